// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/path_tracer.h"

namespace tempera {

const std::vector<ParamSpec>& PathOptions::params() {
  static const std::vector<ParamSpec> specs = {
      {"max_depth", -1, "path edges at most: 1 shows lights only, 2 adds direct light; -1: no limit", -1, 4096},
      {"rr_depth", 5, "path edges after which Russian roulette starts", 1, 4096},
      {"hide_emitters", false, "lights are not seen directly by the camera"},
      {"null_counts_as_bounce", false, "passing through a mask uses up one edge, as in Mitsuba"},
  };
  return specs;
}

PathOptions::PathOptions(const Params& p)
    : max_depth(p.get_int("max_depth") < 0 ? kMaxVertices : p.get_int("max_depth")),
      rr_depth(p.get_int("rr_depth")),
      hide_emitters(p.get_bool("hide_emitters")),
      null_counts(p.get_bool("null_counts_as_bounce")) {}

CameraSample camera_sample(const FrameContext& context, const PixelKey& key, int x, int y, int index) {
  const RenderSettings& settings = context.settings;
  const SampleStream stream(settings.sampler, settings.seed, key.stream, key.x, key.y, std::uint32_t(index));
  const CameraNumbers u = stream.camera();
  const auto rotated = [](float number, int rotation) {
    if (rotation == 0) return number;
    const float sum = number + float(rotation) / PixelKey::kFullRotation;
    return std::min(sum - std::floor(sum), 0x1.fffffep-1f);
  };
  const auto filter = settings.filter.sample({rotated(u.pixel.x, key.rotation_x), rotated(u.pixel.y, key.rotation_y)});
  const Vec2f film{float(x) + 0.5f + filter.offset.x, float(y) + 0.5f + filter.offset.y};
  const double time =
      settings.clock.exposure_time(context.frame, u.time, std::clamp(film.y / float(settings.height), 0.0f, 1.0f));
  return {stream, filter.weight, time, film, u.lens, context.camera.ray(film, u.lens, time), index};
}

void set_footprint(const FrameContext& context, const CameraSample& camera, const SurfacePoint& point,
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

void pass_unseen(const FrameContext& context, Ray& ray, const SurfacePoint& point) {
  Vec3f ng;
  const Vec3f p = context.rays.position(point, ray.time, &ng);
  const Vec3f o = context.rays.offset_origin(p, ng, ray.d);
  ray.tmax -= dot(o - ray.o, ray.d);  // a camera's rays have unit directions
  ray.o = o;
  ray.tmin = 0;
}

SampleResult trace_features(const FrameContext& context, const PathOptions& options, const CameraSample& camera,
                            Features features, ChainFeatures* chains) {
  SampleResult result;
  if (chains) chains->start();
  Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, camera.time};
  Rgb beta(1.0f);
  Vec3f previous = ray.o;
  Vertex v;
  for (std::uint32_t index = 0; int(index) < options.max_depth; ++index) {
    int passed = 0;
    float pass_probability = 1;
    const EdgeEnd end =
        follow(context, camera.stream, index, ray, index == 0 ? &camera : nullptr, v, passed, pass_probability);
    result.rays += std::uint32_t(passed) + 1;
    if (end == EdgeEnd::kEnvironment && chains && chains->active()) chains->leave(beta);
    if (end != EdgeEnd::kSurface) break;
    const float distance = length(v.s.p - previous);
    beta *= absorption(v, distance);
    Rgb emitted;
    if (v.shape->emission && !(options.hide_emitters && index == 0)) {
      emitted = context.lights.emitted(v.hit.point, v.s);
    }
    v.make_bsdf();
    if (index == 0) {
      result.alpha = 1;
      result.first = first_hit(v, emitted, camera, features);
    }
    if (!chains || !chains->active()) break;
    chains->arrive(beta, v, emitted, previous, known_albedo(index, features, result));
    const VertexNumbers u = camera.stream.vertex(index);
    const auto sample = v.bsdf.sample(v.s.wo, u.lobe, u.direction);
    if (!sample || is_black(sample->sum())) break;
    chains->scatter(sample->f_cos);
    if (!chains->active()) break;
    beta *= sample->sum() * (1 / sample->pdf);
    previous = v.s.p;
    ray.o = context.rays.offset_origin(v.s.p, v.s.ng, sample->wi);
    ray.d = sample->wi;
    ray.tmin = 0;
    ray.tmax = kInfinity;
  }
  return result;
}

float transmittance(const FrameContext& context, Ray ray, int edges_left) {
  float t = 1;
  for (int i = 0; i < kMaxVertices; ++i) {
    const auto hit = context.rays.intersect(ray);
    if (!hit) return t;
    const Material& material = *context.rays.shape(hit->point).material;
    if (!material.has_opacity() || --edges_left < 0) return 0;
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

}  // namespace tempera
