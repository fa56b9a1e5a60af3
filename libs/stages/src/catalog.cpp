// SPDX-License-Identifier: Apache-2.0
// The stages: a declaration and a line in the list for each.
#include <fmt/format.h>

#include "tempera/stages/stage.h"

namespace tempera {

extern const StageEntry reconstruct_entry;
extern const StageEntry fill_entry;
extern const StageEntry denoise_entry;
extern const StageEntry upsample_entry;
extern const StageEntry interpolate_entry;
extern const StageEntry motionblur_entry;

std::span<const StageEntry* const> stage_catalog() {
  static const StageEntry* const entries[] = {
      // clang-format off
      &reconstruct_entry,
      &fill_entry,
      &denoise_entry,
      &upsample_entry,
      &interpolate_entry,
      &motionblur_entry,
      // clang-format on
  };
  return entries;
}

const StageEntry& find_stage(const std::string& name, const SourceLoc& loc) {
  std::vector<std::string> names;
  for (const StageEntry* e : stage_catalog()) {
    if (e->name == name) return *e;
    names.push_back(e->name);
  }
  throw Error(ErrorCode::kUnknownName, loc,
              fmt::format("unknown stage \"{}\"; known: {}", name, nearest_names(name, names)));
}

}  // namespace tempera
