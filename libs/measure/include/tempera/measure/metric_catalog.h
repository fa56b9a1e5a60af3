// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a comparison can measure, as a table: command line, reports, documents and tests read names, units and
// directions from here and from nowhere else. The measurements of single pictures are in metrics.h, those of sequences
// in compare.h.
#include <span>
#include <string_view>

namespace tempera {

/// What one value of a metric belongs to.
enum class MetricScope {
  kFrame,     ///< a frame
  kPair,      ///< a frame and the one before it; the first frame has no value
  kSequence,  ///< all frames together: there is no value per frame
};

/// Which of two values is better.
enum class MetricBetter { kLower, kHigher, kNearZero };
/// "lower", "higher" or "near zero".
const char* to_text(MetricBetter better);

/// What a metric needs beside the test and its reference. Without it the metric has no value.
enum class MetricNeeds {
  kNothing,
  kMotion,      ///< motion.backward in the files of the reference
  kMotionBoth,  ///< motion.backward in the files of the test and of the reference
  kTracks,      ///< motion.forward in the files of the reference
  kSeeds,       ///< several runs of the same method with different seeds
  kStillScene,  ///< meaningful only if nothing moves: chosen by default for a reference of one picture
};

struct MetricInfo {
  std::string_view id;       ///< as typed and written to files: "relmse"; letters, digits and '_'
  std::string_view title;    ///< for people: "relMSE"
  std::string_view unit;     ///< "" for plain numbers
  std::string_view help;     ///< what it says, in a line
  std::string_view formula;  ///< in a line of plain text; T test, R reference, p pixel, c channel, t frame
  std::string_view source;   ///< citation with a key of docs/references.bib, "[Wang 2004]"; "" for a definition of ours
  MetricScope scope = MetricScope::kFrame;
  MetricBetter better = MetricBetter::kLower;
  MetricNeeds needs = MetricNeeds::kNothing;
  bool has_map = false;  ///< whether there is a value per pixel
  bool trims = false;    ///< whether the largest values can be left out (CompareOptions::trim)
  /// Whether it follows from the mean square of a difference from the reference, to which the reference's own noise
  /// adds; a second reference takes that out (CompareOptions::reference2).
  bool squared = false;
  bool is_default = false;  ///< whether it is measured unless others are asked for
};

/// All metrics, in the order in which tables show them.
std::span<const MetricInfo> metric_catalog();

/// Null if there is none of that name.
const MetricInfo* find_metric(std::string_view id);

/// As find_metric. Errors: Error{kUnknownName} naming those that are similar.
const MetricInfo& get_metric(std::string_view id);

/// Whether `value` of the metric is worse than `limit`; a value that is not a number is.
bool is_worse(const MetricInfo& metric, double value, double limit);

}  // namespace tempera
