// SPDX-License-Identifier: Apache-2.0
#include "tempera/import/import.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "catalog.h"

namespace tempera {
namespace {

#define X(name) &name##_importer,
constexpr std::array kImporters{TEMPERA_IMPORTERS(X)};
#undef X

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return c >= 'A' && c <= 'Z' ? char(c - 'A' + 'a') : char(c); });
  return text;
}

}  // namespace

std::span<const ImporterEntry* const> importers() { return kImporters; }

Scene import_scene(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings) {
  const std::string extension = lower_case(file.extension().string());
  std::string known;
  for (const ImporterEntry* importer : kImporters) {
    for (std::string_view e : importer->extensions) {
      if (e == extension) {
        Scene scene = importer->load(file, options, warnings);
        validate(scene);
        if (options.strict) warnings.report(true);
        return scene;
      }
      known += (known.empty() ? "" : ", ") + std::string(e);
    }
  }
  throw Error(ErrorCode::kUnsupported, {file.string()},
              fmt::format("no importer reads \"{}\" files; known extensions: {}", extension, known));
}

}  // namespace tempera
