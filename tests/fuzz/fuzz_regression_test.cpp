// SPDX-License-Identifier: Apache-2.0
// Replays the seeds of all fuzz targets and every input that once crashed one.
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <string>
#include <utility>

#include "entries.h"

namespace tempera::fuzz {
namespace {

using Entry = std::pair<const char*, void (*)(std::string_view)>;

class FuzzRegression : public testing::TestWithParam<Entry> {};

TEST_P(FuzzRegression, SeedsAndOldCrashesEndWell) {
  const auto [name, run] = GetParam();
  int count = 0;
  for (const char* kind : {"seeds", "crashes"}) {
    const std::filesystem::path folder = std::filesystem::path(TEMPERA_SOURCE_DIR) / "tests/fuzz" / kind / name;
    if (!std::filesystem::is_directory(folder)) continue;
    for (const auto& file : std::filesystem::directory_iterator(folder)) {
      SCOPED_TRACE(file.path().string());
      std::ifstream in(file.path(), std::ios::binary);
      const std::string input{std::istreambuf_iterator<char>(in), {}};
      run(input);
      ++count;
    }
  }
  EXPECT_GT(count, 0) << "there are no inputs for " << name;
}

INSTANTIATE_TEST_SUITE_P(, FuzzRegression,
                         testing::Values(Entry{"lpe", lpe}, Entry{"obj", obj}, Entry{"ply", ply},
                                         Entry{"serialized", serialized}, Entry{"gltf", gltf}, Entry{"glb", glb},
                                         Entry{"mitsuba", mitsuba}, Entry{"shot", shot}),
                         [](const auto& tested) { return std::string(tested.param.first); });

}  // namespace
}  // namespace tempera::fuzz
