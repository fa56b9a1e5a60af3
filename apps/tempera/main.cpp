// SPDX-License-Identifier: Apache-2.0
// The program `tempera`: reads the command line, calls one library function per command, prints, and turns errors into
// the exit status of their kind.
#include <OpenImageIO/imageio.h>
#include <embree3/rtcore.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "interrupt.h"
#include "program.h"
#include "tempera/core/log.h"

namespace tempera {

std::string version_text() {
  const int oiio = OIIO::openimageio_version();
  return fmt::format("tempera {} ({}, {}, Embree {}, OpenImageIO {}.{}.{})", TEMPERA_VERSION, TEMPERA_BUILD_TYPE,
                     TEMPERA_COMPILER, RTC_VERSION_STRING, oiio / 10000, oiio / 100 % 100, oiio % 100);
}

CLI::App* Program::add(const std::string& name, const std::string& help, const std::vector<std::string>& examples,
                       std::function<int()> action) {
  return add(app, name, help, examples, std::move(action));
}

CLI::App* Program::add(CLI::App& parent, const std::string& name, const std::string& help,
                       const std::vector<std::string>& examples, std::function<int()> action) {
  CLI::App* command = parent.add_subcommand(name, help);
  if (!examples.empty()) command->footer(fmt::format("Examples:\n  {}", fmt::join(examples, "\n  ")));
  command->callback([this, action = std::move(action)] { run = action; });
  return command;
}

std::string Program::command_line() const {
  std::string out;
  for (const std::string& a : arguments) {
    const bool plain = !a.empty() &&
                       a.find_first_not_of(
                           "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
                           "_-./,=:+#@%") == std::string::npos &&
                       a[0] != '#';
    std::string quoted = a;
    if (!plain) {
      quoted = "'";
      for (const char c : a) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
      quoted += "'";
    }
    out += (out.empty() ? "" : " ") + quoted;
  }
  return out;
}

ProgressKind Program::progress_kind(const std::string& text) const {
  return verbosity < 0 && text == "auto" ? ProgressKind::kNone : parse_progress(text);
}

namespace {

constexpr const char* kOutOfMemory = "tempera: out of memory\n";

constexpr const char* kOutOfMemoryEvent =
    "{\"event\":\"error\",\"kind\":\"out_of_memory\",\"message\":\"out of memory\",\"status\":5}\n";

[[noreturn]] void end_of_memory() {
  // Nothing here may allocate.
  [[maybe_unused]] const ssize_t n = write(STDERR_FILENO, kOutOfMemory, std::char_traits<char>::length(kOutOfMemory));
  _exit(exit_status(ErrorCode::kOutOfMemory));
}

/// Whether memory ran out: by an allocation, or because no stack was left for a thread that the standard library or TBB
/// wanted to start (TBB tells that by its text alone).
bool out_of_memory(const std::exception& e) {
  if (dynamic_cast<const std::bad_alloc*>(&e) != nullptr) return true;
  if (const auto* system = dynamic_cast<const std::system_error*>(&e)) {
    return system->code() == std::errc::resource_unavailable_try_again ||
           system->code() == std::errc::not_enough_memory;
  }
  return std::string_view(e.what()).starts_with("pthread_create has failed");
}

/// Exceptions that leave a thread or a noexcept function: memory that ran out gets the same end everywhere.
void on_terminate() {
  if (const auto e = std::current_exception()) {
    try {
      std::rethrow_exception(e);
    } catch (const std::exception& error) {
      if (out_of_memory(error)) end_of_memory();
      std::fprintf(stderr, "tempera: internal failure: %s\n", error.what());
    } catch (...) {
      std::fprintf(stderr, "tempera: internal failure\n");
    }
  }
  std::abort();
}

int status_of(const Error& e) {
  if (e.code() == ErrorCode::kCancelled && InterruptGuard::signal() != 0) return 128 + InterruptGuard::signal();
  // A wrong value is the user's fault or the file's, depending on who wrote it.
  const bool typed = e.loc().file == ShotConfig::kCommandLine().file;
  return typed && e.code() != ErrorCode::kMissingFile ? exit_status(ErrorCode::kUsage) : exit_status(e.code());
}

/// Whether standard output is read by a program that expects events. Asked before the command line is understood, so
/// that wrong usage is an event, too.
bool wants_events(const std::vector<std::string>& arguments) {
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    if (arguments[i] == "--progress=json") return true;
    if (arguments[i] == "--progress" && i + 1 < arguments.size() && arguments[i + 1] == "json") return true;
  }
  return false;
}

int report(const Error& e, bool events) {
  std::string text = format_with_excerpt(e);
  std::fprintf(stderr, "tempera: %s\n", text.c_str());
  const int status = status_of(e);
  if (events) write_error_event(e, status);
  return status;
}

/// The commands below `app` that are shown in its help.
std::vector<std::string> command_names(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : app.get_subcommands(nullptr)) {
    if (!command->get_group().empty()) names.push_back(command->get_name());
  }
  return names;
}

/// What is wrong with a command line that cannot be parsed, in one line.
std::string usage_message(const CLI::App& app, const std::vector<std::string>& arguments,
                          const CLI::ParseError& error) {
  const CLI::App* command = &app;
  std::string name = app.get_name();
  for (std::size_t i = 1; i < arguments.size() && !command->get_subcommands(nullptr).empty(); ++i) {
    const std::string& word = arguments[i];
    if (word.starts_with('-')) continue;
    const auto all = command->get_subcommands(nullptr);
    const auto found = std::find_if(all.begin(), all.end(), [&](const CLI::App* c) { return c->get_name() == word; });
    if (found == all.end()) {
      return fmt::format("unknown command \"{}\" of {}; known: {}", word, name,
                         nearest_names(word, command_names(*command)));
    }
    command = *found;
    name += " " + word;
  }
  std::vector<std::string> flags;
  for (const CLI::App* level : {command, &app}) {
    for (const CLI::Option* o : level->get_options()) {
      for (const std::string& s : o->get_snames()) flags.push_back("-" + s);
      for (const std::string& l : o->get_lnames()) flags.push_back("--" + l);
    }
    if (command == &app) break;
  }
  for (const std::string& extra : app.remaining(true)) {
    if (extra.size() > 1 && extra[0] == '-') {
      const std::string flag = extra.substr(0, extra.find('='));
      return fmt::format("unknown flag {} of {}; the nearest known: {}; {} --help shows all", flag, name,
                         nearest_names(flag, flags, 3), name);
    }
  }
  if (!command_names(*command).empty()) {
    return fmt::format("{} needs a command; one of: {}", name, fmt::join(command_names(*command), ", "));
  }
  std::vector<std::string> positionals;
  for (const CLI::Option* o : command->get_options()) {
    if (o->get_positional() && o->nonpositional() == false) positionals.push_back(o->get_type_name());
  }
  const std::vector<std::string> remaining = app.remaining(true);
  if (!remaining.empty()) {
    return fmt::format(
        "\"{}\" is one argument too many for {}{}", remaining[0], name,
        positionals.empty() ? ", which takes none" : fmt::format("; usage: {} {}", name, fmt::join(positionals, " ")));
  }
  return fmt::format("{}: {}; {} --help shows the usage", name, error.what(), name);
}

int main_guarded(int argc, char** argv) {
  InterruptGuard interrupt;
  Program program;
  program.arguments.assign(argv, argv + argc);
  program.stop = interrupt.token();
  const bool events = wants_events(program.arguments);
  if (events) write_warning_events();
  CLI::App& app = program.app;
  app.name("tempera");
  app.description("A physically based renderer for animation.");
  app.set_version_flag("--version", version_text());
  app.require_subcommand(1);
  app.fallthrough();
  app.get_formatter()->column_width(34);
  app.option_defaults()->group("General");
  app.add_flag_callback(
      "-q,--quiet", [&] { program.verbosity = -1; }, "print warnings and errors only");
  app.add_flag_callback(
      "-v,--verbose", [&] { program.verbosity = 1; }, "print more");
  app.option_defaults()->group("Options");
  app.footer(
      "tempera COMMAND --help explains a command.\n"
      "Exit status: 0 done, 1 failed while running, 2 wrong usage, 3 bad scene or input, 4 missing file,\n"
      "5 out of memory, 6 comparison differs, 130 or 143 interrupted (work in progress is saved first).");
  add_render(program);
  add_run(program);
  add_info(program);
  add_list(program);
  add_merge(program);
  add_stages(program);
  add_video(program);
  add_compare(program);
  add_gallery(program);
  add_docs(program);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app.exit(e);  // --help, --version
    return report(Error(ErrorCode::kUsage, usage_message(app, program.arguments, e)), events);
  }
  set_log_level(program.verbosity < 0   ? LogLevel::kWarning
                : program.verbosity > 0 ? LogLevel::kDebug
                                        : LogLevel::kInfo);
  try {
    return program.run();
  } catch (const Error& e) {
    return report(e, events);
  } catch (const std::exception& e) {
    if (out_of_memory(e)) {
      if (events) std::fputs(kOutOfMemoryEvent, stdout), std::fflush(stdout);
      end_of_memory();
    }
    return report(Error(ErrorCode::kFailed, e.what()), events);
  }
}

}  // namespace
}  // namespace tempera

int main(int argc, char** argv) {
  std::set_terminate(tempera::on_terminate);
  // Both end as failed writes, which are reported like any other: a viewer or a pipe that closed, a file that is too
  // large.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  return tempera::main_guarded(argc, argv);
}
