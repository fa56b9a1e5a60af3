// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/metric_catalog.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "metric_entry.h"
#include "tempera/core/error.h"

namespace tempera {
namespace {

Image scaled(const Image& image, float scale) {
  Image out = image;
  for (float& v : out.values()) v *= scale;
  return out;
}

const auto kEntries = std::to_array<MetricEntry>({
    {{.id = "relmse",
      .title = "relMSE",
      .help = "mean of squared differences over squared reference + epsilon",
      .formula = "mean over p, c of (T - R)^2 / (R^2 + epsilon), epsilon = 0.01",
      .source = "[Rousselle 2011]",
      .has_map = true,
      .is_default = true},
     [](const Pair& p, Image* map) -> Measured { return {relative_mse(p.test, p.reference, map, p.options.epsilon)}; }},
    {{.id = "mse",
      .title = "MSE",
      .help = "mean of squared differences",
      .formula = "mean over p, c of (T - R)^2",
      .has_map = true,
      .is_default = true},
     [](const Pair& p, Image* map) -> Measured { return {mse(p.test, p.reference, map)}; }},
    {{.id = "flip",
      .title = "FLIP",
      .help = "the difference that a person sees on a display when alternating between the two, 0 to 1",
      .formula = "mean over p of (delta E_c)^(1 - delta E_f)",
      .source = "[Andersson 2020]",
      .has_map = true,
      .is_default = true},
     [](const Pair& p, Image* map) -> Measured {
       const float scale = std::exp2(p.options.exposure);
       if (scale == 1) return {flip(p.test, p.reference, map, p.options.pixels_per_degree)};
       return {flip(scaled(p.test, scale), scaled(p.reference, scale), map, p.options.pixels_per_degree)};
     }},
    {{.id = "hdr_flip",
      .title = "HDR-FLIP",
      .help = "the largest FLIP of each pixel over all exposures, 0 to 1",
      .formula = "mean over p of the largest FLIP over exposures, tone mapped",
      .source = "[Andersson 2021]",
      .has_map = true},
     [](const Pair& p, Image* map) -> Measured {
       return {hdr_flip(p.test, p.reference, map, p.options.pixels_per_degree)};
     }},
});

}  // namespace

std::span<const MetricEntry> metric_entries() { return kEntries; }

std::span<const MetricInfo> metric_catalog() {
  static const std::vector<MetricInfo> infos = [] {
    std::vector<MetricInfo> out;
    for (const MetricEntry& e : kEntries) out.push_back(e.info);
    return out;
  }();
  return infos;
}

const MetricInfo* find_metric(std::string_view id) {
  for (const MetricInfo& m : metric_catalog()) {
    if (m.id == id) return &m;
  }
  return nullptr;
}

const MetricInfo& get_metric(std::string_view id) {
  if (const MetricInfo* m = find_metric(id)) return *m;
  std::vector<std::string> names;
  for (const MetricInfo& m : metric_catalog()) names.emplace_back(m.id);
  throw Error(ErrorCode::kUnknownName,
              fmt::format("unknown metric \"{}\"; known: {}", id, nearest_names(id, std::move(names))));
}

bool is_worse(const MetricInfo& metric, double value, double limit) {
  switch (metric.better) {
    case MetricBetter::kLower:
      return !(value <= limit);
    case MetricBetter::kHigher:
      return !(value >= limit);
    case MetricBetter::kNearZero:
      return !(std::abs(value) <= limit);
  }
  return true;
}

}  // namespace tempera
