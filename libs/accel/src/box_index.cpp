// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/box_index.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tempera/core/error.h"

namespace tempera {

namespace {

/// What boxes are kept apart by: a large box among small ones would make the boxes around them large.
int size_class(const Bounds3f& b) {
  const float size = std::max({b.hi.x - b.lo.x, b.hi.y - b.lo.y, b.hi.z - b.lo.z});
  return size > 0 ? std::clamp(std::ilogb(size) / 2, -16, 15) : -16;
}

}  // namespace

std::int32_t BoxIndex::add_node() {
  Node n;
  for (int a = 0; a < 3; ++a) {
    n.lo[a] = Floats{} + std::numeric_limits<float>::quiet_NaN();
    n.hi[a] = n.lo[a];
  }
  n.child.fill(0);
  nodes_.push_back(n);
  return std::int32_t(nodes_.size()) - 1;
}

/// Makes `slot` of a node what holds `entries`, at least one.
void BoxIndex::fill(std::int32_t node, int slot, std::span<Entry> entries, std::span<const Bounds3f> boxes) {
  Bounds3f all, centers;
  for (const Entry& e : entries) all.extend(boxes[e.index]), centers.extend(e.center);
  for (int a = 0; a < 3; ++a) nodes_[node].lo[a][slot] = all.lo[a], nodes_[node].hi[a][slot] = all.hi[a];
  if (entries.size() == 1) {
    nodes_[node].child[slot] = ~entries[0].index;
    return;
  }
  const std::int32_t inner = add_node();
  nodes_[node].child[slot] = inner;
  // Parts of full nodes: each but the last holds a power of eight.
  std::size_t part = 1;
  while (part * kWidth < entries.size()) part *= kWidth;
  // Halves by the longest side, as long as there is more than one part.
  int next = 0;
  const auto divide = [&](auto&& self, std::span<Entry> range) -> void {
    if (range.size() <= part) {
      fill(inner, next++, range, boxes);
      return;
    }
    Bounds3f around;
    for (const Entry& e : range) around.extend(e.center);
    const Vec3f size = around.hi - around.lo;
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const std::size_t parts = (range.size() + part - 1) / part, middle = (parts / 2) * part;
    std::nth_element(range.begin(), range.begin() + std::ptrdiff_t(middle), range.end(),
                     [&](const Entry& a, const Entry& b) {
                       return a.center[axis] != b.center[axis] ? a.center[axis] < b.center[axis] : a.index < b.index;
                     });
    self(self, range.first(middle));
    self(self, range.subspan(middle));
  };
  divide(divide, entries);
}

BoxIndex::BoxIndex(std::span<const Bounds3f> boxes) {
  TEMPERA_ASSERT(boxes.size() < (std::size_t(1) << 31));
  std::vector<Entry> entries;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    const Bounds3f& b = boxes[i];
    if (!(b.lo.x <= b.hi.x && b.lo.y <= b.hi.y && b.lo.z <= b.hi.z)) continue;
    constexpr float kFar = 1e30f;
    const auto middle = [&](float lo, float hi) {
      return 0.5f * std::clamp(lo, -kFar, kFar) + 0.5f * std::clamp(hi, -kFar, kFar);
    };
    entries.push_back({{middle(b.lo.x, b.hi.x), middle(b.lo.y, b.hi.y), middle(b.lo.z, b.hi.z)}, std::int32_t(i)});
  }
  if (entries.empty()) return;
  std::stable_sort(entries.begin(), entries.end(), [&](const Entry& a, const Entry& b) {
    return size_class(boxes[a.index]) < size_class(boxes[b.index]);
  });
  // The roots of all sizes, in nodes of their own.
  std::int32_t roots = add_node();
  int slot = 0;
  for (auto first = entries.begin(); first != entries.end();) {
    const int size = size_class(boxes[first->index]);
    const auto last =
        std::find_if(first, entries.end(), [&](const Entry& e) { return size_class(boxes[e.index]) != size; });
    if (slot == kWidth - 1 && last != entries.end()) {
      const std::int32_t more = add_node();
      for (int a = 0; a < 3; ++a) nodes_[roots].lo[a][slot] = -kInfinity, nodes_[roots].hi[a][slot] = kInfinity;
      nodes_[roots].child[slot] = more;
      roots = more, slot = 0;
    }
    fill(roots, slot++, {first, last}, boxes);
    first = last;
  }
  nodes_.shrink_to_fit();
}

}  // namespace tempera
