// SPDX-License-Identifier: Apache-2.0
// Errors of values, one picture at a time. What compares frames with those before is in temporal.cpp, FLIP in flip.cpp.
#include "tempera/measure/metrics.h"

#include <array>
#include <vector>

#include "display_values.h"
#include "pixel_mean.h"

namespace tempera {
namespace {

/// Mean over pixels of the mean over channels of error(test, reference), an Rgb of doubles each.
template <class F>
double mean_error(const Image& test, const Image& reference, Image* map, double trim, F&& error) {
  check_sizes(test, reference);
  return mean_over_pixels(test.width(), test.height(), map, trim,
                          [&](int x, int y) {
                            const Rgb t = test.rgb(x, y), r = reference.rgb(x, y);
                            if (!is_finite(t) || !is_finite(r)) return std::numeric_limits<double>::quiet_NaN();
                            return error(t, r);
                          })
      .value;
}

double square(double v) { return v * v; }

}  // namespace

double mse(const Image& test, const Image& reference, Image* map, double trim) {
  return mean_error(test, reference, map, trim, [](const Rgb& t, const Rgb& r) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += square(double(t[c]) - double(r[c]));
    return sum / 3;
  });
}

double relative_mse(const Image& test, const Image& reference, Image* map, double epsilon, double trim) {
  return mean_error(test, reference, map, trim, [=](const Rgb& t, const Rgb& r) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += square(double(t[c]) - double(r[c])) / (square(r[c]) + epsilon);
    return sum / 3;
  });
}

double relative_mse_gray(const Image& test, const Image& reference, Image* map, double epsilon, double trim) {
  return mean_error(test, reference, map, trim, [=](const Rgb& t, const Rgb& r) {
    double sum = 0, gray = 0;
    for (int c = 0; c < 3; ++c) sum += square(double(t[c]) - double(r[c])), gray += double(r[c]);
    return sum / 3 / (square(gray / 3) + epsilon);
  });
}

double luminance_bias(const Image& test, const Image& reference) {
  const double difference = mean_error(test, reference, nullptr, 0, [](const Rgb& t, const Rgb& r) {
    return double(luminance(t)) - double(luminance(r));
  });
  const double mean =
      mean_error(test, reference, nullptr, 0, [](const Rgb&, const Rgb& r) { return double(luminance(r)); });
  return mean > 0 ? difference / mean : std::numeric_limits<double>::quiet_NaN();
}

double display_mse(const Image& test, const Image& reference, float exposure) {
  check_sizes(test, reference);
  return encoded_mse(display_colors(test, exposure), display_colors(reference, exposure));
}

double encoded_mse(const Image& test, const Image& reference) {
  const int values = test.width() * 3;
  std::vector<double> rows(test.height());
  parallel_rows(
      0, test.height(),
      [&](int y) {
        const float *t = test.row(y), *r = reference.row(y);
        double sum = 0;
        for (int i = 0; i < values; ++i) sum += square(double(t[i]) - double(r[i]));
        rows[y] = sum;
      },
      kRowGrain);
  double sum = 0;
  for (const double row : rows) sum += row;
  return sum / (3 * double(test.pixels()));
}

double psnr(const Image& test, const Image& reference, float exposure) {
  return decibels_below_peak(display_mse(test, reference, exposure));
}

double ssim(const Image& test, const Image& reference, float exposure) {
  check_sizes(test, reference);
  return encoded_ssim(display_luminance(test, exposure), display_luminance(reference, exposure));
}

double encoded_ssim(const Image& test, const Image& reference) {
  constexpr int kRadius = 5, kTaps = 2 * kRadius + 1;
  constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // (K L)^2 with the range L = 1
  const int w = test.width(), h = test.height(), inner = w - 2 * kRadius;
  if (inner < 1 || h < kTaps) return std::numeric_limits<double>::quiet_NaN();
  std::array<float, kTaps> taps{};
  double total = 0;
  for (int i = 0; i < kTaps; ++i) total += std::exp(-square(i - kRadius) / (2 * 1.5 * 1.5));
  for (int i = 0; i < kTaps; ++i) {
    taps[i] = float(std::exp(-square(i - kRadius) / (2 * 1.5 * 1.5)) / total);
  }
  std::vector<double> rows(h - 2 * kRadius);
  parallel_rows(
      kRadius, h - kRadius,
      [&](int y) {
        // Sums along columns, then along the row, of t, r, t^2, r^2 and t r. Values are taken relative to the middle of
        // their range, which changes no variance and loses less of it to rounding.
        constexpr int kSums = 5;
        thread_local std::vector<float> buffer;
        buffer.assign(kSums * (w + inner), 0.0f);
        std::array<float*, kSums> column{}, window{};
        for (int s = 0; s < kSums; ++s) {
          column[s] = buffer.data() + s * w;
          window[s] = buffer.data() + kSums * w + s * inner;
        }
        const auto add_row = [w](float tap, const float* __restrict t, const float* __restrict r, float* __restrict m0,
                                 float* __restrict m1, float* __restrict m2, float* __restrict m3,
                                 float* __restrict m4) {
          for (int x = 0; x < w; ++x) {
            const float a = t[x] - 0.5f, b = r[x] - 0.5f;
            m0[x] += tap * a, m1[x] += tap * b, m2[x] += tap * (a * a), m3[x] += tap * (b * b), m4[x] += tap * (a * b);
          }
        };
        for (int i = -kRadius; i <= kRadius; ++i) {
          add_row(taps[i + kRadius], test.row(y + i), reference.row(y + i), column[0], column[1], column[2], column[3],
                  column[4]);
        }
        for (std::size_t s = 0; s < kSums; ++s) {
          float* const out = window[s];
          for (int i = 0; i < kTaps; ++i) {
            const float tap = taps[i];
            const float* const from = column[s] + i;
            for (int x = 0; x < inner; ++x) out[x] += tap * from[x];
          }
        }
        double sum = 0;
        for (int x = 0; x < inner; ++x) {
          const float a = window[0][x], b = window[1][x];
          const float var_t = window[2][x] - a * a, var_r = window[3][x] - b * b, covariance = window[4][x] - a * b;
          const float mean_t = a + 0.5f, mean_r = b + 0.5f;
          // Both factors, (2 u v + C) / (u^2 + v^2 + C), in a form that is exactly 1 for u = v.
          const float means = 1 - (a - b) * (a - b) / (mean_t * mean_t + mean_r * mean_r + kC1);
          sum += double(means * (1 - (var_t + var_r - 2 * covariance) / (var_t + var_r + kC2)));
        }
        rows[y - kRadius] = sum;
      },
      kRowGrain);
  double sum = 0;
  for (const double row : rows) sum += row;
  return sum / (double(inner) * double(rows.size()));
}

Image mean_of(const Image& a, const Image& b) {
  check_sizes(a, b);
  Image out(a.width(), a.height(), a.channels() == b.channels() ? a.channels() : 3);
  parallel_rows(
      0, a.height(),
      [&](int y) {
        float* const to = out.row(y);
        if (a.channels() != b.channels()) {
          for (int x = 0; x < a.width(); ++x) out.set_rgb(x, y, a.rgb(x, y) * 0.5f + b.rgb(x, y) * 0.5f);
          return;
        }
        const float *from_a = a.row(y), *from_b = b.row(y);
        for (int i = 0; i < a.width() * a.channels(); ++i) to[i] = 0.5f * from_a[i] + 0.5f * from_b[i];
      },
      kRowGrain);
  return out;
}

std::int64_t count_non_finite(const Image& image) {
  std::vector<std::int64_t> rows(image.height());
  parallel_rows(
      0, image.height(),
      [&](int y) {
        for (int x = 0; x < image.width(); ++x) rows[y] += !is_finite(image.rgb(x, y));
      },
      kRowGrain);
  std::int64_t count = 0;
  for (const std::int64_t row : rows) count += row;
  return count;
}

// --- Display values

namespace {

/// Calls encode(first value of the output row, Rgb of each pixel).
template <class F>
Image displayed(const Image& image, int channels, float exposure, F&& encode) {
  Image out(image.width(), image.height(), channels);
  const float scale = std::exp2(exposure);
  const auto unit = [](float v) { return v > 0 ? std::min(v, 1.0f) : 0.0f; };  // NaN becomes 0
  parallel_rows(
      0, image.height(),
      [&](int y) {
        float* const row = out.row(y);
        for (int x = 0; x < image.width(); ++x) {
          const Rgb c = image.rgb(x, y);
          encode(row + x * channels, Rgb{unit(c.r * scale), unit(c.g * scale), unit(c.b * scale)});
        }
        for (int i = 0; i < image.width() * channels; ++i) row[i] = srgb_fast(row[i]);
      },
      kRowGrain);
  return out;
}

}  // namespace

Image display_colors(const Image& image, float exposure) {
  return displayed(image, 3, exposure, [](float* out, const Rgb& c) { out[0] = c.r, out[1] = c.g, out[2] = c.b; });
}

Image display_luminance(const Image& image, float exposure) {
  return displayed(image, 1, exposure, [](float* out, const Rgb& c) { out[0] = std::min(luminance(c), 1.0f); });
}

}  // namespace tempera
