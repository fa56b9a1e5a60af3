// SPDX-License-Identifier: Apache-2.0
#pragma once
// Parameter tables: one table per integrator, stage or command feeds its parser, `tempera list`, --help and the manual,
// so that they cannot disagree. Values carry the place they came from into every message.
#include <map>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "tempera/core/error.h"

namespace tempera {

using ParamValue = std::variant<bool, int, double, std::string>;

/// One row of a parameter table. The default's type is the parameter's type.
struct ParamSpec {
  std::string name;
  ParamValue fallback;
  std::string help;
  double min = -1e300, max = 1e300;    ///< valid range of numbers, inclusive
  std::vector<std::string> choices{};  ///< valid values of a string; empty: any
};

/// Values checked against a table: every name known, every value of the right type and in range.
class Params {
 public:
  Params() = default;
  explicit Params(std::span<const ParamSpec> specs) : specs_(specs.begin(), specs.end()) {}

  /// Sets `name`; an int is accepted where a double is expected.
  /// Errors: Error{kUnknownName} with the known names, Error{kBadInput} for a wrong type, Error{kOutOfRange}, at `loc`.
  void set(const std::string& name, ParamValue value, const SourceLoc& loc = {});
  /// Sets from text ("true", "12", "0.5", "name"), converted to the parameter's type. Errors as `set`.
  void set_text(const std::string& name, const std::string& text, const SourceLoc& loc = {});

  bool get_bool(const std::string& name) const;
  int get_int(const std::string& name) const;
  double get_double(const std::string& name) const;
  const std::string& get_string(const std::string& name) const;
  bool has(const std::string& name) const;
  std::span<const ParamSpec> specs() const { return specs_; }
  /// "name=value,..." of all parameters in table order: the canonical form for metadata and for comparing settings.
  std::string canonical() const;

 private:
  const ParamSpec& spec(const std::string& name, const SourceLoc& loc) const;
  const ParamValue& value(const std::string& name) const;
  std::vector<ParamSpec> specs_;
  std::map<std::string, ParamValue> values_;
};

/// The text of a value as `set_text` reads it.
std::string to_text(const ParamValue& value);
/// "bool", "integer", "number" or "string".
std::string type_name(const ParamValue& value);
/// "a number", "an integer".
std::string with_article(const std::string& noun);

}  // namespace tempera
