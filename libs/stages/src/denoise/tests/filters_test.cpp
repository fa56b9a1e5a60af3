// SPDX-License-Identifier: Apache-2.0
// The filters that the denoiser is made of, on planes alone.
#include <gtest/gtest.h>

#include <cmath>

#include "denoise/denoiser.h"
#include "denoise/nl_means.h"
#include "denoise/residuals.h"
#include "denoise/tests/pictures.h"
#include "denoise/tracks.h"

namespace tempera::denoise {
namespace {

TEST(DenoisePlanes, BoxMeanIsThatOfThePixelsThatAreThere) {
  for (const int radius : {0, 1, 3, 24}) {
    const Planes in = picture(37, 41, 2, [](int x, int y, int c) { return deviate(1, x, y, c); });
    const Planes out = box_mean(in, radius);
    for (const auto& [x, y] : {std::pair{0, 0}, {36, 40}, {5, 20}, {31, 32}}) {
      double sum = 0;
      int count = 0;
      for (int j = std::max(y - radius, 0); j <= std::min(y + radius, 40); ++j) {
        for (int i = std::max(x - radius, 0); i <= std::min(x + radius, 36); ++i, ++count)
          sum += double(in.row(1, j)[i]);
      }
      EXPECT_NEAR(out.row(1, y)[x], sum / count, 1e-6) << radius << ' ' << x << ' ' << y;
    }
  }
}

TEST(DenoisePlanes, PackedValuesKeepTheirSizeAndSign) {
  const Planes in = picture(62, 9, 2, [](int x, int y, int c) {
    return c == 1 ? 0.0f : std::ldexp(1 + float(y) / 9, x - 31) * (x % 2 ? -1.0f : 1.0f);
  });
  const PackedPlanes packed(in);
  EXPECT_FALSE(packed.is_zero());
  const Planes out = packed.planes();
  ASSERT_EQ(out.channels(), 2);
  for (std::size_t i = 0; i < in.values().size(); ++i)
    ASSERT_NEAR(out.values()[i], in.values()[i], std::abs(in.values()[i]) * 0x1p-10f) << i;
  EXPECT_EQ(packed.at(0, 5, 40), out.row(0, 5)[40]);
  EXPECT_EQ(packed.at(1, 5, 40), 0);
  const Planes ends = PackedPlanes(picture(4, 1, 1, [](int x, int, int) {
                        return x == 0 ? 1e-20f : x == 1 ? -1e-20f : x == 2 ? 1e30f : -INFINITY;
                      })).planes();
  EXPECT_EQ(ends.row(0, 0)[0], 0);
  EXPECT_EQ(ends.row(0, 0)[1], 0);
  EXPECT_NEAR(ends.row(0, 0)[2] / 0x1p32f, 1, 1e-3) << "the largest that there is";
  EXPECT_NEAR(ends.row(0, 0)[3] / -0x1p32f, 1, 1e-3);
  EXPECT_TRUE(PackedPlanes(Planes(5, 4, 3)).is_zero());
  EXPECT_EQ(PackedPlanes(Planes(5, 4, 3)).planes().values(), Planes(5, 4, 3).values());
}

TEST(DenoisePlanes, HalvesTellTheVarianceOfTheirMean) {
  const float sigma = 0.3f;
  const auto half = [&](std::uint64_t seed) {
    return picture(64, 64, 3, [&](int x, int y, int c) { return 5 + sigma * deviate(seed, x, y, c); });
  };
  const Planes v = half_variance(half(1), half(2), 3);
  double mean = 0;
  for (const float x : v.values()) mean += double(x) / double(v.values().size());
  // 12288 differences: relative standard deviation sqrt(2 / 12288) = 0.013; four of them
  EXPECT_NEAR(mean, double(sigma * sigma / 2), 0.052 * double(sigma * sigma / 2));
}

TEST(NlMeans, AveragesNoiseAndKeepsEdges) {
  const auto step = [](int x, int) { return x < 35 ? 0.2f : 1.0f; };
  const Noisy n = noisy(70, 40, 0.1f, step);
  const NlMeansFrame frame{&n.a, &n.b, &n.variance, nullptr, nullptr};
  const NlMeansResult r = nl_means(std::span(&frame, 1), {});
  const Planes truth = picture(70, 40, 3, [&](int x, int y, int) { return step(x, y); });
  EXPECT_NEAR(mean_square(n.a, truth), 0.01, 0.001);
  for (const Planes* half : {&r.a, &r.b}) EXPECT_LT(mean_square(*half, truth), 0.01 / 20);
  for (int y = 5; y < 35; ++y) {
    EXPECT_LT(r.a.row(0, y)[33], 0.3f);
    EXPECT_GT(r.a.row(0, y)[36], 0.9f);
  }
}

TEST(NlMeans, WhatHasNoNoiseStaysAsItIs) {
  const Planes clean = picture(50, 37, 3, [](int x, int y, int c) { return 0.5f + 0.4f * deviate(3, x, y, c); });
  const Planes none(50, 37, 1);
  const NlMeansFrame frame{&clean, &clean, &none, nullptr, nullptr};
  const NlMeansResult r = nl_means(std::span(&frame, 1), {});
  EXPECT_LT(mean_square(r.a, clean), 1e-12);
}

TEST(NlMeans, FeaturesKeepApartWhatLooksAlike) {
  // A faint edge that noise hides, and a feature that shows it.
  const auto step = [](int x, int) { return x < 30 ? 0.5f : 0.55f; };
  const Noisy n = noisy(60, 40, 0.1f, step);
  const Planes truth = picture(60, 40, 3, [&](int x, int y, int) { return step(x, y); });
  const Planes feature = picture(60, 40, 1, [](int x, int, int) { return x < 30 ? 0.0f : 1.0f; });
  NlMeansSettings settings;
  const NlMeansFrame without{&n.a, &n.b, &n.variance, nullptr, nullptr},
      with{&n.a, &n.b, &n.variance, nullptr, &feature};
  const auto gap = [&](const NlMeansResult& r) {
    double sum = 0;
    for (int y = 5; y < 35; ++y)
      sum += double(r.a.row(0, y)[30] + r.b.row(0, y)[30] - r.a.row(0, y)[29] - r.b.row(0, y)[29]);
    return sum / 60;
  };
  const double blurred = gap(nl_means(std::span(&without, 1), settings));
  settings.feature_groups = {1}, settings.feature_floors = {1e-3f};
  const double kept = gap(nl_means(std::span(&with, 1), settings));
  EXPECT_LT(blurred, 0.6 * kept);
  EXPECT_NEAR(kept, 0.05, 0.025);
}

TEST(NlMeans, SameBitsForAnyThreadsAndTilesOfATrialAreThoseOfTheWhole) {
  const Noisy n = noisy(150, 70, 0.1f, [](int x, int y) { return 0.1f * float(x % 7) + 0.01f * float(y); });
  const NlMeansFrame frame{&n.a, &n.b, &n.variance, nullptr, nullptr};
  NlMeansSettings settings;
  NlMeansResult one, many;
  with_threads(1, [&] { one = nl_means(std::span(&frame, 1), settings); });
  with_threads(5, [&] { many = nl_means(std::span(&frame, 1), settings); });
  EXPECT_EQ(one.a.values(), many.a.values());
  settings.every = 4;
  const NlMeansResult trial = nl_means(std::span(&frame, 1), settings);
  int tried = 0;
  for (int y = 0; y < 70; ++y) {
    for (int x = 0; x < 150; ++x) {
      if (!is_on_trial(x, y, 4)) continue;
      ++tried;
      ASSERT_EQ(trial.b.row(2, y)[x], one.b.row(2, y)[x]);
    }
  }
  EXPECT_GT(tried, 0);
  EXPECT_LT(tried, 150 * 70 / 2);
}

PackedPlanes facing(int width, int height, float z) {
  return PackedPlanes(picture(width, height, 3, [&](int, int, int c) { return c == 2 ? z : 0.0f; }));
}

/// A picture that moves by (2, 1) pixels a frame, with an object in columns from `edge` on.
Surfaces moving(int width, int height, bool valid = true) {
  Surfaces s;
  s.forward = picture(width, height, 2, [&](int, int, int c) { return valid ? c == 0 ? 2.0f : 1.0f : kNowhere; });
  s.backward = picture(width, height, 2, [&](int, int, int c) { return valid ? c == 0 ? -2.0f : -1.0f : kNowhere; });
  s.id = Planes(width, height, 1, 3);
  s.normal = facing(width, height, 1);
  return s;
}

TEST(Tracks, FollowVectorsOverSeveralFrames) {
  std::map<int, Surfaces> frames;
  for (int f = 1; f <= 3; ++f) frames[f] = moving(20, 12);
  const auto surfaces = [&](int f) -> const Surfaces& { return frames.at(f); };
  const Track t = follow(3, 1, surfaces);
  ASSERT_FALSE(t.empty());
  EXPECT_EQ(t.valid.row(0, 7)[9], 1);
  EXPECT_EQ(t.place.row(0, 7)[9], 5);
  EXPECT_EQ(t.place.row(1, 7)[9], 5);
  EXPECT_EQ(t.valid.row(0, 1)[9], 0) << "it comes from outside of the picture";
  const Planes ramp = picture(20, 12, 1, [](int x, int y, int) { return float(x + 100 * y); });
  EXPECT_EQ(gather_nearest(ramp, t).row(0, 7)[9], 505);
  EXPECT_NEAR(gather_smooth(ramp, t).row(0, 7)[9], 505, 1e-3);

  frames[2].id.row(0, 6)[7] = 4;  // another object on the way
  EXPECT_EQ(follow(3, 1, surfaces).valid.row(0, 7)[9], 0);
  frames[2] = moving(20, 12), frames[1].normal = facing(20, 12, -1);
  EXPECT_EQ(follow(3, 1, surfaces).valid.row(0, 7)[9], 0) << "another side of it";
  frames[1] = moving(20, 12), frames[1].forward.row(0, 5)[5] = 9;
  EXPECT_EQ(follow(3, 1, surfaces).valid.row(0, 7)[9], 0) << "nothing leads back";
  frames[1] = moving(20, 12), frames[2] = moving(20, 12, false);
  const Track cut = follow(3, 1, surfaces);
  for (const float v : cut.valid.values()) EXPECT_EQ(v, 0) << "vectors that are not valid: a cut";
  EXPECT_TRUE(follow(3, 1, [&](int) -> const Surfaces& {
                static const Surfaces none;
                return none;
              }).empty());
}

TEST(Tracks, WeightsTellTheSameFromOthersInTheNoise) {
  const float sigma = 0.2f;
  const auto frame = [&](float truth, std::uint64_t seed) {
    return picture(40, 40, 3, [&](int x, int y, int c) { return truth + sigma * deviate(seed, x, y, c); });
  };
  const Planes variance(40, 40, 1, sigma * sigma), valid(40, 40, 1, 1);
  const auto mean_weight = [&](float other) {
    const Planes w = likeness_weights(frame(1, 5), variance, frame(other, 6), variance, valid, {});
    double sum = 0;
    for (const float x : w.values()) sum += double(x);
    return sum / double(w.values().size());
  };
  EXPECT_GT(mean_weight(1), 0.6);
  EXPECT_LT(mean_weight(2), 1e-4);
  const Planes nothing = likeness_weights(frame(1, 5), variance, frame(1, 6), variance, Planes(40, 40, 1), {});
  for (const float w : nothing.values()) EXPECT_EQ(w, 0);
}

// A reflection that differs by half of the noise passes for the same in a small patch, but not in a large one.
TEST(Tracks, WidePatchesSeeWhatTheNoiseOfSmallOnesHides) {
  const float sigma = 0.2f;
  const auto mean_weight = [&](float difference, float wide_k) {
    const auto frame = [&](float truth, std::uint64_t seed) {
      return picture(60, 60, 3, [&](int x, int y, int c) { return truth + sigma * deviate(seed, x, y, c); });
    };
    const Planes variance(60, 60, 1, sigma * sigma), valid(60, 60, 1, 1);
    Likeness likeness;
    likeness.k = 0.9f;
    likeness.wide_k = wide_k;
    const Planes w = likeness_weights(frame(1, 5), variance, frame(1 + difference, 6), variance, valid, likeness);
    double sum = 0;
    for (const float x : w.values()) sum += double(x);
    return sum / double(w.values().size());
  };
  const float half = 0.5f * sigma;
  EXPECT_GT(mean_weight(half, 0), 0.7);
  EXPECT_LT(mean_weight(half, 0.2f), 0.1);
  EXPECT_GT(mean_weight(0, 0.2f), 0.6);
}

TEST(Residuals, GiveBackWhatBothHalvesShowAndLittleNoise) {
  const auto detail = [](int x, int y, int) { return 1 + 0.3f * float((x / 3 + y / 3) % 2); };
  const Planes truth = picture(96, 80, 3, detail), flat(96, 80, 3, 1.15f);
  const auto half = [&](const Planes& of, float sigma, std::uint64_t seed) {
    Planes out = of;
    for (int c = 0; c < 3; ++c) {
      for (int y = 0; y < 80; ++y) {
        for (int x = 0; x < 96; ++x) out.row(c, y)[x] += sigma * deviate(seed, x, y, c);
      }
    }
    return out;
  };
  {  // a denoiser that wiped the detail off, of samples almost without noise
    const Planes a = half(truth, 0.01f, 1), b = half(truth, 0.01f, 2);
    const double wiped = mean_square(flat, truth);
    EXPECT_LT(mean_square(return_residuals({a, b, flat, flat, flat}, 1), truth), wiped / 20);
  }
  {  // one that left nothing out, of noisy samples
    const Planes a = half(flat, 0.5f, 1), b = half(flat, 0.5f, 2);
    EXPECT_LT(mean_square(return_residuals({a, b, flat, flat, flat}, 1), flat), 0.125 / 50) << "of the noise";
  }
}

TEST(ShotAround, EndsAtCutsAndReach) {
  const FrameRange reach{1, 20};
  EXPECT_EQ(shot_around(10, 5, reach, {}), (FrameRange{5, 15}));
  EXPECT_EQ(shot_around(2, 5, reach, {}), (FrameRange{1, 7}));
  EXPECT_EQ(shot_around(10, 5, reach, {8, 12}), (FrameRange{8, 11}));
  EXPECT_EQ(shot_around(8, 5, reach, {8}), (FrameRange{8, 13}));
  EXPECT_EQ(shot_around(7, 5, reach, {8}), (FrameRange{2, 7}));
}

}  // namespace
}  // namespace tempera::denoise
