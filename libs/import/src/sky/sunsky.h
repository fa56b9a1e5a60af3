// SPDX-License-Identifier: Apache-2.0
#pragma once
// Sky and sun of the Hosek-Wilkie models as an image of the environment.
#include "tempera/core/grid.h"
#include "tempera/core/vec.h"

namespace tempera {

struct SunSkyParams {
  Vec3d sun_direction{0, 0, 1};  ///< towards the sun, z up; unit
  double turbidity = 3;          ///< in [1, 10]: 2 is arctic, 10 haze
  Rgb albedo{0.3f};              ///< of the ground, in [0, 1]
  double sky_scale = 1, sun_scale = 1;
  double sun_aperture = 0.5358;  ///< full angle in degrees; the sun's power does not depend on it
};

/// Radiance of the clear sky without the sun in unit direction `d` (z up), scene-linear RGB: W/(m^2 sr nm) weighed
/// by the CIE 1931 observer and divided by 106.75 nm, the integral of its y, as in Mitsuba. Zero below the horizon, and
/// everywhere when the sun is there. [Hosek 2012]
class Sky {
 public:
  explicit Sky(const SunSkyParams& params);
  Rgb radiance(const Vec3d& d) const;

 private:
  Vec3d sun_;
  double coefficients_[3][9];
  double mean_[3];
};

/// Irradiance of the sun on a surface that faces it, in the units of `Sky`. [Hosek 2013]
Rgb sun_irradiance(const SunSkyParams& params);

/// Equirectangular image of sky and sun, with height = width / 2, in the layout of Environment::image
/// for an Environment whose local y is the model's z, x is x and z is -y. The sun is a uniform disc whose pixels add up
/// to its irradiance exactly.
Grid<Rgb> sun_sky_image(const SunSkyParams& params, int width);

/// A time and place on Earth. `hour` is local time in `timezone` (hours ahead of UTC); latitude and longitude in
/// degrees, north and east positive.
struct SunTime {
  int year = 2010, month = 7, day = 10;
  double hour = 15, minute = 0, second = 0;
  double latitude = 35.6894, longitude = 139.6917, timezone = 9;
};
/// Angles of the sun in radians: from the zenith, and from north through east. [Blanco-Muriel 2001]
struct SunAngles {
  double zenith = 0, azimuth = 0;
};
SunAngles sun_position(const SunTime& time);

}  // namespace tempera
