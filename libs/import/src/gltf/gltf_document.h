// SPDX-License-Identifier: Apache-2.0
#pragma once
// A glTF file's container, buffers and accessors: everything below the meaning of meshes and materials. What is read
// through this has been checked against the bytes that are there; nothing is allocated for more elements than a file
// can hold.
//
// Why not tiny_gltf, which Debian has: its errors carry no place, it uses indices of nodes, textures and buffer views
// without checking them, and it hands out extensions as untyped copies. Reading the JSON takes less code than checking
// behind it.
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "gltf_json.h"
#include "input_files.h"
#include "tempera/core/log.h"

namespace tempera {

/// Values of glTF's componentType.
enum class ComponentType : int {
  kByte = 5120,
  kUByte = 5121,
  kShort = 5122,
  kUShort = 5123,
  kUInt = 5125,
  kFloat = 5126
};

/// A typed view of a buffer, checked to lie inside it.
struct Accessor {
  Json json;
  ComponentType type = ComponentType::kFloat;
  std::string_view shape;  ///< "SCALAR", "VEC2", ... "MAT4"
  int components = 1;      ///< numbers per element
  std::size_t count = 0;   ///< elements
  bool normalized = false;
  int view = -1;                   ///< bufferView, -1: zeros
  std::size_t offset = 0;          ///< in the view
  std::optional<Error> error;      ///< why it cannot be read
  mutable bool asked_for = false;  ///< by whoever builds something of it

  bool is_float() const { return type == ComponentType::kFloat; }
  /// Float, or integers that stand for fractions.
  bool is_fraction() const { return is_float() || (normalized && type != ComponentType::kUInt); }
};

class GltfDocument {
 public:
  /// Reads the container, all buffers, and checks buffer views and accessors. A fault in one of these is an error for
  /// whoever uses it only: clips that no one asked for are none of a picture's business.
  /// Errors: Error{kSyntax | kBadInput | kOutOfRange | kUnsupported | kMissingFile | kOutOfMemory} at the offending
  /// place.
  GltfDocument(const std::filesystem::path& file, const ImportOptions& options, InputFiles& files, Warnings& warnings);
  GltfDocument(const GltfDocument&) = delete;

  Json root() const { return json_->root(); }
  /// A top-level array such as "nodes"; missing if there is none.
  Json list(std::string_view name) const { return root()[name].array(); }
  std::size_t count(std::string_view name) const { return list(name).size(); }

  /// The accessor that `index` (a value of the document) names. Errors: at `index`, unless it is one of `shapes`
  /// ("VEC3", or "VEC3|VEC4"), and for one that cannot be read.
  const Accessor& accessor(const Json& index, std::string_view shapes) const;
  /// All elements as floats, components interleaved; normalised integers become fractions.
  /// Errors: sparse indices out of order; memory.
  void read(const Accessor& accessor, float* out) const;
  void read(const Accessor& accessor, std::uint32_t* out) const;  ///< for integers that are not normalised
  std::vector<float> floats(const Accessor& accessor) const;
  std::string_view view_bytes(int index) const { return view(index).bytes; }

  /// Path of the file that a URI names. Errors: at `uri` for schemes other than relative paths.
  std::filesystem::path resolve(const Json& uri) const;
  /// Bytes of a data URI; nothing if `uri` is none. Errors: bad base64.
  static std::optional<std::string> decode_data_uri(const Json& uri);

  const std::filesystem::path& file() const { return file_; }
  InputFiles& files() const { return files_; }
  /// Version of Blender's exporter that wrote the file, as major * 100 + minor; 0: another program.
  int blender_version() const { return blender_version_; }
  void warn(const std::string& what, const Json& where) const { warn(what, where.loc()); }
  void warn(const std::string& what, const SourceLoc& where) const { warnings_.add(what, where); }
  /// Warns of accessors and buffer views that cannot be read and that nothing has asked for.
  void warn_of_unread() const;
  Warnings& warnings() const { return warnings_; }

 private:
  struct View {
    std::string_view bytes;
    std::size_t stride = 0;  ///< 0: tightly packed
    std::optional<Error> error;
    mutable bool asked_for = false;
  };
  void read_container(const ImportOptions& options);
  void check_asset();
  void check_extensions();
  void check_names();
  void read_buffers();
  void read_views();
  View read_view(const Json& json) const;
  void read_accessors();
  void read_accessor(const Json& json, Accessor& accessor) const;
  const View& view(int index) const;
  template <class T>
  void read_elements(const Accessor& accessor, T* out) const;
  template <class T>
  void read_plain(ComponentType type, bool normalized, std::size_t components, const View& view, std::size_t offset,
                  std::size_t count, T* out) const;

  std::filesystem::path file_;
  InputFiles& files_;
  Warnings& warnings_;
  FileContents contents_;
  std::optional<JsonDocument> json_;
  std::string_view bin_;  // the GLB's binary chunk
  bool has_bin_ = false;
  struct Buffer {
    FileContents file;
    std::string decoded;
    std::string_view bytes;
    std::string missing;  // why there are no bytes
  };
  std::vector<Buffer> buffers_;
  std::vector<View> views_;
  std::vector<Accessor> accessors_;
  std::uint64_t total_bytes_ = 0;
  int blender_version_ = 0;
};

}  // namespace tempera
