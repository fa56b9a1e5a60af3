// SPDX-License-Identifier: Apache-2.0
// Properties that every BSDF must have: samples follow the density, weights sum to the integral, energy is not gained,
// reciprocity, event split, finite numbers everywhere.
#include <map>
#include <set>

#include "shading_test_util.h"
#include "support/chi_square.h"
#include "support/effort.h"
#include "tempera/shading/spectrum.h"

namespace tempera {
namespace {

using test::bsdf_of;
using test::effort;
using test::Random;

using Case = test::BsdfCase;

Roughness rough(float u, float v, Microfacets type, bool visible = true) { return {true, type, u, v, visible}; }

MaterialPtr principled(std::function<void(PrincipledParams&)> set) {
  PrincipledParams p;
  set(p);
  return make_principled(p);
}
MaterialPtr gltf(std::function<void(MetallicRoughnessParams&)> set) {
  MetallicRoughnessParams p;
  p.metallic = 0.0f;
  set(p);
  return make_metallic_roughness(p);
}

/// A normal map or height field that is constant or linear in uv.
class Plane final : public Texture {
 public:
  Plane(Rgb value, Vec2f slope) : value_(value), slope_(slope) {}
  Rgb rgb(const ShadingPoint&) const override { return value_; }
  Vec2f scalar_gradient(const ShadingPoint&) const override { return slope_; }
  Rgb mean() const override { return value_; }

 private:
  Rgb value_;
  Vec2f slope_;
};

const std::vector<Case>& cases() {
  static const std::vector<Case> all = [] {
    constexpr auto kGgx = Microfacets::kGgx;
    constexpr auto kBeckmann = Microfacets::kBeckmann;
    const Slot half = 0.5f, white = 1.0f;
    const auto mirror = [&](const Roughness& r) { return make_conductor({0.0f, 1.0f, white, r}); };
    const auto glass = [&](const Roughness& r, float ior = 1.5f) {
      return make_dielectric({ior, 1, white, white, false, r});
    };
    const auto plastic = [&](const Roughness& r, Slot diffuse, bool nonlinear) {
      return make_plastic({1.5f, 1, diffuse, white, nonlinear, r});
    };
    std::vector<Case> c;
    c.push_back({"diffuse", make_diffuse(white)});
    c.push_back({"mirror", mirror({})});
    c.push_back({"conductor_ggx", mirror(rough(0.3f, 0.3f, kGgx))});
    c.push_back({"conductor_beckmann", mirror(rough(0.3f, 0.3f, kBeckmann))});
    c.push_back({"conductor_anisotropic_ggx", mirror(rough(0.5f, 0.2f, kGgx))});
    c.push_back({"conductor_anisotropic_beckmann", mirror(rough(0.2f, 0.6f, kBeckmann))});
    c.push_back({"conductor_all_normals_ggx", mirror(rough(0.3f, 0.2f, kGgx, false))});
    c.push_back({"conductor_all_normals_beckmann", mirror(rough(0.25f, 0.4f, kBeckmann, false))});
    c.push_back({"dielectric", glass({}), true, 1.5f});
    c.push_back({"thin_dielectric", make_dielectric({1.5f, 1, white, white, true, {}}), true});
    c.push_back({"dielectric_ggx", glass(rough(0.3f, 0.3f, kGgx)), true, 1.5f});
    c.push_back({"dielectric_beckmann", glass(rough(0.4f, 0.2f, kBeckmann)), true, 1.5f});
    c.push_back({"dielectric_all_normals", glass(rough(0.3f, 0.3f, kGgx, false)), true, 1.5f});
    c.push_back({"dielectric_diamond", glass(rough(0.3f, 0.3f, kGgx), 2.4f), true, 2.4f});
    c.push_back({"dielectric_beckmann_bubble", glass(rough(0.3f, 0.3f, kBeckmann), 1 / 1.33f), true, 1 / 1.33f});
    c.push_back({"plastic", plastic({}, white, false)});
    c.push_back({"plastic_nonlinear", plastic({}, half, true)});
    c.push_back({"rough_plastic_ggx", plastic(rough(0.3f, 0.3f, kGgx), white, true)});
    c.push_back({"rough_plastic_beckmann", plastic(rough(0.2f, 0.2f, kBeckmann), half, false)});
    // Burley's retro-reflection and sheen gain energy at grazing angles by design, and so does the coat without
    // layering.
    c.push_back({"principled", principled([](auto& p) { p.roughness = 0.4f; }), false, 1, true, 0.6f});
    c.push_back({"principled_metal", principled([](auto& p) { p.metallic = 1.0f, p.anisotropic = 0.8f; })});
    c.push_back({"principled_all", principled([](auto& p) {
                   p.roughness = 0.7f, p.sheen = 1.0f, p.flatness = 0.5f, p.clearcoat = 1.0f, p.spec_tint = 0.5f;
                 }),
                 false, 1, true, 1.2f});
    c.push_back({"principled_glass",
                 principled([](auto& p) { p.base_color = 1.0f, p.spec_trans = 1.0f, p.roughness = 0.5f; }), true,
                 1.5f});
    c.push_back({"gltf_dielectric", gltf([](auto& p) { p.roughness = 0.5f; })});
    c.push_back({"gltf_polished", gltf([](auto& p) { p.roughness = 0.0f; })});
    c.push_back({"gltf_metal", gltf([](auto& p) { p.metallic = 1.0f, p.roughness = 0.6f; })});
    c.push_back({"gltf_anisotropic", gltf([](auto& p) {
                   p.metallic = 0.5f, p.roughness = 0.5f, p.anisotropy = 0.8f, p.anisotropy_rotation = 0.6f;
                 })});
    c.push_back({"gltf_specular", gltf([](auto& p) {
                   p.specular = 0.7f, p.specular_color = Rgb{1, 0.2f, 3}, p.roughness = 0.4f;
                 })});
    c.push_back({"gltf_coat", gltf([](auto& p) { p.clearcoat = 1.0f, p.clearcoat_roughness = 0.5f; })});
    c.push_back({"gltf_sheen", gltf([](auto& p) { p.sheen_color = 1.0f, p.sheen_roughness = 0.6f; })});
    c.push_back({"gltf_everything", gltf([](auto& p) {
                   p.metallic = 0.3f, p.roughness = 0.4f, p.clearcoat = 0.8f, p.clearcoat_roughness = 0.4f;
                   p.sheen_color = Rgb{0.5f, 0.3f, 0.1f}, p.sheen_roughness = 0.5f, p.transmission = 0.4f;
                 }),
                 true});
    c.push_back({"gltf_thin", gltf([](auto& p) { p.transmission = 1.0f, p.roughness = 0.0f; }), true});
    c.push_back({"gltf_frosted_sheet", gltf([](auto& p) { p.transmission = 1.0f, p.roughness = 0.6f; }), true});
    c.push_back({"gltf_glass", gltf([](auto& p) { p.transmission = 1.0f, p.roughness = 0.0f, p.thin_walled = false; }),
                 true, 1.5f});
    c.push_back({"gltf_frosted_glass",
                 gltf([](auto& p) { p.transmission = 0.7f, p.roughness = 0.6f, p.thin_walled = false; }), true, 1.5f});
    c.push_back({"blend", make_blend(0.4f, make_diffuse(0.8f), mirror(rough(0.3f, 0.3f, kGgx)))});
    c.push_back({"blend_of_blends",
                 make_blend(0.3f, make_blend(0.5f, plastic({}, half, false), glass(rough(0.3f, 0.3f, kGgx))),
                            make_diffuse(half)),
                 true, 1.5f});
    const auto tilted = std::make_shared<Plane>(Rgb{0.7f, 0.4f, 0.9f}, Vec2f{});
    c.push_back({"normal_map", make_normal_map(tilted, 1, plastic(rough(0.3f, 0.3f, kGgx), half, false)), false, 1,
                 false, 0.1f});
    c.push_back({"bump",
                 make_bump(std::make_shared<Plane>(Rgb(0.0f), Vec2f{0.3f, -0.2f}), 1, mirror(rough(0.3f, 0.5f, kGgx))),
                 false, 1, false});
    c.push_back({"coat_on_normal_map", make_normal_map(tilted, 1, gltf([](auto& p) {
                                                         p.clearcoat = 1.0f, p.clearcoat_roughness = 0.5f,
                                                         p.roughness = 0.6f;
                                                       })),
                 false, 1, false, 0.1f});
    for (const auto& make : test::added_bsdf_cases()) c.push_back(make());
    return c;
  }();
  return all;
}

std::vector<Vec3f> view_directions(const Case& c) {
  std::vector<Vec3f> w = {normalize(Vec3f{0.1f, 0.05f, 1}), normalize(Vec3f{0.6f, -0.5f, 0.7f}),
                          normalize(Vec3f{-1, 0.3f, 0.25f})};
  if (c.transmits && c.eta != 1) w.push_back(normalize(Vec3f{0.3f, 0.4f, -0.8f}));
  return w;
}

constexpr double kSignificance = 0.01;  // for each family of tests, by Šidák

TEST(BsdfStatistics, SamplesFollowTheDensity) {
  struct Outcome {
    std::string what;
    test::ChiSquareResult result;
  };
  std::vector<Outcome> outcomes;
  constexpr double kMaskingError = 0.0035;   // of the fit that stands for Beckmann's masking [Walter 2007, Sec. 5.2]
  const int nodes = effort() > 1 ? 40 : 10;  // refraction has edges, which few samples do not show
  for (const Case& c : cases())
    for (const Vec3f& wo : view_directions(c)) {
      const Bsdf bsdf = bsdf_of(*c.material, wo);
      ASSERT_FALSE(bsdf.empty()) << c.name;
      if (!bsdf.has_non_delta()) continue;
      Random random(outcomes.size() + 1);
      const auto sample = [&](int) -> std::optional<Vec3f> {
        const float u = random();
        const auto s = bsdf.sample(wo, u, random.pair());
        if (!s || s->delta) return std::nullopt;
        return s->wi;
      };
      const double masking_error = c.name.find("beckmann") != c.name.npos ? kMaskingError : 0;
      const auto density = [&](const Vec3f& wi) { return bsdf.eval(wo, wi).pdf; };
      outcomes.push_back({c.name + " at " + std::to_string(wo.z),
                          test::chi_square(sample, density, 60000 * effort(), nodes, masking_error)});
    }
  const double limit = 1 - std::pow(1 - kSignificance, 1.0 / double(outcomes.size()));
  for (const Outcome& o : outcomes) EXPECT_GT(o.result.p_value, limit) << o.what << ": " << o.result.report;
  EXPECT_GT(outcomes.size(), 100u);
}

TEST(BsdfStatistics, TheChiSquareTestRejectsAWrongDensity) {
  const Vec3f wo = normalize(Vec3f{0.6f, -0.5f, 0.7f});
  const auto metal = [](float alpha) {
    return make_conductor({0.0f, 1.0f, 1.0f, rough(alpha, alpha, Microfacets::kGgx)});
  };
  const Bsdf right = bsdf_of(*metal(0.3f), wo), wrong = bsdf_of(*metal(0.32f), wo);
  Random random(1);
  const auto sample = [&](int) -> std::optional<Vec3f> {
    const auto s = right.sample(wo, 0, random.pair());
    return s ? std::optional(s->wi) : std::nullopt;
  };
  const auto test = [&](const Bsdf& bsdf) {
    return test::chi_square(
               sample, [&](const Vec3f& wi) { return bsdf.eval(wo, wi).pdf; }, 60000)
        .p_value;
  };
  EXPECT_GT(test(right), 1e-3);
  EXPECT_LT(test(wrong), 1e-6);
}

TEST(BsdfStatistics, TailOfTheChiSquareDistribution) {  // closed forms: exp(-x/2) for 2 degrees, erfc for 1
  EXPECT_NEAR(test::chi_square_tail(3, 2), std::exp(-1.5), 1e-12);
  EXPECT_NEAR(test::chi_square_tail(0.5, 1), std::erfc(0.5), 1e-12);
  EXPECT_NEAR(test::chi_square_tail(9, 1), std::erfc(std::sqrt(4.5)), 1e-12);
  EXPECT_NEAR(test::chi_square_tail(1000, 1000), 0.4940530, 1e-6);
}

/// Sum over directions of f cos, by quadrature (non-delta) and by sampling (all), as power: times eta^2 across
/// interfaces.
struct Albedo {
  double quadrature[kEventCount] = {};  ///< of the non-delta part, mean over channels
  double mean = 0, standard_error = 0;  ///< of the sample weights of the non-delta part
  double delta = 0, power = 0;          ///< of the delta part; of everything
};
Albedo albedo_of(const Bsdf& bsdf, const Vec3f& wo, float eta, int samples, std::uint64_t seed) {
  Albedo a;
  constexpr int kTheta = 240, kPhi = 240;
  const float scale = wo.z > 0 ? eta : 1 / eta;
  for (int i = 0; i < kTheta; ++i)
    for (int j = 0; j < kPhi; ++j) {
      const float theta = kPi * (float(i) + 0.5f) / kTheta, phi = 2 * kPi * (float(j) + 0.5f) / kPhi;
      const float z = std::cos(theta), r = std::sin(theta);
      const double solid_angle = 2 * kPiD * kPiD * double(r) / (kTheta * kPhi);
      const BsdfEval e = bsdf.eval(wo, {r * std::cos(phi), r * std::sin(phi), z});
      for (std::size_t k = 0; k < kEventCount; ++k) a.quadrature[k] += double(mean(e.f_cos[k])) * solid_angle;
      a.power += double(mean(e.sum())) * (z * wo.z < 0 ? double(scale * scale) : 1.0) * solid_angle;
    }
  Random random(seed);
  double sum = 0, squares = 0;
  for (int i = 0; i < samples; ++i) {
    // Lobes are chosen by strata, so that the sum over delta lobes has no noise to speak of.
    const auto s = bsdf.sample(wo, (float(i) + random()) / float(samples), random.pair());
    if (!s) continue;
    const double w = double(mean(s->sum()) / s->pdf);
    if (s->delta) {
      a.delta += w / samples;
      a.power += w * double(s->eta * s->eta) / samples;
    } else {
      sum += w, squares += w * w;
    }
  }
  a.mean = sum / samples;
  a.standard_error = std::sqrt(std::max(squares / samples - a.mean * a.mean, 0.0) / samples);
  return a;
}

TEST(BsdfStatistics, SampleWeightsSumToTheIntegralAndEnergyIsNotGained) {
  std::uint64_t seed = 100;
  for (const Case& c : cases())
    for (const Vec3f& wo : view_directions(c)) {
      const Bsdf bsdf = bsdf_of(*c.material, wo);
      const Albedo a = albedo_of(bsdf, wo, c.eta, 20000 * effort(), ++seed);
      const double integral = a.quadrature[0] + a.quadrature[1] + a.quadrature[2];
      EXPECT_NEAR(a.mean, integral, 4.5 * a.standard_error + 4e-3 * integral) << c.name << " at " << wo.z;
      EXPECT_LE(a.power, 1 + 0.01 + double(c.gain)) << c.name << " at " << wo.z;
    }
}

TEST(BsdfStatistics, LosslessInterfacesKeepAllEnergy) {
  // Smooth interfaces exactly. Of rough ones single scattering loses little at small alpha, and less the rounder the
  // facets.
  for (const Case& c : cases())
    for (const Vec3f& wo : view_directions(c)) {
      if (c.name != "dielectric" && c.name != "thin_dielectric" && c.name != "mirror" && c.name != "gltf_thin" &&
          c.name != "gltf_glass")
        continue;
      EXPECT_NEAR(albedo_of(bsdf_of(*c.material, wo), wo, c.eta, 10000, 7).power, 1, 2e-4) << c.name << " at " << wo.z;
    }
  const Vec3f wo = normalize(Vec3f{0.6f, -0.5f, 0.7f});
  for (const auto type : {Microfacets::kGgx, Microfacets::kBeckmann})
    for (const float alpha : {0.02f, 0.1f, 0.3f}) {
      double power[2];
      for (const bool metal : {false, true}) {
        const Roughness r = rough(alpha, alpha, type);
        const auto m = metal ? make_conductor({0.0f, 1.0f, 1.0f, r}) : make_dielectric({1.5f, 1, 1.0f, 1.0f, false, r});
        const Bsdf bsdf = bsdf_of(*m, wo);
        Random random(3);
        double sum = 0;
        constexpr int kSamples = 20000;
        for (int i = 0; i < kSamples; ++i) {
          const float u = random();
          if (const auto s = bsdf.sample(wo, u, random.pair())) sum += double(s->sum().g / s->pdf * s->eta * s->eta);
        }
        power[metal] = sum / kSamples;
        EXPECT_LE(power[metal], 1.001) << alpha;
        EXPECT_GT(power[metal], 1 - 0.6 * double(alpha)) << alpha;
      }
      EXPECT_GT(power[0], power[1] - 2e-3) << "refraction is masked less than reflection, alpha " << alpha;
    }
}

TEST(BsdfStatistics, Reciprocity) {
  for (const Case& c : cases()) {
    if (!c.reciprocal) continue;
    Random random(11);
    int compared = 0;
    for (int i = 0; i < 400; ++i) {
      const Vec3f a = c.transmits ? random.sphere() : random.hemisphere(),
                  b = c.transmits ? random.sphere() : random.hemisphere();
      if (std::abs(a.z) < 0.05f || std::abs(b.z) < 0.05f) continue;
      const Rgb ab = bsdf_of(*c.material, a).eval(a, b).sum() / std::abs(b.z);
      const Rgb ba = bsdf_of(*c.material, b).eval(b, a).sum() / std::abs(a.z);
      // f(wo, wi) / eta_o^2 = f(wi, wo) / eta_i^2 [Veach 1997, Eq. 5.14].
      const auto index = [&](const Vec3f& w) { return w.z > 0 ? 1.0f : c.eta; };
      const float eta_a = sqr(index(a)), eta_b = sqr(index(b));
      for (int k = 0; k < 3; ++k)
        EXPECT_NEAR(ab[k] / eta_a, ba[k] / eta_b, 2e-3f * std::max(ab[k] / eta_a, ba[k] / eta_b) + 1e-5f)
            << c.name << " a " << a.x << " " << a.y << " " << a.z << " b " << b.x << " " << b.y << " " << b.z;
      compared += max_component(ab) > 0;
    }
    if (bsdf_of(*c.material, Vec3f{0, 0, 1}).has_non_delta()) {
      EXPECT_GT(compared, 100) << c.name;
    }
  }
}

TEST(BsdfStatistics, SwappedArgumentsOfOneBsdfAgreeWithTheBsdfSeenFromThere) {  // light subpaths rely on it
  for (const Case& c : cases()) {
    if (c.transmits || !c.reciprocal) continue;
    Random random(12);
    for (int i = 0; i < 100; ++i) {
      const Vec3f a = random.hemisphere(), b = random.hemisphere();
      if (a.z < 0.05f || b.z < 0.05f) continue;
      const Rgb here = bsdf_of(*c.material, a).eval(b, a).sum(), there = bsdf_of(*c.material, b).eval(b, a).sum();
      for (int k = 0; k < 3; ++k) EXPECT_NEAR(here[k], there[k], 1e-3f * there[k] + 1e-5f) << c.name;
    }
  }
}

TEST(Bsdf, EventsFollowKindAndRoughness) {
  const Vec3f wo = normalize(Vec3f{0.3f, 0.2f, 0.9f});
  const auto events = [&](const MaterialPtr& m) {
    const Bsdf bsdf = bsdf_of(*m, wo);
    std::map<Event, int> count;
    Random random(5);
    for (int i = 0; i < 300; ++i) {
      const float u = random();
      const auto s = bsdf.sample(wo, u, random.pair());
      if (!s) continue;
      ++count[s->event];
      EXPECT_EQ(s->transmitted, s->wi.z < 0);
      EXPECT_EQ(s->delta, s->roughness == 0);
      EXPECT_GT(max_component(s->f_cos[std::size_t(s->event)]), 0) << "the sampled event has a value";
      EXPECT_EQ(s->eta != 1, s->transmitted);
      if (s->delta) {
        EXPECT_EQ(bsdf.eval(wo, s->wi).f_cos[std::size_t(s->event)], Rgb(0.0f)) << "deltas are not evaluated";
      }
    }
    std::string letters;
    for (const auto& [e, n] : count) letters += e == Event::kDiffuse ? 'D' : e == Event::kReflection ? 'R' : 'T';
    return letters;
  };
  constexpr auto kGgx = Microfacets::kGgx;
  const auto glass = [](const Roughness& r) { return make_dielectric({1.5f, 1, 1.0f, 1.0f, false, r}); };
  EXPECT_EQ(events(make_diffuse(0.5f)), "D");
  EXPECT_EQ(events(make_conductor({})), "R");
  EXPECT_EQ(events(make_conductor({0.0f, 1.0f, 1.0f, rough(0.099f, 0.05f, kGgx)})), "R");
  EXPECT_EQ(events(make_conductor({0.0f, 1.0f, 1.0f, rough(0.01f, 0.1f, kGgx)})), "D");
  EXPECT_EQ(events(glass({})), "RT");
  EXPECT_EQ(events(glass(rough(0.05f, 0.05f, kGgx))), "RT");
  EXPECT_EQ(events(glass(rough(0.2f, 0.2f, kGgx))), "D");
  EXPECT_EQ(events(make_plastic({1.5f, 1, 0.5f, 1.0f, false, {}})), "DR");
  EXPECT_EQ(events(make_plastic({1.5f, 1, 0.5f, 1.0f, false, rough(0.05f, 0.05f, kGgx)})), "DR");
}

TEST(Bsdf, BlendIsLinearAndItsProbabilitiesAre) {
  const auto a = make_plastic({1.5f, 1, 0.5f, 1.0f, false, rough(0.3f, 0.3f, Microfacets::kGgx)});
  const auto b = make_principled({});
  const auto mixed = make_blend(0.3f, a, b);
  Random random(9);
  for (int i = 0; i < 200; ++i) {
    const Vec3f wo = random.hemisphere(), wi = random.hemisphere();
    const BsdfEval ea = bsdf_of(*a, wo).eval(wo, wi), eb = bsdf_of(*b, wo).eval(wo, wi),
                   e = bsdf_of(*mixed, wo).eval(wo, wi);
    EXPECT_NEAR(e.sum().r, 0.7f * ea.sum().r + 0.3f * eb.sum().r, 1e-5f * (1 + e.sum().r));
    EXPECT_NEAR(e.pdf, 0.7f * ea.pdf + 0.3f * eb.pdf, 1e-5f * (1 + e.pdf));
  }
}

TEST(Bsdf, NumbersAreFiniteAndConsistentEverywhere) {
  Random random(21);
  std::vector<MaterialPtr> materials;
  for (const Case& c : cases()) materials.push_back(c.material);
  for (int i = 0; i < 60; ++i) {
    const float a = std::pow(10.0f, -3 * random()), b = random() < 0.5f ? a : std::pow(10.0f, -3 * random());
    const auto type = random() < 0.5f ? Microfacets::kGgx : Microfacets::kBeckmann;
    const Roughness r = rough(a, b, type, random() < 0.8f);
    const float eta = i % 3 == 0 ? 1 + 1e-5f * (random() - 0.5f) : 0.4f + 2 * random();
    materials.push_back(make_dielectric({eta, 1, 1.0f, 1.0f, false, r}));
    materials.push_back(make_conductor({random(), 4 * random(), 1.0f, r}));
    materials.push_back(principled([&](auto& p) {
      p.roughness = random(), p.metallic = random(), p.spec_trans = random(), p.eta = eta, p.clearcoat = random();
      p.clearcoat_gloss = random(), p.anisotropic = random(), p.sheen = random(), p.spec_tint = random();
    }));
    materials.push_back(gltf([&](auto& p) {
      p.roughness = random(), p.metallic = random(), p.transmission = random() < 0.5f ? 0 : random(),
      p.clearcoat = random();
      p.clearcoat_roughness = random() < 0.3f ? 0 : random(), p.sheen_color = random(), p.sheen_roughness = random();
      p.thin_walled = random() < 0.5f, p.ior = 1 + random(), p.anisotropy = random();
    }));
  }
  const auto direction = [&] {
    Vec3f w = random.sphere();
    const float kind = random();
    if (kind < 0.15f) w.z = 1e-7f * (random() - 0.5f);
    if (kind > 0.15f && kind < 0.2f) w.z = 0;
    if (kind > 0.2f && kind < 0.3f) w = {1e-5f * random(), 0, w.z};
    return normalize(w);
  };
  const auto check = [](const BsdfEval& e, const char* what) {
    EXPECT_TRUE(std::isfinite(e.pdf) && e.pdf >= 0) << what << " pdf " << e.pdf;
    for (const Rgb& f : e.f_cos) {
      EXPECT_TRUE(is_finite(f)) << what << " f " << f.r << " " << f.g << " " << f.b << " pdf " << e.pdf;
      EXPECT_GE(std::min({f.r, f.g, f.b}), 0) << what;
    }
  };
  for (const MaterialPtr& m : materials)
    for (int i = 0; i < 200; ++i) {
      const Vec3f wo = direction(), wi = i % 7 == 0 ? -wo : direction();
      const Bsdf bsdf = bsdf_of(*m, wo);
      check(bsdf.eval(wo, wi), "eval");
      const float u = random();
      const auto s = bsdf.sample(wo, u, random.pair());
      if (s) {
        EXPECT_NEAR(length(s->wi), 1, 1e-4f);
        BsdfEval e;
        e.f_cos = s->f_cos, e.pdf = s->pdf;
        check(e, "sample");
        EXPECT_GT(s->pdf, 0);
        if (!s->delta) {
          const BsdfEval again = bsdf.eval(wo, s->wi);
          EXPECT_NEAR(again.pdf, s->pdf, 2e-3f * s->pdf);  // through world space and back
        }
      }
      const Rgb albedo = bsdf.albedo(wo);
      EXPECT_TRUE(is_finite(albedo) && std::min({albedo.r, albedo.g, albedo.b}) >= 0);
    }
}

TEST(Bsdf, AlbedoIsTheIntegralOfPower) {
  for (const Case& c : cases()) {
    if (!c.reciprocal) continue;  // bumped surfaces, which lose light at the horizon
    for (const Vec3f& wo : view_directions(c)) {
      const Bsdf bsdf = bsdf_of(*c.material, wo);
      const double exact = albedo_of(bsdf, wo, c.eta, 4000, 1).power;
      // Tables are of round facets.
      const bool anisotropic = c.name.find("anisotropic") != std::string::npos || c.name == "principled_metal";
      EXPECT_NEAR(double(mean(bsdf.albedo(wo))), exact, anisotropic ? 0.08 : 0.03) << c.name << " at " << wo.z;
    }
  }
}

TEST(Bsdf, AlbedoOfWhatLosesNothingIsOne) {
  struct Lossless {
    std::string name;
    MaterialPtr material;
    double tolerance;
  };
  const auto glass = [](bool thin, const Roughness& r = {}, float ior = 1.5f) {
    return make_dielectric({ior, 1, 1.0f, 1.0f, thin, r});
  };
  // What is nearly smooth loses little between its facets. Deltas and diffuse surfaces have closed forms.
  const Roughness fine = rough(0.02f, 0.02f, Microfacets::kGgx),
                  fine_beckmann = rough(0.02f, 0.02f, Microfacets::kBeckmann);
  const auto solid = [](float roughness) {
    return gltf([&](auto& p) { p.transmission = 1.0f, p.roughness = roughness, p.thin_walled = false; });
  };
  std::vector<Lossless> all{
      {"diffuse", make_diffuse(1.0f), 1e-6},
      {"two-sided diffuse", make_two_sided(make_diffuse(1.0f)), 1e-6},
      {"mirror", make_conductor({}), 1e-6},
      {"rough mirror", make_conductor({0.0f, 1.0f, 1.0f, fine}), 0.02},
      {"glass", glass(false), 1e-5},
      {"diamond", glass(false, {}, 2.4f), 1e-5},
      {"bubble", glass(false, {}, 1 / 1.33f), 1e-5},
      {"rough glass", glass(false, fine), 0.02},
      {"rough glass of Beckmann facets", glass(false, fine_beckmann), 0.02},
      {"thin glass", glass(true), 1e-5},
      {"principled glass", principled([](auto& p) { p.base_color = 1.0f, p.spec_trans = 1.0f, p.roughness = 0.1f; }),
       0.02},
      {"glTF glass", solid(0), 1e-5},
      {"glTF rough glass", solid(0.1f), 0.02},
      {"glTF pane", gltf([](auto& p) { p.transmission = 1.0f, p.roughness = 0.0f; }), 1e-5},
      {"glTF frosted pane", gltf([](auto& p) { p.transmission = 1.0f, p.roughness = 0.1f; }), 0.02},
      {"glTF metal", gltf([](auto& p) { p.metallic = 1.0f, p.roughness = 0.0f; }), 1e-5},
      {"blend", make_blend(0.3f, glass(false), glass(true)), 1e-5},
      {"mask", make_mask(0.5f, glass(false)), 1e-5},
  };
  for (const Lossless& l : all)
    for (const Vec3f& wo : {Vec3f{0, 0, 1}, Vec3f{0.6f, 0, 0.8f}, Vec3f{0, 0.9539392f, 0.3f}, Vec3f{0.6f, 0, -0.8f}}) {
      const Bsdf bsdf = bsdf_of(*l.material, wo);
      if (bsdf.empty()) continue;  // opaque from behind
      const Rgb albedo = bsdf.albedo(wo);
      for (int k = 0; k < 3; ++k) EXPECT_NEAR(double(albedo[k]), 1, l.tolerance) << l.name << " at " << wo.z;
    }
}

TEST(Bsdf, AlbedoOfTintedGlassIsItsReflectanceAndTransmittance) {
  const Vec3f wo{0.6f, 0, 0.8f};
  const double r = double(dielectric_interface(wo.z, 1.5f).reflectance);
  const auto expect = [&](const MaterialPtr& m, const Vec3f& w, std::array<double, 3> exact, double tolerance) {
    const Rgb albedo = bsdf_of(*m, w).albedo(w);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(double(albedo[k]), exact[k], tolerance);
  };
  const Rgb reflectance{0.9f, 0.5f, 0.1f}, transmittance{0.2f, 0.6f, 1};
  const std::array<double, 3> tinted{0.9 * r + 0.2 * (1 - r), 0.5 * r + 0.6 * (1 - r), 0.1 * r + (1 - r)};
  expect(make_dielectric({1.5f, 1, reflectance, transmittance, false, {}}), wo, tinted, 1e-5);
  expect(make_dielectric({1.5f, 1, reflectance, transmittance, false, rough(0.02f, 0.02f, Microfacets::kGgx)}), wo,
         tinted, 0.02);
  // From inside at this angle all light is reflected, and nothing tinted by what passes.
  expect(make_dielectric({1.5f, 1, reflectance, transmittance, false, {}}), {0.8f, 0, -0.6f}, {0.9, 0.5, 0.1}, 1e-5);
  const double two = 2 * r / (1 + r);
  expect(make_dielectric({1.5f, 1, reflectance, transmittance, true, {}}), wo,
         {0.9 * two + 0.2 * (1 - two), 0.5 * two + 0.6 * (1 - two), 0.1 * two + (1 - two)}, 1e-5);
  // glTF: the base color tints what passes, by its square root where a solid shall be tinted once in all.
  const double s = double(schlick_weight(wo.z)), f = 0.04 + 0.96 * s;
  for (const bool once : {false, true})
    expect(gltf([&](auto& p) {
             p.transmission = 1.0f, p.roughness = 0.0f, p.thin_walled = false, p.base_color = Rgb{0.25f, 0.5f, 1};
             p.tints_once = once;
           }),
           wo, {f + (once ? 0.5 : 0.25) * (1 - f), f + (once ? std::sqrt(0.5) : 0.5) * (1 - f), 1}, 1e-5);
  // A thin pane is crossed once.
  expect(gltf([&](auto& p) {
           p.transmission = 1.0f, p.roughness = 0.0f, p.base_color = Rgb{0.25f, 0.5f, 1}, p.tints_once = true;
         }),
         wo, {f + 0.25 * (1 - f), f + 0.5 * (1 - f), 1}, 1e-5);
  expect(principled([](auto& p) {
           p.base_color = Rgb{0.25f, 0.5f, 1}, p.spec_trans = 1.0f, p.roughness = 0.1f;
         }),
         wo, {r + 0.5 * (1 - r), r + std::sqrt(0.5) * (1 - r), 1}, 0.02);
}

TEST(Bsdf, LobesBeyondTheCapacityAreRefusedWhenTheMaterialIsBuilt) {
  MaterialPtr m = make_plastic({});
  try {
    for (int i = 0; i < 5; ++i) m = make_blend(0.5f, m, m);
    FAIL() << "64 lobes were accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
  }
}

TEST(Bsdf, OneSidedMaterialsAreBlackFromBehindAndTwoSidedOnesAreNot) {
  const Vec3f below{0.3f, 0.2f, -0.9f};
  EXPECT_TRUE(bsdf_of(*make_diffuse(0.5f), below).empty());
  const Bsdf both = bsdf_of(*make_two_sided(make_diffuse(0.5f)), below);
  EXPECT_NEAR(both.eval(below, {0, 0, -1}).sum().g, 0.5f * kInvPi, 1e-6f);
  EXPECT_EQ(both.eval(below, {0, 0, 1}).pdf, 0);
}

TEST(MaterialCatalog, EveryTypeScattersByItsDefaults) {
  std::set<std::string> names;
  for (const MaterialEntry* e : material_catalog()) {
    EXPECT_TRUE(names.insert(e->name).second) << e->name;
    EXPECT_EQ(find_material(e->name), e);
    EXPECT_FALSE(bsdf_of(*test::catalog_material(e->name), Vec3f{0, 0, 1}).empty()) << e->name;
  }
  EXPECT_EQ(find_material("diffus"), nullptr);
}

TEST(Mask, OpacityIsAskedSeparately) {
  const auto m = make_mask(0.25f, make_diffuse(0.5f));
  const ShadingPoint p = test::plane_point({0, 0, 1});
  EXPECT_TRUE(m->has_opacity());
  EXPECT_FLOAT_EQ(m->opacity(p), 0.25f);
  EXPECT_FLOAT_EQ(bsdf_of(*m, p).eval({0, 0, 1}, {0, 0, 1}).sum().r, 0.5f * kInvPi);
  // A blend of a mask and an opaque material: half of the light interacts with the mask, if it is not let through.
  const auto mixed = make_blend(0.5f, m, make_diffuse(0.9f));
  EXPECT_FLOAT_EQ(mixed->opacity(p), 0.625f);
  EXPECT_NEAR(mixed->opacity(p) * bsdf_of(*mixed, p).eval({0, 0, 1}, {0, 0, 1}).sum().r,
              (0.5f * 0.25f * 0.5f + 0.5f * 0.9f) * kInvPi, 1e-6f);
}

TEST(MetallicRoughness, NeverGainsEnergy) {
  // A white dielectric: what the simple Fresnel mix of the specification would reflect comes close to 2 here.
  for (const float roughness : {0.05f, 0.3f, 1.0f})
    for (const float cosine : {0.02f, 0.1f, 0.5f, 1.0f}) {
      const auto m = gltf([&](auto& p) { p.roughness = roughness; });
      const Vec3f wo{std::sqrt(1 - cosine * cosine), 0, cosine};
      const Bsdf bsdf = bsdf_of(*m, wo);
      Random random(17);
      double sum = 0;
      constexpr int kSamples = 40000;
      for (int i = 0; i < kSamples; ++i) {
        const float u = random();
        if (const auto s = bsdf.sample(wo, u, random.pair())) sum += double(s->sum().g / s->pdf);
      }
      EXPECT_LE(sum / kSamples, 1.015) << roughness << " " << cosine;
      EXPECT_GE(sum / kSamples, 0.7) << roughness << " " << cosine;
    }
}

TEST(MetallicRoughness, SpecialCases) {
  const Vec3f wo{0, 0, 1};
  // Head-on, a polished dielectric reflects ((ior - 1) / (ior + 1))^2, times specular and its color, and a metal its
  // color.
  const auto mirror = [&](const MaterialPtr& m) {
    const Bsdf b = bsdf_of(*m, wo);
    return b.sample_delta(0, wo)->sum();
  };
  EXPECT_NEAR(mirror(gltf([](auto& p) { p.roughness = 0.0f; })).g, 0.04f, 1e-5f);
  EXPECT_NEAR(mirror(gltf([](auto& p) { p.roughness = 0.0f, p.ior = 2.0f; })).g, 1 / 9.0f, 1e-5f);
  EXPECT_NEAR(mirror(gltf([](auto& p) {
                p.roughness = 0.0f, p.specular = 0.5f, p.specular_color = Rgb{0, 1, 2};
              })).b,
              0.04f, 1e-5f);
  EXPECT_NEAR(mirror(gltf([](auto& p) { p.roughness = 0.0f, p.ior = 0; })).g, 1.0f, 1e-5f);
  EXPECT_NEAR(mirror(gltf([](auto& p) {
                p.roughness = 0.0f, p.metallic = 1.0f, p.base_color = Rgb{0.9f, 0.5f, 0.1f};
              })).b,
              0.1f, 1e-5f);
  EXPECT_NEAR(
      mirror(gltf([](auto& p) { p.roughness = 1.0f, p.base_color = 0.0f, p.specular = 0.0f, p.clearcoat = 0.5f; })).g,
      0.02f, 1e-5f);

  const auto tinted = gltf([](auto& p) {
    p.transmission = 1.0f, p.roughness = 0.0f, p.thin_walled = false, p.attenuation_color = Rgb{0.5f, 0.25f, 1};
    p.attenuation_distance = 2;
  });
  EXPECT_TRUE(tinted->has_absorption());
  const Rgb sigma = tinted->absorption(test::plane_point(wo));
  EXPECT_NEAR(std::exp(-2 * sigma.r), 0.5f, 1e-6f);
  EXPECT_NEAR(std::exp(-2 * sigma.g), 0.25f, 1e-6f);
  EXPECT_EQ(sigma.b, 0);
  EXPECT_FALSE(gltf([](auto& p) { p.attenuation_distance = 1, p.attenuation_color = Rgb(0.5f); })->has_absorption())
      << "nothing gets inside";

  // A quarter turn, by the rotation or by a texture that says (0, 1), exchanges what s and t see.
  const auto brushed = [](float rotation, bool textured) {
    return gltf([&](auto& p) {
      p.metallic = 1.0f, p.roughness = 0.3f, p.anisotropy = 0.8f, p.anisotropy_rotation = rotation;
      if (textured) p.anisotropy_direction = std::make_shared<Plane>(Rgb{0.5f, 1, 0}, Vec2f{});
    });
  };
  const Vec3f along_s = normalize(Vec3f{0.5f, 0, 1}), along_t = normalize(Vec3f{0, 0.5f, 1});
  const auto value = [&](const MaterialPtr& m, const Vec3f& wi) { return bsdf_of(*m, wo).eval(wo, wi).sum().g; };
  const float wide = value(brushed(0, false), along_s), narrow = value(brushed(0, false), along_t);
  EXPECT_GT(wide, 2 * narrow) << "roughness is higher along the tangent";
  for (const MaterialPtr& m : {brushed(kPi / 2, false), brushed(0, true)}) {
    EXPECT_NEAR(value(m, along_t), wide, 1e-4f * wide);
    EXPECT_NEAR(value(m, along_s), narrow, 1e-4f * narrow);
  }
  EXPECT_NEAR(value(brushed(kPi / 2, true), along_s), wide, 1e-4f * wide) << "both: half a turn";

  EXPECT_THROW(gltf([](auto& p) { p.ior = 0.5f; }), Error);
  EXPECT_THROW(gltf([](auto& p) { p.attenuation_distance = 0; }), Error);
  EXPECT_THROW(make_dielectric({-1, 1, 1.0f, 1.0f, false, {}}), Error);
}

TEST(Bump, ALinearHeightTiltsTheNormal) {
  // z = 0.5 x: the normal is (-0.5, 0, 1) / sqrt(1.25); light along it sees the full cosine, less the shadowing term.
  const auto m = make_bump(std::make_shared<Plane>(Rgb(0.0f), Vec2f{0.5f, 0}), 1, make_diffuse(1.0f));
  const Vec3f n = normalize(Vec3f{-0.5f, 0, 1});
  const Bsdf bsdf = bsdf_of(*m, Vec3f{0, 0, 1});
  EXPECT_NEAR(length(bsdf.frame(0).n - n), 0, 1e-6f);
  const float alpha2 = 0.125f * 0.25f, shadow = 2 / (1 + std::sqrt(1 + alpha2 * 0.25f));
  EXPECT_NEAR(bsdf.eval({0, 0, 1}, n).sum().g, shadow * kInvPi, 1e-6f);
  // Below the true surface, though above the tilted plane: no light.
  EXPECT_EQ(bsdf.eval({0, 0, 1}, normalize(Vec3f{-1, 0, -0.1f})).sum(), Rgb(0.0f));
}

}  // namespace
}  // namespace tempera
