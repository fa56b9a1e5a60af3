// SPDX-License-Identifier: Apache-2.0
// glTF 2.0 materials [glTF 2.0, Appendix B, and the KHR_materials extensions], from the top:
//   clearcoat over sheen over mix(dielectric: GGX reflection over mix(diffuse, transmission), metal: GGX reflection).
// Reflection of dielectric and metal share one lobe, because both Fresnel terms have Schlick's form.
// DEVIATION [glTF 2.0, B.3.6.3]: the simple mix dims the diffuse base by 1 - F(VdotH), which gains up to a factor of
// two at grazing angles. Here every layer dims what is below it by min(1 - A(wo), 1 - A(wi)) with its directional
// albedo A, as KHR_materials_sheen does: reciprocal and never above 1; shown by MetallicRoughness.NeverGainsEnergy.
#include "albedo.h"
#include "material_util.h"

namespace tempera {
namespace {

constexpr float kSmoothAlpha =
    1e-3f;  ///< below it a lobe is a delta: no difference to see, and no float precision left

class MetallicRoughness final : public Material {
 public:
  explicit MetallicRoughness(const MetallicRoughnessParams& params) : p_(params) {
    // ior 0 means reflectance 1 at all angles (for converted specular-glossiness materials); it cannot bend light.
    f0_ = reflectance_at_normal(p_.ior);
    eta_ = p_.thin_walled || p_.ior == 0 ? 1 : p_.ior;  // 1: light passes straight on, as through a thin wall
    if (p_.attenuation_distance < kInfinity && !p_.thin_walled)
      for (int i = 0; i < 3; ++i)
        absorption_[i] = -std::log(std::clamp(p_.attenuation_color[i], 1e-6f, 1.0f)) / p_.attenuation_distance;
    transmits_ = !zero(p_.transmission);
    has_sheen_ = !zero(p_.sheen_color);
    has_coat_ = !zero(p_.clearcoat);
    has_anisotropy_ = !zero(p_.anisotropy);
  }

  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    if (!(weight > 0)) return;
    const float transmission = transmits_ ? std::clamp(p_.transmission.scalar(point), 0.0f, 1.0f) : 0;
    const bool volume = transmission > 0 && eta_ != 1;
    int frame = frame_of(point, bsdf);
    float cosine = cos_wo(point);
    // Opaque parts look the same from behind if they are double-sided. Only the surface of a volume has an inside.
    const bool inside = volume && cosine < 0;
    if (cosine < 0 && !volume) {
      if (!p_.double_sided && transmission == 0) return;
      frame = bsdf.add_flipped_frame(frame);
      cosine = -cosine;
    }
    if (cosine == 0) return;
    const float c = std::abs(cosine);

    Rgb base = p_.base_color.rgb(point);
    if (p_.use_vertex_color) base *= point.color;
    const float metallic = std::clamp(p_.metallic.scalar(point), 0.0f, 1.0f);
    const float alpha = sqr(std::clamp(p_.roughness.scalar(point), 0.0f, 1.0f));
    const float specular = p_.specular.scalar(point);
    const Rgb tinted = clamp(p_.specular_color.rgb(point) * f0_, 0, 1) * specular;

    SchlickFresnel fresnel;
    fresnel.f0 = lerp(tinted, base, metallic);
    fresnel.f90 = specular + metallic * (1 - specular);
    fresnel.transmittance = (volume && p_.tints_once ? sqrt(base) : base) * ((1 - metallic) * transmission);
    fresnel.loss0 = max_component(tinted);
    fresnel.loss90 = specular;
    fresnel.eta = volume ? eta_ : 1.0f;

    Parts parts(bsdf, weight);
    int layer = -1;
    if (!inside) {
      if (has_coat_) layer = add_coat(point, frame, layer, parts);
      if (has_sheen_) layer = add_sheen(point, frame, c, layer, parts);
    }
    const GgxAlbedo ggx = ggx_albedo(c, alpha);
    add_interface(point, frame, cosine, alpha, volume, fresnel, ggx, layer, parts);

    const Rgb diffuse = base * ((1 - metallic) * (1 - transmission));
    if (!inside && max_component(diffuse) > 0) {
      BsdfLayer top{BsdfLayer::Albedo::kGgx, std::uint8_t(frame), std::int8_t(layer)};
      top.f0 = fresnel.loss0, top.f90 = fresnel.loss90, top.alpha = alpha;
      DiffuseLobe lobe;
      lobe.reflectance = diffuse;
      parts.add(frame, lobe, luminance(diffuse) * (1 - ggx.of(top.f0, top.f90)) * parts.below,
                top.f90 > 0 ? bsdf.add_layer(top) : layer);
    }
    parts.finish();
  }

  Rgb absorption(const ShadingPoint&) const override { return absorption_; }
  bool has_absorption() const override { return transmits_ && !is_black(absorption_); }
  bool needs_tangents() const override { return has_anisotropy_ || p_.clearcoat_normal; }
  bool needs_footprint() const override {
    return p_.clearcoat_normal || p_.anisotropy_direction ||
           any_texture({&p_.base_color, &p_.metallic, &p_.roughness, &p_.transmission, &p_.specular, &p_.specular_color,
                        &p_.clearcoat, &p_.clearcoat_roughness, &p_.sheen_color, &p_.sheen_roughness, &p_.anisotropy});
  }
  int max_lobes() const override { return 5; }
  int max_frames() const override { return 5; }
  int max_layers() const override { return 3; }

 private:
  static bool zero(const Slot& slot) {
    return !slot.texture && slot.factor.is_constant() && is_black(slot.factor.at(0));
  }

  /// Adds lobes with their expected shares of the light, which become probabilities once all are known.
  struct Parts {
    Parts(Bsdf& target, float w) : bsdf(target), weight(w), first(target.size()) {}
    Bsdf& bsdf;
    float weight;
    int first;
    float below = 1;  ///< share of light that gets below the layers added so far
    float sum = 0;    ///< of the shares
    template <class L>
    void add(int frame, const L& lobe, float share, int layer) {
      share = std::max(share, 1e-3f);
      sum += share;
      bsdf.add(frame, lobe, share, weight, layer);
    }
    void finish() { bsdf.scale_probabilities(first, weight / sum); }
  };

  int add_coat(const ShadingPoint& point, int frame, int above, Parts& parts) const {
    const float strength = std::clamp(p_.clearcoat.scalar(point), 0.0f, 1.0f);
    if (strength <= 0) return above;
    Bsdf& bsdf = parts.bsdf;
    // The coat follows its own normal map over the interpolated normal, not the base's normal map.
    int coat_frame = unperturbed(frame, point, bsdf);
    if (p_.clearcoat_normal) {
      const Basis coat = bsdf.frame_basis(coat_frame);
      const Basis b = point.bends ? with_normal(coat, bsdf.unbent_normal(coat_frame)) : coat;
      const Rgb t = p_.clearcoat_normal->rgb(point);
      const float s = p_.clearcoat_normal_scale;
      const Vec3f mapped = normalize(b.to_world({s * (2 * t.r - 1), s * (2 * t.g - 1), 2 * t.b - 1}));
      const Vec3f n = point.bends ? bend_normal(mapped, ng_towards_viewer(point), point.wo) : mapped;
      if (dot(n, point.wo) > 0 && dot(n, b.n) > 0)
        coat_frame = bsdf.add_perturbed_frame(Basis::with_tangent(n, b.s), coat_frame, mapped);
    }
    const float c = dot(bsdf.frame_basis(coat_frame).n, point.wo);
    if (c <= 0) return above;
    const float alpha = sqr(std::clamp(p_.clearcoat_roughness.scalar(point), 0.0f, 1.0f));
    SchlickFresnel fresnel;  // index 1.5
    fresnel.f0 = Rgb(0.04f * strength);
    fresnel.f90 = strength;
    BsdfLayer layer{BsdfLayer::Albedo::kFresnel, std::uint8_t(coat_frame), std::int8_t(above)};
    layer.f0 = 0.04f * strength, layer.f90 = strength;
    const float share = layer.f0 + (layer.f90 - layer.f0) * schlick_weight(c);
    if (alpha < kSmoothAlpha)
      parts.add(coat_frame, MirrorLobe<SchlickFresnel>{fresnel}, share, above);
    else
      parts.add(coat_frame, MicrofacetReflectionLobe<SchlickFresnel>{{Microfacets::kGgx, alpha, alpha}, fresnel}, share,
                above);
    parts.below *= 1 - share;
    return bsdf.add_layer(layer);
  }

  int add_sheen(const ShadingPoint& point, int frame, float c, int above, Parts& parts) const {
    SheenLobe lobe;
    lobe.color = clamp(p_.sheen_color.rgb(point), 0, 1);
    lobe.alpha = std::max(sqr(std::clamp(p_.sheen_roughness.scalar(point), 0.0f, 1.0f)), kSmoothAlpha);
    if (is_black(lobe.color)) return above;
    BsdfLayer layer{BsdfLayer::Albedo::kSheen, std::uint8_t(frame), std::int8_t(above)};
    layer.f0 = max_component(lobe.color);
    layer.alpha = lobe.alpha;
    const float albedo = sheen_albedo(c, lobe.alpha);
    parts.add(frame, lobe, luminance(lobe.color) * albedo * parts.below, above);
    parts.below *= 1 - layer.f0 * albedo;
    return parts.bsdf.add_layer(layer);
  }

  /// GGX reflection of dielectric and metal, and transmission.
  void add_interface(const ShadingPoint& point, int frame, float cosine, float alpha, bool volume,
                     const SchlickFresnel& fresnel, const GgxAlbedo& ggx, int layer, Parts& parts) const {
    const bool smooth = alpha < kSmoothAlpha && !has_anisotropy_;
    const float reflected =
        smooth ? luminance(fresnel.reflect(cosine)) : luminance(fresnel.f0) * ggx.scale + fresnel.f90 * ggx.bias;
    const float transmitted = luminance(fresnel.transmit(cosine));
    const bool transmits = !is_black(fresnel.transmittance);
    float alpha_t = alpha;
    if (has_anisotropy_) {
      const float a = p_.anisotropy.scalar(point);
      alpha_t = alpha + a * a * (1 - alpha);
    }
    if (smooth) {
      parts.add(frame, MirrorLobe<SchlickFresnel>{fresnel, volume || transmits}, reflected * parts.below, layer);
      if (!transmits) return;
      if (volume)
        parts.add(frame, RefractionLobe<SchlickFresnel>{fresnel}, transmitted * parts.below, layer);
      else
        parts.add(frame, PassageLobe<SchlickFresnel>{fresnel}, transmitted * parts.below, layer);
      return;
    }
    const Microfacet facets(Microfacets::kGgx, alpha_t, alpha);
    if (has_anisotropy_) frame = rotated(frame, point, parts.bsdf);
    if (volume && transmits) {
      parts.add(frame, RoughInterfaceLobe<SchlickFresnel>{facets, fresnel}, (reflected + transmitted) * parts.below,
                layer);
      return;
    }
    if (cosine > 0)
      parts.add(frame, MicrofacetReflectionLobe<SchlickFresnel>{facets, fresnel}, reflected * parts.below, layer);
    if (transmits)
      parts.add(frame, RoughPassageLobe<SchlickFresnel>{facets, fresnel}, transmitted * parts.below, layer);
  }

  /// The frame of the interpolated normal on the side of `frame`.
  static int unperturbed(int frame, const ShadingPoint& point, Bsdf& bsdf) {
    const int root = bsdf.root_frame(frame);
    return dot(bsdf.frame_basis(root).n, point.wo) < 0 ? bsdf.add_flipped_frame(root) : root;
  }
  /// `frame` with its tangent along the direction of highest roughness: the texture's (or the tangent), turned
  /// counterclockwise.
  int rotated(int frame, const ShadingPoint& point, Bsdf& bsdf) const {
    Vec2f d{1, 0};
    if (p_.anisotropy_direction) {
      const Rgb t = p_.anisotropy_direction->rgb(point);
      const Vec2f v{2 * t.r - 1, 2 * t.g - 1};
      if (length(v) > 1e-3f) d = v / length(v);
    }
    const float c = std::cos(p_.anisotropy_rotation), s = std::sin(p_.anisotropy_rotation);
    d = {c * d.x - s * d.y, s * d.x + c * d.y};
    return d == Vec2f{1, 0} ? frame : bsdf.add_rotated_frame(frame, d);
  }

  MetallicRoughnessParams p_;
  float f0_, eta_;
  Rgb absorption_;
  bool transmits_, has_sheen_, has_coat_, has_anisotropy_;
};

}  // namespace

MaterialPtr make_metallic_roughness(const MetallicRoughnessParams& params) {
  if (!(params.ior == 0 || params.ior >= 1) || !std::isfinite(params.ior))
    throw Error(ErrorCode::kOutOfRange, "metallic-roughness material: ior must be 0 or at least 1");
  if (!(params.attenuation_distance > 0))
    throw Error(ErrorCode::kOutOfRange, "metallic-roughness material: attenuation distance must be positive");
  return std::make_shared<MetallicRoughness>(params);
}

namespace {
MaterialPtr metallic_roughness_from(const MaterialValues& v) {
  MetallicRoughnessParams p;
  p.base_color = v.color_slot("base_color");
  p.metallic = v.scalar_slot("metallic");
  p.roughness = v.scalar_slot("roughness");
  p.transmission = v.scalar_slot("transmission");
  p.specular = v.scalar_slot("specular");
  p.specular_color = v.color_slot("specular_color");
  p.ior = float(v.params().get_double("ior"));
  p.clearcoat = v.scalar_slot("clearcoat");
  p.clearcoat_roughness = v.scalar_slot("clearcoat_roughness");
  p.sheen_color = v.color_slot("sheen_color");
  p.sheen_roughness = v.scalar_slot("sheen_roughness");
  p.thin_walled = v.params().get_bool("thin_walled");
  p.attenuation_color = v.color("attenuation_color");
  const double distance = v.params().get_double("attenuation_distance");
  p.attenuation_distance = distance > 0 ? float(distance) : kInfinity;
  p.tints_once = v.params().get_string("solid_tint") == "once";
  p.double_sided = v.two_sided().value_or(true);
  return make_metallic_roughness(p);
}
}  // namespace

extern const MaterialEntry metallic_roughness_material;
const MaterialEntry metallic_roughness_material{
    "metallic_roughness",
    "glTF's material",
    {{"base_color", "1", "color or image"},
     {"metallic", "1", "in [0,1], or an image"},
     {"roughness", "1", "perceptual roughness in [0,1], or an image"},
     {"transmission", "0", "in [0,1], or an image"},
     {"specular", "1", "in [0,1], or an image"},
     {"specular_color", "1", "color or image"},
     {"ior", 1.5, "index of refraction", 1, 5},
     {"clearcoat", "0", "in [0,1], or an image"},
     {"clearcoat_roughness", "0", "in [0,1], or an image"},
     {"sheen_color", "0", "color or image"},
     {"sheen_roughness", "0", "in [0,1], or an image"},
     {"thin_walled", true, "false: a solid body that refracts"},
     {"solid_tint",
      "twice",
      "solid bodies: whether base_color tints light as it enters and again as it leaves, or once in all",
      -1e300,
      1e300,
      {"twice", "once"}},
     {"attenuation_color", "1", "color of white light after `attenuation_distance` inside"},
     {"attenuation_distance", 0.0, "meters; 0: no attenuation", 0, 1e9}},
    metallic_roughness_from};

}  // namespace tempera
