// SPDX-License-Identifier: Apache-2.0
#pragma once
// Polygons of mesh files to triangles.
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/vec.h"
#include "tempera/scene/geometry.h"

namespace tempera {

/// Appends the triangles of a polygon in space to `triangles`: three indices into `corners` each, in the polygon's
/// winding. Convex polygons become a fan around their first corner; others are cut ear by ear in the plane that their
/// area lies in, so that a polygon whose outline does not cross itself is covered exactly, with holes that are
/// connected by a bridge (two edges over each other), repeated corners and corners on straight edges. No triangle has
/// less than three distinct corners; n corners give at most n - 2 triangles. Fewer than three corners give none.
/// Result: whether that worked; false for an outline that crosses itself, or one too large for its shape (cutting takes
/// at most a second). It still gets triangles that span its corners. Time: about n log n for outlines found in
/// practice.
bool triangulate(std::span<const Vec3f> corners, std::vector<std::uint32_t>& triangles);

/// Adds polygons to a mesh that has its positions.
class PolygonMesher {
 public:
  explicit PolygonMesher(Mesh& mesh) : mesh_(mesh) {}
  /// Appends the triangles of the polygon of these vertices to the mesh's indices; as `triangulate`.
  bool add(std::span<const std::uint32_t> vertices);

 private:
  Mesh& mesh_;
  std::vector<Vec3f> corners_;
  std::vector<std::uint32_t> triangles_;
};

/// What to warn of where `add` returns false.
inline constexpr const char* kCrossedPolygon = "polygons whose outline crosses itself get triangles that overlap";

}  // namespace tempera
