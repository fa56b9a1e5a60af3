// SPDX-License-Identifier: Apache-2.0
#pragma once
// How a stage that works through a sequence tells what it does.
#include <string>
#include <vector>

namespace tempera {

/// Watches a stage. Threads: all calls come from the thread that runs the stage. A call may throw, which ends it.
class StageObserver {
 public:
  virtual ~StageObserver() = default;
  /// Frames that will be written, in order, and those that are already finished.
  virtual void begin(const std::vector<int>& /*frames*/, const std::vector<int>& /*skipped*/) {}
  /// Share of the work that is done, in [0, 1], never falling.
  virtual void progress(double /*share*/) {}
  /// The file of a frame is written.
  virtual void frame_done(int /*frame*/, const std::string& /*path*/) {}
  virtual void end(double /*seconds*/) {}
};

}  // namespace tempera
