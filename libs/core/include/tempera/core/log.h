// SPDX-License-Identifier: Apache-2.0
#pragma once
// Messages for people: levels on standard error, and a collector that turns repeated warnings into one line with a
// count.
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/error.h"

namespace tempera {

enum class LogLevel { kQuiet, kWarning, kInfo, kDebug };

/// The level below which messages are dropped. The one process-wide setting: where messages go is not part of a result.
void set_log_level(LogLevel level);
LogLevel log_level();
/// Passes lines, with their end, to `writer` instead of standard error: a progress bar has to step aside for them. An
/// empty one restores standard error. Threads: safe; `writer` is called by one thread at a time and must not log.
void set_log_writer(std::function<void(std::string_view line)> writer);
/// Writes one line to standard error (flushed at once) if `level` is enabled. Threads: safe.
void log(LogLevel level, const std::string& message);
/// A warning as programs are told of it.
struct Warning {
  std::string message;
  std::string kind = "general";  ///< "input": about the content of a file that was read
  SourceLoc loc{};               ///< first place, if it has one
  int count = 1;                 ///< places
  /// "message (2 times, first at file:line)".
  std::string line() const;
};
/// Logs it, and passes it to the observer.
void log_warning(const Warning& warning);
inline void log_warning(const std::string& m) { log_warning(Warning{m}); }
/// Told of every warning, whatever the log level; an empty one ends that. Threads: safe; called by one at a time; must
/// not log.
void set_warning_observer(std::function<void(const Warning&)> observer);
inline void log_info(const std::string& m) { log(LogLevel::kInfo, m); }
inline void log_debug(const std::string& m) { log(LogLevel::kDebug, m); }

/// Collects what an input asks for and this program lacks: one line per kind with its count and first place.
/// Threads: safe.
class Warnings {
 public:
  /// Notes one occurrence. `what` identifies the kind, e.g. "texture filter \"ewa\" is treated as bilinear".
  void add(const std::string& what, const SourceLoc& loc);
  bool empty() const;
  /// What `report` would log, one line per kind.
  std::vector<std::string> lines() const;
  /// Logs "what (N times, first at loc)" per kind in alphabetical order and forgets them.
  /// Errors: with `strict`, throws Error{kUnsupported} at the first place of the first kind instead.
  void report(bool strict = false);

 private:
  struct Entry {
    int count = 0;
    SourceLoc first;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Entry> entries_;
};

}  // namespace tempera
