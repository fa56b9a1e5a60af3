// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_sampler.h"

#include <cmath>
#include <unordered_map>

#include "distribution.h"
#include "light_choice.h"

namespace tempera {

namespace {

/// A triangle of a light that does not move, ready for sampling.
struct FixedTriangle {
  Vec3f p, e1, e2, ng;
};

/// World transform of a node, evaluated once if it never moves.
struct Place {
  int node = -1;
  bool fixed = false;
  Affine3f world;
};

/// An emitting shape at one place.
struct AreaLight {
  std::uint32_t instance = 0, shape = 0;
  const AreaEmission* emission = nullptr;
  const Mesh* mesh = nullptr;        // null: analytic
  Discrete triangles;                // by area at the reference time
  float fixed_pdf_area = 0;          // 1 / area where the surface never moves; 0: ask at the time
  std::vector<FixedTriangle> fixed;  // of a mesh that never moves
  int analytic = -1;                 // index of the geometry variant: 1 sphere, 2 disk, 3 cylinder
};

/// Piecewise constant density over the texels of a latitude-longitude picture.
struct EnvironmentMap {
  const Environment* environment = nullptr;
  Discrete rows;
  std::vector<Discrete> columns;
  Place place;
};

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

/// How much of its intensity a spot sends in a direction, in its own frame with z the axis.
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

}  // namespace

struct LightSampler::Impl {
  const Scene* scene = nullptr;
  const RayScene* rays = nullptr;
  std::vector<AreaLight> areas;
  std::vector<EnvironmentMap> environments;
  std::unordered_map<std::uint64_t, std::uint32_t> area_index;  // (instance, shape) -> areas
  LightChoice choice;                                           // areas, then punctual lights, then environments
  TimeSpan span;                                                // of the rays
  double reference_time = 0;                                    // its middle

  /// Means over the span of what changes within it: a light that is off in the middle may shine at its ends. Keys are
  /// looked at, and some times between.
  template <class F, class... T>
  float mean_over_span(F&& value, const Animated<T>&... sources) const {
    constexpr int kTimes = 8;
    if ((!sources.varies_over(span) && ...)) return value(reference_time);
    double sum = 0;
    int count = 0;
    const auto add = [&](double t) { sum += value(t), ++count; };
    for (int i = 0; i <= kTimes; ++i) add(span.begin + span.length() * i / kTimes);
    const auto add_keys = [&](const auto& source) {
      for (const double t : source.times()) {
        if (span.contains(t)) add(t);
      }
    };
    (add_keys(sources), ...);
    return float(sum / count);
  }

  std::vector<Place> punctual_places;
  Place place(int node) const {
    return {node, !scene->moves(node, {-kInfinity, kInfinity}), Affine3f(scene->world(node, reference_time))};
  }
  Affine3f world(const Place& p, double t) const { return p.fixed ? p.world : Affine3f(scene->world(p.node, t)); }

  /// A direction, and where it points in the picture of one environment.
  struct MapPoint {
    Vec3f d;
    Vec2f uv;
    float sin_theta = 0;
  };
  MapPoint map_point(const EnvironmentMap& e, const Vec3f& d, double t) const {
    if (e.environment->image.empty()) return {d, {}, 0};
    const Vec3f local = world(e.place, t).transposed_vector(d);
    const float u = std::atan2(local.x, -local.z) * (0.5f * kInvPi);
    return {d,
            {u < 0 ? u + 1 : u, std::acos(std::clamp(local.y, -1.0f, 1.0f)) * kInvPi},
            std::sqrt(std::max(0.0f, 1 - local.y * local.y))};
  }
  static Rgb texture(const Environment& e, const Vec2f& uv) {
    const float x = uv.x * float(e.width) - 0.5f,
                y = std::clamp(uv.y * float(e.height) - 0.5f, 0.0f, float(e.height - 1));
    const int x0 = int(std::floor(x)), y0 = int(y), y1 = std::min(y0 + 1, e.height - 1);
    const float fx = x - float(x0), fy = y - float(y0);
    const auto at = [&](int i, int j) -> const Rgb& {
      i = i < 0 ? i + e.width : i >= e.width ? i - e.width : i;
      return e.image[std::size_t(j) * std::size_t(e.width) + std::size_t(i)];
    };
    return (at(x0, y0) * (1 - fx) + at(x0 + 1, y0) * fx) * (1 - fy) +
           (at(x0, y1) * (1 - fx) + at(x0 + 1, y1) * fx) * fy;
  }
  Rgb radiance(const EnvironmentMap& e, const MapPoint& at, double t) const {
    const Rgb factor = e.environment->radiance.at(t);
    return e.environment->image.empty() ? factor : factor * texture(*e.environment, at.uv);
  }
  float pdf(const EnvironmentMap& e, const MapPoint& at) const {
    if (e.environment->image.empty()) return 0.25f * kInvPi;
    if (at.sin_theta <= 0) return 0;
    const int w = e.environment->width, h = e.environment->height;
    const auto row = std::uint32_t(std::clamp(int(at.uv.y * float(h)), 0, h - 1));
    const auto column = std::uint32_t(std::clamp(int(at.uv.x * float(w)), 0, w - 1));
    return e.rows.probability(row) * e.columns[row].probability(column) * float(w) * float(h) /
           (2 * kPi * kPi * at.sin_theta);
  }
  MapPoint sample_direction(const EnvironmentMap& e, double t, Vec2f u) const {
    if (e.environment->image.empty()) {
      const float z = 1 - 2 * u.x, r = std::sqrt(std::max(0.0f, 1 - z * z)), phi = 2 * kPi * u.y;
      return {{r * std::cos(phi), r * std::sin(phi), z}, {}, 0};
    }
    const std::uint32_t row = e.rows.sample(u.y), column = e.columns[row].sample(u.x);
    const Vec2f uv{(float(column) + u.x) / float(e.environment->width),
                   (float(row) + u.y) / float(e.environment->height)};
    const float phi = 2 * kPi * uv.x, theta = kPi * uv.y, s = std::sin(theta);
    const Vec3f local{s * std::sin(phi), std::cos(theta), -s * std::cos(phi)};
    return {normalize(world(e.place, t).vector(local)), uv, s};
  }
  std::size_t first_environment() const { return areas.size() + scene->lights.size(); }

  static constexpr std::size_t kNone = ~std::size_t(0);
  /// A directional light that comes from a disk of the sky, evenly: the directions of a cone.
  struct Sun {
    std::size_t light = 0;              // Scene::lights index
    float one_minus_cos = 0, sin2 = 0;  // of half of its angle
  };
  std::vector<Sun> suns;
  /// Radiance that gives the light's irradiance on a surface that faces the middle of the disk: E / (pi sin^2).
  Rgb radiance(const Sun& sun, double t) const {
    const PunctualLight& light = scene->lights[sun.light];
    return light.intensity.at(t) * (light.intensity_scale.at(t) * kInvPi / sun.sin2);
  }
  float pdf(const Sun& sun) const { return 0.5f * kInvPi / sun.one_minus_cos; }
  /// Towards the middle of the disk.
  Vec3f direction(const Sun& sun, double t) const { return -normalize(world(punctual_places[sun.light], t).z); }
  bool contains(const Sun& sun, const Vec3f& d, double t) const {
    const Vec3f middle = direction(sun, t);
    // 1 - cos of small angles needs the difference: |d - m|^2 = 2 (1 - cos).
    return length_squared(d - middle) <= 2 * sun.one_minus_cos * (1 + 1e-4f);  // as sampled, rounding included
  }
  const Sun* sun_of(std::size_t light) const {
    for (const Sun& s : suns) {
      if (s.light == light) return &s;
    }
    return nullptr;
  }

  /// Center and radius if the light is a sphere under a similarity at time t.
  struct RoundSphere {
    Vec3f center;
    float radius = 0;
  };
  std::optional<RoundSphere> round_sphere(const AreaLight& light, double t) const {
    if (light.analytic != 1) return std::nullopt;
    const Affine3f m = world_from_unit(light, t);
    const float a = length(m.x), b = length(m.y), c = length(m.z), eps = 1e-4f * a;
    if (std::abs(a - b) > eps || std::abs(a - c) > eps) return std::nullopt;
    return RoundSphere{m.translation, a};
  }
  Affine3f world_from_unit(const AreaLight& light, double t) const {
    return rays->world_from_unit(light.instance, light.shape, t);
  }

  float pdf_area(const AreaLight& light, const SurfacePoint& point, const Vec3f& ng, double t) const;
  // These fill a fresh sample; false: there is no direction to the light. Densities lack the choice of the light,
  // except for environments, which are one light.
  bool sample_area(const AreaLight& light, const Vec3f& p, double t, float u1, Vec2f u, LightSample& r) const;
  bool from_area(const AreaLight& light, const Vec3f& p, double t, LightSample& r) const;
  /// `index`: of the environment in whose picture `at` lies; kNone: of none.
  bool from_infinity(std::size_t index, const MapPoint& at, const Vec3f& p, double t, LightSample& r) const;
  Rgb directed(const AreaEmission& emission, const Vec3f& ng, const Vec3f& wo, double t) const;
  bool from_punctual(std::size_t index, const Vec3f& p, double t, LightSample& r) const;
  std::optional<float> cap_pdf(const AreaLight& light, const Vec3f& q, const Vec3f& p, double t) const;
  float area_of(const AreaLight& light, double t) const;
  LightReach reach_of(const AreaLight& light, float radiance) const;
};

LightSampler::LightSampler(LightSampler&&) noexcept = default;
LightSampler::~LightSampler() = default;
bool LightSampler::empty() const { return impl_->choice.empty(); }
bool LightSampler::has_environment() const { return !impl_->environments.empty() || !impl_->suns.empty(); }

float LightSampler::Impl::area_of(const AreaLight& light, double t) const {
  if (light.mesh) return float(light.triangles.total());  // mean over the span
  const Affine3f m = world_from_unit(light, t);
  // Scale factor by the geometric mean: exact for similarities; only steers the choice of lights otherwise.
  const float scale = std::cbrt(std::abs(m.determinant()));
  const float unit = light.analytic == 1 ? 4 * kPi : light.analytic == 2 ? kPi : 2 * kPi;
  return light.analytic == 1   ? unit * sqr(scale)
         : light.analytic == 2 ? kPi * length(cross(m.x, m.y))
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
    for (const int shape_index : scene.groups[std::size_t(instance.group)]) {
      const Shape& shape = scene.shapes[std::size_t(shape_index)];
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
        light.analytic = int(shape.geometry.index());
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
      const float half = 0.5f * light.angle, sine = std::sin(0.5f * half);
      s.suns.push_back({s.punctual_places.size() - 1, 2 * sine * sine, sqr(std::sin(half))});
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
          weights[std::size_t(x)] = v;
          row += v;
        }
        e.columns.emplace_back(weights);
        row_sums[std::size_t(y)] = float(row) * sin_theta;
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
  const float unit_area = light.analytic == 1 ? 4 * kPi : light.analytic == 2 ? kPi : 2 * kPi;
  return 1 / (unit_area * stretch);
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

inline bool LightSampler::Impl::sample_area(const AreaLight& light, const Vec3f& p, double t, float u1, Vec2f u,
                                            LightSample& r) const {
  SurfacePoint& point = r.point.emplace();
  point.instance = light.instance;
  point.shape = light.shape;
  if (light.mesh) {
    point.primitive = light.triangles.sample(u1);
    // Uniform barycentrics without the square root's distortion [Heitz 2019, A Low-Distortion Map].
    const float half = 0.5f * std::min(u.x, u.y);
    point.u = u.x - half, point.v = u.y - half;
  } else if (const auto sphere = round_sphere(light, t)) {
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
      const Vec3f n = normalize(q);
      point.u = std::atan2(n.y, n.x) * (0.5f * kInvPi);
      if (point.u < 0) point.u += 1;
      point.v = std::acos(std::clamp(n.z, -1.0f, 1.0f)) * kInvPi;
    } else {
      point.u = u.x;
      point.v = std::acos(1 - 2 * u.y) * kInvPi;
    }
  } else {
    point.u = u.x, point.v = u.y;
    if (light.analytic == 1) point.v = std::acos(1 - 2 * u.y) * kInvPi;
    if (light.analytic == 2) point.u = std::sqrt(u.x);
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
inline bool LightSampler::Impl::from_area(const AreaLight& light, const Vec3f& p, double t, LightSample& r) const {
  const SurfacePoint& point = *r.point;
  Vec3f q, ng;
  if (light.fixed.empty()) {
    q = rays->position(point, t, &ng);
  } else {
    const FixedTriangle& f = light.fixed[point.primitive];
    q = f.p + f.e1 * point.u + f.e2 * point.v;
    ng = f.ng;
  }
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
      const float h = u.x * sun->one_minus_cos, sine = std::sqrt(std::max(0.0f, h * (2 - h))), phi = 2 * kPi * u.y;
      const Basis b(s.direction(*sun, t));
      const Vec3f d = normalize(b.n * (1 - h) + (b.s * std::cos(phi) + b.t * std::sin(phi)) * sine);
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
  Rgb sum;
  for (const EnvironmentMap& e : impl_->environments) {
    if (!from_camera || e.environment->camera_visible) sum += impl_->radiance(e, impl_->map_point(e, d, t), t);
  }
  for (const Impl::Sun& sun : impl_->suns) {
    const bool seen = !from_camera || impl_->scene->lights[sun.light].camera_visible;
    if (seen && impl_->contains(sun, d, t)) sum += impl_->radiance(sun, t);
  }
  return sum;
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
