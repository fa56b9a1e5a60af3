// SPDX-License-Identifier: Apache-2.0
#pragma once
// Non-local means over a few frames, with weights from another picture than the one that is averaged and from features.
// Private to the denoiser.
#include <span>
#include <vector>

#include "denoise/planes.h"

namespace tempera::denoise {

/// One frame of what is averaged, brought to the pixels of the frame that is denoised.
struct NlMeansFrame {
  const Planes* a = nullptr;         ///< [h,w,3] half of the samples
  const Planes* b = nullptr;         ///< the other half, independent of it; null: there are no halves
  const Planes* variance = nullptr;  ///< [h,w,1] of the mean of both halves, or of `a` alone
  const Planes* valid = nullptr;     ///< [h,w,1] 1 or 0; null: all are
  const Planes* features = nullptr;  ///< [h,w,n], without noise worth mentioning; null: none
};

struct NlMeansSettings {
  int window = 7;                     ///< radius in pixels of what is averaged
  int window_around = 4;              ///< the same in the frames around
  int patch = 3;                      ///< radius of the patches that are compared
  float k = 0.3f;                     ///< strength: how many standard deviations count as like
  float k_feature = 0.6f;             ///< the same for features
  float floor = 1e-10f;               ///< squared difference that counts as equal
  int every = 1;                      ///< only each n-th tile is made, for trials; pixels of the others are 0
  std::vector<int> feature_groups;    ///< numbers of channels of each feature, whose differences are averaged
  std::vector<float> feature_floors;  ///< squared difference of each feature that counts as none
};

/// Halves of the result, or the whole in `a`.
struct NlMeansResult {
  Planes a, b;
};

/// Denoises the first of `frames`. Each half is averaged with weights from the other one, so that they stay independent
/// of their own noise; without halves, with weights from itself.
/// Result: the same bits for any number of threads. Source: [Rousselle 2013], with one variance for all channels.
NlMeansResult nl_means(std::span<const NlMeansFrame> frames, const NlMeansSettings& settings);

/// Whether pixel (x, y) belongs to the tiles that `every` selects.
bool is_on_trial(int x, int y, int every);

}  // namespace tempera::denoise
