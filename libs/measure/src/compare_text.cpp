// SPDX-License-Identifier: Apache-2.0
// What compare.h measures as JSON, CSV and a table.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "tempera/measure/compare.h"

namespace tempera {
namespace {

using Json = nlohmann::ordered_json;

/// JSON has neither NaN nor infinity.
Json number(double v) { return std::isfinite(v) ? Json(v) : Json(nullptr); }

Json numbers(const std::vector<double>& values) {
  Json out = Json::array();
  for (const double v : values) out.push_back(number(v));
  return out;
}

const char* name_of(MetricScope scope) {
  switch (scope) {
    case MetricScope::kFrame:
      return "frame";
    case MetricScope::kPair:
      return "pair";
    case MetricScope::kSequence:
      return "sequence";
  }
  return "";
}

Json json_of(const CompareSide& s) {
  Json mean = Json::object(), error = Json::object(), confidence = Json::object(), values = Json::object(),
       coverage = Json::object();
  for (const MetricSeries& m : s.series) {
    const std::string id(m.metric->id);
    mean[id] = number(m.mean.mean);
    error[id] = number(m.mean.standard_error);
    confidence[id] = number(m.mean.confidence_95());
    if (!m.values.empty()) values[id] = numbers(m.values);
    if (!m.coverage.empty()) coverage[id] = numbers(m.coverage);
  }
  Json spectra = Json::array();
  for (const ResidualSpectrum& p : s.spectra) {
    spectra.push_back({{"id", p.id},
                       {"frequency", numbers(p.frequency)},
                       {"power", numbers(p.power)},
                       {"segment_frames", p.segment_frames},
                       {"segments", p.segments},
                       {"coverage", p.coverage}});
  }
  return {{"name", s.name},
          {"label", s.label},
          {"runs", s.runs},
          {"frames", s.frames},
          {"mean", mean},
          {"standard_error", error},
          {"confidence_95", confidence},
          {"values", values},
          {"coverage", coverage},
          {"spectra", spectra},
          {"non_finite", s.non_finite},
          {"unmatched", s.unmatched},
          {"missing", s.missing}};
}

/// A CSV field: quoted when it holds what separates fields.
std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string csv_number(double v) { return std::isnan(v) ? std::string() : fmt::format("{}", v); }

/// Lines of columns: the first aligned left, the others right, and empty columns left out.
class Columns {
 public:
  void add(std::vector<std::string> line) { lines_.push_back(std::move(line)); }
  std::string text() const {
    std::vector<std::size_t> widths;
    for (const auto& line : lines_) {
      widths.resize(std::max(widths.size(), line.size()));
      for (std::size_t c = 0; c < line.size(); ++c) widths[c] = std::max(widths[c], width_of(line[c]));
    }
    std::string out;
    for (const auto& line : lines_) {
      std::string row;
      for (std::size_t c = 0; c < line.size(); ++c) {
        if (widths[c] == 0) continue;
        const std::string space(widths[c] - width_of(line[c]), ' ');
        row += c == 0 ? line[c] + space : "  " + space + line[c];
      }
      out += row.substr(0, row.find_last_not_of(' ') + 1) + "\n";
    }
    return out;
  }

 private:
  /// Characters of UTF-8 text.
  static std::size_t width_of(const std::string& text) {
    return std::size_t(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }));
  }
  std::vector<std::vector<std::string>> lines_;
};

std::string table_number(double v) { return std::isnan(v) ? "-" : fmt::format("{:.4g}", v); }

}  // namespace

std::string to_json(const CompareResult& result) {
  const CompareOptions& o = result.options;
  Json metrics = Json::array();
  for (const MetricInfo* m : result.metrics) {
    metrics.push_back({{"id", m->id},
                       {"title", m->title},
                       {"unit", m->unit},
                       {"scope", name_of(m->scope)},
                       {"better", to_text(m->better)},
                       {"formula", m->formula},
                       {"source", m->source},
                       {"trim", m->trims ? o.trim : 0},
                       {"noise_removed", m->squared && !o.reference2.empty()}});
  }
  Json noise = Json::object();
  for (std::size_t m = 0; m < result.reference_noise.size(); ++m) {
    if (result.metrics[m]->squared) noise[std::string(result.metrics[m]->id)] = number(result.reference_noise[m]);
  }
  Json j{{"reference", result.reference},
         {"reference2", o.reference2.empty() ? Json(nullptr) : Json(o.reference2)},
         {"layer", o.layer},
         {"width", result.width},
         {"height", result.height},
         {"fps", result.fps},
         {"reference_error",
          {{"relmse", number(result.reference_error.mean)},
           {"confidence_95", number(result.reference_error.confidence_95())}}},
         {"reference_noise", std::move(noise)},
         {"settings",
          {{"epsilon", o.epsilon},
           {"exposure", o.exposure},
           {"pixels_per_degree", o.pixels_per_degree},
           {"trim", o.trim},
           {"cutoff", o.cutoff},
           {"motion", o.motion},
           {"where", o.where ? Json{{"layer", o.where->layer}, {"value", o.where->value}} : Json(nullptr)}}},
         {"notes", result.notes},
         {"metrics", std::move(metrics)},
         {"sides", Json::array()}};
  for (const CompareSide& s : result.sides) j["sides"].push_back(json_of(s));
  return j.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

std::string to_csv(const CompareResult& result) {
  std::string text = "name,frame";
  const double trim = result.options.trim;
  for (const MetricInfo* m : result.metrics) {
    text += fmt::format(",{}", m->id);
    if (m->trims && trim > 0) text += fmt::format("[without {:g}%]", trim * 100);
  }
  text += ",non_finite\n";
  for (const CompareSide& s : result.sides) {
    std::int64_t non_finite = 0;
    for (std::size_t f = 0; f < s.frames.size(); ++f) {
      text += fmt::format("{},{}", field(s.name), s.frames[f]);
      for (const MetricSeries& m : s.series)
        text += fmt::format(",{}", m.values.empty() ? "" : csv_number(m.values[f]));
      text += fmt::format(",{}\n", s.non_finite[f]);
      non_finite += s.non_finite[f];
    }
    text += field(s.name) + ",mean";
    for (const MetricSeries& m : s.series) text += fmt::format(",{}", csv_number(m.mean.mean));
    text += fmt::format(",{}\n", non_finite);
    text += field(s.name) + ",standard_error";
    for (const MetricSeries& m : s.series) text += fmt::format(",{}", csv_number(m.mean.standard_error));
    text += ",\n";
  }
  if (!result.reference_noise.empty()) {
    text += "reference,noise";
    for (const double v : result.reference_noise) text += fmt::format(",{}", csv_number(v));
    text += ",\n";
  }
  return text;
}

std::string to_table(const CompareResult& result) {
  Columns table;
  std::vector<std::string> line{""};
  const auto add_side = [&](std::string value, std::string error, std::string ratio) {
    line.push_back(std::move(value)), line.push_back(std::move(error)), line.push_back(std::move(ratio));
  };
  for (const CompareSide& s : result.sides) add_side(s.label, "", "");
  table.add(std::exchange(line, {"frames"}));
  for (const CompareSide& s : result.sides) add_side(fmt::format("{}", s.frames.size()), "", "");
  table.add(std::move(line));
  for (std::size_t m = 0; m < result.metrics.size(); ++m) {
    const MetricInfo& metric = *result.metrics[m];
    line = {metric.unit.empty() ? std::string(metric.title) : fmt::format("{} [{}]", metric.title, metric.unit)};
    const double first = result.sides[0].series[m].mean.mean;
    for (const CompareSide& s : result.sides) {
      const MeanError& v = s.series[m].mean;
      const double error = v.confidence_95();
      const bool ratio = &s != &result.sides[0] && metric.better == MetricBetter::kLower && first > 0;
      add_side(table_number(v.mean), std::isnan(error) ? "" : fmt::format("± {:.2g}", error),
               ratio && !std::isnan(v.mean) ? fmt::format("{:.3f}x", v.mean / first) : "");
    }
    table.add(std::move(line));
  }
  line = {"non-finite pixels"};
  bool any = false;
  for (const CompareSide& s : result.sides) {
    std::int64_t sum = 0;
    for (const std::int64_t n : s.non_finite) sum += n;
    any |= sum > 0;
    add_side(fmt::format("{}", sum), "", "");
  }
  if (any) table.add(std::move(line));
  const std::string& second = result.options.reference2;
  std::string text = fmt::format("{}, layer {}, {}x{} pixels\n",
                                 second.empty() ? "Reference: " + result.reference
                                                : fmt::format("References: {} and {}", result.reference, second),
                                 result.options.layer, result.width, result.height);
  text += table.text();
  bool over_runs = false, over_frames = false;
  for (const CompareSide& s : result.sides) {
    for (const MetricSeries& m : s.series) {
      if (!std::isnan(m.mean.standard_error)) (s.runs.size() > 1 ? over_runs : over_frames) = true;
    }
  }
  if (over_runs || over_frames) {
    text += fmt::format("±: 95 % confidence of the mean over {}\n", over_runs && over_frames
                                                                        ? "runs, or over frames where there is one run"
                                                                    : over_runs ? "runs"
                                                                                : "frames");
  }
  for (const std::string& note : result.notes) text += note + "\n";
  return text;
}

}  // namespace tempera
