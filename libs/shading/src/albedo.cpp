// SPDX-License-Identifier: Apache-2.0
#include "albedo.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <mutex>

#include "tempera/shading/lobe_principled.h"
#include "tempera/shading/lobe_sheen.h"

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
      (*table)[j][i] = {float(scale / kSamples), float(bias / kSamples)};
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
      (*table)[j][i] = float(std::min(sum * 2 * kPiD / (kCosines * kAngles), 1.0));
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

namespace {

/// Adds the four functions of kFresnel, kSchlick or kFacets at the facet m.
void add_facet(const AlbedoKey& key, const Microfacet& facets, const Vec3f& wo, const Vec3f& m, double (&sum)[4]) {
  const float om = dot(wo, m);
  const Vec3f reflected = mirror(wo, m);
  const float back = reflected.z > 0 ? facets.g1(reflected, m) : 0;
  if (key.of == AlbedoOf::kFacets) {
    sum[0] += double(back);
    sum[1] += double(back * om);
    return;
  }
  const DielectricInterface face = dielectric_interface(om, key.eta);
  const float f = key.of == AlbedoOf::kFresnel ? face.reflectance : schlick_weight_interface(om, key.eta);
  sum[0] += double(back * (1 - f));
  sum[1] += double(back * f);
  if (face.cos_t == 0) return;  // total reflection
  const Vec3f refracted = m * (om / face.eta + face.cos_t) - wo * (1 / face.eta);
  const float through = refracted.z < 0 ? facets.g1(refracted, m) : 0;
  sum[2] += double(through * (1 - f));
  sum[3] += double(through * f);
}

AlbedoTable<AlbedoEntry> make_table(const AlbedoKey& key) {
  constexpr int kSamples = 256;
  AlbedoTable<AlbedoEntry> table;
  for (int j = 0; j < kAlbedoSize; ++j)
    for (int i = 0; i < kAlbedoSize; ++i) {
      const Vec3f wo = direction(cosine_at(i));
      const float alpha = alpha_at(j);
      const Microfacet facets(key.facets, alpha, alpha);
      const ClearcoatLobe coat{1, alpha, key.eta};
      PrincipledDiffuseLobe plain, flat, sheen;
      plain.base_color = flat.base_color = sheen.sheen = Rgb(1.0f);
      plain.surface_roughness = flat.surface_roughness = alpha;
      flat.flatness = 1;
      double sum[4] = {};
      for (int s = 0; s < kSamples; ++s) {
        const Vec2f u = recurrence_point(s);
        Vec3f wi;
        if (key.of == AlbedoOf::kBurley) {
          plain.sample(wo, 0, u, wi);
          const PrincipledDiffuseLobe* lobes[] = {&plain, &flat, &sheen};
          for (int k = 0; k < 3; ++k) {
            const LobeEval e = lobes[k]->eval(wo, wi);
            if (e.pdf > 0) sum[k] += double(e.f_cos.g / e.pdf);
          }
        } else if (key.of == AlbedoOf::kClearcoat) {
          if (!coat.sample(wo, 0, u, wi)) continue;
          const LobeEval e = coat.eval(wo, wi);
          if (e.pdf > 0) sum[0] += double(e.f_cos.g / e.pdf);
        } else {
          add_facet(key, facets, wo, facets.sample(wo, u), sum);
        }
      }
      for (std::size_t k = 0; k < 4; ++k) table[j][i][k] = float(sum[k] / kSamples);
    }
  return table;
}

/// The tables that have been asked for: pure functions of their keys, and few, as there is one for each index of
/// refraction in a scene. Read without a lock.
struct KnownTable {
  AlbedoKey key;
  AlbedoTable<AlbedoEntry> table;
  std::unique_ptr<const KnownTable> next;
};

const AlbedoTable<AlbedoEntry>& table_of(const AlbedoKey& key) {
  static std::mutex mutex;
  static std::unique_ptr<const KnownTable> all;
  static std::atomic<const KnownTable*> newest{nullptr};
  const auto find = [&]() -> const KnownTable* {
    const KnownTable* t = newest.load(std::memory_order_acquire);
    while (t && !(t->key == key)) t = t->next.get();
    return t;
  };
  if (const KnownTable* t = find()) return t->table;
  const std::lock_guard lock(mutex);
  if (const KnownTable* t = find()) return t->table;
  all = std::make_unique<const KnownTable>(KnownTable{key, make_table(key), std::move(all)});
  newest.store(all.get(), std::memory_order_release);
  return all->table;
}

}  // namespace

AlbedoEntry albedo_of(const AlbedoKey& key, float cosine, float alpha) {
  const AlbedoTable<AlbedoEntry>& table = table_of(key);
  const AlbedoPlace at(cosine, alpha);
  const auto &a = table[at.j][at.i], &b = table[at.j][at.i + 1], &c = table[at.j + 1][at.i],
             &d = table[at.j + 1][at.i + 1];
  AlbedoEntry result;
  for (std::size_t k = 0; k < 4; ++k) result[k] = lerp(lerp(a[k], b[k], at.x), lerp(c[k], d[k], at.x), at.y);
  return result;
}

}  // namespace tempera
