// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/default_view.h"

#include <cmath>

#include "tempera/scene/deform.h"

namespace tempera {

Bounds3f world_bounds(const Scene& scene, double t) {
  constexpr std::size_t kVerticesPerMesh = 4096;
  Bounds3f bounds;
  for (const Instance& instance : scene.instances) {
    if (!scene.visible(instance.node, t)) continue;
    const Affine3f world(scene.world(instance.node, t));
    for (const int shape : scene.groups[instance.group]) {
      const Geometry& geometry = scene.shapes[shape].geometry;
      if (const auto* mesh = std::get_if<Mesh>(&geometry)) {
        const MeshPose pose = mesh_pose(scene, *mesh, instance.node, t);
        const std::size_t stride = std::max<std::size_t>(1, mesh->positions.size() / kVerticesPerMesh);
        for (std::size_t v = 0; v < mesh->positions.size(); v += stride) {
          bounds.extend(posed_position(*mesh, pose, std::uint32_t(v)));
        }
      } else {
        const Affine3f m = object_from_unit(geometry);
        for (int i = 0; i < 8; ++i) {
          bounds.extend(world.point(m.point({i & 1 ? 1.0f : -1.0f, i & 2 ? 1.0f : -1.0f, i & 4 ? 1.0f : -1.0f})));
        }
      }
    }
  }
  return bounds;
}

void add_default_camera(Scene& scene) {
  Bounds3f bounds;
  constexpr int kTimes = 8;
  for (int i = 0; i <= kTimes; ++i) {
    bounds.extend(world_bounds(scene, scene.animation.begin + scene.animation.length() * i / kTimes));
  }
  if (bounds.empty() || !is_finite(bounds.center())) bounds = {{-1, -1, -1}, {1, 1, 1}};
  const double radius = std::max(1e-6f, bounds.radius());
  constexpr double kVerticalFov = 0.7;
  Camera camera;
  camera.name = "default";
  camera.keep_vertical_fov = true;
  camera.fov_x = float(2 * std::atan(std::tan(kVerticalFov / 2) * camera.authored_aspect));
  const Vec3d center(bounds.center());
  const Vec3d from = center + normalize(Vec3d{0.35, 0.25, 1}) * (radius / std::sin(kVerticalFov / 2) * 1.02);
  camera.node = int(scene.nodes.size());
  camera.near_clip = float(radius * 1e-3);
  scene.nodes.push_back({-1, AnimatedTransform(look_at(from, center, Vec3d{0, 1, 0})), "default camera", 1.0f});
  scene.cameras = {camera};
  scene.default_camera = 0;
}

bool has_light(const Scene& scene) {
  if (!scene.lights.empty() || !scene.environments.empty()) return true;
  return std::any_of(scene.shapes.begin(), scene.shapes.end(), [](const Shape& s) { return s.emission.has_value(); });
}

void add_default_light(Scene& scene) {
  Environment environment;
  environment.radiance = Rgb(0.5f);
  environment.name = "default environment";
  scene.environments.push_back(environment);
  PunctualLight sun;
  sun.type = LightType::kDirectional;
  sun.intensity = Rgb(2.0f);
  sun.name = "default light";
  sun.node = int(scene.nodes.size());
  scene.nodes.push_back(
      {-1, AnimatedTransform(look_at(Vec3d{-0.5, 1, 0.8}, Vec3d{0, 0, 0}, Vec3d{0, 1, 0})), "default light", 1.0f});
  scene.lights.push_back(sun);
}

}  // namespace tempera
