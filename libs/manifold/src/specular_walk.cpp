// SPDX-License-Identifier: Apache-2.0
#include "tempera/manifold/specular_walk.h"

#include <algorithm>
#include <cmath>

namespace tempera {

namespace {

constexpr double kGrazing = 1e-4, kFlat = 1e-6;  // cosines

/// What is missing from the end of `chain` to `last`, and by which change of the parameters that would be made up for.
struct Gap {
  Vec3d r;
  Vec2d q;
};
Gap gap_of(const SpecularChain& chain, const ChainEnd& last) {
  const Vec3d r = last.p - chain.last.p;
  const Vec3d &u = chain.last.dpdu, &v = chain.last.dpdv;
  const double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), det = uu * vv - uv * uv;
  if (!(det > 0)) return {r, {}};
  const double ru = dot(r, u), rv = dot(r, v);
  return {r, {(vv * ru - uv * rv) / det, (uu * rv - uv * ru) / det}};
}

}  // namespace

std::vector<SpecularVertex> bends_of(const SpecularChain& chain) {
  std::vector<SpecularVertex> out;
  out.reserve(chain.vertices.size());
  for (const ChainVertex& v : chain.vertices) {
    if (!v.straight()) out.push_back(v.specular);
  }
  return out;
}

const SpecularVertex* first_bend(const SpecularChain& chain) {
  for (const ChainVertex& v : chain.vertices) {
    if (!v.straight()) return &v.specular;
  }
  return nullptr;
}

ChainEnd infinite_end(const Vec3d& d, const Vec3d& dpdt) {
  const Vec3d helper = std::abs(d.x) < 0.6 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0};
  const Vec3d u = normalize(cross(helper, d));
  return {true, d, u, cross(d, u), dpdt};
}

WalkState bend(const SpecularVertex& vertex, bool refracts, const Vec3d& w, Vec3d& d) {
  const SurfaceFrame& f = vertex.surface;
  if (refracts && vertex.eta == 1) {
    d = -w;
    return WalkState::kDone;
  }
  const double cosine = dot(w, f.n), side = dot(w, f.ng);
  if (!(std::abs(cosine) >= kGrazing) || !(cosine * side > 0)) return WalkState::kMissed;
  if (refracts) {
    const Vec3d along = (w - f.n * cosine) * (-1 / vertex.eta);
    const double rest = 1 - dot(along, along);
    if (!(rest > 0)) return WalkState::kTotal;
    d = along - f.n * std::copysign(std::sqrt(rest), cosine);
  } else {
    d = f.n * (2 * cosine) - w;
  }
  return (dot(d, f.ng) * side < 0) == refracts ? WalkState::kDone : WalkState::kMissed;
}

std::optional<SpecularChain> trace_chain(const ChainMatter& matter, const ChainEnd& first, const Vec3d& aim,
                                         const ChainEnd& last, const Vec3d& last_normal,
                                         const std::vector<bool>& refracts, double t, const SpecularChain* like,
                                         WalkState* why) {
  const auto fail = [&](WalkState state) -> std::optional<SpecularChain> {
    if (why) *why = state;
    return std::nullopt;
  };
  SpecularChain chain{t, first, last, last_normal, {}};
  Vec3d d = first.infinite ? -first.p : normalize(aim - first.p);
  // Parallel rays start far enough before the aim to meet all that lies there.
  Vec3d o = first.infinite ? aim + first.p * (1e3 * std::max(1.0, length(aim))) : first.p;
  const ChainVertex* from = nullptr;
  chain.vertices.reserve(refracts.size());
  for (std::size_t i = 0; i < refracts.size(); ++i) {
    const auto at = matter.meet(o, d, t, from);
    if (!at) return fail(WalkState::kMissed);
    if (like) {
      const SurfacePoint& was = like->vertices[i].at.point;
      if (at->point.instance != was.instance || at->point.shape != was.shape) return fail(WalkState::kMissed);
    }
    const SurfaceFrame f = matter.surface(*at, t);
    const auto eta = matter.eta(*at, f, -d, refracts[i], t);
    if (!eta) return fail(WalkState::kMissed);
    // From the outside before, from the inside now: another path.
    if (like && refracts[i] && (*eta > 1) != (like->vertices[i].specular.eta > 1)) return fail(WalkState::kMissed);
    chain.vertices.push_back({*at, refracts[i], {f, *eta}});
    from = &chain.vertices.back();
    const WalkState bent = bend(from->specular, refracts[i], -d, d);
    if (bent != WalkState::kDone) return fail(bent);
    o = f.p;
  }
  if (last.infinite) {
    chain.last = infinite_end(d, last.dpdt);
  } else {
    // The plane of the last end rather than what the scene shows there.
    Vec3d n = last_normal;
    double cosine = dot(d, n);
    if (!(std::abs(cosine) > kFlat)) n = d, cosine = 1;
    const double distance = dot(last.p - o, n) / cosine;
    if (!(distance > 0) || !std::isfinite(distance)) return fail(WalkState::kMissed);
    chain.last.p = o + d * distance;
  }
  return chain;
}

std::optional<SpecularChain> retrace_chain(const ChainMatter& matter, const SpecularChain& like, const ChainEnd& first,
                                           const Vec3d& aim, const ChainEnd& last, const Vec3d& last_normal, double t,
                                           WalkState& why) {
  std::vector<bool> refracts;
  refracts.reserve(like.vertices.size());
  for (const ChainVertex& v : like.vertices) refracts.push_back(v.refracts);
  return trace_chain(matter, first, aim, last, last_normal, refracts, t, &like, &why);
}

WalkState walk_in_space(const ChainMatter& matter, const ChainEnd& last, const Vec3d& last_normal, double tolerance,
                        SpecularChain& chain, WalkCounts* counts, const StepLimits& limits) {
  double beta = 1;
  Gap gap = gap_of(chain, last);
  for (int step = 0; step < limits.steps; ++step) {
    if (length(gap.r) <= tolerance) {
      chain.last = last, chain.last_normal = last_normal;
      return WalkState::kDone;
    }
    const std::vector<SpecularVertex> specular = bends_of(chain);
    if (specular.empty()) return WalkState::kStuck;  // where it is aimed at decides alone
    const SpecularSystem system(chain.first, specular, chain.last);
    if (system.singular()) return WalkState::kSingular;
    const Vec2d q = system.solve({}, gap.q, 0)[0];
    const SurfaceFrame& f = specular[0].surface;
    WalkState why = WalkState::kStuck;
    for (;; beta /= 2) {
      if (beta < limits.least) return why;
      if (counts && counts->spent()) return WalkState::kStuck;
      if (counts) ++counts->spatial;
      auto next = retrace_chain(matter, chain, chain.first, f.p + (f.dpdu * q.x + f.dpdv * q.y) * beta, last,
                                last_normal, chain.time, why);
      if (!next) continue;
      const Gap left = gap_of(*next, last);
      if (!(dot(left.r, left.r) < dot(gap.r, gap.r))) {
        why = WalkState::kStuck;
        continue;
      }
      chain = std::move(*next), gap = left;
      break;
    }
    beta = std::min(1.0, 2 * beta);
  }
  if (length(gap.r) > tolerance) return WalkState::kStuck;
  chain.last = last, chain.last_normal = last_normal;
  return WalkState::kDone;
}

}  // namespace tempera
