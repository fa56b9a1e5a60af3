// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the shading tests share: points, random numbers, statistics, and 4 x 4 images.
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/random.h"
#include "tempera/shading/material_catalog.h"

namespace tempera::test {

/// A counter-based sequence of uniform numbers.
class Random {
 public:
  explicit Random(std::uint64_t seed) : seed_(seed) {}
  float operator()() { return to_unit_float(std::uint32_t(hash_key(seed_, ++count_) >> 32)); }
  Vec2f pair() {
    const float a = (*this)();
    return {a, (*this)()};
  }
  Vec3f sphere() {
    const float z = 2 * (*this)() - 1, r = std::sqrt(std::max(1 - z * z, 0.0f)), phi = 2 * kPi * (*this)();
    return {r * std::cos(phi), r * std::sin(phi), z};
  }
  Vec3f hemisphere() {
    Vec3f w = sphere();
    w.z = std::abs(w.z);
    return w;
  }

 private:
  std::uint64_t seed_, count_ = 0;
};

/// A point in the plane z = 0 whose frame is the world's, seen from `wo`.
inline ShadingPoint plane_point(const Vec3f& wo) {
  ShadingPoint p;
  p.ng = {0, 0, 1};
  p.dpdu = {1, 0, 0};
  p.dpdv = {0, 1, 0};
  p.uv = {0.3f, 0.6f};
  p.wo = wo;
  return p;
}

inline Bsdf bsdf_of(const Material& material, const ShadingPoint& point) {
  Bsdf bsdf;
  material.add_lobes(point, 1, bsdf);
  return bsdf;
}
inline Bsdf bsdf_of(const Material& material, const Vec3f& wo) { return bsdf_of(material, plane_point(wo)); }

/// A material whose samples, energy and reciprocity bsdf_statistics_test.cpp checks.
struct BsdfCase {
  std::string name;
  MaterialPtr material;
  bool transmits = false;
  float eta = 1;           ///< inside over outside
  bool reciprocal = true;  ///< f(wo, wi) = f(wi, wo), with eta^2 across an interface
  float gain = 0;          ///< energy above 1 that the published model has
};
/// A type of the catalog whose colors are `color`, all else by default.
inline MaterialPtr catalog_material(std::string_view name, const Rgb& color = Rgb(0.5f)) {
  struct Values final : MaterialValues {
    Slot color_slot(const std::string&) const override { return tint; }
    Slot scalar_slot(const std::string& n) const override { return parse_color(others.get_string(n)).value(); }
    Rgb color(const std::string&) const override { return tint; }
    const Params& params() const override { return others; }
    Rgb tint;
    Params others;
  } values;
  const MaterialEntry* entry = find_material(name);
  values.tint = color;
  values.others = Params(entry->params);
  return entry->make(values);
}
/// Cases of other test files; each adds its own as a global AddBsdfCase.
inline std::vector<std::function<BsdfCase()>>& added_bsdf_cases() {
  static std::vector<std::function<BsdfCase()>> cases;
  return cases;
}
struct AddBsdfCase {
  explicit AddBsdfCase(std::function<BsdfCase()> make) { added_bsdf_cases().push_back(std::move(make)); }
};

/// A folder that is removed at the end.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "tempera-shading-XXXXXX").string();
    path_ = mkdtemp(name.data());
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// Writes pixels [height][width][channels] in their own type.
template <class T>
void write_image(const std::filesystem::path& file, int width, int height, int channels, const std::vector<T>& pixels) {
  const OIIO::TypeDesc type = OIIO::BaseTypeFromC<T>::value;
  auto out = OIIO::ImageOutput::create(file.string());
  OIIO::ImageSpec spec(width, height, channels, type);
  spec["oiio:UnassociatedAlpha"] = 1;
  ASSERT_TRUE(out && out->open(file.string(), spec) && out->write_image(type, pixels.data()) && out->close()) << file;
}

}  // namespace tempera::test
