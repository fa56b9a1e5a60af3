// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/gltf.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <compare>
#include <map>

#include "catalog.h"
#include "gltf_animation.h"
#include "gltf_document.h"
#include "gltf_material.h"
#include "gltf_mesh.h"
#include "singular.h"

namespace tempera {
namespace {

float first_number(const float* v) { return v[0]; }
Rgb three_numbers(const float* v) { return {v[0], v[1], v[2]}; }

/// Affine map of 16 numbers by columns.
Affine3d affine(const double* m) {
  return {{m[0], m[1], m[2]}, {m[4], m[5], m[6]}, {m[8], m[9], m[10]}, {m[12], m[13], m[14]}};
}

Quatd unit_quaternion(const double* q) { return normalize(Quatd{q[3], q[0], q[1], q[2]}); }

Affine3d compose(const Vec3d& t, const Quatd& r, const Vec3d& s) {
  Affine3d m = rotation(r) * scale(s);
  m.translation = t;
  return m;
}

/// Product of two step functions of visibility.
Animated<float> visible_in_both(const Animated<float>& a, const Animated<float>& b) {
  if (a.is_constant() && a.at(0) >= 0.5f) return b;
  if (b.is_constant() && b.at(0) >= 0.5f) return a;
  std::vector<double> times = a.times();
  times.insert(times.end(), b.times().begin(), b.times().end());
  if (times.empty()) times.push_back(0);
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());
  std::vector<float> values;
  for (const double t : times) values.push_back(a.at(t) >= 0.5f && b.at(t) >= 0.5f ? 1.0f : 0.0f);
  return {std::move(times), std::move(values), Interpolation::kStep};
}

std::uint64_t byte_size(const Mesh& mesh) {
  const auto bytes = [](const auto& v) { return std::uint64_t(v.size() * sizeof(v[0])); };
  std::uint64_t sum = bytes(mesh.positions) + bytes(mesh.normals) + bytes(mesh.uvs) + bytes(mesh.uvs1) +
                      bytes(mesh.tangents) + bytes(mesh.tangent_signs) + bytes(mesh.indices) + bytes(mesh.colors) +
                      bytes(mesh.color_alphas) + bytes(mesh.source_vertices) + bytes(mesh.skin.indices) +
                      bytes(mesh.skin.weights);
  for (const MorphTarget& t : mesh.morph_targets) sum += bytes(t.positions) + bytes(t.normals) + bytes(t.tangents);
  return sum;
}

class GltfImporter {
 public:
  GltfImporter(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings)
      : files_(file, options),
        document_(file, options, files_, warnings),
        animations_(document_, options.animation),
        materials_(document_, animations_, options.tints_once) {
    scene_.source = file;
    scene_.bend_normals = true;
  }
  Scene load();

 private:
  /// What a node draws. Nodes that draw the same share a group.
  struct GroupKey {
    int mesh, skin;
    int weights_node;  // whose weights shape it; -1: the mesh's own
    auto operator<=>(const GroupKey&) const = default;
  };
  struct Use {
    int node;  // glTF's
    GroupKey key;
  };

  void build_nodes();
  AnimatedTransform node_transform(const Json& json, int node);
  Animated<float> node_visibility(const Json& json, int node);
  std::vector<int> reachable_nodes() const;
  void build_meshes(const std::vector<int>& nodes);
  std::vector<int> build_group(const GroupKey& key, bool last_use);
  Skin bind_skin(Skin skin, int index, std::size_t max_joint, const Json& where);
  int skinned_node(int node);
  void add_instances(const Use& use, int group);
  void add_gpu_instances(const Json& extension, const Instance& instance);
  void add_camera(int node, int camera);
  void add_light(int node, int index);
  int add_node(Node node);
  int add_turned_child(int parent, const std::string& name);
  int add_turned_child(int parent, Affine3d world, const std::string& name);
  Json node_json(int node) const { return document_.list("nodes").at(node); }

  InputFiles files_;
  GltfDocument document_;
  GltfAnimations animations_;
  GltfMaterials materials_;
  Scene scene_;
  std::vector<int> scene_node_;   // of each glTF node
  std::vector<int> gltf_parent_;  // of each glTF node, or -1
  std::vector<int> order_;        // glTF nodes, parents first
  std::vector<Affine3d> world_;   // of each scene node that stands for a glTF node, at time 0
  std::vector<GltfMesh> meshes_;
};

Scene GltfImporter::load() {
  build_nodes();
  const std::vector<int> nodes = reachable_nodes();
  const Json list = document_.list("meshes");
  for (std::size_t i = 0; i < list.size(); ++i) meshes_.push_back(read_mesh(document_, list.at(i)));
  const Json skins = document_.list("skins");
  for (int i = 0; i < std::ssize(skins); ++i) bind_skin({}, i, 0, skins.at(i));  // also those that nothing uses
  build_meshes(nodes);
  const std::size_t lights =
      document_.root()["extensions"].object()["KHR_lights_punctual"].object()["lights"].array().size();
  for (const int node : nodes) {
    const Json json = node_json(node);
    if (const Json camera = json["camera"]) add_camera(node, camera.index(document_.count("cameras"), "cameras"));
    if (const Json light = json["extensions"].object()["KHR_lights_punctual"].object()["light"])
      add_light(node, light.index(lights, "lights"));
  }
  if (scene_.instances.empty()) document_.warn("the scene shows no geometry", document_.root());
  animations_.warn_unused();
  document_.warn_of_unread();
  scene_.animation = animations_.span();
  scene_.animation_names = animations_.names();
  scene_.content_hash = files_.hash();
  return std::move(scene_);
}

int GltfImporter::add_node(Node node) {
  files_.charge(sizeof(Node), {document_.file().string()});
  scene_.nodes.push_back(std::move(node));
  return int(scene_.nodes.size()) - 1;
}

void GltfImporter::build_nodes() {
  const Json nodes = document_.list("nodes");
  const int n = int(nodes.size());
  gltf_parent_.assign(n, -1);
  for (int i = 0; i < n; ++i) {
    const Json children = nodes.at(i).object()["children"].array();
    for (std::size_t k = 0; k < children.size(); ++k) {
      const int child = children.at(k).index(n, "nodes");
      if (gltf_parent_[child] >= 0)
        children.at(k).fail(fmt::format("nodes[{}] is a child of nodes[{}] already", child, gltf_parent_[child]));
      gltf_parent_[child] = i;
    }
  }
  // Parents first. What is left after all roots and what hangs on them goes round in a circle.
  for (int i = 0; i < n; ++i)
    if (gltf_parent_[i] < 0) order_.push_back(i);
  for (std::size_t i = 0; i < order_.size(); ++i) {
    const Json children = nodes.at(order_[i])["children"];
    for (std::size_t k = 0; k < children.size(); ++k) order_.push_back(int(children.at(k).integer(0)));
  }
  scene_node_.assign(n, -1);
  for (const int i : order_) scene_node_[i] = 0;
  for (int i = 0; i < n; ++i)
    if (scene_node_[i] < 0) nodes.at(i).fail("is a descendant of itself");

  for (const int i : order_) {
    const Json json = nodes.at(i);
    Node node;
    const int parent = gltf_parent_[i];
    node.parent = parent < 0 ? -1 : scene_node_[parent];
    node.name = json["name"].string();
    node.local = node_transform(json, i);
    node.visibility = node_visibility(json, i);
    world_.push_back(node.parent < 0 ? node.local.at(0) : world_[node.parent] * node.local.at(0));
    scene_node_[i] = add_node(std::move(node));
  }
}

AnimatedTransform GltfImporter::node_transform(const Json& json, int node) {
  const auto finite = [](const Json& where, const double* values, std::size_t n) {
    // JSON has no infinity, but floats have less room than JSON's numbers.
    for (std::size_t i = 0; i < n; ++i)
      if (!(std::abs(values[i]) < 1e30)) where.fail(ErrorCode::kOutOfRange, fmt::format("{} is too large", values[i]));
  };
  double m[16], t[3] = {0, 0, 0}, r[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
  const bool has_trs = json["translation"].numbers(t, 3) | json["rotation"].numbers(r, 4) | json["scale"].numbers(s, 3);
  finite(json["translation"], t, 3), finite(json["rotation"], r, 4), finite(json["scale"], s, 3);
  if (const Json matrix = json["matrix"]) {
    if (has_trs) json.fail("has both a matrix and translation, rotation or scale");
    matrix.numbers(m, 16);
    finite(matrix, m, 16);
    if (std::abs(m[3]) + std::abs(m[7]) + std::abs(m[11]) + std::abs(m[15] - 1) > 1e-4)
      matrix.fail("the last row of a node's matrix is 0 0 0 1");
    return affine(m);
  }
  for (double& x : s)
    if (std::abs(x) < 1e-30) x = 0;  // float32, which shapes are held in, has no inverse of it
  const double norm = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
  if (std::abs(norm - 1) > 0.02)
    document_.warn("rotations that are not unit quaternions are normalized", json["rotation"]);
  const Vec3d translation{t[0], t[1], t[2]}, scale{s[0], s[1], s[2]};
  const Quatd rotation = unit_quaternion(r);

  const std::string pointer = fmt::format("/nodes/{}", node);
  const Track* moving_t = animations_.find(pointer + "/translation", 3);
  const Track* moving_r = animations_.find(pointer + "/rotation", 4);
  const Track* moving_s = animations_.find(pointer + "/scale", 3);
  const bool flat = s[0] == 0 || s[1] == 0 || s[2] == 0;  // a matrix would lose the rotation, which cameras need
  if (!moving_t && !moving_r && !moving_s && !flat) return compose(translation, rotation, scale);
  AnimatedTransform animated;
  animated.keyed = true;
  animated.translation = moving_t ? map_linear<Vec3d>(*moving_t, to_vec3d) : Animated<Vec3d>(translation);
  animated.rotation = moving_r ? map_linear<Quatd>(*moving_r, to_quatd) : Animated<Quatd>(rotation);
  animated.scale = moving_s ? map_linear<Vec3d>(*moving_s, to_vec3d) : Animated<Vec3d>(scale);
  return animated;
}

Animated<float> GltfImporter::node_visibility(const Json& json, int node) {
  const Json extension = json["extensions"].object()["KHR_node_visibility"].object();
  const Track* track = animations_.find(fmt::format("/nodes/{}/extensions/KHR_node_visibility/visible", node), 1);
  if (track) return map_linear<float>(*track, first_number);
  return extension["visible"].boolean(true) ? 1.0f : 0.0f;
}

std::vector<int> GltfImporter::reachable_nodes() const {
  const Json scenes = document_.list("scenes");
  const int index = document_.root()["scene"].optional_index(scenes.size(), "scenes");
  if (!scenes) return order_;
  if (index < 0 && scenes.size() > 0) document_.warn("the file names no default scene; the first one is shown", scenes);
  std::vector<char> in_scene(order_.size(), 0);
  for (int i = 0; i < std::ssize(scenes); ++i) {
    const Json roots = scenes.at(i).object()["nodes"].array();
    for (std::size_t k = 0; k < roots.size(); ++k) {
      const int node = roots.at(k).index(order_.size(), "nodes");
      if (gltf_parent_[node] >= 0) roots.at(k).fail(fmt::format("nodes[{}] is not a root: it has a parent", node));
      if (i == std::max(index, 0)) in_scene[node] = 1;
    }
  }
  std::vector<int> reachable;
  for (const int node : order_) {
    const int parent = gltf_parent_[node];
    if (parent >= 0) in_scene[node] = in_scene[parent];
    if (in_scene[node]) reachable.push_back(node);
  }
  return reachable;
}

void GltfImporter::build_meshes(const std::vector<int>& nodes) {
  std::vector<Use> uses;
  constexpr int kNotBuilt = -1, kDrawsNothing = -2;
  std::map<GroupKey, int> groups;
  std::vector<int> keys_of_mesh(meshes_.size(), 0);
  for (const int node : nodes) {
    const Json json = node_json(node);
    const int skin = json["skin"].optional_index(document_.count("skins"), "skins");
    if (!json["mesh"]) {
      if (skin >= 0) document_.warn("a skin on a node without a mesh is ignored", json["skin"]);
      continue;
    }
    const int mesh = json["mesh"].index(meshes_.size(), "meshes");
    const GltfMesh& m = meshes_[mesh];
    const bool own_weights =
        m.targets > 0 && (json["weights"] || animations_.find(fmt::format("/nodes/{}/weights", node), m.targets));
    const Use use{node, {mesh, skin, own_weights ? node : -1}};
    if (groups.emplace(use.key, kNotBuilt).second) ++keys_of_mesh[mesh];
    uses.push_back(use);
  }
  for (const Use& use : uses) {
    int& group = groups[use.key];
    if (group == kNotBuilt) {
      std::vector<int> shapes = build_group(use.key, --keys_of_mesh[use.key.mesh] == 0);
      group = shapes.empty() ? kDrawsNothing : int(scene_.groups.size());
      if (!shapes.empty()) scene_.groups.push_back(std::move(shapes));
    }
    if (group >= 0) add_instances(use, group);
  }
}

std::vector<int> GltfImporter::build_group(const GroupKey& key, bool last_use) {
  GltfMesh& source = meshes_[key.mesh];
  std::string mesh_name(source.json["name"].string());
  if (mesh_name.empty()) mesh_name = fmt::format("mesh{}", key.mesh);

  std::vector<float> weights = source.weights;
  const Track* track = nullptr;
  if (source.targets > 0) {
    if (key.weights_node >= 0) {
      std::vector<double> own(source.targets);
      if (node_json(key.weights_node)["weights"].numbers(own.data(), own.size()))
        weights.assign(own.begin(), own.end());
      track = animations_.find(fmt::format("/nodes/{}/weights", key.weights_node), source.targets);
    } else {
      track = animations_.find(fmt::format("/meshes/{}/weights", key.mesh), source.targets);
    }
  }

  std::vector<int> shapes;
  for (std::size_t i = 0; i < source.primitives.size(); ++i) {
    GltfPrimitive& primitive = source.primitives[i];
    Skin skin;
    if (key.skin >= 0) {
      if (primitive.mesh.skin.indices.empty() && !primitive.mesh.positions.empty())
        primitive.json["attributes"].fail("lacks JOINTS_0 and WEIGHTS_0, but a node uses the mesh with a skin");
      skin = bind_skin(last_use ? std::move(primitive.mesh.skin) : primitive.mesh.skin, key.skin, primitive.max_joint,
                       primitive.json);
    }
    if (primitive.mesh.indices.empty()) continue;  // points, lines
    if (!last_use) files_.charge(byte_size(primitive.mesh), primitive.json.loc());
    Shape shape;
    const GltfMaterial& material = materials_.get(primitive.material, primitive.has_colors);
    Mesh mesh = last_use ? std::move(primitive.mesh) : primitive.mesh;
    mesh.skin = std::move(skin);
    if (material.uses_tangents) make_tangents(mesh);
    if (!mesh.morph_targets.empty()) {
      if (track) {
        mesh.morph_weights = map_linear<std::vector<float>>(
            *track, [n = source.targets](const float* v) { return std::vector<float>(v, v + n); });
      } else {
        bake_morph_targets(mesh, weights);
        if (!std::all_of(mesh.positions.begin(), mesh.positions.end(), [](const Vec3f& p) { return is_finite(p); }))
          primitive.json.fail("the morph targets move a vertex beyond all bounds");
      }
    }
    shape.geometry = std::move(mesh);
    shape.material = material.material;
    shape.emission = material.emission;
    shape.material_name = material.name;
    shape.name = source.primitives.size() == 1 ? mesh_name : fmt::format("{}[{}]", mesh_name, i);
    shapes.push_back(int(scene_.shapes.size()));
    scene_.shapes.push_back(std::move(shape));
  }
  return shapes;
}

Skin GltfImporter::bind_skin(Skin skin, int index, std::size_t max_joint, const Json& where) {
  const Json json = document_.list("skins").at(index).object();
  const Json joints = json["joints"].required().array();
  const std::size_t n = joints.size();
  if (n == 0) joints.fail("a skin has at least one joint");
  if (n > 65536) joints.fail(ErrorCode::kUnsupported, fmt::format("{} joints; at most 65536 are supported", n));
  if (max_joint >= n)
    where.fail(ErrorCode::kOutOfRange,
               fmt::format("a vertex follows joint {} of skins[{}], which has {}", max_joint, index, n));
  std::vector<float> inverse_bind;
  if (const Json matrices = json["inverseBindMatrices"]) {
    const Accessor& a = document_.accessor(matrices, "MAT4");
    if (!a.is_float()) matrices.fail("matrices are floats");
    if (a.count < n) matrices.fail(fmt::format("has {} matrices for {} joints", a.count, n));
    inverse_bind = document_.floats(a);
  }
  skin.joints.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    skin.joints[i].node = scene_node_[joints.at(i).index(scene_node_.size(), "nodes")];
    if (inverse_bind.empty()) continue;
    double m[16];
    for (std::size_t k = 0; k < 16; ++k) {
      m[k] = inverse_bind[16 * i + k];
      if (!std::isfinite(m[k])) json["inverseBindMatrices"].fail(fmt::format("matrix {} is not finite", i));
    }
    skin.joints[i].inverse_bind = affine(m);
  }
  return skin;
}

/// A node for a skinned mesh at `node`: only joints move it (glTF 2.0, 3.7.3.3), but it is hidden with its ancestors.
int GltfImporter::skinned_node(int node) {
  Animated<float> visibility{1.0f};
  for (int i = node; i >= 0; i = gltf_parent_[i])
    visibility = visible_in_both(visibility, scene_.nodes[scene_node_[i]].visibility);
  if (visibility.is_constant() && visibility.at(0) >= 0.5f) return -1;
  Node root;
  root.name = scene_.nodes[scene_node_[node]].name;
  root.visibility = std::move(visibility);
  return add_node(std::move(root));
}

void GltfImporter::add_instances(const Use& use, int group) {
  const Json json = node_json(use.node);
  Instance instance;
  instance.group = group;
  instance.node = use.key.skin >= 0 ? skinned_node(use.node) : scene_node_[use.node];
  instance.name = json["name"].string();
  if (instance.name.empty()) instance.name = meshes_[use.key.mesh].json["name"].string();
  if (instance.name.empty()) instance.name = fmt::format("node{}", use.node);
  const Json gpu = json["extensions"].object()["EXT_mesh_gpu_instancing"].object();
  if (!gpu) {
    scene_.instances.push_back(std::move(instance));
  } else if (use.key.skin >= 0) {
    gpu.fail(ErrorCode::kUnsupported, "instances of a skinned mesh");
  } else {
    add_gpu_instances(gpu, instance);
  }
}

void GltfImporter::add_gpu_instances(const Json& extension, const Instance& instance) {
  const Json attributes = extension["attributes"].required().object();
  std::size_t count = 0;
  bool any = false;
  const auto read = [&](const char* name, const char* shape, bool fraction) {
    const Json index = attributes[name];
    std::vector<float> values;
    if (!index) return values;
    const Accessor& a = document_.accessor(index, shape);
    if (fraction ? !a.is_fraction() : !a.is_float())
      index.fail(fmt::format("cannot be of component type {}", int(a.type)));
    if (any && a.count != count) index.fail(fmt::format("has {} elements, another attribute {}", a.count, count));
    count = a.count;
    any = true;
    files_.charge(a.count * a.components * sizeof(float), index.loc());
    values = document_.floats(a);
    for (const float v : values)
      if (!(std::abs(v) < 1e30f)) index.fail(fmt::format("a {} that is not finite or too large", name));
    return values;
  };
  const auto t = read("TRANSLATION", "VEC3", false), r = read("ROTATION", "VEC4", true),
             s = read("SCALE", "VEC3", false);
  if (!attributes["TRANSLATION"] && !attributes["ROTATION"] && !attributes["SCALE"])
    attributes.fail("has none of TRANSLATION, ROTATION and SCALE");
  for (std::size_t i = 0; i < count; ++i) {
    Node node;
    node.parent = instance.node;
    node.name = fmt::format("{}[{}]", instance.name, i);
    node.local =
        compose(t.empty() ? Vec3d{} : to_vec3d(&t[3 * i]), r.empty() ? Quatd{} : normalize(to_quatd(&r[4 * i])),
                s.empty() ? Vec3d{1, 1, 1} : to_vec3d(&s[3 * i]));
    Instance one = instance;
    one.name = node.name;
    one.node = add_node(std::move(node));
    scene_.instances.push_back(std::move(one));
  }
}

/// A node for a camera or light at a node, that looks along its -z. glTF ignores the scale of the nodes of cameras and
/// lights. A node's own scale is left out if it moves or is 0; any other, and that of the nodes above, is undone as it
/// is at time 0. Returns -1 if that is not possible: the nodes above are singular then, or a matrix is.
int GltfImporter::add_turned_child(int parent, const std::string& name) {
  const AnimatedTransform& local = scene_.nodes[parent].local;
  if (local.keyed && (!local.scale.is_constant() || is_singular(scale(local.scale.at(0))))) {
    Node unscaled = scene_.nodes[parent];
    unscaled.local.scale = Vec3d{1, 1, 1};
    const Affine3d above = unscaled.parent < 0 ? Affine3d{} : world_[unscaled.parent];
    const Affine3d world = above * unscaled.local.at(0);
    return add_turned_child(add_node(std::move(unscaled)), world, name);
  }
  return add_turned_child(parent, world_[parent], name);
}

int GltfImporter::add_turned_child(int parent, Affine3d m, const std::string& name) {
  m.translation = {};
  const Vec3d z = normalize(m.z), x = normalize(cross(m.y, z));
  const Affine3d unscale = inverse(m) * Affine3d{x, cross(z, x), z};
  const double change =
      length(unscale.x - Vec3d{1, 0, 0}) + length(unscale.y - Vec3d{0, 1, 0}) + length(unscale.z - Vec3d{0, 0, 1});
  if (!std::isfinite(change) || is_singular(m)) return -1;
  Node node;
  node.parent = parent;
  node.name = name;
  node.local = Affine3d{{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}};
  if (change > 1e-5) node.local = unscale * node.local.matrix;
  return add_node(std::move(node));
}

static constexpr Named<Projection> kCameraTypes[] = {{"perspective", Projection::kPerspective},
                                                     {"orthographic", Projection::kOrthographic}};

void GltfImporter::add_camera(int node, int camera) {
  const Json json = document_.list("cameras").at(camera).object();
  const std::string pointer = fmt::format("/cameras/{}", camera);
  Camera c;
  const Node& parent = scene_.nodes[scene_node_[node]];
  c.name = json["name"].string();
  const auto taken = [&](const Camera& other) { return other.name == c.name; };
  if (c.name.empty() || std::any_of(scene_.cameras.begin(), scene_.cameras.end(), taken)) c.name = parent.name;
  if (c.name.empty() || std::any_of(scene_.cameras.begin(), scene_.cameras.end(), taken))
    c.name = fmt::format("camera{}", scene_.cameras.size());
  c.node = add_turned_child(scene_node_[node], c.name);
  if (c.node < 0) return document_.warn("cameras at nodes with a singular transform are left out", node_json(node));
  c.keep_vertical_fov = true;

  const Json type = json["type"].required();
  const auto positive = [](const Json& value, double max) {
    const double v = value.required().number(0);
    if (!(v > 0 && v < max)) value.fail(ErrorCode::kOutOfRange, fmt::format("{} is outside (0, {})", v, max));
    return v;
  };
  c.projection = choice(type, type.string(), "camera type", kCameraTypes);
  if (c.projection == Projection::kPerspective) {
    const Json p = json["perspective"].required().object();
    const double yfov = positive(p["yfov"], kPiD);
    if (const Json aspect = p["aspectRatio"]) c.authored_aspect = float(positive(aspect, 1e6));
    const auto fov_x = [aspect = double(c.authored_aspect)](double y) {
      return float(2 * std::atan(aspect * std::tan(std::clamp(y, 1e-4, kPiD - 1e-4) / 2)));
    };
    const Track* track = animations_.find(pointer + "/perspective/yfov", 1);
    c.fov_x = track ? map_resampled(*track, fov_x) : Animated<float>(fov_x(yfov));
    c.near_clip = float(positive(p["znear"], 1e30));
    if (const Json far = p["zfar"]) c.far_clip = float(positive(far, 1e30));
    if (!(c.far_clip > c.near_clip)) p["zfar"].fail(ErrorCode::kOutOfRange, "zfar is not beyond znear");
  } else {
    const Json o = json["orthographic"].required().object();
    const auto half = [&](const char* name) {
      const double v = std::abs(o[name].required().number(0));
      if (!(v > 0 && v < 1e30)) o[name].fail(ErrorCode::kOutOfRange, "a magnification is not zero");
      return v;
    };
    const double xmag = half("xmag"), ymag = half("ymag");
    const Track* track = animations_.find(pointer + "/orthographic/xmag", 1);
    c.width =
        track ? map_linear<float>(*track, [](const float* v) { return 2 * v[0]; }) : Animated<float>(float(2 * xmag));
    c.authored_aspect = float(xmag / ymag);
    c.near_clip = float(o["znear"].required().number(0, 0, 1e30));
    c.far_clip = float(positive(o["zfar"], 1e30));
    if (!(c.far_clip > c.near_clip)) o["zfar"].fail(ErrorCode::kOutOfRange, "zfar is not beyond znear");
  }
  scene_.cameras.push_back(std::move(c));
}

static constexpr Named<LightType> kLightTypes[] = {
    {"point", LightType::kPoint}, {"spot", LightType::kSpot}, {"directional", LightType::kDirectional}};

void GltfImporter::add_light(int node, int index) {
  const Json json = document_.root()["extensions"]["KHR_lights_punctual"]["lights"].at(index).object();
  const std::string pointer = fmt::format("/extensions/KHR_lights_punctual/lights/{}", index);
  PunctualLight light;
  const Json type = json["type"].required();
  light.type = choice(type, type.string(), "light type", kLightTypes);
  light.name = json["name"].string();
  if (light.name.empty()) light.name = scene_.nodes[scene_node_[node]].name;
  light.node = add_turned_child(scene_node_[node], light.name);
  if (light.node < 0) return document_.warn("lights at nodes with a singular transform are ignored", node_json(node));

  // See the header: Watts as Blender means them.
  const int blender = document_.blender_version();
  const bool directional = light.type == LightType::kDirectional;
  const float unit = blender == 0 ? 1.0f : blender >= 304 ? 1.0f / 683 : directional ? 1.0f : 1.0f / (4 * kPi);
  const Json intensity = json["intensity"];
  const double value = intensity.number(1);
  if (!(value >= 0 && value < 1e30))
    intensity.fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [0, 1e30)", value));
  const Track* track = animations_.find(pointer + "/intensity", 1);
  light.intensity_scale = track ? map_linear<float>(*track, [&](const float* v) { return v[0] * unit; })
                                : Animated<float>(float(value) * unit);
  double color[3] = {1, 1, 1};
  json["color"].numbers(color, 3);
  for (const double c : color)
    if (!(c >= 0 && c < 1e30)) json["color"].fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [0, 1]", c));
  track = animations_.find(pointer + "/color", 3);
  light.intensity = track ? map_linear<Rgb>(*track, three_numbers)
                          : Animated<Rgb>(Rgb(float(color[0]), float(color[1]), float(color[2])));

  if (light.type == LightType::kSpot) {
    const Json spot = json["spot"].required().object();
    light.falloff = SpotFalloff::kSquared;
    const double outer = spot["outerConeAngle"].number(kPiD / 4, 0, kPiD / 2 + 1e-6),
                 inner = spot["innerConeAngle"].number(0, 0, kPiD / 2);
    if (!(inner < outer))
      spot.fail(ErrorCode::kOutOfRange, fmt::format("innerConeAngle {} is not below outerConeAngle {}", inner, outer));
    const Track* moving_outer = animations_.find(pointer + "/spot/outerConeAngle", 1);
    const Track* moving_inner = animations_.find(pointer + "/spot/innerConeAngle", 1);
    light.cutoff_angle = moving_outer ? map_linear<float>(*moving_outer, first_number) : Animated<float>(float(outer));
    light.beam_width = moving_inner ? map_linear<float>(*moving_inner, first_number) : Animated<float>(float(inner));
  }
  scene_.lights.push_back(std::move(light));
}

constexpr std::string_view kExtensions[] = {".glb", ".gltf"};

}  // namespace

Scene import_gltf(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings) {
  try {
    return GltfImporter(file, options, warnings).load();
  } catch (const std::bad_alloc&) {
    throw Error(ErrorCode::kOutOfMemory, {file.string()}, "not enough memory for the scene");
  }
}

extern const ImporterEntry gltf_importer{"gltf", "glTF 2.0, text or binary, with animation", kExtensions, import_gltf};

}  // namespace tempera
