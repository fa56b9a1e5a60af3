// SPDX-License-Identifier: Apache-2.0
#pragma once
// Memory limits of the process, and estimates of what a render takes before it takes it.
#include <cstdint>
#include <string_view>

#include "tempera/pipeline/shot.h"

namespace tempera {

/// "8G", "512M", "1.5GiB", "64K" or bytes; units are powers of 1024. Errors: Error{kUsage}.
std::uint64_t parse_memory_size(std::string_view text);

/// Bytes that this process can hope for: of the machine, or of its control group where that is less.
std::uint64_t machine_memory();

/// Makes allocations beyond `bytes` fail from here on (RLIMIT_DATA).
/// Errors: Error{kFailed} if the system refuses.
void limit_memory(std::uint64_t bytes);

/// Bytes that the geometry of a scene holds, without textures.
std::uint64_t scene_memory(const Scene& scene);

/// Bytes that rendering takes beside the scene, estimated from counts: ray tracing structures of the frame, moving
/// vertices, and the frames in flight. Textures, which have a cache of bounded size, are not in it.
std::uint64_t estimate_render_memory(const Shot& shot, const Scene& scene);

/// Refuses a render that cannot fit before it starts. `limit` 0: that of the machine.
/// Errors: Error{kOutOfMemory} with the estimate and the largest part.
void check_memory(const Shot& shot, const Scene& scene, std::uint64_t limit);

}  // namespace tempera
