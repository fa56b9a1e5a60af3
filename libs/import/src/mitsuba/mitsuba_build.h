// SPDX-License-Identifier: Apache-2.0
#pragma once
// Builds a Scene from Mitsuba's objects. One file per kind of object: mitsuba_shapes.cpp, mitsuba_materials.cpp,
// mitsuba_textures.cpp, mitsuba_lights.cpp, mitsuba_sensors.cpp; mitsuba.cpp holds the frame.
#include <fmt/format.h>

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "input_files.h"
#include "mitsuba_xml.h"
#include "named.h"
#include "tempera/core/log.h"
#include "tempera/scene/scene.h"

namespace tempera {
struct MaterialEntry;
}

namespace tempera::mitsuba {

/// What a spectrum describes, which decides how it becomes RGB.
enum class SpectrumKind {
  kReflectance,  ///< seen under daylight, in [0,1]
  kUnbounded,    ///< the same without an upper bound: indices of refraction, roughness
  kEmission,     ///< emitted light
  kHeight,       ///< of bump maps: one number of any sign
  kScalar,       ///< one number: opacity, roughness, weights
};

/// The geometry of one shape, to be read from its file once all objects are known: many at a time.
struct MeshJob {
  int shape = 0;  ///< Scene::shapes index
  const Object* object = nullptr;
  std::function<Mesh()> read;
};

class Builder {
 public:
  Builder(const Document& document, InputFiles& files, Warnings& warnings)
      : document_(document), files_(files), warnings_(warnings) {}
  /// The whole scene. Errors of independent objects are reported together, at the place of the first.
  Scene build(const std::filesystem::path& source);

 private:
  // --- properties of an object (mitsuba.cpp) ---
  const Property* find(const Object& object, std::string_view name) const;  // marks it as used
  bool has(const Object& object, std::string_view name) const;              // does not
  double number(const Object& object, std::string_view name, double fallback, double min = -1e300,
                double max = 1e300) const;
  int integer(const Object& object, std::string_view name, int fallback, int min, int max) const;
  bool boolean(const Object& object, std::string_view name, bool fallback) const;
  std::string text(const Object& object, std::string_view name, std::string_view fallback) const;
  /// The entry of the table that a string names, upper case or lower.
  template <class T, std::size_t N>
  const Named<T>& choice(const Object& object, std::string_view name, std::string_view fallback,
                         const Named<T> (&table)[N]) const {
    const std::string value = lower_case(text(object, name, fallback));
    const Named<T>* entry = find_named(table, value);
    if (!entry)
      fail(ErrorCode::kUnknownName, place(object, name),
           fmt::format("\"{}\" is no value of \"{}\"; known: {}", value, name, names_of(table)));
    return *entry;
  }
  Vec3d vector3(const Object& object, std::string_view name, const Vec3d& fallback) const;
  Transform transform(const Object& object, std::string_view name) const;
  std::filesystem::path file(const Object& object, std::string_view name) const;  // required
  /// Nested objects and references of one kind (tag), in the order of the file; marks them as used.
  std::vector<const Object*> children(const Object& object, std::string_view tag) const;
  const Object* child(const Object& object, std::string_view tag) const;         // at most one, else nullptr
  const Object* named_child(const Object& object, std::string_view name) const;  // object-valued property or nullptr
  void ignore(const Object& object, std::initializer_list<std::string_view> names) const;
  void ignore_all(const Object& object) const;
  /// Warns of each property that nothing asked for. Call when `object` is built.
  void finish(const Object& object) const;
  void warn(const std::string& what, const Place& place) const { warnings_.add(what, document_.loc(place)); }
  void warn_replaced(const Object& object, std::string_view by) const {
    warn(fmt::format("{} is replaced by {}", object.name(), by), object.place);
  }
  [[noreturn]] void fail(ErrorCode code, const Place& place, const std::string& message) const {
    throw Error(code, document_.loc(place), message);
  }
  [[noreturn]] void wrong_type(const Property& property, std::string_view expected) const;
  const Place& place(const Object& object, std::string_view name) const;  // of the property, else of the object

  // --- transforms (mitsuba.cpp) ---
  /// Index of a new root node with this pose; -1 for the identity.
  int add_node(const Transform& transform, const Place& place, const std::string& name);
  AnimatedTransform animated(const Transform& transform, const Place& place);

  // --- spectra and textures (mitsuba_textures.cpp) ---
  Rgb color(const Property& property, SpectrumKind kind) const;
  /// A constant or a texture.
  Slot slot(const Object& object, std::string_view name, Slot fallback, SpectrumKind kind = SpectrumKind::kReflectance);
  Slot texture_slot(const Object& texture, SpectrumKind kind);
  Slot make_texture_slot(const Object& texture, SpectrumKind kind);
  // What the plugins come to; make_texture_slot has the table.
  Slot bitmap_texture(const Object& texture, SpectrumKind kind);
  Slot checkerboard_texture(const Object& texture, SpectrumKind kind);
  Slot scale_texture(const Object& texture, SpectrumKind kind);
  Slot vertex_color_texture(const Object& texture, SpectrumKind kind);
  Slot uniform_spectrum(const Object& texture, SpectrumKind kind);
  Slot srgb_spectrum(const Object& texture, SpectrumKind kind);
  Slot daylight_spectrum(const Object& texture, SpectrumKind kind);
  Slot blackbody_spectrum(const Object& texture, SpectrumKind kind);
  Slot sampled_spectrum(const Object& texture, SpectrumKind kind);
  UvTransform uv_transform(const Object& texture) const;
  /// A value that we take as constant only: textures are replaced by their mean, with a warning.
  Rgb constant(const Object& object, std::string_view name, const Rgb& fallback, SpectrumKind kind);

  // --- materials (mitsuba_materials.cpp) ---
  struct NamedMaterial {
    MaterialPtr material;
    std::string name;
  };
  MaterialPtr material(const Object& bsdf);
  MaterialPtr make_material(const Object& bsdf);
  /// A type of material_catalog() that is no plugin of Mitsuba's, by its name and parameters.
  MaterialPtr catalog_material(const Object& bsdf, const MaterialEntry& entry);
  // What the plugins come to; make_material has the table.
  MaterialPtr diffuse_bsdf(const Object& bsdf);
  MaterialPtr conductor_bsdf(const Object& bsdf);
  MaterialPtr dielectric_bsdf(const Object& bsdf);
  MaterialPtr plastic_bsdf(const Object& bsdf);
  MaterialPtr principled_bsdf(const Object& bsdf);
  MaterialPtr two_sided_bsdf(const Object& bsdf);
  MaterialPtr blend_bsdf(const Object& bsdf);
  MaterialPtr mixture_bsdf(const Object& bsdf);
  MaterialPtr mask_bsdf(const Object& bsdf);
  MaterialPtr null_bsdf(const Object& bsdf);
  MaterialPtr bump_bsdf(const Object& bsdf);
  MaterialPtr coating_bsdf(const Object& bsdf);
  MaterialPtr phong_bsdf(const Object& bsdf);
  MaterialPtr diffuse_transmitter_bsdf(const Object& bsdf);
  NamedMaterial shape_material(const Object& shape, bool emits);
  float index_of_refraction(const Object& bsdf, std::string_view name, std::string_view fallback) const;
  Roughness roughness(const Object& bsdf);
  void conductor_indices(const Object& bsdf, Slot& eta, Slot& k);
  MaterialPtr nested_material(const Object& bsdf);

  // --- shapes (mitsuba_shapes.cpp) ---
  void add_shape(const Object& shape);
  /// Appends to Scene::shapes; `to_world` is applied to the geometry.
  int make_shape(const Object& shape, const Affine3d& to_world);
  // What the plugins come to, made of an object into `shape`; make_shape has the table. `bake`: from object space.
  void mesh_file(const Object& object, const Affine3d& bake, Shape& shape);
  void rectangle_or_cube(const Object& object, const Affine3d& bake, Shape& shape);
  void sphere(const Object& object, const Affine3d& bake, Shape& shape);
  void disk(const Object& object, const Affine3d& bake, Shape& shape);
  void cylinder(const Object& object, const Affine3d& bake, Shape& shape);
  bool flips_normals(const Object& object) const { return boolean(object, "flip_normals", false); }
  void add_shape_group(const Object& group);
  void add_instance(const Object& instance);
  void warn_about_media(const Object& shape);
  std::string unique_name(const std::string& name);  // `name`, or with a number behind it
  std::shared_ptr<const FileContents> shared_contents(const std::filesystem::path& path, const SourceLoc& loc);
  void read_meshes();

  // --- lights (mitsuba_lights.cpp) ---
  void add_emitter(const Object& emitter);
  // What the plugins come to; add_emitter has the table.
  void note_area_emitter(const Object& emitter);
  void add_point(const Object& emitter);
  void add_spot(const Object& emitter);
  void add_directional(const Object& emitter);
  void add_projector(const Object& emitter);
  void add_light(const Object& emitter, PunctualLight light, const Transform& to_world);
  /// Whether an emitter has the property, which excludes a to_world.
  bool in_place_of_to_world(const Object& emitter, std::string_view name) const;
  AreaEmission area_emission(const Object& emitter);
  void add_environment(const Object& emitter);
  void add_sun_sky(const Object& emitter);
  Transform rotation_only(Transform transform, const Place& place) const;
  Vec2i image_size(const std::filesystem::path& path, const Place& place) const;

  // --- sensors, film, integrator (mitsuba_sensors.cpp) ---
  void add_sensor(const Object& sensor);
  void film_defaults(const Object& film, int width, int height, bool first);
  void add_integrator(const Object& integrator);
  /// Radians; `vertical` tells whether the file gave the vertical angle.
  double horizontal_fov(const Object& object, double aspect, bool& vertical) const;

  const Document& document_;
  InputFiles& files_;
  Warnings& warnings_;
  Scene scene_;
  std::map<const Object*, MaterialPtr> materials_;
  std::set<const Object*> in_construction_;  // cycles of references
  std::map<std::string, int> names_;         // the last number given to a name
  std::set<std::string> taken_names_;
  std::map<const Object*, int> groups_;  // shape groups -> Scene::groups index
  std::vector<MeshJob> jobs_;
  std::map<std::filesystem::path, std::shared_ptr<const FileContents>> contents_;
  std::vector<Error> errors_;
  bool animated_ = false;
};

/// An error for several independent ones: the first with the others in its message.
Error combine(const std::vector<Error>& errors);

}  // namespace tempera::mitsuba
