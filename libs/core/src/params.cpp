// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/params.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>

namespace tempera {

std::string to_text(const ParamValue& value) {
  struct Visitor {
    std::string operator()(bool b) const { return b ? "true" : "false"; }
    std::string operator()(int i) const { return fmt::format("{}", i); }
    std::string operator()(double d) const { return fmt::format("{}", d); }
    std::string operator()(const std::string& s) const { return s; }
  };
  return std::visit(Visitor{}, value);
}

std::string type_name(const ParamValue& value) {
  static const char* const names[] = {"bool", "integer", "number", "string"};
  return names[value.index()];
}

std::string with_article(const std::string& noun) {
  return (std::string_view("aeiou").find(noun.front()) == std::string_view::npos ? "a " : "an ") + noun;
}

const ParamSpec& Params::spec(const std::string& name, const SourceLoc& loc) const {
  for (const ParamSpec& s : specs_) {
    if (s.name == name) return s;
  }
  std::vector<std::string> names;
  for (const ParamSpec& s : specs_) names.push_back(s.name);
  throw Error(ErrorCode::kUnknownName, loc,
              fmt::format("unknown parameter \"{}\"; known: {}", name, nearest_names(name, names, 32)));
}

void Params::set(const std::string& name, ParamValue value, const SourceLoc& loc) {
  const ParamSpec& s = spec(name, loc);
  if (std::holds_alternative<double>(s.fallback) && std::holds_alternative<int>(value))
    value = double(std::get<int>(value));
  if (value.index() != s.fallback.index()) {
    throw Error(ErrorCode::kBadInput, loc,
                fmt::format("{} = {} is {}; expected {}", name, to_text(value), with_article(type_name(value)),
                            with_article(type_name(s.fallback))));
  }
  if (const auto* text = std::get_if<std::string>(&value); text && !s.choices.empty()) {
    bool known = false;
    for (const auto& c : s.choices) known |= c == *text;
    if (!known) {
      throw Error(
          ErrorCode::kUnknownName, loc,
          fmt::format("{} = \"{}\" is not known; one of: {}", name, *text, nearest_names(*text, s.choices, 32)));
    }
  }
  double number = 0;
  if (const auto* i = std::get_if<int>(&value)) number = *i;
  if (const auto* d = std::get_if<double>(&value)) number = *d;
  const bool numeric = value.index() == 1 || value.index() == 2;
  if (numeric && !(number >= s.min && number <= s.max)) {
    const std::string range =
        s.max < 1e300 ? fmt::format("between {} and {}", s.min, s.max) : fmt::format("at least {}", s.min);
    throw Error(ErrorCode::kOutOfRange, loc, fmt::format("{} = {} is out of range; must be {}", name, number, range));
  }
  values_[name] = std::move(value);
}

void Params::set_text(const std::string& name, const std::string& text, const SourceLoc& loc) {
  const ParamSpec& s = spec(name, loc);
  const auto fail = [&]() -> Error {
    static const char* const kinds[] = {"true or false", "an integer", "a number", "a string"};
    return Error(ErrorCode::kBadInput, loc,
                 fmt::format("{} = \"{}\" is not {}", name, text, kinds[s.fallback.index()]));
  };
  if (std::holds_alternative<std::string>(s.fallback)) return set(name, text, loc);
  if (std::holds_alternative<bool>(s.fallback)) {
    if (text == "true" || text == "1" || text == "on" || text == "yes") return set(name, true, loc);
    if (text == "false" || text == "0" || text == "off" || text == "no") return set(name, false, loc);
    throw fail();
  }
  const char* end = text.data() + text.size();
  if (std::holds_alternative<int>(s.fallback)) {
    int v = 0;
    const auto r = std::from_chars(text.data(), end, v);
    if (r.ec != std::errc() || r.ptr != end) throw fail();
    return set(name, v, loc);
  }
  double v = 0;
  const auto r = std::from_chars(text.data(), end, v);
  if (r.ec != std::errc() || r.ptr != end || !std::isfinite(v)) throw fail();
  set(name, v, loc);
}

bool Params::has(const std::string& name) const { return values_.contains(name); }

const ParamValue& Params::value(const std::string& name) const {
  const auto it = values_.find(name);
  return it != values_.end() ? it->second : spec(name, {}).fallback;
}
bool Params::get_bool(const std::string& name) const { return std::get<bool>(value(name)); }
int Params::get_int(const std::string& name) const { return std::get<int>(value(name)); }
double Params::get_double(const std::string& name) const { return std::get<double>(value(name)); }
const std::string& Params::get_string(const std::string& name) const { return std::get<std::string>(value(name)); }

std::string Params::canonical() const {
  std::string out;
  for (const ParamSpec& s : specs_) {
    out += (out.empty() ? "" : ",") + s.name + "=" + to_text(value(s.name));
  }
  return out;
}

}  // namespace tempera
