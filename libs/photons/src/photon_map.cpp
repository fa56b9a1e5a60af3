// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/photon_map.h"

#include <algorithm>

namespace tempera {

namespace {

/// How far apart the normals of a photon and of a surface may be.
constexpr float kLeastNormalCosine = 0.7f;

/// How far from its plane a photon counts: on curved surfaces footprints stand off.
float thickness_of(const Footprint& f) {
  const FootprintAxes h = f.half_axes();
  return std::max(length(h.a), length(h.b));
}

LightPathClassifier::State next(const LightPathClassifier& c, LightPathClassifier::State s, PhotonEvents::Kind k) {
  switch (k) {
    case PhotonEvents::kReflection:
      return c.next(s, Event::kReflection);
    case PhotonEvents::kTransmission:
      return c.next(s, Event::kTransmission);
    default:
      return c.next_passage(s);
  }
}

}  // namespace

PhotonMap::PhotonMap(const PhotonTracer& tracer, std::vector<Photon> photons, const LightPathClassifier& classifier,
                     const RayScene& rays, bool always_instant)
    : photons_(std::move(photons)),
      kernel_(tracer.kernel()),
      instant_(tracer.instant()),
      always_instant_(always_instant),
      rays_(rays) {
  std::stable_sort(photons_.begin(), photons_.end(), [](const Photon& a, const Photon& b) { return a.half < b.half; });
  std::map<std::uint64_t, std::uint32_t> suffixes;
  for (Photon& p : photons_) {
    const auto [it, added] = suffixes.try_emplace(p.events.code(), std::uint32_t(ends_.size()));
    p.suffix = it->second;
    if (!added) continue;
    auto& ends = ends_.emplace_back(classifier.state_count());
    for (std::size_t s = 0; s < ends.size(); ++s) {
      auto state = LightPathClassifier::State(s);
      p.events.visit([&](PhotonEvents::Kind k) { state = next(classifier, state, k); });
      ends[s] = state;
    }
  }
  std::vector<Bounds3f> boxes;
  auto from = photons_.begin();
  for (int half = 0; half < 2; ++half) {
    const auto to = std::find_if(from, photons_.end(), [&](const Photon& p) { return p.half != half; });
    boxes.clear();
    for (auto p = from; p != to; ++p)
      boxes.push_back(footprint_bounds(p->footprint, kernel_, p->n.unpack(), thickness_of(p->footprint)));
    first_of_half_.push_back(std::uint32_t(from - photons_.begin()));
    index_.emplace_back(boxes);
    from = to;
  }
  const Scene& scene = rays.scene();
  moves_.resize(scene.instances.size());
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    for (const int shape : scene.groups[scene.instances[i].group])
      moves_[i] |= char(rays.moves(i, std::uint32_t(shape), tracer.exposure()));
  }
}

std::uint64_t PhotonMap::memory() const {
  return photons_.capacity() * sizeof(Photon) + photons_.size() * sizeof(Bounds3f);
}

void PhotonMap::add(const Photon& p, const Vec3f& position, const Vec3f& ng, bool moving, std::uint32_t instance,
                    double t, float scale, std::vector<GatheredLight::Arrival>& out) const {
  if ((moving || p.moving) && p.instance != instance) return;
  const Vec3f n = p.n.unpack(), offset = position - p.footprint.center;
  if (std::abs(dot(n, offset)) > thickness_of(p.footprint) || std::abs(dot(n, ng)) < kLeastNormalCosine) return;
  const float density = always_instant_ || moving
                            ? instant_density(p.footprint, kernel_.kernel, offset,
                                              kernel_.begin < kernel_.end ? float(t - instant_) : 0.0f, p.rate)
                            : swept_density(p.footprint, kernel_, offset, p.rate);
  if (!(density > 0)) return;
  out.push_back({p.wi.unpack(), p.flux * (density * scale), p.events.size() + 1, ends_[p.suffix]});
}

void PhotonMap::gather(const Vertex& at, double t, int half, std::vector<GatheredLight::Arrival>& out) const {
  out.clear();
  const std::uint32_t instance = at.hit.point.instance;
  const bool moving = moves_[instance];
  Vec3f position = at.s.p, ng = at.s.ng;
  // Matter that moves is looked up where it was when the photons met it.
  if (moving) position = rays_.position(at.hit.point, instant_, &ng);
  thread_local std::vector<std::uint32_t> found;
  for (int h = 0; h < 2; ++h) {
    if (half >= 0 && h != half) continue;
    found.clear();
    index_[h].visit(position, [&](std::size_t i) { found.push_back(first_of_half_[h] + std::uint32_t(i)); });
    std::sort(found.begin(), found.end());  // sums have one order
    for (const std::uint32_t i : found)
      add(photons_[i], position, ng, moving, instance, t, half >= 0 ? 2.0f : 1.0f, out);
  }
}

std::span<const GatheredLight::Arrival> PhotonLight::arriving(const Vertex& at, double time, int sample) const {
  thread_local std::vector<Arrival> result;
  std::size_t piece = 0;
  while (piece + 1 < frame_.pieces.size() && time >= frame_.pieces[piece + 1].rays.rays().begin) ++piece;
  maps_[piece]->gather(at, time, frame_.settings.spp > 1 ? sample & 1 : -1, result);
  return result;
}

std::vector<ExposurePiece> exposure_pieces_of(const FrameContext& frame) {
  const TimeSpan exposure = frame.settings.clock.exposure(frame.frame);
  if (frame.pieces.empty()) return {{&frame, exposure}};
  std::vector<ExposurePiece> result;
  for (const FrameContext& piece : frame.pieces) {
    const TimeSpan rays = piece.rays.rays();
    const double begin = std::max(rays.begin, exposure.begin), end = std::min(rays.end, exposure.end);
    result.push_back({&piece, {begin, std::max(begin, end)}});
  }
  return result;
}

bool needs_instants(const FrameContext& frame, TimeSpan exposure) {
  const Shutter& shutter = frame.settings.clock.shutter;
  if (shutter.rolling != 0 || shutter.shape != ShutterShape::kBox) return true;
  const float w = float(frame.settings.width), h = float(frame.settings.height);
  for (const Vec2f& pixel : {Vec2f{0, 0}, Vec2f{w, 0}, Vec2f{0, h}, Vec2f{w, h}}) {
    const Vec2f lens{0.7f, 0.3f};
    const CameraRay a = frame.camera.ray(pixel, lens, exposure.begin);
    for (int i = 1; i <= 8; ++i) {
      const CameraRay b = frame.camera.ray(pixel, lens, exposure.begin + exposure.length() * i / 8);
      if (!(a.o == b.o && a.d == b.d)) return true;
    }
  }
  return false;
}

}  // namespace tempera
