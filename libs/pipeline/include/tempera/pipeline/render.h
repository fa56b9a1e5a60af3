// SPDX-License-Identifier: Apache-2.0
#pragma once
// Renders the frames of a shot to files: tiles in parallel, frames written in the background, finished work kept
// whatever happens. Which frames and where is the shot's matter; who watches is an observer's.
#include <cstdint>
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/frames/frame.h"
#include "tempera/methods/section.h"
#include "tempera/pipeline/shot.h"

namespace tempera {

struct RenderPlan {
  std::vector<int> frames;    ///< that will be rendered, in order
  std::size_t skipped = 0;    ///< frames that were already finished
  std::size_t units = 0;      ///< of work, in all of them together
  int width = 0, height = 0;  ///< of the files
  const RenderSettings* settings = nullptr;
  std::vector<LayerDesc> layers;
};

struct FrameReport {
  int frame = 0;
  std::string path;
  double seconds = 0;  ///< wall time, of all runs together if it was continued from a checkpoint
  RenderTotals totals;
};

struct RenderReport {
  std::vector<FrameReport> frames;
  std::vector<int> skipped;
  double seconds = 0;
  RenderTotals totals;
};

/// Watches a render. Threads: tile_done is called concurrently; frame_end comes from the thread that writes files, so
/// it can overlap the next frame's calls. Must not block for long: the renderer waits.
class RenderObserver {
 public:
  virtual ~RenderObserver() = default;
  virtual void begin(const RenderPlan& /*plan*/) {}
  /// `units_done`: those that a checkpoint brought; their pixels are in `picture`. Frames that are rendered together
  /// begin together, with the units of all of them at the first.
  virtual void frame_begin(int /*frame*/, const Frame& /*picture*/, std::size_t /*units_done*/) {}
  /// A unit is done: the pixels of `tile` (coordinates in `picture`), which are final unless a later pass changes them.
  /// An empty tile: it has no pixels of its own.
  virtual void tile_done(int /*frame*/, const Frame& /*picture*/, const Tile& /*tile*/,
                         const RenderTotals& /*totals*/) {}
  /// The file is written.
  virtual void frame_end(const FrameReport& /*report*/) {}
  virtual void end(const RenderReport& /*report*/) {}
};

struct RenderOptions {
  /// Skip frames whose file is complete and has the same fingerprint; continue those that were interrupted.
  bool resume = false;
  std::vector<int> reuse;           ///< frames that are skipped like this without `resume`, too
  double checkpoint_seconds = 600;  ///< between checkpoints of frames in progress; 0: only when stopped
  Part part;                        ///< of the units; less than all of them end in files for merge_parts
  std::string command;              ///< for the metadata
};

/// Renders `shot.frames` to `shot.output`, one file each.
/// Result:  files that depend on shot and scene alone, but for the time and the command in their metadata.
/// Errors:  Error{kCancelled} after `stop`: the frame in progress is in "<file>.partial", from which `resume`
/// continues.
///          Error{kFailed} if files cannot be written: where that can be known, before a ray is traced.
/// Threads: uses parallel_for, and one thread more that writes.
RenderReport render_sequence(const Shot& shot, const Scene& scene, const RenderOptions& options,
                             std::span<RenderObserver* const> observers, const std::stop_token& stop = {});

/// Adds up the parts of frames that lie in `inputs` (folders, or files), and writes the frames to the folder `output`.
/// Result:  the files that one run would have written, by their names. Returns how many frames.
/// Errors:  Error{kBadInput} for parts of different frames or settings, and for units that are missing, or that two
/// parts
///          hold; Error{kMissingFile} where there are no parts.
std::size_t merge_parts(std::span<const std::string> inputs, const std::string& output);

/// One frame in memory, without its metadata but the cryptomatte manifest. Result: the pixels of render_sequence.
Frame render_frame(const Shot& shot, const Scene& scene, int frame, RenderTotals* totals = nullptr);

/// Radiance of a single sample: what its pixel would add up. Errors: Error{kUsage} for a pixel or sample outside.
Rgb replay_sample(const Shot& shot, const Scene& scene, const BadSample& sample);

}  // namespace tempera
