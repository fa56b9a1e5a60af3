// SPDX-License-Identifier: Apache-2.0
#pragma once
// The stage `reconstruct`: turns the pictures and differences that a gradient-domain integrator wrote into final
// frames, window by window, from files alone. The solver of one window is in poisson.h.
//
// Layers read of a frame t: `color`, `grad.x`, `grad.y` (the base pass B_t), and for sequences `offset.color`,
// `offset.grad.x`, `offset.grad.y` (the offset pass O_t, which replays the random numbers of frame t - 1),
// `offset.source` (the pixel of frame t - 1 whose numbers a pixel replays) and `offset.samples`. Where the light of
// rare paths is solved for apart: `rare.color`, `rare.grad.x`, `rare.grad.y` and `held.color` of both passes, or of one
// with `rare.a` and `rare.b`; and, as far as they are there, `samples`, `albedo`, `normal` and `object_id`.
#include <functional>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/sequence.h"
#include "tempera/stages/poisson.h"
#include "tempera/stages/stage_observer.h"

namespace tempera {

/// The parameters of the stage: for parsers, `tempera list` and the manual.
std::span<const ParamSpec> reconstruct_params();

/// Checks what the parameters say together. Errors: Error{kOutOfRange} for an overlap as long as the window.
void check_reconstruct_params(const Params& params);

/// The windows that frames [segment.first, segment.last] without a cut are solved in. Window k covers the frames
/// [k step, k step + length) with step = length - overlap, whatever the segment's start: where a part of a sequence is
/// reconstructed apart, its windows are those of the whole. Windows are clipped to the segment, and those that another
/// one contains are left out. Pre: 0 <= overlap < length.
std::vector<FrameRange> reconstruction_windows(const FrameRange& segment, int length, int overlap);

/// Weight of frame `frame` in the window of length `length` that covers it and begins at `begin` before clipping.
/// Source: [Manzi 2016, Sec. 5], a Hann window, to be divided by the sum over windows. In (0, 1].
double window_weight(int frame, int begin, int length);

/// Whether frames of these layers are made to be reconstructed: they hold differences.
bool has_differences(std::span<const LayerDesc> layers);

/// Frames of the input that reconstructing `frames` reads, in ascending order: they and, for layers with an offset
/// pass, all that share a window with one of them. `sequence`: all frames that there can be; pre: it contains `frames`.
/// Errors: as check_reconstruct_params.
std::vector<int> reconstruction_inputs(std::span<const int> frames, const FrameRange& sequence, const Params& params,
                                       std::span<const LayerDesc> layers);

/// Whether the output holds this layer of the input: neither data of the reconstruction, nor statistics or parts
/// (class.*) of the input's `color`, which are not those of the solution.
bool survives_reconstruction(const std::string& layer);

struct ReconstructOptions {
  Params params{reconstruct_params()};
  std::vector<int> frames;  ///< frames to write; empty: all of the input
  /// What the sequence consists of, whatever else is there or is not there yet; none: the frames of the input. Windows
  /// end with it, so parts of one sequence agree on it.
  std::optional<FrameRange> sequence;
  bool resume = false;  ///< skip frames whose file is complete and would be the same
  WriteOptions write;
  std::string command;  ///< for the metadata
};

struct ReconstructReport {
  std::vector<int> frames;   ///< written
  std::vector<int> skipped;  ///< already finished
  std::vector<int> cuts;     ///< first frames after a cut, among those that were read
  /// Of the light of the written frames: the share that was kept apart, and that which was held back. 0 if all light
  /// was solved for together.
  double rare_light = 0, held_back = 0;
  double seconds = 0;
};

/// Writes the frames of `input` to `output` (see frame_path; a name without a place for the number for one frame):
/// `color` is the solution, with the input's alpha; other layers are copied if they survive_reconstruction. With rare
/// light apart: `color` has no negative values; `color.common` and `color.rare` are its two parts, the second one
/// before it was smoothed; the metadata tempera/rare_light and tempera/held_back are the shares of the report, frame by
/// frame. Result:  a function of the input files and parameters: the same bits for any number of threads, any choice of
///          frames, and after any interruption, as long as all frames of the windows are there.
/// Memory:  the frames of one window, whatever the length of the sequence.
/// Errors:  Error{kBadInput} for a missing layer, frames of different sizes, values that are not finite, sources that
///          are not one-to-one, gaps in the frame numbers of a sequence with an offset pass, each naming file and
///          layer; Error{kUsage} if a frame would replace its own input; Error{kCancelled} after `stop`: finished
///          frames stay; those of read_frame and write_frame.
/// Source:  [Manzi 2016, Sec. 3.3, 4.2, 5].
ReconstructReport reconstruct(const FrameSequence& input, const std::string& output, const ReconstructOptions& options,
                              StageObserver& observer, std::stop_token stop = {});

}  // namespace tempera
