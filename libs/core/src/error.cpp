// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/error.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <numeric>

namespace tempera {

void assertion_failed(const char* what, const char* file, int line) {
  std::fprintf(stderr, "%s:%d: assertion failed: %s\n", file, line, what);
  std::abort();
}

std::string SourceLoc::str() const {
  std::string s = file;
  if (line > 0) s += fmt::format(":{}", line);
  if (line > 0 && column > 0) s += fmt::format(":{}", column);
  return s;
}

std::string_view to_string(ErrorCode code) {
  switch (code) {
    case ErrorCode::kFailed:
      return "failed";
    case ErrorCode::kUsage:
      return "usage";
    case ErrorCode::kSyntax:
      return "syntax";
    case ErrorCode::kBadInput:
      return "bad_input";
    case ErrorCode::kUnknownName:
      return "unknown_name";
    case ErrorCode::kOutOfRange:
      return "out_of_range";
    case ErrorCode::kUnsupported:
      return "unsupported";
    case ErrorCode::kMissingFile:
      return "missing_file";
    case ErrorCode::kOutOfMemory:
      return "out_of_memory";
    case ErrorCode::kCancelled:
      return "cancelled";
    case ErrorCode::kDiffers:
      return "differs";
  }
  return "failed";
}

int exit_status(ErrorCode code) {
  switch (code) {
    case ErrorCode::kFailed:
      return 1;
    case ErrorCode::kUsage:
      return 2;
    case ErrorCode::kSyntax:
    case ErrorCode::kBadInput:
    case ErrorCode::kUnknownName:
    case ErrorCode::kOutOfRange:
    case ErrorCode::kUnsupported:
      return 3;
    case ErrorCode::kMissingFile:
      return 4;
    case ErrorCode::kOutOfMemory:
      return 5;
    case ErrorCode::kDiffers:
      return 6;
    case ErrorCode::kCancelled:
      return 130;
  }
  return 1;
}

Error::Error(ErrorCode code, SourceLoc loc, std::string message)
    : std::runtime_error(loc.file.empty() ? message : loc.str() + ": " + message),
      code_(code),
      loc_(std::move(loc)),
      message_(std::move(message)) {}

std::string format_with_excerpt(const Error& error) {
  std::string out = error.what();
  const SourceLoc& loc = error.loc();
  if (loc.line <= 0) return out;
  std::ifstream in(loc.file);
  std::string line;
  for (int i = 0; i < loc.line && std::getline(in, line); ++i) {
  }
  // Minified or binary files have lines that no terminal shows; the place alone is clearer there.
  const bool printable = std::all_of(line.begin(), line.end(), [](unsigned char c) { return c >= 32 || c == '\t'; });
  if (!in || line.empty() || line.size() > 200 || !printable) return out;
  out += "\n  " + line;
  if (loc.column > 0) out += "\n  " + std::string(loc.column - 1, ' ') + "^";
  return out;
}

SourceLoc locate(const std::string& file, std::string_view text, std::size_t offset) {
  offset = std::min(offset, text.size());
  const auto before = text.substr(0, offset);
  const auto newline = before.rfind('\n');
  const std::size_t line_begin = newline == std::string_view::npos ? 0 : newline + 1;
  return {file, int(std::count(before.begin(), before.end(), '\n')) + 1, int(offset - line_begin) + 1};
}

static std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), 0);
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (a[i - 1] != b[j - 1])});
      diagonal = above;
    }
  }
  return row.back();
}

std::string nearest_names(std::string_view wanted, std::vector<std::string> names, std::size_t limit) {
  std::stable_sort(names.begin(), names.end(), [&](const std::string& a, const std::string& b) {
    return edit_distance(wanted, a) < edit_distance(wanted, b);
  });
  if (names.size() > limit) {
    names.resize(limit);
    names.push_back("...");
  }
  return fmt::format("{}", fmt::join(names, ", "));
}

}  // namespace tempera
