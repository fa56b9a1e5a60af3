// SPDX-License-Identifier: Apache-2.0
#pragma once
// Shapes in their own object space, with what deforms them over time.
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "tempera/core/animated.h"
#include "tempera/core/vec.h"

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

/// Positions (and optionally normals) of a whole mesh at a time, for vertex caches.
struct VertexCacheSample {
  double time = 0;
  std::vector<Vec3f> positions, normals;
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
  std::vector<VertexCacheSample> cache;        ///< sorted by time; fewer than two: static

  std::size_t triangle_count() const { return indices.size() / 3; }
  bool deforms() const { return !morph_targets.empty() || !skin.joints.empty() || cache.size() > 1; }
};

/// Analytic shapes; `object_from_unit` places them. u, v as in Mitsuba: sphere phi/2pi, theta/pi; disk radius, phi/2pi;
/// cylinder phi/2pi, z. Unit sphere at the origin; unit disk in z = 0 facing +z; cylinder of radius 1, z in [0,1],
/// open. `object_from_unit` may be any invertible map: the shapes are intersected in unit space.
struct Sphere {
  Affine3f object_from_unit;
  bool flip_normals = false;
};
struct Disk {
  Affine3f object_from_unit;
  bool flip_normals = false;
};
struct Cylinder {
  Affine3f object_from_unit;
  bool flip_normals = false;
};

using Geometry = std::variant<Mesh, Sphere, Disk, Cylinder>;

/// Two triangles over [-1,1]^2 in z = 0 facing +z, uv over [0,1]^2 (Mitsuba's rectangle).
Mesh make_rectangle();
/// Twelve triangles over [-1,1]^3, flat normals, uv over [0,1]^2 on each face.
Mesh make_cube();
/// Applies an affine map to positions, normals, tangents and morph targets of a mesh; keeps front faces in front under
/// mirroring.
void transform(Mesh& mesh, const Affine3d& map);

}  // namespace tempera
