// SPDX-License-Identifier: Apache-2.0
#pragma once
// How the metrics of the catalog are measured; private to the module.
#include <span>

#include "tempera/stages/compare.h"

namespace tempera {

/// A test and its reference in one frame.
struct Pair {
  const Image& test;
  const Image& reference;
  const CompareOptions& options;
};

struct Measured {
  double value = kUndefined;
  double coverage = 1;  ///< part of the pixels that counted
};

struct MetricEntry {
  MetricInfo info;
  /// Of one frame; `map`, if given, receives the value of each pixel. Null for metrics of sequences.
  Measured (*measure)(const Pair& pair, Image* map) = nullptr;
};

std::span<const MetricEntry> metric_entries();

}  // namespace tempera
