// SPDX-License-Identifier: Apache-2.0
#pragma once
// How a report stores images: as small as their noise allows, yet as numbers, so that the reader can change the
// exposure, read pixels and compute differences. A browser unpacks them with what it has: DecompressionStream and a few
// loops (libs/report/assets/codec.js).
//
// A value becomes a whole number of 16 bits, its code; a channel of codes is predicted from its neighbors, and what the
// prediction missed goes through deflate. docs/report.md states the format.
#include <cstdint>
#include <string>

#include "tempera/frames/image.h"

namespace tempera {

/// The code of a value v is sign(v) * round(steps * log2(1 + |v| / toe)): steps in proportion to the value far above
/// `toe`, even steps below it, so that noise around 0 costs nothing. 0 is exact, what is not finite has a code of its
/// own.
struct PictureCode {
  int steps = 64;  ///< per doubling of the value; the relative error is at most 2^(1 / (2 steps)) - 1
  float toe = 1;   ///< in units of the values, > 0
  bool operator==(const PictureCode&) const = default;
};

/// Largest relative error of values far above the toe, e.g. 0.0054 for 64 steps.
double relative_error(const PictureCode& code);

/// An encoded image. Its size is not part of it.
struct EncodedPicture {
  std::string bytes;       ///< a zlib stream
  int channels = 0;        ///< 1 or 3; of vectors 2
  bool gradient = false;   ///< which prediction: of the gradient, else the mean of four neighbors
  PictureCode code;        ///< of pictures
  double vector_step = 0;  ///< of vectors: pixels per code; else 0
};

struct EncodeOptions {
  double bytes_per_pixel = 1.7;  ///< at most, unless the coarsest code needs more
  int max_steps = 256;           ///< the finest code, for images that are easily within bytes_per_pixel
  int first_steps = 0;           ///< where the search begins, 0: at the finest; saves time for frames of a sequence
  float toe_octaves = 10;        ///< how far the toe lies below the median, in doublings
};

/// Encodes the first three channels, or the only one of images with fewer than three, as finely as the bound on the
/// size allows. Noise does not compress: the noisier a picture, the coarser its code, which stays a small part of the
/// noise. Shapes:  [h,w,c]. Threads: safe. Result: the same bytes for the same image and options.
EncodedPicture encode_picture(const Image& image, const EncodeOptions& options = {});

/// Encodes the first two channels of motion vectors in steps of 1/8 pixel. A vector whose fourth channel, the validity,
/// is below 0.5, or that is not finite, becomes invalid. Vectors longer than 4095 pixels are shortened to it.
EncodedPicture encode_vectors(const Image& vectors);

/// What a browser gets: [h,w,channels], NaN where the value was not finite (or the vector invalid).
/// Errors: Error{kBadInput} if the bytes are not those of such an image.
Image decode_picture(const EncodedPicture& picture, int width, int height);

/// Base64 with padding [RFC 4648, section 4].
std::string base64(std::string_view bytes);

}  // namespace tempera
