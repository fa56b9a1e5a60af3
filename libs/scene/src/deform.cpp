// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/deform.h"

#include <algorithm>
#include <cmath>

namespace tempera {

MeshPose mesh_pose(const Scene& scene, const Mesh& mesh, int node, double t, double piece) {
  MeshPose pose;
  if (mesh.skin.joints.empty()) pose.world = Affine3f(scene.world(node, t, piece));
  pose.joints.reserve(mesh.skin.joints.size());
  for (const Skin::Joint& joint : mesh.skin.joints) {
    pose.joints.emplace_back(scene.world(joint.node, t, piece) * joint.inverse_bind);
  }
  if (!mesh.morph_targets.empty()) pose.morph_weights = mesh.morph_weights.at(t, piece);
  if (mesh.cache.samples) {
    const std::vector<double>& times = mesh.cache.samples->times();
    const std::size_t after = std::upper_bound(times.begin(), times.end(), t) - times.begin();
    pose.cache_index = after == 0 ? 0 : after - 1;
    if (after > 0 && after < times.size()) {
      pose.cache_blend = float((t - times[after - 1]) / (times[after] - times[after - 1]));
    }
  }
  return pose;
}

/// Sum of the joint matrices of a vertex by weight [glTF 2.0, 3.7.3.3].
static Affine3f skin_matrix(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Affine3f m{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  const std::size_t count = mesh.skin.influences, first = count * vertex;
  for (std::size_t i = first; i < first + count; ++i) {
    const float w = mesh.skin.weights[i];
    if (w == 0) continue;
    const Affine3f& j = pose.joints[mesh.skin.indices[i]];
    m.x += j.x * w, m.y += j.y * w, m.z += j.z * w, m.translation += j.translation * w;
  }
  return m;
}

/// Before morph targets and skin.
static Vec3f base_position(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  const CachedPositions& c = mesh.cache;
  if (!c.samples) return mesh.positions[vertex];
  const std::size_t v = c.vertices.empty() ? c.first_vertex + vertex : c.vertices[vertex];
  Vec3f p = c.samples->position(pose.cache_index, v);
  if (pose.cache_blend != 0) p = lerp(p, c.samples->position(pose.cache_index + 1, v), pose.cache_blend);
  return c.mesh_from_cache.point(p);
}

/// Mean of the normals of the triangles around by their angles there; the mesh's own where all of them degenerate.
static Vec3f cached_normal(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  // Vertices of a closed fan are few; the bound keeps a fan of a million triangles from taking forever.
  constexpr std::uint32_t kMaxCorners = 4096;
  const CachedPositions& c = mesh.cache;
  const std::uint32_t fan = c.fan_of[vertex], begin = c.fan_begin[fan];
  const std::uint32_t end = std::min(c.fan_begin[fan + 1], begin + kMaxCorners);
  Vec3f sum;
  for (std::uint32_t i = begin; i < end; ++i) {
    const std::uint32_t corner = c.fans[i], first = corner - corner % 3;
    const auto at = [&](std::uint32_t k) { return base_position(mesh, pose, mesh.indices[first + (corner + k) % 3]); };
    const Vec3f p = at(0), e1 = at(1) - p, e2 = at(2) - p, n = cross(e1, e2);
    const float l = length(n);
    if (l > 0) sum += n * (std::atan2(l, dot(e1, e2)) / l);
  }
  const float l = length(sum);
  return l > 0 && std::isfinite(l) ? sum * (1 / l) : mesh.normals[vertex];
}

Vec3f posed_position(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Vec3f p = base_position(mesh, pose, vertex);
  for (std::size_t i = 0; i < pose.morph_weights.size(); ++i) {
    const auto& d = mesh.morph_targets[i].positions;
    if (pose.morph_weights[i] != 0 && !d.empty()) p += d[vertex] * pose.morph_weights[i];
  }
  return pose.joints.empty() ? pose.world.point(p) : skin_matrix(mesh, pose, vertex).point(p);
}

Vec3f posed_normal(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Vec3f n = mesh.cache.samples ? cached_normal(mesh, pose, vertex) : mesh.normals[vertex];
  for (std::size_t i = 0; i < pose.morph_weights.size(); ++i) {
    const auto& d = mesh.morph_targets[i].normals;
    if (pose.morph_weights[i] != 0 && !d.empty()) n += d[vertex] * pose.morph_weights[i];
  }
  if (pose.joints.empty()) return transform_normal(pose.world, n);
  const Affine3f m = skin_matrix(mesh, pose, vertex);
  return normalize(cofactor_vector(m, n));
}

void mesh_jumps(const Scene& scene, const Mesh& mesh, int node, TimeSpan span, std::vector<double>& out) {
  scene.jumps(node, span, out);
  for (const Skin::Joint& joint : mesh.skin.joints) scene.jumps(joint.node, span, out);
  mesh.morph_weights.jumps(span, out);
}

void instance_jumps(const Scene& scene, TimeSpan span, std::vector<double>& out) {
  for (const Instance& instance : scene.instances) {
    scene.jumps(instance.node, span, out);
    for (const int shape : scene.groups[instance.group]) {
      const auto* mesh = std::get_if<Mesh>(&scene.shapes[shape].geometry);
      if (mesh && mesh->deforms()) mesh_jumps(scene, *mesh, instance.node, span, out);
    }
  }
}

}  // namespace tempera
