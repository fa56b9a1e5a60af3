// SPDX-License-Identifier: Apache-2.0
#pragma once
// What `quality` of a shot stands for. It says nothing where the shot or the command line do.
#include <algorithm>
#include <string>

#include "tempera/frames/layers.h"
#include "tempera/pipeline/shot_config.h"

namespace tempera {

struct Quality {
  std::string name;
  int spp;  ///< samples per pixel, where none are given
};

/// Samples per pixel up to which files cost as much as rendering, and all light is denoised together.
constexpr int kFewSamples = 16;
/// Further samples of features alone, which cost a fifth of others, where there are more: noise of textures is what is left
/// of the error then.
inline int feature_samples(int spp) { return spp > kFewSamples ? std::min(16, spp / 4) : 0; }

/// Features of what is seen in mirrors and behind glass, and of the parts of surfaces that scatter: where there are that many
/// samples, their noise and their files cost less than they gain.
std::vector<LayerDesc> quality_layers(int spp);

/// That of a shot; null: it is as the shot says.
const Quality* quality_of(const ShotConfig& config);
/// The name of the stage that follows all others.
inline const std::string& quality_stage() {
  static const std::string name = "denoise";
  return name;
}
/// Where the stages were named: the key `stages` or its element `i`, or the quality, which names one.
inline SourceLoc stages_loc(const ShotConfig& config) {
  return config.loc(config.find("stages") ? "stages" : "quality");
}
inline SourceLoc stages_loc(const ShotConfig& config, std::size_t i) {
  return config.find("stages") ? config.loc("stages", i) : config.loc("quality");
}

}  // namespace tempera
