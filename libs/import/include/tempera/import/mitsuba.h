// SPDX-License-Identifier: Apache-2.0
#pragma once
// Mitsuba's XML scenes, dialects 0.6 and 3 (with <animation>). Names in camelCase and snake_case are the same; what the
// two dialects mean differently follows the version of the file. Differences from Mitsuba 3 on purpose: an emitted
// <spectrum> of one value is white in files of version 0.x (Mitsuba 3 makes it pinkish in both); uoffset adds after
// uscale, as 0.6 does; the sun of sky models has the power of Mitsuba's spectral variants, 5 to 8 % below its rgb
// variants. Parameters that only steer sampling are skipped in silence.
#include "tempera/import/import.h"

namespace tempera {

/// Scene of a Mitsuba XML file. Errors, threads: as `import_scene`.
Scene import_mitsuba(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings);

}  // namespace tempera
