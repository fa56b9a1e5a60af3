// SPDX-License-Identifier: Apache-2.0
#pragma once
// Glass that moves between parallel light from straight above and a diffuse ground at z = 0.
#include "tempera/scene/scene.h"

namespace tempera::test {

/// `width`: of what the camera sees from above, about (x, 0), in metres; `ground`: half of the side of the ground. Instance 0
/// is the glass, 1 the ground.
inline Scene lit_ground(Mesh glass, double ior, AnimatedTransform motion, float x, float width, float ground) {
  Scene scene;
  scene.nodes.push_back({-1, std::move(motion), "glass", 1.0f});
  scene.nodes.push_back(
      {-1, AnimatedTransform(Affine3d(look_at(Vec3f{x, 0, 3}, Vec3f{x, 0, 0}, Vec3f{0, 1, 0}))), "light", 1.0f});
  const auto add = [&](Mesh mesh, MaterialPtr material, int node) {
    scene.shapes.push_back({std::move(mesh), std::move(material), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back({int(scene.groups.size()) - 1, node, "shape", true});
  };
  DielectricParams dielectric;
  dielectric.int_ior = float(ior), dielectric.ext_ior = 1;
  add(std::move(glass), make_dielectric(dielectric), 0);
  Mesh below = make_rectangle();
  for (Vec3f& p : below.positions) p *= ground;
  add(std::move(below), make_diffuse(0.8f), -1);
  PunctualLight light;
  light.type = LightType::kDirectional;
  light.intensity = Rgb(1.0f);
  light.node = 1;
  scene.lights.push_back(light);
  Camera camera;
  camera.projection = Projection::kOrthographic;
  camera.node = 1;
  camera.width = width;
  scene.cameras.push_back(camera);
  return scene;
}

}  // namespace tempera::test
