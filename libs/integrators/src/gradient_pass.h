// SPDX-License-Identifier: Apache-2.0
#pragma once
// One pass of gradient-domain path tracing over a tile: picture and differences of neighbouring pixels.
#include <functional>
#include <stop_token>
#include <string>
#include <vector>

#include "path_tracer.h"

namespace tempera {

struct GradientOptions {
  PathOptions path;
  float roughness_threshold = 0.001f;

  static const std::vector<ParamSpec>& params();
  explicit GradientOptions(const Params& p);
};

/// Layers that a pass keeps until all tiles are there: the estimates of each difference from either side.
std::vector<LayerDesc> gradient_work_layers(const std::string& prefix = "");

/// Renders `spp` samples of each pixel of the tile, with the random numbers that `key(x, y)` says, into the layers of
/// `out` that begin with `prefix`. Returns false if it was stopped.
bool gradient_pass(const FrameContext& context, const GradientOptions& options, const Tile& tile, int spp,
                   const std::function<PixelKey(int, int)>& key, const std::string& prefix, Frame& out,
                   RenderCounters& counters, const std::stop_token& stop);

/// Joins the two estimates of each difference: mean of g_ij minus mean of g_ji. [Manzi 2016, Eq. 1]
void join_gradients(const std::string& prefix, Frame& out);

/// Errors: Error{kUnsupported} for a rolling shutter, naming `integrator`.
void check_gradient_settings(const RenderSettings& settings, std::string_view integrator);

}  // namespace tempera
