// SPDX-License-Identifier: Apache-2.0
// Features of what is seen in mirrors and through glass.
#include "box_shot.h"

namespace tempera {
namespace {

/// A wall at z = 0, seen straight on from z = 5, and what stands before it.
TestShot wall() {
  TestShot shot;
  shot.add(quad({0, 0, 0}, {4, 0, 0}, {0, 4, 0}), make_diffuse(Rgb{0.2f, 0.5f, 0.8f}));
  shot.orthographic(1);
  shot.settings.width = shot.settings.height = 8;
  shot.settings.spp = 256;
  shot.settings.layers = {"albedo"};
  for (const char* chain : {"D", "RD", "TD", "TTD"}) {
    for (const LayerDesc& d : layers::chain_features())
      shot.settings.layers.push_back(layers::chain_layer(chain, d).name);
  }
  Environment sky;
  sky.radiance = Rgb(1.0f);
  sky.width = sky.height = 1;
  sky.image = {Rgb(1.0f)};
  shot.scene.environments.push_back(sky);
  return shot;
}
Rgb mean(const Image& image) {
  Rgb sum;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) sum += image.rgb(x, y);
  }
  return sum * (1 / float(image.pixels()));
}

TEST(ChainFeatures, OfAWallSeenDirectly) {
  const Frame f = wall().render();
  EXPECT_EQ(f.layer("chain.D.albedo").rgb(3, 3), f.layer("albedo").rgb(3, 3));
  EXPECT_NEAR(f.layer("chain.D.normal").at(3, 3, 2), 1, 1e-6f);
  EXPECT_NEAR(f.layer("chain.D.depth").at(3, 3), 5, 1e-5f);
  EXPECT_EQ(f.layer("chain.D.object_id").at(3, 3), 1);
  EXPECT_EQ(mean(f.layer("chain.TTD.albedo")), Rgb(0.0f));
  EXPECT_EQ(f.layer("chain.RD.object_id").at(3, 3), 0);
}

// Two sides of a pane: each sends 4 % back, which with what goes back and forth leaves (1 - F) / (1 + F) of the light;
// of the chain TTD, what passes both at once.
TEST(ChainFeatures, BehindGlass) {
  TestShot shot = wall();
  for (const float side : {1.0f, -1.0f})
    shot.add(quad({0, 0, 2 + 0.05f * side}, {side * 2, 0, 0}, {0, 2, 0}), make_dielectric({}));
  const Frame f = shot.render();
  const double fresnel = sqr(0.5046 / 2.5046), through = sqr(1 - fresnel);  // of 1.5046 against 1
  const Rgb albedo = mean(f.layer("chain.TTD.albedo"));
  EXPECT_NEAR(double(albedo.g), 0.5 * through, 0.02);
  EXPECT_NEAR(double(albedo.r / albedo.b), 0.25, 1e-4);
  EXPECT_EQ(mean(f.layer("chain.D.albedo")), Rgb(0.0f));
  EXPECT_EQ(f.layer("chain.TTD.object_id").at(3, 3), 1);
  EXPECT_NEAR(f.layer("chain.TTD.depth").at(3, 3), 5, 1e-4f);
  EXPECT_NEAR(f.layer("chain.TTD.normal").at(3, 3, 2), 1, 1e-5f);
  EXPECT_EQ(mean(f.layer("chain.TD.albedo")), Rgb(0.0f)) << "inside of glass nothing scatters";
}

// Lacquer over wood: the wood is the end of one chain, and what the lacquer mirrors of another.
TEST(ChainFeatures, OneSampleFeedsSeveralChains) {
  TestShot shot = wall();
  shot.scene.shapes[0].material = make_plastic({});
  shot.add(quad({0, 0, 6}, {-20, 0, 0}, {0, 20, 0}), make_diffuse(Rgb{0.9f, 0.1f, 0.1f}));  // behind the camera
  const Frame f = shot.render();
  const Rgb base = mean(f.layer("chain.D.albedo")), mirrored = mean(f.layer("chain.RD.albedo")),
            all = mean(f.layer("albedo"));
  EXPECT_EQ(f.layer("chain.D.object_id").at(3, 3), 1);
  EXPECT_EQ(f.layer("chain.RD.object_id").at(3, 3), 2);
  EXPECT_NEAR(f.layer("chain.RD.depth").at(3, 3), 5 + 6, 1e-4f);
  const float coat = all.g - base.g;  // the share that the lacquer mirrors
  EXPECT_NEAR(coat, 0.04f, 0.005f);
  EXPECT_NEAR(mirrored.r / 0.9f, coat, 0.15f * coat);
  EXPECT_NEAR(mirrored.g / mirrored.r, 1 / 9.0f, 1e-4f);
}

/// Asks for what all chains together show, too.
TestShot with_any(TestShot shot) {
  for (const LayerDesc& d : layers::chain_features())
    shot.settings.layers.push_back(layers::chain_layer(layers::kAnyChain, d).name);
  return shot;
}

// All chains together see a pane's far side by every number of passes between its surfaces, and the sky that it mirrors.
TEST(ChainFeatures, OfAnyChainBehindGlass) {
  TestShot shot = with_any(wall());
  for (const float side : {1.0f, -1.0f})
    shot.add(quad({0, 0, 2 + 0.05f * side}, {side * 2, 0, 0}, {0, 2, 0}), make_dielectric({}));
  const Frame f = shot.render();
  const double fresnel = sqr(0.5046 / 2.5046), passes = (1 - fresnel) / (1 + fresnel);
  const Rgb albedo = mean(f.layer("chain.any.albedo")), first = mean(f.layer("chain.TTD.albedo"));
  const double mirrored = 1 - passes;  // of the sky behind the camera, as white as can be
  EXPECT_NEAR(double(albedo.g), 0.5 * passes + mirrored, 0.02);
  EXPECT_NEAR(double(albedo.b - albedo.r), 0.6 * passes, 0.02);
  EXPECT_GT(albedo.b - albedo.r, first.b - first.r) << "what went back and forth";
  EXPECT_EQ(f.layer("chain.any.object_id").at(3, 3), 1);
}

TEST(ChainFeatures, OfAnyChainAreThoseOfAllChains) {
  TestShot shot = with_any(wall());
  const Frame bare = shot.render();
  EXPECT_EQ(bare.layer("chain.any.albedo").rgb(3, 3), bare.layer("chain.D.albedo").rgb(3, 3));
  EXPECT_EQ(bare.layer("chain.any.normal").rgb(3, 3), bare.layer("chain.D.normal").rgb(3, 3));
  EXPECT_NEAR(bare.layer("chain.any.depth").at(3, 3), 5, 1e-4f);
  // Lacquer over wood: what it shows of itself and what it mirrors.
  shot.scene.shapes[0].material = make_plastic({});
  shot.add(quad({0, 0, 6}, {-20, 0, 0}, {0, 20, 0}), make_diffuse(Rgb{0.9f, 0.1f, 0.1f}));
  const Frame f = shot.render();
  const Rgb all = mean(f.layer("chain.any.albedo")), base = mean(f.layer("chain.D.albedo")),
            mirrored = mean(f.layer("chain.RD.albedo"));
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(all[c], base[c] + mirrored[c], 0.002f);
  EXPECT_EQ(f.layer("chain.any.object_id").at(3, 3), 1);
  // A lamp has no reflectance, and in a mirror counts as white.
  TestShot lamp = with_any(wall());
  lamp.scene.shapes[0].material = make_conductor({});
  lamp.settings.layers.push_back("emission");
  lamp.add(quad({0, 0, 6}, {-20, 0, 0}, {0, 20, 0}), make_diffuse(Rgb(0.0f)));
  lamp.scene.shapes[1].emission = AreaEmission{Slot(7.0f), true};
  const Frame mirror = lamp.render();
  const Rgb reflectance = mean(mirror.layer("albedo"));
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(mean(mirror.layer("chain.any.albedo"))[c], reflectance[c], 0.02f);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(mean(mirror.layer("chain.any.emission"))[c], 7 * reflectance[c], 0.2f);
}

TEST(ChainFeatures, FurtherSamplesChangeFeaturesAlone) {
  TestShot shot = wall();
  for (const float side : {1.0f, -1.0f})
    shot.add(quad({0, 0, 2 + 0.05f * side}, {side * 2, 0, 0}, {0, 2, 0}), make_dielectric({}));
  shot.settings.spp = 4;
  const Frame few = shot.render();
  shot.parameters = "feature_samples=252";
  const Frame many = shot.render();
  EXPECT_EQ(few.layer("color"), many.layer("color"));
  shot.settings.spp = 256;
  shot.parameters = "";
  const Frame same = shot.render();  // the samples of 256 do the same as 4 and 252 that look at features alone
  for (const char* name : {"chain.TTD.albedo", "chain.TTD.normal", "albedo"}) {
    const std::span<const float> a = many.layer(name).values(), b = same.layer(name).values();
    for (std::size_t i = 0; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 2e-5f) << name;
  }
  EXPECT_NE(few.layer("chain.TTD.albedo"), many.layer("chain.TTD.albedo"));
}

// Tables of what is filtered apart: which chains the classes of the default decomposition are seen by.
TEST(ChainFeatures, OfTheDefaultDecomposition) {
  std::vector<std::string> found, expressions;
  for (const PathClass& c : default_decomposition()) {
    std::string line = c.name + ":";
    for (const std::string& chain : chains_of_class(c)) line += " " + chain;
    found.push_back(line);
    expressions.push_back(c.expression);
  }
  EXPECT_EQ(found, (std::vector<std::string>{"emission:", "direct: D", "indirect: D", "caustic: D", "reflection: RD",
                                             "transmission: TD TTD"}));
  EXPECT_FALSE(LightPathClassifier(expressions).overlap());
}

TEST(ChainFeatures, OfOtherClasses) {
  EXPECT_EQ(chains_of_class({"trans4", "ETTTTD.*"}), (std::vector<std::string>{"TTTTD"}));
  EXPECT_EQ(chains_of_class({"mirrors", "ER+D.*"}),
            (std::vector<std::string>{"RD", "RRD", "RRRD", "RRRRD", "RRRRRD", "RRRRRRD"}));
  EXPECT_EQ(chains_of_class({"all", "E.*"}).size(), 15u) << "those of up to three events";
}

}  // namespace
}  // namespace tempera
