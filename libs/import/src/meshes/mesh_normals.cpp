// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>

#include "tempera/core/parallel.h"
#include "tempera/import/mesh_files.h"

namespace tempera {
namespace {

/// Angle between unit vectors, accurate for small ones.
float angle_between(const Vec3f& a, const Vec3f& b) {
  const float d = dot(a, b);
  return d < 0 ? kPi - 2 * std::asin(std::min(1.0f, length(a + b) / 2))
               : 2 * std::asin(std::min(1.0f, length(b - a) / 2));
}

struct Face {
  Vec3f normal;  // unit; zero if degenerate
  std::array<float, 3> angles{};
};

Face face_of(const Mesh& mesh, std::size_t t) {
  std::array<Vec3f, 3> p;
  for (std::size_t i = 0; i < 3; ++i) p[i] = mesh.positions[mesh.corners(t)[i]];
  Face f;
  f.normal = normalize(cross(p[1] - p[0], p[2] - p[0]));
  if (length_squared(f.normal) == 0 || !is_finite(f.normal)) return {};
  for (std::size_t i = 0; i < 3; ++i)
    f.angles[i] = angle_between(normalize(p[(i + 1) % 3] - p[i]), normalize(p[(i + 2) % 3] - p[i]));
  return f;
}

}  // namespace

void fill_normals(Mesh& mesh) {
  const bool all = mesh.normals.empty();
  mesh.normals.resize(mesh.positions.size());
  if (!all && std::none_of(mesh.normals.begin(), mesh.normals.end(), [](const Vec3f& n) { return n == Vec3f{}; }))
    return;
  std::vector<Vec3f> sums(mesh.positions.size());
  for (std::size_t t = 0; t < mesh.triangle_count(); ++t) {
    const Face f = face_of(mesh, t);
    for (std::size_t i = 0; i < 3; ++i) sums[mesh.corners(t)[i]] += f.normal * f.angles[i];
  }
  for (std::size_t v = 0; v < sums.size(); ++v) {
    if (mesh.normals[v] != Vec3f{}) continue;
    mesh.normals[v] = normalize(sums[v]);
    if (mesh.normals[v] == Vec3f{} || !is_finite(mesh.normals[v])) mesh.normals[v] = {1, 0, 0};
  }
}

void crease_normals(Mesh& mesh, float max_angle) {
  const float min_cosine = std::cos(max_angle);
  const std::size_t corners = mesh.indices.size();
  std::vector<Face> faces(mesh.triangle_count());
  parallel_for(
      0, std::int64_t(faces.size()), [&](std::int64_t t) { faces[t] = face_of(mesh, t); }, 1024);

  // Corners sorted by position: those at one point stand together.
  std::vector<std::uint32_t> order(corners);
  std::iota(order.begin(), order.end(), 0u);
  const auto position = [&](std::uint32_t corner) -> const Vec3f& { return mesh.positions[mesh.indices[corner]]; };
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    const Vec3f &p = position(a), &q = position(b);
    return std::tie(p.x, p.y, p.z, a) < std::tie(q.x, q.y, q.z, b);
  });
  std::vector<Vec3f> normals(corners);
  // Groups at one point are small in real meshes; this bound keeps a fan of a million triangles from taking forever.
  constexpr std::size_t kMaxGroup = 4096;
  for (std::size_t begin = 0, end = 0; begin < corners; begin = end) {
    while (end < corners && end - begin < kMaxGroup && position(order[end]) == position(order[begin])) ++end;
    for (std::size_t i = begin; i < end; ++i) {
      const Face& own = faces[order[i] / 3];
      Vec3f sum;
      for (std::size_t j = begin; j < end; ++j) {
        const Face& other = faces[order[j] / 3];
        if (i == j || dot(own.normal, other.normal) >= min_cosine) sum += other.normal * other.angles[order[j] % 3];
      }
      normals[order[i]] = normalize(sum);
      if (normals[order[i]] == Vec3f{}) normals[order[i]] = own.normal == Vec3f{} ? Vec3f{1, 0, 0} : own.normal;
    }
  }

  // A vertex for each distinct pair of old vertex and normal.
  Mesh result;
  result.flip_normals = mesh.flip_normals;
  result.color_per_face = mesh.color_per_face;
  if (mesh.color_per_face) result.colors = mesh.colors, result.color_alphas = mesh.color_alphas;
  std::map<std::pair<std::uint32_t, std::array<float, 3>>, std::uint32_t> known;
  result.indices.reserve(corners);
  for (std::size_t c = 0; c < corners; ++c) {
    const std::uint32_t v = mesh.indices[c];
    const Vec3f& n = normals[c];
    const auto [entry, is_new] = known.try_emplace({v, {n.x, n.y, n.z}}, std::uint32_t(result.positions.size()));
    if (is_new) {
      result.positions.push_back(mesh.positions[v]);
      result.normals.push_back(n);
      if (!mesh.uvs.empty()) result.uvs.push_back(mesh.uvs[v]);
      if (!mesh.color_per_face && !mesh.colors.empty()) result.colors.push_back(mesh.colors[v]);
      if (!mesh.color_per_face && !mesh.color_alphas.empty()) result.color_alphas.push_back(mesh.color_alphas[v]);
    }
    result.indices.push_back(entry->second);
  }
  mesh = std::move(result);
}

void align_winding(Mesh& mesh) {
  if (mesh.normals.empty()) return;
  parallel_for(
      0, std::int64_t(mesh.triangle_count()),
      [&](std::int64_t t) {
        std::uint32_t* const i = mesh.corners(t);
        const Vec3f& p = mesh.positions[i[0]];
        const Vec3f n = cross(mesh.positions[i[1]] - p, mesh.positions[i[2]] - p);
        if (dot(n, mesh.normals[i[0]] + mesh.normals[i[1]] + mesh.normals[i[2]]) < 0) std::swap(i[1], i[2]);
      },
      4096);
}

}  // namespace tempera
