// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/compare.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <optional>

#include "catalog.h"
#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/frames/display.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"
#include "tempera/report/report.h"

namespace tempera {

namespace {

/// get_metric with the command line as the place of errors.
const MetricInfo& named_metric(const std::string& name) {
  try {
    return get_metric(name);
  } catch (const Error& e) {
    throw Error(e.code(), ShotConfig::kCommandLine(), e.message());
  }
}

std::vector<std::string> split_list(const std::string& text) {
  std::vector<std::string> out;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t comma = std::min(text.find(',', at), text.size());
    out.push_back(text.substr(at, comma - at));
    at = comma + 1;
  }
  return out;
}

struct Flags {
  std::vector<std::string> tests, thresholds;
  std::string reference, metrics = "default", frames, where, csv, json, error_map, html, title, tone_map = "srgb";
  double trim_percent = 0, html_scale_percent = 100;
  CompareOptions options;
  int threads = 0;
};

/// A value of --threshold.
struct Limit {
  const MetricInfo* metric = nullptr;
  double value = 0;
  bool of_mean = false;  ///< whether it limits the sequence and not each of its frames
};

/// "relmse=0.01" or "mean.relmse=0.01". Errors: Error{kUsage}.
Limit parse_limit(const std::string& text) {
  constexpr std::string_view kMean = "mean.";
  const auto equals = text.find('=');
  const char* const end = text.data() + text.size();
  Limit limit;
  if (equals != std::string::npos) {
    const auto [next, ec] = std::from_chars(text.data() + equals + 1, end, limit.value);
    if (ec == std::errc() && next == end && std::isfinite(limit.value)) {
      limit.of_mean = text.starts_with(kMean);
      const std::size_t begin = limit.of_mean ? kMean.size() : 0;
      limit.metric = &named_metric(text.substr(begin, equals - begin));
      return limit;
    }
  }
  throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
              fmt::format("--threshold \"{}\" is not of the form METRIC=VALUE; write for example relmse=0.01 for each "
                          "frame or mean.relmse=0.01 for the mean",
                          text));
}

/// "object_id=9". Errors: Error{kUsage}.
Region parse_region(const std::string& text) {
  const auto equals = text.find('=');
  Region region{text.substr(0, equals)};
  if (equals != std::string::npos && equals > 0) {
    const char* const end = text.data() + text.size();
    const auto [next, ec] = std::from_chars(text.data() + equals + 1, end, region.value);
    if (ec == std::errc() && next == end && std::isfinite(region.value)) return region;
  }
  throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
              fmt::format("--where \"{}\" is not of the form LAYER=VALUE; write for example object_id=9", text));
}

/// What of `result` passes the limits, a sentence each.
std::vector<std::string> passed_limits(const CompareResult& result, const std::vector<Limit>& limits) {
  std::vector<std::string> passed;
  if (limits.empty()) return passed;
  for (const CompareSide& side : result.sides) {
    const auto check = [&](const Limit& l, double value, const std::string& where) {
      if (!is_worse(*l.metric, value, l.value)) return;
      const char* const relation = l.metric->better == MetricBetter::kHigher ? "below" : "above";
      passed.push_back(
          fmt::format("{} of {}{} is {:.6g}, {} {:g}", l.metric->id, where, side.name, value, relation, l.value));
    };
    for (const Limit& l : limits) {
      const MetricSeries* const series = side.find(l.metric->id);
      if (l.of_mean || series->values.empty()) {
        check(l, series->mean.mean, "");
        continue;
      }
      // Of pairs, the first frame and those after a gap have no value; gaps are counted below. Nor has a frame without
      // pixels of the region.
      for (std::size_t f = 0; f < side.frames.size(); ++f) {
        const bool may_lack = l.metric->scope == MetricScope::kPair || result.options.where;
        if (may_lack && std::isnan(series->values[f])) continue;
        check(l, series->values[f], fmt::format("frame {} of ", side.frames[f]));
      }
    }
    for (std::size_t f = 0; f < side.frames.size(); ++f) {
      if (side.non_finite[f] > 0) {
        passed.push_back(
            fmt::format("{} pixels of frame {} of {} are not finite", side.non_finite[f], side.frames[f], side.name));
      }
    }
    for (const int f : side.missing) passed.push_back(fmt::format("frame {} of {} is missing", f, side.name));
  }
  return passed;
}

bool is_png(const std::string& path) { return has_extension(path, ".png"); }

/// Writes a metric of each pixel for the frames of the first test.
class ErrorMaps final : public CompareObserver {
 public:
  ErrorMaps(std::string pattern, const MetricInfo& metric) : pattern_(std::move(pattern)), metric_(metric) {}

  std::vector<std::string> maps() const override { return {std::string(metric_.id)}; }
  void test(std::size_t, int frame, const Image&, const std::function<const Image*(std::string_view)>& map) override {
    const Image* const values = map(metric_.id);
    if (!values) return;
    const std::string path = frame_path(pattern_, frame);
    if (is_png(path)) {
      write_png(path, *values, {.exposure = 0, .tone_map = ToneMap::kNone});
    } else {
      Frame out(values->width(), values->height());
      out.add({std::string(metric_.id), {"Y"}, "difference", Combine::kMean}, *values);
      write_frame(path, out);
    }
  }

 private:
  std::string pattern_;
  const MetricInfo& metric_;
};

/// Passes what it sees on to others.
class Observers final : public CompareObserver {
 public:
  void add(CompareObserver& observer) { all_.push_back(&observer); }
  std::vector<std::string> maps() const override {
    std::vector<std::string> out;
    for (const CompareObserver* o : all_) {
      for (std::string& id : o->maps()) out.push_back(std::move(id));
    }
    return out;
  }
  bool motion() const override {
    return std::any_of(all_.begin(), all_.end(), [](const CompareObserver* o) { return o->motion(); });
  }
  void reference(int frame, const Image& image, const Image* backward, const Image* forward) override {
    for (CompareObserver* o : all_) o->reference(frame, image, backward, forward);
  }
  void test(std::size_t side, int frame, const Image& image,
            const std::function<const Image*(std::string_view)>& map) override {
    for (CompareObserver* o : all_) o->test(side, frame, image, map);
  }

 private:
  std::vector<CompareObserver*> all_;
};

/// Writes the report and says how large it is, as browsers have limits.
void finish_report(ReportWriter& report, const CompareResult& result, const std::string& path) {
  const double megabytes = double(report.finish(result)) / 1e6;
  std::printf("%s: %.1f MB\n", path.c_str(), megabytes);
  if (megabytes > 400) {
    log_warning(
        fmt::format("{} is large for a browser; --html-scale 50 makes it a quarter, --frames leaves out frames", path));
  }
}

void compare(const Flags& flags, const std::stop_token& stop) {
  CompareOptions options = flags.options;
  options.metrics = split_list(flags.metrics);
  const MetricInfo* drawn = nullptr;  // the first metric that can be drawn
  for (const std::string& name : options.metrics) {
    if (name == "default" || name == "all") continue;
    const MetricInfo& m = named_metric(name);
    if (!drawn && m.has_map) drawn = &m;
  }
  std::vector<Limit> limits;
  for (const std::string& t : flags.thresholds) {
    for (const std::string& limit : split_list(t)) {
      limits.push_back(parse_limit(limit));
      options.metrics.emplace_back(limits.back().metric->id);
    }
  }
  options.trim = flags.trim_percent / 100;
  if (!flags.where.empty()) options.where = parse_region(flags.where);
  if (!flags.frames.empty()) options.frames = parse_frame_set(flags.frames);
  if (!flags.error_map.empty() && flags.tests.size() > 1) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(), "--error-map takes one picture or sequence at a time");
  }
  if (!flags.error_map.empty() && !is_png(flags.error_map) && !has_extension(flags.error_map, ".exr")) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                fmt::format("--error-map \"{}\" must end in .png or .exr", flags.error_map));
  }
  if (options.where && !flags.html.empty()) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                "--where measures a part of the picture, --html shows all");
  }
  if (flags.reference.empty() && !options.reference2.empty()) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(), "--reference2 needs a first one: --reference");
  }
  const bool measures = !limits.empty() || !flags.csv.empty() || !flags.json.empty() || !flags.error_map.empty();
  if (flags.reference.empty() && (flags.html.empty() || measures)) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                "--reference is missing: without it, sequences can only be shown side by side, with --html");
  }

  std::vector<CompareInput> tests;
  for (const std::string& t : flags.tests) tests.push_back(parse_compare_input(t));
  const bool terminal = isatty(STDERR_FILENO);
  const auto begin = std::chrono::steady_clock::now();
  const CompareProgress progress = [&](int done, int total) {
    if (terminal) {
      const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
      std::fprintf(stderr, "\r\033[K%d of %d pictures, %.0f s left", done, total,
                   std::ceil(seconds * (total - done) / done));
    }
    if (stop.stop_requested()) throw Error(ErrorCode::kCancelled, "stopped; nothing was written");
  };
  std::optional<FrameSequence> reference;
  if (!flags.reference.empty()) reference.emplace(flags.reference);
  std::optional<ReportWriter> report;
  if (!flags.html.empty()) {
    report.emplace(flags.html, tests, reference ? &*reference : nullptr, options,
                   ReportOptions{.title = flags.title,
                                 .display = {.exposure = options.exposure, .tone_map = parse_tone_map(flags.tone_map)},
                                 .scale = flags.html_scale_percent / 100});
  }
  if (!reference) {
    const CompareResult shown = show_sequences(tests, options, *report, progress);
    if (terminal) std::fprintf(stderr, "\r\033[K");
    finish_report(*report, shown, flags.html);
    return;
  }
  Observers observers;
  std::optional<ErrorMaps> maps;
  if (!flags.error_map.empty()) {
    const bool single = tests[0].runs[0].frames().size() == 1;
    maps.emplace(single ? flags.error_map : numbered_pattern(flags.error_map), drawn ? *drawn : get_metric("relmse"));
    observers.add(*maps);
  }
  if (report) observers.add(*report);
  const CompareResult result = compare_sequences(tests, *reference, options, progress, &observers);
  if (terminal) std::fprintf(stderr, "\r\033[K");
  std::printf("%s", to_table(result).c_str());
  if (!flags.csv.empty()) write_file(flags.csv, to_csv(result));
  if (!flags.json.empty()) write_file(flags.json, to_json(result));
  if (report) finish_report(*report, result, flags.html);

  const std::vector<std::string> passed = passed_limits(result, limits);
  if (passed.empty()) return;
  throw Error(ErrorCode::kDiffers, passed[0] + (passed.size() > 1 ? fmt::format(" ({} more)", passed.size() - 1) : ""));
}

}  // namespace

std::vector<CatalogItem> metric_items() {
  std::vector<CatalogItem> out;
  for (const MetricInfo& m : metric_catalog()) {
    out.push_back({std::string(m.id), fmt::format("{}{}", m.help, m.is_default ? " (default)" : ""), {}});
  }
  return out;
}

void add_compare(Program& program) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = program.add(
      "compare", "Measure how far pictures or sequences are from a reference.",
      {"tempera compare out/noisy.####.exr --reference out/ref.####.exr",
       "tempera compare a.exr b.exr --reference ref.exr --metrics relmse --csv figures.csv",
       "tempera compare path=out/path/f.####.exr mlt=out/mlt/f.####.exr -r out/ref/f.####.exr --html report.html",
       "tempera compare a.exr --reference ref.exr --threshold flip=0.05 --error-map diff.png",
       "tempera compare 'out/seed*/f.####.exr' -r ref.exr --metrics relmse,bias_squared,variance",
       "tempera compare out/f.####.exr -r ref/seed1/f.####.exr --reference2 ref/seed2/f.####.exr",
       "tempera compare out/f.####.exr -r ref.####.exr --threshold mean.relmse=0.01,ssim=0.9,flicker=1e-4"},
      [&program, flags] {
        with_threads(flags->threads, [&] { compare(*flags, program.stop); });
        return 0;
      });
  command
      ->add_option(
          "tests", flags->tests,
          "pictures, folders or sequences to judge, [NAME=]PATTERN; * makes a group of runs with different seeds")
      ->required()
      ->type_name("TEST...");
  command
      ->add_option("-r,--reference", flags->reference,
                   "what they should look like; a single picture serves all frames; only --html can do without")
      ->type_name("REFERENCE");
  command
      ->add_option(
          "--reference2", flags->options.reference2,
          "a second one of another seed: takes the noise of both out of squared metrics, others use their mean")
      ->type_name("REFERENCE");
  command
      ->add_option("--metrics", flags->metrics,
                   "what to measure: default, all, and names that tempera list metrics shows [default]")
      ->type_name("A,B,C");
  command->add_option("-f,--frames", flags->frames, "frames to compare [all that both have]")->type_name("SET");
  command->add_option("--layer", flags->options.layer, "layer to compare [color]")->type_name("NAME");
  command->add_option("--exposure", flags->options.exposure, "stops, for psnr, ssim, flip and flicker_display [0]")
      ->type_name("STOPS")
      ->check(CLI::Range(-64.0, 64.0).description(""));
  command
      ->add_option("--trim", flags->trim_percent,
                   "leave out the pixels with the largest errors, of squared errors; 0.1 is usual [0]")
      ->type_name("PERCENT")
      ->check(CLI::Range(0.0, 50.0).description(""));
  command
      ->add_option("--where", flags->where,
                   "only the pixels whose layer LAYER of the reference is VALUE, e.g. object_id=9; of squared errors")
      ->type_name("LAYER=VALUE");
  command
      ->add_option("--cutoff", flags->options.cutoff,
                   "frequency above which residuals are flicker, in cycles per frame [0.25]")
      ->type_name("F")
      ->check(CLI::Range(0.001, 0.499).description(""));
  command->add_option("--motion", flags->options.motion, "files with the reference's motion vectors [the reference]")
      ->type_name("PATTERN");
  command
      ->add_option(
          "--threshold", flags->thresholds,
          "end with status 6 if a frame is worse than this, or for mean.METRIC the sequence; several with commas")
      ->allow_extra_args(false)
      ->type_name("METRIC=VALUE");
  command->add_option("--csv", flags->csv, "also write all figures to this file")->type_name("FILE");
  command->add_option("--json", flags->json, "also write all figures to this file")->type_name("FILE");
  command
      ->add_option("--error-map", flags->error_map,
                   "write the first metric that --metrics names, of each pixel, .png or .exr")
      ->type_name("PATTERN");
  command->add_option("--html", flags->html, "write a page that shows and measures the sequences side by side")
      ->type_name("FILE");
  command->add_option("--title", flags->title, "of the page [the names of the sequences]")->type_name("TEXT");
  command->add_option("--tone-map", flags->tone_map, "that the page begins with: srgb, filmic, none [srgb]")
      ->type_name("NAME");
  command
      ->add_option("--html-scale", flags->html_scale_percent,
                   "percentage of the frames' size that the page stores [100]")
      ->type_name("PERCENT")
      ->check(CLI::Range(1.0, 100.0).description(""));
  command->add_option("--threads", flags->threads, "threads; 0: one per core [0]")
      ->type_name("N")
      ->check(CLI::Range(0, 4096).description(""));
}

}  // namespace tempera
