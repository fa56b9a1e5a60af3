// SPDX-License-Identifier: Apache-2.0
#pragma once
// A frame in progress on disk: the finished tiles with all layers. Written whole or not at all; a damaged, foreign or
// outdated file is refused with the reason.
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "tempera/frames/frame.h"
#include "tempera/pipeline/render.h"

namespace tempera {

/// Side of the square work units in pixels. A constant, so that checkpoints fit any later run.
inline constexpr int kTileSize = 32;

/// Tiles that cover [0,width) x [0,height), row by row.
std::vector<Tile> make_tiles(int width, int height);

struct CheckpointState {
  std::vector<char> done;  ///< per tile: 1 if its pixels are final
  double seconds = 0;      ///< spent on the frame so far
  RenderTotals totals;     ///< of the finished tiles
};

/// Name of the checkpoint of a frame file.
std::string checkpoint_path(const std::string& frame_file);

/// Errors: Error{kFailed}, as write_file.
void save_checkpoint(const std::string& path, const std::string& fingerprint, const Frame& frame,
                     std::span<const Tile> tiles, const CheckpointState& state);

/// Copies the finished tiles into `frame`, which has all layers already, and returns the state; none, with `why` set,
/// if the file does not belong to this frame. Pre: the file exists.
std::optional<CheckpointState> load_checkpoint(const std::string& path, const std::string& fingerprint, Frame& frame,
                                               std::span<const Tile> tiles, std::string& why);

}  // namespace tempera
