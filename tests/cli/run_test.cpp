// SPDX-License-Identifier: Apache-2.0
// A shot from its file to final frames and a movie: in one go, in parts, and after every kind of interruption.
#include <fmt/format.h>

#include <cstdlib>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "program.h"

namespace tempera::test {
namespace {

constexpr int kFrames = 12;

class CliRun : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    shot_ = write_shot("dance.toml", "window = 4\noverlap = 2\n");
  }
  /// `reconstruct`: lines of its table.
  std::string write_shot(const std::string& name, const std::string& reconstruct) const {
    return write(name, fmt::format("scene = \"{}\"\nframes = \"1-{}\"\n[film]\nresolution = [32, 24]\n"
                                   "[sampling]\nspp = 2\n[integrator]\nname = \"temporal_gradient_path\"\n"
                                   "[reconstruct]\n{}",
                                   source_file("scenes/tests/cornell_motion.xml"), kFrames, reconstruct));
  }
  std::vector<std::string> arguments(const std::string& folder, std::vector<std::string> more = {}) const {
    std::vector<std::string> all{"run", shot_, "-o", path(folder)};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  Outcome run_to(const std::string& folder, std::vector<std::string> more = {},
                 const std::function<void()>& prepare = {}) const {
    return run(arguments(folder, std::move(more)), prepare);
  }
  std::string rendered(const std::string& folder, int frame) const {
    return path(fmt::format("{}/dance.{:04}.exr", folder, frame));
  }
  std::string final_frame(const std::string& folder, int frame) const {
    return path(fmt::format("{}/final/dance.{:04}.exr", folder, frame));
  }
  std::string movie(const std::string& folder) const { return path(folder + "/dance.mp4"); }
  void expect_same_result(const std::string& a, const std::string& b, int first = 1, int last = kFrames) const {
    for (int f = first; f <= last; ++f) EXPECT_TRUE(SamePixels(final_frame(a, f), final_frame(b, f)));
  }
  /// All files below a folder with their contents.
  std::map<std::string, std::string> contents(const std::string& folder) const {
    std::map<std::string, std::string> out;
    for (const auto& entry : fs::recursive_directory_iterator(path(folder))) {
      if (entry.is_regular_file()) out[fs::relative(entry.path(), path(folder))] = text_of(entry.path());
    }
    return out;
  }
  static void expect_failure(const Outcome& o, int status, const std::string& what) {
    EXPECT_EQ(o.status, status) << o.err;
    EXPECT_NE(o.err.find(what), std::string::npos) << o.err;
    EXPECT_EQ(o.err.find("tempera: "), o.err.rfind("tempera: ")) << o.err;
  }
  static bool has_ffmpeg() { return std::system("ffmpeg -version >/dev/null 2>&1") == 0; }

  std::string shot_;
};

TEST_F(CliRun, QualityLeavesCleanFramesOfWhatWasAskedFor) {
  const std::string shot = write("plain.toml", fmt::format("scene = \"{}\"\nframes = \"1-3\"\nquality = \"draft\"\n"
                                                           "[film]\nresolution = [24, 18]\n[sampling]\nspp = 2\n"
                                                           "[output]\nlayers = [\"depth\"]\n"
                                                           "[denoise]\nmethod = \"nl_means\"\n",
                                                           source_file("scenes/tests/cornell_motion.xml")));
  const Outcome o = run({"run", shot, "-o", path("q/f.####.exr"), "--no-video"});
  ASSERT_EQ(o.status, 0) << o.err;
  for (int f = 1; f <= 3; ++f) {
    const Frame noisy = read_frame(path(fmt::format("q/f.{:04}.exr", f)));
    const Frame clean = read_frame(path(fmt::format("q/final/f.{:04}.exr", f)));
    EXPECT_TRUE(noisy.has("color.a") && noisy.has("albedo") && noisy.has("motion.backward"));
    EXPECT_EQ(clean.layer_names(), (std::vector<std::string>{"color", "depth"}));
    EXPECT_EQ(std::get<int>(clean.metadata.at("tempera/spp")), 2);
  }
  // The same command finds everything done; other layers of the result are not the same.
  const Outcome again = run({"run", shot, "-o", path("q/f.####.exr"), "--no-video", "--resume"});
  EXPECT_NE(again.err.find("0 frames denoised, 3 already finished"), std::string::npos) << again.err;
  const Outcome more =
      run({"run", shot, "-o", path("q/f.####.exr"), "--no-video", "--resume", "--layers", "depth,albedo"});
  ASSERT_EQ(more.status, 0) << more.err;
  EXPECT_TRUE(read_frame(path("q/final/f.0002.exr")).has("albedo"));
}

TEST_F(CliRun, LeavesFinalFramesAndAMovieAndHasNothingToDoTheSecondTime) {
  if (!has_ffmpeg()) GTEST_SKIP() << "ffmpeg is not installed";
  const Outcome o = run_to("a");
  ASSERT_EQ(o.status, 0) << o.err;
  for (const char* says : {"step 1 of 3: render", "step 2 of 3: reconstruct", "step 3 of 3: video",
                           "12 frames rendered", "12 frames reconstructed", "dance.mp4: 12 pictures"}) {
    EXPECT_NE(o.err.find(says), std::string::npos) << says << '\n' << o.err;
  }
  EXPECT_TRUE(read_frame(rendered("a", 6)).has("offset.source")) << "kept, so that it can be reconstructed again";
  EXPECT_FALSE(read_frame(final_frame("a", 6)).has("grad.x"));
  EXPECT_GT(fs::file_size(movie("a")), 500u);

  const auto before = contents("a");
  const Outcome again = run_to("a", {"--resume"});
  EXPECT_EQ(again.status, 0) << again.err;
  for (const char* says : {"0 frames rendered, 12 already finished", "0 frames reconstructed, 12 already finished",
                           "dance.mp4 is already finished"}) {
    EXPECT_NE(again.err.find(says), std::string::npos) << says << '\n' << again.err;
  }
  EXPECT_EQ(contents("a"), before);

  const Outcome cruder = run_to("a", {"--resume", "--set", "video.crf=40"});
  EXPECT_NE(cruder.err.find("0 frames reconstructed"), std::string::npos) << cruder.err;
  EXPECT_NE(cruder.err.find("12 pictures"), std::string::npos) << cruder.err;
  const Outcome other = run_to("a", {"--resume", "--set", "reconstruct.norm=l2"});
  EXPECT_NE(other.err.find("0 frames rendered"), std::string::npos) << other.err;
  EXPECT_NE(other.err.find("12 frames reconstructed"), std::string::npos) << other.err;
  EXPECT_NE(other.err.find("12 pictures"), std::string::npos) << other.err;
}

TEST_F(CliRun, PartsGiveTheBitsOfTheWhole) {
  ASSERT_EQ(run_to("whole", {"--no-video"}).status, 0);
  EXPECT_FALSE(fs::exists(movie("whole")));
  // Parts on machines of their own: each renders what its windows reach.
  const Outcome first = run_to("one", {"--frames", "1-5", "--no-video", "--threads", "1"});
  ASSERT_EQ(first.status, 0) << first.err;
  EXPECT_NE(first.err.find("frames 1-5 (5 frames) need 2 more rendered around them, for reconstruct: 6-7 (2 frames)"),
            std::string::npos)
      << first.err;
  ASSERT_EQ(run_to("two", {"--frames", "6-12", "--no-video", "--threads", "2"}).status, 0);
  EXPECT_FALSE(fs::exists(rendered("two", 3)));
  EXPECT_TRUE(fs::exists(rendered("two", 4)) && !fs::exists(final_frame("two", 5)));
  expect_same_result("whole", "one", 1, 5);
  expect_same_result("whole", "two", 6, 12);

  // Parts in one folder: what another part has rendered is taken.
  const auto part = [&](const char* frames) { return run_to("shared", {"--frames", frames, "--no-video"}); };
  ASSERT_EQ(part("1-5").status, 0);
  const Outcome last = part("8-12");
  EXPECT_NE(last.err.find("5 frames rendered, 2 already finished"), std::string::npos) << last.err;
  ASSERT_EQ(part("6-7").status, 0);
  expect_same_result("whole", "shared");

  // Render jobs, and reconstruct jobs that depend on them.
  for (const char* frames : {"1-4", "5-8", "9-12"})
    ASSERT_EQ(run({"render", shot_, "-o", path("jobs/dance.####.exr"), "--frames", frames}).status, 0);
  for (const char* frames : {"1-6", "7-12"}) {
    const Outcome o = run_to("jobs", {"--frames", frames, "--resume", "--no-video"});
    EXPECT_NE(o.err.find("0 frames rendered"), std::string::npos) << o.err;
  }
  expect_same_result("whole", "jobs");
  ASSERT_EQ(run({"reconstruct", path("jobs/dance.####.exr"), "-o", path("jobs2/final/dance.####.exr"), "--frames",
                 "3-5", "--window", "4", "--overlap", "2"})
                .status,
            0);
  expect_same_result("whole", "jobs2", 3, 5);
}

TEST_F(CliRun, FramesOfAnEarlierAndLongerShotDoNotCount) {
  ASSERT_EQ(run_to("whole", {"--no-video"}).status, 0);
  ASSERT_EQ(run({"render", shot_, "-o", path("stale/dance.####.exr"), "--frames", "10-16"}).status, 0);
  ASSERT_EQ(run_to("stale", {"--no-video"}).status, 0);
  expect_same_result("whole", "stale");
  const Outcome beyond = run_to("beyond", {"--frames", "11-14", "--no-video"});
  EXPECT_EQ(beyond.status, 0) << beyond.err;
  EXPECT_NE(beyond.err.find("the shot has frames 1-12"), std::string::npos) << beyond.err;
}

TEST_F(CliRun, HaloBoundsWhatIsRenderedAround) {
  ASSERT_EQ(run_to("whole", {"--no-video"}).status, 0);
  const auto part = [&](std::vector<std::string> more) {
    more.insert(more.end(), {"--frames", "5-7", "--no-video", "--resume"});
    return run_to("a", more);
  };
  // Windows of four frames begin at every second: 5 is in 2-5, 7 in 6-9.
  const Outcome cut = part({"--halo", "1"});
  ASSERT_EQ(cut.status, 0) << cut.err;
  EXPECT_NE(cut.err.find("need 2 more rendered around them, for reconstruct: 4,8 (2 frames)"), std::string::npos)
      << cut.err;
  EXPECT_NE(cut.err.find("halo = 1 leaves out frames 2-3,9 (3 frames)"), std::string::npos) << cut.err;
  EXPECT_NE(cut.err.find("frames 5-7 (3 frames) differ from those of the whole shot"), std::string::npos) << cut.err;
  EXPECT_NE(cut.err.find("halo = 3 leaves none out"), std::string::npos) << cut.err;
  EXPECT_TRUE(fs::exists(rendered("a", 4)) && !fs::exists(rendered("a", 3)) && !fs::exists(final_frame("a", 4)));
  EXPECT_TRUE(SamePixels(rendered("a", 5), rendered("whole", 5))) << "only what is made of them differs";
  EXPECT_FALSE(SamePixels(final_frame("a", 5), final_frame("whole", 5)));
  EXPECT_NE(part({"--halo", "1"}).err.find("0 frames reconstructed, 3 already"), std::string::npos);

  // What was made under a bound is not taken for what is made without, nor the other way round.
  const Outcome all = part({});
  EXPECT_NE(all.err.find("3 frames reconstructed"), std::string::npos) << all.err;
  EXPECT_EQ(all.err.find("leaves out"), std::string::npos) << all.err;
  expect_same_result("whole", "a", 5, 7);
  EXPECT_NE(part({"--set", "halo=3"}).err.find("0 frames reconstructed, 3 already"), std::string::npos) << "enough";
  EXPECT_NE(part({"--halo", "0"}).err.find("3 frames reconstructed"), std::string::npos);
  expect_failure(part({"--halo", "-1"}), 2, "--halo");
}

TEST_F(CliRun, StagesAreThoseOfTheShot) {
  const Outcome raw = run_to("a", {"--no-video", "--set", "stages=[]", "--frames", "1-2"});
  ASSERT_EQ(raw.status, 0) << raw.err;
  EXPECT_TRUE(fs::exists(rendered("a", 2)) && !fs::exists(path("a/final")) && !fs::exists(rendered("a", 3)));
  const Outcome named = run_to("a", {"--no-video", "--set", "stages=[\"reconstruct\"]", "--frames", "1-2", "--resume"});
  EXPECT_NE(named.err.find("step 2 of 2: reconstruct"), std::string::npos) << named.err;
  EXPECT_TRUE(fs::exists(final_frame("a", 2)));
  expect_failure(run_to("b", {"--set", "stages=reconstuct"}), 2, "known: reconstruct");
  expect_failure(run_to("b", {"--set", "stages=reconstruct", "--integrator", "path"}), 2,
                 "the integrator gradient_path or the integrator temporal_gradient_path would write it");
  EXPECT_FALSE(fs::exists(path("b")));
}

TEST_F(CliRun, KilledInAnyStepThenResumedGivesTheSameBits) {
  // Steps that last long enough to be stopped in their middle on a busy machine too.
  shot_ = write_shot("dance.toml", "window = 4\noverlap = 2\nrounds = 60\niterations = 100\n");
  const std::vector<std::string> slow{"--spp", "16", "--threads", "2"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.end(), slow.begin(), slow.end());
    return more;
  };
  const bool movies = has_ffmpeg();
  fs::create_directories(path("slow"));
  std::ofstream(path("slow/ffmpeg")) << "#!/bin/sh\nsleep 2\nPATH=${PATH#*:} exec ffmpeg \"$@\"\n";
  fs::permissions(path("slow/ffmpeg"), fs::perms::owner_all);
  const auto slow_movies = [&] { setenv("PATH", (path("slow") + ":" + std::getenv("PATH")).c_str(), 1); };
  const std::string none = movies ? "--progress=plain" : "--no-video";  // the former changes nothing
  ASSERT_EQ(run_to("whole", with({none})).status, 0);
  const auto stopped_when = [&](const std::function<bool(const Process&)>& when, int signal) {
    Process p(arguments("part", with({none, "--resume"})), slow_movies);
    EXPECT_TRUE(p.wait_until([&] { return when(p); }));
    p.signal(signal);
    return p.finish();
  };
  const auto says = [](const char* what) {
    return [what](const Process& p) { return p.err_so_far().find(what) != std::string::npos; };
  };
  EXPECT_EQ(stopped_when([&](const Process&) { return fs::exists(rendered("part", 3)); }, SIGKILL).status, 137);
  EXPECT_FALSE(fs::exists(rendered("part", kFrames))) << "it was killed in the middle";
  EXPECT_EQ(stopped_when([&](const Process&) { return fs::exists(rendered("part", 6)); }, SIGINT).status, 130);
  EXPECT_FALSE(fs::exists(rendered("part", kFrames)));
  EXPECT_EQ(stopped_when([&](const Process&) { return fs::exists(final_frame("part", 2)); }, SIGKILL).status, 137);
  EXPECT_FALSE(fs::exists(final_frame("part", kFrames)));
  const Outcome stopped = stopped_when([&](const Process&) { return fs::exists(final_frame("part", 6)); }, SIGINT);
  EXPECT_EQ(stopped.status, 130) << stopped.err;
  EXPECT_NE(stopped.err.find("--resume continues"), std::string::npos) << stopped.err;
  EXPECT_FALSE(fs::exists(final_frame("part", kFrames)));
  if (movies) {
    EXPECT_EQ(stopped_when(says("step 3 of 3"), SIGKILL).status, 137);
    EXPECT_FALSE(fs::exists(movie("part")));
    const Outcome in_video = stopped_when(says("step 3 of 3"), SIGINT);
    EXPECT_EQ(in_video.status, 130) << in_video.err;
    EXPECT_FALSE(fs::exists(movie("part")));
  }
  ASSERT_EQ(run_to("part", with({none, "--resume"})).status, 0);
  expect_same_result("whole", "part");
  if (!movies) return;
  EXPECT_EQ(text_of(movie("part")), text_of(movie("whole")));
}

TEST_F(CliRun, FullDiskInTheMiddleKeepsWhatIsFinished) {
  ASSERT_EQ(run({"render", shot_, "-o", path("a/dance.####.exr")}).status, 0);
  const Outcome o = run_to("a", {"--resume", "--no-video"}, [] {
    const rlimit limit{2000, 2000};  // a file may not grow beyond this: what a full disk looks like to a program
    setrlimit(RLIMIT_FSIZE, &limit);
  });
  expect_failure(o, 1, "dance.0001.exr");
  EXPECT_TRUE(fs::is_empty(path("a/final"))) << "no temporary files";
  EXPECT_EQ(run_to("a", {"--resume", "--no-video"}).status, 0);
}

TEST_F(CliRun, WithoutFfmpegTheFramesAreThere) {
  const Outcome o = run_to("a", {}, [] { setenv("PATH", "/nonexistent", 1); });
  expect_failure(o, 4, "apt install ffmpeg");
  EXPECT_NE(o.err.find("frames are finished: " + path("a/final/dance.####.exr")), std::string::npos) << o.err;
  EXPECT_TRUE(fs::exists(final_frame("a", kFrames)));
  EXPECT_EQ(run_to("a", {"--no-video", "--resume"}, [] { setenv("PATH", "/nonexistent", 1); }).status, 0);
}

TEST_F(CliRun, MoviesOfPartsHaveNamesOfTheirOwn) {
  if (!has_ffmpeg()) GTEST_SKIP() << "ffmpeg is not installed";
  // Without differences there is nothing to reconstruct.
  const Outcome o = run_to("a/d_####.exr", {"--integrator", "path", "--frames", "2-4"});
  ASSERT_EQ(o.status, 0) << o.err;
  EXPECT_NE(o.err.find("step 2 of 2: video"), std::string::npos) << o.err;
  EXPECT_TRUE(fs::exists(path("a/d.2-4.mp4")) && fs::exists(path("a/d_0002.exr")) && !fs::exists(path("a/final")));
  ASSERT_EQ(run_to("a", {"--integrator", "path", "--frames", "7"}).status, 0);
  EXPECT_FALSE(fs::exists(path("a/dance.7-7.mp4"))) << "one picture is no movie";
  ASSERT_EQ(run_to("a", {"--integrator", "gradient_path", "--frames", "7-8", "--set", "video.path=" + path("b/m.mkv"),
                         "--set", "reconstruct.path=" + path("b/done")})
                .status,
            0);
  EXPECT_TRUE(fs::exists(path("b/m.mkv")) && fs::exists(path("b/done/dance.0007.exr")));
  EXPECT_FALSE(fs::exists(rendered("a", 9))) << "windows need an offset pass";
}

TEST_F(CliRun, EventsForPrograms) {
  const Outcome o = run_to("a", {"--no-video", "--progress", "json"});
  ASSERT_EQ(o.status, 0) << o.err;
  std::vector<std::string> steps;
  nlohmann::json last;
  std::istringstream lines(o.out);
  for (std::string line; std::getline(lines, line);) {
    last = nlohmann::json::parse(line);
    if (last["event"] == "step") steps.push_back(last["step"]);
  }
  EXPECT_EQ(steps, (std::vector<std::string>{"render", "reconstruct"}));
  EXPECT_EQ(last["event"], "result");
  EXPECT_EQ(last["steps"][1]["path"], path("a/final/dance.####.exr"));

  const Outcome jd = run_to("b", {"--no-video", "--progress", "openjd"});
  double percent = 0;
  std::istringstream jd_lines(jd.out);
  for (std::string line; std::getline(jd_lines, line);) {
    const std::string key = "openjd_progress: ";
    if (!line.starts_with(key)) continue;
    EXPECT_GE(std::stod(line.substr(key.size())), percent) << "one job, not two";
    percent = std::stod(line.substr(key.size()));
  }
  EXPECT_EQ(percent, 100);
}

TEST_F(CliRun, ErrorsComeBeforeTheWorkAndNameTheirPlace) {
  const auto fails = [&](const std::string& text, const std::string& what) {
    const std::string shot = write_shot("bad.toml", text);
    const Outcome o = run({"run", shot, "-o", path("out")});
    expect_failure(o, 3, what);
    // The first line that write_shot leaves to us, or the one below a table of our own.
    EXPECT_NE(o.err.find(fmt::format("{}:{}:", shot, text[0] == '[' ? 11 : 10)), std::string::npos) << o.err;
    EXPECT_FALSE(fs::exists(path("out"))) << o.err;
  };
  fails("alhpa = 0.3\n", "known: reconstruct.alpha");
  fails("norm = \"l3\"\n", "l1, l2");
  fails("alpha = 0\n", "alpha");
  fails("overlap = 10\n", "needs windows of more than 10");
  fails(fmt::format("path = \"{}\"\n", path("out/bad.####.exr")), "would replace");
  fails("[video]\npath = \"movie.gif\"\n", "must end in .mp4");
  fails("[video]\nlayer = \"grad.x\"\n", "no layer \"grad.x\"");
  expect_failure(run_to("out", {"--set", "reconstruct.window=0"}), 2, "window");
  expect_failure(run_to("out", {"--integrator", "gradient_path", "--set", "reconstruct.weights=variance"}), 3,
                 "compares the two passes");
  EXPECT_FALSE(fs::exists(path("out")));
  write("file", "x");
  expect_failure(run_to("out", {"--set", "reconstruct.path=" + path("file/f.####.exr")}), 1, path("file"));
}

}  // namespace
}  // namespace tempera::test
