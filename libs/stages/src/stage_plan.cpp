// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/stage_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>

namespace tempera {

StagePlan plan_stages(std::span<const StageChoice> chain, const SequenceDesc& source, std::span<const int> wanted) {
  StagePlan plan;
  std::vector<std::unique_ptr<Stage>> stages;
  for (std::size_t i = 0; i < chain.size(); ++i) {
    const StageEntry& entry = *chain[i].entry;
    stages.push_back(chain[i].make());
    StageStep step;
    step.in.assign(entry.ports.size(), source);
    if (i > 0) step.in[0] = plan.steps[i - 1].out;
    if (auto use = missing_layer(*stages[i], step.in)) {
      std::string message = fmt::format("the stage {} needs the layer \"{}\"", entry.name, use->layer.name);
      throw MissingLayerError(i, std::move(*use), std::move(message));
    }
    step.out = stages[i]->output(step.in);
    plan.steps.push_back(std::move(step));
  }

  // Backwards: `needed` of the step that is looked at, and of the source.
  const SequenceDesc& last = chain.empty() ? source : plan.steps.back().out;
  std::set<int> needed, of_source;
  for (const int f : wanted) {
    if (last.has(f)) needed.insert(f);
  }
  for (std::size_t i = chain.size(); i-- > 0;) {
    StageStep& step = plan.steps[i];
    step.frames.assign(needed.begin(), needed.end());
    needed.clear();
    for (int port = 0; port < std::ssize(step.in); ++port) {
      std::set<int>& into = port == 0 ? needed : of_source;
      for (const int f : step.frames) {
        const std::vector<int> inputs = stages[i]->inputs(port, f, step.in);
        for (const int g : inputs) {
          if (!step.in[port].has(g)) {
            const std::string before = port == 0 && i > 0 ? "the stage " + chain[i - 1].entry->name : "the render";
            throw Error(ErrorCode::kBadInput, fmt::format("the stage {} needs frame {}, which {} does not make",
                                                          chain[i].entry->name, g, before));
          }
          into.insert(g);
        }
      }
    }
  }
  of_source.insert(needed.begin(), needed.end());
  plan.source.assign(of_source.begin(), of_source.end());
  return plan;
}

}  // namespace tempera
