// SPDX-License-Identifier: Apache-2.0
// T1: the solver's error over temporal frequencies is that of the theory [Manzi 2016, Fig. 4 and 5].
#include "poisson_theory.h"

#include <gtest/gtest.h>

#include <array>
#include <functional>

#include "tempera/stages/cosine_transform.h"
#include "theory_window.h"

namespace tempera {
namespace {

using test::model;
using test::NoiseModel;
using test::TemporalRows;

TEST(PoissonTheory, QuadratureGivesTheTable) {
  for (const test::TheoryColumn& column : test::kTheory) {
    const auto error = [&](int n, double frequency) {
      return 1e3 * test::spatial_mean(n, false, [&](double s) {
               return column.replayed ? test::replayed_error(column.model, s, frequency)
                                      : test::independent_error(column.model, s, frequency);
             });
    };
    constexpr double kRounding = 5.1e-5;
    for (std::size_t k = 0; k < column.at.size(); ++k) {
      const double frequency = 0.05 * double(k), value = error(96, frequency);
      EXPECT_NEAR(value, column.at[k], kRounding);
      EXPECT_NEAR(value / error(160, frequency), 1, 1e-4) << "converged";
    }
    double mean = 0, difference = 0;
    constexpr int kSteps = 64;
    for (int k = 0; k < kSteps; ++k) {
      const double frequency = (k + 0.5) / kSteps, value = error(96, frequency) / kSteps;
      mean += value, difference += test::difference_power(frequency) * value;
    }
    EXPECT_NEAR(mean, column.mean, kRounding);
    EXPECT_NEAR(difference, column.difference, kRounding);
  }
}

TEST(PoissonTheory, NoWeightsBeatGeneralisedLeastSquares) {
  for (const test::TheoryColumn& column : test::kTheory) {
    if (!column.replayed) continue;
    for (const double s : {0.0, 0.3, 2.0, 7.5}) {
      for (const double frequency : {0.0, 0.1, 0.3, 0.5}) {
        EXPECT_LE(test::least_replayed_error(column.model, s, frequency),
                  test::replayed_error(column.model, s, frequency) * (1 + 1e-12));
      }
    }
  }
}

TEST(PoissonTheory, ClosedFormsAtTheEnds) {
  const NoiseModel m = model(TemporalRows::kFull, 1);
  EXPECT_NEAR(test::independent_error(m, 0, 0), m.primal, 1e-15) << "the mean is that of the primal data";
  for (const double s : {0.3, 2.0, 7.5}) {
    // With alpha = |eps_G| / |eps_F| the weights are the inverse variances.
    const double power = m.alpha * m.alpha + s + test::temporal_power(m, s, 0.3);
    EXPECT_NEAR(test::independent_error(m, s, 0.3), m.gradient / power, 1e-12);
  }
}

constexpr int kSize = 64, kFrames = 10;

// White noise on each row, without motion: the errors are white in the cosine basis, with the variances of the theory
// at its frequencies.
TEST(PoissonTheory, TheSolverHasTheErrorOfIndependentNoise) {
  for (const test::TheoryColumn& column : test::kTheory) {
    if (column.replayed) continue;
    const NoiseModel& m = column.model;
    const test::Window window = test::noisy_window(column, kSize, kFrames, 17);
    PlanarFrames x = test::primal_data(window);
    ASSERT_TRUE(solve_poisson(window.span(), test::settings_of(m), x).direct);

    std::array<double, kFrames> power{};
    const CosineTransform transform(kFrames);
    CosineTransform::Scratch scratch;
    std::vector<float> series(std::size_t(kFrames) * CosineTransform::kLanes);
    for (int y = 0; y < kSize; ++y) {
      for (int x0 = 0; x0 < kSize; x0 += CosineTransform::kLanes) {
        for (int c = 0; c < 3; ++c) {
          for (int t = 0; t < kFrames; ++t) {
            std::copy_n(x.row(t, y, c) + x0, CosineTransform::kLanes, &series[t * CosineTransform::kLanes]);
          }
          transform.forward(series.data(), scratch);
          for (std::size_t i = 0; i < series.size(); ++i) {
            power[i / CosineTransform::kLanes] += double(series[i]) * double(series[i]);
          }
        }
      }
    }
    for (int k = 0; k < kFrames; ++k) {
      const auto moment = [&](int p) {
        return test::spatial_mean(
            kSize, true, [&](double s) { return std::pow(test::independent_error(m, s, 0.5 * k / kFrames), p); });
      };
      constexpr double kCount = 3.0 * kSize * kSize;
      const double expected = moment(1), sigma = std::sqrt(2 * moment(2) / kCount);
      EXPECT_NEAR(power[k] / kCount, expected, 4.5 * sigma) << "mode " << k;
      EXPECT_LT(4.5 * sigma, 0.25 * expected) << "the test can tell";
    }
  }
}

// Two passes of half the samples each, where O_(t+1) shares most of its noise with B_t, as replayed random numbers make
// it. Frames in the middle of a long window stand for an endless sequence.
TEST(PoissonTheory, TheSolverHasTheErrorOfReplayedNoise) {
  constexpr int kWidth = 32, kLong = 96, kMargin = 16;
  for (const test::TheoryColumn& column : test::kTheory) {
    if (!column.replayed) continue;
    const NoiseModel& m = column.model;
    const test::Window window = test::noisy_window(column, kWidth, kLong, 23);
    PlanarFrames x = test::primal_data(window);
    ASSERT_TRUE(solve_poisson(window.span(), test::settings_of(m), x).direct);

    double error = 0, difference = 0;
    for (int t = kMargin; t < kLong - kMargin; ++t) {
      for (int y = 0; y < kWidth; ++y) {
        for (int c = 0; c < 3; ++c) {
          for (int i = 0; i < kWidth; ++i) {
            const double v = double(x.row(t, y, c)[i]), d = double(x.row(t + 1, y, c)[i]) - v;
            error += v * v, difference += d * d;
          }
        }
      }
    }
    constexpr double kCount = 3.0 * kWidth * kWidth * (kLong - 2 * kMargin);
    double expected_error = 0, expected_difference = 0;
    constexpr int kSteps = 64;
    for (int k = 0; k < kSteps; ++k) {
      const double frequency = (k + 0.5) / kSteps,
                   value = test::spatial_mean(kWidth, true,
                                              [&](double s) { return test::replayed_error(m, s, frequency); }) /
                           kSteps;
      expected_error += value, expected_difference += test::difference_power(frequency) * value;
    }
    EXPECT_NEAR(error / kCount / expected_error, 1, 0.05);
    EXPECT_NEAR(difference / kCount / expected_difference, 1, 0.02);
  }
}

}  // namespace
}  // namespace tempera
