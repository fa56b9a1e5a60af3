// SPDX-License-Identifier: Apache-2.0
#include "tempera/core/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#if defined(__SSE__)
#include <immintrin.h>
#endif
#ifdef TEMPERA_TSAN
#include <sanitizer/tsan_interface.h>
#endif

namespace tempera {

namespace {

/// Tells the thread sanitizer what it cannot see in TBB, which is not instrumented (and so this file is not, either):
/// tasks happen after their loop begins and before it ends, and in no order among each other.
class ForkJoin {
 public:
#ifdef TEMPERA_TSAN
  ForkJoin() { __tsan_release(&fork_); }
  ~ForkJoin() { __tsan_acquire(&join_); }
  struct Task {
    explicit Task(ForkJoin& of) : loop(of) { __tsan_acquire(&loop.fork_); }
    ~Task() { __tsan_release(&loop.join_); }
    ForkJoin& loop;
  };

 private:
  char fork_ = 0, join_ = 0;
#else
  struct Task {
    explicit Task(ForkJoin&) {}
  };
#endif
};

}  // namespace

void with_threads(int threads, const std::function<void()>& body) {
  const int n = threads > 0 ? threads : tbb::info::default_concurrency();
  const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, n);
  tbb::task_arena arena(n);
  ForkJoin order;
  arena.execute([&] {
    const ForkJoin::Task task(order);
    body();
  });
}

int thread_count() { return tbb::this_task_arena::max_concurrency(); }

void parallel_for(std::int64_t begin, std::int64_t end, const std::function<void(std::int64_t)>& body,
                  std::int64_t grain) {
  ForkJoin order;
  tbb::parallel_for(
      tbb::blocked_range<std::int64_t>(begin, end, grain),
      [&](const tbb::blocked_range<std::int64_t>& r) {
        const FlushDenormals flush;
        const ForkJoin::Task task(order);
        for (std::int64_t i = r.begin(); i != r.end(); ++i) body(i);
      },
      tbb::simple_partitioner());
}

void parallel_rows(int begin, int end, const std::function<void(int)>& body, std::int64_t grain) {
  parallel_for(
      begin, end, [&](std::int64_t y) { body(int(y)); }, grain);
}

#if defined(__SSE__)
FlushDenormals::FlushDenormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040u); }
FlushDenormals::~FlushDenormals() { _mm_setcsr(saved_); }
#else
FlushDenormals::FlushDenormals() : saved_(0) {}
FlushDenormals::~FlushDenormals() = default;
#endif

}  // namespace tempera
