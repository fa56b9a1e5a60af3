// SPDX-License-Identifier: Apache-2.0
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "entries.h"
#include "tempera/core/error.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/import/import.h"

namespace tempera::fuzz {

void run(std::string_view target, std::string_view input) {
  if (target == "lpe") return lpe(input);
  if (target == "obj") return obj(input);
  if (target == "ply") return ply(input);
  if (target == "serialized") return serialized(input);
#ifdef TEMPERA_FUZZ_SHOT
  if (target == "shot") return shot(input);
#endif
  for (const ImporterEntry* e : importers()) {
    for (const std::string_view extension : e->extensions) {
      if (extension.substr(1) == target) return scene(extension, input);
    }
    if (e->name == target) return scene(e->extensions[0], input);
  }
  std::fprintf(stderr, "seeds/%.*s is of no fuzz target\n", int(target.size()), target.data());
  std::abort();
}

void expect_bad_input_only(const std::function<void()>& body) {
  set_log_level(LogLevel::kQuiet);
  with_threads(1, [&] {
    try {
      body();
    } catch (const Error& e) {
      const int status = exit_status(e.code());
      if (status < 3 || status > 5 || e.message().empty()) {
        std::fprintf(stderr, "unexpected error of status %d: %s\n", status, e.what());
        std::abort();
      }
      (void)format_with_excerpt(e);
    }
  });
}

const std::filesystem::path& work_folder() {
  static const std::filesystem::path folder = [] {
    namespace fs = std::filesystem;
    const fs::path path = fs::temp_directory_path() / ("tempera_fuzz_" + std::to_string(getpid()));
    fs::create_directories(path);
    fs::copy(fs::path(TEMPERA_SOURCE_DIR) / "tests/fuzz/files", path,
             fs::copy_options::recursive | fs::copy_options::overwrite_existing);
    std::atexit([] {
      std::error_code ignored;
      fs::remove_all(work_folder(), ignored);
    });
    return path;
  }();
  return folder;
}

std::filesystem::path write_input(const std::string& name, std::string_view input) {
  const std::filesystem::path file = work_folder() / name;
  std::ofstream(file, std::ios::binary).write(input.data(), std::streamsize(input.size()));
  return file;
}

}  // namespace tempera::fuzz
