// SPDX-License-Identifier: Apache-2.0
#pragma once
// What is rendered, apart from the scene and a method's own parameters.
#include <algorithm>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/core/time.h"
#include "tempera/paths/pixel_filter.h"
#include "tempera/paths/sample_stream.h"

namespace tempera {

/// A class of light paths that is wanted as layers of its own.
struct PathClass {
  std::string name;        ///< layer class.<name>.color
  std::string expression;  ///< e.g. "ERD.*"; see light_path_expression.h
};

/// The parts that `tree = "default"` stands for in a decomposition: what is filtered well apart. [Zimmer 2015, Sec. 3],
/// with caustics out of indirect light, and one letter for glass that is a sheet.
const std::vector<PathClass>& default_decomposition();

/// Chains (layers::chain_layer) whose surfaces the light of a class is seen on, see ClassInfo: "D" for light on what is seen
/// directly, "TD" and "TTD" for what is seen through glass, "RL" for lamps in mirrors. Where there are more than 16, those
/// of up to three specular events, and those that have layers in `layers` (names).
std::vector<std::string> chains_of_class(const PathClass& path_class, std::span<const std::string> layers = {});

/// A setting that an integrator cannot do with. Loaders turn it into an error at the place of the setting.
class SettingError : public Error {
 public:
  /// `key`: of the setting in shot.toml, e.g. "sampling.spp".
  SettingError(ErrorCode code, std::string key, std::string message)
      : Error(code, std::move(message)), key_(std::move(key)) {}
  const std::string& key() const { return key_; }

 private:
  std::string key_;
};

/// What is rendered, apart from the scene and the integrator's own parameters.
struct RenderSettings {
  int width = 1280, height = 720;
  int crop_x = 0, crop_y = 0, crop_width = 0, crop_height = 0;  ///< crop_width 0: the whole picture
  int camera = 0;
  FrameClock clock;
  int spp = 64;
  std::uint64_t seed = 0;
  bool seed_per_frame = true;  ///< false: every frame gets the same noise pattern
  SamplerKind sampler = SamplerKind::kSobol;
  PixelFilter filter;
  std::vector<std::string> layers{"color"};  ///< requested layer names (frames/layers.h); "color" is always written
  std::vector<PathClass> classes;
  bool classes_are_decomposition = false;  ///< check disjointness, add "residual", components sum to color exactly
  int cryptomatte_depth = 6;
  /// First frames after a cut, in order: nothing looks across, so motion vectors are invalid there.
  std::vector<int> cuts;
  bool asks_for_chain_motion() const;  ///< any of layers::chain_motion()
  bool is_cut(int frame) const { return std::binary_search(cuts.begin(), cuts.end(), frame); }
  std::string canonical() const;  ///< all fields as text, for metadata and resume

  int x0() const { return crop_width > 0 ? crop_x : 0; }
  int y0() const { return crop_width > 0 ? crop_y : 0; }
  int x1() const { return crop_width > 0 ? crop_x + crop_width : width; }
  int y1() const { return crop_width > 0 ? crop_y + crop_height : height; }
};

}  // namespace tempera
