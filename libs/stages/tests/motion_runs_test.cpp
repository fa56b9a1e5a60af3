// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/motion_runs.h"

#include <gtest/gtest.h>

#include <set>

#include "random_motion.h"

namespace tempera {
namespace {

TEST(PixelMap, LinksAreOneToOneAndInside) {
  PixelMap m(4, 3);
  EXPECT_TRUE(m.link(0, 0, 3, 2));
  EXPECT_FALSE(m.link(0, 0, 1, 1)) << "it has a partner";
  EXPECT_FALSE(m.link(1, 1, 3, 2)) << "its target has one";
  EXPECT_FALSE(m.link(-1, 0, 1, 1));
  EXPECT_FALSE(m.link(2, 2, 4, 0));
  EXPECT_EQ(m.count(), 1);
  EXPECT_EQ(m.forward(0, 0), (Vec2<int>{3, 2}));
  EXPECT_EQ(m.backward(3, 2), (Vec2<int>{0, 0}));
  EXPECT_EQ(m.forward(1, 1).x, -1);
  EXPECT_EQ(m.backward(0, 0).x, -1);
}

TEST(MotionRuns, HoldEveryPairAndEveryMixedDifferenceOnce) {
  for (const bool strict : {false, true}) {
    for (const bool voids : {false, true}) {
      const int w = 37, h = 23;
      const PixelMap m = test::random_motion(w, h, 5);
      const Grid<std::uint8_t> sampled = voids ? test::random_mask(w, h, 0.9, 6) : Grid<std::uint8_t>();
      const MotionRuns runs(m, {.mixed = true, .strict_mixed = strict}, sampled);
      const auto expected = [&](int x, int y, int ex, int ey) {
        const Vec2<int> to = m.forward(x, y);
        if (to.x < 0 || x + ex >= w || y + ey >= h || to.x + ex >= w || to.y + ey >= h) return false;
        if (voids && !sampled.at(to.x + ex, to.y + ey)) return false;
        const Vec2<int> neighbor = m.forward(x + ex, y + ey);
        return !strict || (neighbor.x == to.x + ex && neighbor.y == to.y + ey);
      };
      std::int64_t pixels = 0;
      for (int y = 0; y < h; ++y) {
        int last = -1;
        for (const MotionRun& r : runs.from_row(y)) {
          EXPECT_EQ(r.y, y);
          EXPECT_GT(r.x, last) << "from left to right, without overlap";
          last = r.x + r.length - 1;
          EXPECT_TRUE(r.mixed_x == r.length || r.mixed_x == r.length - 1 || r.mixed_x == 0);
          for (int i = 0; i < r.length; ++i, ++pixels) {
            EXPECT_EQ(m.forward(r.x + i, y), (Vec2<int>{r.x + i + r.dx, y + r.dy}));
            EXPECT_EQ(i < r.mixed_x, expected(r.x + i, y, 1, 0));
            EXPECT_EQ(r.mixed_y, expected(r.x + i, y, 0, 1));
          }
        }
      }
      EXPECT_EQ(pixels, m.count());
      EXPECT_EQ(runs.count(), m.count());
      // Both orders hold the same runs.
      std::set<std::pair<int, int>> from, to;
      for (int y = 0; y < h; ++y) {
        for (const MotionRun& r : runs.from_row(y)) from.insert({r.y, r.x});
        for (const MotionRun& r : runs.to_row(y)) {
          EXPECT_EQ(r.y + r.dy, y);
          to.insert({r.y, r.x});
        }
      }
      EXPECT_EQ(from, to);
    }
  }
}

TEST(MotionRuns, APanIsOneRunARow) {
  PixelMap m(700, 4);
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 700; ++x) m.link(x, y, x + 2, y + 1);
  }
  const MotionRuns runs(m);
  EXPECT_EQ(runs.size(), 6u) << "two a row, because of the largest length";
  EXPECT_EQ(runs.from_row(0)[0], (MotionRun{0, 0, 512, 2, 1, 512, true}));
  EXPECT_EQ(runs.from_row(0)[1], (MotionRun{0, 512, 186, 2, 1, 185, true}));
  EXPECT_EQ(runs.from_row(2)[1], (MotionRun{2, 512, 186, 2, 1, 185, false}));
  EXPECT_FALSE(runs.is_identity());
}

TEST(MotionRuns, KnowsWhenNothingMoves) {
  const auto still = [](const MotionRunOptions& options) {
    PixelMap m(5, 4);
    for (int y = 0; y < 4; ++y) {
      for (int x = 0; x < 5; ++x) m.link(x, y, x, y);
    }
    return MotionRuns(m, options);
  };
  EXPECT_TRUE(still({}).is_identity());
  EXPECT_TRUE(still({}).has_all_mixed());
  EXPECT_TRUE(still({.strict_mixed = true}).has_all_mixed());
  EXPECT_TRUE(still({.mixed = false}).is_identity());
  EXPECT_FALSE(still({.mixed = false}).has_all_mixed());
  PixelMap holes(5, 4);
  holes.link(1, 1, 1, 1);
  EXPECT_FALSE(MotionRuns(holes).is_identity());
}

}  // namespace
}  // namespace tempera
