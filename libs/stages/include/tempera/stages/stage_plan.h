// SPDX-License-Identifier: Apache-2.0
#pragma once
// Stages behind each other: what goes in and comes out of each, and, backwards from the frames that are wanted, which
// frames each of them has to make.
#include <span>
#include <vector>

#include "tempera/stages/stage.h"

namespace tempera {

/// One stage of a chain, or `fill` after it.
struct StageStep {
  StageChoice choice;
  std::size_t asked = 0;         ///< index of the stage in the chain; of `fill`: of the one that writes the mask
  std::vector<SequenceDesc> in;  ///< by port
  SequenceDesc out;
  std::vector<int> frames;  ///< to make, in ascending order
  /// Whether it puts pixels into the frames of the step before that are rendered in between.
  bool fills() const;
};

struct StagePlan {
  std::vector<StageStep> steps;  ///< in their order
  SequenceDesc source_desc;      ///< the source, smaller where stages enlarge it
  std::vector<int> source;       ///< frames of the source that they read, in ascending order
  std::vector<int> guides;       ///< frames that they read of guides (StagePort::guides), in ascending order
};

/// A stage of a chain reads a layer that nothing before it writes.
class MissingLayerError : public Error {
 public:
  /// `step`: index of the stage in the chain.
  MissingLayerError(std::size_t step, LayerUse use, std::string message)
      : Error(ErrorCode::kBadInput, std::move(message)), step_(step), use_(std::move(use)) {}
  std::size_t step() const { return step_; }
  const LayerUse& use() const { return use_; }

 private:
  std::size_t step_;
  LayerUse use_;
};

/// Plans `chain`: the first port of each stage gets the frames of the one before it, the first one's the source's; all
/// other ports get the source's, or guides, which are such frames, too. `source` has the size of the result: where stages
/// enlarge frames, the source itself is smaller. After a stage that writes a mask comes a step that fills it: its second port gets
/// frames like the source's, of the size and the numbers of the stage's, in which the pixels of the mask are rendered.
/// `wanted`: frames of the last stage; those that it does not make are left out.
/// Errors: MissingLayerError; Error{kBadInput} for a frame that a stage reads and the one before does not make; those
/// of Stage::output. Pre: the source has all frames of its reach.
StagePlan plan_stages(std::span<const StageChoice> chain, const SequenceDesc& source, std::span<const int> wanted);

}  // namespace tempera
