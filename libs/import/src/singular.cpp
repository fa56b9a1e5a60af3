// SPDX-License-Identifier: Apache-2.0
#include "singular.h"

#include <algorithm>
#include <cmath>

namespace tempera {
namespace {

constexpr double kTiny = 1e-12;  // of the size of what is compared with it
constexpr double kThickness = 1e-4;
constexpr double kLeast = 1e-30;  // a length; float32, which shapes are held in, loses shorter axes or their inverse

/// The longest cross product of two of three vectors.
Vec3d longest_cross(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  const std::array<Vec3d, 3> all{cross(b, c), cross(c, a), cross(a, b)};
  return *std::max_element(all.begin(), all.end(),
                           [](const Vec3d& p, const Vec3d& q) { return length(p) < length(q); });
}

/// `m` with a longest axis of about 1, so that products of three numbers neither vanish nor overflow; and that length.
double rescale(Affine3d& m) {
  double size = 0;
  for (const Vec3d& v : {m.x, m.y, m.z})
    for (int i = 0; i < 3; ++i) size = std::max(size, std::abs(v[i]));
  if (size > 0) m.x = m.x / size, m.y = m.y / size, m.z = m.z / size;
  return size;
}

}  // namespace

bool is_singular(const Affine3d& map) {
  Affine3d m = map;
  rescale(m);
  // Against the axes' own lengths: a map may well be thin.
  return !(std::abs(m.determinant()) > kTiny * length(m.x) * length(m.y) * length(m.z));
}

std::optional<Affine3d> with_thickness(const Affine3d& map) {
  Affine3d m = map;
  for (Vec3d* axis : {&m.x, &m.y, &m.z})
    if (length(*axis) < kLeast) *axis = {};
  if (!is_singular(m)) return map;
  const double size = rescale(m);
  const Vec3d across = longest_cross(m.x, m.y, m.z);
  if (!(length(across) > kTiny)) return std::nullopt;
  const Vec3d row0{m.x.x, m.y.x, m.z.x}, row1{m.x.y, m.y.y, m.z.y}, row2{m.x.z, m.y.z, m.z.z};
  const Vec3d lost = normalize(longest_cross(row0, row1, row2));  // the direction that the map forgets
  const Vec3d n = normalize(across) * kThickness;
  m.x += n * lost.x, m.y += n * lost.y, m.z += n * lost.z;
  m.x = m.x * size, m.y = m.y * size, m.z = m.z * size;
  m.translation = map.translation;
  if (m.determinant() < 0) {
    m.x -= n * (2 * size * lost.x), m.y -= n * (2 * size * lost.y), m.z -= n * (2 * size * lost.z);
  }
  return m;
}

std::optional<Affine3d> with_all_axes(Affine3d m) {
  if (m.x == Vec3d{})
    m.x = normalize(cross(m.y, m.z));
  else if (m.y == Vec3d{})
    m.y = normalize(cross(m.z, m.x));
  else if (m.z == Vec3d{})
    m.z = normalize(cross(m.x, m.y));
  if (is_singular(m)) return std::nullopt;
  return m;
}

Quatd closest_rotation(const Affine3d& map, bool mirrored, const Quatd& hint) {
  Affine3d m = map;
  rescale(m);
  const Affine3d other = rotation(hint);
  std::array<Vec3d, 3> axes{m.x, m.y, m.z};
  const std::array<Vec3d, 3> fallback{other.x, other.y, other.z};
  std::array<Vec3d, 3> unit;
  std::array<bool, 3> known{};
  int count = 0;
  const auto take = [&](std::size_t i, Vec3d v) {
    for (std::size_t k = 0; k < 3; ++k)
      if (known[k]) v = v - unit[k] * dot(unit[k], v);
    if (!(length(v) > 1e-9)) return;
    unit[i] = normalize(v);
    known[i] = true;
    ++count;
  };
  for (std::size_t i = 0; i < 3 && count < 2; ++i)
    if (length(axes[i]) > kTiny) take(i, normalize(mirrored ? -axes[i] : axes[i]));
  for (std::size_t i = 0; i < 3 && count < 2; ++i)
    if (!known[i]) take(i, fallback[i]);
  for (std::size_t i = 0; i < 3 && count < 2; ++i)  // the hint's axis lies along the one that is known
    for (const Vec3d& v : fallback)
      if (!known[i] && count < 2) take(i, v);
  for (std::size_t i = 0; i < 3; ++i)
    if (!known[i]) unit[i] = cross(unit[(i + 1) % 3], unit[(i + 2) % 3]);
  return quaternion(Affine3d{unit[0], unit[1], unit[2]});
}

}  // namespace tempera
