// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a user says about a shot, before the scene is known: the keys of shot.toml and of the command line with their
// values and where each came from. One table feeds the parser, --help and docs/shot.md. `load_shot` (shot.h) turns it
// into a Shot. Not for scene content, which scene files hold.
#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/params.h"

namespace tempera {

/// One key with a fixed name.
struct ShotKey {
  ParamSpec spec;               ///< `name` is dotted: "film.resolution" is `resolution` in the table [film]
  std::string flag;             ///< CLI11 notation, e.g. "-o,--output"; empty: only --set reaches it
  std::string value_name{};     ///< what --help calls the value, e.g. "WxH"
  std::string fallback_help{};  ///< what holds when the key is absent, if that is not spec.fallback
  bool list = false;            ///< an array is accepted in TOML; its elements are joined by ','
  bool keyframes = false;       ///< they may be arrays themselves, whose elements are joined by ':'
};
/// All of them, in the order of the manual.
std::span<const ShotKey> shot_keys();

/// A table of shot.toml whose keys are the user's or another table's.
struct OpenTable {
  std::string name;      ///< e.g. "classes"
  std::string key_name;  ///< what the manual calls its keys
  std::string help;
  int depth = 1;  ///< 2: a table of tables, e.g. materials.<material>.<parameter>
};
std::span<const OpenTable> shot_tables();

/// A value and where it was written.
struct ShotValue {
  ParamValue value;
  SourceLoc loc;
  bool is_text = false;               ///< a string that still has to be converted to the type of what it is for
  std::vector<SourceLoc> elements{};  ///< places of an array's elements, where the value was one
};

/// Parts of a dotted key: {"film", "resolution"}.
using KeyPath = std::vector<std::string>;
/// Splits `a.b."c.d"` into {a, b, c.d}; quotes are double or single, blanks around parts do not count. Errors:
/// Error{kSyntax} at `loc` for an empty part or a missing quote.
KeyPath parse_key(std::string_view text, const SourceLoc& loc = {});

/// Values by dotted key. Later values replace earlier ones, so: file first, command line after it.
class ShotConfig {
 public:
  /// Reads shot.toml. Relative input files in it are relative to its folder.
  /// Errors: Error{kMissingFile}; Error{kSyntax}; Error{kUnknownName} for a key that does not exist, with the nearest
  /// ones; Error{kBadInput | kOutOfRange} for a value of the wrong type or range: all at file:line:column.
  void read_file(const std::filesystem::path& file);
  /// The same from text; `file` names it in messages.
  void read_text(std::string_view text, const std::string& file, const std::filesystem::path& folder);
  /// Sets one key from the command line, e.g. ("film.resolution", "640x360") or ("integrator.max_depth", "3").
  /// Errors: as read_file, at `loc`.
  void set_text(const std::string& key, const std::string& text, const SourceLoc& loc = kCommandLine());
  /// "key=value" as a line of shot.toml would have it: `film.crop=[0, 0, 64, 48]`, `film={scale=50}`, `camera="Main"`.
  /// A value that does not begin with a bracket, brace or quote may also be text as in set_text: `film.crop=0,0,64,48`.
  /// Errors: Error{kUsage} without '='; Error{kSyntax} for a value that is no TOML; those of read_file.
  void assign(const std::string& assignment, const SourceLoc& loc = kCommandLine());

  /// The value of a fixed key, if it was given.
  const ShotValue* find(const std::string& key) const;
  /// The value that the file gave, whether or not the command line replaced it.
  const ShotValue* find_in_file(const std::string& key) const;
  /// Values of an open table by their keys without the table's name: {"dd"}, or for depth 2 {"Glass", "ior"}.
  std::map<KeyPath, ShotValue> table(const std::string& name) const;
  /// The table's default for a fixed key that was not given. Pre: the key exists.
  static const ParamValue& fallback(const std::string& key);

  bool get_bool(const std::string& key) const { return std::get<bool>(get(key)); }
  int get_int(const std::string& key) const { return std::get<int>(get(key)); }
  double get_double(const std::string& key) const { return std::get<double>(get(key)); }
  const std::string& get_string(const std::string& key) const { return std::get<std::string>(get(key)); }
  /// Where a key was given; an empty place if it was not.
  SourceLoc loc(const std::string& key) const;
  /// The same of element `i` of a list; where the list is text, that of the text.
  SourceLoc loc(const std::string& key, std::size_t i) const;
  /// With true, input_path refuses what the file names outside of its folder.
  void set_sandbox(bool sandbox) { sandbox_ = sandbox; }
  /// A string key that names an input file, relative to where it was written. Errors: Error{kBadInput} outside the
  /// sandbox.
  std::filesystem::path input_path(const std::string& key) const;
  std::filesystem::path input_path(const ShotValue& value) const;
  /// The file that was read; empty if none was.
  const std::filesystem::path& file() const { return file_; }

  static SourceLoc kCommandLine() { return {"<command line>", 0, 0}; }

 private:
  const ParamValue& get(const std::string& key) const;
  struct Node;  // a node of a TOML document
  /// Sets `key` to what stands at a node, recursively for tables.
  void set_node(const KeyPath& key, const Node& node);
  void set(const KeyPath& key, const ShotValue& value, const SourceLoc& key_loc);
  std::map<KeyPath, ShotValue> values_, file_values_;
  std::filesystem::path file_, folder_;
  bool sandbox_ = false;
};

}  // namespace tempera
