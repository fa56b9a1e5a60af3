// SPDX-License-Identifier: Apache-2.0
#include "poisson_rows.h"

#include "tempera/core/parallel.h"

namespace tempera {

FlatWindow::FlatWindow(std::span<const PoissonFrame* const> window)
    : width(window[0]->width()), height(window[0]->height()), frames(int(window.size())) {
  const std::size_t n = std::size_t(width) * height * frames;
  forward.assign(n, -1);
  backward.assign(n, -1);
  mixed.assign(n, 0);
  const auto number = [&](int t, int y, int x) { return (t * height + y) * width + x; };
  for (int t = 0; t + 1 < frames; ++t) {
    const MotionRuns& motion = window[t]->motion;
    for (int y = 0; y < height && motion.count() > 0; ++y) {
      for (const MotionRun& r : motion.from_row(y)) {
        for (int i = 0; i < r.length; ++i) {
          const int from = number(t, y, r.x + i), to = number(t + 1, y + r.dy, r.x + r.dx + i);
          forward[from] = to;
          backward[to] = from;
          mixed[from] = static_cast<unsigned char>((i < r.mixed_x ? 1 : 0) + (r.mixed_y ? 2 : 0));
        }
      }
    }
  }
  data.assign(3 * n * kRowSets, 0.0f);
  if (window[0]->has_precision()) precision.assign(n * kRowSets, 0.0f);
  const FlatRows flat = rows();
  parallel_for(0, std::int64_t(frames) * height, [&](std::int64_t line) {
    const int t = int(line / height), y = int(line % height);
    const PoissonFrame& f = *window[t];
    for (int s = 0; s < kRowSets; ++s) {
      const RowSet set{s};
      for (int x = 0; x < width; ++x) {
        const int g = number(t, y, x);
        const std::size_t row = s * n + g;
        if (!flat.exists(set, g)) continue;
        for (int c = 0; c < 3; ++c) data[3 * row + c] = f.data(set, y, c)[x];
        if (!precision.empty()) precision[row] = to_float(f.precision(set, y)[x]);
      }
    }
  });
}

}  // namespace tempera
