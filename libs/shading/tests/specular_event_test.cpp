// SPDX-License-Identifier: Apache-2.0
// What surfaces do by R and T as walks through mirrors and glass ask.
#include <gtest/gtest.h>

#include "shading_test_util.h"

namespace tempera {
namespace {

std::optional<SpecularEvent> event_of(const MaterialPtr& material, Event event, const Vec3f& wo) {
  return test::bsdf_of(*material, test::plane_point(wo)).specular(event, wo, {0, 0, 1});
}
constexpr Event kR = Event::kReflection, kT = Event::kTransmission;
const Vec3f kFront = normalize(Vec3f{0.3f, 0.2f, 1}), kBack = normalize(Vec3f{0.3f, 0.2f, -1});

TEST(SpecularEvents, OfGlass) {
  for (const float alpha : {0.0f, 0.05f}) {
    DielectricParams p{.int_ior = 1.5f, .ext_ior = 1};
    p.roughness.rough = alpha > 0;
    p.roughness.alpha_u = p.roughness.alpha_v = alpha;
    const MaterialPtr glass = make_dielectric(p);
    EXPECT_FLOAT_EQ(event_of(glass, kT, kFront)->eta, 1.5f) << alpha;
    EXPECT_FLOAT_EQ(event_of(glass, kT, kBack)->eta, 1 / 1.5f) << alpha;
    EXPECT_FLOAT_EQ(event_of(glass, kR, kFront)->eta, 1) << alpha;
    EXPECT_FLOAT_EQ(event_of(glass, kR, kBack)->eta, 1) << alpha;
    EXPECT_FALSE(event_of(glass, kT, normalize(Vec3f{1, 0, -0.5f}))) << "total reflection";
  }
  DielectricParams rough{.int_ior = 1.5f, .ext_ior = 1};
  rough.roughness.rough = true;
  rough.roughness.alpha_u = rough.roughness.alpha_v = 0.2f;
  EXPECT_FALSE(event_of(make_dielectric(rough), kT, kFront)) << "that rough it is D";
  const MaterialPtr sheet = make_dielectric({.thin = true});
  for (const Vec3f& wo : {kFront, kBack}) EXPECT_EQ(event_of(sheet, kT, wo)->eta, 1);
}

TEST(SpecularEvents, OfCoatsMetalsAndPaint) {
  EXPECT_TRUE(event_of(make_plastic({}), kR, kFront));
  EXPECT_FALSE(event_of(make_plastic({}), kT, kFront));
  EXPECT_TRUE(event_of(make_conductor({}), kR, kFront));
  EXPECT_FALSE(event_of(make_conductor({}), kR, kBack));
  EXPECT_FALSE(event_of(make_conductor({.specular_reflectance = 0.0f}), kR, kFront)) << "sends nothing";
  EXPECT_FALSE(event_of(make_diffuse(0.5f), kR, kFront));
  MetallicRoughnessParams pane;
  pane.metallic = 0.0f;
  pane.roughness = 0.2f;  // alpha 0.04
  pane.transmission = 1.0f;
  EXPECT_EQ(event_of(make_metallic_roughness(pane), kT, kFront)->eta, 1);
  pane.thin_walled = false;
  EXPECT_FLOAT_EQ(event_of(make_metallic_roughness(pane), kT, kFront)->eta, 1.5f);
}

// Of a base with a bump map under a smooth coat, the coat's normal is the surface's.
TEST(SpecularEvents, PreferTheNormalOfTheSurface) {
  const MaterialPtr bumpy =
      make_normal_map(make_checkerboard(Rgb{0.6f, 0.6f, 1}, Rgb{0.6f, 0.6f, 1}, {}), 1, make_conductor({}));
  const auto perturbed = event_of(bumpy, kR, kFront);
  ASSERT_TRUE(perturbed);
  EXPECT_LT(perturbed->n.z, 0.99f);
  const auto both = event_of(make_blend(0.5f, bumpy, make_conductor({})), kR, kFront);
  ASSERT_TRUE(both);
  EXPECT_EQ(both->n, (Vec3f{0, 0, 1}));
}

}  // namespace
}  // namespace tempera
