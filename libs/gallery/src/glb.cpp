// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/glb.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "tempera/core/error.h"

namespace tempera::gallery {

namespace {

using Json = nlohmann::ordered_json;

// Numbers of the specification [glTF 2.0, sections 3.6 and 4].
constexpr int kFloat = 5126, kUint32 = 5125, kUint16 = 5123;
constexpr int kVertices = 34962, kIndices = 34963;
constexpr std::uint32_t kMagic = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;

Json array(const Vec3d& v) { return {float(v.x), float(v.y), float(v.z)}; }
Json array(const Quatd& q) { return {float(q.x), float(q.y), float(q.z), float(q.w)}; }
Json array(const Rgb& c) { return {c.r, c.g, c.b}; }

void append(std::string& out, const void* data, std::size_t size) { out.append(static_cast<const char*>(data), size); }
void append(std::string& out, std::uint32_t v) { append(out, &v, 4); }

}  // namespace

struct Glb::Data {
  Json doc;
  std::string binary;
  std::set<std::string> extensions;
  std::vector<std::size_t> mesh_triangles;
  std::size_t placed = 0;
  std::map<std::vector<float>, int> key_times;  // accessors of times, shared by tracks
  int clip = -1;

  int add(const char* list, Json item) {
    Json& items = doc[list];
    items.push_back(std::move(item));
    return int(items.size()) - 1;
  }

  int view(const void* data, std::size_t size, int target) {
    while (binary.size() % 4 != 0) binary += '\0';
    Json v{{"buffer", 0}, {"byteOffset", binary.size()}, {"byteLength", size}};
    if (target != 0) v["target"] = target;
    append(binary, data, size);
    return add("bufferViews", std::move(v));
  }

  template <class T>
  int accessor(std::span<const T> values, int components, int component_type, const char* type, int target,
               bool bounds = false) {
    Json a{{"bufferView", view(values.data(), values.size_bytes(), target)},
           {"componentType", component_type},
           {"count", values.size() * sizeof(T) / (components * (component_type == kUint16 ? 2 : 4))},
           {"type", type}};
    if (bounds) {
      const auto* p = reinterpret_cast<const float*>(values.data());
      const std::size_t n = values.size() * sizeof(T) / sizeof(float);
      std::vector<float> lo(p, p + components), hi = lo;
      for (std::size_t i = 0; i < n; ++i) {
        float &l = lo[i % components], &h = hi[i % components];
        l = std::min(l, p[i]), h = std::max(h, p[i]);
      }
      a["min"] = lo, a["max"] = hi;
    }
    return add("accessors", std::move(a));
  }
  int vec3(const std::vector<Vec3f>& v, int target, bool bounds = false) {
    static_assert(sizeof(Vec3f) == 12 && sizeof(Vec2f) == 8);
    return accessor<Vec3f>(v, 3, kFloat, "VEC3", target, bounds);
  }

  int times(std::span<const double> seconds) {
    const std::vector<float> key(seconds.begin(), seconds.end());
    const auto it = key_times.find(key);
    if (it != key_times.end()) return it->second;
    return key_times[key] = accessor<float>(key, 1, kFloat, "SCALAR", 0, true);
  }

  void track(int node, const char* path, std::span<const double> seconds, int output, Interpolation interpolation) {
    if (clip < 0)
      clip = add("animations", {{"name", "motion"}, {"channels", Json::array()}, {"samplers", Json::array()}});
    Json& animation = doc["animations"][clip];
    Json sampler{{"input", times(seconds)}, {"output", output}};
    if (interpolation == Interpolation::kStep) sampler["interpolation"] = "STEP";
    animation["samplers"].push_back(std::move(sampler));
    animation["channels"].push_back(
        {{"sampler", animation["samplers"].size() - 1}, {"target", {{"node", node}, {"path", path}}}});
  }

  Json extension(const char* name, Json value) {
    extensions.insert(name);
    return value;
  }
};

Glb::Glb() : data_(std::make_unique<Data>()) {
  // In the order of the specification; empty lists are left out when the file is made.
  data_->doc = {{"asset", {{"version", "2.0"}, {"generator", "tempera gallery"}}},
                {"extensionsUsed", Json::array()},
                {"scene", 0},
                {"scenes", Json::array({Json{{"nodes", Json::array()}}})}};
  for (const char* list : {"nodes", "cameras", "meshes", "skins", "animations", "materials", "textures", "images",
                           "samplers", "accessors", "bufferViews"})
    data_->doc[list] = Json::array();
}
Glb::~Glb() = default;

int Glb::image(const std::string& file) {
  if (data_->doc["samplers"].empty())
    data_->add("samplers", {{"magFilter", 9729}, {"minFilter", 9987}, {"wrapS", 10497}, {"wrapT", 10497}});
  const int image = data_->add("images", {{"uri", file}});
  return data_->add("textures", {{"sampler", 0}, {"source", image}});
}

int Glb::material(const Look& look) {
  Data& d = *data_;
  const auto texture = [](int index) { return Json{{"index", index}}; };
  Json pbr{{"baseColorFactor", {look.color.r, look.color.g, look.color.b, 1.0}},
           {"metallicFactor", float(look.metallic)},
           {"roughnessFactor", float(look.roughness)}};
  if (look.texture >= 0) pbr["baseColorTexture"] = texture(look.texture);
  if (look.surface_texture >= 0) pbr["metallicRoughnessTexture"] = texture(look.surface_texture);
  Json m{{"name", look.name}, {"pbrMetallicRoughness", pbr}};
  if (look.normal_texture >= 0) {
    m["normalTexture"] = texture(look.normal_texture);
    m["normalTexture"]["scale"] = float(look.normal_scale);
  }
  Json e = Json::object();
  if (!is_black(look.emission)) {
    // A factor is at most 1; its strength is an extension.
    const float strength = std::max(max_component(look.emission), 1.0f);
    m["emissiveFactor"] = array(look.emission / strength);
    m["doubleSided"] = true;  // both sides shine
    if (look.emission_texture >= 0) m["emissiveTexture"] = texture(look.emission_texture);
    if (strength > 1)
      e["KHR_materials_emissive_strength"] =
          d.extension("KHR_materials_emissive_strength", {{"emissiveStrength", strength}});
  }
  if (look.specular != 1)
    e["KHR_materials_specular"] = d.extension("KHR_materials_specular", {{"specularFactor", float(look.specular)}});
  if (look.ior != 1.5) e["KHR_materials_ior"] = d.extension("KHR_materials_ior", {{"ior", float(look.ior)}});
  if (look.transmission > 0) {
    e["KHR_materials_transmission"] =
        d.extension("KHR_materials_transmission", {{"transmissionFactor", float(look.transmission)}});
    if (look.solid) {
      Json volume{{"thicknessFactor", 1.0}};
      if (look.attenuation_distance > 0) {
        volume["attenuationDistance"] = float(look.attenuation_distance);
        volume["attenuationColor"] = array(look.attenuation_color);
      }
      e["KHR_materials_volume"] = d.extension("KHR_materials_volume", std::move(volume));
    }
  }
  if (look.clearcoat > 0)
    e["KHR_materials_clearcoat"] = d.extension(
        "KHR_materials_clearcoat",
        {{"clearcoatFactor", float(look.clearcoat)}, {"clearcoatRoughnessFactor", float(look.clearcoat_roughness)}});
  if (!e.empty()) m["extensions"] = std::move(e);
  return d.add("materials", std::move(m));
}

int Glb::mesh(const std::string& name, std::span<const Part> parts) {
  Data& d = *data_;
  Json primitives = Json::array();
  std::size_t triangles = 0, targets = 0;
  for (const Part& part : parts) {
    const Polygons& p = part.polygons;
    triangles += p.triangle_count();
    Json attributes{{"POSITION", d.vec3(p.positions, kVertices, true)}, {"NORMAL", d.vec3(p.normals, kVertices)}};
    attributes["TEXCOORD_0"] = d.accessor<Vec2f>(p.uvs, 2, kFloat, "VEC2", kVertices);
    if (!p.joints.empty()) {
      attributes["JOINTS_0"] = d.accessor<std::array<std::uint16_t, 4>>(p.joints, 4, kUint16, "VEC4", kVertices);
      attributes["WEIGHTS_0"] = d.accessor<std::array<float, 4>>(p.weights, 4, kFloat, "VEC4", kVertices);
    }
    Json primitive{{"attributes", std::move(attributes)}};
    if (p.positions.size() <= 65535) {
      const std::vector<std::uint16_t> small(p.indices.begin(), p.indices.end());
      primitive["indices"] = d.accessor<std::uint16_t>(small, 1, kUint16, "SCALAR", kIndices);
    } else {
      primitive["indices"] = d.accessor<std::uint32_t>(p.indices, 1, kUint32, "SCALAR", kIndices);
    }
    if (part.material >= 0) primitive["material"] = part.material;
    for (const Polygons::Displacement& t : p.targets)
      primitive["targets"].push_back(
          {{"POSITION", d.vec3(t.positions, kVertices, true)}, {"NORMAL", d.vec3(t.normals, kVertices)}});
    targets = p.targets.size();
    primitives.push_back(std::move(primitive));
  }
  Json mesh{{"name", name}, {"primitives", std::move(primitives)}};
  if (targets > 0) mesh["weights"] = std::vector<float>(targets, 0.0f);
  d.mesh_triangles.push_back(triangles);
  return d.add("meshes", std::move(mesh));
}

int Glb::node(const Node& node) {
  Data& d = *data_;
  Json n{{"name", node.name}};
  if (!(node.translation == Vec3d{})) n["translation"] = array(node.translation);
  if (!(node.rotation == Quatd{})) n["rotation"] = array(node.rotation);
  if (!(node.scale == Vec3d{1, 1, 1})) n["scale"] = array(node.scale);
  if (node.mesh >= 0) {
    n["mesh"] = node.mesh;
    d.placed += d.mesh_triangles[node.mesh];
  }
  if (node.skin >= 0) n["skin"] = node.skin;
  if (node.camera >= 0) n["camera"] = node.camera;
  if (node.light >= 0) n["extensions"]["KHR_lights_punctual"]["light"] = node.light;
  const int index = d.add("nodes", std::move(n));
  if (node.parent >= 0)
    d.doc["nodes"][node.parent]["children"].push_back(index);
  else
    d.doc["scenes"][0]["nodes"].push_back(index);
  return index;
}

int Glb::skin(std::span<const int> joints, std::span<const Affine3d> inverse_bind) {
  std::vector<float> values;
  for (const Affine3d& m : inverse_bind) {
    for (const Vec3d& column : {m.x, m.y, m.z, m.translation})
      values.insert(values.end(), {float(column.x), float(column.y), float(column.z), 0.0f});
    values.back() = 1;
  }
  const int matrices = data_->accessor<float>(values, 16, kFloat, "MAT4", 0);
  return data_->add("skins",
                    {{"joints", std::vector<int>(joints.begin(), joints.end())}, {"inverseBindMatrices", matrices}});
}

int Glb::camera(const std::string& name, double fov_y_degrees, double aspect) {
  return data_->add("cameras", {{"name", name},
                                {"type", "perspective"},
                                {"perspective",
                                 {{"aspectRatio", float(aspect)},
                                  {"yfov", float(fov_y_degrees * kPiD / 180)},
                                  {"znear", 0.01f},
                                  {"zfar", 10000.0f}}}});
}

int Glb::camera(const std::string& name, const Vec2d& size) {
  return data_->add(
      "cameras",
      {{"name", name},
       {"type", "orthographic"},
       {"orthographic",
        {{"xmag", float(0.5 * size.x)}, {"ymag", float(0.5 * size.y)}, {"znear", 0.0f}, {"zfar", 10000.0f}}}});
}

int Glb::directional_light(const std::string& name, const Rgb& irradiance) {
  data_->extensions.insert("KHR_lights_punctual");
  const float strength = std::max(max_component(irradiance), 1e-6f);
  Json& lights = data_->doc["extensions"]["KHR_lights_punctual"]["lights"];
  lights.push_back(
      {{"name", name}, {"type", "directional"}, {"color", array(irradiance / strength)}, {"intensity", strength}});
  return int(lights.size()) - 1;
}

void Glb::clip(const std::string& name) {
  Json& list = data_->doc["animations"];
  for (std::size_t i = 0; i < list.size(); ++i) {
    if (list[i]["name"] == name) return void(data_->clip = int(i));
  }
  data_->clip = data_->add("animations", {{"name", name}, {"channels", Json::array()}, {"samplers", Json::array()}});
}

void Glb::translate(int node, std::span<const double> times, std::span<const Vec3d> values,
                    Interpolation interpolation) {
  const std::vector<Vec3f> v(values.begin(), values.end());
  data_->track(node, "translation", times, data_->vec3(v, 0), interpolation);
}

void Glb::rotate(int node, std::span<const double> times, std::span<const Quatd> values, Interpolation interpolation) {
  std::vector<float> v;
  Quatd last{};
  for (Quatd q : values) {
    if (dot(q, last) < 0) q = -q;  // neighbors on the same half of the sphere
    v.insert(v.end(), {float(q.x), float(q.y), float(q.z), float(q.w)});
    last = q;
  }
  data_->track(node, "rotation", times, data_->accessor<float>(v, 4, kFloat, "VEC4", 0), interpolation);
}

void Glb::morph(int node, std::span<const double> times, std::span<const double> values) {
  const std::vector<float> v(values.begin(), values.end());
  data_->track(node, "weights", times, data_->accessor<float>(v, 1, kFloat, "SCALAR", 0), Interpolation::kLinear);
}

std::size_t Glb::triangles() const {
  std::size_t sum = 0;
  for (const std::size_t n : data_->mesh_triangles) sum += n;
  return sum;
}
std::size_t Glb::placed_triangles() const { return data_->placed; }

std::string Glb::bytes() const {
  Json doc = data_->doc;
  doc["extensionsUsed"] = data_->extensions;
  doc["buffers"] = Json::array({Json{{"byteLength", data_->binary.size()}}});
  for (auto it = doc.begin(); it != doc.end();) it = it->is_array() && it->empty() ? doc.erase(it) : std::next(it);
  std::string json = doc.dump(), binary = data_->binary;
  while (json.size() % 4 != 0) json += ' ';
  while (binary.size() % 4 != 0) binary += '\0';
  std::string out;
  append(out, kMagic);
  append(out, 2);
  append(out, std::uint32_t(12 + 8 + json.size() + 8 + binary.size()));
  append(out, std::uint32_t(json.size()));
  append(out, kJsonChunk);
  out += json;
  append(out, std::uint32_t(binary.size()));
  append(out, kBinaryChunk);
  out += binary;
  return out;
}

}  // namespace tempera::gallery
