// SPDX-License-Identifier: Apache-2.0
#pragma once
// The events of a path as weighted states of a LightPathClassifier. Where a surface scatters by several events at once (a
// coat over a diffuse base), each of them carries a share of the light, and the path is in several states from there
// on; nothing is chosen, so the light of a path does not depend on the classes that are asked for, and its classes add
// up to it.
#include <algorithm>
#include <array>
#include <bit>
#include <span>

#include "tempera/core/fixed_stack.h"
#include "tempera/core/random.h"
#include "tempera/paths/light_path_expression.h"

namespace tempera {

/// States of one path with the shares of its throughput that they carry, for each channel of color. The shares and
/// rest() add up to one. A value; an unused one costs nothing to make.
class WeightedStates {
 public:
  static constexpr int kMaxStates = 8;
  struct Share {
    LightPathClassifier::State state;
    Rgb part;  ///< of the throughput
  };

  WeightedStates() {}  // NOLINT: with "= default", WeightedStates{} would zero the storage
  /// The path so far is E. `random` decides what is left where more than kMaxStates meet.
  void start(const LightPathClassifier& classifier, std::uint32_t random) {
    shares_.clear();
    shares_.push({classifier.start(), Rgb(1.0f)});
    random_ = random;
    rest_ = Rgb(0.0f);
  }
  std::span<const Share> shares() const { return {shares_.begin(), shares_.end()}; }
  /// What the shares lack to one, 0 until states had to be merged: then a random number kept one of two states for the
  /// light of both, which is right in the mean.
  const Rgb& rest() const { return rest_; }

  /// The path scatters; `f` by event, not black in all of them. `straight`: it goes straight on through a thin sheet.
  void scatter(const LightPathClassifier& classifier, const std::array<Rgb, kEventCount>& f, bool straight = false) {
    const std::array<Rgb, kEventCount> parts = event_parts(f);
    const auto before = shares_;
    shares_.clear();
    for (const Share& s : before) {
      for (int e = 0; e < kEventCount; ++e) {
        if (is_black(f[e])) continue;
        add({straight ? classifier.next_passage(s.state) : classifier.next(s.state, Event(e)), s.part * parts[e]});
      }
    }
  }

  /// Adds radiance `c` that arrives along the path to the sums of its classes, the last of which is for paths of none of
  /// the others. Paths of a class in `without` are left out. Returns what was added, whatever class it is of.
  Rgb add_to(const LightPathClassifier& classifier, const Rgb& c, std::span<Rgb> classes,
             std::uint32_t without = 0) const {
    Rgb sum = c * rest_;
    for (const Share& s : shares()) add_light(classifier, s.state, c * s.part, classes, without, sum);
    if (!classes.empty()) classes.back() += c * rest_;
    return sum;
  }
  /// The same for light that the path's last vertex scatters towards the eye: `c` over all events, `f` by event.
  Rgb add_to(const LightPathClassifier& classifier, const Rgb& c, const std::array<Rgb, kEventCount>& f,
             std::span<Rgb> classes, std::uint32_t without = 0) const {
    const std::array<Rgb, kEventCount> parts = event_parts(f);
    Rgb sum = c * rest_;
    for (int e = 0; e < kEventCount; ++e) {
      if (is_black(f[e])) continue;
      for (const Share& s : shares())
        add_light(classifier, classifier.next(s.state, Event(e)), c * s.part * parts[e], classes, without, sum);
    }
    if (!classes.empty()) classes.back() += c * rest_;
    return sum;
  }
  /// The same for light that the path's last vertex scatters by D, of a path whose part towards the light leads from
  /// state s to `end(s)`, which is in a class of `own`.
  template <class End>
  void add_joined(const LightPathClassifier& classifier, const Rgb& c, std::uint32_t own, std::span<Rgb> classes,
                  End&& end) const {
    if (classes.empty()) return;
    for (const Share& s : shares()) {
      std::uint32_t members = classifier.classes(end(classifier.next(s.state, Event::kDiffuse))) & ~own;
      if (members == 0) classes.back() += c * s.part;
      for (; members; members &= members - 1) classes[std::countr_zero(members)] += c * s.part;
    }
    classes.back() += c * rest_;
  }

 private:
  /// Share of each event in the sum. A channel that is black in all of them carries nothing; its share goes to the first
  /// event that is not black, so that shares add up to one in every channel.
  static std::array<Rgb, kEventCount> event_parts(const std::array<Rgb, kEventCount>& f) {
    std::array<Rgb, kEventCount> parts{};
    for (int c = 0; c < 3; ++c) {
      const float sum = f[0][c] + f[1][c] + f[2][c];
      if (sum > 0) {
        for (int e = 0; e < kEventCount; ++e) parts[e][c] = f[e][c] / sum;
      } else {
        const auto first = std::find_if(f.begin(), f.end(), [](const Rgb& v) { return !is_black(v); });
        if (first != f.end()) parts[first - f.begin()][c] = 1;
      }
    }
    return parts;
  }
  static void add_light(const LightPathClassifier& classifier, LightPathClassifier::State state, const Rgb& c,
                        std::span<Rgb> classes, std::uint32_t without, Rgb& sum) {
    std::uint32_t members = classifier.classes(state);
    if (members & without) return;
    sum += c;
    if (classes.empty()) return;
    members &= std::uint32_t((std::uint64_t(1) << (classes.size() - 1)) - 1);  // the classifier may know more
    if (members == 0) classes.back() += c;
    for (; members; members &= members - 1) classes[std::countr_zero(members)] += c;
  }
  void add(const Share& share) {
    for (int i = 0; i < shares_.size(); ++i) {
      if (shares_[i].state != share.state) continue;
      shares_[i].part += share.part;
      return;
    }
    if (shares_.size() < kMaxStates) {
      shares_.push(share);
    } else {
      merge(share);
    }
  }
  /// One of the new share and the least of the others goes on for both.
  void merge(const Share& share) {
    int i = 0;
    for (int k = 1; k < kMaxStates; ++k) {
      if (luminance(shares_[k].part) < luminance(shares_[i].part)) i = k;
    }
    Share& least = shares_[i];
    const float a = luminance(least.part), b = luminance(share.part);
    if (!(a + b > 0)) return;
    const Rgb before = least.part + share.part;
    random_ = std::uint32_t(mix64(random_ + 0x9e3779b97f4a7c15ull));
    const float p = a / (a + b);
    if (to_unit_float(random_) < p) {
      least.part *= 1 / p;
    } else {
      least = {share.state, share.part * (1 / (1 - p))};
    }
    rest_ += before - least.part;
  }

  std::uint32_t random_ = 0;
  Rgb rest_;
  FixedStack<Share, kMaxStates> shares_;
};

}  // namespace tempera
