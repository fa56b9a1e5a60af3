// SPDX-License-Identifier: Apache-2.0
// Chains through mirrors and glass: derivatives against differences, and walks within one moment.
#include "tempera/manifold/specular_walk.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>

#include "support/moving_bodies.h"

namespace tempera::test {
namespace {

// A, B, C and tau against central differences of the constraint itself, whose tangents turn with the surface.
TEST(SpecularSystem, BlocksAreDerivativesOfTheConstraint) {
  Numbers random;
  for (int k = 0; k < 60; ++k) {
    Ball middle, before, after;
    middle.velocity = random.vector(1), middle.spin = random(-2, 2), middle.radius = random(0.3, 1);
    const double u = random(0, 2 * kPiD), v = random(0.5, 2.5);
    const bool refracts = k % 2 == 1;
    const double eta = refracts ? (k % 4 == 1 ? 1.5 : 1 / 1.5) : 1;
    // Neighbours where reflection or refraction about the normal leads, on balls of their own.
    const SurfaceFrame f = middle.frame(u, v, 0);
    Vec3d w = normalize(f.n + normalize(cross(f.n, random.vector(1))) * random(0.1, 0.6));
    const double cosine = dot(w, f.n);
    const Vec3d along = (w - f.n * cosine) * (-1 / eta);
    const Vec3d out = refracts ? along - f.n * std::sqrt(1 - dot(along, along)) : f.n * (2 * cosine) - w;
    struct Neighbour {
      Ball ball;
      double u, v;
    };
    const auto neighbour = [&](const Vec3d& p) {
      Neighbour n;
      n.ball.velocity = random.vector(1), n.ball.spin = random(-2, 2), n.ball.radius = random(0.3, 1);
      n.u = random(0, 2 * kPiD), n.v = random(0.5, 2.5);
      n.ball.center = p - n.ball.normal(n.u, n.v, 0) * n.ball.radius;
      return n;
    };
    const Neighbour a = neighbour(f.p + w * random(0.5, 3)), b = neighbour(f.p + out * random(0.5, 3));
    const auto c = [&](const std::array<double, 7>& x) {
      return constraint(ChainEnd::of(a.ball.frame(a.u + x[0], a.v + x[1], x[6])),
                        {middle.frame(u + x[2], v + x[3], x[6]), eta},
                        ChainEnd::of(b.ball.frame(b.u + x[4], b.v + x[5], x[6])));
    };
    ASSERT_LT(length(c({})), 1e-9);
    const ConstraintBlocks blocks =
        blocks_of(ChainEnd::of(a.ball.frame(a.u, a.v, 0)), {f, eta}, ChainEnd::of(b.ball.frame(b.u, b.v, 0)));
    const std::array<Vec2d, 7> found{blocks.before.x, blocks.before.y, blocks.at.x, blocks.at.y,
                                     blocks.after.x,  blocks.after.y,  blocks.rate};
    for (std::size_t i = 0; i < 7; ++i) {
      std::array<double, 7> more{}, less{};
      more[i] = 1e-5, less[i] = -1e-5;
      const Vec2d expected = (c(more) - c(less)) * (0.5 / 1e-5);
      EXPECT_LT(length(found[i] - expected), 1e-6 * (1 + length(expected))) << k << ' ' << i;
    }
  }
}

// The end moves within one moment, by its own parameters.
TEST(SpecularWalk, MovesInSpaceToAnyEnd) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0, 0};
  const ChainEnds ends = ends_of({0, 0, 0}, {-2, 0.4, 0.6}, {}, {1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {3, 0.05, 0.1}, {false});
  const ChainEnds far = ends_of({0, 0, 0}, {-2, -3, 1}, {}, {1, 0, 0});
  ASSERT_EQ(walk_in_space(matter, far.last(0), {1, 0, 0}, 1e-12, chain), WalkState::kDone);
  EXPECT_LT(off_manifold(chain), 1e-11);
  // Light from infinity instead: its direction is the end.
  ChainEnd sky{true, normalize(Vec3d{-1, 0.5, 0.2}), {}, {}, {}};
  auto to_sky = trace_chain(matter, still({0, 0, 0}), {3, 0.1, 0.1}, sky, {}, {false}, 0, nullptr);
  ASSERT_TRUE(to_sky);
  ASSERT_EQ(walk_in_space(matter, sky, {}, 1e-12, *to_sky), WalkState::kDone);
  EXPECT_LT(length(to_sky->last.p - sky.p), 1e-12);
  EXPECT_LT(off_manifold(*to_sky), 1e-11);
}

TEST(SpecularWalk, SaysWhyItEnds) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0, 0};
  const ChainEnds ends = ends_of({0, 0, 0}, {-2, 0.4, 0.6}, {}, {1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {3, 0.05, 0.1}, {false});
  // What covers the end hides nothing from the walk, which does not ask; a wall that comes between does.
  Plane& wall = matter.add<Plane>();
  wall.center = {1, 0, 0}, wall.angle = kPiD;
  const ChainEnds beside = ends_of({0, 0, 0}, {-2, 0.5, 0.6}, {}, {1, 0, 0});
  EXPECT_EQ(walk_in_space(matter, beside.last(0), {1, 0, 0}, 1e-12, chain), WalkState::kMissed);

  Matter glass;
  Plane& inside = glass.add<Plane>();
  inside.center = {2, 0, 0}, inside.angle = kPiD, inside.eta = 1 / 1.5;  // glass on the eye's side
  WalkState why{};
  const ChainEnds behind = ends_of({0, 0, 0}, {4, 0, 0}, {}, {-1, 0, 0});
  EXPECT_FALSE(trace_chain(glass, still({0, 0, 0}), {2, 3, 0}, behind.last(0), {-1, 0, 0}, {true}, 0, nullptr, &why));
  EXPECT_EQ(why, WalkState::kTotal);
}

}  // namespace
}  // namespace tempera::test
