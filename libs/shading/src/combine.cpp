// SPDX-License-Identifier: Apache-2.0
// Materials made of others: two-sided, blend and mask.
#include <fmt/format.h>

#include "material_util.h"

namespace tempera {
namespace {

/// Passes everything on to one nested material; what a wrapper changes it overrides.
class Wrapper : public Material {
 public:
  explicit Wrapper(MaterialPtr nested) : nested_(std::move(nested)) {}
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    nested_->add_lobes(point, weight, bsdf);
  }
  float opacity(const ShadingPoint& point) const override { return nested_->opacity(point); }
  bool has_opacity() const override { return nested_->has_opacity(); }
  Rgb absorption(const ShadingPoint& point) const override { return nested_->absorption(point); }
  bool has_absorption() const override { return nested_->has_absorption(); }
  bool needs_tangents() const override { return nested_->needs_tangents(); }
  bool needs_footprint() const override { return nested_->needs_footprint(); }
  int max_lobes() const override { return nested_->max_lobes(); }
  int max_frames() const override { return nested_->max_frames(); }
  int max_layers() const override { return nested_->max_layers(); }

 protected:
  MaterialPtr nested_;
};

/// Checks that the lobes of `material` fit into one Bsdf.
MaterialPtr checked(MaterialPtr material) {
  const auto check = [](const char* what, int count, int limit) {
    if (count > limit)
      throw Error(ErrorCode::kBadInput,
                  fmt::format("material combines too many others: {} {}, at most {} are possible", count, what, limit));
  };
  check("lobes", material->max_lobes(), Bsdf::kMaxLobes);
  check("shading frames", material->max_frames(), Bsdf::kMaxFrames);
  check("layers", material->max_layers(), Bsdf::kMaxLayers);
  return material;
}

/// The point seen from behind: its frame and geometric normal turned over.
ShadingPoint turned(const ShadingPoint& point, Bsdf& bsdf) {
  ShadingPoint back = point;
  back.frame.n = -back.frame.n;
  back.unbent = -back.unbent;
  back.ng = -back.ng;
  if (back.bsdf_frame >= 0) back.bsdf_frame = bsdf.add_flipped_frame(back.bsdf_frame);
  return back;
}

class TwoSided final : public Material {
 public:
  TwoSided(MaterialPtr front, MaterialPtr back) : front_(std::move(front)), back_(std::move(back)) {}
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    if (cos_wo(point) < 0)
      back_->add_lobes(turned(point, bsdf), weight, bsdf);
    else
      front_->add_lobes(point, weight, bsdf);
  }
  float opacity(const ShadingPoint& point) const override {
    return (cos_wo(point) < 0 ? back_ : front_)->opacity(point);
  }
  bool has_opacity() const override { return front_->has_opacity() || back_->has_opacity(); }
  bool needs_tangents() const override { return front_->needs_tangents() || back_->needs_tangents(); }
  bool needs_footprint() const override { return front_->needs_footprint() || back_->needs_footprint(); }
  int max_lobes() const override { return std::max(front_->max_lobes(), back_->max_lobes()); }
  int max_frames() const override { return 1 + std::max(front_->max_frames(), back_->max_frames()); }
  int max_layers() const override { return std::max(front_->max_layers(), back_->max_layers()); }

 private:
  MaterialPtr front_, back_;
};

class Blend final : public Material {
 public:
  Blend(Slot weight, MaterialPtr a, MaterialPtr b) : weight_(std::move(weight)), a_(std::move(a)), b_(std::move(b)) {}
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    const float w = mix(point);
    float a = 1 - w, b = w;
    if (has_opacity()) {  // given that light does not pass through, with which of the two does it interact?
      a *= a_->opacity(point), b *= b_->opacity(point);
      const float sum = a + b;
      if (sum > 0) a /= sum, b /= sum;
    }
    if (a > 0) a_->add_lobes(point, weight * a, bsdf);
    if (b > 0) b_->add_lobes(point, weight * b, bsdf);
  }
  float opacity(const ShadingPoint& point) const override {
    const float w = mix(point);
    return (1 - w) * a_->opacity(point) + w * b_->opacity(point);
  }
  bool has_opacity() const override { return a_->has_opacity() || b_->has_opacity(); }
  Rgb absorption(const ShadingPoint& point) const override {
    return lerp(a_->absorption(point), b_->absorption(point), mix(point));
  }
  bool has_absorption() const override { return a_->has_absorption() || b_->has_absorption(); }
  bool needs_tangents() const override { return a_->needs_tangents() || b_->needs_tangents(); }
  bool needs_footprint() const override { return weight_.texture || a_->needs_footprint() || b_->needs_footprint(); }
  int max_lobes() const override { return a_->max_lobes() + b_->max_lobes(); }
  int max_frames() const override { return a_->max_frames() + b_->max_frames(); }
  int max_layers() const override { return a_->max_layers() + b_->max_layers(); }

 private:
  float mix(const ShadingPoint& point) const { return std::clamp(weight_.scalar(point), 0.0f, 1.0f); }
  Slot weight_;
  MaterialPtr a_, b_;
};

class Mask final : public Wrapper {
 public:
  Mask(Slot opacity, MaterialPtr nested) : Wrapper(std::move(nested)), opacity_(std::move(opacity)) {}
  float opacity(const ShadingPoint& point) const override {
    return std::clamp(opacity_.scalar(point), 0.0f, 1.0f) * nested_->opacity(point);
  }
  bool has_opacity() const override { return true; }
  bool needs_footprint() const override { return opacity_.texture || nested_->needs_footprint(); }

 private:
  Slot opacity_;
};

/// Common part of bump and normal mapping: the nested material sees a frame around another normal.
class Perturbed : public Wrapper {
 public:
  using Wrapper::Wrapper;
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    ShadingPoint bumped = point;
    if (point.bends) bumped.frame = with_normal(point.frame, point.unbent);  // maps are over normals as they are
    const Basis base = bumped.frame;
    const auto unit = [](Vec3f n) {
      n = normalize(n);
      return length_squared(n) > 0 && is_finite(n) ? n : Vec3f{0, 0, 1};
    };
    const Vec3f mapped = normal(bumped);  // local to the base
    Vec3f n = mapped;
    // A normal that faces away from the viewer is turned about the unperturbed one.
    const Vec3f wo = base.to_local(point.wo);
    if (wo.z * dot(wo, n) <= 0) n = {-n.x, -n.y, n.z};
    n = unit(n);
    const Vec3f s = Vec3f{1, 0, 0} - n * n.x;
    const Basis local = Basis::with_tangent(n, s);
    bumped.frame = {base.to_world(local.s), base.to_world(local.t), base.to_world(n)};
    bumped.unbent = bumped.frame.n;
    if (point.bends)  // what reflects is bent from where the map points
      bumped.frame = with_normal(bumped.frame, bend_normal(base.to_world(unit(mapped)), point.ng, point.wo));
    bumped.bsdf_frame = bsdf.add_perturbed_frame(bumped.frame, frame_of(point, bsdf), bumped.unbent);
    nested_->add_lobes(bumped, weight, bsdf);
  }
  bool needs_tangents() const override { return true; }
  bool needs_footprint() const override { return true; }
  int max_frames() const override { return 1 + Wrapper::max_frames(); }

 protected:
  /// The new normal in the local frame of `point`; need not have unit length.
  virtual Vec3f normal(const ShadingPoint& point) const = 0;
};

class Bump final : public Perturbed {
 public:
  Bump(std::shared_ptr<const Texture> height, float scale, MaterialPtr nested)
      : Perturbed(std::move(nested)), height_(std::move(height)), scale_(scale) {}

 protected:
  Vec3f normal(const ShadingPoint& point) const override {
    // Tangents of the displaced surface [Blinn 1978]: dpdu + n dh/du, with dpdu projected onto the shading tangent
    // plane.
    const Vec2f slope = height_->scalar_gradient(point) * scale_;
    const Vec3f& n = point.frame.n;
    const Vec3f du = point.dpdu + n * (slope.x - dot(n, point.dpdu));
    const Vec3f dv = point.dpdv + n * (slope.y - dot(n, point.dpdv));
    Vec3f bumped = normalize(cross(du, dv));
    if (dot(bumped, point.ng) < 0) bumped = -bumped;
    return point.frame.to_local(bumped);
  }

 private:
  std::shared_ptr<const Texture> height_;
  float scale_;
};

class NormalMap final : public Perturbed {
 public:
  NormalMap(std::shared_ptr<const Texture> map, float scale, MaterialPtr nested)
      : Perturbed(std::move(nested)), map_(std::move(map)), scale_(scale) {}

 protected:
  Vec3f normal(const ShadingPoint& point) const override {
    const Rgb c = map_->rgb(point);
    return {scale_ * (2 * c.r - 1), scale_ * (2 * c.g - 1), 2 * c.b - 1};
  }

 private:
  std::shared_ptr<const Texture> map_;
  float scale_;
};

}  // namespace

void make_bent_bsdf(const Material& material, const ShadingPoint& point, Bsdf& bsdf) {
  bsdf.set_horizon(ng_towards_viewer(point));
  const Vec3f n = bend_normal(point.frame.n, point.ng, point.wo);
  if (n == point.frame.n) return material.add_lobes(point, 1, bsdf);
  ShadingPoint bent = point;
  bent.frame = with_normal(point.frame, n);
  material.add_lobes(bent, 1, bsdf);
}

MaterialPtr make_two_sided(MaterialPtr front, MaterialPtr back) {
  if (!back) back = front;
  return checked(std::make_shared<TwoSided>(std::move(front), std::move(back)));
}
MaterialPtr make_blend(Slot weight, MaterialPtr a, MaterialPtr b) {
  return checked(std::make_shared<Blend>(std::move(weight), std::move(a), std::move(b)));
}
MaterialPtr make_mask(Slot opacity, MaterialPtr nested) {
  return std::make_shared<Mask>(std::move(opacity), std::move(nested));
}
MaterialPtr make_bump(std::shared_ptr<const Texture> height, float scale, MaterialPtr nested) {
  return checked(std::make_shared<Bump>(std::move(height), scale, std::move(nested)));
}
MaterialPtr make_normal_map(std::shared_ptr<const Texture> normal, float scale, MaterialPtr nested) {
  return checked(std::make_shared<NormalMap>(std::move(normal), scale, std::move(nested)));
}

}  // namespace tempera
