// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <fmt/format.h>

#include <chrono>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"
#include "tempera/pipeline/stage_progress.h"

namespace tempera {

namespace {

struct RunFlags {
  RenderFlags render;
  bool no_video = false;
};

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// The steps of a plan in their order.
std::vector<JobStep> steps_of(const RunPlan& plan) {
  std::vector<JobStep> steps{{.name = "render"}};
  if (plan.reconstructs) steps.push_back({.name = "reconstruct"});
  if (!plan.video_path.empty()) steps.push_back({.name = "video"});
  // Guesses at how much of the time is over when a step begins.
  const auto begin_of = [](const JobStep& s) { return s.name == "render" ? 0.0 : s.name == "video" ? 0.98 : 0.8; };
  for (std::size_t i = 0; i < steps.size(); ++i) {
    steps[i].number = int(i + 1), steps[i].of = int(steps.size());
    steps[i].begin = begin_of(steps[i]);
    steps[i].end = i + 1 < steps.size() ? begin_of(steps[i + 1]) : 1;
  }
  return steps;
}

/// Refuses before rendering what could not be written after it. Errors: Error{kFailed}.
void check_writable(const RunPlan& plan) {
  for (const std::string& path : {frame_path(plan.output, plan.frames.front()), plan.video_path}) {
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

void run_shot(Program& program, RunFlags& flags) {
  const ProgressKind kind = flags.render.progress_kind(program);
  RunPlan plan;
  std::vector<JobStep> steps;
  std::vector<JobResult> results;
  double begin = now();
  const auto finished = [&](const std::string& path) {
    results.push_back({steps[results.size()].name, now() - begin, path});
    begin = now();
  };

  render_shot(program, flags.render, [&](const ShotConfig& config, Shot& shot, RenderOptions& options) {
    plan = plan_run(config, shot, !flags.no_video);
    shot = plan.render;
    options.reuse = plan.neighbors;
    if (!flags.render.replay.empty()) return;
    check_writable(plan);
    steps = steps_of(plan);
    flags.render.step = steps[0];
    announce_step(kind, steps[0]);
    if (plan.neighbors.empty()) return;
    log_info(fmt::format("frames {} are rendered as well, because the reconstruction needs them",
                         describe_frames(plan.neighbors)));
  });
  if (!flags.render.replay.empty()) return;
  finished(plan.render.output);

  with_threads(flags.render.shot.threads(), [&] {
    if (plan.reconstructs) {
      const JobStep& step = steps[results.size()];
      announce_step(kind, step);
      ReconstructOptions options{.params = plan.render.reconstruct,
                                 .frames = plan.frames,
                                 .sequence = plan.sequence,
                                 .resume = flags.render.resume,
                                 .write = plan.render.final_write,
                                 .command = program.command_line()};
      reconstruct_frames(FrameSequence(plan.render.output, plan.render.frames), plan.output, options,
                         *make_stage_progress(kind, step), program.stop);
      finished(plan.output);
    }
    if (!plan.video_path.empty()) {
      announce_step(kind, steps[results.size()]);
      make_movie_of(program, plan, FrameSequence(plan.output, plan.frames), flags.render.resume);
      finished(plan.video_path);
    }
  });
  announce_results(kind, results);
}

}  // namespace

void add_run(Program& program) {
  auto flags = std::make_shared<RunFlags>();
  CLI::App* command = program.add(
      "run",
      "Do all that a shot asks for: render its frames, reconstruct them where the integrator needs it, make a movie.",
      {"tempera run shot.toml", "tempera run shot.toml -o out/take2 --integrator temporal_gradient_path --spp 32",
       "tempera run shot.toml --resume   (continues what was stopped, in any step)",
       "tempera run shot.toml --frames 1-50 --no-video   (one part of many: the same bits as all at once)"},
      [&program, flags] {
        run_shot(program, *flags);
        return 0;
      });
  flags->render.add_to(*command);
  command->add_flag("--no-video", flags->no_video, "make no movie");
}

}  // namespace tempera
