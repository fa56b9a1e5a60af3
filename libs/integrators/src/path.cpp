// SPDX-License-Identifier: Apache-2.0
// Path tracing with next-event estimation, multiple importance sampling and light-path classes.
//
//   throughput  beta: product of f |cos| / pdf over the vertices so far
//   edges       number of path edges so far; a path to a light over n surfaces has n + 1
//   w           multiple importance sampling weight, power heuristic [Veach 1997, Eq. 9.13]
#include <fmt/format.h>

#include <array>
#include <bit>
#include <cmath>

#include "cryptomatte_names.h"
#include "tempera/frames/cryptomatte.h"
#include "tempera/integrators/integrator.h"

namespace tempera {

namespace {

constexpr int kMaxVertices = 4096;     // surfaces visited by one path, passed masks included: ends endless light traps
constexpr float kMaxContinue = 0.95f;  // survival probability of Russian roulette, at most

const std::vector<ParamSpec> kParams = {
    {"max_depth", -1, "path edges at most: 1 shows lights only, 2 adds direct light; -1: no limit", -1, 4096},
    {"rr_depth", 5, "path edges after which Russian roulette starts", 1, 4096},
    {"clamp", 0.0, "largest luminance that one sample may add through scattered light; 0: off (clamping is biased)", 0,
     1e9},
    {"hide_emitters", false, "lights are not seen directly by the camera"},
    {"null_counts_as_bounce", false, "passing through a mask uses up one edge, as in Mitsuba"},
    {"adaptive_error", 0.0, "stop sampling a pixel at this relative error of its mean; 0: off, every pixel gets spp", 0,
     1},
    {"adaptive_min_spp", 32, "samples that every pixel gets under adaptive sampling", 4, 1e6},
};

float power_heuristic(float a, float b) {
  const float a2 = a * a, b2 = b * b;
  return a2 > 0 ? (std::isinf(a2) ? 1.0f : a2 / (a2 + b2)) : 0.0f;
}

/// What the first surface of a camera ray contributes to feature layers.
struct FirstHit {
  bool valid = false;
  Rgb albedo, emission;
  Vec3f normal, position;
  Vec2f uv;
  float depth = 0;
  std::uint32_t instance = 0;
};

/// Radiance of one sample, in total and by class.
struct SampleResult {
  Rgb radiance;
  float alpha = 0;
  FirstHit first;
  std::uint32_t rays = 0, shadow_rays = 0;
};

class PathIntegrator final : public Integrator {
 public:
  explicit PathIntegrator(const Params& p)
      : max_depth_(p.get_int("max_depth") < 0 ? kMaxVertices : p.get_int("max_depth")),
        rr_depth_(p.get_int("rr_depth")),
        clamp_(float(p.get_double("clamp"))),
        hide_emitters_(p.get_bool("hide_emitters")),
        null_counts_(p.get_bool("null_counts_as_bounce")),
        adaptive_error_(float(p.get_double("adaptive_error"))),
        adaptive_min_spp_(p.get_int("adaptive_min_spp")) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override;
  void render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
              std::stop_token stop) const override;
  Rgb replay(const FrameContext& context, int x, int y, int sample) const override;

 private:
  /// Collects radiance: the total, and the share of each class (the last entry: paths of no class).
  struct Tally {
    const LightPathClassifier& classifier;
    std::span<Rgb> classes;
    Rgb total;
    float clamp = 0;
    void add(LightPathClassifier::State state, Rgb c, bool scattered) {
      if (clamp > 0 && scattered) {
        const float l = luminance(c);
        if (l > clamp) c *= clamp / l;
      }
      total += c;
      if (classes.empty()) return;
      std::uint32_t members = classifier.classes(state);
      if (members == 0) classes.back() += c;
      for (; members; members &= members - 1) classes[std::size_t(std::countr_zero(members))] += c;
    }
  };
  struct PixelState;
  /// The random numbers, filter weight, time and camera ray of one sample.
  struct CameraSample {
    SampleStream stream;
    float weight;
    double time;
    Vec2f film, lens;
    CameraRay ray;
  };
  static CameraSample camera_sample(const FrameContext& context, int x, int y, int index);

  SampleResult trace(const FrameContext& context, const CameraSample& camera, const Vec3f& view_axis,
                     std::span<Rgb> classes, bool features) const;
  static void set_footprint(const FrameContext& context, const CameraSample& camera, const SurfacePoint& point,
                            ShadingPoint& s);
  float transmittance(const FrameContext& context, Ray ray, int edges_left) const;
  void write_motion(const FrameContext& context, const Tile& tile, Frame& out) const;

  int max_depth_, rr_depth_;
  float clamp_;
  bool hide_emitters_, null_counts_;
  float adaptive_error_;
  int adaptive_min_spp_;
};

std::vector<LayerDesc> PathIntegrator::outputs(const RenderSettings& settings) const {
  std::vector<LayerDesc> result{layers::color()};
  const auto add = [&](const LayerDesc& desc) {
    for (const LayerDesc& d : result) {
      if (d.name == desc.name) return;
    }
    result.push_back(desc);
  };
  static const std::vector<std::string> plain{"color",    "color.a",        "color.b",         "color.var", "albedo",
                                              "normal",   "depth",          "position",        "object_id", "uv",
                                              "emission", "motion.forward", "motion.backward", "samples",   "time"};
  for (const std::string& name : settings.layers) {
    const auto desc = layers::find(name);
    if (!desc || (std::find(plain.begin(), plain.end(), name) == plain.end() && !name.starts_with("CryptoObject"))) {
      throw Error(
          ErrorCode::kUnknownName,
          fmt::format("the integrator \"path\" cannot write the layer \"{}\"; it can write: {}, CryptoObject00..., "
                      "and a class.<name>.color for each light-path class",
                      name, fmt::join(plain, ", ")));
    }
    if (name.starts_with("CryptoObject")) {
      for (int rank = 0; rank < (settings.cryptomatte_depth + 1) / 2; ++rank) add(layers::crypto(rank));
    } else {
      add(*desc);
    }
  }
  for (const PathClass& c : settings.classes) add(layers::class_layer(c.name, layers::color()));
  if (settings.classes_are_decomposition) add(layers::class_layer("residual", layers::color()));
  return result;
}

/// Fraction of light that reaches along `ray` through surfaces with opacity below 1.
float PathIntegrator::transmittance(const FrameContext& context, Ray ray, int edges_left) const {
  float t = 1;
  for (int i = 0; i < kMaxVertices; ++i) {
    const auto hit = context.rays.intersect(ray);
    if (!hit) return t;
    const Material& material = *context.rays.shape(hit->point).material;
    if (!material.has_opacity() || (null_counts_ && --edges_left < 0)) return 0;
    const ShadingPoint s = context.rays.shading_point(hit->point, ray.time, -ray.d);
    t *= 1 - material.opacity(s);
    if (t <= 0) return 0;
    const Vec3f o = context.rays.offset_origin(s.p, s.ng, ray.d);
    ray.tmax -= dot(o - ray.o, ray.d);
    ray.o = o;
    ray.tmin = 0;
    if (!(ray.tmax > 0)) return t;
  }
  return 0;
}

/// Groups the events of `f` by the state that they lead to and calls use(state, sum of the group) for each group that
/// is not black, until it returns false.
template <class Use>
void for_each_state(const LightPathClassifier& classifier, LightPathClassifier::State from,
                    const std::array<Rgb, kEventCount>& f, Use&& use) {
  std::array<LightPathClassifier::State, kEventCount> next;
  for (std::size_t e = 0; e < kEventCount; ++e) next[e] = classifier.next(from, Event(e));
  for (std::size_t e = 0; e < kEventCount; ++e) {
    if (std::find(next.begin(), next.begin() + e, next[e]) != next.begin() + e) continue;
    Rgb share;
    for (std::size_t k = e; k < kEventCount; ++k) {
      if (next[k] == next[e]) share += f[k];
    }
    if (!is_black(share) && !use(next[e], share)) return;
  }
}

/// Sets the texture footprint of a hit that the camera sees: how far apart on the tangent plane the rays of
/// neighbouring samples arrive, taking samples for evenly spread over the pixel [Igehy 1999; Pharr 2023, Sec. 10.1].
void PathIntegrator::set_footprint(const FrameContext& context, const CameraSample& camera, const SurfacePoint& point,
                                   ShadingPoint& s) {
  constexpr float kLeast = 0.125f;  // of a pixel: what is finer than that is noise below the others
  const float spacing = std::max(kLeast, 1 / std::sqrt(float(context.settings.spp)));
  const SurfaceDerivatives d = context.rays.derivatives(point, camera.time);
  const float uu = dot(d.dpdu, d.dpdu), uv = dot(d.dpdu, d.dpdv), vv = dot(d.dpdv, d.dpdv);
  const float inv = 1 / (uu * vv - uv * uv);
  const auto footprint = [&](const Vec2f& step) -> Vec2f {
    const CameraRay r = context.camera.ray(camera.film + step * spacing, camera.lens, camera.time);
    const float t = dot(s.p - r.o, s.ng) / dot(r.d, s.ng);
    const Vec3f dp = r.o + r.d * t - s.p;
    const float u = dot(dp, d.dpdu), v = dot(dp, d.dpdv);
    const Vec2f result{(vv * u - uv * v) * inv, (uu * v - uv * u) * inv};
    return std::isfinite(result.x) && std::isfinite(result.y) ? result : Vec2f{};
  };
  s.duv_dx = footprint({1, 0});
  s.duv_dy = footprint({0, 1});
}

SampleResult PathIntegrator::trace(const FrameContext& context, const CameraSample& camera, const Vec3f& view_axis,
                                   std::span<Rgb> classes, bool features) const {
  const RayScene& rays = context.rays;
  const LightSampler& lights = context.lights;
  const LightPathClassifier& classifier = context.classifier;
  const bool masks = rays.has_opacity();
  SampleResult result;
  Tally tally{classifier, classes, {}, clamp_};

  const double time = camera.time;
  Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, time};
  Rgb beta(1.0f);
  float beta_roulette = 1;  // throughput before a class was chosen, so that roulette does not depend on the classes
  float eta_product = 1;    // radiance scaling by refraction, taken out of roulette's decision
  LightPathClassifier::State state = classifier.start();
  float bsdf_pdf = 0;  // density of ray.d at the previous vertex
  bool mis = false;    // whether next-event estimation could have found what this ray finds
  Vec3f previous = ray.o;
  bool seen_by_camera = true;
  int edges = 1;

  for (std::uint32_t vertex = 0; vertex < std::uint32_t(kMaxVertices) && edges <= max_depth_; ++vertex) {
    const auto hit = rays.intersect(ray);
    ++result.rays;
    if (!hit) {
      if (lights.has_environment() && !(hide_emitters_ && seen_by_camera)) {
        const Rgb le = lights.environment(ray.d, time, seen_by_camera);
        if (!is_black(le)) {
          const float w = mis ? power_heuristic(bsdf_pdf, lights.environment_pdf(ray.d, time, previous)) : 1.0f;
          tally.add(state, beta * le * w, edges > 1);
          if (seen_by_camera) result.alpha = 0;
        }
      }
      break;
    }
    ShadingPoint s = rays.shading_point(hit->point, time, -ray.d);
    const Shape& shape = rays.shape(hit->point);
    const Material& material = *shape.material;
    if (seen_by_camera && material.needs_footprint()) set_footprint(context, camera, hit->point, s);

    const VertexNumbers u = camera.stream.vertex(vertex);
    if (masks && material.has_opacity()) {
      const float opacity = material.opacity(s);
      if (opacity < 1 && u.opacity >= opacity) {
        ray.o = rays.offset_origin(s.p, s.ng, ray.d);
        ray.tmin = 0;
        ray.tmax = kInfinity;
        if (null_counts_) ++edges;
        continue;  // no event: the path goes on as if nothing were there
      }
    }
    if (material.has_absorption() && dot(s.ng, s.wo) < 0) {  // this edge ran inside
      const Rgb sigma = material.absorption(s);
      const float d = length(s.p - previous);
      beta *= exp(sigma * -d);
    }

    Rgb emitted;
    if (shape.emission) {
      emitted = lights.emitted(hit->point, s);
      if (!is_black(emitted) && !(hide_emitters_ && seen_by_camera)) {
        float w = 1;
        if (mis) w = power_heuristic(bsdf_pdf, lights.pdf(hit->point, s, previous, length(s.p - previous)));
        tally.add(state, beta * emitted * w, edges > 1);
      }
    }

    Bsdf bsdf;
    material.add_lobes(s, 1, bsdf);
    if (seen_by_camera) {
      seen_by_camera = false;
      result.alpha = 1;
      if (features) {
        FirstHit& f = result.first;
        f.valid = true;
        f.instance = hit->point.instance;
        f.normal = dot(s.frame.n, s.wo) < 0 ? -s.frame.n : s.frame.n;
        f.position = s.p;
        f.uv = s.uv;
        f.emission = emitted;
        f.depth = dot(s.p - camera.ray.o, view_axis);
        for (int e = 0; e < kEventCount; ++e) f.albedo += bsdf.albedo(s.wo, Event(e));
      }
    }
    if (edges >= max_depth_ || bsdf.empty()) break;

    // Next-event estimation. [Zimmer 2015, Sec. 3]: each event's share goes to the class that it leads to.
    const bool next_event = bsdf.has_non_delta() && !lights.empty();
    if (next_event) {
      const auto light = lights.sample(s.p, time, u.light_choice, u.light_point);
      if (light && !is_black(light->radiance)) {
        const BsdfEval f = bsdf.eval(s.wo, light->wi);
        if (!is_black(f.sum())) {
          Ray shadow{rays.offset_origin(s.p, s.ng, light->wi), light->wi, 0, kInfinity, time};
          if (std::isfinite(light->distance)) {  // from where the ray really starts to just before the light
            const Vec3f to_light = s.p + light->wi * light->distance - shadow.o;
            const float distance = length(to_light);
            shadow.d = to_light * (1 / distance);
            shadow.tmax = distance * (1 - 1e-4f);
          }
          ++result.shadow_rays;
          const float visible =
              masks ? transmittance(context, shadow, max_depth_ - edges - 1) : (rays.occluded(shadow) ? 0.0f : 1.0f);
          if (visible > 0) {
            const float w = light->delta ? 1.0f : power_heuristic(light->pdf, f.pdf);
            const Rgb le = beta * light->radiance * (visible * w / light->pdf);
            if (classes.empty()) {
              tally.add(state, le * f.sum(), true);
            } else {
              for_each_state(classifier, state, f.f_cos, [&](LightPathClassifier::State next, const Rgb& share) {
                tally.add(next, le * share, true);
                return true;
              });
            }
          }
        }
      }
    }

    const auto sample = bsdf.sample(s.wo, u.lobe, u.direction);
    if (!sample || !(sample->pdf > 0)) break;
    const Rgb total = sample->sum();
    if (is_black(total)) break;
    const float inv_pdf = 1 / sample->pdf;
    const float eta2 = sample->transmitted ? sample->eta * sample->eta : 1.0f;
    beta_roulette *= max_component(total) * inv_pdf;
    eta_product *= eta2;
    if (classes.empty()) {
      beta *= total * inv_pdf;
    } else {
      // Events that lead to one state need no choice; between states, choose by luminance and divide. The number that
      // chose the lobe is spent; a hash of it chooses the state.
      const float u_state = to_unit_float(std::uint32_t(mix64(std::bit_cast<std::uint32_t>(u.lobe) + 0x5851f42dull)));
      Rgb chosen;
      float below = 0;
      const LightPathClassifier::State from = state;
      for_each_state(classifier, from, sample->f_cos, [&](LightPathClassifier::State next, const Rgb& share) {
        const float p = luminance(share) / luminance(total);
        if (!(p > 0)) return true;
        chosen = p < 1 ? share * (1 / p) : share;
        state = next;
        below += p;
        return u_state >= below;
      });
      beta *= chosen * inv_pdf;
    }
    mis = !sample->delta && next_event;
    bsdf_pdf = sample->pdf;
    previous = s.p;
    ray.o = rays.offset_origin(s.p, s.ng, sample->wi);
    ray.d = sample->wi;
    ray.tmin = 0;
    ray.tmax = kInfinity;
    ++edges;

    if (edges > rr_depth_) {
      const float q = std::min(beta_roulette * eta_product, kMaxContinue);
      if (!(u.roulette < q)) break;
      beta *= 1 / q;
      beta_roulette /= q;
    }
  }
  result.radiance = tally.total;
  return result;
}

PathIntegrator::CameraSample PathIntegrator::camera_sample(const FrameContext& context, int x, int y, int index) {
  const RenderSettings& settings = context.settings;
  const SampleStream stream(settings.sampler, settings.seed, settings.seed_per_frame ? context.frame : 0, x, y,
                            std::uint32_t(index));
  const CameraNumbers u = stream.camera();
  const auto filter = settings.filter.sample(u.pixel);
  const Vec2f film{float(x) + 0.5f + filter.offset.x, float(y) + 0.5f + filter.offset.y};
  const double time =
      settings.clock.exposure_time(context.frame, u.time, std::clamp(film.y / float(settings.height), 0.0f, 1.0f));
  return {stream, filter.weight, time, film, u.lens, context.camera.ray(film, u.lens, time)};
}

/// Sums over the samples of one pixel.
struct PathIntegrator::PixelState {
  Rgb sum, sum_a, sum_b, squares;
  float alpha = 0;
  int count = 0, count_a = 0, count_b = 0;
  Rgb albedo, emission;
  Vec3f normal, position;
  Vec2f uv;
  float depth = 0;
  int hits = 0;
  double time = 0;

  /// Relative standard error of the pixel's mean luminance, from all samples.
  float relative_error() const {
    if (count < 2) return kInfinity;
    const float n = float(count), mean = luminance(sum) / n;
    const float variance = std::max(0.0f, (luminance(squares) / n - mean * mean) / (n - 1));
    return std::sqrt(variance) / (std::abs(mean) + 1e-2f);
  }
};

void PathIntegrator::render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
                            std::stop_token stop) const {
  const RenderSettings& settings = context.settings;
  const int w = tile.x1 - tile.x0, h = tile.y1 - tile.y0;
  const std::size_t class_count = settings.classes.empty() ? 0 : settings.classes.size() + 1;
  std::vector<PixelState> pixels(std::size_t(w) * std::size_t(h));
  std::vector<Rgb> class_sums(pixels.size() * class_count), sample_classes(class_count);
  const auto wants = [&](std::string_view name) { return out.has(name); };
  const bool cryptomatte = wants("CryptoObject00");
  const bool features = cryptomatte || wants("albedo") || wants("normal") || wants("depth") || wants("position") ||
                        wants("uv") || wants("emission");
  CryptomatteBuffer ids(cryptomatte ? w : 0, cryptomatte ? h : 0);
  std::vector<float> instance_ids;
  if (cryptomatte) {
    for (const std::string& name : cryptomatte_names(context.scene)) instance_ids.push_back(cryptomatte_id(name));
  }
  std::uint64_t samples = 0, ray_count = 0, shadow_count = 0;

  const auto take = [&](int x, int y, int index) {
    const std::size_t i = std::size_t(y - tile.y0) * std::size_t(w) + std::size_t(x - tile.x0);
    PixelState& p = pixels[i];
    const CameraSample camera = camera_sample(context, x, y, index);
    const Vec3f axis = features ? context.camera.axis(camera.time) : Vec3f{};
    std::fill(sample_classes.begin(), sample_classes.end(), Rgb(0.0f));
    const SampleResult r = trace(context, camera, axis, sample_classes, features);
    ++samples;
    ray_count += r.rays;
    shadow_count += r.shadow_rays;
    if (!is_finite(r.radiance)) {
      counters.note_bad({context.frame, x, y, index});
      return;
    }
    const Rgb c = r.radiance * camera.weight;
    p.sum += c;
    p.squares += c * c;
    p.alpha += r.alpha * camera.weight;
    ++p.count;
    (index & 1 ? p.sum_b : p.sum_a) += c;
    ++(index & 1 ? p.count_b : p.count_a);
    p.time += camera.time;
    for (std::size_t k = 0; k < class_count; ++k) class_sums[i * class_count + k] += sample_classes[k] * camera.weight;
    if (cryptomatte) ids.add(x - tile.x0, y - tile.y0, r.first.valid ? instance_ids[r.first.instance] : 0, 1);
    if (r.first.valid) {
      ++p.hits;
      p.albedo += r.first.albedo;
      p.emission += r.first.emission;
      p.normal += r.first.normal;
      p.position += r.first.position;
      p.uv += r.first.uv;
      p.depth += r.first.depth;
    }
  };

  if (adaptive_error_ <= 0) {
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return;
        for (int i = 0; i < settings.spp; ++i) take(x, y, i);
      }
    }
  } else {
    // Passes over the tile, each doubling the samples where a pixel or a neighbour is still too noisy. Only pixels of
    // the tile are looked at, so that the result does not depend on what else was rendered.
    int done = 0;
    std::vector<char> active(pixels.size(), 1);
    while (done < settings.spp) {
      const int until = std::min(settings.spp, done == 0 ? std::min(adaptive_min_spp_, settings.spp) : 2 * done);
      for (int y = tile.y0; y < tile.y1; ++y) {
        for (int x = tile.x0; x < tile.x1; ++x) {
          if (stop.stop_requested()) return;
          if (!active[std::size_t(y - tile.y0) * std::size_t(w) + std::size_t(x - tile.x0)]) continue;
          for (int i = done; i < until; ++i) take(x, y, i);
        }
      }
      done = until;
      std::vector<char> next(pixels.size(), 0);
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          const std::size_t i = std::size_t(y) * std::size_t(w) + std::size_t(x);
          if (!active[i] || pixels[i].relative_error() <= adaptive_error_) continue;
          for (int j = std::max(0, y - 1); j <= std::min(h - 1, y + 1); ++j) {
            for (int k = std::max(0, x - 1); k <= std::min(w - 1, x + 1); ++k) {
              next[std::size_t(j) * std::size_t(w) + std::size_t(k)] = 1;
            }
          }
        }
      }
      for (std::size_t i = 0; i < active.size(); ++i) active[i] = active[i] && next[i];
    }
  }

  Frame crypto_frame(w, h);
  if (cryptomatte) ids.write(crypto_frame, {}, "CryptoObject", settings.cryptomatte_depth);
  const auto layer = [&](std::string_view name) { return wants(name) ? &out.layer(name) : nullptr; };
  Image* color = layer("color");
  Image *half_a = layer("color.a"), *half_b = layer("color.b"), *variance = layer("color.var");
  Image *albedo = layer("albedo"), *normal = layer("normal"), *depth = layer("depth"), *position = layer("position");
  Image *uv = layer("uv"), *emission = layer("emission"), *count = layer("samples"), *mean_time = layer("time");
  std::vector<Image*> class_layers;
  for (const PathClass& c : settings.classes) class_layers.push_back(layer("class." + c.name + ".color"));
  if (class_count) class_layers.push_back(layer("class.residual.color"));
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      const std::size_t i = std::size_t(y - tile.y0) * std::size_t(w) + std::size_t(x - tile.x0);
      const PixelState& p = pixels[i];
      const int ox = x - settings.x0(), oy = y - settings.y0();
      const float inv = p.count ? 1 / float(p.count) : 0, inv_hits = p.hits ? 1 / float(p.hits) : 0;
      Rgb mean_color = p.sum * inv;
      Rgb class_total;
      for (std::size_t k = 0; k < class_count; ++k) {
        const Rgb c = class_sums[i * class_count + k] * inv;
        if (class_layers[k]) class_layers[k]->set_rgb(ox, oy, c);
        class_total += c;
      }
      // The picture is defined as the sum of its parts: adding the layers up gives it to the bit.
      if (settings.classes_are_decomposition && class_count) mean_color = class_total;
      color->set_rgb(ox, oy, mean_color);
      if (color->channels() > 3) color->at(ox, oy, 3) = p.alpha * inv;
      if (half_a) half_a->set_rgb(ox, oy, p.count_a ? p.sum_a * (1 / float(p.count_a)) : Rgb(0.0f));
      if (half_b) half_b->set_rgb(ox, oy, p.count_b ? p.sum_b * (1 / float(p.count_b)) : Rgb(0.0f));
      if (variance) {
        Rgb v;
        if (p.count > 1) {
          const float n = float(p.count);
          for (int c = 0; c < 3; ++c) v[c] = std::max(0.0f, (p.squares[c] - p.sum[c] * p.sum[c] / n) / (n * (n - 1)));
        }
        variance->set_rgb(ox, oy, v);
      }
      if (albedo) albedo->set_rgb(ox, oy, p.albedo * inv);
      if (emission) emission->set_rgb(ox, oy, p.emission * inv);
      if (normal) normal->set_vec3(ox, oy, normalize(p.normal));
      if (position) position->set_vec3(ox, oy, p.position * inv_hits);
      if (depth) depth->at(ox, oy) = p.depth * inv_hits;
      if (uv) {
        uv->at(ox, oy, 0) = p.uv.x * inv_hits;
        uv->at(ox, oy, 1) = p.uv.y * inv_hits;
      }
      if (count) count->at(ox, oy) = float(p.count);
      if (mean_time) mean_time->at(ox, oy) = p.count ? float(p.time / p.count) : 0.0f;
      if (cryptomatte) {
        for (const Layer& l : crypto_frame.layers()) {
          if (!out.has(l.desc.name)) continue;
          Image& target = out.layer(l.desc.name);
          for (int c = 0; c < target.channels(); ++c) {
            target.at(ox, oy, c) = l.image.at(x - tile.x0, y - tile.y0, c);
          }
        }
      }
    }
  }
  write_motion(context, tile, out);
  counters.samples += samples;
  counters.rays += ray_count;
  counters.shadow_rays += shadow_count;
}

/// Object ids and motion vectors: what stands at the pixel's center at the middle of the exposure, and where the same
/// matter is seen one frame later and earlier.
void PathIntegrator::write_motion(const FrameContext& context, const Tile& tile, Frame& out) const {
  const RenderSettings& settings = context.settings;
  Image* object_id = out.has("object_id") ? &out.layer("object_id") : nullptr;
  Image* forward = out.has("motion.forward") ? &out.layer("motion.forward") : nullptr;
  Image* backward = out.has("motion.backward") ? &out.layer("motion.backward") : nullptr;
  if (!object_id && !forward && !backward) return;
  const bool masks = context.rays.has_opacity();
  for (int y = tile.y0; y < tile.y1; ++y) {
    const double row = (double(y) + 0.5) / settings.height;
    const double now = settings.clock.exposure_time(context.frame, 0.5, row);
    for (int x = tile.x0; x < tile.x1; ++x) {
      const int ox = x - settings.x0(), oy = y - settings.y0();
      const CameraRay c = context.camera.ray({float(x) + 0.5f, float(y) + 0.5f}, {0.5f, 0.5f}, now);
      Ray ray{c.o, c.d, c.tmin, c.tmax, now};
      auto hit = context.rays.intersect(ray);
      for (int i = 0; hit && masks && i < kMaxVertices; ++i) {  // look through what is mostly transparent
        const Material& material = *context.rays.shape(hit->point).material;
        if (!material.has_opacity()) break;
        const ShadingPoint s = context.rays.shading_point(hit->point, now, -ray.d);
        if (material.opacity(s) >= 0.5f) break;
        ray.o = context.rays.offset_origin(s.p, s.ng, ray.d);
        ray.tmin = 0;
        hit = context.rays.intersect(ray);
      }
      if (object_id) object_id->at(ox, oy) = hit ? float(hit->point.instance + 1) : 0.0f;
      const auto write = [&](Image* image, int step) {
        if (!image) return;
        const double then = settings.clock.exposure_time(context.frame + step, 0.5, row);
        Vec2f motion;
        float depth_change = 0;
        bool valid = false;
        if (hit) {
          const auto a = context.camera.project(context.rays.position(hit->point, now), now);
          const auto b = context.camera.project(context.rays.position(hit->point, then), then);
          valid = a && b;
          if (valid) motion = b->pixel - a->pixel, depth_change = b->depth - a->depth;
        } else if (const auto a = context.camera.project_direction(c.d, now)) {
          const auto b = context.camera.project_direction(context.lights.environment_motion(c.d, now, then), then);
          valid = b.has_value();
          if (valid) motion = *b - *a;
        } else {  // parallel projection sees no directions: a far point instead
          const Vec3f p = c.o + c.d * (1e3f * std::max(1.0f, context.rays.bounds().radius()));
          const auto from = context.camera.project(p, now), to = context.camera.project(p, then);
          valid = from && to;
          if (valid) motion = to->pixel - from->pixel;
        }
        valid = valid && std::isfinite(motion.x) && std::isfinite(motion.y) && std::isfinite(depth_change);
        image->at(ox, oy, 0) = valid ? motion.x : 0.0f;
        image->at(ox, oy, 1) = valid ? motion.y : 0.0f;
        image->at(ox, oy, 2) = valid ? depth_change : 0.0f;
        image->at(ox, oy, 3) = valid ? 1.0f : 0.0f;
      };
      write(forward, 1);
      write(backward, -1);
    }
  }
}

Rgb PathIntegrator::replay(const FrameContext& context, int x, int y, int sample) const {
  const CameraSample camera = camera_sample(context, x, y, sample);
  std::vector<Rgb> classes(context.settings.classes.empty() ? 0 : context.settings.classes.size() + 1);
  return trace(context, camera, {}, classes, false).radiance * camera.weight;
}

std::unique_ptr<Integrator> make_path(const Params& params) { return std::make_unique<PathIntegrator>(params); }

}  // namespace

extern const IntegratorEntry path_entry;
const IntegratorEntry path_entry{"path", "Path tracing with next-event estimation and multiple importance sampling",
                                 kParams, make_path};

}  // namespace tempera
