// SPDX-License-Identifier: Apache-2.0
#pragma once
// Runs the built program with arguments, limits and signals, and keeps what it printed.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "tempera/frames/frame.h"

namespace tempera::test {

namespace fs = std::filesystem;

inline std::string source_file(const std::string& name) { return std::string(TEMPERA_SOURCE_DIR) + "/" + name; }

inline std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream out;
  out << in.rdbuf();
  return out.str();
}

struct Outcome {
  int status = -1;  ///< exit status, or 128 + signal as a shell counts it
  std::string out, err;
};

/// A run of the program.
class Process {
 public:
  /// `prepare` runs in the child before the program: for limits.
  explicit Process(std::vector<std::string> arguments, const std::function<void()>& prepare = {}) {
    static int counter = 0;
    const std::string stem =
        (fs::temp_directory_path() / ("tempera_cli_" + std::to_string(getpid()) + "_" + std::to_string(counter++)));
    out_ = stem + ".out", err_ = stem + ".err";
    arguments.insert(arguments.begin(), TEMPERA_PROGRAM);
    std::vector<char*> argv;
    argv.reserve(arguments.size() + 1);
    for (std::string& a : arguments) argv.push_back(a.data());
    argv.push_back(nullptr);
    pid_ = fork();
    if (pid_ == 0) {
      dup2(open(out_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600), STDOUT_FILENO);
      dup2(open(err_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600), STDERR_FILENO);
      if (prepare) prepare();
      execv(argv[0], argv.data());
      _exit(127);
    }
  }
  ~Process() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    fs::remove(out_);
    fs::remove(err_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void signal(int number) const { kill(pid_, number); }
  /// Waits until `what` holds; false if the program ended, or `seconds` passed, before that.
  bool wait_until(const std::function<bool()>& what, double seconds = 60) {
    const auto begin = std::chrono::steady_clock::now();
    while (std::chrono::steady_clock::now() - begin < std::chrono::duration<double>(seconds)) {
      if (what()) return true;
      siginfo_t info{};
      if (waitid(P_PID, id_t(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == pid_) return what();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }
  std::string err_so_far() const { return text_of(err_); }
  /// Processor time that the program has used so far, in seconds; 0 if it has ended.
  double cpu_seconds() const {
    // Fields 14 and 15 (user and system time, in ticks), counted after the name in parentheses [proc(5)].
    const std::string stat = text_of("/proc/" + std::to_string(pid_) + "/stat");
    std::istringstream fields(stat.substr(std::min(stat.size(), stat.rfind(')') + 2)));
    std::string skipped;
    for (int i = 3; i < 14; ++i) fields >> skipped;
    double user = 0, system = 0;
    fields >> user >> system;
    return (user + system) / double(sysconf(_SC_CLK_TCK));
  }
  Outcome finish() {
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = 0;
    Outcome o;
    o.status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    o.out = text_of(out_);
    o.err = text_of(err_);
    return o;
  }

 private:
  pid_t pid_ = 0;
  std::string out_, err_;
};

inline Outcome run(std::vector<std::string> arguments, const std::function<void()>& prepare = {}) {
  return Process(std::move(arguments), prepare).finish();
}

/// A folder of its own for each test, removed at its end.
class CliTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::temp_directory_path() / ("tempera_cli_" + std::to_string(getpid()) + "_" + info->name());
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name) << text;
    return path(name);
  }
  fs::path folder_;
};

/// A small, quick render of a scene in motion: 80x60 pixels, six tiles a frame.
inline std::vector<std::string> quick_render(const std::string& output, std::vector<std::string> more = {}) {
  std::vector<std::string> arguments{"render",       source_file("scenes/tests/cornell_motion.xml"),
                                     "-o",           output,
                                     "--resolution", "80x60",
                                     "--layers",     "motion,albedo,halves,samples",
                                     "--shutter",    "0,0.5"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

/// Whether two frame files hold the same layers with the same bits.
inline testing::AssertionResult SamePixels(const std::string& a, const std::string& b) {
  const Frame x = read_frame(a), y = read_frame(b);
  if (x.layer_names() != y.layer_names())
    return testing::AssertionFailure() << a << " and " << b << " have other layers";
  for (const Layer& l : x.layers()) {
    if (!(l.image == y.layer(l.desc.name)))
      return testing::AssertionFailure() << l.desc.name << " of " << a << " and " << b << " differ";
  }
  return testing::AssertionSuccess();
}

}  // namespace tempera::test
