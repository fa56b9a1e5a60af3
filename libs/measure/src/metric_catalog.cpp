// SPDX-License-Identifier: Apache-2.0
#include "tempera/measure/metric_catalog.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "display_values.h"
#include "flip.h"
#include "metric_entry.h"
#include "tempera/core/error.h"

namespace tempera {
namespace {

/// display(reference), or the mean of that of both references.
template <class F>
Image displayed_reference(const FrameBatch& batch, F&& display) {
  if (!batch.first) return display(batch.reference, batch.options.exposure);
  return mean_of(display(*batch.first, batch.options.exposure), display(*batch.second, batch.options.exposure));
}

std::vector<FlipTest> flip_tests(const FrameBatch& batch, std::span<const Measurement> out) {
  std::vector<FlipTest> tests;
  for (std::size_t i = 0; i < batch.tests.size(); ++i) tests.push_back({batch.tests[i].image, out[i].map});
  return tests;
}

const auto kEntries = std::to_array<MetricEntry>({
    {.info = {.id = "flicker_display",
              .title = "displayed flicker",
              .unit = "1/255",
              .help = "rms of the displayed luminance's error (sRGB, clipped at 1) above the cutoff frequency",
              .formula = "255 sqrt(sum over f > cutoff of mean over p of |DFT_f(w e)|^2), e = L(T) - L(R), L displayed "
                         "luminance in [0,1], w Hann window",
              .source = "[Manzi 2016, Sec. 3.4], [Welch 1967]",
              .scope = MetricScope::kSequence,
              .squared = true,
              .is_default = true},
     .scale = MetricScale::kDisplayLevels},
    {.info = {.id = "relmse",
              .title = "relMSE",
              .help = "mean of squared differences over squared reference + epsilon",
              .formula = "mean over p, c of (T - R)^2 / (R^2 + epsilon), epsilon = 0.01",
              .source = "[Rousselle 2011]",
              .has_map = true,
              .trims = true,
              .squared = true,
              .is_default = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           return PixelMean{relative_mse(*t.image, b.reference, map, b.options.epsilon, b.options.trim)};
         }},
    {.info = {.id = "relmse_gray",
              .title = "relMSE, gray",
              .help = "as relmse, relative to the mean of the reference's channels: gradient-domain rendering",
              .formula = "mean over p of (mean over c of (T - R)^2) / ((mean over c of R)^2 + 0.001)",
              .source = "[Kettunen 2015]",
              .has_map = true,
              .trims = true,
              .squared = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           return PixelMean{relative_mse_gray(*t.image, b.reference, map, 1e-3, b.options.trim)};
         }},
    {.info = {.id = "mse",
              .title = "MSE",
              .help = "mean of squared differences",
              .formula = "mean over p, c of (T - R)^2",
              .has_map = true,
              .trims = true,
              .squared = true,
              .is_default = true},
     .of_test = [](const FrameBatch& b, const TestFrame& t,
                   Image* map) { return PixelMean{mse(*t.image, b.reference, map, b.options.trim)}; }},
    {.info = {.id = "bias",
              .title = "bias of luminance",
              .help = "mean luminance over that of the reference, minus 1",
              .formula = "(mean over p of Y(T)) / (mean over p of Y(R)) - 1, Y luminance",
              .better = MetricBetter::kNearZero,
              .is_default = true},
     .of_test = [](const FrameBatch& b, const TestFrame& t,
                   Image*) { return PixelMean{luminance_bias(*t.image, b.reference)}; }},
    {.info = {.id = "bias_squared",
              .title = "bias^2",
              .help = "the part of relmse that stays however many runs are averaged; of groups of runs",
              .formula = "mean over p, c and pairs of runs i != j of (T_i - R) (T_j - R) / (R^2 + epsilon)",
              .needs = MetricNeeds::kSeeds,
              .squared = true,
              .is_default = true}},
    {.info = {.id = "variance",
              .title = "variance",
              .help = "the part of relmse that differs from run to run; of groups of runs",
              .formula = "mean over p, c of (variance over runs of T) / (R^2 + epsilon) = relmse - bias_squared",
              .needs = MetricNeeds::kSeeds,
              .is_default = true}},
    {.info = {.id = "psnr",
              .title = "PSNR",
              .unit = "dB",
              .help = "peak signal-to-noise ratio of the displayed pictures (sRGB, clipped at 1)",
              .formula = "-10 log10 (mean over p, c of (D(T) - D(R))^2), D display value in [0,1]",
              .better = MetricBetter::kHigher,
              .squared = true,
              .is_default = true},
     .of_batch =
         [](const FrameBatch& b, std::span<Measurement> out) {
           const Image reference = displayed_reference(b, display_colors);
           for (std::size_t i = 0; i < out.size(); ++i) {
             out[i].mean = {encoded_mse(display_colors(*b.tests[i].image, b.options.exposure), reference)};
           }
         },
     .scale = MetricScale::kDecibels},
    {.info = {.id = "ssim",
              .title = "SSIM",
              .help = "structural similarity of the displayed luminance (sRGB, clipped at 1), 1 for equal pictures",
              .formula =
                  "mean over p of (2 m_T m_R + 1e-4) (2 s_TR + 9e-4) / ((m_T^2 + m_R^2 + 1e-4) (s_T^2 + s_R^2 + 9e-4)) "
                  "in Gaussian windows of 11x11 pixels, deviation 1.5",
              .source = "[Wang 2004]",
              .better = MetricBetter::kHigher,
              .is_default = true},
     .of_batch =
         [](const FrameBatch& b, std::span<Measurement> out) {
           const Image reference = displayed_reference(b, display_luminance);
           for (std::size_t i = 0; i < out.size(); ++i) {
             out[i].mean = {encoded_ssim(display_luminance(*b.tests[i].image, b.options.exposure), reference)};
           }
         }},
    {.info = {.id = "flip",
              .title = "FLIP",
              .help = "the difference that a person sees on a display when alternating between the two, 0 to 1",
              .formula = "mean over p of (Delta E_c)^(1 - Delta E_f)",
              .source = "[Andersson 2020]",
              .has_map = true,
              .is_default = true},
     .of_batch =
         [](const FrameBatch& b, std::span<Measurement> out) {
           const auto values =
               flip(flip_tests(b, out), b.reference, std::exp2(b.options.exposure), b.options.pixels_per_degree);
           for (std::size_t i = 0; i < values.size(); ++i) out[i].mean = {values[i]};
         }},
    {.info = {.id = "hdr_flip",
              .title = "HDR-FLIP",
              .help = "the largest FLIP of each pixel over all exposures, 0 to 1; takes ten times as long",
              .formula = "mean over p of the largest FLIP over exposures, tone mapped",
              .source = "[Andersson 2021]",
              .has_map = true},
     .of_batch =
         [](const FrameBatch& b, std::span<Measurement> out) {
           const auto values = hdr_flip(flip_tests(b, out), b.reference, b.options.pixels_per_degree);
           for (std::size_t i = 0; i < values.size(); ++i) out[i].mean = {values[i]};
         }},
    {.info = {.id = "temporal",
              .title = "temporal error",
              .help = "relMSE of the change since the frame before",
              .formula =
                  "mean over p, c of ((T_t - T_(t-1)) - (R_t - R_(t-1)))^2 / ((R_t^2 + R_(t-1)^2) / 2 + epsilon), "
                  "epsilon = 0.01",
              .scope = MetricScope::kPair,
              .has_map = true,
              .trims = true,
              .squared = true,
              .is_default = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           return temporal_error(*t.image, *t.before, b.reference, *b.reference_before, nullptr, map, b.options.epsilon,
                                 b.options.trim);
         }},
    {.info = {.id = "temporal_compensated",
              .title = "temporal error along motion",
              .help = "as temporal, with the frame before looked up along the reference's motion vectors",
              .formula =
                  "as temporal, with T_(t-1) and R_(t-1) at p + motion.backward(p), where that is visible in both",
              .scope = MetricScope::kPair,
              .needs = MetricNeeds::kMotion,
              .has_map = true,
              .trims = true,
              .squared = true,
              .is_default = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           if (!b.previous) return PixelMean();
           return temporal_error(*t.image, *t.before, b.reference, *b.reference_before, b.previous, map,
                                 b.options.epsilon, b.options.trim);
         }},
    {.info = {.id = "warp_error",
              .title = "warp error",
              .help = "relative squared change of what moves, along the reference's motion vectors",
              .formula = "mean over p, c of (T_t(p) - T_(t-1)(q))^2 / ((R_t(p)^2 + R_(t-1)(q)^2) / 2 + epsilon), "
                         "q = p + motion.backward(p)",
              .source = "[Lai 2018]",
              .scope = MetricScope::kPair,
              .needs = MetricNeeds::kMotion,
              .has_map = true,
              .trims = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           if (!b.previous) return PixelMean();
           return warp_error(*t.image, *t.before, b.reference, *b.reference_before, *b.previous, map, b.options.epsilon,
                             b.options.trim);
         }},
    {.info = {.id = "motion_error",
              .title = "error of motion vectors",
              .unit = "pixels",
              .help = "mean distance between motion.backward of test and reference where both are valid",
              .formula = "mean over p of |motion_T(p) - motion_R(p)|",
              .needs = MetricNeeds::kMotionBoth,
              .has_map = true},
     .of_test =
         [](const FrameBatch& b, const TestFrame& t, Image* map) {
           return t.motion && b.motion ? motion_error(*t.motion, *b.motion, map) : PixelMean();
         }},
    {.info = {.id = "flicker_static",
              .title = "change of luminance",
              .help = "mean luminance difference to the frame before; flicker if nothing moves",
              .formula = "mean over p of |Y(T_t) - Y(T_(t-1))|, Y luminance",
              .scope = MetricScope::kPair,
              .needs = MetricNeeds::kStillScene,
              .has_map = true,
              .is_default = true},
     .of_test = [](const FrameBatch&, const TestFrame& t,
                   Image* map) { return luminance_change(*t.image, *t.before, map); }},
    {.info = {.id = "flicker",
              .title = "flicker",
              .help = "power of the residual (luminance of test minus reference) above the cutoff frequency",
              .formula = "sum over f > cutoff of mean over p of |DFT_f(w e)|^2, e = Y(T) - Y(R), w Hann window",
              .source = "[Manzi 2016, Sec. 3.4], [Welch 1967]",
              .scope = MetricScope::kSequence,
              .squared = true,
              .is_default = true}},
    {.info = {.id = "flicker_tracked",
              .title = "flicker along motion",
              .help = "as flicker, of pixels that follow the reference's motion vectors",
              .formula = "as flicker, with e looked up where the pixel moves to",
              .source = "[Manzi 2016, Sec. 3.4], [Welch 1967]",
              .scope = MetricScope::kSequence,
              .needs = MetricNeeds::kTracks,
              .squared = true}},
});

}  // namespace

void MetricEntry::measure(const FrameBatch& batch, std::span<Measurement> out) const {
  if (of_batch) return of_batch(batch, out);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const TestFrame& test = batch.tests[i];
    const bool has_value = info.scope != MetricScope::kPair || (batch.reference_before && test.before);
    if (has_value) out[i].mean = of_test(batch, test, out[i].map);
  }
}

std::span<const MetricEntry> metric_entries() { return kEntries; }

std::span<const MetricInfo> metric_catalog() {
  static const std::vector<MetricInfo> infos = [] {
    std::vector<MetricInfo> out;
    out.reserve(kEntries.size());
    for (const MetricEntry& e : kEntries) out.push_back(e.info);
    return out;
  }();
  return infos;
}

const MetricInfo* find_metric(std::string_view id) {
  for (const MetricInfo& m : metric_catalog()) {
    if (m.id == id) return &m;
  }
  return nullptr;
}

const MetricInfo& get_metric(std::string_view id) {
  if (const MetricInfo* m = find_metric(id)) return *m;
  std::vector<std::string> names;
  for (const MetricInfo& m : metric_catalog()) names.emplace_back(m.id);
  throw Error(ErrorCode::kUnknownName,
              fmt::format("unknown metric \"{}\"; known: {}", id, nearest_names(id, std::move(names))));
}

const char* to_text(MetricBetter better) {
  switch (better) {
    case MetricBetter::kLower:
      return "lower";
    case MetricBetter::kHigher:
      return "higher";
    case MetricBetter::kNearZero:
      return "near zero";
  }
  return "";
}

bool is_worse(const MetricInfo& metric, double value, double limit) {
  switch (metric.better) {
    case MetricBetter::kLower:
      return !(value <= limit);
    case MetricBetter::kHigher:
      return !(value >= limit);
    case MetricBetter::kNearZero:
      return !(std::abs(value) <= limit);
  }
  return true;
}

}  // namespace tempera
