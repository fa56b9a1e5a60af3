// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/compare.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tempera/core/time.h"
#include "tempera/frames/frame.h"

namespace tempera {
namespace {

class Compare : public testing::Test {
 protected:
  Compare() {
    folder_ =
        std::filesystem::path(testing::TempDir()) /
        ("tempera_" + std::to_string(::getpid()) + "_" + testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
  }
  ~Compare() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  /// Frames of one value each.
  FrameSequence write(const std::string& name, std::initializer_list<int> frames, float value, float step = 0,
                      int width = 8) {
    for (const int n : frames) {
      Frame f(width, 6);
      for (float& v : f.create(layers::color()).values()) v = value + step * float(n);
      write_frame(frame_path(path(name + ".####.exr"), n), f);
    }
    return FrameSequence(path(name + ".####.exr"));
  }
  std::filesystem::path folder_;
};

TEST_F(Compare, FiguresAndMeansOfSequences) {
  const auto a = write("a", {1, 2, 3}, 1.0f, 0.5f), b = write("b", {2, 3, 4}, 2.0f),
             reference = write("r", {1, 2, 3}, 1.0f);
  int calls = 0;
  const CompareResult r = compare_sequences({a, b}, reference, {}, [&](int done, int total) {
    EXPECT_EQ(done, ++calls);
    EXPECT_EQ(total, 5);
  });
  EXPECT_EQ(calls, 5);
  ASSERT_EQ(r.sides.size(), 2u);
  ASSERT_EQ(r.sides[0].frames.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    const FrameFigures& f = r.sides[0].frames[std::size_t(i)];
    EXPECT_EQ(f.frame, i + 1);
    EXPECT_NEAR(f.mse, 0.25 * (i + 1) * (i + 1), 1e-6);
    EXPECT_NEAR(f.relative_mse, f.mse / 1.01, 1e-6);
    EXPECT_EQ(f.flip, 0) << "both are white when shown";
    EXPECT_GT(f.hdr_flip, 0.1);
  }
  EXPECT_NEAR(r.sides[0].mean.mse, 0.25 * 14 / 3, 1e-6);
  EXPECT_EQ(r.sides[0].mean.frame, 3);
  EXPECT_TRUE(r.sides[0].unmatched.empty());
  EXPECT_EQ(r.sides[1].mean.frame, 2);
  EXPECT_EQ(r.sides[1].unmatched, std::vector<int>{4});
  EXPECT_NEAR(r.sides[1].mean.mse, 1, 1e-6);
  EXPECT_EQ(r.sides[0].name, path("a.####.exr"));
}

TEST_F(Compare, OneReferenceServesAllFramesAndExposureMatters) {
  const auto a = write("a", {1, 2}, 1.0f), reference = write("r", {77}, 2.0f);
  CompareOptions options;
  options.exposure = -2;
  options.hdr_flip = false;
  const CompareResult r = compare_sequences({a}, reference, options);
  EXPECT_EQ(r.sides[0].mean.frame, 2);
  EXPECT_EQ(r.sides[0].mean.mse, 1);
  EXPECT_EQ(r.sides[0].mean.flip, flip(Image(8, 6, 3, 0.25f), Image(8, 6, 3, 0.5f)));
  EXPECT_LT(r.sides[0].mean.hdr_flip, 0);
  options.flip = false;
  options.frames = {2};
  const CompareResult fewer = compare_sequences({a}, reference, options);
  EXPECT_EQ(fewer.sides[0].mean.frame, 1);
  EXPECT_LT(fewer.sides[0].mean.flip, 0);
}

TEST_F(Compare, WhatCannotBeComparedIsAnError) {
  const auto a = write("a", {1, 2}, 1), reference = write("r", {3, 4}, 1), wide = write("w", {1, 2}, 1, 0, 9);
  try {
    compare_sequences({a}, reference);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
  }
  try {
    compare_sequences({a}, wide);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
    EXPECT_EQ(e.message(), path("a.0001.exr") + " has 8x6 pixels, the reference " + path("w.0001.exr") + " has 9x6");
  }
  CompareOptions options;
  options.layer = "albedo";
  try {
    compare_sequences({a}, a, options);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
  }
}

CompareResult sample_result() {
  CompareSide side{"a \"b\", c", {}, {}, {9}};
  side.frames = {{1, 0.5, 0.25, 0.125, -1, 0}, {2, 1.5, 0.75, 0.375, -1, 3}};
  side.mean = {2, 1, 0.5, 0.25, -1, 3};
  CompareSide other = side;
  other.name = "other";
  other.mean.relative_mse = 0.25;
  return {"ref", "color", {side, other}};
}

TEST(CompareText, Json) {
  const nlohmann::json j = nlohmann::json::parse(to_json(sample_result()));
  EXPECT_EQ(j["reference"], "ref");
  EXPECT_EQ(j["sides"][0]["name"], "a \"b\", c");
  EXPECT_EQ(j["sides"][0]["mean"]["relative_mse"], 0.5);
  EXPECT_EQ(j["sides"][0]["frames"][1]["frame"], 2);
  EXPECT_EQ(j["sides"][0]["frames"][1]["flip"], 0.375);
  EXPECT_EQ(j["sides"][0]["frames"][1]["non_finite"], 3);
  EXPECT_EQ(j["sides"][0]["unmatched"], std::vector<int>{9});
  EXPECT_FALSE(j["sides"][0]["mean"].contains("hdr_flip"));
}

TEST(CompareText, Csv) {
  CompareResult r = sample_result();
  r.sides.pop_back();
  EXPECT_EQ(to_csv(r),
            "name,frame,mse,relative_mse,flip,hdr_flip,non_finite\n"
            "\"a \"\"b\"\", c\",1,0.5,0.25,0.125,,0\n"
            "\"a \"\"b\"\", c\",2,1.5,0.75,0.375,,3\n"
            "\"a \"\"b\"\", c\",mean,1,0.5,0.25,,3\n");
}

TEST(CompareText, Table) {
  EXPECT_EQ(to_table(sample_result()),
            "          frames          MSE       relMSE      FLIP  HDR-FLIP  non-finite  relMSE to first\n"
            "a \"b\", c       2            1          0.5   0.25000         -           3  1.000x\n"
            "other          2            1         0.25   0.25000         -           3  0.500x\n");
}

}  // namespace
}  // namespace tempera
