// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/cryptomatte_names.h"

#include <fmt/format.h>

namespace tempera {

std::vector<std::string> cryptomatte_names(const Scene& scene) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const std::string& name = scene.instances[i].name;
    names.push_back(name.empty() ? fmt::format("instance_{}", i) : name);
  }
  return names;
}

}  // namespace tempera
