// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <numeric>

#include "box_shot.h"

namespace tempera {
namespace {

TestShot temporal(TestShot shot, int spp) {
  shot.integrator = "temporal_gradient_path";
  shot.settings.spp = spp;
  return shot;
}

// Nothing moves: the offset pass of a frame repeats the base pass of the frame before, to the bit.
TEST(TemporalGradientPath, ReplaysAStillSceneToTheBit) {
  ConductorParams rough;
  rough.roughness = {true, Microfacets::kGgx, 0.2f, 0.2f, true};
  const TestShot shot = temporal(BoxShot(make_conductor(rough), make_dielectric({})).area_light().sky(), 8);
  const Frame before = shot.render(3), now = shot.render(4);
  for (const char* name : {"color", "grad.x", "grad.y"}) {
    EXPECT_EQ(values(now.layer(std::string("offset.") + name)), values(before.layer(name))) << name;
    EXPECT_NE(values(now.layer(name)), values(before.layer(name))) << "each frame has numbers of its own";
  }
  const Image& source = now.layer("offset.source");
  for (int y = 0; y < source.height(); ++y) {
    for (int x = 0; x < source.width(); ++x) {
      EXPECT_EQ(source.at(x, y, 0), float(x));
      EXPECT_EQ(source.at(x, y, 1), float(y));
      EXPECT_EQ(source.at(x, y, 2), 1.0f);
    }
  }
  EXPECT_EQ(now.layer("samples").at(5, 5), 4.0f);
  EXPECT_EQ(now.layer("offset.samples").at(5, 5), 4.0f);
}

// With counts that differ from pixel to pixel, too.
TEST(TemporalGradientPath, ReplaysAdaptiveCountsToTheBit) {
  for (const std::string mode : {"published", "unbiased"}) {
    TestShot shot = temporal(BoxShot(make_diffuse(0.7f), make_conductor({})).area_light(0.1f), 32);
    shot.parameters += ",adaptive=" + mode;
    const Frame before = shot.render(3), now = shot.render(4);
    for (const char* name : {"color", "samples", "grad.x", "grad.y"}) {
      EXPECT_EQ(values(now.layer(std::string("offset.") + name)), values(before.layer(name))) << name;
    }
    const std::vector<float> samples = values(now.layer("samples"));
    const auto [least, most] = std::minmax_element(samples.begin(), samples.end());
    EXPECT_GT(*most, 2 * *least);
    const double mean = std::accumulate(samples.begin(), samples.end(), 0.0) / double(samples.size());
    EXPECT_NEAR(mean, mode == "published" ? 16 : 12, 0.5)
        << "the first of four batches is left out of unbiased results";
  }
}

// A camera that moves by three pixels a frame over a card: the map is the pan, and what is lit directly by the sky, the
// same from everywhere, has no temporal difference.
TEST(TemporalGradientPath, FollowsAPan) {
  TestShot shot;
  shot.orthographic(1);
  shot.add(quad({0, 0, 0}, {9, 0, 0}, {0, 9, 0}), make_diffuse(0.5f));
  Environment sky;
  sky.radiance = Rgb(1.0f);
  shot.scene.environments.push_back(sky);
  AnimatedTransform pan;
  pan.keyed = true;
  const double step = 3 * 2.0 / 32;  // world units of three pixels
  pan.translation = {{-4, 4}, {Vec3d{-4 * step, 0, 5}, Vec3d{4 * step, 0, 5}}, Interpolation::kLinear};
  pan.rotation = axis_angle(Vec3d{0, 1, 0}, kPiD);  // cameras look along +z
  shot.scene.nodes[shot.scene.cameras[0].node].local = pan;
  shot.parameters = "max_depth=2";
  const TestShot t = temporal(shot, 4);
  const Frame before = t.render(0), now = t.render(1);
  const Image& source = now.layer("offset.source");
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      ASSERT_EQ(source.at(x, y, 2), x < 29 ? 1.0f : 0.0f) << x;
      if (x >= 29) continue;
      EXPECT_EQ(source.at(x, y, 0), float(x + 3));
      EXPECT_EQ(source.at(x, y, 1), float(y));
      const Rgb a = now.layer("offset.color").rgb(x, y), b = before.layer("color").rgb(x + 3, y);
      EXPECT_NEAR(a.g, b.g, 1e-4f);
    }
  }
  EXPECT_GT(now.layer("offset.color").rgb(31, 5).g, 0) << "what was not seen before has samples of its own";
}

// A pan by three and a third pixels over stripes of a third of a pixel: a sample that stays where it is in the pixel
// lands on the stripe beside its own. Of samples that move along a third leave the pixel, and come back three stripes
// away.
TEST(TemporalGradientPath, FollowsPartsOfPixels) {
  TestShot shot;
  shot.orthographic(1);
  const double pixel = 2.0 / 32;
  Mesh stripes;
  for (int i = -96; i < 96; i += 2) {
    const Mesh one = quad({float((i + 0.5) * pixel / 3), 0, 0}, {float(pixel / 6), 0, 0}, {0, 2, 0});
    for (const int index : one.indices) stripes.indices.push_back(int(stripes.positions.size()) + index);
    stripes.positions.insert(stripes.positions.end(), one.positions.begin(), one.positions.end());
  }
  shot.add(stripes, make_diffuse(0.0f)).emission = AreaEmission{Slot(1.0f), true};
  shot.add(quad({0, 0, -0.01f}, {9, 0, 0}, {0, 9, 0}), make_diffuse(0.0f));
  AnimatedTransform pan;
  pan.keyed = true;
  pan.translation = {{-1, 1}, {Vec3d{-10 * pixel / 3, 0, 5}, Vec3d{10 * pixel / 3, 0, 5}}, Interpolation::kLinear};
  pan.rotation = axis_angle(Vec3d{0, 1, 0}, kPiD);
  shot.scene.nodes[shot.scene.cameras[0].node].local = pan;
  const auto difference = [&](const std::string& parameters, FilterKind filter) {
    shot.parameters = "max_depth=1," + parameters;
    shot.settings.filter = PixelFilter(filter);
    const TestShot t = temporal(shot, 64);
    const Frame before = t.render(0), now = t.render(1);
    const Image& source = now.layer("offset.source");
    double sum = 0;
    int n = 0;
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        if (source.at(x, y, 2) == 0) continue;
        const int sx = int(source.at(x, y, 0)), sy = int(source.at(x, y, 1));
        EXPECT_EQ(sx, x + 3);
        sum += sqr(now.layer("offset.color").rgb(x, y).g - before.layer("color").rgb(sx, sy).g);
        ++n;
      }
    }
    EXPECT_GT(n, 800);
    return sum / n - 1.0 / 9;  // pixels have one or two lit stripes in turn
  };
  const double without = difference("subpixel_motion=false", FilterKind::kBox);
  EXPECT_NEAR(without, 1.0 / 32, 0.2 / 32) << "each sample changes by one";
  EXPECT_NEAR(difference("subpixel_motion=true", FilterKind::kBox), 1.0 / 96, 0.2 / 96);
  EXPECT_EQ(difference("subpixel_motion=true", FilterKind::kGaussian),
            difference("subpixel_motion=false", FilterKind::kGaussian))
      << "only even densities can be turned";
}

// Two cards that pass each other: no pixel replays numbers of another object's, and each source serves one pixel.
TEST(TemporalGradientPath, NeverCrossesObjects) {
  TestShot shot;
  shot.orthographic(1);
  shot.add(quad({0, 0, 0}, {9, 0, 0}, {0, 9, 0}), make_diffuse(0.5f));
  AnimatedTransform moving;
  moving.keyed = true;
  moving.translation = {{-1, 1}, {Vec3d{-0.45, 0.1, 1}, Vec3d{0.45, -0.1, 1}}, Interpolation::kLinear};
  shot.add(quad({0, 0, 0}, {0.4f, 0, 0}, {0, 0.5f, 0}), make_diffuse(0.9f), shot.node(moving));
  Environment sky;
  sky.radiance = Rgb(1.0f);
  shot.scene.environments.push_back(sky);
  shot.settings.layers.push_back("object_id");
  const TestShot t = temporal(shot, 2);
  const Frame before = t.render(0), now = t.render(1);
  const Image& source = now.layer("offset.source");
  std::vector<int> used(32 * 32);
  int replayed = 0, on_card = 0;
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      if (source.at(x, y, 2) == 0) continue;
      const int sx = int(source.at(x, y, 0)), sy = int(source.at(x, y, 1));
      EXPECT_EQ(now.layer("object_id").at(x, y), before.layer("object_id").at(sx, sy)) << x << " " << y;
      EXPECT_EQ(used[sy * 32 + sx]++, 0);
      ++replayed;
      on_card += now.layer("object_id").at(x, y) == 2;
    }
  }
  EXPECT_GT(replayed, 700);
  EXPECT_GT(on_card, 100);
}

TEST(TemporalGradientPath, NeedsTwoSamplesAndSeedsOfItsOwn) {
  TestShot shot = temporal(BoxShot(make_diffuse(0.5f), nullptr), 1);
  EXPECT_THROW(shot.render(), Error);
  shot.settings.spp = 2;
  shot.settings.seed_per_frame = false;
  EXPECT_THROW(shot.render(), Error);
}

}  // namespace
}  // namespace tempera
