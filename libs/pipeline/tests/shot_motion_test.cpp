// SPDX-License-Identifier: Apache-2.0
#include "../src/shot_motion.h"

#include <gtest/gtest.h>

#include "tempera/paths/camera_model.h"

namespace tempera {
namespace {

/// A quad in front of a camera, both on nodes of their own (0 and 1), at 24 frames a second.
struct Stage {
  Scene scene;
  RenderSettings settings;
  Stage() {
    scene.nodes.resize(2);
    scene.nodes[1].local = Affine3d(look_at(Vec3d{0, 0, 10}, Vec3d{0, 0, 0}, Vec3d{0, 1, 0}));
    scene.shapes.push_back({make_rectangle(), make_black(), std::nullopt, "", ""});
    scene.groups = {{0}};
    scene.instances.push_back({0, 0, "", true});
    scene.cameras.emplace_back();
    scene.cameras[0].name = "eye";
    scene.cameras[0].node = 1;
    scene.animation = {0, 1};
    settings.width = 1000, settings.height = 500;
    settings.clock.shutter = {.open = 0, .close = 1};
  }
  /// Keys at each frame from 0 to 24.
  static AnimatedTransform baked(const std::function<Vec3d(int)>& place, Interpolation how = Interpolation::kLinear) {
    AnimatedTransform t;
    t.keyed = true;
    std::vector<double> times;
    std::vector<Vec3d> places;
    for (int f = 0; f <= 24; ++f) times.push_back(double(float(f / 24.0))), places.push_back(place(f));
    t.translation = {times, places, how};
    return t;
  }
};

TEST(Cuts, JumpsOfTheCameraAreFound) {
  for (const Interpolation how : {Interpolation::kStep, Interpolation::kLinear}) {
    Stage s;
    s.scene.nodes[1].local = Stage::baked(
        [](int f) {
          return f < 8 ? Vec3d{0.01 * f, 0, 10} : Vec3d{50, 0.02 * f, 9};
        },
        how);
    EXPECT_EQ(find_cuts(s.scene, s.settings, {}),
              how == Interpolation::kStep ? std::vector<int>{8} : std::vector<int>{});
    EXPECT_EQ(find_cuts(s.scene, s.settings, {8}), std::vector<int>{8});
  }
}

TEST(Cuts, ACameraThatIsAnimatedInStepsIsNotCut) {
  Stage s;
  s.scene.nodes[1].local = Stage::baked([](int f) { return Vec3d{double(f / 2), 0, 10}; }, Interpolation::kStep);
  EXPECT_TRUE(find_cuts(s.scene, s.settings, {}).empty());
}

// Exporters bake a cut as two keys a frame apart.
TEST(Cuts, DeclaredOnesEndTheFlight) {
  Stage s;
  s.scene.nodes[1].local = Stage::baked([](int f) {
    return f < 8 ? Vec3d{0.1 * f, 0, 10} : Vec3d{50 + 0.1 * f, 0, 10};
  });
  s.scene.nodes[0].local = Stage::baked([](int f) { return Vec3d{0.2 * f, 0, 0}; });  // goes on
  cut_motion(s.scene, s.settings.clock, {8});
  const auto x = [&](int node, double frame) { return s.scene.world(node, frame / 24).translation.x; };
  EXPECT_NEAR(x(1, 7.25), 0.725, 1e-4);
  EXPECT_NEAR(x(1, 7.99), 0.799, 1e-4);
  EXPECT_NEAR(x(1, 8), 50.8, 1e-4);
  EXPECT_NEAR(x(1, 8.5), 50.85, 1e-4);
  for (double f = 0; f < 24; f += 0.25) EXPECT_NEAR(x(0, f), 0.2 * f, 1e-5) << f;
  // A cut of what the camera sees goes with it.
  s.scene.nodes[0].local = Stage::baked([](int f) { return Vec3d{f < 8 ? 0.0 : 30.0, 0, 0}; });
  cut_motion(s.scene, s.settings.clock, {8});
  EXPECT_NEAR(x(0, 7.9), 0, 1e-6);
  EXPECT_NEAR(x(0, 8), 30, 1e-6);
}

TEST(Cuts, CubicKeysAreCutLikeLinearOnes) {
  Stage s;
  AnimatedTransform t;
  t.keyed = true;
  std::vector<double> times;
  std::vector<Vec3d> values;
  for (int f = 0; f <= 24; ++f) {
    times.push_back(f / 24.0);
    const Vec3d slope{f == 7 || f == 8 ? 500.0 : 2.4, 0, 0}, even{2.4, 0, 0};  // per second
    values.insert(values.end(),
                  {f == 8 ? slope : even, Vec3d{f < 8 ? 0.1 * f : 50 + 0.1 * f, 0, 10}, f == 7 ? slope : even});
  }
  t.translation = {times, values, Interpolation::kCubic};
  s.scene.nodes[1].local = t;
  cut_motion(s.scene, s.settings.clock, {8});
  for (double f = 0; f < 8; f += 0.24) EXPECT_NEAR(s.scene.world(1, f / 24).translation.x, 0.1 * f, 1e-6) << f;
  for (double f = 8; f < 24; f += 0.24) EXPECT_NEAR(s.scene.world(1, f / 24).translation.x, 50 + 0.1 * f, 1e-6) << f;
}

TEST(MotionSegments, AreAsManyAsTheMotionNeeds) {
  const auto rotor = [](double degrees_a_frame, double squash) {
    Stage s;
    AnimatedTransform t;
    t.keyed = true;
    std::vector<double> times;
    std::vector<Quatd> turns;
    for (int i = 0; i <= 24 * 32; ++i) {
      times.push_back(i / (24.0 * 32));
      turns.push_back(axis_angle(Vec3d{0, 0, 1}, degrees_a_frame * kPiD / 180 * i / 32));
    }
    t.rotation = {times, turns, Interpolation::kLinear};
    s.scene.nodes[0].local = Affine3d(scale(Vec3d{1, squash, 1}));
    s.scene.nodes.push_back({0, t, "", 1.0f});
    s.scene.instances[0].node = 2;
    return s;
  };
  const Stage even = rotor(20, 1), squashed = rotor(90, 0.3), fast = rotor(720, 1);
  EXPECT_EQ(settle_motion_segments(even.scene, even.settings, std::nullopt), 4);
  const int n = settle_motion_segments(squashed.scene, squashed.settings, std::nullopt);
  EXPECT_GT(n, 4);
  EXPECT_LE(n, 64);
  EXPECT_GE(settle_motion_segments(fast.scene, fast.settings, std::nullopt), 8);
  EXPECT_EQ(settle_motion_segments(squashed.scene, squashed.settings, 3), 3);
  // An instant shows no motion.
  Stage instant = squashed;
  instant.settings.clock.shutter.close = 0;
  EXPECT_EQ(settle_motion_segments(instant.scene, instant.settings, std::nullopt), 4);
}

TEST(MotionSegments, FastCamerasCountToo) {
  Stage s;
  AnimatedTransform t;
  t.keyed = true;
  std::vector<double> times;
  std::vector<Quatd> turns;
  for (int i = 0; i <= 24 * 16; ++i) {  // round an axis that is not the picture's: no slerp of four poses
    times.push_back(i / (24.0 * 16));
    turns.push_back(axis_angle(Vec3d{0, 1, 0}, 0.3 * std::sin(0.9 * i)));
  }
  t.rotation = {times, turns, Interpolation::kLinear};
  t.translation = Vec3d{0, 0, -10};
  s.scene.nodes[1].local = t;
  EXPECT_GE(settle_motion_segments(s.scene, s.settings, std::nullopt), 16);
}

}  // namespace
}  // namespace tempera
