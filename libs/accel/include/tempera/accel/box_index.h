// SPDX-License-Identifier: Apache-2.0
#pragma once
// Which of many boxes hold a point: footprints of photons, bounds of records.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <type_traits>

#include "tempera/core/vec.h"

namespace tempera {

/// Threads: visits are re-entrant.
class BoxIndex {
 public:
  /// Boxes are closed; those that are empty or have a bound that is no number hold nothing. They are copied.
  /// Errors: Error{kOutOfMemory}. Range: fewer than 2^32 boxes.
  explicit BoxIndex(std::span<const Bounds3f> boxes);
  ~BoxIndex();
  BoxIndex(BoxIndex&&) noexcept;
  BoxIndex& operator=(BoxIndex&&) noexcept;
  BoxIndex(const BoxIndex&) = delete;
  BoxIndex& operator=(const BoxIndex&) = delete;

  /// Calls f(index) once for each box that holds p, with its std::size_t index among those given. The order is not
  /// defined and may differ between runs: what is summed must not depend on it. f must not throw.
  template <class F>
  void visit(const Vec3f& p, F&& f) const {
    using Function = std::remove_reference_t<F>;
    const Visitor visitor = [](const void* user, std::size_t index) {
      (*static_cast<Function*>(const_cast<void*>(user)))(index);
    };
    query(p, visitor, std::addressof(f));
  }

 private:
  using Visitor = void (*)(const void* user, std::size_t index);
  void query(const Vec3f& p, Visitor visitor, const void* user) const;

  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace tempera
