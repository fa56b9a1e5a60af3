// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/photon_map.h"

#include <algorithm>
#include <array>
#include <map>
#include <tuple>

#include "tempera/core/random.h"

namespace tempera {

namespace {

/// How far apart the normals of a photon and of a surface may be.
constexpr float kLeastNormalCosine = 0.7f;

/// Place of a point on a curve that fills a box: 21 bits of each coordinate, interleaved.
std::uint64_t morton(const Vec3f& p, const Bounds3f& box) {
  const float size = std::max({box.hi.x - box.lo.x, box.hi.y - box.lo.y, box.hi.z - box.lo.z, 1e-30f});
  std::uint64_t code = 0;
  for (int a = 0; a < 3; ++a) {
    auto x = std::uint64_t(std::clamp((p[a] - box.lo[a]) / size, 0.0f, 1.0f) * 0x1fffff);
    x = (x | x << 32) & 0x1f00000000ffffull;
    x = (x | x << 16) & 0x1f0000ff0000ffull;
    x = (x | x << 8) & 0x100f00f00f00f00full;
    x = (x | x << 4) & 0x10c30c30c30c30c3ull;
    x = (x | x << 2) & 0x1249249249249249ull;
    code |= x << a;
  }
  return code;
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

/// Photons from nearly the same direction arrive as one, so that the surface is asked once for all of them.
class Arrivals {
 public:
  using Ends = std::vector<LightPathClassifier::State>;
  explicit Arrivals(std::vector<GatheredLight::Arrival>& out) : out_(out) {}
  void add(const Photon& p, const Rgb& irradiance, const Ends& ends) {
    const std::uint64_t key = direction_cell(p.wi) | std::uint64_t(p.suffix) << 32 | std::uint64_t(1) << 63;
    const std::size_t first = mix64(key) % kGroups;
    for (std::size_t k = 0; k < 4; ++k) {
      Group& g = groups_[(first + k) % kGroups];
      if (g.key == key) {
        GatheredLight::Arrival& a = out_[g.arrival];
        a.wi += p.wi * luminance(irradiance);
        a.irradiance += irradiance;
        return;
      }
      if (g.key != 0) continue;
      g = {key, out_.size()};
      break;
    }
    out_.push_back({p.wi * luminance(irradiance), irradiance, ends});
  }
  void finish() {
    for (GatheredLight::Arrival& a : out_) a.wi = normalize(a.wi);
  }

 private:
  static constexpr std::size_t kGroups = 64;
  struct Group {
    std::uint64_t key = 0;
    std::size_t arrival = 0;
  };
  std::array<Group, kGroups> groups_;
  std::vector<GatheredLight::Arrival>& out_;
};

}  // namespace

PhotonMap::Set PhotonMap::make_set(std::vector<Photon> photons) const {
  // Neighbours stand together: what a point needs is then found in few places of memory.
  Bounds3f around;
  for (const Photon& p : photons) around.extend(p.footprint.center);
  struct Place {
    std::uint64_t code;
    std::uint32_t index;
  };
  std::vector<Place> order(photons.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    const std::uint64_t place = morton(photons[i].footprint.center, around);
    order[i] = {std::uint64_t(photons[i].half) << 63 | place, std::uint32_t(i)};
  }
  // A map made of the photons of another map has them in the same order.
  std::sort(order.begin(), order.end(), [&](const Place& a, const Place& b) {
    const Vec3f &p = photons[a.index].footprint.center, &q = photons[b.index].footprint.center;
    return std::tie(a.code, p.x, p.y, p.z, a.index) < std::tie(b.code, q.x, q.y, q.z, b.index);
  });
  Set set;
  set.photons.reserve(photons.size());
  for (const Place& o : order) set.photons.push_back(photons[o.index]);
  std::vector<Bounds3f> boxes;
  std::vector<Vec3f> points;
  auto from = set.photons.begin();
  for (std::size_t half = 0; half < 2; ++half) {
    const auto to = std::find_if(from, set.photons.end(), [&](const Photon& p) { return p.half != half; });
    set.first_of_half[half] = std::uint32_t(from - set.photons.begin());
    if (nearest_ > 0) {
      points.clear();
      for (auto p = from; p != to; ++p) points.push_back(p->footprint.center);
      set.points.emplace_back(points);
    } else {
      boxes.clear();
      for (auto p = from; p != to; ++p) boxes.push_back(footprint_bounds(p->footprint, kernel_, p->n, p->thickness));
      set.index.emplace_back(boxes);
    }
    from = to;
  }
  return set;
}

PhotonMap::PhotonMap(const PhotonTracer& tracer, std::vector<Photon> photons, const LightPathClassifier& classifier,
                     const RayScene& rays, bool always_instant)
    : kernel_(tracer.kernel()),
      nearest_(tracer.nearest()),
      radius_(float(tracer.disc_radius())),
      instant_(tracer.instant()),
      always_instant_(always_instant),
      halves_(tracer.halves()),
      moves_(tracer.moves()),
      lights_(tracer.lights().begin(), tracer.lights().end()),
      rays_(rays) {
  // Few of the many sequences of events are told apart by the classifier. Numbers of these do not depend on the order of
  // photons.
  std::map<std::uint64_t, std::vector<LightPathClassifier::State>> by_code;
  for (const Photon& p : photons) {
    const auto [it, added] = by_code.try_emplace(p.events.code());
    if (!added) continue;
    it->second.resize(classifier.state_count());
    for (std::size_t s = 0; s < it->second.size(); ++s) {
      auto state = LightPathClassifier::State(s);
      p.events.visit([&](PhotonEvents::Kind k) { state = next(classifier, state, k); });
      it->second[s] = state;
    }
  }
  for (const auto& [code, ends] : by_code) ends_.push_back(ends);
  std::sort(ends_.begin(), ends_.end());
  ends_.erase(std::unique(ends_.begin(), ends_.end()), ends_.end());
  std::map<std::uint64_t, std::uint32_t> suffixes;
  for (const auto& [code, ends] : by_code)
    suffixes[code] = std::uint32_t(std::lower_bound(ends_.begin(), ends_.end(), ends) - ends_.begin());
  for (Photon& p : photons) {
    p.suffix = suffixes[p.events.code()];
    p.edges = std::uint8_t(p.events.size() + 1);
  }
  if (nearest_ > 0) {
    sets_[0] = make_set(std::move(photons));
    return;
  }
  std::vector<Photon> few;
  for (const Photon& p : photons) {
    if (!(p.coarse_scale > 0)) continue;
    few.push_back(p);
    few.back().flux *= p.coarse_scale;
    few.back().footprint.widen(std::sqrt(2.0f));
    few.back().thickness *= std::sqrt(2.0f);
  }
  sets_ = {make_set(std::move(photons)), make_set(std::move(few))};
}

std::uint64_t PhotonMap::memory() const {
  std::uint64_t bytes = 0;
  for (const Set& set : sets_) {
    bytes += set.photons.capacity() * sizeof(Photon);
    for (const BoxIndex& i : set.index) bytes += i.memory();
    for (const PointIndex& i : set.points) bytes += i.memory();
  }
  return bytes;
}

/// Where a map is asked.
struct PhotonMap::Place {
  Vec3f position, ng;
  std::uint32_t instance;
  bool moving;
};

PhotonMap::Place PhotonMap::place_of(const Vertex& at) const {
  const std::uint32_t instance = at.hit.point.instance;
  Place place{at.s.p, at.s.ng, instance, bool(moves_[instance])};
  // Matter that moves is looked up where it was when the photons met it.
  if (place.moving) place.position = rays_.position(at.hit.point, instant_, &place.ng);
  return place;
}

/// Whether a photon lies on the surface that is asked about, and its path is short enough.
bool PhotonMap::counts(const Photon& p, const Place& at, int most_edges) const {
  if ((p.instance != at.instance && (at.moving || moves_[p.instance])) || p.edges > most_edges) return false;
  return std::abs(dot(p.n, at.position - p.footprint.center)) <= p.thickness &&
         std::abs(dot(p.n, at.ng)) >= kLeastNormalCosine;
}

void PhotonMap::gather(const Vertex& at, double t, int half, bool coarse, int most_edges,
                       std::vector<GatheredLight::Arrival>& out) const {
  if (nearest_ > 0) {
    thread_local std::vector<float> room;
    NearestDistance found(std::size_t(nearest_), sqr(radius_), room);
    find_nearest(at, half, most_edges, found);
    gather_disc(at, half, most_edges, found.reach(), out);
    return;
  }
  out.clear();
  const Set& set = sets_[coarse];
  const Place place = place_of(at);
  const bool instant = always_instant_ || place.moving;
  const float sigma = kernel_.begin < kernel_.end ? float(t - instant_) : 0.0f;
  Arrivals arrivals(out);
  const bool one = halves_ && half >= 0;
  for (int h = 0; h < (halves_ ? 2 : 1); ++h) {
    if (one && h != half) continue;
    set.index[h].visit(place.position, [&](std::size_t i) {
      const Photon& p = set.photons[set.first_of_half[h] + i];
      if (!counts(p, place, most_edges)) return;
      const Vec3f offset = place.position - p.footprint.center;
      float density = instant ? instant_density(p.footprint, kernel_.kernel, offset, sigma, p.rate)
                              : swept_density(p.footprint, kernel_, offset, p.rate);
      if (!(density > 0)) return;
      if (one) density *= 2;
      arrivals.add(p, p.flux * density, ends_[p.suffix]);
    });
  }
  arrivals.finish();
}

void PhotonMap::find_nearest(const Vertex& at, int half, int most_edges, NearestDistance& found) const {
  const Set& set = sets_[0];
  const Place place = place_of(at);
  for (int h = 0; h < (halves_ ? 2 : 1); ++h) {
    if (halves_ && half >= 0 && h != half) continue;
    set.points[h].visit(place.position, found.reach(), [&](std::size_t i, float d2) {
      if (counts(set.photons[set.first_of_half[h] + i], place, most_edges)) found.add(d2);
      return found.reach();
    });
  }
}

void PhotonMap::gather_disc(const Vertex& at, int half, int most_edges, float radius_squared,
                            std::vector<GatheredLight::Arrival>& out) const {
  out.clear();
  if (!(radius_squared > 0)) return;
  const Set& set = sets_[0];
  const Place place = place_of(at);
  const bool one = halves_ && half >= 0;
  const float to_filter = sqr(support(kernel_.kernel)) / radius_squared;
  const float scale = (one ? 2.0f : 1.0f) * to_filter * kInvPi;
  Arrivals arrivals(out);
  for (int h = 0; h < (halves_ ? 2 : 1); ++h) {
    if (one && h != half) continue;
    set.points[h].visit(place.position, radius_squared, [&](std::size_t i, float d2) {
      const Photon& p = set.photons[set.first_of_half[h] + i];
      // The farthest one says how large the disc is. With its light, too, there would be too much on average.
      if (d2 < radius_squared && counts(p, place, most_edges))
        arrivals.add(p, p.flux * (spatial_kernel(kernel_.kernel, d2 * to_filter) * scale), ends_[p.suffix]);
      return radius_squared;
    });
  }
  arrivals.finish();
}

void PhotonLight::add(std::size_t piece, PhotonMap map) {
  maps_.resize(piece + 1);
  lights_.resize(piece + 1);
  // A light that is dark at one of several instants has no photons there, and nothing is missing.
  std::vector<char>& lights = lights_[piece];
  lights.resize(map.lights().size());
  for (std::size_t i = 0; i < lights.size(); ++i) lights[i] |= map.lights()[i];
  maps_[piece].push_back(std::make_unique<PhotonMap>(std::move(map)));
}

std::uint64_t PhotonLight::memory() const {
  std::uint64_t bytes = 0;
  for (const auto& piece : maps_) {
    for (const auto& map : piece) bytes += map->memory();
  }
  return bytes;
}

std::span<const GatheredLight::Arrival> PhotonLight::arriving(const Vertex& at, double time, int sample, bool coarse,
                                                              int most_edges) const {
  thread_local std::vector<Arrival> result;
  const auto& maps = maps_[frame_.piece_at(time)];
  const int half = frame_.settings.spp > 1 ? sample & 1 : -1;
  if (maps.size() == 1) {
    maps[0]->gather(at, time, half, coarse, most_edges, result);
    return result;
  }
  thread_local std::vector<Arrival> one;
  result.clear();
  // The nearest photons are those of all instants together.
  const bool nearest = !maps.empty() && maps[0]->nearest() > 0;
  float reach = 0;
  if (nearest) {
    thread_local std::vector<float> room;
    NearestDistance found(std::size_t(maps[0]->nearest()), sqr(maps[0]->largest_radius()), room);
    for (const auto& map : maps) map->find_nearest(at, half, most_edges, found);
    reach = found.reach();
  }
  for (const auto& map : maps) {
    if (nearest)
      map->gather_disc(at, half, most_edges, reach, one);
    else
      map->gather(at, time, half, coarse, most_edges, one);
    for (Arrival& a : one) a.irradiance *= 1 / float(maps.size());
    result.insert(result.end(), one.begin(), one.end());
  }
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
