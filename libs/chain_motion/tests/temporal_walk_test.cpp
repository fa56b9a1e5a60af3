// SPDX-License-Identifier: Apache-2.0
// Walks through moving mirrors and glass against what optics says.
#include "tempera/chain_motion/temporal_walk.h"

#include <gtest/gtest.h>

#include "support/moving_bodies.h"

namespace tempera::test {
namespace {

TEST(TemporalWalk, TurningMirrorShowsTheVirtualImage) {
  Matter matter;
  Plane& mirror = matter.add<Plane>();
  mirror.center = {2, 0, 0}, mirror.velocity = {0.3, 0.1, 0}, mirror.angle = kPiD, mirror.turn = 0.3;
  const ChainEnds ends = ends_of({0, 0, 0}, {0.5, 1.5, 0.4}, {0.2, -0.3, 0.5}, {0, -1, 0});
  const SpecularChain start = chain_to(matter, ends, {2, 0.4, 0.1}, {false});
  for (const double to : {1.0, -1.0, 0.37}) {
    SpecularChain chain = start;
    WalkCounts counts;
    ASSERT_EQ(walk_in_time(matter, ends, to, 1e-12, chain, &counts), WalkState::kDone);
    const Vec3d n = mirror.normal(0, 0, to), p = ends.last(to).p;
    const Vec3d image = p - n * (2 * dot(p - mirror.at(to), n));
    const Vec3d seen = image * (dot(mirror.at(to), n) / dot(image, n));
    EXPECT_LT(length(chain.vertices[0].specular.surface.p - seen), 1e-11) << to;
    EXPECT_LE(counts.temporal, 2);
    EXPECT_LE(counts.spatial, 6);
  }
}

TEST(TemporalWalk, GlassSlabShiftsWhatIsBehindIt) {
  Matter matter;
  constexpr double kEta = 1.5, kThick = 0.5;
  for (const double x : {2.0, 2.0 + kThick}) {
    Plane& face = matter.add<Plane>();
    face.center = {x, 0, 0}, face.velocity = {0.4, 0, 0}, face.angle = x > 2 ? 0 : kPiD, face.eta = kEta;
  }
  const ChainEnds ends = ends_of({0, 0, 0}, {5, 1, 0.5}, {0, -0.8, 0.3}, {-1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {2, 0.4, 0.2}, {true, true});
  ASSERT_EQ(walk_in_time(matter, ends, 1, 1e-12, chain), WalkState::kDone);
  // Where it leaves the eye's axis: outside at angle a, inside at b, with sin a = eta sin b.
  const Vec3d p = ends.last(1).p, first = chain.vertices[0].specular.surface.p;
  const double tan_a = std::hypot(first.y, first.z) / first.x, sin_a = tan_a / std::sqrt(1 + tan_a * tan_a);
  const double sin_b = sin_a / kEta, tan_b = sin_b / std::sqrt(1 - sin_b * sin_b);
  EXPECT_NEAR(first.x, 2.4, 1e-12);
  EXPECT_NEAR(tan_a * (p.x - kThick) + tan_b * kThick, std::hypot(p.y, p.z), 1e-11);
  EXPECT_NEAR(first.y * p.z, first.z * p.y, 1e-12);
}

// Reflection and two refractions by a ball that moves and spins by about a tenth of a picture.
TEST(TemporalWalk, BallsAreFollowedInFewStepsAndBack) {
  Numbers random;
  int temporal = 0, spatial = 0, done = 0;
  constexpr int kPaths = 200;
  for (int k = 0; k < kPaths; ++k) {
    Matter matter;
    Ball& ball = matter.add<Ball>();
    const bool glass = k % 2 == 1;
    ball.center = {4, random(-0.3, 0.3), random(-0.3, 0.3)}, ball.velocity = random.vector(0.25);
    ball.spin = random(-1, 1), ball.eta = glass ? 1.5 : 0;
    const Vec3d aim = ball.center + Vec3d{-0.7, random(-0.5, 0.5), random(-0.5, 0.5)};
    const std::vector<bool> refracts = glass ? std::vector<bool>{true, true} : std::vector<bool>{false};
    // A wall behind glass, one behind the eye for the mirror: the point is where the first path ends.
    const double wall = glass ? 7 : -2;
    ChainEnds ends = ends_of({0, 0, 0}, {wall, 0, 0}, random.vector(0.2), {glass ? -1.0 : 1.0, 0, 0});
    const auto start = trace_chain(matter, ends.first(0), aim, ends.last(0), ends.last_normal(0), refracts, 0, nullptr);
    if (!start) continue;
    ends = ends_of({0, 0, 0}, start->last.p, ends.last(0).dpdt, ends.last_normal(0));
    SpecularChain chain = *start;
    WalkCounts counts;
    if (walk_in_time(matter, ends, 1, 1e-11, chain, &counts) != WalkState::kDone) continue;
    ++done;
    temporal += counts.temporal, spatial += counts.spatial;
    EXPECT_EQ(chain.time, 1);
    EXPECT_LT(length(chain.last.p - ends.last(1).p), 1e-11);
    EXPECT_LT(off_manifold(chain), 1e-9);
    ASSERT_EQ(walk_in_time(matter, ends, 0, 1e-11, chain), WalkState::kDone);
    EXPECT_LT(length(chain.vertices[0].specular.surface.p - start->vertices[0].specular.surface.p), 1e-8);
  }
  EXPECT_GE(done, 0.98 * kPaths);
  EXPECT_LT(temporal, 1.6 * done);
  EXPECT_LT(spatial, 6 * done);
}

// The rate that the linear system tells is that of the walk.
TEST(TemporalWalk, FollowsItsTimeDerivative) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0.2, 0}, ball.velocity = {0.2, -0.5, 0.4}, ball.spin = 1.1, ball.eta = 1.4;
  const ChainEnds wall = ends_of({0, 0, 0}, {7, 0, 0}, {}, {-1, 0, 0});
  const auto traced =
      trace_chain(matter, wall.first(0), {3.1, 0.4, 0.2}, wall.last(0), {-1, 0, 0}, {true, true}, 0, nullptr);
  ASSERT_TRUE(traced);
  const SpecularChain& start = *traced;
  const ChainEnds ends = ends_of({0, 0, 0}, start.last.p, {0.1, 0.3, -0.6}, {-1, 0, 0});
  const std::vector<SpecularVertex> vertices{start.vertices[0].specular, start.vertices[1].specular};
  const SpecularSystem system(start.first, vertices, ends.last(0));
  ASSERT_FALSE(system.singular());
  const std::vector<Vec2d> rate = system.solve({}, {}, 1);
  constexpr double kStep = 2e-5;
  SpecularChain later = start, earlier = start;
  ASSERT_EQ(walk_in_time(matter, ends, kStep, 1e-13, later), WalkState::kDone);
  ASSERT_EQ(walk_in_time(matter, ends, -kStep, 1e-13, earlier), WalkState::kDone);
  for (std::size_t i = 0; i < 2; ++i) {
    const Vec2d measured{(later.vertices[i].at.u - earlier.vertices[i].at.u) * (0.5 / kStep),
                         (later.vertices[i].at.v - earlier.vertices[i].at.v) * (0.5 / kStep)};
    EXPECT_LT(length(measured - rate[i]), 1e-5 * (1 + length(measured))) << i;
  }
}

}  // namespace
}  // namespace tempera::test
