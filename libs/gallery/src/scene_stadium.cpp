// SPDX-License-Identifier: Apache-2.0
// Stands for [Zhou 2015, Fig. 3 and Table 1].
#include <algorithm>
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kLong = 150, kShort = 130, kHeight = 50;  // of the wall; metres
constexpr double kOpenLong = 70, kOpenShort = 50;          // of the opening in the roof
constexpr int kMain = 24, kSecondary = 4700;
constexpr std::uint64_t kSeed = 2008;

/// A beam of 24 triangles: four sides in two lengths, and fans at the ends.
void add_beam(Polygons& out, const Vec3d& a, const Vec3d& b, const Vec3d& outwards, double wide, double deep) {
  const Vec3d axis = normalize(b - a), side = normalize(cross(axis, outwards)), up = cross(side, axis);
  const Vec3d corner[4] = {side * (-wide / 2) + up * (-deep / 2), side * (wide / 2) + up * (-deep / 2),
                           side * (wide / 2) + up * (deep / 2), side * (-wide / 2) + up * (deep / 2)};
  const Vec3d normal[4] = {-up, side, up, -side};
  const Vec3d rings[3] = {a, (a + b) / 2, b};
  for (std::size_t k = 0; k < 4; ++k) {
    const std::size_t n = (k + 1) % 4;
    std::uint32_t first = 0;
    for (std::size_t r = 0; r < 3; ++r) {
      const std::uint32_t v = out.vertex(rings[r] + corner[k], normal[k], {0, double(r)});
      out.vertex(rings[r] + corner[n], normal[k], {1, double(r)});
      if (r == 0) first = v;
    }
    for (std::uint32_t r = 0; r < 4; r += 2) {
      const std::uint32_t v = first + r;
      out.triangle(v, v + 3, v + 1);
      out.triangle(v, v + 2, v + 3);
    }
  }
  for (const double end : {-1.0, 1.0}) {
    const Vec3d at = end < 0 ? a : b, n = axis * end;
    const std::uint32_t center = out.vertex(at, n, {0.5, 0.5});
    for (const Vec3d& c : corner) out.vertex(at + c, n, {0, 0});
    for (std::uint32_t k = 0; k < 4; ++k) {
      const std::uint32_t p = center + 1 + k, q = center + 1 + (k + 1) % 4;
      end > 0 ? out.triangle(center, q, p) : out.triangle(center, p, q);
    }
  }
}

/// The rim dips at the ends of the long axis, as a saddle.
double rim_height(double angle) { return kHeight * (0.92 - 0.10 * std::cos(2 * angle)); }
Vec3d rim(double angle) { return {kLong * std::cos(angle), rim_height(angle), kShort * std::sin(angle)}; }
Vec3d base(double angle) { return {0.84 * kLong * std::cos(angle), 0, 0.84 * kShort * std::sin(angle)}; }
/// Where the tangent at `angle` of the opening, `scale` times as large, meets the rim: `side` -1 or 1. Angle of the
/// rim.
double tangent_end(double angle, double side, double scale = 1) {
  const Vec2d p{scale * kOpenLong * std::cos(angle), scale * kOpenShort * std::sin(angle)},
      d{-kOpenLong * std::sin(angle) * side, kOpenShort * std::cos(angle) * side};
  const double a = sqr(d.x / kLong) + sqr(d.y / kShort), h = p.x * d.x / sqr(kLong) + p.y * d.y / sqr(kShort),
               c = sqr(p.x / kLong) + sqr(p.y / kShort) - 1;
  const double t = (-h + std::sqrt(h * h - a * c)) / a;
  return std::atan2((p.y + d.y * t) / kShort, (p.x + d.x * t) / kLong);
}
Polygons beams() {
  Polygons out;
  const Vec3d up{0, 1, 0};
  const auto outward = [](double angle) { return Vec3d{std::cos(angle) / kLong, 0.0, std::sin(angle) / kShort}; };
  for (int k = 0; k < kMain; ++k) {
    const double angle = 2 * kPiD * (k + 0.5) / kMain, end = tangent_end(angle, 1);
    add_beam(out, rim(tangent_end(angle, -1)), rim(end), up, 1.6, 3.2);
  }
  // Half of the rest stand in the wall, leaning either way; the others lie in the roof along tangents of the opening.
  for (std::uint64_t k = 0; k < kSecondary; ++k) {
    const auto r = [&](std::uint64_t purpose) { return random(kSeed, k, purpose); };
    const double thick = 0.45 + 0.75 * r(0) * r(1);
    if (r(2) < 0.56) {
      const double angle = 2 * kPiD * r(3), lean = (r(4) < 0.5 ? -1 : 1) * (0.06 + 0.42 * r(5));
      const double from = 0.55 * sqr(r(6)), to = 1 - 0.35 * sqr(r(7));
      const Vec3d a = base(angle), b = rim(angle + lean);
      // A chord of the wall, pushed out to where the wall is at both ends.
      const double inset = 1 - 0.012 * r(8);
      add_beam(out, (a + (b - a) * from) * inset, (a + (b - a) * to) * inset, outward(angle + lean / 2), thick,
               0.8 * thick);
    } else {
      // A piece of a chord of the rim that touches the opening, or an oval around it.
      const double angle = 2 * kPiD * r(3), oval = 1 + 0.9 * sqr(r(9));
      const Vec3d a = rim(tangent_end(angle, -1, oval)), b = rim(tangent_end(angle, 1, oval));
      const double middle = r(5), half = 0.06 + 0.22 * r(6);
      const double from = std::max(0.0, middle - half), to = std::min(1.0, middle + half);
      const Vec3d drop{0, -2.5 * r(7), 0};
      add_beam(out, a + (b - a) * from + drop, a + (b - a) * to + drop, up, thick, 0.9 * thick);
    }
  }
  return out;
}

void build(GalleryBuilder& b) {
  const int steel = b.material({.name = "steel", .color = Rgb(0.6f), .roughness = 0.8, .specular = 0});
  const int seats = b.material({.name = "seats", .color = hex("#b3392c"), .specular = 0});
  const int ground = b.material({.name = "ground", .color = hex("#8f8a80"), .specular = 0});
  const int grass = b.material({.name = "grass", .color = hex("#4d7a35"), .specular = 0});
  b.place("beams", beams(), steel);
  // Ten rows of 60 quadrilaterals.
  const Polygons bowl = sheet(60, 10, [](double u, double v) {
    const double a = 2 * kPiD * u, s = 0.38 + 0.44 * v;
    return Vec3d{kLong * s * std::cos(a), 1 + 34 * std::pow(std::max(v, 0.0), 1.35), -kShort * s * std::sin(a)};
  });
  b.place("seats", bowl, seats);
  b.place("pitch", floor_plane({105, 68}), grass, {0, 0.4, 0});
  b.place("ground", floor_plane({3000, 3000}), ground);
  b.environment(sky(1024, {0.55, 0.55, 0.65}, 3, 0.3, 3.2));
  b.camera(
      26,
      [](double f) {
        const double a = (38 + 0.5 * f) * kPiD / 180;
        return Vec3d{400 * std::sin(a), 165, 400 * std::cos(a)};
      },
      [](double) {
        return Vec3d{0, 14, 0};
      });
}

}  // namespace

extern const GalleryScene stadium_scene{
    .name = "stadium",
    .title = "A stadium of steel beams under the sky, seen from an orbit",
    .paper = &kZhou2015,
    .figure = "Figure 3 and Table 1",
    .triangles = 114580,
    .width = 720,
    .height = 480,
    .last_frame = 48,
    .spp = 32,
    .max_depth = 4,
    .reference_spp = 4096,
    .classes = {{"direct", "ED", "direct light of sky and sun"},
                {"indirect", "ED.+", "light by more than one reflection"}},
    .decomposition = true,
    .camera_moves = true,
    .variants = {{"large", "the second size of Table 1", {{"film.resolution", "[1024, 576]"}}}},
    .about =
        "The steel of a stadium of about 114 000 triangles: 24 main trusses tangent to the opening of the roof and "
        "4700 further beams in wall\n"
        "and roof, 24 triangles each, on an oval of 300 x 260 m, 50 m high, with a bowl of seats of 1200. Steel has "
        "albedo 0.6. The sky is a\n"
        "gradient with a sun of 3 degrees in radius that holds 30 % of the irradiance; the camera orbits by 0.5 "
        "degrees a\n"
        "frame. The paper's figures show 32 samples per pixel.\n",
    .build = build,
};

}  // namespace tempera
