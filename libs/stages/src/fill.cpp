// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/fill.h"

#include <fmt/format.h>

#include <algorithm>

#include "tempera/core/parallel.h"

namespace tempera {

namespace {

enum Port { kFrames, kPixels };

class Fill final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    if (in[kFrames].width != in[kPixels].width || in[kFrames].height != in[kPixels].height) {
      throw Error(ErrorCode::kBadInput,
                  fmt::format("the frames to be filled have {}x{} pixels, the rendered ones {}x{}", in[kFrames].width,
                              in[kFrames].height, in[kPixels].width, in[kPixels].height));
    }
    SequenceDesc out = in[kFrames];
    std::erase_if(out.layers, [](const LayerDesc& d) { return d.role == LayerRole::kMask; });
    if (std::none_of(out.layers.begin(), out.layers.end(), [&](const LayerDesc& d) { return in[kPixels].has(d); }))
      throw Error(ErrorCode::kBadInput, "the rendered frames have none of the layers that are to be filled");
    return out;
  }
  std::vector<LayerUse> reads(int port, std::span<const SequenceDesc> in) const override {
    std::vector<LayerUse> uses;
    for (const LayerDesc& d : in[kFrames].layers) {
      const bool mask = d.role == LayerRole::kMask;
      if (port == kFrames && mask) uses.push_back({d, true, kWhyMask});
      if (port == kPixels && !mask && in[kPixels].has(d)) uses.push_back({d, true, "others have it"});
    }
    if (port == kFrames && uses.empty()) uses.push_back({layers::mask(), true, kWhyMask});
    return uses;
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    const Image& mask = in.at(frame, kFrames).layers().front().image;
    for (const Layer& rendered : in.at(frame, kPixels).layers()) {
      const std::string& name = rendered.desc.name;
      const Image& from = rendered.image;
      if (!out.has(name)) continue;
      Image& to = out.layer(name);
      if (from.channels() != to.channels()) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("frame {}: the layer \"{}\" has {} channels in the frames to be filled, {} in the "
                                "rendered ones",
                                frame, name, to.channels(), from.channels()));
      }
      parallel_for(0, to.height(), [&](std::int64_t row) {
        const int y = int(row);
        for (int x = 0; x < to.width(); ++x) {
          if (!(mask.at(x, y) > 0)) continue;
          for (int c = 0; c < to.channels(); ++c) to.at(x, y, c) = from.at(x, y, c);
        }
      });
    }
  }

 private:
  static constexpr const char* kWhyMask = "it says which pixels to fill";
};

}  // namespace

const StageEntry fill_entry{
    .name = "fill",
    .help = "pixels that a stage left to the renderer, put into its frames",
    .command_help = "Put pixels that were rendered alone into the frames of a stage that left them out.",
    .done = "filled",
    .ports = {{"base", "frames of a stage that writes the layer mask"},
              {"pixels", "frames in which the pixels of that mask are rendered"}},
    .output_help = "filled frames",
    .reads = {{{"mask"}, "above 0 where a pixel is to be filled"},
              {{"*"}, "of the rendered frames: every layer that the others have, too"}},
    .writes = {{{"*"}, "all layers but the mask; where the mask is above 0, the rendered pixel"}},
    .window = "the frame itself",
    .gap_help = "each frame takes pixels of its own",
    .examples = {"tempera render shot.toml --mask between/f.####.exr -o pixels/f.####.exr",
                 "tempera fill between/ pixels/ -o final/   (between/ is what a stage wrote, with the layer mask)"},
    .make = [](const Params&) -> std::unique_ptr<Stage> { return std::make_unique<Fill>(); },
    .inserted_help = "follows by itself, after a render of these pixels, where a stage writes a mask"};

}  // namespace tempera
