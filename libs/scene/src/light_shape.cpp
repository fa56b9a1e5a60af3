// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/light_shape.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tempera/core/error.h"

namespace tempera {

void make_sphere_light(Scene& scene, int index, float radius, bool camera_visible) {
  auto light = std::make_shared<PunctualLight>(scene.lights.at(index));
  TEMPERA_ASSERT(radius > 0 && (light->type == LightType::kPoint || light->type == LightType::kSpot));
  scene.lights.erase(scene.lights.begin() + index);

  Affine3d m = scene.world(light->node, scene.animation.begin);
  m.translation = {};
  const Vec3d z = normalize(m.z), x = normalize(cross(m.y, z));
  Node node;
  node.parent = light->node;
  node.name = light->name;
  node.local = inverse(m) * Affine3d{x, cross(z, x), z};
  const Affine3d& local = node.local.matrix;
  if (!is_finite(local.x) || !is_finite(local.y) || !is_finite(local.z)) {
    throw Error(ErrorCode::kBadInput, SourceLoc{scene.source.string()},
                fmt::format("the light \"{}\" has a singular transform and cannot be given a radius", light->name));
  }

  Shape shape;
  shape.geometry = Sphere{Affine3f(scale(Vec3d{radius, radius, radius}))};
  shape.material = make_black();
  shape.name = light->name;
  AreaEmission emission;
  emission.radiance = product(light->intensity, light->intensity_scale);
  const float per_area = kInvPi / (radius * radius);
  emission.radiance = product(emission.radiance.factor, Animated<float>(per_area));
  if (light->type == LightType::kSpot) emission.spot = light;
  shape.emission = std::move(emission);

  Instance instance;
  instance.group = int(scene.groups.size());
  instance.node = int(scene.nodes.size());
  instance.name = light->name;
  instance.camera_visible = camera_visible;
  scene.groups.push_back({int(scene.shapes.size())});
  scene.nodes.push_back(std::move(node));
  scene.shapes.push_back(std::move(shape));
  scene.instances.push_back(std::move(instance));
}

}  // namespace tempera
