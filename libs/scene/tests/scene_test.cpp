// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/scene.h"

#include <gtest/gtest.h>

#include "tempera/core/error.h"
#include "tempera/scene/default_view.h"
#include "tempera/scene/deform.h"

namespace tempera {
namespace {

Scene one_cube() {
  Scene s;
  s.nodes.push_back({-1, AnimatedTransform(translate(Vec3d{1, 2, 3})), "root", 1.0f});
  s.nodes.push_back({0, AnimatedTransform(scale(Vec3d{2, 2, 2})), "child", 1.0f});
  s.shapes.push_back({make_cube(), make_diffuse(), std::nullopt, "cube", ""});
  s.groups = {{0}};
  s.instances = {{0, 1, "cube", true}};
  return s;
}

TEST(Scene, WorldAppliesParentsAfterChildren) {
  const Scene s = one_cube();
  EXPECT_EQ(s.world(1, 0).point({1, 0, 0}), (Vec3d{3, 2, 3}));
  EXPECT_EQ(s.world(-1, 0), Affine3d{});
}

TEST(Scene, ValidateFindsEachFault) {
  validate(one_cube());
  const auto fault = [](auto&& spoil) {
    Scene s = one_cube();
    spoil(s, std::get<Mesh>(s.shapes[0].geometry));
    try {
      validate(s);
      return std::string();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      return std::string(e.what());
    }
  };
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.indices[5] = 24; }), "");
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.indices.pop_back(); }), "");
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.positions[2].y = NAN; }), "");
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.normals.resize(3); }), "");
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.morph_targets.resize(1); }), "");
  EXPECT_NE(fault([](Scene&, Mesh& m) { m.skin.joints.push_back({0, {}}); }), "");
  EXPECT_NE(fault([](Scene& s, Mesh&) { s.nodes[0].parent = 1; }), "");
  EXPECT_NE(fault([](Scene& s, Mesh&) { s.instances[0].group = 1; }), "");
  EXPECT_NE(fault([](Scene& s, Mesh&) { s.instances[0].node = 7; }), "");
  EXPECT_NE(fault([](Scene& s, Mesh&) { s.shapes[0].material = nullptr; }), "");
  EXPECT_NE(fault([](Scene& s, Mesh&) { s.groups[0] = {4}; }), "");
}

TEST(Geometry, CubeFacesPointOutwards) {
  const Mesh m = make_cube();
  ASSERT_EQ(m.triangle_count(), 12u);
  for (std::size_t i = 0; i < m.indices.size(); i += 3) {
    const Vec3f a = m.positions[m.indices[i]], b = m.positions[m.indices[i + 1]], c = m.positions[m.indices[i + 2]];
    EXPECT_GT(dot(cross(b - a, c - a), a + b + c), 0);
  }
}

TEST(Geometry, MirroringKeepsTheFrontInFront) {
  Mesh m = make_cube();
  transform(m, scale(Vec3d{-1, 1, 2}));
  for (std::size_t i = 0; i < m.indices.size(); i += 3) {
    const Vec3f a = m.positions[m.indices[i]], b = m.positions[m.indices[i + 1]], c = m.positions[m.indices[i + 2]];
    EXPECT_GT(dot(cross(b - a, c - a), a + b + c), 0);
  }
}

TEST(Deform, SkinFollowsItsJointsWhateverItsOwnNode) {
  Scene s = one_cube();
  AnimatedTransform joint;
  joint.keyed = true;
  joint.translation = {{0, 1}, {Vec3d{0, 0, 0}, Vec3d{0, 5, 0}}, Interpolation::kLinear};
  s.nodes.push_back({-1, joint, "joint", 1.0f});
  Mesh& m = std::get<Mesh>(s.shapes[0].geometry);
  m.skin.influences = 1;
  m.skin.joints = {{2, translate(Vec3d{0, -1, 0})}};
  m.skin.indices.assign(m.positions.size(), 0);
  m.skin.weights.assign(m.positions.size(), 1);
  validate(s);
  const MeshPose pose = mesh_pose(s, m, 1, 0.5);
  for (std::uint32_t v = 0; v < m.positions.size(); ++v) {
    EXPECT_LT(length(posed_position(m, pose, v) - (m.positions[v] + Vec3f{0, 1.5f, 0})), 1e-5f);
  }
}

TEST(Deform, CacheInterpolatesBetweenItsSamples) {
  Scene s = one_cube();
  Mesh& m = std::get<Mesh>(s.shapes[0].geometry);
  const std::vector<double> times{0, 1, 3};
  std::vector<Vec3f> positions;
  for (const double t : times) {
    for (const Vec3f& p : m.positions) positions.push_back(p + Vec3f{float(t), 0, 0});
  }
  bind_cache(m, {.samples = std::make_shared<VertexCache>(times, m.positions.size(), positions)});
  for (const double t : {-1.0, 0.25, 1.0, 2.5, 9.0}) {
    const MeshPose pose = mesh_pose(s, m, -1, t);
    EXPECT_NEAR(posed_position(m, pose, 3).x - m.positions[3].x, std::clamp(t, 0.0, 3.0), 1e-6) << t;
  }
}

TEST(DefaultView, FramesTheWholeAnimationAndLightsIt) {
  Scene s = one_cube();
  EXPECT_FALSE(has_light(s));
  add_default_camera(s);
  add_default_light(s);
  validate(s);
  EXPECT_TRUE(has_light(s));
  const Bounds3f b = world_bounds(s, 0);
  EXPECT_EQ(b.lo, (Vec3f{-1, 0, 1}));
  const Affine3d camera = s.world(s.cameras[0].node, 0);
  for (int i = 0; i < 8; ++i) {  // every corner is inside the vertical angle of view
    const Vec3d corner{i & 1 ? b.lo.x : b.hi.x, i & 2 ? b.lo.y : b.hi.y, i & 4 ? b.lo.z : b.hi.z};
    const Vec3d local = inverse(camera).point(corner);
    EXPECT_GT(local.z, 0);
    EXPECT_LT(std::hypot(local.x, local.y) / local.z, std::tan(0.35));
  }
}

}  // namespace
}  // namespace tempera
