// SPDX-License-Identifier: Apache-2.0
// How much of the ray tracer's speed the path tracer keeps: renders one frame on one thread while recording every ray,
// then traces the same rays in the same order in a bare loop over the same acceleration structure.
//
//   ray_rate SCENE [--width N] [--spp N] [--repeat N]
#include <dlfcn.h>
#include <embree3/rtcore.h>
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <string>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/import/import.h"
#include "tempera/methods/render_section.h"

namespace {

struct RecordedRay {
  RTCRay ray;
  bool shadow;
};
std::vector<RecordedRay>* g_record = nullptr;
RTCScene g_scene = nullptr;

template <class F>
F next_symbol(const char* name) {
  return reinterpret_cast<F>(dlsym(RTLD_NEXT, name));
}
const auto real_intersect = next_symbol<void (*)(RTCScene, RTCIntersectContext*, RTCRayHit*)>("rtcIntersect1");
const auto real_occluded = next_symbol<void (*)(RTCScene, RTCIntersectContext*, RTCRay*)>("rtcOccluded1");

}  // namespace

// The program's own definitions stand before the library's: the renderer's calls pass through here.
extern "C" void rtcIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit) {
  if (g_record) {
    g_record->push_back({rayhit->ray, false});
    g_scene = scene;
  }
  real_intersect(scene, context, rayhit);
}
extern "C" void rtcOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray) {
  if (g_record) {
    g_record->push_back({*ray, true});
    g_scene = scene;
  }
  real_occluded(scene, context, ray);
}

using namespace tempera;

static double seconds_of(const std::function<void()>& body) {
  const auto start = std::chrono::steady_clock::now();
  body();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

int main(int argc, char** argv) try {
  std::string file;
  int width = 256, spp = 8, repeat = 3;
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    if (i + 1 < argc && a == "--width")
      width = std::stoi(argv[++i]);
    else if (i + 1 < argc && a == "--spp")
      spp = std::stoi(argv[++i]);
    else if (i + 1 < argc && a == "--repeat")
      repeat = std::stoi(argv[++i]);
    else
      file = a;
  }
  if (file.empty()) {
    fmt::print(stderr, "usage: ray_rate SCENE [--width N] [--spp N] [--repeat N]\n");
    return 2;
  }
  Warnings warnings;
  const Scene scene = import_scene(file, {}, warnings);
  if (scene.cameras.empty()) {
    fmt::print(stderr, "{} has no camera\n", file);
    return 3;
  }
  RenderSettings settings;
  const double aspect = double(scene.defaults.width.value_or(16)) / double(scene.defaults.height.value_or(9));
  settings.width = width;
  settings.height = std::max(1, int(width / aspect));
  settings.spp = spp;
  settings.camera = scene.default_camera;
  Params params(find_method("path").params);
  if (scene.defaults.max_depth) params.set("max_depth", *scene.defaults.max_depth);
  const auto method = find_method("path").make(params);
  constexpr int kFrame = 1;
  GeometryCache cache;
  const LightPathClassifier classifier;
  SceneWindow window(scene, settings, classifier, settings.clock.frame_duration() / 4, cache, {kFrame, kFrame});
  window.frame(kFrame);
  const FlushDenormals flush;
  const auto render = [&] {
    Section section(*method, settings, scene, {kFrame, kFrame}, {kFrame}, method->passes(settings, {kFrame, kFrame}));
    with_threads(1, [&] { render_section(*method, window, section, {}, {}, {}); });
  };
  std::vector<RecordedRay> record;
  g_record = &record;
  render();
  g_record = nullptr;
  const auto replay = [&] {
    RTCIntersectContext rtc_context;
    for (const RecordedRay& r : record) {
      rtcInitIntersectContext(&rtc_context);
      if (r.shadow) {
        RTCRay ray = r.ray;
        real_occluded(g_scene, &rtc_context, &ray);
      } else {
        RTCRayHit hit;
        hit.ray = r.ray;
        hit.hit.geomID = hit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        real_intersect(g_scene, &rtc_context, &hit);
      }
    }
  };
  replay();
  double in_path = 1e30, bare = 1e30;
  for (int i = 0; i < repeat; ++i) {  // alternating, best of each: the machine may be shared
    in_path = std::min(in_path, seconds_of(render));
    bare = std::min(bare, seconds_of(replay));
  }
  const double n = double(record.size()), samples = double(settings.width) * settings.height * spp;
  fmt::print(
      "{{\"scene\": \"{}\", \"rays\": {}, \"rays_per_sample\": {:.2f}, \"path_mrays\": {:.3f}, \"bare_mrays\": {:.3f}, "
      "\"ratio\": {:.3f}, \"msamples\": {:.3f}}}\n",
      file, record.size(), n / samples, n / in_path * 1e-6, n / bare * 1e-6, bare / in_path, samples / in_path * 1e-6);
} catch (const Error& e) {
  fmt::print(stderr, "{}\n", e.what());
  return exit_status(e.code());
}
