// SPDX-License-Identifier: Apache-2.0
#pragma once
// Where the next samples of gradient-domain path tracing go: to pixels whose differences are noisy for their
// brightness. [Manzi 2016, Sec. 4.1]
#include <cstdint>
#include <vector>

#include "tempera/core/params.h"

namespace tempera {

struct AdaptiveOptions {
  enum class Mode { kOff, kPublished, kUnbiased };
  Mode mode = Mode::kOff;
  int batches = 4;
  float boost = 8;            ///< samples of a pixel in a batch at most, in multiples of the batch's mean
  bool by_luminance = false;  ///< variance over luminance, as the paper says; else over its square, as its program does

  /// The parameters that set these, for tables of integrators.
  static const std::vector<ParamSpec>& params();
  /// From parameters with those specifications.
  explicit AdaptiveOptions(const Params& p);
  AdaptiveOptions() = default;
};

/// How the samples of a pixel, on average, are divided into batches: the first is the same for all pixels.
struct BatchPlan {
  int first = 0;           ///< samples of every pixel in the first batch
  int later = 0;           ///< mean samples of a pixel in each later batch
  int count = 1;           ///< batches
  bool keep_first = true;  ///< whether the first batch is part of the picture
};
/// Uniform sampling is one batch. Batches have at least 4 samples, if need be by being fewer.
/// Errors: Error{kOutOfRange} if `spp` is too few for two batches.
BatchPlan plan_batches(const AdaptiveOptions& options, int spp);

/// What is known about a pixel, sums over RGB.
struct PixelNoise {
  float variance = 0;  ///< of its mean differences to the right and downwards
  float radiance = 0;  ///< mean
  int samples = 0;     ///< taken so far
};

/// Samples of each pixel in the next batch, row by row; `mean` on average but for rounding and at least 2.
/// `seed`: decides which pixels get the sample that is left over by rounding down.
/// Pre: noise has width * height entries; mean > 2. Threads: uses parallel_for.
std::vector<int> next_batch(const AdaptiveOptions& options, const std::vector<PixelNoise>& noise, int width, int height,
                            int mean, std::uint64_t seed);

}  // namespace tempera
