// SPDX-License-Identifier: Apache-2.0
// Complete pictures with caustics by photons, against path tracing.
#include <array>
#include <functional>

#include "box_shot.h"
#include "estimate.h"
#include "tempera/methods/render_section.h"
#include "tempera/photons/photon_tracer.h"

namespace tempera {
namespace {

const MaterialPtr kWhite = make_diffuse(0.7f);

MaterialPtr glass(float alpha = 0) {
  DielectricParams p;
  if (alpha > 0) p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_dielectric(p);
}
MaterialPtr metal(float alpha) {
  ConductorParams p;
  if (alpha > 0) p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  p.eta = Rgb(0.2f), p.k = Rgb(3.0f);
  return make_conductor(p);
}
MaterialPtr plastic() { return make_plastic({}); }

struct Case {
  const char* name;
  std::function<BoxShot()> make;
  int spp = 256;  ///< of path tracing
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

BoxShot sun(BoxShot shot, float degrees) {
  PunctualLight light;
  light.type = LightType::kDirectional;
  light.angle = degrees * kPi / 180;
  light.intensity = Rgb(3.0f);
  light.node = shot.node(Affine3d(look_at(Vec3f{-0.2f, 0.9f, 2.5f}, Vec3f{0.2f, -0.5f, 0}, Vec3f{0, 1, 0})));
  shot.scene.lights.push_back(light);
  return shot;
}

/// All light, and that which photons stand for.
struct Estimates {
  Estimate all, caustics;
};
Estimates estimates(BoxShot shot, int frame) {
  shot.settings.classes = {{"caustics", kPhotonPaths}};
  std::vector<Frame> frames;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    shot.settings.seed = std::uint64_t(seed);
    frames.push_back(shot.render(frame));
  }
  const auto of = [&](const char* layer) { return estimate([&](int seed) { return frames[seed - 1].layer(layer); }); };
  return {of("color"), of("class.caustics.color")};
}

/// Whether photons find what path tracing does. `blur`: which part of the caustics of a block footprints may carry to its
/// neighbours.
void expect_agreement(BoxShot shot, int frame, int path_spp, int spp, double blur, const char* more = "") {
  shot.settings.spp = path_spp;
  const Estimates expected = estimates(shot, frame);
  shot.integrator = "temporal_photon";
  shot.parameters += std::string(",photons=25000") + more;
  shot.settings.spp = spp;
  const Estimates found = estimates(shot, frame);
  EXPECT_TRUE(agree(found.all, expected.all, 1e-3, 0.02));
  EXPECT_TRUE(agree(found.caustics, expected.caustics, 1e-3, blur));
}

class PhotonsAgreeWithPath : public testing::TestWithParam<Case> {};

TEST_P(PhotonsAgreeWithPath, InEveryBlock) { expect_agreement(GetParam().make(), 0, GetParam().spp, 32, 0.06); }

INSTANTIATE_TEST_SUITE_P(
    , PhotonsAgreeWithPath,
    testing::Values(Case{"glass_ball", [] { return BoxShot(kWhite, glass()).area_light(); }},
                    Case{"sun_of_4_degrees", [] { return sun(BoxShot(kWhite, glass()), 4); }},
                    Case{"glossy_floor", [] { return BoxShot(metal(0.3f), glass()).area_light(); }},
                    Case{"mirror_floor", [] { return BoxShot(metal(0), glass()).area_light(); }},
                    Case{"coated_floor", [] { return BoxShot(plastic(), metal(0)).area_light(); }},
                    Case{"coated_ball", [] { return BoxShot(kWhite, plastic()).area_light(); }},
                    Case{"sharp_metal", [] { return BoxShot(kWhite, metal(0.05f)).area_light(); }},
                    Case{"nearly_smooth_glass", [] { return BoxShot(kWhite, glass(0.05f)).area_light(); }},
                    Case{"nearly_smooth_water",
                         [] {
                           BoxShot shot = BoxShot(kWhite, nullptr).area_light();
                           shot.add(quad({0, -0.5f, 0}, {1, 0, 0}, {0, 0, -1}), glass(0.05f));
                           return shot;
                         }},
                    Case{"masked_ball", [] { return BoxShot(kWhite, make_mask(0.6f, glass())).area_light(); }},
                    Case{"pane",
                         [] {
                           BoxShot shot = BoxShot(kWhite, metal(0)).area_light();
                           DielectricParams p;
                           p.thin = true;
                           shot.add(quad({0.1f, 0.3f, 0.1f}, {0.5f, 0.1f, 0}, {0, 0, 0.5f}), make_dielectric(p));
                           return shot;
                         }},
                    Case{"flat_ball_of_a_coarse_mesh",
                         [] {
                           BoxShot shot = BoxShot(kWhite, nullptr).coarse(glass()).area_light();
                           shot.scene.bend_normals = false;
                           return shot;
                         }},
                    Case{"environment_with_a_sun", [] { return BoxShot(kWhite, glass()).sky_with_a_sun(); }, 512},
                    Case{"sky_is_left_to_paths", [] { return BoxShot(kWhite, glass()).sky().area_light(); }}),
    [](const auto& c) { return std::string(c.param.name); });

BoxShot moving_glass() {
  BoxShot shot = BoxShot(kWhite, nullptr).area_light();
  AnimatedTransform pose;
  pose.keyed = true;
  pose.translation = {{0, 4}, {Vec3d{-0.4, -0.4, 0.1}, Vec3d{0.8, 0.3, 0.1}}, Interpolation::kLinear};
  pose.scale = Vec3d{0.4, 0.4, 0.4};
  shot.add(Sphere{}, glass(), shot.node(pose));
  shot.settings.clock.shutter = {.open = 0, .close = 1};
  return shot;
}

// Swept footprints, and those of a moving camera's samples, stand for the exposure.
TEST(Photons, OfMovingGlassAgreeWithPath) {
  for (const char* gauge : {",gauge=matter", ",gauge=emission"}) {
    SCOPED_TRACE(gauge);
    expect_agreement(moving_glass(), 1, 256, 32, 0.1, gauge);
  }
}

TEST(Photons, OfAMovingCameraAgreeWithPath) {
  BoxShot shot = moving_glass();
  AnimatedTransform pose = shot.scene.nodes[shot.scene.cameras[0].node].local;
  const Affine3d a(look_at(Vec3f{0.1f, 0.1f, 3.2f}, Vec3f{0, -0.1f, 0}, Vec3f{0, 1, 0}));
  pose.keyed = true;
  pose.translation = {
      {0, 4}, {a.translation - Vec3d{0.6, 0, 0}, a.translation + Vec3d{1, 0.3, 0}}, Interpolation::kLinear};
  pose.rotation = quaternion(a);
  shot.scene.nodes[shot.scene.cameras[0].node].local = pose;
  expect_agreement(shot, 1, 256, 64, 0.1);
}

// The floor slides away under a caustic that stays where it is.
TEST(Photons, StayInTheWorldOnAMovingReceiver) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light();
  AnimatedTransform slide;
  slide.keyed = true;
  slide.translation = {{0, 4}, {Vec3d{-2, 0, 0}, Vec3d{2, 0, 0}}, Interpolation::kLinear};
  shot.scene.instances[0].node = shot.node(slide);
  shot.scene.instances[0].name = "floor";
  for (Vec3f& p : std::get<Mesh>(shot.scene.shapes[0].geometry).positions) p.x *= 4;
  shot.settings.clock.shutter = {.open = 0, .close = 1};
  expect_agreement(shot, 1, 256, 64, 0.1);
}

Frame rendered(BoxShot shot, const char* integrator, int threads = 0) {
  shot.integrator = integrator;
  shot.parameters += ",photons=3000";
  std::optional<Frame> frame;
  with_threads(threads, [&] { frame.emplace(shot.render(1)); });
  return std::move(*frame);
}

TEST(Photons, HaveTheBitsOfStaticOnesWhereNothingMoves) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light();
  shot.settings.spp = 4;
  shot.settings.clock.shutter = {.open = 0, .close = 1};
  EXPECT_EQ(values(rendered(shot, "temporal_photon").layer("color")),
            values(rendered(shot, "photon_differentials").layer("color")));
}

TEST(Photons, HaveTheSameBitsForAnyThreadsAndTiles) {
  BoxShot shot = moving_glass();
  shot.settings.spp = 4;
  const auto expected = values(rendered(shot, "temporal_photon", 1).layer("color"));
  EXPECT_EQ(values(rendered(shot, "temporal_photon", 3).layer("color")), expected);
  shot.tile = 7;
  EXPECT_EQ(values(rendered(shot, "temporal_photon", 2).layer("color")), expected);
}

TEST(Photons, AddUpWithClasses) {
  BoxShot shot = moving_glass();
  shot.settings.spp = 8;
  shot.settings.layers = {"color"};
  shot.settings.classes = {{"caustic", "ED[RT]+"}, {"direct", "ED"}, {"seen_caustic", "E[RT]+D[RT]+"}};
  shot.settings.classes_are_decomposition = true;
  const Frame f = rendered(shot, "temporal_photon");
  double caustic = 0;
  for (int y = 0; y < f.height(); ++y) {
    for (int x = 0; x < f.width(); ++x) {
      Rgb sum;
      for (const char* name : {"caustic", "direct", "seen_caustic", "residual"})
        sum += f.layer(std::string("class.") + name + ".color").rgb(x, y);
      EXPECT_NEAR(luminance(sum), luminance(f.layer("color").rgb(x, y)), 1e-4);
      caustic += double(luminance(f.layer("class.caustic.color").rgb(x, y)));
    }
  }
  EXPECT_GT(caustic, 1);
}

// Passes with ever smaller footprints, that each stand for ever less of an exposure, find what one of them blurs.
TEST(Photons, PassesConverge) {
  BoxShot shot = moving_glass();
  shot.settings.classes = {{"caustics", kPhotonPaths}};
  const std::string common = shot.parameters;
  const auto caustics = [&](const char* integrator, const std::string& more, int spp) {
    shot.settings.spp = spp;
    shot.integrator = integrator;
    shot.parameters = common + more;
    return values(shot.render(1).layer("class.caustics.color"));
  };
  const std::vector<float> reference = caustics("path", "", 4096);
  const auto error = [&](const std::string& more) {
    const std::vector<float> v = caustics("temporal_photon", more, 128);
    double sum = 0;
    for (std::size_t i = 0; i < v.size(); ++i) sum += sqr(double(v[i]) - double(reference[i]));
    return sum;
  };
  const double passes = error(",photons=1000,progressive=32");
  EXPECT_LT(passes, 0.6 * error(",photons=1000"));
  EXPECT_LT(passes, 0.7 * error(",photons=32000")) << "one instant is not enough for glass that moves by its radius";
}

TEST(Photons, PassesHaveTheSameBitsForAnyThreadsAndTiles) {
  BoxShot shot = moving_glass();
  shot.settings.spp = 10;
  shot.parameters += ",progressive=3";
  const Frame expected = rendered(shot, "temporal_photon", 1);
  EXPECT_EQ(expected.layer("color"), rendered(shot, "temporal_photon", 3).layer("color"));
  shot.tile = 7;
  EXPECT_EQ(expected.layer("color"), rendered(shot, "temporal_photon", 2).layer("color"));
}

// Each half of two stands for all light, as one set of photons does.
TEST(Photons, HalvesHoldTheSameLight) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light();
  shot.settings.spp = 64;
  shot.settings.classes = {{"caustics", kPhotonPaths}};
  shot.integrator = "temporal_photon";
  shot.parameters += ",photons=30000";
  const auto sum = [](const Image& image) {
    double s = 0;
    for (const float v : image.values()) s += double(v);
    return s;
  };
  constexpr std::array kLayers{"class.caustics.color", "class.caustics.color.a", "class.caustics.color.b"};
  double one = 0;
  std::array<double, 3> halves{};
  for (int seed = 1; seed <= kSeeds; ++seed) {
    shot.settings.seed = std::uint64_t(seed);
    shot.settings.layers = {"color"};
    one += sum(shot.render().layer(kLayers[0]));
    shot.settings.layers = {"color", "color.a", "color.b"};
    const Frame two = shot.render();
    for (int i = 0; i < 3; ++i) halves[i] += sum(two.layer(kLayers[i]));
  }
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(halves[i] / one, 1, 0.05) << kLayers[i];
}

// The halves of the samples see independent photons, so they tell the noise of photons, too.
TEST(Photons, HalvesAreIndependent) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light();
  shot.settings.spp = 16;
  shot.settings.layers = {"color", "color.a", "color.b", "color.var"};
  shot.settings.classes = {{"caustic", "ED[RT]+"}};
  shot.parameters += ",overlap=1";  // so few that noise of photons outweighs that of samples
  const auto caustic = [&](int seed) {
    shot.settings.seed = std::uint64_t(seed);
    return rendered(shot, "temporal_photon");
  };
  double told = 0, seen = 0;
  constexpr int kRuns = 12;
  std::vector<Frame> runs;
  runs.reserve(kRuns);
  for (int i = 0; i < kRuns; ++i) runs.push_back(caustic(i + 1));
  const auto value = [&](const Frame& f, int x, int y) {
    return double(luminance(f.layer("class.caustic.color").rgb(x, y)));
  };
  for (int y = 0; y < shot.settings.height; ++y) {
    for (int x = 0; x < shot.settings.width; ++x) {
      double mean = 0, squares = 0;
      for (const Frame& f : runs) mean += value(f, x, y) / kRuns;
      for (const Frame& f : runs) {
        squares += sqr(value(f, x, y) - mean) / (kRuns - 1);
        const auto half = [&](const char* name) { return double(luminance(f.layer(name).rgb(x, y))); };
        told += sqr(half("class.caustic.color.a") - half("class.caustic.color.b")) / 4 / kRuns;
      }
      seen += squares;
    }
  }
  EXPECT_NEAR(told / seen, 1, 0.3);
}

// What they are compared with blurs more, and holds the same light.
TEST(Photons, OfPlainMapsHoldTheSameLight) {
  const auto caustics = [](const char* integrator, const char* parameters) {
    BoxShot shot = moving_glass();
    shot.settings.spp = 16;
    shot.settings.classes = {{"caustics", kPhotonPaths}};
    shot.integrator = integrator;
    shot.parameters += parameters;
    const Image image = shot.render(1).layer("class.caustics.color");
    double sum = 0;
    for (const float v : image.values()) sum += double(v);
    return sum;
  };
  const double expected = caustics("temporal_photon", ",photons=50000");
  EXPECT_NEAR(caustics("photon", ",photons=50000,radius=0.05") / expected, 1, 0.05);
  EXPECT_NEAR(caustics("time_photon", ",photons=50000,radius=0.05,between=6") / expected, 1, 0.03);
  EXPECT_NEAR(caustics("photon", ",photons=50000,radius=0.1,nearest=60") / expected, 1, 0.05);
  EXPECT_NEAR(caustics("time_photon", ",photons=50000,radius=0.1,nearest=60,between=6") / expected, 1, 0.03);
}

TEST(Photons, ChoiceOfLightsLeavesTheOthersToPaths) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light();
  shot.add(quad({0.6f, 0.97f, 0.5f}, {0.25f, 0, 0}, {0, 0, 0.25f}), make_diffuse(0.2f)).emission =
      AreaEmission{Slot(Rgb{1, 5, 1}), false};
  expect_agreement(shot, 0, 256, 64, 0.06, ",photon_lights=shape7");
  // Light of the others is of its class alone, too.
  BoxShot parts = shot;
  parts.settings.spp = 8;
  parts.settings.classes = {{"caustic", "ED[RT]+"}, {"direct", "ED"}};
  parts.settings.classes_are_decomposition = true;
  parts.settings.layers = {"color", "color.a", "color.b"};
  parts.integrator = "temporal_photon";
  parts.parameters += ",photon_lights=shape7";
  const Frame f = parts.render();
  for (int y = 0; y < f.height(); ++y) {
    for (int x = 0; x < f.width(); ++x) {
      const Rgb halves = (f.layer("color.a").rgb(x, y) + f.layer("color.b").rgb(x, y)) * 0.5f;  // summed up apart
      EXPECT_NEAR(luminance(f.layer("color").rgb(x, y)), luminance(halves), 1e-4) << x << " " << y;
    }
  }
  shot.integrator = "temporal_photon";
  shot.parameters += ",photon_lights=shape";
  try {
    shot.render();
    FAIL() << "took a light that is not there";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
    EXPECT_NE(std::string(e.what()).find("shape7"), std::string::npos) << e.what();
  }
}

// Photons of two machines, the rest of the picture by some that take up what others saved.
TEST(Photons, OfPartsAndAfterStopsHaveTheSameBits) {
  for (const auto& [integrator, parameters] :
       {std::pair{"temporal_photon", ",photons=12000"},
        {"temporal_photon", ",photons=9000,progressive=2"},
        {"gradient_path", ",photons=9000,caustics=photons,adaptive=published"}}) {
    SCOPED_TRACE(std::string(integrator) + parameters);
    BoxShot shot = moving_glass();
    shot.settings.spp = 8;
    shot.integrator = integrator;
    shot.parameters += parameters;
    const Frame whole = shot.render(1);
    const auto method = shot.make_method();
    const LightPathClassifier classifier(path_expressions(*method, shot.settings));
    const auto section = [&] {
      return std::make_unique<Section>(*method, shot.settings, shot.scene, FrameRange{1, 1}, std::vector{1},
                                       method->passes(shot.settings, {1, 1}), shot.tile);
    };
    const auto run = [&](Section& s, const Part& part, int stop_after = 1 << 30) {
      GeometryCache cache;
      SceneWindow window(shot.scene, shot.settings, classifier, 1.0 / 16, cache, {1, 1});
      std::stop_source stop;
      std::atomic<int> left{stop_after};
      SectionHooks hooks;
      hooks.done = [&](const Unit&, const Frame*, const RenderTotals&) {
        if (--left == 0) stop.request_stop();
      };
      with_threads(2, [&] { render_section(*method, window, s, part, hooks, stop.get_token()); });
    };
    auto a = section(), b = section();
    run(*a, {0, 2});
    run(*b, {1, 2});
    EXPECT_LT(a->units_done(), a->units());
    a->merge(*b);
    int stops = 0;
    for (; !a->is_done(); ++stops) {
      run(*a, {}, 3);
      Bytes bytes;
      ByteWriter out(bytes);
      a->save(out);
      a = section();
      ByteReader in(bytes);
      a->load(in);
      ASSERT_LT(stops, 100);
    }
    EXPECT_GT(stops, 1);
    a->finish(*method);
    EXPECT_EQ(a->picture(1).layer("color"), whole.layer("color"));
  }
}

// A hundred photons a lamp are few: most are divided, which must not lose those that only just meet the ball.
TEST(Photons, OfManyLampsHoldAllLight) {
  BoxShot shot(kWhite, glass());
  for (int i = 0; i < 36; ++i) {
    const float x = -0.75f + 0.3f * float(i % 6), z = -0.75f + 0.3f * float(i / 6);
    shot.add(quad({x, 0.98f, z}, {0.05f, 0, 0}, {0, 0, 0.05f}), make_diffuse(0.2f)).emission =
        AreaEmission{Slot(4.0f), false};
  }
  const auto caustics = [&](const char* photons) {
    BoxShot s = shot;
    s.integrator = "temporal_photon";
    s.parameters += photons;
    s.settings.spp = 16;
    s.settings.classes = {{"caustics", kPhotonPaths}};
    const Image image = s.render().layer("class.caustics.color");
    double sum = 0;
    for (const float v : image.values()) sum += double(v);
    return sum;
  };
  double few = 0;
  constexpr int kSeeds = 16;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    shot.settings.seed = std::uint64_t(seed);
    few += caustics(",photons=3600") / kSeeds;
  }
  EXPECT_NEAR(few / caustics(",photons=100000"), 1, 0.15);
}

}  // namespace
}  // namespace tempera
