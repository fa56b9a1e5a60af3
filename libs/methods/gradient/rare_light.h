// SPDX-License-Identifier: Apache-2.0
#pragma once
// Light that robust reconstruction keeps out of the differences of pixels: that of rare paths (ShiftObserver::rare),
// and samples of other paths that outshine their surroundings by far. A few of either are as bright as all others
// together; their differences are noise, and would become holes and dots of the picture.
#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "tempera/methods/method.h"

namespace tempera {

/// What a sample adds to its pixel: radiance, then contributions to its four differences.
using SampleParts = std::array<Rgb, 5>;

/// The brightest samples of a pixel, kept until those around are known. Size: the largest luminance among the parts.
struct BrightSamples {
  SampleParts first, second;
  float first_size = 0, second_size = 0;

  void add(const SampleParts& sample);
};

/// Rare light of one of the two independent estimates of a pixel: sum over its samples, and the two brightest of them.
struct RareLight {
  Rgb sum, first, second;
  float first_size = 0, second_size = 0;
  int count = 0;  ///< samples of the pixel, rare or not

  void add(const Rgb& radiance);
};

/// What a pixel gathers of it in a pass.
struct RarePixel {
  BrightSamples common;                ///< of paths that are not rare
  std::array<Rgb, 4> differences;      ///< sums of what rare paths add to the differences
  std::array<RareLight, 2> estimates;  ///< of the even and the odd samples; of a pass that is one of two: the first
};

/// The estimates that a pass tells apart: 2 if it is the only one of its frame, 1 if it is one of two.
/// Layers of a pass that hold RarePixel until all tiles are there.
std::vector<LayerDesc> rare_work_layers(const std::string& prefix, int estimates);
/// Layers of the result of a pass: rare.color, its differences rare.grad.x and rare.grad.y, held.color; and rare.a and
/// rare.b where the pass has two estimates.
std::vector<LayerDesc> rare_layers(const std::string& prefix, int estimates);

/// Stores a pixel in the work layers of a pass; `count`: its samples. x and y are those of the layers.
void store_rare(const RarePixel& pixel, int count, const std::string& prefix, int x, int y, Frame& out);

/// Makes the layers of rare_layers from the work layers of the passes of a frame: one pass with two estimates, or two
/// with one each. Samples that are much brighter than those around, and outshine the mean light around by much, are
/// held back down to a limit that grows with the number of samples, so that nothing is lost in the limit of many.
/// Result: the same bits for any number of threads. Threads: uses parallel_for.
void keep_rare_apart(std::span<const std::string> prefixes, Frame& out);

}  // namespace tempera
