// SPDX-License-Identifier: Apache-2.0
#pragma once
// The files that one scene is made of: where they may lie, how much memory they may take, and what their contents hash
// to.
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "tempera/core/error.h"
#include "tempera/import/import.h"

namespace tempera {

/// Bytes of a whole file.
class FileContents {
 public:
  FileContents() = default;
  FileContents(std::unique_ptr<char[]> bytes, std::size_t size) : bytes_(std::move(bytes)), size_(size) {}
  std::string_view view() const { return {bytes_.get(), size_}; }

 private:
  std::unique_ptr<char[]> bytes_;
  std::size_t size_ = 0;
};

/// `text` without a UTF-8 byte order mark at its start, which editors of Windows write.
std::string_view skip_byte_order_mark(std::string_view text);

/// 64-bit hash in the manner of FNV-1a, eight bytes a step; `seed` chains calls.
std::uint64_t hash_bytes(std::string_view bytes, std::uint64_t seed = 0xcbf29ce484222325u);

/// Threads: safe.
class InputFiles {
 public:
  /// `scene_file` sets the folder that the sandbox allows (with its subfolders, after resolving links).
  InputFiles(const std::filesystem::path& scene_file, const ImportOptions& options);

  /// Throws unless `file` is a regular file that may be read.
  /// Errors at `loc`: Error{kMissingFile}; Error{kBadInput} for a place that the sandbox forbids or a special file.
  void check(const std::filesystem::path& file, const SourceLoc& loc) const;
  /// All bytes of `file`; adds them to the hash, not to the memory that is accounted for.
  /// Errors at `loc`: as `check`, and Error{kOutOfMemory} if they alone pass the limit.
  FileContents read(const std::filesystem::path& file, const SourceLoc& loc);
  /// Adds the contents of a file that others will read (a texture) to the hash. Errors as `check`.
  void note(const std::filesystem::path& file, const SourceLoc& loc);

  /// Accounts for `bytes` of scene data that stay allocated. Errors: Error{kOutOfMemory} at `loc` beyond the limit.
  void charge(std::uint64_t bytes, const SourceLoc& loc);
  std::uint64_t memory_limit() const { return limit_; }  ///< 0: none

  /// Hash over paths' contents, each file once, independent of the order of reading.
  std::uint64_t hash() const;

 private:
  std::filesystem::path root_;  // empty: no sandbox
  std::uint64_t limit_ = 0;
  mutable std::mutex mutex_;
  std::uint64_t charged_ = 0;
  std::map<std::filesystem::path, std::uint64_t> hashes_;
};

}  // namespace tempera
