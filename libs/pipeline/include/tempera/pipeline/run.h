// SPDX-License-Identifier: Apache-2.0
#pragma once
// What `tempera run` does with a shot: which frames it renders, whether they are reconstructed, what it makes a movie
// of, and where the files of each step go. Only the plan; render.h, stages and video.h do the work.
#include <string>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/frames/sequence.h"
#include "tempera/pipeline/shot.h"

namespace tempera {

struct RunPlan {
  Shot render;                 ///< what the first step renders, and where to
  std::vector<int> neighbors;  ///< frames among render.frames that were not asked for: the reconstruction reads them
  std::vector<int> frames;     ///< that were asked for
  bool reconstructs = false;   ///< whether the integrator writes differences
  FrameRange sequence;         ///< what the reconstruction takes the whole sequence to be
  std::string output;          ///< of the frames that are the result, see frame_path
  std::string video_path;      ///< empty: no movie
};

/// Settles the steps of a shot. A frame of the result depends on the shot alone, not on which frames were asked for: to
/// that end frames around them, within `shot.sequence`, are rendered as well where windows of the reconstruction reach
/// beyond them. The movie of a part of the sequence gets the numbers of its first and last frame into its name, unless
/// it was named on the command line; a single frame gets none unless one is named. `video` false: no movie. Errors:
/// Error{kBadInput | kUsage}, where `config` says so: frames that would replace their own input, a movie of a layer
/// that the frames will not have, a name that no movie can have.
RunPlan plan_run(const ShotConfig& config, const Shot& shot, bool video = true);

/// Identity of the movie of `frames`: it changes with the content of the files and with the options. Errors: as
/// content_identity.
std::string movie_identity(const FrameSequence& frames, const VideoOptions& options);

}  // namespace tempera
