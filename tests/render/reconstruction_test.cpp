// SPDX-License-Identifier: Apache-2.0
// Gradient-domain rendering from the scene to the reconstructed frames: with L2 and counts that do not depend on the
// samples they weight, the expected value is that of path tracing.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "support/effort.h"
#include "tempera/pipeline/render.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

struct Case {
  const char* name;
  std::string scene;  ///< XML; empty: scenes/tests/cornell_motion.xml
  std::vector<std::string> settings;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

const std::vector<std::string> kGradient{"integrator.name=gradient_path", "integrator.rr_depth=100"},
    kTemporal{"integrator.name=temporal_gradient_path", "integrator.rr_depth=100"},
    kRoulette{"integrator.name=temporal_gradient_path", "integrator.rr_depth=1"},
    // Few batches: where the first decided about itself, this shows most.
    kAdaptive{"integrator.name=temporal_gradient_path", "integrator.rr_depth=100", "integrator.adaptive=unbiased",
              "integrator.adaptive_batches=2"};

/// A ball that hops and a block that turns between a floor and a wall, seen by a camera that travels.
std::string moving_scene(const std::string& lights, const std::string& floor, const std::string& ball) {
  return fmt::format(R"(<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="45"/><float name="shutter_close" value="0.02"/>
    <animation name="to_world">
      <transform time="0"><lookat origin="-0.3, 1, 4" target="0, 0.4, 0" up="0, 1, 0"/></transform>
      <transform time="1"><lookat origin="0.5, 1.2, 3.7" target="0, 0.4, 0" up="0, 1, 0"/></transform>
    </animation>
  </sensor>
  {}
  <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>{}</shape>
  <shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1.5"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.5, 0.3"/></bsdf></shape>
  <shape type="sphere"><float name="radius" value="0.5"/>
    <animation name="to_world">
      <transform time="0"><translate x="-0.9" y="0.5" z="0.3"/></transform>
      <transform time="1"><translate x="0.3" y="1" z="0.5"/></transform>
    </animation>{}</shape>
  <shape type="cube">
    <animation name="to_world">
      <transform time="0"><scale value="0.4"/><translate x="0.8" y="0.4" z="-0.3"/></transform>
      <transform time="1"><scale value="0.4"/><rotate y="1" angle="100"/><translate x="0.8" y="0.4" z="-0.3"/></transform>
    </animation>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.6, 0.4"/></bsdf></shape>
</scene>)",
                     lights, floor, ball);
}
/// A rectangular light above, of half the given side.
std::string lamp(double half) {
  return fmt::format(R"(<shape type="rectangle"><transform name="to_world"><scale value="{}"/><rotate x="1" angle="90"/>
    <translate x="-0.4" y="2.4" z="0.6"/></transform><emitter type="area"><rgb name="radiance" value="{}"/></emitter></shape>)",
                     half, 3 / (half * half));
}
const std::string kPoint =
    R"(<emitter type="point"><point name="position" x="-0.6" y="2.5" z="1"/><rgb name="intensity" value="8"/></emitter>)";
const std::string kSpot = R"(<emitter type="spot"><transform name="to_world"><lookat origin="-1, 2.5, 2"
    target="0, 0.3, 0" up="0, 1, 0"/></transform><rgb name="intensity" value="20"/></emitter>)";
const std::string kSky = R"(<emitter type="sky"><float name="turbidity" value="4"/></emitter>)";
const std::string kConstant = R"(<emitter type="constant"><rgb name="radiance" value="0.8, 0.9, 1"/></emitter>)";
const std::string kDiffuse = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf>)";
const std::string kGlass = R"(<bsdf type="dielectric"/>)";
const std::string kMirror = R"(<bsdf type="conductor"><string name="material" value="Cu"/></bsdf>)";
const std::string kMixed = R"(<bsdf type="blendbsdf"><float name="weight" value="0.4"/><bsdf type="diffuse"/>
    <bsdf type="conductor"><string name="material" value="Al"/></bsdf></bsdf>)";
std::string rough(const char* type, double alpha) {
  return fmt::format(R"(<bsdf type="{}"><float name="alpha" value="{}"/></bsdf>)", type, alpha);
}

class Reconstruction : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / fmt::format("tempera_unbiased_{}_{}", GetParam().name, getpid());
    fs::create_directories(folder_);
    scene_ = std::string(TEMPERA_SOURCE_DIR) + "/scenes/tests/cornell_motion.xml";
    if (!GetParam().scene.empty()) {
      scene_ = path("scene.xml");
      std::ofstream(scene_) << GetParam().scene;
    }
    set_log_level(LogLevel::kWarning);
  }
  void TearDown() override {
    fs::remove_all(folder_);
    set_log_level(LogLevel::kInfo);
  }
  LoadedShot load(const std::vector<std::string>& more) const {
    ShotConfig config = read_shot_config(scene_);
    for (const char* key : {"film.resolution=16x12", "film.filter=box", "sampling.sampler=independent"})
      config.assign(key);
    // Without the caustics of the box, whose rare large values make the variance of any number of samples worthless.
    config.assign(GetParam().scene.empty() ? "integrator.max_depth=3" : "integrator.max_depth=5");
    for (const std::string& key : more) config.assign(key);
    Warnings warnings;
    return load_shot(config, {}, warnings);
  }
  std::string path(const char* name) const { return (folder_ / name).string(); }

  fs::path folder_;
  std::string scene_;
};

constexpr int kWidth = 16, kHeight = 12, kFrames = 3, kFirst = 20;
constexpr std::array<int, 3> kSizes{kWidth, kHeight, kFrames};
constexpr int kValues = kWidth * kHeight * kFrames;

/// Value i of basis function k of the orthonormal cosine transform of n values.
double cosine(int n, int k, int i) { return std::sqrt((k == 0 ? 1.0 : 2.0) / n) * std::cos(kPiD * k * (i + 0.5) / n); }

/// Along each axis in turn, out[k] = sum of weight(cosine) * in[i].
template <class F>
std::vector<double> transform(std::vector<double> values, F&& weight) {
  std::size_t stride = 1;
  for (const int n : kSizes) {
    std::vector<double> out(values.size());
    for (std::size_t at = 0; at < values.size(); ++at) {
      const int k = int(at / stride) % n;
      const std::size_t base = at - std::size_t(k) * stride;
      for (int i = 0; i < n; ++i) out[at] += weight(cosine(n, k, i)) * values[base + std::size_t(i) * stride];
    }
    values = std::move(out);
    stride *= std::size_t(n);
  }
  return values;
}

/// The green channel of the layer of all frames, as kSizes says: the channels' noise goes together.
template <class Read>
std::vector<double> gather(const std::string& layer, Read&& read) {
  std::vector<double> values;
  values.reserve(kValues);
  for (int f = 0; f < kFrames; ++f) {
    const Frame& frame = read(kFirst + f);
    const Image& image = frame.layer(layer);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) values.push_back(double(image.at(x, y, 1)));
    }
  }
  return values;
}

// Errors of a solution go together over neighbouring pixels and frames, but those of its frequencies hardly: each
// coefficient of the cosine transform over x, y and time is compared with a converged picture's.
// [Manzi 2016, Sec. 3.1: L2 is unbiased]
TEST_P(Reconstruction, HasTheMeanOfPathTracing) {
  const int runs = 64 * test::effort(), spp = 16;
  // The truth is a mean of independent pictures, which tell its variance.
  const int pictures = 16;
  LoadedShot truth = load(
      {fmt::format("sampling.spp={}", 4 * runs * spp / pictures), "output.layers=color", "integrator.rr_depth=100"});
  std::vector<double> picture(kValues), variance(kValues);
  for (int k = 0; k < pictures; ++k) {
    truth.shot.settings.seed = std::uint64_t(977 + k);
    const std::vector<double> one = gather("color", [&](int f) { return render_frame(truth.shot, truth.scene, f); });
    for (std::size_t i = 0; i < kValues; ++i) picture[i] += one[i] / pictures, variance[i] += sqr(one[i]) / pictures;
  }
  for (std::size_t i = 0; i < kValues; ++i) variance[i] = std::max(0.0, variance[i] - sqr(picture[i])) / (pictures - 1);
  std::vector<std::string> keys = GetParam().settings;
  keys.push_back(fmt::format("sampling.spp={}", spp));
  LoadedShot shot = load(keys);
  shot.shot.frames.clear();
  for (int f = 0; f < kFrames; ++f) shot.shot.frames.push_back(kFirst + f);
  shot.shot.output = path("in.####.exr");
  StageChoice choice{&find_stage("reconstruct"), Params(find_stage("reconstruct").params)};
  choice.params.set("norm", std::string("l2"));
  choice.params.set("iterations", 400);
  StageObserver observer;
  std::vector<std::vector<double>> results;
  for (int r = 0; r < runs; ++r) {
    shot.shot.settings.seed = std::uint64_t(r);
    render_sequence(shot.shot, shot.scene, {}, {}, {});
    const std::string out = path("out.####.exr");
    const FrameSequence in(shot.shot.output);
    run_stage(choice, std::span(&in, 1), out, {}, observer);
    results.push_back(gather("color", [&](int f) { return read_frame(frame_path(out, f)); }));
  }

  // Variance of the mean of runs, value by value.
  const auto own_variance = [&](std::size_t i) {
    double sum = 0, squares = 0;
    for (const std::vector<double>& r : results) sum += r[i], squares += sqr(r[i]);
    return std::max(0.0, (squares - sum * sum / runs) / (double(runs) * (runs - 1)));
  };
  // In units of the noise of each pixel: else the few that are far noisier would be most of every coefficient.
  std::vector<double> scale;
  for (std::size_t i = 0; i < kValues; ++i) {
    scale.push_back(1 / std::sqrt(variance[i] + own_variance(i) + 1e-12));
    variance[i] *= sqr(scale[i]);
  }
  const auto spectrum = [&](std::vector<double> values) {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] *= scale[i];
    return transform(std::move(values), [](double c) { return c; });
  };
  const std::vector<double> expected = spectrum(picture), noise = transform(variance, [](double c) { return c * c; });
  for (std::vector<double>& r : results) r = spectrum(std::move(r));

  const auto z_square = [&](std::size_t i) {
    double mean = 0;
    for (const std::vector<double>& r : results) mean += r[i] / runs;
    return sqr(mean - expected[i]) / (own_variance(i) + noise[i]);
  };
  double z2 = 0;
  for (std::size_t i = 0; i < kValues; ++i) z2 += z_square(i) / kValues;
  std::printf("%s: mean z^2 %.3f, z of the mean %.2f\n", GetParam().name, z2, std::sqrt(z_square(0)));
  EXPECT_LT(z_square(0), sqr(3.8)) << "the mean of all values";
  // Squares of Student's t with runs - 1 degrees of freedom. Bounds: four times their spread over so many values.
  const double n = runs - 1, wanted = n / (n - 2);
  const double spread = std::sqrt(2 * n * n * (n - 1) / (sqr(n - 2) * (n - 4)) / kValues);
  EXPECT_LT(z2, wanted + 4 * spread);
  EXPECT_GT(z2, 0.6 * wanted) << "variances are too large: pixels with few samples have rare large values";
}

INSTANTIATE_TEST_SUITE_P(Methods, Reconstruction,
                         testing::Values(Case{"gradient", "", kGradient}, Case{"temporal", "", kTemporal},
                                         Case{"roulette", "", kRoulette}, Case{"adaptive", "", kAdaptive}),
                         [](const auto& i) { return std::string(i.param.name); });

// Light and material of every kind that shifts treat differently, in motion.
INSTANTIATE_TEST_SUITE_P(
    Scenes, Reconstruction,
    testing::Values(Case{"penumbra", moving_scene(lamp(0.1), kDiffuse, kDiffuse), kTemporal},
                    Case{"point", moving_scene(kPoint, kDiffuse, kDiffuse), kTemporal},
                    Case{"spot", moving_scene(kSpot, kDiffuse, kDiffuse), kTemporal},
                    Case{"sky", moving_scene(kSky, kDiffuse, rough("roughplastic", 0.2)), kTemporal},
                    Case{"glossy", moving_scene(lamp(0.6), rough("roughconductor", 0.2), kDiffuse), kTemporal},
                    Case{"mirror", moving_scene(kConstant, kDiffuse, kMirror), kTemporal},
                    Case{"glass", moving_scene(kConstant, kDiffuse, kGlass), kTemporal},
                    Case{"rough_glass", moving_scene(kConstant, kDiffuse, rough("roughdielectric", 0.3)), kTemporal},
                    Case{"mixed", moving_scene(lamp(0.6) + kPoint + kConstant, kMixed, rough("roughplastic", 0.3)),
                         kTemporal}),
    [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace tempera
