// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_path_expression.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <map>
#include <string_view>

namespace tempera {
namespace {

// Limits that no useful expression comes near; they keep hostile ones from taking memory, time or stack.
constexpr std::size_t kMaxLength = 4096;  // characters of an expression: what {0} discards costs time, too
constexpr int kMaxNesting = 64;
constexpr int kMaxRepetitions = 255;
constexpr std::size_t kMaxNfaStates = 8192;
constexpr std::size_t kMaxDfaStates = 4096;
constexpr std::size_t kMaxSteps = std::size_t(1) << 23;  // of the subset construction, together well below a second

// Letters as bits, in the order of the automaton's columns: the events of the table, then E and L, which only begin and
// end a path.
constexpr std::string_view kLetters = "DRTVPEL";
constexpr int kColumns = kEventCount + 2;
constexpr std::uint8_t kAnyEvent = (1u << kColumns) - 1;
constexpr std::uint8_t kTransmission = 1u << 2, kPassage = 1u << 4, kEye = 1u << 5, kLight = 1u << 6;

/// A state of Thompson's construction: one transition on a set of letters, or up to two empty ones.
struct NfaState {
  std::uint8_t letters = 0;
  int next = -1;  ///< after one of `letters`
  std::array<int, 2> empty{-1, -1};
  int column = 0;  ///< of the letters in the expression, from 0
};

/// A part of an automaton: the states [begin, end of the vector when it was built), entered at `start`.
struct Fragment {
  int begin = 0, start = 0, accept = 0;
};

/// Recursive descent over one expression that appends its states to a shared vector.
class Parser {
 public:
  Parser(std::string_view text, const SourceLoc& loc, std::vector<NfaState>& states)
      : text_(text), loc_(loc), states_(states) {}

  Fragment parse() {
    if (text_.size() > kMaxLength) {
      fail(ErrorCode::kOutOfRange, kMaxLength, fmt::format("an expression has at most {} characters", kMaxLength));
    }
    skip_spaces();
    if (at_ >= text_.size()) fail(ErrorCode::kSyntax, at_, "expected E");
    const Fragment f = alternatives();
    if (at_ < text_.size()) fail(ErrorCode::kSyntax, at_, "this ')' closes nothing");
    check_ends(f);
    return f;
  }

 private:
  [[noreturn]] void fail(ErrorCode code, std::size_t at, const std::string& what) const {
    SourceLoc loc = loc_;
    loc.column = std::max(loc.column, 1) + int(at);
    const bool shorten = text_.size() > 60;
    std::string shown;
    for (const char c : text_.substr(0, shorten ? 57 : text_.size())) shown += c >= ' ' && c < '\x7f' ? c : '?';
    throw Error(
        code, loc,
        fmt::format("light-path expression \"{}{}\", character {}: {}", shown, shorten ? "..." : "", at + 1, what));
  }
  /// "expected X, not Y" for the next character.
  std::string expected(std::string_view what) const {
    if (at_ >= text_.size()) return fmt::format("expected {} before the end", what);
    const char c = text_[at_];
    if (c < ' ' || c >= '\x7f') return fmt::format("expected {}, not the byte 0x{:02x}", what, std::uint8_t(c));
    return fmt::format("expected {}, not '{}'", what, c);
  }

  void skip_spaces() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t')) ++at_;
  }
  /// The next character that is not a space; 0 at the end.
  char peek() {
    skip_spaces();
    return at_ < text_.size() ? text_[at_] : '\0';
  }
  bool accept(char c) {
    if (at_ >= text_.size() || peek() != c) return false;
    ++at_;
    return true;
  }

  int add_state(NfaState s = {}) {
    if (states_.size() >= kMaxNfaStates) {
      fail(ErrorCode::kOutOfRange, std::min(at_, text_.size()),
           fmt::format("too many repetitions: a set of expressions may have {} states before it is reduced",
                       kMaxNfaStates));
    }
    states_.push_back(s);
    return int(states_.size()) - 1;
  }
  NfaState& state(int i) { return states_[i]; }
  void link(int from, int to) {
    auto& empty = state(from).empty;
    empty[empty[0] < 0 ? 0 : 1] = to;
  }

  Fragment alternatives() {
    Fragment f = concatenation();
    while (accept('|')) {
      const Fragment g = concatenation();
      const int start = add_state(), end = add_state();
      link(start, f.start), link(start, g.start);
      link(f.accept, end), link(g.accept, end);
      f = {f.begin, start, end};
    }
    return f;
  }

  Fragment concatenation() {
    Fragment f = repetition();
    for (char c = peek(); at_ < text_.size() && c != '|' && c != ')'; c = peek()) {
      const Fragment g = repetition();
      link(f.accept, g.start);
      f.accept = g.accept;
    }
    return f;
  }

  Fragment repetition() {
    Fragment f = atom();
    for (;;) {
      if (accept('*')) {
        f = repeat(f, 0, -1);
      } else if (accept('+')) {
        f = repeat(f, 1, -1);
      } else if (accept('?')) {
        f = repeat(f, 0, 1);
      } else if (accept('{')) {
        skip_spaces();
        const std::size_t at = at_;
        const int low = number();
        int high = low;
        if (accept(',')) high = peek() == '}' ? -1 : number();
        if (!accept('}')) fail(ErrorCode::kSyntax, at_, expected(high == low ? "',' or '}'" : "'}'"));
        if (high >= 0 && high < low) {
          fail(ErrorCode::kOutOfRange, at, fmt::format("the limits {},{} are in the wrong order", low, high));
        }
        f = repeat(f, low, high);
      } else {
        return f;
      }
    }
  }

  int number() {
    const auto digit = [&] { return at_ < text_.size() && text_[at_] >= '0' && text_[at_] <= '9'; };
    skip_spaces();
    const std::size_t at = at_;
    if (!digit()) fail(ErrorCode::kSyntax, at_, expected("a number"));
    int n = 0;
    for (; digit(); ++at_) n = std::min(10 * n + (text_[at_] - '0'), kMaxRepetitions + 1);
    if (n > kMaxRepetitions) {
      fail(ErrorCode::kOutOfRange, at, fmt::format("a repetition count is at most {}", kMaxRepetitions));
    }
    return n;
  }

  /// f{low,high}; high < 0: without limit. `f` must be the fragment that was built last.
  Fragment repeat(const Fragment& f, int low, int high) {
    if (high == 0) {  // what was repeated goes; an empty path stays
      states_.resize(std::size_t(f.begin));
      const int start = add_state(), end = add_state();
      link(start, end);
      return {f.begin, start, end};
    }
    const int pieces = high < 0 ? std::max(low, 1) : high;
    std::vector<NfaState> original;  // before anything is linked to it
    if (pieces > 1) original.assign(states_.begin() + f.begin, states_.end());

    Fragment chain = f;
    for (int i = 0; i < pieces; ++i) {
      Fragment piece = f;
      if (i > 0) {
        const int shift = int(states_.size()) - f.begin;
        for (NfaState s : original) {
          for (int* target : {&s.next, &s.empty[0], &s.empty[1]}) {
            if (*target >= 0) *target += shift;
          }
          add_state(s);
        }
        piece = {f.begin + shift, f.start + shift, f.accept + shift};
      }
      const bool may_skip = i >= low, may_repeat = high < 0 && i + 1 == pieces;
      if (may_skip || may_repeat) {
        const int start = add_state(), end = add_state();
        link(start, piece.start);
        if (may_skip) link(start, end);
        link(piece.accept, end);
        if (may_repeat) link(piece.accept, piece.start);
        piece.start = start, piece.accept = end;
      }
      if (i > 0) {
        link(chain.accept, piece.start);
        chain.accept = piece.accept;
      } else {
        chain = piece;
      }
    }
    return chain;
  }

  Fragment atom() {
    const char c = peek();
    const std::size_t at = at_;
    std::uint8_t letters = 0;
    if (at_ < text_.size() && c == '(') {
      if (++nesting_ > kMaxNesting) {
        fail(ErrorCode::kOutOfRange, at_, fmt::format("groups nest at most {} deep", kMaxNesting));
      }
      ++at_;
      const Fragment f = alternatives();
      if (!accept(')')) {
        skip_spaces();
        fail(ErrorCode::kSyntax, at_, expected("')'"));
      }
      --nesting_;
      return f;
    }
    if (accept('.')) {
      letters = kAnyEvent;
    } else if (accept('[')) {
      const bool complement = accept('^');
      do {
        letters |= letter("an event (one of D R T V E L)");
      } while (peek() != ']');
      ++at_;
      if (complement) letters = std::uint8_t(kAnyEvent & ~letters);
      if (!letters) fail(ErrorCode::kSyntax, at, "this class excludes every event");
    } else {
      letters = letter("an event (one of D R T V E L), '.', '[' or '('");
    }
    const int start = add_state({.letters = letters, .column = int(at)});
    const int end = add_state();
    state(start).next = end;
    return {start, start, end};
  }

  std::uint8_t letter(std::string_view what) {
    char c = peek();
    if (c == 'C') c = 'E';
    const std::size_t i = at_ < text_.size() ? kLetters.find(c) : std::string_view::npos;
    if (i == std::string_view::npos) fail(ErrorCode::kSyntax, at_, expected(what));
    ++at_;
    return std::uint8_t((1u << i) | (c == 'T' ? kPassage : 0u));
  }

  /// Which states can be reached from `from` by empty transitions, or also by letters.
  std::vector<bool> reachable(std::vector<int> from, bool by_letters) const {
    std::vector<bool> seen(states_.size());
    while (!from.empty()) {
      const int i = from.back();
      from.pop_back();
      if (i < 0 || seen[i]) continue;
      seen[i] = true;
      const NfaState& s = states_[i];
      from.insert(from.end(), s.empty.begin(), s.empty.end());
      if (by_letters) from.push_back(s.next);
    }
    return seen;
  }

  /// E begins every path and stands nowhere else; L can only end one.
  void check_ends(const Fragment& f) const {
    constexpr std::size_t kNone = std::string_view::npos;
    std::size_t column = kNone;
    const char* fault = nullptr;
    const auto note = [&](std::size_t at, const char* what) {
      if (at < column) column = at, fault = what;
    };
    std::vector<int> after_eye;
    const std::vector<bool> first = reachable({f.start}, false);
    if (first[f.accept]) note(0, "expected E at the beginning of every path, but this can be empty");
    for (std::size_t i = 0; i < states_.size(); ++i) {
      if (!first[i] || !states_[i].letters) continue;
      if (states_[i].letters != kEye) note(std::size_t(states_[i].column), "expected E: every path begins with it");
      after_eye.push_back(states_[i].next);
    }
    const std::vector<bool> inner = reachable(after_eye, true);
    for (std::size_t i = 0; i < states_.size(); ++i) {
      if (!inner[i]) continue;
      const NfaState& s = states_[i];
      if (s.letters & kEye) note(std::size_t(s.column), "E can only begin a path");
      if (!(s.letters & kLight)) continue;
      const std::vector<bool> after = reachable({s.next}, false);
      for (std::size_t j = 0; j < states_.size(); ++j) {
        if (after[j] && states_[j].letters)
          note(std::size_t(states_[j].column), "L ends a path: nothing can follow it");
      }
    }
    if (fault) fail(ErrorCode::kSyntax, column, fault);
  }

  std::string_view text_;
  const SourceLoc& loc_;
  std::vector<NfaState>& states_;
  std::size_t at_ = 0;
  int nesting_ = 0;
};

/// A set of states of the nondeterministic automaton.
using StateSet = std::vector<std::uint64_t>;

void insert(StateSet& set, int i) { set[std::size_t(i) / 64] |= std::uint64_t(1) << (i % 64); }
bool contains(const StateSet& set, int i) { return set[std::size_t(i) / 64] >> (i % 64) & 1; }
template <class F>
void for_each(const StateSet& set, F&& f) {
  for (std::size_t w = 0; w < set.size(); ++w) {
    for (std::uint64_t bits = set[w]; bits; bits &= bits - 1) f(int(w * 64) + std::countr_zero(bits));
  }
}
/// Adds all that empty transitions reach from `from`; returns how many steps that took.
std::size_t close(const std::vector<NfaState>& nfa, StateSet& set, std::vector<int>& from) {
  std::size_t steps = 0;
  for (; !from.empty(); ++steps) {
    const int i = from.back();
    from.pop_back();
    if (i < 0 || contains(set, i)) continue;
    insert(set, i);
    const auto& empty = nfa[i].empty;
    from.insert(from.end(), empty.begin(), empty.end());
  }
  return steps;
}

/// A complete deterministic automaton over D, R, T, V, P; state 0 stands after E.
struct Dfa {
  std::vector<std::array<int, kColumns>> next;
  std::vector<std::uint32_t> accept;
};

/// Subset construction over all expressions at once.
Dfa determinize(const std::vector<NfaState>& nfa, const std::vector<Fragment>& expressions, const SourceLoc& loc) {
  const StateSet none((nfa.size() + 63) / 64);
  // Classes of a path that ends here: L may be written or implied.
  std::vector<std::uint32_t> ends(nfa.size());
  for (std::size_t e = 0; e < expressions.size(); ++e) ends[expressions[e].accept] |= 1u << e;
  const std::vector<std::uint32_t> implied = ends;
  std::vector<int> open;
  for (std::size_t i = 0; i < nfa.size(); ++i) {
    if (!(nfa[i].letters & kLight)) continue;
    StateSet after = none;
    open.push_back(nfa[i].next);
    close(nfa, after, open);
    for_each(after, [&](int j) { ends[i] |= implied[j]; });
  }

  Dfa dfa;
  std::map<StateSet, int> numbers;
  std::vector<const StateSet*> sets;
  std::size_t steps = 0;
  const auto number = [&](StateSet&& set) {
    const auto [it, added] = numbers.try_emplace(std::move(set), int(sets.size()));
    if (added) {
      if (sets.size() >= kMaxDfaStates || steps > kMaxSteps) {
        throw Error(ErrorCode::kOutOfRange, loc,
                    "the light-path expressions are too complex together; use fewer or simpler repetitions");
      }
      sets.push_back(&it->first);
      std::uint32_t accept = 0;
      for_each(it->first, [&](int i) { accept |= ends[i]; });
      dfa.accept.push_back(accept);
      dfa.next.emplace_back();
    }
    return it->second;
  };
  const auto step = [&](const StateSet& set, std::uint8_t letter) {
    for_each(set, [&](int i) {
      if (nfa[i].letters & letter) open.push_back(nfa[i].next);
    });
    StateSet after = none;
    steps += set.size() + open.size() + close(nfa, after, open);
    return after;
  };
  StateSet origin = none;
  for (const Fragment& f : expressions) open.push_back(f.start);
  close(nfa, origin, open);
  number(step(origin, kEye));
  for (std::size_t s = 0; s < sets.size(); ++s) {
    for (int c = 0; c < kColumns; ++c) {
      const int target = number(step(*sets[s], std::uint8_t(1u << c)));
      dfa.next[s][c] = target;
    }
  }
  return dfa;
}

/// Hopcroft's partition of the states into blocks that no continuation tells apart. Returns the block of each state.
std::vector<int> equivalent_states(const Dfa& dfa) {
  const int n = int(dfa.next.size());
  // Predecessors of each state for each letter, as ranges of one array.
  std::array<std::vector<int>, kColumns> offset, source;
  for (std::size_t c = 0; c < kColumns; ++c) {
    offset[c].resize(std::size_t(n) + 1);
    source[c].resize(std::size_t(n));
    for (const auto& row : dfa.next) ++offset[c][std::size_t(row[c]) + 1];
    for (std::size_t i = 0; i < std::size_t(n); ++i) offset[c][i + 1] += offset[c][i];
    std::vector<int> fill(offset[c].begin(), offset[c].end() - 1);
    for (int s = 0; s < n; ++s) source[c][fill[dfa.next[s][c]]++] = s;
  }
  // Blocks are sets of states; at the start, one for each set of classes.
  std::vector<int> block_of(static_cast<std::size_t>(n));
  std::vector<std::vector<int>> blocks;
  std::map<std::uint32_t, int> by_accept;
  for (int s = 0; s < n; ++s) {
    const auto [it, added] = by_accept.try_emplace(dfa.accept[s], int(blocks.size()));
    if (added) blocks.emplace_back();
    block_of[s] = it->second;
    blocks[it->second].push_back(s);
  }
  struct Splitter {
    int block, column;
  };
  std::vector<Splitter> work;
  std::vector<std::array<bool, kColumns>> waiting;
  const auto wait = [&](int block, int column) {
    waiting.resize(blocks.size());
    waiting[block][column] = true;
    work.push_back({block, column});
  };
  for (int b = 0; b < int(blocks.size()); ++b) {
    for (int c = 0; c < kColumns; ++c) wait(b, c);
  }
  std::vector<std::vector<int>> hit;  // per block: its states that lead into the splitter
  while (!work.empty()) {
    const auto [splitter, column] = work.back();
    work.pop_back();
    const std::size_t c = std::size_t(column);
    waiting[splitter][c] = false;
    std::vector<int> touched;
    hit.resize(blocks.size());
    for (const int s : blocks[splitter]) {
      for (int k = offset[c][s]; k < offset[c][std::size_t(s) + 1]; ++k) {
        const int p = source[c][k], b = block_of[p];
        if (hit[b].empty()) touched.push_back(b);
        hit[b].push_back(p);
      }
    }
    for (const int b : touched) {
      std::vector<int> moved = std::move(hit[b]);
      hit[b].clear();
      auto& block = blocks[b];
      if (moved.size() == block.size()) continue;
      const int fresh = int(blocks.size());
      for (const int s : moved) block_of[s] = fresh;
      std::erase_if(block, [&](int s) { return block_of[s] == fresh; });
      blocks.push_back(std::move(moved));
      for (int d = 0; d < kColumns; ++d) {
        const auto& old = blocks[b];
        const bool old_waits = waiting[b][d];
        wait(old_waits || blocks.back().size() <= old.size() ? fresh : b, d);
      }
    }
  }
  return block_of;
}

}  // namespace

LightPathClassifier::LightPathClassifier(const std::vector<std::string>& expressions, const SourceLoc& loc)
    : count_(expressions.size()) {
  if (expressions.size() > kMaxExpressions) {
    throw Error(ErrorCode::kOutOfRange, loc,
                fmt::format("{} light-path expressions in one set; at most {}", expressions.size(), kMaxExpressions));
  }
  std::vector<NfaState> nfa;
  std::vector<Fragment> fragments;
  for (const std::string& e : expressions) fragments.push_back(Parser(e, loc, nfa).parse());
  const Dfa dfa = determinize(nfa, fragments, loc);
  const std::vector<int> block_of = equivalent_states(dfa);

  // Number the blocks in the order in which a search from the start meets them, so that the table is canonical.
  std::vector<int> number(dfa.next.size(), -1), representative;
  const auto visit = [&](int s) {
    int& n = number[block_of[s]];
    if (n < 0) {
      n = int(representative.size());
      representative.push_back(s);
    }
    return State(n);
  };
  start_ = visit(0);
  for (std::size_t i = 0; i < representative.size(); ++i) {
    const std::size_t s = std::size_t(representative[i]);
    Row row;
    for (std::size_t c = 0; c < kColumns; ++c) row.next[c] = visit(dfa.next[s][c]);
    row.accept = dfa.accept[s];
    table_.push_back(row);
  }
  // In a minimal automaton only one state can be dead: it classifies nothing and leads to itself alone.
  for (std::size_t i = 0; i < table_.size(); ++i) {
    Row& row = table_[i];
    row.alive = row.accept != 0 || std::any_of(row.next.begin(), row.next.end(), [&](State t) { return t != i; });
  }
}

std::optional<LightPathClassifier::Overlap> LightPathClassifier::overlap() const {
  // Breadth first, so that the first state with two classes has a shortest path.
  struct Step {
    State state;
    std::size_t before;
    char letter;
  };
  std::vector<Step> steps{{start_, 0, 'E'}};
  std::vector<bool> seen(table_.size());
  seen[start_] = true;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const Row& row = table_[steps[i].state];
    if (std::popcount(row.accept) > 1) {
      std::string reversed(1, 'L');
      for (std::size_t k = i; k > 0; k = steps[k].before) reversed += steps[k].letter;
      reversed += 'E';
      return Overlap{{reversed.rbegin(), reversed.rend()},
                     std::countr_zero(row.accept),
                     std::countr_zero(row.accept & (row.accept - 1))};
    }
    for (std::size_t c = 0; c < kColumns; ++c) {
      if (seen[row.next[c]]) continue;
      seen[row.next[c]] = true;
      steps.push_back({row.next[c], i, kLetters[c]});
    }
  }
  return std::nullopt;
}

}  // namespace tempera
