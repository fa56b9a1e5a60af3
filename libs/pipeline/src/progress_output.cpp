// SPDX-License-Identifier: Apache-2.0
#include "progress_output.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "tempera/core/log.h"

namespace tempera {

namespace {

constexpr const char* kEraseLine = "\r\033[K";

}  // namespace

ProgressKind settle_progress(ProgressKind kind) {
  if (kind != ProgressKind::kAuto && kind != ProgressKind::kTty) return kind;
  return isatty(STDERR_FILENO) ? ProgressKind::kTty : ProgressKind::kPlain;
}

void write_now(std::FILE* out, const std::string& text) {
  std::fwrite(text.data(), 1, text.size(), out);
  std::fflush(out);
}

void write_event(const nlohmann::ordered_json& event) {
  write_now(stdout, event.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

void write_openjd_progress(const JobStep& step, double part) {
  write_now(stdout, fmt::format("openjd_progress: {:.2f}\n", 100 * step.share(part)));
}

std::string clock_text(double seconds) {
  const long s = std::lround(std::clamp(seconds, 0.0, 1e9));
  return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
                   : fmt::format("{}:{:02}", s / 60, s % 60);
}

ProgressBar::ProgressBar() {
  set_log_writer([this](std::string_view line) { write_above(std::string(line)); });
}

ProgressBar::~ProgressBar() {
  set_log_writer({});
  hide();
}

void ProgressBar::show(double part, const std::string& text) {
  winsize size{};
  const int columns = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
  const int width = std::clamp(columns - int(text.size()) - 4, 0, 40);
  std::string line;
  if (width >= 8) {
    const int full = int(part * width);
    line = fmt::format("[{:=<{}}{:{}}]", "", full, "", width - full);
  }
  draw((line + " " + text).substr(0, std::max(columns - 1, 10)));
}

void ProgressBar::write_above(const std::string& line) {
  const std::scoped_lock lock(mutex_);
  write_now(stderr, kEraseLine + line + line_);
}

void ProgressBar::draw(std::string line) {
  const std::scoped_lock lock(mutex_);
  if (line.empty() && line_.empty()) return;
  line_ = std::move(line);
  write_now(stderr, kEraseLine + line_);
}

}  // namespace tempera
