// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/metrics.h"

#include <fmt/format.h>

#include <vector>

#include "tempera/core/parallel.h"

namespace tempera {
namespace {

constexpr int kGrain = 8;  ///< rows a task

void check_sizes(const Image& test, const Image& reference) {
  if (test.width() != reference.width() || test.height() != reference.height() || test.empty()) {
    throw Error(ErrorCode::kBadInput, fmt::format("cannot compare {}x{} pixels with a reference of {}x{}", test.width(),
                                                  test.height(), reference.width(), reference.height()));
  }
}

/// Mean of `error(test, reference)`, an Rgb, over the pixels whose values are finite. Rows are summed apart and then in
/// order, so that threads cannot change the result.
template <class F>
double mean_error(const Image& test, const Image& reference, Image* map, F&& error) {
  check_sizes(test, reference);
  const int w = test.width(), h = test.height();
  if (map) *map = Image(w, h, 1);
  std::vector<double> sums(static_cast<std::size_t>(h));
  std::vector<std::int64_t> counts(static_cast<std::size_t>(h));
  parallel_for(
      0, h,
      [&](std::int64_t y) {
        double sum = 0;
        std::int64_t count = 0;
        for (int x = 0; x < w; ++x) {
          const Rgb t = test.rgb(x, int(y)), r = reference.rgb(x, int(y));
          if (!is_finite(t) || !is_finite(r)) continue;
          double e = 0;
          for (int c = 0; c < 3; ++c) e += error(double(t[c]), double(r[c]));
          e /= 3;
          if (map) map->at(x, int(y)) = float(e);
          sum += e;
          ++count;
        }
        sums[std::size_t(y)] = sum, counts[std::size_t(y)] = count;
      },
      kGrain);
  double sum = 0;
  std::int64_t count = 0;
  for (std::size_t y = 0; y < sums.size(); ++y) sum += sums[y], count += counts[y];
  return count > 0 ? sum / double(count) : 0;
}
}  // namespace

double mse(const Image& test, const Image& reference, Image* map) {
  return mean_error(test, reference, map, [](double t, double r) { return (t - r) * (t - r); });
}

double relative_mse(const Image& test, const Image& reference, Image* map, double epsilon) {
  return mean_error(test, reference, map, [=](double t, double r) { return (t - r) * (t - r) / (r * r + epsilon); });
}

std::int64_t count_non_finite(const Image& image) {
  std::int64_t count = 0;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) count += !is_finite(image.rgb(x, y));
  }
  return count;
}

}  // namespace tempera
