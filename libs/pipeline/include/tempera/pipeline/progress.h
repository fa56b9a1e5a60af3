// SPDX-License-Identifier: Apache-2.0
#pragma once
// Progress of a render for people and for the programs that run it. One line per event, flushed at once.
#include <memory>
#include <string_view>

#include "tempera/pipeline/render.h"

namespace tempera {

enum class ProgressKind {
  kAuto,    ///< kTty if standard error is a terminal, else kPlain
  kTty,     ///< a bar on standard error with the time left, and a line per finished frame
  kPlain,   ///< a line per finished frame on standard error: "frame 12 done: seconds=3.21 samples=... path=..."
  kJson,    ///< one JSON object per event on standard output: start, frame, progress, done, end
  kOpenJd,  ///< openjd_progress: and openjd_status: lines on standard output (Open Job Description)
  kNone,
};
/// "auto", "tty", "plain", "json", "openjd" or "none". Errors: Error{kUnknownName} with the known names.
ProgressKind parse_progress(std::string_view text);

/// While it lives, a bar steps aside for log lines.
std::unique_ptr<RenderObserver> make_progress(ProgressKind kind);

}  // namespace tempera
