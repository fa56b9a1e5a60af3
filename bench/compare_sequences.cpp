// SPDX-License-Identifier: Apache-2.0
// Writes what bench/compare.py measures comparisons with: a reference that pans, with its motion vectors, and noisy
// versions of it, of which each has half of the variance of the one before.
//
//   compare_sequences FOLDER [--frames N] [--size WxH] [--methods N]
#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/frames/frame.h"

namespace {

using namespace tempera;

constexpr int kPan = 3;  ///< pixels a frame, to the right

/// A room-like picture: soft gradients, hard edges, textures, and a few lamps far above 1.
Rgb scene(int x, int y, int c) {
  const float u = float(x) / 640, v = float(y) / 360;
  const auto wave = [](float t) { return 0.5f + 0.5f * std::sin(t); };
  float value = 0.05f + 0.4f * wave(2.1f * u + float(c)) * wave(3.3f * v - float(c) * 0.7f);
  if ((x / 40 + y / 40) % 2) value *= 0.3f;
  value += 0.1f * wave(float(x) * 0.9f) * wave(float(y) * 1.1f);
  if ((x % 400 - 200) * (x % 400 - 200) + (y - 120) * (y - 120) < 400) value += 12;
  return Rgb(value) * Rgb{1, 0.8f + 0.2f * wave(u), 0.6f};
}

float noise(int x, int y, int frame, int c, int method) {
  const std::uint64_t bits =
      hash_key(std::uint64_t(x), std::uint64_t(y), std::uint64_t(frame * 4 + c), std::uint64_t(method));
  const float u = to_unit_float(std::uint32_t(bits)), v = to_unit_float(std::uint32_t(bits >> 32));
  return std::sqrt(-2 * std::log(1 - u)) * std::cos(6.2831853f * v);
}

}  // namespace

int main(int argc, char** argv) {
  std::string folder;
  int frames = 48, width = 1280, height = 720, methods = 3;
  for (int i = 1; i < argc; ++i) {
    const bool more = i + 1 < argc;
    if (!std::strcmp(argv[i], "--frames") && more) {
      frames = std::atoi(argv[++i]);
    } else if (!std::strcmp(argv[i], "--methods") && more) {
      methods = std::atoi(argv[++i]);
    } else if (!std::strcmp(argv[i], "--size") && more) {
      if (std::sscanf(argv[++i], "%dx%d", &width, &height) != 2) return 2;
    } else {
      folder = argv[i];
    }
  }
  if (folder.empty()) {
    std::fprintf(stderr, "usage: compare_sequences FOLDER [--frames N] [--size WxH] [--methods N]\n");
    return 2;
  }
  parallel_for(0, std::int64_t(frames) * (methods + 1), [&](std::int64_t index) {
    const int frame = int(index) / (methods + 1), method = int(index) % (methods + 1);
    Frame out(width, height);
    Image& color = out.create(layers::color());
    const float sigma = method == 0 ? 0 : 0.4f * std::exp2(-0.5f * float(method - 1));
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        Rgb value = scene(x - kPan * frame + 100000, y, 0);
        for (int c = 0; c < 3; ++c) value[c] = std::max(0.0f, value[c] * (1 + sigma * noise(x, y, frame, c, method)));
        color.set_rgb(x, y, value);
        color.at(x, y, 3) = 1;
      }
    }
    if (method == 0) {
      Image &back = out.create(layers::motion_backward()), &forward = out.create(layers::motion_forward());
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          back.at(x, y, 0) = -kPan, back.at(x, y, 3) = 1;
          forward.at(x, y, 0) = kPan, forward.at(x, y, 3) = 1;
        }
      }
    }
    const std::string name = method == 0 ? "reference" : fmt::format("method{}", method);
    write_frame(fmt::format("{}/{}/f.{:04}.exr", folder, name, frame + 1), out);
  });
}
