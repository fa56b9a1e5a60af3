// SPDX-License-Identifier: Apache-2.0
// Reading the files of a frame and measuring what is in them.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "comparison.h"
#include "display_values.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/frame.h"

namespace tempera {

CompareResult Comparison::run() {
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

Image Comparison::load_vectors(const FrameSequence& sequence, int frame, const LayerDesc& layer) const {
  return std::move(read_frame(sequence.path(frame), {{layer.name}}).layer(layer.name));
}

Comparison::ReferenceFrame Comparison::load_reference(int frame) const {
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
  if (options_.where) read.layers.push_back(options_.where->layer);
  Frame f = read_frame(reference_.path(reference_frame(frame)), read);
  if (options_.where) r.region = f.layer(options_.where->layer);  // which may be any layer that is taken below
  r.image = std::move(f.layer(options_.layer));
  if (second_) {
    r.first = std::move(r.image);
    r.second = std::move(read_frame(second_path(frame), {{options_.layer}}).layer(options_.layer));
    if (r.first.width() != r.second.width() || r.first.height() != r.second.height()) {
      throw Error(ErrorCode::kBadInput,
                  fmt::format("the second reference {} has {}x{} pixels, the first, {}, has {}x{}", second_path(frame),
                              r.second.width(), r.second.height(), reference_.path(reference_frame(frame)),
                              r.first.width(), r.first.height()));
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
  if (options_.where) {
    for (Image* image : {&r.image, &r.first, &r.second}) keep_region(*image, r.region);
  }
  return r;
}

void Comparison::keep_region(Image& image, const Image& layer) const {
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      if (layer.at(x, y, 0) == options_.where->value) continue;
      std::fill_n(image.pixel(x, y), image.channels(), std::numeric_limits<float>::quiet_NaN());
    }
  }
}

void Comparison::load(int frame) {
  active_.clear();
  for (Run& r : runs_) {
    if (sorted_contains(result_.sides[r.side].frames, frame)) active_.push_back(&r);
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
  for (Run* r : active_) {
    CompareSide& side = result_.sides[r->side];
    side.non_finite[sorted_index(side.frames, frame)] += count_non_finite(r->now.image);
    if (options_.where) keep_region(r->now.image, now_.region);
  }
  if (options_.where) {
    const std::span<const float> values = now_.region.values();
    const int step = now_.region.channels();
    for (std::size_t i = 0; i < values.size(); i += step) region_pixels_ += values[i] == options_.where->value;
  }
}

const Comparison::ReferenceFrame* Comparison::reference_before(int frame) const {
  if (still_) return &now_;
  return before_.frame == frame - step_ ? &before_ : nullptr;
}

void Comparison::measure(int frame) {
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
    if (!metrics_[m]->measures_frames()) continue;
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
      r.values[m][sorted_index(result_.sides[r.side].frames, frame)] = out[i].mean;
    }
    if (noise) noise_[m][sorted_index(all_frames_, frame)] = out.back().mean.value;
  }
  batch.tests = std::span(tests).first(active_.size());
  if (uses_seeds_) measure_seeds(frame);
  if (uses_spectra_) record_residuals(frame);
  if (observer_) show(frame, batch, maps);
}

void Comparison::measure_reference() {
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

std::vector<const Image*> Comparison::images_of(std::size_t side) const {
  std::vector<const Image*> images;
  for (const Run* r : active_) {
    if (r->side == side) images.push_back(&r->now.image);
  }
  return images;
}

void Comparison::measure_seeds(int frame) {
  seeds_.resize(result_.sides.size());
  for (std::size_t m = 0; m < metrics_.size() && second_; ++m) {
    if (metrics_[m]->info.id == "bias_squared") noise_[m][sorted_index(all_frames_, frame)] = reference_errors_.back();
  }
  for (std::size_t s = 0; s < result_.sides.size(); ++s) {
    const std::vector<const Image*> images = images_of(s);
    if (images.size() > 1) seeds_[s].push_back(bias_and_variance(images, now_.image, options_.epsilon));
  }
}

void Comparison::record_residuals(int frame) {
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
    const bool begins = sorted_contains(plan.segments.starts, at);
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

void Comparison::show(int frame, const FrameBatch& batch,
                      std::map<std::pair<std::string_view, std::size_t>, Image>& maps) {
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

}  // namespace tempera
