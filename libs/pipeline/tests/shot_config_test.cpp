// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/shot_config.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <set>

namespace tempera {
namespace {

ShotConfig read(const std::string& text) {
  ShotConfig config;
  config.read_text(text, "shot.toml", "folder");
  return config;
}

/// The error that reading `text` ends with.
Error error_of(const std::string& text) {
  try {
    read(text);
  } catch (const Error& e) {
    return e;
  }
  return Error(ErrorCode::kFailed, "nothing was thrown");
}

TEST(ShotConfig, ReadsEveryKindOfValue) {
  const ShotConfig c = read(
      "scene = \"a.xml\"\n"
      "fps = 25\n"  // an integer where a number is expected
      "[film]\nresolution = [640, 360]\n"
      "[sampling]\nspp = 12\nseed_per_frame = false\n"
      "[integrator]\nname = \"path\"\nmax_depth = 7\n"
      "[classes]\ndd = \"ED\"\n"
      "[materials.\"My Glass\"]\ntype = \"dielectric\"\nint_ior = 1.4\nreflectance = [1, 0.5, 0]\n");
  EXPECT_EQ(c.get_double("fps"), 25);
  EXPECT_EQ(c.get_string("film.resolution"), "640,360");
  EXPECT_EQ(c.get_int("sampling.spp"), 12);
  EXPECT_FALSE(c.get_bool("sampling.seed_per_frame"));
  EXPECT_EQ(c.input_path("scene"), std::filesystem::path("folder/a.xml"));
  EXPECT_EQ(c.get_string("camera"), "") << "the default";
  EXPECT_EQ(c.find("camera"), nullptr);
  const auto integrator = c.table("integrator");
  ASSERT_EQ(integrator.size(), 1u) << "`name` is a key of its own";
  EXPECT_EQ(std::get<int>(integrator.at({"max_depth"}).value), 7);
  EXPECT_EQ(integrator.at({"max_depth"}).loc.line, 10);
  EXPECT_EQ(std::get<std::string>(c.table("classes").at({"dd"}).value), "ED");
  const auto materials = c.table("materials");
  EXPECT_EQ(std::get<double>(materials.at({"My Glass", "int_ior"}).value), 1.4);
  EXPECT_EQ(std::get<std::string>(materials.at({"My Glass", "reflectance"}).value), "1,0.5,0");
}

TEST(ShotConfig, CommandLineReplacesTheFile) {
  ShotConfig c = read("[sampling]\nspp = 12\n[film]\nfilter = \"tent\"\n");
  c.set_text("sampling.spp", "99");
  c.assign("materials.\"My.Glass\".type=dielectric");
  c.assign("materials.\"a=b\".type=diffuse");
  EXPECT_EQ(c.get_int("sampling.spp"), 99);
  EXPECT_EQ(c.loc("sampling.spp").file, "<command line>");
  EXPECT_EQ(std::get<int>(c.find_in_file("sampling.spp")->value), 12);
  EXPECT_EQ(c.find_in_file("film.resolution"), nullptr);
  EXPECT_EQ(c.get_string("film.filter"), "tent");
  EXPECT_EQ(to_text(c.table("materials").at({"My.Glass", "type"}).value), "dielectric");
  EXPECT_EQ(to_text(c.table("materials").at({"a=b", "type"}).value), "diffuse");
  c.set_text("scene", "here.xml");
  EXPECT_EQ(c.input_path("scene"), std::filesystem::path("here.xml")) << "relative to the current directory";
}

/// Values by key as text, whatever gave them.
std::map<std::string, std::string> values_of(const ShotConfig& c) {
  std::map<std::string, std::string> out;
  for (const ShotKey& k : shot_keys()) {
    if (const ShotValue* v = c.find(k.spec.name)) out[k.spec.name] = to_text(v->value);
  }
  for (const OpenTable& t : shot_tables()) {
    for (const auto& [key, value] : c.table(t.name)) {
      std::string name = t.name;
      for (const std::string& part : key) name += "/" + part;
      out[name] = to_text(value.value);
    }
  }
  return out;
}

TEST(ShotConfig, SetTakesWhatTheFileTakes) {
  // Each a line of a file without tables.
  for (const char* line : {"shutter.curve=[0, 1, 1, 0]",
                           "shutter.curve = [ 0.0, 0.5,1.0 ]",
                           "film.resolution=[640, 360]",
                           "film.crop = [1, 2, 30, 40]",
                           "environment.radiance=[1, 0.5, 0.25]",
                           "environment.radiance=2",
                           "environment.radiance=[0.5]",
                           "output.layers=[\"albedo\", 'normal']",
                           "output.layers=\"motion\"",
                           "frames=[1, 5, \"7-9\"]",
                           "frames=\"1-24\"",
                           "camera=\"Main Camera\"",
                           "camera='0'",
                           "fps=23.976",
                           "fps=1_0",
                           "first_frame=+3",
                           "sampling.seed=0x10",
                           "sampling.seed_per_frame=false",
                           "output.half=true",
                           "fps=1e2",
                           "film={resolution=[64, 48], scale=50, filter=\"tent\"}",
                           "classes={dd=\"ED\", s=\"E[RT]+\"}",
                           "materials.\"My.Glass\"={type=\"dielectric\", int_ior=1.5}",
                           "materials.'a=b'.reflectance=[1, 0.5, 0]",
                           "materials={G={type=\"diffuse\"}}",
                           "integrator={name=\"path\", max_depth=5}",
                           "integrator.max_depth=5",
                           "define.name=\"a, b\"",
                           "video={path=\"a.mp4\", crf=20}",
                           "reconstruct.norm=\"l2\"",
                           "\"film\".\"scale\"=50"}) {
    ShotConfig typed;
    ASSERT_NO_THROW(typed.assign(line)) << line;
    EXPECT_EQ(values_of(typed), values_of(read(line))) << line;
    EXPECT_FALSE(values_of(typed).empty()) << line;
  }
}

TEST(ShotConfig, SetTakesBareText) {
  const auto value = [](const char* text, const char* key) {
    ShotConfig c;
    c.assign(text);
    return to_text(c.find(key)->value);
  };
  EXPECT_EQ(value("film.resolution=640x360", "film.resolution"), "640x360");
  EXPECT_EQ(value("frames=1-24", "frames"), "1-24");
  EXPECT_EQ(value("camera=0x10", "camera"), "0x10") << "a name";
  EXPECT_EQ(value("camera=1979-05-27", "camera"), "1979-05-27");
  EXPECT_EQ(value("output.path=out/a b/f.exr", "output.path"), "out/a b/f.exr");
  EXPECT_EQ(value("first_frame=0010", "first_frame"), "10");
  EXPECT_EQ(value("sampling.seed_per_frame=off", "sampling.seed_per_frame"), "false");
}

TEST(ShotConfig, SetRefusesWhatTheFileRefuses) {
  for (const char* line :
       {"sampling.spp=[1]", "sampling.spp=\"4\"", "sampling.spp={a=1}", "film.crop=[1, [2]]", "film.crop=[1, 2",
        "camera=\"a", "film={scale=0}", "film={resolutoin=[1, 2]}", "flim={scale=50}", "film.filter={name=\"box\"}",
        "sampling.seed=9999999999", "fps=1979-05-27", "camera=[\"a\"]", "integrator={a={b=1}}", "materials.G=[1, 2]"}) {
    ShotConfig c;
    try {
      c.assign(line);
      ADD_FAILURE() << "accepted " << line;
    } catch (const Error& e) {
      EXPECT_EQ(e.loc().file, "<command line>") << line;
      EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << e.what();
    }
    EXPECT_THROW(read(line), Error) << line;
  }
  ShotConfig c;
  EXPECT_THROW(c.assign("film.crop=[1, 2, 3, 4]\nsampling.spp=3"), Error) << "one at a time";
}

struct Bad {
  const char* text;
  ErrorCode code;
  int line, column;
  const char* says;
};
class ShotConfigErrors : public testing::TestWithParam<Bad> {};

TEST_P(ShotConfigErrors, NamesPlaceAndRemedy) {
  const Bad& bad = GetParam();
  const Error e = error_of(bad.text);
  EXPECT_EQ(e.code(), bad.code) << e.what();
  EXPECT_EQ(e.loc().file, "shot.toml");
  EXPECT_EQ(e.loc().line, bad.line) << e.what();
  EXPECT_EQ(e.loc().column, bad.column) << e.what();
  EXPECT_NE(e.message().find(bad.says), std::string::npos) << e.what();
}

INSTANTIATE_TEST_SUITE_P(
    All, ShotConfigErrors,
    testing::Values(Bad{"scene = \"a\"\ncamra = \"b\"\n", ErrorCode::kUnknownName, 2, 1, "known: camera"},
                    Bad{"[film]\nresolutoin = [1, 2]\n", ErrorCode::kUnknownName, 2, 1, "known: film.resolution"},
                    Bad{"[reconstruct]\nalhpa = 1\n", ErrorCode::kUnknownName, 2, 1,
                        "known: reconstruct.alpha, reconstruct.path, "},
                    Bad{"[reconstruct]\nnorm = \"l3\"\n", ErrorCode::kUnknownName, 2, 8, "l1, l2"},
                    Bad{"[flim]\nfilter = \"box\"\n", ErrorCode::kUnknownName, 1, 2, "known: film"},
                    Bad{"[film.filter]\nname = \"box\"\n", ErrorCode::kUnknownName, 1, 7, "unknown table"},
                    Bad{"[sampling]\nspp = \"many\"\n", ErrorCode::kBadInput, 2, 7, "expected an integer"},
                    Bad{"[sampling]\nspp = 0\n", ErrorCode::kOutOfRange, 2, 7, "between 1 and"},
                    Bad{"[sampling]\nspp = [1]\n", ErrorCode::kBadInput, 2, 7, "is an array"},
                    Bad{"[sampling]\nseed = 9999999999\n", ErrorCode::kOutOfRange, 2, 8, "32 bits"},
                    Bad{"[sampling]\nsampler = \"halton\"\n", ErrorCode::kUnknownName, 2, 11, "sobol"},
                    Bad{"fps = 1979-05-27\n", ErrorCode::kBadInput, 1, 7, "date"},
                    Bad{"[film]\nresolution = [1, [2]]\n", ErrorCode::kBadInput, 2, 18, "array"},
                    Bad{"scene = \"a\nb\"\n", ErrorCode::kSyntax, 1, 11, ""},
                    Bad{"[classes.a]\nb = \"ED\"\n", ErrorCode::kUnknownName, 1, 10, "unknown table"},
                    Bad{"[materials]\nGlass = \"dielectric\"\n", ErrorCode::kUnknownName, 2, 1,
                        "materials.<material>.<parameter>"}));

TEST(ShotConfig, CommandLineErrorsNameTheCommandLine) {
  ShotConfig c;
  const auto code = [&](const char* text) {
    try {
      c.assign(text);
    } catch (const Error& e) {
      EXPECT_EQ(e.loc().file, "<command line>") << text;
      return e.code();
    }
    return ErrorCode::kFailed;
  };
  EXPECT_EQ(code("sampling.sppp=3"), ErrorCode::kUnknownName);
  EXPECT_EQ(code("sampling.spp"), ErrorCode::kUsage);
  EXPECT_EQ(code("sampling.spp=x"), ErrorCode::kBadInput);
  EXPECT_EQ(code("=3"), ErrorCode::kUsage);
  EXPECT_EQ(code("a..b=3"), ErrorCode::kSyntax);
  EXPECT_EQ(code("materials.\"Glass.ior=3"), ErrorCode::kUsage) << "the quote never ends, so there is no =";
}

TEST(ShotConfig, TableIsConsistent) {
  std::set<std::string> names, flags;
  for (const ShotKey& k : shot_keys()) {
    EXPECT_TRUE(names.insert(k.spec.name).second) << k.spec.name;
    EXPECT_FALSE(k.spec.help.empty()) << k.spec.name;
    EXPECT_TRUE(k.flag.empty() || flags.insert(k.flag).second) << k.flag;
    Params p(std::span(&k.spec, 1));
    if (k.spec.choices.empty()) continue;
    EXPECT_NO_THROW(p.set(k.spec.name, k.spec.fallback)) << "default of " << k.spec.name;
  }
  for (const OpenTable& t : shot_tables()) {
    EXPECT_TRUE(t.depth == 1 || t.depth == 2);
    EXPECT_FALSE(names.contains(t.name)) << t.name;
  }
}

}  // namespace
}  // namespace tempera
