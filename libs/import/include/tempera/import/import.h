// SPDX-License-Identifier: Apache-2.0
#pragma once
// Foreign scene files to `Scene`. What a file asks for and we lack becomes a warning; what is wrong in it, an error
// with its place. Not for shot.toml, which stands above scene files and belongs to the pipeline.
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tempera/core/log.h"
#include "tempera/scene/scene.h"

namespace tempera {

struct ImportOptions {
  /// Values of `$name` parameters that override the file's own <default>s (Mitsuba's -D name=value).
  std::vector<std::pair<std::string, std::string>> defines{};
  bool strict = false;             ///< throw Error{kUnsupported} if there was any warning, instead of keeping them
  bool sandbox = false;            ///< refuse to read files outside the folder of the scene file
  std::uint64_t memory_limit = 0;  ///< bytes that file contents and geometry may take together; 0: no limit
  std::string animation{};         ///< glTF: the one animation to play; empty: all of them together
  double fps = 24;                 ///< glTF: frame rate of tracks that count in frames rather than in seconds
  bool tints_once = false;         ///< glTF: MetallicRoughnessParams::tints_once of solid glass, as in Blender
};

/// One scene format.
struct ImporterEntry {
  std::string_view name;                         ///< e.g. "mitsuba"
  std::string_view help;                         ///< one line for `tempera list`
  std::span<const std::string_view> extensions;  ///< lower case with dot, e.g. ".xml"
  Scene (*load)(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings);
};

/// All importers, in alphabetical order of their names.
std::span<const ImporterEntry* const> importers();

/// Reads `file` with the importer of its extension (any case). The result has passed `validate`.
/// Errors: Error{kUnsupported} for an unknown extension, listing the known ones; Error{kMissingFile} for it and any
/// file it refers to; Error{kSyntax | kBadInput | kUnknownName | kOutOfRange} at the offending place;
/// Error{kOutOfMemory} beyond `options.memory_limit`. Threads: re-entrant; uses parallel loops.
Scene import_scene(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings);

}  // namespace tempera
