// SPDX-License-Identifier: Apache-2.0
// Partition of unity: a pair of a path and its shifted path can be sampled from either pixel, by next-event estimation
// or by the BSDF; the weights of all these ways sum to one [Kettunen 2015, Sec. 4].
//
// The weights are inside of the ShiftObserver. With p_a the density of the way a and g_a what it adds to the
// difference, the sum of p_a g_a over the ways from the base pixel, less that over those from the offset pixel, is the
// difference of the two contributions times the sum of all weights.
#include <functional>
#include <memory>

#include "../shift_mapping.h"
#include "../shift_observer.h"
#include "box_shot.h"

namespace tempera {
namespace {

/// A shot as an integrator sees it.
struct View {
  explicit View(BoxShot s) : shot(std::move(s)) { validate(shot.scene); }
  BoxShot shot;
  GeometryCache cache;
  TimeSpan around{-1, 1};
  RayScene rays{shot.scene, {0, 0}, around, {.motion_step = 1.0 / 16}, cache};
  LightSampler lights{shot.scene, rays};
  CameraModel camera{shot.scene, shot.settings.camera, shot.settings.width, shot.settings.height, around, 1.0 / 16};
  LightPathClassifier classifier{std::vector<std::string>{}};
  FrameContext context{shot.scene, rays, lights, camera, classifier, shot.settings};
};

Vec3d to_double(const Rgb& c) { return {double(c.r), double(c.g), double(c.b)}; }
Vec3d product(const Vec3d& a, const Vec3d& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }

/// A path from the camera over surfaces to a light.
struct LightPath {
  CameraSample camera;
  std::vector<Vertex> vertices;
  std::vector<BsdfSample> samples;  ///< between them
  LightSample light;                ///< seen from the last one
  float visible = 0;
};

BsdfSample sample_towards(const Vertex& v, const Vec3f& wi) {
  const BsdfEval f = v.bsdf.eval(v.s.wo, wi);
  BsdfSample s;
  s.wi = wi, s.f_cos = f.f_cos, s.pdf = f.pdf;
  return s;
}

class Pair {
 public:
  Pair(const View& view, float threshold, bool roulette)
      : view_(view),
        threshold_(threshold),
        roulette_(roulette),
        base_{camera_sample(view.context, 0, 0, 0), {}, {}, {}, 0},
        offset_(base_) {}

  enum Outcome { kNone, kFailed, kShifted };
  /// Makes the base path with `surfaces` surfaces from random numbers, and shifts it to the next pixel on the right.
  Outcome make(int x, int y, int index, int surfaces) {
    const FrameContext& c = view_.context;
    base_ = {camera_sample(c, x, y, index), {}, {}, {}, 0};
    base_.camera.film = {std::round(base_.camera.film.x * 4096) / 4096, base_.camera.film.y};  // + 1 is exact
    base_.camera.ray = c.camera.ray(base_.camera.film, base_.camera.lens, base_.camera.time);
    Vertex v;
    if (!see(base_.camera, v)) return kNone;
    base_.vertices.push_back(v);
    for (int i = 1; i < surfaces; ++i) {
      const VertexNumbers u = base_.camera.stream.vertex(std::uint32_t(i - 1));
      const auto s = v.bsdf.sample(v.s.wo, u.lobe, u.direction);
      if (!s || s->delta || s->transmitted || !go(base_.vertices.back(), s->wi, v)) return kNone;
      // The direction between the points as they are rounded: the one that the way back takes.
      v.s.wo = normalize(base_.vertices.back().s.p - v.s.p);
      v.make_bsdf();
      base_.samples.push_back(sample_towards(base_.vertices.back(), -v.s.wo));
      if (!(base_.samples.back().pdf > 0)) return kNone;
      base_.vertices.push_back(v);
    }
    const VertexNumbers u = base_.camera.stream.vertex(std::uint32_t(surfaces - 1));
    const auto light = c.lights.sample(v.s.p, 0, u.light_choice, u.light_point);
    if (!light || !(light->pdf > 0)) return kNone;
    base_.light = *light;
    base_.visible = visibility(c, v.s, light->wi, light->distance);
    return shift();
  }

  const LightPath& base() const { return base_; }
  const LightPath& offset() const { return offset_; }
  double jacobian() const { return jacobian_; }

  /// f of a path, in solid angle at its vertices.
  Vec3d contribution(const LightPath& p) const {
    const Vertex& last = p.vertices.back();
    Vec3d f = product(to_double(last.bsdf.eval(last.s.wo, p.light.wi).sum()), to_double(p.light.radiance)) *
              double(p.visible);
    for (const BsdfSample& s : p.samples) f = product(f, to_double(s.sum()));
    return f;
  }

  /// Sum of p_a g_a over the ways to sample the path, for the difference with neighbour `j`.
  Vec3d sampled(const LightPath& p, std::size_t j) const {
    std::array<bool, 4> inside{};
    inside[j] = true;
    const FrameContext& c = view_.context;
    const PathOptions options{Params(PathOptions::params())};
    ShiftObserver<false> before(c, options, threshold_, p.camera, inside);
    before.start(&p.vertices.front(), Rgb(0.0f));
    double density = 1;
    float beta = 1;  // that of roulette
    const auto survival = [&](const BsdfSample& s) {
      if (!roulette_) return 1.0f;
      beta *= max_component(s.sum()) / s.pdf;
      const float q = std::min(beta, kMaxContinue);
      beta /= q;
      return q;
    };
    const auto extend = [&](ShiftObserver<false>& o, std::size_t i, const BsdfSample& s, float q, const Vertex* to,
                            const Rgb& emitted, float light_pdf) {
      o.extend({p.vertices[i], s, s.sum() * (1 / (s.pdf * q)), q, roulette_, to, emitted, light_pdf, 1,
                std::uint32_t(i + 1), Rgb(0.0f)});
    };
    for (std::size_t i = 0; i < p.samples.size(); ++i) {
      const float q = survival(p.samples[i]);
      extend(before, i, p.samples[i], q, &p.vertices[i + 1], Rgb(0.0f), 0);
      density *= double(p.samples[i].pdf) * double(q);
    }
    const Vertex& last = p.vertices.back();
    const auto gain = [&](const ShiftObserver<false>& after) { return to_double(after.g(j) - before.g(j)); };

    ShiftObserver<false> by_light = before;
    by_light.next_event(last, p.light, last.bsdf.eval(last.s.wo, p.light.wi), p.visible);
    Vec3d sum = gain(by_light) * double(p.light.pdf);
    const BsdfSample s = sample_towards(last, p.light.wi);
    if (p.visible > 0 && s.pdf > 0 && !is_black(s.sum())) {
      const float q = survival(s);
      ShiftObserver<false> by_bsdf = before;
      Vertex end;
      if (p.light.point) {
        end.hit.point = *p.light.point;
        end.s = c.rays.shading_point(end.hit.point, 0, -p.light.wi);
        end.shape = &c.rays.shape(end.hit.point);
      }
      extend(by_bsdf, p.vertices.size() - 1, s, q, p.light.point ? &end : nullptr, p.light.radiance, p.light.pdf);
      sum = sum + gain(by_bsdf) * (double(s.pdf) * double(q));
    }
    return sum * density;
  }

 private:
  bool see(const CameraSample& camera, Vertex& v) const {
    Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, camera.time};
    int passed = 0;
    float pass_probability = 1;
    return follow(view_.context, camera.stream, 0, ray, &camera, v, passed, pass_probability) == EdgeEnd::kSurface &&
           finish(v);
  }
  bool go(const Vertex& from, const Vec3f& wi, Vertex& v) const {
    Ray ray{view_.rays.offset_origin(from.s.p, from.s.ng, wi), wi, 0, kInfinity, 0};
    int passed = 0;
    float pass_probability = 1;
    return follow(view_.context, base_.camera.stream, 1, ray, nullptr, v, passed, pass_probability) ==
               EdgeEnd::kSurface &&
           finish(v);
  }
  static bool finish(Vertex& v) {
    v.make_bsdf();
    return !v.shape->emission;
  }
  bool connects(const Vertex& v) const { return v.bsdf.least_roughness() > threshold_; }

  Outcome shift() {
    offset_ = base_;
    jacobian_ = 1;
    offset_.camera.film = base_.camera.film + kNeighbours[0];
    offset_.camera.ray = view_.camera.ray(offset_.camera.film, offset_.camera.lens, offset_.camera.time);
    if (!see(offset_.camera, offset_.vertices[0])) return kNone;
    bool joined = false;
    for (std::size_t i = 0; i < base_.samples.size(); ++i) {
      const Vertex &x = base_.vertices[i], &from = offset_.vertices[i], &next = base_.vertices[i + 1];
      Vec3f wi = base_.samples[i].wi;
      if (!joined && connects(x) && connects(from) && connects(next)) {
        const Vec3f d = next.s.p - from.s.p;
        wi = normalize(d);
        if (visibility(view_.context, from.s, wi, length(d)) == 0) return kFailed;
        jacobian_ *= double(reconnection_jacobian(x.s.p, from.s.p, next.s.p, next.s.ng));
        Vertex v = next;
        v.s.wo = -wi;
        v.make_bsdf();
        offset_.vertices[i + 1] = v;
        joined = true;
      } else if (!joined) {
        const auto s =
            shift_reflection(x.s.frame.to_local(x.s.wo), x.s.frame.to_local(wi), from.s.frame.to_local(from.s.wo));
        Vertex v;
        if (!s || !go(from, wi = from.s.frame.to_world(s->wi), v)) return kNone;
        if (connects(x) && connects(from) && connects(v)) return kFailed;  // the way back would connect
        jacobian_ *= double(s->jacobian);
        offset_.vertices[i + 1] = v;
      }
      offset_.samples[i] = sample_towards(offset_.vertices[i], wi);
      if (!(offset_.samples[i].pdf > 0)) return kFailed;
    }
    const Vertex &x = base_.vertices.back(), &last = offset_.vertices.back();
    if (!joined && !(connects(x) && connects(last))) return kNone;  // ends in another point of a light
    const auto light = view_.lights.connect(base_.light, last.s.p, 0);
    if (!light || !(light->pdf > 0)) return kNone;
    offset_.light = *light;
    offset_.visible = visibility(view_.context, last.s, light->wi, light->distance);
    if (light->point && !joined) {
      Vec3f n;
      const Vec3f y = view_.rays.position(*light->point, 0, &n);
      jacobian_ *= double(reconnection_jacobian(x.s.p, last.s.p, y, n));
    }
    return kShifted;
  }

  const View& view_;
  float threshold_;
  bool roulette_;
  LightPath base_, offset_;
  double jacobian_ = 1;
};

struct Case {
  const char* name;
  std::function<BoxShot()> shot;
  float threshold = 0.001f;
  /// Of the contributions. A copied half vector and the ray after it come back with the rounding errors of positions.
  double tolerance = 1e-5;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class ShiftWeights : public testing::TestWithParam<Case> {};

TEST_P(ShiftWeights, SumToOne) {
  const View view(GetParam().shot());
  int shifted = 0, failed = 0, half_hidden = 0;
  double worst = 0;
  for (const bool roulette : {false, true}) {
    for (int index = 0; index < 3000; ++index) {
      Pair pair(view, GetParam().threshold, roulette);
      const int surfaces = 1 + index % 3;
      const Pair::Outcome outcome = pair.make(index / 3 % 23, index / 69 % 20, index, surfaces);
      if (outcome == Pair::kNone) continue;
      const Vec3d base = pair.contribution(pair.base());
      Vec3d expected = base * -1.0, sum = pair.sampled(pair.base(), 0);
      double scale = length(base);
      if (outcome == Pair::kShifted) {
        const Vec3d offset = pair.contribution(pair.offset()) * pair.jacobian();
        expected = offset - base;
        sum = sum - pair.sampled(pair.offset(), 2) * pair.jacobian();
        scale += length(offset);
      }
      if (!(scale > 0)) continue;
      (outcome == Pair::kShifted ? shifted : failed) += 1;
      if (outcome == Pair::kShifted) half_hidden += (pair.base().visible > 0) != (pair.offset().visible > 0);
      worst = std::max(worst, length(sum - expected) / scale);
      EXPECT_LT(length(sum - expected) / scale, GetParam().tolerance)
          << "path " << index << ", surfaces " << surfaces << ", roulette " << roulette << ", visible "
          << pair.base().visible << " and " << pair.offset().visible;
    }
  }
  std::printf("%s: %d shifted, %d of them to or from where the light is hidden, %d failed; largest error %.1e\n",
              GetParam().name, shifted, half_hidden, failed, worst);
  EXPECT_GT(shifted, 300);
  EXPECT_GT(half_hidden, 5);
}

MaterialPtr rough(float alpha) {
  ConductorParams p;
  p.roughness = {true, Microfacets::kGgx, alpha, alpha, true};
  return make_conductor(p);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, ShiftWeights,
    testing::Values(Case{"area", [] { return BoxShot(make_diffuse(0.7f), make_diffuse(0.4f)).area_light(); }},
                    Case{"sky", [] { return BoxShot(make_diffuse(0.7f), make_diffuse(0.4f)).sky(); }},
                    Case{"both", [] { return BoxShot(make_diffuse(0.7f), make_diffuse(0.4f)).area_light().sky(); }},
                    Case{"glossy", [] { return BoxShot(rough(0.3f), rough(0.2f)).area_light(0.6f); }},
                    // Its weight f / pdf depends on the direction, so that the two paths survive roulette differently.
                    Case{"blend",
                         [] {
                           const MaterialPtr m = make_blend(0.5f, make_diffuse(0.5f), rough(0.3f));
                           return BoxShot(m, m).area_light(0.6f);
                         }},
                    Case{"glossy_copied", [] { return BoxShot(rough(0.3f), rough(0.2f)).area_light(0.6f); }, 0.5f,
                         2e-3}),
    [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace tempera
