// SPDX-License-Identifier: Apache-2.0
#pragma once
// Points by their place: those within a distance, and how far the nearest few are. A balanced tree that halves the points
// along the longest side of their box.
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera {

/// Threads: visits are re-entrant.
class PointIndex {
 public:
  PointIndex() = default;
  /// Points are finite; they are copied. Range: fewer than 2^32 points.
  explicit PointIndex(std::span<const Vec3f> points);

  /// Calls f(index, squared distance) for points no farther from p than the root of `reach` (squared distance), each at
  /// most once. f returns the reach from then on, which must not grow.
  template <class F>
  void visit(const Vec3f& p, float reach, F&& f) const {
    struct Part {
      std::uint32_t first, last;
      float distance;  // squared, to its side of the plane that halved it
    };
    std::array<Part, 64> open;
    int count = 0;
    open[count++] = {0, std::uint32_t(nodes_.size()), 0};
    while (count > 0) {
      auto [first, last, distance] = open[--count];
      while (first < last && distance <= reach) {
        const std::uint32_t middle = first + (last - first) / 2;
        const Node& n = nodes_[middle];
        const float d2 = length_squared(p - n.point);
        if (d2 <= reach) reach = f(std::size_t(n.index), d2);
        const float beside = p[n.axis] - n.point[n.axis];
        const bool below = beside < 0;
        const Part far{below ? middle + 1 : first, below ? last : middle, std::max(distance, beside * beside)};
        if (far.first < far.last) open[count++] = far;
        (below ? last : first) = below ? middle : middle + 1;
      }
    }
  }
  /// Bytes that it holds.
  std::uint64_t memory() const { return nodes_.capacity() * sizeof(Node); }

 private:
  struct Node {
    Vec3f point;
    std::uint32_t index = 0;
    int axis = 0;
  };
  void halve(std::span<Node> nodes);
  std::vector<Node> nodes_;  // the middle one of a range divides it
};

/// The squared distance of the k-th nearest of what is added, or `most` if there are not that many nearer than it.
class NearestDistance {
 public:
  /// `room`: whose contents are replaced; it must outlive this.
  NearestDistance(std::size_t k, float most, std::vector<float>& room) : k_(k), reach_(most), nearest_(room) {
    nearest_.clear();
  }
  /// Pre: d2 <= reach().
  void add(float d2) {
    nearest_.push_back(d2);
    std::push_heap(nearest_.begin(), nearest_.end());
    if (nearest_.size() > k_) {
      std::pop_heap(nearest_.begin(), nearest_.end());
      nearest_.pop_back();
    }
    if (nearest_.size() == k_) reach_ = nearest_.front();
  }
  float reach() const { return reach_; }

 private:
  std::size_t k_;
  float reach_;
  std::vector<float>& nearest_;
};

}  // namespace tempera
