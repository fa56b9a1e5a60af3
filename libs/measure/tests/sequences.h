// SPDX-License-Identifier: Apache-2.0
#pragma once
// Sequences of made-up frames on disk, in memory where the system has a place for that.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>

#include "tempera/core/random.h"
#include "tempera/core/time.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/sequence.h"
#include "tempera/measure/compare.h"

namespace tempera::test {

/// A normally distributed number for each address.
inline float normal(int x, int y, int frame, int key) {
  const std::uint64_t bits = hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(frame), std::uint64_t(key));
  const float u = to_unit_float(std::uint32_t(bits)), v = to_unit_float(std::uint32_t(bits >> 32));
  return std::sqrt(-2 * std::log(1 - u)) * std::cos(6.2831853f * v);
}

/// An image of value(x, y, channel).
template <class F>
Image filled(int w, int h, int channels, F&& value) {
  Image image(w, h, channels);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      for (int c = 0; c < channels; ++c) image.at(x, y, c) = value(x, y, c);
    }
  }
  return image;
}

/// The same vector everywhere, valid.
inline Image vectors(int w, int h, float dx, float dy) {
  return filled(w, h, 4, [=](int, int, int c) { return c == 0 ? dx : c == 1 ? dy : c == 3 ? 1.0f : 0.0f; });
}

/// A folder of its own for each test, removed at its end.
class SequenceTest : public testing::Test {
 protected:
  SequenceTest() {
    const std::filesystem::path memory = "/dev/shm";
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = (::access(memory.c_str(), W_OK) == 0 ? memory : std::filesystem::path(testing::TempDir())) /
              ("tempera_" + std::to_string(::getpid()) + "_" + info->test_suite_name() + "_" + info->name());
    std::filesystem::create_directories(folder_);
  }
  ~SequenceTest() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// Frames [first, last] of make(frame), as folder/f.####.exr.
  FrameSequence write(const std::string& folder, int first, int last, const std::function<Frame(int)>& make) const {
    for (int f = first; f <= last; ++f) {
      write_frame(frame_path(path(folder + "/f.####.exr"), f), make(f), {.compression = Compression::kNone});
    }
    return FrameSequence(path(folder + "/f.####.exr"));
  }
  /// As write, for frames that hold `color` alone.
  FrameSequence write_colors(const std::string& folder, int first, int last,
                             const std::function<Image(int)>& make) const {
    return write(folder, first, last, [&](int f) { return color_frame(make(f)); });
  }
  static Frame color_frame(Image image) {
    Frame frame(image.width(), image.height());
    LayerDesc desc = layers::color();
    desc.channels.resize(std::size_t(image.channels()));
    frame.add(desc, std::move(image));
    return frame;
  }

  std::filesystem::path folder_;
};

inline CompareInput input(const FrameSequence& sequence) { return {sequence.pattern(), {sequence}}; }

}  // namespace tempera::test
