// SPDX-License-Identifier: Apache-2.0
#pragma once
// What `quality` of a shot stands for. It says nothing where the shot or the command line do.
#include <string>
#include <vector>

#include "tempera/pipeline/shot_config.h"

namespace tempera {

struct Quality {
  std::string name;
  int spp;                          ///< samples per pixel, where none are given
  std::vector<std::string> stages;  ///< after all others
  bool chooses_caustics = false;    ///< whether photons find caustics where kCausticsMatter
};

/// Part of the pixels that caustics have to be seen in (caustics_coverage) to be left to photons.
constexpr double kCausticsMatter = 0.005;

/// Samples per pixel of guides that see features alone.
constexpr int kGuideFeatureSamples = 16;

/// Samples per pixel up to which files cost as much as rendering.
constexpr int kFewSamples = 16;

/// That of a shot; null: it is as the shot says.
const Quality* quality_of(const ShotConfig& config);
constexpr const char* kDenoiser = "denoise";  ///< the stage
/// Where the stages were named: the key `stages` or its element `i`, or the quality, which names one.
inline SourceLoc stages_loc(const ShotConfig& config) {
  return config.loc(config.find("stages") ? "stages" : "quality");
}
inline SourceLoc stages_loc(const ShotConfig& config, std::size_t i) {
  return config.find("stages") ? config.loc("stages", i) : config.loc("quality");
}

}  // namespace tempera
