// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/compare.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "sequences.h"
#include "tempera/core/color.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

using namespace test;

class Compare : public SequenceTest {
 protected:
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
};

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

template <class F>
void expect_error(ErrorCode code, const std::string& message, F&& body) {
  try {
    body();
    ADD_FAILURE() << "no Error was thrown; expected: " << message;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code) << e.message();
    EXPECT_EQ(e.message(), message);
  }
}

TEST_F(Compare, MetricsThatLackWhatTheyNeedAreErrorsOnlyIfTheyAreNamed) {
  const auto a = write("a", {1, 2}, 1), reference = write("r", {1, 2}, 1);
  const auto compare = [&](std::vector<std::string> metrics) {
    CompareOptions options;
    options.metrics = std::move(metrics);
    return compare_sequences({input(a)}, reference, options);
  };
  std::vector<std::string_view> ids;
  for (const MetricInfo* m : compare({"all"}).metrics) ids.push_back(m->id);
  EXPECT_EQ(ids, (std::vector<std::string_view>{"relmse", "relmse_gray", "mse", "bias", "psnr", "flip", "hdr_flip",
                                                "temporal", "flicker_static"}));
  const auto bad = ErrorCode::kBadInput;
  expect_error(bad, "\"flicker\" cannot be measured: it needs 8 frames in a row; there are 2", [&] {
    compare({"default", "flicker"});
  });
  expect_error(
      bad,
      "\"warp_error\" cannot be measured: it needs the layer motion.backward, which " + reference.pattern() + " lacks",
      [&] { compare({"warp_error"}); });
  expect_error(bad, "\"variance\" cannot be measured: it needs several runs of a method, as \"out/seed*/f.####.exr\"",
               [&] { compare({"variance"}); });
  expect_error(bad, "\"ssim\" cannot be measured: it needs a picture of 11x11 pixels", [&] { compare({"ssim"}); });
  expect_error(ErrorCode::kUnknownName,
               "unknown metric \"relmsee\"; known: relmse, mse, relmse_gray, bias, psnr, ssim, flip, flicker, ...",
               [&] { compare({"relmsee"}); });
  CompareOptions one;
  one.frames = {2}, one.metrics = {"temporal"};
  expect_error(bad, "\"temporal\" cannot be measured: it needs two frames, one after the other",
               [&] { compare_sequences({input(a)}, reference, one); });
}

TEST_F(Compare, OptionsHaveRanges) {
  const auto a = write("a", {1}, 1);
  const auto with = [&](auto&& change) {
    CompareOptions options;
    change(options);
    compare_sequences({input(a)}, a, options);
  };
  expect_error(ErrorCode::kOutOfRange, "trim is 0.6; it has to be a part of the pixels from 0 to 0.5",
               [&] { with([](CompareOptions& o) { o.trim = 0.6; }); });
  expect_error(ErrorCode::kOutOfRange, "cutoff is 0.5; it has to be between 0 and 0.5 cycles per frame",
               [&] { with([](CompareOptions& o) { o.cutoff = 0.5; }); });
  expect_error(ErrorCode::kOutOfRange, "epsilon is 0; it has to be above 0",
               [&] { with([](CompareOptions& o) { o.epsilon = 0; }); });
  expect_error(ErrorCode::kBadInput, "there is nothing to compare with the reference",
               [&] { compare_sequences({}, a); });
}

TEST_F(Compare, GroupsOfRuns) {
  for (const char* name : {"seed1", "seed2", "seed10"}) {
    const float value = name == std::string("seed10") ? 4 : 2;
    for (const int f : {1, 2})
      write_frame(path(name) + fmt::format("/f.{:04}.exr", f), color_frame(Image(8, 6, 3, value)));
  }
  std::filesystem::create_directories(path("seed_notes"));
  const auto reference = write("r", {1, 2}, 1);
  const CompareInput group = parse_compare_input(path("seed*/f.####.exr"));
  ASSERT_EQ(group.runs.size(), 3u);
  EXPECT_EQ(group.runs[0].pattern(), path("seed1/f.####.exr"));
  EXPECT_EQ(group.runs[1].pattern(), path("seed10/f.####.exr"));
  EXPECT_EQ(group.name, path("seed*/f.####.exr"));
  CompareOptions options;
  options.metrics = {"mse", "bias", "bias_squared", "variance"};
  const CompareResult r = compare_sequences({group}, reference, options);
  const CompareSide& side = r.sides[0];
  ASSERT_EQ(side.runs.size(), 3u);
  EXPECT_EQ(side.frames, (std::vector<int>{1, 2}));
  // Errors 1, 1 and 3.
  const MetricSeries& mse = *side.find("mse");
  EXPECT_NEAR(mse.mean.mean, 11.0 / 3, 1e-6);
  EXPECT_NEAR(mse.values[1], 11.0 / 3, 1e-6);
  EXPECT_NEAR(mse.mean.standard_error, 8 / 3.0, 1e-6) << "over the runs: deviation 8 / sqrt(3) over sqrt(3)";
  EXPECT_EQ(mse.mean.count, 3);
  EXPECT_NEAR(side.find("bias")->mean.mean, 5 / 3.0, 1e-6);
  EXPECT_NEAR(side.find("bias_squared")->mean.mean, 7 / 3.0 / 1.01, 1e-6);
  EXPECT_NEAR(side.find("variance")->mean.mean, 4 / 3.0 / 1.01, 1e-6);
  EXPECT_EQ(side.find("variance")->mean.count, 3);
  EXPECT_NE(to_table(r).find("confidence of the mean over runs\n"), std::string::npos);
  expect_error(ErrorCode::kMissingFile, "no pictures or frames match " + path("sead*/f.####.exr"),
               [&] { parse_compare_input(path("sead*/f.####.exr")); });
}

TEST_F(Compare, NamesAndPlacesOfTheStar) {
  const auto names = [](const CompareInput& input) {
    std::vector<std::string> out;
    for (const FrameSequence& r : input.runs) out.push_back(std::filesystem::path(r.pattern()).filename().string());
    return out;
  };
  write("s1", {1, 2}, 1), write("s2", {1, 2}, 1), write("t3", {1}, 1);
  EXPECT_EQ(names(parse_compare_input(path("s*.####.exr"))), (std::vector<std::string>{"s1.####.exr", "s2.####.exr"}));
  EXPECT_EQ(names(parse_compare_input(path("*.%04d.exr"))).size(), 3u);
  const CompareInput pictures = parse_compare_input(path("s*.0001.exr"));
  EXPECT_EQ(names(pictures), (std::vector<std::string>{"s1.0001.exr", "s2.0001.exr"}));
  EXPECT_EQ(compare_sequences({pictures}, FrameSequence(path("t3.0001.exr"))).sides[0].frames, std::vector<int>{1});

  const auto folder = std::filesystem::current_path();
  std::filesystem::current_path(path(""));
  EXPECT_EQ(parse_compare_input("mine=s1.####.exr").name, "mine");
  EXPECT_EQ(parse_compare_input("mine=s1.####.exr").runs[0].pattern(), "s1.####.exr");
  EXPECT_EQ(parse_compare_input("mine=s*.####.exr").runs.size(), 2u);
  write("a=b", {1}, 1);
  EXPECT_EQ(parse_compare_input("a=b.####.exr").name, "a=b.####.exr") << "that is what it is called";
  std::filesystem::current_path(folder);
}

TEST_F(Compare, SinglePicturesMakeAGroupWhateverTheirNumbers) {
  for (const int seed : {7, 8}) {
    write_frame(path(fmt::format("s{}.exr", seed)), color_frame(Image(8, 6, 3, float(seed))));
  }
  const CompareInput group = parse_compare_input(path("s*.exr"));
  const CompareResult r = compare_sequences({group}, FrameSequence(path("s7.exr")));
  EXPECT_NEAR(r.sides[0].find("mse")->mean.mean, 0.5, 1e-6);
  write("t1", {1}, 1), write("t2", {2}, 1);
  const CompareInput apart = parse_compare_input(path("t*.####.exr"));
  expect_error(ErrorCode::kBadInput, "the runs of " + apart.name + " have no frame in common",
               [&] { compare_sequences({apart}, FrameSequence(path("s7.exr"))); });
}

TEST_F(Compare, ObserversSeeWhatIsInMemory) {
  const auto reference = SequenceTest::write("r", 1, 3, [](int f) {
    Frame frame = color_frame(Image(16, 12, 3, float(f)));
    frame.add(layers::motion_backward(), vectors(16, 12, 1, 0));
    return frame;
  });
  const auto a = write_colors("a", 1, 3, [](int) { return Image(16, 12, 3, 2.0f); });
  const auto b = write_colors("b", 2, 3, [](int) { return Image(16, 12, 3, 0.0f); });
  struct Watcher final : CompareObserver {
    std::vector<std::string> maps() const override { return {"mse", "temporal_compensated"}; }
    bool motion() const override { return true; }
    void reference(int frame, const Image& image, const Image* backward, const Image* forward) override {
      seen += fmt::format("r{} {} ", frame, image.at(3, 3));
      ASSERT_NE(backward, nullptr);
      EXPECT_EQ(backward->at(0, 0), 1);
      EXPECT_EQ(forward, nullptr);
    }
    void test(std::size_t side, int frame, const Image& image,
              const std::function<const Image*(std::string_view)>& map) override {
      seen += fmt::format("{}{} {} ", side, frame, image.at(3, 3));
      ASSERT_NE(map("mse"), nullptr);
      EXPECT_NEAR(map("mse")->at(4, 4), (image.at(0, 0) - float(frame)) * (image.at(0, 0) - float(frame)), 1e-6);
      const Image* temporal = map("temporal_compensated");
      EXPECT_EQ(temporal != nullptr, frame > 1 && !(side == 1 && frame == 2)) << side << " " << frame;
      EXPECT_EQ(map("flip"), nullptr) << "nobody asked for it";
    }
    std::string seen;
  } watcher;
  CompareOptions options;
  options.metrics = {"flip"};  // the maps are of others
  const CompareResult r = compare_sequences({input(a), input(b)}, reference, options, {}, &watcher);
  EXPECT_EQ(watcher.seen, "r1 1 01 2 r2 2 02 2 12 0 r3 3 03 2 13 0 ");
  EXPECT_EQ(r.metrics.size(), 1u);
}

TEST_F(Compare, VectorsMayComeFromOtherFiles) {
  const auto picture = [](int f) {
    return filled(24, 12, 3, [=](int x, int, int) { return std::sin(float(x - 2 * f)); });
  };
  const auto reference = write_colors("r", 1, 3, picture), a = write_colors("a", 1, 3, picture);
  SequenceTest::write("v", 1, 3, [](int) {
    Frame frame(24, 12);
    frame.add(layers::motion_backward(), vectors(24, 12, -2, 0));
    return frame;
  });
  CompareOptions options;
  options.metrics = {"warp_error"};
  options.motion = path("v/f.####.exr");
  const CompareResult r = compare_sequences({input(a)}, reference, options);
  EXPECT_NEAR(r.sides[0].find("warp_error")->mean.mean, 0, 1e-9);
  EXPECT_TRUE(std::isnan(r.sides[0].find("warp_error")->values[0])) << "nothing is before the first frame";
  EXPECT_NEAR(r.sides[0].find("warp_error")->coverage[1], 22.0 / 24, 1e-12);
}

TEST_F(Compare, TheReferencesOwnErrorFollowsFromItsHalves) {
  const auto reference = SequenceTest::write("r", 1, 2, [](int) {
    Frame frame = color_frame(Image(8, 6, 3, 1.0f));
    frame.add(layers::color_a(), Image(8, 6, 3, 1.1f));
    frame.add(layers::color_b(), Image(8, 6, 3, 0.9f));
    return frame;
  });
  const CompareResult r = compare_sequences({input(write("a", {1, 2}, 1))}, reference);
  EXPECT_NEAR(r.reference_error.mean, 0.01 / 1.01, 1e-6);
  EXPECT_NE(to_table(r).find("The reference's own relMSE is about 0.0099."), std::string::npos) << to_table(r);
  EXPECT_TRUE(std::isnan(compare_sequences({input(write("b", {1}, 1))}, write("s", {1}, 1)).reference_error.mean));
}

TEST_F(Compare, SpectraKeepToTheirMemory) {
  const auto noisy = [](int f) { return filled(64, 48, 1, [=](int x, int y, int) { return normal(x, y, f, 3); }); };
  const auto a = write_colors("a", 1, 16, noisy);
  const auto reference = write_colors("r", 1, 1, [](int) { return Image(64, 48, 1); });
  CompareOptions options;
  options.metrics = {"flicker"};
  const CompareResult all = compare_sequences({input(a)}, reference, options);
  options.spectrum_memory = 64 * 48 * 16 * 4 / 4;
  const CompareResult quarter = compare_sequences({input(a)}, reference, options);
  EXPECT_EQ(all.sides[0].spectra[0].coverage, 1);
  EXPECT_EQ(quarter.sides[0].spectra[0].coverage, 0.25);
  EXPECT_TRUE(all.notes.empty());
  ASSERT_EQ(quarter.notes.size(), 1u);
  EXPECT_EQ(quarter.notes[0], "Flicker was measured at one pixel of each 2x2, to save memory.");
  EXPECT_NEAR(all.sides[0].find("flicker")->mean.mean, 7.0 / 16, 0.02);
  EXPECT_NEAR(quarter.sides[0].find("flicker")->mean.mean, 7.0 / 16, 0.04);
  EXPECT_NEAR(compare_sequences({input(a)}, reference, {.metrics = {"flicker"}, .cutoff = 0.125})
                  .sides[0]
                  .find("flicker")
                  ->mean.mean,
              11.0 / 16, 0.03);
}

TEST_F(Compare, LongSequencesHaveTheSameSpectrum) {  // in segments, whose number does not change the power
  const auto noisy = [](int f) { return filled(24, 16, 1, [=](int x, int y, int) { return normal(x, y, f, 3); }); };
  const auto a = write_colors("a", 1, 100, noisy);
  const auto reference = write_colors("r", 1, 1, [](int) { return Image(24, 16, 1); });
  const CompareResult r = compare_sequences({input(a)}, reference, {.metrics = {"flicker"}});
  EXPECT_EQ(r.sides[0].spectra[0].segments, 3);
  EXPECT_EQ(r.sides[0].spectra[0].segment_frames, 50);
  EXPECT_NEAR(r.sides[0].find("flicker")->mean.mean, 0.5, 0.03);
}

TEST_F(Compare, SameBitsOnAnyNumberOfThreads) {
  const auto make = [&](const std::string& name, int key) {
    return SequenceTest::write(name, 1, 9, [=](int f) {
      Frame frame =
          color_frame(filled(61, 37, 3, [=](int x, int y, int c) { return 1 + 0.3f * normal(x, y, 3 * f + c, key); }));
      frame.add(layers::motion_backward(), vectors(61, 37, -1.5f, 0.5f));
      frame.add(layers::motion_forward(), vectors(61, 37, 1.5f, -0.5f));
      return frame;
    });
  };
  const CompareInput group{"group", {make("a", 1), make("b", 2), make("c", 3)}};
  const auto reference = make("r", 4);
  std::string one, seven;
  const auto all = [&] { return to_json(compare_sequences({group}, reference, {.metrics = {"all"}, .trim = 0.001})); };
  with_threads(1, [&] { one = all(); });
  with_threads(7, [&] { seven = all(); });
  EXPECT_EQ(one, seven);
  EXPECT_EQ(nlohmann::json::parse(one)["metrics"].size(), metric_catalog().size()) << "every metric was measured";
}

TEST_F(Compare, TrimmingIsStatedWhereverFiguresAre) {
  const auto a = write("a", {1, 2}, 2), reference = write("r", {1, 2}, 1);
  const CompareResult r = compare_sequences({input(a)}, reference, {.metrics = {"mse", "psnr"}, .trim = 0.001});
  EXPECT_EQ(to_csv(r).substr(0, to_csv(r).find('\n')), "name,frame,mse[without 0.1%],psnr,non_finite");
  const auto j = nlohmann::json::parse(to_json(r));
  EXPECT_EQ(j["metrics"][0]["trim"], 0.001);
  EXPECT_EQ(j["metrics"][1]["trim"], 0);
  EXPECT_NE(to_table(r).find("The 0.1 % of the pixels with the largest errors are left out of MSE.\n"),
            std::string::npos);
}

TEST_F(Compare, PsnrOfASequenceIsThatOfItsMeanError) {
  const auto a = write("a", {1, 2, 3}, 0, 0.25f);  // display values of 0.25, 0.5 and 0.75
  const auto reference = write("r", {1, 2, 3}, 0);
  const CompareResult r = compare_sequences({input(a)}, reference, {.metrics = {"psnr"}});
  double sum = 0;
  for (int f = 1; f <= 3; ++f) {
    const double d = linear_to_srgb(0.25f * float(f));
    EXPECT_NEAR(r.sides[0].find("psnr")->values[f - 1], -20 * std::log10(d), 1e-3);
    sum += d * d / 3;
  }
  EXPECT_NEAR(r.sides[0].find("psnr")->mean.mean, -10 * std::log10(sum), 1e-3);
  const MeanError same = compare_sequences({input(a)}, a, {.metrics = {"psnr"}}).sides[0].find("psnr")->mean;
  EXPECT_EQ(same.mean, INFINITY);
}

TEST(MetricCatalog, IsWellFormedAndDocumented) {
  std::ifstream file(std::string(TEMPERA_SOURCE_DIR) + "/docs/metrics.md");
  const std::string page((std::istreambuf_iterator<char>(file)), {});
  ASSERT_FALSE(page.empty());
  for (const MetricInfo& m : metric_catalog()) {
    EXPECT_EQ(find_metric(m.id), &m);
    EXPECT_EQ(m.id.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_"), std::string_view::npos) << m.id;
    EXPECT_FALSE(m.title.empty() || m.help.empty() || m.formula.empty()) << m.id;
    EXPECT_NE(page.find(fmt::format("\n### `{}`", m.id)), std::string::npos)
        << m.id << " has no section in docs/metrics.md";
  }
  EXPECT_EQ(find_metric("nothing"), nullptr);
}

TEST(MetricCatalog, WorseDependsOnTheMetric) {
  const MetricInfo &error = get_metric("mse"), &likeness = get_metric("ssim"), &bias = get_metric("bias");
  EXPECT_TRUE(is_worse(error, 2, 1));
  EXPECT_FALSE(is_worse(error, 1, 1));
  EXPECT_TRUE(is_worse(likeness, 0.8, 0.9));
  EXPECT_FALSE(is_worse(likeness, 0.9, 0.9));
  EXPECT_TRUE(is_worse(bias, -0.2, 0.1));
  EXPECT_FALSE(is_worse(bias, -0.1, 0.1));
  for (const MetricInfo* m : {&error, &likeness, &bias}) EXPECT_TRUE(is_worse(*m, kUndefined, 1e9)) << m->id;
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
  r.width = 8, r.height = 6;
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
            "Reference: ref, layer color, 8x6 pixels\n"
            "                       a         other\n"
            "frames                 2             2\n"
            "MSE                    1  ± 6.4      1  ± 6.4  1.000x\n"
            "relMSE               0.5  ± 3.2   0.25  ± 3.2  0.500x\n"
            "FLIP               0.375         0.375         1.000x\n"
            "non-finite pixels      3             3\n"
            "±: 95 % confidence of the mean over frames\n"
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
