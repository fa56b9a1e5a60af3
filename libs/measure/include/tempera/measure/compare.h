// SPDX-License-Identifier: Apache-2.0
#pragma once
// Frame sequences against a reference: the metrics of each frame, their means over the sequence with standard errors,
// and what only a sequence has (flicker, spectra), as a table, JSON or CSV.
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/frames/image.h"
#include "tempera/frames/sequence.h"
#include "tempera/measure/metric_catalog.h"
#include "tempera/measure/metrics.h"
#include "tempera/measure/statistics.h"

namespace tempera {

inline constexpr double kUndefined = std::numeric_limits<double>::quiet_NaN();

/// One method: a sequence, or several runs of it that differ in their seed alone.
struct CompareInput {
  std::string name;                 ///< for tables and reports
  std::vector<FrameSequence> runs;  ///< at least one
};

/// "[NAME=]PATTERN": a picture, folder or sequence. A '*' in a folder or file name stands for any text, and makes a
/// group of all sequences that match, in the order of their names: runs with different seeds, "out/s*/f.####.exr". The
/// name is the pattern if none is given. Errors: Error{kMissingFile} if nothing matches; those of FrameSequence.
CompareInput parse_compare_input(const std::string& text);

/// The parts of `names` between the folders that all of them begin and end with: "path" and "mlt" of "out/path/f.exr"
/// and "out/mlt/f.exr".
std::vector<std::string> distinguishing_labels(const std::vector<std::string>& names);

/// The pixels whose first channel of a layer has this value.
struct Region {
  std::string layer;
  float value = 0;
};

struct CompareOptions {
  std::vector<std::string> metrics;  ///< ids; "default" or "all": those that the files allow; empty: default
  std::string layer = "color";
  std::vector<int> frames;  ///< which to compare; empty: all that both sides have
  double epsilon = 1e-2;    ///< of relmse and of the temporal errors
  float exposure = 0;       ///< stops, for metrics of displayed pictures, which are clipped at 1 after this exposure
  float pixels_per_degree = kPixelsPerDegree;  ///< of FLIP
  double trim = 0;  ///< part of the pixels, those with the largest errors, that squared errors leave out: in [0, 0.5]
  double cutoff = 0.25;  ///< cycles per frame above which residuals count as flicker: in (0, 0.5)
  std::string motion;    ///< files with motion.backward (and motion.forward) of the reference; empty: its own
  /// Pattern of a second reference whose noise is independent of that of the first (another seed); empty: there is
  /// none. The mean of both is the reference then, and squared metrics (MetricInfo::squared) are without its noise:
  /// ((T - R1)^2 + (T - R2)^2 - (R1 - R2)^2) / 2 = (T - R)^2 - (R1 - R)^2, so that they estimate the error to the truth
  /// and may be below 0 where that is small. Metrics of displayed pictures take the mean of what is displayed.
  std::string reference2;
  /// Part of the picture that is compared, by a layer in the (first) reference's files; none: all of it. Only means of
  /// pixels' errors (MetricInfo::trims) can be measured of it; errors along motion where both ends are in it. A frame
  /// without such pixels has no value.
  std::optional<Region> where;
  std::int64_t spectrum_memory = std::int64_t(1) << 30;  ///< bytes at most; beyond that fewer pixels are looked at
};

/// One metric of one side.
struct MetricSeries {
  const MetricInfo* metric = nullptr;
  /// Of each of CompareSide::frames; kUndefined where there is none (the first frame of a pair). The mean over runs.
  /// Empty for metrics of whole sequences.
  std::vector<double> values;
  /// Part of the pixels that counted in each frame, in [0,1]; empty if the metric looks at all of them.
  std::vector<double> coverage;
  /// Of the sequence: for metrics of frames the mean over those that have a value, except for psnr, which is that of
  /// the mean squared error (and flicker_display, the root of the mean over runs). Its standard error is that over the
  /// runs if there are several, otherwise over the frames as if they were independent; `count` is how many of them it
  /// stands on.
  MeanError mean;
};

/// The power of the residual (luminance of test minus reference) over temporal frequency, averaged over pixels, without
/// the noise of two references. Welch's method with a Hann window: the powers add up to the mean of the squared
/// residual, weighted by the window.
struct ResidualSpectrum {
  /// Of the metric that is its part above the cutoff, "flicker" or "flicker_tracked", or the root of that,
  /// "flicker_display".
  std::string id;
  std::vector<double> frequency;  ///< cycles per frame, from 0 to at most 0.5
  std::vector<double> power;      ///< squared luminance, for flicker_display in units of (1/255)^2, of each frequency
  int segment_frames = 0;         ///< length of a segment
  int segments = 0;               ///< how many, overlapping by half
  double coverage = 1;            ///< part of the pixels that was looked at
};

/// One method that is compared with the reference.
struct CompareSide {
  std::string name;
  std::string label;                      ///< a short name: the part of the pattern in which the sides differ
  std::vector<std::string> runs;          ///< the pattern of each run
  std::vector<int> frames;                ///< that were compared, ascending
  std::vector<int> unmatched;             ///< that the side has and the reference lacks
  std::vector<int> missing;               ///< that the reference has and the side lacks, between its first and last one
  std::vector<std::int64_t> non_finite;   ///< pixels of each frame that are not finite, over all runs
  std::vector<MetricSeries> series;       ///< in the order of CompareResult::metrics
  std::vector<ResidualSpectrum> spectra;  ///< of the flicker metrics among them

  /// Null if the metric was not measured.
  const MetricSeries* find(std::string_view id) const;
};

struct CompareResult {
  std::string reference;
  CompareOptions options;  ///< that it was made with
  int width = 0, height = 0;
  double fps = 0;  ///< as the reference's files say; 0 if they do not
  /// relmse of the reference itself, from two references or from color.a and color.b in its files; else undefined.
  MeanError reference_error;
  std::vector<const MetricInfo*> metrics;  ///< that were measured, in the order of the catalog
  /// With two references, of each metric: what their noise amounts to and was taken out; undefined for metrics that are
  /// not squared. Empty with one.
  std::vector<double> reference_noise;
  std::vector<CompareSide> sides;
  std::vector<std::string> notes;  ///< what a reader of the figures should know, a sentence each
};

/// Watches a comparison while pictures are in memory, so that a report reads no file again. Called from one thread.
class CompareObserver {
 public:
  virtual ~CompareObserver() = default;
  /// Ids of the metrics (with has_map) whose maps `test` wants.
  virtual std::vector<std::string> maps() const { return {}; }
  /// Whether `reference` wants motion vectors.
  virtual bool motion() const { return false; }
  /// Once for each frame, ascending, before its tests. `motion_backward` and `motion_forward` [h,w,>=2] are null if the
  /// files have none. A reference of one picture is shown for each frame.
  virtual void reference(int frame, const Image& image, const Image* motion_backward, const Image* motion_forward);
  /// The first run of a side. `map(id)` [h,w,1] is one of `maps()`; null where it has no value (the first of pairs).
  virtual void test(std::size_t side, int frame, const Image& image,
                    const std::function<const Image*(std::string_view id)>& map);
};

/// Called after each frame of the work. Throw Error{kCancelled} from it to stop.
using CompareProgress = std::function<void(int done, int total)>;

/// Compares each of `tests` with `reference` frame by frame. A reference of a single frame stands for every frame of
/// the tests (a converged picture of a still scene).
/// Result:  the same bits on any number of threads. Each file is read once.
/// Memory:  independent of the number of frames: a few layers for each run, and `spectrum_memory`.
/// Errors:  Error{kBadInput} if a test has no frame in common with the reference, the second reference lacks one of
///          these or is the first, the sizes of a pair differ (naming both files), a metric that was asked for by
///          name lacks what it needs, or nothing is in the region; Error{kUnknownName} for unknown metrics; Error{kOutOfRange} for options; those of
///          read_frame.
CompareResult compare_sequences(const std::vector<CompareInput>& tests, const FrameSequence& reference,
                                const CompareOptions& options = {}, const CompareProgress& progress = {},
                                CompareObserver* observer = nullptr);

/// {"reference", "reference2", "layer", "width", "height", "fps", "reference_error": {"relmse", "confidence_95"},
/// "reference_noise": {id: ...}, "settings": {...}, "notes": [...], "metrics": [{"id", "title", "unit", "scope",
/// "better", "formula", "source", "trim", "noise_removed"}], "sides":
/// [{"name", "label", "runs", "frames": [...], "mean": {id: ...}, "standard_error": {...}, "confidence_95": {...},
/// "values": {id: [one of each frame]}, "coverage", "spectra", "non_finite", "unmatched", "missing"}]}. What has no
/// value, or an infinite one, is null.
std::string to_json(const CompareResult& result);
/// A line "name,frame,<id of each metric>,non_finite" for each frame (a trimmed metric is "relmse[without 0.1%]"), and
/// lines with frame "mean" and "standard_error" for each side; what has no value is empty. With two references a line
/// "reference,noise" says what was taken out.
std::string to_csv(const CompareResult& result);
/// The means as a table for people: a metric a line, with their 95 % confidence and the ratio to the first side.
std::string to_table(const CompareResult& result);

}  // namespace tempera
