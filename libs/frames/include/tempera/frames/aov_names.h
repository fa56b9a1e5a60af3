// SPDX-License-Identifier: Apache-2.0
#pragma once
// Layer names of other programs: which EXR channels a frame becomes when it is written for them, and which of our
// layers the channels of their files are. Facts from the manuals and file conventions of Blender, Arnold, RenderMan and
// pbrt-v4.
#include <string>
#include <vector>

#include "tempera/frames/layers.h"

namespace tempera {

/// Whose names of layers and channels a file uses.
enum class AovNames { kTempera, kBlender, kArnold, kRenderman, kPbrt };
/// Reads "tempera", "blender", "arnold", "renderman" or "pbrt". Errors: Error{kUnknownName} with the known names.
AovNames parse_aov_names(std::string_view text);

/// One channel of a file: its value is `scale` times channel `source_channel` of our layer `source`.
struct AovChannel {
  std::string name;    ///< in the file
  std::string source;  ///< our layer
  int source_channel = 0;
  float scale = 1;
  bool operator==(const AovChannel&) const = default;
};

/// The channels of a file that holds `layers` under the names of `names`, in the order of the layers. Layers that the
/// other program has no name for keep theirs (for Blender as the pass "ViewLayer.<name with '_' for '.'>").
/// Blender's Vector pass (X, Y: previous - current; Z, W: current - next; y up) is written when both motion layers are
/// there, beside them, since only they hold depth change and validity.
std::vector<AovChannel> aov_channels(const std::vector<LayerDesc>& layers, AovNames names);

/// One line per layer, "normal -> ViewLayer.Denoising Normal.{X,Y,Z}", for the log.
std::string describe_aov_names(const std::vector<LayerDesc>& layers, AovNames names);

/// Where a channel of one of our layers comes from when a file is read: `scale` times channel `channel` (in the order
/// of the file) of the file.
struct ChannelSource {
  int channel = 0;
  float scale = 1;
};
struct LayerSource {
  LayerDesc desc;
  std::vector<ChannelSource> channels;  ///< one per desc.channels
};
/// Groups the channel names of a file into layers, known layers in the channel order of the vocabulary. With
/// `translate` the names of other programs become ours where that is unambiguous: the first of two claimants wins, the
/// other keeps its name.
std::vector<LayerSource> layers_of_channels(const std::vector<std::string>& channels, bool translate = true);

}  // namespace tempera
