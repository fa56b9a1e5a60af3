// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a frame file says about itself: named values in the EXR header, and the record of a render among them that lets
// `--resume` recognise finished frames.
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "tempera/core/bytes.h"

namespace tempera {

/// Values that EXR headers hold: string, int (32 bits), float or double. Reading gives double for both of the latter.
using MetaValue = std::variant<std::string, int, double>;
/// Full attribute name -> value, e.g. "tempera/seed", "cryptomatte/3e14daf/name".
using Metadata = std::map<std::string, MetaValue>;

void save_metadata(const Metadata& metadata, ByteWriter& out);
/// Errors: Error{kBadInput}.
void read_metadata(Metadata& metadata, ByteReader& in);

/// The text of a value, numbers as short as they read back.
std::string to_text(const MetaValue& value);

/// Frames per second as a fraction, as movies and EXR headers store it: 24000/1001 for what people write as 23.976,
/// whole thousandths in lowest terms otherwise. Pre: fps in [0.001, 2000000].
struct FrameRate {
  int numerator = 24, denominator = 1;
  bool operator==(const FrameRate&) const = default;
};
FrameRate frame_rate(double fps);

/// Width of a pixel over its height, where that is not 1. EXR files get the standard attribute from it, too.
inline constexpr const char* kPixelAspectKey = "tempera/pixel_aspect";

/// The motion vector convention that every file states as "tempera/motion".
inline constexpr const char* kMotionConvention =
    "pixels, x right, y down; backward = previous - current, forward = next - current; Z = depth change in meters; "
    "V = 1 where valid";

/// Attributes that identify the content of a file by everything that it was computed from. A file has one of them: that
/// of a rendered frame, or that of the stage which made it. `--resume` and what is made of the files go by them.
inline constexpr const char* kFingerprintKey = "tempera/fingerprint";
std::string stage_fingerprint_key(std::string_view stage);  ///< "tempera/<stage>_fingerprint"
bool is_fingerprint_key(std::string_view key);

/// Attributes of a file that a stage made: its parameters, and its command line.
std::string stage_settings_key(std::string_view stage);  ///< "tempera/<stage>"
std::string stage_command_key(std::string_view stage);   ///< "tempera/<stage>_command"
/// What did the work, where that depends on the machine.
std::string stage_engine_key(std::string_view stage);  ///< "tempera/<stage>_engine"

/// A class of light paths whose layers a file has: what class.<name>.color is of, see docs/layers.md.
struct ClassInfo {
  std::string name;
  std::string expression;  ///< over the events of paths; tabs are spaces after reading
  /// Whose surfaces its light is seen on, see layers::chain_layer. "RL", with an L in the place of the D, is light of lamps
  /// alone that mirrors show: they have the layers of "RD", and no reflectance that light could be divided by.
  std::vector<std::string> chains;
  bool operator==(const ClassInfo&) const = default;
};
/// Sets the attribute "tempera/classes", a line for each class: its name, its expression and its chains, apart by tabs.
/// No attribute without classes.
void set_classes(Metadata& metadata, std::span<const ClassInfo> classes);
/// What set_classes stored; empty where the attribute is missing. A line that lacks fields has them empty.
std::vector<ClassInfo> classes(const Metadata& metadata);

/// How a frame was rendered: the attributes "tempera/<field>". The text fields are free of meaning to this module.
struct RenderInfo {
  std::string version;     ///< of the program
  std::string command;     ///< command line
  std::string scene;       ///< name of the scene file
  std::string scene_hash;  ///< of everything that the scene consists of
  std::string integrator;
  std::string parameters;  ///< Params::canonical()
  int spp = 0;
  std::uint64_t seed = 0;
  int frame = 0;
  double fps = 24;
  double shutter_open = 0, shutter_close = 0.5;  ///< fractions of a frame
  double render_seconds = 0;                     ///< wall time spent on the frame

  /// Whether `other` would hold the same pixels: all fields but command, scene (the name) and render time are equal.
  bool same_render(const RenderInfo& other) const;
  bool operator==(const RenderInfo&) const = default;
};
/// Sets the attributes of `info` and the motion vector convention.
void set_render_info(Metadata& metadata, const RenderInfo& info);
/// The record that set_render_info stored; none when it is missing or incomplete.
std::optional<RenderInfo> render_info(const Metadata& metadata);

}  // namespace tempera
