// SPDX-License-Identifier: Apache-2.0
#pragma once
// FLIP of several tests against one reference, which is filtered once; private to the module.
#include <span>
#include <vector>

#include "tempera/measure/metrics.h"

namespace tempera {

/// A test, and its map [h,w,1] if one is wanted.
struct FlipTest {
  const Image* image = nullptr;
  Image* map = nullptr;
};

/// As flip, with pictures multiplied by `scale` first. Shapes: a result for each test.
std::vector<double> flip(std::span<const FlipTest> tests, const Image& reference, float scale, float pixels_per_degree);

/// As hdr_flip. Shapes: a result for each test.
std::vector<double> hdr_flip(std::span<const FlipTest> tests, const Image& reference, float pixels_per_degree);

}  // namespace tempera
