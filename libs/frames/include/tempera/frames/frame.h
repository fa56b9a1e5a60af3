// SPDX-License-Identifier: Apache-2.0
#pragma once
// A frame: named layers of one size with metadata, and its multi-layer EXR files. Sequences of files are in sequence.h.
#include <list>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/frames/aov_names.h"
#include "tempera/frames/image.h"
#include "tempera/frames/layers.h"
#include "tempera/frames/metadata.h"

namespace tempera {

struct Layer {
  LayerDesc desc;
  Image image;
  bool operator==(const Layer&) const = default;
};

/// An ordered set of layers of one size. References to layers stay valid until that layer is removed.
/// Threads: const access from many; different layers may be written concurrently.
class Frame {
 public:
  Frame() = default;
  Frame(int width, int height) : width_(width), height_(height) {}

  int width() const { return width_; }
  int height() const { return height_; }

  /// Adds a layer of zeros, or sets the one of that name to zeros. Pre: the frame has a size.
  Image& create(const LayerDesc& desc);
  /// Adds a layer or replaces the one of that name; gives a frame without layers its size.
  /// Errors: Error{kBadInput} if the size differs from the frame's or the channels from the descriptor's.
  Image& add(LayerDesc desc, Image image);
  void remove(std::string_view name);

  bool has(std::string_view name) const { return find(name) != nullptr; }
  /// The layer of that name; null when there is none.
  const Layer* find(std::string_view name) const;
  /// Errors: Error{kUnknownName} naming the layers that are there.
  const Image& layer(std::string_view name) const;
  Image& layer(std::string_view name);
  const LayerDesc& desc(std::string_view name) const;
  const std::list<Layer>& layers() const { return layers_; }
  std::vector<std::string> layer_names() const;

  Metadata metadata;

 private:
  const Layer& get(std::string_view name) const;
  int width_ = 0, height_ = 0;
  std::list<Layer> layers_;
};

/// EXR compression. kDwaa loses a little of the picture and is refused for frames with data layers that it would
/// damage.
enum class Compression { kNone, kRle, kZips, kZip, kPiz, kDwaa };

struct WriteOptions {
  Compression compression = Compression::kZip;
  /// 16-bit floats for radiance and reflectance layers, clamped to what these hold (65504); data layers stay 32-bit.
  bool half = false;
  AovNames names = AovNames::kTempera;
  std::string view_layer = kViewLayer;  ///< of Blender's names
};
/// What of the options decides the names in a file, for fingerprints.
std::string names_text(const WriteOptions& options);
/// Reads "none", "rle", "zips", "zip", "piz" or "dwaa". Errors: Error{kUnknownName} with the known names.
Compression parse_compression(std::string_view text);

/// Checks before the work that write_frame can store a frame of these layers. Errors: Error{kUnsupported} for kDwaa
/// with data layers that it would damage; Error{kBadInput} for two layers that become one channel.
void check_encoding(const std::vector<LayerDesc>& layers, const WriteOptions& options);

/// Writes a single-part multi-layer EXR, whole or not at all (see write_file).
/// Result:  the same bytes for the same frame and options.
/// Errors:  Error{kFailed} if the disk is full, read-only or not permitted: what stood at `path` stays, no temporary
/// file
///          does. Error{kBadInput} for a frame without layers; those of check_encoding.
/// Threads: safe for different frames.
void write_frame(const std::string& path, const Frame& frame, const WriteOptions& options = {});

struct ReadOptions {
  std::vector<std::string> layers;  ///< names of the layers to keep; empty: all. One that the file lacks is an error.
  bool rename = true;               ///< translate the names of other programs to ours where they are unambiguous
  bool decode = true;               ///< integers of pictures are sRGB; else they come as the fractions that are stored
  std::int64_t max_values = std::int64_t(1) << 32;  ///< largest number of pixels x channels that is accepted
};

/// Reads an EXR with any number of layers and parts, scan lines or tiles (the first view of a stereo file wins), or a
/// picture in another format as its `color` layer (8- and 16-bit integers are decoded from sRGB to linear).
/// Shapes:  the display window; pixels outside of the data window are 0.
/// Errors:  Error{kMissingFile}; Error{kBadInput} for what is no image, is damaged, truncated or too large;
///          Error{kUnsupported} for deep images; Error{kUnknownName} for a layer asked for that the file lacks.
Frame read_frame(const std::string& path, const ReadOptions& options = {});

/// The header of a frame file: size and metadata, layers without their pixels. Costs no decoding.
struct FrameHeader {
  int width = 0, height = 0;
  std::vector<LayerDesc> layers;
  Metadata metadata;
};
/// Errors: as read_frame.
FrameHeader read_header(const std::string& path, const ReadOptions& options = {});
/// Metadata alone. Errors: as read_frame.
Metadata read_metadata(const std::string& path);
/// Identity of the content of a frame file: the fingerprint in it, else its size and when it was written.
/// Errors: as read_frame.
std::string content_identity(const std::string& path);

}  // namespace tempera
