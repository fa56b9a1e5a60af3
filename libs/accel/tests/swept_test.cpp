// SPDX-License-Identifier: Apache-2.0
// What moves within a span, where it passes, and which points see each other.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "moving_scenes.h"

namespace tempera {
namespace {

constexpr double kStep = 1.0 / 8;
constexpr TimeSpan kSecond{0, 1};

Mesh morphing(const Animated<std::vector<float>>& weights, const Vec3f& by) {
  Mesh m = make_cube();
  m.morph_targets = {{std::vector<Vec3f>(m.positions.size(), by), {}, {}}};
  m.morph_weights = weights;
  return m;
}

Mesh skinned_to(int node) {
  Mesh m = make_cube();
  m.skin.influences = 1;
  m.skin.joints = {{node, Affine3d{}}};
  m.skin.indices.assign(m.positions.size(), 0);
  m.skin.weights.assign(m.positions.size(), 1);
  return m;
}

AnimatedTransform sliding(std::vector<double> times, std::vector<Vec3d> places, Interpolation how) {
  AnimatedTransform t;
  t.keyed = true;
  t.translation = {std::move(times), std::move(places), how};
  return t;
}

Mesh cached(const std::vector<float>& x) {
  Mesh m = make_cube();
  std::vector<Vec3f> positions;
  std::vector<double> times;
  for (std::size_t k = 0; k < x.size(); ++k) {
    times.push_back(double(k) / double(x.size() - 1));
    for (const Vec3f& p : m.positions) positions.push_back(p + Vec3f{x[k], 0, 0});
  }
  bind_cache(m, {.samples = std::make_shared<VertexCache>(times, m.positions.size(), positions)});
  return m;
}

// Each thing moves within its own part of the second.
TEST(Moves, IsTrueWhereAnythingOfItDoes) {
  const auto linear = Interpolation::kLinear;
  const std::vector<double> keys{0, 0.5, 0.75, 1};  // moves in the third quarter alone
  const std::vector<Vec3d> places{{0, 0, 0}, {0, 0, 0}, {1, 0, 0}, {1, 0, 0}};
  const Animated<std::vector<float>> weights{keys, {{0}, {0}, {1}, {1}}, linear};
  SceneBuilder b;
  const int mover = b.node(sliding(keys, places, linear)), rest = b.node({});
  const int still_but_keyed = b.node(sliding({0, 0.5, 1}, {{1, 2, 3}, {1, 2, 3}, {1, 2, 3}}, linear));
  AnimatedTransform flat = sliding(keys, places, linear);
  flat.scale = Vec3d{1, 1, 0};
  std::vector<bool> moving;
  const auto add = [&](Geometry g, int node, bool moves) {
    b.add(std::move(g), node);
    moving.push_back(moves);
  };
  add(make_cube(), mover, true);
  add(Sphere{}, mover, true);
  add(make_cube(), b.node({}, mover), true);
  add(make_cube(), b.node(flat), true);
  add(Sphere{}, b.node(flat), true);
  add(morphing(weights, {0, 1, 0}), rest, true);
  add(skinned_to(mover), rest, true);
  add(cached({0, 0, 0, 0, 0, 1, 1, 1, 1}), rest, false);  // from 1/2 to 5/8: see below
  moving.back() = true;
  add(make_cube(), rest, false);
  add(Disk{}, still_but_keyed, false);
  add(make_cube(), still_but_keyed, false);
  add(morphing(weights, {0, 0, 0}), rest, false);  // weights change, no vertex follows
  add(skinned_to(rest), mover, false);             // a skin ignores the node that it hangs on
  add(cached({2, 2, 2}), rest, false);
  add(morphing(std::vector<float>{0.5f}, {0, 1, 0}), rest, false);
  GeometryCache cache;
  const RayScene rays(b.scene, {0.5, 0.75}, kSecond, {.motion_step = kStep}, cache);
  for (std::uint32_t i = 0; i < moving.size(); ++i) {
    EXPECT_EQ(rays.moves(i, i, kSecond), moving[i]) << i;
    EXPECT_EQ(rays.moves(i, i, {0.5, 0.75}), moving[i]) << i;
    EXPECT_EQ(rays.moves(i, i, {0.51, 0.52}), moving[i]) << i;
    EXPECT_FALSE(rays.moves(i, i, {0.1, 0.5})) << i;
    EXPECT_FALSE(rays.moves(i, i, {0.75, 1})) << i;
    EXPECT_FALSE(rays.moves(i, i, {0.6, 0.6})) << i;
  }
}

TEST(Moves, CountsJumps) {
  SceneBuilder b;
  b.add(make_cube(), b.node(sliding({0, 0.6}, {{0, 0, 0}, {1, 0, 0}}, Interpolation::kStep)));
  b.add(make_cube(), b.node({}));
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0.59}, kSecond, {.motion_step = kStep}, cache);
  EXPECT_TRUE(rays.moves(0, 0, kSecond));
  EXPECT_TRUE(rays.moves(0, 0, {0.55, 0.65}));
  EXPECT_FALSE(rays.moves(0, 0, {0, 0.59}));
  EXPECT_FALSE(rays.moves(0, 0, {0.61, 1}));
  EXPECT_FALSE(rays.moves(1, 1, kSecond));
  EXPECT_LT(rays.swept_bounds(0, 0, {0, 0.59}).hi.x, 1.001f);
  EXPECT_GT(rays.swept_bounds(0, 0, {0.61, 1}).lo.x, -0.001f);
  const Bounds3f both = rays.swept_bounds(0, 0, kSecond);
  EXPECT_LT(both.lo.x, -0.999f);
  EXPECT_GT(both.hi.x, 1.999f);
}

bool holds(const Bounds3f& b, const Vec3f& p) {
  return p.x >= b.lo.x && p.x <= b.hi.x && p.y >= b.lo.y && p.y <= b.hi.y && p.z >= b.lo.z && p.z <= b.hi.z;
}

/// Box of many points of a shape at many times.
Bounds3f sampled_bounds(const RayScene& rays, std::uint32_t instance, std::uint32_t shape, TimeSpan span) {
  Bounds3f b;
  const auto* mesh = std::get_if<Mesh>(&rays.scene().shapes[shape].geometry);
  for (int i = 0; i <= 32; ++i) {
    const double t = span.begin + span.length() * i / 32;
    if (mesh) {
      for (std::uint32_t k = 0; k < mesh->triangle_count(); ++k) {
        for (const Vec2f uv : {Vec2f{0, 0}, Vec2f{1, 0}, Vec2f{0, 1}}) {
          b.extend(rays.position({instance, shape, k, uv.x, uv.y}, t));
        }
      }
    } else {
      for (int k = 0; k < 33 * 33; ++k) {
        b.extend(rays.position({instance, shape, 0, float(k % 33) / 32, float(k / 33) / 32}, t));
      }
    }
  }
  return b;
}

TEST(SweptBounds, HoldEverythingAndLittleMore) {
  Scene scene = everything_moves();
  const auto turning_fast = [&](const Vec3d& scale, int parent) {
    scene.nodes.push_back({parent, turning({0.2, 1, 0.4}, 10, {0, 0, 0}, {1, 0, 0}, scale, scale), "", 1.0f});
    return int(scene.nodes.size()) - 1;
  };
  const auto add = [&](Geometry g, int node) {
    scene.shapes.push_back({std::move(g), make_black(), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back({int(scene.groups.size()) - 1, node, "", true});
  };
  Mesh afar = make_cube();  // turns about a place outside
  transform(afar, translate(Vec3d{5, 1, 0}));
  add(afar, turning_fast({1, 1, 1}, -1));
  add(Cylinder{Affine3f(translate(Vec3d{4, 1, 0}))}, turning_fast({1, 0.5, 1}, -1));
  add(make_cube(), turning_fast({1, 1, 0}, -1));
  add(Sphere{}, turning_fast({1, 1, 0}, -1));
  add(make_cube(), -1);
  add(Sphere{Affine3f(rotation(axis_angle(Vec3d{0, 0, 1}, 0.5)) * scale(Vec3d{1, 0.2, 3}))}, -1);
  add(Mesh{}, -1);
  GeometryCache cache;
  const RayScene rays(scene, {0.25, 0.75}, kSecond, {.motion_step = kStep}, cache);
  for (std::uint32_t i = 0; i + 1 < scene.instances.size(); ++i) {
    const auto shape = std::uint32_t(scene.groups[scene.instances[i].group][0]);
    const bool loose = std::holds_alternative<Mesh>(scene.shapes[shape].geometry) &&
                       !std::get<Mesh>(scene.shapes[shape].geometry).deforms() && scene.instances[i].node >= 0;
    for (const TimeSpan span : {TimeSpan{0.25, 0.75}, {0, 1}, {0.3, 0.31}, {0.4, 0.4}, {0.5, 0.5}, {0.8, 1}}) {
      const Bounds3f box = rays.swept_bounds(i, shape, span), seen = sampled_bounds(rays, i, shape, span);
      EXPECT_TRUE(holds(box, seen.lo) && holds(box, seen.hi)) << i << " from " << span.begin << " to " << span.end;
      EXPECT_LT(box.radius(), seen.radius() * (loose ? 3.0f : 1.06f))
          << i << " from " << span.begin << " to " << span.end;
    }
  }
  EXPECT_TRUE(
      rays.swept_bounds(std::uint32_t(scene.instances.size()) - 1, std::uint32_t(scene.shapes.size()) - 1, kSecond)
          .empty());
  // Nothing is hit outside of them.
  std::vector<Bounds3f> boxes;
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    boxes.push_back(rays.swept_bounds(i, std::uint32_t(scene.groups[scene.instances[i].group][0]), {0.25, 0.75}));
  }
  for (std::uint64_t i = 0; i < 20000; ++i) {
    const Ray ray = random_ray(i, {0.25, 0.75});
    const auto hit = rays.intersect(ray);
    if (!hit) continue;
    Bounds3f box = boxes[hit->point.instance];
    box.lo = box.lo - Vec3f{2e-5f, 2e-5f, 2e-5f}, box.hi = box.hi + Vec3f{2e-5f, 2e-5f, 2e-5f};  // rounding of the ray
    EXPECT_TRUE(holds(box, ray.o + ray.d * hit->t)) << hit->point.instance;
  }
}

TEST(Visible, IsTheSameForBothOrders) {
  const Scene scene = everything_moves();
  GeometryCache cache;
  const RayScene rays(scene, {0.25, 0.75}, kSecond, {.motion_step = 1.0 / 16}, cache);
  std::vector<SurfaceEnd> ends;
  const double t = 0.4;
  for (std::uint64_t i = 0; ends.size() < 400; ++i) {
    Ray ray = random_ray(i, {t, t});
    const auto hit = rays.intersect(ray);
    if (!hit) continue;
    const SurfaceFrame f = rays.surface(hit->point, hit->point.u, hit->point.v, t);
    ends.push_back({f.p, Vec3f(f.ng)});
    if (i % 4 == 0) ends.push_back({Vec3d(ray.o + ray.d * (0.9f * hit->t)), {}});  // a lamp in the air
  }
  int pairs = 0, seen = 0, clear = 0, otherwise = 0;
  for (std::size_t i = 0; i < ends.size(); ++i) {
    for (std::size_t k = 0; k <= i; k += 1 + (i + k) % 7) {
      const SurfaceEnd &a = ends[i], &b = ends[k];
      const bool visible = rays.visible(a, b, t);
      EXPECT_EQ(visible, rays.visible(b, a, t)) << i << " " << k;
      ++pairs, seen += visible;
      // Clear cases: not along a surface, and what is in the way is not close to either end.
      const Vec3f d(b.p - a.p);
      const float l = length(d);
      if (l < 0.1f) continue;
      const auto grazes = [&](const SurfaceEnd& e) { return e.ng != Vec3f{} && std::abs(dot(e.ng, d)) < 0.2f * l; };
      if (grazes(a) || grazes(b)) continue;
      const bool near = rays.occluded({Vec3f(a.p), d, 1e-4f, 1 - 1e-4f, t});
      const bool far = rays.occluded({Vec3f(a.p), d, 2e-2f, 1 - 2e-2f, t});
      if (near != far) continue;
      ++clear;
      otherwise += visible == near;
    }
  }
  EXPECT_GT(pairs, 10000);
  EXPECT_GT(seen, pairs / 20);
  EXPECT_LT(seen, pairs * 19 / 20);
  EXPECT_GT(clear, pairs / 2);
  EXPECT_LE(otherwise, clear / 1000);  // edges that pass between the ends of one ray and of the other
  EXPECT_TRUE(rays.visible(ends[0], ends[0], t));
  EXPECT_FALSE(rays.visible(ends[0], {{std::nan(""), 0, 0}, {}}, t));
  EXPECT_FALSE(rays.visible({{1e300, 0, 0}, {}}, ends[0], t));
}

// Slats as narrow as some hundred roundings: a ray the other way round would often end otherwise.
TEST(Visible, IsTheSameForBothOrdersPastManyEdges) {
  SceneBuilder b;
  Mesh slats;
  for (int i = 0; i < 20000; ++i) {
    const float x = 1e-4f * float(i);
    const auto base = std::uint32_t(slats.positions.size());
    for (const Vec3f& p : {Vec3f{x, -1, 0}, {x + 5e-5f, -1, 0}, {x + 2.5e-5f, 3, 0}}) slats.positions.push_back(p);
    for (const std::uint32_t k : {0u, 1u, 2u}) slats.indices.push_back(base + k);
  }
  b.add(slats, -1);
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0}, {0, 0}, {}, cache);
  int seen = 0;
  for (std::uint64_t i = 0; i < 20000; ++i) {
    const auto at = [&](std::uint64_t k, double z, float up) {
      return SurfaceEnd{{2.0 * uniform(i, k), 2.0 * uniform(i, k + 1), z}, {0, 0, up}};
    };
    const SurfaceEnd low = at(0, -1, i % 3 ? 1.0f : 0.0f), high = at(2, 1, -1);
    const bool visible = rays.visible(low, high, 0);
    EXPECT_EQ(visible, rays.visible(high, low, 0)) << i;
    seen += visible;
  }
  EXPECT_GT(seen, 8000);
  EXPECT_LT(seen, 19000);
}

TEST(Visible, BothEndsLeaveTheirSurfaces) {
  SceneBuilder b;
  Mesh floor = make_rectangle(), ceiling = make_rectangle();
  transform(floor, translate(Vec3d{1000, 1000, 0}));
  transform(ceiling, translate(Vec3d{1000, 1000, 2}));
  b.add(floor, -1);
  b.add(ceiling, -1);
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0}, {0, 0}, {}, cache);
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const auto at = [&](std::uint64_t k, double z, float up) {
      return SurfaceEnd{{1000 + 1.9 * uniform(i, k) - 0.95, 1000 + 1.9 * uniform(i, k + 1) - 0.95, z}, {0, 0, up}};
    };
    for (const float up : {-1.0f, 1.0f}) {
      const SurfaceEnd low = at(0, 0, up), high = at(2, 2, 1), above = at(2, 3, 1);
      EXPECT_TRUE(rays.visible(low, high, 0) && rays.visible(high, low, 0));
      EXPECT_FALSE(rays.visible(low, above, 0) || rays.visible(above, low, 0));
    }
  }
}

}  // namespace
}  // namespace tempera
