// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/stage_progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <mutex>
#include <nlohmann/json.hpp>

#include "tempera/core/log.h"

namespace tempera {

namespace {

void print(std::FILE* out, const std::string& text) {
  std::fwrite(text.data(), 1, text.size(), out);
  std::fflush(out);
}

/// Keeps count, and lets `update` come no more often than every `interval` seconds.
class Counting : public StageObserver {
 public:
  void begin(const std::vector<int>& frames, const std::vector<int>& skipped) override {
    begin_ = last_ = Clock::now();
    frames_ = frames.size(), skipped_ = skipped.size();
    started(frames);
  }
  void progress(double share) override {
    share_ = share;
    if (seconds_since(last_) < interval_) return;
    last_ = Clock::now();
    update();
  }
  void frame_done(int frame, const std::string& path) override {
    ++done_;
    finished_frame(frame, path);
  }

 protected:
  using Clock = std::chrono::steady_clock;
  explicit Counting(double interval) : interval_(interval) {}
  virtual void started(const std::vector<int>& /*frames*/) {}
  virtual void update() {}
  virtual void finished_frame(int /*frame*/, const std::string& /*path*/) {}

  static double seconds_since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }
  /// Negative while there is nothing to judge by.
  double seconds_left() const { return share_ > 0 ? seconds_since(begin_) * (1 - share_) / share_ : -1; }
  static std::string done_line(int frame, const std::string& path) {
    return fmt::format("frame {} done: path={}\n", frame, path);
  }

  double share_ = 0;
  std::size_t frames_ = 0, skipped_ = 0, done_ = 0;

 private:
  double interval_;
  Clock::time_point begin_, last_;
};

class Plain : public Counting {
 public:
  Plain() : Counting(1e9) {}

 protected:
  void finished_frame(int frame, const std::string& path) override {
    if (log_level() >= LogLevel::kInfo) print(stderr, done_line(frame, path));
  }
};

class Bar : public Counting {
 public:
  Bar() : Counting(0.1) {
    set_log_writer([this](std::string_view line) {
      const std::scoped_lock lock(mutex_);
      print(stderr, "\r\033[K" + std::string(line) + bar_);
    });
  }
  ~Bar() override {
    set_log_writer({});
    draw("");
  }

 protected:
  void update() override {
    constexpr int kWidth = 32;
    const int full = int(share_ * kWidth);
    const double left = seconds_left();
    draw(fmt::format("[{:=<{}}{:{}}] {:5.1f} %  {} of {} frames  {}", "", full, "", kWidth - full, 100 * share_, done_,
                     frames_, left < 0 ? "" : fmt::format("{}:{:02} left", long(left) / 60, long(left) % 60)));
  }
  void finished_frame(int, const std::string&) override { update(); }
  void end(double) override { draw(""); }

 private:
  void draw(std::string bar) {
    const std::scoped_lock lock(mutex_);
    if (bar.empty() && bar_.empty()) return;
    bar_ = std::move(bar);
    print(stderr, "\r\033[K" + bar_);
  }
  std::mutex mutex_;
  std::string bar_;
};

class Json : public Counting {
 public:
  explicit Json(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  static void event(const nlohmann::ordered_json& j) {
    print(stdout, j.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
  }
  void started(const std::vector<int>& frames) override {
    event({{"event", "start"}, {"frames", frames}, {"skipped", skipped_}});
  }
  void update() override {
    event({{"event", "progress"}, {"percent", 100 * step_.share(share_)}, {"seconds_left", seconds_left()}});
  }
  void finished_frame(int frame, const std::string& path) override {
    event({{"event", "done"}, {"frame", frame}, {"path", path}});
  }
  void end(double seconds) override {
    event({{"event", "end"}, {"frames", done_}, {"skipped", skipped_}, {"seconds", seconds}});
  }

 private:
  JobStep step_;
};

class OpenJd : public Counting {
 public:
  explicit OpenJd(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  void started(const std::vector<int>& frames) override {
    progress_line(0);
    print(stdout, fmt::format("openjd_status: {} frames to do, {} finished before\n", frames.size(), skipped_));
  }
  void update() override { progress_line(share_); }
  void finished_frame(int frame, const std::string& path) override { print(stdout, done_line(frame, path)); }
  void end(double seconds) override {
    progress_line(1);
    print(stdout, fmt::format("openjd_status: {} frames done in {:.0f} seconds\n", done_, seconds));
  }

 private:
  void progress_line(double part) const {
    print(stdout, fmt::format("openjd_progress: {:.2f}\n", 100 * step_.share(part)));
  }
  JobStep step_;
};

}  // namespace

std::unique_ptr<StageObserver> make_stage_progress(ProgressKind kind, const JobStep& step) {
  // A bar written into a file would be one endless line.
  if (kind == ProgressKind::kAuto || kind == ProgressKind::kTty) {
    kind = isatty(STDERR_FILENO) ? ProgressKind::kTty : ProgressKind::kPlain;
  }
  switch (kind) {
    case ProgressKind::kTty:
      return std::make_unique<Bar>();
    case ProgressKind::kJson:
      return std::make_unique<Json>(step);
    case ProgressKind::kOpenJd:
      return std::make_unique<OpenJd>(step);
    case ProgressKind::kNone:
      return std::make_unique<StageObserver>();
    default:
      return std::make_unique<Plain>();
  }
}

}  // namespace tempera
