// SPDX-License-Identifier: Apache-2.0
#pragma once
// Features of what is seen in mirrors and through glass: those of the first surface where a path scatters diffusely (D),
// for each chain of specular events (R, T) before it. Where a surface does several of these at once (coated wood), a path
// follows all of them with their shares, so one sample may feed several chains. [Zimmer 2015, Sec. 3]
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "tempera/core/bytes.h"
#include "tempera/core/fixed_stack.h"
#include "tempera/frames/frame.h"
#include "tempera/paths/light_path_expression.h"

namespace tempera {

/// What one sample tells of a chain. Zero where the path does not follow it.
struct ChainHit {
  Rgb albedo;        ///< of the D events of the surface, times what the chain leaves of light
  Rgb emission;      ///< likewise
  float weight = 0;  ///< luminance of what the chain leaves of light
  Vec3f normal;      ///< unit, on the viewer's side
  float depth = 0;   ///< length of the path from the camera
  std::uint32_t instance = 0;
};

/// The chains that layers are asked for, and what the sample at hand tells of each. Threads: one thread each.
class ChainFeatures {
 public:
  /// Letters as in layers::chain_layer.
  explicit ChainFeatures(std::vector<std::string> chains);
  const std::vector<std::string>& chains() const { return names_; }
  bool empty() const { return names_.empty(); }

  /// A path begins at the camera.
  void start();
  /// Whether the path may still reach the end of a chain.
  bool active() const { return shares_.size() > 0 || !is_black(any_part_); }
  /// The path arrived with throughput `beta` from `previous` at `v`, which sends back `emitted`; `known`: the albedo there, if
  /// it is. Not inlined, so that the path tracer is rounded alike with chains and without. Pre: active; v has its bsdf.
  template <class Vertex>
  [[gnu::noinline]] void arrive(const Rgb& beta, const Vertex& v, const Rgb& emitted, const Vec3f& previous,
                                const Rgb* known) {
    depth_ += length(v.s.p - previous);
    const bool ends = v.bsdf.empty() || !is_black(emitted);
    std::optional<Rgb> albedo;
    const auto diffuse = [&]() -> const Rgb& {
      if (!albedo) albedo = v.bsdf.diffuse_albedo(v.s.wo, known);
      return *albedo;
    };
    const auto hit = [&](const Rgb& throughput) {
      return ChainHit{
          .albedo = throughput * diffuse(),
          .emission = throughput * emitted,
          .weight = luminance(throughput),
          .normal = dot(v.s.bends ? v.s.ng : v.s.frame.n, v.s.wo) < 0 ? -v.s.frame.n : v.s.frame.n,
          .depth = depth_,
          .instance = v.hit.point.instance,
      };
    };
    for (const Share& s : shares_) {
      const int i = find(s.code);
      if (i < 0) continue;
      if (!ends && is_black(diffuse())) break;  // a mirror or clear glass
      hits_[std::size_t(i)] = hit(beta * s.part);
    }
    if (!is_black(any_part_)) {
      ChainHit h = hit(beta * any_part_);
      // A lamp in a mirror or behind glass has no reflectance that its light could be divided by.
      if (events_ > 0 && !is_black(emitted)) h.albedo = beta * any_part_;
      add_any(h);
    }
  }
  /// The path left the scene with throughput `beta`. Pre: active.
  void leave(const Rgb& beta);
  /// The path scatters by `f`, by event. Pre: active.
  void scatter(const std::array<Rgb, kEventCount>& f);
  /// One for each chain.
  std::span<const ChainHit> hits() const { return hits_; }

 private:
  /// Specular events so far, a bit each (T: 1), below a leading one.
  using Code = std::uint32_t;
  struct Share {
    Code code;
    Rgb part;
  };
  int find(Code code) const;
  /// Adds a hit to those of any chain, weighted by what its reflectance sends to the camera.
  void add_any(ChainHit hit);

  std::vector<std::string> names_;
  std::vector<Code> codes_;
  std::vector<Code> prefixes_;  ///< of these, themselves included
  std::vector<ChainHit> hits_;
  FixedStack<Share, 2 * (1 << layers::kMaxChain)> shares_;
  float depth_ = 0;
  int any_ = -1;    ///< index of layers::kAnyChain; -1: not asked for
  Rgb any_part_;    ///< of the light that may still come by any chain; 0: not asked for
  int events_ = 0;  ///< so far
};

/// Means of chain features over the samples of a tile's pixels. Threads: one thread each.
class ChainFilm {
 public:
  /// Gathers what `out` has layers for; nothing for null.
  ChainFilm(const Frame* out, int width, int height);
  ChainFeatures& features() { return features_; }
  static std::size_t bytes_of_pixel(std::size_t chains) { return chains * sizeof(Sums); }
  /// Adds features().hits() to pixel `i` of the tile with a filter weight.
  void add(std::size_t i, float weight);
  /// Writes the tile to the layers of `out`, from (left, top) on. count(i): samples of pixel i.
  void write(Frame& out, int left, int top, const std::function<int(std::size_t)>& count) const;
  void save(ByteWriter& out) const { out.values(sums_); }
  void load(ByteReader& in) { in.values(sums_); }

 private:
  struct Sums {
    Rgb albedo, emission;
    Vec3f normal;
    float depth = 0, weight = 0, largest = 0;
    std::uint32_t instance = 0;
  };
  ChainFeatures features_;
  int width_;
  std::vector<Sums> sums_;  ///< of a pixel, for each chain
};

}  // namespace tempera
