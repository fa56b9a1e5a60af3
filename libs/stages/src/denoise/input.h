// SPDX-License-Identifier: Apache-2.0
#pragma once
// Frames of the input as planes, and what classes and chains there are to work with. Private to the denoiser.
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "denoise/denoiser.h"
#include "denoise/planes.h"
#include "tempera/stages/stage_run.h"

namespace tempera::denoise {

/// The surfaces that the light of a class is seen on.
struct ClassView {
  std::string name;                 ///< of the class
  std::vector<std::string> chains;  ///< with features of their own; none: the first surface stands for them
  bool divide;                      ///< whether these scatter the light, so that it can be divided by their reflectance
  bool emission = false;            ///< whether the class is of light that is seen directly
};
/// Of available.classes, by the metadata of a frame.
std::vector<ClassView> class_views(const Available& available, const Metadata& metadata);

/// Samples per pixel, where the frame says so.
std::optional<int> samples_of(const Metadata& metadata);

/// Features of several chains together: what reaches the camera of all their surfaces.
struct ChainView {
  Planes albedo;  ///< [h,w,3]
  Planes normal;  ///< [h,w,3] mean, weighted by the luminance of the albedo
};

/// The layers of a frame.
class InputFrame {
 public:
  /// `wanted`: of the layers that the stage reads; none: all. Errors: those of StageRun::read.
  InputFrame(StageRun& run, int frame, const std::function<bool(const LayerDesc&)>& wanted = {});
  const Metadata& metadata() const { return frame_.metadata; }
  /// The first channels of a layer, 0 where they are not finite or beyond 1e14; empty if the sequence lacks the layer.
  /// Errors: Error{kBadInput} if the sequence has the layer, and this frame has not or with fewer channels.
  Planes planes(const LayerDesc& layer, int channels);
  /// The same of a layer that is not looked at again.
  Planes take(const LayerDesc& layer, int channels);
  /// Motion vectors x, y, as Surfaces has them. Errors: as planes.
  Planes vectors(const LayerDesc& layer) const;
  /// The first surfaces, with the vectors of what is seen by chains where there are such: of several chains, those of the
  /// one that most light comes by. Errors: as planes.
  Surfaces moving(Surfaces first, std::span<const std::string> chains);
  /// Errors: as planes.
  ChainView chains(std::span<const std::string> chains);
  /// Values so far that were not finite.
  std::int64_t damaged() const { return damaged_; }

 private:
  const Image* image(const LayerDesc& layer, int channels) const;
  const StageRun& run_;
  int number_;
  Frame frame_;
  std::int64_t damaged_ = 0;
};

/// Halves whose mean is `all`, also for odd numbers of samples.
std::array<Planes, 2> centred_halves(const Planes& all, const Planes& a, const Planes& b);

}  // namespace tempera::denoise
