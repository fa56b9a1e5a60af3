// SPDX-License-Identifier: Apache-2.0
#pragma once
// Mitsuba's XML as a tree of objects with typed properties, each with its place: names in snake_case whatever the
// dialect, parameters substituted, files included, nothing yet built. What the properties mean is the builder's
// business.
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "input_files.h"
#include "mitsuba_text.h"
#include "tempera/core/log.h"
#include "tempera/core/vec.h"

namespace tempera::mitsuba {

struct Object;
using ObjectPtr = std::shared_ptr<const Object>;

/// A position in one of the files that were read.
struct Place {
  int file = 0;            ///< Document::files index
  std::size_t offset = 0;  ///< bytes
};

struct Color {
  Vec3d rgb;  ///< linear
};

/// Samples over wavelengths, or one value at all of them.
struct Spectrum {
  std::vector<double> wavelengths;  ///< nm, strictly increasing; empty: uniform
  std::vector<double> values;       ///< as many, or one
};

struct Blackbody {
  double temperature = 0;  ///< K
  double scale = 1;
};

/// Constant, or keyed if `keys` is not empty (times in seconds, in order; two keys at one time: the value before it and
/// from then on).
struct Transform {
  Affine3d constant;
  std::vector<std::pair<double, Affine3d>> keys;
};

struct Reference {
  std::string id;
};

using Value = std::variant<bool, std::int64_t, double, std::string, Vec3d, Color, Spectrum, Blackbody, Transform,
                           ObjectPtr, Reference>;

struct Property {
  std::string name;  ///< snake_case; empty for objects without a name
  Value value;
  Place place;
  mutable bool used = false;  ///< asked for by the builder
};

/// <bsdf type="diffuse" id="wall">: tag, plugin, id.
struct Object {
  std::string tag, plugin, id;
  Place place;
  std::vector<Property> properties;  ///< in the order of the file, nested objects and references among them
  std::string name() const;          ///< e.g. bsdf "diffuse"
};

/// A scene file with all that it includes.
class Document {
 public:
  /// Reads `file`. `defines` are values of `$name` that override <default>s.
  /// Errors: Error{kSyntax} for malformed XML, Error{kBadInput} for wrong values or structure, Error{kUnknownName} for
  /// unknown elements, parameters and ids, Error{kMissingFile} for includes, each at its place.
  Document(const std::filesystem::path& file, const std::vector<std::pair<std::string, std::string>>& defines,
           InputFiles& inputs, Warnings& warnings);

  const Object& scene() const { return *scene_; }
  /// The object behind a nested object or a reference. Errors: Error{kUnknownName} for an id that nobody has.
  const Object& resolve(const Property& property) const;
  /// Whether some object refers to `id`.
  bool is_referenced(const std::string& id) const { return referenced_.contains(id); }
  /// Whether the file of `place` was written for Mitsuba 0.x.
  bool is_legacy(const Place& place) const { return files_[place.file].legacy; }
  SourceLoc loc(const Place& place) const;
  /// An existing file for `name`, looked for in the scene's search folders; else the first place looked at.
  std::filesystem::path find_file(const std::string& name, const Place& place) const;

 private:
  friend class Parser;
  struct File {
    std::filesystem::path path;
    std::vector<std::size_t> line_starts;
    bool legacy = false;
  };
  std::vector<File> files_;
  std::vector<std::filesystem::path> folders_;  // first has precedence
  std::map<std::string, ObjectPtr, std::less<>> ids_;
  std::map<std::string, Place, std::less<>> referenced_;
  ObjectPtr scene_;
};

}  // namespace tempera::mitsuba
