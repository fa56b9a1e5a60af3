// SPDX-License-Identifier: Apache-2.0
// The stage `denoise`, on files: noisy frames of a textured wall that moves.
#include <dlfcn.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/frames/files.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 72, kHeight = 40;

float deviate(std::uint64_t seed, int frame, int x, int y, int c) {
  const auto uniform = [&](int k) {
    const std::uint64_t h = hash_key(seed, frame, x, y, c, k);
    return (double(h >> 11) + 0.5) / double(1ull << 53);
  };
  return float(std::sqrt(-2 * std::log(uniform(1))) * std::cos(6.283185307179586 * uniform(2)));
}

struct Shot {
  int first = 1, last = 9, spp = 32;
  float noise = 0.2f;  ///< standard deviation of `color`
  int cut = 1000;      ///< first frame of another picture
  bool vectors_know = true;
  bool halves = true, motion = true, features = true, classes = false;
  int firefly_frame = 0;
};

float albedo_at(const Shot& s, int frame, int x, int y) {
  const int u = x - frame + (frame >= s.cut ? 7 : 0), v = y;  // moves to the right, a pixel a frame
  return 0.3f + 0.5f * float(((u + 600) / 5 + v / 5) % 2);
}
float light_at(const Shot& s, int frame, int x, int y) {
  const float u = float(x - frame);
  return (frame >= s.cut ? 2.5f : 1.0f) * (0.6f + 0.3f * std::sin(0.09f * u) * std::cos(0.13f * float(y)));
}

Rgb gray(float v) { return {v, v, v}; }

class Denoise : public testing::Test {
 protected:
  Denoise() {
    folder_ = fs::path(testing::TempDir()) / ("tempera_" + std::to_string(::getpid()) + "_" +
                                              testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string pattern(const std::string& name) const { return (folder_ / (name + ".####.exr")).string(); }

  static Frame make(const Shot& s, int f) {
    Frame frame(kWidth, kHeight);
    Image& color = frame.create(layers::color());
    Image halves[2] = {Image(kWidth, kHeight, 3), Image(kWidth, kHeight, 3)};
    Image albedo(kWidth, kHeight, 3), normal(kWidth, kHeight, 3), id(kWidth, kHeight, 1);
    Image vectors[2] = {Image(kWidth, kHeight, 4), Image(kWidth, kHeight, 4)};
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const float a = albedo_at(s, f, x, y), truth = a * light_at(s, f, x, y);
        for (int c = 0; c < 3; ++c) {
          for (int h = 0; h < 2; ++h) {
            float& v = halves[h].pixel(x, y)[c];
            v = std::max(0.0f, truth + a * s.noise * 1.414f * deviate(std::uint64_t(h + 1), f, x, y, c));
            if (h == 0 && f == s.firefly_frame && x == 30 && y == 20) v += 2000;
          }
          color.pixel(x, y)[c] = 0.5f * (halves[0].pixel(x, y)[c] + halves[1].pixel(x, y)[c]);
          albedo.pixel(x, y)[c] = a;
        }
        color.at(x, y, 3) = float(x) / kWidth;
        normal.set_vec3(x, y, {0, 0, 1});
        id.at(x, y) = 1;
        for (int d = 0; d < 2; ++d) {
          const int there = d == 0 ? f + 1 : f - 1;
          const bool same = (there >= s.cut) == (f >= s.cut) || !s.vectors_know;
          vectors[d].at(x, y, 0) = d == 0 ? 1.0f : -1.0f;
          vectors[d].at(x, y, 3) = same ? 1.0f : 0.0f;
        }
      }
    }
    if (s.halves) frame.add(layers::color_a(), halves[0]), frame.add(layers::color_b(), halves[1]);
    if (s.features)
      frame.add(layers::albedo(), albedo), frame.add(layers::normal(), normal), frame.add(layers::object_id(), id);
    if (s.motion) frame.add(layers::motion_forward(), vectors[0]), frame.add(layers::motion_backward(), vectors[1]);
    if (s.classes) {  // half of the light is of one class, a quarter of another
      for (const auto& [name, share] : {std::pair{"direct", 0.5f}, {"mirrored", 0.25f}, {"residual", 0.25f}}) {
        for (const auto& [layer, image] :
             {std::pair{layers::color(), &color}, {layers::color_a(), &halves[0]}, {layers::color_b(), &halves[1]}}) {
          Image part(kWidth, kHeight, 3);
          for (int y = 0; y < kHeight; ++y) {
            for (int x = 0; x < kWidth; ++x) part.set_rgb(x, y, image->rgb(x, y) * share);
          }
          frame.add(layers::class_layer(name, layer), part);
        }
      }
      set_classes(frame.metadata,
                  std::vector<ClassInfo>{{"direct", "ED.*", {"D"}}, {"mirrored", "ER.*", {"RD", "RRD"}}});
    }
    frame.create(layers::crypto(0)).at(3, 4, 0) = 1e-30f;
    frame.metadata["tempera/spp"] = s.spp;
    frame.metadata["tempera/note"] = fmt::format("frame {}", f);
    return frame;
  }
  FrameSequence write(const std::string& name, const Shot& s = {}) const {
    for (int f = s.first; f <= s.last; ++f) write_frame(frame_path(pattern(name), f), make(s, f));
    return FrameSequence(pattern(name));
  }
  using Flags = std::map<std::string, std::string>;
  StageReport run(const FrameSequence& in, const std::string& out, const Flags& flags = {},
                  StageOptions options = {}) const {
    const StageEntry& entry = find_stage("denoise");
    StageChoice choice{&entry, Params(entry.params)};
    for (const auto& [name, value] : flags) choice.params.set_text(name, value);
    StageObserver nobody;
    return run_stage(choice, std::span(&in, 1), pattern(out), options, nobody);
  }
  Frame result(const std::string& name, int frame) const { return read_frame(frame_path(pattern(name), frame)); }
  /// Mean squared error over the picture's radiance.
  double error(const std::string& name, const Shot& s, int f) const {
    const Frame frame = result(name, f);
    double sum = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          const float truth = albedo_at(s, f, x, y) * light_at(s, f, x, y);
          sum += std::pow(double(frame.layer("color").at(x, y, c) - truth), 2);
        }
      }
    }
    return sum / (3.0 * kWidth * kHeight);
  }
  void expect_same(const std::string& a, const std::string& b, int f) const {
    EXPECT_EQ(result(a, f).layer("color"), result(b, f).layer("color")) << a << ' ' << b << ' ' << f;
  }
  std::string error_of(const std::function<void()>& f, ErrorCode code) const {
    try {
      f();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.what();
      return e.message();
    }
    ADD_FAILURE() << "no Error was thrown";
    return "";
  }
  fs::path folder_;
};

TEST_F(Denoise, TakesOutNoiseAndLeavesTheRest) {
  const Shot shot;
  const FrameSequence in = write("in", shot);
  const StageReport report = run(in, "out");
  EXPECT_EQ(report.frames.size(), 9u);
  const double noisy = error("in", shot, 5), clean = error("out", shot, 5);
  EXPECT_LT(clean, noisy / 60);
  EXPECT_LT(error("out", shot, 1), noisy / 30) << "also at the end of the sequence";
  const Frame before = read_frame(in.path(5)), after = result("out", 5);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) ASSERT_EQ(after.layer("color").at(x, y, 3), before.layer("color").at(x, y, 3));
  }
  for (const char* layer : {"albedo", "normal", "object_id", "motion.forward", "motion.backward", "CryptoObject00"})
    EXPECT_EQ(after.layer(layer), before.layer(layer)) << layer;
  for (const char* layer : {"color.a", "color.b"}) EXPECT_FALSE(after.has(layer)) << "not of this picture";
  EXPECT_EQ(after.metadata.at("tempera/note"), before.metadata.at("tempera/note"));
  EXPECT_EQ(to_text(after.metadata.at("tempera/denoise_engine")), "nl_means");
}

TEST_F(Denoise, FramesAroundHelpAndWithoutThemEachIsAlone) {
  const Shot shot;
  const FrameSequence in = write("in", shot);
  run(in, "out"), run(in, "alone", {{"radius", "0"}}, {.sections = {{.frames = {5}}}});
  EXPECT_LT(error("out", shot, 5), 0.7 * error("alone", shot, 5));
  Shot still = shot;
  still.first = still.last = 5;
  run(write("still", still), "one");
  expect_same("alone", "one", 5);
}

TEST_F(Denoise, SameBitsForAnyThreadsAndChunks) {
  for (const std::string recipe : {"halves", "components", "classes"}) {
    const Shot shot{.last = 10, .classes = recipe != "halves"};
    const std::string name = recipe + "_";
    const FrameSequence in = write(name + "in", shot);
    const Flags flags{{"recipe", recipe}};
    with_threads(1, [&] { run(in, name + "one", flags); });
    with_threads(3, [&] {
      for (const std::vector<int>& frames : {std::vector{1, 2, 3}, {7}, {1, 4, 9}})
        run(in, name + "part", flags, {.sections = {{.frames = frames}}});
    });
    for (const int f : {1, 2, 3, 4, 7, 9}) expect_same(name + "one", name + "part", f);
  }
}

TEST_F(Denoise, CutsEndAllAverages) {
  for (const bool vectors : {true, false}) {
    const Shot shot{.last = 12, .cut = 7, .vectors_know = vectors};
    const std::string name = vectors ? "vectors" : "flag";
    const FrameSequence in = write(name, shot);
    run(in, name + "_out", vectors ? Flags{} : Flags{{"cuts", "7"}});
    Shot before = shot, after = shot;
    before.last = 6, after.first = 7;
    run(write(name + "_before", before), name + "_before_out"), run(write(name + "_after", after), name + "_after_out");
    for (const int f : {5, 6}) expect_same(name + "_out", name + "_before_out", f);
    for (const int f : {7, 8}) expect_same(name + "_out", name + "_after_out", f);
  }
  const std::string message = error_of([&] { run(write("x"), "y", {{"cuts", "seven"}}); }, ErrorCode::kUsage);
  EXPECT_NE(message.find("cuts"), std::string::npos) << message;
}

TEST_F(Denoise, WorksWithWhatThereIs) {
  Shot shot{.last = 3};
  double noisy = 0;
  const auto gain = [&](const std::string& name, const Shot& s) {
    run(write(name, s), name + "_out", {}, {.sections = {{.frames = {2}}}});
    noisy = error(name, s, 2);
    return noisy / error(name + "_out", s, 2);
  };
  const double all = gain("all", shot);
  shot.motion = false;
  const double no_motion = gain("no_motion", shot);
  shot.halves = false;
  const double no_halves = gain("no_halves", shot);
  shot.features = false;
  const double color_alone = gain("color_alone", shot);
  EXPECT_GT(all, 1.2 * no_motion);
  EXPECT_GT(no_motion, 10);
  EXPECT_GT(no_halves, 5);
  EXPECT_GT(color_alone, 1.5) << "noise is half of the texture's contrast";
  const Shot one_sample{.last = 3, .spp = 1};
  EXPECT_GT(gain("one_sample", one_sample), 5) << "its second half is not one";
}

TEST_F(Denoise, MoreSamplesLeadToTheTruth) {
  const Shot shot{.last = 5, .spp = 1024, .noise = 0.01f};
  const FrameSequence in = write("in", shot);
  run(in, "out");
  EXPECT_LT(error("out", shot, 3), 1.1 * error("in", shot, 3));
}

TEST_F(Denoise, ClassesOfPathsAddUp) {
  const Shot shot{.classes = true};
  const FrameSequence in = write("in", shot);
  const StageReport report = run(in, "out", {{"recipe", "components"}});
  ASSERT_FALSE(report.notes.empty());
  EXPECT_NE(report.notes[0].find("by class of light paths"), std::string::npos) << report.notes[0];
  EXPECT_LT(error("out", shot, 5), error("in", shot, 5) / 40);
  EXPECT_FALSE(result("out", 5).has("class.direct.color"));
  const StageReport whole = run(in, "halves");
  EXPECT_EQ(whole.notes[0].find("by class of light paths"), std::string::npos) << whole.notes[0];
  const Shot none{.last = 3};
  const StageReport fallback = run(write("none", none), "none_out", {{"recipe", "components"}});
  EXPECT_EQ(fallback.notes[0].find("by class of light paths"), std::string::npos) << fallback.notes[0];
}

TEST_F(Denoise, EachClassStandsForItself) {
  const Shot shot{.classes = true};
  run(write("in", shot), "out", {{"recipe", "classes"}}, {.sections = {{.frames = {5}}}});
  const Frame in = result("in", 5), out = result("out", 5);
  EXPECT_LT(error("out", shot, 5), error("in", shot, 5) / 40);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      Rgb sum;
      for (const char* name : {"class.direct.color", "class.mirrored.color", "class.residual.color"})
        sum += out.layer(name).rgb(x, y);
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(sum[c], out.layer("color").at(x, y, c), 1e-6f);
    }
  }
  EXPECT_FALSE(out.has("class.direct.color.a"));
  // Which has half of the light.
  double noisy = 0, clean = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float truth = 0.5f * albedo_at(shot, 5, x, y) * light_at(shot, 5, x, y);
      noisy += std::pow(double(in.layer("class.direct.color").at(x, y, 1) - truth), 2);
      clean += std::pow(double(out.layer("class.direct.color").at(x, y, 1) - truth), 2);
    }
  }
  EXPECT_LT(clean, noisy / 40);
  const Shot none{.last = 3};
  const StageReport fallback = run(write("none", none), "none_out", {{"recipe", "classes"}});
  EXPECT_EQ(fallback.notes[0].find("each class"), std::string::npos) << fallback.notes[0];
}

#ifdef TEMPERA_PATH_SPACE_MOTION
// A picture passes by in a mirror that stands still.
TEST_F(Denoise, ClassesFollowWhatMirrorsShow) {
  const Shot shot{.classes = true};
  enum Vectors { kNone, kSome, kAll };
  std::array<double, 3> errors{};
  for (const Vectors vectors : {kNone, kSome, kAll}) {
    const std::string in = fmt::format("in{}", int(vectors));
    for (int f = shot.first; f <= shot.last; ++f) {
      Frame frame = make(shot, f);
      for (const char* half : {"color", "color.a", "color.b"}) {
        const std::string name = half;
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            frame.layer("class.mirrored." + name).set_rgb(x, y, frame.layer(name).rgb(x, y));
            for (const char* other : {"class.direct.", "class.residual."}) frame.layer(other + name).set_rgb(x, y, {});
          }
        }
      }
      for (const char* d : {"motion.forward", "motion.backward"}) {
        const std::string chain = std::string("chain.RD.") + d;
        Image moving = frame.layer(d);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            frame.layer(d).at(x, y, 0) = 0;
            if (vectors == kSome && x >= kWidth / 2) moving.at(x, y, 3) = 0;
          }
        }
        const LayerDesc desc =
            d == std::string("motion.forward") ? layers::motion_forward() : layers::motion_backward();
        if (vectors != kNone) frame.add(layers::chain_layer("RD", desc), moving);
      }
      const Image white(kWidth, kHeight, 3, 1.0f);
      frame.add(layers::chain_layer("RD", layers::albedo()), white);
      frame.add(layers::chain_layer("RD", layers::normal()), frame.layer("normal"));
      write_frame(frame_path(pattern(in), f), frame);
    }
    const std::string out = fmt::format("out{}", int(vectors));
    run(FrameSequence(pattern(in)), out, {{"recipe", "classes"}}, {.sections = {{.frames = {5}}}});
    errors[vectors] = error(out, shot, 5);
  }
  EXPECT_LT(errors[kAll], 0.5 * errors[kNone]);
  EXPECT_LT(errors[kSome], 0.8 * errors[kNone]);
}
#endif

// A spot of theirs, as small as a pixel, is no firefly and stays as sharp as it is.
TEST_F(Denoise, LightOfPhotonsPassesAsItIs) {
  const auto photons = [](int frame, int x, int y) { return x == 20 + frame && y == 15 ? 8.0f : x % 3 ? 0.0f : 0.25f; };
  for (const bool halves : {true, false}) {
    Shot s;
    s.last = 3, s.halves = halves;
    write("without", s);
    for (int f = s.first; f <= s.last; ++f) {
      Frame frame = make(s, f);
      for (const auto& [all, part] : {std::pair{layers::color(), layers::photon_color()},
                                      {layers::color_a(), layers::photon_a()},
                                      {layers::color_b(), layers::photon_b()}}) {
        if (!frame.has(all.name)) continue;
        Image& light = frame.create(part);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            // Halves of photons differ, by what no filter may take for noise of all light.
            const float share = all == layers::color_a() ? 1.5f : all == layers::color_b() ? 0.5f : 1.0f;
            light.set_rgb(x, y, gray(share * photons(f, x, y)));
            frame.layer(all.name).set_rgb(x, y, frame.layer(all.name).rgb(x, y) + light.rgb(x, y));
          }
        }
      }
      write_frame(frame_path(pattern("with"), f), frame);
    }
    const FrameSequence with(pattern("with")), without(pattern("without"));
    run(with, "a"), run(without, "b");
    const Frame a = result("a", 2), b = result("b", 2);
    EXPECT_FALSE(a.has("photon.color"));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        ASSERT_NEAR(a.layer("color").rgb(x, y).g, b.layer("color").rgb(x, y).g + photons(2, x, y), 2e-3f)
            << x << " " << y;
      }
    }
  }
}

TEST_F(Denoise, FirefliesAreHeldBackAndReported) {
  const Shot shot{.last = 5, .firefly_frame = 3};
  const FrameSequence in = write("in", shot);
  const StageReport held = run(in, "held");
  run(in, "kept", {{"fireflies", "keep"}, {"residuals", "no"}});
  EXPECT_LT(error("held", shot, 3), error("kept", shot, 3) / 5) << "its energy would be spread";
  double light = 0;  // of both halves
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) light += 2 * double(albedo_at(shot, 3, x, y) * light_at(shot, 3, x, y));
  }
  const double firefly = 2000;
  const double share = std::get<double>(result("held", 3).metadata.at("tempera/denoise_held_share"));
  EXPECT_NEAR(share, firefly / (firefly + light), 0.02);
  EXPECT_FALSE(result("kept", 3).metadata.contains("tempera/denoise_held_share"));
  bool told = false;
  for (const std::string& note : held.notes) told = told || note.find("held back") != std::string::npos;
  EXPECT_TRUE(told);
}

// Light that few samples find is found by many pixels around: it is what there is to see, behind glass for one.
TEST_F(Denoise, ManyFirefliesAreTheLightThatThereIs) {
  const Shot shot{.last = 3, .spp = 8};
  const auto is_rare = [](int x, int y) { return x >= 36 && x < 64 && y >= 8 && y < 32; };
  double truth = 0;
  for (int f = 1; f <= 3; ++f) {
    Frame frame = make(shot, f);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (!is_rare(x, y)) continue;
        std::array<float, 2> half{};
        for (int h = 0; h < 2; ++h) {
          const bool found = hash_key(std::uint64_t(h), f, x, y) % 100 < 8;
          half[std::size_t(h)] = found ? albedo_at(shot, f, x, y) * light_at(shot, f, x, y) / 0.08f : 0;
          frame.layer(h == 0 ? "color.a" : "color.b").set_rgb(x, y, gray(half[std::size_t(h)]));
        }
        for (int c = 0; c < 3; ++c) frame.layer("color").at(x, y, c) = 0.5f * (half[0] + half[1]);
        if (f == 2) truth += double(albedo_at(shot, f, x, y) * light_at(shot, f, x, y));
      }
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  run(FrameSequence(pattern("in")), "out");
  double sum = 0;
  const Frame out = result("out", 2);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) sum += is_rare(x, y) ? double(out.layer("color").at(x, y, 1)) : 0;
  }
  EXPECT_GT(sum, 0.75 * truth);
}

// The edge of a pane: nothing is seen behind it, and its own reflectance of 1 says nothing of the light.
TEST_F(Denoise, WhereNoChainEndsItIsDark) {
  const Shot shot{.last = 3, .spp = 8, .noise = 1};
  for (int f = 1; f <= 3; ++f) {
    Frame frame = make(shot, f);
    const LayerDesc albedo = layers::chain_layer("TTD", layers::albedo());
    frame.create(albedo), frame.create(layers::chain_layer("TTD", layers::normal()));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool edge = x == 30;
        frame.layer(albedo.name).set_rgb(x, y, edge ? gray(0) : frame.layer("albedo").rgb(x, y));
        frame.layer("albedo").set_rgb(x, y, gray(1));
        for (const char* layer : {"color", "color.a", "color.b"}) {
          if (edge) frame.layer(layer).set_rgb(x, y, gray(0));
        }
      }
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  run(FrameSequence(pattern("in")), "out");
  const Frame out = result("out", 2);
  for (int y = 4; y < kHeight - 4; ++y) EXPECT_LT(out.layer("color").at(30, y, 1), 0.15f) << y;
}

// Texture behind glass: the reflectance of the pane itself says nothing of it, that of all chains together does. Of few
// samples that is too noisy to be of use.
TEST_F(Denoise, LooksThroughGlassOfManySamples) {
  for (const int spp : {8, 32}) {
    const Shot shot{.last = 5, .spp = spp, .noise = 0.3f};
    const std::string in = fmt::format("in{}", spp);
    for (const bool seen : {false, true}) {
      for (int f = shot.first; f <= shot.last; ++f) {
        Frame frame = make(shot, f);
        const LayerDesc albedo = layers::chain_layer(layers::kAnyChain, layers::albedo());
        if (seen) {
          frame.add(albedo, frame.layer("albedo"));
          frame.add(layers::chain_layer(layers::kAnyChain, layers::normal()), frame.layer("normal"));
        }
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) frame.layer("albedo").set_rgb(x, y, gray(1));
        }
        write_frame(frame_path(pattern(in), f), frame);
      }
      run(FrameSequence(pattern(in)), fmt::format("{}{}", seen ? "seen" : "pane", spp));
    }
    const Shot truth = shot;
    const double pane = error(fmt::format("pane{}", spp), truth, 3), seen = error(fmt::format("seen{}", spp), truth, 3);
    if (spp == 8) {
      EXPECT_EQ(seen, pane);
    } else {
      EXPECT_LT(seen, 0.7 * pane);
    }
  }
}

// With few samples all light is filtered together, and files are read no further than that.
TEST_F(Denoise, ClassesThatAreNotAskedForAreNotLookedAt) {
  const Shot shot{.last = 3, .spp = 8, .classes = true};
  for (int f = 1; f <= 3; ++f) {
    Frame frame = make(shot, f);
    const LayerDesc layer = layers::class_layer("direct", layers::color());
    if (f == 2) frame.layer(layer.name).at(3, 3, 0) = NAN;
    write_frame(frame_path(pattern("in"), f), frame);
  }
  const auto damaged = [&](const Flags& flags) {
    for (const std::string& note : run(FrameSequence(pattern("in")), "out", flags).notes) {
      if (note.find("not finite") != std::string::npos) return true;
    }
    return false;
  };
  EXPECT_FALSE(damaged({}));
  EXPECT_TRUE(damaged({{"recipe", "components"}}));
}

TEST_F(Denoise, DamagedPixelsDoNotSpread) {
  const Shot shot{.last = 3};
  for (int f = 1; f <= 3; ++f) {
    Frame frame = make(shot, f);
    if (f == 2) {
      frame.layer("color").at(20, 20, 1) = NAN, frame.layer("color.a").at(20, 20, 1) = INFINITY;
      frame.layer("albedo").at(40, 10, 0) = NAN, frame.layer("motion.forward").at(10, 10, 0) = NAN;
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  run(FrameSequence(pattern("in")), "out");
  for (int f = 1; f <= 3; ++f) {
    const Frame out = result("out", f);
    for (const float v : out.layer("color").values()) ASSERT_TRUE(std::isfinite(v)) << f;
  }
}

// What the first frame has and another lacks, or has in another form, is named and not guessed.
TEST_F(Denoise, LayersAreThoseOfEveryFrame) {
  const auto spoiled = [&](const std::function<void(Frame&)>& how) {
    Frame frame = read_frame(frame_path(pattern("in"), 3));
    how(frame);
    write_frame(frame_path(pattern("in"), 3), frame);
    return error_of([&] { run(FrameSequence(pattern("in")), "out"); }, ErrorCode::kBadInput);
  };
  const FrameSequence in = write("in");
  const std::string missing = spoiled([](Frame& f) { f.remove("albedo"); });
  EXPECT_NE(missing.find(in.path(3) + ": layer \"albedo\" is missing"), std::string::npos) << missing;
  write("in");
  const std::string thin = spoiled([](Frame& f) {
    f.remove("color.a");
    f.add({"color.a", {"R"}, units::kRadiance}, Image(f.width(), f.height(), 1));
  });
  EXPECT_NE(thin.find("\"color.a\" has 1 channel;"), std::string::npos) << thin;
}

// What Cycles stores for denoisers does for us what our own layers do.
TEST_F(Denoise, TakesThePassesOfBlender) {
  Shot shot{.last = 3};
  shot.halves = false;
  const std::string view = "ViewLayer.";
  const auto write_passes = [&](const std::string& name, const std::string& without) {
    for (int f = 1; f <= 3; ++f) {
      const Frame ours = make(shot, f);
      Frame theirs(kWidth, kHeight);
      const auto add = [&](const std::string& pass, std::vector<std::string> channels,
                           const std::function<float(int x, int y, int c)>& value) {
        if (pass == without) return;
        Image& image = theirs.create({view + pass, channels});
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            for (int c = 0; c < image.channels(); ++c) image.at(x, y, c) = value(x, y, c);
          }
        }
      };
      const auto of = [&](const char* layer) {
        return [&image = ours.layer(layer)](int x, int y, int c) { return image.at(x, y, c); };
      };
      add("Combined", {"R", "G", "B", "A"}, of("color"));
      add("Denoising Albedo", {"R", "G", "B"}, of("albedo"));
      // In camera space: what we have as world space, seen along -z.
      add("Denoising Normal", {"X", "Y", "Z"},
          [&](int x, int y, int c) { return (c == 2 ? -1.0f : 1.0f) * ours.layer("normal").at(x, y, c); });
      // Previous - current and current - next, y up.
      add("Vector", {"X", "Y", "Z", "W"}, [&](int x, int y, int c) {
        const Image& motion = ours.layer(c < 2 ? "motion.backward" : "motion.forward");
        return (c == 1 || c == 2 ? -1.0f : 1.0f) * motion.at(x, y, c % 2);
      });
      add("Object Index", {"X"}, of("object_id"));
      write_frame(frame_path(pattern(name), f), theirs);
    }
    return FrameSequence(pattern(name));
  };
  run(write("ours", shot), "ours_out");
  run(write_passes("theirs", ""), "theirs_out");
  expect_same("ours_out", "theirs_out", 2);
  EXPECT_EQ(result("theirs_out", 2).layer("normal"), result("ours_out", 2).layer("normal"));
  EXPECT_LT(error("theirs_out", shot, 2), error("ours", shot, 2) / 10);
  for (const char* pass : {"Denoising Albedo", "Vector"}) {
    run(write_passes("less", pass), "less_out");
    EXPECT_GT(error("less_out", shot, 2), 1.1 * error("theirs_out", shot, 2)) << pass;
  }
}

// Without a number of samples the frames are taken to have many.
TEST_F(Denoise, ClassesOfFramesThatDoNotSayTheirSamples) {
  Shot s;
  s.classes = true;
  write("in", s);
  for (int f = s.first; f <= s.last; ++f) {
    Frame frame = read_frame(frame_path(pattern("in"), f));
    frame.metadata.erase("tempera/spp");
    write_frame(frame_path(pattern("in"), f), frame);
  }
  EXPECT_EQ(run(FrameSequence(pattern("in")), "out", {{"recipe", "components"}}).frames.size(),
            std::size_t(s.last - s.first + 1));
}

TEST_F(Denoise, SequencesWithFaultsAreNamed) {
  const Shot shot;
  const FrameSequence in = write("in", shot);
  fs::remove(in.path(4));
  const std::string gap = error_of([&] { run(FrameSequence(pattern("in")), "out"); }, ErrorCode::kBadInput);
  EXPECT_NE(gap.find("lacks frames in between: 4"), std::string::npos) << gap;
  EXPECT_NE(gap.find("--radius 0"), std::string::npos) << gap;
  EXPECT_EQ(run(FrameSequence(pattern("in")), "alone", {{"radius", "0"}}).frames.size(), 8u);
  Frame small(kWidth / 2, kHeight);
  small.create(layers::color());
  write_frame(in.path(4), small);
  const std::string size = error_of([&] { run(FrameSequence(pattern("in")), "out"); }, ErrorCode::kBadInput);
  EXPECT_NE(size.find("36x40"), std::string::npos) << size;
}

/// The methods of papers.
class DenoisePublished : public Denoise, public testing::WithParamInterface<const char*> {
 protected:
  Flags method(Flags more = {}) const {
    more["method"] = GetParam();
    return more;
  }
  bool over_time() const { return std::string(GetParam()) == "published"; }
};

TEST_P(DenoisePublished, TakesOutNoiseAndLeavesTheRest) {
  const Shot shot{.last = 3};
  const FrameSequence in = write("in", shot);
  const StageReport report = run(in, "out", method());
  const double gain = error("in", shot, 2) / error("out", shot, 2);
  EXPECT_GT(gain, over_time() ? 15 : 8) << "most of what is left is that the light is smoothed";
  ASSERT_FALSE(report.notes.empty());
  EXPECT_NE(report.notes[0].find(GetParam()), std::string::npos) << report.notes[0];
  const Frame before = read_frame(in.path(2)), after = result("out", 2);
  for (int x = 0; x < kWidth; ++x)
    ASSERT_EQ(after.layer("color").at(x, 7, 3), before.layer("color").at(x, 7, 3)) << "alpha";
  for (const char* layer : {"albedo", "object_id", "motion.forward"})
    EXPECT_EQ(after.layer(layer), before.layer(layer)) << layer;
  EXPECT_FALSE(after.has("color.a"));
  EXPECT_EQ(to_text(after.metadata.at("tempera/denoise_engine")), GetParam());
}

TEST_P(DenoisePublished, SameBitsForAnyThreadsAndChunks) {
  for (const bool classes : {false, true}) {
    const Shot shot{.last = 4, .classes = classes};
    const std::string name = classes ? "classes_" : "whole_";
    const FrameSequence in = write(name + "in", shot);
    with_threads(1, [&] { run(in, name + "one", method()); });
    with_threads(3, [&] { run(in, name + "part", method(), {.sections = {{.frames = {2}}, {.frames = {4}}}}); });
    for (const int f : {2, 4}) expect_same(name + "one", name + "part", f);
  }
}

TEST_P(DenoisePublished, FramesAroundHelpWhereTheMethodLooksAtThem) {
  const Shot shot{.last = 3};
  const FrameSequence in = write("in", shot);
  const StageOptions middle{.sections = {{.frames = {2}}}};
  run(in, "out", method(), middle), run(in, "alone", method({{"radius", "0"}}), middle);
  if (!over_time()) return expect_same("out", "alone", 2);
  const auto noise = [&](const std::string& name) {  // the light is gray: what channels differ by
    const Image color = result(name, 2).layer("color");
    double sum = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) sum += std::pow(double(color.at(x, y, 0) - color.at(x, y, 2)), 2);
    }
    return sum;
  };
  EXPECT_LT(noise("out"), 0.5 * noise("alone"));
  Shot next = shot;
  next.first = 2;
  run(write("after", next), "without_before", method()), run(in, "cut", method({{"cuts", "2"}}), middle);
  expect_same("cut", "without_before", 2);
}

TEST_P(DenoisePublished, WorksWithWhatThereIs) {
  Shot shot{.last = 2};
  const auto gain = [&](const std::string& name, const Shot& s) {
    run(write(name, s), name + "_out", method());
    return error(name, s, 2) / error(name + "_out", s, 2);
  };
  shot.motion = false;
  EXPECT_GT(gain("no_motion", shot), 8);
  shot.halves = false;
  EXPECT_GT(gain("no_halves", shot), 4);
  shot.features = false;
  EXPECT_GT(gain("color_alone", shot), 1.2) << "noise is half of the texture's contrast";
}

TEST_P(DenoisePublished, WhatEmitsIsNotSpread) {
  const Shot shot{.last = 2};
  const auto lamp = [](int x, int y) { return x >= 20 && x < 30 && y >= 10 && y < 20; };
  for (int f = 1; f <= 2; ++f) {
    Frame frame = make(shot, f);
    Image& emission = frame.create(layers::emission());
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (!lamp(x, y)) continue;
        emission.set_rgb(x, y, Rgb(50.0f));
        for (const char* layer : {"color", "color.a", "color.b"})
          frame.layer(layer).set_rgb(x, y, frame.layer(layer).rgb(x, y) + Rgb(50.0f));
      }
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  run(FrameSequence(pattern("in")), "out", method());
  const Image color = result("out", 2).layer("color");
  // Beside the lamp nothing is like a pixel, and the noise may stay: 0.16 at most, four times that.
  for (int y = 5; y < 25; ++y) {
    for (int x = 15; x < 35; ++x) {
      const float truth = albedo_at(shot, 2, x, y) * light_at(shot, 2, x, y) + (lamp(x, y) ? 50 : 0);
      ASSERT_NEAR(color.at(x, y, 1), truth, 0.64) << x << ' ' << y;
    }
  }
}

TEST_P(DenoisePublished, DamagedPixelsDoNotSpread) {
  const Shot shot{.last = 2};
  for (int f = 1; f <= 2; ++f) {
    Frame frame = make(shot, f);
    if (f == 2) {
      frame.layer("color").at(20, 20, 1) = NAN, frame.layer("color.a").at(20, 20, 1) = 1e30f;
      frame.layer("albedo").at(40, 10, 0) = NAN, frame.layer("motion.backward").at(10, 10, 0) = NAN;
    }
    write_frame(frame_path(pattern("in"), f), frame);
  }
  const StageReport report = run(FrameSequence(pattern("in")), "out", method());
  for (const float v : result("out", 2).layer("color").values()) ASSERT_TRUE(std::isfinite(v));
  EXPECT_NE(report.notes.back().find("3 values"), std::string::npos) << report.notes.back();
}

TEST_P(DenoisePublished, RefusesWhatItDoesNotHave) {
  const FrameSequence in = write("in", {.last = 2});
  for (const auto& [param, value] : {std::pair{"recipe", "halves"}, {"fireflies", "hold"}}) {
    const std::string message = error_of([&] { run(in, "out", method({{param, value}})); }, ErrorCode::kUsage);
    EXPECT_NE(message.find(param), std::string::npos) << message;
  }
  error_of([&] { run(in, "out", method({{"oidn_version", "2.5.1"}})); }, ErrorCode::kUsage);
}

INSTANTIATE_TEST_SUITE_P(Papers, DenoisePublished, testing::Values("published", "rmz13"),
                         [](const auto& method) { return std::string(method.param); });

// Half of the light is of a class that is divided by the albedo, a quarter of what mirrors show.
TEST_F(Denoise, PublishedFiltersClassesByThemselves) {
  const Shot shot{.last = 3, .classes = true};
  const FrameSequence in = write("in", shot);
  const StageReport report = run(in, "out", {{"method", "published"}});
  ASSERT_FALSE(report.notes.empty());
  EXPECT_NE(report.notes[0].find("the classes direct, mirrored, residual"), std::string::npos) << report.notes[0];
  EXPECT_LT(error("out", shot, 2), error("in", shot, 2) / 10);
  EXPECT_FALSE(result("out", 2).has("class.direct.color"));
  Shot whole = shot;
  whole.classes = false;
  run(write("whole", whole), "whole_out", {{"method", "published"}});
  EXPECT_NE(result("whole_out", 2).layer("color"), result("out", 2).layer("color"));
}

/// With the library of the tests, which takes means over 3x3 pixels.
class DenoiseOidn : public Denoise {
 protected:
  void TearDown() override {
    unsetenv("TEMPERA_OIDN_STUB_VERSION"), unsetenv("TEMPERA_OIDN");
    Denoise::TearDown();
  }
  const Flags stub_{{"method", "oidn"}, {"oidn", TEMPERA_OIDN_STUB}};
};

TEST_F(DenoiseOidn, IsLoadedAndRecorded) {
  for (const char* recipe : {"single", "halves", "components"}) {
    const Shot shot{.last = 5, .classes = true};
    const std::string name = recipe;
    const FrameSequence in = write(name, shot);
    Flags flags = stub_;
    flags["recipe"] = recipe;
    run(in, name + "_out", flags);
    EXPECT_LT(error(name + "_out", shot, 3), error(name, shot, 3) / 1.5) << recipe;
    EXPECT_EQ(to_text(result(name + "_out", 3).metadata.at("tempera/denoise_engine")), "oidn 2.3.4");
  }
}

// It copes with most fireflies: only what outshines the other half by far is held back, unless all is asked for.
TEST_F(DenoiseOidn, HoldsFarOutliersBack) {
  for (const float bright : {20.0f, 2000.0f}) {
    const Shot shot{.last = 3, .spp = 8};
    const std::string name = fmt::format("in{}", bright);
    for (int f = 1; f <= 3; ++f) {
      Frame frame = make(shot, f);
      if (f == 2) {
        for (const auto& [layer, part] : {std::pair{"color", 0.5f}, {"color.a", 1.0f}})
          frame.layer(layer).pixel(30, 20)[1] += part * bright;
      }
      write_frame(frame_path(pattern(name), f), frame);
    }
    const auto share = [&](const std::string& out, Flags flags) {
      flags.merge(Flags(stub_));
      run(FrameSequence(pattern(name)), name + out, flags);
      return std::get<double>(result(name + out, 2).metadata.at("tempera/denoise_held_share"));
    };
    const double held = share("auto", {}), all = share("hold", {{"fireflies", "hold"}});
    EXPECT_GT(all, 1e-4) << bright;
    if (bright > 1000) {
      EXPECT_GT(held, 0.5 * all);
    } else {
      EXPECT_LT(held, 0.01 * all);
    }
  }
}

TEST_F(DenoiseOidn, MustBeThereInTheVersionThatIsAskedFor) {
  const FrameSequence in = write("in", {.last = 3});
  const auto refusal = [&](const Flags& flags) {
    return error_of([&] { run(in, "out", flags); }, ErrorCode::kUnsupported);
  };
  EXPECT_NE(refusal({{"method", "oidn"}, {"oidn", "/nowhere/lib.so"}}).find("/nowhere/lib.so"), std::string::npos);
  Flags flags = stub_;
  flags["oidn_version"] = "2.5.1";
  EXPECT_NE(refusal(flags).find("version 2.3.4, version 2.5.1 is asked for"), std::string::npos);
  flags["oidn_version"] = "2.3.4";
  EXPECT_EQ(run(in, "out", flags).frames.size(), 3u);
  setenv("TEMPERA_OIDN_STUB_VERSION", "30000", 1);
  EXPECT_NE(refusal(stub_).find("3.0.0"), std::string::npos);
  error_of([&] { run(in, "out", {{"oidn", TEMPERA_OIDN_STUB}}); }, ErrorCode::kUsage);
}

// The recipe goes by samples, method and layers.
TEST_F(DenoiseOidn, RecipesFitTheSamples) {
  const auto recipe = [&](int spp, bool classes, const Flags& flags) {
    return run(write("in", {.last = 2, .spp = spp, .classes = classes}), "out", flags).notes[0];
  };
  const auto ends_with = [](const std::string& text, const char* end) { return text.ends_with(end); };
  EXPECT_PRED2(ends_with, recipe(16, true, stub_), "all samples together");
  EXPECT_PRED2(ends_with, recipe(17, true, stub_), "halves of the samples");
  EXPECT_PRED2(ends_with, recipe(23, true, stub_), "halves of the samples");
  EXPECT_PRED2(ends_with, recipe(24, true, stub_), "by class of light paths");
  EXPECT_PRED2(ends_with, recipe(24, false, stub_), "halves of the samples");
  EXPECT_PRED2(ends_with, recipe(8, true, {}), "all samples together");
  EXPECT_PRED2(ends_with, recipe(128, true, {}), "halves of the samples");
}

TEST_F(DenoiseOidn, AutoTakesItWhereItIs) {
  const FrameSequence in = write("in", {.last = 3});
  setenv("TEMPERA_OIDN", TEMPERA_OIDN_STUB, 1);
  run(in, "with", {{"method", "auto"}});
  EXPECT_EQ(to_text(result("with", 2).metadata.at("tempera/denoise_engine")), "oidn 2.3.4");
  setenv("TEMPERA_OIDN", "/nowhere/lib.so", 1);
  run(in, "without", {{"method", "auto"}});
  EXPECT_EQ(to_text(result("without", 2).metadata.at("tempera/denoise_engine")), "nl_means");
}

TEST_F(DenoiseOidn, FramesOfOneSequenceAreMadeAlike) {
  const FrameSequence in = write("in", {.last = 4});
  setenv("TEMPERA_OIDN", TEMPERA_OIDN_STUB, 1);
  const Flags chosen{{"method", "auto"}};
  run(in, "out", chosen, {.sections = {{.frames = {1, 2}}}});
  setenv("TEMPERA_OIDN", "/nowhere/lib.so", 1);  // another machine of the farm
  const auto refused = [&](const StageOptions& options) {
    return error_of([&] { run(in, "out", chosen, options); }, ErrorCode::kBadInput);
  };
  EXPECT_NE(refused({.sections = {{.frames = {3, 4}}}}).find("by oidn 2.3.4, here it would be nl_means"),
            std::string::npos);
  refused({.resume = true});
  EXPECT_EQ(run(in, "out", chosen).frames.size(), 4u) << "all of them anew";
}

/// As it was before the tests changed it.
const std::string installed_oidn = [] {
  const char* const path = std::getenv("TEMPERA_OIDN");
  return std::string(path ? path : "libOpenImageDenoise.so.2");
}();

TEST_F(DenoiseOidn, OfTheRealLibrary) {
  void* const handle = dlopen(installed_oidn.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) GTEST_SKIP() << "Open Image Denoise is not installed";
  dlclose(handle);
  const Shot shot{.last = 5};
  const FrameSequence in = write("in", shot);
  run(in, "out", {{"method", "oidn"}, {"oidn", installed_oidn}});
  EXPECT_LT(error("out", shot, 3), error("in", shot, 3) / 20);
}

}  // namespace
}  // namespace tempera
