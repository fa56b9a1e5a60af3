// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/photon_tracer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "tempera/core/fixed_stack.h"
#include "tempera/transport/path_tracer.h"

namespace tempera {

namespace {

/// Directions of a column at most, as a tangent.
constexpr double kMostSpread = 0.5;
/// Of the flux that a photon began with: branches with less go on by chance.
constexpr float kLeastFlux = 0.05f;
/// Footprints over a point of weak light, at least.
constexpr double kLeastOverlap = 4;
/// Largest footprint and largest way during the exposure, of the diameter of the scene.
constexpr double kMostRadius = 0.025, kMostSweep = 0.1;
/// Smallest one where the pixels do not say it, of the diameter.
constexpr double kLeastRadius = 2e-4;
/// Of the radius of the scene, for discs.
constexpr double kDiscRadius = 0.0125;
/// Cosines below which a surface is not met, and below which a footprint is no ellipse any more.
constexpr double kParallel = 1e-7;
constexpr double kGrazing = 1e-4;
/// Change of the normal over a beam from which on it is no longer nearly linear: half of it to each side.
constexpr double kCurved = 1;
/// How often a beam is divided, and which part of the photon's flux is worth it.
constexpr int kMostDivisions = 2;
constexpr float kLeastDivided = 0.01f;
/// Samples that tell how much light goes where, of all lights and targets together.
constexpr std::size_t kPilots = 65536;
/// All photons for each of those that stand for them where little is seen of it.
constexpr std::int64_t kFew = 8;
/// Share of photons that goes wherever lights shine, in case something focuses light that was not known to.
constexpr double kEverywhere = 0.1;
/// The same, of all its light, for a lamp that seems not to reach anything that focuses.
constexpr double kOutOfSight = 1e-3;

/// Whether a surface sends light from `wo` on by R or T, and not straight through.
bool focuses(const Bsdf& bsdf, const Vec3f& wo) {
  if (bsdf.has_near_specular()) return true;
  for (int i = 0; i < bsdf.size(); ++i) {
    if (!bsdf.is_delta(i)) continue;
    const auto s = bsdf.sample_delta(i, wo);
    if (s && !is_passage(*s)) return true;
  }
  return false;
}

/// The same at some points of a shape, from both sides.
bool focuses(const RayScene& rays, std::uint32_t instance, std::uint32_t shape, double t) {
  const Shape& s = rays.scene().shapes[shape];
  const auto* mesh = std::get_if<Mesh>(&s.geometry);
  const std::size_t triangles = mesh ? mesh->triangle_count() : 1;
  constexpr std::size_t kPoints = 32;
  Bsdf bsdf;
  for (std::size_t k = 0; k < std::min(kPoints, mesh ? triangles : kPoints); ++k) {
    SurfacePoint point{instance, shape, 0, 0.3f, 0.3f};
    if (mesh) {
      point.primitive = std::uint32_t(k * triangles / std::min(kPoints, triangles));
    } else {
      point.u = (float(k) + 0.5f) / kPoints;
      point.v = to_unit_float(std::uint32_t(mix64(k)));
    }
    for (const float side : {1.0f, -1.0f}) {
      Vec3f ng;
      rays.position(point, t, &ng);
      if (!(length_squared(ng) > 0)) continue;
      const Basis b(ng);
      const Vec3f wo = normalize(ng * side + b.s * 0.5f);
      ShadingPoint at = rays.shading_point(point, t, wo);
      at.bends = false;
      make_bsdf(*s.material, at, bsdf);
      if (focuses(bsdf, wo)) return true;
    }
  }
  return false;
}

/// Joins boxes that lie near each other until there are at most `most`.
void join(std::vector<Bounds3f>::iterator first, std::vector<Bounds3f>::iterator last, std::size_t most,
          std::vector<Bounds3f>& out) {
  const auto count = std::size_t(last - first);
  if (count <= most) {
    out.insert(out.end(), first, last);
    return;
  }
  Bounds3f all, centers;
  for (auto i = first; i != last; ++i) all.extend(*i), centers.extend(i->center());
  if (most == 1) {
    out.push_back(all);
    return;
  }
  const Vec3f size = centers.hi - centers.lo;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const auto middle = first + std::ptrdiff_t(count / 2);
  std::nth_element(first, middle, last,
                   [&](const Bounds3f& a, const Bounds3f& b) { return a.center()[axis] < b.center()[axis]; });
  join(first, middle, most / 2, out);
  join(middle, last, most - most / 2, out);
}

/// Whether layers of independent halves of the samples are asked for.
bool asks_for_halves(const RenderSettings& settings) {
  return std::any_of(settings.layers.begin(), settings.layers.end(), [](const std::string& name) {
    return name == "color.a" || name == "color.b" || name == "color.var";
  });
}

}  // namespace

PhotonCounts& PhotonCounts::operator+=(const PhotonCounts& o) {
  emitted += o.emitted, stored += o.stored, clamped += o.clamped, curved += o.curved;
  emitted_flux += o.emitted_flux, stored_flux += o.stored_flux;
  escaped_flux += o.escaped_flux, absorbed_flux += o.absorbed_flux;
  return *this;
}

std::string describe(const PhotonCounts& counts) {
  const double whole = std::max(counts.emitted_flux, 1e-300);
  return fmt::format(
      "{} photons emitted, {} stored; of their flux {:.3g} % arrived, {:.3g} % escaped, {:.3g} % was absorbed; {} "
      "footprints limited, {} photons bent strongly",
      counts.emitted, counts.stored, 100 * counts.stored_flux / whole, 100 * counts.escaped_flux / whole,
      100 * counts.absorbed_flux / whole, counts.clamped, counts.curved);
}

std::vector<Bounds3f> find_casters(const RayScene& rays, TimeSpan span) {
  const Scene& scene = rays.scene();
  const double t = 0.5 * (span.begin + span.end);
  std::vector<Bounds3f> boxes, result;
  std::vector<signed char> known(scene.shapes.size(), -1);
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    if (!scene.visible(scene.instances[i].node, t)) continue;
    for (const int shape : scene.groups[scene.instances[i].group]) {
      signed char& k = known[shape];
      if (k < 0) k = focuses(rays, i, std::uint32_t(shape), t);
      if (!k) continue;
      const Bounds3f box = rays.swept_bounds(i, std::uint32_t(shape), span);
      if (!box.empty()) boxes.push_back(box);
    }
  }
  join(boxes.begin(), boxes.end(), LightAim::kMaxTargets, result);
  return result;
}

/// A photon on its way.
struct PhotonTracer::Branch {
  Beam beam;
  Rgb flux;
  float relative = 1;  ///< flux over that of the start, at least kLeastFlux
  float rate = 0;
  double distance = 0;  ///< from the light to where the beam was bent first
  EmitterMotion emitter;
  Vec3f ray_from;
  PhotonEvents events;
  int depth = 0;
  std::int64_t photons = 0;  ///< of the light
  float thinning = 1;        ///< part of the photons that has survived roulette
  double width = 1;          ///< length of columns over those of the start
  float coarse_scale = 0;    ///< as in Photon
  std::uint64_t salt = 0;    ///< tells the parts of a photon that was divided apart
  bool bent = false, from_infinity = false;
  std::uint8_t half = 0;
};

PhotonTracer::PhotonTracer(const FrameContext& piece, const PhotonOptions& options, TimeSpan exposure, int set,
                           std::int64_t photons, int max_depth, int pass, bool whole)
    : context_(piece),
      options_(options),
      exposure_(exposure),
      set_(pass * int(options.instants_of(exposure, pass, whole).size()) + set),
      scale_(PhotonOptions::area_scale(pass)),
      instant_(options.instants_of(exposure, pass, whole)[set]),
      kernel_{options.kernel, options.sweep, options.filter, 0, 0},
      photons_(photons),
      max_depth_(max_depth),
      halves_(asks_for_halves(piece.settings)),
      casters_(find_casters(piece.rays, exposure)) {
  if (options.temporal) {
    const TimeSpan reach = PhotonOptions::reach_of(exposure, pass, whole);
    kernel_.begin = reach.begin - instant_, kernel_.end = reach.end - instant_;
  }
  const Scene& scene = piece.scene;
  moves_.resize(scene.instances.size());
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    for (const int shape : scene.groups[scene.instances[i].group])
      moves_[i] |= char(piece.rays.moves(i, std::uint32_t(shape), exposure));
  }
  diameter_ = 2 * double(std::max(piece.rays.bounds().radius(), 1e-6f));
  const RenderSettings& s = piece.settings;
  const Vec2f middle{0.5f * float(s.width), 0.5f * float(s.height)};
  const CameraRay a = piece.camera.ray(middle, {0.5f, 0.5f}, instant_);
  const CameraRay b = piece.camera.ray(middle + Vec2f{1, 0}, {0.5f, 0.5f}, instant_);
  eye_ = Vec3d(piece.camera.position(instant_));
  pixel_size_ = length(Vec3d(a.o) - Vec3d(b.o));
  pixel_angle_ = length(Vec3d(a.d) - Vec3d(b.d));
  plan();
}

/// Half of a pixel where the camera sees it; less in later passes.
double PhotonTracer::least_radius(const Vec3d& p) const {
  const double r = 0.5 * (pixel_size_ + pixel_angle_ * length(p - eye_)) * std::sqrt(scale_);
  return std::clamp(r, 1e-3 * kLeastRadius * diameter_, 10 * kLeastRadius * diameter_);
}

double PhotonTracer::disc_radius() const {
  if (!options_.discs) return 0;
  return options_.radius > 0 ? options_.radius : kDiscRadius * 0.5 * diameter_;
}

/// Of what starts as `e`: whether it meets a surface that focuses light.
bool PhotonTracer::meets_caster(const AimedLight& e) const {
  const Vec3f w(e.w);
  const Vec3f from = length_squared(e.n) > 0 ? context_.rays.offset_origin(Vec3f(e.p), e.n, w) : Vec3f(e.p);
  Hit hit;
  if (!context_.rays.intersect({from, w, 0, kInfinity, instant_}, hit)) return false;
  ShadingPoint at = context_.rays.shading_point(hit.point, instant_, -w);
  at.bends = false;
  Bsdf bsdf;
  make_bsdf(*context_.rays.shape(hit.point).material, at, bsdf);
  return focuses(bsdf, -w);
}

/// Photons that miss what they are aimed at light nothing, and footprints need not be as wide as if they did.
double PhotonTracer::overlap_of(std::int64_t photons) const {
  return options_.overlap_of(std::int64_t(met_ * double(photons)));
}

/// Divides the photons among the lights and their parts by the light that goes there.
void PhotonTracer::plan() {
  const std::uint32_t count = LightAim::light_count(context_.lights);
  lamps_.resize(count);
  const auto pilots = std::uint32_t(std::clamp<std::size_t>(kPilots / (count * (casters_.size() + 1) + 1), 4, 64));
  std::vector<double> weights;
  double towards_all = 0, aimed = 0, met = 0;
  for (std::uint32_t l = 0; l < count; ++l) {
    const bool emits = options_.lights.empty()
                           ? LightAim::is_concentrated(context_.lights, l)
                           : std::find(options_.lights.begin(), options_.lights.end(),
                                       LightAim::light_name(context_.lights, l)) != options_.lights.end();
    lights_.push_back(emits);
    if (!emits) continue;
    Lamp& lamp = lamps_[l];
    lamp.aim.emplace(context_.lights, l, casters_, instant_);
    const int parts = lamp.aim->parts();
    std::vector<double> power(parts);
    for (int k = 0; k < parts; ++k) {
      std::vector<double> alone(parts);
      alone[k] = 1;
      for (std::uint32_t i = 0; i < pilots; ++i) {
        const SampleStream stream(SamplerKind::kSobol, context_.settings.seed, stream_number(StreamPurpose::kPilot, 0),
                                  int(l), k, i);
        const LightNumbers u = stream.light();
        const auto e = lamp.aim->emit(k, alone, u.choice, u.position, u.direction);
        if (!e) continue;
        const double part = double(luminance(e->power)) / (e->pdf_position * e->pdf_direction * pilots);
        power[k] += part;
        if (k > 0) aimed += part, met += meets_caster(*e) ? part : 0;
      }
    }
    double towards = 0;
    for (int k = 1; k < parts; ++k) towards += power[k];
    power[0] = towards > 0 ? kEverywhere * towards : kOutOfSight * power[0];
    for (int k = 0; k < parts; ++k) {
      shares_.push_back({l, k, 0, 0});
      weights.push_back(power[k]);
      towards_all += power[k];
    }
  }
  if (met > 0) met_ = met / aimed;
  if (!(towards_all > 0)) {
    photons_ = 0;
    shares_.clear();
    lights_.assign(count, 0);
    return;
  }
  std::int64_t before = 0;
  for (std::size_t i = 0; i < shares_.size(); ++i) {
    if (!(weights[i] > 0)) continue;
    const auto part = std::int64_t(std::llround(double(photons_) * weights[i] / towards_all));
    shares_[i].first = before, shares_[i].count = std::max<std::int64_t>(part, 2);
    before += shares_[i].count;
    lamps_[shares_[i].light].photons += shares_[i].count;
  }
  for (std::uint32_t l = 0; l < count; ++l) lights_[l] = lamps_[l].photons > 0;
  for (const Share& s : shares_) {
    Lamp& lamp = lamps_[s.light];
    lamp.shares.push_back(lamp.photons > 0 ? double(s.count) / double(lamp.photons) : 0.0);
  }
  std::erase_if(shares_, [](const Share& s) { return s.count == 0; });
  photons_ = before;
}

/// The numbers of a photon. It keeps them from frame to frame, so that what is left of noise does not flicker. Those of a
/// stream's even numbers are one net, those of the odd ones another.
SampleStream PhotonTracer::stream_of(const Share& share, std::int64_t i) const {
  const RenderSettings& s = context_.settings;
  return {s.sampler,
          s.seed,
          stream_number(StreamPurpose::kLight, 0),
          int(share.light),
          share.part + set_ * (int(LightAim::kMaxTargets) + 1),
          std::uint32_t(halves_ ? i : 2 * i)};
}

std::optional<PhotonTracer::Branch> PhotonTracer::start(const Share& share, std::int64_t i,
                                                        PhotonCounts& counts) const {
  const Lamp& lamp = lamps_[share.light];
  const SampleStream stream = stream_of(share, i);
  const LightNumbers u = stream.light();
  ++counts.emitted;
  const auto e = lamp.aim->emit(share.part, lamp.shares, u.choice, u.position, u.direction);
  if (!e) return std::nullopt;
  Branch b;
  const double n = double(lamp.photons);
  b.flux = e->power * float(1 / (n * e->pdf_position * e->pdf_direction));
  b.photons = lamp.photons;
  b.half = std::uint8_t(halves_ ? i & 1 : 0);
  // The first eighth of a part, whole pairs of the two halves; two at least, as every part has.
  const std::int64_t few = options_.discs ? share.count : std::max<std::int64_t>(share.count / (2 * kFew) * 2, 2);
  if (i < few) b.coarse_scale = float(double(share.count) / double(few));
  b.beam.x = e->p, b.beam.w = e->w;
  // Cells of the light that one photon stands for, so large that `overlap` of them cover a point.
  const double beta = std::sqrt(4 * overlap_of(lamp.photons) * scale_ / kPiD);
  int column = 0;
  if (!e->delta_position) {
    const double size = beta / std::sqrt(n * e->pdf_position);
    for (const Vec3d& d : tangents_of(e->infinite ? e->w : Vec3d(e->n))) b.beam.dx[column++] = d * size;
  }
  if (!e->delta_direction) {
    const double size = std::min(beta / std::sqrt(n * e->pdf_direction), kMostSpread);
    for (const Vec3d& d : tangents_of(e->w)) {
      // Light from infinity turns about where it passes what it is aimed at, not about where it is taken to start.
      b.beam.dx[column] = d * (-size * e->pivot);
      b.beam.dw[column++] = d * size;
    }
  }
  if (options_.temporal) {
    b.emitter = {e->infinite, e->velocity, e->turn};
    b.beam.dw[Beam::kTime] = cross(e->turn, e->w);
    b.beam.dx[Beam::kTime] = e->velocity - b.beam.dw[Beam::kTime] * e->pivot;
  }
  b.from_infinity = e->infinite;
  b.ray_from = length_squared(e->n) > 0 ? context_.rays.offset_origin(Vec3f(e->p), e->n, Vec3f(e->w)) : Vec3f(e->p);
  counts.emitted_flux += double(luminance(b.flux));
  return b;
}

void PhotonTracer::store(const Branch& b, const SurfaceFrame& f, const SurfacePoint& point, std::vector<Photon>& out,
                         PhotonCounts& counts) const {
  Photon p;
  const Vec3d wi = -b.beam.w;
  const Vec3d n = dot(f.ng, wi) < 0 ? -f.ng : f.ng;
  const double least = least_radius(f.p), most = std::max(kMostRadius * diameter_, least);
  bool clamped = false;
  const bool grazing = dot(n, wi) < kGrazing;
  FootprintAxes axes = footprint_axes(std::span(b.beam.dx).first<Beam::kSpatial>(), n, least, most, &clamped);
  // What moves over the matter of the receiver, which carries it along.
  Vec3d slip = b.beam.dx[Beam::kTime] - f.dpdt;
  slip = slip - n * dot(n, slip);
  float rate = b.rate;
  if (grazing || !is_finite(axes.a) || !is_finite(axes.b) || !is_finite(slip)) {
    axes = footprint_axes({}, n, least, most);
    slip = {};
    rate = 0;
    clamped = true;
  }
  if (options_.discs) {
    axes = footprint_axes({}, n, disc_radius(), disc_radius());
    slip = {};
    rate = 0;
  }
  const double span = kernel_.end - kernel_.begin, way = length(slip) * span, limit = kMostSweep * diameter_;
  if (way > limit) slip *= limit / way, clamped = true;
  p.footprint = Footprint(Vec3f(f.p), axes, Vec3f(slip));
  p.thickness = 0.5f * std::max(length(axes.a), length(axes.b));
  p.flux = b.flux;
  p.rate = rate;
  p.coarse_scale = b.coarse_scale;
  p.n = Vec3f(n);
  p.wi = Vec3f(wi);
  p.instance = point.instance;
  p.events = b.events;
  p.half = b.half;
  if (!is_finite(p.flux) || !is_finite(p.footprint.center) || !is_finite(p.n)) return;
  out.push_back(p);
  ++counts.stored;
  counts.clamped += clamped;
}

namespace {

/// Changes of the normal of a lobe that is not the surface's own, as of a bump map: differences over the beam's width,
/// finer than which photons do not see.
Beam::Columns perturbed_normal_change(const RayScene& rays, const Vertex& v, const SurfaceFrame& f,
                                      const MatterChange& change, int frame_lobe, double t) {
  const Vec3f n = v.bsdf.frame(frame_lobe).n;
  double du = 0, dv = 0;
  for (int i = 0; i < Beam::kSpatial; ++i)
    du = std::max(du, std::abs(change.u[i])), dv = std::max(dv, std::abs(change.v[i]));
  const auto slope = [&](double step, bool along_v) -> Vec3d {
    if (!(step > 0)) return {};
    const float h = float(std::clamp(0.25 * step, 1e-4, 0.1));
    Vec3f normals[2];
    Bsdf bsdf;
    for (const int side : {0, 1}) {
      SurfacePoint point = v.hit.point;
      (along_v ? point.v : point.u) += side ? h : -h;
      ShadingPoint at = rays.shading_point(point, t, v.s.wo);
      at.bends = false;
      make_bsdf(v.material(), at, bsdf);
      if (frame_lobe >= bsdf.size()) return {};
      normals[side] = bsdf.frame(frame_lobe).n;
      if (dot(normals[side], n) < 0) normals[side] = -normals[side];
    }
    return (Vec3d(normals[1]) - Vec3d(normals[0])) * (0.5 / double(h));
  };
  const Vec3d dndu = slope(du, false), dndv = slope(dv, true);
  Beam::Columns r;
  for (int i = 0; i < Beam::kColumns; ++i) r[i] = dndu * change.u[i] + dndv * change.v[i];
  r[Beam::kTime] += f.dndt;
  return r;
}

/// A way on from a surface, by one of its specular lobes or by facets that are nearly so, with the flux that takes it.
struct Way {
  BsdfSample sample;
  Rgb flux;
};
using Ways = FixedStack<Way, Bsdf::kMaxLobes + 1>;

/// All ways of flux that arrives from wl: every delta, and one direction of all near-specular lobes together.
Ways specular_ways(const Vertex& v, const Vec3f& wl, const Rgb& flux, const VertexNumbers& u) {
  Ways ways;
  const float cos_l = std::max(std::abs(dot(v.s.ng, wl)), 1e-7f);
  const auto add = [&](const BsdfSample& s, const Rgb& f) {
    const Rgb onward = flux * f * (1 / cos_l);
    if (!is_black(onward) && is_finite(onward)) ways.push({s, onward});
  };
  for (int i = 0; i < v.bsdf.size(); ++i) {
    if (!v.bsdf.is_delta(i)) continue;
    if (const auto s = v.bsdf.sample_delta(i, wl))
      add(*s, s->sum() * delta_flux_factor(v.bsdf.frame(i).n, v.s.ng, wl, *s));
  }
  if (v.bsdf.has_near_specular()) {
    if (const auto s = v.bsdf.sample_near_specular(wl, u.lobe, u.direction))
      add(*s, v.bsdf.eval_near_specular(s->wi, wl).sum() * (std::abs(dot(v.s.ng, s->wi)) / s->pdf));
  }
  return ways;
}

/// What bending a beam told.
struct Bend {
  bool passes = true;    ///< false: it is reflected totally where it should be refracted
  double curvature = 0;  ///< largest change of the normal over the beam, radians
  int pair = 0;          ///< 0: by the first two columns, 1: by the others
};
/// Sends a beam that has arrived at a vertex on by a specular sample that does not pass straight through.
Bend bend(const RayScene& rays, const Vertex& v, const SurfaceFrame& f, const Vec3f& wl, const BsdfSample& s, double t,
          Beam& beam) {
  const MatterChange change = matter_change(f, beam);
  Beam::Columns turn = normal_change(f, change);
  Vec3d n(v.bsdf.frame(s.lobe).n), own = f.n;
  if (dot(n, own) < 0) {
    own = -own;
    for (Vec3d& d : turn) d = -d;
  }
  if (!s.delta) {
    const Vec3d wi(s.wi), wo(wl);
    Vec3d m = s.transmitted && s.eta == 1 ? n : normalize(s.transmitted ? -(wo + wi * double(s.eta)) : wi + wo);
    if (dot(m, n) < 0) m = -m;
    turn = turned(turn, n, m);
    n = m;
  } else if (dot(n, own) < 1 - 1e-7) {
    turn = perturbed_normal_change(rays, v, f, change, s.lobe, t);
  } else {
    n = own;
  }
  Bend r;
  for (int i = 0; i < Beam::kSpatial; ++i) {
    const double curvature = length(turn[i]);
    if (curvature > r.curvature) r.curvature = curvature, r.pair = i / 2;
  }
  if (!s.transmitted) {
    reflect(n, turn, beam);
  } else if (s.eta != 1) {
    r.passes = refract(n, turn, double(s.eta), beam);
  }
  if (!s.delta) beam.w = Vec3d(s.wi);
  beam.w = normalize(beam.w);
  // Beyond what a linear change describes: a beam that is bent so strongly does not spread farther.
  for (int i = 0; i < Beam::kSpatial; ++i) {
    const double spread = length(beam.dw[i]);
    if (spread > kMostSpread) beam.dw[i] *= kMostSpread / spread;
  }
  return r;
}

}  // namespace

void PhotonTracer::trace(std::int64_t index, std::vector<Photon>& out, PhotonCounts& counts,
                         std::uint64_t& ray_count) const {
  const auto share = std::prev(std::upper_bound(shares_.begin(), shares_.end(), index,
                                                [](std::int64_t i, const Share& s) { return i < s.first; }));
  const std::int64_t i = index - share->first;
  if (const auto first = start(*share, i, counts)) trace(*first, stream_of(*share, i), 0, out, counts, ray_count);
}

/// Gives what has little flux left its chance, and the footprint the width that goes with it. Returns whether it goes on;
/// `number` in [0,1).
bool PhotonTracer::thin_out(float number, Branch& b) const {
  if (b.relative < kLeastFlux) {
    const float q = b.relative / kLeastFlux;
    if (!(number < q)) return false;
    b.flux *= 1 / q;
    b.relative = kLeastFlux;
    b.thinning *= q;
  }
  // Weak light needs fewer footprints over a point for the same noise of the whole, but those that are left after
  // thinning out are fewer, and so wider.
  const double overlap = overlap_of(b.photons);
  const double covers = std::max(overlap * double(b.relative), std::min(kLeastOverlap, overlap));
  const double width = std::sqrt(covers / (overlap * double(b.thinning))), widening = width / b.width;
  b.width = width;
  for (int i = 0; i < Beam::kSpatial; ++i) b.beam.dx[i] *= widening, b.beam.dw[i] *= widening;
  return true;
}

/// Moves a photon to the surface that it meets: vertex `v`, with the surface `f` around it. Returns false if there is
/// none, or none that it could go on from.
bool PhotonTracer::arrive(const SampleStream& stream, Branch& b, Vertex& v, SurfaceFrame& f, PhotonCounts& counts,
                          std::uint64_t& ray_count) const {
  const double flux = double(luminance(b.flux));
  Ray ray{b.ray_from, Vec3f(b.beam.w), 0, kInfinity, instant_};
  int passed = 0;
  float pass_probability = 1;
  const EdgeEnd end = follow(context_, stream, std::uint32_t(b.depth), ray, nullptr, v, passed, pass_probability);
  ray_count += std::uint64_t(passed) + 1;
  if (end != EdgeEnd::kSurface) {
    counts.escaped_flux += flux;
    return false;
  }
  Hit hit = v.hit;
  hit.t = float(dot(Vec3d(v.s.p) - b.beam.x, b.beam.w));  // from the last surface, not from behind a mask
  PrimitiveHit at{hit.point.u, hit.point.v, hit.t};
  if (const auto crossing = context_.rays.refine(hit, b.beam.x, b.beam.w, instant_)) at = *crossing;
  f = context_.rays.surface(hit.point, at.u, at.v, instant_);
  if (!(std::abs(dot(f.ng, b.beam.w)) > kParallel) || !(at.distance > 0)) {
    counts.absorbed_flux += flux;
    return false;
  }
  if (v.material().has_absorption() && !(b.depth == 0 && b.from_infinity)) b.flux *= absorption(v, float(at.distance));
  counts.absorbed_flux += flux - double(luminance(b.flux));
  transfer(f, at.distance, b.beam);
  if (!options_.temporal) b.beam.dx[Beam::kTime] = b.beam.dw[Beam::kTime] = {};
  if (!b.bent) b.distance += at.distance;
  v.s.bends = false;
  v.make_bsdf();
  return true;
}

/// Traces a beam. One that is bent too strongly for what its derivatives tell is divided into four narrower ones, and so
/// are these.
void PhotonTracer::trace(const Branch& first, const SampleStream& stream, int level, std::vector<Photon>& out,
                         PhotonCounts& counts, std::uint64_t& ray_count) const {
  const std::size_t stored_before = out.size();
  const PhotonCounts counts_before = counts;
  Bend strongest{.curvature = kCurved};
  bool strong = false;
  const float initial = std::max(max_component(first.flux), 1e-38f);
  constexpr std::size_t kOpen = 64;
  thread_local std::array<std::vector<Branch>, kMostDivisions + 1> stacks;
  std::vector<Branch>& open = stacks[level];
  open.assign(1, first);
  Vertex v;
  SurfaceFrame f;
  SurfacePoint met;  // first
  for (std::uint64_t traced = 0; !open.empty(); ++traced) {
    Branch b = open.back();
    open.pop_back();
    if (!arrive(stream, b, v, f, counts, ray_count)) continue;
    if (traced == 0) met = v.hit.point;
    const Vec3f wl = v.s.wo;
    const Ways ways = specular_ways(v, wl, b.flux, stream.vertex(std::uint32_t(b.depth), Subpath::kLight));
    const bool stores = b.bent && v.bsdf.has_diffuse();
    if (stores) store(b, f, v.hit.point, out, counts);
    double left = double(luminance(b.flux));
    for (const Way& way : ways) left -= double(luminance(way.flux));
    (stores ? counts.stored_flux : counts.absorbed_flux) += left;

    for (int k = 0; k < ways.size(); ++k) {
      const BsdfSample& s = ways[k].sample;
      Branch next = b;
      next.flux = ways[k].flux;
      next.relative = max_component(next.flux) / initial;
      const double before = double(luminance(next.flux));
      const std::uint64_t key =
          (std::uint64_t(stream.hash()) + (b.salt << 32)) * 0x9e3779b97f4a7c15ull + traced * kOpen + std::uint64_t(k);
      const bool ends = b.events.full() || b.depth + 2 >= max_depth_ || open.size() == kOpen ||
                        !thin_out(to_unit_float(std::uint32_t(mix64(key))), next);
      counts.absorbed_flux += ends ? before : before - double(luminance(next.flux));
      if (ends) continue;

      PhotonEvents::Kind event = PhotonEvents::kPassage;
      if (!is_passage(s)) {
        event = s.transmitted ? PhotonEvents::kTransmission : PhotonEvents::kReflection;
        if (!next.bent && options_.temporal && options_.gauge == PhotonGauge::kMatter && moves_[v.hit.point.instance])
          next.rate = float(follow_matter(f, next.emitter, next.distance, next.beam));
        next.bent = true;
        const Bend bent = bend(context_.rays, v, f, wl, s, instant_, next.beam);
        if (!bent.passes || !is_finite(next.beam.w)) {
          counts.absorbed_flux += double(luminance(next.flux));
          continue;
        }
        if (bent.curvature > strongest.curvature && next.relative >= kLeastDivided && !options_.discs)
          strongest = bent, strong = true;
        if (!s.delta) {
          const double beta = std::sqrt(4 * overlap_of(b.photons) * scale_ / kPiD) * next.width;
          widen(std::min(beta / std::sqrt(double(b.photons) * double(s.pdf)), kMostSpread), next.beam);
        }
      }
      next.events.push(event);
      ++next.depth;
      next.ray_from = context_.rays.offset_origin(v.s.p, v.s.ng, Vec3f(next.beam.w));
      open.push_back(next);
    }
  }
  if (!strong) return;
  if (level == kMostDivisions) {
    ++counts.curved;
    return;
  }
  // A photon stands for light on what it meets. So its parts have all of its flux, even where some would pass that by: others
  // beside it, which do, are not divided.
  const int u = 2 * strongest.pair, w = u + 1;
  FixedStack<Branch, 4> parts;
  for (int k = 0; k < 4; ++k) {
    Branch part = first;
    Beam& beam = part.beam;
    const double a = k & 1 ? 0.25 : -0.25, c = k & 2 ? 0.25 : -0.25;
    const Vec3d aside = beam.dx[u] * a + beam.dx[w] * c;
    beam.x += aside;
    part.ray_from += Vec3f(aside);
    beam.w = normalize(beam.w + beam.dw[u] * a + beam.dw[w] * c);
    for (const int i : {u, w}) beam.dx[i] *= 0.5, beam.dw[i] *= 0.5;
    for (Vec3d& d : beam.dw) d = d - beam.w * dot(beam.w, d);
    part.salt = part.salt * 4 + std::uint64_t(k) + 1;
    Ray ray{part.ray_from, Vec3f(beam.w), 0, kInfinity, instant_};
    int passed = 0;
    float pass_probability = 1;
    const EdgeEnd end = follow(context_, stream, std::uint32_t(part.depth), ray, nullptr, v, passed, pass_probability);
    ray_count += std::uint64_t(passed) + 1;
    if (end == EdgeEnd::kSurface && v.hit.point.instance == met.instance && v.hit.point.shape == met.shape)
      parts.push(part);
  }
  if (parts.size() == 0) {
    ++counts.curved;
    return;
  }
  out.resize(stored_before);
  counts = counts_before;
  for (int k = 0; k < parts.size(); ++k) {
    parts[k].flux *= 1 / float(parts.size());
    trace(parts[k], stream, level + 1, out, counts, ray_count);
  }
}

}  // namespace tempera
