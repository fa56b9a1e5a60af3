// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include "cryptomatte_names.h"
#include "tempera/frames/cryptomatte.h"
#include "tempera/integrators/integrator.h"

namespace tempera {

std::string RenderSettings::canonical() const {
  std::string s = fmt::format(
      "size={}x{} crop={},{},{},{} camera={} fps={} first={} start={} shutter={},{},{},{},{},{} spp={} seed={},{} "
      "sampler={} filter={},{} layers={} decomposition={} cryptomatte={}",
      width, height, crop_x, crop_y, crop_width, crop_height, camera, clock.fps, clock.first, clock.start,
      clock.shutter.open, clock.shutter.close, int(clock.shutter.shape), clock.shutter.ramp_in, clock.shutter.ramp_out,
      clock.shutter.rolling, spp, seed, seed_per_frame, int(sampler), filter_name(filter.kind()), filter.radius(),
      fmt::join(layers, ","), classes_are_decomposition, cryptomatte_depth);
  for (const float c : clock.shutter.curve) s += fmt::format(" {}", c);
  for (const PathClass& c : classes) s += fmt::format(" {}={}", c.name, c.expression);
  if (!cuts.empty()) s += fmt::format(" cuts={}", fmt::join(cuts, ","));
  return s;
}

std::vector<std::string> cryptomatte_names(const Scene& scene) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const std::string& name = scene.instances[i].name;
    names.push_back(name.empty() ? fmt::format("instance_{}", i) : name);
  }
  return names;
}

Frame make_frame(const Integrator& integrator, const RenderSettings& settings, const Scene& scene) {
  const int width = settings.x1() - settings.x0(), height = settings.y1() - settings.y0();
  Frame frame(width, height);
  bool cryptomatte = false;
  for (const LayerDesc& desc : integrator.outputs(settings)) {
    frame.create(desc);
    cryptomatte |= desc.name.starts_with("CryptoObject");
  }
  for (const LayerDesc& desc : integrator.work_layers(settings)) frame.create(desc);
  if (cryptomatte) {
    CryptomatteBuffer(width, height).write(frame, cryptomatte_names(scene), "CryptoObject", settings.cryptomatte_depth);
  }
  return frame;
}

void finish_frame(const Integrator& integrator, const FrameContext& context, Frame& frame) {
  integrator.finish(context, frame);
  for (const LayerDesc& desc : integrator.work_layers(context.settings)) frame.remove(desc.name);
}

}  // namespace tempera
