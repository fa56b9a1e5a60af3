// SPDX-License-Identifier: Apache-2.0
#pragma once
// What each fuzz target does with one input: everything that a program does with such a file before it renders, and a
// few rays. The libFuzzer programs and the regression test, which replays seeds and old crashes, share these functions.
// A target is called like its folder of seeds.
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

#include "tempera/scene/scene.h"

namespace tempera::fuzz {

/// Does what `target` does: one of the functions below, or reading a scene with the importer of that name, or the one for
/// that extension. Scene files may refer to what lies in files/.
void run(std::string_view target, std::string_view input);

/// Expressions, one a line.
void lpe(std::string_view input);
/// Single mesh files.
void obj(std::string_view input);
void ply(std::string_view input);
void serialized(std::string_view input);
/// Scene files of an importer, with this extension.
void scene(std::string_view extension, std::string_view input);
/// shot.toml, with the scenes that it names in files/.
void shot(std::string_view input);

/// Memory that an importer may take; libFuzzer's own limit is larger.
inline constexpr std::uint64_t kMemoryLimit = std::uint64_t(256) << 20;

/// Runs `body` on one thread. An Error is an expected end if it is one of bad input; anything else that is thrown, or
/// an error without a message, ends the process.
void expect_bad_input_only(const std::function<void()>& body);
/// A folder of this process with the contents of files/.
const std::filesystem::path& work_folder();
/// Writes `input` to `name` in work_folder().
std::filesystem::path write_input(const std::string& name, std::string_view input);
/// Uses the scene that came of `input` as a renderer would: cameras, poses, a RayScene, materials and lights where rays
/// arrive. Fuzz programs do so for every fourth input, since it takes longer than reading.
void exercise(const Scene& scene, std::string_view input);

}  // namespace tempera::fuzz
