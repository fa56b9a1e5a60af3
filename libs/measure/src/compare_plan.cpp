// SPDX-License-Identifier: Apache-2.0
// What to compare: which frames and runs of each side, what their files hold, and what can be measured of it.
#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <set>

#include "comparison.h"
#include "tempera/frames/frame.h"

namespace tempera {
namespace {

/// Which frames a side is compared in, of those in `chosen` (ascending; empty: all).
CompareSide plan_side(const CompareInput& input, const FrameSequence& reference, const std::vector<int>& chosen) {
  CompareSide side;
  side.name = input.name;
  for (const FrameSequence& r : input.runs) side.runs.push_back(r.pattern());
  const bool still = reference.frames().size() == 1;
  const auto wanted = [&](int f) { return chosen.empty() || sorted_contains(chosen, f); };
  // Runs that are single pictures belong together whatever numbers their names hold.
  const auto serves = [](const FrameSequence& run, int f) { return run.has(f) || run.path(f) == run.path(f + 1); };
  bool common = false;
  for (const int f : input.runs.at(0).frames()) {
    const bool in_all_runs =
        std::all_of(input.runs.begin(), input.runs.end(), [&](const FrameSequence& r) { return serves(r, f); });
    common |= in_all_runs;
    if (wanted(f) && in_all_runs) (still || reference.has(f) ? side.frames : side.unmatched).push_back(f);
  }
  if (!common) throw Error(ErrorCode::kBadInput, fmt::format("the runs of {} have no frame in common", input.name));
  if (side.frames.empty()) {
    throw Error(ErrorCode::kBadInput,
                fmt::format("{} and the reference {} have no frame to compare", input.name, reference.pattern()));
  }
  for (const int f : reference.frames()) {
    if (wanted(f) && f > side.frames.front() && f < side.frames.back() && !sorted_contains(side.frames, f)) {
      side.missing.push_back(f);
    }
  }
  side.non_finite.assign(side.frames.size(), 0);
  return side;
}

void check_options(const CompareOptions& o) {
  const auto check = [](bool ok, const char* name, double value, const char* range) {
    if (!ok) throw Error(ErrorCode::kOutOfRange, fmt::format("{} is {:g}; it has to be {}", name, value, range));
  };
  check(o.epsilon > 0 && std::isfinite(o.epsilon), "epsilon", o.epsilon, "above 0");
  check(o.trim >= 0 && o.trim <= 0.5, "trim", o.trim, "a part of the pixels from 0 to 0.5");
  check(o.cutoff > 0 && o.cutoff < 0.5, "cutoff", o.cutoff, "between 0 and 0.5 cycles per frame");
  check(o.pixels_per_degree >= 1 && o.pixels_per_degree <= 1000, "pixels_per_degree", o.pixels_per_degree,
        "from 1 to 1000");
  check(std::abs(o.exposure) <= 64, "exposure", o.exposure, "from -64 to 64 stops");
}

}  // namespace

std::pair<std::size_t, int> longest_stretch(const std::vector<int>& frames, int step) {
  std::size_t best = 0, begin = 0;
  int length = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i > 0 && frames[i] != frames[i - 1] + step) begin = i;
    if (int(i - begin) + 1 > length) best = begin, length = int(i - begin) + 1;
  }
  return {best, length};
}

Comparison::Comparison(const std::vector<CompareInput>& tests, const FrameSequence& reference,
                       const CompareOptions& options, const CompareProgress& progress, CompareObserver* observer)
    : tests_(tests), reference_(reference), options_(options), progress_(progress), observer_(observer) {
  if (tests.empty()) throw Error(ErrorCode::kBadInput, "there is nothing to compare with the reference");
  check_options(options);
  still_ = reference.frames().size() == 1;
  plan_sides();
  plan_second_reference();
  plan_files();
  plan_metrics();
  plan_spectra();
}

void Comparison::plan_sides() {
  result_.reference = reference_.pattern();
  result_.options = options_;
  std::vector<int> chosen = options_.frames;
  std::sort(chosen.begin(), chosen.end());
  std::set<int> all;
  std::vector<std::string> names;
  for (const CompareInput& input : tests_) {
    CompareSide side = plan_side(input, reference_, chosen);
    all.insert(side.frames.begin(), side.frames.end());
    for (std::size_t r = 0; r < input.runs.size(); ++r) {
      Run& run = runs_.emplace_back();
      run.side = result_.sides.size(), run.index = r, run.sequence = &input.runs[r];
      total_ += int(side.frames.size());
    }
    names.push_back(side.name);
    result_.sides.push_back(std::move(side));
  }
  const std::vector<std::string> labels = distinguishing_labels(names);
  for (std::size_t s = 0; s < labels.size(); ++s) result_.sides[s].label = labels[s];
  all_frames_.assign(all.begin(), all.end());
  step_ = all_frames_.size() > 1 ? all_frames_[1] - all_frames_[0] : 1;
  for (std::size_t i = 1; i < all_frames_.size(); ++i) step_ = std::min(step_, all_frames_[i] - all_frames_[i - 1]);
}

void Comparison::plan_second_reference() {
  if (options_.reference2.empty()) return;
  second_.emplace(options_.reference2);
  const auto fail = [&](const std::string& what) {
    throw Error(ErrorCode::kBadInput, fmt::format("the second reference {} {}", second_->pattern(), what));
  };
  if (still_ != (second_->frames().size() == 1)) {
    const auto count = [](const FrameSequence& q) {
      return q.frames().size() == 1 ? "a single picture" : fmt::format("a sequence of {} frames", q.frames().size());
    };
    fail(fmt::format("is {}, the first, {}, is {}", count(*second_), reference_.pattern(), count(reference_)));
  }
  for (const int f : all_frames_) {
    if (!still_ && !second_->has(f)) fail(fmt::format("lacks frame {}, which {} has", f, reference_.pattern()));
    const std::string path = reference_.path(reference_frame(f));
    if (std::error_code ignored; std::filesystem::equivalent(path, second_path(f), ignored)) {
      fail(fmt::format("is the first one again ({}); it has to be rendered with another seed", path));
    }
  }
}

void Comparison::plan_files() {
  const FrameHeader header = read_header(reference_.path(reference_frame(all_frames_[0])));
  const auto has = [](const FrameHeader& h, std::string_view layer) {
    return std::any_of(h.layers.begin(), h.layers.end(), [&](const LayerDesc& l) { return l.name == layer; });
  };
  if (const auto info = render_info(header.metadata)) result_.fps = info->fps;
  result_.width = header.width, result_.height = header.height;
  has_halves_ = !second_ && options_.layer == layers::color().name && has(header, layers::color_a().name) &&
                has(header, layers::color_b().name);
  if (options_.where && !has(header, options_.where->layer)) {
    throw Error(ErrorCode::kBadInput,
                fmt::format("the reference {} has no layer {}, which is to tell the part of the picture to compare",
                            reference_.pattern(), options_.where->layer));
  }
  FrameHeader vectors = header;
  if (!options_.motion.empty()) {
    motion_.emplace(options_.motion);
    vectors = read_header(motion_->path(motion_->frames()[0]));
  }
  // Vectors lead to the next frame; those of a still picture say nothing about the frames of the tests.
  const bool vectors_serve = step_ == 1 && !still_;
  has_backward_ = vectors_serve && has(vectors, layers::motion_backward().name);
  has_forward_ = vectors_serve && has(vectors, layers::motion_forward().name);
  tests_have_motion_ = has_backward_;
  for (const Run& r : runs_) {
    const int first = result_.sides[r.side].frames[0];
    tests_have_motion_ =
        tests_have_motion_ && has(read_header(r.sequence->path(first)), layers::motion_backward().name);
  }
}

std::string Comparison::obstacle(const MetricInfo& m) const {
  if (options_.where && !m.trims) return "of a part of the picture only squared errors are measured";
  const std::string vectors = options_.motion.empty() ? reference_.pattern() : options_.motion;
  switch (m.needs) {
    case MetricNeeds::kNothing:
    case MetricNeeds::kStillScene:
      break;
    case MetricNeeds::kSeeds:
      if (runs_.size() == result_.sides.size()) return "it needs several runs of a method, as \"out/seed*/f.####.exr\"";
      break;
    case MetricNeeds::kMotion:
    case MetricNeeds::kMotionBoth:
    case MetricNeeds::kTracks:
      if (still_) return "the reference is a single picture, in which nothing moves";
      if (step_ != 1) return "motion vectors lead from one frame to the next, and the frames are further apart";
      if (m.needs == MetricNeeds::kTracks && !has_forward_) {
        return fmt::format("it needs the layer motion.forward, which {} lacks", vectors);
      }
      if (m.needs != MetricNeeds::kTracks && !has_backward_) {
        return fmt::format("it needs the layer motion.backward, which {} lacks", vectors);
      }
      if (m.needs == MetricNeeds::kMotionBoth && !tests_have_motion_) {
        return "it needs the layer motion.backward in the files of all tests";
      }
      break;
  }
  const auto longest = [&] {
    int frames = 0;
    for (const CompareSide& s : result_.sides) frames = std::max(frames, longest_stretch(s.frames, step_).second);
    return frames;
  };
  if (m.scope == MetricScope::kPair && longest() < 2) return "it needs two frames, one after the other";
  if (m.scope == MetricScope::kSequence && longest() < kMinSpectrumFrames) {
    return fmt::format("it needs {} frames in a row; there are {}", kMinSpectrumFrames, longest());
  }
  if (m.id == "ssim" && (result_.width < 11 || result_.height < 11)) return "it needs a picture of 11x11 pixels";
  return {};
}

void Comparison::plan_metrics() {
  const auto asked = [&](std::string_view id) {
    return std::find(options_.metrics.begin(), options_.metrics.end(), id) != options_.metrics.end();
  };
  const bool all = asked("all"), defaults = asked("default") || options_.metrics.empty();
  for (const std::string& id : options_.metrics) {
    if (id == "all" || id == "default") continue;
    if (const std::string why = obstacle(get_metric(id)); !why.empty()) {
      throw Error(ErrorCode::kBadInput, fmt::format("\"{}\" cannot be measured: {}", id, why));
    }
  }
  for (const MetricEntry& e : metric_entries()) {
    const bool by_default = e.info.is_default && (e.info.needs != MetricNeeds::kStillScene || still_);
    if (asked(e.info.id) || ((all || (defaults && by_default)) && obstacle(e.info).empty())) {
      metrics_.push_back(&e);
      result_.metrics.push_back(find_metric(e.info.id));
    }
  }
  for (Run& r : runs_) {
    r.values.assign(metrics_.size(), std::vector<PixelMean>(result_.sides[r.side].frames.size()));
  }
  noise_.assign(metrics_.size(), std::vector<double>(all_frames_.size(), kUndefined));
  if (observer_) {
    for (const std::string& id : observer_->maps()) {
      if (!get_metric(id).has_map) throw Error(ErrorCode::kBadInput, fmt::format("\"{}\" has no map", id));
      for (const MetricEntry& e : metric_entries()) {
        if (e.info.id == id) drawn_.push_back(&e);
      }
    }
  }
  std::vector<const MetricEntry*> used = metrics_;
  used.insert(used.end(), drawn_.begin(), drawn_.end());
  const auto uses = [&](auto... needs) {
    return std::any_of(used.begin(), used.end(),
                       [&](const MetricEntry* e) { return ((e->info.needs == needs) || ...); });
  };
  const bool vectors_wanted = observer_ && observer_->motion();
  uses_previous_ = has_backward_ && uses(MetricNeeds::kMotion);
  uses_tracks_ = uses(MetricNeeds::kTracks);
  uses_test_motion_ = tests_have_motion_ && uses(MetricNeeds::kMotionBoth);
  uses_pairs_ =
      std::any_of(used.begin(), used.end(), [](const MetricEntry* e) { return e->info.scope == MetricScope::kPair; });
  uses_seeds_ = uses(MetricNeeds::kSeeds);
  for (std::size_t k = 0; k < kSpectra.size(); ++k) {
    uses_spectrum_[k] = measures(kSpectra[k]);
    uses_spectra_ |= uses_spectrum_[k];
  }
  reads_backward_ = has_backward_ && (uses_previous_ || uses_test_motion_ || uses_tracks_ || vectors_wanted);
  reads_forward_ = has_forward_ && (uses_previous_ || uses_tracks_ || vectors_wanted);
}

bool Comparison::measures(std::string_view id) const {
  return std::any_of(metrics_.begin(), metrics_.end(), [&](const MetricEntry* e) { return e->info.id == id; });
}

void Comparison::plan_spectra() {
  std::int64_t bytes = 0;   // of each pixel that is looked at
  const auto value_bytes =  // of a pixel in a frame
      std::int64_t(sizeof(float) * (uses_spectrum_[kInPlace] + uses_spectrum_[kTracked]) +
                   sizeof(std::int16_t) * uses_spectrum_[kDisplayed]);
  for (const CompareSide& side : result_.sides) {
    const auto [first, frames] = longest_stretch(side.frames, step_);
    const int first_frame = side.frames[first];
    std::size_t at = 0;
    while (at < plans_.size() && (plans_[at].first_frame != first_frame || plans_[at].frames != frames)) ++at;
    const bool is_new = at == plans_.size();
    if (is_new) {
      SpectrumPlan& plan = plans_.emplace_back();
      plan.first_frame = first_frame, plan.frames = frames;
      if (uses_spectra_) plan.segments = plan_segments(frames);
    }
    plan_of_side_.push_back(at);
    const Segments& segments = plans_[at].segments;
    const std::int64_t at_a_time = std::min<std::int64_t>(2, std::int64_t(segments.starts.size()));
    const std::int64_t runs = std::int64_t(side.runs.size()) + (is_new && second_);
    bytes += at_a_time * (runs * segments.length * value_bytes +
                          std::int64_t(sizeof(Vec2f)) * (is_new && uses_spectrum_[kTracked]));
  }
  int stride = 1;
  while (std::int64_t((result_.width + stride - 1) / stride) * ((result_.height + stride - 1) / stride) * bytes >
         std::max<std::int64_t>(options_.spectrum_memory, bytes)) {
    ++stride;
  }
  choice_ = std::make_shared<const PixelChoice>(result_.width, result_.height, stride);
}

}  // namespace tempera
