// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pixel reconstruction filters, realised by filter importance sampling: samples are placed by the filter's density, never
// splatted, so that pixels stay independent.
#include <memory>
#include <string>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/core/vec.h"

namespace tempera {

enum class FilterKind { kBox, kTent, kGaussian, kMitchell, kBlackmanHarris };

/// A separable filter. Radius in pixels. Threads: const and re-entrant.
class PixelFilter {
 public:
  /// radius 0: the kind's usual one (box 0.5, tent 1, gaussian 2 with stddev 0.5, mitchell 2, blackman_harris 1.5).
  explicit PixelFilter(FilterKind kind = FilterKind::kBox, float radius = 0);
  struct Sample {
    Vec2f offset;      ///< from the pixel's center
    float weight = 1;  ///< estimates are multiplied by this; not 1 only for filters with negative lobes
  };
  /// Maps u in [0,1)^2 to an offset.
  Sample sample(const Vec2f& u) const;
  float evaluate(float x) const;  ///< unnormalised 1D profile
  FilterKind kind() const { return kind_; }
  float radius() const { return radius_; }

 private:
  FilterKind kind_;
  float radius_;
  std::shared_ptr<const std::vector<float>> cdf_;  ///< of |filter| over [-radius, radius]
  float scale_ = 1;  ///< integral of |filter| over integral of the filter
};

/// "box", "tent", ... Errors: Error{kUnknownName} with the known names.
FilterKind parse_filter(const std::string& name, const SourceLoc& loc = {});
std::string filter_name(FilterKind kind);

}  // namespace tempera
