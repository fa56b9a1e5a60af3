// SPDX-License-Identifier: Apache-2.0
// What a comparison comes to: series and means of what was measured, and notes on it.
#include <fmt/format.h>

#include <cmath>

#include "comparison.h"
#include "display_values.h"

namespace tempera {

double Comparison::scaled(MetricScale scale, double mean_square) {
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

void Comparison::rescale(MetricScale scale, MetricSeries& s) {
  const double mean_square = s.mean.mean;
  s.mean.mean = scaled(scale, mean_square);
  for (double& v : s.values) v = scaled(scale, v);
  if (scale == MetricScale::kPlain) return;
  const double slope =
      scale == MetricScale::kDecibels ? 10 / std::log(10.0) / mean_square : 255 / (2 * std::sqrt(mean_square));
  s.mean.standard_error *= mean_square > 0 ? slope : kUndefined;
}

void Comparison::take_noise_out() {
  if (!second_) return;
  for (std::size_t m = 0; m < metrics_.size(); ++m) {
    const MetricEntry& e = *metrics_[m];
    double noise = mean_error(noise_[m]).mean;
    if (e.info.scope == MetricScope::kSequence) {
      const SpectrumPlan& plan = plans_[plan_of_side_[0]];
      if (!plan.segments.starts.empty()) noise = power_above(spectrum(e, plan, plan.reference), options_.cutoff);
    }
    result_.reference_noise.push_back(scaled(e.scale, noise));
    if (!e.info.squared || !e.measures_frames()) continue;
    for (Run& r : runs_) {
      const std::vector<int>& frames = result_.sides[r.side].frames;
      for (std::size_t f = 0; f < frames.size(); ++f) {
        r.values[m][f].value -= noise_[m][sorted_index(all_frames_, frames[f])];
      }
    }
  }
}

MetricSeries Comparison::series_of(const MetricEntry& entry,
                                   const std::vector<const std::vector<PixelMean>*>& runs) const {
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

MetricSeries Comparison::seed_series(const MetricEntry& entry, std::size_t side) const {
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
    const double noise = reference_errors_[sorted_index(all_frames_, result_.sides[side].frames[f])];
    s.values.back() -= noise;
    for (double& v : without.back()) v -= noise;
  }
  s.mean = jackknife(s.values, without);
  if (s.values.empty()) s.values.assign(result_.sides[side].frames.size(), kUndefined);
  return s;
}

ResidualSpectrum Comparison::spectrum(const MetricEntry& entry, const SpectrumPlan& plan,
                                      const Residuals& residuals) const {
  const std::size_t kind = std::find(kSpectra.begin(), kSpectra.end(), entry.info.id) - kSpectra.begin();
  const PowerSums& sums = residuals.power[kind];
  const double all = double(result_.width) * double(result_.height) * double(plan.segments.starts.size());
  return spectrum_of(entry.info.id, plan.segments, sums, sums.pixels / all);
}

MetricSeries Comparison::spectrum_series(const MetricEntry& entry, std::size_t side) {
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

void Comparison::finish() {
  if (options_.where && region_pixels_ == 0) {
    throw Error(ErrorCode::kBadInput,
                fmt::format("no pixel of the reference {} has {} = {:g}: there is nothing to compare",
                            reference_.pattern(), options_.where->layer, options_.where->value));
  }
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

void Comparison::add_notes() {
  std::vector<std::string>& notes = result_.notes;
  std::vector<std::string_view> trimmed;
  for (const MetricInfo* m : result_.metrics) {
    if (m->trims) trimmed.push_back(m->title);
  }
  if (options_.trim > 0 && !trimmed.empty()) {
    notes.push_back(fmt::format("The {:g} % of the pixels with the largest errors are left out of {}.",
                                options_.trim * 100, fmt::join(trimmed, ", ")));
  }
  if (options_.where) {
    const double all = double(result_.width) * result_.height * double(all_frames_.size());
    notes.push_back(fmt::format("Only the pixels where {} is {:g} count, {:.2g} % of all.", options_.where->layer,
                                options_.where->value, 100 * double(region_pixels_) / all));
  }
  if (choice_->stride > 1) {
    notes.push_back(fmt::format("Flicker was measured at one pixel of each {0}x{0}, to save memory.", choice_->stride));
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
      notes.push_back(fmt::format("{} has {} frames that the reference lacks, from {} on.", s.name, s.unmatched.size(),
                                  s.unmatched[0]));
    }
  }
  for (const CompareSide& s : result_.sides) {
    if (s.frames == result_.sides[0].frames) continue;
    notes.push_back("The sides were compared in different frames.");
    break;
  }
}

}  // namespace tempera
