// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a denoiser took out of a picture, given back as far as both halves of the samples agree that it is not noise, so
// that more samples always lead to the truth. Private to the denoiser.
#include "denoise/planes.h"

namespace tempera::denoise {

/// Pictures [h,w,3] of one frame.
struct ResidualInput {
  const Planes &a, &b;              ///< noisy halves
  const Planes &clean_a, &clean_b;  ///< the same denoised, each without looking at the other's values
  const Planes& clean;              ///< the denoised picture
};

/// `clean` with the residual (a + b) / 2 - clean added in bands of scales, each as far as its product between the
/// halves, less `margin` times the standard deviation of that, is above chance.
Planes return_residuals(const ResidualInput& in, float margin);

}  // namespace tempera::denoise
