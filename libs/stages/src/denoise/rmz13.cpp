// SPDX-License-Identifier: Apache-2.0
// Symbols: u → color, V → variance, F_k → candidates, dF_k/du → JointResult::derivative, k_c → k_color, k_f → k_feature,
// tau → JointFilter::tau, f → patch, R → window
#include "denoise/rmz13.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace tempera::denoise {

namespace {

constexpr int kColor = 0, kBalanced = 1, kFeatures = 2, kFilters = 3;
constexpr std::array<JointFilter, kFilters> kCandidates{JointFilter{.patch = 1, .color = true, .tau = 1e-3f},
                                                        JointFilter{.patch = 3, .color = true, .tau = 1e-3f},
                                                        JointFilter{.patch = 1, .color = false, .tau = 1e-4f}};
constexpr JointFilter kSecondPass{.patch = 3, .color = true, .tau = 1e-4f};
constexpr int kWindow = 10, kSecondWindow = 5, kErrorWindow = 1, kSelectionWindow = 5, kPrefilterWindow = 5;

template <class F>
Planes made(int width, int height, int channels, const F& f) {
  Planes out(width, height, channels);
  for_rows(height, [&](int y) {
    for (int c = 0; c < channels; ++c) {
      float* to = out.row(c, y);
      for (int x = 0; x < width; ++x) to[x] = f(c, y, x);
    }
  });
  return out;
}

/// Values smoothed where the colors of `guide` are alike.
Planes smoothed(const Planes& values, const Planes& guide, const Planes& variance, int window, float floor) {
  const JointFilter by_color{.patch = 3};
  const JointFrame frame{.guide = &guide, .variance = &variance, .values = &values};
  const JointSettings settings{.window = window, .k_color = 1, .floor = floor};
  return std::move(joint_filter(std::span(&frame, 1), std::span(&by_color, 1), settings)[0].values);
}

}  // namespace

Planes bounded_variance(const Planes& means, int samples) {
  const int width = means.width(), height = means.height();
  return made(width, height, means.channels(), [&](int c, int y, int x) {
    const float here = means.row(c, y)[x];
    float least = here, most = here;
    for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
      for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i)
        least = std::min(least, means.row(c, j)[i]), most = std::max(most, means.row(c, j)[i]);
    }
    return (here - least) * (most - here) / float(samples);
  });
}

Feature prefilter(Feature feature) {
  const std::vector<float>& v = feature.variance.values();
  if (v.empty() || *std::max_element(v.begin(), v.end()) < 1e-6f) return feature;
  const JointFilter alone{.patch = 3};
  const JointFrame frame{.guide = &feature.values, .variance = &feature.variance, .values = &feature.values};
  const JointSettings settings{.window = kPrefilterWindow, .k_color = 1};
  JointResult r = std::move(joint_filter(std::span(&frame, 1), std::span(&alone, 1), settings)[0]);
  for (int c = 0; c < feature.variance.channels(); ++c) {
    for (std::size_t i = 0; i < r.gain.pixels(); ++i) feature.variance.plane(c)[i] *= r.gain.plane(0)[i];
  }
  return {std::move(r.values), std::move(feature.variance)};
}

void FeatureStack::add(const Feature& feature) {
  const int channels = feature.values.channels();
  const auto append = [&](Planes& to, const Planes& from) {
    Planes all(feature.values.width(), feature.values.height(), to.channels() + channels);
    std::copy(to.values().begin(), to.values().end(), all.values().begin());
    if (!from.empty()) std::copy(from.values().begin(), from.values().end(), all.plane(to.channels()));
    to = std::move(all);
  };
  append(values, feature.values), append(variance, feature.variance);
  groups.push_back(channels);
}

Rmz13Result rmz13(const Rmz13Input& in) {
  const int width = in.a.width(), height = in.a.height();
  const bool halves = !in.b.empty();
  const auto mean_of = [&](const Planes& ab) {  // of the halves, which lie one after the other
    if (!halves) return ab;
    return made(width, height, 3, [&](int c, int y, int x) { return 0.5f * (ab.row(c, y)[x] + ab.row(c + 3, y)[x]); });
  };
  Planes noisy = in.a;
  if (halves) {
    noisy = Planes(width, height, 6);
    std::copy(in.a.values().begin(), in.a.values().end(), noisy.plane(0));
    std::copy(in.b.values().begin(), in.b.values().end(), noisy.plane(3));
  }
  const Planes u = mean_of(noisy);
  double brightness = 0;
  for (const float v : u.values()) brightness += double(v) / double(u.values().size());
  // The published 1e-10 is for pictures of brightness 1.
  const float floor = float(1e-10 * brightness * brightness + 1e-30);

  JointFrame frame{.guide = &u, .variance = &in.variance, .values = &noisy};
  JointSettings settings{.window = kWindow, .floor = floor, .derivative = true};
  if (!in.features.groups.empty()) {
    frame.features = &in.features.values, frame.feature_variance = &in.features.variance;
    settings.feature_groups = in.features.groups;
  }
  const std::vector<JointResult> filtered = joint_filter(std::span(&frame, 1), kCandidates, settings);

  Rmz13Result out{.candidates = Planes(width, height, 3 * kFilters), .errors = Planes(width, height, kFilters)};
  std::vector<Planes> derivatives;  // means of the channels
  for (int k = 0; k < kFilters; ++k) {
    const JointResult& r = filtered[std::size_t(k)];
    const Planes f = mean_of(r.values);
    std::copy(f.values().begin(), f.values().end(), out.candidates.plane(3 * k));
    // Stein's unbiased estimate of the squared error. [Rousselle 2013]
    const Planes error = made(width, height, 1, [&](int, int y, int x) {
      float sum = 0;
      for (int c = 0; c < 3; ++c) {
        const float d = f.row(c, y)[x] - u.row(c, y)[x], v = in.variance.row(c, y)[x];
        sum += d * d + 2 * v * r.derivative.row(c, y)[x] - v;
      }
      return sum / 3;
    });
    std::copy(error.values().begin(), error.values().end(), out.errors.plane(k));
    derivatives.push_back(made(width, height, 1, [&](int, int y, int x) {
      return r.derivative.row(0, y)[x] + r.derivative.row(1, y)[x] + r.derivative.row(2, y)[x];
    }));
  }

  const Planes errors = smoothed(out.errors, u, in.variance, kErrorWindow, floor);
  Planes best(width, height, kFilters);
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      int k = errors.row(kBalanced, y)[x] <= errors.row(kFeatures, y)[x] ? kBalanced : kFeatures;
      // What keeps colors keeps outliers, too: there it changes with the pixel more than the balanced filter.
      const bool spike = derivatives[kColor].row(0, y)[x] > derivatives[kBalanced].row(0, y)[x];
      if (!spike && errors.row(kColor, y)[x] < errors.row(k, y)[x]) k = kColor;
      best.row(k, y)[x] = 1;
    }
  });
  // Weights add up to 1, so what is averaged of three maps that do does as well.
  out.selection = smoothed(best, u, in.variance, kSelectionWindow, floor);
  const Planes blended = made(width, height, noisy.channels(), [&](int c, int y, int x) {
    float sum = 0;
    for (int k = 0; k < kFilters; ++k) sum += out.selection.row(k, y)[x] * filtered[std::size_t(k)].values.row(c, y)[x];
    return sum;
  });
  out.color = mean_of(blended);
  if (!halves) return out;

  // What the halves still differ by is the noise that remains.
  const Planes remaining = made(width, height, 3, [&](int c, int y, int x) {
    const float d = blended.row(c, y)[x] - blended.row(c + 3, y)[x];
    return 0.25f * d * d;
  });
  frame.guide = &out.color, frame.variance = &remaining, frame.values = &out.color;
  settings.window = kSecondWindow, settings.derivative = false;
  Planes second = std::move(joint_filter(std::span(&frame, 1), std::span(&kSecondPass, 1), settings)[0].values);
  out.color = std::move(second);
  return out;
}

}  // namespace tempera::denoise
