// SPDX-License-Identifier: Apache-2.0
// T1: the solver's error over temporal frequencies is that of the theory [Manzi 2016, Fig. 4 and 5].
#include "poisson_theory.h"

#include <gtest/gtest.h>

#include <array>
#include <functional>

#include "synthetic_window.h"
#include "tempera/stages/cosine_transform.h"

namespace tempera {
namespace {

using test::NoiseModel;
using test::TemporalRows;

NoiseModel model(TemporalRows rows, double ratio = 1) {
  NoiseModel m;
  m.rows = rows, m.ratio = ratio;
  return m;
}

/// Errors in thousandths at frequencies 0, 0.05, ... 0.5, their mean over all, and the variance of differences of
/// consecutive frames.
struct Column {
  NoiseModel model;
  bool replayed;
  std::array<double, 11> at;
  double mean, difference;
};

// To four places; each agrees with a simulation that shares no code with this program.
const Column kTable[] = {
    {model(TemporalRows::kNone),
     false,
     {.2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119},
     .2119,
     .4238},
    {model(TemporalRows::kFirstOrder),
     false,
     {.2119, .1710, .1325, .1069, .0889, .0761, .0670, .0606, .0565, .0541, .0533},
     .0946,
     .1321},
    {model(TemporalRows::kFull, 0.5),
     false,
     {.2119, .1421, .0818, .0496, .0329, .0238, .0186, .0155, .0137, .0127, .0124},
     .0501,
     .0401},
    {model(TemporalRows::kFull, 1),
     false,
     {.2119, .1586, .1041, .0704, .0505, .0385, .0312, .0266, .0238, .0223, .0219},
     .0642,
     .0643},
    {model(TemporalRows::kFull, 1.5),
     false,
     {.2119, .1752, .1264, .0912, .0680, .0532, .0437, .0377, .0340, .0319, .0313},
     .0783,
     .0885},
    {model(TemporalRows::kFull, 2),
     false,
     {.2119, .1917, .1487, .1119, .0856, .0679, .0563, .0488, .0441, .0415, .0407},
     .0923,
     .1127},
    {model(TemporalRows::kNone),
     true,
     {.3334, .3275, .3102, .2833, .2494, .2119, .1743, .1404, .1135, .0963, .0903},
     .2119,
     .3022},
    {model(TemporalRows::kFirstOrder),
     true,
     {.3334, .2702, .2077, .1644, .1337, .1118, .0964, .0858, .0790, .0751, .0739},
     .1427,
     .1901},
    {model(TemporalRows::kFull, 0.5),
     true,
     {.3786, .2563, .1520, .0951, .0646, .0476, .0376, .0316, .0281, .0262, .0256},
     .0939,
     .0800},
    {model(TemporalRows::kFull, 1),
     true,
     {.3334, .2677, .1964, .1444, .1092, .0861, .0711, .0615, .0555, .0522, .0512},
     .1236,
     .1432},
    {model(TemporalRows::kFull, 2),
     true,
     {.2431, .2906, .2851, .2431, .1983, .1631, .1380, .1211, .1103, .1043, .1024},
     .1829,
     .2695},
};

TEST(PoissonTheory, QuadratureGivesTheTable) {
  for (const Column& column : kTable) {
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

PixelMap still(int w, int h) {
  PixelMap m(w, h);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) m.link(x, y, x, y);
  }
  return m;
}

PoissonSettings settings_of(const NoiseModel& m) {
  PoissonSettings s;
  s.norm = PoissonNorm::kL2;
  s.weights.alpha = float(m.alpha);
  s.weights.temporal = m.rows == TemporalRows::kNone ? 0 : 1;
  s.weights.mixed = m.rows == TemporalRows::kFull ? 1 : 0;
  return s;
}

// White noise on each row, without motion: the errors are white in the cosine basis, with the variances of the theory
// at its frequencies.
TEST(PoissonTheory, TheSolverHasTheErrorOfIndependentNoise) {
  const MotionRuns runs{still(kSize, kSize)};
  for (const Column& column : kTable) {
    if (column.replayed) continue;
    const NoiseModel& m = column.model;
    test::Window window(kSize, kSize, kFrames);
    for (int t = 0; t + 1 < kFrames; ++t) window.frames[std::size_t(t)]->motion = runs;
    test::set_data(window, [&](RowSet set, std::uint64_t address) {
      const double variance = set == RowSet::kPrimal ? m.primal
                              : set <= RowSet::kDy   ? m.gradient
                                                     : m.ratio * m.gradient;
      return std::sqrt(variance) * test::normal(17, address);
    });
    PlanarFrames x = test::primal_data(window);
    ASSERT_TRUE(solve_poisson(window.span(), settings_of(m), x).direct);

    std::array<double, kFrames> power{};
    const CosineTransform transform(kFrames);
    CosineTransform::Scratch scratch;
    std::vector<float> series(std::size_t(kFrames) * CosineTransform::kLanes);
    for (int y = 0; y < kSize; ++y) {
      for (int x0 = 0; x0 < kSize; x0 += CosineTransform::kLanes) {
        for (int c = 0; c < 3; ++c) {
          for (int t = 0; t < kFrames; ++t) {
            std::copy_n(x.row(t, y, c) + x0, CosineTransform::kLanes,
                        &series[std::size_t(t * CosineTransform::kLanes)]);
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
      EXPECT_NEAR(power[std::size_t(k)] / kCount, expected, 4.5 * sigma) << "mode " << k;
      EXPECT_LT(4.5 * sigma, 0.25 * expected) << "the test can tell";
    }
  }
}

// Two passes of half the samples each, where O_(t+1) shares most of its noise with B_t, as replayed random numbers make
// it. Frames in the middle of a long window stand for an endless sequence.
TEST(PoissonTheory, TheSolverHasTheErrorOfReplayedNoise) {
  constexpr int kWidth = 32, kLong = 96, kMargin = 16;
  const MotionRuns runs{still(kWidth, kWidth)};
  for (const Column& column : kTable) {
    if (!column.replayed) continue;
    const NoiseModel& m = column.model;
    // Noise of pass `offset` of frame t in the data of `set`: that of the stream t or t - 1, and some of its own.
    const auto noise = [&](RowSet set, bool offset, int t, int y, int x, int c) {
      const double variance = 2 * (set == RowSet::kPrimal ? m.primal : m.gradient);
      const double q = set == RowSet::kPrimal ? m.ratio * m.gradient / (2 * m.primal) : m.ratio / 2;
      const auto address = [&](int stream, int part) {
        return ((((std::uint64_t(stream + 1) * 4 + std::uint64_t(part)) * 3 + std::uint64_t(set)) * 3 +
                 std::uint64_t(c)) *
                    kWidth +
                std::uint64_t(y)) *
                   kWidth +
               std::uint64_t(x);
      };
      return std::sqrt(variance) * (std::sqrt(1 - q) * test::normal(23, address(offset ? t - 1 : t, 0)) +
                                    std::sqrt(q) * test::normal(23, address(t, offset ? 1 : 2)));
    };
    test::Window window(kWidth, kWidth, kLong);
    for (int t = 0; t < kLong; ++t) {
      PoissonFrame& f = *window.frames[std::size_t(t)];
      if (t + 1 < kLong) f.motion = runs;
      test::for_each_row(f, t + 1 == kLong, [&](RowSet set, int y, int x, int, int) {
        const RowSet image = set >= RowSet::kDt ? RowSet(int(set) - int(RowSet::kDt)) : set;
        for (int c = 0; c < 3; ++c) {
          f.data(set, y, c)[x] = set >= RowSet::kDt
                                     ? float(noise(image, true, t + 1, y, x, c) - noise(image, false, t, y, x, c))
                                     : float(0.5 * (noise(image, true, t, y, x, c) + noise(image, false, t, y, x, c)));
        }
      });
    }
    PlanarFrames x = test::primal_data(window);
    ASSERT_TRUE(solve_poisson(window.span(), settings_of(m), x).direct);

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
