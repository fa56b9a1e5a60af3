// SPDX-License-Identifier: Apache-2.0
#include "tempera/manifold/specular_system.h"

#include <array>

namespace tempera {

namespace {

/// Of what matters, the determinant of a block that has no inverse any more.
constexpr double kSingular = 1e-10;

/// Tangents of the shading normal.
struct Tangents {
  Vec3d s, t;
  Vec2d operator()(const Vec3d& v) const { return {dot(s, v), dot(t, v)}; }
};

Tangents tangents_of(const SurfaceFrame& f) {
  const Vec3d s = normalize(f.dpdu - f.n * dot(f.n, f.dpdu));
  return {s, cross(f.n, s)};
}

/// A direction from a vertex to a neighbour: w, and how it changes as either moves, (I - w w^T) / r times what they do.
struct Edge {
  Vec3d w;
  double inverse_length = 0;  ///< 0: infinitely long
  bool infinite = false;

  Edge(const ChainEnd& end, const Vec3d& from) : infinite(end.infinite) {
    const Vec3d d = infinite ? end.p : end.p - from;
    const double r = length(d);
    w = d * (1 / r);
    if (!infinite) inverse_length = 1 / r;
  }
  Vec3d across(const Vec3d& v) const { return v - w * dot(w, v); }
  /// Change of w if the neighbour moves by v, or an infinite one turns by v.
  Vec3d by_neighbour(const Vec3d& v) const { return across(v) * (infinite ? 1.0 : inverse_length); }
  /// Change of w if the vertex itself moves by v.
  Vec3d by_vertex(const Vec3d& v) const { return across(v) * -inverse_length; }
};

}  // namespace

Vec2d constraint(const ChainEnd& before, const SpecularVertex& v, const ChainEnd& after) {
  const Edge to_before(before, v.surface.p), to_after(after, v.surface.p);
  return tangents_of(v.surface)(to_before.w + to_after.w * v.eta);
}

ConstraintBlocks blocks_of(const ChainEnd& before, const SpecularVertex& v, const ChainEnd& after) {
  const SurfaceFrame& f = v.surface;
  const Tangents project = tangents_of(f);
  const Edge to_before(before, f.p), to_after(after, f.p);
  // Where c = 0 the tangents turn only against h along n: d(S^T) h = -(h . n) S^T dn. [Jakob 2012, Sec. 4.3]
  const double along = dot(to_before.w + to_after.w * v.eta, f.n);
  const auto by_vertex = [&](const Vec3d& dp, const Vec3d& dn) {
    return project(to_before.by_vertex(dp) + to_after.by_vertex(dp) * v.eta - dn * along);
  };
  const auto by_before = [&](const Vec3d& dp) { return project(to_before.by_neighbour(dp)); };
  const auto by_after = [&](const Vec3d& dp) { return project(to_after.by_neighbour(dp) * v.eta); };
  return {{by_before(before.dpdu), by_before(before.dpdv)},
          {by_vertex(f.dpdu, f.dndu), by_vertex(f.dpdv, f.dndv)},
          {by_after(after.dpdu), by_after(after.dpdv)},
          by_before(before.dpdt) + by_after(after.dpdt) + by_vertex(f.dpdt, f.dndt)};
}

SpecularSystem::SpecularSystem(const ChainEnd& first, std::span<const SpecularVertex> chain, const ChainEnd& last) {
  const std::size_t count = chain.size();
  blocks_.reserve(count), inverse_.reserve(count), upper_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const ChainEnd before = i > 0 ? ChainEnd::of(chain[i - 1].surface) : first;
    const ChainEnd after = i + 1 < count ? ChainEnd::of(chain[i + 1].surface) : last;
    const ConstraintBlocks b = blocks_of(before, chain[i], after);
    const Mat2 d = i > 0 ? b.at - b.before * upper_[i - 1] : b.at;
    singular_ |= !(std::abs(d.determinant()) > kSingular * b.at.norm_squared());
    blocks_.push_back(b);
    inverse_.push_back(d.inverse());
    upper_.push_back(inverse_.back() * b.after);
  }
}

std::vector<Vec2d> SpecularSystem::solve(const Vec2d& q_first, const Vec2d& q_last, double dt) const {
  // Block elimination from the camera on, and back.
  std::vector<Vec2d> q(blocks_.size());
  Vec2d before = q_first;  // known for the first vertex; then what elimination has found
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    q[i] = inverse_[i] * (blocks_[i].rate * -dt - blocks_[i].before * before);
    before = q[i];
  }
  Vec2d after = q_last;
  for (std::size_t i = blocks_.size(); i-- > 0;) {
    q[i] = q[i] - upper_[i] * after;
    after = q[i];
  }
  return q;
}

}  // namespace tempera
