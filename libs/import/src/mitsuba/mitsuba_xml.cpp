// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_xml.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <initializer_list>
#include <new>
#include <pugixml.hpp>
#include <set>

#include "tempera/import/paths.h"

namespace tempera::mitsuba {

// Bounds on what a hostile file can ask for. Real scenes stay far below them.
constexpr int kMaxDepth = 64;  // nested elements
constexpr int kMaxIncludeDepth = 32;
constexpr int kMaxIncludes = 10000;             // files that include each other twice grow exponentially
constexpr std::size_t kMaxAttribute = 1 << 24;  // bytes after substitution; likewise for parameters in parameters

namespace {

constexpr std::array<std::string_view, 14> kObjectTags{"scene",   "integrator", "sensor",  "film",      "sampler",
                                                       "rfilter", "bsdf",       "emitter", "shape",     "texture",
                                                       "medium",  "phase",      "volume",  "subsurface"};
constexpr std::array<std::string_view, 17> kOtherTags{
    "boolean",   "integer",   "float",     "string", "point", "vector",  "rgb",     "srgb", "spectrum",
    "blackbody", "transform", "animation", "ref",    "alias", "include", "default", "path"};
constexpr std::array<std::string_view, 6> kTransformTags{"translate", "rotate", "scale", "lookat", "lookAt", "matrix"};

template <class Range>
bool contains(const Range& range, std::string_view name) {
  return std::find(std::begin(range), std::end(range), name) != std::end(range);
}

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
bool is_separator(char c) { return is_blank(c) || c == ','; }

/// intIOR -> int_ior, toWorld -> to_world.
std::string snake_case(std::string_view name) {
  const auto lower = [](char c) { return c >= 'a' && c <= 'z'; };
  const auto upper = [](char c) { return c >= 'A' && c <= 'Z'; };
  std::string result;
  for (std::size_t i = 0; i < name.size(); ++i) {
    if (i > 0 && lower(name[i - 1]) && upper(name[i])) {
      result += '_';
      for (; i < name.size() && upper(name[i]); ++i) result += char(name[i] - 'A' + 'a');
      if (i == name.size()) break;
    }
    result += name[i];
  }
  return result;
}

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

bool parse_number(std::string_view text, double& value) {
  text = trim(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (failed == std::errc::result_out_of_range) value = std::strtod(std::string(text).c_str(), nullptr);  // 0 or inf
  return (failed == std::errc() || failed == std::errc::result_out_of_range) && end == text.data() + text.size();
}

std::vector<std::string_view> split(std::string_view text) {
  std::vector<std::string_view> words;
  for (std::size_t i = 0; i < text.size();) {
    while (i < text.size() && is_separator(text[i])) ++i;
    const std::size_t begin = i;
    while (i < text.size() && !is_separator(text[i])) ++i;
    if (i > begin) words.push_back(text.substr(begin, i - begin));
  }
  return words;
}

/// In the order of time, and of several keys at one time the first and the last: what holds before it and from then on.
void order_keys(std::vector<std::pair<double, Affine3d>>& keys) {
  std::stable_sort(keys.begin(), keys.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<std::pair<double, Affine3d>> kept;
  for (const auto& key : keys) {
    if (kept.size() > 1 && kept[kept.size() - 2].first == key.first) kept.pop_back();
    kept.push_back(key);
  }
  keys = std::move(kept);
}

double srgb_to_linear(double v) { return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4); }

}  // namespace

bool parse_numbers(std::string_view text, std::vector<double>& numbers) {
  numbers.clear();
  for (std::string_view word : split(text)) {
    double v;
    if (!parse_number(word, v) || !std::isfinite(v)) return false;
    numbers.push_back(v);
  }
  return true;
}

std::string Object::name() const { return plugin.empty() ? tag : fmt::format("{} \"{}\"", tag, plugin); }

// ---------------------------------------------------------------------------------------------------------------------

class Parser {
 public:
  Parser(Document& document, const std::vector<std::pair<std::string, std::string>>& defines, InputFiles& inputs,
         Warnings& warnings)
      : document_(document), inputs_(inputs), warnings_(warnings) {
    for (const auto& [name, value] : defines) parameters_[name] = {value, true, false};
  }

  std::shared_ptr<Object> parse_file(const std::filesystem::path& path, const SourceLoc& from);

  void finish() {
    for (const auto& [name, parameter] : parameters_)
      if (parameter.is_define && !parameter.used)
        warnings_.add(
            fmt::format("the parameter \"{}\" that was defined on the command line is not used by the scene", name),
            {"<command line>"});
    for (const auto& [id, place] : document_.referenced_)
      if (!document_.ids_.contains(id)) fail_unknown_id(id, place);
  }
  [[noreturn]] void fail_unknown_id(const std::string& id, const Place& place) const {
    std::vector<std::string> known;
    for (const auto& [name, object] : document_.ids_) known.push_back(name);
    const std::string nearest = nearest_names(id, known);
    throw Error(ErrorCode::kUnknownName, document_.loc(place),
                fmt::format("there is no object with the id \"{}\"; {}", id,
                            nearest.empty() ? "the scene has no ids" : "known: " + nearest));
  }

 private:
  struct Parameter {
    std::string value;
    bool is_define = false;
    bool used = false;
  };
  using Attributes = std::map<std::string, std::pair<std::string, Place>, std::less<>>;  // name -> value, its place

  [[noreturn]] void fail(ErrorCode code, const Place& place, const std::string& message) const {
    throw Error(code, document_.loc(place), message);
  }
  Place place(const pugi::xml_node& node) const {
    const std::ptrdiff_t offset = node.offset_debug();  // of the name, behind the '<'
    return {file_, offset > 0 ? std::size_t(offset) - 1 : 0};
  }
  Attributes attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> required,
                        std::initializer_list<std::string_view> optional);
  std::string substitute(std::string_view text, const Place& place);
  void parse_children(const pugi::xml_node& node, Object& parent, int depth);
  void parse_child(const pugi::xml_node& node, Object& parent, int depth);
  void parse_object(const pugi::xml_node& node, Object& parent, int depth);
  void include(const pugi::xml_node& node, Object& parent);
  void add(Object& parent, std::string_view name, Value value, const Place& place);

  double number(const std::pair<std::string, Place>& text, std::string_view what) const;
  Vec3d vector3(const Attributes& a, double missing, const Place& place) const;
  Vec3d vector3(const std::pair<std::string, Place>& text, std::string_view what) const;
  Spectrum spectrum(const std::pair<std::string, Place>& text) const;
  Spectrum spectrum_file(const std::string& name, const Place& place);
  Affine3d transform(const pugi::xml_node& node);
  void transform_step(const pugi::xml_node& node, Affine3d& map);

  Document& document_;
  InputFiles& inputs_;
  Warnings& warnings_;
  std::map<std::string, Parameter, std::less<>> parameters_;
  std::vector<std::filesystem::path> include_stack_;
  int include_count_ = 0;
  int file_ = 0;                  // the file that is being parsed
  const char* buffer_ = nullptr;  // its text, for the places of attributes
  std::size_t buffer_size_ = 0;
};

std::shared_ptr<Object> Parser::parse_file(const std::filesystem::path& path, const SourceLoc& from) {
  const FileContents contents = inputs_.read(path, from);
  std::string text(contents.view());
  Document::File file{path, {0}, false};
  for (std::size_t i = 0; i < text.size(); ++i)
    if (text[i] == '\n') file.line_starts.push_back(i + 1);
  document_.files_.push_back(std::move(file));

  const int saved_file = std::exchange(file_, int(document_.files_.size()) - 1);
  const char* const saved_buffer = std::exchange(buffer_, text.data());
  const std::size_t saved_size = std::exchange(buffer_size_, text.size());
  include_stack_.push_back(std::filesystem::weakly_canonical(path));

  pugi::xml_document xml;
  const pugi::xml_parse_result parsed = xml.load_buffer_inplace(text.data(), text.size());
  if (parsed.status == pugi::status_out_of_memory) throw std::bad_alloc();
  if (!parsed)
    fail(ErrorCode::kSyntax, {file_, std::size_t(std::max<std::ptrdiff_t>(parsed.offset, 0))},
         fmt::format("this is not well-formed XML: {}", parsed.description()));
  const pugi::xml_node root = xml.document_element();
  if (!contains(kObjectTags, root.name()))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("the root element <{}> is no Mitsuba scene; expected <scene version=\"3.0.0\">", root.name()));
  if (!root.attribute("version"))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("the root element <{}> lacks its version, e.g. version=\"3.0.0\"", root.name()));
  double major = 0;
  const std::string_view version = root.attribute("version").value();
  if (!parse_number(version.substr(0, version.find('.')), major))
    fail(ErrorCode::kBadInput, place(root),
         fmt::format("cannot read the version \"{}\"; expected e.g. 3.0.0", version));
  document_.files_.back().legacy = major < 2;

  auto holder = std::make_shared<Object>();
  holder->place = place(root);
  parse_object(root, *holder, 0);

  include_stack_.pop_back();
  file_ = saved_file;
  buffer_ = saved_buffer;
  buffer_size_ = saved_size;
  return holder;
}

std::string Parser::substitute(std::string_view text, const Place& place) {
  if (text.find('$') == std::string_view::npos) return std::string(text);
  std::string result;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\\' && i + 1 < text.size() && text[i + 1] == '$') {  // an escaped dollar sign
      result += text[++i];
      continue;
    }
    if (text[i] != '$') {
      result += text[i];
      continue;
    }
    // The longest known name wins: "$sppx" means "$spp" followed by "x" if only "spp" exists, as in Mitsuba.
    std::size_t end = i + 1;
    while (end < text.size() && (std::isalnum(static_cast<unsigned char>(text[end])) || text[end] == '_')) ++end;
    auto found = parameters_.end();
    std::size_t used = end;
    for (; used > i + 1 && found == parameters_.end(); --used) {
      found = parameters_.find(text.substr(i + 1, used - i - 1));
      if (found != parameters_.end()) break;
    }
    if (found == parameters_.end()) {
      std::vector<std::string> known;
      for (const auto& [name, parameter] : parameters_) known.push_back(name);
      fail(ErrorCode::kUnknownName, place,
           fmt::format("the parameter \"${}\" has no value; give it a <default> or define it on the command line{}",
                       text.substr(i + 1, end - i - 1), known.empty() ? "" : "; known: " + nearest_names("", known)));
    }
    found->second.used = true;
    result += found->second.value;
    if (result.size() > kMaxAttribute) fail(ErrorCode::kBadInput, place, "parameters expand without end");
    i = used - 1;
  }
  return result;
}

Parser::Attributes Parser::attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> required,
                                      std::initializer_list<std::string_view> optional) {
  Attributes result;
  for (const pugi::xml_attribute& a : node.attributes()) {
    Place at = place(node);
    const std::ptrdiff_t offset = a.value() - buffer_;  // values are decoded in place, so that they still start here
    if (offset > 0 && std::size_t(offset) < buffer_size_) at.offset = std::size_t(offset);
    if (!contains(required, a.name()) && !contains(optional, a.name())) {
      std::string known;
      for (const auto& list : {required, optional})
        for (std::string_view n : list) known += (known.empty() ? "" : ", ") + std::string(n);
      fail(ErrorCode::kUnknownName, at,
           fmt::format("<{}> has no attribute \"{}\"; known: {}", node.name(), a.name(), known));
    }
    result[a.name()] = {substitute(a.value(), at), at};
  }
  for (std::string_view name : required)
    if (!result.contains(name))
      fail(ErrorCode::kBadInput, place(node), fmt::format("<{}> lacks its attribute \"{}\"", node.name(), name));
  return result;
}

double Parser::number(const std::pair<std::string, Place>& text, std::string_view what) const {
  double v;
  if (!parse_number(text.first, v))
    fail(ErrorCode::kBadInput, text.second, fmt::format("cannot read {} \"{}\" as a number", what, text.first));
  if (!std::isfinite(v))
    fail(ErrorCode::kOutOfRange, text.second, fmt::format("{} is {}; it must be a finite number", what, text.first));
  return v;
}

Vec3d Parser::vector3(const std::pair<std::string, Place>& text, std::string_view what) const {
  std::vector<double> v;
  if (!parse_numbers(text.first, v) || v.size() != 3)
    fail(ErrorCode::kBadInput, text.second,
         fmt::format("{} is \"{}\"; expected three finite numbers such as \"0, 1, 0\"", what, text.first));
  return {v[0], v[1], v[2]};
}

Vec3d Parser::vector3(const Attributes& a, double missing, const Place& place) const {
  if (const auto value = a.find("value"); value != a.end()) {
    if (a.contains("x") || a.contains("y") || a.contains("z"))
      fail(ErrorCode::kBadInput, place, "\"value\" and \"x\", \"y\", \"z\" exclude each other");
    std::vector<double> v;
    if (!parse_numbers(value->second.first, v) || (v.size() != 1 && v.size() != 3))
      fail(ErrorCode::kBadInput, value->second.second,
           fmt::format("\"{}\" must be one or three finite numbers", value->second.first));
    return v.size() == 1 ? Vec3d{v[0], v[0], v[0]} : Vec3d{v[0], v[1], v[2]};
  }
  Vec3d v{missing, missing, missing};
  int i = 0;
  for (const char* name : {"x", "y", "z"}) {
    if (const auto c = a.find(name); c != a.end()) v[i] = number(c->second, name);
    ++i;
  }
  return v;
}

Spectrum Parser::spectrum(const std::pair<std::string, Place>& text) const {
  Spectrum s;
  const std::vector<std::string_view> words = split(text.first);
  if (words.empty()) fail(ErrorCode::kBadInput, text.second, "a spectrum needs a value or wavelength:value pairs");
  if (words.size() == 1 && words[0].find(':') == std::string_view::npos) {
    s.values = {number({std::string(words[0]), text.second}, "a spectrum value")};
    return s;
  }
  for (std::string_view word : words) {
    const std::size_t colon = word.find(':');
    double wavelength, value;
    if (colon == std::string_view::npos || !parse_number(word.substr(0, colon), wavelength) ||
        !parse_number(word.substr(colon + 1), value) || !std::isfinite(wavelength) || !std::isfinite(value))
      fail(ErrorCode::kBadInput, text.second,
           fmt::format("\"{}\" is no pair of wavelength (nm) and value such as 550:0.8", word));
    if (!s.wavelengths.empty() && wavelength <= s.wavelengths.back())
      fail(ErrorCode::kBadInput, text.second,
           fmt::format("wavelengths must increase, but {} follows {}", wavelength, s.wavelengths.back()));
    s.wavelengths.push_back(wavelength);
    s.values.push_back(value);
  }
  if (s.values.size() < 2) fail(ErrorCode::kBadInput, text.second, "a sampled spectrum needs at least two pairs");
  return s;
}

Spectrum Parser::spectrum_file(const std::string& name, const Place& place) {
  const std::filesystem::path path = document_.find_file(name, place);
  const FileContents contents = inputs_.read(path, document_.loc(place));
  Spectrum s;
  int line_number = 0;
  for (std::string_view rest = skip_byte_order_mark(contents.view()); !rest.empty();) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    const std::string_view line = trim(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
    ++line_number;
    if (line.empty() || line[0] == '#') continue;
    const SourceLoc loc{path.string(), line_number, 1};
    std::vector<double> pair;
    if (!parse_numbers(line, pair) || pair.size() != 2)
      throw Error(ErrorCode::kBadInput, loc, "expected a wavelength (nm) and a value in each line");
    if (!s.wavelengths.empty() && pair[0] <= s.wavelengths.back())
      throw Error(ErrorCode::kBadInput, loc,
                  fmt::format("wavelengths must increase, but {} follows {}", pair[0], s.wavelengths.back()));
    s.wavelengths.push_back(pair[0]);
    s.values.push_back(pair[1]);
  }
  if (s.values.size() < 2)
    throw Error(ErrorCode::kBadInput, {path.string()},
                "a spectrum file needs at least two lines of wavelength and value");
  return s;
}

void Parser::transform_step(const pugi::xml_node& node, Affine3d& map) {
  const std::string_view tag = node.name();
  const Place at = place(node);
  Affine3d step;
  if (tag == "translate") {
    step = translate(vector3(attributes(node, {}, {"x", "y", "z", "value"}), 0, at));
  } else if (tag == "scale") {
    step = scale(vector3(attributes(node, {}, {"x", "y", "z", "value"}), 1, at));
  } else if (tag == "rotate") {
    const Attributes a = attributes(node, {"angle"}, {"x", "y", "z", "value"});
    const Vec3d axis = vector3(a, 0, at);
    if (length(axis) == 0)
      fail(ErrorCode::kOutOfRange, at, "the axis of a rotation must not be zero; e.g. <rotate y=\"1\" angle=\"90\"/>");
    step = rotation(axis_angle(normalize(axis), number(a.at("angle"), "the angle") * (kPiD / 180)));
  } else if (tag == "lookat" || tag == "lookAt") {
    const Attributes a = attributes(node, {"origin", "target"}, {"up"});
    const Vec3d origin = vector3(a.at("origin"), "origin"), target = vector3(a.at("target"), "target");
    Vec3d up;
    if (const auto u = a.find("up"); u != a.end()) up = vector3(u->second, "up");
    const Vec3d direction = normalize(target - origin);
    if (length(direction) == 0) fail(ErrorCode::kOutOfRange, at, "origin and target of a lookat must differ");
    if (length(up) == 0) up = Vec3d(Basis(Vec3f(direction)).s);
    if (length(cross(up, direction)) == 0)
      fail(ErrorCode::kOutOfRange, at, "the up vector of a lookat must not point along its direction of view");
    step = look_at(origin, target, up);
  } else if (tag == "matrix") {
    const Attributes a = attributes(node, {"value"}, {});
    const auto& value = a.at("value");
    std::vector<double> m;
    if (!parse_numbers(value.first, m))
      fail(ErrorCode::kBadInput, value.second, "a matrix must consist of finite numbers");
    if (m.size() != 16 && m.size() != 9)
      fail(ErrorCode::kBadInput, value.second,
           fmt::format("a matrix has 9 or 16 values, row by row, not {}", m.size()));
    const std::size_t n = m.size() == 16 ? 4 : 3;
    if (n == 4 && (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] == 0))
      fail(ErrorCode::kBadInput, value.second, "the last row of a matrix must be 0 0 0 1");
    const double w = n == 4 ? 1 / m[15] : 1;
    const auto column = [&](std::size_t i) { return Vec3d{m[i], m[n + i], m[2 * n + i]} * w; };
    step = {column(0), column(1), column(2), n == 4 ? column(3) : Vec3d{}};
  } else {
    fail(ErrorCode::kUnknownName, at,
         fmt::format("<{}> is no step of a transform; known: translate, rotate, scale, lookat, matrix", tag));
  }
  map = step * map;
  for (const Vec3d& v : {map.x, map.y, map.z, map.translation})
    if (!is_finite(v)) fail(ErrorCode::kOutOfRange, at, "this makes the transform infinite");
}

Affine3d Parser::transform(const pugi::xml_node& node) {
  Affine3d map;
  for (const pugi::xml_node& child : node.children())
    if (child.type() == pugi::node_element) transform_step(child, map);
  return map;
}

void Parser::add(Object& parent, std::string_view name, Value value, const Place& place) {
  std::string key = snake_case(name);
  if (!key.empty())
    for (const Property& p : parent.properties)
      if (p.name == key)
        fail(ErrorCode::kBadInput, place,
             fmt::format("{} has its parameter \"{}\" twice, here and at {}", parent.name(), key,
                         document_.loc(p.place).str()));
  parent.properties.push_back({std::move(key), std::move(value), place});
}

void Parser::include(const pugi::xml_node& node, Object& parent) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"filename"}, {"name"});
  const auto& name = a.at("filename");
  if (int(include_stack_.size()) >= kMaxIncludeDepth || ++include_count_ > kMaxIncludes)
    fail(ErrorCode::kBadInput, at,
         fmt::format("too many includes; at most {} inside each other and {} in all", kMaxIncludeDepth, kMaxIncludes));
  const std::filesystem::path path = document_.find_file(name.first, at);
  inputs_.check(path, document_.loc(name.second));
  const std::filesystem::path real = std::filesystem::weakly_canonical(path);
  if (std::find(include_stack_.begin(), include_stack_.end(), real) != include_stack_.end())
    fail(ErrorCode::kBadInput, name.second, fmt::format("\"{}\" includes itself", name.first));
  const std::shared_ptr<Object> holder = parse_file(path, document_.loc(name.second));
  // The parts of an included <scene> become parts of this object; any other root element is one part itself.
  const auto& root = std::get<ObjectPtr>(holder->properties.front().value);
  if (root->tag == "scene") {
    for (const Property& p : root->properties) parent.properties.push_back(p);
  } else {
    parent.properties.push_back({a.contains("name") ? snake_case(a.at("name").first) : "", root, at});
  }
}

void Parser::parse_object(const pugi::xml_node& node, Object& parent, int depth) {
  const bool is_root = depth == 0;
  const bool is_scene = node.name() == std::string_view("scene");
  const Attributes a = is_root    ? attributes(node, {"version"}, {"type", "id", "name"})
                       : is_scene ? attributes(node, {}, {"type", "id", "name"})
                                  : attributes(node, {"type"}, {"id", "name"});
  auto object = std::make_shared<Object>();
  object->tag = node.name();
  object->place = place(node);
  if (const auto type = a.find("type"); type != a.end()) object->plugin = type->second.first;
  if (const auto id = a.find("id"); id != a.end() && !id->second.first.empty()) {
    object->id = id->second.first;
    const auto [other, added] = document_.ids_.try_emplace(object->id, object);
    if (!added)
      fail(ErrorCode::kBadInput, id->second.second,
           fmt::format("the id \"{}\" is taken already, at {}", object->id, document_.loc(other->second->place).str()));
  }
  const auto name = a.find("name");
  add(parent, name == a.end() ? "" : name->second.first, ObjectPtr(object), object->place);
  parse_children(node, *object, depth);
}

void Parser::parse_children(const pugi::xml_node& node, Object& parent, int depth) {
  for (const pugi::xml_node& child : node.children())
    if (child.type() == pugi::node_element) parse_child(child, parent, depth + 1);
}

void Parser::parse_child(const pugi::xml_node& node, Object& parent, int depth) {
  const std::string_view tag = node.name();
  const Place at = place(node);
  if (depth > kMaxDepth)
    fail(ErrorCode::kBadInput, at, fmt::format("elements are nested more than {} deep", kMaxDepth));
  if (contains(kObjectTags, tag) || (tag == "spectrum" && node.attribute("type")))
    return parse_object(node, parent, depth);

  if (tag == "transform") {
    const Attributes a = attributes(node, {"name"}, {});
    return add(parent, a.at("name").first, Transform{transform(node), {}}, at);
  }
  if (tag == "animation") {
    const Attributes a = attributes(node, {"name"}, {});
    Transform animated;
    std::set<double> times;
    for (const pugi::xml_node& key : node.children()) {
      if (key.type() != pugi::node_element) continue;
      if (key.name() != std::string_view("transform"))
        fail(ErrorCode::kUnknownName, place(key),
             fmt::format("<{}> in an <animation>; expected <transform time=\"…\">", key.name()));
      const Attributes k = attributes(key, {"time"}, {});
      const double time = number(k.at("time"), "the time");
      const SourceLoc here = document_.loc(k.at("time").second);
      if (!times.insert(time).second)
        warnings_.add("an animation with several keys at one time steps there from the first to the last", here);
      if (!animated.keys.empty() && time < animated.keys.back().first)
        warnings_.add("an animation whose keys are not in the order of time is sorted", here);
      animated.keys.emplace_back(time, transform(key));
    }
    order_keys(animated.keys);
    if (animated.keys.empty())
      warnings_.add("an <animation> without a <transform time=\"…\"> moves nothing", document_.loc(at));
    else
      animated.constant = animated.keys.front().second;
    return add(parent, a.at("name").first, std::move(animated), at);
  }
  for (const pugi::xml_node& child : node.children())
    if (child.type() == pugi::node_element)
      fail(ErrorCode::kBadInput, place(child), fmt::format("<{}> cannot stand inside <{}>", child.name(), tag));

  if (tag == "float") {
    const Attributes a = attributes(node, {"name", "value"}, {});
    add(parent, a.at("name").first, number(a.at("value"), fmt::format("\"{}\"", a.at("name").first)),
        a.at("value").second);
  } else if (tag == "integer") {
    const Attributes a = attributes(node, {"name", "value"}, {});
    const auto& [text, where] = a.at("value");
    std::string_view digits = trim(text);
    if (digits.starts_with('+')) digits.remove_prefix(1);
    std::int64_t value = 0;
    const auto [end, failed] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (failed != std::errc() || end != digits.data() + digits.size())
      fail(ErrorCode::kBadInput, where, fmt::format("cannot read \"{}\" as an integer", text));
    add(parent, a.at("name").first, value, where);
  } else if (tag == "boolean") {
    const Attributes a = attributes(node, {"name", "value"}, {});
    std::string text = a.at("value").first;
    std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    if (text != "true" && text != "false")
      fail(ErrorCode::kBadInput, a.at("value").second, fmt::format("\"{}\" must be true or false", text));
    add(parent, a.at("name").first, text == "true", a.at("value").second);
  } else if (tag == "string") {
    const Attributes a = attributes(node, {"name", "value"}, {});
    add(parent, a.at("name").first, a.at("value").first, a.at("value").second);
  } else if (tag == "point" || tag == "vector") {
    const Attributes a = attributes(node, {"name"}, {"x", "y", "z", "value"});
    if (!a.contains("value"))
      for (const char* c : {"x", "y", "z"})
        if (!a.contains(c)) fail(ErrorCode::kBadInput, at, fmt::format("<{}> lacks its attribute \"{}\"", tag, c));
    add(parent, a.at("name").first, vector3(a, 0, at), at);
  } else if (tag == "rgb" || tag == "srgb") {
    const Attributes a = attributes(node, {"name", "value"}, {"intent"});
    const auto& [text, where] = a.at("value");
    Color color;
    std::vector<double> v;
    const std::string_view word = trim(text);
    unsigned hex = 0;
    if (word.size() == 7 && word[0] == '#' &&
        std::from_chars(word.data() + 1, word.data() + 7, hex, 16).ptr == word.data() + 7) {
      color.rgb = Vec3d(hex >> 16, hex >> 8 & 255, hex & 255) / 255.0;
    } else if (parse_numbers(text, v) && (v.size() == 1 || v.size() == 3)) {
      color.rgb = v.size() == 1 ? Vec3d{v[0], v[0], v[0]} : Vec3d{v[0], v[1], v[2]};
    } else {
      fail(ErrorCode::kBadInput, where,
           fmt::format("\"{}\" is no color; expected one or three finite numbers or #rrggbb", text));
    }
    if (tag == "srgb")
      for (int i = 0; i < 3; ++i) color.rgb[i] = srgb_to_linear(color.rgb[i]);
    add(parent, a.at("name").first, color, where);
  } else if (tag == "spectrum") {
    const Attributes a = attributes(node, {"name"}, {"value", "filename", "intent"});
    if (a.contains("value") == a.contains("filename"))
      fail(ErrorCode::kBadInput, at, "<spectrum> needs either \"value\" or \"filename\"");
    const auto& source = a.contains("value") ? a.at("value") : a.at("filename");
    std::vector<double> v;  // 0.6 takes three plain numbers for RGB
    if (a.contains("value") && document_.is_legacy(at) && parse_numbers(source.first, v) && v.size() == 3)
      return add(parent, a.at("name").first, Color{{v[0], v[1], v[2]}}, source.second);
    add(parent, a.at("name").first, a.contains("value") ? spectrum(source) : spectrum_file(source.first, source.second),
        source.second);
  } else if (tag == "blackbody") {
    const Attributes a = attributes(node, {"name", "temperature"}, {"scale"});
    auto temperature = a.at("temperature");
    if (temperature.first.ends_with('K') || temperature.first.ends_with('k')) temperature.first.pop_back();
    Blackbody body{number(temperature, "the temperature"),
                   a.contains("scale") ? number(a.at("scale"), "the scale") : 1.0};
    add(parent, a.at("name").first, body, temperature.second);
  } else if (tag == "ref") {
    const Attributes a = attributes(node, {"id"}, {"name"});
    const auto& [id, where] = a.at("id");
    document_.referenced_.try_emplace(id, where);
    add(parent, a.contains("name") ? a.at("name").first : "", Reference{id}, where);
  } else if (tag == "alias") {
    const Attributes a = attributes(node, {"id", "as"}, {});
    const auto found = document_.ids_.find(a.at("id").first);
    if (found == document_.ids_.end()) fail_unknown_id(a.at("id").first, a.at("id").second);
    if (!document_.ids_.try_emplace(a.at("as").first, found->second).second)
      fail(ErrorCode::kBadInput, a.at("as").second, fmt::format("the id \"{}\" is taken already", a.at("as").first));
  } else if (tag == "default") {
    const Attributes a = attributes(node, {"name", "value"}, {});
    const auto& [name, where] = a.at("name");
    if (name.empty()) fail(ErrorCode::kBadInput, where, "a <default> needs a name");
    parameters_.try_emplace(name, Parameter{a.at("value").first, false, false});
  } else if (tag == "include") {
    include(node, parent);
  } else if (tag == "path") {
    const Attributes a = attributes(node, {"value"}, {});
    const auto& [name, where] = a.at("value");
    std::filesystem::path folder = named_file(document_.files_[file_].path.parent_path(), name);
    if (!std::filesystem::is_directory(folder)) folder = document_.find_file(name, at);
    if (!std::filesystem::is_directory(folder))
      fail(ErrorCode::kMissingFile, where, fmt::format("cannot find the folder \"{}\"", name));
    document_.folders_.insert(document_.folders_.begin(), folder);
  } else {
    std::vector<std::string> known;
    for (const auto* list : {kObjectTags.begin(), kOtherTags.begin()}) {
      const std::size_t n = list == kObjectTags.begin() ? kObjectTags.size() : kOtherTags.size();
      for (std::size_t i = 0; i < n; ++i) known.emplace_back(list[i]);
    }
    fail(ErrorCode::kUnknownName, at,
         contains(kTransformTags, tag)
             ? fmt::format("<{}> can only stand inside <transform>", tag)
             : fmt::format("unknown element <{}>; known: {}", tag, nearest_names(tag, known)));
  }
}

// ---------------------------------------------------------------------------------------------------------------------

Document::Document(const std::filesystem::path& file, const std::vector<std::pair<std::string, std::string>>& defines,
                   InputFiles& inputs, Warnings& warnings) {
  folders_.push_back(file.parent_path());
  Parser parser(*this, defines, inputs, warnings);
  const std::shared_ptr<Object> holder = parser.parse_file(file, {file.string()});
  scene_ = std::get<ObjectPtr>(holder->properties.front().value);
  if (scene_->tag != "scene")
    throw Error(ErrorCode::kBadInput, loc(scene_->place),
                fmt::format("the root element is <{}>; a scene that can be rendered starts with <scene>", scene_->tag));
  parser.finish();
}

const Object& Document::resolve(const Property& property) const {
  if (const auto* reference = std::get_if<Reference>(&property.value)) return *ids_.find(reference->id)->second;
  return *std::get<ObjectPtr>(property.value);
}

SourceLoc Document::loc(const Place& place) const {
  const File& file = files_[place.file];
  const auto line = std::upper_bound(file.line_starts.begin(), file.line_starts.end(), place.offset) - 1;
  return {file.path.string(), int(line - file.line_starts.begin()) + 1, int(place.offset - *line) + 1};
}

std::filesystem::path Document::find_file(const std::string& name, const Place& place) const {
  std::error_code failed;
  for (const std::filesystem::path& folder : folders_)
    if (std::filesystem::path file = named_file(folder, name); std::filesystem::exists(file, failed)) return file;
  // Parts that were included may also count from their own folder.
  std::filesystem::path sibling = named_file(files_[place.file].path.parent_path(), name);
  return std::filesystem::exists(sibling, failed) ? sibling : named_file(folders_.back(), name);
}

}  // namespace tempera::mitsuba
