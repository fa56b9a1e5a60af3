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

float cosine_at(int i) { return std::max(sqr(float(i) / (kAlbedoSize - 1)), 1e-4f); }
float alpha_at(int i) { return std::max(sqr(float(i) / (kAlbedoSize - 1)), 1e-3f); }

Vec3f direction(float cosine) { return {std::sqrt(std::max(1 - cosine * cosine, 0.0f)), 0, cosine}; }

std::unique_ptr<const AlbedoTable<GgxAlbedo>> make_ggx_table() {
  constexpr int kSamples = 512;
  auto table = std::make_unique<AlbedoTable<GgxAlbedo>>();
  for (int j = 0; j < kAlbedoSize; ++j)
    for (int i = 0; i < kAlbedoSize; ++i) {
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

std::unique_ptr<const AlbedoTable<float>> make_sheen_table() {
  constexpr int kCosines = 32, kAngles = 24;
  auto table = std::make_unique<AlbedoTable<float>>();
  for (int j = 0; j < kAlbedoSize; ++j)
    for (int i = 0; i < kAlbedoSize; ++i) {
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

const AlbedoTable<GgxAlbedo>& ggx_albedo_table() {
  static const auto table = make_ggx_table();
  return *table;
}

float sheen_albedo(float cosine, float alpha) {
  static const auto table = make_sheen_table();
  const AlbedoPlace at(cosine, alpha);
  const auto row = [&](std::size_t j) { return lerp((*table)[j][at.i], (*table)[j][at.i + 1], at.x); };
  return lerp(row(at.j), row(at.j + 1), at.y);
}

}  // namespace tempera
