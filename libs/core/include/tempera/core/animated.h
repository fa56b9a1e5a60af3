// SPDX-License-Identifier: Apache-2.0
#pragma once
// Values over time as authored: keys with step, linear or cubic interpolation. Clamped outside the keys, as glTF and
// Mitsuba do. Times are seconds on the shot's axis. A value jumps at a step key, and where two keys stand at one time.
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/core/vec.h"

namespace tempera {

enum class Interpolation { kStep, kLinear, kCubic };

/// How far before its key a jump takes effect (seconds): files hold key times as float32, so the key of a frame may
/// stand a little after the frame's own time.
inline double key_tolerance(double key_time) { return 2e-6 + 4e-7 * std::abs(key_time); }

namespace detail {
template <class T>
T mix(const T& a, const T& b, double s) {
  return a * float(1 - s) + b * float(s);
}
inline double mix(double a, double b, double s) { return a * (1 - s) + b * s; }
inline Vec3d mix(const Vec3d& a, const Vec3d& b, double s) { return a * (1 - s) + b * s; }
inline Quatd mix(const Quatd& a, const Quatd& b, double s) { return slerp(a, b, s); }
inline std::vector<float> mix(const std::vector<float>& a, const std::vector<float>& b, double s) {
  std::vector<float> r(a.size());
  for (std::size_t i = 0; i < r.size(); ++i) r[i] = float(a[i] * (1 - s) + b[i] * s);
  return r;
}
template <class T>
T hermite(const T& p0, const T& m0, const T& p1, const T& m1, double s) {
  const double s2 = s * s, s3 = s2 * s;
  const double a = 2 * s3 - 3 * s2 + 1, b = s3 - 2 * s2 + s, c = -2 * s3 + 3 * s2, d = s3 - s2;
  using F = std::conditional_t<std::is_same_v<T, Rgb>, float, double>;
  return T(p0 * F(a) + m0 * F(b) + p1 * F(c) + m1 * F(d));
}
inline Vec3f hermite(const Vec3f& p0, const Vec3f& m0, const Vec3f& p1, const Vec3f& m1, double s) {
  return Vec3f(hermite(Vec3d(p0), Vec3d(m0), Vec3d(p1), Vec3d(m1), s));
}
inline Quatd hermite(const Quatd& p0, const Quatd& m0, const Quatd& p1, const Quatd& m1, double s) {
  const double s2 = s * s, s3 = s2 * s;
  return normalize(p0 * (2 * s3 - 3 * s2 + 1) + m0 * (s3 - 2 * s2 + s) + p1 * (-2 * s3 + 3 * s2) + m1 * (s3 - s2));
}
inline std::vector<float> hermite(const std::vector<float>& p0, const std::vector<float>& m0,
                                  const std::vector<float>& p1, const std::vector<float>& m1, double s) {
  std::vector<float> r(p0.size());
  for (std::size_t i = 0; i < r.size(); ++i) r[i] = hermite(p0[i], m0[i], p1[i], m1[i], s);
  return r;
}
}  // namespace detail

/// A value of type T over time. T is float, double, Vec3f/d, Rgb, Quatd or vector<float> (all of one length).
template <class T>
class Animated {
 public:
  Animated() = default;
  Animated(T constant) : values_{std::move(constant)} {}  // NOLINT: a constant is an animation
  /// Keys at increasing `times`; of two at one time, the first ends what comes before and the second begins what comes
  /// after. kCubic takes three values a key (in-tangent, value, out-tangent; tangents are per second), as glTF's
  /// CUBICSPLINE does; the others one. Pre: times nonempty, sizes match.
  Animated(std::vector<double> times, std::vector<T> values, Interpolation interpolation)
      : times_(std::move(times)), values_(std::move(values)), interpolation_(interpolation) {
    for (std::size_t i = 1; i < times_.size(); ++i) jumps_ |= jumps_at(i);
  }

  /// Value at time `t` (seconds), clamped to the first and last key.
  T at(double t) const { return at(t, t); }
  /// The same as if the piece between jumps that holds the time `piece` went on for ever: how a value moves up to a
  /// jump or from it on, whatever comes beyond.
  T at(double t, double piece) const {
    if (times_.size() <= 1) return values_.empty() ? T{} : value(0);
    if (interpolation_ == Interpolation::kStep) return value(last_key(piece));
    if (!jumps_) return between(t, 0, times_.size() - 1);
    std::size_t first = last_key(piece), last = first;
    while (first > 0 && !jumps_at(first)) --first;
    while (last + 1 < times_.size() && !jumps_at(last + 1)) ++last;
    return between(t, first, last);
  }
  /// Appends the times at which the value jumps within the open `span` (seconds).
  void jumps(TimeSpan span, std::vector<double>& out) const {
    if (!jumps_) return;
    for (std::size_t i = 1; i < times_.size(); ++i) {
      const double t = times_[i] - key_tolerance(times_[i]);
      if (t > span.begin && t < span.end && jumps_at(i) && !(value(i) == value(i - 1))) out.push_back(t);
    }
  }

  bool is_constant() const { return times_.size() <= 1; }
  /// Whether the value can change within `span`: keys exist on both sides of some instant in it.
  bool varies_over(TimeSpan span) const {
    return times_.size() > 1 && span.end > times_.front() && span.begin < times_.back();
  }
  /// Whether it jumps anywhere.
  bool has_jumps() const { return jumps_; }
  const std::vector<double>& times() const { return times_; }
  const std::vector<T>& values() const { return values_; }
  Interpolation interpolation() const { return interpolation_; }
  /// Value of key i (the middle one of a cubic key's three).
  const T& value(std::size_t i) const {
    return values_[interpolation_ == Interpolation::kCubic && !times_.empty() ? 3 * i + 1 : i];
  }

 private:
  /// Whether key i ends the piece that key i - 1 belongs to.
  bool jumps_at(std::size_t i) const {
    return interpolation_ == Interpolation::kStep || times_[i] - times_[i - 1] <= key_tolerance(times_[i]);
  }
  /// The last key that has taken effect at time t; the first one before that.
  std::size_t last_key(double t) const {
    const auto taken = [](double at, double key) { return at < key - key_tolerance(key); };
    const auto after = std::upper_bound(times_.begin(), times_.end(), t, taken);
    return after == times_.begin() ? 0 : after - times_.begin() - 1;
  }
  /// Value of the piece of keys [first, last], which goes on beyond them where other keys follow.
  T between(double t, std::size_t first, std::size_t last) const {
    if (first == last || (t <= times_[first] && first == 0)) return value(first);
    if (t >= times_[last] && last + 1 == times_.size()) return value(last);
    const auto begin = times_.begin() + std::ptrdiff_t(first), end = times_.begin() + std::ptrdiff_t(last);
    const auto after = std::upper_bound(begin + 1, end, t);
    const std::size_t i = after - times_.begin() - 1;
    const double dt = times_[i + 1] - times_[i], s = (t - times_[i]) / dt;
    if (interpolation_ != Interpolation::kCubic) return detail::mix(value(i), value(i + 1), s);
    return detail::hermite(value(i), scaled(values_[3 * i + 2], dt), value(i + 1), scaled(values_[3 * i + 3], dt), s);
  }
  static T scaled(const T& m, double dt) {
    if constexpr (requires { m.size(); }) {
      T r = m;
      for (auto& x : r) x = decltype(+x)(x * dt);
      return r;
    } else if constexpr (
        requires { m * 1.0; } && !requires { m.r; } && !std::is_same_v<T, Vec3f>) {
      return T(m * dt);
    } else {
      return m * float(dt);
    }
  }
  std::vector<double> times_;
  std::vector<T> values_;
  Interpolation interpolation_ = Interpolation::kLinear;
  bool jumps_ = false;
};

/// The product of two values over time, with the jumps of both. Where both vary between keys it is sampled at 16 places
/// a segment and linear between them. Pre: A * B is defined.
template <class A, class B>
auto product(const Animated<A>& a, const Animated<B>& b) {
  using T = decltype(a.at(0) * b.at(0));
  const auto scaled = [](const auto& moving, const auto& times_constant) {
    std::vector<T> values;
    for (const auto& v : moving.values()) values.push_back(times_constant(v));
    return Animated<T>(moving.times(), std::move(values), moving.interpolation());
  };
  if (a.is_constant() && b.is_constant()) return Animated<T>(a.at(0) * b.at(0));
  if (b.is_constant()) return scaled(a, [&](const A& v) { return v * b.at(0); });
  if (a.is_constant()) return scaled(b, [&](const B& v) { return a.at(0) * v; });

  std::vector<double> keys = a.times(), times;
  keys.insert(keys.end(), b.times().begin(), b.times().end());
  std::sort(keys.begin(), keys.end());
  const auto same = [](double s, double t) { return t - s <= key_tolerance(t); };
  keys.erase(std::unique(keys.begin(), keys.end(), same), keys.end());
  const bool steps = a.interpolation() == Interpolation::kStep && b.interpolation() == Interpolation::kStep;
  std::vector<T> values;
  const auto add = [&](double t, double piece) {
    times.push_back(t);
    values.push_back(a.at(t, piece) * b.at(t, piece));
  };
  constexpr int kParts = 16;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    const double t = keys[i], before = t - 2 * key_tolerance(t);
    if (!steps && (!(a.at(t) == a.at(t, before)) || !(b.at(t) == b.at(t, before)))) add(t, before);
    add(t, t);
    if (steps || i + 1 == keys.size()) continue;
    for (int k = 1; k < kParts; ++k) add(t + (keys[i + 1] - t) * k / kParts, t);
  }
  return Animated<T>(std::move(times), std::move(values), steps ? Interpolation::kStep : Interpolation::kLinear);
}

/// Translation, rotation and scale over time, or a constant affine map (for what TRS cannot say, e.g. shear).
struct AnimatedTransform {
  Affine3d matrix;  ///< used when `keyed` is false
  bool keyed = false;
  Animated<Vec3d> translation{Vec3d{0, 0, 0}};
  Animated<Quatd> rotation{Quatd{}};
  Animated<Vec3d> scale{Vec3d{1, 1, 1}};

  AnimatedTransform() = default;
  AnimatedTransform(const Affine3d& m) : matrix(m) {}  // NOLINT: a constant is an animation
  Affine3d at(double t) const { return at(t, t); }
  /// As Animated::at.
  Affine3d at(double t, double piece) const {
    if (!keyed) return matrix;
    Affine3d m = tempera::rotation(normalize(rotation.at(t, piece)));
    const Vec3d s = scale.at(t, piece);
    m.x *= s.x, m.y *= s.y, m.z *= s.z;
    m.translation = translation.at(t, piece);
    return m;
  }
  void jumps(TimeSpan span, std::vector<double>& out) const {
    if (!keyed) return;
    translation.jumps(span, out);
    rotation.jumps(span, out);
    scale.jumps(span, out);
  }
  bool is_constant() const {
    return !keyed || (translation.is_constant() && rotation.is_constant() && scale.is_constant());
  }
  bool varies_over(TimeSpan span) const {
    return keyed && (translation.varies_over(span) || rotation.varies_over(span) || scale.varies_over(span));
  }
};

}  // namespace tempera
