// SPDX-License-Identifier: Apache-2.0
#include "denoise/tracks.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "tempera/core/fast_math.h"

namespace tempera::denoise {

namespace {

constexpr float kLog2E = 1.44269504f;

}  // namespace

Track follow(int from, int to, const std::function<const Surfaces&(int)>& surfaces) {
  const int step = to > from ? 1 : -1;
  const Surfaces& first = surfaces(from);
  const auto vectors = [&](const Surfaces& s, bool onward) -> const Planes& {
    return (step > 0) == onward ? s.forward : s.backward;
  };
  if (vectors(first, true).empty()) return {};
  const int width = first.forward.empty() ? first.backward.width() : first.forward.width();
  const int height = first.forward.empty() ? first.backward.height() : first.forward.height();
  Track track{Planes(width, height, 2), Planes(width, height, 1, 1)};
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) track.place.row(0, y)[x] = float(x), track.place.row(1, y)[x] = float(y);
  });
  for (int f = from; f != to; f += step) {
    const Surfaces &here = surfaces(f), &there = surfaces(f + step);
    const Planes& onward = vectors(here, true);
    const Planes& back = vectors(there, false);
    if (onward.empty()) return {};
    for_rows(height, [&](int y) {
      float *px = track.place.row(0, y), *py = track.place.row(1, y), *valid = track.valid.row(0, y);
      for (int x = 0; x < width; ++x) {
        if (valid[x] == 0) continue;
        const int ix = int(px[x] + 0.5f), iy = int(py[x] + 0.5f);
        const float mx = onward.row(0, iy)[ix], my = onward.row(1, iy)[ix];
        const float nx = px[x] + mx, ny = py[x] + my;
        bool ok = nx >= 0 && ny >= 0 && nx <= float(width - 1) && ny <= float(height - 1);
        if (ok) {
          const int jx = int(nx + 0.5f), jy = int(ny + 0.5f);
          if (!there.id.empty() && !first.id.empty()) ok = there.id.row(0, jy)[jx] == first.id.row(0, y)[x];
          if (ok && !back.empty()) {
            const float bx = back.row(0, jy)[jx], by = back.row(1, jy)[jx];
            const float gap = (mx + bx) * (mx + bx) + (my + by) * (my + by);
            ok = gap <= 0.01f * (mx * mx + my * my + bx * bx + by * by) + 0.5f;
          }
          if (ok && !there.normal.empty() && !first.normal.empty()) {
            float product = 0, square = 0;
            for (int c = 0; c < 3; ++c) {
              const float n = first.normal.at(c, y, x);
              product += n * there.normal.at(c, jy, jx), square += n * n;
            }
            ok = square == 0 || product > 0.8f * square;
          }
        }
        px[x] = ok ? nx : 0, py[x] = ok ? ny : 0, valid[x] = ok ? 1.0f : 0.0f;
      }
    });
  }
  return track;
}

Planes gather_nearest(const Planes& in, const Track& track) {
  Planes out(in.width(), in.height(), in.channels());
  for_rows(in.height(), [&](int y) {
    const float *px = track.place.row(0, y), *py = track.place.row(1, y), *valid = track.valid.row(0, y);
    for (int c = 0; c < in.channels(); ++c) {
      const float* from = in.plane(c);
      float* to = out.row(c, y);
      for (int x = 0; x < in.width(); ++x) {
        to[x] = valid[x] * from[std::size_t(int(py[x] + 0.5f)) * std::size_t(in.width()) + std::size_t(px[x] + 0.5f)];
      }
    }
  });
  return out;
}

Planes gather_nearest(const PackedPlanes& in, const Track& track) {
  Planes out(in.width(), in.height(), in.channels());
  for_rows(in.height(), [&](int y) {
    const float *px = track.place.row(0, y), *py = track.place.row(1, y), *valid = track.valid.row(0, y);
    for (int c = 0; c < in.channels(); ++c) {
      float* to = out.row(c, y);
      for (int x = 0; x < in.width(); ++x) to[x] = valid[x] * in.at(c, int(py[x] + 0.5f), int(px[x] + 0.5f));
    }
  });
  return out;
}

Planes gather_smooth(const Planes& in, const Track& track) {
  const int width = in.width(), height = in.height();
  Planes out(width, height, in.channels());
  const auto weights = [](float f, float* w) {  // Catmull-Rom
    w[0] = ((-0.5f * f + 1) * f - 0.5f) * f;
    w[1] = (1.5f * f - 2.5f) * f * f + 1;
    w[2] = ((-1.5f * f + 2) * f + 0.5f) * f;
    w[3] = (0.5f * f - 0.5f) * f * f;
  };
  for_rows(height, [&](int y) {
    const float *px = track.place.row(0, y), *py = track.place.row(1, y), *valid = track.valid.row(0, y);
    for (int x = 0; x < width; ++x) {
      if (valid[x] == 0) continue;
      const int x0 = int(px[x]), y0 = int(py[x]);
      float wx[4], wy[4];
      weights(px[x] - float(x0), wx), weights(py[x] - float(y0), wy);
      int at[4];
      for (int i = 0; i < 4; ++i) at[i] = std::clamp(x0 + i - 1, 0, width - 1);
      for (int c = 0; c < in.channels(); ++c) {
        float sum = 0;
        for (int j = 0; j < 4; ++j) {
          const float* from = in.row(c, std::clamp(y0 + j - 1, 0, height - 1));
          sum += wy[j] * (wx[0] * from[at[0]] + wx[1] * from[at[1]] + wx[2] * from[at[2]] + wx[3] * from[at[3]]);
        }
        out.row(c, y)[x] = sum;
      }
    }
  });
  return out;
}

Planes likeness_weights(const Planes& here, const Planes& here_variance, const Planes& there,
                        const Planes& there_variance, const Planes& valid, const Likeness& likeness) {
  const int width = here.width(), height = here.height();
  Planes distance(width, height, 2);  // and the share that is valid
  const float k2 = likeness.k * likeness.k;
  for_rows(height, [&](int y) {
    float *d = distance.row(0, y), *share = distance.row(1, y);
    const float *vh = here_variance.row(0, y), *vt = there_variance.row(0, y), *ok = valid.row(0, y);
    const float *h0 = here.row(0, y), *h1 = here.row(1, y), *h2 = here.row(2, y);
    const float *t0 = there.row(0, y), *t1 = there.row(1, y), *t2 = there.row(2, y);
    for (int x = 0; x < width; ++x) {
      const float a = t0[x] - h0[x], b = t1[x] - h1[x], c = t2[x] - h2[x];
      const float mean = (h0[x] + h1[x] + h2[x]) * (1 / 3.0f);
      // [Rousselle 2013], the channels' differences averaged
      const float num = (a * a + b * b + c * c) * (1 / 3.0f) - (vh[x] + std::min(vh[x], vt[x]));
      const float den = likeness.floor + likeness.relative * mean * mean + k2 * (vh[x] + vt[x]);
      d[x] = ok[x] * std::min(num / den, 1e6f);
      share[x] = ok[x];
    }
  });
  const Planes mean = box_mean(distance, likeness.radius);
  const bool wide = likeness.wide_k > 0;
  const Planes wide_mean = wide ? box_mean(distance, likeness.wide_radius) : Planes();
  const float wide_scale = wide ? k2 / (likeness.wide_k * likeness.wide_k) : 0;
  Planes out(width, height, 1);
  for_rows(height, [&](int y) {
    float* w = out.row(0, y);
    const float *d = mean.row(0, y), *share = mean.row(1, y), *ok = valid.row(0, y);
    for (int x = 0; x < width; ++x) {
      float distance_here = std::max(0.0f, d[x] / std::max(share[x], 1e-3f));
      if (wide) {
        const float around = wide_mean.row(0, y)[x] / std::max(wide_mean.row(1, y)[x], 1e-3f);
        distance_here = std::max(distance_here, wide_scale * around);
      }
      w[x] = ok[x] * exp2_fast(-kLog2E * std::min(distance_here, 80.0f));
    }
  });
  return out;
}

void add_weighted(const Planes& value, const Planes& weight, Planes& sum) {
  for_rows(sum.height(), [&](int y) {
    const float* w = weight.row(0, y);
    for (int c = 0; c < sum.channels(); ++c) {
      const float* from = value.row(c, y);
      float* to = sum.row(c, y);
      for (int x = 0; x < sum.width(); ++x) to[x] += w[x] * from[x];
    }
  });
}

void divide(Planes& sum, const Planes& by) {
  for_rows(sum.height(), [&](int y) {
    const float* d = by.row(0, y);
    for (int c = 0; c < sum.channels(); ++c) {
      float* to = sum.row(c, y);
      for (int x = 0; x < sum.width(); ++x) to[x] /= d[x];
    }
  });
}

}  // namespace tempera::denoise
