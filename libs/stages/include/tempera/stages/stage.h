// SPDX-License-Identifier: Apache-2.0
#pragma once
// A stage turns the frames of a sequence into others: a pure function of the layers that it declares, over the frames
// that it declares. It never sees a scene, so it runs from files, alone, on any machine. A StageEntry is its manual.
// What is the same for all stages (files, resume, progress, errors) is in stage_run.h, and how they follow each other
// in stage_plan.h.
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/frames/frame.h"

namespace tempera {

/// A sequence as it is known before a file of it is looked at. Frame numbers are places on the shot's time axis: a
/// stage may leave frames out or make some in between, but a number means the same time before and after it.
struct SequenceDesc {
  FrameRange sequence;      ///< of the whole, whatever part of it is there: what counts from its ends goes by this
  FrameRange reach;         ///< part of it that stages may look at: beyond it, they take the sequence to end
  std::vector<int> frames;  ///< that are there or can be made, in ascending order; none: all of `reach`
  int width = 0, height = 0;
  std::vector<LayerDesc> layers;

  bool has(int frame) const;
  std::vector<int> all_frames() const;
  bool has(const LayerDesc& layer) const;  ///< by name
  /// Whether it has a mask: pixels that the stage has left to be rendered (LayerRole::kMask).
  bool has_mask() const;
};

/// A layer that a stage reads.
struct LayerUse {
  LayerDesc layer;
  bool required = true;  ///< else it is read where it is there
  std::string why{};     ///< for the message where it is missing: what the stage needs
};

/// Parameters that do not go with each other, or with the frames.
class StageParamError : public Error {
 public:
  /// `params`: whose values are at fault, the first to be blamed first.
  StageParamError(ErrorCode code, std::vector<std::string> params, std::string message)
      : Error(code, std::move(message)), params_(std::move(params)) {}
  const std::vector<std::string>& params() const { return params_; }

 private:
  std::vector<std::string> params_;
};

class StageRun;

/// In all functions `in` has one sequence per port. They depend on the parameters and arguments alone.
class Stage {
 public:
  virtual ~Stage() = default;
  /// Checks that the stage can work on such sequences, and says what comes out: frames, size, layers. A layer with the
  /// role kMask says which pixels the stage leaves to the renderer: a run renders them, and fills them in (fill.h).
  /// Errors: StageParamError; Error{kBadInput}. Layers that are missing need not be looked for, see `reads`.
  virtual SequenceDesc output(std::span<const SequenceDesc> in) const = 0;
  /// Layers of a port that are read. Errors: as output.
  virtual std::vector<LayerUse> reads(int port, std::span<const SequenceDesc> in) const = 0;
  /// Frames of a port that making `frame` reads, in ascending order and within in[port].reach.
  virtual std::vector<int> inputs(int /*port*/, int frame, std::span<const SequenceDesc> /*in*/) const {
    return {frame};
  }
  /// What a frame depends on besides the parameters, its input frames and which ones these are: where it counts from
  /// the ends of the sequence, these. Changes the fingerprint.
  virtual std::string identity(std::span<const SequenceDesc> /*in*/) const { return ""; }
  /// Which of several programs or libraries does the work, where that depends on the machine; recorded in the frames.
  /// Frames of one sequence are made by the same one. Errors: Error{kUnsupported} if it is not there.
  virtual std::string engine() const { return ""; }
  /// Makes run.frames(), in ascending order. Memory: what one window takes, however long the sequence is.
  virtual void run(StageRun& run) const = 0;
};

/// The frames that a FrameStage sees: those that are declared for the one it makes.
class FrameWindow {
 public:
  explicit FrameWindow(StageRun& run) : run_(run) {}
  /// Makes the inputs of `frame` available and forgets all others. Errors: those of StageRun::read.
  void move_to(int frame, const Stage& stage);
  bool has(int frame, int port = 0) const { return frames_.contains({port, frame}); }
  /// The declared layers of a frame, as far as the file has them. Pre: has(frame, port).
  const Frame& at(int frame, int port = 0) const { return frames_.at({port, frame}); }
  std::span<const SequenceDesc> in() const;

 private:
  StageRun& run_;
  std::map<std::pair<int, int>, Frame> frames_;
};

/// A stage that makes each frame alone, from a few of its input.
class FrameStage : public Stage {
 public:
  void run(StageRun& run) const final;

 protected:
  /// Makes `frame`. `out` is StageRun::start(frame): what passes through is in it already.
  virtual void make(const FrameWindow& in, int frame, Frame& out) const = 0;
};

/// Frames frame - before to frame + after, as far as in.reach goes.
std::vector<int> frames_around(int frame, int before, int after, const SequenceDesc& in);

struct StagePort {
  std::string name;  ///< of the command's argument
  std::string help;  ///< what frames it takes
  /// In a shot, whether it gets guides: frames of the shot's size that are rendered with few samples, any of them.
  bool guides = false;
};

/// Layers in the manual.
struct LayerHelp {
  std::vector<std::string> layers;  ///< names, or "offset.*", "class.*"
  std::string help;
};

/// A stage that users can choose, and its manual.
struct StageEntry {
  std::string name;          ///< of the stage, its command, and its table in shot.toml
  std::string help;          ///< what it makes, for lists
  std::string command_help;  ///< the same as a sentence
  std::string done;          ///< what happened to its frames: "reconstructed"
  /// None is called `path`, the key of shot.toml for the place of the frames, or like a flag that the commands of all
  /// stages have (frames, output, resume, ...).
  std::vector<ParamSpec> params;
  /// In a shot the first port gets the frames of the step before, all others get the rendered ones, or guides.
  std::vector<StagePort> ports;
  std::string output_help;  ///< what its frames are
  std::vector<LayerHelp> reads, writes;
  std::string window;    ///< which frames it reads to make one
  std::string gap_help;  ///< for the message that frames among them are missing
  std::vector<std::string> examples;
  /// Errors: StageParamError for values that do not go with each other.
  std::unique_ptr<Stage> (*make)(const Params& params);
  /// Whether rendered frames of these layers are made for this stage, so that it follows where a shot names no stages.
  bool (*follows)(std::span<const LayerDesc> layers) = nullptr;
  std::string follows_help{};  ///< what such frames are
  /// Where plans of shots put it by themselves, for the manual; empty: shots name it.
  std::string inserted_help{};
  /// How many times smaller the frames of its first port are than its own, in width and height.
  int enlarges = 1;
  /// Whether the frames of its first port are keys, with others in between that the step before does not make.
  bool takes_keys = false;
  /// Whether its frames have to be sharp: a shot with it renders them with a shutter that is open for no time.
  bool sharp = false;
  /// Whether it opens the shutter again, for as long as its parameter `shutter` says: in a shot, that of the shot.
  bool opens_shutter = false;
  /// Whether its parameter `cuts` is that of the shot, where none is given.
  bool takes_cuts = false;
};

/// All stages, in the order of the manual, which is that in which they would follow each other.
std::span<const StageEntry* const> stage_catalog();
/// Errors: Error{kUnknownName} at `loc` with the known names.
const StageEntry& find_stage(const std::string& name, const SourceLoc& loc = {});

/// A stage that was chosen, with its parameters.
struct StageChoice {
  const StageEntry* entry = nullptr;
  Params params;
  /// Errors: as StageEntry::make.
  std::unique_ptr<Stage> make() const { return entry->make(params); }
};

/// The first layer that `stage` needs and `in` lacks; none if it lacks none. Errors: as Stage::output.
std::optional<LayerUse> missing_layer(const Stage& stage, std::span<const SequenceDesc> in);

}  // namespace tempera
