// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"
#include "tempera/pipeline/memory.h"
#include "tempera/pipeline/stage_progress.h"

namespace tempera {

namespace {

struct RunFlags {
  RenderFlags render;
  bool no_video = false;
  int halo = 0;
  CLI::Option* halo_given = nullptr;
};

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// The steps of a plan in their order.
std::vector<JobStep> steps_of(const RunPlan& plan) {
  std::vector<JobStep> steps{{.name = "render"}};
  if (plan.guides) steps.push_back({.name = "guides"});
  for (const RunStage& s : plan.stages) {
    if (s.pixels) steps.push_back({.name = "pixels"});
    steps.push_back({.name = s.choice.entry->name});
  }
  const std::size_t stages = steps.size() - 1;
  if (!plan.video_path.empty()) steps.push_back({.name = "video"});
  // Guesses at how much of the time is over when a step begins.
  constexpr double kRender = 0.8, kVideo = 0.98;
  const auto begin_of = [&](std::size_t i) {
    if (i == 0) return 0.0;
    return i > stages ? kVideo
                      : kRender + (kVideo - kRender) * double(i - 1) / double(std::max<std::size_t>(stages, 1));
  };
  for (std::size_t i = 0; i < steps.size(); ++i) {
    steps[i].number = int(i + 1), steps[i].of = int(steps.size());
    steps[i].begin = begin_of(i);
    steps[i].end = i + 1 < steps.size() ? begin_of(i + 1) : 1;
  }
  return steps;
}

/// Says what the frames around those that were asked for cost, or what it costs to do without them.
void tell_halo(const RunPlan& plan, const std::vector<int>& asked) {
  std::vector<std::string> names;
  for (const RunStage& s : plan.stages) names.push_back(s.choice.entry->name);
  const std::string stages = fmt::format("{}", fmt::join(names, ", "));
  if (!plan.neighbors.empty()) {
    log_info(fmt::format("frames {} need {} more rendered around them, for {}: {}; --halo N bounds how far",
                         describe_frames(asked), plan.neighbors.size(), stages, describe_frames(plan.neighbors)));
  }
  const HaloLoss& loss = plan.loss;
  if (loss.left_out.empty()) return;
  log_warning(fmt::format(
      "halo = {} leaves out frames {}, which {} would look at: frames {} differ from those of the whole "
      "shot, as they are made as if it ended there; halo = {} leaves none out",
      plan.render.halo, describe_frames(loss.left_out), stages, describe_frames(loss.differing), loss.enough));
}

/// Refuses before rendering what could not be written after it. Errors: Error{kFailed}.
void check_writable(const RunPlan& plan) {
  std::vector<std::string> paths{frame_path(plan.output, plan.frames.front()), plan.video_path};
  if (plan.guides) paths.push_back(frame_path(plan.guides->output, plan.guides->frames.front()));
  for (const RunStage& s : plan.stages) {
    if (s.pixels) paths.push_back(frame_path(s.pixels->output, s.frames.front()));
    paths.push_back(frame_path(s.output, s.frames.front()));
  }
  for (const std::string& path : paths) {
    if (!path.empty()) const TemporaryFile probe(path);
  }
}

void make_movie_of(const Program& program, const RunPlan& plan, const FrameSequence& frames, bool resume) {
  VideoOptions options = plan.render.video;
  options.comment = movie_identity(frames, options);
  if (resume && video_has_comment(plan.video_path, options.comment)) {
    log_info(fmt::format("{} is already finished", plan.video_path));
    return;
  }
  try {
    make_movie(program, frames, plan.video_path, options);
  } catch (const Error& e) {
    throw Error(
        e.code(), e.loc(),
        fmt::format("{}; the frames are finished: {}; --resume makes only the movie", e.message(), plan.output));
  }
}

/// The steps of a job that are behind it, and the one that runs.
class Job {
 public:
  explicit Job(ProgressKind kind) : kind_(kind) {}
  ProgressKind kind() const { return kind_; }
  void plan(std::vector<JobStep> steps) { steps_ = std::move(steps); }
  const JobStep& step() const { return steps_[results_.size()]; }
  void begin() {
    begin_ = now();
    announce_step(kind_, step());
  }
  void end(const std::string& path) { results_.push_back({step().name, now() - begin_, path}); }
  void announce() const { announce_results(kind_, results_); }

 private:
  ProgressKind kind_;
  std::vector<JobStep> steps_;
  std::vector<JobResult> results_;
  double begin_ = now();
};

class WatchStages final : public RunObserver {
 public:
  explicit WatchStages(Job& job) : job_(job) {}
  std::unique_ptr<RenderObserver> begin_guides(const Shot& guides) override {
    job_.begin();
    log_frames(guides.frames, guides.output);
    return make_progress(job_.kind(), job_.step());
  }
  void end_guides(const Shot& guides, const RenderReport& report) override {
    log_render(report);
    job_.end(guides.output);
  }
  std::unique_ptr<RenderObserver> begin_pixels(const RunStage& of) override {
    job_.begin();
    log_frames(of.pixels->frames, of.pixels->output);
    return make_progress(job_.kind(), job_.step());
  }
  void end_pixels(const RunStage& of, const RenderReport& report) override {
    log_render(report);
    job_.end(of.pixels->output);
  }
  std::unique_ptr<StageObserver> begin_stage(const RunStage& stage) override {
    job_.begin();
    log_frames(stage.frames, stage.output);
    return make_stage_progress(job_.kind(), job_.step());
  }
  void end_stage(const RunStage& stage, const StageReport& report) override {
    log_stage(*stage.choice.entry, report);
    job_.end(stage.output);
  }

 private:
  Job& job_;
};

void run_shot(Program& program, RunFlags& flags) {
  if (flags.halo_given->count() > 0) flags.render.shot.preset("halo", std::to_string(flags.halo));
  Job job(flags.render.progress_kind(program));
  RunPlan plan;
  LoadedShot loaded =
      render_shot(program, flags.render, [&](const ShotConfig& config, LoadedShot& to_render, RenderOptions& options) {
        const std::vector<int> asked = to_render.shot.frames;
        plan = plan_run(config, to_render.shot, !flags.no_video);
        to_render.shot = plan.render;
        options.reuse = plan.neighbors;
        if (!flags.render.replay.empty()) return;
        check_writable(plan);
        if (plan.guides) check_memory(*plan.guides, to_render.scene, flags.render.shot.memory_limit());
        for (const RunStage& s : plan.stages) {
          if (s.pixels) check_memory(*s.pixels, to_render.scene, flags.render.shot.memory_limit());
        }
        job.plan(steps_of(plan));
        flags.render.step = job.step();
        job.begin();
        tell_halo(plan, asked);
      });
  if (!flags.render.replay.empty()) return;
  job.end(plan.render.output);
  const bool pixels =
      std::any_of(plan.stages.begin(), plan.stages.end(), [](const RunStage& s) { return s.pixels.has_value(); });
  if (!pixels && !plan.guides) loaded.scene = {};  // stages see none

  with_threads(flags.render.shot.threads(), [&] {
    WatchStages watch(job);
    run_stages(plan, loaded.scene, flags.render.options(program), watch, program.stop);
    if (!plan.video_path.empty()) {
      job.begin();
      make_movie_of(program, plan, FrameSequence(plan.output, plan.frames), flags.render.resume);
      job.end(plan.video_path);
    }
  });
  job.announce();
}

}  // namespace

void add_run(Program& program) {
  auto flags = std::make_shared<RunFlags>();
  CLI::App* command = program.add(
      "run", "Do all that a shot asks for: render its frames, run the stages that follow, make a movie.",
      {"tempera run shot.toml", "tempera run shot.toml -o out/take2 --integrator temporal_gradient_path --spp 32",
       "tempera run shot.toml --resume   (continues what was stopped, in any step)",
       "tempera run shot.toml --frames 1-50 --no-video   (one part of many: the same bits as all at once)"},
      [&program, flags] {
        run_shot(program, *flags);
        return 0;
      });
  flags->render.add_to(*command);
  flags->halo_given =
      command
          ->add_option("--halo", flags->halo,
                       "frames at most that are made around those asked for, on either side, where stages look at "
                       "several; beyond them the shot is taken to end [all that they look at]")
          ->type_name("N")
          ->check(CLI::Range(0, 1000000000).description(""));
  command->add_flag("--no-video", flags->no_video, "make no movie");
}

}  // namespace tempera
