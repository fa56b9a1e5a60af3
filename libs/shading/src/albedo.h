// SPDX-License-Identifier: Apache-2.0
#pragma once
// Directional albedos of rough lobes, tabulated on first use.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "tempera/core/vec.h"
#include "tempera/shading/microfacet.h"

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

/// Function of cosine and alpha, [alpha][cosine]. Both are spaced by squares: albedos change fastest at grazing angles.
inline constexpr int kAlbedoSize = 32;
template <class T>
using AlbedoTable = std::array<std::array<T, kAlbedoSize>, kAlbedoSize>;

/// Where a table is read: cosine (the absolute value is taken) and alpha, both in [0,1].
struct AlbedoPlace {
  std::size_t i, j;  ///< columns i and i + 1, rows j and j + 1
  float x, y;        ///< position between them
  AlbedoPlace(float cosine, float alpha) {
    constexpr int kLast = kAlbedoSize - 1;
    x = std::sqrt(std::min(1.0f, std::abs(cosine))) * kLast;  // 1 for what is no number
    y = std::sqrt(std::max(0.0f, std::min(1.0f, alpha))) * kLast;
    const int column = std::min(int(x), kLast - 1), row = std::min(int(y), kLast - 1);
    i = column, j = row;
    x -= float(column), y -= float(row);
  }
};

/// Made on first use. Threads: safe.
const AlbedoTable<GgxAlbedo>& ggx_albedo_table();
/// Bilinear in the table, error below 1e-2.
inline GgxAlbedo ggx_albedo(float cosine, float alpha) {
  using Floats = float __attribute__((vector_size(16)));  // scale and bias of two neighbouring cosines
  const AlbedoTable<GgxAlbedo>& table = ggx_albedo_table();
  const AlbedoPlace at(cosine, alpha);
  Floats a, b;
  std::memcpy(&a, &table[at.j][at.i], sizeof a);
  std::memcpy(&b, &table[at.j + 1][at.i], sizeof b);
  a += (b - a) * at.y;
  return {a[0] + at.x * (a[2] - a[0]), a[1] + at.x * (a[3] - a[1])};
}

/// What a table of directional albedos is about. Entries are means of four functions over the normals that are visible
/// from `wo`, with the masking of the scattered direction; F is a Fresnel term of the relative index, c the cosine at
/// the facet.
enum class AlbedoOf : std::uint8_t {
  kFresnel,    ///< reflected 1 - F, F; transmitted 1 - F, F of a dielectric
  kSchlick,    ///< the same with Schlick's weight (schlick_weight_interface)
  kFacets,     ///< reflected 1, c
  kBurley,     ///< PrincipledDiffuseLobe: white base without and with flatness, white sheen. alpha is the roughness
  kClearcoat,  ///< ClearcoatLobe of weight 1
};
struct AlbedoKey {
  AlbedoOf of;
  Microfacets facets = Microfacets::kGgx;
  float eta = 1;  ///< far side over the side of wo
  bool operator==(const AlbedoKey&) const = default;
};
using AlbedoEntry = std::array<float, 4>;
/// Bilinear in a table that is made on first use. Error below 0.02. Threads: safe.
AlbedoEntry albedo_of(const AlbedoKey& key, float cosine, float alpha);

}  // namespace tempera
