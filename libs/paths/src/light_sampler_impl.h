// SPDX-License-Identifier: Apache-2.0
#pragma once
// What LightSampler keeps of each light, for its two sides: choosing light from a reference point (light_sampler.cpp),
// and emitting it into the scene (light_emission.cpp).
#include <cmath>
#include <optional>
#include <unordered_map>
#include <vector>

#include "distribution.h"
#include "light_choice.h"
#include "tempera/paths/light_sampler.h"
#include "tempera/scene/analytic.h"

namespace tempera {

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
  const Mesh* mesh = nullptr;            // null: analytic
  Discrete triangles;                    // by area at the reference time
  float fixed_pdf_area = 0;              // 1 / area where the surface never moves; 0: ask at the time
  std::vector<FixedTriangle> fixed;      // of a mesh that never moves
  std::optional<AnalyticKind> analytic;  // empty: a mesh
};

/// Piecewise constant density over the texels of a latitude-longitude picture.
struct EnvironmentMap {
  const Environment* environment = nullptr;
  Discrete rows;
  std::vector<Discrete> columns;
  Place place;
};

/// 1 - cos of an angle in [0, pi].
inline float one_minus_cosine(float angle) { return 2 * sqr(std::sin(0.5f * angle)); }
/// Direction of a cone around a unit axis, spread evenly over its solid angle 2 pi (1 - cos).
inline Vec3f sample_cone(const Vec3f& axis, float one_minus_cos, const Vec2f& u) {
  const float h = u.x * one_minus_cos, sine = std::sqrt(std::max(0.0f, h * (2 - h))), phi = 2 * kPi * u.y;
  const Basis b(axis);
  return normalize(b.n * (1 - h) + (b.s * std::cos(phi) + b.t * std::sin(phi)) * sine);
}
inline float cone_pdf(float one_minus_cos) { return 0.5f * kInvPi / one_minus_cos; }
/// Whether unit direction d lies in a cone, as sampled, rounding included.
inline bool in_cone(const Vec3f& axis, float one_minus_cos, const Vec3f& d) {
  // 1 - cos of small angles needs the difference: |d - a|^2 = 2 (1 - cos).
  return length_squared(d - axis) <= 2 * one_minus_cos * (1 + 1e-4f);
}

/// How much of its intensity a spot sends in a direction, in its own frame with z the axis.
Rgb spot_factor(const PunctualLight& light, const Vec3f& local, double t);

struct LightSampler::Impl {
  const Scene* scene = nullptr;
  const RayScene* rays = nullptr;
  std::vector<AreaLight> areas;
  std::vector<EnvironmentMap> environments;
  std::unordered_map<std::uint64_t, std::uint32_t> area_index;  // (instance, shape) -> areas
  LightChoice choice;                                           // areas, then punctual lights, then environments
  bool emits = false;                                           // whether any light has power
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
  float pdf(const Sun& sun) const { return cone_pdf(sun.one_minus_cos); }
  /// Towards the middle of the disk.
  Vec3f direction(const Sun& sun, double t) const { return -normalize(world(punctual_places[sun.light], t).z); }
  bool contains(const Sun& sun, const Vec3f& d, double t) const {
    return in_cone(direction(sun, t), sun.one_minus_cos, d);
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
    if (light.analytic != AnalyticKind::kSphere) return std::nullopt;
    const Affine3f m = world_from_unit(light, t);
    const float a = length(m.x), b = length(m.y), c = length(m.z), eps = 1e-4f * a;
    if (std::abs(a - b) > eps || std::abs(a - c) > eps) return std::nullopt;
    return RoundSphere{m.translation, a};
  }
  Affine3f world_from_unit(const AreaLight& light, double t) const {
    return rays->world_from_unit(light.instance, light.shape, t);
  }

  /// A point of the light, spread evenly over its area (over that of the unit shape if it is stretched).
  SurfacePoint even_point(const AreaLight& light, float u1, Vec2f u) const {
    SurfacePoint point{light.instance, light.shape, 0, u.x, u.y};
    if (light.mesh) {
      point.primitive = light.triangles.sample(u1);
      // Uniform barycentrics without the square root's distortion [Heitz 2019, A Low-Distortion Map].
      const float half = 0.5f * std::min(u.x, u.y);
      point.u = u.x - half, point.v = u.y - half;
    } else {
      const Vec2f uv = analytic::sample(*light.analytic, u);
      point.u = uv.x, point.v = uv.y;
    }
    return point;
  }
  /// Where a point of the light is, and its unit geometric normal. Not returned: GCC makes that 1 % slower.
  TEMPERA_INLINE void locate(const AreaLight& light, const SurfacePoint& point, double t, Vec3f& p, Vec3f& ng) const {
    if (light.fixed.empty()) {
      p = rays->position(point, t, &ng);
    } else {
      const FixedTriangle& f = light.fixed[point.primitive];
      p = f.p + f.e1 * point.u + f.e2 * point.v;
      ng = f.ng;
    }
  }
  /// Density of even_point(), by area.
  float pdf_area(const AreaLight& light, const SurfacePoint& point, const Vec3f& ng, double t) const;
  // These fill a fresh sample; false: there is no direction to the light. Densities lack the choice of the light,
  // except for environments, which are one light.
  bool sample_area(const AreaLight& light, const Vec3f& p, double t, float u1, Vec2f u, LightSample& r) const;
  /// Not inlined: copies of it in sample() and connect() together took 2 % of the time of gradient-domain paths.
  [[gnu::noinline]] bool from_area(const AreaLight& light, const Vec3f& p, double t, LightSample& r) const;
  /// `index`: of the environment in whose picture `at` lies; kNone: of none.
  bool from_infinity(std::size_t index, const MapPoint& at, const Vec3f& p, double t, LightSample& r) const;
  Rgb directed(const AreaEmission& emission, const Vec3f& ng, const Vec3f& wo, double t) const;
  bool from_punctual(std::size_t index, const Vec3f& p, double t, LightSample& r) const;
  std::optional<float> cap_pdf(const AreaLight& light, const Vec3f& q, const Vec3f& p, double t) const;
  float area_of(const AreaLight& light, double t) const;
  LightReach reach_of(const AreaLight& light, float radiance) const;

  // For emission. These fill an end whose light is chosen, all but `beta`.
  void emit_area(const AreaLight& light, double t, float u1, const Vec2f& position, const Vec2f& direction,
                 LightEnd& e) const;
  void emit_punctual(std::size_t index, double t, const Vec2f& direction, LightEnd& e) const;
  void emit_infinite(const Vec3f& to_light, double t, const Vec2f& position, LightEnd& e) const;
  void from_disk(const Vec3f& w, const Vec2f& position, LightEnd& e) const;
  EmissionPdf infinite_pdf(const Vec3f& to_light, double t) const;
  /// A direction in which light leaves a point with unit geometric normal ng, and the density of that.
  Vec3f sample_direction(const AreaLight& light, const Vec3f& ng, double t, Vec2f u) const;
  float direction_pdf(const AreaLight& light, const Vec3f& ng, const Vec3f& w, double t) const;
  float direction_pdf(const PunctualLight& light, const Affine3f& world, const Vec3f& w, double t) const;
  Vec3f spot_axis(const PunctualLight& spot, double t) const {
    return normalize(Affine3f(scene->world(spot.node, t)).z);
  }
  /// The disk through which parallel light is emitted covers a sphere around all that rays can hit.
  Vec3f center() const { return rays->bounds().empty() ? Vec3f{} : rays->bounds().center(); }
  float radius() const { return 1.001f * std::max(rays->bounds().radius(), 1e-6f); }
};

}  // namespace tempera
