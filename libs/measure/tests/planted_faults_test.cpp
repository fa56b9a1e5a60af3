// SPDX-License-Identifier: Apache-2.0
// Faults that a renderer of animations can have, planted in sequences that are otherwise fine: each has to move the
// metrics that are there for it by what follows from its size, and leave alone those that are not.
#include <algorithm>

#include "sequences.h"

namespace tempera {
namespace {

using namespace test;

constexpr int kWidth = 48, kHeight = 32, kFirst = 1, kLast = 16, kPan = 2;
constexpr float kNoise = 0.02f;

/// A smooth pattern that pans: slow enough that nothing of it changes faster than an eighth of the frame rate.
float pattern(int x, int y, int frame) {
  const float u = float(x - kPan * frame), v = float(y);
  return 0.8f + 0.5f * std::sin(6.2831853f * u / 16) * std::cos(0.2f * v) + 0.01f * v;
}

Image reference_image(int frame) {
  return filled(kWidth, kHeight, 3, [=](int x, int y, int) { return pattern(x, y, frame); });
}

/// What a sound renderer makes of it: noise of kNoise, new in each frame.
Image sound(int frame, int seed) {
  return filled(kWidth, kHeight, 3,
                [=](int x, int y, int) { return pattern(x, y, frame) * (1 + kNoise * normal(x, y, frame, seed)); });
}

Image times(Image image, float factor) {
  for (float& v : image.values()) v *= factor;
  return image;
}

/// Mean over frames and pixels of f(reference).
double mean_of_reference(const std::function<double(double)>& f) {
  double sum = 0;
  for (int t = kFirst; t <= kLast; ++t) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) sum += f(double(pattern(x, y, t)));
    }
  }
  return sum / double(kWidth * kHeight * (kLast - kFirst + 1));
}

class PlantedFaults : public SequenceTest {
 protected:
  /// The reference, with vectors that are off by `backward_error` and `forward_error` pixels to the right.
  FrameSequence reference(const std::string& folder, float backward_error = 0, float forward_error = 0) const {
    return write(folder, kFirst, kLast, [=](int f) {
      Frame frame = color_frame(reference_image(f));
      frame.add(layers::motion_backward(), vectors(kWidth, kHeight, -float(kPan) + backward_error, 0));
      frame.add(layers::motion_forward(), vectors(kWidth, kHeight, float(kPan) + forward_error, 0));
      return frame;
    });
  }
  FrameSequence control(const std::string& folder, int seed) const {
    return write_colors(folder, kFirst, kLast, [=](int f) { return sound(f, seed); });
  }
  static CompareResult compare(const std::vector<CompareInput>& sides, const FrameSequence& reference) {
    CompareOptions options;
    options.metrics = {"all"};
    return compare_sequences(sides, reference, options);
  }
  static CompareResult compare(const std::vector<FrameSequence>& sides, const FrameSequence& reference) {
    std::vector<CompareInput> inputs;
    for (const FrameSequence& s : sides) inputs.push_back(input(s));
    return compare(inputs, reference);
  }
};

double mean(const CompareSide& side, std::string_view id) { return side.find(id)->mean.mean; }
const std::vector<double>& values(const CompareSide& side, std::string_view id) { return side.find(id)->values; }

/// That a fault moved the mean of a metric: by much more than another seed does.
testing::AssertionResult Moved(const CompareResult& r, std::string_view id, double times_more = 8) {
  const double control = mean(r.sides[0], id), other = mean(r.sides[1], id), fault = mean(r.sides[2], id);
  const bool moved = std::abs(fault - control) > times_more * std::abs(other - control);
  return (moved && std::isfinite(fault) ? testing::AssertionSuccess() : testing::AssertionFailure())
         << id << ": control " << control << ", another seed " << other << ", fault " << fault;
}

TEST_F(PlantedFaults, ControlsAreAsTheirNoise) {
  const CompareResult r = compare({control("a", 1), control("b", 2)}, reference("r"));
  const double relative = kNoise * kNoise * mean_of_reference([](double v) { return v * v / (v * v + 0.01); });
  const double power = kNoise * kNoise * mean_of_reference([](double v) { return v * v; });
  for (const CompareSide& s : r.sides) {
    EXPECT_NEAR(mean(s, "relmse") / relative, 1, 0.03);
    EXPECT_NEAR(mean(s, "temporal") / relative, 2, 0.06);
    EXPECT_NEAR(mean(s, "temporal_compensated") / relative, 2, 0.06);
    EXPECT_NEAR(mean(s, "flicker") / power, 7.0 / 16, 0.02) << "frequencies 5 to 8 of 16, the last with one sign";
    EXPECT_NEAR(mean(s, "flicker_tracked") / power, 7.0 / 16, 0.03);
    EXPECT_NEAR(mean(s, "bias"), 0, 5e-4);
    EXPECT_LT(std::abs(mean(s, "bias")), 3 * s.find("bias")->mean.standard_error);
  }
  EXPECT_EQ(r.sides[0].find("motion_error"), nullptr) << "the tests have no vectors";
}

TEST_F(PlantedFaults, BrightnessFlickerOfOnePercent) {
  const auto flickering =
      write_colors("fault", kFirst, kLast, [](int f) { return times(sound(f, 1), f % 2 ? 0.99f : 1.01f); });
  const CompareResult r = compare({control("a", 1), control("b", 2), flickering}, reference("r"));
  const CompareSide &sound_side = r.sides[0], &fault = r.sides[2];
  const double power = 1e-4 * mean_of_reference([](double v) { return v * v; });
  const double relative = 1e-4 * mean_of_reference([](double v) { return v * v / (v * v + 0.01); });

  EXPECT_TRUE(Moved(r, "flicker_display"));
  EXPECT_TRUE(Moved(r, "flicker"));
  EXPECT_NEAR((mean(fault, "flicker") - mean(sound_side, "flicker")) / power, 1, 0.05) << "all of it is flicker";
  EXPECT_TRUE(Moved(r, "flicker_tracked"));
  EXPECT_NEAR((mean(fault, "flicker_tracked") - mean(sound_side, "flicker_tracked")) / power, 1, 0.05);
  EXPECT_TRUE(Moved(r, "temporal"));
  EXPECT_GT((mean(fault, "temporal") - mean(sound_side, "temporal")) / relative, 3.7);
  EXPECT_TRUE(Moved(r, "temporal_compensated"));
  EXPECT_NEAR((mean(fault, "temporal_compensated") - mean(sound_side, "temporal_compensated")) / relative, 4, 0.1)
      << "2 % from frame to frame";
  EXPECT_TRUE(Moved(r, "warp_error"));
  // Each frame is a little worse, by the square of 1 %, and none of it shows in the mean brightness.
  EXPECT_NEAR((mean(fault, "relmse") - mean(sound_side, "relmse")) / relative, 1, 0.1);
  EXPECT_NEAR(mean(fault, "bias"), mean(sound_side, "bias"), 2e-5);
  for (std::size_t f = 0; f < fault.frames.size(); ++f) {
    EXPECT_NEAR(values(fault, "bias")[f] - values(sound_side, "bias")[f], f % 2 ? 0.01 : -0.01, 1e-4);
  }
  EXPECT_NEAR(mean(fault, "ssim"), mean(sound_side, "ssim"), 1e-3) << "structure stays";

  // The spectrum says what kind of flicker it is: all at half of the frame rate, that is the last frequency and, by the
  // window, the one before.
  const auto spectrum = [](const CompareSide& side) {
    return *std::find_if(side.spectra.begin(), side.spectra.end(), [](const auto& p) { return p.id == "flicker"; });
  };
  const ResidualSpectrum s = spectrum(fault), c = spectrum(sound_side);
  ASSERT_EQ(s.power.size(), 9u);
  EXPECT_NEAR((s.power[8] + s.power[7] - c.power[8] - c.power[7]) / power, 1, 0.1);
  for (std::size_t k = 0; k < 5; ++k) EXPECT_NEAR(s.power[k], c.power[k], 0.03 * power) << k;
}

TEST_F(PlantedFaults, OneFrameIsDropped) {
  constexpr int kDropped = 9;  // shows the frame before once more
  const auto dropping = write_colors("fault", kFirst, kLast, [](int f) { return sound(f == kDropped ? f - 1 : f, 1); });
  const CompareResult r = compare({control("a", 1), control("b", 2), dropping}, reference("r"));
  const CompareSide &sound_side = r.sides[0], &fault = r.sides[2];
  for (const char* id : {"relmse", "mse", "flip", "temporal", "temporal_compensated", "warp_error", "flicker"}) {
    EXPECT_TRUE(Moved(r, id));
  }
  for (std::size_t f = 0; f < fault.frames.size(); ++f) {
    const bool dropped = fault.frames[f] == kDropped, pair = dropped || fault.frames[f] == kDropped + 1;
    for (const char* id : {"relmse", "mse", "flip"}) {
      if (dropped) {
        EXPECT_GT(values(fault, id)[f], 3 * values(sound_side, id)[f]) << id;
      } else {
        EXPECT_EQ(values(fault, id)[f], values(sound_side, id)[f]) << id << " of frame " << fault.frames[f];
      }
    }
    if (f == 0) continue;
    for (const char* id : {"temporal", "temporal_compensated", "warp_error"}) {
      if (pair) {
        EXPECT_GT(values(fault, id)[f], 10 * values(sound_side, id)[f]) << id;
      } else {
        EXPECT_EQ(values(fault, id)[f], values(sound_side, id)[f]) << id << " of frame " << fault.frames[f];
      }
    }
  }
  EXPECT_EQ(values(fault, "flicker_static")[kDropped - kFirst], 0) << "a frozen frame does not change at all";
  EXPECT_NEAR(mean(fault, "bias"), mean(sound_side, "bias"), 1e-3);
}

TEST_F(PlantedFaults, OneFrameIsMissing) {
  constexpr int kMissing = 9;
  const auto whole = control("a", 1);
  control("fault", 1);
  std::filesystem::remove(whole.path(kMissing).replace(whole.path(kMissing).find("/a/"), 3, "/fault/"));
  const CompareResult r = compare({whole, FrameSequence(path("fault/f.####.exr"))}, reference("r"));
  const CompareSide &sound_side = r.sides[0], &fault = r.sides[1];
  EXPECT_TRUE(sound_side.missing.empty());
  EXPECT_EQ(fault.missing, std::vector<int>{kMissing});
  EXPECT_EQ(fault.frames.size(), sound_side.frames.size() - 1);
  const auto after = std::size_t(kMissing - kFirst);  // index of the frame after it
  EXPECT_EQ(fault.frames[after], kMissing + 1);
  EXPECT_TRUE(std::isnan(values(fault, "temporal")[after])) << "the frame before it is not there";
  EXPECT_EQ(values(fault, "temporal")[after + 1], values(sound_side, "temporal")[after + 2]);
  EXPECT_EQ(values(fault, "relmse")[after], values(sound_side, "relmse")[after + 1]);
  EXPECT_EQ(fault.spectra[0].segment_frames, 8) << "the longer of the stretches: frames 1 to 8";
  EXPECT_TRUE(std::any_of(r.notes.begin(), r.notes.end(), [](const std::string& n) {
    return n.find("lacks 1 of the frames") != std::string::npos;
  })) << to_table(r);
}

TEST_F(PlantedFaults, MotionVectorsOfTheReferenceAreShifted) {
  // An error that sticks to what moves, as that of a renderer that reuses samples, beside fresh noise.
  const auto sticky = write_colors("t", kFirst, kLast, [](int f) {
    return filled(kWidth, kHeight, 3, [=](int x, int y, int) {
      const float stuck = 0.1f * normal(x - kPan * f, y, 0, 7);
      return pattern(x, y, f) * (1 + stuck + kNoise * normal(x, y, f, 1));
    });
  });
  const CompareResult right = compare({sticky}, reference("right"));
  const CompareResult wrong = compare({sticky}, reference("wrong", 1, -1));
  const CompareSide &a = right.sides[0], &b = wrong.sides[0];
  const double relative = mean_of_reference([](double v) { return v * v / (v * v + 0.01); });
  // Along the right vectors only the fresh noise changes; along wrong ones the stuck error does as well.
  EXPECT_NEAR(mean(a, "temporal_compensated") / (2 * kNoise * kNoise * relative), 1, 0.1);
  EXPECT_NEAR(mean(b, "temporal_compensated") / (2 * (kNoise * kNoise + 0.01) * relative), 1, 0.1);
  EXPECT_NEAR(mean(a, "warp_error") / (2 * kNoise * kNoise * relative), 1, 0.1);
  EXPECT_GT(mean(b, "warp_error"), 20 * mean(a, "warp_error"));
  EXPECT_GT(mean(b, "flicker_tracked"), 8 * mean(a, "flicker_tracked"));
  // What looks at no vectors does not change by a bit.
  for (const MetricInfo* m : right.metrics) {
    if (m->needs == MetricNeeds::kMotion || m->needs == MetricNeeds::kTracks) continue;
    EXPECT_EQ(a.find(m->id)->mean.mean, b.find(m->id)->mean.mean) << m->id;
  }
  // Vectors of which only those backward are shifted contradict those forward: there is nothing to go by.
  const CompareResult torn = compare({sticky}, reference("torn", 1, 0));
  EXPECT_TRUE(std::isnan(mean(torn.sides[0], "temporal_compensated")));
  EXPECT_EQ(torn.sides[0].find("temporal_compensated")->coverage[3], 0);
  EXPECT_GT(a.find("temporal_compensated")->coverage[3], 0.9);
}

TEST_F(PlantedFaults, MotionVectorsOfTheTestAreShifted) {
  const auto with_vectors = [&](const std::string& folder, float error) {
    return write(folder, kFirst, kLast, [=](int f) {
      Frame frame = color_frame(sound(f, 1));
      Image v = vectors(kWidth, kHeight, -float(kPan), 0);
      for (int y = 8; y < 16; ++y) {  // of a quarter of the picture
        for (int x = 0; x < kWidth; ++x) v.at(x, y, 0) += error;
      }
      frame.add(layers::motion_backward(), std::move(v));
      return frame;
    });
  };
  const CompareResult r = compare({with_vectors("a", 0), with_vectors("b", 1)}, reference("r"));
  EXPECT_EQ(mean(r.sides[0], "motion_error"), 0);
  EXPECT_EQ(mean(r.sides[1], "motion_error"), 0.25);
  for (const MetricInfo* m : r.metrics) {
    if (m->id == "motion_error") continue;
    EXPECT_EQ(r.sides[0].find(m->id)->mean.mean, r.sides[1].find(m->id)->mean.mean) << m->id;
  }
}

// Samples of a path tracer have heavy tails: here each pixel is the reference times an exponential variable, of mean 1.
// Clamping it at 1 leaves the mean 1 - 1/e.
TEST_F(PlantedFaults, ClampedEstimatorIsBiased) {
  constexpr int kSeeds = 6, kFrames = 8;
  const auto estimates = [&](const std::string& name, int first_seed, float limit) {
    CompareInput group{name, {}};
    for (int s = 0; s < kSeeds; ++s) {
      group.runs.push_back(write_colors(name + "/s" + std::to_string(s), 1, kFrames, [=](int f) {
        return filled(kWidth, kHeight, 3, [=](int x, int y, int) {
          const std::uint64_t bits =
              hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(f), std::uint64_t(first_seed + s));
          const float sample = -std::log(1 - to_unit_float(std::uint32_t(bits >> 32)));
          return pattern(x, y, f) * std::min(sample, limit);
        });
      }));
    }
    return group;
  };
  const CompareResult r =
      compare({estimates("control", 10, kInfinity), estimates("other", 20, kInfinity), estimates("clamped", 10, 1)},
              write_colors("r", 1, kFrames, reference_image));
  const CompareSide &sound_side = r.sides[0], &other = r.sides[1], &fault = r.sides[2];
  const double left = 1 - std::exp(-1.0);
  const double relative = mean_of_reference([](double v) { return v * v / (v * v + 0.01); });

  EXPECT_TRUE(Moved(r, "bias"));
  EXPECT_NEAR(mean(fault, "bias"), left - 1, 0.01);
  EXPECT_TRUE(Moved(r, "bias_squared"));
  EXPECT_NEAR(mean(fault, "bias_squared") / ((1 - left) * (1 - left) * relative), 1, 0.05);
  for (const char* id : {"bias", "bias_squared"}) {
    const auto confidence = [&](const CompareSide& s) { return s.find(id)->mean.confidence_95(); };
    EXPECT_LT(std::abs(mean(sound_side, id)), confidence(sound_side)) << id;
    EXPECT_LT(std::abs(mean(other, id)), confidence(other)) << id;
    EXPECT_GT(std::abs(mean(fault, id)), 5 * confidence(fault)) << id;
  }
  // Clamping is done because it makes pictures less noisy: the plain errors get better and tell nothing.
  EXPECT_LT(mean(fault, "variance"), 0.6 * mean(sound_side, "variance"));
  EXPECT_LT(mean(fault, "relmse"), 0.6 * mean(sound_side, "relmse"));
  EXPECT_LT(mean(fault, "temporal"), 0.6 * mean(sound_side, "temporal"));
  EXPECT_LT(mean(fault, "flicker"), 0.6 * mean(sound_side, "flicker"));
  for (const CompareSide& s : r.sides) {
    EXPECT_NEAR(mean(s, "relmse"), mean(s, "bias_squared") + mean(s, "variance"), 1e-9);
  }
}

}  // namespace
}  // namespace tempera
