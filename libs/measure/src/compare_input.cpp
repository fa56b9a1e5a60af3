// SPDX-License-Identifier: Apache-2.0
// What a comparison is told to compare: names and groups of runs.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <string_view>

#include "tempera/core/error.h"
#include "tempera/core/time.h"
#include "tempera/measure/compare.h"

namespace fs = std::filesystem;

namespace tempera {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }
std::size_t digits_at(std::string_view text, std::size_t begin) {
  std::size_t end = begin;
  while (end < text.size() && is_digit(text[end])) ++end;
  return end - begin;
}

/// Length of the place for a frame number that `pattern` begins with; 0 if there is none.
std::size_t frame_place(std::string_view pattern) {
  const FramePlace place = find_frame_place(pattern);
  return place.begin == 0 ? place.length : 0;
}

/// Whether `name` is of the form of `pattern`, one part of a path, in which '*' stands for any text and a place for the
/// frame number for any number. Adds to `concrete` the pattern with what every '*' stands for.
bool matches(std::string_view pattern, std::string_view name, std::string& concrete) {
  if (pattern.empty()) return name.empty();
  const std::size_t before = concrete.size();
  const auto rest_matches = [&](std::size_t used, std::size_t taken, std::string_view text) {
    concrete += text;
    if (matches(pattern.substr(used), name.substr(taken), concrete)) return true;
    concrete.resize(before);
    return false;
  };
  if (const std::size_t place = frame_place(pattern)) {
    const std::size_t sign = name.starts_with('-');
    for (std::size_t digits = digits_at(name, sign); digits > 0; --digits) {
      if (rest_matches(place, sign + digits, pattern.substr(0, place))) return true;
    }
    return false;
  }
  if (pattern[0] == '*') {
    for (std::size_t length = name.size() + 1; length-- > 0;) {
      if (rest_matches(1, length, name.substr(0, length))) return true;
    }
    return false;
  }
  return !name.empty() && name[0] == pattern[0] && rest_matches(1, 1, pattern.substr(0, 1));
}

/// `part` for each entry of `folder` that it matches, with every '*' replaced by what it stands for there.
std::set<std::string> entries(const fs::path& folder, const std::string& part) {
  std::set<std::string> found;
  std::error_code ec;
  for (fs::directory_iterator it(folder.empty() ? "." : folder, ec), end; !ec && it != end; it.increment(ec)) {
    const std::string name = it->path().filename().string();
    std::string concrete;
    if (!name.starts_with(".") && matches(part, name, concrete)) found.insert(concrete);
  }
  return found;
}

/// The patterns without '*' that `pattern` stands for, in the order of their names.
std::vector<std::string> expand(const std::string& pattern) {
  std::vector<fs::path> found{fs::path()};
  for (const fs::path& part : fs::path(pattern)) {
    std::vector<fs::path> longer;
    for (const fs::path& folder : found) {
      if (part.string().find('*') == std::string::npos) {
        longer.push_back(folder / part);
      } else {
        for (const std::string& name : entries(folder, part.string())) longer.push_back(folder / name);
      }
    }
    found = std::move(longer);
  }
  std::vector<std::string> out;
  for (const fs::path& p : found) out.push_back(p.string());
  return out;
}

bool exists(const std::string& pattern) {
  std::error_code ec;
  return fs::exists(pattern, ec) || (has_frame_pattern(pattern) && !existing_frames(pattern).empty());
}

}  // namespace

CompareInput parse_compare_input(const std::string& text) {
  CompareInput input;
  input.name = text;
  std::string pattern = text;
  const auto equals = text.find('=');
  if (equals != std::string::npos && equals > 0 && text.find('/') > equals && !exists(text)) {
    input.name = text.substr(0, equals);
    pattern = text.substr(equals + 1);
  }
  if (pattern.find('*') == std::string::npos || exists(pattern)) {
    input.runs.emplace_back(pattern);
    return input;
  }
  for (const std::string& run : expand(pattern)) {
    // A folder or file may match that holds no frames, as a folder of notes beside those of seeds.
    try {
      input.runs.emplace_back(run);
    } catch (const Error& e) {
      if (e.code() != ErrorCode::kMissingFile) throw;
    }
  }
  if (input.runs.empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no pictures or frames match {}", pattern));
  return input;
}

}  // namespace tempera
