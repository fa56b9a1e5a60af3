// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the tests of the glTF importer share.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "import_test_util.h"
#include "tempera/import/gltf.h"
#include "tempera/scene/deform.h"

namespace tempera {

inline std::string base64(const std::string& bytes) {
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
inline constexpr const char* kPng =
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

inline std::string asset(const std::string& rest) { return fmt::format(R"({{"asset":{{"version":"2.0"}},{}}})", rest); }

/// One triangle at node 0 with the given material and attributes beyond POSITION.
inline std::string triangle(Buffer& buffer, const std::string& attributes, const std::string& rest,
                            const std::string& primitive = {}) {
  const int position = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  return asset(fmt::format(R"("nodes":[{{"mesh":0,"name":"thing"}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":{}{}}}{}}}]}}],
{}{}{})",
                           position, attributes, primitive, rest, rest.empty() ? "" : ",\n", buffer.json()));
}

inline std::string glb(std::string json, const std::string& bin) {
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
  fs::path write(const std::string& name, const std::string& bytes) const { return folder_.write(name, bytes); }
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

  TestFolder folder_;
  const fs::path& dir_ = folder_.path();
  Warnings warnings_;
};

inline const Mesh& mesh_of(const Scene& scene, std::size_t instance = 0, std::size_t shape = 0) {
  const int group = scene.instances.at(instance).group;
  return std::get<Mesh>(scene.shapes.at(std::size_t(scene.groups.at(std::size_t(group)).at(shape))).geometry);
}

inline Vec3d world_position(const Scene& scene, std::size_t instance, std::uint32_t vertex, double t) {
  const int node = scene.instances.at(instance).node;
  const Mesh& mesh = mesh_of(scene, instance);
  return Vec3d(posed_position(mesh, mesh_pose(scene, mesh, node, t), vertex));
}

inline int node_named(const Scene& scene, const std::string& name) {
  for (std::size_t i = 0; i < scene.nodes.size(); ++i)
    if (scene.nodes[i].name == name) return int(i);
  ADD_FAILURE() << "no node " << name;
  return -1;
}

inline void expect_near(const Vec3d& a, const Vec3d& b, double tolerance) {
  EXPECT_NEAR(a.x, b.x, tolerance);
  EXPECT_NEAR(a.y, b.y, tolerance);
  EXPECT_NEAR(a.z, b.z, tolerance);
}

}  // namespace tempera
