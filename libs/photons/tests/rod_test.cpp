// SPDX-License-Identifier: Apache-2.0
// A glass rod that turns about one of its ends under parallel light: the scene of Figures 7 and 8 of [Schjoth 2010], with
// irradiance computed apart.
#include <gtest/gtest.h>

#include <cmath>

#include "lit_ground.h"
#include "tempera/photons/photon_map.h"
#include "tempera/shading/fresnel.h"
#include "tempera/transport/frame_scene.h"

namespace tempera {
namespace {

constexpr double kRadius = 0.2, kLength = 2.4, kLevel = 0.4, kIndex = 1.5;
constexpr double kTurn = 5 * kPiD / 180;  // a frame, counterclockwise from above
constexpr double kCell = 0.01;
constexpr Vec2d kCorner{-0.2, -1.2};
constexpr int kColumns = 280, kRows = 240;

/// What passes the rod across its axis, or is reflected by its outside: relative irradiance on the ground over the distance
/// from the axis, in bins of a quarter of a cell from -kReach to kReach.
constexpr double kReach = 3, kBin = kCell / 4;
std::vector<double> profile() {
  constexpr int kRays = 2000000;
  std::vector<double> bins(std::size_t(2 * kReach / kBin));
  const auto refracted = [](const Vec2d& d, const Vec2d& n, double ratio) {
    const double ci = -dot(d, n), ct = std::sqrt(1 - ratio * ratio * (1 - ci * ci));
    return d * ratio + n * (ratio * ci - ct);
  };
  for (int i = 0; i < kRays; ++i) {
    const double c = kRadius * (2 * (i + 0.5) / kRays - 1);
    const Vec2d entry{c, std::sqrt(sqr(kRadius) - c * c)}, n = entry * (1 / kRadius);
    const Vec2d inside = refracted({0, -1}, n, 1 / kIndex);
    const Vec2d exit = entry - inside * (2 * dot(entry, inside));
    const auto arrive = [&](const Vec2d& from, const Vec2d& d, double part) {
      if (!(d.y < 0)) return;
      const auto bin = std::int64_t(std::floor((from.x - d.x / d.y * (kLevel + from.y) + kReach) / kBin));
      if (bin >= 0 && bin < std::int64_t(bins.size())) bins[bin] += part * 2 * kRadius / kRays / kBin;
    };
    const double reflected = double(dielectric_interface(float(n.y), float(kIndex)).reflectance);
    // The angles within are the same at both surfaces, and so is what they reflect.
    arrive(exit, refracted(inside, exit * (-1 / kRadius), kIndex), sqr(1 - reflected));
    arrive(entry, Vec2d{0, -1} + n * (2 * n.y), reflected);
  }
  return bins;
}

/// Relative irradiance on the ground, mean over the exposure [begin, end] in frames.
std::vector<double> reference(double begin, double end) {
  constexpr int kTimes = 60, kSide = 4;
  const std::vector<double> across = profile();
  std::vector<double> cells(std::size_t(kColumns) * kRows);
  for (int k = 0; k < kTimes; ++k) {
    const double angle = kTurn * (begin + (end - begin) * (k + 0.5) / kTimes);
    const Vec2d along{std::cos(angle), std::sin(angle)};
    for (int j = 0; j < kRows * kSide; ++j) {
      for (int i = 0; i < kColumns * kSide; ++i) {
        const Vec2d p = kCorner + Vec2d{(i + 0.5) / kSide, (j + 0.5) / kSide} * kCell;
        const double s = dot(p, along), c = p.y * along.x - p.x * along.y;
        if (!(s > 0 && s < kLength)) continue;
        cells[std::size_t(j / kSide) * kColumns + i / kSide] +=
            across[std::size_t((c + kReach) / kBin)] / (sqr(kSide) * kTimes);
      }
    }
  }
  return cells;
}

/// The rod along x, without ends: light from straight above passes none.
Mesh rod_mesh() {
  Mesh m;
  constexpr int kAround = 128, kAlong = 48;
  for (int i = 0; i <= kAlong; ++i) {
    for (int j = 0; j <= kAround; ++j) {
      const double a = 2 * kPiD * j / kAround;
      const Vec3d n{0, std::cos(a), std::sin(a)};
      m.positions.push_back(Vec3f(Vec3d{kLength * i / kAlong, 0, 0} + n * kRadius));
      m.normals.push_back(Vec3f(n));
    }
  }
  constexpr std::uint32_t kRing = kAround + 1;
  for (std::uint32_t i = 0; i < kAlong; ++i) {
    for (std::uint32_t j = 0; j < kAround; ++j) {
      const std::uint32_t v = i * kRing + j;
      for (const std::uint32_t c : {v, v + kRing + 1, v + 1, v, v + kRing, v + kRing + 1}) m.indices.push_back(c);
    }
  }
  return m;
}

Scene rod_scene() {
  AnimatedTransform motion;
  motion.keyed = true;
  motion.translation = {Vec3d{0, 0, kLevel}};
  motion.rotation = {
      {-4, 4}, {axis_angle(Vec3d{0, 0, 1}, -4 * kTurn), axis_angle(Vec3d{0, 0, 1}, 4 * kTurn)}, Interpolation::kLinear};
  // Pixels are as large as cells.
  return test::lit_ground(rod_mesh(), kIndex, motion, 1, float(kColumns * kCell), 4);
}

/// Sum of |E - reference| over that of the reference: irradiance on the ground over one frame by 5000 photons that
/// arrive there.
double measure(PhotonInstant instant, PhotonGauge gauge, double overlap) {
  const Scene scene = rod_scene();
  RenderSettings settings;
  settings.width = kColumns, settings.height = kRows;
  settings.clock.fps = 1;
  settings.clock.shutter = {.open = -1, .close = 0};
  GeometryCache cache;
  const LightPathClassifier classifier({kPhotonPaths});
  const FrameScene frame(scene, settings, classifier, 0, 1.0 / 16, cache);
  PhotonOptions options;
  options.overlap = overlap;
  options.gauge = gauge;
  options.instant = instant;
  const TimeSpan span = settings.clock.exposure(0);
  // Light is sent to the box in which the rod turns, but for a tenth.
  const double box = kLength * (2 * kRadius + kLength * std::sin(kTurn)), rod = kLength * 2 * kRadius;
  constexpr int kEdges = 4;  // light, rod, rod, ground, eye: no light that is reflected within
  const PhotonTracer tracer(frame.context(), options, span, 0, std::int64_t(4350 * box / rod), kEdges);
  std::vector<Photon> stored;
  PhotonCounts counts;
  std::uint64_t rays = 0;
  for (std::int64_t i = 0; i < tracer.photons(); ++i) tracer.trace(i, stored, counts, rays);
  if (overlap > 0) EXPECT_NEAR(double(counts.stored), 5000, 250);  // else strongly bent beams are divided
  const PhotonMap map(tracer, std::move(stored), classifier, frame.context().rays, false);

  static const std::vector<double> expected = reference(-1, 0);
  double error = 0, total = 0, sum = 0;
  Vertex v;
  v.hit.point.instance = v.hit.point.shape = 1;
  v.s.ng = {0, 0, 1};
  std::vector<GatheredLight::Arrival> arrivals;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      double e = 0;
      for (int k = 0; k < 4; ++k) {
        const Vec2d p = kCorner + Vec2d{i + 0.25 + 0.5 * (k & 1), j + 0.25 + 0.5 * (k >> 1)} * kCell;
        v.s.p = Vec3f(Vec3d{p.x, p.y, 0});
        map.gather(v, 0.5 * (span.begin + span.end), -1, false, 100, arrivals);
        for (const auto& a : arrivals) e += double(a.irradiance.g) / 4;
      }
      const double there = expected[std::size_t(j) * kColumns + i];
      error += std::abs(e - there);
      sum += e, total += there;
    }
  }
  EXPECT_NEAR(sum / total, 1, 0.02);
  return error / total;
}

// Errors of a prototype without Fresnel and with jittered photons, which ours, better spread, do not exceed.
TEST(Rod, ErrorsOfFiveThousandPhotons) {
  const auto trailing = PhotonInstant::kClose, middle = PhotonInstant::kMiddle;
  const auto emission = PhotonGauge::kEmission, matter = PhotonGauge::kMatter;
  struct Row {
    PhotonInstant instant;
    PhotonGauge gauge;
    double overlap, error;
  };
  for (const Row& row :
       {Row{trailing, emission, 4, 0.41}, Row{middle, emission, 4, 0.16}, Row{middle, emission, 9, 0.14},
        Row{trailing, matter, 4, 0.13}, Row{trailing, matter, 9, 0.094}, Row{middle, matter, 4, 0.13},
        Row{middle, matter, 9, 0.091}}) {
    EXPECT_LT(measure(row.instant, row.gauge, row.overlap), 1.1 * row.error) << "overlap " << row.overlap;
  }
}

// Half of the light that is sent to the box of the rod misses it, and does not make footprints wider.
TEST(Rod, DefaultOverlapCountsPhotonsThatMeetIt) {
  EXPECT_LT(measure(PhotonInstant::kMiddle, PhotonGauge::kMatter, 0), 0.12);
}

}  // namespace
}  // namespace tempera
