// SPDX-License-Identifier: Apache-2.0
#pragma once
// Values as bytes, for checkpoints: written by the program that reads them, on one kind of machine.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "tempera/core/error.h"

namespace tempera {

using Bytes = std::vector<std::byte>;

/// Hands values on, as bytes, to where they are stored.
class ByteWriter {
 public:
  explicit ByteWriter(std::function<void(const void*, std::size_t)> store) : store_(std::move(store)) {}
  /// Appends to `out`, which must outlive this.
  explicit ByteWriter(Bytes& out)
      : ByteWriter([&out](const void* data, std::size_t n) {
          const auto* first = static_cast<const std::byte*>(data);
          out.insert(out.end(), first, first + n);
        }) {}

  void bytes(const void* data, std::size_t n) { store_(data, n); }
  template <class T>
  void value(const T& v) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&v, sizeof v);
  }
  /// The values with their number.
  template <class T>
  void values(std::span<const T> v) {
    static_assert(std::is_trivially_copyable_v<T>);
    value(std::uint64_t(v.size()));
    if (!v.empty()) bytes(v.data(), v.size_bytes());
  }
  template <class T>
  void values(const std::vector<T>& v) {
    values(std::span<const T>(v));
  }
  void text(const std::string& s) { values(std::span<const char>(s)); }

 private:
  std::function<void(const void*, std::size_t)> store_;
};

/// Reads what a ByteWriter wrote. Errors: Error{kBadInput} where it ends too early, or a length cannot be.
class ByteReader {
 public:
  /// `load` fills the place that it gets; returns false if there are not as many bytes.
  explicit ByteReader(std::function<bool(void*, std::size_t)> load) : load_(std::move(load)) {}
  /// From memory that outlives this.
  explicit ByteReader(std::span<const std::byte> from)
      : ByteReader([from](void* data, std::size_t n) mutable {
          if (n > from.size()) return false;
          std::memcpy(data, from.data(), n);
          from = from.subspan(n);
          return true;
        }) {}

  void bytes(void* data, std::size_t n) {
    if (!load_(data, n)) throw Error(ErrorCode::kBadInput, "it ends too early");
  }
  template <class T>
  void value(T& v) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&v, sizeof v);
  }
  template <class T>
  T value() {
    T v;
    value(v);
    return v;
  }
  template <class T>
  void values(std::vector<T>& v) {
    // In blocks, so that a length that is damaged ends where the data do and not where the memory does.
    constexpr std::uint64_t kBlock = std::uint64_t(1) << 16;
    auto left = value<std::uint64_t>();
    v.clear();
    while (left > 0) {
      const std::size_t n = std::min(left, kBlock), at = v.size();
      v.resize(at + n);
      bytes(v.data() + at, n * sizeof(T));
      left -= n;
    }
  }
  std::string text() {
    std::vector<char> v;
    values(v);
    return {v.begin(), v.end()};
  }

 private:
  std::function<bool(void*, std::size_t)> load_;
};

}  // namespace tempera
