// SPDX-License-Identifier: Apache-2.0
#pragma once
// How far a picture is from a reference: mean squared errors of the values, structural similarity, and FLIP, the
// difference that a person sees when alternating between the two; and how far the change from one picture to the next
// is from that of the reference. Of layers with more channels the first three count; fewer channels are gray.
//
// All functions: the same bits on any number of threads; Error{kBadInput} if sizes differ. A pixel with a value that is
// not finite in any of the pictures is left out, and 0 in maps [h,w,1], where what is said of it does not differ; NaN
// is returned if no pixel is left. docs/metrics.md has the formulas.
#include <cstdint>
#include <limits>

#include "tempera/frames/image.h"

namespace tempera {

/// The mean over those pixels of a picture that count.
struct PixelMean {
  double value = std::numeric_limits<double>::quiet_NaN();
  double coverage = 1;  ///< part of the pixels that counted, in [0,1]
};

/// Mean over pixels and channels of (test - reference)^2. `trim`: part of the pixels, those with the largest errors,
/// that is left out, in [0,1).
double mse(const Image& test, const Image& reference, Image* map = nullptr, double trim = 0);

/// Mean over pixels and channels of (test - reference)^2 / (reference^2 + epsilon). Source: [Rousselle 2011].
double relative_mse(const Image& test, const Image& reference, Image* map = nullptr, double epsilon = 1e-2,
                    double trim = 0);

/// As relative_mse, but relative to the square of the mean of the reference's channels, so that a saturated color does
/// not weigh more than a gray of the same brightness. Source: gradient-domain rendering [Kettunen 2015].
double relative_mse_gray(const Image& test, const Image& reference, Image* map = nullptr, double epsilon = 1e-3,
                         double trim = 0);

/// (mean luminance of test) / (mean luminance of reference) - 1: what a biased estimator loses or adds in total. NaN
/// for a black reference.
double luminance_bias(const Image& test, const Image& reference);

/// Peak signal-to-noise ratio, in dB, of the pictures as displayed: multiplied by 2^exposure, clipped to [0,1], encoded
/// as sRGB, so that the peak is 1; NaN counts as 0. Infinity for equal pictures. display_mse is the mean squared error
/// in it: psnr = -10 log10 display_mse.
double psnr(const Image& test, const Image& reference, float exposure = 0);
double display_mse(const Image& test, const Image& reference, float exposure = 0);

/// Mean structural similarity, at most 1, of the luminance of the pictures as displayed (multiplied by 2^exposure,
/// clipped to [0,1], Rec. 709 luminance, encoded as sRGB; NaN counts as 0): Gaussian window of 11x11 pixels and
/// deviation 1.5, K1 = 0.01, K2 = 0.03, over the pixels whose window lies inside of the picture. NaN for pictures
/// smaller than that. Source: [Wang 2004].
double ssim(const Image& test, const Image& reference, float exposure = 0);

/// Number of pixels whose first three channels are not all finite.
std::int64_t count_non_finite(const Image& image);

/// The default: a 0.7 m wide display of 3840 pixels seen from 0.7 m.
inline constexpr float kPixelsPerDegree = 67.0206433f;

/// FLIP of two pictures as shown: linear RGB, clamped to [0,1] (NaN counts as 0). In [0,1], 0 for equal pictures.
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

// --- From one frame to the next

/// Where in the previous frame each pixel of this one was: positions [h,w,2] in pixels, NaN where there is none.
/// `backward`: motion.backward of this frame; `forward_before`: motion.forward of the previous one, [h,w,2] or with a
/// validity channel as the last of four, conventions as in docs/motion-vectors.md.
/// A position is given if the vector is valid and stays inside of the picture, and if, with `forward_before`, the way
/// back ends where it began: |b + f|^2 <= 0.01 (|b|^2 + |f|^2) + 0.5, which surfaces that were hidden fail.
/// Source: [Sundaram 2010].
Image previous_positions(const Image& backward, const Image* forward_before = nullptr);

/// Mean over pixels and channels of ((T - T') - (R - R'))^2 / ((R^2 + R'^2) / 2 + epsilon), with T', R' the pictures
/// before: the relMSE of what changes. With `previous` (see previous_positions), T' and R' are looked up bilinearly
/// where each pixel came from, and pixels that came from nowhere are left out. DEVIATION from a plain relative_mse of
/// the differences: relative to the reference's frames, not to their difference, which is 0 wherever nothing moves and
/// would make of the relative error an absolute one, and which wrong vectors enlarge. So independent noise in
/// proportion to brightness gives twice the relative_mse, whatever moves.
PixelMean temporal_error(const Image& test, const Image& test_before, const Image& reference,
                         const Image& reference_before, const Image* previous = nullptr, Image* map = nullptr,
                         double epsilon = 1e-2, double trim = 0);

/// Mean over pixels and channels of (T - T')^2 / ((R^2 + R'^2) / 2 + epsilon), T' and R' looked up at `previous`: how
/// much what moves does not look as it did. Of the reference itself it tells how good the vectors are.
/// Source: [Lai 2018], here relative.
PixelMean warp_error(const Image& test, const Image& test_before, const Image& reference, const Image& reference_before,
                     const Image& previous, Image* map = nullptr, double epsilon = 1e-2, double trim = 0);

/// Mean distance between motion vectors, in pixels, over the pixels where both are valid.
PixelMean motion_error(const Image& test, const Image& reference, Image* map = nullptr);

/// Mean over pixels of |luminance(now) - luminance(before)|: what flickers, if nothing moves.
PixelMean luminance_change(const Image& now, const Image& before, Image* map = nullptr);

}  // namespace tempera
