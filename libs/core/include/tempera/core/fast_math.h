// SPDX-License-Identifier: Apache-2.0
#pragma once
// Elementary functions without branches or calls, so that loops over pixels become SIMD code; private to the module.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

namespace tempera {

/// log2 of a positive normal number; absolute error below 2e-6.
inline float log2_fast(float x) {
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(x);
  // Mantissa in [sqrt(1/2), sqrt(2)), so that the series converges evenly around 1.
  const std::uint32_t shifted = bits - 0x3f3504f3u;
  const float exponent = float(std::int32_t(shifted) >> 23);
  const float m = std::bit_cast<float>((shifted & 0x007fffffu) + 0x3f3504f3u);
  // log2(m) = 2 / ln 2 * atanh(s), s = (m - 1) / (m + 1)
  const float s = (m - 1) / (m + 1), s2 = s * s;
  return exponent + s * (2.88539008f + s2 * (0.961796694f + s2 * (0.577078016f + s2 * 0.412198583f)));
}

/// 2^x for x in [-126, 126]; relative error below 1e-6.
inline float exp2_fast(float x) {
  const float whole = std::floor(x + 0.5f), f = x - whole;  // f in [-0.5, 0.5]
  const float p =
      1 +
      f * (0.693147181f + f * (0.240226507f + f * (0.0555041087f +
                                                   f * (0.00961812911f + f * (0.00133335581f + f * 0.000154035304f)))));
  return std::bit_cast<float>(std::bit_cast<std::uint32_t>(p) + (std::uint32_t(std::int32_t(whole)) << 23));
}

/// x^p for x >= 0 and p > 0; 0 for x below 1e-30.
inline float pow_fast(float x, float p) {
  const float safe = std::max(x, 1e-30f);
  const float r = exp2_fast(p * log2_fast(safe));
  return x > 1e-30f ? r : 0.0f;
}

/// sRGB encoding of x in [0,1]; absolute error below 1e-6.
inline float srgb_fast(float x) {
  const float curve = 1.055f * pow_fast(x, 1 / 2.4f) - 0.055f;
  return x <= 0.0031308f ? 12.92f * x : curve;
}

}  // namespace tempera
