// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/vertex_cache.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <fstream>
#include <limits>

#include "tempera/scene/deform.h"

namespace tempera {
namespace {

template <class T>
std::string bytes(T value, bool big = false) {
  std::string s(reinterpret_cast<const char*>(&value), sizeof(value));
  return big ? std::string(s.rbegin(), s.rend()) : s;
}

/// Vertex v of sample i stands at (i, v, 10 i + v).
std::string positions(int samples, int vertices, bool big = false) {
  std::string s;
  for (int i = 0; i < samples; ++i) {
    for (int v = 0; v < vertices; ++v) s += bytes(float(i), big) + bytes(float(v), big) + bytes(float(10 * i + v), big);
  }
  return s;
}
std::string pc2(int samples, int vertices, float start, float rate) {
  return std::string("POINTCACHE2\0", 12) + bytes(1) + bytes(vertices) + bytes(start) + bytes(rate) + bytes(samples);
}

class VertexCaches : public testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directories(folder_); }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  /// A file of its own each time: those that are mapped must not change.
  std::shared_ptr<VertexCache> open(const std::string& content, VertexCacheOptions options) const {
    const std::filesystem::path file = folder_ / std::to_string(files_++);
    std::ofstream(file, std::ios::binary) << content;
    return VertexCache::open(file, options, {"shot.toml", 7, 1});
  }
  void expect_bad(const std::string& content, VertexCacheOptions options, const std::string& says) const {
    try {
      open(content, options);
      ADD_FAILURE() << says << ": nothing was thrown";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kBadInput) << e.what();
      EXPECT_EQ(e.loc().line, 7);
      EXPECT_NE(e.message().find(says), std::string::npos) << e.what();
    }
  }
  std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("tempera_cache_" + std::to_string(getpid()));
  mutable int files_ = 0;
};

TEST_F(VertexCaches, EveryFormatHoldsTheSame) {
  std::string mdd = bytes(3, true) + bytes(5, true);
  for (const float t : {0.5f, 0.75f, 2.0f}) mdd += bytes(t, true);
  for (const auto& c : {open(pc2(3, 5, 4, 0.5f) + positions(3, 5), {CacheFormat::kPc2}),
                        open(mdd + positions(3, 5, true), {CacheFormat::kMdd}),
                        open("header" + positions(3, 5), {CacheFormat::kRaw, 5, 6})}) {
    ASSERT_EQ(c->samples(), 3u);
    ASSERT_EQ(c->vertices(), 5u);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t v = 0; v < 5; ++v)
        EXPECT_EQ(c->position(i, v), (Vec3f{float(i), float(v), float(10 * i + v)})) << i << " " << v;
    }
  }
  EXPECT_EQ(open(pc2(3, 5, 4, 0.5f) + positions(3, 5), {CacheFormat::kPc2})->times(), (std::vector{4.0, 4.5, 5.0}));
  EXPECT_EQ(open(mdd + positions(3, 5, true), {CacheFormat::kMdd})->times(), (std::vector{0.5, 0.75, 2.0}));
  EXPECT_EQ(open(positions(3, 5), {CacheFormat::kRaw, 5})->times(), (std::vector{0.0, 1.0, 2.0}));
}

TEST_F(VertexCaches, DamagedFilesAreRefused) {
  const std::string good = pc2(3, 5, 0, 1) + positions(3, 5);
  for (std::size_t n = 1; n < good.size(); n += n < 40 ? 1 : 13) expect_bad(good.substr(0, n), {CacheFormat::kPc2}, "");
  expect_bad("", {CacheFormat::kPc2}, "is empty");
  expect_bad(good + "x", {CacheFormat::kPc2}, "more than 3 samples of 5 vertices need");
  expect_bad(good.substr(0, good.size() - 1), {CacheFormat::kPc2}, "fewer than 3 samples of 5 vertices need");
  expect_bad(pc2(3, -5, 0, 1) + positions(3, 5), {CacheFormat::kPc2}, "-5 vertices");
  expect_bad(pc2(2147483647, 2147483647, 0, 1), {CacheFormat::kPc2}, "fewer");
  expect_bad(bytes(2147483647, true) + bytes(2147483647, true), {CacheFormat::kMdd}, "fewer");
  expect_bad(bytes(3), {CacheFormat::kMdd}, "is not an MDD file");
  expect_bad(positions(3, 5) + "x", {CacheFormat::kRaw, 5}, "no multiple of the 60 of a sample of 5 vertices");
  expect_bad(positions(3, 5), {CacheFormat::kRaw, 5, 500}, "no multiple");
  expect_bad(std::string("POINTCACHE3\0", 12) + good.substr(12), {CacheFormat::kPc2}, "is not a PC2 file");
  std::string nan = good;
  const float bad = std::numeric_limits<float>::quiet_NaN();
  std::memcpy(&nan[32 + 12 * (2 * 5 + 3) + 4], &bad, 4);
  expect_bad(nan, {CacheFormat::kPc2}, "not finite: vertex 3 of sample 2");
  try {
    VertexCache::open(folder_ / "none", {}, {"shot.toml", 7, 1});
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kMissingFile);
  }
  expect_bad(good, {CacheFormat::kRaw, 0}, "0 vertices");
}

// More than one block of 4 MiB: every byte counts in the hash, and what is bad is found in any of them.
TEST_F(VertexCaches, LargeFilesAreReadInBlocks) {
  const int vertices = 50000, samples = 9;
  std::string content(std::size_t(vertices) * samples * 12 + 3, '\0');
  const VertexCacheOptions options{CacheFormat::kRaw, std::size_t(vertices), 3};  // floats lie across the blocks
  const std::uint64_t zeros = open(content, options)->content_hash();
  const float one = 1, infinity = std::numeric_limits<float>::infinity();
  for (const std::size_t vertex : {std::size_t(0), std::size_t(349525), std::size_t(449999)}) {
    std::string changed = content;
    std::memcpy(&changed[3 + 12 * vertex], &one, 4);
    EXPECT_NE(open(changed, options)->content_hash(), zeros) << vertex;
    EXPECT_EQ(open(changed, options)->position(vertex / 50000, vertex % 50000).x, 1);
    for (int c = 0; c < 3; ++c) {
      std::memcpy(&changed[3 + 12 * vertex + 4 * std::size_t(c)], &infinity, 4);
      expect_bad(changed, options,
                 "vertex " + std::to_string(vertex % 50000) + " of sample " + std::to_string(vertex / 50000));
    }
  }
}

/// Two quads that meet at x = 0, where the vertices are there twice, as at a seam of a texture.
Mesh seam(bool sharp) {
  Mesh m;
  const float d = sharp ? 0.6f : 0;
  for (const float side : {-1.0f, 1.0f}) {
    const auto base = std::uint32_t(m.positions.size());
    for (const float y : {0.0f, 1.0f}) {
      for (const float x : {0.0f, side}) {
        m.positions.push_back({x, y, 0});
        m.normals.push_back(sharp ? Vec3f{side * d, 0, 0.8f} : Vec3f{0, 0, 1});
      }
    }
    const auto quad =
        side > 0 ? std::array<std::uint32_t, 6>{0, 1, 3, 0, 3, 2} : std::array<std::uint32_t, 6>{0, 3, 1, 0, 2, 3};
    for (const std::uint32_t i : quad) m.indices.push_back(base + i);
  }
  return m;
}

// Folded like a roof the normals of a smooth seam stay common, those of a sharp one are their faces'.
TEST(CachedMeshes, NormalsFollowThePositions) {
  for (const bool sharp : {false, true}) {
    Scene scene;
    Mesh m = seam(sharp);
    std::vector<Vec3f> samples = m.positions;
    for (const Vec3f& p : m.positions) samples.push_back({p.x, p.y, -std::abs(p.x)});
    bind_cache(m, {.samples = std::make_shared<VertexCache>(std::vector{0.0, 2.0}, 8, samples)});
    EXPECT_TRUE(m.deforms());
    for (const double t : {-1.0, 0.0, 1.0, 2.0, 5.0}) {
      const MeshPose pose = mesh_pose(scene, m, -1, t);
      const double fold = std::clamp(t / 2, 0.0, 1.0);
      for (std::uint32_t v = 0; v < 8; ++v) {
        const float side = v < 4 ? -1.0f : 1.0f;
        EXPECT_LT(length(posed_position(m, pose, v) -
                         Vec3f{m.positions[v].x, m.positions[v].y, float(-fold * std::abs(m.positions[v].x))}),
                  1e-6f);
        const bool ridge = m.positions[v].x == 0;
        const Vec3f face = normalize(Vec3f{side * float(fold), 0, 1});
        const Vec3f expected = ridge && !sharp ? Vec3f{0, 0, 1} : face;
        EXPECT_LT(length(posed_normal(m, pose, v) - expected), 1e-5f) << t << " " << v << " " << sharp;
      }
    }
  }
}

TEST(CachedMeshes, VerticesComeFromWhereTheyWere) {
  Scene scene;
  Mesh m = make_rectangle();
  CachedPositions c;
  c.samples = std::make_shared<VertexCache>(std::vector{0.0}, 3, std::vector<Vec3f>{{1, 2, 3}, {4, 5, 6}, {7, 8, 9}});
  c.vertices = {2, 0, 0, 1};
  c.mesh_from_cache = {{1, 0, 0}, {0, 0, -1}, {0, 1, 0}};  // z up
  bind_cache(m, c);
  const MeshPose pose = mesh_pose(scene, m, -1, 0.5);
  EXPECT_EQ(posed_position(m, pose, 0), (Vec3f{7, 9, -8}));
  EXPECT_EQ(posed_position(m, pose, 1), (Vec3f{1, 3, -2}));
  EXPECT_EQ(posed_position(m, pose, 2), (Vec3f{1, 3, -2}));
  EXPECT_EQ(posed_position(m, pose, 3), (Vec3f{4, 6, -5}));
}

}  // namespace
}  // namespace tempera
