// SPDX-License-Identifier: Apache-2.0
// The program `tempera`: reads the command line, calls one library function per command, prints, and turns errors into
// the exit status of their kind.
#include <OpenImageIO/imageio.h>
#include <embree3/rtcore.h>
#include <fmt/format.h>
#include <unistd.h>

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

[[noreturn]] void end_of_memory() {
  // Nothing here may allocate.
  [[maybe_unused]] const ssize_t n = write(STDERR_FILENO, kOutOfMemory, std::char_traits<char>::length(kOutOfMemory));
  _exit(exit_status(ErrorCode::kOutOfMemory));
}

/// Exceptions that leave a thread or a noexcept function: memory that ran out gets the same end everywhere.
void on_terminate() {
  if (const auto e = std::current_exception()) {
    try {
      std::rethrow_exception(e);
    } catch (const std::bad_alloc&) {
      end_of_memory();
    } catch (const std::exception& error) {
      std::fprintf(stderr, "tempera: internal failure: %s\n", error.what());
    } catch (...) {
      std::fprintf(stderr, "tempera: internal failure\n");
    }
  }
  std::abort();
}

int report(const Error& e) {
  std::string text = format_with_excerpt(e);
  std::fprintf(stderr, "tempera: %s\n", text.c_str());
  if (e.code() == ErrorCode::kCancelled && InterruptGuard::signal() != 0) return 128 + InterruptGuard::signal();
  // A wrong value is the user's fault or the file's, depending on who wrote it.
  const bool typed = e.loc().file == ShotConfig::kCommandLine().file;
  return typed && e.code() != ErrorCode::kMissingFile ? exit_status(ErrorCode::kUsage) : exit_status(e.code());
}

int main_guarded(int argc, char** argv) {
  InterruptGuard interrupt;
  Program program;
  program.arguments.assign(argv, argv + argc);
  program.stop = interrupt.token();
  CLI::App& app = program.app;
  app.name("tempera");
  app.description("A physically based renderer for animation.");
  app.set_version_flag("--version", version_text());
  app.require_subcommand(1);
  app.fallthrough();
  app.get_formatter()->column_width(34);
  app.option_defaults()->group("General");
  app.add_flag_callback(
      "-q,--quiet", [&] { program.verbosity = -1; }, "only warnings and failures are printed");
  app.add_flag_callback(
      "-v,--verbose", [&] { program.verbosity = 1; }, "more is printed");
  app.option_defaults()->group("Options");
  app.footer(
      "tempera COMMAND --help explains a command.\n"
      "Exit status: 0 done, 1 failed while running, 2 wrong usage, 3 bad scene or input, 4 missing file,\n"
      "5 out of memory, 6 comparison differs, 130 or 143 interrupted (work in progress is saved first).");
  add_render(program);
  add_run(program);
  add_info(program);
  add_list(program);
  add_reconstruct(program);
  add_video(program);
  add_compare(program);
  add_gallery(program);
  add_docs(program);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app.exit(e);  // --help, --version
    std::fprintf(stderr, "tempera: %s\n", e.what());
    return exit_status(ErrorCode::kUsage);
  }
  set_log_level(program.verbosity < 0   ? LogLevel::kWarning
                : program.verbosity > 0 ? LogLevel::kDebug
                                        : LogLevel::kInfo);
  try {
    return program.run();
  } catch (const Error& e) {
    return report(e);
  } catch (const std::bad_alloc&) {
    end_of_memory();
  } catch (const std::exception& e) {
    std::fprintf(stderr, "tempera: %s\n", e.what());
    return exit_status(ErrorCode::kFailed);
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
