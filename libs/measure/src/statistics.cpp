// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/statistics.h"

#include <cmath>
#include <numbers>

#include "tempera/core/error.h"

namespace tempera {
namespace {

/// P(|T| <= t) by the finite series for whole degrees of freedom [Abramowitz 1964, Eqs. 26.7.3 and 26.7.4].
double probability_within(double t, int degrees_of_freedom) {
  const double angle = std::atan(t / std::sqrt(double(degrees_of_freedom)));
  const double sine = std::sin(angle), cosine2 = std::cos(angle) * std::cos(angle);
  const bool odd = degrees_of_freedom % 2 != 0;
  double term = odd ? std::cos(angle) : 1, sum = 0;
  for (int k = odd ? 3 : 2; k <= degrees_of_freedom; k += 2) {
    sum += term;
    term *= cosine2 * double(k - 1) / double(k);
  }
  return odd ? (angle + sine * sum) * 2 / std::numbers::pi : sine * sum;
}

}  // namespace

double student_t_95(int degrees_of_freedom) {
  TEMPERA_ASSERT(degrees_of_freedom >= 1);
  double low = 1.9, high = 13;  // the quantiles lie between 1.96 (many) and 12.71 (one)
  while (high - low > 1e-12 * high) {
    const double middle = (low + high) / 2;
    (probability_within(middle, degrees_of_freedom) < 0.95 ? low : high) = middle;
  }
  return (low + high) / 2;
}

double MeanError::confidence_95() const {
  return count > 1 ? student_t_95(count - 1) * standard_error : std::numeric_limits<double>::quiet_NaN();
}

MeanError mean_error(std::span<const double> values) {
  MeanError r;
  double mean = 0, squares = 0;
  for (const double v : values) {  // Welford: stable for long runs
    if (std::isnan(v)) continue;
    ++r.count;
    const double d = v - mean;
    mean += d / r.count;
    squares += d * (v - mean);
  }
  if (r.count > 0) r.mean = mean;
  if (r.count > 1) r.standard_error = std::sqrt(squares / (r.count - 1) / r.count);
  return r;
}

}  // namespace tempera
