// SPDX-License-Identifier: Apache-2.0
#include "checkpoint.h"

#include <fmt/format.h>

#include <cctype>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "hash.h"
#include "tempera/frames/files.h"

namespace tempera {

namespace {

constexpr std::string_view kKind = "tempera checkpoint ", kVersion = "3\n";  // a file begins with both

/// A hash of bytes that come in pieces, whatever the pieces are.
class RunningHash {
 public:
  void add(const void* data, std::size_t n) {
    const auto* bytes = static_cast<const char*>(data);
    for (; n > 0 && filled_ > 0; --n) add_byte(*bytes++);
    for (; n >= sizeof word_; n -= sizeof word_, bytes += sizeof word_) {
      std::memcpy(&word_, bytes, sizeof word_);
      hash_ = hash_key(hash_, word_);
    }
    for (; n > 0; --n) add_byte(*bytes++);
  }
  std::uint64_t value() const { return hash_key(hash_, filled_ > 0 ? word_ : 0, filled_); }

 private:
  void add_byte(char c) {
    if (filled_ == 0) word_ = 0;
    std::memcpy(reinterpret_cast<char*>(&word_) + filled_, &c, 1);
    if (++filled_ < sizeof word_) return;
    hash_ = hash_key(hash_, word_);
    filled_ = 0;
  }
  std::uint64_t hash_ = 0, word_ = 0;
  std::size_t filled_ = 0;
};

/// Whether the file begins as checkpoints of all versions do, with the number of another one.
bool is_of_another_version(std::ifstream& stream) {
  std::string begin(kKind.size() + kVersion.size(), ' ');
  const bool read = bool(stream.read(begin.data(), std::streamsize(begin.size())));
  stream.clear();
  stream.seekg(0);
  return read && begin.starts_with(kKind) && !begin.ends_with(kVersion) &&
         std::isdigit(static_cast<unsigned char>(begin[kKind.size()]));
}

/// Whether the file ends with the hash of what it holds before that.
bool is_whole(std::ifstream& stream) {
  stream.seekg(0, std::ios::end);
  auto left = std::int64_t(stream.tellg()) - std::int64_t(sizeof(std::uint64_t));
  stream.seekg(0);
  RunningHash hash;
  std::vector<char> block(1 << 20);
  while (left > 0) {
    const std::size_t n = std::min(left, std::int64_t(block.size()));
    if (!stream.read(block.data(), std::streamsize(n))) return false;
    hash.add(block.data(), n);
    left -= std::int64_t(n);
  }
  std::uint64_t stored = 0;
  const bool whole =
      left == 0 && stream.read(reinterpret_cast<char*>(&stored), sizeof stored) && stored == hash.value();
  stream.seekg(0);
  return whole;
}

}  // namespace

std::string checkpoint_path(const std::string& frame_file) { return frame_file + ".partial"; }

std::string part_path(const std::string& frame_file, const Part& part) {
  return fmt::format("{}.part{}of{}", frame_file, part.index + 1, part.count);
}

void SectionRecord::save(ByteWriter& out) const {
  out.text(fingerprint);
  out.text(method);
  out.text(parameters);
  out.value(seconds);
  out.value(std::uint64_t(frames.size()));
  for (const FrameRecord& f : frames) {
    out.text(f.file);
    save_metadata(f.metadata, out);
  }
  out.value(write.compression), out.value(write.half), out.value(write.names);
  out.text(write.view_layer);
}

void SectionRecord::load(ByteReader& in) {
  fingerprint = in.text();
  method = in.text();
  parameters = in.text();
  in.value(seconds);
  for (auto n = in.value<std::uint64_t>(); n > 0; --n) {
    FrameRecord& f = frames.emplace_back();
    f.file = in.text();
    read_metadata(f.metadata, in);
  }
  in.value(write.compression), in.value(write.half), in.value(write.names);
  write.view_layer = in.text();
}

void finish_metadata(Frame& picture, const Metadata& metadata, double seconds) {
  for (const auto& [key, value] : metadata) picture.metadata[key] = value;
  picture.metadata["tempera/render_seconds"] = seconds;
}

void save_checkpoint(const std::string& path, const SectionRecord& record, const Section& section) {
  TemporaryFile file(path);
  std::ofstream stream(file.path(), std::ios::binary);
  RunningHash hash;
  ByteWriter out([&](const void* data, std::size_t n) {
    hash.add(data, n);
    stream.write(static_cast<const char*>(data), std::streamsize(n));
  });
  out.bytes(kKind.data(), kKind.size()), out.bytes(kVersion.data(), kVersion.size());
  record.save(out);
  section.save(out);
  out.value(hash.value());
  stream.close();
  if (!stream) throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path, std::strerror(errno)));
  file.commit();
}

void read_checkpoint(const std::string& path,
                     const std::function<void(const SectionRecord&, ByteReader& section)>& use) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw Error(ErrorCode::kMissingFile, {path}, "cannot be opened");
  const auto damaged = [&] { return Error(ErrorCode::kBadInput, {path}, "it is damaged"); };
  if (is_of_another_version(stream)) {  // first: it may end in another way
    throw Error(ErrorCode::kBadInput, {path},
                fmt::format("it is of another version of tempera than {}", TEMPERA_VERSION));
  }
  if (!is_whole(stream)) throw damaged();
  ByteReader in(
      [&](void* data, std::size_t n) { return bool(stream.read(static_cast<char*>(data), std::streamsize(n))); });
  std::string magic(kKind.size() + kVersion.size(), ' ');
  try {
    in.bytes(magic.data(), magic.size());
    if (!magic.starts_with(kKind) || !magic.ends_with(kVersion)) throw damaged();
    SectionRecord record;
    record.load(in);
    use(record, in);
  } catch (const Error& e) {
    if (!e.loc().file.empty()) throw;
    throw Error(e.code(), {path}, e.message());
  }
}

bool load_checkpoint(const std::string& path, SectionRecord& record, Section& section, std::string& why) {
  try {
    read_checkpoint(path, [&](const SectionRecord& saved, ByteReader& in) {
      if (saved.fingerprint != record.fingerprint)
        throw Error(ErrorCode::kBadInput, "it was made with other settings, or of another scene");
      section.load(in);
      record.seconds = saved.seconds;
    });
    return true;
  } catch (const Error& e) {
    why = e.message();
    return false;
  }
}

}  // namespace tempera
