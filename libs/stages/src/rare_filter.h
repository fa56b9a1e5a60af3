// SPDX-License-Identifier: Apache-2.0
#pragma once
// Light of rare paths, which differences do not help: smoothed over pixels that look alike, over space and time.
#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/frames/image.h"
#include "tempera/stages/poisson.h"

namespace tempera {

/// What a frame has beside its Poisson rows. Guides that the files do not have are empty.
struct RareFrame {
  std::array<Image, 2> light;    ///< [h,w,3]: two independent estimates, without what is held back
  Image albedo, normal, object;  ///< guides: [h,w,3], [h,w,3], [h,w,1]
  Grid<std::int32_t> previous;   ///< index of the pixel of the frame before that a pixel continues; -1: none
  float samples = 16;            ///< of a pixel, both estimates together, on average
  bool dark = true;              ///< whether there is no rare light at all
};

/// Smooths the rare light of a window.
/// Method: a bilateral filter of light over albedo, along the motion of matter, whose weights follow the guides, the
/// other light and the brightness of the other estimate: so noise does not choose its own weights. The window shrinks
/// as samples grow, and with it the bias.
class RareFilter {
 public:
  /// Keeps references. Pre: `solution` holds the other light of the same frames.
  RareFilter(std::span<const RareFrame* const> frames, const PlanarFrames& solution);
  /// Whether there is no rare light in any frame of the window.
  bool dark() const;
  /// The smoothed light of frame t of the window, [h,w,3], radiance >= 0. Frames are best asked for in ascending order.
  /// Result: the same bits for any number of threads, and whichever frames are asked for. Threads: uses parallel_for;
  /// one call at a time.
  Image smooth(int t);

 private:
  /// What the weights of a pixel look at, scaled to units of standard deviations; together, so that a tap reads one
  /// place.
  struct Guide {
    std::array<float, 7> features{};
    float object = 0;
    std::array<float, 2> brightness{};  ///< of the two estimates
    std::array<Rgb, 2> light;           ///< over albedo
  };
  using Guides = Grid<Guide>;
  const Guides& guides(int t);
  Guides make_guides(int t) const;
  /// Whether there may be light within the reach of each pixel of a frame.
  Grid<std::uint8_t> lit(int t) const;

  std::span<const RareFrame* const> frames_;
  const PlanarFrames& solution_;
  double mean_ = 0;  ///< luminance of the solution
  std::map<int, Guides> guides_;
};

}  // namespace tempera
