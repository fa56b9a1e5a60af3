// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/progress.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "tempera/core/log.h"
#include "tempera/pipeline/stage_progress.h"

namespace tempera {
namespace {

/// What a two-frame render with one frame skipped prints.
std::string transcript(ProgressKind kind) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  {
    RenderSettings settings;
    RenderPlan plan;
    plan.frames = {1, 2};
    plan.skipped = 1;
    plan.units = 2 * plan.frames.size();
    plan.settings = &settings;
    plan.layers = {layers::color()};
    const auto progress = make_progress(kind);
    const Frame picture(4, 4);
    progress->begin(plan);
    RenderReport report;
    for (const int f : plan.frames) {
      progress->frame_begin(f, picture, 0);
      RenderTotals tile;
      tile.samples = 100;
      progress->tile_done(f, picture, {0, 0, 2, 4}, tile);
      progress->tile_done(f, picture, {2, 0, 4, 4}, tile);
      FrameReport done{f, "out/\"f\".exr", 1.5, tile};
      progress->frame_end(done);
      report.frames.push_back(done);
    }
    progress->end(report);
  }
  return testing::internal::GetCapturedStdout() + "\n--\n" + testing::internal::GetCapturedStderr();
}

TEST(Progress, JsonIsOneObjectPerLine) {
  std::istringstream lines(transcript(ProgressKind::kJson));
  std::vector<nlohmann::json> events;
  for (std::string line; std::getline(lines, line) && !line.empty();) events.push_back(nlohmann::json::parse(line));
  std::vector<std::string> kinds;
  kinds.reserve(events.size());
  for (const auto& e : events) kinds.push_back(e.at("event"));
  EXPECT_EQ(kinds, (std::vector<std::string>{"start", "frame", "done", "frame", "done", "end"}));
  EXPECT_EQ(events[0].at("frames"), (std::vector<int>{1, 2}));
  EXPECT_EQ(events[0].at("skipped"), 1);
  EXPECT_EQ(events[2].at("path"), "out/\"f\".exr");
  EXPECT_EQ(events[2].at("samples"), 100);
  EXPECT_EQ(events[5].at("frames"), 2);
}

TEST(Progress, WarningsAndErrorsAreEvents) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  write_warning_events();
  Warnings collected;
  collected.add("\"ewa\" is treated as bilinear", {"a.xml", 3, 7});
  collected.add("\"ewa\" is treated as bilinear", {"a.xml", 9, 1});
  collected.report();
  log_warning("the disk is nearly full");
  set_warning_observer({});
  log_warning("not told");
  write_error_event(Error(ErrorCode::kMissingFile, {"shot.toml", 2, 9}, "there is no scene"), 4);
  const std::string out = testing::internal::GetCapturedStdout(), err = testing::internal::GetCapturedStderr();
  EXPECT_EQ(out,
            "{\"event\":\"warning\",\"kind\":\"input\",\"message\":\"\\\"ewa\\\" is treated as bilinear\",\"count\":2,"
            "\"file\":\"a.xml\",\"line\":3,\"column\":7}\n"
            "{\"event\":\"warning\",\"kind\":\"general\",\"message\":\"the disk is nearly full\",\"count\":1}\n"
            "{\"event\":\"error\",\"kind\":\"missing_file\",\"message\":\"there is no scene\",\"status\":4,"
            "\"file\":\"shot.toml\",\"line\":2,\"column\":9}\n");
  EXPECT_EQ(err,
            "warning: \"ewa\" is treated as bilinear (2 times, first at a.xml:3:7)\n"
            "warning: the disk is nearly full\nwarning: not told\n")
      << "people read them as before";
}

TEST(Progress, OpenJobDescriptionLines) {
  const std::string text = transcript(ProgressKind::kOpenJd);
  EXPECT_EQ(text.find("openjd_progress: 0.00\n"), 0u) << text;
  EXPECT_NE(text.find("openjd_status: frame 2 (2 of 2)\n"), std::string::npos) << text;
  EXPECT_NE(text.find("openjd_progress: 100.00\n"), std::string::npos) << text;
}

TEST(Progress, StepsOfAJobShareItsPercentage) {
  testing::internal::CaptureStdout();
  const JobStep step{"reconstruct", 2, 3, 0.5, 0.9};
  announce_step(ProgressKind::kOpenJd, step);
  make_progress(ProgressKind::kOpenJd, step)->begin({});
  const auto stage = make_stage_progress(ProgressKind::kOpenJd, step);
  stage->begin({1}, {});
  stage->end(1);
  announce_results(ProgressKind::kJson, std::vector<JobResult>{{"render", 1.5, "f.####.exr"}});
  EXPECT_EQ(testing::internal::GetCapturedStdout(),
            "openjd_status: step 2 of 3: reconstruct\n"
            "openjd_progress: 50.00\nopenjd_status: 0 frames to render, 0 finished before\n"
            "openjd_progress: 50.00\nopenjd_status: 1 frames to do, 0 finished before\n"
            "openjd_progress: 90.00\nopenjd_status: 0 frames done in 0:01\n"
            "{\"event\":\"result\",\"steps\":[{\"step\":\"render\",\"seconds\":1.5,\"path\":\"f.####.exr\"}]}\n");
}

TEST(Progress, PlainLinesWhereThereIsNoTerminal) {
  for (const ProgressKind kind : {ProgressKind::kPlain, ProgressKind::kTty, ProgressKind::kAuto}) {
    const std::string text = transcript(kind);
    EXPECT_NE(text.find("--\nframe 1 done: seconds=1.500 samples=100 rays=0 path=out/\"f\".exr\nframe 2 done:"),
              std::string::npos)
        << text;
    EXPECT_EQ(text.find('\033'), std::string::npos) << "no bar in a file";
  }
  EXPECT_EQ(transcript(ProgressKind::kNone), "\n--\n");
}

TEST(Progress, HarmlessLinesDoNotSayError) {
  for (const ProgressKind kind : {ProgressKind::kPlain, ProgressKind::kJson, ProgressKind::kOpenJd}) {
    EXPECT_EQ(transcript(kind).find("rror"), std::string::npos);
  }
}

TEST(Progress, RefusesUnknownKinds) {
  EXPECT_EQ(parse_progress("json"), ProgressKind::kJson);
  EXPECT_THROW(parse_progress("xml"), Error);
}

}  // namespace
}  // namespace tempera
