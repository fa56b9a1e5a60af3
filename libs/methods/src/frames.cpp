// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/cryptomatte.h"
#include "tempera/methods/method.h"
#include "tempera/transport/cryptomatte_names.h"

namespace tempera {

Frame make_frame(const Method& method, const RenderSettings& settings, const Scene& scene) {
  const int width = settings.x1() - settings.x0(), height = settings.y1() - settings.y0();
  Frame frame(width, height);
  bool cryptomatte = false;
  for (const LayerDesc& desc : method.outputs(settings)) {
    frame.create(desc);
    cryptomatte |= desc.name.starts_with("CryptoObject");
  }
  for (const LayerDesc& desc : method.work_layers(settings)) frame.create(desc);
  if (cryptomatte) {
    CryptomatteBuffer(width, height).write(frame, cryptomatte_names(scene), "CryptoObject", settings.cryptomatte_depth);
  }
  return frame;
}

std::vector<std::string> path_expressions(const Method& method, const RenderSettings& settings) {
  std::vector<std::string> out;
  for (const PathClass& c : settings.classes) out.push_back(c.expression);
  for (std::string& e : method.own_classes()) out.push_back(std::move(e));
  return out;
}

}  // namespace tempera
