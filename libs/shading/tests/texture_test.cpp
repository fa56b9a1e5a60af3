// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/texture.h"

#include <fmt/format.h>

#include <array>
#include <fstream>
#include <functional>
#include <iterator>

#include "../src/image.h"
#include "shading_test_util.h"
#include "tempera/core/color.h"
#include "tempera/core/log.h"
#include "tempera/shading/color_space.h"

namespace tempera {
namespace {

using test::Random;
using test::TemporaryFolder;
using test::write_image;

ShadingPoint at(float u, float v) {
  ShadingPoint p = test::plane_point({0, 0, 1});
  p.uv = {u, v};
  return p;
}
std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
void expect_rgb(const Rgb& value, const Rgb& expected, float tolerance = 1e-6f) {
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(value[c], expected[c], tolerance) << "channel " << c;
}

/// 4 x 2 floats: value = x + 10 y.
class ImageTextures : public testing::Test {
 protected:
  void SetUp() override {
    std::vector<float> v;
    for (int y = 0; y < 2; ++y)
      for (int x = 0; x < 4; ++x) v.push_back(float(x + 10 * y));
    params.file = folder / "ramp.exr";
    write_image(params.file, 4, 2, 1, v);
  }
  float value(float u, float v) const { return make_image_texture(params)->scalar(at(u, v)); }
  TemporaryFolder folder;
  ImageTextureParams params;
};

TEST_F(ImageTextures, BilinearInterpolatesBetweenTexelCentres) {
  EXPECT_FLOAT_EQ(value(0.125f, 0.25f), 0);
  EXPECT_FLOAT_EQ(value(0.375f, 0.25f), 1);
  EXPECT_FLOAT_EQ(value(0.25f, 0.25f), 0.5f);
  EXPECT_FLOAT_EQ(value(0.375f, 0.5f), 6);
  EXPECT_FLOAT_EQ(value(0.375f, 0.75f), 11);
  params.flip_v = true;
  EXPECT_FLOAT_EQ(value(0.375f, 0.75f), 1);
  params.filter = TextureFilter::kNearest;
  EXPECT_FLOAT_EQ(value(0.49f, 0.51f), 1);
  EXPECT_FLOAT_EQ(value(0.49f, 0.49f), 11);
}

TEST_F(ImageTextures, WrapModes) {
  params.wrap_v = Wrap::kClamp;
  const float row = 0.25f;
  EXPECT_FLOAT_EQ(value(1.375f, row), 1);  // repeat
  EXPECT_FLOAT_EQ(value(0, row), 1.5f);    // between texels 3 and 0
  EXPECT_FLOAT_EQ(value(-0.625f, row), 1);
  EXPECT_FLOAT_EQ(value(0.375f, -7), 1);  // v is clamped
  EXPECT_FLOAT_EQ(value(0.375f, 9), 11);
  params.wrap_u = Wrap::kMirror;
  EXPECT_FLOAT_EQ(value(-0.375f, row), 1);
  EXPECT_FLOAT_EQ(value(1.125f, row), 3);
  EXPECT_FLOAT_EQ(value(1.875f, row), 0);
  EXPECT_FLOAT_EQ(value(2.375f, row), 1);
  EXPECT_FLOAT_EQ(value(0, row), 0);
  params.wrap_u = Wrap::kBlack;
  EXPECT_FLOAT_EQ(value(1.2f, row), 0);
  EXPECT_FLOAT_EQ(value(1.0f, row), 1.5f);  // half of texel 3
  for (const Wrap wrap : {Wrap::kRepeat, Wrap::kMirror, Wrap::kClamp, Wrap::kBlack}) {
    params.wrap_u = params.wrap_v = wrap;
    for (const float u : {1e30f, -1e30f, 4e9f, kInfinity, std::nanf("")}) EXPECT_TRUE(std::isfinite(value(u, u)));
  }
}

TEST_F(ImageTextures, TransformAndSecondSet) {
  params.transform = {2, 0, 0.25f, 0, 1, 0};
  EXPECT_FLOAT_EQ(value(0.0625f, 0.25f), 1);
  params.transform = {0, 1, 0, 1, 0, 0};  // swaps u and v
  EXPECT_FLOAT_EQ(value(0.25f, 0.375f), 1);
  params.transform = {};
  params.uv_set = 1;
  ShadingPoint p = at(0, 0);
  p.uv1 = {0.625f, 0.25f};
  EXPECT_FLOAT_EQ(make_image_texture(params)->scalar(p), 2);
}

TEST_F(ImageTextures, GradientIsTheDerivative) {
  params.transform = {0.7f, 0.3f, 0.1f, -0.2f, 0.9f, 0.4f};
  for (const bool flip : {false, true}) {
    params.flip_v = flip;
    params.invert = flip;
    const auto texture = make_image_texture(params);
    const Texture& base = *texture;
    Random random(1);
    for (int i = 0; i < 50; ++i) {
      const ShadingPoint p = at(random(), random());
      const Vec2f g = texture->scalar_gradient(p), d = base.Texture::scalar_gradient(p);
      // Differences straddle texel edges now and then; there the two need not agree.
      if (std::abs(g.x - d.x) > 0.05f || std::abs(g.y - d.y) > 0.05f) {
        ShadingPoint q = p;
        q.uv += Vec2f{0.004f, 0.004f};
        EXPECT_GT(length(texture->scalar_gradient(q) - g) + length(base.Texture::scalar_gradient(q) - d), 0);
        continue;
      }
      EXPECT_NEAR(g.x, d.x, 0.05f);
      EXPECT_NEAR(g.y, d.y, 0.05f);
    }
  }
  params = {};
  params.file = folder / "ramp.exr";
  const Vec2f g = make_image_texture(params)->scalar_gradient(at(0.3f, 0.4f));
  EXPECT_FLOAT_EQ(g.x, 4);   // one per texel, four texels
  EXPECT_FLOAT_EQ(g.y, 20);  // ten per texel, two texels
}

TEST_F(ImageTextures, MeanAndMipmaps) {
  params.filter = TextureFilter::kMipmap;
  const auto texture = make_image_texture(params);
  EXPECT_FLOAT_EQ(texture->mean().g, 6.5f);
  ShadingPoint p = at(0.375f, 0.25f);
  EXPECT_FLOAT_EQ(texture->scalar(p), 1);  // no footprint
  p.duv_dx = {0.01f, 0}, p.duv_dy = {0, 0.01f};
  EXPECT_FLOAT_EQ(texture->scalar(p), 1);  // smaller than a texel
  p.duv_dx = {50, 0}, p.duv_dy = {0, 50};
  EXPECT_NEAR(texture->scalar(p), 6.5f, 0.01f);  // many times the image
  p.duv_dx = {1, 0}, p.duv_dy = {0, 1e-3f};      // long along u only: rows stay apart
  EXPECT_NEAR(texture->scalar(p), 1.5f, 1.0f);
  p.uv.y = 0.75f;
  EXPECT_NEAR(texture->scalar(p), 11.5f, 1.0f);
}

TEST(ImageTexture, OddSizesKeepTheirMeanInAllLevels) {
  const TemporaryFolder folder;
  Random random(3);
  std::vector<float> v(7 * 5 * 3);
  for (float& x : v) x = random();
  write_image(folder / "odd.exr", 7, 5, 3, v);
  ImageRequest request;
  request.file = folder / "odd.exr";
  request.mipmap = true;
  const auto image = load_image(request, {});
  ASSERT_EQ(image->levels.size(), 2u);
  EXPECT_EQ(image->levels[0].width, 3);
  for (const auto& level : image->levels) {
    double sum = 0;
    for (std::size_t i = 0; i < level.texels.size(); i += 4) sum += double(half_to_float(level.texels[i]));
    EXPECT_NEAR(sum / (level.width * level.height), double(image->mean().c[0]), 1e-3);
  }
}

TEST(ImageTexture, EncodingsAndFormats) {
  const TemporaryFolder folder;
  ImageTextureParams p;
  const auto middle = [&] { return make_image_texture(p)->rgb(at(0.25f, 0.25f)); };
  // sRGB 188 is 0.5028865 linear; half of the range is 0.2140411.
  write_image<std::uint8_t>(folder / "color.png", 2, 2, 3, {188, 0, 255, 9, 9, 9, 9, 9, 9, 9, 9, 9});
  p.file = folder / "color.png";
  expect_rgb(middle(), {0.5028865f, 0, 1}, 2e-6f);
  p.encoding = ColorEncoding::kLinear;
  expect_rgb(middle(), {188 / 255.0f, 0, 1});
  p.invert = true;
  expect_rgb(middle(), {67 / 255.0f, 1, 0});
  p = {};

  write_image<std::uint16_t>(folder / "deep.png", 2, 2, 1, {32768, 0, 0, 0});
  p.file = folder / "deep.png";
  expect_rgb(middle(), Rgb(0.21405f), 2e-4f);
  p.encoding = ColorEncoding::kLinear;
  expect_rgb(middle(), Rgb(0.5f), 2e-4f);
  p.encoding = ColorEncoding::kAuto;

  write_image<float>(folder / "hdr.hdr", 2, 2, 3, std::vector<float>(12, 17.5f));
  p.file = folder / "hdr.hdr";
  expect_rgb(middle(), Rgb(17.5f), 0.1f);
  p.encoding = ColorEncoding::kSrgb;
  write_image<float>(folder / "float.exr", 2, 2, 3, std::vector<float>(12, 0.5f));
  p.file = folder / "float.exr";
  expect_rgb(middle(), Rgb(0.2140411f), 1e-5f);
  p.encoding = ColorEncoding::kAuto;
  expect_rgb(middle(), Rgb(0.5f));
}

TEST(ImageTexture, ChannelsAndAlpha) {
  const TemporaryFolder folder;
  // Alpha 0 must not touch color, and alpha is never decoded from sRGB.
  write_image<std::uint8_t>(folder / "rgba.png", 1, 1, 4, {255, 128, 0, 0});
  write_image<std::uint8_t>(folder / "rgba2.png", 1, 1, 4, {0, 0, 0, 128});
  write_image<std::uint8_t>(folder / "gray_alpha.png", 1, 1, 2, {255, 51});
  ImageTextureParams p;
  p.file = folder / "rgba.png";
  expect_rgb(make_image_texture(p)->rgb(at(0, 0)), {1, 0.2158605f, 0}, 1e-5f);
  const auto scalar = [&](Channel c) {
    p.channel = c;
    return make_image_texture(p)->scalar(at(0, 0));
  };
  EXPECT_FLOAT_EQ(scalar(Channel::kR), 1);
  EXPECT_NEAR(scalar(Channel::kG), 0.2158605f, 1e-5f);
  EXPECT_FLOAT_EQ(scalar(Channel::kB), 0);
  EXPECT_FLOAT_EQ(scalar(Channel::kA), 0);
  EXPECT_NEAR(scalar(Channel::kLuminance), luminance(Rgb{1, 0.2158605f, 0}), 1e-5f);
  p.file = folder / "rgba2.png";
  EXPECT_NEAR(scalar(Channel::kA), 128 / 255.0f, 1e-6f);
  p.file = folder / "gray_alpha.png";
  EXPECT_NEAR(scalar(Channel::kA), 0.2f, 1e-6f);
  EXPECT_FLOAT_EQ(scalar(Channel::kB), 1);
}

TEST(ImageTexture, EncodedBytesInMemory) {
  const TemporaryFolder folder;
  ImageTextureParams p;
  for (const std::string type : {"png", "jpg", "webp", "exr", "tif"}) {
    const auto file = folder / ("image." + type);
    write_image<std::uint8_t>(file, 16, 16, 3, std::vector<std::uint8_t>(16 * 16 * 3, 200));
    const auto texture = make_image_texture(p, bytes_of(file), "image " + type);
    expect_rgb(texture->rgb(at(0.5f, 0.5f)), type == "exr" ? Rgb(200 / 255.0f) : Rgb(srgb_to_linear(200 / 255.0f)),
               0.02f);
  }
}

ErrorCode code_of(const std::function<void()>& f, SourceLoc* loc = nullptr) {
  try {
    f();
  } catch (const Error& e) {
    if (loc) *loc = e.loc();
    return e.code();
  }
  ADD_FAILURE() << "no error";
  return ErrorCode::kFailed;
}

TEST(ImageTexture, Errors) {
  const TemporaryFolder folder;
  ImageTextureParams p;
  SourceLoc loc;
  p.file = folder / "missing.png";
  EXPECT_EQ(code_of([&] { make_image_texture(p, SourceLoc{"scene.xml", 12, 3}); }, &loc), ErrorCode::kMissingFile);
  EXPECT_EQ(loc.line, 12);

  write_image<std::uint8_t>(folder / "whole.png", 64, 64, 3, [] {
    std::vector<std::uint8_t> v(64 * 64 * 3);
    for (std::size_t i = 0; i < v.size(); ++i) v[i] = std::uint8_t(hash_key(i));
    return v;
  }());
  const std::string whole = bytes_of(folder / "whole.png");
  std::ofstream(folder / "cut.png", std::ios::binary) << whole.substr(0, whole.size() / 2);
  std::ofstream(folder / "text.png") << "this is no image";
  std::ofstream(folder / "empty.png").flush();
  for (const char* name : {"cut.png", "text.png", "empty.png"}) {
    p.file = folder / name;
    EXPECT_EQ(code_of(
                  [&] {
                    make_image_texture(p, SourceLoc{"scene.xml", 7, 1});
                  },
                  &loc),
              ErrorCode::kBadInput)
        << name;
    EXPECT_EQ(loc.line, 7);
  }
  p.file.clear();
  EXPECT_EQ(code_of([&] { make_image_texture(p, whole.substr(0, 300), "buffer 1"); }), ErrorCode::kBadInput);
  EXPECT_EQ(code_of([&] { make_image_texture(p, std::string_view(), "buffer 2"); }), ErrorCode::kBadInput);
  EXPECT_EQ(code_of([&] { make_image_texture(p, "nonsense", "buffer 3"); }), ErrorCode::kBadInput);
  EXPECT_EQ(code_of([&] { make_image_texture(p, "\xABKTX 20\xBB\r\n\x1A\n", "buffer 4"); }), ErrorCode::kUnsupported);
  p.file = folder.operator/("");
  EXPECT_EQ(code_of([&] { make_image_texture(p); }), ErrorCode::kMissingFile) << "a folder";
}

TEST(ImageTexture, DamagedBytesNeverCrash) {
  const TemporaryFolder folder;
  for (const std::string type : {"png", "jpg", "webp", "hdr", "exr"}) {
    const auto file = folder / ("whole." + type);
    std::vector<std::uint8_t> v(24 * 24 * 3);
    for (std::size_t i = 0; i < v.size(); ++i) v[i] = std::uint8_t(hash_key(i));
    write_image<std::uint8_t>(file, 24, 24, 3, v);
    const std::string whole = bytes_of(file);
    Random random(8);
    for (int i = 0; i < 40; ++i) {
      std::string bad = whole;
      for (int k = 0; k < 4; ++k) bad[std::size_t(random() * float(bad.size() - 1))] = char(256 * random());
      try {
        ImageTextureParams p;
        make_image_texture(p, bad, "damaged " + std::to_string(i))->rgb(at(0.5f, 0.5f));
      } catch (const Error&) {  // refused: as good as a picture
      }
    }
  }
}

TEST(ImageTexture, PagedImagesLookTheSame) {
  const TemporaryFolder folder;
  constexpr int kWidth = 200, kHeight = 130;
  std::vector<std::uint8_t> v(kWidth * kHeight * 4);
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = std::uint8_t(hash_key(i));
  write_image(folder / "noise.png", kWidth, kHeight, 4, v);
  std::vector<float> f(kWidth * kHeight * 3);
  for (std::size_t i = 0; i < f.size(); ++i) f[i] = float(hash_key(i) % 1000) / 100;
  write_image(folder / "noise.exr", kWidth, kHeight, 3, f);
  for (const char* name : {"noise.png", "noise.exr"}) {
    ImageTextureParams p;
    p.file = folder / name;
    p.wrap_u = Wrap::kMirror;
    for (const Channel channel : {Channel::kRgb, Channel::kA}) {
      p.channel = channel;
      const auto decoded = make_image_texture(p);
      set_image_memory_budget(0);
      std::filesystem::last_write_time(p.file, std::filesystem::last_write_time(p.file) + std::chrono::seconds(1));
      const auto paged = make_image_texture(p);
      set_image_memory_budget(std::size_t(1) << 30);
      Random random(4);
      for (int i = 0; i < 500; ++i) {
        const ShadingPoint q = at(3 * random() - 1, 3 * random() - 1);
        expect_rgb(paged->rgb(q), decoded->rgb(q), 2e-6f);
        EXPECT_NEAR(paged->scalar_gradient(q).x, decoded->scalar_gradient(q).x, 2e-2f);
      }
      expect_rgb(paged->mean(), decoded->mean(), 1e-5f);
    }
  }
}

TEST(ImageTexture, TexelsThatAreNoLightAreReadAsZeroWithOneWarning) {
  const TemporaryFolder folder;
  const float nan = std::nanf("");
  const std::vector<float> f{-1, 0.5f, nan, kInfinity, -kInfinity, 2, 0.25f, 0.5f, 1, -0.0f, 1, 1};
  for (const char* name : {"bad.exr", "bad.tif"}) {
    write_image(folder / name, 2, 2, 3, f);
    for (const auto filter : {TextureFilter::kNearest, TextureFilter::kBilinear, TextureFilter::kMipmap})
      for (const bool paged : {false, true}) {
        Warnings warnings;
        ImageTextureParams p;
        p.file = folder / name;
        p.filter = filter;
        p.warnings = &warnings;
        if (paged) {
          set_image_memory_budget(0);
          std::filesystem::last_write_time(p.file, std::filesystem::last_write_time(p.file) + std::chrono::seconds(1));
        }
        const auto texture = make_image_texture(p);
        set_image_memory_budget(std::size_t(1) << 30);
        if (filter == TextureFilter::kNearest) {
          expect_rgb(texture->rgb(at(0.25f, 0.25f)), {0, 0.5f, 0});
          expect_rgb(texture->rgb(at(0.75f, 0.25f)), {0, 0, 2});
          expect_rgb(texture->rgb(at(0.25f, 0.75f)), {0.25f, 0.5f, 1});
        }
        expect_rgb(texture->mean(), {0.0625f, 0.5f, 1}, 1e-3f);
        Random random(6);
        for (int i = 0; i < 200; ++i) {
          const Rgb c = texture->rgb(at(2 * random() - 1, 2 * random() - 1));
          EXPECT_TRUE(is_finite(c) && std::min({c.r, c.g, c.b}) >= 0);
        }
        if (paged) continue;  // what is wrong is met later, and logged then
        ASSERT_EQ(warnings.lines().size(), 1u);
        EXPECT_NE(warnings.lines()[0].find("negative, infinite or not a number"), std::string::npos);
      }
  }
  // A height may be negative, but not infinite.
  ImageTextureParams height;
  height.file = folder / "bad.exr";
  height.filter = TextureFilter::kNearest;
  height.keep_negative = true;
  EXPECT_EQ(make_image_texture(height)->scalar(at(0.25f, 0.25f)), -1);
  EXPECT_EQ(make_image_texture(height)->scalar(at(0.75f, 0.25f)), 0);
  // Images that are as they should be say nothing.
  Warnings none;
  write_image(folder / "good.exr", 2, 2, 3, std::vector<float>(12, 0.5f));
  ImageTextureParams good;
  good.file = folder / "good.exr";
  good.warnings = &none;
  make_image_texture(good);
  EXPECT_TRUE(none.empty());
}

TEST(Checkerboard, ColorZeroWhereHalvesAgree) {
  const auto t = make_checkerboard(Rgb{1, 0, 0}, Rgb{0, 1, 0}, {});
  expect_rgb(t->rgb(at(0.2f, 0.3f)), {1, 0, 0});
  expect_rgb(t->rgb(at(0.7f, 0.8f)), {1, 0, 0});
  expect_rgb(t->rgb(at(0.7f, 0.3f)), {0, 1, 0});
  expect_rgb(t->rgb(at(-0.3f, 0.3f)), {0, 1, 0});
  expect_rgb(t->mean(), {0.5f, 0.5f, 0});
  const auto scaled = make_checkerboard(1.0f, 0.0f, {4, 0, 0, 0, 4, 0});
  EXPECT_EQ(scaled->scalar(at(0.2f, 0.05f)), 0);
}

TEST(VertexColor, AndProducts) {
  ShadingPoint p = at(0, 0);
  p.color = {0.5f, 0.25f, 1};
  p.color_alpha = 0.4f;
  expect_rgb(make_vertex_color(2)->rgb(p), {1, 0.5f, 2});
  EXPECT_FLOAT_EQ(make_vertex_alpha()->scalar(p), 0.4f);
  expect_rgb(make_product(make_vertex_color(), make_vertex_alpha())->rgb(p), {0.2f, 0.1f, 0.4f});
  const Slot slot(Animated<Rgb>({0.0, 1.0}, {Rgb(0.0f), Rgb(1.0f)}, Interpolation::kLinear), make_vertex_color());
  p.time = 0.5;
  expect_rgb(slot.rgb(p), {0.25f, 0.125f, 0.5f});
  EXPECT_FALSE(slot.is_constant());
}

TEST(Image, HalfFloatsRoundTrip) {
  for (const float f : {0.0f, 1.0f, -2.5f, 0.333251953125f, 65504.0f, 6.1035156e-5f})
    EXPECT_EQ(half_to_float(float_to_half(f)), f);
  EXPECT_EQ(half_to_float(float_to_half(1e9f)), 65504.0f);
}

/// One pixel with what the file says about its colors.
void write_pixel(const std::filesystem::path& file, OIIO::TypeDesc type, const std::vector<float>& rgb,
                 const std::function<void(OIIO::ImageSpec&)>& describe) {
  OIIO::ImageSpec spec(1, 1, int(rgb.size()), type);
  describe(spec);
  auto out = OIIO::ImageOutput::create(file.string());
  ASSERT_TRUE(out && out->open(file.string(), spec) && out->write_image(OIIO::TypeDesc::FLOAT, rgb.data()) &&
              out->close());
}

// Linear Rec. 709 of a stored (0.5, 0.25, 0.75), computed by hand from the definitions: the curve, then the matrix from
// the primaries (published for P3-D65, Rec. 2020 and ACEScg by their standards; with Bradford's adaptation for the
// last).
TEST(ColorSpaces, FilesSayWhatTheirNumbersAre) {
  TemporaryFolder folder;
  const Rgb stored{0.5f, 0.25f, 0.75f};
  const auto srgb = [&](float v) { return srgb_to_linear(v); };
  const Rgb decoded{srgb(stored.r), srgb(stored.g), srgb(stored.b)};
  const auto power = [&](float g) { return Rgb{std::pow(stored.r, g), std::pow(stored.g, g), std::pow(stored.b, g)}; };
  const auto times = [](const Rgb& c, const std::array<float, 9>& m) {
    const Rgb r{m[0] * c.r + m[1] * c.g + m[2] * c.b, m[3] * c.r + m[4] * c.g + m[5] * c.b,
                m[6] * c.r + m[7] * c.g + m[8] * c.b};
    return Rgb{std::max(r.r, 0.0f), std::max(r.g, 0.0f), std::max(r.b, 0.0f)};
  };
  const std::array<float, 9> p3{1.22494f, -0.22494f, 0, -0.04206f, 1.04206f, 0, -0.01964f, -0.07864f, 1.09827f};
  const std::array<float, 9> rec2020{1.66049f,  -0.58764f, -0.07285f, -0.12455f, 1.13290f,
                                     -0.00835f, -0.01815f, -0.10058f, 1.11873f};
  const std::array<float, 9> ap1{1.70505f,  -0.62179f, -0.08326f, -0.13026f, 1.14080f,
                                 -0.01055f, -0.02400f, -0.12897f, 1.15297f};
  struct Case {
    std::string id;
    Rgb expected;
  };
  const std::vector<Case> cases{{"", stored},
                                {"unknown", stored},
                                {"data", stored},
                                {"lin_rec709_scene", stored},
                                {"srgb_rec709_scene", decoded},
                                {"sRGB_Rec709_Display", decoded},
                                {"g22_rec709_scene", power(2.2f)},
                                {"g18_rec709_scene", power(1.8f)},
                                {"g24_rec709_display", power(2.4f)},
                                {"lin_p3d65_scene", times(stored, p3)},
                                {"srgb_p3d65_display", times(decoded, p3)},
                                {"lin_rec2020_scene", times(stored, rec2020)},
                                {"lin_ap1_scene", times(stored, ap1)},
                                {"srgb_ap1_scene", times(decoded, ap1)}};
  for (const OIIO::TypeDesc type : {OIIO::TypeDesc::FLOAT, OIIO::TypeDesc::HALF}) {
    for (const Case& c : cases) {
      ImageTextureParams params;
      params.file = folder / fmt::format("{}_{}.exr", c.id, int(type.basetype));
      write_pixel(params.file, type, {stored.r, stored.g, stored.b}, [&](OIIO::ImageSpec& spec) {
        if (!c.id.empty()) spec.attribute("colorInteropID", c.id);
      });
      SCOPED_TRACE(c.id);
      const float tolerance = type == OIIO::TypeDesc::HALF ? 1e-3f : 2e-4f;
      expect_rgb(make_image_texture(params)->rgb(at(0.5f, 0.5f)), c.expected, tolerance);
      expect_rgb(make_image_texture(params)->mean(), c.expected, tolerance);
      params.encoding = ColorEncoding::kLinear;  // data stay as they are
      expect_rgb(make_image_texture(params)->rgb(at(0.5f, 0.5f)), stored);
    }
  }
  // Chromaticities of an EXR mean primaries, unless the identifier says otherwise.
  const float chromaticities[8] = {0.713f, 0.293f, 0.165f, 0.830f, 0.128f, 0.044f, 0.32168f, 0.33767f};
  for (const bool named : {false, true}) {
    ImageTextureParams params;
    params.file = folder / fmt::format("chromaticities{}.exr", named);
    write_pixel(params.file, OIIO::TypeDesc::FLOAT, {0.5f, 0.25f, 0.75f}, [&](OIIO::ImageSpec& spec) {
      spec.attribute("chromaticities", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 8), chromaticities);
      if (named) spec.attribute("colorInteropID", "lin_rec709_scene");
    });
    expect_rgb(make_image_texture(params)->rgb(at(0.5f, 0.5f)), named ? stored : times(stored, ap1), 2e-4f);
  }
}

// PNG: chunks that OpenImageIO reports. 8 and 16 bits, decoded and paged.
TEST(ColorSpaces, PngChunksCount) {
  TemporaryFolder folder;
  for (const OIIO::TypeDesc type : {OIIO::TypeDesc::UINT8, OIIO::TypeDesc::UINT16}) {
    for (const auto& [name, gamma, expected] : {std::tuple{"sRGB", 0.0f, srgb_to_linear(0.4f)},
                                                {"", 0.0f, srgb_to_linear(0.4f)},
                                                {"Linear", 1.0f, 0.4f},
                                                {"Gamma1.8", 1.8f, std::pow(0.4f, 1.8f)},
                                                {"Gamma2.2", 2.2f, srgb_to_linear(0.4f)}}) {
      ImageTextureParams params;
      params.file = folder / fmt::format("{}_{}.png", name, int(type.basetype));
      write_pixel(params.file, type, {0.4f, 0.4f, 0.4f}, [&, n = name, g = gamma](OIIO::ImageSpec& spec) {
        spec.erase_attribute("oiio:ColorSpace");
        if (*n) spec.attribute("oiio:ColorSpace", n);
        if (g > 0) spec.attribute("oiio:Gamma", g);
      });
      SCOPED_TRACE(name);
      expect_rgb(make_image_texture(params)->rgb(at(0.5f, 0.5f)), Rgb(expected), 2e-4f);
      set_image_memory_budget(0);
      params.filter = TextureFilter::kNearest;
      params.file = folder / fmt::format("copy_{}_{}.png", name, int(type.basetype));
      std::filesystem::copy_file(folder / fmt::format("{}_{}.png", name, int(type.basetype)), params.file);
      expect_rgb(make_image_texture(params)->rgb(at(0.5f, 0.5f)), Rgb(expected), 2e-4f);
      set_image_memory_budget(std::size_t(1) << 30);
    }
  }
}

TEST(ColorSpaces, UnknownOnesAreSaidOnce) {
  TemporaryFolder folder;
  ImageTextureParams params;
  params.file = folder / "odd.exr";
  write_pixel(params.file, OIIO::TypeDesc::FLOAT, {0.5f, 0.25f, 0.75f},
              [&](OIIO::ImageSpec& spec) { spec.attribute("colorInteropID", "pq_rec2020_display"); });
  std::string log;
  set_log_writer([&](std::string_view line) { log += line; });
  const auto texture = make_image_texture(params), again = make_image_texture(params);
  set_log_writer({});
  expect_rgb(texture->rgb(at(0.5f, 0.5f)), {0.5f, 0.25f, 0.75f});
  EXPECT_NE(log.find("\"pq_rec2020_display\" (colorInteropID) is not known; taken as linear"), std::string::npos)
      << log;
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
  EXPECT_FALSE(named_color_space("lin_rec709"));
  EXPECT_FALSE(named_color_space("lin_nothing_scene"));
  EXPECT_FALSE(named_color_space("g2x_rec709_scene"));
  EXPECT_FALSE(named_color_space(""));
}

}  // namespace
}  // namespace tempera
