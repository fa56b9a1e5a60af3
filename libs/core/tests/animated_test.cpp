// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/animated.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

// Files hold key times as float32; frames are computed in double.
TEST(Animated, StepKeysTakeEffectInTheirFrameAtAnyRate) {
  for (const double fps : {12.0, 15.0, 23.976, 24.0, 25.0, 29.97, 30.0, 48.0, 50.0, 60.0, 120.0}) {
    for (int frame = 1; frame < 3000; ++frame) {
      const double key = double(float(frame / fps));
      const Animated<float> a({0, key}, {1, 2}, Interpolation::kStep);
      ASSERT_EQ(a.at(frame / fps), 2) << frame << " at " << fps;
      ASSERT_EQ(a.at((frame - 0.01) / fps), 1) << frame << " at " << fps;
    }
  }
}

TEST(Animated, TwoKeysAtOneTimeAreAJump) {
  const Animated<float> a({0, 1, 1, 2}, {0, 10, 50, 60}, Interpolation::kLinear);
  EXPECT_FLOAT_EQ(a.at(0.5), 5);
  EXPECT_NEAR(a.at(0.9999), 9.999, 1e-3);
  EXPECT_FLOAT_EQ(a.at(1), 50);
  EXPECT_FLOAT_EQ(a.at(1.5), 55);
  std::vector<double> jumps;
  a.jumps({0, 2}, jumps);
  ASSERT_EQ(jumps.size(), 1u);
  EXPECT_NEAR(jumps[0], 1, 1e-5);
}

TEST(Animated, APieceGoesOnBeyondItsJumpsAndStopsAtTheOuterKeys) {
  const Animated<float> a({0, 1, 1, 2}, {0, 10, 50, 60}, Interpolation::kLinear);
  EXPECT_FLOAT_EQ(a.at(1.2, 0.5), 12);
  EXPECT_FLOAT_EQ(a.at(0.8, 1.5), 48);
  EXPECT_FLOAT_EQ(a.at(-1, 0.5), 0);
  EXPECT_FLOAT_EQ(a.at(3, 1.5), 60);
  const Animated<float> s({0, 1, 2}, {1, 2, 3}, Interpolation::kStep);
  EXPECT_EQ(s.at(5, 0.5), 1);
  EXPECT_EQ(s.at(0, 1.5), 2);
  // A Hermite segment goes on as the polynomial that it is: here t^2.
  const Animated<float> c({0, 1, 1, 2}, {0, 0, 0, 2, 1, 2, 0, 7, 0, 0, 7, 0}, Interpolation::kCubic);
  EXPECT_NEAR(c.at(0.5), 0.25, 1e-6);
  EXPECT_NEAR(c.at(1.5, 0.5), 2.25, 1e-5);
  EXPECT_FLOAT_EQ(c.at(1.5), 7);
}

TEST(Animated, AProductHasTheJumpsOfBothAndNothingBetween) {
  const Animated<Rgb> color({0, 1, 2}, {Rgb(1.0f), Rgb(2.0f), Rgb(8.0f)}, Interpolation::kStep);
  const Animated<float> ramp({0, 1.5, 1.5, 3}, {1, 4, 10, 13}, Interpolation::kLinear);
  const Animated<Rgb> p = product(color, ramp);
  for (const double t : {0.0, 0.5, 0.999, 1.0, 1.25, 1.4999, 1.5, 1.75, 1.9999, 2.0, 2.5, 3.0, 4.0})
    EXPECT_NEAR(p.at(t).r, color.at(t).r * ramp.at(t), 1e-5 * p.at(t).r) << t;
  std::vector<double> jumps;
  p.jumps({0, 4}, jumps);
  ASSERT_EQ(jumps.size(), 3u);
  EXPECT_NEAR(jumps[0], 1, 1e-5);
  EXPECT_NEAR(jumps[1], 1.5, 1e-5);
  EXPECT_NEAR(jumps[2], 2, 1e-5);
}

TEST(Animated, AProductOfTwoRampsIsNearTheirSquare) {
  const Animated<float> ramp({0, 2}, {0, 2}, Interpolation::kLinear);
  const Animated<float> square = product(ramp, ramp);
  for (double t = 0; t <= 2; t += 0.01) EXPECT_NEAR(square.at(t), t * t, 0.25 / 64 + 1e-6) << t;
}

TEST(Animated, StepKeysWithOneValueDoNotJump) {
  const Animated<float> a({0, 1, 2, 3}, {1, 1, 2, 2}, Interpolation::kStep);
  std::vector<double> jumps;
  a.jumps({0, 4}, jumps);
  ASSERT_EQ(jumps.size(), 1u);
  EXPECT_NEAR(jumps[0], 2, 1e-5);
}

}  // namespace
}  // namespace tempera
