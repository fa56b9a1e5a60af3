// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures of cards that move before each other, whose values, vectors and depths are known at any time: what the stages
// that move pictures are held against.
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tempera/frames/frame.h"
#include "tempera/stages/stage_run.h"

namespace tempera::test {

/// A textured rectangle; the first of a picture is behind all others and has no bounds.
struct Card {
  float x0 = 0, y0 = 0, x1 = 0, y1 = 0;  ///< at time 0, pixels
  Vec2f velocity;                        ///< pixels per frame
  float depth = 10;
  std::function<Rgb(float x, float y)> texture;  ///< of the place at time 0
};

inline Rgb waves(float x, float y) {
  return {0.5f + 0.3f * std::sin(0.35f * x) * std::cos(0.25f * y), 0.5f + 0.2f * std::cos(0.3f * x + 0.2f * y),
          0.4f + 0.2f * std::sin(0.2f * y)};
}

/// The card that is seen at (x, y) and its color.
inline std::size_t seen(const std::vector<Card>& cards, float x, float y, float t, Rgb& color) {
  std::size_t front = 0;
  for (std::size_t k = 1; k < cards.size(); ++k) {
    const Card& c = cards[k];
    const float px = x - c.velocity.x * t, py = y - c.velocity.y * t;
    if (px >= c.x0 && px < c.x1 && py >= c.y0 && py < c.y1 && c.depth < cards[front].depth) front = k;
  }
  const Card& c = cards[front];
  color = c.texture(x - c.velocity.x * t, y - c.velocity.y * t);
  return front;
}

/// `grid` x `grid` points in each pixel, at `times` times of an exposure of `shutter` frames around frame `t`.
inline Image picture(const std::vector<Card>& cards, int w, int h, float t, float shutter = 0, int times = 1,
                     int grid = 4) {
  Image out(w, h, 4);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      Rgb sum;
      for (int j = 0; j < times; ++j) {
        const float time = t + shutter * ((float(j) + 0.5f) / float(times) - 0.5f);
        for (int k = 0; k < grid * grid; ++k) {
          Rgb c;
          seen(cards, float(x) + (float(k % grid) + 0.5f) / float(grid),
               float(y) + (float(k / grid) + 0.5f) / float(grid), time, c);
          sum += c;
        }
      }
      out.set_rgb(x, y, sum / float(times * grid * grid));
      out.at(x, y, 3) = 1;
    }
  }
  return out;
}

/// Frame `t` with vectors (valid everywhere), depth and ids.
inline Frame frame_of(const std::vector<Card>& cards, int w, int h, float t, int grid = 4) {
  Frame f(w, h);
  f.add(layers::color(), picture(cards, w, h, t, 0, 1, grid));
  Image &forward = f.create(layers::motion_forward()), &backward = f.create(layers::motion_backward());
  Image &depth = f.create(layers::depth()), &id = f.create(layers::object_id());
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      Rgb color;
      const std::size_t k = seen(cards, float(x) + 0.5f, float(y) + 0.5f, t, color);
      const Vec2f v = cards[k].velocity;
      const float to[4] = {v.x, v.y, 0, 1}, back[4] = {-v.x, -v.y, 0, 1};
      std::copy(to, to + 4, forward.pixel(x, y)), std::copy(back, back + 4, backward.pixel(x, y));
      depth.at(x, y) = cards[k].depth;
      id.at(x, y) = float(k + 1);
    }
  }
  return f;
}

/// Frame `t` of a wall that stands still with a mirror in it, in which something moves by `velocity`: its light by classes
/// of paths with the vectors of the chain RD. The mirror covers [10, w - 10) x [8, h - 8). `shines`: what is seen there is a
/// lamp, and scatters nothing.
inline Frame mirror_frame(int w, int h, float t, Vec2f velocity, bool with_vectors, bool shines = false) {
  Frame f = frame_of({{.texture = waves}}, w, h, t);
  const Card shown{.velocity = velocity, .texture = [](float x, float y) { return waves(1.4f * y, 1.2f * x) * 1.5f; }};
  Image& color = f.layer("color");
  Image &direct = f.create(layers::class_layer("direct", layers::color())),
        &mirrored = f.create(layers::class_layer("reflection", layers::color()));
  f.create(layers::class_layer("residual", layers::color()));
  const LayerDesc descs[] = {layers::motion_forward(), layers::motion_backward(), layers::depth(),
                             layers::object_id(),      layers::albedo(),          layers::emission()};
  for (const LayerDesc& d : descs) {
    if (with_vectors || d.name == "albedo" || d.name == "emission") f.create(layers::chain_layer("RD", d));
  }
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (x < 10 || x >= w - 10 || y < 8 || y >= h - 8) {
        direct.set_rgb(x, y, color.rgb(x, y));
        continue;
      }
      f.layer("object_id").at(x, y) = 2, f.layer("depth").at(x, y) = 9;
      Rgb c;
      seen({shown}, float(x) + 0.5f, float(y) + 0.5f, t, c);
      mirrored.set_rgb(x, y, c), color.set_rgb(x, y, c);
      f.layer(shines ? "chain.RD.emission" : "chain.RD.albedo").set_rgb(x, y, shines ? c : Rgb(0.8f));
      if (!with_vectors) continue;
      const float to[4] = {velocity.x, velocity.y, 0, 1}, back[4] = {-velocity.x, -velocity.y, 0, 1};
      std::copy(to, to + 4, f.layer("chain.RD.motion.forward").pixel(x, y));
      std::copy(back, back + 4, f.layer("chain.RD.motion.backward").pixel(x, y));
      f.layer("chain.RD.depth").at(x, y) = 20, f.layer("chain.RD.object_id").at(x, y) = 5;
    }
  }
  const ClassInfo shown_class =
      shines ? ClassInfo{"reflection", "ER", {"RL"}} : ClassInfo{"reflection", "ERD.*", {"RD"}};
  set_classes(f.metadata, std::vector<ClassInfo>{{"direct", "ED", {"D"}}, shown_class});
  return f;
}

/// Mean square of the difference of R, G and B, at least `border` pixels from the edge.
inline double mean_square(const Image& a, const Image& b, int border = 0) {
  double sum = 0;
  int count = 0;
  for (int y = border; y < a.height() - border; ++y) {
    for (int x = border; x < a.width() - border; ++x) {
      for (int c = 0; c < 3; ++c) sum += std::pow(double(a.at(x, y, c)) - double(b.at(x, y, c)), 2), ++count;
    }
  }
  return sum / count;
}

/// A folder of sequences that goes away with the test.
class FrameFiles : public testing::Test {
 protected:
  FrameFiles() {
    folder_ = std::filesystem::temp_directory_path() / ("tempera_motion_" + std::to_string(getpid()) + "_" +
                                                        testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string pattern(const std::string& name) const { return (folder_ / (name + ".####.exr")).string(); }
  void write(const std::string& name, int number, const Frame& f) const {
    write_frame(frame_path(pattern(name), number), f);
  }
  Frame read(const std::string& name, int number) const { return read_frame(frame_path(pattern(name), number)); }
  StageReport run(const std::string& stage, const std::vector<std::string>& in, const std::string& out,
                  const std::vector<std::pair<std::string, std::string>>& params = {},
                  std::vector<int> frames = {}) const {
    const StageEntry& entry = find_stage(stage);
    StageChoice choice{&entry, Params(entry.params)};
    for (const auto& [name, value] : params) choice.params.set_text(name, value);
    std::vector<FrameSequence> ports;
    for (const std::string& name : in) ports.emplace_back(pattern(name));
    StageObserver nobody;
    StageOptions options;
    options.sections[0].frames = std::move(frames);
    return run_stage(choice, ports, pattern(out), options, nobody);
  }
  std::filesystem::path folder_;
};

}  // namespace tempera::test
