// SPDX-License-Identifier: Apache-2.0
#pragma once
// Discrete distributions over weights.
#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace tempera {

/// Inversion of a tabulated CDF: monotone in u, so stratified numbers stay stratified. Weights need not sum to 1; all
/// zero weights mean uniform. A second table says where to begin the search [Chen 1974].
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
    if (cdf_.empty()) return;
    cdf_.back() = 1;
    first_.resize(cdf_.size() < 16 ? cdf_.size() : cdf_.size() / 4);
    for (std::uint32_t k = 0, i = 0; k < first_.size(); ++k) {
      while (cdf_[i] * float(first_.size()) <= float(k)) ++i;
      first_[k] = i;
    }
  }
  /// Index for u in [0,1); `u` becomes the position within that entry, again in [0,1).
  std::uint32_t sample(float& u) const {
    std::uint32_t i = first_[std::size_t(u * float(first_.size()))];
    while (i > 0 && cdf_[i - 1] > u) --i;  // the product above may have been rounded up
    while (cdf_[i] <= u) ++i;
    const float lo = i > 0 ? cdf_[i - 1] : 0.0f, width = cdf_[i] - lo;
    u = width > 0 ? std::min((u - lo) / width, 0x1.fffffep-1f) : 0.0f;
    return i;
  }
  float probability(std::uint32_t i) const { return cdf_[i] - (i > 0 ? cdf_[i - 1] : 0.0f); }
  std::size_t size() const { return cdf_.size(); }
  double total() const { return total_; }

 private:
  std::vector<float> cdf_;
  std::vector<std::uint32_t> first_;  // entry for the lowest u of each equal part of [0,1)
  double total_ = 0;
};

}  // namespace tempera
