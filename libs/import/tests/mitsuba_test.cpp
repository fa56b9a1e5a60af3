// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/mitsuba.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <fstream>
#include <set>

#include "../src/sunsky.h"
#include "tempera/shading/bsdf.h"
#include "tempera/shading/spectrum.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// Sample scenes that not every checkout has.
fs::path shared_scenes() { return fs::path(TEMPERA_SOURCE_DIR) / ".." / "shared" / "scenes"; }

/// A folder of files that goes away with the object.
class Folder {
 public:
  Folder() : path_(fs::temp_directory_path() / fmt::format("tempera_mitsuba_{}_{}", getpid(), count_++)) {
    fs::create_directories(path_);
  }
  ~Folder() { fs::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  fs::path write(const std::string& name, const std::string& contents) const {
    fs::create_directories((path_ / name).parent_path());
    std::ofstream(path_ / name, std::ios::binary) << contents;
    return path_ / name;
  }
  /// Imports a scene with this inside its root element, which stands on line 1.
  Scene load(const std::string& inner, ImportOptions options = {}, const char* version = "3.0.0") {
    return import_mitsuba(write("scene.xml", fmt::format("<scene version=\"{}\">{}</scene>", version, inner)), options,
                          warnings);
  }
  const fs::path& path() const { return path_; }
  Warnings warnings;

 private:
  static inline int count_ = 0;
  fs::path path_;
};

constexpr const char* kTriangleObj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

/// Scattering of a material at fixed directions, for a surface in z = 0.
std::vector<float> scattering(const Material& material, const Vec2f& uv = {0.3f, 0.6f}) {
  std::vector<float> result;
  for (const Vec3f& o : {Vec3f{0.3f, 0.2f, 0.8f}, Vec3f{-0.6f, 0.1f, 0.3f}, Vec3f{0.3f, 0.2f, -0.8f}}) {
    ShadingPoint p;
    p.ng = {0, 0, 1};
    p.dpdu = {1, 0, 0};
    p.dpdv = {0, 1, 0};
    p.uv = p.uv1 = uv;
    p.color = Rgb(0.9f, 0.5f, 0.1f);
    p.wo = normalize(o);
    Bsdf bsdf;
    material.add_lobes(p, 1, bsdf);
    result.push_back(material.opacity(p));
    for (const Vec3f& i : {Vec3f{-0.28f, -0.2f, 0.8f}, Vec3f{0.5f, -0.4f, 0.5f}, Vec3f{-0.2f, -0.1f, -0.7f}}) {
      const Rgb f = bsdf.eval(p.wo, normalize(i)).sum();
      for (int c = 0; c < 3; ++c) result.push_back(f[c]);
    }
    // Delta lobes: what one sample carries.
    for (const float u : {0.02f, 0.97f}) {
      const auto s = bsdf.empty() ? std::nullopt : bsdf.sample(p.wo, u, {0.3f, 0.7f});
      for (int c = 0; c < 3; ++c) result.push_back(s && s->delta ? s->sum()[c] / s->pdf : 0);
      result.push_back(s && s->delta ? s->wi.z : 0);
    }
  }
  return result;
}

testing::AssertionResult SameScattering(const Material& a, const Material& b) {
  const std::vector<float> x = scattering(a), y = scattering(b);
  for (std::size_t i = 0; i < x.size(); ++i)
    if (!(std::abs(x[i] - y[i]) <= 1e-5f * (1 + std::abs(y[i]))))
      return testing::AssertionFailure() << "value " << i << " is " << x[i] << " instead of " << y[i];
  return testing::AssertionSuccess();
}

const Mesh& mesh_of(const Scene& scene, std::size_t shape = 0) {
  return std::get<Mesh>(scene.shapes.at(shape).geometry);
}

Bounds3f bounds_of(const Mesh& mesh) {
  Bounds3f b;
  for (const Vec3f& p : mesh.positions) b.extend(p);
  return b;
}

void expect_near(const Vec3f& a, const Vec3f& b, float tolerance = 1e-5f) {
  EXPECT_LT(length(a - b), tolerance) << a.x << " " << a.y << " " << a.z;
}
void expect_near(const Vec3d& a, const Vec3d& b) { expect_near(Vec3f(a), Vec3f(b)); }

// --- the language ----------------------------------------------------------------------------------------------------

TEST(MitsubaXml, DefaultsAndDefinesFillInParameters) {
  const std::string inner = R"(
    <default name="r" value="2"/> <default name="rx" value="3"/> <default name="kind" value="sphere"/>
    <shape type="$kind"><float name="radius" value="$rx.5"/><point name="center" value="$r 0 \$"/></shape>)";
  Folder folder;
  EXPECT_THROW(folder.load(inner), Error);  // an escaped dollar sign stays one
  const std::string good = inner.substr(0, inner.find(" \\$")) + " 0" + inner.substr(inner.find("\"/></shape>"));
  const Affine3f m = std::get<Sphere>(folder.load(good).shapes[0].geometry).object_from_unit;
  EXPECT_EQ(m.x.x, 3.5f);
  EXPECT_EQ(m.translation.x, 2);
  const Scene s = folder.load(good, {.defines = {{"r", "7"}, {"unused", "1"}}});
  EXPECT_EQ(std::get<Sphere>(s.shapes[0].geometry).object_from_unit.translation.x, 7);
  EXPECT_FALSE(folder.warnings.empty());  // about "unused"
}

TEST(MitsubaXml, ReferencesMayComeBeforeWhatTheyName) {
  Folder folder;
  const Scene s = folder.load(R"(
    <shape type="rectangle"><ref id="paint"/></shape>
    <bsdf type="diffuse" id="wall"><rgb name="reflectance" value="0.1 0.2 0.3"/></bsdf>
    <alias id="wall" as="paint"/>
    <shape type="rectangle"><ref id="wall"/></shape>)");
  EXPECT_EQ(s.shapes[0].material, s.shapes[1].material);
  EXPECT_EQ(s.shapes[0].material_name, "wall");
  EXPECT_TRUE(SameScattering(*s.shapes[0].material, *make_diffuse(Rgb(0.1f, 0.2f, 0.3f))));
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaXml, IncludesAndSearchFolders) {
  Folder folder;
  folder.write(
      "parts/shapes.xml",
      R"(<scene version="3.0.0"><shape type="obj"><string name="filename" value="tri.obj"/><ref id="b"/></shape></scene>)");
  folder.write("parts/b.xml",
               R"(<bsdf version="3.0.0" type="diffuse" id="b"><rgb name="reflectance" value="$gray"/></bsdf>)");
  folder.write("models/tri.obj", kTriangleObj);
  const Scene s = folder.load(
      R"(<default name="gray" value="0.25"/><path value="models"/><include filename="parts/shapes.xml"/><include filename="parts/b.xml"/>)");
  ASSERT_EQ(s.shapes.size(), 1u);
  EXPECT_EQ(s.shapes[0].name, "tri");
  EXPECT_TRUE(SameScattering(*s.shapes[0].material, *make_diffuse(0.25f)));
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaXml, BothDialectsMeanTheSame) {
  Folder folder;
  folder.write("tri.obj", kTriangleObj);
  const Scene old_one = folder.load(R"(
    <integrator type="path"><integer name="maxDepth" value="7"/><integer name="rrDepth" value="3"/><boolean name="hideEmitters" value="true"/></integrator>
    <sensor type="thinlens"><float name="apertureRadius" value="0.2"/><float name="focusDistance" value="3"/><float name="nearClip" value="1"/>
      <transform name="toWorld"><lookAt origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
      <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="4"/><string name="pixelFormat" value="rgb"/></film>
      <sampler type="ldsampler"><integer name="sampleCount" value="16"/></sampler></sensor>
    <shape type="obj"><string name="filename" value="tri.obj"/><boolean name="faceNormals" value="true"/><boolean name="flipNormals" value="true"/>
      <bsdf type="roughplastic"><float name="intIOR" value="1.6"/><rgb name="diffuseReflectance" value="#ff8000"/></bsdf></shape>)",
                                    {}, "0.6.0");
  const Scene new_one = folder.load(R"(
    <integrator type="path"><integer name="max_depth" value="7"/><integer name="rr_depth" value="3"/><boolean name="hide_emitters" value="true"/></integrator>
    <sensor type="thinlens"><float name="aperture_radius" value="0.2"/><float name="focus_distance" value="3"/><float name="near_clip" value="1"/>
      <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
      <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="4"/></film>
      <sampler type="independent"><integer name="sample_count" value="16"/></sampler></sensor>
    <shape type="obj"><string name="filename" value="tri.obj"/><boolean name="face_normals" value="true"/><boolean name="flip_normals" value="true"/>
      <bsdf type="roughplastic"><float name="int_ior" value="1.6"/><rgb name="diffuse_reflectance" value="1 0.50196078 0"/></bsdf></shape>)");
  EXPECT_TRUE(folder.warnings.empty());
  for (const Scene* s : {&old_one, &new_one}) {
    EXPECT_EQ(s->defaults.max_depth, 7);
    EXPECT_EQ(s->defaults.rr_depth, 3);
    EXPECT_EQ(s->defaults.hide_emitters, true);
    EXPECT_EQ(s->defaults.spp, 16);
    EXPECT_EQ(s->defaults.width, 8);
    EXPECT_TRUE(s->defaults.null_counts_as_bounce);
    EXPECT_EQ(s->cameras[0].aperture_radius.at(0), 0.2f);
    EXPECT_EQ(s->cameras[0].focus_distance.at(0), 3);
    EXPECT_EQ(s->cameras[0].near_clip, 1);
    EXPECT_TRUE(mesh_of(*s).flip_normals);
    EXPECT_TRUE(mesh_of(*s).normals.empty());
  }
  EXPECT_TRUE(SameScattering(*old_one.shapes[0].material, *new_one.shapes[0].material));
}

struct BadScene {
  const char* inner;  // line 1 of it is line 2 of the file
  ErrorCode code;
  int line;
  const char* part_of_message;
};

TEST(MitsubaXml, ErrorsHaveCodeLineAndAdvice) {
  const BadScene cases[] = {
      {"<shape type=\"sphere\">\n", ErrorCode::kSyntax, 3, "well-formed"},
      {"<shape type=\"sphere\" type=\"disk\" <\n/>", ErrorCode::kSyntax, 2, "well-formed"},
      {"\n<blob/>", ErrorCode::kUnknownName, 3, "known:"},
      {"<translate x=\"1\"/>", ErrorCode::kUnknownName, 2, "<transform>"},
      {"<shape/>", ErrorCode::kBadInput, 2, "\"type\""},
      {"<shape type=\"sphere\" kind=\"x\"/>", ErrorCode::kUnknownName, 2, "known: type, id, name"},
      {"<shape type=\"sphere\">\n<float name=\"radius\" value=\"abc\"/></shape>", ErrorCode::kBadInput, 3,
       "as a number"},
      {"<shape type=\"sphere\">\n<float name=\"radius\" value=\"nan\"/></shape>", ErrorCode::kOutOfRange, 3, "finite"},
      {"<shape type=\"sphere\">\n<float name=\"radius\" value=\"1e999\"/></shape>", ErrorCode::kOutOfRange, 3,
       "finite"},
      {"<shape type=\"sphere\">\n<float name=\"radius\" value=\"-1\"/></shape>", ErrorCode::kOutOfRange, 3, "at least"},
      {"<shape type=\"sphere\">\n<string name=\"radius\" value=\"1\"/></shape>", ErrorCode::kBadInput, 3,
       "expected a number"},
      {"<shape type=\"sphere\">\n<float name=\"radius\" value=\"1\"/>\n<float name=\"radius\" value=\"1\"/></shape>",
       ErrorCode::kBadInput, 4, "twice"},
      {"<shape type=\"sphere\">\n<point name=\"center\" x=\"1\" y=\"2\"/></shape>", ErrorCode::kBadInput, 3, "\"z\""},
      {"<shape type=\"sphere\">\n<point name=\"center\" value=\"1 2\"/></shape>", ErrorCode::kBadInput, 3, "three"},
      {"<integrator type=\"path\">\n<integer name=\"max_depth\" value=\"2.5\"/></integrator>", ErrorCode::kBadInput, 3,
       "integer"},
      {"<integrator type=\"path\">\n<integer name=\"max_depth\" value=\"99999999999999999999\"/></integrator>",
       ErrorCode::kBadInput, 3, "integer"},
      {"<integrator type=\"path\">\n<boolean name=\"hide_emitters\" value=\"yes\"/></integrator>", ErrorCode::kBadInput,
       3, "true or false"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<matrix value=\"1 0 0 0 1 0 0 0\"/></transform></shape>",
       ErrorCode::kBadInput, 3, "9 or 16"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<matrix value=\"1 0 0 0  0 1 0 0  0 0 1 0  0 0 1 "
       "1\"/></transform></shape>",
       ErrorCode::kBadInput, 3, "0 0 0 1"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<rotate angle=\"3\"/></transform></shape>",
       ErrorCode::kOutOfRange, 3, "axis"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<lookat origin=\"0 0 0\" target=\"0 0 "
       "0\"/></transform></shape>",
       ErrorCode::kOutOfRange, 3, "differ"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<lookat origin=\"0 0 0\" target=\"0 1 0\" up=\"0 1 "
       "0\"/></transform></shape>",
       ErrorCode::kOutOfRange, 3, "up"},
      {"<shape type=\"disk\"><transform name=\"to_world\">\n<shear x=\"1\"/></transform></shape>",
       ErrorCode::kUnknownName, 3, "lookat"},
      {"<shape type=\"disk\">\n<transform name=\"to_world\"><scale x=\"0\"/></transform></shape>",
       ErrorCode::kOutOfRange, 3, "invertible"},
      {"<shape type=\"disk\">\n<animation name=\"to_world\"><transform time=\"1\"/>\n<transform "
       "time=\"1\"/></animation></shape>",
       ErrorCode::kBadInput, 4, "increase"},
      {"<shape type=\"disk\">\n<animation name=\"to_world\"/></shape>", ErrorCode::kBadInput, 3, "at least one"},
      {"<shape type=\"disk\">\n<ref id=\"wal\"/></shape><bsdf id=\"wall\" type=\"diffuse\"/>", ErrorCode::kUnknownName,
       3, "known: wall"},
      {"<bsdf id=\"a\" type=\"diffuse\"/>\n<bsdf id=\"a\" type=\"diffuse\"/>", ErrorCode::kBadInput, 3, "taken"},
      {"<alias id=\"a\" as=\"b\"/>", ErrorCode::kUnknownName, 2, "no ids"},
      {"<shape type=\"disk\"><ref id=\"a\"/></shape>\n<bsdf id=\"a\" type=\"twosided\"><ref id=\"b\"/></bsdf>\n<bsdf "
       "id=\"b\" type=\"mask\"><ref id=\"a\"/></bsdf>",
       ErrorCode::kBadInput, 3, "itself"},
      {"<shape type=\"disk\"><float name=\"x\" value=\"$missing\"/></shape>", ErrorCode::kUnknownName, 2, "$missing"},
      {"<default name=\"a\" value=\"1\"><float/></default>", ErrorCode::kBadInput, 2, "inside <default>"},
      {"\n<include filename=\"nowhere.xml\"/>", ErrorCode::kMissingFile, 3, "nowhere.xml"},
      {"\n<include filename=\"scene.xml\"/>", ErrorCode::kBadInput, 3, "includes itself"},
      {"\n<path value=\"nowhere\"/>", ErrorCode::kMissingFile, 3, "folder"},
      {"<shape type=\"obj\">\n<string name=\"filename\" value=\"nowhere.obj\"/></shape>", ErrorCode::kMissingFile, 3,
       "nowhere.obj"},
      {"\n<shape type=\"obj\"/>", ErrorCode::kBadInput, 3, "filename"},
      {"<shape type=\"obj\">\n<string name=\"filename\" value=\".\"/></shape>", ErrorCode::kBadInput, 3,
       "regular file"},
      {"<shape type=\"cylinder\"><point name=\"p1\" value=\"0\"/></shape>", ErrorCode::kOutOfRange, 2, "differ"},
      {"\n<shape type=\"instance\"/>", ErrorCode::kBadInput, 3, "shapegroup"},
      {"<bsdf id=\"d\" type=\"dielectric\">\n<string name=\"int_ior\" value=\"watr\"/></bsdf><shape type=\"disk\"><ref "
       "id=\"d\"/></shape>",
       ErrorCode::kUnknownName, 3, "water"},
      {"<shape type=\"disk\"><bsdf type=\"conductor\">\n<string name=\"material\" "
       "value=\"Unobtainium\"/></bsdf></shape>",
       ErrorCode::kUnknownName, 3, "Au"},
      {"<shape type=\"disk\">\n<bsdf type=\"mask\"/></shape>", ErrorCode::kBadInput, 3, "nested bsdf"},
      {"<shape type=\"disk\">\n<bsdf type=\"blendbsdf\"><bsdf type=\"diffuse\"/></bsdf></shape>", ErrorCode::kBadInput,
       3, "two nested"},
      {"<shape type=\"disk\"><bsdf type=\"roughconductor\">\n<string name=\"distribution\" "
       "value=\"gx\"/></bsdf></shape>",
       ErrorCode::kUnknownName, 3, "ggx"},
      {"<shape type=\"disk\"><bsdf type=\"diffuse\">\n<rgb name=\"reflectance\" value=\"1 2\"/></bsdf></shape>",
       ErrorCode::kBadInput, 3, "one or three"},
      {"<shape type=\"disk\"><bsdf type=\"diffuse\">\n<spectrum name=\"reflectance\" value=\"400:1 "
       "390:2\"/></bsdf></shape>",
       ErrorCode::kBadInput, 3, "increase"},
      {"<shape type=\"disk\"><bsdf type=\"diffuse\">\n<spectrum name=\"reflectance\" value=\"400:1 "
       "x\"/></bsdf></shape>",
       ErrorCode::kBadInput, 3, "wavelength"},
      {"<shape type=\"disk\"><bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\">\n<string "
       "name=\"filename\" value=\"no.png\"/></texture></bsdf></shape>",
       ErrorCode::kMissingFile, 3, "no.png"},
      {"<sensor type=\"perspective\">\n<float name=\"fov\" value=\"180\"/></sensor>", ErrorCode::kOutOfRange, 3,
       "between"},
      {"<sensor type=\"perspective\">\n<string name=\"fov_axis\" value=\"z\"/></sensor>", ErrorCode::kUnknownName, 3,
       "diagonal"},
      {"<sensor type=\"perspective\">\n<string name=\"focal_length\" value=\"long\"/></sensor>", ErrorCode::kBadInput,
       3, "50mm"},
      {"<sensor type=\"perspective\"><film type=\"hdrfilm\">\n<integer name=\"width\" value=\"0\"/></film></sensor>",
       ErrorCode::kOutOfRange, 3, "between"},
      {"<sensor type=\"perspective\"><float name=\"shutter_open\" value=\"1\"/>\n<float name=\"shutter_close\" "
       "value=\"0\"/></sensor>",
       ErrorCode::kOutOfRange, 3, "before"},
      {"\n<sensor type=\"thinlens\"/>", ErrorCode::kBadInput, 3, "aperture_radius"},
      {"<emitter type=\"directional\">\n<vector name=\"direction\" value=\"0\"/></emitter>", ErrorCode::kOutOfRange, 3,
       "zero"},
      {"<emitter type=\"sunsky\">\n<float name=\"turbidity\" value=\"11\"/></emitter>", ErrorCode::kOutOfRange, 3,
       "between 1 and 10"},
  };
  for (const BadScene& bad : cases) {
    Folder folder;
    try {
      folder.load(std::string("\n") + bad.inner);
      ADD_FAILURE() << "no error for " << bad.inner;
    } catch (const Error& e) {
      EXPECT_EQ(int(e.code()), int(bad.code)) << e.what() << "\n for " << bad.inner;
      EXPECT_EQ(e.loc().line, bad.line) << e.what() << "\n for " << bad.inner;
      EXPECT_GT(e.loc().column, 0) << e.what();
      EXPECT_NE(e.message().find(bad.part_of_message), std::string::npos) << e.what();
    }
  }
}

TEST(MitsubaXml, PlacesPointAtTheValue) {
  Folder folder;
  const fs::path file = folder.write("scene.xml",
                                     "<scene version=\"3.0.0\">\n  <shape type=\"sphere\">\n    <float name=\"radius\" "
                                     "value=\"x\"/>\n</shape></scene>");
  try {
    import_mitsuba(file, {}, folder.warnings);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().str(), file.string() + ":3:33");
  }
}

TEST(MitsubaXml, RootMustBeAScene) {
  Folder folder;
  const auto line_of = [&](const std::string& text) {
    try {
      import_mitsuba(folder.write("a.xml", text), {}, folder.warnings);
    } catch (const Error& e) {
      return fmt::format("{} {}", int(e.code()), e.loc().line);
    }
    return std::string("none");
  };
  EXPECT_EQ(line_of(""), fmt::format("{} 1", int(ErrorCode::kSyntax)));
  EXPECT_EQ(line_of("\n<html/>"), fmt::format("{} 2", int(ErrorCode::kBadInput)));
  EXPECT_EQ(line_of("\n<scene/>"), fmt::format("{} 2", int(ErrorCode::kBadInput)));
  EXPECT_EQ(line_of("\n<scene version=\"x\"/>"), fmt::format("{} 2", int(ErrorCode::kBadInput)));
  EXPECT_EQ(line_of("\n<bsdf version=\"3\" type=\"diffuse\"/>"), fmt::format("{} 2", int(ErrorCode::kBadInput)));
  EXPECT_EQ(line_of("<scene version=\"3.0.0\"/>"), "none");
}

TEST(MitsubaXml, BombsAreDefused) {
  Folder folder;
  std::string deep;
  for (int i = 0; i < 10000; ++i) deep += "<bsdf type=\"twosided\">";
  for (int i = 0; i < 10000; ++i) deep += "</bsdf>";
  EXPECT_THROW(folder.load(deep), Error);
  std::string doubling = "<default name=\"a0\" value=\"xxxxxxxxxx\"/>";
  for (int i = 1; i < 60; ++i) doubling += fmt::format("<default name=\"a{}\" value=\"$a{}$a{}\"/>", i, i - 1, i - 1);
  EXPECT_THROW(folder.load(doubling), Error);
  for (int i = 0; i < 30; ++i)
    folder.write(
        fmt::format("{}.xml", i),
        fmt::format("<scene version=\"3.0.0\"><include filename=\"{0}.xml\"/><include filename=\"{0}.xml\"/></scene>",
                    i + 1));
  folder.write("30.xml", "<scene version=\"3.0.0\"/>");
  EXPECT_THROW(folder.load("<include filename=\"0.xml\"/>"), Error);
}

TEST(MitsubaXml, ErrorsOfIndependentObjectsComeTogether) {
  Folder folder;
  folder.write("bad.obj", "v 0 0 0\nf 1 2 3\n");
  try {
    folder.load(
        "\n<shape type=\"sphere\">\n<float name=\"radius\" value=\"-1\"/></shape>\n<shape type=\"obj\"><string "
        "name=\"filename\" value=\"bad.obj\"/></shape>");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().line, 3);
    EXPECT_NE(e.message().find("bad.obj:2"), std::string::npos) << e.what();
  }
}

TEST(MitsubaXml, WhatIsNotSupportedIsCounted) {
  const auto warns = [](const std::string& inner, const std::string& part) {
    Folder folder;
    folder.load(inner);
    try {
      folder.warnings.report(true);
    } catch (const Error& e) {
      if (e.code() == ErrorCode::kUnsupported && e.message().find(part) != std::string::npos && e.loc().line == 2)
        return testing::AssertionSuccess();
      return testing::AssertionFailure() << e.what();
    }
    return testing::AssertionFailure() << "no warning";
  };
  EXPECT_TRUE(warns("\n<shape type=\"sdfgrid\"/>", "sdfgrid"));
  EXPECT_TRUE(warns("<shape type=\"sphere\">\n<float name=\"wobble\" value=\"1\"/></shape>", "wobble"));
  EXPECT_TRUE(warns("<shape type=\"sphere\">\n<medium name=\"interior\" type=\"homogeneous\"/></shape>",
                    "participating media"));
  EXPECT_TRUE(warns("<shape type=\"sphere\">\n<bsdf type=\"hair\"/></shape>", "hair"));
  EXPECT_TRUE(warns("\n<integrator type=\"bdpt\"/>", "bdpt"));
  EXPECT_TRUE(warns("\n<sensor type=\"spherical\"/>", "spherical"));
  EXPECT_TRUE(warns("\n<emitter type=\"measured\"/>", "measured"));
  EXPECT_TRUE(warns("\n<emitter type=\"area\"/>", "outside of a shape"));
  EXPECT_TRUE(warns("<sensor type=\"perspective\"><film type=\"hdrfilm\">\n<rfilter type=\"lanczos\"/></film></sensor>",
                    "lanczos"));
  EXPECT_TRUE(warns(
      "<shape type=\"disk\"><bsdf type=\"diffuse\">\n<texture name=\"reflectance\" type=\"wood\"/></bsdf></shape>",
      "wood"));
  EXPECT_TRUE(warns("\n<phase type=\"hg\"/>", "hg"));
}

TEST(MitsubaXml, SandboxKeepsInsideTheFolder) {
  Folder outside;
  outside.write("secret.obj", kTriangleObj);
  Folder folder;
  folder.write("tri.obj", kTriangleObj);
  const auto shape = [](const std::string& name) {
    return fmt::format("\n<shape type=\"obj\"><string name=\"filename\" value=\"{}\"/></shape>", name);
  };
  const std::string elsewhere = (outside.path() / "secret.obj").string();
  EXPECT_EQ(folder.load(shape(elsewhere)).shapes.size(), 1u);
  EXPECT_EQ(folder.load(shape("tri.obj"), {.sandbox = true}).shapes.size(), 1u);
  fs::create_symlink(outside.path() / "secret.obj", folder.path() / "link.obj");
  for (const std::string& name : {elsewhere, fs::relative(elsewhere, folder.path()).string(), std::string("link.obj"),
                                  std::string("/dev/zero")}) {
    try {
      folder.load(shape(name), {.sandbox = true});
      ADD_FAILURE() << name;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      EXPECT_EQ(e.loc().line, 2);
    }
  }
}

TEST(MitsubaXml, MemoryLimit) {
  Folder folder;
  std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  for (int i = 0; i < 10000; ++i) text += "f 1 2 3\n";
  folder.write("many.obj", text);
  const std::string inner = "<shape type=\"obj\"><string name=\"filename\" value=\"many.obj\"/></shape>";
  EXPECT_EQ(folder.load(inner, {.memory_limit = 1 << 20}).shapes.size(), 1u);
  try {
    folder.load(inner, {.memory_limit = 100000});
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kOutOfMemory);
    EXPECT_EQ(exit_status(e.code()), 5);
  }
}

TEST(MitsubaXml, HashFollowsContentsOnly) {
  Folder a, b;
  const std::string inner = "<shape type=\"obj\"><string name=\"filename\" value=\"tri.obj\"/></shape>";
  a.write("tri.obj", kTriangleObj);
  b.write("tri.obj", kTriangleObj);
  const std::uint64_t first = a.load(inner).content_hash;
  EXPECT_NE(first, 0u);
  EXPECT_EQ(first, b.load(inner).content_hash);
  b.write("tri.obj", std::string(kTriangleObj) + "\n");
  EXPECT_NE(first, b.load(inner).content_hash);
}

// --- shapes ----------------------------------------------------------------------------------------------------------

TEST(MitsubaShapes, StepsOfATransformApplyInOrder) {
  Folder folder;
  const Scene s = folder.load(R"(<shape type="disk"><transform name="to_world">
    <scale value="2"/><rotate y="1" angle="90"/><translate x="1" z="5"/><matrix value="0 -1 0  1 0 0  0 0 1"/></transform></shape>)");
  const Affine3f m = std::get<Disk>(s.shapes[0].geometry).object_from_unit;
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
  const Affine3f m = std::get<Sphere>(s.shapes[0].geometry).object_from_unit;
  expect_near(m.point({0, 0, 0}), {1, 6, 3});
  expect_near(m.point({0, 1, 0}), {1, 12, 3});
  const auto& c = std::get<Cylinder>(s.shapes[1].geometry);
  expect_near(c.object_from_unit.point({0, 0, 0}), {0, 1, 0});
  expect_near(c.object_from_unit.point({0, 0, 1}), {0, 5, 0});
  EXPECT_NEAR(length(c.object_from_unit.vector({0.6f, 0.8f, 0})), 0.5f, 1e-6f);
  EXPECT_TRUE(c.flip_normals);
  // A mirrored sphere is inside out, as in Mitsuba 3.
  EXPECT_TRUE(std::get<Sphere>(s.shapes[2].geometry).flip_normals);
  EXPECT_FALSE(std::get<Sphere>(s.shapes[3].geometry).flip_normals);
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
  EXPECT_EQ(std::get<Sphere>(s.shapes[0].geometry).object_from_unit.translation.x, 1);
}

// --- materials -------------------------------------------------------------------------------------------------------

MaterialPtr imported(const std::string& bsdf, const char* version = "3.0.0", bool expect_warning = false) {
  Folder folder;
  const Scene s = folder.load("<shape type=\"disk\">" + bsdf + "</shape>", {}, version);
  EXPECT_EQ(folder.warnings.empty(), !expect_warning) << bsdf;
  return s.shapes.at(0).material;
}

TEST(MitsubaMaterials, DefaultsAreMitsubas) {
  Roughness rough;
  rough.rough = true;
  ConductorParams rough_mirror;
  rough_mirror.roughness = rough;
  DielectricParams thin, frosted;
  thin.thin = true;
  frosted.roughness = rough;
  PlasticParams rough_plastic;
  rough_plastic.roughness = rough;
  PrincipledParams principled;
  principled.eta = 2 / (1 - std::sqrt(0.08f * 0.5f)) - 1;
  const std::pair<const char*, MaterialPtr> cases[] = {{"diffuse", make_diffuse(0.5f)},
                                                       {"conductor", make_conductor({})},
                                                       {"roughconductor", make_conductor(rough_mirror)},
                                                       {"dielectric", make_dielectric({})},
                                                       {"thindielectric", make_dielectric(thin)},
                                                       {"roughdielectric", make_dielectric(frosted)},
                                                       {"plastic", make_plastic({})},
                                                       {"roughplastic", make_plastic(rough_plastic)},
                                                       {"principled", make_principled(principled)},
                                                       {"null", make_mask(0.0f, make_black())}};
  for (const auto& [plugin, material] : cases)
    EXPECT_TRUE(SameScattering(*imported(fmt::format("<bsdf type=\"{}\"/>", plugin)), *material)) << plugin;
}

TEST(MitsubaMaterials, ParametersArrive) {
  ConductorParams gold;
  gold.eta = named_conductor("Au")->eta;
  gold.k = named_conductor("Au")->k;
  gold.roughness = {true, Microfacets::kGgx, 0.3f, 0.2f};
  gold.specular_reflectance = Rgb(0.9f, 0.8f, 0.7f);
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="roughconductor"><string name="material" value="Au"/><string name="distribution" value="GGX"/>
    <float name="alpha_u" value="0.3"/><float name="alpha_v" value="0.2"/><rgb name="specular_reflectance" value="0.9 0.8 0.7"/></bsdf>)"),
      *make_conductor(gold)));
  ConductorParams spectral;
  spectral.eta = 0.789f, spectral.k = 6.15f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="conductor"><spectrum name="eta" value="0.789"/><spectrum name="k" value="6.15"/></bsdf>)"),
      *make_conductor(spectral)));
  EXPECT_TRUE(SameScattering(*imported(R"(<bsdf type="conductor"><string name="material" value="none"/></bsdf>)"),
                             *make_conductor({})));
  DielectricParams diamond;
  diamond.int_ior = 2.419f, diamond.ext_ior = 1.333f, diamond.specular_transmittance = 0.5f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="dielectric"><string name="int_ior" value="Diamond"/><string name="ext_ior" value="water"/>
    <float name="specular_transmittance" value="0.5"/></bsdf>)"),
      *make_dielectric(diamond)));
  PlasticParams plastic;
  plastic.int_ior = 1.9f, plastic.nonlinear = true, plastic.diffuse_reflectance = Rgb(0.1f, 0.27f, 0.36f);
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1, 0.27, 0.36"/><float name="int_ior" value="1.9"/>
    <boolean name="nonlinear" value="true"/></bsdf>)"),
      *make_plastic(plastic)));
  PrincipledParams car;
  car.base_color = Rgb(0.8f, 0.1f, 0.2f), car.metallic = 0.3f, car.roughness = 0.4f, car.anisotropic = 0.5f,
  car.clearcoat = 0.6f;
  car.clearcoat_gloss = 0.7f, car.sheen = 0.2f, car.sheen_tint = 0.9f, car.spec_tint = 0.15f, car.flatness = 0.25f,
  car.eta = 1.7f;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="principled"><rgb name="base_color" value="0.8 0.1 0.2"/><float name="metallic" value="0.3"/>
    <float name="roughness" value="0.4"/><float name="anisotropic" value="0.5"/><float name="clearcoat" value="0.6"/><float name="clearcoat_gloss" value="0.7"/>
    <float name="sheen" value="0.2"/><float name="sheen_tint" value="0.9"/><float name="spec_tint" value="0.15"/><float name="flatness" value="0.25"/>
    <float name="eta" value="1.7"/><float name="main_specular_sampling_rate" value="2"/></bsdf>)"),
      *make_principled(car)));
}

TEST(MitsubaMaterials, NestedMaterials) {
  const MaterialPtr red = make_diffuse(Rgb(0.8f, 0.1f, 0.1f)), blue = make_diffuse(Rgb(0.1f, 0.1f, 0.8f));
  const std::string r = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.8 0.1 0.1"/></bsdf>)",
                    b = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.1 0.8"/></bsdf>)";
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"twosided\">" + r + b + "</bsdf>"), *make_two_sided(red, blue)));
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"twosided\">" + r + "</bsdf>"), *make_two_sided(red)));
  EXPECT_TRUE(
      SameScattering(*imported("<bsdf type=\"blendbsdf\"><float name=\"weight\" value=\"0.25\"/>" + r + b + "</bsdf>"),
                     *make_blend(0.25f, red, blue)));
  EXPECT_TRUE(SameScattering(*imported("<bsdf type=\"mask\"><float name=\"opacity\" value=\"0.3\"/>" + r + "</bsdf>"),
                             *make_mask(0.3f, red)));
  // 0.5 red + 0.25 blue + 0.25 of nothing
  EXPECT_TRUE(SameScattering(
      *imported("<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"0.5, 0.25\"/>" + r + b + "</bsdf>",
                "0.6.0"),
      *make_diffuse(Rgb(0.425f, 0.075f, 0.25f))));
}

TEST(MitsubaMaterials, SubstitutesKeepTheEnergy) {
  // phong and ward: both reflectances survive the blend.
  const MaterialPtr phong = imported(
      R"(<bsdf type="phong"><float name="exponent" value="60"/><rgb name="diffuseReflectance" value="0.3"/><rgb name="specularReflectance" value="0.2"/></bsdf>)",
      "0.6.0", true);
  EXPECT_NEAR(scattering(*phong)[4], scattering(*make_diffuse(0.3f))[4],
              1e-3f);  // away from the highlight only diffuse
  PlasticParams coated;
  coated.int_ior = 1.7f, coated.diffuse_reflectance = 0.4f, coated.nonlinear = true;
  EXPECT_TRUE(SameScattering(
      *imported(
          R"(<bsdf type="coating"><float name="intIOR" value="1.7"/><bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf></bsdf>)",
          "0.6.0", true),
      *make_plastic(coated)));
  EXPECT_TRUE(SameScattering(
      *imported("<bsdf type=\"roughdiffuse\"><float name=\"alpha\" value=\"0.2\"/></bsdf>", "0.6.0", true),
      *make_diffuse(0.5f)));
}

TEST(MitsubaMaterials, ShapesWithoutBsdfAreDiffuseOrBlackIfTheyEmit) {
  EXPECT_TRUE(SameScattering(*imported(""), *make_diffuse(0.5f)));
  EXPECT_TRUE(SameScattering(*imported("<emitter type=\"area\"/>"), *make_diffuse(0.0f)));
}

TEST(MitsubaTextures, BitmapsCheckerboardsAndScales) {
  Folder folder;
  // 2 x 2 gray pixels: 0.25 0.5 in the first row, 0.75 1 in the second.
  folder.write("t.pfm", [] {
    std::string b = "Pf\n2 2\n-1.0\n";  // rows from the bottom
    for (const float v : {0.75f, 1.0f, 0.25f, 0.5f}) b.append(reinterpret_cast<const char*>(&v), 4);
    return b;
  }());
  const auto at = [&](const std::string& texture, const Vec2f& uv, const char* version = "3.0.0") {
    const Scene s =
        folder.load("<shape type=\"disk\"><bsdf type=\"diffuse\">" + texture + "</bsdf></shape>", {}, version);
    EXPECT_TRUE(folder.warnings.empty()) << texture;
    return scattering(*s.shapes[0].material, uv)[1] / scattering(*make_diffuse(1.0f))[1];
  };
  const auto bitmap = [](const std::string& more) {
    return R"(<texture name="reflectance" type="bitmap"><string name="filename" value="t.pfm"/><string name="filter_type" value="nearest"/>)" +
           more + "</texture>";
  };
  // Row 0 is at v = 0.
  EXPECT_NEAR(at(bitmap(""), {0.25f, 0.25f}), 0.25f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {0.75f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {0.25f, 0.75f}), 0.75f, 1e-5f);
  EXPECT_NEAR(at(bitmap(""), {1.25f, 0.25f}), 0.25f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<string name=\"wrap_mode\" value=\"clamp\"/>"), {1.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<string name=\"wrap_mode\" value=\"mirror\"/>"), {1.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(at(bitmap("<transform name=\"to_uv\"><translate x=\"0.5\"/></transform>"), {0.25f, 0.25f}), 0.5f, 1e-5f);
  EXPECT_NEAR(
      at(bitmap("<transform name=\"to_uv\"><scale x=\"3\"/><translate y=\"0.5\"/></transform>"), {0.25f, 0.25f}), 1,
      1e-5f);
  EXPECT_NEAR(at(bitmap("<float name=\"uoffset\" value=\"0.5\"/>"), {0.25f, 0.25f}, "0.6.0"), 0.5f, 1e-5f);
  // 0.6 scales first: 0.75 -> 0.375 -> 0.875; the other order would give 0.625 -> 0.5.
  EXPECT_NEAR(at(bitmap("<float name=\"uscale\" value=\"0.5\"/><float name=\"uoffset\" value=\"-0.2\"/>"),
                 {0.75f, 0.25f}, "0.6.0"),
              0.25f, 1e-5f);
  EXPECT_NEAR(at("<texture name=\"reflectance\" type=\"scale\"><float name=\"scale\" value=\"0.5\"/>" + bitmap("") +
                     "</texture>",
                 {0.75f, 0.25f}, "0.6.0"),
              0.25f, 1e-5f);
  const std::string checker =
      R"(<texture name="reflectance" type="checkerboard"><rgb name="color0" value="0.8"/><rgb name="color1" value="0.1"/></texture>)";
  EXPECT_NEAR(at(checker, {0.2f, 0.2f}), 0.8f, 1e-5f);
  EXPECT_NEAR(at(checker, {0.7f, 0.2f}), 0.1f, 1e-5f);
  EXPECT_NEAR(at(checker, {0.7f, 0.7f}), 0.8f, 1e-5f);
  // The shading point's color attribute has red 0.9.
  EXPECT_NEAR(
      at(R"(<texture name="reflectance" type="mesh_attribute"><string name="name" value="face_color"/><float name="scale" value="0.5"/></texture>)",
         {}),
      0.45f, 1e-5f);
}

TEST(MitsubaTextures, Spectra) {
  Folder folder;
  folder.write("a.spd", "# wavelength value\n400 0.5\n\n700 0.5\n");
  const auto emitted = [&](const std::string& radiance, const char* version = "3.0.0") {
    return folder.load("<emitter type=\"constant\">" + radiance + "</emitter>", {}, version)
        .environments.at(0)
        .radiance.at(0);
  };
  const auto expect_rgb = [](const Rgb& a, const Rgb& b) {
    EXPECT_LT(max_component(a - b) + max_component(b - a), 2e-3f) << a.r << " " << a.g << " " << a.b;
  };
  EXPECT_EQ(emitted(R"(<rgb name="radiance" value="1 2 3"/>)"), Rgb(1, 2, 3));
  EXPECT_EQ(emitted(R"(<rgb name="radiance" value="4"/>)"), Rgb(4.0f));
  EXPECT_EQ(emitted(R"(<float name="radiance" value="4"/>)"), Rgb(4.0f));
  expect_rgb(emitted(R"(<srgb name="radiance" value="#ff8000"/>)", "0.6.0"), Rgb(1, 0.2158605f, 0));
  // An equal-energy spectrum in D65 space; plain white in the 0.6 dialect.
  expect_rgb(emitted(R"(<spectrum name="radiance" value="2"/>)"), Rgb(2.40958f, 1.896582f, 1.817832f));
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" value="2"/>)", "0.6.0"), Rgb(2.0f));
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" value="1, 2, 3"/>)", "0.6.0"), Rgb(1, 2, 3));
  // As Mitsuba 3.9.1 converts it.
  expect_rgb(emitted(R"(<spectrum name="radiance" value="400:0, 500:8, 600:15.6, 700:18.4"/>)") / 20.710836f,
             Rgb(20.710836f, 10.854634f, 2.771152f) / 20.710836f);
  const Rgb file = emitted(R"(<spectrum name="radiance" filename="a.spd"/>)"),
            list = emitted(R"(<spectrum name="radiance" value="400:0.5 700:0.5"/>)");
  EXPECT_EQ(file, list);
  EXPECT_EQ(
      emitted(
          R"(<spectrum name="radiance" type="regular"><float name="wavelength_min" value="400"/><float name="wavelength_max" value="700"/><string name="values" value="0.5 0.5"/></spectrum>)"),
      list);
  EXPECT_EQ(
      emitted(
          R"(<spectrum name="radiance" type="irregular"><string name="wavelengths" value="400 700"/><string name="values" value="0.5 0.5"/></spectrum>)"),
      list);
  expect_rgb(
      emitted(R"(<spectrum name="radiance" type="blackbody"><float name="temperature" value="5000"/></spectrum>)") /
          blackbody_rgb(5000).r,
      blackbody_rgb(5000) / blackbody_rgb(5000).r);
  expect_rgb(emitted(R"(<blackbody name="radiance" temperature="5000K" scale="2"/>)", "0.6.0") / blackbody_rgb(5000).r,
             blackbody_rgb(5000) * 2 / blackbody_rgb(5000).r);
  EXPECT_EQ(emitted(R"(<spectrum name="radiance" type="d65"><float name="scale" value="3"/></spectrum>)"), Rgb(3.0f));
  EXPECT_TRUE(folder.warnings.empty());
  folder.write("bad.spd", "400 1\n300 2\n");
  try {
    emitted(R"(<spectrum name="radiance" filename="bad.spd"/>)");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().line, 2);
    EXPECT_TRUE(e.loc().file.ends_with("bad.spd"));
  }
}

// --- lights ----------------------------------------------------------------------------------------------------------

TEST(MitsubaLights, PunctualLights) {
  Folder folder;
  const Scene s = folder.load(R"(
    <emitter type="point"><point name="position" value="1 2 3"/><rgb name="intensity" value="4 5 6"/></emitter>
    <emitter type="point"><transform name="to_world"><translate y="7"/></transform></emitter>
    <emitter type="spot" id="stage"><float name="cutoff_angle" value="40"/><transform name="to_world"><lookat origin="0 3 0" target="1 3 0" up="0 1 0"/></transform></emitter>
    <emitter type="spot"><float name="cutoff_angle" value="40"/><float name="beam_width" value="10"/></emitter>
    <emitter type="directional"><vector name="direction" value="0 -2 0"/><rgb name="irradiance" value="2"/></emitter>
    <emitter type="projector"><float name="fov" value="60"/><float name="scale" value="2"/></emitter>)");
  ASSERT_EQ(s.lights.size(), 6u);
  const auto pose = [&](std::size_t i) { return s.world(s.lights[i].node, 0); };
  EXPECT_EQ(s.lights[0].type, LightType::kPoint);
  EXPECT_EQ(s.lights[0].intensity.at(0), Rgb(4, 5, 6));
  expect_near(pose(0).translation, {1, 2, 3});
  expect_near(pose(1).translation, {0, 7, 0});
  EXPECT_EQ(s.lights[2].name, "stage");
  expect_near(pose(2).z, {1, 0, 0});
  EXPECT_NEAR(s.lights[2].cutoff_angle.at(0), 40 * kPi / 180, 1e-6);
  EXPECT_NEAR(s.lights[2].beam_width.at(0), 30 * kPi / 180, 1e-6);
  EXPECT_NEAR(s.lights[3].beam_width.at(0), 10 * kPi / 180, 1e-6);
  EXPECT_EQ(s.lights[4].type, LightType::kDirectional);
  expect_near(pose(4).z, {0, -1, 0});
  EXPECT_EQ(s.lights[4].intensity.at(0), Rgb(2.0f));
  EXPECT_EQ(s.lights[5].type, LightType::kProjector);
  EXPECT_NEAR(s.lights[5].projector_fov, kPi / 3, 1e-6);
  EXPECT_NEAR(s.lights[5].intensity.at(0).g, 2 * kPi, 1e-5);
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaLights, AreaLightsBelongToShapes) {
  Folder folder;
  const Scene s = folder.load(R"(
    <emitter type="area" id="glow"><rgb name="radiance" value="3 2 1"/></emitter>
    <shape type="rectangle"><ref id="glow"/></shape>
    <shape type="sphere"><emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>)");
  ASSERT_TRUE(s.shapes[0].emission && s.shapes[1].emission);
  EXPECT_EQ(s.shapes[0].emission->radiance.mean(), Rgb(3, 2, 1));
  EXPECT_EQ(s.shapes[1].emission->radiance.mean(), Rgb(5.0f));
  EXPECT_FALSE(s.shapes[1].emission->two_sided);
  EXPECT_TRUE(s.lights.empty());
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaLights, EnvironmentImages) {
  Folder folder;
  folder.write("e.pfm", [] {
    std::string b = "PF\n2 1\n-1.0\n";
    for (const float v : {1.0f, 2.0f, 3.0f, 4.0f, 5.0f, std::numeric_limits<float>::infinity()})
      b.append(reinterpret_cast<const char*>(&v), 4);
    return b;
  }());
  const Scene s =
      folder.load(R"(<emitter type="envmap"><string name="filename" value="e.pfm"/><float name="scale" value="2"/>
    <transform name="to_world"><scale value="3"/><rotate y="1" angle="90"/><translate x="9"/></transform></emitter>)");
  ASSERT_EQ(s.environments.size(), 1u);
  const Environment& e = s.environments[0];
  EXPECT_EQ(e.width, 2);
  EXPECT_EQ(e.height, 1);
  EXPECT_EQ(e.image[0], Rgb(1, 2, 3));
  EXPECT_EQ(e.image[1], Rgb(4, 5, 0));
  EXPECT_FALSE(folder.warnings.empty());  // about the infinity
  EXPECT_EQ(e.radiance.at(0), Rgb(2.0f));
  expect_near(s.world(e.node, 0).x, {0, 0, -1});
  expect_near(s.world(e.node, 0).translation, {0, 0, 0});
  folder.write("e.pfm", "PF\n2 1\n-1.0\nshort");
  EXPECT_THROW(folder.load(R"(<emitter type="envmap"><string name="filename" value="e.pfm"/></emitter>)"), Error);
}

/// Radiance of Mitsuba 3.9.1's sunsky emitter (rgb variant), turbidity 3, albedo 0.3, sun at (1, 0, 1) / sqrt 2.
TEST(SunSky, RadianceIsMitsubas) {
  SunSkyParams params;
  params.sun_direction = normalize(Vec3d{1, 0, 1});
  const Sky sky(params);
  const struct {
    Vec3d d;
    Rgb value;
  } expected[] = {{{0, 0, 1}, {0.02374932f, 0.04151599f, 0.0840942f}},
                  {{1, 1, 1}, {0.06086959f, 0.09332516f, 0.1535218f}},
                  {{-1, 0, 0.05}, {0.1599004f, 0.2209357f, 0.268591f}},
                  {{0.5, -0.3, 0.8}, {0.06480926f, 0.08981293f, 0.1389715f}},
                  {{0.9, 0.1, 0.9}, {0.169314f, 0.193323f, 0.226814f}}};
  for (const auto& e : expected) {
    const Rgb value = sky.radiance(normalize(e.d));
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(value[c] / e.value[c], 1, 1e-4);
  }
  EXPECT_EQ(sky.radiance({0, 0.8, -0.6}), Rgb());
}

TEST(SunSky, ImageHoldsTheSunsPower) {
  for (const double elevation : {8.0, 30.0, 75.0, 89.95}) {
    for (const double aperture : {0.001, 0.5358, 4.0}) {
      SunSkyParams params;
      params.sun_direction = {std::cos(elevation * kPiD / 180) * 0.6, std::cos(elevation * kPiD / 180) * 0.8,
                              std::sin(elevation * kPiD / 180)};
      params.sky_scale = 0;
      params.sun_aperture = aperture;
      constexpr int kWidth = 512, kHeight = 256;
      const std::vector<Rgb> image = sun_sky_image(params, kWidth);
      Vec3d sum, centre;
      for (int y = 0; y < kHeight; ++y) {
        const double row = 2 * kPiD / kWidth * (std::cos(kPiD * y / kHeight) - std::cos(kPiD * (y + 1) / kHeight));
        for (int x = 0; x < kWidth; ++x) {
          const Rgb& c = image[std::size_t(y * kWidth + x)];
          sum += Vec3d{c.r, c.g, c.b} * row;
          const double phi = 2 * kPiD * (x + 0.5) / kWidth, theta = kPiD * (y + 0.5) / kHeight;
          centre +=
              Vec3d{std::sin(theta) * std::sin(phi), std::sin(theta) * std::cos(phi), std::cos(theta)} * (c.g * row);
        }
      }
      const Rgb sun = sun_irradiance(params);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c] / sun[c], 1, 1e-4) << elevation << " " << aperture;
      EXPECT_GT(dot(normalize(centre), params.sun_direction), std::cos(0.5 * kPiD / 180))
          << elevation << " " << aperture;
    }
  }
}

/// Irradiance of the sun by Mitsuba 3.9.1's spectral variant, integrated over the disc and the observer.
TEST(SunSky, SunHasThePowerOfTheSpectralModel) {
  const struct {
    double turbidity, elevation;
    Rgb value;
  } expected[] = {{1, 20, {1.3081f, 0.94850f, 0.53852f}},
                  {3, 45, {1.39454f, 1.11986f, 0.81894f}},
                  {3, 5, {0.60505f, 0.26790f, 0.04043f}},
                  {10, 70, {0.94655f, 0.74832f, 0.59325f}}};
  for (const auto& e : expected) {
    SunSkyParams params;
    params.turbidity = e.turbidity;
    params.sun_direction = {std::cos(e.elevation * kPiD / 180), 0, std::sin(e.elevation * kPiD / 180)};
    const Rgb value = sun_irradiance(params);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(value[c], e.value[c], 0.003 * e.value.r);
  }
}

TEST(SunSky, PositionFollowsTheAlmanac) {
  // Solar noon at the equator on the equinox: the sun stands in the zenith.
  EXPECT_LT(sun_position({2024, 3, 20, 12, 7, 20, 0, 0, 0}).zenith, 0.3 * kPiD / 180);
  // Greenwich, 21 June 2024, 12:02 UT: elevation 90 - 51.48 + 23.44 = 61.96 degrees, due south.
  const SunAngles noon = sun_position({2024, 6, 21, 12, 1, 50, 51.48, 0, 0});
  EXPECT_NEAR(noon.zenith * 180 / kPiD, 28.04, 0.05);
  EXPECT_NEAR(std::abs(noon.azimuth) * 180 / kPiD, 180, 0.5);
  // In the morning it stands in the east.
  const SunAngles morning = sun_position({2024, 6, 21, 8, 0, 0, 51.48, 0, 0});
  EXPECT_GT(morning.azimuth * 180 / kPiD, 80);
  EXPECT_LT(morning.azimuth * 180 / kPiD, 110);
}

TEST(SunSky, EmittersPlaceTheSun) {
  Folder folder;
  const auto brightest = [&](const std::string& emitter, const char* version = "3.0.0") {
    const Scene s = folder.load(emitter, {}, version);
    const Environment& e = s.environments.at(0);
    std::size_t best = 0;
    for (std::size_t i = 0; i < e.image.size(); ++i)
      if (e.image[i].g > e.image[best].g) best = i;
    const double u = (double(best % std::size_t(e.width)) + 0.5) / e.width * 2 * kPiD,
                 v = (double(best / std::size_t(e.width)) + 0.5) / e.height * kPiD;
    return s.world(e.node, 0).vector({std::sin(v) * std::sin(u), std::cos(v), -std::sin(v) * std::cos(u)});
  };
  const Vec3d d = normalize(Vec3d{0.3, 0.5, 0.4});
  EXPECT_LT(
      length(brightest(R"(<emitter type="sunsky"><vector name="sun_direction" value="0.3 0.5 0.4"/></emitter>)") - d),
      0.005);
  // z up turned to y up; the direction is in world space.
  EXPECT_LT(
      length(
          brightest(
              R"(<emitter type="sunsky"><vector name="sun_direction" value="0.3 0.5 0.4"/><transform name="to_world"><rotate x="1" angle="-90"/></transform></emitter>)") -
          d),
      0.005);
  EXPECT_LT(length(brightest(R"(<emitter type="sunsky"><vector name="sunDirection" value="0.3 0.5 0.4"/></emitter>)",
                             "0.6.0") -
                   d),
            0.005);
  // 0.6 has north along -z; on a July noon in Tokyo the sun stands south, high up.
  const Vec3d noon = brightest(R"(<emitter type="sunsky"><float name="hour" value="11.8"/></emitter>)", "0.6.0");
  EXPECT_GT(noon.z, 0.15);
  EXPECT_GT(noon.y, 0.95);
  // Mitsuba 3's default sun: Tokyo, 10 July 2010, 15 h.
  EXPECT_LT(length(brightest(R"(<emitter type="sunsky"/>)") - Vec3d{0.051385, 0.691748, 0.720308}), 0.005);
}

// --- cameras ---------------------------------------------------------------------------------------------------------

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

// --- published scenes ------------------------------------------------------------------------------------------------

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
    for (const int index : s.groups[std::size_t(i.group)]) {
      const Shape& shape = s.shapes[std::size_t(index)];
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
    if (const auto* disk = std::get_if<Disk>(&a.shapes[i].geometry)) {
      const Affine3f &p = disk->object_from_unit, &q = std::get<Disk>(b.shapes[i].geometry).object_from_unit;
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
