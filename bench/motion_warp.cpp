// SPDX-License-Identifier: Apache-2.0
// How well motion vectors carry a layer from one frame to the next: motion_warp A.exr B.exr LAYER CHAIN
// Looks A's pixels up in B along chain.CHAIN.motion.forward and along motion.forward, where both are valid, and prints the
// relMSE of what is found there for both. Pixels whose look-up touches one without the chain count for neither.
#include <fmt/format.h>

#include <cstdio>

#include "tempera/frames/frame.h"

int main(int argc, char** argv) {
  using namespace tempera;
  if (argc != 5) {
    std::fputs("usage: motion_warp A.exr B.exr LAYER CHAIN\n", stderr);
    return 2;
  }
  try {
    const Frame a = read_frame(argv[1]), b = read_frame(argv[2]);
    const std::string chain = std::string("chain.") + argv[4] + ".motion.";
    const Image &from = a.layer(argv[3]), &to = b.layer(argv[3]), &there = b.layer(chain + "state");
    const Image &along_chain = a.layer(chain + "forward"), &along_surface = a.layer("motion.forward");
    /// Squared error relative to what was to be found; negative where that cannot be told.
    const auto error = [&](const Image& vectors, int x, int y) {
      if (vectors.at(x, y, 3) == 0) return -1.0;
      const Vec2f p = Vec2f{float(x) + 0.5f, float(y) + 0.5f} + vectors.vec2(x, y);
      if (!(p.x >= 0.5f && p.y >= 0.5f && p.x < float(b.width()) - 0.5f && p.y < float(b.height()) - 0.5f)) return -1.0;
      for (int i = 0; i < 4; ++i) {
        if (there.at(int(p.x - 0.5f) + i % 2, int(p.y - 0.5f) + i / 2) == 0) return -1.0;
      }
      const Rgb expected = from.rgb(x, y), d = to.rgb_bilinear(p) - expected;
      const double gray = double(expected.r + expected.g + expected.b) / 3;
      return double(d.r * d.r + d.g * d.g + d.b * d.b) / 3 / (gray * gray + 0.01);
    };
    double sum_chain = 0, sum_surface = 0;
    std::int64_t count = 0;
    for (int y = 0; y < a.height(); ++y) {
      for (int x = 0; x < a.width(); ++x) {
        const double c = error(along_chain, x, y), s = error(along_surface, x, y);
        if (c < 0 || s < 0) continue;
        ++count, sum_chain += c, sum_surface += s;
      }
    }
    fmt::print("{} {:.6g} {:.6g}\n", count, sum_chain / double(std::max<std::int64_t>(count, 1)),
               sum_surface / double(std::max<std::int64_t>(count, 1)));
  } catch (const Error& e) {
    fmt::print(stderr, "motion_warp: {}\n", e.message());
    return 1;
  }
}
