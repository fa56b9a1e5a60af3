// SPDX-License-Identifier: Apache-2.0
#pragma once
// Published Mitsuba scenes with a moving camera: a small scene file of ours that includes theirs.
#include "builder.h"

namespace tempera::gallery {

/// Writes scene.xml with a sensor "camera" whose pose is given for each frame, and the scene that the gallery's one
/// needs. `fov_x` is the full horizontal angle in degrees.
void include_published(GalleryBuilder& b, double fov_x, const std::function<Vec3d(double frame)>& eye,
                       const std::function<Vec3d(double frame)>& target);

}  // namespace tempera::gallery
