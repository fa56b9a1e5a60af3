// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/layers.h"

#include <gtest/gtest.h>

#include <set>

#include "test_files.h"

namespace tempera {
namespace {

std::vector<std::string> names_of(const std::vector<LayerDesc>& layers) {
  std::vector<std::string> names;
  for (const LayerDesc& d : layers) names.push_back(d.name);
  return names;
}

TEST(Layers, ChannelNamesInFiles) {
  EXPECT_EQ(layers::color().channel_name(0), "R");
  EXPECT_EQ(layers::color().channel_name(3), "A");
  EXPECT_EQ(layers::color_a().channel_name(2), "color.a.B");
  EXPECT_EQ(layers::motion_forward().channel_name(3), "motion.forward.V");
  EXPECT_EQ(layers::depth().channel_name(0), "depth.Z");
  EXPECT_EQ((LayerDesc{"u", {""}, "", Combine::kMean}.channel_name(0)), "u");
}

TEST(Layers, NamesAndChannelsOfTheVocabularyAreUnique) {
  std::set<std::string> names, channels;
  for (const LayerDesc& d : layers::known()) {
    EXPECT_TRUE(names.insert(d.name).second) << d.name;
    for (int c = 0; c < d.channel_count(); ++c) EXPECT_TRUE(channels.insert(d.channel_name(c)).second) << d.name;
    EXPECT_FALSE(d.unit.empty()) << d.name;
    ASSERT_TRUE(layers::find(d.name)) << d.name;
    EXPECT_EQ(*layers::find(d.name), d);
  }
}

TEST(Layers, FindsComposedNames) {
  ASSERT_TRUE(layers::find("class.dd.color"));
  EXPECT_EQ(layers::find("class.dd.color")->channels, (std::vector<std::string>{"R", "G", "B"}));
  EXPECT_EQ(*layers::find("class.mirror_1.motion.forward"), layers::class_layer("mirror_1", layers::motion_forward()));
  EXPECT_EQ(layers::find("class.dd.reflectance")->unit, units::kReflectance);
  EXPECT_EQ(*layers::find("offset.grad.x"), layers::offset(layers::grad_x()));
  EXPECT_EQ(*layers::find("offset.class.dd.color"), layers::offset(*layers::find("class.dd.color")));
  EXPECT_EQ(layers::find("CryptoMaterial02")->combine, Combine::kId);
  EXPECT_EQ(layers::derived(layers::color(), "denoised").name, "color.denoised");
  for (const char* bad : {"", "colour", "class.dd", "class..color", "class.d d.color", "class.dd.nothing", "offset.",
                          "offset.offset.color", "Crypto01", "CryptoObject0", "color.denoised"}) {
    EXPECT_FALSE(layers::find(bad)) << bad;
  }
}

TEST(Layers, SayWhatTheyAreToLaterSteps) {
  EXPECT_EQ(layers::color().role, LayerRole::kPicture);
  EXPECT_EQ(layers::color_variance().role, LayerRole::kStatistic);
  EXPECT_EQ(layers::albedo().role, LayerRole::kFeature);
  EXPECT_EQ(layers::samples().role, LayerRole::kFeature) << "true of the pixel, whatever is made of its light";
  EXPECT_EQ(layers::held_color().role, LayerRole::kReconstruction);
  EXPECT_EQ(layers::color().pass + layers::color().path_class, "");
  const LayerDesc part = *layers::find("offset.class.dd.grad.x");
  EXPECT_EQ(part.role, LayerRole::kReconstruction);
  EXPECT_EQ(part.pass, "offset");
  EXPECT_EQ(part.path_class, "dd");
  EXPECT_EQ(layers::find("class.dd.reflectance")->path_class, "dd");
  EXPECT_EQ(layers::derived(layers::color_a(), "denoised").role, LayerRole::kStatistic) << "as what it is made of";
}

TEST(Layers, ParsesUserInput) {
  EXPECT_EQ(names_of(parse_layer_names("albedo,normal, class.dd.color ,albedo")),
            (std::vector<std::string>{"albedo", "normal", "class.dd.color"}));
  EXPECT_EQ(names_of(parse_layer_names("motion,halves,cryptomatte")),
            (std::vector<std::string>{"motion.forward", "motion.backward", "color.a", "color.b", "CryptoObject00",
                                      "CryptoObject01", "CryptoObject02"}));
  EXPECT_TRUE(parse_layer_names("").empty());
}

TEST(Layers, ChainsByNameAndInGroups) {
  const std::vector<std::string> features = names_of(parse_layer_names("chain.TTTTD"));
  EXPECT_EQ(features, (std::vector<std::string>{"chain.TTTTD.albedo", "chain.TTTTD.normal", "chain.TTTTD.emission",
                                                "chain.TTTTD.depth", "chain.TTTTD.object_id"}));
  EXPECT_EQ(names_of(parse_layer_names("chains")).size(), 5 * features.size());
  EXPECT_EQ(test::error_of([] { parse_layer_names("chain.TRX"); }).code(), ErrorCode::kUnknownName);
  if (layers::chain_motion().empty()) {
    for (const char* name : {"chain_motion", "chain.RD.motion", "chain.RD.motion.forward", "chain.D.motion.state"}) {
      const Error e = test::error_of([&] { parse_layer_names(name, {"shot.toml", 4, 9}); });
      EXPECT_EQ(e.code(), ErrorCode::kUnsupported) << name;
      EXPECT_NE(e.message().find("TEMPERA_PATH_SPACE_MOTION"), std::string::npos) << e.message();
      EXPECT_EQ(e.message().find('\n'), std::string::npos);
      EXPECT_FALSE(layers::find(name));
    }
    return;
  }
  const std::vector<std::string> motion = names_of(parse_layer_names("chain.RD.motion"));
  EXPECT_EQ(motion,
            (std::vector<std::string>{"chain.RD.motion.forward", "chain.RD.motion.backward", "chain.RD.motion.state"}));
  EXPECT_EQ(names_of(parse_layer_names("chain_motion")).size(), 4 * motion.size()) << "all but D, which \"motion\" has";
  const LayerDesc state = *layers::find("chain.RD.motion.state");
  EXPECT_EQ(state.chain, "RD");
  EXPECT_EQ(state.combine, Combine::kId);
  EXPECT_FALSE(layers::find("motion.state")) << "of chains alone";
}

TEST(Layers, UnknownNamesListTheKnownOnesNearestFirst) {
  const Error e = test::error_of([] { parse_layer_names("albedo,normals", {"shot.toml", 4, 9}); });
  EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
  EXPECT_EQ(e.loc().line, 4);
  EXPECT_TRUE(e.message().starts_with("unknown layer \"normals\"; known: normal, ")) << e.message();
  for (const LayerDesc& d : layers::known()) EXPECT_NE(e.message().find(d.name), std::string::npos) << d.name;
}

}  // namespace
}  // namespace tempera
