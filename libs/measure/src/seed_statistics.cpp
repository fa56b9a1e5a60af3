// SPDX-License-Identifier: Apache-2.0
#include "seed_statistics.h"

#include <cmath>
#include <limits>

#include "pixel_mean.h"

namespace tempera {
namespace {

struct Sums {
  explicit Sums(std::size_t runs) : own(runs), with_sum(runs) {}
  std::vector<double> own;       ///< <E_i, E_i>
  std::vector<double> with_sum;  ///< <S, E_i>
  std::int64_t pixels = 0;

  double of_sum() const {  // <S, S>
    double sum = 0;
    for (const double v : with_sum) sum += v;
    return sum;
  }
};

/// bias^2 and variance, per value, of `runs` runs with the sum of <E_i,E_i> `own` and <S,S> `of_sum`.
std::pair<double, double> estimate(double runs, double own, double of_sum, double values) {
  const double pairs = runs * (runs - 1) * values;
  return {(of_sum - own) / pairs, (runs * own - of_sum) / pairs};
}

}  // namespace

BiasVariance bias_and_variance(std::span<const Image* const> runs, const Image& reference, double epsilon) {
  for (const Image* r : runs) check_sizes(*r, reference);
  const std::size_t count = runs.size();
  std::vector<Sums> rows(reference.height(), Sums(count));
  parallel_rows(
      0, reference.height(),
      [&](int y) {
        Sums& row = rows[y];
        std::vector<Rgb> errors(count);
        for (int x = 0; x < reference.width(); ++x) {
          const Rgb r = reference.rgb(x, y);
          Rgb sum(0.0f);
          for (std::size_t i = 0; i < count; ++i) errors[i] = runs[i]->rgb(x, y) - r, sum += errors[i];
          if (!is_finite(sum)) continue;
          ++row.pixels;
          for (int c = 0; c < 3; ++c) {
            const double weight = 1 / (double(r[c]) * double(r[c]) + epsilon);
            for (std::size_t i = 0; i < count; ++i) {
              const double e = errors[i][c];
              row.own[i] += weight * e * e;
              row.with_sum[i] += weight * e * double(sum[c]);
            }
          }
        }
      },
      kRowGrain);
  Sums total(count);
  for (const Sums& row : rows) {
    for (std::size_t i = 0; i < count; ++i) total.own[i] += row.own[i], total.with_sum[i] += row.with_sum[i];
    total.pixels += row.pixels;
  }

  BiasVariance result;
  const double values = total.pixels > 0 ? 3 * double(total.pixels) : std::numeric_limits<double>::quiet_NaN();
  double own = 0;
  for (const double v : total.own) own += v;
  const double of_sum = total.of_sum();
  std::tie(result.bias_squared, result.variance) = estimate(double(count), own, of_sum, values);
  for (std::size_t i = 0; i < count && count > 2; ++i) {
    const auto [bias, variance] =
        estimate(double(count - 1), own - total.own[i], of_sum - 2 * total.with_sum[i] + total.own[i], values);
    result.bias_squared_without.push_back(bias);
    result.variance_without.push_back(variance);
  }
  return result;
}

MeanError jackknife(std::span<const double> estimates, std::span<const std::vector<double>> without) {
  MeanError result;
  result.mean = mean_error(estimates).mean;
  const std::size_t runs = without.empty() ? 0 : without[0].size();
  if (runs < 2) return result;
  std::vector<double> means(runs);
  for (const std::vector<double>& frame : without) {
    for (std::size_t i = 0; i < runs; ++i) means[i] += frame[i] / double(without.size());
  }
  const MeanError spread = mean_error(means);
  // The means without one run vary less than the estimate itself, by the factor runs - 1.
  result.standard_error = spread.standard_error * double(runs - 1);
  result.count = int(runs);
  return result;
}

}  // namespace tempera
