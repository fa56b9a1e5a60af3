// SPDX-License-Identifier: Apache-2.0
// Optical flow of irradiance on soft shadows whose motion is known.
#ifdef TEMPERA_PATH_SPACE_MOTION

#include "motion/flow.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "tempera/core/parallel.h"

namespace tempera::motion {
namespace {

using denoise::Planes;

constexpr int kWidth = 320, kHeight = 240;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

/// A soft shadow with five lobes.
struct Shadow {
  float x = 0, y = 0, radius = 40;  ///< at time 0, pixels
  float penumbra = 10;              ///< width, pixels
  float opacity = 0.7f;
  Vec2f motion;
  /// How much of the light is held back at a place at time t: 0 to 1.
  float cover(float px, float py, float t) const {
    const float dx = px - x - t * motion.x, dy = py - y - t * motion.y, d = std::sqrt(dx * dx + dy * dy);
    const float edge = radius * (1 + 0.25f * std::cos(5 * std::atan2(dy, dx)));
    const float s = std::clamp((edge - d) / penumbra + 0.5f, 0.0f, 1.0f);
    return s * s * (3 - 2 * s);
  }
};

/// Irradiance of a ramp of light with shadows; `noise`: relative, of independent channels.
Planes irradiance(const std::vector<Shadow>& shadows, float t, float noise, unsigned seed, int width = kWidth,
                  int height = kHeight) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  Planes out(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      float light = 0.5f + float(x) / float(width);
      for (const Shadow& s : shadows) light *= 1 - s.opacity * s.cover(float(x) + 0.5f, float(y) + 0.5f, t);
      const float sample = light * (1 + noise * normal(random));
      for (int c = 0; c < 3; ++c) out.row(c, y)[x] = sample;
    }
  }
  return out;
}

Grid<Place> unmoved(int width, int height) {
  Grid<Place> out(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) out.at(x, y) = {float(x) + 0.5f, float(y) + 0.5f, 1};
  }
  return out;
}

/// Mean distance of vectors from the motion of the shadow whose penumbra is at a pixel, over all such pixels.
double edge_error(const Grid<Vec2f>& vectors, const std::vector<Shadow>& shadows) {
  double sum = 0;
  int count = 0;
  for (int y = 0; y < vectors.height(); ++y) {
    for (int x = 0; x < vectors.width(); ++x) {
      for (const Shadow& s : shadows) {
        const float cover = s.cover(float(x) + 0.5f, float(y) + 0.5f, 0);
        if (cover < 0.05f || cover > 0.95f) continue;
        const Vec2f d = vectors.at(x, y) - s.motion;
        sum += std::hypot(double(d.x), double(d.y)), ++count;
      }
    }
  }
  return sum / count;
}

const std::vector<Shadow> kOne = {{150, 115, 50, 10, 0.7f, {7, 3}}};
const std::vector<Shadow> kThree = {
    {80, 70, 36, 5, 0.3f, {6, 2}}, {215, 75, 40, 14, 0.85f, {-5, 4}}, {140, 175, 34, 9, 0.6f, {3, -6}}};
const std::vector<Shadow> kBlack = {{150, 115, 40, 12, 1, {7, 3}}};
const std::vector<Shadow> kFast = {{140, 115, 50, 10, 0.7f, {14, 5.5f}}};

LightFlow flow_of(const std::vector<Shadow>& shadows, float noise, bool back = false) {
  const Planes a = irradiance(shadows, 0, noise, 1), b = irradiance(shadows, 1, noise, 2);
  return irradiance_flow(back ? b : a, back ? a : b, unmoved(kWidth, kHeight), {});
}

struct Bar {
  const char* name;
  const std::vector<Shadow>* shadows;
  float clean, some, much;  ///< largest mean error for relative noise of 0, 1 and 3 %, pixels
};
class FlowOfShadows : public testing::TestWithParam<Bar> {};

TEST_P(FlowOfShadows, IsTheirMotionInThePenumbra) {
  const Bar& bar = GetParam();
  const std::pair<float, float> cases[] = {{0.0f, bar.clean}, {0.01f, bar.some}, {0.03f, bar.much}};
  for (const auto& [noise, most] : cases) {
    const double error = edge_error(flow_of(*bar.shadows, noise).vectors, *bar.shadows);
    EXPECT_LT(error, double(most)) << "noise " << noise;
    RecordProperty("error_at_" + std::to_string(int(std::lround(100 * noise))), std::to_string(error));
  }
}
INSTANTIATE_TEST_SUITE_P(Bars, FlowOfShadows,
                         testing::Values(Bar{"One", &kOne, 0.1f, 0.15f, 0.2f}, Bar{"Three", &kThree, 0.1f, 0.15f, 0.2f},
                                         Bar{"Black", &kBlack, 0.15f, 0.2f, 0.2f},
                                         Bar{"Fast", &kFast, 0.15f, 0.2f, 0.3f}),
                         [](const auto& param) { return std::string(param.param.name); });

TEST(Flow, OfPicturesThatAreTheSameIsExactlyZero) {
  Planes light = irradiance(kThree, 0, 0.1f, 3, 150, 90);
  Grid<Place> places = unmoved(150, 90);
  for (int y = 30; y < 50; ++y) {
    for (int x = 40; x < 60; ++x) places.at(x, y) = Place();
  }
  light.row(1, 10)[20] = kNaN, light.row(0, 70)[99] = -1;
  const LightFlow flow = irradiance_flow(light, light, places, {});
  for (std::size_t i = 0; i < places.size(); ++i) {
    ASSERT_EQ(flow.vectors[i], Vec2f());
    ASSERT_EQ(flow.valid[i] != 0, places[i].valid());
  }
}

TEST(Flow, SurfacesThatTurn) {
  const Shadow shadow{150, 115, 30, 10, 0.7f, {14, 8}};
  constexpr float kAngle = 3 * kPi / 180;
  const auto turned = [&](float x, float y) {
    const float dx = x - kWidth / 2, dy = y - kHeight / 2;
    return Vec2f{kWidth / 2 + std::cos(kAngle) * dx - std::sin(kAngle) * dy,
                 kHeight / 2 + std::sin(kAngle) * dx + std::cos(kAngle) * dy};
  };
  Grid<Place> places(kWidth, kHeight);
  Planes first(kWidth, kHeight, 1), moved = first, everywhere(kWidth, kHeight, 1, 1.0f);
  const auto log_light = [&](Vec2f p, float t) {
    return std::log((0.5f + p.x / kWidth) * (1 - shadow.opacity * shadow.cover(p.x, p.y, t)));
  };
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Vec2f p{float(x) + 0.5f, float(y) + 0.5f}, q = turned(p.x, p.y);
      if (q.x >= 0 && q.y >= 0 && q.x < kWidth && q.y < kHeight) places.at(x, y) = {q.x, q.y, 1};
      first.row(0, y)[x] = log_light(p, 0), moved.row(0, y)[x] = log_light(q, 1);
    }
  }
  const LightFlow flow = irradiance_flow(irradiance({shadow}, 0, 0, 1), irradiance({shadow}, 1, 0, 2), places, {});
  Grid<Vec2f> plain = optical_flow(first, moved, everywhere);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Vec2f p{float(x) + 0.5f, float(y) + 0.5f};
      plain.at(x, y) += turned(p.x, p.y) - p;
    }
  }
  const double error = edge_error(flow.vectors, {shadow}), plain_error = edge_error(plain, {shadow});
  EXPECT_LT(error, 0.55);
  EXPECT_LT(error, 0.65 * plain_error);
  RecordProperty("error", std::to_string(error));
  RecordProperty("error_of_the_sum", std::to_string(plain_error));
}

TEST(Flow, OfAnObjectIsAddedToItsOwnMotion) {
  // A card moves over a wall by 20 pixels, and a shadow on the card by 5 more.
  constexpr int kW = 160, kH = 120;
  const Vec2f card{20, 0}, more{0, 5};
  const Shadow shadow{60, 60, 16, 8, 0.7f, card + more};
  const auto on_card = [&](float x, float y, float t) {
    return std::abs(x - 60 - t * card.x) < 36 && std::abs(y - 60 - t * card.y) < 36;
  };
  Planes pictures[2] = {Planes(kW, kH, 3), Planes(kW, kH, 3)};
  Grid<Place> places = unmoved(kW, kH);
  Grid<float> id(kW, kH);
  for (int y = 0; y < kH; ++y) {
    for (int x = 0; x < kW; ++x) {
      const float px = float(x) + 0.5f, py = float(y) + 0.5f;
      for (int t = 0; t < 2; ++t) {
        const float light = on_card(px, py, float(t)) ? 1 - shadow.opacity * shadow.cover(px, py, float(t)) : 3.0f;
        for (int c = 0; c < 3; ++c) pictures[t].row(c, y)[x] = light;
      }
      if (on_card(px, py, 0)) {
        id.at(x, y) = 1, places.at(x, y) = {px + card.x, py + card.y, 1};
      } else if (on_card(px, py, 1)) {
        places.at(x, y) = Place();
      }
    }
  }
  for (const bool with_id : {true, false}) {
    const LightFlow flow = irradiance_flow(pictures[0], pictures[1], places, with_id ? id : Grid<float>());
    EXPECT_LT(edge_error(flow.vectors, {shadow}), 0.3);
    // The wall stands still; what the card will cover is not there.
    for (int y = 0; y < kH; ++y) {
      for (int x = 0; x < kW; ++x) {
        const float px = float(x) + 0.5f, py = float(y) + 0.5f;
        ASSERT_EQ(flow.valid.at(x, y) != 0, places.at(x, y).valid()) << x << ' ' << y;
        if (std::abs(px - 60) < 70 && std::abs(py - 60) < 46) continue;
        ASSERT_LT(std::hypot(flow.vectors.at(x, y).x, flow.vectors.at(x, y).y), 0.5f) << x << ' ' << y;
      }
    }
  }
}

TEST(Flow, LightAtEdgesOfObjectsIsNoData) {
  // Two objects that move nearly alike; what changes is how much of each the pixels between them show.
  constexpr int kW = 60, kH = 40;
  Planes a(kW, kH, 3, 1.0f), b = a;
  Grid<Place> places = unmoved(kW, kH);
  Grid<float> id(kW, kH);
  const Vec2f motion{0, 0.4f};
  for (int y = 0; y < kH; ++y) {
    for (int x = 30; x < kW; ++x) {
      for (int c = 0; c < 3; ++c) a.row(c, y)[x] = x == 30 ? 2.4f : 3, b.row(c, y)[x] = x == 30 ? 1.6f : 3;
      id.at(x, y) = 1;
      if (y + 1 < kH) places.at(x, y).y += motion.y;
    }
  }
  const auto unlike_surfaces = [&](const LightFlow& flow) {
    int count = 0;
    for (int y = 0; y + 1 < kH; ++y) {
      for (int x = 0; x < kW; ++x) {
        const Vec2f d = flow.vectors.at(x, y) - (x < 30 ? Vec2f() : motion);
        count += std::hypot(d.x, d.y) > 1e-4f;
      }
    }
    return count;
  };
  EXPECT_EQ(unlike_surfaces(irradiance_flow(a, b, places, id)), 0);
  EXPECT_GT(unlike_surfaces(irradiance_flow(a, b, places, {})), 100);  // else this would show nothing
}

TEST(Flow, IsFilledInWhereDataDoNotCount) {
  constexpr int kW = 120, kH = 90;
  const Vec2f motion{3, -2};
  Planes a(kW, kH, 1), b = a, counts(kW, kH, 1, 1.0f);
  const auto texture = [](float x, float y) {
    return std::sin(0.2f * x) * std::cos(0.17f * y) + 0.2f * std::sin(0.5f * y);
  };
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(-2, 2);
  const auto hidden = [](int x, int y) { return std::abs(x - 60) <= 8 && std::abs(y - 45) <= 8; };
  for (int y = 0; y < kH; ++y) {
    for (int x = 0; x < kW; ++x) {
      a.row(0, y)[x] = hidden(x, y) ? uniform(random) : texture(float(x), float(y));
      b.row(0, y)[x] = texture(float(x) - motion.x, float(y) - motion.y);
      if (hidden(x, y)) counts.row(0, y)[x] = 0;
    }
  }
  const auto worst = [&](const Grid<Vec2f>& flow) {
    float most = 0;
    for (int y = 30; y <= 60; ++y) {
      for (int x = 45; x <= 75; ++x)
        most = std::max(most, std::hypot(flow.at(x, y).x - motion.x, flow.at(x, y).y - motion.y));
    }
    return most;
  };
  EXPECT_LT(worst(optical_flow(a, b, counts)), 0.2f);
  EXPECT_GT(worst(optical_flow(a, b, Planes(kW, kH, 1, 1.0f))), 1);  // else this would show nothing
  // Neither do values that nobody knows, of either picture.
  for (int y = 0; y < kH; ++y) {
    for (int x = 0; x < kW; ++x) {
      if (hidden(x, y)) a.row(0, y)[x] = kNaN;
      if (hidden(x + 20, y)) b.row(0, y)[x] = kNaN;
    }
  }
  EXPECT_LT(worst(optical_flow(a, b, Planes(kW, kH, 1, 1.0f))), 0.2f);
}

TEST(Flow, ThatIsNotUndoneIsNotConsistent) {
  LightFlow there = flow_of(kOne, 0.01f), back = flow_of(kOne, 0.01f, true);
  const auto part_of_penumbra = [&](const Grid<std::uint8_t>& good) {
    int count = 0, all = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const float cover = kOne[0].cover(float(x) + 0.5f, float(y) + 0.5f, 0);
        if (cover < 0.05f || cover > 0.95f) continue;
        count += good.at(x, y), ++all;
      }
    }
    return double(count) / all;
  };
  EXPECT_GT(part_of_penumbra(consistent(there, back)), 0.97);
  for (Vec2f& v : back.vectors) v.y += 0.7f;
  EXPECT_LT(part_of_penumbra(consistent(there, back)), 0.05);
  EXPECT_GT(part_of_penumbra(consistent(there, back, 1.0f)), 0.9);
  back.valid.fill(0);
  EXPECT_EQ(part_of_penumbra(consistent(there, back, 1.0f)), 0);
}

TEST(Flow, HasTheSameBitsForAnyNumberOfThreads) {
  const Planes a = irradiance(kThree, 0, 0.02f, 1, 200, 131), b = irradiance(kThree, 1, 0.02f, 2, 200, 131);
  LightFlow one, three;
  with_threads(1, [&] { one = irradiance_flow(a, b, unmoved(200, 131), {}); });
  with_threads(3, [&] { three = irradiance_flow(a, b, unmoved(200, 131), {}); });
  EXPECT_EQ(one.vectors, three.vectors);
  EXPECT_EQ(one.valid, three.valid);
  EXPECT_NE(one.vectors, Grid<Vec2f>(200, 131));
}

TEST(Flow, IsFiniteForAnyPicture) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-1, 4);
  const float odd[] = {0, kNaN, kInfinity, -kInfinity, 1e-38f, 1e14f, 3e38f, -3e38f, -5};
  const std::pair<int, int> sizes[] = {{0, 0}, {1, 1}, {1, 6}, {6, 1}, {2, 2}, {3, 5}, {16, 16}, {40, 3}, {33, 24}};
  for (const auto& [w, h] : sizes) {
    for (int kind = 0; kind < 4; ++kind) {  // none, some, half, all of the values are odd
      const auto value = [&] {
        const bool is_odd = int(random() % 10) < std::array{0, 1, 5, 10}[std::size_t(kind)];
        return is_odd ? odd[random() % std::size(odd)] : uniform(random);
      };
      Planes a(w, h, 3), b(w, h, 3), counts(w, h, 1);
      for (Planes* p : {&a, &b, &counts}) std::generate(p->values().begin(), p->values().end(), value);
      Grid<Place> places = unmoved(w, h);
      for (Place& p : places) {
        if (random() % 5 == 0) p = Place();
        if (random() % 5 == 0) p.x = uniform(random) / 3 * float(w);
        if (random() % 9 == 0) p.y = value();
      }
      const auto expect_finite = [&](const Grid<Vec2f>& flow) {
        ASSERT_EQ(flow.width(), w);
        ASSERT_EQ(flow.height(), h);
        for (const Vec2f& v : flow) ASSERT_TRUE(std::abs(v.x) < 100 && std::abs(v.y) < 100) << v.x << ' ' << v.y;
      };
      const LightFlow there = irradiance_flow(a, b, places, {}), back = irradiance_flow(b, a, places, {});
      expect_finite(there.vectors);
      EXPECT_EQ(consistent(there, back).size(), places.size());
      Planes first(w, h, 1), second(w, h, 1);
      for (Planes* p : {&first, &second}) std::generate(p->values().begin(), p->values().end(), value);
      expect_finite(optical_flow(first, second, counts));
    }
  }
}

}  // namespace
}  // namespace tempera::motion

#endif  // TEMPERA_PATH_SPACE_MOTION
