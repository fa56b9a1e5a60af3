// SPDX-License-Identifier: Apache-2.0
// Chains through moving mirrors and glass: derivatives against differences, walks against what optics says.
#include "tempera/manifold/specular_walk.h"

#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <numbers>

#include "tempera/core/random.h"

namespace tempera {
namespace {

constexpr double kPi = std::numbers::pi;

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
  std::optional<Crossing> meet(const Vec3d& o, const Vec3d& d, double t, const Crossing*) const override {
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
  std::optional<double> eta(const Crossing& at, const Vec3d& wo, bool refracts, double t) const override {
    const Body& body = *bodies[at.point.instance];
    if (refracts != (body.eta > 0)) return std::nullopt;
    if (!refracts) return 1.0;
    return dot(wo, body.normal(at.u, at.v, t)) > 0 ? body.eta : 1 / body.eta;
  }
};

ChainEnd still(const Vec3d& p) { return {false, p, {}, {}, {}}; }

/// A point that flies on a plane patch with this normal.
ChainEnds ends_of(const Vec3d& eye, const Vec3d& p, const Vec3d& velocity, const Vec3d& normal) {
  const Vec3d u = normalize(cross(std::abs(normal.x) < 0.6 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0}, normal));
  const Vec3d v = cross(normal, u);
  return {[=](double) { return still(eye); },
          [=](double t) {
            return ChainEnd{false, p + velocity * t, u, v, velocity};
          },
          [=](double) { return normal; }};
}

/// The chain that a ray from the eye towards `aim` makes, ended where it really goes.
SpecularChain chain_to(const Matter& matter, const ChainEnds& ends, const Vec3d& aim, const std::vector<bool>& refracts,
                       double tolerance = 1e-12) {
  WalkState why{};
  auto chain = trace_chain(matter, ends.first(0), aim, ends.last(0), ends.last_normal(0), refracts, 0, nullptr, &why);
  EXPECT_TRUE(chain) << int(why);
  EXPECT_EQ(walk_in_space(matter, ends.last(0), ends.last_normal(0), tolerance, *chain), WalkState::kDone);
  return *chain;
}

/// Largest |S^T h| of its vertices.
double off_manifold(const SpecularChain& c) {
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

// A, B, C and tau against central differences of the constraint itself, whose tangents turn with the surface.
TEST(SpecularSystem, BlocksAreDerivativesOfTheConstraint) {
  Numbers random;
  for (int k = 0; k < 60; ++k) {
    Ball middle, before, after;
    middle.velocity = random.vector(1), middle.spin = random(-2, 2), middle.radius = random(0.3, 1);
    const double u = random(0, 2 * kPi), v = random(0.5, 2.5);
    const bool refracts = k % 2 == 1;
    const double eta = refracts ? (k % 4 == 1 ? 1.5 : 1 / 1.5) : 1;
    // Neighbours where reflection or refraction about the normal leads, on balls of their own.
    const SurfaceFrame f = middle.frame(u, v, 0);
    Vec3d w = normalize(f.n + normalize(cross(f.n, random.vector(1))) * random(0.1, 0.6));
    const double cosine = dot(w, f.n);
    const Vec3d along = (w - f.n * cosine) * (-1 / eta);
    const Vec3d out = refracts ? along - f.n * std::sqrt(1 - dot(along, along)) : f.n * (2 * cosine) - w;
    struct Neighbour {
      Ball ball;
      double u, v;
    };
    const auto neighbour = [&](const Vec3d& p) {
      Neighbour n;
      n.ball.velocity = random.vector(1), n.ball.spin = random(-2, 2), n.ball.radius = random(0.3, 1);
      n.u = random(0, 2 * kPi), n.v = random(0.5, 2.5);
      n.ball.center = p - n.ball.normal(n.u, n.v, 0) * n.ball.radius;
      return n;
    };
    const Neighbour a = neighbour(f.p + w * random(0.5, 3)), b = neighbour(f.p + out * random(0.5, 3));
    const auto c = [&](const std::array<double, 7>& x) {
      return constraint(ChainEnd::of(a.ball.frame(a.u + x[0], a.v + x[1], x[6])),
                        {middle.frame(u + x[2], v + x[3], x[6]), eta},
                        ChainEnd::of(b.ball.frame(b.u + x[4], b.v + x[5], x[6])));
    };
    ASSERT_LT(length(c({})), 1e-9);
    const ConstraintBlocks blocks =
        blocks_of(ChainEnd::of(a.ball.frame(a.u, a.v, 0)), {f, eta}, ChainEnd::of(b.ball.frame(b.u, b.v, 0)));
    const std::array<Vec2d, 7> found{blocks.before.x, blocks.before.y, blocks.at.x, blocks.at.y,
                                     blocks.after.x,  blocks.after.y,  blocks.rate};
    for (std::size_t i = 0; i < 7; ++i) {
      std::array<double, 7> more{}, less{};
      more[i] = 1e-5, less[i] = -1e-5;
      const Vec2d expected = (c(more) - c(less)) * (0.5 / 1e-5);
      EXPECT_LT(length(found[i] - expected), 1e-6 * (1 + length(expected))) << k << ' ' << i;
    }
  }
}

TEST(SpecularWalk, TurningMirrorShowsTheVirtualImage) {
  Matter matter;
  Plane& mirror = matter.add<Plane>();
  mirror.center = {2, 0, 0}, mirror.velocity = {0.3, 0.1, 0}, mirror.angle = kPi, mirror.turn = 0.3;
  const ChainEnds ends = ends_of({0, 0, 0}, {0.5, 1.5, 0.4}, {0.2, -0.3, 0.5}, {0, -1, 0});
  const SpecularChain start = chain_to(matter, ends, {2, 0.4, 0.1}, {false});
  for (const double to : {1.0, -1.0, 0.37}) {
    SpecularChain chain = start;
    WalkCounts counts;
    ASSERT_EQ(walk_in_time(matter, ends, to, 1e-12, chain, &counts), WalkState::kDone);
    const Vec3d n = mirror.normal(0, 0, to), p = ends.last(to).p;
    const Vec3d image = p - n * (2 * dot(p - mirror.at(to), n));
    const Vec3d seen = image * (dot(mirror.at(to), n) / dot(image, n));
    EXPECT_LT(length(chain.vertices[0].specular.surface.p - seen), 1e-11) << to;
    EXPECT_LE(counts.temporal, 2);
    EXPECT_LE(counts.spatial, 6);
  }
}

TEST(SpecularWalk, GlassSlabShiftsWhatIsBehindIt) {
  Matter matter;
  constexpr double kEta = 1.5, kThick = 0.5;
  for (const double x : {2.0, 2.0 + kThick}) {
    Plane& face = matter.add<Plane>();
    face.center = {x, 0, 0}, face.velocity = {0.4, 0, 0}, face.angle = x > 2 ? 0 : kPi, face.eta = kEta;
  }
  const ChainEnds ends = ends_of({0, 0, 0}, {5, 1, 0.5}, {0, -0.8, 0.3}, {-1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {2, 0.4, 0.2}, {true, true});
  ASSERT_EQ(walk_in_time(matter, ends, 1, 1e-12, chain), WalkState::kDone);
  // Where it leaves the eye's axis: outside at angle a, inside at b, with sin a = eta sin b.
  const Vec3d p = ends.last(1).p, first = chain.vertices[0].specular.surface.p;
  const double tan_a = std::hypot(first.y, first.z) / first.x, sin_a = tan_a / std::sqrt(1 + tan_a * tan_a);
  const double sin_b = sin_a / kEta, tan_b = sin_b / std::sqrt(1 - sin_b * sin_b);
  EXPECT_NEAR(first.x, 2.4, 1e-12);
  EXPECT_NEAR(tan_a * (p.x - kThick) + tan_b * kThick, std::hypot(p.y, p.z), 1e-11);
  EXPECT_NEAR(first.y * p.z, first.z * p.y, 1e-12);
}

// Reflection and two refractions by a ball that moves and spins by about a tenth of a picture.
TEST(SpecularWalk, BallsAreFollowedInFewStepsAndBack) {
  Numbers random;
  int temporal = 0, spatial = 0, done = 0;
  constexpr int kPaths = 200;
  for (int k = 0; k < kPaths; ++k) {
    Matter matter;
    Ball& ball = matter.add<Ball>();
    const bool glass = k % 2 == 1;
    ball.center = {4, random(-0.3, 0.3), random(-0.3, 0.3)}, ball.velocity = random.vector(0.25);
    ball.spin = random(-1, 1), ball.eta = glass ? 1.5 : 0;
    const Vec3d aim = ball.center + Vec3d{-0.7, random(-0.5, 0.5), random(-0.5, 0.5)};
    const std::vector<bool> refracts = glass ? std::vector<bool>{true, true} : std::vector<bool>{false};
    // A wall behind glass, one behind the eye for the mirror: the point is where the first path ends.
    const double wall = glass ? 7 : -2;
    ChainEnds ends = ends_of({0, 0, 0}, {wall, 0, 0}, random.vector(0.2), {glass ? -1.0 : 1.0, 0, 0});
    const auto start = trace_chain(matter, ends.first(0), aim, ends.last(0), ends.last_normal(0), refracts, 0, nullptr);
    if (!start) continue;
    ends = ends_of({0, 0, 0}, start->last.p, ends.last(0).dpdt, ends.last_normal(0));
    SpecularChain chain = *start;
    WalkCounts counts;
    if (walk_in_time(matter, ends, 1, 1e-11, chain, &counts) != WalkState::kDone) continue;
    ++done;
    temporal += counts.temporal, spatial += counts.spatial;
    EXPECT_EQ(chain.time, 1);
    EXPECT_LT(length(chain.last.p - ends.last(1).p), 1e-11);
    EXPECT_LT(off_manifold(chain), 1e-9);
    ASSERT_EQ(walk_in_time(matter, ends, 0, 1e-11, chain), WalkState::kDone);
    EXPECT_LT(length(chain.vertices[0].specular.surface.p - start->vertices[0].specular.surface.p), 1e-8);
  }
  EXPECT_GE(done, 0.98 * kPaths);
  EXPECT_LT(temporal, 1.6 * done);
  EXPECT_LT(spatial, 6 * done);
}

// The rate that the linear system tells is that of the walk.
TEST(SpecularWalk, FollowsItsTimeDerivative) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0.2, 0}, ball.velocity = {0.2, -0.5, 0.4}, ball.spin = 1.1, ball.eta = 1.4;
  const ChainEnds wall = ends_of({0, 0, 0}, {7, 0, 0}, {}, {-1, 0, 0});
  const auto traced =
      trace_chain(matter, wall.first(0), {3.1, 0.4, 0.2}, wall.last(0), {-1, 0, 0}, {true, true}, 0, nullptr);
  ASSERT_TRUE(traced);
  const SpecularChain& start = *traced;
  const ChainEnds ends = ends_of({0, 0, 0}, start.last.p, {0.1, 0.3, -0.6}, {-1, 0, 0});
  const std::vector<SpecularVertex> vertices{start.vertices[0].specular, start.vertices[1].specular};
  const SpecularSystem system(start.first, vertices, ends.last(0));
  ASSERT_FALSE(system.singular());
  const std::vector<Vec2d> rate = system.solve({}, {}, 1);
  constexpr double kStep = 2e-5;
  SpecularChain later = start, earlier = start;
  ASSERT_EQ(walk_in_time(matter, ends, kStep, 1e-13, later), WalkState::kDone);
  ASSERT_EQ(walk_in_time(matter, ends, -kStep, 1e-13, earlier), WalkState::kDone);
  for (std::size_t i = 0; i < 2; ++i) {
    const Vec2d measured{(later.vertices[i].at.u - earlier.vertices[i].at.u) * (0.5 / kStep),
                         (later.vertices[i].at.v - earlier.vertices[i].at.v) * (0.5 / kStep)};
    EXPECT_LT(length(measured - rate[i]), 1e-5 * (1 + length(measured))) << i;
  }
}

// The end moves within one moment, by its own parameters.
TEST(SpecularWalk, MovesInSpaceToAnyEnd) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0, 0};
  const ChainEnds ends = ends_of({0, 0, 0}, {-2, 0.4, 0.6}, {}, {1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {3, 0.05, 0.1}, {false});
  const ChainEnds far = ends_of({0, 0, 0}, {-2, -3, 1}, {}, {1, 0, 0});
  ASSERT_EQ(walk_in_space(matter, far.last(0), {1, 0, 0}, 1e-12, chain), WalkState::kDone);
  EXPECT_LT(off_manifold(chain), 1e-11);
  // Light from infinity instead: its direction is the end.
  ChainEnd sky{true, normalize(Vec3d{-1, 0.5, 0.2}), {}, {}, {}};
  auto to_sky = trace_chain(matter, still({0, 0, 0}), {3, 0.1, 0.1}, sky, {}, {false}, 0, nullptr);
  ASSERT_TRUE(to_sky);
  ASSERT_EQ(walk_in_space(matter, sky, {}, 1e-12, *to_sky), WalkState::kDone);
  EXPECT_LT(length(to_sky->last.p - sky.p), 1e-12);
  EXPECT_LT(off_manifold(*to_sky), 1e-11);
}

TEST(SpecularWalk, SaysWhyItEnds) {
  Matter matter;
  Ball& ball = matter.add<Ball>();
  ball.center = {4, 0, 0}, ball.velocity = {0, 5, 0};
  const ChainEnds ends = ends_of({0, 0, 0}, {-2, 0.4, 0.6}, {}, {1, 0, 0});
  SpecularChain chain = chain_to(matter, ends, {3, 0.05, 0.1}, {false});
  // A ball that covers the point hides nothing from the walk, which asks for no visibility; a wall that comes between does.
  Plane& wall = matter.add<Plane>();
  wall.center = {1, 0, 0}, wall.velocity = {0, 0, 0}, wall.angle = kPi;
  EXPECT_EQ(walk_in_time(matter, ends, 0.1, 1e-12, chain), WalkState::kMissed);

  Matter glass;
  Plane& inside = glass.add<Plane>();
  inside.center = {2, 0, 0}, inside.angle = kPi, inside.eta = 1 / 1.5;  // glass on the eye's side
  WalkState why{};
  const ChainEnds behind = ends_of({0, 0, 0}, {4, 0, 0}, {}, {-1, 0, 0});
  EXPECT_FALSE(trace_chain(glass, still({0, 0, 0}), {2, 3, 0}, behind.last(0), {-1, 0, 0}, {true}, 0, nullptr, &why));
  EXPECT_EQ(why, WalkState::kTotal);
}

}  // namespace
}  // namespace tempera
