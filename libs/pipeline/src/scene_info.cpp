// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/scene_info.h"

#include <set>

#include "tempera/pipeline/memory.h"

namespace tempera {

SceneInfo describe(const Scene& scene) {
  SceneInfo info;
  for (int i = 0; i < std::ssize(scene.cameras); ++i) {
    const Camera& c = scene.cameras[i];
    CameraInfo out;
    out.name = c.name;
    out.orthographic = c.projection == Projection::kOrthographic;
    if (!out.orthographic) out.fov_degrees = c.fov_x.at(scene.animation.begin) * 180 / kPiD;
    out.animated = scene.moves(c.node, scene.animation) || c.fov_x.varies_over(scene.animation) ||
                   c.width.varies_over(scene.animation) || c.aperture_radius.varies_over(scene.animation) ||
                   c.focus_distance.varies_over(scene.animation);
    out.is_default = i == scene.default_camera;
    info.cameras.push_back(out);
  }
  info.animations = scene.animation_names;
  info.animation = scene.animation;
  info.nodes = scene.nodes.size();
  for (const Node& n : scene.nodes) info.moving_nodes += n.local.varies_over(scene.animation);

  std::set<std::string> materials;
  for (const Shape& s : scene.shapes) {
    if (const auto* mesh = std::get_if<Mesh>(&s.geometry)) {
      ++info.meshes;
      info.triangles += mesh->triangle_count();
      info.skinned += !mesh->skin.joints.empty();
      info.morphed += !mesh->morph_targets.empty();
      info.cached += mesh->cache.samples != nullptr;
    } else if (const auto* analytic = std::get_if<AnalyticShape>(&s.geometry)) {
      info.spheres += analytic->kind == AnalyticKind::kSphere;
      info.disks += analytic->kind == AnalyticKind::kDisk;
      info.cylinders += analytic->kind == AnalyticKind::kCylinder;
    }
    materials.insert(s.material_name);
  }
  info.materials.assign(materials.begin(), materials.end());
  info.instances = scene.instances.size();
  for (const Instance& i : scene.instances) {
    for (const int shape : scene.groups[i.group]) {
      const Shape& s = scene.shapes[shape];
      info.area_lights += s.emission.has_value();
      if (const auto* mesh = std::get_if<Mesh>(&s.geometry)) info.placed_triangles += mesh->triangle_count();
    }
  }
  for (const PunctualLight& l : scene.lights) {
    info.point_lights += l.type == LightType::kPoint;
    info.spot_lights += l.type == LightType::kSpot;
    info.directional_lights += l.type == LightType::kDirectional;
    info.projectors += l.type == LightType::kProjector;
  }
  info.environments = scene.environments.size();
  for (const Environment& e : scene.environments) {
    if (e.width > info.environment_width) info.environment_width = e.width, info.environment_height = e.height;
  }
  info.memory = scene_memory(scene);
  return info;
}

}  // namespace tempera
