// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/stage.h"

#include <algorithm>
#include <set>

#include "tempera/stages/stage_run.h"

namespace tempera {

bool SequenceDesc::has(int frame) const {
  return frames.empty() ? reach.contains(frame) : std::binary_search(frames.begin(), frames.end(), frame);
}

std::vector<int> SequenceDesc::all_frames() const {
  if (!frames.empty()) return frames;
  std::vector<int> all;
  for (int f = reach.first; f <= reach.last; ++f) all.push_back(f);
  return all;
}

bool SequenceDesc::has(const LayerDesc& layer) const {
  return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
}

bool SequenceDesc::has_mask() const {
  return std::any_of(layers.begin(), layers.end(), [](const LayerDesc& d) { return d.role == LayerRole::kMask; });
}

std::span<const SequenceDesc> FrameWindow::in() const { return run_.in(); }

void FrameWindow::move_to(int frame, const Stage& stage) {
  std::set<std::pair<int, int>> wanted;
  for (int port = 0; port < std::ssize(run_.in()); ++port) {
    for (const int f : stage.inputs(port, frame, run_.in())) wanted.emplace(port, f);
  }
  std::erase_if(frames_, [&](const auto& held) { return !wanted.contains(held.first); });
  for (const auto& [port, f] : wanted) {
    if (!has(f, port)) frames_.emplace(std::pair(port, f), run_.read(f, port));
  }
}

void FrameStage::run(StageRun& run) const {
  FrameWindow window(run);
  double done = 0;
  for (const int f : run.frames()) {
    window.move_to(f, *this);
    Frame out = run.start(f);
    make(window, f, out);
    run.write(f, std::move(out));
    run.progress(++done / double(run.frames().size()));
  }
}

std::vector<int> frames_around(int frame, int before, int after, const SequenceDesc& in) {
  std::vector<int> out;
  for (int f = std::max(frame - before, in.reach.first); f <= std::min(frame + after, in.reach.last); ++f) {
    out.push_back(f);
  }
  return out;
}

std::optional<LayerUse> missing_layer(const Stage& stage, std::span<const SequenceDesc> in) {
  for (int port = 0; port < std::ssize(in); ++port) {
    for (LayerUse& use : stage.reads(port, in)) {
      if (use.required && !in[port].has(use.layer)) return std::move(use);
    }
  }
  return std::nullopt;
}

}  // namespace tempera
