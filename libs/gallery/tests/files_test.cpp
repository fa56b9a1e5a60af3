// SPDX-License-Identifier: Apache-2.0
// Pictures, glTF files and the catalog, as far as they can be checked without a renderer.
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "tempera/core/error.h"
#include "tempera/frames/files.h"
#include "tempera/gallery/gallery.h"
#include "tempera/gallery/glb.h"
#include "tempera/gallery/picture.h"

namespace tempera::gallery {
namespace {

struct Decoded {
  OIIO::ImageSpec spec;
  std::vector<float> values;
};
Decoded decode(const char* name, const std::string& bytes) {
  OIIO::Filesystem::IOMemReader memory(bytes.data(), bytes.size());
  const auto in = OIIO::ImageInput::open(name, nullptr, &memory);
  if (!in) return {};
  Decoded d{in->spec(), std::vector<float>(std::size_t(in->spec().width) * std::size_t(in->spec().height) *
                                           std::size_t(in->spec().nchannels))};
  in->read_image(0, 0, 0, d.spec.nchannels, OIIO::TypeDesc::FLOAT, d.values.data());
  return d;
}

TEST(Picture, PngHoldsColorsAsSrgbAndDataAsTheyAre) {
  const Picture p = paint(4, 2, [](double u, double v) { return Rgb{float(u), float(v), 0.5f}; });
  const Decoded color = decode("a.png", encode_png(p)), data = decode("a.png", encode_png(p, false));
  ASSERT_EQ(color.spec.width, 4);
  ASSERT_EQ(color.spec.height, 2);
  ASSERT_EQ(color.spec.nchannels, 3);
  EXPECT_NEAR(color.values[2], 0.7354, 3e-3);  // 0.5 in sRGB
  EXPECT_NEAR(data.values[2], 0.5, 3e-3);
  EXPECT_NEAR(data.values[0], 0.125, 3e-3);  // the first pixel's center, on the left
  EXPECT_NEAR(data.values[1], 0.25, 3e-3);   // and on top
  EXPECT_EQ(decode("g.png", encode_png(paint(2, 2, [](double, double) { return Rgb(0.3f); }))).spec.nchannels, 1);
  EXPECT_EQ(encode_png(p), encode_png(p));
}

TEST(Picture, ExrHoldsRadiance) {
  const Picture p = paint_environment(8, 4, [](const Vec3d& d) { return Rgb{float(d.y > 0), 100, 0.25f}; });
  const Decoded d = decode("e.exr", encode_exr(p));
  ASSERT_EQ(d.values.size(), 8u * 4 * 3);
  EXPECT_EQ(d.values[0], 1);  // up is on top
  EXPECT_EQ(d.values[8 * 3 * 3], 0);
  EXPECT_EQ(d.values[1], 100);
  EXPECT_EQ(encode_exr(p), encode_exr(p));
}

TEST(Picture, NormalMapsPointUpAndLeanAway) {
  const auto flat = paint_normals(4, 4, [](double, double) { return 0.7; });
  EXPECT_NEAR(flat.at(1, 1).b, 1, 1e-6);
  const auto slope = paint_normals(4, 4, [](double u, double v) { return u - v; });
  EXPECT_LT(slope.at(1, 1).r, 0.3f);  // rises to the right: leans to the left
  EXPECT_LT(slope.at(1, 1).g, 0.3f);  // rises upwards: leans down
}

TEST(Picture, NoiseIsAFunctionThatRepeatsWhereItShould) {
  double least = 1, most = -1;
  for (int i = 0; i < 2000; ++i) {
    const double x = i * 0.137, y = i * 0.071;
    const double n = noise({x, y, 0.3}, 5);
    least = std::min(least, n), most = std::max(most, n);
    EXPECT_NEAR(tiled_noise(x, y, 6, 3, 9), tiled_noise(x + 1, y - 2, 6, 3, 9), 1e-9);
  }
  EXPECT_LT(least, -0.4);
  EXPECT_GT(most, 0.4);
  EXPECT_GT(least, -1.2);
  EXPECT_LT(most, 1.2);
  EXPECT_NE(noise({0.3, 0.4, 0.5}, 1), noise({0.3, 0.4, 0.5}, 2));
}

TEST(Picture, TextHasTheShapeOfItsLetters) {
  EXPECT_EQ(text_coverage("L", 0.5, 0.5), 1);
  EXPECT_EQ(text_coverage("L", 3.5, 0.5), 0);
  EXPECT_EQ(text_coverage("L", 3.5, 6.5), 1);
  EXPECT_EQ(text_coverage(" L", 6.5, 3.5), 1);
  EXPECT_EQ(text_coverage("L", -0.5, 3), 0);
  EXPECT_EQ(text_coverage("L", 12, 3), 0);
}

TEST(Glb, IsAFileOfTwoChunks) {
  Glb glb;
  const int red = glb.material({.name = "red", .color = {1, 0, 0}, .emission = {4, 2, 1}});
  const Glb::Part part{box({1, 2, 3}), red};
  const int mesh = glb.mesh("box", {&part, 1});
  const int node = glb.node({.name = "box", .translation = {1, 2, 3}, .mesh = mesh});
  glb.node({.name = "child", .parent = node, .mesh = mesh});
  const std::vector<double> times{0, 1};
  glb.translate(node, times, std::vector<Vec3d>{{0, 0, 0}, {1, 0, 0}});
  EXPECT_EQ(glb.triangles(), 12u);
  EXPECT_EQ(glb.placed_triangles(), 24u);
  const std::string bytes = glb.bytes();
  EXPECT_EQ(bytes, glb.bytes());

  std::uint32_t header[5];
  std::memcpy(header, bytes.data(), sizeof header);
  EXPECT_EQ(bytes.substr(0, 4), "glTF");
  EXPECT_EQ(header[1], 2u);
  EXPECT_EQ(header[2], bytes.size());
  ASSERT_LE(20 + header[3] + 8, bytes.size());
  EXPECT_EQ(header[3] % 4, 0u);
  const auto j = nlohmann::json::parse(bytes.substr(20, header[3]));
  std::uint32_t binary;
  std::memcpy(&binary, bytes.data() + 20 + header[3], 4);
  EXPECT_EQ(j["buffers"][0]["byteLength"].get<std::size_t>(), std::size_t(binary));
  for (const auto& view : j["bufferViews"])
    EXPECT_LE(view["byteOffset"].get<std::size_t>() + view["byteLength"].get<std::size_t>(), std::size_t(binary));
  EXPECT_EQ(j["extensionsUsed"], nlohmann::json::array({"KHR_materials_emissive_strength"}));
  EXPECT_EQ(j["materials"][0]["emissiveFactor"][0], 1);
  EXPECT_EQ(j["nodes"][0]["children"][0], 1);
  EXPECT_EQ(j["scenes"][0]["nodes"], nlohmann::json::array({0}));
  EXPECT_EQ(j["meshes"][0]["primitives"][0]["attributes"].size(), 3u);
  EXPECT_FALSE(j.contains("skins"));  // empty lists are no valid glTF
}

TEST(Catalog, NamesAreUniqueAndInOrder) {
  std::vector<std::string> names;
  for (const GalleryScene* s : gallery_catalog()) {
    names.push_back(s->name);
    EXPECT_FALSE(s->title.empty()) << s->name;
    EXPECT_NE(s->title.back(), '.') << s->name;
    EXPECT_FALSE(s->about.empty()) << s->name;
    EXPECT_EQ(s->figure.empty(), s->paper == nullptr) << s->name;
    EXPECT_GT(s->triangles, 0u) << s->name;
    EXPECT_GE(s->last_frame - s->first_frame, 23) << s->name;
    EXPECT_GE(s->reference_spp, 32 * s->spp) << s->name << ": a reference needs 32 times the samples";
    EXPECT_TRUE(s->camera_moves || !s->moving.empty()) << s->name;
    EXPECT_FALSE(s->classes.empty()) << s->name;
    std::set<std::string> variants;
    for (const GalleryVariant& v : s->variants) EXPECT_TRUE(variants.insert(v.name).second) << s->name;
  }
  EXPECT_TRUE(std::is_sorted(names.begin(), names.end()));
  EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), names.size());
}

TEST(Catalog, FindsScenesAndVariantsByName) {
  EXPECT_EQ(find_gallery_scene("wave").shot_file(), "shot.toml");
  EXPECT_EQ(find_gallery_scene("running-figure:4x").shot_file(), "shot_4x.toml");
  for (const char* wrong : {"waves", "running-figure:8x", "wave:"}) {
    try {
      find_gallery_scene(wrong);
      ADD_FAILURE() << wrong;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
      EXPECT_NE(std::string(e.what()).find("known: "), std::string::npos) << e.what();
    }
  }
}

TEST(Catalog, MissingPublishedScenesAreNamed) {
  try {
    make_gallery_scene(*find_gallery_scene("bathroom").scene, {"no/such/folder"});
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kMissingFile);
    for (const char* part : {"bathroom", "mitsuba/bathroom/scene.xml", "no/such/folder", "--scenes", "TEMPERA_SCENES"})
      EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
  }
}

TEST(Catalog, WritesWhatDiffers) {
  const auto folder = std::filesystem::temp_directory_path() / "tempera_gallery_write";
  std::filesystem::remove_all(folder);
  GalleryFiles files{{"a.txt", "one"}, {"b.txt", "two"}};
  EXPECT_EQ(write_gallery_files(files, folder), 2);
  EXPECT_EQ(write_gallery_files(files, folder), 0);
  files["b.txt"] = "three";
  EXPECT_EQ(write_gallery_files(files, folder), 1);
  EXPECT_EQ(read_file((folder / "b.txt").string()), "three");
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace tempera::gallery
