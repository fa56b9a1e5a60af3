// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/log.h"

#include <fmt/format.h>

#include <atomic>
#include <cstdio>

namespace tempera {

static std::atomic<LogLevel> g_level{LogLevel::kInfo};
static std::mutex g_writer_mutex;
static std::function<void(std::string_view)> g_writer;
static std::mutex g_observer_mutex;
static std::function<void(const Warning&)> g_observer;

void set_log_level(LogLevel level) { g_level = level; }
LogLevel log_level() { return g_level; }
void set_log_writer(std::function<void(std::string_view)> writer) {
  const std::scoped_lock lock(g_writer_mutex);
  g_writer = std::move(writer);
}

void set_warning_observer(std::function<void(const Warning&)> observer) {
  const std::scoped_lock lock(g_observer_mutex);
  g_observer = std::move(observer);
}

std::string Warning::line() const {
  const std::string place = loc.file.empty() ? "" : (count > 1 ? ", first at " : "at ") + loc.str();
  const std::string detail = (count > 1 ? fmt::format("{} times", count) : "") + place;
  return detail.empty() ? message : fmt::format("{} ({})", message, detail);
}

void log_warning(const Warning& warning) {
  {
    const std::scoped_lock lock(g_observer_mutex);
    if (g_observer) g_observer(warning);
  }
  log(LogLevel::kWarning, warning.line());
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
  for (const auto& [what, e] : entries_) out.push_back(Warning{what, "input", e.first, e.count}.line());
  return out;
}

void Warnings::report(bool strict) {
  const std::scoped_lock lock(mutex_);
  if (strict && !entries_.empty()) {
    const auto& [what, e] = *entries_.begin();
    throw Error(ErrorCode::kUnsupported, e.first, what + " (an error under --strict)");
  }
  for (const auto& [what, e] : entries_) log_warning(Warning{what, "input", e.first, e.count});
  entries_.clear();
}

}  // namespace tempera
