// SPDX-License-Identifier: Apache-2.0
#pragma once
// What of a frame is seen at each pixel of a picture of another time, by the motion vectors of the frame: surfaces are
// moved, the nearest one is found, and its place in the frame worked out backwards, so that there are neither cracks nor
// seams. Private to the stages that move pictures.
#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "sound_values.h"
#include "tempera/core/grid.h"
#include "tempera/core/params.h"
#include "tempera/frames/frame.h"

namespace tempera::motion {

/// The surfaces of a frame and how they move: at `theta` frames from its time, what pixel i shows is displaced by
/// theta * linear + theta^2 * quadratic; x, y in pixels, z in meters of depth.
struct Surfaces {
  Grid<Vec3f> linear, quadratic;
  Grid<float> depth;           ///< meters, kFar where nothing is; empty: unknown
  Grid<float> id;              ///< of objects; empty: unknown
  Grid<std::uint8_t> vectors;  ///< which ones the frame has: kForward, kBackward; kNothing: no surface
  std::int64_t unknown = 0;    ///< pixels without any vector of their object: they stay where they are
  int width() const { return linear.width(); }
  int height() const { return linear.height(); }
  Vec3f moved(std::size_t i, float theta) const { return theta * linear[i] + theta * theta * quadratic[i]; }
  /// Whether two pixels that are near each other move as parts of one surface do.
  bool moves_with(std::size_t i, std::size_t j) const {
    const Vec3f &a = linear[i], &b = linear[j];
    const float dx = a.x - b.x, dy = a.y - b.y, limit = 0.5f + 0.05f * (std::abs(a.x) + std::abs(a.y));
    return dx * dx + dy * dy <= limit * limit;
  }
  bool same(std::size_t i, std::size_t j) const { return (id.empty() || id[i] == id[j]) && moves_with(i, j); }
  /// Whether `i` is nearer than `j`: by depth, else what moves more is taken to be.
  bool nearer(std::size_t i, std::size_t j) const;
};
inline constexpr float kFar = 1e30f;
inline constexpr std::uint8_t kForward = 1, kBackward = 2, kNothing = 4;

/// Takes motion.forward and motion.backward (one of them at least), depth and object_id of a frame. A vector that is
/// not valid is the opposite of the one in the other direction, else continued from pixels of the same object: smoothly
/// [Zimmer 2015, Sec. 5.3]. Errors: Error{kBadInput} naming `frame` for layers with too few channels.
/// `prefix`: of the layers' names: "chain.RD." for what is seen in mirrors.
Surfaces read_surfaces(const Frame& layers, int frame, const std::string& prefix = "");

/// A place in a frame.
struct Place {
  float x = -1, y = -1;   ///< pixels, centers at +0.5; x < 0: nothing
  float depth = kFar;     ///< when it is seen
  std::int8_t frame = 0;  ///< index of the frame, for those who look at several
  bool valid() const { return x >= 0; }
};

/// What is seen `theta` frames after the time of `surfaces`, at each pixel. Serial; the same bits always.
Grid<Place> project(const Surfaces& surfaces, float theta);

/// Where what pixels of a frame show is `frames.size() - 1` frames on, step by step along the vectors: `frames` are the
/// surfaces of the frame, of those in between, and of the last one, in either direction of time (`step` 1 or -1). A place
/// is valid where each vector on the way is the frame's own, leads to the same object within the picture, and is undone
/// by the vector back.
Grid<Place> walk(std::span<const Surfaces* const> frames, int step);

/// Lets pixels that see nothing see what the farthest of their neighbors does, ring by ring.
void grow(Grid<Place>& places);

/// Pixels of a frame and their weights: what stands at a place, from the pixels around of the same surface.
struct Taps {
  std::uint32_t pixel[4];
  float weight[4];   ///< adding up to 1
  std::size_t main;  ///< the pixel that the place is in
};
Taps taps_at(const Surfaces& surfaces, const Place& place);
/// The value of channel `c` there; what is damaged counts as 0.
inline float value_at(const Image& image, const Taps& taps, int c) {
  float sum = 0;
  const float* v = image.values().data();
  for (int k = 0; k < 4; ++k) {
    const float value = v[std::size_t(taps.pixel[k]) * image.channels() + c];
    sum += taps.weight[k] * sound(value);
  }
  return sum;
}

/// First frames of shots, from the parameter `cuts` of a stage. Errors: StageParamError.
std::vector<int> cuts_of(const Params& params);

/// Pixels at the edge of something nearer that moves in another way, whose averages hold light of it: a bit for each of
/// the eight neighbors that belong to it, in the order of `kAround`.
Grid<std::uint8_t> covered_edges(const Surfaces& surfaces);
inline constexpr int kAround[8][2] = {{-1, -1}, {0, -1}, {1, -1}, {-1, 0}, {1, 0}, {-1, 1}, {0, 1}, {1, 1}};
/// `image`, with the means of the pixels at such edges replaced by those of pixels around of the same surface.
Image without_edges(const Image& image, const Surfaces& surfaces, const Grid<std::uint8_t>& edges);

}  // namespace tempera::motion
