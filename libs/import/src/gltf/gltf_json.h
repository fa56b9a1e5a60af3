// SPDX-License-Identifier: Apache-2.0
#pragma once
// A JSON document that remembers where each value stands, so that every complaint about it names file, line and column.
// nlohmann-json does the grammar; its own tree forgets positions, so its event parser (which does not recurse, whatever
// the nesting) fills this one. Not a general JSON library: read only, and every access checks the type.
#include <fmt/format.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "named.h"
#include "tempera/core/error.h"

namespace tempera {

class JsonDocument;

/// A value of a document, or the absence of one (a missing member; its place is then the object that lacks it).
/// Getters throw Error{kBadInput} at the value, with its JSON pointer, when it has another type or range than asked
/// for.
class Json {
 public:
  Json() = default;

  explicit operator bool() const { return document_ != nullptr && !missing_; }
  bool is_object() const;
  bool is_array() const;
  bool is_string() const;

  /// Member `key` of an object. Errors: this is neither an object nor missing.
  Json operator[](std::string_view key) const;
  /// Element of an array, or member in document order.
  Json at(std::size_t i) const;
  /// Number of elements or members; 0 if missing. Errors: not a container.
  std::size_t size() const;
  /// Key of a member of an object.
  std::string_view key() const;

  /// Throws Error{kBadInput} at the enclosing object if this is missing; returns itself otherwise.
  const Json& required() const;
  const Json& object() const;  ///< missing passes
  const Json& array() const;   ///< missing passes
  bool boolean(bool fallback) const;
  double number(double fallback) const;
  /// A number in [min, max]; the range is part of the message.
  double number(double fallback, double min, double max) const;
  std::string_view string(std::string_view fallback = {}) const;
  /// A whole number in [0, 2^53].
  std::uint64_t integer(std::uint64_t fallback) const;
  /// An index below `size` of the document's array `target`, e.g. "accessors". Required.
  int index(std::size_t size, std::string_view target) const;
  /// As `index`, or -1 if missing.
  int optional_index(std::size_t size, std::string_view target) const;
  /// Reads `n` numbers into `out`, which keeps its values if this is missing. Errors: another length than `n`.
  bool numbers(double* out, std::size_t n) const;

  SourceLoc loc() const;
  /// JSON pointer, e.g. "/accessors/3/count".
  std::string pointer() const;
  /// Throws Error{code} at this place: "<pointer>: <message>".
  [[noreturn]] void fail(ErrorCode code, const std::string& message) const;
  [[noreturn]] void fail(const std::string& message) const { fail(ErrorCode::kBadInput, message); }

 private:
  friend class JsonDocument;
  Json(const JsonDocument* document, std::uint32_t node) : document_(document), node_(node) {}
  [[noreturn]] void wrong_type(std::string_view wanted) const;

  const JsonDocument* document_ = nullptr;
  std::uint32_t node_ = 0;
  bool missing_ = false;
  std::string_view missing_key_;
};

/// What one of the names in a table means. Errors: Error{kBadInput} at `json`, which has the name, with all of them.
/// `what`: what they are, e.g. "light type".
template <class T, std::size_t N>
const T& choice(const Json& json, std::string_view name, std::string_view what, const Named<T> (&table)[N]) {
  const Named<T>* entry = find_named(table, name);
  if (!entry) json.fail(fmt::format("\"{}\" is no {}; valid: {}", json.string(), what, names_of(table)));
  return entry->value;
}

/// Immutable after construction. `text` must outlive it.
class JsonDocument {
 public:
  /// Parses `text[begin, end)`, a part of the bytes of `file`: places are counted from the start of `text`, so that a
  /// line number of a .glb is a line number of the file itself. At most 256 levels of nesting; the tree may take at
  /// most `memory_limit` bytes (0: no limit). Errors: Error{kSyntax}, Error{kOutOfMemory}.
  JsonDocument(std::string file, std::string_view text, std::size_t begin, std::size_t end, std::uint64_t memory_limit);

  Json root() const { return {this, 0}; }
  SourceLoc loc(std::size_t offset) const;

 private:
  friend class Json;
  friend class JsonBuilder;
  enum class Kind : std::uint8_t { kNull, kBoolean, kNumber, kString, kArray, kObject };
  struct Node {
    Kind kind = Kind::kNull;
    std::uint32_t parent = 0;
    std::uint32_t position = 0;  // among the parent's children
    std::size_t offset = 0;      // of the value's first byte in the text
    std::uint32_t key_begin = 0, key_size = 0;
    std::uint32_t begin = 0, size = 0;  // of a string in `strings_`, or of children in `children_`
    double number = 0;
  };

  std::string file_;
  std::string_view text_;
  std::vector<std::size_t> lines_;  // where each line but the first starts
  std::vector<Node> nodes_;
  std::vector<std::uint32_t> children_;
  std::string strings_;
};

}  // namespace tempera
