// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/scene_edits.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "tempera/core/log.h"
#include "tempera/pipeline/shot.h"
#include "tempera/scene/deform.h"

namespace tempera {
namespace {

/// Two cameras, a quad at a node, a lamp of every kind, and two copies of an emitting quad.
Scene scene() {
  Scene s;
  s.source = "scene.xml";
  s.nodes.push_back({-1, translate(Vec3d{0, 0, 4}), "Hero", 1.0f});
  s.nodes.push_back({-1, translate(Vec3d{0, 3, 0}), "Lamp object", 1.0f});
  s.nodes.push_back({1, Affine3d{{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}}, "", 1.0f});
  s.shapes.push_back({make_rectangle(), make_diffuse(), std::nullopt, "quad", "Paint"});
  s.shapes.push_back({make_rectangle(), make_black(), AreaEmission{Slot(Rgb{1, 2, 3}), true}, "tube", "Glow"});
  s.groups = {{0}, {1}};
  s.instances = {{0, 0, "Hero", true}, {1, -1, "Left", true}, {1, -1, "Right", true}};
  s.cameras.resize(2);
  s.cameras[0].name = "near";
  s.cameras[1].name = "far";
  s.cameras[1].keep_vertical_fov = true;
  for (const LightType type : {LightType::kPoint, LightType::kSpot, LightType::kDirectional}) {
    PunctualLight light;
    light.type = type;
    light.node = 2;
    light.intensity = Rgb{1, 0.5f, 0.25f};
    light.intensity_scale = 8.0f;
    light.name = type == LightType::kPoint ? "Bulb" : type == LightType::kSpot ? "Spot" : "Sun";
    s.lights.push_back(light);
  }
  s.lights[0].node = s.lights[2].node = 0;
  return s;
}

Shot settle(const std::string& toml, Scene& s, const std::filesystem::path& folder = ".") {
  ShotConfig c;
  c.read_text("scene = \"scene.xml\"\n" + toml, "shot.toml", folder);
  Shot shot = settle_shot(c, s);
  validate(s);
  return shot;
}
Scene settled(const std::string& toml, const std::filesystem::path& folder = ".") {
  Scene s = scene();
  settle(toml, s, folder);
  return s;
}

struct Bad {
  const char* toml;
  ErrorCode code;
  int line;
  const char* says;
};
void PrintTo(const Bad& b, std::ostream* out) { *out << b.toml; }
class SceneEditErrors : public testing::TestWithParam<Bad> {};
TEST_P(SceneEditErrors, StandAtTheValue) {
  try {
    settled(GetParam().toml);
    FAIL() << "nothing was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), GetParam().code) << e.what();
    EXPECT_EQ(e.loc().line, GetParam().line) << e.what();
    EXPECT_NE(e.message().find(GetParam().says), std::string::npos) << e.what();
  }
}
INSTANTIATE_TEST_SUITE_P(
    All, SceneEditErrors,
    testing::Values(Bad{"[camera]\nf_stop = 2.8\n", ErrorCode::kBadInput, 3, "focus_distance"},
                    Bad{"[camera]\nf_stop = 0\nfocus_distance = 1\n", ErrorCode::kOutOfRange, 3, "f_stop"},
                    Bad{"[camera]\nf_stop = 2\naperture_radius = 1\n", ErrorCode::kBadInput, 4, "exclude"},
                    Bad{"[camera]\nfov = 40\nfocal_length = 35\n", ErrorCode::kBadInput, 4, "exclude"},
                    Bad{"[camera]\nfov = [[1, 40], [1, 50]]\n", ErrorCode::kBadInput, 3, "increase"},
                    Bad{"[camera]\nfov = [40, 50]\n", ErrorCode::kBadInput, 3, "[[frame, value], ...]"},
                    Bad{"[camera]\nfov = [[1, 40, 2]]\n", ErrorCode::kBadInput, 3, "[[frame, value], ...]"},
                    Bad{"[camera]\nfov = [[[1], 40]]\n", ErrorCode::kBadInput, 3, "array"},
                    Bad{"[camera]\nfov = 180\n", ErrorCode::kOutOfRange, 3, "179.9"},
                    Bad{"[camera]\nfocus_object = \"Herro\"\nf_stop = 2\n", ErrorCode::kUnknownName, 3, "Hero"},
                    Bad{"[camera]\nfocus_object = \"Hero\"\nfocus_distance = 2\n", ErrorCode::kBadInput, 3, "exclude"},
                    Bad{"[camera]\npixel_aspect = 0\n", ErrorCode::kOutOfRange, 3, "0.001"},
                    Bad{"[camera]\nnear_clip = 5\nfar_clip = 2\n", ErrorCode::kOutOfRange, 3, "below"},
                    Bad{"[camera]\nfstop = 2\n", ErrorCode::kUnknownName, 3, "camera.f_stop"},
                    Bad{"[camera]\nname = \"fra\"\n", ErrorCode::kUnknownName, 3, "1 (far)"},
                    Bad{"[cameras.fra]\nfov = 2\n", ErrorCode::kUnknownName, 3, "far"},
                    Bad{"[lights.Blub]\nscale = 2\n", ErrorCode::kUnknownName, 3, "Bulb, Sun, Left, Spot"},
                    Bad{"[lights.Bulb]\nradios = 2\n", ErrorCode::kUnknownName, 3, "radius"},
                    Bad{"[lights.Bulb]\nradius = -1\n", ErrorCode::kOutOfRange, 3, "0"},
                    Bad{"[lights.Bulb]\nangle = 1\n", ErrorCode::kBadInput, 3, "\"Bulb\" is a point light"},
                    Bad{"[lights.Sun]\nradius = 1\n", ErrorCode::kBadInput, 3, "\"Sun\" is a directional light"},
                    Bad{"[lights.Sun]\nspread = 90\n", ErrorCode::kBadInput, 3, "does not apply"},
                    Bad{"[lights.Sun]\ncamera_visible = true\n", ErrorCode::kBadInput, 3, "angle"},
                    Bad{"[lights.Left]\nradius = 1\n", ErrorCode::kBadInput, 3, "emitting object"},
                    Bad{"[lights.Left]\nspread = 0.5\n", ErrorCode::kOutOfRange, 3, "180"},
                    Bad{"[lights.Spot]\nbeam = 40\nblend = 0.5\n", ErrorCode::kBadInput, 4, "exclude"},
                    Bad{"[lights.Spot]\ncone = 30\nbeam = 40\n", ErrorCode::kOutOfRange, 4, "30 degrees"},
                    Bad{"[lights.Bulb]\ncolor = \"red\"\n", ErrorCode::kBadInput, 3, "no color"},
                    Bad{"[lights.quad]\nscale = 2\n", ErrorCode::kUnknownName, 3, "Left"}));

// The values of Blender's own formulas (BKE_camera_params_compute_viewplane): with a shift the window moves by
// fractions of the larger side; the angle belongs to that side.
TEST(SceneEdits, CamerasAreBlenders) {
  const auto corner = [](const Scene& s, const Shot& shot, int camera = 0) {  // of the window at distance 1: left, top
    const CameraModel m(s, camera, shot.settings.width, shot.settings.height, {0, 0}, 1);
    const CameraRay a = m.ray({0, 0}, {}, 0),
                    b = m.ray({float(shot.settings.width), float(shot.settings.height)}, {}, 0);
    return std::array<double, 4>{-double(a.d.x / a.d.z), double(a.d.y / a.d.z), -double(b.d.x / b.d.z),
                                 double(b.d.y / b.d.z)};  // x to the right
  };
  struct Case {
    const char* film;
    double width, height, aspect, viewfac, ycor;
  };
  for (const Case& c : {Case{"[400, 200]", 400, 200, 1, 400, 1}, Case{"[200, 400]", 200, 400, 1, 400, 1},
                        Case{"[400, 300]", 400, 300, 0.5, 600, 2}, Case{"[300, 400]", 300, 400, 2, 300, 0.5}}) {
    Scene s = scene();
    const Shot shot =
        settle(fmt::format("[film]\nresolution = {}\n[camera]\nfocal_length = 50\nshift_x = 0.1\nshift_y = "
                           "-0.3\npixel_aspect = {}\nsensor_width = 32\n",
                           c.film, c.aspect),
               s);
    const double pixel = 32.0 / 50 / c.viewfac;
    const double dx = 0.1 * c.viewfac, dy = -0.3 * c.viewfac;
    const auto seen = corner(s, shot);
    EXPECT_NEAR(seen[0], (-c.width / 2 + dx) * pixel, 1e-5) << c.film;
    EXPECT_NEAR(seen[2], (c.width / 2 + dx) * pixel, 1e-5) << c.film;
    EXPECT_NEAR(seen[1], (c.ycor * c.height / 2 + dy) * pixel, 1e-5) << c.film;
    EXPECT_NEAR(seen[3], (-c.ycor * c.height / 2 + dy) * pixel, 1e-5) << c.film;
  }
  // The angle of the side that sensor_fit names, for a camera of its own name that does not render.
  Scene s = scene();
  const Shot shot = settle(
      "[film]\nresolution = [400, 200]\n[camera]\nname = \"near\"\n[cameras.far]\nfov = 90\nsensor_fit = "
      "\"vertical\"\n",
      s);
  EXPECT_EQ(shot.settings.camera, 0);
  EXPECT_NEAR(corner(s, shot, 1)[1], 1, 1e-5);
  EXPECT_NEAR(corner(s, shot, 1)[2], 2, 1e-5);
}

TEST(SceneEdits, LensesChangeOverTime) {
  Scene s = scene();
  const Shot shot = settle(
      "fps = 10\nfirst_frame = 1\nstart = 2\n[camera]\nf_stop = [[1, 2], [11, 8]]\nfocus_object = \"Hero\"\n"
      "focal_length = [[1, 36], [11, 72]]\nnear_clip = 0.5\nfar_clip = 50\n",
      s);
  const Camera& c = s.cameras[0];
  EXPECT_EQ(c.focus_node, 0);
  EXPECT_NEAR(c.f_stop.at(2.5), 5, 1e-6) << "half way, at frame 6";
  EXPECT_NEAR(c.f_stop.at(0), 2, 0);
  EXPECT_NEAR(c.fov_x.at(2.5), 2 * std::atan(36.0 / 2 / 54), 1e-3);
  EXPECT_EQ(c.near_clip, 0.5f);
  EXPECT_EQ(c.far_clip, 50);
  // Text of the command line means the same, and all of it is in the fingerprint.
  ShotConfig config;
  config.set_text("scene", "scene.xml");
  for (const char* set : {"fps=10", "first_frame=1", "start=2", "camera.f_stop=1:2,11:8", "camera.focus_object=Hero",
                          "camera.focal_length=1:36,11:72", "camera.near_clip=0.5", "camera.far_clip=50"})
    config.assign(set, ShotConfig::kCommandLine());
  Scene same = scene();
  EXPECT_EQ(settle_shot(config, same).edits, shot.edits);
  EXPECT_NE(settle("[camera]\nshift_x = 0.1\n", same).edits, settle("[camera]\nshift_x = 0.2\n", same).edits);
  // A lens of the scene's own can be closed.
  Scene thin = scene();
  thin.cameras[0].aperture_radius = 0.2f;
  settle("[camera]\nf_stop = 4\n", thin);
  EXPECT_EQ(thin.cameras[0].f_stop.at(0), 4);
  settle("[camera]\naperture_radius = 0\n", thin);
  EXPECT_EQ(thin.cameras[0].aperture_radius.at(0), 0);
  EXPECT_EQ(thin.cameras[0].f_stop.at(0), 0);
}

TEST(SceneEdits, LightsGetSizes) {
  const Scene s = settled(
      "[lights.Bulb]\nradius = 0.5\ncolor = \"#ffffff\"\nscale = 2\n"
      "[lights.Spot]\nradius = 0.25\ncamera_visible = true\ncone = 60\nblend = 0.25\nintensity = [[0, 1], [24, 3]]\n"
      "[lights.Sun]\nangle = 0.53\nintensity = 3\n");
  ASSERT_EQ(s.lights.size(), 1u);
  EXPECT_NEAR(s.lights[0].angle, 0.53 * kPiD / 180, 1e-7);
  EXPECT_EQ(s.lights[0].intensity_scale.at(0), 3);
  EXPECT_EQ(s.lights[0].intensity.at(0), (Rgb{1, 0.5f, 0.25f}));
  ASSERT_EQ(s.instances.size(), 5u);
  const Instance &spot = s.instances[3], &bulb = s.instances[4];
  EXPECT_EQ(spot.name, "Spot");
  EXPECT_TRUE(spot.camera_visible);
  EXPECT_FALSE(bulb.camera_visible);
  const AreaEmission& bulb_light = *s.shapes[s.groups[bulb.group][0]].emission;
  EXPECT_NEAR(bulb_light.radiance.mean().r, 16 / (kPiD * 0.25), 1e-4);
  EXPECT_NEAR(bulb_light.radiance.mean().b, 16 / (kPiD * 0.25), 1e-4) << "white now";
  const AreaEmission& spot_light = *s.shapes[s.groups[spot.group][0]].emission;
  EXPECT_NEAR(spot_light.radiance.mean(0.5).r, 2 / (kPiD * 0.0625), 1e-4) << "half way between its keys";
  ASSERT_TRUE(spot_light.spot);
  EXPECT_EQ(spot_light.spot->falloff, SpotFalloff::kSmoothstep);
  EXPECT_NEAR(spot_light.spot->cutoff_angle.at(0), kPiD / 6, 1e-6);
  const double outer = std::cos(kPiD / 6);
  EXPECT_NEAR(std::cos(spot_light.spot->beam_width.at(0)), outer + (1 - outer) * 0.25, 1e-6);
  EXPECT_NEAR(s.world(spot.node, 0).translation.y, 3, 1e-6);
}

TEST(SceneEdits, ObjectsThatEmitAreLights) {
  // By the object: the other copy stays as it is. By the mesh: all of them.
  const Scene s = settled("[lights.Left]\ntwo_sided = false\nspread = 60\nscale = 3\ncamera_visible = false\n");
  const auto& left = *s.shapes[s.groups[s.instances[1].group][0]].emission;
  const auto& right = *s.shapes[s.groups[s.instances[2].group][0]].emission;
  EXPECT_FALSE(left.two_sided);
  EXPECT_NEAR(left.half_spread, kPiD / 6, 1e-6);
  EXPECT_EQ(left.radiance.mean(), (Rgb{3, 6, 9}));
  EXPECT_FALSE(s.instances[1].camera_visible);
  EXPECT_TRUE(right.two_sided);
  EXPECT_EQ(right.half_spread, kPi / 2);
  EXPECT_EQ(right.radiance.mean(), (Rgb{1, 2, 3}));
  EXPECT_TRUE(s.instances[2].camera_visible);
  const Scene both = settled("[lights.tube]\nintensity = 2\ncolor = [1, 1, 0]\n");
  for (const int i : {1, 2}) {
    const Instance& instance = both.instances[i];
    EXPECT_EQ(both.shapes[both.groups[instance.group][0]].emission->radiance.mean(), (Rgb{2, 2, 0}));
  }
  // A light by the name of the object that holds it.
  const Scene held = settled("[lights.\"Lamp object\"]\nscale = 2\n");
  EXPECT_EQ(held.lights[1].intensity.at(0), (Rgb{2, 1, 0.5f}));
  EXPECT_EQ(held.lights[0].intensity.at(0), (Rgb{1, 0.5f, 0.25f}));
}

class Caches : public testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directories(folder_); }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  void write(const std::string& name, const std::vector<float>& values) const {
    std::ofstream(folder_ / name, std::ios::binary)
        .write(reinterpret_cast<const char*>(values.data()), std::streamsize(values.size() * sizeof(float)));
  }
  /// Raw samples of the rectangle, moved by i along x.
  void write_rectangle(const std::string& name, int samples) const {
    std::vector<float> values;
    for (int i = 0; i < samples; ++i) {
      for (const Vec3f& p : make_rectangle().positions) values.insert(values.end(), {p.x + float(i), p.y, p.z});
    }
    write(name, values);
  }
  Error error(const std::string& toml) const {
    try {
      settled(toml, folder_);
    } catch (const Error& e) {
      return e;
    }
    return Error(ErrorCode::kFailed, "nothing was thrown");
  }
  std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("tempera_edits_" + std::to_string(getpid()));
};

TEST_F(Caches, SamplesStandAtFramesOfTheShot) {
  write_rectangle("move.raw", 4);
  const auto x = [&](const std::string& toml, double t) {
    const Scene s = settled(toml, folder_);
    const Mesh& mesh = std::get<Mesh>(s.shapes[0].geometry);
    return double(posed_position(mesh, mesh_pose(s, mesh, -1, t), 1).x - mesh.positions[1].x);
  };
  const std::string clock = "fps = 10\nfirst_frame = 101\nstart = 3\n", cache = "[caches.Hero]\nfile = \"move.raw\"\n";
  EXPECT_NEAR(x(cache + "start = 10\n", 10.5 / 24), 0.5, 1e-6);
  EXPECT_NEAR(x(clock + cache + "start = 101\n", 3.05), 0.5, 1e-6);
  EXPECT_NEAR(x(clock + cache + "start = 101\nstep = 0.5\n", 3.05), 1, 1e-6);
  EXPECT_NEAR(x(clock + cache + "frames = [101, 102, 106, 107]\n", 3.3), 1.5, 1e-6);
  EXPECT_NEAR(x(clock + cache + "start = 101\n", -50), 0, 1e-6);
  EXPECT_NEAR(x(clock + cache + "start = 101\n", 50), 3, 1e-6);
  // By the mesh's own name; the sequence covers the samples.
  Scene s = scene();
  const Shot shot = settle("[caches.quad]\nfile = \"move.raw\"\nstart = 5\n", s, folder_);
  EXPECT_EQ(shot.sequence, (FrameRange{5, 8}));
}

TEST_F(Caches, ContentAndTimesAreInTheFingerprint) {
  write_rectangle("move.raw", 3);
  const auto edits = [&](const std::string& more) {
    Scene s = scene();
    return settle("[caches.Hero]\nfile = \"move.raw\"\n" + more, s, folder_).edits;
  };
  const std::string before = edits("");
  EXPECT_EQ(edits(""), before);
  EXPECT_NE(edits("step = 2\n"), before);
  EXPECT_NE(edits("up = \"z\"\n"), before);
  std::vector<float> values(36, 0.0f);
  write("move.raw", values);
  const std::string zeros = edits("");
  values[35] = 1e-30f;
  write("move.raw", values);
  EXPECT_NE(edits(""), zeros);
  EXPECT_NE(zeros, before);
}

TEST_F(Caches, MeshesThatWereSplitNeedTheirIndices) {
  write("three.raw", {1, 0, 0, 2, 0, 0, 3, 0, 0});
  const std::string toml = "[caches.Hero]\nfile = \"three.raw\"\nvertices = 3\n";
  const Error e = error(toml);
  EXPECT_EQ(e.code(), ErrorCode::kBadInput);
  EXPECT_EQ(e.loc().line, 3);
  EXPECT_NE(e.message().find("has 3 vertices, but the mesh \"Hero\" has 4"), std::string::npos) << e.what();
  Scene s = scene();
  std::get<Mesh>(s.shapes[0].geometry).source_vertices = {2, 0, 0, 1};
  settle(toml, s, folder_);
  const Mesh& mesh = std::get<Mesh>(s.shapes[0].geometry);
  const MeshPose pose = mesh_pose(s, mesh, -1, 0);
  EXPECT_EQ(posed_position(mesh, pose, 0).x, 3);
  EXPECT_EQ(posed_position(mesh, pose, 3).x, 2);
  Scene beyond = scene();
  std::get<Mesh>(beyond.shapes[0].geometry).source_vertices = {3, 0, 0, 1};
  EXPECT_THROW(settle(toml, beyond, folder_), Error);
  // Two primitives without indices share a cache of their vertices one after the other.
  Scene two = scene();
  two.shapes.push_back(two.shapes[0]);
  two.groups[0] = {0, 3 - 1};
  two.shapes[0].name = "quad[0]", two.shapes[2].name = "quad[1]";
  std::vector<float> eight(24);
  for (std::size_t i = 0; i < 8; ++i) eight[3 * i] = float(i);
  write("eight.raw", eight);
  settle("[caches.quad]\nfile = \"eight.raw\"\n", two, folder_);
  const Mesh& second = std::get<Mesh>(two.shapes[2].geometry);
  EXPECT_EQ(posed_position(second, mesh_pose(two, second, -1, 0), 1).x, 5);
}

TEST_F(Caches, MistakesAreErrorsAtTheValue) {
  write_rectangle("move.raw", 3);
  const auto expect = [&](const std::string& keys, int line, const std::string& says,
                          ErrorCode code = ErrorCode::kBadInput) {
    const Error e = error("[caches.Hero]\nfile = \"move.raw\"\n" + keys);
    EXPECT_EQ(e.code(), code) << e.what();
    EXPECT_EQ(e.loc().line, line) << e.what();
    EXPECT_NE(e.message().find(says), std::string::npos) << e.what();
  };
  expect("frames = [1, 2]\n", 4, "names 2 frames, but the file has 3 samples");
  expect("frames = [1, 3, 2]\n", 4, "do not increase");
  expect("frames = [1, 2, 3]\nstep = 2\n", 4, "exclude");
  expect("format = \"pc2\"\n", 3, "is not a PC2 file");
  expect("format = \"abc\"\n", 4, "mdd", ErrorCode::kUnknownName);
  expect("step = 0\n", 4, "out of range", ErrorCode::kOutOfRange);
  EXPECT_EQ(error("[caches.Hero]\nfile = \"none.pc2\"\n").code(), ErrorCode::kMissingFile);
  EXPECT_EQ(error("[caches.Hro]\nfile = \"move.raw\"\n").code(), ErrorCode::kUnknownName);
  EXPECT_NE(error("[caches.Hro]\nfile = \"move.raw\"\n").message().find("Hero"), std::string::npos);
  EXPECT_NE(error("[caches.Hero]\nstep = 2\n").message().find("missing"), std::string::npos);
}

// A cache with z up on a mesh with y up is told from its first sample.
TEST_F(Caches, TheOtherAxisIsSuggested) {
  std::vector<float> values;
  for (const Vec3f& p : make_rectangle().positions) values.insert(values.end(), {p.x, -p.z, p.y + 0.001f});
  write("blender.raw", values);
  std::string log;
  set_log_writer([&](std::string_view line) { log += line; });
  settled("[caches.Hero]\nfile = \"blender.raw\"\n", folder_);
  EXPECT_NE(log.find("up = \"z\""), std::string::npos) << log;
  log.clear();
  settled("[caches.Hero]\nfile = \"blender.raw\"\nup = \"z\"\n", folder_);
  set_log_writer({});
  EXPECT_EQ(log, "");
}

// Blender looks into a latitude-longitude picture at u = 1/2 - atan2(y, x) / 2 pi, v = asin(z) / pi + 1/2 of the
// direction that its mapping has turned: three angles give the same texel.
TEST(SceneEdits, EnvironmentsTurnAsInBlender) {
  for (const Vec3d angles : {Vec3d{0, 0, 0}, Vec3d{0, 0, 50}, Vec3d{30, 0, 0}, Vec3d{0, -70, 0}, Vec3d{20, 130, -40}}) {
    const Scene s = settled(fmt::format("[environment]\nrotation = [{}, {}, {}]\n", angles.x, angles.y, angles.z));
    const Affine3d world = s.world(s.environments[0].node, 0);
    for (int i = 0; i < 50; ++i) {
      const double z = -0.99 + 0.04 * i, r = std::sqrt(1 - z * z), phi = 2.4 * i;
      const Vec3d d{r * std::cos(phi), r * std::sin(phi), z};  // Blender's axes
      const double k = kPiD / 180;
      Vec3d m = d;  // x first
      m = {m.x, m.y * std::cos(angles.x * k) - m.z * std::sin(angles.x * k),
           m.y * std::sin(angles.x * k) + m.z * std::cos(angles.x * k)};
      m = {m.x * std::cos(angles.y * k) + m.z * std::sin(angles.y * k), m.y,
           -m.x * std::sin(angles.y * k) + m.z * std::cos(angles.y * k)};
      m = {m.x * std::cos(angles.z * k) - m.y * std::sin(angles.z * k),
           m.x * std::sin(angles.z * k) + m.y * std::cos(angles.z * k), m.z};
      const double u = 0.5 - std::atan2(m.y, m.x) / (2 * kPiD), v = 0.5 - std::asin(m.z) / kPiD;  // row 0 on top
      const Vec3d local = inverse(world).vector({d.x, d.z, -d.y});
      const double ours = std::atan2(local.x, -local.z) / (2 * kPiD);
      EXPECT_NEAR(std::remainder(ours - u, 1.0), 0, 1e-9) << angles.x << " " << angles.y << " " << angles.z;
      EXPECT_NEAR(std::acos(local.y) / kPiD, v, 1e-9);
    }
  }
  // One angle is as it was, and [0, 0, a] is 90 - a.
  const Scene one = settled("[environment]\nrotation = 60\n"),
              three = settled("[environment]\nrotation = [0, 0, 30]\n");
  const Vec3d p{1, 2, 3};
  EXPECT_LT(
      length(one.world(one.environments[0].node, 0).vector(p) - three.world(three.environments[0].node, 0).vector(p)),
      1e-12);
  EXPECT_THROW(settled("[environment]\nrotation = [1, 2]\n"), Error);
  EXPECT_THROW(settled("[environment]\nrotation = \"nan\"\n"), Error);
}

}  // namespace
}  // namespace tempera
