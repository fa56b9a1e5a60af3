// SPDX-License-Identifier: Apache-2.0
// Time without frames: the pieces of a section.
#include "tempera/transport/scene_timeline.h"

#include "tempera/transport/scene_window.h"
#include "test_shot.h"

namespace tempera {
namespace {

constexpr double kStep = 1.0 / 64;

/// Ten frames of a square that turns and moves, and a smaller one before it that goes at 2.3 s and comes at 7.25 s.
TestShot moving() {
  TestShot shot;
  shot.orthographic(1);
  shot.settings.clock.shutter = {.open = 0, .close = 0.5};
  AnimatedTransform turn;
  turn.keyed = true;
  turn.rotation = {{0, 10}, {axis_angle(Vec3d{0, 0, 1}, 0.0), axis_angle(Vec3d{0, 0, 1}, 3.0)}, Interpolation::kLinear};
  turn.translation = {{0, 10}, {Vec3d{-0.3, 0, 0}, Vec3d{0.3, 0.2, -1}}, Interpolation::kLinear};
  shot.add(make_rectangle(), make_diffuse(0.5f), shot.node(turn));
  const int near = shot.node(Affine3d(translate(Vec3d{0, 0, 1}) * scale(Vec3d{0.25, 0.25, 1})));
  shot.scene.nodes[near].visibility = {{0, 2.3, 7.25}, {1, 0, 1}, Interpolation::kStep};
  shot.add(make_rectangle(), make_diffuse(0.5f), near);
  return shot;
}

TEST(SceneTimeline, PiecesAreCutAtJumpsAndHoldFewSegments) {
  const TestShot shot = moving();
  const std::vector<TimeSpan> pieces = timeline_pieces(shot.scene, {0, 9.5}, kStep);
  EXPECT_EQ(pieces.front().begin, 0);
  EXPECT_EQ(pieces.back().end, 9.5);
  std::vector<double> cuts;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    EXPECT_LT(pieces[i].begin, pieces[i].end);
    EXPECT_LE(pieces[i].length(), 126 * kStep);
    if (i > 0) {
      EXPECT_EQ(pieces[i].begin, pieces[i - 1].end);
      cuts.push_back(pieces[i].begin);
    }
  }
  for (const double jump : {2.3, 7.25}) {
    EXPECT_EQ(std::count_if(cuts.begin(), cuts.end(), [&](double c) { return std::abs(c - jump) < 1e-5; }), 1) << jump;
  }
  EXPECT_LE(pieces.size(), 10u) << "608 segments between two jumps: no more pieces than need be";
  EXPECT_EQ(timeline_pieces(shot.scene, {3, 3}, kStep).size(), 1u) << "a moment";
}

// Rays and points are those of the frames, to the bit, and between shutters there is something, too.
TEST(SceneTimeline, AgreesWithTheFrames) {
  const TestShot shot = moving();
  GeometryCache cache;
  const LightPathClassifier classifier;
  SceneWindow window(shot.scene, shot.settings, classifier, kStep, cache, {0, 9});
  const SceneTimeline& timeline = window.timeline();
  EXPECT_EQ(&timeline, &window.timeline());
  EXPECT_EQ(timeline.span().end, 9.5);
  int near = 0, far = 0;
  for (int i = 0; i < 950; ++i) {
    const double t = i / 100.0;
    const Ray ray{{0.1f, -0.05f, 5}, {0, 0, -1}, 0, kInfinity, t};
    const RayScene& rays = timeline.at(t).rays;
    const auto hit = rays.intersect(ray);
    ASSERT_TRUE(hit) << t;
    const bool gone = t >= 2.3 && t < 7.25;
    if (std::abs(t - 2.3) > 1e-4 && std::abs(t - 7.25) > 1e-4) {
      EXPECT_EQ(hit->point.instance, gone ? 0u : 1u) << t;
    }
    ++(hit->point.instance == 0 ? far : near);
    const int frame = int(t);
    if (t - frame > 0.5) continue;
    const RayScene& of_frame = window.frame(frame).at(t).rays;
    const auto same = of_frame.intersect(ray);
    ASSERT_TRUE(same);
    EXPECT_EQ(hit->point.instance, same->point.instance) << t;
    for (const double other : {t, t + 0.4}) {
      const Vec3f a = rays.position(hit->point, other), b = of_frame.position(same->point, other);
      EXPECT_NEAR(length(a - b), 0, 1e-6f) << t;
    }
  }
  EXPECT_GT(near, 300);
  EXPECT_GT(far, 300);
}

}  // namespace
}  // namespace tempera
