// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/poisson.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>

#include "../src/poisson_rows.h"
#include "random_motion.h"
#include "synthetic_window.h"
#include "tempera/core/error.h"

namespace tempera {
namespace {

using test::RowEntry;
using test::Window;

/// The rows of A from the map itself, without runs.
template <class F>
void rows_of_definition(const std::vector<PixelMap>& motion, const std::vector<Grid<std::uint8_t>>& sampled, int w,
                        int h, int frames, F&& row) {
  for (int t = 0; t < frames; ++t) {
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        row(RowSet::kPrimal, t, y, x, 0, 0);
        if (x + 1 < w) row(RowSet::kDx, t, y, x, 0, 0);
        if (y + 1 < h) row(RowSet::kDy, t, y, x, 0, 0);
        if (t + 1 == frames) continue;
        const Vec2<int> to = motion[t].forward(x, y);
        if (to.x < 0) continue;
        const auto& s = sampled[t];
        row(RowSet::kDt, t, y, x, to.x, to.y);
        if (x + 1 < w && to.x + 1 < w && s.at(to.x + 1, to.y)) row(RowSet::kDxDt, t, y, x, to.x, to.y);
        if (y + 1 < h && to.y + 1 < h && s.at(to.x, to.y + 1)) {
          row(RowSet::kDyDt, t, y, x, to.x, to.y);
        }
      }
    }
  }
}

/// A window with random motion, where pixels of the offset pass are missing, and data of NaN in rows that do not exist.
struct RandomSystem {
  RandomSystem(int w_, int h_, int frames_) : w(w_), h(h_), frames(frames_), window(w_, h_, frames_) {
    for (int t = 0; t + 1 < frames; ++t) {
      motion.push_back(test::random_motion(w, h, std::uint64_t(t) + 11));
      sampled.push_back(test::random_mask(w, h, 0.95, std::uint64_t(t) + 70));
      window.frames[t]->motion = MotionRuns(motion.back(), {}, sampled.back());
    }
    for (int t = 0; t < frames; ++t) {
      for (int y = 0; y < h; ++y) {
        for (int c = 0; c < 3; ++c) {
          for (int s = 0; s < kRowSets; ++s) {
            std::fill_n(window.frames[t]->data(RowSet(s), y, c), w, std::numeric_limits<float>::quiet_NaN());
          }
          for (int x = 0; x < w; ++x) window.truth.row(t, y, c)[x] = float(test::normal(3, address(t, y, x, c)));
        }
      }
    }
    for_each([&](RowSet set, int t, int y, int x, int, int) {
      for (int c = 0; c < 3; ++c) {
        window.frames[t]->data(set, y, c)[x] =
            float(test::normal(4, address(t, y, x, c) * kRowSets + std::uint64_t(set)));
      }
    });
  }
  std::uint64_t address(int t, int y, int x, int c) const { return std::uint64_t(((t * h + y) * w + x) * 3 + c); }
  template <class F>
  void for_each(F&& row) const {
    rows_of_definition(motion, sampled, w, h, frames, row);
  }
  int w, h, frames;
  std::vector<PixelMap> motion;
  std::vector<Grid<std::uint8_t>> sampled;
  Window window;
};

/// A^T W^2 (b_factor b - x_factor A x) in double precision, by the definition.
std::vector<double> reference_descent(const RandomSystem& s, const PoissonSystem& system, const PlanarFrames& x,
                                      double x_factor, double b_factor) {
  std::vector<double> out(std::size_t(s.w * s.h * s.frames * 3));
  s.for_each([&](RowSet set, int t, int y, int px, int to_x, int to_y) {
    const double w2 = double(system.squared_weight(set, t, px, y));
    for (int c = 0; c < 3; ++c) {
      const auto entries = test::row_entries(set, t, y, px, to_x, to_y);
      double r = b_factor * double(s.window.frames[t]->data(set, y, c)[px]);
      for (const RowEntry& e : entries) r -= x_factor * e.coefficient * double(x.row(e.t, e.y, c)[e.x]);
      for (const RowEntry& e : entries) out[s.address(e.t, e.y, e.x, c)] += e.coefficient * w2 * r;
    }
  });
  return out;
}

/// Relative to the reference's norm.
double relative_error(const RandomSystem& s, const PlanarFrames& x, const std::vector<double>& reference) {
  double error = 0, norm = 0;
  for (int t = 0; t < s.frames; ++t) {
    for (int y = 0; y < s.h; ++y) {
      for (int px = 0; px < s.w; ++px) {
        for (int c = 0; c < 3; ++c) {
          const double r = reference[s.address(t, y, px, c)], d = double(x.row(t, y, c)[px]) - r;
          error += d * d, norm += r * r;
        }
      }
    }
  }
  return std::sqrt(error / norm);
}

// T2 of the specification: the fused operator is A^T W^2 A of the definition, for random motion and weights.
TEST(PoissonSystem, IsTheProductOfItsRows) {
  const RandomSystem s(53, 38, 4);
  PoissonSystem system(s.window.span(), {.alpha = 0.3f, .spatial = 0.9f, .temporal = 1.1f, .mixed = 0.7f});
  PlanarFrames out(s.w, s.h, s.frames);
  for (const bool weighted : {false, true}) {
    if (weighted) system.reweight(s.window.truth, 0.1, 1);
    ChannelSums x_out{}, out_out{};
    system.apply(s.window.truth, out, x_out, out_out);
    EXPECT_LT(relative_error(s, out, reference_descent(s, system, s.window.truth, -1, 0)), 1e-6);
    ChannelSums expected{};
    for (int t = 0; t < s.frames; ++t) {
      for (int y = 0; y < s.h; ++y) {
        for (std::size_t c = 0; c < 3; ++c) {
          for (int x = 0; x < s.w; ++x) {
            expected[c] += double(out.row(t, y, int(c))[x]) * double(s.window.truth.row(t, y, int(c))[x]);
          }
        }
      }
    }
    for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(x_out[c] / expected[c], 1, 1e-6);

    const ChannelSums norm = system.descent(s.window.truth, out);
    EXPECT_LT(relative_error(s, out, reference_descent(s, system, s.window.truth, 1, 1)), 1e-6);
    EXPECT_GT(norm[0], 0);
  }
}

// T2: <A x, y> = <x, A^T y> with y random on all rows; rows that do not exist hold NaN here, and have no effect.
TEST(PoissonSystem, RowsAndColumnsAreAdjoint) {
  const RandomSystem s(61, 27, 3);
  const PoissonSystem system(s.window.span(), {.alpha = 1});
  double ax_y = 0, norm = 0;
  s.for_each([&](RowSet set, int t, int y, int px, int to_x, int to_y) {
    for (int c = 0; c < 3; ++c) {
      double ax = 0;
      for (const RowEntry& e : test::row_entries(set, t, y, px, to_x, to_y)) {
        ax += e.coefficient * double(s.window.truth.row(e.t, e.y, c)[e.x]);
      }
      const double v = ax * double(s.window.frames[t]->data(set, y, c)[px]);
      ax_y += v, norm += std::abs(v);
    }
  });
  PlanarFrames zero(s.w, s.h, s.frames), transposed(s.w, s.h, s.frames);
  system.descent(zero, transposed);
  double x_aty = 0;
  for (int t = 0; t < s.frames; ++t) {
    for (int y = 0; y < s.h; ++y) {
      for (int c = 0; c < 3; ++c) {
        for (int x = 0; x < s.w; ++x) {
          x_aty += double(transposed.row(t, y, c)[x]) * double(s.window.truth.row(t, y, c)[x]);
        }
      }
    }
  }
  EXPECT_NEAR(ax_y, x_aty, 1e-6 * norm);
}

TEST(PoissonSystem, WeightsAreThoseOfFairsLoss) {
  const RandomSystem s(31, 17, 3);
  const PoissonWeights weights{.alpha = 0.3f, .spatial = 0.9f, .temporal = 1.1f, .mixed = 0.7f};
  PoissonSystem system(s.window.span(), weights);
  const double epsilon = 0.4, scale = 2.5, sum = system.reweight(s.window.truth, epsilon, scale);
  double expected = 0;
  s.for_each([&](RowSet set, int t, int y, int px, int to_x, int to_y) {
    double n2 = 0;
    for (int c = 0; c < 3; ++c) {
      double r = -double(s.window.frames[t]->data(set, y, c)[px]);
      for (const RowEntry& e : test::row_entries(set, t, y, px, to_x, to_y)) {
        r += e.coefficient * double(s.window.truth.row(e.t, e.y, c)[e.x]);
      }
      n2 += r * r;
    }
    const double w0 = double(weights.of(set)), norm = w0 * std::sqrt(n2);
    expected += norm;
    EXPECT_NEAR(double(system.squared_weight(set, t, px, y)) * (norm + epsilon) / (scale * w0 * w0), 1, 1.0 / 256)
        << "eight bits of mantissa";
  });
  EXPECT_NEAR(sum / expected, 1, 1e-6);
  system.set_uniform();
  EXPECT_EQ(system.squared_weight(RowSet::kDx, 0, 0, 0), 0.9f * 0.9f);
}

TEST(PoissonSystem, PrecisionsMultiplySquaredWeights) {
  const RandomSystem s(31, 17, 3);
  const auto precision = [&](RowSet set, int t, int y, int x) {
    return std::exp2(float(hash_key(std::uint64_t(set), s.address(t, y, x, 0)) % 9) - 4);  // exact in eight bits
  };
  for (int t = 0; t < s.frames; ++t) {
    for (int y = 0; y < s.h; ++y) {
      for (int set = 0; set < kRowSets; ++set) {
        std::vector<float> row;
        for (int x = 0; x < s.w; ++x) row.push_back(precision(RowSet(set), t, y, x));
        s.window.frames[t]->set_precision(RowSet(set), y, row);
      }
    }
  }
  const PoissonWeights weights{.alpha = 0.5f, .spatial = 1, .temporal = 2, .mixed = 0.5f};
  PoissonSystem system(s.window.span(), weights);
  PlanarFrames out(s.w, s.h, s.frames);
  system.set_precise();
  EXPECT_EQ(system.squared_weight(RowSet::kDt, 0, 4, 2), 4 * precision(RowSet::kDt, 0, 2, 4));
  system.descent(s.window.truth, out);
  EXPECT_LT(relative_error(s, out, reference_descent(s, system, s.window.truth, 1, 1)), 1e-6);
  const double epsilon = 0.3;
  system.reweight(s.window.truth, epsilon, 1);
  s.for_each([&](RowSet set, int t, int y, int px, int to_x, int to_y) {
    double n2 = 0;
    for (int c = 0; c < 3; ++c) {
      double r = -double(s.window.frames[t]->data(set, y, c)[px]);
      for (const RowEntry& e : test::row_entries(set, t, y, px, to_x, to_y)) {
        r += e.coefficient * double(s.window.truth.row(e.t, e.y, c)[e.x]);
      }
      n2 += r * r;
    }
    const double square = double(weights.of(set)) * double(weights.of(set)) * double(precision(set, t, y, px));
    EXPECT_NEAR(double(system.squared_weight(set, t, px, y)) * (std::sqrt(square * n2) + epsilon) / square, 1,
                1.0 / 256);
  });
}

// Inverse variances as precisions are the best weights.
TEST(Poisson, PrecisionsLowerTheError) {
  Window window = test::pan_with_discs(80, 60, 4);
  // One half of the picture is far noisier than the other.
  const auto sigma = [](RowSet set, int x) { return (x < 40 ? 0.005 : 0.2) * (set == RowSet::kPrimal ? 5 : 1); };
  const std::uint64_t w = 80;
  test::set_data(window, [&](RowSet set, std::uint64_t address) {
    return sigma(set, int(address / 3 % w)) * test::normal(2, address);
  });
  PoissonSettings settings;
  settings.norm = PoissonNorm::kL2;
  settings.l2_steps = 60;
  PlanarFrames plain = test::primal_data(window), precise = test::primal_data(window);
  solve_poisson(window.span(), settings, plain);
  for (int t = 0; t < 4; ++t) {
    for (int y = 0; y < 60; ++y) {
      for (int set = 0; set < kRowSets; ++set) {
        std::vector<float> row;
        for (int x = 0; x < 80; ++x) {
          const double s = sigma(RowSet(set), x) / 0.02;
          row.push_back(float((set == 0 ? 25 : 1) / (s * s)));
        }
        window.frames[t]->set_precision(RowSet(set), y, row);
      }
    }
  }
  solve_poisson(window.span(), settings, precise);
  const auto error = [&](const PlanarFrames& x, int from, int to) {
    double sum = 0;
    for (int t = 0; t < 4; ++t) {
      for (int y = 0; y < 60; ++y) {
        for (int c = 0; c < 3; ++c) {
          for (int i = from; i < to; ++i) {
            const double d = double(x.row(t, y, c)[i]) - double(window.truth.row(t, y, c)[i]);
            sum += d * d;
          }
        }
      }
    }
    return std::sqrt(sum);
  };
  EXPECT_LT(error(precise, 0, 40), 0.3 * error(plain, 0, 40)) << "the noise of the other half stays there";
  EXPECT_LT(error(precise, 40, 80), error(plain, 40, 80));
}

// T3: exact data give the exact picture, from any start.
TEST(Poisson, ReproducesExactData) {
  Window window = test::pan_with_discs(96, 64, 5);
  test::set_data(window, [](RowSet, std::uint64_t) { return 0.0; });
  for (const PoissonNorm norm : {PoissonNorm::kL2, PoissonNorm::kL1}) {
    for (const bool zero : {false, true}) {
      PlanarFrames x(96, 64, 5);
      if (!zero) {
        for (int t = 0; t < 5; ++t) {
          for (int y = 0; y < 64; ++y) {
            for (int c = 0; c < 3; ++c) {
              for (int i = 0; i < 96; ++i)
                x.row(t, y, c)[i] = float(test::normal(9, std::uint64_t((t * 64 + y) * 96 + i)));
            }
          }
        }
      }
      PoissonSettings settings;
      settings.norm = norm;
      settings.direct_start = false;
      settings.l2_steps = 200;
      settings.rounds = 4, settings.round_steps = 150;
      solve_poisson(window.span(), settings, x);
      EXPECT_LT(test::rms_difference(x, window.truth), 1e-5) << int(norm) << zero;
    }
  }
  PlanarFrames x = test::primal_data(window);
  solve_poisson(window.span(), {}, x);
  EXPECT_LT(test::rms_difference(x, window.truth), 1e-6) << "the data themselves are a start that is not left";
}

/// The window seen backwards in time.
Window reversed(const Window& in, const std::vector<PixelMap>& motion) {
  const int w = in.truth.width(), h = in.truth.height(), n = in.truth.frames();
  Window out(w, h, n);
  for (int t = 0; t < n; ++t) {
    const PoissonFrame& from = *in.frames[n - 1 - t];
    PoissonFrame& to = *out.frames[t];
    for (int y = 0; y < h; ++y) {
      for (int c = 0; c < 3; ++c) {
        for (const RowSet set : {RowSet::kPrimal, RowSet::kDx, RowSet::kDy}) {
          std::copy_n(from.data(set, y, c), w, to.data(set, y, c));
        }
      }
    }
    if (t + 1 == n) continue;
    const PixelMap& m = motion[n - 2 - t];
    const PoissonFrame& pair = *in.frames[n - 2 - t];
    PixelMap back(w, h);
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const Vec2<int> i = m.backward(x, y);
        if (i.x < 0) continue;
        back.link(x, y, i.x, i.y);
        for (int c = 0; c < 3; ++c) {
          for (const RowSet set : {RowSet::kDt, RowSet::kDxDt, RowSet::kDyDt}) {
            to.data(set, y, c)[x] = -pair.data(set, i.y, c)[i.x];
          }
        }
      }
    }
    to.motion = MotionRuns(back);
  }
  return out;
}

PoissonSettings few_steps(PoissonNorm norm) {
  PoissonSettings s;
  s.norm = norm;
  s.l2_steps = 60, s.rounds = 3, s.round_steps = 60;
  return s;
}

// T4: time may run backwards.
TEST(Poisson, TimeReversalGivesTheSamePictures) {
  const int w = 48, h = 40, n = 4;
  Window forward(w, h, n);
  std::vector<PixelMap> motion;
  for (int t = 0; t + 1 < n; ++t) {
    motion.push_back(test::random_motion(w, h, std::uint64_t(t) + 31));
    forward.frames[t]->motion = MotionRuns(motion.back());
  }
  test::set_data(forward, test::SampledNoise{1, 0.2, 0.01});
  const Window backward = reversed(forward, motion);
  for (const PoissonNorm norm : {PoissonNorm::kL2, PoissonNorm::kL1}) {
    PlanarFrames a = test::primal_data(forward), b = test::primal_data(backward);
    solve_poisson(forward.span(), few_steps(norm), a);
    solve_poisson(backward.span(), few_steps(norm), b);
    PlanarFrames c(w, h, n);
    for (int t = 0; t < n; ++t) {
      for (int y = 0; y < h; ++y) {
        for (int k = 0; k < 3; ++k) std::copy_n(b.row(n - 1 - t, y, k), w, c.row(t, y, k));
      }
    }
    EXPECT_LT(test::rms_difference(a, c), 1e-4);
    EXPECT_GT(test::rms_difference(a, forward.truth), 1e-2) << "something was solved";
  }
}

// T4: left and right, and top and bottom, may be exchanged where motion is rigid.
TEST(Poisson, MirroredDataGiveMirroredPictures) {
  const int w = 45, h = 38, n = 4;
  for (const bool horizontal : {true, false}) {
    Window a(w, h, n), b(w, h, n);
    const auto mirror = [&](Vec2<int> p) {
      return horizontal ? Vec2<int>{w - 1 - p.x, p.y} : Vec2<int>{p.x, h - 1 - p.y};
    };
    for (int t = 0; t + 1 < n; ++t) {
      PixelMap m(w, h), mirrored(w, h);
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          const Vec2<int> from = mirror({x, y}), to = mirror({x + 3, y - 2});
          if (m.link(x, y, x + 3, y - 2)) mirrored.link(from.x, from.y, to.x, to.y);
        }
      }
      a.frames[t]->motion = MotionRuns(m);
      b.frames[t]->motion = MotionRuns(mirrored);
    }
    test::set_data(a, test::SampledNoise{1, 0.2, 0.01});
    for (int t = 0; t < n; ++t) {
      PoissonFrame& to = *b.frames[t];
      test::for_each_row(*a.frames[t], t + 1 == n, [&](RowSet set, int y, int x, int, int) {
        // A difference along the mirrored direction starts at the other of its two pixels and changes its sign.
        const bool along =
            horizontal ? set == RowSet::kDx || set == RowSet::kDxDt : set == RowSet::kDy || set == RowSet::kDyDt;
        const Vec2<int> at = mirror(along ? (horizontal ? Vec2<int>{x + 1, y} : Vec2<int>{x, y + 1}) : Vec2<int>{x, y});
        for (int c = 0; c < 3; ++c) {
          const float v = a.frames[t]->data(set, y, c)[x];
          to.data(set, at.y, c)[at.x] = along ? -v : v;
        }
      });
    }
    for (const PoissonNorm norm : {PoissonNorm::kL2, PoissonNorm::kL1}) {
      PlanarFrames x = test::primal_data(a), z = test::primal_data(b), back(w, h, n);
      solve_poisson(a.span(), few_steps(norm), x);
      solve_poisson(b.span(), few_steps(norm), z);
      for (int t = 0; t < n; ++t) {
        for (int y = 0; y < h; ++y) {
          for (int px = 0; px < w; ++px) {
            const Vec2<int> at = mirror({px, y});
            for (int c = 0; c < 3; ++c) back.row(t, y, c)[px] = z.row(t, at.y, c)[at.x];
          }
        }
      }
      EXPECT_LT(test::rms_difference(x, back), 1e-4) << horizontal;
    }
  }
}

Window still_window(int w, int h, int n, std::uint64_t seed) {
  Window window(w, h, n);
  PixelMap still(w, h);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) still.link(x, y, x, y);
  }
  for (int t = 0; t + 1 < n; ++t) window.frames[t]->motion = MotionRuns(still);
  test::set_data(window, test::SampledNoise{0.1, 0.02, 0, seed});
  return window;
}

// What never moves is solved by transforms, in one go, and agrees with many steps of conjugate gradients.
TEST(Poisson, StillWindowsAreSolvedDirectly) {
  const Window window = still_window(50, 37, 6, 5);
  PoissonSettings settings;
  settings.norm = PoissonNorm::kL2;
  settings.weights = {.alpha = 0.1f, .spatial = 0.8f, .temporal = 1.2f, .mixed = 0.9f};
  PlanarFrames x = test::primal_data(window);
  const PoissonReport report = solve_poisson(window.span(), settings, x);
  EXPECT_TRUE(report.direct);
  EXPECT_EQ(report.steps, 0);
  PoissonSystem system(window.span(), settings.weights);
  PlanarFrames rest(50, 37, 6), start(50, 37, 6);
  const ChannelSums after = system.descent(x, rest), before = system.descent(start, rest);
  for (std::size_t c = 0; c < 3; ++c) EXPECT_LT(after[c], 1e-10 * before[c]) << "a residual of rounding errors";
}

TEST(Poisson, ASingleFrameIsSolvedDirectly) {
  Window window(40, 31, 1);
  test::set_data(window, test::SampledNoise{});
  PoissonSettings settings;
  settings.norm = PoissonNorm::kL2;
  PlanarFrames x = test::primal_data(window);
  EXPECT_TRUE(solve_poisson(window.span(), settings, x).direct);
  EXPECT_LT(test::rms_difference(x, window.truth), 0.03);
  PlanarFrames robust = test::primal_data(window);
  settings.norm = PoissonNorm::kL1;
  EXPECT_GT(solve_poisson(window.span(), settings, robust).steps, 0);
  EXPECT_LT(test::rms_difference(robust, window.truth), test::rms_difference(x, window.truth))
      << "the L1 norm is robust against the outliers";
}

TEST(Poisson, ConstantPicturesStayExactly) {
  for (const bool moving : {false, true}) {
    Window window = moving ? test::pan_with_discs(64, 48, 4) : still_window(64, 48, 4, 1);
    for (int t = 0; t < 4; ++t) {
      for (int y = 0; y < 48; ++y) {
        for (int c = 0; c < 3; ++c) std::fill_n(window.truth.row(t, y, c), 64, 0.3f + 0.1f * float(c));
      }
    }
    test::set_data(window, [](RowSet, std::uint64_t) { return 0.0; });
    for (const PoissonNorm norm : {PoissonNorm::kL2, PoissonNorm::kL1}) {
      PoissonSettings settings;
      settings.norm = norm;
      PlanarFrames x = test::primal_data(window);
      solve_poisson(window.span(), settings, x);
      EXPECT_EQ(test::rms_difference(x, window.truth), 0) << moving << int(norm);
    }
  }
}

TEST(Poisson, SameBitsOnAnyNumberOfThreads) {
  Window window = test::pan_with_discs(130, 75, 4);
  test::set_data(window, test::SampledNoise{});
  const auto solve = [&](int threads, PoissonNorm norm) {
    PlanarFrames x = test::primal_data(window);
    with_threads(threads, [&] { solve_poisson(window.span(), few_steps(norm), x); });
    return x;
  };
  for (const PoissonNorm norm : {PoissonNorm::kL2, PoissonNorm::kL1}) {
    const PlanarFrames one = solve(1, norm);
    for (const int threads : {2, 7}) EXPECT_EQ(test::rms_difference(one, solve(threads, norm)), 0);
  }
}

TEST(Poisson, BrightnessScalesThrough) {
  Window a = test::pan_with_discs(60, 40, 3), b = test::pan_with_discs(60, 40, 3);
  test::set_data(a, test::SampledNoise{});
  constexpr float kScale = 1024;
  for (int t = 0; t < 3; ++t) {
    test::for_each_row(*a.frames[t], t == 2, [&](RowSet set, int y, int x, int, int) {
      for (int c = 0; c < 3; ++c) {
        b.frames[t]->data(set, y, c)[x] = kScale * a.frames[t]->data(set, y, c)[x];
      }
    });
  }
  PlanarFrames x = test::primal_data(a), z = test::primal_data(b);
  solve_poisson(a.span(), {}, x);
  solve_poisson(b.span(), {}, z);
  for (int t = 0; t < 3; ++t) {
    for (int y = 0; y < 40; ++y) {
      for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < 60; ++i) ASSERT_EQ(kScale * x.row(t, y, c)[i], z.row(t, y, c)[i]);
      }
    }
  }
}

TEST(Poisson, StopsOnRequest) {
  Window window = test::pan_with_discs(32, 24, 3);
  test::set_data(window, test::SampledNoise{});
  PlanarFrames x = test::primal_data(window);
  std::stop_source stop;
  stop.request_stop();
  try {
    solve_poisson(window.span(), {}, x, stop.get_token());
    ADD_FAILURE() << "no Error was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kCancelled);
  }
}

// One round of reweighting more must not raise the loss that it minimises.
TEST(Poisson, RobustLossFallsFromRoundToRound) {
  Window window = test::pan_with_discs(64, 48, 4);
  test::set_data(window, test::SampledNoise{});
  double last = std::numeric_limits<double>::infinity();
  for (int rounds = 2; rounds <= 6; ++rounds) {
    PoissonSettings settings;
    settings.rounds = rounds, settings.round_steps = 60;
    settings.epsilon = settings.epsilon_floor = 0.02;
    PlanarFrames x = test::primal_data(window);
    const PoissonReport report = solve_poisson(window.span(), settings, x);
    EXPECT_LT(report.objective, last);
    last = report.objective;
  }
}

// The rows as other processors see them, a pixel each, against their definition; CUDA kernels are made of the same
// functions.
TEST(PoissonRows, OfPixelsAreThoseOfTheDefinition) {
  const RandomSystem s(37, 23, 4);
  const auto span = s.window.span();
  PoissonSystem system(span, {});
  system.reweight(s.window.truth, 0.02, 1);
  const FlatWindow flat(span);
  const FlatRows rows = flat.rows();
  const std::size_t n = flat.pixels();
  std::vector<float> x(3 * n), residual(3 * kRowSets * n);
  const auto place = [&](int g) { return std::array{g / (s.w * s.h), g / s.w % s.h, g % s.w}; };
  for (int g = 0; g < rows.pixels(); ++g) {
    const auto [t, y, px] = place(g);
    for (int c = 0; c < 3; ++c) x[3 * g + c] = s.window.truth.row(t, y, c)[px];
  }
  for (int set = 0; set < kRowSets; ++set) {
    for (int g = 0; g < rows.pixels(); ++g) {
      if (!rows.exists(RowSet(set), g)) continue;
      const auto [t, y, px] = place(g);
      for (int c = 0; c < 3; ++c) {
        const std::size_t i = 3 * (std::size_t(set) * n + std::size_t(g)) + std::size_t(c);
        residual[i] =
            system.squared_weight(RowSet(set), t, px, y) * (flat.data[i] - rows.value(RowSet(set), g, x.data(), c));
      }
    }
  }
  PlanarFrames out(s.w, s.h, s.frames);
  std::vector<double> diagonal(n);
  for (int g = 0; g < rows.pixels(); ++g) {
    const auto [t, y, px] = place(g);
    rows.for_each_row_of(g, [&](RowSet set, int row, float coefficient) {
      const auto [row_t, row_y, row_x] = place(row);
      diagonal[g] += double(system.squared_weight(set, row_t, row_x, row_y));
      for (int c = 0; c < 3; ++c)
        out.row(t, y, c)[px] += coefficient * residual[3 * (std::size_t(set) * n + std::size_t(row)) + std::size_t(c)];
    });
    EXPECT_NEAR(diagonal[g] * double(system.inverse_diagonal(t, y)[px]), 1, 1e-5);
  }
  EXPECT_LT(relative_error(s, out, reference_descent(s, system, s.window.truth, 1, 1)), 1e-6);
}

TEST(PoissonCuda, SolvesAsTheProcessorDoes) {
  const RandomSystem s(61, 45, 6);
  PoissonSettings settings;
  settings.device = PoissonDevice::kCuda;
  for (const PoissonNorm norm : {PoissonNorm::kL1, PoissonNorm::kL2}) {
    settings.norm = norm;
    settings.l2_steps = 60;
    PlanarFrames x(s.w, s.h, s.frames), on_device(s.w, s.h, s.frames);
    if (!has_cuda()) {
      EXPECT_THROW(solve_poisson(s.window.span(), settings, on_device), Error);
      continue;
    }
    solve_poisson(s.window.span(), settings, on_device);
    settings.device = PoissonDevice::kCpu;
    solve_poisson(s.window.span(), settings, x);
    settings.device = PoissonDevice::kCuda;
    std::vector<double> reference(std::size_t(s.w * s.h * s.frames * 3));
    for (int t = 0; t < s.frames; ++t) {
      for (int y = 0; y < s.h; ++y) {
        for (int c = 0; c < 3; ++c) {
          for (int px = 0; px < s.w; ++px) reference[s.address(t, y, px, c)] = double(x.row(t, y, c)[px]);
        }
      }
    }
    // Weights of the processor's L1 have eight bits.
    EXPECT_LT(relative_error(s, on_device, reference), norm == PoissonNorm::kL1 ? 3e-3 : 1e-4);
  }
  if (!has_cuda()) GTEST_SKIP() << "no CUDA build, or no device";
}

}  // namespace
}  // namespace tempera
