// SPDX-License-Identifier: Apache-2.0
#pragma once
// Conjugate gradients and reweighting of a window on a CUDA device: what solve_poisson does after its direct start.
// Only in builds with TEMPERA_CUDA.
#include <functional>

#include "poisson_rows.h"

namespace tempera {

/// Devices that can be used.
int cuda_device_count();

/// The rounds of solve_poisson from `first_round` on (1: the first was solved directly), from and to x.
/// `unit`: what epsilon is relative to. `before_step(round, step)` may throw. Adds to `report` what it did.
/// Result:  that of the host but for rounding: weights are floats here. The same bits on the same kind of device.
/// Errors:  Error{kOutOfMemory} if the device has too little, Error{kFailed} with CUDA's message.
void solve_rounds_on_cuda(const FlatWindow& window, const PoissonSettings& settings, int first_round, double unit,
                          PlanarFrames& x, PoissonReport& report, const std::function<void(int, int)>& before_step);

}  // namespace tempera
