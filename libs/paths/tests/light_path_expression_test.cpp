// SPDX-License-Identifier: Apache-2.0
#include "tempera/paths/light_path_expression.h"

#include <gtest/gtest.h>

#include <ctime>
#include <functional>
#include <map>
#include <regex>
#include <set>

namespace tempera {
namespace {

using State = LightPathClassifier::State;

State step(const LightPathClassifier& c, State s, char letter) {
  switch (letter) {
    case 'D':
      return c.next(s, Event::kDiffuse);
    case 'R':
      return c.next(s, Event::kReflection);
    case 'T':
      return c.next(s, Event::kTransmission);
    default:
      return c.next_medium(s);
  }
}
State walk(const LightPathClassifier& c, const std::string& events) {
  State s = c.start();
  for (const char e : events) s = step(c, s, e);
  return s;
}
/// Classes of the path E events L.
std::uint32_t classify(const LightPathClassifier& c, const std::string& events) { return c.classes(walk(c, events)); }

/// All strings over D, R, T, V up to `length`.
void for_each_path(int length, const std::function<void(const std::string&)>& f) {
  const std::function<void(const std::string&)> extend = [&](const std::string& s) {
    f(s);
    if (int(s.size()) == length) return;
    for (const char e : std::string("DRTV")) extend(s + e);
  };
  extend("");
}

/// The same expression for std::regex, which knows nothing of our alphabet.
std::regex translate(const std::string& expression) {
  std::string out;
  bool complement = false;
  for (std::size_t i = 0; i < expression.size(); ++i) {
    const char c = expression[i];
    if (c == ' ') continue;
    if (c == '[') {
      complement = expression[i + 1] == '^';
      out += complement ? "(?:(?![" : "[";
      i += complement;
    } else if (c == ']') {
      out += complement ? "])[DRTV])" : "]";
    } else if (c == '.') {
      out += "[DRTV]";
    } else {
      out += c == 'C' ? 'E' : c;
    }
  }
  return std::regex(out);
}

std::string repeat(const std::string& text, int count) {
  std::string s;
  for (int i = 0; i < count; ++i) s += text;
  return s;
}

const std::vector<std::string> kDefaultTree{"ED", "ED.+", "ERD.*", "ETTD.*"};

TEST(LightPathExpression, AgreesWithARegexMatcherOnAllShortPaths) {
  const std::vector<std::string> checked{"E",
                                         "EL",
                                         "ED",
                                         "ED.+",
                                         "ERD.*",
                                         "ETTD.*",
                                         "E.*",
                                         "E.+L",
                                         "E[RT]*D",
                                         "E[^D]*",
                                         "E(R|T)+D.*L",
                                         "ED?R?T?V?",
                                         "E(DR){2}",
                                         "E(D|R{2,3}|T{2,})*",
                                         "E.{2,4}D",
                                         "C(DL|R|TL?)",
                                         "E (D | R) * V",
                                         "E[DR][^RT]{0,2}(T|V?)",
                                         "E((D*R)*T)*",
                                         "E(((D)))",
                                         "E[^RT]+[VT]{3}",
                                         "E(D+|R+)+(TV)*",
                                         "E.{0}D",
                                         "E(D?){5}T",
                                         "E((D|RR)+T?){1,2}",
                                         "E(D{2}){2}|E(R{1,2}T){1,}",
                                         "E(D*)*",
                                         "E(D?R?)+",
                                         "E(D{0,2}R){2,}T{0}"};
  const LightPathClassifier joint(checked);
  for (std::size_t i = 0; i < checked.size(); ++i) {
    const LightPathClassifier alone({checked[i]});
    const std::regex regex = translate(checked[i]);
    int members = 0;
    for_each_path(6, [&](const std::string& events) {
      const std::string path = "E" + events;
      const bool expected = std::regex_match(path, regex) || std::regex_match(path + "L", regex);
      members += expected;
      EXPECT_EQ(classify(alone, events) == 1, expected) << checked[i] << " on " << path;
      EXPECT_EQ((classify(joint, events) >> i & 1) == 1, expected) << checked[i] << " on " << path << " in the set";
    });
    EXPECT_GT(members, 0) << checked[i];
  }
}

TEST(LightPathExpression, AutomatonIsMinimal) {
  // Two states must differ on some continuation; of n states, one shorter than n.
  const LightPathClassifier c({"E(D|R)*T.{3}", "E.*V[^D]", "ED{2,5}"});
  const std::size_t n = c.state_count();
  std::vector<std::vector<int>> kind(n, std::vector<int>(1));
  std::vector<int> block(n);
  for (std::size_t s = 0; s < n; ++s) block[s] = int(c.classes(State(s)));
  for (std::size_t round = 0; round < n; ++round) {
    std::map<std::vector<int>, int> signature;
    std::vector<int> refined(n);
    for (std::size_t s = 0; s < n; ++s) {
      std::vector<int> key{block[s]};
      for (const char e : std::string("DRTV")) key.push_back(block[step(c, State(s), e)]);
      refined[s] = signature.try_emplace(key, int(signature.size())).first->second;
    }
    block = refined;
  }
  for (std::size_t s = 0; s < n; ++s) {
    for (std::size_t t = 0; t < s; ++t) EXPECT_NE(block[s], block[t]) << s << " and " << t << " are equal";
  }
}

TEST(LightPathExpression, DefaultDecompositionHasTheNineStatesOfTheTable) {
  const LightPathClassifier c(kDefaultTree);
  EXPECT_EQ(c.state_count(), 9u);
  const State s0 = walk(c, ""), s1 = walk(c, "D"), s2 = walk(c, "R"), s3 = walk(c, "T"), s4 = walk(c, "DD"),
              s5 = walk(c, "RD"), s6 = walk(c, "TT"), s7 = walk(c, "TTD"), dead = walk(c, "TD");
  const std::vector<State> states{s0, s1, s2, s3, s4, s5, s6, s7, dead};
  EXPECT_EQ(std::set<State>(states.begin(), states.end()).size(), 9u);
  const auto row = [&](State s) {
    return std::vector<State>{step(c, s, 'D'), step(c, s, 'R'), step(c, s, 'T'), step(c, s, 'V')};
  };
  EXPECT_EQ(row(s0), (std::vector{s1, s2, s3, dead}));
  EXPECT_EQ(row(s1), (std::vector{s4, s4, s4, s4}));
  EXPECT_EQ(row(s4), (std::vector{s4, s4, s4, s4}));
  EXPECT_EQ(row(s2), (std::vector{s5, dead, dead, dead}));
  EXPECT_EQ(row(s5), (std::vector{s5, s5, s5, s5}));
  EXPECT_EQ(row(s3), (std::vector{dead, dead, s6, dead}));
  EXPECT_EQ(row(s6), (std::vector{s7, dead, dead, dead}));
  EXPECT_EQ(row(s7), (std::vector{s7, s7, s7, s7}));
  EXPECT_EQ(row(dead), (std::vector{dead, dead, dead, dead}));
  std::vector<std::uint32_t> classes;
  for (const State s : states) classes.push_back(c.classes(s));
  EXPECT_EQ(classes, (std::vector<std::uint32_t>{0, 1, 0, 0, 2, 4, 0, 8, 0}));
  for (const State s : states) EXPECT_EQ(c.alive(s), s != dead);
  EXPECT_FALSE(c.overlap());
}

TEST(LightPathExpression, EmptySetClassifiesNothing) {
  const LightPathClassifier c;
  EXPECT_EQ(c.expression_count(), 0u);
  EXPECT_EQ(classify(c, "DRT"), 0u);
  EXPECT_FALSE(c.alive(c.start()));
  EXPECT_FALSE(c.overlap());
}

TEST(LightPathExpression, AliveMeansThatSomeContinuationBelongs) {
  const LightPathClassifier c({"ED{3}", "ER(TV)*"});
  for_each_path(4, [&](const std::string& prefix) {
    bool reachable = false;
    for_each_path(4, [&](const std::string& suffix) { reachable |= classify(c, prefix + suffix) != 0; });
    EXPECT_EQ(c.alive(walk(c, prefix)), reachable) << prefix;
  });
}

TEST(LightPathExpression, OverlapHasAShortestWitness) {
  const auto overlap = [](const std::vector<std::string>& e) { return LightPathClassifier(e).overlap(); };
  auto o = overlap({"ED.*", "ED"});
  ASSERT_TRUE(o);
  EXPECT_EQ(o->witness, "EDL");
  EXPECT_EQ(o->first, 0);
  EXPECT_EQ(o->second, 1);
  o = overlap({"ER", "E.*T.*", "E.{3}", "EV*"});
  ASSERT_TRUE(o);
  EXPECT_EQ(o->witness, "EDDTL");
  EXPECT_EQ(o->first, 1);
  EXPECT_EQ(o->second, 2);
  o = overlap({"E", "E.*L"});
  ASSERT_TRUE(o);
  EXPECT_EQ(o->witness, "EL");
  EXPECT_FALSE(overlap({"E[RT]*D.*", "E[^D]*", "E[RT]*V[^V]*D"}).has_value());
}

TEST(LightPathExpression, SpellingsOfTheSameSetAreTheSameAutomaton) {
  const std::vector<std::pair<std::string, std::string>> pairs{
      {"ED", "EDL"},     {"ED.+", "ED.+L"},    {"ED", "CD"},       {"E[DR]T", "E(D|R) T"},
      {"E.", "E[DRTV]"}, {"E[^DV]", "E(T|R)"}, {"ED{2,}", "EDDD*"}};
  for (const auto& [a, b] : pairs) {
    const LightPathClassifier ca({a}), cb({b});
    EXPECT_EQ(ca.state_count(), cb.state_count()) << a << " " << b;
    for_each_path(5, [&](const std::string& p) { EXPECT_EQ(walk(ca, p), walk(cb, p)) << a << " " << b << " " << p; });
  }
}

struct BadExpression {
  const char* text;
  int column;  ///< from 1
  const char* message;
  ErrorCode code = ErrorCode::kSyntax;
};

TEST(LightPathExpression, ErrorsNameTheCharacterAndWhatIsExpected) {
  const std::vector<BadExpression> table{
      {"", 1, "expected E"},
      {"   ", 4, "expected E"},
      {"D", 1, "expected E: every path begins with it"},
      {".D", 1, "expected E: every path begins with it"},
      {"ED|RD", 4, "expected E: every path begins with it"},
      {"E?D", 3, "expected E: every path begins with it"},
      {"[ED]D", 1, "expected E: every path begins with it"},
      {"E*", 1, "this can be empty"},
      {"EDED", 3, "E can only begin a path"},
      {"(ED)+", 2, "E can only begin a path"},
      {"ELD", 3, "nothing can follow it"},
      {"E(DL?)*", 3, "nothing can follow it"},
      {"ELL", 3, "nothing can follow it"},
      {"EDx", 3, "one of D R T V E L), '.', '[' or '(', not 'x'"},
      {"ES", 2, "not 'S'"},
      {"Ed", 2, "not 'd'"},
      {"E\x01", 2, "not the byte 0x01"},
      {"E\xc3\xa9", 2, "not the byte 0xc3"},
      {"ED|", 4, "before the end"},
      {"|ED", 1, "not '|'"},
      {"*", 1, "not '*'"},
      {"E|*", 3, "not '*'"},
      {"E(", 3, "before the end"},
      {"E()", 3, "not ')'"},
      {"E(D", 4, "expected ')' before the end"},
      {"ED)", 3, "closes nothing"},
      {"E[", 3, "expected an event (one of D R T V E L) before the end"},
      {"E[]", 3, "expected an event (one of D R T V E L), not ']'"},
      {"E[D", 4, "before the end"},
      {"E[D*]", 4, "not '*'"},
      {"E[^DRTV]", 2, "excludes every event"},
      {"ED{", 4, "expected a number before the end"},
      {"ED{}", 4, "expected a number, not '}'"},
      {"ED{,3}", 4, "expected a number, not ','"},
      {"ED{2", 5, "expected ',' or '}' before the end"},
      {"ED{2x}", 5, "expected ',' or '}', not 'x'"},
      {"ED{2,3x}", 7, "expected '}', not 'x'"},
      {"ED{2,x}", 6, "expected a number, not 'x'"},
      {"ED{3,2}", 4, "the limits 3,2 are in the wrong order", ErrorCode::kOutOfRange},
      {"ED{256}", 4, "at most 255", ErrorCode::kOutOfRange},
      {"ED{1,99999999999999999999}", 6, "at most 255", ErrorCode::kOutOfRange},
  };
  for (const BadExpression& bad : table) {
    try {
      LightPathClassifier c({"ED", bad.text}, {"shot.toml", 12, 20});
      ADD_FAILURE() << "accepted \"" << bad.text << "\"";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), bad.code) << bad.text << ": " << e.what();
      EXPECT_EQ(e.loc().line, 12) << bad.text;
      EXPECT_EQ(e.loc().column, 19 + bad.column) << bad.text << ": " << e.what();
      EXPECT_NE(e.message().find(bad.message), std::string::npos) << bad.text << ": " << e.what();
      EXPECT_NE(e.message().find("character " + std::to_string(bad.column) + ":"), std::string::npos) << e.what();
    }
  }
}

TEST(LightPathExpression, HostileExpressionsEndQuickly) {
  const std::string eye = "E", open = "(", close = ")";
  std::vector<std::string> twins;  // each alone is small; their product is not
  for (int i = 0; i < 32; ++i) twins.push_back(eye + "(.{" + std::to_string(2 * i + 3) + "})*D");
  const std::vector<std::vector<std::string>> hostile{
      {eye + repeat(open, 30) + "." + repeat("{9})", 30)},
      {eye + "D" + repeat("{1,2}", 40)},
      {eye + "D" + repeat("*", 100000)},
      twins,
      {eye + repeat(open, 100000)},
      {eye + repeat(open, 65) + "D" + repeat(close, 65)},
      {"E.*D.{40}"},
      {"E(.*D.{9}){9}"},
      {"E.D**.+{255}{2,8}"},
      {"E.{255}{255}"},
      {"E((.{0,255}){0,255}){0,255}"},
      std::vector<std::string>(33, "ED"),
      {eye + repeat("D", 1000000)},
      std::vector<std::string>(32,
                               eye + repeat("((.{16}){16}){16}{0}", 204) + "D{255}{255}"),  // discarded work is work
      {eye + open + repeat("L", 4000) + close},
  };
  for (std::size_t i = 0; i < hostile.size(); ++i) {
    const std::clock_t begin = std::clock();  // of this process: other programs do not count
    try {
      LightPathClassifier c(hostile[i]);
      ADD_FAILURE() << "accepted " << i << " with " << c.state_count() << " states";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), i + 1 == hostile.size() ? ErrorCode::kSyntax : ErrorCode::kOutOfRange) << e.what();
      EXPECT_LT(std::string(e.what()).size(), 400u);
    }
    // A fraction of a second; sanitizers and assertions take ten times that.
    EXPECT_LT(double(std::clock() - begin) / CLOCKS_PER_SEC, 5.0) << "set " << i;
  }
}

TEST(LightPathExpression, LargeButReasonableSetsCompile) {
  const std::string eye = "E";
  std::vector<std::string> each;  // one class for each length of path, as a depth decomposition asks for
  for (int i = 0; i < 32; ++i) each.push_back(eye + ".{" + std::to_string(i) + "}");
  const LightPathClassifier c(each);
  EXPECT_EQ(c.state_count(), 33u);
  EXPECT_FALSE(c.overlap());
  EXPECT_EQ(LightPathClassifier({"E(.{60}){60}"}).state_count(), 3602u);
  EXPECT_EQ(LightPathClassifier({eye + repeat("(", 64) + "D" + repeat(")", 64)}).state_count(), 3u);
}

}  // namespace
}  // namespace tempera
