// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/grid.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <stdexcept>

namespace tempera {
namespace {

TEST(Grid, HoldsRowsOneAfterTheOther) {
  Grid<int> g(3, 2);
  EXPECT_EQ(g.width(), 3);
  EXPECT_EQ(g.height(), 2);
  EXPECT_EQ(g.size(), 6u);
  EXPECT_TRUE(std::all_of(g.begin(), g.end(), [](int v) { return v == 0; }));
  std::iota(g.begin(), g.end(), 0);
  for (int y = 0; y < 2; ++y) {
    EXPECT_EQ(g.row(y).size(), 3u);
    for (int x = 0; x < 3; ++x) {
      EXPECT_EQ(g.at(x, y), 3 * y + x);
      EXPECT_EQ(g[g.index(x, y)], 3 * y + x);
      EXPECT_EQ(g.row(y)[x], 3 * y + x);
      EXPECT_EQ(g.data()[3 * y + x], 3 * y + x);
    }
  }
}

TEST(Grid, IsAValue) {
  Grid<float> a(4, 3, 2.5f);
  const Grid<float> b = a;
  EXPECT_EQ(a, b);
  a.at(3, 2) = 1;
  EXPECT_NE(a, b);
  EXPECT_EQ(b.at(3, 2), 2.5f);
  a.fill(2.5f);
  EXPECT_EQ(a, b);
  EXPECT_NE(a, Grid<float>(3, 4, 2.5f)) << "the same values in another shape";
  a.assign(2, 1, 7);
  EXPECT_EQ(a, Grid<float>(2, 1, 7));
  a.resize(5, 2);
  EXPECT_EQ(a.size(), 10u);
  EXPECT_EQ(a.row(1).size(), 5u);
}

TEST(Grid, MayHaveNoValues) {
  EXPECT_TRUE(Grid<int>().empty());
  const Grid<int> no_columns(0, 5), no_rows(5, 0);
  EXPECT_TRUE(no_columns.empty());
  EXPECT_TRUE(no_columns.row(4).empty());
  EXPECT_EQ(no_rows.begin(), no_rows.end());
  EXPECT_NE(no_columns, no_rows);
}

TEST(Grid, CountsItsValuesBeyondTheRangeOfInt) {
  struct Tile {
    double values[2];
  };
  // 2^60 tiles are more than a vector may hold; a product of ints would be 0.
  EXPECT_THROW(Grid<Tile>(1 << 30, 1 << 30), std::length_error);
}

}  // namespace
}  // namespace tempera
