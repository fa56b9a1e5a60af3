// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the parameters of `reconstruct` come to for the frames that it is given, and how windows lie in a sequence.
#include <algorithm>
#include <string>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/stages/motion_runs.h"
#include "tempera/stages/poisson.h"

namespace tempera::reconstruction {

inline int floor_div(int a, int b) { return a >= 0 ? a / b : -((-a + b - 1) / b); }

/// Windows of a sequence by number.
struct WindowGrid {
  int length, step;
  int begin(int k) const { return k * step; }
  int end(int k) const { return k * step + length - 1; }  ///< its last frame
  int first_with(int frame) const { return floor_div(frame - length, step) + 1; }
  int last_with(int frame) const { return floor_div(frame, step); }
  /// The frames of window k that the sequence has.
  FrameRange clipped(int k, const FrameRange& sequence) const {
    return {std::max(begin(k), sequence.first), std::min(end(k), sequence.last)};
  }
  /// The frames that share a window with `frame`.
  FrameRange around(int frame, const FrameRange& sequence) const {
    return {clipped(first_with(frame), sequence).first, clipped(last_with(frame), sequence).last};
  }
};

/// Parameters in the form in which the stage needs them.
struct Settings {
  /// `two_passes`: whether the frames have an offset pass; without it there is nothing that windows could share.
  /// `rare`: whether they have the layers of rare light. `class_names`: of those that have differences.
  /// Errors: Error{kBadInput} where the parameters ask for what the frames lack, StageParamError{kOutOfRange}.
  Settings(const Params& p, bool two_passes, bool rare, std::vector<std::string> class_names = {});
  WindowGrid grid() const { return {window, window - overlap}; }
  PoissonSettings poisson;
  MotionRunOptions runs;
  bool temporal;                     ///< whether the frames have an offset pass
  bool weighted = false;             ///< whether differences are weighted by their variance
  bool apart = false;                ///< whether rare light is solved for apart
  bool parts = false;                ///< whether both parts are written
  bool photons = false;              ///< whether the frames have light of photons
  std::vector<std::string> classes;  ///< light-path classes that are solved for, too
  int window = 10, overlap = 5;
};

/// Whether the part `piece` of window k is solved, or left to a neighbouring window that contains it.
/// `goes_on`: the segment has frames after the piece.
bool keeps_piece(const FrameRange& piece, bool goes_on, int begin, int length, int step);

}  // namespace tempera::reconstruction
