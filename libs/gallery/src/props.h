// SPDX-License-Identifier: Apache-2.0
#pragma once
// Things and pictures that several scenes use.
#include "builder.h"

namespace tempera::gallery {

/// A teapot of our own shape, 0.1 m in radius, on y = 0 with its spout towards +x. A hollow one is a vessel with a wall
/// of 7 mm: one closed surface outside and one inside. `cell` is the edge of the grid that it is made on, in metres.
Polygons teapot(bool hollow, double cell);

/// A painting of hills under a sun.
Picture landscape(int width, int height, std::uint64_t seed);
/// Sky that brightens towards the horizon, with ground below it and a disc of `sun_radius` degrees with soft edge that
/// holds `sun_share` of the irradiance of a horizontal surface. `sun` need not be normalized. The sum is scaled to
/// `irradiance` (mean of the channels, W/m^2).
Picture sky(int width, const Vec3d& sun, double sun_radius, double sun_share, double irradiance,
            const Rgb& zenith = {0.12f, 0.26f, 0.62f}, const Rgb& horizon = {0.50f, 0.62f, 0.82f},
            const Rgb& ground = {0.20f, 0.19f, 0.17f}, const Rgb& sun_color = {1.0f, 0.86f, 0.68f});

/// A frame of four mitred bars around a picture of `size`, in the x-y plane, facing +z.
Polygons picture_frame(const Vec2d& size, double bar, double depth);

}  // namespace tempera::gallery
