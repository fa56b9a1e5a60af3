// SPDX-License-Identifier: Apache-2.0
// Elements that hold a value, and the steps of transforms.
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>

#include "mitsuba_parser.h"
#include "tempera/import/paths.h"

namespace tempera::mitsuba {
namespace {

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

Affine3d Parser::translate_step(const pugi::xml_node& node) {
  return translate(vector3(attributes(node, {}, {"x", "y", "z", "value"}), 0, place(node)));
}

Affine3d Parser::scale_step(const pugi::xml_node& node) {
  return scale(vector3(attributes(node, {}, {"x", "y", "z", "value"}), 1, place(node)));
}

Affine3d Parser::rotate_step(const pugi::xml_node& node) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"angle"}, {"x", "y", "z", "value"});
  const Vec3d axis = vector3(a, 0, at);
  if (length(axis) == 0)
    fail(ErrorCode::kOutOfRange, at, "the axis of a rotation must not be zero; e.g. <rotate y=\"1\" angle=\"90\"/>");
  return rotation(axis_angle(normalize(axis), number(a.at("angle"), "the angle") * (kPiD / 180)));
}

Affine3d Parser::look_at_step(const pugi::xml_node& node) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"origin", "target"}, {"up"});
  const Vec3d origin = vector3(a.at("origin"), "origin"), target = vector3(a.at("target"), "target");
  Vec3d up;
  if (const auto u = a.find("up"); u != a.end()) up = vector3(u->second, "up");
  const Vec3d direction = normalize(target - origin);
  if (length(direction) == 0) fail(ErrorCode::kOutOfRange, at, "origin and target of a lookat must differ");
  if (length(up) == 0) up = Vec3d(Basis(Vec3f(direction)).s);
  if (length(cross(up, direction)) == 0)
    fail(ErrorCode::kOutOfRange, at, "the up vector of a lookat must not point along its direction of view");
  return look_at(origin, target, up);
}

Affine3d Parser::matrix_step(const pugi::xml_node& node) {
  const Attributes a = attributes(node, {"value"}, {});
  const auto& value = a.at("value");
  std::vector<double> m;
  if (!parse_numbers(value.first, m))
    fail(ErrorCode::kBadInput, value.second, "a matrix must consist of finite numbers");
  if (m.size() != 16 && m.size() != 9)
    fail(ErrorCode::kBadInput, value.second, fmt::format("a matrix has 9 or 16 values, row by row, not {}", m.size()));
  const std::size_t n = m.size() == 16 ? 4 : 3;
  if (n == 4 && (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] == 0))
    fail(ErrorCode::kBadInput, value.second, "the last row of a matrix must be 0 0 0 1");
  const double w = n == 4 ? 1 / m[15] : 1;
  const auto column = [&](std::size_t i) { return Vec3d{m[i], m[n + i], m[2 * n + i]} * w; };
  return {column(0), column(1), column(2), n == 4 ? column(3) : Vec3d{}};
}

void Parser::transform_step(const pugi::xml_node& node, Affine3d& map) {
  const auto* step = find_named(kSteps, node.name());
  if (!step)
    fail(ErrorCode::kUnknownName, place(node),
         fmt::format("<{}> is no step of a transform; known: {}", node.name(), names_of(kSteps)));
  const Affine3d next = (this->*step->value)(node);
  map = next * map;
  for (const Vec3d& v : {map.x, map.y, map.z, map.translation})
    if (!is_finite(v)) fail(ErrorCode::kOutOfRange, place(node), "this makes the transform infinite");
}

Affine3d Parser::transform(const pugi::xml_node& node) {
  Affine3d map;
  for (const pugi::xml_node& child : node.children())
    if (child.type() == pugi::node_element) transform_step(child, map);
  return map;
}

void Parser::parse_transform(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name"}, {});
  add(parent, a.at("name").first, Transform{transform(node), {}}, place(node));
}

void Parser::parse_animation(const pugi::xml_node& node, Object& parent) {
  const Place at = place(node);
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
  add(parent, a.at("name").first, std::move(animated), at);
}

void Parser::parse_float(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name", "value"}, {});
  add(parent, a.at("name").first, number(a.at("value"), fmt::format("\"{}\"", a.at("name").first)),
      a.at("value").second);
}

void Parser::parse_integer(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name", "value"}, {});
  const auto& [text, where] = a.at("value");
  std::string_view digits = trim(text);
  if (digits.starts_with('+')) digits.remove_prefix(1);
  std::int64_t value = 0;
  const auto [end, failed] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (failed != std::errc() || end != digits.data() + digits.size())
    fail(ErrorCode::kBadInput, where, fmt::format("cannot read \"{}\" as an integer", text));
  add(parent, a.at("name").first, value, where);
}

void Parser::parse_boolean(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name", "value"}, {});
  const std::string text = lower_case(a.at("value").first);
  if (text != "true" && text != "false")
    fail(ErrorCode::kBadInput, a.at("value").second, fmt::format("\"{}\" must be true or false", text));
  add(parent, a.at("name").first, text == "true", a.at("value").second);
}

void Parser::parse_string(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name", "value"}, {});
  add(parent, a.at("name").first, a.at("value").first, a.at("value").second);
}

void Parser::parse_vector(const pugi::xml_node& node, Object& parent) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"name"}, {"x", "y", "z", "value"});
  if (!a.contains("value"))
    for (const char* c : {"x", "y", "z"})
      if (!a.contains(c))
        fail(ErrorCode::kBadInput, at, fmt::format("<{}> lacks its attribute \"{}\"", node.name(), c));
  add(parent, a.at("name").first, vector3(a, 0, at), at);
}

void Parser::parse_color(const pugi::xml_node& node, Object& parent) {
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
  if (node.name() == std::string_view("srgb"))
    for (int i = 0; i < 3; ++i) color.rgb[i] = srgb_to_linear(color.rgb[i]);
  add(parent, a.at("name").first, color, where);
}

void Parser::parse_spectrum(const pugi::xml_node& node, Object& parent) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"name"}, {"value", "filename", "intent"});
  if (a.contains("value") == a.contains("filename"))
    fail(ErrorCode::kBadInput, at, "<spectrum> needs either \"value\" or \"filename\"");
  const auto& source = a.contains("value") ? a.at("value") : a.at("filename");
  std::vector<double> v;  // 0.6 takes three plain numbers for RGB
  if (a.contains("value") && document_.is_legacy(at) && parse_numbers(source.first, v) && v.size() == 3)
    return add(parent, a.at("name").first, Color{{v[0], v[1], v[2]}}, source.second);
  add(parent, a.at("name").first, a.contains("value") ? spectrum(source) : spectrum_file(source.first, source.second),
      source.second);
}

void Parser::parse_blackbody(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"name", "temperature"}, {"scale"});
  auto temperature = a.at("temperature");
  if (temperature.first.ends_with('K') || temperature.first.ends_with('k')) temperature.first.pop_back();
  Blackbody body{number(temperature, "the temperature"),
                 a.contains("scale") ? number(a.at("scale"), "the scale") : 1.0};
  add(parent, a.at("name").first, body, temperature.second);
}

void Parser::parse_reference(const pugi::xml_node& node, Object& parent) {
  const Attributes a = attributes(node, {"id"}, {"name"});
  const auto& [id, where] = a.at("id");
  document_.referenced_.try_emplace(id, where);
  add(parent, a.contains("name") ? a.at("name").first : "", Reference{id}, where);
}

void Parser::parse_alias(const pugi::xml_node& node, Object&) {
  const Attributes a = attributes(node, {"id", "as"}, {});
  const auto found = document_.ids_.find(a.at("id").first);
  if (found == document_.ids_.end()) fail_unknown_id(a.at("id").first, a.at("id").second);
  if (!document_.ids_.try_emplace(a.at("as").first, found->second).second)
    fail(ErrorCode::kBadInput, a.at("as").second, fmt::format("the id \"{}\" is taken already", a.at("as").first));
}

void Parser::parse_default(const pugi::xml_node& node, Object&) {
  const Attributes a = attributes(node, {"name", "value"}, {});
  const auto& [name, where] = a.at("name");
  if (name.empty()) fail(ErrorCode::kBadInput, where, "a <default> needs a name");
  parameters_.try_emplace(name, Parameter{a.at("value").first, false, false});
}

void Parser::parse_path(const pugi::xml_node& node, Object&) {
  const Place at = place(node);
  const Attributes a = attributes(node, {"value"}, {});
  const auto& [name, where] = a.at("value");
  std::filesystem::path folder = named_file(document_.files_[file_].path.parent_path(), name);
  if (!std::filesystem::is_directory(folder)) folder = document_.find_file(name, at);
  if (!std::filesystem::is_directory(folder))
    fail(ErrorCode::kMissingFile, where, fmt::format("cannot find the folder \"{}\"", name));
  document_.folders_.insert(document_.folders_.begin(), folder);
}

}  // namespace tempera::mitsuba
