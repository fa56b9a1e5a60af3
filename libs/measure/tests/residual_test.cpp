// SPDX-License-Identifier: Apache-2.0
#include "../src/residual.h"

#include <cmath>
#include <functional>
#include <numeric>

#include "sequences.h"

namespace tempera {
namespace {

using namespace test;

/// The spectrum of a residual e(t, x, y), on top of a reference that changes, by the same steps as a comparison.
ResidualSpectrum spectrum(int frames, int w, int h, const std::function<float(int t, int x, int y)>& e,
                          int stride = 1) {
  const Segments plan = plan_segments(frames);
  const auto choice = std::make_shared<const PixelChoice>(w, h, stride);
  PowerSums sums;
  for (const int start : plan.starts) {
    SegmentRecord<float> record(plan, choice);
    for (int t = start; t < start + plan.length; ++t) {
      Image reference(w, h, 1), test(w, h, 1);
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          reference.at(x, y) = 1 + 0.5f * float((x + y + t) % 3);
          test.at(x, y) = reference.at(x, y) + e(t, x, y);
        }
      }
      EXPECT_FALSE(record.full());
      record.add(test, reference, nullptr);
    }
    EXPECT_TRUE(record.full());
    record.add_to(sums);
  }
  return spectrum_of("flicker", plan, sums, choice->coverage);
}

double total(const ResidualSpectrum& s) { return std::accumulate(s.power.begin(), s.power.end(), 0.0); }

TEST(Segments, CoverAllFramesAndOverlapByHalf) {
  EXPECT_TRUE(plan_segments(7).starts.empty());
  for (int frames = 8; frames < 400; ++frames) {
    const Segments s = plan_segments(frames);
    ASSERT_FALSE(s.starts.empty()) << frames;
    EXPECT_LE(s.length, kMaxSegmentFrames);
    EXPECT_EQ(s.starts.front(), 0);
    EXPECT_EQ(s.starts.back() + s.length, frames);
    EXPECT_GE(s.length, std::min(frames, 43)) << "not much shorter than they could be";
    EXPECT_TRUE(frames > kMaxSegmentFrames || s.length == frames);
    for (std::size_t i = 1; i < s.starts.size(); ++i) {
      EXPECT_NEAR(s.starts[i] - s.starts[i - 1], s.length / 2.0, 1) << frames;
    }
  }
}

// The values of scipy.signal.periodogram, see tools/metric_constants.py.
TEST(Spectrum, AgreesWithSciPy) {
  const ResidualSpectrum s = spectrum(
      20, 5, 3, [](int t, int, int) { return float(0.5 + 0.2 * t + std::sin(1.1 * t) + 0.3 * std::cos(2.9 * t)); });
  ASSERT_EQ(s.power.size(), 11u);
  EXPECT_NEAR(s.power[0], 3.81751818, 2e-5);
  EXPECT_NEAR(s.power[1], 2.269532073, 2e-5);
  EXPECT_NEAR(s.power[3], 0.2557593262, 2e-6);
  EXPECT_NEAR(s.power[7], 8.182930707e-06, 2e-7);
  EXPECT_NEAR(s.power[9], 0.02840507738, 1e-6);
  EXPECT_NEAR(s.power[10], 0.011566011, 1e-6);
  EXPECT_EQ(s.frequency[10], 0.5);
  EXPECT_EQ(s.segment_frames, 20);
  EXPECT_EQ(s.segments, 1);
}

TEST(Spectrum, OfASinusoidIsHalfItsSquareAtItsFrequency) {
  const int frames = 32, k = 11;
  const ResidualSpectrum s = spectrum(frames, 9, 7, [](int t, int x, int y) {
    return 0.3f * std::sin(6.2831853f * k * float(t) / frames + float(x * y));
  });
  EXPECT_NEAR(total(s), 0.045, 0.001);
  EXPECT_NEAR(s.power[k] + s.power[k - 1] + s.power[k + 1], total(s), 1e-8) << "the window spreads to the neighbours";
  EXPECT_NEAR(power_above(s, 0.25), total(s), 1e-8);
  EXPECT_NEAR(power_above(s, 0.4), 0, 1e-8);
  EXPECT_NEAR(power_above(s, double(k) / frames), s.power[k + 1], 1e-8) << "above the cutoff, not at it";
}

TEST(Spectrum, AlternationIsAllFlickerAndAConstantErrorNone) {
  const ResidualSpectrum alternating = spectrum(24, 4, 4, [](int t, int, int) { return t % 2 ? 0.1f : -0.1f; });
  EXPECT_NEAR(power_above(alternating, 0.25), 0.01, 1e-6);
  const ResidualSpectrum constant = spectrum(24, 4, 4, [](int, int, int) { return 0.1f; });
  EXPECT_NEAR(total(constant), 0.01, 1e-6);
  EXPECT_NEAR(power_above(constant, 0.25), 0, 1e-9);
  EXPECT_NEAR(total(spectrum(24, 4, 4, [](int, int, int) { return 0.0f; })), 0, 1e-12);
}

// White noise has the same power at all frequencies, however many segments it is cut into.
TEST(Spectrum, OfWhiteNoiseIsFlatAndAddsUpToItsVariance) {
  for (const int frames : {16, 47, 160}) {
    const ResidualSpectrum s = spectrum(frames, 40, 30, [](int t, int x, int y) { return 0.2f * normal(x, y, t, 5); });
    EXPECT_NEAR(total(s), 0.04, 0.001) << frames;
    const double each = 0.04 / s.segment_frames;
    for (std::size_t k = 0; k < s.power.size(); ++k) {
      const bool both_signs = k > 0 && int(2 * k) != s.segment_frames;
      EXPECT_NEAR(s.power[k] / (each * (both_signs ? 2 : 1)), 1, 0.15) << frames << " " << k;
    }
  }
}

TEST(Spectrum, PixelsThatAreNotFiniteDropOut) {
  const auto noise = [](int t, int x, int y) { return 0.2f * normal(x, y, t, 5); };
  const Segments plan = plan_segments(16);
  const auto choice = std::make_shared<const PixelChoice>(16, 4, 1);
  PowerSums half, all;
  SegmentRecord<float> with(plan, choice), without(plan, choice);
  for (int t = 0; t < 16; ++t) {
    const Image reference(16, 4, 1);
    Image test(16, 4, 1);
    for (int y = 0; y < 4; ++y) {
      for (int x = 0; x < 16; ++x) test.at(x, y) = x < 8 ? noise(t, x, y) : 0;
    }
    without.add(test, reference, nullptr);
    if (t == 5) {
      for (int y = 0; y < 4; ++y) {
        for (int x = 8; x < 16; ++x) test.at(x, y) = std::nanf("");
      }
    }
    with.add(test, reference, nullptr);
  }
  with.add_to(half), without.add_to(all);
  EXPECT_EQ(half.pixels, 32);
  EXPECT_EQ(all.pixels, 64);
  for (std::size_t k = 0; k < all.power.size(); ++k) EXPECT_EQ(half.power[k], all.power[k]);
}

TEST(Spectrum, AFewPixelsStandForAll) {
  const PixelChoice choice(1000, 600, 5);
  EXPECT_EQ(choice.pixels.size(), 24000u);
  EXPECT_NEAR(choice.coverage, 0.04, 1e-12);
  int columns[5] = {};
  for (const PixelChoice::Pixel& p : choice.pixels) {
    ASSERT_TRUE(p.x >= 0 && p.y >= 0 && p.x < 1000 && p.y < 600);
    ++columns[p.x % 5];
  }
  for (const int n : columns) EXPECT_NEAR(n, 4800, 250) << "pictures of period 5 do not fool it";
  const PixelChoice uneven(11, 7, 4);
  for (const PixelChoice::Pixel& p : uneven.pixels) EXPECT_TRUE(p.x < 11 && p.y < 7);
  const ResidualSpectrum s = spectrum(
      16, 160, 120, [](int t, int x, int y) { return 0.2f * normal(x, y, t, 5); }, 4);
  EXPECT_NEAR(total(s), 0.04, 0.003);
  EXPECT_NEAR(s.coverage, 1 / 16.0, 1e-12);
}

// A residual that sticks to a surface moving 1.5 pixels a frame: seen from a pixel it flickers, along its track not.
TEST(Tracks, FollowASurfaceUntilItIsLost) {
  const int w = 64, h = 4, frames = 16;
  const PixelChoice choice(w, h, 1);
  Image forward(w, h, 4), backward(w, h, 4);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      forward.at(x, y, 0) = 1.5f, forward.at(x, y, 3) = 1;
      backward.at(x, y, 0) = -1.5f, backward.at(x, y, 3) = 1;
    }
  }
  Tracks tracks(choice);
  for (int t = 1; t < frames; ++t) tracks.advance(forward, &backward);
  int alive = 0;
  for (std::size_t i = 0; i < choice.pixels.size(); ++i) {
    const Vec2f p = tracks.positions()[i];
    if (std::isnan(p.x)) continue;
    ++alive;
    EXPECT_EQ(p, Vec2f(float(choice.pixels[i].x) + 0.5f + 1.5f * (frames - 1), float(choice.pixels[i].y) + 0.5f));
  }
  EXPECT_EQ(alive, 41 * h) << "15 frames of 1.5 pixels: what began left of 41 is still inside";
  // Where the way back leads elsewhere, the surface was covered.
  for (int y = 0; y < h; ++y) backward.at(10, y, 0) = 4;
  Tracks covered(choice);
  covered.advance(forward, &backward);
  EXPECT_TRUE(std::isnan(covered.positions()[8].x)) << "leads to 10, where nothing came from 8.5";
  EXPECT_FALSE(std::isnan(covered.positions()[20].x));
  covered.advance(Image(), nullptr);
  EXPECT_TRUE(std::isnan(covered.positions()[20].x)) << "there are no vectors to follow";
}

TEST(Tracks, ResidualsAreLookedUpAtTheNearestPixel) {
  const Segments plan = plan_segments(8);
  const auto choice = std::make_shared<const PixelChoice>(32, 2, 1);
  PowerSums along, in_place;
  SegmentRecord<float> tracked(plan, choice), fixed(plan, choice);
  std::vector<Vec2f> positions;
  for (const PixelChoice::Pixel& p : choice->pixels) positions.push_back({float(p.x) + 0.5f, float(p.y) + 0.5f});
  for (int t = 0; t < 8; ++t) {
    Image test(32, 2, 1);
    const Image reference(32, 2, 1);
    for (int y = 0; y < 2; ++y) {
      for (int x = 0; x < 32; ++x) test.at(x, y) = 0.2f * normal(x - 2 * t, y, 0, 1);  // glued to what moves
    }
    std::vector<Vec2f> moved = positions;
    for (Vec2f& p : moved) {
      p.x += 2 * float(t) + 0.4f;  // 0.4 pixels beside it: the pixel is the same
      if (p.x >= 32) p = {std::nanf(""), 0};
    }
    tracked.add(test, reference, &moved);
    fixed.add(test, reference, nullptr);
  }
  tracked.add_to(along), fixed.add_to(in_place);
  const ResidualSpectrum a = spectrum_of("flicker_tracked", plan, along, 1),
                         b = spectrum_of("flicker", plan, in_place, 1);
  EXPECT_EQ(along.pixels, 2 * (32 - 14));
  EXPECT_NEAR(power_above(a, 0.25), 0, 1e-9);
  EXPECT_GT(power_above(b, 0.25), 0.005);
}

}  // namespace
}  // namespace tempera
