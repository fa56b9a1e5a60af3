// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdlib>

namespace tempera::test {

/// How many times more samples statistical tests take than in the fast suite: the environment variable
/// TEMPERA_TEST_EFFORT, 1 unless set. The slow suite sets it: n times the samples show a bias sqrt(n) times smaller.
inline int effort() {
  static const int value = [] {
    const char* text = std::getenv("TEMPERA_TEST_EFFORT");
    return text ? std::clamp(std::atoi(text), 1, 1000) : 1;
  }();
  return value;
}

}  // namespace tempera::test
