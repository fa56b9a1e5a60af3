// SPDX-License-Identifier: Apache-2.0
#pragma once
// How the metrics of the catalog are measured; private to the module.
#include <span>

#include "tempera/measure/compare.h"

namespace tempera {

/// A test in one frame.
struct TestFrame {
  const Image* image = nullptr;
  const Image* before = nullptr;  ///< in the frame before; null if that was not compared
  const Image* motion = nullptr;  ///< its own motion.backward; null if nobody needs it
};

/// All tests of one frame, measured together so that what they share is computed once.
struct FrameBatch {
  const Image& reference;  ///< the mean of both, if there are two
  /// Both of them, null if there is one: what displays them takes the mean of what is displayed.
  const Image *first = nullptr, *second = nullptr;
  const Image* reference_before = nullptr;
  const Image* motion = nullptr;    ///< motion.backward of the reference
  const Image* previous = nullptr;  ///< previous_positions of it
  std::span<const TestFrame> tests;
  const CompareOptions& options;
};

/// A value of a test, and its map if one is wanted.
struct Measurement {
  PixelMean mean;
  Image* map = nullptr;  ///< stays empty where the metric has no value
};

/// What mean squares become when they have been averaged.
enum class MetricScale {
  kPlain,          ///< nothing else
  kDecibels,       ///< decibels below a peak of 1
  kDisplayLevels,  ///< their root, in units of 1/255
};

struct MetricEntry {
  MetricInfo info;
  /// The value of one test, which has a frame before where the metric is one of pairs. `map`: see Measurement.
  PixelMean (*of_test)(const FrameBatch& batch, const TestFrame& test, Image* map) = nullptr;
  /// In its place where tests share work: fills a measurement for each.
  void (*of_batch)(const FrameBatch& batch, std::span<Measurement> out) = nullptr;
  MetricScale scale = MetricScale::kPlain;

  /// Whether frames are measured one by one; not so for metrics of whole sequences and of groups of runs.
  bool measures_frames() const { return of_test || of_batch; }
  /// A measurement for each of the batch's tests; one without a value stays as it is. Pre: measures_frames().
  void measure(const FrameBatch& batch, std::span<Measurement> out) const;
};

std::span<const MetricEntry> metric_entries();

}  // namespace tempera
