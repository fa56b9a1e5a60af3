// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/picture.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <span>

#include "tempera/core/color.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera::gallery {

Picture paint(int width, int height, const std::function<Rgb(double u, double v)>& color) {
  Picture p(width, height);
  parallel_rows(0, height, [&](int y) {
    for (int x = 0; x < width; ++x) p.at(x, y) = color((x + 0.5) / width, (double(y) + 0.5) / height);
  });
  return p;
}

Picture paint_environment(int width, int height, const std::function<Rgb(const Vec3d& direction)>& radiance) {
  return paint(width, height, [&](double u, double v) {
    const double phi = 2 * kPiD * u, theta = kPiD * v;
    return radiance({std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)});
  });
}

Picture paint_normals(int width, int height, const std::function<double(double u, double v)>& height_at) {
  const double e = 0.5 / width;
  return paint(width, height, [&](double u, double v) {
    const double dx = (height_at(u + e, v) - height_at(u - e, v)) / (2 * e),
                 dy = (height_at(u, v + e) - height_at(u, v - e)) / (2 * e);
    const Vec3d n = normalize(Vec3d{-dx, dy, 1});  // green points up, v down
    return Rgb{float(0.5 + 0.5 * n.x), float(0.5 + 0.5 * n.y), float(0.5 + 0.5 * n.z)};
  });
}

namespace {

std::string encode(const char* name, const OIIO::ImageSpec& spec, OIIO::TypeDesc type, const void* data) {
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput memory(bytes);
  const auto out = OIIO::ImageOutput::create(name, &memory);
  if (!out || !out->open(name, spec) || !out->write_image(type, data) || !out->close())
    throw Error(ErrorCode::kFailed,
                fmt::format("cannot encode {}: {}", name, out ? out->geterror() : OIIO::geterror()));
  return {bytes.begin(), bytes.end()};
}

}  // namespace

std::string encode_png(const Picture& picture, bool srgb) {
  const bool gray = std::all_of(picture.begin(), picture.end(), [](const Rgb& c) { return c.r == c.g && c.g == c.b; });
  const int channels = gray ? 1 : 3;
  std::vector<std::uint8_t> values;
  values.reserve(picture.size() * channels);
  for (const Rgb& c : picture) {
    for (int i = 0; i < channels; ++i) {
      const float v = std::clamp(c[i], 0.0f, 1.0f);
      values.push_back(std::uint8_t((srgb ? linear_to_srgb(v) : v) * 255 + 0.5f));
    }
  }
  OIIO::ImageSpec spec(picture.width(), picture.height(), channels, OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:ColorSpace", srgb ? "sRGB" : "Linear");
  return encode("texture.png", spec, OIIO::TypeDesc::UINT8, values.data());
}

std::string encode_exr(const Picture& picture) {
  OIIO::ImageSpec spec(picture.width(), picture.height(), 3, OIIO::TypeDesc::HALF);
  spec.attribute("compression", "zip");
  spec.attribute("DateTime", "2000:01:01 00:00:00");  // else the time of writing
  static_assert(sizeof(Rgb) == 3 * sizeof(float));
  return encode("environment.exr", spec, OIIO::TypeDesc::FLOAT, picture.data());
}

namespace {

double fade(double t) { return t * t * t * (t * (t * 6 - 15) + 10); }

/// Gradient noise over cells that repeat after `period` in x and y (0: never).
double gradient_noise(const Vec3d& p, std::uint64_t seed, std::int64_t period) {
  const Vec3d cell{std::floor(p.x), std::floor(p.y), std::floor(p.z)}, f = p - cell;
  const auto wrap = [&](double x) {
    const auto i = std::int64_t(x);
    return std::uint64_t(period > 0 ? ((i % period) + period) % period : i);
  };
  const auto corner = [&](int i, int j, int k) {
    const std::uint64_t h = hash_key(seed, wrap(cell.x + i), wrap(cell.y + j), std::uint64_t(std::int64_t(cell.z) + k));
    const double x = f.x - i, y = f.y - j, z = f.z - k;
    // One of the twelve directions to the edges of a cube.
    const int g = int(h % 12), axis = g >> 2;
    const double a = axis == 0 ? y : x, b = axis == 2 ? y : z;
    return (g & 1 ? -a : a) + (g & 2 ? -b : b);
  };
  const auto line = [](double a, double b, double t) { return a + (b - a) * t; };
  const double u = fade(f.x), v = fade(f.y), w = fade(f.z);
  return line(line(line(corner(0, 0, 0), corner(1, 0, 0), u), line(corner(0, 1, 0), corner(1, 1, 0), u), v),
              line(line(corner(0, 0, 1), corner(1, 0, 1), u), line(corner(0, 1, 1), corner(1, 1, 1), u), v), w);
}

}  // namespace

double noise(const Vec3d& p, std::uint64_t seed) { return gradient_noise(p, seed, 0); }

double fractal_noise(const Vec3d& p, int octaves, std::uint64_t seed) {
  double sum = 0, size = 1;
  Vec3d q = p;
  for (int i = 0; i < octaves; ++i, q = q * 2.0, size /= 2) sum += size * gradient_noise(q, seed + std::uint64_t(i), 0);
  return sum;
}

double tiled_noise(double u, double v, int scale, int octaves, std::uint64_t seed) {
  double sum = 0, size = 1;
  for (int i = 0; i < octaves; ++i, scale *= 2, size /= 2)
    sum += size * gradient_noise({u * scale, v * scale, 0.5}, seed + std::uint64_t(i), scale);
  return sum;
}

double random(std::uint64_t seed, std::uint64_t a, std::uint64_t b, std::uint64_t c) {
  return double(hash_key(seed, a, b, c) >> 11) * 0x1p-53;
}

double smooth_step(double a, double b, double x) {
  const double t = std::clamp((x - a) / (b - a), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

Rgb mix(const Rgb& a, const Rgb& b, double t) { return a + (b - a) * float(t); }

Rgb hex(std::string_view text) {
  const auto channel = [&](std::size_t i) {
    int v = 0;
    std::from_chars(text.data() + i, text.data() + i + 2, v, 16);
    return srgb_to_linear(float(v) / 255);
  };
  TEMPERA_ASSERT(text.size() == 7 && text[0] == '#');
  return {channel(1), channel(3), channel(5)};
}

namespace {

/// Seven rows of five dots, the leftmost dot in bit 4.
struct Letter {
  char name;
  std::array<std::uint8_t, 7> rows;
};
constexpr Letter kLetters[] = {
    {'A', {14, 17, 17, 31, 17, 17, 17}}, {'B', {30, 17, 17, 30, 17, 17, 30}}, {'C', {14, 17, 16, 16, 16, 17, 14}},
    {'D', {30, 17, 17, 17, 17, 17, 30}}, {'E', {31, 16, 16, 30, 16, 16, 31}}, {'F', {31, 16, 16, 30, 16, 16, 16}},
    {'G', {14, 17, 16, 23, 17, 17, 14}}, {'H', {17, 17, 17, 31, 17, 17, 17}}, {'I', {14, 4, 4, 4, 4, 4, 14}},
    {'J', {7, 2, 2, 2, 2, 18, 12}},      {'K', {17, 18, 20, 24, 20, 18, 17}}, {'L', {16, 16, 16, 16, 16, 16, 31}},
    {'M', {17, 27, 21, 21, 17, 17, 17}}, {'N', {17, 25, 21, 19, 17, 17, 17}}, {'O', {14, 17, 17, 17, 17, 17, 14}},
    {'P', {30, 17, 17, 30, 16, 16, 16}}, {'Q', {14, 17, 17, 17, 21, 18, 13}}, {'R', {30, 17, 17, 30, 20, 18, 17}},
    {'S', {15, 16, 16, 14, 1, 1, 30}},   {'T', {31, 4, 4, 4, 4, 4, 4}},       {'U', {17, 17, 17, 17, 17, 17, 14}},
    {'V', {17, 17, 17, 17, 17, 10, 4}},  {'W', {17, 17, 17, 21, 21, 27, 17}}, {'X', {17, 17, 10, 4, 10, 17, 17}},
    {'Y', {17, 17, 10, 4, 4, 4, 4}},     {'Z', {31, 1, 2, 4, 8, 16, 31}},     {'0', {14, 17, 19, 21, 25, 17, 14}},
    {'1', {4, 12, 4, 4, 4, 4, 14}},      {'2', {14, 17, 1, 6, 8, 16, 31}},    {'3', {14, 17, 1, 6, 1, 17, 14}},
    {'4', {2, 6, 10, 18, 31, 2, 2}},     {'5', {31, 16, 30, 1, 1, 17, 14}},   {'6', {14, 16, 30, 17, 17, 17, 14}},
    {'7', {31, 1, 2, 4, 4, 4, 4}},       {'8', {14, 17, 17, 14, 17, 17, 14}}, {'9', {14, 17, 17, 15, 1, 1, 14}},
    {'-', {0, 0, 0, 31, 0, 0, 0}},       {'.', {0, 0, 0, 0, 0, 12, 12}},      {'/', {1, 1, 2, 4, 8, 16, 16}},
    {'+', {0, 4, 4, 31, 4, 4, 0}},
};

}  // namespace

double text_coverage(std::string_view text, double x, double y) {
  const int row = int(std::floor(y)), dot = int(std::floor(x));
  if (row < 0 || row >= 7 || dot < 0) return 0;
  const std::size_t index = dot / 6;
  const int column = dot % 6;
  if (index >= text.size() || column == 5) return 0;
  const auto letter =
      std::find_if(std::begin(kLetters), std::end(kLetters), [&](const Letter& l) { return l.name == text[index]; });
  if (letter == std::end(kLetters)) return 0;
  return letter->rows[row] >> (4 - column) & 1;
}

int checker(double u, double v) { return int(std::int64_t(std::floor(u)) + std::int64_t(std::floor(v))) & 1; }

Brick brick(double u, double v, double height, double shift) {
  Brick b;
  b.row = int(std::floor(v / height));
  const double moved = u + b.row * shift;
  b.column = int(std::floor(moved));
  b.u = moved - b.column;
  b.v = v / height - b.row;
  b.from_joint = std::min({b.u, 1 - b.u, b.v * height, (1 - b.v) * height});
  return b;
}

}  // namespace tempera::gallery
