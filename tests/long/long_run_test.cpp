// SPDX-License-Identifier: Apache-2.0
// A sequence of ten seconds, rendered and reconstructed: it fits into the memory that is promised, and being killed in
// the middle of either step changes no bit. Takes up to 8 GB of disk in the folder for temporary files.
#include <sys/resource.h>

#include <cstdlib>

#include "../cli/program.h"
#include "tempera/core/time.h"

namespace tempera::test {
namespace {

constexpr int kFrames = 240;
constexpr double kPatience = 7200;  // seconds for one step on a machine that is busy with other things

class LongRun : public CliTest {
 protected:
  std::vector<std::string> arguments(const std::string& folder) const {
    // One second at 240 frames per second. Short paths and few samples: the length of the sequence is what counts here.
    return {"run",          source_file("scenes/tests/cornell_motion.xml"),
            "-o",           path(folder + "/f.####.exr"),
            "--frames",     "0-239",
            "--fps",        "240",
            "--resolution", "640x360",
            "--spp",        "2",
            "--max-depth",  "2",
            "--integrator", "temporal_gradient_path",
            "--resume",     "--progress",
            "plain"};
  }
  fs::path rendered(const std::string& folder, int frame) const {
    return frame_path(path(folder + "/f.####.exr"), frame);
  }
  fs::path final_frame(const std::string& folder, int frame) const {
    return frame_path(path(folder + "/final/f.####.exr"), frame);
  }
  double gigabytes(const std::string& folder) const {
    double bytes = 0;
    for (const auto& entry : fs::directory_iterator(path(folder))) {
      if (entry.is_regular_file()) bytes += double(entry.file_size());
    }
    return bytes / 1e9;
  }
  /// Of all processes that have ended so far, ffmpeg among them.
  struct Usage {
    double gibibytes = 0;  ///< of the largest one
    double seconds = 0;    ///< of processor time
  };
  static Usage usage() {
    rusage u{};
    getrusage(RUSAGE_CHILDREN, &u);
    const auto seconds = [](const timeval& t) { return double(t.tv_sec) + 1e-6 * double(t.tv_usec); };
    return {double(u.ru_maxrss) / (1 << 20), seconds(u.ru_utime) + seconds(u.ru_stime)};
  }
};

TEST_F(LongRun, TwoHundredAndFortyFramesSurviveBeingKilledInLittleMemory) {
  const auto begin = std::chrono::steady_clock::now();
  const auto report = [&](const char* what) {
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    std::printf("%-28s at %6.0f s (%.0f of processors), peak so far %.2f GiB\n", what, seconds, usage().seconds,
                usage().gibibytes);
    std::fflush(stdout);
  };
  if (std::system("ffmpeg -version >/dev/null 2>&1") != 0) GTEST_SKIP() << "ffmpeg is not installed";
  const Outcome whole = run(arguments("whole"));
  ASSERT_EQ(whole.status, 0) << whole.err;
  std::printf("%s", whole.err.substr(whole.err.rfind("\nrender ") + 1).c_str());
  std::printf("%.2f GB rendered, %.2f GB final\n", gigabytes("whole"), gigabytes("whole/final"));
  report("undisturbed");

  // To save time, all but the middle of the sequence counts as rendered before the first kill.
  fs::create_directories(path("killed"));
  for (int f = 0; f < kFrames; ++f) {
    if (f < kFrames * 2 / 5 || f > kFrames * 3 / 5) fs::create_hard_link(rendered("whole", f), rendered("killed", f));
  }
  const auto kill_when = [&](const fs::path& file) {
    Process p(arguments("killed"));
    ASSERT_TRUE(p.wait_until([&] { return fs::exists(file); }, kPatience)) << p.err_so_far();
    p.signal(SIGKILL);
    EXPECT_EQ(p.finish().status, 128 + SIGKILL);
  };
  kill_when(rendered("killed", kFrames / 2));
  EXPECT_FALSE(fs::exists(rendered("killed", kFrames * 3 / 5)));
  report("killed in the rendering");
  kill_when(final_frame("killed", kFrames / 2));
  EXPECT_FALSE(fs::exists(final_frame("killed", kFrames - 1)));
  report("killed in reconstruction");
  const Outcome resumed = run(arguments("killed"));
  ASSERT_EQ(resumed.status, 0) << resumed.err;
  EXPECT_NE(resumed.err.find("0 frames rendered, 240 already finished"), std::string::npos);
  report("resumed");
  for (int f = 0; f < kFrames; ++f) {
    EXPECT_TRUE(SamePixels(rendered("whole", f).string(), rendered("killed", f).string()));
    EXPECT_TRUE(SamePixels(final_frame("whole", f).string(), final_frame("killed", f).string()));
  }
  EXPECT_LT(usage().gibibytes, 4e9 / (1 << 30));
}

}  // namespace
}  // namespace tempera::test
