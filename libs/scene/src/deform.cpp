// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/deform.h"

#include <algorithm>

namespace tempera {

MeshPose mesh_pose(const Scene& scene, const Mesh& mesh, int node, double t, double piece) {
  MeshPose pose;
  if (mesh.skin.joints.empty()) pose.world = Affine3f(scene.world(node, t, piece));
  pose.joints.reserve(mesh.skin.joints.size());
  for (const Skin::Joint& joint : mesh.skin.joints) {
    pose.joints.emplace_back(scene.world(joint.node, t, piece) * joint.inverse_bind);
  }
  if (!mesh.morph_targets.empty()) pose.morph_weights = mesh.morph_weights.at(t, piece);
  if (mesh.cache.size() > 1) {
    const auto after = std::upper_bound(mesh.cache.begin(), mesh.cache.end(), t,
                                        [](double time, const VertexCacheSample& s) { return time < s.time; });
    const auto last = mesh.cache.size() - 2;
    pose.cache_index = after == mesh.cache.begin() ? 0 : std::min(last, std::size_t(after - mesh.cache.begin()) - 1);
    const double t0 = mesh.cache[pose.cache_index].time, t1 = mesh.cache[pose.cache_index + 1].time;
    pose.cache_blend = float(std::clamp((t - t0) / (t1 - t0), 0.0, 1.0));
  }
  return pose;
}

/// Sum of the joint matrices of a vertex by weight [glTF 2.0, 3.7.3.3].
static Affine3f skin_matrix(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Affine3f m{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  const std::size_t first = std::size_t(vertex) * std::size_t(mesh.skin.influences);
  for (std::size_t i = first; i < first + std::size_t(mesh.skin.influences); ++i) {
    const float w = mesh.skin.weights[i];
    if (w == 0) continue;
    const Affine3f& j = pose.joints[mesh.skin.indices[i]];
    m.x += j.x * w, m.y += j.y * w, m.z += j.z * w, m.translation += j.translation * w;
  }
  return m;
}

Vec3f posed_position(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Vec3f p = mesh.positions[vertex];
  if (mesh.cache.size() > 1) {
    p = lerp(mesh.cache[pose.cache_index].positions[vertex], mesh.cache[pose.cache_index + 1].positions[vertex],
             pose.cache_blend);
  }
  for (std::size_t i = 0; i < pose.morph_weights.size(); ++i) {
    const auto& d = mesh.morph_targets[i].positions;
    if (pose.morph_weights[i] != 0 && !d.empty()) p += d[vertex] * pose.morph_weights[i];
  }
  return pose.joints.empty() ? pose.world.point(p) : skin_matrix(mesh, pose, vertex).point(p);
}

Vec3f posed_normal(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex) {
  Vec3f n = mesh.normals[vertex];
  if (mesh.cache.size() > 1 && !mesh.cache[pose.cache_index].normals.empty()) {
    n = lerp(mesh.cache[pose.cache_index].normals[vertex], mesh.cache[pose.cache_index + 1].normals[vertex],
             pose.cache_blend);
  }
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

}  // namespace tempera
