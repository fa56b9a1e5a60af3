// SPDX-License-Identifier: Apache-2.0
// Pictures of small scenes, bit by bit: a change of the code that is not meant to change pictures changes no bit. Who
// means to change them enters the values that a failure prints, and says so in the change.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>

#include "tempera/core/random.h"
#include "tempera/gallery/gallery.h"
#include "tempera/pipeline/render.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

struct Pinned {
  const char* name;
  const char* scene;  ///< of the gallery
  int frame;
  std::vector<std::string> settings;  ///< keys of shot.toml
  std::uint64_t bits;                 ///< of all layers; of the compiler and instruction set that kBitsHold names
  double mean;                        ///< of the color's channels
};
void PrintTo(const Pinned& p, std::ostream* out) { *out << p.name; }

/// Compilers differ in how they contract products and sums; the bits are those of Debian 12's on x86-64-v3.
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ == 12 && defined(__OPTIMIZE__) && defined(__AVX2__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && !defined(TEMPERA_ASSERTS)
constexpr bool kBitsHold = true;
#else
constexpr bool kBitsHold = false;
#endif

const std::string kSize = "film.resolution=48x27", kFeatures =
                                                       "output.layers=color,halves,color.var,albedo,normal,depth,"
                                                       "position,object_id,uv,emission,motion,cryptomatte,"
                                                       "samples,time";

std::vector<Pinned> pins() {
  const auto gradient = [](std::string name, std::string spp, std::vector<std::string> more = {}) {
    more.insert(more.end(), {kSize, "integrator.name=" + name, "sampling.spp=" + spp});
    return more;
  };
  const std::string adaptive = "integrator.adaptive=unbiased", batches = "integrator.adaptive_batches=2";
  return {
      {"runner_path", "running-figure", 9, {kSize, "sampling.spp=4", kFeatures}, 0x2c9efbe1c27f1acc, 0.3171284},
      {"egg_path",
       "glass-egg",
       5,
       {kSize, "sampling.spp=4", "integrator.name=path", kFeatures},
       0x01b80204b30f1932,
       0.3517202},
      {"cornell_path", "cornell-motion", 7, {kSize, "sampling.spp=3", kFeatures}, 0x70e38dd7bfffd021, 0.2063102},
      {"vase_path",
       "vase",
       3,
       {kSize, "sampling.spp=2", "shutter.close=1", "film.filter=gaussian"},
       0x58425b4446571dbd,
       0.4814588},
      {"runner_gradients", "running-figure", 9, gradient("gradient_path", "4"), 0xaf6884195500face, 0.3171284},
      {"egg_gradients", "glass-egg", 5, gradient("gradient_path", "4"), 0x82ffa4e5a458296d, 0.3517202},
      {"egg_adaptive", "glass-egg", 5, gradient("gradient_path", "8", {adaptive, batches}), 0xdff189f63ff67448,
       0.3546182},
      {"runner_temporal", "running-figure", 9, gradient("temporal_gradient_path", "4"), 0x7cd7c27cef3ddb89, 0.3172564},
      {"egg_temporal", "glass-egg", 5, gradient("temporal_gradient_path", "4"), 0x15d7039535742eee, 0.350071},
      {"cornell_temporal", "cornell-motion", 7, gradient("temporal_gradient_path", "4"), 0x8f1e1f360a43595c, 0.1982349},
      {"cornell_adaptive", "cornell-motion", 7, gradient("temporal_gradient_path", "16", {adaptive, batches}),
       0xf2164a1ac7b4b217, 0.2078421},
  };
}

std::uint64_t bits_of(const Frame& frame) {
  std::uint64_t h = 0;
  for (const Layer& layer : frame.layers()) {
    for (const char c : layer.desc.name) h = hash_key(h, std::uint64_t(c));
    for (const float v : layer.image.values()) {
      std::uint32_t word;
      std::memcpy(&word, &v, sizeof word);
      h = hash_key(h, word);
    }
  }
  return h;
}

class PinnedBits : public testing::TestWithParam<Pinned> {};

TEST_P(PinnedBits, ArePictures) {
  const Pinned& pin = GetParam();
  const fs::path folder = fs::temp_directory_path() / fmt::format("tempera_pinned_{}_{}", pin.name, getpid());
  const GalleryFiles files = make_gallery_scene(*find_gallery_scene(pin.scene).scene, {});
  write_gallery_files(files, folder);
  ShotConfig config = read_shot_config(folder / "shot.toml");
  for (const std::string& s : pin.settings) config.assign(s);
  Warnings warnings;
  const LoadedShot loaded = load_shot(config, {}, warnings);
  const Frame frame = render_frame(loaded.shot, loaded.scene, pin.frame);
  fs::remove_all(folder);

  const Image& color = frame.layer("color");
  double mean = 0;
  for (const float v : color.values()) mean += v;
  mean /= double(color.values().size());
  const std::uint64_t bits = bits_of(frame);
  EXPECT_NEAR(mean, pin.mean, 1e-3 * pin.mean);
  if (!kBitsHold) return;
  EXPECT_EQ(bits, pin.bits) << fmt::format("{} is now 0x{:016x}, mean {:.7g}", pin.name, bits, mean);
}

INSTANTIATE_TEST_SUITE_P(Scenes, PinnedBits, testing::ValuesIn(pins()),
                         [](const auto& pin) { return std::string(pin.param.name); });

}  // namespace
}  // namespace tempera
