// SPDX-License-Identifier: Apache-2.0
// Smooth and rough plastic: a diffuse base under a dielectric coat. Light that the base scatters is partly reflected
// back by the coat from inside, again and again; `nonlinear` lets the base's color take part in that series.
#include <map>
#include <mutex>
#include <numeric>
#include <span>
#include <tuple>

#include "material_util.h"
#include "quadrature.h"
#include "tempera/core/parallel.h"

namespace tempera {
namespace {

/// Reflectance or transmittance of a rough interface of relative index eta, for `wo` outside: nodes of a Gauss-Legendre
/// rule on the unit square are mapped through the sampling of visible normals, whose weight is Fresnel times masking.
/// Normals come in pairs that mirror each other in the plane of wo, so that half of the square suffices.
float rough_albedo(const Microfacet& facets, const Vec3f& wo, float eta, bool transmitted,
                   const std::vector<QuadratureNode>& rule) {
  const bool lateral_is_x = facets.type == Microfacets::kGgx;
  double sum = 0;
  for (std::size_t i = 0; i < rule.size() / 2; ++i)
    for (const QuadratureNode& b : rule) {
      const QuadratureNode& a = rule[i];
      const Vec3f m = facets.sample(wo, lateral_is_x ? Vec2f{a.x, b.x} : Vec2f{b.x, a.x});
      const float om = dot(wo, m);
      const DielectricInterface face = dielectric_interface(om, eta);
      Vec3f wi;
      float f;
      if (transmitted) {
        wi = m * (om / face.eta + face.cos_t) - wo * (1 / face.eta);
        f = wi.z < 0 ? 1 - face.reflectance : 0;
      } else {
        wi = mirror(wo, m);
        f = wi.z > 0 ? face.reflectance : 0;
      }
      if (f > 0) sum += 2 * double(a.weight) * double(b.weight) * double(f * facets.g1(wi, m));
    }
  return float(sum);
}

std::shared_ptr<const RoughTransmittance> compute(Microfacets type, float alpha, float eta) {
  // Total internal reflection makes a kink, so that the inside needs a finer rule; with these the table is exact to
  // 2e-4.
  const std::vector<QuadratureNode> coarse = gauss_legendre(32),
                                    fine = gauss_legendre(type == Microfacets::kGgx ? 128 : 64);
  const Microfacet facets(type, alpha, alpha);
  auto table = std::make_shared<RoughTransmittance>();
  std::array<double, RoughTransmittance::kSize> inside{};
  parallel_for(0, RoughTransmittance::kSize, [&](std::int64_t i) {
    const float mu = std::max(float(i) / (RoughTransmittance::kSize - 1), 1e-6f);
    const Vec3f wo{std::sqrt(1 - mu * mu), 0, mu};
    table->external[i] = rough_albedo(facets, wo, eta, true, eta > 1 ? coarse : fine);
    inside[i] = double(rough_albedo(facets, wo, 1 / eta, false, eta > 1 ? fine : coarse) * mu);
  });
  table->internal_reflectance =
      float(2 * std::accumulate(inside.begin(), inside.end(), 0.0) / RoughTransmittance::kSize);
  constexpr int kSteps = 4 * RoughTransmittance::kSize;
  for (int i = 0; i < kSteps; ++i) {
    const float c = (float(i) + 0.5f) / kSteps;
    table->mean += table->at(c) * 2 * c / kSteps;
  }
  return table;
}

}  // namespace

std::shared_ptr<const RoughTransmittance> RoughTransmittance::make(Microfacets type, float alpha, float eta) {
  using Key = std::tuple<Microfacets, float, float>;
  static std::mutex mutex;  // tables are pure functions of the key, and kept only while a material uses them
  static std::map<Key, std::weak_ptr<const RoughTransmittance>> tables;
  const Key key{type, alpha, eta};
  {
    const std::lock_guard lock(mutex);
    if (auto known = tables[key].lock()) return known;
  }
  // Not under the lock: the loop may run other tasks of this thread, and they may want a table, too.
  auto table = compute(type, alpha, eta);
  const std::lock_guard lock(mutex);
  tables[key] = table;
  return table;
}

namespace {

class Plastic final : public Material {
 public:
  explicit Plastic(const PlasticParams& params)
      : p_(params), eta_(params.int_ior / params.ext_ior), internal_(diffuse_fresnel_reflectance(1 / eta_)) {
    if (p_.roughness.rough) {
      if (!p_.roughness.alpha_u.is_constant())
        throw Error(ErrorCode::kUnsupported, "plastic: the roughness of a rough plastic must be a constant");
      const float alpha = std::max(p_.roughness.alpha_u.factor.at(0).r, 1e-4f);
      table_ = RoughTransmittance::make(p_.roughness.distribution, alpha, eta_);
      internal_ = table_->internal_reflectance;
    }
    const float s = sampling_mean(p_.specular_reflectance), d = sampling_mean(p_.diffuse_reflectance);
    specular_weight_ = s + d > 0 ? s / (s + d) : 1;
  }

  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    const float cosine = cos_wo(point);
    if (cosine <= 0) return;
    const int frame = frame_of(point, bsdf);
    const DielectricFresnel coat{eta_, p_.specular_reflectance.rgb(point), Rgb(0.0f)};
    const Rgb base = p_.diffuse_reflectance.rgb(point);
    const Rgb series = Rgb(1.0f) - (p_.nonlinear ? base * internal_ : Rgb(internal_));
    const Rgb diffuse = base / series * (1 / (eta_ * eta_));

    const float transmitted = table_ ? table_->at(cosine) : 1 - dielectric_interface(cosine, eta_).reflectance;
    float specular = (1 - transmitted) * specular_weight_;
    const float total = specular + transmitted * (1 - specular_weight_);
    specular = total > 0 ? specular / total : 1;
    if (table_) {
      const float alpha = p_.roughness.alpha_u.factor.at(0).r;
      const Microfacet facets(p_.roughness.distribution, alpha, alpha, p_.roughness.sample_visible);
      bsdf.add(frame, MicrofacetReflectionLobe<DielectricFresnel>{facets, coat}, weight * specular, weight);
      RoughPlasticLobe lobe;
      lobe.reflectance = diffuse;
      lobe.table = table_.get();
      bsdf.add(frame, lobe, weight * (1 - specular), weight);
    } else {
      bsdf.add(frame, MirrorLobe<DielectricFresnel>{coat}, weight * specular, weight);
      SmoothPlasticLobe lobe;
      lobe.reflectance = diffuse;
      lobe.eta = eta_;
      bsdf.add(frame, lobe, weight * (1 - specular), weight);
    }
  }
  bool needs_tangents() const override { return false; }  // roughness is one constant
  bool needs_footprint() const override { return any_texture({&p_.diffuse_reflectance, &p_.specular_reflectance}); }
  int max_lobes() const override { return 2; }

 private:
  PlasticParams p_;
  float eta_;
  float internal_;  ///< reflectance of the coat for diffuse light from inside
  float specular_weight_ = 0.5f;
  std::shared_ptr<const RoughTransmittance> table_;  ///< null: smooth
};

}  // namespace

MaterialPtr make_plastic(const PlasticParams& params) {
  check_ior("plastic", params.int_ior, params.ext_ior);
  return std::make_shared<Plastic>(params);
}

namespace {
MaterialPtr plastic_from(const MaterialValues& v) {
  PlasticParams p;
  p.int_ior = float(v.params().get_double("int_ior"));
  p.ext_ior = float(v.params().get_double("ext_ior"));
  p.diffuse_reflectance = v.color_slot("reflectance");
  p.specular_reflectance = v.color_slot("specular");
  p.nonlinear = v.params().get_bool("nonlinear");
  p.roughness = roughness_from(v);
  return make_plastic(p);
}
}  // namespace

extern const MaterialEntry plastic_material;
const MaterialEntry plastic_material{"plastic",
                                     "diffuse base under a clear coat",
                                     {{"reflectance", "0.5", "of the base: color or image"},
                                      {"specular", "1", "factor of the coat's reflection: color or image"},
                                      {"nonlinear", false, "color shifts of the scattering inside"},
                                      ior_param(1.49),
                                      outer_ior_param(),
                                      roughness_param(),
                                      distribution_param()},
                                     plastic_from};

}  // namespace tempera
