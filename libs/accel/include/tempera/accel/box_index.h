// SPDX-License-Identifier: Apache-2.0
#pragma once
// Which of many boxes hold a point: footprints of photons, bounds of records. A tree of eight boxes a node. Embree's
// point queries find the same, but call back through pointers and visit boxes in an order that differs between runs, so
// that what is summed has to be sorted first; that took as long as the search.
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera {

/// Threads: visits are re-entrant.
class BoxIndex {
 public:
  /// Boxes are closed; those that are empty or have a bound that is no number hold nothing. They are copied.
  /// Range: fewer than 2^31 boxes.
  explicit BoxIndex(std::span<const Bounds3f> boxes);

  /// Calls f(index) once for each box that holds p, with its std::size_t index among those given, in an order that
  /// depends on the boxes and the point alone.
  template <class F>
  void visit(const Vec3f& p, F&& f) const {
    if (nodes_.empty()) return;
    std::array<std::int32_t, kMostOpen> open;
    int count = 0;
    open[count++] = 0;
    while (count > 0) {
      const Node& n = nodes_[open[--count]];
      unsigned held = 0;
      const Ints inside = (n.lo[0] <= p.x) & (n.hi[0] >= p.x) & (n.lo[1] <= p.y) & (n.hi[1] >= p.y) & (n.lo[2] <= p.z) &
                          (n.hi[2] >= p.z);
      for (int i = 0; i < kWidth; ++i) held |= unsigned(inside[i] & 1) << i;
      for (; held; held &= held - 1) {
        const std::int32_t child = n.child[std::countr_zero(held)];
        if (child < 0) {
          const std::int32_t index = ~child;
          f(std::size_t(index));
        } else {
          open[count++] = child;
        }
      }
    }
  }
  /// Bytes that it holds.
  std::uint64_t memory() const { return nodes_.capacity() * sizeof(Node); }

 private:
  static constexpr int kWidth = 8;
  static constexpr std::size_t kMostOpen = 128;  // seven more at each of at most 11 levels, and the roots of sizes
  using Floats = float __attribute__((vector_size(32)));
  using Ints = std::int32_t __attribute__((vector_size(32)));
  struct Node {
    std::array<Floats, 3> lo, hi;            // empty boxes hold nothing
    std::array<std::int32_t, kWidth> child;  // a node, or the complement of a box's index
  };
  struct Entry {
    Vec3f center;
    std::int32_t index = 0;
  };
  void fill(std::int32_t node, int slot, std::span<Entry> entries, std::span<const Bounds3f> boxes);
  std::int32_t add_node();
  std::vector<Node> nodes_;
};

}  // namespace tempera
