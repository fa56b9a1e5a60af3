// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the files of `reconstruct` hold, and what a frame's data for the solver are made of: the base pass and the
// offset pass, with the light of rare paths in them. See reconstruct.cpp for the layers.
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "rare_filter.h"
#include "reconstruct_settings.h"
#include "row_weights.h"
#include "tempera/core/grid.h"
#include "tempera/frames/image.h"
#include "tempera/stages/motion_runs.h"
#include "tempera/stages/poisson.h"
#include "tempera/stages/stage_run.h"

namespace tempera::reconstruction {

/// The layers of one pass of a file.
struct Pass {
  Image color, grad_x, grad_y;
};

/// What a sequence of pictures is solved from, in one frame.
struct PassPair {
  Pass base, offset;  ///< offset: empty images without an offset pass
};

/// What a file holds for the reconstruction.
struct Input {
  std::string path;
  int frame = 0;
  PassPair light;                 ///< all of it but that of photons, or without rare light
  std::vector<PassPair> classes;  ///< of each of Settings::classes
  /// Light of photons, which has no differences: mean of both passes, of all light and of each class. Empty if there is
  /// none.
  std::vector<Image> photons;
  /// Rare light among theirs, and what of it is held back; empty unless it is solved for apart.
  Pass base_rare, offset_rare;
  Image base_held, offset_held;
  std::array<Image, 2> rare_halves;  ///< without an offset pass: what is not held back, of both halves
  Image albedo, normal, object;      ///< empty if the file has none
  float samples = 0;                 ///< of a pixel, all passes, on average; 0: unknown
  Image source;
  Grid<std::uint8_t> sampled;  ///< pixels of the offset pass that have samples; empty without that pass
  bool is_sampled(int x, int y) const { return !sampled.empty() && sampled.at(x, y) != 0; }
  int crop_left = 0, crop_top = 0;  ///< of the file in the full picture
  bool cropped = false;
  std::string camera;
};

/// Layers that are read of each frame.
std::vector<LayerUse> layers_read(const Settings& settings);

/// Takes a frame's layers apart and checks them.
class Reader {
 public:
  Reader(const StageRun& run, const Settings& settings)
      : run_(run), settings_(settings), width_(run.in()[0].width), height_(run.in()[0].height) {}
  int width() const { return width_; }
  int height() const { return height_; }

  /// Errors: Error{kBadInput} for a layer that lacks channels, or with a value that is not finite where it counts.
  Input read(int frame) const;

 private:
  const StageRun& run_;
  const Settings& settings_;
  int width_, height_;
};

/// phi from the frame before to `in`, whose offset pass tells the inverse. [Manzi 2016, Sec. 4.2]
/// Errors: Error{kBadInput} where that is not one-to-one.
PixelMap replay_map(const Input& in, int width, int height);

/// Primal and spatial data of a frame: means of the two passes where both have samples. [Manzi 2016, Sec. 4.2.1]
void combine_passes(const Input& in, const PassPair& light, PoissonFrame& out);

/// Variances of the spatial data that combine_passes makes: the passes of a frame are independent estimates of the
/// same.
DataVariance variance_between_passes(const Input& in, const PassPair& light, int w, int h);

/// Temporal and mixed data of a frame: its base pass taken from the offset pass of the next one.
/// [Manzi 2016, Sec. 4.2.1]
void subtract_passes(const Pass& base, const Pass& next, PoissonFrame& out);

/// Luminance of a picture, all its rare light, and what is held back of it: sums over pixels.
struct LightShares {
  double all = 0, rare = 0, held = 0;
  LightShares& operator+=(const LightShares& o) {
    all += o.all, rare += o.rare, held += o.held;
    return *this;
  }
  double rare_share() const { return all > 0 ? rare / all : 0; }
  double held_share() const { return all > 0 ? held / all : 0; }
};

/// Takes the rare light out of the passes of a frame. Adds to `shares` what it finds.
RareFrame take_rare_light(Input& in, LightShares& shares);

}  // namespace tempera::reconstruction
