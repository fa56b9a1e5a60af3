// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/reconstruct.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <set>

#include "synthetic_window.h"
#include "tempera/core/time.h"
#include "tempera/frames/files.h"
#include "tempera/stages/stage_plan.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

TEST(ReconstructionWindows, AreThoseOfThePaperFromFrameZeroOn) {
  EXPECT_EQ(reconstruction_windows({0, 19}, 10, 5), (std::vector<FrameRange>{{0, 9}, {5, 14}, {10, 19}}));
  EXPECT_EQ(reconstruction_windows({0, 13}, 10, 5), (std::vector<FrameRange>{{0, 9}, {5, 13}}));
  EXPECT_EQ(reconstruction_windows({0, 9}, 10, 5), (std::vector<FrameRange>{{0, 9}}));
  EXPECT_EQ(reconstruction_windows({0, 3}, 10, 5), (std::vector<FrameRange>{{0, 3}}));
  EXPECT_EQ(reconstruction_windows({1001, 1012}, 10, 5), (std::vector<FrameRange>{{1001, 1009}, {1005, 1012}}));
  EXPECT_EQ(reconstruction_windows({-7, -7}, 10, 5), (std::vector<FrameRange>{{-7, -7}}));
  EXPECT_EQ(reconstruction_windows({3, 5}, 1, 0), (std::vector<FrameRange>{{3, 3}, {4, 4}, {5, 5}}));
}

TEST(ReconstructionWindows, CoverAllFramesAndDoNotContainEachOther) {
  for (const auto& [length, overlap] : {std::pair{10, 5}, {10, 0}, {10, 9}, {7, 2}, {4, 3}, {1, 0}}) {
    for (int first = -12; first <= 12; ++first) {
      for (int count = 1; count <= 26; ++count) {
        const FrameRange segment{first, first + count - 1};
        const auto windows = reconstruction_windows(segment, length, overlap);
        std::set<int> covered;
        for (const FrameRange& w : windows) {
          EXPECT_LE(w.last - w.first + 1, length);
          for (int f = w.first; f <= w.last; ++f) covered.insert(f);
          for (const FrameRange& o : windows) {
            EXPECT_TRUE(&w == &o || o.first < w.first || o.last > w.last || !(w.first <= o.first && o.last <= w.last));
          }
        }
        EXPECT_EQ(int(covered.size()), count);
        EXPECT_EQ(*covered.begin(), segment.first);
        EXPECT_EQ(*covered.rbegin(), segment.last);
      }
    }
  }
}

TEST(ReconstructionInputs, AreTheFramesThatShareAWindow) {
  const std::vector<LayerDesc> space{layers::color(), layers::grad_x(), layers::grad_y()};
  std::vector<LayerDesc> space_and_time = space;
  for (const LayerDesc& d : {layers::color(), layers::grad_x(), layers::grad_y(), layers::source()})
    space_and_time.push_back(layers::offset(d));
  const StageEntry& entry = find_stage("reconstruct");
  Params params(entry.params);
  const FrameRange sequence{1, 240};
  const auto range = [](int first, int last) {
    std::vector<int> out;
    for (int f = first; f <= last; ++f) out.push_back(f);
    return out;
  };
  const auto reconstruction_inputs = [&](const std::vector<int>& frames, const FrameRange& whole, const Params& p,
                                         const std::vector<LayerDesc>& layers) {
    const StageChoice choice{&entry, p};
    return plan_stages(std::span(&choice, 1), {whole, whole, {}, 8, 8, layers}, frames).source;
  };
  const auto inputs = [&](const std::vector<int>& frames, const std::vector<LayerDesc>& layers) {
    return reconstruction_inputs(frames, sequence, params, layers);
  };
  EXPECT_EQ(inputs(range(1, 50), space_and_time), range(1, 59));
  EXPECT_EQ(inputs(range(51, 100), space_and_time), range(45, 109));
  EXPECT_EQ(inputs(range(50, 99), space_and_time), range(45, 104));
  EXPECT_EQ(inputs({240}, space_and_time), range(235, 240));
  EXPECT_EQ(inputs({9, 3}, space), (std::vector<int>{3, 9}));
  params.set("temporal_rows", std::string("none"));
  EXPECT_EQ(inputs({9, 3}, space_and_time), (std::vector<int>{3, 9}));
  EXPECT_TRUE(entry.follows(space));
  EXPECT_FALSE(entry.follows(std::vector{layers::color()}));

  // All of every window that holds the frame, for any length.
  for (const auto& [length, overlap] : {std::pair{10, 5}, {10, 9}, {7, 2}, {4, 0}}) {
    Params p(entry.params);
    p.set("window", length);
    p.set("overlap", overlap);
    for (int f = 1; f <= 30; ++f) {
      std::set<int> all;
      for (const FrameRange& w : reconstruction_windows({1, 30}, length, overlap)) {
        for (int g = w.first; w.contains(f) && g <= w.last; ++g) all.insert(g);
      }
      const auto read = reconstruction_inputs(std::vector{f}, {1, 30}, p, space_and_time);
      EXPECT_EQ(std::set<int>(read.begin(), read.end()), all) << f;
    }
  }
}

TEST(ReconstructionWindows, WeightsAreAHannWindow) {
  double sum = 0;
  for (int k = 0; k < 10; ++k) {
    EXPECT_NEAR(window_weight(20 + k, 20, 10), window_weight(29 - k, 20, 10), 1e-15) << "symmetric";
    EXPECT_GT(window_weight(20 + k, 20, 10), 0.02);
    sum += window_weight(20 + k, 20, 10);
    if (k < 5) {
      EXPECT_NEAR(window_weight(20 + k, 20, 10) + window_weight(25 + k, 20, 10), 1, 1e-15);
    }
  }
  EXPECT_NEAR(sum, 5, 1e-12);
  EXPECT_EQ(window_weight(3, 3, 1), 1);
}

/// What one pass sees of a frame.
using Picture = std::function<Rgb(int x, int y)>;

struct Sequence {
  int width = 24, height = 18;
  std::function<Rgb(int x, int y, int frame)> truth = [](int, int, int) { return Rgb(0.25f, 0.5f, 0.125f); };
  using Noise = std::function<Rgb(int x, int y, int frame, bool offset)>;
  Noise noise;               ///< of colors; differences follow from them,
  Noise noise_dx, noise_dy;  ///< unless they have noise of their own
  Noise photons;             ///< light that has no differences
  Noise rare, held;          ///< light of rare paths, whose differences follow from it, and what of it is held back
  Vec2<int> velocity;        ///< pixels a frame
  std::set<int> cuts;        ///< frames that replay nothing
  bool fill = true;          ///< whether pixels that replay nothing have samples
  bool temporal = true;
};

class Reconstruct : public testing::Test {
 protected:
  Reconstruct() {
    folder_ = fs::path(testing::TempDir()) / ("tempera_" + std::to_string(::getpid()) + "_" +
                                              testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  static Frame make(const Sequence& s, int frame, int first) {
    Frame f(s.width, s.height);
    const auto fill = [&](bool offset) {
      const auto value = [&](int x, int y) {
        const Rgb v = s.truth(x, y, frame);
        return s.noise ? v + s.noise(x, y, frame, offset) : v;
      };
      const auto difference = [&](int x, int y, int dx, int dy) {
        const Sequence::Noise& own = dx ? s.noise_dx : s.noise_dy;
        if (!own) return value(x + dx, y + dy) - value(x, y);
        return s.truth(x + dx, y + dy, frame) - s.truth(x, y, frame) + own(x, y, frame, offset);
      };
      const auto layer = [&](const LayerDesc& d) -> Image& { return f.create(offset ? layers::offset(d) : d); };
      const auto rare = [&](int x, int y) { return s.rare ? s.rare(x, y, frame, offset) : Rgb(0.0f); };
      if (s.photons) layer(layers::photon_color());
      Image &color = layer(layers::color()), &gx = layer(layers::grad_x()), &gy = layer(layers::grad_y());
      for (int y = 0; y < s.height; ++y) {
        for (int x = 0; x < s.width; ++x) {
          const Rgb photons = s.photons ? s.photons(x, y, frame, offset) : Rgb(0.0f);
          if (s.photons) f.layer(offset ? "offset.photon.color" : "photon.color").set_rgb(x, y, photons);
          color.set_rgb(x, y, value(x, y) + rare(x, y) + photons);
          color.at(x, y, 3) = 0.5f;
          gx.set_rgb(x, y, x + 1 < s.width ? difference(x, y, 1, 0) + rare(x + 1, y) - rare(x, y) : Rgb(NAN));
          gy.set_rgb(x, y, y + 1 < s.height ? difference(x, y, 0, 1) + rare(x, y + 1) - rare(x, y) : Rgb(NAN));
        }
      }
      if (!s.rare) return;
      Image &r = layer(layers::rare_color()), &rx = layer(layers::rare_grad_x()), &ry = layer(layers::rare_grad_y()),
            &held = layer(layers::held_color());
      for (int y = 0; y < s.height; ++y) {
        for (int x = 0; x < s.width; ++x) {
          r.set_rgb(x, y, rare(x, y));
          held.set_rgb(x, y, s.held ? s.held(x, y, frame, offset) : Rgb(0.0f));
          if (x + 1 < s.width) rx.set_rgb(x, y, rare(x + 1, y) - rare(x, y));
          if (y + 1 < s.height) ry.set_rgb(x, y, rare(x, y + 1) - rare(x, y));
        }
      }
      if (s.temporal) return;
      Image &a = layer(layers::rare_a()), &b = layer(layers::rare_b());
      for (int y = 0; y < s.height; ++y) {
        for (int x = 0; x < s.width; ++x) {
          const Rgb half = r.rgb(x, y) - held.rgb(x, y);
          a.set_rgb(x, y, half * 1.5f), b.set_rgb(x, y, half * 0.5f);
        }
      }
    };
    fill(false);
    f.create(layers::normal()).set_vec3(1, 2, {0, 1, 0});
    f.create(layers::color_variance());
    f.create(layers::color_a());
    f.metadata["tempera/spp"] = 7;
    f.metadata["tempera/fingerprint"] = fmt::format("{}x{} {}", s.width, s.height, frame);
    if (!s.temporal) return f;
    fill(true);
    Image &source = f.create(layers::offset(layers::source())), &samples = f.create(layers::offset(layers::samples()));
    for (int y = 0; y < s.height; ++y) {
      for (int x = 0; x < s.width; ++x) {
        const int sx = x - s.velocity.x, sy = y - s.velocity.y;
        const bool valid =
            frame != first && !s.cuts.contains(frame) && sx >= 0 && sy >= 0 && sx < s.width && sy < s.height;
        if (valid) source.at(x, y, 0) = float(sx), source.at(x, y, 1) = float(sy), source.at(x, y, 2) = 1;
        samples.at(x, y) = valid || s.fill ? 4 : 0;
      }
    }
    return f;
  }
  /// Files of frames first to first + count - 1.
  FrameSequence write(const std::string& name, const Sequence& s, int first, int count) const {
    for (int f = first; f < first + count; ++f) write_frame(frame_path(path(name + ".####.exr"), f), make(s, f, first));
    return FrameSequence(path(name + ".####.exr"));
  }
  static StageChoice choose(std::string_view settings = "") {
    StageChoice choice{&find_stage("reconstruct"), Params(find_stage("reconstruct").params)};
    while (!settings.empty()) {
      const auto comma = settings.find(','), equals = settings.find('=');
      choice.params.set_text(std::string(settings.substr(0, equals)),
                             std::string(settings.substr(equals + 1, comma - equals - 1)));
      settings = comma == std::string_view::npos ? std::string_view{} : settings.substr(comma + 1);
    }
    return choice;
  }
  StageReport run(const FrameSequence& in, const std::string& out, const std::string& settings = "",
                  std::vector<int> frames = {}, bool resume = false) const {
    StageOptions options;
    options.sections[0].frames = std::move(frames);
    options.resume = resume;
    StageObserver nobody;
    return run_stage(choose(settings), std::span(&in, 1), path(out + ".####.exr"), options, nobody);
  }
  Frame result(const std::string& name, int frame) const {
    return read_frame(frame_path(path(name + ".####.exr"), frame));
  }
  /// The message of the Error that a run throws.
  std::string error_of(const FrameSequence& in, ErrorCode code, const std::string& settings = "") const {
    try {
      run(in, "never", settings);
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code);
      return e.what();
    }
    ADD_FAILURE() << "no Error was thrown";
    return "";
  }
  fs::path folder_;
};

/// Noise of which the offset pass of frame f + 1 repeats most of the base pass of f at the pixel that it replays.
Sequence::Noise replayed_noise(Vec2<int> v, double sigma, std::uint64_t seed = 1) {
  return [=](int x, int y, int frame, bool offset) {
    const int sx = offset ? x - v.x : x, sy = offset ? y - v.y : y, stream = offset ? frame - 1 : frame;
    Rgb n;
    for (int c = 0; c < 3; ++c) {
      const auto address = [&](std::int64_t px, std::int64_t py, std::int64_t s, int part) {
        return hash_key(std::uint64_t(px + 1000), std::uint64_t(py + 1000), std::uint64_t(s + 1000), std::uint64_t(c),
                        std::uint64_t(part));
      };
      n[c] = float(sigma * (test::normal(seed, address(sx, sy, stream, 0)) +
                            0.1 * test::normal(seed, address(x, y, frame, offset ? 1 : 2))));
    }
    return n;
  };
}

/// A pattern that moves by the velocity.
std::function<Rgb(int, int, int)> moving_pattern(Vec2<int> v) {
  return [=](int x, int y, int frame) {
    const float a = 0.7f * float(x - v.x * frame), b = 0.4f * float(y - v.y * frame);
    return Rgb(0.5f + 0.4f * std::sin(a) * std::cos(b), 0.5f + 0.3f * std::cos(a + b), 0.6f + 0.2f * std::sin(a - b));
  };
}

double rms(const Frame& f, const std::function<Rgb(int, int)>& truth) {
  double sum = 0;
  const Image& c = f.layer("color");
  for (int y = 0; y < c.height(); ++y) {
    for (int x = 0; x < c.width(); ++x) {
      const Rgb d = c.rgb(x, y) - truth(x, y);
      sum += double(d.r * d.r + d.g * d.g + d.b * d.b) / 3;
    }
  }
  return std::sqrt(sum / double(c.pixels()));
}

// T12: blending keeps what is constant, for every length of a sequence.
TEST_F(Reconstruct, ConstantSequencesStayExactly) {
  Sequence s;
  s.width = 6, s.height = 5;
  s.velocity = {1, 0};
  for (const int count : {1, 9, 10, 11, 14, 240}) {
    const std::string name = fmt::format("c{}", count);
    const auto in = write(name, s, 1001, count);
    const StageReport r = run(in, name + "_out", "rounds=2,iterations=3");
    EXPECT_EQ(int(r.frames.size()), count);
    EXPECT_TRUE(r.notes.empty()) << r.notes[0];
    for (int f = 1001; f < 1001 + count; ++f) {
      ASSERT_EQ(rms(result(name + "_out", f), [](int, int) { return Rgb(0.25f, 0.5f, 0.125f); }), 0) << count << f;
    }
  }
}

TEST_F(Reconstruct, ExactDataGiveTheExactSequence) {
  Sequence s;
  s.velocity = {2, -1};
  s.truth = moving_pattern(s.velocity);
  // Noise in the pictures that the differences do not have.
  auto in = write("in", s, 0, 12);
  for (int f = 0; f < 12; ++f) {
    Frame frame = read_frame(in.path(f));
    for (const char* layer : {"color", "offset.color"}) {
      Image& c = frame.layer(layer);
      for (int y = 0; y < s.height; ++y) {
        for (int x = 0; x < s.width; ++x) {
          // The replay repeats it, so that differences over time are exact, too.
          const int k = layer[0] == 'o' && f > 0 ? f - 1 : f;
          const int sx = k == f ? x : x - 2, sy = k == f ? y : y + 1;
          c.set_rgb(
              x, y,
              c.rgb(x, y) + Rgb(float(0.2 * test::normal(5, (std::uint64_t(k) * 900 + std::uint64_t(sx + 40)) * 900 +
                                                                std::uint64_t(sy + 40)))));
        }
      }
    }
    write_frame(in.path(f), frame);
  }
  const double noise = rms(result("in", 6), [&](int x, int y) { return s.truth(x, y, 6); });
  EXPECT_GT(noise, 0.15);
  run(in, "l2", "norm=l2,iterations=200");
  run(in, "l1");
  for (int f = 0; f < 12; ++f) {
    // Only the mean of a connected stretch of frames is left of the noise.
    EXPECT_LT(rms(result("l2", f), [&](int x, int y) { return s.truth(x, y, f); }), 0.1 * noise) << f;
    EXPECT_LT(rms(result("l1", f), [&](int x, int y) { return s.truth(x, y, f); }), 0.1 * noise) << f;
  }
}

TEST_F(Reconstruct, PassesAreAveragedWhereBothHaveSamples) {
  Sequence s;
  s.velocity = {3, 0};
  s.noise = [](int x, int y, int, bool offset) { return Rgb(offset ? 0.5f : 0.25f) * float(x + 1) / float(y + 1); };
  for (const bool fill : {true, false}) {
    s.fill = fill;
    const auto in = write(fill ? "fill" : "void", s, 0, 2);
    // So much weight on the pictures that they are the result.
    run(in, fill ? "fill_out" : "void_out", "norm=l2,alpha=1000,temporal_rows=none");
    const auto expected = [&](int frame, bool both) {
      return [&, frame, both](int x, int y) {
        const bool two = fill || (frame == 1 && x >= 3);
        const Rgb b = s.truth(x, y, frame) + s.noise(x, y, frame, false),
                  o = s.truth(x, y, frame) + s.noise(x, y, frame, true);
        return both && two ? (b + o) * 0.5f : b;
      };
    };
    for (int f = 0; f < 2; ++f) {
      EXPECT_LT(rms(result(fill ? "fill_out" : "void_out", f), expected(f, true)), 1e-4);
      if (fill) {
        EXPECT_GT(rms(result("fill_out", f), expected(f, false)), 0.1);
      }
    }
  }
}

TEST_F(Reconstruct, ReplayedNoiseFlickersLess) {
  Sequence s;
  s.width = 40, s.height = 32;
  s.velocity = {1, 1};
  s.truth = moving_pattern(s.velocity);
  s.noise = replayed_noise(s.velocity, 0.1);
  const auto in = write("in", s, 0, 10);
  run(in, "alone", "temporal_rows=none,norm=l2");
  run(in, "together", "norm=l2");
  const auto flicker = [&](const std::string& name) {
    double sum = 0;
    for (int f = 3; f < 7; ++f) {
      const Frame a = result(name, f), b = result(name, f + 1);
      for (int y = 2; y < s.height - 2; ++y) {
        for (int x = 2; x < s.width - 2; ++x) {
          const Rgb d = (b.layer("color").rgb(x + 1, y + 1) - s.truth(x + 1, y + 1, f + 1)) -
                        (a.layer("color").rgb(x, y) - s.truth(x, y, f));
          sum += double(d.r * d.r + d.g * d.g + d.b * d.b);
        }
      }
    }
    return sum;
  };
  EXPECT_LT(flicker("together"), 0.2 * flicker("alone"));
}

/// Noise of pictures and differences in the left two thirds and the rest of a sequence, where the offset pass repeats
/// that of the base pass only if `replays`.
void set_parts(Sequence& s, double left, double right, bool replays) {
  const auto noise = [&](double of_both, std::uint64_t seed) -> Sequence::Noise {
    const auto a = replayed_noise(s.velocity, of_both * left, seed),
               b = replayed_noise(s.velocity, of_both * right, seed),
               other = replayed_noise(s.velocity, of_both * right, seed + 3);
    return [=, middle = 2 * s.width / 3](int x, int y, int frame, bool offset) {
      return (x < middle ? a : offset && !replays ? other : b)(x, y, frame, offset);
    };
  };
  s.noise = noise(1, 1), s.noise_dx = noise(0.2, 2), s.noise_dy = noise(0.2, 3);
}

TEST_F(Reconstruct, WeightsKeepBadReplaysOut) {
  Sequence s;
  s.width = 48, s.height = 32;
  s.velocity = {0, 1};
  s.truth = moving_pattern(s.velocity);
  set_parts(s, 0.1, 0.1, false);
  const auto in = write("in", s, 0, 8);
  const auto error = [&](const std::string& name) {
    double sum = 0;
    for (int f = 0; f < 8; ++f) sum += rms(result(name, f), [&](int x, int y) { return s.truth(x, y, f); });
    return sum;
  };
  for (const std::string norm : {"l1", "l2"}) {
    run(in, norm, "weights=uniform,norm=" + norm);
    run(in, norm + "_weighted", "weights=variance,norm=" + norm);
    EXPECT_LT(error(norm + "_weighted"), 0.9 * error(norm)) << norm;
    run(in, norm + "_default", "norm=" + norm);
    EXPECT_EQ(error(norm + "_default"), error(norm == "l1" ? "l1_weighted" : "l2"));
  }
}

TEST_F(Reconstruct, WeightsKeepNoiseWhereItIs) {
  Sequence s;
  s.width = 48, s.height = 32;
  s.velocity = {0, 1};
  s.truth = moving_pattern(s.velocity);
  set_parts(s, 0.02, 1, true);
  s.noise = replayed_noise(s.velocity, 0.1);
  const auto in = write("in", s, 0, 6);
  for (const std::string window : {"1", "10"}) {
    run(in, "uniform" + window, "norm=l2,iterations=100,window=" + window);
    run(in, "variance" + window, "weights=variance,norm=l2,iterations=100,window=" + window);
    const auto error = [&](const std::string& name) {
      double sum = 0;
      for (int f = 0; f < 6; ++f) sum += rms(result(name + window, f), [&](int x, int y) { return s.truth(x, y, f); });
      return sum;
    };
    EXPECT_LT(error("variance"), 0.75 * error("uniform")) << window;
  }
}

TEST_F(Reconstruct, ChunksGiveTheBitsOfTheWhole) {
  Sequence s;
  s.velocity = {1, 0};
  s.truth = moving_pattern(s.velocity);
  s.noise = replayed_noise(s.velocity, 0.1);
  s.cuts = {1009};
  const auto in = write("in", s, 1001, 24);
  const StageReport whole = run(in, "whole");
  EXPECT_EQ(whole.frames.size(), 24u);
  EXPECT_EQ(whole.notes, std::vector<std::string>{"cuts before frames 1009 (1 frame)"});
  // Chunks, single frames, and frames picked here and there.
  for (const std::vector<int>& frames :
       {std::vector<int>{1001, 1002, 1003}, {1008}, {1009}, {1010, 1011, 1012, 1013}, {1024}, {1004, 1016, 1017}}) {
    const StageReport r = run(in, "part", "", frames);
    EXPECT_EQ(r.frames, frames);
    for (const int f : frames) EXPECT_EQ(result("part", f).layer("color"), result("whole", f).layer("color")) << f;
  }
  // A machine that holds no more than the frames of the windows.
  fs::create_directories(path("halo"));
  for (int f = 1006; f <= 1020; ++f) fs::copy_file(in.path(f), frame_path(path("halo/in.####.exr"), f));
  run(FrameSequence(path("halo")), "far", "", {1011, 1012, 1013, 1014});
  for (int f = 1011; f <= 1014; ++f) EXPECT_EQ(result("far", f).layer("color"), result("whole", f).layer("color")) << f;
  with_threads(1, [&] { run(in, "one", "", {1012}); });
  with_threads(7, [&] { run(in, "seven", "", {1012}); });
  EXPECT_EQ(result("one", 1012).layer("color"), result("seven", 1012).layer("color"));
}

TEST_F(Reconstruct, NothingPassesThroughACut) {
  Sequence a, b;
  a.velocity = b.velocity = {1, 0};
  a.noise = b.noise = replayed_noise({1, 0}, 0.1);
  a.truth = b.truth = moving_pattern({1, 0});
  a.cuts = b.cuts = {6};
  b.truth = [&](int x, int y, int f) { return f < 6 ? a.truth(x, y, f) : Rgb(7) - a.truth(x, y, f); };
  run(write("a", a, 0, 12), "a_out");
  run(write("b", b, 0, 12), "b_out");
  for (int f = 0; f < 6; ++f) EXPECT_EQ(result("a_out", f).layer("color"), result("b_out", f).layer("color")) << f;
  EXPECT_NE(result("a_out", 6).layer("color"), result("b_out", 6).layer("color"));

  // The name of the camera tells, too.
  Sequence c = a;
  c.cuts.clear();
  const auto in = write("c", c, 0, 12);
  for (int f = 0; f < 12; ++f) {
    Frame frame = read_frame(in.path(f));
    frame.metadata["tempera/camera"] = f < 6 ? "near" : "far";
    write_frame(in.path(f), frame);
  }
  EXPECT_EQ(run(in, "c_out").notes, std::vector<std::string>{"cuts before frames 6 (1 frame)"});
}

TEST_F(Reconstruct, ResumeKeepsWhatIsFinishedAndRedoesTheRest) {
  Sequence s;
  s.velocity = {1, 0};
  s.noise = replayed_noise(s.velocity, 0.1);
  const auto in = write("in", s, 0, 12);
  run(in, "whole");
  run(in, "out");
  const auto file = [&](int f) { return frame_path(path("out.####.exr"), f); };
  fs::remove(file(4));
  fs::resize_file(file(7), fs::file_size(file(7)) / 2);
  { std::ofstream(file(9)) << "not an image"; }
  StageReport r = run(in, "out", "", {}, true);
  EXPECT_EQ(r.frames, (std::vector<int>{4, 7, 9}));
  EXPECT_EQ(r.skipped.size(), 9u);
  for (int f = 0; f < 12; ++f) EXPECT_EQ(result("out", f).layer("color"), result("whole", f).layer("color")) << f;
  EXPECT_TRUE(run(in, "out", "", {}, true).frames.empty());
  EXPECT_EQ(run(in, "out", "alpha=0.3", {}, true).frames.size(), 12u) << "other settings";
  // A new input makes the frames whose windows hold it old.
  Frame changed = read_frame(in.path(11));
  changed.metadata["tempera/fingerprint"] = "another";
  write_frame(in.path(11), changed);
  r = run(in, "out", "alpha=0.3", {}, true);
  EXPECT_EQ(r.frames, (std::vector<int>{5, 6, 7, 8, 9, 10, 11}));
}

TEST_F(Reconstruct, OutputKeepsFeaturesAndAlpha) {
  Sequence s;
  const auto in = write("in", s, 0, 2);
  run(in, "out");
  const Frame f = result("out", 1);
  EXPECT_EQ(f.layer_names(), (std::vector<std::string>{"color", "normal"}));
  EXPECT_EQ(f.layer("color").at(3, 3, 3), 0.5f);
  EXPECT_EQ(f.layer("normal").vec3(1, 2).y, 1);
  EXPECT_EQ(std::get<int>(f.metadata.at("tempera/spp")), 7);
  EXPECT_FALSE(f.metadata.contains("tempera/fingerprint")) << "a render must not take it for its own";
  EXPECT_NE(std::get<std::string>(f.metadata.at("tempera/reconstruct")).find("alpha=0.2"), std::string::npos);
}

// A crop stores sources as pixels of the full picture; those outside of it replay nothing that is here.
TEST_F(Reconstruct, CropsAreCutsOfTheFullPicture) {
  Sequence s;
  s.velocity = {1, 0};
  s.truth = moving_pattern(s.velocity);
  s.noise = replayed_noise(s.velocity, 0.1);
  const auto in = write("in", s, 0, 4);
  run(in, "out");
  for (int f = 0; f < 4; ++f) {
    Frame frame = read_frame(in.path(f));
    frame.metadata["tempera/crop_left"] = 100, frame.metadata["tempera/crop_top"] = 50;
    Image& source = frame.layer("offset.source");
    for (int y = 0; y < s.height; ++y) {
      for (int x = 0; x < s.width; ++x) {
        if (f > 0 && x == 0) source.at(x, y, 0) = -1, source.at(x, y, 1) = float(y), source.at(x, y, 2) = 1;
        source.at(x, y, 0) += 100, source.at(x, y, 1) += 50;
      }
    }
    write_frame(frame_path(path("crop.####.exr"), f), frame);
  }
  run(FrameSequence(path("crop.####.exr")), "crop_out");
  for (int f = 0; f < 4; ++f) EXPECT_EQ(result("out", f).layer("color"), result("crop_out", f).layer("color")) << f;
}

TEST_F(Reconstruct, SingleFramesWithoutOffsetPass) {
  Sequence s;
  s.temporal = false;
  s.truth = moving_pattern({1, 0});
  // Every other frame is enough where frames stand alone.
  for (const int f : {1, 3}) write_frame(frame_path(path("in.####.exr"), f), make(s, f, 1));
  run(FrameSequence(path("in.####.exr")), "out", "norm=l2");
  for (const int f : {1, 3}) EXPECT_LT(rms(result("out", f), [&](int x, int y) { return s.truth(x, y, f); }), 1e-5);

  write_frame(path("still.exr"), make(s, 0, 0));
  StageObserver nobody;
  const FrameSequence still(path("still.exr"));
  run_stage(choose(), std::span(&still, 1), path("still_out.exr"), {}, nobody);
  EXPECT_TRUE(fs::exists(path("still_out.exr"))) << "a single file keeps its plain name";
}

/// Dots, a tenth of the pixels of each pass, as bright as makes the mean `mean`.
Sequence::Noise dots(float mean) {
  return [=](int x, int y, int frame, bool offset) {
    const std::uint64_t h = hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(frame), std::uint64_t(offset));
    return to_unit_float(std::uint32_t(h)) < 0.1f ? Rgb(10 * mean) : Rgb(0.0f);
  };
}

Sequence with_rare_light() {
  Sequence s;
  s.width = 48, s.height = 40;
  s.velocity = {1, 0};
  s.truth = moving_pattern(s.velocity);
  s.noise = replayed_noise(s.velocity, 0.02);
  s.rare = dots(0.5f);
  return s;
}

TEST_F(Reconstruct, RareLightIsKeptApartAndSmoothed) {
  const Sequence s = with_rare_light();
  const auto in = write("in", s, 0, 6);
  const StageReport report = run(in, "apart");
  run(in, "together", "rare=together");
  const auto lit = [&](int x, int y) { return s.truth(x, y, 3) + Rgb(0.5f); };
  const Frame apart = result("apart", 3), together = result("together", 3);
  EXPECT_LT(rms(apart, lit), 0.5 * rms(together, lit));
  double sum = 0, raw = 0;
  float least = 1;
  for (int y = 0; y < s.height; ++y) {
    for (int x = 0; x < s.width; ++x) {
      sum += double(apart.layer("color").rgb(x, y).g), least = std::min(least, apart.layer("color").rgb(x, y).g);
      const Rgb rare = (s.rare(x, y, 3, false) + s.rare(x, y, 3, true)) * 0.5f;
      raw += double(s.truth(x, y, 3).g + rare.g);
      EXPECT_EQ(apart.layer("color.rare").rgb(x, y), rare) << "not smoothed";
      EXPECT_NEAR(apart.layer("color.common").rgb(x, y).g, s.truth(x, y, 3).g, 0.1);
    }
  }
  EXPECT_GE(least, 0);
  EXPECT_NEAR(sum / raw, 1, 0.05) << "no light is lost";
  EXPECT_GT(std::get<double>(apart.metadata.at("tempera/rare_light")), 0.3);
  EXPECT_EQ(std::get<double>(apart.metadata.at("tempera/held_back")), 0);
  ASSERT_EQ(report.notes.size(), 1u);
  EXPECT_NE(report.notes[0].find("% of the light was kept apart"), std::string::npos) << report.notes[0];
  EXPECT_FALSE(together.has("color.common"));
  EXPECT_FALSE(together.has("rare.color"));
  EXPECT_FALSE(apart.has("rare.color"));
  run(in, "no_parts", "parts=no");
  EXPECT_FALSE(result("no_parts", 3).has("color.common"));
  EXPECT_EQ(result("no_parts", 3).layer("color"), apart.layer("color"));
}

// They come through as they are, whatever is solved for.
TEST_F(Reconstruct, LightOfPhotonsIsAddedToTheSolution) {
  Sequence with = with_rare_light();
  const Sequence without = with;
  with.photons = [](int x, int y, int frame, bool offset) {
    return Rgb(float((x * 7 + y * 3 + frame) % 5) + (offset ? 0.5f : 0.0f));
  };
  const auto in = write("in", with, 0, 4), plain = write("plain", without, 0, 4);
  for (const char* settings : {"norm=l1", "norm=l2"}) {
    SCOPED_TRACE(settings);
    run(in, "a", settings);
    run(plain, "b", settings);
    const Frame a = result("a", 2), b = result("b", 2);
    EXPECT_FALSE(a.has("photon.color"));
    double worst = 0;
    for (int y = 0; y < with.height; ++y) {
      for (int x = 0; x < with.width; ++x) {
        const Rgb photons = (with.photons(x, y, 2, false) + with.photons(x, y, 2, true)) * 0.5f;
        // Where the solution is below 0 it is the sum that is kept from being so.
        const float expected = b.layer("color").rgb(x, y).g + photons.g;
        if (b.layer("color").rgb(x, y).g > 0)
          worst = std::max(worst, double(std::abs(a.layer("color").rgb(x, y).g - expected)));
      }
    }
    EXPECT_LT(worst, 1e-3);
  }
}

TEST_F(Reconstruct, WhatIsHeldBackIsSaid) {
  Sequence s = with_rare_light();
  s.held = [&](int x, int y, int frame, bool offset) { return s.rare(x, y, frame, offset) * 0.25f; };
  const StageReport report = run(write("in", s, 0, 3), "out");
  EXPECT_EQ(report.notes.size(), 1u);
  for (int f = 0; f < 3; ++f) {
    const Frame frame = result("out", f);
    EXPECT_NEAR(std::get<double>(frame.metadata.at("tempera/held_back")),
                0.25 * std::get<double>(frame.metadata.at("tempera/rare_light")), 1e-6);
    const Rgb rare = (s.rare(5, 6, f, false) + s.rare(5, 6, f, true)) * 0.5f;
    EXPECT_EQ(frame.layer("color.rare").rgb(5, 6), rare * 0.75f);
  }
}

// L2 is for unbiased frames: all light together, the bits of files without these layers.
TEST_F(Reconstruct, L2TakesAllLightTogether) {
  const Sequence s = with_rare_light();
  const auto in = write("in", s, 0, 6);
  for (int f = 0; f < 6; ++f) {
    Frame frame = read_frame(in.path(f));
    for (const std::string& name : frame.layer_names()) {
      if (name.find("rare.") != std::string::npos || name.find("held.") != std::string::npos) frame.remove(name);
    }
    write_frame(frame_path(path("plain.####.exr"), f), frame);
  }
  const FrameSequence plain(path("plain.####.exr"));
  for (const std::string norm : {"l1", "l2"}) {
    run(in, "in_" + norm, "rare=" + std::string(norm == "l1" ? "together" : "auto") + ",norm=" + norm);
    run(plain, "plain_" + norm, "norm=" + norm);
    for (int f = 0; f < 6; ++f)
      EXPECT_EQ(result("in_" + norm, f).layer("color"), result("plain_" + norm, f).layer("color")) << norm << f;
  }
  EXPECT_EQ(
      error_of(plain, ErrorCode::kBadInput, "rare=apart"),
      "rare = \"apart\" needs frames with the layers of rare light (rare.color and others), which gradient-domain "
      "integrators write unless told not to (rare = false); auto and together take any");
}

TEST_F(Reconstruct, ChunksAndThreadsGiveTheBitsOfTheWholeWithRareLight) {
  Sequence s = with_rare_light();
  s.cuts = {1009};
  const auto in = write("in", s, 1001, 16);
  run(in, "whole");
  const auto same = [&](const std::string& name, int f) {
    for (const char* layer : {"color", "color.common", "color.rare"})
      EXPECT_EQ(result(name, f).layer(layer), result("whole", f).layer(layer)) << layer << f;
  };
  for (const std::vector<int>& frames : {std::vector<int>{1001, 1002}, {1008}, {1009}, {1004, 1014, 1016}}) {
    run(in, "part", "", frames);
    for (const int f : frames) same("part", f);
  }
  with_threads(1, [&] { run(in, "one", "", {1005, 1006}); });
  with_threads(5, [&] { run(in, "five", "", {1005, 1006}); });
  for (const int f : {1005, 1006}) same("one", f), same("five", f);
}

TEST_F(Reconstruct, RareLightOfSinglePasses) {
  Sequence s = with_rare_light();
  s.temporal = false;
  const auto in = write("in", s, 0, 1);
  run(in, "apart");
  run(in, "together", "rare=together");
  const auto lit = [&](int x, int y) { return s.truth(x, y, 0) + Rgb(0.5f); };
  EXPECT_LT(rms(result("apart", 0), lit), 0.6 * rms(result("together", 0), lit));
  const Rgb rare = s.rare(9, 9, 0, false);
  EXPECT_EQ(result("apart", 0).layer("color.rare").rgb(9, 9), rare);
}

// Classes with differences are solved for, each as all light is: a class that has all of it has the bits of `color`, and
// one that has a quarter of it, with l2, a quarter.
TEST_F(Reconstruct, ClassesWithDifferencesAreSolvedFor) {
  for (const bool temporal : {true, false}) {
    for (const std::string norm : {"l1", "l2"}) {
      Sequence s;
      s.velocity = {1, 0};
      s.truth = moving_pattern(s.velocity);
      s.noise = replayed_noise(s.velocity, 0.1);
      s.temporal = temporal;
      for (int f = 0; f < 8; ++f) {
        Frame frame = make(s, f, 0);
        for (const LayerDesc& d : {layers::color(), layers::grad_x(), layers::grad_y()}) {
          for (const bool offset : {false, true}) {
            if (offset && !temporal) continue;
            const auto pass = [&](const LayerDesc& l) { return offset ? layers::offset(l) : l; };
            const Image from = frame.layer(pass(d).name);
            Image& all = frame.create(pass(layers::class_layer("all", d)));
            Image& quarter = frame.create(pass(layers::class_layer("quarter", d)));
            for (int y = 0; y < s.height; ++y) {
              for (int x = 0; x < s.width; ++x)
                all.set_rgb(x, y, from.rgb(x, y)), quarter.set_rgb(x, y, from.rgb(x, y) * 0.25f);
            }
          }
        }
        frame.create(layers::class_layer("other", layers::color()));
        frame.create(layers::class_layer("all", layers::color_a()));
        write_frame(frame_path(path("in.####.exr"), f), frame);
      }
      run(FrameSequence(path("in.####.exr")), "out", "window=4,norm=" + norm);
      for (int f = 0; f < 8; ++f) {
        const Frame out = result("out", f);
        EXPECT_FALSE(out.has("class.other.color") || out.has("class.all.grad.x") || out.has("class.all.color.a") ||
                     out.has("offset.class.all.color"));
        for (int y = 0; y < s.height; ++y) {
          for (int x = 0; x < s.width; ++x) {
            const Rgb color = out.layer("color").rgb(x, y);
            ASSERT_EQ(out.layer("class.all.color").rgb(x, y), color) << f << ": " << x << " " << y;
            if (norm == "l2") {
              ASSERT_EQ(out.layer("class.quarter.color").rgb(x, y), color * 0.25f) << f << ": " << x << " " << y;
            }
          }
        }
      }
    }
  }
}

// Parts of the input's picture are not parts of the solution.
TEST_F(Reconstruct, ClassesAreLeftOut) {
  Sequence s;
  Frame f = make(s, 0, 0);
  f.create(layers::class_layer("direct", layers::color()));
  f.create(layers::class_layer("residual", layers::color()));
  write_frame(path("in.0000.exr"), f);
  run(FrameSequence(path("in.####.exr")), "out");
  for (const std::string& name : result("out", 0).layer_names()) EXPECT_FALSE(name.starts_with("class.")) << name;
}

TEST_F(Reconstruct, BadInputIsNamed) {
  Sequence s;
  s.velocity = {1, 0};
  const auto in = write("in", s, 0, 4);
  const auto spoil = [&](int f, const std::function<void(Frame&)>& how) {
    Frame frame = make(s, f, 0);
    how(frame);
    write_frame(in.path(f), frame);
  };
  const auto restore = [&](int f) { write_frame(in.path(f), make(s, f, 0)); };

  spoil(2, [](Frame& f) { f.remove("offset.grad.y"); });
  EXPECT_EQ(error_of(in, ErrorCode::kBadInput),
            in.path(2) +
                " has no layer \"offset.grad.y\": reconstruction needs the frames of the integrator "
                "temporal_gradient_path");
  spoil(2, [](Frame& f) { f.layer("grad.x").set_rgb(5, 4, Rgb(INFINITY)); });
  EXPECT_EQ(error_of(in, ErrorCode::kBadInput),
            in.path(2) + ": layer \"grad.x\" has a value that is not finite at pixel 5,4");
  spoil(2, [](Frame& f) { f.layer("offset.source").at(5, 4, 0) = 99; });
  EXPECT_EQ(error_of(in, ErrorCode::kBadInput),
            in.path(2) + ": layer \"offset.source\" names 99,4 at pixel 5,4, which is no pixel of the frame before");
  spoil(2, [](Frame& f) { f.layer("offset.source").at(5, 4, 0) = 5; });
  EXPECT_EQ(error_of(in, ErrorCode::kBadInput),
            in.path(2) + ": layer \"offset.source\" names 5,4 at two pixels, 5,4 and 6,4: it must be one-to-one");
  restore(2);
  Sequence wide = s;
  wide.width = 25;
  write_frame(in.path(3), make(wide, 3, 0));
  EXPECT_EQ(error_of(in, ErrorCode::kBadInput), in.path(3) + " has 25x18 pixels, " + in.path(0) + " has 24x18");
  restore(3);
  fs::remove(in.path(1));
  const FrameSequence gap(path("in.####.exr"));
  EXPECT_EQ(error_of(gap, ErrorCode::kBadInput),
            gap.pattern() +
                " lacks frames in between: 1; without them there are no differences over time (give "
                "--temporal-rows none to do without)");
  EXPECT_EQ(run(gap, "apart", "temporal_rows=none").frames, (std::vector<int>{0, 2, 3}));
  EXPECT_NE(error_of(gap, ErrorCode::kOutOfRange, "window=4,overlap=4").find("overlap of 4"), std::string::npos);

  Sequence plain;
  plain.temporal = false;
  Frame f = make(plain, 0, 0);
  f.remove("grad.x");
  write_frame(path("plain.0000.exr"), f);
  EXPECT_EQ(error_of(FrameSequence(path("plain.####.exr")), ErrorCode::kBadInput),
            path("plain.0000.exr") +
                " has no layer \"grad.x\": reconstruction needs the frames of the integrator "
                "gradient_path");
  write_frame(path("plain.0000.exr"), make(plain, 0, 0));
  EXPECT_EQ(error_of(FrameSequence(path("plain.####.exr")), ErrorCode::kBadInput, "weights=variance"),
            "weights = \"variance\" compares the two passes of temporal_gradient_path, and these frames have one; "
            "auto and uniform take any");
  StageOptions options;
  StageObserver nobody;
  try {
    run_stage(choose(), std::span(&gap, 1), gap.pattern(), options, nobody);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUsage);
  }
  options.sections[0].frames = {17};
  try {
    run_stage(choose(), std::span(&gap, 1), path("never.####.exr"), options, nobody);
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kMissingFile);
  }
}

TEST_F(Reconstruct, StopsBetweenStepsAndKeepsFinishedFrames) {
  Sequence s;
  s.velocity = {1, 0};
  s.noise = replayed_noise(s.velocity, 0.1);
  const auto in = write("in", s, 0, 20);
  struct Stopper : StageObserver {
    std::stop_source stop;
    double last = 0;
    void progress(double share) override {
      EXPECT_GE(share, last);
      EXPECT_LE(share, 1);
      last = share;
    }
    void frame_done(int frame, const std::string&) override {
      if (frame == 3) stop.request_stop();
    }
  } stopper;
  try {
    run_stage(choose(), std::span(&in, 1), path("out.####.exr"), {}, stopper, stopper.stop.get_token());
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kCancelled);
  }
  EXPECT_TRUE(fs::exists(path("out.0003.exr")));
  EXPECT_FALSE(fs::exists(path("out.0012.exr")));
  run(in, "out", "", {}, true);
  run(in, "whole");
  for (int f = 0; f < 20; ++f) EXPECT_EQ(result("out", f).layer("color"), result("whole", f).layer("color")) << f;
}

}  // namespace
}  // namespace tempera
