// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/box_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {
namespace {

float uniform(std::uint64_t key, std::uint64_t i) { return to_unit_float(std::uint32_t(hash_key(key, i) >> 32)); }

std::vector<std::size_t> visited(const BoxIndex& index, const Vec3f& p) {
  std::vector<std::size_t> found;
  index.visit(p, [&](std::size_t i) { found.push_back(i); });
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<std::size_t> all_around(const std::vector<Bounds3f>& boxes, const Vec3f& p) {
  std::vector<std::size_t> found;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    const Bounds3f& b = boxes[i];
    if (p.x >= b.lo.x && p.x <= b.hi.x && p.y >= b.lo.y && p.y <= b.hi.y && p.z >= b.lo.z && p.z <= b.hi.z) {
      found.push_back(i);
    }
  }
  return found;
}

TEST(BoxIndex, FindsWhatBruteForceFinds) {
  std::vector<Bounds3f> boxes;
  for (std::uint64_t i = 0; i < 5000; ++i) {
    Bounds3f b;
    const Vec3f p{uniform(i, 0), uniform(i, 1), uniform(i, 2)};
    b.extend(p);
    const float size = i % 10 == 0 ? 0.0f : i % 7 == 0 ? 0.5f : 0.05f;  // points, large and small ones
    b.extend(p + Vec3f{uniform(i, 3), uniform(i, 4), i % 3 == 0 ? 0 : uniform(i, 5)} * size);
    boxes.push_back(b);
  }
  const float nan = std::numeric_limits<float>::quiet_NaN();
  boxes.push_back({});                                                 // empty
  boxes.push_back({{nan, 0, 0}, {1, 1, 1}});                           // none
  boxes.push_back({{0, 0.5f, 0}, {1, 0.4f, 1}});                       // turned inside out
  boxes.push_back({{-kInfinity, 0, 0}, {kInfinity, 1, 1}});            // a bar
  boxes.push_back({{-1e30f, -1e30f, -1e30f}, {1e30f, 1e30f, 1e30f}});  // everything
  const BoxIndex index(boxes);
  std::size_t found = 0;
  std::vector<Vec3f> points;
  for (std::uint64_t i = 0; i < 3000; ++i) points.push_back({uniform(i, 6), uniform(i, 7), uniform(i, 8)});
  for (std::size_t i = 0; i < boxes.size(); i += 3) points.push_back(boxes[i].lo), points.push_back(boxes[i].hi);
  for (const Vec3f& p : {Vec3f{1e20f, 0.5f, 0.5f}, {kInfinity, 0.5f, 0.5f}, {nan, 0, 0}, {9, 9, 9}})
    points.push_back(p);
  for (const Vec3f& p : points) {
    const auto at = visited(index, p);
    EXPECT_EQ(at, all_around(boxes, p)) << p.x << " " << p.y << " " << p.z;
    found += at.size();
  }
  EXPECT_GT(found, 20000u);
}

TEST(BoxIndex, MayHoldNothingAndMove) {
  const BoxIndex none({});
  EXPECT_TRUE(visited(none, {0, 0, 0}).empty());
  const std::vector<Bounds3f> one{{{0, 0, 0}, {1, 1, 1}}};
  BoxIndex a(one), b({});
  b = std::move(a);
  EXPECT_EQ(visited(b, {1, 1, 1}), std::vector<std::size_t>{0});
  EXPECT_TRUE(visited(b, {1.0001f, 1, 1}).empty());
}

TEST(BoxIndex, IsReadByManyThreads) {
  std::vector<Bounds3f> boxes;
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const Vec3f p{uniform(i, 0), uniform(i, 1), uniform(i, 2)};
    boxes.push_back({p, p + Vec3f{0.2f, 0.2f, 0.2f}});
  }
  const BoxIndex index(boxes);
  std::vector<std::size_t> sums(1000);
  parallel_for(0, 1000, [&](std::int64_t i) {
    const auto key = std::uint64_t(i);
    index.visit({uniform(key, 3), uniform(key, 4), uniform(key, 5)}, [&](std::size_t k) { sums[key] += k + 1; });
  });
  for (std::uint64_t i = 0; i < 1000; ++i) {
    std::size_t expected = 0;
    for (const std::size_t k : all_around(boxes, {uniform(i, 3), uniform(i, 4), uniform(i, 5)})) expected += k + 1;
    EXPECT_EQ(sums[i], expected);
  }
}

}  // namespace
}  // namespace tempera
