// SPDX-License-Identifier: Apache-2.0
#pragma once
// How far motion that is resampled at knots strays from the motion that was authored.
#include <functional>
#include <span>

#include "tempera/accel/motion_grid.h"

namespace tempera {

/// How far apart two places are for who looks at time t (seconds), in units of the caller's; 0: it does not matter.
using MotionDistance = std::function<double(const Vec3f& authored, const Vec3f& resampled, double t)>;

/// Largest distance of matter from where it should be in each of `exposures`, if its motion is resampled at knots
/// `motion_step` seconds apart. Looks at some vertices of each mesh that moves and at the corners of analytic shapes,
/// three times a segment. Instances that are hidden all the time are left out. Threads: uses parallel_for.
std::vector<double> motion_errors(const Scene& scene, std::span<const TimeSpan> exposures, double motion_step,
                                  const MotionDistance& distance);

}  // namespace tempera
