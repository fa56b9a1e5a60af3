// SPDX-License-Identifier: Apache-2.0
#include "row_weights.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

constexpr int kRadius = 2;

/// Mean over the valid pixels around each but itself, [h,w,1]; negative where there are none.
template <class Valid>
Image mean_around(const Image& values, Valid&& valid) {
  const int w = values.width(), h = values.height();
  Image out(w, h, 1);
  parallel_rows(
      0, h,
      [&](int y) {
        for (int x = 0; x < w; ++x) {
          float sum = 0;
          int count = 0;
          for (int v = std::max(0, y - kRadius); v <= std::min(h - 1, y + kRadius); ++v) {
            for (int u = std::max(0, x - kRadius); u <= std::min(w - 1, x + kRadius); ++u) {
              if (!valid(u, v) || (u == x && v == y)) continue;
              sum += values.at(u, v);
              ++count;
            }
          }
          out.at(x, y) = count > 0 ? sum / float(count) : -1.0f;
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

void append_known(const Image& variance, std::vector<float>& out) {
  const auto values = variance.values();
  std::copy_if(values.begin(), values.end(), std::back_inserter(out), [](float v) { return v >= 0; });
}

/// Of spatial rows. Below it primal rows, which are far noisier where differences are, would count more than those.
constexpr double kLeastPrecision = 0.04;

/// Precisions of variances: 1 at the reference, and where nothing is known.
void store_weights(PoissonFrame& frame, RowSet set, const Image& variance, double reference, PoissonNorm norm) {
  const int w = frame.width();
  std::vector<float> row(w, 1.0f);
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < w; ++x) {
      const double v = double(variance.at(x, y));
      double precision = v >= 0 && reference > 0 ? 2 * reference / (v + reference) : 1;
      if (set <= RowSet::kDy) precision = std::max(precision, kLeastPrecision);
      row[x] = float(norm == PoissonNorm::kL1 ? std::sqrt(precision) : precision);
    }
    frame.set_precision(set, y, row);
  }
}

}  // namespace

double set_spatial_precision(PoissonFrame& frame, const DataVariance& variance, PoissonNorm norm) {
  const auto smooth = [](const Image& image) {
    return mean_around(image, [&](int x, int y) { return image.at(x, y) >= 0; });
  };
  const Image dx = smooth(variance.dx), dy = smooth(variance.dy);
  std::vector<float> known;
  append_known(dx, known), append_known(dy, known);
  const double reference = median(std::move(known));
  store_weights(frame, RowSet::kPrimal, Image(frame.width(), frame.height(), 1, -1), reference, norm);
  store_weights(frame, RowSet::kDx, dx, reference, norm);
  store_weights(frame, RowSet::kDy, dy, reference, norm);
  return reference;
}

void set_temporal_precision(PoissonFrame& frame, double reference, PoissonNorm norm) {
  const int w = frame.width(), h = frame.height();
  const auto mean_square = [&](RowSet set) {
    Image square(w, h, 1);
    Grid<std::uint8_t> valid(w, h);
    for (int y = 0; y < h; ++y) {
      const float *r = frame.data(set, y, 0), *g = frame.data(set, y, 1), *b = frame.data(set, y, 2);
      for (const MotionRun& run : frame.motion.from_row(y)) {
        const int count = set == RowSet::kDt     ? run.length
                          : set == RowSet::kDxDt ? run.mixed_x
                                                 : run.mixed_y * run.length;
        for (int x = run.x; x < run.x + count; ++x) {
          valid.at(x, y) = 1;
          square.at(x, y) = (r[x] * r[x] + g[x] * g[x] + b[x] * b[x]) / 3;
        }
      }
    }
    Image mean = mean_around(square, [&](int x, int y) { return valid.at(x, y) != 0; });
    for (std::size_t i = 0; i < valid.size(); ++i) {
      if (!valid[i]) mean.values()[i] = -1;
    }
    return mean;
  };
  const Image dt = mean_square(RowSet::kDt), dxdt = mean_square(RowSet::kDxDt), dydt = mean_square(RowSet::kDyDt);
  if (reference <= 0) {
    std::vector<float> known;  // those of second order are as noisy as the spatial ones, those of first order noisier
    append_known(dxdt, known), append_known(dydt, known);
    if (known.empty()) append_known(dt, known);  // those of second order are not used
    reference = median(std::move(known));
  }
  store_weights(frame, RowSet::kDt, dt, reference, norm);
  store_weights(frame, RowSet::kDxDt, dxdt, reference, norm);
  store_weights(frame, RowSet::kDyDt, dydt, reference, norm);
}

}  // namespace tempera
