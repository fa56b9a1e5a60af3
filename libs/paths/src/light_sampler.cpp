// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_sampler.h"

#include <cmath>

#include "light_sampler_impl.h"

namespace tempera {

namespace {

bool is_directed(const AreaEmission& e) { return e.half_spread < kPi / 2 || e.spot; }

/// Light through a grid of slats that hide everything beyond `half_spread` radians from the normal: 1 - tan /
/// tan(spread) of a direction passes. Scaled so that the power stays: the mean over cosine-weighted directions is 1 -
/// spread / tan(spread).
float spread_factor(float half_spread, float cosine) {
  if (!(half_spread < kPi / 2)) return 1;
  const float tan_spread = std::tan(half_spread);
  const float tangent = std::sqrt(std::max(0.0f, 1 - cosine * cosine)) / std::max(cosine, 1e-6f);
  // tan(a) - a cancels for small angles.
  const float a2 = half_spread * half_spread;
  const float norm = half_spread < 0.1f ? half_spread * a2 * (1 / 3.0f + a2 * (2 / 15.0f + a2 * (17 / 315.0f)))
                                        : tan_spread - half_spread;
  return std::max(0.0f, tan_spread - tangent) / norm;
}

}  // namespace

Rgb spot_factor(const PunctualLight& light, const Vec3f& local, double t) {
  if (local.z <= 0) return Rgb(0.0f);
  const float cutoff = light.cutoff_angle.at(t), beam = std::min(light.beam_width.at(t), cutoff);
  float falloff = 1;
  if (light.falloff == SpotFalloff::kLinear) {
    if (local.z < std::cos(beam)) {
      falloff = std::clamp((cutoff - std::acos(local.z)) / std::max(1e-6f, cutoff - beam), 0.0f, 1.0f);
    }
  } else {
    const float inner = std::cos(beam), outer = std::cos(cutoff);
    const bool gltf = light.falloff == SpotFalloff::kSquared;  // KHR_lights_punctual, "Inner and Outer Cone Angles"
    const float x = std::clamp((local.z - outer) / std::max(gltf ? 1e-3f : 1e-6f, inner - outer), 0.0f, 1.0f);
    falloff = gltf ? sqr(x) : x * x * (3 - 2 * x);
  }
  if (falloff <= 0 || !light.texture) return Rgb(falloff);
  ShadingPoint s;
  s.time = t;
  const float k = 0.5f / (local.z * std::tan(cutoff));
  s.uv = {0.5f + k * local.x, 0.5f + k * local.y};
  return light.texture->rgb(s) * falloff;
}

LightSampler::LightSampler(LightSampler&&) noexcept = default;
LightSampler::~LightSampler() = default;
bool LightSampler::empty() const { return impl_->choice.empty(); }
bool LightSampler::has_environment() const { return !impl_->environments.empty() || !impl_->suns.empty(); }

float LightSampler::Impl::area_of(const AreaLight& light, double t) const {
  if (light.mesh) return float(light.triangles.total());  // mean over the span
  const Affine3f m = world_from_unit(light, t);
  // Scale factor by the geometric mean: exact for similarities; only steers the choice of lights otherwise.
  const float scale = std::cbrt(std::abs(m.determinant()));
  const float unit = analytic::unit_area(*light.analytic);
  return light.analytic == AnalyticKind::kSphere ? unit * sqr(scale)
         : light.analytic == AnalyticKind::kDisk
             ? unit * length(cross(m.x, m.y))
             : unit * std::sqrt(0.5f * (length_squared(m.x) + length_squared(m.y))) * length(m.z);
}

LightReach LightSampler::Impl::reach_of(const AreaLight& light, float radiance) const {
  Bounds3f box;
  if (light.mesh) {
    for (std::uint32_t k = 0; k < light.mesh->triangle_count(); ++k) {
      for (const Vec2f b : {Vec2f{0, 0}, Vec2f{1, 0}, Vec2f{0, 1}}) {
        box.extend(rays->position({light.instance, light.shape, k, b.x, b.y}, reference_time));
      }
    }
  } else {
    const Affine3f m = world_from_unit(light, reference_time);
    for (int i = 0; i < 8; ++i) box.extend(m.point({i & 1 ? 1.0f : -1.0f, i & 2 ? 1.0f : -1.0f, i & 4 ? 1.0f : -1.0f}));
  }
  return {.constant = 0,
          .near = radiance * area_of(light, reference_time) * spread_factor(light.emission->half_spread, 1),
          .center = box.center(),
          .radius = std::max(box.radius(), 1e-6f * rays->bounds().radius())};
}

LightSampler::LightSampler(const Scene& scene, const RayScene& rays) : impl_(std::make_unique<Impl>()) {
  Impl& s = *impl_;
  s.scene = &scene;
  s.rays = &rays;
  s.span = rays.rays();
  s.reference_time = 0.5 * (s.span.begin + s.span.end);
  std::vector<float> powers;
  std::vector<LightReach> reaches;
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& instance = scene.instances[i];
    if (!scene.visible(instance.node, s.reference_time)) continue;
    const bool moving = !s.place(instance.node).fixed;
    for (const int shape_index : scene.groups[instance.group]) {
      const Shape& shape = scene.shapes[shape_index];
      if (!shape.emission) continue;
      const Slot& emitted = shape.emission->radiance;
      const float radiance =
          s.mean_over_span([&](double t) { return std::max(0.0f, luminance(emitted.mean(t))); }, emitted.factor);
      if (!(radiance > 0)) continue;
      AreaLight light;
      light.instance = i;
      light.shape = std::uint32_t(shape_index);
      light.emission = &*shape.emission;
      light.mesh = std::get_if<Mesh>(&shape.geometry);
      if (light.mesh) {
        // Over the span, where it may be flat at any one time.
        std::vector<double> times{s.reference_time};
        if (moving || light.mesh->deforms()) times = {s.span.begin, s.reference_time, s.span.end};
        std::vector<float> areas(light.mesh->triangle_count());
        for (std::uint32_t k = 0; k < areas.size(); ++k) {
          for (const double t : times) areas[k] += rays.triangle_area(i, light.shape, k, t) / float(times.size());
        }
        light.triangles = Discrete(areas);
        if (!(light.triangles.total() > 0)) continue;
        if (!moving && !light.mesh->deforms()) {
          light.fixed_pdf_area = float(1 / light.triangles.total());
          for (std::uint32_t k = 0; k < light.mesh->triangle_count(); ++k) {
            FixedTriangle f;
            f.p = rays.position({i, light.shape, k, 0, 0}, s.reference_time, &f.ng);
            f.e1 = rays.position({i, light.shape, k, 1, 0}, s.reference_time) - f.p;
            f.e2 = rays.position({i, light.shape, k, 0, 1}, s.reference_time) - f.p;
            light.fixed.push_back(f);
          }
        }
      } else {
        light.analytic = std::get<AnalyticShape>(shape.geometry).kind;
      }
      reaches.push_back(s.reach_of(light, radiance));
      powers.push_back(kPi * radiance * s.area_of(light, s.reference_time) * (light.emission->two_sided ? 2.0f : 1.0f));
      s.area_index[(std::uint64_t(i) << 32) | light.shape] = std::uint32_t(s.areas.size());
      s.areas.push_back(std::move(light));
    }
  }
  const float radius = std::max(rays.bounds().radius(), 1e-6f);
  for (const PunctualLight& light : scene.lights) {
    s.punctual_places.push_back(s.place(light.node));
    const float intensity = s.mean_over_span(
        [&](double t) { return std::max(0.0f, luminance(light.intensity.at(t)) * light.intensity_scale.at(t)); },
        light.intensity, light.intensity_scale);
    const float cone = s.mean_over_span([&](double t) { return 2 * kPi * (1 - std::cos(light.cutoff_angle.at(t))); },
                                        light.cutoff_angle);
    const bool shown = scene.visible(light.node, s.reference_time);
    if (shown && light.type == LightType::kDirectional && light.angle > 0) {
      const float half = 0.5f * light.angle;
      s.suns.push_back({s.punctual_places.size() - 1, one_minus_cosine(half), sqr(std::sin(half))});
    }
    LightReach reach;
    if (shown && light.type == LightType::kDirectional) reach.constant = intensity;
    if (shown && light.type != LightType::kDirectional) {
      reach.near = intensity;
      reach.center = s.punctual_places.back().world.translation;
      reach.radius = 1e-3f * radius;
    }
    reaches.push_back(reach);
    powers.push_back(!shown                                  ? 0.0f
                     : light.type == LightType::kDirectional ? intensity * kPi * sqr(radius)
                     : light.type == LightType::kPoint       ? intensity * 4 * kPi
                                                             : intensity * cone);
  }
  for (const Environment& environment : scene.environments) {
    EnvironmentMap e;
    e.environment = &environment;
    e.place = s.place(environment.node);
    double mean_luminance = 1;
    if (!environment.image.empty()) {
      const int w = environment.width, h = environment.height;
      std::vector<float> row_sums(static_cast<std::size_t>(h)), weights(static_cast<std::size_t>(w));
      double sum = 0, norm = 0;
      const auto lum = [&](int x, int y) {
        return std::max(
            0.0f,
            luminance(
                environment.image[std::size_t(std::clamp(y, 0, h - 1)) * std::size_t(w) + std::size_t((x + w) % w)]));
      };
      for (int y = 0; y < h; ++y) {
        const float sin_theta = std::sin(kPi * (float(y) + 0.5f) / float(h));
        double row = 0;
        for (int x = 0; x < w; ++x) {
          // The picture is interpolated between texel centers: a texel's weight must cover its neighbours' share.
          float v = 0;
          for (int j = -1; j <= 1; ++j) {
            v += (j == 0 ? 0.5f : 0.25f) *
                 (0.25f * lum(x - 1, y + j) + 0.5f * lum(x, y + j) + 0.25f * lum(x + 1, y + j));
          }
          weights[x] = v;
          row += v;
        }
        e.columns.emplace_back(weights);
        row_sums[y] = float(row) * sin_theta;
        sum += row * sin_theta;
        norm += double(w) * sin_theta;
      }
      e.rows = Discrete(row_sums);
      mean_luminance = sum / norm;
    }
    const float radiance =
        float(mean_luminance) *
        s.mean_over_span([&](double t) { return std::max(0.0f, luminance(environment.radiance.at(t))); },
                         environment.radiance);
    reaches.push_back({.constant = kPi * radiance, .near = 0, .center = {}, .radius = 0});
    powers.push_back(radiance * 4 * kPi * kPi * sqr(radius));
    s.environments.push_back(std::move(e));
  }
  // Half by power, half evenly: power alone starves small lights that matter nearby.
  double total = 0;
  std::size_t usable = 0;
  for (const float p : powers) total += p, usable += p > 0;
  if (total > 0) {
    for (float& p : powers) p = p > 0 ? float(0.5 * p / total + 0.5 / double(usable)) : 0;
  }
  s.choice = LightChoice(reaches, powers);
  s.emits = total > 0;
}

float LightSampler::Impl::pdf_area(const AreaLight& light, const SurfacePoint& point, const Vec3f& ng, double t) const {
  if (light.fixed_pdf_area > 0) return light.fixed_pdf_area;
  if (light.mesh) {
    const float area = rays->triangle_area(light.instance, light.shape, point.primitive, t);
    return area > 0 ? light.triangles.probability(point.primitive) / area : 0;
  }
  // Area element of an affine map: |det M| |M^-T n|, with n the unit-space normal; expressed through the world normal.
  const Affine3f m = world_from_unit(light, t);
  const Vec3f unit_normal = m.transposed_vector(ng);  // M^T n_world is parallel to the unit-space normal
  const float stretch = std::abs(m.determinant()) / length(unit_normal);
  return 1 / (analytic::unit_area(*light.analytic) * stretch);
}

/// How much of its radiance a surface with normal ng sends in unit direction wo.
Rgb LightSampler::Impl::directed(const AreaEmission& emission, const Vec3f& ng, const Vec3f& wo, double t) const {
  Rgb factor(spread_factor(emission.half_spread, std::abs(dot(ng, wo))));
  if (emission.spot) {
    const Affine3f m(scene->world(emission.spot->node, t));
    factor *=
        spot_factor(*emission.spot, {dot(wo, normalize(m.x)), dot(wo, normalize(m.y)), dot(wo, normalize(m.z))}, t);
  }
  return factor;
}

TEMPERA_INLINE bool LightSampler::Impl::sample_area(const AreaLight& light, const Vec3f& p, double t, float u1, Vec2f u,
                                                    LightSample& r) const {
  SurfacePoint& point = r.point.emplace(even_point(light, u1, u));
  if (const auto sphere = round_sphere(light, t)) {
    const Vec3f to_center = sphere->center - p;
    const float d2 = length_squared(to_center), r2 = sqr(sphere->radius);
    const Affine3f unit_from_world = inverse(world_from_unit(light, t));
    if (d2 > r2 * 1.0001f) {  // the visible cap, by solid angle
      const float sin2_max = r2 / d2, cos_max = std::sqrt(std::max(0.0f, 1 - sin2_max));
      const float one_minus_cos_max = sin2_max < 1e-3f ? 0.5f * sin2_max * (1 + 0.25f * sin2_max) : 1 - cos_max;
      const float one_minus_cos = u.x * one_minus_cos_max, cos_theta = 1 - one_minus_cos;
      const float sin_theta = std::sqrt(std::max(0.0f, one_minus_cos * (1 + cos_theta))), phi = 2 * kPi * u.y;
      const Basis b(to_center * (1 / std::sqrt(d2)));
      const Vec3f w = b.to_world({sin_theta * std::cos(phi), sin_theta * std::sin(phi), cos_theta});
      const float along = dot(to_center, w);
      const float half_chord = std::sqrt(std::max(0.0f, r2 - (d2 - along * along)));
      const Vec3f q = unit_from_world.point(p + w * (along - half_chord));
      const Vec2f uv = analytic::sphere_uv(normalize(q));
      point.u = uv.x, point.v = uv.y;
    }
  }
  return from_area(light, p, t, r);
}

/// Density of directions from p over the part of a round sphere that p sees, which is sampled by solid angle: 0 for
/// points q of the sphere that p does not see. Empty for lights that are sampled by area.
std::optional<float> LightSampler::Impl::cap_pdf(const AreaLight& light, const Vec3f& q, const Vec3f& p,
                                                 double t) const {
  const auto sphere = round_sphere(light, t);
  if (!sphere) return std::nullopt;
  const float d2 = length_squared(sphere->center - p), r2 = sqr(sphere->radius);
  if (!(d2 > r2 * 1.0001f)) return std::nullopt;
  if (dot(q - sphere->center, p - q) < 0) return 0.0f;
  const float sin2 = r2 / d2;
  const float one_minus_cos = sin2 < 1e-3f ? 0.5f * sin2 * (1 + 0.25f * sin2) : 1 - std::sqrt(std::max(0.0f, 1 - sin2));
  return 1 / (2 * kPi * one_minus_cos);
}

/// Light from the point of an area light that `r` holds.
bool LightSampler::Impl::from_area(const AreaLight& light, const Vec3f& p, double t, LightSample& r) const {
  const SurfacePoint& point = *r.point;
  Vec3f q, ng;
  locate(light, point, t, q, ng);
  const Vec3f to_light = q - p;
  const float d2 = length_squared(to_light);
  if (!(d2 > 0)) return false;
  r.distance = std::sqrt(d2);
  r.wi = to_light * (1 / r.distance);
  const float cosine = -dot(ng, r.wi);
  if (cosine == 0) return false;
  if (light.fixed_pdf_area > 0) {
    r.pdf = light.fixed_pdf_area * d2 / std::abs(cosine);
  } else {
    const auto cap = cap_pdf(light, q, p, t);
    r.pdf = cap ? *cap : pdf_area(light, point, ng, t) * d2 / std::abs(cosine);
  }
  if (cosine < 0 && !light.emission->two_sided) return true;
  const Slot& slot = light.emission->radiance;
  r.radiance = slot.is_constant() ? slot.factor.values()[0] : slot.rgb(rays->shading_point(point, t, -r.wi));
  if (is_directed(*light.emission)) r.radiance *= directed(*light.emission, ng, -r.wi, t);
  return true;
}

/// Light from the direction of a point in the picture of environment `index`; the others, and suns, shine from there,
/// too.
bool LightSampler::Impl::from_infinity(std::size_t index, const MapPoint& at, const Vec3f& p, double t,
                                       LightSample& r) const {
  r.wi = at.d;
  r.distance = kInfinity;
  for (std::size_t i = 0; i < environments.size(); ++i) {
    const EnvironmentMap& e = environments[i];
    const MapPoint here = i == index ? at : map_point(e, at.d, t);
    r.radiance += radiance(e, here, t);
    r.pdf += choice.probability(p, std::uint32_t(first_environment() + i)) * pdf(e, here);
  }
  for (const Sun& s : suns) {
    if (!contains(s, at.d, t)) continue;
    r.radiance += radiance(s, t);
    r.pdf += choice.probability(p, std::uint32_t(areas.size() + s.light)) * pdf(s);
  }
  return r.pdf > 0;
}

bool LightSampler::Impl::from_punctual(std::size_t index, const Vec3f& p, double t, LightSample& r) const {
  const PunctualLight& light = scene->lights[index];
  const Affine3f world = this->world(punctual_places[index], t);
  const Vec3f axis = normalize(world.z);
  const Rgb intensity = light.intensity.at(t) * light.intensity_scale.at(t);
  r.delta = true;
  if (light.type == LightType::kDirectional) {
    r.wi = -axis;
    r.distance = kInfinity;
    r.radiance = intensity;
    return true;
  }
  const Vec3f to_light = world.translation - p;
  const float d2 = length_squared(to_light);
  if (!(d2 > 0)) return false;
  r.distance = std::sqrt(d2);
  r.wi = to_light * (1 / r.distance);
  if (light.type == LightType::kPoint) {
    r.radiance = intensity * (1 / d2);
    return true;
  }
  // Direction from the light in its own frame; rotation only, a light has no size.
  const Vec3f local{-dot(r.wi, normalize(world.x)), -dot(r.wi, normalize(world.y)), -dot(r.wi, axis)};
  if (local.z <= 0) return true;  // dark
  ShadingPoint s;
  s.time = t;
  if (light.type == LightType::kProjector) {
    const float tan_x = std::tan(0.5f * light.projector_fov), tan_y = tan_x / light.projector_aspect;
    s.uv = {0.5f - 0.5f * local.x / (local.z * tan_x), 0.5f - 0.5f * local.y / (local.z * tan_y)};
    if (!(s.uv.x >= 0 && s.uv.x <= 1 && s.uv.y >= 0 && s.uv.y <= 1)) return true;
    const float depth = local.z * r.distance;
    r.radiance = intensity * (1 / (depth * depth * local.z));
    if (light.texture) r.radiance *= light.texture->rgb(s);
    return true;
  }
  r.radiance = spot_factor(light, local, t);
  if (!is_black(r.radiance)) r.radiance *= intensity * (1 / d2);
  return true;
}

std::optional<LightSample> LightSampler::sample(const Vec3f& p, double t, float u_choice, const Vec2f& u) const {
  const Impl& s = *impl_;
  std::optional<LightSample> result;
  if (s.choice.empty()) return result;
  const auto [light, probability] = s.choice.sample(p, u_choice);
  if (!(probability > 0)) return result;
  LightSample& r = result.emplace();
  r.light = light;
  bool found;
  if (light < s.areas.size()) {
    found = s.sample_area(s.areas[light], p, t, u_choice, u, r);
    r.pdf *= probability;
  } else if (light < s.first_environment()) {
    if (const Impl::Sun* sun = s.sun_of(light - s.areas.size())) {
      const Vec3f d = sample_cone(s.direction(*sun, t), sun->one_minus_cos, u);
      found = s.from_infinity(Impl::kNone, {d, {}, 0}, p, t, r);
    } else {
      found = s.from_punctual(light - s.areas.size(), p, t, r);
      r.pdf = probability;
    }
  } else {
    const std::size_t i = light - s.first_environment();
    found = s.from_infinity(i, s.sample_direction(s.environments[i], t, u), p, t, r);
  }
  if (!found || !(r.pdf > 0)) result.reset();  // rounding can pick what lies just out of sight
  return result;
}

std::optional<LightSample> LightSampler::connect(const LightSample& sample, const Vec3f& p, double t) const {
  const Impl& s = *impl_;
  std::optional<LightSample> result;
  LightSample& r = result.emplace();
  r.light = sample.light;
  bool found;
  if (sample.light < s.areas.size()) {
    r.point = sample.point;
    found = s.from_area(s.areas[sample.light], p, t, r);
    r.pdf *= s.choice.probability(p, sample.light);
  } else if (sample.light < s.first_environment()) {
    if (s.sun_of(sample.light - s.areas.size())) {
      found = s.from_infinity(Impl::kNone, {sample.wi, {}, 0}, p, t, r);
    } else {
      found = s.from_punctual(sample.light - s.areas.size(), p, t, r);
      r.pdf = s.choice.probability(p, sample.light);
    }
  } else {
    const std::size_t i = sample.light - s.first_environment();
    found = s.from_infinity(i, s.map_point(s.environments[i], sample.wi, t), p, t, r);
  }
  if (!found) result.reset();
  return result;
}

Rgb LightSampler::emitted(const SurfacePoint& point, const ShadingPoint& s) const {
  const auto& emission = impl_->scene->shapes[point.shape].emission;
  if (!emission || (!emission->two_sided && dot(s.wo, s.ng) <= 0)) return Rgb(0.0f);
  const Rgb radiance = emission->radiance.rgb(s);
  return is_directed(*emission) ? radiance * impl_->directed(*emission, s.ng, s.wo, s.time) : radiance;
}

float LightSampler::pdf(const SurfacePoint& point, const ShadingPoint& s, const Vec3f& from, float distance) const {
  const auto it = impl_->area_index.find((std::uint64_t(point.instance) << 32) | point.shape);
  if (it == impl_->area_index.end()) return 0;
  const AreaLight& light = impl_->areas[it->second];
  const float probability = impl_->choice.probability(from, it->second);
  if (const auto cap = impl_->cap_pdf(light, s.p, from, s.time)) return probability * *cap;
  const float cosine = std::abs(dot(s.ng, s.wo));
  return cosine > 0 ? probability * impl_->pdf_area(light, point, s.ng, s.time) * sqr(distance) / cosine : 0;
}

Rgb LightSampler::environment(const Vec3f& d, double t, bool from_camera) const {
  return environment(d, t, from_camera, {});
}

Rgb LightSampler::environment(const Vec3f& d, double t, bool from_camera, std::span<const char> lights) const {
  const auto wanted = [&](std::size_t light) { return lights.empty() || lights[light]; };
  Rgb sum;
  for (std::size_t i = 0; i < impl_->environments.size(); ++i) {
    const EnvironmentMap& e = impl_->environments[i];
    if (!wanted(impl_->first_environment() + i)) continue;
    if (!from_camera || e.environment->camera_visible) sum += impl_->radiance(e, impl_->map_point(e, d, t), t);
  }
  for (const Impl::Sun& sun : impl_->suns) {
    if (!wanted(impl_->areas.size() + sun.light)) continue;
    const bool seen = !from_camera || impl_->scene->lights[sun.light].camera_visible;
    if (seen && impl_->contains(sun, d, t)) sum += impl_->radiance(sun, t);
  }
  return sum;
}

std::uint32_t LightSampler::light_of(const SurfacePoint& point) const {
  const auto it = impl_->area_index.find((std::uint64_t(point.instance) << 32) | point.shape);
  return it == impl_->area_index.end() ? 0 : it->second;
}

float LightSampler::environment_pdf(const Vec3f& d, double t, const Vec3f& from) const {
  float sum = 0;
  for (std::size_t i = 0; i < impl_->environments.size(); ++i) {
    const EnvironmentMap& e = impl_->environments[i];
    sum += impl_->choice.probability(from, std::uint32_t(impl_->first_environment() + i)) *
           impl_->pdf(e, impl_->map_point(e, d, t));
  }
  for (const Impl::Sun& sun : impl_->suns) {
    if (!impl_->contains(sun, d, t)) continue;
    sum += impl_->choice.probability(from, std::uint32_t(impl_->areas.size() + sun.light)) * impl_->pdf(sun);
  }
  return sum;
}

Vec3f LightSampler::environment_motion(const Vec3f& d, double from, double to) const {
  for (const EnvironmentMap& e : impl_->environments) {
    if (e.place.fixed) continue;
    return normalize(impl_->world(e.place, to).vector(impl_->world(e.place, from).transposed_vector(d)));
  }
  return d;
}

}  // namespace tempera
