// SPDX-License-Identifier: Apache-2.0
#pragma once
// Gradient-domain path tracing of tiles: picture and differences of neighbouring pixels.
#include <stop_token>
#include <string>
#include <vector>

#include "adaptive_sampling.h"
#include "photons/photon_pass.h"
#include "rare_light.h"
#include "tempera/methods/method.h"
#include "tempera/transport/path_tracer.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

template <bool kByClass>
class ShiftObserver;

struct GradientOptions {
  PathOptions path;
  AdaptiveOptions adaptive;
  float roughness_threshold = 0.001f;
  bool rare = true;              ///< whether to write what robust reconstruction keeps apart (rare_light.h)
  bool class_gradients = false;  ///< whether to write the differences of each light-path class, too
  bool photons = false;          ///< whether caustics are found by photons

  static const std::vector<ParamSpec>& params();
  explicit GradientOptions(const Params& p);
};

/// Layers of a pass for a reconstruction: color, if `with_color`, and its differences; those of classes, too, if
/// they are asked for.
std::vector<LayerDesc> gradient_outputs(const GradientOptions& options, const RenderSettings& settings,
                                        const std::string& prefix, bool with_color);
/// Layers that a pass keeps until all tiles are there: the estimates of each difference from either side, their
/// variances if needed, and those of classes.
std::vector<LayerDesc> gradient_work_layers(const GradientOptions& options, const RenderSettings& settings,
                                            const std::string& prefix);
/// Names of the layers that a pass can write beside those of a film. `estimates`: as rare_layers has it.
std::vector<std::string> gradient_layer_names(const GradientOptions& options, const std::string& prefix, int estimates);

/// The samples of a tile, and what paths shifted to the neighbouring pixels say of the differences. Estimates from the
/// two sides of a difference are weighted as if both pixels had equally many samples, whatever they have: so the
/// weights of a pair of paths add up to one in any order and number of batches. Threads: one thread each.
class GradientTile {
 public:
  /// Gathers what `out` has layers for, under names that begin with `prefix`. `gathered`: as trace_path has it.
  GradientTile(const FrameContext& context, const Tile& tile, const Frame& out, const std::string& prefix,
               const GatheredLight* gathered);
  /// That `save` takes, about.
  static std::size_t bytes_of_pixel(const GradientOptions& options, const RenderSettings& settings);

  /// Adds `count` samples of pixel (x, y), with the random numbers of `key` from number `first` on.
  void sample(const FrameContext& context, const GradientOptions& options, int x, int y, const PixelKey& key, int first,
              int count, RenderCounters& counters);
  /// Writes the estimates to the layers of `out`, work layers too. Variances of differences are those of the means,
  /// from two independent halves; or, if `of_samples`, what the spread of all samples says, which is less noisy and,
  /// for points of a net, too much.
  void write(Frame& out, bool of_samples = false) const;
  /// As TileFilm has them.
  void save(ByteWriter& out) const;
  void load(ByteReader& in);

 private:
  struct Pixel {
    std::array<Rgb, 4> sums, even_sums, squares;  ///< of the contributions to the four differences
    int count = 0, even_count = 0;
  };
  template <bool kByClass>
  void sample_pixel(const FrameContext& context, const GradientOptions& options, int x, int y, const PixelKey& key,
                    int first, int count, RenderCounters& counters);
  template <bool kByClass>
  void add_rare(RarePixel& pixel, const SampleResult& sample, const ShiftObserver<kByClass>& shifts, float weight,
                bool even) const;

  const RenderSettings& settings_;
  Tile tile_;
  std::string prefix_;
  const GatheredLight* gathered_;
  TileFilm film_;
  std::vector<Pixel> pixels_;
  std::vector<RarePixel> rare_;   ///< empty if not asked for
  std::size_t class_count_ = 0;   ///< whose differences are gathered, paths of no class included
  std::vector<Rgb> class_sums_;   ///< contributions to the four differences of a pixel, by class
  std::vector<Rgb> class_apart_;  ///< what stays out of these, by class; empty without gathered light
  bool two_estimates_;
};

/// Joins the two estimates of each difference of a pass (the beginning of its layers' names), of classes, too: mean of g_ij minus mean
/// of g_ji. [Manzi 2016, Eq. 1]
void join_gradients(const std::string& pass, Frame& out);

/// A frame whose samples are placed in batches, a pass each: what its tiles share.
class GradientBatches {
 public:
  /// `spp`: samples of a pixel, on average.
  GradientBatches(const RenderSettings& settings, const GradientOptions& options, int spp);

  /// Their passes; every one but the first waits for the one before.
  static std::vector<PassDesc> passes(const GradientOptions& options, const RenderSettings& settings, int spp);
  int count() const { return plan_.count; }
  /// Renders batch `batch` of a tile. Returns false if it was stopped. Threads: concurrently for different tiles.
  bool render(const FrameContext& context, const GradientOptions& options, const GatheredLight* gathered, int batch,
              const Tile& tile, UnitOutput& out, RenderCounters& counters, const std::stop_token& stop) const;
  /// Places the batch after `batch`, once all tiles of `out` hold this one.
  void end(const RenderSettings& settings, const GradientOptions& options, int batch, int frame, const Frame& out);
  void save(ByteWriter& out) const;
  void load(ByteReader& in);

 private:
  BatchPlan plan_;
  std::vector<int> taken_, wanted_;  ///< samples of each pixel: numbers used up; in the present batch
};

/// What the passes of a frame share.
struct GradientState : SectionState {
  GradientState(const RenderSettings& settings, const GradientOptions& options, int spp)
      : batches(settings, options, spp) {}
  void save(ByteWriter& out) const override;
  void load(ByteReader& in) override;
  GradientBatches batches;
  PhotonState photons;
};

/// Method::replay: the radiance of a sample, or what it adds to a difference if that is not finite.
Rgb replay_gradients(const FrameContext& context, const GradientOptions& options, const BadSample& sample);

/// Errors: Error{kUnsupported} for a rolling shutter, naming `integrator`.
void check_gradient_settings(const RenderSettings& settings, std::string_view integrator);

}  // namespace tempera
