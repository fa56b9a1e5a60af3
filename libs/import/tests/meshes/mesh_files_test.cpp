// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/mesh_files.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "tempera/core/parallel.h"

namespace tempera {
namespace {

/// Passes if `f` throws an Error with this code and line.
template <class F>
testing::AssertionResult Fails(ErrorCode code, int line, F&& f) {
  try {
    f();
  } catch (const Error& e) {
    if (e.code() == code && e.loc().line == line) return testing::AssertionSuccess();
    return testing::AssertionFailure() << "got code " << int(e.code()) << " and message " << e.what();
  }
  return testing::AssertionFailure() << "nothing was thrown";
}

template <class T>
void put(std::string& bytes, T value, bool swap = false) {
  char b[sizeof(T)];
  std::memcpy(b, &value, sizeof(T));
  if (swap) std::reverse(b, b + sizeof(T));
  bytes.append(b, sizeof(T));
}

/// An OBJ file that gives no warning.
Mesh obj_mesh(const std::string& text, const std::string& file) {
  Warnings warnings;
  Mesh mesh = read_obj(text, file, warnings);
  EXPECT_TRUE(warnings.empty());
  return mesh;
}

double area(const Mesh& m) {
  double sum = 0;
  for (std::size_t i = 0; i < m.indices.size(); i += 3) {
    const Vec3d a(m.positions[m.indices[i]]), b(m.positions[m.indices[i + 1]]), c(m.positions[m.indices[i + 2]]);
    sum += length(cross(b - a, c - a)) / 2;
  }
  return sum;
}

// --- OBJ -------------------------------------------------------------------------------------------------------------

TEST(Obj, SharesVerticesOfEqualTriples) {
  const Mesh m = obj_mesh(
      "# two triangles with a seam: corner 3 has two texture coordinates\n"
      "v 0 0 0\r\nv 1 0 0\nv +1 1e0 0\nv 0 1 -.5\n"
      "vt 0 0\nvt 1 0.25\nvt 1 1\nvt 0 1\nvt 0.5 0.5\n"
      "vn 0 0 2\n"
      "usemtl wood\n"
      "f 1/1/1 2/2/1 3/3/1\n"
      "  f 1/1/1 3/5/1 4/4/1  # comment\n",
      "a.obj");
  EXPECT_EQ(m.indices, (std::vector<std::uint32_t>{0, 1, 2, 0, 3, 4}));
  ASSERT_EQ(m.positions.size(), 5u);
  EXPECT_EQ(m.positions[2], m.positions[3]);
  EXPECT_EQ(m.positions[4], (Vec3f{0, 1, -0.5f}));
  EXPECT_EQ(m.uvs[1], (Vec2f{1, 0.25f}));
  EXPECT_EQ(m.uvs[3], (Vec2f{0.5f, 0.5f}));
  EXPECT_EQ(m.normals[0], (Vec3f{0, 0, 1}));  // made unit
}

TEST(Obj, ConvexPolygonsBecomeFansAndShortFacesVanish) {
  const Mesh m = obj_mesh("v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 2 0\nf 1 2 3 4 5\nf 1 2\nf 3\n", "a.obj");
  EXPECT_EQ(m.indices, (std::vector<std::uint32_t>{0, 1, 2, 0, 2, 3, 0, 3, 4}));
  EXPECT_TRUE(m.uvs.empty());
  EXPECT_TRUE(m.normals.empty());
}

TEST(Obj, ABackslashContinuesAnyStatement) {
  const Mesh plain =
      obj_mesh("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.5 0.25\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1 4/1/1\n", "a.obj");
  for (const std::string end : {"\\\n", "\\\r\n", " \\ \t\r\n\t"}) {
    SCOPED_TRACE(end);
    const std::string text = fmt::format(
        "# of C:\\models\\\nv{0} 0 0 {0}0\nv 1 {0} 0{0} 0 # C:\\\nv 1 1 0\nv 0 1 0\nvt 0.5 {0}0.25\nvn 0 0{0} 1\n"
        "mtllib a{0} b\ng {0}\nf {0} {0}1/1/1 2/1/1 {0} 3/1/1{0}4/1/1 # end\\\nf {0}\n",
        end);
    const Mesh m = obj_mesh(text, "a.obj");
    EXPECT_EQ(m.positions, plain.positions);
    EXPECT_EQ(m.normals, plain.normals);
    EXPECT_EQ(m.uvs, plain.uvs);
    EXPECT_EQ(m.indices, plain.indices);
    // Lines count as they stand in the file.
    const std::string bad = fmt::format("v 0 0 0\n\nv 1{0} 0 0\nf 1{0} 2 7\n", end);
    EXPECT_TRUE(Fails(ErrorCode::kBadInput, 5, [&] { obj_mesh(bad, "a.obj"); }));
  }
  EXPECT_EQ(obj_mesh("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 \\", "a.obj").triangle_count(), 1u);
  EXPECT_EQ(obj_mesh("\\\n\\\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\\\r\n", "a.obj").triangle_count(), 1u);
  EXPECT_TRUE(Fails(ErrorCode::kBadInput, 1, [&] { obj_mesh("v 0 \\ 0 0\n", "a.obj"); }));
}

TEST(Obj, ContinuedLinesMayEndABlock) {
  // Blocks of 4 MiB are cut at the ends of statements, not of lines.
  std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  constexpr int kFaces = 400000;
  for (int i = 0; i < kFaces; ++i) text += i % 3 ? "f 1 \\\n 2 3\n" : "f\\\n 1 2\\\r\n 3\n";
  EXPECT_GT(text.size(), std::size_t(4) << 20);
  EXPECT_EQ(obj_mesh(text, "a.obj").triangle_count(), std::size_t(kFaces));
}

TEST(Obj, AByteOrderMarkIsSkipped) {
  EXPECT_EQ(obj_mesh("\xEF\xBB\xBFv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj").triangle_count(), 1u);
}

/// A face of these points in their plane, which is tilted and far away.
std::string tilted_polygon(const std::vector<Vec2d>& points, bool reversed = false) {
  const Affine3d place = translate(Vec3d{300, -20, 70}) * rotation(axis_angle(normalize(Vec3d{1, 2, 3}), 1.1));
  std::string text, face = "f";
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vec2d& q = points[reversed ? points.size() - 1 - i : i];
    const Vec3d p = place.point({q.x, q.y, 0});
    text += fmt::format("v {} {} {}\n", p.x, p.y, p.z);
    face += fmt::format(" {}", i + 1);
  }
  return text + face + "\n";
}

TEST(Obj, ConcavePolygonsAreCoveredExactly) {
  struct Case {
    const char* name;
    std::vector<Vec2d> points;
    double area;
  };
  std::vector<Case> cases = {
      {"arrow head", {{-1, -1}, {1, 0}, {-1, 1}, {-0.5, 0}}, 1.5},
      {"arrow head from its notch", {{-0.5, 0}, {-1, -1}, {1, 0}, {-1, 1}}, 1.5},
      {"L", {{0, 0}, {2, 0}, {2, 1}, {1, 1}, {1, 2}, {0, 2}}, 3},
      {"C", {{0, 0}, {3, 0}, {3, 1}, {1, 1}, {1, 2}, {3, 2}, {3, 3}, {0, 3}}, 7},
      {"square with corners on its sides", {{0, 0}, {1, 0}, {2, 0}, {2, 1}, {2, 2}, {0, 2}, {0, 1.5}, {0, 0.5}}, 4},
      {"repeated corners", {{0, 0}, {0, 0}, {2, 0}, {1, 0.5}, {1, 0.5}, {1, 0.5}, {1, 2}, {0, 0}}, 1.25 - 0.25 + 0.25},
      {"hole by a bridge", {{0, 0}, {4, 0}, {4, 4}, {0, 4}, {0, 0}, {1, 1}, {1, 3}, {3, 3}, {3, 1}, {1, 1}}, 12},
      {"two holes",
       {{0, 0},
        {9, 0},
        {9, 5},
        {0, 5},
        {0, 0},
        {1, 1},
        {1, 2},
        {2, 2},
        {6, 2},
        {6, 4},
        {7, 4},
        {7, 2},
        {6, 2},
        {2, 2},
        {2, 1},
        {1, 1}},
       45 - 1 - 2},
      {"spike", {{0, 0}, {2, 0}, {2, 2}, {1, 2}, {1, 3}, {1, 2}, {0, 2}}, 4},
      {"zigzag", {{0, 0}, {1, 2}, {2, 0}, {3, 2}, {4, 0}, {4, 1}, {3, 3}, {2, 1}, {1, 3}, {0, 1}}, 4},
  };
  for (Case& c : cases) {  // what the shoelace formula says, so that the table above need not be trusted
    double twice = 0;
    for (std::size_t i = 0; i < c.points.size(); ++i) {
      const Vec2d a = c.points[i], b = c.points[(i + 1) % c.points.size()];
      twice += a.x * b.y - a.y * b.x;
    }
    c.area = std::abs(twice) / 2;
    SCOPED_TRACE(c.name);
    for (std::size_t turn = 0; turn < c.points.size(); ++turn) {  // whatever corner comes first
      for (const bool reversed : {false, true}) {
        const Mesh m = obj_mesh(tilted_polygon(c.points, reversed), "a.obj");
        EXPECT_NEAR(area(m), c.area, 1e-4 * c.area) << turn << reversed;
        EXPECT_LE(m.triangle_count(), c.points.size() - 2);
        // All triangles face the way of the outline.
        const Vec3d up =
            rotation(axis_angle(normalize(Vec3d{1, 2, 3}), 1.1)).vector({0, 0, (twice < 0) != reversed ? -1.0 : 1.0});
        for (std::size_t i = 0; i < m.indices.size(); i += 3) {
          const Vec3d p(m.positions[m.indices[i]]), q(m.positions[m.indices[i + 1]]), r(m.positions[m.indices[i + 2]]);
          EXPECT_GT(dot(cross(q - p, r - p), up), -1e-4);
        }
      }
      std::rotate(c.points.begin(), c.points.begin() + 1, c.points.end());
    }
  }
}

TEST(Obj, ConcavePolygonsKeepWhatBelongsToTheirCorners) {
  const Mesh m = obj_mesh(
      "v -1 -1 0\nv 1 0 0\nv -1 1 0\nv 0.5 0 0\nvt 0.1 0\nvt 0.2 0\nvt 0.3 0\nvt 0.4 0\nvn 0 0 1\nvn 0 1 1\n"
      "f -4/-4/-2 -3/-3/-1 -2/-2/-2 -1/-1/-1\n",
      "a.obj");
  EXPECT_NEAR(area(m), 0.5, 1e-6);
  ASSERT_EQ(m.indices.size(), 6u);
  for (const std::uint32_t i : m.indices) {
    const float x = m.positions[i].x, y = m.positions[i].y;
    EXPECT_EQ(m.uvs[i].x, x == 1 ? 0.2f : x == 0.5f ? 0.4f : y < 0 ? 0.1f : 0.3f);
    EXPECT_EQ(m.normals[i].y > 0, x > 0);
  }
}

TEST(Obj, LargePolygonsTakeLittleTime) {
  // A cogwheel, a comb, a spiral and noise of tens of thousands of corners; without a bound each takes minutes.
  constexpr int kCorners = 60000;
  std::vector<Vec2d> wheel, comb, spiral, noise;
  for (int i = 0; i < kCorners; ++i) {
    const double a = 2 * kPiD * i / kCorners, r = i % 2 ? 1 : 1.5, s = double(i) / kCorners;
    wheel.push_back({r * std::cos(a), r * std::sin(a)});
    comb.push_back({s, i % 2 ? 1.0 : 0.01});
    const double t = std::abs(2 * s - 1), radius = (s < 0.5 ? 1.0 : 1.02) + 5 * t;
    spiral.push_back({radius * std::cos(200 * t), radius * std::sin(200 * t)});
    noise.push_back({std::fmod(i * 0.754877666, 1.0), std::fmod(i * 0.569840291, 1.0)});
  }
  comb.push_back({1, 0}), comb.push_back({0, 0});
  for (const auto* points : {&wheel, &comb, &spiral}) {
    double twice = 0;
    for (std::size_t i = 0; i < points->size(); ++i) {
      const Vec2d a = (*points)[i], b = (*points)[(i + 1) % points->size()];
      twice += a.x * b.y - a.y * b.x;
    }
    std::string text, face = "f";
    for (std::size_t i = 0; i < points->size(); ++i) {
      text += fmt::format("v {} 0 {}\n", (*points)[i].x, (*points)[i].y);
      face += fmt::format(" {}", i + 1);
    }
    EXPECT_NEAR(area(obj_mesh(text + face, "a.obj")), std::abs(twice) / 2, 1e-3 * std::abs(twice));
  }
  Warnings warnings;
  const Mesh m = read_obj(tilted_polygon(noise), "a.obj", warnings);
  EXPECT_LE(m.triangle_count(), noise.size() - 2);
  EXPECT_FALSE(warnings.empty());
}

TEST(Obj, CrossedPolygonsAreAWarning) {
  const auto check = [](const std::string& text, double at_most) {
    Warnings warnings;
    const Mesh m = read_obj(text, "a.obj", warnings);
    EXPECT_LE(area(m), at_most) << text;
    ASSERT_EQ(warnings.lines().size(), 1u) << text;
    EXPECT_NE(warnings.lines()[0].find("crosses itself"), std::string::npos);
    EXPECT_NE(warnings.lines()[0].find(fmt::format("a.obj:{}", std::count(text.begin(), text.end(), '\n'))),
              std::string::npos)
        << warnings.lines()[0];
  };
  check(tilted_polygon({{-1, -1}, {1, -1}, {-1, 1}, {1, 1}}), 4.001);  // bow tie; its lobes cancel out
  check(tilted_polygon({{-1, -1}, {1, -1}, {-1, 2}, {1, 1}}), 6);      // another
  std::vector<Vec2d> star;
  for (int i = 0; i < 5; ++i) star.push_back({std::cos(4 * kPiD / 5 * i), std::sin(4 * kPiD / 5 * i)});
  check(tilted_polygon(star), 4);
  check(tilted_polygon({{0, 0}, {3, 0}, {3, 3}, {1, -1}, {0, 3}}), 15.1);
  // A fold out of the plane is no crossing, nor is a polygon without area.
  EXPECT_EQ(obj_mesh("v 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nf 1 2 3 4\n", "a.obj").triangle_count(), 2u);
  EXPECT_EQ(area(obj_mesh("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\nv 1 0 0\nf 1 2 3 4 5\n", "a.obj")), 0);
  EXPECT_EQ(area(obj_mesh("v 0 0 0\nv 0 0 0\nf 1 2 1 2 1\n", "a.obj")), 0);
  EXPECT_NO_THROW(obj_mesh("v 3e38 0 0\nv -3e38 0 0\nv 0 3e38 0\nv 0 1e38 0\nv 1 2 3\nf 1 3 2 4\n", "a.obj"));
}

TEST(Obj, NegativeIndicesCountBack) {
  const Mesh m =
      obj_mesh("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\nv 5 5 5\nf -4 -3 -1\n", "a.obj");
  ASSERT_EQ(m.triangle_count(), 2u);
  EXPECT_EQ(m.positions[m.indices[5]], (Vec3f{5, 5, 5}));
  EXPECT_EQ(m.positions[m.indices[3]], (Vec3f{0, 0, 0}));
  // Corners without a normal in a file that has some are marked by zero.
  EXPECT_EQ(m.normals[m.indices[0]], (Vec3f{0, 0, 1}));
  EXPECT_EQ(m.normals[m.indices[5]], Vec3f{});
}

TEST(Obj, BlocksJoinWhateverTheThreads) {
  // About 13 MB: several blocks, with indices that count back over their borders.
  std::string text;
  constexpr int kTriangles = 120000;
  for (int i = 0; i < kTriangles; ++i)
    text += fmt::format("v {0}.0000000 0.125 1\nv {0}.5 1 1e-3\nv {0}.25 {1} -2\nvt 0.5 0.25\nf -3/-1 -2/-1 -1/{2}\n",
                        i, i % 7, i + 1);
  Mesh one, seven;
  with_threads(1, [&] { one = obj_mesh(text, "big.obj"); });
  with_threads(7, [&] { seven = obj_mesh(text, "big.obj"); });
  ASSERT_EQ(one.triangle_count(), std::size_t(kTriangles));
  ASSERT_EQ(one.positions.size(), std::size_t(3 * kTriangles));
  for (std::size_t i = 0; i < one.indices.size(); ++i) ASSERT_EQ(one.indices[i], i);
  EXPECT_EQ(one.positions[3 * 99999 + 2], (Vec3f{99999.25f, 99999 % 7, -2}));
  EXPECT_EQ(one.positions, seven.positions);
  EXPECT_EQ(one.indices, seven.indices);
  EXPECT_EQ(one.uvs, seven.uvs);
  text += "f 1 2 400000\n";
  EXPECT_TRUE(Fails(ErrorCode::kBadInput, 5 * kTriangles + 1, [&] { obj_mesh(text, "big.obj"); }));
}

TEST(Obj, ManyVerticesAtOnePositionStayDistinct) {
  std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  constexpr int kCount = 5000;
  for (int i = 0; i < kCount; ++i) text += fmt::format("vt {} 0\n", i);
  for (int round = 0; round < 2; ++round)
    for (int i = 0; i < kCount; ++i) text += fmt::format("f 1/{} 2/1 3/1\n", i + 1);
  const Mesh m = obj_mesh(text, "a.obj");
  EXPECT_EQ(m.positions.size(), std::size_t(kCount + 2));
  EXPECT_EQ(m.uvs[m.indices[3 * 4321]].x, 4321);
  EXPECT_EQ(m.indices[3 * 4321], m.indices[3 * (kCount + 4321)]);
}

TEST(Obj, ErrorsNameTheLine) {
  const auto fails = [](int line, const char* text) {
    return Fails(ErrorCode::kBadInput, line, [&] { obj_mesh(text, "a.obj"); });
  };
  EXPECT_TRUE(fails(2, "v 0 0 0\nv 1 x 0\n"));
  EXPECT_TRUE(fails(1, "v 0 0\n"));
  EXPECT_TRUE(fails(1, "v 0 nan 0\n"));
  EXPECT_TRUE(fails(1, "v 0 1e999 0\n"));
  EXPECT_TRUE(fails(2, "\nvn 0 inf 0\n"));
  EXPECT_TRUE(fails(2, "v 0 0 0\nvt\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3/1\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3//1\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3z\n"));
  EXPECT_TRUE(fails(4, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n"));
  EXPECT_EQ(obj_mesh("", "a.obj").triangle_count(), 0u);
  EXPECT_EQ(obj_mesh("v 0 1e-999 0", "a.obj").triangle_count(), 0u);
}

// --- PLY -------------------------------------------------------------------------------------------------------------

constexpr const char* kPlyProperties =
    "element vertex 4\n"
    "property double x\nproperty float y\nproperty int16 z\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    "property float s\nproperty float t\n"
    "element face 2\n"
    "property list uint8 int32 vertex_indices\n"
    "end_header\n";

std::string binary_ply(bool big_endian) {
  std::string b =
      fmt::format("ply\nformat binary_{}_endian 1.0\ncomment test\n{}", big_endian ? "big" : "little", kPlyProperties);
  for (int i = 0; i < 4; ++i) {
    put(b, 0.5 * i, big_endian);
    put(b, float(i) - 1, big_endian);
    put(b, std::int16_t(-300 * i), big_endian);
    for (const int c : {255, 51 * i, 0}) put(b, std::uint8_t(c));
    put(b, 0.25f * float(i), big_endian);
    put(b, 1.0f, big_endian);
  }
  put(b, std::uint8_t(4));
  for (const int i : {0, 1, 2, 3}) put(b, std::int32_t(i), big_endian);
  put(b, std::uint8_t(3));
  for (const int i : {3, 1, 0}) put(b, std::int32_t(i), big_endian);
  return b;
}

std::string ascii_ply() {
  std::string b = fmt::format("ply\nformat ascii 1.0\ncomment test\n{}", kPlyProperties);
  for (int i = 0; i < 4; ++i)
    b += fmt::format("{} {} {} 255 {} 0 {} +1.0\n", 0.5 * i, i - 1, -300 * i, 51 * i, 0.25 * i);
  return b + "4 0 1 2 3\n3 3 1 0\n";
}

TEST(Ply, AllFormatsGiveTheSameMesh) {
  for (const std::string& bytes : {ascii_ply(), binary_ply(false), binary_ply(true)}) {
    Warnings warnings;
    const Mesh m = read_ply(bytes, "a.ply", warnings);
    EXPECT_TRUE(warnings.empty());
    ASSERT_EQ(m.positions.size(), 4u);
    EXPECT_EQ(m.positions[3], (Vec3f{1.5f, 2, -900}));
    EXPECT_EQ(m.uvs[2], (Vec2f{0.5f, 1}));
    EXPECT_TRUE(m.normals.empty());
    ASSERT_EQ(m.colors.size(), 4u);
    EXPECT_NEAR(m.colors[2].g, 102 / 255.0, 1e-6);
    EXPECT_EQ(m.colors[2].r, 1);
    EXPECT_FALSE(m.color_per_face);
    EXPECT_EQ(m.indices, (std::vector<std::uint32_t>{0, 1, 2, 0, 2, 3, 3, 1, 0}));
  }
}

TEST(Ply, FaceColorsFollowTheTrianglesOfAPolygon) {
  Warnings warnings;
  const Mesh m = read_ply(
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float "
      "quality\n"
      "element face 2\nproperty float r\nproperty list uchar uint vertex_index\nproperty float g\nproperty float b\n"
      "element edge 1\nproperty int a\nend_header\n"
      "0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 0 9\n"
      "0.1 4 0 1 2 3 0.2 0.3\n0.5 3 0 1 2 0.6 0.7\n1\n",
      "a.ply", warnings);
  ASSERT_TRUE(m.color_per_face);
  ASSERT_EQ(m.colors.size(), 3u);
  EXPECT_EQ(m.colors[0], Rgb(0.1f, 0.2f, 0.3f));
  EXPECT_EQ(m.colors[1], Rgb(0.1f, 0.2f, 0.3f));
  EXPECT_EQ(m.colors[2], Rgb(0.5f, 0.6f, 0.7f));
  EXPECT_FALSE(warnings.empty());  // quality and edge
}

TEST(Ply, ConcavePolygonsWithColorsAndWideIndices) {
  constexpr const char* kHeader =
      "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 2\nproperty list {} vertex_indices\nproperty uchar red\nproperty uchar green\n"
      "property uchar blue\nend_header\n";
  const std::string ascii = "\xEF\xBB\xBF" + fmt::format(kHeader, "ascii", "int64 uint64") +
                            "-1 -1 0\n1 0 0\n-1 1 0\n0.5 0 0\n4 0 1 2 3 255 0 0\n3 0 1 2 0 0 255\n";
  std::string binary = fmt::format(kHeader, "binary_big_endian", "uint64 long");
  for (const float v : {-1.0f, -1.0f, 0.0f, 1.0f, 0.0f, 0.0f, -1.0f, 1.0f, 0.0f, 0.5f, 0.0f, 0.0f})
    put(binary, v, true);
  put(binary, std::uint64_t(4), true);
  for (const int i : {0, 1, 2, 3}) put(binary, std::int64_t(i), true);
  for (const int c : {255, 0, 0}) put(binary, std::uint8_t(c));
  put(binary, std::uint64_t(3), true);
  for (const int i : {0, 1, 2}) put(binary, std::int64_t(i), true);
  for (const int c : {0, 0, 255}) put(binary, std::uint8_t(c));
  for (const std::string& bytes : {ascii, binary}) {
    Warnings warnings;
    const Mesh m = read_ply(bytes, "a.ply", warnings);
    EXPECT_TRUE(warnings.empty());
    ASSERT_EQ(m.triangle_count(), 3u);
    EXPECT_NEAR(area(m), 0.5 + 2, 1e-6);
    ASSERT_EQ(m.colors.size(), 3u);
    EXPECT_EQ(m.colors[1], Rgb(1, 0, 0));
    EXPECT_EQ(m.colors[2], Rgb(0, 0, 1));
  }
}

TEST(Ply, FacesMayComeBeforeVertices) {
  Warnings warnings;
  const Mesh m = read_ply(
      "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int vertex_index\nelement vertex 4\n"
      "property float x\nproperty float y\nproperty float z\nend_header\n"
      "4 0 1 2 3\n4 0 2 1 3\n-1 -1 0\n1 -1 0\n1 1 0\n-1 1 0\n",
      "a.ply", warnings);
  EXPECT_EQ(m.triangle_count(), 4u);
  ASSERT_EQ(warnings.lines().size(), 1u);  // the second face crosses itself
  EXPECT_NE(warnings.lines()[0].find("a.ply:11"), std::string::npos) << warnings.lines()[0];
}

TEST(Ply, ErrorsNameTheLine) {
  const auto fails = [](int line, const std::string& text, ErrorCode code = ErrorCode::kBadInput) {
    return Fails(code, line, [&] {
      Warnings warnings;
      read_ply(text, "a.ply", warnings);
    });
  };
  const std::string good = ascii_ply();
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const std::size_t at = text.find(from);
    EXPECT_NE(at, std::string::npos);
    return text.replace(at, from.size(), to);
  };
  EXPECT_TRUE(fails(1, "plx\n"));
  EXPECT_TRUE(fails(1, ""));
  EXPECT_TRUE(fails(3, "ply\nformat ascii 1.0\n"));
  EXPECT_TRUE(fails(2, with("ascii", "morse")));
  EXPECT_TRUE(fails(2, with("1.0", "2.0"), ErrorCode::kUnsupported));
  EXPECT_TRUE(fails(4, with("vertex 4", "vertex many")));
  EXPECT_TRUE(fails(4, with("vertex 4", "vertex 99999999999")));
  EXPECT_TRUE(fails(5, with("double x", "quad x")));
  EXPECT_TRUE(fails(4, with("double x", "double xx")));
  EXPECT_TRUE(fails(14, with("list uint8", "list float")));
  EXPECT_TRUE(fails(13, with("vertex_indices", "corners")));
  EXPECT_TRUE(fails(18, with("1 1 -600", "1 one -600")));
  EXPECT_TRUE(fails(17, with("0.5 0 -300", "nan 0 -300")));
  EXPECT_TRUE(fails(20, with("4 0 1 2 3", "4 0 1 2 4")));
  EXPECT_TRUE(fails(20, with("4 0 1 2 3", "4 0 1 2 -1")));
  EXPECT_TRUE(fails(22, with("3 3 1 0\n", "3 3 1\n")));
  // A header that lies about binary data.
  std::string binary = binary_ply(false);
  EXPECT_TRUE(fails(0, binary.substr(0, binary.size() - 3)));
  const std::size_t count = binary.find("face 2");
  EXPECT_TRUE(fails(13, std::string(binary).replace(count, 6, "face 4000000000")));
  std::string index = binary;
  index[index.size() - 12] = 77;
  EXPECT_TRUE(fails(0, index));
}

// --- serialized ------------------------------------------------------------------------------------------------------

std::string deflate(const std::string& data) {
  uLongf size = compressBound(uLong(data.size()));
  std::string packed(size, '\0');
  compress(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(data.data()),
           uLong(data.size()));
  packed.resize(size);
  return packed;
}

/// One triangle whose first vertex stands at (x, 0, 0).
template <class Float>
std::string mesh_stream(int version, float x, std::uint32_t index = 2, std::uint64_t vertex_count = 3) {
  std::string data;
  put(data, std::uint32_t((sizeof(Float) == 8 ? 0x2000 : 0x1000) | 0x1 | 0x2));
  if (version == 4) data.append("name", 5);
  put(data, vertex_count);
  put(data, std::uint64_t(1));
  for (const double v : {double(x), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0}) put(data, Float(v));
  for (int i = 0; i < 3; ++i)
    for (const double v : {0.0, 0.0, 2.0}) put(data, Float(v));
  for (const double v : {0.0, 0.0, 1.0, 0.0, 0.0, 1.0}) put(data, Float(v));
  for (const std::uint32_t i : {0u, 1u, index}) put(data, i);
  std::string bytes;
  put(bytes, std::uint16_t(0x041c));
  put(bytes, std::uint16_t(version));
  return bytes + deflate(data);
}

template <class Offset>
std::string serialized_file(const std::vector<std::string>& streams) {
  std::string bytes, table;
  for (const std::string& s : streams) {
    put(table, Offset(bytes.size()));
    bytes += s;
  }
  put(table, std::uint32_t(streams.size()));
  return bytes + table;
}

TEST(Serialized, ReadsBothVersionsAndPrecisions) {
  const std::string v3 = serialized_file<std::uint32_t>({mesh_stream<float>(3, 5), mesh_stream<double>(3, 6)});
  const std::string v4 =
      serialized_file<std::uint64_t>({mesh_stream<double>(4, 5), mesh_stream<float>(4, 6), mesh_stream<float>(4, 7)});
  for (const std::string& file : {v3, v4}) {
    for (int i = 0; i < 2; ++i) {
      const Mesh m = read_serialized(file, "a.serialized", i);
      ASSERT_EQ(m.positions.size(), 3u);
      EXPECT_EQ(m.positions[0], (Vec3f{float(5 + i), 0, 0}));
      EXPECT_EQ(m.normals[2], (Vec3f{0, 0, 1}));
      EXPECT_EQ(m.uvs[1], (Vec2f{1, 0}));
      EXPECT_EQ(m.indices, (std::vector<std::uint32_t>{0, 1, 2}));
    }
  }
  EXPECT_EQ(read_serialized(v4, "a.serialized", 2).positions[0].x, 7);
}

TEST(Serialized, DamageIsAnError) {
  const auto fails = [](ErrorCode code, const std::string& bytes, int index = 0, std::uint64_t max_bytes = 0) {
    return Fails(code, 0, [&] { read_serialized(bytes, "a.serialized", index, max_bytes); });
  };
  const std::string good = serialized_file<std::uint64_t>({mesh_stream<float>(4, 5), mesh_stream<float>(4, 6)});
  const auto overwritten = [&](std::size_t at, std::string_view bytes) {
    std::string s = good;
    std::copy(bytes.begin(), bytes.end(), s.begin() + std::ptrdiff_t(at));
    return s;
  };
  EXPECT_TRUE(fails(ErrorCode::kBadInput, ""));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, "\x1c\x04"));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, "PK" + good));
  EXPECT_TRUE(fails(ErrorCode::kUnsupported, overwritten(2, "\x09")));
  EXPECT_TRUE(fails(ErrorCode::kOutOfRange, good, 2));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, good.substr(0, 40)));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, overwritten(10, "\xff\xff\xff\xff")));
  std::string table = good;
  table[table.size() - 12] = '\x7f';  // offset of the second mesh
  EXPECT_TRUE(fails(ErrorCode::kBadInput, table, 1));
  table = good;
  table[table.size() - 2] = '\x7f';  // number of meshes
  EXPECT_TRUE(fails(ErrorCode::kBadInput, table, 1));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, mesh_stream<float>(4, 5, 3)));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, mesh_stream<float>(4, std::numeric_limits<float>::quiet_NaN())));
  // A header that claims far more than there is fails when the data end, not when memory does.
  EXPECT_TRUE(fails(ErrorCode::kBadInput, mesh_stream<float>(4, 5, 2, 4000000000u)));
  EXPECT_TRUE(fails(ErrorCode::kBadInput, mesh_stream<float>(4, 5, 2, ~std::uint64_t(0))));
  EXPECT_TRUE(fails(ErrorCode::kOutOfMemory, good, 0, 50));
}

// --- normals ---------------------------------------------------------------------------------------------------------

TEST(Normals, AnglesWeighCubeCorners) {
  // At a corner of a cube whose faces are split unevenly, angles (not triangles or areas) make the mean symmetric.
  Mesh cube = make_cube();
  std::vector<Vec3f> corners;
  for (std::uint32_t& i : cube.indices) {
    const Vec3f p = cube.positions[i];
    const auto at = std::find(corners.begin(), corners.end(), p);
    i = std::uint32_t(at - corners.begin());
    if (at == corners.end()) corners.push_back(p);
  }
  cube.positions = corners;
  cube.uvs.clear();
  fill_normals(cube);
  ASSERT_EQ(cube.normals.size(), 8u);
  for (std::size_t i = 0; i < 8; ++i) EXPECT_LT(length(cube.normals[i] - normalize(corners[i])), 1e-6f);
}

TEST(Normals, FillsOnlyWhatIsMissing) {
  Mesh m = make_rectangle();
  m.normals = {{1, 0, 0}, {}, {0, 1, 0}, {}};
  m.positions.push_back({5, 5, 5});  // no triangle uses it
  m.normals.push_back({});
  fill_normals(m);
  EXPECT_EQ(m.normals[0], (Vec3f{1, 0, 0}));
  EXPECT_EQ(m.normals[1], (Vec3f{0, 0, 1}));
  EXPECT_EQ(m.normals[4], (Vec3f{1, 0, 0}));
}

TEST(Normals, CreasesBreakAtTheAngle) {
  // Two squares that meet at 45 degrees.
  const auto roof = [] {
    return obj_mesh("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 1\nv 2 1 1\nf 1 2 3 4\nf 2 5 6 3\n", "roof.obj");
  };
  Mesh sharp = roof();
  crease_normals(sharp, 44 * kPi / 180);
  EXPECT_EQ(sharp.positions.size(), 8u);
  EXPECT_EQ(sharp.triangle_count(), 4u);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_LT(length(sharp.normals[sharp.indices[i]] - Vec3f{0, 0, 1}), 1e-6f);
  Mesh smooth = roof();
  crease_normals(smooth, 46 * kPi / 180);
  EXPECT_EQ(smooth.positions.size(), 6u);
  for (std::size_t i = 0; i < smooth.positions.size(); ++i) {
    if (smooth.positions[i].x != 1) continue;
    EXPECT_NEAR(std::atan2(-smooth.normals[i].x, smooth.normals[i].z), 22.5f * kPi / 180, 1e-5f);
  }
}

TEST(Normals, WindingFollowsNormals) {
  Mesh m = make_rectangle();
  m.normals.assign(4, {0, 0, -1});
  align_winding(m);
  const Vec3f p = m.positions[m.indices[0]];
  EXPECT_LT(cross(m.positions[m.indices[1]] - p, m.positions[m.indices[2]] - p).z, 0);
  const std::vector<std::uint32_t> turned = m.indices;
  align_winding(m);
  EXPECT_EQ(m.indices, turned);
}

}  // namespace
}  // namespace tempera
