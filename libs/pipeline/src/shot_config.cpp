// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/shot_config.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <limits>

#include "tempera/frames/files.h"
#include "tempera/import/paths.h"

namespace tempera {

std::string join_key(const KeyPath& key) {
  std::string s;
  for (const std::string& part : key) {
    const bool plain = !part.empty() && std::all_of(part.begin(), part.end(), [](unsigned char c) {
      return std::isalnum(c) || c == '_' || c == '-';
    });
    if (!s.empty()) s += '.';
    s += plain ? part : fmt::format("\"{}\"", part);
  }
  return s;
}

namespace {
std::string_view trimmed(std::string_view text) {
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.front()))) text.remove_prefix(1);
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.remove_suffix(1);
  return text;
}
}  // namespace

KeyPath parse_key(std::string_view text, const SourceLoc& loc) {
  const auto fail = [&] {
    return Error(
        ErrorCode::kSyntax, loc,
        fmt::format("cannot read the key \"{}\"; write for example film.resolution or materials.\"My Glass\".ior",
                    text));
  };
  KeyPath key;
  std::string_view rest = trimmed(text);
  for (;;) {
    std::string_view part;
    if (rest.starts_with('"') || rest.starts_with('\'')) {
      const auto end = rest.find(rest.front(), 1);
      if (end == std::string_view::npos) throw fail();
      part = rest.substr(1, end - 1);
      rest.remove_prefix(end + 1);
    } else {
      const auto end = std::min(rest.find('.'), rest.size());
      part = trimmed(rest.substr(0, end));
      rest.remove_prefix(end);
    }
    if (part.empty()) throw fail();
    key.emplace_back(part);
    rest = trimmed(rest);
    if (rest.empty()) return key;
    if (rest.front() != '.') throw fail();
    rest = trimmed(rest.substr(1));
  }
}

namespace {

const ShotKey* find_key(const std::string& dotted) {
  for (const ShotKey& k : shot_keys()) {
    if (k.spec.name == dotted) return &k;
  }
  return nullptr;
}

const OpenTable* find_table(const std::string& name) {
  for (const OpenTable& t : shot_tables()) {
    if (t.name == name) return &t;
  }
  return nullptr;
}

/// The keys nearest to one that does not exist.
std::string known_keys(const KeyPath& wanted) {
  if (const OpenTable* t = find_table(wanted[0]); t && wanted[0] != "integrator") {
    return fmt::format("keys of this table are {}.<{}>{}", t->name, t->key_name, t->depth == 2 ? ".<parameter>" : "");
  }
  std::vector<std::string> names, of_table;
  for (const ShotKey& k : shot_keys()) {
    names.push_back(k.spec.name);
    if (wanted.size() > 1 && k.spec.name.starts_with(wanted[0] + ".")) of_table.push_back(k.spec.name);
  }
  if (!of_table.empty()) return "known: " + nearest_names(join_key(wanted), of_table, of_table.size());
  for (const OpenTable& t : shot_tables()) names.push_back(t.name);
  return "known: " + nearest_names(join_key(wanted), names, 5);
}

Error unknown_table(const KeyPath& wanted, const SourceLoc& loc) {
  std::vector<std::string> names;
  for (const ShotKey& k : shot_keys()) {
    const std::string table = k.spec.name.substr(0, k.spec.name.find('.'));
    if (table != k.spec.name && (names.empty() || names.back() != table)) names.push_back(table);
  }
  for (const OpenTable& t : shot_tables()) {
    if (std::find(names.begin(), names.end(), t.name) == names.end()) names.push_back(t.name);
  }
  return Error(
      ErrorCode::kUnknownName, loc,
      fmt::format("unknown table [{}]; known: {}", join_key(wanted), nearest_names(join_key(wanted), names, 5)));
}

SourceLoc place(const std::string& file, const toml::source_region& region) {
  return {file, int(region.begin.line), int(region.begin.column)};
}

const char* kind(const toml::node& node) {
  switch (node.type()) {
    case toml::node_type::table:
      return "a table";
    case toml::node_type::array:
      return "an array";
    case toml::node_type::date:
    case toml::node_type::time:
    case toml::node_type::date_time:
      return "a date or time";
    default:
      return "a value";
  }
}

/// A scalar as it is. Errors: Error{kBadInput | kOutOfRange} at `loc`.
ParamValue scalar(const toml::node& node, const std::string& key, const SourceLoc& loc) {
  if (const auto* v = node.as_string()) return v->get();
  if (const auto* v = node.as_boolean()) return v->get();
  if (const auto* v = node.as_floating_point()) return v->get();
  if (const auto* v = node.as_integer()) {
    if (v->get() < std::numeric_limits<int>::min() || v->get() > std::numeric_limits<int>::max()) {
      throw Error(ErrorCode::kOutOfRange, loc, fmt::format("{} = {} does not fit into 32 bits", key, v->get()));
    }
    return int(v->get());
  }
  throw Error(ErrorCode::kBadInput, loc,
              fmt::format("{} is {}; expected a number, a string or a bool", key, kind(node)));
}

}  // namespace

/// A node with what messages about it name as its places; on the command line that is the same for all nodes.
struct ShotConfig::Node {
  const toml::node& toml;
  std::string file;
  SourceLoc key_loc;
  bool in_file = true;

  SourceLoc loc(const toml::node& of) const { return in_file ? place(file, of.source()) : key_loc; }
};

void ShotConfig::read_file(const std::filesystem::path& file) {
  read_text(tempera::read_file(file.string()), file.string(), file.parent_path());
  file_ = file;
}

void ShotConfig::read_text(std::string_view text, const std::string& file, const std::filesystem::path& folder) {
  folder_ = folder;
  toml::table root;
  try {
    root = toml::parse(text, file);
  } catch (const toml::parse_error& e) {
    throw Error(ErrorCode::kSyntax, place(file, e.source()), std::string(e.description()));
  }
  for (const auto& [name, node] : root) set_node({std::string(name.str())}, {node, file, place(file, name.source())});
}

void ShotConfig::set_node(const KeyPath& key, const Node& node) {
  const OpenTable* open = find_table(key[0]);
  const std::string dotted = join_key(key);
  if (const auto* inner = node.toml.as_table()) {
    if (key.size() > std::size_t(open ? open->depth : 1)) throw unknown_table(key, node.key_loc);
    if (!open && std::none_of(shot_keys().begin(), shot_keys().end(),
                              [&](const ShotKey& k) { return k.spec.name.starts_with(key[0] + "."); })) {
      throw unknown_table(key, node.key_loc);
    }
    for (const auto& [name, value] : *inner) {
      KeyPath longer = key;
      longer.emplace_back(name.str());
      set_node(longer, {value, node.file, node.in_file ? place(node.file, name.source()) : node.key_loc, node.in_file});
    }
    return;
  }
  const SourceLoc loc = node.loc(node.toml);
  if (const auto* array = node.toml.as_array()) {
    const ShotKey* fixed = find_key(dotted);
    if (fixed && !fixed->list) {
      throw Error(ErrorCode::kBadInput, loc,
                  fmt::format("{} is an array; expected {}", dotted, with_article(type_name(fixed->spec.fallback))));
    }
    const bool keyframes = fixed ? fixed->keyframes : open && open->depth == 2;
    const auto joined = [&](auto&& self, const toml::array& list, char separator) -> std::string {
      std::string text;  // as --set has it without brackets
      for (const toml::node& element : list) {
        if (!text.empty()) text += separator;
        const auto* pair = separator == ',' && keyframes ? element.as_array() : nullptr;
        text += pair ? self(self, *pair, ':') : to_text(scalar(element, dotted, node.loc(element)));
      }
      return text;
    };
    const std::string text = fixed || open ? joined(joined, *array, ',') : "";
    std::vector<SourceLoc> elements;
    for (const toml::node& element : *array) elements.push_back(node.loc(element));
    set(key, {text, loc, false, std::move(elements)}, node.key_loc);
    return;
  }
  set(key, {scalar(node.toml, dotted, loc), loc}, node.key_loc);
}

void ShotConfig::set(const KeyPath& key, const ShotValue& value, const SourceLoc& key_loc) {
  const std::string dotted = join_key(key);
  if (const ShotKey* fixed = find_key(dotted)) {
    Params check(std::span(&fixed->spec, 1));
    // A list of one number may be written without brackets.
    const bool number = fixed->list && !std::holds_alternative<std::string>(value.value);
    if (value.is_text || number) {
      check.set_text(dotted, to_text(value.value), value.loc);
    } else {
      check.set(dotted, value.value, value.loc);
    }
    ShotValue& out = values_[key];
    out.loc = value.loc, out.elements = value.elements;
    switch (fixed->spec.fallback.index()) {
      case 0:
        out.value = check.get_bool(dotted);
        break;
      case 1:
        out.value = check.get_int(dotted);
        break;
      case 2:
        out.value = check.get_double(dotted);
        break;
      default:
        out.value = check.get_string(dotted);
    }
    if (value.loc.line > 0) file_values_[key] = out;  // only files have lines
    return;
  }
  const OpenTable* open = find_table(key[0]);
  if (!open || key.size() != std::size_t(open->depth) + 1) {
    throw Error(ErrorCode::kUnknownName, key_loc, fmt::format("unknown key \"{}\"; {}", dotted, known_keys(key)));
  }
  values_[key] = value;
}

void ShotConfig::set_text(const std::string& key, const std::string& text, const SourceLoc& loc) {
  set(parse_key(key, loc), {text, loc, true}, loc);
}

void ShotConfig::assign(const std::string& assignment, const SourceLoc& loc) {
  // The first '=' outside of quotes: names of materials may hold one.
  char quote = 0;
  std::size_t equals = 0;
  for (; equals < assignment.size() && (quote != 0 || assignment[equals] != '='); ++equals) {
    const char c = assignment[equals];
    if (quote != 0 ? c == quote : c == '"' || c == '\'') quote = quote != 0 ? char(0) : c;
  }
  if (equals == 0 || equals >= assignment.size()) {
    throw Error(ErrorCode::kUsage, loc, fmt::format("\"{}\" is not of the form key=value", assignment));
  }
  const KeyPath key = parse_key(std::string_view(assignment).substr(0, equals), loc);
  const std::string text(trimmed(std::string_view(assignment).substr(equals + 1)));
  const bool is_toml = !text.empty() && std::string_view("[{\"'").find(text[0]) != std::string_view::npos;
  toml::table parsed;
  try {
    parsed = toml::parse("value = " + text);
  } catch (const toml::parse_error& e) {
    if (is_toml) {
      throw Error(ErrorCode::kSyntax, loc,
                  fmt::format("cannot read the value of {}: {}", join_key(key), e.description()));
    }
  }
  if (is_toml) {
    if (parsed.size() != 1) {
      throw Error(ErrorCode::kUsage, loc, fmt::format("\"{}\" is more than one key=value", assignment));
    }
    set_node(key, {*parsed.get("value"), "", loc, false});
    return;
  }
  // Numbers in the spellings of TOML: 1_000, 0xff, +1. A name that looks like one stays as it is.
  const ShotKey* fixed = find_key(join_key(key));
  const bool is_name = key[0] == "define" || (fixed && std::holds_alternative<std::string>(fixed->spec.fallback));
  const toml::node* number = is_name || parsed.size() != 1 ? nullptr : parsed.get("value");
  const bool converts = number && number->is_number() && text.find_first_of("_xobXOB+") != std::string::npos;
  set(key, {converts ? to_text(scalar(*number, join_key(key), loc)) : text, loc, true}, loc);
}

const ShotValue* ShotConfig::find(const std::string& key) const {
  const auto it = values_.find(parse_key(key));
  return it == values_.end() ? nullptr : &it->second;
}

const ShotValue* ShotConfig::find_in_file(const std::string& key) const {
  const auto it = file_values_.find(parse_key(key));
  return it == file_values_.end() ? nullptr : &it->second;
}

std::map<KeyPath, ShotValue> ShotConfig::table(const std::string& name) const {
  std::map<KeyPath, ShotValue> out;
  for (const auto& [key, value] : values_) {
    if (key[0] == name && key.size() > 1 && !find_key(join_key(key))) out[KeyPath(key.begin() + 1, key.end())] = value;
  }
  return out;
}

const ParamValue& ShotConfig::fallback(const std::string& key) {
  const ShotKey* k = find_key(key);
  TEMPERA_ASSERT(k);
  return k->spec.fallback;
}

const ParamValue& ShotConfig::get(const std::string& key) const {
  const ShotValue* v = find(key);
  return v ? v->value : fallback(key);
}

SourceLoc ShotConfig::loc(const std::string& key) const {
  const ShotValue* v = find(key);
  return v ? v->loc : SourceLoc{};
}

SourceLoc ShotConfig::loc(const std::string& key, std::size_t i) const {
  const ShotValue* v = find(key);
  return v && i < v->elements.size() ? v->elements[i] : loc(key);
}

std::filesystem::path ShotConfig::input_path(const ShotValue& value) const {
  const std::string& name = std::get<std::string>(value.value);
  if (value.loc.line == 0) return name;  // only files have lines
  std::filesystem::path path = named_file(folder_, name);
  if (sandbox_) {
    std::error_code failed;
    const auto inside = std::filesystem::weakly_canonical(folder_.empty() ? "." : folder_, failed);
    const auto target = std::filesystem::weakly_canonical(path, failed);
    const auto [end, rest] = std::mismatch(inside.begin(), inside.end(), target.begin(), target.end());
    if (failed || end != inside.end()) {
      throw Error(ErrorCode::kBadInput, value.loc,
                  fmt::format("\"{}\" lies outside of the folder of the shot, which --sandbox forbids", name));
    }
  }
  return path;
}

std::filesystem::path ShotConfig::input_path(const std::string& key) const {
  const ShotValue* v = find(key);
  return v ? input_path(*v) : std::filesystem::path(std::get<std::string>(fallback(key)));
}

}  // namespace tempera
