// SPDX-License-Identifier: Apache-2.0
#include "motion/parts.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "decomposition.h"

namespace tempera::motion {

namespace {

bool has(std::span<const LayerDesc> layers, const std::string& name) {
  return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == name; });
}

std::string chain_prefix(const std::string& chain) { return "chain." + chain + "."; }

#ifdef TEMPERA_PATH_SPACE_MOTION
/// Those of `chains` that have vectors, by the letters of their layers.
std::vector<std::string> moving_chains(const std::vector<std::string>& chains, std::span<const LayerDesc> layers) {
  std::vector<std::string> out;
  for (std::string chain : chains) {
    if (chain.ends_with('L')) chain.back() = 'D';
    const std::string prefix = chain_prefix(chain);
    if (has(layers, prefix + layers::motion_forward().name) && has(layers, prefix + layers::motion_backward().name))
      out.push_back(chain);
  }
  return out;
}
#endif

}  // namespace

std::vector<Part> parts_of(std::span<const LayerDesc> layers, const Metadata& metadata) {
  const std::vector<ClassInfo> known = classes(metadata);
  const bool decomposition = is_decomposed(layers);
  std::vector<Part> out;
  if (!decomposition) out.push_back({layers::color().name, {}});
  for (const LayerDesc& d : layers) {
    if (!is_class_color(d)) continue;
    const auto info =
        std::find_if(known.begin(), known.end(), [&](const ClassInfo& c) { return c.name == d.path_class; });
    Part part{d.name, {}, true, decomposition};
    if (info != known.end()) {
      const bool first_scatters = info->chains == std::vector<std::string>{"D"};
      part.divide = first_scatters;
#ifdef TEMPERA_PATH_SPACE_MOTION
      if (!first_scatters) part.chains = moving_chains(info->chains, layers);
      part.shines = !part.chains.empty() && std::all_of(info->chains.begin(), info->chains.end(),
                                                        [](const std::string& c) { return c.ends_with('L'); });
      part.divide |= !part.chains.empty() && !part.shines;
#endif
    } else {
      part.divide = false;
    }
    out.push_back(std::move(part));
  }
  return out;
}

std::vector<LayerDesc> chain_layers(std::span<const LayerDesc> layers) {
  std::vector<LayerDesc> out;
  for (const LayerDesc& d : layers) {
    if (d.chain.empty() && !d.name.starts_with("chain.")) continue;
    for (const char* end : {".motion.forward", ".motion.backward", ".depth", ".object_id", ".albedo", ".emission"}) {
      if (d.name.ends_with(end)) out.push_back(d);
    }
    if (d.chain.empty() || d != layers::chain_layer(d.chain, layers::motion_forward())) continue;
    for (const LayerDesc& more : {layers::depth(), layers::object_id()}) {  // a shot can have them rendered
      const LayerDesc layer = layers::chain_layer(d.chain, more);
      if (!has(layers, layer.name)) out.push_back(layer);
    }
  }
  return out;
}

Surfaces surfaces_of(const Frame& frame, int number, const Part& part) {
  if (part.chains.empty()) return read_surfaces(frame, number);
  Surfaces out = read_surfaces(frame, number, chain_prefix(part.chains[0]));
  using Light = std::pair<float, float>;  // of the surface itself, and what it scatters, or 1
  constexpr Light kNone{0.0f, 0.0f};
  constexpr float kDark = 1e-6f;
  std::vector<Light> most(out.linear.size(), kNone);
  for (std::size_t k = 0; k < part.chains.size(); ++k) {
    const std::string prefix = chain_prefix(part.chains[k]);
    const Surfaces of_chain = k == 0 ? out : read_surfaces(frame, number, prefix);
    const Layer *albedo = frame.find(prefix + layers::albedo().name),
                *emission = part.shines ? frame.find(prefix + layers::emission().name) : nullptr;
    const auto sum = [](const Layer& layer, std::size_t i) {
      const float* v = layer.image.values().data() + i * std::size_t(layer.image.channels());
      return std::max(sound(v[0]) + sound(v[1]) + sound(v[2]), 0.0f);
    };
    for (std::size_t i = 0; i < most.size(); ++i) {
      // Where there is nothing of the chain its depth is 0, and no light comes from it. The background has vectors alone.
      const bool there = of_chain.depth.empty() || of_chain.depth[i] < kFar || (part.shines && of_chain.vectors[i]);
      Light light{0.0f, there ? 1.0f : 0.0f};
      if (albedo && albedo->image.channels() >= 3)
        light.second = std::max(sum(*albedo, i), part.shines && there ? kDark : 0.0f);
      if (emission && emission->image.channels() >= 3) light.first = sum(*emission, i);
      if (!(light > most[i])) continue;
      most[i] = light;
      out.linear[i] = of_chain.linear[i], out.quadratic[i] = of_chain.quadratic[i],
      out.vectors[i] = of_chain.vectors[i];
      if (!out.depth.empty() && !of_chain.depth.empty()) out.depth[i] = of_chain.depth[i];
      if (!out.id.empty() && !of_chain.id.empty()) out.id[i] = of_chain.id[i];
    }
  }
  for (std::size_t i = 0; i < most.size(); ++i) {
    if (most[i] == kNone) out.vectors[i] = kNothing;
  }
  return out;
}

Image reflectance_of(const Frame& frame, const Part& part, float least) {
  Image out(frame.width(), frame.height(), 3, 1.0f);
  if (!part.divide) return out;
  std::vector<std::string> names;
  for (const std::string& chain : part.chains) names.push_back(chain_prefix(chain) + layers::albedo().name);
  if (names.empty()) names.push_back(layers::albedo().name);
  bool first = true;
  for (const std::string& name : names) {
    const Layer* layer = frame.find(name);
    if (!layer || layer->image.channels() < 3) continue;
    const std::size_t n = std::size_t(layer->image.channels());
    for (std::size_t i = 0; i < std::size_t(out.pixels()); ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        const float v = layer->image.values()[i * n + c];
        out.values()[i * 3 + c] = (first ? 0.0f : out.values()[i * 3 + c]) + sound(v);
      }
    }
    first = false;
  }
  for (float& v : out.values()) v = std::max(v, least);
  return out;
}

}  // namespace tempera::motion
