// SPDX-License-Identifier: Apache-2.0
// What a comparison is told to compare: names and groups of runs.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <regex>
#include <set>

#include "tempera/core/error.h"
#include "tempera/core/time.h"
#include "tempera/stages/compare.h"

namespace fs = std::filesystem;

namespace tempera {
namespace {

/// One part of a path with '*' as a regular expression that captures what each '*' stands for. A place for the frame
/// number matches any number.
std::regex expression_of(const std::string& part) {
  static const std::regex kFrame("#+|%0?[0-9]*d|\\$F[0-9]*");
  std::string out;
  for (auto at = part.cbegin(); at != part.cend();) {
    std::smatch frame;
    if (std::regex_search(at, part.cend(), frame, kFrame, std::regex_constants::match_continuous)) {
      out += "-?[0-9]+";
      at = frame[0].second;
      continue;
    }
    if (*at == '*') {
      out += "(.*)";
    } else {
      if (std::string_view("^$\\.+?()[]{}|").find(*at) != std::string_view::npos) out += '\\';
      out += *at;
    }
    ++at;
  }
  return std::regex(out);
}

/// `part` for each entry of `folder` that it matches, with every '*' replaced by what it stands for there.
std::set<std::string> matches(const fs::path& folder, const std::string& part) {
  const std::regex expression = expression_of(part);
  std::set<std::string> found;
  std::error_code ec;
  for (fs::directory_iterator it(folder.empty() ? "." : folder, ec), end; !ec && it != end; it.increment(ec)) {
    const std::string name = it->path().filename().string();
    std::smatch texts;
    if (name.starts_with(".") || !std::regex_match(name, texts, expression)) continue;
    std::string concrete;
    std::size_t next = 1;
    for (const char c : part) concrete += c == '*' ? texts[next++].str() : std::string(1, c);
    found.insert(concrete);
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
        for (const std::string& name : matches(folder, part.string())) longer.push_back(folder / name);
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
