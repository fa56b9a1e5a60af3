// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/stage_progress.h"

#include <fmt/format.h>

#include <chrono>

#include "progress_output.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

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
    if (log_level() >= LogLevel::kInfo) write_now(stderr, done_line(frame, path));
  }
};

class Bar : public Counting {
 public:
  Bar() : Counting(0.1) {}

 protected:
  void update() override {
    const double left = seconds_left();
    bar_.show(share_, fmt::format("{:5.1f} %  {} of {} frames  {} left", 100 * share_, done_, frames_,
                                  left < 0 ? "?" : clock_text(left)));
  }
  void finished_frame(int, const std::string&) override { update(); }
  void end(double) override { bar_.hide(); }

 private:
  ProgressBar bar_;
};

class Json : public Counting {
 public:
  explicit Json(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  void started(const std::vector<int>& frames) override {
    write_event({{"event", "start"}, {"frames", frames}, {"skipped", skipped_}});
  }
  void update() override {
    write_event({{"event", "progress"}, {"percent", 100 * step_.share(share_)}, {"seconds_left", seconds_left()}});
  }
  void finished_frame(int frame, const std::string& path) override {
    write_event({{"event", "done"}, {"frame", frame}, {"path", path}});
  }
  void end(double seconds) override {
    write_event({{"event", "end"}, {"frames", done_}, {"skipped", skipped_}, {"seconds", seconds}});
  }

 private:
  JobStep step_;
};

class OpenJd : public Counting {
 public:
  explicit OpenJd(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  void started(const std::vector<int>& frames) override {
    write_openjd_progress(step_, 0);
    write_now(stdout, fmt::format("openjd_status: {} frames to do, {} finished before\n", frames.size(), skipped_));
  }
  void update() override { write_openjd_progress(step_, share_); }
  void finished_frame(int frame, const std::string& path) override { write_now(stdout, done_line(frame, path)); }
  void end(double seconds) override {
    write_openjd_progress(step_, 1);
    write_now(stdout, fmt::format("openjd_status: {} frames done in {}\n", done_, clock_text(seconds)));
  }

 private:
  JobStep step_;
};

}  // namespace

std::unique_ptr<StageObserver> make_stage_progress(ProgressKind kind, const JobStep& step) {
  return make_observer<StageObserver, Plain, Bar, Json, OpenJd>(kind, step);
}

}  // namespace tempera
