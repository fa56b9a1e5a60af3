// SPDX-License-Identifier: Apache-2.0
#pragma once
// Discrete distributions over weights.
#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace tempera {

/// Inversion of a tabulated CDF: monotone in u, so stratified numbers stay stratified. Weights need not sum to 1; all
/// zero weights mean uniform.
class Discrete {
 public:
  Discrete() = default;
  explicit Discrete(std::span<const float> weights) {
    cdf_.reserve(weights.size());
    double sum = 0;
    for (const float w : weights) sum += w;
    const bool uniform = !(sum > 0);
    total_ = sum;
    double running = 0;
    for (const float w : weights) {
      running += uniform ? 1.0 / double(weights.size()) : w / sum;
      cdf_.push_back(float(running));
    }
    if (!cdf_.empty()) cdf_.back() = 1;
  }
  /// Index for u in [0,1); `u` becomes the position within that entry, again in [0,1).
  std::uint32_t sample(float& u) const {
    std::uint32_t i = 0;  // the first entry above u, by halves, without branches that cannot be foreseen
    for (auto n = std::uint32_t(cdf_.size()); n > 1;) {
      const std::uint32_t half = n / 2;
      i += cdf_[i + half - 1] <= u ? half : 0;
      n -= half;
    }
    const float lo = i > 0 ? cdf_[i - 1] : 0.0f, width = cdf_[i] - lo;
    u = width > 0 ? std::min((u - lo) / width, 0x1.fffffep-1f) : 0.0f;
    return i;
  }
  float probability(std::uint32_t i) const { return cdf_[i] - (i > 0 ? cdf_[i - 1] : 0.0f); }
  std::size_t size() const { return cdf_.size(); }
  double total() const { return total_; }

 private:
  std::vector<float> cdf_;
  double total_ = 0;
};

}  // namespace tempera
