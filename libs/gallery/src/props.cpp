// SPDX-License-Identifier: Apache-2.0
#include "props.h"

#include <cmath>

#include "tempera/gallery/implicit.h"

namespace tempera::gallery {

Polygons teapot(bool hollow, double cell) {
  const std::vector<Vec2d> belly{{0, 0.004},     {0.045, 0.003}, {0.058, 0.0},   {0.064, 0.006}, {0.088, 0.028},
                                 {0.104, 0.065}, {0.099, 0.102}, {0.076, 0.130}, {0.058, 0.139}, {0.055, 0.144}};
  std::vector<Vec2d> body = curve(belly, 4);
  body.push_back({0, 0.144});
  const std::vector<Vec2d> cover{{0, 0.140},     {0.05, 0.140},  {0.052, 0.146}, {0.040, 0.157},
                                 {0.020, 0.164}, {0.009, 0.168}, {0.008, 0.174}, {0.017, 0.181},
                                 {0.018, 0.190}, {0.011, 0.197}, {0, 0.199}};
  const std::vector<Vec2d> lid = curve(cover, 3);
  const std::vector<Vec3d> spout = curve(
      std::vector<Vec3d>{{0.080, 0.048, 0}, {0.128, 0.058, 0}, {0.152, 0.098, 0}, {0.172, 0.136, 0}, {0.190, 0.150, 0}},
      4);
  const std::vector<Vec3d> handle = curve(std::vector<Vec3d>{{-0.078, 0.120, 0},
                                                             {-0.125, 0.134, 0},
                                                             {-0.162, 0.112, 0},
                                                             {-0.160, 0.068, 0},
                                                             {-0.126, 0.040, 0},
                                                             {-0.088, 0.040, 0}},
                                          4);
  std::vector<double> thick, bar(handle.size(), 0.0095);
  for (std::size_t i = 0; i < spout.size(); ++i) {
    const double t = double(i) / double(spout.size() - 1);
    thick.push_back(0.030 - 0.024 * t + 0.008 * t * t);
  }
  constexpr double kWall = 0.007;
  const auto distance = [&](const Vec3d& p) {
    const double vessel = turned_solid(p, body);
    double d = blend(vessel, turned_solid(p, lid), 0.004);
    d = blend(d, bent_limb(p, spout, thick), 0.022);
    d = blend(d, bent_limb(p, handle, bar), 0.014);
    return hollow ? carve(d, vessel + kWall, 0.003) : d;
  };
  return polygonize(distance, {-0.18, -0.01, -0.112}, {0.212, 0.205, 0.112}, cell);
}

Picture landscape(int width, int height, std::uint64_t seed) {
  const double aspect = double(width) / height;
  const double sun_x = 0.25 + 0.5 * random(seed, 1), sun_y = 0.30 + 0.1 * random(seed, 2);
  return paint(width, height, [=](double u, double v) {
    const double d = std::hypot((u - sun_x) * aspect, v - sun_y);
    Rgb c = mix(hex("#f3c987"), hex("#5f8fb4"), smooth_step(0.62, 0.0, v));
    c = mix(c, hex("#e88b4a"), 0.6 * std::exp(-5 * d));
    if (d < 0.085) c = hex("#fdf0c4");
    const Rgb hills[] = {hex("#9a86a0"), hex("#6d7f86"), hex("#48695a"), hex("#2d4a3a")};
    for (int k = 0; k < 4; ++k) {
      const double crest = 0.48 + 0.12 * k -
                           (0.09 - 0.012 * k) * noise({u * aspect * (1.6 + 0.5 * k), 3.1 * k, 0.5}, seed) -
                           0.05 * noise({u * aspect * (5.0 + k), 7.7 * k, 0.5}, seed + 1);
      if (v > crest) c = mix(hills[k], hex("#f0d9ae"), 0.25 * std::exp(-14 * (v - crest)));
    }
    return c * float(1 + 0.10 * fractal_noise({u * 30 * aspect, v * 30, 2}, 3, seed + 2));
  });
}

Picture sky(int width, const Vec3d& sun, double sun_radius, double sun_share, double irradiance, const Rgb& zenith,
            const Rgb& horizon, const Rgb& ground, const Rgb& sun_color) {
  const Vec3d to_sun = normalize(sun);
  const double radius = sun_radius * kPiD / 180;
  const int height = width / 2;
  const auto disc = [&](const Vec3d& d) {
    const double angle = std::atan2(length(cross(d, to_sun)), dot(d, to_sun));
    return 1 - smooth_step(0.85 * radius, 1.15 * radius, angle);
  };
  const auto dome = [&](const Vec3d& d) {
    if (d.y < 0) return mix(horizon, ground, smooth_step(0, 0.06, -d.y));
    const double glow = std::pow(std::max(dot(d, to_sun), 0.0), 24);
    return mix(horizon, zenith, std::pow(d.y, 0.45)) + sun_color * float(0.35 * glow);
  };
  // Irradiance of a horizontal surface by the parts of the sky.
  double from_dome = 0, from_disc = 0;
  for (int y = 0; y < height / 2; ++y) {
    for (int x = 0; x < width; ++x) {
      const double theta = kPiD * (y + 0.5) / height, phi = 2 * kPiD * (x + 0.5) / width;
      const Vec3d d{std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)};
      const double weight = std::cos(theta) * std::sin(theta) * (kPiD / height) * (2 * kPiD / width);
      from_dome += weight * mean(dome(d));
      from_disc += weight * disc(d) * mean(sun_color);
    }
  }
  const double a = irradiance * (1 - sun_share) / from_dome, b = from_disc > 0 ? irradiance * sun_share / from_disc : 0;
  return paint_environment(width, height,
                           [&](const Vec3d& d) { return dome(d) * float(a) + sun_color * float(b * disc(d)); });
}

Polygons picture_frame(const Vec2d& size, double bar, double depth) {
  Polygons out;
  // The profile of a bar from the picture outwards: (outwards, towards the viewer).
  const std::vector<Vec2d> profile{{0, 0}, {0, 0.35}, {0.25, 0.5}, {0.45, 0.95}, {0.75, 1.0}, {1.0, 0.7}, {1.0, 0}};
  const Vec2d half = size / 2;
  const Vec2d corners[4] = {{-half.x, -half.y}, {half.x, -half.y}, {half.x, half.y}, {-half.x, half.y}};
  const Vec2d outward[4] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
  double along = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    const std::size_t n = (k + 1) % 4;
    const double side = length(corners[n] - corners[k]);
    for (std::size_t i = 0; i + 1 < profile.size(); ++i) {
      const auto point = [&](std::size_t corner, const Vec2d& p) {
        const Vec2d q = corners[corner] + outward[corner] * (p.x * bar);
        return Vec3d{q.x, q.y, p.y * depth};
      };
      const Vec3d a = point(k, profile[i]), b = point(n, profile[i]), c = point(n, profile[i + 1]),
                  d = point(k, profile[i + 1]);
      const double v0 = profile[i].x * 0.1, v1 = profile[i + 1].x * 0.1;
      out.flat({a, d, c, b}, {Vec2d{along, v0}, Vec2d{along, v1}, Vec2d{along + side, v1}, Vec2d{along + side, v0}});
    }
    along += side;
  }
  return out;
}

}  // namespace tempera::gallery
