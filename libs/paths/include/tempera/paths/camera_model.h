// SPDX-License-Identifier: Apache-2.0
#pragma once
// A camera at any time of the shot: rays out of it, and projection of points onto its film.
#include <cstdint>
#include <optional>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/scene/scene.h"

namespace tempera {

struct CameraRay {
  Vec3f o, d;  ///< world; d is unit length
  float tmin = 0, tmax = kInfinity;
};

/// A camera for a film of width x height pixels. Threads: const and re-entrant.
class CameraModel {
 public:
  /// `span`: times that will be asked for; within it the pose is resampled on the grid of `motion_step` seconds, as matter is.
  CameraModel(const Scene& scene, int camera, int width, int height, TimeSpan span, double motion_step);

  /// Ray through film position `pixel` (pixels, (0,0) top left corner) and lens point u in [0,1)^2 at time t.
  CameraRay ray(const Vec2f& pixel, const Vec2f& lens, double t) const;
  /// Film position (pixels) of a world point at time t through the center of the lens, and its distance along the view
  /// axis (metres). Empty behind or in the plane of a perspective camera.
  struct Projected {
    Vec2f pixel;
    float depth = 0;
  };
  std::optional<Projected> project(const Vec3f& p, double t) const;
  /// The same for a direction, i.e. a point at infinity.
  std::optional<Vec2f> project_direction(const Vec3f& d, double t) const;
  /// World-space view axis (unit) at time t, and the position of the camera.
  Vec3f axis(double t) const;
  Vec3f position(double t) const;

 private:
  struct Pose {
    Affine3f world_from_camera;
    float tan_x = 1, tan_y = 1;  ///< half extents at distance 1, or half size of an orthographic picture
    float aperture = 0, focus = 1;
  };
  Pose pose(double t) const;
  const Scene* scene_;
  const Camera* camera_;
  int width_, height_;
  double step_;
  bool static_;
  std::int64_t first_knot_ = 0;
  std::vector<Pose> knots_;   ///< poses at knots first_knot_ + i, kept as rotation quaternions beside
  std::vector<Quatd> rotations_;
};

}  // namespace tempera
