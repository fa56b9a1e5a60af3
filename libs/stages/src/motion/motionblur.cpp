// SPDX-License-Identifier: Apache-2.0
// The stage `motionblur`: frames as a camera with an open shutter sees them, from sharp frames with motion vectors, see
// docs/motion-stages.md. Source: [Zimmer 2015, Sec. 5.3].
#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>

#include "denoise/denoiser.h"
#include "motion/parts.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

namespace {

using motion::Part;
using motion::Place;
using motion::Surfaces;
using motion::Taps;

const std::vector<ParamSpec> kParams = {
    {"shutter", 0.5,
     "how long the shutter is open, in frames; half of it before the time of the sharp frame, half after", 0, 2},
    {"cuts", std::string(), "first frames of new shots, e.g. 25,61, where motion vectors do not say so"},
};

/// What becomes of a layer.
enum class Blur {
  kMean,      ///< the mean over the exposure
  kHits,      ///< the mean over the times at which there is something, as renders average features
  kCoverage,  ///< of cryptomatte: shares of the exposure
  kKeep,      ///< true of the middle of the exposure: identifiers, vectors, counts
};

Blur blur_of(const LayerDesc& d) {
  if (d.name.starts_with("Crypto")) return Blur::kCoverage;
  if (d.unit == units::kDirection || d.unit == units::kMeters || d.unit == units::kWorld || d.unit == units::kTexture)
    return Blur::kHits;
  return d.combine == Combine::kMean && d.unit != units::kSeconds ? Blur::kMean : Blur::kKeep;
}

/// A frame that light is taken from.
struct Source {
  const Frame* frame = nullptr;
  Surfaces surfaces;
  Grid<std::uint8_t> edges;
  std::map<std::string, Image> clean;  ///< layers without what covers their edges
  Grid<std::uint8_t> hidden;           ///< of a frame around: 1 for what something nearer hides in the sharp frame
  bool hides = false;                  ///< whether there is such
};

/// Light that is seen in mirrors or through glass, with the surfaces there.
struct Seen {
  Part part;
  std::map<int, Surfaces> surfaces;  ///< by distance in frames
  Grid<Place> places;                ///< at the time that is looked at
  std::vector<double> sum;
};

/// Sums over the exposure of one layer.
struct Sums {
  const Layer* layer;
  Blur blur;
  std::vector<double> sum;
  std::vector<int> hits;
};

/// Ids and coverage of one pixel.
using Coverage = std::vector<std::pair<float, double>>;

/// A set of cryptomatte layers.
struct Matte {
  std::vector<std::string> layers;  ///< two ranks in each
  Grid<Coverage> coverage;

  void add(const Frame& from, std::size_t pixel, int x, int y) {
    for (const std::string& name : layers) {
      const Layer* layer = from.find(name);
      if (!layer || layer->image.channels() != 4) continue;
      const float* v = layer->image.values().data() + pixel * 4;
      for (const int k : {0, 2}) {
        if (v[k] == 0 || !std::isfinite(v[k]) || !(v[k + 1] > 0)) continue;
        Coverage& shares = coverage.at(x, y);
        auto it = std::find_if(shares.begin(), shares.end(), [&](const auto& share) { return share.first == v[k]; });
        if (it == shares.end()) it = shares.insert(it, {v[k], 0.0});
        it->second += double(v[k + 1]);
      }
    }
  }
  /// The largest shares of the exposure, in which pixels were added at `times` times.
  void write(int times, Frame& out) {
    for (std::size_t k = 0; k < layers.size(); ++k) {
      Image& image = out.layer(layers[k]);
      for (int y = 0; y < image.height(); ++y) {
        for (int x = 0; x < image.width(); ++x) {
          Coverage& shares = coverage.at(x, y);
          if (k == 0) {
            std::stable_sort(shares.begin(), shares.end(),
                             [](const auto& a, const auto& b) { return a.second > b.second; });
          }
          for (std::size_t rank = 2 * k; rank < 2 * k + 2; ++rank) {
            float* v = image.pixel(x, y) + rank % 2 * 2;
            v[0] = rank < shares.size() ? shares[rank].first : 0;
            v[1] = rank < shares.size() ? float(shares[rank].second / times) : 0;
          }
        }
      }
    }
  }
};

class MotionBlur final : public Stage {
 public:
  explicit MotionBlur(const Params& params) : shutter_(params.get_double("shutter")), cuts_(motion::cuts_of(params)) {}

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    std::erase_if(out.layers, [](const LayerDesc& d) {
      return !d.pass.empty() || d.role == LayerRole::kStatistic || d.role == LayerRole::kReconstruction;
    });
    return out;
  }
  std::vector<LayerUse> reads(int /*port*/, std::span<const SequenceDesc> in) const override {
    const std::string why = "it says what moves where";
    std::vector<LayerUse> uses{{layers::color(), true, "there is nothing to blur"},
                               {layers::motion_forward(), !in[0].has(layers::motion_backward()), why},
                               {layers::motion_backward(), false, why},
                               {layers::depth(), false},
                               {layers::object_id(), false}};
    for (const LayerDesc& d : output(in).layers) {
      const auto named = [&](const LayerUse& use) { return use.layer.name == d.name; };
      if (blur_of(d) != Blur::kKeep && std::none_of(uses.begin(), uses.end(), named)) uses.push_back({d, false});
    }
    for (const LayerDesc& d : motion::chain_layers(in[0].layers)) {
      const auto named = [&](const LayerUse& use) { return use.layer.name == d.name; };
      if (std::none_of(uses.begin(), uses.end(), named)) uses.push_back({d, false});
    }
    return uses;
  }
  std::vector<int> inputs(int /*port*/, int frame, std::span<const SequenceDesc> in) const override {
    const FrameRange range = denoise::shot_around(frame, shutter_ > 0 ? 1 : 0, in[0].reach, cuts_);
    return frames_around(frame, frame - range.first, range.last - frame, in[0]);
  }

  void run(StageRun& run) const override {
    FrameWindow window(run);
    std::vector<int> blurred;
    std::int64_t unknown = 0;
    double done = 0;
    for (const int f : run.frames()) {
      window.move_to(f, *this);
      Frame out = run.start(f);
      if (const auto info = render_info(out.metadata); info && info->shutter_close > info->shutter_open)
        blurred.push_back(f);
      if (shutter_ > 0) unknown += make(window, f, out);
      set_shutter(out.metadata);
      run.write(f, std::move(out));
      run.progress(++done / double(run.frames().size()));
    }
    if (!blurred.empty()) {
      run.note(
          fmt::format("frames {} were rendered with an open shutter: what moves in them is blurred twice; render "
                      "with --shutter 0.25,0.25",
                      describe_frames(blurred)));
    }
    if (unknown > 0) {
      run.note(fmt::format(
          "{} pixels have no motion vector in either direction, nor does their object: they stay sharp", unknown));
    }
  }

 private:
  void set_shutter(Metadata& metadata) const {
    auto info = render_info(metadata);
    if (!info) return;
    const double middle = (info->shutter_open + info->shutter_close) / 2;
    info->shutter_open = middle - shutter_ / 2, info->shutter_close = middle + shutter_ / 2;
    set_render_info(metadata, *info);
  }

  static Source source_of(const Frame& layers, int frame) {
    Source s;
    s.frame = &layers;
    s.surfaces = motion::read_surfaces(layers, frame);
    s.edges = motion::covered_edges(s.surfaces);
    for (const Layer& l : layers.layers()) {
      if (blur_of(l.desc) == Blur::kMean)
        s.clean.emplace(l.desc.name, motion::without_edges(l.image, s.surfaces, s.edges));
    }
    return s;
  }

  /// Which pixels of `there` show what is hidden in the sharp frame `here`, `step` frames before it.
  static Grid<std::uint8_t> hidden_in(const Surfaces& here, const Surfaces& there, int step) {
    const int w = here.width(), h = here.height();
    Grid<std::uint8_t> out(w, h);
    if (here.depth.empty() || there.depth.empty()) return out;
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = there.linear.index(x, y);
        const Vec3f d = there.moved(i, float(-step));
        const float px = float(x) + 0.5f + d.x, py = float(y) + 0.5f + d.y;
        if (!(px >= 0 && py >= 0 && px < float(w) && py < float(h))) continue;
        const std::size_t j = here.linear.index(int(px), int(py));
        const bool other = here.id.empty() || there.id.empty() || here.id[j] != there.id[i];
        out[i] = other && here.depth[j] < 0.98f * (there.depth[i] + d.z);
      }
    });
    return out;
  }

  /// Whether what covers the edge of pixel `main` of the frame does so at pixel (x, y), too.
  static bool covered_alike(const Source& own, const Grid<Place>& places, int x, int y, std::size_t main) {
    const Surfaces& s = own.surfaces;
    unsigned now = 0;
    for (int k = 0; k < 8; ++k) {
      const int nx = x + motion::kAround[k][0], ny = y + motion::kAround[k][1];
      if (nx < 0 || ny < 0 || nx >= places.width() || ny >= places.height()) continue;
      const Place& p = places.at(nx, ny);
      if (!p.valid() || p.frame != 0) continue;
      const std::size_t j = s.linear.index(int(p.x), int(p.y));
      if (!s.moves_with(main, j) && s.nearer(j, main)) now |= 1u << k;
    }
    const unsigned then = own.edges[main];
    return std::popcount(then & ~now) * 3 <= std::popcount(then);
  }

  /// Returns the number of pixels that have no vector.
  std::int64_t make(const FrameWindow& in, int frame, Frame& out) const {
    std::map<int, Source> sources;  // by distance in frames
    const auto source = [&](int step) -> const Source* {
      if (!in.has(frame + step)) return nullptr;
      auto it = sources.find(step);
      if (it == sources.end()) {
        it = sources.emplace(step, source_of(in.at(frame + step), frame + step)).first;
        Source& made = it->second;
        if (step != 0) made.hidden = hidden_in(sources.at(0).surfaces, made.surfaces, step);
        made.hides = std::find(made.hidden.begin(), made.hidden.end(), 1) != made.hidden.end();
      }
      return &it->second;
    };
    const Source& own = *source(0);
    const Surfaces& s = own.surfaces;
    const int w = out.width(), h = out.height();

    std::vector<Sums> all;
    std::map<std::string, Matte> mattes;  // by the name without the rank
    for (const Layer& l : out.layers()) {
      const Blur blur = blur_of(l.desc);
      if (blur == Blur::kCoverage && l.image.channels() == 4) {
        Matte& matte = mattes[l.desc.name.substr(0, l.desc.name.size() - 2)];
        matte.layers.push_back(l.desc.name);
        matte.coverage = Grid<Coverage>(w, h);
      }
      if (blur != Blur::kMean && blur != Blur::kHits) continue;
      const std::size_t pixels = std::size_t(w) * std::size_t(h);
      all.push_back({&l, blur, std::vector<double>(pixels * std::size_t(l.image.channels())),
                     std::vector<int>(blur == Blur::kHits ? pixels : 0)});
    }

    std::vector<LayerDesc> descs;
    for (const Layer& l : in.at(frame).layers()) descs.push_back(l.desc);
    const std::vector<Part> parts = motion::parts_of(descs, out.metadata);
    std::vector<Seen> seen;
    for (const Part& part : parts) {
      if (part.chains.empty() || !out.has(part.color)) continue;
      std::erase_if(all, [&](const Sums& sums) { return sums.layer->desc.name == part.color; });
      Seen& made = seen.emplace_back();
      made.part = part, made.sum.resize(std::size_t(w) * std::size_t(h) * 3);
      for (const int step : {0, -1, 1}) {
        if (!source(step) || !source(step)->frame->has(part.color)) continue;
        made.surfaces.emplace(step, motion::surfaces_of(*source(step)->frame, frame + step, part));
      }
    }

    float fastest = 0;
    const auto look_at = [&](const Surfaces& surfaces) {
      for (std::size_t i = 0; i < surfaces.linear.size(); ++i) {
        const Vec3f d = surfaces.moved(i, float(shutter_) / 2);
        fastest = std::max(fastest, 2 * std::sqrt(d.x * d.x + d.y * d.y));
      }
    };
    look_at(s);
    for (const Seen& part : seen) look_at(part.surfaces.at(0));
    const int times = int(std::clamp(std::ceil(2 * fastest), 16.0f, 64.0f));
    for (int j = 0; j < times; ++j) {
      const float theta = float(shutter_ * ((j + 0.5) / times - 0.5));
      Grid<Place> places = motion::project(s, theta);
      const bool holes = std::any_of(places.begin(), places.end(), [](const Place& p) { return !p.valid(); });
      // What comes into view is in the frame that is nearer in time, else in the other one.
      const int nearer = theta > 0 ? 1 : -1;
      for (const int step : {nearer, -nearer}) {
        const Source* other = source(step);
        if (other && (holes || other->hides)) uncover(*other, step, theta - float(step), places);
      }
      if (holes) motion::grow(places);
      for (Seen& part : seen) {
        part.places = motion::project(part.surfaces.at(0), theta);
        for (const int step : {nearer, -nearer}) {  // what comes into the mirror's view
          const auto other = part.surfaces.find(step);
          if (other != part.surfaces.end()) add_places(other->second, step, theta - float(step), part.places);
        }
      }
      parallel_rows(0, h, [&](int y) {
        for (int x = 0; x < w; ++x) {
          Place p = places.at(x, y);
          if (!p.valid()) p = {float(x) + 0.5f, float(y) + 0.5f};  // nothing is seen anywhere
          const Source& from = p.frame == 0 ? own : sources.at(p.frame);
          const Taps taps = motion::taps_at(from.surfaces, p);
          const bool raw = p.frame == 0 && own.edges[taps.main] && covered_alike(own, places, x, y, taps.main);
          add(from, taps, raw, std::size_t(y) * std::size_t(w) + std::size_t(x), all);
          for (Seen& part : seen) add_seen(own, sources, from, p, taps, x, y, part);
          for (auto& [name, matte] : mattes) matte.add(*from.frame, taps.main, x, y);
        }
      });
    }
    for (const Sums& sums : all) {
      Image& image = out.layer(sums.layer->desc.name);
      const std::size_t n = std::size_t(image.channels());
      for (std::size_t i = 0; i < sums.sum.size(); ++i) {
        const int count = sums.blur == Blur::kHits ? sums.hits[i / n] : times;
        image.values()[i] = count > 0 ? float(sums.sum[i] / count) : 0.0f;
      }
    }
    for (auto& [name, matte] : mattes) matte.write(times, out);
    if (!seen.empty()) add_up(seen, parts, times, out);
    return s.unknown;
  }

  /// Lets pixels that see nothing, or something behind what is hidden in the sharp frame, see what stands there in
  /// another frame, `step` frames on. `theta`: the time, in frames from that of the other frame.
  static void uncover(const Source& other, int step, float theta, Grid<Place>& places) {
    const Grid<Place> seen = motion::project(other.surfaces, theta);
    const std::uint8_t back = step > 0 ? motion::kBackward : motion::kForward;
    for (std::size_t i = 0; i < places.size(); ++i) {
      if (!seen[i].valid()) continue;
      const std::size_t j = other.hidden.index(int(seen[i].x), int(seen[i].y));
      if (!(other.surfaces.vectors[j] & back)) continue;  // not of this shot
      if (places[i].valid() && !(other.hidden[j] && seen[i].depth < places[i].depth)) continue;
      places[i] = seen[i];
      places[i].frame = std::int8_t(step);
    }
  }

  /// Adds the light of a part at pixel (x, y): what the vectors of its own surfaces bring there, if they bring it within
  /// the mirror or the glass that is seen there; else what is at the place `p` of the first surface, at `taps` of `from`.
  static void add_seen(const Source& own, const std::map<int, Source>& sources, const Source& from, const Place& p,
                       const Taps& taps, int x, int y, Seen& part) {
    const Place& q = part.places.at(x, y);
    const auto object = [](const Source& source, const Place& place) {
      const Grid<float>& id = source.surfaces.id;
      return id.empty() ? 0.0f : id.at(int(place.x), int(place.y));
    };
    const bool within = q.valid() && object(sources.at(q.frame), q) == object(from, p);
    const Source& source = within ? sources.at(q.frame) : from;
    const Layer* layer = source.frame->find(part.part.color);
    if (!layer || layer->image.channels() < 3) return;
    const Taps at = within ? motion::taps_at(part.surfaces.at(q.frame), q) : taps;
    const std::size_t pixel = std::size_t(y) * std::size_t(own.surfaces.width()) + std::size_t(x);
    for (int c = 0; c < 3; ++c) part.sum[pixel * 3 + std::size_t(c)] += double(motion::value_at(layer->image, at, c));
  }
  /// Lets pixels that see nothing see what stands there in another frame, as `uncover`.
  static void add_places(const Surfaces& other, int step, float theta, Grid<Place>& places) {
    if (std::all_of(places.begin(), places.end(), [](const Place& p) { return p.valid(); })) return;
    const Grid<Place> seen = motion::project(other, theta);
    const std::uint8_t back = step > 0 ? motion::kBackward : motion::kForward;
    for (std::size_t i = 0; i < places.size(); ++i) {
      if (places[i].valid() || !seen[i].valid()) continue;
      if (!(other.vectors.at(int(seen[i].x), int(seen[i].y)) & back)) continue;
      places[i] = seen[i];
      places[i].frame = std::int8_t(step);
    }
  }
  /// The layers of such light, and `color` as the sum of all parts.
  static void add_up(const std::vector<Seen>& seen, const std::vector<Part>& parts, int times, Frame& out) {
    for (const Seen& part : seen) {
      Image& image = out.layer(part.part.color);
      for (std::size_t i = 0; i < part.sum.size(); ++i) {
        image.values()[i / 3 * std::size_t(image.channels()) + i % 3] = float(part.sum[i] / times);
      }
    }
    Image& color = out.layer("color");
    for (int y = 0; y < color.height(); ++y) {
      for (int x = 0; x < color.width(); ++x) {
        Rgb sum;
        for (const Part& part : parts) {
          if (part.add) sum += out.layer(part.color).rgb(x, y);
        }
        color.set_rgb(x, y, sum);
      }
    }
  }

  static void add(const Source& from, const Taps& taps, bool raw, std::size_t pixel, std::vector<Sums>& all) {
    for (Sums& sums : all) {
      const std::string& name = sums.layer->desc.name;
      const int n = sums.layer->image.channels();
      const Layer* layer = from.frame->find(name);
      const auto clean = from.clean.find(name);
      double* sum = sums.sum.data() + pixel * std::size_t(n);
      if (!layer || layer->image.channels() != n || (sums.blur == Blur::kMean && clean == from.clean.end())) {
        // A frame around has other layers: what the sharp frame has here is the best guess.
        const float* v = sums.layer->image.values().data() + pixel * std::size_t(n);
        for (int c = 0; c < n; ++c) sum[c] += double(sound(v[c]));
        if (sums.blur == Blur::kHits) ++sums.hits[pixel];
        continue;
      }
      if (sums.blur == Blur::kMean) {
        const Image& image = raw ? layer->image : clean->second;
        for (int c = 0; c < n; ++c) sum[c] += double(motion::value_at(image, taps, c));
        continue;
      }
      const float* v = layer->image.values().data() + taps.main * std::size_t(n);
      if (std::all_of(v, v + n, [](float f) { return f == 0; })) continue;
      if (!std::all_of(v, v + n, is_sound)) continue;
      for (int c = 0; c < n; ++c) sum[c] += double(v[c]);
      ++sums.hits[pixel];
    }
  }

  double shutter_;
  std::vector<int> cuts_;
};

}  // namespace

extern const StageEntry motionblur_entry;
const StageEntry motionblur_entry{
    .name = "motionblur",
    .help = "motion blur, added to sharp frames with motion vectors",
    .command_help = "Blur sharp frames along their motion, as an open shutter would.",
    .done = "blurred",
    .params = kParams,
    .ports = {{"in", "sharp frames"}},
    .output_help = "blurred frames",
    .reads = {{{"color"}, "needed: the sharp picture"},
              {{"motion.forward", "motion.backward"}, "one is needed; with both, paths are curved"},
              {{"depth"}, "what is in front of what; without it, what moves more is taken to be"},
              {{"object_id"}, "objects, within which vectors are continued and pixels interpolated"},
              {{"class.*", "chain.*"}, "light by class of paths, of a decomposition, with vectors of its own"},
              {{"*"}, "of the frames around: the layers that are blurred, for what comes into view"}},
    .writes = {{{"color", "albedo", "emission", "class.*"}, "means over the exposure, with alpha"},
               {{"depth", "normal", "position", "uv"},
                "means over the part of the exposure in which something is there"},
               {{"Crypto*"}, "coverage over the exposure"}},
    .window = "one before and one after it, up to the next cut",
    .gap_help = "they show what comes into view while the shutter is open",
    .examples = {"tempera render shot.toml --shutter 0.25,0.25 --layers motion,depth,object_id -o sharp/f.####.exr",
                 "tempera motionblur sharp/ -o blurred/ --shutter 0.5"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<MotionBlur>(p); },
    .sharp = true,
    .opens_shutter = true,
    .takes_cuts = true};

}  // namespace tempera
