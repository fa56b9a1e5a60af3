// SPDX-License-Identifier: Apache-2.0
// Solving the system of a window: exactly where it is separable, by conjugate gradients, by rounds of reweighting.
#include "tempera/stages/poisson.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "band_sums.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"
#include "tempera/core/vec.h"
#include "tempera/stages/cosine_transform.h"
#ifdef TEMPERA_CUDA
#include "poisson_cuda.h"
#endif

namespace tempera {
namespace {

/// Transforms the rows of all planes in place.
void transform_rows(PlanarFrames& x, const CosineTransform& transform, bool forward) {
  const int w = x.width(), h = x.height(), blocks = (h + CosineTransform::kLanes - 1) / CosineTransform::kLanes;
  constexpr int kLanes = CosineTransform::kLanes;
  parallel_for(0, std::int64_t(x.frames()) * 3 * blocks, [&](std::int64_t task) {
    const int t = int(task / (3 * blocks)), c = int(task / blocks % 3), y0 = int(task % blocks) * kLanes;
    const int n = std::min(kLanes, h - y0);
    RowBlock<float> lanes(w * kLanes, 1);
    float* data = lanes.row(0);
    CosineTransform::Scratch scratch;
    for (int l = 0; l < n; ++l) {
      const float* row = x.row(t, y0 + l, c);
      for (int i = 0; i < w; ++i) data[i * kLanes + l] = row[i];
    }
    forward ? transform.forward(data, scratch) : transform.inverse(data, scratch);
    for (int l = 0; l < n; ++l) {
      float* row = x.row(t, y0 + l, c);
      for (int i = 0; i < w; ++i) row[i] = data[i * kLanes + l];
    }
  });
}

/// Divides by the eigenvalues of A^T A, where the rows are already transformed. `linked`: whether rows between frames
/// count.
void divide_columns(PlanarFrames& x, const PoissonWeights& weights, bool linked) {
  const int w = x.width(), h = x.height(), frames = x.frames();
  constexpr int kLanes = CosineTransform::kLanes;
  const CosineTransform in_y(h), in_t(frames);
  const auto eigenvalue = [](int k, int n) { return 2 - 2 * std::cos(kPiD * k / n); };  // of differences, free ends
  const double a2 = double(weights.alpha) * weights.alpha, s2 = double(weights.spatial) * weights.spatial;
  linked = linked && frames > 1;
  const double t2 = double(weights.temporal) * weights.temporal, m2 = double(weights.mixed) * weights.mixed;
  const int blocks = (w + kLanes - 1) / kLanes;
  parallel_for(0, 3 * std::int64_t(blocks), [&](std::int64_t task) {
    const int c = int(task / blocks), x0 = int(task % blocks) * kLanes;
    const int n = std::min(kLanes, w - x0);
    RowBlock<float> columns(h * kLanes, frames), line(frames * kLanes, 1);
    CosineTransform::Scratch scratch;
    for (int t = 0; t < frames; ++t) {
      for (int y = 0; y < h; ++y) std::copy_n(x.row(t, y, c) + x0, n, columns.row(t) + y * kLanes);
      in_y.forward(columns.row(t), scratch);
    }
    for (int y = 0; y < h; ++y) {
      for (int t = 0; t < frames; ++t) std::copy_n(columns.row(t) + y * kLanes, kLanes, line.row(0) + t * kLanes);
      if (linked) in_t.forward(line.row(0), scratch);
      for (int t = 0; t < frames; ++t) {
        for (int l = 0; l < kLanes; ++l) {
          const double mu = eigenvalue(x0 + l, w) + eigenvalue(y, h), theta = linked ? eigenvalue(t, frames) : 0;
          line.row(0)[t * kLanes + l] *= float(1 / (a2 + s2 * mu + theta * (t2 + m2 * mu)));
        }
      }
      if (linked) in_t.inverse(line.row(0), scratch);
      for (int t = 0; t < frames; ++t) std::copy_n(line.row(0) + t * kLanes, kLanes, columns.row(t) + y * kLanes);
    }
    for (int t = 0; t < frames; ++t) {
      in_y.inverse(columns.row(t), scratch);
      for (int y = 0; y < h; ++y) std::copy_n(columns.row(t) + y * kLanes, n, x.row(t, y, c) + x0);
    }
  });
}

/// The solution of a separable system with uniform weights, from any x; r is working memory.
void solve_separable(const PoissonSystem& system, PlanarFrames& r, PlanarFrames& x) {
  system.descent(x, r);
  const CosineTransform in_x(r.width());
  transform_rows(r, in_x, true);
  divide_columns(r, system.weights(), system.linked());
  transform_rows(r, in_x, false);
  parallel_rows(0, r.height(), [&](int y) {
    for (int t = 0; t < r.frames(); ++t) {
      for (int c = 0; c < 3; ++c) {
        const float* from = r.row(t, y, c);
        float* to = x.row(t, y, c);
        for (int i = 0; i < r.width(); ++i) to[i] += from[i];
      }
    }
  });
}

/// x += alpha p, r -= alpha q, p = r / D + beta p. Returns sum(r r / D).
ChannelSums advance(const PoissonSystem& system, PlanarFrames& x, PlanarFrames& r, PlanarFrames& p,
                    const PlanarFrames& q, const ChannelSums& alpha, const ChannelSums& beta) {
  const int h = x.height(), n = x.stride();
  BandSums<ChannelSums> sums(h);
  sums.for_each(h, [&](std::int64_t band, int y0, int y1) {
    ChannelSums sum{};
    for (int t = 0; t < x.frames(); ++t) {
      for (int y = y0; y < y1; ++y) {
        const float* __restrict d = system.inverse_diagonal(t, y);
        for (int c = 0; c < 3; ++c) {
          const float a = float(alpha[c]), b = float(beta[c]);
          float* __restrict xs = x.row(t, y, c), * __restrict rs = r.row(t, y, c), * __restrict ps = p.row(t, y, c);
          const float* __restrict qs = q.row(t, y, c);
          float lane[kSumLanes] = {};
          const auto run = [&](const auto& preconditioned) {
            for (int i = 0; i < n; i += kSumLanes) {
              for (int l = 0; l < kSumLanes; ++l) {
                const int k = i + l;
                xs[k] += a * ps[k];
                const float v = rs[k] - a * qs[k], z = preconditioned(v, k);
                rs[k] = v;
                ps[k] = z + b * ps[k];
                lane[l] += v * z;
              }
            }
          };
          if (d) {
            run([=](float v, int k) { return v * d[k]; });
          } else {
            run([](float v, int) { return v; });
          }
          for (const float v : lane) sum[c] += double(v);
        }
      }
    }
    sums[band] = sum;
  });
  return sums.total();
}

/// Vectors of conjugate gradients, kept from round to round.
struct Vectors {
  PlanarFrames r, p, q;
};

/// Takes up to `steps` steps from x. Returns those taken; `residual` is what is left of |A^T W^2 (A x - b)|, in the
/// norm of the inverse preconditioner. Source: [Hestenes 1952], one scalar a channel; beta comes from a prediction of
/// the next residual's norm, so that one pass updates all vectors, and the norm is then computed afresh, which keeps
/// the method stable [Chen 2020].
int conjugate_gradients(const PoissonSystem& system, int steps, PlanarFrames& x, Vectors& v, double& residual,
                        const std::function<void()>& before_step) {
  ChannelSums norm = system.descent(x, v.r);
  const ChannelSums start = norm;
  parallel_rows(0, x.height(), [&](int y) {
    for (int t = 0; t < x.frames(); ++t) {
      const float* d = system.inverse_diagonal(t, y);
      for (int c = 0; c < 3; ++c) {
        const float* r = v.r.row(t, y, c);
        float* p = v.p.row(t, y, c);
        for (int i = 0; i < x.width(); ++i) p[i] = d ? r[i] * d[i] : r[i];
      }
    }
  });
  constexpr double kConverged = 1e-14;  // of squared norms: the limit of single precision
  int taken = 0;
  for (; taken < steps; ++taken) {
    bool active = false;
    for (std::size_t c = 0; c < 3; ++c) active = active || norm[c] > kConverged * start[c];
    if (!active) break;
    before_step();
    ChannelSums pq{}, qq{}, alpha{}, beta{};
    system.apply(v.p, v.q, pq, qq);
    for (std::size_t c = 0; c < 3; ++c) {
      if (!(norm[c] > kConverged * start[c]) || !(pq[c] > 0)) continue;
      alpha[c] = norm[c] / pq[c];
      beta[c] = std::max(0.0, alpha[c] * alpha[c] * qq[c] - norm[c]) / norm[c];
    }
    norm = advance(system, x, v.r, v.p, v.q, alpha, beta);
  }
  double now = 0, then = 0;
  for (std::size_t c = 0; c < 3; ++c) now += norm[c], then += start[c];
  residual = then > 0 ? std::sqrt(now / then) : 0;
  return taken;
}

/// Mean luminance of the absolute primal data.
double mean_luminance(std::span<const PoissonFrame* const> window) {
  const int w = window[0]->width(), h = window[0]->height();
  BandSums<std::array<double, 1>> sums(h);
  sums.for_each(h, [&](std::int64_t band, int y0, int y1) {
    double sum = 0;
    for (const PoissonFrame* f : window) {
      for (int y = y0; y < y1; ++y) {
        const float *r = f->data(RowSet::kPrimal, y, 0), *g = f->data(RowSet::kPrimal, y, 1),
                    *b = f->data(RowSet::kPrimal, y, 2);
        for (int i = 0; i < w; ++i) sum += std::abs(0.2126f * r[i] + 0.7152f * g[i] + 0.0722f * b[i]);
      }
    }
    sums[band] = {sum};
  });
  return sums.total()[0] / (double(w) * h * double(window.size()));
}

}  // namespace

PoissonSettings PoissonSettings::published() {
  PoissonSettings s;
  s.direct_start = false;
  s.l2_steps = 50;
  s.rounds = 20, s.round_steps = 50;
  s.epsilon = 0.05, s.epsilon_floor = 0;
  s.relative = false;
  return s;
}

bool has_cuda() {
#ifdef TEMPERA_CUDA
  return cuda_device_count() > 0;
#else
  return false;
#endif
}

PoissonReport solve_poisson(std::span<const PoissonFrame* const> window, const PoissonSettings& settings,
                            PlanarFrames& x, std::stop_token stop, const PoissonProgress& progress) {
  if (settings.device == PoissonDevice::kCuda && !has_cuda()) {
#ifdef TEMPERA_CUDA
    throw Error(ErrorCode::kUnsupported, "there is no CUDA device that can be used; --device cpu needs none");
#else
    throw Error(ErrorCode::kUnsupported, "this build has no CUDA solver (-DTEMPERA_CUDA=ON); --device cpu needs none");
#endif
  }
  TEMPERA_ASSERT(!window.empty() && x.frames() == int(window.size()) && x.width() == window[0]->width() &&
                 x.height() == window[0]->height());
  const int w = x.width(), h = x.height(), frames = x.frames();
  PoissonSystem system(window, settings.weights);
  Vectors v{PlanarFrames(w, h, frames), {}, {}};
  PoissonReport report;
  const bool l1 = settings.norm == PoissonNorm::kL1;
  const int rounds = l1 ? settings.rounds : 1, round_steps = l1 ? settings.round_steps : settings.l2_steps;
  int round = 0;
  const auto before_step = [&](int of_round, int step) {
    if (stop.stop_requested()) throw Error(ErrorCode::kCancelled, "stopped");
    if (progress) progress((of_round + double(step) / round_steps) / rounds);
  };
  const auto steps = [&](int n) {
    if (v.p.frames() == 0) v.p = PlanarFrames(w, h, frames), v.q = PlanarFrames(w, h, frames);
    int step = 0;
    report.steps += conjugate_gradients(system, n, x, v, report.residual, [&] { before_step(round, step++); });
  };
  const bool precise = window[0]->has_precision();
  // Without precisions a still window is solved exactly; rounds of reweighting take them in later.
  report.direct = system.is_separable() && (!precise || (l1 && rounds > 1));
  const bool on_cuda = settings.device == PoissonDevice::kCuda;
  if (report.direct) {
    solve_separable(system, v.r, x);
  } else {
    if (settings.direct_start) {
      system.set_linked(false);
      solve_separable(system, v.r, x);
      system.set_linked(true);
    }
    if (precise) system.set_precise();
    if (!on_cuda) steps(round_steps);
  }
  const double mean = mean_luminance(window), unit = settings.relative && mean > 0 ? mean : 1;
#ifdef TEMPERA_CUDA
  if (on_cuda) {
    v = {};
    solve_rounds_on_cuda(FlatWindow(window), settings, report.direct ? 1 : 0, unit, x, report, before_step);
    return report;
  }
#endif
  for (round = 1; round < rounds; ++round) {
    const double epsilon = unit * std::max(settings.epsilon_floor, settings.epsilon * std::exp2(1 - round));
    report.objective = system.reweight(x, epsilon, unit);
    steps(round_steps);
  }
  return report;
  // The analyzer takes the memory of `v` for lost, because it does not know the deleter of RowBlock.
}  // NOLINT(clang-analyzer-cplusplus.NewDeleteLeaks)

}  // namespace tempera
