// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/frames/sequence.h"
#include "tempera/frames/video.h"

namespace tempera {

void add_run(Program& program) {
  auto flags = std::make_shared<RenderFlags>();
  CLI::App* command = program.add(
      "run", "Do all that a shot describes: render its frames, then make its movie.",
      {"tempera run shot.toml --resume", "tempera run shot.toml --set video.path=out/shot.mp4"}, [&program, flags] {
        const Shot shot = render_shot(program, *flags);
        if (!shot.video_path.empty() && flags->replay.empty()) {
          const FrameSequence frames(has_frame_pattern(shot.output) ? shot.output : frame_path(shot.output, 0));
          const int n = write_video(frames, shot.video_path, shot.video);
          log_info(fmt::format("{}: {} pictures", shot.video_path, n));
        }
        return 0;
      });
  flags->add_to(*command);
}

}  // namespace tempera
