// SPDX-License-Identifier: Apache-2.0
#pragma once
// Keyed hashing: stateless numbers that are a function of their address alone. There is no generator with state.
#include <bit>
#include <cstdint>

namespace tempera {

/// Bijective mixing of 64 bits (the finaliser of splitmix64).
constexpr std::uint64_t mix64(std::uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9ull;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}
/// Order-dependent combination of words into one well-mixed key.
constexpr std::uint64_t hash_key(std::uint64_t a) { return mix64(a + 0x9e3779b97f4a7c15ull); }
template <class... Rest>
constexpr std::uint64_t hash_key(std::uint64_t a, std::uint64_t b, Rest... rest) {
  return hash_key(mix64(a + 0x9e3779b97f4a7c15ull) ^ (b * 0xd6e8feb86659fd93ull), std::uint64_t(rest)...);
}
/// Uniform float in [0,1) from the top 24 of 32 bits: never 1.
constexpr float to_unit_float(std::uint32_t bits) { return float(bits >> 8) * 0x1p-24f; }

}  // namespace tempera
