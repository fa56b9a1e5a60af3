// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_test_util.h"
#include "tempera/shading/spectrum.h"

namespace tempera {
namespace {

MaterialPtr imported(const std::string& bsdf, const char* version = "3.0.0", bool expect_warning = false) {
  Folder folder;
  const Scene s = folder.load("<shape type=\"disk\">" + bsdf + "</shape>", {}, version);
  EXPECT_EQ(folder.warnings.empty(), !expect_warning) << bsdf;
  return s.shapes.at(0).material;
}

TEST(MitsubaMaterials, DefaultsAreMitsubas) {
  Roughness rough;
  rough.rough = true;
  ConductorParams rough_mirror;
  rough_mirror.roughness = rough;
  DielectricParams thin, frosted;
  thin.thin = true;
  frosted.roughness = rough;
  PlasticParams rough_plastic;
  rough_plastic.roughness = rough;
  PrincipledParams principled;
  principled.eta = 2 / (1 - std::sqrt(0.08f * 0.5f)) - 1;
  const std::pair<const char*, MaterialPtr> cases[] = {{"diffuse", make_diffuse(0.5f)},
                                                       {"conductor", make_conductor({})},
                                                       {"roughconductor", make_conductor(rough_mirror)},
                                                       {"dielectric", make_dielectric({})},
                                                       {"thindielectric", make_dielectric(thin)},
                                                       {"roughdielectric", make_dielectric(frosted)},
                                                       {"plastic", make_plastic({})},
                                                       {"roughplastic", make_plastic(rough_plastic)},
                                                       {"principled", make_principled(principled)},
                                                       {"null", make_mask(0.0f, make_black())}};
  for (const auto& [plugin, material] : cases)
    EXPECT_TRUE(SameScattering(*imported(fmt::format("<bsdf type=\"{}\"/>", plugin)), *material)) << plugin;
}

TEST(MitsubaMaterials, OurOwnTypesByTheirNames) {
  MetallicRoughnessParams p;
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"metallic_roughness\"/>"), *make_metallic_roughness(p)));
  p.base_color = Rgb(0.9f, 0.4f, 0.2f);
  p.roughness = 0.3f;
  p.metallic = 0.5f;
  p.clearcoat = 0.7f;
  p.ior = 1.7f;
  p.thin_walled = false;
  p.tints_once = true;
  p.transmission = 0.4f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="metallic_roughness"><rgb name="base_color" value="0.9 0.4 0.2"/><float name="roughness" value="0.3"/>
    <float name="metallic" value="0.5"/><float name="clearcoat" value="0.7"/><float name="ior" value="1.7"/><float name="transmission" value="0.4"/>
    <boolean name="thin_walled" value="false"/><string name="solid_tint" value="once"/></bsdf>)"),
      *make_metallic_roughness(p)));
  imported(R"(<bsdf type="metallic_roughness"><float name="shine" value="1"/></bsdf>)", "3.0.0", true);
  for (const char* bad : {R"(<float name="ior" value="0.5"/>)", R"(<string name="solid_tint" value="never"/>)",
                          R"(<boolean name="thin_walled" value="maybe"/>)"})
    EXPECT_THROW(imported(fmt::format("<bsdf type=\"metallic_roughness\">{}</bsdf>", bad)), Error) << bad;
}

TEST(MitsubaMaterials, ParametersArrive) {
  ConductorParams gold;
  gold.eta = named_conductor("Au")->eta;
  gold.k = named_conductor("Au")->k;
  gold.roughness = {true, Microfacets::kGgx, 0.3f, 0.2f};
  gold.specular_reflectance = Rgb(0.9f, 0.8f, 0.7f);
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="roughconductor"><string name="material" value="Au"/><string name="distribution" value="GGX"/>
    <float name="alpha_u" value="0.3"/><float name="alpha_v" value="0.2"/><rgb name="specular_reflectance" value="0.9 0.8 0.7"/></bsdf>)"),
      *make_conductor(gold)));
  ConductorParams spectral;
  spectral.eta = 0.789f, spectral.k = 6.15f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="conductor"><spectrum name="eta" value="0.789"/><spectrum name="k" value="6.15"/></bsdf>)"),
      *make_conductor(spectral)));
  EXPECT_TRUE(SameScattering(*imported(R"(<bsdf type="conductor"><string name="material" value="none"/></bsdf>)"),
                             *make_conductor({})));
  DielectricParams diamond;
  diamond.int_ior = 2.419f, diamond.ext_ior = 1.333f, diamond.specular_transmittance = 0.5f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="dielectric"><string name="int_ior" value="Diamond"/><string name="ext_ior" value="water"/>
    <float name="specular_transmittance" value="0.5"/></bsdf>)"),
      *make_dielectric(diamond)));
  PlasticParams plastic;
  plastic.int_ior = 1.9f, plastic.nonlinear = true, plastic.diffuse_reflectance = Rgb(0.1f, 0.27f, 0.36f);
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1, 0.27, 0.36"/><float name="int_ior" value="1.9"/>
    <boolean name="nonlinear" value="true"/></bsdf>)"),
      *make_plastic(plastic)));
  PrincipledParams car;
  car.base_color = Rgb(0.8f, 0.1f, 0.2f), car.metallic = 0.3f, car.roughness = 0.4f, car.anisotropic = 0.5f,
  car.clearcoat = 0.6f;
  car.clearcoat_gloss = 0.7f, car.sheen = 0.2f, car.sheen_tint = 0.9f, car.spec_tint = 0.15f, car.flatness = 0.25f,
  car.eta = 1.7f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="principled"><rgb name="base_color" value="0.8 0.1 0.2"/><float name="metallic" value="0.3"/>
    <float name="roughness" value="0.4"/><float name="anisotropic" value="0.5"/><float name="clearcoat" value="0.6"/><float name="clearcoat_gloss" value="0.7"/>
    <float name="sheen" value="0.2"/><float name="sheen_tint" value="0.9"/><float name="spec_tint" value="0.15"/><float name="flatness" value="0.25"/>
    <float name="eta" value="1.7"/><float name="main_specular_sampling_rate" value="2"/></bsdf>)"),
      *make_principled(car)));
}

TEST(MitsubaMaterials, NestedMaterials) {
  const MaterialPtr red = make_diffuse(Rgb(0.8f, 0.1f, 0.1f)), blue = make_diffuse(Rgb(0.1f, 0.1f, 0.8f));
  const std::string r = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.8 0.1 0.1"/></bsdf>)",
                    b = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.1 0.8"/></bsdf>)";
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"twosided\">" + r + b + "</bsdf>"), *make_two_sided(red, blue)));
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"twosided\">" + r + "</bsdf>"), *make_two_sided(red)));
  EXPECT_TRUE(
      SameScattering(*imported("<bsdf type=\"blendbsdf\"><float name=\"weight\" value=\"0.25\"/>" + r + b + "</bsdf>"),
                     *make_blend(0.25f, red, blue)));
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"mask\"><float name=\"opacity\" value=\"0.3\"/>" + r + "</bsdf>"),
                             *make_mask(0.3f, red)));
  // 0.5 red + 0.25 blue + 0.25 of nothing
  EXPECT_TRUE(SameScattering(
      *imported("<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"0.5, 0.25\"/>" + r + b + "</bsdf>",
                "0.6.0"),
      *make_diffuse(Rgb(0.425f, 0.075f, 0.25f))));
}

TEST(MitsubaMaterials, SubstitutesKeepTheEnergy) {
  // phong and ward: both reflectances survive the blend.
  const MaterialPtr phong = imported(
      R"(<bsdf type="phong"><float name="exponent" value="60"/><rgb name="diffuseReflectance" value="0.3"/><rgb name="specularReflectance" value="0.2"/></bsdf>)",
      "0.6.0", true);
  EXPECT_NEAR(scattering(*phong)[4], scattering(*make_diffuse(0.3f))[4],
              1e-3f);  // away from the highlight only diffuse
  PlasticParams coated;
  coated.int_ior = 1.7f, coated.diffuse_reflectance = 0.4f, coated.nonlinear = true;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="coating"><float name="intIOR" value="1.7"/><bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf></bsdf>)",
          "0.6.0", true),
      *make_plastic(coated)));
  EXPECT_TRUE(SameScattering(
      *imported("<bsdf type=\"roughdiffuse\"><float name=\"alpha\" value=\"0.2\"/></bsdf>", "0.6.0", true),
      *make_diffuse(0.5f)));
}

TEST(MitsubaMaterials, ShapesWithoutBsdfAreDiffuseOrBlackIfTheyEmit) {
  EXPECT_TRUE(SameScattering(*imported(""), *make_diffuse(0.5f)));
  EXPECT_TRUE(SameScattering(*imported("<emitter type=\"area\"/>"), *make_diffuse(0.0f)));
}

TEST(MitsubaTextures, WhatIsNoLightIsReadAsZeroWithOneWarning) {
  Folder folder;
  const float nan = std::nanf("");
  folder.write("bad.pfm", [&] {
    std::string b = "PF\n1 1\n-1.0\n";
    for (const float v : {-0.34f, nan, kInfinity}) b.append(reinterpret_cast<const char*>(&v), 4);
    return b;
  }());
  folder.write("colors.ply",
               "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
               "property float r\nproperty float g\nproperty float b\nelement face 1\n"
               "property list uchar int vertex_index\nend_header\n"
               "0 0 0 -1 0.5 0.25\n1 0 0 nan 0.5 0.25\n0 1 0 0 inf 0.25\n3 0 1 2\n");
  const auto bitmap = [](const char* name) {
    return fmt::format(R"(<texture name="{}" type="bitmap"><string name="filename" value="bad.pfm"/></texture>)", name);
  };
  for (const std::string& bsdf : {"<bsdf type=\"diffuse\">" + bitmap("reflectance") + "</bsdf>",
                                  "<bsdf type=\"roughconductor\">" + bitmap("alpha") + "</bsdf>",
                                  "<bsdf type=\"roughconductor\">" + bitmap("specular_reflectance") + "</bsdf>",
                                  "<bsdf type=\"dielectric\">" + bitmap("specular_transmittance") + "</bsdf>",
                                  "<bsdf type=\"principled\">" + bitmap("base_color") + "</bsdf>",
                                  "<bsdf type=\"principled\">" + bitmap("metallic") + "</bsdf>",
                                  "<bsdf type=\"principled\">" + bitmap("roughness") + "</bsdf>",
                                  "<bsdf type=\"normalmap\">" + bitmap("normalmap") + "<bsdf type=\"diffuse\"/></bsdf>",
                                  "<bsdf type=\"mask\">" + bitmap("opacity") + "<bsdf type=\"diffuse\"/></bsdf>"}) {
    folder.warnings.report();
    const Scene s = folder.load("<shape type=\"disk\">" + bsdf + "</shape>");
    EXPECT_FALSE(s.bend_normals) << "Mitsuba's convention";
    ASSERT_EQ(folder.warnings.lines().size(), 1u) << bsdf;
    EXPECT_NE(folder.warnings.lines()[0].find("not a number"), std::string::npos);
    for (const float v : scattering(*s.shapes[0].material)) EXPECT_TRUE(v >= -1 && std::isfinite(v)) << bsdf;
    EXPECT_EQ(scattering(*s.shapes[0].material)[1] >= 0, true) << bsdf;
  }
  folder.warnings.report();
  const Scene s = folder.load(R"(<shape type="ply"><string name="filename" value="colors.ply"/></shape>)");
  ASSERT_EQ(folder.warnings.lines().size(), 1u);
  EXPECT_NE(folder.warnings.lines()[0].find("colors that are negative"), std::string::npos);
  EXPECT_EQ(mesh_of(s).colors[0], Rgb(0, 0.5f, 0.25f));
  EXPECT_EQ(mesh_of(s).colors[1], Rgb(0, 0.5f, 0.25f));
  EXPECT_EQ(mesh_of(s).colors[2], Rgb(0, 0, 0.25f));
}

TEST(MitsubaTextures, BitmapsCheckerboardsAndScales) {
  Folder folder;
  // 2 x 2 gray pixels: 0.25 0.5 in the first row, 0.75 1 in the second.
  folder.write("t.pfm", [] {
    std::string b = "Pf\n2 2\n-1.0\n";  // rows from the bottom
    for (const float v : {0.75f, 1.0f, 0.25f, 0.5f}) b.append(reinterpret_cast<const char*>(&v), 4);
    return b;
  }());
  const auto at = [&](const std::string& texture, const Vec2f& uv, const char* version = "3.0.0") {
    const Scene s =
        folder.load("<shape type=\"disk\"><bsdf type=\"diffuse\">" + texture + "</bsdf></shape>", {}, version);
    EXPECT_TRUE(folder.warnings.empty()) << texture;
    return scattering(*s.shapes[0].material, uv)[1] / scattering(*make_diffuse(1.0f))[1];
  };
  const auto bitmap = [](const std::string& more) {
    return R"(<texture name="reflectance" type="bitmap"><string name="filename" value="t.pfm"/><string name="filter_type" value="nearest"/>)" +
           more + "</texture>";
  };
  // Row 0 is at v = 0.
  EXPECT_NEAR(at(bitmap(""), {0.25f, 0.25f}), 0.25f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {0.75f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {0.25f, 0.75f}), 0.75f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {1.25f, 0.25f}), 0.25f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<string name=\"wrap_mode\" value=\"clamp\"/>"), {1.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<string name=\"wrap_mode\" value=\"mirror\"/>"), {1.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<transform name=\"to_uv\"><translate x=\"0.5\"/></transform>"), {0.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(
      at(bitmap("<transform name=\"to_uv\"><scale x=\"3\"/><translate y=\"0.5\"/></transform>"), {0.25f, 0.25f}), 1,
      1e-5f);
  EXPECT_NEAR(at(bitmap("<float name=\"uoffset\" value=\"0.5\"/>"), {0.25f, 0.25f}, "0.6.0"), 0.5f, 1e-5f);
  // 0.6 scales first: 0.75 -> 0.375 -> 0.875; the other order would give 0.625 -> 0.5.
  EXPECT_NEAR(at(bitmap("<float name=\"uscale\" value=\"0.5\"/><float name=\"uoffset\" value=\"-0.2\"/>"),
                 {0.75f, 0.25f}, "0.6.0"),
              0.25f, 1e-5f);
  EXPECT_NEAR(at("<texture name=\"reflectance\" type=\"scale\"><float name=\"scale\" value=\"0.5\"/>" + bitmap("") +
                     "</texture>",
                 {0.75f, 0.25f}, "0.6.0"),
              0.25f, 1e-5f);
  const std::string checker =
      R"(<texture name="reflectance" type="checkerboard"><rgb name="color0" value="0.8"/><rgb name="color1" value="0.1"/></texture>)";
  EXPECT_NEAR(at(checker, {0.2f, 0.2f}), 0.8f, 1e-5f);
  EXPECT_NEAR(at(checker, {0.7f, 0.2f}), 0.1f, 1e-5f);
  EXPECT_NEAR(at(checker, {0.7f, 0.7f}), 0.8f, 1e-5f);
  // The shading point's color attribute has red 0.9.
  EXPECT_NEAR(
      at(R"(<texture name="reflectance" type="mesh_attribute"><string name="name" value="face_color"/><float name="scale" value="0.5"/></texture>)",
         {}),
      0.45f, 1e-5f);
}

TEST(MitsubaTextures, Spectra) {
  Folder folder;
  folder.write("a.spd", "# wavelength value\n400 0.5\n\n700 0.5\n");
  const auto emitted = [&](const std::string& radiance, const char* version = "3.0.0") {
    return folder.load("<emitter type=\"constant\">" + radiance + "</emitter>", {}, version)
        .environments.at(0)
        .radiance.at(0);
  };
  const auto expect_rgb = [](const Rgb& a, const Rgb& b) {
    EXPECT_LT(max_component(a - b) + max_component(b - a), 2e-3f) << a.r << " " << a.g << " " << a.b;
  };
  EXPECT_EQ(emitted(R"(<rgb name="radiance" value="1 2 3"/>)"), Rgb(1, 2, 3));
  EXPECT_EQ(emitted(R"(<rgb name="radiance" value="4"/>)"), Rgb(4.0f));
  EXPECT_EQ(emitted(R"(<float name="radiance" value="4"/>)"), Rgb(4.0f));
  expect_rgb(emitted(R"(<srgb name="radiance" value="#ff8000"/>)", "0.6.0"), Rgb(1, 0.2158605f, 0));
  // An equal-energy spectrum in D65 space; plain white in the 0.6 dialect.
  expect_rgb(emitted(R"(<spectrum name="radiance" value="2"/>)"), Rgb(2.40958f, 1.896582f, 1.817832f));
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" value="2"/>)", "0.6.0"), Rgb(2.0f));
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" value="1, 2, 3"/>)", "0.6.0"), Rgb(1, 2, 3));
  // As Mitsuba 3.9.1 converts it.
  expect_rgb(emitted(R"(<spectrum name="radiance" value="400:0, 500:8, 600:15.6, 700:18.4"/>)") / 20.710836f,
             Rgb(20.710836f, 10.854634f, 2.771152f) / 20.710836f);
  const Rgb file = emitted(R"(<spectrum name="radiance" filename="a.spd"/>)"),
            list = emitted(R"(<spectrum name="radiance" value="400:0.5 700:0.5"/>)");
  EXPECT_EQ(file, list);
  EXPECT_EQ(
      emitted(
          R"(<spectrum name="radiance" type="regular"><float name="wavelength_min" value="400"/><float name="wavelength_max" value="700"/><string name="values" value="0.5 0.5"/></spectrum>)"),
      list);
  EXPECT_EQ(
      emitted(
          R"(<spectrum name="radiance" type="irregular"><string name="wavelengths" value="400 700"/><string name="values" value="0.5 0.5"/></spectrum>)"),
      list);
  expect_rgb(
      emitted(R"(<spectrum name="radiance" type="blackbody"><float name="temperature" value="5000"/></spectrum>)") /
          blackbody_rgb(5000).r,
      blackbody_rgb(5000) / blackbody_rgb(5000).r);
  expect_rgb(emitted(R"(<blackbody name="radiance" temperature="5000K" scale="2"/>)", "0.6.0") / blackbody_rgb(5000).r,
             blackbody_rgb(5000) * 2 / blackbody_rgb(5000).r);
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" type="d65"><float name="scale" value="3"/></spectrum>)"), Rgb(3.0f));
  EXPECT_TRUE(folder.warnings.empty());
  folder.write("bad.spd", "400 1\n300 2\n");
  try {
    emitted(R"(<spectrum name="radiance" filename="bad.spd"/>)");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().line, 2);
    EXPECT_TRUE(e.loc().file.ends_with("bad.spd"));
  }
}

}  // namespace
}  // namespace tempera
