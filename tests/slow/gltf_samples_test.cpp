// SPDX-License-Identifier: Apache-2.0
// Every glTF sample beside the project renders, and what is animated moves. The samples lie beside the project; without
// them the tests are skipped.
#include <set>

#include "../cli/program.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

const fs::path kSamples = fs::path(TEMPERA_SOURCE_DIR).parent_path() / "shared/scenes/gltf";

std::vector<fs::path> sample_files() {
  std::vector<fs::path> files;
  if (!fs::exists(kSamples)) return files;
  for (const auto& entry : fs::recursive_directory_iterator(kSamples)) {
    if (entry.path().extension() == ".gltf" || entry.path().extension() == ".glb") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

class GltfSamples : public test::CliTest {};

TEST_F(GltfSamples, RenderAndMove) {
  const std::vector<fs::path> files = sample_files();
  if (files.empty()) GTEST_SKIP() << kSamples << " is not there";
  const std::set<std::string> animated{
      "AnimatedCube",      "AnimatedMorphCube", "AnimatedTriangle", "BoxAnimated",        "CesiumMan",   "Fox",
      "InterpolationTest", "MorphStressTest",   "RiggedFigure",     "RecursiveSkeletons", "SimpleMorph", "SimpleSkin"};
  std::set<std::string> moving;
  for (const fs::path& file : files) {
    SCOPED_TRACE(file);
    const std::string name = file.stem();
    const test::Outcome o = test::run({"render", file, "-o", path(name + ".####.exr"), "--frames", "3,11", "--spp",
                                       "16", "--resolution", "64x48", "--layers", "motion,albedo"});
    ASSERT_EQ(o.status, 0) << o.err;
    EXPECT_EQ(o.err.find("not finite"), std::string::npos) << o.err;
    const Frame a = read_frame(path(name + ".0003.exr")), b = read_frame(path(name + ".0011.exr"));
    float largest = 0;
    for (const Frame* f : {&a, &b}) {
      const Image& motion = f->layer("motion.forward");
      for (int y = 0; y < 48; ++y) {
        for (int x = 0; x < 64; ++x) {
          largest = std::max({largest, std::abs(motion.at(x, y, 0)), std::abs(motion.at(x, y, 1))});
        }
      }
    }
    if (largest > 0.01f) {
      moving.insert(name);
      EXPECT_FALSE(a.layer("albedo") == b.layer("albedo"));
    } else {
      EXPECT_EQ(largest, 0) << "vectors of what stands still are exactly zero";
    }
  }
  EXPECT_GE(files.size(), 25u);
  EXPECT_EQ(moving, animated);
}

}  // namespace
}  // namespace tempera
