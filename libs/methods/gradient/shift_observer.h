// SPDX-License-Identifier: Apache-2.0
#pragma once
// Gradient-domain path tracing: beside the picture, the differences between neighbouring pixels, estimated with pairs
// of correlated paths. [Kettunen 2015; Manzi 2016]
//
// Every path of a pixel (the base path: that of the integrator "path", bit for bit) is shifted to its four neighbours.
// The difference I_j - I_i is the sum of two estimates, from the paths of i and from those of j; each path pair is
// weighted over all the ways in which it could have been sampled: from either side, by next-event estimation or by the
// BSDF. What is weighted are ratios to the density of the base path, so that single precision serves:
//
//   beta  f' / p of the offset path, with the Jacobians of its shifts
//   rho   p' / p of the two paths, with the Jacobians
//   g     of Manzi's g_ij: the contributions of one base path to one difference
#include "tempera/transport/path_tracer.h"

namespace tempera {

/// To the neighbours of a pixel: right, down, left, up.
constexpr std::array<Vec2f, 4> kNeighbours{Vec2f{1, 0}, Vec2f{0, 1}, Vec2f{-1, 0}, Vec2f{0, -1}};

/// What a path keeps to tell classes apart.
struct ClassesOfPath {
  WeightedStates states;   ///< of its events
  std::span<Rgb> classes;  ///< of an offset path: g by class, the last entry for paths of none
};
struct NoClasses {};

/// One shifted path, built along with the base path.
template <bool kByClass>
struct OffsetPath {
  enum State : std::uint8_t {
    kOutside,  ///< its pixel is not part of the picture
    kDead,     ///< the shift failed
    kFree,     ///< all its vertices are its own
    kFresh,    ///< shares the current vertex, but arrives there from elsewhere
    kJoined    ///< shares the last two vertices
  } state = kOutside;
  Rgb beta{1.0f};
  float rho = 1;
  float roulette = 1, eta2 = 1;  ///< what Russian roulette looks at
  Vertex vertex;                 ///< kFree, kFresh: the current one, seen from this path's previous vertex
  Rgb g;
  [[no_unique_address]] std::conditional_t<kByClass, ClassesOfPath, NoClasses> by_class;
};

/// Shifts a base path to the neighbouring pixels as it grows. kByClass: whether it tells light-path classes apart; without
/// that nothing of them is compiled in.
template <bool kByClass>
class ShiftObserver {
 public:
  static constexpr bool kActive = true;
  /// `classes`: with kByClass, zeros for the contributions to each of the four differences, one for each class and one for
  /// paths of none; or empty. `gathered`: with kByClass, what finds light of some classes instead of these paths, or null;
  /// `apart`: zeros for what of it stays out of the differences, by class; or empty.
  ShiftObserver(const FrameContext& context, const PathOptions& options, float threshold, const CameraSample& camera,
                std::array<bool, 4> inside, [[maybe_unused]] std::span<Rgb> classes = {},
                [[maybe_unused]] const GatheredLight* gathered = nullptr, [[maybe_unused]] std::span<Rgb> apart = {})
      : context_(context), options_(options), threshold_(threshold), camera_(camera) {
    if constexpr (kByClass) {
      by_class_.states.start(context.classifier, camera.stream.hash());
      by_class_.classes = apart;
      gathered_ = gathered;
      if (gathered) owned_lights_ = gathered->lights(camera.time);
    }
    for (std::size_t j = 0; j < 4; ++j) {
      Offset& o = offsets_[j];
      o.state = inside[j] ? OffsetPath<kByClass>::kFree : OffsetPath<kByClass>::kOutside;
      if constexpr (kByClass) {
        o.by_class.states.start(context.classifier, camera.stream.hash());
        o.by_class.classes = classes.subspan(j * classes.size() / 4, classes.size() / 4);
      }
    }
  }
  const Rgb& g(std::size_t j) const { return offsets_[j].g; }

  /// Whether the path is rare: it met a lobe too narrow to connect to after a surface that connects, as light does that
  /// glass focuses onto a wall. Shifts of such paths mostly fail, so their differences are noise.
  bool rare() const { return rare_; }
  /// Of a rare path, radiance and contributions to the differences from before it became one.
  const Rgb& common_radiance() const { return common_radiance_; }
  const Rgb& common_g(std::size_t j) const { return common_g_[j]; }
  std::uint64_t rays() const { return rays_; }

  void start(const Vertex* first, const Rgb& emitted);
  void next_event(const Vertex& at, const LightSample& light, const BsdfEval& f, float visible);
  void extend(const Extension& edge);
  /// Gathered light behind the first surface is compared as a lamp's would be that BSDF samples alone find. That on the
  /// first surface stays out of the differences: pixels beside each other gather it from the same photons.
  void gather(const Vertex& at, std::span<const GatheredLight::Arrival> arrivals, const Rgb& found, bool first,
              bool coarse, int most_edges);

 private:
  using Offset = OffsetPath<kByClass>;
  /// Diffuse enough to connect to; `delta`: whether the path takes a delta lobe there.
  bool connects(const Vertex& v, bool delta) const { return !delta && v.bsdf.least_roughness() > threshold_; }
  /// The end of an edge: lights and the environment always can be connected to.
  bool connects_to(const Vertex* v) const { return !v || v->shape->emission || connects(*v, false); }
  bool samples_lights(const Bsdf& bsdf) const { return bsdf.has_non_delta() && !context_.lights.empty(); }
  /// What a pair of paths that end at a light adds to a difference: throughput of the offset path and the radiance that it
  /// carries, light of the base path, and the pair's weight. `owned`: the part of that radiance from lights whose paths
  /// may be left out.
  TEMPERA_INLINE void add(Offset& o, const Rgb& beta, const Rgb& radiance, const Rgb& base, float weight,
                          const Rgb& owned) const;
  /// The same where there is no offset path.
  TEMPERA_INLINE void lose(Offset& o, const Rgb& base, float weight) const;
  /// The same for light that arrives by next-event estimation, where f is what the last vertices scatter by event.
  TEMPERA_INLINE void add(Offset& o, const Rgb& offset, const BsdfEval& f_offset, const Rgb& base, const BsdfEval& f,
                          float weight, const Rgb& owned) const;
  /// What of these goes to classes. Never inlined, so that g is rounded alike with classes and without.
  [[gnu::noinline]] void add_to_classes(Offset& o, const Rgb& beta, const Rgb& radiance, const Rgb& base,
                                        float weight) const;
  [[gnu::noinline]] void add_to_classes(Offset& o, const Rgb& offset, const BsdfEval& f_offset, const Rgb& base,
                                        const BsdfEval& f, float weight) const;
  /// All of these where some paths are left out: light of the offset path is beta times radiance. `f_offset`, `f`: what the
  /// last vertices scatter; null where the paths end at a light.
  [[gnu::noinline]] void add_others(Offset& o, const Rgb& beta, const Rgb& radiance, const BsdfEval* f_offset,
                                    const Rgb& owned, const Rgb& base, const BsdfEval* f, float weight) const;
  /// Part of the radiance that a light sends, or a surface or the environment along wi, of lights whose paths may be left
  /// out. 0 if none are.
  Rgb owned(const LightSample& light) const;
  Rgb owned(const Vertex* to, const Vec3f& wi, const Rgb& emitted) const;
  void extend_shared(const Extension& e, const Rgb& base, float base_weight, Offset& o) const;
  void reconnect(const Extension& e, const Rgb& base, float base_weight, Offset& o);
  void copy_half_vector(const Extension& e, const Rgb& base, Offset& o);
  /// Scattering of an offset path by `f`: its share of throughput, density and roulette.
  TEMPERA_INLINE void scatter(const Extension& e, const BsdfEval& f, float pdf, float jacobian, float eta, Offset& o,
                              bool straight = false) const;

  const FrameContext& context_;
  const PathOptions& options_;
  float threshold_;
  const CameraSample& camera_;
  Rgb beta_{1.0f};  ///< of the base path
  /// Of the base path; classes: of what stays apart.
  [[no_unique_address]] std::conditional_t<kByClass, ClassesOfPath, NoClasses> by_class_;
  const GatheredLight* gathered_ = nullptr;
  std::span<const char> owned_lights_;
  Rgb owned_;  ///< of what the base path's last edge leads to
  Rgb apart_;  ///< radiance that stays out of the differences
  std::array<OffsetPath<kByClass>, 4> offsets_;
  std::uint64_t rays_ = 0;
  bool connected_ = false, rare_ = false;  ///< connected_: a surface that connects was met
  Rgb common_radiance_;
  std::array<Rgb, 4> common_g_;
};

}  // namespace tempera
