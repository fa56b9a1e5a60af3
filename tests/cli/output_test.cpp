// SPDX-License-Identifier: Apache-2.0
// What output is called, what is refused before a ray is traced, and what a user is told of what follows.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

class CliOutput : public CliTest {
 protected:
  /// Renders next to nothing.
  Outcome render(const std::string& output, const std::vector<std::string>& more = {}, const char* command = "render") {
    std::vector<std::string> arguments{
        command, source_file("scenes/tests/cornell_motion.xml"), "-o", path(output), "--resolution", "8x6", "--spp",
        "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  }
  /// Files below the test's folder, in order.
  std::vector<std::string> files() const {
    std::vector<std::string> out;
    for (const auto& e : fs::recursive_directory_iterator(folder_)) {
      if (e.is_regular_file()) out.push_back(e.path().lexically_relative(folder_).string());
    }
    std::sort(out.begin(), out.end());
    return out;
  }
};
using Files = std::vector<std::string>;

TEST_F(CliOutput, OneFrameIsOneFileAndSeveralAreNumbered) {
  ASSERT_EQ(render("a.exr", {"--frames", "5"}).status, 0);
  EXPECT_EQ(files(), Files{"a.exr"});
  EXPECT_EQ(std::get<int>(read_metadata(path("a.exr")).at("tempera/frame")), 5);
  EXPECT_NE(render("a.exr", {"--frames", "5", "--resume"}).err.find("1 already finished"), std::string::npos);
  const Outcome two = render("a.exr", {"--frames", "1-2"});
  ASSERT_EQ(two.status, 0);
  EXPECT_NE(two.err.find("frames 1-2 (2 frames), to " + path("a.####.exr")), std::string::npos) << two.err;
  EXPECT_EQ(files(), (Files{"a.0001.exr", "a.0002.exr", "a.exr"}));
}

// Motion of chains is an option of the build: its names are there or nowhere.
TEST_F(CliOutput, ChainMotionIsThereOrSaidToBeMissing) {
  const Outcome listed = run({"list", "layers"}),
                asked = render("a.exr", {"--frames", "1", "--layers", "chain_motion"});
  if (layers::chain_motion().empty()) {
    EXPECT_EQ(listed.out.find("chain_motion"), std::string::npos);
    EXPECT_EQ(listed.out.find(".motion.state"), std::string::npos);
    EXPECT_EQ(asked.status, 2);
    EXPECT_NE(asked.err.find("-DTEMPERA_PATH_SPACE_MOTION=ON"), std::string::npos) << asked.err;
    EXPECT_TRUE(files().empty());
    return;
  }
  EXPECT_NE(listed.out.find("chain.<letters>.motion.state"), std::string::npos) << listed.out;
  ASSERT_EQ(asked.status, 0) << asked.err;
  const auto desc = read_frame(path("a.exr")).layer("chain.TTTTD.motion.state");
  EXPECT_EQ(desc.channels(), 2);
}

TEST_F(CliOutput, PatternsAndFolders) {
  for (const char* pattern :
       {"h/f.####.exr", "a/f.@@@@.exr", "p/f.%04d.exr", "s/f.$F4.exr", "k/f.<F4>.exr", "n/f.####"}) {
    ASSERT_EQ(render(pattern, {"--frames", "3"}).status, 0) << pattern;
  }
  ASSERT_EQ(render("folder", {"--frames", "3"}).status, 0);
  ASSERT_EQ(render("v.2/", {"--frames", "3"}).status, 0);
  EXPECT_EQ(files(), (Files{"a/f.0003.exr", "folder/cornell_motion.0003.exr", "h/f.0003.exr", "k/f.0003.exr",
                            "n/f.0003.exr", "p/f.0003.exr", "s/f.0003.exr", "v.2/cornell_motion.0003.exr"}));
}

TEST_F(CliOutput, OtherFormatsAreRefusedWithTheNameThatWouldDo) {
  ASSERT_EQ(render("in/f.####.exr", {"--frames", "1-2", "--integrator", "gradient_path"}).status, 0);
  const Files before = files();
  const auto expect_refused = [&](const Outcome& o, const std::string& instead) {
    EXPECT_EQ(o.status, 2) << o.err;
    EXPECT_NE(o.err.find("write " + path(instead) + "\n"), std::string::npos) << o.err;
    EXPECT_EQ(std::count(o.err.begin(), o.err.end(), '\n'), 1) << o.err;
    EXPECT_EQ(files(), before);
  };
  for (const auto& [wrong, right] : std::vector<std::pair<std::string, std::string>>{{"x.####.png", "x.####.exr"},
                                                                                     {"x.####.PNG", "x.####.exr"},
                                                                                     {"x.@@.jpg", "x.@@.exr"},
                                                                                     {"x.tif", "x.####.exr"},
                                                                                     {"x.####.foo", "x.####.exr"},
                                                                                     {"x.mp4", "x.####.exr"}}) {
    expect_refused(render(wrong, {"--frames", "1-2"}), right);
    expect_refused(render(wrong, {"--frames", "1-2"}, "run"), right);
    expect_refused(run({"reconstruct", path("in"), "-o", path(wrong)}), right);
  }
  expect_refused(render("x.png", {"--frames", "1"}), "x.exr");
  const Outcome gallery = run({"gallery", "run", "cornell-motion", "--gallery", path("g"), "--frames", "3-4",
                               "--resolution", "8x8", "--spp", "1", "-o", path("x.####.png")});
  EXPECT_EQ(gallery.status, 2) << gallery.err;
  EXPECT_NE(gallery.err.find("write " + path("x.####.exr")), std::string::npos) << gallery.err;
  EXPECT_EQ(run({"video", path("in"), path("m.gif")}).status, 2);
  EXPECT_EQ(run({"video", path("in"), path("m.mp4"), "--contact-sheet", path("s.jpg")}).status, 2);
  EXPECT_EQ(run({"compare", path("in"), "-r", path("in"), "--error-map", path("e.jpg")}).status, 2);
}

TEST_F(CliOutput, ReconstructNamesItsFilesAsRunDoes) {
  ASSERT_EQ(render("a/b/f.####.exr", {"--frames", "1-3", "--integrator", "gradient_path"}).status, 0);
  ASSERT_EQ(run({"reconstruct", path("a/b"), "-o", path("c/d")}).status, 0);
  EXPECT_TRUE(fs::exists(path("c/d/f.0002.exr")));
  ASSERT_EQ(run({"reconstruct", path("a/b/f.@@@@.exr"), "-o", path("e.exr")}).status, 0);
  EXPECT_TRUE(fs::exists(path("e.0003.exr")));
  ASSERT_EQ(run({"reconstruct", path("a/b"), "-o", path("one.exr"), "--frames", "2"}).status, 0);
  EXPECT_TRUE(fs::exists(path("one.exr")));
  ASSERT_EQ(run({"reconstruct", path("a/b/f.0002.exr"), "-o", path("g")}).status, 0);
  EXPECT_TRUE(fs::exists(path("g/f.0002.exr")));
  const Outcome itself = run({"reconstruct", path("a/b"), "-o", path("a/b")});
  EXPECT_EQ(itself.status, 2) << itself.err;
  EXPECT_NE(itself.err.find("would replace its own input"), std::string::npos) << itself.err;

  // A still through all steps.
  ASSERT_EQ(render("still/s.exr", {"--frames", "7", "--integrator", "gradient_path"}, "run").status, 0);
  EXPECT_TRUE(fs::exists(path("still/s.exr")));
  EXPECT_TRUE(fs::exists(path("still/final/s.exr")));
}

TEST_F(CliOutput, RawFramesComeWithWhatFollows) {
  const Outcome raw = render("a/f.####.exr", {"--frames", "1-2", "--integrator", "temporal_gradient_path"});
  EXPECT_NE(raw.err.find("tempera reconstruct " + path("a/f.####.exr") + " -o " + path("a/final") +
                         " (tempera run does both)\n"),
            std::string::npos)
      << raw.err;
  EXPECT_EQ(run({"reconstruct", path("a/f.####.exr"), "-o", path("a/final")}).status, 0) << "as it says";
  EXPECT_EQ(render("b/f.####.exr", {"--frames", "1-2"}).err.find("reconstruct"), std::string::npos);
  const Outcome gallery = run({"gallery", "run", "cornell-motion", "--gallery", path("g"), "--frames", "3-4",
                               "--resolution", "8x8", "--spp", "2", "--integrator", "temporal_gradient_path"});
  EXPECT_NE(gallery.err.find("tempera reconstruct "), std::string::npos) << gallery.err;
  EXPECT_EQ(render("c", {"--frames", "1", "--integrator", "gradient_path"}, "run").err.find("tempera reconstruct"),
            std::string::npos)
      << "run has done it";
}

TEST_F(CliOutput, EncodingsAreRefusedBeforeRendering) {
  const auto expect_refused = [&](const Outcome& o, const char* layer) {
    EXPECT_EQ(o.status, 2) << o.err;
    EXPECT_NE(o.err.find(fmt::format("dwaa compression would damage layer \"{}\"", layer)), std::string::npos) << o.err;
    EXPECT_TRUE(files().empty()) << files()[0];
  };
  const std::vector<std::string> lossy{"--frames", "1", "--set", "output.compression=dwaa"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.end(), lossy.begin(), lossy.end());
    return more;
  };
  expect_refused(render("f.exr", with({"--layers", "motion"})), "motion.forward");
  expect_refused(render("f.exr", with({"--layers", "cryptomatte", "--half"})), "CryptoObject00");
  expect_refused(render("f.exr", with({"--layers", "normal"}), "run"), "normal");
  expect_refused(render("f.exr", with({"--integrator", "gradient_path"})), "grad.x");
  EXPECT_EQ(render("g.exr", with({"--layers", "albedo,depth", "--half"})).status, 0);
  EXPECT_EQ(render("h.exr", with({"--integrator", "gradient_path"}), "run").status, 0)
      << "final frames hold no differences";
  const std::string shot =
      write("shot.toml", fmt::format("scene = \"{}\"\nframes = \"1\"\n[output]\nlayers = [\"position\"]\n"
                                     "path = \"{}\"\ncompression = \"dwaa\"\n",
                                     source_file("scenes/tests/cornell_motion.xml"), path("s.exr")));
  const Outcome o = run({"render", shot, "--resolution", "8x6", "--spp", "1"});
  EXPECT_EQ(o.status, 3);
  EXPECT_NE(o.err.find("shot.toml:6:"), std::string::npos) << o.err;
  EXPECT_FALSE(fs::exists(path("s.exr")));

  ASSERT_EQ(render("in/f.####.exr", {"--frames", "1-2", "--integrator", "gradient_path", "--layers", "normal"}).status,
            0);
  const Outcome reconstruct = run({"reconstruct", path("in"), "-o", path("out"), "--compression", "dwaa"});
  EXPECT_EQ(reconstruct.status, 3) << reconstruct.err;
  EXPECT_FALSE(fs::exists(path("out")));
}

TEST_F(CliOutput, BlenderNames) {
  ASSERT_EQ(render("f.exr", {"--frames", "1", "--layers", "depth,motion,uv,cryptomatte", "--aov-names", "blender",
                             "--view-layer", "Shot 7"})
                .status,
            0);
  ReadOptions raw;
  raw.rename = false;
  const Frame f = read_frame(path("f.exr"), raw);
  for (const char* pass : {"Combined", "Depth", "Vector", "UV", "CryptoObject00"}) {
    EXPECT_TRUE(f.has(std::string("Shot 7.") + pass)) << pass;
  }
  EXPECT_EQ(render("f.exr", {"--frames", "1", "--view-layer", "a.b"}).status, 2);
}

TEST_F(CliOutput, SetTakesEveryKeyOfTheFile) {
  const std::string scene = source_file("scenes/tests/cornell_motion.xml");
  const std::vector<std::string> same{"shutter={shape=\"curve\", curve=[0, 1, 1, 0]}",
                                      "film.resolution=[16, 12]",
                                      "film.crop=[2, 2, 8, 6]",
                                      "environment.radiance=[0.1, 0.2, 0.3]",
                                      "output.layers=[\"albedo\", \"normal\"]",
                                      "sampling.spp=2",
                                      "frames=[1]",
                                      "integrator={name=\"path\", max_depth=2}"};
  std::string file = fmt::format("scene = \"{}\"\n", scene);
  std::vector<std::string> typed{"render", scene, "-o", path("typed.exr")};
  for (const std::string& s : same) {
    file += s + "\n";
    typed.insert(typed.end(), {"--set", s});
  }
  ASSERT_EQ(run({"render", write("shot.toml", file), "-o", path("file.exr")}).status, 0);
  const Outcome o = run(typed);
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_TRUE(SamePixels(path("typed.exr"), path("file.exr")));
  EXPECT_EQ(read_frame(path("typed.exr")).width(), 8);
  const Outcome broken = run({"render", scene, "-o", path("f.exr"), "--set", "film.crop=[1, 2"});
  EXPECT_EQ(broken.status, 2);
  EXPECT_EQ(std::count(broken.err.begin(), broken.err.end(), '\n'), 1) << broken.err;
}

TEST_F(CliOutput, CausesAreNamedWhereTheyStand) {
  const Outcome typed = run({"render", source_file("scenes/tests/cornell_motion.xml"), "-o", path("f.exr"), "--frames",
                             "1", "--integrator", "temporal_gradient_path", "--spp", "1", "--layers", "albedo"});
  EXPECT_EQ(typed.status, 2);
  EXPECT_NE(typed.err.find("<command line>: the integrator \"temporal_gradient_path\" divides the samples"),
            std::string::npos)
      << typed.err;
  const std::string shot = write(
      "shot.toml", fmt::format("scene = \"{}\"\n[output]\nlayers = [\"albedo\"]\n[sampling]\nspp = 1\n[integrator]\n"
                               "name = \"temporal_gradient_path\"\n",
                               source_file("scenes/tests/cornell_motion.xml")));
  EXPECT_NE(run({"render", shot, "-o", path("f.exr")}).err.find("shot.toml:5:7: "), std::string::npos);
  const Outcome override = run({"render", shot, "-o", path("f.exr"), "--spp", "1"});
  EXPECT_NE(override.err.find("<command line>: the integrator"), std::string::npos) << override.err;
}

TEST_F(CliOutput, FlatCamerasAreRefusedBeforeRendering) {
  // The scale of what the camera hangs on goes to zero at 1 s.
  const std::string scene = write("flat.gltf", R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
"nodes": [{"children": [1]}, {"camera": 0}], "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
"animations": [{"channels": [{"sampler": 0, "target": {"node": 0, "path": "scale"}}],
  "samplers": [{"input": 0, "output": 1}]}],
"buffers": [{"byteLength": 32, "uri": "data:application/octet-stream;base64,AAAAAAAAgD8AAIA/AACAPwAAgD8AAAAAAAAAAAAAAAA="}],
"bufferViews": [{"buffer": 0, "byteLength": 8}, {"buffer": 0, "byteOffset": 8, "byteLength": 24}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
  {"bufferView": 1, "componentType": 5126, "count": 2, "type": "VEC3"}]})");
  const Outcome o =
      run({"render", scene, "-o", path("f.####.exr"), "--frames", "0-24", "--resolution", "8x6", "--spp", "1"});
  EXPECT_EQ(o.status, 3) << o.err;
  EXPECT_NE(o.err.find("frame 23: camera "), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("singular transform"), std::string::npos) << o.err;
  EXPECT_EQ(files(), Files{"flat.gltf"});
  EXPECT_EQ(
      run({"render", scene, "-o", path("f.####.exr"), "--frames", "0-2", "--resolution", "8x6", "--spp", "1"}).status,
      0)
      << "frames that do not see it are fine";
}

TEST_F(CliOutput, ProgramsAreToldOfWarningsAndErrors) {
  const std::string scene =
      write("a.xml",
            "<scene version=\"3.0.0\">\n<sensor type=\"perspective\"/>\n"
            "<shape type=\"sphere\"><float name=\"frobnication\" value=\"1\"/></shape>\n</scene>\n");
  const auto events = [](const Outcome& o) {
    std::vector<nlohmann::json> out;
    std::istringstream lines(o.out);
    for (std::string line; std::getline(lines, line);) out.push_back(nlohmann::json::parse(line));
    return out;
  };
  const Outcome good =
      run({"render", scene, "-o", path("f.exr"), "--resolution", "8x6", "--spp", "1", "--progress", "json"});
  ASSERT_EQ(good.status, 0) << good.err;
  const auto told = events(good);
  const auto warning = std::find_if(told.begin(), told.end(),
                                    [](auto& e) { return e.at("event") == "warning" && e.at("kind") == "input"; });
  ASSERT_NE(warning, told.end()) << good.out;
  EXPECT_EQ(warning->at("count"), 1);
  EXPECT_EQ(warning->at("file"), scene);
  EXPECT_EQ(warning->at("line"), 3);
  EXPECT_NE(warning->at("message").get<std::string>().find("frobnication"), std::string::npos);
  EXPECT_EQ(told.back().at("event"), "end");

  const auto last = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--progress", "json"});
    const Outcome o = run(arguments);
    const auto all = events(o);
    EXPECT_FALSE(all.empty()) << o.err;
    if (all.empty()) return nlohmann::json();
    EXPECT_EQ(all.back().at("event"), "error") << o.out;
    EXPECT_EQ(all.back().at("status"), o.status);
    return all.back();
  };
  EXPECT_EQ(last({"render", scene, "-o", path("f.exr"), "--strict"}).at("kind"), "unsupported");
  EXPECT_EQ(last({"render", path("none.xml"), "-o", path("f.exr")}).at("kind"), "missing_file");
  EXPECT_EQ(last({"render", scene, "--frobnicate"}).at("kind"), "usage");
  EXPECT_EQ(last({"run", write("b.toml", "scene = \"a.xml\"\nfps = 0\n")}).at("line"), 2);
  EXPECT_EQ(last({"reconstruct", path("nothing"), "-o", path("x")}).at("kind"), "missing_file");
}

}  // namespace
}  // namespace tempera::test
