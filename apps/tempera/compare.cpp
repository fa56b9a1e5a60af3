// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/compare.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>

#include "catalog.h"
#include "program.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/frames/display.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"

namespace tempera {

namespace {

/// A figure that can be asked for, limited and drawn as a map.
struct Metric {
  const char* name;
  const char* help;
  double FrameFigures::*value;
  double (*map)(const Image& test, const Image& reference, const CompareOptions& options, Image& out);
};
constexpr std::array<Metric, 4> kMetrics{{
    {"relmse", "mean of squared differences over squared reference + epsilon", &FrameFigures::relative_mse,
     [](const Image& a, const Image& b, const CompareOptions& o, Image& out) {
       return relative_mse(a, b, &out, o.epsilon);
     }},
    {"mse", "mean of squared differences", &FrameFigures::mse,
     [](const Image& a, const Image& b, const CompareOptions&, Image& out) { return mse(a, b, &out); }},
    {"flip", "FLIP: the difference that a person sees on a display, 0 to 1", &FrameFigures::flip,
     [](const Image& a, const Image& b, const CompareOptions& o, Image& out) {
       return flip(a, b, &out, o.pixels_per_degree);
     }},
    {"hdr_flip", "HDR-FLIP: the largest FLIP over all exposures", &FrameFigures::hdr_flip,
     [](const Image& a, const Image& b, const CompareOptions& o, Image& out) {
       return hdr_flip(a, b, &out, o.pixels_per_degree);
     }},
}};

const Metric& find_metric(const std::string& name) {
  std::vector<std::string> names;
  for (const Metric& m : kMetrics) {
    if (m.name == name) return m;
    names.emplace_back(m.name);
  }
  throw Error(ErrorCode::kUnknownName, ShotConfig::kCommandLine(),
              fmt::format("unknown metric \"{}\"; known: {}", name, nearest_names(name, names)));
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
  std::string reference, metrics = "relmse,mse,flip", frames, csv, json, error_map;
  CompareOptions options;
  int threads = 0;
};

struct Limit {
  const Metric* metric;
  double value = 0;
};

/// "relmse=0.01". Errors: Error{kUsage}.
Limit parse_limit(const std::string& text) {
  const auto equals = text.find('=');
  const char* const end = text.data() + text.size();
  double value = 0;
  if (equals != std::string::npos) {
    const auto [next, ec] = std::from_chars(text.data() + equals + 1, end, value);
    if (ec == std::errc() && next == end && value >= 0) return {&find_metric(text.substr(0, equals)), value};
  }
  throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
              fmt::format("--threshold \"{}\" is not of the form METRIC=VALUE; write for example relmse=0.01", text));
}

/// Writes the first metric of each pixel for the frames of the only test.
void write_error_maps(const Flags& flags, const Metric& metric, const FrameSequence& test,
                      const FrameSequence& reference, const CompareSide& side) {
  for (const FrameFigures& f : side.frames) {
    const int other = reference.frames().size() == 1 ? reference.frames()[0] : f.frame;
    const ReadOptions layer{{flags.options.layer}};
    Image map;
    metric.map(read_frame(test.path(f.frame), layer).layer(flags.options.layer),
               read_frame(reference.path(other), layer).layer(flags.options.layer), flags.options, map);
    const bool numbered = side.frames.size() > 1 || has_frame_pattern(flags.error_map);
    const std::string path = numbered ? frame_path(flags.error_map, f.frame) : flags.error_map;
    if (path.ends_with(".png")) {
      write_png(path, map, {.exposure = 0, .tone_map = ToneMap::kNone});
    } else {
      Frame frame(map.width(), map.height());
      frame.add({metric.name, {"Y"}, "difference", Combine::kMean}, std::move(map));
      write_frame(path, frame);
    }
  }
}

void compare(const Flags& flags, const std::stop_token& stop) {
  CompareOptions options = flags.options;
  std::vector<const Metric*> metrics;
  for (const std::string& name : split_list(flags.metrics)) metrics.push_back(&find_metric(name));
  std::vector<Limit> limits;
  for (const std::string& t : flags.thresholds) limits.push_back(parse_limit(t));
  const auto asked = [&](double FrameFigures::*value) {
    return std::any_of(metrics.begin(), metrics.end(), [&](const Metric* m) { return m->value == value; }) ||
           std::any_of(limits.begin(), limits.end(), [&](const Limit& l) { return l.metric->value == value; });
  };
  options.flip = asked(&FrameFigures::flip);
  options.hdr_flip = asked(&FrameFigures::hdr_flip);
  if (!flags.frames.empty()) options.frames = parse_frame_set(flags.frames);
  if (!flags.error_map.empty() && flags.tests.size() > 1) {
    throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(), "--error-map takes one picture or sequence at a time");
  }

  std::vector<FrameSequence> tests;
  for (const std::string& t : flags.tests) tests.emplace_back(t);
  const FrameSequence reference(flags.reference);
  const bool terminal = isatty(STDERR_FILENO);
  const CompareResult result = compare_sequences(tests, reference, options, [&](int done, int total) {
    if (terminal) std::fprintf(stderr, "\r\033[Kframe %d of %d", done, total);
    if (stop.stop_requested()) throw Error(ErrorCode::kCancelled, "stopped; nothing was written");
  });
  if (terminal) std::fprintf(stderr, "\r\033[K");
  std::printf("%s", to_table(result).c_str());
  if (!flags.csv.empty()) write_file(flags.csv, to_csv(result));
  if (!flags.json.empty()) write_file(flags.json, to_json(result));
  if (!flags.error_map.empty()) write_error_maps(flags, *metrics[0], tests[0], reference, result.sides[0]);

  std::vector<std::string> passed;
  for (const CompareSide& side : result.sides) {
    for (const FrameFigures& f : side.frames) {
      for (const Limit& l : limits) {
        const double v = f.*(l.metric->value);
        // Written so that what is not a number counts as too much.
        if (v <= l.value) continue;
        passed.push_back(
            fmt::format("{} of frame {} of {} is {:.6g}, above {:g}", l.metric->name, f.frame, side.name, v, l.value));
      }
      if (!limits.empty() && f.non_finite > 0) {
        passed.push_back(fmt::format("{} pixels of frame {} of {} are not finite", f.non_finite, f.frame, side.name));
      }
    }
  }
  if (passed.empty()) return;
  throw Error(ErrorCode::kDiffers, passed[0] + (passed.size() > 1 ? fmt::format(" ({} more)", passed.size() - 1) : ""));
}

}  // namespace

std::vector<CatalogItem> metric_items() {
  std::vector<CatalogItem> out;
  out.reserve(std::size(kMetrics));
  for (const Metric& m : kMetrics) out.push_back({m.name, m.help, {}});
  return out;
}

void add_compare(Program& program) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      program.add("compare", "Measure how far pictures or sequences are from a reference.",
                  {"tempera compare out/noisy.####.exr --reference out/ref.####.exr",
                   "tempera compare a.exr b.exr --reference ref.exr --metrics relmse --csv figures.csv",
                   "tempera compare a.exr --reference ref.exr --threshold flip=0.05 --error-map diff.png"},
                  [&program, flags] {
                    with_threads(flags->threads, [&] { compare(*flags, program.stop); });
                    return 0;
                  });
  std::vector<std::string> names;
  names.reserve(std::size(kMetrics));
  for (const Metric& m : kMetrics) names.emplace_back(m.name);
  command->add_option("tests", flags->tests, "pictures, folders or sequences to judge")
      ->required()
      ->type_name("TEST...");
  command
      ->add_option("-r,--reference", flags->reference, "what they should look like; a single picture serves all frames")
      ->required()
      ->type_name("REFERENCE");
  command
      ->add_option("--metrics", flags->metrics,
                   fmt::format("what to measure: {} [relmse,mse,flip]", fmt::join(names, ", ")))
      ->type_name("A,B,C");
  command->add_option("-f,--frames", flags->frames, "frames to compare [all that both have]")->type_name("SET");
  command->add_option("--layer", flags->options.layer, "layer to compare [color]")->type_name("NAME");
  command->add_option("--exposure", flags->options.exposure, "stops, for flip [0]")->type_name("STOPS");
  command->add_option("--threshold", flags->thresholds, "end with status 6 if any frame is above this")
      ->allow_extra_args(false)
      ->type_name("METRIC=VALUE");
  command->add_option("--csv", flags->csv, "also write all figures to this file")->type_name("FILE");
  command->add_option("--json", flags->json, "also write all figures to this file")->type_name("FILE");
  command->add_option("--error-map", flags->error_map, "write the first metric of each pixel, .png or .exr")
      ->type_name("PATTERN");
  command->add_option("--threads", flags->threads, "threads; 0: one per core [0]")
      ->type_name("N")
      ->check(CLI::Range(0, 4096).description(""));
}

}  // namespace tempera
