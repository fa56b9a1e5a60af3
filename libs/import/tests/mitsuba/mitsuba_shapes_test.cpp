// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_test_util.h"

namespace tempera {
namespace {

TEST(MitsubaShapes, StepsOfATransformApplyInOrder) {
  Folder folder;
  const Scene s = folder.load(R"(<shape type="disk"><transform name="to_world">
    <scale value="2"/><rotate y="1" angle="90"/><translate x="1" z="5"/><matrix value="0 -1 0  1 0 0  0 0 1"/></transform></shape>)");
  EXPECT_EQ(std::get<AnalyticShape>(s.shapes[0].geometry).kind, AnalyticKind::kDisk);
  const Affine3f m = std::get<AnalyticShape>(s.shapes[0].geometry).object_from_unit;
  // x (1,0,0) -> (2,0,0) -> (0,0,-2) -> (1,0,3) -> (0,1,3)
  expect_near(m.point({1, 0, 0}), {0, 1, 3});
  expect_near(m.point({0, 0, 1}), {0, 3, 5});
  EXPECT_EQ(s.instances[0].node, -1);
}

TEST(MitsubaShapes, AnalyticShapes) {
  Folder folder;
  const Scene s = folder.load(R"(
    <shape type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="2"/>
      <transform name="to_world"><scale x="1" y="3" z="1"/></transform></shape>
    <shape type="cylinder"><point name="p0" value="0 1 0"/><point name="p1" value="0 5 0"/><float name="radius" value="0.5"/><boolean name="flip_normals" value="true"/></shape>
    <shape type="sphere"><transform name="to_world"><scale x="-1"/></transform></shape>
    <shape type="sphere"><boolean name="flip_normals" value="true"/><transform name="to_world"><scale x="-1"/></transform></shape>)");
  const Affine3f m = std::get<AnalyticShape>(s.shapes[0].geometry).object_from_unit;
  expect_near(m.point({0, 0, 0}), {1, 6, 3});
  expect_near(m.point({0, 1, 0}), {1, 12, 3});
  EXPECT_EQ(std::get<AnalyticShape>(s.shapes[0].geometry).kind, AnalyticKind::kSphere);
  const auto& c = std::get<AnalyticShape>(s.shapes[1].geometry);
  EXPECT_EQ(c.kind, AnalyticKind::kCylinder);
  expect_near(c.object_from_unit.point({0, 0, 0}), {0, 1, 0});
  expect_near(c.object_from_unit.point({0, 0, 1}), {0, 5, 0});
  EXPECT_NEAR(length(c.object_from_unit.vector({0.6f, 0.8f, 0})), 0.5f, 1e-6f);
  EXPECT_TRUE(c.flip_normals);
  // A mirrored sphere is inside out, as in Mitsuba 3.
  EXPECT_TRUE(std::get<AnalyticShape>(s.shapes[2].geometry).flip_normals);
  EXPECT_FALSE(std::get<AnalyticShape>(s.shapes[3].geometry).flip_normals);
}

TEST(MitsubaShapes, CubeHasMitsubasTextureCoordinates) {
  Folder folder;
  const Mesh m = mesh_of(folder.load("<shape type=\"cube\"/>"));
  ASSERT_EQ(m.triangle_count(), 12u);
  // Read off Mitsuba 3: u, v at points of the faces.
  const struct {
    Vec3f p, n;
    Vec2f uv;
  } expected[] = {
      {{1, -1, -1}, {0, -1, 0}, {0, 1}}, {{-1, -1, 1}, {0, -1, 0}, {1, 0}}, {{1, 1, -1}, {0, 1, 0}, {0, 1}},
      {{-1, 1, -1}, {0, 1, 0}, {1, 1}},  {{1, 1, 1}, {1, 0, 0}, {1, 0}},    {{1, -1, -1}, {1, 0, 0}, {0, 1}},
      {{1, -1, 1}, {0, 0, 1}, {0, 1}},   {{-1, 1, 1}, {0, 0, 1}, {1, 0}},   {{-1, -1, 1}, {-1, 0, 0}, {0, 1}},
      {{-1, 1, -1}, {-1, 0, 0}, {1, 0}}, {{1, 1, -1}, {0, 0, -1}, {0, 1}},  {{-1, -1, -1}, {0, 0, -1}, {1, 0}}};
  for (const auto& e : expected) {
    bool found = false;
    for (std::size_t t = 0; t < 12; ++t) {
      const Vec3f a = m.positions[m.indices[3 * t]], b = m.positions[m.indices[3 * t + 1]],
                  c = m.positions[m.indices[3 * t + 2]];
      if (dot(normalize(cross(b - a, c - a)), e.n) < 0.99f) continue;
      for (std::size_t i = 0; i < 3; ++i)
        if (m.positions[m.indices[3 * t + i]] == e.p) {
          found = true;
          EXPECT_EQ(m.uvs[m.indices[3 * t + i]], e.uv);
        }
    }
    EXPECT_TRUE(found) << e.p.x << e.p.y << e.p.z;
  }
}

TEST(MitsubaShapes, MeshFilesAreBakedAndSmoothed) {
  Folder folder;
  folder.write("tri.obj", kTriangleObj);
  folder.write(
      "tri.ply",
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float "
      "u\nproperty float v\n"
      "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n");
  const Scene s = folder.load(R"(
    <shape type="obj" id="a"><string name="filename" value="tri.obj"/><transform name="to_world"><scale value="2"/><translate z="3"/></transform></shape>
    <shape type="ply"><string name="filename" value="tri.ply"/></shape>
    <shape type="obj"><string name="filename" value="tri.obj"/><boolean name="flip_tex_coords" value="false"/><transform name="to_world"><scale z="-1"/></transform></shape>
    <shape type="obj"><string name="filename" value=".\tri.obj"/><float name="max_smooth_angle" value="30"/></shape>)");
  EXPECT_EQ(s.shapes[0].name, "a");
  EXPECT_EQ(s.shapes[1].name, "tri");
  EXPECT_EQ(s.shapes[2].name, "tri_1");  // names stay unique
  expect_near(bounds_of(mesh_of(s, 0)).hi, {2, 2, 3});
  EXPECT_EQ(mesh_of(s, 0).normals[0], (Vec3f{0, 0, 1}));
  // OBJ counts v from the bottom, Mitsuba from the top; PLY is taken as it is.
  EXPECT_EQ(mesh_of(s, 0).uvs[2], (Vec2f{0, 0}));
  EXPECT_EQ(mesh_of(s, 1).uvs[2], (Vec2f{0, 1}));
  EXPECT_EQ(mesh_of(s, 2).uvs[2], (Vec2f{0, 1}));
  // Normals that Mitsuba makes up follow the winding in world space.
  EXPECT_EQ(mesh_of(s, 2).normals[0], (Vec3f{0, 0, 1}));
  for (const Shape& shape : s.shapes) EXPECT_FALSE(shape.emission);
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaShapes, OwnNormalsDecideTheFrontOfMirroredMeshes) {
  Folder folder;
  folder.write("tri.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n");
  const Mesh m =
      mesh_of(folder.load("<shape type=\"obj\"><string name=\"filename\" value=\"tri.obj\"/><transform "
                          "name=\"to_world\"><scale value=\"-2\"/></transform></shape>"));
  EXPECT_EQ(m.normals[0], (Vec3f{0, 0, -1}));
  const Vec3f p = m.positions[m.indices[0]];
  EXPECT_LT(cross(m.positions[m.indices[1]] - p, m.positions[m.indices[2]] - p).z, 0);
}

TEST(MitsubaShapes, AnimatedTransformsBecomeKeys) {
  Folder folder;
  folder.write("tri.obj", kTriangleObj);
  const Scene s = folder.load(R"(
    <shape type="obj"><string name="filename" value="tri.obj"/><animation name="toWorld">
      <transform time="0.5"><scale value="2"/><rotate z="1" angle="0"/><translate x="1"/></transform>
      <transform time="1.5"><scale value="4"/><rotate z="1" angle="90"/><translate x="3"/></transform></animation></shape>
    <sensor type="perspective"><animation name="to_world"><transform time="-1"><lookat origin="0 0 1" target="0 0 0" up="0 1 0"/></transform>
      <transform time="1"><lookat origin="0 0 3" target="0 0 0" up="0 1 0"/></transform></animation>
      <float name="shutter_open" value="0.25"/><float name="shutter_close" value="0.75"/></sensor>)",
                              {}, "0.5.0");
  ASSERT_GE(s.instances[0].node, 0);
  EXPECT_EQ(s.animation, (TimeSpan{-1, 1.5}));
  EXPECT_EQ(s.defaults.exposure, (TimeSpan{0.25, 0.75}));
  EXPECT_EQ(bounds_of(mesh_of(s)).hi, (Vec3f{1, 1, 0}));  // not baked
  const Affine3d half = s.world(s.instances[0].node, 1.0);
  expect_near(half.translation, {2, 0, 0});
  expect_near(half.vector({1, 0, 0}), Vec3d{1, 1, 0} * (3 / std::sqrt(2)));
  expect_near(s.world(s.instances[0].node, -9).vector({1, 0, 0}), {2, 0, 0});  // held before the first key
  expect_near(s.world(s.cameras[0].node, 0).translation, {0, 0, 2});
  expect_near(s.world(s.cameras[0].node, 0).z, {0, 0, -1});
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaShapes, InstancesShareTheirGroup) {
  Folder folder;
  const Scene s = folder.load(R"(
    <shape type="instance" id="first"><ref id="g"/></shape>
    <shape type="shapegroup" id="g">
      <shape type="sphere"><transform name="to_world"><translate x="1"/></transform></shape>
      <shape type="cube"/></shape>
    <shape type="instance"><ref id="g"/><animation name="to_world"><transform time="0"/><transform time="1"><translate y="2"/></transform></animation></shape>
    <shape type="instance"><ref id="g"/><transform name="to_world"><translate z="7"/></transform></shape>)");
  ASSERT_EQ(s.groups.size(), 1u);
  EXPECT_EQ(s.groups[0].size(), 2u);
  ASSERT_EQ(s.instances.size(), 3u);
  EXPECT_EQ(s.shapes.size(), 2u);
  EXPECT_EQ(s.instances[0].node, -1);
  EXPECT_EQ(s.instances[0].name, "first");
  expect_near(s.world(s.instances[1].node, 0.5).translation, {0, 1, 0});
  expect_near(s.world(s.instances[2].node, 0).translation, {0, 0, 7});
  EXPECT_FALSE(s.moves(s.instances[2].node, {0, 1}));
  EXPECT_EQ(std::get<AnalyticShape>(s.shapes[0].geometry).object_from_unit.translation.x, 1);
}

}  // namespace
}  // namespace tempera
