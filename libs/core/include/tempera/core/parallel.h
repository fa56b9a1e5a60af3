// SPDX-License-Identifier: Apache-2.0
#pragma once
// Parallel loops. Work is split into units that do not depend on the thread count, so results cannot either.
#include <cstdint>
#include <functional>

namespace tempera {

/// Runs `body` so that its parallel loops use `threads` threads (0: all hardware threads); more threads than cores are
/// allowed. Returns when `body` has; rethrows its exception.
void with_threads(int threads, const std::function<void()>& body);

/// Threads that a parallel loop started here would use.
int thread_count();

/// Calls body(i) for i in [begin, end), in any order, on many threads. An exception of a body stops the loop and is
/// rethrown. `grain` consecutive indices go to one task.
void parallel_for(std::int64_t begin, std::int64_t end, const std::function<void(std::int64_t)>& body,
                  std::int64_t grain = 1);

/// As parallel_for, for the rows [begin, end) of a picture.
void parallel_rows(int begin, int end, const std::function<void(int)>& body, std::int64_t grain = 1);

/// Flushes denormals to zero on the calling thread while alive; Embree and filters need it for speed.
class FlushDenormals {
 public:
  FlushDenormals();
  ~FlushDenormals();
  FlushDenormals(const FlushDenormals&) = delete;
  FlushDenormals& operator=(const FlushDenormals&) = delete;

 private:
  unsigned saved_;
};

}  // namespace tempera
