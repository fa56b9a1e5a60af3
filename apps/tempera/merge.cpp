// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <memory>

#include "program.h"
#include "tempera/core/log.h"
#include "tempera/pipeline/render.h"

namespace tempera {

void add_merge(Program& program) {
  struct Flags {
    std::vector<std::string> in;
    std::string out;
  };
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      program.add("merge", "Add up parts of frames that several machines rendered.",
                  {"tempera render shot.toml --part 1/2 -o a/f.####.exr   (and 2/2 to b/, on another machine)",
                   "tempera merge a b -o out   (the same bits as one run)"},
                  [flags] {
                    const std::size_t n = merge_parts(flags->in, flags->out);
                    log_info(fmt::format("{} {} to {}", n, n == 1 ? "frame" : "frames", flags->out));
                    return 0;
                  });
  command->add_option("in", flags->in, "folders with files of `tempera render --part`, or such files")
      ->required()
      ->type_name("IN");
  command->add_option("-o,--output", flags->out, "folder of the frames")->required()->type_name("FOLDER");
}

}  // namespace tempera
