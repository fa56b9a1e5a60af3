// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/video.h"

#include <array>
#include <csignal>
#include <cstdio>
#include <fstream>

#include "tempera/frames/frame.h"
#include "test_files.h"

namespace tempera {
namespace {
using test::error_of;

std::string output_of(const std::string& command) {
  std::string text;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (!pipe) return text;
  std::array<char, 256> buffer;
  while (std::fgets(buffer.data(), int(buffer.size()), pipe)) text += buffer.data();
  ::pclose(pipe);
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return text;
}

class Video : public test::TestFolder {
 protected:
  void SetUp() override {
    if (output_of("ffprobe -version").empty()) GTEST_SKIP() << "ffmpeg is not installed";
  }
  /// Frames of one gray each, that says which frame it is.
  void write_frames(std::initializer_list<int> numbers, int width = 64, int height = 48) {
    for (const int n : numbers) {
      Frame f(width, height);
      Image& color = f.create(layers::color());
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) color.set_rgb(x, y, Rgb(gray(n)));
      }
      write_frame(path("f." + std::string(4 - std::to_string(n).size(), '0') + std::to_string(n) + ".exr"), f);
    }
  }
  static float gray(int n) { return 0.05f + 0.02f * float(n % 40); }
  std::string probe(const std::string& file, const std::string& entries) {
    return output_of("ffprobe -v error -count_frames -select_streams v:0 -show_entries stream=" + entries +
                     " -of csv=p=0 '" + path(file) + "'");
  }
  /// The middle pixel of every picture of a movie, as ffmpeg shows it.
  std::vector<int> grays(const std::string& file, int width, int height) {
    const std::string raw = path("raw.rgb");
    output_of("ffmpeg -v error -y -i '" + path(file) + "' -f rawvideo -pix_fmt rgb24 '" + raw + "'");
    std::ifstream in(raw, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(in)), {});
    std::vector<int> out;
    const std::size_t size = std::size_t(width) * std::size_t(height) * 3;
    for (std::size_t i = 0; i + size <= bytes.size(); i += size) {
      out.push_back(static_cast<unsigned char>(bytes[i + size / 2 + std::size_t(width) / 2 * 3]));
    }
    return out;
  }
};

TEST_F(Video, Mp4HasEveryFrameInOrder) {
  write_frames({1001, 1002, 1003, 1004, 1005});
  int calls = 0;
  EXPECT_EQ(write_video(FrameSequence(path("f.####.exr")), path("out/m.mp4"), {},
                        [&](int done, int total) {
                          EXPECT_EQ(done, ++calls);
                          EXPECT_EQ(total, 5);
                        }),
            5);
  EXPECT_EQ(calls, 5);
  EXPECT_EQ(probe("out/m.mp4", "codec_name,width,height,pix_fmt,r_frame_rate,nb_read_frames"),
            "h264,64,48,yuv420p,24/1,5");
  const std::vector<int> shown = grays("out/m.mp4", 64, 48);
  ASSERT_EQ(shown.size(), 5u);
  for (int i = 0; i < 5; ++i) {
    EXPECT_NEAR(shown[i], 255 * linear_to_srgb(gray(1001 + i)), 3) << i;
  }
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(path("out")), {}), 1) << "nothing temporary stays";
}

TEST_F(Video, OddSizesAndOtherContainers) {
  write_frames({1, 2, 3}, 33, 17);
  VideoOptions options;
  options.fps = 23.976;
  const FrameSequence frames(path("f.####.exr"));
  write_video(frames, path("m.mkv"), options);
  EXPECT_EQ(probe("m.mkv", "codec_name,width,height,r_frame_rate,nb_read_frames"), "h264,34,18,24000/1001,3");
  write_video(frames, path("m.webm"), options);
  EXPECT_EQ(probe("m.webm", "codec_name,width,height,nb_read_frames"), "vp9,34,18,3");
  options.codec = "ffv1";
  write_video(frames, path("m.mkv"), options);
  EXPECT_EQ(probe("m.mkv", "codec_name,nb_read_frames"), "ffv1,3");
  for (int i = 0; i < 3; ++i) {  // lossless
    EXPECT_EQ(grays("m.mkv", 34, 18)[i], int(255 * linear_to_srgb(gray(i + 1)) + 0.5f));
  }
}

TEST_F(Video, CarriesAComment) {
  write_frames({1, 2, 3, 4});
  FrameSequence frames(path("f.####.exr"));
  frames.keep(std::vector{4, 2, 9});
  EXPECT_EQ(frames.frames(), (std::vector<int>{2, 4}));
  VideoOptions options;
  options.comment = "made of 4711";
  for (const char* name : {"m.mp4", "m.mov", "m.mkv", "m.webm"}) {
    EXPECT_FALSE(video_has_comment(path(name), options.comment)) << name;
    EXPECT_EQ(write_video(frames, path(name), options), 2) << name;
    EXPECT_TRUE(video_has_comment(path(name), options.comment)) << name;
    EXPECT_FALSE(video_has_comment(path(name), "made of 4712")) << name;
  }
}

TEST_F(Video, ColorsSurviveTheEncoder) {
  Frame f(64, 64);
  Image& color = f.create(layers::color());
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) color.set_rgb(x, y, {0.5f, 0.1f, 0.02f});
  }
  VideoWriter writer(path("m.mp4"), 64, 64);
  for (int i = 0; i < 3; ++i) writer.add(color);
  writer.finish();
  output_of("ffmpeg -v error -y -i '" + path("m.mp4") + "' -frames:v 1 '" + path("m.png") + "'");
  const Rgb shown = read_frame(path("m.png")).layer("color").rgb(32, 32);
  EXPECT_NEAR(shown.r, 0.5f, 0.02f);
  EXPECT_NEAR(shown.g, 0.1f, 0.01f);
  EXPECT_NEAR(shown.b, 0.02f, 0.01f);
  EXPECT_EQ(probe("m.mp4", "color_space,color_transfer,color_primaries,color_range"), "tv,bt709,iec61966-2-1,bt709");
}

TEST_F(Video, MissingFramesRepeatTheOneBefore) {
  write_frames({10, 11, 14, 15});
  VideoOptions options;
  options.codec = "ffv1";
  testing::internal::CaptureStderr();
  EXPECT_EQ(write_video(FrameSequence(path("f.####.exr")), path("m.mkv"), options), 6);
  EXPECT_NE(testing::internal::GetCapturedStderr().find("2 missing frames repeated from before: 12, 13"),
            std::string::npos);
  const std::vector<int> shown = grays("m.mkv", 64, 48);
  ASSERT_EQ(shown.size(), 6u);
  EXPECT_EQ(shown[1], shown[2]);
  EXPECT_EQ(shown[1], shown[3]);
  EXPECT_LT(shown[3], shown[4]);
}

TEST_F(Video, AFrameOfAnotherSizeIsNamed) {
  write_frames({1, 2});
  write_frames({3}, 32, 32);
  const Error e = error_of([&] { write_video(FrameSequence(path("f.####.exr")), path("m.mp4")); });
  EXPECT_EQ(e.code(), ErrorCode::kBadInput);
  EXPECT_EQ(e.message(), path("f.0003.exr") + " has 32x32 pixels, the frames before it 64x48: a movie has one size");
  EXPECT_FALSE(std::filesystem::exists(path("m.mp4")));
}

TEST_F(Video, EveryOtherFrameHasNoGaps) {
  write_frames({1, 3, 5});
  EXPECT_EQ(write_video(FrameSequence(path("f.####.exr")), path("m.mp4")), 3);
}

TEST_F(Video, MissingProgramNamesThePackage) {
  VideoOptions options;
  options.ffmpeg = "no-such-ffmpeg";
  const Error e = error_of([&] { VideoWriter(path("m.mp4"), 4, 4, options); });
  EXPECT_EQ(e.code(), ErrorCode::kMissingFile);
  EXPECT_NE(e.message().find("apt install ffmpeg"), std::string::npos);
  EXPECT_TRUE(files().empty());
}

TEST_F(Video, AFailingEncoderIsAnErrorAndNotASignal) {
  ::signal(SIGPIPE, SIG_DFL);
  VideoOptions options;
  options.ffmpeg = "false";  // ends at once without reading
  const Error e = error_of([&] {
    VideoWriter writer(path("m.mp4"), 640, 480, options);
    const Image image(640, 480, 3);
    for (int i = 0; i < 20; ++i) writer.add(image);
    writer.finish();
  });
  EXPECT_EQ(e.code(), ErrorCode::kFailed);
  EXPECT_NE(e.message().find(path("m.mp4")), std::string::npos);
  EXPECT_TRUE(files().empty());
}

TEST_F(Video, NothingStaysWithoutFinish) {
  std::ofstream(path("m.mp4")) << "old";
  {
    VideoWriter writer(path("m.mp4"), 64, 48);
    writer.add(Image(64, 48, 3));
    EXPECT_EQ(error_of([&] { writer.add(Image(65, 48, 3)); }).code(), ErrorCode::kBadInput);
  }
  EXPECT_EQ(files(), (std::vector<std::string>{"m.mp4"}));
  EXPECT_EQ(std::filesystem::file_size(path("m.mp4")), 3u);
}

TEST_F(Video, WrongArgumentsAreErrors) {
  VideoOptions options;
  EXPECT_EQ(error_of([&] { VideoWriter(path("m.avi"), 4, 4); }).code(), ErrorCode::kUsage);
  options.codec = "h264";
  EXPECT_EQ(error_of([&] { VideoWriter(path("m.webm"), 4, 4, options); }).code(), ErrorCode::kUsage);
  options = {};
  options.fps = 0;
  EXPECT_EQ(error_of([&] { VideoWriter(path("m.mp4"), 4, 4, options); }).code(), ErrorCode::kOutOfRange);
  options = {};
  options.crf = 99;
  EXPECT_EQ(error_of([&] { VideoWriter(path("m.mp4"), 4, 4, options); }).code(), ErrorCode::kOutOfRange);
  write_frames({1});
  options = {};
  options.layer = "albedo";
  EXPECT_EQ(error_of([&] { write_video(FrameSequence(path("f.####.exr")), path("m.mp4"), options); }).code(),
            ErrorCode::kUnknownName);
}

TEST_F(Video, ContactSheetShowsTheFrames) {
  write_frames({1, 2, 3, 4, 5, 6, 7});
  ContactSheetOptions options;
  options.width = 32;
  options.columns = 3;
  write_contact_sheet(FrameSequence(path("f.####.exr")), path("sheet.png"), options);
  const Image sheet = read_frame(path("sheet.png")).layer("color");
  EXPECT_EQ(sheet.width(), 4 + 3 * 36);
  EXPECT_EQ(sheet.height(), 4 + 3 * (24 + 14 + 4));
  for (int i = 0; i < 7; ++i) {
    EXPECT_NEAR(sheet.rgb(4 + i % 3 * 36 + 16, 4 + i / 3 * 42 + 12).g, gray(i + 1), 0.005f) << i;
  }
}

}  // namespace
}  // namespace tempera
