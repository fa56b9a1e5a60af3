// SPDX-License-Identifier: Apache-2.0
// Stanford PLY: a text header that names elements and their properties, then their values as text or binary records.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <vector>

#include "input_files.h"
#include "tempera/core/parallel.h"
#include "tempera/import/mesh_files.h"
#include "triangulate.h"

namespace tempera {
namespace {

enum class Type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kInt64, kUint64, kFloat32, kFloat64 };

struct TypeName {
  std::string_view name;
  Type type;
};
constexpr std::array<TypeName, 20> kTypes{
    {{"char", Type::kInt8},     {"uchar", Type::kUint8},    {"short", Type::kInt16},     {"ushort", Type::kUint16},
     {"int", Type::kInt32},     {"uint", Type::kUint32},    {"long", Type::kInt64},      {"ulong", Type::kUint64},
     {"float", Type::kFloat32}, {"double", Type::kFloat64}, {"int8", Type::kInt8},       {"uint8", Type::kUint8},
     {"int16", Type::kInt16},   {"uint16", Type::kUint16},  {"int32", Type::kInt32},     {"uint32", Type::kUint32},
     {"int64", Type::kInt64},   {"uint64", Type::kUint64},  {"float32", Type::kFloat32}, {"float64", Type::kFloat64}}};

std::size_t size_of(Type type) {
  constexpr std::array<std::size_t, 10> kSizes{1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return kSizes[std::size_t(type)];
}
bool is_integer(Type type) { return type < Type::kFloat32; }
/// What an integer color is divided by.
double full_scale(Type type) {
  constexpr std::array<double, 10> kScales{
      127, 255, 32767, 65535, 2147483647, 4294967295, 9223372036854775807.0, 18446744073709551615.0, 1, 1};
  return kScales[std::size_t(type)];
}

struct PlyProperty {
  std::string name;
  Type type = Type::kFloat32;
  std::optional<Type> count_type;  // set: a list
  std::size_t offset = 0;          // bytes into a record, if no list comes before
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;
  int line = 0;
  std::size_t stride() const {
    std::size_t n = 0;
    for (const PlyProperty& p : properties) n += size_of(p.count_type.value_or(p.type));
    return n;
  }
  bool has_list() const {
    return std::any_of(properties.begin(), properties.end(),
                       [](const PlyProperty& p) { return p.count_type.has_value(); });
  }
};

enum class Format { kAscii, kLittleEndian, kBigEndian };

struct Header {
  Format format = Format::kAscii;
  std::vector<Element> elements;
  std::size_t size = 0;  // bytes
  int lines = 0;
};

template <class T>
double load(const char* p, bool swap) {
  T value;
  if constexpr (sizeof(T) == 1) {
    std::memcpy(&value, p, 1);
  } else if (swap) {
    char reversed[sizeof(T)];
    std::reverse_copy(p, p + sizeof(T), reversed);
    std::memcpy(&value, reversed, sizeof(T));
  } else {
    std::memcpy(&value, p, sizeof(T));
  }
  return double(value);
}

double load(Type type, const char* p, bool swap) {
  switch (type) {
    case Type::kInt8:
      return load<std::int8_t>(p, swap);
    case Type::kUint8:
      return load<std::uint8_t>(p, swap);
    case Type::kInt16:
      return load<std::int16_t>(p, swap);
    case Type::kUint16:
      return load<std::uint16_t>(p, swap);
    case Type::kInt32:
      return load<std::int32_t>(p, swap);
    case Type::kUint32:
      return load<std::uint32_t>(p, swap);
    case Type::kInt64:
      return load<std::int64_t>(p, swap);
    case Type::kUint64:
      return load<std::uint64_t>(p, swap);
    case Type::kFloat32:
      return load<float>(p, swap);
    case Type::kFloat64:
      break;
  }
  return load<double>(p, swap);
}

/// Where a property goes: which array and which component of it.
struct Column {
  std::size_t property = 0;
  std::vector<float>* target = nullptr;
  int component = 0, components = 1;
  float scale = 1;
};

class Reader {
 public:
  Reader(std::string_view bytes, const std::string& file, Warnings& warnings)
      : bytes_(bytes), file_(file), warnings_(warnings) {}

  Mesh read() {
    parse_header();
    at_ = header_.size;
    line_ = header_.lines + 1;
    const auto skip_all = [&](const Element& e) {
      for (std::uint64_t i = 0; i < e.count; ++i)
        for (const PlyProperty& p : e.properties) skip(p);
    };
    bool has_vertices = false, has_faces = false;
    struct {
      const Element* element = nullptr;
      std::size_t at = 0;
      int line = 0;
    } early_faces;  // before the vertices that their polygons need
    for (const Element& e : header_.elements) {
      check_size(e);
      if (e.name == "vertex" && !has_vertices) {
        has_vertices = true;
        read_vertices(e);
      } else if (e.name == "face" && !has_faces) {
        has_faces = true;
        if (has_vertices) {
          read_faces(e);
        } else {
          early_faces = {&e, at_, line_};
          skip_all(e);
        }
      } else {
        if (e.count > 0) warnings_.add(fmt::format("PLY element \"{}\" is ignored", e.name), {file_, e.line, 1});
        skip_all(e);
      }
    }
    if (!has_vertices) fail(header_.lines, "the file has no element \"vertex\"");
    if (!has_faces) fail(header_.lines, "the file has no element \"face\"");
    if (early_faces.element) {
      at_ = early_faces.at;
      line_ = early_faces.line;
      read_faces(*early_faces.element);
    }
    return std::move(mesh_);
  }

 private:
  [[noreturn]] void fail(int line, const std::string& message) const {
    throw Error(ErrorCode::kBadInput, {file_, line, line > 0 ? 1 : 0}, message);
  }
  /// Line of ascii data that is being read; none in binary data.
  int data_line() const { return header_.format == Format::kAscii ? line_ : 0; }

  void parse_header();
  void check_size(const Element& element) const;
  void read_vertices(const Element& element);
  void read_faces(const Element& element);
  /// Fills the columns' targets from all records of an element without lists.
  void read_columns(const Element& element, const std::vector<Column>& columns);
  std::vector<Column> color_columns(const Element& element, std::vector<float>& rgb, std::vector<float>& alpha);
  std::optional<Column> column(const Element& element, std::initializer_list<std::string_view> names);
  void note_unused(const Element& element, const std::vector<Column>& columns, std::size_t except = std::string::npos);

  /// The next value of a property or of a list's count.
  double next(Type type);
  double next_number();
  void skip(const PlyProperty& property);

  std::string_view bytes_;
  const std::string& file_;
  Warnings& warnings_;
  Header header_;
  std::size_t at_ = 0;
  int line_ = 1;
  Mesh mesh_;
};

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  for (std::size_t i = 0; i < line.size();) {
    while (i < line.size() && (line[i] == ' ' || line[i] == '\t' || line[i] == '\r')) ++i;
    const std::size_t begin = i;
    while (i < line.size() && line[i] != ' ' && line[i] != '\t' && line[i] != '\r') ++i;
    if (i > begin) words.push_back(line.substr(begin, i - begin));
  }
  return words;
}

void Reader::parse_header() {
  const auto type_of = [&](std::string_view name, int line) {
    for (const TypeName& t : kTypes)
      if (t.name == name) return t.type;
    fail(line,
         fmt::format(
             "\"{}\" is no PLY type; known: char uchar short ushort int uint long ulong float double, int8 … float64",
             name));
  };
  bool has_format = false;
  for (;;) {
    const std::size_t newline = bytes_.find('\n', header_.size);
    if (newline == std::string_view::npos) fail(header_.lines + 1, "the header ends without \"end_header\"");
    const std::vector<std::string_view> w = words_of(bytes_.substr(header_.size, newline - header_.size));
    header_.size = newline + 1;
    const int line = ++header_.lines;
    if (line == 1) {
      if (w.size() != 1 || w[0] != "ply") fail(1, "a PLY file starts with the line \"ply\"");
      continue;
    }
    if (w.empty() || w[0] == "comment" || w[0] == "obj_info") continue;
    if (w[0] == "end_header") break;
    if (w[0] == "format" && w.size() == 3) {
      has_format = true;
      if (w[1] == "ascii")
        header_.format = Format::kAscii;
      else if (w[1] == "binary_little_endian")
        header_.format = Format::kLittleEndian;
      else if (w[1] == "binary_big_endian")
        header_.format = Format::kBigEndian;
      else
        fail(line, fmt::format("unknown format \"{}\"; known: ascii, binary_little_endian, binary_big_endian", w[1]));
      if (w[2] != "1.0")
        throw Error(ErrorCode::kUnsupported, {file_, line, 1}, fmt::format("PLY version {} is not 1.0", w[2]));
    } else if (w[0] == "element" && w.size() == 3) {
      Element e;
      e.name = w[1];
      e.line = line;
      const auto [end, failed] = std::from_chars(w[2].data(), w[2].data() + w[2].size(), e.count);
      if (failed != std::errc() || end != w[2].data() + w[2].size())
        fail(line, fmt::format("cannot read the count \"{}\" of element \"{}\"", w[2], e.name));
      header_.elements.push_back(std::move(e));
    } else if (w[0] == "property" && (w.size() == 3 || (w.size() == 5 && w[1] == "list"))) {
      if (header_.elements.empty()) fail(line, "a property comes before any element");
      Element& e = header_.elements.back();
      PlyProperty p;
      p.offset = e.stride();
      p.name = w.back();
      p.type = type_of(w[w.size() - 2], line);
      if (w.size() == 5) {
        p.count_type = type_of(w[2], line);
        if (!is_integer(*p.count_type)) fail(line, "the length of a list must have an integer type");
      }
      e.properties.push_back(std::move(p));
    } else {
      fail(line,
           fmt::format("cannot read the header line \"{}\"; expected format, element, property or end_header", w[0]));
    }
  }
  if (!has_format) fail(header_.lines, "the header has no \"format\" line");
}

void Reader::check_size(const Element& element) const {
  // A count is believed only as far as the file is long: two characters or the bytes of each value.
  const std::size_t rest = bytes_.size() - at_;
  const std::size_t least = header_.format == Format::kAscii ? 2 * element.properties.size() : element.stride();
  if (least == 0 ? element.count > 0 : element.count > (rest + 1) / least)
    fail(element.line, fmt::format("element \"{}\" is said to have {} entries, but the file holds only {} more bytes",
                                   element.name, element.count, rest));
}

double Reader::next_number() {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; };
  while (at_ < bytes_.size() && blank(bytes_[at_])) line_ += bytes_[at_++] == '\n';
  if (at_ < bytes_.size() && bytes_[at_] == '+') ++at_;
  double value;
  const auto [end, failed] = std::from_chars(bytes_.data() + at_, bytes_.data() + bytes_.size(), value);
  if (failed == std::errc::result_out_of_range)
    value = 0;
  else if (failed != std::errc())
    fail(line_, at_ == bytes_.size() ? std::string("the file ends in the middle of its data")
                                     : fmt::format("cannot read the number \"{}\"", bytes_.substr(at_, 16)));
  at_ = end - bytes_.data();
  return value;
}

double Reader::next(Type type) {
  if (header_.format == Format::kAscii) return next_number();
  const std::size_t n = size_of(type);
  if (bytes_.size() - at_ < n) fail(0, "the file ends in the middle of its data");
  const double value = load(type, bytes_.data() + at_,
                            (header_.format == Format::kBigEndian) == (std::endian::native == std::endian::little));
  at_ += n;
  return value;
}

void Reader::skip(const PlyProperty& property) {
  if (!property.count_type) {
    next(property.type);
    return;
  }
  const double count = next(*property.count_type);
  for (double i = 0; i < count; ++i) next(property.type);
}

std::optional<Column> Reader::column(const Element& element, std::initializer_list<std::string_view> names) {
  for (std::string_view name : names)
    for (std::size_t i = 0; i < element.properties.size(); ++i)
      if (element.properties[i].name == name && !element.properties[i].count_type) return Column{i, nullptr, 0, 1, 1};
  return std::nullopt;
}

std::vector<Column> Reader::color_columns(const Element& element, std::vector<float>& rgb, std::vector<float>& alpha) {
  std::vector<Column> columns;
  const std::optional<Column> c[4] = {column(element, {"red", "r", "color_r", "color_0", "diffuse_red"}),
                                      column(element, {"green", "g", "color_g", "color_1", "diffuse_green"}),
                                      column(element, {"blue", "b", "color_b", "color_2", "diffuse_blue"}),
                                      column(element, {"alpha", "a", "color_a", "color_3"})};
  if (!c[0] || !c[1] || !c[2]) return columns;
  for (int i = 0; i < 4; ++i) {
    if (!c[i]) continue;
    Column out = *c[i];
    out.target = i < 3 ? &rgb : &alpha;
    out.component = i < 3 ? i : 0;
    out.components = i < 3 ? 3 : 1;
    out.scale = float(1 / full_scale(element.properties[out.property].type));
    columns.push_back(out);
  }
  return columns;
}

void Reader::note_unused(const Element& element, const std::vector<Column>& columns, std::size_t except) {
  for (std::size_t i = 0; i < element.properties.size(); ++i) {
    const bool used =
        i == except || std::any_of(columns.begin(), columns.end(), [&](const Column& c) { return c.property == i; });
    if (!used && element.count > 0)
      warnings_.add(
          fmt::format("PLY property \"{}\" of element \"{}\" is ignored", element.properties[i].name, element.name),
          {file_, element.line, 1});
  }
}

void Reader::read_columns(const Element& element, const std::vector<Column>& columns) {
  for (const Column& c : columns) c.target->resize(element.count * c.components);
  if (header_.format != Format::kAscii && !element.has_list()) {
    const std::size_t stride = element.stride();
    if ((bytes_.size() - at_) / std::max<std::size_t>(stride, 1) < element.count)
      fail(0, "the file ends in the middle of its data");
    const bool swap = (header_.format == Format::kBigEndian) == (std::endian::native == std::endian::little);
    const char* const records = bytes_.data() + at_;
    constexpr std::int64_t kRecords = 1 << 14;  // a block stays in the cache for all its columns
    parallel_for(0, (std::int64_t(element.count) + kRecords - 1) / kRecords, [&](std::int64_t block) {
      const std::size_t begin = block * kRecords, end = std::min(begin + kRecords, element.count);
      for (const Column& c : columns) {
        const PlyProperty& p = element.properties[c.property];
        float* const out = c.target->data() + c.component;
        for (std::size_t i = begin; i < end; ++i)
          out[i * c.components] = float(load(p.type, records + i * stride + p.offset, swap)) * c.scale;
      }
    });
    at_ += stride * element.count;
    return;
  }
  std::vector<const Column*> by_property(element.properties.size(), nullptr);
  for (const Column& c : columns) by_property[c.property] = &c;
  for (std::size_t i = 0; i < element.count; ++i) {
    for (std::size_t k = 0; k < element.properties.size(); ++k) {
      const PlyProperty& p = element.properties[k];
      if (p.count_type || !by_property[k]) {
        skip(p);
      } else {
        const Column& c = *by_property[k];
        (*c.target)[i * c.components + c.component] = float(next(p.type)) * c.scale;
      }
    }
  }
}

template <class T>
std::vector<T> as(const std::vector<float>& numbers) {
  static_assert(sizeof(T) % sizeof(float) == 0);
  std::vector<T> result(numbers.size() * sizeof(float) / sizeof(T));
  if (!numbers.empty()) std::memcpy(static_cast<void*>(result.data()), numbers.data(), numbers.size() * sizeof(float));
  return result;
}

void Reader::read_vertices(const Element& element) {
  std::vector<float> positions, normals, uvs, rgb, alpha;
  std::vector<Column> columns;
  const auto group = [&](std::vector<float>& target,
                         std::initializer_list<std::initializer_list<std::string_view>> names) {
    std::vector<Column> found;
    for (const auto& component : names) {
      std::optional<Column> c = column(element, component);
      if (!c) return false;
      c->target = &target;
      c->component = int(found.size());
      c->components = int(names.size());
      found.push_back(*c);
    }
    columns.insert(columns.end(), found.begin(), found.end());
    return true;
  };
  if (!group(positions, {{"x"}, {"y"}, {"z"}})) fail(element.line, "the vertices lack one of the properties x, y, z");
  group(normals, {{"nx"}, {"ny"}, {"nz"}});
  if (!group(uvs, {{"u"}, {"v"}}) && !group(uvs, {{"s"}, {"t"}}) && !group(uvs, {{"texture_u"}, {"texture_v"}}))
    group(uvs, {{"texture_s"}, {"texture_t"}});
  for (const Column& c : color_columns(element, rgb, alpha)) columns.push_back(c);
  note_unused(element, columns);
  const int first_line = line_;
  read_columns(element, columns);

  mesh_.positions = as<Vec3f>(positions);
  mesh_.normals = as<Vec3f>(normals);
  mesh_.uvs = as<Vec2f>(uvs);
  mesh_.colors = as<Rgb>(rgb);
  mesh_.color_alphas = std::move(alpha);
  for (int i = 0; i < std::ssize(mesh_.positions); ++i)
    if (!is_finite(mesh_.positions[i]))
      fail(header_.format == Format::kAscii ? first_line + i : 0,
           fmt::format("vertex {} has a position that is not finite", i));
  for (Vec3f& n : mesh_.normals) n = is_finite(n) ? normalize(n) : Vec3f{};
  for (Vec2f& uv : mesh_.uvs)
    if (!std::isfinite(uv.x) || !std::isfinite(uv.y)) uv = {};
}

void Reader::read_faces(const Element& element) {
  std::size_t list = element.properties.size();
  for (std::size_t i = 0; i < element.properties.size(); ++i)
    if (element.properties[i].count_type &&
        (element.properties[i].name == "vertex_indices" || element.properties[i].name == "vertex_index"))
      list = i;
  if (list == element.properties.size())
    fail(element.line, "the faces lack the list property vertex_indices (or vertex_index)");
  const PlyProperty& indices = element.properties[list];
  if (!is_integer(indices.type)) fail(element.line, "vertex indices must have an integer type");

  std::vector<float> rgb, alpha;
  std::vector<Column> columns = mesh_.colors.empty() ? color_columns(element, rgb, alpha) : std::vector<Column>{};
  note_unused(element, columns, list);
  std::vector<const Column*> by_property(element.properties.size(), nullptr);
  for (const Column& c : columns) by_property[c.property] = &c;

  mesh_.indices.reserve(3 * element.count);
  std::vector<float> values(element.properties.size());
  std::vector<std::uint32_t> polygon;
  PolygonMesher mesher(mesh_);
  for (std::uint64_t f = 0; f < element.count; ++f) {
    polygon.clear();
    for (std::size_t k = 0; k < element.properties.size(); ++k) {
      const PlyProperty& p = element.properties[k];
      if (k != list) {
        if (by_property[k])
          values[k] = float(next(p.type)) * by_property[k]->scale;
        else
          skip(p);
        continue;
      }
      const double count = next(*p.count_type);
      for (double i = 0; i < count; ++i) {
        const double index = next(p.type);
        if (!(index >= 0 && index < double(mesh_.positions.size())))
          fail(data_line(), fmt::format("face {} refers to vertex {}, but the file has {} vertices (counted from 0)", f,
                                        index, mesh_.positions.size()));
        polygon.push_back(std::uint32_t(index));
      }
    }
    const std::size_t before = mesh_.triangle_count();
    if (!mesher.add(polygon)) warnings_.add(kCrossedPolygon, {file_, data_line(), data_line() > 0 ? 1 : 0});
    for (std::size_t t = before; t < mesh_.triangle_count(); ++t) {
      for (const Column& c : columns) {
        if (c.component == 0) c.target->resize(c.target->size() + c.components);
        (*c.target)[c.target->size() - (c.components - c.component)] = values[c.property];
      }
    }
  }
  if (!rgb.empty()) {
    mesh_.colors = as<Rgb>(rgb);
    mesh_.color_alphas = std::move(alpha);
    mesh_.color_per_face = true;
  }
}

}  // namespace

Mesh read_ply(std::string_view bytes, const std::string& file, Warnings& warnings) {
  return Reader(skip_byte_order_mark(bytes), file, warnings).read();
}

}  // namespace tempera
