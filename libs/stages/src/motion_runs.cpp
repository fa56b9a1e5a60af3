// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/motion_runs.h"

#include <algorithm>

#include "tempera/core/error.h"

namespace tempera {

PixelMap::PixelMap(int width, int height) : forward_(width, height, -1), backward_(width, height, -1) {}

bool PixelMap::link(int from_x, int from_y, int to_x, int to_y) {
  const auto inside = [&](int x, int y) { return x >= 0 && y >= 0 && x < width() && y < height(); };
  if (!inside(from_x, from_y) || !inside(to_x, to_y)) return false;
  std::int32_t &to = forward_.at(from_x, from_y), &from = backward_.at(to_x, to_y);
  if (to >= 0 || from >= 0) return false;
  to = std::int32_t(forward_.index(to_x, to_y)), from = std::int32_t(forward_.index(from_x, from_y));
  ++count_;
  return true;
}

MotionRuns::MotionRuns(const PixelMap& motion, const MotionRunOptions& options, const Grid<std::uint8_t>& sampled_next)
    : count_(motion.count()) {
  const int w = motion.width(), h = motion.height();
  TEMPERA_ASSERT(sampled_next.empty() || (sampled_next.width() == w && sampled_next.height() == h));
  const auto sampled = [&](int x, int y) { return sampled_next.empty() || sampled_next.at(x, y) != 0; };
  // [Manzi 2016, Eq. 3]: the mixed difference of i uses the neighbour of phi(i), not phi of the neighbour of i.
  const auto mixed = [&](int x, int y, const Vec2<int>& to, int ex, int ey) {
    if (!options.mixed || x + ex >= w || y + ey >= h || to.x + ex >= w || to.y + ey >= h) return false;
    if (!sampled(to.x + ex, to.y + ey)) return false;
    return !options.strict_mixed || motion.forward(x + ex, y + ey) == Vec2<int>{to.x + ex, to.y + ey};
  };
  from_begin_.push_back(0);
  all_mixed_ = true;
  for (int y = 0; y < h; ++y) {
    bool open = false;
    for (int x = 0; x < w; ++x) {
      const Vec2<int> to = motion.forward(x, y);
      if (to.x < 0) {
        open = false;
        continue;
      }
      const bool mx = mixed(x, y, to, 1, 0), my = mixed(x, y, to, 0, 1);
      all_mixed_ = all_mixed_ && mx == (x + 1 < w && to.x + 1 < w) && my == (y + 1 < h && to.y + 1 < h);
      if (open) {
        MotionRun& r = from_.back();
        // A pixel without a mixed difference to the right can only be the last one of its run, unless none has one.
        const bool fits = r.mixed_x == r.length || (r.mixed_x == 0 && !mx);
        open = to.x - x == r.dx && to.y - y == r.dy && my == r.mixed_y && fits && r.length < kMaxLength;
      }
      if (!open) from_.push_back({y, x, 0, to.x - x, to.y - y, 0, my});
      open = true;
      MotionRun& r = from_.back();
      ++r.length;
      r.mixed_x += mx;
    }
    from_begin_.push_back(std::uint32_t(from_.size()));
  }
  to_ = from_;
  std::sort(to_.begin(), to_.end(), [](const MotionRun& a, const MotionRun& b) {
    return a.y + a.dy != b.y + b.dy ? a.y + a.dy < b.y + b.dy : a.x + a.dx < b.x + b.dx;
  });
  to_begin_.assign(h + 1, 0);
  for (const MotionRun& r : to_) ++to_begin_[r.y + r.dy + 1];
  for (int y = 0; y < h; ++y) to_begin_[y + 1] += to_begin_[y];
  const bool still = std::all_of(from_.begin(), from_.end(), [](const MotionRun& r) { return r.dx == 0 && r.dy == 0; });
  identity_ = still && count_ == std::int64_t(w) * h;
}

}  // namespace tempera
