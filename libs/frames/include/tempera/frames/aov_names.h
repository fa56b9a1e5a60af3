// SPDX-License-Identifier: Apache-2.0
#pragma once
// Layer names of other programs: which EXR channels a frame becomes when it is written for them, and which of our
// layers the channels of their files are. Facts from the manuals and file conventions of Blender, Arnold, RenderMan and
// pbrt-v4.
#include <optional>
#include <string>
#include <vector>

#include "tempera/frames/layers.h"

namespace tempera {

/// Whose names of layers and channels a file uses.
enum class AovNames { kTempera, kBlender, kArnold, kRenderman, kPbrt };
/// Reads "tempera", "blender", "arnold", "renderman" or "pbrt". Errors: Error{kUnknownName} with the known names.
AovNames parse_aov_names(std::string_view text);

/// How other programs store a value of ours: theirs = scale * ours + offset, and `background` where nothing is seen.
struct AovValue {
  float scale = 1, offset = 0;
  /// What stands for our 0 of pixels that show nothing; without it 0 is a value like any other.
  std::optional<float> background{};
  float to_theirs(float ours) const {
    if (background && ours == 0) return *background;
    return scale == 1 && offset == 0 ? ours : scale * ours + offset;  // the same bits of -0
  }
  float to_ours(float theirs) const {
    if (background && theirs == *background) return 0;
    return scale == 1 && offset == 0 ? theirs : (theirs - offset) / scale + 0.0f;  // no -0
  }
  bool operator==(const AovValue&) const = default;
};

/// One channel of a file: it holds channel `source_channel` of our layer `source`.
struct AovChannel {
  std::string name;    ///< in the file
  std::string source;  ///< our layer
  int source_channel = 0;
  AovValue value{};
  bool operator==(const AovChannel&) const = default;
};

/// Name of the view layer that Blender's scenes begin with.
inline constexpr const char* kViewLayer = "ViewLayer";

/// The channels of a file that holds `layers` under the names of `names`, in the order of the layers. Layers that the
/// other program has no name for keep theirs. For Blender every name is "<view_layer>.<pass>.<channel>", a pass without
/// a name there being ours with '_' for '.'; normals and positions are in its space, where z is up; Depth is 1e10 where
/// nothing is seen. Its Vector pass (X, Y: previous - current; Z, W: current - next; y up) is written when both motion
/// layers are there, as well as them, since only they hold depth change and validity.
std::vector<AovChannel> aov_channels(const std::vector<LayerDesc>& layers, AovNames names,
                                     const std::string& view_layer = kViewLayer);

/// One line per layer, "normal -> ViewLayer.Denoising Normal.{X,Y,Z}", for the log.
std::string describe_aov_names(const std::vector<LayerDesc>& layers, AovNames names,
                               const std::string& view_layer = kViewLayer);

/// Where a channel of one of our layers comes from when a file is read: channel `channel` of the file, in its order.
struct ChannelSource {
  int channel = 0;
  AovValue value{};  ///< how the file stores it
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
