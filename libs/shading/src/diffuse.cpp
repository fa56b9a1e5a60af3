// SPDX-License-Identifier: Apache-2.0
#include "material_util.h"

namespace tempera {
namespace {

class Diffuse final : public Material {
 public:
  explicit Diffuse(Slot reflectance) : reflectance_(std::move(reflectance)) {}
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    if (cos_wo(point) <= 0) return;
    DiffuseLobe lobe;
    lobe.reflectance = reflectance_.rgb(point);
    bsdf.add(frame_of(point, bsdf), lobe, weight, weight);
  }
  bool needs_tangents() const override { return false; }
  bool needs_footprint() const override { return any_texture({&reflectance_}); }

 private:
  Slot reflectance_;
};

class Black final : public Material {
 public:
  void add_lobes(const ShadingPoint&, float, Bsdf&) const override {}
  bool needs_tangents() const override { return false; }
  bool needs_footprint() const override { return false; }
  int max_lobes() const override { return 0; }
  int max_frames() const override { return 0; }
};

}  // namespace

MaterialPtr make_diffuse(Slot reflectance) { return std::make_shared<Diffuse>(std::move(reflectance)); }
MaterialPtr make_black() { return std::make_shared<Black>(); }

namespace {
MaterialPtr diffuse_from(const MaterialValues& v) { return make_diffuse(v.color_slot("reflectance")); }
}  // namespace

extern const MaterialEntry diffuse_material;
const MaterialEntry diffuse_material{
    "diffuse", "ideally diffuse reflection", {{"reflectance", "0.5", "color or image"}}, diffuse_from};

}  // namespace tempera
