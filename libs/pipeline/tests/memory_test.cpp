// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/memory.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

TEST(Memory, ReadsSizes) {
  EXPECT_EQ(parse_memory_size("1024"), 1024u);
  EXPECT_EQ(parse_memory_size("64K"), 65536u);
  EXPECT_EQ(parse_memory_size("512M"), 512ull << 20);
  EXPECT_EQ(parse_memory_size("512MB"), 512ull << 20);
  EXPECT_EQ(parse_memory_size("1.5GiB"), 3ull << 29);
  EXPECT_EQ(parse_memory_size("2T"), 2ull << 40);
  for (const char* bad : {"", "G", "-1G", "0", "8X", "8GG", "1e30", "nan", "8 G"}) {
    try {
      parse_memory_size(bad);
      ADD_FAILURE() << bad;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kUsage) << bad;
    }
  }
}

TEST(Memory, MachineHasSome) {
  EXPECT_GT(machine_memory(), 64ull << 20);
  EXPECT_LT(machine_memory(), 1ull << 50);
}

Scene scene_of(int triangles) {
  Scene scene;
  Mesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  for (int i = 0; i < triangles; ++i) mesh.indices.insert(mesh.indices.end(), {0u, 1u, 2u});
  Shape shape;
  shape.geometry = std::move(mesh);
  scene.shapes.push_back(std::move(shape));
  scene.groups = {{0}};
  scene.instances.push_back({});
  return scene;
}

TEST(Memory, EstimateGrowsWithTrianglesAndPixels) {
  Shot shot;
  shot.params = Params(find_method("path").params);
  const std::uint64_t small = estimate_render_memory(shot, scene_of(1)),
                      large = estimate_render_memory(shot, scene_of(1000001));
  EXPECT_GT(large - small, 100u << 20) << "a million triangles take more than 100 bytes each";
  EXPECT_LT(large - small, 1000u << 20);
  Shot wide = shot;
  wide.settings.width *= 2;
  EXPECT_NEAR(double(estimate_render_memory(wide, scene_of(1))), 2 * double(small), 0.01 * double(small));
}

TEST(Memory, RefusesWhatCannotFit) {
  Shot shot;
  shot.params = Params(find_method("path").params);
  const Scene scene = scene_of(1000);
  EXPECT_NO_THROW(check_memory(shot, scene, 1ull << 40));
  try {
    check_memory(shot, scene, 1 << 20);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kOutOfMemory);
    EXPECT_NE(e.message().find("--memory-limit"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace tempera
