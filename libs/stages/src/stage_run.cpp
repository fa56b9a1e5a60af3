// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/stage_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <map>

#include "tempera/core/random.h"
#include "tempera/frames/files.h"

namespace tempera {

namespace {

std::string hash_of(const std::string& text) {
  std::uint64_t h = text.size();
  for (const char c : text) h = hash_key(h, static_cast<unsigned char>(c));
  return fmt::format("{:016x}", h);
}

bool is_finished(const std::string& path, const std::string& key, const std::string& fingerprint) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored)) return false;
  try {
    const Metadata metadata = read_metadata(path);
    const auto it = metadata.find(key);
    if (it == metadata.end() || it->second != MetaValue(fingerprint)) return false;
    read_frame(path);  // the header of a truncated file is whole; only its pixels tell
    return true;
  } catch (const Error&) {
    return false;
  }
}

std::string list_frames(const std::vector<int>& frames) {
  std::string out;
  constexpr std::size_t kMost = 8;
  for (std::size_t i = 0; i < std::min(frames.size(), kMost); ++i) out += fmt::format("{}{}", i ? ", " : "", frames[i]);
  return out + (frames.size() > kMost ? fmt::format(" and {} more", frames.size() - kMost) : "");
}

/// The frames to make, in ascending order and each once. Errors: Error{kMissingFile} for one that cannot be made.
std::vector<int> frames_to_make(const StageEntry& entry, const StageSection& section, const SequenceDesc& out,
                                const FrameSequence& in) {
  std::vector<int> frames = section.frames.empty() ? out.all_frames() : section.frames;
  std::sort(frames.begin(), frames.end());
  frames.erase(std::unique(frames.begin(), frames.end()), frames.end());
  for (const int f : frames) {
    if (out.has(f)) continue;
    if (!in.has(f)) {
      throw Error(ErrorCode::kMissingFile, fmt::format("{} has no frame {}; it has {} to {}", in.pattern(), f,
                                                       in.frames().front(), in.frames().back()));
    }
    throw Error(ErrorCode::kMissingFile, fmt::format("{} makes no frame {} of {}", entry.name, f, in.pattern()));
  }
  return frames;
}

/// That no finished frame of `output`, which this run keeps, was made by another engine.
/// Errors: Error{kBadInput} naming the first.
void check_engine(const StageEntry& entry, const std::string& engine, const std::string& output,
                  const std::set<int>& remade) {
  std::vector<int> frames = has_frame_pattern(output) ? existing_frames(output) : std::vector<int>();
  for (const int f : frames) {
    if (remade.contains(f)) continue;
    Metadata metadata;
    try {
      metadata = read_metadata(frame_path(output, f));
    } catch (const Error&) {
      continue;  // not finished
    }
    const auto made_by = metadata.find(stage_engine_key(entry.name));
    if (made_by == metadata.end() || made_by->second == MetaValue(engine)) continue;
    throw Error(ErrorCode::kBadInput,
                fmt::format("{} was {} by {}, here it would be {}: frames of one sequence are made alike",
                            frame_path(output, f), entry.done, to_text(made_by->second), engine));
  }
}

/// The sequence of a port as its files are, judged by `file`.
SequenceDesc describe(const FrameSequence& files, const std::string& file, const StageSection& section) {
  const std::vector<int>& have = files.frames();
  const FrameHeader header = read_header(file);
  SequenceDesc desc;
  desc.sequence = section.sequence.value_or(FrameRange{have.front(), have.back()});
  desc.reach = section.reach.value_or(desc.sequence);
  desc.frames = have;
  desc.width = header.width, desc.height = header.height;
  desc.layers = header.layers;
  return desc;
}

}  // namespace

StageRun::StageRun(const Stage& stage, std::span<const FrameSequence> files, std::vector<SequenceDesc> in,
                   std::vector<std::string> described, StageReport& report)
    : files_(files), in_(std::move(in)), described_(std::move(described)), out_(stage.output(in_)), report_(report) {
  for (int port = 0; port < std::ssize(in_); ++port) reads_.push_back(stage.reads(port, in_));
}

Frame StageRun::read(int frame, int port, const std::function<bool(const LayerDesc&)>& wanted) const {
  TEMPERA_ASSERT(declared_.contains({port, frame}));
  const SequenceDesc& in = in_[port];
  const std::string file = path(frame, port);
  const FrameHeader header = read_header(file);
  if (header.width != in.width || header.height != in.height) {
    throw Error(ErrorCode::kBadInput, fmt::format("{} has {}x{} pixels, {} has {}x{}", file, header.width,
                                                  header.height, described_[port], in.width, in.height));
  }
  const auto has = [&](const LayerDesc& layer) {
    return std::any_of(header.layers.begin(), header.layers.end(),
                       [&](const LayerDesc& d) { return d.name == layer.name; });
  };
  ReadOptions options;
  for (const LayerUse& use : reads_[port]) {
    if (wanted && !wanted(use.layer)) continue;
    if (has(use.layer)) {
      options.layers.push_back(use.layer.name);
    } else if (use.required) {
      throw Error(ErrorCode::kBadInput, fmt::format("{} has no layer \"{}\": {}", file, use.layer.name, use.why));
    }
  }
  return read_frame(file, options);
}

Frame StageRun::start(int frame) const {
  if (!files_[0].has(frame)) return Frame(out_.width, out_.height);
  const std::string file = path(frame);
  ReadOptions options;
  for (const LayerDesc& d : read_header(file).layers) {
    if (out_.has(d)) options.layers.push_back(d.name);
  }
  const bool same_size = out_.width == in_[0].width && out_.height == in_[0].height;
  if (same_size && !options.layers.empty()) return read_frame(file, options);
  Frame empty(out_.width, out_.height);
  empty.metadata = read_metadata(file);
  return empty;
}

void StageRun::write(int frame, Frame out) { write_(frame, std::move(out)); }

StageReport run_stage(const StageChoice& choice, std::span<const FrameSequence> in, const std::string& output,
                      const StageOptions& options, StageObserver& observer, std::stop_token stop) {
  const auto start = std::chrono::steady_clock::now();
  const StageEntry& entry = *choice.entry;
  TEMPERA_ASSERT(in.size() == entry.ports.size());
  const std::unique_ptr<Stage> stage = choice.make();
  const std::string fingerprint_key = stage_fingerprint_key(entry.name);
  const auto out_path = [&](int f) { return frame_path(output, f); };

  const std::string engine = stage->engine();
  StageReport report;
  std::vector<StageRun> runs;
  std::size_t wanted = 0;
  for (const StageSection& section : options.sections) {
    const int first = section.frames.empty() ? in[0].frames().front()
                                             : *std::min_element(section.frames.begin(), section.frames.end());
    std::vector<SequenceDesc> descs;
    std::vector<std::string> described;
    for (const FrameSequence& files : in) {
      described.push_back(files.path(files.has(first) ? first : files.frames().front()));
      descs.push_back(describe(files, described.back(), section));
    }
    StageRun run(*stage, in, std::move(descs), std::move(described), report);
    std::erase_if(run.out_.layers, [&](const LayerDesc& d) {  // nor are they read to pass through
      return std::find(options.leave_out.begin(), options.leave_out.end(), d.name) != options.leave_out.end();
    });
    run.frames_ = frames_to_make(entry, section, run.out_, in[0]);
    wanted += run.frames_.size();
    runs.push_back(std::move(run));
  }
  if (wanted > 1 && !has_frame_pattern(output)) {
    throw Error(ErrorCode::kUsage,
                fmt::format("{} cannot hold {} frames; write {}", output, wanted, numbered_pattern(output)));
  }
  if (!engine.empty()) {
    std::set<int> remade;  // --resume keeps what was made before
    for (const StageRun& run : runs) {
      if (!options.resume) remade.insert(run.frames_.begin(), run.frames_.end());
    }
    check_engine(entry, engine, output, remade);
  }
  const auto check_stop = [&] {
    if (stop.stop_requested()) {
      throw Error(ErrorCode::kCancelled, fmt::format("stopped; {} of {} frames are done, --resume continues",
                                                     report.frames.size() + report.skipped.size(), wanted));
    }
  };

  // The files that a frame depends on, and so whether it has to be done.
  std::map<std::string, std::string> identities;  // by path
  std::map<int, std::string> targets;             // frame -> fingerprint
  for (StageRun& run : runs) {
    for (int port = 0; port < std::ssize(in); ++port) {
      std::set<int> missing;
      for (const int f : run.frames_) {
        std::error_code ignored;
        if (std::filesystem::equivalent(run.path(f, port), out_path(f), ignored)) {
          throw Error(ErrorCode::kUsage, fmt::format("frame {} would replace its own input {}; name another output", f,
                                                     run.path(f, port)));
        }
        for (const int g : stage->inputs(port, f, run.in_)) {
          run.declared_.emplace(port, g);
          if (!in[port].has(g)) missing.insert(g);
        }
      }
      if (missing.empty()) continue;
      throw Error(ErrorCode::kBadInput, fmt::format("{} lacks {}: {}; {}", in[port].pattern(),
                                                    port == 0 ? "frames in between" : "frames that go with the others",
                                                    list_frames({missing.begin(), missing.end()}), entry.gap_help));
    }
  }
  for (StageRun& run : runs) {
    const WriteOptions& w = options.write;
    const std::string settings =
        fmt::format("{}\n{}\n{}half={} names={} lossy={}\n", TEMPERA_VERSION, choice.params.canonical(),
                    stage->identity(run.in_) + engine, w.half, names_text(w), w.compression == Compression::kDwaa) +
        (options.leave_out.empty() ? "" : fmt::format("without={}\n", fmt::join(options.leave_out, ",")));
    std::vector<int> unfinished;
    for (const int f : run.frames_) {
      check_stop();
      std::string text = settings;
      for (int port = 0; port < std::ssize(in); ++port) {
        if (port > 0) text += fmt::format("port {}\n", port);
        for (const int g : stage->inputs(port, f, run.in_)) {
          auto [it, fresh] = identities.try_emplace(run.path(g, port));
          if (fresh) it->second = content_identity(it->first);
          text += fmt::format("{} {}\n", g, it->second);
        }
      }
      const std::string fingerprint = hash_of(text);
      if (options.resume && is_finished(out_path(f), fingerprint_key, fingerprint)) {
        report.skipped.push_back(f);
      } else {
        targets[f] = fingerprint;
        unfinished.push_back(f);
      }
    }
    run.frames_ = std::move(unfinished);
  }
  std::sort(report.skipped.begin(), report.skipped.end());
  {
    std::vector<int> frames;
    frames.reserve(targets.size());
    for (const auto& [f, fingerprint] : targets) frames.push_back(f);
    observer.begin(frames, report.skipped);
  }
  if (!targets.empty()) {
    for (const StageRun& run : runs) check_encoding(run.out_.layers, options.write);
    const TemporaryFile probe(out_path(targets.begin()->first));  // what cannot be written is known before the work
  }

  const std::size_t all = targets.size();
  std::size_t before = 0;
  for (StageRun& run : runs) {
    if (run.frames_.empty()) continue;
    run.progress_ = [&, done = double(before) / double(all),
                     part = double(run.frames_.size()) / double(all)](double x) {
      observer.progress(done + part * x);
      check_stop();
    };
    run.check_stop_ = check_stop;
    run.write_ = [&](int f, Frame out) {
      const auto target = targets.find(f);
      TEMPERA_ASSERT(target != targets.end());
      // The file is no longer what the step before would write.
      std::erase_if(out.metadata, [](const auto& value) { return is_fingerprint_key(value.first); });
      if (!entry.params.empty()) out.metadata[stage_settings_key(entry.name)] = choice.params.canonical();
      out.metadata[fingerprint_key] = target->second;
      if (!engine.empty()) out.metadata[stage_engine_key(entry.name)] = engine;
      if (!options.command.empty()) out.metadata[stage_command_key(entry.name)] = options.command;
      for (const std::string& name : options.leave_out) {
        if (out.has(name)) out.remove(name);
      }
      const std::string path = out_path(f);
      write_frame(path, out, options.write);
      targets.erase(target);
      report.frames.push_back(f);
      observer.frame_done(f, path);
    };
    stage->run(run);
    before += run.frames_.size();
  }
  TEMPERA_ASSERT(targets.empty());
  observer.progress(1);
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  observer.end(report.seconds);
  return report;
}

}  // namespace tempera
