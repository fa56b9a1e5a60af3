// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "sequences.h"
#include "tempera/core/parallel.h"
#include "tempera/measure/metrics.h"

namespace tempera {
namespace {

using namespace test;

TEST(PreviousPositions, FollowVectorsInsideOfThePicture) {
  const Image p = previous_positions(vectors(8, 4, -2.25f, 1));
  EXPECT_EQ(p.vec2(5, 1), Vec2f(5.5f - 2.25f, 2.5f));
  EXPECT_TRUE(std::isnan(p.at(1, 1))) << "came in from the left";
  EXPECT_FALSE(std::isnan(p.at(2, 1))) << "0.25 is inside";
  EXPECT_TRUE(std::isnan(p.at(5, 3))) << "came in from below";
  EXPECT_EQ(previous_positions(vectors(3, 3, 0, 0)).vec2(2, 2), Vec2f(2.5f, 2.5f));
}

TEST(PreviousPositions, InvalidVectorsLeadNowhere) {
  Image backward = vectors(8, 4, 0, 0);
  backward.at(3, 2, 3) = 0;
  const Image p = previous_positions(backward);
  EXPECT_TRUE(std::isnan(p.at(3, 2)));
  EXPECT_EQ(p.vec2(4, 2), Vec2f(4.5f, 2.5f));
  const Image two = filled(4, 4, 2, [](int, int, int) { return 0.0f; });  // without a validity channel
  EXPECT_EQ(previous_positions(two).vec2(3, 3), Vec2f(3.5f, 3.5f));
  backward.at(5, 1, 0) = std::nanf("");
  EXPECT_TRUE(std::isnan(previous_positions(backward).at(5, 1)));
}

// A card of 4 pixels moves 3 to the right over a background that stands still. What it uncovers was hidden behind it:
// the background's vectors are 0 there, and lead to pixels that moved away.
TEST(PreviousPositions, UncoveredSurfacesComeFromNowhere) {
  const int w = 20, h = 3;
  const auto on_card = [](int x, int frame) { return x >= 5 + 3 * frame && x < 9 + 3 * frame; };
  Image forward = vectors(w, h, 0, 0), backward = vectors(w, h, 0, 0);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (on_card(x, 0)) forward.at(x, y, 0) = 3;
      if (on_card(x, 1)) backward.at(x, y, 0) = -3;
    }
  }
  const Image without = previous_positions(backward), with = previous_positions(backward, &forward);
  for (int x = 0; x < w; ++x) {
    EXPECT_FALSE(std::isnan(without.at(x, 1))) << x;
    const bool uncovered = on_card(x, 0) && !on_card(x, 1);
    EXPECT_EQ(std::isnan(with.at(x, 1)), uncovered) << x;
  }
  EXPECT_EQ(with.vec2(9, 1), Vec2f(6.5f, 1.5f)) << "the card was followed";
}

TEST(PreviousPositions, TheWayBackMayMissByARootOfAHalf) {
  const Image backward = vectors(16, 4, 0, 0);
  const auto kept = [&](float dx) {
    const Image forward = vectors(16, 4, dx, 0);
    return !std::isnan(previous_positions(backward, &forward).at(8, 2));
  };
  EXPECT_TRUE(kept(0.70f));
  EXPECT_FALSE(kept(0.72f));
}

TEST(TemporalError, ClosedForms) {
  const auto flat = [](float v) { return Image(6, 5, 3, v); };
  // The test changes by 0.3 more than the reference, which goes from 1 to 2.
  Image map;
  const PixelMean e = temporal_error(flat(2.4f), flat(1.1f), flat(2), flat(1), nullptr, &map);
  EXPECT_NEAR(e.value, 0.09 / (2.5 + 0.01), 1e-7);
  EXPECT_EQ(e.coverage, 1);
  EXPECT_NEAR(map.at(4, 3), e.value, 1e-7);
  EXPECT_NEAR(temporal_error(flat(2.4f), flat(1.1f), flat(2), flat(1), nullptr, nullptr, 0.5).value, 0.09 / 3, 1e-7);
  EXPECT_NEAR(temporal_error(flat(1.5f), flat(0.5f), flat(2), flat(1)).value, 0, 1e-12)
      << "an error that stays does not flicker";
  EXPECT_NEAR(temporal_error(flat(1.1f), flat(2.4f), flat(1), flat(2)).value, e.value, 1e-12) << "backwards as well";
}

TEST(TemporalError, IndependentNoiseGivesTwiceTheRelativeError) {
  const int w = 200, h = 200;
  const float sigma = 0.1f;
  const auto reference = [&](int frame) {
    return filled(w, h, 3,
                  [=](int x, int y, int) { return (x + 5 * frame) / 20 % 2 ? 4.0f : 0.5f + 0.001f * float(y); });
  };
  const auto noisy = [&](const Image& r, int key) {
    return filled(w, h, 3,
                  [&, key](int x, int y, int c) { return r.at(x, y, c) * (1 + sigma * normal(x, y, c, key)); });
  };
  const Image r0 = reference(0), r1 = reference(1), t0 = noisy(r0, 1), t1 = noisy(r1, 2);
  const double once = relative_mse(t1, r1);
  EXPECT_NEAR(once, sigma * sigma, 2e-4);
  EXPECT_NEAR(temporal_error(t1, t0, r1, r0).value / once, 2, 0.03);
  EXPECT_LT(temporal_error(noisy(r1, 1), t0, r1, r0).value, 0.6 * 2 * once) << "the same noise in both frames: less";
}

TEST(TemporalError, CompensatedFollowsWhatMoves) {
  const int w = 40, h = 12;
  // Texture, and an error of the test that sticks to it, move by (3, 1) pixels a frame.
  const auto texture = [](float x, float y) { return 1 + 0.5f * std::sin(x) * std::cos(0.7f * y); };
  const auto error = [](float x, float y) { return 0.2f * std::sin(2 * x + y); };
  const auto frame = [&](int t, bool test) {
    return filled(w, h, 3, [=](int x, int y, int) {
      const float u = float(x - 3 * t), v = float(y - t);
      return texture(u, v) + (test ? error(u, v) : 0);
    });
  };
  const Image r0 = frame(0, false), r1 = frame(1, false), t0 = frame(0, true), t1 = frame(1, true);
  const Image right = previous_positions(vectors(w, h, -3, -1));
  const PixelMean compensated = temporal_error(t1, t0, r1, r0, &right);
  EXPECT_NEAR(compensated.value, 0, 1e-10) << "the error does not flicker, it moves";
  EXPECT_NEAR(compensated.coverage, double((w - 3) * (h - 1)) / (w * h), 1e-12);
  EXPECT_GT(temporal_error(t1, t0, r1, r0).value, 0.005) << "seen from one place it flickers";
  EXPECT_NEAR(warp_error(t1, t0, r1, r0, right).value, 0, 1e-10);
  const Image wrong = previous_positions(vectors(w, h, -2, -1));
  EXPECT_GT(temporal_error(t1, t0, r1, r0, &wrong).value, 0.01);
  EXPECT_GT(warp_error(t1, t0, r1, r0, wrong).value, 0.01);
  EXPECT_NEAR(temporal_error(r1, r0, r1, r0, &wrong).value, 0, 1e-12) << "the reference has no error to follow";
  EXPECT_GT(warp_error(r1, r0, r1, r0, wrong).value, 0.01) << "but shows that the vectors are wrong";
}

TEST(TemporalError, BetweenPixelsIsBilinear) {
  const auto ramp = [](float offset) {
    return filled(16, 4, 3, [=](int x, int, int) { return 1 + 0.1f * (float(x) + offset); });
  };
  // A ramp that moves by half a pixel is met exactly between two pixels.
  const Image half = previous_positions(vectors(16, 4, 0.5f, 0));
  Image map;
  warp_error(ramp(0.5f), ramp(0), ramp(0), ramp(0), half, &map);
  for (int x = 0; x < 15; ++x) EXPECT_NEAR(map.at(x, 2), 0, 1e-10) << x;
}

TEST(TemporalError, WhatIsNotFiniteIsLeftOut) {
  Image test(10, 10, 3, 1.0f), before(10, 10, 3, 1.0f), reference(10, 10, 3, 1.0f);
  test.at(1, 2, 1) = std::nanf("");
  before.at(7, 7, 0) = kInfinity;
  const PixelMean e = temporal_error(test, before, reference, reference);
  EXPECT_EQ(e.value, 0);
  EXPECT_EQ(e.coverage, 0.98);
  const PixelMean none = temporal_error(Image(2, 2, 3, kInfinity), Image(2, 2, 3), Image(2, 2, 3), Image(2, 2, 3));
  EXPECT_TRUE(std::isnan(none.value));
  EXPECT_EQ(none.coverage, 0);
}

TEST(TemporalError, SameBitsOnAnyNumberOfThreads) {
  const auto noise = [](int key) {
    return filled(77, 53, 3, [=](int x, int y, int c) { return 1 + 0.2f * normal(x, y, c, key); });
  };
  const Image a = noise(1), b = noise(2), c = noise(3), d = noise(4),
              where = previous_positions(vectors(77, 53, 1.3f, -0.4f));
  double one = 0, seven = 0;
  with_threads(1, [&] { one = temporal_error(a, b, c, d, &where, nullptr, 1e-2, 0.01).value; });
  with_threads(7, [&] { seven = temporal_error(a, b, c, d, &where, nullptr, 1e-2, 0.01).value; });
  EXPECT_EQ(one, seven);
}

TEST(MotionError, MeanDistanceOfValidVectors) {
  Image test = vectors(4, 1, 3, 4), reference = vectors(4, 1, 0, 0);
  EXPECT_EQ(motion_error(test, reference).value, 5);
  test.at(0, 0, 3) = 0;
  reference.at(1, 0, 3) = 0;
  test.at(2, 0, 0) = 0, test.at(2, 0, 1) = 0;
  Image map;
  const PixelMean e = motion_error(test, reference, &map);
  EXPECT_EQ(e.value, 2.5);
  EXPECT_EQ(e.coverage, 0.5);
  EXPECT_EQ(map.at(3, 0), 5);
  EXPECT_EQ(map.at(0, 0), 0);
}

// The difference of two independent normal values has the mean absolute value 2 sigma / sqrt(pi).
TEST(LuminanceChange, OfNoiseIsItsExpectation) {
  const auto gray_noise = [](int key) {
    return filled(400, 300, 1, [=](int x, int y, int) { return 2 + 0.1f * normal(x, y, 0, key); });
  };
  const Image a = gray_noise(1), b = gray_noise(2);
  EXPECT_NEAR(luminance_change(a, b).value, 2 * 0.1 / std::sqrt(M_PI), 4e-4);
  EXPECT_EQ(luminance_change(a, a).value, 0);
  EXPECT_NEAR(luminance_change(Image(3, 3, 3, 0.75f), Image(3, 3, 3, 1.0f)).value, 0.25, 1e-6);
}

}  // namespace
}  // namespace tempera
