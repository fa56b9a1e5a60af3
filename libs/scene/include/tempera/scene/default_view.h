// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a viewer shows of a file that has no camera or no light: models are often published without either.
#include "tempera/scene/scene.h"

namespace tempera {

/// World box of everything at time t; meshes of many vertices are sampled.
Bounds3f world_bounds(const Scene& scene, double t);
/// Adds a perspective camera in front (on the +z side, a little from the right and above) that sees the whole
/// animation. Pre: the scene has no camera.
void add_default_camera(Scene& scene);
/// Whether anything in the scene gives light.
bool has_light(const Scene& scene);
/// Adds a dim even environment and a directional light from the upper left of the default camera.
void add_default_light(Scene& scene);

}  // namespace tempera
