// SPDX-License-Identifier: Apache-2.0
// Values and densities of our BSDFs against Mitsuba's, from bsdf_reference.txt (tools/make_bsdf_reference.py).
#include <fstream>
#include <functional>
#include <map>
#include <sstream>

#include "shading_test_util.h"
#include "tempera/shading/spectrum.h"

namespace tempera {
namespace {

using test::TemporaryFolder;

const Rgb kColor{0.7f, 0.4f, 0.2f}, kTint{0.9f, 0.8f, 0.6f};

/// The 4 x 4 images of the reference script.
std::shared_ptr<const Texture> image(const TemporaryFolder& folder, int channels, Channel channel) {
  std::vector<std::uint8_t> data;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x)
      for (int c = 0; c < channels; ++c) {
        const int v = (40 * x + 67 * y + 90 * c + 13 * x * y) % 256;
        data.push_back(std::uint8_t(c == 2 ? 128 + v / 2 : v));
      }
  ImageTextureParams p;
  p.file = folder / ("image" + std::to_string(channels) + ".png");
  test::write_image(p.file, 4, 4, channels, data);
  p.encoding = ColorEncoding::kLinear;
  p.channel = channel;
  return make_image_texture(p);
}

Roughness rough(float u, float v, Microfacets type = Microfacets::kBeckmann, bool visible = true) {
  return {true, type, u, v, visible};
}
MaterialPtr gold(const Roughness& r, Slot scale = 1.0f) {
  const auto au = named_conductor("Au");
  return make_conductor({au->eta, au->k, scale, r});
}
MaterialPtr plastic(const Roughness& r, Slot diffuse, bool nonlinear = false, Slot specular = 1.0f, float ior = 1.49f) {
  return make_plastic({ior, 1.000277f, diffuse, specular, nonlinear, r});
}
MaterialPtr glass(const Roughness& r, float inside = 1.5046f, float outside = 1.000277f, Slot transmittance = 1.0f) {
  return make_dielectric({inside, outside, 1.0f, transmittance, false, r});
}
float eta_of_specular(float s) { return 2 / (1 - std::sqrt(0.08f * s)) - 1; }

std::map<std::string, MaterialPtr> materials(const TemporaryFolder& folder) {
  constexpr auto kGgx = Microfacets::kGgx;
  constexpr auto kBeckmann = Microfacets::kBeckmann;
  const auto gray = image(folder, 1, Channel::kLuminance);
  const auto luminance = image(folder, 3, Channel::kLuminance);
  const auto normals = image(folder, 3, Channel::kRgb);
  std::map<std::string, MaterialPtr> m;
  m["diffuse"] = make_diffuse(kColor);
  m["conductor"] = gold({}, kTint);
  m["roughconductor_beckmann"] = gold(rough(0.2f, 0.2f));
  m["roughconductor_ggx"] = gold(rough(0.3f, 0.3f, kGgx), kTint);
  m["roughconductor_sharp"] = gold(rough(0.02f, 0.02f, kGgx));
  m["roughconductor_anisotropic_beckmann"] = gold(rough(0.1f, 0.4f));
  m["roughconductor_anisotropic_ggx"] = gold(rough(0.5f, 0.15f, kGgx));
  m["roughconductor_all_normals_beckmann"] = gold(rough(0.3f, 0.3f, kBeckmann, false));
  m["roughconductor_all_normals_ggx"] = gold(rough(0.3f, 0.2f, kGgx, false));
  m["dielectric"] = make_dielectric({1.5046f, 1.000277f, kTint, kColor, false, {}});
  m["dielectric_diamond_in_water"] = glass({}, *named_ior("diamond"), *named_ior("water"));
  m["thindielectric"] = make_dielectric({1.5046f, 1.000277f, 1.0f, kColor, true, {}});
  m["roughdielectric_beckmann"] = glass(rough(0.3f, 0.3f), 1.5046f, 1.000277f, kColor);
  m["roughdielectric_ggx"] = glass(rough(0.2f, 0.2f, kGgx), 1.8f, 1.0f);
  m["roughdielectric_anisotropic"] = glass(rough(0.1f, 0.5f, kGgx));
  m["roughdielectric_all_normals"] = glass(rough(0.3f, 0.3f, kGgx, false));
  m["roughdielectric_from_dense"] = glass(rough(0.25f, 0.25f), 1.0f, 1.5f);
  m["plastic"] = plastic({}, kColor, false, kTint);
  m["plastic_nonlinear"] = plastic({}, kColor, true, 1.0f, 1.9f);
  m["roughplastic_beckmann"] = plastic(rough(0.1f, 0.1f), kColor);
  m["roughplastic_ggx_nonlinear"] = plastic(rough(0.3f, 0.3f, kGgx), kColor, true);
  m["roughplastic_all_normals"] = plastic(rough(0.2f, 0.2f, kGgx, false), 0.5f, false, kTint);
  const auto principled = [](auto&& set) {
    PrincipledParams p;
    p.base_color = kColor;
    p.eta = eta_of_specular(0.5f);
    set(p);
    return make_principled(p);
  };
  m["principled_plain"] = principled([](auto& p) { p.roughness = 0.4f; });
  m["principled_metal"] =
      principled([](auto& p) { p.roughness = 0.3f, p.metallic = 0.8f, p.anisotropic = 0.7f, p.spec_tint = 0.5f; });
  m["principled_cloth"] = principled([](auto& p) {
    p.roughness = 0.8f, p.flatness = 0.6f, p.sheen = 0.9f, p.sheen_tint = 0.4f, p.eta = eta_of_specular(0.3f);
  });
  m["principled_coat"] =
      principled([](auto& p) { p.roughness = 0.6f, p.clearcoat = 1.0f, p.clearcoat_gloss = 0.3f, p.spec_tint = 0.7f; });
  m["principled_glass"] = principled([](auto& p) {
    p.roughness = 0.35f, p.spec_trans = 0.8f, p.eta = 1.45f, p.clearcoat = 0.5f, p.clearcoat_gloss = 0.9f;
    p.metallic = 0.1f, p.anisotropic = 0.3f, p.spec_tint = 0.2f;
  });
  m["blend"] = make_blend(0.3f, make_diffuse(kColor), gold(rough(0.3f, 0.3f)));
  m["blend_textured"] = make_blend(gray, make_diffuse(kColor), plastic({}, kTint));
  m["twosided"] = make_two_sided(plastic(rough(0.25f, 0.25f), kColor));
  m["twosided_pair"] = make_two_sided(make_diffuse(kColor), gold(rough(0.3f, 0.2f)));
  m["bumpmap"] = make_bump(gray, 0.4f, make_diffuse(kColor));
  m["bumpmap_color"] = make_bump(luminance, -0.2f, gold(rough(0.3f, 0.3f)));
  m["bumpmap_twosided"] = make_bump(gray, 0.3f, make_two_sided(plastic(rough(0.3f, 0.3f), kColor)));
  m["twosided_bumpmap"] = make_two_sided(make_bump(gray, 0.3f, make_diffuse(kColor)));
  m["bumpmap_dielectric"] = make_bump(gray, 0.1f, glass(rough(0.3f, 0.3f)));
  m["normalmap"] = make_normal_map(normals, 1, gold(rough(0.4f, 0.2f)));
  m["normalmap_twosided"] = make_two_sided(make_normal_map(normals, 1, make_diffuse(kColor)));
  return m;
}

struct Row {
  std::string bsdf;
  bool delta;
  Vec2f uv;
  Vec3f wo, wi;
  Rgb f;
  float pdf;
};
std::vector<Row> rows() {
  std::ifstream in(TEMPERA_SOURCE_DIR "/libs/shading/tests/bsdf_reference.txt");
  std::vector<Row> out;
  std::string line, kind, name;
  while (std::getline(in, line)) {
    std::istringstream s(line);
    s >> kind;
    if (kind == "bsdf") {
      s >> name;
    } else if (kind == "eval" || kind == "delta") {
      Row r{name, kind == "delta", {}, {}, {}, {}, 0};
      s >> r.uv.x >> r.uv.y >> r.wo.x >> r.wo.y >> r.wo.z >> r.wi.x >> r.wi.y >> r.wi.z >> r.f.r >> r.f.g >> r.f.b >>
          r.pdf;
      EXPECT_TRUE(s) << line;
      out.push_back(r);
    }
  }
  return out;
}

ShadingPoint point_of(const Row& row) {
  ShadingPoint p = test::plane_point(row.wo);
  p.dpdu = {0.8f, 0, 0.1f};
  p.dpdv = {-0.3f, 1.2f, 0.2f};
  p.uv = row.uv;
  return p;
}

/// Relative 2e-4 (single precision on both sides; 1e-3 where Mitsuba tabulates), with a floor for values that vanish.
void expect_near(float value, float expected, float tolerance, const std::string& what) {
  EXPECT_NEAR(value, expected, tolerance * std::abs(expected) + 2e-6f) << what;
}

TEST(BsdfReference, ValuesAndDensitiesAreMitsubas) {
  const TemporaryFolder folder;
  const auto known = materials(folder);
  std::map<std::string, int> checked;
  for (const Row& row : rows()) {
    const auto it = known.find(row.bsdf);
    ASSERT_NE(it, known.end()) << row.bsdf;
    const Bsdf bsdf = test::bsdf_of(*it->second, point_of(row));
    const float tolerance =
        row.bsdf.find("roughplastic") != std::string::npos || row.bsdf == "twosided" ? 1e-3f : 2e-4f;
    std::ostringstream what;
    what << row.bsdf << " wo " << row.wo.x << " " << row.wo.y << " " << row.wo.z << " wi " << row.wi.x << " "
         << row.wi.y << " " << row.wi.z;
    ++checked[row.bsdf];
    if (!row.delta) {
      const BsdfEval e = bsdf.eval(row.wo, row.wi);
      for (int c = 0; c < 3; ++c) expect_near(e.sum()[c], row.f[c], tolerance, what.str());
      expect_near(e.pdf, row.pdf, tolerance, what.str() + " pdf");
      continue;
    }
    bool found = false;
    for (int i = 0; i < 1000 && !found; ++i) {
      const auto s = bsdf.sample(row.wo, (float(i) + 0.5f) / 1000, {0.5f, 0.5f});
      if (!s || !s->delta || length(s->wi - row.wi) > 1e-4f) continue;
      found = true;
      for (int c = 0; c < 3; ++c) expect_near(s->sum()[c], row.f[c], tolerance, what.str());
      expect_near(s->pdf, row.pdf, tolerance, what.str() + " probability");
    }
    EXPECT_TRUE(found) << what.str() << ": no delta lobe in that direction";
  }
  for (const auto& [name, material] : known) EXPECT_GE(checked[name], 20) << name;
}

}  // namespace
}  // namespace tempera
