// SPDX-License-Identifier: Apache-2.0
#pragma once
// Mitsuba's XML scenes, dialects 0.6 and 3 (with <animation>), as documented by Mitsuba; what Mitsuba 3 and 0.6 read
// differently follows the file's version. Differences on purpose are listed in docs/formats.md.
#include "tempera/import/import.h"

namespace tempera {

/// Scene of a Mitsuba XML file. Errors, threads: as `import_scene`.
Scene import_mitsuba(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings);

}  // namespace tempera
