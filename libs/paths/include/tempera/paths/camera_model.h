// SPDX-License-Identifier: Apache-2.0
#pragma once
// A camera at any time of the shot: rays out of it, and projection of points onto its film.
#include <cstdint>
#include <optional>
#include <vector>

#include "tempera/accel/motion_grid.h"
#include "tempera/core/time.h"
#include "tempera/scene/scene.h"

namespace tempera {

struct CameraRay {
  Vec3f o, d;                        ///< world; d is unit length
  float tmin = 0, tmax = kInfinity;  ///< where the ray passes the near and the far clipping plane
  Vec3f axis;                        ///< the camera's axis at that time, unit length
};

/// How the camera sees a point through one point of its lens.
struct Importance {
  CameraRay ray;       ///< the one that arrives at the point: what ray() makes of `pixel` and the lens point
  float distance = 0;  ///< along it to the point, between tmin and tmax: in front of tmin nothing hides the point
  Vec2f pixel;         ///< film position, also outside of the film
  /// Pixels per square metre of a surface that faces the ray at the point: how dense rays arrive there if one starts in
  /// every pixel, all through this point of the lens.
  float we = 0;
};

/// A camera for a film of width x height pixels. Scale in its node's transform widens or narrows the picture and does
/// not change metres along the view axis or on the lens. Threads: const and re-entrant.
class CameraModel {
 public:
  /// `span`: times that will be asked for; within it the pose is resampled on the grid of `motion_step` seconds, as
  /// matter is: translation and scale linear, rotation slerp, picture size and lens linear between the knots; where
  /// the camera jumps, nothing lies between. `scene` is only read here. Errors: Error{kBadInput} for a transform that
  /// is singular or not finite; Error{kOutOfRange} for a field of view, lens or clipping distance outside its range, or
  /// a span of more than a million knots; both name the camera.
  CameraModel(const Scene& scene, int camera, int width, int height, TimeSpan span, double motion_step);

  /// Ray through film position `pixel` (pixels, (0,0) top left corner) and lens point u in [0,1)^2 at time t.
  CameraRay ray(const Vec2f& pixel, const Vec2f& lens, double t) const;
  /// Film position (pixels) of a world point at time t through the center of the lens, and its distance along the view
  /// axis (metres; an orthographic camera sees points behind it, at negative ones). Empty behind or in the plane of a
  /// perspective camera, and farther from the center of the picture than kReach times its longer side: close to that
  /// plane a film position is little more than rounding.
  static constexpr double kReach = 16;
  struct Projected {
    Vec2f pixel;
    float depth = 0;
  };
  std::optional<Projected> project(const Vec3f& p, double t) const;
  /// The same in double: x and y on the film, and the distance along the view axis.
  std::optional<Vec3d> project_double(const Vec3d& p, double t) const;
  /// Line of sight through film position `pixel` and the center of the lens at time t, in double: from its origin in unit
  /// direction d, seen between tmin and tmax. Orthographic cameras: the origin is in the plane of the camera.
  struct Sight {
    Vec3d o, d;
    double tmin = 0, tmax = 0;
  };
  Sight sight(const Vec2d& pixel, double t) const;
  /// The importance of a world point at time t through lens point u in [0,1)^2; empty where the camera does not see it
  /// whatever is in between: behind or beyond its clipping planes, or farther from the picture than project() goes.
  ///
  /// Measure: the estimate of a pixel is the mean of radiance over rays, film positions x with the density h(x) of the
  /// pixel filter, lens points u evenly in [0,1)^2. Change x for the point p where the ray ends:
  ///   I = int du int dA(p) h(pixel(p, u)) we(p, u) |cos(n(p), ray.d)| L(p -> lens),
  /// so a light subpath that arrives at p with flux beta and is scattered by f towards the lens adds
  ///   beta f |cos(n(p), ray.d)| we h(pixel)
  /// to it if nothing is in between. In the usual terms we = We |cos(lens)| / (distance^2 pdf_area(lens)), where We is
  /// per pixel: the lens point's density is in it already. Rays are we distance^2 per steradian and pixel. The same
  /// holds for pinholes, where u does not matter, and for orthographic cameras, where directions do not spread.
  std::optional<Importance> importance(const Vec3f& p, const Vec2f& lens, double t) const;
  /// The same for a direction, i.e. a point at infinity. Empty for orthographic cameras, too.
  std::optional<Vec2f> project_direction(const Vec3f& d, double t) const;
  bool is_perspective() const { return perspective_; }
  /// World-space view axis (unit) at time t, and the position of the camera.
  Vec3f axis(double t) const;
  Vec3f position(double t) const;

 private:
  /// What is interpolated: world_from_camera = translate * rotate * upper triangular matrix.
  struct Knot {
    Vec3d translation;
    Quatd rotation;
    Vec3d scale, skew;  ///< diagonal; xy, xz, yz
    double half_width = 1,
           half_height = 1;  ///< of the picture: at distance 1 (perspective) or everywhere (orthographic)
    double aperture = 0, focus = 1;
  };
  /// What rays are made from.
  struct Pose {
    Affine3d world_from_camera;  ///< its z is a unit vector
    Vec3d lens_x, lens_y;        ///< unit, if there is an aperture
    double half_width = 1, half_height = 1, aperture = 0, focus = 1;
  };
  Knot sample(const Scene& scene, const Camera& camera, const MotionPieces::Knot& at) const;
  Pose compose(const Knot& knot) const;
  Pose interpolate(double t) const;
  /// Calls f with the pose at t; without copies for cameras that stand still.
  template <class F>
  auto with_pose(double t, F&& f) const {
    return knots_.empty() ? f(still_) : f(interpolate(t));
  }
  /// Film position of a point of the picture, in halves of its size from the center; empty beyond kReach.
  std::optional<Vec2d> to_pixel(double x, double y) const;

  bool perspective_;
  Vec2d size_;     ///< of the film in pixels
  double aspect_;  ///< of the picture: width over height
  Vec2d offset_;   ///< of the picture in fractions of its size
  double near_, far_;
  Pose still_;  ///< of a camera that does not change
  MotionPieces pieces_;
  std::vector<Knot> knots_;  ///< at those of pieces_; empty if nothing changes
};

/// Appends the times within the open `span` (seconds) at which the camera jumps to another view.
void camera_jumps(const Scene& scene, const Camera& camera, TimeSpan span, std::vector<double>& out);

}  // namespace tempera
