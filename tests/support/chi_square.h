// SPDX-License-Identifier: Apache-2.0
#pragma once
// Chi-square test of a direction sampler against its density over the whole sphere.
#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera::test {

/// Probability that a chi-square variable with `degrees` degrees of freedom exceeds x: the regularised incomplete gamma
/// function Q(degrees/2, x/2), by its series or its continued fraction (Lentz).
inline double chi_square_tail(double x, double degrees) {
  const double a = degrees / 2;
  x /= 2;
  if (x <= 0) return 1;
  const double front = std::exp(-x + a * std::log(x) - std::lgamma(a));
  if (x < a + 1) {
    double term = 1 / a, sum = term;
    for (double n = a + 1; std::abs(term) > 1e-15 * sum; ++n) sum += term *= x / n;
    return 1 - sum * front;
  }
  double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
  for (int i = 1; i < 10000; ++i) {
    const double an = -i * (i - a);
    b += 2;
    d = 1 / (an * d + b);
    c = b + an / c;
    h *= d * c;
    if (std::abs(d * c - 1) < 1e-14) break;
  }
  return front * h;
}

struct ChiSquareResult {
  double p_value;
  std::string report;
};

/// Histogram of `count` samples over cells in (cos theta, phi) plus one for "no direction", against the density
/// integrated over each cell (`nodes`^2 Gauss-Legendre points). Cells that expect fewer than 5 samples are pooled.
/// `sample` takes the index of the sample. The density may be wrong by a common factor within `factor_error` of 1.
inline ChiSquareResult chi_square(const std::function<std::optional<Vec3f>(int)>& sample,
                                  const std::function<float(const Vec3f&)>& density, int count, int nodes = 10,
                                  double factor_error = 0) {
  constexpr int kCos = 24, kPhi = 40;
  const auto cell = [](int a, int b) { return std::size_t(a) * kPhi + std::size_t(b); };
  std::vector<double> expected(kCos * kPhi + 1), observed(kCos * kPhi + 1);
  for (int i = 0; i < count; ++i) {
    const auto w = sample(i);
    if (!w) {
      ++observed.back();
      continue;
    }
    const int a = std::clamp(int((w->z + 1) / 2 * kCos), 0, kCos - 1);
    double phi = std::atan2(w->y, w->x);
    if (phi < 0) phi += 2 * kPiD;
    ++observed[cell(a, std::clamp(int(phi / (2 * kPiD) * kPhi), 0, kPhi - 1))];
  }
  std::vector<double> x(static_cast<std::size_t>(nodes)), weight(x.size());
  for (int i = 0; i < nodes; ++i) {  // Gauss-Legendre on [0,1]
    double t = std::cos(kPiD * (i + 0.75) / (nodes + 0.5)), dp = 1;
    for (int step = 0; step < 8; ++step) {
      double p0 = 1, p1 = t;
      for (int k = 2; k <= nodes; ++k) p0 = std::exchange(p1, ((2 * k - 1) * t * p1 - (k - 1) * p0) / k);
      dp = nodes * (t * p1 - p0) / (t * t - 1);
      t -= p1 / dp;
    }
    x[i] = (1 - t) / 2;
    weight[i] = 1 / ((1 - t * t) * dp * dp);
  }
  double total = 0;
  for (int a = 0; a < kCos; ++a)
    for (int b = 0; b < kPhi; ++b) {
      double sum = 0;
      for (std::size_t i = 0; i < x.size(); ++i)
        for (std::size_t j = 0; j < x.size(); ++j) {
          const double z = -1 + 2 * (a + x[i]) / kCos, phi = 2 * kPiD * (b + x[j]) / kPhi;
          const double r = std::sqrt(1 - z * z);
          sum += weight[i] * weight[j] * double(density(Vec3f(Vec3d{r * std::cos(phi), r * std::sin(phi), z})));
        }
      sum *= 4 * kPiD / (kCos * kPhi);
      total += sum;
      expected[cell(a, b)] = sum * count;
    }
  if (factor_error > 0) {
    const double factor = std::clamp((count - observed.back()) / (total * count), 1 - factor_error, 1 + factor_error);
    for (double& e : expected) e *= factor;
    total *= factor;
  }
  expected.back() = std::max(1 - total, 0.0) * count;

  std::vector<std::size_t> order(expected.size());
  std::iota(order.begin(), order.end(), std::size_t(0));
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return expected[a] < expected[b]; });
  double statistic = 0, pooled_expected = 0, pooled_observed = 0;
  int cells = 0;
  const auto add = [&](double e, double o) { statistic += (o - e) * (o - e) / e, ++cells; };
  for (const std::size_t i : order) {
    if (expected[i] >= 5 && (pooled_expected == 0 || pooled_expected >= 5)) {
      if (pooled_expected > 0) add(pooled_expected, pooled_observed), pooled_expected = pooled_observed = 0;
      add(expected[i], observed[i]);
    } else {
      pooled_expected += expected[i], pooled_observed += observed[i];
    }
  }
  if (pooled_expected >= 5)
    add(pooled_expected, pooled_observed);
  else if (pooled_observed > 5 + 10 * pooled_expected)
    statistic = 1e9;  // samples where there should be none
  ChiSquareResult result;
  result.p_value = cells > 1 ? chi_square_tail(statistic, cells - 1) : (statistic > 100 ? 0.0 : 1.0);
  std::ostringstream s;
  s << "chi^2 " << statistic << " in " << cells << " cells, integral of the density " << total << ", p "
    << result.p_value;
  result.report = s.str();
  return result;
}

}  // namespace tempera::test
