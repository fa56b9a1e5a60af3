// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "gltf_test_util.h"

namespace tempera {
namespace {

struct Sample {
  const char* file;
  std::size_t triangles;  // over instances
  std::size_t instances, shapes, lights, cameras, clips;
  double begin, end;
};

TEST_F(Gltf, SamplesLoadWithExpectedCounts) {
  // Counts as in the files' JSON (triangles: indices / 3 per mesh and node); times: the input accessors' min and max.
  const Sample samples[] = {
      {"AnimatedCube/AnimatedCube.gltf", 12, 1, 1, 0, 0, 1, 0, 2},
      {"AnimatedMorphCube/AnimatedMorphCube.glb", 12, 1, 1, 0, 0, 1, 0, 4.2},
      {"AnimatedTriangle/AnimatedTriangle.gltf", 1, 1, 1, 0, 0, 1, 0, 1},
      {"BoxAnimated/BoxAnimated.glb", 254, 2, 2, 0, 0, 1, 0, 3.70833},
      {"Cameras/Cameras.gltf", 2, 1, 1, 0, 2, 0, 0, 0},
      {"CesiumMan/CesiumMan.glb", 4672, 1, 1, 0, 0, 1, 0.0416667, 2},
      {"ClearCoatTest/ClearCoatTest.glb", 37116, 27, 27, 0, 0, 0, 0, 0},
      {"EmissiveStrengthTest/EmissiveStrengthTest.glb", 90, 6, 6, 0, 0, 0, 0, 0},
      {"Fox/Fox.glb", 576, 1, 1, 0, 0, 3, 0, 3.41667},
      {"GlassVaseFlowers/GlassVaseFlowers.glb", 14036, 4, 3, 0, 0, 0, 0, 0},
      {"InterpolationTest/InterpolationTest.glb", 110, 10, 10, 0, 0, 9, 0, 1.70833},
      {"LightsPunctualLamp/LightsPunctualLamp.gltf", 6000, 3, 3, 5, 0, 0, 0, 0},
      {"MeshPrimitiveModes/MeshPrimitiveModes.gltf", 16, 3, 3, 0, 0, 0, 0, 0},
      {"MorphStressTest/MorphStressTest.glb", 2412, 1, 2, 0, 0, 3, 0.0333333, 9.36667},
      {"NegativeScaleTest/NegativeScaleTest.glb", 7724, 11, 8, 0, 0, 0, 0, 0},
      {"RecursiveSkeletons/RecursiveSkeletons.glb", 6384, 84, 84, 0, 0, 1, 0, 2},
      {"RiggedFigure/RiggedFigure.glb", 256, 1, 1, 0, 0, 1, 0, 1.25},
      {"SimpleInstancing/SimpleInstancing.glb", 1500, 125, 1, 0, 0, 0, 0, 0},
      {"SimpleMorph/SimpleMorph.gltf", 1, 1, 1, 0, 0, 1, 0, 4},
      {"SimpleSkin/SimpleSkin.gltf", 8, 1, 1, 0, 0, 1, 0, 5.5},
      {"SimpleSparseAccessor/SimpleSparseAccessor.gltf", 12, 1, 1, 0, 0, 0, 0, 0},
      {"TextureTransformTest/TextureTransformTest.gltf", 24, 12, 9, 0, 0, 0, 0, 0},
      {"ToyCar/ToyCar.gltf", 108936, 3, 3, 0, 8, 0, 0, 0},
      {"TransmissionRoughnessTest/TransmissionRoughnessTest.glb", 77792, 9, 9, 0, 0, 0, 0, 0},
      {"TransmissionTest/TransmissionTest.glb", 128775, 22, 22, 0, 1, 0, 0, 0},
  };
  const fs::path root = shared_scenes() / "gltf";
  if (!fs::exists(root)) GTEST_SKIP() << "no sample scenes at " << root;
  for (const Sample& sample : samples) {
    SCOPED_TRACE(sample.file);
    const Scene scene = load_sample(root / sample.file);
    std::size_t triangles = 0;
    for (std::size_t i = 0; i < scene.instances.size(); ++i)
      for (const int s : scene.groups[scene.instances[i].group])
        triangles += std::get<Mesh>(scene.shapes[s].geometry).triangle_count();
    EXPECT_EQ(triangles, sample.triangles);
    EXPECT_EQ(scene.instances.size(), sample.instances);
    EXPECT_EQ(scene.shapes.size(), sample.shapes);
    EXPECT_EQ(scene.lights.size(), sample.lights);
    EXPECT_EQ(scene.cameras.size(), sample.cameras);
    EXPECT_EQ(scene.animation_names.size(), sample.clips);
    EXPECT_NEAR(scene.animation.begin, sample.begin, 1e-4);
    EXPECT_NEAR(scene.animation.end, sample.end, 1e-4);
    EXPECT_NE(scene.content_hash, 0u);
  }
}

TEST_F(Gltf, InterpolationsMatchHandEvaluatedValues) {
  const fs::path file = shared_scenes() / "gltf/InterpolationTest/InterpolationTest.glb";
  if (!fs::exists(file)) GTEST_SKIP();
  const Scene scene = load_sample(file);  // nine clips on nine nodes play together
  const auto local = [&](const char* node, double t) { return scene.nodes[node_named(scene, node)].local.at(t); };
  const auto scale_of = [&](const char* node, double t) { return length(local(node, t).x); };
  // Scale keys 1, 0.5, 1, ... at 1/24, 10/24, 21/24 s.
  EXPECT_NEAR(scale_of("Cube", 0.4), 1, 1e-6);  // step
  EXPECT_NEAR(scale_of("Cube", 0.42), 0.5, 1e-6);
  EXPECT_NEAR(scale_of("Cube", -1), 1, 1e-6);                            // clamped
  EXPECT_NEAR(scale_of("Cube.001", 1 / 24.0 + 0.375 / 4), 0.875, 1e-6);  // linear, a quarter of the way
  EXPECT_NEAR(scale_of("Cube.002", 1 / 24.0 + 0.375 / 4), 0.921875,
              1e-6);  // cubic with zero tangents: 1 - 0.5 (3/16 - 2/64)
  // Rotations about z by 0, -45, -90 degrees at 0, 10/24, 21/24 s.
  const auto angle_of = [&](const char* node, double t) {
    return std::atan2(local(node, t).x.y, local(node, t).x.x) * 180 / kPiD;
  };
  EXPECT_NEAR(angle_of("Cube.003", 0.5), -45, 1e-4);
  EXPECT_NEAR(angle_of("Cube.005", 5 / 24.0), -22.5, 1e-4);  // slerp: constant speed
  // Middle of the first segment: 0.5 p0 + dt/8 m0 + 0.5 p1 - dt/8 m1, z and w before normalisation -0.1888472,
  // 0.9619997.
  EXPECT_NEAR(angle_of("Cube.004", 5 / 24.0), 2 * std::atan2(-0.1888472, 0.9619997) * 180 / kPiD, 1e-3);
  // Translations.
  expect_near(local("Cube.006", 0.7).translation, {0, 10, 0}, 1e-5);
  expect_near(local("Cube.009", 0.625).translation, {-3.297581, 8, 0}, 1e-5);
  expect_near(local("Cube.008", 0.625).translation, {3.305180, 8, 0}, 1e-5);
  expect_near(local("Cube.008", 0.416667 + 0.416667 / 4).translation, {3.305180, 10 - 4 * 0.15625, 0}, 1e-5);
}

TEST_F(Gltf, SkinsFollowTheirJoints) {
  const fs::path root = shared_scenes() / "gltf";
  if (!fs::exists(root)) GTEST_SKIP();
  {  // The upper joint, at (0, 1, 0), turns by 2 atan(0.707 / 0.707) = 90 degrees at 1 s; vertex 9 hangs on it alone.
    const Scene scene = load_sample(root / "SimpleSkin/SimpleSkin.gltf");
    expect_near(world_position(scene, 0, 9, 0), {0.5, 2, 0}, 1e-6);
    expect_near(world_position(scene, 0, 9, 1), {-1, 1.5, 0}, 1e-4);
    expect_near(world_position(scene, 0, 5, 1), {0.25, 1.25, 0}, 1e-4);  // mean of (0.5, 1) and (0, 1.5)
    expect_near(world_position(scene, 0, 0, 1), {-0.5, 0, 0}, 1e-6);
  }
  // From an independent evaluation in double precision (own reader, slerp and blending).
  struct Expected {
    double time;
    std::uint32_t vertex;
    Vec3d position;
  };
  const Expected man[] = {
      {0.3, 0, {0.021497, 0.977125, 0.109360}},     {0.3, 1000, {-0.090686, 1.436907, -0.076245}},
      {0.3, 2000, {0.042601, 0.211689, -0.201956}}, {0.3, 3000, {0.096071, 1.430778, 0.172575}},
      {0.77, 0, {0.015816, 0.932890, 0.105551}},    {0.77, 1000, {-0.092638, 1.401575, -0.062606}},
      {0.77, 2000, {0.041790, 0.153812, 0.428880}}, {0.77, 3000, {0.136571, 1.372015, 0.145569}},
      {1.5, 0, {0.006733, 0.989178, 0.123583}},     {1.5, 1000, {-0.192813, 1.430932, -0.031330}},
      {1.5, 2000, {0.052512, 0.025016, -0.089434}}, {1.5, 3000, {-0.037415, 1.445348, 0.238185}},
  };
  const Scene cesium = load_sample(root / "CesiumMan/CesiumMan.glb");
  for (const Expected& e : man) expect_near(world_position(cesium, 0, e.vertex, e.time), e.position, 1e-5);
  const std::pair<const char*, std::vector<Expected>> clips[] = {
      {"Survey", {{1.0, 0, {2.055216, 33.011986, -20.419275}}, {1.0, 1500, {-5.669781, 5.049250, 20.759435}}}},
      {"Walk", {{0.5, 0, {0.818340, 37.430446, -17.791297}}, {0.5, 1500, {-5.667498, 5.545320, 26.592205}}}},
      {"2", {{0.33, 0, {2.895524, 28.687298, -20.334437}}, {0.33, 1500, {-7.419964, 21.464526, 59.698782}}}},
  };
  for (const auto& [clip, expected] : clips) {
    ImportOptions options;
    options.animation = clip;
    const Scene fox = load_sample(root / "Fox/Fox.glb", options);  // 100 units long
    for (const Expected& e : expected) expect_near(world_position(fox, 0, e.vertex, e.time), e.position, 1e-3);
  }
}

TEST_F(Gltf, NegativeScaleKeepsFrontFacesInFront) {
  const fs::path file = shared_scenes() / "gltf/NegativeScaleTest/NegativeScaleTest.glb";
  if (!fs::exists(file)) GTEST_SKIP();
  const Scene scene = load_sample(file);
  int mirrored = 0;
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const Affine3d world = scene.world(scene.instances[i].node, 0);
    mirrored += world.determinant() < 0;
    const Mesh& mesh = mesh_of(scene, i);
    for (std::size_t t = 0; t < mesh.triangle_count(); ++t) {
      const std::uint32_t* v = &mesh.indices[3 * t];
      const auto p = [&](int k) { return world.point(Vec3d(mesh.positions[v[k]])); };
      // glTF 2.0, 3.7.4: a negative determinant reverses the winding. The stored normals must lie on that side.
      const Vec3d winding = cross(p(1) - p(0), p(2) - p(0)) * (world.determinant() < 0 ? -1.0 : 1.0);
      const Vec3d normal = inverse(world).transposed_vector(Vec3d(mesh.normals[v[0]]));
      if (length(winding) < 1e-9) continue;
      ASSERT_GT(dot(normalize(winding), normalize(normal)), -0.2);
    }
  }
  EXPECT_GE(mirrored, 2);
}

TEST_F(Gltf, BlenderFilesPlayAllAnimationsAndKeepTheirLook) {
  const fs::path file = shared_scenes() / "blender/cornell_anim.glb";
  if (!fs::exists(file)) GTEST_SKIP();
  const Scene scene = load_sample(file);
  ASSERT_EQ(scene.animation_names, (std::vector<std::string>{"sphereAction", "boxAction"}));
  // The script keys frames 1 and 24 at 24 fps; Blender's frame 24 is glTF's 1 s. Blender's (x, y, z) is our (x, z, -y).
  const auto at = [&](const char* name, double t) { return scene.world(node_named(scene, name), t).translation; };
  expect_near(at("sphere", 1 / 24.0), {-0.9, 0.42, 0.3}, 1e-5);
  expect_near(at("sphere", 1), {0.3, 0.42, 0.3}, 1e-5);
  expect_near(at("sphere", 0.5), {-0.9 + 1.2 * 11 / 23, 0.42, 0.3}, 1e-5);
  expect_near(at("box", 1), {0.55, 0.4501, -0.3}, 1e-5);
  expect_near(scene.world(node_named(scene, "box"), 1).x, {0, 0, -0.5}, 1e-4);  // turned by 90 degrees, 0.5 wide
  EXPECT_NEAR(scene.animation.end, 1, 1e-6);
  ASSERT_EQ(scene.cameras.size(), 1u);
  const Camera& camera = scene.cameras[0];
  EXPECT_NEAR(camera.fov_x.at(0) * 180 / kPiD, 53.13, 0.01);
  EXPECT_TRUE(camera.keep_vertical_fov);
  EXPECT_NEAR(camera.authored_aspect, 16.0 / 9, 1e-5);
  const Affine3d view = scene.world(camera.node, 0);
  expect_near(view.translation, {0, 0.9, 4.2}, 1e-5);
  expect_near(view.z, {0, 0, -1}, 1e-6);
  expect_near(view.y, {0, 1, 0}, 1e-6);
  expect_near(view.x, {-1, 0, 0}, 1e-6);
  int emitters = 0;
  for (const Shape& shape : scene.shapes) {
    if (!shape.emission) continue;
    ++emitters;
    EXPECT_EQ(shape.name, "light");
    EXPECT_TRUE(shape.emission->two_sided);
    EXPECT_NEAR(shape.emission->radiance.mean().r, 16, 1e-4);
    EXPECT_NEAR(shape.emission->radiance.mean().b, 9.6, 1e-4);
  }
  EXPECT_EQ(emitters, 1);
  // The glass is a solid as in Cycles, not thin-walled as the file says by the letter: light is bent at its surface.
  for (const Shape& shape : scene.shapes) {
    if (shape.material_name != "glass") continue;
    ShadingPoint point;
    point.ng = {0, 0, 1};
    point.wo = normalize(Vec3f(1, 0, 1));
    Bsdf bsdf;
    shape.material->add_lobes(point, 1, bsdf);
    bool refracts = false;
    for (int i = 0; i < 64; ++i)
      if (const auto sample = bsdf.sample(point.wo, (float(i) + 0.5f) / 64, {0.5f, 0.5f});
          sample && sample->transmitted) {
        refracts = true;
        EXPECT_NEAR(-sample->wi.x, std::sqrt(0.5f) / 1.5f, 1e-3);
      }
    EXPECT_TRUE(refracts);
  }
}

TEST_F(Gltf, ClipsThatCannotPlayTogetherAreChosenAsWholes) {
  Buffer buffer;
  const int times = buffer.floats({0, 2}, "SCALAR"), move = buffer.floats({0, 0, 0, 2, 0, 0}, "VEC3"),
            grow = buffer.floats({1, 1, 1, 3, 3, 3}, "VEC3");
  const auto clip = [&](const char* name, int node, const char* path, int output) {
    return fmt::format(
        R"({{"name":"{}","samplers":[{{"input":{},"output":{}}}],"channels":[{{"sampler":0,"target":{{"node":{},"path":"{}"}}}}]}})",
        name, times, output, node, path);
  };
  const std::string json =
      asset(fmt::format(R"("nodes":[{{"name":"a"}},{{"name":"b"}}],"animations":[{},{},{},{}],{})",
                        clip("walk", 0, "translation", move), clip("run", 0, "translation", grow),
                        clip("grow", 0, "scale", grow), clip("other", 1, "translation", move), buffer.json()));
  {
    const Scene scene = load(json);
    EXPECT_NEAR(scene.nodes[0].local.at(1).translation.x, 1, 1e-6);
    EXPECT_NEAR(scene.nodes[0].local.at(1).x.x, 2, 1e-6);
    EXPECT_NEAR(scene.nodes[1].local.at(1).translation.x, 1, 1e-6);
    EXPECT_TRUE(warned("\"run\" move what an earlier one moves"));
    EXPECT_FALSE(warned("\"walk\""));
  }
  ImportOptions options;
  options.animation = "run";
  EXPECT_NEAR(load(json, options).nodes[0].local.at(1).translation.x, 2, 1e-6);
  options.animation = "3";
  EXPECT_TRUE(load(json, options).nodes[0].local.is_constant());
  EXPECT_FALSE(load(json, options).nodes[1].local.is_constant());
  options.animation = "none";
  const Scene still = load(json, options);
  EXPECT_EQ(still.animation, TimeSpan{});
  EXPECT_EQ(still.animation_names.size(), 4u);
  options.animation = "wlak";
  expect_error(json, ErrorCode::kUnknownName, 1, "no animation \"wlak\"; known: walk", "test.gltf", options);
}

}  // namespace
}  // namespace tempera
