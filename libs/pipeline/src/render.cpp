// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/render.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <optional>
#include <thread>

#include "checkpoint.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/frames/files.h"
#include "tempera/transport/frame_scene.h"

namespace tempera {

RenderTotals& RenderTotals::operator+=(const RenderTotals& o) {
  samples += o.samples;
  rays += o.rays;
  shadow_rays += o.shadow_rays;
  bad_samples += o.bad_samples;
  for (const BadSample& b : o.first_bad) {
    if (first_bad.size() < 16) first_bad.push_back(b);
  }
  return *this;
}

namespace {

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// What is fixed for a sequence.
struct Sequence {
  const Shot& shot;
  const Scene& scene;
  std::unique_ptr<Integrator> integrator;
  std::vector<LayerDesc> layers;
  LightPathClassifier classifier;
  GeometryCache cache;
  int width, height;        ///< of the crop window
  std::vector<Tile> tiles;  ///< pixels of the files
  std::vector<std::size_t> order;

  Sequence(const Shot& shot_, const Scene& scene_)
      : shot(shot_),
        scene(scene_),
        integrator(find_integrator(shot_.integrator).make(shot_.params)),
        layers(integrator->outputs(shot_.settings)),
        classifier(expressions(shot_.settings)),
        width(shot_.settings.x1() - shot_.settings.x0()),
        height(shot_.settings.y1() - shot_.settings.y0()),
        tiles(make_tiles(width, height)),
        order(tiles.size()) {
    // From the center outwards, ring by ring, as there the subject is. Results do not depend on it.
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    const auto key = [&](std::size_t i) {
      const Tile& t = tiles[i];
      const double x = 0.5 * (t.x0 + t.x1 - width) / kTileSize, y = 0.5 * (t.y0 + t.y1 - height) / kTileSize;
      return std::pair(std::lround(std::max(std::abs(x), std::abs(y))), std::atan2(y, x));
    };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  }

  static std::vector<std::string> expressions(const RenderSettings& settings) {
    std::vector<std::string> out;
    for (const PathClass& c : settings.classes) out.push_back(c.expression);
    return out;
  }

  double motion_step() const { return shot.settings.clock.frame_duration() / shot.motion_segments; }
};

/// What rays of one frame meet, and what its integrator made of that.
struct PreparedFrame {
  FrameScene scene;
  std::unique_ptr<FramePlan> plan;
  bool only_for_next_frame;

  /// `rendered`: as Integrator::prepare takes it; `only_for_next_frame`: whether only what the next frame needs is
  /// wanted.
  PreparedFrame(Sequence& q, int frame, const Frame* rendered, bool only_for_next_frame_ = false)
      : scene(q.scene, q.shot.settings, q.classifier, frame, q.motion_step(), q.cache),
        only_for_next_frame(only_for_next_frame_) {
    if (q.integrator->frames_before() == 0 || only_for_next_frame) {
      plan = q.integrator->prepare(context(), nullptr, nullptr);
      return;
    }
    const PrecedingFrame before(scene);
    plan = q.integrator->prepare(context(), &before.context(), rendered);
  }
  FrameContext context() const { return scene.context(plan.get(), only_for_next_frame); }
};

RenderTotals totals_of(RenderCounters& c) { return {c.samples, c.rays, c.shadow_rays, c.bad_samples, c.first_bad}; }

/// Renders the tiles of `state` that are not done into `frame`. `finished(tile, totals)` is called without
/// `mutex` after a tile is marked done.
void render_tiles(const Sequence& q, const FrameContext& c, Frame& frame, CheckpointState& state, std::mutex& mutex,
                  std::stop_token stop, const std::function<void(const Tile&, const RenderTotals&)>& finished) {
  std::vector<std::size_t> missing;
  for (const std::size_t i : q.order) {
    if (!state.done[i]) missing.push_back(i);
  }
  // Taken in order from a counter: a parallel loop alone would start in the middle of the list.
  std::atomic<std::size_t> next{0};
  parallel_for(0, std::int64_t(missing.size()), [&](std::int64_t) {
    if (stop.stop_requested()) return;
    const std::size_t i = missing[next++];
    const Tile& t = q.tiles[i];
    const int dx = c.settings.x0(), dy = c.settings.y0();
    RenderCounters counters;
    q.integrator->render(c, {t.x0 + dx, t.y0 + dy, t.x1 + dx, t.y1 + dy}, frame, counters, stop);
    if (stop.stop_requested()) return;  // it may be incomplete
    const RenderTotals totals = totals_of(counters);
    {
      const std::scoped_lock lock(mutex);
      state.done[i] = 1;
      state.totals += totals;
    }
    finished(t, totals);
  });
}

/// Renders all rounds of a frame, each as render_tiles does; `state` is that of the last.
void render_rounds(const Sequence& q, const FrameContext& c, Frame& frame, CheckpointState& state, std::mutex& mutex,
                   const std::stop_token& stop, const std::function<void(const Tile&, const RenderTotals&)>& finished) {
  const int rounds = q.integrator->rounds(c.settings);
  for (int round = 0; round < rounds; ++round) {
    if (round > 0) {
      std::fill(state.done.begin(), state.done.end(), 0);
      if (stop.stop_requested()) return;
      q.integrator->next_round(c, frame);
    }
    render_tiles(q, c, frame, state, mutex, stop, finished);
  }
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

/// The layers of a frame that the next one needs_before over.
Frame keep_layers_for_next_frame(const Sequence& q, const Frame& frame) {
  Frame result(frame.width(), frame.height());
  for (const std::string& name : q.integrator->layers_for_next_frame()) {
    const Layer* layer = frame.find(name);
    result.create(layer->desc) = layer->image;
  }
  return result;
}

/// Those layers from the file of the frame, if it holds what would be rendered, else rendered for them alone.
Frame layers_of_frame_before(Sequence& q, int frame, const std::stop_token& stop) {
  const std::string path = frame_path(q.shot.output, frame);
  try {
    if (std::error_code ignored;
        std::filesystem::exists(path, ignored) && has_fingerprint(q, frame, read_metadata(path))) {
      ReadOptions options;
      options.layers = q.integrator->layers_for_next_frame();
      return read_frame(path, options);
    }
  } catch (const Error& e) {
    log_debug(fmt::format("frame {}: {} cannot be used: {}", frame, path, e.message()));
  }
  log_info(fmt::format("frame {}: first rendering what it needs of the frame before", frame + 1));
  Frame picture = make_frame(*q.integrator, q.shot.settings, q.scene);
  const PreparedFrame prepared(q, frame, nullptr, true);
  CheckpointState state{std::vector<char>(q.tiles.size(), 0), 0, {}};
  std::mutex mutex;
  render_rounds(q, prepared.context(), picture, state, mutex, stop, [](const Tile&, const RenderTotals&) {});
  return keep_layers_for_next_frame(q, picture);
}

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
  void push(Frame frame, FrameReport report, const WriteOptions& options) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return !waiting_ || error_; });
    rethrow();
    waiting_ = Job{std::move(frame), std::move(report), options};
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
  struct Job {
    Frame frame;
    FrameReport report;
    WriteOptions options;
  };
  void rethrow() {
    if (error_) std::rethrow_exception(error_);
  }
  void run() {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [&] { return waiting_ || closing_; });
      if (!waiting_ || error_) return;
      Job job = std::move(*waiting_);
      waiting_.reset();
      busy_ = true;
      changed_.notify_all();
      lock.unlock();
      std::exception_ptr error;
      try {
        write_frame(job.report.path, job.frame, job.options);
        std::error_code ignored;
        std::filesystem::remove(checkpoint_path(job.report.path), ignored);
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
  std::optional<Job> waiting_;
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

}  // namespace

RenderReport render_sequence(const Shot& shot, const Scene& scene, const RenderOptions& options,
                             std::span<RenderObserver* const> observers, const std::stop_token& stop) {
  const double begin = now();
  Sequence q(shot, scene);
  RenderReport report;

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
  const int rounds = q.integrator->rounds(shot.settings);
  plan.tiles = q.tiles.size() * std::size_t(rounds);
  plan.width = q.width;
  plan.height = q.height;
  plan.settings = &shot.settings;
  plan.layers = q.layers;
  check_camera(q, plan.frames);
  if (plan.frames.size() > 1 && !has_frame_pattern(shot.output)) {
    throw Error(ErrorCode::kUsage, fmt::format("{} cannot hold {} frames; write {}", shot.output, plan.frames.size(),
                                               numbered_pattern(shot.output)));
  }
  if (!plan.frames.empty()) check_output(q, plan.frames.size(), frame_path(shot.output, plan.frames[0]));
  for (RenderObserver* o : observers) o->begin(plan);

  // Both the caller and a failed write stop the tiles.
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
  const bool needs_before = !q.integrator->layers_for_next_frame().empty();
  std::optional<std::pair<int, Frame>> before_layers;

  for (const int f : plan.frames) {
    if (halt.stop_requested()) break;
    const double frame_begin = now();
    const std::string path = frame_path(shot.output, f), partial = checkpoint_path(path);
    const std::string frame_fingerprint = fingerprint(shot, scene, f);
    Frame frame = make_frame(*q.integrator, shot.settings, scene);
    CheckpointState state{std::vector<char>(q.tiles.size(), 0), 0, {}};
    if (std::error_code ignored; options.resume && std::filesystem::exists(partial, ignored)) {
      std::string why;
      if (auto saved = load_checkpoint(partial, frame_fingerprint, frame, q.tiles, why)) {
        state = std::move(*saved);
        log_info(fmt::format("frame {}: continuing from {} with {} of {} tiles done", f, partial,
                             std::count(state.done.begin(), state.done.end(), 1), q.tiles.size()));
      } else {
        log_info(fmt::format("frame {}: starting over, because {} cannot be used: {}", f, partial, why));
      }
    }
    if (needs_before && (!before_layers || before_layers->first != f - 1))
      before_layers = {f - 1, layers_of_frame_before(q, f - 1, halt.get_token())};
    const PreparedFrame prepared(q, f, needs_before ? &before_layers->second : nullptr);
    log_debug(fmt::format("frame {}: built in {:.3f} s, {:.1f} MiB, {} pieces between jumps", f, now() - frame_begin,
                          double(prepared.scene.memory()) / (1 << 20), prepared.scene.piece_count()));
    for (RenderObserver* o : observers) {
      o->frame_begin(f, frame, std::size_t(std::count(state.done.begin(), state.done.end(), 1)));
    }

    std::mutex mutex;
    const double earlier = state.seconds;
    const auto snapshot = [&] {
      const std::scoped_lock lock(mutex);
      CheckpointState copy = state;
      copy.seconds = earlier + now() - frame_begin;
      return copy;
    };
    {
      const PeriodicCheckpoint periodic(rounds == 1 ? options.checkpoint_seconds : 0, [&] {
        try {
          save_checkpoint(partial, frame_fingerprint, frame, q.tiles, snapshot());
        } catch (const Error& e) {
          log_warning(fmt::format("no checkpoint of frame {}: {}", f, e.what()));
        }
      });
      render_rounds(q, prepared.context(), frame, state, mutex, halt.get_token(),
                    [&](const Tile& t, const RenderTotals& totals) {
                      for (RenderObserver* o : observers) o->tile_done(f, frame, t, totals);
                    });
    }
    writer.check();
    if (std::find(state.done.begin(), state.done.end(), 0) != state.done.end()) {
      writer.finish();
      if (rounds > 1) {  // later rounds build on all samples of all tiles
        log_info(fmt::format("frame {}: stopped; it will start over, as frames with adaptive sampling do", f));
        break;
      }
      save_checkpoint(partial, frame_fingerprint, frame, q.tiles, snapshot());
      log_info(fmt::format("frame {}: stopped; {} of {} tiles are kept in {}", f,
                           std::count(state.done.begin(), state.done.end(), 1), q.tiles.size(), partial));
      break;
    }

    finish_frame(*q.integrator, prepared.context(), frame);
    if (needs_before) before_layers = {f, keep_layers_for_next_frame(q, frame)};
    RenderInfo info = render_info_of(q, f);
    info.command = options.command;
    info.render_seconds = earlier + now() - frame_begin;
    set_render_info(frame.metadata, info);
    frame.metadata[kFingerprintKey] = frame_fingerprint;
    const double aspect = scene.cameras[std::size_t(shot.settings.camera)].pixel_aspect;
    if (aspect != 1) frame.metadata[kPixelAspectKey] = aspect;
    if (shot.settings.crop_width > 0) {  // layers of pixel indices count in the full picture
      frame.metadata["tempera/crop_left"] = shot.settings.crop_x;
      frame.metadata["tempera/crop_top"] = shot.settings.crop_y;
    }
    writer.push(std::move(frame), {f, path, info.render_seconds, state.totals}, shot.write);
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
  if (report.frames.size() < plan.frames.size()) {
    throw Error(ErrorCode::kCancelled, fmt::format("stopped; {} of {} frames are done, --resume continues",
                                                   report.frames.size() + report.skipped.size(), shot.frames.size()));
  }
  return report;
}

Frame render_frame(const Shot& shot, const Scene& scene, int frame, RenderTotals* totals) {
  Sequence q(shot, scene);
  Frame picture = make_frame(*q.integrator, shot.settings, scene);
  std::optional<Frame> before_layers;
  if (!q.integrator->layers_for_next_frame().empty()) before_layers = layers_of_frame_before(q, frame - 1, {});
  const PreparedFrame prepared(q, frame, before_layers ? &*before_layers : nullptr);
  CheckpointState state{std::vector<char>(q.tiles.size(), 0), 0, {}};
  std::mutex mutex;
  render_rounds(q, prepared.context(), picture, state, mutex, {}, [](const Tile&, const RenderTotals&) {});
  finish_frame(*q.integrator, prepared.context(), picture);
  if (totals) *totals = state.totals;
  return picture;
}

Rgb replay_sample(const Shot& shot, const Scene& scene, const BadSample& b) {
  const RenderSettings& s = shot.settings;
  if (b.x < 0 || b.y < 0 || b.x >= s.width || b.y >= s.height || b.sample < 0) {
    throw Error(ErrorCode::kUsage, fmt::format("sample {} of pixel {},{} does not exist in a picture of {}x{}",
                                               b.sample, b.x, b.y, s.width, s.height));
  }
  Sequence q(shot, scene);
  const PreparedFrame prepared(q, b.frame, nullptr, true);
  const FlushDenormals flush;  // as the render had it
  return q.integrator->replay(prepared.context(), b);
}

}  // namespace tempera
