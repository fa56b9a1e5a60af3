// SPDX-License-Identifier: Apache-2.0
#pragma once
// Deforming vertices at one instant. A pose holds what depends on time alone (joint matrices, morph weights); vertices
// are then a pure function of the mesh and the pose, so whole meshes and single vertices agree to the bit.
#include <vector>

#include "tempera/scene/scene.h"

namespace tempera {

/// What places and deforms a mesh at one time.
struct MeshPose {
  Affine3f world;                ///< of the node that the mesh is instanced at; identity for a skinned mesh
  std::vector<Affine3f> joints;  ///< mesh space (at bind) to the world
  std::vector<float> morph_weights;
  std::size_t cache_index = 0;  ///< vertex cache: samples cache_index and, unless the weight is 0, cache_index + 1 ...
  float cache_blend = 0;        ///< ... mixed with this weight
  bool operator==(const MeshPose&) const = default;
};

/// Pose of `mesh`, instanced at `node`, at time t as if the piece between jumps that holds the time `piece` went on for
/// ever (see Animated::at). A skinned mesh ignores its own node's transform (glTF 2.0, 3.7.3.3).
MeshPose mesh_pose(const Scene& scene, const Mesh& mesh, int node, double t, double piece);
inline MeshPose mesh_pose(const Scene& scene, const Mesh& mesh, int node, double t) {
  return mesh_pose(scene, mesh, node, t, t);
}
/// World position of a vertex.
Vec3f posed_position(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex);
/// World normal of a vertex: unit, or zero where the pose flattens it away. Pre: the mesh has normals.
Vec3f posed_normal(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex);
/// Appends the times within the open `span` at which the mesh, instanced at `node`, jumps from one pose to another.
void mesh_jumps(const Scene& scene, const Mesh& mesh, int node, TimeSpan span, std::vector<double>& out);
/// Appends the times within the open `span` at which any instance jumps, in place or in pose, appears or disappears.
void instance_jumps(const Scene& scene, TimeSpan span, std::vector<double>& out);

}  // namespace tempera
