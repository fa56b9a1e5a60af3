// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/sample_stream.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <set>
#include <vector>

#include "statistics.h"
#include "support/effort.h"

namespace tempera {
namespace {

using test::CountsFit;
using test::MeanIs;
using test::Uncorrelated;

constexpr SamplerKind kKinds[] = {SamplerKind::kSobol, SamplerKind::kIndependent};

SampleStream stream(SamplerKind kind, int pixel, std::uint32_t sample, std::uint64_t seed = 7, std::int64_t frame = 3) {
  return {kind, seed, frame, pixel % 64, pixel / 64, sample};
}

TEST(SampleStream, TestToolsRejectPlantedFaults) {
  std::vector<double> expected(64, 1000.0), counts(64), x, y;
  for (int i = 0; i < 64000; ++i) {
    const double u = stream(SamplerKind::kIndependent, i, 0).get1(0);
    ++counts[std::size_t(64 * std::pow(u, 1.05))];
    x.push_back(u);
    y.push_back(stream(SamplerKind::kIndependent, i, 0).get1(1) + 0.03 * u);
  }
  EXPECT_FALSE(CountsFit(expected, counts));
  EXPECT_FALSE(CountsFit(expected, expected));
  EXPECT_FALSE(Uncorrelated(x, y));
  EXPECT_FALSE(MeanIs(0.506, x));
}

TEST(SampleStream, EveryElementaryIntervalOfANetHoldsOnePoint) {
  for (const int pixel : {0, 1, 65, 4000}) {
    for (const std::uint32_t pair : {0u, 1u, 2u, 17u, 1000u}) {
      for (int log_count = 0; log_count <= 12; ++log_count) {
        const std::uint32_t n = 1u << log_count;
        for (const std::uint32_t first : {0u, n, 5 * n}) {  // any aligned block of the even or the odd ones is a net
          for (int log_x = 0; log_x <= log_count; ++log_x) {
            std::vector<int> count(n);
            const float nx = float(1u << log_x), ny = float(n >> log_x);
            for (std::uint32_t i = 0; i < n; ++i) {
              const Vec2f u = stream(SamplerKind::kSobol, pixel, 2 * (first + i) + pair % 2).get2(2 * pair);
              ++count[std::size_t(u.x * nx) * std::size_t(ny) + std::size_t(u.y * ny)];
            }
            const std::vector<int> once(n, 1);
            ASSERT_EQ(count, once) << "pixel " << pixel << " pair " << pair << ", " << n << " points from " << first
                                   << " in " << nx << " x " << ny;
          }
        }
      }
    }
  }
}

TEST(SampleStream, SecondDimensionIsThatOfTheGeneratorMatrix) {
  for (const std::uint32_t index : {0u, 1u, 2u, 3u, 5u, 100u, 65535u, 65536u, 0x9abcdef1u, 0xffffffffu}) {
    std::uint32_t expected = 0, column = 1u << 31;  // the definition: columns v[k+1] = v[k] ^ v[k] >> 1
    for (std::uint32_t bits = index; bits; bits >>= 1, column ^= column >> 1) expected ^= bits & 1 ? column : 0;
    EXPECT_EQ(detail::reverse_bits(detail::sobol2_reversed(index)), expected) << index;
  }
  EXPECT_EQ(detail::reverse_bits(0x80000001u), 0x80000001u);
  EXPECT_EQ(detail::reverse_bits(0x00000002u), 0x40000000u);
}

TEST(SampleStream, ScrambleIsNested) {
  // Flipping digit k leaves the digits before it, flips it, and changes those after it at random.
  std::vector<double> flips_after;
  for (std::uint32_t trial = 0; trial < 2000; ++trial) {
    const std::uint32_t x = std::uint32_t(mix64(trial)), seed = std::uint32_t(mix64(trial + 1000000)), k = trial % 32;
    const std::uint32_t difference =
        detail::scramble_reversed(x, seed) ^ detail::scramble_reversed(x ^ (1u << k), seed);
    ASSERT_EQ(difference & ((std::uint64_t(2) << k) - 1), 1u << k);
    if (k < 31) flips_after.push_back(double(std::popcount(difference) - 1) / (31 - k));
  }
  EXPECT_TRUE(MeanIs(0.5, flips_after));
}

TEST(SampleStream, IsUniformOverPixels) {
  for (const SamplerKind kind : kKinds) {
    for (const std::uint32_t sample : {0u, 1u, 77u}) {
      for (const std::uint32_t pair : {0u, 3u, 60u}) {
        std::vector<double> counts(32 * 32), expected(32 * 32, 64.0 * test::effort());
        for (int pixel = 0; pixel < 32 * 32 * 64 * test::effort(); ++pixel) {
          const Vec2f u = stream(kind, pixel, sample).get2(2 * pair);
          ASSERT_TRUE(u.x >= 0 && u.x < 1 && u.y >= 0 && u.y < 1);
          ++counts[std::size_t(u.x * 32) * 32 + std::size_t(u.y * 32)];
        }
        EXPECT_TRUE(CountsFit(expected, counts)) << int(kind) << " sample " << sample << " pair " << pair;
      }
    }
  }
}

TEST(SampleStream, LowDigitsAreUniformToo) {
  for (const SamplerKind kind : kKinds) {
    for (std::uint32_t c = 0; c < 2; ++c) {
      std::vector<double> counts(256), expected(256, 256.0 * test::effort());
      for (int pixel = 0; pixel < 256 * test::effort(); ++pixel) {
        for (std::uint32_t sample = 0; sample < 256; ++sample) {
          const float u = stream(kind, pixel, sample).get1(c) * 65536.0f;
          ++counts[std::size_t((u - std::floor(u)) * 256)];
        }
      }
      EXPECT_TRUE(CountsFit(expected, counts)) << int(kind) << " coordinate " << c;
    }
  }
}

TEST(SampleStream, DifferentAddressesAreUncorrelated) {
  // Two numbers each from many pixels that differ in one part of the address.
  using Pick = std::function<float(int pixel)>;
  for (const SamplerKind kind : kKinds) {
    const Pick base = [=](int p) { return stream(kind, 2 * p, 5).get1(8); };
    const std::vector<std::pair<const char*, Pick>> others{
        {"the next coordinate", [=](int p) { return stream(kind, 2 * p, 5).get1(9); }},
        {"the next pair", [=](int p) { return stream(kind, 2 * p, 5).get1(10); }},
        {"the same coordinate of the next vertex", [=](int p) { return stream(kind, 2 * p, 5).get1(16); }},
        {"the neighbour", [=](int p) { return stream(kind, 2 * p + 1, 5).get1(8); }},
        {"the pixel below", [=](int p) { return stream(kind, 2 * p + 64, 5).get1(8); }},
        {"the next seed", [=](int p) { return stream(kind, 2 * p, 5, 8).get1(8); }},
        {"the next frame", [=](int p) { return stream(kind, 2 * p, 5, 7, 4).get1(8); }},
        {"a frame before the first", [=](int p) { return stream(kind, 2 * p, 5, 7, -3).get1(8); }},
        {"another pair of a later sample", [=](int p) { return stream(kind, 2 * p, 6).get1(10); }}};
    for (const auto& [name, other] : others) {
      std::vector<double> x, y, joint(8 * 8), expected(8 * 8, 50000.0 / 64 * test::effort());
      for (int p = 0; p < 50000 * test::effort(); ++p) {
        x.push_back(base(p)), y.push_back(other(p));
        ++joint[std::size_t(x.back() * 8) * 8 + std::size_t(y.back() * 8)];
      }
      EXPECT_TRUE(Uncorrelated(x, y)) << int(kind) << " and " << name;
      EXPECT_TRUE(CountsFit(expected, joint)) << int(kind) << " and " << name;
    }
  }
  // Samples of one pixel repel each other in a net; independent ones do not.
  std::vector<double> x, y;
  for (int p = 0; p < 50000; ++p) {
    x.push_back(stream(SamplerKind::kIndependent, p, 4).get1(8));
    y.push_back(stream(SamplerKind::kIndependent, p, 5).get1(8));
  }
  EXPECT_TRUE(Uncorrelated(x, y));
}

TEST(SampleStream, PairsOfOnePixelAreIndependentOverItsSamples) {
  // Coordinates from two pairs: over the samples of one pixel, their joint first digits must not follow each other,
  // which they would if all pairs visited their sequences in the same order.
  std::vector<double> correlation, same_quadrant;
  for (int pixel = 0; pixel < 4000 * test::effort(); ++pixel) {
    double sum = 0, same = 0;
    for (std::uint32_t i = 0; i < 16; ++i) {
      const SampleStream s = stream(SamplerKind::kSobol, pixel, i);
      sum += (s.get1(8) - 0.5) * (s.get1(10) - 0.5) / 16;
      same += ((s.get1(8) < 0.5f) == (s.get1(11) < 0.5f)) / 16.0;
    }
    correlation.push_back(sum);
    same_quadrant.push_back(same);
  }
  EXPECT_TRUE(MeanIs(0, correlation));
  EXPECT_TRUE(MeanIs(0.5, same_quadrant));
  // Independent shuffles put 4 + 4 of 16 into each combination on average with a spread; equal ones always 0, 8 or 16.
  const std::set<double> values(same_quadrant.begin(), same_quadrant.end());
  EXPECT_GE(values.size(), 5u);
}

// Means of the even and of the odd samples of a pixel know nothing of each other.
TEST(SampleStream, HalvesOfAPixelAreIndependent) {
  for (const std::uint32_t count : {1u, 2u, 8u}) {
    for (const std::uint32_t pair : {0u, 5u}) {
      std::vector<double> even, odd;
      for (int pixel = 0; pixel < 20000 * test::effort(); ++pixel) {
        double sums[2] = {};
        for (std::uint32_t i = 0; i < 2 * count; ++i) {
          const Vec2f u = stream(SamplerKind::kSobol, pixel, i).get2(2 * pair);
          sums[i & 1] += sqr(double(u.x)) + double(u.x * u.y);
        }
        even.push_back(sums[0]), odd.push_back(sums[1]);
      }
      EXPECT_TRUE(Uncorrelated(even, odd)) << count << " samples of pair " << pair;
    }
  }
}

TEST(SampleStream, AccessorsAgree) {
  for (const SamplerKind kind : kKinds) {
    for (std::uint32_t i = 0; i < 200; ++i) {
      const SampleStream s = stream(kind, int(i) * 13, i * i), replay = s;
      for (std::uint32_t pair = 0; pair < 40; ++pair) {
        const Vec2f u = s.get2(2 * pair);
        EXPECT_EQ(u.x, s.get1(2 * pair));
        EXPECT_EQ(u.y, replay.get1(2 * pair + 1));
        EXPECT_EQ(u, stream(kind, int(i) * 13, i * i).get2(2 * pair));
      }
      for (std::uint32_t b = 0; b < 9; ++b) {
        const VertexNumbers v = s.vertex(b);
        EXPECT_EQ(v.direction, s.get2(coordinate(b, VertexDim::kDirection)));
        EXPECT_EQ(v.light_point, s.get2(coordinate(b, VertexDim::kLightPoint)));
        EXPECT_EQ(v.lobe, s.get1(coordinate(b, VertexDim::kLobe)));
        EXPECT_EQ(v.light_choice, s.get1(coordinate(b, VertexDim::kLightChoice)));
        EXPECT_EQ(v.roulette, s.get1(coordinate(b, VertexDim::kRoulette)));
        EXPECT_EQ(v.opacity, s.get1(coordinate(b, VertexDim::kOpacity)));
      }
    }
  }
}

// Numbers of a light subpath are its own: no coordinate is shared with the camera's, and they are as well distributed,
// each and against the camera's.
TEST(SampleStream, LightSubpathsHaveTheirOwnNumbers) {
  std::set<std::uint32_t> coordinates;
  std::size_t count = 0;
  const auto take = [&](std::uint32_t c) { coordinates.insert(c), ++count; };
  for (const auto d : {CameraDim::kPixel, CameraDim::kLens, CameraDim::kTime, CameraDim::kSpare}) take(coordinate(d));
  for (const auto d : {LightDim::kPosition, LightDim::kDirection, LightDim::kChoice, LightDim::kTime})
    take(coordinate(d));
  for (std::uint32_t b = 0; b < 5000; ++b) {
    for (const Subpath s : {Subpath::kCamera, Subpath::kLight}) {
      for (const auto d : {VertexDim::kDirection, VertexDim::kLightPoint, VertexDim::kLobe, VertexDim::kLightChoice,
                           VertexDim::kRoulette, VertexDim::kOpacity}) {
        take(coordinate(b, d, s));
      }
    }
  }
  EXPECT_EQ(coordinates.size(), count);

  for (const SamplerKind kind : kKinds) {
    const SampleStream s = stream(kind, 17, 6);
    const LightNumbers u = s.light();
    EXPECT_EQ(u.choice, s.get1(coordinate(LightDim::kChoice)));
    EXPECT_EQ(u.position, s.get2(coordinate(LightDim::kPosition)));
    EXPECT_EQ(u.direction, s.get2(coordinate(LightDim::kDirection)));
    EXPECT_EQ(u.time, s.get1(coordinate(LightDim::kTime)));
    const VertexNumbers v = s.vertex(3, Subpath::kLight);
    EXPECT_EQ(v.direction, s.get2(coordinate(3, VertexDim::kDirection, Subpath::kLight)));
    EXPECT_EQ(v.opacity, s.get1(coordinate(3, VertexDim::kOpacity, Subpath::kLight)));

    const auto uncorrelated = [&](const char* what,
                                  const std::function<std::pair<float, float>(const SampleStream&)>& pick) {
      std::vector<double> x, y, joint(8 * 8), expected(8 * 8, 20000.0 / 64);
      for (int p = 0; p < 20000; ++p) {
        const auto [a, b] = pick(stream(kind, p, 5));
        x.push_back(double(a)), y.push_back(double(b));
        ++joint[std::size_t(a * 8) * 8 + std::size_t(b * 8)];
      }
      EXPECT_TRUE(Uncorrelated(x, y)) << int(kind) << " " << what;
      EXPECT_TRUE(CountsFit(expected, joint)) << int(kind) << " " << what;
    };
    using S = const SampleStream&;
    uncorrelated("choice and time", [](S n) { return std::pair{n.light().choice, n.light().time}; });
    uncorrelated("position and direction", [](S n) { return std::pair{n.light().position.x, n.light().direction.x}; });
    uncorrelated("both ends", [](S n) { return std::pair{n.light().position.x, n.camera().pixel.x}; });
    uncorrelated("first vertices", [](S n) {
      return std::pair{n.vertex(0).direction.x, n.vertex(0, Subpath::kLight).direction.x};
    });
  }
  // Light paths that count on at one address are a net.
  std::vector<int> cells(256), once(256, 1);
  for (std::uint32_t i = 0; i < 256; ++i) {
    const Vec2f u = stream(SamplerKind::kSobol, 0, 2 * i).light().direction;
    ++cells[std::size_t(u.x * 16) * 16 + std::size_t(u.y * 16)];
  }
  EXPECT_EQ(cells, once);
}

// Stored pictures rely on the numbers that purposes had before they had names.
TEST(SampleStream, PurposesKeepFramesApart) {
  EXPECT_EQ(stream_number(StreamPurpose::kPicture, -7), -7);
  EXPECT_EQ(stream_number(StreamPurpose::kFill, 3), (std::int64_t(1) << 40) + 3);
  EXPECT_EQ(stream_number(StreamPurpose::kPilot, 3), (std::int64_t(1) << 41) + 3);
  std::set<std::int64_t> numbers;
  constexpr std::int64_t kLast = std::numeric_limits<int>::max();
  for (const auto p : {StreamPurpose::kPicture, StreamPurpose::kFill, StreamPurpose::kPilot, StreamPurpose::kLight}) {
    for (const std::int64_t frame : {-kLast, std::int64_t(0), std::int64_t(1), kLast}) {
      numbers.insert(stream_number(p, frame));
    }
  }
  EXPECT_EQ(numbers.size(), 16u);
}

TEST(SampleStream, SobolIntegratesSmoothFunctionsTenTimesBetter) {
  const auto f = [](const Vec2f& u) { return std::exp(-double(u.x) * u.y) + std::sin(3.0 * u.x + u.y); };
  double exact = 0;
  const int grid = 1000;
  for (int i = 0; i < grid * grid; ++i) {
    exact += f({(float(i % grid) + 0.5f) / grid, (float(i / grid) + 0.5f) / grid}) / (double(grid) * grid);
  }
  const auto rmse = [&](SamplerKind kind, std::uint32_t count) {
    double sum = 0;
    const int trials = 400;
    for (int p = 0; p < trials; ++p) {
      double mean = 0;
      for (std::uint32_t i = 0; i < count; ++i) mean += f(stream(kind, p, i).get2(4)) / count;
      sum += (mean - exact) * (mean - exact) / trials;
    }
    return std::sqrt(sum);
  };
  const double independent = rmse(SamplerKind::kIndependent, 256), sobol = rmse(SamplerKind::kSobol, 256);
  RecordProperty("rmse_independent_256", std::to_string(independent));
  RecordProperty("rmse_sobol_256", std::to_string(sobol));
  EXPECT_GT(independent, 10 * sobol) << sobol;
  // Counts that are not powers of two do not fall behind either.
  EXPECT_GT(rmse(SamplerKind::kIndependent, 200), 3 * rmse(SamplerKind::kSobol, 200));
  // Owen scrambling converges like n^-3/2 where independent samples give n^-1/2.
  EXPECT_LT(rmse(SamplerKind::kSobol, 1024), sobol / 6);
  EXPECT_NEAR(std::log2(rmse(SamplerKind::kIndependent, 64) / independent), 1, 0.2);
}

}  // namespace
}  // namespace tempera
