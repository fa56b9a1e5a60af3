// SPDX-License-Identifier: Apache-2.0
// Objects, cameras and lights that are scaled to a plane, a line or a point.
#include "singular.h"

#include <gtest/gtest.h>

#include "gltf/gltf_test_util.h"

namespace tempera {
namespace {

using Singular = Gltf;

Affine3d turned(double angle = 0.7) { return rotation(axis_angle(normalize(Vec3d{1, -2, 0.5}), angle)); }

TEST_F(Singular, MapsOntoPlanesGetAThickness) {
  for (const double size : {1e-20, 1.0, 1e20}) {
    for (int axis = 0; axis < 3; ++axis) {
      Vec3d s{size, 2 * size, 0.5 * size};
      s[axis] = 0;
      Affine3d m = turned() * scale(s) * turned(0.3);  // the lost direction is none of the axes
      m.translation = {1, 2, 3};
      EXPECT_TRUE(is_singular(m));
      const auto thick = with_thickness(m);
      ASSERT_TRUE(thick.has_value());
      EXPECT_GT(thick->determinant(), 0);
      EXPECT_FALSE(is_singular(*thick));
      EXPECT_TRUE(is_finite(inverse(*thick).x));
      EXPECT_EQ(thick->translation, m.translation);
      for (const Vec3d& v : {thick->x - m.x, thick->y - m.y, thick->z - m.z}) EXPECT_LT(length(v), 3e-4 * size);
      // What lies in the plane stays there: the change is across it.
      const Vec3d n = normalize(turned().vector({axis == 0 ? 1.0 : 0, axis == 1 ? 1.0 : 0, axis == 2 ? 1.0 : 0}));
      EXPECT_LT(length(cross(thick->x - m.x, n)), 1e-12 * size);
    }
    EXPECT_FALSE(with_thickness(turned() * scale(Vec3d{size, 0, 0})).has_value());
  }
  EXPECT_FALSE(with_thickness(scale(Vec3d{0, 0, 0})).has_value());
  EXPECT_EQ(with_thickness(scale(Vec3d{1, 1e-8, 1})), scale(Vec3d{1, 1e-8, 1}));  // thin, not flat
  EXPECT_EQ(with_thickness(scale(Vec3d{-1, 1, 1})), scale(Vec3d{-1, 1, 1}));
}

TEST_F(Singular, RotationsFollowTheirNeighbors) {
  const Quatd q = axis_angle(normalize(Vec3d{1, -2, 0.5}), 0.7), other = axis_angle(Vec3d{0, 0, 1}, 0.4);
  const auto same = [](const Quatd& a, const Quatd& b) { EXPECT_NEAR(std::abs(dot(a, b)), 1, 1e-9); };
  same(closest_rotation(rotation(q), false, other), q);
  same(closest_rotation(rotation(q) * scale(Vec3d{-2, -2, -2}), true, other), q);
  for (const Vec3d& s : {Vec3d{0, 1, 2}, Vec3d{1, 0, 2}, Vec3d{1, 2, 0}})
    same(closest_rotation(rotation(q) * scale(s), false, other), q);
  same(closest_rotation(scale(Vec3d{0, 0, 0}), false, other), other);
  for (const Vec3d& s : {Vec3d{1, 0, 0}, Vec3d{0, 1, 0}, Vec3d{0, 0, 1}})
    same(closest_rotation(rotation(q) * scale(s), false, q), q);
}

TEST_F(Singular, CamerasAndLightsIgnoreTheScaleOfTheirNode) {
  const std::string rest =
      R"("cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":1}}],
"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","spot":{}}]}},"extensionsUsed":["KHR_lights_punctual"])";
  const auto node = [](const std::string& scale) {
    return fmt::format(
        R"({{"camera":0,"extensions":{{"KHR_lights_punctual":{{"light":0}}}},"translation":[1,2,3],"rotation":[0,0.6,0,0.8]{}}})",
        scale);
  };
  const Scene right = load(asset(fmt::format("\"nodes\":[{}],{}", node(""), rest)));
  const Affine3d camera = right.world(right.cameras.at(0).node, 0), light = right.world(right.lights.at(0).node, 0);
  const auto check = [&](const Scene& scene, double t) {
    ASSERT_EQ(scene.cameras.size(), 1u);
    ASSERT_EQ(scene.lights.size(), 1u);
    const Affine3d c = scene.world(scene.cameras[0].node, t), l = scene.world(scene.lights[0].node, t);
    expect_near(c.x, camera.x, 1e-6), expect_near(c.z, camera.z, 1e-6),
        expect_near(c.translation, camera.translation, 1e-6);
    expect_near(l.y, light.y, 1e-6), expect_near(l.z, light.z, 1e-6),
        expect_near(l.translation, light.translation, 1e-6);
  };
  for (const char* s : {"0,0,0", "0,1,1", "1,0,1", "1,1,0", "1e-300,1,1", "1e-300,1e-300,1e-300", "2,3,0.5"})
    check(load(asset(fmt::format("\"nodes\":[{}],{}", node(fmt::format(",\"scale\":[{}]", s)), rest))), 0);
  // A scale that moves, through 0.
  Buffer buffer;
  const int times = buffer.floats({0, 1, 2}, "SCALAR"), scales = buffer.floats({1, 1, 1, 0, 0, 0, 1, 2, 3}, "VEC3");
  const Scene moving = load(asset(fmt::format(
      R"("nodes":[{}],"animations":[{{"channels":[{{"sampler":0,"target":{{"node":0,"path":"scale"}}}}],"samplers":[{{"input":{},"output":{}}}]}}],{},{})",
      node(""), times, scales, rest, buffer.json())));
  for (const double t : {0.0, 0.5, 1.0, 1.5, 2.0}) check(moving, t);
  // Nothing tells where a camera below a collapsed node looks.
  const Scene below =
      load(asset(fmt::format("\"nodes\":[{{\"scale\":[0,0,0],\"children\":[1]}},{}],{}", node(""), rest)));
  EXPECT_TRUE(below.cameras.empty());
  EXPECT_TRUE(warned("cameras at nodes with a singular transform"));
}

TEST_F(Singular, EmptyMeshesDrawNothing) {
  Buffer buffer;
  const int none = buffer.add_json(R"({"componentType":5126,"count":0,"type":"VEC3"})");
  const int no_indices = buffer.add_json(R"({"componentType":5123,"count":0,"type":"SCALAR"})");
  const int some = buffer.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
  for (const int mode : {4, 5, 6}) {
    const Scene scene = load(asset(fmt::format(
        R"("nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"mode":{0},"attributes":{{"POSITION":{1}}}}},{{"mode":{0},"attributes":{{"POSITION":{1},"NORMAL":{1}}},"indices":{2}}},{{"mode":{0},"attributes":{{"POSITION":{3}}},"indices":{2}}}]}}],{4})",
        mode, none, no_indices, some, buffer.json())));
    EXPECT_TRUE(scene.shapes.empty());
  }
  EXPECT_TRUE(warned("accessors without elements"));
}

/// A Mitsuba scene with one shape.
Scene mitsuba(const fs::path& file, const std::string& inner) {
  std::ofstream(file) << "<scene version=\"3.0.0\">" << inner << "</scene>";
  Warnings warnings;
  return import_scene(file, {}, warnings);
}

TEST_F(Singular, MitsubaShapesOfEveryKind) {
  write("quad.obj", "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\n");
  const std::string obj = "<string name=\"filename\" value=\"quad.obj\"/>";
  for (const std::string kind : {"sphere", "disk", "cylinder", "rectangle", "cube", "obj"}) {
    for (const char* s : {"x=\"0\"", "y=\"0\"", "z=\"0\"", "x=\"0\" y=\"0\"", "value=\"0\"", "z=\"-0.0\"",
                          "value=\"1e-300\"", "x=\"1e-300\""}) {
      for (const char* emitter : {"", "<emitter type=\"area\"/>"}) {
        const std::string where = fmt::format(
            "<transform name=\"to_world\"><scale {}/><rotate x=\"1\" y=\"1\" angle=\"33\"/></transform>", s);
        const std::string inside = (kind == "obj" ? obj : "") + emitter;
        SCOPED_TRACE(kind + where);
        Scene scene;
        ASSERT_NO_THROW(
            scene = mitsuba(dir_ / "a.xml", fmt::format("<shape type=\"{}\">{}{}</shape>", kind, where, inside)));
        ASSERT_EQ(scene.shapes.size(), 1u);
        const Geometry& g = scene.shapes[0].geometry;
        if (const auto* mesh = std::get_if<Mesh>(&g)) {
          for (const Vec3f& n : mesh->normals) EXPECT_TRUE(is_finite(n));
        } else {
          const Affine3f m = std::visit(
              [](const auto& x) -> Affine3f {
                if constexpr (requires { x.object_from_unit; })
                  return x.object_from_unit;
                else
                  return {};
              },
              g);
          EXPECT_TRUE(is_finite(inverse(Affine3d{Vec3d(m.x), Vec3d(m.y), Vec3d(m.z), Vec3d(m.translation)}).x));
        }
        ASSERT_NO_THROW(mitsuba(dir_ / "a.xml",
                                fmt::format("<shape type=\"shapegroup\" id=\"g\"><shape type=\"{}\">{}</shape></shape>"
                                            "<shape type=\"instance\"><ref id=\"g\"/>{}</shape>",
                                            kind, inside, where)));
      }
    }
    const std::string animated =
        "<animation name=\"to_world\"><transform time=\"0\"><rotate z=\"1\" angle=\"40\"/></transform>"
        "<transform time=\"1\"><scale value=\"0\"/><translate x=\"3\"/></transform>"
        "<transform time=\"2\"><scale z=\"0\"/><rotate z=\"1\" angle=\"40\"/></transform></animation>";
    const Scene scene = mitsuba(
        dir_ / "a.xml", fmt::format("<shape type=\"{}\">{}{}</shape>", kind, animated, kind == "obj" ? obj : ""));
    // A key without a size has no rotation of its own: it does not turn on its way there and back.
    const int node = scene.instances.at(0).node;
    for (const double t : {0.25, 0.5, 0.75, 1.25, 1.9}) {
      const Vec3d x = scene.world(node, t).x;
      EXPECT_NEAR(std::atan2(x.y, x.x), 40 * kPiD / 180, 1e-6) << t;
    }
    expect_near(scene.world(node, 1).translation, {3, 0, 0}, 1e-9);
    EXPECT_EQ(length(scene.world(node, 1).y), 0);
    EXPECT_NEAR(length(scene.world(node, 2).y), 1, 1e-9);
    EXPECT_EQ(length(scene.world(node, 2).z), 0);
  }
}

TEST_F(Singular, MitsubaKeysInDisorder) {
  const auto x = [&](const std::string& keys, double t) {
    const Scene scene =
        mitsuba(dir_ / "a.xml", "<shape type=\"sphere\"><animation name=\"to_world\">" + keys + "</animation></shape>");
    return scene.world(scene.instances.at(0).node, t).translation.x;
  };
  const auto key = [](double t, double to) {
    return fmt::format("<transform time=\"{}\"><translate x=\"{}\"/></transform>", t, to);
  };
  EXPECT_NEAR(x(key(1, 1) + key(0, 0), 0.25), 0.25, 1e-9);
  EXPECT_NEAR(x(key(-1, 1) + key(1, 3), 0), 2, 1e-9);
  const std::string jump = key(0, 0) + key(1, 1) + key(1, 7) + key(1, 5) + key(2, 6);
  EXPECT_NEAR(x(jump, 0.999), 0.999, 1e-9);
  EXPECT_NEAR(x(jump, 1), 5, 1e-9);
  EXPECT_NEAR(x(jump, 1.5), 5.5, 1e-9);
  EXPECT_EQ(x("", 0), 0);
  Warnings warnings;
  std::ofstream(dir_ / "b.xml") << "<scene version=\"3.0.0\">\n<shape type=\"sphere\"><animation name=\"to_world\">\n"
                                << key(1, 0) << "\n"
                                << key(0, 0) << "\n"
                                << key(0, 1) << "</animation></shape></scene>";
  import_scene(dir_ / "b.xml", {}, warnings);
  ASSERT_EQ(warnings.lines().size(), 2u);
  EXPECT_NE(warnings.lines()[0].find("b.xml:4"), std::string::npos) << warnings.lines()[0];
  EXPECT_NE(warnings.lines()[1].find("b.xml:5"), std::string::npos) << warnings.lines()[1];
}

}  // namespace
}  // namespace tempera
