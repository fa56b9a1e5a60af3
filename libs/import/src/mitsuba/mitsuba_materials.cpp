// SPDX-License-Identifier: Apache-2.0
// Mitsuba's BSDF plugins as our materials. Plugins that we lack become the closest material that we have, with a
// warning.
#include <fmt/format.h>

#include <cmath>

#include "mitsuba_build.h"
#include "tempera/shading/material_catalog.h"
#include "tempera/shading/spectrum.h"

namespace tempera::mitsuba {
namespace {

constexpr Named<Microfacets> kDistributions[] = {{"beckmann", Microfacets::kBeckmann},
                                                 {"ggx", Microfacets::kGgx},
                                                 {"phong", Microfacets::kBeckmann},
                                                 {"as", Microfacets::kBeckmann},
                                                 {"trowbridge-reitz", Microfacets::kGgx}};

}  // namespace

float Builder::index_of_refraction(const Object& bsdf, std::string_view name, std::string_view fallback) const {
  const Property* p = find(bsdf, name);
  if (p && !std::holds_alternative<std::string>(p->value)) return float(number(bsdf, name, 1, 1e-3, 100));
  const std::string material = text(bsdf, name, fallback);
  if (const std::optional<float> ior = named_ior(material)) return *ior;
  fail(ErrorCode::kUnknownName, place(bsdf, name),
       fmt::format("\"{}\" is no material with a known index of refraction; known: {}", material,
                   nearest_names(material, named_iors())));
}

Roughness Builder::roughness(const Object& bsdf) {
  Roughness r;
  r.rough = true;
  const Named<Microfacets>& distribution = choice(bsdf, "distribution", "beckmann", kDistributions);
  if (distribution.value == Microfacets::kBeckmann && distribution.name != "beckmann")
    warn(fmt::format("microfacet distribution \"{}\" is treated as beckmann", distribution.name),
         place(bsdf, "distribution"));
  r.distribution = distribution.value;
  r.sample_visible = boolean(bsdf, "sample_visible", true);
  if (has(bsdf, "alpha_u") != has(bsdf, "alpha_v"))
    fail(ErrorCode::kBadInput, bsdf.place,
         fmt::format("{} needs both \"alpha_u\" and \"alpha_v\", or \"alpha\" alone", bsdf.name()));
  const Slot alpha = slot(bsdf, "alpha", 0.1f, SpectrumKind::kScalar);
  r.alpha_u = slot(bsdf, "alpha_u", alpha, SpectrumKind::kScalar);
  r.alpha_v = slot(bsdf, "alpha_v", alpha, SpectrumKind::kScalar);
  return r;
}

void Builder::conductor_indices(const Object& bsdf, Slot& eta, Slot& k) {
  const std::string material = text(bsdf, "material", "none");
  eta = Rgb(0.0f);
  k = Rgb(1.0f);
  if (material != "none" && !has(bsdf, "eta")) {
    const std::optional<ConductorIndices> indices = named_conductor(material);
    if (!indices)
      fail(ErrorCode::kUnknownName, place(bsdf, "material"),
           fmt::format("\"{}\" is no known conductor; known: none, {}", material,
                       nearest_names(material, named_conductors(), 40)));
    eta = indices->eta;
    k = indices->k;
  }
  eta = slot(bsdf, "eta", eta, SpectrumKind::kUnbounded);
  k = slot(bsdf, "k", k, SpectrumKind::kUnbounded);
  if (has(bsdf, "ext_eta")) {  // 0.6: the index of what lies around
    const float outside = index_of_refraction(bsdf, "ext_eta", "air");
    eta.factor = eta.factor.at(0) / outside;
    k.factor = k.factor.at(0) / outside;
  }
}

MaterialPtr Builder::nested_material(const Object& bsdf) {
  const Object* nested = child(bsdf, "bsdf");
  if (!nested) fail(ErrorCode::kBadInput, bsdf.place, fmt::format("{} needs a nested bsdf", bsdf.name()));
  return material(*nested);
}

MaterialPtr Builder::material(const Object& bsdf) {
  if (const auto known = materials_.find(&bsdf); known != materials_.end()) return known->second;
  if (!in_construction_.insert(&bsdf).second)
    fail(ErrorCode::kBadInput, bsdf.place, fmt::format("{} refers to itself", bsdf.name()));
  MaterialPtr result;
  try {
    result = make_material(bsdf);
  } catch (const Error& e) {
    if (!e.loc().file.empty()) throw;
    throw Error(e.code(), document_.loc(bsdf.place), e.message());  // materials know no places
  }
  in_construction_.erase(&bsdf);
  finish(bsdf);
  materials_[&bsdf] = result;
  return result;
}

MaterialPtr Builder::diffuse_bsdf(const Object& bsdf) {
  if (bsdf.plugin == "roughdiffuse") {
    warn_replaced(bsdf, "diffuse");
    ignore(bsdf, {"alpha", "use_fast_approx"});
  }
  return make_diffuse(slot(bsdf, has(bsdf, "reflectance") ? "reflectance" : "diffuse_reflectance", 0.5f));
}

MaterialPtr Builder::conductor_bsdf(const Object& bsdf) {
  ConductorParams params;
  conductor_indices(bsdf, params.eta, params.k);
  params.specular_reflectance = slot(bsdf, "specular_reflectance", 1.0f);
  if (bsdf.plugin == "roughconductor") params.roughness = roughness(bsdf);
  return make_conductor(params);
}

MaterialPtr Builder::dielectric_bsdf(const Object& bsdf) {
  DielectricParams params;
  params.int_ior = index_of_refraction(bsdf, "int_ior", "bk7");
  params.ext_ior = index_of_refraction(bsdf, "ext_ior", "air");
  params.specular_reflectance = slot(bsdf, "specular_reflectance", 1.0f);
  params.specular_transmittance = slot(bsdf, "specular_transmittance", 1.0f);
  params.thin = bsdf.plugin == "thindielectric";
  if (bsdf.plugin == "roughdielectric") params.roughness = roughness(bsdf);
  return make_dielectric(params);
}

MaterialPtr Builder::plastic_bsdf(const Object& bsdf) {
  if (bsdf.plugin == "pplastic") warn_replaced(bsdf, "roughplastic");
  PlasticParams params;
  params.int_ior = index_of_refraction(bsdf, "int_ior", "polypropylene");
  params.ext_ior = index_of_refraction(bsdf, "ext_ior", "air");
  params.diffuse_reflectance = slot(bsdf, "diffuse_reflectance", 0.5f);
  params.specular_reflectance = slot(bsdf, "specular_reflectance", 1.0f);
  params.nonlinear = boolean(bsdf, "nonlinear", false);
  if (bsdf.plugin != "plastic") params.roughness = roughness(bsdf);
  return make_plastic(params);
}

MaterialPtr Builder::principled_bsdf(const Object& bsdf) {
  PrincipledParams params;
  const auto scalar = [&](std::string_view name, float fallback) {
    return slot(bsdf, name, fallback, SpectrumKind::kScalar);
  };
  params.base_color = slot(bsdf, "base_color", 0.5f);
  params.roughness = scalar("roughness", 0.5f);
  params.anisotropic = scalar("anisotropic", 0);
  params.metallic = scalar("metallic", 0);
  params.spec_trans = scalar("spec_trans", 0);
  params.spec_tint = scalar("spec_tint", 0);
  params.sheen = scalar("sheen", 0);
  params.sheen_tint = scalar("sheen_tint", 0);
  params.flatness = scalar("flatness", 0);
  params.clearcoat = scalar("clearcoat", 0);
  params.clearcoat_gloss = scalar("clearcoat_gloss", 0);
  if (has(bsdf, "eta") && has(bsdf, "specular"))
    fail(ErrorCode::kBadInput, place(bsdf, "specular"), "\"eta\" and \"specular\" exclude each other");
  if (has(bsdf, "eta")) {
    params.eta = index_of_refraction(bsdf, "eta", "");
    if (params.eta == 1) params.eta = 1.001f;  // no interface at all would not transmit either
  } else {
    params.eta = 2 / (1 - std::sqrt(0.08f * float(number(bsdf, "specular", 0.5, 0, 1)))) - 1;
  }
  // These steer Mitsuba's sampling, not its result.
  ignore(bsdf, {"main_specular_sampling_rate", "clearcoat_sampling_rate", "diffuse_reflectance_sampling_rate"});
  if (bsdf.plugin == "principled") return make_principled(params);
  ignore(bsdf, {"diff_trans", "spec_trans"});
  warn_replaced(bsdf, "an opaque principled");
  params.spec_trans = 0.0f;
  return make_two_sided(make_principled(params));
}

MaterialPtr Builder::two_sided_bsdf(const Object& bsdf) {
  const std::vector<const Object*> nested = children(bsdf, "bsdf");
  if (nested.empty() || nested.size() > 2)
    fail(ErrorCode::kBadInput, bsdf.place, "twosided needs one nested bsdf, or one for each side");
  ignore(bsdf, {"allow_transmission"});
  return make_two_sided(material(*nested.front()), nested.size() == 2 ? material(*nested.back()) : nullptr);
}

MaterialPtr Builder::blend_bsdf(const Object& bsdf) {
  const std::vector<const Object*> nested = children(bsdf, "bsdf");
  if (nested.size() != 2) fail(ErrorCode::kBadInput, bsdf.place, "blendbsdf needs two nested bsdfs");
  if (!has(bsdf, "weight")) fail(ErrorCode::kBadInput, bsdf.place, "blendbsdf needs a \"weight\" between 0 and 1");
  return make_blend(slot(bsdf, "weight", 0.5f, SpectrumKind::kScalar), material(*nested[0]), material(*nested[1]));
}

MaterialPtr Builder::mixture_bsdf(const Object& bsdf) {
  const std::vector<const Object*> nested = children(bsdf, "bsdf");
  std::vector<double> weights;
  if (!parse_numbers(text(bsdf, "weights", ""), weights) || weights.size() != nested.size() || nested.empty())
    fail(ErrorCode::kBadInput, place(bsdf, "weights"),
         fmt::format("mixturebsdf needs as many \"weights\" as nested bsdfs, which are {}", nested.size()));
  MaterialPtr mix;
  double sum = 0;
  for (std::size_t i = 0; i < nested.size(); ++i) {
    if (weights[i] < 0) fail(ErrorCode::kOutOfRange, place(bsdf, "weights"), "weights must not be negative");
    if (weights[i] == 0) continue;
    sum += weights[i];
    const MaterialPtr next = material(*nested[i]);
    mix = mix ? make_blend(float(weights[i] / sum), mix, next) : next;
  }
  if (!mix) return make_black();
  if (sum > 1 + 1e-6) warn("weights of a mixturebsdf beyond 1 in sum are scaled down", place(bsdf, "weights"));
  return sum < 1 - 1e-6 ? make_blend(float(1 - sum), mix, make_black()) : mix;
}

MaterialPtr Builder::mask_bsdf(const Object& bsdf) {
  return make_mask(slot(bsdf, "opacity", 0.5f, SpectrumKind::kScalar), nested_material(bsdf));
}

MaterialPtr Builder::null_bsdf(const Object&) { return make_mask(0.0f, make_black()); }

MaterialPtr Builder::bump_bsdf(const Object& bsdf) {
  const Object* map = nullptr;
  for (const Object* t : children(bsdf, "texture")) {
    if (map) fail(ErrorCode::kBadInput, t->place, fmt::format("{} takes one texture only", bsdf.name()));
    map = t;
  }
  if (!map) fail(ErrorCode::kBadInput, bsdf.place, fmt::format("{} needs a nested texture", bsdf.name()));
  ignore(bsdf, {"flip_invalid_normals", "use_shadowing_function"});
  const bool is_bump = bsdf.plugin != "normalmap";
  const Slot s = texture_slot(*map, is_bump ? SpectrumKind::kHeight : SpectrumKind::kUnbounded);
  const double scale = number(bsdf, "scale", 1) * s.factor.at(0).r;
  const MaterialPtr nested = nested_material(bsdf);
  if (!s.texture) return nested;  // a constant height or normal
  return is_bump ? make_bump(s.texture, float(scale), nested) : make_normal_map(s.texture, 1, nested);
}

// --- without a counterpart ---

MaterialPtr Builder::coating_bsdf(const Object& bsdf) {
  const Object* nested = child(bsdf, "bsdf");
  if (!nested) fail(ErrorCode::kBadInput, bsdf.place, fmt::format("{} needs a nested bsdf", bsdf.name()));
  if (nested->plugin != "diffuse") {
    warn_replaced(bsdf, "what it coats");
    ignore_all(bsdf);
    return material(*nested);
  }
  warn_replaced(bsdf, bsdf.plugin == "coating" ? "plastic" : "roughplastic");  // a coated diffuse surface is just that
  PlasticParams params;
  params.int_ior = index_of_refraction(bsdf, "int_ior", "bk7");
  params.ext_ior = index_of_refraction(bsdf, "ext_ior", "air");
  params.diffuse_reflectance = slot(*nested, has(*nested, "reflectance") ? "reflectance" : "diffuse_reflectance", 0.5f);
  params.specular_reflectance = slot(bsdf, "specular_reflectance", 1.0f);
  params.nonlinear = true;
  if (bsdf.plugin == "roughcoating") params.roughness = roughness(bsdf);
  return make_plastic(params);
}

MaterialPtr Builder::phong_bsdf(const Object& bsdf) {
  warn_replaced(bsdf, "a blend of diffuse and rough mirror");
  const Slot diffuse = slot(bsdf, "diffuse_reflectance", 0.5f);
  const Slot specular = slot(bsdf, "specular_reflectance", 0.2f);
  ConductorParams params;
  params.roughness.rough = true;
  if (bsdf.plugin == "phong") {
    const double exponent = number(bsdf, "exponent", 30, 0);
    params.roughness.alpha_u = params.roughness.alpha_v = float(std::min(1.0, std::sqrt(2 / (exponent + 2))));
  } else {
    params.roughness.alpha_u = slot(bsdf, "alpha_u", 0.1f, SpectrumKind::kScalar);
    params.roughness.alpha_v = slot(bsdf, "alpha_v", 0.1f, SpectrumKind::kScalar);
    ignore(bsdf, {"variant"});
  }
  // The blend's weights scale its parts: dividing by them keeps the sum of both reflectances.
  const float d = mean(diffuse.mean()), s = mean(specular.mean());
  if (d + s == 0) return make_black();
  const float weight = s / (d + s);
  const auto scaled = [](Slot slot, float factor) { return Slot(slot.factor.at(0) * factor, slot.texture); };
  if (s > 0) params.specular_reflectance = scaled(specular, 1 / weight);
  return make_blend(weight, make_diffuse(d > 0 ? scaled(diffuse, 1 / (1 - weight)) : diffuse), make_conductor(params));
}

MaterialPtr Builder::diffuse_transmitter_bsdf(const Object& bsdf) {
  warn_replaced(bsdf, "diffuse on both sides");
  return make_two_sided(make_diffuse(slot(bsdf, "transmittance", 0.5f)));
}

MaterialPtr Builder::make_material(const Object& bsdf) {
  static constexpr Named<MaterialPtr (Builder::*)(const Object&)> kPlugins[] = {
      {"diffuse", &Builder::diffuse_bsdf},
      {"roughdiffuse", &Builder::diffuse_bsdf},
      {"conductor", &Builder::conductor_bsdf},
      {"roughconductor", &Builder::conductor_bsdf},
      {"dielectric", &Builder::dielectric_bsdf},
      {"roughdielectric", &Builder::dielectric_bsdf},
      {"thindielectric", &Builder::dielectric_bsdf},
      {"plastic", &Builder::plastic_bsdf},
      {"roughplastic", &Builder::plastic_bsdf},
      {"pplastic", &Builder::plastic_bsdf},
      {"principled", &Builder::principled_bsdf},
      {"principledthin", &Builder::principled_bsdf},
      {"twosided", &Builder::two_sided_bsdf},
      {"blendbsdf", &Builder::blend_bsdf},
      {"mixturebsdf", &Builder::mixture_bsdf},
      {"mask", &Builder::mask_bsdf},
      {"null", &Builder::null_bsdf},
      {"bumpmap", &Builder::bump_bsdf},
      {"normalmap", &Builder::bump_bsdf},
      {"bump", &Builder::bump_bsdf},
      {"coating", &Builder::coating_bsdf},
      {"roughcoating", &Builder::coating_bsdf},
      {"phong", &Builder::phong_bsdf},
      {"ward", &Builder::phong_bsdf},
      {"difftrans", &Builder::diffuse_transmitter_bsdf},
  };
  if (const auto* plugin = find_named(kPlugins, bsdf.plugin)) return (this->*plugin->value)(bsdf);
  if (const MaterialEntry* ours = find_material(bsdf.plugin)) return catalog_material(bsdf, *ours);
  warn_replaced(bsdf, "diffuse");
  ignore_all(bsdf);  // one message is enough
  return make_diffuse();
}

MaterialPtr Builder::catalog_material(const Object& bsdf, const MaterialEntry& entry) {
  struct Values final : MaterialValues {
    Values(Builder& b, const Object& o, const MaterialEntry& e) : builder(b), object(o), others(e.params) {
      for (const ParamSpec& s : e.params) {
        if (const bool* on = std::get_if<bool>(&s.fallback)) others.set(s.name, b.boolean(o, s.name, *on));
        if (const int* n = std::get_if<int>(&s.fallback))
          others.set(s.name, b.integer(o, s.name, *n, int(s.min), int(s.max)));
        if (const double* x = std::get_if<double>(&s.fallback))
          others.set(s.name, b.number(o, s.name, *x, s.min, s.max));
        if (s.choices.empty()) continue;
        const std::string value = b.text(o, s.name, std::get<std::string>(s.fallback));
        if (std::find(s.choices.begin(), s.choices.end(), value) == s.choices.end()) {
          b.fail(ErrorCode::kUnknownName, b.place(o, s.name),
                 fmt::format("\"{}\" is no value of \"{}\"; known: {}", value, s.name, fmt::join(s.choices, ", ")));
        }
        others.set(s.name, value);
      }
    }
    Rgb fallback(const std::string& name) const { return parse_color(others.get_string(name)).value_or(Rgb(0.0f)); }
    Slot color_slot(const std::string& name) const override { return builder.slot(object, name, fallback(name)); }
    Slot scalar_slot(const std::string& name) const override {
      return builder.slot(object, name, fallback(name), SpectrumKind::kScalar);
    }
    Rgb color(const std::string& name) const override {
      return builder.constant(object, name, fallback(name), SpectrumKind::kReflectance);
    }
    const Params& params() const override { return others; }
    SourceLoc loc(const std::string& name) const override { return builder.document_.loc(builder.place(object, name)); }
    Builder& builder;
    const Object& object;
    Params others;  // all but colors and images
  };
  return entry.make(Values(*this, bsdf, entry));
}

Builder::NamedMaterial Builder::shape_material(const Object& shape, bool emits) {
  const std::vector<const Object*> bsdfs = children(shape, "bsdf");
  if (bsdfs.size() > 1) warn("a shape with several bsdfs gets the first one throughout", shape.place);
  const Object* bsdf = bsdfs.empty() ? nullptr : bsdfs.front();
  if (!bsdf) return {make_diffuse(emits ? 0.0f : 0.5f), ""};
  std::string name = bsdf->id;
  for (const Object* inner = bsdf; name.empty();) {  // ids inside wrappers name the material as well
    const Object* next = nullptr;
    for (const Property& p : inner->properties) {
      if (!std::holds_alternative<ObjectPtr>(p.value)) continue;
      const Object& nested = document_.resolve(p);
      if (nested.tag == "bsdf" && !next) next = &nested;
    }
    if (!next) break;
    inner = next;
    name = inner->id;
  }
  return {material(*bsdf), name};
}

}  // namespace tempera::mitsuba
