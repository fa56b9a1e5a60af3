// SPDX-License-Identifier: Apache-2.0
#include "tempera/report/picture_code.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

namespace tempera {
namespace {

constexpr int kNotFinite = -32768, kLargest = 32767;
constexpr double kVectorStep = 0.125;  // pixels

/// Steps per doubling that pictures may have, finest first.
constexpr std::array<int, 22> kSteps{256, 192, 160, 128, 112, 96, 80, 64, 56, 48, 40,
                                     32,  28,  24,  20,  16,  12, 8,  6,  4,  3,  2};

/// Codes of all channels, one plane after another.
struct Codes {
  int width = 0, height = 0, channels = 0;
  std::vector<std::int16_t> values;
  std::size_t pixels() const { return std::size_t(width) * height; }
  std::int16_t* plane(int c) { return values.data() + pixels() * c; }
  const std::int16_t* plane(int c) const { return const_cast<Codes*>(this)->plane(c); }
};

/// Below the toe lies little of what a picture tells: it is `octaves` under the median of what is not 0, rounded to
/// a power of two so that codes of neighboring frames agree.
float choose_toe(const Image& image, int channels, float octaves) {
  std::vector<float> sample;
  const std::int64_t stride = std::max<std::int64_t>(1, image.pixels() / 16384);
  for (std::int64_t i = 0; i < image.pixels(); i += stride) {
    const float* p = image.values().data() + i * image.channels();
    for (int c = 0; c < channels; ++c) {
      const float v = std::abs(p[c]);
      if (v > 0 && std::isfinite(v)) sample.push_back(v);
    }
  }
  if (sample.empty()) return std::exp2(-octaves);
  const auto middle = sample.begin() + std::ptrdiff_t(sample.size() / 2);
  std::nth_element(sample.begin(), middle, sample.end());
  // Within the normal numbers, and with room above for the largest values.
  return std::exp2(std::clamp(std::round(std::log2(*middle)), -100.0f, 100.0f) - octaves);
}

/// log2(1 + |v| / toe) with the sign of v: codes are multiples of it, rounded. NaN for what is not finite.
std::vector<float> octaves_of(const Image& image, int channels, float toe) {
  const std::size_t n = image.pixels();
  std::vector<float> out(n * channels);
  const float base = std::log2(toe);  // exact: the toe is a power of two, so that 0 becomes 0
  for (int c = 0; c < channels; ++c) {
    float* to = out.data() + n * c;
    const float* from = image.values().data() + c;
    for (std::size_t i = 0; i < n; ++i, from += image.channels()) {
      const float v = *from;
      to[i] = std::isfinite(v) ? std::copysign(std::log2(toe + std::abs(v)) - base, v) : NAN;
    }
  }
  return out;
}

Codes codes_of(const std::vector<float>& octaves, int width, int height, int channels, int steps) {
  Codes codes{width, height, channels, std::vector<std::int16_t>(octaves.size())};
  for (std::size_t i = 0; i < octaves.size(); ++i) {
    const float v = octaves[i];
    codes.values[i] = std::int16_t(std::isnan(v) ? kNotFinite : std::lround(v * float(steps)));
  }
  return codes;
}

/// Noise is much alike in all channels: red and blue are stored as their differences to green, modulo 2^16. `kSign` -1
/// makes the differences, 1 undoes it.
template <int kSign>
void add_green(Codes& codes) {
  if (codes.channels != 3) return;
  const std::size_t n = codes.values.size() / 3;
  const std::int16_t* g = codes.plane(1);
  for (const int channel : {0, 2}) {
    std::int16_t* values = codes.plane(channel);
    for (std::size_t i = 0; i < n; ++i) values[i] = std::int16_t(unsigned(values[i]) + unsigned(kSign * g[i]));
  }
}

/// What is expected of a code, given those to the west, north, northwest and northeast. The mean suits noise, the
/// gradient (the median of W, N and W + N - NW, as in JPEG-LS) suits smooth surfaces and edges.
inline int expected(bool gradient, int w, int n, int nw, int ne) {
  if (!gradient) return (w + n + nw + ne + 2) >> 2;
  const int low = std::min(w, n), high = std::max(w, n);
  return nw >= high ? low : nw <= low ? high : w + n - nw;
}

/// Calls visit(index, prediction) in the order of a reader, row by row; codes[index] is read only after its visit.
/// Outside of the image stands the nearest known code, 0 for the very first.
template <class Visit>
void predict(bool gradient, const std::int16_t* codes, int width, int height, const Visit& visit) {
  for (int y = 0; y < height; ++y) {
    const std::size_t row = std::size_t(y) * width;
    const std::int16_t* here = codes + row;
    const std::int16_t* above = y > 0 ? here - width : nullptr;
    for (int x = 0; x < width; ++x) {
      int prediction = 0;
      if (y == 0) {
        prediction = x > 0 ? here[x - 1] : 0;
      } else if (x == 0) {
        prediction = above[0];
      } else {
        prediction = expected(gradient, here[x - 1], above[x], above[x - 1], above[x + 1 < width ? x + 1 : x]);
      }
      visit(row + x, prediction);
    }
  }
}

/// Residuals of all channels as bytes: per channel the plane of low bytes, then that of high bytes. 128 is added to
/// both halves so that small residuals of either sign have one high byte.
std::string residual_bytes(const Codes& codes, bool gradient) {
  const std::size_t n = codes.pixels();
  std::string bytes(2 * n * codes.channels, '\0');
  for (int c = 0; c < codes.channels; ++c) {
    char* low = bytes.data() + 2 * n * c;
    char* high = low + n;
    const std::int16_t* plane = codes.plane(c);
    predict(gradient, plane, codes.width, codes.height, [&](std::size_t i, int prediction) {
      const unsigned residual = unsigned(plane[i] - prediction) + 0x8080u;
      low[i] = char(residual & 0xff);
      high[i] = char((residual >> 8) & 0xff);
    });
  }
  return bytes;
}

/// Whether the gradient predicts better, by the sum of absolute residuals of every fourth row.
bool gradient_is_better(const Codes& codes) {
  std::int64_t difference = 0;
  for (int c = 0; c < codes.channels; ++c) {
    for (int y = 1; y < codes.height; y += 4) {
      const std::int16_t* here = codes.plane(c) + std::size_t(y) * codes.width;
      const std::int16_t* above = here - codes.width;
      for (int x = 1; x + 1 < codes.width; ++x) {
        const auto miss = [&](bool gradient) {
          return std::abs(here[x] - expected(gradient, here[x - 1], above[x], above[x - 1], above[x + 1]));
        };
        difference += miss(true) - miss(false);
      }
    }
  }
  return difference < 0;
}

/// `strategy` Z_RLE is six times faster than Z_FILTERED and as small for noise within 2 %.
std::string deflated(const std::string& bytes, int strategy) {
  z_stream stream{};
  if (deflateInit2(&stream, 6, Z_DEFLATED, 15, 9, strategy) != Z_OK) {
    throw Error(ErrorCode::kOutOfMemory, "cannot start zlib");
  }
  std::string out;
  out.resize(deflateBound(&stream, uLong(bytes.size())));
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = uInt(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = uInt(out.size());
  const int status = deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  if (status != Z_STREAM_END) throw Error(ErrorCode::kFailed, fmt::format("zlib failed with status {}", status));
  return out;
}

/// zlib counts in 32 bits; an image of a gigapixel has no place in a page anyway.
void check_size(const Image& image) {
  if (image.empty() || image.pixels() > (std::int64_t(1) << 28)) {
    throw Error(ErrorCode::kBadInput, fmt::format("a report cannot hold an image of {}x{} pixels; it takes 1 to 2^28",
                                                  image.width(), image.height()));
  }
}
}  // namespace

double relative_error(const PictureCode& code) { return std::exp2(0.5 / code.steps) - 1; }

EncodedPicture encode_picture(const Image& image, const EncodeOptions& options) {
  check_size(image);
  EncodedPicture out;
  out.channels = image.channels() >= 3 ? 3 : 1;
  out.code.toe = choose_toe(image, out.channels, options.toe_octaves);
  const std::vector<float> octaves = octaves_of(image, out.channels, out.code.toe);
  float most = 1;  // octaves; codes of the finest steps would not hold the range of some pictures
  for (const float v : octaves) most = std::max(most, std::isnan(v) ? 0 : std::abs(v));
  const double bound = options.bytes_per_pixel * double(image.pixels());
  std::string residuals;
  const auto fits = [&](int steps) {
    Codes codes = codes_of(octaves, image.width(), image.height(), out.channels, steps);
    add_green<-1>(codes);
    out.gradient = gradient_is_better(codes);
    out.code.steps = steps;
    residuals = residual_bytes(codes, out.gradient);
    out.bytes = deflated(residuals, Z_RLE);
    return double(out.bytes.size()) <= bound;
  };

  // From where the search begins, to finer codes while they fit, else to coarser ones until one does.
  const auto allowed = [&](int i) {
    const int steps = kSteps[i];
    return steps <= options.max_steps && float(steps) * most <= float(kLargest);
  };
  const int last = int(kSteps.size()) - 1;
  int first = 0;
  while (!allowed(first) && first < last) ++first;
  int i = first;
  while (options.first_steps > 0 && i < last && kSteps[i] > options.first_steps) ++i;
  bool fit = fits(kSteps[i]);
  if (fit) {
    while (i > first && fits(kSteps[i - 1])) --i;
    if (out.code.steps != kSteps[i]) fits(kSteps[i]);  // the finer one did not fit
  } else {
    while (!fit && i < last) fit = fits(kSteps[++i]);
  }
  if (out.bytes.size() < residuals.size() / 5) {  // there is more than noise: a search for repetitions pays
    std::string filtered = deflated(residuals, Z_FILTERED);
    if (filtered.size() < out.bytes.size()) out.bytes = std::move(filtered);
  }
  return out;
}

EncodedPicture encode_vectors(const Image& vectors) {
  check_size(vectors);
  TEMPERA_ASSERT(vectors.channels() >= 2);
  const std::size_t n = vectors.pixels();
  Codes codes{vectors.width(), vectors.height(), 2, std::vector<std::int16_t>(n * 2)};
  std::int16_t* x = codes.plane(0);
  std::int16_t* y = codes.plane(1);
  const float* from = vectors.values().data();
  for (std::size_t i = 0; i < n; ++i, from += vectors.channels()) {
    const bool valid = (vectors.channels() < 4 || from[3] >= 0.5f) && std::isfinite(from[0]) && std::isfinite(from[1]);
    const auto code = [&](float v) {
      return std::int16_t(valid ? std::lround(std::clamp(v, -4095.0f, 4095.0f) / kVectorStep) : kNotFinite);
    };
    x[i] = code(from[0]);
    y[i] = code(from[1]);
  }
  EncodedPicture out;
  out.channels = 2;
  out.vector_step = kVectorStep;
  out.gradient = true;
  out.bytes = deflated(residual_bytes(codes, true), Z_FILTERED);
  return out;
}

Image decode_picture(const EncodedPicture& picture, int width, int height) {
  Codes codes{width, height, picture.channels, {}};
  const std::size_t n = codes.pixels();
  codes.values.resize(n * picture.channels);
  std::string bytes(codes.values.size() * 2, '\0');
  uLongf size = uLongf(bytes.size());
  const int status = uncompress(reinterpret_cast<Bytef*>(bytes.data()), &size,
                                reinterpret_cast<const Bytef*>(picture.bytes.data()), uLong(picture.bytes.size()));
  if (status != Z_OK || size != bytes.size()) {
    throw Error(ErrorCode::kBadInput, fmt::format("a block of a report does not hold {}x{} pixels", width, height));
  }
  for (int c = 0; c < picture.channels; ++c) {
    const char* low = bytes.data() + 2 * n * c;
    const char* high = low + n;
    std::int16_t* plane = codes.plane(c);
    predict(picture.gradient, plane, width, height, [&](std::size_t i, int prediction) {
      const unsigned residual = (unsigned(std::uint8_t(low[i])) | unsigned(std::uint8_t(high[i])) << 8) - 0x8080u;
      plane[i] = std::int16_t(residual + unsigned(prediction));
    });
  }
  if (picture.vector_step == 0) add_green<1>(codes);
  Image out(width, height, picture.channels);
  for (int c = 0; c < picture.channels; ++c) {
    const std::int16_t* plane = codes.plane(c);
    float* to = out.values().data() + c;
    for (std::size_t i = 0; i < n; ++i, to += picture.channels) {
      const int code = plane[i];
      if (code == kNotFinite) {
        *to = NAN;
      } else if (picture.vector_step > 0) {
        *to = float(code * picture.vector_step);
      } else {
        const double value = picture.code.toe * (std::exp2(std::abs(code) / double(picture.code.steps)) - 1);
        *to = float(std::copysign(std::min(value, double(std::numeric_limits<float>::max())), code));
      }
    }
  }
  return out;
}

std::string base64(std::string_view bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  const auto at = [&](std::size_t i) { return i < bytes.size() ? unsigned(std::uint8_t(bytes[i])) : 0u; };
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const unsigned v = at(i) << 16 | at(i + 1) << 8 | at(i + 2);
    out += kDigits[v >> 18 & 63];
    out += kDigits[v >> 12 & 63];
    out += i + 1 < bytes.size() ? kDigits[v >> 6 & 63] : '=';
    out += i + 2 < bytes.size() ? kDigits[v & 63] : '=';
  }
  return out;
}

}  // namespace tempera
