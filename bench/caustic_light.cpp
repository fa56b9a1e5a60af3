// SPDX-License-Identifier: Apache-2.0
// Light of the sun through mirrors and glass onto diffuse surfaces, for pictures of photons: traced apart, as their
// reference, or as the places of photons with their velocities.
//
//   caustic_light reference SHOT FRAME X0,Z0,X1,Z1 NX,NZ TIMES OUT.pfm [KEY=VALUE...]
//     The caustic that the shot's camera sees of the ground, in the green channel: NX x NZ rays straight down on the
//     rectangle at each of TIMES instants of the exposure, of 1 W/m^2. What is left of a ray below a ten-thousandth ends.
//   caustic_light photons SHOT FRAME PHOTONS [KEY=VALUE...]
//     A line "x z dx dz" for each photon that a method of photons stores, with its motion per frame. PHOTONS are emitted.
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/methods/method.h"
#include "tempera/photons/photon_tracer.h"
#include "tempera/pipeline/shot.h"
#include "tempera/transport/frame_scene.h"

using namespace tempera;

namespace {

constexpr float kLeastFlux = 1e-4f;

struct Rectangle {
  double x0, z0, x1, z1;
};

/// A picture that rays of one batch add to.
struct Film {
  const FrameContext& frame;
  std::vector<float> pixels;
  explicit Film(const FrameContext& f) : frame(f), pixels(std::size_t(f.settings.width) * f.settings.height) {}

  void add(const ShadingPoint& at, const Bsdf& bsdf, const Vec3f& wl, float flux, double t) {
    const auto seen = frame.camera.importance(at.p, {0.5f, 0.5f}, t);
    if (!seen) return;
    const Vec3f wc = -seen->ray.d;
    const float cos_g = std::max(std::abs(dot(at.ng, wl)), 1e-7f);
    const float value = flux / cos_g * bsdf.eval(wc, wl).sum().g * std::abs(dot(at.ng, wc)) * seen->we;
    const int x = int(std::floor(seen->pixel.x)), y = int(std::floor(seen->pixel.y));
    if (x < 0 || y < 0 || x >= frame.settings.width || y >= frame.settings.height) return;
    pixels[std::size_t(y) * frame.settings.width + x] += value;
  }
};

/// Follows light through all specular lobes and adds what arrives at diffuse ones after one of them.
void trace(Film& film, Ray ray, float flux, float initial, int edges, int max_edges) {
  const FrameContext& frame = film.frame;
  Hit hit;
  if (edges > max_edges || !frame.rays.intersect(ray, hit)) return;
  const Vec3f wl = -ray.d;
  ShadingPoint at = frame.rays.shading_point(hit.point, ray.time, wl);
  at.bends = false;
  Bsdf bsdf;
  make_bsdf(*frame.rays.shape(hit.point).material, at, bsdf);
  if (edges > 1 && bsdf.has_diffuse() && edges + 1 <= max_edges) film.add(at, bsdf, wl, flux, ray.time);
  const float cos_g = std::max(std::abs(dot(at.ng, wl)), 1e-7f);
  for (int i = 0; i < bsdf.size(); ++i) {
    if (!bsdf.is_delta(i)) continue;
    const auto s = bsdf.sample_delta(i, wl);
    if (!s) continue;
    const float next = flux * s->sum().g * delta_flux_factor(bsdf.frame(i).n, at.ng, wl, *s) / cos_g;
    if (!(next > kLeastFlux * initial)) continue;
    trace(film, {frame.rays.offset_origin(at.p, at.ng, s->wi), s->wi, 0, kInfinity, ray.time}, next, initial, edges + 1,
          max_edges);
  }
}

std::vector<float> reference(const FrameContext& frame, const Rectangle& lit, int nx, int nz, int times,
                             int max_edges) {
  const TimeSpan exposure = frame.settings.clock.exposure(frame.frame);
  const double top = double(frame.rays.bounds().hi.y) + 1;
  const double area = (lit.x1 - lit.x0) * (lit.z1 - lit.z0);
  const auto flux = float(area / (double(nx) * nz * times));
  std::vector<Film> films(std::size_t(times), Film{frame});
  parallel_for(0, times, [&](std::int64_t k) {
    const FlushDenormals flush;
    const double t = exposure.begin + exposure.length() * (double(k) + 0.5) / times;
    // Each instant has a grid of its own, moved by a part of its steps.
    const double u = std::fmod((double(k) + 0.5) * 0.7548776662466927, 1.0);
    const double v = std::fmod((double(k) + 0.5) * 0.5698402909980532, 1.0);
    for (int j = 0; j < nz; ++j) {
      for (int i = 0; i < nx; ++i) {
        const Vec3f o(Vec3d{lit.x0 + (lit.x1 - lit.x0) * (i + u) / nx, top, lit.z0 + (lit.z1 - lit.z0) * (j + v) / nz});
        trace(films[std::size_t(k)], {o, {0, -1, 0}, 0, kInfinity, t}, flux, flux, 1, max_edges);
      }
    }
  });
  for (std::size_t k = 1; k < films.size(); ++k) {
    for (std::size_t i = 0; i < films[0].pixels.size(); ++i) films[0].pixels[i] += films[k].pixels[i];
  }
  return films[0].pixels;
}

void write_pfm(const std::string& file, int width, int height, std::span<const float> pixels) {
  std::FILE* out = std::fopen(file.c_str(), "wb");
  if (!out) throw Error(ErrorCode::kBadInput, fmt::format("{}: cannot be written", file));
  fmt::print(out, "Pf\n{} {}\n-1.0\n", width, height);
  for (int y = height - 1; y >= 0; --y)
    std::fwrite(&pixels[std::size_t(y) * width], sizeof(float), std::size_t(width), out);
  std::fclose(out);
}

void print_photons(const FrameContext& frame, const Params& params, std::int64_t count, int max_edges) {
  const TimeSpan exposure = frame.settings.clock.exposure(frame.frame);
  const PhotonTracer tracer(frame, PhotonOptions(params), exposure, 0, count, max_edges);
  std::vector<Photon> photons;
  PhotonCounts counts;
  std::uint64_t rays = 0;
  for (std::int64_t i = 0; i < tracer.photons(); ++i) tracer.trace(i, photons, counts, rays);
  const auto frame_seconds = float(frame.settings.clock.frame_duration());
  for (const Photon& p : photons) {
    const Vec3f way = p.footprint.velocity() * frame_seconds;
    fmt::print("{:.5f} {:.5f} {:.5f} {:.5f}\n", p.footprint.center.x, p.footprint.center.z, way.x, way.z);
  }
}

}  // namespace

int main(int argc, char** argv) try {
  const std::vector<std::string> args(argv + 1, argv + argc);
  const bool photons = !args.empty() && args[0] == "photons";
  const std::size_t fixed = photons ? 4 : 7;
  if (args.size() < fixed || (!photons && args[0] != "reference")) {
    fmt::print(stderr,
               "usage: caustic_light reference SHOT FRAME X0,Z0,X1,Z1 NX,NZ TIMES OUT.pfm [KEY=VALUE...]\n"
               "       caustic_light photons SHOT FRAME PHOTONS [KEY=VALUE...]\n");
    return 2;
  }
  ShotConfig config = read_shot_config(args[1]);
  for (std::size_t i = fixed; i < args.size(); ++i) config.assign(args[i]);
  Warnings warnings;
  const LoadedShot loaded = load_shot(config, {}, warnings);
  const RenderSettings& settings = loaded.shot.settings;
  const LightPathClassifier classifier({kPhotonPaths});
  GeometryCache cache;
  const double step = settings.clock.frame_duration() / loaded.shot.motion_segments;
  const FrameScene scene(loaded.scene, settings, classifier, std::stoi(args[2]), step, cache);
  const int max_edges = loaded.shot.params.get_int("max_depth");
  if (photons) {
    print_photons(scene.context(), loaded.shot.params, std::stoll(args[3]), max_edges);
    return 0;
  }
  Rectangle lit{};
  if (std::sscanf(args[3].c_str(), "%lf,%lf,%lf,%lf", &lit.x0, &lit.z0, &lit.x1, &lit.z1) != 4)
    throw Error(ErrorCode::kBadInput, fmt::format("{} is no rectangle: x0,z0,x1,z1", args[3]));
  int nx = 0, nz = 0;
  if (std::sscanf(args[4].c_str(), "%d,%d", &nx, &nz) != 2 || nx < 1 || nz < 1)
    throw Error(ErrorCode::kBadInput, fmt::format("{} are no numbers of rays: nx,nz", args[4]));
  write_pfm(args[6], settings.width, settings.height,
            reference(scene.context(), lit, nx, nz, std::stoi(args[5]), max_edges));
  return 0;
} catch (const Error& e) {
  fmt::print(stderr, "caustic_light: {}\n", e.what());
  return 3;
}
