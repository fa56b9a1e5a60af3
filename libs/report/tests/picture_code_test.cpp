// SPDX-License-Identifier: Apache-2.0
#include "tempera/report/picture_code.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tempera/core/error.h"

namespace tempera {
namespace {

/// Numbers in [0,1) that are the same everywhere.
class Numbers {
 public:
  explicit Numbers(std::uint64_t seed) : state_(seed) {}
  double operator()() {  // splitmix64
    std::uint64_t z = state_ += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return double((z ^ z >> 31) >> 11) * 0x1p-53;
  }

 private:
  std::uint64_t state_;
};

/// A shaded picture with noise of the given relative deviation, as few paths a pixel give it: gray for the most part.
Image noisy(int width, int height, double deviation, std::uint64_t seed = 1) {
  Image image(width, height, 4, 1.0f);
  Numbers u(seed);
  const auto log_normal = [&](double s) {
    return std::exp(s * std::sqrt(-2 * std::log(1 - u())) * std::cos(2 * 3.14159265 * u()));
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double shade = (0.2 + 0.6 * x / width) * log_normal(deviation);
      image.set_rgb(x, y,
                    {float(shade * 0.9 * log_normal(0.3 * deviation)), float(shade),
                     float(shade * 0.7 * log_normal(0.3 * deviation))});
    }
  }
  return image;
}

/// Whether decoding gives the values of the first three channels (or the only one) within half a step of the code.
testing::AssertionResult DecodesTo(const EncodedPicture& p, const Image& image) {
  const Image out = decode_picture(p, image.width(), image.height());
  const double factor = std::exp2(0.5 / p.code.steps) * (1 + 1e-6);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      for (int c = 0; c < p.channels; ++c) {
        const double v = image.pixel(x, y)[c], d = out.pixel(x, y)[c];
        const auto wrong = [&] {
          return testing::AssertionFailure()
                 << "pixel " << x << ", " << y << " channel " << c << ": " << v << " became " << d << " with "
                 << p.code.steps << " steps from " << p.code.toe;
        };
        if (!std::isfinite(v)) {
          if (!std::isnan(d)) return wrong();
          continue;
        }
        const double a = std::abs(v) + p.code.toe, b = std::abs(d) + p.code.toe;
        if (!(b <= a * factor && a <= b * factor)) return wrong();
        if (v * d < 0 || (v == 0 && d != 0)) return wrong();
      }
    }
  }
  return testing::AssertionSuccess();
}

TEST(PictureCode, KeepsValuesWithinHalfAStep) {
  for (const double deviation : {0.0, 0.05, 0.5, 2.0}) {
    const Image image = noisy(61, 37, deviation);
    const EncodedPicture p = encode_picture(image);
    EXPECT_EQ(p.channels, 3);
    EXPECT_TRUE(DecodesTo(p, image)) << deviation;
  }
}

TEST(PictureCode, KeepsSignsZerosAndExtremes) {
  Image image(8, 4, 1);
  const float values[] = {0, -0.0f, 1, -1, 1e-30f, -1e-6f, 65504, -3e5f, 3e38f, 1e-38f, 0.18f, -0.18f, 2, 3, 4, 5};
  for (int i = 0; i < 32; ++i) image.values()[i] = values[i % 16];
  const EncodedPicture p = encode_picture(image, {.bytes_per_pixel = 100});
  EXPECT_EQ(p.channels, 1);
  EXPECT_TRUE(DecodesTo(p, image));
  EXPECT_EQ(p.code.steps, 192) << "finer codes of this range would not fit into 16 bits";
  EXPECT_NEAR(relative_error(p.code), 0.0018, 1e-4);
}

TEST(PictureCode, MarksWhatIsNotFinite) {
  Image image = noisy(9, 7, 0.3);
  image.pixel(4, 3)[1] = NAN;
  image.pixel(0, 0)[0] = std::numeric_limits<float>::infinity();
  image.pixel(8, 6)[2] = -std::numeric_limits<float>::infinity();
  EXPECT_TRUE(DecodesTo(encode_picture(image), image));
  Image nothing(5, 5, 3, NAN);
  EXPECT_TRUE(DecodesTo(encode_picture(nothing), nothing));
}

TEST(PictureCode, TakesAnyShape) {
  for (const auto& [w, h] : {std::pair{1, 1}, {1, 9}, {9, 1}, {2, 2}, {3, 5}}) {
    for (const int channels : {1, 2, 3, 4}) {
      Image image(w, h, channels);
      Numbers u(7);
      for (float& v : image.values()) v = float(u() - 0.3);
      const EncodedPicture p = encode_picture(image, {.bytes_per_pixel = 100});
      EXPECT_EQ(p.channels, channels >= 3 ? 3 : 1);
      EXPECT_TRUE(DecodesTo(p, image)) << w << "x" << h << "x" << channels;
    }
  }
  EXPECT_THROW(encode_picture(Image()), Error);
}

TEST(PictureCode, StaysWithinItsBytesAndSpendsThemOnPrecision) {
  int steps = 1000;
  for (const double deviation : {0.02, 0.2, 0.6, 1.5}) {
    const Image image = noisy(320, 180, deviation);
    const EncodedPicture p = encode_picture(image, {.bytes_per_pixel = 1.6});
    EXPECT_LE(double(p.bytes.size()), 1.6 * double(image.pixels())) << deviation;
    EXPECT_LT(p.code.steps, steps) << "more noise is stored with fewer steps";
    steps = p.code.steps;
    // Half a step is a small part of the noise, so what it adds to squared errors does not count.
    EXPECT_LT(relative_error(p.code), 0.1 * deviation);
    if (p.code.steps < 256) {
      EXPECT_GT(double(p.bytes.size()), 1.3 * double(image.pixels())) << "bytes were left";
    }
  }
  const EncodedPicture coarse = encode_picture(noisy(320, 180, 1.5), {.bytes_per_pixel = 0.01});
  EXPECT_EQ(coarse.code.steps, 2) << "the coarsest code is the end";
}

TEST(PictureCode, SmoothPicturesAreSmallAndFine) {
  const Image image = noisy(320, 180, 0);
  const EncodedPicture p = encode_picture(image);
  EXPECT_EQ(p.code.steps, 256);
  EXPECT_LT(double(p.bytes.size()), 0.2 * double(image.pixels()));
}

TEST(PictureCode, WhereTheSearchBeginsDoesNotMatter) {
  const Image image = noisy(160, 90, 0.4);
  const EncodedPicture a = encode_picture(image);
  for (const int first : {2, 24, 64, 256}) {
    const EncodedPicture b = encode_picture(image, {.first_steps = first});
    EXPECT_EQ(a.code, b.code) << first;
    EXPECT_EQ(a.bytes, b.bytes) << first;
  }
  EXPECT_EQ(encode_picture(image, {.bytes_per_pixel = 100, .max_steps = 32}).code.steps, 32);
}

TEST(PictureCode, VectorsAreExactToASixteenthOfAPixel) {
  Image vectors(31, 17, 4);
  Numbers u(3);
  for (int y = 0; y < 17; ++y) {
    for (int x = 0; x < 31; ++x) {
      float* p = vectors.pixel(x, y);
      p[0] = float(20 * (u() - 0.5)), p[1] = float(400 * (u() - 0.5)), p[2] = 7, p[3] = x % 5 == 0 ? 0.0f : 1.0f;
    }
  }
  vectors.pixel(1, 0)[0] = NAN;
  vectors.pixel(2, 0)[0] = 1e9f;
  const EncodedPicture p = encode_vectors(vectors);
  EXPECT_EQ(p.channels, 2);
  const Image out = decode_picture(p, 31, 17);
  EXPECT_TRUE(std::isnan(out.pixel(1, 0)[0]));
  EXPECT_EQ(out.pixel(2, 0)[0], 4095);
  for (int y = 1; y < 17; ++y) {
    for (int x = 0; x < 31; ++x) {
      if (x % 5 == 0) {
        EXPECT_TRUE(std::isnan(out.pixel(x, y)[0]) && std::isnan(out.pixel(x, y)[1]));
      } else {
        EXPECT_NEAR(out.pixel(x, y)[0], vectors.pixel(x, y)[0], 1 / 16.0 + 1e-5);
        EXPECT_NEAR(out.pixel(x, y)[1], vectors.pixel(x, y)[1], 1 / 16.0 + 1e-5);
      }
    }
  }
  const Image two(4, 4, 2, 1.5f);  // without validity, as other programs write them
  EXPECT_EQ(decode_picture(encode_vectors(two), 4, 4).pixel(3, 3)[1], 1.5f);
}

TEST(PictureCode, RefusesWhatItDidNotWrite) {
  EncodedPicture p = encode_picture(noisy(20, 10, 0.2));
  EXPECT_THROW(decode_picture(p, 20, 11), Error);
  EXPECT_THROW(decode_picture(p, 20, 9), Error);
  p.bytes[p.bytes.size() / 2] ^= 1;
  EXPECT_THROW(decode_picture(p, 20, 10), Error) << "a checksum covers the codes";
}

TEST(Base64, AgreesWithTheStandard) {  // RFC 4648, section 10
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foo"), "Zm9v");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(base64(std::string("\xff\xfe\x00", 3)), "//4A");
}

}  // namespace
}  // namespace tempera
