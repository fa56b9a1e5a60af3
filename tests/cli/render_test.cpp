// SPDX-License-Identifier: Apache-2.0
// Sequences rendered by the program: names of files, the same bits for any division of the work, and what is left when
// things go wrong.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

class CliRender : public CliTest {
 protected:
  Outcome render(const std::string& folder, std::vector<std::string> more,
                 const std::function<void()>& prepare = {}) const {
    Outcome o = run(quick_render(path(folder + "/f.####.exr"), std::move(more)), prepare);
    return o;
  }
  std::string frame(const std::string& folder, int number) const {
    return path(fmt::format("{}/f.{:04}.exr", folder, number));
  }
  void expect_same(const std::string& a, const std::string& b, int first, int last) const {
    for (int f = first; f <= last; ++f) EXPECT_TRUE(SamePixels(frame(a, f), frame(b, f)));
  }
  std::size_t files(const std::string& folder) const {
    return std::size_t(std::distance(fs::directory_iterator(folder_ / folder), fs::directory_iterator()));
  }
};

TEST_F(CliRender, FrameSetsAndPatterns) {
  const std::string scene = source_file("scenes/tests/cornell.xml");
  const auto tiny = [&](const std::string& output, const std::string& frames) {
    return run({"render", scene, "-o", path(output), "--frames=" + frames, "--resolution", "8x8", "--spp", "1"});
  };
  const Outcome o = tiny("a/f.exr", "1-2,7");
  EXPECT_EQ(o.status, 0) << o.err;
  EXPECT_NE(o.err.find("frames 1-2,7 (3 frames)"), std::string::npos) << o.err;
  for (const char* f : {"a/f.0001.exr", "a/f.0002.exr", "a/f.0007.exr"}) EXPECT_TRUE(fs::exists(path(f))) << f;
  EXPECT_NE(tiny("b/f.%03d.exr", "1..5:2").err.find("frames 1-5x2 (3 frames)"), std::string::npos);
  EXPECT_TRUE(fs::exists(path("b/f.003.exr")));
  EXPECT_NE(tiny("c/f_##.exr", "-2--1").err.find("frames -2--1 (2 frames)"), std::string::npos);
  EXPECT_TRUE(fs::exists(path("c/f_-2.exr")));
  tiny("d/f.$F3.exr", "1-3x2");
  EXPECT_TRUE(fs::exists(path("d/f.001.exr")) && fs::exists(path("d/f.003.exr")) && !fs::exists(path("d/f.002.exr")));
}

TEST_F(CliRender, SameBitsForAnyThreadsAndSplit) {
  ASSERT_EQ(render("one", {"--frames", "1-4", "--spp", "4", "--threads", "1"}).status, 0);
  ASSERT_EQ(render("two", {"--frames", "1-2", "--spp", "4", "--threads", "2"}).status, 0);
  ASSERT_EQ(render("two", {"--frames", "3-4", "--spp", "4", "--threads", "2"}).status, 0);
  ASSERT_EQ(render("seven", {"--frames", "4,2,3,1", "--spp", "4", "--threads", "7"}).status, 0);
  expect_same("one", "two", 1, 4);
  expect_same("one", "seven", 1, 4);
  ASSERT_EQ(render("seed", {"--frames", "1", "--spp", "4", "--seed", "1"}).status, 0);
  EXPECT_FALSE(SamePixels(frame("one", 1), frame("seed", 1))) << "the comparison can fail";
}

TEST_F(CliRender, ResumeSkipsAndTellsWhyNot) {
  ASSERT_EQ(render("a", {"--frames", "1-3", "--spp", "2"}).status, 0);
  EXPECT_NE(render("a", {"--frames", "1-3", "--spp", "2", "--resume", "--threads", "1"})
                .err.find("0 frames rendered, 3 already finished"),
            std::string::npos);
  fs::resize_file(frame("a", 2), fs::file_size(frame("a", 2)) * 2 / 3);
  const Outcome repaired = render("a", {"--frames", "1-3", "--spp", "2", "--resume"});
  EXPECT_NE(repaired.err.find("1 frame rendered, 2 already finished"), std::string::npos) << repaired.err;
  EXPECT_NE(repaired.err.find("frame 2: rendering again"), std::string::npos) << repaired.err;
  const Outcome more = render("a", {"--frames", "1-3", "--spp", "3", "--resume"});
  EXPECT_NE(more.err.find("spp was 2, now 3"), std::string::npos) << more.err;
  EXPECT_NE(more.err.find("3 frames rendered"), std::string::npos) << more.err;
  const Outcome param = render("a", {"--frames", "1", "--spp", "3", "--resume", "--max-depth", "2"});
  EXPECT_NE(param.err.find("parameters was"), std::string::npos) << param.err;
}

TEST_F(CliRender, KilledInTheMiddleThenResumedIsTheSame) {
  const std::vector<std::string> job{"--frames", "1-4", "--spp", "24", "--threads", "2"};
  ASSERT_EQ(render("whole", job).status, 0);
  {
    Process p(quick_render(path("killed/f.####.exr"), job));
    ASSERT_TRUE(p.wait_until([&] { return fs::exists(frame("killed", 2)); }));
    p.signal(SIGKILL);
    EXPECT_EQ(p.finish().status, 128 + SIGKILL);
  }
  EXPECT_FALSE(fs::exists(frame("killed", 4))) << "it was killed in the middle";
  std::vector<std::string> again = job;
  again.push_back("--resume");
  const Outcome o = render("killed", again);
  EXPECT_EQ(o.status, 0) << o.err;
  EXPECT_EQ(o.err.find("4 frames rendered"), std::string::npos) << "finished frames are kept: " << o.err;
  expect_same("whole", "killed", 1, 4);
}

TEST_F(CliRender, SignalsSaveTheFrameInProgress) {
  const std::vector<std::string> job{"--frames", "7", "--spp", "300", "--threads", "2"};
  ASSERT_EQ(render("whole", job).status, 0);
  for (const int signal : {SIGTERM, SIGINT}) {
    const std::string folder = signal == SIGTERM ? "term" : "int";
    std::vector<std::string> shown = job;
    shown.insert(shown.end(), {"--progress", "json"});
    Process p(quick_render(path(folder + "/f.####.exr"), shown));
    // The folder appears before the first tile; give tiles time to finish, but not all of them.
    ASSERT_TRUE(p.wait_until([&] { return fs::exists(path(folder)); }));
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    p.signal(signal);
    if (signal == SIGTERM) p.signal(SIGTERM);  // job systems send several
    const Outcome o = p.finish();
    EXPECT_EQ(o.status, 128 + signal) << o.err;
    EXPECT_TRUE(fs::exists(frame(folder, 7) + ".partial")) << o.err;
    EXPECT_FALSE(fs::exists(frame(folder, 7)));
    std::vector<std::string> again = job;
    again.push_back("--resume");
    const Outcome resumed = render(folder, again);
    EXPECT_EQ(resumed.status, 0);
    EXPECT_NE(resumed.err.find("frame 7: continuing from"), std::string::npos) << resumed.err;
    expect_same("whole", folder, 7, 7);
    EXPECT_EQ(files(folder), 1u);
  }
}

TEST_F(CliRender, SecondInterruptEndsAtOnce) {
  // A single tile that takes minutes, so that nothing but the second signal can end it.
  Process p(quick_render(path("a/f.####.exr"), {"--frames", "1", "--spp", "5000000", "--crop", "40,30,8,8"}));
  // The scene is small: after this much work the tile has begun. A signal before that would end the run by itself.
  ASSERT_TRUE(p.wait_until([&] { return fs::exists(path("a")) && p.cpu_seconds() > 1.5; }));
  p.signal(SIGINT);
  ASSERT_TRUE(p.wait_until([&] { return p.err_so_far().find("stopping") != std::string::npos; }));
  p.signal(SIGINT);
  EXPECT_EQ(p.finish().status, 130);
  EXPECT_FALSE(fs::exists(frame("a", 1) + ".partial"));
}

TEST_F(CliRender, UnwritableOutputIsOneMessageBeforeRendering) {
  // As root every folder is writable, but not one below a file or in /proc.
  write("file", "x");
  for (const std::string& output : {path("file/f.####.exr"), std::string("/proc/nowhere/f.####.exr")}) {
    const Outcome o = run(quick_render(output, {"--frames", "1-2", "--spp", "1"}));
    EXPECT_EQ(o.status, 1) << o.err;
    EXPECT_EQ(o.err.find("done:"), std::string::npos) << o.err;
    EXPECT_EQ(o.err.find("tempera: "), o.err.rfind("tempera: ")) << o.err;
    EXPECT_NE(o.err.find(output.substr(0, output.rfind('/'))), std::string::npos) << o.err;
  }
  if (geteuid() == 0) return;
  fs::create_directories(path("locked"));
  fs::permissions(path("locked"), fs::perms::owner_read | fs::perms::owner_exec);
  EXPECT_EQ(render("locked", {"--frames", "1", "--spp", "1"}).status, 1);
  fs::permissions(path("locked"), fs::perms::owner_all);
}

TEST_F(CliRender, FullDiskKeepsWhatIsFinished) {
  ASSERT_EQ(render("a", {"--frames", "1", "--spp", "2"}).status, 0);
  const std::string before = text_of(frame("a", 1));
  const Outcome o = render("a", {"--frames", "1-3", "--spp", "2", "--resume"}, [] {
    const rlimit limit{20000, 20000};  // a file may not grow beyond this: what a full disk looks like to a program
    setrlimit(RLIMIT_FSIZE, &limit);
  });
  EXPECT_EQ(o.status, 1) << o.err;
  EXPECT_NE(o.err.find("f.0002.exr"), std::string::npos) << o.err;
  EXPECT_EQ(std::count(o.err.begin(), o.err.end(), '\n'), 2) << "the frames, and one message: " << o.err;
  EXPECT_EQ(text_of(frame("a", 1)), before);
  EXPECT_EQ(files("a"), 1u) << "no temporary files";
  EXPECT_EQ(render("a", {"--frames", "1-3", "--spp", "2", "--resume"}).status, 0);
}

TEST_F(CliRender, MemoryLimitIsStatusFiveAndOneLine) {
  // Refused by the estimate: pictures of 4 GiB.
  const Outcome estimate =
      run({"render", source_file("scenes/tests/cornell.xml"), "-o", path("a/f.####.exr"), "--frames", "1", "--spp", "1",
           "--resolution", "16384x16384", "--memory-limit", "600M"});
  EXPECT_EQ(estimate.status, 5) << estimate.err;
  EXPECT_NE(estimate.err.find("--memory-limit"), std::string::npos) << estimate.err;
  // Less than the program takes by itself: found out while running, wherever that is, or by the estimate.
  for (const int mebibytes : {8, 16, 24, 25, 26, 32, 48, 100, 200, 300}) {
    const Outcome o = render("a", {"--frames", "1", "--spp", "1", "--memory-limit", std::to_string(mebibytes) + "M"});
    EXPECT_EQ(o.status, 5) << mebibytes << ": " << o.err;
    EXPECT_EQ(std::count(o.err.begin(), o.err.end(), '\n'), 1) << mebibytes << ": " << o.err;
  }
  EXPECT_EQ(render("a", {"--frames", "1", "--spp", "1", "--memory-limit", "4G"}).status, 0);
}

TEST_F(CliRender, ProgressForMachines) {
  const Outcome json = render("a", {"--frames", "1-2", "--spp", "1", "--progress", "json"});
  ASSERT_EQ(json.status, 0) << json.err;
  std::istringstream lines(json.out);
  std::vector<std::string> kinds;
  for (std::string line; std::getline(lines, line);) {
    const auto j = nlohmann::json::parse(line);
    kinds.push_back(j.at("event"));
    if (kinds.back() == "done") {
      EXPECT_EQ(j.at("path"), frame("a", j.at("frame")));
      EXPECT_EQ(j.at("samples"), 80 * 60);
      EXPECT_EQ(j.at("bad_samples"), 0);
    }
  }
  EXPECT_EQ(kinds.front(), "start");
  EXPECT_EQ(kinds.back(), "end");
  EXPECT_EQ(std::count(kinds.begin(), kinds.end(), "done"), 2);
  const Outcome jd = render("a", {"--frames", "1-2", "--spp", "1", "--progress", "openjd"});
  EXPECT_EQ(jd.out.rfind("openjd_progress: 0.00\n", 0), 0u) << jd.out;
  EXPECT_EQ(jd.out.find("rror"), std::string::npos);
  const Outcome quiet = render("a", {"--frames", "1", "--spp", "1", "-q"});
  EXPECT_EQ(quiet.out + quiet.err, "");
}

TEST_F(CliRender, AbsentViewerChangesNothing) {
  ASSERT_EQ(render("a", {"--frames", "1", "--spp", "2"}).status, 0);
  const Outcome o = render("b", {"--frames", "1", "--spp", "2", "--tev", "127.0.0.1:1"});
  EXPECT_EQ(o.status, 0) << o.err;
  expect_same("a", "b", 1, 1);
}

TEST_F(CliRender, ReplayGivesTheSample) {
  ASSERT_EQ(render("a", {"--frames", "3", "--spp", "1"}).status, 0);
  const Outcome o = render("a", {"--frames", "3", "--spp", "1", "--replay", "3,40,30,0"});
  ASSERT_EQ(o.status, 0) << o.err;
  const Rgb c = read_frame(frame("a", 3)).layer("color").rgb(40, 30);
  EXPECT_EQ(o.out, fmt::format("frame 3, pixel 40,30, sample 0: {:g} {:g} {:g}\n", c.r, c.g, c.b));
}

TEST_F(CliRender, FlagsAndKeysSayTheSame) {
  const std::string shot =
      write("shot.toml", fmt::format("scene = \"{}\"\nframes = \"2\"\n"
                                     "[shutter]\nopen = -0.25\nclose = 0.25\n"
                                     "[film]\nresolution = [80, 60]\nfilter = \"tent\"\nfilter_radius = 1.5\n"
                                     "[sampling]\nspp = 2\nseed = 3\n"
                                     "[integrator]\nmax_depth = 4\n[decompose]\ndirect = \"ED\"\nrest = \"ED.+\"\n",
                                     source_file("scenes/tests/cornell_motion.xml")));
  ASSERT_EQ(run({"render", shot, "-o", path("a/f.####.exr")}).status, 0);
  const Outcome o = run({"render",       source_file("scenes/tests/cornell_motion.xml"),
                         "-o",           path("b/f.####.exr"),
                         "--frames",     "2",
                         "--shutter",    "-0.25,0.25",
                         "--resolution", "80x60",
                         "--filter",     "tent:1.5",
                         "--spp",        "2",
                         "--seed",       "3",
                         "--max-depth",  "4",
                         "--decompose",  "direct=ED;rest=ED.+"});
  ASSERT_EQ(o.status, 0) << o.err;
  expect_same("a", "b", 2, 2);
  const Outcome resumed = run({"render", shot, "-o", path("b/f.####.exr"), "--resume"});
  EXPECT_NE(resumed.err.find("0 frames rendered, 1 already finished"), std::string::npos)
      << "the fingerprints agree: " << resumed.err;
}

TEST_F(CliRender, CompareMeasuresAndLimits) {
  ASSERT_EQ(render("a", {"--frames", "1-2", "--spp", "1"}).status, 0);
  ASSERT_EQ(render("b", {"--frames", "1-2", "--spp", "8"}).status, 0);
  const auto compare = [&](const std::string& test, std::vector<std::string> more) {
    std::vector<std::string> arguments{"compare", path(test + "/f.####.exr"), "--reference", path("b/f.####.exr")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  EXPECT_EQ(compare("b", {"--threshold", "relmse=0", "--threshold", "flip=0"}).status, 0) << "equal sequences";
  const Outcome o = compare("a", {"--threshold", "relmse=1e-6", "--csv", path("c.csv"), "--json", path("c.json"),
                                  "--error-map", path("e.png")});
  EXPECT_EQ(o.status, 6);
  EXPECT_NE(o.err.find("relmse of frame 1"), std::string::npos) << o.err;
  EXPECT_EQ(compare("a", {"--threshold", "relmse=1e6"}).status, 0);
  const auto j = nlohmann::json::parse(text_of(path("c.json")));
  EXPECT_GT(j.at("sides")[0].at("mean").at("relmse").get<double>(), 0);
  const std::string csv = text_of(path("c.csv"));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 5) << csv;
  EXPECT_TRUE(fs::exists(path("e.0001.png")) && fs::exists(path("e.0002.png")));
}

TEST_F(CliRender, RunMakesTheMovie) {
  const std::string shot = write(
      "shot.toml", fmt::format("scene = \"{}\"\nframes = \"1-3\"\n[output]\npath = \"{}\"\n[video]\npath = \"{}\"\n",
                               source_file("scenes/tests/cornell_motion.xml"), path("f.####.exr"), path("m.mp4")));
  const Outcome o = run({"run", shot, "--resolution", "64x48", "--spp", "1"});
  if (std::system("ffmpeg -version >/dev/null 2>&1") != 0) {
    EXPECT_EQ(o.status, 4) << o.err;
    return;
  }
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_GT(fs::file_size(path("m.mp4")), 500u);
  EXPECT_NE(run({"run", shot, "--resolution", "64x48", "--spp", "1", "--resume"}).err.find("3 already finished"),
            std::string::npos);
  EXPECT_EQ(run({"video", path("f.####.exr"), path("n.mp4"), "--fps", "12", "--layer", "color", "--contact-sheet",
                 path("s.png")})
                .status,
            0);
  EXPECT_GT(fs::file_size(path("s.png")), 500u);
}

}  // namespace
}  // namespace tempera::test
