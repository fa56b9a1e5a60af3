// SPDX-License-Identifier: Apache-2.0
#pragma once
// Materials: what a user names in a scene file. Once per hit a material adds its lobes to a Bsdf; nothing of it is
// called per sample after that. Factories take parameter structs whose defaults are Mitsuba's or glTF's.
#include <memory>
#include <string>

#include "tempera/shading/bsdf.h"
#include "tempera/shading/texture.h"

namespace tempera {

/// Threads: const and re-entrant.
class Material {
 public:
  virtual ~Material() = default;
  /// Adds the lobes at `point`, each scaled by `weight` in [0,1].
  virtual void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const = 0;
  /// Fraction of light that does not pass straight through, in [0,1].
  virtual float opacity(const ShadingPoint&) const { return 1; }
  /// Whether `opacity` can be below 1: rays then ask at each hit.
  virtual bool has_opacity() const { return false; }
  /// Absorption coefficient (1/m) of the inside, i.e. of the side that the geometric normal points away from.
  virtual Rgb absorption(const ShadingPoint&) const { return Rgb(0.0f); }
  virtual bool has_absorption() const { return false; }
  /// Whether `add_lobes` or `opacity` depends on the direction of ShadingPoint::frame.s or on dpdu and dpdv, which cost
  /// as much as the rest of a hit. When in doubt, yes.
  virtual bool needs_tangents() const { return true; }
  /// Whether it looks at ShadingPoint::duv_dx and duv_dy, i.e. has textures that could be filtered.
  virtual bool needs_footprint() const { return true; }
  /// The most lobes, frames and layers that `add_lobes` can add: combining materials checks it against Bsdf's capacity.
  virtual int max_lobes() const { return 1; }
  virtual int max_frames() const { return 1; }
  virtual int max_layers() const { return 0; }
};
using MaterialPtr = std::shared_ptr<const Material>;

/// The same as make_bsdf for a point whose normals are to be bent.
void make_bent_bsdf(const Material& material, const ShadingPoint& point, Bsdf& bsdf);
/// Fills `bsdf` with the lobes of `material` at `point` as an eye path sees them: where ShadingPoint::bends says so,
/// with normals bent for the viewer `point.wo` (bend_normal) after bump and normal mapping, and light that fades out at
/// the horizon. A light path, or one that shall be followed backwards, leaves `bends` false.
inline void make_bsdf(const Material& material, const ShadingPoint& point, Bsdf& bsdf) {
  bsdf.clear();
  if (point.bends)
    make_bent_bsdf(material, point, bsdf);
  else
    material.add_lobes(point, 1, bsdf);
}

/// Roughness of a microfacet surface; smooth (delta) when `rough` is false. alpha is clamped to at least 1e-4.
struct Roughness {
  bool rough = false;
  Microfacets distribution = Microfacets::kBeckmann;  ///< Mitsuba's default
  Slot alpha_u{0.1f}, alpha_v{0.1f};
  bool sample_visible = true;
};

/// Lambertian reflector, reflectance in [0,1]; black from behind.
MaterialPtr make_diffuse(Slot reflectance = 0.5f);

struct ConductorParams {
  Slot eta{Rgb(0.0f)}, k{Rgb(1.0f)};  ///< complex index relative to the outside; eta 0 and k 1 is a perfect mirror
  Slot specular_reflectance{1.0f};
  Roughness roughness;
};
MaterialPtr make_conductor(const ConductorParams& params);

struct DielectricParams {
  float int_ior = 1.5046f, ext_ior = 1.000277f;
  Slot specular_reflectance{1.0f}, specular_transmittance{1.0f};
  bool thin = false;  ///< two interfaces with no refraction between them; smooth only
  Roughness roughness;
};
/// Smooth, thin or rough interface between two dielectrics [Walter 2007].
MaterialPtr make_dielectric(const DielectricParams& params);

struct PlasticParams {
  float int_ior = 1.49f, ext_ior = 1.000277f;
  Slot diffuse_reflectance{0.5f}, specular_reflectance{1.0f};
  bool nonlinear = false;  ///< color shifts of internal scattering
  Roughness roughness;
};
/// Diffuse base under a dielectric coat with internal scattering, as Mitsuba's `plastic` and `roughplastic`.
MaterialPtr make_plastic(const PlasticParams& params);

/// Mitsuba's `principled` (after Burley 2012, 2015). All scalars in [0,1] unless noted.
struct PrincipledParams {
  Slot base_color{0.5f}, roughness{0.5f}, anisotropic{0.0f}, metallic{0.0f}, spec_trans{0.0f};
  Slot spec_tint{0.0f}, sheen{0.0f}, sheen_tint{0.0f}, flatness{0.0f}, clearcoat{0.0f}, clearcoat_gloss{0.0f};
  float eta = 1.5f;  ///< interior over exterior index
};
MaterialPtr make_principled(const PrincipledParams& params);

/// glTF 2.0 metallic-roughness with KHR_materials_{transmission, volume, ior, specular, clearcoat, sheen, anisotropy,
/// unlit via emission}. Factors are folded into the slots (glTF multiplies factor and texture).
struct MetallicRoughnessParams {
  Slot base_color{1.0f};
  Slot metallic{1.0f}, roughness{1.0f};  ///< roughness is perceptual: alpha = roughness^2
  Slot transmission{0.0f};
  Slot specular{1.0f}, specular_color{1.0f};  ///< KHR_materials_specular
  float ior = 1.5f;
  Slot clearcoat{0.0f}, clearcoat_roughness{0.0f};
  std::shared_ptr<const Texture> clearcoat_normal;  ///< tangent space, values in [0,1]
  float clearcoat_normal_scale = 1;
  Slot sheen_color{0.0f}, sheen_roughness{0.0f};
  Slot anisotropy{0.0f};
  float anisotropy_rotation = 0;                        ///< radians
  std::shared_ptr<const Texture> anisotropy_direction;  ///< red, green in [0,1]: direction in [-1,1] along s, t
  bool thin_walled = true;                              ///< no KHR_materials_volume, or thickness 0
  Rgb attenuation_color{1.0f};
  float attenuation_distance = kInfinity;  ///< metres
  bool double_sided = true;                ///< false: black from behind unless it transmits
  /// How the base color tints what passes through a solid. false: at each crossing of its surface, as glTF says
  /// [KHR_materials_volume, "Base Color and Absorption"]. true: once in all, by its square root at each crossing, as
  /// Cycles does.
  bool tints_once = false;
  bool use_vertex_color = false;
};
MaterialPtr make_metallic_roughness(const MetallicRoughnessParams& params);

/// Applies `front` (and `back`, or `front` again) to the side that is seen. Opaque materials only.
MaterialPtr make_two_sided(MaterialPtr front, MaterialPtr back = nullptr);
/// (1 - weight) a + weight b.
MaterialPtr make_blend(Slot weight, MaterialPtr a, MaterialPtr b);
MaterialPtr make_mask(Slot opacity, MaterialPtr nested);
/// Displacement `height` (world units after `scale`) tilts the shading frame; as Mitsuba's `bumpmap`.
MaterialPtr make_bump(std::shared_ptr<const Texture> height, float scale, MaterialPtr nested);
/// Tangent-space normal map; `scale` multiplies x and y (glTF's normalTexture.scale).
MaterialPtr make_normal_map(std::shared_ptr<const Texture> normal, float scale, MaterialPtr nested);
/// Scatters nothing (a surface that only emits or only bounds a medium when masked).
MaterialPtr make_black();

}  // namespace tempera
