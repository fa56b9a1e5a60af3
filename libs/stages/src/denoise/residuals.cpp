// SPDX-License-Identifier: Apache-2.0
#include "denoise/residuals.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace tempera::denoise {

namespace {

constexpr int kBands = 4;               ///< and what is left below them
constexpr float kDark = 0.02f;          ///< added to the luminance by which residuals are divided, of the mean
constexpr int kRadius = 3, kMost = 24;  ///< of the averages of products, at the finest band, and at most

int mirrored(int i, int n) {
  if (n == 1) return 0;
  const int period = 2 * n - 2;
  i = std::abs(i) % period;
  return i < n ? i : period - i;
}

/// One step of the a-trous transform with a cubic B-spline: a smoother picture.
Planes smoothed(const Planes& in, int step) {
  constexpr float kTaps[5] = {1 / 16.0f, 4 / 16.0f, 6 / 16.0f, 4 / 16.0f, 1 / 16.0f};
  const int width = in.width(), height = in.height();
  Planes rows(width, height, in.channels()), out(width, height, in.channels());
  for_rows(height, [&](int y) {
    for (int c = 0; c < in.channels(); ++c) {
      const float* from = in.row(c, y);
      float* to = rows.row(c, y);
      const auto at_border = [&](int x) {
        float sum = 0;
        for (int i = -2; i <= 2; ++i) sum += kTaps[i + 2] * from[mirrored(x + i * step, width)];
        to[x] = sum;
      };
      const int inner = std::min(2 * step, width), last = std::max(width - 2 * step, inner);
      for (int x = 0; x < inner; ++x) at_border(x);
      for (int x = inner; x < last; ++x) {
        to[x] = kTaps[0] * (from[x - 2 * step] + from[x + 2 * step]) + kTaps[1] * (from[x - step] + from[x + step]) +
                kTaps[2] * from[x];
      }
      for (int x = last; x < width; ++x) at_border(x);
    }
  });
  for_rows(height, [&](int y) {
    for (int c = 0; c < in.channels(); ++c) {
      const float* r[5];
      for (int i = -2; i <= 2; ++i) r[i + 2] = rows.row(c, mirrored(y + i * step, height));
      float* to = out.row(c, y);
      for (int x = 0; x < width; ++x)
        to[x] = kTaps[0] * (r[0][x] + r[4][x]) + kTaps[1] * (r[1][x] + r[3][x]) + kTaps[2] * r[2][x];
    }
  });
  return out;
}

}  // namespace

Planes return_residuals(const ResidualInput& in, float margin) {
  const int width = in.clean.width(), height = in.clean.height();
  // Of the frame's mean, so that exposure does not matter.
  double sum = 0;
  for (const float v : in.clean.values()) sum += double(v);
  const float dark = kDark * float(std::max(sum / double(in.clean.values().size()), 1e-20));
  Planes bright(width, height, 1);
  for_rows(height, [&](int y) {
    const float *r = in.clean.row(0, y), *g = in.clean.row(1, y), *b = in.clean.row(2, y);
    float* to = bright.row(0, y);
    for (int x = 0; x < width; ++x) to[x] = luminance(r[x], g[x], b[x]);
  });
  Planes scale = box_mean(bright, 1);
  for (float& v : scale.values()) v = std::max(v, 0.0f) + dark;

  // Five residuals of three channels: of the whole, and of each half from each denoised half.
  enum { kWhole = 0, kBA = 3, kAA = 6, kAB = 9, kBB = 12, kAll = 15 };
  Planes residual(width, height, kAll);
  for_rows(height, [&](int y) {
    const float* s = scale.row(0, y);
    for (int c = 0; c < 3; ++c) {
      const float *a = in.a.row(c, y), *b = in.b.row(c, y), *da = in.clean_a.row(c, y), *db = in.clean_b.row(c, y),
                  *d = in.clean.row(c, y);
      for (int x = 0; x < width; ++x) {
        const float k = 1 / s[x];
        residual.row(kWhole + c, y)[x] = (0.5f * (a[x] + b[x]) - d[x]) * k;
        residual.row(kBA + c, y)[x] = (b[x] - da[x]) * k, residual.row(kAA + c, y)[x] = (a[x] - da[x]) * k;
        residual.row(kAB + c, y)[x] = (a[x] - db[x]) * k, residual.row(kBB + c, y)[x] = (b[x] - db[x]) * k;
      }
    }
  });

  Planes out = in.clean;
  for (int band = 0; band <= kBands; ++band) {
    Planes rest = band < kBands ? smoothed(residual, 1 << band) : Planes(width, height, kAll);
    for (std::size_t i = 0; i < rest.values().size(); ++i) residual.values()[i] -= rest.values()[i];
    Planes products(width, height, 3);  // between halves, their squares, and of the whole with itself
    for_rows(height, [&](int y) {
      float *num = products.row(0, y), *square = products.row(1, y), *den = products.row(2, y);
      for (int c = 0; c < 3; ++c) {
        const float *u = residual.row(kWhole + c, y), *ba = residual.row(kBA + c, y), *aa = residual.row(kAA + c, y),
                    *ab = residual.row(kAB + c, y), *bb = residual.row(kBB + c, y);
        for (int x = 0; x < width; ++x) {
          num[x] += (ba[x] * aa[x] + ab[x] * bb[x]) * (1 / 6.0f);
          den[x] += u[x] * u[x] * (1 / 3.0f);
        }
      }
      for (int x = 0; x < width; ++x) square[x] = num[x] * num[x];
    });
    const int radius = std::min(kRadius << band, kMost);
    const Planes mean = box_mean(products, radius);
    // Values of a band are alike over about its width, so that fewer of them are independent.
    const float area = float((2 * radius + 1) * (2 * radius + 1));
    const float count = std::max(area / (std::ldexp(1.0f, 2 * band) * (band == 0 ? 1.5f : 3.0f)), 2.0f);
    for_rows(height, [&](int y) {
      const float *num = mean.row(0, y), *square = mean.row(1, y), *den = mean.row(2, y), *s = scale.row(0, y);
      for (int x = 0; x < width; ++x) {
        const float deviation = std::sqrt(std::max(square[x] - num[x] * num[x], 0.0f) / count);
        const float w = std::clamp((num[x] - margin * deviation) / std::max(den[x], 1e-12f), 0.0f, 1.0f);
        for (int c = 0; c < 3; ++c) out.row(c, y)[x] += w * s[x] * residual.row(kWhole + c, y)[x];
      }
    });
    residual = std::move(rest);
  }
  return out;
}

}  // namespace tempera::denoise
