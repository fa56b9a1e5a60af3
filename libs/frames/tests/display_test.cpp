// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/display.h"

#include <OpenImageIO/imageio.h>

#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"
#include "test_files.h"

namespace tempera {
namespace {

TEST(Display, SrgbTransferFunction) {  // values of IEC 61966-2-1
  EXPECT_NEAR(linear_to_srgb(0.18f), 0.46135613f, 1e-6f);
  EXPECT_NEAR(linear_to_srgb(0.001f), 0.01292f, 1e-7f);
  EXPECT_EQ(linear_to_srgb(0), 0);
  EXPECT_NEAR(linear_to_srgb(1), 1, 1e-6f);
  for (int i = 0; i <= 255; ++i) EXPECT_NEAR(linear_to_srgb(srgb_to_linear(float(i) / 255)), float(i) / 255, 2e-6f);
}

TEST(Display, ExposureIsInStops) {
  EXPECT_NEAR(tone_map(Rgb(0.09f), {1, ToneMap::kSrgb}).g, 0.46135613f, 1e-6f);
  EXPECT_NEAR(tone_map(Rgb(0.25f), {-1, ToneMap::kNone}).g, 0.125f, 1e-7f);
}

TEST(Display, FilmicKeepsMidGrayRisesAndStaysInRange) {
  EXPECT_NEAR(tone_map(Rgb(0.18f), {0, ToneMap::kFilmic}).g, 0.46135613f, 1e-3f);
  float last = -1;
  for (float v = 0; v < 1e5f; v = v * 1.1f + 0.001f) {
    const Rgb c = tone_map(Rgb(v), {0, ToneMap::kFilmic});
    EXPECT_GE(c.g, last);
    EXPECT_LE(c.g, 1);
    last = c.g;
  }
  EXPECT_LT(tone_map(Rgb(1.0f), {0, ToneMap::kFilmic}).g, 0.95f) << "highlights roll off";
  EXPECT_GT(last, 0.99f);
}

TEST(Display, StrangeValuesAreShownAsBlackOrWhite) {
  for (const ToneMap t : {ToneMap::kSrgb, ToneMap::kFilmic, ToneMap::kNone}) {
    const Rgb c = tone_map({std::nanf(""), kInfinity, -kInfinity}, {0, t});
    EXPECT_NEAR(tone_map(Rgb(kInfinity), {0, t}).g, 1.0f, 1e-6f);
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(c[i] >= 0 && c[i] <= 1);
    EXPECT_EQ(tone_map(Rgb(std::nanf("")), {0, t}), Rgb(0.0f));
    EXPECT_EQ(tone_map(Rgb(-1.0f), {0, t}).r, 0);
  }
  EXPECT_EQ(parse_tone_map("filmic"), ToneMap::kFilmic);
  EXPECT_EQ(test::error_of([] { parse_tone_map("agx"); }).code(), ErrorCode::kUnknownName);
}

TEST(Display, ResizingKeepsTheMean) {
  Image image(7, 5, 3);
  for (std::size_t i = 0; i < image.values().size(); ++i) image.values()[i] = float(i * 37 % 101);
  const auto mean_of = [](const Image& m) {
    double sum = 0;
    for (const float v : m.values()) sum += v;
    return sum / double(m.values().size());
  };
  for (const auto& [w, h] : {std::pair{3, 2}, {1, 1}, {7, 5}, {14, 10}, {10, 3}}) {
    const Image small = resized(image, w, h);
    EXPECT_EQ(small.width(), w);
    EXPECT_NEAR(mean_of(small), mean_of(image), 1e-3) << w << "x" << h;
  }
  EXPECT_EQ(resized(image, 7, 5), image);
  EXPECT_EQ(resized(image, 14, 10).at(13, 9, 2), image.at(6, 4, 2));
}

class Png : public test::TestFolder {};

TEST_F(Png, HoldsTheToneMappedPicture) {
  Image image(3, 2, 4);
  image.set_rgb(0, 0, {0.18f, 1, 0});
  image.set_rgb(2, 1, {9, -1, std::nanf("")});
  write_png(path("a.png"), image);
  const auto in = OIIO::ImageInput::open(path("a.png"));
  ASSERT_TRUE(in);
  EXPECT_EQ(in->spec().nchannels, 3);
  std::vector<std::uint8_t> data(18);
  ASSERT_TRUE(in->read_image(0, 0, 0, 3, OIIO::TypeDesc::UINT8, data.data()));
  EXPECT_EQ((std::vector<std::uint8_t>(data.begin(), data.begin() + 6)),
            (std::vector<std::uint8_t>{118, 255, 0, 0, 0, 0}));
  EXPECT_EQ((std::vector<std::uint8_t>(data.end() - 3, data.end())), (std::vector<std::uint8_t>{255, 0, 0}));
  EXPECT_EQ(test::error_of([&] { write_png(path("b.png"), Image()); }).code(), ErrorCode::kBadInput);
  EXPECT_EQ(test::error_of([&] { write_png("/dev/full", image); }).code(), ErrorCode::kFailed);
}

TEST_F(Png, LayerOfAFrameToPng) {
  Frame f(4, 4);
  f.create(layers::depth()).at(1, 2) = 0.5f;
  write_frame(path("f.exr"), f);
  write_png(path("depth.png"), read_frame(path("f.exr")).layer("depth"), {0, ToneMap::kNone});
  const Image back = read_frame(path("depth.png")).layer("color");
  EXPECT_NEAR(linear_to_srgb(back.rgb(1, 2).r), 128 / 255.0f, 1e-5f);
  EXPECT_EQ(back.rgb(0, 0).r, 0);
}

}  // namespace
}  // namespace tempera
