// SPDX-License-Identifier: Apache-2.0
#pragma once
// glTF mesh primitives as our triangle meshes.
#include <vector>

#include "gltf_document.h"
#include "tempera/scene/geometry.h"

namespace tempera {

struct GltfPrimitive {
  Json json;
  Mesh mesh;  ///< skin without joints, which belong to the node; no triangles for points and lines
  int material = -1;
  bool has_colors = false;
  std::size_t max_joint = 0;  ///< largest joint index with a weight
};

struct GltfMesh {
  Json json;
  std::vector<GltfPrimitive> primitives;
  std::size_t targets = 0;     ///< morph targets, the same for all primitives
  std::vector<float> weights;  ///< default weight of each
};

/// Errors: at the offending accessor or property.
GltfMesh read_mesh(const GltfDocument& document, const Json& json);

/// Adds tangents for normal maps where the file has none, from normals and uvs; splits vertices at which mirrored and
/// unmirrored texture meets. Does nothing without normals or uvs.
void make_tangents(Mesh& mesh);

/// Applies constant `weights` to positions, normals and tangents and drops the morph targets.
void bake_morph_targets(Mesh& mesh, const std::vector<float>& weights);

/// Triangles and attributes of a primitive that KHR_draco_mesh_compression holds.
struct DracoPrimitive {
  std::vector<std::uint32_t> indices;
  struct Attribute {
    std::string semantic;
    int components = 0;
    std::vector<float> values;
  };
  std::vector<Attribute> attributes;
  std::size_t vertices = 0;
};
/// Errors: Error{kUnsupported} in builds without the library; Error{kBadInput} for data that it cannot decode.
DracoPrimitive decode_draco(const GltfDocument& document, const Json& extension);

}  // namespace tempera
