// SPDX-License-Identifier: Apache-2.0
#pragma once
// A BSDF at one point: a value that a Material fills with lobes once per hit. Closed over its kinds of lobes:
// evaluating and sampling make no virtual call. Directions are unit vectors in world space and point away from the
// surface; `wo` is known, `wi` is sampled. Values include the cosine of each lobe's own shading frame ("f_cos"), so
// that lobes with different frames (bumped base, smooth coat) can share one Bsdf. They are for radiance that travels
// from wi to wo: transmission has the factor 1/eta^2. For importance (light subpaths) multiply by BsdfSample::eta^2, or
// swap the arguments of `eval`.
#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <optional>
#include <type_traits>

#include "tempera/core/error.h"
#include "tempera/core/fixed_stack.h"
#include "tempera/core/vec.h"
#include "tempera/shading/lobes.h"

namespace tempera {

/// Letter that a scattering event contributes to a light path: D diffuse or rough, R (near-)specular reflection,
/// T (near-)specular transmission. A lobe is R or T if it is a delta or its roughness alpha is below 0.1, else D
/// [Zimmer 2015, Sec. 3].
enum class Event : std::uint8_t { kDiffuse, kReflection, kTransmission };
inline constexpr int kEventCount = 3;
inline constexpr float kSpecularRoughness = 0.1f;

/// f(wo, wi) |cos| split by event, and the solid-angle density with which Bsdf::sample would produce wi. No delta
/// lobes.
struct BsdfEval {
  std::array<Rgb, kEventCount> f_cos{};
  float pdf = 0;
  Rgb sum() const { return f_cos[0] + f_cos[1] + f_cos[2]; }
};

/// A sampled direction with its value. Non-delta: of all non-delta lobes in direction wi. Delta: f_cos is the lobe's
/// coefficient in its event, pdf the probability of choosing this lobe.
struct BsdfSample : BsdfEval {
  Vec3f wi;
  bool delta = false;
  bool transmitted = false;       ///< wi and wo are on opposite sides
  Event event = Event::kDiffuse;  ///< of the sampled lobe
  float eta = 1;  ///< relative index of refraction (side of wi over side of wo) crossed by this event; 1 for reflection
  float roughness = 1;  ///< alpha of the sampled lobe; 0 for delta, 1 for diffuse
  int lobe = 0;         ///< index of the sampled lobe
};

/// What a surface does by R or T (Event) as a smooth mirror or interface would: rough lobes of these events are taken
/// for smooth ones. [Zimmer 2015, Sec. 4]
struct SpecularEvent {
  float eta =
      1;    ///< index of refraction on the far side over that on the side of wo; 1: reflects, or passes straight on
  Vec3f n;  ///< unit normal that it reflects or refracts about, of either side
};

/// A partly reflecting layer (coat, sheen) above lobes: it scales them by min(1 - A(wo), 1 - A(wi)), where A is the
/// layer's directional albedo. Symmetric, so that reciprocity holds, and never gains energy [Estevez 2017, Sec. 4].
struct BsdfLayer {
  enum class Albedo : std::uint8_t {
    kFresnel,  ///< f0 + (f90 - f0)(1 - cos)^5: a smooth coat
    kGgx,      ///< the same Fresnel term over GGX facets of roughness `alpha`
    kSheen,    ///< f0 times the albedo of SheenLobe
  };
  Albedo albedo = Albedo::kFresnel;
  std::uint8_t frame = 0;  ///< of Bsdf
  std::int8_t above = -1;  ///< layer over this one, or -1
  float f0 = 0.04f, f90 = 1, alpha = 1;
};

/// A set of weighted lobes. Threads: a value, const use is re-entrant.
class Bsdf {
 public:
  static constexpr int kMaxLobes = 16;
  static constexpr int kMaxFrames = 12;
  static constexpr int kMaxLayers = 8;

  Bsdf() {}  // NOLINT: with "= default", Bsdf{} would zero the uninitialised storage

  /// Empties it for another point.
  void clear() {
    lobes_.clear();
    frames_.clear();
    layers_.clear();
    total_probability_ = 0;
    has_non_delta_ = false;
    has_horizon_ = false;
  }
  /// From here on reflecting lobes keep to the viewer's side of the surface with geometric normal `ng` (unit, turned
  /// towards the viewer) and fade out at its horizon (terminator_factor). Interfaces that transmit do not: they use the
  /// normals as they were before they were bent.
  void set_horizon(const Vec3f& ng) {
    horizon_ = ng;
    has_horizon_ = true;
  }
  /// Registers a shading frame for the lobes added after it; returns its index (an equal frame's, if there is one).
  /// More than kMaxFrames, kMaxLobes or kMaxLayers is an assertion failure: materials check their depth when they are
  /// built.
  int add_frame(const Basis& frame) { return add_frame(frame, frame.n); }
  /// The same for a frame whose normal was bent from `unbent`.
  int add_frame(const Basis& frame, const Vec3f& unbent);
  /// Registers a frame that bump or normal mapping made from frame `parent`, its normal perhaps bent from `unbent`.
  /// Without a horizon light must be on the same side of both normals, and is attenuated near the horizon of the parent
  /// [Estevez 2019], as in Mitsuba.
  int add_perturbed_frame(const Basis& frame, int parent, const Vec3f& unbent);
  /// Frame `index` seen from behind: the normal (and nothing else) turned over.
  int add_flipped_frame(int index);
  /// Frame `index` turned about its normal so that the tangent is direction.x s + direction.y t (a unit vector).
  int add_rotated_frame(int index, const Vec2f& direction);
  int add_layer(const BsdfLayer& layer);
  /// Adds `weight` times a lobe, chosen by `sample` with probability proportional to `probability`, under layer `layer`
  /// (-1: none). The probabilities of one material sum to its weight.
  template <class L>
  void add(int frame, const L& lobe, float probability, float weight = 1, int layer = -1) {
    if (!(probability > 0)) return;
    if constexpr (requires { lobe.transmits(); }) {
      if (has_horizon_ && lobe.transmits()) frame = unbent_frame(frame);
    }
    lobes_.push_made([&] {
      return Entry{Lobe(std::in_place_type<L>, lobe), probability, weight, std::uint8_t(frame), std::int8_t(layer)};
    });
    total_probability_ += probability;
    has_non_delta_ |= !L::kDelta;
  }
  /// Multiplies the probabilities of lobe `first` and those after it, for materials that know them only when all their
  /// lobes are there.
  void scale_probabilities(int first, float factor) {
    total_probability_ = 0;
    for (int i = 0; i < lobes_.size(); ++i) {
      if (i >= first) lobes_[i].probability *= factor;
      total_probability_ += lobes_[i].probability;
    }
  }

  /// Sum over the non-delta lobes. Zero (pdf 0) where none scatters. Values are for the given wo; the probabilities of
  /// lobes stay those of the wo that the material saw.
  BsdfEval eval(const Vec3f& wo, const Vec3f& wi) const;
  /// Draws wi from the mixture of lobes. `u_lobe`, `u` in [0,1). Empty if no lobe scatters or the sample is invalid.
  std::optional<BsdfSample> sample(const Vec3f& wo, float u_lobe, const Vec2f& u) const;

  /// The same as eval and sample, of the lobes alone that are near-specular (R or T, Event) but no deltas; they are chosen
  /// among each other.
  BsdfEval eval_near_specular(const Vec3f& wo, const Vec3f& wi) const;
  std::optional<BsdfSample> sample_near_specular(const Vec3f& wo, float u_lobe, const Vec2f& u) const;

  /// The one direction of delta lobe i, as `sample` gives it when it chooses that lobe.
  /// Empty if it scatters nothing. Pre: lobe i is a delta.
  std::optional<BsdfSample> sample_delta(int i, const Vec3f& wo) const;

  bool empty() const { return lobes_.size() == 0; }
  bool is_delta(int i) const;
  /// Whether a lobe is D, or near-specular (R or T, Event) without being a delta.
  bool has_diffuse() const;
  bool has_near_specular() const;
  /// Smallest alpha of the lobes that are not deltas; infinity without one.
  float least_roughness() const;
  /// Index of refraction on the other side of the surface over that on the side of `wo`, of the first lobe that is no
  /// delta and transmits (1: it lets light pass straight on). 0 without one.
  float rough_eta(const Vec3f& wo) const;
  /// Whether next-event estimation can contribute: some lobe is not a delta.
  bool has_non_delta() const { return has_non_delta_; }
  /// Share of the light from everywhere that reaches `wo`: directional reflectance and transmittance, in terms of power
  /// (without the 1/eta^2 of radiance), so 1 for clear glass. In closed form or from tables, within 0.03, and 0.08 for
  /// anisotropic facets. For feature layers, never for transport.
  Rgb albedo(const Vec3f& wo) const;
  /// The same of lobes that are D alone (Event), whether they reflect or transmit.
  /// `all`: albedo(wo), if that is known.
  Rgb diffuse_albedo(const Vec3f& wo, const Rgb* all = nullptr) const;
  /// How light that is seen from `wo` is reflected (R) or transmitted (T) where that sends any: by the lobe whose normal
  /// is nearest to `n`. Empty if none does. Pre: event is not kDiffuse.
  std::optional<SpecularEvent> specular(Event event, const Vec3f& wo, const Vec3f& n) const;
  int size() const { return lobes_.size(); }
  const Lobe& lobe(int i) const { return lobes_[i].lobe; }
  /// Probability of choosing lobe i.
  float probability(int i) const { return lobes_[i].probability / total_probability_; }
  /// Shading frame of lobe i.
  const Basis& frame(int i) const { return frames_[lobes_[i].frame].basis; }
  /// Frame `index` as returned by add_frame, and the index of the unperturbed frame that it was made from.
  const Basis& frame_basis(int index) const { return frames_[index].basis; }
  const Vec3f& unbent_normal(int index) const { return frames_[index].unbent; }
  int root_frame(int index) const {
    while (frames_[index].parent >= 0) index = frames_[index].parent;
    return index;
  }

 private:
  struct Entry {
    Lobe lobe;
    float probability, weight;
    std::uint8_t frame;
    std::int8_t layer;
  };
  struct Frame {
    Basis basis;
    Vec3f unbent;         ///< normal that basis.n was bent from
    float n_ng;           ///< cosine between basis.n and the horizon's normal; 0: light does not fade at the horizon
    float shadow_alpha2;  ///< roughness of the bump shadowing term
    float orientation;    ///< -1 if the normal was turned over against the parent's
    std::int8_t parent;   ///< -1: not perturbed
    bool attenuates;      ///< frame_factor is not always 1
  };
  Frame made_frame(const Basis& basis, const Vec3f& unbent) const;
  int unbent_frame(int index);
  float frame_factor(const Frame& frame, const Vec3f& wi, float roughness) const;
  float layer_factor(int layer, const Vec3f& wo, const Vec3f& wi) const;
  /// Its mean over directions that a diffuse lobe of frame `basis` scatters to.
  float mean_layer_factor(int layer, const Vec3f& wo, const Basis& basis) const;
  template <class L>
  void accumulate(const L& lobe, const Entry& entry, const Vec3f& wo, const Vec3f& wi, const Vec3f& local_wo,
                  const Vec3f& local_wi, BsdfEval& out) const;
  void accumulate_all(const Vec3f& wo, const Vec3f& wi, int skip, BsdfEval& out) const;
  /// Sum of the probabilities of the near-specular lobes that are no deltas.
  float near_specular_probability() const;

  FixedStack<Entry, kMaxLobes> lobes_;
  FixedStack<Frame, 2 * kMaxFrames> frames_;  // each may have an unbent twin
  FixedStack<BsdfLayer, kMaxLayers> layers_;
  float total_probability_ = 0;
  bool has_non_delta_ = false;
  bool has_horizon_ = false;
  Vec3f horizon_;
};

}  // namespace tempera
