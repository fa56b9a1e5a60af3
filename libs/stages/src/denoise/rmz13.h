// SPDX-License-Identifier: Apache-2.0
#pragma once
// The denoiser of [Rousselle 2013], to compare with: three joint NL-means filters of all light in a frame, the best of
// which is selected for each pixel by an unbiased estimate of its error, and a second pass. Private to the denoiser.
#include <vector>

#include "denoise/joint_filter.h"

namespace tempera::denoise {

/// A feature, scaled to about [0,1], and the variance of its noise.
struct Feature {
  Planes values, variance;
};

/// Upper bound of the variance of means of `samples` samples that lie within what the 3x3 pixels around show.
/// [Bhatia 2000]
Planes bounded_variance(const Planes& means, int samples);

/// The feature without most of its noise, with the variance of what remains: NL-means by itself alone.
Feature prefilter(Feature feature);

/// Several features one after another, as JointFrame and JointSettings take them.
struct FeatureStack {
  Planes values, variance;
  std::vector<int> groups;
  void add(const Feature& feature);
};

struct Rmz13Input {
  const Planes &a, &b;     ///< [h,w,3] halves of the samples; b empty: all samples are in a
  const Planes& variance;  ///< [h,w,3] of their mean
  const FeatureStack& features;
};

struct Rmz13Result {
  Planes color;
  Planes candidates;  ///< [h,w,9] of the filters that keep colors, balance, and keep features
  Planes errors;      ///< [h,w,3] estimated mean squared errors of these, not smoothed yet
  Planes selection;   ///< [h,w,3] shares of these in the picture, which add up to 1
};

/// The second pass needs halves, which tell what noise remains, and is left out without.
/// Result: the same bits for any number of threads. Source: [Rousselle 2013]; what differs is in docs/denoising.md.
Rmz13Result rmz13(const Rmz13Input& in);

}  // namespace tempera::denoise
