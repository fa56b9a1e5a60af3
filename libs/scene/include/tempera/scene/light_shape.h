// SPDX-License-Identifier: Apache-2.0
#pragma once
// Lights that get a size.
#include "tempera/scene/scene.h"

namespace tempera {

/// Turns the point or spot light scene.lights[light] into an emitting sphere of `radius` metres around its node's
/// origin, an instance of the light's name: its radiance is intensity / (pi radius^2), so that it sends out the same
/// power in every direction. A spot keeps its cone by direction. Scale of its node does not change the radius. The
/// light is taken out of scene.lights. `camera_visible`: of the instance. Errors: Error{kBadInput} for a node whose
/// transform at the start is singular. Pre: radius > 0.
void make_sphere_light(Scene& scene, int light, float radius, bool camera_visible);

}  // namespace tempera
