// SPDX-License-Identifier: Apache-2.0
#pragma once
// Means and how far to trust them.
#include <limits>
#include <span>

namespace tempera {

/// The mean of independent values and its standard error.
struct MeanError {
  double mean = std::numeric_limits<double>::quiet_NaN();
  double standard_error = std::numeric_limits<double>::quiet_NaN();  ///< NaN with less than two values
  int count = 0;                                                     ///< of the values that are not NaN
  /// Half of the width of the interval around `mean` that holds the true one with 95 % probability, for normally
  /// distributed values (Student's t); NaN without a standard error.
  double confidence_95() const;
};

/// NaN among the values is left out.
MeanError mean_error(std::span<const double> values);

/// The t for which |T| <= t with 95 % probability, T of Student's distribution. Pre: degrees_of_freedom >= 1.
double student_t_95(int degrees_of_freedom);

}  // namespace tempera
