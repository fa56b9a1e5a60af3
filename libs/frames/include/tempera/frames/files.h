// SPDX-License-Identifier: Apache-2.0
#pragma once
// Writing files so that a reader, a full disk or a power cut never leaves a half-written one under the final name.
#include <cstddef>
#include <span>
#include <string>
#include <string_view>

namespace tempera {

/// Writes `bytes` to a temporary file beside `path`, forces them to the disk and renames it to `path`: afterwards
/// `path` holds either all of `bytes` or what it held before. Missing directories are created; a symbolic link is
/// followed. Errors: Error{kFailed} with the system's reason (disk full, read-only, no permission, not a regular file);
/// no temporary file stays behind. Threads: safe, also for the same path (the last one wins whole).
void write_file(const std::string& path, std::span<const std::byte> bytes);
void write_file(const std::string& path, std::string_view text);

/// Whole contents of a file. Errors: Error{kMissingFile} or Error{kFailed}.
std::string read_file(const std::string& path);

/// A name for a temporary file beside a final one, for output that another program writes. `commit` makes it the final
/// file; without it the destructor removes it.
class TemporaryFile {
 public:
  /// Creates the missing directories and an empty file named ".<stem>.<unique>.tmp<extension>" beside `path`.
  /// Errors: as write_file.
  explicit TemporaryFile(const std::string& path);
  ~TemporaryFile();
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::string& path() const { return temporary_; }
  /// Forces the file to the disk and renames it. Errors: Error{kFailed}.
  void commit();

 private:
  friend void write_file(const std::string&, std::span<const std::byte>);
  std::string final_, temporary_;
  int fd_ = -1;
  bool synced_ = false;
};

}  // namespace tempera
