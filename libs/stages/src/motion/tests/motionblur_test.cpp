// SPDX-License-Identifier: Apache-2.0
// The stage motionblur on cards whose blurred pictures are known.
#include <gtest/gtest.h>

#include "motion/tests/moving_pictures.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

using test::Card;
using test::frame_of;
using test::mean_square;
using test::picture;
using test::waves;

constexpr int kWidth = 64, kHeight = 40;

class MotionBlur : public test::FrameFiles {
 protected:
  /// Frames 0 to 2 of the cards, of which frame 1 is blurred.
  Frame blurred(const std::vector<Card>& cards, const std::string& shutter,
                const std::function<void(int number, Frame&)>& change = {}) const {
    for (int t = 0; t < 3; ++t) {
      Frame f = frame_of(cards, kWidth, kHeight, float(t));
      if (change) change(t, f);
      write("in", t, f);
    }
    run("motionblur", {"in"}, "out", {{"shutter", shutter}}, {1});
    return read("out", 1);
  }
};

const std::vector<Card> kCrossing = {
    {.velocity = {0, 0}, .depth = 10, .texture = waves},
    {.x0 = 18,
     .y0 = 8,
     .x1 = 34,
     .y1 = 24,
     .velocity = {12, 0},
     .depth = 5,
     .texture = [](float x, float y) { return waves(y, x) * 2; }},
    {.x0 = 44, .y0 = 14, .x1 = 56, .y1 = 34, .velocity = {-10, 3}, .depth = 3, .texture = [](float x, float) {
       return Rgb(0.1f + 0.05f * std::sin(x));
     }}};

TEST_F(MotionBlur, AClosedShutterChangesNothing) {
  EXPECT_EQ(blurred(kCrossing, "0").layer("color"), picture(kCrossing, kWidth, kHeight, 1));
}

TEST_F(MotionBlur, WhatStandsStillStaysToTheBit) {
  const std::vector<Card> still = {{.texture = waves},
                                   {.x0 = 5.3f, .y0 = 4, .x1 = 30, .y1 = 20.6f, .depth = 2, .texture = waves}};
  EXPECT_EQ(blurred(still, "0.7").layer("color"), picture(still, kWidth, kHeight, 1));
}

TEST_F(MotionBlur, ATranslationIsABoxOfItsLength) {
  const std::vector<Card> cards = {{.velocity = {9, -4}, .texture = waves}};
  const Image truth = picture(cards, kWidth, kHeight, 1, 0.8f, 64);
  const Image out = blurred(cards, "0.8").layer("color");
  // At the left and the right, too, where frames 0 and 2 show what enters; what enters at corners is in none of them.
  for (int y = 4; y < kHeight - 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(out.at(x, y, c), truth.at(x, y, c), 0.006) << x << "," << y;
    }
  }
}

TEST_F(MotionBlur, ASpotKeepsItsEnergy) {
  const std::vector<Card> cards = {{.velocity = {7, 3}, .texture = [](float x, float y) {
                                      return Rgb(std::hypot(x - 20, y - 15) < 1.2f ? 50.0f : 0.0f);
                                    }}};
  const auto sum = [](const Image& image) {
    double total = 0;
    for (int i = 0; i < image.pixels(); ++i) total += double(image.values()[std::size_t(i) * 4]);
    return total;
  };
  const double all = sum(picture(cards, kWidth, kHeight, 1));
  EXPECT_NEAR(sum(blurred(cards, "0.9").layer("color")), all, 0.01 * all);
}

TEST_F(MotionBlur, CardsThatCrossHideEachOther) {
  const Image truth = picture(kCrossing, kWidth, kHeight, 1, 0.5f, 64);
  const double sharp = mean_square(picture(kCrossing, kWidth, kHeight, 1), truth);
  const Image out = blurred(kCrossing, "0.5").layer("color");
  EXPECT_LT(mean_square(out, truth), 0.02 * sharp);

  // What does not look behind the cards: each pixel along its own vector.
  Image naive = picture(kCrossing, kWidth, kHeight, 1);
  const Frame f = frame_of(kCrossing, kWidth, kHeight, 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      Rgb mean;
      for (int j = 0; j < 32; ++j) {
        const float theta = 0.5f * ((float(j) + 0.5f) / 32 - 0.5f);
        const Vec2f v = f.layer("motion.forward").vec2(x, y);
        mean += f.layer("color").rgb_bilinear({float(x) + 0.5f - theta * v.x, float(y) + 0.5f - theta * v.y});
      }
      naive.set_rgb(x, y, mean / 32.0f);
    }
  }
  EXPECT_LT(mean_square(out, truth), 0.1 * mean_square(naive, truth));
}

TEST_F(MotionBlur, EdgesAlongTheMotionStaySmooth) {
  // The card's lower edge is halfway in a pixel, and stays there.
  const std::vector<Card> cards = {
      {.depth = 10, .texture = [](float, float) { return Rgb(0.0f); }},
      {.x0 = -1000, .y0 = 5, .x1 = 1000, .y1 = 20.5f, .velocity = {8, 0}, .depth = 4, .texture = [](float, float) {
         return Rgb(1.0f);
       }}};
  const Image out = blurred(cards, "0.5").layer("color");
  EXPECT_NEAR(out.at(30, 20, 0), 0.5f, 0.01f);
}

TEST_F(MotionBlur, VectorsThatAreMissingAreContinued) {
  const Image whole = blurred(kCrossing, "0.5").layer("color");
  const Image patched = blurred(kCrossing, "0.5", [](int t, Frame& f) {
                          if (t != 1) return;
                          for (int y = 10; y < 16; ++y) {
                            for (int x = 34; x < 40; ++x) {  // within the first card
                              for (const char* name : {"motion.forward", "motion.backward"})
                                std::fill_n(f.layer(name).pixel(x, y), 4, 0.0f);
                            }
                          }
                          for (int y = 0; y < kHeight; ++y)
                            std::fill_n(f.layer("motion.backward").pixel(50, y), 4, 0.0f);
                        }).layer("color");
  for (std::size_t i = 0; i < whole.values().size(); ++i) ASSERT_NEAR(patched.values()[i], whole.values()[i], 1e-4f);
}

TEST_F(MotionBlur, PathsAreCurvedWhereBothVectorsSaySo) {
  // A point that turns back: it moves by (6, 0) before frame 1 and by (0, 6) after it.
  const std::vector<Card> cards = {{.texture = waves}};
  const auto turn = [](int, Frame& f) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const float to[4] = {0, 6, 0, 1}, back[4] = {-6, 0, 0, 1};
        std::copy(to, to + 4, f.layer("motion.forward").pixel(x, y));
        std::copy(back, back + 4, f.layer("motion.backward").pixel(x, y));
      }
    }
  };
  const Image out = blurred(cards, "1", turn).layer("color");
  Rgb mean;
  constexpr int kTimes = 256;
  for (int j = 0; j < kTimes; ++j) {
    const float t = (float(j) + 0.5f) / kTimes - 0.5f;  // by (3, 3) t + (-3, 3) t^2
    mean += waves(32.5f - 3 * t + 3 * t * t, 20.5f - 3 * t - 3 * t * t);
  }
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(out.at(32, 20, c), mean[c] / kTimes, 0.006f);
}

TEST_F(MotionBlur, NothingShowsThroughACut) {
  const std::vector<Card> cards = {{.velocity = {12, 0}, .texture = waves}};
  const Image out =
      blurred(cards, "1", [](int t, Frame& f) {
        if (t == 2) {  // another shot
          for (float& v : f.layer("color").values()) v = 1000;
          std::fill_n(f.layer("motion.backward").values().data(), f.layer("motion.backward").values().size(), 0.0f);
        }
        if (t == 1)
          std::fill_n(f.layer("motion.forward").values().data(), f.layer("motion.forward").values().size(), 0.0f);
      }).layer("color");
  EXPECT_LT(*std::max_element(out.values().begin(), out.values().end()), 1.01f);
  EXPECT_LT(mean_square(out, picture(cards, kWidth, kHeight, 1, 1, 64), 8), 1e-4);
  // The same where the vectors do not say it, but the user does.
  Frame other = frame_of(cards, kWidth, kHeight, 2);
  for (float& v : other.layer("color").values()) v = 1000;
  write("in", 2, other);
  run("motionblur", {"in"}, "told", {{"shutter", "1"}, {"cuts", "2"}}, {1});
  const Image told = read("told", 1).layer("color");
  EXPECT_LT(*std::max_element(told.values().begin(), told.values().end()), 1.01f);
}

TEST_F(MotionBlur, AlphaDepthAndMattesAreThoseOfTheExposure) {
  std::vector<Card> cards = {
      {.depth = 10, .texture = [](float, float) { return Rgb(0.0f); }},
      {.x0 = 20, .y0 = 10, .x1 = 40, .y1 = 30, .velocity = {10, 0}, .depth = 4, .texture = [](float, float) {
         return Rgb(1.0f);
       }}};
  const Frame out = blurred(cards, "0.8", [](int, Frame& f) {
    Image &color = f.layer("color"), &crypto = f.create(layers::crypto(0));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool card = f.layer("object_id").at(x, y) == 2;
        color.at(x, y, 3) = card;
        if (!card) f.layer("object_id").at(x, y) = 0, f.layer("depth").at(x, y) = 0;
        crypto.at(x, y, 0) = card ? 7.0f : 0.0f, crypto.at(x, y, 1) = card;
      }
    }
  });
  // At frame 1 the card covers 30 to 50; its left edge moves over 26 to 34.
  for (const auto& [x, share] : std::vector<std::pair<int, float>>{
           {24, 0.0f}, {27, 0.1875f}, {29, 0.4375f}, {32, 0.8125f}, {40, 1.0f}, {51, 0.3125f}}) {
    EXPECT_NEAR(out.layer("color").at(x, 20, 0), share, 0.07f) << x;
    EXPECT_NEAR(out.layer("color").at(x, 20, 3), out.layer("color").at(x, 20, 0), 1e-5f) << "premultiplied";
    EXPECT_NEAR(out.layer("CryptoObject00").at(x, 20, 1), share, 0.07f) << x;
    EXPECT_EQ(out.layer("CryptoObject00").at(x, 20, 0), share > 0 ? 7.0f : 0.0f);
    EXPECT_EQ(out.layer("depth").at(x, 20), share > 0 ? 4.0f : 0.0f) << "of what is there, not mixed with nothing";
  }
  EXPECT_EQ(out.layer("object_id").at(45, 20), 2);
  EXPECT_EQ(out.layer("motion.forward").at(45, 20, 0), 10);
}

#ifdef TEMPERA_PATH_SPACE_MOTION
TEST_F(MotionBlur, WhatAMirrorShowsMovesByItself) {
  const Vec2f velocity{7, 2};
  Image truth = test::mirror_frame(kWidth, kHeight, 1, velocity, true).layer("color");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      Rgb sum;
      for (int j = 0; j < 32; ++j) {
        const float t = 1 + 0.6f * ((float(j) + 0.5f) / 32 - 0.5f);
        Rgb c;
        test::seen(
            {{.velocity = velocity, .texture = [](float u, float v) { return waves(1.4f * v, 1.2f * u) * 1.5f; }}},
            float(x) + 0.5f, float(y) + 0.5f, t, c);
        sum += c;
      }
      if (x >= 10 && x < kWidth - 10 && y >= 8 && y < kHeight - 8) truth.set_rgb(x, y, sum / 32.0f);
    }
  }
  const auto error = [&](bool with_vectors, bool shines) {
    for (int t = 0; t < 3; ++t)
      write("in", t, test::mirror_frame(kWidth, kHeight, float(t), velocity, with_vectors, shines));
    run("motionblur", {"in"}, "out", {{"shutter", "0.6"}}, {1});
    const Frame out = read("out", 1);
    EXPECT_EQ(out.layer("color").rgb(3, 20), truth.rgb(3, 20)) << "the wall stands still";
    Rgb sum = out.layer("class.direct.color").rgb(30, 20) + out.layer("class.reflection.color").rgb(30, 20);
    EXPECT_EQ(out.layer("color").rgb(30, 20), sum) << "parts add up";
    return mean_square(out.layer("color"), truth);
  };
  for (const bool shines : {false, true}) EXPECT_LT(10 * error(true, shines), error(false, shines)) << shines;
}
#endif

TEST_F(MotionBlur, TheSameBitsInAnyDivision) {
  for (int t = 0; t < 4; ++t) write("in", t, frame_of(kCrossing, kWidth, kHeight, float(t)));
  with_threads(1, [&] { run("motionblur", {"in"}, "all"); });
  with_threads(5, [&] {
    for (int t = 3; t >= 0; --t) run("motionblur", {"in"}, "each", {}, {t});
  });
  for (int t = 0; t < 4; ++t) EXPECT_EQ(read("all", t).layer("color"), read("each", t).layer("color")) << t;
}

TEST_F(MotionBlur, TheMetadataSayHowLongTheShutterIsOpen) {
  Frame f = frame_of(kCrossing, kWidth, kHeight, 0);
  RenderInfo info;
  info.version = info.command = info.scene = info.scene_hash = info.integrator = info.parameters = "x";
  info.shutter_open = info.shutter_close = 0.25;
  set_render_info(f.metadata, info);
  write("in", 0, f);
  EXPECT_TRUE(run("motionblur", {"in"}, "out").notes.empty());
  const auto blurred = render_info(read("out", 0).metadata);
  ASSERT_TRUE(blurred);
  EXPECT_EQ(blurred->shutter_open, 0);
  EXPECT_EQ(blurred->shutter_close, 0.5);
  const std::vector<std::string> notes = run("motionblur", {"out"}, "twice").notes;
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_NE(notes[0].find("blurred twice"), std::string::npos);
}

TEST_F(MotionBlur, ValuesThatAreNotFiniteDoNotSpread) {
  const float bad[] = {NAN, INFINITY, -INFINITY, 1e30f, 3e38f};
  const Frame out = blurred(kCrossing, "0.5", [&](int, Frame& f) {
    f.create(layers::crypto(0)), f.create(layers::normal());
    const std::list<Layer>& all = f.layers();
    int at = 0;
    for (const Layer& l : all) {
      for (const float v : bad) f.layer(l.desc.name).at(3 + 5 * (at % 10), 2 + 3 * (at / 10), 0) = v, ++at;
    }
  });
  for (const char* name : {"color", "normal", "depth", "CryptoObject00"}) {
    for (const float v : out.layer(name).values()) ASSERT_TRUE(std::isfinite(v)) << name;
  }
}

TEST_F(MotionBlur, LayersThatFramesAroundLackStayBright) {
  const Frame out = blurred(kCrossing, "1", [&](int number, Frame& f) {
    if (number == 1) f.add(layers::albedo(), Image(kWidth, kHeight, 3, 0.5f));
  });
  for (const float v : out.layer("albedo").values()) ASSERT_NEAR(v, 0.5f, 1e-6f);
}

TEST_F(MotionBlur, OneColumnOfVectorsIsEnoughForItsObject) {
  Frame f = frame_of({{.texture = waves}}, kWidth, kHeight, 0);
  f.remove("motion.backward");
  Image& forward = f.layer("motion.forward");
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) forward.at(x, y, 0) = 6, forward.at(x, y, 3) = x == 0 ? 1.0f : 0.0f;
  }
  write("in", 0, f);
  EXPECT_TRUE(run("motionblur", {"in"}, "out").notes.empty()) << "no pixel stays sharp";
  const Image out = read("out", 0).layer("color");
  const Image truth = picture({{.velocity = {6, 0}, .texture = waves}}, kWidth, kHeight, 0, 0.5f, 32);
  EXPECT_LT(20 * mean_square(out, truth, 4), mean_square(f.layer("color"), truth, 4));
}

TEST_F(MotionBlur, OnePixelIsAPicture) {
  write("in", 0, frame_of(kCrossing, 1, 1, 0));
  run("motionblur", {"in"}, "out");
  EXPECT_EQ(read("out", 0).layer("color"), picture(kCrossing, 1, 1, 0));
}

TEST_F(MotionBlur, SaysWhatIsMissing) {
  const auto error = [&] {
    try {
      run("motionblur", {"in"}, "out");
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput);
      return e.message();
    }
    return std::string("no error");
  };
  Frame f = frame_of(kCrossing, 8, 8, 0);
  f.remove("motion.forward");
  write("in", 0, f);
  EXPECT_EQ(error(), "no error") << "one direction is enough";
  f.remove("motion.backward");
  write("in", 0, f);
  EXPECT_NE(error().find("motion.forward"), std::string::npos);
  f.add({"motion.forward", {"X"}, units::kPixels}, Image(8, 8, 1));
  write("in", 0, f);
  EXPECT_EQ(error(), "frame 0: the layer \"motion.forward\" has 1 channels, 2 are needed");
}

}  // namespace
}  // namespace tempera
