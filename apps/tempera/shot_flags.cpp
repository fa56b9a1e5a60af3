// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include "program.h"
#include "tempera/pipeline/memory.h"

namespace tempera {

namespace {

/// One value per occurrence: a list option would swallow the SHOT that follows it.
CLI::Option* add_repeatable(CLI::App& command, const std::string& flag, std::vector<std::string>& out,
                            const std::string& help, const std::string& value_name) {
  return command.add_option(flag, out, help)->allow_extra_args(false)->type_name(value_name);
}

/// "filter:1.5" or "a=b" in two parts; the second is empty without a separator.
std::pair<std::string, std::string> split(const std::string& text, char separator) {
  const auto at = text.find(separator);
  return at == std::string::npos ? std::pair(text, std::string()) : std::pair(text.substr(0, at), text.substr(at + 1));
}

/// "name=value" into table `table`. Errors: Error{kUsage}.
void assign(ShotConfig& config, const std::string& table, const std::string& text, const char* flag,
            const char* example) {
  const auto [name, value] = split(text, '=');
  if (name.empty() || text.find('=') == std::string::npos) {
    throw Error(
        ErrorCode::kUsage, ShotConfig::kCommandLine(),
        fmt::format("{} \"{}\" is not of the form NAME=VALUE; write for example {} {}", flag, text, flag, example));
  }
  config.set_text(table + ".\"" + name + '"', value);
}

}  // namespace

void ShotFlags::add_to(CLI::App& command) {
  command.add_option("shot", shot_, "shot.toml, or a scene: Mitsuba XML or glTF")->required()->type_name("SHOT");
  add_overrides_to(command);
}

void ShotFlags::add_overrides_to(CLI::App& command) {
  for (const ShotKey& k : shot_keys()) {
    if (k.flag.empty()) continue;
    KeyFlag& f = keys_.emplace_back(KeyFlag{&k, nullptr, {}});
    std::string help = k.spec.help;
    if (!k.spec.choices.empty()) help += fmt::format(": {}", fmt::join(k.spec.choices, ", "));
    if (!k.fallback_help.empty()) {
      help += fmt::format(" [{}]", k.fallback_help);
    } else if (!std::holds_alternative<bool>(k.spec.fallback) && !to_text(k.spec.fallback).empty()) {
      help += fmt::format(" [{}]", to_text(k.spec.fallback));
    }
    if (std::holds_alternative<bool>(k.spec.fallback)) {
      f.option = command.add_flag(k.flag, f.on, help);
    } else {
      f.option = command.add_option(k.flag, f.text, help)->type_name(k.value_name);
    }
    f.option->group("Shot");
  }
  max_depth_given_ =
      command.add_option("--max-depth", max_depth_, "path edges at most, -1: no limit (integrator.max_depth)")
          ->type_name("N")
          ->group("Shot");
  command.add_option("--shutter", shutter_, "open,close[,shape] in frames, e.g. 0,0.5 or -0.25,0.25,trapezoid")
      ->type_name("A,B[,SHAPE]")
      ->group("Shot");
  add_repeatable(command, "--param", params_, "parameter of the integrator; `tempera list integrators` names them",
                 "NAME=VALUE")
      ->group("Shot");
  add_repeatable(command, "--class", classes_,
                 "light-path class to write as layer class.NAME.color, e.g. caustics=ED.*D", "NAME=EXPR")
      ->group("Shot");
  command
      .add_option(
          "--decompose", decompose_,
          "classes that are checked to be disjoint, e.g. \"dd=ED;di=ED.+\", or `default`: emission, direct, indirect, "
          "caustic, reflection, transmission")
      ->type_name("NAME=EXPR;...")
      ->group("Shot");
  add_repeatable(command, "-D,--define", defines_, "value of the scene file's own parameter $NAME", "NAME=VALUE")
      ->group("Shot");
  add_repeatable(command, "--set", set_, "any key of shot.toml, e.g. --set environment.rotation=90", "KEY=VALUE")
      ->group("Shot");
  command.add_option("--threads", threads_, "threads; 0: one per core; results do not depend on it [0]")
      ->type_name("N")
      ->check(CLI::Range(0, 4096).description(""));
  command.add_option("--memory-limit", memory_limit_, "refuse to take more memory, e.g. 8G")->type_name("SIZE");
  command.add_flag("--strict", strict_, "what a scene file asks for and we lack is an error instead of a warning");
  command.add_flag("--sandbox", sandbox_, "refuse to read files outside of the scene's folder");
}

ShotConfig ShotFlags::config() const {
  ShotConfig config = read_shot_config(shot_);
  config.set_sandbox(sandbox_);
  for (const auto& [key, text] : presets_) config.set_text(key, text);
  for (const KeyFlag& f : keys_) {
    if (f.option->count() == 0) continue;
    if (f.key->spec.name == "film.filter") {
      const auto [name, radius] = split(f.text, ':');
      config.set_text("film.filter", name);
      if (f.text.find(':') != std::string::npos) config.set_text("film.filter_radius", radius);
    } else {
      config.set_text(f.key->spec.name,
                      std::holds_alternative<bool>(f.key->spec.fallback) ? (f.on ? "true" : "false") : f.text);
    }
  }
  if (max_depth_given_->count() > 0) config.set_text("integrator.max_depth", std::to_string(max_depth_));
  if (!shutter_.empty()) {
    const auto [open, rest] = split(shutter_, ',');
    const auto [close, shape] = split(rest, ',');
    if (close.empty()) {
      throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                  fmt::format("--shutter \"{}\" is not of the form open,close[,shape]", shutter_));
    }
    config.set_text("shutter.open", open);
    config.set_text("shutter.close", close);
    if (!shape.empty()) config.set_text("shutter.shape", shape);
  }
  for (const std::string& p : params_) assign(config, "integrator", p, "--param", "max_depth=8");
  for (const std::string& c : classes_) assign(config, "classes", c, "--class", "caustics=ED.*D");
  for (const std::string& d : defines_) assign(config, "define", d, "-D", "spp=64");
  for (std::string rest = decompose_ == "default" ? "tree=default" : decompose_; !rest.empty();) {
    const auto [first, tail] = split(rest, ';');
    assign(config, "decompose", first, "--decompose", "\"dd=ED;di=ED.+\"");
    rest = tail;
  }
  for (const std::string& s : set_) config.assign(s);
  return config;
}

std::uint64_t ShotFlags::memory_limit() const { return memory_limit_.empty() ? 0 : parse_memory_size(memory_limit_); }

ImportOptions ShotFlags::import_options() const {
  ImportOptions options;
  options.strict = strict_;
  options.sandbox = sandbox_;
  options.memory_limit = memory_limit();
  return options;
}

}  // namespace tempera
