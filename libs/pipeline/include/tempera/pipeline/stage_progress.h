// SPDX-License-Identifier: Apache-2.0
#pragma once
// Progress of stages for people and for the programs that run them, in the manner of progress.h.
#include <memory>

#include "tempera/pipeline/progress.h"
#include "tempera/stages/stage_observer.h"

namespace tempera {

/// A bar, lines, JSON events or Open Job Description lines, as `kind` says; where they go is as for renders. While it
/// lives, a bar steps aside for log lines.
std::unique_ptr<StageObserver> make_stage_progress(ProgressKind kind, const JobStep& step = {});

}  // namespace tempera
