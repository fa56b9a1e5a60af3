// SPDX-License-Identifier: Apache-2.0
// The stage `interpolate`: frames between key frames, see docs/motion-stages.md. Source: [Zimmer 2015, Sec. 5.3].
// DEVIATION [Zimmer 2015, Sec. 5.3]: but for method `published` keys are not splatted. What a frame in between shows is
// known from guides, which are rendered with few samples: their surfaces are followed to both keys, and light is gathered
// there.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "denoise/denoiser.h"
#include "denoise/planes.h"
#include "motion/interpolation.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

namespace {

using denoise::box_mean;
using denoise::Planes;
using motion::image_of;
using motion::Light;
using motion::Made;
using motion::Part;
using motion::Place;
using motion::planes_of;
using motion::Surfaces;
using motion::Taps;

enum Port { kKeys, kGuides };

const std::vector<ParamSpec> kParams = {
    {"every", 4, "distance of key frames, from the first frame on; 0: all frames that there are", 0, 1000},
    {.name = "method",
     .fallback = std::string("gathered"),
     .help =
         "gathered follows what guides show to both keys; published projects keys to the frame, as Zimmer et al. 2015 "
         "do, and takes nothing of the guides' light",
     .choices = {"gathered", "published"}},
    {"cuts", std::string(),
     "first frames of new shots, e.g. 25,61: each is a key, and so is the frame before it; a shot's own are known"},
};

/// The same surfaces of all frames from a key to the next, and where those of the frame that is made are in both.
struct Walks {
  std::map<int, Surfaces> surfaces;
  Grid<Place> before, after;
};

/// What a key says of the light of the frame that is made.
struct Gathered {
  Planes irradiance;  ///< [h,w,3]
  Planes color;       ///< [h,w,3]
  Planes valid;       ///< [h,w,1] 1 or 0
};

class Interpolate final : public Stage {
 public:
  explicit Interpolate(const Params& params)
      : every_(params.get_int("every")),
        published_(params.get_string("method") == "published"),
        cuts_(motion::cuts_of(params)) {}

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
    // Light of all frames is divided alike, by what the keys have.
    if (port == kGuides) std::erase_if(uses, [&](const LayerUse& u) { return !u.required && !in[kKeys].has(u.layer); });
    const auto named = [&](const LayerDesc& d) {
      return std::find_if(uses.begin(), uses.end(), [&](const LayerUse& use) { return use.layer.name == d.name; });
    };
    for (const LayerDesc& d : motion::chain_layers(in[kKeys].layers)) uses.push_back({d, false});
    for (const LayerDesc& d : in[kKeys].layers) {
      if (survives(d) && d.role == LayerRole::kPicture && named(d) == uses.end()) uses.push_back({d, false});
    }
    if (port == kKeys) {
      for (LayerUse& use : uses) {
        if (!use.required && in[kKeys].has(use.layer)) use.required = true, use.why = "other keys have it";
      }
      return uses;
    }
    for (const LayerDesc& d : {layers::color_a(), layers::color_b()}) {
      uses.push_back({d, false});
      for (const LayerDesc& light : in[kKeys].layers) {
        if (!light.path_class.empty() && survives(light))
          uses.push_back({layers::class_layer(light.path_class, d), false});
      }
    }
    for (const LayerDesc& d : in[kKeys].layers) {
      if (!survives(d)) continue;
      const auto it = named(d);
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
    const SequenceDesc& keys = run.in()[kKeys];
    if (keys.reach == keys.sequence) {
      std::vector<int> beyond = run.in()[kGuides].frames;
      std::erase_if(beyond, [&](int f) { return keys.reach.contains(f); });
      if (!beyond.empty())
        run.note(fmt::format("guides {} are beyond the keys: no frames are made of them", describe_frames(beyond)));
    }
    if (between > 0)
      run.note(fmt::format("{:.1f} % of the frames in between are left to be rendered", 100 * left / between));
  }

 private:
  /// Whether a layer is true of the frames that come out.
  static bool survives(const LayerDesc& d) {
    const bool light = d.name == layers::color().name || !d.path_class.empty();
    return d.pass.empty() && d.role != LayerRole::kStatistic && d.role != LayerRole::kReconstruction &&
           d.role != LayerRole::kMask && (d.role != LayerRole::kPicture || light);
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

  Walks walks_of(const FrameWindow& in, int frame, int a, int b, const Part& part) const {
    Walks out;
    for (int f = a; f <= b; ++f)
      out.surfaces.emplace(f, motion::surfaces_of(in.at(f, f == a || f == b ? kKeys : kGuides), f, part));
    const auto walk_to = [&](int key) {
      const int step = key > frame ? 1 : -1;
      std::vector<const Surfaces*> way;
      for (int f = frame; f != key + step; f += step) way.push_back(&out.surfaces.at(f));
      return motion::walk(way, step);
    };
    out.before = walk_to(a), out.after = walk_to(b);
    return out;
  }

  /// What a key says of the light at `places`.
  static Gathered gather(const Frame& key, int number, const Part& part, const Surfaces& s, const Grid<Place>& places) {
    const int w = s.width(), h = s.height();
    const Light light(key, part, "key", number);
    // Edges of what moves before something else hold light of both.
    const Image radiance = light.color.image();
    const Image clean = motion::without_edges(light.irradiance(light.color).image(), s, motion::covered_edges(s));
    Gathered out{Planes(w, h, 3), Planes(w, h, 3), Planes(w, h, 1)};
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const Place& p = places.at(x, y);
        if (!p.valid()) continue;
        const Taps taps = motion::taps_at(s, p);
        for (int c = 0; c < 3; ++c) {
          out.irradiance.row(c, y)[x] = motion::value_at(clean, taps, c);
          out.color.row(c, y)[x] = motion::value_at(radiance, taps, c);
        }
        out.valid.row(0, y)[x] = 1;
      }
    });
    return out;
  }

  /// Variance of the irradiance of a guide, from the halves of its samples if there are such.
  static Planes noise_of(const Frame& guide, int frame, const Part& part, const Light& light,
                         const Planes& irradiance) {
    const Image* a = image_of(guide, part.color + ".a", 3, "guide", frame);
    const Image* b = image_of(guide, part.color + ".b", 3, "guide", frame);
    if (!a || !b) return denoise::apparent_variance(irradiance, kRadius);
    const int w = guide.width(), h = guide.height();
    return denoise::half_variance(light.irradiance(planes_of(a, 3, 0, w, h)),
                                  light.irradiance(planes_of(b, 3, 0, w, h)), kRadius);
  }

  /// `all`: light of all parts, about; empty: there are no others.
  static Made make_part(const FrameWindow& in, int frame, int a, int b, const Part& part, const Walks& walks,
                        const Planes& all) {
    const Surfaces& here = walks.surfaces.at(frame);
    const int w = here.width(), h = here.height();
    const Gathered before = gather(in.at(a, kKeys), a, part, walks.surfaces.at(a), walks.before);
    const Gathered after = gather(in.at(b, kKeys), b, part, walks.surfaces.at(b), walks.after);
    const Frame& guide = in.at(frame, kGuides);
    const Light light(guide, part, "guide", frame);
    const Planes noisy = light.irradiance(light.color);
    const Planes variance = noise_of(guide, frame, part, light, noisy);
    Planes share = share_of_after(before, after, noisy, variance, float(frame - a) / float(b - a));
    Made out{Planes(w, h, 3), {}};
    Planes irradiance(w, h, 3), known(w, h, 1);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const bool has_a = before.valid.row(0, y)[x] > 0, has_b = after.valid.row(0, y)[x] > 0;
        float& t = share.row(0, y)[x];
        if (!has_a || !has_b) t = has_a ? 0.0f : 1.0f;
        // Texture comes from the guide, unless pixels lie on pixels; that of mirrors and glass is the noise of a guide's
        // few samples, and goes where their vectors lead.
        const bool as_it_is = !part.chains.empty() || ((!has_a || is_whole(walks.before.at(x, y))) &&
                                                       (!has_b || is_whole(walks.after.at(x, y))));
        known.row(0, y)[x] = has_a || has_b;
        for (int c = 0; c < 3; ++c) {
          float u = noisy.row(c, y)[x], r = light.color.row(c, y)[x];  // the best guess where there is nothing else
          if (has_a || has_b) {
            u = (1 - t) * before.irradiance.row(c, y)[x] + t * after.irradiance.row(c, y)[x];
            r = as_it_is ? (1 - t) * before.color.row(c, y)[x] + t * after.color.row(c, y)[x]
                         : u * light.divisor.row(c, y)[x] + light.emission.row(c, y)[x];
          }
          irradiance.row(c, y)[x] = u;
          out.color.row(c, y)[x] = r;
        }
      }
    });
    Planes whole = part.add ? all : Planes();  // as irradiance of this part
    for (std::size_t i = 0; i < whole.values().size(); ++i) whole.values()[i] /= light.divisor.values()[i];
    out.unwanted = unwanted(here, walks, before, after, noisy, variance, irradiance, known, whole);
    return out;
  }

  /// Frame `frame` between the keys a and b, with the layers `wanted` and the mask.
  Frame make(const FrameWindow& in, int frame, int a, int b, const std::vector<LayerDesc>& wanted) const {
    const Frame& guide = in.at(frame, kGuides);
    const int w = guide.width(), h = guide.height();
    Frame out(w, h);
    out.metadata = in.at(a, kKeys).metadata;  // made as the keys are
    for (const char* own : {"tempera/frame", "tempera/render_seconds"}) {
      if (const auto it = guide.metadata.find(own); it != guide.metadata.end()) out.metadata[own] = it->second;
    }
    for (const Layer& l : guide.layers()) {
      const bool written =
          std::any_of(wanted.begin(), wanted.end(), [&](const LayerDesc& d) { return d.name == l.desc.name; });
      if (written) out.add(l.desc, l.image);
    }
    const std::vector<Part> parts = motion::parts_of(wanted, guide.metadata);
    std::map<std::vector<std::string>, Walks> walks;  // by the chains of a part
    const auto walks_along = [&](const Part& part) -> const Walks& {
      auto it = walks.find(part.chains);
      if (it == walks.end()) it = walks.emplace(part.chains, walks_of(in, frame, a, b, part)).first;
      return it->second;
    };
    Planes all;  // light of all classes, about
    if (parts.size() > 1)
      all = box_mean(planes_of(image_of(guide, layers::color().name, 3, "guide", frame), 3, 0, w, h), 2 * kRadius);
    std::vector<Made> made;
    Planes sum(w, h, 3);
    for (const Part& part : parts) {
      const Walks& along = walks_along(part);
      made.push_back(published_
                         ? motion::interpolate_published({.key_before = in.at(a, kKeys),
                                                          .key_after = in.at(b, kKeys),
                                                          .before = a,
                                                          .frame = frame,
                                                          .after = b,
                                                          .part = part,
                                                          .surfaces = along.surfaces,
                                                          .follow_light = parts.size() > 1 && part.chains.empty()})
                         : make_part(in, frame, a, b, part, along, all));
      if (part.add) {
        for (std::size_t i = 0; i < sum.values().size(); ++i) sum.values()[i] += made.back().color.values()[i];
      }
      if (part.color != layers::color().name) put(made.back().color, out.layer(part.color));
    }
    put(sum, out.layer("color"));
    if (out.layer("color").channels() >= 4)
      put_alpha(in.at(a, kKeys), in.at(b, kKeys), walks_along({}), float(frame - a) / float(b - a), out.layer("color"));

    // What a part of the light lacks counts where it is seen. [Zimmer 2015, Sec. 5.3]
    constexpr int kSeen = 3;
    constexpr float kVisible = 0.005f;
    const Planes level = box_mean(sum, kSeen);
    Image& mask = out.add(layers::mask(), Image(w, h, 1));
    for (std::size_t k = 0; k < parts.size(); ++k) {
      if (!parts[k].add) continue;
      const Planes own = parts.size() == 1 ? level : box_mean(made[k].color, kSeen);
      parallel_rows(0, h, [&](int y) {
        for (int x = 0; x < w; ++x) {
          if (!made[k].unwanted.at(x, y)) continue;
          const auto brightness = [&](const Planes& p) { return p.row(0, y)[x] + p.row(1, y)[x] + p.row(2, y)[x]; };
          if (parts.size() == 1 || brightness(own) >= kVisible * brightness(level)) mask.at(x, y) = 1;
        }
      });
    }
    return out;
  }

  static void put(const Planes& from, Image& to) {
    for (int y = 0; y < to.height(); ++y) {
      for (int x = 0; x < to.width(); ++x) {
        for (int c = 0; c < 3; ++c) to.at(x, y, c) = from.row(c, y)[x];
      }
    }
  }
  /// Alpha of both keys, as far as they show what is there; else it stays that of the guide.
  static void put_alpha(const Frame& a, const Frame& b, const Walks& walks, float share, Image& to) {
    const Image &from_a = a.layer("color"), &from_b = b.layer("color");
    if (from_a.channels() < 4 || from_b.channels() < 4) return;
    for (int y = 0; y < to.height(); ++y) {
      for (int x = 0; x < to.width(); ++x) {
        const Place &p = walks.before.at(x, y), &q = walks.after.at(x, y);
        const auto alpha = [&](const Image& image, const Place& place, const Surfaces& s) {
          return motion::value_at(image, motion::taps_at(s, place), 3);
        };
        if (!p.valid() && !q.valid()) continue;
        const float t = !q.valid() ? 0 : !p.valid() ? 1 : share;
        float sum = 0;
        if (p.valid()) sum += (1 - t) * alpha(from_a, p, walks.surfaces.begin()->second);
        if (q.valid()) sum += t * alpha(from_b, q, walks.surfaces.rbegin()->second);
        to.at(x, y, 3) = sum;
      }
    }
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
  /// where the light is not what the guide has, by more than can be seen beside the light of the `whole` picture.
  static Grid<std::uint8_t> unwanted(const Surfaces& here, const Walks& walks, const Gathered& before,
                                     const Gathered& after, const Planes& noisy, const Planes& variance,
                                     const Planes& made, const Planes& known, const Planes& whole) {
    const int w = here.width(), h = here.height();
    Planes sums(w, h, 5);  // what the guide has more of, by channel; the weight; by how much the keys differ
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        if (known.row(0, y)[x] == 0) continue;
        for (int c = 0; c < 3; ++c) sums.row(c, y)[x] = noisy.row(c, y)[x] - made.row(c, y)[x];
        sums.row(3, y)[x] = 1;
        if (before.valid.row(0, y)[x] == 0 || after.valid.row(0, y)[x] == 0) continue;
        for (int c = 0; c < 3; ++c) {
          sums.row(4, y)[x] += std::abs(after.irradiance.row(c, y)[x] - before.irradiance.row(c, y)[x]) / 3;
        }
      }
    });
    Grid<std::uint8_t> light(w, h);
    for (const int radius : {kRadius, 2 * kRadius}) {  // what is small and strong, and what is wide and weak
      const Planes mean = box_mean(sums, radius), level = box_mean(made, radius), noise = box_mean(variance, radius);
      parallel_rows(0, h, [&](int y) {
        for (int x = 0; x < w; ++x) {
          const float share = mean.row(3, y)[x];
          if (share == 0 || known.row(0, y)[x] == 0) continue;
          const float n = share * float((2 * radius + 1) * (2 * radius + 1));
          const float all = (level.row(0, y)[x] + level.row(1, y)[x] + level.row(2, y)[x]) / 3;
          const bool differ = mean.row(4, y)[x] > kDiffer * share * std::abs(all);
          const float sigmas = differ ? kSigmasWhereKeysDiffer : kSigmas;
          for (int c = 0; c < 3; ++c) {
            const float own = std::abs(level.row(c, y)[x]);
            const float e = mean.row(c, y)[x] / share,
                        bound = kRelative * (std::max(own, whole.empty() ? 0 : whole.row(c, y)[x]) + 0.01f);
            if (e * e > sigmas * sigmas * noise.row(0, y)[x] / n + bound * bound) light.at(x, y) = 1;
          }
        }
      });
    }
    Grid<std::uint8_t> out(w, h);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = here.linear.index(x, y);
        if (here.vectors[i] == motion::kNothing) continue;  // nothing of this light is here
        bool want = known.row(0, y)[x] == 0;
        int around = 0;
        for (const auto& o : motion::kAround) {
          const int nx = x + o[0], ny = y + o[1];
          if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
          around += light.at(nx, ny);
          want |= !here.same(i, here.linear.index(nx, ny)) && part_ways(walks.before, walks.after, x, y, nx, ny);
        }
        // Alone, it is chance; amid others, what they are.
        out[i] = want || (light[i] ? around >= 2 : around >= 4);
      }
    });
    return out;
  }
  /// Whether two neighbors are not neighbors in a key.
  static bool part_ways(const Grid<Place>& before, const Grid<Place>& after, int x, int y, int nx, int ny) {
    for (const Grid<Place>* places : {&before, &after}) {
      const Place &p = places->at(x, y), &q = places->at(nx, ny);
      if (p.valid() != q.valid()) return true;
      if (!p.valid()) continue;
      const float dx = q.x - p.x - float(nx - x), dy = q.y - p.y - float(ny - y);
      if (dx * dx + dy * dy > 0.25f) return true;
    }
    return false;
  }

  static constexpr int kRadius = 2;    ///< of windows in which the guide's noise is averaged
  static constexpr float kSigmas = 3;  ///< of that noise
  static constexpr float kSigmasWhereKeysDiffer = 1.5f;
  static constexpr float kDiffer = 0.15f;    ///< of the light: keys that differ by more are no proof of it
  static constexpr float kRelative = 0.05f;  ///< of the light
  int every_;
  bool published_;
  std::vector<int> cuts_;
};

}  // namespace

namespace motion {

const Image* image_of(const Frame& frame, const std::string& name, int channels, const char* what, int number) {
  const Layer* layer = frame.find(name);
  if (!layer) return nullptr;
  if (layer->image.channels() < channels) {
    throw Error(ErrorCode::kBadInput, fmt::format("{} {}: the layer \"{}\" has {} channels, {} are needed", what,
                                                  number, name, layer->image.channels(), channels));
  }
  return &layer->image;
}

Planes planes_of(const Image* image, int channels, float missing, int w, int h) {
  if (!image) return {w, h, channels, missing};
  Planes out(*image, channels);
  for (float& v : out.values()) v = sound(v);
  return out;
}

Light::Light(const Frame& frame, const Part& part, const char* what, int number)
    : color(planes_of(image_of(frame, part.color, 3, what, number), 3, 0, frame.width(), frame.height())),
      divisor(reflectance_of(frame, part, denoise::kLeastReflectance), 3),
      emission(frame.width(), frame.height(), 3) {
  if (part.color == layers::color().name)
    emission =
        planes_of(image_of(frame, layers::emission().name, 3, what, number), 3, 0, frame.width(), frame.height());
}

Planes Light::irradiance(const Planes& of) const {
  Planes out = of;
  for (std::size_t i = 0; i < out.values().size(); ++i)
    out.values()[i] = (of.values()[i] - emission.values()[i]) / divisor.values()[i];
  return out;
}

}  // namespace motion

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
              {{"class.*", "chain.*"}, "light by class of paths, of a decomposition, with vectors of its own"},
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
