// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/caustics.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

/// A ball of `material` between a light from above and the ground that a camera looks down on.
Scene scene(MaterialPtr material) {
  Scene s;
  s.source = "scene.xml";
  const auto node = [&](const Affine3d& pose) {
    s.nodes.push_back({-1, AnimatedTransform(pose), "", 1.0f});
    return int(s.nodes.size()) - 1;
  };
  const auto add = [&](Geometry geometry, MaterialPtr of, int at) {
    s.shapes.push_back({std::move(geometry), std::move(of), std::nullopt, "", ""});
    s.groups.push_back({int(s.shapes.size()) - 1});
    s.instances.push_back({int(s.groups.size()) - 1, at, "shape", true});
  };
  add(make_rectangle(), make_diffuse(0.7f), -1);
  add(Sphere{}, std::move(material), node(Affine3d(translate(Vec3d{0, 0, 0.6}) * scale(Vec3d{0.3, 0.3, 0.3}))));
  Camera camera;
  camera.node = node(Affine3d(look_at(Vec3f{0, 2, 2}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
  camera.fov_x = 0.8f;
  s.cameras.push_back(camera);
  PunctualLight light;
  light.type = LightType::kDirectional;
  light.node = node(Affine3d(look_at(Vec3f{0, 0, 5}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
  s.lights.push_back(light);
  return s;
}

Shot settle(Scene& s, const std::string& toml) {
  ShotConfig c;
  c.read_text("scene = \"scene.xml\"\n[film]\nresolution = [96, 54]\n" + toml, "shot.toml", ".");
  return settle_shot(c, s);
}
Shot with_quality(Scene& s, const char* quality, const std::string& toml = "") {
  ShotConfig c;
  c.read_text("scene = \"scene.xml\"\nquality = \"" + std::string(quality) + "\"\n" + toml, "shot.toml", ".");
  return settle_shot(c, s);
}
std::string caustics(const Shot& shot) { return shot.params.get_string("caustics"); }

TEST(Caustics, AreLeftToPhotonsByAQualityWhereTheyAreSeen) {
  Scene glass = scene(make_dielectric({})), wall = scene(make_diffuse(0.5f));
  EXPECT_EQ(caustics(with_quality(glass, "final")), "photons");
  EXPECT_EQ(caustics(with_quality(glass, "draft", "[integrator]\nname = \"temporal_gradient_path\"\n")), "photons");
  EXPECT_EQ(caustics(with_quality(wall, "final")), "paths");
  EXPECT_EQ(caustics(settle(glass, "")), "paths") << "nothing was asked for";
  EXPECT_EQ(caustics(with_quality(glass, "final", "[integrator]\ncaustics = \"paths\"\n")), "paths") << "it is said";
  with_quality(glass, "final", "[integrator]\nname = \"light_path\"\n");  // which has no such choice
  // Where the camera looks away there are some, but none to be seen.
  glass.nodes[glass.cameras[0].node].local =
      AnimatedTransform(Affine3d(look_at(Vec3f{0, 0, 4}, Vec3f{0, 0, 8}, Vec3f{0, 1, 0})));
  EXPECT_EQ(caustics(with_quality(glass, "final")), "paths");
}

TEST(Caustics, AreSurveyedWithTheShotsPhotons) {
  Scene glass = scene(make_dielectric({})), wall = scene(make_diffuse(0.5f));
  EXPECT_FALSE(survey_photons(glass, settle(glass, "")));
  const auto survey = [](Scene& s, const char* name) {
    return survey_photons(s, settle(s, "[integrator]\nname = \"" + std::string(name) + "\"\nphotons = 9000\n"));
  };
  const auto found = survey(glass, "temporal_photon");
  ASSERT_TRUE(found);
  EXPECT_EQ(found->casters, 1);
  EXPECT_NEAR(double(found->counts.emitted), 9000, 90);
  EXPECT_GT(found->counts.stored, 1000);
  const PhotonCounts& c = found->counts;
  EXPECT_NEAR(c.stored_flux + c.escaped_flux + c.absorbed_flux, c.emitted_flux, 1e-3 * c.emitted_flux);
  EXPECT_NEAR(double(survey(glass, "time_photon")->counts.emitted), 9000, 90) << "all instants together";
  EXPECT_EQ(survey(wall, "temporal_photon")->casters, 0);
}

}  // namespace
}  // namespace tempera
