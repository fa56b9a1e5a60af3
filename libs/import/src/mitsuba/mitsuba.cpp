// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/mitsuba.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "catalog.h"
#include "mitsuba_build.h"
#include "singular.h"

namespace tempera {
namespace mitsuba {
namespace {

constexpr std::size_t kMaxReportedErrors = 20;

/// Rotation, translation and scale of an affine map with orthogonal columns; the axes are made orthogonal if they are
/// not.
struct Parts {
  Vec3d translation, scale;
  Quatd rotation;
  bool sheared = false;
};

/// What has no volume leaves its rotation open, or a part of it, and whether it is a mirror image: there it follows
/// `neighbor`.
Parts decompose(const Affine3d& m, const Parts& neighbor) {
  Parts parts;
  parts.translation = m.translation;
  parts.scale = {length(m.x), length(m.y), length(m.z)};
  const bool singular = is_singular(m), mirrored = singular ? neighbor.scale.x < 0 : m.determinant() < 0;
  parts.rotation = closest_rotation(m, mirrored, neighbor.rotation);
  if (mirrored) parts.scale = -parts.scale;  // a mirror image has no rotation: point reflection times one
  const auto bent = [](const Vec3d& a, const Vec3d& b) { return std::abs(dot(a, b)) > 1e-4 * length(a) * length(b); };
  parts.sheared = bent(m.x, m.y) || bent(m.y, m.z) || bent(m.z, m.x);
  return parts;
}

}  // namespace

Error combine(const std::vector<Error>& errors) {
  if (errors.size() == 1) return errors.front();
  std::string message = errors.front().message();
  for (std::size_t i = 1; i < errors.size() && i < kMaxReportedErrors; ++i)
    message += std::string("\n") + errors[i].what();
  if (errors.size() > kMaxReportedErrors)
    message += fmt::format("\nand {} more errors", errors.size() - kMaxReportedErrors);
  return Error(errors.front().code(), errors.front().loc(), message);
}

// --- properties ------------------------------------------------------------------------------------------------------

const Property* Builder::find(const Object& object, std::string_view name) const {
  for (const Property& p : object.properties) {
    if (p.name == name) {
      p.used = true;
      return &p;
    }
  }
  return nullptr;
}

bool Builder::has(const Object& object, std::string_view name) const {
  return std::any_of(object.properties.begin(), object.properties.end(),
                     [&](const Property& p) { return p.name == name; });
}

const Place& Builder::place(const Object& object, std::string_view name) const {
  for (const Property& p : object.properties)
    if (p.name == name) return p.place;
  return object.place;
}

void Builder::wrong_type(const Property& property, std::string_view expected) const {
  static constexpr std::array kTypes{"a boolean",         "an integer", "a number",   "a string",
                                     "a point or vector", "a color",    "a spectrum", "a blackbody",
                                     "a transform",       "an object",  "a reference"};
  fail(ErrorCode::kBadInput, property.place,
       fmt::format("\"{}\" is {}; expected {}", property.name, kTypes[property.value.index()], expected));
}

double Builder::number(const Object& object, std::string_view name, double fallback, double min, double max) const {
  const Property* p = find(object, name);
  if (!p) return fallback;
  double v;
  if (const auto* d = std::get_if<double>(&p->value))
    v = *d;
  else if (const auto* i = std::get_if<std::int64_t>(&p->value))
    v = double(*i);
  else
    wrong_type(*p, "a number");
  if (v < min || v > max) {
    const std::string range = max >= 1e300    ? fmt::format("at least {}", min)
                              : min <= -1e300 ? fmt::format("at most {}", max)
                                              : fmt::format("between {} and {}", min, max);
    fail(ErrorCode::kOutOfRange, p->place, fmt::format("\"{}\" is {}; it must be {}", name, v, range));
  }
  return v;
}

int Builder::integer(const Object& object, std::string_view name, int fallback, int min, int max) const {
  const Property* p = find(object, name);
  if (!p) return fallback;
  const auto* i = std::get_if<std::int64_t>(&p->value);
  if (!i) wrong_type(*p, "an integer");
  if (*i < min || *i > max)
    fail(ErrorCode::kOutOfRange, p->place,
         fmt::format("\"{}\" is {}; it must be between {} and {}", name, *i, min, max));
  return int(*i);
}

bool Builder::boolean(const Object& object, std::string_view name, bool fallback) const {
  const Property* p = find(object, name);
  if (!p) return fallback;
  const auto* b = std::get_if<bool>(&p->value);
  if (!b) wrong_type(*p, "true or false");
  return *b;
}

std::string Builder::text(const Object& object, std::string_view name, std::string_view fallback) const {
  const Property* p = find(object, name);
  if (!p) return std::string(fallback);
  const auto* s = std::get_if<std::string>(&p->value);
  if (!s) wrong_type(*p, "a string");
  return *s;
}

Vec3d Builder::vector3(const Object& object, std::string_view name, const Vec3d& fallback) const {
  const Property* p = find(object, name);
  if (!p) return fallback;
  const auto* v = std::get_if<Vec3d>(&p->value);
  if (!v) wrong_type(*p, "a point or vector");
  return *v;
}

Transform Builder::transform(const Object& object, std::string_view name) const {
  const Property* p = find(object, name);
  if (!p) return {};
  const auto* t = std::get_if<Transform>(&p->value);
  if (!t) wrong_type(*p, "a transform");
  return *t;
}

std::filesystem::path Builder::file(const Object& object, std::string_view name) const {
  const Property* p = find(object, name);
  if (!p) fail(ErrorCode::kBadInput, object.place, fmt::format("{} needs the string \"{}\"", object.name(), name));
  const auto* s = std::get_if<std::string>(&p->value);
  if (!s) wrong_type(*p, "a file name");
  std::filesystem::path path = document_.find_file(*s, p->place);
  files_.check(path, document_.loc(p->place));
  return path;
}

std::vector<const Object*> Builder::children(const Object& object, std::string_view tag) const {
  std::vector<const Object*> result;
  for (const Property& p : object.properties) {
    if (!std::holds_alternative<ObjectPtr>(p.value) && !std::holds_alternative<Reference>(p.value)) continue;
    const Object& child = document_.resolve(p);
    if (child.tag != tag) continue;
    p.used = true;
    result.push_back(&child);
  }
  return result;
}

const Object* Builder::child(const Object& object, std::string_view tag) const {
  const std::vector<const Object*> all = children(object, tag);
  if (all.size() > 1)
    fail(ErrorCode::kBadInput, all[1]->place, fmt::format("{} takes one {} only", object.name(), tag));
  return all.empty() ? nullptr : all.front();
}

const Object* Builder::named_child(const Object& object, std::string_view name) const {
  for (const Property& p : object.properties) {
    if (p.name != name) continue;
    if (!std::holds_alternative<ObjectPtr>(p.value) && !std::holds_alternative<Reference>(p.value)) return nullptr;
    p.used = true;
    return &document_.resolve(p);
  }
  return nullptr;
}

void Builder::ignore(const Object& object, std::initializer_list<std::string_view> names) const {
  for (std::string_view name : names) find(object, name);
}

void Builder::ignore_all(const Object& object) const {
  for (const Property& p : object.properties) p.used = true;
}

void Builder::finish(const Object& object) const {
  for (const Property& p : object.properties) {
    if (p.used) continue;
    p.used = true;  // once for objects that several others use
    if (std::holds_alternative<ObjectPtr>(p.value) || std::holds_alternative<Reference>(p.value)) {
      warn(fmt::format("{} inside {} is ignored", document_.resolve(p).name(), object.name()), p.place);
    } else {
      warn(fmt::format("parameter \"{}\" of {} is ignored", p.name, object.name()), p.place);
    }
  }
}

// --- transforms ------------------------------------------------------------------------------------------------------

AnimatedTransform Builder::animated(const Transform& transform, const Place& place) {
  if (transform.keys.size() < 2) return transform.constant;
  AnimatedTransform result;
  result.keyed = true;
  std::vector<double> times;
  std::vector<Vec3d> translations, scales;
  std::vector<Quatd> rotations;
  Parts neighbor;  // the key before, or for the first ones the first that tells all
  for (const auto& [time, map] : transform.keys) {
    if (is_singular(map)) continue;
    neighbor = decompose(map, {});
    break;
  }
  for (const auto& [time, map] : transform.keys) {
    const Parts parts = decompose(map, neighbor);
    neighbor.rotation = parts.rotation;
    if (!is_singular(map)) neighbor.scale = parts.scale;
    if (parts.sheared) warn("the shear in an animated transform is dropped", place);
    times.push_back(time);
    translations.push_back(parts.translation);
    rotations.push_back(parts.rotation);
    scales.push_back(parts.scale);
  }
  result.translation = {times, std::move(translations), Interpolation::kLinear};
  result.rotation = {times, std::move(rotations), Interpolation::kLinear};
  result.scale = {times, std::move(scales), Interpolation::kLinear};
  scene_.animation.begin = animated_ ? std::min(scene_.animation.begin, times.front()) : times.front();
  scene_.animation.end = animated_ ? std::max(scene_.animation.end, times.back()) : times.back();
  animated_ = true;
  return result;
}

int Builder::add_node(const Transform& transform, const Place& place, const std::string& name) {
  if (transform.keys.size() < 2 && transform.constant == Affine3d{}) return -1;
  Node node;
  node.local = animated(transform, place);
  node.name = name;
  scene_.nodes.push_back(std::move(node));
  return int(scene_.nodes.size()) - 1;
}

// --- the scene -------------------------------------------------------------------------------------------------------

Scene Builder::build(const std::filesystem::path& source) {
  scene_.source = source;
  // The last ones are built where they are referred to.
  static constexpr Named<void (Builder::*)(const Object&)> kTags[] = {{"shape", &Builder::add_shape},
                                                                      {"sensor", &Builder::add_sensor},
                                                                      {"emitter", &Builder::add_emitter},
                                                                      {"integrator", &Builder::add_integrator},
                                                                      {"bsdf", nullptr},
                                                                      {"texture", nullptr},
                                                                      {"spectrum", nullptr},
                                                                      {"medium", nullptr}};
  // Mitsuba counts passing through a mask as an interaction.
  scene_.defaults.null_counts_as_bounce = true;
  for (const Property& p : document_.scene().properties) {
    if (!std::holds_alternative<ObjectPtr>(p.value) && !std::holds_alternative<Reference>(p.value)) continue;
    const Object& object = document_.resolve(p);
    const auto* tag = find_named(kTags, object.tag);
    p.used = tag != nullptr;
    if (!tag || !tag->value) continue;
    try {
      (this->*tag->value)(object);
    } catch (const Error& e) {
      errors_.push_back(e);
    }
  }
  finish(document_.scene());
  read_meshes();
  if (!errors_.empty()) throw combine(errors_);
  scene_.content_hash = files_.hash();
  return std::move(scene_);
}

}  // namespace mitsuba

Scene import_mitsuba(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings) {
  InputFiles files(file, options);
  const mitsuba::Document document(file, options.defines, files, warnings);
  return mitsuba::Builder(document, files, warnings).build(file);
}

namespace {
constexpr std::array<std::string_view, 1> kExtensions{".xml"};
}
const ImporterEntry mitsuba_importer{"mitsuba", "Mitsuba XML scenes, 0.6 and 3", kExtensions, import_mitsuba};

}  // namespace tempera
