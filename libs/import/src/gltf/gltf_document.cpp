// SPDX-License-Identifier: Apache-2.0
#include "gltf_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>

#include "tempera/import/paths.h"

namespace tempera {
namespace {

// The file formats are little endian, and so is every machine that this program is built for.
static_assert(std::endian::native == std::endian::little);

std::uint32_t read_u32(std::string_view bytes, std::size_t offset) {
  std::uint32_t v;
  std::memcpy(&v, bytes.data() + offset, 4);
  return v;
}

struct Component {
  ComponentType type;
  int size;  ///< bytes
};
constexpr Component kComponents[] = {{ComponentType::kByte, 1},  {ComponentType::kUByte, 1},
                                     {ComponentType::kShort, 2}, {ComponentType::kUShort, 2},
                                     {ComponentType::kUInt, 4},  {ComponentType::kFloat, 4}};

std::size_t component_size(ComponentType type) {
  for (const Component& c : kComponents)
    if (c.type == type) return c.size;
  return 4;
}

struct ElementShape {
  int rows, columns;
};
constexpr Named<ElementShape> kShapes[] = {{"SCALAR", {1, 1}}, {"VEC2", {2, 1}}, {"VEC3", {3, 1}}, {"VEC4", {4, 1}},
                                           {"MAT2", {2, 2}},   {"MAT3", {3, 3}}, {"MAT4", {4, 4}}};

/// Bytes of an element: columns of matrices start at multiples of four bytes.
std::size_t element_size(const ElementShape& s, ComponentType type) {
  const std::size_t column = component_size(type) * s.rows;
  return s.columns == 1 ? column : (column + 3) / 4 * 4 * (s.columns - 1) + column;
}

ComponentType component_type(const Json& json) {
  const std::uint64_t v = json.required().integer(0);
  std::string valid;
  for (const Component& c : kComponents) {
    const auto number = static_cast<std::uint64_t>(c.type);
    if (number == v) return c.type;
    valid += fmt::format("{}{}", valid.empty() ? "" : ", ", number);
  }
  json.fail(fmt::format("{} is no component type; valid: {}", v, valid));
}

/// glTF 2.0, section 3.6.2.2: fractions of the largest magnitude; the most negative number is clamped.
template <class Source>
float to_fraction(Source v) {
  return std::max(float(v) / float(std::numeric_limits<Source>::max()), -1.0f);
}

template <class Source, class T>
void convert(const char* from, std::size_t stride, std::size_t count, std::size_t components, bool normalized, T* out) {
  for (std::size_t i = 0; i < count; ++i, from += stride) {
    for (std::size_t c = 0; c < components; ++c) {
      Source v;
      std::memcpy(&v, from + c * sizeof(Source), sizeof(Source));
      if constexpr (std::is_same_v<T, float> && !std::is_same_v<Source, float>) {
        *out++ = normalized ? to_fraction(v) : float(v);
      } else {
        *out++ = T(v);
      }
    }
  }
}

int hex_digit(char c) {
  return c >= '0' && c <= '9'   ? c - '0'
         : c >= 'a' && c <= 'f' ? c - 'a' + 10
         : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                : -1;
}

/// Replaces %XX. A percent sign without two hex digits stays.
std::string percent_decode(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    const int high = text[i] == '%' && i + 2 < text.size() ? hex_digit(text[i + 1]) : -1;
    const int low = high >= 0 ? hex_digit(text[i + 2]) : -1;
    if (low >= 0) {
      out += char(high * 16 + low);
      i += 2;
    } else {
      out += text[i];
    }
  }
  return out;
}

std::optional<std::string> base64_decode(std::string_view text) {
  while (!text.empty() && text.back() == '=') text.remove_suffix(1);
  if (text.size() % 4 == 1) return std::nullopt;
  std::string out;
  out.reserve(text.size() / 4 * 3 + 3);
  std::uint32_t bits = 0;
  int filled = 0;
  for (const char c : text) {
    int v;
    if (c >= 'A' && c <= 'Z')
      v = c - 'A';
    else if (c >= 'a' && c <= 'z')
      v = c - 'a' + 26;
    else if (c >= '0' && c <= '9')
      v = c - '0' + 52;
    else if (c == '+' || c == '-')
      v = 62;  // '-' and '_': the URL-safe alphabet, which some writers use
    else if (c == '/' || c == '_')
      v = 63;
    else
      return std::nullopt;
    bits = bits << 6 | std::uint32_t(v);
    filled += 6;
    if (filled >= 8) {
      filled -= 8;
      out += char(bits >> filled & 0xff);
    }
  }
  return out;
}

// Extensions whose absence would change the picture beyond what a warning says, and that are implemented.
constexpr std::string_view kSupported[] = {
    "EXT_mesh_gpu_instancing",         "EXT_texture_webp",
#ifdef TEMPERA_HAS_DRACO
    "KHR_draco_mesh_compression",
#endif
    "KHR_animation_pointer",           "KHR_lights_punctual", "KHR_materials_anisotropy", "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength", "KHR_materials_ior",   "KHR_materials_sheen",      "KHR_materials_specular",
    "KHR_materials_transmission",      "KHR_materials_unlit", "KHR_materials_variants",   "KHR_materials_volume",
    "KHR_mesh_quantization",           "KHR_node_visibility", "KHR_texture_transform",
};
// Extensions that change no picture, or whose use draws its own warning where it stands.
constexpr std::string_view kHarmless[] = {
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_texture_basisu",
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
};

bool contains(std::span<const std::string_view> names, std::string_view name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

GltfDocument::GltfDocument(const std::filesystem::path& file, const ImportOptions& options, InputFiles& files,
                           Warnings& warnings)
    : file_(file), files_(files), warnings_(warnings) {
  read_container(options);
  check_asset();
  check_extensions();
  check_names();
  read_buffers();
  read_views();
  read_accessors();
}

void GltfDocument::read_container(const ImportOptions& options) {
  const std::string name = file_.string();
  contents_ = files_.read(file_, {name});
  const std::string_view bytes = contents_.view();
  const auto fail = [&](std::size_t offset, const std::string& message) {
    throw Error(ErrorCode::kSyntax, locate(name, bytes, offset), fmt::format("{} (at byte {})", message, offset));
  };

  std::string extension = file_.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](char c) { return char(c | 0x20); });
  if (bytes.substr(0, 4) != "glTF") {
    if (extension == ".glb") fail(0, "not a binary glTF file: it does not start with \"glTF\"");
    json_.emplace(name, bytes, 0, bytes.size(), options.memory_limit);
    return;
  }

  constexpr std::uint32_t kJson = 0x4E4F534A, kBin = 0x004E4942;
  if (bytes.size() < 12) fail(bytes.size(), "ends within the 12 bytes of the header");
  const std::uint32_t version = read_u32(bytes, 4);
  if (version != 2) fail(4, fmt::format("binary glTF of version {}; version 2 is supported", version));
  const std::size_t length = read_u32(bytes, 8);
  if (length > bytes.size()) fail(8, fmt::format("says that it has {} bytes, but has {}", length, bytes.size()));
  if (length < 20) fail(8, fmt::format("says that it has {} bytes, too few for a JSON chunk", length));
  if (length < bytes.size())
    warnings_.add("bytes after the end of the binary glTF file are ignored", locate(name, bytes, length));

  std::size_t at = 12;
  for (int chunk = 0; at < length; ++chunk) {
    if (length - at < 8) fail(at, "ends within the 8 bytes of a chunk's header");
    const std::size_t size = read_u32(bytes, at);
    const std::uint32_t type = read_u32(bytes, at + 4);
    if (size % 4 != 0) fail(at, fmt::format("chunk of {} bytes; chunks are multiples of 4 bytes", size));
    if (size > length - at - 8) fail(at, fmt::format("chunk of {} bytes, but {} are left", size, length - at - 8));
    const std::size_t begin = at + 8;
    if (chunk == 0) {
      if (type != kJson) fail(at + 4, "the first chunk is not JSON");
      if (size == 0) fail(at, "the JSON chunk is empty");
      json_.emplace(name, bytes, begin, begin + size, options.memory_limit);
    } else if (type == kJson) {
      fail(at + 4, "a second JSON chunk");
    } else if (type == kBin) {
      if (has_bin_) fail(at + 4, "a second binary chunk");
      if (chunk != 1) fail(at + 4, "the binary chunk is not the second chunk");
      has_bin_ = true;
      bin_ = bytes.substr(begin, size);
    } else {
      warnings_.add("unknown chunk of a binary glTF file is ignored", locate(name, bytes, at));
    }
    at = begin + size;
  }
}

void GltfDocument::check_asset() {
  const Json asset = root()["asset"].required().object();
  const Json version = asset["version"].required();
  const auto parse = [](const Json& json) {
    int major = -1, minor = -1, used = 0;
    const std::string text(json.string());
    if (std::sscanf(text.c_str(), "%5d.%5d%n", &major, &minor, &used) != 2 || used != std::ssize(text) || major < 0 ||
        minor < 0)
      json.fail(fmt::format("\"{}\" is no version of the form \"2.0\"", text));
    return std::pair(major, minor);
  };
  if (parse(version).first != 2)
    version.fail(ErrorCode::kUnsupported, fmt::format("glTF version {}; version 2 is supported", version.string()));
  const Json min_version = asset["minVersion"];
  if (min_version && parse(min_version) > std::pair(2, 0))
    min_version.fail(ErrorCode::kUnsupported,
                     fmt::format("needs glTF version {}; version 2.0 is supported", min_version.string()));
  int major = 0, minor = 0;
  const std::string generator(asset["generator"].string());
  if (std::sscanf(generator.c_str(), "Khronos glTF Blender I/O v%5d.%5d", &major, &minor) == 2)
    blender_version_ = major * 100 + minor;
}

void GltfDocument::check_extensions() {
  const Json required = list("extensionsRequired");
  for (std::size_t i = 0; i < required.size(); ++i) {
    const std::string_view name = required.at(i).string();
    if (!contains(kSupported, name))
      required.at(i).fail(ErrorCode::kUnsupported, fmt::format("the file requires the extension \"{}\"; supported: {}",
                                                               name, fmt::join(kSupported, ", ")));
  }
  const Json used = list("extensionsUsed");
  for (std::size_t i = 0; i < used.size(); ++i) {
    const std::string_view name = used.at(i).string();
    if (!contains(kSupported, name) && !contains(kHarmless, name))
      warn(fmt::format("extension \"{}\" is ignored", name), used.at(i));
  }
  root()["extensions"].object();
}

void GltfDocument::check_names() {
  for (const char* name : {"accessors", "animations", "buffers", "bufferViews", "cameras", "images", "materials",
                           "meshes", "nodes", "samplers", "scenes", "skins", "textures"}) {
    const Json list = this->list(name);
    for (std::size_t i = 0; i < list.size(); ++i) list.at(i).object()["name"].string();
  }
}

void GltfDocument::read_buffers() {
  const Json buffers = list("buffers");
  buffers_.resize(buffers.size());
  total_bytes_ = contents_.view().size();
  for (std::size_t i = 0; i < buffers.size(); ++i) {
    const Json json = buffers.at(i).object();
    Buffer& buffer = buffers_[i];
    const std::uint64_t length = json["byteLength"].required().integer(0);
    if (length == 0) warn("buffers without bytes are no valid glTF", json["byteLength"]);
    const Json uri = json["uri"];
    const Json extensions = json["extensions"].object();
    if (uri) {
      if (auto decoded = decode_data_uri(uri)) {
        buffer.decoded = std::move(*decoded);
        buffer.bytes = buffer.decoded;
      } else {
        buffer.file = files_.read(resolve(uri), uri.loc());
        buffer.bytes = buffer.file.view();
      }
    } else if (i == 0 && has_bin_) {
      buffer.bytes = bin_;
    } else {
      buffer.missing = extensions["EXT_meshopt_compression"] || extensions["KHR_meshopt_compression"]
                           ? "its data are compressed with EXT_meshopt_compression, which is not supported"
                           : "it has no uri and the file has no binary chunk for it";
      continue;
    }
    if (buffer.bytes.size() < length)
      json.fail(fmt::format("says that it has {} bytes, but its data have {}", length, buffer.bytes.size()));
    buffer.bytes = buffer.bytes.substr(0, length);
    if (uri) total_bytes_ += length;
  }
}

void GltfDocument::read_views() {
  const Json views = list("bufferViews");
  views_.resize(views.size());
  for (std::size_t i = 0; i < views.size(); ++i) {
    try {
      views_[i] = read_view(views.at(i).object());
    } catch (const Error& e) {
      views_[i].error = e;
    }
  }
}

GltfDocument::View GltfDocument::read_view(const Json& json) const {
  const int index = json["buffer"].index(buffers_.size(), "buffers");
  const Buffer& buffer = buffers_[index];
  const std::uint64_t offset = json["byteOffset"].integer(0), length = json["byteLength"].required().integer(0);
  if (length == 0) warn("buffer views without bytes are no valid glTF", json["byteLength"]);
  if (!buffer.missing.empty()) {
    const Json extensions = json["extensions"].object();
    if (extensions["EXT_meshopt_compression"] || extensions["KHR_meshopt_compression"])
      json.fail(ErrorCode::kUnsupported, "is compressed with EXT_meshopt_compression, which is not supported");
    json["buffer"].fail(fmt::format("buffers[{}] has no data: {}", index, buffer.missing));
  }
  if (offset > buffer.bytes.size() || length > buffer.bytes.size() - offset)
    json.fail(fmt::format("covers bytes {} to {} of buffers[{}], which has {}", offset, offset + length, index,
                          buffer.bytes.size()));
  const Json stride = json["byteStride"];
  if (stride && (stride.integer(0) < 4 || stride.integer(0) > 252))
    stride.fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [4, 252]", stride.integer(0)));
  return {buffer.bytes.substr(offset, length), stride.integer(0), {}};
}

const GltfDocument::View& GltfDocument::view(int index) const {
  const View& v = views_[index];
  v.asked_for = true;
  if (v.error) throw *v.error;
  return v;
}

void GltfDocument::read_accessors() {
  const Json list = this->list("accessors");
  accessors_.resize(list.size());
  for (std::size_t i = 0; i < list.size(); ++i) {
    accessors_[i].json = list.at(i).object();
    try {
      read_accessor(accessors_[i].json, accessors_[i]);
    } catch (const Error& e) {
      accessors_[i].error = e;
    }
  }
}

void GltfDocument::read_accessor(const Json& json, Accessor& a) const {
  a.type = component_type(json["componentType"]);
  a.shape = json["type"].required().string();
  const ElementShape& shape = choice(json["type"], a.shape, "accessor type", kShapes);
  a.components = shape.rows * shape.columns;
  const std::uint64_t count = json["count"].required().integer(0);
  if (count == 0) return warn("accessors without elements are no valid glTF", json["count"]);
  a.normalized = json["normalized"].boolean(false);
  a.view = json["bufferView"].optional_index(views_.size(), "bufferViews");
  a.offset = json["byteOffset"].integer(0);
  const std::size_t size = element_size(shape, a.type);
  if (a.view >= 0) {
    const View& view = this->view(a.view);
    const std::size_t stride = view.stride ? view.stride : size;
    if (stride < size)
      json.fail(fmt::format("has elements of {} bytes, but bufferViews[{}] has a stride of {}", size, a.view, stride));
    // Both factors fit in 53 + 8 bits.
    if (a.offset > view.bytes.size() || (count - 1) * stride + size > view.bytes.size() - a.offset)
      json.fail(fmt::format("needs {} bytes from byte {} of bufferViews[{}], which has {}", (count - 1) * stride + size,
                            a.offset, a.view, view.bytes.size()));
  } else if (count > std::max<std::uint64_t>(total_bytes_, 65536)) {
    // Zeros cost no bytes in the file. Meshes of zeros are of no use, and sparse data belong to meshes with bytes.
    json["count"].fail(ErrorCode::kOutOfRange,
                       fmt::format("{} elements without data in a file of {} bytes", count, total_bytes_));
  }
  a.count = count;

  const Json sparse = json["sparse"].object();
  if (!sparse) return;
  const std::uint64_t sparse_count = sparse["count"].required().integer(0);
  if (sparse_count == 0 || sparse_count > count)
    sparse["count"].fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [1, {}]", sparse_count, count));
  const Json indices = sparse["indices"].required().object(), values = sparse["values"].required().object();
  const ComponentType type = component_type(indices["componentType"]);
  if (type != ComponentType::kUByte && type != ComponentType::kUShort && type != ComponentType::kUInt)
    indices["componentType"].fail("indices are of type 5121, 5123 or 5125");
  const auto fits = [&](const Json& part, std::size_t bytes) {
    const View& view = this->view(part["bufferView"].index(views_.size(), "bufferViews"));
    const std::uint64_t offset = part["byteOffset"].integer(0);
    if (offset > view.bytes.size() || sparse_count * bytes > view.bytes.size() - offset)
      part.fail(fmt::format("needs {} bytes, but its buffer view has {}", sparse_count * bytes, view.bytes.size()));
  };
  fits(indices, component_size(type));
  fits(values, size);
}

const Accessor& GltfDocument::accessor(const Json& index, std::string_view shapes) const {
  const Accessor& a = accessors_[index.index(accessors_.size(), "accessors")];
  a.asked_for = true;
  if (a.error) throw *a.error;
  for (std::string_view rest = shapes; !rest.empty();) {
    const std::size_t bar = std::min(rest.find('|'), rest.size());
    if (rest.substr(0, bar) == a.shape) return a;
    rest.remove_prefix(std::min(bar + 1, rest.size()));
  }
  index.fail(fmt::format("refers to an accessor of type {} instead of {}", a.shape, shapes));
}

template <class T>
void GltfDocument::read_plain(ComponentType type, bool normalized, std::size_t components, const View& view,
                              std::size_t offset, std::size_t count, T* out) const {
  const char* from = view.bytes.data() + offset;
  const std::size_t stride = view.stride ? view.stride : components * component_size(type);
  switch (type) {
    case ComponentType::kByte:
      return convert<std::int8_t>(from, stride, count, components, normalized, out);
    case ComponentType::kUByte:
      return convert<std::uint8_t>(from, stride, count, components, normalized, out);
    case ComponentType::kShort:
      return convert<std::int16_t>(from, stride, count, components, normalized, out);
    case ComponentType::kUShort:
      return convert<std::uint16_t>(from, stride, count, components, normalized, out);
    case ComponentType::kUInt:
      return convert<std::uint32_t>(from, stride, count, components, normalized, out);
    case ComponentType::kFloat:
      return convert<float>(from, stride, count, components, normalized, out);
  }
}

template <class T>
void GltfDocument::read_elements(const Accessor& a, T* out) const {
  const std::size_t components = a.components;
  if (a.count == 0) return;
  if (a.view >= 0) {
    read_plain(a.type, a.normalized, components, view(a.view), a.offset, a.count, out);
  } else {
    std::fill_n(out, a.count * components, T(0));
  }
  const Json sparse = a.json["sparse"];
  if (!sparse) return;
  const std::size_t count = sparse["count"].integer(0);
  const Json indices = sparse["indices"], values = sparse["values"];
  std::vector<std::uint32_t> where(count);
  const auto packed = [&](const Json& part) {  // sparse data have no stride
    return View{view(int(part["bufferView"].integer(0))).bytes, 0, {}};
  };
  read_plain(component_type(indices["componentType"]), false, 1, packed(indices), indices["byteOffset"].integer(0),
             count, where.data());
  std::vector<T> replaced(count * components);
  read_plain(a.type, a.normalized, components, packed(values), values["byteOffset"].integer(0), count, replaced.data());
  for (std::size_t i = 0; i < count; ++i) {
    if (where[i] >= a.count || (i > 0 && where[i] <= where[i - 1]))
      indices.fail(
          fmt::format("sparse index {} (number {}) is not in increasing order below {}", where[i], i, a.count));
    std::copy_n(replaced.begin() + std::ptrdiff_t(i * components), components, out + where[i] * components);
  }
}

void GltfDocument::warn_of_unread() const {
  const auto check = [&](const auto& items, const char* what) {
    for (const auto& item : items)
      if (item.error && !item.asked_for)
        warn(fmt::format("{} that cannot be read, but nothing uses: {}", what, item.error->message()),
             item.error->loc());
  };
  check(accessors_, "an accessor");
  check(views_, "a buffer view");
}

void GltfDocument::read(const Accessor& accessor, float* out) const { read_elements(accessor, out); }
void GltfDocument::read(const Accessor& accessor, std::uint32_t* out) const { read_elements(accessor, out); }

std::vector<float> GltfDocument::floats(const Accessor& accessor) const {
  std::vector<float> out(accessor.count * accessor.components);
  read(accessor, out.data());
  return out;
}

std::optional<std::string> GltfDocument::decode_data_uri(const Json& uri) {
  std::string_view text = uri.string();
  if (text.substr(0, 5) != "data:") return std::nullopt;
  const std::size_t comma = text.find(',');
  if (comma == text.npos) uri.fail("a data URI without a comma");
  const bool base64 = text.substr(0, comma).ends_with(";base64");
  text.remove_prefix(comma + 1);
  if (!base64) return percent_decode(text);
  auto decoded = base64_decode(text.find('%') == text.npos ? std::string(text) : percent_decode(text));
  if (!decoded) uri.fail("a data URI that is not valid base64");
  return decoded;
}

std::filesystem::path GltfDocument::resolve(const Json& uri) const {
  const std::string_view text = uri.string();
  const std::size_t scheme = text.find_first_of(":/?#");
  if (text.empty()) uri.fail("an empty URI");
  if (scheme != text.npos && text[scheme] == ':')
    uri.fail(ErrorCode::kUnsupported,
             fmt::format("\"{}\" is not a path relative to the file, nor a data URI", text.substr(0, 80)));
  const std::string decoded = percent_decode(text);
  if (std::any_of(decoded.begin(), decoded.end(), [](unsigned char c) { return c < 32; }))
    uri.fail("a URI with control characters");
  // Some writers do not encode their names, so that a percent sign may be one.
  const std::filesystem::path folder = file_.parent_path();
  std::filesystem::path named = named_file(folder, decoded);
  std::error_code failed;
  if (decoded == text || std::filesystem::exists(named, failed)) return named;
  const std::filesystem::path as_written = named_file(folder, std::string(text));
  return std::filesystem::exists(as_written, failed) ? as_written : named;
}

}  // namespace tempera
