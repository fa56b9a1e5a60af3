// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/point_index.h"

#include "tempera/core/error.h"

namespace tempera {

PointIndex::PointIndex(std::span<const Vec3f> points) {
  TEMPERA_ASSERT(points.size() < (std::size_t(1) << 32));
  nodes_.resize(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) nodes_[i].point = points[i], nodes_[i].index = std::uint32_t(i);
  halve(nodes_);
}

void PointIndex::halve(std::span<Node> nodes) {
  if (nodes.size() < 2) return;
  Bounds3f around;
  for (const Node& n : nodes) around.extend(n.point);
  const Vec3f size = around.hi - around.lo;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const std::size_t middle = nodes.size() / 2;
  std::nth_element(nodes.begin(), nodes.begin() + std::ptrdiff_t(middle), nodes.end(),
                   [&](const Node& a, const Node& b) {
                     return a.point[axis] != b.point[axis] ? a.point[axis] < b.point[axis] : a.index < b.index;
                   });
  nodes[middle].axis = axis;
  halve(nodes.first(middle));
  halve(nodes.subspan(middle + 1));
}

}  // namespace tempera
