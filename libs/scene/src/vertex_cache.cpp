// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/vertex_cache.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cmath>
#include <limits>
#include <numeric>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {

namespace {

constexpr std::size_t kVertexBytes = 3 * sizeof(float);
constexpr std::size_t kBlock = 4 << 20;  // bytes, of whole pages

template <class T>
T load(const std::byte* at, bool swap) {
  std::uint32_t word;
  std::memcpy(&word, at, sizeof(word));
  return std::bit_cast<T>(swap ? __builtin_bswap32(word) : word);
}

}  // namespace

VertexCache::VertexCache(std::vector<double> times, std::size_t vertices, std::vector<Vec3f> positions)
    : data_(reinterpret_cast<const std::byte*>(positions.data())),
      vertices_(vertices),
      samples_(times.size()),
      times_(std::move(times)),
      own_(std::move(positions)) {
  static_assert(sizeof(Vec3f) == kVertexBytes);
  TEMPERA_ASSERT(own_.size() == samples_ * vertices_);
}

VertexCache::~VertexCache() {
  if (mapping_) ::munmap(mapping_, mapping_size_);
}

void VertexCache::set_times(std::vector<double> times) {
  TEMPERA_ASSERT(times.size() == samples_);
  times_ = std::move(times);
}

std::shared_ptr<VertexCache> VertexCache::open(const std::filesystem::path& file, const VertexCacheOptions& options,
                                               const SourceLoc& loc) {
  const std::string name = file.string();
  const auto bad = [&](const std::string& why) {
    return Error(ErrorCode::kBadInput, loc, fmt::format("the vertex cache {} {}", name, why));
  };
  const int fd = ::open(name.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0 && errno == ENOENT) {
    throw Error(ErrorCode::kMissingFile, loc, fmt::format("there is no vertex cache {}", name));
  }
  if (fd < 0) throw bad(fmt::format("cannot be read: {}", std::strerror(errno)));
  struct ::stat status {};
  const bool regular = ::fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
  const std::size_t size = regular ? status.st_size : 0;
  void* mapping = size > 0 ? ::mmap(nullptr, size, PROT_READ, MAP_SHARED, fd, 0) : MAP_FAILED;
  const int error = errno;
  ::close(fd);
  if (!regular) throw bad("is not a file");
  if (size == 0) throw bad("is empty");
  if (mapping == MAP_FAILED) throw bad(fmt::format("cannot be mapped: {}", std::strerror(error)));

  std::shared_ptr<VertexCache> cache(new VertexCache);
  cache->mapping_ = mapping, cache->mapping_size_ = size;
  const auto* bytes = static_cast<const std::byte*>(mapping);
  constexpr bool kLittle = std::endian::native == std::endian::little;
  cache->swap_ = (options.format == CacheFormat::kMdd) == kLittle;

  // Counts are below 2^32, so that their product with 12 fits into 128 bits; a file is never that large.
  std::uint64_t header = options.offset, vertices = options.vertices, samples = 0;
  if (options.format == CacheFormat::kPc2) {
    header = 32;
    if (size < header || std::memcmp(bytes, "POINTCACHE2", 12) != 0) throw bad("is not a PC2 file");
    const auto version = load<std::int32_t>(bytes + 12, cache->swap_);
    const auto points = load<std::int32_t>(bytes + 16, cache->swap_),
               frames = load<std::int32_t>(bytes + 28, cache->swap_);
    if (version != 1) throw bad(fmt::format("is a PC2 file of version {}; known: 1", version));
    if (points <= 0 || frames <= 0) throw bad(fmt::format("has {} vertices and {} samples", points, frames));
    vertices = std::uint64_t(points), samples = std::uint64_t(frames);
  } else if (options.format == CacheFormat::kMdd) {
    if (size < 8) throw bad("is not an MDD file");
    const auto frames = load<std::int32_t>(bytes, cache->swap_), points = load<std::int32_t>(bytes + 4, cache->swap_);
    if (points <= 0 || frames <= 0) throw bad(fmt::format("has {} vertices and {} samples", points, frames));
    vertices = std::uint64_t(points), samples = std::uint64_t(frames);
    header = 8 + 4 * samples;
  } else {
    if (vertices == 0 || vertices > std::numeric_limits<std::uint32_t>::max()) throw bad("cannot hold 0 vertices");
    const std::uint64_t sample = vertices * kVertexBytes;
    if (size <= header || (size - header) % sample != 0) {
      throw bad(
          fmt::format("has {} bytes after the first {}, which is no multiple of the {} of a sample of {} vertices",
                      size - std::min<std::uint64_t>(size, header), header, sample, vertices));
    }
    samples = (size - header) / sample;
  }
  if (const auto needed = static_cast<unsigned __int128>(vertices) * samples * kVertexBytes + header; needed != size) {
    throw bad(fmt::format("has {} bytes, {} than {} samples of {} vertices need", size,
                          needed > size ? "fewer" : "more", samples, vertices));
  }
  cache->data_ = bytes + header;
  cache->vertices_ = vertices, cache->samples_ = samples;
  cache->times_.resize(samples);
  for (std::size_t i = 0; i < samples; ++i) {
    cache->times_[i] =
        options.format == CacheFormat::kPc2
            ? double(load<float>(bytes + 20, cache->swap_)) + double(i) * double(load<float>(bytes + 24, cache->swap_))
        : options.format == CacheFormat::kMdd ? double(load<float>(bytes + 8 + 4 * i, cache->swap_))
                                              : double(i);
  }
  cache->check(loc, name);
  return cache;
}

/// Reads everything once, block by block: for the hash, and for numbers that are none. Pages are given back at once.
void VertexCache::check(const SourceLoc& loc, const std::string& name) {
  const auto* bytes = static_cast<const std::byte*>(mapping_);
  const std::size_t blocks = (mapping_size_ + kBlock - 1) / kBlock;
  std::vector<std::uint64_t> hashes(blocks);
  std::atomic<std::size_t> first_bad{std::numeric_limits<std::size_t>::max()};  // float of data_
  const std::size_t header = data_ - bytes;
  parallel_for(0, std::int64_t(blocks), [&](std::int64_t block) {
    const std::size_t begin = block * kBlock, end = std::min(begin + kBlock, mapping_size_);
    std::uint64_t h = hash_key(end - begin, 0);
    for (std::size_t at = begin; at < end; at += 8) {
      std::uint64_t word = 0;
      std::memcpy(&word, bytes + at, std::min<std::size_t>(8, end - at));
      h = (h ^ word) * 0x9e3779b97f4a7c15ull;
      h ^= h >> 32;
    }
    hashes[block] = mix64(h);
    // Floats that begin in this block, though the last may end in the next.
    const std::size_t first = begin <= header ? 0 : (begin - header + 3) / 4;
    const std::size_t last = end <= header ? 0 : (end - header + 3) / 4;
    for (std::size_t i = first; i < std::min(last, samples_ * vertices_ * 3); ++i) {
      if (std::isfinite(load<float>(data_ + 4 * i, swap_))) continue;
      std::size_t before = first_bad;
      while (i < before && !first_bad.compare_exchange_weak(before, i)) {
      }
      break;
    }
    ::madvise(static_cast<std::byte*>(mapping_) + begin, end - begin, MADV_DONTNEED);
  });
  if (const std::size_t i = first_bad; i != std::numeric_limits<std::size_t>::max()) {
    throw Error(ErrorCode::kBadInput, loc,
                fmt::format("the vertex cache {} has a position that is not finite: vertex {} of sample {}", name,
                            i / 3 % vertices_, i / 3 / vertices_));
  }
  content_hash_ = std::accumulate(hashes.begin(), hashes.end(), hash_key(mapping_size_, 1),
                                  [](std::uint64_t h, std::uint64_t block) { return hash_key(h, block); });
}

}  // namespace tempera
