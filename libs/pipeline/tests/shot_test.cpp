// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/shot.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "tempera/pipeline/materials.h"

namespace tempera {
namespace {

/// A scene of one quad with what a scene file may ask for.
Scene scene() {
  Scene s;
  s.source = "scene.xml";
  s.content_hash = 42;
  s.shapes.push_back({make_rectangle(), make_diffuse(), std::nullopt, "quad", "Paint"});
  s.groups = {{0}};
  s.instances.push_back({});
  s.cameras.resize(2);
  s.cameras[0].name = "near";
  s.cameras[1].name = "far";
  s.environments.resize(1);
  return s;
}

Shot settle(const std::string& toml, Scene& s) {
  ShotConfig c;
  c.read_text("scene = \"scene.xml\"\n" + toml, "shot.toml", ".");
  return settle_shot(c, s);
}
Shot settle(const std::string& toml) {
  Scene s = scene();
  return settle(toml, s);
}

Error error_of(const std::string& toml) {
  try {
    settle(toml);
  } catch (const Error& e) {
    return e;
  }
  return Error(ErrorCode::kFailed, "nothing was thrown");
}

std::vector<std::string> stages_of(const Shot& shot) {
  std::vector<std::string> names;
  for (const ShotStage& s : shot.stages) names.push_back(s.choice.entry->name);
  return names;
}

bool writes(const Shot& shot, const LayerDesc& layer) {
  const std::vector<LayerDesc> layers = rendered_layers(shot);
  return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
}

TEST(Shot, QualityStandsForWhatIsNotSaid) {
  const std::vector<std::string> denoised{"denoise"};
  const Shot draft = settle("quality = \"draft\"\n"), final = settle("quality = \"final\"\n");
  EXPECT_EQ(draft.settings.spp, 8);
  EXPECT_EQ(final.settings.spp, 64);
  for (const Shot* shot : {&draft, &final}) {
    EXPECT_EQ(stages_of(*shot), denoised);
    EXPECT_EQ(shot->stages[0].choice.params.get_string("method"), "auto");
    for (const LayerDesc& d :
         {layers::color_a(), layers::color_b(), layers::normal(), layers::object_id(), layers::motion_forward()}) {
      EXPECT_TRUE(writes(*shot, d)) << d.name;
    }
  }
  // Of many samples it looks through glass and into mirrors.
  const LayerDesc seen = layers::chain_layer(layers::kAnyChain, layers::albedo());
  EXPECT_TRUE(writes(draft, layers::albedo()) && !writes(draft, seen));
  EXPECT_TRUE(writes(final, seen) && !writes(final, layers::albedo()));
  const Shot asked = settle("quality = \"final\"\n[output]\nlayers = [\"albedo\"]\n");
  EXPECT_TRUE(writes(asked, seen) && writes(asked, layers::albedo()));
  EXPECT_TRUE(writes(settle("quality = \"final\"\n[denoise]\nmethod = \"rmz13\"\n"), layers::albedo()));
  // What few samples leave is written fast, and nothing that is only the denoiser's is part of the result.
  EXPECT_EQ(draft.write.compression, Compression::kRle);
  EXPECT_EQ(draft.final_write.compression, Compression::kZip);
  EXPECT_EQ(final.write.compression, Compression::kZip);
  EXPECT_TRUE(std::find(draft.stage_layers.begin(), draft.stage_layers.end(), "albedo") != draft.stage_layers.end());
  EXPECT_FALSE(writes(draft, layers::color_variance()));
  // What is said stays: samples, stages, and how they work. The scene's own samples are not said.
  EXPECT_EQ(settle("quality = \"final\"\n[sampling]\nspp = 5\n").settings.spp, 5);
  EXPECT_TRUE(settle("quality = \"final\"\nstages = []\n").stages.empty());
  EXPECT_EQ(
      settle("quality = \"draft\"\n[denoise]\nmethod = \"nl_means\"\n").stages[0].choice.params.get_string("method"),
      "nl_means");
  Scene s = scene();
  s.defaults.spp = 333;
  EXPECT_EQ(settle("quality = \"draft\"\n", s).settings.spp, 8);
  // Differences are solved for first.
  const Shot gradients = settle("quality = \"final\"\n[integrator]\nname = \"gradient_path\"\n");
  EXPECT_EQ(stages_of(gradients), (std::vector<std::string>{"reconstruct", "denoise"}));
  EXPECT_TRUE(writes(gradients, layers::albedo()));
  EXPECT_EQ(error_of("quality = \"best\"\n").code(), ErrorCode::kUnknownName);
  EXPECT_TRUE(settle("").stages.empty());
}

TEST(Shot, BuiltInDefaults) {
  const Shot shot = settle("");
  EXPECT_EQ(shot.settings.width, 1280);
  EXPECT_EQ(shot.settings.height, 720);
  EXPECT_EQ(shot.settings.spp, 64);
  EXPECT_EQ(shot.settings.clock.fps, 24);
  EXPECT_EQ(shot.settings.clock.shutter.close, 0.5);
  EXPECT_EQ(shot.frames, std::vector<int>{0});
  EXPECT_EQ(shot.integrator, "path");
  EXPECT_EQ(shot.settings.layers, std::vector<std::string>{"color"});
}

TEST(Shot, SceneFileThenShotThenCommandLine) {
  Scene s = scene();
  s.defaults.width = 100, s.defaults.height = 50;
  s.defaults.spp = 7;
  s.defaults.max_depth = 5;
  s.defaults.rr_depth = 9;
  s.defaults.filter = "gaussian";
  s.defaults.filter_radius = 1.25;
  const Shot from_scene = settle("", s);
  EXPECT_EQ(from_scene.settings.width, 100);
  EXPECT_EQ(from_scene.settings.spp, 7);
  EXPECT_EQ(from_scene.params.get_int("max_depth"), 5);
  EXPECT_EQ(from_scene.settings.filter.kind(), FilterKind::kGaussian);
  EXPECT_EQ(from_scene.settings.filter.radius(), 1.25f);

  ShotConfig c;
  c.read_text("scene=\"scene.xml\"\n[sampling]\nspp=8\n[film]\nfilter=\"tent\"\n[integrator]\nmax_depth=6\n",
              "shot.toml", ".");
  const Shot from_shot = settle_shot(c, s);
  EXPECT_EQ(from_shot.settings.spp, 8);
  EXPECT_EQ(from_shot.settings.width, 100);
  EXPECT_EQ(from_shot.params.get_int("max_depth"), 6);
  EXPECT_EQ(from_shot.params.get_int("rr_depth"), 9);
  EXPECT_EQ(from_shot.settings.filter.radius(), 1.0f) << "the tent's own, not the scene's";

  c.set_text("sampling.spp", "9");
  c.set_text("integrator.max_depth", "3");
  const Shot from_line = settle_shot(c, s);
  EXPECT_EQ(from_line.settings.spp, 9);
  EXPECT_EQ(from_line.params.get_int("max_depth"), 3);
}

TEST(Shot, AnotherIntegratorLeavesOutWhatItDoesNotHave) {
  const std::string file = "scene=\"scene.xml\"\n[integrator]\nname=\"path\"\nclamp=5.0\nmax_depth=6\n";
  Scene s = scene();
  ShotConfig c;
  c.read_text(file, "shot.toml", ".");
  c.set_text("integrator.name", "gradient_path");
  std::string log;
  set_log_writer([&](std::string_view line) { log += line; });
  const Shot shot = settle_shot(c, s);
  set_log_writer({});
  EXPECT_EQ(shot.params.get_int("max_depth"), 6);
  EXPECT_NE(log.find("\"gradient_path\" has no parameter clamp"), std::string::npos) << log;
  // In the file itself, and on the command line, it is an error.
  EXPECT_EQ(error_of("[integrator]\nname=\"gradient_path\"\nclamp=5.0\n").code(), ErrorCode::kUnknownName);
  c.set_text("integrator.clamp", "5");
  EXPECT_THROW(settle_shot(c, s), Error);
}

TEST(Shot, TheSequenceIsWhatTheFileSaysAndFramesAPartOfIt) {
  ShotConfig c;
  c.read_text("scene=\"scene.xml\"\nframes=\"1001-1240\"\n", "shot.toml", ".");
  Scene s = scene();
  EXPECT_EQ(settle_shot(c, s).sequence, (FrameRange{1001, 1240}));
  EXPECT_FALSE(settle_shot(c, s).is_part);
  c.set_text("frames", "1051-1100");
  const Shot part = settle_shot(c, s);
  EXPECT_EQ(part.sequence, (FrameRange{1001, 1240}));
  EXPECT_EQ(part.frames.size(), 50u);
  EXPECT_TRUE(part.is_part);

  ShotConfig unsaid;
  unsaid.set_text("scene", "scene.xml");
  unsaid.set_text("frames", "7-9");
  EXPECT_EQ(settle_shot(unsaid, s).sequence, (FrameRange{7, 9})) << "the scene does not move";
  EXPECT_FALSE(settle_shot(unsaid, s).is_part);
  s.animation = {0, 1};
  EXPECT_EQ(settle_shot(unsaid, s).sequence, (FrameRange{0, 24}));
  EXPECT_TRUE(settle_shot(unsaid, s).is_part);
  s.animation = {0, 1e9};
  EXPECT_EQ(settle_shot(unsaid, s).sequence, (FrameRange{7, 9})) << "too long to mean it";
}

TEST(Shot, FramesFollowTheAnimation) {
  Scene s = scene();
  s.animation = {1.0 / 24, 1.0};  // as Blender writes it: no key at 0
  EXPECT_EQ(settle("", s).frames.front(), 1);
  EXPECT_EQ(settle("", s).frames.back(), 24);
  EXPECT_EQ(settle("fps = 12\n", s).frames.size(), 12u);
  EXPECT_EQ(settle("first_frame = 1001\nstart = 0.5\n", s).frames.front(), 990);
  EXPECT_EQ(settle("frames = \"3,1-2\"\n", s).frames, (std::vector<int>{3, 1, 2}));
  s.defaults.exposure = TimeSpan{0.25, 0.5};
  const Shot still = settle("", s);
  EXPECT_EQ(still.frames, std::vector<int>{0}) << "absolute shutter times mean one picture";
  EXPECT_EQ(still.settings.clock.exposure(0), (TimeSpan{0.25, 0.5}));
}

TEST(Shot, CropAndScale) {
  const Shot shot = settle("[film]\nresolution = [400, 200]\ncrop = [100, 50, 40, 20]\nscale = 50\n");
  EXPECT_EQ(shot.settings.width, 200);
  EXPECT_EQ(shot.settings.height, 100);
  EXPECT_EQ(shot.settings.x0(), 50);
  EXPECT_EQ(shot.settings.y1(), 35);
}

TEST(Shot, ScaleCutsFractionsOffAsBlenderDoes) {
  const auto size = [](int w, int h, const char* percent) {
    const Shot s = settle(fmt::format("[film]\nresolution = [{}, {}]\nscale = {}\n", w, h, percent));
    return std::pair(s.settings.width, s.settings.height);
  };
  EXPECT_EQ(size(1920, 1080, "33"), std::pair(633, 356));  // 633.6 x 356.4
  EXPECT_EQ(size(1280, 720, "12.5"), std::pair(160, 90));
  EXPECT_EQ(size(1000, 999, "33.3"), std::pair(333, 332));  // 332.667
  for (int percent = 1; percent <= 200; ++percent) {
    EXPECT_EQ(size(1921, 1079, std::to_string(percent).c_str()),
              std::pair(std::max(1, 1921 * percent / 100), std::max(1, 1079 * percent / 100)));
  }
  EXPECT_EQ(size(3, 3, "1"), std::pair(1, 1));
  // Windows that share an edge still do, and cover the whole picture.
  const auto window = [](int x, int width) {
    return settle(fmt::format("[film]\nresolution = [101, 9]\ncrop = [{}, 0, {}, 9]\nscale = 33\n", x, width)).settings;
  };
  for (int cut = 10; cut < 90; ++cut) {
    EXPECT_EQ(window(0, cut).x1(), window(cut, 101 - cut).x0()) << cut;
    EXPECT_EQ(window(cut, 101 - cut).x1(), 33) << cut;
  }
}

TEST(Shot, SettingsThatAnIntegratorCannotDoWithAreNamed) {
  const auto line = [](const std::string& toml) {
    const Error e = error_of(toml);
    EXPECT_NE(e.message(), "nothing was thrown") << toml;
    return e.loc().line;
  };
  const std::string temporal = "[integrator]\nname = \"temporal_gradient_path\"\n[output]\nlayers = [\"albedo\"]\n";
  EXPECT_EQ(line(temporal + "[sampling]\nspp = 1\n"), 7);
  EXPECT_EQ(line(temporal + "[sampling]\nseed_per_frame = false\n"), 7);
  EXPECT_EQ(line(temporal + "[shutter]\nrolling = 0.5\n"), 7);
  EXPECT_EQ(line("[output]\nlayers = [\"grad.x\"]\n"), 3);
  Scene s = scene();
  s.defaults.spp = 1;  // the scene's own
  try {
    settle(temporal, s);
    ADD_FAILURE() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().line, 3) << e.what();
  }
}

TEST(Shot, CameraByNameOrIndex) {
  EXPECT_EQ(settle("camera = \"far\"\n").settings.camera, 1);
  EXPECT_EQ(settle("camera = \"1\"\n").settings.camera, 1);
  const Error e = error_of("camera = \"fra\"\n");
  EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
  EXPECT_EQ(e.loc().line, 2);
  EXPECT_NE(e.message().find("1 (far)"), std::string::npos) << e.what();
}

struct Bad {
  const char* toml;
  ErrorCode code;
  int line;
  const char* says;
};
class ShotErrors : public testing::TestWithParam<Bad> {};
TEST_P(ShotErrors, StandAtTheValue) {
  const Error e = error_of(GetParam().toml);
  EXPECT_EQ(e.code(), GetParam().code) << e.what();
  EXPECT_EQ(e.loc().line, GetParam().line) << e.what();
  EXPECT_NE(e.message().find(GetParam().says), std::string::npos) << e.what();
}
INSTANTIATE_TEST_SUITE_P(
    All, ShotErrors,
    testing::Values(
        Bad{"[film]\nresolution = [0, 5]\n", ErrorCode::kOutOfRange, 3, "65536"},
        Bad{"[film]\nresolution = \"1280by720\"\n", ErrorCode::kBadInput, 3, "1280x720"},
        Bad{"[film]\nresolution = [1, 2, 3]\n", ErrorCode::kBadInput, 3, "1280x720"},
        Bad{"[film]\nresolution = [10, 10]\ncrop = [8, 0, 4, 4]\n", ErrorCode::kOutOfRange, 4, "not inside"},
        Bad{"frames = \"5-1\"\n", ErrorCode::kBadInput, 2, "backwards"},
        Bad{"[shutter]\nopen = 1\nclose = 0\n", ErrorCode::kOutOfRange, 4, "before it opens"},
        Bad{"[shutter]\nshape = \"curve\"\n", ErrorCode::kOutOfRange, 3, "two numbers"},
        Bad{"[shutter]\nramp_in = 0.7\nramp_out = 0.7\n", ErrorCode::kOutOfRange, 4, "more than 1"},
        Bad{"[integrator]\nname = \"pathh\"\n", ErrorCode::kUnknownName, 3, "path"},
        Bad{"[integrator]\nmax_dept = 3\n", ErrorCode::kUnknownName, 3, "max_depth"},
        Bad{"[integrator]\nmax_depth = 2.5\n", ErrorCode::kBadInput, 3, "integer"},
        Bad{"[output]\nlayers = [\"albdo\"]\n", ErrorCode::kUnknownName, 3, "albedo"},
        Bad{"[output]\nlayers = [\"grad.x\"]\n", ErrorCode::kUnknownName, 3, "cannot write"},
        Bad{"[classes]\ndd = \"ED(\"\n", ErrorCode::kSyntax, 3, ""},
        Bad{"[classes]\nresidual = \"ED\"\n", ErrorCode::kBadInput, 3, "residual"},
        Bad{"[classes]\na = \"ED\"\n[decompose]\nb = \"ER\"\n", ErrorCode::kBadInput, 5, "together"},
        Bad{"[decompose]\na = \"ED.*\"\nb = \"E[DR]\"\n", ErrorCode::kBadInput, 4, "\"a\" and \"b\" overlap"},
        Bad{"[environment]\nradiance = \"blue\"\n", ErrorCode::kBadInput, 3, "three"},
        Bad{"[environment]\nimage = \"none.hdr\"\n", ErrorCode::kMissingFile, 3, "none.hdr"},
        Bad{"[materials.Pait]\ntype = \"diffuse\"\n", ErrorCode::kUnknownName, 3, "it has: Paint"},
        Bad{"[materials.Paint]\nreflectance = 1\n", ErrorCode::kBadInput, 3, "needs a type"},
        Bad{"[materials.Paint]\ntype = \"diffuse\"\nreflectance = -0.3\n", ErrorCode::kOutOfRange, 4, "below 0"},
        Bad{"[materials.Paint]\nemission = [1, -1, 1]\n", ErrorCode::kOutOfRange, 3, "below 0"},
        Bad{"solid_tint = \"never\"\n", ErrorCode::kUnknownName, 2, "twice"},
        Bad{"[materials.Paint]\ntype = \"difuse\"\n", ErrorCode::kUnknownName, 3, "diffuse"},
        Bad{"[materials.Paint]\ntype = \"diffuse\"\nior = 2\n", ErrorCode::kUnknownName, 4, "reflectance"},
        Bad{"[materials.Paint]\ntype = \"diffuse\"\nreflectance = \"red\"\n", ErrorCode::kBadInput, 4,
            "neither a color"},
        Bad{"[reconstruct]\nwindow = 8\noverlap = 8\n", ErrorCode::kOutOfRange, 4, "more than 8"},
        Bad{"[reconstruct]\nwindow = 1.5\n", ErrorCode::kBadInput, 3, "integer"}));

TEST(Shot, ReplacesEnvironmentAndMaterials) {
  Scene s = scene();
  settle(
      "[environment]\nradiance = [1, 2, 3]\nrotation = 90\n"
      "[materials.Paint]\ntype = \"diffuse\"\nreflectance = \"#ff0000\"\nemission = 2.5\nopacity = 0.25\n",
      s);
  ASSERT_EQ(s.environments.size(), 1u);
  EXPECT_EQ(s.environments[0].radiance.at(0), (Rgb{1, 2, 3}));
  const Vec3d turned = s.world(s.environments[0].node, 0).vector({0, 0, 1});
  EXPECT_NEAR(turned.x, 1, 1e-12) << "counterclockwise from above: z turns to x";
  ASSERT_TRUE(s.shapes[0].emission);
  EXPECT_EQ(s.shapes[0].emission->radiance.mean(), Rgb(2.5f));
  EXPECT_EQ(s.shapes[0].material->opacity({}), 0.25f);
  Scene kept = scene();
  settle("[environment]\nradiance = 1\nkeep = true\n", kept);
  EXPECT_EQ(kept.environments.size(), 2u);
}

TEST(Shot, BendsNormalsAsTheSceneSaysUnlessTold) {
  for (const bool format : {false, true}) {
    Scene s = scene();
    s.bend_normals = format;
    const Shot plain = settle("", s);
    EXPECT_EQ(s.bend_normals, format);
    for (const bool told : {false, true}) {
      const Shot shot = settle(told ? "bend_normals = true\n" : "bend_normals = false\n", s);
      EXPECT_EQ(s.bend_normals, told);
      EXPECT_NE(fingerprint(shot, s, 0), fingerprint(plain, s, 0));
    }
  }
  EXPECT_NE(fingerprint(settle("solid_tint = \"once\"\n"), scene(), 0), fingerprint(settle(""), scene(), 0));
}

TEST(Shot, TwoSidedDecidesWhichSidesShine) {
  const auto shines_both_ways = [](bool in_scene, const std::string& toml) {
    Scene s = scene();
    s.shapes[0].emission = AreaEmission{Slot(2.0f), in_scene};
    settle("[materials.Paint]\n" + toml, s);
    return s.shapes[0].emission->two_sided;
  };
  for (const char* type : {"", "type = \"diffuse\"\n", "type = \"metallic_roughness\"\n"})
    for (const char* emission : {"", "emission = 3\n"})
      for (const bool in_scene : {false, true}) {
        const std::string toml = std::string(type) + emission;
        if (!toml.empty()) {
          EXPECT_EQ(shines_both_ways(in_scene, toml), in_scene) << toml;
        }
        EXPECT_FALSE(shines_both_ways(in_scene, toml + "two_sided = false\n")) << toml;
        EXPECT_TRUE(shines_both_ways(in_scene, toml + "two_sided = true\n")) << toml;
      }
}

TEST(Shot, TwoSidedDecidesWhatTheBackLooksLike) {
  const auto black_from_behind = [](const std::string& toml) {
    Scene s = scene();
    settle("[materials.Paint]\n" + toml, s);
    ShadingPoint p;
    p.ng = {0, 0, 1};
    p.wo = {0, 0, -1};
    Bsdf bsdf;
    s.shapes[0].material->add_lobes(p, 1, bsdf);
    return bsdf.empty();
  };
  EXPECT_TRUE(black_from_behind("two_sided = false\n")) << "the scene's own diffuse is";
  EXPECT_FALSE(black_from_behind("two_sided = true\n"));
  EXPECT_TRUE(black_from_behind("type = \"diffuse\"\n"));
  EXPECT_FALSE(black_from_behind("type = \"diffuse\"\ntwo_sided = true\n"));
  EXPECT_FALSE(black_from_behind("type = \"metallic_roughness\"\n"));
  EXPECT_FALSE(black_from_behind("type = \"metallic_roughness\"\ntwo_sided = true\n"));
  EXPECT_TRUE(black_from_behind("type = \"metallic_roughness\"\ntwo_sided = false\n"));
  EXPECT_FALSE(black_from_behind("type = \"metallic_roughness\"\ntwo_sided = false\ntransmission = 1\n"));
}

TEST(Shot, FingerprintChangesWithWhatChangesPixelsOnly) {
  Scene s = scene();
  const Shot base = settle("", s);
  const std::string print = fingerprint(base, s, 1);
  EXPECT_EQ(print.size(), 32u);
  EXPECT_NE(fingerprint(base, s, 2), print);
  EXPECT_NE(fingerprint(settle("[sampling]\nspp = 65\n", s), s, 1), print);
  EXPECT_NE(fingerprint(settle("[integrator]\nmax_depth = 3\n", s), s, 1), print);
  EXPECT_NE(fingerprint(settle("[output]\nhalf = true\n", s), s, 1), print);
  EXPECT_NE(fingerprint(settle("motion_segments = 8\n", s), s, 1), print);
  Scene lit = scene();
  EXPECT_NE(fingerprint(settle("[environment]\nradiance = 2\n", lit), lit, 1), print);
  Scene changed = scene();
  changed.content_hash = 43;
  EXPECT_NE(fingerprint(settle("", changed), changed, 1), print);
  EXPECT_EQ(fingerprint(settle("frames = \"1-9\"\n[output]\npath = \"a.exr\"\n[video]\npath = \"b.mp4\"\n", s), s, 1),
            print);
}

TEST(Shot, SandboxHoldsForTheFileOnly) {
  ShotConfig c;
  c.read_text("scene = \"../a.xml\"\n[environment]\nimage = \"sub/../b.hdr\"\n", "shot.toml", "folder");
  EXPECT_EQ(c.input_path("scene"), std::filesystem::path("folder/../a.xml"));
  c.set_sandbox(true);
  EXPECT_NO_THROW(c.input_path("environment.image"));
  try {
    c.input_path("scene");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kBadInput);
    EXPECT_EQ(e.loc().line, 1);
  }
  c.set_text("scene", "../a.xml");
  EXPECT_NO_THROW(c.input_path("scene")) << "what the user types is the user's will";
}

TEST(Materials, EveryTypeHasWorkingDefaults) {
  for (const MaterialEntry* e : material_catalog()) {
    Scene s = scene();
    override_material(s, "Paint", {{"type", e->name}}, {{"type", {}}}, {});
    ASSERT_TRUE(s.shapes[0].material) << e->name;
    ShadingPoint p;
    p.wo = {0, 0, 1};
    Bsdf bsdf;
    s.shapes[0].material->add_lobes(p, 1, bsdf);
    EXPECT_FALSE(bsdf.empty()) << e->name;
  }
}

TEST(Materials, ReadsColors) {
  EXPECT_EQ(parse_color("0.5"), Rgb(0.5f));
  EXPECT_EQ(parse_color(" 1, 2 ,3 "), (Rgb{1, 2, 3}));
  EXPECT_EQ(parse_color("#ffffff"), Rgb(1.0f));
  EXPECT_NEAR(parse_color("#808080")->g, 0.2158605f, 1e-6f) << "sRGB";
  for (const char* bad : {"", "a", "1,2", "1,2,3,4", "#fff", "#12345g", "1,,2", "nan", "1;2;3"})
    EXPECT_FALSE(parse_color(bad)) << bad;
}

TEST(Shot, NamesOfFilesMayComeFromOtherSystems) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "tempera_shot_names";
  std::filesystem::create_directories(folder / "models");
  std::ofstream(folder / "models" / "a.xml") << "<scene version=\"3.0.0\"/>";
  Warnings warnings;
  ShotConfig windows;
  windows.read_text("scene = 'models\\a.xml'\n", "shot.toml", folder);
  EXPECT_EQ(windows.input_path("scene"), folder / "models" / "a.xml");
  EXPECT_NO_THROW(import_shot_scene(windows, {}, warnings));
  ShotConfig other_case;
  other_case.read_text("scene = 'models/A.xml'\n", "shot.toml", folder);
  try {
    import_shot_scene(other_case, {}, warnings);
    FAIL() << "found a file of another name";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kMissingFile);
    EXPECT_NE(std::string(e.what()).find("did you mean"), std::string::npos) << e.what();
    EXPECT_EQ(e.loc().line, 1);
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace tempera
