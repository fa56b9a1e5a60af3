// SPDX-License-Identifier: Apache-2.0
#pragma once
// A section in progress on disk: the finished units with all that they left, and what is needed to finish it without
// its scene. Written whole or not at all; a damaged, foreign or outdated file is refused with the reason.
#include <functional>
#include <string>
#include <vector>

#include "tempera/frames/frame.h"
#include "tempera/methods/section.h"

namespace tempera {

/// Names of the checkpoint, and of the file that holds a part, of a section whose first file is `frame_file`.
std::string checkpoint_path(const std::string& frame_file);
std::string part_path(const std::string& frame_file, const Part& part);

struct FrameRecord {
  std::string file;  ///< its name, without folders
  Metadata metadata;
};

/// What makes files of a section that is done.
struct SectionRecord {
  std::string fingerprint;  ///< of everything that affects the pixels of its frames
  std::string method, parameters;
  double seconds = 0;  ///< spent on it so far
  std::vector<FrameRecord> frames;
  WriteOptions write;

  void save(ByteWriter& out) const;
  void load(ByteReader& in);
};

/// Gives a finished picture its metadata, and the time that it took.
void finish_metadata(Frame& picture, const Metadata& metadata, double seconds);

/// Errors: Error{kFailed}, as write_file. Threads: beside the units of the section.
void save_checkpoint(const std::string& path, const SectionRecord& record, const Section& section);

/// Calls `use` with the record and where the section follows, if the file is whole.
/// Errors: Error{kMissingFile | kBadInput}, with its name.
void read_checkpoint(const std::string& path,
                     const std::function<void(const SectionRecord& record, ByteReader& section)>& use);

/// Loads into a section in which nothing is done, and the seconds that were spent on it. Returns false, with `why` set,
/// if the file does not belong to the section, which is then of no use any more. Pre: the file exists.
bool load_checkpoint(const std::string& path, SectionRecord& record, Section& section, std::string& why);

}  // namespace tempera
