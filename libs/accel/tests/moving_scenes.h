// SPDX-License-Identifier: Apache-2.0
#pragma once
// Scenes in which everything moves, and rays into them.
#include <cmath>

#include "tempera/accel/ray_scene.h"
#include "tempera/core/random.h"
#include "tempera/scene/scene.h"

namespace tempera {

inline float uniform(std::uint64_t key, std::uint64_t i) {
  return to_unit_float(std::uint32_t(hash_key(key, i) >> 32));
}

/// A bumpy sphere of 2 * rings * sectors triangles with normals and uvs.
inline Mesh bumpy_sphere(int rings = 24, int sectors = 32) {
  Mesh m;
  for (int j = 0; j <= rings; ++j) {
    for (int i = 0; i <= sectors; ++i) {
      const float theta = kPi * (float(j) + 0.001f) / (float(rings) + 0.002f),
                  phi = 2 * kPi * float(i) / float(sectors);
      const Vec3f n{std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)};
      m.positions.push_back(n * (1 + 0.2f * std::sin(5 * theta) * std::cos(3 * phi)));
      m.normals.push_back(n);
      m.uvs.push_back({float(i) / float(sectors), float(j) / float(rings)});
    }
  }
  for (int j = 0; j < rings; ++j) {
    for (int i = 0; i < sectors; ++i) {
      const auto a = std::uint32_t(j * (sectors + 1) + i), b = a + std::uint32_t(sectors) + 1;
      for (const std::uint32_t v : {a, a + 1, b, b, a + 1, b + 1}) m.indices.push_back(v);
    }
  }
  return m;
}

inline AnimatedTransform turning(const Vec3d& axis, double angle, const Vec3d& from, const Vec3d& to,
                                 const Vec3d& scale0, const Vec3d& scale1) {
  AnimatedTransform t;
  t.keyed = true;
  std::vector<double> times;
  std::vector<Quatd> rotations;
  for (int i = 0; i <= 4; ++i) {
    times.push_back(i * 0.25);
    rotations.push_back(axis_angle(normalize(axis), angle * i / 4));
  }
  t.rotation = {times, rotations, Interpolation::kLinear};
  t.translation = {{0, 1}, {from, to}, Interpolation::kLinear};
  t.scale = {{0, 1}, {scale0, scale1}, Interpolation::kLinear};
  return t;
}

struct SceneBuilder {
  Scene scene;
  int node(const AnimatedTransform& local, int parent = -1) {
    scene.nodes.push_back({parent, local, "", 1.0f});
    return int(scene.nodes.size()) - 1;
  }
  void add(Geometry g, int node) {
    scene.shapes.push_back({std::move(g), make_black(), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back({int(scene.groups.size()) - 1, node, "", true});
  }
};

inline Scene everything_moves() {
  SceneBuilder b;
  const int rigid = b.node(turning({1, 2, 3}, 2.5, {-4, 0, 0}, {-3, 1, 0}, {1, 1, 1}, {1, 1, 1}));
  const int nested = b.node(turning({0, 1, 0}, -1.5, {1, 0, 0}, {1, 0.5, 0}, {1, 1, 1}, {1.5, 0.7, 1}),
                            b.node(turning({0, 0, 1}, 1, {0, 4, 0}, {0, 3.5, 1}, {1, 2, 1}, {1, 1.5, 1})));
  const int fixed = b.node(Affine3d(translate(Vec3d{4, 0, 0}) * rotation(axis_angle(Vec3d{0, 1, 0}, 0.3))));
  b.add(bumpy_sphere(), rigid);
  b.add(bumpy_sphere(), nested);
  b.add(bumpy_sphere(), fixed);
  b.add(Sphere{Affine3f(scale(Vec3f{1, 0.6f, 0.8f}))},
        b.node(turning({1, 0, 0}, 2, {0, -4, 0}, {1, -4, 0}, {1, 1, 1}, {1, 1, 1})));
  b.add(Cylinder{}, b.node(turning({1, 0, 1}, 2, {4, 4, 0}, {4, 3, 0}, {1, 1, 1}, {1, 1, 1})));
  b.add(Disk{}, b.node(turning({1, 0, 1}, 2, {-4, 4, 0}, {-4, 4, 1}, {1, 1, 1}, {1, 1, 1})));
  Mesh morph = bumpy_sphere();
  MorphTarget target;
  for (const Vec3f& p : morph.positions) {
    target.positions.push_back({0.5f * std::sin(3 * p.y), 0.3f * p.x, 0});
    target.normals.push_back({0.2f * p.y, 0, 0});
  }
  morph.morph_targets = {target};
  morph.morph_weights = {{0, 0.4, 1}, {std::vector<float>{0}, {1}, {0.2f}}, Interpolation::kLinear};
  b.add(morph, b.node(turning({0, 1, 0}, 1, {-4, -4, 0}, {-4, -4, 1}, {1, 1, 1}, {1, 1, 1})));
  Mesh skinned = bumpy_sphere();
  skinned.skin.influences = 2;
  const int root = b.node(Affine3d(translate(Vec3d{4, -4, 0})));
  const int joint = b.node(turning({0, 0, 1}, 1.2, {0, 0, 0}, {0, 0.2, 0}, {1, 1, 1}, {1, 1, 1}), root);
  skinned.skin.joints = {{root, Affine3d{}}, {joint, Affine3d{}}};
  for (const Vec3f& p : skinned.positions) {
    const float w = std::clamp(0.5f + 0.5f * p.y, 0.0f, 1.0f);
    for (const int j : {0, 1}) skinned.skin.indices.push_back(std::uint16_t(j));
    skinned.skin.weights.push_back(1 - w);
    skinned.skin.weights.push_back(w);
  }
  b.add(skinned, -1);
  Mesh cached = bumpy_sphere();
  std::vector<Vec3f> positions;
  for (int k = 0; k <= 3; ++k) {
    for (const Vec3f& p : cached.positions) positions.push_back(p * (1 + 0.1f * float(k)) + Vec3f{0, 0, 4});
  }
  bind_cache(cached, {.samples = std::make_shared<VertexCache>(std::vector{0.0, 1 / 3.0, 2 / 3.0, 1.0},
                                                               cached.positions.size(), positions)});
  b.add(cached, -1);
  return b.scene;
}

inline Ray random_ray(std::uint64_t i, TimeSpan span) {
  const auto r = [&](int k) { return uniform(i, std::uint64_t(k)); };
  const float z = 1 - 2 * r(0), phi = 2 * kPi * r(1), s = std::sqrt(1 - z * z);
  const Vec3f o = Vec3f{s * std::cos(phi), s * std::sin(phi), z} * 12;
  const Vec3f target{10 * r(2) - 5, 10 * r(3) - 5, 6 * r(4) - 1};
  return {o, normalize(target - o), 0, kInfinity, span.begin + (span.end - span.begin) * r(5)};
}

}  // namespace tempera
