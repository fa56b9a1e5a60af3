// SPDX-License-Identifier: Apache-2.0
#include "sunsky.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sunsky_data.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

constexpr double kLuminousScale = 1 / 106.7502593994140625;  // of the CIE observer's y integrated over nm
constexpr double kTerrestrialAperture = 0.5358;              // degrees, for which kSun holds

double elevation_of(const Vec3d& sun) { return std::clamp(std::asin(std::clamp(sun.z, -1.0, 1.0)), 0.0, kPiD / 2); }

/// Weights of the control points of a quintic Bézier curve.
std::array<double, 6> bezier(double x) {
  const double y = 1 - x;
  return {y * y * y * y * y,      5 * y * y * y * y * x, 10 * y * y * y * x * x,
          10 * y * y * x * x * x, 5 * y * x * x * x * x, x * x * x * x * x};
}

/// Lower table entry and weight of the upper one.
std::pair<int, double> between(double turbidity) {
  const int lower = std::clamp(int(turbidity) - 1, 0, 8);
  return {lower, std::clamp(turbidity - 1 - lower, 0.0, 1.0)};
}

}  // namespace

Sky::Sky(const SunSkyParams& params) : sun_(params.sun_direction) {
  const std::array<double, 6> weights = bezier(std::cbrt(elevation_of(sun_) / (kPiD / 2)));
  const auto [turbidity, upper] = between(params.turbidity);
  for (int c = 0; c < 3; ++c) {
    std::fill(std::begin(coefficients_[c]), std::end(coefficients_[c]), 0.0);
    mean_[c] = 0;
    for (int albedo = 0; albedo < 2; ++albedo) {
      for (int t = 0; t < 2; ++t) {
        const double share = (albedo ? params.albedo[c] : 1 - params.albedo[c]) * (t ? upper : 1 - upper);
        for (int p = 0; p < 6; ++p) {
          for (int i = 0; i < 9; ++i)
            coefficients_[c][i] += share * weights[p] * sunsky::kSkyShape[c][albedo][turbidity + t][p][i];
          mean_[c] += share * weights[p] * sunsky::kSkyMean[c][albedo][turbidity + t][p];
        }
      }
    }
    mean_[c] *= sun_.z < 0 ? 0 : params.sky_scale * kLuminousScale;
  }
}

Rgb Sky::radiance(const Vec3d& d) const {  // [Hosek 2012, Eq. 8]
  if (d.z < 0) return {};
  const double cos_gamma = std::clamp(dot(d, sun_), -1.0, 1.0), gamma = std::acos(cos_gamma),
               cos_theta = std::min(d.z, 1.0);
  Rgb result;
  for (int c = 0; c < 3; ++c) {
    const double* const k = coefficients_[c];
    const double chi = (1 + cos_gamma * cos_gamma) / std::pow(1 + k[8] * k[8] - 2 * k[8] * cos_gamma, 1.5);
    const double value = (1 + k[0] * std::exp(k[1] / (cos_theta + 0.01))) *
                         (k[2] + k[3] * std::exp(k[4] * gamma) + k[5] * cos_gamma * cos_gamma + k[6] * chi +
                          k[7] * std::sqrt(cos_theta));
    result[c] = float(std::max(0.0, value * mean_[c]));
  }
  return result;
}

Rgb sun_irradiance(const SunSkyParams& params) {
  if (params.sun_direction.z <= 0) return {};
  const auto [turbidity, upper] = between(params.turbidity);
  const double x = std::cbrt(elevation_of(params.sun_direction) / (kPiD / 2)) * 45;
  const int k = std::min(int(x), 44);
  const double f = x - k;
  Rgb result;
  for (int c = 0; c < 3; ++c) {
    // Catmull-Rom in the elevation, linear in the turbidity.
    double p[4];
    for (int i = 0; i < 4; ++i) {
      const int node = std::clamp(k - 1 + i, 0, 45);
      p[i] = sunsky::kSun[turbidity][node][c] * (1 - upper) + sunsky::kSun[turbidity + 1][node][c] * upper;
    }
    const double value =
        p[1] +
        0.5 * f * (p[2] - p[0] + f * (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3] + f * (3 * (p[1] - p[2]) + p[3] - p[0])));
    result[c] = float(std::max(0.0, value * params.sun_scale));
  }
  return result;
}

Grid<Rgb> sun_sky_image(const SunSkyParams& params, int width) {
  const int height = width / 2;
  Grid<Rgb> image(width, height);
  const Sky sky(params);
  // Direction of image coordinates (pixels), z up.
  const auto direction = [&](double x, double y) {
    const double phi = 2 * kPiD * x / width, theta = kPiD * y / height;
    const double s = std::sin(theta);
    return Vec3d{s * std::sin(phi), s * std::cos(phi), std::cos(theta)};  // env (x, y, z) = model (x, z, -y)
  };
  if (params.sky_scale > 0) {
    parallel_rows(
        0, height / 2,
        [&](int y) {
          for (int x = 0; x < width; ++x) image.at(x, y) = sky.radiance(direction(x + 0.5, y + 0.5));
        },
        16);
  }

  const Rgb sun = sun_irradiance(params);
  if (is_black(sun)) return image;
  // Share of each pixel that the disc covers, by sub-pixels; rows near the pole are scanned all around.
  constexpr int kSub = 16;
  const double half = params.sun_aperture / 2 * (kPiD / 180), cos_half = std::cos(half);
  const double theta = std::acos(std::clamp(params.sun_direction.z, -1.0, 1.0));
  const auto row_at = [&](double angle, int margin) {
    return std::clamp(int(angle / kPiD * height) + margin, 0, height - 1);
  };
  const int first = row_at(theta - half, -1), last = row_at(theta + half, 1);
  std::vector<std::pair<std::size_t, double>> covered;  // pixel, share
  double solid_angle = 0;
  for (int y = first; y <= last; ++y) {
    const double row =
        2 * kPiD / width * (std::cos(kPiD * y / height) - std::cos(kPiD * (y + 1) / height));  // of a pixel
    for (int x = 0; x < width; ++x) {
      if (dot(direction(x + 0.5, y + 0.5), params.sun_direction) < std::cos(half + 2 * kPiD / width * 2)) continue;
      int hits = 0;
      for (int i = 0; i < kSub * kSub; ++i) {
        const Vec3d d = direction(x + (i % kSub + 0.5) / kSub, y + (i / kSub + 0.5) / kSub);
        hits += d.z >= 0 && dot(d, params.sun_direction) >= cos_half;
      }
      if (hits == 0) continue;
      const double share = double(hits) / (kSub * kSub);
      covered.emplace_back(image.index(x, y), share);
      solid_angle += share * row;
    }
  }
  if (covered.empty()) {  // a sun smaller than a sub-pixel
    const double phi = std::atan2(params.sun_direction.x, params.sun_direction.y);
    const int x = int((phi < 0 ? phi + 2 * kPiD : phi) / (2 * kPiD) * width) % width;
    const int y = row_at(theta, 0);
    covered.emplace_back(image.index(x, y), 1.0);
    solid_angle = 2 * kPiD / width * (std::cos(kPiD * y / height) - std::cos(kPiD * (y + 1) / height));
  }
  for (const auto& [pixel, share] : covered) image[pixel] += sun * float(share / solid_angle);
  return image;
}

SunAngles sun_position(const SunTime& time) {
  // Days since noon of 1 January 2000, universal time.
  const double hours = time.hour - time.timezone + (time.minute + time.second / 60) / 60;
  const int a = (time.month - 14) / 12;
  const int day = 1461 * (time.year + 4800 + a) / 4 + 367 * (time.month - 2 - 12 * a) / 12 -
                  3 * ((time.year + 4900 + a) / 100) / 4 + time.day - 32075;
  const double days = day - 0.5 + hours / 24 - 2451545;
  // Ecliptic coordinates.
  const double omega = 2.1429 - 0.0010394594 * days, anomaly = 6.2400600 + 0.0172019699 * days;
  const double longitude = 4.8950630 + 0.017202791698 * days + 0.03341607 * std::sin(anomaly) +
                           0.00034894 * std::sin(2 * anomaly) - 0.0001134 - 0.0000203 * std::sin(omega);
  const double obliquity = 0.4090928 - 6.2140e-9 * days + 0.0000396 * std::cos(omega);
  // Equatorial coordinates.
  const double right_ascension = std::atan2(std::cos(obliquity) * std::sin(longitude), std::cos(longitude));
  const double declination = std::asin(std::sin(obliquity) * std::sin(longitude));
  // Horizontal coordinates.
  const double sidereal = (6.6974243242 + 0.0657098283 * days + hours) * 15 + time.longitude;  // degrees
  const double hour_angle = sidereal * (kPiD / 180) - right_ascension, latitude = time.latitude * (kPiD / 180);
  double zenith = std::acos(std::cos(latitude) * std::cos(hour_angle) * std::cos(declination) +
                            std::sin(declination) * std::sin(latitude));
  const double azimuth = std::atan2(
      -std::sin(hour_angle), std::tan(declination) * std::cos(latitude) - std::sin(latitude) * std::cos(hour_angle));
  zenith += 6371.01 / 149597890 * std::sin(zenith);  // parallax
  return {zenith, azimuth};
}

}  // namespace tempera
