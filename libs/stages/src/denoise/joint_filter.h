// SPDX-License-Identifier: Apache-2.0
#pragma once
// Joint NL-means as published: the smaller of a weight by colors and one by features, each channel with a variance of its
// own, several parameter sets at once, and the derivative that unbiased error estimates need. nl_means.h is what our own
// denoiser uses in its place. Private to the denoiser.
#include <span>
#include <vector>

#include "denoise/planes.h"

namespace tempera::denoise {

/// A parameter set. [Rousselle 2013]
struct JointFilter {
  int patch = 3;      ///< radius of the patches that are compared
  bool color = true;  ///< else features alone decide
  float tau = 1e-3f;  ///< squared difference of features that counts as none
};

/// One frame of what is averaged, brought to the pixels of the frame that is filtered. Null: there is none.
struct JointFrame {
  const Planes* guide = nullptr;             ///< [h,w,n] whose patches are compared
  const Planes* variance = nullptr;          ///< [h,w,n] of it
  const Planes* values = nullptr;            ///< [h,w,m] that are averaged
  const Planes* features = nullptr;          ///< [h,w,k], each scaled to about [0,1]
  const Planes* feature_variance = nullptr;  ///< [h,w,k]; null: they have no noise
  const Planes* valid = nullptr;             ///< [h,w,1] 1 or 0; null: all are
};

struct JointSettings {
  int window = 10;                  ///< radius in pixels of what is averaged
  float k_color = 0.45f;            ///< how many standard deviations count as like
  float k_feature = 0.6f;           ///< the same for features
  float floor = 1e-10f;             ///< squared difference of colors that counts as equal
  std::vector<int> feature_groups;  ///< numbers of channels of each feature, whose differences are averaged
  bool derivative = false;          ///< whether JointResult::derivative is asked for
};

struct JointResult {
  Planes values;
  Planes gain;  ///< [h,w,1] in (0,1]: sum of the squared weights over the square of their sum, which is what is left
                ///< of the variance of noise that is independent between pixels
  Planes derivative;  ///< [h,w,n]: by how much each channel of the filtered guide changes with that of the pixel itself
};

/// Filters the first of `frames` by each of `filters`.
/// Result: the same bits for any number of threads. Patches count the pixels that are there.
std::vector<JointResult> joint_filter(std::span<const JointFrame> frames, std::span<const JointFilter> filters,
                                      const JointSettings& settings);

/// Weights, before they are divided by their sum, that pixels give to those (dx, dy) away in the same frame, [h,w,1].
Planes joint_weights(const JointFrame& frame, const JointFilter& filter, const JointSettings& settings, int dx, int dy);

}  // namespace tempera::denoise
