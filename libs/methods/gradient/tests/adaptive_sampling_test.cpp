// SPDX-License-Identifier: Apache-2.0
#include "../adaptive_sampling.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

namespace tempera {
namespace {

using Mode = AdaptiveOptions::Mode;

AdaptiveOptions options(Mode mode, int batches = 4) {
  AdaptiveOptions o;
  o.mode = mode;
  o.batches = batches;
  return o;
}
double mean(const std::vector<int>& counts) {
  return std::accumulate(counts.begin(), counts.end(), 0.0) / double(counts.size());
}

TEST(AdaptiveSampling, BatchesUseUpTheSamples) {
  for (int spp = 8; spp < 70; ++spp) {
    const BatchPlan p = plan_batches(options(Mode::kPublished), spp);
    EXPECT_EQ(p.first + (p.count - 1) * p.later, spp);
    EXPECT_GE(p.later, 4);
    EXPECT_LE(p.count, 4);
    const BatchPlan u = plan_batches(options(Mode::kUnbiased), spp);
    EXPECT_EQ(u.first + u.later, spp);
    EXPECT_FALSE(u.keep_first);
  }
  EXPECT_EQ(plan_batches(options(Mode::kOff), 5).first, 5);
  EXPECT_EQ(plan_batches(options(Mode::kOff), 5).count, 1);
  EXPECT_THROW(plan_batches(options(Mode::kPublished), 7), Error);
}

TEST(AdaptiveSampling, NoiseGetsSamples) {
  const int w = 64, h = 48;
  std::vector<PixelNoise> noise(w * h, {1e-5f, 1, 8});
  for (int y = 10; y < 20; ++y) {
    for (int x = 0; x < 12; ++x) noise[y * w + x].variance = 1e-2f;  // up to the left border
  }
  noise[30 * w + 40].variance = 1;  // one wild estimate: the median leaves it out
  noise[40 * w + 40].variance = std::numeric_limits<float>::quiet_NaN();
  const std::vector<int> counts = next_batch(options(Mode::kPublished), noise, w, h, 8, 1);
  EXPECT_NEAR(mean(counts), 8, 0.1) << "what is clamped away is given to all";
  EXPECT_GE(*std::min_element(counts.begin(), counts.end()), 2);
  EXPECT_LE(*std::max_element(counts.begin(), counts.end()), 8 * 8 + 8);
  EXPECT_GT(counts[15 * w + 5], 20);
  EXPECT_GT(counts[15 * w], 20) << "borders count as much as the middle";
  EXPECT_LT(counts[30 * w + 40], 8);
  EXPECT_LT(counts[40 * w + 40], 8);
}

TEST(AdaptiveSampling, BrightnessForgivesNoise) {
  const int w = 40, h = 20;
  std::vector<PixelNoise> noise(w * h);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) noise[y * w + x] = {1e-3f, x < w / 2 ? 0.5f : 2.0f, 8};
  }
  const auto ratio = [&](bool by_luminance) {
    AdaptiveOptions o = options(Mode::kPublished);
    o.by_luminance = by_luminance;
    const std::vector<int> counts = next_batch(o, noise, w, h, 1002, 1);
    return double(counts[10 * w + 5] - 2) / double(counts[10 * w + 34] - 2);
  };
  EXPECT_NEAR(ratio(false), 16, 0.3);
  EXPECT_NEAR(ratio(true), 4, 0.1);
}

TEST(AdaptiveSampling, NothingKnownIsUniform) {
  const std::vector<int> counts = next_batch(options(Mode::kPublished), std::vector<PixelNoise>(100), 10, 10, 5, 1);
  EXPECT_EQ(counts, std::vector<int>(100, 5));
}

}  // namespace
}  // namespace tempera
