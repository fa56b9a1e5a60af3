// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstring>
#include <random>
#include <set>

#include "gltf_test_util.h"

namespace tempera {
namespace {

TEST_F(Gltf, ErrorsNameTheirPlace) {
  using E = ErrorCode;
  struct Case {
    E code;
    int line;
    const char* part;
    const char* text;
  };
  const Case cases[] =
      {
          {E::kSyntax, 2, "not valid JSON", "{\n \"asset\": }"},
          {E::kSyntax, 1, "is UTF-16", "\xFF\xFE{\n}"},
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
           "\"bufferViews\":[\n{\"buffer\":0,\"byteOffset\":2,\"byteLength\":4}],\"accessors\":[{\"bufferView\":0,"
           "\"componentType\":5126,\"count\":1,\"type\":\"VEC3\"}],"
           "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}"},
          {E::kBadInput, 1, "has no data",
           R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3}],"bufferViews":[{"buffer":0,"byteLength":3}],"accessors":[{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kOutOfRange, 1, "outside [4, 252]",
           R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3,"byteStride":300}],"accessors":[{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kUnsupported, 1, "EXT_meshopt_compression",
           R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"extensions":{"EXT_meshopt_compression":{"fallback":true}}}],"bufferViews":[{"buffer":0,"byteLength":3,"extensions":{"EXT_meshopt_compression":{}}}],"accessors":[{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kBadInput, 1, "no component type",
           R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5124,"count":1,"type":"SCALAR"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kBadInput, 1, "no accessor type",
           R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":1,"type":"VEC5"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kOutOfRange, 1, "without data",
           R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":4000000000,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kBadInput, 1, "needs 12 bytes",
           R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3}],"accessors":[{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kBadInput, 1, "needs",
           R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":3,"uri":"data:;base64,AAAA"}],"bufferViews":[{"buffer":0,"byteLength":3}],"accessors":[{"bufferView":0,"byteOffset":9007199254740991,"componentType":5126,"count":9007199254740992,"type":"VEC4"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kOutOfRange, 1, "is outside [1, 1]",
           R"({"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":1,"type":"VEC3","sparse":{"count":2}}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]})"},
          {E::kBadInput, 1, "lacks the required property \"primitives\"",
           R"({"asset":{"version":"2.0"},"meshes":[{}]})"},
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
          {E::kBadInput, 1,
           "indices are of component type", R"({"asset":{"version":"2.0"},"meshes":[{"primitives":[{"indices":1,"attributes":{"POSITION":0}}]}],"accessors":[{"componentType":5126,"count":3,"type":"VEC3"},{"componentType":5126,"count":3,"type":"SCALAR"}]})"},
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
          {E::kBadInput, 1, "no light type",
           R"({"asset":{"version":"2.0"},"nodes":[{"extensions":{"KHR_lights_punctual":{"light":0}}}],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"area"}]}}})"},
          {E::kOutOfRange, 1, "is not below outerConeAngle",
           R"({"asset":{"version":"2.0"},"nodes":[{"extensions":{"KHR_lights_punctual":{"light":0}}}],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","spot":{"innerConeAngle":0.8}}]}}})"},
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
  const std::set<std::string> only_warnings = {"empty_array.gltf", "sampler_input_no_bounds.gltf",
                                               "colors_non_clamped.gltf",
                                               "normals_tangents_non_unit_invalid_sign.gltf"};
  const std::set<std::string> valid = {"bom.glb",
                                       "extra_data.glb",
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
    const bool is_animation = entry.path().parent_path().filename().string().starts_with("animation");
    if (valid.contains(name) || only_warnings.contains(name) || is_animation) {
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
