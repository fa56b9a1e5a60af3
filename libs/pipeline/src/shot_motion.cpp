// SPDX-License-Identifier: Apache-2.0
#include "shot_motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "tempera/accel/motion_error.h"
#include "tempera/core/log.h"
#include "tempera/paths/camera_model.h"
#include "tempera/scene/default_view.h"

namespace tempera {

namespace {

constexpr double kFewPixels = 0.25, kManyPixels = 0.5;
constexpr int kLeastSegments = 4, kMostSegments = 1024;
/// Frames and objects that are looked at together, at most: of more frames, every n-th is.
constexpr double kMostMeasured = 500'000;

/// A cut, as keys see it (seconds).
struct Cut {
  double time = 0, frame_duration = 0;
};

/// The key from which a track flies over a cut in no more than a frame.
template <class T>
std::optional<std::size_t> flight(const Animated<T>& track, const Cut& cut) {
  if (track.interpolation() == Interpolation::kStep) return std::nullopt;
  const auto& times = track.times();
  for (std::size_t i = 0; i + 1 < times.size(); ++i) {
    const double rounding = 1e-3 * cut.frame_duration;
    if (times[i] < cut.time - rounding && times[i + 1] >= cut.time - rounding) {
      const double length = times[i + 1] - times[i];
      if (length > key_tolerance(times[i + 1]) && length <= cut.frame_duration * 1.01) return i;
    }
  }
  return std::nullopt;
}

/// Two keys at the time of the cut in place of the flight from key i on.
template <class T>
Animated<T> without_flight(const Animated<T>& track, std::size_t i, const Cut& cut) {
  const bool cubic = track.interpolation() == Interpolation::kCubic;
  const std::size_t per_key = cubic ? 3 : 1;
  std::vector<double> times = track.times();
  std::vector<T> values = track.values();
  const double after = times[i + 1] <= cut.time + 1e-3 * cut.frame_duration ? times[i + 1] : cut.time;
  // How the value moved before it flew: the segment before, or none.
  const bool moved = i > 0 && times[i] - times[i - 1] > key_tolerance(times[i]);
  T before = track.value(i);
  if (moved) {
    const Animated<T> earlier({times[i - 1], times[i]},
                              std::vector<T>(values.begin() + std::ptrdiff_t((i - 1) * per_key),
                                             values.begin() + std::ptrdiff_t((i + 1) * per_key)),
                              track.interpolation());
    const double h = (cubic ? 0.05 : 1) * (times[i] - times[i - 1]);
    before = detail::mix(earlier.at(times[i] - h), earlier.at(times[i]), 1 + (after - times[i]) / h);
  }
  // A straight line to `before`, whatever the interpolation.
  std::vector<T> inserted(per_key, before);
  if (cubic) {
    const T rate = T((before - track.value(i)) * (1 / (after - times[i])));
    values[3 * i + 2] = inserted[0] = inserted[2] = rate;
  }
  std::vector<double> new_times{after};
  if (times[i + 1] > after) {  // the pose after it stands still until its first key
    new_times.push_back(after);
    std::vector<T> still(per_key, track.value(i + 1));
    if (cubic) still[0] = still[2] = T(still[0] * 0);
    inserted.insert(inserted.end(), still.begin(), still.end());
    if (cubic) values[3 * (i + 1)] = still[0];
  }
  times.insert(times.begin() + std::ptrdiff_t(i + 1), new_times.begin(), new_times.end());
  values.insert(values.begin() + std::ptrdiff_t((i + 1) * per_key), inserted.begin(), inserted.end());
  return Animated<T>(std::move(times), std::move(values), track.interpolation());
}

/// How far apart two poses of a frame of reference are.
struct Change {
  double distance = 0, angle = 0;
  bool exceeds(const Change& other, double factor) const {
    return distance > factor * other.distance || angle > factor * other.angle;
  }
};
Change change(const Affine3d& a, const Affine3d& b) {
  const auto turn = [](const Vec3d& u, const Vec3d& v) {
    return std::acos(std::clamp(dot(normalize(u), normalize(v)), -1.0, 1.0));
  };
  return {length(b.translation - a.translation), std::max(turn(a.z, b.z), turn(a.y, b.y))};
}

/// Whether a transform moves over the cut by much more than before and after it.
bool jumps_at(const AnimatedTransform& t, const Cut& cut) {
  constexpr double kFarther = 8;
  const double d = cut.frame_duration;
  const Change over = change(t.at(cut.time - d), t.at(cut.time));
  const Change before = change(t.at(cut.time - 2 * d), t.at(cut.time - d));
  const Change after = change(t.at(cut.time), t.at(cut.time + d));
  const Change usual{std::max(before.distance, after.distance) + 1e-6, std::max(before.angle, after.angle) + 1e-4};
  return over.exceeds(usual, kFarther);
}

}  // namespace

void cut_motion(Scene& scene, const FrameClock& clock, const std::vector<int>& declared) {
  std::set<int> seen_from;  // nodes of cameras and what they hang on
  for (const Camera& camera : scene.cameras) {
    for (int n = camera.node; n >= 0; n = scene.nodes[n].parent) seen_from.insert(n);
  }
  for (const int frame : declared) {
    const Cut cut{clock.time(frame), clock.frame_duration()};
    const auto end_flight = [&](auto& track) {
      if (const auto i = flight(track, cut)) track = without_flight(track, *i, cut);
    };
    for (int n = 0; n < std::ssize(scene.nodes); ++n) {
      AnimatedTransform& t = scene.nodes[n].local;
      if (!t.keyed || (!seen_from.contains(n) && !jumps_at(t, cut))) continue;
      end_flight(t.translation);
      end_flight(t.rotation);
      end_flight(t.scale);
    }
    for (Camera& camera : scene.cameras) {
      end_flight(camera.fov_x);
      end_flight(camera.width);
      end_flight(camera.aperture_radius);
      end_flight(camera.f_stop);
      end_flight(camera.focus_distance);
    }
  }
}

std::vector<int> find_cuts(const Scene& scene, const RenderSettings& settings, const std::vector<int>& declared) {
  std::set<int> cuts(declared.begin(), declared.end());
  const Camera& camera = scene.cameras[settings.camera];
  const FrameClock& clock = settings.clock;
  const auto frame_at = [&](double t) { return clock.first + (t - clock.start) * clock.fps; };
  const double first = frame_at(scene.animation.begin), last = frame_at(scene.animation.end);
  constexpr double kMostFrames = 1e6;
  if (!scene.moves(camera.node, scene.animation) || !(last - first < kMostFrames) || !(std::abs(first) < 1e9)) {
    return {cuts.begin(), cuts.end()};
  }
  // How far the camera goes from each frame to the next.
  const int begin = int(std::floor(first)) - 3, end = int(std::ceil(last)) + 3;
  std::vector<Change> steps;
  Affine3d pose = scene.world(camera.node, clock.time(begin));
  for (int f = begin; f < end; ++f) {
    const Affine3d next = scene.world(camera.node, clock.time(f + 1));
    steps.push_back(change(pose, next));
    pose = next;
  }
  const double size = std::max(double(world_bounds(scene, scene.animation.begin).radius()), 1e-6);
  const Change noticeable{0.01 * size, 0.05};
  const auto stands_out = [&](int f, int around) {  // the step from f to f + 1
    const Change& step = steps[f - begin];
    if (!step.exceeds(noticeable, 1)) return false;
    Change usual;
    for (int g = std::max(begin, f - around); g <= std::min(end - 1, f + around); ++g) {
      if (g == f) continue;
      usual = {std::max(usual.distance, steps[g - begin].distance), std::max(usual.angle, steps[g - begin].angle)};
    }
    constexpr double kFarther = 8;
    return (step.distance > noticeable.distance && step.distance > kFarther * usual.distance) ||
           (step.angle > noticeable.angle && step.angle > kFarther * usual.angle);
  };
  // A camera that jumps again and again, as one that is animated in steps, shows one scene: its jumps are no cuts.
  constexpr int kAround = 3;
  std::vector<double> jumps;
  camera_jumps(scene, camera, {clock.time(begin), clock.time(end)}, jumps);
  std::set<int> jumping;
  for (const double t : jumps) jumping.insert(int(std::ceil(frame_at(t) - 1e-3)));
  std::vector<int> flights;
  for (int f = begin; f < end; ++f) {
    const int to = f + 1;
    if (jumping.contains(to)) {
      if (stands_out(f, kAround)) cuts.insert(to);
    } else if (!cuts.contains(to) && stands_out(f, kAround)) {
      flights.push_back(to);
    }
  }
  if (!flights.empty()) {
    log_warning(
        fmt::format("the camera \"{}\" flies from one view to another within a frame; if these are cuts, write "
                    "cuts = [{}] into the shot",
                    camera.name, fmt::join(flights, ", ")));
  }
  return {cuts.begin(), cuts.end()};
}

namespace {

/// Exposures of the frames in which anything is animated.
std::vector<TimeSpan> animated_exposures(const Scene& scene, const FrameClock& clock) {
  TimeSpan span = scene.animation;
  for (const Shape& shape : scene.shapes) {
    const auto* mesh = std::get_if<Mesh>(&shape.geometry);
    if (!mesh || !mesh->cache.samples) continue;
    const std::vector<double>& times = mesh->cache.samples->times();
    span = {std::min(span.begin, times.front()), std::max(span.end, times.back())};
  }
  std::vector<TimeSpan> exposures;
  if (!(span.length() > 0)) return exposures;
  const auto frame_at = [&](double t) { return clock.first + (t - clock.start) * clock.fps; };
  const double first = std::floor(frame_at(span.begin)) - 1, last = std::ceil(frame_at(span.end)) + 1;
  if (!(std::abs(first) < 1e9) || !(std::abs(last) < 1e9)) return exposures;
  const double stride = std::max(
      1.0, std::ceil((last - first) * double(std::max<std::size_t>(scene.instances.size(), 1)) / kMostMeasured));
  for (double f = first; f <= last; f += stride) {
    const TimeSpan e = clock.exposure(int(f));
    if (e.end > span.begin && e.begin < span.end) exposures.push_back(e);
  }
  return exposures;
}

/// How far the picture itself is misplaced because the camera's motion is resampled.
double camera_error(const Scene& scene, const RenderSettings& s, TimeSpan exposure, double step, double distance) {
  constexpr int kFiner = 16;
  const CameraModel ours(scene, s.camera, s.width, s.height, exposure, step);
  const CameraModel finer(scene, s.camera, s.width, s.height, exposure, step / kFiner);
  double error = 0;
  for (double t = exposure.begin + 0.31 * step; t < exposure.end; t += step / 3) {
    for (const Vec2f at : {Vec2f{0.5f, 0.5f}, Vec2f{0.05f, 0.05f}, Vec2f{0.95f, 0.9f}}) {
      const Vec2f pixel{at.x * float(s.width), at.y * float(s.height)};
      const CameraRay ray = ours.ray(pixel, {0.5f, 0.5f}, t);
      if (const auto seen = finer.project(ray.o + ray.d * float(distance), t)) {
        error = std::max(error, double(length(seen->pixel - pixel)));
      }
    }
  }
  return error;
}

/// The largest error over some exposures, in pixels, and each one's.
struct Measured {
  double worst = 0;
  std::vector<double> each;
};
Measured measure(const Scene& scene, const RenderSettings& s, const std::vector<TimeSpan>& exposures, double step) {
  Measured m;
  const double size = std::max(double(world_bounds(scene, scene.animation.begin).radius()), 1e-6);
  TimeSpan all{exposures.front().begin, exposures.back().end};
  const CameraModel camera(scene, s.camera, s.width, s.height, all, step);
  const auto pixels = [&](const Vec3f& authored, const Vec3f& resampled, double t) {
    const auto a = camera.project(authored, t), b = camera.project(resampled, t);
    if (!a || !b) return 0.0;
    // What is far outside of the picture is seen in mirrors at most.
    const auto outside = [](float x, int n) { return x < -0.5f * float(n) || x > 1.5f * float(n); };
    if (outside(a->pixel.x, s.width) || outside(a->pixel.y, s.height)) return 0.0;
    return double(length(a->pixel - b->pixel));
  };
  m.each = motion_errors(scene, exposures, step, pixels);
  for (std::size_t i = 0; i < exposures.size(); ++i) {
    if (exposures[i].length() > 0) m.each[i] = std::max(m.each[i], camera_error(scene, s, exposures[i], step, size));
    m.worst = std::max(m.worst, m.each[i]);
  }
  return m;
}

}  // namespace

int settle_motion_segments(const Scene& scene, const RenderSettings& s, std::optional<int> wanted) {
  const double frame = s.clock.frame_duration();
  std::vector<TimeSpan> exposures;
  for (const TimeSpan e : animated_exposures(scene, s.clock)) {
    if (e.length() > 0) exposures.push_back(e);
  }
  int segments = wanted.value_or(kLeastSegments);
  double worst = 0;
  TimeSpan where;
  while (!exposures.empty()) {
    Measured m;
    try {
      m = measure(scene, s, exposures, frame / segments);
    } catch (const Error&) {
      return segments;  // a camera that cannot be used is reported where it is
    }
    worst = m.worst;
    const auto at = std::max_element(m.each.begin(), m.each.end()) - m.each.begin();
    where = exposures[at];
    if (wanted || worst <= kFewPixels || segments == kMostSegments) break;
    // What is right already does not become wrong with finer steps.
    std::vector<TimeSpan> left;
    for (std::size_t i = 0; i < exposures.size(); ++i) {
      if (m.each[i] > kFewPixels) left.push_back(exposures[i]);
    }
    exposures = std::move(left);
    segments *= 2;
  }
  if (worst > kManyPixels) {
    log_warning(fmt::format("motion between {} segments of a frame is misplaced by up to {:.2g} pixels (at {:.4g} s){}",
                            segments, worst, where.begin, wanted ? "; see motion_segments" : ""));
  }
  return segments;
}

}  // namespace tempera
