// SPDX-License-Identifier: Apache-2.0
#include "reconstruct_settings.h"

#include <fmt/format.h>

#include <cmath>
#include <string>
#include <utility>

#include "tempera/core/error.h"
#include "tempera/core/vec.h"
#include "tempera/stages/reconstruct.h"
#include "tempera/stages/stage.h"

namespace tempera {
namespace reconstruction {

Settings::Settings(const Params& p, bool two_passes, bool rare, std::vector<std::string> class_names)
    : temporal(two_passes), classes(std::move(class_names)) {
  poisson = p.get_string("schedule") == "published" ? PoissonSettings::published() : PoissonSettings{};
  poisson.norm = p.get_string("norm") == "l1" ? PoissonNorm::kL1 : PoissonNorm::kL2;
  if (p.get_string("device") == "cuda") poisson.device = PoissonDevice::kCuda;
  poisson.weights.alpha = float(p.get_double("alpha"));
  if (const int n = p.get_int("rounds"); n > 0) poisson.rounds = n;
  if (const int n = p.get_int("iterations"); n > 0) poisson.l2_steps = poisson.round_steps = n;
  const std::string& rows = p.get_string("temporal_rows");
  runs.mixed = rows == "all";
  runs.strict_mixed = p.get_bool("strict_mixed");
  if (!runs.mixed) poisson.weights.mixed = 0;
  const std::string& rule = p.get_string("weights");
  if (!temporal && rule == "variance") {
    throw Error(ErrorCode::kBadInput,
                "weights = \"variance\" compares the two passes of temporal_gradient_path, and these frames have one; "
                "auto and uniform take any");
  }
  weighted = temporal && (rule == "variance" || (rule == "auto" && poisson.norm == PoissonNorm::kL1));
  const std::string& rare_rule = p.get_string("rare");
  if (rare_rule == "apart" && !rare) {
    throw Error(ErrorCode::kBadInput,
                "rare = \"apart\" needs frames with the layers of rare light (rare.color and others), which gradient-"
                "domain integrators write unless told not to (rare = false); auto and together take any");
  }
  apart = rare && (rare_rule == "apart" || (rare_rule == "auto" && poisson.norm == PoissonNorm::kL1));
  parts = apart && p.get_string("parts") == "yes";
  window = p.get_int("window");
  overlap = p.get_int("overlap");
  if (overlap < 0) overlap = window / 2;
  if (overlap >= window) {
    throw StageParamError(
        ErrorCode::kOutOfRange, {"overlap", "window"},
        fmt::format("an overlap of {} frames needs windows of more than {}, not of {}", overlap, overlap, window));
  }
  if (rows == "none" || !temporal) window = 1, overlap = 0;
}

bool keeps_piece(const FrameRange& piece, bool goes_on, int begin, int length, int step) {
  const bool in_previous = piece.last <= begin + length - 1 - step;
  const bool in_next = piece.first >= begin + step && goes_on;  // else the next one is equal and leaves it to this one
  return !in_previous && !in_next;
}

}  // namespace reconstruction

std::vector<FrameRange> reconstruction_windows(const FrameRange& segment, int length, int overlap) {
  TEMPERA_ASSERT(overlap >= 0 && overlap < length && segment.first <= segment.last);
  const reconstruction::WindowGrid grid{length, length - overlap};
  std::vector<FrameRange> out;
  for (int k = grid.first_with(segment.first); k <= grid.last_with(segment.last); ++k) {
    const FrameRange piece{std::max(segment.first, grid.begin(k)), std::min(segment.last, grid.end(k))};
    if (reconstruction::keeps_piece(piece, piece.last < segment.last, grid.begin(k), length, grid.step))
      out.push_back(piece);
  }
  return out;
}

double window_weight(int frame, int begin, int length) {
  const double k = frame - begin + 1;
  return 0.5 * (1 + std::cos(2 * kPiD * (k - 0.5 * (length + 1)) / length));
}

}  // namespace tempera
