// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cmath>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera {

struct QuadratureNode {
  float x, weight;
};

/// Gauss-Legendre rule with n nodes on [0,1]; exact for polynomials of degree 2n - 1.
inline std::vector<QuadratureNode> gauss_legendre(int n) {
  std::vector<QuadratureNode> nodes(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) {
    double x = std::cos(kPiD * (i + 0.75) / (n + 0.5)), derivative = 1;  // Newton from an asymptotic first guess
    for (int step = 0; step < 10; ++step) {
      double p0 = 1, p1 = x;  // Legendre polynomials by their recurrence
      for (int k = 2; k <= n; ++k) {
        const double p2 = ((2 * k - 1) * x * p1 - (k - 1) * p0) / k;
        p0 = p1, p1 = p2;
      }
      derivative = n * (x * p1 - p0) / (x * x - 1);
      x -= p1 / derivative;
    }
    nodes[i] = {float(0.5 - 0.5 * x), float(1 / ((1 - x * x) * derivative * derivative))};
  }
  return nodes;
}

}  // namespace tempera
