// SPDX-License-Identifier: Apache-2.0
// tempera gallery: what it lists, makes and renders, and what it says when it cannot.
#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

class GalleryCommand : public CliTest {
 protected:
  Outcome gallery(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "gallery");
    arguments.insert(arguments.end(), {"--gallery", path("g")});
    return run(arguments);
  }
};

TEST_F(GalleryCommand, ListsScenes) {
  const Outcome text = run({"gallery", "list"}), json = run({"gallery", "list", "--json"});
  ASSERT_EQ(text.status, 0) << text.err;
  const auto list = nlohmann::json::parse(json.out);
  ASSERT_GE(list.size(), 16u);
  for (const auto& s : list)
    EXPECT_NE(text.out.find("\n" + s.at("name").get<std::string>() + " "), std::string::npos) << s;
}

TEST_F(GalleryCommand, MakesAFolder) {
  const Outcome o = gallery({"make", "cornell-motion"});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_EQ(o.out, path("g/cornell-motion/shot.toml") + "\n");
  for (const char* file : {"shot.toml", "scene.glb", "README.md"})
    EXPECT_TRUE(fs::exists(path("g/cornell-motion/") + file));
  EXPECT_EQ(run({"gallery", "make", "cornell-motion", "-o", path("own")}).status, 0);
  EXPECT_EQ(text_of(path("own/scene.glb")), text_of(path("g/cornell-motion/scene.glb")));
}

TEST_F(GalleryCommand, RunsWithOverrides) {
  const Outcome o = gallery({"run", "cornell-motion", "--frames", "3-4", "--resolution", "16x16", "--spp", "2"});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_EQ(o.out, path("g/cornell-motion/frames/cornell-motion.####.exr") + "\n");
  const Frame frame = read_frame(path("g/cornell-motion/frames/cornell-motion.0004.exr"));
  EXPECT_EQ(frame.width(), 16);
  EXPECT_NE(frame.find("class.direct.color"), nullptr);
  EXPECT_NE(frame.find("motion.forward"), nullptr);
}

TEST_F(GalleryCommand, ReferencesContinue) {
  const std::vector<std::string> arguments{"reference", "cornell-motion", "--frames", "3-4",        "--resolution",
                                           "8x8",       "--spp",          "4",        "--progress", "plain"};
  const Outcome first = gallery(arguments), second = gallery(arguments);
  ASSERT_EQ(first.status, 0) << first.err;
  ASSERT_EQ(second.status, 0) << second.err;
  EXPECT_NE(second.err.find("0 frames rendered, 2 already finished"), std::string::npos) << second.err;
  const Frame frame = read_frame(path("g/cornell-motion/reference/cornell-motion.0003.exr"));
  EXPECT_NE(frame.find("color.var"), nullptr);
  EXPECT_NE(frame.find("motion.backward"), nullptr);
}

TEST_F(GalleryCommand, SaysWhatIsWrong) {
  const Outcome unknown = gallery({"run", "glas-egg"});
  EXPECT_EQ(unknown.status, 2);
  EXPECT_NE(unknown.err.find("no scene \"glas-egg\"; known: glass-egg"), std::string::npos) << unknown.err;
  EXPECT_EQ(gallery({"make", "wave", "vase", "-o", path("x")}).status, 2);
  EXPECT_EQ(run({"gallery"}).status, 2);
  const Outcome missing = gallery({"make", "bathroom", "--scenes", path("nothing")});
  EXPECT_EQ(missing.status, 4);
  EXPECT_NE(missing.err.find("TEMPERA_SCENES"), std::string::npos) << missing.err;
}

}  // namespace
}  // namespace tempera::test
