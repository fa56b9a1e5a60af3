// SPDX-License-Identifier: Apache-2.0
#pragma once
// glTF materials and textures as ours.
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "gltf_animation.h"
#include "gltf_document.h"
#include "tempera/scene/scene.h"

namespace tempera {

struct GltfMaterial {
  MaterialPtr material;
  std::optional<AreaEmission> emission;
  std::string name;
  bool uses_tangents = false;  ///< a tangent-space texture is looked up in the mesh's tangents
};

class GltfMaterials {
 public:
  /// `tints_once`: MetallicRoughnessParams::tints_once of all of them.
  GltfMaterials(const GltfDocument& document, GltfAnimations& animations, bool tints_once)
      : document_(document), animations_(animations), tints_once_(tints_once) {}

  /// Material `index` (-1: glTF's default) for meshes with or without vertex colors. The reference stays valid.
  /// Errors: at the offending property or image.
  const GltfMaterial& get(int index, bool vertex_colors);

 private:
  using TexturePtr = std::shared_ptr<const Texture>;
  GltfMaterial make(int index, bool vertex_colors);
  MetallicRoughnessParams metallic_roughness(const Json& json, const std::string& pointer, GltfMaterial& made);
  MaterialPtr with_alpha(MaterialPtr opaque, const Json& json, const std::string& pointer, bool vertex_colors);
  /// Null if `info` is missing or names nothing that can be read. `pointer` is that of `info`, which animations may
  /// name.
  TexturePtr texture(const Json& info, const std::string& pointer, Channel channel, ColorEncoding encoding);
  TexturePtr image_texture(const Json& info, ImageTextureParams params);
  /// Factor `name` of `json` (an object or missing, at `pointer`), animated if the file animates it; one number makes
  /// gray.
  Animated<Rgb> factor(const Json& json, const std::string& pointer, std::string_view name, std::size_t components,
                       Rgb fallback, double max);
  Slot slot(const Json& json, const std::string& pointer, std::string_view factor_name, Rgb fallback,
            std::size_t components, std::string_view texture_name, Channel channel, ColorEncoding encoding);
  double limited(const Json& json, double fallback, double min, double max);

  const GltfDocument& document_;
  GltfAnimations& animations_;
  bool tints_once_;
  std::map<std::pair<int, bool>, GltfMaterial> made_;
};

}  // namespace tempera
