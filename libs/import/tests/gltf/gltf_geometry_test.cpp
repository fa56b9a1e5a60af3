// SPDX-License-Identifier: Apache-2.0
#include "gltf_test_util.h"

namespace tempera {
namespace {

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

TEST_F(Gltf, VerticesTellWhereTheyComeFrom) {
  Buffer buffer;
  const int p = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3"), source = buffer.floats({7, 0, 16777216}, "SCALAR"),
            half = buffer.floats({7, 0.5f, 1}, "SCALAR");
  const auto file = [&](int index) {
    return asset(fmt::format(
        R"("nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{},"_ORIGINAL_INDEX":{}}}}}]}}],{})",
        p, index, buffer.json()));
  };
  EXPECT_EQ(mesh_of(load(file(source))).source_vertices, (std::vector<std::uint32_t>{7, 0, 16777216}));
  EXPECT_THROW(load(file(half)), Error);
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

}  // namespace
}  // namespace tempera
