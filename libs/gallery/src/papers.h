// SPDX-License-Identifier: Apache-2.0
#pragma once
// The papers of the gallery.
#include "tempera/gallery/gallery.h"

namespace tempera {

extern const GalleryPaper kManzi2016, kSchjoth2010, kWoestijne2017, kZhou2015, kZimmer2015;

}  // namespace tempera
