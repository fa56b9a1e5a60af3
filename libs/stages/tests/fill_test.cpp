// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/fill.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "tempera/core/random.h"
#include "tempera/stages/stage_plan.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

class FillFiles : public testing::Test {
 protected:
  FillFiles() {
    folder_ = fs::temp_directory_path() / ("tempera_fill_" + std::to_string(getpid()) + "_" +
                                           testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string pattern(const std::string& name) const { return (folder_ / (name + ".####.exr")).string(); }
  /// Pixel x of every layer is `value` + x.
  static Frame frame(float value, const std::vector<LayerDesc>& layers, int width = 3) {
    Frame f(width, 1);
    for (const LayerDesc& d : layers) {
      Image& image = f.create(d);
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < image.channels(); ++c) image.at(x, 0, c) = value + float(x);
      }
    }
    return f;
  }
  void write(const std::string& name, int number, const Frame& f) const {
    write_frame(frame_path(pattern(name), number), f);
  }
  StageReport fill(bool resume = false) const {
    StageObserver nobody;
    const std::vector<FrameSequence> in{FrameSequence(pattern("base")), FrameSequence(pattern("pixels"))};
    return run_stage({&fill_entry, Params(fill_entry.params)}, in, pattern("out"), {.resume = resume}, nobody);
  }
  std::string error() const {
    try {
      fill();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput) << e.what();
      return e.message();
    }
    ADD_FAILURE() << "no Error was thrown";
    return "";
  }
  fs::path folder_;
};

TEST_F(FillFiles, PixelsOfTheMaskComeFromTheRender) {
  for (const int number : {4, 5}) {
    Frame base = frame(10, {layers::color(), layers::depth(), layers::derived(layers::color(), "own"), layers::mask()});
    base.layer("mask").at(0, 0) = 0, base.layer("mask").at(1, 0) = 0.25f, base.layer("mask").at(2, 0) = number == 4;
    base.metadata["tempera/spp"] = 7;
    write("base", number, base);
    write("pixels", number, frame(float(100 * number), {layers::albedo(), layers::depth(), layers::color()}));
  }
  EXPECT_EQ(fill().frames, (std::vector<int>{4, 5}));
  for (const int number : {4, 5}) {
    const Frame out = read_frame(frame_path(pattern("out"), number));
    EXPECT_EQ(out.layer_names(), (std::vector<std::string>{"color", "depth", "color.own"}));
    const float rendered = float(100 * number);
    for (const char* name : {"color", "depth"}) {
      const Image& image = out.layer(name);
      for (int c = 0; c < image.channels(); ++c) {
        EXPECT_EQ(image.at(0, 0, c), 10) << name;
        EXPECT_EQ(image.at(1, 0, c), rendered + 1) << name;
        EXPECT_EQ(image.at(2, 0, c), number == 4 ? rendered + 2 : 12) << name;
      }
    }
    EXPECT_EQ(out.layer("color.own").at(1, 0), 11) << "no render has it";
    EXPECT_EQ(std::get<int>(out.metadata.at("tempera/spp")), 7);
  }
  EXPECT_TRUE(fill(true).frames.empty());
  write("pixels", 5, frame(1000, {layers::depth(), layers::color()}));
  EXPECT_EQ(fill(true).frames, std::vector<int>{5});
}

TEST_F(FillFiles, BadInputIsNamed) {
  const std::vector<LayerDesc> masked{layers::color(), layers::mask()};
  write("base", 1, frame(1, {layers::color()}));
  write("pixels", 1, frame(2, {layers::color()}));
  EXPECT_NE(error().find("has no layer \"mask\": it says which pixels to fill"), std::string::npos);
  write("base", 1, frame(1, masked));
  write("pixels", 1, frame(2, {layers::color()}, 4));
  EXPECT_EQ(error(), "the frames to be filled have 3x1 pixels, the rendered ones 4x1");
  write("pixels", 1, frame(2, {layers::depth()}));
  EXPECT_NE(error().find("none of the layers"), std::string::npos);
  write("pixels", 1, frame(2, {{"color", {"R", "G", "B"}, "", Combine::kMean}}));
  EXPECT_NE(error().find("\"color\" has 4 channels in the frames to be filled, 3 in the rendered ones"),
            std::string::npos);
  write("pixels", 1, frame(2, {layers::color()}));
  write("base", 2, frame(1, masked));
  EXPECT_EQ(error(),
            pattern("pixels") + " lacks frames that go with the others: 2; each frame takes pixels of its own");
  write("pixels", 2, frame(2, {layers::color()}, 4));
  EXPECT_NE(error().find("has 4x1 pixels"), std::string::npos);
}

/// Writes a mask; makes frames of twice the size, from those around.
class Masking final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    out.width *= 2, out.height *= 2;
    out.layers = {layers::color(), layers::mask()};
    return out;
  }
  std::vector<LayerUse> reads(int, std::span<const SequenceDesc>) const override {
    return {{layers::color(), true, ""}};
  }
  std::vector<int> inputs(int, int frame, std::span<const SequenceDesc> in) const override {
    return frames_around(frame, 1, 1, in[0]);
  }

 protected:
  void make(const FrameWindow&, int, Frame&) const override {}
};

TEST_F(FillFiles, DamagedValuesDoNotSpreadWhereItIsSmooth) {
  const std::vector<LayerDesc> layers{layers::color(), layers::albedo(), layers::normal(), layers::emission()};
  constexpr int kWidth = 40;
  Frame base = frame(0.5f, layers, kWidth), pixels = frame(0.5f, layers, kWidth);
  pixels.add(layers::color_a(), frame(0.5f, {layers::color_a()}, kWidth).layer("color.a"));
  pixels.add(layers::color_b(), frame(0.5f, {layers::color_b()}, kWidth).layer("color.b"));
  base.add(layers::mask(), Image(kWidth, 1, 1));
  base.metadata[stage_engine_key("denoise")] = std::string("nl_means");
  for (const int x : {3, 20, 36}) base.layer("mask").at(x, 0) = 1;
  int at = 4;
  for (Frame* f : {&base, &pixels}) {
    const std::list<Layer>& all = f->layers();
    for (const Layer& l : all) {
      if (l.desc.name == "mask" || l.desc.name == "color") continue;
      for (const float v : {NAN, INFINITY, 3e38f}) f->layer(l.desc.name).at(4 + at++ % 32, 0, 0) = v;
    }
  }
  write("base", 1, base), write("pixels", 1, pixels);
  fill();
  const Image out = read_frame(frame_path(pattern("out"), 1)).layer("color");
  for (const int x : {3, 20, 36}) {
    for (int c = 0; c < 3; ++c) EXPECT_TRUE(std::isfinite(out.at(x, 0, c))) << x;
  }
}

TEST(FillPlan, FollowsAStageThatWritesAMask) {
  StageEntry masking;
  masking.name = "masking";
  masking.ports.resize(1);
  masking.make = [](const Params&) -> std::unique_ptr<Stage> { return std::make_unique<Masking>(); };
  const std::vector<StageChoice> chain{{&masking, {}}, {&masking, {}}};
  const SequenceDesc source{{1, 20}, {1, 20}, {}, 8, 6, {layers::color(), layers::albedo()}};
  const StagePlan plan = plan_stages(chain, source, std::vector<int>{5, 9});
  ASSERT_EQ(plan.steps.size(), 4u);
  for (const std::size_t i : {1, 3}) {
    const StageStep& step = plan.steps[i];
    EXPECT_TRUE(step.fills() && !plan.steps[i - 1].fills());
    EXPECT_EQ(step.asked, i / 2);
    EXPECT_EQ(step.frames, plan.steps[i - 1].frames);
    EXPECT_FALSE(step.out.has_mask());
    ASSERT_EQ(step.in.size(), 2u);
    EXPECT_EQ(step.in[1].width, i == 1 ? 16 : 32) << "rendered at the stage's size";
    EXPECT_TRUE(step.in[1].has(layers::albedo())) << "as a render";
  }
  EXPECT_EQ(plan.steps[3].frames, (std::vector<int>{5, 9}));
  EXPECT_EQ(plan.steps[1].frames, (std::vector<int>{4, 5, 6, 8, 9, 10}));
  EXPECT_EQ(plan.source, (std::vector<int>{3, 4, 5, 6, 7, 8, 9, 10, 11})) << "the pixels are not of the source";
}

TEST_F(FillFiles, NoiseOfThePixelsGoesWhereTheOthersAreClean) {
  constexpr int kSize = 32;
  const auto light = [](int x) { return x < kSize / 2 ? 0.5f : 2.0f; };  // an edge that has to stay
  const auto albedo = [](int x, int y) { return 0.3f + 0.1f * float((x * 7 + y * 3) % 5); };
  Frame base(kSize, kSize), pixels(kSize, kSize);
  for (Frame* f : {&base, &pixels}) f->create(layers::color()), f->create(layers::albedo());
  Image &mask = base.create(layers::mask()), &a = pixels.create(layers::color_a()),
        &b = pixels.create(layers::color_b());
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const float truth = light(x) * albedo(x, y);
      const auto noise = [&](int half) {
        return 1 + 0.6f * (2 * float(hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(half)) >> 40) /
                               float(1 << 24) -
                           1);
      };
      mask.at(x, y) = y >= 10 && y < 18;
      a.set_rgb(x, y, Rgb(truth * noise(0))), b.set_rgb(x, y, Rgb(truth * noise(1)));
      base.layer("color").set_rgb(x, y, Rgb(truth));
      pixels.layer("color").set_rgb(x, y, (a.rgb(x, y) + b.rgb(x, y)) * 0.5f);
      for (Frame* f : {&base, &pixels}) f->layer("albedo").set_rgb(x, y, Rgb(albedo(x, y)));
    }
  }
  const auto error_of = [&](const std::string& smooth) {
    StageObserver nobody;
    StageChoice choice{&fill_entry, Params(fill_entry.params)};
    choice.params.set_text("smooth", smooth);
    const std::vector<FrameSequence> in{FrameSequence(pattern("base")), FrameSequence(pattern("pixels"))};
    run_stage(choice, in, pattern(smooth), {}, nobody);
    const Frame filled = read_frame(frame_path(pattern(smooth), 1));
    const Image& out = filled.layer("color");
    double sum = 0;
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        const float direct = filled.layer("class.direct.color").at(x, y, 1);
        EXPECT_NEAR(3 * direct, out.at(x, y, 1), 1e-5f) << "classes add up";
        const double e = double(out.at(x, y, 0)) / double(light(x) * albedo(x, y)) - 1;
        if (mask.at(x, y) == 0) {
          EXPECT_NEAR(e, 0, 1e-6) << "others stay";
        }
        sum += e * e;
      }
    }
    return sum;
  };
  for (Frame* f : {&base, &pixels}) {  // classes with a third of the light and the rest
    for (const auto& [name, part] : {std::pair{"direct", 1 / 3.0f}, {"residual", 2 / 3.0f}}) {
      Image& image = f->create(layers::class_layer(name, layers::color()));
      for (int y = 0; y < kSize; ++y) {
        for (int x = 0; x < kSize; ++x) image.set_rgb(x, y, f->layer("color").rgb(x, y) * part);
      }
    }
  }
  write("base", 1, base), write("pixels", 1, pixels);
  const double noisy = error_of("no");
  EXPECT_EQ(error_of("auto"), noisy) << "nothing says that the others are clean";
  EXPECT_LT(4 * error_of("yes"), noisy);
  base.metadata[stage_engine_key("denoise")] = std::string("nl_means");
  write("base", 1, base);
  EXPECT_LT(4 * error_of("auto"), noisy);
}

}  // namespace
}  // namespace tempera
