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

CompareInput input(const FrameSequence& sequence) { return {sequence.pattern(), {sequence}}; }

TEST_F(Compare, FiguresAndMeansOfSequences) {
  const auto a = write("a", {1, 2, 3}, 1.0f, 0.5f), b = write("b", {2, 3, 4}, 2.0f),
             reference = write("r", {1, 2, 3}, 1.0f);
  int calls = 0;
  CompareOptions options;
  options.metrics = {"default", "hdr_flip"};
  const CompareResult r = compare_sequences({input(a), input(b)}, reference, options, [&](int done, int total) {
    EXPECT_EQ(done, ++calls);
    EXPECT_EQ(total, 5);
  });
  EXPECT_EQ(calls, 5);
  ASSERT_EQ(r.sides.size(), 2u);
  EXPECT_EQ(r.width, 8);
  const CompareSide &x = r.sides[0], &y = r.sides[1];
  EXPECT_EQ(x.frames, (std::vector<int>{1, 2, 3}));
  for (std::size_t i = 0; i < 3; ++i) {
    const double e = 0.25 * double((i + 1) * (i + 1));
    EXPECT_NEAR(x.find("mse")->values[i], e, 1e-6);
    EXPECT_NEAR(x.find("relmse")->values[i], e / 1.01, 1e-6);
    EXPECT_EQ(x.find("flip")->values[i], 0) << "both are white when shown";
    EXPECT_GT(x.find("hdr_flip")->values[i], 0.1);
  }
  const MeanError& mean = x.find("mse")->mean;
  EXPECT_NEAR(mean.mean, 0.25 * 14 / 3, 1e-6);
  EXPECT_NEAR(mean.standard_error, 0.583333, 1e-5) << "of 0.25, 1, 2.25: deviation 1.010363 over the root of 3";
  EXPECT_EQ(mean.count, 3);
  EXPECT_TRUE(x.unmatched.empty());
  EXPECT_EQ(y.frames, (std::vector<int>{2, 3}));
  EXPECT_EQ(y.unmatched, std::vector<int>{4});
  EXPECT_NEAR(y.find("mse")->mean.mean, 1, 1e-6);
  EXPECT_EQ(x.name, path("a.####.exr"));
  EXPECT_EQ(x.label, "a.####.exr");
  EXPECT_EQ(y.label, "b.####.exr");
}

TEST_F(Compare, OneReferenceServesAllFramesAndExposureMatters) {
  const auto a = write("a", {1, 2}, 1.0f), reference = write("r", {77}, 2.0f);
  CompareOptions options;
  options.exposure = -2;
  const CompareResult r = compare_sequences({input(a)}, reference, options);
  EXPECT_EQ(r.sides[0].frames.size(), 2u);
  EXPECT_EQ(r.sides[0].find("mse")->mean.mean, 1);
  EXPECT_EQ(r.sides[0].find("flip")->mean.mean, flip(Image(8, 6, 3, 0.25f), Image(8, 6, 3, 0.5f)));
  EXPECT_EQ(r.sides[0].find("hdr_flip"), nullptr) << "not a default";
  options.metrics = {"relmse"};
  options.frames = {2};
  const CompareResult fewer = compare_sequences({input(a)}, reference, options);
  EXPECT_EQ(fewer.sides[0].frames, std::vector<int>{2});
  ASSERT_EQ(fewer.metrics.size(), 1u);
  EXPECT_EQ(fewer.metrics[0]->id, "relmse");
}

TEST_F(Compare, WhatCannotBeComparedIsAnError) {
  const auto a = write("a", {1, 2}, 1), reference = write("r", {3, 4}, 1), wide = write("w", {1, 2}, 1, 0, 9);
  try {
    compare_sequences({input(a)}, reference);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
  }
  try {
    compare_sequences({input(a)}, wide);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
    EXPECT_EQ(e.message(), path("a.0001.exr") + " has 8x6 pixels, the reference " + path("w.0001.exr") + " has 9x6");
  }
  CompareOptions options;
  options.layer = "albedo";
  try {
    compare_sequences({input(a)}, a, options);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
  }
}

CompareResult sample_result() {
  CompareSide side;
  side.name = "a \"b\", c", side.label = "a";
  side.frames = {1, 2}, side.non_finite = {0, 3}, side.unmatched = {9};
  side.series = {{&get_metric("mse"), {0.5, 1.5}, {}, {1, 0.5, 2}},
                 {&get_metric("relmse"), {0.25, 0.75}, {}, {0.5, 0.25, 2}},
                 {&get_metric("flip"), {kUndefined, 0.375}, {}, {0.375, kUndefined, 1}}};
  CompareSide other = side;
  other.name = other.label = "other";
  other.series[1].mean.mean = 0.25;
  CompareResult r;
  r.reference = "ref";
  r.metrics = {&get_metric("mse"), &get_metric("relmse"), &get_metric("flip")};
  r.sides = {side, other};
  r.notes = {"A note."};
  return r;
}

TEST(CompareText, Json) {
  const nlohmann::json j = nlohmann::json::parse(to_json(sample_result()));
  EXPECT_EQ(j["reference"], "ref");
  EXPECT_EQ(j["metrics"][1]["id"], "relmse");
  EXPECT_EQ(j["notes"][0], "A note.");
  const nlohmann::json& side = j["sides"][0];
  EXPECT_EQ(side["name"], "a \"b\", c");
  EXPECT_EQ(side["mean"]["relmse"], 0.5);
  EXPECT_EQ(side["standard_error"]["mse"], 0.5);
  EXPECT_NEAR(side["confidence_95"]["mse"].get<double>(), 0.5 * 12.7062, 1e-4);
  EXPECT_TRUE(side["standard_error"]["flip"].is_null());
  EXPECT_EQ(side["frames"], (std::vector<int>{1, 2}));
  EXPECT_TRUE(side["values"]["flip"][0].is_null());
  EXPECT_EQ(side["values"]["flip"][1], 0.375);
  EXPECT_EQ(side["non_finite"][1], 3);
  EXPECT_EQ(side["unmatched"], std::vector<int>{9});
}

TEST(CompareText, Csv) {
  CompareResult r = sample_result();
  r.sides.pop_back();
  EXPECT_EQ(to_csv(r),
            "name,frame,mse,relmse,flip,non_finite\n"
            "\"a \"\"b\"\", c\",1,0.5,0.25,,0\n"
            "\"a \"\"b\"\", c\",2,1.5,0.75,0.375,3\n"
            "\"a \"\"b\"\", c\",mean,1,0.5,0.375,3\n"
            "\"a \"\"b\"\", c\",standard_error,0.5,0.25,,\n");
}

TEST(CompareText, Table) {
  EXPECT_EQ(to_table(sample_result()),
            "                       a         other\n"
            "frames                 2             2\n"
            "MSE                    1  ± 6.4      1  ± 6.4  1.000x\n"
            "relMSE               0.5  ± 3.2   0.25  ± 3.2  0.500x\n"
            "FLIP               0.375         0.375         1.000x\n"
            "non-finite pixels      3             3\n"
            "A note.\n");
}

TEST(Statistics, MeanAndConfidence) {
  const std::vector<double> values{1, 2, kUndefined, 4};
  const MeanError e = mean_error(values);
  EXPECT_EQ(e.count, 3);
  EXPECT_NEAR(e.mean, 7.0 / 3, 1e-15);
  EXPECT_NEAR(e.standard_error, 0.881917104, 1e-9) << "deviation 1.527525232 over the root of 3";
  EXPECT_NEAR(e.confidence_95(), 4.302652730 * 0.881917104, 1e-7);
  EXPECT_TRUE(std::isnan(mean_error(std::vector<double>{5}).standard_error));
}

// Quantiles of Student's t, as tables have them.
TEST(Statistics, StudentT) {
  EXPECT_NEAR(student_t_95(1), 12.706204736, 1e-8);
  EXPECT_NEAR(student_t_95(2), 4.302652730, 1e-8);
  EXPECT_NEAR(student_t_95(3), 3.182446305, 1e-8);
  EXPECT_NEAR(student_t_95(10), 2.228138852, 1e-8);
  EXPECT_NEAR(student_t_95(29), 2.045229642, 1e-8);
  EXPECT_NEAR(student_t_95(1000), 1.962339081, 1e-8);
}

}  // namespace
}  // namespace tempera
