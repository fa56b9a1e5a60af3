// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/implicit.h"

#include <algorithm>
#include <cmath>

#include "tempera/core/parallel.h"

namespace tempera::gallery {

Polygons polygonize(const Distance& d, const Vec3d& lo, const Vec3d& hi, double cell) {
  // A rim of one cell keeps the surface away from the border of the grid.
  const auto count = [&](double a, double b) { return int(std::ceil((b - a) / cell)) + 3; };
  const int nx = count(lo.x, hi.x), ny = count(lo.y, hi.y), nz = count(lo.z, hi.z);
  const Vec3d origin = lo - Vec3d{cell, cell, cell};
  const auto corner = [&](int i, int j, int k) { return (std::size_t(k) * ny + j) * nx + i; };
  const auto place = [&](int i, int j, int k) { return origin + Vec3d{i * cell, j * cell, k * cell}; };
  std::vector<float> value(corner(0, 0, nz));
  parallel_rows(0, nz, [&](int k) {
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) value[corner(i, j, k)] = float(d(place(i, j, k)));
  });

  const double h = cell * 1e-3;
  const auto gradient = [&](const Vec3d& p) {
    return normalize(Vec3d{d(p + Vec3d{h, 0, 0}) - d(p - Vec3d{h, 0, 0}), d(p + Vec3d{0, h, 0}) - d(p - Vec3d{0, h, 0}),
                           d(p + Vec3d{0, 0, h}) - d(p - Vec3d{0, 0, h})});
  };
  Polygons out;
  std::vector<std::int32_t> vertex(value.size(), -1);
  for (int k = 0; k + 1 < nz; ++k) {
    for (int j = 0; j + 1 < ny; ++j) {
      for (int i = 0; i + 1 < nx; ++i) {
        int inside = 0;
        for (int c = 0; c < 8; ++c) inside += value[corner(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))] < 0;
        if (inside == 0 || inside == 8) continue;
        // The mean of the crossings of the cell's edges.
        Vec3d sum{};
        int crossings = 0;
        for (int c = 0; c < 8; ++c) {
          for (int axis = 0; axis < 3; ++axis) {
            if (c >> axis & 1) continue;
            const int e = c | 1 << axis;
            const double a = value[corner(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))],
                         b = value[corner(i + (e & 1), j + (e >> 1 & 1), k + (e >> 2))];
            if ((a < 0) == (b < 0)) continue;
            const Vec3d pa = place(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)),
                        pb = place(i + (e & 1), j + (e >> 1 & 1), k + (e >> 2));
            sum += pa + (pb - pa) * (a / (a - b));
            ++crossings;
          }
        }
        vertex[corner(i, j, k)] = std::int32_t(out.vertex(sum / double(crossings), {0, 1, 0}, {}));
      }
    }
  }
  parallel_for(
      0, std::int64_t(out.positions.size()),
      [&](std::int64_t v) {
        Vec3d p(out.positions[v]);
        const Vec3d start = p;
        for (int step = 0; step < 3; ++step) p -= gradient(p) * d(p);
        if (!is_finite(p) || length(p - start) > cell) p = start;  // at an edge that the cells cannot show
        out.positions[v] = Vec3f(p);
        out.normals[v] = Vec3f(gradient(p));
      },
      256);

  // A quadrilateral around each edge of the grid that crosses the surface.
  for (int k = 1; k + 1 < nz; ++k) {
    for (int j = 1; j + 1 < ny; ++j) {
      for (int i = 1; i + 1 < nx; ++i) {
        const bool in = value[corner(i, j, k)] < 0;
        const auto quad = [&](int a, int b, int c, int e, bool outwards) {
          const auto at = [](int v) { return std::uint32_t(v); };
          if (outwards)
            out.triangle(at(a), at(b), at(c)), out.triangle(at(a), at(c), at(e));
          else
            out.triangle(at(a), at(c), at(b)), out.triangle(at(a), at(e), at(c));
        };
        if (in != (value[corner(i + 1, j, k)] < 0))
          quad(vertex[corner(i, j - 1, k - 1)], vertex[corner(i, j, k - 1)], vertex[corner(i, j, k)],
               vertex[corner(i, j - 1, k)], in);
        if (in != (value[corner(i, j + 1, k)] < 0))
          quad(vertex[corner(i - 1, j, k - 1)], vertex[corner(i - 1, j, k)], vertex[corner(i, j, k)],
               vertex[corner(i, j, k - 1)], in);
        if (in != (value[corner(i, j, k + 1)] < 0))
          quad(vertex[corner(i - 1, j - 1, k)], vertex[corner(i, j - 1, k)], vertex[corner(i, j, k)],
               vertex[corner(i - 1, j, k)], in);
      }
    }
  }
  return out;
}

double ball(const Vec3d& p, const Vec3d& center, double radius) { return length(p - center) - radius; }

double ellipsoid(const Vec3d& p, const Vec3d& r) {
  const double k0 = length(Vec3d{p.x / r.x, p.y / r.y, p.z / r.z});
  const double k1 = length(Vec3d{p.x / sqr(r.x), p.y / sqr(r.y), p.z / sqr(r.z)});
  return k1 > 0 ? k0 * (k0 - 1) / k1 : -std::min({r.x, r.y, r.z});
}

double limb(const Vec3d& p, const Vec3d& a, const Vec3d& b, double radius_a, double radius_b) {
  const Vec3d ab = b - a;
  const double t = std::clamp(dot(p - a, ab) / dot(ab, ab), 0.0, 1.0);
  return length(p - a - ab * t) - (radius_a + (radius_b - radius_a) * t);
}

double bent_limb(const Vec3d& p, std::span<const Vec3d> path, std::span<const double> radii) {
  double d = 1e30;
  for (std::size_t i = 0; i + 1 < path.size(); ++i)
    d = std::min(d, limb(p, path[i], path[i + 1], radii[i], radii[i + 1]));
  return d;
}

double turned_solid(const Vec3d& p, std::span<const Vec2d> outline) {
  const Vec2d q{std::hypot(p.x, p.z), p.y};
  double nearest = 1e30;
  bool inside = false;
  for (std::size_t i = 0; i + 1 < outline.size(); ++i) {
    const Vec2d a = outline[i], b = outline[i + 1], ab = b - a;
    const double t = std::clamp(dot(q - a, ab) / std::max(dot(ab, ab), 1e-30), 0.0, 1.0);
    const Vec2d to = q - a - ab * t;
    nearest = std::min(nearest, dot(to, to));
    // Even-odd rule for a ray towards larger radii: the axis closes the outline.
    if ((a.y > q.y) != (b.y > q.y) && q.x < a.x + (q.y - a.y) / (b.y - a.y) * ab.x) inside = !inside;
  }
  return (inside ? -1 : 1) * std::sqrt(nearest);
}

double blend(double a, double b, double k) {
  if (k <= 0) return std::min(a, b);
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - h * h * k / 4;
}

double carve(double a, double b, double k) { return -blend(-a, b, k); }

}  // namespace tempera::gallery
