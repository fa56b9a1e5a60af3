// SPDX-License-Identifier: Apache-2.0
#include "input_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <fstream>

#include "tempera/import/paths.h"

namespace tempera {

std::string_view skip_byte_order_mark(std::string_view text) {
  return text.starts_with("\xEF\xBB\xBF") ? text.substr(3) : text;
}

std::uint64_t hash_bytes(std::string_view bytes, std::uint64_t seed) {
  constexpr std::uint64_t kPrime = 0x100000001b3u;
  std::uint64_t h = seed;
  std::size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    std::uint64_t word;
    std::memcpy(&word, bytes.data() + i, 8);
    h = (h ^ word) * kPrime;
    h ^= h >> 32;  // a multiplication alone never carries high bits of a word down
  }
  for (; i < bytes.size(); ++i) h = (h ^ std::uint8_t(bytes[i])) * kPrime;
  return (h ^ bytes.size()) * kPrime;
}

InputFiles::InputFiles(const std::filesystem::path& scene_file, const ImportOptions& options)
    : limit_(options.memory_limit) {
  if (options.sandbox) {
    std::error_code failed;
    root_ = std::filesystem::weakly_canonical(std::filesystem::absolute(scene_file, failed).parent_path(), failed);
  }
}

void InputFiles::check(const std::filesystem::path& file, const SourceLoc& loc) const {
  std::error_code failed;
  if (!root_.empty()) {  // before looking at the file: whether it exists is not to be found out either
    const std::filesystem::path real =
        std::filesystem::weakly_canonical(std::filesystem::absolute(file, failed), failed);
    if (failed || std::mismatch(root_.begin(), root_.end(), real.begin(), real.end()).first != root_.end())
      throw Error(ErrorCode::kBadInput, loc,
                  fmt::format("\"{}\" lies outside the scene's folder, which --sandbox forbids", file.string()));
  }
  const std::filesystem::file_status status = std::filesystem::status(file, failed);
  if (!std::filesystem::exists(status)) throw Error(ErrorCode::kMissingFile, loc, cannot_find(file));
  if (!std::filesystem::is_regular_file(status))
    throw Error(ErrorCode::kBadInput, loc, fmt::format("\"{}\" is not a regular file", file.string()));
}

FileContents InputFiles::read(const std::filesystem::path& file, const SourceLoc& loc) {
  check(file, loc);
  std::ifstream in(file, std::ios::binary);
  std::error_code failed;
  const std::uint64_t size = std::filesystem::file_size(file, failed);
  if (!in || failed)
    throw Error(ErrorCode::kMissingFile, loc, fmt::format("cannot open \"{}\" for reading", file.string()));
  if (limit_ != 0 && size > limit_)
    throw Error(ErrorCode::kOutOfMemory, loc,
                fmt::format("\"{}\" has {} bytes, beyond the memory limit of {}", file.string(), size, limit_));
  std::unique_ptr<char[]> bytes(new char[size]);  // not zeroed
  in.read(bytes.get(), std::streamsize(size));
  if (std::uint64_t(in.gcount()) != size)
    throw Error(ErrorCode::kMissingFile, loc, fmt::format("cannot read all of \"{}\"", file.string()));
  FileContents contents(std::move(bytes), size);
  const std::uint64_t h = hash_bytes(contents.view());
  const std::lock_guard lock(mutex_);
  hashes_[file.lexically_normal()] = h;
  return contents;
}

void InputFiles::note(const std::filesystem::path& file, const SourceLoc& loc) {
  check(file, loc);
  {
    const std::lock_guard lock(mutex_);
    if (hashes_.contains(file.lexically_normal())) return;
  }
  std::ifstream in(file, std::ios::binary);
  if (!in) throw Error(ErrorCode::kMissingFile, loc, fmt::format("cannot open \"{}\" for reading", file.string()));
  std::string block(1 << 20, '\0');
  std::uint64_t h = hash_bytes({});
  while (in.read(block.data(), std::streamsize(block.size())), in.gcount() > 0)
    h = hash_bytes(std::string_view(block).substr(0, in.gcount()), h);
  const std::lock_guard lock(mutex_);
  hashes_[file.lexically_normal()] = h;
}

void InputFiles::charge(std::uint64_t bytes, const SourceLoc& loc) {
  const std::lock_guard lock(mutex_);
  charged_ += bytes;
  if (limit_ != 0 && charged_ > limit_)
    throw Error(ErrorCode::kOutOfMemory, loc,
                fmt::format("the scene needs more than {} bytes, beyond the memory limit of {}", charged_, limit_));
}

std::uint64_t InputFiles::hash() const {
  // Sums commute: readers may come in any order. The folder is left out, so that a moved scene keeps its hash.
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = 0;
  for (const auto& [file, h] : hashes_) sum += hash_bytes(file.filename().string(), h);
  return sum;
}

}  // namespace tempera
