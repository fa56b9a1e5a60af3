// SPDX-License-Identifier: Apache-2.0
#pragma once
// A photon as a map keeps it: its footprint on the first surface that scatters it diffusely after mirrors or glass.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "tempera/paths/light_path_expression.h"
#include "tempera/photons/footprint.h"

namespace tempera {

/// A unit vector in four bytes: points of an octahedron unfolded to a square; within 4e-5 of it.
class PackedDirection {
 public:
  PackedDirection() = default;
  explicit PackedDirection(const Vec3f& d) {
    const float s = 1 / (std::abs(d.x) + std::abs(d.y) + std::abs(d.z));
    float x = d.x * s, y = d.y * s;
    if (d.z < 0) {
      const float fx = (1 - std::abs(y)) * std::copysign(1.0f, x);
      y = (1 - std::abs(x)) * std::copysign(1.0f, y);
      x = fx;
    }
    x_ = pack(x), y_ = pack(y);
  }
  Vec3f unpack() const {
    Vec3f d{float(x_) / kMost, float(y_) / kMost, 0};
    d.z = 1 - std::abs(d.x) - std::abs(d.y);
    if (d.z < 0) {
      const float x = d.x;
      d.x = (1 - std::abs(d.y)) * std::copysign(1.0f, x);
      d.y = (1 - std::abs(x)) * std::copysign(1.0f, d.y);
    }
    return normalize(d);
  }
  /// One of 2^12 parts of all directions, about 3 degrees wide.
  std::uint32_t cell() const { return std::uint32_t((x_ + 32768) >> 10) << 6 | std::uint32_t((y_ + 32768) >> 10); }

 private:
  static constexpr float kMost = 32767;
  static std::int16_t pack(float v) { return std::int16_t(std::lround(std::clamp(v, -1.0f, 1.0f) * kMost)); }
  std::int16_t x_ = 0, y_ = 0;
};

/// The specular events of a photon's path, the last one first: as a path from the eye meets them.
class PhotonEvents {
 public:
  enum Kind : std::uint8_t { kReflection = 1, kTransmission = 2, kPassage = 3 };
  static constexpr int kMost = 32;
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
  Vec3f n;                 ///< unit geometric normal on the side where the photon arrives
  PackedDirection wi;      ///< towards where it comes from
  std::uint32_t instance = 0;
  std::uint32_t suffix = 0;  ///< which sequence of events it has: an index of the map's
  PhotonEvents events;
  std::uint8_t half = 0;     ///< 0 or 1: which of two independent sets it belongs to
  bool moving = false;       ///< whether its receiver moves while the shutter is open
};

}  // namespace tempera
