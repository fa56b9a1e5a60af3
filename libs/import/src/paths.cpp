// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/paths.h"

#include <fmt/format.h>

#include <algorithm>

namespace tempera {
namespace {

constexpr int kMaxEntries = 100000;  // of a folder

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? char(c | 32) : c; });
  return text;
}

/// `file` with each part that does not exist replaced by one that differs in case only; empty if a part has none.
std::filesystem::path in_other_case(const std::filesystem::path& file) {
  namespace fs = std::filesystem;
  std::error_code failed;
  fs::path found;
  for (const fs::path& part : file) {
    if (fs::exists(found / part, failed)) {
      found /= part;
      continue;
    }
    const std::string wanted = lower_case(part.string());
    std::string best;  // the first by name, so that the answer does not depend on the order of the folder
    int seen = 0;
    for (fs::directory_iterator i(found.empty() ? fs::path(".") : found, failed), end;
         !failed && i != end && ++seen < kMaxEntries; i.increment(failed)) {
      const std::string name = i->path().filename().string();
      if (lower_case(name) == wanted && (best.empty() || name < best)) best = name;
    }
    if (best.empty()) return {};
    found /= best;
  }
  return found;
}

}  // namespace

std::filesystem::path named_file(const std::filesystem::path& folder, const std::string& name) {
  std::error_code failed;
  if (name.find('\\') == name.npos || std::filesystem::exists(folder / name, failed)) return folder / name;
  std::string slashes = name;
  std::replace(slashes.begin(), slashes.end(), '\\', '/');
  return folder / slashes;
}

std::string cannot_find(const std::filesystem::path& file) {
  const std::filesystem::path other = in_other_case(file);
  return fmt::format("cannot find the file \"{}\"", file.string()) +
         (other.empty() ? "" : fmt::format("; did you mean \"{}\"? Upper and lower case differ", other.string()));
}

}  // namespace tempera
