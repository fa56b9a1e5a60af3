// SPDX-License-Identifier: Apache-2.0
// Each scene of the gallery as a thumbnail of two frames: it loads, is what its table says, and shows what it is for.
#include "tempera/gallery/gallery.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <set>

#include "tempera/core/parallel.h"
#include "tempera/frames/layers.h"
#include "tempera/pipeline/render.h"
#include "tempera/pipeline/scene_info.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;

/// Folder with published scenes, or an empty path if there is none on this machine.
fs::path published() {
  const char* variable = std::getenv("TEMPERA_SCENES");
  const fs::path folder =
      variable && *variable ? fs::path(variable) : fs::path(TEMPERA_SOURCE_DIR) / "../shared/scenes";
  std::error_code ignored;
  return fs::is_directory(folder, ignored) ? folder : fs::path();
}

/// Of all frames, two in the middle.
std::array<int, 2> two_frames(const GalleryScene& s) {
  const int middle = (s.first_frame + s.last_frame) / 2;
  return {middle, middle + 1};
}

/// Samples per pixel that make the rarest class of a scene show.
int samples(const GalleryScene& s) {
  static const std::map<std::string, int> more{
      {"ajar-door", 48}, {"glass-egg", 24}, {"wave", 24}, {"glass-cylinder", 32}, {"vase", 16}};
  const auto it = more.find(s.name);
  return it == more.end() ? 6 : it->second;
}

class Gallery : public testing::TestWithParam<const GalleryScene*> {
 protected:
  void SetUp() override {
    scene_ = GetParam();
    if (!scene_->needs.empty() && !fs::exists(published() / scene_->needs)) GTEST_SKIP() << "needs " << scene_->needs;
    folder_ = fs::temp_directory_path() / fmt::format("tempera_gallery_{}_{}", scene_->name, getpid());
    options_.scenes = published();
    static std::map<std::string, GalleryFiles> made;  // by the tests before
    GalleryFiles& files = made[scene_->name];
    if (files.empty()) files = make_gallery_scene(*scene_, options_);
    files_ = files;
    write_gallery_files(files_, folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  LoadedShot load(const std::string& shot, const std::vector<std::string>& keys) {
    ShotConfig config = read_shot_config(folder_ / shot);
    for (const std::string& k : keys) config.assign(k);
    Warnings warnings;
    LoadedShot loaded = load_shot(config, {}, warnings);
    for (const std::string& line : warnings.lines()) {
      // The published hall fills a pane with a medium.
      EXPECT_TRUE(scene_->name == "modern-hall" && line.find("medium") != std::string::npos) << line;
    }
    return loaded;
  }

  const GalleryScene* scene_ = nullptr;
  fs::path folder_;
  GalleryOptions options_;
  GalleryFiles files_;
};

/// Triangles turn their vertex normals outwards, too, and none is degenerate beyond the poles of lathes.
void check_normals(const Scene& scene) {
  for (const Shape& shape : scene.shapes) {
    const auto* mesh = std::get_if<Mesh>(&shape.geometry);
    if (!mesh) continue;
    ASSERT_EQ(mesh->normals.size(), mesh->positions.size()) << shape.name;
    std::size_t wrong = 0;
    for (std::size_t i = 0; i < mesh->indices.size(); i += 3) {
      const std::uint32_t* v = &mesh->indices[i];
      const Vec3f n =
          cross(mesh->positions[v[1]] - mesh->positions[v[0]], mesh->positions[v[2]] - mesh->positions[v[0]]);
      for (int k = 0; k < 3; ++k) wrong += dot(n, mesh->normals[v[k]]) < 0;
    }
    EXPECT_LE(wrong, mesh->indices.size() / 1000) << shape.name;
  }
}

TEST_P(Gallery, ThumbnailShowsWhatItIsFor) {
  if (IsSkipped()) return;
  const int width = 64, height = 64 * scene_->height / scene_->width;
  const LoadedShot loaded = load("shot.toml", {fmt::format("film.resolution={}x{}", width, height),
                                               fmt::format("sampling.spp={}", samples(*scene_)),
                                               "output.layers=motion,object_id", "sampling.seed=3"});
  const Shot& shot = loaded.shot;
  const Scene& scene = loaded.scene;
  EXPECT_EQ(describe(scene).placed_triangles, scene_->triangles);
  EXPECT_EQ(shot.frames.size(), std::size_t(scene_->last_frame - scene_->first_frame + 1));
  EXPECT_EQ(shot.frames.front(), scene_->first_frame);
  if (scene_->needs.empty()) check_normals(scene);

  const TimeSpan shown{shot.settings.clock.time(scene_->first_frame), shot.settings.clock.time(scene_->last_frame)};
  std::set<int> moving;  // instances
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& instance = scene.instances[i];
    bool moves = scene.moves(instance.node, shown);
    for (const int s : scene.groups[instance.group]) {
      const auto* mesh = std::get_if<Mesh>(&scene.shapes[s].geometry);
      moves |= mesh && mesh->deforms();
    }
    if (moves) moving.insert(int(i));
  }
  for (const std::string& name : scene_->moving) {
    const bool found =
        std::any_of(moving.begin(), moving.end(), [&](int i) { return scene.instances[i].name == name; });
    EXPECT_TRUE(found) << "\"" << name << "\" does not move";
  }

  std::map<std::string, double> energy;
  std::size_t moved_pixels = 0, moving_pixels = 0, resting_pixels = 0, shifted_pixels = 0;
  for (const int number : two_frames(*scene_)) {
    RenderTotals totals;
    const Frame frame = render_frame(shot, scene, number, &totals);
    EXPECT_EQ(totals.bad_samples, 0u);
    const Image &color = frame.layer("color"), &motion = frame.layer("motion.forward"), &id = frame.layer("object_id");
    double sum = 0;
    std::size_t black = 0;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const Rgb c = color.rgb(x, y);
        ASSERT_TRUE(is_finite(c));
        sum += luminance(c);
        black += is_black(c);
        const int instance = int(id.at(x, y)) - 1;
        if (instance < 0) continue;
        const double shift = length(motion.vec2(x, y));
        const bool own = moving.contains(instance);
        moving_pixels += own, moved_pixels += own && shift > 1e-3;
        resting_pixels += !own, shifted_pixels += !own && shift > 1e-3;
      }
    }
    const double mean = sum / (width * height);
    EXPECT_GT(mean, 0.01);
    EXPECT_LT(mean, 6);
    EXPECT_LT(black, std::size_t(width * height / 2));
    for (const auto& c : scene_->classes) {
      for (const float v : frame.layer("class." + c.name + ".color").values()) energy[c.name] += double(v);
    }
  }
  for (const auto& c : scene_->classes) EXPECT_GT(energy[c.name], 0) << c.name << ": no light of " << c.expression;
  if (!scene_->moving.empty() && scene_->name != "wave") {  // whose camera stands below the water and looks down
    EXPECT_GT(moving_pixels, 8u) << "nothing that moves is in the picture";
    EXPECT_GT(double(moved_pixels), 0.9 * double(moving_pixels));
  }
  if (scene_->camera_moves)
    EXPECT_GT(double(shifted_pixels), 0.9 * double(resting_pixels));
  else
    EXPECT_EQ(shifted_pixels, 0u) << "what stands still has motion vectors";
}

TEST_P(Gallery, SameFilesAgainAndReadmeSaysWhatTheyAre) {
  if (IsSkipped()) return;
  GalleryFiles again;
  with_threads(1, [&] { again = make_gallery_scene(*scene_, options_); });
  EXPECT_TRUE(files_ == again);
  std::size_t size = 0;
  for (const auto& [name, bytes] : files_) size += bytes.size();
  EXPECT_LT(size, std::size_t(8) << 20);
  const std::string& readme = files_.at("README.md");
  for (const std::string& part :
       {"# " + scene_->name + "\n", scene_->title, scene_->stands_for(), scene_->frames(),
        std::to_string(scene_->triangles), std::to_string(scene_->reference_spp), scene_->about})
    EXPECT_NE(readme.find(part), std::string::npos) << part;
}

TEST_P(Gallery, VariantsAreShots) {
  if (IsSkipped()) return;
  const LoadedShot plain = load("shot.toml", {});
  for (const GalleryVariant& v : scene_->variants) {
    const LoadedShot loaded = load("shot_" + v.name + ".toml", {});
    EXPECT_FALSE(loaded.shot.frames.empty()) << v.name;
    const int frame = loaded.shot.frames[0];
    EXPECT_TRUE(loaded.shot.frames != plain.shot.frames ||
                fingerprint(loaded.shot, loaded.scene, frame) != fingerprint(plain.shot, plain.scene, frame))
        << v.name << " changes nothing";
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, Gallery, testing::ValuesIn(gallery_catalog().begin(), gallery_catalog().end()),
                         [](const auto& scene) {
                           std::string name = scene.param->name;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

/// World position of a node by name.
Vec3d position(const Scene& scene, const std::string& name, double t) {
  for (std::size_t i = 0; i < scene.nodes.size(); ++i) {
    if (scene.nodes[i].name == name) return scene.world(int(i), t).translation;
  }
  ADD_FAILURE() << "no node " << name;
  return {};
}

struct Made {
  explicit Made(const std::string& name, const std::string& shot = "shot.toml")
      : folder(fs::temp_directory_path() / fmt::format("tempera_made_{}_{}", name, getpid())) {
    write_gallery_files(make_gallery_scene(*find_gallery_scene(name).scene, {}), folder);
    Warnings warnings;
    loaded = load_shot(read_shot_config(folder / shot), {}, warnings);
  }
  ~Made() { fs::remove_all(folder); }
  fs::path folder;
  LoadedShot loaded;
};

/// The running figure, made once.
const Made& runner() {
  static const Made made("running-figure");
  return made;
}

TEST(GalleryMotion, FeetStandStillWhileTheyCarry) {
  const Scene& scene = runner().loaded.scene;
  for (const char* foot : {"runner_foot_l", "runner_foot_r"}) {
    int standing = 0, count = 0;
    double lowest = 1, highest = 0;
    constexpr double kStep = 1.0 / 96;
    for (double t = 0.1; t < 1.42; t += kStep, ++count) {  // two strides
      const Vec3d p = position(scene, foot, t), q = position(scene, foot, t + kStep);
      standing += std::hypot(q.x - p.x, q.z - p.z) / kStep < 0.3;
      lowest = std::min(lowest, p.y), highest = std::max(highest, p.y);
    }
    EXPECT_NEAR(double(standing) / count, 0.32, 0.06) << foot;
    EXPECT_NEAR(lowest, 0.085, 0.02) << foot;  // of the ankle
    EXPECT_GT(highest, 0.4) << foot;
  }
  const double speed = (position(scene, "runner_hips", 1).z - position(scene, "runner_hips", 0.34).z) / 0.66;
  EXPECT_NEAR(speed, 3.55, 0.05);
}

TEST(GalleryMotion, RunsFasterInItsVariants) {
  const auto step = [](const char* file) {
    Warnings warnings;
    const LoadedShot loaded = load_shot(read_shot_config(runner().folder / file), {}, warnings);
    const FrameClock& clock = loaded.shot.settings.clock;
    return position(loaded.scene, "runner_hips", clock.time(8)).z -
           position(loaded.scene, "runner_hips", clock.time(7)).z;
  };
  const double slow = step("shot.toml");
  EXPECT_NEAR(step("shot_2x.toml") / slow, 2, 1e-3);
  EXPECT_NEAR(step("shot_4x.toml") / slow, 4, 1e-3);
}

TEST(GalleryMotion, TheWaveIsTheOneOfTheStudy) {
  // Both ways of moving it give y = 2 + 0.05 sin(2 pi (x - 0.1 f)).
  for (const char* shot : {"shot.toml", "shot_vertical.toml"}) {
    const Made made("wave", shot);
    const Scene& scene = made.loaded.scene;
    const double f = 7.25, t = made.loaded.shot.settings.clock.time(0) + f / 24;
    const auto instance = std::find_if(scene.instances.begin(), scene.instances.end(),
                                       [](const Instance& i) { return i.name == "wave"; });
    ASSERT_NE(instance, scene.instances.end());
    const auto& mesh = std::get<Mesh>(scene.shapes[scene.groups[instance->group][0]].geometry);
    const Affine3d world = scene.world(instance->node, t);
    const std::vector<float> weights = mesh.morph_targets.empty() ? std::vector<float>() : mesh.morph_weights.at(t);
    for (std::size_t v = 0; v < mesh.positions.size(); v += 37) {
      Vec3f p = mesh.positions[v], n = mesh.normals[v];
      for (std::size_t k = 0; k < weights.size(); ++k) {
        p += mesh.morph_targets[k].positions[v] * weights[k];
        n += mesh.morph_targets[k].normals[v] * weights[k];
      }
      const Vec3d q = world.point(Vec3d(p));
      const double phase = 2 * kPiD * (q.x - 0.1 * f), slope = 0.05 * 2 * kPiD * std::cos(phase);
      EXPECT_NEAR(q.y, 2 + 0.05 * std::sin(phase), 2e-4) << shot;
      const Vec3d expected = normalize(Vec3d{-slope, 1, 0});
      EXPECT_NEAR(length(normalize(Vec3d(n)) - expected), 0, 4e-3) << shot;
    }
  }
}

TEST(GalleryMotion, WheelsRoll) {
  const Made made("loader");
  const Scene& scene = made.loaded.scene;
  const FrameClock& clock = made.loaded.shot.settings.clock;
  // The point of a wheel on the ground is at rest: the turn is the way over the radius.
  const auto hub =
      std::find_if(scene.nodes.begin(), scene.nodes.end(), [](const Node& n) { return n.name == "hub_front_left"; }) -
      scene.nodes.begin();
  const double t = clock.time(20), h = 1e-3;
  const Affine3d a = scene.world(int(hub), t), b = scene.world(int(hub), t + h);
  const Vec3d contact = inverse(a).point(a.translation + Vec3d{0, -0.78, 0});
  EXPECT_NEAR(length(b.point(contact) - a.point(contact)) / h, 0, 5e-3);
  EXPECT_NEAR((b.translation.x - a.translation.x) / h, 0.05 * 24, 1e-3);
}

// What each piece shows has vectors there and back, but where its own edge comes in between.
TEST(GalleryMotion, MirrorsAndGlassOfTheTestsAreFollowed) {
  if (layers::chain_motion().empty()) GTEST_SKIP() << "built without TEMPERA_PATH_SPACE_MOTION";
  const std::map<std::string, std::string> shown{
      {"mirror-plane", "RD"},  {"mirror-sphere", "RD"},  {"slab", "TTD"},       {"sheet", "TD"},
      {"glass-sphere", "TTD"}, {"glass-shell", "TTTTD"}, {"thick-lens", "TTD"}, {"mesh-deform", "TTD"}};
  const GalleryScene& scene = *find_gallery_scene("motion-tests").scene;
  const Made made("motion-tests");
  ASSERT_EQ(scene.variants.size(), shown.size());
  for (const GalleryVariant& v : scene.variants) {
    ShotConfig config = read_shot_config(made.folder / ("shot_" + v.name + ".toml"));
    for (const char* key : {"film.resolution=128x72", "sampling.spp=1", "output.layers=chains,chain_motion"})
      config.assign(key);
    Warnings warnings;
    const LoadedShot loaded = load_shot(config, {}, warnings);
    EXPECT_TRUE(warnings.lines().empty()) << v.name;
    const Frame frame = render_frame(loaded.shot, loaded.scene, 6, nullptr);
    const Image& state = frame.layer("chain." + shown.at(v.name) + ".motion.state");
    int there = 0, tracked = 0, moved = 0;
    const Image& vectors = frame.layer("chain." + shown.at(v.name) + ".motion.forward");
    for (int y = 0; y < frame.height(); ++y) {
      for (int x = 0; x < frame.width(); ++x) {
        for (int direction = 0; direction < 2; ++direction) {
          there += MotionState(int(state.at(x, y, direction))) != MotionState::kEmpty;
          tracked += MotionState(int(state.at(x, y, direction))) == MotionState::kTracked;
        }
        moved += length(vectors.vec2(x, y)) > 0.1;
      }
    }
    const bool edges = v.name == "mirror-plane" || v.name == "slab" || v.name == "sheet";
    EXPECT_GT(there, 1000) << v.name;
    EXPECT_GE(tracked, (edges ? 0.8 : 0.97) * there) << v.name;
    EXPECT_GT(moved, 0.2 * there) << v.name;
  }
}

// Emitters are seen directly, in mirrors and through glass by classes of their own, and all classes are the picture.
TEST(GalleryClasses, LightOfASignAddsUp) {
  const GalleryScene& scene = *find_gallery_scene("coat-emit").scene;
  const Made made("coat-emit");
  ShotConfig config = read_shot_config(made.folder / "shot.toml");
  for (const char* key : {"film.resolution=64x36", "sampling.spp=16"}) config.assign(key);
  Warnings warnings;
  const LoadedShot loaded = load_shot(config, {}, warnings);
  const Frame frame = render_frame(loaded.shot, loaded.scene, 12, nullptr);
  const Image& color = frame.layer("color");
  std::map<std::string, double> light;
  double all = 0;
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < frame.width(); ++x) {
      Rgb sum = frame.layer("class.residual.color").rgb(x, y);
      light["residual"] += luminance(sum);
      for (const GalleryClass& c : scene.classes) {
        const Rgb part = frame.layer("class." + c.name + ".color").rgb(x, y);
        sum += part, light[c.name] += luminance(part);
      }
      const Rgb whole = color.rgb(x, y);
      all += luminance(whole);
      for (int k = 0; k < 3; ++k) ASSERT_NEAR(sum[k], whole[k], 1e-5 * (1 + whole[k])) << x << ' ' << y;
    }
  }
  for (const char* name : {"emission", "mirrored", "passed"}) EXPECT_GT(light[name], 0.005 * all) << name;
  EXPECT_LT(light["residual"], 0.2 * all);
}

}  // namespace
}  // namespace tempera
