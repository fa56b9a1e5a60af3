// SPDX-License-Identifier: Apache-2.0
// One pass over the frames: the files of a frame are read side by side, everything is measured, and only the pictures
// of this frame and of the one before stay in memory.
#include "tempera/measure/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "display_values.h"
#include "metric_entry.h"
#include "pixel_mean.h"
#include "residual.h"
#include "seed_statistics.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/frame.h"

namespace tempera {
namespace {

bool contains(const std::vector<int>& sorted, int value) {
  return std::binary_search(sorted.begin(), sorted.end(), value);
}
std::size_t index_of(const std::vector<int>& sorted, int value) {
  return std::size_t(std::lower_bound(sorted.begin(), sorted.end(), value) - sorted.begin());
}

// --- What to compare

/// Which frames a side is compared in, of those in `chosen` (ascending; empty: all).
CompareSide plan_side(const CompareInput& input, const FrameSequence& reference, const std::vector<int>& chosen) {
  CompareSide side;
  side.name = input.name;
  for (const FrameSequence& r : input.runs) side.runs.push_back(r.pattern());
  const bool still = reference.frames().size() == 1;
  const auto wanted = [&](int f) { return chosen.empty() || contains(chosen, f); };
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
    if (wanted(f) && f > side.frames.front() && f < side.frames.back() && !contains(side.frames, f)) {
      side.missing.push_back(f);
    }
  }
  side.non_finite.assign(side.frames.size(), 0);
  return side;
}

/// The first and the number of frames of the longest stretch that has a frame every `step`.
std::pair<std::size_t, int> longest_stretch(const std::vector<int>& frames, int step) {
  std::size_t best = 0, begin = 0;
  int length = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i > 0 && frames[i] != frames[i - 1] + step) begin = i;
    if (int(i - begin) + 1 > length) best = begin, length = int(i - begin) + 1;
  }
  return {best, length};
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

// --- What is in memory

struct Picture {
  std::optional<int> frame;  ///< that it shows; none if it shows nothing
  Image image;
};

/// The residuals that have a spectrum, by the metric that is made of it.
constexpr std::array<std::string_view, 3> kSpectra{"flicker_display", "flicker", "flicker_tracked"};
enum SpectrumKind : std::size_t { kDisplayed, kInPlace, kTracked };

/// The residuals of one run.
struct Residuals {
  std::array<PowerSums, kSpectra.size()> power;
  // Of the segments that are being filled, the oldest first.
  std::vector<SegmentRecord<std::int16_t>> displayed;
  std::vector<SegmentRecord<float>> in_place, tracked;
};

/// One run of one side, and what has been measured of it.
struct Run {
  std::size_t side = 0, index = 0;  ///< index: within its side
  const FrameSequence* sequence = nullptr;
  std::vector<std::vector<PixelMean>> values;  ///< [metric][frame of the side]
  Picture now, before;
  Image motion;
  Residuals residuals;
};

/// What the runs of a side share in the spectrum of their residuals; sides with the same frames have one together.
struct SpectrumPlan {
  Segments segments;  ///< empty if there are too few frames
  int first_frame = 0, frames = 0;
  std::vector<Tracks> tracks;  ///< of the segments that are being filled
  Residuals reference;         ///< of the first reference, if there are two
};

struct ReferenceFrame {
  std::optional<int> frame;
  Image image;          ///< the mean, if there are two references
  Image first, second;  ///< empty if there is one
  Image half_a, half_b, backward, forward;
};

class Comparison {
 public:
  Comparison(const std::vector<CompareInput>& tests, const FrameSequence& reference, const CompareOptions& options,
             const CompareProgress& progress, CompareObserver* observer)
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

  CompareResult run() {
    for (const int frame : all_frames_) {
      load(frame);
      measure(frame);
      for (Run* r : active_) {
        r->before = uses_pairs_ ? std::exchange(r->now, {}) : Picture{};
        if (progress_) progress_(++done_, total_);
      }
      if (!still_) before_ = std::exchange(now_, {});
    }
    finish();
    return std::move(result_);
  }

 private:
  void plan_sides() {
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

  int reference_frame(int frame) const { return still_ ? reference_.frames()[0] : frame; }
  std::string second_path(int frame) const { return second_->path(still_ ? second_->frames()[0] : frame); }

  void plan_second_reference() {
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

  /// What the files hold, judged by the first frame.
  void plan_files() {
    const FrameHeader header = read_header(reference_.path(reference_frame(all_frames_[0])));
    const auto has = [](const FrameHeader& h, std::string_view layer) {
      return std::any_of(h.layers.begin(), h.layers.end(), [&](const LayerDesc& l) { return l.name == layer; });
    };
    if (const auto info = render_info(header.metadata)) result_.fps = info->fps;
    result_.width = header.width, result_.height = header.height;
    has_halves_ = !second_ && options_.layer == layers::color().name && has(header, layers::color_a().name) &&
                  has(header, layers::color_b().name);
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

  /// Why a metric cannot be measured; "" if it can.
  std::string obstacle(const MetricInfo& m) const {
    const std::string vectors = options_.motion.empty() ? reference_.pattern() : options_.motion;
    switch (m.needs) {
      case MetricNeeds::kNothing:
      case MetricNeeds::kStillScene:
        break;
      case MetricNeeds::kSeeds:
        if (runs_.size() == result_.sides.size())
          return "it needs several runs of a method, as \"out/seed*/f.####.exr\"";
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

  void plan_metrics() {
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

  bool measures(std::string_view id) const {
    return std::any_of(metrics_.begin(), metrics_.end(), [&](const MetricEntry* e) { return e->info.id == id; });
  }

  void plan_spectra() {
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

  // --- Frames

  Image load_vectors(const FrameSequence& sequence, int frame, const LayerDesc& layer) const {
    return std::move(read_frame(sequence.path(frame), {{layer.name}}).layer(layer.name));
  }

  ReferenceFrame load_reference(int frame) const {
    ReferenceFrame r;
    r.frame = frame;
    ReadOptions read{{options_.layer}};
    const auto add = [&](bool use, const LayerDesc& layer) {
      if (use) read.layers.push_back(layer.name);
    };
    const bool own_vectors = !motion_;
    add(has_halves_, layers::color_a());
    add(has_halves_, layers::color_b());
    add(own_vectors && reads_backward_, layers::motion_backward());
    add(own_vectors && reads_forward_, layers::motion_forward());
    Frame f = read_frame(reference_.path(reference_frame(frame)), read);
    r.image = std::move(f.layer(options_.layer));
    if (second_) {
      r.first = std::move(r.image);
      r.second = std::move(read_frame(second_path(frame), {{options_.layer}}).layer(options_.layer));
      if (r.first.width() != r.second.width() || r.first.height() != r.second.height()) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("the second reference {} has {}x{} pixels, the first, {}, has {}x{}",
                                second_path(frame), r.second.width(), r.second.height(),
                                reference_.path(reference_frame(frame)), r.first.width(), r.first.height()));
      }
      r.image = mean_of(r.first, r.second);
    }
    const auto take = [&](bool use, const LayerDesc& layer, Image& image) {
      if (use) image = std::move(f.layer(layer.name));
    };
    take(has_halves_, layers::color_a(), r.half_a);
    take(has_halves_, layers::color_b(), r.half_b);
    take(own_vectors && reads_backward_, layers::motion_backward(), r.backward);
    take(own_vectors && reads_forward_, layers::motion_forward(), r.forward);
    if (motion_ && motion_->has(frame)) {
      if (reads_backward_) r.backward = load_vectors(*motion_, frame, layers::motion_backward());
      if (reads_forward_) r.forward = load_vectors(*motion_, frame, layers::motion_forward());
    }
    for (const Image* vectors : {&r.backward, &r.forward}) {
      if (!vectors->empty() && (vectors->width() != r.image.width() || vectors->height() != r.image.height())) {
        throw Error(
            ErrorCode::kBadInput,
            fmt::format("the motion vectors of frame {} have {}x{} pixels, the reference {} has {}x{}", frame,
                        vectors->width(), vectors->height(), reference_.pattern(), r.image.width(), r.image.height()));
      }
    }
    return r;
  }

  void load(int frame) {
    active_.clear();
    for (Run& r : runs_) {
      if (contains(result_.sides[r.side].frames, frame)) active_.push_back(&r);
    }
    const bool new_reference = !still_ || now_.image.empty();
    parallel_for(-1, std::int64_t(active_.size()), [&](std::int64_t i) {
      if (i < 0) {
        if (new_reference) now_ = load_reference(frame);
        return;
      }
      Run& r = *active_[i];
      ReadOptions read{{options_.layer}};
      if (uses_test_motion_) read.layers.push_back(layers::motion_backward().name);
      Frame f = read_frame(r.sequence->path(frame), read);
      r.now = {frame, std::move(f.layer(options_.layer))};
      if (uses_test_motion_) r.motion = std::move(f.layer(layers::motion_backward().name));
    });
    now_.frame = frame;
    for (const Run* r : active_) {
      if (r->now.image.width() == now_.image.width() && r->now.image.height() == now_.image.height()) continue;
      throw Error(ErrorCode::kBadInput,
                  fmt::format("{} has {}x{} pixels, the reference {} has {}x{}", r->sequence->path(frame),
                              r->now.image.width(), r->now.image.height(), reference_.path(reference_frame(frame)),
                              now_.image.width(), now_.image.height()));
    }
    if (now_.image.width() != result_.width || now_.image.height() != result_.height) {
      throw Error(ErrorCode::kBadInput,
                  fmt::format("{} has {}x{} pixels, frames before it {}x{}", reference_.path(reference_frame(frame)),
                              now_.image.width(), now_.image.height(), result_.width, result_.height));
    }
  }

  static const Image* some(const Image& image) { return image.empty() ? nullptr : &image; }

  /// The reference in the frame before; null if that was not compared.
  const ReferenceFrame* reference_before(int frame) const {
    if (still_) return &now_;
    return before_.frame == frame - step_ ? &before_ : nullptr;
  }

  void measure(int frame) {
    measure_reference();
    const ReferenceFrame* const before = reference_before(frame);
    Image previous;
    if (uses_previous_ && before && !now_.backward.empty()) {
      previous = previous_positions(now_.backward, some(before_.forward));
    }
    std::vector<TestFrame> tests;
    for (const Run* r : active_) {
      const bool pair = before && r->before.frame == frame - step_;
      tests.push_back({&r->now.image, pair ? &r->before.image : nullptr, some(r->motion)});
    }
    // The noise of two references is what a squared metric makes of the first one, beside the mean of both.
    if (second_) tests.push_back({&now_.first, before ? &before->first : nullptr, nullptr});
    FrameBatch batch{.reference = now_.image,
                     .first = some(now_.first),
                     .second = some(now_.second),
                     .reference_before = before ? &before->image : nullptr,
                     .motion = some(now_.backward),
                     .previous = some(previous),
                     .tests = tests,
                     .options = options_};
    if (observer_) observer_->reference(frame, now_.image, some(now_.backward), some(now_.forward));

    // Maps are drawn of the first run of each side.
    std::map<std::pair<std::string_view, std::size_t>, Image> maps;
    for (std::size_t m = 0; m < metrics_.size(); ++m) {
      if (!metrics_[m]->measure) continue;
      const bool drawn = std::find(drawn_.begin(), drawn_.end(), metrics_[m]) != drawn_.end();
      const bool noise = second_ && metrics_[m]->info.squared;
      std::vector<Measurement> out(active_.size() + noise);
      for (std::size_t i = 0; i < active_.size(); ++i) {
        if (drawn && active_[i]->index == 0) out[i].map = &maps[{metrics_[m]->info.id, i}];
      }
      batch.tests = std::span(tests).first(out.size());
      metrics_[m]->measure(batch, out);
      for (std::size_t i = 0; i < active_.size(); ++i) {
        Run& r = *active_[i];
        r.values[m][index_of(result_.sides[r.side].frames, frame)] = out[i].mean;
      }
      if (noise) noise_[m][index_of(all_frames_, frame)] = out.back().mean.value;
    }
    batch.tests = std::span(tests).first(active_.size());
    for (const Run* r : active_) {
      CompareSide& side = result_.sides[r->side];
      side.non_finite[index_of(side.frames, frame)] += count_non_finite(r->now.image);
    }
    if (uses_seeds_) measure_seeds(frame);
    if (uses_spectra_) record_residuals(frame);
    if (observer_) show(frame, batch, maps);
  }

  /// The reference's own error: half of the difference of two references, or of its halves, has the variance of their
  /// mean.
  void measure_reference() {
    if (second_) {
      reference_errors_.push_back(relative_mse(now_.first, now_.image, nullptr, options_.epsilon));
      return;
    }
    if (!has_halves_ || (still_ && !reference_errors_.empty())) return;
    const PixelMean e = mean_over_pixels(result_.width, result_.height, nullptr, 0, [&](int x, int y) {
      const Rgb a = now_.half_a.rgb(x, y), b = now_.half_b.rgb(x, y), r = now_.image.rgb(x, y);
      double sum = 0;
      for (int c = 0; c < 3; ++c) {
        const double half = (double(a[c]) - double(b[c])) / 2;
        sum += half * half / (double(r[c]) * double(r[c]) + options_.epsilon);
      }
      return std::isfinite(sum) ? sum / 3 : kUndefined;
    });
    reference_errors_.push_back(e.value);
  }

  /// The runs of a side that are in memory.
  std::vector<const Image*> images_of(std::size_t side) const {
    std::vector<const Image*> images;
    for (const Run* r : active_) {
      if (r->side == side) images.push_back(&r->now.image);
    }
    return images;
  }

  void measure_seeds(int frame) {
    seeds_.resize(result_.sides.size());
    for (std::size_t m = 0; m < metrics_.size() && second_; ++m) {
      if (metrics_[m]->info.id == "bias_squared") noise_[m][index_of(all_frames_, frame)] = reference_errors_.back();
    }
    for (std::size_t s = 0; s < result_.sides.size(); ++s) {
      const std::vector<const Image*> images = images_of(s);
      if (images.size() > 1) seeds_[s].push_back(bias_and_variance(images, now_.image, options_.epsilon));
    }
  }

  void record_residuals(int frame) {
    const bool displays = uses_spectrum_[kDisplayed];
    const auto displayed = [&](const Image& image) { return display_luminance(image, options_.exposure); };
    Image shown_reference, shown_first;
    if (displays) {
      shown_reference = displayed(second_ ? now_.first : now_.image);
      if (second_) {
        shown_first = std::move(shown_reference);
        shown_reference = mean_of(shown_first, displayed(now_.second));
      }
    }
    for (std::size_t p = 0; p < plans_.size(); ++p) {
      SpectrumPlan& plan = plans_[p];
      const int at = (frame - plan.first_frame) / step_;
      if (plan.segments.starts.empty() || frame < plan.first_frame || at >= plan.frames) continue;
      for (Tracks& t : plan.tracks) {
        t.advance(before_.forward, some(now_.backward));
      }
      const bool begins = contains(plan.segments.starts, at);
      if (begins && uses_spectrum_[kTracked]) plan.tracks.emplace_back(*choice_);
      bool ended = false;
      const auto record = [&](Residuals& residuals, SpectrumKind kind, auto& segments, const Image& test,
                              const Image& reference) {
        if (!uses_spectrum_[kind]) return;
        if (begins) segments.emplace_back(plan.segments, choice_);
        for (std::size_t i = 0; i < segments.size(); ++i) {
          segments[i].add(test, reference, kind == kTracked ? &plan.tracks[i].positions() : nullptr);
        }
        if (!segments.front().full()) return;
        segments.front().add_to(residuals.power[kind]);
        segments.erase(segments.begin());
        ended = true;
      };
      const auto record_all = [&](Residuals& residuals, const Image& test, const Image& shown) {
        record(residuals, kDisplayed, residuals.displayed, shown, shown_reference);
        record(residuals, kInPlace, residuals.in_place, test, now_.image);
        record(residuals, kTracked, residuals.tracked, test, now_.image);
      };
      for (Run* r : active_) {
        if (plan_of_side_[r->side] != p) continue;
        record_all(r->residuals, r->now.image, displays ? displayed(r->now.image) : Image());
      }
      if (second_) record_all(plan.reference, now_.first, shown_first);
      if (ended && uses_spectrum_[kTracked]) plan.tracks.erase(plan.tracks.begin());
    }
  }

  void show(int frame, const FrameBatch& batch, std::map<std::pair<std::string_view, std::size_t>, Image>& maps) {
    for (std::size_t i = 0; i < active_.size(); ++i) {
      if (active_[i]->index != 0) continue;
      for (const MetricEntry* e : drawn_) {  // those that were not measured anyway
        Image& map = maps[{e->info.id, i}];
        if (!map.empty()) continue;
        const TestFrame one = batch.tests[i];
        FrameBatch alone = batch;
        alone.tests = {&one, 1};
        Measurement out{{}, &map};
        e->measure(alone, {&out, 1});
      }
      observer_->test(active_[i]->side, frame, active_[i]->now.image, [&](std::string_view id) -> const Image* {
        const auto found = maps.find({id, i});
        return found == maps.end() ? nullptr : some(found->second);
      });
    }
  }

  // --- Results

  static double scaled(MetricScale scale, double mean_square) {
    switch (scale) {
      case MetricScale::kPlain:
        break;
      case MetricScale::kDecibels:
        return decibels_below_peak(mean_square);
      case MetricScale::kDisplayLevels:
        return 255 * std::sqrt(mean_square < 0 ? 0 : mean_square);
    }
    return mean_square;
  }

  /// Makes of mean squares what the metric is; the standard error to first order.
  static void rescale(MetricScale scale, MetricSeries& s) {
    const double mean_square = s.mean.mean;
    s.mean.mean = scaled(scale, mean_square);
    for (double& v : s.values) v = scaled(scale, v);
    if (scale == MetricScale::kPlain) return;
    const double slope =
        scale == MetricScale::kDecibels ? 10 / std::log(10.0) / mean_square : 255 / (2 * std::sqrt(mean_square));
    s.mean.standard_error *= mean_square > 0 ? slope : kUndefined;
  }

  /// Takes the noise of two references out of the values of the runs.
  void take_noise_out() {
    if (!second_) return;
    for (std::size_t m = 0; m < metrics_.size(); ++m) {
      const MetricEntry& e = *metrics_[m];
      double noise = mean_error(noise_[m]).mean;
      if (e.info.scope == MetricScope::kSequence) {
        const SpectrumPlan& plan = plans_[plan_of_side_[0]];
        if (!plan.segments.starts.empty()) noise = power_above(spectrum(e, plan, plan.reference), options_.cutoff);
      }
      result_.reference_noise.push_back(scaled(e.scale, noise));
      if (!e.info.squared || !e.measure) continue;
      for (Run& r : runs_) {
        const std::vector<int>& frames = result_.sides[r.side].frames;
        for (std::size_t f = 0; f < frames.size(); ++f) {
          r.values[m][f].value -= noise_[m][index_of(all_frames_, frames[f])];
        }
      }
    }
  }

  /// The series of a metric from the values of each run.
  MetricSeries series_of(const MetricEntry& entry, const std::vector<const std::vector<PixelMean>*>& runs) const {
    MetricSeries s;
    s.metric = find_metric(entry.info.id);
    bool partial = false;
    std::vector<double> over_runs(runs.size());
    for (std::size_t f = 0; f < runs[0]->size(); ++f) {
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
        for (const PixelMean& m : *runs[r]) values.push_back(m.value);
        over_runs[r] = mean_error(values).mean;
      }
      s.mean = mean_error(over_runs);
    }
    rescale(entry.scale, s);
    return s;
  }

  MetricSeries seed_series(const MetricEntry& entry, std::size_t side) const {
    MetricSeries s;
    s.metric = find_metric(entry.info.id);
    const bool bias = entry.info.id == "bias_squared";
    std::vector<std::vector<double>> without;
    for (std::size_t f = 0; f < seeds_[side].size(); ++f) {
      const BiasVariance& b = seeds_[side][f];
      s.values.push_back(bias ? b.bias_squared : b.variance);
      without.push_back(bias ? b.bias_squared_without : b.variance_without);
      if (!bias || !second_) continue;
      // The error of the reference is one that all runs share.
      const double noise = reference_errors_[index_of(all_frames_, result_.sides[side].frames[f])];
      s.values.back() -= noise;
      for (double& v : without.back()) v -= noise;
    }
    s.mean = jackknife(s.values, without);
    if (s.values.empty()) s.values.assign(result_.sides[side].frames.size(), kUndefined);
    return s;
  }

  /// The spectrum of one run, with the noise of the references.
  ResidualSpectrum spectrum(const MetricEntry& entry, const SpectrumPlan& plan, const Residuals& residuals) const {
    const auto kind = std::size_t(std::find(kSpectra.begin(), kSpectra.end(), entry.info.id) - kSpectra.begin());
    const PowerSums& sums = residuals.power[kind];
    const double all = double(result_.width) * double(result_.height) * double(plan.segments.starts.size());
    return spectrum_of(entry.info.id, plan.segments, sums, sums.pixels / all);
  }

  /// The spectrum of a side, the mean of those of its runs, and the power above the cutoff.
  MetricSeries spectrum_series(const MetricEntry& entry, std::size_t side) {
    const SpectrumPlan& plan = plans_[plan_of_side_[side]];
    MetricSeries s;
    s.metric = find_metric(entry.info.id);
    if (plan.segments.starts.empty()) return s;
    std::vector<double> flicker;
    ResidualSpectrum mean;
    for (const Run& r : runs_) {
      if (r.side != side) continue;
      ResidualSpectrum one = spectrum(entry, plan, r.residuals);
      if (second_) {
        const ResidualSpectrum noise = spectrum(entry, plan, plan.reference);
        for (std::size_t k = 0; k < one.power.size(); ++k) one.power[k] -= noise.power[k];
      }
      flicker.push_back(power_above(one, options_.cutoff));
      if (flicker.size() == 1) {
        mean = std::move(one);
      } else {
        const double n = double(flicker.size());
        for (std::size_t k = 0; k < mean.power.size(); ++k) mean.power[k] += (one.power[k] - mean.power[k]) / n;
        mean.coverage += (one.coverage - mean.coverage) / n;
      }
    }
    s.mean = mean_error(flicker);
    rescale(entry.scale, s);
    if (entry.scale == MetricScale::kDisplayLevels) {
      for (double& p : mean.power) p *= 255.0 * 255;
    }
    result_.sides[side].spectra.push_back(std::move(mean));
    return s;
  }

  void finish() {
    result_.reference_error = mean_error(reference_errors_);
    seeds_.resize(result_.sides.size());
    take_noise_out();
    for (std::size_t s = 0; s < result_.sides.size(); ++s) {
      for (std::size_t m = 0; m < metrics_.size(); ++m) {
        const MetricEntry& e = *metrics_[m];
        CompareSide& side = result_.sides[s];
        if (e.info.needs == MetricNeeds::kSeeds) {
          side.series.push_back(seed_series(e, s));
        } else if (e.info.scope == MetricScope::kSequence) {
          side.series.push_back(spectrum_series(e, s));
        } else {
          std::vector<const std::vector<PixelMean>*> values;
          for (const Run& r : runs_) {
            if (r.side == s) values.push_back(&r.values[m]);
          }
          side.series.push_back(series_of(e, values));
        }
      }
    }
    add_notes();
  }

  void add_notes() {
    std::vector<std::string>& notes = result_.notes;
    std::vector<std::string_view> trimmed;
    for (const MetricInfo* m : result_.metrics) {
      if (m->trims) trimmed.push_back(m->title);
    }
    if (options_.trim > 0 && !trimmed.empty()) {
      notes.push_back(fmt::format("The {:g} % of the pixels with the largest errors are left out of {}.",
                                  options_.trim * 100, fmt::join(trimmed, ", ")));
    }
    if (choice_->stride > 1) {
      notes.push_back(
          fmt::format("Flicker was measured at one pixel of each {0}x{0}, to save memory.", choice_->stride));
    }
    const double own = result_.reference_error.mean;
    std::vector<std::string_view> squared;
    for (const MetricInfo* m : result_.metrics) {
      if (m->squared) squared.push_back(m->title);
    }
    if (second_ && own == 0) {
      notes.emplace_back("The two references are equal: there was no noise of theirs to take out.");
    } else if (second_ && !squared.empty()) {
      notes.push_back(fmt::format("The noise of the two references is taken out of {}.", fmt::join(squared, ", ")));
    }
    if (std::isfinite(own) && !(second_ && own == 0)) {
      notes.push_back(second_ ? fmt::format("The relMSE of the references' mean is itself about {:.2g}.", own)
                              : fmt::format("The reference's own relMSE is about {:.2g}.", own));
    }
    for (const CompareSide& s : result_.sides) {
      if (!s.missing.empty()) {
        notes.push_back(fmt::format("{} lacks {} of the frames between its first and its last, from {} on.", s.name,
                                    s.missing.size(), s.missing[0]));
      }
      if (!s.unmatched.empty()) {
        notes.push_back(fmt::format("{} has {} frames that the reference lacks, from {} on.", s.name,
                                    s.unmatched.size(), s.unmatched[0]));
      }
    }
    for (const CompareSide& s : result_.sides) {
      if (s.frames == result_.sides[0].frames) continue;
      notes.push_back("The sides were compared in different frames.");
      break;
    }
  }

  const std::vector<CompareInput>& tests_;
  const FrameSequence& reference_;
  const CompareOptions& options_;
  const CompareProgress& progress_;
  CompareObserver* observer_;

  CompareResult result_;
  std::vector<const MetricEntry*> metrics_, drawn_;
  std::optional<FrameSequence> second_;     ///< the second reference
  std::vector<std::vector<double>> noise_;  ///< of two references: [metric][frame], undefined where it does not count
  bool still_ = false, has_halves_ = false, has_backward_ = false, has_forward_ = false, tests_have_motion_ = false;
  bool uses_previous_ = false, uses_tracks_ = false, uses_test_motion_ = false, uses_pairs_ = false,
       uses_seeds_ = false, uses_spectra_ = false, reads_backward_ = false, reads_forward_ = false;
  std::array<bool, kSpectra.size()> uses_spectrum_{};
  std::optional<FrameSequence> motion_;
  std::vector<int> all_frames_;
  int step_ = 1, done_ = 0, total_ = 0;

  std::vector<Run> runs_;
  std::vector<Run*> active_;  ///< that have the current frame
  ReferenceFrame now_, before_;
  std::vector<double> reference_errors_;
  std::vector<std::vector<BiasVariance>> seeds_;  ///< [side][frame]
  std::vector<SpectrumPlan> plans_;
  std::vector<std::size_t> plan_of_side_;
  std::shared_ptr<const PixelChoice> choice_;
};

}  // namespace

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
