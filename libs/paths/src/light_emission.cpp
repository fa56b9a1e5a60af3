// SPDX-License-Identifier: Apache-2.0
// Light leaving its source: points, directions and their densities, by kind of light.
#include <cmath>

#include "light_sampler_impl.h"
#include "tempera/shading/microfacet.h"

namespace tempera {

namespace {

/// Smallest cone that is sampled: one of no size has no density.
constexpr float kSmallestCone = 1e-12f;

/// 1 - cos of the cone in which a spot shines; none shines behind itself.
float cone_of(const PunctualLight& spot, double t) {
  return std::max(one_minus_cosine(std::min(spot.cutoff_angle.at(t), kPi / 2)), kSmallestCone);
}

/// Half of the extent of a projector's picture at distance 1.
Vec2f half_picture(const PunctualLight& light) {
  const float x = std::tan(0.5f * light.projector_fov);
  return {x, x / light.projector_aspect};
}

/// Squared sine of the angle from its normal within which a surface emits.
float sin2_of(const AreaEmission& emission) {
  return emission.half_spread < kPi / 2 ? sqr(std::sin(emission.half_spread)) : 1.0f;
}

}  // namespace

/// Spots that have a size are sampled by their cone, whatever the normal: the falloff varies more than the cosine.
float LightSampler::Impl::direction_pdf(const AreaLight& light, const Vec3f& ng, const Vec3f& w, double t) const {
  const AreaEmission& emission = *light.emission;
  if (emission.spot) {
    const float cone = cone_of(*emission.spot, t);
    return in_cone(spot_axis(*emission.spot, t), cone, w) ? cone_pdf(cone) : 0;
  }
  const float cosine = emission.two_sided ? std::abs(dot(ng, w)) : dot(ng, w), sin2 = sin2_of(emission);
  if (!(cosine > 0) || (sin2 < 1 && length_squared(cross(ng, w)) > sin2 * (1 + 1e-4f))) return 0;
  return cosine * kInvPi / sin2 * (emission.two_sided ? 0.5f : 1.0f);
}

Vec3f LightSampler::Impl::sample_direction(const AreaLight& light, const Vec3f& ng, double t, Vec2f u) const {
  const AreaEmission& emission = *light.emission;
  if (emission.spot) return sample_cone(spot_axis(*emission.spot, t), cone_of(*emission.spot, t), u);
  bool back = false;
  if (emission.two_sided) {
    back = u.x >= 0.5f;
    u.x = 2 * u.x - (back ? 1.0f : 0.0f);
  }
  const Vec2f disk = square_to_disk(u) * std::sqrt(sin2_of(emission));
  return Basis(ng).to_world({disk.x, disk.y, std::sqrt(std::max(0.0f, 1 - dot(disk, disk))) * (back ? -1.0f : 1.0f)});
}

void LightSampler::Impl::emit_area(const AreaLight& light, double t, float u1, const Vec2f& position,
                                   const Vec2f& direction, LightEnd& e) const {
  const AreaEmission& emission = *light.emission;
  const SurfacePoint& point = e.point.emplace(even_point(light, u1, position));
  locate(light, point, t, e.p, e.n);
  e.w = sample_direction(light, e.n, t, direction);
  e.pdf_position = pdf_area(light, point, e.n, t);
  e.pdf_direction = direction_pdf(light, e.n, e.w, t);
  if (dot(e.n, e.w) < 0 && !emission.two_sided) return;
  e.radiance = emission.radiance.rgb(rays->shading_point(point, t, e.w)) * directed(emission, e.n, e.w, t);
}

float LightSampler::Impl::direction_pdf(const PunctualLight& light, const Affine3f& world, const Vec3f& w,
                                        double t) const {
  if (light.type == LightType::kPoint) return 0.25f * kInvPi;
  const Vec3f axis = normalize(world.z);
  if (light.type == LightType::kSpot) {
    const float cone = cone_of(light, t);
    return in_cone(axis, cone, w) ? cone_pdf(cone) : 0;
  }
  // Evenly over the picture at distance 1, whose solid angle shrinks by the cube of the cosine.
  const float cosine = dot(w, axis);
  if (!(cosine > 0)) return 0;
  const Vec2f half = half_picture(light);
  const float x = dot(w, normalize(world.x)) / cosine, y = dot(w, normalize(world.y)) / cosine;
  constexpr float kRounding = 1 + 1e-5f;
  if (std::abs(x) > half.x * kRounding || std::abs(y) > half.y * kRounding) return 0;
  return 1 / (4 * half.x * half.y * cosine * cosine * cosine);
}

void LightSampler::Impl::emit_punctual(std::size_t index, double t, const Vec2f& direction, LightEnd& e) const {
  const PunctualLight& light = scene->lights[index];
  const Affine3f world = this->world(punctual_places[index], t);
  const Vec3f x = normalize(world.x), y = normalize(world.y), axis = normalize(world.z);  // a light has no size
  e.delta_position = true;
  e.pdf_position = 1;
  e.p = world.translation;
  const Rgb intensity = light.intensity.at(t) * light.intensity_scale.at(t);
  if (light.type == LightType::kPoint) {
    e.w = sample_cone({0, 0, 1}, 2, direction);
    e.radiance = intensity;
  } else if (light.type == LightType::kSpot) {
    e.w = sample_cone(axis, cone_of(light, t), direction);
    e.radiance = intensity * spot_factor(light, {dot(e.w, x), dot(e.w, y), dot(e.w, axis)}, t);
  } else {
    const Vec2f half = half_picture(light), at{1 - 2 * direction.x, 1 - 2 * direction.y};
    e.w = normalize(x * (at.x * half.x) + y * (at.y * half.y) + axis);
    const float cosine = dot(e.w, axis);
    e.radiance = intensity * (1 / (cosine * cosine * cosine));
    ShadingPoint s;
    s.time = t;
    s.uv = direction;
    if (light.texture) e.radiance *= light.texture->rgb(s);
  }
  e.pdf_direction = direction_pdf(light, world, e.w, t);
}

EmissionPdf LightSampler::Impl::infinite_pdf(const Vec3f& to_light, double t) const {
  EmissionPdf r{0, kInvPi / sqr(radius()), 0};
  const auto add = [&](std::size_t light, float pdf) {
    const float probability = choice.by_power().probability(std::uint32_t(light));
    r.choice += probability;
    r.direction += probability * pdf;
  };
  for (std::size_t i = 0; i < environments.size(); ++i) {
    add(first_environment() + i, pdf(environments[i], map_point(environments[i], to_light, t)));
  }
  for (const Sun& s : suns) add(areas.size() + s.light, contains(s, to_light, t) ? pdf(s) : 0);
  if (r.choice > 0) r.direction /= r.choice;
  return r;
}

/// Through the disk, from the direction `to_light`, from which all environments and suns shine.
void LightSampler::Impl::emit_infinite(const Vec3f& to_light, double t, const Vec2f& position, LightEnd& e) const {
  from_disk(-to_light, position, e);
  const EmissionPdf pdf = infinite_pdf(to_light, t);
  e.pdf_choice = pdf.choice, e.pdf_direction = pdf.direction;
  for (const EnvironmentMap& environment : environments) {
    e.radiance += radiance(environment, map_point(environment, to_light, t), t);
  }
  for (const Sun& s : suns) {
    if (contains(s, to_light, t)) e.radiance += radiance(s, t);
  }
}

void LightSampler::Impl::from_disk(const Vec3f& w, const Vec2f& position, LightEnd& e) const {
  const float r = radius();
  const Vec2f disk = square_to_disk(position) * r;
  const Basis b(w);
  e.infinite = true;
  e.w = e.n = w;
  e.p = center() + b.s * disk.x + b.t * disk.y - w * r;
  e.pdf_position = kInvPi / sqr(r);
}

std::optional<LightEnd> LightSampler::emit(double t, float u, const Vec2f& position, const Vec2f& direction) const {
  const Impl& s = *impl_;
  if (!s.emits) return std::nullopt;
  std::optional<LightEnd> result;
  LightEnd& e = result.emplace();
  e.light = s.choice.by_power().sample(u);
  e.pdf_choice = s.choice.by_power().probability(e.light);
  if (e.light < s.areas.size()) {
    s.emit_area(s.areas[e.light], t, u, position, direction, e);
  } else if (e.light >= s.first_environment()) {
    s.emit_infinite(s.sample_direction(s.environments[e.light - s.first_environment()], t, direction).d, t, position,
                    e);
  } else {
    const std::size_t i = e.light - s.areas.size();
    const PunctualLight& light = s.scene->lights[i];
    if (const Impl::Sun* sun = s.sun_of(i)) {
      s.emit_infinite(sample_cone(s.direction(*sun, t), sun->one_minus_cos, direction), t, position, e);
    } else if (light.type == LightType::kDirectional) {
      s.from_disk(normalize(s.world(s.punctual_places[i], t).z), position, e);
      e.delta_direction = true;
      e.pdf_direction = 1;
      e.radiance = light.intensity.at(t) * light.intensity_scale.at(t);
    } else {
      s.emit_punctual(i, t, direction, e);
    }
  }
  const double pdf = double(e.pdf_choice) * double(e.pdf_position) * double(e.pdf_direction);
  if (!(pdf > 0)) return std::nullopt;
  e.beta = e.radiance * float((e.delta_position ? 1.0 : std::abs(double(dot(e.n, e.w)))) / pdf);
  return result;
}

EmissionPdf LightSampler::emission_pdf(const LightEnd& end, const Vec3f& w, double t) const {
  const Impl& s = *impl_;
  if (!s.emits) return {};
  EmissionPdf r{s.choice.by_power().probability(end.light), 1, 1};
  if (end.light < s.areas.size()) {
    const AreaLight& light = s.areas[end.light];
    Vec3f p, ng;
    s.locate(light, *end.point, t, p, ng);
    r.position = s.pdf_area(light, *end.point, ng, t);
    r.direction = s.direction_pdf(light, ng, w, t);
    return r;
  }
  const std::size_t i = end.light - s.areas.size();
  if (end.light >= s.first_environment() || s.sun_of(i)) return s.infinite_pdf(-w, t);
  const PunctualLight& light = s.scene->lights[i];
  if (light.type == LightType::kDirectional) {
    r.position = kInvPi / sqr(s.radius());
  } else {
    r.direction = s.direction_pdf(light, s.world(s.punctual_places[i], t), w, t);
  }
  return r;
}

}  // namespace tempera
