// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/log.h"

#include <fmt/format.h>

#include <atomic>
#include <cstdio>

namespace tempera {

static std::atomic<LogLevel> g_level{LogLevel::kInfo};
static std::mutex g_writer_mutex;
static std::function<void(std::string_view)> g_writer;

void set_log_level(LogLevel level) { g_level = level; }
LogLevel log_level() { return g_level; }
void set_log_writer(std::function<void(std::string_view)> writer) {
  const std::scoped_lock lock(g_writer_mutex);
  g_writer = std::move(writer);
}

void log(LogLevel level, const std::string& message) {
  if (level > g_level.load() || level == LogLevel::kQuiet) return;
  const std::string line = (level == LogLevel::kWarning ? "warning: " : "") + message + "\n";
  const std::scoped_lock lock(g_writer_mutex);
  if (g_writer) return g_writer(line);
  std::fwrite(line.data(), 1, line.size(), stderr);
  std::fflush(stderr);
}

void Warnings::add(const std::string& what, const SourceLoc& loc) {
  const std::scoped_lock lock(mutex_);
  Entry& e = entries_[what];
  if (e.count++ == 0) e.first = loc;
}

bool Warnings::empty() const {
  const std::scoped_lock lock(mutex_);
  return entries_.empty();
}

std::vector<std::string> Warnings::lines() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::string> out;
  for (const auto& [what, e] : entries_) {
    const std::string place = e.first.file.empty() ? "" : (e.count > 1 ? ", first at " : "at ") + e.first.str();
    const std::string count = e.count > 1 ? fmt::format("{} times", e.count) : "";
    const std::string detail = count + place;
    out.push_back(detail.empty() ? what : fmt::format("{} ({})", what, detail));
  }
  return out;
}

void Warnings::report(bool strict) {
  for (const std::string& line : lines()) {
    if (!strict) log_warning(line);
  }
  const std::scoped_lock lock(mutex_);
  if (strict && !entries_.empty()) {
    const auto& [what, e] = *entries_.begin();
    throw Error(ErrorCode::kUnsupported, e.first, what + " (an error under --strict)");
  }
  entries_.clear();
}

}  // namespace tempera
