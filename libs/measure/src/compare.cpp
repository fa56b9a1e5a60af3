// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "comparison.h"

namespace tempera {

std::vector<std::string> distinguishing_labels(const std::vector<std::string>& names) {
  if (names.size() == 1) return names;
  std::vector<std::vector<std::string>> parts;
  for (const std::string& name : names) {
    auto& p = parts.emplace_back();
    for (const std::filesystem::path& folder : std::filesystem::path(name)) p.push_back(folder.string());
  }
  const auto all_have = [&](auto&& part) {
    return std::all_of(parts.begin(), parts.end(),
                       [&](const auto& p) { return p.size() > 1 && part(p) == part(parts[0]); });
  };
  while (all_have([](const auto& p) { return p.front(); })) {
    for (auto& p : parts) p.erase(p.begin());
  }
  while (all_have([](const auto& p) { return p.back(); })) {
    for (auto& p : parts) p.pop_back();
  }
  std::vector<std::string> out;
  for (const auto& p : parts) out.push_back(fmt::format("{}", fmt::join(p, "/")));
  return out;
}

void CompareObserver::reference(int, const Image&, const Image*, const Image*) {}
void CompareObserver::test(std::size_t, int, const Image&, const std::function<const Image*(std::string_view)>&) {}

const MetricSeries* CompareSide::find(std::string_view id) const {
  for (const MetricSeries& s : series) {
    if (s.metric->id == id) return &s;
  }
  return nullptr;
}

CompareResult compare_sequences(const std::vector<CompareInput>& tests, const FrameSequence& reference,
                                const CompareOptions& options, const CompareProgress& progress,
                                CompareObserver* observer) {
  return Comparison(tests, reference, options, progress, observer).run();
}

}  // namespace tempera
