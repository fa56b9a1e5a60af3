// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures as a display shows them, and the metrics that are defined on those; private to the module.
#include <cmath>

#include "tempera/core/fast_math.h"
#include "tempera/frames/image.h"

namespace tempera {

/// Multiplied by 2^exposure, clipped to [0,1] (NaN becomes 0), encoded as sRGB: [h,w,3], and the Rec. 709 luminance of
/// the clipped color, encoded as sRGB: [h,w,1].
Image display_colors(const Image& image, float exposure);
Image display_luminance(const Image& image, float exposure);

/// Of pictures that display_colors made.
double encoded_mse(const Image& test, const Image& reference);
/// Of pictures that display_luminance made.
double encoded_ssim(const Image& test, const Image& reference);

/// Infinity for 0, and for less, which a mean square without the noise of references can be.
inline double decibels_below_peak(double mean_square) { return -10 * std::log10(mean_square < 0 ? 0 : mean_square); }

/// The mean of two pictures, of their first three channels where one of them has more than the other. Errors:
/// Error{kBadInput} if sizes differ.
Image mean_of(const Image& a, const Image& b);

}  // namespace tempera
