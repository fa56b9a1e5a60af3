// SPDX-License-Identifier: Apache-2.0
#pragma once
// A stack of bounded size for values that hot loops make by the million.
#include <cstddef>
#include <new>
#include <type_traits>

#include "tempera/core/error.h"

namespace tempera {

/// Up to N values in uninitialised storage: an empty one costs nothing to make.
template <class T, int N>
class FixedStack {
 public:
  int size() const { return size_; }
  const T& operator[](int i) const { return std::launder(reinterpret_cast<const T*>(storage_))[i]; }
  T& operator[](int i) { return std::launder(reinterpret_cast<T*>(storage_))[i]; }
  const T* begin() const { return std::launder(reinterpret_cast<const T*>(storage_)); }
  const T* end() const { return begin() + size_; }
  void clear() { size_ = 0; }
  /// Appends and returns the index. More than N is an assertion failure; without assertions the value is dropped and
  /// the last index returned.
  int push(const T& value) {
    return push_made([&]() -> const T& { return value; });
  }
  /// The same for what make() returns, made in place.
  template <class Make>
  int push_made(Make&& make) {
    TEMPERA_ASSERT(size_ < N);
    if (size_ < N) new (storage_ + std::size_t(size_++) * sizeof(T)) T(make());
    return size_ - 1;
  }

 private:
  static_assert(std::is_trivially_copyable_v<T>);
  int size_ = 0;
  alignas(T) std::byte storage_[N * sizeof(T)];
};

}  // namespace tempera
