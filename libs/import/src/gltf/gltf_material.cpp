// SPDX-License-Identifier: Apache-2.0
#include "gltf_material.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tempera {
namespace {

using TexturePtr = std::shared_ptr<const Texture>;

/// Alpha of a surface: factor and texture times the vertex alpha, cut to 0 or 1 in glTF's MASK mode.
class Coverage final : public Texture {
 public:
  Coverage(Slot alpha, bool vertex_alpha, std::optional<Animated<float>> cutoff)
      : alpha_(std::move(alpha)), vertex_alpha_(vertex_alpha), cutoff_(std::move(cutoff)) {}
  Rgb rgb(const ShadingPoint& point) const override { return Rgb(scalar(point)); }
  float scalar(const ShadingPoint& point) const override {
    const float a = alpha_.scalar(point) * (vertex_alpha_ ? point.color_alpha : 1.0f);
    if (cutoff_) return a >= cutoff_->at(point.time) ? 1.0f : 0.0f;
    return std::clamp(a, 0.0f, 1.0f);
  }
  Rgb mean() const override { return clamp(Rgb(alpha_.mean().r), 0.0f, 1.0f); }

 private:
  Slot alpha_;
  bool vertex_alpha_;
  std::optional<Animated<float>> cutoff_;
};

/// KHR_texture_transform: scale, then rotate, then shift. Rotation is counterclockwise as seen on a picture whose v
/// points down (the matrix in the extension's text has the other sign than its pictures and all viewers).
UvTransform uv_transform(const Vec2f& offset, float rotation, const Vec2f& scale) {
  const float c = std::cos(rotation), s = std::sin(rotation);
  return {c * scale.x, s * scale.y, offset.x, -s * scale.x, c * scale.y, offset.y};
}

/// A texture seen through a moving KHR_texture_transform.
class MovingUv final : public Texture {
 public:
  MovingUv(TexturePtr texture, int uv_set, Animated<Vec3f> offset, Animated<float> rotation, Animated<Vec3f> scale)
      : texture_(std::move(texture)),
        uv_set_(uv_set),
        offset_(std::move(offset)),
        rotation_(std::move(rotation)),
        scale_(std::move(scale)) {}
  Rgb rgb(const ShadingPoint& point) const override { return texture_->rgb(moved(point)); }
  float scalar(const ShadingPoint& point) const override { return texture_->scalar(moved(point)); }
  Rgb mean() const override { return texture_->mean(); }

 private:
  ShadingPoint moved(const ShadingPoint& point) const {
    const Vec3f offset = offset_.at(point.time), scale = scale_.at(point.time);
    UvTransform map = uv_transform({offset.x, offset.y}, rotation_.at(point.time), {scale.x, scale.y});
    ShadingPoint result = point;
    Vec2f& uv = uv_set_ == 0 ? result.uv : result.uv1;
    uv = map(uv);
    map.c = map.f = 0;
    result.duv_dx = map(point.duv_dx);
    result.duv_dy = map(point.duv_dy);
    return result;
  }
  TexturePtr texture_;
  int uv_set_;
  Animated<Vec3f> offset_;
  Animated<float> rotation_;
  Animated<Vec3f> scale_;
};

bool can_be_positive(const Animated<Rgb>& factor) {
  return std::any_of(factor.values().begin(), factor.values().end(), [](const Rgb& v) { return max_component(v) > 0; });
}

bool is_constant(const Slot& slot, const Rgb& value) { return slot.is_constant() && slot.factor.values()[0] == value; }

Wrap wrap_mode(const Json& json) {
  switch (json.integer(10497)) {
    case 10497:
      return Wrap::kRepeat;
    case 33071:
      return Wrap::kClamp;
    case 33648:
      return Wrap::kMirror;
  }
  json.fail(fmt::format("{} is no wrap mode; valid: 10497 (repeat), 33071 (clamp), 33648 (mirror)", json.integer(0)));
}

TextureFilter filter_mode(const Json& sampler) {
  const Json mag = sampler["magFilter"], min = sampler["minFilter"];
  const std::uint64_t large = mag.integer(9729), small = min.integer(9987);
  if (large != 9728 && large != 9729) mag.fail(fmt::format("{} is no magFilter; valid: 9728, 9729", large));
  if (small != 9728 && small != 9729 && !(small >= 9984 && small <= 9987))
    min.fail(fmt::format("{} is no minFilter; valid: 9728, 9729, 9984 to 9987", small));
  if (large == 9728) return TextureFilter::kNearest;
  return small == 9728 || small == 9729 ? TextureFilter::kBilinear : TextureFilter::kMipmap;
}

}  // namespace

const GltfMaterial& GltfMaterials::get(int index, bool vertex_colors) {
  const auto key = std::pair(index, vertex_colors);
  auto it = made_.find(key);
  if (it == made_.end()) it = made_.emplace(key, make(index, vertex_colors)).first;
  return it->second;
}

double GltfMaterials::limited(const Json& json, double fallback, double min, double max) {
  const double v = json.number(fallback);
  if (v >= min && v <= max) return v;
  document_.warn(fmt::format("material values outside [{}, {}] are clamped", min, max), json);
  return std::clamp(v, min, max);
}

Animated<Rgb> GltfMaterials::factor(const Json& json, const std::string& pointer, std::string_view name,
                                    std::size_t components, Rgb fallback, double max) {
  if (const Track* track = animations_.find(fmt::format("{}/{}", pointer, name), components)) {
    return map_linear<Rgb>(*track, [&](const float* v) { return components == 1 ? Rgb(v[0]) : Rgb(v[0], v[1], v[2]); });
  }
  const Json value = json[name];
  if (!value) return fallback;
  if (components == 1) return Rgb(float(limited(value, fallback.r, 0, max)));
  if (value.array().size() != components)
    value.fail(fmt::format("has {} elements instead of {}", value.size(), components));
  return Rgb(float(limited(value.at(0), 0, 0, max)), float(limited(value.at(1), 0, 0, max)),
             float(limited(value.at(2), 0, 0, max)));
}

Slot GltfMaterials::slot(const Json& json, const std::string& pointer, std::string_view factor_name, Rgb fallback,
                         std::size_t components, std::string_view texture_name, Channel channel,
                         ColorEncoding encoding) {
  return {factor(json, pointer, factor_name, components, fallback, 1.0),
          texture(json[texture_name], fmt::format("{}/{}", pointer, texture_name), channel, encoding)};
}

GltfMaterial GltfMaterials::make(int index, bool vertex_colors) {
  GltfMaterial made;
  const Json json = index < 0 ? Json() : document_.list("materials").at(index).object();
  const std::string pointer = fmt::format("/materials/{}", index);
  const Json extensions = json["extensions"].object();
  made.name = json["name"].string();
  if (made.name.empty()) made.name = index < 0 ? "default" : fmt::format("material{}", index);
  for (const char* name : {"KHR_materials_iridescence", "KHR_materials_dispersion",
                           "KHR_materials_diffuse_transmission", "KHR_materials_pbrSpecularGlossiness"})
    if (extensions[name]) document_.warn(fmt::format("extension \"{}\" is ignored", name), extensions[name]);

  const bool double_sided = json["doubleSided"].boolean(false);
  MetallicRoughnessParams params = metallic_roughness(json, pointer, made);
  params.use_vertex_color = vertex_colors;
  if (extensions["KHR_materials_unlit"]) {
    // A picture of its own color that no light changes. It does light its surroundings: a path tracer's emitter does.
    Slot color = params.base_color;
    if (vertex_colors)
      color.texture = color.texture ? make_product(color.texture, make_vertex_color()) : make_vertex_color();
    made.emission = AreaEmission{std::move(color), true};
    made.material = make_black();
    made.uses_tangents = false;
  } else {
    made.material = make_metallic_roughness(params);
    const Json normal = json["normalTexture"].object();
    if (const TexturePtr map = texture(normal, pointer + "/normalTexture", Channel::kRgb, ColorEncoding::kLinear)) {
      made.material = make_normal_map(map, float(normal["scale"].number(1)), made.material);
      made.uses_tangents = true;
    }
    // Radiance factor * texture * strength. Of a single-sided surface glTF shows the front alone, so that is what
    // shines.
    const Json strength = extensions["KHR_materials_emissive_strength"].object();
    const Animated<Rgb> emissive = product(factor(json, pointer, "emissiveFactor", 3, Rgb(0.0f), 1e30),
                                           factor(strength, pointer + "/extensions/KHR_materials_emissive_strength",
                                                  "emissiveStrength", 1, Rgb(1.0f), 1e30));
    const Json emissive_texture = json["emissiveTexture"];
    if (can_be_positive(emissive))
      made.emission = AreaEmission{
          {emissive, texture(emissive_texture, pointer + "/emissiveTexture", Channel::kRgb, ColorEncoding::kSrgb)},
          double_sided};
  }
  made.material = with_alpha(made.material, json, pointer, vertex_colors);
  return made;
}

MetallicRoughnessParams GltfMaterials::metallic_roughness(const Json& json, const std::string& pointer,
                                                          GltfMaterial& made) {
  constexpr auto kLinear = ColorEncoding::kLinear, kSrgb = ColorEncoding::kSrgb;
  const Rgb white(1.0f), black(0.0f);
  MetallicRoughnessParams p;
  // glTF hides the back of single-sided surfaces to save work; an offline renderer shows what is there, as Cycles does.
  p.double_sided = true;
  p.tints_once = tints_once_;

  const Json pbr = json["pbrMetallicRoughness"].object();
  const std::string at = pointer + "/pbrMetallicRoughness";
  p.base_color = slot(pbr, at, "baseColorFactor", white, 4, "baseColorTexture", Channel::kRgb, kSrgb);
  p.metallic = slot(pbr, at, "metallicFactor", white, 1, "metallicRoughnessTexture", Channel::kB, kLinear);
  p.roughness = slot(pbr, at, "roughnessFactor", white, 1, "metallicRoughnessTexture", Channel::kG, kLinear);

  const Json extensions = json["extensions"].object();
  const auto extension = [&](const char* name) { return extensions[name].object(); };
  const auto path = [&](const char* name) { return pointer + "/extensions/" + name; };

  if (const Json e = extension("KHR_materials_ior")) {
    p.ior = float(e["ior"].number(1.5));  // 0 stands for an infinite one: all light is reflected
    if (p.ior != 0 && !(p.ior >= 1 && p.ior < 1e3f))
      e["ior"].fail(ErrorCode::kOutOfRange, fmt::format("{} is neither 0 nor in [1, 1000)", p.ior));
  }
  if (const Json e = extension("KHR_materials_specular")) {
    const std::string name = path("KHR_materials_specular");
    p.specular = slot(e, name, "specularFactor", white, 1, "specularTexture", Channel::kA, kLinear);
    p.specular_color = {factor(e, name, "specularColorFactor", 3, white, 1e4),
                        texture(e["specularColorTexture"], name + "/specularColorTexture", Channel::kRgb, kSrgb)};
  }
  if (const Json e = extension("KHR_materials_transmission")) {
    p.transmission = slot(e, path("KHR_materials_transmission"), "transmissionFactor", black, 1, "transmissionTexture",
                          Channel::kR, kLinear);
    // glTF calls a surface without KHR_materials_volume thin-walled. Blender's exporter writes that extension only for
    // materials with a special node group, while Cycles renders every transmissive surface as the hull of a solid. What
    // comes from there shall look as it does there.
    p.thin_walled = document_.blender_version() == 0;
  }
  if (const Json e = extension("KHR_materials_volume")) {
    // The geometry itself is traced; the thickness only says whether there is an inside.
    p.thin_walled = p.thin_walled && !(e["thicknessFactor"].number(0) > 0);
    const Json color = e["attenuationColor"];
    double rgb[3] = {1, 1, 1};
    color.numbers(rgb, 3);
    for (double& c : rgb) {
      if (!(c >= 0 && c <= 1)) color.fail(ErrorCode::kOutOfRange, fmt::format("{} is outside [0, 1]", c));
      // A color of exactly 0 after some distance would need infinite absorption.
      c = std::max(c, 1e-6);
    }
    p.attenuation_color = Rgb(float(rgb[0]), float(rgb[1]), float(rgb[2]));
    const Json distance = e["attenuationDistance"];
    p.attenuation_distance = float(std::min(distance.number(double(kInfinity)), double(kInfinity)));
    if (!(p.attenuation_distance > 0)) distance.fail(ErrorCode::kOutOfRange, "a distance is greater than 0");
  }
  if (const Json e = extension("KHR_materials_clearcoat")) {
    const std::string name = path("KHR_materials_clearcoat");
    p.clearcoat = slot(e, name, "clearcoatFactor", black, 1, "clearcoatTexture", Channel::kR, kLinear);
    p.clearcoat_roughness =
        slot(e, name, "clearcoatRoughnessFactor", black, 1, "clearcoatRoughnessTexture", Channel::kG, kLinear);
    const Json normal = e["clearcoatNormalTexture"].object();
    if (!is_constant(p.clearcoat, black)) {
      p.clearcoat_normal = texture(normal, name + "/clearcoatNormalTexture", Channel::kRgb, kLinear);
      p.clearcoat_normal_scale = float(normal["scale"].number(1));
      made.uses_tangents |= p.clearcoat_normal != nullptr;
    }
  }
  if (const Json e = extension("KHR_materials_sheen")) {
    const std::string name = path("KHR_materials_sheen");
    p.sheen_color = slot(e, name, "sheenColorFactor", black, 3, "sheenColorTexture", Channel::kRgb, kSrgb);
    p.sheen_roughness = slot(e, name, "sheenRoughnessFactor", black, 1, "sheenRoughnessTexture", Channel::kA, kLinear);
  }
  if (const Json e = extension("KHR_materials_anisotropy")) {
    const std::string name = path("KHR_materials_anisotropy");
    p.anisotropy = slot(e, name, "anisotropyStrength", black, 1, "anisotropyTexture", Channel::kB, kLinear);
    p.anisotropy_rotation = float(e["anisotropyRotation"].number(0));
    if (e["anisotropyTexture"])
      document_.warn("the directions in an anisotropyTexture are ignored", e["anisotropyTexture"]);
    made.uses_tangents |= !is_constant(p.anisotropy, black);
  }
  return p;
}

MaterialPtr GltfMaterials::with_alpha(MaterialPtr opaque, const Json& json, const std::string& pointer,
                                      bool vertex_colors) {
  const Json mode = json["alphaMode"];
  enum class AlphaMode { kOpaque, kMask, kBlend };
  static constexpr Named<AlphaMode> kAlphaModes[] = {
      {"OPAQUE", AlphaMode::kOpaque}, {"MASK", AlphaMode::kMask}, {"BLEND", AlphaMode::kBlend}};
  const AlphaMode alpha_mode = choice(mode, mode.string("OPAQUE"), "alpha mode", kAlphaModes);
  if (alpha_mode == AlphaMode::kOpaque) return opaque;

  const Json pbr = json["pbrMetallicRoughness"].object();
  const std::string at = pointer + "/pbrMetallicRoughness";
  Slot alpha;
  if (const Track* track = animations_.find(at + "/baseColorFactor", 4)) {
    alpha.factor = map_linear<Rgb>(*track, [](const float* v) { return Rgb(v[3]); });
  } else if (const Json factor = pbr["baseColorFactor"]) {
    alpha.factor = Rgb(float(limited(factor.at(3), 1, 0, 1)));  // its length was checked with the color
  }
  alpha.texture = texture(pbr["baseColorTexture"], at + "/baseColorTexture", Channel::kA, ColorEncoding::kLinear);

  std::optional<Animated<float>> cutoff;
  if (alpha_mode == AlphaMode::kMask) {
    const Track* track = animations_.find(pointer + "/alphaCutoff", 1);
    cutoff = track ? map_linear<float>(*track, [](const float* v) { return v[0]; })
                   : Animated<float>(float(json["alphaCutoff"].number(0.5)));
  } else if (is_constant(alpha, Rgb(1.0f)) && !vertex_colors) {
    return opaque;  // exporters write BLEND for materials that are opaque everywhere
  }
  TexturePtr coverage = std::make_shared<Coverage>(std::move(alpha), vertex_colors, std::move(cutoff));
  return make_mask(std::move(coverage), std::move(opaque));
}

GltfMaterials::TexturePtr GltfMaterials::texture(const Json& info, const std::string& pointer, Channel channel,
                                                 ColorEncoding encoding) {
  if (!info.object()) return nullptr;
  ImageTextureParams params;
  params.channel = channel;
  params.encoding = encoding;
  std::uint64_t set = info["texCoord"].integer(0);

  const Json transform = info["extensions"].object()["KHR_texture_transform"].object();
  set = transform["texCoord"].integer(set);
  if (set > 1) document_.warn("texture coordinate sets beyond the second are read as the first", info);
  params.uv_set = set == 1 ? 1 : 0;
  double offset[2] = {0, 0}, scale[2] = {1, 1};
  transform["offset"].numbers(offset, 2);
  transform["scale"].numbers(scale, 2);
  const double rotation = transform["rotation"].number(0);

  const std::string at = pointer + "/extensions/KHR_texture_transform";
  const Track* moving_offset = animations_.find(at + "/offset", 2);
  const Track* moving_scale = animations_.find(at + "/scale", 2);
  const Track* moving_rotation = animations_.find(at + "/rotation", 1);
  if (!moving_offset && !moving_scale && !moving_rotation) {
    params.transform =
        uv_transform({float(offset[0]), float(offset[1])}, float(rotation), {float(scale[0]), float(scale[1])});
    return image_texture(info, params);
  }
  const auto vec2 = [](const Track* track, const double* constant) {
    return track ? map_linear<Vec3f>(*track, [](const float* v) { return Vec3f(v[0], v[1], 0); })
                 : Animated<Vec3f>(Vec3f(float(constant[0]), float(constant[1]), 0));
  };
  TexturePtr image = image_texture(info, params);
  if (!image) return nullptr;
  return std::make_shared<MovingUv>(std::move(image), params.uv_set, vec2(moving_offset, offset),
                                    moving_rotation
                                        ? map_linear<float>(*moving_rotation, [](const float* v) { return v[0]; })
                                        : Animated<float>(float(rotation)),
                                    vec2(moving_scale, scale));
}

GltfMaterials::TexturePtr GltfMaterials::image_texture(const Json& info, ImageTextureParams params) {
  const Json json =
      document_.list("textures").at(info["index"].index(document_.count("textures"), "textures")).object();
  const Json sampler_index = json["sampler"];
  const int sampler = sampler_index.optional_index(document_.count("samplers"), "samplers");
  if (sampler >= 0) {
    const Json s = document_.list("samplers").at(sampler).object();
    params.wrap_u = wrap_mode(s["wrapS"]);
    params.wrap_v = wrap_mode(s["wrapT"]);
    params.filter = filter_mode(s);
  } else {
    params.filter = TextureFilter::kMipmap;
  }
  params.warnings = &document_.warnings();

  const Json extensions = json["extensions"].object();
  const Json webp = extensions["EXT_texture_webp"].object()["source"],
             basisu = extensions["KHR_texture_basisu"].object()["source"];
  const Json source = webp ? webp : json["source"];
  if (!source) {
    document_.warn(
        basisu ? "textures in KTX2 (KHR_texture_basisu) are ignored" : "textures without an image are ignored", json);
    return nullptr;
  }
  const int index = source.index(document_.count("images"), "images");
  const Json image = document_.list("images").at(index).object();
  const Json uri = image["uri"], view = image["bufferView"];
  if (uri && view) image.fail("has both a uri and a bufferView");
  if (!uri && !view) image.fail("has neither a uri nor a bufferView");

  std::optional<std::string> decoded;
  std::string_view bytes;
  if (view) {
    bytes = document_.view_bytes(view.index(document_.count("bufferViews"), "bufferViews"));
  } else {
    decoded = GltfDocument::decode_data_uri(uri);
    if (!decoded) {
      params.file = document_.resolve(uri);
      document_.files().note(params.file, uri.loc());
      return make_image_texture(params, uri.loc());
    }
    bytes = *decoded;
  }
  if (bytes.substr(0, 7) == "\xABKTX 20") {
    document_.warn("textures in KTX2 (KHR_texture_basisu) are ignored", json);
    return nullptr;
  }
  // The name identifies the picture in the texture cache, also across files of one name with different contents.
  const std::string name = fmt::format("{}#images/{}#{:016x}", document_.file().string(), index, hash_bytes(bytes));
  return make_image_texture(params, bytes, name, image.loc());
}

}  // namespace tempera
