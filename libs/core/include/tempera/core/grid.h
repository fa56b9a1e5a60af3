// SPDX-License-Identifier: Apache-2.0
#pragma once
// A two-dimensional array of values: what a picture's pixels, or any table with rows, hold that is not an image of
// floats (see frames/image.h). Places are found in std::size_t, so that no caller multiplies a row by a width.
#include <algorithm>
#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "tempera/core/error.h"

namespace tempera {

/// `height` rows of `width` values each, one row after the other, row 0 first. Accessors do not check their arguments in
/// release builds. Threads: concurrent writes to different values are safe.
template <typename T>
class Grid {
  static_assert(!std::is_same_v<T, bool>, "values that share a byte cannot be written concurrently; use std::uint8_t");

 public:
  Grid() = default;
  /// All values `value`. Pre: sizes >= 0.
  Grid(int width, int height, const T& value = T())
      : width_(width), height_(height), values_(count(width, height), value) {}

  int width() const { return width_; }
  int height() const { return height_; }
  bool empty() const { return values_.empty(); }
  /// Number of values.
  std::size_t size() const { return values_.size(); }

  T& at(int x, int y) { return values_[index(x, y)]; }
  const T& at(int x, int y) const { return values_[index(x, y)]; }
  /// Position of (x, y) among all values: what operator[] takes.
  std::size_t index(int x, int y) const {
    TEMPERA_ASSERT(x >= 0 && y >= 0 && x < width_ && y < height_);
    return std::size_t(y) * width_ + x;
  }
  T& operator[](std::size_t i) { return values_[i]; }
  const T& operator[](std::size_t i) const { return values_[i]; }
  /// The values of row y: [width].
  std::span<T> row(int y) { return std::span(values_).subspan(row_begin(y), width_); }
  std::span<const T> row(int y) const { return std::span(values_).subspan(row_begin(y), width_); }

  T* data() { return values_.data(); }
  const T* data() const { return values_.data(); }
  auto begin() { return values_.begin(); }
  auto begin() const { return values_.begin(); }
  auto end() { return values_.end(); }
  auto end() const { return values_.end(); }
  void fill(const T& value) { std::fill(begin(), end(), value); }
  /// Another size, in the memory that there is where that is enough. Which values it then has is not specified.
  void resize(int width, int height) {
    values_.resize(count(width, height));
    width_ = width, height_ = height;
  }
  /// The same, with all values `value`.
  void assign(int width, int height, const T& value = T()) {
    values_.assign(count(width, height), value);
    width_ = width, height_ = height;
  }

  bool operator==(const Grid&) const = default;

 private:
  static std::size_t count(int width, int height) {
    TEMPERA_ASSERT(width >= 0 && height >= 0);
    return std::size_t(width) * height;
  }
  std::size_t row_begin(int y) const {
    TEMPERA_ASSERT(y >= 0 && y < height_);
    return std::size_t(y) * width_;
  }

  int width_ = 0, height_ = 0;
  std::vector<T> values_;
};

}  // namespace tempera
