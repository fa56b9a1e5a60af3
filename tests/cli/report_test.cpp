// SPDX-License-Identifier: Apache-2.0
// `tempera compare --html` as a user runs it. What the page then does is the matter of tests/report.
#include "program.h"

namespace tempera::test {
namespace {

class CompareHtml : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    ASSERT_EQ(run(quick_render(path("a/f.####.exr"), {"--frames", "1-2", "--spp", "1"})).status, 0);
    ASSERT_EQ(run(quick_render(path("b/f.####.exr"), {"--frames", "1-2", "--spp", "4", "--seed", "5"})).status, 0);
  }
  std::string a() const { return path("a/f.####.exr"); }
  std::string b() const { return path("b/f.####.exr"); }
};

TEST_F(CompareHtml, WritesAPageBesideTheFigures) {
  const Outcome o = run({"compare", a(), "--reference", b(), "--html", path("out/report.html"), "--title", "A & B",
                         "--csv", path("figures.csv"), "--error-map", path("map.####.png")});
  EXPECT_EQ(o.status, 0) << o.err;
  EXPECT_NE(o.out.find("report.html: "), std::string::npos) << o.out;
  const std::string page = text_of(path("out/report.html"));
  EXPECT_NE(page.find("<title>A &amp; B</title>"), std::string::npos);
  for (const char* id : {"picture-0-1", "picture-0-2", "picture-reference-2", "map-flip-0-1", "motion-backward-2"}) {
    EXPECT_NE(page.find("id=\"" + std::string(id) + "\""), std::string::npos) << id;
  }
  EXPECT_TRUE(fs::exists(path("figures.csv")));
  EXPECT_TRUE(fs::exists(path("map.0002.png"))) << "other observers still see the frames";
}

TEST_F(CompareHtml, ThresholdsStillCount) {
  const Outcome o =
      run({"compare", a(), "--reference", b(), "--html", path("report.html"), "--threshold", "relmse=1e-9"});
  EXPECT_EQ(o.status, 6);
  EXPECT_TRUE(fs::exists(path("report.html")));
}

TEST_F(CompareHtml, NeedsNoReference) {
  const Outcome o = run({"compare", a(), b(), "--html", path("report.html"), "--html-scale", "50"});
  EXPECT_EQ(o.status, 0) << o.err;
  const std::string page = text_of(path("report.html"));
  EXPECT_NE(page.find("\"reference\":null"), std::string::npos);
  EXPECT_NE(page.find("\"width\":40,\"height\":30"), std::string::npos);
}

TEST_F(CompareHtml, SaysWhatIsMissingOrWrong) {
  const Outcome without = run({"compare", a(), b()});
  EXPECT_EQ(without.status, 2);
  EXPECT_NE(without.err.find("--reference is missing"), std::string::npos) << without.err;
  const Outcome tone = run({"compare", a(), b(), "--html", path("r.html"), "--tone-map", "purple"});
  EXPECT_EQ(tone.status, 3);
  EXPECT_NE(tone.err.find("srgb, filmic, none"), std::string::npos) << tone.err;
  const Outcome place = run({"compare", a(), b(), "--html", "/proc/none/report.html"});
  EXPECT_EQ(place.status, 1);
  const Outcome scale = run({"compare", a(), b(), "--html", path("r.html"), "--html-scale", "0"});
  EXPECT_EQ(scale.status, 2);
}

}  // namespace
}  // namespace tempera::test
