// SPDX-License-Identifier: Apache-2.0
// Gradient-domain rendering from the scene to the reconstructed frames: with L2 and counts that do not depend on the
// samples they weight, the expected value is that of path tracing.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>

#include "support/effort.h"
#include "tempera/pipeline/render.h"
#include "tempera/stages/reconstruct.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

struct Method {
  const char* name;
  const char* integrator;
  std::vector<std::string> parameters;
  int spp = 16;
};
void PrintTo(const Method& m, std::ostream* out) { *out << m.name; }

class Reconstruction : public testing::TestWithParam<Method> {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / fmt::format("tempera_unbiased_{}_{}", GetParam().name, getpid());
    fs::create_directories(folder_);
    set_log_level(LogLevel::kWarning);
  }
  void TearDown() override {
    fs::remove_all(folder_);
    set_log_level(LogLevel::kInfo);
  }
  LoadedShot load(const std::vector<std::string>& more) const {
    ShotConfig config = read_shot_config(std::string(TEMPERA_SOURCE_DIR) + "/scenes/tests/cornell_motion.xml");
    // Without caustics, whose rare large values make the variance of any number of samples worthless.
    for (const char* key :
         {"film.resolution=16x12", "film.filter=box", "sampling.sampler=independent", "integrator.max_depth=3"})
      config.assign(key);
    for (const std::string& key : more) config.assign(key);
    Warnings warnings;
    return load_shot(config, {}, warnings);
  }
  std::string path(const char* name) const { return (folder_ / name).string(); }

  fs::path folder_;
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
  const int runs = 64 * test::effort(), spp = GetParam().spp;
  const LoadedShot truth = load({fmt::format("sampling.spp={}", 4 * runs * spp), "sampling.seed=977",
                                 "output.layers=color,color.var", "integrator.rr_depth=100"});
  std::vector<Frame> pictures;
  pictures.reserve(kFrames);
  for (int f = 0; f < kFrames; ++f) pictures.push_back(render_frame(truth.shot, truth.scene, kFirst + f));
  const auto picture = [&](int f) -> const Frame& { return pictures[std::size_t(f - kFirst)]; };
  std::vector<std::string> keys{fmt::format("sampling.spp={}", spp),
                                fmt::format("integrator.name={}", GetParam().integrator)};
  keys.insert(keys.end(), GetParam().parameters.begin(), GetParam().parameters.end());
  LoadedShot shot = load(keys);
  shot.shot.frames.clear();
  for (int f = 0; f < kFrames; ++f) shot.shot.frames.push_back(kFirst + f);
  shot.shot.output = path("in.####.exr");
  ReconstructOptions options;
  options.params.set("norm", std::string("l2"));
  options.params.set("iterations", 400);
  StageObserver observer;
  std::vector<std::vector<double>> results;
  for (int r = 0; r < runs; ++r) {
    shot.shot.settings.seed = std::uint64_t(r);
    render_sequence(shot.shot, shot.scene, {}, {}, {});
    const std::string out = path("out.####.exr");
    reconstruct(FrameSequence(shot.shot.output), out, options, observer, {});
    results.push_back(gather("color", [&](int f) { return read_frame(frame_path(out, f)); }));
  }

  // Variance of the mean of runs, value by value.
  const auto own_variance = [&](std::size_t i) {
    double sum = 0, squares = 0;
    for (const std::vector<double>& r : results) sum += r[i], squares += sqr(r[i]);
    return std::max(0.0, (squares - sum * sum / runs) / (double(runs) * (runs - 1)));
  };
  // In units of the noise of each pixel: else the few that are far noisier would be most of every coefficient.
  std::vector<double> variance = gather("color.var", picture), scale;
  for (std::size_t i = 0; i < kValues; ++i) {
    scale.push_back(1 / std::sqrt(variance[i] + own_variance(i) + 1e-12));
    variance[i] *= sqr(scale[i]);
  }
  const auto spectrum = [&](std::vector<double> values) {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] *= scale[i];
    return transform(std::move(values), [](double c) { return c; });
  };
  const std::vector<double> expected = spectrum(gather("color", picture)),
                            noise = transform(variance, [](double c) { return c * c; });
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
                         testing::Values(Method{"gradient", "gradient_path", {"integrator.rr_depth=100"}},
                                         Method{"temporal", "temporal_gradient_path", {"integrator.rr_depth=100"}},
                                         Method{"roulette", "temporal_gradient_path", {"integrator.rr_depth=1"}},
                                         Method{"adaptive",
                                                "temporal_gradient_path",
                                                {"integrator.rr_depth=100", "integrator.adaptive=unbiased"},
                                                64}),
                         [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace tempera
