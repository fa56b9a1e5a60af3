// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/cosine_transform.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tempera/core/random.h"
#include "tempera/core/vec.h"

namespace tempera {
namespace {

constexpr int kLanes = CosineTransform::kLanes;

std::vector<float> random_lanes(int n) {
  std::vector<float> v(std::size_t(n) * kLanes);
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = float(double(hash_key(std::uint64_t(n), i) >> 11) * 0x1p-52 - 1);
  return v;
}

// Every radix, mixtures, primes with code of their own, without, and those that need Bluestein's algorithm.
const int kLengths[] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 13, 15, 16, 20, 25, 30, 31, 36, 37, 49, 61, 74, 120, 127};

TEST(CosineTransform, AgreesWithItsDefinition) {
  for (const int n : kLengths) {
    const std::vector<float> in = random_lanes(n);
    std::vector<float> out = in;
    CosineTransform::Scratch scratch;
    CosineTransform(n).forward(out.data(), scratch);
    double worst = 0;
    for (int k = 0; k < n; ++k) {
      for (int l = 0; l < kLanes; ++l) {
        double sum = 0;
        for (int i = 0; i < n; ++i) {
          sum += double(in[i * kLanes + l]) * std::cos(kPiD * (2 * i + 1) * k / (2.0 * n));
        }
        sum *= std::sqrt((k == 0 ? 1.0 : 2.0) / n);
        worst = std::max(worst, std::abs(sum - double(out[k * kLanes + l])));
      }
    }
    EXPECT_LT(worst, 2e-6) << "length " << n;
  }
}

TEST(CosineTransform, InverseUndoesIt) {
  std::vector<int> lengths(std::begin(kLengths), std::end(kLengths));
  for (const int n : {720, 1280, 1366, 853, 1080, 2048}) lengths.push_back(n);
  for (const int n : lengths) {
    const std::vector<float> in = random_lanes(n);
    std::vector<float> out = in;
    const CosineTransform transform(n);
    CosineTransform::Scratch scratch;
    transform.forward(out.data(), scratch);
    transform.inverse(out.data(), scratch);
    double worst = 0;
    for (std::size_t i = 0; i < in.size(); ++i) worst = std::max(worst, std::abs(double(in[i]) - double(out[i])));
    EXPECT_LT(worst, 4e-6) << "length " << n;
  }
}

}  // namespace
}  // namespace tempera
