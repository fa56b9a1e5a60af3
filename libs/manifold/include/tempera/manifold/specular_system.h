// SPDX-License-Identifier: Apache-2.0
#pragma once
// How a chain of mirrors and glass moves, to first order: which changes of its vertices keep it a path of light when its
// ends move over their surfaces, and matter with time. [Jakob 2012, Sec. 4; Zimmer 2015, Sec. 4]
//
// Each specular vertex x_i between x_{i-1} and x_{i+1} obeys c_i = S^T h = 0: the half vector h = w_- + eta w_+ of the unit
// directions to both neighbours is along the shading normal n, of which S = [s, t] are tangents. Derivatives of c by the
// parameters of the three vertices are 2x2 blocks A, B and C, and tau by time; together they are a block tridiagonal
// system, which is solved in linear time.
#include <span>
#include <vector>

#include "tempera/accel/ray_scene.h"

namespace tempera {

/// A 2x2 matrix by columns.
struct Mat2 {
  Vec2d x, y;
  Vec2d operator*(const Vec2d& v) const { return x * v.x + y * v.y; }
  Mat2 operator*(const Mat2& m) const { return {*this * m.x, *this * m.y}; }
  Mat2 operator-(const Mat2& m) const { return {x - m.x, y - m.y}; }
  double determinant() const { return x.x * y.y - x.y * y.x; }
  double norm_squared() const { return dot(x, x) + dot(y, y); }
  /// Pre: the determinant is not zero.
  Mat2 inverse() const {
    const double k = 1 / determinant();
    return {{y.y * k, -x.y * k}, {-y.x * k, x.x * k}};
  }
};

/// A vertex between others that reflects or refracts.
struct SpecularVertex {
  SurfaceFrame surface;
  /// Index of refraction on the far side over that on the near side, along the chain; 1 for mirrors.
  double eta = 1;
};

/// The first or the last vertex of a chain: a point of a surface, of a lens or without any; or a direction, of parallel
/// rays and of what is infinitely far away.
struct ChainEnd {
  bool infinite = false;
  Vec3d p;           ///< position; infinite: unit direction from the chain to it
  Vec3d dpdu, dpdv;  ///< by the end's parameters; zero where it has none
  Vec3d dpdt;        ///< per second, of the same matter

  static ChainEnd of(const SurfaceFrame& s) { return {false, s.p, s.dpdu, s.dpdv, s.dpdt}; }
};

/// Derivatives of the constraint of one vertex.
struct ConstraintBlocks {
  Mat2 before, at, after;  ///< A, B, C: by the parameters of the vertex before, of its own, of the one after
  Vec2d rate;              ///< tau: by time
};

/// How far the vertex between two ends is from being one of a path of light: S^T h, zero if it is one; S as blocks_of.
Vec2d constraint(const ChainEnd& before, const SpecularVertex& v, const ChainEnd& after);
/// Derivatives of that where it is zero. Pre: dpdu and dpdv of the vertex are not parallel.
ConstraintBlocks blocks_of(const ChainEnd& before, const SpecularVertex& v, const ChainEnd& after);

/// The linear system of a whole chain.
class SpecularSystem {
 public:
  SpecularSystem(const ChainEnd& first, std::span<const SpecularVertex> chain, const ChainEnd& last);
  /// Whether the chain folds here (a caustic): its vertices do not follow from its ends.
  bool singular() const { return singular_; }
  /// Changes of the vertices' parameters if those of the ends change by q_first and q_last and `dt` seconds pass.
  /// Pre: not singular.
  std::vector<Vec2d> solve(const Vec2d& q_first, const Vec2d& q_last, double dt) const;

 private:
  std::vector<ConstraintBlocks> blocks_;
  std::vector<Mat2> inverse_;  ///< of D_i = B_i - A_i U_{i-1}
  std::vector<Mat2> upper_;    ///< U_i = D_i^-1 C_i
  bool singular_ = false;
};

}  // namespace tempera
