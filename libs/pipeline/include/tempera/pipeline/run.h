// SPDX-License-Identifier: Apache-2.0
#pragma once
// What `tempera run` does with a shot: which frames it renders, which stages make what of them, what it makes a movie
// of, and where the files of each step go; and the steps between the render and the movie, one after the other.
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/frames/sequence.h"
#include "tempera/pipeline/render.h"
#include "tempera/pipeline/shot.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

/// A stage with what it makes.
struct RunStage {
  StageChoice choice;
  std::string output;                  ///< of its frames, see frame_path
  std::vector<int> frames;             ///< that it makes, in ascending order
  std::vector<StageSection> sections;  ///< the same in the parts of the sequence that are cut from each other
  WriteOptions write;
  std::vector<std::string> leave_out{};  ///< layers that are not written
  /// What is rendered before it, for its second port: the pixels of the mask that the stage before has written.
  std::optional<Shot> pixels;
};

/// What a bound on the frames around those asked for costs.
struct HaloLoss {
  std::vector<int> left_out;   ///< rendered frames that the result depends on and that are not made
  std::vector<int> differing;  ///< frames of the result that depend on them, and so differ from those of the whole shot
  int enough = 0;              ///< the least bound that leaves none out
};

struct RunPlan {
  Shot render;                   ///< what the first step renders, and where to
  std::optional<Shot> guides;    ///< what is rendered with few samples after it, where stages take guides
  std::vector<int> neighbors;    ///< frames among render.frames that were not asked for: stages look at them
  std::vector<int> frames;       ///< of the result: those asked for that the last stage makes
  std::vector<RunStage> stages;  ///< the steps after it: the stages of the shot, and those that fill what they mask
  HaloLoss loss;
  std::string output;      ///< of the frames that are the result, see frame_path
  std::string video_path;  ///< empty: no movie
};

/// Settles the steps of a shot, backwards from the frames that were asked for. A frame of the result depends on the
/// shot alone, not on which frames were asked for: to that end frames around them, within `shot.sequence`, are made as
/// well where stages look beyond them. With `shot.halo` each run of frames asked for is made as if the shot ended so
/// many frames around it. The movie of a part of the sequence gets the numbers of its first and last frame into its
/// name, unless it was named on the command line; a single frame gets none unless one is named. `video` false: no
/// movie.
/// Errors: Error{kBadInput | kUsage}, where `config` says so: a stage that lacks a layer, with what would write it;
/// frames that no stage makes, or that would replace those they are made of; a stage that has pixels rendered where the
/// integrator renders whole pictures alone; a movie of a layer that the frames will not have, a name that no movie can
/// have.
RunPlan plan_run(const ShotConfig& config, const Shot& shot, bool video = true);

/// The frames of a stage's ports when the steps before it are done. `step`: index in plan.stages.
std::vector<FrameSequence> stage_input(const RunPlan& plan, std::size_t step);

/// Watches run_stages. Each step begins, is watched by what that returns, and ends.
class RunObserver {
 public:
  virtual ~RunObserver() = default;
  virtual std::unique_ptr<RenderObserver> begin_guides(const Shot& /*guides*/) {
    return std::make_unique<RenderObserver>();
  }
  virtual void end_guides(const Shot& /*guides*/, const RenderReport& /*report*/) {}
  virtual std::unique_ptr<RenderObserver> begin_pixels(const RunStage& /*of*/) {
    return std::make_unique<RenderObserver>();
  }
  virtual void end_pixels(const RunStage& /*of*/, const RenderReport& /*report*/) {}
  virtual std::unique_ptr<StageObserver> begin_stage(const RunStage& /*stage*/) {
    return std::make_unique<StageObserver>();
  }
  virtual void end_stage(const RunStage& /*stage*/, const StageReport& /*report*/) {}
};

/// Runs the stages of a plan whose frames are rendered, with the renders of guides before and of single pixels between
/// them. `scene` is that
/// of the plan's shot, and not looked at where no step renders. `options`: as for the render of the shot, whole frames;
/// frames of pixels that were not asked for are taken where they are finished.
/// Errors: those of render_sequence and run_stage.
void run_stages(const RunPlan& plan, const Scene& scene, const RenderOptions& options, RunObserver& observer,
                const std::stop_token& stop = {});

/// Identity of the movie of `frames`: it changes with the content of the files and with the options. Errors: as
/// content_identity.
std::string movie_identity(const FrameSequence& frames, const VideoOptions& options);

}  // namespace tempera
