// SPDX-License-Identifier: Apache-2.0
// Stages that leave pixels to the renderer, through all steps of a run: the result has the bits of the whole render.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <set>

#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/pipeline/run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// Leaves every other pixel out, in frame 2 none; in frame 3 also all of the left third. `scale`: makes pictures so
/// many times larger.
class DropPixels final : public FrameStage {
 public:
  explicit DropPixels(int scale) : scale_(scale) {}
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    out.width *= scale_, out.height *= scale_;
    out.layers.push_back(layers::mask());
    return out;
  }
  std::vector<LayerUse> reads(int, std::span<const SequenceDesc> in) const override {
    std::vector<LayerUse> all;
    for (const LayerDesc& d : in[0].layers) all.push_back({d, true, "all"});
    return all;
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    Image& mask = out.create(layers::mask());
    for (const Layer& from : in.at(frame).layers()) {
      Image& to = out.create(from.desc);
      for (int y = 0; y < to.height(); ++y) {
        for (int x = 0; x < to.width(); ++x) {
          const bool left_out =
              scale_ > 1 || (frame != 2 && ((x + y + frame) % 2 == 0 || (frame == 3 && x < to.width() / 3)));
          mask.at(x, y) = left_out ? 1.0f : 0.0f;
          for (int c = 0; c < to.channels(); ++c)
            to.at(x, y, c) = left_out ? -1.0f : from.image.at(x / scale_, y / scale_, c);
        }
      }
    }
  }

 private:
  int scale_;
};

template <int kScale>
StageEntry drop_entry(const std::string& name = "drop") {
  StageEntry e;
  e.name = name;
  e.done = "thinned";
  e.output_help = "thinned frames";
  e.ports.resize(1);
  e.make = [](const Params&) -> std::unique_ptr<Stage> { return std::make_unique<DropPixels>(kScale); };
  return e;
}
const StageEntry kDrop = drop_entry<1>(), kDropLarge = drop_entry<2>(), kAgain = drop_entry<1>("again");

/// Counts what is made, and asks to stop after so many tiles of pixels.
struct Watch : RunObserver {
  int stop_after = -1;
  std::atomic<int> tiles = 0;
  int pixel_frames = 0, stage_frames = 0;
  std::uint64_t samples = 0;
  std::stop_source stop;

  std::unique_ptr<RenderObserver> begin_pixels(const RunStage&) override {
    struct Tiles : RenderObserver {
      explicit Tiles(Watch& w) : watch(w) {}
      void tile_done(int, const Frame&, const Tile&, const RenderTotals&) override {
        if (++watch.tiles == watch.stop_after) watch.stop.request_stop();
      }
      Watch& watch;
    };
    return std::make_unique<Tiles>(*this);
  }
  void end_pixels(const RunStage&, const RenderReport& report) override {
    pixel_frames += int(report.frames.size());
    samples += report.totals.samples;
  }
  void end_stage(const RunStage&, const StageReport& report) override { stage_frames += int(report.frames.size()); }
};

class RunPixels : public testing::Test {
 protected:
  void SetUp() override {
    set_log_level(LogLevel::kWarning);
    folder_ = fs::temp_directory_path() / ("tempera_run_pixels_" + std::to_string(getpid()) + "_" +
                                           testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
  }
  void TearDown() override {
    fs::remove_all(folder_);
    set_log_level(LogLevel::kInfo);
  }
  std::string frames(const std::string& folder) const { return (folder_ / folder / "f.####.exr").string(); }

  /// A shot of frames 1 to 3 with tiles 3 x 2, after which comes `stage`, if there is one.
  struct Settled {
    ShotConfig config;
    LoadedShot loaded;
    RunPlan plan() const { return plan_run(config, loaded.shot, false); }
    void follow(const StageEntry& entry) {
      ShotStage stage;
      stage.choice.entry = &entry;
      loaded.shot.stages.push_back(stage);
    }
  };
  Settled settle(const std::string& folder, const StageEntry* stage, const std::string& toml = "") const {
    Settled s;
    s.config.read_text(
        fmt::format("scene = \"{}/scenes/tests/cornell_motion.xml\"\nframes = \"1-3\"\n{}", TEMPERA_SOURCE_DIR, toml),
        "shot.toml", ".");
    s.config.assign("output.path=" + frames(folder));
    s.config.assign("output.layers=albedo,halves,motion,cryptomatte");
    s.config.assign("sampling.spp=3");
    if (!s.config.find("film.resolution")) s.config.assign("film.resolution=70x50");
    Warnings warnings;
    s.loaded = load_shot(s.config, {}, warnings);
    if (stage) s.follow(*stage);
    return s;
  }
  /// Frames `part` of a shot of six.
  Settled part_of(const std::string& folder, const std::string& toml, const std::vector<int>& part) const {
    Settled s = settle(folder, nullptr, toml);
    s.loaded.shot.sequence = {1, 6};
    s.loaded.shot.frames = part;
    s.loaded.shot.output = frames(folder);
    return s;
  }
  RunPlan run(const Settled& s, Watch& watch, bool resume = false) const {
    RunPlan plan = s.plan();
    const RenderOptions options{.resume = resume, .checkpoint_seconds = 0, .command = "tempera run"};
    render_sequence(plan.render, s.loaded.scene, options, {});
    run_stages(plan, s.loaded.scene, options, watch, watch.stop.get_token());
    return plan;
  }
  RunPlan run(const Settled& s) const {
    Watch watch;
    return run(s, watch);
  }
  static void expect_same(const std::string& a, const std::string& b, const std::vector<int>& frames) {
    for (const int f : frames) {
      const Frame x = read_frame(frame_path(a, f)), y = read_frame(frame_path(b, f));
      ASSERT_EQ(x.layer_names(), y.layer_names());
      for (const Layer& l : x.layers()) EXPECT_EQ(l.image, y.layer(l.desc.name)) << l.desc.name << " of frame " << f;
    }
  }
  Error error_of(const std::function<void()>& f) const {
    try {
      f();
    } catch (const Error& e) {
      return e;
    }
    ADD_FAILURE() << "no Error was thrown";
    return {ErrorCode::kFailed, ""};
  }
  fs::path folder_;
};

TEST_F(RunPixels, WhatAStageLeavesOutIsRenderedAndFilledIn) {
  run(settle("whole", nullptr));
  for (const int threads : {1, 3}) {
    with_threads(threads, [&] {
      Watch watch;
      const RunPlan plan = run(settle("run", &kDrop), watch);
      ASSERT_EQ(plan.stages.size(), 2u);
      EXPECT_EQ(plan.stages[0].output, frames("run/drop.masked"));
      EXPECT_EQ(plan.stages[1].pixels->output, frames("run/drop.pixels"));
      EXPECT_EQ(plan.output, frames("run/final"));
      expect_same(plan.output, frames("whole"), {1, 2, 3});
      // Half of two frames, and half of two thirds and a third of the other.
      EXPECT_NEAR(double(watch.samples), 3.0 * 70 * 50 * (0.5 + 0 + 2.0 / 3), 3 * 120.0);
      EXPECT_EQ(read_frame(frame_path(plan.stages[0].output, 1)).layer("color").at(1, 0), -1) << "it was left out";
      EXPECT_TRUE(read_metadata(frame_path(plan.output, 1)).contains("tempera/fill_fingerprint"));
    });
    fs::remove_all(folder_ / "run");
  }
}

TEST_F(RunPixels, StoppedAmongPixelsThenResumed) {
  run(settle("whole", nullptr));
  const Settled s = settle("run", &kDrop);
  Watch stopped;
  stopped.stop_after = 2;
  EXPECT_EQ(error_of([&] { run(s, stopped); }).code(), ErrorCode::kCancelled);
  EXPECT_TRUE(fs::exists(frame_path(frames("run/drop.pixels"), 1) + ".partial"));
  Watch resumed;
  const RunPlan plan = run(s, resumed, true);
  EXPECT_LT(resumed.tiles, 18) << "it went on from the checkpoint";
  EXPECT_EQ(resumed.pixel_frames, 3);
  EXPECT_EQ(resumed.stage_frames, 3) << "what the stage wrote was finished; three were filled";
  expect_same(plan.output, frames("whole"), {1, 2, 3});
  Watch again;
  run(s, again, true);
  EXPECT_EQ(again.pixel_frames + again.stage_frames, 0);
  fs::remove(frame_path(frames("run/drop.masked"), 3));
  run(s, again, true);
  EXPECT_EQ(again.pixel_frames, 0) << "the same mask again";
  EXPECT_EQ(again.stage_frames, 1);
}

TEST_F(RunPixels, PartsHaveTheBitsOfTheWhole) {
  run(settle("whole", nullptr));
  for (const std::vector<int>& part : {std::vector<int>{2}, std::vector<int>{3, 1}}) {
    Settled s = settle("run", &kDrop);
    s.loaded.shot.frames = part;
    s.loaded.shot.output = frames("run");
    run(s);
  }
  expect_same(frames("run/final"), frames("whole"), {1, 2, 3});
}

TEST_F(RunPixels, OfTheStagesSizeAndInTheCropWindow) {
  run(settle("large", nullptr, "[film]\nresolution = \"140x100\"\n"));
  const RunPlan plan = run(settle("run", &kDropLarge));
  expect_same(plan.output, frames("large"), {1, 2, 3});

  const std::string crop = "[film]\nresolution = \"70x50\"\ncrop = \"7,3,40,35\"\n";
  run(settle("cropped", nullptr, crop));
  expect_same(run(settle("crop", &kDrop, crop)).output, frames("cropped"), {1, 2, 3});
  run(settle("cropped_large", nullptr, "[film]\nresolution = \"140x100\"\ncrop = \"14,6,80,70\"\n"));
  expect_same(run(settle("crop_large", &kDropLarge, crop)).output, frames("cropped_large"), {1, 2, 3});
}

TEST_F(RunPixels, StagesAfterItGetFilledFrames) {
  const std::string half = "[output]\nhalf = true\n";
  run(settle("whole", nullptr, half));
  Settled s = settle("run", &kDrop, half);
  s.follow(kAgain);
  const RunPlan plan = run(s);
  std::vector<std::string> outputs;
  for (const RunStage& stage : plan.stages) outputs.push_back(fs::path(stage.output).parent_path().filename());
  EXPECT_EQ(outputs, (std::vector<std::string>{"drop.masked", "drop", "again.masked", "final"}));
  expect_same(plan.output, frames("whole"), {1, 2, 3});
}

TEST_F(RunPixels, WhatCannotBeIsSaidBeforeRendering) {
  const Error whole_only = error_of([&] { settle("run", &kDrop, "[integrator]\nname = \"gradient_path\"\n").plan(); });
  EXPECT_EQ(whole_only.code(), ErrorCode::kUnsupported);
  EXPECT_NE(
      whole_only.message().find("the stage drop has single pixels rendered, but the integrator \"gradient_path\""),
      std::string::npos)
      << whole_only.what();
  Settled masked = settle("run", &kDrop);
  masked.loaded.shot.mask = "m.exr";
  EXPECT_NE(error_of([&] { masked.plan(); }).message().find("takes no other"), std::string::npos);
  const Error named = error_of([&] { settle("run", nullptr, "stages = [\"fill\"]\n"); });
  EXPECT_EQ(named.loc().line, 3);
  EXPECT_NE(named.message().find("fill is not named"), std::string::npos) << named.what();
  EXPECT_FALSE(fs::exists(folder_));
}

// The whole of quality fast: keys at half the size, guides, pixels rendered twice, motion blur.
TEST_F(RunPixels, FastGivesTheSameBitsInParts) {
  const std::string fast =
      "quality = \"fast\"\n[film]\nresolution = \"48x32\"\n[guides]\nspp = 2\n[denoise]\nmethod = \"nl_means\"\n";
  const auto of = [&](const std::string& folder, const std::vector<int>& part) { return part_of(folder, fast, part); };
  Watch watch;
  const RunPlan whole = run(of("whole", {1, 2, 3, 4, 5, 6}), watch);
  EXPECT_EQ(whole.render.frames, (std::vector<int>{1, 5, 6}));
  EXPECT_EQ(whole.frames.size(), 6u);
  EXPECT_GT(watch.samples, 0u) << "edges of what moves are rendered";
  for (const int f : {3, 6, 2}) run(of("parts", {f}));
  const RunPlan again = of("parts", {2, 3, 6}).plan();
  expect_same(whole.output, again.output, {2, 3, 6});

  const Frame key = read_frame(frame_path(whole.output, 1)), between = read_frame(frame_path(whole.output, 3));
  const auto names = [](const Frame& f) {
    const std::vector<std::string> all = f.layer_names();
    return std::set<std::string>(all.begin(), all.end());
  };
  EXPECT_EQ(names(key), names(between));
  EXPECT_EQ(between.width(), 48);
  for (const char* layer : {"color", "albedo", "motion.forward", "CryptoObject00"})
    EXPECT_TRUE(between.has(layer)) << layer;
  EXPECT_FALSE(between.has("mask") || between.has("depth")) << "the result has what was asked for";
  const auto info = render_info(between.metadata);
  ASSERT_TRUE(info);
  EXPECT_EQ(info->frame, 3);
  EXPECT_NEAR(info->shutter_close - info->shutter_open, 0.5, 1e-6);
}

// Each class of a decomposition is denoised, enlarged and followed to the next key by itself.
TEST_F(RunPixels, FastOfClassesGivesTheSameBitsInParts) {
  const std::string fast =
      "quality = \"fast\"\n[film]\nresolution = \"48x32\"\n[guides]\nspp = 2\n[decompose]\ntree = \"default\"\n"
      "[denoise]\nmethod = \"nl_means\"\n";
  const auto of = [&](const std::string& folder, const std::vector<int>& part) { return part_of(folder, fast, part); };
  const RunPlan whole = run(of("whole", {2, 3}));
  for (const int f : {3, 2}) run(of("parts", {f}));
  expect_same(whole.output, of("parts", {2, 3}).plan().output, {2, 3});
  const Frame between = read_frame(frame_path(
      (fs::path(whole.output).parent_path().parent_path() / "interpolate" / fs::path(whole.output).filename()).string(),
      3));
  ASSERT_TRUE(between.has("class.reflection.color"));
  double color = 0, classes = 0;
  for (const Layer& l : between.layers()) {
    if (l.desc.path_class.empty() && l.desc.name != "color") continue;
    for (int y = 0; y < between.height(); ++y) {
      for (int x = 0; x < between.width(); ++x)
        (l.desc.name == "color" ? color : classes) += double(l.image.at(x, y, 1));
    }
  }
  EXPECT_GT(color, 0);
  EXPECT_NEAR(classes / color, 1, 0.01) << "they add up";
}

TEST_F(RunPixels, FastMakesACropWindowToo) {
  const Settled s =
      settle("crop", nullptr,
             "quality = \"fast\"\n[film]\nresolution = \"48x32\"\ncrop = \"16,8,24,16\"\n[guides]\nspp = 2\n"
             "[denoise]\nmethod = \"nl_means\"\n");
  const RunPlan plan = run(s);
  const Frame out = read_frame(frame_path(plan.output, 2));
  EXPECT_EQ(out.width(), 24);
  EXPECT_EQ(out.height(), 16);
  EXPECT_EQ(out.metadata.at("tempera/crop_left"), MetaValue(16));
  // What is seen there is what guides of the whole picture see.
  Settled whole = settle("whole", nullptr, "[film]\nresolution = \"48x32\"\n[shutter]\nopen = 0.25\nclose = 0.25\n");
  const Image all = read_frame(frame_path(run(whole).output, 2)).layer("motion.forward");
  const Image part = read_frame(frame_path(plan.guides->output, 2)).layer("motion.forward");
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 24; ++x) EXPECT_NEAR(part.at(x, y, 0), all.at(x + 16, y + 8, 0), 1e-4f) << x << "," << y;
  }
}

TEST_F(RunPixels, WhereAllFramesAreKeysThereAreNoGuides) {
  const std::string closed = "[shutter]\nclose = 0\n";
  Settled s = settle("keys", nullptr, "stages = [\"interpolate\"]\n" + closed);
  s.loaded.shot.frames = {1};
  s.loaded.shot.output = frames("keys");
  const RunPlan plan = run(s);
  EXPECT_FALSE(plan.guides);
  EXPECT_EQ(read_frame(frame_path(plan.output, 1)).layer("color"),
            read_frame(frame_path(plan.render.output, 1)).layer("color"));
}

// As docs/motion-stages.md has it: more frames a second, of which every fourth is rendered.
TEST_F(RunPixels, SlowMotionIsTheSameMotionInMoreFrames) {
  const std::string sharp = "[shutter]\nopen = 0\nclose = 0\n[film]\nresolution = \"48x32\"\n";
  Settled s = settle("slow", nullptr,
                     "fps = 96\nquality = \"fast\"\n" + sharp +
                         "[guides]\nspp = 2\n[video]\nfps = 24\n[denoise]\nmethod = \"nl_means\"\n");
  s.loaded.shot.sequence = {1, 9};
  s.loaded.shot.frames = {1, 2, 3, 4, 5, 6, 7, 8, 9};
  s.loaded.shot.output = frames("slow");
  const RunPlan plan = run(s);
  EXPECT_EQ(plan.render.frames, (std::vector<int>{1, 5, 9})) << "24 keys a second";
  EXPECT_EQ(plan.frames.size(), 9u);
  EXPECT_EQ(s.loaded.shot.video.fps, 24);
  // The picture of frame 7 at 96 frames a second is that of frame 2.5 at 24, and moves a quarter as far to the next.
  const RunPlan direct =
      run(settle("direct", nullptr, "[shutter]\nopen = 0.5\nclose = 0.5\n[film]\nresolution = \"48x32\"\n"));
  const Frame slow = read_frame(frame_path(plan.output, 7)), truth = read_frame(frame_path(direct.output, 2));
  const Image &v = slow.layer("motion.forward"), &v4 = truth.layer("motion.forward");
  double quarter = 0, whole = 0;
  for (std::size_t i = 0; i < v.values().size(); i += 4) {
    if (!(v.values()[i + 3] > 0.5f && v4.values()[i + 3] > 0.5f)) continue;
    quarter += std::hypot(double(v.values()[i]), double(v.values()[i + 1]));
    whole += std::hypot(double(v4.values()[i]), double(v4.values()[i + 1]));
  }
  ASSERT_GT(whole, 1);
  EXPECT_NEAR(4 * quarter / whole, 1, 0.05);
}

}  // namespace
}  // namespace tempera
