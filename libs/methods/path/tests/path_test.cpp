// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>

#include "box_shot.h"
#include "tempera/scene/light_shape.h"

namespace tempera {
namespace {

/// Two-sided z-test of the mean over the pixels of a picture whose every pixel estimates `expected`.
testing::AssertionResult PixelsEstimate(double expected, const Image& image, double alpha = 1e-3) {
  double n = 0, mean = 0, m2 = 0;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      const double v = luminance(image.rgb(x, y)), d = v - mean;
      mean += d / ++n;
      m2 += d * (v - mean);
    }
  }
  const double error = std::sqrt(m2 / (n - 1) / n) + 5e-5 * std::abs(expected);
  const double z = (mean - expected) / error, p = std::erfc(std::abs(z) / std::sqrt(2.0));
  if (p >= alpha) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "mean " << mean << " +- " << error << ", expected " << expected
                                     << ", z = " << z;
}

AnimatedTransform moving(const Vec3d& a, const Vec3d& b, double t0 = -2, double t1 = 2) {
  AnimatedTransform t;
  t.keyed = true;
  t.translation = {{t0, t1}, {a, b}, Interpolation::kLinear};
  return t;
}

TestShot furnace(float albedo, float emission) {
  TestShot shot;
  Shape& s = shot.add(Sphere{{}, true}, make_diffuse(albedo));
  s.emission = AreaEmission{Slot(emission), false};
  shot.perspective(Affine3d(look_at(Vec3f{0.1f, 0.2f, 0.3f}, Vec3f{1, 0, 0}, Vec3f{0, 1, 0})), 1.2f);
  shot.settings.width = shot.settings.height = 16;
  return shot;
}

// Radiance in a closed sphere is Le / (1 - albedo) everywhere.
TEST(Path, FurnaceRadianceIsOne) {
  for (const SamplerKind sampler : {SamplerKind::kIndependent, SamplerKind::kSobol}) {
    TestShot shot = furnace(0.5f, 0.5f);
    shot.settings.sampler = sampler;
    EXPECT_TRUE(PixelsEstimate(1, shot.render().layer("color")));
  }
}

TEST(Path, FurnaceHoldsForEveryFilter) {
  for (const FilterKind kind : {FilterKind::kBox, FilterKind::kTent, FilterKind::kGaussian, FilterKind::kMitchell,
                                FilterKind::kBlackmanHarris}) {
    TestShot shot = furnace(0.5f, 0.5f);
    shot.settings.filter = PixelFilter(kind);
    EXPECT_TRUE(PixelsEstimate(1, shot.render().layer("color"))) << filter_name(kind);
  }
}

TEST(Path, DepthLimitsCutTheGeometricSeries) {
  for (const int depth : {1, 2, 3, 6}) {
    TestShot shot = furnace(0.5f, 0.5f);
    shot.parameters = "max_depth=" + std::to_string(depth);
    EXPECT_TRUE(PixelsEstimate(1 - std::pow(0.5, depth), shot.render().layer("color"))) << depth;
  }
}

TEST(Path, RouletteFromTheStartIsUnbiased) {
  TestShot shot = furnace(0.5f, 0.5f);
  shot.parameters = "rr_depth=1";
  EXPECT_TRUE(PixelsEstimate(1, shot.render().layer("color")));
}

// A plane of albedo 0.5 under each light that has a closed form.
TEST(Path, AnalyticLightsOnAPlane) {
  const auto plane = [](const std::function<void(TestShot&)>& light) {
    TestShot shot;
    Mesh rectangle = make_rectangle();
    transform(rectangle, scale(Vec3d{100, 100, 1}));
    shot.add(rectangle, make_diffuse(0.5f));
    shot.orthographic(0.01f);  // a small spot around the origin
    light(shot);
    return shot.render().layer("color");
  };
  EXPECT_TRUE(
      PixelsEstimate(0.5 * 3 / kPiD * 0.8, plane([](TestShot& shot) {
                       PunctualLight l;
                       l.type = LightType::kDirectional;
                       l.intensity = Rgb(3);
                       l.node = shot.node(Affine3d(look_at(Vec3f{0.6f, 0, 0.8f}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
                       shot.scene.lights = {l};
                     })));
  EXPECT_TRUE(PixelsEstimate(0.5 * 3 / kPiD / 4, plane([](TestShot& shot) {
                               PunctualLight l;
                               l.intensity = Rgb(3);
                               l.node = shot.node(translate(Vec3d{0, 0, 2}));
                               shot.scene.lights = {l};
                             })));
  EXPECT_TRUE(PixelsEstimate(0.5 * 0.7, plane([](TestShot& shot) {
                               Environment e;
                               e.radiance = Rgb(0.7f);
                               shot.scene.environments = {e};
                             })));
  // The same radiance as a picture: importance sampling and its density must agree.
  EXPECT_TRUE(PixelsEstimate(0.5 * 0.7, plane([](TestShot& shot) {
                               Environment e;
                               e.width = 16, e.height = 8;
                               e.image.assign(128, Rgb(0.7f));
                               shot.scene.environments = {e};
                             })));
  // Disk of radius r at height h, seen from below: irradiance pi L r^2 / (r^2 + h^2).
  const auto disk = [](bool as_sphere) {
    return [as_sphere](TestShot& shot) {
      if (as_sphere) {  // irradiance pi L (r / h)^2 for a sphere whose center is at height h
        Shape& s = shot.add(Sphere{Affine3f{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, 2}}}, make_black());
        s.emission = AreaEmission{Slot(2.0f), false};
      } else {
        Shape& s = shot.add(Disk{Affine3f{{1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {0, 0, 2}}}, make_black());
        s.emission = AreaEmission{Slot(2.0f), false};
      }
      shot.scene.nodes[0].local = Affine3d(look_at(Vec3f{0, 0, 0.5f}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}));
    };
  };
  EXPECT_TRUE(PixelsEstimate(0.5 * 2 / 5.0, plane(disk(false))));
  EXPECT_TRUE(PixelsEstimate(0.5 * 2 / 4.0, plane(disk(true))));
}

TEST(Path, ElongatedSphereLightIsSampledByItsArea) {
  TestShot shot;
  Mesh rectangle = make_rectangle();
  transform(rectangle, scale(Vec3d{100, 100, 1}));
  shot.add(rectangle, make_diffuse(0.5f));
  shot.orthographic(0.01f);
  shot.scene.nodes[0].local = Affine3d(look_at(Vec3f{0, 0, 0.5f}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}));
  Shape& light = shot.add(Sphere{Affine3f{{2, 0, 0}, {0, 1, 0}, {0, 0, 0.5f}, {0, 0, 2}}}, make_black());
  light.emission = AreaEmission{Slot(2.0f), false};
  shot.settings.spp = 256;
  const Image image = shot.render().layer("color");
  // Irradiance by numerical integration over directions: E = 2 int cos over the directions that hit.
  double irradiance = 0;
  const int n = 2000;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {  // cosine-weighted: uniform over the unit disk
      const double x = (i + 0.5) * 2 / n - 1, y = (j + 0.5) * 2 / n - 1, r2 = x * x + y * y;
      if (r2 >= 1) continue;
      const double z = std::sqrt(1 - r2);
      const Vec3d o{0, 0, -2 / 0.5}, d{x / 2, y, z / 0.5};  // in the ellipsoid's unit space
      const double a = dot(d, d), b = dot(o, d), c = dot(o, o) - 1;
      if (b < 0 && b * b >= a * c) irradiance += 2.0 * 4 / (double(n) * n);
    }
  }
  EXPECT_TRUE(PixelsEstimate(0.5 / kPiD * irradiance, image));
}

// An emitting card that crosses a pixel: the mean radiance is the time for which the card covers it, averaged over the
// pixel.
TEST(Path, MovingCardBlursAnalytically) {
  TestShot shot;
  shot.settings.width = 64, shot.settings.height = 4;
  shot.settings.clock.shutter = {.open = 0, .close = 0.5};
  shot.settings.spp = 4096;
  shot.settings.sampler = SamplerKind::kSobol;
  shot.orthographic(32);  // one unit a pixel
  Mesh card = make_rectangle();
  transform(card, scale(Vec3d{4, 40, 1}));  // 8 pixels wide
  // During the exposure of frame 0 the center runs from x = -5 to x = 5: 20 pixels a second.
  Shape& s = shot.add(card, make_black(), shot.node(moving({-45, 0, 0}, {35, 0, 0})));
  s.emission = AreaEmission{Slot(1.0f), true};
  const Image image = shot.render().layer("color");
  double total = 0;
  for (int x = 0; x < 64; ++x) {
    double expected = 0;
    const int n = 4000;
    for (int i = 0; i < n; ++i) {  // overlap of [x-32, x-31] with the card, averaged over the exposure
      const double c = -5 + 10 * (i + 0.5) / n;
      expected += std::max(0.0, std::min(c + 4, x - 31.0) - std::max(c - 4, x - 32.0)) / n;
    }
    double mean = 0;
    for (int y = 0; y < 4; ++y) mean += 0.25 * image.rgb(x, y).r;
    EXPECT_NEAR(mean, expected, 0.012) << x;  // 16384 samples of a 0 or 1: three standard errors are 0.0117
    total += mean;
  }
  EXPECT_NEAR(total, 8, 0.02);
}

// Many kinds of light at once: the probabilities of choosing them must be those that the weights use. One light at a
// time is the reference; a hidden light gives nothing.
TEST(Path, LightsAddUpHoweverTheyAreChosen) {
  const auto shot = [](int which) {  // -1: all
    TestShot s;
    Mesh floor = make_rectangle();
    transform(floor, scale(Vec3d{50, 50, 1}));
    s.add(floor, make_diffuse(0.5f));
    s.perspective(Affine3d(look_at(Vec3f{0, -6, 3}, Vec3f{0, 0, 0}, Vec3f{0, 0, 1})), 0.8f);
    const auto on = [&](int i) { return which < 0 || which == i; };
    const auto punctual = [&](LightType type, const Affine3d& pose, float intensity, float visible) {
      PunctualLight l;
      l.type = type;
      l.intensity = Rgb(intensity);
      l.node = s.node(pose);
      s.scene.nodes.back().visibility = visible;
      s.scene.lights.push_back(l);
    };
    if (on(0)) punctual(LightType::kPoint, translate(Vec3d{1, 1, 1}), 1, 1);
    if (on(1)) punctual(LightType::kDirectional, Affine3d(look_at(Vec3d{1, 0, 1}, Vec3d{}, Vec3d{0, 1, 0})), 0.3f, 1);
    if (on(2)) {
      Shape& ball = s.add(Sphere{Affine3f{{0.2f, 0, 0}, {0, 0.2f, 0}, {0, 0, 0.2f}, {-1, 0, 0.8f}}}, make_black());
      ball.emission = AreaEmission{Slot(3.0f), false};
    }
    if (on(3)) {
      Environment e;
      e.radiance = Rgb(0.1f);
      s.scene.environments = {e};
    }
    if (which < 0) punctual(LightType::kPoint, translate(Vec3d{0, 0, 1}), 100, 0);
    s.settings.spp = 256;
    const Image image = s.render().layer("color");
    double sum = 0;
    for (int y = 16; y < 32; ++y) {  // the floor, below everything that casts a shadow on it
      for (int x = 0; x < 32; ++x) sum += luminance(image.rgb(x, y)) / 512;
    }
    return sum;
  };
  double parts = 0;
  for (int i = 0; i < 4; ++i) parts += shot(i);
  // The ball shades the floor from the other lights only where it stands: a small part of the picture.
  EXPECT_NEAR(shot(-1) / parts, 1, 0.01);
}

TEST(Path, ThinLensBlursByTheCircleOfConfusion) {
  TestShot shot;
  shot.settings.width = 64, shot.settings.height = 64;
  shot.settings.spp = 1024;
  shot.settings.sampler = SamplerKind::kSobol;
  Camera& c = shot.perspective(Affine3d(look_at(Vec3f{0, 0, 0}, Vec3f{0, 0, 1}, Vec3f{0, 1, 0})), 2 * std::atan(1.0f));
  c.aperture_radius = 0.1f;
  c.focus_distance = 1;
  // A small bright disk at distance 2: in the plane of focus its image has radius 0.1 / 2 + r / 2.
  Shape& s = shot.add(Disk{Affine3f{{0.05f, 0, 0}, {0, 0.05f, 0}, {0, 0, -1}, {0, 0, 2}}}, make_black());
  s.emission = AreaEmission{Slot(1.0f), true};
  const Image image = shot.render().layer("color");
  const double pixels_per_unit = 32;  // at distance 1
  double total = 0, radius = 0;
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double v = image.rgb(x, y).r;
      total += v;
      if (v > 0) radius = std::max(radius, std::hypot(x + 0.5 - 32, y + 0.5 - 32));
    }
  }
  EXPECT_NEAR(radius, (0.05 + 0.025) * pixels_per_unit, 1.0);
  EXPECT_NEAR(total, kPiD * sqr(0.025 * pixels_per_unit), 0.08 * total);  // blur keeps the light
}

/// Shows the footprint that it is asked for: the lengths of duv_dx and duv_dy, and their dot product.
class FootprintProbe final : public Texture {
 public:
  Rgb rgb(const ShadingPoint& s) const override {
    return {length(s.duv_dx), length(s.duv_dy), std::abs(s.duv_dx.x * s.duv_dy.x + s.duv_dx.y * s.duv_dy.y)};
  }
  Rgb mean() const override { return Rgb(1.0f); }
};

// A card turned by 60 degrees about y fills twice as much of u in each pixel; samples divide the pixel among them.
TEST(Path, FootprintsOfATurnedCard) {
  TestShot shot;
  shot.orthographic(1);
  Mesh card;
  card.positions = {{-2, -2, 0}, {2, -2, 0}, {2, 2, 0}, {-2, 2, 0}};
  card.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  card.indices = {0, 1, 2, 0, 2, 3};
  const auto probe = std::make_shared<FootprintProbe>();
  shot.add(card, make_diffuse(Slot(probe)), shot.node(Affine3d(rotation(axis_angle(Vec3d{0, 1, 0}, kPiD / 3)))))
      .emission = AreaEmission{Slot(probe), true};
  shot.parameters = "max_depth=1";
  for (const int spp : {1, 16, 1024}) {
    shot.settings.spp = spp;
    const float pixel = 2.0f / 32 / 4 * std::max(0.125f, 1 / std::sqrt(float(spp)));  // in units of uv
    const Frame frame = shot.render();
    for (const auto& [x, y] : {std::pair{16, 16}, {5, 20}, {30, 3}}) {
      const Rgb c = frame.layer("color").rgb(x, y);
      EXPECT_NEAR(c.r, 2 * pixel, 1e-3f * pixel) << spp;
      EXPECT_NEAR(c.g, pixel, 1e-3f * pixel) << spp;
      EXPECT_NEAR(c.b, 0, 1e-3f * pixel * pixel) << spp;
    }
  }
}

TEST(Path, MotionVectorsOfAMovingCard) {
  TestShot shot;
  shot.settings.width = 64, shot.settings.height = 48;
  shot.settings.layers = {"motion.forward", "motion.backward", "object_id"};
  shot.orthographic(32);
  Mesh card = make_rectangle();
  transform(card, scale(Vec3d{20, 20, 1}));
  shot.add(card, make_diffuse(), shot.node(moving({-6, 4, 2}, {6, -4, -2})));  // (3, -2, -1) a frame
  const Frame frame = shot.render(0);
  int covered = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const float* f = frame.layer("motion.forward").pixel(x, y);
      const float* b = frame.layer("motion.backward").pixel(x, y);
      EXPECT_EQ(f[3], 1);
      if (frame.layer("object_id").at(x, y) == 0) continue;
      ++covered;
      EXPECT_NEAR(f[0], 3, 1e-4);
      EXPECT_NEAR(f[1], 2, 1e-4);  // down in the picture
      EXPECT_NEAR(f[2], 1, 1e-4);  // farther from the camera at z = 5
      EXPECT_NEAR(b[0], -3, 1e-4);
      EXPECT_NEAR(b[1], -2, 1e-4);
      EXPECT_NEAR(b[2], -1, 1e-4);
    }
  }
  EXPECT_EQ(covered, 1600);
}

TEST(Path, MotionVectorsOfARotatingCard) {
  TestShot shot;
  shot.settings.width = shot.settings.height = 64;
  shot.settings.layers = {"motion.forward"};
  shot.orthographic(32);
  Mesh card = make_rectangle();
  transform(card, scale(Vec3d{25, 25, 1}));
  AnimatedTransform turn;
  turn.keyed = true;
  const double rate = 0.3;  // radians a frame, counterclockwise
  turn.rotation = {
      {-2, 2}, {axis_angle(Vec3d{0, 0, 1}, -2 * rate), axis_angle(Vec3d{0, 0, 1}, 2 * rate)}, Interpolation::kLinear};
  shot.add(card, make_diffuse(), shot.node(turn));
  const Image motion = shot.render(0).layer("motion.forward");
  for (int y = 20; y < 44; ++y) {
    for (int x = 20; x < 44; ++x) {
      const double px = x + 0.5 - 32, py = 32 - (y + 0.5);
      EXPECT_NEAR(motion.at(x, y, 0), px * std::cos(rate) - py * std::sin(rate) - px, 2e-4);
      EXPECT_NEAR(motion.at(x, y, 1), -(px * std::sin(rate) + py * std::cos(rate) - py), 2e-4);
    }
  }
}

TEST(Path, MotionVectorsOfAZoomAndOfTheBackground) {
  TestShot shot;
  shot.settings.width = shot.settings.height = 64;
  shot.settings.layers = {"motion.forward"};
  Environment sky;
  shot.scene.environments = {sky};
  Camera& c = shot.perspective(Affine3d(look_at(Vec3f{0, 0, 0}, Vec3f{0, 0, 1}, Vec3f{0, 1, 0})), 1);
  const auto fov = [](double t) { return float(2 * std::atan(0.5 + 0.1 * t)); };
  c.fov_x = Animated<float>({-1, 0, 1}, {fov(-1), fov(0), fov(1)}, Interpolation::kLinear);
  const Image motion = shot.render(0).layer("motion.forward");
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {  // x' = x tan(0) / tan(1) about the center
      EXPECT_NEAR(motion.at(x, y, 0), (x + 0.5 - 32) * (0.5 / 0.6 - 1), 1e-4);
      EXPECT_NEAR(motion.at(x, y, 1), (y + 0.5 - 32) * (0.5 / 0.6 - 1), 1e-4);
      EXPECT_EQ(motion.at(x, y, 3), 1);
    }
  }
}

TEST(Path, MotionVectorsOfAStillSceneAreExactlyZero) {
  TestShot shot;
  shot.settings.layers = {"motion.forward", "motion.backward"};
  shot.add(make_cube(), make_diffuse());
  shot.perspective(Affine3d(look_at(Vec3f{3, 2, 4}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})), 0.8f);
  const Frame frame = shot.render(0);
  for (const char* name : {"motion.forward", "motion.backward"}) {
    const Image& m = frame.layer(name);
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        for (int c = 0; c < 3; ++c) EXPECT_EQ(m.at(x, y, c), 0) << name;
      }
    }
  }
}

/// Coated, glossy, diffuse and glass things under an area light: every event occurs.
TestShot mixed() {
  TestShot shot;
  PlasticParams plastic;
  shot.add(Sphere{Affine3f{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1.2f, 0, 0}}}, make_plastic(plastic));
  shot.add(Sphere{Affine3f{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1.2f, 0, 0}}}, make_dielectric({}));
  Mesh wall = make_rectangle();
  transform(wall, translate(Vec3d{0, 0, -2}) * scale(Vec3d{5, 5, 1}));
  shot.add(wall, make_diffuse(0.6f));
  Shape& s = shot.add(Disk{Affine3f{{1, 0, 0}, {0, 0, 1}, {0, -1, 0}, {0, 3, 0}}}, make_black());
  s.emission = AreaEmission{Slot(5.0f), true};
  shot.perspective(Affine3d(look_at(Vec3f{0, 0.5f, 6}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})), 0.8f);
  shot.settings.spp = 16;
  return shot;
}

TEST(Path, TilesAndThreadsDoNotChangeABit) {
  TestShot shot = mixed();
  shot.settings.layers = {"color",  "color.a", "color.var",      "albedo",
                          "normal", "depth",   "CryptoObject00", "motion.forward"};
  shot.settings.classes = {{"diffuse", "ED"}, {"glass", "ET.*"}};
  Frame reference;
  with_threads(1, [&] { reference = shot.render(); });
  for (const auto& [threads, tile] : {std::pair{2, 16}, {7, 5}, {3, 32}}) {
    shot.tile = tile;
    Frame other;
    with_threads(threads, [&] { other = shot.render(); });
    for (const Layer& layer : reference.layers())
      EXPECT_EQ(layer.image, other.layer(layer.desc.name)) << layer.desc.name;
  }
}

TEST(Path, ADecompositionAddsUpToTheBit) {
  TestShot shot = mixed();
  shot.settings.classes = {{"dd", "ED"}, {"di", "ED.+"}, {"refl", "ERD.*"}, {"trans", "ETTD.*"}};
  shot.settings.classes_are_decomposition = true;
  const Frame frame = shot.render();
  const Image& color = frame.layer("color");
  double part[5] = {};
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      Rgb sum;
      int k = 0;
      for (const char* name : {"dd", "di", "refl", "trans", "residual"}) {
        const Rgb c = frame.layer("class." + std::string(name) + ".color").rgb(x, y);
        sum += c;
        part[k++] += luminance(c);
      }
      EXPECT_EQ(sum, color.rgb(x, y));
    }
  }
  for (const double p : part) EXPECT_GT(p, 0);
}

TEST(Path, OneClassOfEverythingChangesNothing) {
  TestShot shot = mixed();
  const Frame plain = shot.render();
  shot.settings.classes = {{"all", "E.*"}};
  const Frame classed = shot.render();
  EXPECT_EQ(plain.layer("color"), classed.layer("color"));
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      EXPECT_EQ(classed.layer("class.all.color").rgb(x, y), plain.layer("color").rgb(x, y));
    }
  }
}

// Nothing is chosen at random for the classes: the picture is that without them, whatever they are.
TEST(Path, ClassesDoNotChangeThePicture) {
  TestShot shot = mixed();
  const Image plain = shot.render().layer("color");
  std::vector<PathClass> by_mirrors;
  for (int k = 0; k < 12; ++k)
    by_mirrors.push_back({"r" + std::to_string(k), "E([DT]*R){" + std::to_string(k) + "}[DT]*"});
  for (const std::vector<PathClass>& classes :
       {std::vector<PathClass>{{"dd", "ED"}, {"refl", "ERD.*"}, {"trans", "ETTD.*"}},
        {{"none", "EDRTDRTDRT"}},
        {{"long", "E.{3,}"}},
        by_mirrors}) {
    shot.settings.classes = classes;
    shot.settings.classes_are_decomposition = false;
    EXPECT_EQ(shot.render().layer("color"), plain);
    shot.settings.classes_are_decomposition = true;  // the picture is the sum of its parts
    const Image sum = shot.render().layer("color");
    for (std::size_t i = 0; i < plain.values().size(); ++i)
      EXPECT_NEAR(sum.values()[i], plain.values()[i], 2e-5f * (1 + std::abs(plain.values()[i])));
  }
}

// What a class has in the mean does not depend on the others that are asked for, with halves and variance of its own.
TEST(Path, HalvesOfClasses) {
  TestShot shot = mixed();
  shot.settings.classes = {{"dd", "ED"}, {"rest", "ED.+"}};
  shot.settings.layers = {"color.a", "color.b", "color.var"};
  shot.settings.classes_are_decomposition = true;
  const Frame frame = shot.render();
  for (const char* half : {"color.a", "color.b"}) {
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        Rgb sum;
        for (const char* name : {"dd", "rest", "residual"})
          sum += frame.layer("class." + std::string(name) + "." + half).rgb(x, y);
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], frame.layer(half).rgb(x, y)[c], 2e-5f * (1 + std::abs(sum[c])));
      }
    }
  }
  double variance = 0, difference = 0;
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      const Rgb d = frame.layer("class.dd.color.a").rgb(x, y) - frame.layer("class.dd.color.b").rgb(x, y);
      difference += luminance(d * d) / 4, variance += luminance(frame.layer("class.dd.color.var").rgb(x, y));
    }
  }
  EXPECT_NEAR(variance / difference, 1, 1e-3);
}

TEST(Path, MasksLetLightThrough) {
  // A card of opacity 0.3 in front of an emitting wall, and in front of the light that shines on a plane.
  TestShot shot;
  shot.orthographic(0.5f);
  Mesh near_card = make_rectangle(), wall = make_rectangle();
  transform(near_card, translate(Vec3d{0, 0, 1}) * scale(Vec3d{5, 5, 1}));
  transform(wall, scale(Vec3d{5, 5, 1}));
  shot.add(near_card, make_mask(0.3f, make_black()));
  Shape& s = shot.add(wall, make_black());
  s.emission = AreaEmission{Slot(1.0f), false};
  EXPECT_TRUE(PixelsEstimate(0.7, shot.render().layer("color")));

  TestShot lit;
  lit.orthographic(0.01f);
  lit.scene.nodes[0].local = Affine3d(look_at(Vec3f{0, 0, 0.5f}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}));
  lit.add(wall, make_diffuse(0.5f));
  Mesh shade = make_rectangle();
  transform(shade, translate(Vec3d{0, 0, 1}) * scale(Vec3d{50, 50, 1}));
  lit.add(shade, make_mask(0.25f, make_black()));
  PunctualLight l;
  l.intensity = Rgb(3);
  l.node = lit.node(translate(Vec3d{0, 0, 2}));
  lit.scene.lights = {l};
  EXPECT_TRUE(PixelsEstimate(0.75 * 0.5 * 3 / kPiD / 4, lit.render().layer("color")));
}

// A sphere light over a plane, straight in front of the camera, which looks through it; a mirror shows it. The same for
// the disk of a sun.
TEST(Path, SizedLightsAreSeenByMirrorsAndNotByTheCamera) {
  const auto plane = [](const MaterialPtr& material, LightType type, bool visible) {
    TestShot shot;
    Mesh rectangle = make_rectangle();
    transform(rectangle, scale(Vec3d{100, 100, 1}));
    shot.add(rectangle, material);
    shot.orthographic(0.01f);
    PunctualLight l;
    l.type = type;
    l.intensity = Rgb(3);
    l.angle = 0.4f;
    l.camera_visible = visible;
    l.node = shot.node(Affine3d(look_at(Vec3f{0, 0, 2}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
    shot.scene.lights = {l};
    if (type == LightType::kPoint) make_sphere_light(shot.scene, 0, 0.5f, visible);
    shot.settings.width = shot.settings.height = 8;
    shot.settings.layers = {"color", "depth", "object_id"};
    return shot.render();
  };
  const MaterialPtr diffuse = make_diffuse(0.5f), mirror = make_conductor({});
  const double sphere = 3 / (kPiD * 0.25), sun = 3 / (kPiD * std::pow(std::sin(0.2), 2));
  const Frame through = plane(diffuse, LightType::kPoint, false);
  EXPECT_TRUE(PixelsEstimate(0.5 * 3 / kPiD / 4, through.layer("color")));
  EXPECT_NEAR(through.layer("depth").at(3, 4), 5, 1e-4);
  EXPECT_EQ(through.layer("object_id").at(3, 4), 1);
  EXPECT_TRUE(PixelsEstimate(sphere, plane(mirror, LightType::kPoint, false).layer("color")));
  const Frame seen = plane(diffuse, LightType::kPoint, true);
  EXPECT_TRUE(PixelsEstimate(sphere, seen.layer("color")));
  EXPECT_NEAR(seen.layer("depth").at(3, 4), 2.5, 1e-3);
  EXPECT_EQ(seen.layer("object_id").at(3, 4), 2);
  EXPECT_TRUE(PixelsEstimate(0.5 * 3 / kPiD, plane(diffuse, LightType::kDirectional, false).layer("color")));
  EXPECT_TRUE(PixelsEstimate(sun, plane(mirror, LightType::kDirectional, false).layer("color")));
}

TEST(Path, VarianceLayerPredictsTheSpread) {
  for (const SamplerKind sampler : {SamplerKind::kSobol, SamplerKind::kIndependent}) {
    TestShot shot = furnace(0.5f, 0.5f);
    shot.settings.layers = {"color", "color.a", "color.b", "color.var"};
    shot.settings.sampler = sampler;
    shot.settings.spp = 32;
    double predicted = 0, seen = 0;
    for (int seed = 0; seed < 8; ++seed) {
      shot.settings.seed = std::uint64_t(seed);
      const Frame frame = shot.render();
      for (int y = 0; y < 16; ++y) {
        for (int x = 0; x < 16; ++x) {
          predicted += frame.layer("color.var").rgb(x, y).g;
          seen += sqr(frame.layer("color").rgb(x, y).g - 1);
          const Rgb halves = (frame.layer("color.a").rgb(x, y) + frame.layer("color.b").rgb(x, y)) * 0.5f;
          EXPECT_NEAR(halves.r, frame.layer("color").rgb(x, y).r, 1e-5);
        }
      }
    }
    // Of 2048 squares each: relative errors sqrt(2 / 2048) and tails.
    EXPECT_NEAR(predicted / seen, 1, 0.15) << int(sampler);
  }
}

TEST(Path, AdaptiveSamplingSpendsWhereItIsNoisy) {
  TestShot shot = mixed();
  shot.settings.spp = 1024;
  shot.settings.layers = {"samples"};
  shot.parameters = "adaptive_error=0.05,adaptive_min_spp=16";
  const Image samples = shot.render().layer("samples");
  float least = kInfinity, most = 0;
  for (const float n : samples.values()) least = std::min(least, n), most = std::max(most, n);
  EXPECT_EQ(least, 16);
  EXPECT_GT(most, 100);
}

TEST(Path, ClampIsOffByDefaultAndBounds) {
  TestShot shot = furnace(0.5f, 0.5f);
  shot.parameters = "clamp=0.01";
  const Image image = shot.render().layer("color");
  for (int y = 0; y < 16; ++y) EXPECT_LT(image.rgb(3, y).r, 0.5f + 0.01f * 64);
  EXPECT_LT(image.rgb(8, 8).r, 0.9f);
}

TEST(Path, UnknownLayersAreNamed) {
  TestShot shot = mixed();
  shot.settings.layers = {"grad.x"};
  Params params(find_method("path").params);
  const auto integrator = find_method("path").make(params);
  try {
    integrator->outputs(shot.settings);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
    EXPECT_NE(std::string(e.what()).find("grad.x"), std::string::npos);
  }
}

/// A coarse ball of `material` in a white world; radiance of the pixels that it covers wholly.
std::vector<float> seen_of_coarse_ball(MaterialPtr material, bool bend) {
  TestShot shot;
  // Seen so that some facets are in view whose corners' normals are not.
  const Basis view(normalize(Vec3f{0.75f, 0.6f, -0.3f}));
  const Affine3d turn{
      {view.s.x, view.t.x, view.n.x}, {view.s.y, view.t.y, view.n.y}, {view.s.z, view.t.z, view.n.z}, {}};
  shot.add(coarse_ball(), std::move(material), shot.node(turn));
  Environment sky;
  sky.radiance = Rgb(1.0f);
  sky.camera_visible = false;
  shot.scene.environments.push_back(sky);
  shot.orthographic(1.0f);
  shot.scene.bend_normals = bend;
  shot.settings.spp = 256;
  const Frame frame = shot.render();
  const Image& color = frame.layer("color");
  std::vector<float> seen;
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x)
      if (color.at(x, y, 3) == 1) seen.push_back(color.rgb(x, y).g);
  return seen;
}

TEST(Path, BentNormalsLeaveNoBlackPatches) {
  MetallicRoughnessParams paint;
  paint.metallic = 0.0f, paint.roughness = 0.4f;
  const MaterialPtr two_sided = make_metallic_roughness(paint);  // seen from inside instead of black
  for (const MaterialPtr& m : {make_diffuse(0.8f), make_plastic({}), two_sided}) {
    const std::vector<float> plain = seen_of_coarse_ball(m, false), bent = seen_of_coarse_ball(m, true);
    ASSERT_GT(bent.size(), 300u);
    if (m != two_sided) {
      EXPECT_LT(*std::min_element(plain.begin(), plain.end()), 0.02f) << "without, there are";
    }
    EXPECT_GT(*std::min_element(bent.begin(), bent.end()), 0.15f);
    EXPECT_LT(*std::max_element(bent.begin(), bent.end()), 1.05f) << "nothing gains light";
  }
  // A mirror shows the world everywhere: nothing of what it reflects is its own inside.
  for (const float v : seen_of_coarse_ball(make_conductor({}), true)) EXPECT_NEAR(v, 1, 1e-3f);
  // Glass is as it was.
  const std::vector<float> bent = seen_of_coarse_ball(make_dielectric({}), true),
                           plain = seen_of_coarse_ball(make_dielectric({}), false);
  const auto mean = [](const std::vector<float>& v) {
    return std::accumulate(v.begin(), v.end(), 0.0) / double(v.size());
  };
  EXPECT_NEAR(mean(bent), mean(plain), 3e-3);
}

TEST(Path, BentNormalsChangeNothingWhereNormalsFit) {
  TestShot shot = mixed();
  const Frame plain = shot.render();
  shot.scene.bend_normals = true;
  EXPECT_EQ(plain.layer("color"), shot.render().layer("color"));
}

TEST(Path, AlbedoLayerOfClearGlassIsOne) {
  MetallicRoughnessParams solid;
  solid.transmission = 1.0f, solid.metallic = 0.0f, solid.roughness = 0.0f, solid.thin_walled = false;
  for (const MaterialPtr& m :
       {make_dielectric({}), make_dielectric({1.5f, 1, 1.0f, 1.0f, true, {}}), make_metallic_roughness(solid)}) {
    TestShot shot;
    shot.add(quad({0, 0, 0}, {1, 0, 0}, {0, 1, 0}), m);
    shot.orthographic(0.5f);
    shot.scene.environments.push_back({});
    shot.settings.spp = 4;
    for (const bool alone : {true, false}) {
      shot.settings.layers = {"color", "albedo"};
      if (!alone) shot.settings.layers.push_back("normal");
      EXPECT_NEAR(shot.render().layer("albedo").rgb(7, 9).g, 1, 1e-5f);
    }
  }
}

}  // namespace
}  // namespace tempera
