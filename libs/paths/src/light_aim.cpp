// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_aim.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "light_sampler_impl.h"
#include "tempera/shading/microfacet.h"

namespace tempera {

namespace {

std::array<Vec3f, 8> corners(const Bounds3f& b) {
  std::array<Vec3f, 8> r;
  for (int i = 0; i < 8; ++i) r[i] = {i & 1 ? b.hi.x : b.lo.x, i & 2 ? b.hi.y : b.lo.y, i & 4 ? b.hi.z : b.lo.z};
  return r;
}

/// A rectangle of a plane with coordinates along two axes.
struct Rectangle {
  Vec2f lo{kInfinity, kInfinity}, hi{-kInfinity, -kInfinity};
  void extend(const Vec2f& p) {
    lo = {std::min(lo.x, p.x), std::min(lo.y, p.y)};
    hi = {std::max(hi.x, p.x), std::max(hi.y, p.y)};
  }
  /// Makes it larger by rounding, and at least of that size.
  void pad(float least) {
    const float x = std::max(1e-4f * (hi.x - lo.x), least), y = std::max(1e-4f * (hi.y - lo.y), least);
    lo = lo - Vec2f{x, y}, hi = hi + Vec2f{x, y};
  }
  bool holds(const Vec2f& p) const { return p.x >= lo.x && p.x <= hi.x && p.y >= lo.y && p.y <= hi.y; }
  double area() const { return double(hi.x - lo.x) * double(hi.y - lo.y); }
  Vec2f at(const Vec2f& u) const { return {lo.x + (hi.x - lo.x) * u.x, lo.y + (hi.y - lo.y) * u.y}; }
};

/// Directions from a point that reach a box: those through a rectangle at distance 1, or a cone where the box is too near
/// for one.
class DirectionWindow {
 public:
  DirectionWindow(const Vec3f& from, const Bounds3f& box) {
    const Vec3f to = box.center() - from;
    const float distance = length(to), radius = box.radius() * (1 + 1e-4f);
    basis_ = Basis(distance > 0 ? to * (1 / distance) : Vec3f{0, 0, 1});
    flat_ = distance > 0;
    constexpr float kLeastCosine = 0.2f;
    for (const Vec3f& c : corners(box)) {
      if (!flat_) break;
      const Vec3f d = basis_.to_local(c - from);
      flat_ = d.z > kLeastCosine * length(d);
      if (flat_) rectangle_.extend({d.x / d.z, d.y / d.z});
    }
    if (flat_) {
      rectangle_.pad(1e-5f);
    } else {
      one_minus_cos_ = distance > radius ? 1 - std::sqrt(std::max(0.0f, 1 - sqr(radius / distance))) : 2;
      one_minus_cos_ = std::max(one_minus_cos_, 1e-6f);
    }
  }
  Vec3f sample(const Vec2f& u) const {
    if (!flat_) return sample_cone(basis_.n, one_minus_cos_, u);
    const Vec2f p = rectangle_.at(u);
    return normalize(basis_.to_world({p.x, p.y, 1}));
  }
  double pdf(const Vec3f& w) const {
    if (!flat_) return in_cone(basis_.n, one_minus_cos_, w) ? double(cone_pdf(one_minus_cos_)) : 0.0;
    const Vec3f d = basis_.to_local(w);
    if (!(d.z > 0) || !rectangle_.holds({d.x / d.z, d.y / d.z})) return 0;
    return 1 / (rectangle_.area() * double(d.z) * double(d.z) * double(d.z));
  }

 private:
  Basis basis_;
  bool flat_ = false;
  Rectangle rectangle_;
  float one_minus_cos_ = 2;
};

/// Sampling with shares of several ways, of which one was taken: density by all of them [Veach 1997, Sec. 9.2].
template <class Density>
double mixed_pdf(std::span<const double> shares, Density&& density) {
  double sum = 0;
  for (std::size_t i = 0; i < shares.size(); ++i) {
    if (shares[i] > 0) sum += shares[i] * density(int(i));
  }
  return sum;
}

/// How a node turns, rad/s, and how its origin moves, m/s: differences of what it really does.
struct NodeMotion {
  Vec3d velocity, turn;
};
NodeMotion motion_of(const Scene& scene, int node, double t, TimeSpan span) {
  constexpr double kStep = 1e-4;
  if (node < 0 || !scene.moves(node, {t - kStep, t + kStep})) return {};
  const double a = std::max(t - kStep, std::min(span.begin, t)), b = std::min(t + kStep, std::max(span.end, t));
  const double inv = b > a ? 1 / (b - a) : 0;
  const Affine3d before = scene.world(node, a), after = scene.world(node, b), now = scene.world(node, t);
  NodeMotion m{(after.translation - before.translation) * inv, {}};
  // Unit axes e of a rotation change by turn x e, so the sum of e x de is twice the turn.
  for (const auto axis : {&Affine3d::x, &Affine3d::y, &Affine3d::z}) {
    m.turn += cross(normalize(now.*axis), (normalize(after.*axis) - normalize(before.*axis)) * inv) * 0.5;
  }
  return m;
}

}  // namespace

LightAim::LightAim(const LightSampler& lights, std::uint32_t light, std::span<const Bounds3f> targets, double t)
    : lights_(lights), light_(light), targets_(targets.begin(), targets.end()), t_(t) {
  TEMPERA_ASSERT(targets.size() <= kMaxTargets && light < light_count(lights));
}

std::uint32_t LightAim::light_count(const LightSampler& lights) {
  const LightSampler::Impl& s = *lights.impl_;
  return std::uint32_t(s.first_environment() + s.environments.size());
}

std::string LightAim::light_name(const LightSampler& lights, std::uint32_t light) {
  const LightSampler::Impl& s = *lights.impl_;
  if (light < s.areas.size()) return s.scene->instances[s.areas[light].instance].name;
  if (light < s.first_environment()) return s.scene->lights[light - s.areas.size()].name;
  return s.environments[light - s.first_environment()].environment->name;
}

bool LightAim::is_concentrated(const LightSampler& lights, std::uint32_t light) {
  const LightSampler::Impl& s = *lights.impl_;
  if (light < s.first_environment()) return true;
  const Environment& e = *s.environments[light - s.first_environment()].environment;
  if (e.image.empty()) return false;
  double sum = 0, bright = 0, weight = 0;
  const auto visit = [&](auto&& f) {
    for (int y = 0; y < e.height; ++y) {
      const double row = std::sin(kPiD * (y + 0.5) / e.height);  // by solid angle
      for (int x = 0; x < e.width; ++x)
        f(row, double(luminance(e.image[std::size_t(y) * std::size_t(e.width) + std::size_t(x)])));
    }
  };
  visit([&](double row, double l) { sum += row * l, weight += row; });
  const double limit = 16 * sum / weight;
  visit([&](double row, double l) { bright += l > limit ? row * l : 0; });
  return bright > 0.25 * sum;
}

std::optional<AimedLight> LightAim::emit(int part, std::span<const double> shares, float choice, const Vec2f& position,
                                         const Vec2f& direction) const {
  const LightSampler::Impl& s = *lights_.impl_;
  std::optional<AimedLight> result;
  AimedLight& r = result.emplace();
  // A direction from a place, by the light's own density or through the windows of the targets.
  const auto send = [&](const Vec3f& from, auto&& own_sample, auto&& own_pdf) {
    std::array<std::optional<DirectionWindow>, kMaxTargets> windows;
    const auto window = [&](int i) -> const DirectionWindow& {
      auto& w = windows[i - 1];
      if (!w) w.emplace(from, targets_[i - 1]);
      return *w;
    };
    const Vec3f w = part == 0 ? own_sample() : window(part).sample(direction);
    r.w = normalize(Vec3d(w));
    r.pdf_direction = mixed_pdf(shares, [&](int i) { return i == 0 ? double(own_pdf(w)) : window(i).pdf(w); });
    return w;
  };
  // A place on a plane across w, outside of all that rays can hit.
  const auto send_parallel = [&](const Vec3f& w) {
    const Basis b(w);
    const Vec3f center = s.center();
    const float radius = s.radius();
    const auto rectangle = [&](int i) {
      Rectangle rect;
      for (const Vec3f& c : corners(targets_[i - 1])) rect.extend({dot(c - center, b.s), dot(c - center, b.t)});
      rect.pad(1e-6f * radius);
      return rect;
    };
    const Vec2f at = part == 0 ? square_to_disk(position) * radius : rectangle(part).at(position);
    r.pdf_position = mixed_pdf(shares, [&](int i) {
      if (i == 0) return dot(at, at) <= radius * radius ? double(kInvPi) / sqr(double(radius)) : 0.0;
      const Rectangle rect = rectangle(i);
      return rect.holds(at) ? 1 / rect.area() : 0.0;
    });
    r.infinite = true;
    r.w = normalize(Vec3d(w));
    r.p = Vec3d(center) + Vec3d(b.s) * double(at.x) + Vec3d(b.t) * double(at.y) - r.w * double(radius);
    r.pivot = part == 0 ? double(radius) : dot(Vec3d(targets_[part - 1].center()) - r.p, r.w);
  };

  if (light_ < s.areas.size()) {
    const AreaLight& light = s.areas[light_];
    const AreaEmission& emission = *light.emission;
    const SurfacePoint point = s.even_point(light, choice, position);
    const SurfaceFrame f = s.rays->surface(point, point.u, point.v, t_);
    r.p = f.p;
    r.n = Vec3f(f.ng);
    r.velocity = f.dpdt;
    r.turn = cross(f.ng, f.dngdt);
    r.pdf_position = s.pdf_area(light, point, r.n, t_);
    const Vec3f w = send(
        Vec3f(f.p), [&] { return s.sample_direction(light, r.n, t_, direction); },
        [&](const Vec3f& d) { return s.direction_pdf(light, r.n, d, t_); });
    const float cosine = dot(r.n, w);
    if (cosine < 0 && !emission.two_sided) return std::nullopt;
    r.power = emission.radiance.rgb(s.rays->shading_point(point, t_, w)) * s.directed(emission, r.n, w, t_) *
              std::abs(cosine);
  } else if (light_ >= s.first_environment()) {
    const EnvironmentMap& e = s.environments[light_ - s.first_environment()];
    const auto at = s.sample_direction(e, t_, direction);
    send_parallel(-at.d);
    r.pdf_direction = s.pdf(e, at);
    r.power = s.radiance(e, at, t_);
    r.turn = motion_of(*s.scene, e.environment->node, t_, s.span).turn;
  } else {
    const std::size_t i = light_ - s.areas.size();
    const PunctualLight& light = s.scene->lights[i];
    if (!s.scene->visible(light.node, t_)) return std::nullopt;
    const NodeMotion motion = motion_of(*s.scene, light.node, t_, s.span);
    if (light.type == LightType::kDirectional) {
      const LightSampler::Impl::Sun* sun = s.sun_of(i);
      const Vec3f to_light = sun ? sample_cone(s.direction(*sun, t_), sun->one_minus_cos, direction)
                                 : -normalize(s.world(s.punctual_places[i], t_).z);
      send_parallel(-to_light);
      r.delta_direction = !sun;
      if (sun) r.pdf_direction = s.pdf(*sun);
      r.power = sun ? s.radiance(*sun, t_) : light.intensity.at(t_) * light.intensity_scale.at(t_);
      r.turn = motion.turn;
    } else {
      const Affine3f world = s.world(s.punctual_places[i], t_);
      LightEnd end;
      const Vec3f w = send(
          world.translation,
          [&] {
            s.emit_punctual(i, t_, direction, end);
            return end.w;
          },
          [&](const Vec3f& d) { return s.direction_pdf(light, world, d, t_); });
      r.p = Vec3d(world.translation);
      r.delta_position = true;
      r.velocity = motion.velocity;
      if (light.type != LightType::kPoint) r.turn = motion.turn;
      // What arrives at distance 1 is the intensity.
      LightSample seen;
      if (s.from_punctual(i, world.translation + w, t_, seen)) r.power = seen.radiance;
    }
  }
  if (is_black(r.power) || !is_finite(r.power) || !(r.pdf_position > 0) || !(r.pdf_direction > 0)) return std::nullopt;
  return result;
}

}  // namespace tempera
