// SPDX-License-Identifier: Apache-2.0
#pragma once
// The comparison of sequences while it runs: one pass over the frames, in which the files of a frame are read side by
// side, everything is measured, and only the pictures of this frame and of the one before stay in memory. What is to be
// compared is planned in compare_plan.cpp, frames are read and measured in compare_measure.cpp, and what comes out is
// made of the measured values in compare_results.cpp.
#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "metric_entry.h"
#include "pixel_mean.h"
#include "residual.h"
#include "seed_statistics.h"
#include "tempera/frames/frame.h"
#include "tempera/measure/compare.h"

namespace tempera {

inline bool sorted_contains(const std::vector<int>& sorted, int value) {
  return std::binary_search(sorted.begin(), sorted.end(), value);
}
inline std::size_t sorted_index(const std::vector<int>& sorted, int value) {
  return std::lower_bound(sorted.begin(), sorted.end(), value) - sorted.begin();
}
/// The first and the number of frames of the longest stretch that has a frame every `step`.
std::pair<std::size_t, int> longest_stretch(const std::vector<int>& frames, int step);

/// compare_sequences, whose arguments it keeps references to. Used once: make it, then run it.
class Comparison {
 public:
  Comparison(const std::vector<CompareInput>& tests, const FrameSequence& reference, const CompareOptions& options,
             const CompareProgress& progress, CompareObserver* observer);
  CompareResult run();

 private:
  struct Picture {
    std::optional<int> frame;  ///< that it shows; none if it shows nothing
    Image image;
  };

  /// The residuals that have a spectrum, by the metric that is made of it.
  static constexpr std::array<std::string_view, 3> kSpectra{"flicker_display", "flicker", "flicker_tracked"};
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
    Image region;  ///< the layer of CompareOptions::where
  };

  // --- What to compare (compare_plan.cpp)

  void plan_sides();
  void plan_second_reference();
  /// What the files hold, judged by the first frame.
  void plan_files();
  void plan_metrics();
  void plan_spectra();
  /// Why a metric cannot be measured; "" if it can.
  std::string obstacle(const MetricInfo& m) const;
  bool measures(std::string_view id) const;
  /// What stands for a frame in the reference, and in the second one.
  int reference_frame(int frame) const { return still_ ? reference_.frames()[0] : frame; }
  std::string second_path(int frame) const { return second_->path(still_ ? second_->frames()[0] : frame); }

  // --- Frames (compare_measure.cpp)

  void load(int frame);
  ReferenceFrame load_reference(int frame) const;
  /// Pixels outside of the region become NaN, which metrics leave out.
  void keep_region(Image& image, const Image& layer) const;
  Image load_vectors(const FrameSequence& sequence, int frame, const LayerDesc& layer) const;
  /// The reference in the frame before; null if that was not compared.
  const ReferenceFrame* reference_before(int frame) const;
  /// The runs of a side that are in memory.
  std::vector<const Image*> images_of(std::size_t side) const;
  static const Image* some(const Image& image) { return image.empty() ? nullptr : &image; }

  void measure(int frame);
  /// The reference's own error: half of the difference of two references, or of its halves, has the variance of their
  /// mean.
  void measure_reference();
  void measure_seeds(int frame);
  void record_residuals(int frame);
  void show(int frame, const FrameBatch& batch, std::map<std::pair<std::string_view, std::size_t>, Image>& maps);

  // --- Results (compare_results.cpp)

  void finish();
  /// Takes the noise of two references out of the values of the runs.
  void take_noise_out();
  /// The series of a metric from the values of each run.
  MetricSeries series_of(const MetricEntry& entry, const std::vector<const std::vector<PixelMean>*>& runs) const;
  MetricSeries seed_series(const MetricEntry& entry, std::size_t side) const;
  /// The spectrum of a side, the mean of those of its runs, and the power above the cutoff.
  MetricSeries spectrum_series(const MetricEntry& entry, std::size_t side);
  /// The spectrum of one run, with the noise of the references.
  ResidualSpectrum spectrum(const MetricEntry& entry, const SpectrumPlan& plan, const Residuals& residuals) const;
  static double scaled(MetricScale scale, double mean_square);
  /// Makes of mean squares what the metric is; the standard error to first order.
  static void rescale(MetricScale scale, MetricSeries& s);
  void add_notes();

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
  std::int64_t region_pixels_ = 0;  ///< of all frames
  std::vector<double> reference_errors_;
  std::vector<std::vector<BiasVariance>> seeds_;  ///< [side][frame]
  std::vector<SpectrumPlan> plans_;
  std::vector<std::size_t> plan_of_side_;
  std::shared_ptr<const PixelChoice> choice_;
};

}  // namespace tempera
