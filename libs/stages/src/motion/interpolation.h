// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the ways to make a frame between two keys share. Private to the stage `interpolate`.
#include <map>

#include "denoise/planes.h"
#include "motion/parts.h"
#include "motion/projection.h"

namespace tempera::motion {

/// Layer `name` of a frame, null if it has none. Errors: Error{kBadInput} that names `what` and the frame, for fewer
/// channels.
const Image* image_of(const Frame& frame, const std::string& name, int channels, const char* what, int number);
/// The first channels of an image, `missing` for none, 0 for what is damaged.
denoise::Planes planes_of(const Image* image, int channels, float missing, int width, int height);

/// How the light of a part of a frame becomes irradiance: (color - emission) / divisor.
struct Light {
  denoise::Planes color;     ///< [h,w,3] radiance
  denoise::Planes divisor;   ///< [h,w,3] reflectance, kLeastReflectance at least
  denoise::Planes emission;  ///< [h,w,3]

  /// Errors: those of image_of.
  Light(const Frame& frame, const Part& part, const char* what, int number);
  denoise::Planes irradiance(const denoise::Planes& of) const;
};

/// What is made of a part of the light.
struct Made {
  denoise::Planes color;        ///< [h,w,3]
  Grid<std::uint8_t> unwanted;  ///< 1 where it is better rendered
};

/// A part of two keys, and of the frame that is made of them.
struct BetweenKeys {
  const Frame &key_before, &key_after;
  int before, frame, after;
  const Part& part;
  const std::map<int, Surfaces>& surfaces;  ///< of the part, in all frames from the first key to the second
  bool follow_light;                        ///< whether light may move otherwise than the surfaces that it is seen on
  /// How much of the light is that of the later key, by time.
  float share() const { return float(frame - before) / float(after - before); }
};

/// As the paper does it: pixels of the keys are projected to the frame along their vectors, and those of both keys
/// averaged by time. [Zimmer 2015, Sec. 5.3]
Made interpolate_published(const BetweenKeys& in);

}  // namespace tempera::motion
