// SPDX-License-Identifier: Apache-2.0
#pragma once
// Means over the pixels of a picture that do not depend on the number of threads; private to the module.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/core/parallel.h"
#include "tempera/measure/metrics.h"

namespace tempera {

inline constexpr int kRowGrain = 8;  ///< rows a task

/// Errors: Error{kBadInput} unless both have the same size, and some.
inline void check_sizes(const Image& test, const Image& reference) {
  if (test.width() != reference.width() || test.height() != reference.height() || test.empty()) {
    throw Error(ErrorCode::kBadInput, fmt::format("cannot compare {}x{} pixels with a reference of {}x{}", test.width(),
                                                  test.height(), reference.width(), reference.height()));
  }
}

/// Mean of value(x, y) over the pixels where it is not NaN, without the `trim` of them (a part in [0,1), rounded down
/// to whole pixels) that have the largest values. `map`, if given, receives the values, and 0 where there is none. Rows
/// are summed apart and then in order.
template <class F>
PixelMean mean_over_pixels(int width, int height, Image* map, double trim, F&& value) {
  Image local;
  if (!map && trim > 0) map = &local;
  if (map) *map = Image(width, height, 1);
  struct Row {
    double sum = 0;
    std::int64_t count = 0;
  };
  std::vector<Row> rows(height);
  Grid<float> values = trim > 0 ? Grid<float>(width, height) : Grid<float>();
  parallel_rows(
      0, height,
      [&](int y) {
        Row row;
        float* const out = map ? map->row(y) : nullptr;
        for (int x = 0; x < width; ++x) {
          const double v = value(x, y);
          if (trim > 0) values.at(x, y) = float(v);
          if (std::isnan(v)) continue;
          if (out) out[x] = float(v);
          row.sum += v;
          ++row.count;
        }
        rows[y] = row;
      },
      kRowGrain);
  Row total;
  for (const Row& r : rows) total.sum += r.sum, total.count += r.count;
  PixelMean mean;
  mean.coverage = double(total.count) / (double(width) * double(height));
  if (total.count == 0) return mean;
  const auto dropped = std::int64_t(trim * double(total.count));
  if (dropped > 0) {
    const auto end = std::remove_if(values.begin(), values.end(), [](float v) { return std::isnan(v); });
    const std::int64_t kept = total.count - dropped;
    std::nth_element(values.begin(), values.begin() + (kept - 1), end);
    total = {};
    for (std::int64_t i = 0; i < kept; ++i) total.sum += double(values[i]);
    total.count = kept;
  }
  mean.value = total.sum / double(total.count);
  return mean;
}

}  // namespace tempera
