// SPDX-License-Identifier: Apache-2.0
#include "../src/rare_filter.h"

#include <gtest/gtest.h>

#include <numeric>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {
namespace {

constexpr int kSize = 24;

float noise(int t, int x, int y, int k) {
  return to_unit_float(std::uint32_t(hash_key(std::uint64_t(t), std::uint64_t(y * 1000 + x), std::uint64_t(k))));
}

struct Window {
  explicit Window(int frames) : solution(kSize, kSize, frames), frames_(std::size_t(frames)) {
    for (int t = 0; t < frames; ++t) {
      RareFrame& f = frames_[t];
      f.light = {Image(kSize, kSize, 3), Image(kSize, kSize, 3)};
      f.dark = false;
      if (t > 0) {
        f.previous.assign(kSize, kSize);
        std::iota(f.previous.begin(), f.previous.end(), 0);
      }
      for (int y = 0; y < kSize; ++y) {
        for (int c = 0; c < 3; ++c) std::fill_n(solution.row(t, y, c), kSize, 1.0f);
      }
    }
  }
  RareFrame& frame(int t) { return frames_[t]; }
  template <class F>
  void fill(F&& light) {
    for (int t = 0; t < solution.frames(); ++t) {
      for (std::size_t k = 0; k < 2; ++k) {
        for (int y = 0; y < kSize; ++y) {
          for (int x = 0; x < kSize; ++x) frame(t).light[k].set_rgb(x, y, Rgb(light(t, x, y, int(k))));
        }
      }
    }
  }
  Image smooth(int t) {
    std::vector<const RareFrame*> pointers;
    for (const RareFrame& f : frames_) pointers.push_back(&f);
    return RareFilter(pointers, solution).smooth(t);
  }
  PlanarFrames solution;
  std::vector<RareFrame> frames_;
};

double mean(const Image& image) {
  double sum = 0;
  for (const float v : image.values()) sum += double(v);
  return sum / double(image.values().size());
}

double mean_square(const Image& image, double around) {
  double sum = 0;
  for (const float v : image.values()) sum += (double(v) - around) * (double(v) - around);
  return sum / double(image.values().size());
}

TEST(RareFilter, KeepsEvenLight) {
  Window w(3);
  w.fill([](int, int, int, int) { return 0.3f; });
  for (int run = 0; run < 2; ++run) {  // without and with a guide
    for (const int t : {0, 1, 2}) {
      const Image out = w.smooth(t);
      for (const float v : out.values()) ASSERT_NEAR(v, 0.3f, 1e-5f) << t;
    }
    for (int t = 0; t < 3; ++t) w.frame(t).albedo = Image(kSize, kSize, 3, 0.5f);
  }
}

// Rare bright samples: far less noise, and no light lost.
TEST(RareFilter, SmoothsNoiseAndKeepsTheMean) {
  Window w(3);
  const auto rare = [](int t, int x, int y, int k) { return noise(t, x, y, k) < 0.1f ? 1.0f : 0.0f; };
  w.fill(rare);
  double raw = 0;
  for (int k = 0; k < 2; ++k) raw += 0.5 * mean(w.frame(1).light[k]);
  const Image out = w.smooth(1);
  EXPECT_NEAR(mean(out), raw, 0.1 * raw);
  EXPECT_LT(mean_square(out, 0.1), 0.1 * 0.5 * 0.09) << "variance of the mean of both: half that of one";
  // Frames before and after help.
  Window alone(1);
  alone.fill([&](int, int x, int y, int k) { return rare(1, x, y, k); });
  EXPECT_LT(mean_square(out, 0.1), 0.8 * mean_square(alone.smooth(0), 0.1));
}

// The window shrinks as samples grow.
TEST(RareFilter, ShrinksWithSamples) {
  Window w(1);
  w.fill([](int, int x, int, int) { return x == kSize / 2 ? 1.0f : 0.5f; });
  const float few = w.smooth(0).at(kSize / 2, 7);
  w.frame(0).samples = 16 * 64;
  const float many = w.smooth(0).at(kSize / 2, 7);
  EXPECT_LT(few, 0.9f);
  EXPECT_GT(many, few + 0.05f);
}

TEST(RareFilter, StaysWithinAnObject) {
  Window w(2);
  w.fill([](int, int x, int, int) { return x < kSize / 2 ? 1.0f : 0.0f; });
  for (const int t : {0, 1}) {
    w.frame(t).object = Image(kSize, kSize, 1, 1);
    for (int y = 0; y < kSize; ++y) {
      for (int x = kSize / 2; x < kSize; ++x) w.frame(t).object.at(x, y) = 2;
    }
  }
  const Image out = w.smooth(0);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) ASSERT_NEAR(out.at(x, y), x < kSize / 2 ? 1 : 0, 1e-5f) << x;
  }
}

// Light that glides by three pixels a frame, over matter that does.
TEST(RareFilter, FollowsMotion) {
  Window w(3);
  w.fill([](int t, int x, int, int) { return x >= 6 + 3 * t && x < 9 + 3 * t ? 1.0f : 0.0f; });
  for (int t = 0; t < 3; ++t) {
    w.frame(t).object = Image(kSize, kSize, 1, 1);
    for (int y = 0; y < kSize; ++y) {
      for (int x = 6 + 3 * t; x < 9 + 3 * t; ++x) w.frame(t).object.at(x, y) = 2;
      for (int x = 0; x < kSize && t > 0; ++x) w.frame(t).previous.at(x, y) = x >= 3 ? y * kSize + x - 3 : -1;
    }
  }
  const Image out = w.smooth(1);
  for (int x = 0; x < kSize; ++x) EXPECT_NEAR(out.at(x, 9), x >= 9 && x < 12 ? 1 : 0, 1e-5f) << x;
}

// A dot in one estimate alone does not choose its own weights: it spreads as if it were not there.
TEST(RareFilter, NoiseDoesNotChooseItsWeights) {
  Window w(1);
  w.fill([](int, int, int, int) { return 0.1f; });
  const float calm = w.smooth(0).at(12, 12);
  w.frame(0).light[0].set_rgb(12, 12, Rgb(10.0f));
  const Image out = w.smooth(0);
  EXPECT_NEAR(calm, 0.1f, 1e-5f);
  EXPECT_LT(out.at(12, 12), 0.3f * 5) << "of a mean of 5 between both";
  EXPECT_GT(out.at(14, 12), 0.11f);
}

TEST(RareFilter, ScalesWithTheLight) {
  Window w(2);
  w.fill([](int t, int x, int y, int k) { return noise(t, x, y, k) < 0.2f ? 2.0f : 0.0f; });
  const Image once = w.smooth(0);
  w.fill([](int t, int x, int y, int k) { return noise(t, x, y, k) < 0.2f ? 2048.0f : 0.0f; });
  for (int t = 0; t < 2; ++t) {
    for (int y = 0; y < kSize; ++y) {
      for (int c = 0; c < 3; ++c) std::fill_n(w.solution.row(t, y, c), kSize, 1024.0f);
    }
  }
  const Image scaled = w.smooth(0);
  for (std::size_t i = 0; i < once.values().size(); ++i)
    ASSERT_NEAR(scaled.values()[i], 1024 * once.values()[i], 1e-3f * scaled.values()[i]);
}

TEST(RareFilter, DarkFramesStayBlackAndThreadsDoNotShow) {
  Window w(3);
  w.fill([](int t, int x, int y, int k) { return x < 6 && noise(t, x, y, k) < 0.2f ? 2.0f : 0.0f; });
  Image one, three;
  with_threads(1, [&] { one = w.smooth(1); });
  with_threads(3, [&] { three = w.smooth(1); });
  EXPECT_TRUE(std::equal(one.values().begin(), one.values().end(), three.values().begin()));
  EXPECT_GT(one.at(3, 3), 0);
  float reached = 0;
  for (int y = 0; y < kSize; ++y) {
    reached += one.at(9, y);
    EXPECT_EQ(one.at(10, y), 0) << "out of reach";
  }
  EXPECT_GT(reached, 0);
  for (int t = 0; t < 3; ++t) w.frame(t).dark = true;
  EXPECT_EQ(mean(w.smooth(1)), 0);
}

}  // namespace
}  // namespace tempera
