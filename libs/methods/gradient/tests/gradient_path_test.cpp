// SPDX-License-Identifier: Apache-2.0
#include <functional>

#include "box_shot.h"

namespace tempera {
namespace {

/// How well the differences of gradient_path agree with those of converged pictures of the integrator path: means over
/// pixels and channels of the standardised residual and of its square.
struct Agreement {
  double z = 0, z2 = 0, largest = 0;
  double slope = 0;  ///< of the differences of the pictures over these, which have less noise
  int n = 0;
};

/// Mean and variance of the mean of a layer over independent renders of a shot, whose samples they share.
struct Estimate {
  std::vector<double> mean, variance;
};
constexpr int kRuns = 16;

/// `less`: a layer that is taken from each, or null.
std::vector<Estimate> estimate(BoxShot shot, std::uint64_t first_seed, const std::vector<std::string>& names,
                               const char* less = nullptr) {
  std::vector<Estimate> out(names.size());
  shot.settings.spp /= kRuns;
  for (int run = 0; run < kRuns; ++run) {
    shot.settings.seed = first_seed + std::uint64_t(run);
    const Frame frame = shot.render();
    for (std::size_t k = 0; k < names.size(); ++k) {
      const Image& image = frame.layer(names[k]);
      const Image* other = less ? &frame.layer(less) : nullptr;
      Estimate& e = out[k];
      e.mean.resize(image.pixels() * 3), e.variance.resize(e.mean.size());
      for (std::size_t i = 0; i < e.mean.size(); ++i) {
        const auto pixel = int(i / 3);
        const int x = pixel % image.width(), y = pixel / image.width(), c = int(i % 3);
        const double value = double(image.at(x, y, c)) - (other ? double(other->at(x, y, c)) : 0);
        e.mean[i] += value / kRuns, e.variance[i] += value * value / kRuns;
      }
    }
  }
  for (Estimate& e : out) {
    for (std::size_t i = 0; i < e.mean.size(); ++i)
      e.variance[i] = std::max(0.0, e.variance[i] - sqr(e.mean[i])) / (kRuns - 1);
  }
  return out;
}

/// One for each of `classes`; "": all light.
std::vector<Agreement> compare(const BoxShot& shot, int spp, int reference_spp,
                               const std::vector<std::string>& classes = {""}) {
  BoxShot gradients = shot, reference = shot;
  gradients.integrator = "gradient_path", reference.integrator = "path";
  gradients.settings.spp = spp;
  reference.settings.spp = reference_spp;
  const bool photons = classes[0].empty() && shot.parameters.find("caustics=photons") != std::string::npos;
  if (photons) reference.settings.layers.emplace_back("photon.color");
  for (const char* own : {",roughness_threshold", ",adaptive", ",class_gradients"}) {  // what path lacks stands last
    if (const auto at = reference.parameters.find(own); at != std::string::npos) reference.parameters.resize(at);
  }
  std::vector<std::string> differences, colors;
  for (const std::string& name : classes) {
    const std::string prefix = name.empty() ? "" : "class." + name + ".";
    differences.push_back(prefix + "grad.x"), differences.push_back(prefix + "grad.y");
    colors.push_back(prefix + "color");
  }
  const std::vector<Estimate> all_g = estimate(gradients, 0, differences),
                              all_colors = estimate(reference, 99, colors, photons ? "photon.color" : nullptr);
  const int w = shot.settings.width, h = shot.settings.height;
  std::vector<Agreement> result(classes.size());
  for (std::size_t n = 0; n < classes.size(); ++n) {
    Agreement& a = result[n];
    const Estimate& color = all_colors[n];
    double products = 0, squares = 0;
    for (const auto& [k, dx, dy] : {std::tuple{0, 1, 0}, {1, 0, 1}}) {
      const Estimate& g = all_g[2 * n + std::size_t(k)];
      for (int y = 0; y + dy < h; ++y) {
        for (int x = 0; x + dx < w; ++x) {
          for (int c = 0; c < 3; ++c) {
            const std::size_t i = std::size_t((y * w + x) * 3 + c), j = std::size_t(((y + dy) * w + x + dx) * 3 + c);
            const double variance = g.variance[i] + color.variance[i] + color.variance[j];
            const double difference = color.mean[j] - color.mean[i], residual = g.mean[i] - difference;
            products += g.mean[i] * difference;
            squares += sqr(g.mean[i]) - g.variance[i];
            if (variance == 0 && residual == 0) continue;  // the class has no light here
            const double z = residual / std::sqrt(variance + 1e-12);
            a.z += z, a.z2 += z * z, ++a.n;
            a.largest = std::max(a.largest, std::abs(z));
          }
        }
      }
    }
    a.slope = products / squares;
    a.z /= a.n;
    a.z2 /= a.n * double(kRuns - 1) / (kRuns - 3);  // squares of Student's t with kRuns - 1 degrees of freedom
  }
  return result;
}

struct Case {
  const char* name;
  std::function<BoxShot()> shot;
  int effort = 1;  ///< times the samples: where rare large values make the variance of few samples worthless
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class Gradients : public testing::TestWithParam<Case> {};

BoxShot with_photons(BoxShot shot, const char* more = "") {
  shot.parameters += std::string(",caustics=photons,photons=30000") + more;
  return shot;
}

// Residuals of neighbouring differences share pixels, and rare large values make the variance of few runs too small.
// Over these scenes the means of z^2 are 0.81 to 1.16, those of z at most 0.08: other random numbers alone can pass the
// bounds once in a while, so look at several seeds before blaming the code. With as many samples, a Jacobian that is
// 20 % too large gave 1.56 and 1.71 for `diffuse` and `penumbra`; with 32 times as many, 5 % gave 1.85 and 2.05.
TEST_P(Gradients, AreTheDifferencesOfThePicture) {
  const int spp = 128 * GetParam().effort, width = 16, height = 14;
  BoxShot shot = GetParam().shot();
  shot.settings.width = width, shot.settings.height = height;
  const Agreement a = compare(shot, spp, 16 * spp)[0];
  RecordProperty("mean_z", std::to_string(a.z));
  RecordProperty("mean_z2", std::to_string(a.z2));
  std::printf("%s: mean z %.3f, mean z^2 %.3f, largest %.1f of %d\n", GetParam().name, a.z, a.z2, a.largest, a.n);
  EXPECT_NEAR(a.z2, 1, 0.3);
  EXPECT_NEAR(a.z, 0, 0.15);
}

const MaterialPtr kWhite = make_diffuse(0.7f);
MaterialPtr glass(float alpha = 0);

/// Surfaces that scatter by several events at once, or by other events than their neighbours.
BoxShot many_events() {
  BoxShot shot = BoxShot(make_blend(0.5f, make_diffuse(0.6f), make_conductor({})), make_plastic({})).area_light().sky();
  shot.coarse(glass(0.05f));
  shot.integrator = "gradient_path";
  shot.parameters += ",class_gradients=true";
  shot.settings.classes = {{"direct", "ED"}, {"indirect", "ED.+"}, {"mirror", "ER.*"}, {"glass", "ET.*"}};
  shot.settings.classes_are_decomposition = true;
  return shot;
}

// Differences of classes are differences of their pictures, and add up to the difference of all light.
TEST(ClassGradients, AreTheDifferencesOfTheirPictures) {
  BoxShot shot = many_events();
  shot.settings.width = 16, shot.settings.height = 14;
  const std::vector<std::string> names{"direct", "indirect", "mirror", "glass"};
  const std::vector<Agreement> all = compare(shot, 256, 2048, names);
  for (std::size_t k = 0; k < names.size(); ++k) {
    const Agreement& a = all[k];
    std::printf("%s: mean z %.3f, mean z^2 %.3f, largest %.1f of %d\n", names[k].c_str(), a.z, a.z2, a.largest, a.n);
    EXPECT_GT(a.n, 500) << names[k];
    EXPECT_NEAR(a.z2, 1, 0.35) << names[k];
    EXPECT_NEAR(a.z, 0, 0.15) << names[k];
  }
}

TEST(ClassGradients, AddUpAndChangeNothingElse) {
  BoxShot shot = many_events();
  shot.settings.spp = 8;
  const Frame with = shot.render();
  shot.parameters = "max_depth=6";
  const Frame without = shot.render();
  for (const char* name : {"color", "grad.x", "grad.y", "class.mirror.color", "rare.color"})
    EXPECT_EQ(values(with.layer(name)), values(without.layer(name))) << name;
  EXPECT_FALSE(without.has("class.mirror.grad.x"));
  for (const char* name : {"grad.x", "grad.y"}) {
    for (int y = 0; y < shot.settings.height; ++y) {
      for (int x = 0; x < shot.settings.width; ++x) {
        Rgb sum;
        for (const char* part : {"direct", "indirect", "mirror", "glass", "residual"})
          sum += with.layer("class." + std::string(part) + "." + name).rgb(x, y);
        const Rgb all = with.layer(name).rgb(x, y);
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], all[c], 1e-4f * (1 + std::abs(all[c]))) << x << " " << y;
      }
    }
  }
}

MaterialPtr rough(float alpha) {
  ConductorParams p;
  p.eta = Rgb{0.2f, 0.9f, 1.1f}, p.k = Rgb{3.9f, 2.4f, 2.2f};
  p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_conductor(p);
}
MaterialPtr glass(float alpha) {
  DielectricParams p;
  if (alpha > 0) p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_dielectric(p);
}

// The picture itself is that of the integrator path, whatever is shifted beside it.
TEST(GradientPath, PictureIsThatOfPath) {
  BoxShot shot = BoxShot(kWhite, glass()).area_light().sky();
  shot.settings.spp = 8;
  BoxShot gradients = shot;
  gradients.integrator = "gradient_path";
  EXPECT_EQ(values(shot.render().layer("color")), values(gradients.render().layer("color")));
}

// Differences of light that photons find, apart from all other light: none of what is seen directly, and those of pictures for
// what mirrors, glass and diffuse surfaces show of it.
TEST(ClassGradients, OfPhotonsAreTheDifferencesOfTheirPictures) {
  for (const bool mirror : {false, true}) {
    SCOPED_TRACE(mirror ? "mirror" : "diffuse");
    BoxShot shot =
        with_photons(BoxShot(mirror ? make_conductor({}) : kWhite, glass()).area_light(), ",class_gradients=true");
    shot.settings.width = 16, shot.settings.height = 14;
    shot.settings.classes = {{"first", "ED[RT]+"}, {"shown", "E[RT]+D[RT]+"}, {"bounced", "ED+D[RT]+"}};
    const std::vector<std::string> names{"shown", "bounced"};
    const std::vector<Agreement> all = compare(shot, 1024, 4096, names);
    for (std::size_t k = 0; k < names.size(); ++k) {
      const Agreement& a = all[k];
      std::printf("%s: mean z %.3f, mean z^2 %.3f, slope %.3f\n", names[k].c_str(), a.z, a.z2, a.slope);
      EXPECT_NEAR(a.z2, 1, 0.4) << names[k];
      EXPECT_NEAR(a.z, 0, 0.15) << names[k];
      EXPECT_NEAR(a.slope, 1, 0.2) << names[k];
    }
    shot.integrator = "gradient_path";
    shot.settings.spp = 16;
    const Frame frame = shot.render();
    for (const char* layer : {"class.first.grad.x", "class.first.grad.y"}) {
      for (const float v : values(frame.layer(layer))) ASSERT_EQ(v, 0) << layer;
    }
    EXPECT_EQ(values(frame.layer("class.first.photon.color")), values(frame.layer("class.first.color")));
    EXPECT_EQ(values(frame.layer("class.first.photon.color")), values(frame.layer("photon.color")));
  }
}

TEST(GradientPath, PhotonsAreThoseOfPathAndKeptApart) {
  BoxShot shot = with_photons(BoxShot(kWhite, glass()).area_light());
  shot.settings.spp = 8;
  shot.settings.layers = {"color", "photon.color"};
  BoxShot gradients = shot;
  gradients.integrator = "gradient_path";
  const Frame a = shot.render(), b = gradients.render();
  EXPECT_EQ(values(a.layer("color")), values(b.layer("color")));
  EXPECT_EQ(values(a.layer("photon.color")), values(b.layer("photon.color")));
  // All light that paths of four edges find behind glass is that of photons.
  gradients.parameters.replace(0, std::string("max_depth=6").size(), "max_depth=4");
  BoxShot paths = gradients;
  paths.parameters = "max_depth=4";
  paths.settings.layers = {"color"};
  double rare = 0, rare_of_paths = 0;
  for (const float v : values(gradients.render().layer("rare.color"))) rare += double(v);
  for (const float v : values(paths.render().layer("rare.color"))) rare_of_paths += double(v);
  EXPECT_LT(rare, 0.1 * rare_of_paths);
}

// Tiles meet without a seam: their size changes no bit of a difference.
TEST(GradientPath, TilesDoNotShow) {
  BoxShot shot = BoxShot(rough(0.2f), glass(0.3f)).area_light();
  shot.integrator = "gradient_path";
  shot.settings.spp = 4;
  const Frame a = shot.render();
  shot.tile = 5;
  const Frame b = shot.render();
  for (const char* name : {"grad.x", "grad.y"}) EXPECT_EQ(values(a.layer(name)), values(b.layer(name))) << name;
  EXPECT_FALSE(a.has("grad.right")) << "work layers are no output";
}

// With either sampler: points of a net spread less than their number says.
TEST(GradientPath, VarianceIsThatOfTheMeanDifference) {
  for (const SamplerKind sampler : {SamplerKind::kSobol, SamplerKind::kIndependent}) {
    BoxShot shot = BoxShot(kWhite, nullptr).sky();
    shot.integrator = "gradient_path";
    shot.parameters = "max_depth=2";
    shot.settings.sampler = sampler;
    shot.settings.spp = 16;
    shot.settings.layers = {"grad.x.var"};
    const int runs = 24;
    double predicted = 0;
    std::vector<double> sum, squares;
    for (int run = 0; run < runs; ++run) {
      shot.settings.seed = std::uint64_t(run);
      const Frame frame = shot.render();
      for (const float v : values(frame.layer("grad.x.var"))) predicted += double(v) / runs;
      const std::vector<float> x = values(frame.layer("grad.x"));
      sum.resize(x.size()), squares.resize(x.size());
      for (std::size_t i = 0; i < x.size(); ++i) sum[i] += double(x[i]), squares[i] += sqr(double(x[i]));
    }
    double seen = 0;
    for (std::size_t i = 0; i < sum.size(); ++i) seen += (squares[i] - sqr(sum[i]) / runs) / (runs - 1);
    EXPECT_NEAR(predicted / seen, 1, 0.1) << int(sampler);
  }
}

TEST(GradientPath, RollingShutterIsRefused) {
  BoxShot shot(kWhite, nullptr);
  shot.integrator = "gradient_path";
  shot.settings.clock.shutter.rolling = 0.5;
  try {
    shot.render();
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kUnsupported);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, Gradients,
    testing::Values(
        Case{"diffuse", [] { return BoxShot(kWhite, kWhite).area_light(); }},
        Case{"penumbra", [] { return BoxShot(kWhite, kWhite).area_light(0.05f); }},
        Case{"point", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kPoint); }},
        Case{"spot", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kSpot); }},
        Case{"sphere_light", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kPoint).sized(0.1f); }},
        Case{"soft_spot", [] { return BoxShot(kWhite, kWhite).lamp(LightType::kSpot).sized(0.1f); }},
        Case{"spread",
             [] {
               BoxShot s = BoxShot(kWhite, kWhite).area_light();
               s.scene.shapes.back().emission->half_spread = 0.5f;
               return s;
             }},
        Case{"sun",
             [] {
               BoxShot s = BoxShot(kWhite, kWhite).lamp(LightType::kDirectional);
               s.scene.lights[0].angle = 0.3f;
               s.scene.nodes.back().local = Affine3d(look_at(Vec3f{0.5f, 0.7f, 2}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}));
               return s;
             }},
        Case{"sky", [] { return BoxShot(kWhite, kWhite).sky(); }},
        Case{"glossy", [] { return BoxShot(rough(0.15f), kWhite).area_light(); }},
        Case{"glossy_copied",
             [] {
               BoxShot s = BoxShot(rough(0.15f), rough(0.3f)).area_light();
               s.parameters += ",roughness_threshold=0.5";
               return s;
             },
             8},
        Case{"mirror", [] { return BoxShot(make_conductor({}), kWhite).area_light(); }},
        Case{"glass", [] { return BoxShot(kWhite, glass()).area_light(); }},
        Case{"rough_glass", [] { return BoxShot(kWhite, glass(0.2f)).area_light(); }},
        Case{"rough_glass_copied",
             [] {
               BoxShot s = BoxShot(kWhite, glass(0.2f)).area_light();
               s.parameters += ",roughness_threshold=0.5";
               return s;
             },
             8},
        Case{"mixed",
             [] {
               return BoxShot(make_blend(0.5f, make_diffuse(0.6f), make_conductor({})), make_plastic({})).area_light();
             }},
        Case{"bent", [] { return BoxShot(kWhite, nullptr).coarse(make_diffuse(0.8f)).area_light(); }},
        Case{"bent_plastic", [] { return BoxShot(kWhite, nullptr).coarse(make_plastic({})).area_light(); }},
        Case{"bent_glossy",
             [] {
               BoxShot s = BoxShot(rough(0.15f), nullptr).coarse(rough(0.3f)).area_light();
               s.parameters += ",roughness_threshold=0.5";
               return s;
             },
             8},
        Case{"bent_mirror", [] { return BoxShot(kWhite, nullptr).coarse(make_conductor({})).area_light(); }},
        Case{"bent_glass", [] { return BoxShot(kWhite, nullptr).coarse(glass()).area_light(); }},
        Case{"adaptive",
             [] {
               BoxShot s = BoxShot(kWhite, rough(0.15f)).area_light(0.05f).sky();
               s.parameters += ",adaptive=unbiased";
               return s;
             }},
        Case{"mask", [] { return BoxShot(kWhite, make_mask(0.5f, make_two_sided(make_diffuse(0.6f)))).area_light(); }},
        // Caustics by photons: those that are seen directly stay apart, their light after diffuse reflections does not.
        Case{"photons", [] { return with_photons(BoxShot(kWhite, glass()).area_light(0.1f)); }},
        Case{"photons_in_a_mirror", [] { return with_photons(BoxShot(make_conductor({}), glass()).area_light()); }},
        Case{"photons_of_one_light",
             [] {
               BoxShot s = BoxShot(make_plastic({}), make_conductor({})).area_light().lamp(LightType::kSpot);
               s.scene.lights[0].name = "spot";
               return with_photons(s, ",photon_lights=spot");
             }},
        Case{"photons_of_a_sky", [] { return with_photons(BoxShot(kWhite, glass()).sky_with_a_sun()); }},
        Case{"roulette",
             [] {
               BoxShot s = BoxShot(kWhite, kWhite).area_light();
               s.parameters = "rr_depth=1";
               return s;
             }}),
    [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace tempera
