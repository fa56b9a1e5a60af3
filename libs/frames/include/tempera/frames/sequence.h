// SPDX-License-Identifier: Apache-2.0
#pragma once
// Numbered files on disk: which frames of a sequence exist, what they are called, and what they will be called.
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace tempera {

/// The frames that exist for a pattern, a directory or a single file at the time of construction.
class FrameSequence {
 public:
  FrameSequence() = default;
  /// `pattern`: one with a place for the number (see FramePlace); a directory that holds one sequence; a file, which is
  /// a sequence of one frame with the last number in its name (0 when there is none); or "f.exr" where f.<number>.exr
  /// exist, as programs write that add the number on their own.
  /// Errors: Error{kMissingFile} if there is no such file, directory or frame; Error{kBadInput} for a directory with
  /// several sequences, naming them.
  explicit FrameSequence(const std::string& pattern);
  /// What frame_path(pattern, frame) names for `frames`, as far as it exists. A pattern without a place for the number
  /// is the file of the only frame. Errors: Error{kMissingFile} if no frame exists.
  FrameSequence(const std::string& pattern, std::span<const int> frames);

  /// Frame numbers in ascending order.
  const std::vector<int>& frames() const { return frames_; }
  bool has(int frame) const;
  /// Leaves only those of `frames` that exist.
  void keep(std::span<const int> frames);
  /// Path of a frame, whether it exists or not.
  std::string path(int frame) const;
  /// The pattern that `path` fills in, or the name of the single file.
  const std::string& pattern() const { return pattern_; }
  /// Smallest distance between two frames; 1 when there are fewer.
  int step() const;

 private:
  std::string pattern_;
  bool single_ = false;
  std::vector<int> frames_;
};

/// Frame numbers for which a file of `pattern` exists, in ascending order; empty when none does, or without a place for
/// the number.
std::vector<int> existing_frames(const std::string& pattern);

/// "1-24,30 (25 frames)": as parse_frame_set reads them, and their number.
std::string describe_frames(std::span<const int> frames);

/// Whether a path ends in `extension` (".png"), in small or capital letters.
bool has_extension(const std::string& path, std::string_view extension);

/// The pattern of the EXR files that a user means by `path`: the rule of every option that names output frames.
/// A pattern with a place for the number (see FramePlace) stands as it is, and gets ".exr" if it has no extension. A
/// name that ends in .exr is the file itself if `single`, else the number goes before the extension. Anything else is a
/// folder, in which files are called `name`.
/// Errors: Error{kUsage} for the extension of another image or movie format, with the name that would do.
std::string output_pattern(const std::string& path, const std::string& name, bool single);

}  // namespace tempera
