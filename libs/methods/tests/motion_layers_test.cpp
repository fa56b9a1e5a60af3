// SPDX-License-Identifier: Apache-2.0
// Layers of motion are the same whatever method writes them.
#include "box_shot.h"
#include "tempera/transport/chain_features.h"

namespace tempera {
namespace {

/// A ball of glass that moves over a coated floor.
BoxShot moving_ball() {
  BoxShot shot(make_plastic({}), make_dielectric({}));
  shot.area_light();
  AnimatedTransform& ball = shot.scene.nodes[shot.scene.instances[5].node].local;
  ball = AnimatedTransform();
  ball.keyed = true;
  ball.translation = {{-2, 4}, {Vec3d{0.1, -0.5, 0.1}, Vec3d{0.4, -0.4, 0.1}}, Interpolation::kLinear};
  ball.scale = {{0}, {Vec3d{0.45, 0.45, 0.45}}, Interpolation::kLinear};
  shot.settings.spp = 2;
  shot.settings.layers = {"color", "motion.forward"};
  for (const LayerDesc& d : parse_layer_names(layers::chain_motion().empty() ? "" : "chain_motion"))
    shot.settings.layers.push_back(d.name);
  return shot;
}

TEST(MotionLayers, AreTheSameFromAllMethodsAndInAllTiles) {
  BoxShot shot = moving_ball();
  const Frame path = shot.render(1);
  if (!layers::chain_motion().empty()) {
    int tracked = 0;
    for (const float v : path.layer("chain.TTD.motion.state").values()) tracked += v == 1;
    EXPECT_GT(tracked, 30);
  }
  shot.tile = 5;
  for (const char* integrator : {"path", "gradient_path", "temporal_gradient_path"}) {
    shot.integrator = integrator;
    const Frame other = shot.render(1);
    for (const Layer& l : path.layers()) {
      if (l.desc.unit != units::kPixels && l.desc.unit != units::kMotionState) continue;
      EXPECT_EQ(l.image, other.layer(l.desc.name)) << integrator << ' ' << l.desc.name;
    }
  }
}

TEST(MotionLayers, OfChainsAskForNoFeaturesOfThem) {
  BoxShot shot = moving_ball();
  const auto method = shot.make_method();
  for (const LayerDesc& d : method->outputs(shot.settings)) {
    const auto is_this = [&](const LayerDesc& base) { return d == layers::chain_layer(d.chain, base); };
    EXPECT_FALSE(std::any_of(layers::chain_features().begin(), layers::chain_features().end(), is_this)) << d.name;
  }
  const Frame frame = make_frame(*method, shot.settings, shot.scene);
  EXPECT_TRUE(ChainFilm(&frame, 1, 1).features().empty());
}

}  // namespace
}  // namespace tempera
