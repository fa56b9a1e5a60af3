// SPDX-License-Identifier: Apache-2.0
#include "../src/seed_statistics.h"

#include "sequences.h"

namespace tempera {
namespace {

using namespace test;

BiasVariance of_errors(const std::vector<float>& errors, float reference, double epsilon) {
  std::vector<Image> images;
  for (const float e : errors) images.push_back(Image(5, 4, 3, reference + e));
  std::vector<const Image*> runs;
  for (const Image& i : images) runs.push_back(&i);
  return bias_and_variance(runs, Image(5, 4, 3, reference), epsilon);
}

TEST(BiasAndVariance, ClosedForm) {
  // Errors 1, 2, 6 over 2^2 + 1: products of pairs 2, 6, 12; sample variance 7.
  const BiasVariance b = of_errors({1, 2, 6}, 2, 1);
  EXPECT_NEAR(b.bias_squared, 20.0 / 3 / 5, 1e-6);
  EXPECT_NEAR(b.variance, 7.0 / 5, 1e-6);
  ASSERT_EQ(b.bias_squared_without.size(), 3u);
  EXPECT_NEAR(b.bias_squared_without[0], 12.0 / 5, 1e-6);
  EXPECT_NEAR(b.bias_squared_without[1], 6.0 / 5, 1e-6);
  EXPECT_NEAR(b.bias_squared_without[2], 2.0 / 5, 1e-6);
  EXPECT_NEAR(b.variance_without[0], 8.0 / 5, 1e-6);
  EXPECT_NEAR(b.variance_without[2], 0.5 / 5, 1e-6);
  const BiasVariance two = of_errors({1, -1}, 0, 1);
  EXPECT_NEAR(two.bias_squared, -1, 1e-6) << "unbiased, and so below 0 at times";
  EXPECT_NEAR(two.variance, 2, 1e-6);
  EXPECT_TRUE(two.bias_squared_without.empty());
}

TEST(BiasAndVariance, PixelsThatAreNotFiniteInSomeRunAreLeftOut) {
  Image a(4, 4, 3, 1.0f), b(4, 4, 3, 3.0f);
  const Image reference(4, 4, 3, 1.0f);
  a.at(1, 2, 1) = std::nanf("");
  const std::vector<const Image*> runs{&a, &b};
  const BiasVariance clean = bias_and_variance(runs, reference, 1);
  EXPECT_NEAR(clean.bias_squared, 0, 1e-9);
  EXPECT_NEAR(clean.variance, 2.0 / 2, 1e-9);
  const Image none(4, 4, 3, kInfinity);
  EXPECT_TRUE(std::isnan(bias_and_variance(std::vector<const Image*>{&none, &b}, reference, 1).variance));
}

// Intervals of 95 % hold the truth in 95 of 100 experiments, for the variance and for the squared bias.
TEST(BiasAndVariance, ConfidenceHoldsTheTruth) {
  constexpr int kExperiments = 400, kRuns = 8;
  constexpr float kBias = 0.3f, kSigma = 0.4f;
  int bias_held = 0, variance_held = 0;
  std::vector<double> biases, variances;
  const Image reference(8, 6, 3, 0.0f);
  for (int e = 0; e < kExperiments; ++e) {
    std::vector<Image> images;
    for (int r = 0; r < kRuns; ++r) {
      images.push_back(
          filled(8, 6, 3, [=](int x, int y, int c) { return kBias + kSigma * normal(x, y, 3 * e + c, r); }));
    }
    std::vector<const Image*> runs;
    for (const Image& i : images) runs.push_back(&i);
    const BiasVariance b = bias_and_variance(runs, reference, 1);
    const MeanError bias =
        jackknife(std::vector{b.bias_squared}, std::vector<std::vector<double>>{b.bias_squared_without});
    const MeanError variance = jackknife(std::vector{b.variance}, std::vector<std::vector<double>>{b.variance_without});
    EXPECT_EQ(bias.count, kRuns);
    bias_held += std::abs(bias.mean - kBias * kBias) < bias.confidence_95();
    variance_held += std::abs(variance.mean - kSigma * kSigma) < variance.confidence_95();
    biases.push_back(bias.mean), variances.push_back(variance.mean);
  }
  const MeanError bias_mean = mean_error(biases), variance_mean = mean_error(variances);
  EXPECT_LT(std::abs(bias_mean.mean - kBias * kBias), 3 * bias_mean.standard_error);
  EXPECT_LT(std::abs(variance_mean.mean - kSigma * kSigma), 3 * variance_mean.standard_error);
  EXPECT_NEAR(bias_held / double(kExperiments), 0.95, 0.03);
  EXPECT_NEAR(variance_held / double(kExperiments), 0.95, 0.03);
}

}  // namespace
}  // namespace tempera
