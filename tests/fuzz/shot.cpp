// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/shot.h"

#include "entries.h"

namespace tempera::fuzz {

void shot(std::string_view input) {
  expect_bad_input_only([&] {
    ShotConfig config;
    config.read_text(input, "shot.toml", work_folder());
    Warnings warnings;
    ImportOptions options;
    options.sandbox = true;
    options.memory_limit = kMemoryLimit;
    const LoadedShot loaded = load_shot(config, options, warnings);
    warnings.report();
    if (!loaded.shot.frames.empty()) (void)fingerprint(loaded.shot, loaded.scene, loaded.shot.frames.front());
    exercise(loaded.scene, input);
  });
}

}  // namespace tempera::fuzz
