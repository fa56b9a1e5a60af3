// SPDX-License-Identifier: Apache-2.0
#pragma once
// The error of a reconstruction over temporal frequencies when noise is white [Manzi 2016, Sec. 3.4], in closed form.
//
// Symbols: |eps_F|^2 -> primal, |eps_G|^2 -> gradient, c -> ratio, |D_x|^2 + |D_y|^2 -> s.
#include <cmath>
#include <complex>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera::test {

enum class TemporalRows { kNone, kFirstOrder, kFull };

struct NoiseModel {
  double primal = 0.01, gradient = 0.0004, alpha = 0.2;  ///< variances of data, weight of the primal rows
  double ratio = 1;                                      ///< variance of temporal and mixed to that of spatial data
  TemporalRows rows = TemporalRows::kFull;
};

/// |D|^2 of a difference at a frequency in cycles a pixel or frame.
inline double difference_power(double frequency) { return 2 - 2 * std::cos(2 * kPiD * frequency); }

/// Sum of the powers of the temporal and mixed rows.
inline double temporal_power(const NoiseModel& m, double s, double frequency) {
  const double t = difference_power(frequency);
  return m.rows == TemporalRows::kNone ? 0 : m.rows == TemporalRows::kFirstOrder ? t : t * (1 + s);
}

/// Mean squared error at one frequency when all rows have independent noise: [Manzi 2016, Eq. 4] with its c.
inline double independent_error(const NoiseModel& m, double s, double frequency) {
  const double a2 = m.alpha * m.alpha, t = temporal_power(m, s, frequency);
  return (a2 * a2 * m.primal + m.gradient * (s + m.ratio * t)) / ((a2 + s + t) * (a2 + s + t));
}

/// The same when the primal and spatial data are means of a base and an offset pass of half the samples each, and the
/// temporal data are differences of the same passes: the correlation of B_t and O_(t+1) is 1 - q.
inline double replayed_error(const NoiseModel& m, double s, double frequency) {
  const double a2 = m.alpha * m.alpha;
  const double q_primal = m.ratio * m.gradient / (2 * m.primal), q_gradient = m.ratio / 2;
  const std::complex<double> z = std::polar(1.0, 2 * kPiD * frequency);
  const std::complex<double> first = m.rows == TemporalRows::kNone ? 0.0 : std::conj(z) - 1.0;
  const std::complex<double> mixed = m.rows == TemporalRows::kFull ? std::conj(z) - 1.0 : 0.0;
  const double mean = std::norm(1.0 + std::conj(z)) / 4;
  // Noise that B_t and O_(t+1) share cancels in their difference; what they do not share enters both terms.
  const auto own = [&](double weight, std::complex<double> d) {
    return std::norm(0.5 * weight - d) + std::norm(0.5 * weight + z * d);
  };
  const double numerator = 2 * m.primal * ((1 - q_primal) * a2 * a2 * mean + q_primal * own(a2, first)) +
                           2 * m.gradient * s * ((1 - q_gradient) * mean + q_gradient * own(1, mixed));
  const double denominator = a2 + s + temporal_power(m, s, frequency);
  return numerator / (denominator * denominator);
}

/// Mean of f(s) over all spatial frequencies: the integral by the midpoint rule, which converges exponentially for
/// periodic functions, or with `cosine` the mean over the n x n modes of a picture of n pixels with free ends.
template <class F>
double spatial_mean(int n, bool cosine, F&& f) {
  std::vector<double> power;
  for (int k = 0; k < n; ++k) power.push_back(difference_power(cosine ? 0.5 * k / n : (k + 0.5) / n));
  double sum = 0;
  for (const double x : power) {
    for (const double y : power) sum += f(x + y);
  }
  return sum / (double(n) * n);
}

}  // namespace tempera::test
