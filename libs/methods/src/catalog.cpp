// SPDX-License-Identifier: Apache-2.0
// The list of methods: adding one is one line here.
#include <fmt/format.h>

#include "tempera/core/error.h"
#include "tempera/methods/method.h"

namespace tempera {

extern const MethodEntry path_entry;
extern const MethodEntry gradient_path_entry;
extern const MethodEntry temporal_gradient_path_entry;
extern const MethodEntry photon_entry;
extern const MethodEntry time_photon_entry;
extern const MethodEntry photon_differentials_entry;
extern const MethodEntry temporal_photon_entry;
extern const MethodEntry light_path_entry;

std::span<const MethodEntry* const> method_catalog() {
  static const MethodEntry* const entries[] = {
      &path_entry,        &gradient_path_entry,        &temporal_gradient_path_entry, &photon_entry,
      &time_photon_entry, &photon_differentials_entry, &temporal_photon_entry,        &light_path_entry,
  };
  return entries;
}

const MethodEntry& find_method(const std::string& name, const SourceLoc& loc) {
  std::vector<std::string> names;
  for (const MethodEntry* e : method_catalog()) {
    if (e->name == name) return *e;
    names.push_back(e->name);
  }
  throw Error(ErrorCode::kUnknownName, loc,
              fmt::format("unknown integrator \"{}\"; known: {}", name, nearest_names(name, names)));
}

}  // namespace tempera
