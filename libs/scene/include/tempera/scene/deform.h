// SPDX-License-Identifier: Apache-2.0
#pragma once
// Deforming vertices at one instant. A pose holds what depends on time alone (joint matrices, morph weights); vertices
// are then a pure function of the mesh and the pose, so whole meshes and single vertices agree to the bit.
#include <vector>

#include "tempera/scene/scene.h"

namespace tempera {

/// What deforms a mesh at one time.
struct MeshPose {
  std::vector<Affine3f> joints;  ///< mesh space (at bind) to the instance's space
  std::vector<float> morph_weights;
  std::size_t cache_index = 0;  ///< vertex cache: samples cache_index and, unless the weight is 0, cache_index + 1 ...
  float cache_blend = 0;        ///< ... mixed with this weight
};

/// Pose of `mesh`, instanced at `node`, at time t. Joint matrices are relative to the world of `node`: a skinned mesh
/// ignores its own node's transform (glTF 2.0, 3.7.3.3).
MeshPose mesh_pose(const Scene& scene, const Mesh& mesh, int node, double t);
/// Vertex position in the instance's space.
Vec3f posed_position(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex);
/// Unit vertex normal in the instance's space. Pre: the mesh has normals.
Vec3f posed_normal(const Mesh& mesh, const MeshPose& pose, std::uint32_t vertex);

}  // namespace tempera
