// SPDX-License-Identifier: Apache-2.0
#pragma once
// Small vectors, colors, rotations, affine maps and boxes: zero-initialised values with the usual arithmetic.
// Column convention: an affine map takes a point p to `linear * p + translation`. Not a general linear algebra library
// (Eigen serves where one is needed); these exist so that no third-party type shows in a public header.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

// The compiler's estimate of what inlining costs keeps these few instructions out of the large functions that use them
// most.
#if defined(__GNUC__)
#define TEMPERA_INLINE [[gnu::always_inline]] inline
#else
#define TEMPERA_INLINE inline
#endif

namespace tempera {

inline constexpr float kPi = 3.14159265358979323846f;
inline constexpr float kInvPi = 0.31830988618379067154f;
inline constexpr double kPiD = 3.14159265358979323846;
inline constexpr float kInfinity = std::numeric_limits<float>::infinity();

template <class T>
struct Vec2 {
  T x = 0, y = 0;
  constexpr Vec2() = default;
  constexpr Vec2(T x_, T y_) : x(x_), y(y_) {}
  template <class U>
  explicit constexpr Vec2(const Vec2<U>& v) : x(T(v.x)), y(T(v.y)) {}
  constexpr Vec2 operator+(Vec2 b) const { return {x + b.x, y + b.y}; }
  constexpr Vec2 operator-(Vec2 b) const { return {x - b.x, y - b.y}; }
  constexpr Vec2 operator-() const { return {-x, -y}; }
  constexpr Vec2 operator*(T s) const { return {x * s, y * s}; }
  constexpr Vec2 operator/(T s) const { return {x / s, y / s}; }
  constexpr Vec2& operator+=(Vec2 b) { return *this = *this + b; }
  constexpr Vec2& operator-=(Vec2 b) { return *this = *this - b; }
  constexpr Vec2& operator*=(T s) { return *this = *this * s; }
  constexpr bool operator==(const Vec2&) const = default;
  constexpr T& operator[](int i) { return i == 0 ? x : y; }
  constexpr T operator[](int i) const { return i == 0 ? x : y; }
};

template <class T>
struct Vec3 {
  T x = 0, y = 0, z = 0;
  constexpr Vec3() = default;
  constexpr Vec3(T x_, T y_, T z_) : x(x_), y(y_), z(z_) {}
  template <class U>
  explicit constexpr Vec3(const Vec3<U>& v) : x(T(v.x)), y(T(v.y)), z(T(v.z)) {}
  constexpr Vec3 operator+(const Vec3& b) const { return {x + b.x, y + b.y, z + b.z}; }
  constexpr Vec3 operator-(const Vec3& b) const { return {x - b.x, y - b.y, z - b.z}; }
  constexpr Vec3 operator-() const { return {-x, -y, -z}; }
  constexpr Vec3 operator*(T s) const { return {x * s, y * s, z * s}; }
  constexpr Vec3 operator*(const Vec3& b) const { return {x * b.x, y * b.y, z * b.z}; }
  constexpr Vec3 operator/(T s) const { return {x / s, y / s, z / s}; }
  constexpr Vec3& operator+=(const Vec3& b) { return *this = *this + b; }
  constexpr Vec3& operator-=(const Vec3& b) { return *this = *this - b; }
  constexpr Vec3& operator*=(T s) { return *this = *this * s; }
  constexpr bool operator==(const Vec3&) const = default;
  constexpr T& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
  constexpr T operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
};

template <class T>
constexpr Vec2<T> operator*(T s, Vec2<T> v) {
  return v * s;
}
template <class T>
constexpr Vec3<T> operator*(T s, const Vec3<T>& v) {
  return v * s;
}

using Vec2f = Vec2<float>;
using Vec2d = Vec2<double>;
using Vec2i = Vec2<int>;
using Vec3f = Vec3<float>;
using Vec3d = Vec3<double>;

template <class T>
constexpr T dot(const Vec2<T>& a, const Vec2<T>& b) {
  return a.x * b.x + a.y * b.y;
}
template <class T>
constexpr T dot(const Vec3<T>& a, const Vec3<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
constexpr Vec3<T> cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class V>
auto length_squared(const V& v) {
  return dot(v, v);
}
template <class V>
auto length(const V& v) {
  return std::sqrt(dot(v, v));
}
/// Unit vector along `v`; a zero vector stays zero.
template <class T>
TEMPERA_INLINE Vec3<T> normalize(const Vec3<T>& v) {
  const T l = length(v);
  return l > 0 ? v * (T(1) / l) : v;
}
template <class T>
bool is_finite(const Vec3<T>& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}
template <class T>
constexpr T lerp(const T& a, const T& b, float s) {
  return a * (1 - s) + b * s;
}
template <class T>
constexpr T sqr(T x) {
  return x * x;
}

/// Linear RGB with Rec. 709 primaries: radiance, reflectance or weights.
struct Rgb {
  float r = 0, g = 0, b = 0;
  constexpr Rgb() = default;
  constexpr Rgb(float r_, float g_, float b_) : r(r_), g(g_), b(b_) {}
  explicit constexpr Rgb(float v) : r(v), g(v), b(v) {}
  constexpr Rgb operator+(const Rgb& o) const { return {r + o.r, g + o.g, b + o.b}; }
  constexpr Rgb operator-(const Rgb& o) const { return {r - o.r, g - o.g, b - o.b}; }
  constexpr Rgb operator*(const Rgb& o) const { return {r * o.r, g * o.g, b * o.b}; }
  constexpr Rgb operator/(const Rgb& o) const { return {r / o.r, g / o.g, b / o.b}; }
  constexpr Rgb operator*(float s) const { return {r * s, g * s, b * s}; }
  constexpr Rgb operator/(float s) const { return *this * (1.0f / s); }
  constexpr Rgb& operator+=(const Rgb& o) { return *this = *this + o; }
  constexpr Rgb& operator-=(const Rgb& o) { return *this = *this - o; }
  constexpr Rgb& operator*=(const Rgb& o) { return *this = *this * o; }
  constexpr Rgb& operator*=(float s) { return *this = *this * s; }
  constexpr bool operator==(const Rgb&) const = default;
  constexpr float& operator[](int i) { return i == 0 ? r : i == 1 ? g : b; }
  constexpr float operator[](int i) const { return i == 0 ? r : i == 1 ? g : b; }
};
constexpr Rgb operator*(float s, const Rgb& c) { return c * s; }
constexpr bool is_black(const Rgb& c) { return c.r == 0 && c.g == 0 && c.b == 0; }
inline bool is_finite(const Rgb& c) { return std::isfinite(c.r) && std::isfinite(c.g) && std::isfinite(c.b); }
constexpr float max_component(const Rgb& c) { return std::max(c.r, std::max(c.g, c.b)); }
constexpr float mean(const Rgb& c) { return (c.r + c.g + c.b) * (1.0f / 3.0f); }
/// Rec. 709 relative luminance.
constexpr float luminance(const Rgb& c) { return 0.212671f * c.r + 0.715160f * c.g + 0.072169f * c.b; }
inline Rgb clamp(const Rgb& c, float lo, float hi) {
  return {std::clamp(c.r, lo, hi), std::clamp(c.g, lo, hi), std::clamp(c.b, lo, hi)};
}
inline Rgb sqrt(const Rgb& c) { return {std::sqrt(c.r), std::sqrt(c.g), std::sqrt(c.b)}; }
inline Rgb exp(const Rgb& c) { return {std::exp(c.r), std::exp(c.g), std::exp(c.b)}; }

/// Unit quaternion w + xi + yj + zk for rotations.
template <class T>
struct Quat {
  T w = 1, x = 0, y = 0, z = 0;
  constexpr Quat operator+(const Quat& b) const { return {w + b.w, x + b.x, y + b.y, z + b.z}; }
  constexpr Quat operator-(const Quat& b) const { return {w - b.w, x - b.x, y - b.y, z - b.z}; }
  constexpr Quat operator-() const { return {-w, -x, -y, -z}; }
  constexpr Quat operator*(T s) const { return {w * s, x * s, y * s, z * s}; }
  constexpr Quat operator*(const Quat& b) const {  // Hamilton product: rotate by b, then by *this
    return {w * b.w - x * b.x - y * b.y - z * b.z, w * b.x + x * b.w + y * b.z - z * b.y,
            w * b.y - x * b.z + y * b.w + z * b.x, w * b.z + x * b.y - y * b.x + z * b.w};
  }
  constexpr bool operator==(const Quat&) const = default;
};
using Quatf = Quat<float>;
using Quatd = Quat<double>;
template <class T>
constexpr T dot(const Quat<T>& a, const Quat<T>& b) {
  return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
}
/// Unit quaternion along `q`; the zero quaternion becomes the identity.
template <class T>
Quat<T> normalize(const Quat<T>& q) {
  const T l = std::sqrt(dot(q, q));
  return l > 0 ? q * (T(1) / l) : Quat<T>{};
}
/// Rotation by `angle` radians about the unit vector `axis`, counterclockwise when it points at the viewer.
template <class T>
Quat<T> axis_angle(const Vec3<T>& axis, T angle) {
  const T s = std::sin(angle / 2);
  return {std::cos(angle / 2), axis.x * s, axis.y * s, axis.z * s};
}
/// Spherical interpolation along the shorter arc between unit quaternions, s in [0,1].
template <class T>
Quat<T> slerp(const Quat<T>& a, Quat<T> b, T s) {
  T c = dot(a, b);
  if (c < 0) b = -b, c = -c;
  if (c > T(0.9995)) return normalize(a * (1 - s) + b * s);
  const T angle = std::acos(std::min(c, T(1)));
  const T inv = T(1) / std::sin(angle);
  return normalize(a * (std::sin((1 - s) * angle) * inv) + b * (std::sin(s * angle) * inv));
}

/// Affine map, column convention: p -> x * p.x + y * p.y + z * p.z + translation.
template <class T>
struct Affine3 {
  Vec3<T> x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};  // images of the axes
  Vec3<T> translation{};
  constexpr Affine3() = default;
  constexpr Affine3(const Vec3<T>& x_, const Vec3<T>& y_, const Vec3<T>& z_, const Vec3<T>& t = {})
      : x(x_), y(y_), z(z_), translation(t) {}
  template <class U>
  explicit constexpr Affine3(const Affine3<U>& a) : x(a.x), y(a.y), z(a.z), translation(a.translation) {}
  constexpr Vec3<T> vector(const Vec3<T>& v) const { return x * v.x + y * v.y + z * v.z; }
  constexpr Vec3<T> point(const Vec3<T>& p) const { return vector(p) + translation; }
  /// Maps a normal by the transpose of the *inverse* of this map, given that inverse. Not normalised.
  constexpr Vec3<T> transposed_vector(const Vec3<T>& n) const { return {dot(x, n), dot(y, n), dot(z, n)}; }
  /// this ∘ b: first b, then this.
  constexpr Affine3 operator*(const Affine3& b) const {
    return {vector(b.x), vector(b.y), vector(b.z), point(b.translation)};
  }
  constexpr T determinant() const { return dot(x, cross(y, z)); }
  constexpr bool operator==(const Affine3&) const = default;
};
using Affine3f = Affine3<float>;
using Affine3d = Affine3<double>;

/// Inverse map; entries are not finite when `a` is singular.
template <class T>
constexpr Affine3<T> inverse(const Affine3<T>& a) {
  const Vec3<T> r0 = cross(a.y, a.z), r1 = cross(a.z, a.x), r2 = cross(a.x, a.y);
  const T s = T(1) / dot(a.x, r0);
  Affine3<T> r{Vec3<T>{r0.x, r1.x, r2.x} * s, Vec3<T>{r0.y, r1.y, r2.y} * s, Vec3<T>{r0.z, r1.z, r2.z} * s};
  r.translation = -r.vector(a.translation);
  return r;
}
/// The cofactor matrix of a map times a vector: the direction of a transformed surface's normal, right for any scale
/// and for singular maps, too; it points to the other side under mirroring.
template <class T>
constexpr Vec3<T> cofactor_vector(const Affine3<T>& m, const Vec3<T>& n) {
  return cross(m.y, m.z) * n.x + cross(m.z, m.x) * n.y + cross(m.x, m.y) * n.z;
}
/// Unit normal of a transformed surface, on the same side of it; zero where the map leaves no surface.
template <class T>
TEMPERA_INLINE Vec3<T> transform_normal(const Affine3<T>& m, const Vec3<T>& n) {
  Vec3<T> r = cofactor_vector(m, n);
  const T largest = std::max({std::abs(r.x), std::abs(r.y), std::abs(r.z)});
  if (!(largest > 0)) return {};
  r = normalize(r * (1 / largest));  // the square of a tiny number is none
  return m.determinant() < 0 ? -r : r;
}
template <class T>
constexpr Affine3<T> translate(const Vec3<T>& t) {
  return {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, t};
}
template <class T>
constexpr Affine3<T> scale(const Vec3<T>& s) {
  return {{s.x, 0, 0}, {0, s.y, 0}, {0, 0, s.z}};
}
template <class T>
constexpr Affine3<T> rotation(const Quat<T>& q) {
  return {{1 - 2 * (q.y * q.y + q.z * q.z), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)},
          {2 * (q.x * q.y - q.w * q.z), 1 - 2 * (q.x * q.x + q.z * q.z), 2 * (q.y * q.z + q.w * q.x)},
          {2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x * q.x + q.y * q.y)}};
}
/// Camera-to-world map that looks from `origin` to `target`: local +z points at the target, +y along `up` (so local +x
/// is to the left of the view: a right-handed frame).
template <class T>
Affine3<T> look_at(const Vec3<T>& origin, const Vec3<T>& target, const Vec3<T>& up) {
  const Vec3<T> z = normalize(target - origin);
  const Vec3<T> x = normalize(cross(up, z));
  return {x, cross(z, x), z, origin};
}
/// Rotation of a pure rotation matrix (orthonormal columns, determinant +1).
template <class T>
Quat<T> quaternion(const Affine3<T>& m) {
  const T t = m.x.x + m.y.y + m.z.z;
  if (t > 0) {
    const T s = std::sqrt(t + 1) * 2;
    return normalize(Quat<T>{s / 4, (m.y.z - m.z.y) / s, (m.z.x - m.x.z) / s, (m.x.y - m.y.x) / s});
  }
  if (m.x.x > m.y.y && m.x.x > m.z.z) {
    const T s = std::sqrt(1 + m.x.x - m.y.y - m.z.z) * 2;
    return normalize(Quat<T>{(m.y.z - m.z.y) / s, s / 4, (m.y.x + m.x.y) / s, (m.z.x + m.x.z) / s});
  }
  if (m.y.y > m.z.z) {
    const T s = std::sqrt(1 + m.y.y - m.x.x - m.z.z) * 2;
    return normalize(Quat<T>{(m.z.x - m.x.z) / s, (m.y.x + m.x.y) / s, s / 4, (m.z.y + m.y.z) / s});
  }
  const T s = std::sqrt(1 + m.z.z - m.x.x - m.y.y) * 2;
  return normalize(Quat<T>{(m.x.y - m.y.x) / s, (m.z.x + m.x.z) / s, (m.z.y + m.y.z) / s, s / 4});
}

/// Axis-aligned box; empty when default constructed.
struct Bounds3f {
  Vec3f lo{kInfinity, kInfinity, kInfinity}, hi{-kInfinity, -kInfinity, -kInfinity};
  void extend(const Vec3f& p) {
    lo = {std::min(lo.x, p.x), std::min(lo.y, p.y), std::min(lo.z, p.z)};
    hi = {std::max(hi.x, p.x), std::max(hi.y, p.y), std::max(hi.z, p.z)};
  }
  void extend(const Bounds3f& b) {
    if (!b.empty()) extend(b.lo), extend(b.hi);
  }
  bool empty() const { return !(lo.x <= hi.x); }
  Vec3f center() const { return (lo + hi) * 0.5f; }
  float radius() const { return empty() ? 0.0f : length(hi - lo) * 0.5f; }
};

/// Two unit vectors that with unit vector n, as the third, are a right-handed orthonormal basis.
template <class T>
std::array<Vec3<T>, 2> tangents_of(const Vec3<T>& n) {
  const Vec3<T> s = normalize(std::abs(n.x) > std::abs(n.y) ? Vec3<T>{-n.z, 0, n.x} : Vec3<T>{0, n.z, -n.y});
  return {s, cross(n, s)};
}

/// Orthonormal basis around a unit normal: local coordinates with the normal along +z.
struct Basis {
  Vec3f s{1, 0, 0}, t{0, 1, 0}, n{0, 0, 1};
  Basis() = default;
  Basis(const Vec3f& s_, const Vec3f& t_, const Vec3f& n_) : s(s_), t(t_), n(n_) {}
  /// Branchless construction from a unit normal [Duff 2017].
  TEMPERA_INLINE explicit Basis(const Vec3f& normal) : n(normal) {
    const float sign = std::copysign(1.0f, n.z);
    const float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    s = {1 + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t = {b, sign + n.y * n.y * a, -n.y};
  }
  /// Basis whose s lies along the projection of `tangent`; falls back to an arbitrary tangent when that vanishes.
  TEMPERA_INLINE static Basis with_tangent(const Vec3f& normal, const Vec3f& tangent) {
    const Vec3f p = tangent - normal * dot(normal, tangent);
    const float l2 = length_squared(p);
    if (!(l2 > 1e-20f * length_squared(tangent)) || !std::isfinite(l2)) return Basis(normal);
    const Vec3f s = p * (1.0f / std::sqrt(l2));
    return {s, cross(normal, s), normal};
  }
  TEMPERA_INLINE Vec3f to_local(const Vec3f& v) const { return {dot(v, s), dot(v, t), dot(v, n)}; }
  TEMPERA_INLINE Vec3f to_world(const Vec3f& v) const { return s * v.x + t * v.y + n * v.z; }
};

}  // namespace tempera
