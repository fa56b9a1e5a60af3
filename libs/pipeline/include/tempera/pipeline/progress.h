// SPDX-License-Identifier: Apache-2.0
#pragma once
// Progress of a render for people and for the programs that run it. One line per event, flushed at once.
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "tempera/pipeline/render.h"

namespace tempera {

enum class ProgressKind {
  kAuto,    ///< kTty if standard error is a terminal, else kPlain
  kTty,     ///< a bar on standard error with the time left, and a line per finished frame
  kPlain,   ///< a line per finished frame on standard error: "frame 12 done: seconds=3.21 samples=... path=..."
  kJson,    ///< one JSON object per event on standard output: start, frame, progress, done, end, ...
  kOpenJd,  ///< openjd_progress: and openjd_status: lines on standard output (Open Job Description)
  kNone,
};
/// "auto", "tty", "plain", "json", "openjd" or "none". Errors: Error{kUnknownName} with the known names.
ProgressKind parse_progress(std::string_view text);

/// From now on every warning is an event of ProgressKind::kJson, too.
void write_warning_events();
/// The last event of ProgressKind::kJson for a program that ends with `status` because of `error`.
void write_error_event(const Error& error, int status);

/// A step of a job that has several, or the whole of it.
struct JobStep {
  std::string name;
  int number = 1, of = 1;
  double begin = 0, end = 1;  ///< its part of the job's work, for the percentage that programs are told
  double share(double part) const { return begin + (end - begin) * part; }
};
/// Tells that a step begins: a line of the log, or for programs an event or a status.
void announce_step(ProgressKind kind, const JobStep& step);

/// What a step of a job left.
struct JobResult {
  std::string step;
  double seconds = 0;
  std::string path;  ///< file, or pattern of the files
};
/// Tells at the end of a job where everything is and how long it took, in the manner of announce_step.
void announce_results(ProgressKind kind, std::span<const JobResult> results);

/// While it lives, a bar steps aside for log lines.
std::unique_ptr<RenderObserver> make_progress(ProgressKind kind, const JobStep& step = {});

}  // namespace tempera
