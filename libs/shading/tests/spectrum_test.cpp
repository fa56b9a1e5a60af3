// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/spectrum.h"

#include <gtest/gtest.h>

#include "tempera/core/error.h"

namespace tempera {
namespace {

void expect_rgb(const Rgb& value, const Rgb& expected, float relative) {
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(value[c], expected[c], relative * std::max(std::abs(expected[c]), 0.02f)) << c;
}

TEST(Spectrum, IntegralsAreMitsubas) {  // spectrum_list_to_srgb of Mitsuba 3.9.1
  const std::vector<float> w{400, 450, 500, 550, 600, 650, 700}, v{.1f, .2f, .5f, .4f, .7f, .6f, .3f};
  expect_rgb(spectrum_to_rgb(w, v, false), {0.67969f, 0.483393f, 0.216592f}, 1e-5f);
  expect_rgb(spectrum_to_rgb(w, v, true), {0.801333f, 0.461056f, 0.187978f}, 1e-5f);
  const std::vector<float> wide{360, 830}, ramp{0, 2};
  expect_rgb(spectrum_to_rgb(wide, ramp, false), {1.20059f, 0.777843f, 0.343541f}, 1e-5f);
  const std::vector<float> cornell{400, 500, 600, 700}, light{0, 8, 15.6f, 18.4f};
  expect_rgb(spectrum_to_rgb(cornell, light, true), {20.7108f, 10.8546f, 2.77115f}, 1e-5f);
}

TEST(Spectrum, ConstantsAreWhiteAsReflectanceAndEqualEnergyAsEmission) {
  const std::vector<float> w{500, 600}, v{0.3f, 0.3f};
  expect_rgb(spectrum_to_rgb(w, v, false), Rgb(0.3f), 1e-6f);
  expect_rgb(spectrum_to_rgb(w, v, true), Rgb{1.204794f, 0.948292f, 0.908916f} * 0.3f, 1e-5f);
  const std::vector<float> one{500}, value{2};
  expect_rgb(spectrum_to_rgb(one, value, false), Rgb(2.0f), 1e-6f);
}

TEST(Spectrum, BlackBodies) {  // Mitsuba 3.9.1's `blackbody` in scalar_spectral, integrated over 4000 wavelengths
  expect_rgb(blackbody_rgb(3000), {733.845f, 349.918f, 112.822f}, 2e-4f);
  expect_rgb(blackbody_rgb(6500), {43962.6f, 41448.6f, 43626.2f}, 2e-4f);
  expect_rgb(blackbody_rgb(20000), {641959, 848941, 1.58334e6f}, 2e-4f);
  EXPECT_EQ(blackbody_rgb(1000).b, 0);  // out of gamut, clamped
}

TEST(Spectrum, Errors) {
  const std::vector<float> none, w{400, 500}, back{500, 400}, v{1, 2}, bad{1, kInfinity};
  EXPECT_THROW(spectrum_to_rgb(none, none, false), Error);
  EXPECT_THROW(spectrum_to_rgb(w, none, false), Error);
  EXPECT_THROW(spectrum_to_rgb(back, v, false), Error);
  EXPECT_THROW(spectrum_to_rgb(w, bad, false), Error);
}

TEST(Spectrum, NamedMaterials) {
  const auto gold = named_conductor("Au");
  ASSERT_TRUE(gold);
  EXPECT_GT(gold->k.r, gold->k.b);                                  // reflects red best
  expect_rgb(gold->eta, {0.143119f, 0.374958f, 1.442479f}, 5e-2f);  // widely published figures
  EXPECT_FALSE(named_conductor("Unobtainium"));
  EXPECT_EQ(named_conductors().size(), 71u);
  EXPECT_FLOAT_EQ(*named_ior("BK7"), 1.5046f);
  EXPECT_FLOAT_EQ(*named_ior("air"), 1.000277f);
  EXPECT_FALSE(named_ior("plutonium"));
  for (const std::string& name : named_iors()) EXPECT_GE(*named_ior(name), 1) << name;
}

}  // namespace
}  // namespace tempera
