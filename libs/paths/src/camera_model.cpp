// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/camera_model.h"

#include <fmt/format.h>

#include <cmath>

#include "tempera/core/error.h"
#include "tempera/shading/microfacet.h"

namespace tempera {
namespace {

constexpr double kMaxKnots = 1e6;

[[noreturn]] void fail(const Scene& scene, const Camera& camera, ErrorCode code, const std::string& what) {
  throw Error(code, SourceLoc{scene.source.string()}, fmt::format("camera \"{}\" {}", camera.name, what));
}

}  // namespace

CameraModel::CameraModel(const Scene& scene, int index, int width, int height, TimeSpan span, double motion_step)
    : size_(width, height) {
  TEMPERA_ASSERT(index >= 0 && index < int(scene.cameras.size()) && width > 0 && height > 0 && motion_step > 0);
  const Camera& camera = scene.cameras[index];
  perspective_ = camera.projection == Projection::kPerspective;
  offset_ = Vec2d(camera.principal_offset);
  near_ = camera.near_clip, far_ = camera.far_clip;
  aspect_ = size_.x / size_.y * camera.pixel_aspect;
  if (!(near_ >= 0 && near_ < far_)) {
    fail(scene, camera, ErrorCode::kOutOfRange,
         fmt::format("has clipping distances {} and {}; valid: 0 <= near < far", near_, far_));
  }
  if (!std::isfinite(offset_.x) || !std::isfinite(offset_.y)) {
    fail(scene, camera, ErrorCode::kOutOfRange, "has a principal offset that is not finite");
  }
  if (!(span.length() / motion_step < kMaxKnots) || !(std::abs(span.begin) / motion_step < 1e15)) {
    fail(scene, camera, ErrorCode::kOutOfRange,
         fmt::format("would need more than {:g} poses {} s apart", kMaxKnots, motion_step));
  }
  const MotionGrid grid{motion_step};
  const TimeSpan knots{grid.time(grid.first(span)), grid.time(grid.last(span))};
  const bool changes = scene.moves(camera.node, knots) ||
                       (perspective_ ? camera.fov_x.varies_over(knots) : camera.width.varies_over(knots)) ||
                       camera.aperture_radius.varies_over(knots) || camera.f_stop.varies_over(knots) ||
                       camera.focus_distance.varies_over(knots) ||
                       (camera.focus_node >= 0 && scene.moves(camera.focus_node, knots));
  if (!changes) {
    still_ = compose(sample(scene, camera, {span.begin, span.begin}));
    return;
  }
  std::vector<double> jumps;
  camera_jumps(scene, camera, span, jumps);
  pieces_ = MotionPieces(grid, span, std::move(jumps), {span.begin, span.begin});
  knots_.reserve(pieces_.knots().size());
  for (const MotionPieces::Knot& at : pieces_.knots()) {
    knots_.push_back(sample(scene, camera, at));
    if (knots_.size() == 1) continue;
    const MotionPieces::Knot& before = pieces_.knots()[knots_.size() - 2];
    // A change of handedness between two poses passes through a flat one, unless it is a jump.
    if (before.piece != at.piece || knots_.back().scale.z * knots_[knots_.size() - 2].scale.z > 0) continue;
    fail(scene, camera, ErrorCode::kBadInput,
         fmt::format("has a scale that passes through zero between {} s and {} s", before.time, at.time));
  }
}

void camera_jumps(const Scene& scene, const Camera& camera, TimeSpan span, std::vector<double>& out) {
  for (int node = camera.node; node >= 0; node = scene.nodes[node].parent) {
    scene.nodes[node].local.jumps(span, out);
  }
  if (camera.projection == Projection::kPerspective) {
    camera.fov_x.jumps(span, out);
  } else {
    camera.width.jumps(span, out);
  }
  camera.aperture_radius.jumps(span, out);
  camera.f_stop.jumps(span, out);
  camera.focus_distance.jumps(span, out);
  scene.jumps(camera.focus_node, span, out);
}

CameraModel::Knot CameraModel::sample(const Scene& scene, const Camera& camera, const MotionPieces::Knot& at) const {
  const double t = at.time, piece = at.piece;
  const Affine3d m = scene.world(camera.node, t, piece);
  const double largest = std::max({length(m.x), length(m.y), length(m.z)});
  const bool regular = is_finite(m.x) && is_finite(m.y) && is_finite(m.z) && is_finite(m.translation) &&
                       std::abs(m.determinant()) > 1e-9 * largest * largest * largest;
  if (!regular) fail(scene, camera, ErrorCode::kBadInput, fmt::format("has a singular transform at {} s", t));

  Knot k;
  const Vec3d x = normalize(m.x), y = normalize(m.y - x * dot(x, m.y)), z = cross(x, y);
  k.translation = m.translation;
  k.rotation = quaternion(Affine3d{x, y, z});
  k.scale = {dot(x, m.x), dot(y, m.y), dot(z, m.z)};
  k.skew = {dot(x, m.y), dot(x, m.z), dot(y, m.z)};

  const auto in_range = [&](double value, double low, double high, const char* what, const char* valid) {
    if (value > low && value < high) return value;
    fail(scene, camera, ErrorCode::kOutOfRange, fmt::format("has {} {} at {} s; valid: {}", what, value, t, valid));
  };
  constexpr double kHuge = 1e18;
  const double half_width =
      perspective_
          ? std::tan(in_range(camera.fov_x.at(t, piece), 0, kPiD, "a horizontal field of view of", "0 to pi") / 2)
          : in_range(camera.width.at(t, piece), 0, kHuge, "a width of", "above 0") / 2;
  if (camera.keep_vertical_fov) {
    k.half_height = half_width / in_range(camera.authored_aspect, 0, kHuge, "an aspect ratio of", "above 0");
    k.half_width = k.half_height * aspect_;
  } else {
    k.half_width = half_width;
    k.half_height = half_width / aspect_;
  }
  const double f_stop = in_range(camera.f_stop.at(t, piece), -1e-30, kHuge, "an f-stop of", "0 or more");
  k.aperture = in_range(camera.aperture_radius.at(t, piece), -1e-30, kHuge, "an aperture radius of", "0 or more");
  if (f_stop > 0) {
    const bool across = camera.sensor_fit == SensorFit::kHorizontal ||
                        (camera.sensor_fit == SensorFit::kAuto && k.half_width >= k.half_height);
    const double focal_length = perspective_ ? in_range(camera.sensor_size, 0, kHuge, "a sensor size of", "above 0") /
                                                   (2 * (across ? k.half_width : k.half_height))
                                             : 1.0;
    k.aperture = focal_length / (2 * f_stop);
  }
  k.focus = camera.focus_node < 0
                ? camera.focus_distance.at(t)
                : std::abs(dot(scene.world(camera.focus_node, t).translation - m.translation, normalize(m.z)));
  if (k.aperture > 0) in_range(k.focus, 0, kHuge, "a focus distance of", "above 0");
  return k;
}

CameraModel::Pose CameraModel::compose(const Knot& k) const {
  const Affine3d upper{{k.scale.x, 0, 0}, {k.skew.x, k.scale.y, 0}, {k.skew.y, k.skew.z, k.scale.z}};
  Affine3d m = rotation(k.rotation) * upper;
  // Metres along the view axis are the world's. A perspective picture sees directions alone: a common factor of all
  // axes changes nothing.
  const double unit = 1 / length(m.z);
  m.z = m.z * unit;
  if (perspective_) m.x = m.x * unit, m.y = m.y * unit;
  m.translation = k.translation;
  const bool pinhole = !(k.aperture > 0);
  return {
      m,      pinhole ? m.x : normalize(m.x), pinhole ? m.y : normalize(m.y), k.half_width, k.half_height, k.aperture,
      k.focus};
}

CameraModel::Pose CameraModel::interpolate(double t) const {
  const auto [i, s] = pieces_.locate(t);
  if (s == 0) return compose(knots_[i]);
  const Knot &a = knots_[i], &b = knots_[i + 1];
  const auto mix = [s = s](double u, double v) { return u + (v - u) * s; };  // exactly u if both are equal
  const auto mix3 = [s = s](const Vec3d& u, const Vec3d& v) { return u + (v - u) * s; };
  return compose({mix3(a.translation, b.translation),
                  a.rotation == b.rotation ? a.rotation : slerp(a.rotation, b.rotation, s), mix3(a.scale, b.scale),
                  mix3(a.skew, b.skew), mix(a.half_width, b.half_width), mix(a.half_height, b.half_height),
                  mix(a.aperture, b.aperture), mix(a.focus, b.focus)});
}

CameraRay CameraModel::ray(const Vec2f& pixel, const Vec2f& lens, double t) const {
  return with_pose(t, [&](const Pose& p) {
    const Affine3d& m = p.world_from_camera;
    // Local +x is to the left of the picture, +y up.
    const double x = (1 - 2 * (pixel.x / size_.x - offset_.x)) * p.half_width;
    const double y = (1 - 2 * (pixel.y / size_.y - offset_.y)) * p.half_height;
    CameraRay r;
    r.axis = Vec3f(m.z);
    if (!perspective_ && !(p.aperture > 0)) {
      r.o = Vec3f(m.translation + m.x * x + m.y * y);
      r.d = Vec3f(m.z);
      r.tmin = float(near_), r.tmax = float(far_);
      return r;
    }
    // To the plane at distance 1 from the lens.
    Vec3d d = perspective_ ? m.vector({x, y, 1}) : m.z;
    Vec3d o = perspective_ ? m.translation : m.translation + m.x * x + m.y * y;
    if (p.aperture > 0) {
      const Vec2f disk = square_to_disk(lens);
      const Vec3d offset = p.lens_x * (disk.x * p.aperture) + p.lens_y * (disk.y * p.aperture);
      o += offset;
      d = d - offset / p.focus;  // through the point in focus
    }
    const double per_metre = length(d);  // ray length per metre of depth
    r.o = Vec3f(o);
    r.d = Vec3f(d * (1 / per_metre));
    r.tmin = float(near_ * per_metre), r.tmax = float(far_ * per_metre);
    return r;
  });
}

CameraModel::Sight CameraModel::sight(const Vec2d& pixel, double t) const {
  return with_pose(t, [&](const Pose& p) -> Sight {
    const Affine3d& m = p.world_from_camera;
    const double x = (1 - 2 * (pixel.x / size_.x - offset_.x)) * p.half_width;
    const double y = (1 - 2 * (pixel.y / size_.y - offset_.y)) * p.half_height;
    if (!perspective_) return {m.translation + m.x * x + m.y * y, m.z, near_, far_};
    const Vec3d d = m.vector({x, y, 1});
    const double per_metre = length(d);
    return {m.translation, d * (1 / per_metre), near_ * per_metre, far_ * per_metre};
  });
}

std::optional<Vec2d> CameraModel::to_pixel(double x, double y) const {
  const double reach = kReach * std::max(size_.x, size_.y);
  if (!(std::abs(0.5 * x * size_.x) <= reach && std::abs(0.5 * y * size_.y) <= reach)) return std::nullopt;
  return Vec2d{size_.x * (0.5 - 0.5 * x + offset_.x), size_.y * (0.5 - 0.5 * y + offset_.y)};
}

std::optional<CameraModel::Projected> CameraModel::project(const Vec3f& point, double t) const {
  const auto p = project_double(Vec3d(point), t);
  if (!p) return std::nullopt;
  return Projected{{float(p->x), float(p->y)}, float(p->z)};
}

std::optional<Vec3d> CameraModel::project_double(const Vec3d& point, double t) const {
  return with_pose(t, [&](const Pose& p) -> std::optional<Vec3d> {
    const Affine3d& m = p.world_from_camera;
    const Vec3d local = inverse(Affine3d{m.x, m.y, m.z}).vector(point - m.translation);
    if (perspective_ && !(local.z > 0)) return std::nullopt;
    const double scale = perspective_ ? 1 / local.z : 1;
    const auto pixel = to_pixel(local.x * scale / p.half_width, local.y * scale / p.half_height);
    if (!pixel) return std::nullopt;
    return Vec3d{pixel->x, pixel->y, local.z};
  });
}

std::optional<Importance> CameraModel::importance(const Vec3f& point, const Vec2f& lens, double t) const {
  return with_pose(t, [&](const Pose& p) -> std::optional<Importance> {
    const Affine3d& m = p.world_from_camera;
    const Affine3d camera_from_world = inverse(Affine3d{m.x, m.y, m.z});
    const Vec3d local = camera_from_world.vector(Vec3d(point) - m.translation);
    const double z = local.z;
    if (!(z > near_ && z < far_)) return std::nullopt;
    Vec3d offset;
    if (p.aperture > 0) {
      const Vec2f disk = square_to_disk(lens);
      offset = p.lens_x * (disk.x * p.aperture) + p.lens_y * (disk.y * p.aperture);
    }
    // Back through the point in focus, as in ray().
    const Vec3d shift = camera_from_world.vector(offset) * (perspective_ ? 1 / p.focus - 1 / z : z / p.focus - 1);
    const double scale = perspective_ ? 1 / z : 1;
    const double x = local.x * scale + shift.x, y = local.y * scale + shift.y;
    const auto pixel = to_pixel(x / p.half_width, y / p.half_height);
    if (!pixel) return std::nullopt;
    const Vec3d o = m.translation + offset + (perspective_ ? Vec3d{} : m.x * x + m.y * y);
    const Vec3d d = (perspective_ ? m.vector({x, y, 1}) : m.z) - offset / p.focus;
    const double per_metre = length(d);
    Importance r;
    r.pixel = Vec2f(*pixel);
    r.distance = float(z * per_metre);
    r.ray = {Vec3f(o), Vec3f(d * (1 / per_metre)), float(near_ * per_metre), float(far_ * per_metre)};
    // A pixel's part of the plane through the point, seen from the lens.
    const double plane = std::abs(dot(cross(m.x, m.y), d)) / per_metre * (perspective_ ? z * z : 1);
    r.we = float(size_.x * size_.y / (4 * p.half_width * p.half_height * plane));
    return r;
  });
}

std::optional<Vec2f> CameraModel::project_direction(const Vec3f& d, double t) const {
  if (!perspective_) return std::nullopt;
  return with_pose(t, [&](const Pose& p) -> std::optional<Vec2f> {
    const Affine3d& m = p.world_from_camera;
    const Vec3d local = inverse(Affine3d{m.x, m.y, m.z}).vector(Vec3d(d));
    if (!(local.z > 0)) return std::nullopt;
    const auto pixel = to_pixel(local.x / local.z / p.half_width, local.y / local.z / p.half_height);
    if (!pixel) return std::nullopt;
    return Vec2f(*pixel);
  });
}

Vec3f CameraModel::axis(double t) const {
  return with_pose(t, [](const Pose& p) { return Vec3f(p.world_from_camera.z); });
}

Vec3f CameraModel::position(double t) const {
  return with_pose(t, [](const Pose& p) { return Vec3f(p.world_from_camera.translation); });
}

}  // namespace tempera
