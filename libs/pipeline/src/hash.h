// SPDX-License-Identifier: Apache-2.0
#pragma once
// Hashes of text and bytes for fingerprints: not cryptographic, the same on every machine of one byte order.
#include <fmt/format.h>

#include <cstring>
#include <string>
#include <string_view>

#include "tempera/core/random.h"

namespace tempera {

inline std::uint64_t hash_bytes(std::string_view bytes, std::uint64_t seed = 0) {
  std::uint64_t h = hash_key(seed, bytes.size());
  while (!bytes.empty()) {
    std::uint64_t word = 0;
    const std::size_t n = bytes.size() < 8 ? bytes.size() : 8;
    std::memcpy(&word, bytes.data(), n);
    h = hash_key(h, word);
    bytes.remove_prefix(n);
  }
  return h;
}

/// 32 hexadecimal digits.
inline std::string hash_hex(std::string_view bytes) {
  return fmt::format("{:016x}{:016x}", hash_bytes(bytes, 1), hash_bytes(bytes, 2));
}

}  // namespace tempera
