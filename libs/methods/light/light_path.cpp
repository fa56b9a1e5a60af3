// SPDX-License-Identifier: Apache-2.0
// Light tracing: paths start at lights, and every surface that they meet is connected to the camera. Caustics on
// diffuse surfaces, which paths from the camera find by chance alone, come out clean: it makes references for them.
// What stands between them and the camera must not be a perfect mirror or clear glass: such surfaces stay black. Light
// that the camera sees directly comes from a pass of camera rays, and so do features of first surfaces.
//
//   beta         flux that the light subpath carries
//   wc, wl       unit directions at a vertex: on towards the camera, back towards the light
//   f_cos        radiance BSDF f(wc, wl) times |cos(n, wl)| with the shading normal n
#include <algorithm>
#include <cmath>

#include "tempera/methods/method.h"
#include "tempera/transport/path_tracer.h"
#include "tempera/transport/pixel_motion.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

namespace {

constexpr std::int64_t kPathsOfUnit = 8192;
/// Radiance that the mean of a pixel may reach.
constexpr double kLargestRadiance = 1e6;

enum Pass { kEye, kLight };

const std::vector<ParamSpec>& params() {
  static const std::vector<ParamSpec> specs = [] {
    std::vector<ParamSpec> s = PathOptions::params();
    s.push_back({"section", 8, "frames of the sequence that share light paths where their exposures overlap", 1, 1000});
    return s;
  }();
  return specs;
}

/// Fraction of light from `distance` ahead that reaches the camera along its ray: as camera rays do, past what is
/// hidden from the camera and through what is not opaque.
float reaches_camera(const FrameContext& context, const CameraRay& seen, float distance, double time) {
  Ray ray{seen.o, seen.d, seen.tmin, kInfinity, time};
  const float end = distance * (1 - 1e-4f);
  float passes = 1;
  Hit hit;
  for (int i = 0; i < kMaxVertices; ++i) {
    ray.tmax = end - dot(ray.o - seen.o, seen.d);
    if (!(ray.tmax > ray.tmin) || !context.rays.intersect(ray, hit)) return passes;
    if (context.scene.instances[hit.point.instance].camera_visible) {
      const Material& material = *context.rays.shape(hit.point).material;
      if (!material.has_opacity()) return 0;
      passes *= 1 - std::min(1.0f, material.opacity(context.rays.shading_point(hit.point, time, -ray.d)));
      if (!(passes > 0)) return 0;
    }
    pass_unseen(context, ray, hit.point);
    ray.tmin = 0;
  }
  return 0;
}

class LightPath final : public Method {
 public:
  explicit LightPath(const Params& p) : options_(p), section_(p.get_int("section")) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    if (!settings.classes.empty()) {
      throw SettingError(ErrorCode::kUnsupported, "classes",
                         "the integrator \"light_path\" cannot tell light-path classes apart");
    }
    if (settings.clock.shutter.rolling != 0) {
      throw SettingError(ErrorCode::kUnsupported, "shutter.rolling",
                         "the integrator \"light_path\" splats to all pixels at one time: no rolling shutter");
    }
    for (const char* name : {"color.a", "color.b", "color.var"}) {
      if (std::find(settings.layers.begin(), settings.layers.end(), name) == settings.layers.end()) continue;
      throw SettingError(ErrorCode::kUnsupported, "output.layers",
                         "the integrator \"light_path\" writes no halves of the samples and no variance");
    }
    for (const std::string& name : settings.layers) {
      if (!name.starts_with("chain.")) continue;
      throw SettingError(ErrorCode::kUnsupported, "output.layers",
                         "the integrator \"light_path\" writes no features of chains");
    }
    if (paths_of_frame(settings) > (std::int64_t(1) << 31)) {
      throw SettingError(ErrorCode::kOutOfRange, "sampling.spp",
                         "the integrator \"light_path\" traces at most 2^31 paths a frame: the pixels of the picture "
                         "times sampling.spp");
    }
    return film_outputs(settings, "light_path");
  }
  FrameRange section(const RenderSettings& /*settings*/, FrameRange sequence, int frame) const override {
    const int first = frame - (((frame - sequence.first) % section_) + section_) % section_;
    return {first, std::max(frame, std::min(first + section_ - 1, sequence.last))};
  }
  std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange section) const override {
    const auto paths = double(paths_of_frame(settings));
    PassDesc light{.name = "light", .domain = PassDesc::Domain::kPaths};
    light.units = std::int64_t(section.last - section.first + 1) * units_of_frame(settings);
    light.splats = {{layers::color().name, kLargestRadiance * paths, 1 / paths}};
    return {{.name = "eye"}, light};
  }
  bool renders_single_pixels() const override { return true; }

  void run(const SceneWindow& window, SectionState* /*state*/, const Unit& unit, UnitOutput& out,
           RenderCounters& counters, std::stop_token stop) const override {
    if (unit.pass == kEye) {
      run_eye(window.frame(unit.frame), unit.tile, out, counters, stop);
    } else {
      run_light(window, unit.number, out, counters, stop);
    }
  }

  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    Rgb sum;
    RenderCounters counters;
    trace(context, std::uint32_t(sample.sample), counters,
          [&](const Vec2f&, double, const Rgb& value) { sum += value; });
    return sum;
  }

 private:
  static std::int64_t paths_of_frame(const RenderSettings& s) {
    return std::int64_t(s.width) * s.height * std::int64_t(s.spp);
  }
  static std::int64_t units_of_frame(const RenderSettings& s) {
    return (paths_of_frame(s) + kPathsOfUnit - 1) / kPathsOfUnit;
  }

  /// Light that is seen directly, and features.
  void run_eye(const FrameContext& context, const Tile& tile, UnitOutput& out, RenderCounters& counters,
               const std::stop_token& stop) const {
    TileFilm film(context, tile, out.picture());
    PathOptions seen = options_;
    seen.max_depth = std::min(1, options_.max_depth);
    NoObserver none;
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return;
        if (!out.wants(x, y)) continue;
        for (int i = 0; i < context.settings.spp; ++i) {
          const CameraSample camera = camera_sample(context, x, y, i);
          const SampleResult r = trace_path(context.at(camera.time), seen, camera, {}, film.features(), none);
          counters.rays += r.rays;
          if (!film.add(x, y, i, camera, r)) counters.note_bad({context.frame, x, y, i, own_key(context, x, y)});
        }
      }
    }
    film.write(out.picture());
    write_motion(context, tile, out.picture());
  }

  /// A batch of light paths of a frame: units are numbered frame by frame.
  void run_light(const SceneWindow& window, std::int64_t number, UnitOutput& out, RenderCounters& counters,
                 const std::stop_token& stop) const {
    const RenderSettings& s = window.settings();
    const std::int64_t units = units_of_frame(s);
    const int frame = window.section().first + int(number / units);
    const bool overlap = s.clock.shutter.close - s.clock.shutter.open > 1;
    if (!overlap && !out.wants(frame)) return;
    const FrameContext& context = window.frame(frame);
    const std::int64_t first = number % units * kPathsOfUnit, last = std::min(first + kPathsOfUnit, paths_of_frame(s));
    for (std::int64_t i = first; i < last; ++i) {
      if (stop.stop_requested()) return;
      bool finite = true;
      trace(context, std::uint32_t(i), counters, [&](const Vec2f& pixel, double t, const Rgb& value) {
        finite &= is_finite(value);
        if (!is_finite(value)) return;
        splat(s, window.section(), frame, overlap, pixel, t, value, out);
      });
      if (!finite) counters.note_bad({frame, 0, 0, int(i), {stream_number(StreamPurpose::kLight, frame), 0, 0}});
    }
    counters.samples += std::uint64_t(last - first);
  }

  /// Adds light that arrives at film position `pixel` at time t to all pixels whose filter has it, in all frames that
  /// are open then. Paths were drawn for each of these frames: they share them by how likely each was to draw t.
  static void splat(const RenderSettings& s, FrameRange section, int frame, bool overlap, const Vec2f& pixel, double t,
                    const Rgb& value, UnitOutput& out) {
    FrameRange open{frame, frame};
    double density = 1;
    if (overlap) {
      if (const auto range = s.clock.frames_open_at(t))
        open = {std::max(range->first, section.first), std::min(range->last, section.last)};
      density = 0;
      for (int f = open.first; f <= open.last; ++f) density += s.clock.exposure_density(f, t);
      if (!(density > 0)) return;
    }
    const float r = s.filter.radius();
    for (int f = open.first; f <= open.last; ++f) {
      if (!out.wants(f)) continue;
      const Rgb share = overlap ? value * float(s.clock.exposure_density(f, t) / density) : value;
      const int x0 = std::max(s.x0(), int(std::floor(pixel.x - r))), x1 = std::min(s.x1(), int(std::ceil(pixel.x + r)));
      const int y0 = std::max(s.y0(), int(std::floor(pixel.y - r))), y1 = std::min(s.y1(), int(std::ceil(pixel.y + r)));
      for (int y = y0; y < y1; ++y) {
        for (int x = x0; x < x1; ++x) {
          const float h = s.filter.density({pixel.x - (float(x) + 0.5f), pixel.y - (float(y) + 0.5f)});
          if (h != 0) out.splat(0, f, x - s.x0(), y - s.y0(), share * h);
        }
      }
    }
  }

  /// Traces light path `index` of the frame and calls arrive(film position, time, value) for each way in which its
  /// light gets to the film; the value lacks the filter.
  template <class Arrive>
  void trace(const FrameContext& frame, std::uint32_t index, RenderCounters& counters, Arrive&& arrive) const {
    const RenderSettings& s = frame.settings;
    const SampleStream stream(s.sampler, s.seed,
                              stream_number(StreamPurpose::kLight, s.seed_per_frame ? frame.frame : 0), 0, 0, index);
    const LightNumbers start = stream.light();
    const Vec2f lens = stream.camera().lens;
    const double t = s.clock.exposure_time(frame.frame, start.time);
    const FrameContext& context = frame.at(t);
    const RayScene& rays = context.rays;
    const auto end = context.lights.emit(t, start.choice, start.position, start.direction);
    if (!end || is_black(end->beta)) return;

    Rgb beta = end->beta;
    Ray ray{end->point ? rays.offset_origin(end->p, end->n, end->w) : end->p, end->w, 0, kInfinity, t};
    Vec3f previous = ray.o;
    float beta_roulette = 1;
    std::uint64_t traced = 0, shadow_rays = 0;
    Vertex v;
    // The path light, k surfaces, camera has k + 1 edges.
    for (std::uint32_t k = 0; int(k) + 2 <= options_.max_depth; ++k) {
      int passed = 0;
      float pass_probability = 1;
      const EdgeEnd edge_end = follow(context, stream, k, ray, nullptr, v, passed, pass_probability);
      traced += std::uint64_t(passed) + 1;
      if (edge_end != EdgeEnd::kSurface) break;
      const bool from_infinity = k == 0 && end->infinite;
      if (v.material().has_absorption() && !from_infinity) beta *= absorption(v, length(v.s.p - previous));
      const Vec3f wl = v.s.wo;
      const float cos_g = std::abs(dot(v.s.ng, wl));
      if (!(cos_g > 0)) break;

      shadow_rays += connect(context, v, wl, beta / cos_g, lens, t, arrive);

      const VertexNumbers u = stream.vertex(k, Subpath::kLight);
      const auto scattered = scatter(v, wl, u);
      if (!scattered) break;
      const Vec3f wc = scattered->wc;
      const Rgb step = scattered->step / cos_g;
      if (is_black(step)) break;
      beta *= step;
      beta_roulette *= max_component(step);
      previous = v.s.p;
      ray = {rays.offset_origin(v.s.p, v.s.ng, wc), wc, 0, kInfinity, t};
      if (int(k) + 2 > options_.rr_depth) {
        const float survival = std::min(beta_roulette, kMaxContinue);
        if (!(u.roulette < survival)) break;
        beta *= 1 / survival;
        beta_roulette /= survival;
      }
    }
    counters.rays += traced;
    counters.shadow_rays += shadow_rays;
  }

  struct Scattered {
    Vec3f wc;
    Rgb step;  ///< of the flux, but for the cosine of its arrival with the geometric normal
  };
  /// Where light from wl goes on.
  static std::optional<Scattered> scatter(Vertex& v, const Vec3f& wl, const VertexNumbers& u) {
    // Bending normals depends on the viewer, who is not known yet: directions are drawn by normals as they are, and
    // some from everywhere, as a bent surface may scatter where an unbent one does not.
    const bool bends = v.s.bends;
    const float from_everywhere = bends ? 0.1f : 0.0f;
    v.s.bends = false;
    v.make_bsdf();
    v.s.bends = bends;
    BsdfSample sample;
    if (u.lobe < from_everywhere) {
      if (!v.bsdf.has_non_delta()) return std::nullopt;
      const float z = 1 - 2 * u.direction.y, r = std::sqrt(std::max(0.0f, 1 - z * z)), phi = 2 * kPi * u.direction.x;
      sample.wi = {r * std::cos(phi), r * std::sin(phi), z};
      sample.pdf = v.bsdf.eval(wl, sample.wi).pdf;
    } else {
      const auto drawn = v.bsdf.sample(wl, (u.lobe - from_everywhere) / (1 - from_everywhere), u.direction);
      if (!drawn) return std::nullopt;
      sample = *drawn;
    }
    const Vec3f wc = sample.wi;
    if (!sample.delta) {
      const float pdf = (1 - from_everywhere) * sample.pdf + from_everywhere * (0.25f * kInvPi);
      return Scattered{wc, towards(v, wc).eval(wc, wl).sum() * (std::abs(dot(v.s.ng, wc)) / pdf)};
    }
    const float factor = delta_flux_factor(v.bsdf.frame(sample.lobe).n, v.s.ng, wl, sample);
    return Scattered{wc, sample.sum() * (factor / ((1 - from_everywhere) * sample.pdf))};
  }

  /// The BSDF as a path from the camera meets it, seen from wc.
  static Bsdf& towards(Vertex& v, const Vec3f& wc) {
    v.s.wo = wc;
    v.s.bsdf_frame = -1;
    v.make_bsdf();
    return v.bsdf;
  }

  /// Connects a vertex to the camera; `beta`: flux over the cosine of its arrival. Returns the rays that this took.
  template <class Arrive>
  static std::uint64_t connect(const FrameContext& context, Vertex& v, const Vec3f& wl, const Rgb& beta,
                               const Vec2f& lens, double t, Arrive&& arrive) {
    if (!context.scene.instances[v.hit.point.instance].camera_visible) return 0;
    const auto camera = context.camera.importance(v.s.p, lens, t);
    if (!camera) return 0;
    const float margin = context.settings.filter.radius();
    const RenderSettings& s = context.settings;
    if (camera->pixel.x < float(s.x0()) - margin || camera->pixel.x > float(s.x1()) + margin ||
        camera->pixel.y < float(s.y0()) - margin || camera->pixel.y > float(s.y1()) + margin) {
      return 0;
    }
    const Vec3f wc = -camera->ray.d;
    Rgb value = beta * towards(v, wc).eval(wc, wl).sum() * (std::abs(dot(v.s.ng, wc)) * camera->we);
    if (v.material().has_absorption()) value *= absorption(v, camera->distance);
    std::uint64_t rays = 0;
    if (!is_black(value)) {
      ++rays;
      value *= reaches_camera(context, camera->ray, camera->distance, t);
      if (!is_black(value)) arrive(camera->pixel, t, value);
    }
    v.s.wo = wl;
    v.s.bsdf_frame = -1;
    return rays;
  }

  PathOptions options_;
  int section_;
};

}  // namespace

extern const MethodEntry light_path_entry;
const MethodEntry light_path_entry{
    "light_path", "Light tracing: caustics without noise, as a reference; perfect mirrors and clear glass stay black",
    params(), [](const Params& p) -> std::unique_ptr<Method> { return std::make_unique<LightPath>(p); }};

}  // namespace tempera
