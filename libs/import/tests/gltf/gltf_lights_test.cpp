// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "gltf_test_util.h"

namespace tempera {
namespace {

TEST_F(Gltf, CamerasLookAlongMinusZWithoutScale) {
  const Scene scene = load(asset(
      R"("nodes":[{"camera":0,"scale":[0.1,0.1,0.1],"translation":[1,2,3],"rotation":[0,0.7071067811865476,0,0.7071067811865476]},{"name":"top","camera":1}],
"cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":0.1}},{"type":"orthographic","orthographic":{"xmag":3,"ymag":1.5,"znear":0,"zfar":9}}])"));
  ASSERT_EQ(scene.cameras.size(), 2u);
  const Affine3d view = scene.world(scene.cameras[0].node, 0);
  expect_near(view.z, {-1, 0, 0}, 1e-6);  // -z turned by 90 degrees about y
  expect_near(view.y, {0, 1, 0}, 1e-6);
  expect_near(view.translation, {1, 2, 3}, 1e-9);
  EXPECT_NEAR(scene.cameras[0].fov_x.at(0), 2 * std::atan(16.0 / 9 * std::tan(0.5)), 1e-6);
  EXPECT_EQ(scene.cameras[1].projection, Projection::kOrthographic);
  EXPECT_NEAR(scene.cameras[1].width.at(0), 6, 1e-6);  // xmag is half the width
  EXPECT_NEAR(scene.cameras[1].authored_aspect, 2, 1e-6);
  EXPECT_EQ(scene.cameras[1].name, "top");
}

std::string light_file(const std::string& generator) {
  return fmt::format(R"({{"asset":{{"version":"2.0","generator":"{}"}},
"nodes":[{{"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}},{{"extensions":{{"KHR_lights_punctual":{{"light":1}}}}}}],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"spot","intensity":683,"color":[1,0.5,0.25],"spot":{{"innerConeAngle":0.2,"outerConeAngle":0.6}}}},{{"type":"directional","intensity":1366}}]}}}}}})",
                     generator);
}

TEST_F(Gltf, LightsKeepTheRatioToSurfaces) {
  {
    const Scene scene = load(light_file("somebody"));
    ASSERT_EQ(scene.lights.size(), 2u);
    const PunctualLight& spot = scene.lights[0];
    EXPECT_EQ(spot.type, LightType::kSpot);
    EXPECT_NEAR(spot.intensity_scale.at(0), 683, 1e-3);
    EXPECT_EQ(spot.intensity.at(0), Rgb(1, 0.5f, 0.25f));
    EXPECT_EQ(spot.falloff, SpotFalloff::kSquared);
    EXPECT_NEAR(spot.beam_width.at(0), 0.2, 1e-6);
    EXPECT_NEAR(spot.cutoff_angle.at(0), 0.6, 1e-6);
    expect_near(scene.world(spot.node, 0).z, {0, 0, -1}, 1e-6);
  }
  // 4 pi W in Blender are 1 W/sr, which version 3.4 and later write as 683 cd and earlier ones as 4 pi. Cycles shows a
  // white surface at distance 2 under a point light of 100 W as 100 / (4 pi) / 2^2 / pi (measured with Blender 3.4).
  const Scene now = load(light_file("Khronos glTF Blender I/O v3.4.50")),
              before = load(light_file("Khronos glTF Blender I/O v1.7.33"));
  EXPECT_NEAR(now.lights[0].intensity_scale.at(0), 1, 1e-5);
  EXPECT_NEAR(now.lights[1].intensity_scale.at(0), 2, 1e-5);
  EXPECT_NEAR(before.lights[0].intensity_scale.at(0), 683 / (4 * kPiD), 1e-3);
  EXPECT_NEAR(before.lights[1].intensity_scale.at(0), 1366, 1e-3);
}

TEST_F(Gltf, AnimationPointersDriveCamerasLightsMaterialsAndVisibility) {
  Buffer buffer;
  const int times = buffer.floats({0, 2}, "SCALAR"), number = buffer.floats({1, 0.5f}, "SCALAR"),
            vec3 = buffer.floats({0, 0, 0, 2, 4, 6}, "VEC3");
  const int vec4 = buffer.floats({1, 1, 1, 1, 0, 0, 0, 0.5f}, "VEC4"), vec2 = buffer.floats({0, 0, 1, 0}, "VEC2");
  const int flags = buffer.add(std::vector<std::uint8_t>{1, 0}, "SCALAR", 5121);
  std::string samplers, channels;
  const auto drive = [&](const char* pointer, int output, const char* interpolation = "LINEAR") {
    const char* comma = samplers.empty() ? "" : ",";
    const auto n = std::count(channels.begin(), channels.end(), '\n');
    samplers +=
        fmt::format(R"({}{{"input":{},"output":{},"interpolation":"{}"}})", comma, times, output, interpolation);
    channels += fmt::format(
        R"({}{{"sampler":{},"target":{{"path":"pointer","extensions":{{"KHR_animation_pointer":{{"pointer":"{}"}}}}}}}})"
        "\n",
        comma, n, pointer);
  };
  drive("/cameras/0/perspective/yfov", number);
  drive("/extensions/KHR_lights_punctual/lights/0/intensity", number);
  drive("/extensions/KHR_lights_punctual/lights/0/color", vec3);
  drive("/materials/0/emissiveFactor", vec3);
  drive("/materials/0/pbrMetallicRoughness/baseColorFactor", vec4);
  drive("/materials/0/emissiveTexture/extensions/KHR_texture_transform/offset", vec2);
  drive("/nodes/0/extensions/KHR_node_visibility/visible", flags, "STEP");
  drive("/nodes/0/translation", vec3);
  drive("/materials/0/extensions/KHR_materials_ior/ior", number);
  const std::string rest = fmt::format(
      R"("materials":[{{"alphaMode":"BLEND","emissiveTexture":{{"index":0}}}}],"textures":[{{"source":0,"sampler":0}}],"images":[{{"uri":"{}"}}],
"samplers":[{{"magFilter":9728}}],"cameras":[{{"type":"perspective","perspective":{{"yfov":1,"aspectRatio":1,"znear":0.1}}}}],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point"}}]}}}},
"animations":[{{"samplers":[{}],"channels":[{}]}}])",
      kPng, samplers, channels);
  std::string json = triangle(buffer, "", rest, R"(,"material":0)");
  json.replace(json.find(R"("name":"thing")"), 14,
               R"("name":"thing","camera":0,"extensions":{"KHR_lights_punctual":{"light":0}})");
  const Scene scene = load(json);
  EXPECT_NEAR(scene.cameras[0].fov_x.at(1), 0.75, 1e-3);
  EXPECT_NEAR(scene.lights[0].intensity_scale.at(1), 0.75, 1e-6);
  EXPECT_EQ(scene.lights[0].intensity.at(1), Rgb(1, 2, 3));
  EXPECT_NEAR(scene.world(0, 1).translation.y, 2, 1e-6);
  EXPECT_TRUE(scene.visible(0, 1.9));
  EXPECT_FALSE(scene.visible(0, 2));
  ASSERT_TRUE(scene.shapes[0].emission);
  ShadingPoint point;
  point.uv = {0.25f, 0.25f};
  point.time = 1;
  // At 1 s the texture is shifted by half its width: green instead of red; the factor is (1, 2, 3).
  const Rgb seen = scene.shapes[0].emission->radiance.rgb(point);
  EXPECT_NEAR(seen.r, 0, 1e-5);
  EXPECT_NEAR(seen.g, 2, 1e-5);
  point.time = 0.01;
  EXPECT_NEAR(scene.shapes[0].emission->radiance.rgb(point).g, 0, 1e-5);
  point.time = 2;
  EXPECT_NEAR(scene.shapes[0].material->opacity(point), 0.5, 1e-5);
  EXPECT_TRUE(warned("animation of \"/materials/*/extensions/KHR_materials_ior/ior\" is ignored"));
  EXPECT_EQ(scene.animation, (TimeSpan{0, 2}));
}

TEST_F(Gltf, HiddenNodesHideSkinnedMeshesToo) {
  Buffer buffer;
  const int weights = buffer.floats({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, "VEC4");
  const int joints = buffer.add(std::vector<std::uint8_t>(12, 0), "VEC4", 5121);
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  const auto json = [&](bool visible) {
    return asset(fmt::format(
        R"("nodes":[{{"mesh":0,"skin":0}},{{}},{{"children":[0],"extensions":{{"KHR_node_visibility":{{"visible":{}}}}}}}],"skins":[{{"joints":[1]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{},"JOINTS_0":{},"WEIGHTS_0":{}}}}}]}}],{})",
        visible, position, joints, weights, buffer.json()));
  };
  const Scene shown = load(json(true)), hidden = load(json(false));
  EXPECT_TRUE(shown.visible(shown.instances[0].node, 0));
  EXPECT_FALSE(hidden.visible(hidden.instances[0].node, 0));
}

}  // namespace
}  // namespace tempera
