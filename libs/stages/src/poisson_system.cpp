// SPDX-License-Identifier: Apache-2.0
// The linear system of a window: its rows, which are never stored, and their weights.
#include <algorithm>
#include <bit>
#include <cmath>

#include "band_sums.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/poisson.h"

namespace tempera {
namespace {

// Where the weights and data of rows come from. `at(i)` counts from the pixel for which the object was made.
struct UniformWeight {
  float value;
  float at(int) const { return value; }
};
struct StoredWeight {
  const BFloat16* p;
  float at(int i) const { return to_float(p[i]); }
};
struct StoredPrecision {
  const Precision* p;
  float at(int i) const { return to_float(p[i]); }
};
struct NoData {
  static constexpr float at(int) { return 0; }
};
struct RowData {
  const float* p;
  float at(int i) const { return p[i]; }
};

BFloat16 to_bfloat16(float v) {
  const auto bits = std::bit_cast<std::uint32_t>(v);
  return BFloat16((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}

/// out = A^T W^2 (A x - b) of the primal and spatial rows for one row of pixels and one channel.
/// `up`, `down`: rows of x above and below; at the picture's border `mid` itself, where wy_up or wy is 0.
template <class W, class B>
void spatial_row(int n, const float* __restrict up, const float* __restrict mid, const float* __restrict down, W wp,
                 W wx, W wy_up, W wy, B bp, B bx, B by_up, B by, float* __restrict out) {
  const auto right = [&](int i) { return wx.at(i) * ((mid[i + 1] - mid[i]) - bx.at(i)); };
  const auto rest = [&](int i) {
    return wp.at(i) * (mid[i] - bp.at(i)) + wy_up.at(i) * ((mid[i] - up[i]) - by_up.at(i)) -
           wy.at(i) * ((down[i] - mid[i]) - by.at(i));
  };
  if (n == 1) {
    out[0] = rest(0);
    return;
  }
  out[0] = rest(0) - right(0);
  for (int i = 1; i < n - 1; ++i) out[i] = rest(i) + right(i - 1) - right(i);
  out[n - 1] = rest(n - 1) + right(n - 2);
}

/// A run in one channel: rows of x from its first pixel on, at frame t (p) and t + 1 (q), and the rows below each.
struct RunRows {
  const float *p, *q, *p_below, *q_below;
  int length, mixed_x;
  bool mixed_y;
};

/// Adds `kSign` times the part of A^T W^2 (A x - b) that the temporal and mixed rows of a run have in its own pixels:
/// both frames get it, with opposite signs.
template <int kSign, bool kMixedY, class W, class B>
void run_row(const RunRows& r, W wt, W wx, W wy, B bt, B bx, B by, float* __restrict out) {
  const float* __restrict p = r.p, * __restrict q = r.q;
  const float* __restrict p_below = r.p_below, * __restrict q_below = r.q_below;
  const auto change = [&](int i) { return q[i] - p[i]; };
  const auto right = [&](int i) { return wx.at(i) * ((change(i + 1) - change(i)) - bx.at(i)); };
  const auto rest = [&](int i) {
    const float own = wt.at(i) * (change(i) - bt.at(i));
    if constexpr (!kMixedY) return own;
    return own - wy.at(i) * (((q_below[i] - p_below[i]) - change(i)) - by.at(i));
  };
  const auto add = [&](int i, float v) { kSign > 0 ? out[i] += v : out[i] -= v; };
  const int n = r.length, m = r.mixed_x;
  add(0, m > 0 ? rest(0) - right(0) : rest(0));
  for (int i = 1; i < m; ++i) add(i, rest(i) + right(i - 1) - right(i));
  if (m > 0) add(m, m < n ? rest(m) + right(m - 1) : right(m - 1));
  for (int i = m + 1; i < n; ++i) add(i, rest(i));
}

/// As run_row, for the row of pixels below the run, which its mixed rows in y reach.
template <int kSign, class W, class B>
void run_row_below(const RunRows& r, W wy, B by, float* __restrict out) {
  const float* __restrict p = r.p, * __restrict q = r.q;
  const float* __restrict p_below = r.p_below, * __restrict q_below = r.q_below;
  for (int i = 0; i < r.length; ++i) {
    const float v = wy.at(i) * (((q_below[i] - p_below[i]) - (q[i] - p[i])) - by.at(i));
    kSign > 0 ? out[i] += v : out[i] -= v;
  }
}

/// Adds sum(a b) and sum(b b d), d = 1 if null. Single-precision sums of a row's lanes, double ones of rows: the order
/// is fixed.
void add_dots(const float* __restrict a, const float* __restrict b, const float* __restrict d, int stride, double& ab,
              double& bbd) {
  float s[kSumLanes] = {}, q[kSumLanes] = {};
  const auto sum = [&](const auto& square) {
    for (int i = 0; i < stride; i += kSumLanes) {
      for (int l = 0; l < kSumLanes; ++l) {
        s[l] += a[i + l] * b[i + l];
        q[l] += square(i + l);
      }
    }
  };
  if (d) {
    sum([=](int i) { return b[i] * b[i] * d[i]; });
  } else {
    sum([=](int i) { return b[i] * b[i]; });
  }
  for (int l = 0; l < kSumLanes; ++l) ab += double(s[l]), bbd += double(q[l]);
}

void negate(float* a, int n) {
  for (int i = 0; i < n; ++i) a[i] = -a[i];
}

}  // namespace

Precision to_precision(float v) {
  if (!(v > 0)) return {};
  const std::uint32_t rounded = (std::bit_cast<std::uint32_t>(v) + (1u << 18)) >> 19;
  return {std::uint8_t(std::clamp(rounded, Precision::kBase + 1, Precision::kBase + 255) - Precision::kBase)};
}

void PoissonFrame::set_precision(RowSet set, int y, std::span<const float> values) {
  if (!has_precision()) precision_ = RowBlock<Precision>(width(), std::int64_t(kRowSets) * height_);
  std::transform(values.begin(), values.end(), precision_.row(row_of(set, y)), to_precision);
}

PoissonSystem::PoissonSystem(std::span<const PoissonFrame* const> window, const PoissonWeights& weights)
    : window_(window.begin(), window.end()), weights_(weights) {
  TEMPERA_ASSERT(!window_.empty());
}

template <bool kStored, bool kData>
void PoissonSystem::descend(const PlanarFrames& x, PlanarFrames& out, ChannelSums& x_out, ChannelSums& out_out) const {
  using W = std::conditional_t<kStored, StoredWeight, UniformWeight>;
  using B = std::conditional_t<kData, RowData, NoData>;
  const int w = width(), h = height(), frames = this->frames();
  const auto weight = [&](RowSet set, int t, int y, int i) -> W {
    if constexpr (kStored) {
      return {squared_row(set, t, y) + i};
    } else {
      const float v = weights_.of(set);
      return {v * v};
    }
  };
  const auto datum = [&](RowSet set, int t, int y, int c, int i) -> B {
    if constexpr (kData) return {window_[t]->data(set, y, c) + i};
    return {};
  };
  // Weights of the rows above the first and below the last row of pixels.
  const std::vector<std::uint16_t> none(kStored ? w : 0);
  const auto no_weight = [&]() -> W {
    if constexpr (kStored) return {none.data()};
    return {};
  };
  const auto rows_of = [&](const MotionRun& r, int t, int c) -> RunRows {
    const int yq = r.y + r.dy, xq = r.x + r.dx;
    const float *p = x.row(t, r.y, c) + r.x, *q = x.row(t + 1, yq, c) + xq;
    const bool below = r.mixed_y;
    return {p,         q,    below ? x.row(t, r.y + 1, c) + r.x : p, below ? x.row(t + 1, yq + 1, c) + xq : q, r.length,
            r.mixed_x, below};
  };
  // The run's own pixels, in frame t (kSign < 0) or t + 1.
  const auto add_run = [&]<int kSign>(const MotionRun& r, int t, std::integral_constant<int, kSign>) {
    for (int c = 0; c < 3; ++c) {
      float* to = kSign < 0 ? out.row(t, r.y, c) + r.x : out.row(t + 1, r.y + r.dy, c) + r.x + r.dx;
      const auto add = [&]<bool kMixedY>(std::bool_constant<kMixedY>) {
        run_row<kSign, kMixedY>(rows_of(r, t, c), weight(RowSet::kDt, t, r.y, r.x), weight(RowSet::kDxDt, t, r.y, r.x),
                                weight(RowSet::kDyDt, t, r.y, r.x), datum(RowSet::kDt, t, r.y, c, r.x),
                                datum(RowSet::kDxDt, t, r.y, c, r.x), datum(RowSet::kDyDt, t, r.y, c, r.x), to);
      };
      r.mixed_y ? add(std::true_type()) : add(std::false_type());
    }
  };
  const auto add_run_below = [&]<int kSign>(const MotionRun& r, int t, std::integral_constant<int, kSign>) {
    if (!r.mixed_y) return;
    for (int c = 0; c < 3; ++c) {
      float* to = kSign < 0 ? out.row(t, r.y + 1, c) + r.x : out.row(t + 1, r.y + r.dy + 1, c) + r.x + r.dx;
      run_row_below<kSign>(rows_of(r, t, c), weight(RowSet::kDyDt, t, r.y, r.x), datum(RowSet::kDyDt, t, r.y, c, r.x),
                           to);
    }
  };
  constexpr std::integral_constant<int, -1> kMinus;
  constexpr std::integral_constant<int, 1> kPlus;

  // Gathered row by row: each row of pixels is written once, by one thread, from what reaches it. Scattering by pairs
  // of frames would save arithmetic and cost three passes over memory.
  BandSums<std::array<double, 6>> sums(h);
  sums.for_each(h, [&](std::int64_t band, int y0, int y1) {
    std::array<double, 6> sum{};
    for (int t = 0; t < frames; ++t) {
      const MotionRuns *next = motion_from(t), *last = motion_from(t - 1);
      for (int y = y0; y < y1; ++y) {
        const bool has_up = y > 0, has_down = y + 1 < h;
        for (int c = 0; c < 3; ++c) {
          const float* mid = x.row(t, y, c);
          const auto at = [&](RowSet set) { return weight(set, t, y, 0); };
          const auto b = [&](RowSet set, int row) { return datum(set, t, row, c, 0); };
          // Rows that do not exist have no weight, and data that are finite at least.
          spatial_row(w, has_up ? x.row(t, y - 1, c) : mid, mid, has_down ? x.row(t, y + 1, c) : mid,
                      at(RowSet::kPrimal), at(RowSet::kDx), has_up ? weight(RowSet::kDy, t, y - 1, 0) : no_weight(),
                      has_down ? at(RowSet::kDy) : no_weight(), b(RowSet::kPrimal, y), b(RowSet::kDx, y),
                      has_up ? b(RowSet::kDy, y - 1) : b(RowSet::kPrimal, y),
                      has_down ? b(RowSet::kDy, y) : b(RowSet::kPrimal, y), out.row(t, y, c));
        }
        if (next) {
          for (const MotionRun& r : next->from_row(y)) add_run(r, t, kMinus);
          if (has_up) {
            for (const MotionRun& r : next->from_row(y - 1)) add_run_below(r, t, kMinus);
          }
        }
        if (last) {
          for (const MotionRun& r : last->to_row(y)) add_run(r, t - 1, kPlus);
          if (has_up) {
            for (const MotionRun& r : last->to_row(y - 1)) add_run_below(r, t - 1, kPlus);
          }
        }
        for (int c = 0; c < 3; ++c) {
          float* o = out.row(t, y, c);
          if constexpr (kData) negate(o, w);
          add_dots(x.row(t, y, c), o, inverse_diagonal(t, y), out.stride(), sum[c], sum[c + 3]);
        }
      }
    }
    sums[band] = sum;
  });
  const auto total = sums.total();
  for (std::size_t c = 0; c < 3; ++c) x_out[c] = total[c], out_out[c] = total[c + 3];
}

void PoissonSystem::apply(const PlanarFrames& p, PlanarFrames& out, ChannelSums& p_out, ChannelSums& out_out) const {
  stored_ ? descend<true, false>(p, out, p_out, out_out) : descend<false, false>(p, out, p_out, out_out);
}

ChannelSums PoissonSystem::descent(const PlanarFrames& x, PlanarFrames& out) const {
  ChannelSums x_out{}, out_out{};
  stored_ ? descend<true, true>(x, out, x_out, out_out) : descend<false, true>(x, out, x_out, out_out);
  return out_out;
}

void PoissonSystem::set_precise() {
  const int w = width(), h = height(), frames = this->frames();
  store_weights();
  parallel_for(0, std::int64_t(frames) * h, [&](std::int64_t row) {
    for (int set = 0; set < kRowSets; ++set) {
      const StoredPrecision precision{window_[row / h]->precision(RowSet(set), int(row % h))};
      const float w0 = weights_.of(RowSet(set));
      BFloat16* out = squared_.row(row * kRowSets + set);
      for (int i = 0; i < w; ++i) out[i] = to_bfloat16(w0 * w0 * precision.at(i));
    }
  });
  invert_diagonal();
}

void PoissonSystem::store_weights() {
  if (squared_.rows() == 0) {
    const std::int64_t rows = std::int64_t(height()) * frames();
    squared_ = RowBlock<BFloat16>(width(), kRowSets * rows);
    inverse_diagonal_ = RowBlock<float>(width(), rows);
  }
  stored_ = true;
}

void PoissonSystem::invert_diagonal() {
  const int w = width(), h = height(), frames = this->frames();
  const auto weight = [&](RowSet set, int t, int y, int x) -> StoredWeight { return {squared_row(set, t, y) + x}; };
  // Squared coefficients are 1: each row adds its squared weight to the pixels that it reaches.
  const auto add_run = [&](const MotionRun& r, int t, float* __restrict out) {
    const StoredWeight wt = weight(RowSet::kDt, t, r.y, r.x), wx = weight(RowSet::kDxDt, t, r.y, r.x);
    for (int i = 0; i < r.length; ++i) out[i] += wt.at(i);
    for (int i = 0; i < r.mixed_x; ++i) out[i] += wx.at(i);
    for (int i = 0; i < r.mixed_x; ++i) out[i + 1] += wx.at(i);
  };
  const auto add_mixed_y = [&](const MotionRun& r, int t, float* __restrict out) {
    if (!r.mixed_y) return;
    const StoredWeight wy = weight(RowSet::kDyDt, t, r.y, r.x);
    for (int i = 0; i < r.length; ++i) out[i] += wy.at(i);
  };
  parallel_for(
      0, std::int64_t(frames) * h,
      [&](std::int64_t row) {
        const int t = int(row / h), y = int(row % h);
        const MotionRuns *next = motion_from(t), *last = motion_from(t - 1);
        float* const out = inverse_diagonal_.row(row);
        const StoredWeight wp = weight(RowSet::kPrimal, t, y, 0), wx = weight(RowSet::kDx, t, y, 0);
        for (int i = 0; i < w; ++i) out[i] = wp.at(i);
        for (int i = 0; i + 1 < w; ++i) out[i] += wx.at(i);
        for (int i = 1; i < w; ++i) out[i] += wx.at(i - 1);
        for (const int above : {y - 1, y}) {
          if (above < 0) continue;
          if (above + 1 < h) {
            const StoredWeight wy = weight(RowSet::kDy, t, above, 0);
            for (int i = 0; i < w; ++i) out[i] += wy.at(i);
          }
          if (next) {
            for (const MotionRun& r : next->from_row(above)) add_mixed_y(r, t, out + r.x);
          }
          if (last) {
            for (const MotionRun& r : last->to_row(above)) add_mixed_y(r, t - 1, out + r.x + r.dx);
          }
        }
        if (next) {
          for (const MotionRun& r : next->from_row(y)) add_run(r, t, out + r.x);
        }
        if (last) {
          for (const MotionRun& r : last->to_row(y)) add_run(r, t - 1, out + r.x + r.dx);
        }
        for (int i = 0; i < w; ++i) out[i] = 1 / out[i];
      },
      kBand);
}

double PoissonSystem::reweight(const PlanarFrames& x, double epsilon, double scale) {
  const int w = width(), h = height(), frames = this->frames();
  store_weights();
  const float eps = float(epsilon);
  BandSums<std::array<double, 1>> sums(h);
  sums.for_each(h, [&](std::int64_t band, int y0, int y1) {
    double total = 0;
    // Weights of `n` rows of `set` from pixel i0 on; residual(c, i) is A x - b without a weight.
    const auto for_each_residual = [&](RowSet set, int t, int y, int i0, int n, const auto& residual) {
      BFloat16* out = squared_row(set, t, y) + i0;
      const PoissonFrame& f = *window_[t];
      const StoredPrecision precision{f.has_precision() ? f.precision(set, y) + i0 : nullptr};
      const float uniform = weights_.of(set) * weights_.of(set), top = float(scale);
      constexpr int kChunk = 256;
      float norm[kChunk], square[kChunk];
      for (int begin = 0; begin < n; begin += kChunk) {
        const int m = std::min(kChunk, n - begin);
        for (int k = 0; k < m; ++k) square[k] = uniform;
        if (precision.p) {
          for (int k = 0; k < m; ++k) square[k] *= precision.at(begin + k);
        }
        for (int k = 0; k < m; ++k) {
          const int i = begin + k;
          const float a = residual(0, i), b = residual(1, i), c = residual(2, i);
          norm[k] = std::sqrt(square[k] * (a * a + b * b + c * c));
          out[i] = to_bfloat16(top * square[k] / (norm[k] + eps));
        }
        float lane[kSumLanes] = {};
        int k = 0;
        for (; k + kSumLanes <= m; k += kSumLanes) {
          for (int l = 0; l < kSumLanes; ++l) lane[l] += norm[k + l];
        }
        for (; k < m; ++k) lane[k % kSumLanes] += norm[k];
        for (const float v : lane) total += double(v);
      }
    };
    for (int t = 0; t < frames; ++t) {
      const PoissonFrame& f = *window_[t];
      for (int y = y0; y < y1; ++y) {
        std::array<const float*, 3> mid, down, bp, bx, by;
        for (int c = 0; c < 3; ++c) {
          mid[c] = x.row(t, y, c), down[c] = x.row(t, y + 1 < h ? y + 1 : y, c);
          bp[c] = f.data(RowSet::kPrimal, y, c), bx[c] = f.data(RowSet::kDx, y, c), by[c] = f.data(RowSet::kDy, y, c);
        }
        for_each_residual(RowSet::kPrimal, t, y, 0, w, [=](int c, int i) { return mid[c][i] - bp[c][i]; });
        for_each_residual(RowSet::kDx, t, y, 0, w - 1,
                          [=](int c, int i) { return (mid[c][i + 1] - mid[c][i]) - bx[c][i]; });
        if (y + 1 < h)
          for_each_residual(RowSet::kDy, t, y, 0, w, [=](int c, int i) { return (down[c][i] - mid[c][i]) - by[c][i]; });
        const MotionRuns* next = motion_from(t);
        if (!next) continue;
        for (const MotionRun& r : next->from_row(y)) {
          std::array<const float*, 3> p, q, p_below, q_below, bt, bxt, byt;
          for (int c = 0; c < 3; ++c) {
            const int yq = r.y + r.dy, xq = r.x + r.dx;
            p[c] = x.row(t, y, c) + r.x, q[c] = x.row(t + 1, yq, c) + xq;
            p_below[c] = r.mixed_y ? x.row(t, y + 1, c) + r.x : p[c];
            q_below[c] = r.mixed_y ? x.row(t + 1, yq + 1, c) + xq : q[c];
            bt[c] = f.data(RowSet::kDt, y, c) + r.x;
            bxt[c] = f.data(RowSet::kDxDt, y, c) + r.x, byt[c] = f.data(RowSet::kDyDt, y, c) + r.x;
          }
          for_each_residual(RowSet::kDt, t, y, r.x, r.length,
                            [=](int c, int i) { return (q[c][i] - p[c][i]) - bt[c][i]; });
          for_each_residual(RowSet::kDxDt, t, y, r.x, r.mixed_x, [=](int c, int i) {
            return ((q[c][i + 1] - p[c][i + 1]) - (q[c][i] - p[c][i])) - bxt[c][i];
          });
          if (!r.mixed_y) continue;
          for_each_residual(RowSet::kDyDt, t, y, r.x, r.length, [=](int c, int i) {
            return ((q_below[c][i] - p_below[c][i]) - (q[c][i] - p[c][i])) - byt[c][i];
          });
        }
      }
    }
    sums[band] = {total};
  });
  invert_diagonal();
  return sums.total()[0];
}

float PoissonSystem::squared_weight(RowSet set, int t, int x, int y) const {
  if (!stored_) return weights_.of(set) * weights_.of(set);
  return StoredWeight{squared_row(set, t, y)}.at(x);
}

const MotionRuns* PoissonSystem::motion_from(int t) const {
  const bool pair = linked_ && t >= 0 && t + 1 < frames();
  return pair && window_[t]->motion.count() > 0 ? &window_[t]->motion : nullptr;
}

bool PoissonSystem::is_separable() const {
  return !linked_ || std::all_of(window_.begin(), window_.end() - 1, [&](const PoissonFrame* f) {
    return f->motion.is_identity() && (f->motion.has_all_mixed() || weights_.mixed == 0);
  });
}

}  // namespace tempera
