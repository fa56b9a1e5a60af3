// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/display.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"

namespace tempera {
namespace {

/// S. Hill's fit of the ACES reference rendering and sRGB output transforms (BakingLab, MIT licence): a matrix into the
/// space of the curve, a rational curve per channel, and a matrix back.
Rgb filmic(const Rgb& scene) {
  constexpr float kMidGrayScale = 1.458f;  // the fit sends 0.18 to 0.106; this much exposure makes it 0.18
  const Rgb c = scene * kMidGrayScale;
  const auto curve = [](float v) {
    return (v * (v + 0.0245786f) - 0.000090537f) / (v * (0.983729f * v + 0.4329510f) + 0.238081f);
  };
  const float r = curve(0.59719f * c.r + 0.35458f * c.g + 0.04823f * c.b);
  const float g = curve(0.07600f * c.r + 0.90834f * c.g + 0.01566f * c.b);
  const float b = curve(0.02840f * c.r + 0.13383f * c.g + 0.83777f * c.b);
  return {1.60475f * r - 0.53108f * g - 0.07367f * b, -0.10208f * r + 1.10813f * g - 0.00605f * b,
          -0.00327f * r - 0.07276f * g + 1.07602f * b};
}

/// To [0,1]; NaN becomes 0, as the comparison is false.
float unit(float v) { return v > 0 ? std::min(v, 1.0f) : 0.0f; }
}  // namespace

ToneMap parse_tone_map(std::string_view text) {
  if (text == "srgb") return ToneMap::kSrgb;
  if (text == "filmic") return ToneMap::kFilmic;
  if (text == "none") return ToneMap::kNone;
  throw Error(ErrorCode::kUnknownName, fmt::format("unknown tone map \"{}\"; known: srgb, filmic, none", text));
}

Rgb tone_map(const Rgb& color, const DisplayOptions& options) {
  Rgb c = color * std::exp2(options.exposure);
  if (options.tone_map == ToneMap::kNone) return {unit(c.r), unit(c.g), unit(c.b)};
  if (options.tone_map == ToneMap::kFilmic) {
    // The curve of an infinite value is NaN; far above 1 it is flat.
    for (int i = 0; i < 3; ++i) c[i] = c[i] > 0 ? std::min(c[i], 1e6f) : 0.0f;
    c = filmic(c);
  }
  return {linear_to_srgb(unit(c.r)), linear_to_srgb(unit(c.g)), linear_to_srgb(unit(c.b))};
}

std::vector<std::uint8_t> to_rgb8(const Image& image, const DisplayOptions& options) {
  const std::size_t row_values = 3 * image.width();
  std::vector<std::uint8_t> out(row_values * image.height());
  parallel_rows(
      0, image.height(),
      [&](int y) {
        std::uint8_t* to = out.data() + row_values * y;
        for (int x = 0; x < image.width(); ++x) {
          const Rgb c = tone_map(image.rgb(x, y), options);
          for (int i = 0; i < 3; ++i) *to++ = std::uint8_t(c[i] * 255.0f + 0.5f);
        }
      },
      8);
  return out;
}

void write_png(const std::string& path, const Image& image, const DisplayOptions& options) {
  if (image.empty()) throw Error(ErrorCode::kBadInput, fmt::format("cannot write {}: the image is empty", path));
  const std::vector<std::uint8_t> pixels = to_rgb8(image, options);
  OIIO::Filesystem::IOVecOutput memory;  // see write_frame
  const auto out = OIIO::ImageOutput::create("image.png", &memory);
  OIIO::ImageSpec spec(image.width(), image.height(), 3, OIIO::TypeDesc::UINT8);
  if (options.tone_map != ToneMap::kNone) spec.attribute("oiio:ColorSpace", "sRGB");
  if (!out || !out->open("image.png", spec) || !out->write_image(OIIO::TypeDesc::UINT8, pixels.data()) ||
      !out->close()) {
    throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path, out ? out->geterror() : OIIO::geterror()));
  }
  const auto& bytes = memory.buffer();
  write_file(path, std::as_bytes(std::span(bytes.data(), bytes.size())));
}

Image resized(const Image& image, int width, int height) {
  TEMPERA_ASSERT(!image.empty() && width > 0 && height > 0);
  // Overlaps of a new pixel with the old ones along one axis: first index and weights.
  struct Span {
    int first;
    std::vector<float> weights;
  };
  const auto spans = [](int from, int to) {
    std::vector<Span> out;
    const double scale = double(from) / to;
    for (int i = 0; i < to; ++i) {
      const double a = i * scale, b = (i + 1) * scale;
      Span s{std::min(int(a), from - 1), {}};
      double sum = 0;
      for (int j = s.first; j < from && j < b; ++j) {
        const double w = std::min<double>(b, j + 1) - std::max<double>(a, j);
        if (w <= 1e-9 && !s.weights.empty()) break;
        s.weights.push_back(float(w));
        sum += w;
      }
      for (float& w : s.weights) w = float(w / sum);
      out.push_back(std::move(s));
    }
    return out;
  };
  const auto columns = spans(image.width(), width), rows = spans(image.height(), height);
  Image out(width, height, image.channels());
  parallel_rows(
      0, height,
      [&](int y) {
        const Span& r = rows[y];
        for (int x = 0; x < width; ++x) {
          const Span& c = columns[x];
          float* to = out.pixel(x, y);
          for (int j = 0; j < std::ssize(r.weights); ++j) {
            for (int i = 0; i < std::ssize(c.weights); ++i) {
              const float* from = image.pixel(c.first + i, r.first + j);
              for (int k = 0; k < image.channels(); ++k) to[k] += r.weights[j] * c.weights[i] * from[k];
            }
          }
        }
      },
      4);
  return out;
}

}  // namespace tempera
