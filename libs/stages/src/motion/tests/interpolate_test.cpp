// SPDX-License-Identifier: Apache-2.0
// The stage interpolate on cards that are known at any time.
#include <gtest/gtest.h>

#include "motion/tests/moving_pictures.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/stages/stage_plan.h"

namespace tempera {
namespace {

using test::Card;
using test::frame_of;
using test::mean_square;
using test::waves;

constexpr int kWidth = 72, kHeight = 44;

/// Light of cards with a texture under light of their own: albedo times 1, and a shadow's edge that moves over all of
/// them at `shadow` pixels a frame, if it does.
Frame lit(const std::vector<Card>& cards, float t, float shadow = 0) {
  Frame f = frame_of(cards, kWidth, kHeight, t);
  f.add(layers::albedo(), Image(kWidth, kHeight, 3));
  Image &color = f.layer("color"), &albedo = f.layer("albedo");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      albedo.set_rgb(x, y, color.rgb(x, y));
      const float edge = 20 + shadow * t, light = 2 - 1.5f * std::clamp((edge - float(x)) / 6, 0.0f, 1.0f);
      if (shadow != 0) color.set_rgb(x, y, color.rgb(x, y) * light);
    }
  }
  return f;
}

/// The same with the noise of few samples in its light, and halves.
Frame guide_of(const std::vector<Card>& cards, float t, float shadow = 0, float noise = 0.2f) {
  Frame f = lit(cards, t, shadow);
  Image &a = f.create(layers::color_a()), &b = f.create(layers::color_b());
  const auto uniform = [&](int x, int y, int c, int half) {
    return 2 *
               float(hash_key(std::uint64_t(t * 16), hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(c)),
                              std::uint64_t(half)) >>
                     40) /
               float(1 << 24) -
           1;
  };
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      Rgb c = f.layer("color").rgb(x, y), na = c, nb = c;
      for (int k = 0; k < 3; ++k) {
        na[k] *= 1 + noise * 2.4f * uniform(x, y, k, 0), nb[k] *= 1 + noise * 2.4f * uniform(x, y, k, 1);
      }
      a.set_rgb(x, y, na), b.set_rgb(x, y, nb);
      f.layer("color").set_rgb(x, y, (na + nb) * 0.5f);
    }
  }
  return f;
}

class Interpolate : public test::FrameFiles {
 protected:
  /// Keys at 0 and 4, guides at 1 to 3.
  void write_all(const std::vector<Card>& cards, float shadow = 0) const {
    for (const int t : {0, 4}) write("keys", t, lit(cards, float(t), shadow));
    for (const int t : {1, 2, 3}) write("guides", t, guide_of(cards, float(t), shadow));
  }
  std::string error(const std::vector<std::pair<std::string, std::string>>& params = {}) const {
    try {
      run("interpolate", {"keys", "guides"}, "out", params);
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput) << e.what();
      return e.message();
    }
    return "no error";
  }
};

/// Mean square error relative to the picture's, of the pixels whose mask is `masked`.
double error_where(const Image& a, const Image& truth, const Image& mask, bool masked) {
  double sum = 0;
  int count = 0;
  for (int y = 0; y < a.height(); ++y) {
    for (int x = 0; x < a.width(); ++x) {
      if ((mask.at(x, y) > 0) != masked) continue;
      for (int c = 0; c < 3; ++c)
        sum += std::pow(double(a.at(x, y, c) - truth.at(x, y, c)) / (double(truth.at(x, y, c)) + 0.1), 2), ++count;
    }
  }
  return count ? sum / count : 0;
}
double share(const Image& mask) {
  return double(std::count_if(mask.values().begin(), mask.values().end(), [](float m) { return m > 0; })) /
         double(mask.pixels());
}

const std::vector<Card> kMoving = {
    {.velocity = {1.3f, 0.4f}, .depth = 10, .texture = waves},
    {.x0 = 12,
     .y0 = 8,
     .x1 = 34,
     .y1 = 26,
     .velocity = {4.2f, 0.6f},
     .depth = 5,
     .texture = [](float x, float y) { return waves(y, x); }},
    {.x0 = 44, .y0 = 16, .x1 = 60, .y1 = 36, .velocity = {-3, 0}, .depth = 3, .texture = [](float x, float y) {
       return Rgb(0.3f + 0.1f * std::sin(0.5f * x + 0.3f * y));
     }}};

TEST_F(Interpolate, AStillPictureStaysAsItIs) {
  const std::vector<Card> still = {{.texture = waves},
                                   {.x0 = 8, .y0 = 8, .x1 = 30, .y1 = 20, .depth = 3, .texture = waves}};
  write_all(still);
  for (const std::string method : {"gathered", "published"}) {
    run("interpolate", {"keys", "guides"}, method, {{"method", method}});
    for (const int t : {1, 2, 3}) {
      const Image out = read(method, t).layer("color"), truth = lit(still, 0).layer("color");
      for (std::size_t i = 0; i < out.values().size(); ++i) ASSERT_NEAR(out.values()[i], truth.values()[i], 1e-6f);
    }
  }
}

TEST_F(Interpolate, WhatMovesIsWhereItBelongs) {
  write_all(kMoving);
  run("interpolate", {"keys", "guides"}, "out");
  for (const int t : {1, 2, 3}) {
    const Frame out = read("out", t);
    const Image truth = lit(kMoving, float(t)).layer("color");
    EXPECT_LT(error_where(out.layer("color"), truth, out.layer("mask"), false), 1e-5) << t;
    // Edges of the cards that move and what no key shows: not more.
    EXPECT_GT(share(out.layer("mask")), 0.05);
    EXPECT_LT(share(out.layer("mask")), 0.25);
  }
}

// Bilinear weights, in both directions: textures are smoothed a little.
TEST_F(Interpolate, AsPublishedKeysAreProjected) {
  write_all(kMoving);
  run("interpolate", {"keys", "guides"}, "out", {{"method", "published"}});
  for (const int t : {1, 2, 3}) {
    const Frame out = read("out", t);
    const Image truth = lit(kMoving, float(t)).layer("color");
    EXPECT_LT(error_where(out.layer("color"), truth, out.layer("mask"), false), 5e-4) << t;
    EXPECT_GT(share(out.layer("mask")), 0.05);
    EXPECT_LT(share(out.layer("mask")), 0.35);
  }
  // A shadow that passes stands in two places at half strength: the surface's vectors do not know of it.
  write_all({{.texture = waves}}, 5);
  run("interpolate", {"keys", "guides"}, "shadow", {{"method", "published"}}, {2});
  const Image two = read("shadow", 2).layer("color"), texture = lit({{.texture = waves}}, 2).layer("albedo");
  for (const int x : {22, 36}) EXPECT_NEAR(two.at(x, 20, 0) / texture.at(x, 20, 0), 1.25f, 0.3f) << x;
}

TEST_F(Interpolate, WhatIsInNeitherKeyIsLeftToTheRenderer) {
  // A card that passes: it is there in frame 2 alone.
  std::vector<Card> cards = {
      {.texture = waves},
      {.x0 = -78, .y0 = 10, .x1 = -50, .y1 = 30, .velocity = {44, 0}, .depth = 3, .texture = waves}};
  write_all(cards);
  for (const std::string method : {"gathered", "published"}) {
    run("interpolate", {"keys", "guides"}, method, {{"method", method}});
    const Frame out = read(method, 2);
    for (int y = 10; y < 30; ++y) {
      for (int x = 10; x < 38; ++x) ASSERT_EQ(out.layer("mask").at(x, y), 1) << method << x << "," << y;
    }
    EXPECT_EQ(out.layer("mask").at(60, 20), 0) << method;
  }
}

TEST_F(Interpolate, AShadowThatMovesIsOneShadow) {
  const std::vector<Card> still = {{.texture = waves}};
  write_all(still, 5);
  run("interpolate", {"keys", "guides"}, "out");
  for (const int t : {1, 2, 3}) {
    const Image truth = lit(still, float(t), 5).layer("color");
    const Image a = lit(still, 0, 5).layer("color"), b = lit(still, 4, 5).layer("color");
    Image blend = a;  // what color alone would give
    for (std::size_t i = 0; i < blend.values().size(); ++i) {
      blend.values()[i] += (b.values()[i] - blend.values()[i]) * float(t) / 4;
    }
    const Frame out = read("out", t);
    Image filled = out.layer("color");
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (out.layer("mask").at(x, y) > 0) filled.set_rgb(x, y, truth.rgb(x, y));
      }
    }
    EXPECT_LT(3 * mean_square(out.layer("color"), truth), mean_square(blend, truth)) << t << ", as it is";
    EXPECT_LT(20 * mean_square(filled, truth), mean_square(blend, truth)) << t << ", with the mask rendered";
    EXPECT_LT(share(out.layer("mask")), 0.33);
  }
}

#ifdef TEMPERA_PATH_SPACE_MOTION
// Irradiance has a motion of its own where it is known apart. [Zimmer 2015, Sec. 4.2]
TEST_F(Interpolate, AsPublishedLightOfAClassIsFollowed) {
  const std::vector<Card> still = {{.texture = waves}};
  const auto classified = [](Frame f) {
    f.add(layers::class_layer("direct", layers::color()), Image(kWidth, kHeight, 3));
    f.add(layers::class_layer("residual", layers::color()), Image(kWidth, kHeight, 3));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) f.layer("class.direct.color").set_rgb(x, y, f.layer("color").rgb(x, y));
    }
    set_classes(f.metadata, std::vector<ClassInfo>{{"direct", "ED.*", {"D"}}});
    return f;
  };
  for (const int t : {0, 1, 2, 3, 4}) {
    const Frame f = t % 4 == 0 ? lit(still, float(t), 1) : guide_of(still, float(t), 1);
    write(t % 4 == 0 ? "keys" : "guides", t, f), write(t % 4 == 0 ? "class_keys" : "class_guides", t, classified(f));
  }
  run("interpolate", {"keys", "guides"}, "out", {{"method", "published"}});
  run("interpolate", {"class_keys", "class_guides"}, "class_out", {{"method", "published"}});
  for (const int t : {1, 2, 3}) {
    const Image truth = lit(still, float(t), 1).layer("color");
    EXPECT_LT(3 * mean_square(read("class_out", t).layer("color"), truth),
              mean_square(read("out", t).layer("color"), truth))
        << t;
  }
}
#endif

TEST_F(Interpolate, LightThatNeitherKeyHasIsLeftToTheRenderer) {
  const std::vector<Card> still = {{.texture = waves}};
  write_all(still);
  Frame flash = guide_of(still, 2);
  for (const char* name : {"color", "color.a", "color.b"}) {
    for (int y = 10; y < 20; ++y) {
      for (int x = 20; x < 30; ++x) flash.layer(name).set_rgb(x, y, flash.layer(name).rgb(x, y) * 1.5f);
    }
  }
  write("guides", 2, flash);
  run("interpolate", {"keys", "guides"}, "out");
  const Image mask = read("out", 2).layer("mask");
  for (int y = 12; y < 18; ++y) {
    for (int x = 22; x < 28; ++x) EXPECT_EQ(mask.at(x, y), 1) << x << "," << y;
  }
  EXPECT_LT(share(read("out", 1).layer("mask")), 0.02) << "noise alone leaves hardly anything";
}

TEST_F(Interpolate, FramesHaveEveryLayerOfTheKeys) {
  const auto more = [](Frame f) {
    f.create(layers::normal()).set_vec3(3, 3, {0, 0, 1});
    f.create(layers::crypto(0)).at(3, 3, 1) = 0.5f;
    f.layer("color").at(3, 3, 3) = 0.25f;
    return f;
  };
  for (const int t : {0, 4}) write("keys", t, more(lit(kMoving, float(t))));
  for (const int t : {1, 2, 3}) write("guides", t, more(guide_of(kMoving, float(t))));
  run("interpolate", {"keys", "guides"}, "out");
  for (int t = 0; t <= 4; ++t) {
    const Frame out = read("out", t), truth = more(lit(kMoving, float(t)));
    for (const Layer& l : truth.layers()) {
      ASSERT_TRUE(out.has(l.desc.name)) << l.desc.name;
      if (l.desc.name != "color" || t % 4 == 0) {
        EXPECT_EQ(out.layer(l.desc.name), l.image) << l.desc.name << t;
      }
    }
    EXPECT_FALSE(out.has("color.a")) << "of another picture";
    if (t % 4 == 0) {
      EXPECT_EQ(share(out.layer("mask")), 0) << "keys are whole";
    }
  }
}

TEST_F(Interpolate, BothSidesOfACutAreKeys) {
  const std::vector<Card> first = {{.velocity = {1, 0}, .texture = waves}},
                          second = {{.velocity = {0, 1}, .texture = [](float x, float y) { return waves(y, x) * 3; }}};
  const auto cut = [](Frame f, int t) {
    const auto clear = [&](const char* name) {
      std::fill_n(f.layer(name).values().data(), f.layer(name).values().size(), 0.0f);
    };
    if (t == 5) clear("motion.forward");
    if (t == 6) clear("motion.backward");
    return f;
  };
  for (const int t : {0, 4, 5, 6, 8}) write("keys", t, cut(lit(t < 6 ? first : second, float(t)), t));
  for (const int t : {1, 2, 3, 7}) write("guides", t, guide_of(t < 6 ? first : second, float(t)));
  EXPECT_EQ(run("interpolate", {"keys", "guides"}, "out", {{"cuts", "6"}}).frames,
            (std::vector<int>{0, 1, 2, 3, 4, 5, 6, 7, 8}));
  EXPECT_EQ(read("out", 5).layer("color"), read("keys", 5).layer("color"));
  const Frame after = read("out", 7);
  EXPECT_LT(error_where(after.layer("color"), lit(second, 7).layer("color"), after.layer("mask"), false), 1e-5);
}

#ifdef TEMPERA_PATH_SPACE_MOTION
TEST_F(Interpolate, WhatAMirrorShowsMovesByItself) {
  const Vec2f velocity{3.3f, 1.2f};
  const auto error = [&](bool with_vectors, bool shines, const std::string& method = "gathered") {
    for (int t = 0; t <= 4; ++t)
      write(t % 4 == 0 ? "keys" : "guides", t,
            test::mirror_frame(kWidth, kHeight, float(t), velocity, with_vectors, shines));
    run("interpolate", {"keys", "guides"}, "out", {{"method", method}});
    double sum = 0;
    for (const int t : {1, 2, 3}) {
      const Frame out = read("out", t);
      const Image truth = test::mirror_frame(kWidth, kHeight, float(t), velocity, true).layer("color");
      EXPECT_EQ(out.layer("color").rgb(3, 20), truth.rgb(3, 20)) << "the wall stands still";
      EXPECT_EQ(out.layer("color").rgb(30, 20),
                out.layer("class.direct.color").rgb(30, 20) + out.layer("class.reflection.color").rgb(30, 20));
      // Within the mirror, where both keys show what it shows.
      for (int y = 14; y < kHeight - 14; ++y) {
        for (int x = 24; x < kWidth - 24; ++x) {
          for (int c = 0; c < 3; ++c) sum += std::pow(double(out.layer("color").at(x, y, c) - truth.at(x, y, c)), 2);
          if (with_vectors) {
            EXPECT_EQ(out.layer("mask").at(x, y), 0) << x << "," << y;
          }
        }
      }
    }
    return sum;
  };
  for (const bool shines : {false, true}) {
    EXPECT_LT(10 * error(true, shines), error(false, shines)) << shines;
    EXPECT_LT(5 * error(true, shines, "published"), error(false, shines, "published")) << shines;
  }
}
#endif

TEST_F(Interpolate, TheSameBitsInAnyDivision) {
  write_all(kMoving, 3);
  for (const std::string method : {"gathered", "published"}) {
    with_threads(1, [&] { run("interpolate", {"keys", "guides"}, method, {{"method", method}}); });
    with_threads(5, [&] {
      for (const int t : {3, 0, 1, 4, 2})
        run("interpolate", {"keys", "guides"}, method + "_each", {{"method", method}}, {t});
    });
    for (int t = 0; t <= 4; ++t) {
      const Frame all = read(method, t), each = read(method + "_each", t);
      for (const Layer& l : all.layers()) EXPECT_EQ(l.image, each.layer(l.desc.name)) << t << l.desc.name;
    }
  }
}

TEST_F(Interpolate, AShotPlansItsKeysFromItsEnds) {
  const StageEntry& entry = find_stage("interpolate");
  StageChoice choice{&entry, Params(entry.params)};
  choice.params.set_text("cuts", "7");
  SequenceDesc shot{{1, 11}, {1, 11}, {}, 8, 8, {layers::color(), layers::motion_forward(), layers::motion_backward()}};
  const std::unique_ptr<Stage> stage = choice.make();
  const std::vector<SequenceDesc> in{shot, shot};
  const auto reads = [&](int port, int frame) { return stage->inputs(port, frame, in); };
  EXPECT_EQ(reads(0, 1), std::vector<int>{1});
  EXPECT_EQ(reads(0, 3), (std::vector<int>{1, 5}));
  EXPECT_EQ(reads(1, 3), (std::vector<int>{2, 3, 4}));
  EXPECT_EQ(reads(0, 6), std::vector<int>{6}) << "the last before the cut";
  EXPECT_EQ(reads(0, 8), (std::vector<int>{7, 9})) << "the first after it";
  EXPECT_EQ(reads(0, 10), (std::vector<int>{9, 11})) << "the shot's end is a key";
  EXPECT_EQ(reads(1, 9), std::vector<int>{});
}

TEST_F(Interpolate, ValuesThatAreNotFiniteDoNotSpread) {
  const float bad[] = {NAN, INFINITY, -INFINITY, 1e30f, 3e38f};
  const auto spoiled = [&](Frame f) {
    int at = 0;
    for (const Layer& l : f.layers()) {
      for (const float v : bad) f.layer(l.desc.name).at(2 + 5 * (at % 10), 3 + 4 * (at / 10), 0) = v, ++at;
    }
    // Opposite and huge: their difference is not finite. Something moves to where it is.
    f.layer("motion.forward").at(40, 30, 0) = 3e38f, f.layer("motion.backward").at(40, 30, 0) = -3e38f;
    return f;
  };
  for (const int t : {0, 4}) write("keys", t, spoiled(lit(kMoving, float(t))));
  for (const int t : {1, 2, 3}) write("guides", t, spoiled(guide_of(kMoving, float(t))));
  run("interpolate", {"keys", "guides"}, "out");
  const Frame out = read("out", 2);
  for (const float v : out.layer("color").values()) ASSERT_TRUE(std::isfinite(v));
}

TEST_F(Interpolate, LightIsDividedByWhatAllFramesHave) {
  const std::vector<Card> still = {{.texture = waves}};
  for (const int t : {0, 4}) {
    Frame key = lit(still, float(t), 5);
    key.remove("albedo");
    write("keys", t, key);
  }
  for (const int t : {1, 2, 3}) write("guides", t, guide_of(still, float(t), 5, 0.01f));
  run("interpolate", {"keys", "guides"}, "out");
  const Image truth = lit(still, 2, 5).layer("color");
  EXPECT_LT(error_where(read("out", 2).layer("color"), truth, read("out", 2).layer("mask"), false), 1e-3)
      << "the guides' albedo says nothing of keys without one";

  write_all(still);
  Frame without = lit(still, 4);
  without.remove("albedo");
  write("keys", 4, without);
  EXPECT_NE(error().find("has no layer \"albedo\": other keys have it"), std::string::npos) << error();
}

TEST_F(Interpolate, GuidesBeyondTheKeysAreSaid) {
  write_all(kMoving);
  write("guides", 5, guide_of(kMoving, 5));
  const StageReport report = run("interpolate", {"keys", "guides"}, "out");
  EXPECT_EQ(report.frames, (std::vector<int>{0, 1, 2, 3, 4}));
  ASSERT_FALSE(report.notes.empty());
  EXPECT_EQ(report.notes[0], "guides 5 (1 frame) are beyond the keys: no frames are made of them");
}

TEST_F(Interpolate, OneFrameAndKeysAllOver) {
  write("keys", 3, lit(kMoving, 3)), write("guides", 3, guide_of(kMoving, 3));
  EXPECT_EQ(run("interpolate", {"keys", "guides"}, "out").frames, std::vector<int>{3});
  EXPECT_EQ(read("out", 3).layer("color"), read("keys", 3).layer("color"));
  write("keys", 4, lit(kMoving, 4));
  for (const char* every : {"1", "0", "1000"}) {
    EXPECT_EQ(run("interpolate", {"keys", "guides"}, "out", {{"every", every}}).frames, (std::vector<int>{3, 4}));
    EXPECT_EQ(read("out", 4).layer("color"), read("keys", 4).layer("color"));
  }
}

TEST_F(Interpolate, SaysWhatIsMissing) {
  write_all(kMoving);
  EXPECT_EQ(error(), "no error");
  EXPECT_NE(error({{"every", "2"}}).find("lacks frames in between: 2; keys are every --every frames"),
            std::string::npos);
  std::filesystem::remove(frame_path(pattern("guides"), 2));
  EXPECT_NE(error().find("lacks frames that go with the others: 2"), std::string::npos);
  Frame guide = guide_of(kMoving, 2);
  guide.remove("albedo");
  write("guides", 2, guide);
  EXPECT_NE(error().find("has no layer \"albedo\""), std::string::npos);
  for (const int t : {1, 2, 3}) write("guides", t, Frame(frame_of(kMoving, 8, 8, float(t))));
  EXPECT_EQ(error(), "the keys have 72x44 pixels, the guides 8x8");
}

}  // namespace
}  // namespace tempera
