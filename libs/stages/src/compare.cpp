// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "metric_entry.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/frame.h"

namespace tempera {
namespace {

/// One run of one side, and what has been measured of it.
struct Run {
  std::size_t side = 0, index = 0;  ///< index: within its side
  const FrameSequence* sequence = nullptr;
  std::vector<std::vector<Measured>> values;  ///< [metric][frame of the side]
  Image image;                                ///< of the current frame
};

std::vector<const MetricEntry*> chosen_metrics(const CompareOptions& options) {
  const auto asked = [&](std::string_view id) {
    return std::find(options.metrics.begin(), options.metrics.end(), id) != options.metrics.end();
  };
  const bool all = asked("all"), defaults = asked("default") || options.metrics.empty();
  for (const std::string& id : options.metrics) {
    if (id != "all" && id != "default") get_metric(id);
  }
  std::vector<const MetricEntry*> out;
  for (const MetricEntry& e : metric_entries()) {
    if (all || (defaults && e.info.is_default) || asked(e.info.id)) out.push_back(&e);
  }
  return out;
}

/// The series of a metric from the values of each run of a side.
MetricSeries series_of(const MetricInfo& metric, const std::vector<const std::vector<Measured>*>& runs) {
  MetricSeries s;
  s.metric = &metric;
  const std::size_t frames = runs[0]->size();
  bool partial = false;
  std::vector<double> over_runs(runs.size());
  for (std::size_t f = 0; f < frames; ++f) {
    double coverage = 0;
    for (std::size_t r = 0; r < runs.size(); ++r) {
      over_runs[r] = (*runs[r])[f].value;
      coverage += (*runs[r])[f].coverage / double(runs.size());
    }
    s.values.push_back(mean_error(over_runs).mean);
    s.coverage.push_back(coverage);
    partial |= coverage < 1;
  }
  if (!partial) s.coverage.clear();
  s.mean = mean_error(s.values);
  if (runs.size() > 1) {
    for (std::size_t r = 0; r < runs.size(); ++r) {
      std::vector<double> values;
      for (const Measured& m : *runs[r]) values.push_back(m.value);
      over_runs[r] = mean_error(values).mean;
    }
    s.mean = mean_error(over_runs);
  }
  return s;
}

/// Which frames each side is compared in.
CompareSide plan_side(const CompareInput& input, const FrameSequence& reference, const CompareOptions& options) {
  CompareSide side;
  side.name = input.name;
  for (const FrameSequence& r : input.runs) side.runs.push_back(r.pattern());
  const bool still = reference.frames().size() == 1;
  const auto wanted = [&](int f) {
    return options.frames.empty() || std::find(options.frames.begin(), options.frames.end(), f) != options.frames.end();
  };
  const auto in_all_runs = [&](int f) {
    return std::all_of(input.runs.begin(), input.runs.end(), [&](const FrameSequence& r) { return r.has(f); });
  };
  for (const int f : input.runs.at(0).frames()) {
    if (!wanted(f) || !in_all_runs(f)) continue;
    (still || reference.has(f) ? side.frames : side.unmatched).push_back(f);
  }
  if (side.frames.empty()) {
    throw Error(ErrorCode::kBadInput,
                fmt::format("{} and the reference {} have no frame to compare", input.name, reference.pattern()));
  }
  if (!still) {
    for (const int f : reference.frames()) {
      if (wanted(f) && f > side.frames.front() && f < side.frames.back() &&
          !std::binary_search(side.frames.begin(), side.frames.end(), f)) {
        side.missing.push_back(f);
      }
    }
  }
  return side;
}

/// The parts of `names` between the folders that all of them begin and end with: "path" and "mlt" of "out/path/f.exr"
/// and "out/mlt/f.exr".
std::vector<std::string> labels_of(const std::vector<std::string>& names) {
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

Image load_layer(const std::string& path, const std::string& layer) {
  ReadOptions read;
  read.layers = {layer};
  Frame f = read_frame(path, read);
  return std::move(f.layer(layer));
}

}  // namespace

void CompareObserver::reference(int, const Image&, const Image*, const Image*) {}
void CompareObserver::test(std::size_t, int, const Image&, const std::function<const Image*(std::string_view)>&) {}

const MetricSeries* CompareSide::find(std::string_view id) const {
  for (const MetricSeries& s : series) {
    if (s.metric->id == id) return &s;
  }
  return nullptr;
}

CompareInput parse_compare_input(const std::string& text) {
  CompareInput input;
  input.name = text;
  std::string pattern = text;
  const auto equals = text.find('=');
  if (equals != std::string::npos && equals > 0 && text.find('/') > equals && !std::filesystem::exists(text)) {
    input.name = text.substr(0, equals);
    pattern = text.substr(equals + 1);
  }
  input.runs.emplace_back(pattern);
  return input;
}

CompareResult compare_sequences(const std::vector<CompareInput>& tests, const FrameSequence& reference,
                                const CompareOptions& options, const CompareProgress& progress,
                                CompareObserver* observer) {
  CompareResult result;
  result.reference = reference.pattern();
  result.options = options;
  const std::vector<const MetricEntry*> metrics = chosen_metrics(options);
  for (const MetricEntry* m : metrics) result.metrics.push_back(find_metric(m->info.id));
  std::vector<std::string> maps;
  if (observer) maps = observer->maps();

  std::vector<Run> runs;
  std::set<int> all_frames;
  int total = 0, done = 0;
  for (const CompareInput& input : tests) {
    CompareSide side = plan_side(input, reference, options);
    side.non_finite.assign(side.frames.size(), 0);
    all_frames.insert(side.frames.begin(), side.frames.end());
    for (std::size_t r = 0; r < input.runs.size(); ++r) {
      runs.push_back({result.sides.size(), r, &input.runs[r], {}, {}});
      runs.back().values.assign(metrics.size(), std::vector<Measured>(side.frames.size()));
      total += int(side.frames.size());
    }
    result.sides.push_back(std::move(side));
  }

  std::vector<std::string> names;
  for (const CompareSide& s : result.sides) names.push_back(s.name);
  const std::vector<std::string> labels = labels_of(names);
  for (std::size_t s = 0; s < labels.size(); ++s) result.sides[s].label = labels[s];

  const bool still = reference.frames().size() == 1;
  Image expected;
  std::string expected_path;
  for (const int frame : all_frames) {
    const std::string path = reference.path(still ? reference.frames()[0] : frame);
    std::vector<Run*> now;
    for (Run& r : runs) {
      const std::vector<int>& frames = result.sides[r.side].frames;
      if (std::binary_search(frames.begin(), frames.end(), frame)) now.push_back(&r);
    }
    parallel_for(-1, std::int64_t(now.size()), [&](std::int64_t i) {
      if (i >= 0) {
        Run& r = *now[std::size_t(i)];
        r.image = load_layer(r.sequence->path(frame), options.layer);
      } else if (path != expected_path) {
        expected = load_layer(path, options.layer);
      }
    });
    expected_path = path;
    result.width = expected.width(), result.height = expected.height();
    if (observer) observer->reference(frame, expected, nullptr, nullptr);
    for (Run* r : now) {
      CompareSide& side = result.sides[r->side];
      const auto at =
          std::size_t(std::lower_bound(side.frames.begin(), side.frames.end(), frame) - side.frames.begin());
      if (r->image.width() != expected.width() || r->image.height() != expected.height()) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("{} has {}x{} pixels, the reference {} has {}x{}", r->sequence->path(frame),
                                r->image.width(), r->image.height(), path, expected.width(), expected.height()));
      }
      const Pair pair{r->image, expected, options};
      std::map<std::string, Image, std::less<>> drawn;
      const bool observed = observer && r->index == 0;
      for (std::size_t m = 0; m < metrics.size(); ++m) {
        const std::string id(metrics[m]->info.id);
        const bool wanted = observed && std::find(maps.begin(), maps.end(), id) != maps.end();
        r->values[m][at] = metrics[m]->measure(pair, wanted ? &drawn[id] : nullptr);
      }
      if (observed) {
        for (const std::string& id : maps) {  // those that are not measured
          for (const MetricEntry& e : metric_entries()) {
            if (e.info.id == id && !drawn.contains(id)) e.measure(pair, &drawn[id]);
          }
        }
        observer->test(r->side, frame, r->image, [&](std::string_view id) -> const Image* {
          const auto found = drawn.find(id);
          return found == drawn.end() || found->second.empty() ? nullptr : &found->second;
        });
      }
      side.non_finite[at] += count_non_finite(r->image);
      if (progress) progress(++done, total);
    }
  }

  for (std::size_t s = 0; s < result.sides.size(); ++s) {
    for (std::size_t m = 0; m < metrics.size(); ++m) {
      std::vector<const std::vector<Measured>*> values;
      for (const Run& r : runs) {
        if (r.side == s) values.push_back(&r.values[m]);
      }
      result.sides[s].series.push_back(series_of(*result.metrics[m], values));
    }
  }
  return result;
}

}  // namespace tempera
