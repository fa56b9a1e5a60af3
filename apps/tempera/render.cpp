// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <charconv>
#include <cstdio>
#include <filesystem>
#include <limits>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/aov_names.h"
#include "tempera/pipeline/memory.h"
#include "tempera/pipeline/progress.h"
#include "tempera/pipeline/tev.h"

namespace tempera {

namespace {

/// "frame,x,y,sample", and with the random numbers of another pixel or pass ",stream,x,y,turn,turn" as in PixelKey.
/// Errors: Error{kUsage}.
BadSample parse_replay(const std::string& text, const RenderSettings& settings) {
  std::vector<std::int64_t> numbers;
  for (const char *at = text.data(), *end = at + text.size();; ++at) {
    const auto [next, ec] = std::from_chars(at, end, numbers.emplace_back());
    const bool is_stream = numbers.size() == 5;
    using Int = std::numeric_limits<int>;
    const bool fits = is_stream || (numbers.back() >= Int::min() && numbers.back() <= Int::max());
    if (ec != std::errc() || !fits || (next != end && *next != ',')) numbers.clear();
    if (numbers.empty() || next == end) break;
    at = next;
  }
  if (numbers.size() != 4 && numbers.size() != 9) {
    throw Error(
        ErrorCode::kUsage, ShotConfig::kCommandLine(),
        fmt::format("--replay \"{}\" is not of the form frame,x,y,sample or frame,x,y,sample,stream,x,y,turn,turn",
                    text));
  }
  BadSample b{int(numbers[0]), int(numbers[1]), int(numbers[2]), int(numbers[3]), {}};
  b.numbers = own_key(settings, b.frame, b.x, b.y);
  if (numbers.size() == 9) b.numbers = {numbers[4], int(numbers[5]), int(numbers[6]), int(numbers[7]), int(numbers[8])};
  return b;
}

Part parse_part(const std::string& text) {
  const char *begin = text.data(), *end = begin + text.size();
  Part part;
  const auto first = std::from_chars(begin, end, part.index);
  const bool slash = first.ec == std::errc() && first.ptr != end && *first.ptr == '/';
  const auto second = slash ? std::from_chars(first.ptr + 1, end, part.count) : first;
  if (!slash || second.ec != std::errc() || second.ptr != end || part.index < 1 || part.index > part.count) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                fmt::format("--part \"{}\" is not of the form 2/3: the second of three parts", text));
  }
  --part.index;
  return part;
}

void add_render_options(CLI::App& command, RenderFlags& flags) {
  command
      .add_option("--checkpoint-minutes", flags.checkpoint_minutes,
                  "minutes between checkpoints of a frame; 0: only when stopped [10]")
      ->type_name("N")
      ->check(CLI::Range(0.0, 1e9).description(""));
  command.add_option("--tev", flags.tev, "show tiles in the image viewer tev as they finish")
      ->type_name("HOST[:PORT]")
      ->expected(1);
  command.add_option("--progress", flags.progress, "auto, tty, plain, json, openjd or none [auto]")->type_name("KIND");
  command.add_option("--replay", flags.replay, "render this one sample, as a warning names it, and print its radiance")
      ->type_name("FRAME,X,Y,SAMPLE");
}

}  // namespace

void RenderFlags::add_to(CLI::App& command) {
  shot.add_to(command);
  command.add_flag("--resume", resume, "skip frames that are finished, continue those that were interrupted");
  add_render_options(command, *this);
}

void RenderFlags::add_overrides_to(CLI::App& command) {
  shot.add_overrides_to(command);
  add_render_options(command, *this);
}

void hint_at_stages(const Shot& shot) {
  const std::vector<LayerDesc> layers = rendered_layers(shot);
  for (const StageEntry* e : stage_catalog()) {
    if (!e->follows || !e->follows(layers)) continue;
    log_info(fmt::format("these frames are {}; to make {} of them: tempera {} {} -o {} (tempera run does both)",
                         e->follows_help, e->output_help, e->name, shot.output,
                         (std::filesystem::path(shot.output).parent_path() / "final").string()));
  }
}

void log_render(const RenderReport& report) {
  const std::size_t done = report.frames.size();
  log_info(fmt::format("{} {} rendered, {} already finished, in {:.1f} s", done, done == 1 ? "frame" : "frames",
                       report.skipped.size(), report.seconds));
}

RenderOptions RenderFlags::options(const Program& program) const {
  RenderOptions options;
  options.resume = resume;
  options.checkpoint_seconds = 60 * checkpoint_minutes;
  options.command = program.command_line();
  return options;
}

LoadedShot render_shot(Program& program, const RenderFlags& flags, const PrepareRender& prepare) {
  const ShotConfig config = flags.shot.config();
  const ProgressKind kind = flags.progress_kind(program);
  RenderOptions options = flags.options(program);
  if (!flags.part.empty()) options.part = parse_part(flags.part);
  std::unique_ptr<RenderObserver> tev;
  const std::uint64_t memory_limit = flags.shot.memory_limit();
  if (memory_limit > 0) limit_memory(memory_limit);

  LoadedShot loaded;
  with_threads(flags.shot.threads(), [&] {
    Warnings warnings;
    loaded = load_shot(config, flags.shot.import_options(), warnings);
    warnings.report(flags.shot.strict());
    if (prepare) prepare(config, loaded, options);
    const Shot& shot = loaded.shot;
    check_memory(shot, loaded.scene, memory_limit);
    if (!flags.replay.empty()) {
      const BadSample b = parse_replay(flags.replay, shot.settings);
      const Rgb c = replay_sample(shot, loaded.scene, b);
      std::printf("frame %d, pixel %d,%d, sample %d: %g %g %g\n", b.frame, b.x, b.y, b.sample, c.r, c.g, c.b);
      return;
    }
    if (shot.output.empty()) {
      throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(), "no output is named; add -o out/frame.####.exr");
    }
    const std::vector<LayerDesc> layers = rendered_layers(shot);
    check_shot_encoding(config, layers, shot.write);
    if (!flags.tev.empty()) tev = make_tev_display(parse_tev_address(flags.tev), shot.source.stem().string());
    log_frames(shot.frames, shot.output);
    if (shot.write.names != AovNames::kTempera)
      log_info(describe_aov_names(layers, shot.write.names, shot.write.view_layer));
    const std::unique_ptr<RenderObserver> progress = make_progress(kind, flags.step);
    std::vector<RenderObserver*> observers{progress.get()};
    if (tev) observers.push_back(tev.get());
    const RenderReport report = render_sequence(shot, loaded.scene, options, observers, program.stop);
    if (options.part.count > 1) return;
    log_render(report);
  });
  return loaded;
}

void add_render(Program& program) {
  auto flags = std::make_shared<RenderFlags>();
  CLI::App* command = program.add(
      "render", "Render frames to multi-layer EXR files.",
      {"tempera render scene.xml -o out/frame.####.exr --spp 256",
       "tempera render shot.toml --frames 1-24 --resume --layers motion,albedo,normal",
       "tempera render robot.glb -o out/r.####.exr --camera Main --shutter -0.25,0.25 --resolution 1920x1080",
       "tempera render shot.toml --decompose \"direct=ED;indirect=ED.+\" --tev 127.0.0.1:14158"},
      [&program, flags] {
        const Shot shot = render_shot(program, *flags).shot;
        if (flags->replay.empty()) hint_at_stages(shot);
        return 0;
      });
  flags->add_to(*command);
  command
      ->add_option("--part", flags->part,
                   "render this part of the work on each frame, for `tempera merge`; dividing the frames is cheaper")
      ->type_name("I/N");
}

}  // namespace tempera
