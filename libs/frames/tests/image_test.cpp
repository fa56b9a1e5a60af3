// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/image.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

TEST(Image, StoresRowsOfInterleavedPixels) {
  Image image(3, 2, 4);
  image.at(2, 1, 3) = 7;
  EXPECT_EQ(image.values()[(1 * 3 + 2) * 4 + 3], 7);
  EXPECT_EQ(image.row(1)[2 * 4 + 3], 7);
  EXPECT_EQ(image.pixels(), 6);
  image.set_rgb(0, 1, {1, 2, 3});
  EXPECT_EQ(image.rgb(0, 1), (Rgb{1, 2, 3}));
  EXPECT_EQ(image.vec3(0, 1), (Vec3f{1, 2, 3}));
  EXPECT_EQ(image.vec2(0, 1), (Vec2f{1, 2}));
}

TEST(Image, OneChannelReadsAsGray) {
  Image image(1, 1, 1, 0.25f);
  EXPECT_EQ(image.rgb(0, 0), Rgb(0.25f));
  EXPECT_EQ(image.rgb_bilinear({0.5f, 0.5f}), Rgb(0.25f));
}

TEST(Image, BilinearReproducesALinearRampBetweenCenters) {
  Image image(5, 4, 3);
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 5; ++x) image.set_rgb(x, y, {float(x) + 0.5f, float(y) + 0.5f, float(x * y)});
  }
  for (const Vec2f p : {Vec2f{0.5f, 0.5f}, Vec2f{2.25f, 1.75f}, Vec2f{4.5f, 3.5f}, Vec2f{3.9f, 0.6f}}) {
    const Rgb c = image.rgb_bilinear(p);
    EXPECT_NEAR(c.r, p.x, 1e-6f);
    EXPECT_NEAR(c.g, p.y, 1e-6f);
    EXPECT_EQ(image.bilinear(p, 1), c.g);
  }
}

TEST(Image, PositionsOutsideAreClamped) {
  Image image(2, 2, 1);
  image.at(0, 0) = 1, image.at(1, 0) = 2, image.at(0, 1) = 3, image.at(1, 1) = 4;
  EXPECT_EQ(image.bilinear({-5, -5}), 1);
  EXPECT_EQ(image.bilinear({99, -1}), 2);
  EXPECT_EQ(image.bilinear({kInfinity, kInfinity}), 4);
  EXPECT_EQ(image.bilinear({std::nanf(""), std::nanf("")}), 1);
  EXPECT_TRUE(image.contains({0, 0}));
  EXPECT_TRUE(image.contains({1.99f, 1.99f}));
  EXPECT_FALSE(image.contains({2, 1}));
  EXPECT_FALSE(image.contains({1, -0.01f}));
  EXPECT_FALSE(image.contains({std::nanf(""), 1}));
}

}  // namespace
}  // namespace tempera
