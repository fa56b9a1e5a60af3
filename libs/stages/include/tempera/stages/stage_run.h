// SPDX-License-Identifier: Apache-2.0
#pragma once
// Runs a stage over files: which frames it reads, which are finished, reading a few frames at a time, progress,
// stopping, and writing each file whole or not at all. The same for every stage.
#include <functional>
#include <optional>
#include <set>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/sequence.h"
#include "tempera/stages/stage.h"
#include "tempera/stages/stage_observer.h"

namespace tempera {

/// Frames to make, of a part of a sequence that is cut from the rest.
struct StageSection {
  std::vector<int> frames{};                ///< empty: all that there are
  std::optional<FrameRange> sequence = {};  ///< see SequenceDesc; none: from the first to the last frame of the input
  std::optional<FrameRange> reach = {};     ///< see SequenceDesc; none: all of the sequence
};

struct StageOptions {
  std::vector<StageSection> sections{1};  ///< none of their frames is in two
  bool resume = false;                    ///< skip frames whose file is complete and would be the same
  WriteOptions write{};
  std::vector<std::string> leave_out{};  ///< layers that are not written
  std::string command{};                 ///< for the metadata
};

struct StageReport {
  std::vector<int> frames;         ///< written
  std::vector<int> skipped;        ///< already finished
  std::vector<std::string> notes;  ///< what the stage says of them
  double seconds = 0;
};

/// Writes frames that `choice` makes of `in`, one sequence per port, to `output` (see frame_path; a name without a
/// place for the number for one frame). The metadata are those that the stage gives a frame, and beside them
/// tempera/<stage> (parameters), tempera/<stage>_command and tempera/<stage>_fingerprint.
/// Result:  a function of the input files and parameters: the same bits for any number of threads, any choice of
/// frames,
///          and after any interruption, as long as all frames that the stage declares are there.
/// Memory:  what the stage holds at a time, whatever the length of the sequence.
/// Errors:  Error{kBadInput} for a missing layer, frames of different sizes, frames that are missing among those that
///          are read, each naming the file; Error{kMissingFile} for a frame that cannot be made; Error{kUsage} if a
///          frame would replace its own input; Error{kCancelled} after `stop`: finished frames stay; those of the
/// stage,
///          of read_frame and of write_frame.
StageReport run_stage(const StageChoice& choice, std::span<const FrameSequence> in, const std::string& output,
                      const StageOptions& options, StageObserver& observer, std::stop_token stop = {});

/// What the driver is to a stage that runs: one section of one call of run_stage.
class StageRun {
 public:
  /// What the sequences are, one per port.
  std::span<const SequenceDesc> in() const { return in_; }
  /// Frames to make, in ascending order.
  const std::vector<int>& frames() const { return frames_; }
  std::string path(int frame, int port = 0) const { return files_[port].path(frame); }
  /// The layers of a frame that the stage declares, as far as its file has them and they are `wanted` (none: all), with
  /// its metadata. Pre: it is among the declared inputs. Errors: Error{kBadInput} for another size or a missing layer; those of read_frame.
  Frame read(int frame, int port = 0, const std::function<bool(const LayerDesc&)>& wanted = {}) const;
  /// A frame to fill: with what passes through, which is the metadata and those layers of frame `frame` of the first
  /// port that the stage's output has, too; without layers where the output is of another size, and empty where the
  /// first port has no such frame.
  Frame start(int frame) const;
  /// Writes a frame. Pre: it is one of frames(), and not written yet. Errors: those of write_frame.
  void write(int frame, Frame out);
  /// Tells how much is done, in [0, 1], never falling. Errors: Error{kCancelled} once the run is stopped.
  void progress(double share) const { progress_(share); }
  /// The same without news.
  void check_stop() const { check_stop_(); }
  /// A line about these frames for the report.
  void note(std::string text) { report_.notes.push_back(std::move(text)); }

 private:
  friend StageReport run_stage(const StageChoice&, std::span<const FrameSequence>, const std::string&,
                               const StageOptions&, StageObserver&, std::stop_token);
  StageRun(const Stage& stage, std::span<const FrameSequence> files, std::vector<SequenceDesc> in,
           std::vector<std::string> described, StageReport& report);
  std::span<const FrameSequence> files_;
  std::vector<SequenceDesc> in_;
  std::vector<std::string> described_;  ///< files that these are judged by
  SequenceDesc out_;
  std::vector<std::vector<LayerUse>> reads_;  ///< by port
  std::vector<int> frames_;
  std::set<std::pair<int, int>> declared_;  ///< ports and frames that these are made of
  StageReport& report_;
  std::function<void(double)> progress_;
  std::function<void()> check_stop_;
  std::function<void(int, Frame)> write_;
};

}  // namespace tempera
