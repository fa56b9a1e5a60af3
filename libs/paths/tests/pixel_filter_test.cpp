// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/pixel_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "statistics.h"
#include "tempera/core/random.h"

namespace tempera {
namespace {

constexpr FilterKind kKinds[] = {FilterKind::kBox, FilterKind::kTent, FilterKind::kGaussian, FilterKind::kMitchell,
                                 FilterKind::kBlackmanHarris};

Vec2f random2(std::uint64_t i) {
  const std::uint64_t h = hash_key(i, 1234);
  return {to_unit_float(std::uint32_t(h)), to_unit_float(std::uint32_t(h >> 32))};
}

/// Integral of g(x) over the filter's support by the midpoint rule, fine enough for 1e-6.
template <class G>
double integrate(const PixelFilter& f, double a, double b, G&& g) {
  const int n = 4000;
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    const double x = a + (b - a) * (i + 0.5) / n;
    sum += g(x, double(f.evaluate(float(x)))) * (b - a) / n;
  }
  return sum;
}

TEST(PixelFilter, ProfilesAreThoseOfOtherRenderers) {
  // Values of Mitsuba 3.9's box, tent, gaussian (stddev 0.5) and mitchell (B = C = 1/3) at x; its gaussian is a
  // polynomial fit that is off by up to 4e-4.
  const float x[] = {0, 0.25f, 0.49f, 0.75f, 1, 1.25f, 1.5f, 1.75f, 1.99f};
  const float tent[] = {1, 0.75f, 0.51f, 0.25f, 0, 0, 0, 0, 0};
  const float gaussian[] = {0.999247134f, 0.882166743f, 0.618559361f, 0.324242562f, 0.134960487f,
                            0.043603465f, 0.010758210f, 0.001843098f, 0.000029737f};
  const float mitchell[] = {0.888888955f,  0.782118082f,  0.545946121f,  0.256076425f, 0.055555623f,
                            -0.023437422f, -0.034721967f, -0.014756663f, -0.000032797f};
  for (int i = 0; i < 9; ++i) {
    EXPECT_EQ(PixelFilter(FilterKind::kBox).evaluate(x[i]), x[i] <= 0.5f ? 1.0f : 0.0f);
    EXPECT_NEAR(PixelFilter(FilterKind::kTent).evaluate(x[i]), tent[i], 1e-6);
    EXPECT_NEAR(PixelFilter(FilterKind::kGaussian).evaluate(x[i]), gaussian[i], 5e-4);
    EXPECT_NEAR(PixelFilter(FilterKind::kMitchell).evaluate(x[i]), mitchell[i], 1e-6);
  }
  const PixelFilter harris(FilterKind::kBlackmanHarris);
  EXPECT_NEAR(harris.evaluate(0), 1, 1e-6);            // sum of the absolute coefficients
  EXPECT_NEAR(harris.evaluate(0.75f), 0.21747, 1e-5);  // 0.35875 - 0.14128
  EXPECT_NEAR(harris.evaluate(1.5f), 6e-5, 1e-6);
  for (const FilterKind kind : kKinds) {
    const PixelFilter f(kind);
    for (float y = 0; y < 3; y += 0.01f) {
      EXPECT_EQ(f.evaluate(y), f.evaluate(-y));
      EXPECT_TRUE(y <= f.radius() || f.evaluate(y) == 0);
    }
  }
}

TEST(PixelFilter, OffsetsFollowTheProfile) {
  for (const FilterKind kind : kKinds) {
    for (const float radius : {0.0f, 3.0f}) {
      const PixelFilter f(kind, radius);
      const int bins = 60, samples = 400000;
      const double total = integrate(f, -f.radius(), f.radius(), [](double, double v) { return std::abs(v); });
      std::vector<double> expected, counts_x(bins), counts_y(bins), joint(100), joint_expected;
      const auto mass = [&](int i, int n) {
        const double a = -f.radius() + 2.0 * f.radius() * i / n, b = -f.radius() + 2.0 * f.radius() * (i + 1) / n;
        return integrate(f, a, b, [](double, double v) { return std::abs(v); }) / total;
      };
      for (int i = 0; i < bins; ++i) expected.push_back(samples * mass(i, bins));
      for (int i = 0; i < 100; ++i) joint_expected.push_back(samples * mass(i / 10, 10) * mass(i % 10, 10));
      for (int i = 0; i < samples; ++i) {
        const Vec2f offset = f.sample(random2(std::uint64_t(i))).offset;
        ASSERT_LE(std::max(std::abs(offset.x), std::abs(offset.y)), f.radius());
        const auto bin = [&](float v, int n) {
          return std::size_t(std::min((v / f.radius() + 1) / 2 * float(n), float(n) - 0.5f));
        };
        ++counts_x[bin(offset.x, bins)], ++counts_y[bin(offset.y, bins)];
        ++joint[bin(offset.x, 10) * 10 + bin(offset.y, 10)];
      }
      EXPECT_TRUE(test::CountsFit(expected, counts_x)) << filter_name(kind) << " " << radius;
      EXPECT_TRUE(test::CountsFit(expected, counts_y)) << filter_name(kind) << " " << radius;
      EXPECT_TRUE(test::CountsFit(joint_expected, joint)) << filter_name(kind) << " " << radius;
    }
  }
}

TEST(PixelFilter, WeightedSamplesHaveTheMomentsOfTheFilter) {
  for (const FilterKind kind : kKinds) {
    const PixelFilter f(kind);
    const auto moment = [&](int k) {
      return integrate(f, -f.radius(), f.radius(), [&](double x, double v) { return std::pow(x, k) * v; });
    };
    const double norm = moment(0);
    std::vector<double> weight, x, x2, x2y2, y4;
    bool positive = true;
    for (std::uint64_t i = 0; i < 200000; ++i) {
      const PixelFilter::Sample s = f.sample(random2(i + 7000000));
      const double w = s.weight, sx = s.offset.x, sy = s.offset.y;
      weight.push_back(w), x.push_back(w * sx), x2.push_back(w * sx * sx);
      x2y2.push_back(w * sx * sx * sy * sy), y4.push_back(w * std::pow(sy, 4));
      positive &= w == 1;
      // The sign is the filter's.
      EXPECT_GE(w * f.evaluate(s.offset.x) * f.evaluate(s.offset.y), -1e-9);
    }
    EXPECT_EQ(positive, kind != FilterKind::kMitchell);
    EXPECT_TRUE(positive || test::MeanIs(1, weight));
    EXPECT_TRUE(test::MeanIs(0, x)) << filter_name(kind);
    EXPECT_TRUE(test::MeanIs(moment(2) / norm, x2)) << filter_name(kind);
    EXPECT_TRUE(test::MeanIs(moment(2) * moment(2) / norm / norm, x2y2)) << filter_name(kind);
    EXPECT_TRUE(test::MeanIs(moment(4) / norm, y4)) << filter_name(kind);
  }
}

TEST(PixelFilter, NegativeLobesDoNotChangeBrightness) {
  const PixelFilter f(FilterKind::kMitchell);
  // Integral of |f| over integral of f: each axis contributes it once to a weight and once, inverse, to the mean sign.
  const double total = integrate(f, -2, 2, [](double, double v) { return v; });
  const double scale = integrate(f, -2, 2, [](double, double v) { return std::abs(v); }) / total;
  EXPECT_NEAR(scale, 1.06997, 1e-5);
  const int n = 1 << 20;
  double sum = 0;
  for (int x = 0; x < n; ++x) sum += f.sample({(float(x) + 0.5f) / n, 0.5f}).weight;
  EXPECT_NEAR(sum / n, scale, 1e-5);
  EXPECT_NEAR(f.sample({0.5f, 0.5f}).weight, scale * scale, 1e-6);
  EXPECT_NEAR(f.sample({0.01f, 0.5f}).weight, -scale * scale, 1e-6);
  EXPECT_NEAR(f.sample({0.01f, 0.99f}).weight, scale * scale, 1e-6);
}

TEST(PixelFilter, MapIsMonotoneAndSymmetric) {
  for (const FilterKind kind : kKinds) {
    const PixelFilter f(kind);
    float last = -f.radius();
    for (int i = 0; i < 100000; ++i) {
      const float u = float(i) / 100000;
      const float x = f.sample({u, 0.5f}).offset.x;
      ASSERT_GE(x, last) << filter_name(kind) << " at " << u;
      last = x;
    }
    for (const float u : {0.01f, 0.125f, 0.3f, 0.4999f}) {
      EXPECT_NEAR(f.sample({u, 0.5f}).offset.x, -f.sample({1 - u, 0.5f}).offset.x, 2e-4) << filter_name(kind);
    }
    EXPECT_NEAR(f.sample({0, 0}).offset.x, -f.radius(), 1e-6);
    EXPECT_LE(f.sample({0x0.ffffffp0f, 0}).offset.x, f.radius());
    EXPECT_NEAR(f.sample({0.5f, 0.5f}).offset.x, 0, 1e-3);
  }
}

// What is splatted: integrates to 1 at any radius, is the profile up to a factor, negative lobes included, and adds up
// to what samples estimate.
TEST(PixelFilter, DensityIsTheNormalizedProfile) {
  for (const FilterKind kind : kKinds) {
    for (const float radius : {0.0f, 0.3f, 3.0f}) {
      const PixelFilter f(kind, radius);
      const double r = double(f.radius());
      const int n = 400;
      double sum = 0, second = 0;
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i) {
          const double x = -r + 2 * r * (i + 0.5) / n, y = -r + 2 * r * (j + 0.5) / n;
          const double value = double(f.density({float(x), float(y)})) * 4 * r * r / (n * n);
          sum += value, second += value * (x * x + 0.3 * y * y);
        }
      }
      EXPECT_NEAR(sum, 1, 2e-4) << filter_name(kind);
      std::vector<double> estimates;
      for (std::uint64_t i = 0; i < 20000; ++i) {
        const auto s = f.sample(random2(i));
        const double x = double(s.offset.x), y = double(s.offset.y);
        estimates.push_back(double(s.weight) * (x * x + 0.3 * y * y));
      }
      EXPECT_TRUE(test::MeanIs(second, estimates)) << filter_name(kind);
      const float inside = 0.2f * f.radius(), outside = 0.8f * f.radius();
      EXPECT_NEAR(f.density({outside, inside}) / f.density({inside, inside}), f.evaluate(outside) / f.evaluate(inside),
                  1e-6f);
      EXPECT_EQ(f.density({outside, 0}) < 0, kind == FilterKind::kMitchell);
      EXPECT_EQ(f.density({0, 1.001f * f.radius()}), 0);
    }
  }
  // Every place is in one pixel's box.
  const PixelFilter box;
  EXPECT_EQ(box.density({-0.5f, 0}), 1);
  EXPECT_EQ(box.density({0.5f, 0}), 0);
}

TEST(PixelFilter, NamesAndErrors) {
  for (const FilterKind kind : kKinds) EXPECT_EQ(parse_filter(filter_name(kind)), kind);
  try {
    parse_filter("gausian", {"shot.toml", 3, 9});
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
    EXPECT_EQ(e.loc().line, 3);
    EXPECT_NE(e.message().find("unknown pixel filter \"gausian\"; known: gaussian, "), std::string::npos) << e.what();
    for (const FilterKind kind : kKinds) EXPECT_NE(e.message().find(filter_name(kind)), std::string::npos);
  }
  for (const float radius : {-1.0f, 1e-3f, 100.0f, NAN, INFINITY}) {
    try {
      PixelFilter f(FilterKind::kGaussian, radius);
      ADD_FAILURE() << radius;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kOutOfRange);
    }
  }
}

}  // namespace
}  // namespace tempera
