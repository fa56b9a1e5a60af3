// SPDX-License-Identifier: Apache-2.0
#pragma once
// One path from the camera, with next-event estimation, multiple importance sampling and light-path classes: the part
// that the integrators of camera paths share. An observer may follow the path vertex by vertex (gradient-domain
// rendering shifts it to the neighbouring pixels); without one nothing of it is compiled in.
//
//   throughput  beta: product of f |cos| / pdf over the vertices so far
//   edges       number of path edges so far; a path to a light over n surfaces has n + 1
//   w           multiple importance sampling weight, power heuristic [Veach 1997, Eq. 9.13]
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <new>
#include <span>

#include "tempera/core/params.h"
#include "tempera/paths/weighted_states.h"
#include "tempera/transport/chain_features.h"
#include "tempera/transport/frame_context.h"

namespace tempera {

constexpr int kMaxVertices = 4096;     // surfaces visited by one path, passed masks included: ends endless light traps
constexpr float kMaxContinue = 0.95f;  // survival probability of Russian roulette, at most

inline float power_heuristic(float a, float b) {
  const float a2 = a * a, b2 = b * b;
  return a2 > 0 ? (std::isinf(a2) ? 1.0f : a2 / (a2 + b2)) : 0.0f;
}

/// How paths are limited.
struct PathOptions {
  int max_depth = kMaxVertices;
  int rr_depth = 5;
  float clamp = 0;
  bool hide_emitters = false;
  bool null_counts = false;

  /// The parameters that set these, for tables of integrators.
  static const std::vector<ParamSpec>& params();
  /// From parameters with those specifications.
  explicit PathOptions(const Params& p);
};

/// Which features of the first surface a film asks for; the albedo costs more than the others together.
enum class Features : std::uint8_t { kNone, kGeometry, kAll };

/// What the first surface of a camera ray contributes to feature layers.
struct FirstHit {
  bool valid = false;
  Rgb albedo, emission;
  Vec3f normal, position;
  Vec2f uv;
  float depth = 0;
  std::uint32_t instance = 0;
};

/// One sample of a pixel.
struct SampleResult {
  Rgb radiance;
  Rgb gathered;  ///< the part of it that GatheredLight found on the first surface
  float alpha = 0;
  FirstHit first;
  std::uint32_t rays = 0, shadow_rays = 0;
};

/// The random numbers, filter weight, time and camera ray of one sample.
struct CameraSample {
  SampleStream stream;
  float weight;
  double time;
  Vec2f film, lens;
  CameraRay ray;
  int index = 0;  ///< among the samples of its pixel
};
inline PixelKey own_key(const FrameContext& context, int x, int y) {
  return own_key(context.settings, context.frame, x, y);
}
/// Sample `index` of pixel (x, y) of the frame with the numbers of `key`.
CameraSample camera_sample(const FrameContext& context, const PixelKey& key, int x, int y, int index);
inline CameraSample camera_sample(const FrameContext& context, int x, int y, int index) {
  return camera_sample(context, own_key(context, x, y), x, y, index);
}

/// A point where a path meets a surface. `bsdf` is empty until the path needs it.
struct Vertex {
  Hit hit;
  ShadingPoint s;
  const Shape* shape = nullptr;
  Bsdf bsdf;
  const Material& material() const { return *shape->material; }
  void make_bsdf() { tempera::make_bsdf(material(), s, bsdf); }
};

/// The albedo of vertex `index`, where its features have it.
inline const Rgb* known_albedo(std::uint32_t index, Features features, const SampleResult& result) {
  return index == 0 && features == Features::kAll ? &result.first.albedo : nullptr;
}

/// The features of the first surface.
inline FirstHit first_hit(const Vertex& v, const Rgb& emitted, const CameraSample& camera, Features features) {
  FirstHit f;
  f.valid = true;
  f.instance = v.hit.point.instance;
  // Normals that are bent where they face away belong to the side of the surface that is seen.
  f.normal = dot(v.s.bends ? v.s.ng : v.s.frame.n, v.s.wo) < 0 ? -v.s.frame.n : v.s.frame.n;
  f.position = v.s.p;
  f.uv = v.s.uv;
  f.emission = emitted;
  f.depth = dot(v.s.p - camera.ray.o, camera.ray.axis);
  if (features == Features::kAll) f.albedo = v.bsdf.albedo(v.s.wo);
  return f;
}

/// Sets the texture footprint of a point that the camera sees: how far apart on the tangent plane the rays of
/// neighbouring samples arrive, taking samples for evenly spread over the pixel [Igehy 1999; Pharr 2023, Sec. 10.1].
void set_footprint(const FrameContext& context, const CameraSample& camera, const SurfacePoint& point, ShadingPoint& s);

/// Fraction of light that reaches along `ray` through surfaces with opacity below 1; at most `edges_left` of them if
/// masks count as edges.
float transmittance(const FrameContext& context, Ray ray, int edges_left);

/// Fraction of light that gets from `s` in unit direction `wi` to what is `distance` away (infinity: out of the scene).
TEMPERA_INLINE float visibility(const FrameContext& context, const ShadingPoint& s, const Vec3f& wi, float distance,
                                int edges_left = kMaxVertices) {
  Ray shadow{context.rays.offset_origin(s.p, s.ng, wi), wi, 0, kInfinity, s.time};
  if (std::isfinite(distance)) {  // from where the ray really starts to just before its target
    const Vec3f to_target = s.p + wi * distance - shadow.o;
    const float d = length(to_target);
    shadow.d = to_target * (1 / d);
    shadow.tmax = d * (1 - 1e-4f);
  }
  if (context.rays.has_opacity()) return transmittance(context, shadow, edges_left);
  return context.rays.occluded(shadow) ? 0.0f : 1.0f;
}

/// The number that decides whether a ray towards vertex `index` passes the k-th mask on its way: functions of these two
/// alone, so that masks do not shift what other numbers mean.
inline float mask_number(const SampleStream& stream, std::uint32_t index, int k) {
  const float u = stream.vertex(index).opacity;
  return k == 0 ? u : to_unit_float(std::uint32_t(mix64(std::bit_cast<std::uint32_t>(u) + (std::uint64_t(k) << 32))));
}

/// Moves the origin of `ray` past the surface that it meets at `point`.
void pass_unseen(const FrameContext& context, Ray& ray, const SurfacePoint& point);

/// What `ray` meets first; the origin moves past what the camera does not see, for rays that come straight from there.
inline bool intersect_seen(const FrameContext& context, bool from_camera, Ray& ray, Hit& hit) {
  for (int i = 0; context.rays.intersect(ray, hit); ++i) {
    if (!from_camera || context.scene.instances[hit.point.instance].camera_visible) return true;
    if (i == kMaxVertices) return false;
    pass_unseen(context, ray, hit.point);
  }
  return false;
}

enum class EdgeEnd { kSurface, kEnvironment, kLost };

/// Follows `ray` to the surface that stops it, vertex `index` of the path. `passed` counts the masks on the way,
/// `pass_probability` is the probability of passing them. `camera`: set for rays that come straight from there.
TEMPERA_INLINE EdgeEnd follow(const FrameContext& context, const SampleStream& stream, std::uint32_t index, Ray& ray,
                              const CameraSample* camera, Vertex& v, int& passed, float& pass_probability) {
  passed = 0, pass_probability = 1;
  for (; passed < kMaxVertices; ++passed) {
    if (!intersect_seen(context, camera, ray, v.hit)) return EdgeEnd::kEnvironment;
    new (&v.s) ShadingPoint(context.rays.shading_point(v.hit.point, ray.time, -ray.d));  // made in place, not copied
    v.shape = &context.rays.shape(v.hit.point);
    if (camera && v.material().needs_footprint()) set_footprint(context, *camera, v.hit.point, v.s);
    if (!context.rays.has_opacity() || !v.material().has_opacity()) return EdgeEnd::kSurface;
    const float opacity = v.material().opacity(v.s);
    if (opacity >= 1 || mask_number(stream, index, passed) < opacity) return EdgeEnd::kSurface;
    pass_probability *= 1 - opacity;  // no event: the path goes on as if nothing were there
    ray.o = context.rays.offset_origin(v.s.p, v.s.ng, ray.d);
    ray.tmin = 0;
    ray.tmax = kInfinity;
  }
  return EdgeEnd::kLost;
}

/// What is left of light after the edge of length `d` that arrives at `v`, if it ran inside of an absorbing body.
inline Rgb absorption(const Vertex& v, float d) {
  if (!v.material().has_absorption() || dot(v.s.ng, v.s.wo) >= 0) return Rgb(1.0f);
  return exp(v.material().absorption(v.s) * -d);
}

/// Whether light goes straight on through a thin sheet: the P of expressions.
inline bool is_passage(const BsdfSample& s) { return s.delta && s.transmitted && s.eta == 1; }

/// What a delta lobe with shading normal n multiplies flux by that arrives from wl, beside the lobe's coefficient and over
/// the cosine of arrival with the geometric normal ng: flux is conserved where radiance is compressed by refraction
/// [Veach 1997, Sec. 5.2]; a shading normal changes it [Veach 1997, Sec. 5.3].
inline float delta_flux_factor(const Vec3f& n, const Vec3f& ng, const Vec3f& wl, const BsdfSample& s) {
  const float eta2 = s.transmitted ? s.eta * s.eta : 1.0f;
  return eta2 * std::abs(dot(n, wl) * dot(ng, s.wi)) / std::max(std::abs(dot(n, s.wi)), 1e-7f);
}

/// Light of a class of paths that something else than the path tracer finds, as photons find caustics.
class GatheredLight {
 public:
  /// Light that arrives at a surface.
  struct Arrival {
    Vec3f wi;        ///< unit, towards where it comes from
    Rgb irradiance;  ///< on the surface as it is, W/m^2
    /// State of the classifier at the path's end by the state before its last vertex but this surface.
    std::span<const LightPathClassifier::State> ends;
  };
  virtual ~GatheredLight() = default;
  /// Bits of the classifier's classes, those of the paths that it stands for.
  virtual std::uint32_t classes() const = 0;
  /// From which lights, by their index (LightSample::light): it stands for those alone.
  virtual std::span<const char> lights(double time) const = 0;
  /// What arrives at a vertex that scatters by D, as the sample of that number of a pixel sees it, by paths from lights of
  /// at most `most_edges`. `coarse`: the eye sees the surface in a diffuse reflection, if at all. The span is valid until
  /// the same thread asks again. Threads: re-entrant.
  virtual std::span<const Arrival> arriving(const Vertex& at, double time, int sample, bool coarse,
                                            int most_edges) const = 0;
};

/// Radiance that a vertex scatters by D of what arrives there.
inline Rgb scattered(const Vertex& v, const GatheredLight::Arrival& a) {
  // Irradiance is by the geometric normal, f_cos by those of the lobes.
  const Rgb f = v.bsdf.eval(v.s.wo, a.wi).f_cos[std::size_t(Event::kDiffuse)];
  const float cosine = std::abs(dot(v.s.ng, a.wi));
  return cosine > 0 ? f * a.irradiance * (1 / cosine) : Rgb(0.0f);
}

/// Collects radiance: the total, and the share of each class (the last entry: paths of no class).
struct Tally {
  const LightPathClassifier& classifier;
  std::span<Rgb> classes;
  Rgb total;
  float clamp = 0;
  std::uint32_t without = 0;  ///< classes of paths that are left out, of the lights that `owned` is for
  /// Light that arrives along a path; `scattered`: whether surfaces lie between, else it is not clamped.
  void add(const WeightedStates& states, Rgb c, bool scattered) {
    if (scattered) limit(c);
    total += c;
    if (!classes.empty()) states.add_to(classifier, c, classes);
  }
  /// Light that the last vertex scatters towards the eye; `f` by event.
  void add(const WeightedStates& states, Rgb c, const std::array<Rgb, kEventCount>& f) {
    limit(c);
    total += c;
    if (!classes.empty()) states.add_to(classifier, c, f, classes);
  }
  /// The same where some paths are left out; `owned`: which part of the light comes from lights whose paths may be.
  [[gnu::noinline]] void add_others(const WeightedStates& states, Rgb c, bool scattered, const Rgb& owned) {
    if (scattered) limit(c);
    total += states.add_to(classifier, c * owned, classes, without);
    total += states.add_to(classifier, c * (Rgb(1.0f) - owned), classes);
  }
  [[gnu::noinline]] void add_others(const WeightedStates& states, Rgb c, const std::array<Rgb, kEventCount>& f,
                                    const Rgb& owned) {
    limit(c);
    total += states.add_to(classifier, c * owned, f, classes, without);
    total += states.add_to(classifier, c * (Rgb(1.0f) - owned), f, classes);
  }
  /// Light of the classes that are left out, which arrives at a vertex whose throughput is `beta`, seen from v.s.wo.
  /// Returns what it adds.
  [[gnu::noinline]] Rgb add_gathered(const WeightedStates& states, const Rgb& beta, const Vertex& v,
                                     std::span<const GatheredLight::Arrival> arrivals) {
    Rgb sum;
    for (const GatheredLight::Arrival& a : arrivals) {
      const Rgb c = beta * scattered(v, a);
      if (is_black(c)) continue;
      sum += c;
      states.add_joined(classifier, c, without, classes, [&](LightPathClassifier::State s) { return a.ends[s]; });
    }
    total += sum;
    return sum;
  }

 private:
  void limit(Rgb& c) const {
    if (!(clamp > 0)) return;
    const float l = luminance(c);
    if (l > clamp) c *= clamp / l;
  }
};

/// Part of the light from infinity along `d` that comes from `lights`.
inline Rgb owned_part(const LightSampler& sampler, const Vec3f& d, double time, bool from_camera,
                      std::span<const char> lights, const Rgb& all) {
  const Rgb owned = sampler.environment(d, time, from_camera, lights);
  const auto part = [](float a, float b) { return b > 0 ? std::min(a / b, 1.0f) : 0.0f; };
  return {part(owned.r, all.r), part(owned.g, all.g), part(owned.b, all.b)};
}

/// The edge that a path has just been extended by, for observers.
struct Extension {
  const Vertex& from;
  const BsdfSample& sample;  ///< at `from`
  Rgb step;                  ///< f |cos| / (pdf q): what the throughput was multiplied by
  float survival;            ///< q of Russian roulette at `from`; 1 before it starts
  bool roulette;             ///< whether it had started
  const Vertex* to;          ///< null: the environment
  Rgb emitted;               ///< radiance that `to` sends back
  float light_pdf;           ///< with which next-event estimation at `from` would have found `to`; 0: it could not
  float pass_probability;    ///< probability of passing the masks on the way
  std::uint32_t index;       ///< of `to` in the path
  const Rgb& gathered;       ///< radiance that the path had found before it arrived at `to`
};

/// Sees nothing. An active observer has these functions.
struct NoObserver {
  static constexpr bool kActive = false;
  /// The camera ray arrived at `first` (null: in the environment), which sends `emitted`.
  void start(const Vertex* /*first*/, const Rgb& /*emitted*/) {}
  /// Light was sampled at a vertex: f with its density, and the fraction that gets there. Radiance and f may be black.
  void next_event(const Vertex& /*at*/, const LightSample& /*light*/, const BsdfEval& /*f*/, float /*visible*/) {}
  void extend(const Extension& /*edge*/) {}
  /// Light of a GatheredLight arrived at a vertex, the first one of the path or another, which sends the radiance `found`
  /// along the path; it was asked for with `coarse` and `most_edges`.
  void gather(const Vertex& /*at*/, std::span<const GatheredLight::Arrival> /*arrivals*/, const Rgb& /*found*/,
              bool /*first*/, bool /*coarse*/, int /*most_edges*/) {}
};

/// Traces one path. `classes`: empty, or one entry for each class and one for paths of none. `chains`: null, or what
/// gathers features of chains. `gathered_light`: null, or what finds the light of some classes instead of this path.
template <class Observer>
SampleResult trace_path(const FrameContext& context, const PathOptions& options, const CameraSample& camera,
                        std::span<Rgb> classes, Features features, Observer& observer, ChainFeatures* chains = nullptr,
                        const GatheredLight* gathered_light = nullptr) {
  const RayScene& rays = context.rays;
  const LightSampler& lights = context.lights;
  const LightPathClassifier& classifier = context.classifier;
  SampleResult result;
  Tally tally{classifier, classes, {}, options.clamp, gathered_light ? gathered_light->classes() : 0};
  const bool by_class = !classes.empty() || gathered_light;
  const std::span<const char> owned_lights =
      gathered_light ? gathered_light->lights(camera.time) : std::span<const char>{};
  const auto owned = [&](std::uint32_t light) { return Rgb(owned_lights[light] ? 1.0f : 0.0f); };

  const double time = camera.time;
  Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, time};
  Rgb beta(1.0f);
  float beta_roulette = 1;  // throughput without absorption
  float eta_product = 1;    // radiance scaling by refraction, taken out of roulette's decision
  WeightedStates states;
  if (by_class) states.start(classifier, camera.stream.hash());
  if (chains) chains->start();
  float bsdf_pdf = 0;  // density of ray.d at the previous vertex
  bool mis = false;    // whether next-event estimation could have found what this ray finds
  Vec3f previous = ray.o;
  bool seen_by_camera = true;
  bool blurred = false;  // whether the path has been scattered by D
  int edges = 1;

  // An observer looks at both ends of an edge.
  constexpr std::size_t kKept = Observer::kActive ? 2 : 1;
  std::array<Vertex, kKept> vertices;
  BsdfSample sampled;
  Rgb step, gathered;
  float survival = 1;
  const auto observe = [&](std::uint32_t index, const Vertex* to, const Rgb& emitted, float light_pdf,
                           float pass_probability) {
    if constexpr (Observer::kActive) {
      if (index == 0) {
        observer.start(to, emitted);
      } else {
        observer.extend({vertices[(index - 1) % kKept], sampled, step, survival, edges > options.rr_depth, to, emitted,
                         light_pdf, pass_probability, index, gathered});
      }
    }
  };

  for (std::uint32_t index = 0; edges <= options.max_depth; ++index) {
    Vertex& v = vertices[index % kKept];
    if constexpr (Observer::kActive) gathered = tally.total;
    int passed = 0;
    float pass_probability = 1;
    const EdgeEnd end =
        follow(context, camera.stream, index, ray, seen_by_camera ? &camera : nullptr, v, passed, pass_probability);
    result.rays += std::uint32_t(passed) + 1;
    if (end == EdgeEnd::kLost) break;
    if (options.null_counts && (edges += passed) > options.max_depth) break;
    if (end == EdgeEnd::kEnvironment) {
      Rgb le;
      float light_pdf = 0;
      if (lights.has_environment() && !(options.hide_emitters && seen_by_camera)) {
        le = lights.environment(ray.d, time, seen_by_camera);
        if (!is_black(le)) {
          if (mis) light_pdf = lights.environment_pdf(ray.d, time, previous);
          const Rgb c = beta * le * (mis ? power_heuristic(bsdf_pdf, light_pdf) : 1.0f);
          if (gathered_light) {
            tally.add_others(states, c, edges > 1, owned_part(lights, ray.d, time, seen_by_camera, owned_lights, le));
          } else {
            tally.add(states, c, edges > 1);
          }
        }
      }
      observe(index, nullptr, le, light_pdf, pass_probability);
      if (chains && chains->active()) chains->leave(beta);
      break;
    }
    if (v.material().has_absorption()) beta *= absorption(v, length(v.s.p - previous));

    Rgb emitted;
    float light_pdf = 0;
    if (v.shape->emission) {
      if (!(options.hide_emitters && seen_by_camera)) emitted = lights.emitted(v.hit.point, v.s);
      if (mis && (Observer::kActive || !is_black(emitted))) {
        light_pdf = lights.pdf(v.hit.point, v.s, previous, length(v.s.p - previous));
      }
      if (!is_black(emitted)) {
        const Rgb c = beta * emitted * (mis ? power_heuristic(bsdf_pdf, light_pdf) : 1.0f);
        if (gathered_light) {
          tally.add_others(states, c, edges > 1, owned(lights.light_of(v.hit.point)));
        } else {
          tally.add(states, c, edges > 1);
        }
      }
    }

    v.make_bsdf();
    if (seen_by_camera) {
      seen_by_camera = false;
      result.alpha = 1;
      if (features != Features::kNone) {
        result.first = first_hit(v, emitted, camera, features);
      }
    }
    if (chains && chains->active()) chains->arrive(beta, v, emitted, previous, known_albedo(index, features, result));
    observe(index, &v, emitted, light_pdf, pass_probability);
    if (edges >= options.max_depth || v.bsdf.empty()) break;
    const VertexNumbers u = camera.stream.vertex(index);
    if (gathered_light && v.bsdf.has_non_delta()) {
      const auto arrivals = gathered_light->arriving(v, time, camera.index, blurred, options.max_depth - edges);
      const Rgb found = tally.add_gathered(states, beta, v, arrivals);
      if (index == 0) result.gathered = found;
      observer.gather(v, arrivals, found, index == 0, blurred, options.max_depth - edges);
    }

    // Next-event estimation. Each event's share goes to the class that it leads to. [Zimmer 2015, Sec. 3]
    const bool next_event = v.bsdf.has_non_delta() && !lights.empty();
    if (next_event) {
      const auto light = lights.sample(v.s.p, time, u.light_choice, u.light_point);
      const bool shines = light && !is_black(light->radiance);
      if (Observer::kActive ? light.has_value() : shines) {
        const BsdfEval f = v.bsdf.eval(v.s.wo, light->wi);
        const Rgb f_sum = f.sum();
        const bool carries = shines && !is_black(f_sum);
        if (Observer::kActive || carries) {
          ++result.shadow_rays;
          const float visible = visibility(context, v.s, light->wi, light->distance,
                                           options.null_counts ? options.max_depth - edges - 1 : kMaxVertices);
          if (visible > 0 && carries) {
            const float w = light->delta ? 1.0f : power_heuristic(light->pdf, f.pdf);
            const Rgb le = beta * light->radiance * (visible * w / light->pdf);
            if (gathered_light) {
              const bool one = std::isfinite(light->distance) || light->delta;  // not all that shines from there
              tally.add_others(states, le * f_sum, f.f_cos,
                               one ? owned(light->light)
                                   : owned_part(lights, light->wi, time, false, owned_lights, light->radiance));
            } else {
              tally.add(states, le * f_sum, f.f_cos);
            }
          }
          observer.next_event(v, *light, f, visible);
        }
      }
    }

    const auto sample = v.bsdf.sample(v.s.wo, u.lobe, u.direction);
    if (!sample) break;
    const Rgb total = sample->sum();
    if (is_black(total)) break;
    const float inv_pdf = 1 / sample->pdf;
    const float eta2 = sample->transmitted ? sample->eta * sample->eta : 1.0f;
    beta_roulette *= max_component(total) * inv_pdf;
    eta_product *= eta2;
    beta *= total * inv_pdf;
    blurred |= sample->event == Event::kDiffuse;
    if (by_class) states.scatter(classifier, sample->f_cos, is_passage(*sample));
    if (chains && chains->active()) chains->scatter(sample->f_cos);
    mis = !sample->delta && next_event;
    bsdf_pdf = sample->pdf;
    previous = v.s.p;
    ray.o = rays.offset_origin(v.s.p, v.s.ng, sample->wi);
    ray.d = sample->wi;
    ray.tmin = 0;
    ray.tmax = kInfinity;
    ++edges;

    survival = 1;
    if (edges > options.rr_depth) {
      survival = std::min(beta_roulette * eta_product, kMaxContinue);
      if (!(u.roulette < survival)) break;
      beta *= 1 / survival;
      beta_roulette /= survival;
    }
    if constexpr (Observer::kActive) {
      sampled = *sample;
      step = total * (inv_pdf / survival);
    }
  }
  result.radiance = tally.total;
  return result;
}

/// Follows a path as trace_path does, for its features alone: as far as specular events of chains lead.
SampleResult trace_features(const FrameContext& context, const PathOptions& options, const CameraSample& camera,
                            Features features, ChainFeatures* chains);

}  // namespace tempera
