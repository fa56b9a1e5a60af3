// SPDX-License-Identifier: Apache-2.0
#include "mitsuba_test_util.h"

namespace tempera {
namespace {

TEST(MitsubaXml, DefaultsAndDefinesFillInParameters) {
  const std::string inner = R"(
    <default name="r" value="2"/> <default name="rx" value="3"/> <default name="kind" value="sphere"/>
    <shape type="$kind"><float name="radius" value="$rx.5"/><point name="center" value="$r 0 \$"/></shape>)";
  Folder folder;
  EXPECT_THROW(folder.load(inner), Error);  // an escaped dollar sign stays one
  const std::string good = inner.substr(0, inner.find(" \\$")) + " 0" + inner.substr(inner.find("\"/></shape>"));
  const Affine3f m = std::get<AnalyticShape>(folder.load(good).shapes[0].geometry).object_from_unit;
  EXPECT_EQ(m.x.x, 3.5f);
  EXPECT_EQ(m.translation.x, 2);
  const Scene s = folder.load(good, {.defines = {{"r", "7"}, {"unused", "1"}}});
  EXPECT_EQ(std::get<AnalyticShape>(s.shapes[0].geometry).object_from_unit.translation.x, 7);
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

}  // namespace
}  // namespace tempera
