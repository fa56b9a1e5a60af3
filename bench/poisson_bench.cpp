// SPDX-License-Identifier: Apache-2.0
// The Poisson solver: time, memory and error against the truth on a synthetic window, and the spectrum of its error
// over temporal frequencies against the theory [Manzi 2016, Sec. 3.4]. Prints one JSON object.
//
//   poisson_bench [--size 1280x720] [--frames 10] [--threads N] [--schedules fast,published] [--norm l1|l2] [--alpha
//   0.2]
//                 [--steps N]    steps of each round, or of l2
//   poisson_bench --theory
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <complex>
#include <cstdio>
#include <string>
#include <vector>

#include "../libs/stages/tests/theory_window.h"
#include "tempera/core/error.h"

using namespace tempera;

namespace {

double wall() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }
double cpu() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  const auto seconds = [](const timeval& t) { return double(t.tv_sec) + 1e-6 * double(t.tv_usec); };
  return seconds(u.ru_utime) + seconds(u.ru_stime);
}
double peak_mib() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  return double(u.ru_maxrss) / 1024;
}

struct Measurement {
  PoissonReport report;
  double wall = 0, cpu = 0, error = 0;
  std::string curve;  ///< [[wall, cpu, error], ...]
};

/// Solves from the primal data. With `curve`, the error is taken on the way, outside of the measured time: after each
/// of the first steps, then at intervals that grow with their number.
Measurement measure(const test::Window& window, const PoissonSettings& settings, bool curve) {
  PlanarFrames x = test::primal_data(window);
  const auto frames = window.span();
  Measurement m;
  double paused_wall = 0, paused_cpu = 0;
  const double wall_begin = wall(), cpu_begin = cpu();
  int steps = 0, next = 0;
  const auto point = [&] {
    const double w = wall(), c = cpu();
    m.curve += fmt::format("{}[{:.3f}, {:.3f}, {:.7f}]", m.curve.empty() ? "" : ", ", w - wall_begin - paused_wall,
                           c - cpu_begin - paused_cpu, test::rms_difference(x, window.truth));
    paused_wall += wall() - w, paused_cpu += cpu() - c;
  };
  m.report = solve_poisson(frames, settings, x, {}, [&](double) {
    if (!curve || steps++ < next) return;
    point();
    next = std::max(steps, int(1.15 * steps));
  });
  m.wall = wall() - wall_begin - paused_wall, m.cpu = cpu() - cpu_begin - paused_cpu;
  if (curve) point();
  m.error = test::rms_difference(x, window.truth);
  return m;
}

std::string time_and_error(int width, int height, int frames, int threads, const std::vector<std::string>& schedules,
                           PoissonNorm norm, float alpha, int round_steps) {
  std::string out;
  with_threads(threads, [&] {
    test::Window window = test::pan_with_discs(width, height, frames);
    test::set_data(window, test::SampledNoise{});
    if (norm == PoissonNorm::kL1) {  // as `tempera reconstruct` solves it; all data are equally noisy here
      const std::vector<float> ones(std::size_t(width), 1.0f);
      for (auto& f : window.frames) {
        for (int set = 0; set < kRowSets; ++set) {
          for (int y = 0; y < height; ++y) f->set_precision(RowSet(set), y, ones);
        }
      }
    }
    std::size_t runs = 0;
    for (const auto& f : window.frames) runs += f->motion.size();
    const double pairs = std::max(1, frames - 1);
    out = fmt::format(
        "{{\"width\": {}, \"height\": {}, \"frames\": {}, \"threads\": {}, \"coverage\": {:.4f}, \"runs_per_pair\": "
        "{:.0f}, \"start_error\": {:.5f}, \"schedules\": {{",
        width, height, frames, thread_count(), double(window.linked) / (double(width) * height * pairs),
        double(runs) / pairs, test::rms_difference(test::primal_data(window), window.truth));
    bool first = true;
    for (const std::string& name : schedules) {
      PoissonSettings settings = name == "published" ? PoissonSettings::published() : PoissonSettings{};
      settings.norm = norm;
      settings.weights.alpha = alpha;
      if (round_steps > 0) settings.l2_steps = settings.round_steps = round_steps;
      const Measurement plain = measure(window, settings, false);
      const double memory = peak_mib();
      out += fmt::format(
          "{}\"{}\": {{\"seconds\": {:.3f}, \"cpu_seconds\": {:.3f}, \"steps\": {}, \"error\": {:.6f}, \"peak_mib\": "
          "{:.0f}, \"curve\": [{}]}}",
          first ? "" : ", ", name, plain.wall, plain.cpu, plain.report.steps, plain.error, memory,
          measure(window, settings, true).curve);
      first = false;
    }
    out += "}}";
  });
  return out;
}

/// One column of the theory's table: in closed form, and what the solver makes of a long window with such noise. Errors
/// in thousandths at the frequencies 0, 0.05, ... 0.5; `expected` is the theory for a picture of that size, which the
/// solver has to meet; `least` is that of generalised least squares.
std::string theory_and_solver(const test::TheoryColumn& column) {
  constexpr int kSize = 128, kFrames = 128, kMargin = 24, kKept = kFrames - 2 * kMargin, kFrequencies = 11;
  constexpr int kQuadrature = 96, kSteps = 64;
  const auto error = [&](double s, double f) {
    return column.replayed ? test::replayed_error(column.model, s, f) : test::independent_error(column.model, s, f);
  };
  const auto least = [&](double s, double f) { return test::least_replayed_error(column.model, s, f); };
  struct Curve {
    std::vector<double> at = std::vector<double>(kFrequencies);
    double mean = 0, difference = 0;  ///< of consecutive frames
  };
  const auto curve = [&](int n, bool cosine, const auto& of) {
    Curve c;
    const auto value = [&](double f) {
      return 1e3 * test::spatial_mean(n, cosine, [&](double s) { return of(s, f); });
    };
    for (int k = 0; k < kFrequencies; ++k) c.at[k] = value(0.05 * k);
    for (int k = 0; k < kSteps; ++k) {
      const double f = (k + 0.5) / kSteps, v = value(f) / kSteps;
      c.mean += v, c.difference += test::difference_power(f) * v;
    }
    return c;
  };
  const test::Window window = test::noisy_window(column, kSize, kFrames, 1);
  PlanarFrames x = test::primal_data(window);
  solve_poisson(window.span(), test::settings_of(column.model), x);

  // Periodograms of each pixel of the frames in the middle, which stand for an endless sequence.
  std::vector<std::complex<double>> wave(std::size_t(kFrequencies) * kKept);
  double taper_power = 0;
  for (int t = 0; t < kKept; ++t) {
    const double taper = 0.5 - 0.5 * std::cos(2 * kPiD * (t + 0.5) / kKept);  // Hann
    taper_power += taper * taper;
    for (int k = 0; k < kFrequencies; ++k)
      wave[std::size_t(k) * kKept + std::size_t(t)] = std::polar(taper, -0.1 * kPiD * k * t);
  }
  Curve solver;
  const double scale = 1e3 / (3.0 * kSize * kSize);
  std::vector<double> series(kKept + 1);
  for (int y = 0; y < kSize; ++y) {
    for (int c = 0; c < 3; ++c) {
      for (int i = 0; i < kSize; ++i) {
        for (int t = 0; t <= kKept; ++t) series[t] = double(x.row(kMargin + t, y, c)[i]);
        for (std::size_t t = 0; t < kKept; ++t) {
          const double v = series[t], d = series[t + 1] - v;
          solver.mean += scale / kKept * v * v, solver.difference += scale / kKept * d * d;
        }
        for (std::size_t k = 0; k < kFrequencies; ++k) {
          std::complex<double> sum = 0;
          for (std::size_t t = 0; t < kKept; ++t) sum += wave[k * kKept + t] * series[t];
          solver.at[k] += scale / taper_power * std::norm(sum);
        }
      }
    }
  }
  const auto print = [](const Curve& c) {
    return fmt::format("{{\"at\": [{:.5f}], \"mean\": {:.5f}, \"difference\": {:.5f}}}", fmt::join(c.at, ", "), c.mean,
                       c.difference);
  };
  Curve specified;
  specified.at.assign(column.at.begin(), column.at.end());
  specified.mean = column.mean, specified.difference = column.difference;
  std::string out = fmt::format("\"{}\": {{\"specified\": {}, \"theory\": {}, \"expected\": {}, \"solver\": {}",
                                column.name, print(specified), print(curve(kQuadrature, false, error)),
                                print(curve(kSize, true, error)), print(solver));
  if (column.replayed) out += fmt::format(", \"least\": {}", print(curve(kQuadrature, false, least)));
  return out + "}";
}

std::string theory() {
  std::vector<std::string> columns;
  for (const test::TheoryColumn& c : test::kTheory) columns.push_back(theory_and_solver(c));
  return fmt::format("{{{}}}", fmt::join(columns, ",\n"));
}

}  // namespace

int main(int argc, char** argv) try {
  int width = 1280, height = 720, frames = 10, threads = 0, steps = 0;
  double alpha = 0.2;
  std::vector<std::string> schedules{"fast"};
  PoissonNorm norm = PoissonNorm::kL1;
  bool want_theory = false;
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    const std::string v = i + 1 < argc ? argv[i + 1] : "";
    if (a == "--theory") {
      want_theory = true;
      continue;
    }
    ++i;
    if (a == "--size" && std::sscanf(v.c_str(), "%dx%d", &width, &height) == 2) continue;
    if (a == "--alpha" && (alpha = std::atof(v.c_str())) > 0) continue;
    if (a == "--steps" && (steps = std::atoi(v.c_str())) > 0) continue;
    if (a == "--frames" && (frames = std::atoi(v.c_str())) > 0) continue;
    if (a == "--threads") {
      threads = std::atoi(v.c_str());
      continue;
    }
    if (a == "--schedules") {
      schedules.clear();
      for (std::size_t at = 0; at < v.size(); at = std::min(v.find(',', at), v.size()) + 1) {
        schedules.push_back(v.substr(at, v.find(',', at) - at));
      }
      continue;
    }
    if (a == "--norm" && (v == "l1" || v == "l2")) {
      norm = v == "l1" ? PoissonNorm::kL1 : PoissonNorm::kL2;
      continue;
    }
    fmt::print(stderr, "poisson_bench: cannot read {} {}\n", a, v);
    return 2;
  }
  fmt::print("{}\n", want_theory
                         ? theory()
                         : time_and_error(width, height, frames, threads, schedules, norm, float(alpha), steps));
  return 0;
} catch (const Error& e) {
  fmt::print(stderr, "{}\n", e.what());
  return exit_status(e.code());
}
