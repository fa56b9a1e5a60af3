// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/stage_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "tempera/stages/fill.h"

namespace tempera {

namespace {

/// A step whose inputs are known, with what comes out of it. Errors: MissingLayerError; those of Stage::output.
StageStep make_step(const StageChoice& choice, const Stage& stage, std::size_t asked, std::vector<SequenceDesc> in) {
  if (auto use = missing_layer(stage, in)) {
    std::string message = fmt::format("the stage {} needs the layer \"{}\"", choice.entry->name, use->layer.name);
    throw MissingLayerError(asked, std::move(*use), std::move(message));
  }
  SequenceDesc out = stage.output(in);
  return {choice, asked, std::move(in), std::move(out), {}};
}

}  // namespace

bool StageStep::fills() const { return choice.entry == &fill_entry; }

StagePlan plan_stages(std::span<const StageChoice> chain, const SequenceDesc& result, std::span<const int> wanted) {
  StagePlan plan;
  SequenceDesc& source = plan.source_desc;
  source = result;
  int factor = 1;
  std::string enlarging;
  for (const StageChoice& choice : chain) {
    if (choice.entry->enlarges > 1) factor *= choice.entry->enlarges, enlarging = choice.entry->name;
  }
  source.width /= factor, source.height /= factor;
  if (source.width * factor != result.width || source.height * factor != result.height) {
    const auto above = [&](int size) { return (size + factor - 1) / factor * factor; };
    throw Error(ErrorCode::kBadInput,
                fmt::format("the stage {} makes pictures {} times as wide and high, which cannot be {}x{}, but {}x{}",
                            enlarging, factor, result.width, result.height, above(result.width), above(result.height)));
  }
  std::vector<std::unique_ptr<Stage>> stages;
  const auto add = [&](const StageChoice& choice, std::size_t asked, std::vector<SequenceDesc> in) {
    stages.push_back(choice.make());
    plan.steps.push_back(make_step(choice, *stages.back(), asked, std::move(in)));
  };
  for (std::size_t i = 0; i < chain.size(); ++i) {
    std::vector<SequenceDesc> in(chain[i].entry->ports.size(), source);
    for (std::size_t port = 1; port < in.size(); ++port) {
      if (chain[i].entry->ports[port].guides) in[port] = result;
    }
    if (i > 0) in[0] = plan.steps.back().out;
    add(chain[i], i, std::move(in));
    const SequenceDesc made = plan.steps.back().out;
    if (!made.has_mask()) continue;
    SequenceDesc pixels = made;
    pixels.layers = result.layers;
    add({&fill_entry, Params(fill_entry.params)}, i, {made, pixels});
  }

  // Backwards: `needed` of the step that is looked at, and of the source.
  const SequenceDesc& last = chain.empty() ? source : plan.steps.back().out;
  std::set<int> needed, of_source, of_guides;
  for (const int f : wanted) {
    if (last.has(f)) needed.insert(f);
  }
  for (std::size_t i = plan.steps.size(); i-- > 0;) {
    StageStep& step = plan.steps[i];
    step.frames.assign(needed.begin(), needed.end());
    if (step.fills()) continue;  // it takes each frame from the one of this number
    needed.clear();
    for (int port = 0; port < std::ssize(step.in); ++port) {
      std::set<int>& into = port == 0 ? needed : step.choice.entry->ports[port].guides ? of_guides : of_source;
      for (const int f : step.frames) {
        const std::vector<int> inputs = stages[i]->inputs(port, f, step.in);
        for (const int g : inputs) {
          if (!step.in[port].has(g)) {
            const bool rendered = port > 0 || step.asked == 0;
            const std::string before = rendered ? "the render" : "the stage " + chain[step.asked - 1].entry->name;
            throw Error(ErrorCode::kBadInput, fmt::format("the stage {} needs frame {}, which {} does not make",
                                                          step.choice.entry->name, g, before));
          }
          into.insert(g);
        }
      }
    }
  }
  of_source.insert(needed.begin(), needed.end());
  plan.source.assign(of_source.begin(), of_source.end());
  plan.guides.assign(of_guides.begin(), of_guides.end());
  return plan;
}

}  // namespace tempera
