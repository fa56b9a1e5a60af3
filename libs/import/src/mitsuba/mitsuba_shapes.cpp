// SPDX-License-Identifier: Apache-2.0
// Mitsuba's shapes. Static ones are baked into world space; animated ones keep their space and get a node. Mesh files
// are read last, many at a time.
#include <fmt/format.h>

#include <array>
#include <cmath>

#include "mitsuba_build.h"
#include "singular.h"
#include "tempera/core/parallel.h"
#include "tempera/import/mesh_files.h"

namespace tempera::mitsuba {
namespace {

std::uint64_t bytes_of(const Mesh& m) {
  return 12 * (m.positions.size() + m.normals.size() + m.colors.size()) + 8 * m.uvs.size() +
         4 * (m.indices.size() + m.color_alphas.size());
}

/// Mitsuba's cube: as make_cube, but each face's texture coordinates run as they do there. s and t are where u and v
/// grow.
Mesh textured_cube() {
  struct Side {
    Vec3f n, s, t;
  };
  static constexpr std::array<Side, 6> kSides{{{{0, -1, 0}, {0, 0, 1}, {1, 0, 0}},
                                               {{0, 1, 0}, {-1, 0, 0}, {0, 0, -1}},
                                               {{1, 0, 0}, {0, 1, 0}, {0, 0, -1}},
                                               {{0, 0, 1}, {0, 1, 0}, {1, 0, 0}},
                                               {{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                               {{0, 0, -1}, {0, -1, 0}, {1, 0, 0}}}};
  Mesh m;
  for (const Side& side : kSides) {
    const auto base = std::uint32_t(m.positions.size());
    for (const Vec2f uv : {Vec2f{0, 0}, Vec2f{0, 1}, Vec2f{1, 1}, Vec2f{1, 0}}) {
      m.positions.push_back(side.n + side.s * (2 * uv.x - 1) + side.t * (2 * uv.y - 1));
      m.uvs.push_back(uv);
    }
    // s x t points inwards or outwards, depending on the side
    const bool outwards = dot(cross(side.s, side.t), side.n) > 0;
    for (const std::uint32_t i : {0u, 1u, 2u, 0u, 2u, 3u}) m.indices.push_back(base + (outwards ? (4 - i) % 4 : i));
  }
  return m;
}

/// What happens to a mesh from a file, in Mitsuba's order: place it, then make up missing normals from the placed
/// vertices.
struct MeshOptions {
  Affine3d bake;
  bool flip_v = false;
  bool face_normals = false;
  bool flip_normals = false;
  double max_smooth_angle = -1;  // degrees; negative: no creases
};

void finish_mesh(Mesh& mesh, const MeshOptions& options) {
  if (options.flip_v)
    for (Vec2f& uv : mesh.uvs) uv.y = 1 - uv.y;
  if (options.face_normals || options.max_smooth_angle >= 0) mesh.normals.clear();
  const bool own_normals = !mesh.normals.empty();
  if (options.bake != Affine3d{}) {
    const Affine3d inv = inverse(options.bake);
    for (Vec3f& p : mesh.positions) p = Vec3f(options.bake.point(Vec3d(p)));
    for (Vec3f& n : mesh.normals) n = Vec3f(normalize(inv.transposed_vector(Vec3d(n))));
  }
  if (options.max_smooth_angle >= 0)
    crease_normals(mesh, float(options.max_smooth_angle * kPiD / 180));
  else if (!options.face_normals)
    fill_normals(mesh);
  // Mitsuba takes the side of the shading normal for the front, whatever the winding says.
  if (own_normals) align_winding(mesh);
  mesh.flip_normals = options.flip_normals;
}

}  // namespace

std::string Builder::unique_name(const std::string& name) {
  std::string unique = name;
  for (int& n = names_[name]; !taken_names_.insert(unique).second;) unique = fmt::format("{}_{}", name, ++n);
  return unique;
}

std::shared_ptr<const FileContents> Builder::shared_contents(const std::filesystem::path& path, const SourceLoc& loc) {
  auto& contents = contents_[path];
  if (!contents) contents = std::make_shared<const FileContents>(files_.read(path, loc));
  return contents;
}

void Builder::warn_about_media(const Object& shape) {
  for (const Object* medium : children(shape, "medium"))
    warn(fmt::format("{} inside a shape is ignored: participating media are not rendered", medium->name()),
         medium->place);
}

void Builder::mesh_file(const Object& object, const Affine3d& bake, Shape& shape) {
  const bool is_obj = object.plugin == "obj";
  MeshOptions options;
  options.bake = bake;
  options.flip_normals = flips_normals(object);
  options.face_normals = boolean(object, "face_normals", false);
  options.flip_v = boolean(object, "flip_tex_coords", is_obj);
  if (has(object, "max_smooth_angle")) options.max_smooth_angle = number(object, "max_smooth_angle", 0, 0, 180);
  ignore(object, {"collapse", "srgb"});
  const std::filesystem::path path = file(object, "filename");
  const SourceLoc loc = document_.loc(place(object, "filename"));
  std::function<Mesh()> read;
  if (object.plugin == "serialized") {
    const int shape_index = integer(object, "shape_index", 0, 0, 1 << 30);
    read = [contents = shared_contents(path, loc), path, shape_index, limit = files_.memory_limit()] {
      return read_serialized(contents->view(), path.string(), shape_index, limit);
    };
    if (shape.name.empty()) shape.name = fmt::format("{}_{}", path.stem().string(), shape_index);
  } else {
    if (shape.name.empty()) shape.name = path.stem().string();
    read = [this, path, loc, is_obj] {
      const FileContents contents = files_.read(path, loc);
      return (is_obj ? read_obj : read_ply)(contents.view(), path.string(), warnings_);
    };
  }
  jobs_.push_back({int(scene_.shapes.size()), &object, [read = std::move(read), options] {
                     Mesh mesh = read();
                     finish_mesh(mesh, options);
                     return mesh;
                   }});
}

void Builder::rectangle_or_cube(const Object& object, const Affine3d& bake, Shape& shape) {
  Mesh mesh = object.plugin == "cube" ? textured_cube() : make_rectangle();
  tempera::transform(mesh, bake);
  mesh.flip_normals = flips_normals(object);
  shape.geometry = std::move(mesh);
}

void Builder::sphere(const Object& object, const Affine3d& bake, Shape& shape) {
  const double radius = number(object, "radius", 1, 1e-30);
  const Affine3d map = bake * translate(vector3(object, "center", {})) * scale(Vec3d{radius, radius, radius});
  const bool inside_out = map.determinant() < 0;  // as a mirrored sphere is
  shape.geometry = Sphere{Affine3f(map), flips_normals(object) != inside_out};
}

void Builder::disk(const Object& object, const Affine3d& bake, Shape& shape) {
  shape.geometry = Disk{Affine3f(bake), flips_normals(object)};
}

void Builder::cylinder(const Object& object, const Affine3d& bake, Shape& shape) {
  const Vec3d p0 = vector3(object, "p0", {0, 0, 0}), p1 = vector3(object, "p1", {0, 0, 1});
  const double radius = number(object, "radius", 1, 1e-30), height = length(p1 - p0);
  if (height == 0) fail(ErrorCode::kOutOfRange, object.place, "the end points p0 and p1 of a cylinder must differ");
  const Basis frame{Vec3f((p1 - p0) / height)};
  const Affine3d along{Vec3d(frame.s) * radius, Vec3d(frame.t) * radius, p1 - p0, p0};
  shape.geometry = Cylinder{Affine3f(bake * along), flips_normals(object)};
}

int Builder::make_shape(const Object& object, const Affine3d& to_world) {
  static constexpr Named<void (Builder::*)(const Object&, const Affine3d&, Shape&)> kPlugins[] = {
      {"obj", &Builder::mesh_file},
      {"ply", &Builder::mesh_file},
      {"serialized", &Builder::mesh_file},
      {"rectangle", &Builder::rectangle_or_cube},
      {"cube", &Builder::rectangle_or_cube},
      {"sphere", &Builder::sphere},
      {"disk", &Builder::disk},
      {"cylinder", &Builder::cylinder},
  };
  for (const Vec3d& v : {to_world.x, to_world.y, to_world.z, to_world.translation})
    if (!(length(v) < 1e30))
      fail(ErrorCode::kOutOfRange, place(object, "to_world"), "the transform of a shape is too large");
  const std::optional<Affine3d> placed = with_thickness(to_world);
  const Affine3d bake = placed.value_or(Affine3d{});
  Shape shape;
  const Object* emitter = child(object, "emitter");
  const NamedMaterial bsdf = shape_material(object, emitter != nullptr);
  shape.material = bsdf.material;
  shape.material_name = bsdf.name;
  shape.name = object.id;
  if (emitter) {
    if (emitter->plugin == "area")
      shape.emission = area_emission(*emitter);
    else
      warn(fmt::format("{} on a shape is ignored", emitter->name()), emitter->place);
  }
  warn_about_media(object);
  ignore(object, {"silhouette_sampling_weight"});

  const int index = int(scene_.shapes.size());
  const auto* plugin = find_named(kPlugins, object.plugin);
  if (!plugin) {
    ignore_all(object);
    warn(fmt::format("{} is left out", object.name()), object.place);
    return -1;
  }
  (this->*plugin->value)(object, bake, shape);
  if (!placed) {  // scaled to a line or a point: nothing of it is seen
    if (!jobs_.empty() && jobs_.back().shape == index) jobs_.pop_back();
    shape.geometry = Mesh{};
  }
  if (shape.name.empty()) shape.name = fmt::format("{}_{}", object.plugin, index);
  shape.name = unique_name(shape.name);
  scene_.shapes.push_back(std::move(shape));
  finish(object);
  return index;
}

void Builder::add_shape(const Object& object) {
  if (object.plugin == "shapegroup") return add_shape_group(object);
  if (object.plugin == "instance") return add_instance(object);
  if (object.plugin == "merge") {
    for (const Object* nested : children(object, "shape")) add_shape(*nested);
    return finish(object);
  }
  const Transform to_world = transform(object, "to_world");
  const bool moves = to_world.keys.size() > 1;
  const int shape = make_shape(object, moves ? Affine3d{} : to_world.constant);
  if (shape < 0) return;
  Instance instance;
  instance.group = int(scene_.groups.size());
  instance.name = scene_.shapes[shape].name;
  if (moves) instance.node = add_node(to_world, place(object, "to_world"), instance.name);
  scene_.groups.push_back({shape});
  scene_.instances.push_back(std::move(instance));
}

void Builder::add_shape_group(const Object& object) {
  if (groups_.contains(&object)) return;
  std::vector<int> group;
  for (const Object* nested : children(object, "shape")) {
    if (nested->plugin == "instance" || nested->plugin == "shapegroup")
      fail(ErrorCode::kBadInput, nested->place, fmt::format("a shapegroup cannot hold {}", nested->name()));
    const Transform to_world = transform(*nested, "to_world");
    if (!to_world.keys.empty())
      warn("an animated transform inside a shapegroup keeps its first key", place(*nested, "to_world"));
    const int shape = make_shape(*nested, to_world.constant);
    if (shape >= 0) group.push_back(shape);
  }
  finish(object);
  groups_[&object] = group.empty() ? -1 : int(scene_.groups.size());
  if (!group.empty()) scene_.groups.push_back(std::move(group));
}

void Builder::add_instance(const Object& object) {
  const Object* group = child(object, "shape");
  if (!group || group->plugin != "shapegroup")
    fail(ErrorCode::kBadInput, object.place, "an instance needs a reference to one shapegroup");
  add_shape_group(*group);
  Instance instance;
  instance.group = groups_.at(group);
  instance.name = unique_name(!object.id.empty() ? object.id : !group->id.empty() ? group->id : "instance");
  const Transform to_world = transform(object, "to_world");
  instance.node = add_node(to_world, place(object, "to_world"), instance.name);
  finish(object);
  if (instance.group >= 0) scene_.instances.push_back(std::move(instance));
}

namespace {
/// Whether there was something to repair.
bool repair_colors(Mesh& mesh) {
  bool repaired = false;
  const auto repair = [&](float& v) {
    if (v >= 0 && std::isfinite(v)) return;
    v = 0;
    repaired = true;
  };
  for (Rgb& c : mesh.colors) repair(c.r), repair(c.g), repair(c.b);
  for (float& a : mesh.color_alphas) repair(a);
  return repaired;
}
}  // namespace

void Builder::read_meshes() {
  std::vector<std::optional<Error>> failed(jobs_.size());
  parallel_for(0, std::int64_t(jobs_.size()), [&](std::int64_t i) {
    MeshJob& job = jobs_[i];
    const Place& at = place(*job.object, "filename");
    try {
      Mesh mesh = job.read();
      files_.charge(bytes_of(mesh), document_.loc(at));
      if (repair_colors(mesh))
        warn("vertex or face colors that are negative, infinite or not a number are read as 0", at);
      if (mesh.indices.empty()) warn("a mesh file without triangles is left out", at);
      scene_.shapes[job.shape].geometry = std::move(mesh);
    } catch (const Error& e) {
      failed[i] = e;
    } catch (const std::bad_alloc&) {
      failed[i] = Error(ErrorCode::kOutOfMemory, document_.loc(at), "not enough memory for this mesh");
    }
    job.read = nullptr;  // frees what it holds
  });
  for (const std::optional<Error>& e : failed)
    if (e) errors_.push_back(*e);
  contents_.clear();
}

}  // namespace tempera::mitsuba
