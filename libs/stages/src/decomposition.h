// SPDX-License-Identifier: Apache-2.0
#pragma once
// Which layers are classes of light paths that add up to the picture. Private to the stages.
#include <algorithm>
#include <span>

#include "tempera/frames/layers.h"
#include "tempera/frames/metadata.h"

namespace tempera {

/// Whether a layer is the light of a class: "class.<name>.color".
inline bool is_class_color(const LayerDesc& d) {
  return d.pass.empty() && !d.path_class.empty() && d.name == layers::class_layer(d.path_class, layers::color()).name;
}

/// Whether the classes of these layers are those of a decomposition: it has one for all other light.
inline bool is_decomposed(std::span<const LayerDesc> all) {
  const std::string rest = layers::class_layer("residual", layers::color()).name;
  return std::any_of(all.begin(), all.end(), [&](const LayerDesc& d) { return d.name == rest; });
}

/// Whether the light of a class is that of lamps which are seen directly.
inline bool is_emission(const ClassInfo& c) {
  return c.chains.empty() && c.expression.starts_with("E") && c.expression.size() <= 2;
}

}  // namespace tempera
