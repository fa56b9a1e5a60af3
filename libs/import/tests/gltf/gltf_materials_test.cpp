// SPDX-License-Identifier: Apache-2.0
#include "gltf_test_util.h"

namespace tempera {
namespace {

TEST_F(Gltf, AlphaModes) {
  const auto opacity = [&](const std::string& material, float vertex_alpha) {
    Buffer buffer;
    const int colors = buffer.floats({1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1}, "VEC4");
    const Scene scene = load(triangle(
        buffer, fmt::format(R"(,"COLOR_0":{})", colors),
        fmt::format(
            R"("materials":[{}],"textures":[{{"source":0,"sampler":0}}],"images":[{{"uri":"{}"}}],"samplers":[{{"magFilter":9728}}])",
            material, kPng),
        R"(,"material":0)"));
    ShadingPoint point;
    point.uv = {0.75f, 0.25f};  // texel of alpha 128
    point.color_alpha = vertex_alpha;
    const Material& m = *scene.shapes[0].material;
    return m.has_opacity() ? m.opacity(point) : -1.0f;
  };
  const auto material = [](const std::string& mode) {
    return fmt::format(
        R"({{{}"pbrMetallicRoughness":{{"baseColorFactor":[1,1,1,0.5],"baseColorTexture":{{"index":0}}}}}})", mode);
  };
  EXPECT_EQ(opacity(material(""), 1), -1);
  EXPECT_NEAR(opacity(material(R"("alphaMode":"BLEND",)"), 1), 0.5 * 128 / 255, 1e-5);
  EXPECT_NEAR(opacity(material(R"("alphaMode":"BLEND",)"), 0.5f), 0.25 * 128 / 255, 1e-5);
  EXPECT_EQ(opacity(material(R"("alphaMode":"MASK",)"), 1), 0);
  EXPECT_EQ(opacity(material(R"("alphaMode":"MASK","alphaCutoff":0.25,)"), 1), 1);
  EXPECT_EQ(opacity(material(R"("alphaMode":"MASK","alphaCutoff":0.25,)"), 0.9f), 0);
}

TEST_F(Gltf, EmissionUnlitAndVolume) {
  Buffer buffer;
  const Scene scene = load(triangle(
      buffer, "",
      R"("materials":[{"emissiveFactor":[1,0.5,0],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":8}}}])",
      R"(,"material":0)"));
  ASSERT_TRUE(scene.shapes[0].emission);
  EXPECT_EQ(scene.shapes[0].emission->radiance.mean(), Rgb(8, 4, 0));
  Buffer second;
  const Scene unlit = load(triangle(
      second, "",
      R"("materials":[{"pbrMetallicRoughness":{"baseColorFactor":[0.2,0.4,0.6,1]},"extensions":{"KHR_materials_unlit":{}}}])",
      R"(,"material":0)"));
  ASSERT_TRUE(unlit.shapes[0].emission);
  EXPECT_EQ(unlit.shapes[0].emission->radiance.mean(), Rgb(0.2f, 0.4f, 0.6f));
  EXPECT_TRUE(unlit.shapes[0].emission->two_sided);
  Buffer third;
  const Scene volume = load(triangle(
      third, "",
      R"("materials":[{"emissiveFactor":[0,0,0],"extensions":{"KHR_materials_transmission":{"transmissionFactor":1},
"KHR_materials_volume":{"thicknessFactor":1,"attenuationColor":[0.5,1,0.25],"attenuationDistance":2}}}])",
      R"(,"material":0)"));
  EXPECT_FALSE(volume.shapes[0].emission);
  const Rgb sigma = volume.shapes[0].material->absorption({});
  EXPECT_NEAR(sigma.r, -std::log(0.5) / 2, 1e-5);
  EXPECT_NEAR(sigma.g, 0, 1e-5);
  EXPECT_NEAR(sigma.b, -std::log(0.25) / 2, 1e-5);
}

TEST_F(Gltf, TextureTransformsTurnCounterclockwise) {
  const auto seen = [&](const std::string& transform, Vec2f uv) {
    Buffer buffer;
    const int uvs = buffer.floats({0, 0, 1, 0, 0, 1}, "VEC2");
    const Scene scene = load(triangle(
        buffer, fmt::format(R"(,"TEXCOORD_0":{})", uvs),
        fmt::format(
            R"("materials":[{{"emissiveFactor":[1,1,1],"emissiveTexture":{{"index":0,"extensions":{{"KHR_texture_transform":{}}}}}}}],
"textures":[{{"source":0,"sampler":0}}],"images":[{{"uri":"{}"}}],"samplers":[{{"magFilter":9728}}])",
            transform, kPng),
        R"(,"material":0)"));
    ShadingPoint point;
    point.uv = uv;
    return scene.shapes[0].emission->radiance.rgb(point);
  };
  EXPECT_EQ(seen("{}", {0.25f, 0.25f}), Rgb(1, 0, 0));
  EXPECT_EQ(seen(R"({"offset":[0.5,0]})", {0.25f, 0.25f}), Rgb(0, 1, 0));
  EXPECT_EQ(seen(R"({"scale":[1,3]})", {0.25f, 0.25f}), Rgb(0, 0, 1));
  // By 90 degrees (u, v) becomes (v, -u): (0.25, 0.75) looks at (0.75, -0.25) = (0.75, 0.75).
  EXPECT_EQ(seen(R"({"rotation":1.5707963})", {0.25f, 0.75f}), Rgb(1, 1, 1));
}

/// A PFM image of 1 x 1.
std::string pfm(float r, float g, float b) {
  std::string bytes = "PF\n1 1\n-1.0\n";
  for (const float v : {r, g, b}) bytes.append(reinterpret_cast<const char*>(&v), sizeof v);
  return bytes;
}

TEST_F(Gltf, TexelsThatAreNoLightAreHarmlessWhereverTheyAreUsed) {
  const float nan = std::nanf("");
  write("bad.pfm", pfm(-0.34f, nan, kInfinity));
  const char* materials[] = {
      R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}})",
      R"("pbrMetallicRoughness":{"metallicRoughnessTexture":{"index":0}})",
      R"("normalTexture":{"index":0})",
      R"("emissiveFactor":[1,1,1],"emissiveTexture":{"index":0})",
      R"("alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorTexture":{"index":0}})",
      R"("extensions":{"KHR_materials_specular":{"specularTexture":{"index":0},"specularColorTexture":{"index":0}}})",
      R"("extensions":{"KHR_materials_transmission":{"transmissionFactor":1,"transmissionTexture":{"index":0}}})",
      R"("extensions":{"KHR_materials_clearcoat":{"clearcoatFactor":1,"clearcoatTexture":{"index":0},
"clearcoatRoughnessTexture":{"index":0},"clearcoatNormalTexture":{"index":0}}})",
      R"("extensions":{"KHR_materials_sheen":{"sheenColorFactor":[1,1,1],"sheenColorTexture":{"index":0}}})",
      R"("extensions":{"KHR_materials_anisotropy":{"anisotropyStrength":1,"anisotropyTexture":{"index":0}}})"};
  for (const char* material : materials) {
    warnings_.report();
    Buffer buffer;
    const int uvs = buffer.floats({0, 0, 1, 0, 0, 1}, "VEC2");
    const Scene scene = load(triangle(
        buffer, fmt::format(R"(,"TEXCOORD_0":{})", uvs),
        fmt::format(R"("materials":[{{{}}}],"textures":[{{"source":0}}],"images":[{{"uri":"bad.pfm"}}])", material),
        R"(,"material":0)"));
    EXPECT_TRUE(warned("negative, infinite or not a number")) << material;
    const Shape& shape = scene.shapes[0];
    for (const bool bends : {false, true}) {
      ShadingPoint point;
      point.ng = point.unbent = {0, 0, 1};
      point.dpdu = {1, 0, 0}, point.dpdv = {0, 1, 0};
      point.wo = normalize(Vec3f{0.3f, 0.2f, 0.8f});
      point.bends = bends;
      Bsdf bsdf;
      make_bsdf(*shape.material, point, bsdf);
      const float opacity = shape.material->opacity(point);
      EXPECT_TRUE(opacity >= 0 && opacity <= 1) << material;
      Rgb sum = bsdf.albedo(point.wo) + bsdf.eval(point.wo, normalize(Vec3f{-0.3f, -0.1f, 0.9f})).sum();
      if (shape.emission) sum += shape.emission->radiance.rgb(point);
      EXPECT_TRUE(is_finite(sum) && std::min({sum.r, sum.g, sum.b}) >= 0) << material;
    }
  }
}

TEST_F(Gltf, DoubleSidedSurfacesShineBothWays) {
  const auto both_sides = [&](const std::string& sided) {
    Buffer buffer;
    const Scene scene = load(triangle(buffer, "", fmt::format(R"("materials":[{{{}"emissiveFactor":[1,1,1]}}])", sided),
                                      R"(,"material":0)"));
    return scene.shapes[0].emission->two_sided;
  };
  EXPECT_FALSE(both_sides(""));
  EXPECT_FALSE(both_sides(R"("doubleSided":false,)"));
  EXPECT_TRUE(both_sides(R"("doubleSided":true,)"));
}

TEST_F(Gltf, SolidGlassIsTintedAtEachCrossingOrOnceInAll) {
  for (const bool once : {false, true}) {
    Buffer buffer;
    ImportOptions options;
    options.tints_once = once;
    const Scene scene = load(
        triangle(
            buffer, "",
            R"("materials":[{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.5,0.5,1],"metallicFactor":0,"roughnessFactor":0},
"extensions":{"KHR_materials_transmission":{"transmissionFactor":1},"KHR_materials_volume":{"thicknessFactor":1},
"KHR_materials_ior":{"ior":1.5},"KHR_materials_specular":{"specularFactor":0}}}])",
            R"(,"material":0)"),
        options);
    EXPECT_TRUE(scene.bend_normals);
    float through = 1;  // straight through a slab: in at the front, out at the back
    for (const float z : {1.0f, -1.0f}) {
      ShadingPoint point;
      point.ng = point.unbent = {0, 0, 1};
      point.wo = {0, 0, z};
      Bsdf bsdf;
      make_bsdf(*scene.shapes[0].material, point, bsdf);
      for (int i = 0; i < bsdf.size(); ++i) {
        const auto s = bsdf.sample_delta(i, point.wo);
        if (s && s->transmitted) through *= s->sum().g * s->eta * s->eta;
      }
    }
    EXPECT_NEAR(through, once ? 0.5f : 0.25f, 1e-5f);
  }
}

}  // namespace
}  // namespace tempera
