// SPDX-License-Identifier: Apache-2.0
#pragma once
// Positions of a mesh's vertices at sample times, in a file that is mapped rather than read: only the samples that a
// frame needs come into memory.
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/core/vec.h"

namespace tempera {

/// Known files: PC2 (3ds Max, Blender), MDD (LightWave, Blender), or floats alone.
enum class CacheFormat { kPc2, kMdd, kRaw };

struct VertexCacheOptions {
  CacheFormat format = CacheFormat::kPc2;
  /// kRaw: vertices of a sample, and bytes before the first; [samples][vertices][3] little-endian floats follow to the
  /// end of the file. The others say so themselves.
  std::size_t vertices = 0;
  std::size_t offset = 0;
};

/// Threads: const and re-entrant.
class VertexCache {
 public:
  /// Maps a file. Errors at `loc`: Error{kMissingFile}; Error{kBadInput} for what is not of the format, is shorter or
  /// longer than its header says, or holds a position that is not finite (sample and vertex are named).
  static std::shared_ptr<VertexCache> open(const std::filesystem::path& file, const VertexCacheOptions& options,
                                           const SourceLoc& loc = {});
  /// From memory: positions of sample 0, then of sample 1, ... Pre: finite, as many as times x vertices.
  VertexCache(std::vector<double> times, std::size_t vertices, std::vector<Vec3f> positions);
  ~VertexCache();
  VertexCache(const VertexCache&) = delete;
  VertexCache& operator=(const VertexCache&) = delete;

  std::size_t vertices() const { return vertices_; }
  std::size_t samples() const { return samples_; }
  /// When the samples are, as set_times has it: at first by the file (PC2: start and rate, in frames; MDD: seconds;
  /// else 0, 1, 2, ...).
  const std::vector<double>& times() const { return times_; }
  /// Pre: strictly increasing, one for each sample.
  void set_times(std::vector<double> times);
  /// Of everything in the file, for fingerprints.
  std::uint64_t content_hash() const { return content_hash_; }

  Vec3f position(std::size_t sample, std::size_t vertex) const {
    std::uint32_t words[3];
    std::memcpy(words, data_ + (sample * vertices_ + vertex) * sizeof(words), sizeof(words));
    if (swap_) {
      for (std::uint32_t& w : words) w = __builtin_bswap32(w);
    }
    return {std::bit_cast<float>(words[0]), std::bit_cast<float>(words[1]), std::bit_cast<float>(words[2])};
  }

 private:
  VertexCache() = default;
  void check(const SourceLoc& loc, const std::string& name);

  const std::byte* data_ = nullptr;  ///< position of vertex 0 of sample 0
  bool swap_ = false;                ///< the other byte order
  std::size_t vertices_ = 0, samples_ = 0;
  std::vector<double> times_;
  std::uint64_t content_hash_ = 0;
  void* mapping_ = nullptr;
  std::size_t mapping_size_ = 0;
  std::vector<Vec3f> own_;
};

}  // namespace tempera
