// SPDX-License-Identifier: Apache-2.0
#include "program.h"

namespace tempera {

void add_run(Program& program) {
  auto flags = std::make_shared<RenderFlags>();
  CLI::App* command = program.add(
      "run", "Do all that a shot describes: render its frames, then make its movie.",
      {"tempera run shot.toml --resume", "tempera run shot.toml --set video.path=out/shot.mp4"}, [&program, flags] {
        const Shot shot = render_shot(program, *flags);
        if (!shot.video_path.empty() && flags->replay.empty()) {
          make_movie(program, shot.output, shot.video_path, shot.video);
        }
        return 0;
      });
  flags->add_to(*command);
}

}  // namespace tempera
