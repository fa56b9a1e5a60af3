// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/motion_error.h"

#include <array>

#include "motion.h"
#include "tempera/core/parallel.h"
#include "tempera/scene/deform.h"

namespace tempera {

namespace {

/// Places within a segment that no regular motion can hit all at once.
constexpr std::array<double, 3> kTestedAt{0.31, 0.5, 0.77};

/// Some points of a rigid group in its own space.
std::vector<Vec3f> some_points(const Scene& scene, const std::vector<int>& group) {
  constexpr std::size_t kVerticesPerMesh = 32;
  std::vector<Vec3f> points;
  for (const int shape : group) {
    const Geometry& geometry = scene.shapes[shape].geometry;
    if (const auto* mesh = std::get_if<Mesh>(&geometry)) {
      if (mesh->deforms()) continue;
      const std::size_t stride = std::max<std::size_t>(1, mesh->positions.size() / kVerticesPerMesh);
      for (std::size_t v = 0; v < mesh->positions.size(); v += stride) points.push_back(mesh->positions[v]);
    } else {
      const Affine3f m = object_from_unit(geometry);
      for (int i = 0; i < 8; ++i)
        points.push_back(m.point({i & 1 ? 1.0f : -1.0f, i & 2 ? 1.0f : -1.0f, i & 4 ? 1.0f : -1.0f}));
    }
  }
  return points;
}

/// Times to test between the knots of an exposure, with the knots before and after.
struct Test {
  std::size_t knot;
  float blend;
  double time, piece;
};
std::vector<Test> tests_of(const MotionPieces& pieces, TimeSpan exposure) {
  std::vector<Test> tests;
  const auto& knots = pieces.knots();
  for (std::size_t k = 0; k + 1 < knots.size(); ++k) {
    if (knots[k].piece != knots[k + 1].piece) continue;
    for (const double s : kTestedAt) {
      const double t = knots[k].time + s * (knots[k + 1].time - knots[k].time);
      if (exposure.contains(t)) tests.push_back({k, float(s), t, knots[k].piece});
    }
  }
  return tests;
}

}  // namespace

std::vector<double> motion_errors(const Scene& scene, std::span<const TimeSpan> exposures, double motion_step,
                                  const MotionDistance& distance) {
  std::vector<std::vector<Vec3f>> points(scene.groups.size());
  for (std::size_t g = 0; g < points.size(); ++g) points[g] = some_points(scene, scene.groups[g]);
  std::vector<double> errors(exposures.size(), 0);
  parallel_for(0, std::int64_t(exposures.size()), [&](std::int64_t index) {
    const TimeSpan exposure = exposures[index];
    if (!(exposure.length() > 0)) return;
    double& error = errors[index];
    const auto note = [&](const Vec3f& authored, const Vec3f& resampled, double t) {
      const double d = distance(authored, resampled, t);
      if (d > error) error = d;  // false for what is no number
    };
    std::vector<double> jumps;
    for (const Instance& instance : scene.instances) {
      if (!scene.visible(instance.node, exposure.begin) && !scene.visible(instance.node, exposure.end)) continue;
      const auto& group = scene.groups[instance.group];
      jumps.clear();
      scene.jumps(instance.node, exposure, jumps);
      const TimeSpan first{exposure.begin, exposure.begin};
      const MotionPieces pieces(MotionGrid{motion_step}, exposure, jumps, first);
      const auto& knots = pieces.knots();
      const TimeSpan span{knots.front().time, knots.back().time};
      if (scene.moves(instance.node, span) && !points[instance.group].empty()) {
        std::vector<Affine3d> worlds;
        worlds.reserve(knots.size());
        for (const auto& k : knots) worlds.push_back(scene.world(instance.node, k.time, k.piece));
        const std::vector<AffineKnot> motion = decompose(worlds);
        const bool rigid = is_invertible(motion);
        for (const Test& test : tests_of(pieces, exposure)) {
          const Affine3f authored(scene.world(instance.node, test.time, test.piece));
          const AffineKnot &a = motion[test.knot], &b = motion[test.knot + 1];
          const Affine3f resampled = interpolate(a, b, test.blend), from = compose(a), to = compose(b);
          for (const Vec3f& p : points[instance.group]) {
            note(authored.point(p), rigid ? resampled.point(p) : lerp(from.point(p), to.point(p), test.blend),
                 test.time);
          }
        }
      }
      for (const int shape : group) {
        const auto* mesh = std::get_if<Mesh>(&scene.shapes[shape].geometry);
        if (!mesh || !mesh->deforms()) continue;
        std::vector<double> all;
        mesh_jumps(scene, *mesh, instance.node, exposure, all);
        const MotionPieces own(MotionGrid{motion_step}, exposure, all, first);
        std::vector<MeshPose> poses;
        for (const auto& k : own.knots()) poses.push_back(mesh_pose(scene, *mesh, instance.node, k.time, k.piece));
        constexpr std::size_t kVertices = 64;
        const std::size_t stride = std::max<std::size_t>(1, mesh->positions.size() / kVertices);
        for (const Test& test : tests_of(own, exposure)) {
          const MeshPose pose = mesh_pose(scene, *mesh, instance.node, test.time, test.piece);
          for (std::size_t i = 0; i < mesh->positions.size(); i += stride) {
            const auto v = std::uint32_t(i);
            note(posed_position(*mesh, pose, v),
                 lerp(posed_position(*mesh, poses[test.knot], v), posed_position(*mesh, poses[test.knot + 1], v),
                      test.blend),
                 test.time);
          }
        }
      }
    }
  });
  return errors;
}

}  // namespace tempera
