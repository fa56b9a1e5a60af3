// SPDX-License-Identifier: Apache-2.0
#pragma once
// Numbered files on disk: which frames of a sequence exist, and what they are called.
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace tempera {

/// The frames that exist for a pattern, a directory or a single file at the time of construction.
class FrameSequence {
 public:
  FrameSequence() = default;
  /// `pattern`: "f.####.exr", "f.%04d.exr", "f.$F4.exr"; a directory that holds one sequence; a file, which is a
  /// sequence of one frame with the last number in its name (0 when there is none); or "f.exr" where f.<number>.exr
  /// exist, as programs write that add the number on their own.
  /// Errors: Error{kMissingFile} if there is no such file, directory or frame; Error{kBadInput} for a directory with
  /// several sequences, naming them.
  explicit FrameSequence(const std::string& pattern);

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

/// Frame numbers for which a file of `pattern` (with a frame token) exists; empty when none does.
std::vector<int> existing_frames(const std::string& pattern);

}  // namespace tempera
