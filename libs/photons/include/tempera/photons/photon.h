// SPDX-License-Identifier: Apache-2.0
#pragma once
// A photon as a map keeps it: its footprint on the first surface that scatters it diffusely after mirrors or glass.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "tempera/photons/footprint.h"

namespace tempera {

/// One of 2^10 parts of all directions, about 6 degrees wide: squares of an octahedron unfolded to a square.
inline std::uint32_t direction_cell(const Vec3f& d) {
  const float s = 1 / (std::abs(d.x) + std::abs(d.y) + std::abs(d.z));
  float x = d.x * s, y = d.y * s;
  if (d.z < 0) {
    const float fx = (1 - std::abs(y)) * std::copysign(1.0f, x);
    y = (1 - std::abs(x)) * std::copysign(1.0f, y);
    x = fx;
  }
  const auto part = [](float v) { return std::uint32_t(std::clamp(16 * (v + 1), 0.0f, 31.0f)); };
  return part(x) << 5 | part(y);
}

/// The specular events of a photon's path, the last one first: as a path from the eye meets them. At most 32.
class PhotonEvents {
 public:
  enum Kind : std::uint8_t { kReflection = 1, kTransmission = 2, kPassage = 3 };
  int size() const {
    int n = 0;
    for (std::uint64_t c = code_; c; c >>= 2) ++n;
    return n;
  }
  bool full() const { return code_ >> 62; }
  /// Another event of a photon that travels on. Pre: not full.
  void push(Kind k) { code_ = code_ << 2 | k; }
  /// Calls f(kind) for each, the last one first.
  template <class F>
  void visit(F&& f) const {
    for (std::uint64_t c = code_; c; c >>= 2) f(Kind(c & 3));
  }
  std::uint64_t code() const { return code_; }

 private:
  std::uint64_t code_ = 0;
};

struct Photon {
  Footprint footprint;
  Rgb flux;                ///< W
  float rate = 0;          ///< relative, of the flux, 1/s
  float thickness = 0;     ///< how far from its plane it counts, m: on curved surfaces footprints stand off
  float coarse_scale = 0;  ///< of the flux, where it is one of the few that stand for all; else 0
  Vec3f n;                 ///< unit geometric normal on the side where the photon arrives
  Vec3f wi;                ///< unit, towards where it comes from
  std::uint32_t instance = 0;
  PhotonEvents events;
  std::uint32_t suffix = 0;  ///< what the map's classifier makes of the events: an index of the map's
  std::uint8_t edges = 0;    ///< of its path, for the map
  std::uint8_t half = 0;     ///< 0 or 1: which of two independent sets it belongs to
};

}  // namespace tempera
