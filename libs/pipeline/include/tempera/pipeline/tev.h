// SPDX-License-Identifier: Apache-2.0
#pragma once
// Live tiles in the image viewer tev. A viewer that is absent, slow or gone never delays or fails a render.
// Source: the message layout of tev's inter-process communication (little endian, strings end with 0):
//   u32 length including itself, u8 kind, payload
//   4 create image:  u8 grab_focus, name, i32 width, i32 height, i32 channels, channel names
//   6 update v3:     u8 grab_focus, name, i32 channels, channel names, i32 x, y, width, height,
//                    i64 offset per channel, i64 stride per channel, float data
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "tempera/pipeline/render.h"

namespace tempera {

inline constexpr int kTevPort = 14158;  ///< where tev listens unless told otherwise

/// "host", "host:port", ":port", "[::1]:port".
struct TevAddress {
  std::string host = "127.0.0.1";
  int port = kTevPort;
};
/// Errors: Error{kUsage}.
TevAddress parse_tev_address(std::string_view text);

struct TevOptions {
  double interval = 0.1;     ///< seconds between two batches of tiles, at least
  double flush_seconds = 2;  ///< how long the end of a render waits for the viewer to take the last tiles
  double retry_seconds = 2;  ///< between two attempts to connect
};

/// Shows the layer `color` of the frame in progress under `name`. Keeps one copy of the picture and the list of tiles
/// that the viewer lacks: its memory does not grow with a slow viewer, and one that comes late gets the whole picture.
/// Threads: works on a thread of its own; observers' calls only copy.
std::unique_ptr<RenderObserver> make_tev_display(const TevAddress& address, const std::string& name,
                                                 const TevOptions& options = {});

}  // namespace tempera
