// SPDX-License-Identifier: Apache-2.0
#pragma once
// How far the data of a frame are to be trusted, row by row: precisions for the Poisson solver from estimates of noise.
// Each estimate is a mean over the 5 x 5 pixels around without the one in the middle: a weight that depends on the
// datum which it weights, as variances of few samples do, makes the solution biased. So weight and datum share no more
// than the paths that neighbouring differences share.
//
// A precision is 2 r / (v + r) for a variance v and the median r: at most 2, because estimates from few samples are
// often far too small. For sums of norms it is the root of that, as their weights follow the residuals already.
// Spatial rows keep a precision of 0.04.
#include "tempera/frames/image.h"
#include "tempera/stages/poisson.h"

namespace tempera {

/// Variances of the spatial data of a frame, means over RGB: [h,w,1] each; negative where nothing is known.
struct DataVariance {
  Image dx, dy;
};

/// Sets the precisions of the spatial rows, and those of the primal rows to 1: where the picture is noisy because its
/// light is rare, samples that found none have too little variance. Returns the median variance, 0 without any.
double set_spatial_precision(PoissonFrame& frame, const DataVariance& variance, PoissonNorm norm);

/// Sets the precisions of the temporal and mixed rows from the data themselves: along motion there is little change, so
/// the mean square of the data around is their variance, or little more. `reference`: as returned above; 0: the median
/// over the mixed rows. Pre: motion and data to the next frame are set.
void set_temporal_precision(PoissonFrame& frame, double reference, PoissonNorm norm);

}  // namespace tempera
