// SPDX-License-Identifier: Apache-2.0
// What is the same for all stages, on stages that are made for it: a mean over three frames, one that drops every other
// frame, and one with two ports.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <set>

#include "tempera/frames/files.h"
#include "tempera/stages/stage_plan.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// The mean of `color` over the frame before, itself and the one after.
class MeanOfThree final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    std::erase_if(out.layers, [](const LayerDesc& d) { return d.role == LayerRole::kStatistic; });
    return out;
  }
  std::vector<LayerUse> reads(int, std::span<const SequenceDesc>) const override {
    return {{layers::color(), true, "a mean needs something to take it of"}, {layers::albedo(), false}};
  }
  std::vector<int> inputs(int, int frame, std::span<const SequenceDesc> in) const override {
    return frames_around(frame, 1, 1, in[0]);
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    EXPECT_FALSE(in.has(frame - 2) || in.has(frame + 2)) << "a window, not the sequence";
    EXPECT_FALSE(in.at(frame).has("color.var")) << "only what is declared";
    Image& color = out.layer("color");
    const std::vector<int> frames = inputs(0, frame, in.in());
    for (int y = 0; y < color.height(); ++y) {
      for (int x = 0; x < color.width(); ++x) {
        Rgb sum;
        for (const int f : frames) sum += in.at(f).layer("color").rgb(x, y);
        color.set_rgb(x, y, sum / float(frames.size()));
      }
    }
  }
};

/// Frames first, first + 2, ... of the sequence as they are.
class EveryOther final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    out.frames = in[0].all_frames();
    std::erase_if(out.frames, [&](int f) { return (f - in[0].sequence.first) % 2 != 0; });
    return out;
  }
  std::vector<LayerUse> reads(int, std::span<const SequenceDesc>) const override { return {}; }
  std::string identity(std::span<const SequenceDesc> in) const override {
    return fmt::format("from {}\n", in[0].sequence.first);
  }

 protected:
  void make(const FrameWindow&, int, Frame&) const override {}
};

/// `color` less that of the rendered frame.
class Change final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override { return in[0]; }
  std::vector<LayerUse> reads(int, std::span<const SequenceDesc>) const override {
    return {{layers::color(), true, ""}};
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    Image& color = out.layer("color");
    for (int y = 0; y < color.height(); ++y) {
      for (int x = 0; x < color.width(); ++x) {
        color.set_rgb(x, y, in.at(frame, 0).layer("color").rgb(x, y) - in.at(frame, 1).layer("color").rgb(x, y));
      }
    }
  }
};

template <class T>
StageEntry entry(const std::string& name, int ports = 1) {
  StageEntry e;
  e.name = name;
  e.done = "made";
  e.ports.resize(std::size_t(ports));
  e.gap_help = "a mean of three needs three";
  e.make = [](const Params&) -> std::unique_ptr<Stage> { return std::make_unique<T>(); };
  return e;
}
const StageEntry kMean = entry<MeanOfThree>("mean"), kEveryOther = entry<EveryOther>("every_other"),
                 kChange = entry<Change>("change", 2);
const StageChoice mean{&kMean, {}}, every_other{&kEveryOther, {}}, change{&kChange, {}};

std::vector<int> range(int first, int last) {
  std::vector<int> out;
  for (int f = first; f <= last; ++f) out.push_back(f);
  return out;
}

class StageFiles : public testing::Test {
 protected:
  StageFiles() {
    folder_ = fs::path(testing::TempDir()) / ("tempera_" + std::to_string(::getpid()) + "_" +
                                              testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string pattern(const std::string& name) const { return path(name + ".####.exr"); }

  /// Frames whose `color` is the number's square, at pixel (1, 0) twice that.
  FrameSequence write(const std::string& name, int first, int last) const {
    for (int f = first; f <= last; ++f) write_one(name, f, float(f * f));
    return FrameSequence(pattern(name));
  }
  void write_one(const std::string& name, int f, float value, int width = 2) const {
    Frame frame(width, 1);
    frame.create(layers::color()).set_rgb(0, 0, Rgb(value));
    frame.layer("color").set_rgb(1, 0, Rgb(2 * value));
    frame.layer("color").at(0, 0, 3) = 0.5f;
    frame.create(layers::normal()).set_vec3(0, 0, {0, 1, 0});
    frame.create(layers::color_variance());
    frame.metadata["tempera/spp"] = 7;
    frame.metadata[kFingerprintKey] = fmt::format("{} {}", f, value);
    write_frame(frame_path(pattern(name), f), frame);
  }
  StageReport run(const StageChoice& choice, const FrameSequence& in, const std::string& out,
                  StageOptions options = {}) const {
    StageObserver nobody;
    return run_stage(choice, std::span(&in, 1), pattern(out), options, nobody);
  }
  Frame result(const std::string& name, int frame) const { return read_frame(frame_path(pattern(name), frame)); }
  float value(const std::string& name, int frame) const { return result(name, frame).layer("color").at(0, 0); }
  std::string error_of(const std::function<void()>& f, ErrorCode code) const {
    try {
      f();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.what();
      return e.what();
    }
    ADD_FAILURE() << "no Error was thrown";
    return "";
  }
  fs::path folder_;
};

TEST_F(StageFiles, HaloEndsWithTheSequence) {
  const auto in = write("in", 3, 8);
  const StageReport r = run(mean, in, "out");
  EXPECT_EQ(r.frames, range(3, 8));
  EXPECT_FLOAT_EQ(value("out", 3), (9 + 16) / 2.0f);
  EXPECT_FLOAT_EQ(value("out", 5), (16 + 25 + 36) / 3.0f);
  EXPECT_FLOAT_EQ(value("out", 8), (49 + 64) / 2.0f);
  const Frame f = result("out", 5);
  EXPECT_FLOAT_EQ(f.layer("color").at(1, 0), 2 * (16 + 25 + 36) / 3.0f);
  EXPECT_EQ(f.layer("color").at(0, 0, 3), 0.5f) << "what a stage leaves alone passes through";
  EXPECT_EQ(f.layer("normal"), read_frame(in.path(5)).layer("normal"));
  EXPECT_FALSE(f.has("color.var"));
  EXPECT_EQ(std::get<int>(f.metadata.at("tempera/spp")), 7);
  EXPECT_FALSE(f.metadata.contains(kFingerprintKey)) << "it is not what a render would write";
  EXPECT_TRUE(f.metadata.contains("tempera/mean_fingerprint"));
}

TEST_F(StageFiles, ChunksGiveTheBitsOfTheWhole) {
  const auto in = write("in", 1, 12);
  run(mean, in, "whole");
  for (const std::vector<int>& frames : {range(1, 4), range(5, 5), {12, 7, 9}})
    run(mean, in, "part", {.sections = {{.frames = frames}}});
  for (const int f : {1, 2, 3, 4, 5, 7, 9, 12})
    EXPECT_EQ(result("part", f).layer("color"), result("whole", f).layer("color"));
  // A machine that holds no more than is read, and knows what the whole is.
  fs::create_directories(path("few"));
  for (const int f : {5, 6, 7, 8}) fs::copy_file(in.path(f), frame_path(path("few/in.####.exr"), f));
  run(mean, FrameSequence(path("few")), "far", {.sections = {{.frames = {6, 7}, .sequence = FrameRange{1, 12}}}});
  for (const int f : {6, 7}) EXPECT_EQ(result("far", f).layer("color"), result("whole", f).layer("color"));
  EXPECT_NE(error_of(
                [&] {
                  run(mean, FrameSequence(path("few")), "far", {.sections = {{{5, 6}, FrameRange{1, 12}}}});
                },
                ErrorCode::kBadInput)
                .find("lacks frames in between: 4; a mean of three needs three"),
            std::string::npos);
}

TEST_F(StageFiles, ResumeMakesWhatIsMissingOrWouldDiffer) {
  const auto in = write("in", 1, 12);
  run(mean, in, "whole"), run(mean, in, "out");
  const StageOptions resume{.resume = true};
  EXPECT_TRUE(run(mean, in, "out", resume).frames.empty());
  fs::remove(frame_path(pattern("out"), 4));
  std::string damaged = read_file(frame_path(pattern("out"), 9));
  write_file(frame_path(pattern("out"), 9), std::string_view(damaged).substr(0, damaged.size() - 30));
  StageReport r = run(mean, in, "out", resume);
  EXPECT_EQ(r.frames, (std::vector<int>{4, 9}));
  EXPECT_EQ(r.skipped.size(), 10u);
  for (int f = 1; f <= 12; ++f) {
    EXPECT_EQ(read_file(frame_path(pattern("out"), f)), read_file(frame_path(pattern("whole"), f))) << f;
  }
  write_one("in", 6, 99);
  EXPECT_EQ(run(mean, in, "out", resume).frames, range(5, 7)) << "all that read it, and no other";
  EXPECT_EQ(run(mean, in, "out", {.resume = true, .write = {.half = true}}).frames.size(), 12u);
}

TEST_F(StageFiles, PartsThatAreCutEndAtTheirReach) {
  const auto in = write("in", 1, 12);
  run(mean, in, "whole");
  const FrameRange sequence{1, 12};
  const StageOptions cut{.sections = {{{3, 4}, sequence, FrameRange{3, 5}}, {{9}, sequence, FrameRange{8, 9}}},
                         .resume = true};
  EXPECT_EQ(run(mean, in, "cut", cut).frames, (std::vector<int>{3, 4, 9}));
  EXPECT_FLOAT_EQ(value("cut", 3), (9 + 16) / 2.0f) << "as if the sequence began there";
  EXPECT_EQ(result("cut", 4).layer("color"), result("whole", 4).layer("color"));
  EXPECT_FLOAT_EQ(value("cut", 9), (64 + 81) / 2.0f);
  // The bound is part of what a frame is: what was made without it is not taken for what is made with it, nor the other
  // way round. Frame 4 is the same.
  EXPECT_EQ(run(mean, in, "cut", {.sections = {{{3, 4, 9}}}, .resume = true}).frames, (std::vector<int>{3, 9}));
  EXPECT_EQ(result("cut", 3).layer("color"), result("whole", 3).layer("color"));
  EXPECT_EQ(run(mean, in, "cut", cut).frames, (std::vector<int>{3, 9}));

  // What counts from the ends of the sequence goes on to do so.
  EXPECT_EQ(run(every_other, in, "odd", {.sections = {{{}, sequence, FrameRange{4, 9}}}}).frames,
            (std::vector<int>{1, 3, 5, 7, 9, 11}));
}

TEST_F(StageFiles, FramesCanBeLeftOut) {
  const auto in = write("in", 2, 9);
  EXPECT_EQ(run(every_other, in, "out").frames, (std::vector<int>{2, 4, 6, 8}));
  EXPECT_EQ(result("out", 4).layer("color"), read_frame(in.path(4)).layer("color"));
  EXPECT_NE(error_of(
                [&] {
                  run(every_other, in, "out", {.sections = {{{4, 5}}}});
                },
                ErrorCode::kMissingFile)
                .find("every_other makes no frame 5"),
            std::string::npos);
  EXPECT_EQ(run(every_other, in, "out", {.sections = {{{}, FrameRange{1, 9}}}, .resume = true}).frames,
            (std::vector<int>{3, 5, 7, 9}))
      << "counted from another first frame";
}

TEST_F(StageFiles, TwoPorts) {
  const auto in = write("in", 1, 5);
  run(mean, in, "mean");
  const std::vector<FrameSequence> both{FrameSequence(pattern("mean")), in};
  StageObserver nobody;
  run_stage(change, both, pattern("out"), {}, nobody);
  EXPECT_FLOAT_EQ(value("out", 3), (4 + 9 + 16) / 3.0f - 9);
  write_one("in", 4, 1);
  EXPECT_EQ(run_stage(change, both, pattern("out"), {.resume = true}, nobody).frames, std::vector<int>{4});
  EXPECT_NE(error_of([&] { run_stage(change, both, in.pattern(), {}, nobody); }, ErrorCode::kUsage)
                .find("would replace its own input"),
            std::string::npos);
}

TEST_F(StageFiles, StoppedInTheMiddleThenResumedGivesTheSameFiles) {
  const auto in = write("in", 1, 12);
  struct Stopper : StageObserver {
    std::stop_source stop;
    double last = 0;
    std::vector<int> frames;
    void begin(const std::vector<int>& all, const std::vector<int>&) override { frames = all; }
    void progress(double share) override {
      EXPECT_GE(share, last);
      last = share;
    }
    void frame_done(int frame, const std::string&) override {
      if (frame == 5) stop.request_stop();
    }
  } stopper;
  EXPECT_NE(error_of([&] { run_stage(mean, std::span(&in, 1), pattern("out"), {}, stopper, stopper.stop.get_token()); },
                     ErrorCode::kCancelled)
                .find("5 of 12 frames are done"),
            std::string::npos);
  EXPECT_EQ(stopper.frames, range(1, 12));
  EXPECT_FALSE(fs::exists(frame_path(pattern("out"), 6)));
  EXPECT_EQ(run(mean, in, "out", {.resume = true}).frames, range(6, 12));
  run(mean, in, "whole");
  for (int f = 1; f <= 12; ++f)
    EXPECT_EQ(read_file(frame_path(pattern("out"), f)), read_file(frame_path(pattern("whole"), f)));
}

TEST_F(StageFiles, BadInputIsNamed) {
  const auto in = write("in", 1, 4);
  const auto fails = [&](ErrorCode code, StageOptions options = {}) {
    return error_of([&] { run(mean, in, "never", options); }, code);
  };
  EXPECT_EQ(fails(ErrorCode::kMissingFile, {.sections = {{{5}}}}), in.pattern() + " has no frame 5; it has 1 to 4");
  write_one("in", 3, 1, 3);
  EXPECT_EQ(fails(ErrorCode::kBadInput), in.path(3) + " has 3x1 pixels, " + in.path(1) + " has 2x1");
  Frame bare(2, 1);
  bare.create(layers::normal());
  write_frame(in.path(3), bare);
  EXPECT_EQ(fails(ErrorCode::kBadInput), in.path(3) + " has no layer \"color\": a mean needs something to take it of");
  EXPECT_NE(error_of(
                [&] {
                  StageObserver nobody;
                  run_stage(mean, std::span(&in, 1), path("one.exr"), {}, nobody);
                },
                ErrorCode::kUsage)
                .find("one.####.exr"),
            std::string::npos);
}

TEST_F(StageFiles, IdentityTellsStagesApart) {
  // Both would come to the same fingerprint: neither has parameters, and both read the frame alone.
  const auto in = write("in", 1, 1);
  const StageEntry a = entry<MeanOfThree>("a"), b = entry<MeanOfThree>("b");
  run({&a, {}}, in, "a"), run({&b, {}}, in, "b");
  EXPECT_NE(content_identity(frame_path(pattern("a"), 1)), content_identity(frame_path(pattern("b"), 1)));
  EXPECT_EQ(content_identity(in.path(1)), "1 1");
}

SequenceDesc rendered(const FrameRange& sequence, bool differences = true) {
  SequenceDesc d{sequence, sequence, {}, 16, 16, {layers::color(), layers::albedo()}};
  if (!differences) return d;
  for (const LayerDesc& l : {layers::grad_x(), layers::grad_y()}) d.layers.push_back(l);
  for (const LayerDesc& l : {layers::color(), layers::grad_x(), layers::grad_y(), layers::source()})
    d.layers.push_back(layers::offset(l));
  return d;
}

TEST(StagePlan, GoesBackwardsFromTheFramesThatAreWanted) {
  const StageChoice reconstruct{&find_stage("reconstruct"), Params(find_stage("reconstruct").params)};
  const std::vector<StageChoice> chain{reconstruct, mean, every_other};
  const StagePlan plan = plan_stages(chain, rendered({1, 240}), std::vector<int>{51, 52, 53});
  ASSERT_EQ(plan.steps.size(), 3u);
  EXPECT_EQ(plan.steps[2].frames, (std::vector<int>{51, 53})) << "52 is not made";
  EXPECT_EQ(plan.steps[1].frames, (std::vector<int>{51, 53}));
  EXPECT_EQ(plan.steps[0].frames, range(50, 54));
  EXPECT_EQ(plan.source, range(45, 59)) << "windows of ten frames, every five";
  EXPECT_FALSE(plan.steps[1].in[0].has(layers::grad_x()));
  EXPECT_TRUE(plan.steps[2].out.has(layers::albedo()));

  // A bound ends the sequence for all of them.
  SequenceDesc bound = rendered({1, 240});
  bound.reach = {50, 53};
  const StagePlan cut = plan_stages(chain, bound, std::vector<int>{51, 53});
  EXPECT_EQ(cut.steps[0].frames, range(50, 53));
  EXPECT_EQ(cut.source, range(50, 53));

  const StagePlan ends = plan_stages(chain, rendered({1, 240}), std::vector<int>{1});
  EXPECT_EQ(ends.steps[0].frames, range(1, 2));
  EXPECT_EQ(ends.source, range(1, 9));
  EXPECT_EQ(plan_stages({}, rendered({1, 9}), std::vector<int>{2, 5}).source, (std::vector<int>{2, 5}));
}

TEST(StagePlan, OtherPortsGetTheRenderedFrames) {
  const std::vector<StageChoice> chain{mean, change};
  const StagePlan plan = plan_stages(chain, rendered({1, 9}, false), std::vector<int>{9});
  EXPECT_EQ(plan.steps[0].frames, std::vector<int>{9});
  EXPECT_EQ(plan.source, (std::vector<int>{8, 9}));
  ASSERT_EQ(plan.steps[1].in.size(), 2u);
  EXPECT_TRUE(plan.steps[1].in[1].has(layers::albedo()));
}

TEST(StagePlan, WhatCannotFollowIsRefused) {
  const StageChoice reconstruct{&find_stage("reconstruct"), Params(find_stage("reconstruct").params)};
  try {
    plan_stages(std::vector<StageChoice>{mean, reconstruct}, rendered({1, 9}, false), std::vector<int>{2});
    ADD_FAILURE() << "no Error was thrown";
  } catch (const MissingLayerError& e) {
    EXPECT_EQ(e.step(), 1u);
    EXPECT_EQ(e.use().layer.name, "grad.x");
    EXPECT_EQ(e.message(), "the stage reconstruct needs the layer \"grad.x\"");
  }
  try {
    plan_stages(std::vector<StageChoice>{every_other, mean}, rendered({1, 9}), std::vector<int>{3});
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.message(), "the stage mean needs frame 2, which the stage every_other does not make");
  }
}

/// Runs a chain as its plan says, whatever is done already.
void run_chain(const std::vector<StageChoice>& chain, const FrameSequence& source, const FrameRange& sequence,
               const std::vector<int>& wanted, const std::string& folder) {
  SequenceDesc desc{sequence, sequence, {}, 0, 0, {}};
  const FrameHeader header = read_header(source.path(source.frames()[0]));
  desc.width = header.width, desc.height = header.height, desc.layers = header.layers;
  const StagePlan plan = plan_stages(chain, desc, wanted);
  FrameSequence in = source;
  StageObserver nobody;
  for (std::size_t i = 0; i < chain.size(); ++i) {
    const std::string out = fmt::format("{}/{}/f.####.exr", folder, i);
    run_stage(chain[i], std::span(&in, 1), out, {.sections = {{plan.steps[i].frames, sequence}}, .resume = true},
              nobody);
    in = FrameSequence(out, plan.steps[i].frames);
  }
}

TEST_F(StageFiles, ChainsGiveTheBitsOfTheWholeInParts) {
  // Pictures and differences that move by a pixel a frame, and replay it.
  constexpr int kWidth = 12, kHeight = 9, kFrames = 14;
  const auto light = [](int x, int y, int frame) { return 0.5f + 0.4f * float((7 * (x - frame) + 5 * y) % 11) / 11; };
  for (int f = 1; f <= kFrames; ++f) {
    Frame frame(kWidth, kHeight);
    for (const bool offset : {false, true}) {
      const auto layer = [&](const LayerDesc& d) -> Image& { return frame.create(offset ? layers::offset(d) : d); };
      Image &color = layer(layers::color()), &dx = layer(layers::grad_x()), &dy = layer(layers::grad_y());
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
          color.set_rgb(x, y, Rgb(light(x, y, f) + 0.1f * float((x * 3 + y * 5 + f * (offset ? 2 : 7)) % 4)));
          dx.set_rgb(x, y, Rgb(light(x + 1, y, f) - light(x, y, f)));
          dy.set_rgb(x, y, Rgb(light(x, y + 1, f) - light(x, y, f)));
        }
      }
    }
    Image& source = frame.create(layers::offset(layers::source()));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = f == 1 ? kWidth : 1; x < kWidth; ++x) {
        source.at(x, y, 0) = float(x - 1), source.at(x, y, 1) = float(y), source.at(x, y, 2) = 1;
      }
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  const FrameSequence in(pattern("in"));
  StageChoice reconstruct{&find_stage("reconstruct"), Params(find_stage("reconstruct").params)};
  reconstruct.params.set("window", 4);
  const std::vector<StageChoice> chain{reconstruct, mean, every_other};
  const FrameRange sequence{1, kFrames};
  run_chain(chain, in, sequence, range(1, kFrames), path("whole"));
  run_chain(chain, in, sequence, range(1, 5), path("parts"));
  EXPECT_FALSE(fs::exists(path("parts/0/f.0007.exr"))) << "no more than is needed";
  run_chain(chain, in, sequence, range(6, kFrames), path("parts"));
  for (int f = 1; f <= kFrames; f += 2) {
    EXPECT_EQ(read_file(frame_path(path("parts/2/f.####.exr"), f)),
              read_file(frame_path(path("whole/2/f.####.exr"), f)))
        << f;
  }
  EXPECT_FALSE(fs::exists(path("whole/2/f.0002.exr")));
  const Metadata metadata = read_metadata(path("whole/2/f.0003.exr"));
  EXPECT_TRUE(metadata.contains("tempera/reconstruct")) << "what was done before";
  EXPECT_TRUE(metadata.contains("tempera/every_other_fingerprint"));
  EXPECT_FALSE(metadata.contains("tempera/mean_fingerprint")) << "one identity";
}

TEST(StageCatalog, ManualsNameWhatStagesRead) {
  std::set<std::string> names;
  for (const StageEntry* e : stage_catalog()) {
    EXPECT_TRUE(names.insert(e->name).second);
    EXPECT_EQ(&find_stage(e->name), e);
    for (const std::string* text : {&e->help, &e->command_help, &e->done, &e->output_help, &e->window})
      EXPECT_FALSE(text->empty()) << e->name;
    ASSERT_FALSE(e->ports.empty());
    std::set<std::string> manual;
    for (const LayerHelp& h : e->reads) manual.insert(h.layers.begin(), h.layers.end());
    // Sequences of all layers that there are, with and without the second pass.
    for (const bool offset : {false, true}) {
      SequenceDesc all{{1, 9}, {1, 9}, {}, 4, 4, layers::known()};
      for (const LayerDesc& d : layers::known()) {
        if (offset) all.layers.push_back(layers::offset(d));
      }
      const std::unique_ptr<Stage> stage = e->make(Params(e->params));
      std::vector<SequenceDesc> in(e->ports.size(), all);
      for (std::size_t port = 0; port < in.size(); ++port) {
        if (e->ports[port].guides) in[port].width *= e->enlarges, in[port].height *= e->enlarges;
      }
      std::set<std::string> written;
      for (const LayerHelp& h : e->writes) written.insert(h.layers.begin(), h.layers.end());
      for (int port = 0; port < int(in.size()); ++port) {
        for (const LayerUse& use : stage->reads(port, in)) {
          EXPECT_TRUE(manual.contains(use.layer.name) || manual.contains("*")) << e->name << ' ' << use.layer.name;
        }
        for (const int frame : {8, 9}) {
          for (const int f : stage->inputs(port, frame, in)) EXPECT_TRUE(all.reach.contains(f)) << e->name << ' ' << f;
        }
        if (port == 0) {
          EXPECT_EQ(stage->inputs(port, 9, in).back(), 9) << e->name;
        }
      }
      const SequenceDesc out = stage->output(in);
      for (const LayerDesc& d : out.layers) EXPECT_TRUE(all.has(d) || written.contains(d.name)) << d.name;
    }
  }
  try {
    find_stage("reconstuct", {"shot.toml", 3, 4});
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
    EXPECT_EQ(e.loc().line, 3);
    EXPECT_NE(e.message().find("known: reconstruct"), std::string::npos);
  }
}

}  // namespace
}  // namespace tempera
