// SPDX-License-Identifier: Apache-2.0
#pragma once
// Tests of hypotheses for the samplers of this module. `alpha` is the false-alarm rate of one comparison; seeds are
// fixed, so a test that passes once passes always.
#include <gtest/gtest.h>

#include <cmath>
#include <span>
#include <vector>

#include "support/chi_square.h"

namespace tempera::test {

/// Passes unless counts differ from `expected` (two-sided: counts that fit too well fail as well, unless `stratified`).
/// Cells expected below 5 are pooled.
inline testing::AssertionResult CountsFit(std::span<const double> expected, std::span<const double> counts,
                                          bool stratified = false, double alpha = 1e-4) {
  double chi2 = 0, pooled_expected = 0, pooled_count = 0;
  int cells = 0;
  const auto add = [&](double e, double c) { chi2 += (c - e) * (c - e) / e, ++cells; };
  for (std::size_t i = 0; i < expected.size(); ++i) {
    if (expected[i] >= 5) {
      add(expected[i], counts[i]);
    } else {
      pooled_expected += expected[i], pooled_count += counts[i];
    }
  }
  if (pooled_expected > 0) {
    add(pooled_expected, pooled_count);
  } else if (pooled_count > 0) {
    return testing::AssertionFailure() << pooled_count << " counts where none can be";
  }
  const double p = chi_square_tail(chi2, cells - 1);
  if (p > alpha && (stratified || p < 1 - alpha)) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "chi2 " << chi2 << " with " << cells - 1 << " degrees of freedom, p = " << p;
}

/// Passes unless the mean of independent values differs from `expected` (two-sided z-test).
inline testing::AssertionResult MeanIs(double expected, std::span<const double> x, double alpha = 1e-4) {
  const double n = double(x.size());
  double mean = 0, m2 = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double d = x[i] - mean;
    mean += d / double(i + 1);
    m2 += d * (x[i] - mean);
  }
  const double error = std::sqrt(m2 / (n - 1) / n), z = (mean - expected) / error;
  if (n >= 30 && std::erfc(std::abs(z) / std::sqrt(2.0)) > alpha) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "mean " << mean << " +- " << error << " (n = " << n << "), expected "
                                     << expected << ", z = " << z;
}

/// Passes unless two equally long series of independent pairs of values are correlated.
inline testing::AssertionResult Uncorrelated(std::span<const double> x, std::span<const double> y,
                                             double alpha = 1e-4) {
  const double n = double(x.size());
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  for (std::size_t i = 0; i < x.size(); ++i) mx += x[i] / n, my += y[i] / n;
  for (std::size_t i = 0; i < x.size(); ++i) {
    xx += (x[i] - mx) * (x[i] - mx), yy += (y[i] - my) * (y[i] - my), xy += (x[i] - mx) * (y[i] - my);
  }
  const double r = xy / std::sqrt(xx * yy), z = r * std::sqrt(n);
  if (n >= 100 && std::erfc(std::abs(z) / std::sqrt(2.0)) > alpha) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "correlation " << r << " of " << n << " pairs, z = " << z;
}

}  // namespace tempera::test
