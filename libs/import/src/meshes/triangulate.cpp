// SPDX-License-Identifier: Apache-2.0
#include "triangulate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <numeric>

namespace tempera {
namespace {

constexpr std::uint64_t kMaxSteps = std::uint64_t(1) << 26;  // about half a second

/// Twice the signed area of a triangle.
double area(const Vec2d& a, const Vec2d& b, const Vec2d& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// Twice the vector area of a polygon, relative to its first corner so that far ones keep their digits.
Vec3d vector_area(std::span<const Vec3f> corners) {
  const Vec3d origin(corners[0]);
  Vec3d sum;
  for (std::size_t i = 1; i + 1 < corners.size(); ++i)
    sum += cross(Vec3d(corners[i]) - origin, Vec3d(corners[i + 1]) - origin);
  return sum;
}

/// The corners without the coordinate along which the area is smallest; counterclockwise. This keeps their digits, and
/// what is convex.
std::vector<Vec2d> project(std::span<const Vec3f> corners, const Vec3d& normal) {
  int axis = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(normal[i]) > std::abs(normal[axis])) axis = i;
  int u = (axis + 1) % 3, v = (axis + 2) % 3;
  if (normal[axis] < 0) std::swap(u, v);
  std::vector<Vec2d> points;
  points.reserve(corners.size());
  for (const Vec3f& p : corners) points.push_back({p[u], p[v]});
  return points;
}

/// Whether all corners turn left, none is straight, and the outline goes round once.
bool strictly_convex(std::span<const Vec2d> p) {
  const std::size_t n = p.size();
  int changes = 0;  // of the direction along x: a star that turns left all the way has more than two
  bool rightwards = p[0].x > p[n - 1].x;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec2d &a = p[i], &b = p[(i + 1) % n], &c = p[(i + 2) % n];
    if (!(area(a, b, c) > 0)) return false;
    if (b.x != a.x && (b.x > a.x) != rightwards) rightwards = !rightwards, ++changes;
  }
  return changes <= 2;
}

/// Cuts ears off one polygon. The corners left form a ring; a corner can only be blocked by reflex ones, which a grid
/// finds. First come, first cut: ears all around before their neighbors, so that few triangles are slivers.
class EarCutter {
 public:
  EarCutter(std::vector<Vec2d> points, std::vector<std::uint32_t>& triangles)
      : p_(std::move(points)), out_(triangles), next_(p_.size()), previous_(p_.size()), reflex_(p_.size(), 0) {
    for (std::uint32_t i = 0; i < p_.size(); ++i) next_[i] = i + 1, previous_[i] = i - 1;
    previous_.front() = std::uint32_t(p_.size()) - 1, next_.back() = 0;
    left_ = p_.size();
  }

  bool run() {
    drop_repeated();
    if (left_ < 3) return true;  // a line or a point
    bool simple = turns_once();
    for (std::uint32_t i = start_, k = 0; k < left_; ++k, i = next_[i]) update(i);
    build_grid();
    // What counts as an ear is widened only when no better one is left: one that others touch, then one without area,
    // then anything, which only an outline that crosses itself takes.
    Rank rank = kClear;
    std::deque<std::uint32_t> candidates;
    bool progress = true;
    while (left_ > 3) {
      if (candidates.empty()) {  // who was blocked may be free now
        rank = !progress ? Rank(rank + 1) : steps_ > kMaxSteps ? kAny : kClear;
        progress = false;
        for (std::uint32_t i = start_, k = 0; k < left_; ++k, i = next_[i]) candidates.push_back(i);
      }
      const std::uint32_t i = candidates.front();
      candidates.pop_front();
      if (next_[previous_[i]] != i || !(rank == kAny || is_ear(i, rank))) continue;
      simple = simple && rank != kAny;
      const std::uint32_t before = previous_[i], after = next_[i];
      cut(i);
      candidates.push_back(before);
      candidates.push_back(after);
      progress = true;
      if (rank == kAny && steps_ <= kMaxSteps) rank = kClear;
    }
    const double last = corner_area(start_);
    if (last != 0) emit(previous_[start_], start_, next_[start_]);
    return simple && last >= 0;
  }

 private:
  enum Rank { kClear, kTouched, kFlat, kAny };

  double corner_area(std::uint32_t i) const { return area(p_[previous_[i]], p_[i], p_[next_[i]]); }

  void unlink(std::uint32_t i) {
    next_[previous_[i]] = next_[i];  // from now on next_[previous_[i]] != i
    previous_[next_[i]] = previous_[i];
    if (start_ == i) start_ = next_[i];
    --left_;
  }

  /// Takes out corners at the place of the next one, and tips that the outline goes to and straight back from.
  void drop_repeated() {
    std::uint32_t i = start_;
    for (std::size_t kept = 0; kept < left_ && left_ > 2;) {
      const std::uint32_t before = previous_[i], after = next_[i];
      if (p_[i] == p_[after] || p_[before] == p_[after]) {
        unlink(i);
        i = before;
        kept = 0;
      } else {
        i = after;
        ++kept;
      }
    }
  }

  /// Whether the outline turns by a full circle in all, as one does that does not cross itself. Where it goes back on
  /// itself its turn has no sign; it passes.
  bool turns_once() const {
    double sum = 0;
    for (std::uint32_t i = start_, k = 0; k < left_; ++k, i = next_[i]) {
      const Vec2d a = p_[i] - p_[previous_[i]], b = p_[next_[i]] - p_[i];
      const double sine = a.x * b.y - a.y * b.x, cosine = a.x * b.x + a.y * b.y;
      if (sine == 0 && cosine <= 0) return true;
      sum += std::atan2(sine, cosine);
    }
    return std::abs(sum / (2 * kPiD) - 1) < 0.25;
  }

  void update(std::uint32_t i) {
    const bool reflex = corner_area(i) < 0;
    if (reflex != bool(reflex_[i])) reflex_[i] = reflex, reflex ? ++reflex_count_ : --reflex_count_;
  }

  /// Cells with the reflex corners. Corners only ever stop being reflex, but for outlines that cross themselves.
  void build_grid() {
    built_for_ = reflex_count_;
    Vec2d hi = lo_ = p_[start_];
    std::vector<std::uint32_t> reflex;
    for (std::uint32_t i = start_, k = 0; k < left_; ++k, i = next_[i]) {
      lo_ = {std::min(lo_.x, p_[i].x), std::min(lo_.y, p_[i].y)};
      hi = {std::max(hi.x, p_[i].x), std::max(hi.y, p_[i].y)};
      if (reflex_[i]) reflex.push_back(i);
    }
    size_ = std::clamp(int(std::sqrt(double(reflex.size()))), 1, 1024);
    scale_ = {size_ / std::max(hi.x - lo_.x, 1e-300), size_ / std::max(hi.y - lo_.y, 1e-300)};
    first_.assign(size_ * size_ + 1, 0);
    for (const std::uint32_t i : reflex) ++first_[cell(p_[i]) + 1];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    items_.resize(reflex.size());
    std::vector<std::uint32_t> at(first_.begin(), first_.end() - 1);
    for (const std::uint32_t i : reflex) items_[at[cell(p_[i])]++] = i;
  }
  int column(double x) const { return int(std::clamp((x - lo_.x) * scale_.x, 0.0, size_ - 1.0)); }
  int row(double y) const { return int(std::clamp((y - lo_.y) * scale_.y, 0.0, size_ - 1.0)); }
  int cell(const Vec2d& p) const { return row(p.y) * size_ + column(p.x); }

  bool is_ear(std::uint32_t i, Rank rank) {
    ++steps_;
    const double own = corner_area(i);
    if (rank == kFlat) return own == 0;
    if (!(own > 0)) return false;
    return reflex_count_ == 0 || !is_blocked(i, rank);
  }

  bool is_blocked(std::uint32_t i, Rank rank) {
    const std::uint32_t before = previous_[i], after = next_[i];
    const Vec2d a = p_[before], b = p_[i], c = p_[after];
    const int x0 = column(std::min({a.x, b.x, c.x})), x1 = column(std::max({a.x, b.x, c.x}));
    const int y0 = row(std::min({a.y, b.y, c.y})), y1 = row(std::max({a.y, b.y, c.y}));
    for (int y = y0; y <= y1; ++y) {
      const std::uint32_t begin = first_[y * size_ + x0], end = first_[y * size_ + x1 + 1];
      steps_ += 1 + end - begin;
      for (std::uint32_t k = begin; k < end; ++k) {
        const std::uint32_t q = items_[k];
        if (!reflex_[q] || q == before || q == i || q == after) continue;
        const double ab = area(a, b, p_[q]), bc = area(b, c, p_[q]), ca = area(c, a, p_[q]);
        if (ab < 0 || bc < 0 || ca < 0) continue;
        // Two chains may meet at an end of the diagonal, as they do where a bridge leads to a hole.
        if (p_[q] == a || p_[q] == c) continue;
        if (rank == kClear || (ab > 0 && bc > 0 && ca > 0)) return true;
      }
    }
    return false;
  }

  void cut(std::uint32_t i) {
    const std::uint32_t before = previous_[i], after = next_[i];
    if (corner_area(i) != 0) emit(before, i, after);
    if (reflex_[i]) reflex_[i] = 0, --reflex_count_;
    unlink(i);
    update(before);
    update(after);
    if (2 * reflex_count_ < built_for_ && built_for_ > 64) build_grid();
  }

  void emit(std::uint32_t a, std::uint32_t b, std::uint32_t c) { out_.insert(out_.end(), {a, b, c}); }

  std::vector<Vec2d> p_;
  std::vector<std::uint32_t>& out_;
  std::vector<std::uint32_t> next_, previous_;
  std::vector<char> reflex_;
  std::size_t left_ = 0, reflex_count_ = 0, built_for_ = 0;
  std::uint32_t start_ = 0;
  std::uint64_t steps_ = 0;
  Vec2d lo_, scale_;
  int size_ = 1;
  std::vector<std::uint32_t> first_, items_;  // items of cell k: items_[first_[k], first_[k + 1])
};

}  // namespace

bool triangulate(std::span<const Vec3f> corners, std::vector<std::uint32_t>& triangles) {
  const auto n = std::uint32_t(corners.size());
  const auto fan = [&] {
    for (std::uint32_t i = 2; i < n; ++i) triangles.insert(triangles.end(), {0, i - 1, i});
  };
  if (n < 3) return true;
  if (n == 3) return fan(), true;
  const Vec3d normal = vector_area(corners);
  if (n == 4) {  // either diagonal, as most faces of files that have no triangles
    const std::array<Vec3d, 4> p{Vec3d(corners[0]), Vec3d(corners[1]), Vec3d(corners[2]), Vec3d(corners[3])};
    const auto faces_up = [&](std::size_t a, std::size_t b, std::size_t c) {
      return dot(cross(p[b] - p[a], p[c] - p[a]), normal) > 0;
    };
    if (faces_up(0, 1, 2) && faces_up(0, 2, 3)) return fan(), true;
    if (faces_up(1, 2, 3) && faces_up(1, 3, 0)) {
      triangles.insert(triangles.end(), {1, 2, 3, 1, 3, 0});
      return true;
    }
  }
  if (!is_finite(normal) || normal == Vec3d{}) {
    // Everything on one line, or an outline that crosses itself so that its parts cancel out.
    fan();
    const Vec3d origin(corners[0]);
    for (std::uint32_t i = 2; i < n; ++i)
      if (cross(Vec3d(corners[i - 1]) - origin, Vec3d(corners[i]) - origin) != Vec3d{}) return false;
    return true;
  }
  std::vector<Vec2d> points = project(corners, normal);
  if (strictly_convex(points)) return fan(), true;
  return EarCutter(std::move(points), triangles).run();
}

bool PolygonMesher::add(std::span<const std::uint32_t> vertices) {
  if (vertices.size() <= 3) {
    if (vertices.size() == 3) mesh_.indices.insert(mesh_.indices.end(), vertices.begin(), vertices.end());
    return true;
  }
  corners_.clear();
  for (const std::uint32_t v : vertices) corners_.push_back(mesh_.positions[v]);
  triangles_.clear();
  const bool simple = triangulate(corners_, triangles_);
  for (const std::uint32_t corner : triangles_) mesh_.indices.push_back(vertices[corner]);
  return simple;
}

}  // namespace tempera
