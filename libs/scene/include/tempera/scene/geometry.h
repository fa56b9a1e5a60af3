// SPDX-License-Identifier: Apache-2.0
#pragma once
// Shapes in their own object space, with what deforms them over time.
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "tempera/core/animated.h"
#include "tempera/core/vec.h"
#include "tempera/scene/vertex_cache.h"

namespace tempera {

/// Displacements added to a mesh with an animated weight. Empty arrays mean no change of that attribute.
struct MorphTarget {
  std::vector<Vec3f> positions, normals, tangents;  ///< one per vertex, or empty
};

/// Linear blend skinning: each vertex follows `influences` joints.
struct Skin {
  struct Joint {
    int node = -1;          ///< Scene::nodes index
    Affine3d inverse_bind;  ///< mesh space to joint space at bind time
  };
  std::vector<Joint> joints;
  int influences = 4;                  ///< per vertex
  std::vector<std::uint16_t> indices;  ///< [vertices, influences] into `joints`
  std::vector<float> weights;          ///< [vertices, influences], each vertex sums to 1
};

/// A mesh's positions over time from a vertex cache, in place of `Mesh::positions`. The normals of a smooth mesh follow
/// them: see bind_cache.
struct CachedPositions {
  std::shared_ptr<const VertexCache> samples;  ///< null: none
  Affine3f mesh_from_cache;
  std::size_t first_vertex = 0;         ///< of the cache: where vertex 0 of the mesh stands, if `vertices` is empty
  std::vector<std::uint32_t> vertices;  ///< of the cache, by vertex of the mesh; or empty
  /// Vertices of one `fan_of` share a normal. The corners (indices into Mesh::indices) of the triangles around fan f
  /// are fans[fan_begin[f]] to fans[fan_begin[f + 1] - 1]. Empty for flat meshes.
  std::vector<std::uint32_t> fan_of, fan_begin, fans;
};

/// Indexed triangles. Pre: indices are multiples of 3 and below positions.size(); attribute arrays have one element per
/// vertex or are empty.
struct Mesh {
  std::vector<Vec3f> positions;
  std::vector<Vec3f> normals;  ///< empty: flat shading
  std::vector<Vec2f> uvs, uvs1;
  std::vector<Vec3f> tangents;       ///< empty: derived from uvs
  std::vector<float> tangent_signs;  ///< bitangent = sign * cross(n, tangent); empty: +1
  std::vector<std::uint32_t> indices;
  std::vector<Rgb> colors;  ///< per vertex, or per triangle if `color_per_face`
  std::vector<float> color_alphas;
  bool color_per_face = false;
  bool flip_normals = false;  ///< geometric and shading normals point the other way

  std::vector<MorphTarget> morph_targets;
  Animated<std::vector<float>> morph_weights;  ///< one per target
  Skin skin;                                   ///< no joints: not skinned
  CachedPositions cache;
  std::vector<std::uint32_t> source_vertices;  ///< by vertex: which vertex of the authored mesh it was; or empty

  std::size_t triangle_count() const { return indices.size() / 3; }
  /// The three vertices of a triangle.
  std::uint32_t* corners(std::size_t triangle) { return indices.data() + 3 * triangle; }
  const std::uint32_t* corners(std::size_t triangle) const { return indices.data() + 3 * triangle; }
  bool deforms() const { return !morph_targets.empty() || !skin.joints.empty() || cache.samples; }
};

enum class AnalyticKind : std::uint8_t { kSphere, kDisk, kCylinder };

/// A surface by its equation: that of its kind in unit space (scene/analytic.h), placed by any invertible map.
struct AnalyticShape {
  AnalyticKind kind = AnalyticKind::kSphere;
  Affine3f object_from_unit;
  bool flip_normals = false;
};

/// Analytic shapes by the names of their kinds, to be stored as such: Geometry g = Sphere{map}.
struct Sphere : AnalyticShape {
  explicit Sphere(const Affine3f& map = {}, bool flip = false) : AnalyticShape{AnalyticKind::kSphere, map, flip} {}
};
struct Disk : AnalyticShape {
  explicit Disk(const Affine3f& map = {}, bool flip = false) : AnalyticShape{AnalyticKind::kDisk, map, flip} {}
};
struct Cylinder : AnalyticShape {
  explicit Cylinder(const Affine3f& map = {}, bool flip = false) : AnalyticShape{AnalyticKind::kCylinder, map, flip} {}
};

using Geometry = std::variant<Mesh, AnalyticShape>;

/// The map of an analytic shape from its unit space; the identity for a mesh.
Affine3f object_from_unit(const Geometry& geometry);

/// Two triangles over [-1,1]^2 in z = 0 facing +z, uv over [0,1]^2 (Mitsuba's rectangle).
Mesh make_rectangle();
/// Twelve triangles over [-1,1]^3, flat normals, uv over [0,1]^2 on each face.
Mesh make_cube();
/// Lets `cache` drive the positions of a mesh, and works out what its normals need: vertices that stand at one place
/// with one normal share it, as at a seam of the texture, so smooth stays smooth and sharp stays sharp. At every pose
/// the normal is the mean of the triangles around by their angles [Thuermer 1998]. Pre: every vertex of the mesh is one
/// of the cache.
void bind_cache(Mesh& mesh, CachedPositions cache);
/// Applies an affine map to positions, normals, tangents and morph targets of a mesh; keeps front faces in front under
/// mirroring. Pre: the mesh has no cache.
void transform(Mesh& mesh, const Affine3d& map);

}  // namespace tempera
