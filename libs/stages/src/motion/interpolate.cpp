// SPDX-License-Identifier: Apache-2.0
// The stage `interpolate`: frames between key frames, see docs/motion-stages.md. Source: [Zimmer 2015, Sec. 5.3].
// DEVIATION [Zimmer 2015, Sec. 5.3]: keys are not splatted. What a frame in between shows is known from guides, which
// are rendered with few samples: their surfaces are followed to both keys, and light is gathered there.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "denoise/denoiser.h"
#include "denoise/planes.h"
#include "motion/projection.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

namespace {

using denoise::box_mean;
using denoise::Planes;
using motion::Place;
using motion::Surfaces;
using motion::Taps;

enum Port { kKeys, kGuides };

const std::vector<ParamSpec> kParams = {
    {"every", 4, "distance of key frames, from the first frame on; 0: all frames that there are", 0, 1000},
    {"cuts", std::string(),
     "first frames of new shots, e.g. 25,61: each is a key, and so is the frame before it; a shot's own are known"},
};

/// Reflectance that light is divided by at least, so that black surfaces and the background need no rule of their own.
constexpr float kLeastAlbedo = 0.05f;

/// The layers that light is known by.
struct Light {
  Planes color;     ///< [h,w,3] radiance
  Planes alpha;     ///< [h,w,1]
  Planes divisor;   ///< [h,w,3] reflectance, kLeastAlbedo at least
  Planes emission;  ///< [h,w,3]
};

const Image* image_of(const Frame& frame, const LayerDesc& desc, int channels, const char* what, int number) {
  const Layer* layer = frame.find(desc.name);
  if (!layer) return nullptr;
  if (layer->image.channels() < channels) {
    throw Error(ErrorCode::kBadInput, fmt::format("{} {}: the layer \"{}\" has {} channels, {} are needed", what,
                                                  number, desc.name, layer->image.channels(), channels));
  }
  return &layer->image;
}

Planes planes_of(const Image* image, int channels, float missing, int w, int h) {
  if (!image) return {w, h, channels, missing};
  Planes out(*image, channels);
  for (float& v : out.values()) {
    if (!std::isfinite(v)) v = 0;
  }
  return out;
}

Light light_of(const Frame& frame, const char* what, int number) {
  const int w = frame.width(), h = frame.height();
  Light light;
  const Image* color = image_of(frame, layers::color(), 3, what, number);
  light.color = planes_of(color, 3, 0, w, h);
  light.alpha = Planes(w, h, 1, 1);
  if (color && color->channels() >= 4) {
    for (std::size_t i = 0; i < light.alpha.pixels(); ++i)
      light.alpha.plane(0)[i] = color->values()[i * std::size_t(color->channels()) + 3];
  }
  light.divisor = planes_of(image_of(frame, layers::albedo(), 3, what, number), 3, 1, w, h);
  for (float& v : light.divisor.values()) v = std::max(v, kLeastAlbedo);
  light.emission = planes_of(image_of(frame, layers::emission(), 3, what, number), 3, 0, w, h);
  return light;
}

/// (color - emission) / divisor.
Planes irradiance(const Planes& color, const Light& light) {
  Planes out = color;
  for (std::size_t i = 0; i < out.values().size(); ++i) {
    out.values()[i] = (color.values()[i] - light.emission.values()[i]) / light.divisor.values()[i];
  }
  return out;
}

/// A frame that is not made but read.
struct Known {
  const Frame* frame = nullptr;
  Surfaces surfaces;
};

/// What a key says of the frame that is made.
struct Gathered {
  Grid<Place> places;
  Planes irradiance;  ///< [h,w,3]
  Planes color;       ///< [h,w,3]
  Planes alpha;       ///< [h,w,1]
  Planes valid;       ///< [h,w,1] 1 or 0
};

class Interpolate final : public Stage {
 public:
  explicit Interpolate(const Params& params) : every_(params.get_int("every")) {
    if (const std::string& text = params.get_string("cuts"); !text.empty()) {
      try {
        cuts_ = parse_frame_set(text);
      } catch (const Error& e) {
        throw StageParamError(e.code(), {"cuts"}, "cuts: " + e.message());
      }
    }
  }

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    if (every_ == 0 && in[kKeys].frames.empty()) {
      throw StageParamError(ErrorCode::kBadInput, {"every"},
                            "every = 0 takes all frames that there are for keys; a shot needs their distance");
    }
    if (in.size() > 1 && (in[kKeys].width != in[kGuides].width || in[kKeys].height != in[kGuides].height)) {
      throw Error(ErrorCode::kBadInput, fmt::format("the keys have {}x{} pixels, the guides {}x{}", in[kKeys].width,
                                                    in[kKeys].height, in[kGuides].width, in[kGuides].height));
    }
    SequenceDesc out = in[kKeys];
    std::erase_if(out.layers, [](const LayerDesc& d) { return !survives(d); });
    out.layers.push_back(layers::mask());
    out.frames.clear();
    if (in[kKeys].frames.empty()) return out;
    const std::set<int> keys = keys_of(in[kKeys]);
    std::set<int> all(keys.begin(), keys.end());
    for (const int f : in[kGuides].all_frames()) {
      if (f >= *keys.begin() && f <= *keys.rbegin()) all.insert(f);
    }
    out.frames.assign(all.begin(), all.end());
    return out;
  }

  std::vector<LayerUse> reads(int port, std::span<const SequenceDesc> in) const override {
    const std::string why = "it leads to the frames around";
    std::vector<LayerUse> uses{{layers::color(), true, "there is no light to interpolate"},
                               {layers::motion_forward(), true, why},
                               {layers::motion_backward(), true, why},
                               {layers::object_id(), false},
                               {layers::depth(), false},
                               {layers::albedo(), false},
                               {layers::emission(), false}};
    if (port == kKeys) return uses;
    uses.push_back({layers::color_a(), false});
    uses.push_back({layers::color_b(), false});
    for (const LayerDesc& d : in[kKeys].layers) {
      if (!survives(d)) continue;
      const auto it =
          std::find_if(uses.begin(), uses.end(), [&](const LayerUse& use) { return use.layer.name == d.name; });
      if (it != uses.end()) {
        *it = {d, true, "the keys have it"};
      } else {
        uses.push_back({d, true, "the keys have it"});
      }
    }
    return uses;
  }

  std::vector<int> inputs(int port, int frame, std::span<const SequenceDesc> in) const override {
    const auto [a, b] = around(frame, in[kKeys]);
    if (a == b) return port == kKeys ? std::vector<int>{frame} : std::vector<int>{};
    if (port == kKeys) return {a, b};
    std::vector<int> out;
    for (int f = a + 1; f < b; ++f) out.push_back(f);
    return out;
  }
  std::string identity(std::span<const SequenceDesc> in) const override {
    return fmt::format("keys from {}\n", in[kKeys].sequence.first);
  }

  void run(StageRun& run) const override {
    FrameWindow window(run);
    const std::vector<LayerDesc> wanted = output(run.in()).layers;
    double done = 0, between = 0, left = 0;
    for (const int f : run.frames()) {
      window.move_to(f, *this);
      const auto [a, b] = around(f, run.in()[kKeys]);
      if (a == b) {
        Frame out = run.start(f);
        out.create(layers::mask());
        run.write(f, std::move(out));
      } else {
        Frame out = make(window, f, a, b, wanted);
        const Image& mask = out.layer(layers::mask().name);
        left += double(std::count_if(mask.values().begin(), mask.values().end(), [](float m) { return m > 0; })) /
                double(mask.pixels());
        ++between;
        run.write(f, std::move(out));
      }
      run.progress(++done / double(run.frames().size()));
    }
    if (between > 0)
      run.note(fmt::format("{:.1f} % of the frames in between are left to be rendered", 100 * left / between));
  }

 private:
  /// Whether a layer is true of the frames that come out.
  static bool survives(const LayerDesc& d) {
    return d.pass.empty() && d.role != LayerRole::kStatistic && d.role != LayerRole::kReconstruction &&
           d.role != LayerRole::kMask;
  }

  std::set<int> keys_of(const SequenceDesc& in) const {
    std::set<int> keys;
    const FrameRange& reach = in.reach;
    if (every_ == 0) {
      for (const int f : in.frames) {
        if (reach.contains(f)) keys.insert(f);
      }
    } else {
      const std::int64_t first = in.sequence.first;
      std::int64_t f = first + (std::int64_t(reach.first) - first + every_ - 1) / every_ * every_;
      for (; f <= reach.last; f += every_) keys.insert(int(f));
    }
    keys.insert(reach.first), keys.insert(reach.last);
    for (const int cut : cuts_) {
      for (const int f : {cut - 1, cut}) {
        if (reach.contains(cut - 1) && reach.contains(cut)) keys.insert(f);
      }
    }
    return keys;
  }
  /// The keys at or around a frame.
  std::pair<int, int> around(int frame, const SequenceDesc& in) const {
    const std::set<int> keys = keys_of(in);
    const auto after = keys.lower_bound(frame);
    if (after == keys.end()) return {*keys.rbegin(), *keys.rbegin()};
    if (*after == frame || after == keys.begin()) return {*after, *after};
    return {*std::prev(after), *after};
  }

  /// What the key at the end of `frames` says of the frame at their begin.
  static Gathered gather(std::span<const Surfaces* const> frames, const Frame& key, int number, int step) {
    const Surfaces& s = *frames.back();
    const int w = s.width(), h = s.height();
    const Light light = light_of(key, "key", number);
    // Edges of what moves before something else hold light of both.
    const Grid<std::uint8_t> edges = motion::covered_edges(s);
    const Image radiance = light.color.image();
    const Image clean = motion::without_edges(irradiance(light.color, light).image(), s, edges);
    Gathered out{motion::walk(frames, step), Planes(w, h, 3), Planes(w, h, 3), Planes(w, h, 1), Planes(w, h, 1)};
    const Image alpha = light.alpha.image();
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const Place& p = out.places.at(x, y);
        if (!p.valid()) continue;
        const Taps taps = motion::taps_at(s, p);
        for (int c = 0; c < 3; ++c) {
          out.irradiance.row(c, y)[x] = motion::value_at(clean, taps, c);
          out.color.row(c, y)[x] = motion::value_at(radiance, taps, c);
        }
        out.alpha.row(0, y)[x] = motion::value_at(alpha, taps, 0);
        out.valid.row(0, y)[x] = 1;
      }
    });
    return out;
  }

  /// Frame `frame` between the keys a and b, with the layers `wanted` and the mask.
  Frame make(const FrameWindow& in, int frame, int a, int b, const std::vector<LayerDesc>& wanted) const {
    std::map<int, Surfaces> surfaces;
    for (int f = a; f <= b; ++f) {
      surfaces.emplace(f, motion::read_surfaces(f == a || f == b ? in.at(f, kKeys) : in.at(f, kGuides), f));
    }
    const auto chain = [&](int to) {
      std::vector<const Surfaces*> out;
      for (int f = frame; f != to; f += to > frame ? 1 : -1) out.push_back(&surfaces.at(f));
      out.push_back(&surfaces.at(to));
      return out;
    };
    const Gathered before = gather(chain(a), in.at(a, kKeys), a, -1);
    const Gathered after = gather(chain(b), in.at(b, kKeys), b, 1);
    const Frame& guide = in.at(frame, kGuides);
    const Light light = light_of(guide, "guide", frame);
    const int w = guide.width(), h = guide.height();
    const Surfaces& here = surfaces.at(frame);

    // The noisy light of the guide, and its variance.
    const Planes noisy = irradiance(light.color, light);
    Planes variance;
    if (guide.has("color.a") && guide.has("color.b")) {
      const Planes half_a =
          irradiance(planes_of(image_of(guide, layers::color_a(), 3, "guide", frame), 3, 0, w, h), light);
      const Planes half_b =
          irradiance(planes_of(image_of(guide, layers::color_b(), 3, "guide", frame), 3, 0, w, h), light);
      variance = denoise::half_variance(half_a, half_b, kRadius);
    } else {
      variance = denoise::apparent_variance(noisy, kRadius);
    }

    const float linear = float(frame - a) / float(b - a);
    const Planes share = share_of_after(before, after, noisy, variance, linear);
    Planes made(w, h, 3), known(w, h, 1);
    Planes color(w, h, 3), alpha(w, h, 1);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const bool has_a = before.valid.row(0, y)[x] > 0, has_b = after.valid.row(0, y)[x] > 0;
        const float t = has_a && has_b ? share.row(0, y)[x] : has_a ? 0.0f : 1.0f;
        const bool whole = (!has_a || is_whole(before.places.at(x, y))) && (!has_b || is_whole(after.places.at(x, y)));
        known.row(0, y)[x] = has_a || has_b;
        for (int c = 0; c < 3; ++c) {
          float u = noisy.row(c, y)[x], r = light.color.row(c, y)[x];  // the best guess where there is nothing else
          if (has_a || has_b) {
            u = (1 - t) * before.irradiance.row(c, y)[x] + t * after.irradiance.row(c, y)[x];
            r = whole ? (1 - t) * before.color.row(c, y)[x] + t * after.color.row(c, y)[x]
                      : u * light.divisor.row(c, y)[x] + light.emission.row(c, y)[x];
          }
          made.row(c, y)[x] = u;
          color.row(c, y)[x] = r;
        }
        alpha.row(0, y)[x] = has_a || has_b ? (1 - t) * before.alpha.row(0, y)[x] + t * after.alpha.row(0, y)[x]
                                            : light.alpha.row(0, y)[x];
      }
    });

    Frame out(w, h);
    out.metadata = guide.metadata;
    for (const Layer& l : guide.layers()) {
      const bool written =
          std::any_of(wanted.begin(), wanted.end(), [&](const LayerDesc& d) { return d.name == l.desc.name; });
      if (written) out.add(l.desc, l.image);
    }
    Image& result = out.layer("color");
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        for (int c = 0; c < 3; ++c) result.at(x, y, c) = color.row(c, y)[x];
        if (result.channels() >= 4) result.at(x, y, 3) = alpha.row(0, y)[x];
      }
    }
    out.add(layers::mask(), mask_of(here, before, after, noisy, variance, made, known));
    return out;
  }

  /// Whether a place is the center of a pixel.
  static bool is_whole(const Place& p) {
    const float x = p.x - std::floor(p.x) - 0.5f, y = p.y - std::floor(p.y) - 0.5f;
    return std::abs(x) < 0.01f && std::abs(y) < 0.01f;
  }

  /// How much of the light is that of the later key: what fits the guide best in the window around, with a normal prior
  /// around the linear share. So a shadow's edge that passes is where the guide has it, not in two places at half
  /// strength.
  static Planes share_of_after(const Gathered& before, const Gathered& after, const Planes& noisy,
                               const Planes& variance, float linear) {
    constexpr float kSpread = 0.3f;  // standard deviation of the prior
    const int w = noisy.width(), h = noisy.height();
    Planes sums(w, h, 4);  // difference times guide, its square, variance, weight
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        if (before.valid.row(0, y)[x] == 0 || after.valid.row(0, y)[x] == 0) continue;
        float product = 0, square = 0;
        for (int c = 0; c < 3; ++c) {
          const float u = before.irradiance.row(c, y)[x], d = after.irradiance.row(c, y)[x] - u;
          // What lies far beyond both keys is noise: it may say which one is nearer, not by how much.
          const float n =
              std::clamp(noisy.row(c, y)[x] - u, std::min(0.0f, d) - std::abs(d), std::max(0.0f, d) + std::abs(d));
          product += d * n, square += d * d;
        }
        sums.row(0, y)[x] = product, sums.row(1, y)[x] = square, sums.row(2, y)[x] = variance.row(0, y)[x],
                    sums.row(3, y)[x] = 1;
      }
    });
    const Planes mean = box_mean(sums, kRadius);
    Planes out(w, h, 1, linear);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const float n = mean.row(3, y)[x] * float((2 * kRadius + 1) * (2 * kRadius + 1));
        if (n < 0.5f) continue;
        const float prior = mean.row(2, y)[x] / (n * kSpread * kSpread) + 1e-12f;
        const float t = (mean.row(0, y)[x] + prior * linear) / (mean.row(1, y)[x] + prior);
        out.row(0, y)[x] = std::clamp(t, 0.0f, 1.0f);
      }
    });
    return out;
  }

  /// Which pixels are better rendered: those that neither key shows, edges between what moves in different ways, and
  /// where the light is not what the guide has.
  static Image mask_of(const Surfaces& here, const Gathered& before, const Gathered& after, const Planes& noisy,
                       const Planes& variance, const Planes& made, const Planes& known) {
    const int w = here.width(), h = here.height();
    Planes excess(w, h, 4);  // by channel, and the weight
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        if (known.row(0, y)[x] == 0) continue;
        for (int c = 0; c < 3; ++c) excess.row(c, y)[x] = noisy.row(c, y)[x] - made.row(c, y)[x];
        excess.row(3, y)[x] = 1;
      }
    });
    const Planes mean = box_mean(excess, kRadius);
    const Planes level = box_mean(made, kRadius);
    Grid<std::uint8_t> wanted(w, h);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = here.linear.index(x, y);
        bool want = known.row(0, y)[x] == 0;
        const float share = mean.row(3, y)[x], n = share * float((2 * kRadius + 1) * (2 * kRadius + 1));
        if (!want && share > 0) {
          const float noise = variance.row(0, y)[x] / n;
          for (int c = 0; c < 3 && !want; ++c) {
            const float e = mean.row(c, y)[x] / share, bound = kRelative * (std::abs(level.row(c, y)[x]) + 0.01f);
            want = e * e > kSigmas * kSigmas * noise + bound * bound;
          }
        }
        for (int k = 0; k < 8 && !want; ++k) {
          const int nx = x + motion::kAround[k][0], ny = y + motion::kAround[k][1];
          if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
          const std::size_t j = here.linear.index(nx, ny);
          want = !here.same(i, j) && parts(before.places, x, y, nx, ny, after.places);
        }
        wanted[i] = want;
      }
    });
    Image mask(w, h, 1);
    for (std::size_t i = 0; i < wanted.size(); ++i) mask.values()[i] = wanted[i];
    return mask;
  }
  /// Whether two neighbors are not neighbors in a key.
  static bool parts(const Grid<Place>& before, int x, int y, int nx, int ny, const Grid<Place>& after) {
    for (const Grid<Place>* places : {&before, &after}) {
      const Place &p = places->at(x, y), &q = places->at(nx, ny);
      if (p.valid() != q.valid()) return true;
      if (!p.valid()) continue;
      const float dx = q.x - p.x - float(nx - x), dy = q.y - p.y - float(ny - y);
      if (dx * dx + dy * dy > 0.25f) return true;
    }
    return false;
  }

  static constexpr int kRadius = 2;          ///< of windows in which the guide's noise is averaged
  static constexpr float kSigmas = 3;        ///< of that noise
  static constexpr float kRelative = 0.05f;  ///< of the light
  int every_;
  std::vector<int> cuts_;
};

}  // namespace

extern const StageEntry interpolate_entry;
const StageEntry interpolate_entry{
    .name = "interpolate",
    .help = "frames between key frames, from these and guides of few samples",
    .command_help = "Make the frames between key frames.",
    .done = "made",
    .params = kParams,
    .ports = {{"keys", "key frames, clean"},
              {"guides", "frames in between, rendered with few samples, with the same layers", true}},
    .output_help = "all frames",
    .reads = {{{"color"}, "needed: light of the keys; of the guides, to tell where it changes"},
              {{"motion.forward", "motion.backward"}, "needed"},
              {{"object_id", "depth"}, "which places show the same"},
              {{"albedo", "emission"}, "light is interpolated, texture taken from the guides"},
              {{"color.a", "color.b"}, "of the guides: their noise"},
              {{"*"}, "of the guides: every layer that the keys have"}},
    .writes =
        {{{"color"}, "light of both keys, with alpha"},
         {{"*"}, "every layer of the keys: in between, those of the guides"},
         {{"mask"},
          "pixels that are better rendered: no key shows them, they are edges of what moves, or the light changes"}},
    .window = "the keys around it, and the guides between them",
    .gap_help =
        "keys are every --every frames, the first and the last frame and those at cuts; what moves is followed from "
        "frame to frame between them",
    .examples = {"tempera interpolate keys/ guides/ -o between/ --every 4",
                 "tempera render shot.toml --mask between/f.####.exr -o pixels/f.####.exr",
                 "tempera fill between/ pixels/ -o final/"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<Interpolate>(p); },
    .takes_keys = true,
    .sharp = true,
    .takes_cuts = true};

}  // namespace tempera
