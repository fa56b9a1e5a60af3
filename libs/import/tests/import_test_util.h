// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the tests of all importers share.
#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace tempera {

namespace fs = std::filesystem;

/// Sample scenes that not every checkout has.
inline fs::path shared_scenes() { return fs::path(TEMPERA_SOURCE_DIR) / ".." / "shared" / "scenes"; }

/// A folder of files that goes away with the object.
class TestFolder {
 public:
  TestFolder() : path_(fs::temp_directory_path() / fmt::format("tempera_import_{}_{}", ::getpid(), count_++)) {
    fs::create_directories(path_);
  }
  ~TestFolder() { fs::remove_all(path_); }
  TestFolder(const TestFolder&) = delete;
  TestFolder& operator=(const TestFolder&) = delete;

  const fs::path& path() const { return path_; }
  /// The path of a new file, whose name may have folders before it.
  fs::path write(const std::string& name, const std::string& bytes) const {
    fs::path file = path_ / name;
    fs::create_directories(file.parent_path());
    std::ofstream(file, std::ios::binary) << bytes;
    return file;
  }

 private:
  static inline int count_ = 0;
  fs::path path_;
};

}  // namespace tempera
