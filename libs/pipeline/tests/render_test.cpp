// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/render.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/pipeline/progress.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// A folder of its own for each test.
class RenderSequence : public testing::Test {
 protected:
  void SetUp() override {
    set_log_level(LogLevel::kWarning);
    folder_ = fs::temp_directory_path() / ("tempera_render_" + std::to_string(getpid()) + "_" +
                                           testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    scene_.animation = {0, 1};
    scene_.nodes.resize(2);
    scene_.nodes[0].local.keyed = true;
    scene_.nodes[0].local.translation = Animated<Vec3d>({0, 1}, {{-0.5, 0, 0}, {0.5, 0, 0}}, Interpolation::kLinear);
    scene_.nodes[1].local = look_at(Vec3d{0, 0, 3}, Vec3d{0, 0, 0}, Vec3d{0, 1, 0});
    scene_.shapes.push_back({make_rectangle(), make_diffuse(0.7f), std::nullopt, "card", "paint"});
    scene_.groups = {{0}};
    scene_.instances.push_back({0, 0, "card", true});
    scene_.environments.resize(1);
    scene_.cameras.resize(1);
    scene_.cameras[0].node = 1;
    validate(scene_);

    shot_.scene_file = "scene.xml";
    shot_.settings.width = 80, shot_.settings.height = 70;  // 3 x 3 tiles
    shot_.settings.spp = 2;
    shot_.settings.layers = {"color", "albedo", "motion.forward", "CryptoObject00"};
    shot_.params = Params(find_method("path").params);
    shot_.frames = {1, 2, 3};
    shot_.output = (folder_ / "f.####.exr").string();
  }
  void TearDown() override {
    fs::remove_all(folder_);
    set_log_level(LogLevel::kInfo);
  }

  void adaptive() {
    shot_.settings.spp = 16;
    shot_.settings.layers = {"color", "samples"};
    shot_.integrator = "temporal_gradient_path";
    shot_.params = Params(find_method(shot_.integrator).params);
    shot_.params.set("adaptive", std::string("published"));
  }
  RenderReport render(bool resume = false, RenderObserver* observer = nullptr, const std::stop_token& stop = {}) {
    RenderOptions options;
    options.resume = resume;
    options.command = "tempera render shot";
    std::vector<RenderObserver*> observers;
    if (observer) observers.push_back(observer);
    return render_sequence(shot_, scene_, options, observers, stop);
  }
  std::string file(int frame) const { return frame_path(shot_.output, frame); }
  void expect_right(int frame) const {
    const Frame wanted = render_frame(shot_, scene_, frame), got = read_frame(file(frame));
    ASSERT_EQ(got.layer_names(), wanted.layer_names());
    for (const Layer& l : wanted.layers())
      EXPECT_EQ(got.layer(l.desc.name), l.image) << l.desc.name << " of frame " << frame;
  }
  std::size_t files() const {
    return std::size_t(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }

  fs::path folder_;
  Scene scene_;
  Shot shot_;
};

/// Asks to stop once `tiles` tiles are done.
struct StopAfter : RenderObserver {
  explicit StopAfter(int tiles) : left(tiles) {}
  void tile_done(int, const Frame&, const Tile&, const RenderTotals&) override {
    if (--left == 0) source.request_stop();
  }
  std::atomic<int> left;
  std::stop_source source;
};

ErrorCode code_of(const std::function<void()>& f) {
  try {
    f();
  } catch (const Error& e) {
    return e.code();
  }
  return ErrorCode::kDiffers;  // nothing was thrown
}

TEST_F(RenderSequence, CamerasThatAFrameCannotBeSeenThroughAreRefusedFirst) {
  // Scale, and in turn NaN, of the camera in the last of three frames alone.
  fs::create_directories(folder_);
  const double d = 1 / shot_.settings.clock.fps;
  for (const double bad : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
    scene_.nodes[1].local.keyed = true;
    scene_.nodes[1].local.scale = Animated<Vec3d>({2.6 * d, 3 * d}, {{1, 1, 1}, {1, 1, bad}}, Interpolation::kLinear);
    try {
      render();
      ADD_FAILURE() << "accepted " << bad;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      // Motion vectors look one frame ahead.
      EXPECT_NE(e.message().find("frame 2: camera"), std::string::npos) << e.what();
    }
    EXPECT_EQ(files(), 0u) << "nothing was rendered";
  }
}

TEST_F(RenderSequence, FramesNeverReplaceEachOther) {
  fs::create_directories(folder_);
  shot_.output = (folder_ / "f.exr").string();
  EXPECT_EQ(code_of([&] { render(); }), ErrorCode::kUsage);
  EXPECT_EQ(files(), 0u);
  shot_.frames = {2};
  render();
  EXPECT_TRUE(fs::exists(folder_ / "f.exr"));
}

TEST_F(RenderSequence, WritesFramesWithTheirRecord) {
  const RenderReport report = render();
  EXPECT_EQ(report.frames.size(), 3u);
  EXPECT_EQ(report.totals.samples, 3u * 80 * 70 * 2);
  EXPECT_EQ(files(), 3u) << "nothing but frames";
  for (const int f : shot_.frames) expect_right(f);
  const Metadata m = read_metadata(file(2));
  const auto info = render_info(m);
  ASSERT_TRUE(info);
  EXPECT_EQ(info->frame, 2);
  EXPECT_EQ(info->spp, 2);
  EXPECT_EQ(info->integrator, "path");
  EXPECT_EQ(info->command, "tempera render shot");
  EXPECT_EQ(std::get<std::string>(m.at("tempera/fingerprint")), fingerprint(shot_, scene_, 2));
}

TEST_F(RenderSequence, MovesAndSaysSo) {
  shot_.settings.clock.shutter.close = 0;
  shot_.frames = {6};
  const Frame f = render_frame(shot_, scene_, 6);
  // The card travels 1 m in 24 frames; seen from 3 m with 45 degrees over 80 pixels.
  const double pixels = 1.0 / 24 / (2 * 3 * std::tan(0.7853982 / 2)) * 80;
  const Image& motion = f.layer("motion.forward");
  EXPECT_EQ(motion.at(40, 35, 3), 1.0f);
  EXPECT_NEAR(motion.at(40, 35, 0), pixels, 1e-3);
  EXPECT_NEAR(motion.at(40, 35, 1), 0, 1e-4);
}

TEST_F(RenderSequence, ThreadsAndSplitsDoNotChangeABit) {
  with_threads(1, [&] { render(); });
  std::vector<Frame> one;
  for (const int f : shot_.frames) one.push_back(read_frame(file(f)));
  for (const int threads : {2, 7}) {
    fs::remove_all(folder_);
    with_threads(threads, [&] {
      for (const int f : {3, 1, 2}) {
        shot_.frames = {f};
        render();
      }
    });
    for (int f = 1; f <= 3; ++f) {
      const Frame other = read_frame(file(f));
      for (const Layer& l : other.layers()) EXPECT_EQ(l.image, one[f - 1].layer(l.desc.name)) << l.desc.name;
    }
  }
}

// The offset pass repeats the sample counts of the frame before, which a machine that renders one frame has not
// rendered.
TEST_F(RenderSequence, AdaptiveFramesDoNotDependOnTheSplit) {
  adaptive();
  with_threads(2, [&] { render(); });
  std::vector<Frame> one;
  for (const int f : shot_.frames) one.push_back(read_frame(file(f)));
  const Image& samples = one[0].layer("samples");
  EXPECT_NE(*std::min_element(samples.values().begin(), samples.values().end()),
            *std::max_element(samples.values().begin(), samples.values().end()));
  const auto expect_same = [&] {
    for (int f = 1; f <= 3; ++f) {
      const Frame other = read_frame(file(f));
      for (const Layer& l : other.layers())
        EXPECT_EQ(l.image, one[f - 1].layer(l.desc.name)) << l.desc.name << " of frame " << f;
    }
  };
  fs::remove_all(folder_);
  for (const int f : {3, 1, 2}) {  // frame 2 finds the file of frame 1, the others find none
    shot_.frames = {f};
    with_threads(1, [&] { render(); });
  }
  expect_same();

  fs::remove(file(2));
  shot_.frames = {1, 2, 3};
  for (const int units : {4, 12, 22}) {  // in both batches, and among the tiles of the offset pass
    fs::remove(file(2));
    StopAfter stop(units);
    EXPECT_EQ(code_of([&] { render(true, &stop, stop.source.get_token()); }), ErrorCode::kCancelled) << units;
    EXPECT_TRUE(fs::exists(file(2) + ".partial")) << units;
    struct Count : RenderObserver {
      std::atomic<int> units{0};
      void tile_done(int, const Frame&, const Tile&, const RenderTotals&) override { ++units; }
    } count;
    EXPECT_EQ(render(true, &count).skipped, (std::vector<int>{1, 3}));
    EXPECT_LE(count.units, 3 * 9 - units) << "what is done is not done again";
    expect_same();
  }
}

TEST_F(RenderSequence, ResumeSkipsWhatIsFinishedOnly) {
  render();
  EXPECT_EQ(render(true).skipped, (std::vector<int>{1, 2, 3}));
  fs::remove(file(2));
  fs::resize_file(file(3), fs::file_size(file(3)) - 100);  // as a killed copy leaves it
  const RenderReport again = render(true);
  EXPECT_EQ(again.skipped, std::vector<int>{1});
  for (const int f : shot_.frames) expect_right(f);
  shot_.settings.spp = 3;
  EXPECT_TRUE(render(true).skipped.empty());
  EXPECT_TRUE(render(false).skipped.empty()) << "without --resume everything is rendered";
}

TEST_F(RenderSequence, StoppedFrameContinuesWithTheSameBits) {
  for (const int tiles : {1, 4, 8, 13}) {
    fs::remove_all(folder_);
    StopAfter stop(tiles);
    EXPECT_EQ(code_of([&] { render(false, &stop, stop.source.get_token()); }), ErrorCode::kCancelled);
    const int frame = 1 + tiles / 9;
    EXPECT_TRUE(fs::exists(file(frame) + ".partial")) << tiles;
    struct Count : RenderObserver {
      std::atomic<int> tiles{0};
      void tile_done(int, const Frame&, const Tile&, const RenderTotals&) override { ++tiles; }
    } count;
    const RenderReport report = render(true, &count);
    EXPECT_LE(count.tiles, 27 - tiles) << "finished tiles are not rendered again";
    EXPECT_EQ(files(), 3u) << "the checkpoint is gone";
    std::uint64_t samples = 0;
    for (const FrameReport& f : report.frames) samples += f.totals.samples;
    EXPECT_EQ(samples, (3 - report.skipped.size()) * 80 * 70 * 2) << "counts include those of the first run";
    for (const int f : shot_.frames) expect_right(f);
  }
}

TEST_F(RenderSequence, UnusableCheckpointsAreIgnored) {
  shot_.frames = {1};
  const auto interrupted = [&] {
    fs::remove_all(folder_);
    StopAfter stop(4);
    EXPECT_EQ(code_of([&] { render(false, &stop, stop.source.get_token()); }), ErrorCode::kCancelled);
    return file(1) + ".partial";
  };
  std::string partial = interrupted();
  {  // one flipped byte in the pixels
    std::fstream f(partial, std::ios::in | std::ios::out | std::ios::binary);
    f.seekp(-1000, std::ios::end);
    f.put('\x55');
  }
  render(true);
  expect_right(1);
  partial = interrupted();
  fs::resize_file(partial, fs::file_size(partial) / 2);
  render(true);
  expect_right(1);
  partial = interrupted();
  std::ofstream(partial) << "something else";
  render(true);
  expect_right(1);
  interrupted();
  shot_.settings.seed = 5;  // tiles of another seed must not be mixed in
  render(true);
  expect_right(1);
}

TEST_F(RenderSequence, LongFramesAreCheckpointedOnTheWay) {
  struct Slow : RenderObserver {
    std::string partial;
    std::atomic<bool> seen{false};
    void tile_done(int, const Frame&, const Tile&, const RenderTotals&) override {
      std::this_thread::sleep_for(std::chrono::milliseconds(30));
      if (fs::exists(partial)) seen = true;
    }
  } slow;
  shot_.frames = {1};
  slow.partial = file(1) + ".partial";
  RenderOptions options;
  options.checkpoint_seconds = 0.02;
  RenderObserver* const observers[] = {&slow};
  render_sequence(shot_, scene_, options, observers);
  EXPECT_TRUE(slow.seen);
  EXPECT_FALSE(fs::exists(slow.partial));
  expect_right(1);
}

TEST_F(RenderSequence, OutputThatCannotBeWrittenIsFoundFirst) {
  struct Begun : RenderObserver {
    bool begun = false;
    void begin(const RenderPlan&) override { begun = true; }
  } begun;
  fs::create_directories(folder_);
  std::ofstream(folder_ / "file") << "x";
  shot_.output = (folder_ / "file" / "f.####.exr").string();
  EXPECT_EQ(code_of([&] { render(false, &begun); }), ErrorCode::kFailed);
  EXPECT_FALSE(begun.begun);
}

TEST_F(RenderSequence, FailedWriteEndsTheRenderAndKeepsWhatIsDone) {
  fs::create_directories(file(2));  // a folder stands where the frame should go
  EXPECT_EQ(code_of([&] { render(); }), ErrorCode::kFailed);
  expect_right(1);
  EXPECT_FALSE(fs::exists(file(3)) && fs::exists(file(3) + ".partial"));
}

TEST_F(RenderSequence, ReplaysOneSample) {
  shot_.settings.spp = 1;
  shot_.settings.filter = PixelFilter(FilterKind::kBox);
  const Frame f = render_frame(shot_, scene_, 1);
  const Rgb c = replay_sample(shot_, scene_, {1, 40, 35, 0, {1, 40, 35}});
  EXPECT_EQ(c, f.layer("color").rgb(40, 35));
  EXPECT_EQ(code_of([&] { replay_sample(shot_, scene_, {1, 80, 35, 0, {}}); }), ErrorCode::kUsage);
}

TEST_F(RenderSequence, BadSamplesAreLeftOutCountedAndNamed) {
  scene_.environments[0].radiance = Rgb(3e38f);  // sums of two lights overflow
  scene_.environments.push_back(scene_.environments[0]);
  shot_.frames = {1};
  set_log_level(LogLevel::kInfo);
  std::string log;
  set_log_writer([&](std::string_view line) { log += line; });
  const RenderReport report = render();
  set_log_writer({});
  ASSERT_GT(report.totals.bad_samples, 0u);
  ASSERT_FALSE(report.totals.first_bad.empty());
  EXPECT_LE(report.totals.first_bad.size(), 16u);
  const BadSample b = report.totals.first_bad[0];
  EXPECT_NE(log.find("tempera render shot --replay 1," + std::to_string(b.x) + "," + std::to_string(b.y) + ","),
            std::string::npos)
      << log;
  EXPECT_FALSE(is_finite(replay_sample(shot_, scene_, b))) << "the log names a sample that is bad";
  const Frame frame = read_frame(file(1));
  for (const Layer& l : frame.layers()) {
    for (const float v : l.image.values()) ASSERT_TRUE(std::isfinite(v)) << l.desc.name;
  }
}

// A sample of the offset pass took the numbers of another pixel, of the frame before.
TEST_F(RenderSequence, ReplaysSamplesOfEveryPass) {
  shot_.settings.spp = 2;
  shot_.settings.layers = {"color"};
  shot_.settings.filter = PixelFilter(FilterKind::kBox);
  shot_.integrator = "temporal_gradient_path";
  shot_.params = Params(find_method(shot_.integrator).params);
  shot_.params.set("subpixel_motion", false);
  const Frame f = render_frame(shot_, scene_, 1);
  const Image& source = f.layer("offset.source");
  for (const int x : {30, 40, 50}) {
    ASSERT_EQ(source.at(x, 35, 2), 1.0f);
    const PixelKey numbers{0, int(source.at(x, 35, 0)), int(source.at(x, 35, 1))};
    EXPECT_EQ(replay_sample(shot_, scene_, {1, x, 35, 0, numbers}), f.layer("offset.color").rgb(x, 35));
    EXPECT_EQ(replay_sample(shot_, scene_, {1, x, 35, 0, {1, x, 35}}), f.layer("color").rgb(x, 35));
  }
}

TEST_F(RenderSequence, CropIsAWindowOnTheSamePicture) {
  const Frame whole = render_frame(shot_, scene_, 1);
  shot_.settings.crop_x = 13, shot_.settings.crop_y = 9, shot_.settings.crop_width = 41,
  shot_.settings.crop_height = 37;
  const Frame part = render_frame(shot_, scene_, 1);
  for (const Layer& l : part.layers()) {
    for (int y = 0; y < 37; ++y) {
      for (int x = 0; x < 41; ++x) {
        for (int c = 0; c < l.image.channels(); ++c) {
          ASSERT_EQ(l.image.at(x, y, c), whole.layer(l.desc.name).at(x + 13, y + 9, c))
              << l.desc.name << " " << x << "," << y;
        }
      }
    }
  }
}

}  // namespace
}  // namespace tempera
