// SPDX-License-Identifier: Apache-2.0
#include "albedo.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "tempera/shading/lobe_sheen.h"
#include "tempera/shading/microfacet.h"

namespace tempera {
namespace {

constexpr int kSize = 32;
// Cosines are spaced by squares (albedos change fastest at grazing angles), roughness by the square root of alpha.
float cosine_at(int i) { return std::max(sqr(float(i) / (kSize - 1)), 1e-4f); }
float alpha_at(int i) { return std::max(sqr(float(i) / (kSize - 1)), 1e-3f); }

template <class T>
using Table = std::array<std::array<T, kSize>, kSize>;  // [alpha][cosine]

template <class T>
T lookup(const Table<T>& table, float cosine, float alpha, T (*mix)(const T&, const T&, float)) {
  const float x = std::sqrt(std::clamp(std::abs(cosine), 0.0f, 1.0f)) * (kSize - 1);
  const float y = std::sqrt(std::clamp(alpha, 0.0f, 1.0f)) * (kSize - 1);
  const int i = std::min(int(x), kSize - 2), j = std::min(int(y), kSize - 2);
  const auto row = [&](int r) {
    const auto& t = table[std::size_t(r)];
    return mix(t[std::size_t(i)], t[std::size_t(i) + 1], x - float(i));
  };
  return mix(row(j), row(j + 1), y - float(j));
}

Vec3f direction(float cosine) { return {std::sqrt(std::max(1 - cosine * cosine, 0.0f)), 0, cosine}; }

std::unique_ptr<const Table<GgxAlbedo>> make_ggx_table() {
  constexpr int kSamples = 512;
  auto table = std::make_unique<Table<GgxAlbedo>>();
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) {
      const Vec3f wo = direction(cosine_at(i));
      const Microfacet f(Microfacets::kGgx, alpha_at(j), alpha_at(j));
      double scale = 0, bias = 0;
      for (int s = 0; s < kSamples; ++s) {
        const Vec3f m = f.sample(wo, recurrence_point(s));
        const Vec3f wi = mirror(wo, m);
        if (wi.z <= 0) continue;
        const float weight = f.g1(wi, m), schlick = std::pow(std::clamp(1 - dot(wo, m), 0.0f, 1.0f), 5.0f);
        scale += weight * (1 - schlick);
        bias += weight * schlick;
      }
      (*table)[std::size_t(j)][std::size_t(i)] = {float(scale / kSamples), float(bias / kSamples)};
    }
  return table;
}

std::unique_ptr<const Table<float>> make_sheen_table() {
  constexpr int kCosines = 32, kAngles = 24;
  auto table = std::make_unique<Table<float>>();
  for (int j = 0; j < kSize; ++j)
    for (int i = 0; i < kSize; ++i) {
      SheenLobe lobe;
      lobe.color = Rgb(1.0f);
      lobe.alpha = alpha_at(j);
      const Vec3f wo = direction(cosine_at(i));
      double sum = 0;
      for (int a = 0; a < kCosines; ++a)
        for (int b = 0; b < kAngles; ++b) {
          // cos = x^2 gathers points at the horizon; half of the azimuths suffice by symmetry.
          const float x = (float(a) + 0.5f) / kCosines, c = x * x, s = std::sqrt(1 - c * c);
          const float phi = kPi * (float(b) + 0.5f) / kAngles;
          sum += lobe.eval(wo, {s * std::cos(phi), s * std::sin(phi), c}).f_cos.r * 2 * x;
        }
      (*table)[std::size_t(j)][std::size_t(i)] = float(std::min(sum * 2 * kPiD / (kCosines * kAngles), 1.0));
    }
  return table;
}

}  // namespace

GgxAlbedo ggx_albedo(float cosine, float alpha) {
  static const auto table = make_ggx_table();
  return lookup<GgxAlbedo>(*table, cosine, alpha, [](const GgxAlbedo& a, const GgxAlbedo& b, float s) {
    return GgxAlbedo{a.scale + s * (b.scale - a.scale), a.bias + s * (b.bias - a.bias)};
  });
}

float sheen_albedo(float cosine, float alpha) {
  static const auto table = make_sheen_table();
  return lookup<float>(*table, cosine, alpha, [](const float& a, const float& b, float s) { return a + s * (b - a); });
}

}  // namespace tempera
