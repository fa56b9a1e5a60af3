// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "lights.h"
#include "statistics.h"
#include "support/chi_square.h"
#include "support/effort.h"
#include "tempera/scene/light_shape.h"

namespace tempera {
namespace {

using namespace test;

struct Case {
  std::string name;
  std::function<void(Lights&)> build;
  bool grazing = false;  ///< sampled by area where it curves away: densities have no bound at its outline
};
std::ostream& operator<<(std::ostream& out, const Case& c) { return out << c.name; }

class AreaLights : public testing::TestWithParam<Case> {};

// Seen from one point: what samples estimate is the integral over directions, found here by looking in all of them; the
// density of a direction is the one that its sample came with; and over all directions it holds every sample that
// shines.
TEST_P(AreaLights, SamplesEstimateTheIntegralOverDirections) {
  Lights l;
  GetParam().build(l);
  l.build();
  const double t = 0.3;
  for (const Vec3f p : {Vec3f{0, 0, 0}, Vec3f{0.9f, 0.4f, 1.2f}}) {
    const auto weight = [](const Vec3f& d) { return 1.5 + double(d.x) + 0.3 * double(d.y); };
    double integral = 0, density = 0;
    const int n = 700;
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < 2 * n; ++i) {
        const std::uint64_t k = std::uint64_t(j) * 2 * n + std::uint64_t(i);
        const Vec3f d = direction((j + double(number(k, 7))) / n, (i + double(number(k, 8))) / (2 * n));
        const auto [radiance, pdf] = l.look(p, d, t);
        if (radiance > 0) integral += double(radiance) * weight(d), density += double(pdf);
      }
    }
    integral *= 4 * kPiD / (2.0 * n * n), density *= 4 * kPiD / (2.0 * n * n);

    std::vector<double> estimates, shining;
    int compared = 0;
    for (std::uint64_t i = 0; i < 40000u * std::uint64_t(effort()); ++i) {
      const auto s = l.sample(p, t, i);
      std::optional<Hit> hit;
      if (s && s->radiance.r > 0) hit = l.rays->intersect({.o = p, .d = s->wi, .time = t});
      const bool shines = hit && std::abs(hit->t - s->distance) < 1e-3f * s->distance;
      estimates.push_back(shines ? double(s->radiance.r / s->pdf) * weight(s->wi) : 0);
      shining.push_back(shines);
      if (!shines || compared >= 2000) continue;
      EXPECT_NEAR(length(s->wi), 1, 1e-5f);
      const ShadingPoint seen = l.rays->shading_point(hit->point, t, -s->wi);
      if (std::abs(dot(seen.ng, s->wi)) < 0.05f) continue;  // densities at grazing angles magnify rounding
      EXPECT_NEAR(l.sampler->pdf(hit->point, seen, p, hit->t), s->pdf, 2e-3f * s->pdf);
      EXPECT_NEAR(l.sampler->emitted(hit->point, seen).r, s->radiance.r, 1e-4f);
      ++compared;
    }
    EXPECT_GT(compared, 1000);
    // The look in all directions has an error of its own, at the edges.
    const auto close_to = [&](double expected, const std::vector<double>& values) {
      double mean = 0, squares = 0;
      for (const double v : values) mean += v / double(values.size()), squares += v * v / double(values.size());
      const double error = std::sqrt(std::max(squares - mean * mean, 0.0) / double(values.size()));
      EXPECT_NEAR(mean, expected, 4 * error + 2e-3 * expected);
    };
    close_to(integral, estimates);
    if (!GetParam().grazing) close_to(density, shining);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Shapes, AreaLights,
    testing::Values(Case{"rectangle",
                         [](Lights& l) {
                           l.add(mesh(make_rectangle(), placed({0.7f, 0.4f, 1}, {0.5f, 0.3f, 2})), 3);
                         }},
                    Case{"cube",
                         [](Lights& l) {
                           l.add(mesh(make_cube(), placed({0.5f, 0.3f, 0.4f}, {-0.5f, 1, 3})), 2);
                         }},
                    Case{"sphere",
                         [](Lights& l) {
                           l.add(Sphere{placed({0.6f, 0.6f, 0.6f}, {0.2f, -0.5f, 2.5f})}, 2);
                         }},
                    Case{"ellipsoid",
                         [](Lights& l) {
                           l.add(Sphere{placed({0.9f, 0.2f, 0.4f}, {0.2f, -0.5f, 2.5f})}, 2);
                         },
                         true},
                    Case{"disk",
                         [](Lights& l) {
                           l.add(Disk{placed({0.5f, 0.5f, 1}, {0.4f, 0.2f, 2})}, 5);
                         }},
                    Case{"ellipse",
                         [](Lights& l) {
                           l.add(Disk{placed({1, 0.3f, 1}, {0.4f, 0.2f, 2})}, 5, true);
                         }},
                    Case{"cylinder",
                         [](Lights& l) {
                           l.add(Cylinder{placed({0.3f, 0.3f, 1}, {0.4f, 0.2f, 2.5f})}, 5);
                         },
                         true},
                    Case{"spread",
                         [](Lights& l) {
                           l.add(mesh(make_rectangle(), placed({0.7f, 0.4f, 1}, {0.5f, 0.3f, 2})), 3);
                           l.scene.shapes.back().emission->half_spread = 0.5f;
                         }},
                    Case{"soft_spot",
                         [](Lights& l) {
                           l.scene.lights = {lamp(LightType::kSpot, 30)};
                           l.scene.nodes.push_back({-1, Affine3d(placed({2, 2, 2}, {0.2f, 0.4f, 2.5f})), "", 1.0f});
                           l.scene.lights[0].node = 0;
                           make_sphere_light(l.scene, 0, 0.4f, true);
                         }},
                    Case{"several",
                         [](Lights& l) {
                           l.add(mesh(make_rectangle(), placed({0.7f, 0.4f, 1}, {1.5f, 0.3f, 2})), 3);
                           l.add(Sphere{placed({0.3f, 0.3f, 0.3f}, {-1, 0.5f, 2.5f})}, 20);
                           l.add(Disk{placed({0.5f, 0.5f, 1}, {0.4f, -1.2f, 2.2f})}, 5, true);
                         }}),
    [](const auto& of) { return of.param.name; });

/// Estimates of the irradiance at p on a surface with normal n, by sampling lights; nothing is in between.
std::vector<double> irradiances(const Lights& l, const Vec3f& p, const Vec3f& n, int count = 20000) {
  std::vector<double> out;
  for (int i = 0; i < count; ++i) {
    const auto s = l.sample(p, 0.5, std::uint64_t(i));
    out.push_back(s ? double(s->radiance.r) * std::max(0.0, double(dot(s->wi, n))) / double(s->pdf) : 0);
  }
  return out;
}

// A sphere of even radiance gives what a point in its middle gives, wherever it is above the horizon as a whole.
TEST(LightSizes, ASphereHasTheIrradianceOfItsPoint) {
  for (const LightType type : {LightType::kPoint, LightType::kSpot}) {
    Lights l;
    l.scene.lights = {lamp(type, 7)};
    const Affine3d pose = look_at<double>({0, 0, 3}, {0, 0, 0}, {0, 1, 0}) * scale(Vec3d{3, 1, 2});  // does not count
    l.scene.nodes.push_back({-1, pose, "", 1.0f});
    l.scene.lights[0].node = 0;
    make_sphere_light(l.scene, 0, 0.5f, false);
    EXPECT_TRUE(l.scene.lights.empty());
    l.build();
    for (const Vec3f p : {Vec3f{0, 0, 0}, Vec3f{0.5f, 0.3f, 0}}) {
      const double d2 = double(p.x * p.x + p.y * p.y) + 9;
      EXPECT_TRUE(test::MeanIs(7 * 3 / (d2 * std::sqrt(d2)), irradiances(l, p, {0, 0, 1}))) << int(type);
    }
    // The power of a sphere: 4 pi^2 r^2 L = 4 pi I.
    const double radiance = l.scene.shapes[0].emission->radiance.mean().r;
    EXPECT_NEAR(radiance * 4 * kPiD * kPiD * 0.25, 4 * kPiD * 7, 1e-3);
    if (type == LightType::kPoint) continue;
    // Beyond the cone of 1.2 radians, and far beside it, there is no light.
    for (const double e : irradiances(l, {12, 0, 0}, {0, 0, 1}, 100)) EXPECT_EQ(e, 0);
  }
}

// Soft rims: the falloffs at directions between beam and cutoff, from far away, where the sphere is as good as a point.
TEST(LightSizes, ASpotKeepsItsConeByDirection) {
  for (const SpotFalloff falloff : {SpotFalloff::kLinear, SpotFalloff::kSquared, SpotFalloff::kSmoothstep}) {
    Lights l;
    l.scene.lights = {lamp(LightType::kSpot, 2)};
    l.scene.lights[0].falloff = falloff;
    l.scene.nodes.push_back({-1, look_at<double>({0, 0, 100}, {0, 0, 0}, {0, 1, 0}), "", 1.0f});
    l.scene.lights[0].node = 0;
    make_sphere_light(l.scene, 0, 0.01f, false);
    l.build();
    const double angle = 0.9, c = std::cos(angle), x = (c - std::cos(1.2)) / (std::cos(0.4) - std::cos(1.2));
    const double expected = falloff == SpotFalloff::kLinear    ? (1.2 - angle) / 0.8
                            : falloff == SpotFalloff::kSquared ? x * x
                                                               : x * x * (3 - 2 * x);
    const Vec3f p{float(100 * std::tan(angle)), 0, 0};
    for (const double e : irradiances(l, p, {0, 0, 1}, 100)) {
      EXPECT_NEAR(e, 2 * expected * c * c * c / 1e4, 1e-3 * 2e-4) << int(falloff);
    }
  }
}

// Spread keeps the power, and directs it: on the axis of a disk that is seen within theta,
// E = pi L (T sin^2 theta - (theta - sin theta cos theta)) / (T - s), with T = tan(s) of half the spread s.
TEST(LightSizes, SpreadKeepsThePowerOfADisk) {
  for (const float half_spread : {0.01f, 0.09f, 0.5f, 1.2f, kPi / 2}) {
    Lights l;
    l.add(Disk{Affine3f(scale(Vec3f{2, 2, 1}))}, 3);
    l.scene.shapes[0].emission->half_spread = half_spread;
    l.build();
    ShadingPoint s;
    s.ng = {0, 0, 1};
    const double theta_max = std::min(double(half_spread), kPiD / 2);
    double power = 0;
    const int n = 20000;
    for (int i = 0; i < n; ++i) {  // radiant exitance: the integral of L cos over directions
      const double theta = theta_max * (i + 0.5) / n;
      s.wo = Vec3f(Vec3d{std::sin(theta), 0, std::cos(theta)});
      power += 2 * kPiD * double(l.sampler->emitted({0, 0, 0, 0.5f, 0.5f}, s).r) * std::sin(theta) * std::cos(theta) *
               theta_max / n;
    }
    EXPECT_NEAR(power, 3 * kPiD, 2e-3) << half_spread;
    if (half_spread > 1.5f) continue;
    for (const double h : {40.0, 8.0, 1.0}) {
      const double t = std::tan(double(half_spread)), theta = std::min(std::atan(2 / h), double(half_spread));
      const double e = 3 * kPiD *
                       (t * std::sin(theta) * std::sin(theta) - (theta - std::sin(theta) * std::cos(theta))) /
                       (t - double(half_spread));
      EXPECT_TRUE(test::MeanIs(e, irradiances(l, {0, 0, float(h)}, {0, 0, -1}, 60000))) << half_spread << " " << h;
    }
  }
}

// A sun of any size gives its irradiance to a surface that faces it, and the cosine's share to one that leans, as long
// as all of it is above the horizon; found by sampling it, and by looking into the sky.
TEST(LightSizes, ASunHasTheIrradianceOfItsDirection) {
  for (const double degrees : {0.53, 10.0, 60.0}) {
    Lights l;
    l.scene.lights = {lamp(LightType::kDirectional, 5)};
    l.scene.lights[0].angle = float(degrees * kPiD / 180);
    l.scene.nodes.push_back({-1, look_at<double>({1, 2, 3}, {0, 0, 0}, {0, 1, 0}), "", 1.0f});
    l.scene.lights[0].node = 0;
    l.add(Disk{Affine3f(translate(Vec3f{0, 0, -50}))}, 0);  // the ray scene is not empty
    l.build();
    const Vec3f to_sun = normalize(Vec3f{1, 2, 3});
    const Vec3f leaning = normalize(to_sun + cross(to_sun, {0, 0, 1}) * 0.9f);
    std::vector<double> facing = irradiances(l, {}, to_sun);
    if (degrees < 1) {  // what varies is less than the rounding
      for (const double e : facing) EXPECT_NEAR(e, 5, 1e-4);
    } else {
      EXPECT_TRUE(test::MeanIs(5, facing)) << degrees;
    }
    EXPECT_TRUE(test::MeanIs(5 * double(dot(to_sun, leaning)), irradiances(l, {}, leaning))) << degrees;
    EXPECT_TRUE(l.sampler->has_environment());
    const Rgb seen = l.sampler->environment(to_sun, 0.5);
    EXPECT_NEAR(seen.r * float(kPiD * std::pow(std::sin(degrees * kPiD / 360), 2)), 5, 1e-4);
    EXPECT_TRUE(is_black(l.sampler->environment(to_sun, 0.5, true))) << "the camera does not see it";
    const Basis b(to_sun);
    for (const double f : {0.98, 1.02}) {
      const double a = f * degrees * kPiD / 360;
      const Vec3f d = Vec3f(Vec3d(b.n) * std::cos(a) + Vec3d(b.s) * std::sin(a));
      EXPECT_EQ(l.sampler->environment(d, 0.5).r > 0, f < 1);
      EXPECT_EQ(l.sampler->environment_pdf(d, 0.5, {}) > 0, f < 1);
    }
    double integral = 0;  // of L cos over the cap around the disk, looking in even steps
    const int n = 1000;
    const double cap = 1 - std::cos(1.1 * degrees * kPiD / 360);
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < 50; ++i) {
        const double z = 1 - cap * (j + 0.5) / n, r = std::sqrt(1 - z * z), phi = 2 * kPiD * (i + 0.3) / 50;
        const Vec3f d = b.to_world(Vec3f(Vec3d{r * std::cos(phi), r * std::sin(phi), z}));
        const double pdf = l.sampler->environment_pdf(d, 0.5, {});
        integral += double(l.sampler->environment(d, 0.5).r) * z * 2 * kPiD * cap / (n * 50.0);
        if (pdf > 0) {
          EXPECT_NEAR(pdf, 1 / (2 * kPiD * (1 - std::cos(degrees * kPiD / 360))), 1e-3 * pdf);
        }
      }
    }
    EXPECT_NEAR(integral, 5, 0.01) << degrees;
  }
}

// A sun in front of a sky: directions of both follow the common density, seen from anywhere.
TEST(LightSizes, SunAndSkyShareTheDensity) {
  Lights l;
  Environment e;
  e.radiance = Rgb(0.5f);
  l.scene.environments = {e};
  l.scene.lights = {lamp(LightType::kDirectional, 5)};
  l.scene.lights[0].angle = 0.6f;
  l.scene.nodes.push_back({-1, look_at<double>({1, 2, 3}, {0, 0, 0}, {0, 1, 0}), "", 1.0f});
  l.scene.lights[0].node = 0;
  l.add(Disk{Affine3f(translate(Vec3f{0, 0, -50}))}, 0);
  l.build();
  int differ = 0;
  const auto result = test::chi_square(
      [&](int i) -> std::optional<Vec3f> {
        const auto s = l.sample({}, 0.5, std::uint64_t(i));
        if (!s) return std::nullopt;
        differ += std::abs(s->pdf / l.sampler->environment_pdf(s->wi, 0.5, {}) - 1) > 1e-3f;
        return s->wi;
      },
      [&](const Vec3f& d) { return l.sampler->environment_pdf(d, 0.5, {}); }, 60000);
  EXPECT_GT(result.p_value, 1e-3) << result.report;
  EXPECT_LE(differ, 60) << "of 60000";
  std::vector<double> irradiance = irradiances(l, {}, normalize(Vec3f{1, 2, 3}));
  EXPECT_TRUE(test::MeanIs(5 + 0.5 * kPiD, irradiance));
}

// An environment with a gradient and a bright spot, turned and turning: directions follow the density, at several
// times.
TEST(EnvironmentLights, SamplesFollowTheDensity) {
  Lights l;
  Environment e;
  e.width = 96, e.height = 48;
  for (int y = 0; y < e.height; ++y) {
    for (int x = 0; x < e.width; ++x) {
      const double a = std::hypot(x - 30.5, y - 17.5);
      e.image.emplace_back(float(0.3 + 0.01 * y + 6 * std::exp(-a * a / 60)));
    }
  }
  AnimatedTransform turning;
  turning.keyed = true;
  turning.rotation = {
      {0, 1}, {axis_angle(Vec3d{0, 1, 0}, 0.2), axis_angle(normalize(Vec3d{1, 2, 0}), 1.1)}, Interpolation::kLinear};
  l.scene.nodes.push_back({-1, turning, "", 1.0f});
  e.node = 0;
  l.scene.environments = {e};
  l.build();
  for (const double t : {0.0, 0.55, 1.0}) {
    int differ = 0;  // at the border of two pixels either may be meant
    const auto result = test::chi_square(
        [&](int i) -> std::optional<Vec3f> {
          const auto s = l.sample({1, 2, 3}, t, std::uint64_t(i));
          if (!s) return std::nullopt;
          differ += std::abs(s->pdf / l.sampler->environment_pdf(s->wi, t, {1, 2, 3}) - 1) > 1e-3f;
          return s->wi;
        },
        [&](const Vec3f& d) {
          return l.sampler->environment_pdf(d, t, {1, 2, 3});
        },
        60000);
    EXPECT_GT(result.p_value, 1e-3) << "at " << t << ": " << result.report;
    EXPECT_LE(differ, 60) << "of 60000";
    // The test can fail: another time's density is turned down.
    const auto wrong = test::chi_square(
        [&](int i) -> std::optional<Vec3f> {
          return l.sample({1, 2, 3}, t, std::uint64_t(i))->wi;
        },
        [&](const Vec3f& d) {
          return l.sampler->environment_pdf(d, t < 0.5 ? t + 0.1 : t - 0.1, {1, 2, 3});
        },
        60000);
    EXPECT_LT(wrong.p_value, 1e-6) << "at " << t;
  }
}

}  // namespace
}  // namespace tempera
