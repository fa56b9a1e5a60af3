// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

/// What the command line made of a file.
struct Settled {
  ShotConfig config;
  Shot shot;
};
Settled settle(const std::string& file, const std::string& toml, const std::vector<std::string>& typed = {}) {
  Scene s;
  s.source = "scene.xml";
  s.cameras.resize(1);
  s.environments.resize(1);
  Settled out;
  out.config.read_text("scene = \"scene.xml\"\nframes = \"1-240\"\n" + toml, file, ".");
  for (const std::string& t : typed) out.config.assign(t);
  out.shot = settle_shot(out.config, s);
  out.shot.source = file;  // read_text knows no file
  return out;
}
RunPlan plan(const std::string& toml, const std::vector<std::string>& typed = {},
             const std::string& file = "dance.toml") {
  const Settled s = settle(file, toml, typed);
  return plan_run(s.config, s.shot);
}
const std::string kTemporal = "[integrator]\nname = \"temporal_gradient_path\"\n";

TEST(RunPlan, FilesHaveTheirPlaces) {
  const RunPlan from_name = plan(kTemporal);
  EXPECT_EQ(from_name.render.output, "out/dance/dance.####.exr");
  EXPECT_EQ(from_name.output, "out/dance/final/dance.####.exr");
  EXPECT_EQ(from_name.video_path, "out/dance/dance.mp4");
  EXPECT_EQ(plan("", {}, "scenes/demo/shot.toml").output, "out/demo/demo.####.exr");
  EXPECT_EQ(plan("", {}, "scenes/demo/shot_4x.toml").output, "out/demo_4x/demo_4x.####.exr");

  const RunPlan pattern = plan(kTemporal, {"output.path=a/f_%03d.exr"});
  EXPECT_EQ(pattern.output, "a/final/f_%03d.exr");
  EXPECT_EQ(pattern.video_path, "a/f.mp4");
  EXPECT_EQ(plan("", {"output.path=a/####.exr"}).video_path, "a/movie.mp4");
  EXPECT_EQ(plan("", {"output.path=a/f.exr"}).output, "a/f.####.exr");
  EXPECT_EQ(plan("", {"output.path=a.b"}).output, "a.b/scene.####.exr") << "called after what was read";
  EXPECT_EQ(plan("", {"output.path=a/f.@@@"}).output, "a/f.@@@.exr");
  EXPECT_EQ(plan("[video]\ncodec = \"ffv1\"\n").video_path, "out/dance/dance.mkv");
  EXPECT_EQ(plan(kTemporal + "[reconstruct]\npath = \"b/g.####.exr\"\n").output, "b/g.####.exr");
  EXPECT_EQ(plan(kTemporal + "[reconstruct]\npath = \"b\"\n").output, "b/dance.####.exr");
}

TEST(RunPlan, OneFrameIsOneFile) {
  EXPECT_EQ(plan("", {"frames=5", "output.path=a/f.exr"}).output, "a/f.exr");
  EXPECT_EQ(plan("[output]\npath = \"a/f.exr\"\n", {"frames=5"}).output, "a/f.####.exr")
      << "parts of a shot that names its files must not replace each other";
  const RunPlan still = plan("[integrator]\nname = \"gradient_path\"\n", {"frames=5", "output.path=a/f.exr"});
  EXPECT_EQ(still.render.output, "a/f.exr");
  EXPECT_EQ(still.output, "a/final/f.exr");
  const RunPlan temporal = plan(kTemporal, {"frames=5", "output.path=a/f.exr", "reconstruct.path=b/g.exr"});
  EXPECT_EQ(temporal.render.output, "a/f.####.exr") << "neighbors are rendered as well";
  EXPECT_EQ(temporal.output, "b/g.exr");
}

TEST(RunPlan, PartsRenderWhatTheirWindowsReach) {
  const RunPlan part = plan(kTemporal, {"frames=50-99"});
  EXPECT_EQ(part.frames.size(), 50u);
  EXPECT_EQ(part.render.frames.front(), 45);
  EXPECT_EQ(part.render.frames.back(), 104);
  EXPECT_EQ(part.neighbors, (std::vector<int>{45, 46, 47, 48, 49, 100, 101, 102, 103, 104}));
  ASSERT_EQ(part.stages.size(), 1u);
  EXPECT_EQ(part.stages[0].frames, part.frames);
  ASSERT_EQ(part.stages[0].sections.size(), 1u);
  EXPECT_EQ(part.stages[0].sections[0].sequence, (FrameRange{1, 240}));
  EXPECT_EQ(part.stages[0].sections[0].reach, (FrameRange{1, 240}));
  EXPECT_TRUE(plan(kTemporal).neighbors.empty());
  EXPECT_TRUE(plan("", {"frames=51-100"}).neighbors.empty()) << "nothing is reconstructed";
  EXPECT_TRUE(plan("[integrator]\nname = \"gradient_path\"\n", {"frames=51-100"}).neighbors.empty());
  EXPECT_EQ(plan("", {"frames=9,3"}).render.frames, (std::vector<int>{9, 3})) << "in the order written";
  const RunPlan beyond = plan(kTemporal, {"frames=236-250"});
  EXPECT_EQ(beyond.stages[0].sections[0].sequence, (FrameRange{1, 250}));
}

TEST(RunPlan, StagesAreThoseThatTheShotNames) {
  EXPECT_TRUE(plan("").stages.empty());
  EXPECT_EQ(plan(kTemporal).stages.size(), 1u) << "as such frames are made for";
  const RunPlan raw = plan("stages = []\n" + kTemporal);
  EXPECT_TRUE(raw.stages.empty());
  EXPECT_EQ(raw.output, raw.render.output);
  const RunPlan named = plan("stages = [\"reconstruct\"]\n" + kTemporal);
  ASSERT_EQ(named.stages.size(), 1u);
  EXPECT_EQ(named.stages[0].choice.entry->name, "reconstruct");
  EXPECT_EQ(named.output, plan(kTemporal).output);
  EXPECT_EQ(plan(kTemporal, {"stages=reconstruct"}).stages.size(), 1u);
  EXPECT_TRUE(plan(kTemporal, {"stages="}).stages.empty());
}

// A named stage gets what it can use of what the integrator writes; a render that is asked for less stays as it is.
TEST(RunPlan, RendersWhatTheFirstStageCanUse) {
  const auto layers = [](const RunPlan& p) { return p.render.settings.layers; };
  const auto asks = [&](const RunPlan& p, const char* layer) {
    const std::vector<std::string> all = layers(p);
    return std::count(all.begin(), all.end(), layer);
  };
  const RunPlan denoised = plan("stages = [\"denoise\"]\n[output]\nlayers = [\"albedo\"]\n");
  for (const char* layer : {"color.a", "color.b", "albedo", "normal", "emission", "object_id", "motion.forward"})
    EXPECT_EQ(asks(denoised, layer), 1) << layer;
  EXPECT_EQ(asks(plan("[output]\nlayers = [\"albedo\"]\n"), "color.a"), 0);
  const RunPlan traced = plan("stages = [\"denoise\"]\n[integrator]\nname = \"light_path\"\n");
  EXPECT_EQ(asks(traced, "color.a"), 0) << "it has no halves";
  EXPECT_EQ(asks(traced, "albedo"), 1);
  EXPECT_EQ(layers(plan(kTemporal)), layers(plan("stages = []\n" + kTemporal)));
}

TEST(RunPlan, MoviesShowWhatStagesWrite) {
  EXPECT_NO_THROW(plan(kTemporal + "[video]\nlayer = \"color.rare\"\n"));
  EXPECT_THROW(plan(kTemporal + "[video]\nlayer = \"color.rare\"\n[reconstruct]\nparts = \"no\"\n"), Error);
}

TEST(RunPlan, HaloBoundsTheFramesAroundAndTellsTheLoss) {
  const RunPlan whole = plan(kTemporal, {"frames=9-16"});
  // Windows of ten frames begin at every fifth: frame 9 is in 0-9, and 16 in 15-24.
  EXPECT_EQ(whole.neighbors, (std::vector<int>{1, 2, 3, 4, 5, 6, 7, 8, 17, 18, 19, 20, 21, 22, 23, 24}));
  EXPECT_TRUE(whole.loss.left_out.empty() && whole.loss.differing.empty());

  const RunPlan cut = plan(kTemporal, {"frames=9-16", "halo=2"});
  EXPECT_EQ(cut.neighbors, (std::vector<int>{7, 8, 17, 18}));
  EXPECT_EQ(cut.loss.left_out, (std::vector<int>{1, 2, 3, 4, 5, 6, 19, 20, 21, 22, 23, 24}));
  EXPECT_EQ(cut.loss.differing, (std::vector<int>{9, 10, 11, 12, 13, 14, 15, 16}));
  EXPECT_EQ(cut.loss.enough, 8);
  EXPECT_EQ(plan(kTemporal, {"frames=9-16", "halo=7"}).loss.differing, (std::vector<int>{9, 15, 16}));
  ASSERT_EQ(cut.stages[0].sections.size(), 1u);
  EXPECT_EQ(cut.stages[0].sections[0].reach, (FrameRange{7, 18}));
  EXPECT_EQ(cut.stages[0].sections[0].sequence, (FrameRange{1, 240}));
  EXPECT_TRUE(plan(kTemporal, {"frames=9-16", "halo=9"}).loss.left_out.empty());
  EXPECT_EQ(plan(kTemporal, {"frames=9-16", "halo=9"}).neighbors, whole.neighbors);

  // Runs that lie apart are cut from each other; near ones are not.
  const RunPlan apart = plan(kTemporal, {"frames=9,40-41,43", "halo=1"});
  ASSERT_EQ(apart.stages[0].sections.size(), 2u);
  EXPECT_EQ(apart.stages[0].sections[0].reach, (FrameRange{8, 10}));
  EXPECT_EQ(apart.stages[0].sections[1].reach, (FrameRange{39, 44}));
  EXPECT_EQ(apart.render.frames, (std::vector<int>{8, 9, 10, 39, 40, 41, 42, 43, 44}));
  EXPECT_TRUE(plan(kTemporal, {"frames=9-16", "halo=0"}).neighbors.empty());
  EXPECT_EQ(plan("halo = 2\n" + kTemporal, {"frames=9-16"}).neighbors, cut.neighbors) << "a key of the file";
  EXPECT_TRUE(plan(kTemporal, {"halo=0"}).loss.left_out.empty()) << "all frames of the shot are asked for";
  EXPECT_TRUE(plan("", {"frames=9-16", "halo=0"}).loss.left_out.empty()) << "nothing looks around";
}

TEST(RunPlan, MoviesOfPartsDoNotReplaceThatOfTheWhole) {
  EXPECT_EQ(plan("", {"frames=51-100"}).video_path, "out/dance/dance.51-100.mp4");
  EXPECT_EQ(plan("[video]\npath = \"m.mov\"\n", {"frames=51-100"}).video_path, "m.51-100.mov");
  EXPECT_EQ(plan("", {"frames=51-100", "video.path=m.mov"}).video_path, "m.mov") << "as it was typed";
  EXPECT_EQ(plan("", {"frames=51"}).video_path, "");
  EXPECT_EQ(plan("", {"frames=51", "video.path=m.mov"}).video_path, "m.mov");
}

TEST(RunPlan, WhatWasAskedOfFilesHoldsForTheResult) {
  const std::string spatial = "[integrator]\nname = \"gradient_path\"\n";
  const RunPlan p = plan(spatial + "[output]\nhalf = true\naov_names = \"blender\"\ncompression = \"dwaa\"\n");
  EXPECT_FALSE(p.render.write.half);
  EXPECT_EQ(p.render.write.names, AovNames::kTempera);
  EXPECT_EQ(p.render.write.compression, Compression::kZip);
  EXPECT_TRUE(p.render.final_write.half);
  EXPECT_EQ(p.render.final_write.names, AovNames::kBlender);
}

TEST(RunPlan, ErrorsNameTheirPlace) {
  const auto error_of = [](const std::string& toml) {
    try {
      plan(toml);
    } catch (const Error& e) {
      EXPECT_EQ(e.loc().file, "dance.toml") << e.what();
      return e;
    }
    return Error(ErrorCode::kFailed, "nothing was thrown");
  };
  const Error same = error_of(kTemporal + "[reconstruct]\npath = \"out/../out/dance\"\n");
  EXPECT_EQ(same.code(), ErrorCode::kBadInput);
  EXPECT_EQ(same.loc().line, 6) << same.what();
  EXPECT_EQ(error_of("[output]\npath = \"a/f.####.png\"\n").loc().line, 4);
  EXPECT_EQ(error_of(kTemporal + "[reconstruct]\npath = \"b/f.TIF\"\n").loc().line, 6);
  const Error lossy = error_of("[output]\nlayers = [\"normal\", \"cryptomatte\"]\ncompression = \"dwaa\"\n");
  EXPECT_EQ(lossy.code(), ErrorCode::kUnsupported);
  EXPECT_EQ(lossy.loc().line, 5) << lossy.what();
  EXPECT_EQ(error_of("[video]\npath = \"a.gif\"\n").loc().line, 4);
  EXPECT_EQ(error_of("[video]\npath = \"a.mp4\"\ncodec = \"ffv1\"\n").loc().line, 4);
  EXPECT_EQ(error_of(kTemporal + "[video]\nlayer = \"grad.x\"\n").loc().line, 6);

  const Error unknown = error_of("stages = [\n  \"reconstruct\",\n  \"reconstuct\",\n]\n" + kTemporal);
  EXPECT_EQ(unknown.code(), ErrorCode::kUnknownName);
  EXPECT_EQ(unknown.loc().line, 5) << "the element, not the list: " << unknown.what();
  EXPECT_NE(unknown.message().find("known: reconstruct"), std::string::npos) << unknown.what();
  EXPECT_EQ(error_of("stages = [\"reconstruct\", \"reconstruct\"]\n" + kTemporal).loc().line, 3);
  EXPECT_EQ(error_of("stages = 3\n").loc().line, 3);
  EXPECT_EQ(error_of("halo = -2\n").loc().line, 3);
  const Error alone = error_of(
      "stages = [\"reconstruct\"]\n[reconstruct]\nweights = \"variance\"\n[integrator]\nname = \"gradient_path\"\n");
  EXPECT_NE(alone.message().find("compares the two passes"), std::string::npos) << alone.what();
  EXPECT_EQ(alone.loc().line, 3);
  const Error missing = error_of("stages = [\"reconstruct\"]\n");
  EXPECT_EQ(missing.code(), ErrorCode::kBadInput);
  EXPECT_EQ(missing.loc().line, 3);
  EXPECT_EQ(missing.message(),
            "the stage reconstruct needs the layer \"grad.x\", which no step before it writes: the integrator "
            "gradient_path or the integrator temporal_gradient_path would write it");
}

TEST(RunPlan, FastRendersEveryFourthFrameSharpAndHalfAsLarge) {
  const std::string fast = "quality = \"fast\"\ncuts = [20]\n[film]\nresolution = \"64x36\"\n[shutter]\nclose = 0.6\n";
  const RunPlan p = plan(fast, {"frames=10-11,18-21"});
  EXPECT_EQ(p.render.frames, (std::vector<int>{9, 13, 17, 19, 20, 21, 25})) << "both sides of the cut";
  EXPECT_EQ(p.render.settings.width, 32);
  EXPECT_EQ(p.render.settings.height, 18);
  EXPECT_EQ(p.render.settings.spp, 64);
  EXPECT_DOUBLE_EQ(p.render.settings.clock.shutter.open, 0.3);
  EXPECT_DOUBLE_EQ(p.render.settings.clock.shutter.close, 0.3);
  ASSERT_TRUE(p.guides);
  EXPECT_EQ(p.guides->frames, (std::vector<int>{9, 10, 11, 12, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25}))
      << "the frame after 21 shows what comes into view";
  EXPECT_EQ(p.guides->settings.width, 64);
  EXPECT_EQ(p.guides->settings.spp, 8);
  EXPECT_EQ(p.guides->output, "out/dance/guides/dance.####.exr");
  EXPECT_EQ(p.frames, (std::vector<int>{10, 11, 18, 19, 20, 21}));
  std::vector<std::string> names;
  for (const RunStage& s : p.stages) names.push_back(s.choice.entry->name);
  EXPECT_EQ(names, (std::vector<std::string>{"denoise", "upsample", "fill", "interpolate", "fill", "motionblur"}));
  EXPECT_EQ(p.stages[0].choice.params.get_int("radius"), 0) << "frames around keys are not rendered";
  EXPECT_EQ(p.stages[3].choice.params.get_string("cuts"), "20");
  EXPECT_DOUBLE_EQ(p.stages[5].choice.params.get_double("shutter"), 0.6);
  EXPECT_EQ(p.stages[2].pixels->settings.width, 64);
  EXPECT_EQ(p.stages[2].pixels->settings.spp, 64);

  const RunPlan cropped =
      plan("quality = \"fast\"\n[film]\nresolution = \"64x36\"\ncrop = \"2,4,32,16\"\n", {"frames=10"});
  const RenderSettings& small = cropped.render.settings;
  EXPECT_EQ(
      (std::vector<int>{small.width, small.height, small.crop_x, small.crop_y, small.crop_width, small.crop_height}),
      (std::vector<int>{32, 18, 1, 2, 16, 8}));
  EXPECT_EQ(cropped.guides->settings.crop_width, 32);
  const RunPlan closed = plan("quality = \"fast\"\n[film]\nresolution = \"64x36\"\n[shutter]\nclose = 0\n");
  EXPECT_EQ(closed.stages[5].choice.params.get_double("shutter"), 0) << "a closed shutter stays closed";
  EXPECT_EQ(plan("stages = [\"motionblur\"]\n[shutter]\nclose = 0\n").stages[0].choice.params.get_double("shutter"),
            0.5)
      << "unless the shot asks for blur alone";

  const RunPlan own =
      plan(fast + "[interpolate]\nevery = 6\n[motionblur]\nshutter = 1\n[guides]\nspp = 3\n", {"frames=10"});
  EXPECT_EQ(own.render.frames, (std::vector<int>{7, 13}));
  EXPECT_EQ(own.guides->settings.spp, 3);
  EXPECT_DOUBLE_EQ(own.stages[5].choice.params.get_double("shutter"), 1);
}

TEST(RunPlan, FastFollowsTheClassesOfADecomposition) {
  const std::string fast = "quality = \"fast\"\n[film]\nresolution = \"64x36\"\n";
  const auto recipe = [](const RunPlan& p) { return p.stages[0].choice.params.get_string("recipe"); };
  EXPECT_EQ(recipe(plan(fast)), "auto");
  const std::string tree = "[decompose]\ntree = \"default\"\n";
  const RunPlan p = plan(fast + tree);
  EXPECT_EQ(recipe(p), "classes");
  const auto has = [](const std::vector<LayerDesc>& layers, const char* name) {
    return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == name; });
  };
  for (const char* layer : {"class.reflection.color.a", "chain.RD.albedo"}) {
    EXPECT_TRUE(has(rendered_layers(p.render), layer)) << layer;
    EXPECT_TRUE(has(rendered_layers(*p.guides), layer)) << layer;
  }
  if (!layers::chain_motion().empty()) {
    for (const char* layer : {"chain.RD.motion.forward", "chain.RD.object_id"})
      EXPECT_TRUE(has(rendered_layers(*p.guides), layer)) << layer;
  }
  EXPECT_EQ(recipe(plan(fast + tree + "[denoise]\nrecipe = \"halves\"\n")), "halves");
  EXPECT_EQ(recipe(plan(fast + tree + "[denoise]\nmethod = \"rmz13\"\n")), "auto");
}

TEST(RunPlan, WhatCannotBeMadeOfFewFramesIsRefused) {
  const auto error_of = [](const std::string& toml) {
    try {
      plan(toml);
    } catch (const Error& e) {
      return e;
    }
    return Error(ErrorCode::kFailed, "nothing was thrown");
  };
  const auto says = [&](const std::string& toml, int line, const std::string& part) {
    const Error e = error_of(toml);
    EXPECT_EQ(e.loc().line, line) << e.what();
    EXPECT_NE(e.message().find(part), std::string::npos) << e.what();
  };
  const std::string fast = "quality = \"fast\"\n", even = "[film]\nresolution = \"64x36\"\n";
  says(fast + "[film]\nresolution = \"64x35\"\n", 3, "2 times as wide and high, which cannot be 64x35, but 64x36");
  says(fast + "[film]\nresolution = \"64x36\"\ncrop = \"0,1,32,32\"\n", 3, "multiples of 2");
  says(fast + even + "[shutter]\nrolling = 0.5\n", 7, "no shape or rolling shutter");
  says(fast + even + "[shutter]\nshape = \"trapezoid\"\n", 7, "no shape or rolling shutter");
  says(fast + even + "[shutter]\nclose = 3\n", 7, "2 frames at most");
  says(fast + even + "[sampling]\nseed_per_frame = false\n", 7, "the same noise");
  says(fast + even + "[integrator]\nname = \"gradient_path\"\n", 3, "renders whole pictures alone");
  says("stages = [\"interpolate\"]\n", 3, "close the shutter (shutter.close = 0), or add the stage motionblur");
  EXPECT_NO_THROW(plan("stages = [\"interpolate\"]\n[shutter]\nclose = 0\n"));
  says("stages = [\"interpolate\"]\n[interpolate]\nevery = 0\n[shutter]\nclose = 0\n", 3, "every = 0");
  EXPECT_NO_THROW(plan("stages = [\"motionblur\"]\n")) << "the shutter is closed for it, and opened again";
}

}  // namespace
}  // namespace tempera
