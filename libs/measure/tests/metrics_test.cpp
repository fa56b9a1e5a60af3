// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/metrics.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tempera/core/color.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {
namespace {

/// A number in [0,1) for each pixel, channel and key, as the script that recorded the values below computes it.
double random_value(std::uint32_t x, std::uint32_t y, std::uint32_t c, std::uint32_t key) {
  std::uint32_t h = x * 73856093u ^ y * 19349663u ^ c * 83492791u ^ key * 2654435761u;
  h = (h ^ h >> 16) * 0x45d9f3bu;
  h = (h ^ h >> 16) * 0x45d9f3bu;
  return (h ^ h >> 16) / 4294967296.0;
}

enum class Kind { kReference, kNoise, kShift };

/// Gradients under a checkerboard, with noise, or moved by two pixels.
Image picture(Kind kind, int w = 48, int h = 40) {
  Image image(w, h, 3);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const int xs = kind == Kind::kShift ? std::max(x - 2, 0) : x;
      for (int c = 0; c < 3; ++c) {
        double v = 0.1 + 0.8 * (c == 0   ? double(xs) / (w - 1)
                                : c == 1 ? double(y) / (h - 1)
                                         : double(xs + y) / (w + h - 2));
        if ((xs / 8 + y / 8) % 2) v *= 0.4;
        if (kind == Kind::kNoise)
          v += 0.3 * (random_value(std::uint32_t(x), std::uint32_t(y), std::uint32_t(c), 1) - 0.5);
        image.at(x, y, c) = float(std::clamp(v, 0.0, 1.0));
      }
    }
  }
  return image;
}

Image cubed(Image image) {  // to a high dynamic range
  for (float& v : image.values()) v = v * v * v * 8;
  return image;
}

Image constant(const Rgb& c, int w = 48, int h = 40) {
  Image image(w, h, 3);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) image.set_rgb(x, y, c);
  }
  return image;
}

TEST(Mse, ClosedForms) {
  const Image reference = constant({0.5f, 1, 2}), test = constant({0.75f, 1, 1});
  Image map;
  EXPECT_NEAR(mse(test, reference, &map), (0.0625 + 0 + 1) / 3, 1e-7);
  EXPECT_NEAR(map.at(3, 4), (0.0625 + 0 + 1) / 3, 1e-7);
  EXPECT_NEAR(relative_mse(test, reference), (0.0625 / 0.26 + 0 + 1 / 4.01) / 3, 1e-7);
  EXPECT_NEAR(relative_mse(test, reference, nullptr, 0.5), (0.0625 / 0.75 + 0 + 1 / 4.5) / 3, 1e-7);
  EXPECT_EQ(mse(reference, reference), 0);
}

TEST(Mse, NonFinitePixelsAreLeftOutAndCounted) {
  const Image reference = constant(Rgb(1.0f), 4, 2);
  Image test = constant(Rgb(2.0f), 4, 2), map;
  test.at(1, 1, 2) = std::nanf("");
  test.at(3, 0, 0) = kInfinity;
  EXPECT_EQ(mse(test, reference, &map), 1);
  EXPECT_EQ(map.at(1, 1), 0);
  EXPECT_EQ(map.at(0, 1), 1);
  EXPECT_EQ(count_non_finite(test), 2);
  EXPECT_EQ(count_non_finite(reference), 0);
  test.at(0, 0, 1) = -kInfinity;
  EXPECT_EQ(count_non_finite(test), 3);
}

// The values of NumPy for the same pictures: tools/metric_constants.py prints all constants of this file.
TEST(Mse, AgreesWithNumPy) {
  const Image reference = picture(Kind::kReference), noise = picture(Kind::kNoise), shift = picture(Kind::kShift);
  EXPECT_NEAR(mse(noise, reference), 0.007259066401, 1e-9);
  EXPECT_NEAR(mse(shift, reference), 0.02185610252, 1e-9);
  EXPECT_NEAR(relative_mse(noise, reference), 0.1173076176, 1e-7);
  EXPECT_NEAR(relative_mse(shift, reference), 0.1971043055, 1e-7);
  EXPECT_NEAR(relative_mse_gray(noise, reference), 0.1394763484, 1e-7);
  EXPECT_NEAR(relative_mse_gray(shift, reference), 0.2657289589, 1e-7);
  EXPECT_NEAR(relative_mse(noise, reference, nullptr, 1e-2, 0.05), 0.09927399957, 1e-7);
  EXPECT_NEAR(relative_mse(shift, reference, nullptr, 1e-2, 0.05), 0.1157450827, 1e-7);
  EXPECT_NEAR(luminance_bias(noise, reference), 0.00207815588, 1e-6);
  EXPECT_NEAR(luminance_bias(shift, reference), -0.009529186614, 1e-6);
}

TEST(Mse, GrayReferenceWeighsSaturatedColorsLikeGrayOnes) {
  const Image reference = constant({0, 0, 3}), test = constant({0.1f, 0, 3});
  EXPECT_NEAR(relative_mse_gray(test, reference), 0.01 / 3 / (1 + 1e-3), 1e-8);
  EXPECT_NEAR(relative_mse(test, reference), 0.01 / 3 / 1e-2, 1e-7);
}

TEST(Mse, TrimmingLeavesOutTheLargestErrors) {
  const Image reference = constant(Rgb(1.0f), 100, 10);
  Image test = constant(Rgb(1.5f), 100, 10), map;
  test.set_rgb(3, 4, Rgb(1001));  // a firefly: one pixel of a thousand
  EXPECT_NEAR(mse(test, reference), (999 * 0.25 + 1e6) / 1000, 1e-6);
  EXPECT_NEAR(mse(test, reference, nullptr, 0.001), 0.25, 1e-12);
  EXPECT_NEAR(mse(test, reference, &map, 0.0009), (999 * 0.25 + 1e6) / 1000, 1e-6) << "less than one pixel";
  EXPECT_EQ(map.at(3, 4), 1e6f) << "maps show everything";
  test.set_rgb(7, 7, Rgb(std::nanf("")));  // does not count, and so is not what is left out
  EXPECT_NEAR(mse(test, reference, nullptr, 0.0011), 0.25, 1e-12);
}

TEST(Mse, NothingLeftIsNotANumber) {
  const Image reference = constant(Rgb(1.0f), 4, 4), test = constant(Rgb(kInfinity), 4, 4);
  EXPECT_TRUE(std::isnan(mse(test, reference)));
  EXPECT_TRUE(std::isnan(luminance_bias(test, reference)));
  EXPECT_TRUE(std::isnan(luminance_bias(reference, constant(Rgb(0.0f), 4, 4))));
}

TEST(LuminanceBias, ClosedForm) {
  const Image reference = picture(Kind::kReference);
  Image brighter = reference;
  for (float& v : brighter.values()) v *= 1.25f;
  EXPECT_NEAR(luminance_bias(brighter, reference), 0.25, 1e-6);
  EXPECT_EQ(luminance_bias(reference, reference), 0);
}

// The values of scikit-image 0.26 for the displayed pictures.
TEST(Psnr, AgreesWithScikitImage) {
  const Image reference = picture(Kind::kReference), noise = picture(Kind::kNoise), shift = picture(Kind::kShift);
  EXPECT_NEAR(psnr(noise, reference), 19.66725405, 1e-4);
  EXPECT_NEAR(psnr(shift, reference), 18.81692885, 1e-4);
  EXPECT_NEAR(psnr(noise, reference, -1), 22.30991684, 1e-4);
  EXPECT_NEAR(psnr(shift, reference, -1), 21.32551215, 1e-4);
  EXPECT_EQ(psnr(noise, noise), INFINITY);
  EXPECT_NEAR(display_mse(noise, reference), std::pow(10, -1.966725405), 1e-7);
}

TEST(Psnr, SeesWhatADisplayShows) {
  EXPECT_EQ(psnr(constant(Rgb(7.0f)), constant(Rgb(1.0f))), INFINITY) << "both are white";
  EXPECT_EQ(psnr(constant(Rgb(std::nanf(""))), constant(Rgb(-1.0f))), INFINITY) << "both are black";
  EXPECT_NEAR(psnr(constant(Rgb(1.0f)), constant(Rgb(0.0f))), 0, 1e-5);
  EXPECT_NEAR(psnr(constant(Rgb(2.0f)), constant(Rgb(1.0f)), -1), -20 * std::log10(1 - linear_to_srgb(0.5f)), 1e-4);
}

TEST(Ssim, AgreesWithScikitImage) {
  const Image reference = picture(Kind::kReference), noise = picture(Kind::kNoise), shift = picture(Kind::kShift);
  EXPECT_NEAR(ssim(noise, reference), 0.8188856504, 1e-5);
  EXPECT_NEAR(ssim(shift, reference), 0.4353979931, 1e-5);
  EXPECT_EQ(ssim(noise, noise), 1);
  EXPECT_NEAR(ssim(noise, reference), ssim(reference, noise), 1e-7) << "it is symmetric";
}

TEST(Ssim, ClosedFormOfFlatPictures) {  // only the first of its factors is left
  const double a = linear_to_srgb(0.25f), b = linear_to_srgb(0.5f);
  EXPECT_NEAR(ssim(constant(Rgb(0.25f)), constant(Rgb(0.5f))), (2 * a * b + 1e-4) / (a * a + b * b + 1e-4), 2e-5);
  EXPECT_TRUE(std::isnan(ssim(Image(10, 40, 3), Image(10, 40, 3)))) << "no window fits";
  EXPECT_EQ(ssim(Image(11, 11, 3), Image(11, 11, 3)), 1);
}

TEST(Mse, AlphaDoesNotCount) {
  Image reference(2, 2, 4), test(2, 2, 4);
  test.at(1, 1, 3) = 5;
  EXPECT_EQ(mse(test, reference), 0);
  EXPECT_EQ(mse(Image(2, 2, 1, 0.5f), reference), 0.25);
}

TEST(Metrics, DifferentSizesAreErrors) {
  const Image a(4, 4, 3), b(4, 5, 3);
  for (auto metric : {+[](const Image&x, const Image&y) { return mse(x, y); },
                      +[](const Image&x, const Image&y) { return relative_mse(x, y); },
                      +[](const Image&x, const Image&y) { return flip(x, y); },
                      +[](const Image&x, const Image&y) { return hdr_flip(x, y); },
                      +[](const Image&x, const Image&y) { return psnr(x, y); },
                      +[](const Image&x, const Image&y) { return ssim(x, y); },
                      +[](const Image&x, const Image&y) { return luminance_bias(x, y); },
                      +[](const Image&x, const Image&y) { return temporal_error(x, x, y, y).value; },
                      +[](const Image&x, const Image&y) { return motion_error(x, y).value; },
                      +[](const Image&x, const Image&y) { return luminance_change(x, y).value; }}) {
    try {
      metric(a, b);
      ADD_FAILURE() << "no Error was thrown";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      EXPECT_EQ(e.message(), "cannot compare 4x4 pixels with a reference of 4x5");
    }
  }
}

// The values of NVIDIA's flip-evaluator 1.7 for the same pictures (linear input, means of its maps in double
// precision).
TEST(Flip, AgreesWithTheOfficialTool) {
  const Image reference = picture(Kind::kReference);
  Image map;
  EXPECT_NEAR(flip(picture(Kind::kNoise), reference, &map), 0.1621532, 1e-5);
  EXPECT_NEAR(map.at(7, 5), 0.2145127f, 1e-5f);
  EXPECT_NEAR(map.at(47, 39), 0.14699174f, 1e-5f);
  EXPECT_NEAR(flip(picture(Kind::kShift), reference, &map), 0.2743978, 1e-5);
  EXPECT_NEAR(map.at(7, 5), 0.25616652f, 1e-5f);
  EXPECT_NEAR(map.at(47, 39), 0.12654567f, 1e-5f);
  EXPECT_NEAR(flip(picture(Kind::kNoise), reference, nullptr, 30), 0.3047018, 1e-5);
  EXPECT_NEAR(flip(constant(Rgb(1.0f)), constant(Rgb(0.0f))), 0.9673883, 1e-5);
  EXPECT_NEAR(flip(constant({0, 0, 1}), constant({0, 1, 0})), 1, 1e-5);
  EXPECT_NEAR(flip(constant(Rgb(0.25f)), constant(Rgb(0.2f))), 0.1834358, 1e-5);
}

TEST(HdrFlip, AgreesWithTheOfficialTool) {
  const Image reference = cubed(picture(Kind::kReference));
  const FlipExposures e = flip_exposures(reference);
  EXPECT_NEAR(e.start, -1.3101238f, 1e-5f);
  EXPECT_NEAR(e.stop, 3.2242694f, 1e-5f);
  EXPECT_EQ(e.count, 5);
  Image map;
  EXPECT_NEAR(hdr_flip(cubed(picture(Kind::kNoise)), reference, &map), 0.3879138, 1e-5);
  EXPECT_NEAR(map.at(7, 5), 0.54383814f, 1e-5f);
  EXPECT_NEAR(hdr_flip(cubed(picture(Kind::kShift)), reference), 0.4608266, 1e-5);
}

TEST(Flip, IsZeroForEqualPicturesAndAtMostOne) {
  const Image a = picture(Kind::kNoise, 61, 33);
  EXPECT_EQ(flip(a, a), 0);
  EXPECT_EQ(hdr_flip(cubed(a), cubed(a)), 0);
  Image map;
  flip(constant({0, 0, 1}, 9, 9), picture(Kind::kReference, 9, 9), &map);
  for (const float v : map.values()) EXPECT_TRUE(v >= 0 && v <= 1) << v;
}

TEST(Flip, SmallerThanItsFiltersAndStrangeValues) {
  Image reference(3, 2, 3, 0.5f), test(3, 2, 3, 0.5f);
  EXPECT_EQ(flip(test, reference), 0);
  test.at(1, 1, 0) = std::nanf("");
  test.at(2, 1, 1) = kInfinity;
  test.at(0, 0, 2) = -3;
  reference.at(0, 1, 0) = kInfinity;
  EXPECT_TRUE(std::isfinite(flip(test, reference)));
  EXPECT_TRUE(std::isfinite(hdr_flip(test, reference)));
  EXPECT_GT(hdr_flip(test, reference), 0);
}

TEST(HdrFlip, BlackReferences) {
  const Image black(8, 8, 3);
  EXPECT_EQ(hdr_flip(black, black), 0);
  EXPECT_GT(hdr_flip(Image(8, 8, 3, 1.0f), black), 0.5);
  Image lamp = black;  // most pixels are black: the median says nothing about the rest
  lamp.set_rgb(4, 4, Rgb(100.0f));
  lamp.set_rgb(5, 4, Rgb(1.0f));
  const FlipExposures e = flip_exposures(lamp);
  EXPECT_TRUE(std::isfinite(e.stop));
  EXPECT_GE(e.stop, e.start);
  EXPECT_TRUE(std::isfinite(hdr_flip(black, lamp)));
}

TEST(Metrics, SameBitsOnAnyNumberOfThreads) {
  const Image reference = picture(Kind::kReference, 123, 77), test = picture(Kind::kNoise, 123, 77);
  double one[9], seven[9];
  const auto all = [&](double* out) {
    out[0] = mse(test, reference), out[1] = relative_mse(test, reference);
    out[2] = flip(test, reference), out[3] = hdr_flip(cubed(test), cubed(reference));
    out[4] = psnr(test, reference), out[5] = ssim(test, reference), out[6] = luminance_bias(test, reference);
    out[7] = relative_mse_gray(test, reference, nullptr, 1e-3, 0.01);
    out[8] = luminance_change(test, reference).value;
  };
  with_threads(1, [&] { all(one); });
  with_threads(7, [&] { all(seven); });
  for (int i = 0; i < 9; ++i) EXPECT_EQ(one[i], seven[i]) << i;
}

}  // namespace
}  // namespace tempera
