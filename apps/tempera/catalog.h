// SPDX-License-Identifier: Apache-2.0
#pragma once
// What exists to choose from, by category, read from the tables of the libraries: for `tempera list` and the manual.
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "tempera/core/params.h"

namespace tempera {

struct CatalogItem {
  std::string name, help;
  std::vector<ParamSpec> params;
  /// What else there is to say, e.g. {"reads", "color: the picture"}.
  std::vector<std::pair<std::string, std::string>> manual{};
};
struct CatalogCategory {
  std::string name, help;
  std::function<std::vector<CatalogItem>()> items;
};
const std::vector<CatalogCategory>& catalog();
/// What `tempera compare` measures.
std::vector<CatalogItem> metric_items();

/// "integer, 0 to 16", "number, at least 0", "box|trapezoid", "string".
std::string type_text(const ParamSpec& spec);

}  // namespace tempera
