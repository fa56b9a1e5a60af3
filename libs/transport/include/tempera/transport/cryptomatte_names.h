// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "tempera/scene/scene.h"

namespace tempera {

/// The cryptomatte name of each instance: its object name, or "instance_<index>" without one.
std::vector<std::string> cryptomatte_names(const Scene& scene);

}  // namespace tempera
