// SPDX-License-Identifier: Apache-2.0
// Differentials of surfaces and crossings of lines with them, in double, for every shape and motion.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <string>

#include "moving_scenes.h"

namespace tempera {
namespace {

constexpr double kStep = 1.0 / 8;
constexpr TimeSpan kSecond{0, 1};

struct Case {
  std::string name;
  Scene scene;
};

Mesh flat_mesh() { return make_cube(); }
Mesh smooth_mesh() { return bumpy_sphere(12, 16); }

AnimatedTransform keyed_scale(const Vec3d& from, const Vec3d& to) {
  return turning({1, 0, 0}, 0, {0.5, 0, 0}, {0.7, 0.1, 0}, from, to);
}

/// Each shape under each motion of nodes, and each deformation of meshes.
std::vector<Case> cases() {
  std::vector<Case> all;
  const auto shapes = [](const std::function<void(const char*, Geometry)>& f) {
    f("flat mesh", flat_mesh());
    f("smooth mesh", smooth_mesh());
    Mesh inside_out = smooth_mesh();
    inside_out.flip_normals = true;
    f("flipped mesh", inside_out);
    const Affine3f placed = Affine3f(translate(Vec3d{0.3, -0.1, 0.2}) * rotation(axis_angle(Vec3d{0, 0.6, 0.8}, 0.7)) *
                                     scale(Vec3d{0.8, 0.5, -0.6}));
    f("sphere", Sphere{placed});
    f("disk", Disk{placed, true});
    f("cylinder", Cylinder{placed});
  };
  const auto motions = [](const std::function<void(const char*, const std::function<int(SceneBuilder&)>&)>& f) {
    f("still", [](SceneBuilder& b) { return b.node(Affine3d(translate(Vec3d{0.2, 0.1, 0}))); });
    f("still and mirrored", [](SceneBuilder& b) { return b.node(Affine3d(scale(Vec3d{-0.7, 0.6, 0.5}))); });
    f("rigid", [](SceneBuilder& b) {
      return b.node(turning({1, 2, 3}, 2.5, {-0.4, 0, 0}, {-0.3, 0.4, 0}, {1, 1, 1}, {1, 1, 1}));
    });
    f("turning slowly", [](SceneBuilder& b) {
      return b.node(turning({1, 2, 3}, 0.3, {-0.4, 0, 0}, {-0.3, 0.4, 0}, {1, 1, 1}, {1, 1, 1}));
    });
    f("scaled", [](SceneBuilder& b) { return b.node(keyed_scale({0.5, 0.6, 0.7}, {0.9, 0.5, 0.8})); });
    f("mirrored", [](SceneBuilder& b) { return b.node(keyed_scale({-0.5, 0.6, 0.7}, {-0.9, 0.5, 0.8})); });
    f("sheared", [](SceneBuilder& b) {
      const int parent = b.node(keyed_scale({0.5, 1, 0.7}, {0.9, 0.5, 1}));
      return b.node(turning({0, 1, 1}, 1.5, {0, 0, 0}, {0.1, 0, 0}, {1, 0.8, 1}, {1, 1, 0.7}), parent);
    });
    f("scaled through zero", [](SceneBuilder& b) { return b.node(keyed_scale({0.53, 0.6, 0.7}, {-0.4, 0.5, 0.8})); });
    f("flat", [](SceneBuilder& b) {
      const int parent = b.node(turning({0, 1, 1}, 1.5, {0, 0, 0}, {0.1, 0, 0}, {1, 1, 1}, {1, 1, 1}));
      return b.node(Affine3d(scale(Vec3d{0.9, 0.8, 0})), parent);
    });
  };
  motions([&](const char* motion, const std::function<int(SceneBuilder&)>& node) {
    shapes([&](const char* shape, Geometry geometry) {
      for (const bool shared : {false, true}) {
        SceneBuilder b;
        b.add(geometry, node(b));
        if (shared) b.scene.instances.push_back({0, b.node(Affine3d(translate(Vec3d{5, 0, 0}))), "", true});
        all.push_back({std::string(shape) + ", " + motion + (shared ? ", shared" : ""), b.scene});
      }
    });
  });
  const Scene moving = everything_moves();
  for (std::size_t i = 0; i < moving.instances.size(); ++i) {  // skinned, morphed, from a vertex cache
    const auto* mesh = std::get_if<Mesh>(&moving.shapes[moving.instances[i].group].geometry);
    if (!mesh || !mesh->deforms()) continue;
    for (const bool smooth : {false, true}) {
      Case c{"deforming mesh " + std::to_string(i), moving};
      c.scene.instances = {moving.instances[i]};
      c.scene.groups = {{moving.instances[i].group}};
      c.scene.instances[0].group = 0;
      if (!smooth) {
        Mesh& flat = std::get<Mesh>(c.scene.shapes[c.scene.groups[0][0]].geometry);
        flat.normals.clear();
        for (MorphTarget& target : flat.morph_targets) target.normals.clear();
      }
      all.push_back(std::move(c));
    }
  }
  return all;
}

/// A point of instance 0, away from poles.
SurfacePoint random_point(const Scene& scene, std::uint64_t i) {
  SurfacePoint p;
  p.shape = std::uint32_t(scene.groups[scene.instances[0].group][0]);
  p.u = uniform(i, 0), p.v = uniform(i, 1);
  if (const auto* mesh = std::get_if<Mesh>(&scene.shapes[p.shape].geometry)) {
    p.primitive = std::uint32_t(hash_key(i, 7) % mesh->triangle_count());
    if (p.u + p.v > 1) p.u = 1 - p.u, p.v = 1 - p.v;
  } else {
    p.u = 0.05f + 0.9f * p.u, p.v = 0.05f + 0.9f * p.v;
  }
  return p;
}

/// Whether the shape passes through zero about now: derivatives of its normals have no bound there.
bool nearly_gone(const Case& c, double t) {
  return c.name.find("zero") != std::string::npos && std::abs(t - 0.53 / 0.93) < 0.05;
}

/// Side or fold of something flat: its normal is rounding, or flips within the step of a difference.
bool is_sliver(const SurfaceFrame& f) {
  const double a = length(f.dpdu), b = length(f.dpdv);
  return length(cross(f.dpdu, f.dpdv)) < std::max(3e-2 * a * b, 1e-6 * sqr(std::max(a, b)));
}

/// Derivative of f at 0 by differences of fourth order.
template <class F>
Vec3d difference(double h, const F& f) {
  return (f(h) - f(-h)) * (8 / (12 * h)) - (f(2 * h) - f(-2 * h)) * (1 / (12 * h));
}

TEST(SurfaceFrame, DerivativesAreThoseOfItsOwnPointsAndNormals) {
  for (const Case& c : cases()) {
    SCOPED_TRACE(c.name);
    GeometryCache cache;
    const RayScene rays(c.scene, {0.25, 0.75}, kSecond, {.motion_step = kStep}, cache);
    int tested = 0;
    for (std::uint64_t i = 0; i < 24; ++i) {
      const SurfacePoint point = random_point(c.scene, i);
      const double u = point.u, v = point.v;
      const double t = (double(i % 8) + 0.1 + 0.8 * uniform(i, 2)) * kStep;  // inside a segment
      const SurfaceFrame f = rays.surface(point, u, v, t);
      if (nearly_gone(c, t) || is_sliver(f)) continue;
      ++tested;
      const auto expect = [&](const char* what, const Vec3d& derivative, double h, auto&& at) {
        const Vec3d d = difference(h, at);
        EXPECT_LT(length(derivative - d), 1e-6 * (0.1 + length(d))) << what << " of point " << i << " at " << t;
      };
      const auto check = [&](const char* what, Vec3d SurfaceFrame::*of, const Vec3d* du, const Vec3d* dv,
                             const Vec3d* dt) {
        const auto by = [&](double a, double b, double s) { return rays.surface(point, u + a, v + b, t + s).*of; };
        if (du) expect(what, *du, 1e-3, [&](double h) { return by(h, 0, 0); });
        if (dv) expect(what, *dv, 1e-3, [&](double h) { return by(0, h, 0); });
        expect(what, *dt, 4e-3 * kStep, [&](double h) { return by(0, 0, h); });
      };
      check("p", &SurfaceFrame::p, &f.dpdu, &f.dpdv, &f.dpdt);
      check("n", &SurfaceFrame::n, &f.dndu, &f.dndv, &f.dndt);
      check("ng", &SurfaceFrame::ng, nullptr, nullptr, &f.dngdt);
    }
    EXPECT_GE(tested, 5);
  }
}

// More places than a cache holds, of two scenes in turn: resampled in other steps, they move in other ways.
TEST(SurfaceFrame, IsTheSameWithCachedPlaces) {
  for (const Case& c : cases()) {
    SCOPED_TRACE(c.name);
    GeometryCache first, second;
    PoseCache poses;
    const RayScene early(c.scene, {0.25, 0.5}, kSecond, {.motion_step = kStep}, first),
        late(c.scene, {0.5, 0.75}, kSecond, {.motion_step = 2 * kStep}, second);
    for (std::uint64_t i = 0; i < 400; ++i) {
      const SurfacePoint point = random_point(c.scene, i % 7);
      const double t = double(i / 4 % 90) / 90;
      const RayScene& rays = i % 2 ? early : late;
      const SurfaceFrame f = rays.surface(point, point.u, point.v, t);
      const SurfaceFrame cached = rays.surface(point, point.u, point.v, t, &poses);
      for (const auto of : {&SurfaceFrame::p, &SurfaceFrame::ng, &SurfaceFrame::n, &SurfaceFrame::dpdu,
                            &SurfaceFrame::dpdv, &SurfaceFrame::dpdt, &SurfaceFrame::dndt})
        EXPECT_EQ(f.*of, cached.*of) << t;
    }
  }
}

TEST(SurfaceFrame, IsWhatShadingSees) {
  for (const Case& c : cases()) {
    SCOPED_TRACE(c.name);
    GeometryCache cache;
    const RayScene rays(c.scene, {0.25, 0.75}, kSecond, {.motion_step = kStep}, cache);
    for (std::uint64_t i = 0; i < 50; ++i) {
      const SurfacePoint point = random_point(c.scene, i);
      const double t = i < 9 ? double(i) * kStep : double(uniform(i, 2));  // at knots, too
      const SurfaceFrame f = rays.surface(point, point.u, point.v, t);
      Vec3f ng;
      EXPECT_LT(length(f.p - Vec3d(rays.position(point, t, &ng))), 1e-6) << t;
      const ShadingPoint s = rays.shading_point(point, t, {0, 0, 1});
      if (nearly_gone(c, t) || is_sliver(f)) continue;
      const double rounding = 4e-7 * (length(f.dpdu) + length(f.dpdv)) / length(cross(f.dpdu, f.dpdv));
      EXPECT_LT(length(f.ng - Vec3d(ng)), 1e-5 + rounding) << t;
      EXPECT_LT(length(f.n - Vec3d(s.frame.n)), 1e-5 + rounding) << t;
      // The end of a span is no rest.
      if (i == 8) {
        EXPECT_LT(length(f.dpdt - rays.surface(point, point.u, point.v, t - 1e-9).dpdt), 1e-6);
      }
    }
  }
}

TEST(SurfaceFrame, VelocitiesDoNotCrossJumps) {
  SceneBuilder b;
  AnimatedTransform jumping;
  jumping.keyed = true;
  jumping.translation = {{0, 0.5, 0.5, 1}, {Vec3d{0, 0, 0}, {1, 0, 0}, {90, 0, 0}, {90, 2, 0}}, Interpolation::kLinear};
  b.add(make_cube(), b.node(jumping));
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0.5}, kSecond, {.motion_step = kStep}, cache);
  for (int i = 0; i <= 20; ++i) {
    const double t = i / 20.0;
    const Vec3d v = rays.surface({}, 0.2, 0.3, t).dpdt;
    EXPECT_LT(length(v - (t <= 0.5 ? Vec3d{2, 0, 0} : Vec3d{0, 4, 0})), 1e-5) << t;
  }
}

// Rays through pixels are double; the ones that are traced are those rounded to float.
TEST(Refine, FindsWhereTheLineCrossesTheSurface) {
  int lines = 0, found = 0;
  for (const Case& c : cases()) {
    SCOPED_TRACE(c.name);
    GeometryCache cache;
    const RayScene rays(c.scene, {0.25, 0.75}, kSecond, {.motion_step = kStep}, cache);
    for (std::uint64_t i = 0; i < 60; ++i) {
      const double t = 0.25 + 0.5 * uniform(i, 5);
      const SurfacePoint target = random_point(c.scene, i);
      const Vec3d o = Vec3d{2 * uniform(i, 3) - 1, 2 * uniform(i, 4) - 1, i % 2 ? 3.0 : -3.0} / 1.1;
      const Vec3d d = rays.surface(target, target.u, target.v, t).p - o;
      const auto hit = rays.intersect({Vec3f(o), Vec3f(d), 0, kInfinity, t});
      if (!hit) continue;
      ++lines;
      const auto exact = rays.refine(*hit, o, d, t);
      if (!exact) continue;
      ++found;
      const SurfaceFrame f = rays.surface(hit->point, exact->u, exact->v, t);
      EXPECT_LT(length(f.p - (o + d * exact->distance)), 1e-12) << i;
      EXPECT_LT(std::abs(exact->distance - double(hit->t)), 1e-3) << i;
      // Nothing is in front of the target but what is nearer.
      if (hit->point.primitive == target.primitive && std::abs(hit->t - 1) < 1e-6f) {
        EXPECT_NEAR(exact->distance, 1, 1e-12) << i;
      }
      if (c.name.find("still") != std::string::npos) {
        Hit other = *hit;
        other.t += 100;  // another crossing of a sphere is its back
        const auto back = rays.refine(other, o, d, t);
        EXPECT_TRUE(!back || back->distance >= exact->distance - 1e-9) << i;
      }
    }
  }
  EXPECT_GT(lines, 4000);
  EXPECT_GT(found, lines * 99 / 100);
}

TEST(Refine, IsEmptyForLinesThatMiss) {
  SceneBuilder b;
  const int still = b.node({});
  b.add(make_rectangle(), still);
  b.add(Sphere{}, still);
  b.add(Disk{}, still);
  b.add(Cylinder{}, still);
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0}, {0, 0}, {}, cache);
  const auto refined = [&](std::uint32_t shape, const Vec3d& o, const Vec3d& d) {
    return rays.refine({{shape, shape, 0, 0, 0}, 1}, o, d, 0).has_value();
  };
  for (const std::uint32_t shape : {0u, 2u}) {
    EXPECT_TRUE(refined(shape, {1 - 1e-9, -1e-9, 1}, {0, 0, -1}));
    EXPECT_TRUE(refined(shape, {1 + 1e-5, -1e-9, 1}, {0, 0, -1}));  // within the slack
    EXPECT_FALSE(refined(shape, {1 + 1e-3, -1e-9, 1}, {0, 0, -1}));
    EXPECT_FALSE(refined(shape, {0, 0, 1}, {1, 0, 0}));
  }
  EXPECT_TRUE(refined(1, {1 - 1e-9, 0, 2}, {0, 0, -1}));
  EXPECT_FALSE(refined(1, {1 + 1e-9, 0, 2}, {0, 0, -1}));
  EXPECT_TRUE(refined(1, {0, 0, 2}, {0, 0, -1}));  // the pole
  EXPECT_TRUE(refined(3, {2, 0, 1}, {-1, 0, 0}));
  EXPECT_FALSE(refined(3, {2, 0, 1.001}, {-1, 0, 0}));
  EXPECT_FALSE(refined(3, {0, 0, 2}, {0, 0, -1}));
}

}  // namespace
}  // namespace tempera
