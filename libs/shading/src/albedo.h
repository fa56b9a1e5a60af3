// SPDX-License-Identifier: Apache-2.0
#pragma once
// Directional albedos of rough lobes, tabulated on first use.
#include <cmath>

#include "tempera/core/vec.h"

namespace tempera {

/// Point i of an additive recurrence in the unit square [Roberts 2018]. Unlike a grid, its points lie on different
/// circles of the disk that visible normals are drawn from, which resolves GGX's long tail.
inline Vec2f recurrence_point(int i) {
  const double x = 0.5 + 0.7548776662466927 * i, y = 0.5 + 0.5698402909980532 * i;
  return {float(x - std::floor(x)), float(y - std::floor(y))};
}

/// Albedo of GGX reflection with single scattering and a Schlick term: f0 * scale + f90 * bias.
struct GgxAlbedo {
  float scale, bias;
  float of(float f0, float f90) const { return f0 * scale + f90 * bias; }
};
/// For cosine in [0,1] (absolute value is taken) and alpha in [0,1]; bilinear in a 32 x 32 table, error below 1e-2.
GgxAlbedo ggx_albedo(float cosine, float alpha);

}  // namespace tempera
