// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <functional>

#include "box_shot.h"
#include "estimate.h"
#include "tempera/methods/render_section.h"

namespace tempera {
namespace {

MaterialPtr rough_metal() {
  ConductorParams p;
  p.roughness = {true, Microfacets::kGgx, 0.3f, 0.3f, true};
  return make_conductor(p);
}
MaterialPtr rough_plastic() {
  PlasticParams p;
  p.roughness = {true, Microfacets::kGgx, 0.3f, 0.3f, true};
  return make_plastic(p);
}
MaterialPtr rough_glass() {
  DielectricParams p;
  p.roughness = {true, Microfacets::kGgx, 0.4f, 0.4f, true};
  return make_dielectric(p);
}

struct Case {
  const char* name;
  std::function<BoxShot()> make;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class LightPathAgreesWithPath : public testing::TestWithParam<Case> {};

TEST_P(LightPathAgreesWithPath, InEveryBlock) {
  BoxShot shot = GetParam().make();
  shot.settings.spp = 64;
  const Estimate expected = estimate(shot, 0, {"color"});
  shot.integrator = "light_path";
  EXPECT_TRUE(agree(estimate(shot, 0, {"color"}), expected));
}

const MaterialPtr kWhite = make_diffuse(0.7f);

INSTANTIATE_TEST_SUITE_P(
    , LightPathAgreesWithPath,
    testing::Values(
        Case{"area", [] { return BoxShot(kWhite, make_diffuse(0.5f)).area_light(); }},
        Case{"spot", [] { return BoxShot(kWhite, rough_metal()).lamp(LightType::kSpot); }},
        Case{"point_and_sky", [] { return BoxShot(rough_metal(), kWhite).lamp(LightType::kPoint).sky(); }},
        Case{"directional", [] { return BoxShot(kWhite, rough_plastic()).lamp(LightType::kDirectional); }},
        Case{"rough_glass", [] { return BoxShot(kWhite, rough_glass()).area_light(); }},
        Case{"coarse_ball", [] { return BoxShot(kWhite, nullptr).coarse(make_diffuse(0.6f)).area_light(); }},
        Case{"mask",
             [] { return BoxShot(make_mask(0.4f, kWhite), make_mask(0.5f, rough_metal())).area_light().sky(); }},
        Case{"tent_filter",
             [] {
               BoxShot shot = BoxShot(kWhite, kWhite).area_light();
               shot.settings.filter = PixelFilter(FilterKind::kTent);
               return shot;
             }},
        Case{"thin_lens",
             [] {
               BoxShot shot = BoxShot(kWhite, kWhite).area_light();
               shot.scene.cameras[0].aperture_radius = 0.1f;
               shot.scene.cameras[0].focus_distance = 3.0f;
               return shot;
             }},
        Case{"hidden_ball",
             [] {
               BoxShot shot = BoxShot(kWhite, kWhite).area_light();
               shot.scene.instances[5].camera_visible = false;
               return shot;
             }}),
    [](const auto& c) { return std::string(c.param.name); });

// Light that a ball of clear glass focuses: what the method is for. Glass itself stays black.
TEST(LightPath, FindsCausticsOfClearGlass) {
  BoxShot shot = BoxShot(kWhite, make_dielectric({})).area_light(0.3f);
  shot.settings.spp = 256;
  shot.settings.classes = {{"diffuse", "ED.*"}, {"seen", "E"}};
  const Estimate expected = estimate(shot, 0, {"class.diffuse.color", "class.seen.color"});
  shot.settings.classes.clear();
  shot.settings.spp = 64;
  shot.integrator = "light_path";
  EXPECT_TRUE(agree(estimate(shot, 0, {"color"}), expected));
}

BoxShot moving_box() {
  BoxShot shot = BoxShot(kWhite, nullptr).area_light();
  AnimatedTransform pose;
  pose.keyed = true;
  pose.translation = {{0, 4}, {Vec3d{-0.6, -0.5, 0.1}, Vec3d{0.6, 0.3, 0.1}}, Interpolation::kLinear};
  pose.scale = Vec3d{0.4, 0.4, 0.4};
  shot.add(Sphere{}, kWhite, shot.node(pose));
  shot.settings.clock.shutter = {.open = -0.25, .close = 1.5, .shape = ShutterShape::kTrapezoid};
  return shot;
}

/// Frames of a section rendered in one go.
class LightSections : public testing::Test {
 protected:
  std::unique_ptr<Section> make(std::vector<int> frames) const {
    return std::make_unique<Section>(*method, shot.settings, shot.scene, kRange, std::move(frames),
                                     method->passes(shot.settings, kRange), 8);
  }
  void run(Section& section, const Part& part = {}, int threads = 2, int stop_after = 1 << 30) const {
    GeometryCache cache;
    const LightPathClassifier classifier;
    SceneWindow window(shot.scene, shot.settings, classifier, 1.0 / 16, cache, kRange);
    std::stop_source stop;
    std::atomic<int> left{stop_after};
    SectionHooks hooks;
    hooks.done = [&](const Unit&, const Frame*, const RenderTotals&) {
      if (--left == 0) stop.request_stop();
    };
    with_threads(threads, [&] { render_section(*method, window, section, part, hooks, stop.get_token()); });
  }
  static Bytes saved(const Section& section) {
    Bytes bytes;
    ByteWriter out(bytes);
    section.save(out);
    return bytes;
  }
  Image color(Section& section, int frame) const {
    section.finish(*method);
    return section.picture(frame).layer("color");
  }

  static constexpr FrameRange kRange{0, 3};
  BoxShot shot = [] {
    BoxShot s = moving_box();
    s.integrator = "light_path";
    s.parameters += ",section=4";
    s.settings.spp = 40;
    return s;
  }();
  std::unique_ptr<Method> method = shot.make_method();
};

// Exposures of neighbouring frames overlap: they share paths, and each frame still has the expected value of its own.
TEST_F(LightSections, FramesThatShareLightPathsAgreeWithPath) {
  EXPECT_EQ(method->section(shot.settings, {0, 9}, 5), (FrameRange{4, 7}));
  EXPECT_EQ(method->section(shot.settings, {0, 9}, 9), (FrameRange{8, 9}));
  BoxShot reference = moving_box();
  reference.settings.spp = 64;
  const Estimate expected = estimate(reference, 2, {"color"});
  const Estimate e = estimate([&](int seed) {
    shot.settings.seed = std::uint64_t(seed);
    const auto section = make({2});
    run(*section);
    return color(*section, 2);
  });
  EXPECT_TRUE(agree(e, expected));
}

TEST_F(LightSections, HaveTheSameBitsHoweverTheyAreRendered) {
  const auto whole = make({0, 1, 2, 3});
  run(*whole, {}, 1);
  ASSERT_TRUE(whole->is_done());
  const auto alone = make({2});
  run(*alone, {}, 8);

  // Stopped again and again, and continued from what was saved.
  auto stopped = make({0, 1, 2, 3});
  int stops = 0;
  for (; !stopped->is_done() && stops < 1000; ++stops) {
    run(*stopped, {}, 2, 7);
    auto next = make({0, 1, 2, 3});
    const Bytes bytes = saved(*stopped);
    ByteReader in(bytes);
    next->load(in);
    EXPECT_EQ(next->units_done(), stopped->units_done());
    stopped = std::move(next);
  }
  EXPECT_GT(stops, 3);

  // Three parts, added up in another order.
  std::vector<std::unique_ptr<Section>> parts;
  for (const int i : {2, 0, 1}) {
    const auto part = make({0, 1, 2, 3});
    run(*part, {i, 3});
    const Bytes bytes = saved(*part);
    ByteReader in(bytes);
    parts.push_back(Section::read(in));
  }
  EXPECT_NE(parts[0]->missing(), "");
  EXPECT_THROW(parts[0]->merge(*parts[0]), Error) << "its units would count twice";
  parts[0]->merge(*parts[1]);
  EXPECT_NE(parts[0]->missing().find("light"), std::string::npos);
  parts[0]->merge(*parts[2]);
  EXPECT_EQ(parts[0]->missing(), "");

  const Image of_whole = color(*whole, 2);
  EXPECT_EQ(color(*alone, 2), of_whole);
  EXPECT_EQ(color(*stopped, 2), of_whole);
  EXPECT_EQ(color(*parts[0], 2), of_whole);
  EXPECT_GT(of_whole.rgb(12, 10).r, 0);
}

TEST(SplatFilm, AddsUpInAnyOrderAndCountsWhatIsTooLarge) {
  SplatFilm a(1, 2, 1, 1000), b(1, 2, 1, 1000);
  std::vector<Rgb> values;
  for (int i = 0; i < 1000; ++i) values.push_back(Rgb{1e-7f * float(i), 0.9f / float(i + 1), -0.01f * float(i % 7)});
  for (const Rgb& v : values) a.add(0, 1, 0, v);
  for (std::size_t i = values.size(); i-- > 0;) b.add(0, 1, 0, values[i]);
  EXPECT_EQ(a.image(0, 1), b.image(0, 1));
  double sum = 0;
  for (const Rgb& v : values) sum += double(v.g);
  EXPECT_NEAR(a.image(0, 0.5).rgb(1, 0).g, 0.5 * sum, 1e-6 * sum);
  EXPECT_EQ(a.lost(), 0u);
  a.add(0, 0, 0, Rgb{600, 1001, 0});
  a.add(0, 0, 0, Rgb{600, 0, 0});
  EXPECT_EQ(a.lost(), 2u);
  EXPECT_NEAR(a.image(0, 1).rgb(0, 0).r, 600, 1e-3);
  Bytes bytes;
  ByteWriter out(bytes);
  a.save(out);
  ByteReader in(bytes);
  b.load(in);
  EXPECT_EQ(b.lost(), 2u);
  b.merge(a);
  EXPECT_EQ(b.lost(), 5u) << "its sum of 600 does not fit twice";
  ByteReader other(bytes);
  SplatFilm narrow(1, 2, 1, 10);
  EXPECT_THROW(narrow.load(other), Error);
}

TEST(LightPath, RefusesWhatItCannotWrite) {
  BoxShot shot = BoxShot(kWhite, nullptr).area_light();
  shot.integrator = "light_path";
  const auto method = shot.make_method();
  const auto key = [&](const std::function<void(RenderSettings&)>& change) {
    RenderSettings s = shot.settings;
    change(s);
    try {
      method->outputs(s);
    } catch (const SettingError& e) {
      return e.key();
    }
    return std::string();
  };
  EXPECT_EQ(key([](RenderSettings&) {}), "");
  EXPECT_EQ(key([](RenderSettings& s) { s.classes = {{"a", "ED"}}; }), "classes");
  EXPECT_EQ(key([](RenderSettings& s) { s.clock.shutter.rolling = 0.5; }), "shutter.rolling");
  EXPECT_EQ(key([](RenderSettings& s) { s.layers = {"color", "color.var"}; }), "output.layers");
  EXPECT_EQ(key([](RenderSettings& s) { s.spp = 1 << 24; }), "sampling.spp");
}

}  // namespace
}  // namespace tempera
