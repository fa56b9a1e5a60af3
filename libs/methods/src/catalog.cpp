// SPDX-License-Identifier: Apache-2.0
// The list of integrators: adding one is one line here.
#include <fmt/format.h>

#include "tempera/core/error.h"
#include "tempera/methods/integrator.h"

namespace tempera {

extern const IntegratorEntry path_entry;
extern const IntegratorEntry gradient_path_entry;
extern const IntegratorEntry temporal_gradient_path_entry;

std::span<const IntegratorEntry* const> integrator_catalog() {
  static const IntegratorEntry* const entries[] = {
      &path_entry,
      &gradient_path_entry,
      &temporal_gradient_path_entry,
  };
  return entries;
}

const IntegratorEntry& find_integrator(const std::string& name, const SourceLoc& loc) {
  std::vector<std::string> names;
  for (const IntegratorEntry* e : integrator_catalog()) {
    if (e->name == name) return *e;
    names.push_back(e->name);
  }
  throw Error(ErrorCode::kUnknownName, loc,
              fmt::format("unknown integrator \"{}\"; known: {}", name, nearest_names(name, names)));
}

}  // namespace tempera
