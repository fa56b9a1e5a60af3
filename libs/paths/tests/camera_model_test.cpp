// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/camera_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "statistics.h"
#include "support/effort.h"
#include "tempera/core/error.h"
#include "tempera/core/random.h"
#include "tempera/paths/pixel_filter.h"

namespace tempera {
namespace {

constexpr int kWidth = 320, kHeight = 180;
constexpr double kStep = 1.0 / 96;

float random1(std::uint64_t i, std::uint64_t j) { return to_unit_float(std::uint32_t(hash_key(i, j, 99))); }

Scene scene_with(Camera camera, const AnimatedTransform& transform) {
  Scene scene;
  Node node;
  node.local = transform;
  scene.nodes.push_back(node);
  camera.name = "shot cam";
  camera.node = 0;
  scene.cameras.push_back(camera);
  return scene;
}

CameraModel model(const Scene& scene, TimeSpan span = {0, 1}) { return {scene, 0, kWidth, kHeight, span, kStep}; }

Affine3d mitsuba_pose() { return look_at<double>({1, 2, 3}, {-2, 1, -1}, {0.1, 1, 0}); }

/// A ray of one of Mitsuba 3.9's sensors (scalar_rgb), whose origin lies on the near plane.
struct MitsubaRay {
  Vec2f pixel;
  Vec3f o, d;
  float length;
};
void expect_rays(const Camera& camera, const Affine3d& pose, const Vec2f& lens,
                 const std::vector<MitsubaRay>& expected) {
  const Scene scene = scene_with(camera, pose);
  const CameraModel m = model(scene);
  for (const MitsubaRay& e : expected) {
    const CameraRay r = m.ray(e.pixel, lens, 0.25);
    const Vec3f o = r.o + r.d * r.tmin;
    EXPECT_LT(length(o - e.o), 2e-6f) << e.pixel.x << " " << e.pixel.y << ": " << o.x << " " << o.y << " " << o.z;
    EXPECT_LT(length(r.d - e.d), 1e-6f) << e.pixel.x << " " << e.pixel.y << ": " << r.d.x << " " << r.d.y << " "
                                        << r.d.z;
    EXPECT_NEAR(r.tmax - r.tmin, e.length, 1e-5f * e.length);
  }
}

TEST(CameraModel, PerspectiveRaysAreMitsubas) {
  Camera c;
  c.fov_x = float(50 * kPiD / 180);
  c.near_clip = 0.1f, c.far_clip = 100;
  expect_rays(
      c, mitsuba_pose(), {0.5f, 0.5f},
      {{{0, 0}, {0.9021864f, 2.009784f, 2.943439f}, {-0.86245733f, 0.086273827f, -0.49872237f}, 113.299255f},
       {{160, 90}, {0.9411651f, 1.980388f, 2.921554f}, {-0.58834845f, -0.19611607f, -0.78446454f}, 99.9000015f},
       {{320, 0}, {0.9774457f, 2.002259f, 2.888876f}, {-0.19886965f, 0.019915069f, -0.97982353f}, 113.29924f},
       {{250.25f, 30.5f}, {0.9614987f, 1.995212f, 2.902597f}, {-0.36722016f, -0.045665048f, -0.92901242f}, 104.74044f},
       {{7, 179}, {0.906516f, 1.958638f, 2.952978f}, {-0.83080918f, -0.36758831f, -0.41789314f}, 112.409149f}});
  // Mitsuba's principal_point_offset (0.1, -0.2) moves the window over the scene, which moves the picture the other
  // way.
  c.principal_offset = {-0.1f, 0.2f};
  expect_rays(c, mitsuba_pose(), {0.5f, 0.5f},
              {{{0, 0}, {0.9091727f, 2.019285f, 2.935824f}, {-0.80469197f, 0.1708591f, -0.56857532f}, 112.759277f},
               {{160, 90}, {0.9481514f, 1.989889f, 2.913939f}, {-0.51345134f, -0.1001275f, -0.85225707f}, 100.879502f},
               {{320, 0}, {0.9844319f, 2.011759f, 2.881261f}, {-0.12937638f, 0.097724266f, -0.98676831f}, 120.211136f},
               {{7, 179}, {0.9135022f, 1.968139f, 2.945363f}, {-0.80722159f, -0.29733554f, -0.5098871f}, 107.047775f}});
}

TEST(CameraModel, VerticalFieldOfViewAndMirroredRaysAreMitsubas) {
  Camera c;  // fov_axis y: 50 degrees vertically
  c.keep_vertical_fov = true;
  c.authored_aspect = 2;
  c.fov_x = float(2 * std::atan(2 * std::tan(25 * kPiD / 180)));
  c.near_clip = 0.1f, c.far_clip = 1e4f;
  expect_rays(c, mitsuba_pose(), {0.5f, 0.5f},
              {{{0, 0}, {0.8718696f, 2.032648f, 2.96046f}, {-0.92841536f, 0.23656462f, -0.28649965f}, 13800.838f},
               {{320, 0}, {1.005664f, 2.019269f, 2.863459f}, {0.041039407f, 0.13961913f, -0.98935443f}, 13800.838f},
               {{7, 179}, {0.8795666f, 1.941722f, 2.977419f}, {-0.88759452f, -0.42951146f, -0.1664207f}, 13568.3838f}});
  Camera mirrored;
  mirrored.fov_x = float(50 * kPiD / 180);
  mirrored.near_clip = 0.1f, mirrored.far_clip = 1e4f;
  expect_rays(mirrored, mitsuba_pose() * scale<double>({-1, 1, 1}), {0.5f, 0.5f},
              {{{0, 0}, {0.9774457f, 2.002259f, 2.888875f}, {-0.19886953f, 0.01991505f, -0.97982359f}, 11341.1533f},
               {{250.25f, 30.5f},
                {0.9190478f, 1.999457f, 2.933374f},
                {-0.77211112f, -0.0051759542f, -0.63546646f},
                10484.4238f},
               {{7, 179}, {0.9784826f, 1.951442f, 2.900802f}, {-0.19122876f, -0.43154636f, -0.881589f}, 11252.0547f}});
}

TEST(CameraModel, OrthographicRaysAreMitsubas) {
  Camera c;
  c.projection = Projection::kOrthographic;
  c.width = 2;  // Mitsuba's picture covers [-1, 1] before its transform, which may scale
  c.near_clip = 0.1f, c.far_clip = 50;
  const Vec3f axis{-0.58834839f, -0.19611613f, -0.78446454f};
  expect_rays(c, mitsuba_pose() * scale<double>({2.5, 2.5, 1}), {0.5f, 0.5f},
              {{{0, 0}, {-1.148589f, 3.556395f, 4.094868f}, axis, 49.9f},
               {{160, 90}, {0.9411649f, 1.980389f, 2.921554f}, axis, 49.9f},
               {{320, 0}, {2.88626f, 3.15291f, 1.169602f}, axis, 49.9f},
               {{7, 179}, {-0.9164715f, 0.8143107f, 4.606301f}, axis, 49.9f}});
}

TEST(CameraModel, ThinLensRaysAreMitsubas) {
  Camera c;
  c.fov_x = float(35 * kPiD / 180);
  c.aperture_radius = 0.25f;
  c.focus_distance = 4.5f;
  c.near_clip = 0.1f, c.far_clip = 100;
  expect_rays(
      c, mitsuba_pose(), {0.8f, 0.3f},
      {{{0, 0}, {0.8160822f, 1.938849f, 3.025751f}, {-0.78388411f, 0.015694451f, -0.62070864f}, 105.709473f},
       {{160, 90}, {0.8424381f, 1.918973f, 3.010953f}, {-0.56559628f, -0.18205692f, -0.80433577f}, 99.9554825f},
       {{320, 0}, {0.8669695f, 1.933761f, 2.988857f}, {-0.29816815f, -0.031882074f, -0.9539808f}, 107.414337f},
       {{7, 179}, {0.8190097f, 1.904266f, 3.032201f}, {-0.76312137f, -0.31397021f, -0.56486148f}, 104.753258f}});
  expect_rays(
      c, mitsuba_pose(), {0.1f, 0.95f},
      {{{0, 0}, {1.020257f, 2.15355f, 2.818944f}, {-0.82031232f, -0.030146524f, -0.57112074f}, 106.666306f},
       {{160, 90}, {1.046613f, 2.133673f, 2.804147f}, {-0.61154991f, -0.23066542f, -0.75683564f}, 100.024796f}});
}

/// Everything about the camera moves: pose, scale, picture and lens, under a turning parent.
Scene restless_scene(Projection projection, float aperture) {
  Scene scene;
  Node parent;
  parent.local.keyed = true;
  parent.local.rotation =
      Animated<Quatd>({0, 1}, {Quatd{}, axis_angle<double>({0, 1, 0}, 1.2)}, Interpolation::kLinear);
  Node node;
  node.parent = 0;
  node.local.keyed = true;
  node.local.translation =
      Animated<Vec3d>({-0.2, 0.4, 1.3}, {{0.5, 1, -2}, {1, 0.7, -1}, {-0.3, 1.5, 0}}, Interpolation::kLinear);
  node.local.rotation = Animated<Quatd>(
      {0, 0.6, 1},
      {axis_angle<double>({1, 0, 0}, -0.7), axis_angle<double>({0.6, 0, 0.8}, 0.4), axis_angle<double>({0, 0, 1}, 1.0)},
      Interpolation::kLinear);
  node.local.scale = Animated<Vec3d>({0, 1}, {{1, 1, 1}, {1.5, 1.2, 2}}, Interpolation::kLinear);
  scene.nodes = {parent, node};
  Camera c;
  c.name = "restless";
  c.node = 1;
  c.projection = projection;
  c.fov_x = Animated<float>({0, 1}, {0.5f, 1.4f}, Interpolation::kLinear);
  c.width = Animated<float>({0, 1}, {1.5f, 4.0f}, Interpolation::kLinear);
  c.aperture_radius =
      aperture > 0 ? Animated<float>({0, 1}, {aperture, 2 * aperture}, Interpolation::kLinear) : Animated<float>(0.0f);
  c.focus_distance = Animated<float>({0, 1}, {2.0f, 5.0f}, Interpolation::kLinear);
  c.principal_offset = {0.05f, -0.125f};
  scene.cameras.push_back(c);
  return scene;
}

TEST(CameraModel, ProjectionInvertsRays) {
  for (const Projection projection : {Projection::kPerspective, Projection::kOrthographic}) {
    for (const float aperture : {0.0f, 0.3f}) {
      const Scene scene = restless_scene(projection, aperture);
      const CameraModel m = model(scene);
      const bool lens = aperture > 0;
      std::vector<double> errors;
      for (std::uint64_t i = 0; i < 5000; ++i) {
        const double t = random1(i, 0);
        const Vec2f pixel{random1(i, 1) * kWidth, random1(i, 2) * kHeight};
        const CameraRay r = m.ray(pixel, {random1(i, 3), random1(i, 4)}, t);
        ASSERT_NEAR(length(r.d), 1, 1e-6);
        // Rays through a lens pass through the pixel's point in focus; all others through the pixel at any depth.
        const Vec3f axis = m.axis(t), eye = m.position(t);
        const float depth = lens ? scene.cameras[0].focus_distance.at(t) : 0.5f + 8 * random1(i, 5);
        const Vec3f p = r.o + r.d * ((depth - dot(r.o - eye, axis)) / dot(r.d, axis));
        const auto q = m.project(p, t);
        ASSERT_TRUE(q);
        errors.push_back(std::hypot(double(q->pixel.x) - pixel.x, double(q->pixel.y) - pixel.y));
        EXPECT_NEAR(q->depth, depth, 2e-6 * (1 + depth));
      }
      std::sort(errors.begin(), errors.end());
      // What remains is the rounding of `p`, largest beside the camera.
      EXPECT_LT(errors[errors.size() * 99 / 100], 1e-4);
      EXPECT_LT(errors.back(), 4e-4);
    }
  }
}

// The importance of the point where a camera ray ends knows that ray, and how densely rays arrive there: neighbouring
// pixels are a known area apart. Exactly the measure of a light image.
TEST(Importance, KnowsTheRayThatArrivesAndTheAreaOfAPixel) {
  for (const Projection projection : {Projection::kPerspective, Projection::kOrthographic}) {
    for (const float aperture : {0.0f, 0.3f}) {
      Scene scene = restless_scene(projection, aperture);
      scene.cameras[0].pixel_aspect = 1.5f;
      const CameraModel m = model(scene);
      std::vector<double> pixel_errors, area_errors;
      for (std::uint64_t i = 0; i < 3000; ++i) {
        const double t = random1(i, 0);
        const Vec2f pixel{random1(i, 1) * kWidth, random1(i, 2) * kHeight}, lens{random1(i, 3), random1(i, 4)};
        const float depth = 0.5f + 8 * random1(i, 5);
        const auto at_depth = [&](const Vec2f& film) {
          const CameraRay r = m.ray(film, lens, t);
          return Vec3d(r.o) +
                 Vec3d(r.d) * (double(depth - dot(r.o - m.position(t), m.axis(t))) / double(dot(r.d, m.axis(t))));
        };
        const CameraRay r = m.ray(pixel, lens, t);
        const Vec3f p(at_depth(pixel));
        const auto seen = m.importance(p, lens, t);
        ASSERT_TRUE(seen);
        pixel_errors.push_back(std::hypot(double(seen->pixel.x - pixel.x), double(seen->pixel.y - pixel.y)));
        EXPECT_LT(length(seen->ray.d - r.d), 2e-5f);
        EXPECT_LT(length(seen->ray.o + seen->ray.d * seen->distance - p), 2e-5f);
        EXPECT_LT(length(seen->ray.o - r.o), 2e-5f);
        EXPECT_NEAR(seen->ray.tmin, r.tmin, 1e-4f * r.tmin);
        EXPECT_NEAR(seen->ray.tmax, r.tmax, 1e-4f * r.tmax);
        // Planes of one depth are seen without distortion, so any step will do.
        const Vec3d dx = (at_depth(pixel + Vec2f{50, 0}) - at_depth(pixel - Vec2f{50, 0})) / 100.0;
        const Vec3d dy = (at_depth(pixel + Vec2f{0, 50}) - at_depth(pixel - Vec2f{0, 50})) / 100.0;
        const double facing = std::abs(dot(cross(dx, dy), Vec3d(r.d)));
        area_errors.push_back(std::abs(double(seen->we) * facing - 1));
      }
      std::sort(pixel_errors.begin(), pixel_errors.end());
      std::sort(area_errors.begin(), area_errors.end());
      EXPECT_LT(pixel_errors[pixel_errors.size() * 99 / 100], 3e-4);
      EXPECT_LT(pixel_errors.back(), 3e-3);
      EXPECT_LT(area_errors[area_errors.size() * 99 / 100], 2e-5);
      EXPECT_LT(area_errors.back(), 2e-4);
    }
  }
}

// A pinhole's classic importance: distance^2 / (cos^3 x area of the film at distance 1) per solid angle.
TEST(Importance, OfAPinholeIsTheClassicOne) {
  Camera c;
  c.fov_x = float(kPiD / 2);  // the picture is 2 wide at distance 1
  const Scene scene = scene_with(c, Affine3d{});
  const CameraModel m = model(scene);
  const Vec3f p{0.6f, -0.3f, 2};
  const auto seen = m.importance(p, {0.2f, 0.9f}, 0);
  ASSERT_TRUE(seen);
  const double d = double(length(p)), cosine = 2 / d, pixels_per_area = kWidth * kWidth / 4.0;
  EXPECT_NEAR(seen->distance, d, 1e-6);
  EXPECT_NEAR(seen->we, pixels_per_area / (cosine * cosine * cosine * d * d), 1e-5 * double(seen->we));
  EXPECT_EQ(seen->ray.o, (Vec3f{0, 0, 0}));
}

TEST(Importance, EndsAtTheClippingPlanes) {
  for (const Projection projection : {Projection::kPerspective, Projection::kOrthographic}) {
    for (const float aperture : {0.0f, 0.2f}) {
      Camera c;
      c.projection = projection;
      c.aperture_radius = aperture;
      c.near_clip = 0.5f, c.far_clip = 4;
      const Scene scene = scene_with(c, Affine3d{});
      const CameraModel m = model(scene);
      const auto sees = [&](float z) { return m.importance({0.01f, 0.02f, z}, {0.3f, 0.6f}, 0).has_value(); };
      EXPECT_FALSE(sees(-1));
      EXPECT_FALSE(sees(0));
      EXPECT_FALSE(sees(0.49f));
      EXPECT_TRUE(sees(0.51f));
      EXPECT_TRUE(sees(3.99f));
      EXPECT_FALSE(sees(4.01f));
      EXPECT_FALSE(m.importance({1e5f, 0, 1}, {0.5f, 0.5f}, 0)) << "beyond all reach of the film";
    }
  }
}

/// A square of 2 x 2 m whose radiance is a function of place, in front of the camera, and its two pictures.
struct Panel {
  Vec3d center, x, y;  ///< world; the sides are 2 x and 2 y
  double radiance(double u, double v) const { return 1 + 0.8 * std::sin(3 * u) * std::cos(2 * v + 1); }
  Vec3d normal() const { return normalize(cross(x, y)); }
};

// A light image is the camera's image: the pixels of a bright panel from camera rays, and from points of the panel with
// their importance, for every camera, filter and shutter.
TEST(Importance, OfSurfacePointsMakesTheImageOfRays) {
  struct View {
    const char* name;
    Projection projection = Projection::kPerspective;
    float aperture = 0, pixel_aspect = 1;
    Vec2f offset{};
    bool moves = false;
    FilterKind filter = FilterKind::kBox;
    double rolling = 0;
  };
  const View views[] = {{.name = "pinhole"},
                        {.name = "lens", .aperture = 0.2f, .filter = FilterKind::kTent},
                        {.name = "orthographic", .projection = Projection::kOrthographic},
                        {.name = "orthographic lens",
                         .projection = Projection::kOrthographic,
                         .aperture = 0.2f,
                         .filter = FilterKind::kMitchell},
                        {.name = "shifted", .offset = {0.2f, -0.1f}, .filter = FilterKind::kMitchell},
                        {.name = "wide pixels", .pixel_aspect = 1.7f, .filter = FilterKind::kGaussian},
                        {.name = "moving", .aperture = 0.1f, .moves = true},
                        {.name = "rolling", .moves = true, .filter = FilterKind::kBlackmanHarris, .rolling = 0.6},
                        {.name = "rolling upwards", .moves = true, .rolling = -0.6}};
  constexpr int kX = 8, kY = 6;
  for (const View& view : views) {
    SCOPED_TRACE(view.name);
    Camera c;
    c.projection = view.projection;
    c.fov_x = 0.9f;
    c.width = 2.5f;
    c.aperture_radius = view.aperture;
    c.focus_distance = 2;
    c.pixel_aspect = view.pixel_aspect;
    c.principal_offset = view.offset;
    AnimatedTransform pose = mitsuba_pose();
    if (view.moves) {
      pose = {};
      pose.keyed = true;
      pose.translation = {{0, 1}, {Vec3d{1, 2, 3}, Vec3d{1.5, 2.2, 2}}, Interpolation::kLinear};
      pose.rotation = {
          {0, 1},
          {quaternion(mitsuba_pose()), quaternion(mitsuba_pose() * rotation(axis_angle<double>({0, 1, 0}, 0.4)))},
          Interpolation::kLinear};
    }
    const Scene scene = scene_with(c, pose);
    const CameraModel m(scene, 0, kX, kY, {0, 1}, kStep);
    const Affine3d eye = mitsuba_pose();
    const Panel panel{eye.translation + eye.z * 3.0 + eye.x * 0.2, eye.x + eye.z * 0.4, eye.y - eye.z * 0.3};
    const PixelFilter filter(view.filter);
    FrameClock clock{.fps = 2, .first = 0, .start = 0, .shutter = {}};
    clock.shutter.shape = ShutterShape::kTrapezoid;
    clock.shutter.close = 0.8;
    clock.shutter.rolling = view.rolling;
    const TimeSpan open = clock.exposure(0);

    const int n = 4000 * test::effort();
    const Vec3d normal = panel.normal();
    const double area = 4 * length(cross(panel.x, panel.y));
    std::vector<double> light_image(kX * kY), light_squares(kX * kY);
    const int points = n * kX * kY / 4;
    for (int i = 0; i < points; ++i) {
      const auto k = std::uint64_t(i);
      const double u = 2.0 * double(random1(k, 11)) - 1, v = 2.0 * double(random1(k, 12)) - 1;
      const Vec3f p(panel.center + panel.x * u + panel.y * v);
      const double t = open.begin + open.length() * double(random1(k, 13));
      const auto seen = m.importance(p, {random1(k, 14), random1(k, 15)}, t);
      if (!seen) continue;
      const double weight =
          clock.exposure_density(0, t, std::clamp(double(seen->pixel.y) / kY, 0.0, 1.0)) * open.length();
      const double value =
          weight * panel.radiance(u, v) * area * std::abs(dot(Vec3d(seen->ray.d), normal)) * double(seen->we);
      for (int y = 0; y < kY; ++y) {
        for (int x = 0; x < kX; ++x) {
          const double add =
              value * double(filter.density({seen->pixel.x - float(x) - 0.5f, seen->pixel.y - float(y) - 0.5f}));
          light_image[y * kX + x] += add / points;
          light_squares[y * kX + x] += add * add / points;
        }
      }
    }
    int bright = 0;
    double chi2 = 0;
    for (int y = 0; y < kY; ++y) {
      for (int x = 0; x < kX; ++x) {
        double mean = 0, squares = 0;
        for (int i = 0; i < n; ++i) {
          const auto k = std::uint64_t((y * kX + x) * n + i);
          const auto s = filter.sample({random1(k, 1), random1(k, 2)});
          const Vec2f film{float(x) + 0.5f + s.offset.x, float(y) + 0.5f + s.offset.y};
          const double t = clock.exposure_time(0, double(random1(k, 3)), std::clamp(double(film.y) / kY, 0.0, 1.0));
          const CameraRay r = m.ray(film, {random1(k, 4), random1(k, 5)}, t);
          const Vec3d o(r.o), d(r.d);
          const Vec3d hit = o + d * (dot(panel.center - o, normal) / dot(d, normal)) - panel.center;
          const Vec3d local = inverse(Affine3d{panel.x, panel.y, normal}).vector(hit);
          if (std::abs(local.x) > 1 || std::abs(local.y) > 1) continue;
          const double value = double(s.weight) * panel.radiance(local.x, local.y);
          mean += value / n, squares += value * value / n;
        }
        const auto i = std::size_t(y * kX + x);
        const double variance =
            (squares - mean * mean) / n + (light_squares[i] - light_image[i] * light_image[i]) / points;
        // Few samples tell little about the foot of a filter: 1e-4 is dark.
        const double z = (light_image[i] - mean) / std::sqrt(variance + 1e-8);
        EXPECT_LT(std::abs(z), 4.6) << "pixel " << x << " " << y << ": " << light_image[i] << " instead of " << mean;
        chi2 += z * z;
        bright += mean > 0.1;
        if (mean > 0.5) {
          EXPECT_LT(std::sqrt(variance), 0.06 * mean) << "would not notice a quarter";
        }
      }
    }
    EXPECT_GT(bright, kX * kY / 3);
    EXPECT_GT(test::chi_square_tail(chi2, kX * kY), 1e-4);
  }
}

TEST(CameraModel, FilmCornersAndAxesOfAPlainCamera) {
  Camera c;
  c.fov_x = float(kPiD / 2);  // the picture is 2 wide at distance 1
  const Scene scene = scene_with(c, Affine3d{});
  const CameraModel m = model(scene);
  EXPECT_EQ(m.axis(0), (Vec3f{0, 0, 1}));
  EXPECT_EQ(m.position(0), (Vec3f{0, 0, 0}));
  const float top = float(kHeight) / kWidth;
  const auto expect_at = [&](const Vec3f& p, float x, float y) {
    const auto q = m.project(p, 0);
    ASSERT_TRUE(q);
    EXPECT_NEAR(q->pixel.x, x, 1e-4);
    EXPECT_NEAR(q->pixel.y, y, 1e-4);
    EXPECT_EQ(q->depth, p.z);
    const auto far = m.project_direction(p, 0);
    ASSERT_TRUE(far);
    EXPECT_EQ(far->x, q->pixel.x);
    EXPECT_EQ(far->y, q->pixel.y);
  };
  expect_at({1, top, 1}, 0, 0);  // +x is left, +y up
  expect_at({-1, -top, 1}, kWidth, kHeight);
  expect_at({0, 0, 7}, kWidth / 2, kHeight / 2);
  expect_at({0, -2 * top, 4}, kWidth / 2, 0.75f * kHeight);
  EXPECT_FALSE(m.project({0.1f, 0, 0}, 0));
  EXPECT_FALSE(m.project({0, 0, -1}, 0));
  EXPECT_FALSE(m.project_direction({0, 1, 0}, 0));
  EXPECT_FALSE(m.project_direction({0, 0, -1}, 0));
  // Close to the camera's plane a film position is rounding: none beyond 16 pictures from the center.
  static_assert(kWidth > kHeight && CameraModel::kReach == 16);
  for (const float sign : {-1.0f, 1.0f}) {
    for (const Vec3f& p : {Vec3f{31.9f * sign, 0, 1}, Vec3f{0, 31.9f * sign, 1}, Vec3f{0.0319f * sign, 0, 1e-3f}}) {
      EXPECT_TRUE(m.project(p, 0)) << p.x << " " << p.y;
      EXPECT_TRUE(m.project_direction(p, 0)) << p.x << " " << p.y;
    }
    for (const Vec3f& p : {Vec3f{32.1f * sign, 0, 1}, Vec3f{0, 32.1f * sign, 1}, Vec3f{1 * sign, 0, 1e-6f}}) {
      EXPECT_FALSE(m.project(p, 0)) << p.x << " " << p.y;
      EXPECT_FALSE(m.project_direction(p, 0)) << p.x << " " << p.y;
    }
  }
}

TEST(CameraModel, OrthographicCameraSeesBehindItself) {
  Camera c;
  c.projection = Projection::kOrthographic;
  c.width = 4;
  const Scene scene = scene_with(c, Affine3d{});
  const CameraModel m = model(scene);
  const auto q = m.project({1, 0, -3}, 0);
  ASSERT_TRUE(q);
  EXPECT_FLOAT_EQ(q->pixel.x, kWidth / 4);
  EXPECT_EQ(q->depth, -3);
  EXPECT_FALSE(m.project_direction({0, 0, 1}, 0));
}

TEST(CameraModel, RaysBeginAndEndAtTheClippingPlanes) {
  for (const Projection projection : {Projection::kPerspective, Projection::kOrthographic}) {
    Scene scene = restless_scene(projection, 0.2f);
    scene.cameras[0].near_clip = 0.7f;
    scene.cameras[0].far_clip = 30;
    const CameraModel m = model(scene);
    for (std::uint64_t i = 0; i < 500; ++i) {
      const double t = random1(i, 0);
      const CameraRay r = m.ray({random1(i, 1) * kWidth, random1(i, 2) * kHeight}, {random1(i, 3), random1(i, 4)}, t);
      EXPECT_NEAR(m.project(r.o + r.d * r.tmin, t)->depth, 0.7, 1e-5);
      EXPECT_NEAR(m.project(r.o + r.d * r.tmax, t)->depth, 30, 3e-4);
    }
  }
}

TEST(CameraModel, LensPointsFillTheApertureEvenly) {
  Camera c;
  c.aperture_radius = 0.5f;
  c.focus_distance = 3;
  const Scene scene = scene_with(c, mitsuba_pose());
  const CameraModel m = model(scene);
  const Affine3f pose(mitsuba_pose());
  // Rings of equal area times eight sectors.
  std::vector<double> counts(64), expected(64, 20000.0 / 64);
  for (std::uint64_t i = 0; i < 20000; ++i) {
    const CameraRay r = m.ray({17, 130}, {random1(i, 3), random1(i, 4)}, 0);
    const Vec3f offset = r.o - pose.translation;
    const float x = dot(offset, pose.x), y = dot(offset, pose.y), area = (x * x + y * y) / 0.25f;
    EXPECT_NEAR(dot(offset, pose.z), 0, 1e-6);
    ASSERT_LE(area, 1 + 1e-5f);
    const double sector = (std::atan2(y, x) / kPiD + 1) * 4;
    ++counts[std::size_t(std::min(area, 0.9999f) * 8) * 8 + std::size_t(std::min(sector, 7.9999))];
  }
  EXPECT_TRUE(test::CountsFit(expected, counts));
}

// Circles of confusion: the rays through one pixel meet at the focus distance f and are spread over a disk of diameter
// 2 R |d - f| / f at distance d; on the film that is 2 R |1/d - 1/f| at the plane of distance 1.
TEST(CameraModel, CirclesOfConfusionFollowTheFStop) {
  Camera c;
  c.fov_x = float(2 * std::atan(36.0 / 2 / 50));  // 50 mm on a sensor of 36 mm
  c.f_stop = 2;
  c.focus_distance = 3;
  for (const auto& [fit, size, radius] : {std::tuple{SensorFit::kAuto, 0.036f, 0.05 / 4},
                                          {SensorFit::kHorizontal, 0.072f, 0.1 / 4},
                                          {SensorFit::kVertical, 0.036f, 0.05 / 4 * kWidth / kHeight}}) {
    c.sensor_fit = fit, c.sensor_size = size;
    const Scene scene = scene_with(c, Affine3d{});
    const CameraModel m = model(scene);
    for (const double d : {1.0, 3.0, 12.0}) {
      Vec2d lo{1e9, 1e9}, hi{-1e9, -1e9};
      for (int i = 0; i < 2000; ++i) {
        const float u = random1(std::uint64_t(i), 3);  // the square's rim is that of the lens
        for (const Vec2f lens : {Vec2f{u, 0}, Vec2f{u, 0.9999f}, Vec2f{0, u}, Vec2f{0.9999f, u}}) {
          const CameraRay ray = m.ray({kWidth / 2.0f, kHeight / 2.0f}, lens, 0);
          const Vec3d at = Vec3d(ray.o) + Vec3d(ray.d) * ((d - double(ray.o.z)) / double(ray.d.z));
          lo = {std::min(lo.x, at.x), std::min(lo.y, at.y)}, hi = {std::max(hi.x, at.x), std::max(hi.y, at.y)};
        }
      }
      const double diameter = 2 * radius * std::abs(d - 3) / 3;
      EXPECT_NEAR(hi.x - lo.x, diameter, 0.01 * diameter + 1e-6) << d;
      EXPECT_NEAR(hi.y - lo.y, diameter, 0.01 * diameter + 1e-6) << d;
    }
  }
}

TEST(CameraModel, OrthographicLensesFocusToo) {
  Camera c;
  c.projection = Projection::kOrthographic;
  c.width = 4;
  c.f_stop = 5;  // a radius of 0.1 m
  c.focus_distance = 3;
  const Scene scene = scene_with(c, Affine3d{});
  const CameraModel m = model(scene);
  float largest = 0;
  for (int i = 0; i < 1000; ++i) {
    const CameraRay r = m.ray({80, 90}, {random1(std::uint64_t(i), 3), random1(std::uint64_t(i), 4)}, 0);
    const Vec3f sharp = r.o + r.d * (3 / r.d.z), behind = r.o + r.d * (6 / r.d.z);
    EXPECT_LT(length(sharp - Vec3f{1, 0, 3}), 1e-5f);
    largest = std::max(largest, length(behind - Vec3f{1, 0, 6}));
    EXPECT_NEAR(m.project(r.o + r.d * r.tmin, 0)->depth, 1e-2, 1e-6);
  }
  EXPECT_NEAR(largest, 0.1, 0.002);
}

// The focus follows an object, measured along the view axis, while camera and object move; keys of the lens are kept.
TEST(CameraModel, FocusFollowsANode) {
  AnimatedTransform camera, object;
  camera.keyed = object.keyed = true;
  camera.translation = {{0, 1}, {Vec3d{0, 0, 0}, Vec3d{0, 0, 1}}, Interpolation::kLinear};
  object.translation = {{0, 1}, {Vec3d{1, 0, 5}, Vec3d{-2, 1, 9}}, Interpolation::kLinear};
  Camera c;
  c.aperture_radius = {{0, 1}, {0.1f, 0.3f}, Interpolation::kLinear};
  Scene scene = scene_with(c, camera);
  scene.nodes.push_back({-1, object, "hero", 1.0f});
  scene.cameras[0].focus_node = 1;
  const CameraModel m = model(scene);
  for (const double t : {0.0, 0.25, 0.5, 1.0}) {
    const double distance = 5 + 3 * t;
    const Vec3f expected{0, 0, float(distance + t)};
    for (int i = 0; i < 100; ++i) {
      const CameraRay r =
          m.ray({kWidth / 2.0f, kHeight / 2.0f}, {random1(std::uint64_t(i), 3), random1(std::uint64_t(i), 4)}, t);
      EXPECT_LT(length(r.o + r.d * (float(distance) / r.d.z) - expected), 1e-5f);
      EXPECT_LE(std::hypot(r.o.x, r.o.y), float(0.1 + 0.2 * t) * 1.0001f);
    }
  }
  scene.nodes[1].local = AnimatedTransform(translate(Vec3d{3, 0, 0}));  // in the plane of the lens
  try {
    model(scene, {0, 0});
    FAIL();
  } catch (const Error& e) {
    EXPECT_NE(e.message().find("focus distance"), std::string::npos) << e.what();
  }
}

// Pixels twice as wide as high: the same film shows twice the angle across, and projects back.
TEST(CameraModel, PixelsNeedNotBeSquare) {
  for (const bool vertical : {false, true}) {
    Camera c;
    c.fov_x = float(kPiD / 2);
    c.keep_vertical_fov = vertical;
    c.authored_aspect = 1;
    c.pixel_aspect = 2;
    const Scene scene = scene_with(c, Affine3d{});
    const CameraModel m = model(scene);
    // A square in the scene is half as wide as high in pixels.
    const Vec2f center = m.project({0, 0, 1}, 0)->pixel, side = m.project({-0.1f, 0, 1}, 0)->pixel,
                up = m.project({0, 0.1f, 1}, 0)->pixel;
    EXPECT_NEAR((center.y - up.y) / (side.x - center.x), 2, 1e-5);
    const double half = vertical ? kHeight / 2.0 : kWidth / 2.0;
    EXPECT_NEAR(vertical ? center.y - up.y : side.x - center.x, 0.1 * half, 1e-4);
    const CameraRay r = m.ray({17, 33}, {}, 0);
    const Vec2f back = m.project(r.o + r.d * 7, 0)->pixel;
    EXPECT_NEAR(back.x, 17, 1e-4);
    EXPECT_NEAR(back.y, 33, 1e-4);
  }
}

TEST(CameraModel, VerticalAngleIsKeptOnRequest) {
  Camera c;
  c.fov_x = 1.2f;
  c.keep_vertical_fov = true;
  c.authored_aspect = 4.0f / 3;
  const double top = std::tan(0.6) / (4.0 / 3);
  for (const int width : {90, 240, 400}) {
    const Scene scene = scene_with(c, Affine3d{});
    const CameraModel m(scene, 0, width, 180, {0, 0}, kStep);
    const auto q = m.project({0, float(top), 1}, 0);
    EXPECT_NEAR(q->pixel.x, width / 2.0, 1e-4);
    EXPECT_NEAR(q->pixel.y, 0, 1e-4);
    const auto side = m.project({float(top * width / 180), 0, 1}, 0);  // pixels stay square
    EXPECT_NEAR(side->pixel.x, 0, 1e-4);
  }
}

TEST(CameraModel, MotionIsResampledOnTheGlobalGrid) {
  const Scene scene = restless_scene(Projection::kPerspective, 0.1f);
  const double coarse = 1.0 / 8;
  const CameraModel m(scene, 0, kWidth, kHeight, {0.1, 0.9}, coarse);
  for (int k = 1; k <= 6; ++k) {  // knots are exact ...
    const Affine3d world = scene.world(1, k * coarse);
    EXPECT_LT(length(m.position(k * coarse) - Vec3f(world.translation)), 1e-6f);
    EXPECT_LT(length(m.axis(k * coarse) - Vec3f(normalize(world.z))), 1e-6f);
    const CameraRay r = m.ray({3, 5}, {0.5f, 0.5f}, k * coarse);
    const double half_width = std::tan(scene.cameras[0].fov_x.at(k * coarse) / 2.0);
    const double x = (1 - 2 * (3.0 / kWidth - 0.05)) * half_width;
    const double y = (1 - 2 * (5.0 / kHeight + 0.125)) * half_width * kHeight / kWidth;
    EXPECT_LT(length(r.d - Vec3f(normalize(world.vector({x, y, 1})))), 1e-6f);
    // ... and between them the position lies on a line, though the true one runs along an arc.
    const Vec3d next = scene.world(1, (k + 1) * coarse).translation;
    const Vec3f middle((world.translation + next) * 0.5);
    EXPECT_LT(length(m.position((k + 0.5) * coarse) - middle), 1e-6f);
    EXPECT_GT(length(m.position((k + 0.5) * coarse) - Vec3f(scene.world(1, (k + 0.5) * coarse).translation)), 1e-5f);
  }
  // Any span that holds a time gives the same rays at that time, to the bit.
  const CameraModel other(scene, 0, kWidth, kHeight, {0.4, 0.55}, coarse);
  for (std::uint64_t i = 0; i < 100; ++i) {
    const double t = 0.4 + 0.15 * random1(i, 0);
    const CameraRay a = m.ray({31, 77}, {0.1f, 0.7f}, t), b = other.ray({31, 77}, {0.1f, 0.7f}, t);
    EXPECT_EQ(a.o, b.o);
    EXPECT_EQ(a.d, b.d);
    EXPECT_EQ(a.tmin, b.tmin);
  }
}

TEST(CameraModel, RotationIsSphericalBetweenKnots) {
  AnimatedTransform turn;
  turn.keyed = true;
  turn.rotation = Animated<Quatd>({0, 1}, {Quatd{}, axis_angle<double>({0, 1, 0}, 2.4)}, Interpolation::kLinear);
  const Scene scene = scene_with(Camera{}, turn);
  const CameraModel m(scene, 0, kWidth, kHeight, {0, 1}, 0.5);  // 69 degrees from knot to knot
  for (const double t : {0.1, 0.25, 0.4, 0.7}) {
    EXPECT_LT(length(m.axis(t) - Vec3f(float(std::sin(2.4 * t)), 0, float(std::cos(2.4 * t)))), 1e-6f) << t;
  }
}

TEST(CameraModel, CameraThatMovesElsewhereInTheShotStandsStill) {
  AnimatedTransform late;
  late.keyed = true;
  late.translation = Animated<Vec3d>({2, 3}, {{0, 0, 0}, {1, 0, 0}}, Interpolation::kLinear);
  const Scene scene = scene_with(Camera{}, late);
  const CameraModel before = model(scene, {0, 1}), after = model(scene, {3, 4}), during = model(scene, {2, 3});
  EXPECT_EQ(before.position(0.5).x, 0);
  EXPECT_EQ(after.position(3.5).x, 1);
  EXPECT_NEAR(during.position(2.5).x, 0.5, 1e-6);
}

TEST(CameraModel, ErrorsNameTheCamera) {
  const auto expect = [](const Camera& camera, const AnimatedTransform& transform, ErrorCode code,
                         const std::string& text, TimeSpan span = {0, 1}) {
    const Scene scene = scene_with(camera, transform);
    try {
      model(scene, span);
      ADD_FAILURE() << text;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.what();
      EXPECT_NE(e.message().find("camera \"shot cam\" has " + text), std::string::npos) << e.what();
    }
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  expect({}, scale<double>({1, 1, 0}), ErrorCode::kBadInput, "a singular transform at 0 s");
  expect({}, scale<double>({1, nan, 1}), ErrorCode::kBadInput, "a singular transform");
  expect({}, Affine3d{{1, 0, 0}, {1, 0, 0}, {0, 0, 1}}, ErrorCode::kBadInput, "a singular transform");
  for (const float fov : {0.0f, -1.0f, 3.15f, nan}) {
    Camera c;
    c.fov_x = fov;
    expect(c, {}, ErrorCode::kOutOfRange, "a horizontal field of view of");
  }
  Camera c;
  c.fov_x = Animated<float>({0, 1}, {1.0f, 4.0f}, Interpolation::kLinear);
  expect(c, {}, ErrorCode::kOutOfRange, "a horizontal field of view of");
  c = {};
  c.projection = Projection::kOrthographic;
  c.width = -2;
  expect(c, {}, ErrorCode::kOutOfRange, "a width of -2 at 0 s; valid: above 0");
  c = {};
  c.aperture_radius = -1;
  expect(c, {}, ErrorCode::kOutOfRange, "an aperture radius of");
  c.aperture_radius = 1;
  c.focus_distance = 0;
  expect(c, {}, ErrorCode::kOutOfRange, "a focus distance of");
  c = {};
  c.near_clip = 5, c.far_clip = 5;
  expect(c, {}, ErrorCode::kOutOfRange, "clipping distances");
  c = {};
  c.principal_offset.y = nan;
  expect(c, {}, ErrorCode::kOutOfRange, "a principal offset");
  AnimatedTransform moving;
  moving.keyed = true;
  moving.translation = Animated<Vec3d>({0, 1e9}, {{0, 0, 0}, {1, 0, 0}}, Interpolation::kLinear);
  const Scene scene = scene_with({}, moving);
  EXPECT_THROW(model(scene, {0, 1e9}), Error);
  // A lens that is not used may be anything; so may the other projection's size.
  c = {};
  c.focus_distance = 0;
  c.width = nan;
  const Scene fine = scene_with(c, {});
  EXPECT_NO_THROW(model(fine));
}

// Lines of sight and film positions in double undo each other, and are those of rays but for rounding.
TEST(CameraModel, SightInDouble) {
  AnimatedTransform moving;
  moving.keyed = true;
  moving.translation = Animated<Vec3d>({0, 1}, {{1, 2, 3}, {2, 0, 3.5}}, Interpolation::kLinear);
  moving.rotation = {
      {0, 1}, {axis_angle(Vec3d{0, 1, 0}, 0.3), axis_angle(Vec3d{0, 1, 0}, 0.9)}, Interpolation::kLinear};
  Camera c;
  c.aperture_radius = 0.1f;
  c.principal_offset = {0.1f, -0.05f};
  for (const Projection projection : {Projection::kPerspective, Projection::kOrthographic}) {
    c.projection = projection;
    const Scene scene = scene_with(c, moving);
    const CameraModel m = model(scene);
    for (const double t : {0.0, 0.37, 1.0}) {
      for (const Vec2d& pixel : {Vec2d{0.5, 0.5}, Vec2d{201.25, 37.125}, Vec2d{-40, 200}}) {
        const CameraModel::Sight s = m.sight(pixel, t);
        EXPECT_NEAR(length(s.d), 1, 1e-15);
        const auto back = m.project_double(s.o + s.d * 3.7, t);
        ASSERT_TRUE(back);
        EXPECT_NEAR(back->x, pixel.x, 1e-10);
        EXPECT_NEAR(back->y, pixel.y, 1e-10);
        const CameraRay r = m.ray(Vec2f(pixel), {0.5f, 0.5f}, t);  // through the center of the lens
        EXPECT_LT(length(Vec3d(r.d) - s.d), 1e-6);
        EXPECT_LT(length(Vec3d(r.o) - s.o), 1e-6);
        EXPECT_NEAR(r.tmin, s.tmin, 1e-6);
      }
    }
  }
}

}  // namespace
}  // namespace tempera
