// SPDX-License-Identifier: Apache-2.0
// The Poisson solver: time, memory and error against the truth on a synthetic window, and the spectrum of its error
// over temporal frequencies. Prints one JSON object.
//
//   poisson_bench [--size 1280x720] [--frames 10] [--threads N] [--schedules fast,published] [--norm l1|l2]
//   poisson_bench --spectrum
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "../libs/stages/tests/poisson_theory.h"
#include "../libs/stages/tests/synthetic_window.h"
#include "tempera/core/error.h"
#include "tempera/stages/cosine_transform.h"

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

/// Solves from the primal data. With `points`, the error is taken that often on the way, outside of the measured time.
Measurement measure(const test::Window& window, const PoissonSettings& settings, int points) {
  PlanarFrames x = test::primal_data(window);
  const auto frames = window.span();
  Measurement m;
  double paused_wall = 0, paused_cpu = 0;
  const double wall_begin = wall(), cpu_begin = cpu();
  int steps = 0;
  const int total = settings.norm == PoissonNorm::kL1 ? settings.rounds * settings.round_steps : settings.l2_steps;
  const auto point = [&] {
    const double w = wall(), c = cpu();
    m.curve += fmt::format("{}[{:.3f}, {:.3f}, {:.7f}]", m.curve.empty() ? "" : ", ", w - wall_begin - paused_wall,
                           c - cpu_begin - paused_cpu, test::rms_difference(x, window.truth));
    paused_wall += wall() - w, paused_cpu += cpu() - c;
  };
  m.report = solve_poisson(frames, settings, x, {}, [&](double) {
    if (points > 0 && steps++ % std::max(1, total / points) == 0) point();
  });
  m.wall = wall() - wall_begin - paused_wall, m.cpu = cpu() - cpu_begin - paused_cpu;
  if (points > 0) point();
  m.error = test::rms_difference(x, window.truth);
  return m;
}

std::string time_and_error(int width, int height, int frames, int threads, const std::vector<std::string>& schedules,
                           PoissonNorm norm) {
  std::string out;
  with_threads(threads, [&] {
    test::Window window = test::pan_with_discs(width, height, frames);
    test::set_data(window, test::SampledNoise{});
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
      const Measurement plain = measure(window, settings, 0);
      const double memory = peak_mib();
      out += fmt::format(
          "{}\"{}\": {{\"seconds\": {:.3f}, \"cpu_seconds\": {:.3f}, \"steps\": {}, \"error\": {:.6f}, \"peak_mib\": "
          "{:.0f}, \"curve\": [{}]}}",
          first ? "" : ", ", name, plain.wall, plain.cpu, plain.report.steps, plain.error, memory,
          measure(window, settings, 40).curve);
      first = false;
    }
    out += "}}";
  });
  return out;
}

/// Mean squared error of the solver at the temporal frequencies k / (2 frames), for white noise and no motion, averaged
/// over `repeats` windows.
std::vector<double> spectrum(const test::NoiseModel& m, int repeats) {
  constexpr int kSize = 256, kFrames = 10, kLanes = CosineTransform::kLanes;
  PixelMap still(kSize, kSize);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) still.link(x, y, x, y);
  }
  PoissonSettings settings;
  settings.norm = PoissonNorm::kL2;
  settings.weights.alpha = float(m.alpha);
  settings.weights.temporal = m.rows == test::TemporalRows::kNone ? 0 : 1;
  settings.weights.mixed = m.rows == test::TemporalRows::kFull ? 1 : 0;
  std::vector<double> power(kFrames);
  const CosineTransform transform(kFrames);
  for (int n = 0; n < repeats; ++n) {
    test::Window window(kSize, kSize, kFrames);
    for (int t = 0; t + 1 < kFrames; ++t) window.frames[std::size_t(t)]->motion = MotionRuns(still);
    test::set_data(window, [&](RowSet set, std::uint64_t address) {
      const double variance = set == RowSet::kPrimal ? m.primal
                              : set <= RowSet::kDy   ? m.gradient
                                                     : m.ratio * m.gradient;
      return std::sqrt(variance) * test::normal(std::uint64_t(n) + 100, address);
    });
    PlanarFrames x = test::primal_data(window);
    const auto frames = window.span();
    solve_poisson(frames, settings, x);
    CosineTransform::Scratch scratch;
    std::vector<float> series(std::size_t(kFrames) * kLanes);
    for (int y = 0; y < kSize; ++y) {
      for (int x0 = 0; x0 < kSize; x0 += kLanes) {
        for (int c = 0; c < 3; ++c) {
          for (int t = 0; t < kFrames; ++t) std::copy_n(x.row(t, y, c) + x0, kLanes, &series[std::size_t(t * kLanes)]);
          transform.forward(series.data(), scratch);
          for (std::size_t i = 0; i < series.size(); ++i) {
            power[i / kLanes] += double(series[i]) * double(series[i]) / (3.0 * kSize * kSize * repeats);
          }
        }
      }
    }
  }
  return power;
}

std::string spectra() {
  std::string out = "{";
  const auto add = [&](const char* name, const test::NoiseModel& m) {
    out += fmt::format("{}\"{}\": [{:.4e}]", out.size() > 1 ? ", " : "", name, fmt::join(spectrum(m, 1), ", "));
  };
  test::NoiseModel m;
  m.rows = test::TemporalRows::kNone;
  add("gpt", m);
  m.rows = test::TemporalRows::kFirstOrder;
  add("first", m);
  m.rows = test::TemporalRows::kFull;
  for (const double c : {0.5, 1.0, 1.5, 2.0}) {
    m.ratio = c;
    add(fmt::format("full {}", c).c_str(), m);
  }
  return out + "}";
}

}  // namespace

int main(int argc, char** argv) try {
  int width = 1280, height = 720, frames = 10, threads = 0;
  std::vector<std::string> schedules{"fast"};
  PoissonNorm norm = PoissonNorm::kL1;
  bool want_spectrum = false;
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    const std::string v = i + 1 < argc ? argv[i + 1] : "";
    if (a == "--spectrum") {
      want_spectrum = true;
      continue;
    }
    ++i;
    if (a == "--size" && std::sscanf(v.c_str(), "%dx%d", &width, &height) == 2) continue;
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
  fmt::print("{}\n", want_spectrum ? spectra() : time_and_error(width, height, frames, threads, schedules, norm));
  return 0;
} catch (const Error& e) {
  fmt::print(stderr, "{}\n", e.what());
  return exit_status(e.code());
}
