// SPDX-License-Identifier: Apache-2.0
// Time of what a path tracer asks of shading at each hit: making a Bsdf, evaluating and sampling it, looking up a
// texture.
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/texture.h>
#include <benchmark/benchmark.h>

#include <filesystem>
#include <functional>

#include "tempera/core/random.h"
#include "tempera/shading/material.h"
#include "tempera/shading/spectrum.h"

namespace {

using namespace tempera;

float uniform(std::uint64_t i, std::uint64_t k) { return to_unit_float(std::uint32_t(hash_key(i, k) >> 32)); }
Vec3f direction(std::uint64_t i, std::uint64_t k) {
  return square_to_cosine_hemisphere({uniform(i, 2 * k), uniform(i, 2 * k + 1)});
}

struct Inputs {
  static constexpr std::size_t kCount = 1024;
  std::vector<ShadingPoint> points;
  std::vector<Vec3f> wi;
  std::vector<Vec3f> u;
  Inputs() {
    for (std::size_t i = 0; i < kCount; ++i) {
      ShadingPoint p;
      p.wo = direction(i, 1);
      p.ng = {0, 0, 1};
      p.dpdu = {1, 0, 0}, p.dpdv = {0, 1, 0};
      p.uv = {uniform(i, 10), uniform(i, 11)};
      points.push_back(p);
      wi.push_back(direction(i, 3));
      u.push_back({uniform(i, 12), uniform(i, 13), uniform(i, 14)});
    }
  }
};
const Inputs& inputs() {
  static const Inputs in;
  return in;
}

void build(benchmark::State& state, const MaterialPtr& m) {
  std::size_t i = 0;
  for (auto _ : state) {
    Bsdf bsdf;
    m->add_lobes(inputs().points[i++ % Inputs::kCount], 1, bsdf);
    benchmark::DoNotOptimize(bsdf);
  }
}
/// The work of one vertex: make the Bsdf, evaluate it for a light, sample it.
void vertex(benchmark::State& state, const MaterialPtr& m) {
  std::size_t i = 0;
  for (auto _ : state) {
    const std::size_t k = i++ % Inputs::kCount;
    const ShadingPoint& p = inputs().points[k];
    const Vec3f& u = inputs().u[k];
    Bsdf bsdf;
    m->add_lobes(p, 1, bsdf);
    if (bsdf.has_non_delta()) benchmark::DoNotOptimize(bsdf.eval(p.wo, inputs().wi[k]));
    benchmark::DoNotOptimize(bsdf.sample(p.wo, u.x, {u.y, u.z}));
  }
}

std::filesystem::path test_image() {
  const auto file = std::filesystem::temp_directory_path() / "tempera-shading-bench.png";
  constexpr int kSize = 1024;
  std::vector<std::uint8_t> v(kSize * kSize * 3);
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = std::uint8_t(hash_key(i));
  auto out = OIIO::ImageOutput::create(file.string());
  if (!out || !out->open(file.string(), {kSize, kSize, 3, OIIO::TypeUInt8}) ||
      !out->write_image(OIIO::TypeUInt8, v.data()))
    throw std::runtime_error("cannot write " + file.string());
  out->close();
  return file;
}

void lookup(benchmark::State& state, TextureFilter filter, bool paged) {
  if (paged) set_image_memory_budget(0);
  ImageTextureParams params;
  params.file = test_image();
  params.filter = filter;
  const auto texture = make_image_texture(params);
  set_image_memory_budget(std::size_t(1) << 30);
  std::size_t i = 0;
  for (auto _ : state) {
    ShadingPoint p = inputs().points[i++ % Inputs::kCount];
    p.duv_dx = {0.01f, 0}, p.duv_dy = {0, 0.005f};
    benchmark::DoNotOptimize(texture->rgb(p));
  }
}

/// The same lookup by OpenImageIO, without decoding sRGB.
void lookup_texture_system(benchmark::State& state) {
  auto* system = OIIO::TextureSystem::create(false);
  auto* handle = system->get_texture_handle(OIIO::ustring(test_image().string()));
  auto* thread = system->get_perthread_info();
  OIIO::TextureOpt options;
  options.swrap = options.twrap = OIIO::TextureOpt::WrapPeriodic;
  options.interpmode = OIIO::TextureOpt::InterpBilinear;
  options.mipmode = OIIO::TextureOpt::MipModeNoMIP;
  std::size_t i = 0;
  for (auto _ : state) {
    const Vec2f uv = inputs().points[i++ % Inputs::kCount].uv;
    float rgb[3];
    benchmark::DoNotOptimize(system->texture(handle, thread, options, uv.x, uv.y, 0, 0, 0, 0, 3, rgb));
  }
  OIIO::TextureSystem::destroy(system);
}

}  // namespace

int main(int argc, char** argv) {
  const auto gold = named_conductor("Au");
  const Roughness ggx{true, Microfacets::kGgx, 0.2f, 0.2f, true},
      beckmann{true, Microfacets::kBeckmann, 0.2f, 0.2f, true};
  MetallicRoughnessParams opaque;
  opaque.metallic = 0.0f, opaque.roughness = 0.4f;
  MetallicRoughnessParams everything = opaque;
  everything.metallic = 0.3f, everything.clearcoat = 0.8f, everything.sheen_color = 0.5f,
  everything.transmission = 0.3f;
  const std::pair<const char*, MaterialPtr> materials[] = {
      {"diffuse", make_diffuse(0.5f)},
      {"twosided_diffuse", make_two_sided(make_diffuse(0.5f))},
      {"conductor", make_conductor({gold->eta, gold->k, 1.0f, {}})},
      {"roughconductor_ggx", make_conductor({gold->eta, gold->k, 1.0f, ggx})},
      {"roughconductor_beckmann", make_conductor({gold->eta, gold->k, 1.0f, beckmann})},
      {"dielectric", make_dielectric({})},
      {"roughdielectric_ggx", make_dielectric({1.5f, 1, 1.0f, 1.0f, false, ggx})},
      {"plastic", make_plastic({})},
      {"roughplastic_ggx", make_plastic({1.5f, 1, 0.5f, 1.0f, true, ggx})},
      {"principled", make_principled({})},
      {"gltf", make_metallic_roughness(opaque)},
      {"gltf_everything", make_metallic_roughness(everything)},
  };
  for (const auto& [name, material] : materials) {
    benchmark::RegisterBenchmark((std::string("build/") + name).c_str(), build, material);
    benchmark::RegisterBenchmark((std::string("vertex/") + name).c_str(), vertex, material);
  }
  benchmark::RegisterBenchmark("texture/bilinear", lookup, TextureFilter::kBilinear, false);
  benchmark::RegisterBenchmark("texture/paged_bilinear", lookup, TextureFilter::kBilinear, true);
  benchmark::RegisterBenchmark("texture/mipmap", lookup, TextureFilter::kMipmap, false);
  benchmark::RegisterBenchmark("texture/openimageio_bilinear", lookup_texture_system);
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks();
}
