// SPDX-License-Identifier: Apache-2.0
#pragma once
// SIGINT and SIGTERM as a stop token: the first one asks for an orderly end.
#include <stop_token>
#include <thread>

namespace tempera {

/// Catches SIGINT and SIGTERM while alive; one object per process. A second SIGINT ends the process at once. Further
/// SIGTERMs do nothing: job systems send several while they wait for the checkpoint, and have SIGKILL for the rest.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;
  std::stop_token token() const { return source_.get_token(); }
  /// The first signal that came; 0 if none did.
  static int signal();

 private:
  std::stop_source source_;
  std::thread thread_;
};

}  // namespace tempera
