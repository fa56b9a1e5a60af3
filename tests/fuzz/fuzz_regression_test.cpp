// SPDX-License-Identifier: Apache-2.0
// Replays the seeds of all fuzz targets and every input that once crashed one.
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "entries.h"

namespace tempera::fuzz {
namespace {

std::filesystem::path fuzz_folder() { return std::filesystem::path(TEMPERA_SOURCE_DIR) / "tests/fuzz"; }

std::vector<std::string> targets() {
  std::vector<std::string> names;
  for (const auto& folder : std::filesystem::directory_iterator(fuzz_folder() / "seeds"))
    names.push_back(folder.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

class FuzzRegression : public testing::TestWithParam<std::string> {};

TEST_P(FuzzRegression, SeedsAndOldCrashesEndWell) {
  const std::string& name = GetParam();
  int count = 0;
  for (const char* kind : {"seeds", "crashes"}) {
    const std::filesystem::path folder = fuzz_folder() / kind / name;
    if (!std::filesystem::is_directory(folder)) continue;
    for (const auto& file : std::filesystem::directory_iterator(folder)) {
      SCOPED_TRACE(file.path().string());
      std::ifstream in(file.path(), std::ios::binary);
      const std::string input{std::istreambuf_iterator<char>(in), {}};
      run(name, input);
      ++count;
    }
  }
  EXPECT_GT(count, 0) << "there are no inputs for " << name;
}

INSTANTIATE_TEST_SUITE_P(, FuzzRegression, testing::ValuesIn(targets()),
                         [](const auto& tested) { return tested.param; });

}  // namespace
}  // namespace tempera::fuzz
