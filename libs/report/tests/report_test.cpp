// SPDX-License-Identifier: Apache-2.0
#include "tempera/report/report.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <sstream>

#include "embedded_text.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"
#include "tempera/report/picture_code.h"

namespace tempera {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

/// Hash of a pixel in [0,1): noise that needs no state.
float noise(int x, int y, int frame, int seed) {
  std::uint32_t h = std::uint32_t(x) * 0x8da6b343u ^ std::uint32_t(y) * 0xd8163841u ^
                    std::uint32_t(frame) * 0xcb1ab31fu ^ std::uint32_t(seed) * 0x165667b1u;
  h ^= h >> 15, h *= 0x2c1b3c6du, h ^= h >> 12, h *= 0x297a2d39u, h ^= h >> 15;
  return float(h >> 8) * 0x1p-24f;
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream out;
  out << in.rdbuf();
  return out.str();
}

std::string from_base64(const std::string& text) {
  std::string out;
  unsigned bits = 0, value = 0;
  for (const char c : text) {
    if (c == '=') break;
    const std::string_view digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    value = value << 6 | unsigned(digits.find(c));
    if ((bits += 6) >= 8) out += char(value >> (bits -= 8) & 0xff);
  }
  return out;
}

/// A page as a program reads it that knows docs/report.md alone.
struct Page {
  explicit Page(const std::string& file) : text(text_of(file)) {
    const std::string mark = "id=\"report-data\">";
    const std::size_t begin = text.find(mark) + mark.size();
    data = Json::parse(text.substr(begin, text.find("</script>", begin) - begin));
  }
  bool has(const std::string& id) const { return text.find("id=\"" + id + "\"") != std::string::npos; }
  Image block(const std::string& id) const {
    const std::size_t at = text.find("id=\"" + id + "\"");
    if (at == std::string::npos) throw std::runtime_error("no block " + id);
    const std::size_t begin = text.find('>', at) + 1;
    const std::string head = text.substr(at, begin - at);
    const auto number = [&](const std::string& name) {
      const std::string key = "data-" + name + "=\"";
      const std::size_t found = head.find(key);
      return found == std::string::npos ? 0.0 : std::stod(head.substr(found + key.size()));
    };
    EncodedPicture p;
    p.bytes = from_base64(text.substr(begin, text.find('<', begin) - begin));
    p.channels = int(number("channels"));
    p.gradient = number("gradient") == 1;
    p.code = {int(number("steps")), float(number("toe"))};
    p.vector_step = number("step");
    return decode_picture(p, data["width"], data["height"]);
  }
  std::string text;
  Json data;
};

class Report : public testing::Test {
 protected:
  Report() {
    folder_ = fs::path(testing::TempDir()) / ("tempera_report_" + std::to_string(::getpid()) + "_" +
                                              testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~Report() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// A shaded picture whose noise has the given amplitude, with vectors if wanted.
  static Frame picture(int frame, int seed, float amplitude, int width, int height, bool vectors = false) {
    Frame f(width, height);
    Image& color = f.create(layers::color());
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const float shade = 0.1f + 0.8f * float((x + frame) % width) / float(width);
        for (int c = 0; c < 3; ++c) {
          color.pixel(x, y)[c] = shade * (1 + amplitude * (noise(x, y, frame, seed * 3 + c) - 0.5f));
        }
      }
    }
    if (vectors) {
      for (float& v : f.create(layers::motion_forward()).values()) v = 1;
      Image& backward = f.create(layers::motion_backward());
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          float* p = backward.pixel(x, y);
          p[0] = 0.25f * float(x % 4), p[1] = -1.5f, p[3] = y == 0 ? 0.0f : 1.0f;
        }
      }
    }
    return f;
  }
  FrameSequence write(const std::string& name, const std::vector<int>& frames, int seed, float amplitude,
                      int width = 48, int height = 32, bool vectors = false) {
    const std::string pattern = path(name + "/f.####.exr");
    for (const int n : frames) {
      Frame f = picture(n, seed, amplitude, width, height, vectors);
      set_render_info(f.metadata, {.version = "1",
                                   .command = "tempera",
                                   .scene = "s",
                                   .scene_hash = "0",
                                   .integrator = "path",
                                   .parameters = "p",
                                   .spp = 4 * seed,
                                   .frame = n,
                                   .fps = 25,
                                   .render_seconds = 2.0 * seed});
      write_frame(frame_path(pattern, n), f);
    }
    return FrameSequence(pattern);
  }
  /// Compares and writes a page.
  Page make(const std::vector<CompareInput>& tests, const FrameSequence& reference, const CompareOptions& options = {},
            const ReportOptions& report = {}) {
    ReportWriter writer(path("report.html"), tests, &reference, options, report);
    const CompareResult result = compare_sequences(tests, reference, options, {}, &writer);
    const std::int64_t size = writer.finish(result);
    EXPECT_EQ(std::uintmax_t(size), fs::file_size(path("report.html")));
    return Page(path("report.html"));
  }
  static CompareInput input(const std::string& name, const FrameSequence& sequence) { return {name, {sequence}}; }

  fs::path folder_;
};

TEST_F(Report, HoldsPicturesMapsAndFigures) {
  const auto a = write("a", {1, 2, 3}, 1, 0.1f), b = write("b", {1, 2, 3}, 2, 0.05f), r = write("r", {1, 2, 3}, 3, 0);
  const Page page = make({input("a", a), input("b", b)}, r, {.metrics = {"relmse", "flip"}});
  const Json& d = page.data;
  EXPECT_EQ(d["frames"], Json({1, 2, 3}));
  EXPECT_EQ(d["width"], 48);
  EXPECT_EQ(d["height"], 32);
  EXPECT_EQ(d["fps"], 25);
  ASSERT_EQ(d["sides"].size(), 3u);
  EXPECT_EQ(d["reference"], 2);
  EXPECT_EQ(d["sides"][0]["label"], "a");
  EXPECT_EQ(d["sides"][2]["label"], "reference");
  EXPECT_EQ(d["title"], "a · b");
  const auto info = [&](int side, const std::string& name) {
    for (const Json& row : d["sides"][side]["info"]) {
      if (row[0] == name) return row[1].get<std::string>();
    }
    return std::string();
  };
  EXPECT_EQ(info(1, "samples per pixel"), "8");
  EXPECT_EQ(info(1, "seconds per frame"), "4");

  const CompareResult result = compare_sequences({input("a", a), input("b", b)}, r, {.metrics = {"relmse", "flip"}});
  for (std::size_t s = 0; s < 2; ++s) {
    for (const MetricSeries& m : result.sides[s].series) {
      const Json& series = d["sides"][s]["series"][std::string(m.metric->id)];
      EXPECT_EQ(series["mean"].get<double>(), m.mean.mean);
      ASSERT_EQ(series["values"].size(), 3u);
      for (std::size_t f = 0; f < 3; ++f) EXPECT_EQ(series["values"][f].get<double>(), m.values[f]);
    }
  }
  ASSERT_EQ(d["metrics"].size(), 2u);
  EXPECT_EQ(d["metrics"][0]["id"], "relmse");
  EXPECT_EQ(d["metrics"][0]["better"], "lower");

  // The pictures and maps are those of the files, as exact as the page says.
  for (const int frame : {1, 2, 3}) {
    const std::string number = std::to_string(frame);
    const Image expected = read_frame(a.path(frame)).layer("color"), shown = page.block("picture-0-" + number);
    const double error = d["sides"][0]["relativeError"][1];
    EXPECT_LT(error, 0.02);
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 48; ++x) {
        for (int c = 0; c < 3; ++c) {
          const float v = expected.pixel(x, y)[c];
          ASSERT_NEAR(shown.pixel(x, y)[c], v, 1.02 * error * (std::abs(v) + 1e-3));
        }
      }
    }
    Image map;
    flip(expected, read_frame(r.path(frame)).layer("color"), &map);
    const Image stored = page.block("map-flip-0-" + number);
    double difference = 0;
    for (std::size_t i = 0; i < map.values().size(); ++i) {
      difference += std::abs(map.values()[i] - stored.values()[i]) / double(map.pixels());
    }
    EXPECT_LT(difference, 0.01);
  }
  ASSERT_EQ(d["maps"].size(), 1u) << "relmse is computed by the page and not stored";
  EXPECT_EQ(d["maps"][0]["id"], "flip");
  EXPECT_EQ(d["maps"][0]["frames"], Json::parse("[[1,2,3],[1,2,3],[]]"));
  EXPECT_FALSE(page.has("map-relmse-0-1"));
}

TEST_F(Report, LoadsNothing) {
  const auto a = write("a", {1}, 1, 0.5f), r = write("r", {1}, 2, 0);
  const Page page = make({input("a", a)}, r);
  EXPECT_TRUE(page.text.starts_with("<!DOCTYPE html>"));
  EXPECT_NE(page.text.find("default-src 'none'"), std::string::npos) << "browsers, too, are told to load nothing";
  // Attributes that load: none but the empty icon. Names of documents (the SVG namespace) are no addresses.
  const std::regex loads(R"re((src|href|srcset|action|data|poster)\s*=\s*["']?([^"'\s>]*))re", std::regex::icase);
  const std::string head = page.text.substr(0, page.text.find("id=\"report-data\""));
  for (std::sregex_iterator it(head.begin(), head.end(), loads), end; it != end; ++it) {
    EXPECT_EQ((*it)[2], "data:,") << it->str();
  }
  for (const std::string_view part : {report_assets::kStyle, report_assets::kScript}) {
    for (const char* word : {"@import", "url(", "fetch(", "XMLHttpRequest", "WebSocket", "import(", "sendBeacon",
                             "eval(", "innerHTML", "document.write"}) {
      EXPECT_EQ(part.find(word), std::string_view::npos) << word;
    }
    EXPECT_EQ(std::string(part).find("</script"), std::string::npos);
  }
}

TEST_F(Report, EveryMapOfAMetricIsStoredOrComputedByThePage) {
  const auto a = write("a", {1}, 1, 0.5f);
  const ReportWriter writer(path("report.html"), {input("a", a)}, &a, {.metrics = {"all"}});
  const std::vector<std::string> stored = writer.maps();
  for (const MetricInfo& m : metric_catalog()) {
    if (!m.has_map || std::find(stored.begin(), stored.end(), m.id) != stored.end()) continue;
    EXPECT_NE(report_assets::kScript.find("\"" + std::string(m.id) + "\""), std::string_view::npos)
        << m.id << " is neither stored nor known to the page";
  }
}

TEST_F(Report, EmbedsItsOwnFilesUnchanged) {
  const fs::path assets = fs::path(TEMPERA_SOURCE_DIR) / "libs/report/assets";
  EXPECT_EQ(report_assets::kPage, text_of(assets / "report.html"));
  EXPECT_EQ(report_assets::kStyle, text_of(assets / "report.css"));
  std::size_t length = 0;
  for (const auto& entry : fs::directory_iterator(assets)) {
    if (entry.path().extension() != ".js") continue;
    const std::string text = text_of(entry.path());
    length += text.size();
    EXPECT_NE(report_assets::kScript.find(text), std::string_view::npos) << entry.path();
  }
  EXPECT_EQ(report_assets::kScript.size(), length);
}

TEST_F(Report, NamesCannotBecomeMarkup) {
  const std::string hostile = "</script><script>alert(1)</script><!--\"'&\xff\n{{script}} \xe2\x80\xa8";
  const auto a = write("a", {1}, 1, 0.5f), r = write("r", {1}, 2, 0);
  const Page page = make({input(hostile, a)}, r, {}, {.title = hostile});
  EXPECT_EQ(page.text.find("alert(1)</script>"), std::string::npos);
  EXPECT_EQ(page.text.find('\xff'), std::string::npos) << "the page is UTF-8";
  EXPECT_NE(page.text.find("<title>&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt;&lt;!--&quot;&#39;&amp;\uFFFD\n"
                           "{{script}}"),
            std::string::npos);
  const std::string name = page.data["sides"][0]["name"];
  EXPECT_TRUE(name.starts_with("</script><script>alert(1)</script><!--\"'&")) << "in the data it is the same text";
  EXPECT_EQ(page.data["title"], name);
  // Each script element ends where it should: the data, the program, and a block for each image.
  std::size_t open = 0, close = 0;
  for (std::size_t at = 0; (at = page.text.find("<script", at)) != std::string::npos; ++at) ++open;
  for (std::size_t at = 0; (at = page.text.find("</script", at)) != std::string::npos; ++at) ++close;
  EXPECT_EQ(open, 2u + 2 + page.data["maps"].size());
  EXPECT_EQ(open, close);
}

TEST_F(Report, StoresAStillReferenceOnce) {
  const auto a = write("a", {1, 2, 3, 4}, 1, 0.5f), r = write("r", {7}, 2, 0);
  const Page page = make({input("a", a)}, r);
  const Json& reference = page.data["sides"][1];
  EXPECT_EQ(reference["frames"], Json({1, 2, 3, 4}));
  EXPECT_EQ(reference["stored"], Json({1, 1, 1, 1}));
  EXPECT_TRUE(page.has("picture-reference-1"));
  EXPECT_FALSE(page.has("picture-reference-2"));
}

TEST_F(Report, SidesMayHaveOtherFrames) {
  const auto a = write("a", {1, 2, 3, 4}, 1, 0.5f), b = write("b", {2, 4, 5}, 2, 0.5f),
             r = write("r", {1, 2, 3, 4}, 3, 0);
  const Page page = make({input("a", a), input("b", b)}, r);
  EXPECT_EQ(page.data["frames"], Json({1, 2, 3, 4}));
  EXPECT_EQ(page.data["sides"][1]["frames"], Json({2, 4}));
  EXPECT_EQ(page.data["sides"][1]["missing"], Json({3}));
  EXPECT_EQ(page.data["sides"][1]["series"]["relmse"]["values"].size(), 2u);
  EXPECT_FALSE(page.has("picture-1-1"));
}

TEST_F(Report, ShowsSequencesWithoutAReference) {
  const auto a = write("a", {1, 2}, 1, 0.5f, 48, 32, true), b = write("b", {2, 3}, 2, 0.5f);
  const CompareOptions options;
  ReportWriter writer(path("report.html"), {input("a", a), input("b", b)}, nullptr, options);
  int calls = 0;
  const CompareResult result =
      show_sequences({input("a", a), input("b", b)}, options, writer, [&](int done, int total) {
        EXPECT_EQ(done, ++calls);
        EXPECT_EQ(total, 4);
      });
  EXPECT_EQ(calls, 4);
  writer.finish(result);
  const Page page(path("report.html"));
  EXPECT_TRUE(page.data["reference"].is_null());
  EXPECT_TRUE(page.data["metrics"].empty());
  EXPECT_TRUE(page.data["maps"].empty());
  EXPECT_EQ(page.data["frames"], Json({1, 2, 3}));
  EXPECT_EQ(page.data["sides"].size(), 2u);
  EXPECT_EQ(page.data["motion"]["backward"], Json({1, 2}));
  const Image backward = page.block("motion-backward-2");
  EXPECT_EQ(backward.pixel(7, 5)[0], 0.75f);
  EXPECT_EQ(backward.pixel(7, 5)[1], -1.5f);
  EXPECT_TRUE(std::isnan(backward.pixel(7, 0)[0])) << "where there is no vector";
  EXPECT_EQ(page.block("motion-forward-1").pixel(0, 0)[0], 1);

  write("c", {1}, 1, 0, 24, 32);
  const std::vector<CompareInput> unlike{input("a", a), input("c", FrameSequence(path("c/f.####.exr")))};
  ReportWriter other(path("other.html"), unlike, nullptr, options);
  EXPECT_THROW(show_sequences(unlike, options, other), Error);
}

TEST_F(Report, StoresSmallerPicturesOnRequest) {
  const auto a = write("a", {1}, 1, 0.0f, 48, 32, true);
  const CompareOptions options;
  ReportWriter writer(path("report.html"), {input("a", a)}, nullptr, options, {.scale = 0.5});
  const CompareResult result = show_sequences({input("a", a)}, options, writer);
  writer.finish(result);
  const Page page(path("report.html"));
  EXPECT_EQ(page.data["width"], 24);
  EXPECT_EQ(page.data["height"], 16);
  EXPECT_EQ(page.data["sourceSize"], Json({48, 32}));
  const Image source = read_frame(a.path(1)).layer("color"), shown = page.block("picture-0-1");
  EXPECT_NEAR(shown.pixel(3, 3)[0], 0.5f * (source.pixel(6, 6)[0] + source.pixel(7, 6)[0]), 2e-3);
  EXPECT_EQ(page.block("motion-backward-1").pixel(3, 3)[1], -0.75f) << "vectors shrink with the pictures";
  EXPECT_THROW(ReportWriter(path("x.html"), {input("a", a)}, nullptr, options, {.scale = 0}), Error);
  EXPECT_THROW(ReportWriter(path("x.html"), {input("a", a)}, nullptr, options, {.scale = 2}), Error);
}

TEST_F(Report, IsTheSameOnAnyNumberOfThreads) {
  const auto a = write("a", {1, 2}, 1, 0.8f), b = write("b", {1, 2}, 2, 0.3f), r = write("r", {1, 2}, 3, 0);
  std::string first;
  for (const int threads : {1, 2, 7}) {
    with_threads(threads, [&] { make({input("a", a), input("b", b)}, r); });
    const std::string text = text_of(path("report.html"));
    if (first.empty()) first = text;
    EXPECT_TRUE(text == first) << threads;
  }
}

TEST_F(Report, LeavesNothingBehindWhenItIsAbandoned) {
  const auto a = write("a", {1, 2}, 1, 0.5f), r = write("r", {1, 2}, 2, 0);
  const auto files = [&] { return std::distance(fs::directory_iterator(folder_), fs::directory_iterator()); };
  const auto before = files();
  {
    ReportWriter writer(path("report.html"), {input("a", a)}, &r, {});
    EXPECT_THROW(compare_sequences(
                     {input("a", a)}, r, {}, [](int, int) { throw Error(ErrorCode::kCancelled, "stopped"); }, &writer),
                 Error);
  }
  EXPECT_EQ(files(), before);
  EXPECT_THROW(ReportWriter("/proc/no/report.html", {input("a", a)}, &r, {}), Error);
}

TEST_F(Report, NoiseFitsIntoTheBytesThatItWasGiven) {
  const std::vector<int> frames{1, 2, 3, 4};
  const auto a = write("a", frames, 1, 1.9f, 320, 180, true), b = write("b", frames, 2, 1.0f, 320, 180),
             c = write("c", frames, 3, 0.5f, 320, 180), r = write("r", frames, 4, 0.1f, 320, 180, true);
  make({input("a", a), input("b", b), input("c", c)}, r, {}, {.room = 0});
  // 24 frames of 640x360 of three methods have to stay under 60 MB: 24 x 4 times the pixels.
  EXPECT_LT(double(fs::file_size(path("report.html"))) * 6.0 * 4.0, 60e6);
}

#if !defined(__SANITIZE_ADDRESS__)
/// Peak of the resident memory since `restart_peak`, in bytes.
std::int64_t peak_memory() {
  std::ifstream in("/proc/self/status");
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("VmHWM:")) return std::stoll(line.substr(6)) * 1024;
  }
  return -1;
}
void restart_peak() { std::ofstream("/proc/self/clear_refs") << 5; }

TEST_F(Report, MemoryDoesNotGrowWithTheSequence) {
  constexpr int kWidth = 256, kHeight = 144, kFrames = 150;
  const auto one = write("a", {1}, 1, 0.5f, kWidth, kHeight);
  const auto run = [&](int frames) {
    ReportWriter writer(path("report.html"), {input("a", one)}, &one, {}, {.room = 0});
    CompareResult result;
    CompareSide& side = result.sides.emplace_back();
    side.name = "a", side.runs = {one.pattern()};
    restart_peak();
    for (int f = 1; f <= frames; ++f) {
      const Frame r = picture(f, 2, 0.1f, kWidth, kHeight), a = picture(f, 1, 1.0f, kWidth, kHeight);
      writer.reference(f, r.layer("color"), nullptr, nullptr);
      writer.test(0, f, a.layer("color"), [](std::string_view) -> const Image* { return nullptr; });
      if (f == 1) side.frames = {1};
    }
    result.reference = one.pattern();
    writer.finish(result);
    return peak_memory();
  };
  const std::int64_t few = run(10), many = run(kFrames);
  const std::int64_t written = std::int64_t(fs::file_size(path("report.html")));
  EXPECT_GT(written, std::int64_t(14) << 20);
  EXPECT_LT(many - few, std::int64_t(5) << 20) << "of " << written << " bytes written";
}
#endif

}  // namespace
}  // namespace tempera
