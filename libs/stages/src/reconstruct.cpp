// SPDX-License-Identifier: Apache-2.0
// The stage `reconstruct`: turns the pictures and differences that a gradient-domain integrator wrote into final
// frames, window by window. The solver of one window is in poisson.h.
//
// Layers read of a frame t: `color`, `grad.x`, `grad.y` (the base pass B_t), and for sequences `offset.color`,
// `offset.grad.x`, `offset.grad.y` (the offset pass O_t, which replays the random numbers of frame t - 1),
// `offset.source` (the pixel of frame t - 1 whose numbers a pixel replays) and `offset.samples`. Where the light of
// rare paths is solved for apart: `rare.color`, `rare.grad.x`, `rare.grad.y` and `held.color` of both passes, or of one
// with `rare.a` and `rare.b`; and, as far as they are there, `samples`, `albedo`, `normal` and `object_id`.
//
// `photon.color` and `offset.photon.color`, light of photons that has no differences, are taken out before and added again.
// `color` is the solution, with the input's alpha. With rare light apart it has no negative values, and `color.common`
// and `color.rare` are its two parts, the second one before it was smoothed; the metadata tempera/rare_light and
// tempera/held_back are the shares of these lights. Light-path classes whose differences are there are solved each by
// itself, with all of their light, in the same windows. Source: [Manzi 2016, Sec. 3.3, 4.2, 5].
#include "tempera/stages/reconstruct.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <functional>
#include <map>
#include <memory>

#include "rare_filter.h"
#include "reconstruct_input.h"
#include "reconstruct_settings.h"
#include "row_weights.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/time.h"
#include "tempera/core/vec.h"
#include "tempera/stages/poisson.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

using namespace reconstruction;

namespace {

const std::string kRareShareKey = "tempera/rare_light", kHeldShareKey = "tempera/held_back";
const std::vector<ParamSpec> kParams = {
    {"norm", std::string("l1"), "l1: robust, slightly biased; l2: unbiased", -1e300, 1e300, {"l1", "l2"}},
    {"alpha", 0.2, "weight of the noisy picture against the differences", 1e-3, 1e3},
    {"window", 10, "frames that are solved together; 1: each frame alone", 1, 256},
    {"overlap", -1, "frames that consecutive windows share; -1: half of the window", -1, 255},
    {"temporal_rows",
     std::string("all"),
     "differences over time that are used: all, dt (not the mixed ones) or none",
     -1e300,
     1e300,
     {"all", "dt", "none"}},
    {"strict_mixed", false, "use mixed differences only where the neighbouring pixel moves along"},
    {"weights",
     std::string("auto"),
     "weights of differences: uniform; variance: the less, the noisier they are around, as the two passes of "
     "temporal_gradient_path tell; auto: variance with l1, uniform with l2, which they would bias",
     -1e300,
     1e300,
     {"auto", "uniform", "variance"}},
    {"rare",
     std::string("auto"),
     "light of rare bright paths: apart: kept out of the differences, held back where it outshines its surroundings by "
     "far, smoothed and added again; together: as all other light; auto: apart with l1 if the frames have the layers "
     "for it, together with l2, which it would bias",
     -1e300,
     1e300,
     {"auto", "apart", "together"}},
    {"parts",
     std::string("yes"),
     "whether the two parts of frames with rare light apart are written for a denoiser: color.common, color.rare",
     -1e300,
     1e300,
     {"yes", "no"}},
    {"schedule",
     std::string("fast"),
     "how l1 reweights: fast (6 rounds of 15 steps) or published (20 of 50)",
     -1e300,
     1e300,
     {"fast", "published"}},
    {"device",
     std::string("cpu"),
     "what solves: cpu; cuda in builds with it, the same but for rounding",
     -1e300,
     1e300,
     {"cpu", "cuda"}},
    {"rounds", 0, "rounds of l1; 0: as the schedule says", 0, 1000},
    {"iterations", 0, "steps of each round of l1, or of l2; 0: as the schedule says", 0, 100000},
};

/// The frames of a window and a few around it, in order without gaps.
class FrameBuffer {
 public:
  FrameBuffer(const Reader& reader, const Settings& settings) : reader_(reader), settings_(settings) {}

  /// Makes frames first to last available; forgets those before `first`. Errors: those of reading.
  void hold(int first, int last, const std::function<void()>& before_read) {
    while (!slots_.empty() && slots_.front().frame < first) slots_.pop_front();
    if (slots_.empty() && !(last_read_ && last_read_->frame == first - 1)) last_read_.reset();
    for (int f = slots_.empty() ? first : slots_.back().frame + 1; f <= last; ++f) {
      before_read();
      read(f);
    }
  }
  /// Part 0: of all light; k + 1: of class k.
  const PoissonFrame& frame(int f, std::size_t part) const { return *slot(f).parts[part].data; }
  const RareFrame& rare(int f) const { return slot(f).rare; }
  const LightShares& shares(int f) const { return slot(f).shares; }
  /// By part; empty if there are none.
  const std::vector<Image>& photons(int f) const { return slot(f).photons; }
  /// Whether frame f continues f - 1: some of its pixels replay pixels of that, and the camera is the same. True for
  /// the first frame that was read, which nothing is known about.
  bool continues(int f) const { return slot(f).continues; }

 private:
  struct Part {
    std::unique_ptr<PoissonFrame> data;
    double variance = 0;  ///< the reference of set_spatial_precision
  };
  struct Slot {
    int frame = 0;
    std::vector<Part> parts;
    bool continues = true;
    RareFrame rare;  ///< empty unless it is solved for apart
    LightShares shares;
    std::vector<Image> photons;
  };
  static const PassPair& light(const Input& in, std::size_t part) {
    return part == 0 ? in.light : in.classes[part - 1];
  }
  const Slot& slot(int f) const { return slots_[f - slots_.front().frame]; }

  void read(int f) {
    auto in = std::make_unique<Input>(reader_.read(f));
    const int w = reader_.width(), h = reader_.height();
    Slot slot{f, std::vector<Part>(in->classes.size() + 1)};
    if (settings_.apart) slot.rare = take_rare_light(*in, slot.shares);
    slot.photons = std::move(in->photons);
    const PoissonNorm norm = settings_.poisson.norm;
    for (std::size_t k = 0; k < slot.parts.size(); ++k) {
      auto& [data, variance] = slot.parts[k];
      data = std::make_unique<PoissonFrame>(w, h);
      combine_passes(*in, light(*in, k), *data);
      if (settings_.weighted)
        variance = set_spatial_precision(*data, variance_between_passes(*in, light(*in, k), w, h), norm);
    }
    if (last_read_) {
      slot.continues = false;
      if (settings_.temporal && in->camera == last_read_->camera) {
        const MotionRuns runs(replay_map(*in, w, h), settings_.runs, in->sampled);
        slot.continues = runs.count() > 0;
        for (std::size_t k = 0; slot.continues && !slots_.empty() && k < slot.parts.size(); ++k) {
          const auto& [data, variance] = slots_.back().parts[k];
          data->motion = runs;
          subtract_passes(light(*last_read_, k).base, light(*in, k).offset, *data);
          if (settings_.weighted) set_temporal_precision(*data, variance, norm);
        }
      }
    }
    // Only the base pass meets the next frame.
    in->light.offset = {}, in->source = {}, in->sampled = {};
    for (PassPair& c : in->classes) c.offset = {};
    in->base_rare = in->offset_rare = {}, in->base_held = in->offset_held = {}, in->rare_halves = {};
    last_read_ = std::move(in);
    slots_.push_back(std::move(slot));
  }

  const Reader& reader_;
  const Settings& settings_;
  std::deque<Slot> slots_;
  std::unique_ptr<Input> last_read_;
};

/// A frame of the result, blended from the windows that hold it.
struct Blend {
  std::vector<PlanarFrames> solutions;  ///< of the Poisson rows: of all light, then of each class
  Image rare;                           ///< smoothed rare light; empty if there is none
  Image unfiltered;                     ///< the same before it was smoothed; empty unless parts are written
  std::vector<Image> photons;           ///< light of photons, by part; empty if there is none
  LightShares shares;
  double weight = 0;

  void add(std::span<const PlanarFrames> parts, int t, const Image& light, double window) {
    weight += window;
    const float share = float(window / weight);  // 1 for the first window
    solutions.resize(parts.size());
    for (std::size_t k = 0; k < parts.size(); ++k) {
      const PlanarFrames& x = parts[k];
      PlanarFrames& solution = solutions[k];
      if (solution.frames() == 0) solution = PlanarFrames(x.width(), x.height(), 1);
      for (int y = 0; y < x.height(); ++y) {
        for (int c = 0; c < 3; ++c) {
          const float* from = x.row(t, y, c);
          float* to = solution.row(0, y, c);
          for (int i = 0; i < x.width(); ++i) to[i] += share * (from[i] - to[i]);
        }
      }
    }
    if (light.empty()) return;
    if (rare.empty()) rare = Image(parts[0].width(), parts[0].height(), 3);
    const std::span<const float> from = light.values();
    const std::span<float> to = rare.values();
    for (std::size_t i = 0; i < to.size(); ++i) to[i] += share * (from[i] - to[i]);
  }
};

/// Solves for consecutive frames, from their noisy pictures.
PlanarFrames solve(const std::vector<const PoissonFrame*>& frames, const PoissonSettings& settings,
                   const std::function<void(double)>& progress) {
  PlanarFrames x(frames[0]->width(), frames[0]->height(), int(frames.size()));
  for (int t = 0; t < x.frames(); ++t) {
    for (int y = 0; y < x.height(); ++y) {
      for (int c = 0; c < 3; ++c) {
        std::copy_n(frames[t]->data(RowSet::kPrimal, y, c), x.width(), x.row(t, y, c));
      }
    }
  }
  solve_poisson(frames, settings, x, {}, progress);
  return x;
}

/// Fills a frame that has what passes through.
void fill(const Blend& blend, const Settings& settings, Frame& frame) {
  if (settings.parts) frame.create(layers::color_common()), frame.create(layers::color_rare());
  Image& color = frame.layer(layers::color().name);
  Image* common = settings.parts ? &frame.layer(layers::color_common().name) : nullptr;
  const PlanarFrames& x = blend.solutions[0];
  parallel_rows(
      0, x.height(),
      [&](int y) {
        for (int i = 0; i < x.width(); ++i) {
          Rgb value(x.row(0, y, 0)[i], x.row(0, y, 1)[i], x.row(0, y, 2)[i]);
          if (!blend.photons.empty()) value += blend.photons[0].rgb(i, y);
          if (settings.apart) {  // there is no negative light
            const auto positive = [](const Rgb& v) {
              return Rgb(std::max(v.r, 0.0f), std::max(v.g, 0.0f), std::max(v.b, 0.0f));
            };
            if (common) common->set_rgb(i, y, positive(value));
            if (!blend.rare.empty()) value += blend.rare.rgb(i, y);
            value = positive(value);
          }
          for (int c = 0; c < 3; ++c) color.pixel(i, y)[c] = value[c];
        }
      },
      16);
  for (std::size_t k = 0; k < settings.classes.size(); ++k) {
    const PlanarFrames& solution = blend.solutions[k + 1];
    Image& to = frame.layer(layers::class_layer(settings.classes[k], layers::color()).name);
    for (int y = 0; y < to.height(); ++y) {
      for (int i = 0; i < to.width(); ++i) {
        Rgb value(solution.row(0, y, 0)[i], solution.row(0, y, 1)[i], solution.row(0, y, 2)[i]);
        if (!blend.photons.empty()) value += blend.photons[k + 1].rgb(i, y);
        to.set_rgb(i, y, value);
      }
    }
  }
  if (settings.parts) frame.layer(layers::color_rare().name) = blend.unfiltered;
  if (!settings.apart) return;
  frame.metadata[kRareShareKey] = blend.shares.rare_share();
  frame.metadata[kHeldShareKey] = blend.shares.held_share();
}

/// The mean of both estimates.
Image mean_light(const RareFrame& f) {
  Image out = f.light[0];
  const std::span<const float> other = f.light[1].values();
  for (std::size_t i = 0; i < other.size(); ++i) out.values()[i] = 0.5f * (out.values()[i] + other[i]);
  return out;
}

class Reconstruct final : public Stage {
 public:
  explicit Reconstruct(const Params& params) : params_(params) {
    Settings(params_, true, true);  // what the parameters say together is checked whatever the frames are
  }

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    const Settings s = settings(in);
    SequenceDesc out = in[0];
    std::erase_if(out.layers, [&](const LayerDesc& d) { return !survives(d, s); });
    if (s.parts) {
      for (const LayerDesc& d : {layers::color_common(), layers::color_rare()}) {
        if (!out.has(d)) out.layers.push_back(d);
      }
    }
    return out;
  }

  std::vector<LayerUse> reads(int /*port*/, std::span<const SequenceDesc> in) const override {
    return layers_read(settings(in));
  }

  std::vector<int> inputs(int /*port*/, int frame, std::span<const SequenceDesc> in) const override {
    const Settings s = settings(in);
    if (s.window == 1) return {frame};
    const FrameRange range = s.grid().around(frame, in[0].reach);
    return frames_around(frame, frame - range.first, range.last - frame, in[0]);
  }

  void run(StageRun& run) const override;

 private:
  Settings settings(std::span<const SequenceDesc> in) const {
    std::vector<std::string> classes;
    for (const LayerDesc& d : in[0].layers) {
      if (d.pass.empty() && !d.path_class.empty() && d == layers::class_layer(d.path_class, layers::grad_x()))
        classes.push_back(d.path_class);
    }
    Settings s(params_, in[0].has(layers::offset(layers::color())), in[0].has(layers::rare_color()),
               std::move(classes));
    s.photons = in[0].has(layers::photon_color());
    return s;
  }
  /// Whether the output holds this layer of the input: neither data of the reconstruction, nor statistics or parts of
  /// the input's `color`, which are not those of the solution.
  static bool survives(const LayerDesc& d, const Settings& settings) {
    const bool solved = d.role == LayerRole::kPicture && std::find(settings.classes.begin(), settings.classes.end(),
                                                                   d.path_class) != settings.classes.end();
    return d.pass.empty() && (d.path_class.empty() || solved) && d.role != LayerRole::kStatistic &&
           d.role != LayerRole::kReconstruction;
  }

  Params params_;
};

void Reconstruct::run(StageRun& run) const {
  const Settings settings = this->settings(run.in());
  const WindowGrid grid = settings.grid();
  const FrameRange reach = run.in()[0].reach;
  const std::vector<int>& targets = run.frames();
  std::vector<std::string> classes;
  for (const LayerDesc& d : run.in()[0].layers) {
    if (!d.path_class.empty() && d.pass.empty() && d.role == LayerRole::kPicture && !survives(d, settings))
      classes.push_back(d.name);
  }
  if (!classes.empty()) {
    log_info(
        fmt::format("left out of the final frames, as they are not reconstructed and would not add up to color: "
                    "{}; the frames of the integrator have them (class_gradients = true makes them part of it)",
                    fmt::join(classes, ", ")));
  }
  std::vector<int> windows, cuts;
  for (const int f : targets) {
    for (int k = grid.first_with(f); k <= grid.last_with(f); ++k) {
      if (windows.empty() || windows.back() < k) windows.push_back(k);
    }
  }

  const Reader reader(run, settings);
  FrameBuffer buffer(reader, settings);
  std::map<int, Blend> blends;
  LightShares shares;
  for (std::size_t n = 0; n < windows.size(); ++n) {
    const int k = windows[n];
    const auto progress = [&](double share) { run.progress((double(n) + share) / double(windows.size())); };
    const FrameRange range = grid.clipped(k, reach);
    constexpr double kReading = 0.1;  // a guess at its share of the time
    double read = 0;
    buffer.hold(range.first, range.last, [&] { progress(kReading * read++ / (range.last - range.first + 1)); });
    for (int first = range.first; first <= range.last;) {
      int last = first;
      while (last < range.last && buffer.continues(last + 1)) ++last;
      const FrameRange piece{first, last};
      first = last + 1;
      const int cut = last + 1;
      if (cut <= range.last && (cuts.empty() || cuts.back() < cut)) cuts.push_back(cut);
      const auto target = std::lower_bound(targets.begin(), targets.end(), piece.first);
      if (target == targets.end() || *target > piece.last) continue;
      bool goes_on = false;
      if (piece.first >= grid.begin(k) + grid.step && last == range.last && last < reach.last) {
        buffer.hold(range.first, last + 1, [&] { run.check_stop(); });
        goes_on = buffer.continues(last + 1);
      }
      if (!keeps_piece(piece, goes_on, grid.begin(k), grid.length, grid.step)) continue;

      std::vector<PlanarFrames> parts;
      const std::size_t count = settings.classes.size() + 1;
      for (std::size_t part = 0; part < count; ++part) {
        std::vector<const PoissonFrame*> frames;
        for (int f = piece.first; f <= piece.last; ++f) frames.push_back(&buffer.frame(f, part));
        parts.push_back(solve(frames, settings.poisson, [&](double share) {
          progress(kReading + (1 - kReading) * (double(part) + share) / double(count));
        }));
      }
      std::vector<const RareFrame*> rare;
      for (int f = piece.first; settings.apart && f <= piece.last; ++f) rare.push_back(&buffer.rare(f));
      RareFilter filter(rare, parts[0]);
      for (auto it = target; it != targets.end() && *it <= piece.last; ++it) {
        const int f = *it, t = f - piece.first;
        Blend& blend = blends[f];
        blend.add(parts, t, filter.dark() ? Image() : filter.smooth(t), window_weight(f, grid.begin(k), grid.length));
        if (settings.apart) blend.shares = buffer.shares(f);
        if (blend.photons.empty()) blend.photons = buffer.photons(f);
        if (settings.parts && blend.unfiltered.empty()) blend.unfiltered = mean_light(buffer.rare(f));
      }
    }
    // Frames that no later window covers are final.
    const int open = n + 1 < windows.size() ? grid.begin(windows[n + 1]) : reach.last + 1;
    while (!blends.empty() && blends.begin()->first < open) {
      const auto& [f, blend] = *blends.begin();
      Frame frame = run.start(f);
      fill(blend, settings, frame);
      if (settings.apart) shares += blend.shares;
      run.write(f, std::move(frame));
      blends.erase(blends.begin());
    }
  }
  if (settings.apart) {
    run.note(
        fmt::format("{:.2g} % of the light was kept apart as that of rare bright paths; of all light {:.2g} % was "
                    "held back, because it outshines its surroundings by far",
                    100 * shares.rare_share(), 100 * shares.held_share()));
  }
  if (!cuts.empty()) run.note(fmt::format("cuts before frames {}", describe_frames(cuts)));
}

bool has_differences(std::span<const LayerDesc> layers) {
  const auto has = [&](const LayerDesc& layer) {
    return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
  };
  return has(layers::grad_x()) && has(layers::grad_y());
}

}  // namespace

extern const StageEntry reconstruct_entry;
const StageEntry reconstruct_entry{
    .name = "reconstruct",
    .help = "final frames from the pictures and differences of gradient_path and temporal_gradient_path",
    .command_help = "Make final frames of what gradient_path and temporal_gradient_path rendered.",
    .done = "reconstructed",
    .params = kParams,
    .ports = {{"in", "rendered frames"}},
    .output_help = "final frames",
    .reads = {{{"color", "grad.x", "grad.y"}, "needed: the picture and its differences over space"},
              {{"offset.color", "offset.grad.x", "offset.grad.y", "offset.source"},
               "needed together, for differences over time: the pass that replays the frame before"},
              {{"rare.color", "rare.grad.x", "rare.grad.y", "held.color", "offset.rare.color", "offset.rare.grad.x",
                "offset.rare.grad.y", "offset.held.color", "rare.a", "rare.b"},
               "needed with `rare = \"apart\"`: the light of rare paths, of both passes or of one and its halves"},
              {{"photon.color", "offset.photon.color"},
               "light of photons, which has no differences, where it is there"},
              {{"samples", "offset.samples", "albedo", "normal", "object_id"}, "read where they are there"}},
    .writes = {{{"color"}, "the solution, with the input's alpha"},
               {{"color.common", "color.rare"}, "its two parts, with rare light apart and `parts = \"yes\"`"},
               {{"class.<name>.color"}, "of light-path classes with differences (`class_gradients`): their solutions"}},
    .window = "those that share a window with it (`window`, `overlap`), if they have an offset pass",
    .gap_help = "without them there are no differences over time (give --temporal-rows none to do without)",
    .examples =
        {"tempera reconstruct out/frame.####.exr -o final/frame.####.exr",
         "tempera reconstruct out/ -o final/ --norm l2 --window 20 --overlap 10 --resume",
         "tempera reconstruct out/ -o final/ --frames 1-24   (part of a sequence: the same bits as all at once)",
         "tempera reconstruct still.exr -o final.exr"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<Reconstruct>(p); },
    .follows = has_differences,
    .follows_help = "noisy pictures with differences"};

}  // namespace tempera
