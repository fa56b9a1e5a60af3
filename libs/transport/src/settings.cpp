// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/settings.h"

#include <fmt/format.h>

#include "tempera/frames/layers.h"
#include "tempera/paths/light_path_expression.h"

namespace tempera {

const std::vector<PathClass>& default_decomposition() {
  static const std::vector<PathClass> parts{{"emission", "E"},          {"direct", "ED"},
                                            {"indirect", "ED[RT]*D.*"}, {"caustic", "ED[RT]+"},
                                            {"reflection", "ERD.*"},    {"transmission", "E(T|TT)D.*"}};
  return parts;
}

std::vector<std::string> chains_of_class(const PathClass& path_class, std::span<const std::string> layers) {
  const LightPathClassifier classifier({path_class.expression});
  std::vector<std::pair<std::string, LightPathClassifier::State>> prefixes{{"", classifier.start()}};
  std::vector<std::string> chains;
  for (std::size_t i = 0; i < prefixes.size(); ++i) {
    const auto [letters, state] = prefixes[i];
    if (classifier.alive(classifier.next(state, Event::kDiffuse))) {
      chains.push_back(letters + "D");
    } else if (!letters.empty() && classifier.classes(state)) {
      chains.push_back(letters + "L");
    }
    if (letters.size() == std::size_t(tempera::layers::kMaxChain)) continue;
    for (const auto& [letter, event] : {std::pair{"R", Event::kReflection}, {"T", Event::kTransmission}}) {
      const auto next = classifier.next(state, event);
      if (classifier.alive(next)) prefixes.push_back({letters + letter, next});
    }
  }
  constexpr std::size_t kMost = 16, kFew = 3;
  if (chains.size() <= kMost) return chains;
  std::erase_if(chains, [&](const std::string& chain) {
    const std::string prefix = "chain." + chain.substr(0, chain.size() - 1) + "D.";
    return chain.size() > kFew + 1 &&
           std::none_of(layers.begin(), layers.end(), [&](const std::string& l) { return l.starts_with(prefix); });
  });
  return chains;
}

bool RenderSettings::asks_for_chain_motion() const {
  return std::any_of(layers.begin(), layers.end(), [](const std::string& name) {
    const auto desc = tempera::layers::find(name);
    if (!desc || desc->chain.empty()) return false;
    const auto is_this = [&](const LayerDesc& d) { return *desc == tempera::layers::chain_layer(desc->chain, d); };
    return std::any_of(tempera::layers::chain_motion().begin(), tempera::layers::chain_motion().end(), is_this);
  });
}

std::string RenderSettings::canonical() const {
  std::string s = fmt::format(
      "size={}x{} crop={},{},{},{} camera={} fps={} first={} start={} shutter={},{},{},{},{},{} spp={} seed={},{} "
      "sampler={} filter={},{} layers={} decomposition={} cryptomatte={}",
      width, height, crop_x, crop_y, crop_width, crop_height, camera, clock.fps, clock.first, clock.start,
      clock.shutter.open, clock.shutter.close, int(clock.shutter.shape), clock.shutter.ramp_in, clock.shutter.ramp_out,
      clock.shutter.rolling, spp, seed, seed_per_frame, int(sampler), filter_name(filter.kind()), filter.radius(),
      fmt::join(layers, ","), classes_are_decomposition, cryptomatte_depth);
  for (const float c : clock.shutter.curve) s += fmt::format(" {}", c);
  for (const PathClass& c : classes) s += fmt::format(" {}={}", c.name, c.expression);
  if (!cuts.empty()) s += fmt::format(" cuts={}", fmt::join(cuts, ","));
  return s;
}

}  // namespace tempera
