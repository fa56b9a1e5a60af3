// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/render.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

#include "checkpoint.h"
#include "hash.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"
#include "tempera/methods/render_section.h"

namespace tempera {

namespace {

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// What is fixed for a sequence.
struct Sequence {
  const Shot& shot;
  const Scene& scene;
  std::unique_ptr<Method> method;
  std::vector<LayerDesc> layers;
  LightPathClassifier classifier;
  GeometryCache cache;
  int width, height;  ///< of the crop window

  Sequence(const Shot& shot_, const Scene& scene_)
      : shot(shot_),
        scene(scene_),
        method(find_method(shot_.integrator).make(shot_.params)),
        layers(method->outputs(shot_.settings)),
        classifier(path_expressions(*method, shot_.settings)),
        width(shot_.settings.x1() - shot_.settings.x0()),
        height(shot_.settings.y1() - shot_.settings.y0()) {}

  double motion_step() const { return shot.settings.clock.frame_duration() / shot.motion_segments; }
  FrameRange section(int frame) const { return method->section(shot.settings, shot.sequence, frame); }
  SceneWindow window(FrameRange section) { return {scene, shot.settings, classifier, motion_step(), cache, section}; }
  std::unique_ptr<Section> make_section(FrameRange range, std::vector<int> frames, std::vector<PassDesc> passes) const {
    return std::make_unique<Section>(*method, shot.settings, scene, range, std::move(frames), std::move(passes));
  }
};

/// Frames that are rendered together.
struct Job {
  FrameRange range;
  std::vector<int> frames;  ///< those that are wanted, ascending
};

/// In the order in which the frames are wanted.
std::vector<Job> jobs_of(const Sequence& q, std::span<const int> frames) {
  std::vector<Job> jobs;
  std::map<int, std::size_t> known;  // by the section's first frame
  for (const int f : frames) {
    const FrameRange range = q.section(f);
    const auto [at, is_new] = known.try_emplace(range.first, jobs.size());
    if (is_new) jobs.push_back({range, {}});
    jobs[at->second].frames.push_back(f);
  }
  for (Job& j : jobs) std::sort(j.frames.begin(), j.frames.end());
  return jobs;
}

std::size_t units_of(const Sequence& q, const Job& job) {
  std::size_t n = 0;
  const std::size_t tiles = make_tiles(q.width, q.height).size() * job.frames.size();
  for (const PassDesc& pass : q.method->passes(q.shot.settings, job.range))
    n += pass.domain == PassDesc::Domain::kTiles ? tiles : pass.units;
  return n;
}

/// The layer of a mask's file that says which pixels are wanted, and whether it covers the crop window alone.
struct MaskLayer {
  std::string name;
  bool cropped = false;
};

/// Errors: those of read_header; Error{kBadInput} for another size, or where no layer is known to be the mask.
MaskLayer find_mask(const Shot& shot, int frame) {
  const std::string path = frame_path(shot.mask, frame);
  const FrameHeader file = read_header(path, {.decode = false});
  const RenderSettings& s = shot.settings;
  const bool whole = file.width == s.width && file.height == s.height;
  const bool cropped = file.width == s.x1() - s.x0() && file.height == s.y1() - s.y0();
  if (!whole && !cropped) {
    throw Error(
        ErrorCode::kBadInput, {path},
        fmt::format("this mask has {}x{} pixels, the picture has {}x{}{}", file.width, file.height, s.width, s.height,
                    s.crop_width > 0 ? fmt::format(", its crop window {}x{}", s.crop_width, s.crop_height) : ""));
  }
  std::vector<std::string> names;
  for (const LayerDesc& d : file.layers) {
    if (d.role == LayerRole::kMask) return {d.name, !whole};
    names.push_back(d.name);
  }
  if (names.size() != 1) {
    throw Error(ErrorCode::kBadInput, {path},
                fmt::format("none of its layers is a mask; it would be called \"{}\", or be the only one",
                            layers::mask().name));
  }
  return {names[0], !whole};
}

/// What says which pixels of the full picture are wanted. Errors: those of find_mask and read_frame.
Image read_mask(const Shot& shot, int frame) {
  const MaskLayer layer = find_mask(shot, frame);
  const Frame file = read_frame(frame_path(shot.mask, frame), {.layers = {layer.name}, .decode = false});
  const Image& from = file.layer(layer.name);
  const RenderSettings& s = shot.settings;
  Image mask(s.width, s.height, 1);
  const int dx = layer.cropped ? s.x0() : 0, dy = layer.cropped ? s.y0() : 0;
  for (int y = 0; y < from.height(); ++y) {
    for (int x = 0; x < from.width(); ++x) mask.at(x + dx, y + dy) = from.at(x, y);
  }
  return mask;
}

RenderInfo render_info_of(const Sequence& q, int frame) {
  const RenderSettings& s = q.shot.settings;
  RenderInfo info;
  info.version = TEMPERA_VERSION;
  info.scene = q.shot.scene_file.filename().string();
  info.scene_hash = fmt::format("{:016x}", q.scene.content_hash);
  info.integrator = q.shot.integrator;
  info.parameters = q.shot.params.canonical();
  info.spp = s.spp;
  info.seed = s.seed;
  info.frame = frame;
  info.fps = s.clock.fps;
  info.shutter_open = s.clock.shutter.open;
  info.shutter_close = s.clock.shutter.close;
  return info;
}

/// What differs between a file's record and this render, for people.
std::string differences(const std::optional<RenderInfo>& was, const RenderInfo& is) {
  if (!was) return "it has no record of how it was rendered";
  std::vector<std::string> parts;
  const auto part = [&](const char* name, const auto& a, const auto& b) {
    if (!(a == b)) parts.push_back(fmt::format("{} was {}, now {}", name, a, b));
  };
  part("version", was->version, is.version);
  if (was->scene_hash != is.scene_hash) parts.push_back("the scene changed");
  part("integrator", was->integrator, is.integrator);
  if (was->integrator == is.integrator) part("parameters", was->parameters, is.parameters);
  part("spp", was->spp, is.spp);
  part("seed", was->seed, is.seed);
  part("frame", was->frame, is.frame);
  part("fps", was->fps, is.fps);
  part("shutter open", was->shutter_open, is.shutter_open);
  part("shutter close", was->shutter_close, is.shutter_close);
  return parts.empty() ? "other settings changed" : fmt::format("{}", fmt::join(parts, "; "));
}

bool has_fingerprint(const Sequence& q, int frame, const Metadata& metadata) {
  const auto it = metadata.find(kFingerprintKey);
  const auto* stored = it == metadata.end() ? nullptr : std::get_if<std::string>(&it->second);
  return stored && *stored == fingerprint(q.shot, q.scene, frame);
}

/// Whether the file of a frame is what would be rendered; logs why if it is there and is not.
bool is_finished(const Sequence& q, int frame, const std::string& path) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored)) return false;
  std::string why;
  try {
    const Metadata metadata = read_metadata(path);
    if (has_fingerprint(q, frame, metadata)) {
      read_frame(path);  // the header of a truncated file is whole; only its pixels tell
      return true;
    }
    why = differences(render_info(metadata), render_info_of(q, frame));
  } catch (const Error& e) {
    why = e.message();
  }
  log_info(fmt::format("frame {}: rendering again; {} does not match: {}", frame, path, why));
  return false;
}

/// Layers of finished frames that passes of later ones read, as Method::begin_pass takes them.
class EarlierLayers {
 public:
  EarlierLayers(Sequence& q, std::stop_token stop) : q_(q), stop_(std::move(stop)) {}

  /// From memory, from the frame's file if it holds what would be rendered, else rendered as far as it takes.
  Image read(int frame, const LayerRead& read) {
    if (const auto known = kept_.find({frame, read.layer}); known != kept_.end()) return known->second;
    const std::string path = frame_path(q_.shot.output, frame);
    try {
      if (std::error_code ignored;
          std::filesystem::exists(path, ignored) && has_fingerprint(q_, frame, read_metadata(path))) {
        return read_frame(path, {.layers = {read.layer}}).layer(read.layer);
      }
    } catch (const Error& e) {
      log_debug(fmt::format("frame {}: {} cannot be used: {}", frame, path, e.message()));
    }
    log_info(fmt::format("frame {}: first rendering what it needs of frame {}", frame - read.frame_offset, frame));
    const FrameRange range = q_.section(frame);
    std::vector<PassDesc> passes = q_.method->passes(q_.shot.settings, range);
    while (passes.back().name != read.pass) passes.pop_back();
    const auto section = q_.make_section(range, {frame}, std::move(passes));
    SceneWindow window = q_.window(range);
    SectionHooks hooks;
    hooks.read = [this](int f, const LayerRead& r) { return this->read(f, r); };
    render_section(*q_.method, window, *section, {}, hooks, stop_);
    return section->picture(frame).layer(read.layer);
  }
  /// Keeps what the frames after `frame` may read of it, instead of what was kept of earlier ones.
  void keep(int frame, const Frame& picture, std::span<const PassDesc> passes) {
    int farthest = 0;
    for (const PassDesc& pass : passes) {
      for (const LayerRead& r : pass.reads) {
        kept_[{frame, r.layer}] = picture.layer(r.layer);
        farthest = std::min(farthest, r.frame_offset);
      }
    }
    std::erase_if(kept_, [&](const auto& k) { return k.first.first <= frame + farthest; });
  }

 private:
  Sequence& q_;
  std::stop_token stop_;
  std::map<std::pair<int, std::string>, Image> kept_;
};

/// Refuses before rendering a camera that some frame cannot be seen through. Errors: those of CameraModel.
void check_camera(const Sequence& q, std::span<const int> frames) {
  const RenderSettings& s = q.shot.settings;
  for (const int f : frames) {
    try {
      CameraModel(q.scene, s.camera, s.width, s.height, evaluation_span(s.clock, f), q.motion_step());
    } catch (const Error& e) {
      throw Error(e.code(), e.loc(), fmt::format("frame {}: {}", f, e.message()));
    }
  }
}

/// Refuses before rendering what could not be written after it. Errors: Error{kFailed}.
void check_output(const Sequence& q, std::size_t frames, const std::string& path) {
  { const TemporaryFile probe(path); }  // creates missing folders; leaves nothing else
  std::error_code failed;
  std::filesystem::path folder = std::filesystem::path(path).parent_path();
  const auto space = std::filesystem::space(folder.empty() ? "." : folder, failed);
  if (failed) return;
  double values = 0;
  for (const LayerDesc& d : q.layers) values += double(q.width) * q.height * d.channel_count();
  const double bytes = values * (q.shot.write.half ? 2 : 4);
  constexpr double kMiB = 1 << 20;
  // Noise compresses badly, features well: half the raw size is what a frame takes at least.
  if (double(space.available) < 0.5 * bytes) {
    throw Error(ErrorCode::kFailed,
                fmt::format("no space for a frame of about {:.0f} MiB on the disk of {} ({:.0f} MiB are free)",
                            bytes / kMiB, path, double(space.available) / kMiB));
  }
  if (double(space.available) < 0.5 * bytes * double(frames)) {
    log_warning(fmt::format("{} frames may take {:.0f} MiB, but only {:.0f} MiB are free on the disk of {}", frames,
                            bytes * double(frames) / kMiB, double(space.available) / kMiB, path));
  }
}

/// Writes frames one after the other on a thread of its own, so that the next frame can start. At most one waits:
/// memory stays bounded.
class FrameWriter {
 public:
  /// `written` is called on the writing thread; `failed` is requested to stop on an error.
  FrameWriter(std::function<void(const FrameReport&)> written, std::stop_source failed)
      : written_(std::move(written)), failed_(std::move(failed)), thread_([this] { run(); }) {}
  ~FrameWriter() {
    {
      const std::scoped_lock lock(mutex_);
      closing_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  FrameWriter(const FrameWriter&) = delete;
  FrameWriter& operator=(const FrameWriter&) = delete;

  /// Waits while another frame waits. Errors: those of an earlier write.
  /// `then_remove`: a file that is needed no more once the frame is written; may be empty.
  void push(Frame frame, FrameReport report, const WriteOptions& options, std::string then_remove) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return !waiting_ || error_; });
    rethrow();
    waiting_ = Writing{std::move(frame), std::move(report), options, std::move(then_remove)};
    changed_.notify_all();
  }
  /// Returns when everything is written. Errors: those of a write.
  void finish() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return (!waiting_ && !busy_) || error_; });
    rethrow();
  }
  void check() {
    const std::scoped_lock lock(mutex_);
    rethrow();
  }

 private:
  struct Writing {
    Frame frame;
    FrameReport report;
    WriteOptions options;
    std::string then_remove;
  };
  void rethrow() {
    if (error_) std::rethrow_exception(error_);
  }
  void run() {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [&] { return waiting_ || closing_; });
      if (!waiting_ || error_) return;
      Writing job = std::move(*waiting_);
      waiting_.reset();
      busy_ = true;
      changed_.notify_all();
      lock.unlock();
      std::exception_ptr error;
      try {
        write_frame(job.report.path, job.frame, job.options);
        std::error_code ignored;
        if (!job.then_remove.empty()) std::filesystem::remove(job.then_remove, ignored);
        written_(job.report);
      } catch (...) {
        error = std::current_exception();
      }
      lock.lock();
      busy_ = false;
      error_ = error;
      if (error_) failed_.request_stop();
      changed_.notify_all();
    }
  }

  std::function<void(const FrameReport&)> written_;
  std::stop_source failed_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Writing> waiting_;
  bool busy_ = false, closing_ = false;
  std::exception_ptr error_;
  std::thread thread_;  // last: it uses all of the above
};

/// Saves a frame in progress every `seconds` while alive. Tiles that are done do not change any more, so they are read
/// while others render.
class PeriodicCheckpoint {
 public:
  PeriodicCheckpoint(double seconds, std::function<void()> save)
      : thread_([this, seconds, save = std::move(save)](const std::stop_token& stop) {
          std::unique_lock lock(mutex_);
          while (seconds > 0 && !stop.stop_requested()) {
            const auto interval = std::chrono::duration<double>(std::min(seconds, 1e8));
            wake_.wait_for(lock, stop, interval, [] { return false; });
            if (!stop.stop_requested()) save();
          }
        }) {}

 private:
  std::mutex mutex_;
  std::condition_variable_any wake_;
  std::jthread thread_;  // last: its destructor stops and joins first
};

/// Renders one job from where its checkpoint stands, and hands its frames to the writer.
class JobRender {
 public:
  JobRender(Sequence& q, const Job& job, const RenderOptions& options, std::span<RenderObserver* const> observers,
            EarlierLayers& earlier)
      : q_(q), job_(job), options_(options), observers_(observers), earlier_(earlier) {
    section_ = make_section();
    const std::string first = frame_path(q.shot.output, job.frames[0]);
    store_ = options.part.count > 1 ? part_path(first, options.part) : checkpoint_path(first);
    record_.method = q.shot.integrator;
    record_.parameters = q.shot.params.canonical();
    record_.write = q.shot.write;
    std::string fingerprints;
    for (const int f : job.frames) {
      fingerprints += fingerprint(q.shot, q.scene, f) + " ";
      record_.frames.push_back({std::filesystem::path(frame_path(q.shot.output, f)).filename().string(), metadata(f)});
    }
    record_.fingerprint = hash_hex(fingerprints);
    for (const int f : job.frames) {
      if (!q.shot.mask.empty()) masks_[f] = read_mask(q.shot, f);
    }
  }

  /// Continues what was interrupted.
  void resume() {
    std::string why;
    if (std::error_code ignored; !std::filesystem::exists(store_, ignored)) return;
    if (load_checkpoint(store_, record_, *section_, why)) {
      log_info(fmt::format("{}: continuing from {} with {} of {} units done", title(), store_, section_->units_done(),
                           section_->units()));
    } else {
      section_ = make_section();
      log_info(fmt::format("{}: starting over, because {} cannot be used: {}", title(), store_, why));
    }
  }

  /// Returns whether the section, or the part of it, is done.
  bool run(const std::stop_token& stop) {
    begin_ = now();
    earlier_seconds_ = record_.seconds;
    for (const int f : job_.frames) {
      const std::size_t brought = f == job_.frames[0] ? section_->units_done() : 0;
      for (RenderObserver* o : observers_) o->frame_begin(f, section_->picture(f), brought);
    }
    SceneWindow window = q_.window(job_.range);
    SectionHooks hooks;
    hooks.read = [&](int f, const LayerRead& r) { return earlier_.read(f, r); };
    if (!masks_.empty()) hooks.mask = [&](int f) { return &masks_.at(f); };
    hooks.done = [&](const Unit& unit, const Frame* picture, const RenderTotals& totals) {
      const int frame = picture ? unit.frame : job_.frames[0];
      const int dx = q_.shot.settings.x0(), dy = q_.shot.settings.y0();
      const Tile tile =
          picture ? Tile{unit.tile.x0 - dx, unit.tile.y0 - dy, unit.tile.x1 - dx, unit.tile.y1 - dy} : Tile{};
      for (RenderObserver* o : observers_) o->tile_done(frame, section_->picture(frame), tile, totals);
    };
    bool done = false;
    {
      const PeriodicCheckpoint periodic(options_.checkpoint_seconds, [&] {
        try {
          save();
        } catch (const Error& e) {
          log_warning(fmt::format("no checkpoint of {}: {}", title(), e.what()));
        }
      });
      done = render_section(*q_.method, window, *section_, options_.part, hooks, stop);
    }
    log_debug(fmt::format("{}: {:.1f} MiB, {} pieces between jumps", title(), double(window.memory()) / (1 << 20),
                          window.piece_count()));
    return done;
  }

  /// Keeps what is done.
  void save() const {
    SectionRecord record = record_;
    record.seconds = seconds();
    save_checkpoint(store_, record, *section_);
  }
  void save_interrupted() const {
    save();
    log_info(fmt::format("{}: stopped; {} of {} units are kept in {}", title(), section_->units_done(),
                         section_->units(), store_));
  }
  void save_part() const {
    save();
    log_info(fmt::format("{}: part {} of {} is in {}; tempera merge adds the parts up", title(),
                         options_.part.index + 1, options_.part.count, store_));
  }

  void write(FrameWriter& writer) {
    section_->finish(*q_.method);
    if (const std::uint64_t lost = section_->lost()) {
      log_warning(
          fmt::format("{}: {} values were too bright for the range of their layer and are missing", title(), lost));
    }
    RenderTotals totals = section_->totals();
    const double each = seconds() / double(job_.frames.size());
    for (std::size_t i = 0; i < job_.frames.size(); ++i) {
      const int f = job_.frames[i];
      Frame& picture = section_->picture(f);
      earlier_.keep(f, picture, section_->passes());
      finish_metadata(picture, record_.frames[i].metadata, each);
      writer.push(std::move(picture), {f, frame_path(q_.shot.output, f), each, totals}, q_.shot.write,
                  i + 1 == job_.frames.size() ? store_ : "");
      totals = {};  // of all frames together, with the first
    }
  }

 private:
  std::unique_ptr<Section> make_section() const {
    return q_.make_section(job_.range, job_.frames, q_.method->passes(q_.shot.settings, job_.range));
  }
  double seconds() const { return earlier_seconds_ + now() - begin_; }
  std::string title() const {
    return job_.frames.size() == 1 ? fmt::format("frame {}", job_.frames[0])
                                   : fmt::format("frames {} to {}", job_.frames.front(), job_.frames.back());
  }
  /// Of a finished frame, but for the time that it took.
  Metadata metadata(int frame) const {
    Metadata m;
    RenderInfo info = render_info_of(q_, frame);
    info.command = options_.command;
    set_render_info(m, info);
    m[kFingerprintKey] = fingerprint(q_.shot, q_.scene, frame);
    const RenderSettings& s = q_.shot.settings;
    std::vector<ClassInfo> classes;
    for (const PathClass& c : s.classes) classes.push_back({c.name, c.expression, chains_of_class(c, s.layers)});
    set_classes(m, classes);
    if (const double aspect = q_.scene.cameras[s.camera].pixel_aspect; aspect != 1) m[kPixelAspectKey] = aspect;
    if (s.crop_width > 0) {  // layers of pixel indices count in the full picture
      m["tempera/crop_left"] = s.crop_x;
      m["tempera/crop_top"] = s.crop_y;
    }
    return m;
  }

  Sequence& q_;
  const Job& job_;
  const RenderOptions& options_;
  std::span<RenderObserver* const> observers_;
  EarlierLayers& earlier_;
  std::unique_ptr<Section> section_;
  SectionRecord record_;
  std::map<int, Image> masks_;
  std::string store_;
  double begin_ = 0, earlier_seconds_ = 0;
};

}  // namespace

RenderReport render_sequence(const Shot& shot, const Scene& scene, const RenderOptions& options,
                             std::span<RenderObserver* const> observers, const std::stop_token& stop) {
  const double begin = now();
  Sequence q(shot, scene);
  RenderReport report;
  if (options.part.count > 1 && !shot.frames.empty()) {
    for (const PassDesc& pass : q.method->passes(shot.settings, q.section(shot.frames[0]))) {
      if (pass.waits) {
        throw Error(
            ErrorCode::kUnsupported,
            fmt::format("the pass \"{}\" of \"{}\" needs the whole frame as the passes before left it: divide the "
                        "frames among machines, not each frame into parts",
                        pass.name, shot.integrator));
      }
    }
  }

  RenderPlan plan;
  for (const int f : shot.frames) {
    if (stop.stop_requested()) throw Error(ErrorCode::kCancelled, "stopped while looking for finished frames");
    const bool may_skip =
        options.resume || std::find(options.reuse.begin(), options.reuse.end(), f) != options.reuse.end();
    if (may_skip && is_finished(q, f, frame_path(shot.output, f))) {
      report.skipped.push_back(f);
    } else {
      plan.frames.push_back(f);
    }
  }
  plan.skipped = report.skipped.size();
  plan.width = q.width;
  plan.height = q.height;
  plan.settings = &shot.settings;
  plan.layers = q.layers;
  const std::vector<Job> jobs = jobs_of(q, plan.frames);
  for (const Job& job : jobs) plan.units += units_of(q, job);
  check_camera(q, plan.frames);
  for (const int f : plan.frames) {
    if (!shot.mask.empty()) find_mask(shot, f);
  }
  if (plan.frames.size() > 1 && !has_frame_pattern(shot.output)) {
    throw Error(ErrorCode::kUsage, fmt::format("{} cannot hold {} frames; write {}", shot.output, plan.frames.size(),
                                               numbered_pattern(shot.output)));
  }
  if (!plan.frames.empty()) check_output(q, plan.frames.size(), frame_path(shot.output, plan.frames[0]));
  for (RenderObserver* o : observers) o->begin(plan);

  // Both the caller and a failed write stop the units.
  std::stop_source halt;
  const std::stop_callback forward(stop, [&] { halt.request_stop(); });
  std::mutex report_mutex;
  const auto written = [&](const FrameReport& r) {
    {
      const std::scoped_lock lock(report_mutex);
      report.frames.push_back(r);
      report.totals += r.totals;
    }
    for (RenderObserver* o : observers) o->frame_end(r);
  };
  FrameWriter writer(written, halt);
  EarlierLayers earlier(q, halt.get_token());
  std::size_t parts = 0;
  for (const Job& job : jobs) {
    if (halt.stop_requested()) break;
    JobRender render(q, job, options, observers, earlier);
    if (options.resume) render.resume();
    const bool done = render.run(halt.get_token());
    writer.check();
    if (!done) {
      writer.finish();
      render.save_interrupted();
      break;
    }
    if (options.part.count > 1) {
      render.save_part();
      parts += job.frames.size();
    } else {
      render.write(writer);
    }
  }
  writer.finish();

  report.seconds = now() - begin;
  for (RenderObserver* o : observers) o->end(report);
  const RenderTotals& t = report.totals;
  if (t.bad_samples > 0) {
    const BadSample& b = t.first_bad[0];
    const PixelKey& n = b.numbers;
    const bool own = n == own_key(shot.settings, b.frame, b.x, b.y);
    log_warning(fmt::format("{} samples were not finite and were left out; see one of them: {} --replay {},{},{},{}{}",
                            t.bad_samples, options.command, b.frame, b.x, b.y, b.sample,
                            own ? "" : fmt::format(",{},{},{},{},{}", n.stream, n.x, n.y, n.rotation_x, n.rotation_y)));
  }
  if (report.frames.size() + parts < plan.frames.size()) {
    throw Error(ErrorCode::kCancelled,
                fmt::format("stopped; {} of {} frames are done, --resume continues",
                            report.frames.size() + report.skipped.size() + parts, shot.frames.size()));
  }
  return report;
}

Frame render_frame(const Shot& shot, const Scene& scene, int frame, RenderTotals* totals) {
  Sequence q(shot, scene);
  EarlierLayers earlier(q, {});
  const Job job{q.section(frame), {frame}};
  const auto section = q.make_section(job.range, job.frames, q.method->passes(shot.settings, job.range));
  SceneWindow window = q.window(job.range);
  Image mask;
  SectionHooks hooks;
  hooks.read = [&](int f, const LayerRead& r) { return earlier.read(f, r); };
  if (!shot.mask.empty()) {
    mask = read_mask(shot, frame);
    hooks.mask = [&](int) { return &mask; };
  }
  render_section(*q.method, window, *section, {}, hooks, {});
  section->finish(*q.method);
  if (totals) *totals = section->totals();
  return std::move(section->picture(frame));
}

Rgb replay_sample(const Shot& shot, const Scene& scene, const BadSample& b) {
  const RenderSettings& s = shot.settings;
  if (b.x < 0 || b.y < 0 || b.x >= s.width || b.y >= s.height || b.sample < 0) {
    throw Error(ErrorCode::kUsage, fmt::format("sample {} of pixel {},{} does not exist in a picture of {}x{}",
                                               b.sample, b.x, b.y, s.width, s.height));
  }
  Sequence q(shot, scene);
  const SceneWindow window = q.window({b.frame, b.frame});
  const FlushDenormals flush;  // as the render had it
  return q.method->replay(window.frame(b.frame), b);
}

}  // namespace tempera
