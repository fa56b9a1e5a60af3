// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/progress.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <mutex>

#include "progress_output.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

std::string rate_text(double per_second) {
  if (per_second >= 1e6) return fmt::format("{:.2f} Msamples/s", per_second / 1e6);
  return fmt::format("{:.0f} ksamples/s", per_second / 1e3);
}

/// Counts units of work over the whole sequence; calls `update` at most every `interval` seconds.
class Counting : public RenderObserver {
 public:
  void begin(const RenderPlan& plan) override {
    const std::scoped_lock lock(mutex_);
    begin_ = last_ = now();
    frames_ = plan.frames.size();
    units_ = plan.units;
    started(plan);
  }
  void frame_begin(int frame, const Frame&, std::size_t units_done) override {
    const std::scoped_lock lock(mutex_);
    frame_ = frame;
    ++index_;
    done_ += units_done;
    brought_ += units_done;
    frame_started();
  }
  void tile_done(int, const Frame&, const Tile&, const RenderTotals& totals) override {
    const std::scoped_lock lock(mutex_);
    ++done_;
    samples_ += totals.samples;
    const double t = now();
    if (t - last_ < interval_) return;
    last_ = t;
    update();
  }
  void frame_end(const FrameReport& report) override {
    const std::scoped_lock lock(mutex_);
    frame_done(report);
  }
  void end(const RenderReport& report) override {
    const std::scoped_lock lock(mutex_);
    finished(report);
  }

 protected:
  explicit Counting(double interval) : interval_(interval) {}
  virtual void started(const RenderPlan&) {}
  virtual void frame_started() {}
  virtual void update() {}
  virtual void frame_done(const FrameReport&) {}
  virtual void finished(const RenderReport&) {}

  double fraction() const { return units_ > 0 ? std::min(1.0, double(done_) / double(units_)) : 1.0; }
  double elapsed() const { return now() - begin_; }
  /// Negative while there is nothing to judge by.
  double seconds_left() const {
    const double here = double(done_ - brought_);
    return here > 0 ? elapsed() / here * (double(units_) - double(done_)) : -1;
  }
  double samples_per_second() const { return elapsed() > 0 ? double(samples_) / elapsed() : 0; }

  std::mutex mutex_;
  int frame_ = 0;
  std::size_t index_ = 0, frames_ = 0;

 private:
  double interval_, begin_ = 0, last_ = 0;
  std::size_t units_ = 0, done_ = 0, brought_ = 0;
  std::uint64_t samples_ = 0;
};

std::string done_line(const FrameReport& r) {
  return fmt::format("frame {} done: seconds={:.3f} samples={} rays={} path={}\n", r.frame, r.seconds, r.totals.samples,
                     r.totals.rays + r.totals.shadow_rays, r.path);
}

class Plain : public Counting {
 public:
  Plain() : Counting(1e9) {}

 protected:
  void frame_done(const FrameReport& r) override {
    if (log_level() >= LogLevel::kInfo) write_now(stderr, done_line(r));
  }
};

class Bar : public Counting {
 public:
  Bar() : Counting(0.1) {}

 protected:
  void frame_started() override { update(); }
  void update() override {
    const double left = seconds_left();
    bar_.show(fraction(), fmt::format("{:5.1f} %  frame {} ({}/{})  {} elapsed  {} left  {}", 100 * fraction(), frame_,
                                      index_, frames_, clock_text(elapsed()), left < 0 ? "?" : clock_text(left),
                                      rate_text(samples_per_second())));
  }
  void frame_done(const FrameReport& r) override { bar_.write_above(done_line(r)); }
  void finished(const RenderReport&) override { bar_.hide(); }

 private:
  ProgressBar bar_;
};

class Json : public Counting {
 public:
  explicit Json(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  static nlohmann::ordered_json totals(const RenderTotals& t) {
    return {{"samples", t.samples}, {"rays", t.rays}, {"shadow_rays", t.shadow_rays}, {"bad_samples", t.bad_samples}};
  }
  void started(const RenderPlan& p) override {
    nlohmann::ordered_json layers = nlohmann::ordered_json::array();
    for (const LayerDesc& d : p.layers) layers.push_back(d.name);
    write_event({{"event", "start"},
                 {"frames", p.frames},
                 {"skipped", p.skipped},
                 {"width", p.width},
                 {"height", p.height},
                 {"spp", p.settings->spp},
                 {"layers", layers}});
  }
  void frame_started() override {
    write_event({{"event", "frame"}, {"frame", frame_}, {"index", index_}, {"of", frames_}});
  }
  void update() override {
    write_event({{"event", "progress"},
                 {"frame", frame_},
                 {"percent", 100 * step_.share(fraction())},
                 {"seconds_left", seconds_left()}});
  }
  void frame_done(const FrameReport& r) override {
    nlohmann::ordered_json j{{"event", "done"}, {"frame", r.frame}, {"seconds", r.seconds}, {"path", r.path}};
    j.update(totals(r.totals));
    write_event(j);
  }
  void finished(const RenderReport& r) override {
    nlohmann::ordered_json j{
        {"event", "end"}, {"frames", r.frames.size()}, {"skipped", r.skipped.size()}, {"seconds", r.seconds}};
    j.update(totals(r.totals));
    write_event(j);
  }

 private:
  JobStep step_;
};

class OpenJd : public Counting {
 public:
  explicit OpenJd(JobStep step) : Counting(1), step_(std::move(step)) {}

 protected:
  void progress() const { write_openjd_progress(step_, fraction()); }
  void started(const RenderPlan& p) override {
    write_openjd_progress(step_, 0);
    write_now(stdout,
              fmt::format("openjd_status: {} frames to render, {} finished before\n", p.frames.size(), p.skipped));
  }
  void frame_started() override {
    write_now(stdout, fmt::format("openjd_status: frame {} ({} of {})\n", frame_, index_, frames_));
  }
  void update() override { progress(); }
  void frame_done(const FrameReport& r) override {
    write_now(stdout, done_line(r));
    progress();
  }
  void finished(const RenderReport& r) override {
    write_now(stdout, fmt::format("openjd_status: {} frames done in {}\n", r.frames.size(), clock_text(r.seconds)));
  }

 private:
  JobStep step_;
};

}  // namespace

ProgressKind parse_progress(std::string_view text) {
  static constexpr std::array<std::pair<std::string_view, ProgressKind>, 6> kinds{{{"auto", ProgressKind::kAuto},
                                                                                   {"tty", ProgressKind::kTty},
                                                                                   {"plain", ProgressKind::kPlain},
                                                                                   {"json", ProgressKind::kJson},
                                                                                   {"openjd", ProgressKind::kOpenJd},
                                                                                   {"none", ProgressKind::kNone}}};
  std::vector<std::string> names;
  for (const auto& [name, kind] : kinds) {
    if (name == text) return kind;
    names.emplace_back(name);
  }
  throw Error(ErrorCode::kUnknownName, {"<command line>"},
              fmt::format("unknown kind of progress \"{}\"; known: {}", text, nearest_names(text, names)));
}

namespace {
/// Adds the parts of a place that are known.
void add_place(nlohmann::ordered_json& event, const SourceLoc& loc) {
  if (!loc.file.empty()) event["file"] = loc.file;
  if (loc.line > 0) event["line"] = loc.line;
  if (loc.column > 0) event["column"] = loc.column;
}
}  // namespace

void write_warning_events() {
  set_warning_observer([](const Warning& w) {
    nlohmann::ordered_json event{{"event", "warning"}, {"kind", w.kind}, {"message", w.message}, {"count", w.count}};
    add_place(event, w.loc);
    write_event(event);
  });
}

void write_error_event(const Error& error, int status) {
  nlohmann::ordered_json event{
      {"event", "error"}, {"kind", to_string(error.code())}, {"message", error.message()}, {"status", status}};
  add_place(event, error.loc());
  write_event(event);
}

void announce_step(ProgressKind kind, const JobStep& step) {
  if (kind == ProgressKind::kJson) {
    write_event({{"event", "step"}, {"step", step.name}, {"number", step.number}, {"of", step.of}});
  } else if (kind == ProgressKind::kOpenJd) {
    write_now(stdout, fmt::format("openjd_status: step {} of {}: {}\n", step.number, step.of, step.name));
  } else {
    log_info(fmt::format("step {} of {}: {}", step.number, step.of, step.name));
  }
}

void announce_results(ProgressKind kind, std::span<const JobResult> results) {
  if (kind == ProgressKind::kJson) {
    nlohmann::ordered_json list = nlohmann::ordered_json::array();
    for (const JobResult& r : results) list.push_back({{"step", r.step}, {"seconds", r.seconds}, {"path", r.path}});
    write_event({{"event", "result"}, {"steps", list}});
    return;
  }
  if (kind == ProgressKind::kOpenJd) write_now(stdout, "openjd_progress: 100.00\n");
  for (const JobResult& r : results) log_info(fmt::format("{:<12} {:>9.1f} s  {}", r.step, r.seconds, r.path));
}

std::unique_ptr<RenderObserver> make_progress(ProgressKind kind, const JobStep& step) {
  return make_observer<RenderObserver, Plain, Bar, Json, OpenJd>(kind, step);
}

}  // namespace tempera
