// SPDX-License-Identifier: Apache-2.0
#pragma once
// How the metrics of the catalog are measured; private to the module.
#include <span>

#include "tempera/stages/compare.h"

namespace tempera {

/// A test in one frame.
struct TestFrame {
  const Image* image = nullptr;
  const Image* before = nullptr;  ///< in the frame before; null if that was not compared
  const Image* motion = nullptr;  ///< its own motion.backward; null if nobody needs it
};

/// All tests of one frame, measured together so that what they share is computed once.
struct FrameBatch {
  const Image& reference;
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

struct MetricEntry {
  MetricInfo info;
  /// Fills a measurement for each test. Null for metrics of whole sequences and of groups of runs.
  void (*measure)(const FrameBatch& batch, std::span<Measurement> out) = nullptr;
  /// Whether values are mean squares that become decibels when they have been averaged.
  bool decibels = false;
};

std::span<const MetricEntry> metric_entries();

}  // namespace tempera
