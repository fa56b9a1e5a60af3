// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <OpenImageIO/imageio.h>

#include <string>

#include "tempera/shading/color_space.h"

namespace tempera {

/// As file_color_space, for a file that is open. `name` is for warnings.
ColorSpace color_space_of(const OIIO::ImageInput& input, const std::string& name);

}  // namespace tempera
