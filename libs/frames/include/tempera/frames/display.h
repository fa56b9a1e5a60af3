// SPDX-License-Identifier: Apache-2.0
#pragma once
// From scene-linear values to 8-bit pictures: exposure, tone mapping, sRGB encoding, PNG files.
#include <cstdint>
#include <string>
#include <vector>

#include "tempera/core/color.h"
#include "tempera/frames/image.h"

namespace tempera {

enum class ToneMap {
  kSrgb,    ///< linear up to 1, clipped above; sRGB-encoded
  kFilmic,  ///< the ACES RRT and ODT as fitted by S. Hill, scaled so that 18 % gray keeps its place; sRGB-encoded
  kNone,    ///< values are shown as they are, clipped to [0,1]: data, or what is encoded already
};
/// Reads "srgb", "filmic" or "none". Errors: Error{kUnknownName} with the known names.
ToneMap parse_tone_map(std::string_view text);

struct DisplayOptions {
  float exposure = 0;  ///< in stops: values are multiplied by 2^exposure
  ToneMap tone_map = ToneMap::kSrgb;
};

/// Scene-linear color to display values in [0,1]. NaN becomes 0.
Rgb tone_map(const Rgb& color, const DisplayOptions& options);

/// 8-bit RGB rows, [h,w,3]; an image with one or two channels gives gray.
std::vector<std::uint8_t> to_rgb8(const Image& image, const DisplayOptions& options = {});

/// Writes the first three channels (or gray) as an 8-bit PNG. Errors: Error{kFailed}, as write_file.
void write_png(const std::string& path, const Image& image, const DisplayOptions& options = {});

/// `image` made `width` x `height` by averaging over the area of each new pixel, or by repetition where it grows.
Image resized(const Image& image, int width, int height);

}  // namespace tempera
