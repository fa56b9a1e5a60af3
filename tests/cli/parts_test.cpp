// SPDX-License-Identifier: Apache-2.0
// Work on a frame that is killed, divided among machines, or asked for in single pixels: the same bits as in one go.
#include <fmt/format.h>

#include "program.h"

namespace tempera::test {
namespace {

class CliParts : public CliTest {
 protected:
  std::vector<std::string> command(const std::string& folder, const std::vector<std::string>& more) const {
    return with({"render", source_file("scenes/tests/cornell_motion.xml"), "-o", path(folder + "/f.####.exr"),
                 "--resolution", "80x60"},
                more);
  }
  Outcome render(const std::string& folder, const std::vector<std::string>& more) const {
    return run(command(folder, more));
  }
  std::string frame(const std::string& folder, int number) const {
    return path(fmt::format("{}/f.{:04}.exr", folder, number));
  }
  static std::vector<std::string> with(std::vector<std::string> list, const std::vector<std::string>& more) {
    list.insert(list.end(), more.begin(), more.end());
    return list;
  }
};

std::vector<std::string> light(const std::string& spp) {
  return {"--integrator", "light_path", "--frames", "2-3", "--spp", spp, "--param", "section=3", "--shutter", "0,1.4"};
}

TEST_F(CliParts, KilledWorkContinuesInEveryPass) {
  const std::vector<std::vector<std::string>> jobs{
      {"--frames", "3", "--spp", "80"},
      light("60"),
      {"--integrator", "temporal_gradient_path", "--frames", "3", "--spp", "48", "--param", "adaptive=published"},
      {"--integrator", "gradient_path", "--frames", "3", "--spp", "32", "--param", "adaptive=unbiased"}};
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    const std::string whole = fmt::format("whole{}", i), killed = fmt::format("killed{}", i);
    ASSERT_EQ(render(whole, jobs[i]).status, 0);
    const std::string first = frame(killed, i == 1 ? 2 : 3);
    int kills = 0;
    for (; kills < 3 && !fs::exists(first); ++kills) {
      Process p(command(killed, with(jobs[i], {"--resume", "--checkpoint-minutes", "0.002"})));
      const auto before =
          fs::exists(first + ".partial") ? fs::last_write_time(first + ".partial") : fs::file_time_type();
      ASSERT_TRUE(p.wait_until([&] {
        std::error_code ignored;
        return fs::exists(first, ignored) || fs::last_write_time(first + ".partial", ignored) > before;
      }));
      p.signal(SIGKILL);
      p.finish();
    }
    EXPECT_GT(kills, 0);
    const Outcome resumed = render(killed, with(jobs[i], {"--resume"}));
    ASSERT_EQ(resumed.status, 0) << resumed.err;
    if (!fs::exists(first)) ADD_FAILURE() << resumed.err;
    for (const int f : {2, 3}) {
      if (!fs::exists(frame(whole, f))) continue;
      EXPECT_TRUE(SamePixels(frame(whole, f), frame(killed, f))) << i;
    }
  }
}

TEST_F(CliParts, PartsAddUpToTheBitsOfOneRun) {
  for (const std::vector<std::string>& job :
       {light("40"), std::vector<std::string>{"--frames", "2-3", "--spp", "4", "--layers", "albedo,motion,cryptomatte"},
        std::vector<std::string>{"--integrator", "temporal_gradient_path", "--frames", "2-3", "--spp", "4"}}) {
    fs::remove_all(path("one"));
    ASSERT_EQ(render("one", job).status, 0);
    for (const char* part : {"1/3", "2/3", "3/3"})
      ASSERT_EQ(render(std::string("part") + part[0], with(job, {"--part", part})).status, 0);
    const Outcome two = run({"merge", path("part1"), path("part3"), "-o", path("merged")});
    EXPECT_EQ(two.status, 3) << two.err;
    EXPECT_NE(two.err.find("parts are missing"), std::string::npos) << two.err;
    const Outcome twice = run({"merge", path("part1"), path("part1"), path("part2"), "-o", path("merged")});
    EXPECT_EQ(twice.status, 3);
    EXPECT_NE(twice.err.find("in another part, too"), std::string::npos) << twice.err;
    const Outcome all = run({"merge", path("part3"), path("part1"), path("part2"), "-o", path("merged")});
    ASSERT_EQ(all.status, 0) << all.err;
    for (const int f : {2, 3}) {
      EXPECT_TRUE(SamePixels(frame("one", f), frame("merged", f)));
      EXPECT_EQ(std::get<std::string>(read_metadata(frame("one", f)).at("tempera/fingerprint")),
                std::get<std::string>(read_metadata(frame("merged", f)).at("tempera/fingerprint")));
    }
    for (const char* folder : {"part1", "part2", "part3", "merged"}) fs::remove_all(path(folder));
  }
}

TEST_F(CliParts, PartsOfOtherThingsAreRefused) {
  ASSERT_EQ(render("a", with(light("40"), {"--part", "1/2"})).status, 0);
  ASSERT_EQ(render("b", with(light("40"), {"--part", "2/2", "--seed", "9"})).status, 0);
  const Outcome mixed = run({"merge", path("a"), path("b"), "-o", path("c")});
  EXPECT_EQ(mixed.status, 3);
  EXPECT_NE(mixed.err.find("other settings"), std::string::npos) << mixed.err;
  // Another version, whatever it wrote after its name: not damaged.
  fs::create_directory(path("old"));
  for (const char* begin : {"tempera checkpoint 2\n", "tempera checkpoint 14\n"}) {
    write("old/f.0002.exr.part1of2", begin + std::string(100, 'x'));
    const Outcome old = run({"merge", path("old"), "-o", path("c")});
    EXPECT_EQ(old.status, 3);
    EXPECT_NE(old.err.find("it is of another version"), std::string::npos) << old.err;
    write("old/f.0002.exr.partial", begin + std::string(100, 'x'));
    const Outcome resumed = render("old", {"--frames", "2", "--spp", "1", "--resume"});
    EXPECT_EQ(resumed.status, 0);
    EXPECT_NE(resumed.err.find("starting over"), std::string::npos) << resumed.err;
    EXPECT_NE(resumed.err.find("it is of another version"), std::string::npos) << resumed.err;
    fs::remove(frame("old", 2));
  }
  fs::create_directory(path("empty"));
  EXPECT_EQ(run({"merge", path("empty"), "-o", path("c")}).status, 4);
  for (const auto& entry : fs::directory_iterator(path("a")))
    fs::resize_file(entry.path(), fs::file_size(entry.path()) / 2);
  const Outcome damaged = run({"merge", path("a"), "-o", path("c")});
  EXPECT_EQ(damaged.status, 3);
  EXPECT_NE(damaged.err.find("it is damaged"), std::string::npos) << damaged.err;
  for (const char* part : {"0/2", "3/2", "1", "a/b"}) EXPECT_EQ(render("d", {"--part", part}).status, 2) << part;
  const Outcome adaptive = render("d", {"--integrator", "gradient_path", "--frames", "1", "--spp", "64", "--param",
                                        "adaptive=published", "--part", "1/2"});
  EXPECT_EQ(adaptive.status, 3) << adaptive.err;
  EXPECT_NE(adaptive.err.find("divide the frames"), std::string::npos) << adaptive.err;
}

TEST_F(CliParts, AMaskChoosesPixels) {
  ASSERT_EQ(render("whole", {"--frames", "2", "--spp", "4"}).status, 0);
  const Frame whole = read_frame(frame("whole", 2));
  Frame mask(whole.width(), whole.height());
  Image& on = mask.create({"mask", {""}, "", Combine::kFirst});
  for (int y = 0; y < on.height(); ++y) {
    for (int x = 0; x < on.width(); ++x) on.at(x, y) = (x + 2 * y) % 5 == 0 ? 1.0f : 0.0f;
  }
  write_frame(path("m.0002.exr"), mask);
  const Outcome o = render("sparse", {"--frames", "2", "--spp", "4", "--mask", path("m.####.exr")});
  ASSERT_EQ(o.status, 0) << o.err;
  const Frame sparse = read_frame(frame("sparse", 2));
  for (int y = 0; y < on.height(); ++y) {
    for (int x = 0; x < on.width(); ++x) {
      const Rgb expected = on.at(x, y) > 0 ? whole.layer("color").rgb(x, y) : Rgb(0.0f);
      ASSERT_EQ(sparse.layer("color").rgb(x, y), expected) << x << " " << y;
    }
  }
  EXPECT_NE(std::get<std::string>(sparse.metadata.at("tempera/fingerprint")),
            std::get<std::string>(whole.metadata.at("tempera/fingerprint")));
  const Outcome gradients =
      render("no", {"--integrator", "gradient_path", "--frames", "2", "--spp", "4", "--mask", path("m.####.exr")});
  EXPECT_EQ(gradients.status, 2);
  EXPECT_NE(gradients.err.find("takes no mask"), std::string::npos) << gradients.err;
  // Told before a frame is rendered, of any frame.
  const Outcome gap = render("no", {"--frames", "2-3", "--spp", "4", "--mask", path("m.####.exr")});
  EXPECT_EQ(gap.status, 4);
  EXPECT_NE(gap.err.find("m.0003.exr"), std::string::npos) << gap.err;
  Frame small(8, 8);
  small.create(layers::mask());
  write_frame(path("m.0003.exr"), small);
  const Outcome size = render("no", {"--frames", "2-3", "--spp", "4", "--mask", path("m.####.exr")});
  EXPECT_EQ(size.status, 3);
  EXPECT_NE(size.err.find("this mask has 8x8 pixels, the picture has 80x60"), std::string::npos) << size.err;
  Frame picture(whole.width(), whole.height());
  picture.create(layers::color()), picture.create(layers::normal());
  write_frame(path("m.0003.exr"), picture);
  const Outcome none = render("no", {"--frames", "2-3", "--spp", "4", "--mask", path("m.####.exr")});
  EXPECT_EQ(none.status, 3);
  EXPECT_NE(none.err.find("none of its layers is a mask"), std::string::npos) << none.err;
  EXPECT_FALSE(fs::exists(path("no")));
}

TEST_F(CliParts, MasksOfASequenceAreFilledOnFiles) {
  const std::vector<std::string> job{"--frames", "1-3", "--spp", "16", "--layers", "albedo,normal"};
  ASSERT_EQ(render("whole", job).status, 0);
  // What a stage would have written: frames in which pixels are missing, with a mask of each.
  for (int f = 1; f <= 3; ++f) {
    Frame base = read_frame(frame("whole", f));
    base.remove("normal");
    Image& mask = base.create(layers::mask());
    for (int y = 0; y < mask.height(); ++y) {
      for (int x = 0; x < mask.width(); ++x) {
        if ((x * f + y) % 3 != 0) continue;
        mask.at(x, y) = 1;
        for (const char* name : {"color", "albedo"}) base.layer(name).set_rgb(x, y, Rgb(-1.0f));
      }
    }
    write_frame(frame("base", f), base);
  }
  const auto sparse = with(job, {"--mask", path("base/f.####.exr")});
  {
    Process p(command("pixels", with(sparse, {"--checkpoint-minutes", "0.002"})));
    const std::string partial = frame("pixels", 1) + ".partial";
    ASSERT_TRUE(p.wait_until([&] { return fs::exists(partial) || fs::exists(frame("pixels", 1)); }));
    p.signal(SIGKILL);
    p.finish();
  }
  ASSERT_EQ(render("pixels", with(sparse, {"--resume"})).status, 0);
  const std::vector<std::string> fill{"fill", path("base"), path("pixels"), "-o", path("filled")};
  ASSERT_EQ(run(with(fill, {"--frames", "2", "--threads", "1"})).status, 0);
  const Outcome filled = run(with(fill, {"--resume"}));
  ASSERT_EQ(filled.status, 0) << filled.err;
  EXPECT_NE(filled.err.find("2 frames filled, 1 already finished"), std::string::npos) << filled.err;
  for (int f = 1; f <= 3; ++f) {
    const Frame got = read_frame(frame("filled", f)), wanted = read_frame(frame("whole", f));
    EXPECT_EQ(got.layer_names(), (std::vector<std::string>{"color", "albedo"}));
    for (const char* name : {"color", "albedo"}) EXPECT_EQ(got.layer(name), wanted.layer(name)) << name << f;
  }
  fs::remove(frame("pixels", 2));
  const Outcome gap = run(fill);
  EXPECT_EQ(gap.status, 3);
  EXPECT_NE(gap.err.find("lacks frames that go with the others: 2"), std::string::npos) << gap.err;
}

}  // namespace
}  // namespace tempera::test
