// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdlib>

#include "entries.h"
#include "tempera/paths/light_path_expression.h"

namespace tempera::fuzz {

void lpe(std::string_view input) {
  std::vector<std::string> expressions;
  std::size_t longest = 0;
  while (!input.empty()) {
    const std::size_t end = std::min(input.find('\n'), input.size());
    expressions.emplace_back(input.substr(0, end));
    longest = std::max(longest, end);
    input.remove_prefix(std::min(end + 1, input.size()));
  }
  expect_bad_input_only([&] {
    try {
      const LightPathClassifier c(expressions, {"shot.toml", 1, 1});
      // Every path ends in a state of the table, and an overlap is one that walking the table confirms.
      for (LightPathClassifier::State s = 0; s < c.state_count(); ++s) {
        for (const Event e : {Event::kDiffuse, Event::kReflection, Event::kTransmission}) {
          if (c.next(s, e) >= c.state_count() || (!c.alive(s) && c.alive(c.next(s, e)))) std::abort();
        }
        if (c.next_medium(s) >= c.state_count() || (c.classes(s) && !c.alive(s))) std::abort();
      }
      if (const auto overlap = c.overlap()) {
        LightPathClassifier::State s = c.start();
        for (const char letter : overlap->witness.substr(1, overlap->witness.size() - 2)) {
          s = letter == 'V' ? c.next_medium(s)
                            : c.next(s, letter == 'D'   ? Event::kDiffuse
                                        : letter == 'R' ? Event::kReflection
                                                        : Event::kTransmission);
        }
        const std::uint32_t both = 1u << overlap->first | 1u << overlap->second;
        if (overlap->first == overlap->second || (c.classes(s) & both) != both) std::abort();
      }
    } catch (const Error& e) {
      if (e.loc().column < 1 || std::size_t(e.loc().column) > longest + 1) std::abort();
      throw;
    }
  });
}

}  // namespace tempera::fuzz
