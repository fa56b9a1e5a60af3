// SPDX-License-Identifier: Apache-2.0
#include "interrupt.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>

#include "tempera/core/log.h"

namespace tempera {

namespace {

// A handler may only touch lock-free atomics and call write and _exit; a thread at the other end of the pipe does the
// rest.
std::atomic<int> g_first_signal{0};
int g_pipe[2] = {-1, -1};

extern "C" void on_signal(int signal) {
  const int saved = errno;
  int none = 0;
  if (!g_first_signal.compare_exchange_strong(none, signal)) {
    if (signal == SIGINT) _exit(128 + signal);
  } else {
    const char byte = 1;
    [[maybe_unused]] const ssize_t n = write(g_pipe[1], &byte, 1);
  }
  errno = saved;
}

}  // namespace

InterruptGuard::InterruptGuard() {
  if (pipe2(g_pipe, O_CLOEXEC) != 0) return;  // signals then end the process as usual
  thread_ = std::thread([this] {
    char byte = 0;
    ssize_t n = 0;
    do {
      n = read(g_pipe[0], &byte, 1);
    } while (n < 0 && errno == EINTR);
    if (n != 1 || byte != 1) return;
    log_info("stopping: work in progress is being saved; Ctrl-C ends at once without that");
    source_.request_stop();
  });
  struct sigaction action = {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

InterruptGuard::~InterruptGuard() {
  if (!thread_.joinable()) return;
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
  const char byte = 0;
  [[maybe_unused]] const ssize_t n = write(g_pipe[1], &byte, 1);
  thread_.join();
}

int InterruptGuard::signal() { return g_first_signal; }

}  // namespace tempera
