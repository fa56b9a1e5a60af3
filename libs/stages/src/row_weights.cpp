// SPDX-License-Identifier: Apache-2.0
#include "row_weights.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

#include "tempera/core/parallel.h"

namespace tempera {
namespace {

constexpr int kRadius = 2;

/// Mean over the valid pixels around each but itself, [h,w]; negative where there are none.
template <class Valid>
std::vector<float> mean_around(int w, int h, const std::vector<float>& values, Valid&& valid) {
  std::vector<float> out(values.size());
  const auto index = [w](int x, int y) { return std::size_t(y) * std::size_t(w) + std::size_t(x); };
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        for (int x = 0; x < w; ++x) {
          float sum = 0;
          int count = 0;
          for (int v = std::max(0, y - kRadius); v <= std::min(h - 1, y + kRadius); ++v) {
            for (int u = std::max(0, x - kRadius); u <= std::min(w - 1, x + kRadius); ++u) {
              if (!valid(u, v) || (u == x && v == y)) continue;
              sum += values[index(u, v)];
              ++count;
            }
          }
          out[index(x, y)] = count > 0 ? sum / float(count) : -1.0f;
        }
      },
      8);
  return out;
}

double median(std::vector<float> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return double(*middle);
}

/// Of spatial rows. Below it primal rows, which are far noisier where differences are, would count more than those.
constexpr double kLeastPrecision = 0.04;

/// Precisions of variances: 1 at the reference, and where nothing is known.
void store_weights(PoissonFrame& frame, RowSet set, const std::vector<float>& variance, double reference,
                   PoissonNorm norm) {
  const int w = frame.width();
  std::vector<float> row(std::size_t(w), 1.0f);
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < w; ++x) {
      const double v = double(variance[std::size_t(y) * std::size_t(w) + std::size_t(x)]);
      double precision = v >= 0 && reference > 0 ? 2 * reference / (v + reference) : 1;
      if (set <= RowSet::kDy) precision = std::max(precision, kLeastPrecision);
      row[x] = float(norm == PoissonNorm::kL1 ? std::sqrt(precision) : precision);
    }
    frame.set_precision(set, y, row);
  }
}

}  // namespace

double set_spatial_precision(PoissonFrame& frame, const DataVariance& variance, PoissonNorm norm) {
  const int w = frame.width(), h = frame.height();
  const auto smooth = [&](const Image& image) {
    const std::vector<float> values(image.values().begin(), image.values().end());
    return mean_around(w, h, values, [&](int x, int y) { return image.at(x, y) >= 0; });
  };
  const std::vector<float> dx = smooth(variance.dx), dy = smooth(variance.dy);
  std::vector<float> both = dx;
  both.insert(both.end(), dy.begin(), dy.end());
  std::erase_if(both, [](float v) { return v < 0; });
  const double reference = median(std::move(both));
  store_weights(frame, RowSet::kPrimal, std::vector<float>(dx.size(), -1.0f), reference, norm);
  store_weights(frame, RowSet::kDx, dx, reference, norm);
  store_weights(frame, RowSet::kDy, dy, reference, norm);
  return reference;
}

void set_temporal_precision(PoissonFrame& frame, double reference, PoissonNorm norm) {
  const int w = frame.width(), h = frame.height();
  const auto index = [w](int x, int y) { return std::size_t(y) * std::size_t(w) + std::size_t(x); };
  const auto mean_square = [&](RowSet set) {
    std::vector<float> square(std::size_t(w) * std::size_t(h));
    std::vector<std::uint8_t> valid(square.size());
    for (int y = 0; y < h; ++y) {
      const float *r = frame.data(set, y, 0), *g = frame.data(set, y, 1), *b = frame.data(set, y, 2);
      for (const MotionRun& run : frame.motion.from_row(y)) {
        const int count = set == RowSet::kDt     ? run.length
                          : set == RowSet::kDxDt ? run.mixed_x
                                                 : run.mixed_y * run.length;
        for (int x = run.x; x < run.x + count; ++x) {
          valid[index(x, y)] = 1;
          square[index(x, y)] = (r[x] * r[x] + g[x] * g[x] + b[x] * b[x]) / 3;
        }
      }
    }
    std::vector<float> mean = mean_around(w, h, square, [&](int x, int y) { return valid[index(x, y)] != 0; });
    for (std::size_t i = 0; i < mean.size(); ++i) {
      if (!valid[i]) mean[i] = -1;
    }
    return mean;
  };
  const std::vector<float> dt = mean_square(RowSet::kDt), dxdt = mean_square(RowSet::kDxDt),
                           dydt = mean_square(RowSet::kDyDt);
  if (reference <= 0) {
    std::vector<float> both = dxdt;  // as noisy as the spatial ones, where those of first order are noisier
    both.insert(both.end(), dydt.begin(), dydt.end());
    std::erase_if(both, [](float v) { return v < 0; });
    if (both.empty()) {  // they are not used
      std::copy_if(dt.begin(), dt.end(), std::back_inserter(both), [](float v) { return v >= 0; });
    }
    reference = median(std::move(both));
  }
  store_weights(frame, RowSet::kDt, dt, reference, norm);
  store_weights(frame, RowSet::kDxDt, dxdt, reference, norm);
  store_weights(frame, RowSet::kDyDt, dydt, reference, norm);
}

}  // namespace tempera
