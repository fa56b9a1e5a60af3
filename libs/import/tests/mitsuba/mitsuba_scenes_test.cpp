// SPDX-License-Identifier: Apache-2.0
#include <set>

#include "mitsuba_test_util.h"

namespace tempera {
namespace {

TEST(MitsubaSensors, FieldOfViewAlongAnyAxis) {
  Folder folder;
  const auto fov = [&](const std::string& inner, int width = 200, int height = 100) {
    const Scene s =
        folder.load(fmt::format("<sensor type=\"perspective\">{}<film type=\"hdrfilm\"><integer name=\"width\" "
                                "value=\"{}\"/><integer name=\"height\" value=\"{}\"/></film></sensor>",
                                inner, width, height));
    EXPECT_TRUE(folder.warnings.empty());
    return s.cameras.at(0);
  };
  const auto degrees = [](const Camera& c) { return c.fov_x.at(0) * 180 / kPi; };
  const std::string half = R"(<float name="fov" value="60"/>)";
  EXPECT_NEAR(degrees(fov(half)), 60, 1e-4);
  EXPECT_FALSE(fov(half).keep_vertical_fov);
  const double wide = 2 * std::atan(2 * std::tan(30 * kPiD / 180)) * 180 / kPiD;
  EXPECT_NEAR(degrees(fov(half + R"(<string name="fov_axis" value="y"/>)")), wide, 1e-4);
  EXPECT_TRUE(fov(half + R"(<string name="fov_axis" value="y"/>)").keep_vertical_fov);
  EXPECT_NEAR(degrees(fov(half + R"(<string name="fov_axis" value="smaller"/>)")), wide, 1e-4);
  EXPECT_NEAR(degrees(fov(half + R"(<string name="fov_axis" value="larger"/>)")), 60, 1e-4);
  EXPECT_NEAR(degrees(fov(half + R"(<string name="fov_axis" value="smaller"/>)", 100, 200)), 60, 1e-4);
  // x^2 + (x/2)^2 = tan(30)^2
  EXPECT_NEAR(degrees(fov(half + R"(<string name="fov_axis" value="diagonal"/>)")),
              2 * std::atan(std::tan(kPiD / 6) / std::sqrt(1.25)) * 180 / kPiD, 1e-4);
  // Mitsuba 3's default of 50 mm on 3:2 film.
  EXPECT_NEAR(degrees(fov("", 300, 200)), 2 * std::atan(36 / 100.0) * 180 / kPiD, 1e-3);
  EXPECT_NEAR(degrees(fov(R"(<string name="focal_length" value="18mm"/>)", 300, 200)), 90, 1e-3);
  EXPECT_NEAR(fov("", 300, 200).authored_aspect, 1.5, 1e-6);
}

TEST(MitsubaSensors, FilmsAndFilters) {
  Folder folder;
  const auto defaults = [&](const std::string& film) {
    return folder.load("<sensor type=\"perspective\">" + film + "</sensor>").defaults;
  };
  const RenderDefaults d =
      defaults(R"(<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="32"/>
    <integer name="crop_offset_x" value="8"/><integer name="crop_offset_y" value="4"/><integer name="crop_width" value="16"/><integer name="crop_height" value="10"/>
    <rfilter type="gaussian"><float name="stddev" value="0.75"/></rfilter></film>)");
  EXPECT_EQ(d.crop_x, 8);
  EXPECT_EQ(d.crop_y, 4);
  EXPECT_EQ(d.crop_width, 16);
  EXPECT_EQ(d.crop_height, 10);
  EXPECT_EQ(d.filter, "gaussian");
  EXPECT_EQ(d.filter_radius, 3);
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"/>").filter_radius, 2);
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"/>").width, 768);
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"/>").crop_width, 0);
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"><rfilter type=\"box\"/></film>").filter, "box");
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"><rfilter type=\"tent\"/></film>").filter_radius, 1);
  EXPECT_EQ(defaults("<film type=\"hdrfilm\"><rfilter type=\"mitchell\"/></film>").filter, "mitchell");
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaSensors, OrthographicScaleIsThePicturesSize) {
  Folder folder;
  const Scene s = folder.load(
      R"(<sensor type="orthographic" id="plan"><transform name="to_world"><scale x="1.5" y="1.5"/><lookat target="0, 0, 1" origin="-5, 0, 3" up="0, 0, 1"/></transform>
    <vector name="unused" value="1"/></sensor><sensor type="perspective"><float name="principal_point_offset_x" value="0.25"/><float name="principal_point_offset_y" value="-0.1"/></sensor>)");
  ASSERT_EQ(s.cameras.size(), 2u);
  EXPECT_EQ(s.cameras[0].projection, Projection::kOrthographic);
  EXPECT_EQ(s.cameras[0].name, "plan");
  EXPECT_NEAR(s.cameras[0].width.at(0), 3, 1e-5);
  const Affine3d m = s.world(s.cameras[0].node, 0);
  expect_near(m.translation, {-5, 0, 3});
  expect_near(m.z, normalize(Vec3d{5, 0, -2}));
  EXPECT_NEAR(length(m.x), 1, 1e-9);
  // Mitsuba: the axis stands 0.25 left of the middle and 0.1 below it.
  EXPECT_EQ(s.cameras[1].principal_offset, (Vec2f{-0.25f, 0.1f}));
}

TEST(MitsubaSensors, Integrators) {
  Folder folder;
  const auto defaults = [&](const std::string& integrator) { return folder.load(integrator).defaults; };
  EXPECT_EQ(defaults("<integrator type=\"path\"/>").max_depth, -1);
  EXPECT_EQ(defaults("<integrator type=\"path\"/>").rr_depth, 5);
  EXPECT_EQ(defaults("<integrator type=\"direct\"/>").max_depth, 2);
  EXPECT_FALSE(defaults("<integrator type=\"volpath\"/>").null_counts_as_bounce);
  const RenderDefaults nested =
      defaults(R"(<integrator type="moment"><integrator type="aov"><string name="aovs" value="dd:depth"/>
    <integrator type="path"><integer name="max_depth" value="9"/></integrator></integrator></integrator>)");
  EXPECT_EQ(nested.max_depth, 9);
  EXPECT_EQ(nested.integrator, "path");
  EXPECT_FALSE(defaults("").max_depth.has_value());
  EXPECT_TRUE(folder.warnings.empty());
}

struct Published {
  const char* file;
  std::size_t shapes, triangles, materials, emitting, lights, environments;
  int warnings;  // kinds of things that we lack
};

class PublishedScenes : public testing::TestWithParam<Published> {};

TEST_P(PublishedScenes, ImportWithTheirParts) {
  const Published& p = GetParam();
  const fs::path file = shared_scenes() / p.file;
  if (!fs::exists(file)) GTEST_SKIP() << file << " is not here";
  Warnings warnings;
  const Scene s = import_scene(file, {}, warnings);
  std::size_t triangles = 0, emitting = 0, shapes = 0;
  std::set<const Material*> materials;
  for (const Instance& i : s.instances) {
    for (const int index : s.groups[i.group]) {
      const Shape& shape = s.shapes[index];
      ++shapes;
      if (const auto* m = std::get_if<Mesh>(&shape.geometry)) triangles += m->triangle_count();
      materials.insert(shape.material.get());
      emitting += shape.emission.has_value();
    }
  }
  EXPECT_EQ(shapes, p.shapes);
  EXPECT_EQ(triangles, p.triangles);
  EXPECT_EQ(materials.size(), p.materials);
  EXPECT_EQ(emitting, p.emitting);
  EXPECT_EQ(s.lights.size(), p.lights);
  EXPECT_EQ(s.environments.size(), p.environments);
  EXPECT_EQ(s.cameras.size(), 1u);
  EXPECT_EQ(warnings.empty(), p.warnings == 0);
  EXPECT_TRUE(s.defaults.spp && s.defaults.width && s.defaults.max_depth);
}

INSTANTIATE_TEST_SUITE_P(
    Shared, PublishedScenes,
    testing::Values(
        Published{"mitsuba/bathroom/scene.xml", 856, 592188, 32, 1, 0, 0, 0},
        Published{"mitsuba/cornell-box/scene.xml", 8, 36, 8, 1, 0, 0, 0},
        Published{"mitsuba/living-room/scene.xml", 65, 143163, 19, 0, 0, 1, 0},
        Published{"mitsuba/modern-hall/scene_v0.6.xml", 32, 30927, 21, 13, 0, 0, 0},
        Published{"mitsuba/modern-hall/scene_v3.xml", 32, 30927, 21, 13, 0, 0, 1},
        Published{"mitsuba/veach-ajar/scene.xml", 22, 382690, 13, 1, 0, 0, 0},
        Published{"mitsuba/veach-bidir/scene.xml", 14, 11544, 4, 2, 0, 0, 0},
        Published{"mitsuba/veach-mis/scene.xml", 9, 52, 6, 3, 0, 0, 0},
        Published{"mitsuba3-tests/scenes/cbox/cbox.xml", 8, 38, 5, 1, 0, 0, 0},
        Published{"mitsuba3-tests/scenes/cbox/cbox-rgb.xml", 8, 38, 5, 1, 0, 0, 0},
        Published{"mitsuba3-tests/tests/scenes/bsdf_spheres/test_arealight_path.xml", 13, 325126, 13, 1, 0, 0, 0},
        Published{"mitsuba3-tests/tests/scenes/instancing/test_instancing_path.xml", 9, 97542, 3, 0, 1, 0, 0},
        Published{"mitsuba3-tests/tests/scenes/mesh_attributes/test_mesh_attributes_3_vertex_direct.xml", 1, 528, 1, 0,
                  1, 0, 4},
        Published{"mitsuba3-tests/tests/scenes/orthographic_sensor/test_orthographic_path.xml", 1, 2, 1, 0, 0, 1, 0},
        Published{"mitsuba3-tests/tests/scenes/projector/test_projector_textured_direct.xml", 1, 2, 1, 0, 1, 0, 0},
        Published{"mitsuba3-tests/tests/scenes/spot_light/test_spot_direct.xml", 1, 2, 1, 0, 1, 1, 0},
        Published{"mitsuba3-tests/tests/scenes/various_shapes/test_various_shapes_path.xml", 9, 32, 1, 0, 0, 1, 1}),
    [](const auto& published) { return fmt::format("{}", published.index); });

TEST(PublishedScenePairs, ModernHallIsTheSameInBothDialects) {
  const fs::path folder = shared_scenes() / "mitsuba" / "modern-hall";
  if (!fs::exists(folder)) GTEST_SKIP() << folder << " is not here";
  Warnings warnings;
  const Scene a = import_scene(folder / "scene_v0.6.xml", {}, warnings),
              b = import_scene(folder / "scene_v3.xml", {}, warnings);
  ASSERT_EQ(a.shapes.size(), b.shapes.size());
  for (std::size_t i = 0; i < a.shapes.size(); ++i) {
    ASSERT_EQ(a.shapes[i].geometry.index(), b.shapes[i].geometry.index());
    if (const auto* shape = std::get_if<AnalyticShape>(&a.shapes[i].geometry)) {
      const auto& other = std::get<AnalyticShape>(b.shapes[i].geometry);
      ASSERT_EQ(shape->kind, other.kind);
      const Affine3f &p = shape->object_from_unit, &q = other.object_from_unit;
      for (const Vec3f& v : {Vec3f{1, 0, 0}, Vec3f{0, 1, 0}, Vec3f{0, 0, 1}}) expect_near(p.point(v), q.point(v));
    } else {
      const Mesh &x = mesh_of(a, i), &y = mesh_of(b, i);
      ASSERT_EQ(x.positions.size(), y.positions.size());
      for (std::size_t v = 0; v < x.positions.size(); ++v) ASSERT_LT(length(x.positions[v] - y.positions[v]), 1e-5f);
      EXPECT_EQ(x.indices, y.indices);
      EXPECT_EQ(x.normals, y.normals);
      EXPECT_EQ(x.uvs, y.uvs);
    }
    // The floor is roughplastic in one file and principled in the other.
    if (a.shapes[i].material_name != "FloorTiles") {
      EXPECT_TRUE(SameScattering(*a.shapes[i].material, *b.shapes[i].material)) << a.shapes[i].material_name;
    }
    ASSERT_EQ(a.shapes[i].emission.has_value(), b.shapes[i].emission.has_value());
    if (!a.shapes[i].emission) continue;
    EXPECT_EQ(a.shapes[i].emission->radiance.mean(), b.shapes[i].emission->radiance.mean());
  }
  const Affine3d m = a.world(a.cameras[0].node, 0), n = b.world(b.cameras[0].node, 0);
  for (const auto& [p, q] : {std::pair{m.x, n.x}, {m.y, n.y}, {m.z, n.z}, {m.translation, n.translation}})
    expect_near(p, q);
  EXPECT_EQ(a.cameras[0].fov_x.at(0), b.cameras[0].fov_x.at(0));
}

}  // namespace
}  // namespace tempera
