// SPDX-License-Identifier: Apache-2.0
#include "../../src/sky/sunsky.h"
#include "mitsuba_test_util.h"

namespace tempera {
namespace {

TEST(MitsubaLights, PunctualLights) {
  Folder folder;
  const Scene s = folder.load(R"(
    <emitter type="point"><point name="position" value="1 2 3"/><rgb name="intensity" value="4 5 6"/></emitter>
    <emitter type="point"><transform name="to_world"><translate y="7"/></transform></emitter>
    <emitter type="spot" id="stage"><float name="cutoff_angle" value="40"/><transform name="to_world"><lookat origin="0 3 0" target="1 3 0" up="0 1 0"/></transform></emitter>
    <emitter type="spot"><float name="cutoff_angle" value="40"/><float name="beam_width" value="10"/></emitter>
    <emitter type="directional"><vector name="direction" value="0 -2 0"/><rgb name="irradiance" value="2"/></emitter>
    <emitter type="projector"><float name="fov" value="60"/><float name="scale" value="2"/></emitter>)");
  ASSERT_EQ(s.lights.size(), 6u);
  const auto pose = [&](std::size_t i) { return s.world(s.lights[i].node, 0); };
  EXPECT_EQ(s.lights[0].type, LightType::kPoint);
  EXPECT_EQ(s.lights[0].intensity.at(0), Rgb(4, 5, 6));
  expect_near(pose(0).translation, {1, 2, 3});
  expect_near(pose(1).translation, {0, 7, 0});
  EXPECT_EQ(s.lights[2].name, "stage");
  expect_near(pose(2).z, {1, 0, 0});
  EXPECT_NEAR(s.lights[2].cutoff_angle.at(0), 40 * kPi / 180, 1e-6);
  EXPECT_NEAR(s.lights[2].beam_width.at(0), 30 * kPi / 180, 1e-6);
  EXPECT_NEAR(s.lights[3].beam_width.at(0), 10 * kPi / 180, 1e-6);
  EXPECT_EQ(s.lights[4].type, LightType::kDirectional);
  expect_near(pose(4).z, {0, -1, 0});
  EXPECT_EQ(s.lights[4].intensity.at(0), Rgb(2.0f));
  EXPECT_EQ(s.lights[5].type, LightType::kProjector);
  EXPECT_NEAR(s.lights[5].projector_fov, kPi / 3, 1e-6);
  EXPECT_NEAR(s.lights[5].intensity.at(0).g, 2 * kPi, 1e-5);
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaLights, AreaLightsBelongToShapes) {
  Folder folder;
  const Scene s = folder.load(R"(
    <emitter type="area" id="glow"><rgb name="radiance" value="3 2 1"/></emitter>
    <shape type="rectangle"><ref id="glow"/></shape>
    <shape type="sphere"><emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>)");
  ASSERT_TRUE(s.shapes[0].emission && s.shapes[1].emission);
  EXPECT_EQ(s.shapes[0].emission->radiance.mean(), Rgb(3, 2, 1));
  EXPECT_EQ(s.shapes[1].emission->radiance.mean(), Rgb(5.0f));
  EXPECT_FALSE(s.shapes[1].emission->two_sided);
  EXPECT_TRUE(s.lights.empty());
  EXPECT_TRUE(folder.warnings.empty());
}

TEST(MitsubaLights, EnvironmentImages) {
  Folder folder;
  folder.write("e.pfm", [] {
    std::string b = "PF\n2 1\n-1.0\n";
    for (const float v : {1.0f, 2.0f, 3.0f, 4.0f, 5.0f, std::numeric_limits<float>::infinity()})
      b.append(reinterpret_cast<const char*>(&v), 4);
    return b;
  }());
  const Scene s =
      folder.load(R"(<emitter type="envmap"><string name="filename" value="e.pfm"/><float name="scale" value="2"/>
    <transform name="to_world"><scale value="3"/><rotate y="1" angle="90"/><translate x="9"/></transform></emitter>)");
  ASSERT_EQ(s.environments.size(), 1u);
  const Environment& e = s.environments[0];
  EXPECT_EQ(e.width, 2);
  EXPECT_EQ(e.height, 1);
  EXPECT_EQ(e.image[0], Rgb(1, 2, 3));
  EXPECT_EQ(e.image[1], Rgb(4, 5, 0));
  ASSERT_EQ(folder.warnings.lines().size(), 1u);
  EXPECT_NE(folder.warnings.lines()[0].find("negative, infinite or not a number are set to 0"), std::string::npos);
  EXPECT_EQ(e.radiance.at(0), Rgb(2.0f));
  expect_near(s.world(e.node, 0).x, {0, 0, -1});
  expect_near(s.world(e.node, 0).translation, {0, 0, 0});
  folder.write("e.pfm", "PF\n2 1\n-1.0\nshort");
  EXPECT_THROW(folder.load(R"(<emitter type="envmap"><string name="filename" value="e.pfm"/></emitter>)"), Error);
}

/// Radiance of Mitsuba 3.9.1's sunsky emitter (rgb variant), turbidity 3, albedo 0.3, sun at (1, 0, 1) / sqrt 2.
TEST(SunSky, RadianceIsMitsubas) {
  SunSkyParams params;
  params.sun_direction = normalize(Vec3d{1, 0, 1});
  const Sky sky(params);
  const struct {
    Vec3d d;
    Rgb value;
  } expected[] = {{{0, 0, 1}, {0.02374932f, 0.04151599f, 0.0840942f}},
                  {{1, 1, 1}, {0.06086959f, 0.09332516f, 0.1535218f}},
                  {{-1, 0, 0.05}, {0.1599004f, 0.2209357f, 0.268591f}},
                  {{0.5, -0.3, 0.8}, {0.06480926f, 0.08981293f, 0.1389715f}},
                  {{0.9, 0.1, 0.9}, {0.169314f, 0.193323f, 0.226814f}}};
  for (const auto& e : expected) {
    const Rgb value = sky.radiance(normalize(e.d));
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(value[c] / e.value[c], 1, 1e-4);
  }
  EXPECT_EQ(sky.radiance({0, 0.8, -0.6}), Rgb());
}

TEST(SunSky, ImageHoldsTheSunsPower) {
  for (const double elevation : {8.0, 30.0, 75.0, 89.95}) {
    for (const double aperture : {0.001, 0.5358, 4.0}) {
      SunSkyParams params;
      params.sun_direction = {std::cos(elevation * kPiD / 180) * 0.6, std::cos(elevation * kPiD / 180) * 0.8,
                              std::sin(elevation * kPiD / 180)};
      params.sky_scale = 0;
      params.sun_aperture = aperture;
      constexpr int kWidth = 512, kHeight = 256;
      const Grid<Rgb> image = sun_sky_image(params, kWidth);
      Vec3d sum, centre;
      for (int y = 0; y < kHeight; ++y) {
        const double row = 2 * kPiD / kWidth * (std::cos(kPiD * y / kHeight) - std::cos(kPiD * (y + 1) / kHeight));
        for (int x = 0; x < kWidth; ++x) {
          const Rgb& c = image.at(x, y);
          sum += Vec3d{c.r, c.g, c.b} * row;
          const double phi = 2 * kPiD * (x + 0.5) / kWidth, theta = kPiD * (y + 0.5) / kHeight;
          centre +=
              Vec3d{std::sin(theta) * std::sin(phi), std::sin(theta) * std::cos(phi), std::cos(theta)} * (c.g * row);
        }
      }
      const Rgb sun = sun_irradiance(params);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c] / sun[c], 1, 1e-4) << elevation << " " << aperture;
      EXPECT_GT(dot(normalize(centre), params.sun_direction), std::cos(0.5 * kPiD / 180))
          << elevation << " " << aperture;
    }
  }
}

/// Irradiance of the sun by Mitsuba 3.9.1's spectral variant, integrated over the disc and the observer.
TEST(SunSky, SunHasThePowerOfTheSpectralModel) {
  const struct {
    double turbidity, elevation;
    Rgb value;
  } expected[] = {{1, 20, {1.3081f, 0.94850f, 0.53852f}},
                  {3, 45, {1.39454f, 1.11986f, 0.81894f}},
                  {3, 5, {0.60505f, 0.26790f, 0.04043f}},
                  {10, 70, {0.94655f, 0.74832f, 0.59325f}}};
  for (const auto& e : expected) {
    SunSkyParams params;
    params.turbidity = e.turbidity;
    params.sun_direction = {std::cos(e.elevation * kPiD / 180), 0, std::sin(e.elevation * kPiD / 180)};
    const Rgb value = sun_irradiance(params);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(value[c], e.value[c], 0.003 * e.value.r);
  }
}

TEST(SunSky, PositionFollowsTheAlmanac) {
  // Solar noon at the equator on the equinox: the sun stands in the zenith.
  EXPECT_LT(sun_position({2024, 3, 20, 12, 7, 20, 0, 0, 0}).zenith, 0.3 * kPiD / 180);
  // Greenwich, 21 June 2024, 12:02 UT: elevation 90 - 51.48 + 23.44 = 61.96 degrees, due south.
  const SunAngles noon = sun_position({2024, 6, 21, 12, 1, 50, 51.48, 0, 0});
  EXPECT_NEAR(noon.zenith * 180 / kPiD, 28.04, 0.05);
  EXPECT_NEAR(std::abs(noon.azimuth) * 180 / kPiD, 180, 0.5);
  // In the morning it stands in the east.
  const SunAngles morning = sun_position({2024, 6, 21, 8, 0, 0, 51.48, 0, 0});
  EXPECT_GT(morning.azimuth * 180 / kPiD, 80);
  EXPECT_LT(morning.azimuth * 180 / kPiD, 110);
}

TEST(SunSky, EmittersPlaceTheSun) {
  Folder folder;
  const auto brightest = [&](const std::string& emitter, const char* version = "3.0.0") {
    const Scene s = folder.load(emitter, {}, version);
    const Environment& e = s.environments.at(0);
    std::size_t best = 0;
    for (std::size_t i = 0; i < e.image.size(); ++i)
      if (e.image[i].g > e.image[best].g) best = i;
    const std::size_t row = best / std::size_t(e.width), column = best % std::size_t(e.width);
    const double u = (double(column) + 0.5) / e.width * 2 * kPiD, v = (double(row) + 0.5) / e.height * kPiD;
    return s.world(e.node, 0).vector({std::sin(v) * std::sin(u), std::cos(v), -std::sin(v) * std::cos(u)});
  };
  const Vec3d d = normalize(Vec3d{0.3, 0.5, 0.4});
  EXPECT_LT(
      length(brightest(R"(<emitter type="sunsky"><vector name="sun_direction" value="0.3 0.5 0.4"/></emitter>)") - d),
      0.005);
  // z up turned to y up; the direction is in world space.
  EXPECT_LT(
      length(
          brightest(
              R"(<emitter type="sunsky"><vector name="sun_direction" value="0.3 0.5 0.4"/><transform name="to_world"><rotate x="1" angle="-90"/></transform></emitter>)") -
          d),
      0.005);
  EXPECT_LT(length(brightest(R"(<emitter type="sunsky"><vector name="sunDirection" value="0.3 0.5 0.4"/></emitter>)",
                             "0.6.0") -
                   d),
            0.005);
  // 0.6 has north along -z; on a July noon in Tokyo the sun stands south, high up.
  const Vec3d noon = brightest(R"(<emitter type="sunsky"><float name="hour" value="11.8"/></emitter>)", "0.6.0");
  EXPECT_GT(noon.z, 0.15);
  EXPECT_GT(noon.y, 0.95);
  // Mitsuba 3's default sun: Tokyo, 10 July 2010, 15 h.
  EXPECT_LT(length(brightest(R"(<emitter type="sunsky"/>)") - Vec3d{0.051385, 0.691748, 0.720308}), 0.005);
}

}  // namespace
}  // namespace tempera
