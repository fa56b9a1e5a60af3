// SPDX-License-Identifier: Apache-2.0
#pragma once
// Tables of the Hosek-Wilkie models.

namespace tempera::sunsky {

/// Shape of the sky's radiance: [r g b][albedo 0, 1][turbidity 1 to 10][control point][coefficient A to I]. Control
/// points of a quintic Bézier curve over the cube root of the sun's elevation, 0 at the horizon, 1 at the zenith.
extern const double kSkyShape[3][2][10][6][9];
/// Its mean radiance, likewise.
extern const double kSkyMean[3][2][10][6];
/// Irradiance of the sun's disc: [turbidity 1 to 10][cube root of elevation over 90 degrees, times 45][r g b].
extern const double kSun[10][46][3];

}  // namespace tempera::sunsky
