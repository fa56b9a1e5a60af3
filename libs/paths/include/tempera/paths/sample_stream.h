// SPDX-License-Identifier: Apache-2.0
#pragma once
// Primary sample space with addressed coordinates: every random number of a path is a function of its key (seed,
// stream, pixel, sample) and of its coordinate (subpath, vertex, purpose). Nothing is drawn in sequence, so offset
// paths, replays, resumed units and any number of threads see the same numbers.
#include <cstdint>

#include "tempera/core/random.h"
#include "tempera/core/vec.h"

namespace tempera {

enum class SamplerKind : std::uint8_t { kSobol, kIndependent };

/// Coordinates of the camera vertex.
enum class CameraDim : std::uint32_t { kPixel = 0, kLens = 2, kTime = 4, kSpare = 5 };
/// Coordinates of a scattering vertex; numbers that are used as a pair start at an even coordinate.
enum class VertexDim : std::uint32_t {
  kDirection = 0,
  kLightPoint = 2,
  kLobe = 4,
  kLightChoice = 5,
  kRoulette = 6,
  kOpacity = 7
};

/// Coordinates of the end of a light subpath.
enum class LightDim : std::uint32_t { kPosition = 0, kDirection = 2, kChoice = 4, kTime = 5 };

/// The end that a part of a path is traced from. Both have coordinates of their own, under one key.
enum class Subpath : std::uint32_t { kCamera, kLight };

/// What the numbers of a stream are for: keeps those of one frame apart. The sums of two frames and purposes differ.
enum class StreamPurpose : std::int64_t {
  kPicture = 0,
  kFill = std::int64_t(1) << 40,   ///< pixels that show what the frame before did not
  kPilot = std::int64_t(1) << 41,  ///< first batches that are not part of the picture
  kLight = std::int64_t(1) << 42   ///< paths that start at lights, belong to no pixel
};
/// The `stream` of a SampleStream.
constexpr std::int64_t stream_number(StreamPurpose purpose, std::int64_t frame) {
  return std::int64_t(purpose) + frame;
}

inline constexpr std::uint32_t kDimsPerVertex = 8;
/// Where the coordinates of a subpath begin, in vertices.
constexpr std::uint32_t first_block(Subpath s) { return std::uint32_t(s) << 28; }
constexpr std::uint32_t coordinate(CameraDim d) { return std::uint32_t(d); }
constexpr std::uint32_t coordinate(LightDim d) {
  return kDimsPerVertex * first_block(Subpath::kLight) + std::uint32_t(d);
}
/// Vertex b = 0 is the first surface after the camera or the light. Pre: b < 2^28 - 1.
constexpr std::uint32_t coordinate(std::uint32_t vertex, VertexDim d, Subpath s = Subpath::kCamera) {
  return kDimsPerVertex * (first_block(s) + vertex + 1) + std::uint32_t(d);
}

namespace detail {
// The steps of the Sobol sampler for one 32-bit word or several at once (vector extensions of gcc and clang, compiled
// to whatever the target has), so that each exists once.
using Words4 = std::uint32_t __attribute__((vector_size(16)));
using Words8 = std::uint32_t __attribute__((vector_size(32)));

template <class W>
constexpr W reverse_bits(W x) {
  x = (x >> 16) | (x << 16);
  x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
}
/// Owen's nested uniform scramble of a number whose digits are given in reverse, as a hash in which no bit depends on
/// those above it [Laine 2011; Burley 2020]; constants of [Vegdahl 2021].
template <class W>
constexpr W scramble_reversed(W x, W seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  return x ^ (x * 0x53a22864u);
}
/// Second dimension of Sobol's sequence at `index`, with its digits reversed. Its generator matrix is Pascal's triangle
/// modulo 2; by Lucas' theorem the product is a sum over supersets of bit positions: five steps instead of 32.
template <class W>
constexpr W sobol2_reversed(W index) {
  index ^= (index >> 16) & 0x0000ffffu;
  index ^= (index >> 8) & 0x00ff00ffu;
  index ^= (index >> 4) & 0x0f0f0f0fu;
  index ^= (index >> 2) & 0x33333333u;
  return index ^ ((index >> 1) & 0x55555555u);
}
}  // namespace detail

/// All random numbers of the camera vertex.
struct CameraNumbers {
  Vec2f pixel, lens;
  float time = 0;
};

/// All random numbers of the end of a light subpath: what LightSampler::emit takes.
struct LightNumbers {
  float choice = 0;
  Vec2f position, direction;
  float time = 0;
};

/// All random numbers of one scattering vertex.
struct VertexNumbers {
  Vec2f direction, light_point;
  float lobe = 0, light_choice = 0, roulette = 0, opacity = 0;
};

/// The random numbers of one sample of one pixel, each in [0,1). A small value; copying it replays it.
///
/// kSobol: coordinates 2k and 2k + 1 form a (0,2)-sequence over the even samples of a pixel, and an independent one
/// over the odd ones, so that half the difference of the means of both tells the variance of the mean of all. Each is
/// Owen-scrambled and visited in an order that is shuffled (again by nested scrambling, so that every aligned power of
/// two of its samples is a net) for each key and pair: pairs are independent of each other [Burley 2020]. Any number of
/// samples serves; powers of two best. kIndependent: hashes.
class SampleStream {
 public:
  /// `stream` separates independent pictures: a stream_number of the frame (or of another one, to replay it). Samples
  /// of paths that belong to no pixel count on at one (x, y): they are well distributed together.
  SampleStream(SamplerKind kind, std::uint64_t seed, std::int64_t stream, int x, int y, std::uint32_t sample)
      : key_(hash_key(seed, std::uint64_t(stream), (std::uint64_t(std::uint32_t(y)) << 32) | std::uint32_t(x))),
        reversed_sample_(detail::reverse_bits(sample / 2)),
        kind_(kind) {
    key_ = hash_key(key_, kind == SamplerKind::kIndependent ? sample : sample % 2);
  }

  /// Coordinate c alone: get1(2k) == get2(2k).x and get1(2k + 1) == get2(2k).y.
  float get1(std::uint32_t c) const {
    const std::uint64_t h = pair_hash(c / 2);
    if (kind_ == SamplerKind::kIndependent) return to_unit_float(std::uint32_t(c & 1 ? h >> 32 : h));
    const std::uint32_t i = detail::reverse_bits(detail::scramble_reversed(reversed_sample_, order_seed(h)));
    const std::uint32_t digits = c & 1 ? detail::scramble_reversed(detail::sobol2_reversed(i), std::uint32_t(h >> 32))
                                       : detail::scramble_reversed(i, std::uint32_t(h));
    return to_unit_float(detail::reverse_bits(digits));
  }
  /// Two coordinates, c and c + 1, jointly well distributed over the samples of a pixel. Pre: c is even.
  Vec2f get2(std::uint32_t c) const {
    const std::uint64_t h = pair_hash(c / 2);
    const std::uint32_t low = std::uint32_t(h), high = std::uint32_t(h >> 32);
    if (kind_ == SamplerKind::kIndependent) return {to_unit_float(low), to_unit_float(high)};
    const std::uint32_t i = detail::reverse_bits(detail::scramble_reversed(reversed_sample_, order_seed(h)));
    // The first dimension is the index with its digits reversed, so its reversed digits are the index.
    const detail::Words4 digits{i, detail::sobol2_reversed(i)};
    const detail::Words4 bits = detail::reverse_bits(detail::scramble_reversed(digits, detail::Words4{low, high}));
    return {to_unit_float(bits[0]), to_unit_float(bits[1])};
  }
  /// The numbers of the camera, of the light, and of vertex b of a subpath: equal to get1 and get2 of their
  /// coordinates, for little more than the
  /// price of one pair.
  CameraNumbers camera() const {
    const Block u = block(0);
    using D = CameraDim;
    return {{u(D::kPixel), u(D::kPixel, 1)}, {u(D::kLens), u(D::kLens, 1)}, u(D::kTime)};
  }
  LightNumbers light() const {
    const Block u = block(first_block(Subpath::kLight));
    using D = LightDim;
    return {u(D::kChoice), {u(D::kPosition), u(D::kPosition, 1)}, {u(D::kDirection), u(D::kDirection, 1)}, u(D::kTime)};
  }
  TEMPERA_INLINE VertexNumbers vertex(std::uint32_t b, Subpath s = Subpath::kCamera) const {
    const Block u = block(first_block(s) + b + 1);
    using D = VertexDim;
    return {{u(D::kDirection), u(D::kDirection, 1)},
            {u(D::kLightPoint), u(D::kLightPoint, 1)},
            u(D::kLobe),
            u(D::kLightChoice),
            u(D::kRoulette),
            u(D::kOpacity)};
  }
  /// Bits that differ from sample to sample, for decisions that no coordinate is meant for.
  std::uint32_t hash() const { return std::uint32_t(hash_key(key_, reversed_sample_)); }

 private:
  /// Coordinates 8 i to 8 i + 7. Lanes 0 to 3: first dimensions of the four pairs; 4 to 7: second.
  struct Block {
    detail::Words8 bits;
    template <class Dim>
    float operator()(Dim d, std::uint32_t offset = 0) const {
      const std::uint32_t k = std::uint32_t(d) + offset;
      return to_unit_float(bits[k / 2 + (k & 1) * 4]);
    }
  };
  TEMPERA_INLINE Block block(std::uint32_t i) const {
    static_assert(kDimsPerVertex == 8);
    const std::uint32_t pair = kDimsPerVertex / 2 * i;
    const std::uint64_t h0 = pair_hash(pair), h1 = pair_hash(pair + 1), h2 = pair_hash(pair + 2),
                        h3 = pair_hash(pair + 3);
    const detail::Words8 bits{std::uint32_t(h0),       std::uint32_t(h1),       std::uint32_t(h2),
                              std::uint32_t(h3),       std::uint32_t(h0 >> 32), std::uint32_t(h1 >> 32),
                              std::uint32_t(h2 >> 32), std::uint32_t(h3 >> 32)};
    if (kind_ == SamplerKind::kIndependent) return {bits};
    const detail::Words4 seeds{order_seed(h0), order_seed(h1), order_seed(h2), order_seed(h3)};
    const detail::Words4 sample = detail::Words4{} + reversed_sample_;
    const detail::Words4 index = detail::reverse_bits(detail::scramble_reversed(sample, seeds));
    const detail::Words4 j = detail::sobol2_reversed(index);
    const detail::Words8 digits{index[0], index[1], index[2], index[3], j[0], j[1], j[2], j[3]};
    return {detail::reverse_bits(detail::scramble_reversed(digits, bits))};
  }
  std::uint64_t pair_hash(std::uint32_t pair) const { return mix64(key_ + (pair + 1) * 0x9e3779b97f4a7c15ull); }
  /// A third seed beside the two halves of a pair's hash.
  static std::uint32_t order_seed(std::uint64_t h) { return std::uint32_t((h * 0xd6e8feb86659fd93ull) >> 32); }

  std::uint64_t key_;
  std::uint32_t reversed_sample_;
  SamplerKind kind_;
};

}  // namespace tempera
