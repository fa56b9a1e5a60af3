// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/geometry.h"

#include <algorithm>
#include <numeric>
#include <tuple>

#include "tempera/core/error.h"

namespace tempera {

Affine3f object_from_unit(const Geometry& geometry) {
  return std::visit(
      [](const auto& g) -> Affine3f {
        if constexpr (requires { g.object_from_unit; }) return g.object_from_unit;
        return {};
      },
      geometry);
}

Mesh make_rectangle() {
  Mesh m;
  m.positions = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}};
  m.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  m.indices = {0, 1, 2, 0, 2, 3};
  return m;
}

Mesh make_cube() {
  Mesh m;
  // Each face: normal axis with sign, and the in-plane axes in which uv grows; s x t = normal.
  for (int axis = 0; axis < 3; ++axis) {
    for (const float sign : {-1.0f, 1.0f}) {
      Vec3f n, s, t;
      n[axis] = sign;
      s[(axis + 1) % 3] = sign;
      t[(axis + 2) % 3] = 1;
      const auto base = std::uint32_t(m.positions.size());
      for (const Vec2f uv : {Vec2f{0, 0}, Vec2f{1, 0}, Vec2f{1, 1}, Vec2f{0, 1}}) {
        m.positions.push_back(n + s * (2 * uv.x - 1) + t * (2 * uv.y - 1));
        m.uvs.push_back(uv);
      }
      for (const std::uint32_t i : {0u, 1u, 2u, 0u, 2u, 3u}) m.indices.push_back(base + i);
    }
  }
  return m;
}

void transform(Mesh& mesh, const Affine3d& map) {
  TEMPERA_ASSERT(!mesh.cache.samples);
  const auto inv = inverse(map);
  const bool mirrored = map.determinant() < 0;
  const auto points = [&](std::vector<Vec3f>& v) {
    for (Vec3f& p : v) p = Vec3f(map.point(Vec3d(p)));
  };
  const auto vectors = [&](std::vector<Vec3f>& v) {
    for (Vec3f& p : v) p = Vec3f(map.vector(Vec3d(p)));
  };
  const auto normals = [&](std::vector<Vec3f>& v, bool unit) {
    for (Vec3f& n : v) {
      const Vec3d w = inv.transposed_vector(Vec3d(n));
      n = Vec3f(unit ? normalize(w) : w);
    }
  };
  points(mesh.positions);
  normals(mesh.normals, true);
  for (Vec3f& t : mesh.tangents) t = normalize(Vec3f(map.vector(Vec3d(t))));
  for (MorphTarget& target : mesh.morph_targets) {
    vectors(target.positions);
    normals(target.normals, false);
    vectors(target.tangents);
  }
  if (mirrored) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
    for (float& s : mesh.tangent_signs) s = -s;
  }
}

void bind_cache(Mesh& mesh, CachedPositions cache) {
  const std::size_t n = mesh.positions.size();
  TEMPERA_ASSERT(cache.samples && (cache.vertices.empty() || cache.vertices.size() == n));
  TEMPERA_ASSERT(!cache.vertices.empty() || cache.first_vertex + n <= cache.samples->vertices());
  mesh.cache = std::move(cache);
  if (mesh.normals.empty()) return;

  // Vertices in an order in which those at one place with one normal stand together.
  std::vector<std::uint32_t> order(n);
  std::iota(order.begin(), order.end(), 0u);
  const auto key = [&](std::uint32_t v) {
    const Vec3f &p = mesh.positions[v], &m = mesh.normals[v];
    return std::tie(p.x, p.y, p.z, m.x, m.y, m.z);
  };
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); });
  CachedPositions& c = mesh.cache;
  c.fan_of.resize(n);
  std::uint32_t fans = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (i > 0 && key(order[i]) != key(order[i - 1])) ++fans;
    c.fan_of[order[i]] = fans;
  }
  c.fan_begin.assign(std::size_t(fans) + 2, 0);
  for (const std::uint32_t v : mesh.indices) ++c.fan_begin[std::size_t(c.fan_of[v]) + 1];
  std::partial_sum(c.fan_begin.begin(), c.fan_begin.end(), c.fan_begin.begin());
  c.fans.resize(mesh.indices.size());
  std::vector<std::uint32_t> next(c.fan_begin.begin(), c.fan_begin.end() - 1);
  for (std::size_t corner = 0; corner < mesh.indices.size(); ++corner) {
    c.fans[next[c.fan_of[mesh.indices[corner]]]++] = std::uint32_t(corner);
  }
}

}  // namespace tempera
