// SPDX-License-Identifier: Apache-2.0
#pragma once
// Sums over rows in parallel, whose order does not depend on the threads.
#include <algorithm>
#include <cstdint>
#include <functional>
#include <vector>

#include "tempera/core/parallel.h"

namespace tempera {

inline constexpr int kBand = 8;       ///< rows a task: the frames before and after stay in the cache
inline constexpr int kSumLanes = 16;  ///< partial sums of a row; row strides are multiples of it

/// Sums over bands of rows that are formed in any order and added up in theirs.
template <class T>
class BandSums {
 public:
  explicit BandSums(int height) : parts_((height + kBand - 1) / kBand) {}
  int bands() const { return int(parts_.size()); }
  T& operator[](std::int64_t band) { return parts_[band]; }
  /// Calls body(band, first row, last row + 1) for all bands in parallel.
  void for_each(int height, const std::function<void(std::int64_t, int, int)>& body) {
    parallel_rows(0, bands(), [&](int b) { body(b, b * kBand, std::min(height, (b + 1) * kBand)); });
  }
  T total() const {
    T sum{};
    for (const T& p : parts_) {
      for (std::size_t i = 0; i < p.size(); ++i) sum[i] += p[i];
    }
    return sum;
  }

 private:
  std::vector<T> parts_;
};

}  // namespace tempera
