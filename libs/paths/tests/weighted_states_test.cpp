// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/weighted_states.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tempera {
namespace {

using Events = std::array<Rgb, kEventCount>;

/// A path that scatters by all three events at each vertex, and what belongs to each class if every sequence of events
/// is followed by itself.
void follow(const LightPathClassifier& classifier, LightPathClassifier::State state, const std::vector<Events>& path,
            std::size_t vertex, const Rgb& part, std::vector<Rgb>& classes) {
  if (vertex == path.size()) {
    std::uint32_t members = classifier.classes(state);
    if (members == 0) classes.back() += part;
    for (; members; members &= members - 1) classes[std::countr_zero(members)] += part;
    return;
  }
  const Events& f = path[vertex];
  const Rgb sum = f[0] + f[1] + f[2];
  for (int e = 0; e < kEventCount; ++e) {
    const Rgb share{sum.r > 0 ? f[e].r / sum.r : 0, sum.g > 0 ? f[e].g / sum.g : 0, sum.b > 0 ? f[e].b / sum.b : 0};
    if (!is_black(share)) follow(classifier, classifier.next(state, Event(e)), path, vertex + 1, part * share, classes);
  }
}

std::vector<Events> some_path(int vertices, std::uint64_t seed) {
  std::vector<Events> path(vertices);
  std::uint32_t i = 0;
  for (Events& f : path) {
    for (Rgb& value : f) {
      for (int c = 0; c < 3; ++c) value[c] = to_unit_float(std::uint32_t(hash_key(seed, ++i)));
      if (to_unit_float(std::uint32_t(hash_key(seed, ++i))) < 0.2f) value = Rgb(0.0f);
    }
    if (is_black(f[0] + f[1] + f[2])) f[0] = Rgb{0.5f, 0, 0};
  }
  return path;
}

Rgb sum_of(const std::vector<Rgb>& classes) {
  Rgb sum;
  for (const Rgb& c : classes) sum += c;
  return sum;
}

// While a path is in few states nothing is random: every sequence of events has its share.
TEST(WeightedStates, AreTheSharesOfAllSequencesOfEvents) {
  const LightPathClassifier classifier({"ED", "ED.+", "ERD.*", "ETTD.*", "E.*T.*"});
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const std::vector<Events> path = some_path(6, seed);
    WeightedStates states;
    states.start(classifier, 0);
    for (std::size_t vertices = 0; vertices <= path.size(); ++vertices) {
      std::vector<Rgb> expected(6), classes(6);
      follow(classifier, classifier.start(), {path.begin(), path.begin() + std::ptrdiff_t(vertices)}, 0, Rgb(2.0f),
             expected);
      // Channels that a vertex has ended carry no light, whatever their shares.
      Rgb lit(1.0f);
      for (std::size_t v = 0; v < vertices; ++v) lit *= path[v][0] + path[v][1] + path[v][2];
      const auto check = [&] {
        for (std::size_t k = 0; k < classes.size(); ++k) {
          for (int c = 0; c < 3; ++c) {
            if (lit[c] > 0) {
              EXPECT_NEAR(classes[k][c], expected[k][c], 2e-6f) << seed;
            }
          }
        }
      };
      if (vertices > 0) {  // as next-event estimation at the last vertex sees it
        const Events& f = path[vertices - 1];
        states.add_to(classifier, Rgb(2.0f), f, classes);
        check();
        states.scatter(classifier, f);
        std::fill(classes.begin(), classes.end(), Rgb(0.0f));
      }
      states.add_to(classifier, Rgb(2.0f), classes);
      ASSERT_TRUE(is_black(states.rest()));
      check();
    }
  }
}

// Classes by the number of mirrors: more states than a path can be in at once. Shares still add up to one, and each
// class is right in the mean (|z| < 4.5 for 33 channels of classes: one false alarm in 4000 if nothing is wrong).
TEST(WeightedStates, AreMergedWithoutBias) {
  std::vector<std::string> expressions;
  for (int k = 0; k < 10; ++k) expressions.push_back("E([DT]*R){" + std::to_string(k) + "}[DT]*");
  const LightPathClassifier classifier(expressions);
  const std::vector<Events> path = some_path(13, 7);
  std::vector<Rgb> expected(11);
  std::vector<std::array<double, 3>> sum(11), squares(11);
  follow(classifier, classifier.start(), path, 0, Rgb(1.0f), expected);
  const int runs = 40000;
  int merged = 0;
  for (int run = 0; run < runs; ++run) {
    std::vector<Rgb> classes(11);
    WeightedStates states;
    states.start(classifier, std::uint32_t(mix64(std::uint64_t(run))));
    for (const Events& f : path) states.scatter(classifier, f);
    states.add_to(classifier, Rgb(1.0f), classes);
    merged += !is_black(states.rest());
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum_of(classes)[c], 1, 1e-5f);
    for (std::size_t k = 0; k < classes.size(); ++k) {
      for (int c = 0; c < 3; ++c) sum[k][c] += double(classes[k][c]), squares[k][c] += sqr(double(classes[k][c]));
    }
  }
  EXPECT_GT(merged, runs / 2) << "the test is about merging";
  for (std::size_t k = 0; k < sum.size(); ++k) {
    for (int c = 0; c < 3; ++c) {
      const double mean = sum[k][c] / runs;
      const double variance = std::max(0.0, squares[k][c] / runs - mean * mean) / runs;
      const double difference = mean - double(expected[k][c]);
      EXPECT_LT(std::abs(difference), 4.5 * std::sqrt(variance) + 1e-4 * double(expected[k][c]) + 1e-6)
          << k << " " << c;
    }
  }
}

}  // namespace
}  // namespace tempera
