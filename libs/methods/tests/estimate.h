// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures as estimates of the same light: whether two ways to render agree.
#include <cmath>
#include <functional>
#include <numeric>
#include <string>
#include <vector>

#include "test_shot.h"

namespace tempera {

inline constexpr int kSeeds = 8;

/// Mean luminance of blocks of 4x4 pixels over independent renderings, with the variance of that mean.
struct Estimate {
  std::vector<double> mean, variance;
};

/// `render(seed)` gives the sum of the layers to look at.
inline Estimate estimate(const std::function<Image(int seed)>& render) {
  std::vector<std::vector<double>> runs;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    const Image image = render(seed);
    std::vector<double>& blocks = runs.emplace_back();
    for (int y = 0; y + 4 <= image.height(); y += 4) {
      for (int x = 0; x + 4 <= image.width(); x += 4) {
        double sum = 0;
        for (int i = 0; i < 16; ++i) sum += luminance(image.rgb(x + i % 4, y + i / 4));
        blocks.push_back(sum / 16);
      }
    }
  }
  Estimate e;
  for (std::size_t b = 0; b < runs[0].size(); ++b) {
    double mean = 0, squares = 0;
    for (const auto& r : runs) mean += r[b] / kSeeds;
    for (const auto& r : runs) squares += sqr(r[b] - mean);
    e.mean.push_back(mean);
    e.variance.push_back(squares / (kSeeds * (kSeeds - 1)));
  }
  return e;
}

inline Estimate estimate(TestShot shot, int frame, const std::vector<std::string>& layers) {
  return estimate([&](int seed) {
    shot.settings.seed = std::uint64_t(seed);
    const Frame picture = shot.render(frame);
    Image sum(picture.width(), picture.height(), 3);
    for (const std::string& layer : layers) {
      const Image& image = picture.layer(layer);
      for (int y = 0; y < sum.height(); ++y) {
        for (int x = 0; x < sum.width(); ++x) sum.set_rgb(x, y, sum.rgb(x, y) + image.rgb(x, y));
      }
    }
    return sum;
  });
}

/// Whether both estimate the same: each block by Welch's t, of which none of all may be unlikelier than `alpha`
/// together, and their sum. `bias`: which part of the light of a block, and of its neighbours together, the first may be
/// off by; a tenth of it for the sum. Blocks are then compared down to that part of the light of a mean one.
inline testing::AssertionResult agree(const Estimate& a, const Estimate& b, double alpha = 1e-3, double bias = 0) {
  double difference = 0, variance = 0, total = 0, largest = 0;
  const double mean_block = std::accumulate(b.mean.begin(), b.mean.end(), 0.0) / double(b.mean.size());
  for (std::size_t i = 0; i < a.mean.size(); ++i) {
    const double whole = a.mean[i] - b.mean[i];
    const double d = std::copysign(std::max(std::abs(whole) - bias * b.mean[i], 0.0), whole),
                 v = a.variance[i] + b.variance[i] + sqr(1e-5 * (a.mean[i] + 1e-3));
    difference += whole;
    variance += v;
    total += b.mean[i];
    largest = std::max(largest, std::abs(d) / std::sqrt(v + sqr(bias * mean_block)));
  }
  const double beyond = std::max(std::abs(difference) - 0.1 * bias * total, 0.0), z = beyond / std::sqrt(variance);
  // Quantile of Student's t with seven degrees of freedom, the fewest that a block can have, for 30 blocks.
  const double most = 8.0;
  if (std::erfc(std::abs(z) / std::sqrt(2.0)) >= alpha && largest < most) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "sum off by " << difference / total << " of itself, z = " << z
                                     << ", farthest block t = " << largest;
}

}  // namespace tempera
