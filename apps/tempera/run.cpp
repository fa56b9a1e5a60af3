// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <fmt/format.h>

#include <algorithm>
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
  int halo = 0;
  CLI::Option* halo_given = nullptr;
};

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// The steps of a plan in their order.
std::vector<JobStep> steps_of(const RunPlan& plan) {
  std::vector<JobStep> steps{{.name = "render"}};
  for (const RunStage& s : plan.stages) steps.push_back({.name = s.choice.entry->name});
  if (!plan.video_path.empty()) steps.push_back({.name = "video"});
  // Guesses at how much of the time is over when a step begins.
  constexpr double kRender = 0.8, kVideo = 0.98;
  const double stages = std::max(1.0, double(plan.stages.size()));
  const auto begin_of = [&](std::size_t i) {
    if (i == 0) return 0.0;
    return i > plan.stages.size() ? kVideo : kRender + (kVideo - kRender) * double(i - 1) / stages;
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
  for (const RunStage& s : plan.stages) paths.push_back(frame_path(s.output, s.frames.front()));
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

void run_shot(Program& program, RunFlags& flags) {
  if (flags.halo_given->count() > 0) flags.render.shot.preset("halo", std::to_string(flags.halo));
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
    const std::vector<int> asked = shot.frames;
    plan = plan_run(config, shot, !flags.no_video);
    shot = plan.render;
    options.reuse = plan.neighbors;
    if (!flags.render.replay.empty()) return;
    check_writable(plan);
    steps = steps_of(plan);
    flags.render.step = steps[0];
    announce_step(kind, steps[0]);
    tell_halo(plan, asked);
  });
  if (!flags.render.replay.empty()) return;
  finished(plan.render.output);

  with_threads(flags.render.shot.threads(), [&] {
    for (std::size_t i = 0; i < plan.stages.size(); ++i) {
      const RunStage& stage = plan.stages[i];
      const JobStep& step = steps[results.size()];
      announce_step(kind, step);
      const StageOptions options{.sections = stage.sections,
                                 .resume = flags.render.resume,
                                 .write = stage.write,
                                 .command = program.command_line()};
      make_frames(stage.choice, stage_input(plan, i), stage.output, options, *make_stage_progress(kind, step),
                  program.stop);
      finished(stage.output);
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
