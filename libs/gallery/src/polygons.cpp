// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/polygons.h"

#include <algorithm>
#include <cmath>

#include "tempera/core/error.h"

namespace tempera::gallery {

namespace {

constexpr double kDegree = kPiD / 180;

Vec2d normal_of(const Vec2d& a, const Vec2d& b) {  // to the right of a -> b
  const Vec2d d = b - a;
  const double l = length(d);
  return l > 0 ? Vec2d{d.y / l, -d.x / l} : Vec2d{};
}

Vec2d unit(const Vec2d& v) {
  const double l = length(v);
  return l > 0 ? v / l : v;
}

/// A vector that is not parallel to `d`.
Vec3d across(const Vec3d& d) { return std::abs(d.y) < 0.9 ? Vec3d{0, 1, 0} : Vec3d{1, 0, 0}; }

/// Triangles of a simple polygon, counterclockwise, by cutting ears.
std::vector<std::array<std::uint32_t, 3>> triangulate(std::span<const Vec2d> p) {
  std::vector<std::uint32_t> rest(p.size());
  for (std::size_t i = 0; i < p.size(); ++i) rest[i] = std::uint32_t(i);
  const auto area = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    const Vec2d u = p[b] - p[a], v = p[c] - p[a];
    return u.x * v.y - u.y * v.x;
  };
  const auto fail = [] {
    throw Error(ErrorCode::kBadInput, "an outline to extrude crosses itself or is not counterclockwise");
  };
  std::vector<std::array<std::uint32_t, 3>> out;
  while (rest.size() > 3) {
    const std::size_t n = rest.size();
    bool cut = false;
    for (std::size_t i = 0; i < n && !cut; ++i) {
      const std::uint32_t a = rest[(i + n - 1) % n], b = rest[i], c = rest[(i + 1) % n];
      if (!(area(a, b, c) > 1e-14)) continue;
      const bool blocked = std::any_of(rest.begin(), rest.end(), [&](std::uint32_t q) {
        return q != a && q != b && q != c && area(a, b, q) >= 0 && area(b, c, q) >= 0 && area(c, a, q) >= 0;
      });
      if (blocked) continue;
      out.push_back({a, b, c});
      rest.erase(rest.begin() + std::ptrdiff_t(i));
      cut = true;
    }
    if (!cut) fail();
  }
  out.push_back({rest[0], rest[1], rest[2]});
  double covered = 0, enclosed = 0;
  for (const auto& t : out) covered += std::abs(area(t[0], t[1], t[2]));
  for (std::uint32_t i = 0; i + 1 < p.size(); ++i) enclosed += p[i].x * p[i + 1].y - p[i].y * p[i + 1].x;
  enclosed += p.back().x * p[0].y - p.back().y * p[0].x;
  if (!(std::abs(covered - enclosed) <= 1e-9 * covered)) fail();
  return out;
}

}  // namespace

std::uint32_t Polygons::vertex(const Vec3d& position, const Vec3d& normal, const Vec2d& uv) {
  positions.emplace_back(position);
  normals.emplace_back(normalize(normal));
  uvs.emplace_back(uv);
  return std::uint32_t(positions.size() - 1);
}

void Polygons::flat(const std::array<Vec3d, 3>& c, const std::array<Vec2d, 3>& uv) {
  const Vec3d n = cross(c[1] - c[0], c[2] - c[0]);
  const std::uint32_t a = vertex(c[0], n, uv[0]);
  vertex(c[1], n, uv[1]);
  vertex(c[2], n, uv[2]);
  triangle(a, a + 1, a + 2);
}

void Polygons::flat(const std::array<Vec3d, 4>& c, const std::array<Vec2d, 4>& uv) {
  const Vec3d n = cross(c[2] - c[0], c[3] - c[1]);
  const std::uint32_t a = vertex(c[0], n, uv[0]);
  for (std::size_t i = 1; i < 4; ++i) vertex(c[i], n, uv[i]);
  triangle(a, a + 1, a + 2);
  triangle(a, a + 2, a + 3);
}

Polygons& Polygons::add(const Polygons& other, const Affine3d& place) {
  const std::uint32_t first = std::uint32_t(positions.size());
  const Affine3d inverted = inverse(place);
  for (const Vec3f& p : other.positions) positions.emplace_back(place.point(Vec3d(p)));
  for (const Vec3f& n : other.normals) normals.emplace_back(normalize(inverted.transposed_vector(Vec3d(n))));
  uvs.insert(uvs.end(), other.uvs.begin(), other.uvs.end());
  const bool mirrored = place.determinant() < 0;
  for (std::size_t i = 0; i < other.indices.size(); i += 3) {
    const std::uint32_t a = first + other.indices[i], b = first + other.indices[i + 1],
                        c = first + other.indices[i + 2];
    mirrored ? triangle(a, c, b) : triangle(a, b, c);
  }
  return *this;
}

Polygons& Polygons::map_uv(const Vec2d& scale, const Vec2d& offset) {
  for (Vec2f& t : uvs) t = Vec2f(Vec2d{t.x * scale.x + offset.x, t.y * scale.y + offset.y});
  return *this;
}

Polygons sheet(int nu, int nv, const std::function<Vec3d(double u, double v)>& position) {
  Polygons out;
  const double hu = 1e-3 / nu, hv = 1e-3 / nv;
  for (int j = 0; j <= nv; ++j) {
    for (int i = 0; i <= nu; ++i) {
      const double u = double(i) / nu, v = double(j) / nv;
      const Vec3d du = position(u + hu, v) - position(u - hu, v), dv = position(u, v + hv) - position(u, v - hv);
      out.vertex(position(u, v), cross(du, dv), {u, 1 - v});
    }
  }
  const auto index = [&](int i, int j) { return std::uint32_t(j * (nu + 1) + i); };
  for (int j = 0; j < nv; ++j) {
    for (int i = 0; i < nu; ++i) {
      out.triangle(index(i, j), index(i + 1, j), index(i + 1, j + 1));
      out.triangle(index(i, j), index(i + 1, j + 1), index(i, j + 1));
    }
  }
  return out;
}

Polygons lathe(std::span<const Vec2d> profile, int segments, double crease) {
  // Rings of equal normals: a sharp edge has two.
  struct Ring {
    Vec2d point, normal;
    double v;
  };
  const int n = int(profile.size());
  const double sharp = std::cos(crease * kDegree);
  std::vector<Vec2d> side;  // normal of each piece of the profile
  std::vector<double> arc{0};
  for (int k = 0; k + 1 < n; ++k) {
    side.push_back(normal_of(profile[k], profile[k + 1]));
    arc.push_back(arc.back() + length(profile[k + 1] - profile[k]));
  }
  const bool closed = length(profile.front() - profile.back()) < 1e-9;
  const auto ring = [&](int k, int piece) -> Ring {  // the ring of point k as a corner of `piece`
    const Vec2d own = side[piece];
    int other = piece == k ? k - 1 : k;
    if (closed && other < 0) other = n - 2;
    if (closed && other == n - 1) other = 0;
    Vec2d normal = own;
    if (other >= 0 && other < n - 1) {
      if (dot(own, side[other]) >= sharp) normal = unit(own + side[other]);
    } else if (profile[k].x < 1e-9 && std::abs(own.y) >= sharp) {
      normal = {0, own.y > 0 ? 1.0 : -1.0};  // a smooth pole
    }
    return {profile[k], normal, 1 - arc[k] / arc.back()};
  };

  Polygons out;
  const auto emit = [&](const Ring& r) {
    const std::uint32_t first = std::uint32_t(out.positions.size());
    for (int s = 0; s <= segments; ++s) {
      const double a = 2 * kPiD * s / segments, sine = s == segments ? 0 : std::sin(a), cosine = std::cos(a);
      out.vertex({r.point.x * sine, r.point.y, r.point.x * cosine},
                 {r.normal.x * sine, r.normal.y, r.normal.x * cosine}, {double(s) / segments, r.v});
    }
    return first;
  };
  std::uint32_t upper = 0;
  for (int k = 0; k + 1 < n; ++k) {
    const Ring a = ring(k, k), b = ring(k + 1, k);
    const bool continues = k > 0 && dot(ring(k, k - 1).normal, a.normal) > 1 - 1e-9;
    const std::uint32_t ra = continues ? upper : emit(a), rb = emit(b);
    upper = rb;
    for (int s = 0; s < segments; ++s) {
      const std::uint32_t i = ra + std::uint32_t(s), j = rb + std::uint32_t(s);
      if (a.point.x > 1e-9) out.triangle(i, i + 1, j + 1);
      if (b.point.x > 1e-9) out.triangle(i, j + 1, j);
    }
  }
  return out;
}

Polygons sphere(double radius, int segments, int rings) {
  std::vector<Vec2d> profile;
  for (int k = 0; k <= rings; ++k) {
    const double a = kPiD * k / rings;
    profile.push_back({k == 0 || k == rings ? 0.0 : radius * std::sin(a), -radius * std::cos(a)});
  }
  Polygons out = lathe(profile, segments, 90);
  for (std::size_t i = 0; i < out.positions.size(); ++i) out.normals[i] = normalize(out.positions[i]);
  return out;
}

Polygons cylinder(double radius, double bottom, double top, int segments, double bevel) {
  std::vector<Vec2d> profile{{0, bottom}};
  const auto corner = [&](double y, double begin) {
    if (bevel <= 0) return profile.push_back({radius, y});
    constexpr int kSteps = 4;
    const double cy = begin < 0 ? y + bevel : y - bevel;
    for (int k = 0; k <= kSteps; ++k) {
      const double a = begin + kPiD / 2 * k / kSteps;
      profile.push_back({radius - bevel + bevel * std::cos(a), cy + bevel * std::sin(a)});
    }
  };
  corner(bottom, -kPiD / 2);
  corner(top, 0);
  profile.push_back({0, top});
  return lathe(profile, segments);
}

Polygons tube(std::span<const Vec3d> path, std::span<const double> radii, int sides, bool round_ends) {
  struct Ring {
    Vec3d center, x, y, axis;
    double radius, slope, v;  // slope: part of the normal along the axis
  };
  const std::size_t n = path.size();
  const auto radius = [&](std::size_t i) { return radii[std::min(i, radii.size() - 1)]; };
  std::vector<Ring> rings;
  double arc = 0;
  Vec3d x{};
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t before = i > 0 ? i - 1 : i, after = std::min(i + 1, n - 1);
    const Vec3d axis = normalize(path[after] - path[before]);
    // The frame of the last ring, turned no more than the path turns.
    if (i == 0) x = across(axis);
    x = normalize(x - axis * dot(x, axis));
    if (i > 0) arc += length(path[i] - path[i - 1]);
    const double step = length(path[after] - path[before]);
    rings.push_back(
        {path[i], x, cross(axis, x), axis, radius(i), step > 0 ? -(radius(after) - radius(before)) / step : 0, arc});
  }
  const auto cap = [&](const Ring& end, double sign, std::vector<Ring>& to) {
    constexpr int kSteps = 4;
    for (int k = 1; k <= kSteps; ++k) {
      const double a = kPiD / 2 * k / kSteps;
      Ring r = end;
      r.center = end.center + end.axis * (sign * end.radius * std::sin(a));
      r.radius = k == kSteps ? 0 : end.radius * std::cos(a);
      r.slope = sign * (k == kSteps ? 1e6 : std::tan(a));
      r.v = end.v + sign * end.radius * a;
      to.push_back(r);
    }
  };
  Polygons out;
  if (round_ends) {
    std::vector<Ring> front;
    cap(rings.front(), -1, front);
    std::vector<Ring> back;
    cap(rings.back(), 1, back);
    std::reverse(front.begin(), front.end());
    rings.insert(rings.begin(), front.begin(), front.end());
    rings.insert(rings.end(), back.begin(), back.end());
  }
  for (const Ring& r : rings) {
    for (int s = 0; s <= sides; ++s) {
      const double a = s == sides ? 0 : 2 * kPiD * s / sides;
      const Vec3d outward = r.x * std::cos(a) + r.y * std::sin(a);
      out.vertex(r.center + outward * r.radius, outward + r.axis * r.slope, {double(s) / sides, 1 - r.v});
    }
  }
  const auto index = [&](std::size_t ring, int s) { return std::uint32_t(ring * (sides + 1) + s); };
  for (std::size_t k = 0; k + 1 < rings.size(); ++k) {
    for (int s = 0; s < sides; ++s) {
      if (rings[k].radius > 0) out.triangle(index(k, s), index(k, s + 1), index(k + 1, s + 1));
      if (rings[k + 1].radius > 0) out.triangle(index(k, s), index(k + 1, s + 1), index(k + 1, s));
    }
  }
  if (!round_ends) {
    for (const bool last : {false, true}) {
      const Ring& r = last ? rings.back() : rings.front();
      const Vec3d normal = last ? r.axis : -r.axis;
      const std::uint32_t center = out.vertex(r.center, normal, {0.5, 0.5});
      for (int s = 0; s <= sides; ++s) {
        const double a = 2 * kPiD * s / sides;
        out.vertex(r.center + (r.x * std::cos(a) + r.y * std::sin(a)) * r.radius, normal,
                   {0.5 + 0.5 * std::cos(a), 0.5 + 0.5 * std::sin(a)});
      }
      for (std::uint32_t s = 1; s <= std::uint32_t(sides); ++s)
        last ? out.triangle(center, center + s, center + s + 1) : out.triangle(center, center + s + 1, center + s);
    }
  }
  return out;
}

Polygons capsule(const Vec3d& a, const Vec3d& b, double radius_a, double radius_b, int sides) {
  const std::array<Vec3d, 2> path{a, b};
  const std::array<double, 2> radii{radius_a, radius_b};
  return tube(path, radii, sides);
}

namespace {

/// The six faces of a cube: outward normal and the directions of u and of up.
struct Face {
  Vec3d normal, u, up;
};
constexpr std::array<Face, 6> kFaces{{{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}},
                                      {{-1, 0, 0}, {0, 0, 1}, {0, 1, 0}},
                                      {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}},
                                      {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}},
                                      {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}},
                                      {{0, 0, -1}, {-1, 0, 0}, {0, 1, 0}}}};

double extent(const Vec3d& size, const Vec3d& axis) { return std::abs(dot(size, axis)); }

}  // namespace

Polygons box(const Vec3d& size, double uv_scale) {
  Polygons out;
  for (const Face& f : kFaces) {
    const double w = extent(size, f.u), h = extent(size, f.up);
    const Vec3d c = f.normal * (extent(size, f.normal) / 2), u = f.u * (w / 2), v = f.up * (h / 2);
    const double s = w * uv_scale, t = h * uv_scale;
    out.flat({c - u - v, c + u - v, c + u + v, c - u + v}, {Vec2d{0, t}, Vec2d{s, t}, Vec2d{s, 0}, Vec2d{0, 0}});
  }
  return out;
}

Polygons rounded_box(const Vec3d& size, double radius, int steps, double uv_scale) {
  Polygons out;
  const Vec3d inner = size / 2 - Vec3d{radius, radius, radius};
  // Along each side of a face: half a quarter turn, the flat part, half a quarter turn.
  std::vector<std::pair<double, double>> line;  // side of the flat part, tangent of the angle
  for (int k = 0; k <= steps; ++k) line.push_back({-1, std::tan(kPiD / 4 * (double(k) / steps - 1))});
  for (int k = 0; k <= steps; ++k) line.push_back({1, std::tan(kPiD / 4 * k / steps)});
  const int n = int(line.size());
  for (const Face& f : kFaces) {
    const std::uint32_t first = std::uint32_t(out.positions.size());
    const double w = extent(inner, f.u), h = extent(inner, f.up), d = extent(inner, f.normal);
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const auto [su, tu] = line[i];
        const auto [sv, tv] = line[j];
        const Vec3d normal = normalize(f.normal + f.u * tu + f.up * tv);
        const Vec3d p = f.normal * d + f.u * (su * w) + f.up * (sv * h) + normal * radius;
        out.vertex(p, normal, {(dot(p, f.u) + w + radius) * uv_scale, (h + radius - dot(p, f.up)) * uv_scale});
      }
    }
    for (int j = 0; j + 1 < n; ++j) {
      for (int i = 0; i + 1 < n; ++i) {
        const std::uint32_t a = first + std::uint32_t(j * n + i), b = a + std::uint32_t(n);
        out.triangle(a, a + 1, b + 1);
        out.triangle(a, b + 1, b);
      }
    }
  }
  return out;
}

Polygons floor_plane(const Vec2d& size, const Vec2d& uv_size, int nx, int nz) {
  Polygons out = sheet(nx, nz, [&](double u, double v) { return Vec3d{(u - 0.5) * size.x, 0, (0.5 - v) * size.y}; });
  std::fill(out.normals.begin(), out.normals.end(), Vec3f{0, 1, 0});
  return out.map_uv(uv_size);
}

Polygons wall_plane(const Vec2d& size, const Vec2d& uv_size) {
  const double x = size.x / 2, y = size.y / 2;
  Polygons out;
  out.flat({Vec3d{-x, -y, 0}, Vec3d{x, -y, 0}, Vec3d{x, y, 0}, Vec3d{-x, y, 0}},
           {Vec2d{0, uv_size.y}, Vec2d{uv_size.x, uv_size.y}, Vec2d{uv_size.x, 0}, Vec2d{0, 0}});
  return out;
}

Polygons extrude(std::span<const Vec2d> outline, double depth, double uv_scale, double crease) {
  Polygons out;
  const auto faces = triangulate(outline);
  const double z = depth / 2;
  for (const double side : {1.0, -1.0}) {
    const std::uint32_t first = std::uint32_t(out.positions.size());
    for (const Vec2d& p : outline)
      out.vertex({p.x, p.y, side * z}, {0, 0, side}, {p.x * side * uv_scale, -p.y * uv_scale});
    for (const auto& f : faces)
      side > 0 ? out.triangle(first + f[0], first + f[1], first + f[2])
               : out.triangle(first + f[0], first + f[2], first + f[1]);
  }
  const std::size_t n = outline.size();
  const double sharp = std::cos(crease * kDegree);
  double arc = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const auto edge = [&](std::size_t k) { return normal_of(outline[k % n], outline[(k + 1) % n]); };
    const Vec2d own = edge(i), before = edge(i + n - 1), after = edge(i + 1);
    const Vec2d na = dot(own, before) >= sharp ? unit(own + before) : own;
    const Vec2d nb = dot(own, after) >= sharp ? unit(own + after) : own;
    const Vec2d a = outline[i], b = outline[(i + 1) % n];
    const double end = arc + length(b - a);
    const std::uint32_t v = out.vertex({a.x, a.y, z}, {na.x, na.y, 0}, {arc * uv_scale, 0});
    out.vertex({a.x, a.y, -z}, {na.x, na.y, 0}, {arc * uv_scale, depth * uv_scale});
    out.vertex({b.x, b.y, -z}, {nb.x, nb.y, 0}, {end * uv_scale, depth * uv_scale});
    out.vertex({b.x, b.y, z}, {nb.x, nb.y, 0}, {end * uv_scale, 0});
    out.triangle(v, v + 1, v + 2);
    out.triangle(v, v + 2, v + 3);
    arc = end;
  }
  return out;
}

Affine3d at(const Vec3d& position) { return translate(position); }

Affine3d turned(const Vec3d& axis, double degrees, const Vec3d& position) {
  Affine3d m = rotation(axis_angle(normalize(axis), degrees * kDegree));
  m.translation = position;
  return m;
}

Affine3d along(const Vec3d& a, const Vec3d& b) {
  const Vec3d y = normalize(b - a), x = normalize(cross(y, across(y)));
  return {x, y, cross(x, y), a};
}

namespace {

template <class V>
std::vector<V> catmull_rom(std::span<const V> p, int steps) {
  std::vector<V> out;
  const std::size_t n = p.size();
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const V a = i > 0 ? p[i - 1] : p[0] * 2.0 - p[1], b = p[i], c = p[i + 1],
            d = i + 2 < n ? p[i + 2] : p[n - 1] * 2.0 - p[n - 2];
    for (int k = 0; k < steps; ++k) {
      const double t = double(k) / steps;
      out.push_back((b * 2.0 + (c - a) * t + (a * 2.0 - b * 5.0 + c * 4.0 - d) * (t * t) +
                     (b * 3.0 - a - c * 3.0 + d) * (t * t * t)) *
                    0.5);
    }
  }
  out.push_back(p.back());
  return out;
}

}  // namespace

std::vector<Vec3d> curve(std::span<const Vec3d> points, int steps) { return catmull_rom(points, steps); }
std::vector<Vec2d> curve(std::span<const Vec2d> points, int steps) { return catmull_rom(points, steps); }

}  // namespace tempera::gallery
