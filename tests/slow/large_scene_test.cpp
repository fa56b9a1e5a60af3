// SPDX-License-Identifier: Apache-2.0
// A scene of ten million triangles: loads, renders, and stays within the memory that docs/performance.md states.
#include "../cli/program.h"

namespace tempera {
namespace {

class LargeScene : public test::CliTest {};

/// A bumpy square of 2 * n * n triangles as a binary PLY file, above the plane y = 0.
void write_terrain(const std::string& file, std::uint32_t n) {
  std::ofstream out(file, std::ios::binary);
  out << "ply\nformat binary_little_endian 1.0\nelement vertex " << (n + 1) * (n + 1)
      << "\nproperty float x\nproperty float y\nproperty float z\nelement face " << 2 * n * n
      << "\nproperty list uchar uint vertex_indices\nend_header\n";
  std::vector<char> row;
  const auto put = [&](const auto& value) {
    const char* bytes = reinterpret_cast<const char*>(&value);
    row.insert(row.end(), bytes, bytes + sizeof value);
  };
  const auto flush = [&] {
    out.write(row.data(), std::streamsize(row.size()));
    row.clear();
  };
  for (std::uint32_t j = 0; j <= n; ++j, flush()) {
    for (std::uint32_t i = 0; i <= n; ++i) {
      const float x = 2 * float(i) / float(n) - 1, z = 2 * float(j) / float(n) - 1;
      put(x), put(0.1f * std::sin(20 * x) * std::cos(17 * z)), put(z);
    }
  }
  for (std::uint32_t j = 0; j < n; ++j, flush()) {
    for (std::uint32_t i = 0; i < n; ++i) {
      const std::uint32_t a = j * (n + 1) + i, b = a + n + 1;
      put(std::uint8_t(3)), put(a), put(b), put(a + 1);
      put(std::uint8_t(3)), put(a + 1), put(b), put(b + 1);
    }
  }
}

TEST_F(LargeScene, TenMillionTrianglesFitIntoTheMemoryThatIsStated) {
  constexpr std::uint32_t kCells = 2237;  // 2 * 2237^2 = 10,008,338
  write_terrain(path("terrain.ply"), kCells);
  const std::string scene = write("scene.xml", R"(<scene version="3.0.0">
  <sensor type="perspective"><transform name="to_world"><lookat origin="0, 1.5, -2" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="160"/><integer name="height" value="90"/></film></sensor>
  <emitter type="constant"/>
  <shape type="ply"><string name="filename" value="terrain.ply"/></shape>
</scene>)");
  const auto arguments = [&](const char* limit) {
    return std::vector<std::string>{"render", scene, "-o", path("f.####.exr"), "--spp", "4", "--memory-limit", limit};
  };
  // The limit is checked against an estimate that holds for the worst of meshes, 340 bytes a triangle.
  const test::Outcome done = test::run(arguments("4G"));
  ASSERT_EQ(done.status, 0) << done.err;
  EXPECT_GT(mean(read_frame(path("f.0000.exr")).layer("color").rgb(80, 60)), 0.05f);
  rusage usage{};
  getrusage(RUSAGE_CHILDREN, &usage);  // the largest of the programs that ended
  EXPECT_LT(double(usage.ru_maxrss) / (1 << 20), 1.6) << "GiB";

  const test::Outcome refused = test::run(arguments("1G"));
  EXPECT_EQ(refused.status, 5);
  EXPECT_NE(refused.err.find("memory"), std::string::npos) << refused.err;
}

}  // namespace
}  // namespace tempera
