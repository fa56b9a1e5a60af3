// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures with noise of known variance, for tests of filters.
#include <cmath>

#include "denoise/planes.h"
#include "tempera/core/random.h"

namespace tempera::denoise {

/// Normal deviate of a pixel.
inline float deviate(std::uint64_t seed, int x, int y, int c) {
  const auto uniform = [&](std::uint64_t k) {
    const std::uint64_t h =
        hash_key(hash_key(hash_key(seed * 7 + k, std::uint64_t(x)), std::uint64_t(y)), std::uint64_t(c));
    return (double(h >> 11) + 0.5) / double(1ull << 53);
  };
  return float(std::sqrt(-2 * std::log(uniform(1))) * std::cos(6.283185307179586 * uniform(2)));
}

template <class F>
Planes picture(int width, int height, int channels, const F& f) {
  Planes out(width, height, channels);
  for (int c = 0; c < channels; ++c) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) out.row(c, y)[x] = f(x, y, c);
    }
  }
  return out;
}

inline double mean_square(const Planes& a, const Planes& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.values().size(); ++i) sum += std::pow(double(a.values()[i] - b.values()[i]), 2);
  return sum / double(a.values().size());
}

/// Independent halves, with noise of standard deviation sigma, of what `truth` says.
struct Noisy {
  Planes a, b, variance;
};
template <class F>
Noisy noisy(int width, int height, float sigma, const F& truth) {
  const auto half = [&](std::uint64_t seed) {
    return picture(width, height, 3, [&](int x, int y, int c) { return truth(x, y) + sigma * deviate(seed, x, y, c); });
  };
  Noisy out{half(11), half(12), {}};
  out.variance = half_variance(out.a, out.b, 3);
  return out;
}

}  // namespace tempera::denoise
