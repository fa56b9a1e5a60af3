// SPDX-License-Identifier: Apache-2.0
// Normals that are bent for the viewer, and light that fades out at the horizon.
#include "tempera/shading/shading_normal.h"

#include "shading_test_util.h"

namespace tempera {
namespace {

using test::Random;

/// A point in the plane z = 0 with shading normal `n`, whose normals are to be bent.
ShadingPoint smooth_point(const Vec3f& wo, const Vec3f& n) {
  ShadingPoint p = test::plane_point(wo);
  p.frame = Basis::with_tangent(n, {1, 0, 0});
  p.bends = true;
  p.unbent = n;
  return p;
}
Bsdf bent_bsdf(const Material& material, const ShadingPoint& point) {
  Bsdf bsdf;
  make_bsdf(material, point, bsdf);
  return bsdf;
}
Vec3f tilted(float degrees) {  // towards +x
  const float a = degrees * kPi / 180;
  return {std::sin(a), 0, std::cos(a)};
}

TEST(BendNormal, MirrorsTheViewAboveTheSurface) {
  const Vec3f ng{0, 0, 1};
  Random random(1);
  int bent = 0;
  for (int i = 0; i < 20000; ++i) {
    const Vec3f wo = random.sphere();
    Vec3f n = random.sphere();
    if (i % 2) n.z = std::abs(n.z);  // else even those that face inwards
    const float side = wo.z < 0 ? -1.0f : 1.0f;
    const Vec3f b = bend_normal(n, ng, wo);
    EXPECT_NEAR(length(b), 1, 1e-5);
    EXPECT_GT(side * dot(b, wo), 0) << "faces the viewer";
    const float height = side * mirror(wo, b).z, least = std::min(0.01f, 0.5f * std::abs(wo.z));
    EXPECT_GE(height, least - 1e-5f);
    if (b == n) continue;
    ++bent;
    EXPECT_LT(height, least + 1e-3f) << "no farther than it must";
    EXPECT_NEAR(dot(cross(n, ng), b), 0, 1e-5) << "in the plane of both";
    // A normal that does is kept.
    EXPECT_NEAR(length(bend_normal(b * 0.999f + ng * (0.001f * side), ng, wo) - b), 0, 2e-3f);
  }
  EXPECT_GT(bent, 5000);
}

TEST(BendNormal, IsContinuousAndTheSameFromBothSides) {
  const Vec3f wo = normalize(Vec3f{-0.9f, 0.3f, 0.15f});
  Vec3f last = bend_normal(tilted(-80), {0, 0, 1}, wo);
  for (float a = -80; a < 80; a += 0.25f) {
    const Vec3f b = bend_normal(tilted(a), {0, 0, 1}, wo);
    EXPECT_LT(length(b - last), 0.02f) << a;
    last = b;
    // Seen from behind: everything mirrored in the plane, with both normals still on the front.
    const Vec3f mirrored{wo.x, wo.y, -wo.z}, front = -Vec3f{b.x, b.y, -b.z};
    EXPECT_NEAR(length(bend_normal(-Vec3f{tilted(a).x, 0, -tilted(a).z}, {0, 0, 1}, mirrored) - front), 0, 1e-5f) << a;
  }
}

TEST(Terminator, FadesOutWhereTheSurfaceTurnsAway) {
  EXPECT_EQ(terminator_factor(-0.1f, 0.5f, 0.9f, 1), 0);
  EXPECT_EQ(terminator_factor(0, 0.5f, 0.9f, 1), 0);
  EXPECT_FLOAT_EQ(terminator_factor(0.5f, 0.5f, 0.9f, 1), 1);
  const float g = 0.2f / (0.5f * 0.9f);
  EXPECT_FLOAT_EQ(terminator_factor(0.2f, 0.5f, 0.9f, 1), g + g * g - g * g * g);
  EXPECT_FLOAT_EQ(terminator_factor(0.2f, 0.5f, 0.9f, 0.1f), 1) << "narrower for glossy lobes";
}

const std::vector<MaterialPtr>& opaque_materials() {
  static const std::vector<MaterialPtr> all = [] {
    MetallicRoughnessParams paint, coated, metal, polished;
    paint.metallic = 0.0f, paint.roughness = 0.4f;
    coated = paint, coated.clearcoat = 1.0f, coated.clearcoat_roughness = 0.03f;
    coated.sheen_color = 0.3f, coated.sheen_roughness = 0.5f;
    metal.roughness = 0.3f;
    polished.roughness = 0.0f;
    PrincipledParams burley;
    return std::vector<MaterialPtr>{make_diffuse(0.8f),
                                    make_plastic({}),
                                    make_conductor({}),
                                    make_conductor({0.0f, 1.0f, 1.0f, {true, Microfacets::kGgx, 0.2f, 0.2f, true}}),
                                    make_principled(burley),
                                    make_metallic_roughness(paint),
                                    make_metallic_roughness(coated),
                                    make_metallic_roughness(metal),
                                    make_metallic_roughness(polished)};
  }();
  return all;
}

TEST(BentBsdf, NothingThatTheViewerSeesIsBlackAndNothingGoesIntoTheSurface) {
  // Normals that lean away from the viewer, up to where they face away: without bending these surfaces are black or
  // mirror what is behind them.
  const Vec3f wo = normalize(Vec3f{-1, 0.1f, 0.3f});
  Random random(3);
  for (const MaterialPtr& m : opaque_materials())
    for (const float angle : {0.0f, 20.0f, 60.0f, 80.0f}) {
      const Bsdf bsdf = bent_bsdf(*m, smooth_point(wo, tilted(angle)));
      double sum = 0, below = 0;
      constexpr int kSamples = 4000;
      for (int i = 0; i < kSamples; ++i) {
        const float u = random();
        const auto s = bsdf.sample(wo, u, random.pair());
        if (!s || is_black(s->sum())) continue;
        (s->wi.z > 0 ? sum : below) += double(mean(s->sum()) / s->pdf) / kSamples;
      }
      EXPECT_GT(sum, 0.1) << "material " << &m - opaque_materials().data() << " at " << angle;
      EXPECT_LT(sum, 1.5);
      EXPECT_EQ(below, 0) << "material " << &m - opaque_materials().data() << " at " << angle;
      for (int i = 0; i < 1000; ++i) {
        const Vec3f wi = random.sphere();
        if (wi.z < 0) {
          EXPECT_EQ(bsdf.eval(wo, wi).sum(), Rgb(0.0f));
        }
      }
    }
}

TEST(BentBsdf, SamplingAndEvaluationAgree) {  // what multiple importance sampling relies on
  const Vec3f wo = normalize(Vec3f{-0.8f, 0.2f, 0.4f});
  Random random(4);
  for (const MaterialPtr& m : opaque_materials())
    for (const float angle : {15.0f, 60.0f}) {
      const Bsdf bsdf = bent_bsdf(*m, smooth_point(wo, tilted(angle)));
      // The density integrates to the probability of a sample, and weights to the integral.
      constexpr int kSamples = 60000;
      double by_samples = 0, squares = 0, by_grid = 0;
      for (int i = 0; i < kSamples; ++i) {
        const float u = random();
        const auto s = bsdf.sample(wo, u, random.pair());
        if (!s || s->delta) continue;
        const BsdfEval again = bsdf.eval(wo, s->wi);
        if (!is_black(s->sum())) {
          EXPECT_NEAR(again.pdf, s->pdf, 2e-3f * s->pdf);
        }
        const double w = double(mean(s->sum()) / s->pdf);
        by_samples += w / kSamples, squares += w * w / kSamples;
      }
      constexpr int kGrid = 300;
      for (int i = 0; i < kGrid; ++i)
        for (int j = 0; j < 2 * kGrid; ++j) {
          const float z = -1 + 2 * (float(i) + 0.5f) / kGrid, r = std::sqrt(1 - z * z);
          const float phi = kPi * (float(j) + 0.5f) / kGrid;
          by_grid += double(mean(bsdf.eval(wo, {r * std::cos(phi), r * std::sin(phi), z}).sum()));
        }
      by_grid *= 4 * kPiD / (2 * kGrid * kGrid);
      const double error = std::sqrt((squares - by_samples * by_samples) / kSamples);
      EXPECT_NEAR(by_samples, by_grid, 4.5 * error + 5e-3 * by_grid + 1e-4);
    }
}

TEST(BentBsdf, InterfacesThatTransmitKeepTheirNormals) {
  const Vec3f wo = normalize(Vec3f{-1, 0, 0.3f});
  MetallicRoughnessParams solid, frosted, pane;
  solid.transmission = frosted.transmission = pane.transmission = 1.0f;
  solid.metallic = frosted.metallic = pane.metallic = 0.0f;
  solid.roughness = pane.roughness = 0.0f, frosted.roughness = 0.5f;
  solid.thin_walled = frosted.thin_walled = false;
  for (const MaterialPtr& m : {make_dielectric({}), make_metallic_roughness(solid), make_metallic_roughness(frosted),
                               make_metallic_roughness(pane), make_dielectric({1.5f, 1, 1.0f, 1.0f, true, {}})}) {
    ShadingPoint p = smooth_point(wo, tilted(15));
    const Bsdf bent = bent_bsdf(*m, p);
    p.bends = false;
    const Bsdf plain = bent_bsdf(*m, p);
    ASSERT_EQ(bent.size(), plain.size());
    for (int i = 0; i < bent.size(); ++i) {
      EXPECT_EQ(bent.frame(i).n, tilted(15));
      if (!plain.is_delta(i)) continue;
      EXPECT_NEAR(length(bent.sample_delta(i, wo)->wi - plain.sample_delta(i, wo)->wi), 0, 1e-6f);
      EXPECT_NEAR(bent.sample_delta(i, wo)->sum().g, plain.sample_delta(i, wo)->sum().g, 1e-6f);
    }
  }
  // The mirror of an opaque surface is bent.
  EXPECT_NE(bent_bsdf(*make_conductor({}), smooth_point(wo, tilted(15))).frame(0).n, tilted(15));
}

/// A constant normal map.
class Constant final : public Texture {
 public:
  explicit Constant(Rgb value) : value_(value) {}
  Rgb rgb(const ShadingPoint&) const override { return value_; }
  Rgb mean() const override { return value_; }

 private:
  Rgb value_;
};

TEST(BentBsdf, NormalMapsAreAppliedFirst) {
  // The map leans by 45 degrees away from the viewer, over a flat surface and over one that already leans.
  const auto map = std::make_shared<Constant>(Rgb{0.5f + 0.5f * tilted(45).x, 0.5f, 0.5f + 0.5f * tilted(45).z});
  const Vec3f wo = normalize(Vec3f{-1, 0, 0.4f});
  for (const float angle : {0.0f, 30.0f}) {
    const ShadingPoint p = smooth_point(wo, tilted(angle));
    const Bsdf bsdf = bent_bsdf(*make_normal_map(map, 1, make_conductor({})), p);
    EXPECT_NEAR(length(bsdf.frame(0).n - bend_normal(tilted(angle + 45), p.ng, wo)), 0, 1e-4f);
    const auto s = bsdf.sample_delta(0, wo);
    ASSERT_TRUE(s);
    EXPECT_NEAR(s->wi.z, 0.01f, 1e-3f);
    EXPECT_FLOAT_EQ(s->sum().g, 1) << "as bright as any mirror";
  }
  // A clearcoat's own map, too.
  MetallicRoughnessParams coated;
  coated.base_color = 0.0f, coated.metallic = 0.0f, coated.specular = 0.0f;
  coated.clearcoat = 1.0f, coated.clearcoat_normal = map;
  const Bsdf coat = bent_bsdf(*make_metallic_roughness(coated), smooth_point(wo, tilted(0)));
  EXPECT_NEAR(length(coat.frame(0).n - bend_normal(tilted(45), {0, 0, 1}, wo)), 0, 1e-4f);
}

TEST(BentBsdf, DensitiesCountLobesOfOtherFrames) {
  // Where a mapped base reflects nothing it is still sampled: the coat's light there must not be counted twice.
  const auto map = std::make_shared<Constant>(Rgb{0.5f + 0.5f * tilted(60).x, 0.5f, 0.5f + 0.5f * tilted(60).z});
  MetallicRoughnessParams coated;
  coated.roughness = 0.7f, coated.clearcoat = 1.0f, coated.clearcoat_roughness = 0.7f;
  const auto m = make_normal_map(map, 1, make_metallic_roughness(coated));
  const Vec3f wo = normalize(Vec3f{0.3f, 0, 1});
  Bsdf bsdf;
  make_bsdf(*m, test::plane_point(wo), bsdf);
  Random random(5);
  constexpr int kGrid = 300, kSamples = 200000;
  double by_grid = 0, by_samples = 0, squares = 0;
  for (int i = 0; i < kGrid; ++i)
    for (int j = 0; j < 2 * kGrid; ++j) {
      const float z = (float(i) + 0.5f) / kGrid, r = std::sqrt(1 - z * z), phi = kPi * (float(j) + 0.5f) / kGrid;
      by_grid += double(bsdf.eval(wo, {r * std::cos(phi), r * std::sin(phi), z}).sum().g);
    }
  by_grid *= 2 * kPiD / (2 * kGrid * kGrid);
  for (int i = 0; i < kSamples; ++i) {
    const float u = random();
    const auto s = bsdf.sample(wo, u, random.pair());
    if (!s || is_black(s->sum())) continue;
    const double w = double(s->sum().g / s->pdf);
    by_samples += w / kSamples, squares += w * w / kSamples;
  }
  EXPECT_NEAR(by_samples, by_grid, 4 * std::sqrt((squares - by_samples * by_samples) / kSamples) + 1e-3 * by_grid);
}

}  // namespace
}  // namespace tempera
