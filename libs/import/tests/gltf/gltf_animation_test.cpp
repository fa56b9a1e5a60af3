// SPDX-License-Identifier: Apache-2.0
// Clips that other tools wrote badly: what can be understood plays, with a warning; the rest of the file is not to
// suffer.
#include <cmath>
#include <limits>

#include "gltf_test_util.h"

namespace tempera {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN(), kInf = std::numeric_limits<float>::infinity();

struct Keys {
  std::vector<float> times, values;
  const char* shape = "VEC3";
  const char* path = "translation";
  const char* mode = "LINEAR";
};

/// A node that one channel moves. The sampler stands on line 2, the channel on line 3.
std::string clip(const Keys& keys) {
  Buffer buffer;
  const auto accessor = [&](const std::vector<float>& numbers, const char* shape) {
    return numbers.empty() ? buffer.add_json(fmt::format(R"({{"componentType":5126,"count":0,"type":"{}"}})", shape))
                           : buffer.floats(numbers, shape);
  };
  const int input = accessor(keys.times, "SCALAR"), output = accessor(keys.values, keys.shape);
  if (keys.times.empty() && keys.values.empty()) buffer.floats({0}, "SCALAR");
  return asset(
      fmt::format("\"nodes\":[{{\"name\":\"n\"}}],\"animations\":[{{\"name\":\"walk\",\"samplers\":[\n"
                  "{{\"interpolation\":\"{}\",\"input\":{},\"output\":{}}}],\"channels\":[\n"
                  "{{\"sampler\":0,\"target\":{{\"node\":0,\"path\":\"{}\"}}}}]}}],{}",
                  keys.mode, input, output, keys.path, buffer.json()));
}

/// x of a node's translation.
double x_at(const Scene& scene, double t) { return scene.world(0, t).translation.x; }

TEST_F(Gltf, KeysInDisorderPlayWithAWarning) {
  struct Case {
    const char* warning;
    Keys keys;
    std::vector<std::pair<double, double>> right;  // time, x
  };
  const std::vector<float> ramp = {0, 0, 0, 1, 0, 0, 2, 0, 0};
  const Case cases[] = {
      {"before time 0", {{-0.125f, 0, 1}, ramp}, {{-0.125, 0}, {-0.0625, 0.5}, {0, 1}, {0.5, 1.5}, {1, 2}}},
      {"several keys at one time",
       {{0, 1, 1, 2}, {0, 0, 0, 1, 0, 0, 5, 0, 0, 6, 0, 0}},
       {{0.5, 0.5}, {0.9999, 0.9999}, {1, 5}, {1.5, 5.5}}},
      {"several keys at one time",
       {{0, 1, 1, 1, 2}, {0, 0, 0, 1, 0, 0, 9, 0, 0, 5, 0, 0, 6, 0, 0}},
       {{0.5, 0.5}, {0.9999, 0.9999}, {1, 5}, {1.5, 5.5}}},
      {"several keys at one time",
       {{0, 1, 1, 2}, {0, 0, 0, 1, 0, 0, 5, 0, 0, 6, 0, 0}, "VEC3", "translation", "STEP"},
       {{0.5, 0}, {0.9999, 0}, {1, 5}, {1.5, 5}}},
      {"not in the order of time",
       {{2, 0, 1}, {2, 0, 0, 0, 0, 0, 7, 0, 0}},
       {{0, 0}, {0.5, 3.5}, {1, 7}, {1.5, 4.5}, {2, 2}}},
      {"not finite or too large", {{0, kNan, 2}, ramp}, {{0, 0}, {1, 1}, {2, 2}}},
      {"not finite or too large", {{0, 1, kInf}, ramp}, {{0, 0}, {1, 1}, {9, 1}}},
      {"not finite or too large", {{0, 1, 2}, {0, 0, 0, kNan, 0, 0, 4, 0, 0}}, {{0, 0}, {1, 2}, {2, 4}}},
      {"not finite or too large", {{0, 1, 2}, {0, 0, 0, 3, 1e35f, 0, 4, 0, 0}}, {{0, 0}, {1, 2}, {2, 4}}},
      {"other numbers of key times", {{0, 1, 2, 3}, ramp}, {{0, 0}, {2, 2}, {3, 2}}},
      {"other numbers of key times", {{0, 1}, ramp}, {{0, 0}, {1, 1}, {2, 1}}},
      {"without tangents", {{0, 1, 2}, ramp, "VEC3", "translation", "CUBICSPLINE"}, {{0, 0}, {0.5, 0.5}, {2, 2}}},
      {"lower case", {{0, 1, 2}, ramp, "VEC3", "translation", "step"}, {{0.5, 0}, {1.5, 1}, {2, 2}}},
      {"without keys", {{}, ramp}, {{0, 0}, {2, 0}}},
      {"without keys", {{0, 1}, {}}, {{0, 0}, {2, 0}}},
      {"without keys", {{}, {}}, {{0, 0}, {2, 0}}},
      {"without keys", {{kNan, kNan, kNan}, ramp}, {{0, 0}, {2, 0}}},
      {"\"BEZIER\" is no interpolation", {{0, 1, 2}, ramp, "VEC3", "translation", "BEZIER"}, {{0, 0}, {2, 0}}},
      {"type VEC3 instead of VEC4", {{0, 1, 2}, ramp, "VEC3", "rotation"}, {{0, 0}, {2, 0}}},
      {"path \"color\" is ignored", {{0, 1, 2}, ramp, "VEC3", "color"}, {{0, 0}, {2, 0}}},
      {"no mesh with morph targets", {{0, 1, 2}, {0, 1, 2}, "SCALAR", "weights"}, {{0, 0}, {2, 0}}},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.warning);
    Warnings warnings;
    const fs::path file = write("test.gltf", clip(c.keys));
    const Scene scene = import_gltf(file, {}, warnings);
    validate(scene);
    for (const auto& [t, x] : c.right) EXPECT_NEAR(x_at(scene, t), x, 1e-5) << "at " << t;
    int found = 0;
    for (const std::string& line : warnings.lines()) {
      EXPECT_NE(line.find("test.gltf:"), std::string::npos) << line;
      found += line.find(c.warning) != line.npos;
    }
    EXPECT_EQ(found, 1) << "a warning of its kind";
    EXPECT_GE(scene.animation.begin, 0);

    // It is of no interest to anyone who does not ask for it, and an error only under --strict.
    Warnings none;
    EXPECT_NO_THROW(import_gltf(file, {.animation = "none"}, none));
    for (const std::string& line : none.lines())
      EXPECT_TRUE(line.find("animation") == line.npos && line.find("key") == line.npos) << line;
    EXPECT_THROW(import_scene(file, {.strict = true}, none), Error);
  }
}

TEST_F(Gltf, RotationKeysWithoutLengthAreLeftOut) {
  const float h = float(std::sqrt(0.5));
  const Scene scene = load(clip({{0, 1, 2}, {0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 2 * h, 2 * h}, "VEC4", "rotation"}));
  EXPECT_TRUE(warned("without length"));
  EXPECT_TRUE(warned("normalized"));
  expect_near(scene.world(0, 1).vector({1, 0, 0}), {std::cos(kPiD / 4), std::sin(kPiD / 4), 0}, 1e-6);
  expect_near(scene.world(0, 2).vector({1, 0, 0}), {0, 1, 0}, 1e-6);
}

TEST_F(Gltf, OneBadChannelDoesNotStopTheOthers) {
  Buffer buffer;
  const int times = buffer.floats({0, 1}, "SCALAR"), moves = buffer.floats({0, 0, 0, 3, 0, 0}, "VEC3");
  const int broken = buffer.add_json(R"({"bufferView":0,"componentType":5126,"count":900,"type":"VEC3"})");
  const int sparse = buffer.add_json(
      R"({"componentType":5126,"count":2,"type":"VEC3","sparse":{"count":1,"indices":{"bufferView":77}}})");
  const auto channel = [](const char* sampler, const char* target) {
    return fmt::format(R"({{"sampler":{},"target":{}}})", sampler, target);
  };
  const std::string channels =
      fmt::format("{},{},{},{},{},{},{},{},{},7,{}", channel("0", R"({"node":0,"path":"translation"})"),
                  channel("0", R"({"node":0,"path":"translation"})"),  // again
                  channel("1", R"({"node":0,"path":"scale"})"), channel("2", R"({"node":0,"path":"rotation"})"),
                  channel("99", R"({"node":1,"path":"translation"})"),
                  channel("0", R"({"node":99,"path":"translation"})"), channel("0", R"({"path":"translation"})"),
                  channel("0", R"({"node":2,"path":"translation"})"), channel("0", "3"), R"({"sampler":0})");
  const std::string json = asset(fmt::format(
      R"("nodes":[{{}},{{}},{{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}],
"animations":[{{"channels":[{}],"samplers":[{{"input":{},"output":{}}},{{"input":{},"output":{}}},{{"input":{},"output":{}}}]}},
{{"name":"empty"}},{{"name":"bare","channels":[],"samplers":[]}}],{})",
      channels, times, moves, times, broken, sparse, moves, buffer.json()));
  const Scene scene = load(json);
  EXPECT_NEAR(x_at(scene, 0.5), 1.5, 1e-6);
  EXPECT_EQ(scene.world(1, 1), Affine3d{});
  for (const char* part :
       {"what an earlier one of their animation drives", "needs 10800 bytes", "lacks the required property \"values\"",
        "refers to samplers[99]", "refers to nodes[99]", "without a node", "with a matrix instead",
        "is a number instead of an object", "lacks the required property \"target\"", "animations without channels",
        "lacks the required property \"channels\""})
    EXPECT_TRUE(warned(part)) << part;
  EXPECT_EQ(scene.animation_names, (std::vector<std::string>{"0", "empty", "bare"}));
}

TEST_F(Gltf, WeightsForOtherNumbersOfTargets) {
  for (const int given : {1, 3}) {
    Buffer buffer;
    const int times = buffer.floats({0, 1}, "SCALAR");
    std::vector<float> weights(std::size_t(2 * given), 0.0f);
    weights[given] = 0.5f;  // of the first target, at 1 s
    const int output = buffer.floats(weights, "SCALAR"), shift = buffer.floats({0, 0, 1, 0, 0, 1, 0, 0, 1}, "VEC3");
    const Scene scene = load(
        triangle(buffer, "",
                 fmt::format(R"("animations":[{{"channels":[{{"sampler":0,"target":{{"node":0,"path":"weights"}}}}],
"samplers":[{{"input":{},"output":{}}}]}}])",
                             times, output),
                 fmt::format(R"(,"targets":[{{"POSITION":{}}},{{"POSITION":{}}}])", shift, shift)));
    EXPECT_TRUE(warned("another number of morph targets"));
    expect_near(world_position(scene, 0, 0, 1), {0, 0, 0.5}, 1e-6);
  }
}

TEST_F(Gltf, PropertiesThatJumpKeepBothValues) {
  // A camera whose angle jumps at 1 s (two keys), and an emission that is a product of a step and a ramp.
  Buffer buffer;
  const int times = buffer.floats({0, 1, 1, 2}, "SCALAR"), angles = buffer.floats({0.5f, 0.5f, 1, 1}, "SCALAR");
  const int steps = buffer.floats({0, 1}, "SCALAR"), colors = buffer.floats({1, 1, 1, 0.25f, 0.25f, 0.25f}, "VEC3");
  const int ramp_times = buffer.floats({0, 2}, "SCALAR"), ramp = buffer.floats({2, 4}, "SCALAR");
  const auto pointer = [](int sampler, const char* what) {
    return fmt::format(
        R"({{"sampler":{},"target":{{"path":"pointer","extensions":{{"KHR_animation_pointer":{{"pointer":"{}"}}}}}}}})",
        sampler, what);
  };
  std::string json = triangle(
      buffer, "",
      fmt::format(R"("cameras":[{{"type":"perspective","perspective":{{"yfov":0.5,"znear":0.1,"aspectRatio":1}}}}],
"materials":[{{"emissiveFactor":[1,1,1],"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":2}}}}}}],
"extensionsUsed":["KHR_animation_pointer","KHR_materials_emissive_strength"],
"animations":[{{"channels":[{},{},{}],"samplers":[{{"input":{},"output":{}}},
{{"input":{},"output":{},"interpolation":"STEP"}},{{"input":{},"output":{}}}]}}])",
                  pointer(0, "/cameras/0/perspective/yfov"), pointer(1, "/materials/0/emissiveFactor"),
                  pointer(2, "/materials/0/extensions/KHR_materials_emissive_strength/emissiveStrength"), times, angles,
                  steps, colors, ramp_times, ramp),
      R"(,"material":0)");
  json.replace(json.find(R"("name":"thing"})"), 15, R"("name":"thing"},{"camera":0})");
  const Scene scene = load(json);
  ASSERT_EQ(scene.cameras.size(), 1u);
  EXPECT_NEAR(scene.cameras[0].fov_x.at(0.5), 0.5, 1e-5);
  EXPECT_NEAR(scene.cameras[0].fov_x.at(0.9999), 0.5, 1e-3);
  EXPECT_NEAR(scene.cameras[0].fov_x.at(1), 1, 1e-5);

  const std::optional<AreaEmission>& emission = scene.shapes.at(0).emission;
  ASSERT_TRUE(emission.has_value());
  const auto& factor = emission->radiance.factor;
  EXPECT_NEAR(factor.at(0).r, 2, 1e-5);
  EXPECT_NEAR(factor.at(0.9999).r, 3, 1e-3);
  EXPECT_NEAR(factor.at(1).r, 0.75, 1e-5);
  EXPECT_NEAR(factor.at(2).r, 1, 1e-5);
}

TEST_F(Gltf, ProductsJumpWhereKeysAreRounded) {
  // The step stands a little after a key of the ramp, as float32 has it.
  Buffer buffer;
  const int steps = buffer.floats({0, 1.0000002f}, "SCALAR"), colors = buffer.floats({1, 1, 1, 0, 0, 0}, "VEC3");
  const int ramp_times = buffer.floats({0, 1, 2}, "SCALAR"), ramp = buffer.floats({2, 3, 4}, "SCALAR");
  const Scene scene = load(triangle(
      buffer, "",
      fmt::format(
          R"("materials":[{{"emissiveFactor":[1,1,1],"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":2}}}}}}],
"extensionsUsed":["KHR_animation_pointer","KHR_materials_emissive_strength"],"animations":[{{"channels":[
{{"sampler":0,"target":{{"path":"pointer","extensions":{{"KHR_animation_pointer":{{"pointer":"/materials/0/emissiveFactor"}}}}}}}},
{{"sampler":1,"target":{{"path":"pointer","extensions":{{"KHR_animation_pointer":{{"pointer":"/materials/0/extensions/KHR_materials_emissive_strength/emissiveStrength"}}}}}}}}],
"samplers":[{{"input":{},"output":{},"interpolation":"STEP"}},{{"input":{},"output":{}}}]}}])",
          steps, colors, ramp_times, ramp),
      R"(,"material":0)"));
  const auto& factor = scene.shapes.at(0).emission.value().radiance.factor;
  EXPECT_NEAR(factor.at(0.5).r, 2.5, 1e-5);
  EXPECT_NEAR(factor.at(0.9999).r, 2.9999, 1e-4);
  EXPECT_EQ(factor.at(1).r, 0);
  EXPECT_EQ(factor.at(1.5).r, 0);
}

}  // namespace
}  // namespace tempera
