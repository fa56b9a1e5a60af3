// SPDX-License-Identifier: Apache-2.0
#pragma once
// The error of a reconstruction over temporal frequencies when noise is white [Manzi 2016, Sec. 3.4], in closed form.
//
// Symbols: |eps_F|^2 -> primal, |eps_G|^2 -> gradient, c -> ratio, |D_x|^2 + |D_y|^2 -> s.
#include <array>
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

/// The least error of any unbiased linear reconstruction from the same passes: their half sum and their difference have
/// independent noise, and are weighted by their variances as data of their own.
inline double least_replayed_error(const NoiseModel& m, double s, double frequency) {
  const double q_primal = m.ratio * m.gradient / (2 * m.primal), q_gradient = m.ratio / 2;
  const double sum = 1 - difference_power(frequency) / 4, difference = difference_power(frequency);
  const auto precision = [&](double variance, double q) {
    return sum / (variance * (2 - q)) + difference / (4 * variance * q);
  };
  return 1 / (precision(m.primal, q_primal) + s * precision(m.gradient, q_gradient));
}

/// Mean of f(s) over all spatial frequencies: the integral by the midpoint rule, which converges exponentially for
/// periodic functions, or with `cosine` the mean over the n x n modes of a picture of n pixels with free ends.
template <class F>
double spatial_mean(int n, bool cosine, F&& f) {
  std::vector<double> power;
  power.reserve(std::size_t(n));
  for (int k = 0; k < n; ++k) power.push_back(difference_power(cosine ? 0.5 * k / n : (k + 0.5) / n));
  double sum = 0;
  for (const double x : power) {
    for (const double y : power) sum += f(x + y);
  }
  return sum / (double(n) * n);
}

inline NoiseModel model(TemporalRows rows, double ratio = 1) {
  NoiseModel m;
  m.rows = rows, m.ratio = ratio;
  return m;
}

/// Errors in thousandths at frequencies 0, 0.05, ... 0.5, their mean over all, and the variance of differences of
/// consecutive frames.
struct TheoryColumn {
  const char* name;
  NoiseModel model;
  bool replayed;  ///< as replayed_error, else as independent_error
  std::array<double, 11> at;
  double mean, difference;
};

/// To four places; each agrees with a simulation that shares no code with this program.
inline const TheoryColumn kTheory[] = {
    {"independent, spatial rows",
     model(TemporalRows::kNone),
     false,
     {.2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119, .2119},
     .2119,
     .4238},
    {"independent, first order",
     model(TemporalRows::kFirstOrder),
     false,
     {.2119, .1710, .1325, .1069, .0889, .0761, .0670, .0606, .0565, .0541, .0533},
     .0946,
     .1321},
    {"independent, c = 0.5",
     model(TemporalRows::kFull, 0.5),
     false,
     {.2119, .1421, .0818, .0496, .0329, .0238, .0186, .0155, .0137, .0127, .0124},
     .0501,
     .0401},
    {"independent, c = 1",
     model(TemporalRows::kFull, 1),
     false,
     {.2119, .1586, .1041, .0704, .0505, .0385, .0312, .0266, .0238, .0223, .0219},
     .0642,
     .0643},
    {"independent, c = 1.5",
     model(TemporalRows::kFull, 1.5),
     false,
     {.2119, .1752, .1264, .0912, .0680, .0532, .0437, .0377, .0340, .0319, .0313},
     .0783,
     .0885},
    {"independent, c = 2",
     model(TemporalRows::kFull, 2),
     false,
     {.2119, .1917, .1487, .1119, .0856, .0679, .0563, .0488, .0441, .0415, .0407},
     .0923,
     .1127},
    {"replayed, spatial rows",
     model(TemporalRows::kNone),
     true,
     {.3334, .3275, .3102, .2833, .2494, .2119, .1743, .1404, .1135, .0963, .0903},
     .2119,
     .3022},
    {"replayed, first order",
     model(TemporalRows::kFirstOrder),
     true,
     {.3334, .2702, .2077, .1644, .1337, .1118, .0964, .0858, .0790, .0751, .0739},
     .1427,
     .1901},
    {"replayed, c = 0.5",
     model(TemporalRows::kFull, 0.5),
     true,
     {.3786, .2563, .1520, .0951, .0646, .0476, .0376, .0316, .0281, .0262, .0256},
     .0939,
     .0800},
    {"replayed, c = 1",
     model(TemporalRows::kFull, 1),
     true,
     {.3334, .2677, .1964, .1444, .1092, .0861, .0711, .0615, .0555, .0522, .0512},
     .1236,
     .1432},
    {"replayed, c = 2",
     model(TemporalRows::kFull, 2),
     true,
     {.2431, .2906, .2851, .2431, .1983, .1631, .1380, .1211, .1103, .1043, .1024},
     .1829,
     .2695},
};

}  // namespace tempera::test
