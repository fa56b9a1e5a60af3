// SPDX-License-Identifier: Apache-2.0
#include "motion.h"

#include <fmt/format.h>

#include <cmath>
#include <initializer_list>

#include "tempera/core/log.h"
#include "tempera/scene/deform.h"

namespace tempera {

MotionPieces::MotionPieces(MotionGrid grid, TimeSpan span, std::vector<double> jumps, TimeSpan whole)
    : grid_(grid), whole_span_(whole) {
  span = {std::min(span.begin, whole.begin), std::max(span.end, whole.end)};
  const double middle = 0.5 * (whole.begin + whole.end);
  std::sort(jumps.begin(), jumps.end());
  std::vector<double> cuts{span.begin};
  for (const double t : jumps) {
    if (t > cuts.back() && t < span.end) cuts.push_back(t);
  }
  constexpr std::size_t kMostPieces = 4096;  // of more, which no motion needs, every n-th
  if (const std::size_t n = (cuts.size() + kMostPieces - 1) / kMostPieces; n > 1) {
    for (std::size_t i = 0; i * n < cuts.size(); ++i) cuts[i] = cuts[i * n];
    cuts.resize((cuts.size() + n - 1) / n);
  }
  for (std::size_t i = 0; i < cuts.size(); ++i) {
    TimeSpan piece{cuts[i], i + 1 < cuts.size() ? cuts[i + 1] : span.end};
    const bool holds_whole = middle >= piece.begin && (middle < piece.end || i + 1 == cuts.size());
    const double representative = holds_whole ? middle : 0.5 * (piece.begin + piece.end);
    if (holds_whole) {
      whole_ = i;
      piece = {std::min(piece.begin, whole.begin), std::max(piece.end, whole.end)};
    }
    Piece p{cuts[i], grid.first(piece), 0, knots_.size()};
    p.last = std::max(grid.last(piece), p.first);
    for (std::int64_t k = p.first; k <= p.last; ++k) knots_.push_back({grid.time(k), representative});
    pieces_.push_back(p);
  }
}

std::vector<MotionPieces::Stretch> MotionPieces::stretches(TimeSpan span) const {
  std::vector<Stretch> all;
  for (std::size_t i = 0; i < pieces_.size(); ++i) {
    const Piece& p = pieces_[i];
    const bool is_last = i + 1 == pieces_.size();
    TimeSpan held{i == 0 ? span.begin : p.begin, is_last ? span.end : pieces_[i + 1].begin};
    if (i == whole_) held = {std::min(held.begin, whole_span_.begin), std::max(held.end, whole_span_.end)};
    const TimeSpan shared{std::max(span.begin, held.begin), std::min(span.end, held.end)};
    if (shared.begin > shared.end || (shared.begin == held.end && !is_last && i != whole_)) continue;
    const std::int64_t first = std::clamp(grid_.first(shared), p.first, p.last);
    const std::int64_t last = std::clamp(grid_.last(shared), first, p.last);
    all.push_back({p.index(first), p.index(last), shared});
  }
  return all;
}

std::vector<double> exposure_jumps(const Scene& scene, TimeSpan exposure) {
  constexpr std::size_t kMostJumps = 64;
  std::vector<double> all;
  instance_jumps(scene, exposure, all);
  for (const PunctualLight& light : scene.lights) scene.jumps(light.node, exposure, all);
  std::sort(all.begin(), all.end());
  std::vector<double> jumps;
  double last = exposure.begin;
  for (const double t : all) {
    const double rounding = 2 * key_tolerance(t);
    if (t > last + rounding && t < exposure.end - rounding) jumps.push_back(last = t);
  }
  if (jumps.size() <= kMostJumps) return jumps;
  log_warning(fmt::format("{} jumps within the exposure from {} s to {} s are taken for {}", jumps.size(),
                          exposure.begin, exposure.end, kMostJumps));
  std::vector<double> some;
  for (std::size_t i = 0; i < kMostJumps; ++i) some.push_back(jumps[i * jumps.size() / kMostJumps]);
  return some;
}

std::vector<TimeSpan> exposure_pieces(const Scene& scene, TimeSpan exposure, double motion_step) {
  std::vector<double> cuts = exposure_jumps(scene, exposure);
  cuts.push_back(exposure.end);
  const MotionGrid grid{motion_step};
  std::vector<TimeSpan> pieces;
  double begin = exposure.begin;
  for (const double end : cuts) {
    // At knots, so that no piece has a part of a segment more than it needs.
    for (std::int64_t k; grid.last({begin, end}) - (k = grid.first({begin, end})) > kMaxSegments;) {
      pieces.push_back({begin, grid.time(k + kMaxSegments)});
      begin = pieces.back().end;
    }
    pieces.push_back({begin, end});
    begin = end;
  }
  return pieces;
}

AffineKnot decompose(const Affine3d& m, const AffineKnot* near) {
  constexpr double kTiny = 1e-9;
  const double largest = std::max({length(m.x), length(m.y), length(m.z), 1e-30});
  const Affine3d open = near ? Affine3d(rotation(near->q)) : Affine3d{};
  const auto across = [&](const Vec3d& v, const Vec3d& q) { return v - q * dot(q, v); };
  // What the map leaves open is taken from `near`, as far as it is perpendicular to what the map says.
  const auto unit_or = [&](const Vec3d& v, std::initializer_list<Vec3d> open_axes) {
    if (length(v) > kTiny * largest) return normalize(v);
    for (const Vec3d& a : open_axes) {
      if (length(a) > 0.1) return normalize(a);
    }
    return Vec3d(Basis(Vec3f(normalize(m.z))).s);
  };
  Vec3d q0 = m.x, q1 = m.y;
  const bool open_x = !(length(m.x) > kTiny * largest);
  if (open_x) {  // perpendicular to the other two, so that a flattened thing keeps its plane
    const Vec3d n = cross(m.y, m.z), rest = length(m.y) > length(m.z) ? m.y : m.z;
    const Vec3d r = length(rest) > kTiny * largest ? normalize(rest) : Vec3d{};
    q0 = length(n) > kTiny * largest * largest
             ? normalize(n)
             : unit_or(Vec3d{}, {across(open.x, r), across(open.y, r), across(open.z, r)});
    if (dot(q0, open.x) < 0) q0 = -q0;
  } else {
    q0 = normalize(m.x);
  }
  q1 = across(m.y, q0);
  if (!(length(q1) > kTiny * largest)) {
    const Vec3d n = cross(across(m.z, q0), q0);
    q1 = length(n) > kTiny * largest ? normalize(n) : unit_or(Vec3d{}, {across(open.y, q0), across(open.z, q0)});
    if (dot(q1, open.y) < 0) q1 = -q1;
  } else {
    q1 = normalize(q1);
  }
  Vec3d q2 = cross(q0, q1);
  if (near) {
    // Scales may be negative: flipping two axes is a half turn about the third.
    const Vec3d scale{dot(q0, m.x), dot(q1, m.y), dot(q2, m.z)};
    Vec3d best{1, 1, 1};
    int fewest = 4;
    double closest = -2;
    for (const Vec3d& turn : {Vec3d{1, 1, 1}, Vec3d{1, -1, -1}, Vec3d{-1, 1, -1}, Vec3d{-1, -1, 1}}) {
      int flips = 0;  // of scales that are not zero
      for (int i = 0; i < 3; ++i) {
        const double s = scale[i] * turn[i], before = near->scale[i];
        flips += s * before < 0 && std::abs(s) > kTiny * largest;
      }
      // The trace of the rotation from `near`: 1 + 2 cos(angle).
      const double trace = turn.x * dot(q0, open.x) + turn.y * dot(q1, open.y) + turn.z * dot(q2, open.z);
      constexpr double kNearlyHalf = -0.73, kSlightly = 2.73;  // 150 and 30 degrees
      const bool mirrored = flips == 1 || flips == 3 || fewest == 1 || fewest == 3;
      const bool better = flips == fewest || mirrored ? trace > closest + 1e-9
                          : flips < fewest            ? !(closest > kSlightly && trace < kNearlyHalf)
                                                      : trace > kSlightly && closest < kNearlyHalf;
      if (better) best = turn, fewest = flips, closest = trace;
    }
    q0 = q0 * best.x, q1 = q1 * best.y, q2 = q2 * best.z;
  }
  AffineKnot k;
  const Quatd q = quaternion(Affine3d{q0, q1, q2});
  k.q = {float(q.w), float(q.x), float(q.y), float(q.z)};
  if (near && dot(k.q, near->q) < 0) k.q = -k.q;  // in one hemisphere: slerp then takes the short way
  k.scale = Vec3f(Vec3d{dot(q0, m.x), dot(q1, m.y), dot(q2, m.z)});
  k.skew = Vec3f(Vec3d{dot(q0, m.y), dot(q0, m.z), dot(q1, m.z)});
  k.translation = Vec3f(m.translation);
  return k;
}

std::vector<AffineKnot> decompose(std::span<const Affine3d> motion) {
  std::vector<AffineKnot> knots(motion.size());
  // From the map that is furthest from singular to both ends: those that leave a rotation open take their neighbour's.
  const auto regularity = [](const Affine3d& m) {
    const double l = std::max({length(m.x), length(m.y), length(m.z)});
    return l > 0 ? std::abs(m.determinant()) / (l * l * l) : 0;
  };
  std::size_t start = 0;
  for (std::size_t i = 0; i < motion.size(); ++i) {
    if (regularity(motion[i]) > 1e-3) {
      start = i;
      break;
    }
    if (regularity(motion[i]) > regularity(motion[start])) start = i;
  }
  for (std::size_t i = start; i < motion.size(); ++i) {
    knots[i] = i == start ? decompose(motion[i]) : decompose(motion[i], &knots[i - 1]);
  }
  for (std::size_t i = start; i-- > 0;) knots[i] = decompose(motion[i], &knots[i + 1]);
  return knots;
}

namespace {

float largest_of(const Vec3f& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }
float smallest_of(const Vec3f& v) { return std::min({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }

}  // namespace

bool is_invertible(std::span<const AffineKnot> knots) {
  constexpr float kFlat = 1e-5f, kLeast = 1e-8f, kMost = 1e9f;
  for (const AffineKnot& k : knots) {
    const float least = smallest_of(k.scale), most = std::max(largest_of(k.scale), largest_of(k.skew));
    if (!is_finite(k.translation)) return false;
    if (!(least > kFlat * most && least > kLeast && most < kMost && largest_of(k.translation) < 1e15f)) return false;
    for (int i = 0; i < 3; ++i) {
      if (std::signbit(k.scale[i]) != std::signbit(knots[0].scale[i])) return false;
    }
  }
  return true;
}

bool vanishes(std::span<const AffineKnot> knots) {
  for (const AffineKnot& k : knots) {
    const Affine3f m = compose(k);
    const Vec3d x(m.x), y(m.y), z(m.z);
    const double largest = std::max({length(x), length(y), length(z)});
    const double area = std::max({length(cross(x, y)), length(cross(y, z)), length(cross(z, x))});
    if (largest > 1e-20 && area > 1e-9 * largest * largest) return false;
  }
  return true;
}

Affine3d make_invertible(const Affine3d& m) {
  AffineKnot k = decompose(m);
  const float largest = std::max({largest_of(k.scale), largest_of(k.skew), 1e-20f});
  bool changed = false;
  for (int i = 0; i < 3; ++i) {
    if (std::abs(k.scale[i]) >= 1e-6f * largest) continue;
    k.scale[i] = std::copysign(1e-6f * largest, k.scale[i]);
    changed = true;
  }
  return changed ? Affine3d(compose(k)) : m;
}

template <class T>
static Affine3<T> upper(const Vec3<T>& scale, const Vec3<T>& skew) {
  return {{scale.x, 0, 0}, {skew.x, scale.y, 0}, {skew.y, skew.z, scale.z}};
}

Affine3f upper(const AffineKnot& k) { return upper(k.scale, k.skew); }

Affine3f compose(const AffineKnot& k) {
  Affine3f m = rotation(k.q) * upper(k.scale, k.skew);
  m.translation = k.translation;
  return m;
}

/// Never inlined: the compiler would contract its products and sums in another way, and pictures change their bits.
[[gnu::noinline]] static Quatf turn_between(const Quatf& a, const Quatf& b, float s) { return slerp(a, b, s); }

Affine3f interpolate(const AffineKnot& a, const AffineKnot& b, float s) {
  return compose({turn_between(a.q, b.q, s), lerp(a.scale, b.scale, s), lerp(a.skew, b.skew, s),
                  lerp(a.translation, b.translation, s)});
}

MovingAffine interpolate_moving(const AffineKnot& a, const AffineKnot& b, double s) {
  const auto in_double = [](const Quatf& q) { return normalize(Quatd{q.w, q.x, q.y, q.z}); };
  const Quatd from = in_double(a.q);
  Quatd to = in_double(b.q);
  if (dot(from, to) < 0) to = -to;
  Quatd q, dq;  // slerp of core/vec.h and its derivative
  if (const double c = dot(from, to); c > 0.9995) {
    const Quatd sum = from * (1 - s) + to * s, change = to - from;
    const double scale = 1 / std::sqrt(dot(sum, sum));
    q = sum * scale;
    dq = (change - q * dot(q, change)) * scale;
  } else {
    const double angle = std::acos(c), inv = 1 / std::sin(angle);
    q = (from * std::sin((1 - s) * angle) + to * std::sin(s * angle)) * inv;
    dq = (to * std::cos(s * angle) - from * std::cos((1 - s) * angle)) * (angle * inv);
  }
  const Quatd turn = dq * Quatd{q.w, -q.x, -q.y, -q.z};  // half the angular velocity w: dR/ds = [w]x R
  const Vec3d w = Vec3d{turn.x, turn.y, turn.z} * 2.0;
  const Affine3d r = rotation(q), dr{cross(w, r.x), cross(w, r.y), cross(w, r.z)};
  const Vec3d scale(a.scale), skew(a.skew), translation(a.translation);
  const Vec3d dscale = Vec3d(b.scale) - scale, dskew = Vec3d(b.skew) - skew;
  const Vec3d dtranslation = Vec3d(b.translation) - translation;
  const Affine3d u = upper(scale + dscale * s, skew + dskew * s), du = upper(dscale, dskew);
  const Affine3d turned = dr * u, stretched = r * du;
  MovingAffine m{r * u, {turned.x + stretched.x, turned.y + stretched.y, turned.z + stretched.z, dtranslation}};
  m.map.translation = translation + dtranslation * s;
  return m;
}

}  // namespace tempera
