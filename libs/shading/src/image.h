// SPDX-License-Identifier: Apache-2.0
#pragma once
// Images that textures look into. They are decoded into memory once, up to a budget; what exceeds it is paged in tiles
// through OpenImageIO's image cache, with the same results. Measured for scattered bilinear lookups in 1024 x 1024
// bytes (bench/shading_bench.cpp): decoded 35 ns, paged 300 ns, OpenImageIO's TextureSystem 120 ns, which would
// interpolate sRGB before decoding it.
#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/color.h"
#include "tempera/core/error.h"
#include "tempera/core/vec.h"
#include "tempera/shading/texture.h"

namespace tempera {

/// Linear red, green, blue and alpha; a gray image has three equal colors, one without alpha has alpha 1.
struct alignas(16) Texel {
  float c[4] = {};
  Texel operator+(const Texel& o) const { return {{c[0] + o.c[0], c[1] + o.c[1], c[2] + o.c[2], c[3] + o.c[3]}}; }
  Texel operator-(const Texel& o) const { return {{c[0] - o.c[0], c[1] - o.c[1], c[2] - o.c[2], c[3] - o.c[3]}}; }
  Texel operator*(float s) const { return {{c[0] * s, c[1] * s, c[2] * s, c[3] * s}}; }
};

/// How texels are stored. Gray images have one channel, all others four.
enum class TexelFormat : std::uint8_t { kByte1, kByte4, kHalf1, kHalf4, kFloat1, kFloat4, kPaged };

/// A decoded or paged image. Threads: const use is re-entrant.
class Image {
 public:
  virtual ~Image();
  int width = 0, height = 0;
  TexelFormat format = TexelFormat::kByte4;
  bool srgb = false;           ///< colors are sRGB encoded (bytes and pages; others are decoded when they are read)
  const void* data = nullptr;  ///< [height][width][channels] of level 0, row 0 at the top; null if paged
  /// Levels 1, 2, ... of halves of size (four linear half floats a texel); empty without mipmapping.
  struct Level {
    int width, height;
    std::vector<std::uint16_t> texels;
  };
  std::vector<Level> levels;
  /// Mean of all texels, computed on first use.
  virtual Texel mean() const = 0;
  /// w x h (at most 2 x 2) texels of a paged image from (x, y), row by row; all in range.
  virtual void page_block(int level, int x, int y, int w, int h, Texel* out) const;
  virtual int page_levels() const { return 1; }
  virtual void page_size(int level, int& w, int& h) const;
  bool repaired = false;  ///< some values of the file were replaced by 0: no numbers, infinite, or negative
};

inline constexpr const char* kRepairedTexels = "texels that are negative, infinite or not a number are read as 0";

struct ImageRequest {
  std::filesystem::path file;  ///< read this, or `encoded` if it is not empty
  std::string_view encoded;
  std::string name;           ///< for messages and to recognise the same image again
  bool auto_encoding = true;  ///< as the file says, see file_color_space; else `srgb` says
  bool srgb = false;
  bool mipmap = false;
  bool keep_negative = false;
};

/// The image of a request; equal requests share one while any is alive.
/// Errors: Error{kMissingFile}, Error{kBadInput} (broken or empty image), Error{kUnsupported} at `loc`. Threads: safe.
std::shared_ptr<const Image> load_image(const ImageRequest& request, const SourceLoc& loc);

/// Linear values of the 256 bytes, from sRGB or as fractions of 255.
const std::array<float, 256>& byte_table(bool srgb);
float half_to_float(std::uint16_t h);
std::uint16_t float_to_half(float f);

}  // namespace tempera
