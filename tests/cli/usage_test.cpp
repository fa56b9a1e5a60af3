// SPDX-License-Identifier: Apache-2.0
// What the program says and how it ends when it is asked wrongly, or asked for help.
#include <fmt/format.h>

#include <map>
#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

const std::string kScene = source_file("scenes/tests/cornell.xml");

TEST(Cli, Version) {
  const Outcome o = run({"--version"});
  EXPECT_EQ(o.status, 0);
  EXPECT_EQ(o.out.rfind("tempera " TEMPERA_VERSION " (", 0), 0u) << o.out;
  EXPECT_NE(o.out.find("Embree 3."), std::string::npos) << o.out;
  EXPECT_NE(o.out.find("OpenImageIO 2."), std::string::npos) << o.out;
}

TEST(Cli, HelpHasExamplesForEveryCommand) {
  const Outcome top = run({"--help"});
  EXPECT_EQ(top.status, 0);
  for (const char* command : {"render", "run", "info", "list", "reconstruct", "video", "compare", "gallery"}) {
    EXPECT_NE(top.out.find(fmt::format("\n  {} ", command)), std::string::npos) << command;
    const Outcome o = run({command, "--help"});
    EXPECT_EQ(o.status, 0) << command;
    EXPECT_NE(o.out.find(fmt::format("Examples:\n  tempera {} ", command)), std::string::npos) << o.out;
  }
}

TEST(Cli, WrongUsageIsStatusTwoAndOneLine) {
  const std::vector<std::vector<std::string>> wrong = {
      {},
      {"rendr"},
      {"render"},
      {"render", kScene, "--frobnicate"},
      {"render", kScene},  // no output
      {"render", kScene, "-o", "/nowhere/f.exr", "--frames", "5-1"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--frames", "abc"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--spp", "many"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--spp", "0"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--integrator", "pathh"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--layers", "colour"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--param", "depth=3"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--param", "max_depth"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--set", "film.resolutoin=3x4"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--set", "film.resolution"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--camera", "nobody"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--class", "dd=ED("},
      {"render", kScene, "-o", "/nowhere/f.exr", "--decompose", "a=ED;b=E."},
      {"render", kScene, "-o", "/nowhere/f.exr", "--filter", "sharp"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--shutter", "0.5"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--crop", "1,2,3"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--progress", "loud"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--tev", "host:port"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--memory-limit", "lots"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--replay", "1,2,3"},
      {"render", kScene, "-o", "/nowhere/f.exr", "--aov-names", "maya"},
      {"list", "films"},
      {"compare", "a.exr"},
      {"compare", "a.exr", "--reference", "b.exr", "--metrics", "pnsr"},
      {"compare", "a.exr", "--reference", "b.exr", "--threshold", "flip"},
  };
  for (const auto& arguments : wrong) {
    const Outcome o = run(arguments);
    EXPECT_EQ(o.status, 2) << fmt::format("{}", fmt::join(arguments, " ")) << "\n" << o.err;
    EXPECT_EQ(o.err.rfind("tempera: ", 0), 0u) << o.err;
    EXPECT_EQ(std::count(o.err.begin(), o.err.end(), '\n'), 1) << o.err;
  }
}

TEST(Cli, UnknownNamesComeWithTheNearestKnown) {
  EXPECT_NE(run({"render", kScene, "-o", "x.exr", "--integrator", "pathh"}).err.find("known: path"), std::string::npos);
  EXPECT_NE(run({"render", kScene, "-o", "x.exr", "--set", "film.resolutoin=1x1"}).err.find("known: film.resolution"),
            std::string::npos);
  EXPECT_NE(run({"render", kScene, "-o", "x.exr", "--layers", "albdo"}).err.find("albedo"), std::string::npos);
}

TEST(Cli, UnknownCommandsFlagsAndArgumentsAreNamed) {
  struct Case {
    std::vector<std::string> arguments;
    const char* says;
  };
  for (const Case& c : {
           Case{{"upscale", "x.exr"}, "unknown command \"upscale\" of tempera; known: "},
           Case{{"rendr", "x.xml"}, "unknown command \"rendr\" of tempera; known: render, "},
           Case{{"-q", "vidoe"}, "unknown command \"vidoe\" of tempera; known: video, "},
           Case{{"gallery", "rnu", "x"}, "unknown command \"rnu\" of tempera gallery; known: run, "},
           Case{{}, "tempera needs a command; one of: render, run, info"},
           Case{{"gallery"}, "tempera gallery needs a command; one of: list, make, run, reference"},
           Case{{"render", kScene, "--resolutoin", "8x8"},
                "unknown flag --resolutoin of tempera render; the nearest known: --resolution"},
           Case{{"render", "--resoluton=8x8"},
                "unknown flag --resoluton of tempera render; the nearest known: --resolution"},
           Case{{"compare", "a.exr", "--referense", "b.exr"},
                "unknown flag --referense of tempera compare; the nearest known: --reference"},
           Case{{"gallery", "run", "x", "--sp", "3"},
                "unknown flag --sp of tempera gallery run; the nearest known: --spp"},
           Case{{"render", kScene, "b.xml"},
                "\"b.xml\" is one argument too many for tempera render; usage: tempera render SHOT"},
           Case{{"run", kScene, "b.xml", "c.xml"}, "\"b.xml\" is one argument too many for tempera run"},
           Case{{"video", "a", "b.mp4", "c"},
                "\"c\" is one argument too many for tempera video; usage: tempera video IN OUT"},
           Case{{"list", "layers", "bsdfs"}, "\"bsdfs\" is one argument too many for tempera list"},
           Case{{"gallery", "list", "x"}, "\"x\" is one argument too many for tempera gallery list, which takes none"},
           Case{{"render"}, "tempera render: "},
           Case{{"video", "a"}, "tempera video: "},
           Case{{"reconstruct", "a"}, "tempera reconstruct: "},
           Case{{"render", kScene, "--threads", "many"}, "tempera render: "},
       }) {
    const Outcome o = run(c.arguments);
    EXPECT_EQ(o.status, 2);
    EXPECT_EQ(o.err.rfind(std::string("tempera: ") + c.says, 0), 0u) << o.err;
    EXPECT_EQ(std::count(o.err.begin(), o.err.end(), '\n'), 1) << o.err;
  }
}

using CliFiles = CliTest;

TEST_F(CliFiles, MalformedInputIsStatusThreeWithItsPlace) {
  struct Case {
    const char* name;
    const char* text;
    const char* place;
  };
  for (const Case& c : {Case{"a.xml", "<scene version=\"3.0.0\">\n  <shape type=\"sphere\">\n</scene>\n", "a.xml:"},
                        Case{"b.xml",
                             "<scene version=\"3.0.0\">\n  <bsdf type=\"diffuse\">\n    <rgb name=\"reflectance\" "
                             "value=\"1, x\"/>\n  </bsdf>\n</scene>\n",
                             "b.xml:3:"},
                        Case{"c.gltf", "{\n  \"asset\": {\"version\": \"2.0\"},\n  \"nodes\": 5\n}\n", "c.gltf:3:"},
                        Case{"d.toml", "scene = \"x.xml\"\n[film\n", "d.toml:2:"},
                        Case{"e.toml", "scene = \"x.xml\"\n\n[film]\nfilter = \"sharp\"\n", "e.toml:4:10: "},
                        Case{"f.toml", "[sampling]\nspp = 4\n", "f.toml: "}}) {
    const Outcome o = run({"render", write(c.name, c.text), "-o", path("f.exr")});
    EXPECT_EQ(o.status, 3) << c.name << "\n" << o.err;
    EXPECT_NE(o.err.find(c.place), std::string::npos) << o.err;
    EXPECT_FALSE(fs::exists(path("f.0000.exr")));
  }
}

TEST_F(CliFiles, ErrorsShowTheLineWithACaret) {
  const Outcome o = run({"info", write("shot.toml", "scene = \"x.xml\"\nfps = \"fast\"\n")});
  EXPECT_NE(o.err.find("\n  fps = \"fast\"\n        ^\n"), std::string::npos) << o.err;
}

TEST_F(CliFiles, MissingFilesAreStatusFour) {
  for (const std::string& file : {path("none.xml"), path("none.gltf"), path("none.toml"), path("none.abc")}) {
    const Outcome o = run({"info", file});
    EXPECT_EQ(o.status, 4) << o.err;
    EXPECT_NE(o.err.find(file), std::string::npos) << o.err;
  }
  const Outcome named = run({"info", write("shot.toml", "# a shot\nscene = \"none.xml\"\n")});
  EXPECT_EQ(named.status, 4);
  EXPECT_NE(named.err.find("shot.toml:2:9: "), std::string::npos) << named.err;
  EXPECT_EQ(run({"video", path("none.####.exr"), path("a.mp4")}).status, 4);
  EXPECT_EQ(run({"compare", path("a.exr"), "--reference", path("b.exr")}).status, 4);
  EXPECT_EQ(run({"info", write("a.abc", "x")}).status, 3) << "a file that is there but is no scene";
}

TEST_F(CliFiles, UnsupportedIsAWarningUnlessStrict) {
  const std::string scene =
      write("a.xml",
            "<scene version=\"3.0.0\">\n<sensor type=\"perspective\"/>\n"
            "<shape type=\"sphere\"><float name=\"frobnication\" value=\"1\"/></shape>\n</scene>\n");
  const Outcome lax = run({"info", scene, "--json"});
  ASSERT_EQ(lax.status, 0) << lax.err;
  const auto unsupported = nlohmann::json::parse(lax.out).at("unsupported");
  ASSERT_EQ(unsupported.size(), 1u);
  EXPECT_NE(unsupported[0].get<std::string>().find("a.xml:3"), std::string::npos) << unsupported;
  const Outcome strict = run({"info", scene, "--strict"});
  EXPECT_EQ(strict.status, 3);
  EXPECT_NE(strict.err.find("a.xml:3"), std::string::npos) << strict.err;
}

TEST(Cli, InfoCountsWhatIsThere) {
  const Outcome o = run({"info", source_file("scenes/tests/cornell_motion.xml"), "--json"});
  ASSERT_EQ(o.status, 0) << o.err;
  const auto j = nlohmann::json::parse(o.out);
  ASSERT_EQ(j.at("cameras").size(), 1u);
  EXPECT_TRUE(j.at("cameras")[0].at("animated"));
  EXPECT_EQ(j.at("time").at("end"), 1.0);
  EXPECT_EQ(j.at("lights").at("area"), 1);
  EXPECT_EQ(j.at("shapes").at("spheres"), 1);
  EXPECT_EQ(j.at("shot").at("spp"), 64);
  EXPECT_EQ(j.at("unsupported").size(), 0u);
  const Outcome text = run({"info", source_file("scenes/tests/cornell_motion.xml")});
  EXPECT_NE(text.out.find("39.31 degrees wide, animated (default)"), std::string::npos) << text.out;
}

TEST(Cli, ListShowsTablesWithParameters) {
  const Outcome o = run({"list", "integrators", "--json"});
  ASSERT_EQ(o.status, 0);
  const auto j = nlohmann::json::parse(o.out);
  EXPECT_EQ(j.at("integrators")[0].at("name"), "path");
  EXPECT_EQ(j.at("integrators")[0].at("parameters")[0].at("name"), "max_depth");
  for (const char* category : {"layers", "filters", "samplers", "stages", "importers", "bsdfs", "metrics"}) {
    EXPECT_EQ(run({"list", category}).status, 0) << category;
  }
}

TEST(Cli, ListShowsTheManualOfStages) {
  const auto j = nlohmann::json::parse(run({"list", "stages", "--json"}).out).at("stages");
  ASSERT_EQ(j.at(0).at("name"), "reconstruct");
  std::map<std::string, int> rows;
  for (const auto& row : j.at(0).at("manual")) ++rows[row.at("what")];
  EXPECT_EQ(rows["port in"], 1);
  EXPECT_GE(rows["reads"], 3);
  EXPECT_GE(rows["writes"], 2);
  EXPECT_EQ(rows["frames that it reads to make one"], 1);
  EXPECT_NE(run({"list", "stages"}).out.find("reads: color, grad.x, grad.y: needed"), std::string::npos);
}

/// A page as a program that was built without motion of chains writes it.
std::string without_chain_motion(const std::string& page) {
  std::istringstream lines(page);
  std::string kept;
  for (std::string line; std::getline(lines, line);) {
    if (!line.starts_with("| `chain.<letters>.motion") && !line.starts_with("| `chain_motion`")) kept += line + "\n";
  }
  return kept;
}

TEST_F(CliFiles, GeneratedPagesAreCurrent) {
  ASSERT_EQ(run({"docs", "--out", folder_.string()}).status, 0);
  for (const char* page : {"commands.md", "shot.md", "gallery.md"}) {
    const std::string whole = text_of(source_file(std::string("docs/") + page));
    EXPECT_EQ(text_of(path(page)), layers::chain_motion().empty() ? without_chain_motion(whole) : whole)
        << "docs/" << page << " is out of date; run: tempera docs --out docs";
  }
}

}  // namespace
}  // namespace tempera::test
