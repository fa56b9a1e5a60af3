// SPDX-License-Identifier: Apache-2.0
#include "../rare_light.h"

#include "box_shot.h"

namespace tempera {
namespace {

constexpr int kSize = 11, kX = 5, kY = 5;

/// The work layers of a frame of 11x11 pixels: `common` makes up most of the light of each, `count` samples of one.
struct WorkFrame {
  WorkFrame(std::vector<std::string> prefixes_, int estimates_, int count_)
      : prefixes(std::move(prefixes_)), estimates(estimates_), count(count_), frame(kSize, kSize) {
    for (const std::string& prefix : prefixes) {
      LayerDesc color = layers::color_a();
      color.name = prefix + "color";
      frame.create(color);
      for (const LayerDesc& d : rare_work_layers(prefix, estimates)) frame.create(d);
      for (const LayerDesc& d : rare_layers(prefix, estimates)) frame.create(d);
      for (int y = 0; y < kSize; ++y) {
        for (int x = 0; x < kSize; ++x) set(prefix, x, y, {}, {});
      }
    }
  }
  /// A pixel whose paths have luminance 1, but for some brighter ones: `common`, and `rare` in the last estimate.
  void set(const std::string& prefix, int x, int y, const std::vector<SampleParts>& common,
           const std::vector<Rgb>& rare) {
    RarePixel pixel;
    SampleParts one;
    one[0] = Rgb(1.0f);
    Rgb sum;
    for (int i = 0; i < count; ++i) {
      const SampleParts& sample = std::size_t(i) < common.size() ? common[i] : one;
      pixel.common.add(sample);
      sum += sample[0];
    }
    for (int k = 0; k < estimates; ++k) pixel.estimates[k].count = count / estimates;
    for (const Rgb& r : rare) pixel.estimates[estimates - 1].add(r), sum += r;
    frame.layer(prefix + "color").set_rgb(x, y, sum * (1 / float(count)));
    store_rare(pixel, count, prefix, x, y, frame);
  }
  void finish() { keep_rare_apart(prefixes, frame); }
  Rgb at(const std::string& name) const { return frame.layer(name).rgb(kX, kY); }

  std::vector<std::string> prefixes;
  int estimates, count;
  Frame frame;
};

WorkFrame temporal(int count) { return {{"", "offset."}, 1, count}; }
WorkFrame single(int count) { return {{""}, 2, count}; }

SampleParts sample(float radiance, float difference) {
  SampleParts s;
  s[0] = Rgb(radiance);
  s[1] = Rgb(-difference), s[4] = Rgb(difference);
  return s;
}

/// Mean light around the center: all pixels 1, in one of `passes` the center with a sample of `bright` among `count`.
float mean_around(float bright, int count, int passes) { return 1 + (bright - 1) / float(count) / float(25 * passes); }

TEST(RareLight, HoldsBackWhatIsTooBright) {
  for (const int count : {4, 16}) {
    WorkFrame f = temporal(count);
    f.set("", kX, kY, {sample(1000, 500)}, {});
    f.finish();
    const float limit = 2 * std::max(float(count), 8.0f) * mean_around(1000, count, 2), n = float(count);
    EXPECT_GT(limit, 4);  // than the third brightest allows
    EXPECT_NEAR(f.at("rare.color").g, (1000 - limit) / n, 1e-2f);
    EXPECT_EQ(f.at("held.color").g, f.at("rare.color").g) << "nothing of it is light of rare paths";
    // All differences are scaled with the sample: to the right by -500, from the pixel above by 500 from below.
    EXPECT_NEAR(f.at("rare.grad.x").g, -500 * (1 - limit / 1000) / n, 1e-2f);
    EXPECT_NEAR(f.frame.layer("rare.grad.y").rgb(kX, kY - 1).g, -500 * (1 - limit / 1000) / n, 1e-2f);
    EXPECT_EQ(f.at("rare.grad.y").g, 0);
    EXPECT_EQ(f.at("offset.rare.color").g, 0);
    EXPECT_EQ(f.frame.layer("rare.color").rgb(kX + 1, kY).g, 0);
  }
}

TEST(RareLight, ADifferenceCanBeTooBright) {
  WorkFrame f = temporal(16);
  f.set("", kX, kY, {sample(1, 1000)}, {});
  f.finish();
  EXPECT_NEAR(f.at("rare.grad.x").g, -(1000 - 32) / 16.0f, 1e-2f);
  EXPECT_NEAR(f.at("held.color").g, (1 - 32 / 1000.0f) / 16, 1e-5f);
}

TEST(RareLight, WhatIsAsBrightAroundIsNotTooBright) {
  // Three bright samples around allow four times the third of them; the second of the pixel counts as one.
  WorkFrame f = temporal(16);
  f.set("", kX, kY, {sample(1000, 0), sample(90, 0)}, {});
  f.set("", kX - 2, kY - 2, {sample(100, 0)}, {});
  f.set("", kX + 2, kY + 2, {sample(95, 0)}, {});
  f.set("offset.", kX, kY, {sample(900, 0)}, {});  // the other pass has no say, so that replays agree
  f.finish();
  EXPECT_NEAR(f.at("held.color").g, (1000 - 4 * 90) / 16.0f, 1e-2f);
  WorkFrame alone = temporal(16);
  alone.set("", kX, kY, {sample(1000, 0), sample(90, 0)}, {});
  alone.set("", kX - 2, kY - 2, {sample(100, 0)}, {});
  alone.finish();
  EXPECT_GT(alone.at("held.color").g, (1000 - 4 * 90) / 16.0f);
}

// The limit grows with the samples: in the limit of many nothing is held back.
TEST(RareLight, NothingIsHeldBackOfManySamples) {
  for (const auto& make : {temporal, single}) {
    WorkFrame f = make(1024);
    f.set("", kX, kY, {sample(1000, 500)}, {Rgb(900.0f)});
    f.finish();
    EXPECT_EQ(f.at("held.color").g, 0);
    EXPECT_NEAR(f.at("rare.color").g, 900 / 1024.0f, 1e-5f) << "the light of rare paths itself";
    EXPECT_EQ(f.at("rare.grad.x").g, 0);
  }
}

TEST(RareLight, RarePathsSupportEachOtherInBothPasses) {
  WorkFrame f = temporal(16);
  f.set("", kX, kY, {}, {Rgb(2000.0f)});
  // The eighth brightest of both passes is 20.
  for (int i = 0; i < 4; ++i) {
    f.set("", kX - 2 + i, kY - 1, {}, {Rgb(30.0f)});
    f.set("offset.", kX - 2 + i, kY - 1, {}, {Rgb(i < 3 ? 25.0f : 20.0f)});
  }
  f.finish();
  EXPECT_NEAR(f.at("rare.color").g, 2000 / 16.0f, 1e-2f);
  EXPECT_NEAR(f.at("held.color").g, (2000 - 4 * 20) / 16.0f, 1e-2f);
  WorkFrame fewer = temporal(16);
  fewer.set("", kX, kY, {}, {Rgb(2000.0f)});
  fewer.set("", kX + 1, kY, {}, {Rgb(30.0f)});
  fewer.finish();
  EXPECT_NEAR(fewer.at("held.color").g, (2000 - 2 * 16) / 16.0f, 1e-2f) << "the mean light decides";
}

// One pass: its even and odd samples take the place of two passes.
TEST(RareLight, HalvesOfOnePass) {
  WorkFrame f = single(32);
  f.set("", kX, kY, {}, {Rgb(2000.0f), Rgb(40.0f)});
  f.finish();
  const float limit = 2 * 16;
  EXPECT_NEAR(f.at("rare.color").g, 2040 / 32.0f, 1e-2f);
  EXPECT_NEAR(f.at("held.color").g, (2000 - limit + 40 - limit) / 32.0f, 1e-2f);
  EXPECT_EQ(f.at("rare.a").g, 0);
  EXPECT_NEAR(f.at("rare.b").g, 2 * limit / 16, 1e-2f);
}

// After a surface that connects and a narrow lobe: what the class automaton calls so.
TEST(RareLight, IsTheLightAfterANarrowLobeAfterARoughOne) {
  for (const char* integrator : {"gradient_path", "temporal_gradient_path"}) {
    BoxShot shot = BoxShot(make_diffuse(0.7f), make_dielectric({})).area_light();
    shot.integrator = integrator;
    shot.settings.spp = 64;
    shot.settings.classes = {{"rare", "E.*D.*[RT].*"}};
    const Frame frame = shot.render();
    const Image &rare = frame.layer("rare.color"), &held = frame.layer("held.color"),
                &wanted = frame.layer("class.rare.color");
    double sum = 0;
    int compared = 0;
    for (int y = 0; y < rare.height(); ++y) {
      for (int x = 0; x < rare.width(); ++x) {
        sum += double(luminance(wanted.rgb(x, y)));
        EXPECT_GE(rare.rgb(x, y).g, held.rgb(x, y).g - 1e-4f);
        if (held.rgb(x, y).g != 0) continue;
        EXPECT_NEAR(rare.rgb(x, y).g, wanted.rgb(x, y).g, 1e-5f + 1e-5f * frame.layer("color").rgb(x, y).g);
        ++compared;
      }
    }
    EXPECT_GT(sum, 1);
    EXPECT_GT(compared, 300);
  }
}

TEST(RareLight, ThereIsNoneAmongRoughSurfaces) {
  BoxShot shot = BoxShot(make_diffuse(0.7f), make_diffuse(0.3f)).area_light();
  shot.integrator = "temporal_gradient_path";
  shot.settings.spp = 64;
  const Frame frame = shot.render();
  for (const char* name : {"rare.color", "offset.rare.color"}) {
    double sum = 0;
    for (const float v : values(frame.layer(name))) sum += double(v);
    double all = 0;
    for (const float v : values(frame.layer("color"))) all += double(v);
    EXPECT_LT(sum, 1e-3 * all) << name;
  }
  shot.parameters += ",rare=false";
  const Frame without = shot.render();
  EXPECT_FALSE(without.has("rare.color"));
  for (const char* name : {"color", "grad.x", "offset.color", "offset.grad.y"})
    EXPECT_EQ(values(without.layer(name)), values(frame.layer(name))) << name;
}

// Limits look at pixels of other tiles: neither their size nor the number of threads shows.
TEST(RareLight, TilesAndThreadsDoNotShow) {
  for (const char* integrator : {"gradient_path", "temporal_gradient_path"}) {
    BoxShot shot = BoxShot(make_diffuse(0.7f), make_dielectric({})).area_light(0.1f);
    shot.integrator = integrator;
    shot.settings.spp = 32;
    const Frame a = shot.render();
    shot.tile = 7;
    Frame b(1, 1);
    with_threads(3, [&] { b = shot.render(); });
    double held = 0;
    for (const std::string& name : a.layer_names()) {
      if (name.find("rare.") == std::string::npos && name.find("held.") == std::string::npos) continue;
      EXPECT_EQ(values(a.layer(name)), values(b.layer(name))) << name;
      if (name == "held.color") {
        for (const float v : values(a.layer(name))) held += double(v);
      }
    }
    EXPECT_GT(held, 0);
    EXPECT_FALSE(a.has("rare.brightest")) << "work layers are no output";
  }
}

}  // namespace
}  // namespace tempera
