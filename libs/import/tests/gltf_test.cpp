// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/gltf.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <random>
#include <set>

#include "tempera/scene/deform.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// Sample scenes that not every checkout has.
fs::path shared_scenes() { return fs::path(TEMPERA_SOURCE_DIR) / ".." / "shared" / "scenes"; }

std::string base64(const std::string& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k) bits = bits << 8 | (i + k < bytes.size() ? std::uint8_t(bytes[i + k]) : 0);
    for (std::size_t k = 0; k < 4; ++k) out += i + k > bytes.size() ? '=' : kDigits[bits >> (18 - 6 * k) & 63];
  }
  return out;
}

/// 2 x 2 pixels, RGBA: red 255, green 128 / blue 64, white 0 (alpha is the number).
constexpr const char* kPng =
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAF0lEQVR42mP4z8DwHwgbGIC0w////"
    "xkAQBgHul5CkSMAAAAASUVORK5CYII=";

/// Collects numbers into a buffer and describes them as accessors.
class Buffer {
 public:
  template <class T>
  int add(const std::vector<T>& numbers, const std::string& shape, int type, const std::string& more = {}) {
    const int components = shape == "SCALAR" ? 1 : shape == "MAT4" ? 16 : shape.back() - '0';
    bytes_.resize((bytes_.size() + 3) / 4 * 4);
    views_.push_back(
        fmt::format(R"({{"buffer":0,"byteOffset":{},"byteLength":{}}})", bytes_.size(), numbers.size() * sizeof(T)));
    bytes_.append(reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(T));
    accessors_.push_back(
        fmt::format(R"({{"bufferView":{},"componentType":{},"count":{},"type":"{}","min":[0],"max":[0]{}}})",
                    views_.size() - 1, type, numbers.size() / std::size_t(components), shape, more));
    return int(accessors_.size()) - 1;
  }
  int floats(const std::vector<float>& numbers, const std::string& shape) { return add(numbers, shape, 5126); }
  int add_json(const std::string& accessor) { return accessors_.push_back(accessor), int(accessors_.size()) - 1; }
  int last_view() const { return int(views_.size()) - 1; }
  /// Members "buffers", "bufferViews" and "accessors".
  std::string json() const {
    return fmt::format(R"("buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}],
"bufferViews":[{}],
"accessors":[{}])",
                       bytes_.size(), base64(bytes_), fmt::join(views_, ","), fmt::join(accessors_, ","));
  }

 private:
  std::string bytes_;
  std::vector<std::string> views_, accessors_;
};

std::string asset(const std::string& rest) { return fmt::format(R"({{"asset":{{"version":"2.0"}},{}}})", rest); }

/// One triangle at node 0 with the given material and attributes beyond POSITION.
std::string triangle(Buffer& buffer, const std::string& attributes, const std::string& rest,
                     const std::string& primitive = {}) {
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  return asset(fmt::format(R"("nodes":[{{"mesh":0,"name":"thing"}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{}{}}}{}}}]}}],
{}{}{})",
                           position, attributes, primitive, rest, rest.empty() ? "" : ",\n", buffer.json()));
}

std::string glb(std::string json, const std::string& bin) {
  json.resize((json.size() + 3) / 4 * 4, ' ');
  std::string out = "glTF";
  const auto u32 = [&](std::uint32_t v) { out.append(reinterpret_cast<const char*>(&v), 4); };
  u32(2);
  u32(std::uint32_t(12 + 8 + json.size() + (bin.empty() ? 0 : 8 + bin.size())));
  u32(std::uint32_t(json.size()));
  u32(0x4E4F534A);
  out += json;
  if (!bin.empty()) {
    u32(std::uint32_t(bin.size()));
    u32(0x004E4942);
    out += bin;
  }
  return out;
}

class Gltf : public testing::Test {
 protected:
  void SetUp() override {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    dir_ = fs::temp_directory_path() / fmt::format("tempera_gltf_{}_{}", info->name(), ::getpid());
    fs::create_directories(dir_);
  }
  void TearDown() override { fs::remove_all(dir_); }

  fs::path write(const std::string& name, const std::string& bytes) const {
    const fs::path file = dir_ / name;
    std::ofstream(file, std::ios::binary) << bytes;
    return file;
  }
  Scene load(const std::string& json, const ImportOptions& options = {}) {
    Scene scene = import_gltf(write("test.gltf", json), options, warnings_);
    validate(scene);
    return scene;
  }
  static Scene load_sample(const fs::path& file, const ImportOptions& options = {}, Warnings* warnings = nullptr) {
    Warnings own;
    Scene scene = import_gltf(file, options, warnings ? *warnings : own);
    validate(scene);
    return scene;
  }
  /// `line` 0: do not care.
  void expect_error(const std::string& bytes, ErrorCode code, int line, const std::string& part,
                    const std::string& name = "test.gltf", const ImportOptions& options = {}) const {
    Warnings warnings;
    try {
      import_gltf(write(name, bytes), options, warnings);
      ADD_FAILURE() << "loaded, instead of: " << part;
    } catch (const Error& e) {
      EXPECT_EQ(int(e.code()), int(code)) << e.what();
      EXPECT_EQ(fs::path(e.loc().file).filename(), name) << e.what();
      EXPECT_TRUE(line == 0 || e.loc().line == line) << e.what() << "\ninstead of line " << line;
      EXPECT_NE(e.message().find(part), std::string::npos) << e.what() << "\nlacks: " << part;
    }
  }
  bool warned(const std::string& part) const {
    for (const std::string& line : warnings_.lines())
      if (line.find(part) != std::string::npos) return true;
    return false;
  }

  fs::path dir_;
  Warnings warnings_;
};

const Mesh& mesh_of(const Scene& scene, std::size_t instance = 0, std::size_t shape = 0) {
  const int group = scene.instances.at(instance).group;
  return std::get<Mesh>(scene.shapes.at(std::size_t(scene.groups.at(std::size_t(group)).at(shape))).geometry);
}

Vec3d world_position(const Scene& scene, std::size_t instance, std::uint32_t vertex, double t) {
  const int node = scene.instances.at(instance).node;
  const Mesh& mesh = mesh_of(scene, instance);
  return scene.world(node, t).point(Vec3d(posed_position(mesh, mesh_pose(scene, mesh, node, t), vertex)));
}

int node_named(const Scene& scene, const std::string& name) {
  for (std::size_t i = 0; i < scene.nodes.size(); ++i)
    if (scene.nodes[i].name == name) return int(i);
  ADD_FAILURE() << "no node " << name;
  return -1;
}

void expect_near(const Vec3d& a, const Vec3d& b, double tolerance) {
  EXPECT_NEAR(a.x, b.x, tolerance);
  EXPECT_NEAR(a.y, b.y, tolerance);
  EXPECT_NEAR(a.z, b.z, tolerance);
}

// --- sample files
// -------------------------------------------------------------------------------------------------------

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
      for (const int s : scene.groups[std::size_t(scene.instances[i].group)])
        triangles += std::get<Mesh>(scene.shapes[std::size_t(s)].geometry).triangle_count();
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
  const auto local = [&](const char* node, double t) {
    return scene.nodes[std::size_t(node_named(scene, node))].local.at(t);
  };
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

// --- geometry
// -----------------------------------------------------------------------------------------------------------

TEST_F(Gltf, StripsAndFansKeepTheirWinding) {
  Buffer buffer;
  const int strip = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 2, 0}, "VEC3");
  const int fan = buffer.floats({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0}, "VEC3");
  const Scene scene = load(asset(fmt::format(
      R"("nodes":[{{"mesh":0}}],"meshes":[{{"name":"m","primitives":[{{"mode":5,"attributes":{{"POSITION":{}}}}},{{"mode":6,"attributes":{{"POSITION":{}}}}}]}}],{})",
      strip, fan, buffer.json())));
  ASSERT_EQ(scene.groups.size(), 1u);
  ASSERT_EQ(scene.groups[0].size(), 2u);
  EXPECT_EQ(scene.shapes[0].name, "m[0]");
  EXPECT_EQ(mesh_of(scene, 0, 0).indices, (std::vector<std::uint32_t>{0, 1, 2, 1, 3, 2, 2, 3, 4}));
  EXPECT_EQ(mesh_of(scene, 0, 1).indices, (std::vector<std::uint32_t>{1, 2, 0, 2, 3, 0}));
}

TEST_F(Gltf, QuantizedInterleavedSparseAndColoredAttributes) {
  // One buffer: interleaved vertices of three normalized shorts, two bytes of padding, three normalized bytes, one of
  // padding, and a color of four normalized bytes (16 bytes); then a sparse index (and padding), then its two floats.
  std::string bytes;
  const auto put = [&](auto... numbers) {
    (bytes.append(reinterpret_cast<const char*>(&numbers), sizeof(numbers)), ...);
  };
  using S = std::int16_t;
  using C = std::uint8_t;
  const auto vertex = [&](S x, S y, S z, C r, C g, C b, C a) {
    put(x, y, z, S(0), std::int8_t(0), std::int8_t(0), std::int8_t(127), C(0), r, g, b, a);
  };
  vertex(0, 0, -32768, 255, 0, 0, 255);
  vertex(32767, 0, 0, 0, 51, 0, 255);
  vertex(0, 16384, 0, 0, 0, 255, 0);
  put(C(1), C(0), C(0), C(0), 0.25f, 0.75f);
  const Scene scene = load(asset(fmt::format(
      R"("nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"COLOR_0":2,"TEXCOORD_0":3}}}}]}}],
"accessors":[{{"bufferView":0,"componentType":5122,"normalized":true,"count":3,"type":"VEC3"}},
{{"bufferView":0,"byteOffset":8,"componentType":5120,"normalized":true,"count":3,"type":"VEC3"}},
{{"bufferView":0,"byteOffset":12,"componentType":5121,"normalized":true,"count":3,"type":"VEC4"}},
{{"componentType":5126,"count":3,"type":"VEC2","sparse":{{"count":1,"indices":{{"bufferView":1,"componentType":5121}},"values":{{"bufferView":1,"byteOffset":4}}}}}}],
"bufferViews":[{{"buffer":0,"byteLength":48,"byteStride":16}},{{"buffer":0,"byteOffset":48,"byteLength":12}}],
"buffers":[{{"byteLength":60,"uri":"data:application/octet-stream;base64,{}"}}])",
      base64(bytes))));
  const Mesh& mesh = mesh_of(scene);
  EXPECT_EQ(mesh.positions[0], Vec3f(0, 0, -1));  // -32768 is clamped
  EXPECT_EQ(mesh.positions[1], Vec3f(1, 0, 0));
  EXPECT_NEAR(mesh.positions[2].y, 16384 / 32767.0, 1e-6);
  for (const Vec3f& n : mesh.normals) EXPECT_EQ(n, Vec3f(0, 0, 1));
  EXPECT_EQ(mesh.colors[1], Rgb(0, 0.2f, 0));
  EXPECT_EQ(mesh.color_alphas[2], 0);
  EXPECT_EQ(mesh.uvs, (std::vector<Vec2f>{{0, 0}, {0.25f, 0.75f}, {0, 0}}));
}

TEST_F(Gltf, EightInfluencesAreReadAndNormalized) {
  Buffer buffer;
  const auto nine = [](std::vector<float> one) {
    std::vector<float> three;
    for (int i = 0; i < 3; ++i) three.insert(three.end(), one.begin(), one.end());
    return three;
  };
  const int weights0 = buffer.floats(nine({0.2f, 0.2f, 0, 0.2f}), "VEC4"),
            weights1 = buffer.floats(nine({0.2f, 0.4f, 0, 0}), "VEC4");
  const auto joints = [&](std::vector<std::uint8_t> one) {
    std::vector<std::uint8_t> three;
    for (int i = 0; i < 3; ++i) three.insert(three.end(), one.begin(), one.end());
    return buffer.add(three, "VEC4", 5121);
  };
  const int joints0 = joints({0, 1, 9, 0}), joints1 = joints({1, 1, 0, 0});  // joint 9 has no weight
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  const Scene scene = load(asset(fmt::format(
      R"("nodes":[{{"mesh":0,"skin":0,"translation":[9,9,9]}},{{}},{{"translation":[6,0,0]}}],"skins":[{{"joints":[1,2]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{},"JOINTS_0":{},"WEIGHTS_0":{},"JOINTS_1":{},"WEIGHTS_1":{}}}}}]}}],{})",
      position, joints0, weights0, joints1, weights1, buffer.json())));
  const Skin& skin = mesh_of(scene).skin;
  EXPECT_EQ(skin.influences, 5);
  EXPECT_TRUE(warned("joint weights that do not sum to 1"));
  // 0.8 of 1.2 on the joint at x = 6; the node's own transform does not count.
  expect_near(world_position(scene, 0, 0, 0), {4, 0, 0}, 1e-5);
}

TEST_F(Gltf, MorphTargetsAnimateOrAreBaked) {
  Buffer buffer;
  const int delta = buffer.floats({0, 0, 1, 0, 0, 2, 0, 0, 3}, "VEC3"), times = buffer.floats({0, 1}, "SCALAR"),
            keys = buffer.floats({0, 0, 1, 0.5f}, "SCALAR");
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  const std::string body = fmt::format(
      R"("nodes":[{{"mesh":0}},{{"mesh":0,"weights":[1,0]}},{{"mesh":0}}],
"meshes":[{{"weights":[0,2],"primitives":[{{"attributes":{{"POSITION":{}}},"targets":[{{"POSITION":{}}},{{"POSITION":{}}}]}}]}}],{})",
      position, delta, delta, buffer.json());
  const std::string animation = fmt::format(
      R"("animations":[{{"samplers":[{{"input":{},"output":{}}}],"channels":[{{"sampler":0,"target":{{"node":2,"path":"weights"}}}}]}}],)",
      times, keys);
  const Scene scene = load(asset(animation + body));
  ASSERT_EQ(scene.instances.size(), 3u);
  expect_near(world_position(scene, 0, 2, 0.5), {0, 1, 6}, 1e-6);  // the mesh's weights
  expect_near(world_position(scene, 1, 2, 0.5), {0, 1, 3}, 1e-6);  // the node's weights
  expect_near(world_position(scene, 2, 2, 0.5), {0, 1, 0.75 * 3}, 1e-6);
  EXPECT_FALSE(mesh_of(scene, 0).deforms());
  EXPECT_TRUE(mesh_of(scene, 2).deforms());
}

TEST_F(Gltf, TangentsFollowTheTexture) {
  // Two quads side by side share an edge; the right one's texture is mirrored in u. v points down the picture.
  Buffer buffer;
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 2, 0, 0, 0, 1, 0, 1, 1, 0, 2, 1, 0}, "VEC3");
  const int normal = buffer.floats({0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1}, "VEC3");
  const int uv = buffer.floats({0, 1, 1, 1, 0, 1, 0, 0, 1, 0, 0, 0}, "VEC2");
  const int index = buffer.add(std::vector<std::uint16_t>{0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4}, "SCALAR", 5123);
  const Scene scene = load(asset(fmt::format(
      R"("nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{},"NORMAL":{},"TEXCOORD_0":{}}},"indices":{},"material":0}}]}}],
"materials":[{{"normalTexture":{{"index":0}}}}],"textures":[{{"source":0}}],"images":[{{"uri":"{}"}}],{})",
      position, normal, uv, index, kPng, buffer.json())));
  const Mesh& mesh = mesh_of(scene);
  ASSERT_EQ(mesh.positions.size(), 8u);  // the shared edge's two vertices are split
  for (std::size_t t = 0; t < 4; ++t) {
    const bool mirrored = t >= 2;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t v = mesh.indices[3 * t + k];
      EXPECT_NEAR(mesh.tangents[v].x, mirrored ? -1 : 1, 1e-5);  // where u grows
      const Vec3f bitangent = cross(mesh.normals[v], mesh.tangents[v]) * mesh.tangent_signs[v];
      EXPECT_NEAR(bitangent.y, 1, 1e-5);  // up the picture on both
    }
  }
}

TEST_F(Gltf, InstancesOfOneMeshShareIt) {
  Buffer buffer;
  const int offsets = buffer.floats({1, 0, 0, 2, 0, 0}, "VEC3");
  std::string json = triangle(buffer, "", "");
  const std::string node = R"({"mesh":0,"name":"thing"})";
  json.replace(
      json.find(node), node.size(),
      node +
          fmt::format(
              R"(,{{"mesh":0,"name":"many","scale":[2,2,2],"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{"TRANSLATION":{}}}}}}}}})",
              offsets));
  const Scene scene = load(json);
  EXPECT_EQ(scene.groups.size(), 1u);
  ASSERT_EQ(scene.instances.size(), 3u);
  EXPECT_EQ(scene.instances[2].name, "many[1]");
  expect_near(scene.world(scene.instances[2].node, 0).translation, {4, 0, 0}, 1e-9);
}

TEST_F(Gltf, DracoMeshesDecodeWhereTheLibraryIs) {
  // A quad (0,0) (1,0) (1,2) (0,2), positions and uvs quantized to 10 bits, as draco 1.5.5's encoder wrote it.
  const std::string text = asset(
      R"("extensionsUsed":["KHR_draco_mesh_compression"],"nodes":[{"mesh":0}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1},"indices":2,"extensions":{"KHR_draco_mesh_compression":{"bufferView":0,"attributes":{"POSITION":0,"TEXCOORD_0":1}}}}]}],
"accessors":[{"componentType":5126,"count":4,"type":"VEC3"},{"componentType":5126,"count":4,"type":"VEC2"},{"componentType":5123,"count":6,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteLength":133}],
"buffers":[{"byteLength":133,"uri":"data:;base64,RFJBQ08CAgEBAAAABAIBAgAAAR//ARH/AREC/wAAAAAAAQAJAwAAAgEDCQIAAQIBAQEACwMBIB8BIAMA8IP4PwAA/gcAAAAAAAAA/wMAAAAAAAAAAAAAAAAAAAAAAEAKAQEBAAMDASABIAMA8IOmAAAAAAD/AwAAAAAAAAAAAAAAAIA/Cg=="}])");
  Scene scene;
  try {
    scene = load(text);
  } catch (const Error& e) {
    if (e.code() != ErrorCode::kUnsupported) throw;
    GTEST_SKIP() << e.what();
  }
  const Mesh& mesh = mesh_of(scene);
  ASSERT_EQ(mesh.positions.size(), 4u);
  ASSERT_EQ(mesh.triangle_count(), 2u);
  double area = 0;
  for (std::size_t t = 0; t < 2; ++t) {
    const auto p = [&](std::size_t k) { return mesh.positions[mesh.indices[3 * t + k]]; };
    area += cross(p(1) - p(0), p(2) - p(0)).z / 2;
  }
  EXPECT_NEAR(area, 2, 1e-2);
  for (std::size_t v = 0; v < 4; ++v) {
    EXPECT_NEAR(mesh.uvs[v].x, mesh.positions[v].x, 2e-3);
    EXPECT_NEAR(mesh.uvs[v].y, 1 - mesh.positions[v].y / 2, 2e-3);
  }
  std::string damaged = text;
  damaged.replace(damaged.find("RFJBQ08C"), 16, "RFJBQ08CAgEBAP//");
  expect_error(damaged, ErrorCode::kBadInput, 2, "Draco cannot decode");
}

// --- cameras, lights, visibility
// ------------------------------------------------------------------------------------------

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
    EXPECT_TRUE(spot.smooth_falloff);
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

// --- materials
// ----------------------------------------------------------------------------------------------------------

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

// --- errors
// -------------------------------------------------------------------------------------------------------------

TEST_F(Gltf, ErrorsNameTheirPlace) {
  using E = ErrorCode;
  struct Case {
    E code;
    int line;
    const char* part;
    const char* text;
  };
  const Case cases[] = {
      {E::kSyntax, 2, "not valid JSON", "{\n \"asset\": }"},
      {E::kSyntax, 1, "byte order mark", "\xEF\xBB\xBF{}"},
      {E::kSyntax, 1, "is not an object", "[]"},
      {E::kSyntax, 1, "not valid JSON", ""},
      {E::kSyntax, 1, "not valid JSON", "{\"asset\":{\"version\":\"2.0\"},\"x\":1e999}"},
      {E::kBadInput, 1, "lacks the required property \"asset\"", "{}"},
      {E::kBadInput, 1, "is no version", R"({"asset":{"version":"two"}})"},
      {E::kUnsupported, 1, "glTF version 1.0", R"({"asset":{"version":"1.0"}})"},
      {E::kUnsupported, 1, "needs glTF version 2.9", R"({"asset":{"version":"2.0","minVersion":"2.9"}})"},
      {E::kUnsupported, 3, "requires the extension \"X_y\"",
       "{\"asset\":{\"version\":\"2.0\"},\n\"extensionsRequired\":[\n\"X_y\"]}"},
      {E::kBadInput, 2, "/nodes/0/name: is a number instead of a string",
       "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[\n{\"name\":4}]}"},
      {E::kBadInput, 2, "refers to nodes[7], but there are 1",
       "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"children\":[\n7]}]}"},
      {E::kBadInput, 1, "is a child of nodes[0] already",
       R"({"asset":{"version":"2.0"},"nodes":[{"children":[2]},{"children":[2]},{}]})"},
      {E::kBadInput, 2, "is a descendant of itself",
       "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[\n{\"children\":[0]}]}"},
      {E::kBadInput, 1, "both a matrix and",
       R"({"asset":{"version":"2.0"},"nodes":[{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"scale":[1,1,1]}]})"},
      {E::kBadInput, 1, "has 15 elements instead of 16",
       R"({"asset":{"version":"2.0"},"nodes":[{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0]}]})"},
      {E::kBadInput, 1, "last row",
       R"({"asset":{"version":"2.0"},"nodes":[{"matrix":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]}]})"},
      {E::kOutOfRange, 1, "is too large", R"({"asset":{"version":"2.0"},"nodes":[{"scale":[1e300,1,1]}]})"},
      {E::kBadInput, 1, "is not a root",
       R"({"asset":{"version":"2.0"},"nodes":[{"children":[1]},{}],"scenes":[{"nodes":[1]}]})"},
      {E::kBadInput, 1, "refers to scenes[3]", R"({"asset":{"version":"2.0"},"scene":3,"scenes":[{}]})"},
      {E::kBadInput, 1, "0.5 is not a non-negative whole number",
       R"({"asset":{"version":"2.0"},"scene":0.5,"scenes":[{}]})"},
      {E::kOutOfRange, 1, "at least one byte", R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":0}]})"},
      {E::kBadInput, 1, "its data have 3",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":9,"uri":"data:;base64,AAAA"}]})"},
      {E::kBadInput, 1, "not valid base64",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":9,"uri":"data:;base64,A*AA"}]})"},
      {E::kBadInput, 1, "without a comma",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":9,"uri":"data:;base64"}]})"},
      {E::kUnsupported, 1, "is not a path relative",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":9,"uri":"https://a.b/c.bin"}]})"},
      {E::kMissingFile, 2, "nowhere.bin",
       "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":9,\n\"uri\":\"nowhere.bin\"}]}"},
      {E::kBadInput, 2, "covers bytes 2 to 6",
       "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":3,\"uri\":\"data:;base64,AAAA\"}],"
       "\"bufferViews\":[\n{\"buffer\":0,\"byteOffset\":2,\"byteLength\":4}]}"},
      {E::kBadInput, 1, "has no data",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3}],"bufferViews":[{"buffer":0,"byteLength":3}]})"},
      {E::kOutOfRange, 1, "outside [4, 252]",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3,"byteStride":300}]})"},
      {E::kUnsupported, 1, "EXT_meshopt_compression",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"extensions":{"EXT_meshopt_compression":{"fallback":true}}}],"bufferViews":[{"buffer":0,"byteLength":3,"extensions":{"EXT_meshopt_compression":{}}}]})"},
      {E::kBadInput, 1, "no component type",
       R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5124,"count":1,"type":"SCALAR"}]})"},
      {E::kBadInput, 1, "no accessor type",
       R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":1,"type":"VEC5"}]})"},
      {E::kOutOfRange, 1, "without data",
       R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":4000000000,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "needs 12 bytes",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3}],"accessors":[{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "needs",
       R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3}],"accessors":[{"bufferView":0,"byteOffset":9007199254740991,"componentType":5126,"count":9007199254740992,"type":"VEC4"}]})"},
      {E::kOutOfRange, 1, "is outside [1, 1]",
       R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":1,"type":"VEC3","sparse":{"count":2}}]})"},
      {E::kBadInput, 1, "lacks the required property \"primitives\"", R"({"asset":{"version":"2.0"},"meshes":[{}]})"},
      {E::kBadInput, 1, "at least one primitive", R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[]}]})"},
      {E::kBadInput, 1, "no primitive mode",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{},"mode":7}]}]})"},
      {E::kBadInput, 1, "type VEC2 instead of VEC3",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC2"}]})"},
      {E::kBadInput, 1, "but the primitive's POSITION has 3",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0,"NORMAL":1}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"},{"componentType":5126,"count":2,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "no multiple of 3",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":4,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "fewer than 3",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"mode":5,"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":2,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "indices are of component type",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"indices":1,"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"},{"componentType":5126,"count":3,"type":"SCALAR"}]})"},
      {E::kBadInput, 1, "only one of JOINTS_0 and WEIGHTS_0",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":1}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"},{"componentType":5121,"count":3,"type":"VEC4"}]})"},
      {E::kBadInput, 1, "lacks JOINTS_0",
       R"({"asset":{"version":"2.0"},"nodes":[{"mesh":0,"skin":0}],"skins":[{"joints":[0]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "has 1 morph targets, but",
       R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}},{"attributes":{"POSITION":0},"targets":[{}]}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"}]})"},
      {E::kBadInput, 1, "at least one joint", R"({"asset":{"version":"2.0"},"skins":[{"joints":[]}]})"},
      {E::kBadInput, 1, "has 1 matrices for 2 joints",
       R"({"asset":{"version":"2.0"},"nodes":[{},{}],"skins":[{"joints":[0,1],"inverseBindMatrices":0}],"accessors":[{"componentType":5126,"count":1,"type":"MAT4"}]})"},
      {E::kBadInput, 1, "no camera type",
       R"({"asset":{"version":"2.0"},"nodes":[{"camera":0}],"cameras":[{"type":"fisheye"}]})"},
      {E::kOutOfRange, 1, "/cameras/0/perspective/yfov",
       R"({"asset":{"version":"2.0"},"nodes":[{"camera":0}],"cameras":[{"type":"perspective","perspective":{"yfov":4,"znear":1}}]})"},
      {E::kOutOfRange, 1, "zfar is not beyond znear",
       R"({"asset":{"version":"2.0"},"nodes":[{"camera":0}],"cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":1,"zfar":1}}]})"},
      {E::kBadInput, 1, "is singular",
       R"({"asset":{"version":"2.0"},"nodes":[{"camera":0,"scale":[0,1,1]}],"cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":1}}]})"},
      {E::kBadInput, 1, "no light type",
       R"({"asset":{"version":"2.0"},"nodes":[{"extensions":{"KHR_lights_punctual":{"light":0}}}],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"area"}]}}})"},
      {E::kOutOfRange, 1, "is not below outerConeAngle",
       R"({"asset":{"version":"2.0"},"nodes":[{"extensions":{"KHR_lights_punctual":{"light":0}}}],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","spot":{"innerConeAngle":0.8}}]}}})"},
      {E::kBadInput, 1, "no interpolation; valid: STEP",
       R"({"asset":{"version":"2.0"},"nodes":[{}],"animations":[{"samplers":[{"input":0,"output":0,"interpolation":"BEZIER"}],"channels":[{"sampler":0,"target":{"node":0,"path":"scale"}}]}]})"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.text);
    expect_error(c.text, c.code, c.line, c.part);
  }
}

TEST_F(Gltf, ErrorsInMeshesMaterialsAndTracks) {
  using E = ErrorCode;
  const auto with_material = [](const std::string& material, const std::string& more = {}) {
    Buffer buffer;
    return triangle(buffer, "", fmt::format(R"("materials":[{}]{})", material, more), R"(,"material":0)");
  };
  expect_error(with_material(R"({"alphaMode":"SHINY"})"), E::kBadInput, 3, "no alpha mode");
  expect_error(with_material(R"({"pbrMetallicRoughness":{"baseColorFactor":[1,1,1]}})"), E::kBadInput, 3,
               "has 3 elements instead of 4");
  expect_error(with_material(R"({"emissiveTexture":{"index":2},"emissiveFactor":[1,1,1]})"), E::kBadInput, 3,
               "refers to textures[2]");
  expect_error(with_material(R"({"extensions":{"KHR_materials_ior":{"ior":0.3}}})"), E::kOutOfRange, 3,
               "/materials/0/extensions/KHR_materials_ior/ior");
  const std::string textured = R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}})";
  const auto with_image = [&](const std::string& image, const std::string& sampler = "{}") {
    return with_material(
        textured, fmt::format(",\n\"textures\":[{{\"source\":0,\"sampler\":0}}],\"samplers\":[{}],\n\"images\":[{}]",
                              sampler, image));
  };
  expect_error(with_image(R"({"uri":"none.png"})"), E::kMissingFile, 5, "none.png");
  expect_error(with_image("{}"), E::kBadInput, 5, "neither a uri nor a bufferView");
  expect_error(with_image(R"({"uri":"data:image/png;base64,AAAA"})"), E::kBadInput, 5, "");
  expect_error(with_image(fmt::format(R"({{"uri":"{}"}})", std::string(kPng).substr(0, 90))), E::kBadInput, 5, "");
  expect_error(with_image(fmt::format(R"({{"uri":"{}"}})", kPng), R"({"wrapS":1})"), E::kBadInput, 4, "no wrap mode");

  {
    Buffer buffer;
    const int bad = buffer.floats({0, 0, 0, 1, 0, std::nanf(""), 0, 1, 0}, "VEC3");
    expect_error(asset(fmt::format("\"meshes\":[{{\"primitives\":[{{\"attributes\":{{\n\"POSITION\":{}}}}}]}}],{}", bad,
                                   buffer.json())),
                 E::kBadInput, 2, "POSITION of vertex 1 is not finite");
  }
  const auto indexed = [](const std::vector<std::uint16_t>& indices) {
    Buffer buffer;
    const int index = buffer.add(indices, "SCALAR", 5123);
    return triangle(buffer, "", "", fmt::format(",\n\"indices\":{}", index));
  };
  expect_error(indexed({0, 1, 3}), E::kOutOfRange, 3, "index 3 (number 2) refers past the last of 3 vertices");
  expect_error(indexed({0, 1}), E::kBadInput, 2, "no multiple of 3");
  const auto skinned = [](float weight, std::uint8_t joint) {
    Buffer buffer;
    const int weights = buffer.floats({1, 0, 0, 0, 1, 0, 0, 0, weight, 0, 0, 0}, "VEC4");
    const int joints = buffer.add(std::vector<std::uint8_t>{0, 0, 0, 0, 0, 0, 0, 0, joint, 0, 0, 0}, "VEC4", 5121);
    std::string json = triangle(buffer, fmt::format(R"(,"JOINTS_0":{},"WEIGHTS_0":{})", joints, weights),
                                R"("skins":[{"joints":[0]}])");
    return json.replace(json.find(R"("name":"thing")"), 14, R"("skin":0)");
  };
  expect_error(skinned(-1, 0), E::kBadInput, 2, "is negative");
  expect_error(skinned(1, 3), E::kOutOfRange, 2, "follows joint 3 of skins[0], which has 1");

  const auto animated = [](const std::vector<float>& times, const std::vector<float>& values, const char* shape,
                           const char* path, const char* mode = "LINEAR") {
    Buffer buffer;
    const int input = buffer.floats(times, "SCALAR"), output = buffer.floats(values, shape);
    return asset(fmt::format(
        "\"nodes\":[{{}}],\"animations\":[{{\"samplers\":[{{\n\"interpolation\":\"{}\",\n\"input\":{},\n\"output\":{}}}"
        "],\n\"channels\":[{{\"sampler\":0,\"target\":{{\"node\":0,\"path\":\"{}\"}}}}]}}],{}",
        mode, input, output, path, buffer.json()));
  };
  expect_error(animated({1, 1}, {0, 0, 0, 1, 1, 1}, "VEC3", "translation"), E::kOutOfRange, 3, "key 1 is at 1 s");
  expect_error(animated({-1, 1}, {0, 0, 0, 1, 1, 1}, "VEC3", "translation"), E::kOutOfRange, 3, "key 0 is at -1 s");
  expect_error(animated({0, 1}, {0, 0, 0}, "VEC3", "scale"), E::kBadInput, 4, "has 1 values for 2 keys");
  expect_error(animated({0, 1}, {0, 0, 0, 1, 1, 1}, "VEC3", "scale", "CUBICSPLINE"), E::kBadInput, 4,
               "splines have three");
  expect_error(animated({0, 1}, {0, 0, 0, 1, 1, 1}, "VEC3", "rotation"), E::kBadInput, 4, "type VEC3 instead of VEC4");
  expect_error(animated({0, 1}, {0, 0, 0, INFINITY, 1, 1}, "VEC3", "scale"), E::kBadInput, 4, "not finite");
  expect_error(animated({0, 1}, {0, 1}, "SCALAR", "weights"), E::kBadInput, 5, "no mesh with morph targets");
}

TEST_F(Gltf, ContainerErrorsGiveTheByte) {
  const std::string json = R"({"asset":{"version":"2.0"}})";
  const std::string good = glb(json, "");
  Warnings warnings;
  EXPECT_NO_THROW(import_gltf(write("good.glb", good), {}, warnings));
  expect_error(good.substr(0, 3), ErrorCode::kSyntax, 1, "does not start with", "a.glb");
  expect_error(good.substr(0, 7), ErrorCode::kSyntax, 1, "ends within", "a.glb");
  expect_error(good.substr(0, good.size() - 4), ErrorCode::kSyntax, 1, "(at byte 8)", "a.glb");
  std::string other = good;
  other[4] = 1;
  expect_error(other, ErrorCode::kSyntax, 1, "version 1", "a.glb");
  expect_error(glb("[1,]", ""), ErrorCode::kSyntax, 1, "not valid JSON", "a.glb");
  // Lines of the JSON chunk are counted from the start of the file, so that an editor finds them.
  expect_error(glb("{\"asset\":{\"version\":\"2.0\"},\n\"nodes\":3}", ""), ErrorCode::kBadInput, 2,
               "/nodes: is a number instead of an array", "a.glb");
  const std::string with_bin = R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":9}]})";
  expect_error(glb(with_bin, "12345678"), ErrorCode::kBadInput, 1, "says that it has 9 bytes, but its data have 8",
               "a.glb");
  EXPECT_NO_THROW(import_gltf(write("bin.glb", glb(with_bin, "123456789012")), {}, warnings));
}

TEST_F(Gltf, HostileSizesAreRefused) {
  std::string deep = R"({"asset":{"version":"2.0"},"extras":)";
  for (int i = 0; i < 100000; ++i) deep += '[';
  expect_error(deep, ErrorCode::kSyntax, 1, "nested deeper than 256 levels");

  ImportOptions small;
  small.memory_limit = 20000;
  Buffer buffer;
  buffer.floats(std::vector<float>(3000, 1.0f), "VEC3");
  const std::string mesh = R"({"primitives":[{"attributes":{"POSITION":0},"mode":5}]})";
  const std::string json = asset(fmt::format(R"("meshes":[{},{}],{})", mesh, mesh, buffer.json()));
  expect_error(json, ErrorCode::kOutOfMemory, 1, "memory limit", "test.gltf", small);
  EXPECT_NO_THROW(load(json));
}

TEST_F(Gltf, SandboxKeepsToTheFolder) {
  fs::create_directories(dir_ / "in");
  write("secret.bin", "12345678");
  const std::string json = asset(R"("buffers":[{"byteLength":8,"uri":"../secret%2Ebin"}])");
  Warnings warnings;
  const fs::path file = write("in/scene.gltf", json);
  EXPECT_NO_THROW(import_gltf(file, {}, warnings));
  ImportOptions options;
  options.sandbox = true;
  try {
    import_gltf(file, options, warnings);
    ADD_FAILURE() << "read a file outside";
  } catch (const Error& e) {
    EXPECT_EQ(int(e.code()), int(ErrorCode::kBadInput)) << e.what();
    EXPECT_EQ(e.loc().line, 1);
  }
}

TEST_F(Gltf, MalformedSamplesGiveErrorsWithPlace) {
  const fs::path root = shared_scenes() / "gltf-invalid";
  if (!fs::exists(root)) GTEST_SKIP();
  // What the validator calls an error but leaves no doubt about the meaning is a warning here (an error under
  // --strict).
  const std::set<std::string> only_warnings = {"empty_array.gltf",
                                               "sampler_input_no_bounds.gltf",
                                               "quaternion_cubic_non_unit_values.gltf",
                                               "quaternion_non_unit_values.gltf",
                                               "colors_non_clamped.gltf",
                                               "normals_tangents_non_unit_invalid_sign.gltf"};
  const std::set<std::string> valid = {"extra_data.glb",
                                       "two_images.glb",
                                       "valid.glb",
                                       "valid_buffer.glb",
                                       "custom_property.gltf",
                                       "valid.gltf",
                                       "index_buffer_degenerate_triangle.gltf",
                                       "SceneWithoutNodes.gltf"};
  int files = 0;
  for (const auto& entry : fs::recursive_directory_iterator(root)) {
    const std::string extension = entry.path().extension(), name = entry.path().filename();
    if (extension != ".gltf" && extension != ".glb") continue;
    SCOPED_TRACE(entry.path());
    ++files;
    Warnings warnings;
    if (valid.contains(name) || only_warnings.contains(name)) {
      EXPECT_NO_THROW(validate(import_gltf(entry.path(), {}, warnings)));
      std::size_t real = 0;
      for (const std::string& line : warnings.lines()) real += line.find("shows no geometry") == line.npos;
      EXPECT_TRUE(valid.contains(name) || real >= 1);
      continue;
    }
    try {
      import_gltf(entry.path(), {}, warnings);
      ADD_FAILURE() << "loads";
    } catch (const Error& e) {
      EXPECT_EQ(exit_status(e.code()), 3) << e.what();
      EXPECT_GE(e.loc().line, 1) << e.what();
      EXPECT_EQ(fs::path(e.loc().file), entry.path());
    }
  }
  EXPECT_GE(files, 60);
}

TEST_F(Gltf, DamagedFilesLoadOrGiveAnError) {
  const fs::path root = shared_scenes() / "gltf";
  if (!fs::exists(root)) GTEST_SKIP();
  std::mt19937 random(20240607);
  ImportOptions options;
  options.memory_limit = std::uint64_t(1) << 30;
  int loaded = 0, refused = 0;
  for (const auto& entry : fs::recursive_directory_iterator(root)) {
    if (entry.path().extension() != ".glb" && entry.path().extension() != ".gltf") continue;
    if (entry.file_size() > 300000) continue;                                     // the large ones differ in size only
    for (const auto& other : fs::directory_iterator(entry.path().parent_path()))  // buffers and images
      if (const fs::path link = dir_ / other.path().filename(); !fs::exists(link))
        fs::create_symlink(other.path(), link);
    std::ifstream in(entry.path(), std::ios::binary);
    const std::string original((std::istreambuf_iterator<char>(in)), {});
    const bool binary = original.compare(0, 4, "glTF") == 0;
    std::uint32_t json_size = std::uint32_t(original.size());
    if (binary) std::memcpy(&json_size, original.data() + 12, 4);
    for (int variant = 0; variant < 16; ++variant) {
      std::string bytes = original;
      const auto below = [&](std::size_t n) { return std::size_t(random()) % n; };
      if (variant < 2) {
        bytes.resize(below(bytes.size()));
        if (binary && variant == 1 && bytes.size() > 20) {  // a container that agrees with its shorter self
          bytes.resize(bytes.size() / 4 * 4);
          const auto length = std::uint32_t(bytes.size());
          std::memcpy(&bytes[8], &length, 4);
        }
      } else if (variant < 4) {  // anywhere
        for (int k = 0; k < 4; ++k) bytes[below(bytes.size())] ^= char(1 << below(8));
      } else if (variant < 6 && binary) {  // in the data
        for (int k = 0; k < 100; ++k)
          bytes[std::min(bytes.size() - 1, 28 + json_size + below(bytes.size() - json_size))] ^= char(1 << below(8));
      } else {  // other numbers: what is well-formed gets further
        const std::size_t begin = binary ? 20 : 0;
        for (int k = 0; k < 200 && k < 20 * variant; ++k) {
          char& c = bytes[begin + below(json_size)];
          if (c >= '0' && c <= '9' && below(4) == 0) c = char('0' + below(10));
        }
      }
      const fs::path file = write("damaged" + entry.path().extension().string(), bytes);
      Warnings warnings;
      try {
        const Scene scene = import_gltf(file, options, warnings);
        validate(scene);
        ++loaded;
      } catch (const Error&) {
        ++refused;
      }
    }
  }
  EXPECT_GT(loaded, 10);
  EXPECT_GT(refused, 50);
}

}  // namespace
}  // namespace tempera
