// SPDX-License-Identifier: Apache-2.0
#include "tempera/report/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "embedded_text.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"
#include "tempera/report/picture_code.h"

namespace tempera {
namespace {

using Json = nlohmann::ordered_json;

/// Metrics whose maps the page computes from the pictures (libs/report/assets/errors.js): they need no room.
constexpr std::array<std::string_view, 7> kComputedMaps{
    "relmse", "relmse_gray", "mse", "temporal", "temporal_compensated", "warp_error", "flicker_static"};

bool is_computed(std::string_view id) {
  return std::find(kComputedMaps.begin(), kComputedMaps.end(), id) != kComputedMaps.end();
}

/// Text between tags, and in attribute values.
std::string html_text(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

/// JSON inside of a script element: nothing in it can end the element. Bytes that are no UTF-8 become U+FFFD; values
/// that are not finite become null.
std::string script_json(const Json& json) {
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string out;
  out.reserve(text.size());
  for (const char c : text) {
    if (c == '<') {
      out += "\\u003c";
    } else if (c == '>') {
      out += "\\u003e";
    } else if (c == '&') {
      out += "\\u0026";
    } else {
      out += c;
    }
  }
  return out;
}

/// UTF-8, whatever the bytes were: a title stands in the page as it is.
std::string valid_utf8(const std::string& text) {
  return Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace)).get<std::string>();
}

/// A block as an element of the page; `id` is made of letters, digits, '-' and '_'.
std::string block(const std::string& id, const EncodedPicture& p) {
  std::string text =
      fmt::format("<script type=\"application/octet-stream\" id=\"{}\" data-channels=\"{}\" data-gradient=\"{}\"", id,
                  p.channels, p.gradient ? 1 : 0);
  text += p.vector_step > 0 ? fmt::format(" data-step=\"{}\">", p.vector_step)
                            : fmt::format(" data-steps=\"{}\" data-toe=\"{}\">", p.code.steps, p.code.toe);
  text += base64(p.bytes);
  text += "</script>\n";
  return text;
}

/// Motion vectors at another size: those of the pixels under the new centers, in new pixels.
Image scaled_vectors(const Image& vectors, int width, int height) {
  Image out(width, height, vectors.channels());
  const float sx = float(width) / float(vectors.width()), sy = float(height) / float(vectors.height());
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const int from_x = int((float(x) + 0.5f) / sx), from_y = int((float(y) + 0.5f) / sy);
      const float* from = vectors.pixel(std::min(from_x, vectors.width() - 1), std::min(from_y, vectors.height() - 1));
      float* to = out.pixel(x, y);
      std::copy(from, from + vectors.channels(), to);
      to[0] *= sx, to[1] *= sy;
    }
  }
  return out;
}

/// The range of values of a metric's maps, so that colors mean the same in all frames: a histogram over octaves.
class MapRange {
 public:
  void add(const Image& map) {
    for (const float v : map.values()) {
      if (!std::isfinite(v)) continue;
      least_ = std::min(least_, v);
      const float a = std::abs(v);
      if (a == 0) continue;
      ++bins_[std::clamp(int(std::floor(std::log2(a) * kPerOctave)) + kZero, 0, kBins - 1)];
      ++count_;
    }
  }
  /// {"low", "high", "scale"} as the page wants it (libs/report/assets/color.js).
  Json json(const MetricInfo& metric) const {
    const double high = rounded_up(quantile(0.999));
    if (metric.better == MetricBetter::kNearZero) return {{"low", -high}, {"high", high}, {"scale", "signed"}};
    // Bright is bad in all maps.
    if (metric.better == MetricBetter::kHigher) {
      return {{"low", high}, {"high", least_ < 0 ? -rounded_up(-least_) : 0}, {"scale", "linear"}};
    }
    const double middle = quantile(0.5);
    if (middle > 0 && high > 30 * middle) return {{"low", high * 1e-5}, {"high", high}, {"scale", "log"}};
    return {{"low", 0}, {"high", high}, {"scale", "linear"}};
  }

 private:
  static constexpr int kPerOctave = 8, kBins = 2048, kZero = kBins / 2;
  double quantile(double q) const {
    std::int64_t left = std::int64_t(q * double(count_));
    for (int i = 0; i < kBins; ++i) {
      left -= bins_[i];
      if (left < 0) return std::exp2(double(i + 1 - kZero) / kPerOctave);
    }
    return 1;
  }
  /// The next of 1, 2, 5, 10, ...
  static double rounded_up(double v) {
    const double power = std::pow(10, std::floor(std::log10(v)));
    for (const double m : {1.0, 2.0, 5.0}) {
      if (v <= m * power * (1 + 1e-9)) return m * power;
    }
    return 10 * power;
  }
  std::array<std::int64_t, kBins> bins_{};
  std::int64_t count_ = 0;
  float least_ = 0;
};

/// What the headers of a sequence say about how it was made.
struct Provenance {
  Json rows = Json::array();  ///< [[name, text], ...]
  double fps = 0;             ///< 0: unknown
};

Provenance provenance_of(const std::string& pattern, const std::vector<int>& frames) {
  Provenance out;
  const FrameSequence sequence(pattern);
  std::optional<RenderInfo> first;
  double seconds = 0;
  int timed = 0;
  const bool still = sequence.frames().size() == 1;
  for (const int f : still ? sequence.frames() : frames) {
    const std::optional<RenderInfo> info = render_info(read_metadata(sequence.path(f)));
    if (!info) continue;
    if (!first) first = info;
    seconds += info->render_seconds;
    ++timed;
  }
  if (!first) return out;
  out.fps = first->fps;
  const auto row = [&](const char* name, const std::string& text) {
    if (!text.empty()) out.rows.push_back({name, text});
  };
  row("integrator", first->integrator);
  row("parameters", first->parameters);
  if (first->spp > 0) row("samples per pixel", fmt::format("{}", first->spp));
  row("seed", fmt::format("{}", first->seed));
  if (seconds > 0) row("seconds per frame", fmt::format("{:.4g}", seconds / timed));
  row("shutter", fmt::format("{:g} to {:g} of a frame", first->shutter_open, first->shutter_close));
  row("scene", first->scene);
  row("rendered by", first->version);
  return out;
}

const char* to_text(ToneMap tone_map) {
  switch (tone_map) {
    case ToneMap::kSrgb:
      return "srgb";
    case ToneMap::kFilmic:
      return "filmic";
    case ToneMap::kNone:
      return "none";
  }
  return "srgb";
}

/// A temporary file that is written from front to back; errors name the file that it is to become.
class Output {
 public:
  Output(const TemporaryFile& file, std::string becomes)
      : path_(std::move(becomes)), out_(file.path(), std::ios::binary | std::ios::trunc) {
    check();
  }
  void write(std::string_view text) {
    errno = 0;
    out_.write(text.data(), std::streamsize(text.size()));
    size_ += std::int64_t(text.size());
    check();
  }
  void close() {
    errno = 0;
    out_.close();
    check();
  }
  std::int64_t size() const { return size_; }

 private:
  void check() const {
    if (!out_) throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path_, std::strerror(errno)));
  }
  std::string path_;
  std::ofstream out_;
  std::int64_t size_ = 0;
};

}  // namespace

struct ReportWriter::Impl {
  /// A sequence of the page: the tests in their order, or the reference.
  struct Side {
    std::vector<int> frames;  ///< that it shows
    std::vector<int> stored;  ///< under which frame's number each of them is stored: equal pictures are stored once
    int steps = 0;            ///< of the picture before, where the search for the next begins
    int finest = 0, coarsest = 0;
    Image last;  ///< the picture before, of the reference: a still one comes with each frame
  };
  /// An image of the current frame, waiting to be encoded.
  struct Job {
    enum class Kind { kPicture, kMap, kVectors } kind = Kind::kPicture;
    std::string id;
    Image image;
    Side* side = nullptr;  ///< of a picture
    EncodedPicture encoded;
  };

  Impl(const std::string& file, const std::vector<CompareInput>& inputs, const FrameSequence* reference,
       const CompareOptions& measured, const ReportOptions& report_options)
      : path(file), options(report_options), spool_file(file), spool(spool_file, file) {
    const auto count = [&](const FrameSequence& sequence) {
      return std::count_if(sequence.frames().begin(), sequence.frames().end(), [&](int f) {
        return measured.frames.empty() ||
               std::find(measured.frames.begin(), measured.frames.end(), f) != measured.frames.end();
      });
    };
    for (const CompareInput& input : inputs) pictures += count(input.runs.at(0));
    if (reference) pictures += std::max<std::int64_t>(1, count(*reference));
    const auto asked = [&](std::string_view id) {
      return std::find(measured.metrics.begin(), measured.metrics.end(), id) != measured.metrics.end();
    };
    const bool all = asked("all"), defaults = measured.metrics.empty() || asked("default");
    for (const MetricInfo& m : metric_catalog()) {
      if (m.has_map && !is_computed(m.id) && (all || (defaults && m.is_default) || asked(m.id))) {
        map_ids.emplace_back(m.id);
      }
    }
  }

  void begin(int frame) {
    if (!frames.empty() && frames.back() == frame) return;
    flush();
    frames.push_back(frame);
  }

  /// Takes the size of the first image; the comparison has checked that all have it.
  Image reduced(const Image& image) {
    if (width == 0) {
      source_width = image.width(), source_height = image.height();
      const auto scaled = [&](int size) { return std::max(1, int(std::lround(size * options.scale))); };
      width = scaled(source_width), height = scaled(source_height);
      const double pixels = double(pictures) * width * height;
      precision = std::clamp(options.room / (pixels * options.picture_bytes), 1.0, 2.5);
    }
    return width == image.width() && height == image.height() ? image : resized(image, width, height);
  }

  void add_picture(const std::string& name, Side& side, int frame, const Image& image, bool compare_with_last) {
    side.frames.push_back(frame);
    if (compare_with_last && image == side.last) {
      side.stored.push_back(side.stored.back());
      return;
    }
    side.stored.push_back(frame);
    jobs.push_back({Job::Kind::kPicture, fmt::format("picture-{}-{}", name, frame), reduced(image), &side, {}});
    if (compare_with_last) side.last = image;
  }

  void add_motion(const char* direction, std::vector<int>& known, int frame, const Image* vectors) {
    if (!vectors || width == 0) return;
    known.push_back(frame);
    Image image =
        width == vectors->width() && height == vectors->height() ? *vectors : scaled_vectors(*vectors, width, height);
    jobs.push_back({Job::Kind::kVectors, fmt::format("motion-{}-{}", direction, frame), std::move(image), nullptr, {}});
  }

  /// Encodes what the current frame has gathered.
  void flush() {
    parallel_for(0, std::int64_t(jobs.size()), [&](std::int64_t i) {
      Job& job = jobs[i];
      switch (job.kind) {
        case Job::Kind::kPicture:
          job.encoded = encode_picture(
              job.image,
              {.bytes_per_pixel = options.picture_bytes * precision, .max_steps = 128, .first_steps = job.side->steps});
          break;
        case Job::Kind::kMap:
          job.encoded = encode_picture(
              job.image, {.bytes_per_pixel = options.map_bytes * precision, .max_steps = 32, .toe_octaves = 1});
          break;
        case Job::Kind::kVectors:
          job.encoded = encode_vectors(job.image);
          break;
      }
      job.image = {};
    });
    for (Job& job : jobs) {
      spool.write(block(job.id, job.encoded));
      if (Side* const side = job.side) {
        side->steps = job.encoded.code.steps;
        side->finest = std::max(side->finest, side->steps);
        side->coarsest = side->coarsest == 0 ? side->steps : std::min(side->coarsest, side->steps);
      }
    }
    jobs.clear();
  }

  Json side_json(const Side& side, const std::string& label, const std::string& name,
                 const std::vector<std::string>& runs) const {
    const Provenance p = provenance_of(runs[0], side.frames);
    return {{"label", label},
            {"name", name},
            {"runs", runs},
            {"fps", p.fps},
            {"frames", side.frames},
            {"stored", side.stored},
            {"relativeError", {relative_error({.steps = side.finest}), relative_error({.steps = side.coarsest})}},
            {"info", p.rows}};
  }

  Json data(const CompareResult& result) const {
    Json sides = Json::array(), metrics = Json::array();
    for (std::size_t s = 0; s < result.sides.size(); ++s) {
      const CompareSide& from = result.sides[s];
      Json side = side_json(tests.at(s), from.label.empty() ? from.name : from.label, from.name, from.runs);
      side["missing"] = from.missing;
      side["nonFinite"] = from.non_finite;
      Json series = Json::object();
      for (const MetricSeries& m : from.series) {
        Json& out = series[std::string(m.metric->id)];
        out["mean"] = m.mean.mean;
        out["confidence95"] = m.mean.confidence_95();
        // Of the frames that the side has, as `frames`.
        if (!m.values.empty()) out["values"] = m.values;
        if (!m.coverage.empty()) out["coverage"] = m.coverage;
      }
      for (const ResidualSpectrum& spectrum : from.spectra) {
        series[spectrum.id]["spectrum"] = {{"frequency", spectrum.frequency}, {"power", spectrum.power}};
      }
      side["series"] = std::move(series);
      sides.push_back(std::move(side));
    }
    Json reference_index = nullptr;
    if (!reference_side.frames.empty()) {
      reference_index = sides.size();
      std::vector<std::string> files{result.reference};
      if (!result.options.reference2.empty()) files.push_back(result.options.reference2);
      sides.push_back(side_json(reference_side, "reference", fmt::format("{}", fmt::join(files, ", ")), files));
    }
    for (const MetricInfo* m : result.metrics) {
      metrics.push_back({{"id", m->id},
                         {"title", m->title},
                         {"unit", m->unit},
                         {"help", m->help},
                         {"formula", m->formula},
                         {"source", m->source},
                         {"better", to_text(m->better)}});
    }
    Json maps = Json::array();
    for (const auto& [id, of_sides] : map_frames) {
      const MetricInfo& metric = get_metric(id);
      Json map = map_ranges.at(id).json(metric);
      map["id"] = id, map["title"] = metric.title, map["help"] = metric.help;
      map["frames"] = Json::array();
      for (std::size_t s = 0; s < sides.size(); ++s) {
        const auto found = of_sides.find(s);
        map["frames"].push_back(found == of_sides.end() ? std::vector<int>() : found->second);
      }
      maps.push_back(std::move(map));
    }
    double fps = result.fps;
    for (std::size_t s = 0; s < sides.size() && !(fps > 0); ++s) fps = sides[s]["fps"];
    if (!(fps > 0)) fps = 24;
    return {{"format", 1},
            {"generator", "tempera " TEMPERA_VERSION},
            {"width", width},
            {"height", height},
            {"sourceSize", {source_width, source_height}},
            {"layer", result.options.layer},
            {"epsilon", result.options.epsilon},
            {"fps", fps},
            {"display", {{"exposure", options.display.exposure}, {"toneMap", to_text(options.display.tone_map)}}},
            {"frames", frames},
            {"reference", reference_index},
            {"sides", sides},
            {"metrics", metrics},
            {"notes", result.notes},
            {"maps", maps},
            {"motion", {{"forward", forward}, {"backward", backward}}}};
  }

  std::string path;
  ReportOptions options;
  TemporaryFile spool_file;  ///< the blocks of finished frames
  Output spool;
  std::vector<std::string> map_ids;
  std::int64_t pictures = 0;  ///< that the page may come to hold
  double precision = 1;       ///< factor of the bytes for a pixel
  int width = 0, height = 0, source_width = 0, source_height = 0;
  std::vector<int> frames;  ///< of the page, ascending
  std::map<std::size_t, Side> tests;
  Side reference_side;
  std::vector<int> forward, backward;                                         ///< frames with vectors
  std::map<std::string, std::map<std::size_t, std::vector<int>>> map_frames;  ///< [metric][side]
  std::map<std::string, MapRange> map_ranges;
  std::vector<Job> jobs;  ///< of the current frame
};

ReportWriter::ReportWriter(const std::string& path, const std::vector<CompareInput>& tests,
                           const FrameSequence* reference, const CompareOptions& measured,
                           const ReportOptions& options) {
  if (!(options.scale > 0 && options.scale <= 1)) {
    throw Error(ErrorCode::kOutOfRange,
                fmt::format("the pictures of a report can have 0 to 1 of the frames' size, not {}", options.scale));
  }
  impl_ = std::make_unique<Impl>(path, tests, reference, measured, options);
}
ReportWriter::~ReportWriter() = default;

std::vector<std::string> ReportWriter::maps() const { return impl_->map_ids; }

void ReportWriter::reference(int frame, const Image& image, const Image* motion_backward, const Image* motion_forward) {
  impl_->begin(frame);
  impl_->add_picture("reference", impl_->reference_side, frame, image, true);
  vectors(frame, motion_backward, motion_forward);
}

void ReportWriter::vectors(int frame, const Image* motion_backward, const Image* motion_forward) {
  impl_->begin(frame);
  impl_->add_motion("backward", impl_->backward, frame, motion_backward);
  impl_->add_motion("forward", impl_->forward, frame, motion_forward);
}

void ReportWriter::test(std::size_t side, int frame, const Image& image,
                        const std::function<const Image*(std::string_view id)>& map) {
  Impl& d = *impl_;
  d.begin(frame);
  d.add_picture(fmt::format("{}", side), d.tests[side], frame, image, false);
  for (const std::string& id : d.map_ids) {
    const Image* const values = map(id);
    if (!values) continue;
    d.map_frames[id][side].push_back(frame);
    Image reduced = d.reduced(*values);
    d.map_ranges[id].add(reduced);
    d.jobs.push_back(
        {Impl::Job::Kind::kMap, fmt::format("map-{}-{}-{}", id, side, frame), std::move(reduced), nullptr, {}});
  }
}

std::int64_t ReportWriter::finish(const CompareResult& result) {
  Impl& d = *impl_;
  d.flush();
  d.spool.close();

  std::string title = d.options.title;
  if (title.empty()) {
    for (const CompareSide& s : result.sides) {
      title += (title.empty() ? "" : " · ") + (s.label.empty() ? s.name : s.label);
    }
  }
  Json data = d.data(result);
  data["title"] = title;

  // The page is text with a few marks, {{name}}, at which its parts go in.
  const std::map<std::string_view, std::string> parts{{"title", html_text(valid_utf8(title))},
                                                      {"style", std::string(report_assets::kStyle)},
                                                      {"data", script_json(data)},
                                                      {"script", std::string(report_assets::kScript)}};
  TemporaryFile file(d.path);
  Output out(file, d.path);
  std::string_view rest = report_assets::kPage;
  for (;;) {
    const std::size_t open = rest.find("{{");
    out.write(rest.substr(0, open));
    if (open == std::string_view::npos) break;
    const std::size_t close = rest.find("}}", open);
    const std::string_view name = rest.substr(open + 2, close - open - 2);
    if (name == "blocks") {
      std::ifstream in(d.spool_file.path(), std::ios::binary);
      std::string chunk(1 << 20, '\0');
      std::int64_t left = d.spool.size();
      while (left > 0 && in.read(chunk.data(), std::min<std::int64_t>(left, std::int64_t(chunk.size())))) {
        out.write(std::string_view(chunk).substr(0, in.gcount()));
        left -= in.gcount();
      }
      if (left > 0) {
        throw Error(ErrorCode::kFailed, fmt::format("cannot read {}: {}", d.spool_file.path(), std::strerror(errno)));
      }
    } else {
      out.write(parts.at(name));
    }
    rest.remove_prefix(close + 2);
  }
  out.close();
  file.commit();
  return out.size();
}

CompareResult show_sequences(const std::vector<CompareInput>& tests, const CompareOptions& options,
                             ReportWriter& writer, const CompareProgress& progress) {
  CompareResult result;
  result.options = options;
  std::set<int> frames;
  int total = 0, done = 0;
  for (const CompareInput& input : tests) {
    CompareSide& side = result.sides.emplace_back();
    side.name = input.name;
    for (const FrameSequence& r : input.runs) side.runs.push_back(r.pattern());
    for (const int f : input.runs.at(0).frames()) {
      if (options.frames.empty() ||
          std::find(options.frames.begin(), options.frames.end(), f) != options.frames.end()) {
        side.frames.push_back(f);
      }
    }
    if (side.frames.empty()) {
      throw Error(ErrorCode::kBadInput, fmt::format("{} has none of the frames that were asked for", input.name));
    }
    frames.insert(side.frames.begin(), side.frames.end());
    total += int(side.frames.size());
  }
  std::vector<std::string> names;
  for (const CompareSide& s : result.sides) names.push_back(s.name);
  const std::vector<std::string> labels = distinguishing_labels(names);
  for (std::size_t s = 0; s < labels.size(); ++s) result.sides[s].label = labels[s];

  constexpr std::array<const char*, 2> kMotion{"motion.backward", "motion.forward"};
  std::string first_path;
  for (const int frame : frames) {
    std::vector<Frame> loaded(tests.size());
    parallel_for(0, std::int64_t(tests.size()), [&](std::int64_t i) {
      const FrameSequence& sequence = tests[i].runs[0];
      const auto& mine = result.sides[i].frames;
      if (!std::binary_search(mine.begin(), mine.end(), frame)) return;
      ReadOptions read{{options.layer}};
      for (const LayerDesc& layer : read_header(sequence.path(frame)).layers) {
        if (std::find(kMotion.begin(), kMotion.end(), layer.name) != kMotion.end()) read.layers.push_back(layer.name);
      }
      loaded[i] = read_frame(sequence.path(frame), read);
    });
    std::array<const Image*, 2> vectors{};
    for (std::size_t i = 0; i < tests.size(); ++i) {
      const Frame& f = loaded[i];
      if (f.width() == 0) continue;
      const std::string path = tests[i].runs[0].path(frame);
      if (first_path.empty()) {
        first_path = path;
        result.width = f.width(), result.height = f.height();
      } else if (f.width() != result.width || f.height() != result.height) {
        throw Error(ErrorCode::kBadInput, fmt::format("{} has {}x{} pixels, {} has {}x{}", path, f.width(), f.height(),
                                                      first_path, result.width, result.height));
      }
      const Image& image = f.layer(options.layer);
      writer.test(i, frame, image, [](std::string_view) -> const Image* { return nullptr; });
      result.sides[i].non_finite.push_back(count_non_finite(image));
      for (std::size_t m = 0; m < kMotion.size(); ++m) {
        if (!vectors[m] && f.has(kMotion[m])) vectors[m] = &f.layer(kMotion[m]);
      }
      if (progress) progress(++done, total);
    }
    writer.vectors(frame, vectors[0], vectors[1]);
  }
  return result;
}

}  // namespace tempera
