// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <regex>

#include "checkpoint.h"
#include "tempera/core/log.h"
#include "tempera/pipeline/render.h"

namespace tempera {

namespace {

namespace fs = std::filesystem;

/// The files of parts that `input` names, or that lie in it.
std::vector<std::string> part_files(const std::string& input) {
  static const std::regex kName(R"(.*\.part[0-9]+of[0-9]+)");
  std::error_code failed;
  if (!fs::is_directory(input, failed)) return {input};
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(input)) {
    if (std::regex_match(entry.path().filename().string(), kName)) files.push_back(entry.path().string());
  }
  std::sort(files.begin(), files.end());
  if (files.empty()) {
    throw Error(ErrorCode::kMissingFile, {input},
                "there are no parts here; tempera render --part 1/3 makes files such as f.0001.exr.part1of3");
  }
  return files;
}

struct Merged {
  SectionRecord record;
  std::unique_ptr<Section> section;
  std::string files;  ///< that are in it, for people
};

void write_frames(Merged& merged, const fs::path& output) {
  Section& section = *merged.section;
  const SectionRecord& record = merged.record;
  if (const std::string missing = section.missing(); !missing.empty())
    throw Error(ErrorCode::kBadInput, {merged.files}, "parts are missing: " + missing);
  Params params(find_method(record.method).params);
  std::string_view rest = record.parameters;
  while (!rest.empty()) {
    const std::string_view one = rest.substr(0, rest.find(','));
    rest.remove_prefix(std::min(rest.size(), one.size() + 1));
    params.set_text(std::string(one.substr(0, one.find('='))), std::string(one.substr(one.find('=') + 1)));
  }
  section.finish(*find_method(record.method).make(params));
  if (const std::uint64_t lost = section.lost()) {
    log_warning(fmt::format("{}: {} values were too bright for the range of their layer and are missing",
                            record.frames[0].file, lost));
  }
  const double each = record.seconds / double(record.frames.size());
  for (std::size_t i = 0; i < record.frames.size(); ++i) {
    Frame& picture = section.picture(section.frames()[i]);
    finish_metadata(picture, record.frames[i].metadata, each);
    write_frame((output / record.frames[i].file).string(), picture, record.write);
  }
}

}  // namespace

std::size_t merge_parts(std::span<const std::string> inputs, const std::string& output) {
  std::vector<std::string> files;
  for (const std::string& input : inputs) {
    for (std::string& file : part_files(input)) files.push_back(std::move(file));
  }
  // By the names of the frames: what has them in common is one section, and one is in memory at a time.
  std::map<std::string, std::vector<std::string>> sections;
  for (const std::string& file : files) {
    const std::string name = fs::path(file).filename().string();
    sections[name.substr(0, name.rfind(".part"))].push_back(file);
  }
  std::size_t frames = 0;
  for (const auto& [name, parts] : sections) {
    Merged merged;
    for (const std::string& file : parts) {
      read_checkpoint(file, [&](const SectionRecord& record, ByteReader& in) {
        std::unique_ptr<Section> part = Section::read(in);
        if (!merged.section) {
          merged = {record, std::move(part), file};
          return;
        }
        if (record.fingerprint != merged.record.fingerprint) {
          throw Error(ErrorCode::kBadInput, {file},
                      "this part was rendered with other settings, or of another scene, than " + merged.files);
        }
        merged.section->merge(*part);
        merged.record.seconds += record.seconds;
        merged.files += ", " + file;
      });
    }
    write_frames(merged, output);
    frames += merged.record.frames.size();
  }
  return frames;
}

}  // namespace tempera
