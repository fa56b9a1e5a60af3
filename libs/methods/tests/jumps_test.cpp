// SPDX-License-Identifier: Apache-2.0
// What jumps within an exposure is seen in each of its places for its share of the time.
#include <gtest/gtest.h>

#include "test_shot.h"

namespace tempera {
namespace {

/// A glowing square in front of an orthographic camera whose picture is [-1, 1]^2; exposed for a second.
struct Jumping : TestShot {
  Jumping() {
    settings.width = settings.height = 8;
    settings.spp = 4096;
    settings.sampler = SamplerKind::kSobol;
    settings.clock.shutter = {.open = 0, .close = 1};
    orthographic(1);
  }
  void glow(AnimatedTransform place, Slot radiance = Slot(1.0f)) {
    Affine3d small = scale(Vec3d{0.25, 0.25, 1});
    const int n = node(std::move(place));
    scene.nodes.push_back({n, small, "", 1.0f});
    add(make_rectangle(), make_black(), int(scene.nodes.size()) - 1).emission = AreaEmission{std::move(radiance), true};
  }
};

AnimatedTransform stepping(std::vector<double> times, std::vector<Vec3d> places) {
  AnimatedTransform t;
  t.keyed = true;
  t.translation = {std::move(times), std::move(places), Interpolation::kStep};
  return t;
}

TEST(Jumps, EachPoseHasItsShareOfTheExposure) {
  for (const char* name : {"path", "gradient_path", "temporal_gradient_path"}) {
    Jumping shot;
    shot.integrator = name;
    shot.glow(stepping({0, 0.3}, {{-0.75, 0, 0}, {0.75, 0, 0}}));
    shot.settings.clock.shutter.close = 1;
    const Frame out = shot.render();
    const Image& color = out.layer("color");
    for (int x = 0; x < 8; ++x) {
      EXPECT_NEAR(color.at(x, 4), x < 2 ? 0.3 : x > 5 ? 0.7 : 0, 0.002) << name << " " << x;
    }
  }
}

TEST(Jumps, TheCameraDoesNotFly) {
  Jumping shot;
  shot.glow(AnimatedTransform{});
  Node& camera = shot.scene.nodes[shot.scene.cameras[0].node];
  camera.local.keyed = true;
  const Affine3d pose = camera.local.matrix;
  camera.local.rotation = axis_angle(Vec3d{0, 1, 0}, kPiD);
  camera.local.translation = {{0, 0.4}, {pose.translation, pose.translation + Vec3d{0.75, 0, 0}}, Interpolation::kStep};
  const Frame out = shot.render();
  double sum = 0;
  for (int x = 0; x < 8; ++x) sum += out.layer("color").at(x, 4);
  EXPECT_NEAR(out.layer("color").at(3, 4), 0.4, 0.002);
  EXPECT_NEAR(out.layer("color").at(4, 4), 0.4, 0.002);
  EXPECT_NEAR(sum, 0.4 * 2 + 0.6 * 2, 0.004);
}

TEST(Jumps, WhatLightsAtAnyTimeOfTheExposureIsSampled) {
  // A lamp and a bulb that are dark in the middle of the exposure light a floor; so does one that is there at its end.
  for (const int kind : {0, 1, 2}) {
    TestShot shot;
    shot.orthographic(1);
    shot.settings.width = shot.settings.height = 4;
    shot.settings.spp = 4096;
    shot.settings.clock.shutter = {.open = 0, .close = 1};
    shot.add(make_rectangle(), make_diffuse(Slot(1.0f)), shot.node(Affine3d(scale(Vec3d{20, 20, 1}))));
    const Animated<float> on({0, 0.2, 0.9}, {1, 0, 1}, Interpolation::kStep);  // 0.3 of the time
    const int place = shot.node(Affine3d(translate(Vec3d{0, 0, 2}) * rotation(axis_angle(Vec3d{0, 1, 0}, kPiD))));
    double irradiance = 0;
    if (kind == 1) {
      PunctualLight bulb;
      bulb.node = place;
      bulb.intensity = Rgb(3);
      bulb.intensity_scale = on;
      shot.scene.lights.push_back(bulb);
      irradiance = 3.0 / 4;
    } else {
      Shape& lamp = shot.add(Sphere{Affine3f(scale(Vec3f{0.1f, 0.1f, 0.1f}))}, make_black(), place);
      lamp.emission = AreaEmission{Slot(10.0f), true};
      if (kind == 0) {
        lamp.emission->radiance = Slot(Animated<Rgb>({0, 0.2, 0.9}, {Rgb(10), Rgb(0), Rgb(10)}, Interpolation::kStep));
      } else {
        shot.scene.nodes[place].visibility = on;
      }
      shot.scene.instances.back().camera_visible = false;
      irradiance = kPiD * 10 * 0.01 / 4;
    }
    shot.parameters = "max_depth=2,hide_emitters=true";
    shot.scene.cameras[0].far_clip = 100;
    const Frame out = shot.render();
    double mean = 0;
    // From the side of the lamp the middle of the picture is hidden.
    for (const auto& [x, y] : {std::pair{0, 0}, {3, 0}, {0, 3}, {3, 3}}) mean += out.layer("color").at(x, y) / 4;
    const double r2 = 2 * 0.75 * 0.75 + 4, cosine = 2 / std::sqrt(r2);
    EXPECT_NEAR(mean, 0.3 * irradiance * 4 / r2 * cosine / kPiD, 0.03 * mean) << kind;
  }
}

TEST(Jumps, MotionVectorsEndAtACut) {
  Jumping shot;
  shot.settings.spp = 4;
  shot.settings.layers = {"color", "motion.forward", "motion.backward"};
  shot.glow(AnimatedTransform{});
  shot.settings.cuts = {1};
  const Frame before = shot.render(0), after = shot.render(1);
  EXPECT_EQ(before.layer("motion.forward").at(4, 4, 3), 0);
  EXPECT_EQ(before.layer("motion.backward").at(4, 4, 3), 1);
  EXPECT_EQ(after.layer("motion.forward").at(4, 4, 3), 1);
  EXPECT_EQ(after.layer("motion.backward").at(4, 4, 3), 0);
  shot.integrator = "temporal_gradient_path";
  shot.settings.layers = {"color"};
  const Frame cut = shot.render(1), whole = shot.render(2);
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) {
      EXPECT_EQ(cut.layer("offset.source").at(x, y, 2), 0);
      EXPECT_EQ(whole.layer("offset.source").at(x, y, 2), 1);
    }
  }
}

}  // namespace
}  // namespace tempera
