// SPDX-License-Identifier: Apache-2.0
// The commands of the stages, made from their manuals.
#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <filesystem>
#include <set>

#include "catalog.h"
#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/pipeline/stage_progress.h"

namespace tempera {

namespace {

struct Flags {
  const StageEntry* entry = nullptr;
  std::deque<std::string> in;  // addresses stay: the parser writes into them
  std::string out, frames, compression = "zip", progress = "auto", aov_names = "tempera";
  StageOptions options;
  int threads = 0;
  struct ParamFlag {
    const ParamSpec* spec;
    CLI::Option* option;
    std::string text;
    bool on = false;
  };
  std::deque<ParamFlag> params;
};

void run_stage_command(Program& program, Flags& flags) {
  StageOptions& options = flags.options;
  StageChoice choice{flags.entry, Params(flags.entry->params)};
  for (const Flags::ParamFlag& p : flags.params) {
    if (p.option->count() == 0) continue;
    choice.params.set_text(p.spec->name, std::holds_alternative<bool>(p.spec->fallback) ? "true" : p.text,
                           ShotConfig::kCommandLine());
  }
  if (!flags.frames.empty()) options.sections[0].frames = parse_frame_set(flags.frames);
  try {
    options.write.compression = parse_compression(flags.compression);
    options.write.names = parse_aov_names(flags.aov_names);
  } catch (const Error& e) {
    throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
  }
  options.command = program.command_line();
  const ProgressKind kind = program.progress_kind(flags.progress);
  with_threads(flags.threads, [&] {
    std::vector<FrameSequence> in;
    for (const std::string& name : flags.in) in.emplace_back(name);
    const std::vector<int>& asked = options.sections[0].frames;
    std::set<int> frames(asked.begin(), asked.end());
    if (asked.empty()) {
      const std::vector<int>& first = in[0].frames();
      frames.insert(first.begin(), first.end());
      for (const FrameSequence& port : in) {
        if (!choice.entry->takes_keys) break;
        for (const int f : port.frames()) {
          if (f > first.front() && f < first.back()) frames.insert(f);
        }
      }
    }
    const std::vector<int> made(frames.begin(), frames.end());
    const std::string name = std::filesystem::path(in[0].pattern()).filename().string();
    try {
      const std::string output = output_pattern(flags.out, name, made.size() == 1);
      log_frames(made, output);
      log_stage(*choice.entry, run_stage(choice, in, output, options, *make_stage_progress(kind), program.stop));
    } catch (const Error& e) {
      if (e.code() != ErrorCode::kUsage || !e.loc().file.empty()) throw;
      throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
    }
  });
}

void add_stage(Program& program, const StageEntry& entry) {
  auto flags = std::make_shared<Flags>();
  flags->entry = &entry;
  CLI::App* command = program.add(entry.name, entry.command_help, entry.examples, [&program, flags] {
    run_stage_command(program, *flags);
    return 0;
  });
  for (const StagePort& port : entry.ports) {
    std::string value = port.name;
    std::transform(value.begin(), value.end(), value.begin(), [](unsigned char c) { return char(std::toupper(c)); });
    command
        ->add_option(port.name, flags->in.emplace_back(),
                     port.help + ": a folder, a pattern such as out/f.####.exr, or one file")
        ->required()
        ->type_name(value);
  }
  command->add_option("-o,--output", flags->out, entry.output_help + ": a folder, or names such as final/f.####.exr")
      ->required()
      ->type_name("OUT");
  command->add_option("-f,--frames", flags->frames, "frames to write [all]; those around them are read as needed")
      ->type_name("SET");
  for (const ParamSpec& s : entry.params) {
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

}  // namespace

void log_frames(std::span<const int> frames, const std::string& output) {
  log_info(fmt::format("frames {}, to {}", describe_frames(frames), output));
}

void log_stage(const StageEntry& entry, const StageReport& report) {
  for (const std::string& note : report.notes) log_info(note);
  log_info(fmt::format("{} {} {}, {} already finished, in {:.1f} s", report.frames.size(),
                       report.frames.size() == 1 ? "frame" : "frames", entry.done, report.skipped.size(),
                       report.seconds));
}

void add_stages(Program& program) {
  for (const StageEntry* e : stage_catalog()) add_stage(program, *e);
}

}  // namespace tempera
