// SPDX-License-Identifier: Apache-2.0
#pragma once
// How far a picture is from a reference: mean squared errors of the values, and FLIP, the difference that a person sees
// when alternating between the two. Of layers with more channels the first three count; fewer channels are gray.
#include <cstdint>

#include "tempera/frames/image.h"

namespace tempera {

/// Mean over pixels and channels of (test - reference)^2.
/// Shapes:  both images of one size; `map`, if given, receives the mean over channels of each pixel, [h,w,1].
/// Result:  pixels with a value that is not finite in either image are left out, and 0 in the map; see
///          count_non_finite. The same bits on any number of threads.
/// Errors:  Error{kBadInput} if the sizes differ.
double mse(const Image& test, const Image& reference, Image* map = nullptr);

/// Mean over pixels and channels of (test - reference)^2 / (reference^2 + epsilon). Otherwise as mse.
double relative_mse(const Image& test, const Image& reference, Image* map = nullptr, double epsilon = 1e-2);

/// Number of pixels whose first three channels are not all finite.
std::int64_t count_non_finite(const Image& image);

/// The default: a 0.7 m wide display of 3840 pixels seen from 0.7 m.
inline constexpr float kPixelsPerDegree = 67.0206433f;

/// FLIP of two pictures as shown: linear RGB, clamped to [0,1] (NaN counts as 0). In [0,1], 0 for equal pictures.
/// `map`, if given, receives the difference of each pixel, [h,w,1]; the result is its mean.
/// Errors: Error{kBadInput} if the sizes differ. Result: the same bits on any number of threads.
/// Source: [Andersson 2020]; agrees with NVIDIA's tool to 1e-4.
double flip(const Image& test, const Image& reference, Image* map = nullptr,
            float pixels_per_degree = kPixelsPerDegree);

/// HDR-FLIP: the largest FLIP of each pixel over the exposures at which the reference's highlights to shadows can be
/// seen, with ACES tone mapping. Values are scene-linear; negative ones and NaN count as 0.
/// Exposures follow from the reference as in the paper. DEVIATION: where more than half of the reference is black,
/// whose median exposure would be infinite, the median is taken over the other pixels; an all-black reference is
/// compared at exposure 0. Source: [Andersson 2021]; otherwise as flip.
double hdr_flip(const Image& test, const Image& reference, Image* map = nullptr,
                float pixels_per_degree = kPixelsPerDegree);

/// The exposures that hdr_flip uses, in stops.
struct FlipExposures {
  float start = 0, stop = 0;
  int count = 2;
};
FlipExposures flip_exposures(const Image& reference);

}  // namespace tempera
