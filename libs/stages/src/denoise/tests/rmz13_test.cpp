// SPDX-License-Identifier: Apache-2.0
// The filter of [Rousselle 2013], on planes alone.
#include "denoise/rmz13.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "denoise/tests/pictures.h"

namespace tempera::denoise {
namespace {

double mean_of(const Planes& p, int channel) {
  double sum = 0;
  for (std::size_t i = 0; i < p.pixels(); ++i) sum += double(p.plane(channel)[i]);
  return sum / double(p.pixels());
}

Planes random(int width, int height, int channels, std::uint64_t seed) {
  return picture(width, height, channels, [&](int x, int y, int c) { return deviate(seed, x, y, c); });
}

TEST(JointFilter, WhatHasNoNoiseStaysAsItIs) {
  const Planes clean = random(50, 37, 3, 1), none(50, 37, 3);
  const JointFrame frame{.guide = &clean, .variance = &none, .values = &clean};
  const JointFilter filters[]{{.patch = 1}, {.patch = 3}};
  for (const JointResult& r : joint_filter(std::span(&frame, 1), filters, {}))
    EXPECT_LT(mean_square(r.values, clean), 1e-12);
}

TEST(JointFilter, WeightsAreSymmetricWhereNoiseIsEvenlySpread) {
  const Planes u = random(70, 40, 3, 2), variance(70, 40, 3, 1);
  const Planes feature = picture(70, 40, 1, [](int x, int, int) { return x < 33 ? 0.0f : 0.02f; });
  const JointFrame frame{.guide = &u, .variance = &variance, .values = &u, .features = &feature};
  const JointSettings settings{.feature_groups = {1}};
  for (const JointFilter& filter :
       {JointFilter{.patch = 1}, {.patch = 3}, {.patch = 1, .color = false, .tau = 1e-4f}}) {
    for (const auto& [dx, dy] : {std::pair{1, 0}, {-3, 2}, {9, 10}}) {
      const Planes there = joint_weights(frame, filter, settings, dx, dy),
                   back = joint_weights(frame, filter, settings, -dx, -dy);
      double sum = 0;
      for (int y = std::max(0, -dy); y < std::min(40, 40 - dy); ++y) {
        for (int x = std::max(0, -dx); x < std::min(70, 70 - dx); ++x) {
          ASSERT_NEAR(there.row(0, y)[x], back.row(0, y + dy)[x + dx], 2e-6) << x << ' ' << y << ' ' << dx;
          sum += double(there.row(0, y)[x]);
        }
      }
      EXPECT_GT(sum, 10);
    }
  }
}

/// The weight of one pair, straight from its definition.
struct Pair {
  const JointFrame &p, &q;
  const JointSettings& s;
  bool there(int x, int y, int dx, int dy) const {
    const auto in = [&](int i, int j) { return i >= 0 && j >= 0 && i < p.guide->width() && j < p.guide->height(); };
    return in(x, y) && in(x + dx, y + dy) && (!q.valid || q.valid->row(0, y + dy)[x + dx] > 0);
  }
  double patch(int x, int y, int dx, int dy, int f) const {
    double sum = 0;
    int count = 0;
    for (int j = y - f; j <= y + f; ++j) {
      for (int i = x - f; i <= x + f; ++i) {
        if (!there(i, j, dx, dy)) continue;
        for (int c = 0; c < 3; ++c) {
          const double a = p.guide->row(c, j)[i], b = q.guide->row(c, j + dy)[i + dx], va = p.variance->row(c, j)[i],
                       vb = q.variance->row(c, j + dy)[i + dx];
          sum += ((a - b) * (a - b) - (va + std::min(va, vb))) / (1e-10 + double(s.k_color * s.k_color) * (va + vb));
          ++count;
        }
      }
    }
    return sum / count;
  }
  double by_color(int x, int y, int dx, int dy, int f) const {
    double sum = 0;
    int count = 0;
    for (int j = y - f + 1; j < y + f; ++j) {
      for (int i = x - f + 1; i < x + f; ++i) {
        if (there(i, j, dx, dy)) sum += std::exp(-std::max(0.0, patch(i, j, dx, dy, f))), ++count;
      }
    }
    return sum / count;
  }
  double by_feature(int x, int y, int dx, int dy, double tau) const {
    const Planes& f = *p.features;
    double sum = 0, variance = 0, other = 0, gradient = 0;
    for (int c = 0; c < 2; ++c) {
      const auto at = [&](int i, int j) {
        return double(f.row(c, std::clamp(j, 0, f.height() - 1))[std::clamp(i, 0, f.width() - 1)]);
      };
      const double here = at(x, y);
      sum += std::pow(here - double(q.features->row(c, y + dy)[x + dx]), 2) / 2;
      variance += double(p.feature_variance->row(c, y)[x]) / 2;
      other += double(q.feature_variance->row(c, y + dy)[x + dx]) / 2;
      const auto smaller = [&](double a, double b) {
        return std::min((a - here) * (a - here), (b - here) * (b - here));
      };
      gradient += (smaller(at(x - 1, y), at(x + 1, y)) + smaller(at(x, y - 1), at(x, y + 1))) / 4 / 2;
    }
    const double d = (sum - (variance + std::min(variance, other))) /
                     (double(s.k_feature * s.k_feature) * std::max({tau, variance, gradient}));
    return std::exp(-std::max(0.0, d));
  }
};

TEST(JointFilter, IsWhatItsDefinitionSays) {
  const int width = 67, height = 35;
  const auto spread = [&](int channels, std::uint64_t seed, float scale) {
    Planes v = random(width, height, channels, seed);
    for (float& x : v.values()) x = scale * (0.2f + x * x);
    return v;
  };
  struct Data {
    Planes guide, variance, features, feature_variance, valid;
  } data[2];
  for (std::uint64_t i = 0; i < 2; ++i) {
    data[i] = {random(width, height, 3, 10 + i), spread(3, 20 + i, 0.4f), random(width, height, 2, 30 + i),
               spread(2, 40 + i, 0.2f), Planes(width, height, 1, 1)};
    for (float& f : data[i].features.values()) f *= 0.3f;
  }
  for (int y = 0; y < height; ++y) data[1].valid.row(0, y)[(y * 7) % width] = 0;
  std::vector<JointFrame> frames;
  for (const Data& d : data)
    frames.push_back({&d.guide, &d.variance, &d.guide, &d.features, &d.feature_variance, &d.valid});
  frames[0].valid = nullptr;
  const JointSettings settings{.window = 3, .k_color = 1, .feature_groups = {2}};
  const JointFilter filters[]{{.patch = 1, .tau = 0.1f}, {.patch = 2, .tau = 0.01f}, {.patch = 1, .color = false}};
  const std::vector<JointResult> results = joint_filter(frames, filters, settings);
  for (std::size_t k = 0; k < 3; ++k) {
    for (const auto& [x, y] : {std::pair{0, 0}, {66, 34}, {30, 17}, {64, 31}, {2, 33}}) {
      double sum = 0, total = 0, squares = 0, largest = 0;
      for (std::size_t n = 0; n < 2; ++n) {
        const Pair pair{frames[0], frames[n], settings};
        for (int dy = -3; dy <= 3; ++dy) {
          for (int dx = -3; dx <= 3; ++dx) {
            if ((n == 0 && dx == 0 && dy == 0) || !pair.there(x, y, dx, dy)) continue;
            const double color = filters[k].color ? pair.by_color(x, y, dx, dy, filters[k].patch) : 1;
            const double w = std::min(color, pair.by_feature(x, y, dx, dy, double(filters[k].tau)));
            sum += w * double(data[n].guide.row(1, y + dy)[x + dx]), total += w, squares += w * w;
            largest = std::max(largest, w);
          }
        }
      }
      const double own = std::max(largest, 1e-3);
      const double expected = (sum + own * double(data[0].guide.row(1, y)[x])) / (total + own);
      EXPECT_NEAR(results[k].values.row(1, y)[x], expected, 2e-4) << k << ' ' << x << ' ' << y;
      EXPECT_NEAR(results[k].gain.row(0, y)[x], (squares + own * own) / ((total + own) * (total + own)), 2e-4);
    }
  }
}

TEST(JointFilter, DerivativeIsThatOfTheFilter) {
  // Patches of one pixel: the derivative leaves out that a pixel is in the patches of others, too.
  const Planes u = random(40, 30, 3, 5), variance(40, 30, 3, 1), feature = random(40, 30, 1, 6);
  const JointFilter filter{.patch = 0, .tau = 1.0f};
  JointSettings settings{.window = 3, .k_color = 1, .feature_groups = {1}, .derivative = true};
  const auto filtered = [&](const Planes& guide) {
    const JointFrame frame{.guide = &guide, .variance = &variance, .values = &guide, .features = &feature};
    return std::move(joint_filter(std::span(&frame, 1), std::span(&filter, 1), settings)[0]);
  };
  const Planes derivative = filtered(u).derivative;
  for (const auto& [x, y] : {std::pair{0, 0}, {11, 7}, {20, 15}, {39, 22}, {25, 3}, {8, 25}}) {
    const float step = 1e-3f;
    Planes more = u, less = u;
    more.row(1, y)[x] += step, less.row(1, y)[x] -= step;
    const float change = filtered(more).values.row(1, y)[x] - filtered(less).values.row(1, y)[x];
    EXPECT_NEAR(derivative.row(1, y)[x], change / (2 * step), 0.01) << x << ' ' << y;
  }
}

TEST(JointFilter, GainIsThatOfTheNoise) {
  const Planes noise = random(96, 96, 3, 7), variance(96, 96, 3, 1), feature(96, 96, 1, 1);
  const JointFrame frame{.guide = &noise, .variance = &variance, .values = &noise, .features = &feature};
  const JointFilter filter{.patch = 1, .color = false};
  const JointResult r =
      std::move(joint_filter(std::span(&frame, 1), std::span(&filter, 1), {.window = 2, .feature_groups = {1}})[0]);
  EXPECT_FLOAT_EQ(r.gain.row(0, 50)[50], 1.0f / 25);
  EXPECT_FLOAT_EQ(r.gain.row(0, 0)[0], 1.0f / 9);
  double square = 0;
  for (const float v : r.values.values()) square += double(v * v) / double(r.values.values().size());
  // About 96 * 96 * 3 / 25 values are independent: relative standard deviation sqrt(2 / 1106) = 0.043; four of them
  EXPECT_NEAR(square / mean_of(r.gain, 0), 1, 0.17);
}

/// Left: evenly lit texture that features show. Right: shadows that they do not.
struct Scene {
  int width = 128, height = 64;
  float sigma = 0.15f;
  float albedo(int x, int y) const { return x < 64 && (x / 3 + y / 3) % 2 ? 0.8f : 0.4f; }
  float truth(int x, int y) const { return x < 64 ? albedo(x, y) : (x / 8 + y / 8) % 2 ? 0.2f : 1.0f; }
  Planes clean() const {
    return picture(width, height, 3, [&](int x, int y, int) { return truth(x, y); });
  }
  FeatureStack features() const {
    FeatureStack stack;
    stack.add({picture(width, height, 3, [&](int x, int y, int) { return albedo(x, y); }), {}});
    return stack;
  }
  Noisy noisy_halves() const {
    return noisy(width, height, sigma, [&](int x, int y) { return truth(x, y); });
  }
  /// Known, as errors that are estimated without bias take it to be.
  Planes variance() const { return Planes(width, height, 3, sigma * sigma / 2); }
};

TEST(Rmz13, ErrorsAreEstimatedWithoutBias) {
  const Scene scene;
  const Noisy n = scene.noisy_halves();
  const Planes variance = scene.variance(), clean = scene.clean();
  const FeatureStack features = scene.features();
  const Rmz13Result r = rmz13({n.a, n.b, variance, features});
  for (int k = 0; k < 3; ++k) {
    double error = 0;
    for (int c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < clean.pixels(); ++i)
        error += std::pow(double(r.candidates.plane(3 * k + c)[i] - clean.plane(c)[i]), 2) / double(3 * clean.pixels());
    }
    // The estimate's own noise: of (F - u)^2, 24576 values with relative deviation sqrt(2), 0.9 % of the variance;
    // patches of others that hold the pixel are left out of the derivative.
    EXPECT_NEAR(mean_of(r.errors, k), error, 0.05 * double(variance.values()[0]) + 0.1 * error) << k;
  }
}

TEST(Rmz13, SelectsTheRightFilter) {
  const Scene scene;
  const Noisy n = scene.noisy_halves();
  const Planes variance = scene.variance(), clean = scene.clean();
  const FeatureStack features = scene.features();
  const Rmz13Result r = rmz13({n.a, n.b, variance, features});
  double lit = 0, shadow = 0;
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      const float* const s = r.selection.row(0, y) + x;
      const float sum = s[0] + r.selection.row(1, y)[x] + r.selection.row(2, y)[x];
      ASSERT_NEAR(sum, 1, 1e-5);
      if (x < 56) lit += double(r.selection.row(2, y)[x]) / (56 * scene.height);
      if (x >= 72) shadow += double(r.selection.row(2, y)[x]) / (56 * scene.height);
    }
  }
  EXPECT_GT(lit, 0.6) << "features tell all";
  EXPECT_LT(shadow, 0.1) << "they tell nothing of shadows";
  EXPECT_LT(mean_square(r.color, clean), 0.05 * double(scene.sigma * scene.sigma / 2));
}

TEST(Rmz13, WhatHasNoNoiseStaysAsItIs) {
  const Planes clean = random(48, 33, 3, 3), none(48, 33, 3);
  const FeatureStack features;
  EXPECT_LT(mean_square(rmz13({clean, clean, none, features}).color, clean), 1e-10);
}

TEST(Rmz13, SameBitsForAnyThreads) {
  const Scene scene;
  const Noisy n = scene.noisy_halves();
  const Planes variance = scene.variance();
  const FeatureStack features = scene.features();
  Rmz13Result one, many;
  with_threads(1, [&] { one = rmz13({n.a, n.b, variance, features}); });
  with_threads(5, [&] { many = rmz13({n.a, n.b, variance, features}); });
  EXPECT_EQ(one.color.values(), many.color.values());
}

TEST(Features, VarianceIsBoundedByWhatIsAround) {
  // Means of 16 samples that see 1 with probability 1/4 between pixels that see 0 and 1.
  const Planes edge = picture(3, 3, 1, [](int x, int, int) { return x == 0 ? 0.0f : x == 1 ? 0.25f : 1.0f; });
  const Planes v = bounded_variance(edge, 16);
  EXPECT_FLOAT_EQ(v.row(0, 1)[1], 0.25f * 0.75f / 16);
  EXPECT_EQ(v.row(0, 1)[0], 0);
  EXPECT_EQ(v.row(0, 1)[2], 0);
}

TEST(Features, PrefilterTakesNoiseOutOfEdges) {
  // A slanted edge: coverage of pixels on it, of 8 samples.
  const auto coverage = [](int x, int y) { return std::clamp(float(x) - 0.25f * float(y) - 20, 0.0f, 1.0f); };
  const Planes clean = picture(60, 40, 3, [&](int x, int y, int) { return coverage(x, y); });
  const Planes noisy = picture(60, 40, 3, [&](int x, int y, int) {
    const float a = coverage(x, y);
    return std::clamp(a + std::sqrt(a * (1 - a) / 8) * deviate(9, x, y, 0), 0.0f, 1.0f);
  });
  const Feature filtered = prefilter({noisy, bounded_variance(noisy, 8)});
  EXPECT_LT(mean_square(filtered.values, clean), 0.75 * mean_square(noisy, clean));
  EXPECT_LT(mean_of(filtered.variance, 0), mean_of(bounded_variance(noisy, 8), 0));
  const Feature exact = prefilter({clean, Planes(60, 40, 3)});
  EXPECT_EQ(exact.values.values(), clean.values());
}

}  // namespace
}  // namespace tempera::denoise
