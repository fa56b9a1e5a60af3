// SPDX-License-Identifier: Apache-2.0
// What files from other systems look like: byte order marks, backslashes, other case.
#include "tempera/import/paths.h"

#include "gltf/gltf_test_util.h"
#include "tempera/import/mesh_files.h"

namespace tempera {
namespace {

constexpr const char* kMark = "\xEF\xBB\xBF";
constexpr const char* kTriangleObj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

using Names = Gltf;

TEST_F(Names, ByteOrderMarksAreSkipped) {
  const std::string json = asset(R"("nodes":[{"name":"n"}])");
  Warnings warnings;
  EXPECT_EQ(import_gltf(write("a.gltf", kMark + json), {}, warnings).nodes.size(), 1u);
  EXPECT_EQ(import_gltf(write("a.glb", glb(kMark + json, "")), {}, warnings).nodes.size(), 1u);
  // Places are still those of the file.
  expect_error(kMark + asset("\n\"nodes\":3"), ErrorCode::kBadInput, 2, "is a number");

  write("mesh.obj", std::string(kMark) + kTriangleObj);
  write("metal.spd", std::string(kMark) + "400 0.5\n700 0.5\n");
  const std::string xml =
      "<scene version=\"3.0.0\"><shape type=\"obj\"><string name=\"filename\" value=\"mesh.obj\"/>"
      "<bsdf type=\"diffuse\"><spectrum name=\"reflectance\" filename=\"metal.spd\"/></bsdf></shape></scene>";
  const Scene scene = import_scene(write("a.xml", kMark + xml), {}, warnings);
  EXPECT_EQ(mesh_of(scene).triangle_count(), 1u);
}

TEST_F(Names, BackslashesSeparateFolders) {
  fs::create_directories(dir_ / "Parts" / "low");
  write("Parts/low/data.bin", std::string(36, '\0'));
  write("Parts/low/mesh.obj", kTriangleObj);
  write("Parts/low/a%20b.bin", std::string(36, '\0'));
  write("Parts/low/a b.bin", std::string(48, '\0'));
  Warnings warnings;
  const auto gltf_with = [&](const char* uri, int bytes) {
    return import_gltf(write("a.gltf", asset(fmt::format(R"("buffers":[{{"byteLength":{},"uri":"{}"}}])", bytes, uri))),
                       {}, warnings);
  };
  for (const char* uri : {"Parts/low/data.bin", R"(Parts\\low\\data.bin)", R"(.\\Parts\\low/data.bin)",
                          "Parts%5Clow%5cdata.bin", "Parts%2Flow/data%2ebin"})
    EXPECT_NO_THROW(gltf_with(uri, 36)) << uri;
  EXPECT_NO_THROW(gltf_with("Parts/low/a%20b.bin", 48));  // the decoded name goes first
  fs::remove(dir_ / "Parts/low/a b.bin");
  EXPECT_NO_THROW(gltf_with("Parts/low/a%20b.bin", 36));

  const std::string xml =
      "<scene version=\"3.0.0\"><shape type=\"obj\"><string name=\"filename\" "
      "value=\"Parts\\low\\mesh.obj\"/></shape></scene>";
  EXPECT_EQ(mesh_of(import_scene(write("a.xml", xml), {}, warnings)).triangle_count(), 1u);
  const std::string folder =
      "<scene version=\"3.0.0\"><path value=\"Parts\\low\"/><shape type=\"obj\"><string name=\"filename\" "
      "value=\"mesh.obj\"/></shape></scene>";
  EXPECT_EQ(mesh_of(import_scene(write("a.xml", folder), {}, warnings)).triangle_count(), 1u);

  // A name that really holds a backslash is found first.
  write("odd\\name.bin", std::string(12, '\0'));
  EXPECT_NO_THROW(gltf_with(R"(odd\\name.bin)", 12));
}

TEST_F(Names, OtherCaseIsSaid) {
  fs::create_directories(dir_ / "Parts");
  write("Parts/Wood.bin", "1234");
  const std::string json = asset(R"("buffers":[{"byteLength":4,"uri":"parts\\WOOD.bin"}])");
  expect_error(json, ErrorCode::kMissingFile, 1, "did you mean \"" + (dir_ / "Parts/Wood.bin").string() + "\"");
  expect_error(asset(R"("buffers":[{"byteLength":4,"uri":"parts/oak.bin"}])"), ErrorCode::kMissingFile, 1,
               "cannot find the file");
  EXPECT_EQ(cannot_find(dir_ / "none.bin").find("did you mean"), std::string::npos);
  Warnings warnings;
  try {
    import_scene(write("a.xml",
                       "<scene version=\"3.0.0\">\n<shape type=\"ply\"><string name=\"filename\" "
                       "value=\"parts\\wood.BIN\"/></shape></scene>"),
                 {}, warnings);
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_EQ(e.loc().line, 2);
    EXPECT_NE(e.message().find("did you mean"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace tempera
