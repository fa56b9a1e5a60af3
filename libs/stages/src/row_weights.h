// SPDX-License-Identifier: Apache-2.0
#pragma once
// How far the data of a frame are to be trusted, row by row: precisions for the Poisson solver from estimates of noise.
// Each estimate is a mean over the 5 x 5 pixels around without the one in the middle, so that a weight and its datum
// share no more than the paths that neighbouring differences share.
#include "tempera/frames/image.h"
#include "tempera/stages/poisson.h"

namespace tempera {

/// Variances of the primal and spatial data of a frame, means over RGB: [h,w,1] each.
struct DataVariance {
  Image primal, dx, dy;
};

/// Sets the precisions of the primal and spatial rows: `reference` over the variance around, limited from below.
/// Returns the reference, the median variance of the differences.
/// Primal rows are scaled so that with alpha 0.2 their weight is that of their variance, whatever it is.
double set_spatial_precision(PoissonFrame& frame, const DataVariance& variance);

/// Sets the precisions of the primal and spatial rows to 1.
void set_uniform_precision(PoissonFrame& frame);

/// Sets the precisions of the temporal and mixed rows from the data themselves: along motion there is little change, so
/// the mean square of the data around is their variance, or more. `reference`: as returned above; 0: the median over
/// the mixed rows. Pre: motion and data to the next frame are set.
void set_temporal_precision(PoissonFrame& frame, double reference);

}  // namespace tempera
