// SPDX-License-Identifier: Apache-2.0
#pragma once
// Triangle meshes made by rules: lathes, tubes, boxes, sheets and extruded outlines with smooth normals and texture
// coordinates. For generated scenes; meshes of files are the importers' business.
#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera::gallery {

/// Indexed triangles, counterclockwise seen from outside. Texture coordinates have v pointing down, as in glTF.
struct Polygons {
  std::vector<Vec3f> positions, normals;
  std::vector<Vec2f> uvs;
  std::vector<std::uint32_t> indices;
  /// Skin: up to four joints per vertex with weights that sum to 1; empty, or one per vertex.
  std::vector<std::array<std::uint16_t, 4>> joints;
  std::vector<std::array<float, 4>> weights;
  /// Morph targets: displacements of positions and normals, one per vertex each.
  struct Displacement {
    std::vector<Vec3f> positions, normals;
  };
  std::vector<Displacement> targets;

  std::size_t triangle_count() const { return indices.size() / 3; }
  std::uint32_t vertex(const Vec3d& position, const Vec3d& normal, const Vec2d& uv);
  void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) { indices.insert(indices.end(), {a, b, c}); }
  /// A flat triangle or quadrilateral with vertices of its own.
  void flat(const std::array<Vec3d, 3>& corners, const std::array<Vec2d, 3>& uv);
  void flat(const std::array<Vec3d, 4>& corners, const std::array<Vec2d, 4>& uv);
  /// Appends `other` (without skin and targets), moved by `place`; a mirroring map keeps the outside outside.
  Polygons& add(const Polygons& other, const Affine3d& place = {});
  /// Multiplies and shifts texture coordinates.
  Polygons& map_uv(const Vec2d& scale, const Vec2d& offset = {});
};

/// A sheet of 2 nu nv triangles over (u, v) in [0,1]^2; du x dv points outwards. Normals by central differences.
Polygons sheet(int nu, int nv, const std::function<Vec3d(double u, double v)>& position);

/// A surface of revolution about y. `profile`: (radius, height) with the outside to the right when it is followed, e.g.
/// from the bottom up the outer side. Edges that turn by more than `crease` degrees are sharp. u runs around, v down
/// the height of arc.
Polygons lathe(std::span<const Vec2d> profile, int segments, double crease = 35);
Polygons sphere(double radius, int segments, int rings);
/// Closed cylinder on y from `bottom` to `top` with a rounded edge of `bevel`.
Polygons cylinder(double radius, double bottom, double top, int segments, double bevel = 0);

/// A round bar along `path`; `radii` has one value, or one per point. Ends are rounded or flat.
Polygons tube(std::span<const Vec3d> path, std::span<const double> radii, int sides, bool round_ends = true);
/// A capsule between two points, 2 * sides * (2 rings) triangles or so.
Polygons capsule(const Vec3d& a, const Vec3d& b, double radius_a, double radius_b, int sides);

/// Box around the origin with texture coordinates in metres over each face, times `uv_scale`.
Polygons box(const Vec3d& size, double uv_scale = 1);
/// The same with rounded edges of `steps` segments a quarter turn.
Polygons rounded_box(const Vec3d& size, double radius, int steps, double uv_scale = 1);
/// Rectangle in y = 0 facing +y, `size` along x and z, uv over [0, uv_size] with u along x and v along z.
Polygons floor_plane(const Vec2d& size, const Vec2d& uv_size = {1, 1}, int nx = 1, int nz = 1);
/// Rectangle in z = 0 facing +z, around the origin, uv upright over [0, uv_size].
Polygons wall_plane(const Vec2d& size, const Vec2d& uv_size = {1, 1});

/// Prism over a simple outline in the x-y plane (counterclockwise seen from +z), from z = -depth/2 to depth/2.
/// Texture coordinates in metres times `uv_scale`. Edges that turn by more than `crease` degrees are sharp.
Polygons extrude(std::span<const Vec2d> outline, double depth, double uv_scale = 1, double crease = 30);

/// Poses for `add`.
Affine3d at(const Vec3d& position);
Affine3d turned(const Vec3d& axis, double degrees, const Vec3d& position = {});
/// Takes +y to the direction from `a` to `b` and the origin to `a`.
Affine3d along(const Vec3d& a, const Vec3d& b);

/// Points of a Catmull-Rom curve through `points`, `steps` a piece.
std::vector<Vec3d> curve(std::span<const Vec3d> points, int steps);
std::vector<Vec2d> curve(std::span<const Vec2d> points, int steps);

}  // namespace tempera::gallery
