// SPDX-License-Identifier: Apache-2.0
#pragma once
// Memory for solvers that work on whole rows of pixels: many rows of one length in one allocation, each aligned and
// padded with zeros so that loops vectorise and neighbours just outside of a row can be read. It knows nothing of what
// the rows mean; that is the index arithmetic of its user.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>

namespace tempera {

/// `rows` rows of `width` values, zero at first. Rows start at multiples of 64 bytes. At least one value of zero
/// follows each row and precedes the first one, and stays zero as long as nobody writes outside of [0, width).
/// Threads: concurrent writes to different rows are safe.
template <class T>
class RowBlock {
 public:
  RowBlock() = default;
  /// Pre: width > 0, rows >= 0. Errors: std::bad_alloc.
  RowBlock(int width, std::int64_t rows)
      : width_(width), rows_(rows), stride_((width + 1 + kLine - 1) / kLine * kLine), data_(allocate(size())) {
    std::fill_n(data_.get(), size(), T());
  }

  int width() const { return width_; }
  std::int64_t rows() const { return rows_; }
  /// Distance of two rows, in values; a multiple of 64 bytes.
  int stride() const { return stride_; }
  T* row(std::int64_t i) { return data_.get() + kLine + i * stride_; }
  const T* row(std::int64_t i) const { return data_.get() + kLine + i * stride_; }
  std::size_t bytes() const { return size() * sizeof(T); }

 private:
  static constexpr std::size_t kAlignment = 64;
  static constexpr int kLine = int(kAlignment / sizeof(T));
  struct Free {
    void operator()(T* p) const { ::operator delete(p, std::align_val_t(kAlignment)); }
  };
  static T* allocate(std::size_t n) {
    return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(kAlignment)));
  }
  std::size_t size() const { return rows_ * stride_ + 2 * kLine; }

  int width_ = 0;
  std::int64_t rows_ = 0;
  int stride_ = 0;
  std::unique_ptr<T[], Free> data_;
};

}  // namespace tempera
