// SPDX-License-Identifier: Apache-2.0
// Whole renders of scene files against what is known about them in closed form: from the importer to the layers.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "tempera/frames/cryptomatte.h"
#include "tempera/pipeline/render.h"

namespace tempera {
namespace {

struct Rendered {
  Shot shot;
  Scene scene;
  Frame frame;
  RenderTotals totals;
};

/// Frame `number` of a scene of the repository with keys set as on the command line.
Rendered render(const std::string& name, int number, const std::vector<std::string>& keys) {
  ShotConfig config = read_shot_config(std::string(TEMPERA_SOURCE_DIR) + "/scenes/" + name);
  for (const std::string& k : keys) config.assign(k);
  Warnings warnings;
  LoadedShot loaded = load_shot(config, {}, warnings);
  EXPECT_TRUE(warnings.empty()) << name << ": " << warnings.lines()[0];
  Rendered r{loaded.shot, std::move(loaded.scene), {}, {}};
  r.frame = render_frame(r.shot, r.scene, number, &r.totals);
  EXPECT_EQ(r.totals.bad_samples, 0u);
  return r;
}

// The cards: |x|, |y| <= 0.8 at z = 0, seen from (0, 0, 5) with 40 degrees, 24 frames per second; scenes/tests says how
// they move.
constexpr int kSide = 64;
constexpr double kDegree = kPiD / 180;
double pixels_per_metre(double fov = 40 * kDegree) { return kSide / 2 / std::tan(fov / 2) / 5; }
const std::vector<std::string> kVectors{"film.resolution=64x64", "sampling.spp=1", "shutter.open=0", "shutter.close=0",
                                        "output.layers=motion,depth,object_id"};

/// World position on the card of the center of a pixel.
Vec2d world(int x, int y, double fov = 40 * kDegree) {
  return {(x + 0.5 - kSide / 2) / pixels_per_metre(fov), -(y + 0.5 - kSide / 2) / pixels_per_metre(fov)};
}

/// Compares both vectors with the wanted ones on pixels well inside of the card, and expects rest outside.
/// `tolerance` in pixels. The vectors are those of pixel centers.
template <class F>
void expect_motion(const Rendered& r, F&& wanted, double half_width, double tolerance) {
  int inside = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Vec2d w = world(x, y);
      if (std::max(std::abs(w.x), std::abs(w.y)) > half_width) continue;
      ++inside;
      for (const int direction : {1, -1}) {
        const Image& motion = r.frame.layer(direction > 0 ? "motion.forward" : "motion.backward");
        const Vec2d v = wanted(x, y, direction);
        ASSERT_NEAR(motion.at(x, y, 0), v.x, tolerance) << x << "," << y << " " << direction;
        ASSERT_NEAR(motion.at(x, y, 1), v.y, tolerance) << x << "," << y << " " << direction;
        ASSERT_NEAR(motion.at(x, y, 2), 0, 1e-5) << "the depth does not change";
        ASSERT_EQ(motion.at(x, y, 3), 1.0f);
      }
      ASSERT_NEAR(r.frame.layer("depth").at(x, y), 5, 1e-5);
    }
  }
  EXPECT_GT(inside, 100);
}

TEST(MotionVectors, TranslatingCard) {
  const Rendered r = render("tests/card_translate.gltf", 2, kVectors);
  const double f = pixels_per_metre();
  expect_motion(
      r,
      [&](int, int, int d) {
        return Vec2d{0.5 / 24 * f * d, -0.25 / 24 * f * d};
      },
      0.6, 1e-4);
  const Image& motion = r.frame.layer("motion.forward");
  EXPECT_EQ(r.frame.layer("object_id").at(1, 1), 0.0f);
  EXPECT_NEAR(motion.at(1, 1, 0), 0, 1e-4) << "nothing is there, and the camera is at rest";
  EXPECT_NEAR(motion.at(1, 1, 1), 0, 1e-4);
}

TEST(MotionVectors, RotatingCard) {
  const Rendered r = render("tests/card_rotate.gltf", 12, kVectors);
  const double f = pixels_per_metre();
  expect_motion(
      r,
      [&](int x, int y, int d) {
        const Vec2d w = world(x, y);
        const double a = d * 90 * kDegree / 24;
        const Vec2d to{w.x * std::cos(a) - w.y * std::sin(a), w.x * std::sin(a) + w.y * std::cos(a)};
        return Vec2d{(to.x - w.x) * f, -(to.y - w.y) * f};
      },
      0.5, 0.5 * 90 * kDegree / 24 * 1.5);
}

TEST(MotionVectors, ZoomingCamera) {
  const Rendered r = render("tests/card_zoom.gltf", 12, kVectors);
  const auto fov = [](int frame) { return (40 - 10.0 * frame / 24) * kDegree; };
  expect_motion(
      r,
      [&](int x, int y, int d) {
        const double scale = std::tan(fov(12) / 2) / std::tan(fov(12 + d) / 2) - 1;
        return Vec2d{(x + 0.5 - kSide / 2) * scale, (y + 0.5 - kSide / 2) * scale};
      },
      0.6, 0.02);
}

TEST(MotionVectors, OpenShutterKeepsTheVectorsOfItsMiddle) {
  std::vector<std::string> keys = kVectors;
  keys[2] = "shutter.open=-0.5", keys[3] = "shutter.close=0.5";
  const Rendered still = render("tests/card_rotate.gltf", 12, kVectors),
                 blurred = render("tests/card_rotate.gltf", 12, keys);
  // The same surface is met by other arithmetic once it moves during the exposure: equal to rounding, not to the bit.
  int compared = 0;
  for (const char* layer : {"motion.forward", "motion.backward"}) {
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        if (still.frame.layer("object_id").at(x, y) != blurred.frame.layer("object_id").at(x, y)) continue;
        ++compared;
        for (int c = 0; c < 4; ++c) {
          ASSERT_NEAR(still.frame.layer(layer).at(x, y, c), blurred.frame.layer(layer).at(x, y, c), 1e-3) << layer;
        }
      }
    }
  }
  EXPECT_GT(compared, 2 * kSide * kSide - 20);
}

TEST(MotionBlur, EdgesOfAMovingCardAreRamps) {
  // One frame of one second: the card travels 0.5 m to the right and 0.25 m up.
  const Rendered r = render("tests/card_translate.gltf", 0,
                            {"film.resolution=64x64", "film.crop=0,32,64,1", "sampling.spp=1024", "fps=1",
                             "shutter.open=0", "shutter.close=1"});
  const Image& color = r.frame.layer("color");
  const double f = pixels_per_metre();
  // Coverage of pixel columns in the middle rows: the share of time and width in which the card is there.
  const auto coverage = [&](double x0, double x1) {
    double sum = 0;
    constexpr int kSteps = 4000;
    for (int i = 0; i < kSteps; ++i) {
      const double t = (i + 0.5) / kSteps, left = -0.8 + 0.5 * t, right = 0.8 + 0.5 * t;
      sum += std::max(0.0, std::min(x1, right) - std::max(x0, left)) / (x1 - x0);
    }
    return sum / kSteps;
  };
  double worst = 0;
  for (int x = 0; x < kSide; ++x) {
    const double wanted = coverage((x - kSide / 2) / f, (x + 1 - kSide / 2) / f);
    worst = std::max(worst, std::abs(double(color.at(x, 0, 3)) - wanted));
  }
  EXPECT_LT(worst, 0.01);
}

TEST(Furnace, EveryPixelIsOne) {
  const Rendered r = render("tests/furnace.xml", 0, {"film.resolution=16x16", "sampling.spp=64"});
  double mean = 0;
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 16; ++x) mean += r.frame.layer("color").at(x, y, 1) / (16.0 * 16.0);
  }
  EXPECT_NEAR(mean, 1, 0.01);
}

TEST(Layers, PartsOfADecompositionAddUpToColor) {
  const Rendered r = render("tests/cornell_glass.xml", 0,
                            {"film.resolution=48x48", "sampling.spp=16", "decompose.direct=ED",
                             "decompose.caustic=ED[RT]+", "decompose.mirror=E[RT]+D"});
  const Image& color = r.frame.layer("color");
  double largest_part = 0;
  for (int y = 0; y < color.height(); ++y) {
    for (int x = 0; x < color.width(); ++x) {
      Rgb sum;
      for (const char* part :
           {"class.caustic.color", "class.direct.color", "class.mirror.color", "class.residual.color"}) {
        sum += r.frame.layer(part).rgb(x, y);
        largest_part = std::max(largest_part, double(r.frame.layer("class.mirror.color").at(x, y)));
      }
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(sum[c], color.rgb(x, y)[c], 2e-6f * std::max(1.0f, color.rgb(x, y)[c])) << x << "," << y;
    }
  }
  EXPECT_GT(largest_part, 0) << "the glass sphere shows something";
}

TEST(Layers, HalvesAverageToColorAndVarianceIsTheirs) {
  const Rendered r = render("tests/cornell.xml", 0,
                            {"film.resolution=48x48", "sampling.spp=16", "output.layers=halves,color.var,samples"});
  const Image &color = r.frame.layer("color"), &a = r.frame.layer("color.a"), &b = r.frame.layer("color.b");
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 48; ++x) {
      for (int c = 0; c < 3; ++c) {
        ASSERT_NEAR(0.5f * (a.at(x, y, c) + b.at(x, y, c)), color.at(x, y, c),
                    1e-5f * std::max(1.0f, color.at(x, y, c)));
        ASSERT_FLOAT_EQ(0.25f * sqr(a.at(x, y, c) - b.at(x, y, c)), r.frame.layer("color.var").at(x, y, c));
      }
      ASSERT_EQ(r.frame.layer("samples").at(x, y), 16.0f);
    }
  }
}

TEST(Layers, CryptomatteCoversWhatObjectIdsShow) {
  const Rendered r = render("tests/cornell_motion.xml", 6,
                            {"film.resolution=64x64", "sampling.spp=32", "shutter.open=0", "shutter.close=0.5",
                             "output.layers=cryptomatte,object_id"});
  const auto manifest = cryptomatte_manifest(r.frame.metadata);
  ASSERT_TRUE(manifest.contains("glass_sphere"));
  Image total(64, 64, 1);
  for (const auto& [name, id] : manifest) {
    const Image matte = cryptomatte_matte(r.frame, id);
    for (int y = 0; y < 64; ++y) {
      for (int x = 0; x < 64; ++x) {
        total.at(x, y) += matte.at(x, y);
        if (matte.at(x, y) < 1) continue;
        const auto index = std::size_t(r.frame.layer("object_id").at(x, y)) - 1;
        ASSERT_LT(index, r.scene.instances.size());
        ASSERT_EQ(r.scene.instances[index].name, name) << x << "," << y;
      }
    }
  }
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x)
      ASSERT_NEAR(total.at(x, y), r.frame.layer("color").at(x, y, 3), 1e-5f) << x << "," << y;
  }
}

TEST(Layers, OtherProgramsNamesReadBackAsOurs) {
  const Rendered r = render("tests/cornell.xml", 0,
                            {"film.resolution=16x16", "sampling.spp=2", "output.layers=albedo,normal,depth,motion"});
  const auto file = std::filesystem::temp_directory_path() / "tempera_aov_names.exr";
  for (const AovNames names : {AovNames::kBlender, AovNames::kArnold, AovNames::kRenderman, AovNames::kPbrt}) {
    WriteOptions options;
    options.names = names;
    write_frame(file.string(), r.frame, options);
    const Frame back = read_frame(file.string());
    for (const char* layer : {"color", "albedo", "normal", "depth"}) {
      ASSERT_TRUE(back.has(layer)) << layer << " " << int(names);
      EXPECT_EQ(back.layer(layer), r.frame.layer(layer)) << layer << " " << int(names);
    }
  }
  std::filesystem::remove(file);
}

TEST(Demo, LoadsAndRendersWithoutComplaint) {
  const Rendered r = render("demo/shot.toml", 24, {"film.scale=12.5", "sampling.spp=2"});
  EXPECT_EQ(r.shot.frames.size(), 48u);
  EXPECT_EQ(r.shot.frames.front(), 1);
  EXPECT_EQ(r.shot.settings.width, 80);
  EXPECT_EQ(r.shot.settings.height, 45);
  double mean = 0;
  for (const Layer& l : r.frame.layers()) {
    for (const float v : l.image.values()) ASSERT_TRUE(std::isfinite(v)) << l.desc.name;
  }
  for (int y = 0; y < 45; ++y) {
    for (int x = 0; x < 80; ++x) mean += luminance(r.frame.layer("color").rgb(x, y)) / (80.0 * 45.0);
  }
  EXPECT_GT(mean, 0.01);
  EXPECT_LT(mean, 10);
}

}  // namespace
}  // namespace tempera
