// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the samples of a tile add up to, and the layers that are written from it.
#include <span>
#include <vector>

#include "tempera/frames/cryptomatte.h"
#include "tempera/transport/path_tracer.h"

namespace tempera {

/// Names of the layers that a TileFilm and write_motion (pixel_motion.h) can write, beside CryptoObject* and
/// class.*.
const std::vector<std::string>& film_layers();
/// The descriptors of what `settings` asks for: color, the layers among `names` and film_layers(), cryptomatte, and for
/// each class its color, with halves and variance where those of color are asked for. Errors: Error{kUnknownName} for a layer that is not among them, naming `integrator`.
std::vector<LayerDesc> film_outputs(const RenderSettings& settings, std::string_view integrator,
                                    std::span<const std::string> more = {});

/// Names of the light-path classes that have layers: those of `settings`, and the residual of a decomposition.
std::vector<std::string> class_names(const RenderSettings& settings);

/// Appends those of `more` that `list` lacks.
void add_missing(std::vector<LayerDesc>& list, const std::vector<LayerDesc>& more);

/// Variance of the mean of all samples of a pixel, from what its two independent halves add up to. With halves of m and
/// n samples the square of the difference of their means is, in the mean, (m + n)^2 / (m n) times as large. The square
/// of the mean, at least as large as the variance in the mean, if one half is empty; 0 if both are.
Rgb variance_of_mean(const Rgb& sum_a, int count_a, const Rgb& sum_b, int count_b);

/// Threads: one thread each.
class TileFilm {
 public:
  /// That `save` takes, without cryptomatte.
  static std::size_t bytes_of_pixel(const RenderSettings& settings);

  /// Gathers what `out` has layers for, under names that begin with `prefix`.
  TileFilm(const FrameContext& context, const Tile& tile, const Frame& out, std::string prefix = "");

  /// What samples must tell of their first hit.
  Features features() const { return features_; }
  /// Room for the radiance of one sample by class, zero.
  std::span<Rgb> sample_classes();
  /// Adds sample `index` of pixel (x, y); the classes are those of sample_classes(). Returns false, and leaves the
  /// sample out, if it is not finite.
  bool add(int x, int y, int index, const CameraSample& camera, const SampleResult& sample);
  /// Adds what a further sample tells of features alone.
  void add_features(int x, int y, const CameraSample& camera, const FirstHit& first);
  /// What gathers features of chains; null if they are not asked for.
  ChainFeatures* chains() { return chains_.features().empty() ? nullptr : &chains_.features(); }
  /// Relative standard error of the mean luminance of pixel (x, y).
  float relative_error(int x, int y) const { return pixels_[at(x, y)].relative_error(); }
  void write(Frame& out) const;
  /// What it has gathered, to go on later.
  void save(ByteWriter& out) const;
  /// Pre: saved by a film of this tile and these layers. Errors: Error{kBadInput}.
  void load(ByteReader& in);

 private:
  struct Pixel {
    Rgb sum, sum_a, sum_b, squares;
    float alpha = 0;
    int count = 0, count_a = 0, count_b = 0, feature_count = 0;
    Rgb albedo, emission;
    Vec3f normal, position;
    Vec2f uv;
    float depth = 0;
    int hits = 0;
    double time = 0;
    float relative_error() const;
  };
  std::size_t at(int x, int y) const {
    return std::size_t(y - tile_.y0) * std::size_t(tile_.x1 - tile_.x0) + std::size_t(x - tile_.x0);
  }
  const RenderSettings& settings_;
  Tile tile_;
  std::string prefix_;
  std::size_t class_count_;
  std::vector<Pixel> pixels_;
  /// Radiance of one class: sums of all samples and of those of half a.
  struct ClassSums {
    Rgb sum, sum_a;
  };
  std::vector<ClassSums> class_sums_;
  std::vector<ClassSums> gathered_sums_;  ///< of SampleResult::gathered; empty if not asked for
  std::vector<Rgb> sample_classes_;
  bool cryptomatte_;
  Features features_ = Features::kNone;
  CryptomatteBuffer ids_;
  ChainFilm chains_;
  std::vector<float> instance_ids_;
};

}  // namespace tempera
