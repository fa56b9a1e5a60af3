// SPDX-License-Identifier: Apache-2.0
// Sections, passes and units: what the driver promises to methods of every shape.
#include "box_shot.h"
#include "tempera/methods/render_section.h"

namespace tempera {
namespace {

/// Path tracing of four frames at a time, which ignore each other.
class BlockOfFrames final : public Method {
 public:
  explicit BlockOfFrames(std::unique_ptr<Method> path) : path_(std::move(path)) {}
  std::vector<LayerDesc> outputs(const RenderSettings& s) const override { return path_->outputs(s); }
  FrameRange section(const RenderSettings&, FrameRange sequence, int frame) const override {
    const int first = frame - (frame - sequence.first) % 4;
    return {first, std::min(first + 3, sequence.last)};
  }
  std::vector<PassDesc> passes(const RenderSettings& s, FrameRange range) const override {
    return path_->passes(s, range);
  }
  void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out, RenderCounters& counters,
           std::stop_token stop) const override {
    path_->run(window, state, unit, out, counters, std::move(stop));
  }
  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    return path_->replay(context, sample);
  }

 private:
  std::unique_ptr<Method> path_;
};

BoxShot moving_shot() {
  BoxShot shot = BoxShot(make_diffuse(0.7f), nullptr).area_light();
  AnimatedTransform pose;
  pose.keyed = true;
  pose.translation = {{0, 6}, {Vec3d{-0.6, -0.5, 0.1}, Vec3d{0.6, 0.3, 0.1}}, Interpolation::kLinear};
  pose.scale = Vec3d{0.4, 0.4, 0.4};
  shot.add(Sphere{}, make_plastic({}), shot.node(pose));
  shot.settings.spp = 4;
  return shot;
}

bool render(const Method& method, const TestShot& shot, Section& section, const SectionHooks& hooks = {},
            const std::stop_token& stop = {}) {
  GeometryCache cache;
  const LightPathClassifier classifier;
  SceneWindow window(shot.scene, shot.settings, classifier, 1.0 / 16, cache, section.range());
  return render_section(method, window, section, {}, hooks, stop);
}

TEST(Section, AMethodOverABlockOfFramesThatIgnoresItsNeighboursHasTheBitsOfPath) {
  BoxShot shot = moving_shot();
  const BlockOfFrames method(shot.make_method());
  const FrameRange range = method.section(shot.settings, {1, 6}, 3);
  EXPECT_EQ(range, (FrameRange{1, 4}));
  for (const std::vector<int>& frames : {std::vector<int>{1, 2, 3, 4}, std::vector<int>{2, 4}}) {
    Section section(method, shot.settings, shot.scene, range, frames, method.passes(shot.settings, range), shot.tile);
    ASSERT_TRUE(render(method, shot, section));
    section.finish(method);
    for (const int f : frames) EXPECT_EQ(section.picture(f).layer("color"), shot.render(f).layer("color")) << f;
  }
}

TEST(Section, ASparseRenderGivesExactlyThePixelsOfTheFullOne) {
  BoxShot shot = moving_shot();
  shot.settings.layers = {"color", "color.a", "color.var", "albedo", "normal", "motion.backward"};
  if (!layers::chain_motion().empty()) shot.settings.layers.push_back("chain.D.motion.forward");
  for (const char* name : {"path", "light_path"}) {
    shot.integrator = name;
    if (shot.integrator == "light_path") shot.settings.layers = {"color", "albedo", "normal"};
    const auto method = shot.make_method();
    ASSERT_TRUE(method->renders_single_pixels());
    Section section(*method, shot.settings, shot.scene, {2, 2}, {2}, method->passes(shot.settings, {2, 2}), shot.tile);
    Image mask(shot.settings.width, shot.settings.height, 1);
    for (int y = 0; y < mask.height(); ++y) {
      for (int x = 0; x < mask.width(); ++x) mask.at(x, y) = (x * 7 + y * 5) % 11 == 0 ? 1.0f : 0.0f;
    }
    SectionHooks hooks;
    hooks.mask = [&](int) { return &mask; };
    ASSERT_TRUE(render(*method, shot, section, hooks));
    section.finish(*method);
    const Frame whole = shot.render(2);
    const Frame& sparse = section.picture(2);
    std::int64_t rendered = 0;
    for (const Layer& layer : whole.layers()) {
      if (layer.desc.name.starts_with("motion")) continue;  // costs no samples, and is there everywhere
      for (int y = 0; y < mask.height(); ++y) {
        for (int x = 0; x < mask.width(); ++x) {
          if (mask.at(x, y) == 0) continue;
          ++rendered;
          for (int c = 0; c < layer.image.channels(); ++c)
            ASSERT_EQ(sparse.layer(layer.desc.name).at(x, y, c), layer.image.at(x, y, c)) << name << layer.desc.name;
        }
      }
    }
    EXPECT_GT(rendered, 0);
    if (shot.integrator == "path") {
      EXPECT_LT(section.totals().samples, std::uint64_t(mask.pixels()) * 4 / 8);
    }
  }
  shot.integrator = "path";
  shot.parameters += ",adaptive_error=0.1";
  EXPECT_FALSE(shot.make_method()->renders_single_pixels()) << "pixels look at their neighbours";
}

TEST(Section, EveryPassOfAdaptiveSamplingContinuesFromWhatWasSaved) {
  for (const char* name : {"gradient_path", "temporal_gradient_path"}) {
    for (const char* mode : {"published", "unbiased"}) {
      BoxShot shot = moving_shot();
      shot.integrator = name;
      shot.parameters += ",adaptive=" + std::string(mode) + ",adaptive_batches=3";
      shot.settings.spp = 24;
      shot.settings.layers = {"color", "color.var", "samples", "CryptoObject00"};
      const auto method = shot.make_method();
      const auto make = [&] {
        return std::make_unique<Section>(*method, shot.settings, shot.scene, FrameRange{2, 2}, std::vector<int>{2},
                                         method->passes(shot.settings, {2, 2}), shot.tile);
      };
      const Frame whole = shot.render(2);
      const Image samples_before = shot.integrator == "gradient_path" ? Image() : shot.render(1).layer("samples");
      auto section = make();
      int runs = 0;
      for (; !section->is_done() && runs < 100; ++runs) {
        std::stop_source stop;
        std::atomic<int> left{2};
        SectionHooks hooks;
        hooks.read = [&](int frame, const LayerRead&) {
          EXPECT_EQ(frame, 1);
          return samples_before;
        };
        hooks.done = [&](const Unit&, const Frame*, const RenderTotals&) {
          if (--left == 0) stop.request_stop();
        };
        render(*method, shot, *section, hooks, stop.get_token());
        Bytes bytes;
        ByteWriter out(bytes);
        section->save(out);
        section = make();
        ByteReader in(bytes);
        section->load(in);
      }
      EXPECT_GT(runs, 3) << name;
      section->finish(*method);
      for (const Layer& layer : whole.layers())
        EXPECT_EQ(section->picture(2).layer(layer.desc.name), layer.image)
            << name << " " << mode << " " << layer.desc.name;
    }
  }
}

}  // namespace
}  // namespace tempera
