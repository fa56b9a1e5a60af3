// SPDX-License-Identifier: Apache-2.0
#include "gltf_mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace tempera {
namespace {

template <class Vec>
float* flat(std::vector<Vec>& values) {
  static_assert(sizeof(Vec) % sizeof(float) == 0 && std::is_trivially_copyable_v<Vec>);
  return reinterpret_cast<float*>(values.data());
}

enum Mode { kPoints, kLines, kLineLoop, kLineStrip, kTriangles, kTriangleStrip, kTriangleFan };

/// Reads the attributes of one primitive, from accessors or from Draco's decoder.
class PrimitiveReader {
 public:
  PrimitiveReader(const GltfDocument& document, const Json& primitive) : document_(document), primitive_(primitive) {}
  GltfPrimitive read();

 private:
  template <class Vec>
  std::vector<Vec> attribute(const Json& list, const std::string& semantic, std::string_view shape, bool fraction);
  void read_source_vertices(const Json& attributes);
  void read_colors(const Json& attributes);
  void read_weights(const Json& attributes);
  void read_targets();
  void read_triangles(Mode mode);
  std::vector<std::uint32_t> read_indices();
  void check_count(const Json& where, std::size_t count) const {
    if (count != vertices_)
      where.fail(fmt::format("has {} elements, but the primitive's POSITION has {}", count, vertices_));
  }
  const DracoPrimitive::Attribute* draco_attribute(const Json& list, std::string_view semantic, int components) const;

  const GltfDocument& document_;
  Json primitive_;
  GltfPrimitive out_;
  std::optional<DracoPrimitive> draco_;
  std::size_t vertices_ = 0;
};

const DracoPrimitive::Attribute* PrimitiveReader::draco_attribute(const Json& list, std::string_view semantic,
                                                                  int components) const {
  if (!draco_ || list.key() != "attributes") return nullptr;  // morph targets are never compressed
  for (const auto& a : draco_->attributes) {
    if (a.semantic != semantic) continue;
    if (a.components != components)
      list[semantic].fail(
          fmt::format("the compressed attribute has {} components instead of {}", a.components, components));
    return &a;
  }
  return nullptr;
}

/// Empty if `list` has no such attribute. Finite numbers only.
template <class Vec>
std::vector<Vec> PrimitiveReader::attribute(const Json& list, const std::string& semantic, std::string_view shape,
                                            bool fraction) {
  const Json index = list[semantic];
  if (!index) return {};
  constexpr std::size_t kComponents = sizeof(Vec) / sizeof(float);
  const Accessor& a = document_.accessor(index, shape);
  if (a.type == ComponentType::kUInt || (fraction && !a.is_fraction()))
    index.fail(fmt::format("{} cannot be stored as component type {}{}", semantic, int(a.type),
                           a.normalized ? "" : " that is not normalized"));
  std::vector<Vec> values;
  if (const auto* compressed = draco_attribute(list, semantic, int(kComponents))) {
    values.resize(draco_->vertices);
    std::copy(compressed->values.begin(), compressed->values.end(), flat(values));
  } else {
    check_count(index, a.count);
    values.resize(a.count);
    document_.read(a, flat(values));
  }
  for (std::size_t i = 0; i < values.size(); ++i)
    for (std::size_t c = 0; c < kComponents; ++c)
      if (!std::isfinite(flat(values)[i * kComponents + c]))
        index.fail(fmt::format("{} of vertex {} is not finite", semantic, i));
  return values;
}

using Vec4 = std::array<float, 4>;

GltfPrimitive PrimitiveReader::read() {
  out_.json = primitive_;
  const Json attributes = primitive_["attributes"].required().object();
  const Json extensions = primitive_["extensions"].object();
  const std::uint64_t mode = primitive_["mode"].integer(kTriangles);
  if (mode > kTriangleFan) primitive_["mode"].fail(fmt::format("{} is no primitive mode; valid: 0 to 6", mode));
  out_.material = primitive_["material"].optional_index(document_.count("materials"), "materials");
  if (extensions["KHR_materials_variants"])
    document_.warn("material variants are ignored; the default material is used", extensions["KHR_materials_variants"]);
  const Json position = attributes["POSITION"];
  if (!position) {
    document_.warn("primitives without positions are ignored", primitive_);
    return std::move(out_);
  }
  if (!extensions["KHR_draco_mesh_compression"] && document_.accessor(position, "VEC3").count == 0) {
    document_.warn("primitives without vertices are ignored", primitive_);
    return std::move(out_);
  }
  if (const Json e = extensions["KHR_draco_mesh_compression"].object()) {
    draco_ = decode_draco(document_, e);
    vertices_ = draco_->vertices;
  } else {
    vertices_ = document_.accessor(position, "VEC3").count;
  }
  if (vertices_ > std::numeric_limits<std::uint32_t>::max() - 1)
    position.fail("a primitive of more than 2^32 - 2 vertices");
  // Positions, normals, tangents, two uvs and colors at most; charged before they are read.
  document_.files().charge(vertices_ * (sizeof(Vec3f) * std::min<std::size_t>(attributes.size(), 8)), primitive_.loc());

  Mesh& mesh = out_.mesh;
  mesh.positions = attribute<Vec3f>(attributes, "POSITION", "VEC3", false);
  mesh.normals = attribute<Vec3f>(attributes, "NORMAL", "VEC3", true);
  mesh.uvs = attribute<Vec2f>(attributes, "TEXCOORD_0", "VEC2", false);
  mesh.uvs1 = attribute<Vec2f>(attributes, "TEXCOORD_1", "VEC2", false);
  for (Vec3f& n : mesh.normals) {
    const float l2 = length_squared(n);
    if (std::abs(l2 - 1) > 0.02f)
      document_.warn("normals that are not unit vectors are normalized", attributes["NORMAL"]);
    n = l2 > 0 ? n * (1 / std::sqrt(l2)) : Vec3f(0, 0, 0);
  }
  const auto tangents = attribute<Vec4>(attributes, "TANGENT", "VEC4", true);
  if (!mesh.normals.empty()) {  // without normals there are no tangents either (glTF 2.0, 3.7.2.1)
    for (const Vec4& t : tangents) {
      const Vec3f v(t[0], t[1], t[2]);
      if (std::abs(length_squared(v) - 1) > 0.02f)
        document_.warn("tangents that are not unit vectors are normalized", attributes["TANGENT"]);
      if (t[3] != 1 && t[3] != -1)
        document_.warn("tangents whose sign is neither 1 nor -1 get the nearer one", attributes["TANGENT"]);
      mesh.tangents.push_back(normalize(v));
      mesh.tangent_signs.push_back(t[3] < 0 ? -1.0f : 1.0f);
    }
  }
  read_source_vertices(attributes);
  read_colors(attributes);
  read_weights(attributes);
  read_targets();
  if (mode < kTriangles) {
    document_.warn("points and lines are not rendered", primitive_);
    read_indices();
  } else {
    read_triangles(Mode(mode));
  }
  // A zero normal says nothing; the triangle's own is what flat shading would use.
  for (std::size_t i = 0; i + 2 < mesh.indices.size() && !mesh.normals.empty(); i += 3) {
    const std::uint32_t* v = &mesh.indices[i];
    for (int k = 0; k < 3; ++k) {
      if (length_squared(mesh.normals[v[k]]) > 0) continue;
      const Vec3f& a = mesh.positions[v[0]];
      mesh.normals[v[k]] = normalize(cross(mesh.positions[v[1]] - a, mesh.positions[v[2]] - a));
    }
  }
  for (Vec3f& n : mesh.normals)
    if (!(length_squared(n) > 0)) n = {0, 0, 1};
  return std::move(out_);
}

/// The attribute that tells which vertex of the authored mesh a vertex was, before it was split at seams and materials:
/// exporters have no standard for it; this is the name that vertex caches are documented with.
void PrimitiveReader::read_source_vertices(const Json& attributes) {
  for (const char* name : {"_ORIGINAL_INDEX", "_original_index"}) {
    if (!attributes[name]) continue;
    document_.files().charge(vertices_ * 2 * sizeof(float), primitive_.loc());
    std::size_t v = 0;
    for (const float index : attribute<float>(attributes, name, "SCALAR", false)) {  // exact up to 2^24
      if (!(index >= 0 && index < 4294967040.0f && index == std::floor(index)))
        attributes[name].fail(fmt::format("{} of vertex {} is {}, which is no index", name, v, index));
      out_.mesh.source_vertices.push_back(std::uint32_t(index));
      ++v;
    }
    return;
  }
}

void PrimitiveReader::read_colors(const Json& attributes) {
  const Json index = attributes["COLOR_0"];
  if (!index) return;
  Mesh& mesh = out_.mesh;
  out_.has_colors = true;
  if (document_.accessor(index, "VEC3|VEC4").components == 3) {
    for (const Vec3f& c : attribute<Vec3f>(attributes, "COLOR_0", "VEC3", true))
      mesh.colors.emplace_back(c.x, c.y, c.z);
  } else {
    for (const Vec4& c : attribute<Vec4>(attributes, "COLOR_0", "VEC4", true)) {
      mesh.colors.emplace_back(c[0], c[1], c[2]);
      mesh.color_alphas.push_back(c[3]);
    }
  }
  bool clamped = false;
  for (Rgb& c : mesh.colors) {
    const Rgb limited = clamp(c, 0, 1);
    clamped |= limited != c;
    c = limited;
  }
  for (float& a : mesh.color_alphas) {
    clamped |= a < 0 || a > 1;
    a = std::clamp(a, 0.0f, 1.0f);
  }
  if (clamped) document_.warn("vertex colors outside [0, 1] are clamped", index);
}

void PrimitiveReader::read_weights(const Json& attributes) {
  std::vector<std::vector<Vec4>> joints, weights;
  constexpr int kMaxSets = 64;
  for (int set = 0;; ++set) {
    const std::string joint_name = fmt::format("JOINTS_{}", set), weight_name = fmt::format("WEIGHTS_{}", set);
    const Json joint = attributes[joint_name], weight = attributes[weight_name];
    if (!joint && !weight) break;
    if (set == kMaxSets)
      joint.fail(ErrorCode::kUnsupported, fmt::format("more than {} joints per vertex", 4 * kMaxSets));
    if (!joint || !weight) attributes.fail(fmt::format("has only one of {} and {}", joint_name, weight_name));
    const Accessor& a = document_.accessor(joint, "VEC4");
    if ((a.type != ComponentType::kUByte && a.type != ComponentType::kUShort) || a.normalized)
      joint.fail("joint indices are of component type 5121 or 5123, not normalized");
    document_.files().charge(vertices_ * 2 * sizeof(Vec4), primitive_.loc());
    joints.push_back(attribute<Vec4>(attributes, joint_name, "VEC4", false));  // floats hold 16 bits exactly
    weights.push_back(attribute<Vec4>(attributes, weight_name, "VEC4", true));
  }
  if (joints.empty()) return;

  // Keep the influences that count: most vertices follow fewer joints than there is room for.
  Skin& skin = out_.mesh.skin;
  std::size_t most = 1;
  for (std::size_t v = 0; v < vertices_; ++v) {
    std::size_t n = 0;
    for (const auto& set : weights)
      for (const float w : set[v]) n += w != 0;
    most = std::max(most, n);
  }
  skin.influences = int(most);
  skin.indices.assign(vertices_ * most, 0);
  skin.weights.assign(vertices_ * most, 0.0f);
  for (std::size_t v = 0; v < vertices_; ++v) {
    std::size_t n = 0;
    double sum = 0;
    for (std::size_t set = 0; set < joints.size(); ++set) {
      for (std::size_t c = 0; c < 4; ++c) {
        const float w = weights[set][v][c];
        if (w == 0) continue;
        if (w < 0)
          attributes[fmt::format("WEIGHTS_{}", set)].fail(fmt::format("weight {} of vertex {} is negative", w, v));
        const auto joint = std::size_t(joints[set][v][c]);
        skin.indices[v * most + n] = std::uint16_t(joint);
        skin.weights[v * most + n++] = w;
        out_.max_joint = std::max(out_.max_joint, joint);
        sum += w;
      }
    }
    if (std::abs(sum - 1) > 0.02)
      document_.warn("joint weights that do not sum to 1 are normalized", attributes["WEIGHTS_0"]);
    if (sum > 0) {
      for (std::size_t k = 0; k < n; ++k) skin.weights[v * most + k] = float(skin.weights[v * most + k] / sum);
    } else {
      skin.weights[v * most] = 1;
      skin.indices[v * most] = std::uint16_t(joints[0][v][0]);
      out_.max_joint = std::max(out_.max_joint, std::size_t(joints[0][v][0]));
    }
  }
}

void PrimitiveReader::read_targets() {
  const Json targets = primitive_["targets"].array();
  for (std::size_t i = 0; i < targets.size(); ++i) {
    const Json json = targets.at(i).object();
    document_.files().charge(vertices_ * sizeof(Vec3f) * std::min<std::size_t>(json.size(), 3), json.loc());
    MorphTarget target;
    target.positions = attribute<Vec3f>(json, "POSITION", "VEC3", false);
    target.normals = attribute<Vec3f>(json, "NORMAL", "VEC3", false);
    target.tangents = attribute<Vec3f>(json, "TANGENT", "VEC3", false);
    if (out_.mesh.normals.empty()) target.normals.clear();
    if (out_.mesh.tangents.empty()) target.tangents.clear();
    out_.mesh.morph_targets.push_back(std::move(target));
  }
}

std::vector<std::uint32_t> PrimitiveReader::read_indices() {
  const Json json = primitive_["indices"];
  std::vector<std::uint32_t> indices;
  if (draco_) return std::move(draco_->indices);  // checked by the decoder
  if (!json) {
    document_.files().charge(vertices_ * sizeof(std::uint32_t), primitive_.loc());
    indices.resize(vertices_);
    for (std::size_t i = 0; i < vertices_; ++i) indices[i] = std::uint32_t(i);
    return indices;
  }
  const Accessor& a = document_.accessor(json, "SCALAR");
  if ((a.type != ComponentType::kUByte && a.type != ComponentType::kUShort && a.type != ComponentType::kUInt) ||
      a.normalized)
    json.fail("indices are of component type 5121, 5123 or 5125, not normalized");
  document_.files().charge(a.count * sizeof(std::uint32_t), json.loc());
  indices.resize(a.count);
  document_.read(a, indices.data());
  // The largest number of a type would restart a strip in other formats; glTF forbids it.
  const std::uint32_t restart = a.type == ComponentType::kUByte    ? 0xff
                                : a.type == ComponentType::kUShort ? 0xffff
                                                                   : 0xffffffff;
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] >= vertices_ || indices[i] == restart)
      json.fail(ErrorCode::kOutOfRange,
                fmt::format("index {} (number {}) {}", indices[i], i,
                            indices[i] >= vertices_ ? fmt::format("refers past the last of {} vertices", vertices_)
                                                    : "is the largest of its type, which is not allowed"));
  }
  return indices;
}

void PrimitiveReader::read_triangles(Mode mode) {
  std::vector<std::uint32_t> indices = read_indices();
  const std::size_t n = indices.size();
  std::vector<std::uint32_t>& triangles = out_.mesh.indices;
  if (mode == kTriangles) {
    if (n % 3 != 0) primitive_.fail(fmt::format("a list of triangles with {} vertices, no multiple of 3", n));
    triangles = std::move(indices);
    return;
  }
  if (n == 0) return;
  if (n < 3) primitive_.fail(fmt::format("a triangle strip or fan with {} vertices, fewer than 3", n));
  document_.files().charge((n - 2) * 3 * sizeof(std::uint32_t), primitive_.loc());
  triangles.reserve((n - 2) * 3);
  for (std::size_t i = 0; i + 2 < n; ++i) {  // glTF 2.0, 3.7.2.1
    if (mode == kTriangleStrip) {
      triangles.insert(triangles.end(), {indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]});
    } else {
      triangles.insert(triangles.end(), {indices[i + 1], indices[i + 2], indices[0]});
    }
  }
}

}  // namespace

GltfMesh read_mesh(const GltfDocument& document, const Json& json) {
  GltfMesh mesh;
  mesh.json = json;
  const Json primitives = json.object()["primitives"].required().array();
  if (primitives.size() == 0) primitives.fail("a mesh has at least one primitive");
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Json primitive = primitives.at(i).object();
    const std::size_t targets = primitive["targets"].array().size();
    if (i > 0 && targets != mesh.targets)
      primitive.fail(fmt::format("has {} morph targets, but the mesh's first primitive has {}", targets, mesh.targets));
    mesh.targets = targets;
    mesh.primitives.push_back(PrimitiveReader(document, primitive).read());
  }
  mesh.weights.assign(mesh.targets, 0.0f);
  std::vector<double> weights(mesh.targets, 0.0);
  if (json["weights"].numbers(weights.data(), mesh.targets))
    std::copy(weights.begin(), weights.end(), mesh.weights.begin());
  return mesh;
}

void make_tangents(Mesh& mesh) {
  const std::size_t vertices = mesh.positions.size();
  if (mesh.normals.empty() || mesh.uvs.empty() || !mesh.tangents.empty()) return;
  // A triangle whose texture is mirrored has its bitangent on the other side. Its vertices are not shared with
  // triangles that are not mirrored: sums[s] is for those with sign s.
  struct Sum {
    Vec3f tangent;
    bool used = false;
  };
  std::vector<std::array<Sum, 2>> sums(vertices);
  std::vector<std::uint8_t> mirrored(mesh.triangle_count());
  for (std::size_t t = 0; t < mirrored.size(); ++t) {
    const std::uint32_t* v = mesh.corners(t);
    const Vec3f e1 = mesh.positions[v[1]] - mesh.positions[v[0]], e2 = mesh.positions[v[2]] - mesh.positions[v[0]];
    const Vec2f d1 = mesh.uvs[v[1]] - mesh.uvs[v[0]], d2 = mesh.uvs[v[2]] - mesh.uvs[v[0]];
    const float area = d1.x * d2.y - d2.x * d1.y;
    // v points down in glTF's pictures and up along the bitangent, so a texture that reads correctly has area < 0 here.
    mirrored[t] = area > 0;
    const Vec3f tangent = normalize((e1 * d2.y - e2 * d1.y) * (area < 0 ? -1.0f : 1.0f));
    for (int k = 0; k < 3; ++k) {
      const Vec3f a = normalize(mesh.positions[v[(k + 1) % 3]] - mesh.positions[v[k]]);
      const Vec3f b = normalize(mesh.positions[v[(k + 2) % 3]] - mesh.positions[v[k]]);
      Sum& sum = sums[v[k]][mirrored[t]];
      sum.tangent += tangent * std::acos(std::clamp(dot(a, b), -1.0f, 1.0f));  // weighted by angle, as MikkTSpace does
      sum.used = true;
    }
  }

  // Vertices used with both signs get a copy for the mirrored triangles.
  std::vector<std::uint32_t> source, copy(vertices);
  for (std::size_t v = 0; v < vertices; ++v) {
    copy[v] = std::uint32_t(v);
    if (!sums[v][0].used || !sums[v][1].used) continue;
    copy[v] = std::uint32_t(vertices + source.size());
    source.push_back(std::uint32_t(v));
  }
  const auto extend = [&](auto& values, std::size_t width = 1) {
    if (values.empty()) return;
    values.reserve(values.size() + source.size() * width);
    for (const std::uint32_t v : source)
      for (std::size_t k = 0; k < width; ++k) values.push_back(values[v * width + k]);
  };
  extend(mesh.positions);
  extend(mesh.normals);
  extend(mesh.uvs);
  extend(mesh.uvs1);
  extend(mesh.colors);
  extend(mesh.color_alphas);
  extend(mesh.source_vertices);
  extend(mesh.skin.indices, mesh.skin.influences);
  extend(mesh.skin.weights, mesh.skin.influences);
  for (MorphTarget& target : mesh.morph_targets) {
    extend(target.positions);
    extend(target.normals);
    extend(target.tangents);
  }
  for (std::size_t t = 0; t < mirrored.size(); ++t)
    for (std::size_t k = 0; mirrored[t] && k < 3; ++k) mesh.indices[3 * t + k] = copy[mesh.indices[3 * t + k]];

  mesh.tangents.resize(mesh.positions.size());
  mesh.tangent_signs.resize(mesh.positions.size());
  const auto finish = [&](std::size_t v, const Vec3f& sum, bool is_mirrored) {
    mesh.tangents[v] = Basis::with_tangent(mesh.normals[v], sum).s;
    mesh.tangent_signs[v] = is_mirrored ? -1.0f : 1.0f;
  };
  for (std::size_t v = 0; v < vertices; ++v)
    finish(v, sums[v][sums[v][0].used ? 0 : 1].tangent, !sums[v][0].used && sums[v][1].used);
  for (std::size_t i = 0; i < source.size(); ++i) finish(vertices + i, sums[source[i]][1].tangent, true);
}

void bake_morph_targets(Mesh& mesh, const std::vector<float>& weights) {
  const auto add = [](std::vector<Vec3f>& values, const std::vector<Vec3f>& delta, float w) {
    for (std::size_t i = 0; i < delta.size(); ++i) values[i] += delta[i] * w;
  };
  bool normals = false, tangents = false;
  for (std::size_t k = 0; k < mesh.morph_targets.size(); ++k) {
    const MorphTarget& target = mesh.morph_targets[k];
    if (weights[k] == 0) continue;
    add(mesh.positions, target.positions, weights[k]);
    add(mesh.normals, target.normals, weights[k]);
    add(mesh.tangents, target.tangents, weights[k]);
    normals |= !target.normals.empty();
    tangents |= !target.tangents.empty();
  }
  for (Vec3f& n : mesh.normals)
    if (normals) n = normalize(n);
  for (Vec3f& t : mesh.tangents)
    if (tangents) t = normalize(t);
  mesh.morph_targets.clear();
}

}  // namespace tempera
