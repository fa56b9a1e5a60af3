// SPDX-License-Identifier: Apache-2.0
// Light leaving its source: power, densities, and agreement with what LightSampler::sample finds from the other side.
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
#include "tempera/shading/microfacet.h"

namespace tempera {
namespace {

using namespace test;

constexpr double kTime = 0.3;

std::optional<LightEnd> emit(const Lights& l, std::uint64_t i, double t = kTime) {
  return l.sampler->emit(t, number(i, 21), {number(i, 22), number(i, 23)}, {number(i, 24), number(i, 25)});
}

/// Brighter to the right and at the top: 0.4 + u + v / 2, mean 1.15.
class Slope final : public Texture {
 public:
  Rgb rgb(const ShadingPoint& s) const override { return Rgb(0.4f + s.uv.x + 0.5f * s.uv.y); }
  Rgb mean() const override { return Rgb(1.15f); }
};

/// A scene of one kind of light, with nothing else that emits, and the power that it sends out at kTime; 0: has no
/// closed form.
struct Kind {
  std::string name;
  std::function<void(Lights&)> build;
  double power = 0;
  bool infinite = false;  ///< `power` is per square metre of the disk
};
std::ostream& operator<<(std::ostream& out, const Kind& k) { return out << k.name; }

/// What stands at the origin to be lit, so that the scene has a size; it is in nobody's way in these tests.
void add_matter(Lights& l) { l.add(Sphere{Affine3f(scale(Vec3f{1.2f, 1.2f, 1.2f}))}, 0); }

int add_node(Lights& l, const AnimatedTransform& transform) {
  l.scene.nodes.push_back({-1, transform, "", 1.0f});
  return int(l.scene.nodes.size()) - 1;
}

AnimatedTransform moving(const Vec3d& scale_end = {1, 1, 1}) {
  AnimatedTransform a;
  a.keyed = true;
  a.translation = {{0, 1}, {Vec3d{0.5, 0.2, 2.5}, Vec3d{-0.6, 0.3, 2.1}}, Interpolation::kLinear};
  a.rotation = {
      {0, 1}, {axis_angle(Vec3d{0, 1, 0}, 2.6), axis_angle(normalize(Vec3d{1, 5, 0}), 3.3)}, Interpolation::kLinear};
  a.scale = {{0, 1}, {Vec3d{1, 1, 1}, scale_end}, Interpolation::kLinear};
  return a;
}

void add_lamp(Lights& l, PunctualLight light, const AnimatedTransform& pose) {
  light.node = add_node(l, pose);
  l.scene.lights.push_back(light);
}
Affine3d aimed() { return look_at<double>({1.2, 1.5, 2}, {0.2, 0, 0}, {0, 1, 0}); }

PunctualLight spot(SpotFalloff falloff) {
  PunctualLight light = lamp(LightType::kSpot, 7);
  light.falloff = falloff;
  return light;
}
/// Integral over directions of a spot's falloff between 0.4 and 1.2 radians.
double spot_integral(SpotFalloff falloff) {
  const double beam = 0.4, cutoff = 1.2, inner = std::cos(beam), outer = std::cos(cutoff);
  double rim = 0;
  const int n = 100000;
  for (int i = 0; i < n; ++i) {
    const double a = beam + (cutoff - beam) * (i + 0.5) / n, x = (std::cos(a) - outer) / (inner - outer);
    const double f = falloff == SpotFalloff::kLinear    ? (cutoff - a) / (cutoff - beam)
                     : falloff == SpotFalloff::kSquared ? x * x
                                                        : x * x * (3 - 2 * x);
    rim += f * std::sin(a) * (cutoff - beam) / n;
  }
  return 2 * kPiD * (1 - inner + rim);
}

Environment sky() {
  Environment e;
  e.width = 64, e.height = 32;
  for (int y = 0; y < e.height; ++y) {
    for (int x = 0; x < e.width; ++x) {
      const double a = std::hypot(x - 20.5, y - 11.5);
      e.image.emplace_back(float(0.3 + 0.01 * y + 6 * std::exp(-a * a / 30)));
    }
  }
  return e;
}

std::vector<Kind> kinds() {
  const auto rectangle = mesh(make_rectangle(), placed({0.7f, 0.4f, 1}, {0.5f, 0.3f, 2}));
  const double rectangle_power = 4 * 0.7 * 0.4 * kPiD * 3;
  std::vector<Kind> k{
      {"rectangle", [=](Lights& l) { l.add(rectangle, 3); }, rectangle_power},
      {"flipped_rectangle",
       [=](Lights& l) {
         Geometry g = rectangle;
         std::get<Mesh>(g).flip_normals = true;
         l.add(std::move(g), 3);
       },
       rectangle_power},
      {"textured_rectangle",
       [=](Lights& l) {
         l.add(rectangle, 1);
         l.scene.shapes.back().emission->radiance = Slot(Rgb(3.0f), std::make_shared<Slope>());
       },
       1.15 * rectangle_power},
      {"two_sided_rectangle", [=](Lights& l) { l.add(rectangle, 3, true); }, 2 * rectangle_power},
      {"cube",
       [](Lights& l) {
         l.add(mesh(make_cube(), placed({0.5f, 0.3f, 0.4f}, {-0.5f, 1, 3})), 2);
       },
       8 * (0.5 * 0.3 + 0.5 * 0.4 + 0.3 * 0.4) * 2 * kPiD},
      {"sphere",
       [](Lights& l) {
         l.add(Sphere{placed({0.6f, 0.6f, 0.6f}, {0.2f, -0.5f, 2.5f})}, 2);
       },
       4 * kPiD * 0.36 * 2 * kPiD},
      {"inward_sphere",
       [](Lights& l) {
         l.add(Sphere{Affine3f(scale(Vec3f{2, 2, 2})), true}, 2);
       },
       4 * kPiD * 4 * 2 * kPiD},
      {"ellipsoid",
       [](Lights& l) {
         l.add(Sphere{placed({0.9f, 0.2f, 0.4f}, {0.2f, -0.5f, 2.5f})}, 2);
       }},
      {"disk",
       [](Lights& l) {
         l.add(Disk{placed({0.5f, 0.5f, 1}, {0.4f, 0.2f, 2})}, 5);
       },
       kPiD * 0.25 * 5 * kPiD},
      {"two_sided_ellipse",
       [](Lights& l) {
         l.add(Disk{placed({1, 0.3f, 1}, {0.4f, 0.2f, 2})}, 5, true);
       },
       2 * kPiD * 0.3 * 5 * kPiD},
      {"cylinder",
       [](Lights& l) {  // upright
         const Affine3d upright = rotation(axis_angle(Vec3d{1, 0, 0}, -kPiD / 2)) * scale(Vec3d{0.3, 0.3, 1});
         l.add(Cylinder{Affine3f(translate(Vec3d{0.4, -0.5, 2}) * upright)}, 5);
       },
       2 * kPiD * 0.3 * 5 * kPiD},
      {"soft_spot",
       [](Lights& l) {
         add_lamp(l, spot(SpotFalloff::kLinear), aimed() * scale(Vec3d{2, 2, 2}));
         make_sphere_light(l.scene, 0, 0.4f, true);
       },
       7 * spot_integral(SpotFalloff::kLinear)},
      {"spot_rectangle",
       [=](Lights& l) {
         l.add(rectangle, 3, true);
         auto light = std::make_shared<PunctualLight>(spot(SpotFalloff::kSmoothstep));
         light->node = add_node(l, Affine3d(placed({1, 1, 1}, {0, 0, 0})));
         l.scene.shapes.back().emission->spot = light;
       }},
      {"moving_rectangle",
       [](Lights& l) {
         l.add(make_rectangle(), 3);
         l.scene.instances.back().node = add_node(l, moving({2, 1, 1}));
       }},
      {"moving_sphere",
       [](Lights& l) {
         l.add(Sphere{Affine3f(scale(Vec3f{0.5f, 0.5f, 0.5f}))}, 3);
         l.scene.instances.back().node = add_node(l, moving());
       },
       kPiD * 3 * 4 * kPiD * 0.25},
      {"growing_ellipsoid",
       [](Lights& l) {
         l.add(Sphere{Affine3f(scale(Vec3f{0.5f, 0.3f, 0.2f}))}, 3);
         l.scene.instances.back().node = add_node(l, moving({2, 1, 3}));
       }},
      {"morphing_rectangle",
       [=](Lights& l) {
         Mesh m = std::get<Mesh>(rectangle);
         m.morph_targets.push_back({{{0, 0, 0}, {1, 0.2f, 0}, {0, 0.5f, 0.3f}, {-0.3f, 0, 0.4f}}, {}, {}});
         m.morph_weights = {{0, 1}, {{0.0f}, {1.0f}}, Interpolation::kLinear};
         l.add(std::move(m), 3);
       }},
      {"point", [](Lights& l) { add_lamp(l, lamp(LightType::kPoint, 7), aimed()); }, 4 * kPiD * 7},
      {"dimming_point",
       [](Lights& l) {
         PunctualLight light = lamp(LightType::kPoint, 7);
         light.intensity_scale = {{0, 1}, {1.0f, 0.0f}, Interpolation::kLinear};
         add_lamp(l, light, moving());
       },
       4 * kPiD * 7 * (1 - kTime)},
      {"textured_spot",
       [](Lights& l) {
         PunctualLight light = spot(SpotFalloff::kSquared);
         light.texture = std::make_shared<Slope>();
         add_lamp(l, light, aimed());
       },
       1.15 * 7 * spot_integral(SpotFalloff::kSquared)},  // the slope is even about the axis
      {"widening_spot",
       [](Lights& l) {
         PunctualLight light = spot(SpotFalloff::kSmoothstep);
         light.cutoff_angle = {{0, 1}, {0.6f, 1.4f}, Interpolation::kLinear};
         add_lamp(l, light, moving());
       }},
      {"projector",
       [](Lights& l) {
         PunctualLight light = lamp(LightType::kProjector, 7);
         light.projector_fov = 1.3f, light.projector_aspect = 1.5f;
         light.texture = std::make_shared<Slope>();
         add_lamp(l, light, aimed() * scale(Vec3d{2, 1, 3}));
       },
       1.15 * 7 * 4 * std::pow(std::tan(double(0.65f)), 2) / 1.5},
      {"directional", [](Lights& l) { add_lamp(l, lamp(LightType::kDirectional, 5), aimed()); }, 5, true},
      {"sun",
       [](Lights& l) {
         add_lamp(l, lamp(LightType::kDirectional, 5), aimed());
         l.scene.lights[0].angle = 0.6f;
       },
       5 * 2 * (1 - std::cos(0.3)) / std::pow(std::sin(0.3), 2), true},
      {"constant_environment",
       [](Lights& l) {
         l.scene.environments = {Environment{}};
         l.scene.environments[0].radiance = Rgb(0.5f);
       },
       4 * kPiD * 0.5, true},
      {"turning_sky",
       [](Lights& l) {
         l.scene.environments = {sky()};
         AnimatedTransform turning = moving();
         turning.translation = Vec3d{};
         l.scene.environments[0].node = add_node(l, turning);
       },
       0, true},
      {"sun_and_two_skies",
       [](Lights& l) {
         add_lamp(l, lamp(LightType::kDirectional, 5), aimed());
         l.scene.lights[0].angle = 0.6f;
         l.scene.environments = {sky(), Environment{}};
       },
       0, true}};
  for (const float half_spread : {0.05f, 0.5f, 1.2f}) {
    k.push_back({"spread_" + std::to_string(int(100 * half_spread)),
                 [=](Lights& l) {
                   l.add(rectangle, 3, half_spread == 0.5f);
                   l.scene.shapes.back().emission->half_spread = half_spread;
                 },
                 rectangle_power * (half_spread == 0.5f ? 2 : 1)});
  }
  for (const SpotFalloff falloff : {SpotFalloff::kLinear, SpotFalloff::kSquared, SpotFalloff::kSmoothstep}) {
    k.push_back({"spot_" + std::to_string(int(falloff)), [=](Lights& l) { add_lamp(l, spot(falloff), aimed()); },
                 7 * spot_integral(falloff)});
  }
  k.push_back({"several", [k](Lights& l) {
                 for (const Kind& one : k) {
                   if (one.name == "cube" || one.name == "two_sided_ellipse" || one.name == "soft_spot" ||
                       one.name == "projector" || one.name == "point" || one.name == "directional") {
                     one.build(l);
                   }
                 }
                 l.scene.environments = {sky()};
               }});
  return k;
}

class Emission : public testing::TestWithParam<Kind> {
 protected:
  void SetUp() override {
    add_matter(l_);
    GetParam().build(l_);
    l_.build();
  }
  Lights l_;
};

TEST_P(Emission, HasThePowerOfItsLight) {
  double power = GetParam().power;
  const double radius = double(l_.rays->bounds().radius());
  if (GetParam().infinite) {
    const auto e = emit(l_, 0);
    ASSERT_TRUE(e);
    EXPECT_NEAR(1 / e->pdf_position, kPiD * radius * radius, 0.01 * kPiD * radius * radius);
    power /= double(e->pdf_position);
  }
  std::vector<double> flux;
  double lowest = 1e30, highest = 0;
  for (std::uint64_t i = 0; i < 20000u * std::uint64_t(effort()); ++i) {
    const auto e = emit(l_, i);
    flux.push_back(e ? double(e->beta.r) : 0);
    lowest = std::min(lowest, flux.back()), highest = std::max(highest, flux.back());
    if (!e) continue;
    EXPECT_TRUE(std::isfinite(e->beta.r) && e->beta.r >= 0);
    EXPECT_NEAR(length(e->w), 1, 1e-5f);
    EXPECT_NEAR(length(e->n), e->delta_position ? 0 : 1, 1e-5f);
    const float cosine = e->delta_position ? 1 : std::abs(dot(e->n, e->w));
    const float beta = e->radiance.r * cosine / (e->pdf_choice * e->pdf_position * e->pdf_direction);
    EXPECT_NEAR(e->beta.r, beta, 1e-5f * beta);
  }
  if (power == 0) return;
  if (highest - lowest < 1e-3 * highest) {  // what varies is less than the rounding
    EXPECT_NEAR(highest, power, 1e-3 * power);
  } else {
    EXPECT_TRUE(MeanIs(power, flux));
  }
}

TEST_P(Emission, ComesWithTheDensitiesOfItsEnd) {
  int differ = 0, count = 0;
  for (std::uint64_t i = 0; i < 5000; ++i) {
    const auto e = emit(l_, i);
    if (!e) continue;
    ++count;
    const EmissionPdf pdf = l_.sampler->emission_pdf(*e, e->w, kTime);
    EXPECT_EQ(e->pdf_choice, pdf.choice);
    EXPECT_NEAR(e->pdf_position, pdf.position, 1e-5f * pdf.position);
    differ += std::abs(e->pdf_direction / pdf.direction - 1) > 1e-3f;  // at the border of two pixels of a picture
  }
  EXPECT_GE(count, 4990);
  EXPECT_LE(differ, 5);
}

// From one point, or from infinity, directions follow their density.
TEST_P(Emission, DirectionsFollowTheDensity) {
  if (GetParam().name == "several" || GetParam().name == "directional") return;
  const std::uint64_t fixed = 5;
  const auto end = emit(l_, fixed);
  ASSERT_TRUE(end);
  const auto result = chi_square(
      [&](int i) -> std::optional<Vec3f> {
        const auto k = std::uint64_t(i);
        const auto e = l_.sampler->emit(kTime, end->infinite ? number(k, 31) : number(fixed, 21),
                                        {number(fixed, 22), number(fixed, 23)}, {number(k, 32), number(k, 33)});
        if (!e) return std::nullopt;
        return e->w;
      },
      [&](const Vec3f& w) { return l_.sampler->emission_pdf(*end, w, kTime).direction; }, 30000,
      GetParam().name == "spread_5" ? 100 : 24, 5e-3);  // the quadrature's error at rims
  EXPECT_GT(result.p_value, 1e-4) << result.report;
}

// What arrives on a patch is what sample() finds from there.
TEST_P(Emission, ArrivesWhereSampledLightComesFrom) {
  struct Patch {
    Vec3f center, n;
    float radius;
  };
  const Patch patches[] = {{{0.5f, 0, 0}, normalize(Vec3f{0.1f, 0.2f, 1}), 0.6f},
                           {{-0.5f, 0.4f, 0.2f}, normalize(Vec3f{0.6f, 0.4f, 1}), 0.5f},
                           {{0.4f, -0.6f, 0}, normalize(Vec3f{0.2f, 0.5f, 0.6f}), 0.5f}};
  for (const Patch& patch : patches) {
    const float area = kPi * patch.radius * patch.radius;
    const Basis b(patch.n);
    std::vector<double> difference, sampled;
    for (std::uint64_t i = 0; i < 60000u * std::uint64_t(effort()); ++i) {
      double arriving = 0, found = 0;
      if (const auto e = emit(l_, i); e && dot(e->w, patch.n) < 0) {
        const float s = dot(patch.center - e->p, patch.n) / dot(e->w, patch.n);
        if (s > 0 && length(e->p + e->w * s - patch.center) < patch.radius) arriving = double(e->beta.r / area);
      }
      const Vec2f disk = square_to_disk({number(i, 41), number(i, 42)}) * patch.radius;
      const auto s = l_.sample(patch.center + b.s * disk.x + b.t * disk.y, kTime, i);
      if (s) found = double(s->radiance.r) * std::max(0.0, double(dot(s->wi, patch.n))) / double(s->pdf);
      difference.push_back(arriving - found);
      sampled.push_back(found);
    }
    double mean = 0;
    for (const double x : sampled) mean += x / double(sampled.size());
    if (mean == 0) {
      for (const double x : difference) EXPECT_EQ(x, 0);
      continue;
    }
    EXPECT_TRUE(MeanIs(0, difference, 1e-5)) << "of " << mean;
    for (double& x : difference) x -= 0.3 * mean;
    if (&patch == patches) {
      EXPECT_FALSE(MeanIs(0, difference)) << "the test would not notice a third";
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, Emission, testing::ValuesIn(kinds()), [](const auto& of) { return of.param.name; });

TEST(Emission, IsNothingWithoutPower) {
  Lights none;
  add_matter(none);
  none.build();
  EXPECT_FALSE(emit(none, 0));
  Lights dark;
  add_matter(dark);
  add_lamp(dark, lamp(LightType::kPoint, 0), aimed());
  dark.build();
  EXPECT_FALSE(emit(dark, 0));
}

// A light that is off at the time is chosen all the same: the table is one for the span.
TEST(Emission, IsBlackWhileTheLightIsOff) {
  Lights l;
  add_matter(l);
  PunctualLight light = lamp(LightType::kPoint, 7);
  light.intensity_scale = {{0, 0.5, 1}, {1.0f, 0.0f, 0.0f}, Interpolation::kLinear};
  add_lamp(l, light, aimed());
  l.build();
  const auto off = emit(l, 1, 0.75), on = emit(l, 1, 0.25);
  ASSERT_TRUE(off && on);
  EXPECT_TRUE(is_black(off->beta));
  EXPECT_EQ(off->pdf_choice, on->pdf_choice);
  EXPECT_NEAR(on->beta.r, 4 * kPi * 3.5f, 1e-3f);
}

// Hidden lights stay dark, also at the edges of the choice.
TEST(Emission, HiddenLightsAreNeverChosen) {
  Lights l;
  add_matter(l);
  for (int i = 0; i < 3; ++i) {
    add_lamp(l, lamp(LightType::kPoint, 1), aimed());
    if (i != 1) l.scene.nodes.back().visibility = 0.0f;
  }
  l.build();
  for (const float u : {0.0f, 0.3f, 0x1.fffffep-1f}) {
    const auto e = l.sampler->emit(kTime, u, {0.5f, 0.5f}, {0.5f, 0.5f});
    ASSERT_TRUE(e);
    EXPECT_EQ(e->light, 1u + 0);
    EXPECT_EQ(e->pdf_choice, 1);
  }
}

// The mean over the densities' reciprocals is what they are spread over: the area of a surface that has no even map.
TEST(Emission, PositionsCoverTheArea) {
  Lights l;
  add_matter(l);
  l.add(Sphere{placed({0.5f, 0.5f, 1.5f}, {0.2f, -0.5f, 2.5f})}, 2);
  l.build();
  std::vector<double> areas;
  for (std::uint64_t i = 0; i < 20000; ++i) {
    const auto e = emit(l, i);
    areas.push_back(e ? 1 / double(e->pdf_position) : 0);
  }
  const double a = 0.5, c = 1.5, eccentricity = std::sqrt(1 - a * a / (c * c));  // a prolate spheroid
  EXPECT_TRUE(MeanIs(2 * kPiD * a * a * (1 + c / (a * eccentricity) * std::asin(eccentricity)), areas));
}

}  // namespace
}  // namespace tempera
