// SPDX-License-Identifier: Apache-2.0
#pragma once
// Directional albedos of rough lobes, tabulated on first use.

namespace tempera {

/// Albedo of GGX reflection with single scattering and a Schlick term: f0 * scale + f90 * bias.
struct GgxAlbedo {
  float scale, bias;
  float of(float f0, float f90) const { return f0 * scale + f90 * bias; }
};
/// For cosine in [0,1] (absolute value is taken) and alpha in [0,1]; bilinear in a 32 x 32 table, error below 1e-2.
GgxAlbedo ggx_albedo(float cosine, float alpha);

}  // namespace tempera
