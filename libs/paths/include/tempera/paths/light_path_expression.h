// SPDX-License-Identifier: Apache-2.0
#pragma once
// Light-path expressions: regular expressions over the events of a path from the eye (E) over diffuse (D), reflective
// (R) and transmissive (T) scattering to a light (L), compiled together into one automaton: one number of state per
// path, O(1) per vertex [Zimmer 2015, Sec. 3].
//
//   alt := cat ('|' cat)*     cat := rep+     rep := atom ('*' | '+' | '?' | '{n}' | '{m,n}' | '{m,}')*
//   atom := letter | '.' | '[' letter+ ']' | '[^' letter+ ']' | '(' alt ')'
//   letter := E D R T V P L (C is E)    '.' is any of D R T V    [^...] is any of D R T V but those
//
// Every path starts with E, and only there is an E; L stands at the end, where it is implied if it is not written. V is
// scattering in a medium. P is a T that goes straight on, through a thin sheet. Spaces between tokens are ignored.
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/shading/bsdf.h"

namespace tempera {

/// The joint automaton of a set of expressions. A value; const use is re-entrant.
class LightPathClassifier {
 public:
  static constexpr std::size_t kMaxExpressions = 32;
  /// `loc` is where each expression begins, and errors point at the offending character after it.
  /// Errors: Error{kSyntax} with what is expected; Error{kOutOfRange} for too many states, repetitions, nested groups,
  /// characters or expressions: no set, however hostile, takes more than a fraction of a second.
  explicit LightPathClassifier(const std::vector<std::string>& expressions = {}, const SourceLoc& loc = {});

  using State = std::uint16_t;
  /// State after E.
  State start() const { return start_; }
  State next(State s, Event e) const { return table_[s].next[std::size_t(e)]; }
  /// State after scattering in a medium (V).
  State next_medium(State s) const { return table_[s].next[kEventCount]; }
  /// State after a transmission that goes straight on through a thin sheet (P).
  State next_passage(State s) const { return table_[s].next[kEventCount + 1]; }
  /// Bit i is set if a path that ends at a light in state s belongs to expression i.
  std::uint32_t classes(State s) const { return table_[s].accept; }
  /// Whether any continuation from s can still belong to a class.
  bool alive(State s) const { return table_[s].alive; }
  std::size_t expression_count() const { return count_; }
  std::size_t state_count() const { return table_.size(); }

  /// Empty if no path belongs to two expressions; else a shortest such path, e.g. "EDL", with the two indices.
  struct Overlap {
    std::string witness;
    int first = 0, second = 0;
  };
  std::optional<Overlap> overlap() const;

 private:
  struct Row {
    std::array<State, kEventCount + 2> next{};  ///< D, R, T, V, P
    std::uint32_t accept = 0;
    bool alive = false;
  };
  std::vector<Row> table_;
  State start_ = 0;
  std::size_t count_ = 0;
};

}  // namespace tempera
