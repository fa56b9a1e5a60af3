// SPDX-License-Identifier: Apache-2.0
// Vectors of what mirrors and glass show, on real scenes, against lines of sight that formulas follow.
#include "tempera/chain_motion/chain_motion.h"

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <numeric>

#include "tempera/chain_motion/temporal_walk.h"
#include "tempera/core/random.h"
#include "tempera/manifold/scene_matter.h"
#include "tempera/transport/scene_window.h"

namespace tempera {
namespace {

Mesh quad(const Vec3f& center, const Vec3f& s, const Vec3f& t) {
  Mesh m;
  m.positions = {center - s - t, center + s - t, center + s + t, center - s + t};
  m.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  m.indices = {0, 1, 2, 0, 2, 3};
  return m;
}

/// Turns evenly about an axis while it moves evenly: at frame 0 (and second 0) `from`, one frame later by `step` and
/// `angle` further.
struct Move {
  Vec3d from, step;
  Vec3d axis{0, 1, 0};
  double angle = 0;
  Vec3d at(double t) const { return from + step * t; }
  AnimatedTransform transform(double size = 1) const {
    AnimatedTransform r;
    r.keyed = true;
    r.translation = {{-2, 2}, {at(-2), at(2)}, Interpolation::kLinear};
    std::vector<double> times;
    std::vector<Quatd> turns;
    for (int i = -4; i <= 4; ++i) times.push_back(0.5 * i), turns.push_back(axis_angle(axis, 0.5 * i * angle));
    r.rotation = {times, turns, Interpolation::kLinear};
    r.scale = {{-2}, {Vec3d{size, size, size}}, Interpolation::kLinear};
    return r;
  }
};

struct MotionShot {
  Scene scene;
  RenderSettings settings;
  ChainMotionCounts counts;

  MotionShot() {
    settings.width = 48, settings.height = 36;
    settings.clock.fps = 1;  // seconds are frames
    settings.clock.shutter = {.open = 0, .close = 0};
    Camera c;
    c.node = node(Affine3d(look_at(Vec3f{0, 0, 5}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
    c.fov_x = 0.7f;
    scene.cameras = {c};
  }
  int node(AnimatedTransform t) {
    scene.nodes.push_back({-1, std::move(t), "", 1.0f});
    return int(scene.nodes.size()) - 1;
  }
  void add(Geometry g, MaterialPtr material, AnimatedTransform t = Affine3d()) {
    scene.shapes.push_back({std::move(g), std::move(material), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back({int(scene.groups.size()) - 1, node(std::move(t)), "", true});
  }
  Camera& camera() { return scene.cameras[0]; }

  /// The layers of motion of these chains, tile by tile.
  Frame render(const std::vector<std::string>& chains, int frame = 0, int tile = 64) {
    validate(scene);
    Frame out(settings.width, settings.height);
    for (const std::string& chain : chains) {
      for (const LayerDesc& d : layers::chain_motion()) out.create(layers::chain_layer(chain, d));
    }
    GeometryCache cache;
    const LightPathClassifier classifier;
    const SceneWindow window(scene, settings, classifier, 1.0 / 8, cache, {frame, frame});
    counts = {};
    for (int y = 0; y < settings.height; y += tile) {
      for (int x = 0; x < settings.width; x += tile) {
        const Tile t{x, y, std::min(x + tile, settings.width), std::min(y + tile, settings.height)};
        write_chain_motion(
            window.frame(frame), window.neighbourhood(frame), t, [](int, int) { return true; }, out, &counts);
      }
    }
    return out;
  }
  CameraModel model() const { return {scene, 0, settings.width, settings.height, {-2, 2}, 1.0 / 8}; }
};

MotionState state(const Frame& f, const std::string& chain, int x, int y, int channel) {
  return MotionState(int(f.layer("chain." + chain + ".motion.state").at(x, y, channel)));
}
int count(const Frame& f, const std::string& chain, MotionState s, int channel = 0) {
  int n = 0;
  for (int y = 0; y < f.height(); ++y) {
    for (int x = 0; x < f.width(); ++x) n += state(f, chain, x, y, channel) == s;
  }
  return n;
}

/// Where the line of sight of a film position ends at time t, in coordinates of the matter there; empty where it goes
/// another way.
using Sight = std::function<std::optional<Vec2d>(const Vec2d& pixel, double t)>;

/// How far, in pixels, the vectors of a chain lead beside what their pixels show; and how many are tracked.
struct Accuracy {
  double worst = 0;
  int there = 0, tracked = 0;
};
constexpr double kNear = 80;  // metres: what stands far out on walls of 90 goes beyond them
Accuracy accuracy(const Frame& f, const std::string& chain, const Sight& sight, int step) {
  Accuracy a;
  const Image& vectors = f.layer("chain." + chain + (step > 0 ? ".motion.forward" : ".motion.backward"));
  for (int y = 0; y < f.height(); ++y) {
    for (int x = 0; x < f.width(); ++x) {
      const MotionState s = state(f, chain, x, y, step > 0 ? 0 : 1);
      EXPECT_EQ(vectors.at(x, y, 3), s == MotionState::kTracked ? 1 : 0);
      const Vec2d from{x + 0.5, y + 0.5};
      const auto now = sight(from, 0);
      if (s == MotionState::kEmpty || !now || length(*now) > kNear) continue;
      ++a.there;
      if (s != MotionState::kTracked) continue;
      ++a.tracked;
      const Vec2d to = from + Vec2d{double(vectors.at(x, y, 0)), double(vectors.at(x, y, 1))};
      constexpr double h = 1e-3;
      const auto then = sight(to, step), right = sight(to + Vec2d{h, 0}, step), down = sight(to + Vec2d{0, h}, step);
      if (!then || !right || !down) {
        ADD_FAILURE() << chain << " at " << x << ", " << y << " leads where nothing of it is seen";
        continue;
      }
      const Vec2d miss = *then - *now, du = (*right - *then) * (1 / h), dv = (*down - *then) * (1 / h);
      const double det = du.x * dv.y - du.y * dv.x;
      const Vec2d pixels{(miss.x * dv.y - miss.y * dv.x) / det, (du.x * miss.y - du.y * miss.x) / det};
      a.worst = std::max(a.worst, length(pixels));
    }
  }
  return a;
}

/// How many pixels have which state, for messages.
std::string states(const Frame& f, const std::string& chain, int step) {
  std::string text = chain;
  for (int k = 0; k < kMotionStates; ++k) {
    const int n = count(f, chain, MotionState(k), step > 0 ? 0 : 1);
    if (n > 0) text.append(1, ' ').append(std::to_string(k)).append(": ").append(std::to_string(n));
  }
  return text;
}

/// Where a line crosses a ball, at the first or the last of the two points.
std::optional<double> cross_ball(const Vec3d& o, const Vec3d& d, const Vec3d& c, double r, bool last) {
  const Vec3d m = o - c;
  const double b = dot(m, d), q = b * b - dot(m, m) + r * r;
  if (!(q > 0)) return std::nullopt;
  return last ? -b + std::sqrt(q) : -b - std::sqrt(q);
}
Vec3d mirrored(const Vec3d& d, const Vec3d& n) { return d - n * (2 * dot(d, n)); }
/// eta: on the far side over the near side.
std::optional<Vec3d> refracted(const Vec3d& d, const Vec3d& n, double eta) {
  const double c = dot(d, n), rest = 1 - (1 - c * c) / (eta * eta);
  if (!(rest > 0)) return std::nullopt;
  return (d - n * c) * (1 / eta) + n * std::copysign(std::sqrt(rest), c);
}
/// Where a line crosses the plane z = `z`, as seen from the origin `at` of its coordinates.
std::optional<Vec2d> on_wall(const Vec3d& o, const Vec3d& d, double z, const Vec3d& at) {
  const double s = (z - o.z) / d.z;
  if (!(s > 0)) return std::nullopt;
  const Vec3d p = o + d * s - at;
  return Vec2d{p.x, p.y};
}

const MaterialPtr kWhite = make_diffuse(0.7f);
MaterialPtr glass(float eta) { return make_dielectric({.int_ior = eta, .ext_ior = 1}); }
MaterialPtr mirror_of(float alpha) {
  ConductorParams p;
  p.roughness.rough = alpha > 0;
  p.roughness.alpha_u = p.roughness.alpha_v = alpha;
  return make_conductor(p);
}

// A mirror that turns and moves, a wall behind the camera that moves, too, and a camera that moves and turns.
struct MirrorShot : MotionShot {
  Move mirror{{0, 0, 0}, {0.05, 0.02, 0.1}, {0, 1, 0}, 0.06}, wall{{0, 0, 9}, {0.3, -0.2, 0}, {0, 1, 0}, 0};
  explicit MirrorShot(float alpha = 0) {
    add(quad({}, {3, 0, 0}, {0, 3, 0}), mirror_of(alpha), mirror.transform());
    add(quad({}, {-90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
    scene.nodes.push_back({node(Move{{0, 0, 5}, {-0.1, 0.05, 0.1}, {0, 1, 0}, 0.02}.transform()),
                           Affine3d(rotation(axis_angle(Vec3d{0, 1, 0}, kPiD))), "", 1.0f});  // cameras look along +z
    camera().node = int(scene.nodes.size()) - 1;
  }
  Sight sight() const {
    return [this, camera = model()](const Vec2d& pixel, double t) {
      const CameraModel::Sight s = camera.sight(pixel, t);
      const Vec3d n = Vec3d(tempera::rotation(axis_angle(mirror.axis, mirror.angle * t)).z), at = mirror.at(t);
      const Vec3d p = s.o + s.d * (dot(at - s.o, n) / dot(s.d, n));
      return on_wall(p, mirrored(s.d, n), 9, wall.at(t));
    };
  }
};

TEST(ChainMotion, PlanarMirror) {
  for (const float alpha : {0.0f, 0.05f}) {  // a little rough is taken for smooth
    MirrorShot shot(alpha);
    const Frame f = shot.render({"RD", "D", "TTD"});
    for (const int step : {1, -1}) {
      const Accuracy a = accuracy(f, "RD", shot.sight(), step);
      EXPECT_EQ(a.there, 48 * 36);
      EXPECT_EQ(a.tracked, a.there);
      EXPECT_LT(a.worst, 1e-4);
    }
    EXPECT_EQ(count(f, "D", MotionState::kEmpty), 48 * 36);
    EXPECT_EQ(count(f, "TTD", MotionState::kEmpty), 48 * 36);
  }
  MirrorShot rough(0.2f);
  const Frame f = rough.render({"RD", "D"});
  EXPECT_EQ(count(f, "RD", MotionState::kEmpty), 48 * 36) << "that rough, it counts as diffuse";
  EXPECT_EQ(count(f, "D", MotionState::kTracked), 48 * 36);
}

TEST(ChainMotion, OrthographicCameraAndThinLens) {
  MirrorShot shot;
  shot.camera().aperture_radius = 0.2f;
  shot.camera().focus_distance = 3.0f;
  Frame f = shot.render({"RD"});
  Accuracy a = accuracy(f, "RD", shot.sight(), 1);  // of the lens' center
  EXPECT_EQ(a.tracked, 48 * 36);
  EXPECT_LT(a.worst, 1e-4);
  shot.camera().aperture_radius = 0.0f;
  shot.camera().projection = Projection::kOrthographic;
  shot.camera().width = 3.0f;
  f = shot.render({"RD"});
  for (const int step : {1, -1}) {
    a = accuracy(f, "RD", shot.sight(), step);
    EXPECT_EQ(a.tracked, 48 * 36);
    EXPECT_LT(a.worst, 1e-4);
  }
}

TEST(ChainMotion, MirrorBall) {
  MotionShot shot;
  const Move ball{{0, 0, 0}, {0.25, 0.1, 0.15}, normalize(Vec3d{1, 2, 0}), 0.4}, wall{{0, 0, 8}, {0.4, 0.3, 0}};
  shot.add(Sphere{}, mirror_of(0), ball.transform(0.8));
  shot.add(quad({}, {-90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
  const Frame f = shot.render({"RD"});
  const Sight sight = [&, camera = shot.model()](const Vec2d& pixel, double t) -> std::optional<Vec2d> {
    const CameraModel::Sight s = camera.sight(pixel, t);
    const auto at = cross_ball(s.o, s.d, ball.at(t), 0.8, false);
    if (!at) return std::nullopt;
    const Vec3d p = s.o + s.d * *at;
    return on_wall(p, mirrored(s.d, normalize(p - ball.at(t))), 8, wall.at(t));
  };
  for (const int step : {1, -1}) {
    const Accuracy a = accuracy(f, "RD", sight, step);
    EXPECT_GT(a.there, 100);
    EXPECT_GE(a.tracked, 0.998 * a.there) << states(f, "RD", step);
    EXPECT_LT(a.worst, 1e-4);
  }
}

TEST(ChainMotion, GlassBallAndShell) {
  for (const bool shell : {false, true}) {
    MotionShot shot;
    const double size = shell ? 0.4 : 1;
    const Move ball{{0, 0, 0}, Vec3d{0.2, 0.1, -0.1} * size, {0, 0, 1}, 0.5},
        wall{{0, 0, -3}, Vec3d{0.2, -0.1, 0} * size};
    shot.add(Sphere{}, glass(1.5f), ball.transform(1));
    if (shell) shot.add(Sphere(Affine3f(), true), glass(1.5f), ball.transform(0.85));
    shot.add(quad({}, {90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
    const std::string chain = shell ? "TTTTD" : "TTD";
    const Frame f = shot.render({chain});
    const Sight sight = [&, camera = shot.model()](const Vec2d& pixel, double t) -> std::optional<Vec2d> {
      const CameraModel::Sight s = camera.sight(pixel, t);
      Vec3d o = s.o, d = s.d;
      struct Face {
        double radius, eta;
        bool last;
      };
      std::vector<Face> faces{{1, 1.5, false}, {1, 1 / 1.5, true}};
      if (shell) faces = {{1, 1.5, false}, {0.85, 1 / 1.5, false}, {0.85, 1.5, true}, {1, 1 / 1.5, true}};
      for (const Face& face : faces) {
        const auto at = cross_ball(o, d, ball.at(t), face.radius, face.last);
        if (!at) return std::nullopt;
        o = o + d * *at;
        const auto on = refracted(d, normalize(o - ball.at(t)), face.eta);
        if (!on) return std::nullopt;
        d = *on;
      }
      return on_wall(o, d, -3, wall.at(t));
    };
    for (const int step : {1, -1}) {
      const Accuracy a = accuracy(f, chain, sight, step);
      EXPECT_GT(a.there, 100);
      EXPECT_GE(a.tracked, 0.998 * a.there) << states(f, chain, step);
      EXPECT_LT(a.worst, 1e-4) << chain;
    }
  }
}

// Two sides of a slab that turns; sheets pass light straight on and keep their letter.
TEST(ChainMotion, SlabAndSheets) {
  MotionShot shot;
  const Move slab{{0, 0, 1}, {0.3, 0, 0.1}, {0, 1, 0}, 0.3}, wall{{0, 0, -2}, {0.15, 0.1, 0}};
  const auto face = [](double z, double side) { return quad({0, 0, float(z)}, {float(3 * side), 0, 0}, {0, 3, 0}); };
  shot.add(face(0.25, 1), glass(1.5f), slab.transform());
  shot.add(face(-0.25, -1), glass(1.5f), slab.transform());
  shot.add(quad({0, 0, 2}, {3, 0, 0}, {0, 3, 0}), make_dielectric({.thin = true}));
  shot.add(quad({}, {90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
  const Frame f = shot.render({"TTTD", "TTD"});
  const Sight sight = [&, camera = shot.model()](const Vec2d& pixel, double t) -> std::optional<Vec2d> {
    const CameraModel::Sight s = camera.sight(pixel, t);
    const Vec3d n = tempera::rotation(axis_angle(slab.axis, slab.angle * t)).z;
    const auto inside = refracted(s.d, n, 1.5);
    const Vec3d front = slab.at(t) + n * 0.25, back = slab.at(t) - n * 0.25;
    const Vec3d p = s.o + s.d * (dot(front - s.o, n) / dot(s.d, n));
    return on_wall(p + *inside * (dot(back - p, n) / dot(*inside, n)), s.d, -2, wall.at(t));
  };
  EXPECT_EQ(count(f, "TTD", MotionState::kEmpty), 48 * 36);
  for (const int step : {1, -1}) {
    const Accuracy a = accuracy(f, "TTTD", sight, step);
    EXPECT_EQ(a.tracked, 48 * 36);
    EXPECT_LT(a.worst, 1e-4);
  }
}

TEST(ChainMotion, SeenDirectlyAndThroughASheetAlone) {
  MotionShot shot;
  const Move wall{{0, 0, -2}, {0.15, 0.1, 0}, {0, 0, 1}, 0.1};
  shot.add(quad({0, 0, 2}, {0, 3, 0}, {-3, 0, 0}), make_dielectric({.thin = true}));
  shot.scene.shapes[0].geometry = quad({1.5, 0, 2}, {1.5, 0, 0}, {0, 3, 0});  // the right half
  shot.add(quad({}, {90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
  const Frame f = shot.render({"D", "TD"});
  const Sight sight = [&, camera = shot.model()](const Vec2d& pixel, double t) {
    const CameraModel::Sight s = camera.sight(pixel, t);
    const Vec2d p = *on_wall(s.o, s.d, -2, wall.at(t));
    const double c = std::cos(-wall.angle * t), r = std::sin(-wall.angle * t);
    return std::optional(Vec2d{c * p.x - r * p.y, r * p.x + c * p.y});
  };
  for (const char* chain : {"D", "TD"}) {
    const Accuracy a = accuracy(f, chain, sight, 1);
    EXPECT_EQ(a.there, 24 * 36) << chain;
    EXPECT_GE(a.tracked, 0.9 * a.there) << "all but what crosses the edge of the sheet";
    EXPECT_LT(a.worst, 1e-4) << chain;
  }
}

// The sky in a mirror ball: its directions are the ends.
TEST(ChainMotion, Background) {
  MotionShot shot;
  const Move ball{{0, 0, 0}, {0.25, 0.1, 0.15}};
  shot.add(Sphere{}, mirror_of(0), ball.transform(0.8));
  const Frame f = shot.render({"RD", "D"});
  const Sight sight = [&, camera = shot.model()](const Vec2d& pixel, double t) -> std::optional<Vec2d> {
    const CameraModel::Sight s = camera.sight(pixel, t);
    const auto at = cross_ball(s.o, s.d, ball.at(t), 0.8, false);
    if (!at) return std::nullopt;
    const Vec3d p = s.o + s.d * *at, d = mirrored(s.d, normalize(p - ball.at(t)));
    return Vec2d{d.x / (1 + d.z), d.y / (1 + d.z)};
  };
  const Accuracy a = accuracy(f, "RD", sight, 1);
  EXPECT_GT(a.there, 100);
  EXPECT_GE(a.tracked, 0.998 * a.there);
  EXPECT_LT(a.worst, 1e-4);
  EXPECT_EQ(count(f, "D", MotionState::kTracked) + a.there, 48 * 36) << "the sky beside it";
}

// What stands still has vectors of exactly zero, whatever moves elsewhere or at other times.
TEST(ChainMotion, StillIsZero) {
  MotionShot shot;
  shot.add(Sphere(), glass(1.5f), Affine3d(translate(Vec3d{0.3, 0.1, 0})));
  shot.add(quad({0, -1.1f, 0}, {9, 0, 0}, {0, 0, -9}), make_plastic({}));
  shot.add(quad({0, 0, -3}, {9, 0, 0}, {0, 9, 0}), kWhite);
  AnimatedTransform later;  // moves after frame 1
  later.keyed = true;
  later.translation = {{1, 2}, {Vec3d{-1.2, 0, 0}, Vec3d{2, 0, 0}}, Interpolation::kLinear};
  shot.add(Sphere(Affine3f(scale(Vec3f{0.3f, 0.3f, 0.3f}))), mirror_of(0), later);
  const Frame f = shot.render({"D", "RD", "TTD", "RRD", "TRTD"});
  for (const char* chain : {"D", "RD", "TTD", "TRTD"}) {
    EXPECT_GT(count(f, chain, MotionState::kTracked), 20) << chain;
    EXPECT_EQ(count(f, chain, MotionState::kTracked) + count(f, chain, MotionState::kEmpty), 48 * 36) << chain;
    for (const char* direction : {".motion.forward", ".motion.backward"}) {
      const Image& v = f.layer(std::string("chain.") + chain + direction);
      for (int y = 0; y < f.height(); ++y) {
        for (int x = 0; x < f.width(); ++x) {
          for (int c = 0; c < 3; ++c) ASSERT_EQ(v.at(x, y, c), 0.0f) << chain << ' ' << x << ' ' << y;
        }
      }
    }
  }
}

// A coat mirrors, and its base is seen through it: two chains of one pixel.
TEST(ChainMotion, OneSurfaceEndsOneChainAndPassesAnotherOn) {
  MirrorShot shot;
  shot.scene.shapes[0].material = make_plastic({});
  const Frame f = shot.render({"D", "RD"});
  EXPECT_EQ(count(f, "D", MotionState::kTracked), 48 * 36);
  const Accuracy a = accuracy(f, "RD", shot.sight(), 1);
  EXPECT_EQ(a.tracked, 48 * 36);
  EXPECT_LT(a.worst, 1e-4);
}

TEST(ChainMotion, SaysWhyThereIsNoVector) {
  // What mirrors show is hidden in the next frame, by a plate that comes before the wall.
  MirrorShot hidden;
  AnimatedTransform plate;
  plate.keyed = true;
  plate.translation = {{-1, 0, 1, 2}, {Vec3d{0, 99, 8}, {0, 99, 8}, {0, 0, 8}, {0, 0, 8}}, Interpolation::kLinear};
  hidden.add(quad({}, {-20, 0, 0}, {0, 20, 0}), kWhite, plate);
  Frame f = hidden.render({"RD"});
  EXPECT_EQ(count(f, "RD", MotionState::kOccluded, 0), 48 * 36);
  EXPECT_EQ(count(f, "RD", MotionState::kTracked, 1), 48 * 36);

  // The mirror itself is away.
  MirrorShot missed;
  AnimatedTransform away = missed.mirror.transform();
  away.translation = {{-1, 0, 1, 2}, {Vec3d{}, {}, {0, 50, 0}, {0, 50, 0}}, Interpolation::kLinear};
  missed.scene.nodes[missed.scene.instances[0].node].local = away;
  f = missed.render({"RD"});
  EXPECT_EQ(count(f, "RD", MotionState::kMissed, 0), 48 * 36);

  // A cut before the next frame; the first and the last frame of it have vectors on their sides.
  MirrorShot cut;
  cut.settings.cuts = {1};
  f = cut.render({"RD", "D"}, 0);
  EXPECT_EQ(count(f, "RD", MotionState::kCut, 0), 48 * 36);
  EXPECT_EQ(count(f, "RD", MotionState::kTracked, 1), 48 * 36);
  f = cut.render({"RD"}, 1);
  EXPECT_EQ(count(f, "RD", MotionState::kTracked, 0), 48 * 36);
  EXPECT_EQ(count(f, "RD", MotionState::kCut, 1), 48 * 36);

  // A map turns the mirror's normals.
  MirrorShot bumpy;
  bumpy.scene.shapes[0].material =
      make_normal_map(make_checkerboard(Rgb{0.5f, 0.6f, 1}, Rgb{0.6f, 0.5f, 1}, {}), 1, mirror_of(0));
  f = bumpy.render({"RD"});
  EXPECT_EQ(count(f, "RD", MotionState::kPerturbed, 0), 48 * 36);
  for (const char* layer : {"chain.RD.motion.forward", "chain.RD.motion.backward"}) {
    for (const float v : f.layer(layer).values()) ASSERT_EQ(v, 0.0f);
  }
}

TEST(ChainMotion, DoesNotDependOnTiles) {
  MirrorShot a, b;
  const Frame whole = a.render({"RD"}, 0, 64), parts = b.render({"RD"}, 0, 7);
  for (const Layer& l : whole.layers()) EXPECT_EQ(l.image, parts.layer(l.desc.name)) << l.desc.name;
  EXPECT_EQ(std::accumulate(a.counts.states.begin(), a.counts.states.end(), std::uint64_t(0)), 2u * 48 * 36);
}

// A mesh that deforms, walked there and back by hand; in few steps.
TEST(ChainMotion, ThereAndBack) {
  MotionShot shot;
  Mesh ball;  // with normals of its own
  constexpr int kRings = 48, kSectors = 96;
  for (int j = 0; j <= kRings; ++j) {
    for (int i = 0; i < kSectors; ++i) {
      const double a = kPiD * (j + 0.01) / (kRings + 0.02), b = 2 * kPiD * i / kSectors;
      const Vec3f n(Vec3d{std::sin(a) * std::cos(b), std::cos(a), std::sin(a) * std::sin(b)});
      ball.positions.push_back(n), ball.normals.push_back(n);
      if (j == kRings) continue;
      const auto at = [&](int jj, int ii) { return std::uint32_t(jj * kSectors + ii % kSectors); };
      for (const std::uint32_t v : {at(j, i), at(j, i + 1), at(j + 1, i), at(j + 1, i), at(j, i + 1), at(j + 1, i + 1)})
        ball.indices.push_back(v);
    }
  }
  const Move motion{{0, 0, 0}, {0.15, 0.08, 0.05}, {0, 1, 0}, 0.2}, wall{{0, 0, -3}, {0.1, -0.1, 0}};
  shot.add(ball, glass(1.4f), motion.transform());
  shot.add(quad({}, {90, 0, 0}, {0, 90, 0}), kWhite, wall.transform());
  validate(shot.scene);
  GeometryCache cache;
  const LightPathClassifier classifier;
  const SceneWindow window(shot.scene, shot.settings, classifier, 1.0 / 8, cache, {0, 0});
  const SceneTimeline& timeline = window.neighbourhood(0);
  const CameraModel& camera = window.frame(0).camera;
  const SceneMatter matter([&](double t) -> const RayScene& { return timeline.at(t).rays; },
                           [](const Vec3d&, const Vec3d&, double) {
                             return SceneMatter::Range{0, 1e6};
                           });
  int there = 0, done = 0, returned = 0;
  WalkCounts steps;
  for (int y = 0; y < 36; y += 2) {
    for (int x = 0; x < 48; x += 2) {
      const CameraModel::Sight s = camera.sight({x + 0.5, y + 0.5}, 0);
      const ChainEnd eye{false, s.o, {}, {}, {}}, anywhere{false, {0, 0, -3}, {}, {}, {}};
      const auto start = trace_chain(matter, eye, s.o + s.d, anywhere, {0, 0, 1}, {true, true}, 0, nullptr);
      if (!start) continue;
      const auto& out = start->vertices[1];
      const auto at = matter.meet(out.specular.surface.p, start->last.p - out.specular.surface.p, 0, &out);
      if (!at || at->point.instance != 1) continue;
      ++there;
      const ChainEnds ends{[&](double) { return eye; }, [&](double t) { return ChainEnd::of(matter.surface(*at, t)); },
                           [](double) {
                             return Vec3d{0, 0, 1};
                           }};
      SpecularChain path = *start;
      path.last = ends.last(0);
      const SpecularChain begin = path;
      if (walk_in_time(matter, ends, 1, 1e-9, path, &steps) != WalkState::kDone) continue;
      ++done;
      if (walk_in_time(matter, ends, 0, 1e-9, path) != WalkState::kDone) continue;
      const auto a = camera.project_double(first_bend(begin)->surface.p, 0),
                 b = camera.project_double(first_bend(path)->surface.p, 0);
      returned += length(*a - *b) < 1e-4;
    }
  }
  EXPECT_GT(there, 60);
  EXPECT_GE(done, 0.98 * there);
  EXPECT_GE(returned, 0.98 * done);
  EXPECT_LT(steps.temporal, 1.6 * done);
  EXPECT_LT(steps.spatial, 7 * done);
}

}  // namespace
}  // namespace tempera
