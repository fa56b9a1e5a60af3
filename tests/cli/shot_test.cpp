// SPDX-License-Identifier: Apache-2.0
// What shot.toml changes in a scene, seen in the pictures: lens, lights and vertex caches.
#include <fmt/format.h>

#include <cmath>

#include "program.h"

namespace tempera::test {
namespace {

/// A quad of 2 by 2 at z = 0 that an orthographic camera sees, 4 units wide, and a light in front of it.
constexpr const char* kScene = R"(<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="orthographic" id="camera"><transform name="to_world"><scale value="2"/>
  <lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
<shape type="rectangle" id="quad"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
<emitter type="point" id="bulb"><point name="position" x="0" y="0" z="2"/><rgb name="intensity" value="3"/></emitter>
</scene>)";

class CliShot : public CliTest {
 protected:
  Outcome render(const std::string& toml, const std::string& out, std::vector<std::string> more = {}) const {
    write("scene.xml", kScene);
    std::vector<std::string> arguments{"render", write("shot.toml", "scene = \"scene.xml\"\n" + toml), "-o", path(out)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  }
  /// Samples of the rectangle's vertices, moved by `speed` times i along x.
  void write_cache(const std::string& name, int samples, float speed) const {
    std::ofstream file(folder_ / name, std::ios::binary);
    const float corners[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
    for (int i = 0; i < samples; ++i) {
      for (const auto& c : corners) {
        const float p[3] = {c[0] + speed * float(i), c[1], 0};
        file.write(reinterpret_cast<const char*>(p), sizeof(p));
      }
    }
  }
};

// A cache moves the quad by half a unit a frame: 8 of 64 pixels. Positions, motion vectors and resume follow it.
TEST_F(CliShot, VertexCachesMoveWhatTheySay) {
  write_cache("move.raw", 4, 0.5f);
  const std::string toml =
      "[caches.quad]\nfile = \"move.raw\"\nstart = 1\n[film]\nresolution = [64, 64]\n[sampling]\nspp = 4\n"
      "[shutter]\nclose = 0\n";
  const std::vector<std::string> layers{"--layers", "motion,position"};
  const Outcome first = render(toml, "f.####.exr", layers);
  ASSERT_EQ(first.status, 0) << first.err;
  EXPECT_NE(first.err.find("frames 1-4"), std::string::npos) << first.err;
  for (int f = 1; f <= 4; ++f) {
    const Frame frame = read_frame(path(fmt::format("f.{:04}.exr", f)));
    const int left = 16 + 8 * (f - 1);  // pixel of the left edge
    for (const int x : {left - 1, left, std::min(left + 31, 63)}) {
      const bool on = x >= left;
      ASSERT_EQ(frame.layer("color").rgb(x, 32).r > 0, on) << f << " " << x;
      if (!on) continue;
      EXPECT_NEAR(frame.layer("position").rgb(x, 32).r, (x + 0.5) / 16 - 2, 0.04);
      EXPECT_NEAR(frame.layer("motion.forward").at(x, 32, 0), f < 4 ? 8 : 0, 1e-3) << "clamped after the last";
      EXPECT_NEAR(frame.layer("motion.backward").at(x, 32, 0), f > 1 ? -8 : 0, 1e-3);
      EXPECT_NEAR(frame.layer("motion.forward").at(x, 32, 1), 0, 1e-3);
    }
  }
  std::vector<std::string> resume = layers;
  resume.emplace_back("--resume");
  EXPECT_NE(render(toml, "f.####.exr", resume).err.find("0 frames rendered, 4 found finished"), std::string::npos);
  write_cache("move.raw", 4, 0.25f);
  const Outcome again = render(toml, "f.####.exr", resume);
  EXPECT_NE(again.err.find("4 frames rendered, 0 found finished"), std::string::npos) << again.err;
  // With an open shutter the moving edge is a ramp: half of the way at the middle of it.
  const Outcome open = render(
      "[caches.quad]\nfile = \"move.raw\"\nstart = 1\nstep = 0.5\n[film]\nresolution = [64, 64]\n"
      "[shutter]\nopen = 0\nclose = 1\n",
      "g.####.exr", {"--frames", "1", "--spp", "256"});
  ASSERT_EQ(open.status, 0) << open.err;
  const Image color = read_frame(path("g.0001.exr")).layer("color");
  // Half a unit, 8 pixels, in the frame: coverage falls from pixel 16 to 24 in eighths.
  for (int x = 16; x < 24; ++x) {
    const double px = (x + 0.5) / 16 - 2, whole = 0.5 / kPiD * 3 * 2 / std::pow(4 + px * px, 1.5);  // by the light
    EXPECT_NEAR(color.rgb(x, 32).r / whole, (x - 16 + 0.5) / 8, 0.03) << x;
  }

  fs::resize_file(folder_ / "move.raw", 4 * 4 * 12 - 5);
  const Outcome broken = render(toml, "h.####.exr");
  EXPECT_EQ(broken.status, 3);
  EXPECT_NE(broken.err.find("shot.toml:3:"), std::string::npos) << broken.err;
  EXPECT_EQ(render("[caches.quad]\nfile = \"gone.raw\"\n", "h.####.exr").status, 4);
}

TEST_F(CliShot, PixelAspectIsInTheFile) {
  ASSERT_EQ(render("[camera]\npixel_aspect = 1.5\n", "f.exr",
                   {"--resolution", "24x16", "--spp", "4", "--frames", "0", "--layers", "position"})
                .status,
            0);
  EXPECT_EQ(std::get<double>(read_metadata(path("f.0000.exr")).at(kPixelAspectKey)), 1.5);
  // The picture is 4 wide; 16 lines of pixels that are as high as two thirds of their width.
  const Frame frame = read_frame(path("f.0000.exr"));
  EXPECT_NEAR(frame.layer("position").rgb(12, 4).g - frame.layer("position").rgb(12, 10).g, 6 * 4 / 24.0 / 1.5, 0.05);
}

// The irradiance below the light stays, to a percent; its shadow and mirror image are those of a sphere, see the tests
// of lights. Unknown names are errors that list the known ones.
TEST_F(CliShot, LightsGetSizes) {
  const std::vector<std::string> small{"--resolution", "9x9", "--spp", "256",
                                       "--frames",     "0",   "--set", "film.crop=4,4,1,1"};
  ASSERT_EQ(render("", "point.exr", small).status, 0);
  ASSERT_EQ(render("[lights.bulb]\nradius = 0.7\n", "sphere.exr", small).status, 0);
  const float point = read_frame(path("point.0000.exr")).layer("color").rgb(0, 0).r,
              sphere = read_frame(path("sphere.0000.exr")).layer("color").rgb(0, 0).r;
  EXPECT_NEAR(sphere / point, 1, 0.02);
  const Outcome o = render("[lights.blub]\nradius = 0.7\n", "bad.exr", small);
  EXPECT_EQ(o.status, 3);
  EXPECT_NE(o.err.find("shot.toml:3:"), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("it has: bulb"), std::string::npos) << o.err;
}

}  // namespace
}  // namespace tempera::test
