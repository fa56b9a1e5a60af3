// SPDX-License-Identifier: Apache-2.0
#pragma once
// Bias and variance of a method from several runs of it; private to the module.
//
// With the errors E_i = T_i - R of K runs, relative to sqrt(R^2 + epsilon), and their sum S:
//   mean of <E_i, E_i>            = relmse
//   bias^2   = mean of <E_i, E_j> over pairs i != j = (<S,S> - sum <E_i,E_i>) / (K (K-1)): unbiased, and so negative at
//              times where there is no bias; what the reference is off by counts as bias
//   variance = relmse - bias^2, the sample variance over runs
// All of it, and the estimates without one of the runs, follow from <E_i,E_i>, <S,E_i> and <S,S>.
#include <span>
#include <vector>

#include "tempera/frames/image.h"
#include "tempera/measure/statistics.h"

namespace tempera {

/// Of one frame.
struct BiasVariance {
  double bias_squared, variance;
  /// The same without each of the runs; empty for less than three.
  std::vector<double> bias_squared_without, variance_without;
};

/// Pre: two runs at least, of the reference's size. Pixels that are not finite in all runs are left out; NaN if there
/// is none.
BiasVariance bias_and_variance(std::span<const Image* const> runs, const Image& reference, double epsilon);

/// Mean over frames of `estimates`, with the jackknife's standard error from `without`, [frame][run that is left out].
/// Source: [Quenouille 1956].
MeanError jackknife(std::span<const double> estimates, std::span<const std::vector<double>> without);

}  // namespace tempera
