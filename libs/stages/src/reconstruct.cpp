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
// `color` is the solution, with the input's alpha. With rare light apart it has no negative values, and `color.common`
// and `color.rare` are its two parts, the second one before it was smoothed; the metadata tempera/rare_light and
// tempera/held_back are the shares of these lights. Light-path classes whose differences are there are solved each by
// itself, with all of their light, in the same windows. Source: [Manzi 2016, Sec. 3.3, 4.2, 5].
#include "tempera/stages/reconstruct.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>

#include "rare_filter.h"
#include "row_weights.h"
#include "tempera/core/log.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/core/time.h"
#include "tempera/core/vec.h"
#include "tempera/stages/poisson.h"
#include "tempera/stages/stage_run.h"

namespace tempera {
namespace {

const std::string kRareShareKey = "tempera/rare_light", kHeldShareKey = "tempera/held_back";
const std::string kCameraKey = "tempera/camera", kCropLeftKey = "tempera/crop_left", kCropTopKey = "tempera/crop_top";

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

std::string layer_file(const std::string& path, const std::string& layer) {
  return fmt::format("{}: layer \"{}\"", path, layer);
}

[[noreturn]] void bad_layer(const std::string& path, const std::string& layer, const std::string& what) {
  throw Error(ErrorCode::kBadInput, layer_file(path, layer) + " " + what);
}

int floor_div(int a, int b) { return a >= 0 ? a / b : -((-a + b - 1) / b); }

/// Windows of a sequence by number.
struct WindowGrid {
  int length, step;
  int begin(int k) const { return k * step; }
  int end(int k) const { return k * step + length - 1; }  ///< its last frame
  int first_with(int frame) const { return floor_div(frame - length, step) + 1; }
  int last_with(int frame) const { return floor_div(frame, step); }
  /// The frames of window k that the sequence has.
  FrameRange clipped(int k, const FrameRange& sequence) const {
    return {std::max(begin(k), sequence.first), std::min(end(k), sequence.last)};
  }
  /// The frames that share a window with `frame`.
  FrameRange around(int frame, const FrameRange& sequence) const {
    return {clipped(first_with(frame), sequence).first, clipped(last_with(frame), sequence).last};
  }
};

/// Parameters in the form in which the stage needs them.
struct Settings {
  /// `two_passes`: whether the frames have an offset pass; without it there is nothing that windows could share.
  /// `rare`: whether they have the layers of rare light. `class_names`: of those that have differences.
  Settings(const Params& p, bool two_passes, bool rare, std::vector<std::string> class_names = {})
      : temporal(two_passes), classes(std::move(class_names)) {
    poisson = p.get_string("schedule") == "published" ? PoissonSettings::published() : PoissonSettings{};
    poisson.norm = p.get_string("norm") == "l1" ? PoissonNorm::kL1 : PoissonNorm::kL2;
    if (p.get_string("device") == "cuda") poisson.device = PoissonDevice::kCuda;
    poisson.weights.alpha = float(p.get_double("alpha"));
    if (const int n = p.get_int("rounds"); n > 0) poisson.rounds = n;
    if (const int n = p.get_int("iterations"); n > 0) poisson.l2_steps = poisson.round_steps = n;
    const std::string& rows = p.get_string("temporal_rows");
    runs.mixed = rows == "all";
    runs.strict_mixed = p.get_bool("strict_mixed");
    if (!runs.mixed) poisson.weights.mixed = 0;
    const std::string& rule = p.get_string("weights");
    if (!temporal && rule == "variance") {
      throw Error(
          ErrorCode::kBadInput,
          "weights = \"variance\" compares the two passes of temporal_gradient_path, and these frames have one; "
          "auto and uniform take any");
    }
    weighted = temporal && (rule == "variance" || (rule == "auto" && poisson.norm == PoissonNorm::kL1));
    const std::string& rare_rule = p.get_string("rare");
    if (rare_rule == "apart" && !rare) {
      throw Error(ErrorCode::kBadInput,
                  "rare = \"apart\" needs frames with the layers of rare light (rare.color and others), which gradient-"
                  "domain integrators write unless told not to (rare = false); auto and together take any");
    }
    apart = rare && (rare_rule == "apart" || (rare_rule == "auto" && poisson.norm == PoissonNorm::kL1));
    parts = apart && p.get_string("parts") == "yes";
    window = p.get_int("window");
    overlap = p.get_int("overlap");
    if (overlap < 0) overlap = window / 2;
    if (overlap >= window) {
      throw StageParamError(
          ErrorCode::kOutOfRange, {"overlap", "window"},
          fmt::format("an overlap of {} frames needs windows of more than {}, not of {}", overlap, overlap, window));
    }
    if (rows == "none" || !temporal) window = 1, overlap = 0;
  }
  WindowGrid grid() const { return {window, window - overlap}; }
  PoissonSettings poisson;
  MotionRunOptions runs;
  bool temporal;                     ///< whether the frames have an offset pass
  bool weighted = false;             ///< whether differences are weighted by their variance
  bool apart = false;                ///< whether rare light is solved for apart
  bool parts = false;                ///< whether both parts are written
  std::vector<std::string> classes;  ///< light-path classes that are solved for, too
  int window = 10, overlap = 5;
};

/// Whether the part `piece` of window k is solved, or left to a neighbouring window that contains it.
/// `goes_on`: the segment has frames after the piece.
bool keeps_piece(const FrameRange& piece, bool goes_on, int begin, int length, int step) {
  const bool in_previous = piece.last <= begin + length - 1 - step;
  const bool in_next = piece.first >= begin + step && goes_on;  // else the next one is equal and leaves it to this one
  return !in_previous && !in_next;
}

/// The layers of one pass of a file.
struct Pass {
  Image color, grad_x, grad_y;
};

/// What a sequence of pictures is solved from, in one frame.
struct PassPair {
  Pass base, offset;  ///< offset: empty images without an offset pass
};

/// What a file holds for the reconstruction.
struct Input {
  std::string path;
  int frame = 0;
  PassPair light;                 ///< all of it, or without rare light
  std::vector<PassPair> classes;  ///< of each of Settings::classes
  /// Rare light among theirs, and what of it is held back; empty unless it is solved for apart.
  Pass base_rare, offset_rare;
  Image base_held, offset_held;
  std::array<Image, 2> rare_halves;  ///< without an offset pass: what is not held back, of both halves
  Image albedo, normal, object;      ///< empty if the file has none
  float samples = 0;                 ///< of a pixel, all passes, on average; 0: unknown
  Image source;
  std::vector<std::uint8_t> sampled;  ///< pixels of the offset pass that have samples; empty without that pass
  bool is_sampled(int x, int y) const {
    return !sampled.empty() && sampled[std::size_t(y) * std::size_t(light.base.color.width()) + std::size_t(x)] != 0;
  }
  int crop_left = 0, crop_top = 0;  ///< of the file in the full picture
  bool cropped = false;
  std::string camera;
};

template <class T>
std::optional<T> metadata_value(const Metadata& m, const std::string& key) {
  const auto it = m.find(key);
  const T* v = it == m.end() ? nullptr : std::get_if<T>(&it->second);
  return v ? std::optional<T>(*v) : std::nullopt;
}

float mean_of(const Image& image) {
  double sum = 0;
  for (const float v : image.values()) sum += double(v);
  return float(sum / double(image.values().size()));
}

/// Refuses values that are not finite among those that the reconstruction uses: one would spoil a whole window.
/// `used(x, y)`: whether the value counts.
template <class F>
void check_finite(const std::string& path, const std::string& layer, const Image& image, int width, int height,
                  F&& used) {
  std::vector<int> bad(std::size_t(height), -1);
  parallel_for(
      0, height,
      [&](std::int64_t y) {
        for (int x = 0; x < width; ++x) {
          if (!is_finite(image.rgb(x, int(y))) && used(x, int(y))) {
            bad[y] = x;
            return;
          }
        }
      },
      16);
  for (int y = 0; y < height; ++y) {
    if (bad[y] < 0) continue;
    bad_layer(path, layer, fmt::format("has a value that is not finite at pixel {},{}", bad[y], y));
  }
}

/// Layers that are read of each frame. `why`: what frames need to have them.
std::vector<LayerUse> layers_read(const Settings& settings) {
  std::vector<LayerDesc> required{layers::color(), layers::grad_x(), layers::grad_y()};
  for (const std::string& name : settings.classes) {
    for (const LayerDesc& d : {layers::color(), layers::grad_x(), layers::grad_y()})
      required.push_back(layers::class_layer(name, d));
  }
  if (settings.apart) {
    for (const LayerDesc& d :
         {layers::rare_color(), layers::rare_grad_x(), layers::rare_grad_y(), layers::held_color()})
      required.push_back(d);
  }
  if (settings.temporal) {
    for (const std::vector<LayerDesc> base = required; const LayerDesc& d : base) required.push_back(layers::offset(d));
    required.push_back(layers::offset(layers::source()));
  } else if (settings.apart) {
    required.push_back(layers::rare_a()), required.push_back(layers::rare_b());
  }
  std::vector<LayerUse> out;
  for (const LayerDesc& d : required) {
    out.push_back({d, true,
                   fmt::format("reconstruction needs the frames of the integrator {}",
                               settings.temporal ? "temporal_gradient_path" : "gradient_path")});
  }
  if (settings.temporal) out.push_back({layers::offset(layers::samples()), false});
  if (settings.apart) {
    for (const LayerDesc& d : {layers::samples(), layers::albedo(), layers::normal(), layers::object_id()})
      out.push_back({d, false});
  }
  return out;
}

/// Takes a frame's layers apart and checks them.
class Reader {
 public:
  Reader(const StageRun& run, const Settings& settings)
      : run_(run), settings_(settings), width_(run.in()[0].width), height_(run.in()[0].height) {}
  int width() const { return width_; }
  int height() const { return height_; }

  Input read(int frame) const {
    const bool rare = settings_.apart, temporal = settings_.temporal;
    Input in;
    in.frame = frame;
    in.path = run_.path(frame);
    const std::string samples = layers::offset(layers::samples()).name;
    Frame file = run_.read(frame);
    const auto take = [&](const std::string& name, int channels) {
      Image& image = file.layer(name);
      if (image.channels() < channels)
        bad_layer(in.path, name, fmt::format("has {} channels, not {}", image.channels(), channels));
      return std::move(image);
    };
    const auto take_pass = [&](const std::string& prefix) {
      return Pass{take(prefix + "color", 3), take(prefix + "grad.x", 3), take(prefix + "grad.y", 3)};
    };
    const auto all = [](int, int) { return true; };
    const auto take_base = [&](const std::string& prefix) {
      Pass pass = take_pass(prefix);
      check_finite(in.path, prefix + "color", pass.color, width_, height_, all);
      check_finite(in.path, prefix + "grad.x", pass.grad_x, width_ - 1, height_, all);
      check_finite(in.path, prefix + "grad.y", pass.grad_y, width_, height_ - 1, all);
      return pass;
    };
    in.light.base = take_base("");
    for (const std::string& name : settings_.classes) in.classes.push_back({take_base("class." + name + "."), {}});
    in.camera = metadata_value<std::string>(file.metadata, kCameraKey).value_or("");
    const auto left = metadata_value<int>(file.metadata, kCropLeftKey),
               top = metadata_value<int>(file.metadata, kCropTopKey);
    in.cropped = left || top;
    in.crop_left = left.value_or(0), in.crop_top = top.value_or(0);
    if (rare) {
      take_rare(in, "", in.base_rare, in.base_held, take_pass, take);
      const auto take_if = [&](const LayerDesc& d, int channels) {
        return file.find(d.name) ? take(d.name, channels) : Image();
      };
      in.albedo = take_if(layers::albedo(), 3), in.normal = take_if(layers::normal(), 3);
      in.object = take_if(layers::object_id(), 1);
      for (const char* name : {"samples", "offset.samples"}) {
        if (const Layer* counts = file.find(name)) in.samples += mean_of(counts->image);
      }
      if (!temporal) {
        in.rare_halves = {take(layers::rare_a().name, 3), take(layers::rare_b().name, 3)};
        check_finite(in.path, "rare.a", in.rare_halves[0], width_, height_, all);
        check_finite(in.path, "rare.b", in.rare_halves[1], width_, height_, all);
      }
    }
    if (!temporal) return in;

    in.source = take(layers::offset(layers::source()).name, 3);
    const Image* counts = file.find(samples) ? &file.layer(samples) : nullptr;
    in.sampled.resize(std::size_t(width_) * std::size_t(height_));
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        in.sampled[index(x, y)] = counts ? counts->at(x, y) > 0 : in.source.at(x, y, 2) > 0;
      }
    }
    const auto here = [&](int x, int y) { return in.is_sampled(x, y); };
    const auto take_offset = [&](const std::string& prefix) {
      Pass pass = take_pass(prefix);
      check_finite(in.path, prefix + "color", pass.color, width_, height_, here);
      check_finite(in.path, prefix + "grad.x", pass.grad_x, width_ - 1, height_,
                   [&](int x, int y) { return here(x, y) && here(x + 1, y); });
      check_finite(in.path, prefix + "grad.y", pass.grad_y, width_, height_ - 1,
                   [&](int x, int y) { return here(x, y) && here(x, y + 1); });
      return pass;
    };
    in.light.offset = take_offset("offset.");
    for (std::size_t k = 0; k < in.classes.size(); ++k)
      in.classes[k].offset = take_offset("offset.class." + settings_.classes[k] + ".");
    if (rare) take_rare(in, "offset.", in.offset_rare, in.offset_held, take_pass, take);
    return in;
  }

  std::size_t index(int x, int y) const { return std::size_t(y) * std::size_t(width_) + std::size_t(x); }

 private:
  template <class TakePass, class Take>
  void take_rare(const Input& in, const std::string& prefix, Pass& rare, Image& held, TakePass&& take_pass,
                 Take&& take) const {
    rare = take_pass(prefix + "rare.");
    held = take(prefix + "held.color", 3);
    const auto check = [&](const std::string& name, const Image& image, int dx, int dy) {
      check_finite(in.path, prefix + name, image, width_ - dx, height_ - dy, [](int, int) { return true; });
    };
    check("rare.color", rare.color, 0, 0), check("held.color", held, 0, 0);
    check("rare.grad.x", rare.grad_x, 1, 0), check("rare.grad.y", rare.grad_y, 0, 1);
  }

  const StageRun& run_;
  const Settings& settings_;
  int width_, height_;
};

/// phi from the frame before to `in`, whose offset pass tells the inverse. [Manzi 2016, Sec. 4.2]
PixelMap replay_map(const Input& in, int width, int height) {
  PixelMap map(width, height);
  const std::string layer = layers::offset(layers::source()).name;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float* s = in.source.pixel(x, y);
      if (!(s[2] > 0)) continue;
      const float sx = s[0] - float(in.crop_left), sy = s[1] - float(in.crop_top);
      const bool inside = sx >= 0 && sy >= 0 && sx < float(width) && sy < float(height);
      if (!inside && in.cropped) continue;  // what it replays is not in the file of the frame before
      if (!inside || sx != std::floor(sx) || sy != std::floor(sy)) {
        bad_layer(in.path, layer,
                  fmt::format("names {},{} at pixel {},{}, which is no pixel of the frame before", s[0], s[1], x, y));
      }
      if (!map.link(int(sx), int(sy), x, y)) {
        const Vec2<int> other = map.forward(int(sx), int(sy));
        bad_layer(in.path, layer,
                  fmt::format("names {},{} at two pixels, {},{} and {},{}: it must be one-to-one", s[0], s[1], other.x,
                              other.y, x, y));
      }
    }
  }
  return map;
}

/// Primal and spatial data of a frame: means of the two passes where both have samples. [Manzi 2016, Sec. 4.2.1]
void combine_passes(const Input& in, const PassPair& light, PoissonFrame& out) {
  const int w = out.width(), h = out.height();
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        const auto set_row = [&](RowSet set, int x, const Image& base, const Image& offset, bool both) {
          const Rgb b = base.rgb(x, y), v = both ? (b + offset.rgb(x, y)) * 0.5f : b;
          for (int c = 0; c < 3; ++c) out.data(set, y, c)[x] = v[c];
        };
        for (int x = 0; x < w; ++x) {
          const bool here = in.is_sampled(x, y);
          const auto& [base, offset] = light;
          set_row(RowSet::kPrimal, x, base.color, offset.color, here);
          if (x + 1 < w) set_row(RowSet::kDx, x, base.grad_x, offset.grad_x, here && in.is_sampled(x + 1, y));
          if (y + 1 < h) set_row(RowSet::kDy, x, base.grad_y, offset.grad_y, here && in.is_sampled(x, y + 1));
        }
      },
      8);
}

/// Variances of the spatial data that combine_passes makes: the passes of a frame are independent estimates of the
/// same.
DataVariance variance_between_passes(const Input& in, const PassPair& light, int w, int h) {
  DataVariance out{Image(w, h, 1), Image(w, h, 1)};
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        const auto set_row = [&](Image& image, int x, const Image& base, const Image& offset, bool both) {
          const Rgb d = (base.rgb(x, y) - offset.rgb(x, y)) * 0.5f;
          image.at(x, y) = both ? (d.r * d.r + d.g * d.g + d.b * d.b) / 3 : -1;
        };
        for (int x = 0; x < w; ++x) {
          const bool here = in.is_sampled(x, y);
          const auto& [base, offset] = light;
          set_row(out.dx, x, base.grad_x, offset.grad_x, here && x + 1 < w && in.is_sampled(x + 1, y));
          set_row(out.dy, x, base.grad_y, offset.grad_y, here && y + 1 < h && in.is_sampled(x, y + 1));
        }
      },
      8);
  return out;
}

/// Temporal and mixed data of a frame: its base pass taken from the offset pass of the next one.
/// [Manzi 2016, Sec. 4.2.1]
void subtract_passes(const Pass& base, const Pass& next, PoissonFrame& out) {
  parallel_for(
      0, out.height(),
      [&](std::int64_t row) {
        const int y = int(row);
        for (const MotionRun& r : out.motion.from_row(y)) {
          const auto set_row = [&](RowSet set, int x, const Image& from, const Image& to) {
            const Rgb d = to.rgb(x + r.dx, y + r.dy) - from.rgb(x, y);
            for (int c = 0; c < 3; ++c) out.data(set, y, c)[x] = d[c];
          };
          for (int i = 0; i < r.length; ++i) {
            set_row(RowSet::kDt, r.x + i, base.color, next.color);
            if (i < r.mixed_x) set_row(RowSet::kDxDt, r.x + i, base.grad_x, next.grad_x);
            if (r.mixed_y) set_row(RowSet::kDyDt, r.x + i, base.grad_y, next.grad_y);
          }
        }
      },
      8);
}

/// Luminance of a picture, all its rare light, and what is held back of it: sums over pixels.
struct LightShares {
  double all = 0, rare = 0, held = 0;
  LightShares& operator+=(const LightShares& o) {
    all += o.all, rare += o.rare, held += o.held;
    return *this;
  }
  double rare_share() const { return all > 0 ? rare / all : 0; }
  double held_share() const { return all > 0 ? held / all : 0; }
};

/// Takes the rare light out of the passes of a frame. Adds to `shares` what it finds.
RareFrame take_rare_light(Input& in, LightShares& shares) {
  auto& [in_base, in_offset] = in.light;
  const int w = in_base.color.width(), h = in_base.color.height();
  const bool temporal = !in.sampled.empty();
  RareFrame out;
  out.light = {Image(w, h, 3), Image(w, h, 3)};
  if (in.samples > 0) out.samples = in.samples;
  const auto subtract = [](Image& from, const Image& what, int x, int y) {
    from.set_rgb(x, y, from.rgb(x, y) - what.rgb(x, y));
  };
  std::vector<LightShares> rows(std::size_t(h), LightShares{});
  std::vector<std::uint8_t> lit(std::size_t(h), 0);
  if (temporal) out.previous.assign(std::size_t(w) * std::size_t(h), -1);
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        for (int x = 0; x < w; ++x) {
          const Rgb base = in.base_rare.color.rgb(x, y) - in.base_held.rgb(x, y);
          Rgb all = in_base.color.rgb(x, y), rare = in.base_rare.color.rgb(x, y), held = in.base_held.rgb(x, y);
          std::array<Rgb, 2> light{base, base};
          if (!temporal) {
            light = {in.rare_halves[0].rgb(x, y), in.rare_halves[1].rgb(x, y)};
          } else if (in.is_sampled(x, y)) {
            light[1] = in.offset_rare.color.rgb(x, y) - in.offset_held.rgb(x, y);
            all = (all + in_offset.color.rgb(x, y)) * 0.5f, held = (held + in.offset_held.rgb(x, y)) * 0.5f;
            rare = (rare + in.offset_rare.color.rgb(x, y)) * 0.5f;
          }
          for (std::size_t k = 0; k < 2; ++k) {
            for (int c = 0; c < 3; ++c) light[k][c] = std::max(0.0f, light[k][c]);
            out.light[k].set_rgb(x, y, light[k]);
            lit[y] |= !is_black(light[k]);
          }
          rows[y] += {double(luminance(all)), double(luminance(rare)), double(luminance(held))};
          subtract(in_base.color, in.base_rare.color, x, y);
          subtract(in_base.grad_x, in.base_rare.grad_x, x, y);
          subtract(in_base.grad_y, in.base_rare.grad_y, x, y);
          if (!temporal) continue;
          subtract(in_offset.color, in.offset_rare.color, x, y);
          subtract(in_offset.grad_x, in.offset_rare.grad_x, x, y);
          subtract(in_offset.grad_y, in.offset_rare.grad_y, x, y);
          const float* s = in.source.pixel(x, y);
          const int sx = int(s[0]) - in.crop_left, sy = int(s[1]) - in.crop_top;
          if (s[2] > 0 && sx >= 0 && sy >= 0 && sx < w && sy < h)
            out.previous[std::size_t(y) * std::size_t(w) + std::size_t(x)] = sy * w + sx;
        }
      },
      8);
  for (const LightShares& row : rows) shares += row;
  out.dark = std::find(lit.begin(), lit.end(), 1) == lit.end();
  out.albedo = std::move(in.albedo), out.normal = std::move(in.normal), out.object = std::move(in.object);
  return out;
}

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
  for (std::size_t t = 0; t < frames.size(); ++t) {
    for (int y = 0; y < x.height(); ++y) {
      for (int c = 0; c < 3; ++c) {
        std::copy_n(frames[t]->data(RowSet::kPrimal, y, c), x.width(), x.row(int(t), y, c));
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
  parallel_for(
      0, x.height(),
      [&](std::int64_t row) {
        const int y = int(row);
        for (int i = 0; i < x.width(); ++i) {
          Rgb value(x.row(0, y, 0)[i], x.row(0, y, 1)[i], x.row(0, y, 2)[i]);
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
      for (int i = 0; i < to.width(); ++i)
        to.set_rgb(i, y, {solution.row(0, y, 0)[i], solution.row(0, y, 1)[i], solution.row(0, y, 2)[i]});
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

}  // namespace

std::vector<FrameRange> reconstruction_windows(const FrameRange& segment, int length, int overlap) {
  TEMPERA_ASSERT(overlap >= 0 && overlap < length && segment.first <= segment.last);
  const WindowGrid grid{length, length - overlap};
  std::vector<FrameRange> out;
  for (int k = grid.first_with(segment.first); k <= grid.last_with(segment.last); ++k) {
    const FrameRange piece{std::max(segment.first, grid.begin(k)), std::min(segment.last, grid.end(k))};
    if (keeps_piece(piece, piece.last < segment.last, grid.begin(k), length, grid.step)) out.push_back(piece);
  }
  return out;
}

double window_weight(int frame, int begin, int length) {
  const double k = frame - begin + 1;
  return 0.5 * (1 + std::cos(2 * kPiD * (k - 0.5 * (length + 1)) / length));
}

namespace {

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
    return Settings(params_, in[0].has(layers::offset(layers::color())), in[0].has(layers::rare_color()),
                    std::move(classes));
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
