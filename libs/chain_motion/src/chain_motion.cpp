// SPDX-License-Identifier: Apache-2.0
#include "tempera/chain_motion/chain_motion.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tempera/chain_motion/temporal_walk.h"
#include "tempera/manifold/scene_matter.h"
#include "tempera/transport/path_tracer.h"
#include "tempera/transport/pixel_motion.h"

namespace tempera {

namespace {

constexpr double kTolerance = 1e-5;  // of a walk, pixels
constexpr double kHidden = 1e-3;     // of the length of the last edge: what ends before it hides its end
constexpr double kFar =
    32.0 / 1280;                  // of the picture: a walk that ends so far from where it seemed to go has to return
constexpr double kOffset = 1e-4;  // of coordinates: rays start off surfaces
constexpr double kReturn = 0.1;   // pixels, from where it began
constexpr int kMostSteps = 200;   // of a walk; one that is done takes 5 in the mean
constexpr std::size_t kMostEyes = 16;

MotionState state_of(WalkState state) {
  switch (state) {
    case WalkState::kDone:
      return MotionState::kTracked;
    case WalkState::kMissed:
      return MotionState::kMissed;
    case WalkState::kTotal:
      return MotionState::kTotal;
    case WalkState::kSingular:
      return MotionState::kSingular;
    case WalkState::kStuck:
      return MotionState::kStuck;
  }
  return MotionState::kStuck;
}

struct ChainVector {
  MotionState state = MotionState::kEmpty;
  Vec2d pixels;
  double depth = 0;  ///< change of the length of the way
};

/// A chain as a pixel sees it: up to its end, which is none in the background.
struct SeenChain {
  MotionState state = MotionState::kEmpty;  ///< kTracked: it is there
  SpecularChain path;
  std::optional<ChainMatter::Crossing> end;
};

/// Chains of pixels of a frame, one pixel after another, and their motion. Threads: one thread each.
class ChainTracker {
 public:
  ChainTracker(const FrameContext& context, const SceneTimeline& timeline)
      : context_(context),
        matter_([&timeline](double t) -> const RayScene& { return timeline.at(t).rays; },
                [this](const Vec3d& o, const Vec3d& d, double t) { return first_range(o, d, t); }) {}
  ChainTracker(const ChainTracker&) = delete;
  ChainTracker& operator=(const ChainTracker&) = delete;

  /// What follows is about the center of pixel (x, y).
  void look_at(int x, int y) {
    pixel_ = {x + 0.5, y + 0.5};
    now_ = context_.settings.clock.exposure_time(context_.frame, 0.5, pixel_.y / context_.settings.height);
    sight_ = context_.camera.sight(pixel_, now_);
  }

  /// Finds which of `chains` (letters) the pixel has.
  std::vector<SeenChain> find(const std::vector<std::string>& chains) {
    std::vector<SeenChain> seen(chains.size());
    std::vector<int> all(chains.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = int(i);
    SpecularChain path;
    path.time = now_, path.first = eye(now_);
    follow(chains, all, sight_.o, sight_.d, path, seen);
    return seen;
  }

  /// Where what `chain` shows is seen `step` frames later.
  ChainVector motion(const SeenChain& chain, int step, ChainMotionCounts* counts) {
    if (chain.state != MotionState::kTracked) return {chain.state};
    if (context_.settings.is_cut(step > 0 ? context_.frame + 1 : context_.frame)) return {MotionState::kCut};
    const bool bends = first_bend(chain.path);
    if (!chain.end && !bends) return of_background(step);
    const double then = now_ + step * context_.settings.clock.frame_duration();
    const ChainEnds ends = ends_of(chain);
    SpecularChain path = chain.path;
    const double tolerance = tolerance_of(chain.path);
    if (path.vertices.empty()) {
      path.time = then, path.first = eye(then), path.last = ends.last(then);
    } else {
      WalkCounts steps{.most = kMostSteps};
      const WalkState walk = walk_in_time(matter_, ends, then, tolerance, path, &steps);
      if (counts) counts->steps.spatial += steps.spatial, counts->steps.temporal += steps.temporal;
      if (walk != WalkState::kDone) return {state_of(walk)};
    }
    if (hides_end(path, chain)) return {MotionState::kOccluded};
    if (const MotionState s = look_again(path); s != MotionState::kTracked) return {s};
    // Where nothing has moved, rounding has not either.
    if (stands_still(chain, path, ends)) path.vertices = chain.path.vertices, path.last = chain.path.last;
    const auto from = context_.camera.project_double(seen_point(chain.path), now_);
    const auto to = context_.camera.project_double(seen_point(path), then);
    if (!from || !to) return {MotionState::kOutside};
    const Vec2d pixels{to->x - from->x, to->y - from->y};
    if (bends && strays(chain.path, ends, then, {to->x, to->y}) && !returns(path, ends, tolerance, {from->x, from->y}))
      return {MotionState::kBranch};
    const double depth = chain.end ? length_of(path) - length_of(chain.path) : 0;
    if (!std::isfinite(pixels.x) || !std::isfinite(pixels.y) || !std::isfinite(depth)) return {MotionState::kStuck};
    return {MotionState::kTracked, pixels, depth};
  }

 private:
  /// The camera at a time.
  struct Eye {
    double time = 0;
    ChainEnd end;  ///< the center of the lens, or the direction of all rays
    Vec3d o, axis;
    double near = 0, far = 0;  ///< along the axis
  };
  const Eye& camera_at(double t) const {
    for (const Eye& e : eyes_) {
      if (e.time == t) return e;
    }
    const CameraModel& camera = context_.camera;
    const auto place = [&](double time) {
      const CameraModel::Sight s = camera.sight({}, time);
      return camera.is_perspective() ? s.o : -s.d;
    };
    const CameraModel::Sight s = camera.sight({}, t);
    const double h = 1e-3 * context_.settings.clock.frame_duration();
    Eye e{t, {!camera.is_perspective(), place(t), {}, {}, {}}, s.o, normalize(Vec3d(camera.axis(t))), 0, 0};
    e.end.dpdt = (place(t + h) - place(t - h)) * (0.5 / h);  // a walk's first step alone depends on it
    const double along = dot(s.d, e.axis);
    e.near = s.tmin * along, e.far = s.tmax * along;
    if (eyes_.size() >= kMostEyes) eyes_.clear();
    eyes_.push_back(e);
    return eyes_.back();
  }
  ChainEnd eye(double t) const { return camera_at(t).end; }
  SceneMatter::Range first_range(const Vec3d& o, const Vec3d& d, double t) const {
    const Eye& e = camera_at(t);
    const double along = dot(d, e.axis), before = dot(o - e.o, e.axis);  // parallel rays begin anywhere
    return {(e.near - before) / along, (e.far - before) / along};
  }

  /// From o in direction d, with `path` up to there, for the chains `active`, of which path.vertices have been followed.
  void follow(const std::vector<std::string>& chains, const std::vector<int>& active, const Vec3d& o, const Vec3d& d,
              SpecularChain& path, std::vector<SeenChain>& seen) {
    const std::size_t depth = path.vertices.size();
    const ChainVertex* from = depth > 0 ? &path.vertices.back() : nullptr;
    const auto at = matter_.meet(o, d, now_, from);
    const auto of_letter = [&](char letter) {
      std::vector<int> some;
      for (const int i : active) {
        if (chains[i][depth] == letter) some.push_back(i);
      }
      return some;
    };
    const std::vector<int> ending = of_letter('D');
    if (!at) {
      if (matter_.first_hit(o, d, now_, from)) {  // at an edge, where no primitive has it
        for (const int i : active) seen[i].state = MotionState::kMissed;
        return;
      }
      for (const int i : ending) {
        seen[i] = {MotionState::kTracked, path, std::nullopt};
        seen[i].path.last = infinite_end(d, {});
      }
      return;
    }
    const RayScene& rays = matter_.rays(now_);
    const SurfaceFrame f = matter_.surface(*at, now_);
    Vertex v;
    v.hit = {at->point, 0};
    new (&v.s) ShadingPoint(rays.shading_point(at->point, now_, Vec3f(-d)));
    v.shape = &rays.shape(at->point);
    v.make_bsdf();
    if (!ending.empty() && ends_chain(v)) {
      for (const int i : ending) {
        seen[i] = {MotionState::kTracked, path, at};
        seen[i].path.last = ChainEnd::of(f);
        seen[i].path.last_normal = f.ng;
      }
    }
    for (const bool refracts : {false, true}) {
      const std::vector<int> some = of_letter(refracts ? 'T' : 'R');
      if (some.empty()) continue;
      const SceneMatter::Bend does = SceneMatter::find_bend(v.bsdf, -d, f.n, refracts);
      if (does.does == SceneMatter::Does::kNothing) continue;
      const SpecularVertex vertex{f, does.eta};
      Vec3d on;
      MotionState state = state_of(bend(vertex, refracts, -d, on));
      if (does.does == SceneMatter::Does::kPerturbed) state = MotionState::kPerturbed;
      if (state != MotionState::kTracked) {
        for (const int i : some) seen[i].state = state;
        continue;
      }
      path.vertices.push_back({*at, refracts, vertex});
      follow(chains, some, f.p, on, path, seen);
      path.vertices.pop_back();
    }
  }
  /// Whether a path ends its chain here, as chain_features.h has it.
  bool ends_chain(const Vertex& v) const {
    if (v.bsdf.empty()) return true;
    if (v.shape->emission && !is_black(context_.at(now_).lights.emitted(v.hit.point, v.s))) return true;
    return !is_black(v.bsdf.diffuse_albedo(v.s.wo));
  }

  ChainEnds ends_of(const SeenChain& chain) const {
    ChainEnds ends;
    ends.first = [this](double t) { return eye(t); };
    if (chain.end) {
      auto frame = [this, &chain, at = std::numeric_limits<double>::quiet_NaN(), f = SurfaceFrame()](double t) mutable {
        if (at != t) f = matter_.surface(*chain.end, t), at = t;
        return f;
      };
      ends.last = [frame](double t) mutable { return ChainEnd::of(frame(t)); };
      ends.last_normal = [frame](double t) mutable { return frame(t).ng; };
    } else {
      const auto at = [this, &chain](double t) {
        return Vec3d(context_.at(now_).lights.environment_motion(Vec3f(chain.path.last.p), now_, t));
      };
      const bool turns = at(now_ + context_.settings.clock.frame_duration()) != at(now_);
      ends.last = [=, &chain](double t) { return infinite_end(turns ? normalize(at(t)) : chain.path.last.p, {}); };
      ends.last_normal = [](double) { return Vec3d{}; };
    }
    return ends;
  }

  /// How far from its end a walk may stop, in metres or radians, to be exact to kTolerance in the picture.
  double tolerance_of(const SpecularChain& chain) const {
    const double way = length_of(chain), least = 1e-12 * (1 + way), most = 1e-3 * (1 + way);
    const CameraModel::Sight beside = context_.camera.sight({pixel_.x + 1, pixel_.y}, now_);
    const bool perspective = context_.camera.is_perspective();
    const double pixel = perspective ? length(beside.d - sight_.d) : length(beside.o - sight_.o);
    const std::vector<SpecularVertex> bends = bends_of(chain);
    if (bends.empty()) return std::clamp(kTolerance * pixel * (perspective ? way : 1), least, most);
    // By how many pixels the path is seen elsewhere if its end moves by one unit along either of two axes.
    ChainEnd last = infinite_end(chain.last.infinite ? chain.last.p : chain.last_normal, {});
    last.infinite = chain.last.infinite, last.p = chain.last.p;
    const SpecularSystem system(chain.first, bends, last);
    if (system.singular()) return least;
    const SurfaceFrame& f = bends[0].surface;
    const double distance = perspective ? length(f.p - sight_.o) : 1;
    double squares = 0;
    for (const Vec2d& axis : {Vec2d{1, 0}, Vec2d{0, 1}}) {
      const Vec2d q = system.solve({}, axis, 0)[0];
      const Vec3d across = cross(f.dpdu * q.x + f.dpdv * q.y, sight_.d);
      squares += dot(across, across);
    }
    return std::clamp(kTolerance * pixel * distance / std::sqrt(squares), least, most);
  }

  /// Whether everything on the path is where it was.
  bool stands_still(const SeenChain& chain, const SpecularChain& path, const ChainEnds& ends) const {
    const auto still = [](const ChainEnd& a, const ChainEnd& b) { return a.p == b.p; };
    if (!still(ends.first(path.time), chain.path.first) || !still(ends.last(path.time), chain.path.last)) return false;
    return std::all_of(chain.path.vertices.begin(), chain.path.vertices.end(), [&](const ChainVertex& v) {
      const SurfaceFrame now = matter_.surface(v.at, path.time);
      return now.p == v.specular.surface.p && now.n == v.specular.surface.n;
    });
  }

  bool hides_end(const SpecularChain& path, const SeenChain& chain) const {
    const ChainVertex* from = path.vertices.empty() ? nullptr : &path.vertices.back();
    const bool parallel = !from && path.first.infinite;
    const Vec3d o = from ? from->specular.surface.p : parallel ? path.last.p + path.first.p : path.first.p;
    if (path.last.infinite) return matter_.first_hit(o, path.last.p, path.time, from).has_value();
    const Vec3d way = path.last.p - o;
    const double distance = length(way);
    const auto met = matter_.first_hit(o, way * (1 / distance), path.time, from);
    return !met || met->point.instance != chain.end->point.instance ||
           std::abs(double(met->t) - distance) > kHidden * distance + kOffset * length(path.last.p);
  }

  /// Whether the surfaces that the path has come to do there what it takes them to do: textures may say otherwise.
  MotionState look_again(const SpecularChain& path) const {
    Vec3d before = path.first.p;
    for (std::size_t i = 0; i < path.vertices.size(); ++i) {
      const ChainVertex& v = path.vertices[i];
      const SurfaceFrame& f = v.specular.surface;
      const Vec3d wo = i == 0 && path.first.infinite ? before : normalize(before - f.p);
      before = f.p;
      if (!SceneMatter::varies(*context_.scene.shapes[v.at.point.shape].material)) continue;
      const SceneMatter::Bend does = matter_.find_bend(v.at, f, wo, v.refracts, path.time);
      if (does.does == SceneMatter::Does::kNothing) return MotionState::kMissed;
      if (does.does == SceneMatter::Does::kPerturbed) return MotionState::kPerturbed;
    }
    return MotionState::kTracked;
  }

  /// Whether the path is far from where its first motion led.
  bool strays(const SpecularChain& start, const ChainEnds& ends, double then, const Vec2d& to) const {
    const auto predicted = predict(matter_, ends, start, then - now_);
    const auto seen = predicted ? context_.camera.project_double(*predicted, then) : std::nullopt;
    const double most = kFar * std::max(context_.settings.width, context_.settings.height);
    return !seen || length(Vec2d{seen->x, seen->y} - to) > most;
  }
  /// Whether a walk back leads to where it began.
  bool returns(SpecularChain path, const ChainEnds& ends, double tolerance, const Vec2d& from) const {
    if (walk_in_time(matter_, ends, now_, tolerance, path) != WalkState::kDone) return false;
    const auto back = context_.camera.project_double(seen_point(path), now_);
    return back && length(Vec2d{back->x, back->y} - from) <= kReturn;
  }

  /// What of the path shows where it is seen.
  static Vec3d seen_point(const SpecularChain& path) {
    const SpecularVertex* v = first_bend(path);
    return v ? v->surface.p : path.last.p;
  }
  /// The way from the camera to the end, or to the last vertex before the background.
  double length_of(const SpecularChain& path) const {
    double sum = 0;
    Vec3d before = path.first.p;
    bool known = !path.first.infinite;
    const auto add = [&](const Vec3d& p) {
      sum += known ? length(p - before) : dot(p - camera_at(path.time).o, camera_at(path.time).axis);
      before = p, known = true;
    };
    for (const ChainVertex& v : path.vertices) add(v.specular.surface.p);
    if (!path.last.infinite) add(path.last.p);
    return sum;
  }

  ChainVector of_background(int step) const {
    PixelView view;
    view.ray = context_.camera.ray(Vec2f(pixel_), {0.5f, 0.5f}, now_);
    view.time = now_;
    const auto m = pixel_motion(context_, view, step);
    if (!m) return {MotionState::kOutside};
    return {MotionState::kTracked, Vec2d(m->pixels), 0};
  }

  const FrameContext& context_;
  SceneMatter matter_;
  Vec2d pixel_;
  double now_ = 0;
  CameraModel::Sight sight_;
  mutable std::vector<Eye> eyes_;
};

/// The layers of one chain.
struct ChainLayers {
  Image *forward = nullptr, *backward = nullptr, *state = nullptr;
};

}  // namespace

void write_chain_motion(const FrameContext& context, const SceneTimeline& neighbourhood, const Tile& tile,
                        const std::function<bool(int x, int y)>& wants, Frame& out, ChainMotionCounts* counts) {
  std::vector<std::string> chains;
  std::vector<ChainLayers> layers_of;
  for (const Layer& l : out.layers()) {
    const std::string& chain = l.desc.chain;
    if (chain.empty() || std::find(chains.begin(), chains.end(), chain) != chains.end()) continue;
    const auto find = [&](const LayerDesc& d) {
      const LayerDesc desc = layers::chain_layer(chain, d);
      return out.has(desc.name) ? &out.layer(desc.name) : nullptr;
    };
    const ChainLayers found{find(layers::motion_forward()), find(layers::motion_backward()),
                            find(layers::motion_state())};
    if (!found.forward && !found.backward && !found.state) continue;
    chains.push_back(chain), layers_of.push_back(found);
  }
  if (chains.empty()) return;
  ChainTracker tracker(context, neighbourhood);
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      if (!wants(x, y)) continue;
      tracker.look_at(x, y);
      const std::vector<SeenChain> seen = tracker.find(chains);
      const int ox = x - context.settings.x0(), oy = y - context.settings.y0();
      for (std::size_t i = 0; i < chains.size(); ++i) {
        const auto write = [&](Image* image, int step, int channel) {
          if (!image && !layers_of[i].state) return;
          const ChainVector v = tracker.motion(seen[i], step, counts);
          if (counts) ++counts->states[std::size_t(v.state)];
          const bool valid = v.state == MotionState::kTracked;
          if (layers_of[i].state) layers_of[i].state->at(ox, oy, channel) = float(v.state);
          if (!image) return;
          image->at(ox, oy, 0) = valid ? float(v.pixels.x) : 0.0f;
          image->at(ox, oy, 1) = valid ? float(v.pixels.y) : 0.0f;
          image->at(ox, oy, 2) = valid ? float(v.depth) : 0.0f;
          image->at(ox, oy, 3) = valid ? 1.0f : 0.0f;
        };
        write(layers_of[i].forward, 1, 0);
        write(layers_of[i].backward, -1, 1);
      }
    }
  }
}

}  // namespace tempera
