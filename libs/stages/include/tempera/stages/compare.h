// SPDX-License-Identifier: Apache-2.0
#pragma once
// Frame sequences against a reference: figures of each frame and their means, as a table, JSON or CSV.
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "tempera/frames/sequence.h"
#include "tempera/stages/metrics.h"

namespace tempera {

struct CompareOptions {
  std::string layer = "color";
  std::vector<int> frames;  ///< which to compare; empty: all that both sides have
  double epsilon = 1e-2;    ///< of relative_mse
  float exposure = 0;       ///< stops, for `flip`: the pictures are shown clipped at 1 after this exposure
  bool flip = true;         ///< whether to compute flip, which costs more than the others
  bool hdr_flip = true;     ///< whether to compute hdr_flip, which costs as much as about ten of flip
  float pixels_per_degree = kPixelsPerDegree;
};

/// The errors of one frame, or means of them over frames. A figure that was not asked for is negative.
struct FrameFigures {
  int frame = 0;
  double mse = 0;
  double relative_mse = 0;
  double flip = -1;
  double hdr_flip = -1;
  std::int64_t non_finite = 0;  ///< pixels of the test image that are not finite; a sum in the mean
};

/// One of the sequences that are compared with the reference.
struct CompareSide {
  std::string name;
  std::vector<FrameFigures> frames;  ///< in ascending order
  FrameFigures mean;                 ///< over `frames`; its `frame` is the number of frames
  std::vector<int> unmatched;        ///< frames that this side has and the reference lacks
};

struct CompareResult {
  std::string reference;
  std::string layer;
  std::vector<CompareSide> sides;
};

/// Called after each pair of frames. Throw Error{kCancelled} from it to stop.
using CompareProgress = std::function<void(int done, int total)>;

/// The figures of one pair of pictures; `frame` is left 0.
/// Errors: Error{kBadInput} if the sizes differ.
FrameFigures compare_images(const Image& test, const Image& reference, const CompareOptions& options = {});

/// Compares each of `tests` with `reference` frame by frame. A reference of a single frame stands for every frame of
/// the tests (a converged picture of a still scene). Memory: two layers at a time. Errors: Error{kBadInput} if a test
/// has no frame in common with the reference or the sizes of a pair differ, naming
///         both files; those of read_frame.
CompareResult compare_sequences(const std::vector<FrameSequence>& tests, const FrameSequence& reference,
                                const CompareOptions& options = {}, const CompareProgress& progress = {});

/// {"layer", "reference", "sides": [{"name", "mean": {...}, "frames": [{...}], "unmatched": [...]}]}; figures that were
/// not asked for are left out.
std::string to_json(const CompareResult& result);
/// A line "name,frame,mse,relative_mse,flip,hdr_flip,non_finite" for each frame, and one with frame "mean" for each
/// side; figures that were not asked for are empty.
std::string to_csv(const CompareResult& result);
/// The means as a table for people, one side a line, and the ratio to the first side where there are several.
std::string to_table(const CompareResult& result);

}  // namespace tempera
