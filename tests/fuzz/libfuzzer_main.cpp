// SPDX-License-Identifier: Apache-2.0
// One fuzz program: the build defines TEMPERA_FUZZ_TARGET as the name of a target.
#include <cstdint>

#include "entries.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  tempera::fuzz::run(TEMPERA_FUZZ_TARGET, {reinterpret_cast<const char*>(data), size});
  return 0;
}

// OpenImageIO 2.4 loses the text of an error when libpng leaves its callback by longjmp: a few bytes for each damaged
// PNG.
extern "C" const char* __lsan_default_suppressions() { return "leak:OpenImageIO*ImageInput::geterror\n"; }
