// SPDX-License-Identifier: Apache-2.0
#pragma once
// Mirrors and glass given by formulas, for tests of chains through them.
#include <gtest/gtest.h>

#include <memory>

#include "tempera/core/random.h"
#include "tempera/manifold/specular_walk.h"

namespace tempera::test {

/// A body whose surface is given by formulas.
struct Body {
  virtual ~Body() = default;
  virtual Vec3d position(double u, double v, double t) const = 0;
  virtual Vec3d normal(double u, double v, double t) const = 0;
  /// Distances along a line at which it is crossed, in any order.
  virtual std::vector<double> crossings(const Vec3d& o, const Vec3d& d, double t) const = 0;
  virtual Vec2d parameters(const Vec3d& p, double t) const = 0;
  double eta = 0;  ///< inside over outside, where the normal points out; 0: a mirror

  SurfaceFrame frame(double u, double v, double t) const {
    constexpr double e = 1e-5;
    const auto by = [&](const auto& f, double du, double dv, double dt) {
      return (f(u + e * du, v + e * dv, t + e * dt) - f(u - e * du, v - e * dv, t - e * dt)) * (0.5 / e);
    };
    const auto p = [&](double a, double b, double c) { return position(a, b, c); };
    const auto n = [&](double a, double b, double c) { return normal(a, b, c); };
    SurfaceFrame f;
    f.p = position(u, v, t), f.n = f.ng = normal(u, v, t);
    f.dpdu = by(p, 1, 0, 0), f.dpdv = by(p, 0, 1, 0), f.dpdt = by(p, 0, 0, 1);
    f.dndu = by(n, 1, 0, 0), f.dndv = by(n, 0, 1, 0), f.dndt = f.dngdt = by(n, 0, 0, 1);
    return f;
  }
};

/// A ball that flies and spins about the y axis.
struct Ball final : Body {
  Vec3d center, velocity;
  double radius = 1, spin = 0;
  Vec3d at(double t) const { return center + velocity * t; }
  Vec3d normal(double u, double v, double t) const override {
    return {std::sin(v) * std::cos(u + spin * t), std::cos(v), std::sin(v) * std::sin(u + spin * t)};
  }
  Vec3d position(double u, double v, double t) const override { return at(t) + normal(u, v, t) * radius; }
  std::vector<double> crossings(const Vec3d& o, const Vec3d& d, double t) const override {
    const Vec3d c = o - at(t);
    const double b = dot(c, d), q = b * b - dot(c, c) + radius * radius;
    if (!(q > 0)) return {};
    return {-b - std::sqrt(q), -b + std::sqrt(q)};
  }
  Vec2d parameters(const Vec3d& p, double t) const override {
    const Vec3d n = (p - at(t)) * (1 / radius);
    return {std::atan2(n.z, n.x) - spin * t, std::acos(std::clamp(n.y, -1.0, 1.0))};
  }
};

/// A plane through `center` that turns about the z axis through it; its normal is x turned by the angle.
struct Plane final : Body {
  Vec3d center, velocity;
  double angle = 0, turn = 0;
  Vec3d at(double t) const { return center + velocity * t; }
  Vec3d normal(double, double, double t) const override {
    return {std::cos(angle + turn * t), std::sin(angle + turn * t), 0};
  }
  Vec3d along(double t) const { return {-std::sin(angle + turn * t), std::cos(angle + turn * t), 0}; }
  Vec3d position(double u, double v, double t) const override { return at(t) + along(t) * u + Vec3d{0, 0, v}; }
  std::vector<double> crossings(const Vec3d& o, const Vec3d& d, double t) const override {
    const Vec3d n = normal(0, 0, t);
    return {dot(at(t) - o, n) / dot(d, n)};
  }
  Vec2d parameters(const Vec3d& p, double t) const override { return {dot(p - at(t), along(t)), (p - at(t)).z}; }
};

class Matter final : public ChainMatter {
 public:
  std::vector<std::unique_ptr<Body>> bodies;
  template <class B>
  B& add() {
    bodies.push_back(std::make_unique<B>());
    return static_cast<B&>(*bodies.back());
  }
  std::optional<Crossing> meet(const Vec3d& o, const Vec3d& d, double t, const ChainVertex*) const override {
    std::optional<Crossing> out;
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < bodies.size(); ++i) {
      for (const double s : bodies[i]->crossings(o, d, t)) {
        if (!(s > 1e-9 && s < nearest)) continue;
        nearest = s;
        const Vec2d q = bodies[i]->parameters(o + d * s, t);
        out = Crossing{{std::uint32_t(i), 0, 0, 0, 0}, q.x, q.y};
      }
    }
    return out;
  }
  SurfaceFrame surface(const Crossing& at, double t) const override {
    return bodies[at.point.instance]->frame(at.u, at.v, t);
  }
  std::optional<double> eta(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts,
                            double) const override {
    const Body& body = *bodies[at.point.instance];
    if (refracts != (body.eta > 0)) return std::nullopt;
    if (!refracts) return 1.0;
    return dot(wo, f.n) > 0 ? body.eta : 1 / body.eta;
  }
};

inline ChainEnd still(const Vec3d& p) { return {false, p, {}, {}, {}}; }

/// A point that flies on a plane patch with this normal.
inline ChainEnds ends_of(const Vec3d& eye, const Vec3d& p, const Vec3d& velocity, const Vec3d& normal) {
  const Vec3d u = normalize(cross(std::abs(normal.x) < 0.6 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0}, normal));
  const Vec3d v = cross(normal, u);
  return {[=](double) { return still(eye); },
          [=](double t) {
            return ChainEnd{false, p + velocity * t, u, v, velocity};
          },
          [=](double) { return normal; }};
}

/// The chain that a ray from the eye towards `aim` makes, ended where it really goes.
inline SpecularChain chain_to(const Matter& matter, const ChainEnds& ends, const Vec3d& aim,
                              const std::vector<bool>& refracts, double tolerance = 1e-12) {
  WalkState why{};
  auto chain = trace_chain(matter, ends.first(0), aim, ends.last(0), ends.last_normal(0), refracts, 0, nullptr, &why);
  EXPECT_TRUE(chain) << int(why);
  EXPECT_EQ(walk_in_space(matter, ends.last(0), ends.last_normal(0), tolerance, *chain), WalkState::kDone);
  return *chain;
}

/// Largest |S^T h| of its vertices.
inline double off_manifold(const SpecularChain& c) {
  double worst = 0;
  for (std::size_t i = 0; i < c.vertices.size(); ++i) {
    const ChainEnd before = i > 0 ? ChainEnd::of(c.vertices[i - 1].specular.surface) : c.first;
    const ChainEnd after = i + 1 < c.vertices.size() ? ChainEnd::of(c.vertices[i + 1].specular.surface) : c.last;
    worst = std::max(worst, length(constraint(before, c.vertices[i].specular, after)));
  }
  return worst;
}

struct Numbers {
  std::uint64_t count = 0;
  double operator()(double low, double high) {
    return low + (high - low) * double(hash_key(7, count++) >> 11) * 0x1p-53;
  }
  Vec3d vector(double size) { return {(*this)(-size, size), (*this)(-size, size), (*this)(-size, size)}; }
};

}  // namespace tempera::test
