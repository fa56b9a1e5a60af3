// SPDX-License-Identifier: Apache-2.0
#include "adaptive_sampling.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/methods/method.h"

namespace tempera {

namespace {

constexpr int kLeastBatch = 4;  // samples: fewer say too little about their variance
constexpr int kReserved = 2;    // samples that every pixel gets in every batch
constexpr int kRadius = 2;      // of the neighbourhoods that errors are judged by: 5 x 5 pixels

/// f(pixel of the image nearest to (x, y)) over the neighbourhood of a pixel, gathered for all pixels.
template <class F>
std::vector<float> filtered(int width, int height, F&& f) {
  std::vector<float> out(std::size_t(width) * std::size_t(height));
  parallel_for(
      0, height,
      [&](std::int64_t y) {
        for (int x = 0; x < width; ++x) out[std::size_t(y) * std::size_t(width) + std::size_t(x)] = f(x, int(y));
      },
      8);
  return out;
}

}  // namespace

const std::vector<ParamSpec>& AdaptiveOptions::params() {
  static const std::vector<ParamSpec> specs = {
      {"adaptive",
       std::string("off"),
       "more samples where differences are noisy: off, published (a little biased, as counts depend on what they "
       "weight) "
       "or unbiased (counts from a first batch that is not part of the picture)",
       -1e300,
       1e300,
       {"off", "published", "unbiased"}},
      {"adaptive_batches", 4, "batches of samples, each placed by what those before it showed", 2, 64},
      {"adaptive_boost", 8.0, "samples of a pixel in a batch at most, times their mean", 1, 1e4},
      {"adaptive_relative_to",
       std::string("squared_luminance"),
       "what the variance of differences is divided by: squared_luminance or luminance",
       -1e300,
       1e300,
       {"squared_luminance", "luminance"}},
  };
  return specs;
}

AdaptiveOptions::AdaptiveOptions(const Params& p)
    : mode(p.get_string("adaptive") == "published"  ? Mode::kPublished
           : p.get_string("adaptive") == "unbiased" ? Mode::kUnbiased
                                                    : Mode::kOff),
      batches(p.get_int("adaptive_batches")),
      boost(float(p.get_double("adaptive_boost"))),
      by_luminance(p.get_string("adaptive_relative_to") == "luminance") {}

BatchPlan plan_batches(const AdaptiveOptions& options, int spp) {
  if (options.mode == AdaptiveOptions::Mode::kOff) return {spp, 0, 1, true};
  const int count = std::min(options.batches, spp / kLeastBatch);
  if (count < 2) {
    throw SettingError(
        ErrorCode::kOutOfRange, "sampling.spp",
        fmt::format("adaptive sampling needs two batches of {} samples in each pass, and there are {}: raise spp, "
                    "or set adaptive = \"off\"",
                    kLeastBatch, spp));
  }
  const int later = spp / count, first = spp - (count - 1) * later;
  if (options.mode == AdaptiveOptions::Mode::kUnbiased) return {first, spp - first, 2, false};
  return {first, later, count, true};
}

std::vector<int> next_batch(const AdaptiveOptions& options, const std::vector<PixelNoise>& noise, int width, int height,
                            int mean, std::uint64_t seed) {
  const auto index = [&](int x, int y) {
    x = std::clamp(x, 0, width - 1), y = std::clamp(y, 0, height - 1);
    return std::size_t(y) * std::size_t(width) + std::size_t(x);
  };
  const std::vector<float> relative = filtered(width, height, [&](int x, int y) {
    float around = 0;  // 5 x 5 mean of the radiance
    for (int v = -kRadius; v <= kRadius; ++v) {
      for (int u = -kRadius; u <= kRadius; ++u) around += noise[index(x + u, y + v)].radiance;
    }
    around = std::max(around / 25, 0.0f);
    const PixelNoise& p = noise[index(x, y)];
    // As much as `mean` more samples lower the variance of the mean.
    const float gain = float(mean) / float(mean + p.samples);
    const float e = p.variance / ((options.by_luminance ? around : around * around) + 1e-3f) * gain;
    return std::isfinite(e) ? std::clamp(e, 0.0f, 1.0f) : 0.0f;
  });
  const std::vector<float> error = filtered(width, height, [&](int x, int y) {
    std::array<float, 25> values;
    for (int v = -kRadius, k = 0; v <= kRadius; ++v) {
      for (int u = -kRadius; u <= kRadius; ++u) values[k++] = relative[index(x + u, y + v)];
    }
    std::nth_element(values.begin(), values.begin() + 12, values.end());
    return values[12];
  });
  double total = 0;
  for (const float e : error) total += double(e);
  const double pixels = double(width) * height;
  const double scale = total > 0 ? (mean - kReserved) * pixels / total : 0;
  constexpr std::array<float, 5> kKernel{0.1f, 0.2f, 0.4f, 0.2f, 0.1f};
  const auto smooth = [&](const std::vector<float>& in, int dx, int dy) {
    return filtered(width, height, [&](int x, int y) {
      float sum = 0;
      int k = -2;
      for (const float weight : kKernel) {
        sum += weight * in[index(x + k * dx, y + k * dy)];
        ++k;
      }
      return sum;
    });
  };
  std::vector<float> density = smooth(smooth(error, 1, 0), 0, 1);
  double spent = 0;
  for (float& d : density) {
    d = float(std::min(double(d) * scale, double(options.boost) * mean));
    spent += double(d);
  }
  // What is reserved, and what the limit took away, is spread evenly.
  const float even = float(std::max(double(kReserved), mean - spent / pixels));
  std::vector<int> counts(density.size());
  for (std::size_t i = 0; i < counts.size(); ++i) {
    const float d = density[i] + even, whole = std::floor(d);
    counts[i] = int(whole) + (to_unit_float(std::uint32_t(hash_key(seed, i))) < d - whole);
  }
  return counts;
}

}  // namespace tempera
