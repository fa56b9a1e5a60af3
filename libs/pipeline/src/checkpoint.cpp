// SPDX-License-Identifier: Apache-2.0
#include "checkpoint.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstring>
#include <fstream>

#include "hash.h"
#include "tempera/frames/files.h"

namespace tempera {

namespace {

constexpr std::string_view kMagic = "tempera checkpoint 3\n";

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
  std::uint64_t hash = 0;
  ByteWriter out([&](const void* data, std::size_t n) {
    hash = hash_bytes({static_cast<const char*>(data), n}, hash);
    stream.write(static_cast<const char*>(data), std::streamsize(n));
  });
  out.bytes(kMagic.data(), kMagic.size());
  record.save(out);
  section.save(out);
  const std::uint64_t all = hash;
  out.value(all);
  stream.close();
  if (!stream) throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}", path, std::strerror(errno)));
  file.commit();
}

void read_checkpoint(const std::string& path,
                     const std::function<void(const SectionRecord&, ByteReader& section)>& use) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw Error(ErrorCode::kMissingFile, {path}, "cannot be opened");
  const auto damaged = [&] { return Error(ErrorCode::kBadInput, {path}, "it is damaged"); };
  std::uint64_t hash = 0;
  ByteReader in([&](void* data, std::size_t n) {
    if (!stream.read(static_cast<char*>(data), std::streamsize(n))) return false;
    hash = hash_bytes({static_cast<const char*>(data), n}, hash);
    return true;
  });
  std::string magic(kMagic.size(), ' ');
  try {
    in.bytes(magic.data(), magic.size());
    if (magic != kMagic) throw damaged();
    SectionRecord record;
    record.load(in);
    use(record, in);
    const std::uint64_t expected = hash;
    if (in.value<std::uint64_t>() != expected) throw damaged();
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
