// SPDX-License-Identifier: Apache-2.0
#pragma once
// What shot.toml changes in a scene's cameras, lights and moving vertices: the tables [camera], [cameras.<camera>],
// [lights.<light>] and [caches.<mesh>]. Their parameters feed the parser and the manual.
#include <span>
#include <string>

#include "tempera/core/params.h"
#include "tempera/methods/method.h"
#include "tempera/pipeline/shot_config.h"
#include "tempera/scene/scene.h"

namespace tempera {

std::span<const ParamSpec> camera_params();
std::span<const ParamSpec> light_params();
std::span<const ParamSpec> cache_params();

// These return what they changed as canonical text, for fingerprints. Errors, each at the value in shot.toml:
// Error{kUnknownName} for a camera, light, mesh or parameter that there is not, with those that there are;
// Error{kBadInput | kOutOfRange} for a value that cannot be read, is out of range or does not fit the object.

/// [cameras.<camera>] by name or index, then [camera] for the one that renders. `settings` says the size of the
/// picture.
std::string edit_cameras(const ShotConfig& config, const RenderSettings& settings, Scene& scene);
/// [lights.<light>]: lights by their own name or their node's, emitting objects by theirs.
std::string edit_lights(const ShotConfig& config, const FrameClock& clock, Scene& scene);
/// [caches.<mesh>]: meshes by the name of the object or their own. The scene's animation then covers the samples, too.
/// Errors also Error{kMissingFile}, and those of VertexCache::open.
std::string attach_caches(const ShotConfig& config, const FrameClock& clock, Scene& scene);

/// "5", or keys "1:5, 24:7.5" at frames: linear in between, the first and last value outside.
/// Errors at `loc`: Error{kBadInput}; Error{kOutOfRange} for a value outside [min, max].
Animated<float> parse_keys(const std::string& name, const std::string& text, const FrameClock& clock,
                           const SourceLoc& loc, double min, double max);

}  // namespace tempera
