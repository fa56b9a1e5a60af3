// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/video.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/sequence.h"

namespace tempera {

void make_movie(const Program& program, const FrameSequence& frames, const std::string& path,
                const VideoOptions& options) {
  const bool terminal = isatty(STDERR_FILENO) && program.verbosity >= 0;
  const int pictures = write_video(frames, path, options, [&](int done, int total) {
    if (terminal) std::fprintf(stderr, "\r\033[Kpicture %d of %d", done, total);
    if (program.stop.stop_requested()) throw Error(ErrorCode::kCancelled, "stopped; no movie was written");
  });
  if (terminal) std::fprintf(stderr, "\r\033[K");
  log_info(fmt::format("{}: {} pictures at {:g} frames per second", path, pictures, options.fps));
}

void add_video(Program& program) {
  struct Flags {
    std::string in, out, tone_map = "srgb", contact_sheet;
    VideoOptions options;
  };
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      program.add("video", "Make a movie of a sequence of frames (with ffmpeg).",
                  {"tempera video out/frame.####.exr movie.mp4",
                   "tempera video out/ movie.mp4 --fps 30 --exposure 1 --tone-map filmic",
                   "tempera video out/frame.####.exr normals.mp4 --layer normal --tone-map none"},
                  [&program, flags] {
                    flags->options.display.tone_map = parse_tone_map(flags->tone_map);
                    if (!flags->contact_sheet.empty() && !has_extension(flags->contact_sheet, ".png")) {
                      throw Error(ErrorCode::kUsage, ShotConfig::kCommandLine(),
                                  fmt::format("--contact-sheet \"{}\" must end in .png", flags->contact_sheet));
                    }
                    const FrameSequence frames(flags->in);
                    with_threads(0, [&] { make_movie(program, frames, flags->out, flags->options); });
                    if (!flags->contact_sheet.empty()) {
                      write_contact_sheet(frames, flags->contact_sheet,
                                          {.display = flags->options.display, .layer = flags->options.layer});
                    }
                    return 0;
                  });
  command->add_option("in", flags->in, "pattern, folder or single file")->required()->type_name("IN");
  command->add_option("out", flags->out, "file to write: .mp4, .mov, .mkv or .webm")->required()->type_name("OUT");
  command->add_option("--fps", flags->options.fps, "frames per second [24]")
      ->type_name("N")
      ->check(CLI::Range(1e-3, 1e6).description(""));
  command->add_option("--layer", flags->options.layer, "layer to show [color]")->type_name("NAME");
  command->add_option("--exposure", flags->options.display.exposure, "stops: values are multiplied by 2^exposure [0]")
      ->type_name("STOPS");
  command->add_option("--tone-map", flags->tone_map, "srgb, filmic or none [srgb]")
      ->type_name("NAME")
      ->check(CLI::IsMember({"srgb", "filmic", "none"}).description(""));
  command->add_option("--codec", flags->options.codec, "auto, h264, hevc, vp9, av1 or ffv1 [auto]")->type_name("NAME");
  command->add_option("--contact-sheet", flags->contact_sheet, "also write a PNG with small pictures of the frames")
      ->type_name("FILE");
  command->add_option("--crf", flags->options.crf, "quality: 0 (best) to 51 [18]")
      ->type_name("N")
      ->check(CLI::Range(0, 51).description(""));
}

}  // namespace tempera
