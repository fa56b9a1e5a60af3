// SPDX-License-Identifier: Apache-2.0
// Flicker as a display shows it, and comparisons with two references.
#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "sequences.h"
#include "tempera/core/color.h"

namespace tempera {
namespace {

using namespace test;

double mean(const CompareResult& r, std::string_view id, std::size_t side = 0) {
  return r.sides[side].find(id)->mean.mean;
}

// --- Displayed flicker

class DisplayedFlicker : public SequenceTest {
 protected:
  static constexpr int kFrames = 32;
  static constexpr CompareOptions options() { return {.metrics = {"flicker_display", "flicker"}}; }

  /// Gray whose display value in frame t is `level` + a sin(2 pi k t / 32), with a phase for each pixel.
  FrameSequence tone(const std::string& name, float level, float a, int k) {
    return write_colors(name, 0, kFrames - 1, [=](int t) {
      return filled(6, 5, 3, [=](int x, int y, int) {
        const double angle = 2 * std::numbers::pi * double(k) * t / kFrames + x + 6 * y;
        return srgb_to_linear(level + a * float(std::sin(angle)));
      });
    });
  }
};

TEST_F(DisplayedFlicker, OfAToneIsItsRmsAboveTheCutoffAndNothingBelow) {
  const auto still = tone("still", 0.5f, 0, 0);
  for (const int k : {10, 11, 13}) {
    const CompareResult r = compare_sequences({input(tone(fmt::format("k{}", k), 0.5f, 0.1f, k))}, still, options());
    EXPECT_NEAR(mean(r, "flicker_display"), 255 * 0.1 / std::sqrt(2), 0.01) << k;
  }
  for (const int k : {0, 1, 4, 6}) {
    const CompareResult r = compare_sequences({input(tone(fmt::format("k{}", k), 0.5f, 0.1f, k))}, still, options());
    EXPECT_NEAR(mean(r, "flicker_display"), 0, 0.003) << k;
  }
  // The window spreads a tone to its two neighbors, a sixth of its power to each: at the cutoff, 8, one is above.
  const CompareResult at = compare_sequences({input(tone("k8", 0.5f, 0.1f, 8))}, still, options());
  EXPECT_NEAR(mean(at, "flicker_display"), 255 * 0.1 / std::sqrt(12), 0.01);
  CompareOptions lower = options();
  lower.cutoff = 0.1;
  const CompareResult slow = compare_sequences({input(tone("k5", 0.5f, 0.1f, 5))}, still, lower);
  EXPECT_NEAR(mean(slow, "flicker_display"), 255 * 0.1 / std::sqrt(2), 0.01);
}

TEST_F(DisplayedFlicker, IsWhatTheReferenceLacks) {
  const auto fast = tone("fast", 0.5f, 0.1f, 11), still = tone("still", 0.5f, 0, 0);
  EXPECT_EQ(mean(compare_sequences({input(fast)}, fast, options()), "flicker_display"), 0);
  EXPECT_NEAR(mean(compare_sequences({input(still)}, fast, options()), "flicker_display"), 255 * 0.1 / std::sqrt(2),
              0.01)
      << "what should change and does not counts, too";
}

TEST_F(DisplayedFlicker, OfALampThatTheDisplayClipsIsNothing) {
  const auto lamp = write_colors("lamp", 0, kFrames - 1, [](int t) {
    return filled(6, 5, 3, [=](int, int, int c) { return (c == 0 ? 16.0f : 10.0f) * (t % 2 ? 0.8f : 1.2f); });
  });
  const auto reference = write_colors(
      "r", 0, kFrames - 1, [](int) { return filled(6, 5, 3, [](int, int, int c) { return c == 0 ? 16.0f : 10.0f; }); });
  CompareOptions o = options();
  const CompareResult clipped = compare_sequences({input(lamp)}, reference, o);
  EXPECT_EQ(mean(clipped, "flicker_display"), 0);
  EXPECT_GT(mean(clipped, "flicker"), 1);
  o.exposure = -5;  // 0.5 and 0.3125: not clipped any more
  const double high = linear_to_srgb(float((0.212671 * 16 + 0.787329 * 10) * 1.2 / 32)),
               low = linear_to_srgb(float((0.212671 * 16 + 0.787329 * 10) * 0.8 / 32));
  EXPECT_NEAR(mean(compare_sequences({input(lamp)}, reference, o), "flicker_display"), 255 * (high - low) / 2, 0.05);
}

TEST_F(DisplayedFlicker, IsShownFirstWithItsSpectrum) {
  const auto a = tone("a", 0.5f, 0.1f, 11), b = tone("b", 0.5f, 0.2f, 11), still = tone("still", 0.5f, 0, 0);
  const CompareResult r = compare_sequences({input(a), {"both", {a, b}}}, still);
  ASSERT_FALSE(r.metrics.empty());
  EXPECT_EQ(r.metrics[0]->id, "flicker_display");
  const std::string table = to_table(r);
  EXPECT_LT(table.find("displayed flicker [1/255]"), table.find("relMSE")) << table;
  EXPECT_NEAR(mean(r, "flicker_display", 1), 255 * std::sqrt((0.01 + 0.04) / 4), 0.02)
      << "of the mean power of the runs";
  // Half of the difference of the powers, 0.03 / 2 / 2, times the slope of the root.
  EXPECT_NEAR(r.sides[1].find("flicker_display")->mean.standard_error, 255 * 0.0075 / (2 * std::sqrt(0.0125)), 0.02);
  const ResidualSpectrum& s = r.sides[0].spectra[0];
  EXPECT_EQ(s.id, "flicker_display");
  double above = 0;
  for (std::size_t k = 0; k < s.power.size(); ++k) above += s.frequency[k] > 0.25 ? s.power[k] : 0;
  EXPECT_NEAR(std::sqrt(above), mean(r, "flicker_display"), 1e-6) << "in the same unit";
}

TEST_F(DisplayedFlicker, OfWhiteNoiseIsHalfOfItsVariance) {
  const auto noisy = write_colors("noisy", 0, 9, [](int t) {
    return filled(64, 48, 1, [=](int x, int y, int) { return srgb_to_linear(0.5f + 0.02f * normal(x, y, t, 4)); });
  });
  const auto still = write_colors("still", 0, 9, [](int) { return Image(64, 48, 1, srgb_to_linear(0.5f)); });
  // Of ten frames, frequencies 3, 4 and 5 of 0 to 5 are above a quarter: 5 of 10 with both signs.
  EXPECT_NEAR(mean(compare_sequences({input(noisy)}, still, options()), "flicker_display"), 255 * 0.02 * std::sqrt(0.5),
              0.05);
}

TEST_F(DisplayedFlicker, NeedsEightFrames) {
  const auto a = write_colors("a", 1, 7, [](int) { return Image(4, 4, 3, 0.5f); });
  try {
    compare_sequences({input(a)}, a, options());
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
    EXPECT_EQ(e.message(), "\"flicker_display\" cannot be measured: it needs 8 frames in a row; there are 7");
  }
  EXPECT_EQ(compare_sequences({input(a)}, a).sides[0].find("flicker_display"), nullptr);
}

// --- Two references

class TwoReferences : public SequenceTest {
 protected:
  static constexpr int kFrames = 10, kWidth = 64, kHeight = 48;
  static float truth(int x, int y, int t, int c) {
    return 0.2f + 0.01f * float((x + t) % 32) + 0.004f * float(y) + 0.05f * float(c);
  }
  /// Frames 1 to 10 of the truth with noise of a deviation and a key.
  FrameSequence noisy(const std::string& name, float deviation, int key) {
    return write(name, 1, kFrames, [=](int t) {
      Frame frame = color_frame(filled(kWidth, kHeight, 3, [=](int x, int y, int c) {
        return truth(x, y, t, c) + deviation * normal(x, y, 3 * t + c, key);
      }));
      frame.add(layers::motion_backward(), vectors(kWidth, kHeight, -1, 0));
      frame.add(layers::motion_forward(), vectors(kWidth, kHeight, 1, 0));
      return frame;
    });
  }
  CompareResult compare(const std::vector<CompareInput>& tests, const FrameSequence& first, const std::string& second,
                        std::vector<std::string> metrics = {"all"}, double trim = 0) {
    return compare_sequences(tests, first, {.metrics = std::move(metrics), .trim = trim, .reference2 = second});
  }
};

TEST_F(TwoReferences, TheirNoiseIsTakenOutOfAllSquaredMetrics) {
  const auto a = noisy("a", 0.05f, 1), b = noisy("b", 0.03f, 2), exact = noisy("truth", 0, 3);
  const CompareInput runs{"runs", {noisy("x1", 0.02f, 4), noisy("x2", 0.02f, 5), noisy("x3", 0.02f, 6)}};
  std::vector<std::string> metrics{"variance"};
  for (const MetricInfo& m : metric_catalog()) {
    if (m.squared) metrics.emplace_back(m.id);
  }
  const CompareResult known = compare({runs}, exact, "", metrics), one = compare({runs}, a, "", metrics),
                      two = compare({runs}, a, b.pattern(), metrics);
  int squared = 0;
  for (const MetricInfo* m : known.metrics) {
    if (!m->squared) continue;
    ++squared;
    const double expected = mean(known, m->id), estimate = mean(two, m->id);
    if (m->id == "bias_squared") {  // there is none, and the noise of one reference looks like one
      EXPECT_LT(std::abs(estimate), 0.05 * mean(one, m->id)) << estimate;
    } else if (m->id == "psnr") {
      EXPECT_NEAR(estimate, expected, 0.4);
      EXPECT_LT(mean(one, m->id), expected - 5);
    } else {
      EXPECT_NEAR(estimate / expected, 1, 0.1) << m->id;
      EXPECT_GT(mean(one, m->id) / expected, m->id == "flicker_display" ? 2 : 4) << m->id;
    }
  }
  EXPECT_EQ(squared, 10);
  EXPECT_NEAR(mean(two, "variance") / mean(known, "variance"), 1, 0.03) << "the reference is in its weights alone";
  EXPECT_NEAR(mean(two, "relmse"), mean(two, "bias_squared") + mean(two, "variance"), 1e-6);
  // Of the mean of both: a quarter of the sum of the variances, relative to the squared truth.
  double weight = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) weight += 1 / (std::pow(truth(x, y, 0, c), 2) + 0.01) / (3 * kWidth * kHeight);
    }
  }
  EXPECT_NEAR(two.reference_error.mean / (weight * (0.0025 + 0.0009) / 4), 1, 0.05);
}

TEST_F(TwoReferences, AreTheFormulaOfThreeComparisons) {
  const auto a = noisy("a", 0.05f, 1), b = noisy("b", 0.03f, 2), x = noisy("x", 0.04f, 4);
  const std::vector<std::string> metrics{"mse", "flicker", "flicker_tracked"};  // whose weights hold no reference
  const CompareResult two = compare({input(x)}, a, b.pattern(), metrics), xa = compare({input(x)}, a, "", metrics),
                      xb = compare({input(x)}, b, "", metrics), ab = compare({input(a)}, b, "", metrics);
  for (std::size_t m = 0; m < metrics.size(); ++m) {
    const auto& id = metrics[m];
    EXPECT_NEAR(mean(two, id), (mean(xa, id) + mean(xb, id) - mean(ab, id)) / 2, 1e-4 * mean(xa, id)) << id;
    EXPECT_NEAR(two.reference_noise[m], mean(ab, id) / 4, 1e-4 * mean(ab, id)) << id;
  }
  const auto of_frame = [](const CompareResult& r, std::size_t f) { return r.sides[0].find("mse")->values[f]; };
  for (std::size_t f = 0; f < std::size_t(kFrames); ++f) {
    EXPECT_NEAR(of_frame(two, f), (of_frame(xa, f) + of_frame(xb, f) - of_frame(ab, f)) / 2, 1e-7);
  }
  const auto power = [](const CompareResult& r, std::size_t k) { return r.sides[0].spectra[0].power[k]; };
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_NEAR(power(two, k), (power(xa, k) + power(xb, k) - power(ab, k)) / 2, 1e-8) << "at each frequency";
  }
}

TEST_F(TwoReferences, MetricsThatAreNotSquaredUseTheirMean) {
  const auto a = write_colors("a", 1, 2, [](int) { return Image(16, 12, 3, 0.2f); });
  const auto b = write_colors("b", 1, 2, [](int) { return Image(16, 12, 4, 0.6f); });
  const auto x = write_colors("x", 1, 2, [](int) { return Image(16, 12, 3, 0.5f); });
  const auto both = write_colors("both", 1, 2, [](int) { return Image(16, 12, 3, 0.4f); });
  const std::vector<std::string> metrics{"bias", "ssim", "flip", "hdr_flip", "mse"};
  const CompareResult two = compare({input(x)}, a, b.pattern(), metrics), one = compare({input(x)}, both, "", metrics);
  EXPECT_NEAR(mean(two, "bias"), 0.25, 1e-6);
  EXPECT_NEAR(mean(two, "flip"), mean(one, "flip"), 1e-6);
  EXPECT_NEAR(mean(two, "hdr_flip"), mean(one, "hdr_flip"), 1e-6);
  EXPECT_NEAR(mean(two, "mse"), 0.01 - 0.04, 1e-6) << "may be below 0, or its mean would not be right";
  // Of what is displayed, the mean is that of the display values.
  const double shown = (linear_to_srgb(0.2f) + linear_to_srgb(0.6f)) / 2, test = linear_to_srgb(0.5f);
  EXPECT_NEAR(mean(two, "ssim"), (2 * shown * test + 1e-4) / (shown * shown + test * test + 1e-4), 3e-5);
}

TEST_F(TwoReferences, WithoutNoiseNothingChanges) {
  const auto exact = noisy("truth", 0, 3), same = noisy("same", 0, 3), x = noisy("x", 0.02f, 4);
  const CompareResult two = compare({input(x)}, exact, same.pattern()), one = compare({input(x)}, exact, "");
  for (const MetricInfo* m : one.metrics) EXPECT_NEAR(mean(two, m->id), mean(one, m->id), 1e-9) << m->id;
  EXPECT_NE(to_table(two).find("The two references are equal"), std::string::npos) << to_table(two);
  const CompareResult perfect = compare({input(same)}, exact, x.pattern());
  EXPECT_EQ(mean(perfect, "flicker_display"), 0) << "the root of less than 0";
  EXPECT_EQ(mean(perfect, "psnr"), INFINITY);
}

TEST_F(TwoReferences, TrimmedErrorsLeaveOutTheFirefliesOfTheReferences) {
  const auto fireflies = [&](const std::string& name, int at, int key) {
    return write_colors(name, 1, 2, [=](int t) {
      Image image = filled(kWidth, kHeight, 3, [=](int x, int y, int c) {
        return truth(x, y, t, c) + 0.05f * normal(x, y, 3 * t + c, key);
      });
      image.set_rgb(at, at, Rgb(1000.0f));
      return image;
    });
  };
  const auto a = fireflies("a", 3, 1), b = fireflies("b", 9, 2);
  const auto x = noisy("x", 0.02f, 4);
  const auto exact = noisy("truth", 0, 3);
  const double expected = mean(compare({input(x)}, exact, "", {"mse"}), "mse");
  EXPECT_NEAR(mean(compare({input(x)}, a, b.pattern(), {"mse"}, 0.002), "mse") / expected, 1, 0.15);
}

TEST_F(TwoReferences, APartOfThePictureIsComparedByItself) {
  // An object that moves along by a pixel a frame and is not there in the last one. Errors are 0.1 on it and 3 around.
  const auto on = [](int x, int y, int t) { return t < 3 && x >= 8 + t && x < 24 + t && y >= 10 && y < 30; };
  const auto make = [&](const std::string& name, float object, float around) {
    return write(name, 1, 3, [=](int t) {
      Frame frame = color_frame(filled(kWidth, kHeight, 3, [=](int x, int y, int) {
        return 1 + (on(x, y, t) ? (x % 2 ? object : -object) : around) * float(t);
      }));
      frame.add(layers::object_id(),
                filled(kWidth, kHeight, 1, [=](int x, int y, int) { return on(x, y, t) ? 9.f : 4.f; }));
      frame.add(layers::motion_backward(), vectors(kWidth, kHeight, -1, 0));
      return frame;
    });
  };
  const auto a = make("a", 0, 0.01f), b = make("b", 0, -0.01f), x = make("x", 0.1f, 3);
  CompareOptions options{
      .metrics = {"mse", "relmse", "temporal_compensated"}, .reference2 = b.pattern(), .where = Region{"object_id", 9}};
  const CompareResult r = compare_sequences({input(x)}, a, options);
  const auto& mse = r.sides[0].find("mse")->values;
  EXPECT_NEAR(mse[0], 0.01, 1e-6);
  EXPECT_NEAR(mse[1], 0.04, 1e-6);
  EXPECT_TRUE(std::isnan(mse[2])) << "the object is not there";
  EXPECT_NEAR(mean(r, "mse"), 0.025, 1e-6);
  EXPECT_NEAR(mean(r, "relmse"), 0.025 / 1.01, 1e-6);
  // The signs follow the columns, not the object: along motion -0.1 becomes 0.2 and the other way round.
  EXPECT_NEAR(mean(r, "temporal_compensated"), 0.09 / 1.01, 1e-6);
  EXPECT_NEAR(r.reference_noise[1], 0, 1e-9) << "that of the object";
  EXPECT_EQ(r.sides[0].non_finite, std::vector<std::int64_t>(3, 0));
  EXPECT_NE(to_table(r).find("Only the pixels where object_id is 9 count, 6.9 % of all."), std::string::npos)
      << to_table(r);

  const auto message = [&](const CompareOptions& o) {
    try {
      compare_sequences({input(x)}, a, o);
    } catch (const Error& e) {
      return e.message();
    }
    return std::string();
  };
  EXPECT_EQ(message({.metrics = {"flip"}, .where = Region{"object_id", 9}}),
            "\"flip\" cannot be measured: of a part of the picture only squared errors are measured");
  EXPECT_EQ(message({.where = Region{"object_id", 5}}),
            "no pixel of the reference " + a.pattern() + " has object_id = 5: there is nothing to compare");
  // The layer may be the one that is compared, or of the motion that is followed.
  EXPECT_EQ(message({.where = Region{"color", 5}}),
            "no pixel of the reference " + a.pattern() + " has color = 5: there is nothing to compare");
  options.where = Region{"motion.backward", -1};
  options.metrics = {"mse"};
  EXPECT_NEAR(mean(compare_sequences({input(x)}, a, options), "mse"), 9 * (1 + 4 + 9) / 3.0, 3);
  EXPECT_EQ(
      message({.where = Region{"depth", 5}}),
      "the reference " + a.pattern() + " has no layer depth, which is to tell the part of the picture to compare");
}

TEST_F(TwoReferences, AStillPictureServesAllFrames) {
  const auto still = [&](const std::string& name, int key) {
    return write_colors(name, 1, 1, [=](int) {
      return filled(kWidth, kHeight, 3, [=](int x, int y, int c) { return 0.5f + 0.03f * normal(x, y, c, key); });
    });
  };
  const auto a = still("a", 1), b = still("b", 2);
  const auto x = write_colors("x", 1, 8, [](int t) {
    return filled(kWidth, kHeight, 3, [=](int i, int j, int c) { return 0.5f + 0.05f * normal(i, j, 3 * t + c, 4); });
  });
  const CompareResult r = compare({input(x)}, a, b.pattern(), {"mse", "temporal", "flicker"});
  EXPECT_NEAR(mean(r, "mse"), 0.0025, 0.0004);
  EXPECT_NEAR(mean(r, "temporal") / (2 * 0.0025 / 0.26), 1, 0.06) << "its noise does not change over time";
}

TEST_F(TwoReferences, WhatDoesNotFitIsAnError) {
  const auto a = noisy("a", 0, 1), b = noisy("b", 0, 2);
  const auto fails = [&](const FrameSequence& first, const std::string& second, ErrorCode code,
                         const std::string& what) {
    try {
      compare({input(a)}, first, second, {"mse"});
      ADD_FAILURE() << "no Error was thrown; expected: " << what;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.message();
      EXPECT_EQ(e.message(), what);
    }
  };
  std::filesystem::remove(b.path(4));
  fails(a, b.pattern(), ErrorCode::kBadInput,
        fmt::format("the second reference {} lacks frame 4, which {} has", b.pattern(), a.pattern()));
  const auto small = write_colors("small", 1, kFrames, [](int) { return Image(kWidth, 7, 3); });
  fails(a, small.pattern(), ErrorCode::kBadInput,
        fmt::format("the second reference {} has 64x7 pixels, the first, {}, has 64x48", small.path(1), a.path(1)));
  const auto still = write_colors("still", 1, 1, [](int) { return Image(kWidth, kHeight, 3); });
  fails(a, still.pattern(), ErrorCode::kBadInput,
        fmt::format("the second reference {} is a single picture, the first, {}, is a sequence of 10 frames",
                    still.pattern(), a.pattern()));
  fails(a, path("a"), ErrorCode::kBadInput,
        fmt::format("the second reference {} is the first one again ({}); it has to be rendered with another seed",
                    FrameSequence(path("a")).pattern(), a.path(1)));
  const auto data = write("data", 1, kFrames, [](int) {
    Frame frame(kWidth, kHeight);
    frame.create(layers::depth());
    return frame;
  });
  try {
    compare({input(a)}, a, data.pattern(), {"mse"});
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
    EXPECT_NE(e.message().find("color"), std::string::npos) << e.message();
  }
}

TEST_F(TwoReferences, FilesSayWhatWasTakenOut) {
  const auto a = noisy("a", 0.05f, 1), b = noisy("b", 0.05f, 2), x = noisy("x", 0.1f, 4);
  const CompareResult r = compare({input(x)}, a, b.pattern(), {"mse", "flip"});
  const nlohmann::json j = nlohmann::json::parse(to_json(r));
  EXPECT_EQ(j["reference"], a.pattern());
  EXPECT_EQ(j["reference2"], b.pattern());
  EXPECT_TRUE(j["metrics"][0]["noise_removed"]);
  EXPECT_FALSE(j["metrics"][1]["noise_removed"]);
  EXPECT_NEAR(j["reference_noise"]["mse"].get<double>(), 0.0025 / 2, 2e-5);
  EXPECT_EQ(j["reference_noise"].size(), 1u) << "FLIP is not squared";
  EXPECT_TRUE(nlohmann::json::parse(to_json(compare({input(x)}, a, "", {"mse"})))["reference2"].is_null());
  const std::string csv = to_csv(r), table = to_table(r);
  EXPECT_NE(csv.find(fmt::format("\nreference,noise,{},,\n", r.reference_noise[0])), std::string::npos) << csv;
  EXPECT_TRUE(table.starts_with(fmt::format("References: {} and {}, layer color", a.pattern(), b.pattern()))) << table;
  EXPECT_NE(table.find("The noise of the two references is taken out of MSE.\n"), std::string::npos) << table;
}

}  // namespace
}  // namespace tempera
