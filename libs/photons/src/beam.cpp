// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/beam.h"

#include <algorithm>
#include <cmath>

namespace tempera {

namespace {

/// The least cosine behind a refracting surface by which a derivative is divided.
constexpr double kLeastCosine = 0.02;

}  // namespace

void transfer(const SurfaceFrame& f, double distance, Beam& beam) {
  const double inv = 1 / dot(f.ng, beam.w);
  for (int i = 0; i < Beam::kColumns; ++i) {
    // A point that moves with the surface stays on it, so its velocity stands for the motion of the plane.
    Vec3d d = beam.dx[i] + beam.dw[i] * distance;
    const Vec3d moved = i == Beam::kTime ? d - f.dpdt : d;
    d += beam.w * (-dot(f.ng, moved) * inv);
    beam.dx[i] = d;
  }
  beam.x = f.p;
}

MatterChange matter_change(const SurfaceFrame& f, const Beam& beam) {
  MatterChange r;
  const double uu = dot(f.dpdu, f.dpdu), uv = dot(f.dpdu, f.dpdv), vv = dot(f.dpdv, f.dpdv);
  const double determinant = uu * vv - uv * uv;
  if (!(determinant > 0)) return r;
  const double inv = 1 / determinant;
  for (int i = 0; i < Beam::kColumns; ++i) {
    const Vec3d d = i == Beam::kTime ? beam.dx[i] - f.dpdt : beam.dx[i];
    const double a = dot(d, f.dpdu), b = dot(d, f.dpdv);
    r.u[i] = (vv * a - uv * b) * inv;
    r.v[i] = (uu * b - uv * a) * inv;
  }
  return r;
}

Beam::Columns normal_change(const SurfaceFrame& f, const MatterChange& change) {
  Beam::Columns r;
  for (int i = 0; i < Beam::kColumns; ++i) {
    r[i] = f.dndu * change.u[i] + f.dndv * change.v[i];
    if (i == Beam::kTime) r[i] += f.dndt;
  }
  return r;
}

void reflect(const Vec3d& n, const Beam::Columns& dn, Beam& beam) {
  const double c = dot(beam.w, n);
  for (int i = 0; i < Beam::kColumns; ++i) {
    Vec3d& d = beam.dw[i];
    d = d - ((dot(d, n) + dot(beam.w, dn[i])) * n + c * dn[i]) * 2.0;
  }
  beam.w = beam.w - n * (2 * c);
}

bool refract(const Vec3d& normal, const Beam::Columns& dn, double eta, Beam& beam) {
  const double side = dot(beam.w, normal) > 0 ? -1 : 1;
  const Vec3d n = normal * side;
  const double ratio = 1 / eta, ci = -dot(beam.w, n), k = 1 - ratio * ratio * (1 - ci * ci);
  if (!(k > 0)) return false;
  const double ct = std::sqrt(k), mu = ratio * ci - ct;
  for (int i = 0; i < Beam::kColumns; ++i) {
    const Vec3d turn = dn[i] * side;
    Vec3d& d = beam.dw[i];
    const double dci = -(dot(d, n) + dot(beam.w, turn));
    const double dmu = ratio * (1 - ratio * ci / std::max(ct, kLeastCosine)) * dci;
    d = d * ratio + n * dmu + turn * mu;
  }
  beam.w = beam.w * ratio + n * mu;
  return true;
}

Beam::Columns turned(const Beam::Columns& dn, const Vec3d& n, const Vec3d& m) {
  // The rotation of the smallest angle from n to m.
  const Vec3d axis = cross(n, m);
  const double c = dot(n, m), k = 1 / std::max(1 + c, 1e-6);
  Beam::Columns r;
  for (int i = 0; i < Beam::kColumns; ++i) r[i] = dn[i] * c + cross(axis, dn[i]) + axis * (dot(axis, dn[i]) * k);
  return r;
}

void widen(double length, Beam& beam) {
  // A beam's position along itself does not matter, so each column is a vector of four numbers: where it is and where it
  // goes, across the beam. As columns of a matrix M they spread by M M^T, which is L L^T for the triangular L of M = L Q.
  constexpr int kAll = Beam::kSpatial + 2;
  const auto [s, t] = tangents_of(beam.w);
  std::array<std::array<double, kAll>, 4> rows{};
  for (int i = 0; i < Beam::kSpatial; ++i) {
    rows[0][i] = dot(beam.dx[i], s), rows[1][i] = dot(beam.dx[i], t);
    rows[2][i] = dot(beam.dw[i], s), rows[3][i] = dot(beam.dw[i], t);
  }
  rows[2][Beam::kSpatial] = length;
  rows[3][Beam::kSpatial + 1] = length;
  std::array<std::array<double, 4>, 4> l{};
  for (int r = 0; r < 4; ++r) {
    std::array<double, kAll> q = rows[r];
    const auto product = [](const auto& a, const auto& b) {
      double sum = 0;
      for (int i = 0; i < kAll; ++i) sum += a[i] * b[i];
      return sum;
    };
    const double before = std::sqrt(product(q, q));
    for (int k = 0; k < r; ++k) {
      l[r][k] = product(q, rows[k]);  // rows before r are orthonormal, or zero
      for (int i = 0; i < kAll; ++i) q[i] -= l[r][k] * rows[k][i];
    }
    const double left = std::sqrt(product(q, q));
    l[r][r] = left > 1e-9 * before ? left : 0;
    for (double& v : q) v = l[r][r] > 0 ? v / l[r][r] : 0;
    rows[r] = q;
  }
  for (int i = 0; i < Beam::kSpatial; ++i) {
    beam.dx[i] = s * l[0][i] + t * l[1][i];
    beam.dw[i] = s * l[2][i] + t * l[3][i];
  }
}

double follow_matter(const SurfaceFrame& f, const EmitterMotion& emitter, double distance, Beam& beam) {
  const Vec3d& w = beam.w;
  const Vec3d relative = f.dpdt - emitter.velocity;
  Vec3d& dw = beam.dw[Beam::kTime];
  beam.dx[Beam::kTime] = f.dpdt;
  dw = emitter.parallel ? cross(emitter.turn, w) : (relative - w * dot(w, relative)) * (1 / distance);
  // Flux: irradiance across the ray, which falls with the square of the distance, times the area that the matter shows.
  double rate = (dot(dw, f.ng) + dot(w, f.dngdt)) / dot(w, f.ng) + f.area_rate;
  if (!emitter.parallel) rate -= 2 * dot(w, relative) / distance;
  return rate;
}

}  // namespace tempera
