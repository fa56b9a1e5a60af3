// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the tests of the Mitsuba importer share.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "import_test_util.h"
#include "tempera/import/mitsuba.h"
#include "tempera/shading/bsdf.h"

namespace tempera {

/// A folder of Mitsuba's files.
class Folder : public TestFolder {
 public:
  /// Imports a scene with this inside its root element, which stands on line 1.
  Scene load(const std::string& inner, const ImportOptions& options = {}, const char* version = "3.0.0") {
    return import_mitsuba(write("scene.xml", fmt::format("<scene version=\"{}\">{}</scene>", version, inner)), options,
                          warnings);
  }
  Warnings warnings;
};

inline constexpr const char* kTriangleObj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

/// Scattering of a material at fixed directions, for a surface in z = 0.
inline std::vector<float> scattering(const Material& material, const Vec2f& uv = {0.3f, 0.6f}) {
  std::vector<float> result;
  for (const Vec3f& o : {Vec3f{0.3f, 0.2f, 0.8f}, Vec3f{-0.6f, 0.1f, 0.3f}, Vec3f{0.3f, 0.2f, -0.8f}}) {
    ShadingPoint p;
    p.ng = {0, 0, 1};
    p.dpdu = {1, 0, 0};
    p.dpdv = {0, 1, 0};
    p.uv = p.uv1 = uv;
    p.color = Rgb(0.9f, 0.5f, 0.1f);
    p.wo = normalize(o);
    Bsdf bsdf;
    material.add_lobes(p, 1, bsdf);
    result.push_back(material.opacity(p));
    for (const Vec3f& i : {Vec3f{-0.28f, -0.2f, 0.8f}, Vec3f{0.5f, -0.4f, 0.5f}, Vec3f{-0.2f, -0.1f, -0.7f}}) {
      const Rgb f = bsdf.eval(p.wo, normalize(i)).sum();
      for (int c = 0; c < 3; ++c) result.push_back(f[c]);
    }
    // Delta lobes: what one sample carries.
    for (const float u : {0.02f, 0.97f}) {
      const auto s = bsdf.empty() ? std::nullopt : bsdf.sample(p.wo, u, {0.3f, 0.7f});
      for (int c = 0; c < 3; ++c) result.push_back(s && s->delta ? s->sum()[c] / s->pdf : 0);
      result.push_back(s && s->delta ? s->wi.z : 0);
    }
  }
  return result;
}

inline testing::AssertionResult SameScattering(const Material& a, const Material& b) {
  const std::vector<float> x = scattering(a), y = scattering(b);
  for (std::size_t i = 0; i < x.size(); ++i)
    if (!(std::abs(x[i] - y[i]) <= 1e-5f * (1 + std::abs(y[i]))))
      return testing::AssertionFailure() << "value " << i << " is " << x[i] << " instead of " << y[i];
  return testing::AssertionSuccess();
}

inline const Mesh& mesh_of(const Scene& scene, std::size_t shape = 0) {
  return std::get<Mesh>(scene.shapes.at(shape).geometry);
}

inline Bounds3f bounds_of(const Mesh& mesh) {
  Bounds3f b;
  for (const Vec3f& p : mesh.positions) b.extend(p);
  return b;
}

inline void expect_near(const Vec3f& a, const Vec3f& b, float tolerance = 1e-5f) {
  EXPECT_LT(length(a - b), tolerance) << a.x << " " << a.y << " " << a.z;
}
inline void expect_near(const Vec3d& a, const Vec3d& b) { expect_near(Vec3f(a), Vec3f(b)); }

}  // namespace tempera
