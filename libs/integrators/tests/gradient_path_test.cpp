// SPDX-License-Identifier: Apache-2.0
#include "test_shot.h"

namespace tempera {
namespace {

Mesh quad(const Vec3f& center, const Vec3f& s, const Vec3f& t) {
  Mesh m;
  m.positions = {center - s - t, center + s - t, center + s + t, center - s + t};
  m.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  m.indices = {0, 1, 2, 0, 2, 3};
  return m;
}

/// An open box of 2 units, seen from +z, with one material for the floor and one for a ball.
struct BoxShot : TestShot {
  BoxShot(MaterialPtr floor, MaterialPtr ball) {
    const MaterialPtr white = make_two_sided(make_diffuse(0.7f)),
                      red = make_two_sided(make_diffuse(Rgb{0.6f, 0.1f, 0.1f}));
    add(quad({0, -1, 0}, {1, 0, 0}, {0, 0, -1}), std::move(floor));
    add(quad({0, 1, 0}, {1, 0, 0}, {0, 0, 1}), white);
    add(quad({0, 0, -1}, {1, 0, 0}, {0, 1, 0}), white);
    add(quad({-1, 0, 0}, {0, 0, 1}, {0, -1, 0}), red);
    add(quad({1, 0, 0}, {0, 0, 1}, {0, 1, 0}), white);
    if (ball) {
      add(Sphere{}, std::move(ball),
          node(Affine3d(translate(Vec3d{0.25, -0.5, 0.1}) * scale(Vec3d{0.45, 0.45, 0.45}))));
    }
    perspective(Affine3d(look_at(Vec3f{0.1f, 0.1f, 3.2f}, Vec3f{0, -0.1f, 0}, Vec3f{0, 1, 0})), 0.7f);
    settings.width = 24, settings.height = 20;
    settings.filter = PixelFilter(FilterKind::kBox);
    parameters = "max_depth=6";
  }
  BoxShot& area_light(float size = 0.3f) {
    add(quad({-0.1f, 0.98f, 0.1f}, {size, 0, 0}, {0, 0, size}), make_diffuse(0.2f)).emission =
        AreaEmission{Slot(4.0f), false};
    return *this;
  }
  BoxShot& lamp(LightType type) {
    PunctualLight light;
    light.type = type;
    light.intensity = Rgb(1.5f);
    light.cutoff_angle = 0.6f;
    light.beam_width = 0.5f;
    light.node = node(Affine3d(look_at(Vec3f{-0.3f, 0.8f, 0.5f}, Vec3f{0.2f, -0.8f, 0}, Vec3f{0, 0, 1})));
    scene.lights.push_back(light);
    return *this;
  }
  BoxShot& sky() {
    Environment e;
    e.radiance = Rgb{1, 1.2f, 1.5f};
    e.width = 16, e.height = 8;
    for (int i = 0; i < 128; ++i) e.image.push_back(i % 37 == 5 ? Rgb(6.0f) : Rgb(0.3f));
    scene.environments.push_back(e);
    return *this;
  }
};

/// How well the differences of gradient_path agree with those of converged pictures of the integrator path: means over
/// pixels and channels of the standardised residual and of its square.
struct Agreement {
  double z = 0, z2 = 0, largest = 0;
  int n = 0;
};

Agreement compare(const BoxShot& shot, int spp, int reference_spp) {
  BoxShot gradients = shot, reference = shot;
  gradients.integrator = "gradient_path";
  gradients.settings.spp = spp;
  gradients.settings.layers = {"color", "color.var", "grad.x", "grad.y", "grad.x.var", "grad.y.var"};
  reference.settings.spp = reference_spp;
  reference.settings.seed = 99;
  reference.settings.layers = {"color", "color.var"};
  if (const auto at = reference.parameters.find(",roughness_threshold"); at != std::string::npos)
    reference.parameters.resize(at);
  const Frame g = gradients.render(), r = reference.render();
  const Image &color = r.layer("color"), &var = r.layer("color.var");
  Agreement a;
  for (const auto& [name, dx, dy] : {std::tuple{"grad.x", 1, 0}, {"grad.y", 0, 1}}) {
    const Image &mean = g.layer(name), &v = g.layer(std::string(name) + ".var");
    for (int y = 0; y + dy < color.height(); ++y) {
      for (int x = 0; x + dx < color.width(); ++x) {
        const Rgb expected = color.rgb(x + dx, y + dy) - color.rgb(x, y);
        const Rgb variance = v.rgb(x, y) + var.rgb(x, y) + var.rgb(x + dx, y + dy);
        for (int c = 0; c < 3; ++c) {
          const double z = (mean.rgb(x, y)[c] - expected[c]) / std::sqrt(double(variance[c]) + 1e-12);
          a.z += z, a.z2 += z * z, ++a.n;
          a.largest = std::max(a.largest, std::abs(z));
        }
      }
    }
  }
  a.z /= a.n, a.z2 /= a.n;
  return a;
}

struct Case {
  const char* name;
  std::function<BoxShot()> shot;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class Gradients : public testing::TestWithParam<Case> {};

TEST_P(Gradients, AreTheDifferencesOfThePicture) {
  const Agreement a = compare(GetParam().shot(), 512, 8192);
  std::printf("%s: mean z %.3f, z2 %.3f, largest %.1f, n %d\n", GetParam().name, a.z, a.z2, a.largest, a.n);
  EXPECT_LT(a.z2, 1.25);
}

const MaterialPtr kWhite = make_diffuse(0.7f);
MaterialPtr rough(float alpha) {
  ConductorParams p;
  p.eta = Rgb{0.2f, 0.9f, 1.1f}, p.k = Rgb{3.9f, 2.4f, 2.2f};
  p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_conductor(p);
}
MaterialPtr glass(float alpha = 0) {
  DielectricParams p;
  if (alpha > 0) p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_dielectric(p);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, Gradients,
    testing::Values(
        Case{"diffuse", [] { return BoxShot(kWhite, kWhite).area_light(); }},
        Case{"penumbra", [] { return BoxShot(kWhite, kWhite).area_light(0.05f); }},
        Case{"point", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kPoint); }},
        Case{"spot", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kSpot); }},
        Case{"sky", [] { return BoxShot(kWhite, kWhite).sky(); }},
        Case{"glossy", [] { return BoxShot(rough(0.15f), kWhite).area_light(); }},
        Case{"glossy_copied",
             [] {
               BoxShot s = BoxShot(rough(0.15f), rough(0.3f)).area_light();
               s.parameters += ",roughness_threshold=0.5";
               return s;
             }},
        Case{"mirror", [] { return BoxShot(make_conductor({}), kWhite).area_light(); }},
        Case{"glass", [] { return BoxShot(kWhite, glass()).area_light(); }},
        Case{"rough_glass", [] { return BoxShot(kWhite, glass(0.2f)).area_light(); }},
        Case{"rough_glass_copied",
             [] {
               BoxShot s = BoxShot(kWhite, glass(0.2f)).area_light();
               s.parameters += ",roughness_threshold=0.5";
               return s;
             }},
        Case{"mixed",
             [] {
               return BoxShot(make_blend(0.5f, make_diffuse(0.6f), make_conductor({})), make_plastic({})).area_light();
             }},
        Case{"mask", [] { return BoxShot(kWhite, make_mask(0.5f, make_two_sided(make_diffuse(0.6f)))).area_light(); }},
        Case{"roulette",
             [] {
               BoxShot s = BoxShot(kWhite, kWhite).area_light();
               s.parameters = "rr_depth=1";
               return s;
             }}),
    [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace tempera
