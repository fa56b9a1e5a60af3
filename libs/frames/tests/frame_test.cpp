// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/frame.h"

#include <OpenImageIO/half.h>
#include <OpenImageIO/imageio.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <fstream>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/frames/files.h"
#include "tempera/frames/sequence.h"
#include "test_files.h"

namespace tempera {
namespace {
using test::error_of;
using test::same_bits;

/// Values of every kind that a float can be, NaN payloads included.
void fill(Image& image, std::uint64_t key) {
  const float special[] = {0.0f,   -0.0f,    kInfinity, -kInfinity, std::nanf("1"),
                           1e-42f, 65504.0f, 1e30f,     -1.5f,      1 / 3.0f};
  std::uint64_t i = 0;
  for (float& v : image.values()) {
    const std::uint64_t h = hash_key(key, i++);
    v = h % 4 == 0 ? special[h / 4 % 10] : to_unit_float(std::uint32_t(h >> 32)) * 10 - 5;
  }
}

Frame frame_of(std::vector<LayerDesc> descs, int width = 37, int height = 150) {
  Frame f(width, height);
  std::uint64_t key = 1;
  for (const LayerDesc& d : descs) fill(f.create(d), key++);
  return f;
}

std::vector<LayerDesc> every_layer() {
  std::vector<LayerDesc> all = layers::known();
  for (const char* name : {"class.dd.color", "class.dd.motion.forward", "offset.color", "offset.grad.x",
                           "CryptoObject00", "CryptoObject01"}) {
    all.push_back(*layers::find(name));
  }
  all.push_back(layers::derived(layers::color(), "denoised"));
  all.push_back({"Odd Name", {"b", "a", "whatever"}, "a unit of its own", Combine::kSum});
  all.push_back({"lone", {""}, "none", Combine::kFirst});
  return all;
}

void expect_same(const Frame& a, const Frame& b) {
  ASSERT_EQ(a.layer_names(), b.layer_names());
  for (const Layer& l : a.layers()) {
    EXPECT_EQ(l.desc, b.desc(l.desc.name));
    EXPECT_TRUE(same_bits(l.image, b.layer(l.desc.name))) << l.desc.name;
  }
  EXPECT_EQ(a.metadata, b.metadata);
}

class FrameFile : public test::TestFolder {};

TEST(Frame, LayersKeepTheirPlaceAndSize) {
  Frame f;
  f.add(layers::depth(), Image(4, 3, 1, 2.0f));
  EXPECT_EQ(f.width(), 4);
  Image& color = f.create(layers::color());
  f.create(layers::normal());
  color.at(3, 2, 3) = 1;  // still valid after another layer came
  EXPECT_EQ(f.layer("color").at(3, 2, 3), 1);
  EXPECT_EQ(f.layer_names(), (std::vector<std::string>{"depth", "color", "normal"}));
  f.add(layers::color(), Image(4, 3, 4, 5.0f));
  EXPECT_EQ(color.at(0, 0), 5);
  EXPECT_EQ(f.layer_names().size(), 3u);
  f.remove("color");
  EXPECT_FALSE(f.has("color"));
  const Error missing = error_of([&] { std::as_const(f).layer("norm"); });
  EXPECT_EQ(missing.code(), ErrorCode::kUnknownName);
  EXPECT_EQ(missing.message(), "the frame has no layer \"norm\"; it has normal, depth");
  EXPECT_EQ(error_of([&] { f.add(layers::color(), Image(5, 3, 4)); }).code(), ErrorCode::kBadInput);
  EXPECT_EQ(error_of([&] { f.add(layers::color(), Image(4, 3, 3)); }).code(), ErrorCode::kBadInput);
}

TEST_F(FrameFile, EveryLayerComesBackBitByBit) {
  Frame f = frame_of(every_layer());
  f.metadata["tempera/note"] = "text with \"quotes\",\nlines and äöü";
  f.metadata["tempera/number"] = 0.1;
  f.metadata["tempera/integer"] = -7;
  for (const Compression c :
       {Compression::kNone, Compression::kRle, Compression::kZips, Compression::kZip, Compression::kPiz}) {
    write_frame(path("f.exr"), f, {.compression = c});
    expect_same(f, read_frame(path("f.exr")));
  }
}

TEST_F(FrameFile, SameFrameGivesTheSameBytesOnAnyNumberOfThreads) {
  const Frame f = frame_of({layers::color(), layers::motion_forward()}, 200, 300);
  with_threads(1, [&] { write_frame(path("a.exr"), f); });
  with_threads(7, [&] { write_frame(path("b.exr"), f); });
  EXPECT_EQ(read_file(path("a.exr")), read_file(path("b.exr")));
}

TEST_F(FrameFile, OtherProgramsSeeTheChannels) {
  write_frame(path("f.exr"), frame_of({layers::color(), layers::motion_backward(), layers::depth()}));
  const auto in = OIIO::ImageInput::open(path("f.exr"));
  ASSERT_TRUE(in);
  EXPECT_EQ(in->spec().channelnames,
            (std::vector<std::string>{"R", "G", "B", "A", "depth.Z", "motion.backward.X", "motion.backward.Y",
                                      "motion.backward.Z", "motion.backward.V"}));
  EXPECT_EQ(in->spec().get_string_attribute("compression"), "zip");
  EXPECT_EQ(in->spec().format, OIIO::TypeDesc::FLOAT);
}

TEST_F(FrameFile, HalfIsForPicturesOnly) {
  Frame f = frame_of({layers::color(), layers::depth(), layers::crypto(0)});
  write_frame(path("f.exr"), f, {.half = true});
  const Frame g = read_frame(path("f.exr"));
  EXPECT_TRUE(same_bits(f.layer("depth"), g.layer("depth")));
  EXPECT_TRUE(same_bits(f.layer("CryptoObject00"), g.layer("CryptoObject00")));
  EXPECT_FALSE(same_bits(f.layer("color"), g.layer("color")));
  for (std::size_t i = 0; i < f.layer("color").values().size(); ++i) {
    const float v = f.layer("color").values()[i], expected = float(half(std::clamp(v, -65504.0f, 65504.0f)));
    if (!std::isnan(v)) {
      EXPECT_EQ(g.layer("color").values()[i], expected);
    }
  }
}

TEST_F(FrameFile, HalfClampsWhatItCannotHold) {
  Frame f(2, 1);
  f.create(layers::color()).set_rgb(0, 0, {1e6f, 65504, -1e9f});
  f.layer("color").set_rgb(1, 0, {65519, 70000, 1});
  write_frame(path("f.exr"), f, {.half = true});
  const Frame g = read_frame(path("f.exr"));
  EXPECT_EQ(g.layer("color").rgb(0, 0), (Rgb{65504, 65504, -65504}));
  EXPECT_EQ(g.layer("color").rgb(1, 0), (Rgb{65504, 65504, 1}));
}

TEST_F(FrameFile, EveryEncodingIsRefusedBeforeItDamages) {
  // Whatever check_encoding lets pass comes back: data bit by bit, pictures closely.
  std::vector<LayerDesc> all = layers::known();
  for (const char* name : {"CryptoObject00", "class.a.color", "class.a.reflectance", "offset.color", "offset.grad.x"}) {
    all.push_back(*layers::find(name));
  }
  int refused = 0;
  for (const char* compression : {"none", "rle", "zips", "zip", "piz", "dwaa"}) {
    for (const bool half : {false, true}) {
      for (const AovNames names : {AovNames::kTempera, AovNames::kBlender, AovNames::kArnold, AovNames::kRenderman}) {
        const WriteOptions options{.compression = parse_compression(compression), .half = half, .names = names};
        for (const LayerDesc& d : all) {
          Frame f(16, 16);
          int i = 0;
          for (float& v : f.create(d).values()) v = float(std::abs(std::sin(0.1 * i++))) + 0.01f;
          const std::string where = fmt::format("{} half={} names={} {}", compression, half, int(names), d.name);
          try {
            check_encoding({d}, options);
          } catch (const Error& e) {
            ++refused;
            EXPECT_EQ(e.code(), ErrorCode::kUnsupported) << where;
            EXPECT_EQ(error_of([&] { write_frame(path("f.exr"), f, options); }).code(), e.code()) << where;
            EXPECT_TRUE(files().empty()) << where;
            EXPECT_TRUE(options.compression == Compression::kDwaa) << where;
            continue;
          }
          write_frame(path("f.exr"), f, options);
          const Frame g = read_frame(path("f.exr"));
          std::filesystem::remove(path("f.exr"));
          const bool picture = d.unit == units::kRadiance || d.unit == units::kReflectance;
          const Image& back = g.layer(d.name);
          for (int y = 0; y < 16; ++y) {
            for (int x = 0; x < 16; ++x) {
              for (int c = 0; c < back.channels(); ++c) {
                const float was = f.layer(d.name).at(x, y, c);
                if (picture) {
                  ASSERT_NEAR(back.at(x, y, c), was, 0.03f) << where;
                } else if (names == AovNames::kBlender && d.name == "uv") {
                  ASSERT_NEAR(back.at(x, y, c), was, 1e-7f) << where;  // 1 - v
                } else {
                  ASSERT_EQ(back.at(x, y, c), was) << where;
                }
              }
            }
          }
        }
      }
    }
  }
  EXPECT_GT(refused, 20);
}

TEST_F(FrameFile, LossyCompressionIsRefusedForData) {
  Frame f = frame_of({layers::color(), layers::depth()}, 64, 64);
  for (float& v : f.layer("color").values()) v = 0.5f;
  write_frame(path("f.exr"), f, {.compression = Compression::kDwaa, .half = true});
  EXPECT_TRUE(same_bits(f.layer("depth"), read_frame(path("f.exr")).layer("depth")));
  EXPECT_NEAR(read_frame(path("f.exr")).layer("color").at(3, 3), 0.5f, 0.01f);
  f.create(layers::motion_forward());  // its channel Y passes for luminance
  const Error e = error_of([&] { write_frame(path("g.exr"), f, {.compression = Compression::kDwaa}); });
  EXPECT_EQ(e.code(), ErrorCode::kUnsupported);
  EXPECT_NE(e.message().find("motion.forward"), std::string::npos);
  EXPECT_EQ(files(), (std::vector<std::string>{"f.exr"}));
}

TEST_F(FrameFile, HeaderAndChosenLayers) {
  Frame f = frame_of({layers::color(), layers::normal(), layers::depth()});
  f.metadata["tempera/frame"] = 12;
  write_frame(path("f.exr"), f);
  const FrameHeader h = read_header(path("f.exr"));
  EXPECT_EQ(h.width, 37);
  EXPECT_EQ(h.height, 150);
  EXPECT_EQ(h.layers, (std::vector<LayerDesc>{layers::color(), layers::normal(), layers::depth()}));
  EXPECT_EQ(read_metadata(path("f.exr")), f.metadata);
  ReadOptions some;
  some.layers = {"depth"};
  const Frame g = read_frame(path("f.exr"), some);
  EXPECT_EQ(g.layer_names(), some.layers);
  EXPECT_TRUE(same_bits(g.layer("depth"), f.layer("depth")));
  some.layers = {"albedo"};
  const Error e = error_of([&] { read_frame(path("f.exr"), some); });
  EXPECT_EQ(e.code(), ErrorCode::kUnknownName);
  EXPECT_NE(e.message().find("color"), std::string::npos);
}

// Numbers that EXR defines are single floats: the library would leave out those of another type, with a message.
TEST_F(FrameFile, AttributesOfOtherProgramsComeBack) {
  OIIO::ImageSpec spec(1, 1, 3, OIIO::TypeDesc::FLOAT);
  spec.attribute("XResolution", 72.0f);
  spec.attribute("whiteLuminance", 0.1f);
  const float black[3] = {};
  const auto out = OIIO::ImageOutput::create(path("f.exr"));
  ASSERT_TRUE(out && out->open(path("f.exr"), spec) && out->write_image(OIIO::TypeDesc::FLOAT, black) && out->close());
  Frame f = read_frame(path("f.exr"));
  f.metadata["tempera/number"] = 0.5;
  testing::internal::CaptureStderr();
  write_frame(path("g.exr"), f);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  const Metadata back = read_metadata(path("g.exr"));
  EXPECT_EQ(std::get<double>(back.at("XResolution")), 72);
  EXPECT_EQ(std::get<double>(back.at("whiteLuminance")), double(0.1f));
  const auto in = OIIO::ImageInput::open(path("g.exr"));
  EXPECT_EQ(in->spec().find_attribute("tempera/number")->type(), OIIO::TypeDesc::DOUBLE) << "as all numbers of ours";
}

TEST_F(FrameFile, ClassesComeBack) {
  const std::vector<ClassInfo> some{
      {"direct", "ED", {"D"}}, {"emission", "E", {}}, {"seen", "E (R |T)D.*", {"RD", "TD"}}};
  Frame f(1, 1);
  f.create(layers::color());
  set_classes(f.metadata, {});
  EXPECT_TRUE(f.metadata.empty());
  set_classes(f.metadata, some);
  write_frame(path("f.exr"), f);
  EXPECT_EQ(classes(read_metadata(path("f.exr"))), some);
  EXPECT_EQ(to_text(f.metadata.at("tempera/classes")), "direct\tED\tD\nemission\tE\t\nseen\tE (R |T)D.*\tRD TD\n");
  EXPECT_TRUE(classes({}).empty());
  set_classes(f.metadata, std::vector<ClassInfo>{{"wide", "E\tD D", {"D"}}});
  EXPECT_EQ(classes(f.metadata), (std::vector<ClassInfo>{{"wide", "E D D", {"D"}}})) << "expressions may have tabs";
  f.metadata["tempera/classes"] = std::string("lone\n");
  EXPECT_EQ(classes(f.metadata), (std::vector<ClassInfo>{{"lone", "", {}}}));
}

TEST_F(FrameFile, RenderInfoComesBack) {
  RenderInfo info{"0.1.0", "tempera render x",  "x.toml", "abc",  "path", "depth=5",
                  64,      0xfedcba9876543210u, 1001,     23.976, -0.25,  0.25,
                  12.5};
  Frame f = frame_of({layers::color()});
  set_render_info(f.metadata, info);
  write_frame(path("f.exr"), f);
  const auto back = render_info(read_metadata(path("f.exr")));
  ASSERT_TRUE(back);
  EXPECT_EQ(*back, info);
  EXPECT_TRUE(std::holds_alternative<int>(f.metadata["tempera/spp"]));
  EXPECT_EQ(to_text(f.metadata["tempera/motion"]), kMotionConvention);
  RenderInfo again = info;
  again.command = "tempera render x --resume", again.render_seconds = 99, again.scene = "./x.toml";
  EXPECT_TRUE(again.same_render(info));
  for (auto change :
       {+[](RenderInfo& r) { r.spp = 32; }, +[](RenderInfo& r) { r.seed += 1; }, +[](RenderInfo& r) { r.frame = 1; },
        +[](RenderInfo& r) { r.scene_hash = "abd"; }, +[](RenderInfo& r) { r.parameters = "depth=6"; },
        +[](RenderInfo& r) { r.version = "0.1.1"; }, +[](RenderInfo& r) { r.shutter_close = 0.5; }}) {
    RenderInfo other = info;
    change(other);
    EXPECT_FALSE(other.same_render(info));
  }
  Metadata partial = f.metadata;
  partial.erase("tempera/seed");
  EXPECT_FALSE(render_info(partial));
  partial["tempera/seed"] = "12x";
  EXPECT_FALSE(render_info(partial));
}

TEST(FrameRate, AsFractions) {
  EXPECT_EQ(frame_rate(24), (FrameRate{24, 1}));
  EXPECT_EQ(frame_rate(12.5), (FrameRate{25, 2}));
  EXPECT_EQ(frame_rate(23.976), (FrameRate{24000, 1001}));
  EXPECT_EQ(frame_rate(24000.0 / 1001), (FrameRate{24000, 1001}));
  EXPECT_EQ(frame_rate(29.97), (FrameRate{30000, 1001}));
  EXPECT_EQ(frame_rate(59.94), (FrameRate{60000, 1001}));
  EXPECT_EQ(frame_rate(0.1), (FrameRate{1, 10}));
}

TEST_F(FrameFile, PlayersFindTheFrameRate) {
  Frame f = frame_of({layers::color()}, 4, 4);
  f.metadata["tempera/fps"] = 23.976;
  write_frame(path("f.exr"), f);
  const auto in = OIIO::ImageInput::open(path("f.exr"));
  const auto* rate = in->spec().find_attribute("FramesPerSecond", OIIO::TypeRational);
  ASSERT_TRUE(rate);
  EXPECT_EQ(static_cast<const int*>(rate->data())[0], 24000);
  EXPECT_EQ(static_cast<const int*>(rate->data())[1], 1001);
  EXPECT_EQ(read_metadata(path("f.exr")), f.metadata);
}

TEST_F(FrameFile, ViewersFindThePixelAspect) {
  Frame f = frame_of({layers::color()}, 4, 4);
  f.metadata[kPixelAspectKey] = 1.25;
  write_frame(path("f.exr"), f);
  EXPECT_EQ(OIIO::ImageInput::open(path("f.exr"))->spec().get_float_attribute("PixelAspectRatio"), 1.25f);
  EXPECT_EQ(read_metadata(path("f.exr")), f.metadata) << "stages write it again";
}

// --- Files of other programs, made with OpenImageIO
// --------------------------------------------------------------------

void write_exr(const std::string& path, OIIO::ImageSpec spec, std::vector<std::string> names, const void* data,
               OIIO::TypeDesc format = OIIO::TypeDesc::FLOAT) {
  spec.nchannels = int(names.size());
  spec.channelnames = std::move(names);
  const auto out = OIIO::ImageOutput::create(path);
  ASSERT_TRUE(out && out->open(path, spec)) << OIIO::geterror();
  ASSERT_TRUE(out->write_image(format, data)) << out->geterror();
  ASSERT_TRUE(out->close());
}

TEST_F(FrameFile, ReadsPlainHalfFilesAndTiles) {
  std::vector<float> data(20 * 10 * 3);
  for (std::size_t i = 0; i < data.size(); ++i) data[i] = float(i) * 0.25f;
  OIIO::ImageSpec spec(20, 10, 3, OIIO::TypeDesc::HALF);
  for (const int tile : {0, 16}) {
    spec.tile_width = spec.tile_height = tile;
    write_exr(path("f.exr"), spec, {"R", "G", "B"}, data.data());
    const Frame f = read_frame(path("f.exr"));
    ASSERT_EQ(f.layer_names(), std::vector<std::string>{"color"});
    EXPECT_EQ(f.desc("color").channels, (std::vector<std::string>{"R", "G", "B"}));
    for (std::size_t i = 0; i < data.size(); ++i) EXPECT_EQ(f.layer("color").values()[i], data[i]);
  }
}

TEST_F(FrameFile, IntegerChannelsStayIntegers) {
  std::vector<std::uint32_t> ids{0, 1, 77, 16777216};
  write_exr(path("f.exr"), OIIO::ImageSpec(2, 2, 1, OIIO::TypeDesc::UINT32), {"object_id.I"}, ids.data(),
            OIIO::TypeDesc::UINT32);
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.desc("object_id"), layers::object_id());
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(f.layer("object_id").values()[i], float(ids[i]));
}

TEST_F(FrameFile, DataWindowIsPlacedInTheDisplayWindow) {
  OIIO::ImageSpec spec(4, 3, 1, OIIO::TypeDesc::FLOAT);
  spec.full_width = 6, spec.full_height = 5, spec.full_x = 10, spec.full_y = 20;
  spec.x = 12, spec.y = 19;  // one row sticks out at the top
  std::vector<float> data(12);
  for (int i = 0; i < 12; ++i) data[i] = float(i + 1);
  write_exr(path("f.exr"), spec, {"Y"}, data.data());
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.width(), 6);
  EXPECT_EQ(f.height(), 5);
  const Image& image = f.layer("color");
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 6; ++x)
      EXPECT_EQ(image.at(x, y), x >= 2 && y < 2 ? float((y + 1) * 4 + x - 1) : 0) << x << "," << y;
  }
}

TEST_F(FrameFile, ReadsMultiPartFiles) {
  std::vector<OIIO::ImageSpec> parts(3, OIIO::ImageSpec(4, 2, 4, OIIO::TypeDesc::FLOAT));
  const std::vector<std::vector<std::string>> names{{"R", "G", "B", "A"}, {"Z"}, {"albedo.R", "albedo.G", "albedo.B"}};
  const char* part_names[] = {"rgba", "depth", "albedo"};
  for (std::size_t i = 0; i < 3; ++i) {
    parts[i].nchannels = int(names[i].size());
    parts[i].channelnames = names[i];
    parts[i].attribute("oiio:subimagename", part_names[i]);
  }
  const auto out = OIIO::ImageOutput::create(path("f.exr"));
  ASSERT_TRUE(out->open(path("f.exr"), 3, parts.data()));
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(i == 0 || out->open(path("f.exr"), parts[i], OIIO::ImageOutput::AppendSubimage));
    const std::vector<float> data(8 * names[i].size(), float(i + 1));
    ASSERT_TRUE(out->write_image(OIIO::TypeDesc::FLOAT, data.data()));
  }
  ASSERT_TRUE(out->close());
  const Frame f = read_frame(path("f.exr"));
  EXPECT_EQ(f.layer_names(), (std::vector<std::string>{"color", "depth", "albedo"}));
  EXPECT_EQ(f.desc("depth"), layers::depth());
  EXPECT_EQ(f.layer("color").at(3, 1, 3), 1);
  EXPECT_EQ(f.layer("depth").at(3, 1), 2);
  EXPECT_EQ(f.layer("albedo").at(3, 1, 2), 3);
}

TEST_F(FrameFile, PicturesAreDecodedFromSrgb) {
  const std::vector<std::uint8_t> data{0, 55, 188, 255, 128, 64};
  const auto out = OIIO::ImageOutput::create(path("f.png"));
  ASSERT_TRUE(out->open(path("f.png"), OIIO::ImageSpec(2, 1, 3, OIIO::TypeDesc::UINT8)));
  ASSERT_TRUE(out->write_image(OIIO::TypeDesc::UINT8, data.data()) && out->close());
  const Image image = read_frame(path("f.png")).layer("color");
  const float expected[] = {0, 0.03820437f, 0.50288646f, 1, 0.21586050f, 0.05126946f};
  for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(image.values()[i], expected[i], 1e-6f);
}

// --- Damage and failure
// ------------------------------------------------------------------------------------------------

TEST_F(FrameFile, DamagedFilesAreErrors) {
  EXPECT_EQ(error_of([&] { read_frame(path("none.exr")); }).code(), ErrorCode::kMissingFile);
  EXPECT_EQ(error_of([&] { read_frame(folder_.string()); }).code(), ErrorCode::kBadInput);
  write_file(path("text.exr"), "this is not an image at all");
  EXPECT_EQ(error_of([&] { read_frame(path("text.exr")); }).code(), ErrorCode::kBadInput);
  write_file(path("empty.exr"), "");
  EXPECT_EQ(error_of([&] { read_frame(path("empty.exr")); }).code(), ErrorCode::kBadInput);

  Frame f = frame_of({layers::color(), layers::normal()}, 61, 47);
  write_frame(path("f.exr"), f);
  const std::string whole = read_file(path("f.exr"));
  for (std::size_t size = 1; size < whole.size(); size += size < 2000 ? 13 : 1999) {
    std::ofstream(path("cut.exr"), std::ios::binary) << whole.substr(0, size);
    const Error e = error_of([&] { read_frame(path("cut.exr")); });
    EXPECT_EQ(e.code(), ErrorCode::kBadInput) << size;
    EXPECT_EQ(e.message().find('\n'), std::string::npos);
  }
  // Any byte may be wrong: an Error or a picture, but nothing worse.
  int errors = 0;
  for (std::uint64_t i = 0; i < 400; ++i) {
    std::string bytes = whole;
    for (std::uint64_t k = 0; k < 3; ++k) {
      const std::uint64_t h = hash_key(i, k);
      bytes[h % (i % 2 ? 1200 : bytes.size())] = char(h >> 56);
    }
    std::ofstream(path("bad.exr"), std::ios::binary) << bytes;
    ReadOptions small;
    small.max_values = 1 << 22;
    try {
      read_frame(path("bad.exr"), small);
    } catch (const Error&) {
      ++errors;
    }
  }
  EXPECT_GT(errors, 100);
}

TEST_F(FrameFile, SizeLimitHolds) {
  write_frame(path("f.exr"), frame_of({layers::color()}, 40, 30));
  ReadOptions small;
  small.max_values = 40 * 30 * 4;
  EXPECT_NO_THROW(read_frame(path("f.exr"), small));
  --small.max_values;
  EXPECT_EQ(error_of([&] { read_frame(path("f.exr"), small); }).code(), ErrorCode::kBadInput);
}

TEST_F(FrameFile, FailedWritesKeepWhatWasThere) {
  const Frame old_frame = frame_of({layers::color()}), big = frame_of({layers::color()}, 400, 400);
  write_frame(path("f.exr"), old_frame);
  const std::string before = read_file(path("f.exr"));

  // A limit on the size of files stands for a full disk: write fails in the middle.
  struct rlimit saved {};
  ::getrlimit(RLIMIT_FSIZE, &saved);
  const auto old_handler = ::signal(SIGXFSZ, SIG_IGN);
  const struct rlimit tiny { 100000, saved.rlim_max };
  ::setrlimit(RLIMIT_FSIZE, &tiny);
  const Error full = error_of([&] { write_frame(path("f.exr"), big); });
  ::setrlimit(RLIMIT_FSIZE, &saved);
  ::signal(SIGXFSZ, old_handler);
  EXPECT_EQ(full.code(), ErrorCode::kFailed);
  EXPECT_EQ(full.message(), "cannot write " + path("f.exr") + ": File too large");
  EXPECT_EQ(read_file(path("f.exr")), before);
  EXPECT_EQ(files(), (std::vector<std::string>{"f.exr"}));

  // A folder without permission to write. Root may write anywhere, so it becomes somebody else for a moment.
  std::filesystem::permissions(folder_, std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec |
                                            std::filesystem::perms::others_read | std::filesystem::perms::others_exec);
  const bool root = ::geteuid() == 0;
  ASSERT_TRUE(!root || ::seteuid(65534) == 0);
  const Error denied = error_of([&] { write_frame(path("f.exr"), old_frame); });
  const Error denied_new = error_of([&] { write_frame(path("sub/g.exr"), old_frame); });
  ASSERT_TRUE(!root || ::seteuid(0) == 0);
  std::filesystem::permissions(folder_, std::filesystem::perms::owner_all);
  EXPECT_EQ(denied.code(), ErrorCode::kFailed);
  EXPECT_EQ(denied.message(), "cannot write " + path("f.exr") + ": Permission denied");
  EXPECT_EQ(denied_new.code(), ErrorCode::kFailed);
  EXPECT_EQ(read_file(path("f.exr")), before);
  EXPECT_EQ(files(), (std::vector<std::string>{"f.exr"}));
}

TEST_F(FrameFile, OnlyRegularFilesAreReplaced) {
  const Frame f = frame_of({layers::color()});
  for (const std::string& target : {std::string("/dev/full"), std::string("/dev/null"), folder_.string()}) {
    const Error e = error_of([&] { write_frame(target, f); });
    EXPECT_EQ(e.code(), ErrorCode::kFailed) << target;
    EXPECT_NE(e.message().find("not a regular file"), std::string::npos) << e.message();
  }
  EXPECT_TRUE(std::filesystem::is_character_file("/dev/null"));
  write_file(path("file"), "x");
  EXPECT_EQ(error_of([&] { write_frame(path("file/f.exr"), f); }).code(), ErrorCode::kFailed);
  std::filesystem::create_directory(path("elsewhere"));
  write_file(path("elsewhere/real.exr"), "old");
  std::filesystem::create_symlink(path("elsewhere/real.exr"), path("link.exr"));
  write_frame(path("link.exr"), f);
  EXPECT_TRUE(std::filesystem::is_symlink(path("link.exr")));
  EXPECT_TRUE(same_bits(read_frame(path("elsewhere/real.exr")).layer("color"), f.layer("color")));
  write_frame(path("new/folders/f.exr"), f);
  EXPECT_TRUE(std::filesystem::exists(path("new/folders/f.exr")));
  EXPECT_EQ(error_of([&] { write_frame(path("f.exr"), Frame(3, 3)); }).code(), ErrorCode::kBadInput);
}

TEST_F(FrameFile, TemporaryFilesGoUnlessCommitted) {
  {
    const TemporaryFile t(path("movie.mp4"));
    EXPECT_EQ(std::filesystem::path(t.path()).extension(), ".mp4");
    EXPECT_EQ(files().size(), 1u);
  }
  EXPECT_TRUE(files().empty());
  TemporaryFile t(path("movie.mp4"));
  const int fd = ::open(t.path().c_str(), O_WRONLY);
  EXPECT_EQ(::write(fd, "abc", 3), 3);
  ::close(fd);
  t.commit();
  EXPECT_EQ(read_file(path("movie.mp4")), "abc");
  EXPECT_EQ(files(), (std::vector<std::string>{"movie.mp4"}));
}

TEST(ParseOptions, KnowTheirNames) {
  EXPECT_EQ(parse_compression("dwaa"), Compression::kDwaa);
  EXPECT_EQ(parse_compression("zips"), Compression::kZips);
  EXPECT_EQ(error_of([] { parse_compression("jpeg"); }).code(), ErrorCode::kUnknownName);
  EXPECT_EQ(parse_aov_names("renderman"), AovNames::kRenderman);
  EXPECT_EQ(error_of([] { parse_aov_names("nuke"); }).code(), ErrorCode::kUnknownName);
}

// --- Sequences
// ---------------------------------------------------------------------------------------------------------

class Sequence : public test::TestFolder {
 protected:
  void touch(std::initializer_list<const char*> names) {
    for (const char* n : names) write_file(path(n), "x");
  }
};

TEST_F(Sequence, FindsFramesOfPatterns) {
  touch({"f.0001.exr", "f.0003.exr", "f.1001.exr", "f.12345.exr", "f.-002.exr", "f.3.exr", "f.0003.png", "ff.0004.exr",
         "f.0005.exr.tmp", "g_1.exr", "g_2.exr", "g_10.exr", "g_011.exr", ".f.0009.exr"});
  EXPECT_EQ(FrameSequence(path("f.####.exr")).frames(), (std::vector<int>{-2, 1, 3, 1001, 12345}));
  EXPECT_EQ(FrameSequence(path("f.%04d.exr")).frames(), (std::vector<int>{-2, 1, 3, 1001, 12345}));
  EXPECT_EQ(FrameSequence(path("f.$F4.exr")).frames(), (std::vector<int>{-2, 1, 3, 1001, 12345}));
  EXPECT_EQ(FrameSequence(path("f.exr")).frames(), (std::vector<int>{-2, 1, 3, 1001, 12345}));
  EXPECT_EQ(FrameSequence(path("g_%d.exr")).frames(), (std::vector<int>{1, 2, 10}));
  const FrameSequence s(path("f.####.exr"));
  EXPECT_TRUE(s.has(1001));
  EXPECT_FALSE(s.has(2));
  EXPECT_EQ(s.path(7), path("f.0007.exr"));
  EXPECT_EQ(s.step(), 2);
  EXPECT_EQ(error_of([&] { FrameSequence(path("h.####.exr")); }).code(), ErrorCode::kMissingFile);
  EXPECT_EQ(error_of([&] { FrameSequence(path("h.exr")); }).code(), ErrorCode::kMissingFile);
  EXPECT_TRUE(existing_frames(path("nowhere/f.####.exr")).empty());
  for (const char* other : {"f.@@@@.exr", "f.<F4>.exr", "f.<frame4>.exr"}) {
    EXPECT_EQ(FrameSequence(path(other)).frames(), s.frames()) << other;
  }
  touch({"literal.@@.exr"});
  EXPECT_EQ(FrameSequence(path("literal.@@.exr")).path(0), path("literal.@@.exr")) << "a file of that very name";
}

TEST_F(Sequence, FramesThatWereChosen) {
  touch({"f.0001.exr", "f.0003.exr", "f.0004.exr", "one.exr"});
  const std::vector<int> some{4, 2, 1};
  EXPECT_EQ(FrameSequence(path("f.####.exr"), some).frames(), (std::vector<int>{1, 4}));
  const FrameSequence one(path("one.exr"), std::vector{7});
  EXPECT_EQ(one.frames(), std::vector<int>{7});
  EXPECT_EQ(one.path(7), path("one.exr"));
  EXPECT_EQ(error_of([&] { FrameSequence(path("g.####.exr"), some); }).code(), ErrorCode::kMissingFile);
}

TEST_F(Sequence, OutputNames) {
  const std::string folder = path("now.exr");
  std::filesystem::create_directory(folder);
  const auto name = [](const std::string& p, bool single) { return output_pattern(p, "shot.####.exr", single); };
  for (const bool single : {false, true}) {
    for (const char* same : {"a/f.####.exr", "f.@@@@.exr", "f_%03d.EXR", "f.$F4.exr", "a.b/<F4>.exr"}) {
      EXPECT_EQ(name(same, single), same);
    }
    EXPECT_EQ(name("a/f.####", single), "a/f.####.exr");
    for (const char* other : {"a/b", "a/b/", "take.v2", "f#/x"}) {
      EXPECT_EQ(name(other, single), (std::filesystem::path(other) / "shot.####.exr").string()) << other;
    }
    EXPECT_EQ(name(folder, single), (std::filesystem::path(folder) / "shot.####.exr").string()) << "it exists";
  }
  EXPECT_EQ(name("a/f.exr", true), "a/f.exr");
  EXPECT_EQ(name("a/f.exr", false), "a/f.####.exr");
  EXPECT_EQ(name("a/f.EXR", false), "a/f.####.EXR");
  struct Case {
    const char *path, *one, *many;
  };
  for (const Case& c :
       {Case{"x.####.png", "x.####.exr", "x.####.exr"}, Case{"a/x.@@@.PNG", "a/x.@@@.exr", "a/x.@@@.exr"},
        Case{"x.%04d.jpeg", "x.%04d.exr", "x.%04d.exr"}, Case{"x.####.foo", "x.####.exr", "x.####.exr"},
        Case{"x.####.exr.gz", "x.####.exr", "x.####.exr"}, Case{"x.png", "x.exr", "x.####.exr"},
        Case{"x.Tiff", "x.exr", "x.####.exr"}, Case{"x.hdr", "x.exr", "x.####.exr"},
        Case{"x.webp", "x.exr", "x.####.exr"}, Case{"x.mp4", "x.exr", "x.####.exr"}}) {
    for (const bool single : {false, true}) {
      const Error e = error_of([&] { name(c.path, single); });
      EXPECT_EQ(e.code(), ErrorCode::kUsage) << c.path;
      EXPECT_TRUE(e.message().ends_with(std::string("write ") + (single ? c.one : c.many))) << e.what();
    }
  }
}

TEST_F(Sequence, SingleFilesAndFolders) {
  touch({"a/shot.0008.exr", "a/shot.0009.exr", "a/shot.0010.exr", "a/notes.txt", "b/x1.exr", "b/x2.exr", "b/x10.exr",
         "c/a.01.exr", "c/b.01.exr", "d/only.exr", "e/readme.txt"});
  const FrameSequence one(path("a/shot.0009.exr"));
  EXPECT_EQ(one.frames(), std::vector<int>{9});
  EXPECT_EQ(one.path(9), path("a/shot.0009.exr"));
  EXPECT_EQ(FrameSequence(path("d/only.exr")).frames(), std::vector<int>{0});
  EXPECT_EQ(FrameSequence(path("a")).frames(), (std::vector<int>{8, 9, 10}));
  EXPECT_EQ(FrameSequence(path("a")).pattern(), path("a/shot.####.exr"));
  EXPECT_EQ(FrameSequence(path("b")).frames(), (std::vector<int>{1, 2, 10}));
  EXPECT_EQ(FrameSequence(path("d")).path(0), path("d/only.exr"));
  touch({"u/F.01.EXR", "u/F.02.EXR"});
  EXPECT_EQ(FrameSequence(path("u")).frames(), (std::vector<int>{1, 2}));
  const Error several = error_of([&] { FrameSequence(path("c")); });
  EXPECT_EQ(several.code(), ErrorCode::kBadInput);
  EXPECT_NE(several.message().find("a.##.exr"), std::string::npos);
  EXPECT_NE(several.message().find("b.##.exr"), std::string::npos);
  EXPECT_EQ(error_of([&] { FrameSequence(path("e")); }).code(), ErrorCode::kMissingFile);
}

}  // namespace
}  // namespace tempera
