// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the commands of the program share: the place to register themselves, and the flags that name and change a shot.
#include <CLI/CLI.hpp>
#include <deque>
#include <functional>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/pipeline/progress.h"
#include "tempera/pipeline/render.h"
#include "tempera/pipeline/shot.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

/// The command line of one run. A command adds its subcommand with `add`; `run` is then what main calls.
struct Program {
  CLI::App app;
  std::vector<std::string> arguments;  ///< with the program's name
  std::function<int()> run;            ///< of the command that was chosen; returns the exit status
  int verbosity = 0;                   ///< -1 quiet, 1 verbose
  std::stop_token stop;                ///< SIGINT or SIGTERM came

  /// A subcommand. `examples` are shown below its help, one a line.
  CLI::App* add(const std::string& name, const std::string& help, const std::vector<std::string>& examples,
                std::function<int()> action);
  /// The same below another subcommand.
  CLI::App* add(CLI::App& parent, const std::string& name, const std::string& help,
                const std::vector<std::string>& examples, std::function<int()> action);
  /// The command line as a shell would read it.
  std::string command_line() const;
  /// What --progress says; nothing is shown on its own with --quiet. Errors: as parse_progress.
  ProgressKind progress_kind(const std::string& text) const;
};

/// SHOT and the flags that say how to render it, generated from the table of shot.toml's keys.
class ShotFlags {
 public:
  void add_to(CLI::App& command);
  /// All but SHOT, which `set_shot` then names.
  void add_overrides_to(CLI::App& command);
  void set_shot(const std::string& file) { shot_ = file; }
  /// A value that stands over the file's and below the command line's.
  void preset(const std::string& key, const std::string& text) { presets_.emplace_back(key, text); }
  /// The file's values, and over them those of the command line, in the order file, presets, flags by table, --set.
  ShotConfig config() const;
  ImportOptions import_options() const;
  int threads() const { return threads_; }
  std::uint64_t memory_limit() const;
  bool strict() const { return strict_; }

 private:
  std::string shot_;
  struct KeyFlag {
    const ShotKey* key;
    CLI::Option* option;
    std::string text;
    bool on = false;
  };
  std::deque<KeyFlag> keys_;  // addresses stay: the parser writes into them
  std::vector<std::pair<std::string, std::string>> presets_;
  std::vector<std::string> set_, params_, classes_, defines_;
  std::string decompose_, shutter_, memory_limit_;
  int max_depth_ = 0;
  CLI::Option* max_depth_given_ = nullptr;
  int threads_ = 0;
  bool strict_ = false, sandbox_ = false;
};

/// Flags of `render` and `run`.
struct RenderFlags {
  ShotFlags shot;
  bool resume = false;
  double checkpoint_minutes = 10;
  std::string tev, progress = "auto", replay;
  std::string part;
  JobStep step;  ///< that the render is of a job
  void add_to(CLI::App& command);
  ProgressKind progress_kind(const Program& program) const { return program.progress_kind(progress); }
  /// But for the part.
  RenderOptions options(const Program& program) const;
  /// All but SHOT and --resume.
  void add_overrides_to(CLI::App& command);
};

/// Called between loading a shot and rendering it: may change what is rendered.
using PrepareRender = std::function<void(const ShotConfig&, LoadedShot&, RenderOptions&)>;

/// Loads the shot, checks it and renders its frames. Errors: those of all of them.
/// Returns the shot with its scene; nothing is rendered with --replay.
LoadedShot render_shot(Program& program, const RenderFlags& flags, const PrepareRender& prepare = {});

/// Says how rendered frames become final ones, if they have to.
void hint_at_stages(const Shot& shot);

/// Log what is done, before and after it.
void log_frames(std::span<const int> frames, const std::string& output);
void log_stage(const StageEntry& entry, const StageReport& report);
void log_render(const RenderReport& report);

/// Encodes frames. Errors: those of write_video; Error{kCancelled}.
void make_movie(const Program& program, const FrameSequence& frames, const std::string& path,
                const VideoOptions& options);

void add_render(Program& program);
void add_run(Program& program);
void add_info(Program& program);
void add_list(Program& program);
void add_merge(Program& program);
void add_stages(Program& program);
void add_video(Program& program);
void add_compare(Program& program);
void add_docs(Program& program);
void add_gallery(Program& program);

/// "tempera 0.1.0 (Release, GNU 12.2.0, Embree 3.13.5, OpenImageIO 2.4.7.1)".
std::string version_text();

}  // namespace tempera
