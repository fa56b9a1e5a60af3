// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pixel reconstruction filters, realised by filter importance sampling: samples are placed by the filter's density,
// never splatted, so that pixels stay independent.
#include <memory>
#include <string>

#include "tempera/core/error.h"
#include "tempera/core/vec.h"

namespace tempera {

enum class FilterKind { kBox, kTent, kGaussian, kMitchell, kBlackmanHarris };

/// A separable filter. Radius in pixels. Threads: const and re-entrant.
class PixelFilter {
 public:
  /// radius 0: the kind's usual one (box 0.5, tent 1, gaussian 2, mitchell 2, blackman_harris 1.5). Other radii stretch
  /// the profile; a gaussian's standard deviation is a quarter of its radius, and it is shifted down to end at 0.
  /// Mitchell's parameters are B = C = 1/3.
  /// Errors: Error{kOutOfRange} unless radius is 0 or in [0.01, 32].
  explicit PixelFilter(FilterKind kind = FilterKind::kBox, float radius = 0);
  struct Sample {
    Vec2f offset;      ///< from the pixel's center
    float weight = 1;  ///< estimates are multiplied by this, 1 on average; not 1 only for filters with negative lobes
  };
  /// Maps u in [0,1)^2 to an offset with density proportional to |evaluate(x) evaluate(y)|, monotonically in each axis.
  Sample sample(const Vec2f& u) const;
  /// Unnormalised 1D profile at x pixels from the center; 0 outside the radius.
  float evaluate(float x) const;
  /// The filter at an offset from the pixel's center (pixels), scaled so that it integrates to 1 over the plane: what a
  /// splat of one sample in that place adds, per pixel area. Negative in the lobes of Mitchell's. 0 outside of
  /// [-radius, radius)^2, so that every place is in one box of a grid of pixels.
  float density(const Vec2f& offset) const;
  FilterKind kind() const { return kind_; }
  float radius() const { return radius_; }

 private:
  struct Table;
  float sample_axis(float u) const;

  FilterKind kind_;
  float radius_;
  float norm_ = 1;                      ///< 1 / integral of evaluate(x)
  std::shared_ptr<const Table> table_;  ///< of |filter|; none for kinds with a closed form
};

/// "box", "tent", "gaussian", "mitchell" or "blackman_harris". Errors: Error{kUnknownName} with the known names.
FilterKind parse_filter(const std::string& name, const SourceLoc& loc = {});
std::string filter_name(FilterKind kind);

}  // namespace tempera
