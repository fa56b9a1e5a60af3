// SPDX-License-Identifier: Apache-2.0
#pragma once
// How progress is written, whatever it is the progress of: lines for people, for programs, and a bar on a terminal.
#include <cstdio>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>

#include "tempera/pipeline/progress.h"

namespace tempera {

/// kAuto, and kTty where there is no terminal, become what fits: a bar written into a file would be one endless line.
ProgressKind settle_progress(ProgressKind kind);

/// Writes and flushes.
void write_now(std::FILE* out, const std::string& text);
/// One JSON object as a line on standard output.
void write_event(const nlohmann::ordered_json& event);
/// Open Job Description's percentage, of the whole job.
void write_openjd_progress(const JobStep& step, double part);

/// "1:02:03", or "2:03" below an hour; seconds in [0, 1e9].
std::string clock_text(double seconds);

/// A bar at the end of the terminal. While it lives, log lines go above it. Threads: any.
class ProgressBar {
 public:
  ProgressBar();
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// Shows `part` of the whole in [0, 1], and `text` behind it, as far as the terminal is wide.
  void show(double part, const std::string& text);
  /// Writes a line that ends with a line break, above the bar.
  void write_above(const std::string& line);
  /// Removes the bar until it is shown again.
  void hide() { draw(""); }

 private:
  void draw(std::string line);
  std::mutex mutex_;
  std::string line_;
};

/// The observer of a kind: those that write, or for kNone `Observer` itself, which does nothing. `OpenJd` and `Json`
/// are made of the step.
template <class Observer, class Plain, class Bar, class Json, class OpenJd>
std::unique_ptr<Observer> make_observer(ProgressKind kind, const JobStep& step) {
  switch (settle_progress(kind)) {
    case ProgressKind::kTty:
      return std::make_unique<Bar>();
    case ProgressKind::kJson:
      return std::make_unique<Json>(step);
    case ProgressKind::kOpenJd:
      return std::make_unique<OpenJd>(step);
    case ProgressKind::kNone:
      return std::make_unique<Observer>();
    default:
      return std::make_unique<Plain>();
  }
}

}  // namespace tempera
