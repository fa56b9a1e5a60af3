// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <filesystem>

#include "catalog.h"
#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/pipeline/stage_progress.h"

namespace tempera {

namespace {

struct Flags {
  std::string in, out, frames, compression = "zip", progress = "auto", aov_names = "tempera";
  ReconstructOptions options;
  int threads = 0;
  struct ParamFlag {
    const ParamSpec* spec;
    CLI::Option* option;
    std::string text;
    bool on = false;
  };
  std::deque<ParamFlag> params;  // addresses stay: the parser writes into them
};

void run_reconstruct(Program& program, Flags& flags) {
  ReconstructOptions& options = flags.options;
  for (const Flags::ParamFlag& p : flags.params) {
    if (p.option->count() == 0) continue;
    options.params.set_text(p.spec->name, std::holds_alternative<bool>(p.spec->fallback) ? "true" : p.text,
                            ShotConfig::kCommandLine());
  }
  if (!flags.frames.empty()) options.frames = parse_frame_set(flags.frames);
  try {
    options.write.compression = parse_compression(flags.compression);
    options.write.names = parse_aov_names(flags.aov_names);
  } catch (const Error& e) {
    throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
  }
  options.command = program.command_line();
  const ProgressKind kind = program.progress_kind(flags.progress);
  with_threads(flags.threads, [&] {
    const FrameSequence input(flags.in);
    const std::size_t count = options.frames.empty() ? input.frames().size() : options.frames.size();
    const std::string name = std::filesystem::path(input.pattern()).filename().string();
    try {
      reconstruct_frames(input, output_pattern(flags.out, name, count == 1), options, *make_stage_progress(kind),
                         program.stop);
    } catch (const Error& e) {
      if (e.code() != ErrorCode::kUsage || !e.loc().file.empty()) throw;
      throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
    }
  });
}

}  // namespace

void reconstruct_frames(const FrameSequence& input, const std::string& output, const ReconstructOptions& options,
                        StageObserver& progress, std::stop_token stop) {
  log_info(fmt::format("frames {}, to {}", describe_frames(options.frames.empty() ? input.frames() : options.frames),
                       output));
  const ReconstructReport report = reconstruct(input, output, options, progress, std::move(stop));
  if (!report.cuts.empty()) log_info(fmt::format("cuts before frames {}", describe_frames(report.cuts)));
  log_info(fmt::format("{} {} reconstructed, {} already finished, in {:.1f} s", report.frames.size(),
                       report.frames.size() == 1 ? "frame" : "frames", report.skipped.size(), report.seconds));
}

std::vector<CatalogItem> stage_items() {
  return {{"reconstruct",
           "final frames from the pictures and differences of gradient_path and temporal_gradient_path",
           {reconstruct_params().begin(), reconstruct_params().end()}}};
}

void add_reconstruct(Program& program) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = program.add(
      "reconstruct", "Make final frames of what gradient_path and temporal_gradient_path rendered.",
      {"tempera reconstruct out/frame.####.exr -o final/frame.####.exr",
       "tempera reconstruct out/ -o final/ --norm l2 --window 20 --overlap 10 --resume",
       "tempera reconstruct out/ -o final/ --frames 1-24   (part of a sequence: the same bits as all at once)",
       "tempera reconstruct still.exr -o final.exr"},
      [&program, flags] {
        run_reconstruct(program, *flags);
        return 0;
      });
  command->add_option("in", flags->in, "rendered frames: a folder, a pattern such as out/f.####.exr, or one file")
      ->required()
      ->type_name("IN");
  command->add_option("-o,--output", flags->out, "final frames: a folder, or names such as final/f.####.exr")
      ->required()
      ->type_name("OUT");
  command->add_option("-f,--frames", flags->frames, "frames to write [all]; those around them are read as needed")
      ->type_name("SET");
  for (const ParamSpec& s : reconstruct_params()) {
    Flags::ParamFlag& p = flags->params.emplace_back(Flags::ParamFlag{&s, nullptr, {}});
    std::string name = "--" + s.name;
    std::replace(name.begin(), name.end(), '_', '-');
    if (std::holds_alternative<bool>(s.fallback)) {
      p.option = command->add_flag(name, p.on, s.help);
    } else {
      p.option = command->add_option(name, p.text, fmt::format("{} [{}]", s.help, to_text(s.fallback)))
                     ->type_name(s.choices.empty() ? "N" : "NAME");
    }
  }
  command->add_flag("--resume", flags->options.resume, "skip frames that are finished");
  command->add_flag("--half", flags->options.write.half, "16-bit floats for radiance and reflectance layers");
  command
      ->add_option("--aov-names", flags->aov_names,
                   "whose names the layers get in the file: tempera, blender, arnold, renderman, pbrt [tempera]")
      ->type_name("NAME");
  command->add_option("--view-layer", flags->options.write.view_layer, "first part of Blender's names [ViewLayer]")
      ->type_name("NAME");
  command->add_option("--compression", flags->compression, "zip, zips, piz, rle, none or dwaa [zip]")
      ->type_name("NAME");
  command->add_option("--progress", flags->progress, "auto, tty, plain, json, openjd or none [auto]")
      ->type_name("KIND");
  command->add_option("--threads", flags->threads, "threads; 0: one per core [0]")
      ->type_name("N")
      ->check(CLI::Range(0, 4096).description(""));
}

}  // namespace tempera
