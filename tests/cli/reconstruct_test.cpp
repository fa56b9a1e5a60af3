// SPDX-License-Identifier: Apache-2.0
// From a render with temporal differences to final frames, as users do it.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

class CliReconstruct : public CliTest {
 protected:
  /// Rendered once for all tests.
  static void SetUpTestSuite() {
    rendered_ = fs::temp_directory_path() / ("tempera_cli_" + std::to_string(getpid()) + "_rendered");
    const Outcome o = run({"render", source_file("scenes/tests/cornell_motion.xml"), "-o", rendered_ / "f.####.exr",
                           "--integrator", "temporal_gradient_path", "--frames", "1-12", "--resolution", "40x30",
                           "--spp", "4", "--layers", "albedo"});
    ASSERT_EQ(o.status, 0) << o.err;
  }
  static void TearDownTestSuite() { fs::remove_all(rendered_); }
  void SetUp() override {
    CliTest::SetUp();
    fs::copy(rendered_, path("in"));
  }
  Outcome reconstruct(const std::string& out, std::vector<std::string> more = {}) const {
    std::vector<std::string> arguments{"reconstruct", path("in"), "-o", path(out + "/f.####.exr")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  }
  std::string file(const std::string& folder, int frame) const {
    return path(fmt::format("{}/f.{:04}.exr", folder, frame));
  }
  static inline fs::path rendered_;
};

TEST_F(CliReconstruct, FramesAreCleanerAndKeepTheirFeatures) {
  const Outcome o = reconstruct("out", {"--threads", "2"});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_NE(o.err.find("12 frames reconstructed"), std::string::npos) << o.err;
  const auto roughness = [](const Image& c) {
    double sum = 0;
    for (int y = 0; y < c.height(); ++y) {
      for (int x = 0; x + 1 < c.width(); ++x) sum += std::abs(double(c.at(x + 1, y, 1)) - double(c.at(x, y, 1)));
    }
    return sum;
  };
  const Frame in = read_frame(file("in", 6)), out = read_frame(file("out", 6));
  EXPECT_LT(roughness(out.layer("color")), 0.6 * roughness(in.layer("color")));
  EXPECT_EQ(out.layer("albedo"), in.layer("albedo"));
  EXPECT_FALSE(out.has("grad.x"));
  EXPECT_EQ(std::get<int>(out.metadata.at("tempera/frame")), 6);

  ASSERT_EQ(reconstruct("one", {"--threads", "1"}).status, 0);
  ASSERT_EQ(reconstruct("part", {"--frames", "4-7"}).status, 0);
  EXPECT_FALSE(fs::exists(file("part", 8)));
  for (int f = 1; f <= 12; ++f) EXPECT_TRUE(SamePixels(file("out", f), file("one", f)));
  for (int f = 4; f <= 7; ++f) EXPECT_TRUE(SamePixels(file("out", f), file("part", f)));
}

TEST_F(CliReconstruct, InterruptedWorkIsResumedToTheSameBits) {
  const std::vector<std::string> slow{"--rounds", "30", "--iterations", "40"};
  std::vector<std::string> arguments{"reconstruct", path("in"), "-o", path("out/f.####.exr"), "--resume"};
  arguments.insert(arguments.end(), slow.begin(), slow.end());
  Process process(arguments);
  ASSERT_TRUE(process.wait_until([&] { return fs::exists(file("out", 1)); }));
  process.signal(SIGTERM);
  const Outcome stopped = process.finish();
  EXPECT_EQ(stopped.status, 143) << stopped.err;
  ASSERT_EQ(run(arguments).status, 0);
  ASSERT_EQ(reconstruct("whole", slow).status, 0);
  for (int f = 1; f <= 12; ++f) EXPECT_TRUE(SamePixels(file("out", f), file("whole", f)));
}

TEST_F(CliReconstruct, EventsForPrograms) {
  const Outcome o = reconstruct("out", {"--progress", "json", "--norm", "l2"});
  ASSERT_EQ(o.status, 0) << o.err;
  int done = 0;
  std::istringstream lines(o.out);
  std::string last;
  for (std::string line; std::getline(lines, line);) {
    const nlohmann::json j = nlohmann::json::parse(line);
    last = j["event"];
    done += last == "done";
  }
  EXPECT_EQ(done, 12);
  EXPECT_EQ(last, "end");
}

TEST_F(CliReconstruct, ErrorsAreOneLineWithAStatus) {
  const auto fails = [](const Outcome& o, int status, const std::string& what) {
    EXPECT_EQ(o.status, status) << o.err;
    EXPECT_NE(o.err.find(what), std::string::npos) << o.err;
  };
  fails(reconstruct("out", {"--norm", "l3"}), 2, "l1, l2");
  fails(reconstruct("out", {"--alpha", "0"}), 2, "alpha");
  fails(reconstruct("out", {"--window", "4", "--overlap", "4"}), 3, "overlap");
  fails(reconstruct("out", {"--frames", "11-13"}), 4, "no frame 13");
  fails(run({"reconstruct", path("nowhere"), "-o", path("out")}), 4, "nowhere");
  fails(run({"reconstruct", path("in")}), 2, "--output");
  fails(run({"reconstruct", path("in"), "-o", path("in/f.####.exr")}), 2, "replace its own input");
  fs::remove(file("in", 5));
  fails(reconstruct("out"), 3, "lacks frames in between: 5");
  const Outcome plain = run({"render", source_file("scenes/tests/cornell_motion.xml"), "-o", path("plain/f.####.exr"),
                             "--frames", "1", "--resolution", "16x12", "--spp", "1"});
  ASSERT_EQ(plain.status, 0) << plain.err;
  fails(run({"reconstruct", path("plain"), "-o", path("out/f.####.exr")}), 3, "f.0001.exr has no layer \"grad.x\"");
  EXPECT_TRUE(!fs::exists(path("out")) || fs::is_empty(path("out"))) << "nothing is left of what failed";
}

}  // namespace
}  // namespace tempera::test
