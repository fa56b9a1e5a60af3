// SPDX-License-Identifier: Apache-2.0
// The command compare, on made-up sequences: thresholds and their exit status, groups, files for scripts.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "program.h"
#include "tempera/core/random.h"
#include "tempera/core/time.h"

namespace tempera {
namespace {

using namespace test;

class CliCompare : public CliTest {
 protected:
  static constexpr int kFrames = 8;

  void SetUp() override {
    CliTest::SetUp();
    write("r", 0, 0);
    write("a", 0.05f, 1);
    write("b", 0.1f, 2);
  }
  /// Frames 1 to 8 of a still gradient with noise of a deviation relative to it.
  void write(const std::string& name, float sigma, int seed, int missing = -1) const {
    for (int f = 1; f <= kFrames; ++f) {
      if (f == missing) continue;
      Frame frame(16, 12);
      Image& color = frame.create(layers::color());
      for (int y = 0; y < 12; ++y) {
        for (int x = 0; x < 16; ++x) {
          const std::uint64_t bits =
              hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(f), std::uint64_t(seed));
          const float noise = sigma * std::sqrt(12.0f) * (to_unit_float(std::uint32_t(bits)) - 0.5f);
          for (int c = 0; c < 3; ++c) color.at(x, y, c) = (0.2f + 0.04f * float(x)) * (1 + noise);
        }
      }
      write_frame(frame_path(path(name + "/f.####.exr"), f), frame, {.compression = Compression::kNone});
    }
  }
  Outcome compare(std::vector<std::string> arguments) const {
    for (std::string& a : arguments) {
      if (a.starts_with("@")) a = path(a.substr(1) + "/f.####.exr");
    }
    arguments.insert(arguments.begin(), "compare");
    arguments.insert(arguments.end(), {"--reference", path("r/f.####.exr")});
    return run(arguments);
  }
};

TEST_F(CliCompare, TableFilesAndStatus) {
  const Outcome o = compare({"@a", "@b", "--csv", path("m.csv"), "--json", path("m.json")});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_EQ(o.err, "") << "no progress bar without a terminal";
  EXPECT_NE(o.out.find("layer color, 16x12 pixels"), std::string::npos) << o.out;
  for (const char* row : {"\nrelMSE ", "\nPSNR [dB] ", "\nSSIM ", "\nFLIP ", "\ntemporal error ", "\nflicker "}) {
    EXPECT_NE(o.out.find(row), std::string::npos) << row << "\n" << o.out;
  }
  const auto j = nlohmann::json::parse(text_of(path("m.json")));
  const auto& sides = j.at("sides");
  ASSERT_EQ(sides.size(), 2u);
  EXPECT_EQ(sides[0].at("label"), "a");
  const auto mean = [&](int side, const char* id) { return sides[side].at("mean").at(id).get<double>(); };
  EXPECT_NEAR(mean(1, "relmse") / mean(0, "relmse"), 4, 0.4) << "twice the noise";
  EXPECT_NEAR(mean(1, "flicker") / mean(0, "flicker"), 4, 0.6);
  EXPECT_LT(mean(1, "psnr"), mean(0, "psnr"));
  EXPECT_EQ(sides[0].at("values").at("relmse").size(), 8u);
  EXPECT_EQ(sides[0].at("spectra")[0].at("power").size(), 5u);
  for (const auto& m : j.at("metrics")) EXPECT_TRUE(sides[0].at("mean").contains(m.at("id"))) << m;
  const std::string csv = text_of(path("m.csv"));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 2 * (kFrames + 2)) << csv;
}

TEST_F(CliCompare, ThresholdsEndWithStatusSix) {
  struct Case {
    const char* limit;
    int status;
    const char* message;
  };
  for (const Case& c :
       {Case{"relmse=0.01", 0, ""}, Case{"relmse=0.001", 6, "relmse of frame 1 of "}, Case{"mean.relmse=0.01", 0, ""},
        Case{"mean.relmse=0.001", 6, "relmse of "}, Case{"psnr=20", 0, ""}, Case{"psnr=60", 6, "below 60 (7 more)"},
        Case{"ssim=0.5,flip=0.9,temporal=1", 0, ""}, Case{"ssim=0.5,mean.flicker=1e-9", 6, "flicker of "},
        Case{"flicker=1", 0, ""}, Case{"flicker=1e-9", 6, "above 1e-09"}, Case{"bias=0.5", 0, ""},
        Case{"bias=1e-9", 6, "bias of frame "}, Case{"hdr_flip=0.9", 0, ""}}) {
    const Outcome o = compare({"@a", "--threshold", c.limit, "--csv", path("m.csv")});
    EXPECT_EQ(o.status, c.status) << c.limit << "\n" << o.err;
    EXPECT_NE(o.err.find(c.message), std::string::npos) << c.limit << "\n" << o.err;
    EXPECT_NE(o.out.find("relMSE"), std::string::npos) << "the table is printed anyway";
    EXPECT_TRUE(fs::remove(path("m.csv"))) << "and files are written";
  }
  EXPECT_EQ(compare({"@r", "--threshold", "relmse=0", "--threshold", "flip=0,ssim=1,flicker=0,temporal=0"}).status, 0);
  for (const char* wrong : {"relmse", "relmse=", "relmse=x", "relmse=0.1,", "mean.=1", "meen.relmse=1", "relmsee=1"}) {
    EXPECT_EQ(compare({"@a", "--threshold", wrong}).status, 2) << wrong;
  }
}

TEST_F(CliCompare, MissingFramesAndBadPixelsPassAnyThreshold) {
  write("gap", 0.05f, 1, 4);
  const Outcome gap = compare({"@gap", "--threshold", "relmse=1"});
  EXPECT_EQ(gap.status, 6);
  EXPECT_NE(gap.err.find("frame 4 of " + path("gap/f.####.exr") + " is missing"), std::string::npos) << gap.err;
  EXPECT_EQ(compare({"@gap"}).status, 0) << "without a threshold it is only said";
  Frame bad = read_frame(path("a/f.0003.exr"));
  bad.layer("color").at(2, 2, 1) = std::nanf("");
  write_frame(path("a/f.0003.exr"), bad);
  const Outcome nan = compare({"@a", "--threshold", "relmse=1"});
  EXPECT_EQ(nan.status, 6);
  EXPECT_NE(nan.err.find("1 pixels of frame 3"), std::string::npos) << nan.err;
}

TEST_F(CliCompare, GroupsNamesAndTrimming) {
  for (int s = 1; s <= 4; ++s) write(fmt::format("seed{}", s), 0.1f, 10 + s);
  const Outcome o = compare({"mine=" + path("seed*/f.####.exr"), "other=" + path("a/f.####.exr"), "--metrics",
                             "relmse,bias_squared,variance", "--trim", "0.1", "--json", path("m.json")});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_NE(o.out.find("over runs, or over frames where there is one run"), std::string::npos) << o.out;
  EXPECT_NE(o.out.find("The 0.1 % of the pixels with the largest errors are left out of relMSE."), std::string::npos);
  const auto j = nlohmann::json::parse(text_of(path("m.json")));
  const auto& mine = j.at("sides")[0];
  EXPECT_EQ(mine.at("name"), "mine");
  EXPECT_EQ(mine.at("runs").size(), 4u);
  EXPECT_NEAR(mine.at("mean").at("variance").get<double>(), 0.0095, 0.001);
  EXPECT_LT(std::abs(mine.at("mean").at("bias_squared").get<double>()),
            mine.at("confidence_95").at("bias_squared").get<double>());
  EXPECT_TRUE(j.at("sides")[1].at("mean").at("variance").is_null()) << "one run has no variance";
}

TEST_F(CliCompare, WhatCannotBeMeasured) {
  const Outcome o = compare({"@a", "--metrics", "temporal_compensated"});
  EXPECT_EQ(o.status, 3);
  EXPECT_NE(o.err.find("motion.backward"), std::string::npos) << o.err;
  EXPECT_EQ(compare({"@a", "--frames", "1-4", "--metrics", "flicker"}).status, 3);
  EXPECT_EQ(compare({"@a", "--metrics", "relmsee"}).status, 2);
  EXPECT_EQ(compare({"@a", "--trim", "51"}).status, 2);
  EXPECT_EQ(compare({"@a", "--where", "object_id=9"}).status, 3);
  for (const char* wrong : {"object_id", "object_id=", "=9", "object_id=x", "object_id=nan"}) {
    EXPECT_EQ(compare({"@a", "--where", wrong}).status, 2) << wrong;
  }
  EXPECT_EQ(compare({"@a", "--where", "color=0", "--html", path("r.html")}).status, 2);
  EXPECT_EQ(compare({"@a", "--cutoff", "0.5"}).status, 2);
  EXPECT_EQ(compare({"@nobody*"}).status, 4);
}

TEST_F(CliCompare, ASecondReferenceTakesItsNoiseOut) {
  write("r1", 0.1f, 21), write("r2", 0.1f, 22);
  const auto relmse = [&](const std::vector<std::string>& references) {
    std::vector<std::string> arguments{"compare", path("a/f.####.exr"), "--metrics", "relmse,flicker_display",
                                       "--json",  path("m.json")};
    arguments.insert(arguments.end(), references.begin(), references.end());
    const Outcome o = run(arguments);
    EXPECT_EQ(o.status, 0) << o.err;
    return nlohmann::json::parse(text_of(path("m.json"))).at("sides")[0].at("mean").at("relmse").get<double>();
  };
  const std::string r = path("r/f.####.exr"), r1 = path("r1/f.####.exr"), r2 = path("r2/f.####.exr");
  const double exact = relmse({"-r", r}), one = relmse({"-r", r1}), two = relmse({"-r", r1, "--reference2", r2});
  EXPECT_GT(one, 3 * exact);
  EXPECT_NEAR(two / exact, 1, 0.35);
  EXPECT_EQ(run({"compare", r, "--reference2", r1}).status, 2);
  const Outcome same = run({"compare", r, "-r", r1, "--reference2", r1});
  EXPECT_EQ(same.status, 3);
  EXPECT_NE(same.err.find("is the first one again"), std::string::npos) << same.err;
  EXPECT_EQ(run({"compare", r, "-r", r1, "--reference2", path("nobody/f.####.exr")}).status, 4);
}

TEST_F(CliCompare, ListsItsMetrics) {
  const Outcome o = run({"list", "metrics", "--json"});
  ASSERT_EQ(o.status, 0);
  const auto list = nlohmann::json::parse(o.out).at("metrics");
  ASSERT_GT(list.size(), 15u);
  const Outcome all = compare({"@a", "--metrics", "all", "--json", path("m.json")});
  ASSERT_EQ(all.status, 0) << all.err;
  for (const auto& m : nlohmann::json::parse(text_of(path("m.json"))).at("metrics")) {
    EXPECT_TRUE(std::any_of(list.begin(), list.end(), [&](const auto& l) { return l.at("name") == m.at("id"); })) << m;
  }
}

}  // namespace
}  // namespace tempera
