// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/beam.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

namespace tempera {
namespace {

/// A triangle whose vertices and vertex normals move without regard for each other.
struct MovingTriangle {
  std::array<Vec3d, 3> q, v, a, n, dn;
  bool flat = false;

  std::array<Vec3d, 3> corners(double t) const {
    std::array<Vec3d, 3> r;
    for (int i = 0; i < 3; ++i) r[i] = q[i] + v[i] * t + a[i] * (0.5 * t * t);
    return r;
  }
  Vec3d normal(double b1, double b2, double t) const {
    if (flat) {
      const auto c = corners(t);
      return normalize(cross(c[1] - c[0], c[2] - c[0]));
    }
    const auto at = [&](int i) { return normalize(n[i] + dn[i] * t); };
    return normalize(at(0) * (1 - b1 - b2) + at(1) * b1 + at(2) * b2);
  }
  struct Crossing {
    Vec3d p, n;
    double b1, b2, distance;
  };
  Crossing cross_line(const Vec3d& x, const Vec3d& w, double t) const {
    const auto c = corners(t);
    const Affine3d m{c[1] - c[0], c[2] - c[0], -w};
    const Vec3d s = inverse(m).vector(x - c[0]);
    return {x + w * s.z, normal(s.x, s.y, t), s.x, s.y, s.z};
  }
  SurfaceFrame frame(double b1, double b2, double t) const {
    constexpr double h = 1e-5;
    const auto difference = [&](auto&& f) { return (f(h) - f(-h)) * (0.5 / h); };
    const auto c = corners(t);
    SurfaceFrame f;
    f.p = c[0] * (1 - b1 - b2) + c[1] * b1 + c[2] * b2;
    f.dpdu = c[1] - c[0], f.dpdv = c[2] - c[0];
    f.ng = normalize(cross(f.dpdu, f.dpdv));
    f.n = normal(b1, b2, t);
    if (!flat) {
      f.dndu = difference([&](double e) { return normal(b1 + e, b2, t); });
      f.dndv = difference([&](double e) { return normal(b1, b2 + e, t); });
    }
    f.dndt = difference([&](double e) { return normal(b1, b2, t + e); });
    const auto area = [&](double e) {
      const auto k = corners(t + e);
      return cross(k[1] - k[0], k[2] - k[0]);
    };
    f.dngdt = difference([&](double e) { return normalize(area(e)); });
    f.dpdt = difference([&](double e) {
      const auto k = corners(t + e);
      return k[0] * (1 - b1 - b2) + k[1] * b1 + k[2] * b2;
    });
    f.area_rate = difference([&](double e) { return std::log(length(area(e))); });
    return f;
  }
};

struct Random {
  std::mt19937_64 engine{7};
  double operator()(double a, double b) { return std::uniform_real_distribution<double>(a, b)(engine); }
  Vec3d vector(double size) { return {(*this)(-size, size), (*this)(-size, size), (*this)(-size, size)}; }
};

/// A large triangle across the z axis near height z, its normals about the direction `up`.
MovingTriangle make_triangle(Random& random, double z, const Vec3d& up, bool flat) {
  MovingTriangle m;
  m.flat = flat;
  const std::array<Vec3d, 3> about{Vec3d{-3, -3, z}, Vec3d{4, -2, z}, Vec3d{-1, 5, z}};
  for (int i = 0; i < 3; ++i) {
    m.q[i] = about[i] + random.vector(0.3);
    m.v[i] = random.vector(0.5), m.a[i] = random.vector(0.5);
    m.n[i] = normalize(up + random.vector(0.2)), m.dn[i] = random.vector(0.2);
  }
  return m;
}

struct Ray3d {
  Vec3d x, w;
};

/// A ray of a light whose position and direction both depend on four coordinates and time.
struct Emitter {
  Vec3d x, w, px[4], pw[4], v, turn;
  Ray3d at(const std::array<double, 5>& e) const {
    Ray3d r{x + v * e[4], w + turn * e[4]};
    for (int i = 0; i < 4; ++i) r.x += px[i] * e[i], r.w += pw[i] * e[i];
    return {r.x, normalize(r.w)};
  }
  Beam beam() const {
    Beam b;
    const double l = length(w);
    b.x = x, b.w = w * (1 / l);
    const auto direction = [&](const Vec3d& d) { return (d - b.w * dot(b.w, d)) * (1 / l); };
    for (int i = 0; i < 4; ++i) b.dx[i] = px[i], b.dw[i] = direction(pw[i]);
    b.dx[4] = v, b.dw[4] = direction(turn);
    return b;
  }
};

double relative(const Vec3d& a, const Vec3d& b, double floor) {
  return length(a - b) / std::max({length(a), length(b), floor});
}

TEST(Beam, FollowsRaysThatAreTracedAgain) {
  Random random;
  int chains = 0;
  double worst = 0, largest_dot = 0;
  for (int k = 0; k < 2000; ++k) {
    const bool flat = k % 3 == 0;
    const MovingTriangle glass = make_triangle(random, 0, {0, 0, 1}, flat);
    const MovingTriangle mirror = make_triangle(random, -1, {0, 0, 1}, flat);
    const MovingTriangle floor = make_triangle(random, 2, {0, 0, 1}, true);
    const double eta = random(1.2, 1.6);
    Emitter emitter{random.vector(0.3) + Vec3d{0, 0, 1}, {random(-0.3, 0.3), random(-0.3, 0.3), -1}, {}, {}, {}, {}};
    for (int i = 0; i < 4; ++i) emitter.px[i] = random.vector(0.1), emitter.pw[i] = random.vector(0.1);
    emitter.v = random.vector(0.5), emitter.turn = random.vector(0.5);

    const auto trace = [&](const std::array<double, 5>& e, Vec3d& arrived, Vec3d& direction) {
      Ray3d r = emitter.at(e);
      const double t = e[4];
      auto c = glass.cross_line(r.x, r.w, t);
      double ci = -dot(r.w, c.n), root = 1 - (1 - ci * ci) / (eta * eta);
      r = {c.p, r.w * (1 / eta) + c.n * (ci / eta - std::sqrt(root))};
      c = mirror.cross_line(r.x, r.w, t);
      direction = r.w - c.n * (2 * dot(r.w, c.n));
      arrived = floor.cross_line(c.p, direction, t).p;
    };

    Beam beam = emitter.beam();
    const auto arrive = [&](const MovingTriangle& m) {
      const auto c = m.cross_line(beam.x, beam.w, 0);
      const SurfaceFrame f = m.frame(c.b1, c.b2, 0);
      transfer(f, c.distance, beam);
      return f;
    };
    SurfaceFrame f = arrive(glass);
    ASSERT_TRUE(refract(f.n, normal_change(f, matter_change(f, beam)), eta, beam));
    f = arrive(mirror);
    reflect(f.n, normal_change(f, matter_change(f, beam)), beam);
    if (!(beam.w.z > 0.2)) continue;
    f = arrive(floor);
    EXPECT_NEAR(dot(f.ng, beam.dx[4] - f.dpdt), 0, 1e-9 * (1 + length(beam.dx[4])));
    ++chains;
    for (int i = 0; i < Beam::kColumns; ++i) {
      constexpr double h = 2e-6;
      std::array<double, 5> more{}, less{};
      more[i] = h, less[i] = -h;
      Vec3d xa, wa, xb, wb;
      trace(more, xa, wa);
      trace(less, xb, wb);
      worst = std::max(worst, relative(beam.dx[i], (xa - xb) * (0.5 / h), 0.1));
      worst = std::max(worst, relative(beam.dw[i], (wa - wb) * (0.5 / h), 0.1));
      largest_dot = std::max(largest_dot, std::abs(dot(beam.w, beam.dw[i])) / (1 + length(beam.dw[i])));
    }
  }
  EXPECT_GT(chains, 1000);
  EXPECT_LT(worst, 1e-6);
  EXPECT_LT(largest_dot, 1e-9);  // of the differences that the surfaces are made of
}

TEST(Beam, StandsStillWhereNothingMoves) {
  Random random;
  MovingTriangle m = make_triangle(random, 0, {0, 0, 1}, false);
  for (int i = 0; i < 3; ++i) m.v[i] = m.a[i] = m.dn[i] = {};
  SurfaceFrame f = m.frame(0.3, 0.3, 0);
  f.dpdt = f.dndt = f.dngdt = {};
  Beam beam;
  beam.x = f.p + Vec3d{0.1, 0.2, 1};
  beam.w = normalize(f.p - beam.x);
  beam.dw[0] = {1, 0, 0};
  transfer(f, length(f.p - beam.x), beam);
  ASSERT_TRUE(refract(f.n, normal_change(f, matter_change(f, beam)), 1.5, beam));
  EXPECT_EQ(beam.dx[Beam::kTime], Vec3d());
  EXPECT_EQ(beam.dw[Beam::kTime], Vec3d());
}

// A photon that stays with matter: where that is, where light for it comes from, and how much of it there is.
TEST(Beam, StaysWithTheMatterThatItMeets) {
  Random random;
  double worst = 0;
  for (int k = 0; k < 500; ++k) {
    const MovingTriangle m = make_triangle(random, 0, {0, 0, 1}, false);
    const Vec3d lamp = random.vector(0.5) + Vec3d{0, 0, 3}, velocity = random.vector(1);
    const double b1 = 0.3, b2 = 0.4;
    const auto at = [&](double t) {
      const auto c = m.corners(t);
      return c[0] * (1 - b1 - b2) + c[1] * b1 + c[2] * b2;
    };
    const auto direction = [&](double t) { return normalize(at(t) - lamp - velocity * t); };
    const auto flux = [&](double t) {  // of a lamp of intensity 1, on a triangle so small that it is all alike
      const auto c = m.corners(t);
      const Vec3d d = at(t) - lamp - velocity * t;
      return std::abs(dot(cross(c[1] - c[0], c[2] - c[0]), direction(t))) / dot(d, d);
    };
    const SurfaceFrame f = m.frame(b1, b2, 0);
    Beam beam;
    beam.x = lamp, beam.w = direction(0);
    beam.dx[Beam::kTime] = velocity;
    const double distance = length(f.p - lamp);
    transfer(f, distance, beam);
    const double rate = follow_matter(f, {.velocity = velocity}, distance, beam);
    constexpr double h = 1e-5;
    worst = std::max(worst, relative(beam.dx[Beam::kTime], (at(h) - at(-h)) * (0.5 / h), 0.1));
    worst = std::max(worst, relative(beam.dw[Beam::kTime], (direction(h) - direction(-h)) * (0.5 / h), 0.1));
    const double expected = (std::log(flux(h)) - std::log(flux(-h))) / (2 * h);
    worst = std::max(worst, std::abs(rate - expected) / std::max(std::abs(expected), 0.1));
  }
  EXPECT_LT(worst, 1e-6);
}

// [Schjoth 2010] says nothing of it; a mirror that turns by an angle turns light by twice that.
TEST(Beam, TurnsTwiceAsFastAsAMirror) {
  const double rate = 0.7;
  const Vec3d axis{0, 1, 0}, n = normalize(Vec3d{0.3, 0, 1});
  SurfaceFrame f;
  f.ng = f.n = n;
  f.dpdu = normalize(cross(axis, n)), f.dpdv = axis;
  f.dndt = f.dngdt = cross(axis, n) * rate;
  Beam beam;
  beam.x = Vec3d{0, 0, 2}, beam.w = {0, 0, -1};
  transfer(f, 2, beam);
  reflect(f.n, normal_change(f, matter_change(f, beam)), beam);
  EXPECT_LT(length(beam.dw[Beam::kTime] - cross(axis, beam.w) * (2 * rate)), 1e-12);
}

// A plane that recedes from a lamp spreads what falls on it.
TEST(Beam, SpreadsOnAPlaneThatRecedes) {
  const double h = 2, speed = 0.5, radius = 1.2;
  SurfaceFrame f;
  f.p = {radius, 0, 0}, f.ng = f.n = {0, 0, 1}, f.dpdu = {1, 0, 0}, f.dpdv = {0, 1, 0}, f.dpdt = {0, 0, -speed};
  Beam beam;
  beam.x = {0, 0, h};
  beam.w = normalize(f.p - beam.x);
  transfer(f, length(f.p - beam.x), beam);
  EXPECT_LT(length(beam.dx[Beam::kTime] - Vec3d{radius * speed / h, 0, -speed}), 1e-12);
}

TEST(Beam, IsWidenedAlikeAtEverySurface) {
  Random random;
  for (int k = 0; k < 100; ++k) {
    Beam beam;
    beam.w = normalize(random.vector(1));
    const auto across = [&](const Vec3d& d) { return d - beam.w * dot(beam.w, d); };
    for (int i = 0; i < Beam::kSpatial; ++i) {
      beam.dx[i] = random.vector(1), beam.dw[i] = across(random.vector(1));
      if (k % 4 == 0 && i >= 2) beam.dx[i] = beam.dw[i] = {};
    }
    const Vec3d s = normalize(across(random.vector(1))), t = cross(beam.w, s);
    const double length_of_new = 0.3;
    Beam wide = beam;
    widen(length_of_new, wide);
    for (const double distance : {0.0, 0.7, 3.0}) {
      const auto spread = [&](const Beam& b, const Vec3d& e) {
        double sum = 0;
        for (int i = 0; i < Beam::kSpatial; ++i) sum += sqr(dot(b.dx[i] + b.dw[i] * distance, e));
        return sum;
      };
      for (const Vec3d& e : {s, t, normalize(s + t)}) {
        const double expected = spread(beam, e) + sqr(length_of_new * distance);
        EXPECT_NEAR(spread(wide, e), expected, 1e-9 * (1 + expected));
      }
    }
  }
}

}  // namespace
}  // namespace tempera
