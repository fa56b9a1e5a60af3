// SPDX-License-Identifier: Apache-2.0
#pragma once
// Movies and contact sheets from frames. Movies are encoded by the program `ffmpeg`, which gets the pictures through a
// pipe.
#include <functional>
#include <memory>
#include <string>

#include "tempera/frames/display.h"
#include "tempera/frames/image.h"
#include "tempera/frames/sequence.h"

namespace tempera {

struct VideoOptions {
  double fps = 24;
  /// "auto" (h264 for .mp4, .mov and .mkv, vp9 for .webm), "h264", "hevc", "vp9", "av1", or "ffv1" (lossless, .mkv).
  std::string codec = "auto";
  int crf = 18;  ///< quality of h264, hevc, vp9 and av1: 0 (best) to 51
  DisplayOptions display;
  std::string layer = "color";    ///< layer of the frames to show
  std::string ffmpeg = "ffmpeg";  ///< program, looked up in PATH
  std::string comment;            ///< text that the file carries as its comment; empty: none
};

/// Refuses what VideoWriter would refuse before it got a picture. Errors: its Error{kUsage | kOutOfRange}.
void check_video(const std::string& path, const VideoOptions& options);

/// Writes one movie, picture by picture. The file appears under its name when `finish` returns; without it nothing
/// stays. Errors, of all members: Error{kMissingFile} if ffmpeg is not installed, Error{kUsage} for a file name that
/// does not end in .mp4, .mov, .mkv or .webm, or a codec that the file cannot hold; Error{kFailed} with ffmpeg's own
/// words; Error{kBadInput} for a picture of another size.
class VideoWriter {
 public:
  VideoWriter(const std::string& path, int width, int height, const VideoOptions& options = {});
  ~VideoWriter();
  VideoWriter(VideoWriter&&) noexcept;
  VideoWriter& operator=(VideoWriter&&) noexcept;
  /// Adds a picture of scene-linear values. Odd sizes are extended by repeating the last column or row, as the usual
  /// color subsampling needs even ones.
  void add(const Image& image);
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Whether the file `path` exists and holds `comment` as VideoOptions::comment wrote it. Reads all of the file, but
/// decodes nothing. Pre: `comment` is not empty. Errors: as read_file.
bool video_has_comment(const std::string& path, const std::string& comment);

/// Called after each picture with how many of all are done. Throw Error{kCancelled} from it to stop.
using VideoProgress = std::function<void(int done, int total)>;

/// Makes a movie of the frames of a sequence in steps of its smallest distance; a frame that is missing in the middle
/// repeats the one before it, with one warning that lists them. Returns the number of pictures.
/// Errors: as VideoWriter and read_frame; Error{kBadInput} when more than 100000 frames are missing.
int write_video(const FrameSequence& frames, const std::string& path, const VideoOptions& options = {},
                const VideoProgress& progress = {});

struct ContactSheetOptions {
  int columns = 0;      ///< 0: as makes the sheet about 16:9
  int width = 320;      ///< of one picture, in pixels
  int max_frames = 48;  ///< more are thinned out evenly
  DisplayOptions display;
  std::string layer = "color";
};
/// Writes a PNG with small pictures of the frames in rows, each with its frame number. Errors: as read_frame,
/// write_png.
void write_contact_sheet(const FrameSequence& frames, const std::string& path, const ContactSheetOptions& options = {});

}  // namespace tempera
