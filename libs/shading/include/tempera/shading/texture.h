// SPDX-License-Identifier: Apache-2.0
#pragma once
// Values over surfaces: constants (possibly animated) and textures. Evaluated once per hit when a material makes its
// BSDF.
#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "tempera/core/animated.h"
#include "tempera/core/error.h"
#include "tempera/core/log.h"
#include "tempera/core/vec.h"

namespace tempera {

/// What a material or texture may look at: one point of a surface at one time, seen from `wo`.
struct ShadingPoint {
  Vec3f p;   ///< world position
  Vec3f ng;  ///< unit geometric normal; the front side is where it points
  /// Shading frame: n the interpolated normal (same side as ng), s along dpdu. Without Material::needs_tangents any s
  /// will do, and dpdu and dpdv stay zero.
  Basis frame;
  Vec3f dpdu, dpdv;  ///< world, per unit uv
  Vec2f uv, uv1;     ///< first and second texture coordinates
  Rgb color{1.0f};   ///< vertex or face color attribute, white without one
  float color_alpha = 1;
  Vec3f wo;              ///< unit, away from the surface
  double time = 0;       ///< seconds on the shot's axis
  Vec2f duv_dx, duv_dy;  ///< texture footprint of a pixel step; zero: no filtering
  int bsdf_frame = -1;   ///< index of `frame` in the Bsdf that materials are filling; -1: not registered yet
  /// Whether make_bsdf bends shading normals for the viewer. Materials then see a `frame` that is bent, and in `unbent`
  /// the normal that it was made from; elsewhere the two normals are the same.
  bool bends = false;
  Vec3f unbent;
};

/// A value over surfaces. Threads: const and re-entrant.
class Texture {
 public:
  virtual ~Texture() = default;
  /// Linear RGB, or a non-color vector as stored (normal maps).
  virtual Rgb rgb(const ShadingPoint& point) const = 0;
  /// First channel: roughness, opacity and other non-color data. Textures of one channel override it.
  virtual float scalar(const ShadingPoint& point) const { return rgb(point).r; }
  /// Derivatives of `scalar` along the surface's u and v (bump mapping). Central differences where a texture knows
  /// none.
  virtual Vec2f scalar_gradient(const ShadingPoint& point) const;
  /// Mean over uv in [0,1]^2: for light sampling and lobe probabilities.
  virtual Rgb mean() const = 0;
};

/// A parameter of a material: a texture, or a constant that may be animated. With both, their product (glTF's factors).
struct Slot {
  Animated<Rgb> factor{Rgb(1.0f)};
  std::shared_ptr<const Texture> texture;

  Slot() = default;
  Slot(float v) : factor(Rgb(v)) {}                                  // NOLINT: a constant is a slot
  Slot(const Rgb& v) : factor(v) {}                                  // NOLINT
  Slot(Animated<Rgb> v) : factor(std::move(v)) {}                    // NOLINT
  Slot(std::shared_ptr<const Texture> t) : texture(std::move(t)) {}  // NOLINT
  Slot(Animated<Rgb> v, std::shared_ptr<const Texture> t) : factor(std::move(v)), texture(std::move(t)) {}

  Rgb rgb(const ShadingPoint& point) const {
    const Rgb f = factor.is_constant() ? factor.values()[0] : factor.at(point.time);
    return texture ? f * texture->rgb(point) : f;
  }
  float scalar(const ShadingPoint& point) const {
    const Rgb f = factor.is_constant() ? factor.values()[0] : factor.at(point.time);
    return texture ? f.r * texture->scalar(point) : f.r;
  }
  Rgb mean(double time = 0) const { return texture ? factor.at(time) * texture->mean() : factor.at(time); }
  bool is_constant() const { return !texture && factor.is_constant(); }
};

enum class Wrap { kRepeat, kClamp, kMirror, kBlack };
enum class TextureFilter { kNearest, kBilinear, kMipmap };
/// How stored numbers become values: kAuto converts from the color space that the file states (see color_space.h),
/// kSrgb takes any file as sRGB, kLinear takes numbers as they are stored: for data.
enum class ColorEncoding { kAuto, kSrgb, kLinear };

/// u,v -> (a u + b v + c, d u + e v + f).
struct UvTransform {
  float a = 1, b = 0, c = 0, d = 0, e = 1, f = 0;
  Vec2f operator()(const Vec2f& uv) const { return {a * uv.x + b * uv.y + c, d * uv.x + e * uv.y + f}; }
  bool operator==(const UvTransform&) const = default;
};

enum class Channel { kRgb, kR, kG, kB, kA, kLuminance };

struct ImageTextureParams {
  std::filesystem::path file;
  Wrap wrap_u = Wrap::kRepeat, wrap_v = Wrap::kRepeat;
  TextureFilter filter = TextureFilter::kBilinear;
  ColorEncoding encoding = ColorEncoding::kAuto;
  UvTransform transform;  ///< from surface uv to image uv
  bool flip_v = false;    ///< image row 0 is at v = 1 instead of v = 0
  int uv_set = 0;         ///< 0 or 1
  Channel channel = Channel::kRgb;
  bool invert = false;  ///< 1 - value
  /// Heights may be below 0. All else that a texture says may not: negative texels are read as 0, as are infinite ones
  /// and those that are no numbers, with one warning.
  bool keep_negative = false;
  Warnings* warnings = nullptr;  ///< takes that warning; null: it is logged
};
/// Texture from an image file through OpenImageIO.
/// Errors: Error{kMissingFile} or Error{kBadInput} at `loc`.
std::shared_ptr<const Texture> make_image_texture(const ImageTextureParams& params, const SourceLoc& loc = {});
/// The same from encoded bytes in memory (glTF buffers): `name` identifies them in messages and caches.
std::shared_ptr<const Texture> make_image_texture(const ImageTextureParams& params, std::string_view encoded,
                                                  const std::string& name, const SourceLoc& loc = {});
/// Bytes that decoded images may take together before image files are paged in tiles through OpenImageIO's cache, which
/// is then bounded by the same number; 1 GiB unless set. Applies to images that are loaded later. Threads: safe.
void set_image_memory_budget(std::size_t bytes);

/// Mitsuba's checkerboard: color0 where both halves of a unit cell agree, color1 elsewhere.
std::shared_ptr<const Texture> make_checkerboard(Slot color0, Slot color1, const UvTransform& transform);
/// The surface's color attribute (ShadingPoint::color).
std::shared_ptr<const Texture> make_vertex_color(float scale = 1);
/// The alpha of the surface's color attribute (ShadingPoint::color_alpha).
std::shared_ptr<const Texture> make_vertex_alpha();
/// a times b, per channel and as scalars.
std::shared_ptr<const Texture> make_product(std::shared_ptr<const Texture> a, std::shared_ptr<const Texture> b);

}  // namespace tempera
