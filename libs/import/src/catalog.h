// SPDX-License-Identifier: Apache-2.0
#pragma once
// The list of importers: a new one adds its line here and defines `<name>_importer` at the end of its file.
#include "tempera/import/import.h"

#define TEMPERA_IMPORTERS(X) \
  X(gltf)                    \
  X(mitsuba)

namespace tempera {

#define X(name) extern const ImporterEntry name##_importer;
TEMPERA_IMPORTERS(X)
#undef X

}  // namespace tempera
