// SPDX-License-Identifier: Apache-2.0
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
#include <fmt/format.h>

#include "path_tracer.h"
#include "shift_mapping.h"
#include "tile_film.h"

namespace tempera {

namespace {

const std::vector<ParamSpec>& params() {
  static const std::vector<ParamSpec> specs = [] {
    std::vector<ParamSpec> s = PathOptions::params();
    s.push_back({"roughness_threshold", 0.001,
                 "paths of neighbouring pixels are connected at surfaces that are rougher (alpha)", 0, 1});
    return s;
  }();
  return specs;
}

enum class Neighbour { kRight, kDown, kLeft, kUp };
constexpr std::array<Vec2f, 4> kSteps{Vec2f{1, 0}, Vec2f{0, 1}, Vec2f{-1, 0}, Vec2f{0, -1}};
constexpr std::array<const char*, 4> kSides{"grad.right", "grad.down", "grad.left", "grad.up"};

/// One shifted path, built along with the base path.
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
};

/// Shifts a base path to the neighbouring pixels as it grows.
class ShiftObserver {
 public:
  static constexpr bool kActive = true;
  ShiftObserver(const FrameContext& context, const PathOptions& options, float threshold, const CameraSample& camera,
                std::array<bool, 4> inside)
      : context_(context), options_(options), threshold_(threshold), camera_(camera) {
    for (std::size_t j = 0; j < 4; ++j) offsets_[j].state = inside[j] ? OffsetPath::kFree : OffsetPath::kOutside;
  }
  const Rgb& g(std::size_t j) const { return offsets_[j].g; }
  std::uint64_t rays() const { return rays_; }

  void start(const Vertex* first, const Rgb& emitted);
  void next_event(const Vertex& at, const LightSample& light, const BsdfEval& f, float visible);
  void extend(const Extension& edge);

 private:
  /// Diffuse enough to connect to; `delta`: whether the path takes a delta lobe there.
  bool connects(const Vertex& v, bool delta) const { return !delta && v.bsdf.least_roughness() > threshold_; }
  /// The end of an edge: lights and the environment always can be connected to.
  bool connects_to(const Vertex* v) const { return !v || v->shape->emission || connects(*v, false); }
  bool samples_lights(const Bsdf& bsdf) const { return bsdf.has_non_delta() && !context_.lights.empty(); }
  void extend_shared(const Extension& e, const Rgb& base, float base_weight, OffsetPath& o) const;
  void reconnect(const Extension& e, const Rgb& base, float base_weight, OffsetPath& o);
  void copy_half_vector(const Extension& e, const Rgb& base, OffsetPath& o);
  /// Scattering of an offset path: its share of throughput, density and roulette.
  static void scatter(const Extension& e, const Rgb& f, float pdf, float jacobian, float eta, OffsetPath& o);

  const FrameContext& context_;
  const PathOptions& options_;
  float threshold_;
  const CameraSample& camera_;
  Rgb beta_{1.0f};  ///< of the base path
  std::array<OffsetPath, 4> offsets_;
  std::uint64_t rays_ = 0;
};

void ShiftObserver::start(const Vertex* first, const Rgb& emitted) {
  if (first) beta_ = absorption(*first, length(first->s.p - camera_.ray.o));
  for (std::size_t j = 0; j < 4; ++j) {
    OffsetPath& o = offsets_[j];
    if (o.state == OffsetPath::kOutside) continue;
    CameraSample camera = camera_;
    camera.film = camera_.film + kSteps[j];
    camera.ray = context_.camera.ray(camera.film, camera.lens, camera.time);
    Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, camera.time};
    int passed = 0;
    float clear = 1;
    const EdgeEnd end = follow(context_, camera_.stream, 0, ray, &camera, o.vertex, passed, clear);
    rays_ += std::uint64_t(passed) + 1;
    Rgb offset_emitted;
    if (end == EdgeEnd::kEnvironment) {
      if (!options_.hide_emitters) offset_emitted = context_.lights.environment(ray.d, ray.time, true);
    } else if (end == EdgeEnd::kSurface) {
      o.beta *= absorption(o.vertex, length(o.vertex.s.p - camera.ray.o));
      if (!options_.hide_emitters) offset_emitted = o.beta * context_.lights.emitted(o.vertex.point, o.vertex.s);
    }
    // What the camera sees directly is a path of one edge, and every such path shifts to every other.
    o.g += (offset_emitted - beta_ * emitted) * 0.5f;
    if (!first || end != EdgeEnd::kSurface) {
      o.state = OffsetPath::kDead;
    } else {
      o.vertex.make_bsdf();
    }
  }
}

void ShiftObserver::next_event(const Vertex& at, const LightSample& light, const BsdfEval& f, float visible) {
  const float pl2 = sqr(light.pdf);
  if (!(pl2 > 0)) return;
  const Rgb f_sum = f.sum();
  const Rgb le = light.radiance * (visible / light.pdf);
  const Rgb base = beta_ * f_sum * le;
  const auto density = [&](const Rgb& value, float pdf, float v) {  // nothing is sampled where nothing is carried
    return v > 0 && !light.delta && !is_black(value) ? sqr(pdf) : 0.0f;
  };
  const float pb2 = density(f_sum, f.pdf, visible);
  const bool base_connects = connects(at, false);
  for (OffsetPath& o : offsets_) {
    Rgb offset;
    float others = 0;  // squared densities of the offset's own ways to sample the pair, over pl2
    switch (o.state) {
      case OffsetPath::kOutside:
        continue;
      case OffsetPath::kDead:
        break;
      case OffsetPath::kJoined:
        offset = o.beta * f_sum * le;
        others = sqr(o.rho) * (pl2 + pb2);
        break;
      case OffsetPath::kFresh: {
        if (!samples_lights(o.vertex.bsdf)) break;
        const BsdfEval f_offset = o.vertex.bsdf.eval(o.vertex.s.wo, light.wi);
        const Rgb value = f_offset.sum();
        offset = o.beta * value * le;
        others = sqr(o.rho) * (pl2 + density(value, f_offset.pdf, visible));
        break;
      }
      case OffsetPath::kFree: {
        // Where the base path copies half vectors its BSDF samples alone are compared.
        if (!light.delta && !(base_connects && connects(o.vertex, false))) continue;
        if (!samples_lights(o.vertex.bsdf)) break;
        const ShadingPoint& s = o.vertex.s;
        const auto there = context_.lights.connect(light, s.p, camera_.time);
        if (!there) break;
        const BsdfEval f_offset = o.vertex.bsdf.eval(s.wo, there->wi);
        const Rgb value = f_offset.sum();
        ++rays_;
        const float v = visibility(context_, s, there->wi, there->distance);
        float jacobian = 1;
        if (light.point) {
          Vec3f ng;
          const Vec3f y = context_.rays.position(*light.point, camera_.time, &ng);
          jacobian = reconnection_jacobian(at.s.p, s.p, y, ng);
        }
        offset = o.beta * value * there->radiance * (jacobian * v / light.pdf);
        others = sqr(o.rho * jacobian) * (sqr(there->pdf) + density(value, f_offset.pdf, v));
        break;
      }
    }
    o.g += (offset - base) * (pl2 / (pl2 + pb2 + others));
  }
}

void ShiftObserver::scatter(const Extension& e, const Rgb& f, float pdf, float jacobian, float eta, OffsetPath& o) {
  o.beta *= f * (jacobian / (e.sample.pdf * e.survival));
  o.rho *= jacobian * pdf / e.sample.pdf;
  o.roulette *= max_component(f) / pdf;
  o.eta2 *= eta * eta;
}

void ShiftObserver::extend(const Extension& e) {
  beta_ *= e.step;
  if (e.to) beta_ *= absorption(*e.to, length(e.to->s.p - e.from.s.p));
  const Rgb base = beta_ * e.emitted;
  const float base_weight = 1 + sqr(e.light_pdf / e.sample.pdf);  // (pB^2 + pL^2) / pB^2
  for (OffsetPath& o : offsets_) {
    if (o.state == OffsetPath::kOutside) continue;
    if (o.state == OffsetPath::kDead) {
      o.g -= base * (1 / base_weight);
      continue;
    }
    if (o.state != OffsetPath::kFree) {
      extend_shared(e, base, base_weight, o);
    } else if (connects(e.from, e.sample.delta) && connects(o.vertex, false) && connects_to(e.to)) {
      reconnect(e, base, base_weight, o);
    } else {
      copy_half_vector(e, base, o);
    }
    if (o.state != OffsetPath::kDead && e.roulette) {
      // Each of the two paths survives with its own probability.
      const float q = std::min(o.roulette * o.eta2, kMaxContinue);
      o.rho *= q / e.survival;
      o.roulette /= q;
    }
  }
}

/// The offset path shares the vertex from which the base path goes on.
void ShiftObserver::extend_shared(const Extension& e, const Rgb& base, float base_weight, OffsetPath& o) const {
  const float pb = e.sample.pdf, pl = e.light_pdf;
  const Rgb arriving = e.to ? absorption(*e.to, length(e.to->s.p - e.from.s.p)) : Rgb(1.0f);
  const float eta = e.sample.transmitted ? e.sample.eta : 1.0f;
  Rgb f = e.sample.sum();
  float pdf = pb, others = 0;
  if (o.state == OffsetPath::kJoined) {
    others = sqr(o.rho) * base_weight;
  } else {
    const BsdfEval f_offset = e.sample.delta ? BsdfEval{} : o.vertex.bsdf.eval(o.vertex.s.wo, e.sample.wi);
    f = f_offset.sum();
    pdf = is_black(f) ? 0.0f : f_offset.pdf;
    others = sqr(o.rho) * (sqr(pdf) + (samples_lights(o.vertex.bsdf) ? sqr(pl) : 0.0f)) / sqr(pb);
  }
  if (!(pdf > 0)) {
    o.g -= base * (1 / (base_weight + others));
    o.state = OffsetPath::kDead;
    return;
  }
  scatter(e, f, pdf, 1, eta, o);
  o.beta *= arriving;
  o.g += (o.beta * e.emitted - base) * (1 / (base_weight + others));
  o.state = OffsetPath::kJoined;
}

/// The offset path goes to the base path's next vertex.
void ShiftObserver::reconnect(const Extension& e, const Rgb& base, float base_weight, OffsetPath& o) {
  const ShadingPoint& s = o.vertex.s;
  Vec3f wi = e.sample.wi;
  float distance = kInfinity, jacobian = 1, light_pdf = 0;
  Rgb emitted = e.emitted, arriving(1.0f);
  const bool lights = samples_lights(o.vertex.bsdf) && e.light_pdf > 0;
  Vertex end;
  if (e.to) {
    const Vec3f d = e.to->s.p - s.p;
    distance = length(d);
    if (!(distance > 0)) {
      o.g -= base * (1 / base_weight);
      o.state = OffsetPath::kDead;
      return;
    }
    wi = d * (1 / distance);
    jacobian = reconnection_jacobian(e.from.s.p, s.p, e.to->s.p, e.to->s.ng);
    end.point = e.to->point;
    end.shape = e.to->shape;
    end.s = e.to->s;
    end.s.wo = -wi;
    arriving = absorption(end, distance);
    emitted = e.to->shape->emission ? context_.lights.emitted(end.point, end.s) : Rgb(0.0f);
    if (lights) light_pdf = context_.lights.pdf(end.point, end.s, s.p, distance);
  } else if (lights) {
    light_pdf = context_.lights.environment_pdf(wi, camera_.time, s.p);
  }
  const BsdfEval f = o.vertex.bsdf.eval(s.wo, wi);
  const Rgb value = f.sum();
  float visible = 0;
  if (!is_black(value) && jacobian > 0) {
    ++rays_;
    visible = visibility(context_, s, wi, distance);
  }
  const float pdf = visible > 0 ? f.pdf : 0.0f;
  // An emitter that is occluded from the offset path is still what its next-event estimation would try.
  const float others = sqr(o.rho * jacobian / e.sample.pdf) * (sqr(pdf) + sqr(light_pdf));
  if (!(pdf > 0)) {
    o.g -= base * (1 / (base_weight + others));
    o.state = OffsetPath::kDead;
    return;
  }
  const float eta = dot(wi, s.frame.n) * dot(s.wo, s.frame.n) < 0 ? std::max(o.vertex.bsdf.rough_eta(s.wo), 1e-6f) : 1;
  scatter(e, value, pdf, jacobian, eta, o);
  o.beta *= arriving * (visible / e.clear);
  o.g += (o.beta * emitted - base) * (1 / (base_weight + others));
  if (!e.to) {
    o.state = OffsetPath::kDead;
    return;
  }
  o.vertex.point = end.point;
  o.vertex.shape = end.shape;
  o.vertex.s = end.s;
  o.vertex.make_bsdf();
  o.state = OffsetPath::kFresh;
}

/// The offset path scatters about the same local half vector and finds its own next vertex.
void ShiftObserver::copy_half_vector(const Extension& e, const Rgb& base, OffsetPath& o) {
  const auto fail = [&] {
    o.g -= base;
    o.state = OffsetPath::kDead;
  };
  const ShadingPoint& s = o.vertex.s;
  const Bsdf& bsdf = o.vertex.bsdf;
  const BsdfSample& sample = e.sample;
  Vec3f wi;
  Rgb f;
  float pdf = 0, jacobian = 1, eta = 1;
  if (sample.delta) {
    // The same lobe of the same kind; the lobes of different materials have no common numbering.
    const int i = sample.lobe;
    if (i >= bsdf.size() || bsdf.lobe(i).index() != e.from.bsdf.lobe(i).index()) return fail();
    const auto there = bsdf.sample_delta(i, s.wo);
    if (!there || there->transmitted != sample.transmitted) return fail();
    wi = there->wi;
    f = there->sum();
    pdf = there->pdf;
    eta = there->transmitted ? there->eta : 1;
  } else {
    const ShadingPoint& x = e.from.s;
    const Vec3f wo = x.frame.to_local(x.wo), wi_base = x.frame.to_local(sample.wi);
    const Vec3f wo_offset = s.frame.to_local(s.wo);
    if (wo.z * wo_offset.z <= 0) return fail();
    std::optional<ShiftedDirection> shifted;
    if (wo.z * wi_base.z > 0) {
      shifted = shift_reflection(wo, wi_base, wo_offset);
    } else {
      const float eta_base = e.from.bsdf.rough_eta(x.wo);
      eta = bsdf.rough_eta(s.wo);
      if (eta_base == 0 || eta == 0 || (eta_base == 1) != (eta == 1)) return fail();
      shifted =
          eta == 1 ? shift_passage(wo, wi_base, wo_offset) : shift_refraction(wo, wi_base, eta_base, wo_offset, eta);
    }
    if (!shifted) return fail();
    wi = s.frame.to_world(shifted->wi);
    jacobian = shifted->jacobian;
    const BsdfEval there = bsdf.eval(s.wo, wi);
    f = there.sum();
    pdf = there.pdf;
  }
  if (!(pdf > 0) || is_black(f) || !(jacobian > 0) || !std::isfinite(jacobian)) return fail();

  const bool could_connect = connects(e.from, sample.delta) && connects(o.vertex, sample.delta);
  const Vec3f from = s.p;
  Ray ray{context_.rays.offset_origin(s.p, s.ng, wi), wi, 0, kInfinity, camera_.time};
  Vertex next;
  int passed = 0;
  float clear = 1;
  const EdgeEnd end = follow(context_, camera_.stream, e.index, ray, nullptr, next, passed, clear);
  rays_ += std::uint64_t(passed) + 1;
  if (end == EdgeEnd::kLost || (end == EdgeEnd::kEnvironment) != !e.to) return fail();
  if (end == EdgeEnd::kSurface) next.make_bsdf();
  // The way back would reconnect instead.
  if (could_connect && connects_to(end == EdgeEnd::kSurface ? &next : nullptr)) return fail();

  scatter(e, f, pdf, jacobian, eta, o);
  Rgb emitted;
  if (end == EdgeEnd::kSurface) {
    o.beta *= absorption(next, length(next.s.p - from));
    if (next.shape->emission) emitted = context_.lights.emitted(next.point, next.s);
  } else {
    emitted = context_.lights.environment(wi, camera_.time);
  }
  o.g += (o.beta * emitted - base) * (1 / (1 + sqr(o.rho)));
  if (end == EdgeEnd::kSurface) {
    o.vertex = next;
  } else {
    o.state = OffsetPath::kDead;
  }
}

/// Sums of g over the samples of one pixel, towards its four neighbours.
struct Differences {
  std::array<Rgb, 4> sum, squares;
  int count = 0;
};

class GradientPathIntegrator final : public Integrator {
 public:
  explicit GradientPathIntegrator(const Params& p)
      : options_(p), threshold_(float(p.get_double("roughness_threshold"))) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    if (settings.clock.shutter.rolling != 0) {
      throw Error(ErrorCode::kUnsupported,
                  "the integrator \"gradient_path\" compares pixels at one time and knows no rolling shutter");
    }
    static const std::vector<std::string> more{"grad.x", "grad.y", "grad.x.var", "grad.y.var"};
    std::vector<LayerDesc> result = film_outputs(settings, "gradient_path", more);
    for (const LayerDesc& d : {layers::grad_x(), layers::grad_y()}) {
      if (std::find(result.begin(), result.end(), d) == result.end()) result.push_back(d);
    }
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& /*settings*/) const override {
    std::vector<LayerDesc> result;
    for (const char* side : kSides) {
      LayerDesc mean = layers::grad_x(), variance = layers::grad_x_variance();
      mean.name = side;
      variance.name = fmt::format("{}.var", side);
      result.push_back(std::move(mean));
      result.push_back(std::move(variance));
    }
    return result;
  }

  void render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
              std::stop_token stop) const override {
    const RenderSettings& settings = context.settings;
    TileFilm film(context, tile, out);
    std::uint64_t samples = 0, rays = 0, shadow_rays = 0;
    std::array<Image*, 4> sides{}, variances{};
    for (std::size_t j = 0; j < 4; ++j) {
      sides[j] = &out.layer(kSides[j]);
      variances[j] = &out.layer(fmt::format("{}.var", kSides[j]));
    }
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return;
        // A difference needs samples on both sides: none across the border of what is rendered.
        const std::array<bool, 4> inside{x + 1 < settings.x1(), y + 1 < settings.y1(), x > settings.x0(),
                                         y > settings.y0()};
        Differences d;
        for (int i = 0; i < settings.spp; ++i) {
          const CameraSample camera = camera_sample(context, x, y, i);
          const Vec3f axis = film.features() ? context.camera.axis(camera.time) : Vec3f{};
          ShiftObserver shifts(context, options_, threshold_, camera, inside);
          const SampleResult r =
              trace_path(context, options_, camera, axis, film.sample_classes(), film.features(), shifts);
          ++samples;
          rays += r.rays + shifts.rays();
          shadow_rays += r.shadow_rays;
          bool finite = true;
          for (std::size_t j = 0; j < 4; ++j) finite &= is_finite(shifts.g(j));
          if (!finite || !film.add(x, y, i, camera, r)) {
            counters.note_bad({context.frame, x, y, i});
            continue;
          }
          ++d.count;
          for (std::size_t j = 0; j < 4; ++j) {
            const Rgb g = shifts.g(j) * camera.weight;
            d.sum[j] += g;
            d.squares[j] += g * g;
          }
        }
        const int ox = x - settings.x0(), oy = y - settings.y0();
        const float n = float(std::max(d.count, 1));
        for (std::size_t j = 0; j < 4; ++j) {
          sides[j]->set_rgb(ox, oy, d.sum[j] * (1 / n));
          Rgb v;
          for (int c = 0; d.count > 1 && c < 3; ++c) {
            v[c] = std::max(0.0f, (d.squares[j][c] - d.sum[j][c] * d.sum[j][c] / n) / (n * (n - 1)));
          }
          variances[j]->set_rgb(ox, oy, v);
        }
      }
    }
    film.write(out);
    write_motion(context, tile, out);
    counters.samples += samples;
    counters.rays += rays;
    counters.shadow_rays += shadow_rays;
  }

  /// Joins the two estimates of each difference: mean of g_ij minus mean of g_ji.
  void finish(const FrameContext& /*context*/, Frame& out) const override {
    const auto join = [&](const char* name, Neighbour forward, Neighbour back, int dx, int dy) {
      const auto side = [&](Neighbour n) { return std::string(kSides[std::size_t(n)]); };
      const Image &a = out.layer(side(forward)), &b = out.layer(side(back));
      const Image &va = out.layer(side(forward) + ".var"), &vb = out.layer(side(back) + ".var");
      Image& mean = out.layer(name);
      const std::string variance_name = fmt::format("{}.var", name);
      Image* variance = out.has(variance_name) ? &out.layer(variance_name) : nullptr;
      for (int y = 0; y + dy < out.height(); ++y) {
        for (int x = 0; x + dx < out.width(); ++x) {
          mean.set_rgb(x, y, a.rgb(x, y) - b.rgb(x + dx, y + dy));
          if (variance) variance->set_rgb(x, y, va.rgb(x, y) + vb.rgb(x + dx, y + dy));
        }
      }
    };
    join("grad.x", Neighbour::kRight, Neighbour::kLeft, 1, 0);
    join("grad.y", Neighbour::kDown, Neighbour::kUp, 0, 1);
  }

  Rgb replay(const FrameContext& context, int x, int y, int sample) const override {
    const CameraSample camera = camera_sample(context, x, y, sample);
    std::vector<Rgb> classes(context.settings.classes.empty() ? 0 : context.settings.classes.size() + 1);
    NoObserver none;
    return trace_path(context, options_, camera, {}, classes, false, none).radiance * camera.weight;
  }

 private:
  PathOptions options_;
  float threshold_;
};

}  // namespace

extern const IntegratorEntry gradient_path_entry;
const IntegratorEntry gradient_path_entry{
    "gradient_path",
    "Gradient-domain path tracing: the picture and the differences of its pixels, for `tempera reconstruct`", params(),
    [](const Params& p) -> std::unique_ptr<Integrator> { return std::make_unique<GradientPathIntegrator>(p); }};

}  // namespace tempera
