// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>

#include "denoise/input.h"
#include "denoise/residuals.h"
#include "tempera/core/log.h"

namespace tempera::denoise {

namespace {

constexpr float kLeastReflectance = 0.05f;  ///< below it light is not divided by any less
constexpr float kEmitterShare =
    0.02f;                            ///< of the light of a pixel that it emits, from which on it counts as an emitter
constexpr float kLeastFactor = 0.2f;  ///< the same of clean light, as far as it is averaged over time
constexpr float kFirefly = 4;         ///< times the brightest of the other half around that a half may be
constexpr int kVarianceRadius = 3;
constexpr int kFew = 16, kMany = 32;  ///< samples per pixel, between which recipes change
constexpr int kTrialTiles = 8;        ///< one tile of so many is tried, in large pictures
constexpr int kTrialWindow = 5;

/// CPU time of all threads: what a step costs on one core, whatever else the machine does.
double cpu_seconds() { return double(std::clock()) / CLOCKS_PER_SEC; }

/// Applies f(x of the row...) to each value of planes of one size.
template <class F>
void for_values(Planes& out, const F& f) {
  for (int c = 0; c < out.channels(); ++c) {
    for_rows(out.height(), [&](int y) {
      float* to = out.row(c, y);
      for (int x = 0; x < out.width(); ++x) to[x] = f(c, y, x, to[x]);
    });
  }
}

Planes multiply(const Planes& a, const Planes& b) {
  Planes out = a;
  for_values(out, [&](int c, int y, int x, float v) { return v * b.row(c, y)[x]; });
  return out;
}

/// Squared radiance, divided like the light, that no eye and no display could tell from none.
float noise_floor(const Planes& light) {
  double sum = 0;
  for (const float v : light.values()) sum += double(v);
  const double mean = sum / double(std::max<std::size_t>(light.values().size(), 1));
  return float(1e-8 * mean * mean + 1e-30);
}

}  // namespace

FrameRange shot_around(int frame, int distance, const FrameRange& reach, const std::vector<int>& cuts) {
  FrameRange out{std::max(frame - distance, reach.first), std::min(frame + distance, reach.last)};
  for (const int cut : cuts) {
    if (cut <= frame) out.first = std::max(out.first, cut);
    if (cut > frame) out.last = std::min(out.last, cut - 1);
  }
  return out;
}

Available::Available(std::span<const LayerDesc> layers) {
  const auto has = [&](const LayerDesc& layer) {
    return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
  };
  halves = has(layers::color_a()) && has(layers::color_b());
  variance = has(layers::color_variance());
  albedo = has(layers::albedo()), normal = has(layers::normal()), emission = has(layers::emission());
  id = has(layers::object_id());
  motion = has(layers::motion_forward()) && has(layers::motion_backward());
  // Only the classes of a decomposition are disjoint; it has a class for all other light.
  const bool decomposition = has(layers::class_layer("residual", layers::color()));
  for (const LayerDesc& d : layers) {
    const std::string& name = d.path_class;
    if (!decomposition || name.empty() || d.name != layers::class_layer(name, layers::color()).name) continue;
    if (has(layers::class_layer(name, layers::color_a())) && has(layers::class_layer(name, layers::color_b())))
      classes.push_back(name);
  }
  for (const LayerDesc& d : layers) {
    if (!d.chain.empty() && d == layers::chain_layer(d.chain, layers::albedo()) &&
        has(layers::chain_layer(d.chain, layers::normal())))
      chains.push_back(d.chain);
  }
}

std::vector<std::string> Available::losses(bool alone) const {
  std::vector<std::string> out;
  if (!halves) {
    out.push_back(variance ? "no halves (color.a, color.b): how alike pixels are is judged by the noise itself"
                           : "no halves (color.a, color.b) and no color.var: the noise is guessed from the picture, "
                             "and texture taken for noise");
  }
  if (!alone && !motion) out.push_back("no motion vectors in both directions: each frame is denoised alone");
  if (!albedo) out.push_back("no albedo: texture is smoothed with the light on it");
  if (!normal) out.push_back("no normal: edges are known from the noisy picture alone");
  return out;
}

Planes Denoiser::Light::mean() const {
  if (!halves()) return a;
  Planes out = a;
  for_values(out, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
  return out;
}

std::shared_ptr<Oidn> choose_method(const Settings& settings) {
  if (settings.method != Method::kOidn && settings.method != Method::kAuto) return nullptr;
  std::shared_ptr<Oidn> oidn;
  try {
    oidn = std::make_shared<Oidn>(settings.oidn_path);
  } catch (const Error&) {
    const bool asked =
        settings.method == Method::kOidn || !settings.oidn_path.empty() || !settings.oidn_version.empty();
    if (asked) throw;
    return nullptr;
  }
  if (!settings.oidn_version.empty() && settings.oidn_version != oidn->version()) {
    throw Error(
        ErrorCode::kUnsupported,
        fmt::format("Open Image Denoise here is version {}, version {} is asked for: frames of one sequence are "
                    "denoised by one version",
                    oidn->version(), settings.oidn_version));
  }
  return oidn;
}

std::string describe_method(const Oidn* oidn) { return oidn ? "oidn " + oidn->version() : "nl_means"; }

Denoiser::Denoiser(StageRun& run, const Settings& settings, std::shared_ptr<Oidn> oidn)
    : run_(run),
      settings_(settings),
      available_(run.in()[0].layers),
      radius_(available_.motion ? settings.radius : 0),
      oidn_(std::move(oidn)),
      recipe_(settings.recipe),
      hold_fireflies_(settings.hold_fireflies.value_or(!oidn_)) {
  const Metadata metadata = read_metadata(run.path(run.frames().front()));
  if (recipe_ == Recipe::kAuto) {
    const std::optional<int> spp = samples_of(metadata);
    recipe_ = !available_.halves || spp.value_or(kMany) <= kFew                       ? Recipe::kSingle
              : !oidn_ && !available_.classes.empty() && spp.value_or(kMany) >= kMany ? Recipe::kComponents
                                                                                      : Recipe::kHalves;
  }
  views_.push_back(available_.chains);
  if (recipe_ == Recipe::kComponents) {
    for (const ClassView& c : class_views(available_, metadata)) {
      Part part{c.name, 0, c.divide};
      if (!c.chains.empty()) {
        auto view = std::find(views_.begin() + 1, views_.end(), c.chains);
        if (view == views_.end()) view = views_.insert(view, c.chains);
        part.view = std::size_t(view - views_.begin());
      }
      parts_.push_back(std::move(part));
    }
  }
  // What belongs to no class is a part of its own.
  parts_.push_back({"", 0, parts_.empty()});
}

FrameRange Denoiser::around(int frame, int distance) const {
  return shot_around(frame, radius_ > 0 ? distance : 0, run_.in()[0].reach, settings_.cuts);
}

void Denoiser::spent(const std::string& step, double start) { seconds_[step] += cpu_seconds() - start; }

const Denoiser::Source& Denoiser::source(int frame) {
  auto it = sources_.find(frame);
  if (it == sources_.end()) it = sources_.emplace(frame, read(frame)).first;
  return it->second;
}
const Denoiser::Averaged& Denoiser::averaged(int frame) {
  auto it = averaged_.find(frame);
  if (it == averaged_.end()) it = averaged_.emplace(frame, average(frame)).first;
  return it->second;
}
const Denoiser::Denoised& Denoiser::denoised(int frame) {
  auto it = denoised_.find(frame);
  if (it == denoised_.end()) it = denoised_.emplace(frame, denoise(frame)).first;
  return it->second;
}

void Denoiser::forget_before(int frame) {
  const auto forget = [](auto& frames, int before) { frames.erase(frames.begin(), frames.lower_bound(before)); };
  forget(denoised_, frame - radius_);
  forget(averaged_, frame - radius_);
  forget(sources_, frame);
  // Of earlier frames the light alone is asked for again, unless frames around them are still to be denoised.
  const auto is_settled = [&](int f) { return f < frame - radius_ || denoised_.contains(f); };
  for (auto& [f, a] : averaged_) {
    if (f >= frame) break;
    if (is_settled(f - 1) && is_settled(f) && is_settled(f + 1)) a.tracks.clear(), a.weights.clear(), a.views.clear();
  }
}

Denoiser::Source Denoiser::read(int frame) {
  run_.check_stop();
  const auto start = cpu_seconds();
  InputFrame in(run_, frame);
  spent("read", start);
  const auto prepared = cpu_seconds();
  Source out;
  const auto planes = [&](const LayerDesc& layer, int channels) { return in.planes(layer, channels); };
  const Planes color = planes(layers::color(), 3);
  const int width = color.width(), height = color.height();
  const Planes first_albedo = planes(layers::albedo(), 3), first_normal = planes(layers::normal(), 3);
  for (const std::vector<std::string>& chains : views_) {
    ChainView seen = in.chains(chains);
    View view{std::move(seen.albedo), std::move(seen.normal), {}};
    if (out.views.empty()) {  // all that is seen: the first surface where no chain ends
      const Planes sum = view.albedo;
      const auto light_of = [&](int y, int x) {
        return luminance(sum.row(0, y)[x], sum.row(1, y)[x], sum.row(2, y)[x]);
      };
      const auto fill = [&](Planes& feature, const Planes& first) {
        if (chains.empty() || first.empty()) {
          feature = first;
        } else {
          for_values(feature, [&](int c, int y, int x, float v) {
            return light_of(y, x) < kLeastReflectance ? first.row(c, y)[x] : v;
          });
        }
      };
      fill(view.albedo, first_albedo), fill(view.normal, first_normal);
    }
    view.divisor = view.albedo.empty() ? Planes(width, height, 3, 1) : view.albedo;
    for (float& v : view.divisor.values()) v = std::max(v, kLeastReflectance);
    out.views.push_back(std::move(view));
  }
  Surfaces& s = out.surfaces;
  s.normal = first_normal;
  if (available_.motion && radius_ > 0) {
    s.forward = in.vectors(layers::motion_forward()), s.backward = in.vectors(layers::motion_backward());
  }

  out.emitter = Planes(width, height, 1);
  const bool whole = parts_.size() == 1;
  if (const Planes emission = planes(layers::emission(), 3); whole && !emission.empty()) {
    Planes shine(width, height, 2);
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        shine.row(0, y)[x] = luminance(emission.row(0, y)[x], emission.row(1, y)[x], emission.row(2, y)[x]);
        shine.row(1, y)[x] = luminance(color.row(0, y)[x], color.row(1, y)[x], color.row(2, y)[x]);
      }
    });
    Planes around(width, height, 1);
    const Planes mean = box_mean(shine, kVarianceRadius);
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) around.row(0, y)[x] = shine.row(0, y)[x] > kEmitterShare * mean.row(1, y)[x];
    });
    const Planes grown = box_mean(around, 1);
    for_values(out.emitter, [&](int, int y, int x, float) { return grown.row(0, y)[x] > 0 ? 1.0f : 0.0f; });
    for_values(out.views[0].divisor,
               [&](int, int y, int x, float v) { return out.emitter.row(0, y)[x] > 0 ? 1.0f : v; });
  }
  // What emits and what does not never stand for each other.
  s.id = Planes(width, height, 1);
  const Planes id = planes(layers::object_id(), 1);
  for_values(s.id, [&](int, int y, int x, float) {
    return (id.empty() ? 0.0f : 2 * id.row(0, y)[x]) + out.emitter.row(0, y)[x];
  });

  const auto halves_of = [](const Planes& all, const Planes& a, const Planes& b) {
    std::array<Planes, 2> halves = centred_halves(all, a, b);
    return Light{std::move(halves[0]), std::move(halves[1]), {}};
  };
  Light rest{color, {}, {}};
  if (available_.halves && samples_of(in.metadata()) != 1)
    rest = halves_of(color, planes(layers::color_a(), 3), planes(layers::color_b(), 3));
  std::array<Planes, 2> fireflies;
  if (hold_fireflies_ && rest.halves()) fireflies = held_fireflies(rest, out.held);
  for (const Part& part : parts_) {
    Light light;
    if (part.name.empty()) {
      light = std::move(rest);
    } else {
      const auto layer = [&](const LayerDesc& d) { return planes(layers::class_layer(part.name, d), 3); };
      light = halves_of(layer(layers::color()), layer(layers::color_a()), layer(layers::color_b()));
      for_values(rest.a, [&](int c, int y, int x, float v) { return v - light.a.row(c, y)[x]; });
      for_values(rest.b, [&](int c, int y, int x, float v) { return v - light.b.row(c, y)[x]; });
    }
    if (!fireflies[0].empty()) {  // of a pixel, all parts alike
      for_values(light.a, [&](int, int y, int x, float v) { return v * fireflies[0].row(0, y)[x]; });
      for_values(light.b, [&](int, int y, int x, float v) { return v * fireflies[1].row(0, y)[x]; });
    }
    prepare(light, part.divide ? &out.views[part.view].divisor : nullptr,
            light.halves() ? Planes() : planes(layers::color_variance(), 3));
    out.light.push_back(std::move(light));
  }
  damaged_ += in.damaged();
  spent("prepare", prepared);
  return out;
}

void Denoiser::prepare(Light& light, const Planes* divisor, const Planes& color_variance) {
  if (divisor) {
    const auto divided = [&](int c, int y, int x, float v) { return v / divisor->row(c, y)[x]; };
    for_values(light.a, divided);
    if (light.halves()) for_values(light.b, divided);
  }
  if (light.halves()) {
    light.variance = half_variance(light.a, light.b, kVarianceRadius);
  } else if (!color_variance.empty()) {
    Planes raw(light.a.width(), light.a.height(), 1);
    for_values(raw, [&](int, int y, int x, float) {
      float sum = 0;
      for (int c = 0; c < 3; ++c) {
        const float d = divisor ? divisor->row(c, y)[x] : 1;
        sum += color_variance.row(c, y)[x] / (d * d);
      }
      return sum / 3;
    });
    light.variance = box_mean(raw, kVarianceRadius);
  } else {
    light.variance = apparent_variance(light.a, kVarianceRadius);
  }
}

std::array<Planes, 2> Denoiser::held_fireflies(const Light& light, Held& shares) {
  const auto brightness = [](const Planes& in) {
    Planes out(in.width(), in.height(), 1);
    for_values(out,
               [&](int, int y, int x, float) { return luminance(in.row(0, y)[x], in.row(1, y)[x], in.row(2, y)[x]); });
    return out;
  };
  const std::array<Planes, 2> half{brightness(light.a), brightness(light.b)};
  const int width = half[0].width(), height = half[0].height();
  std::array<Planes, 2> factor{Planes(width, height, 1, 1), Planes(width, height, 1, 1)};
  const float floor = std::sqrt(noise_floor(light.a));
  std::vector<double> held(std::size_t(height), 0.0), all(std::size_t(height), 0.0);
  for (int h = 0; h < 2; ++h) {
    const Planes &own = half[std::size_t(h)], &other = half[std::size_t(1 - h)];
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        float largest = 0;
        for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
          for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i)
            largest = std::max(largest, other.row(0, j)[i]);
        }
        const float l = own.row(0, y)[x], most = kFirefly * largest + floor;
        all[std::size_t(y)] += double(l);
        if (!(l > most)) continue;
        held[std::size_t(y)] += double(l - most);
        factor[std::size_t(h)].row(0, y)[x] = most / l;
      }
    });
  }
  for (int y = 0; y < height; ++y) shares.held += held[std::size_t(y)], shares.all += all[std::size_t(y)];
  return factor;
}

Denoiser::Averaged Denoiser::average(int frame) {
  const Source& here = source(frame);
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) source(f);
  const auto start = cpu_seconds();
  Averaged out;
  for (int f = range.first; f <= range.last; ++f) {
    if (f == frame) continue;
    Track track = follow(frame, f, [&](int g) -> const Surfaces& { return source(g).surfaces; });
    if (!track.empty()) out.tracks.emplace(f, std::move(track));
  }
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    Light light = here.light[part];
    const Planes own = light.mean(), own_variance = light.variance;
    Planes total(own.width(), own.height(), 1, 1);
    Likeness likeness;
    likeness.floor = noise_floor(own);
    for (const auto& [f, track] : out.tracks) {
      const Light& there = source(f).light[part];
      const Planes a = gather_nearest(there.a, track), b = there.halves() ? gather_nearest(there.b, track) : Planes();
      const Planes variance = gather_nearest(there.variance, track);
      Planes mean = a;
      if (!b.empty()) for_values(mean, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
      Planes weight = likeness_weights(own, own_variance, mean, variance, track.valid, likeness);
      add_weighted(a, weight, light.a);
      if (light.halves()) add_weighted(b, weight, light.b);
      for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
      out.weights[f].push_back(std::move(weight));
    }
    divide(light.a, total);
    if (light.halves()) {
      divide(light.b, total);
      light.variance = half_variance(light.a, light.b, kVarianceRadius);
    } else {
      divide(light.variance, total);
    }
    out.light.push_back(std::move(light));
  }
  spent("average before", start);

  const auto features = cpu_seconds();
  const auto prefilter = [&](const char* name, const Planes& in) {
    return in.empty() || !oidn_ ? in : oidn_->prefilter(name, in);
  };
  for (const View& view : here.views) {
    View clean{prefilter("albedo", view.albedo), prefilter("normal", view.normal), {}};
    for (float& v : clean.albedo.values()) v = std::clamp(v, 0.0f, 1.0f);
    out.views.push_back(std::move(clean));
  }
  spent("features", features);

  const auto trials = cpu_seconds();
  // All light together is always divided.
  for (std::size_t part = 0; part < parts_.size(); ++part)
    out.trials.push_back(parts_.size() > 1 ? try_both(frame, out, part) : Trial{});
  spent("trials", trials);
  return out;
}

namespace {

Planes joined(std::initializer_list<const Planes*> planes) {
  int channels = 0;
  const Planes* any = nullptr;
  for (const Planes* p : planes) channels += p->channels(), any = p->empty() ? any : p;
  if (!any) return {};
  Planes out(any->width(), any->height(), channels);
  int channel = 0;
  for (const Planes* p : planes) {
    for (int c = 0; c < p->channels(); ++c) std::copy_n(p->plane(c), p->pixels(), out.plane(channel++));
  }
  return out;
}

const Planes* pointer(const Planes& p) { return p.empty() ? nullptr : &p; }

}  // namespace

Denoiser::Denoised Denoiser::denoise(int frame) {
  Denoised out;
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    const Light& light = averaged(frame).light[part];
    const auto dark = [](const Planes& p) {
      return std::all_of(p.values().begin(), p.values().end(), [](float v) { return v == 0; });
    };
    if (dark(light.a) && dark(light.b)) {  // a class that nothing in the picture belongs to
      out.light.push_back(light);
      out.factor.emplace_back(light.a.width(), light.a.height(), 3, 1.0f);
    } else if (oidn_) {
      denoise_oidn(frame, part, out);
    } else {
      denoise_nl_means(frame, part, out);
    }
  }
  return out;
}

NlMeansSettings Denoiser::nl_means_settings(const Averaged& averaged, std::size_t part, bool divided) const {
  NlMeansSettings settings;
  const auto feature = [&](int channels, float floor) {
    settings.feature_groups.push_back(channels), settings.feature_floors.push_back(floor);
  };
  const View& view = averaged.views[parts_[part].view];
  if (!view.normal.empty()) feature(3, 4e-3f);
  if (!divided && !view.albedo.empty()) feature(3, 1e-3f);
  feature(1, 1e-3f);  // what emits, and what does not
  return settings;
}

Denoiser::Bundle Denoiser::bundle(int frame, const Averaged& averaged, std::size_t part, bool divided,
                                  const Track* track) {
  const Source& s = source(frame);
  const View& view = averaged.views[parts_[part].view];
  static const Planes none;
  Bundle out{averaged.light[part], {}, joined({&view.normal, divided ? &none : &view.albedo, &s.emitter})};
  if (parts_[part].divide && !divided) {
    const Planes& divisor = s.views[parts_[part].view].divisor;
    out.light.a = multiply(out.light.a, divisor);
    if (out.light.halves()) {
      out.light.b = multiply(out.light.b, divisor);
      out.light.variance = half_variance(out.light.a, out.light.b, kVarianceRadius);
    } else {
      for_values(out.light.variance, [&](int, int y, int x, float v) {
        float sum = 0;
        for (int c = 0; c < 3; ++c) sum += divisor.row(c, y)[x] * divisor.row(c, y)[x];
        return v * sum / 3;
      });
    }
  }
  if (track) {
    for (Planes* p : {&out.light.a, &out.light.b, &out.light.variance, &out.features}) {
      if (!p->empty()) *p = gather_nearest(*p, *track);
    }
    out.valid = track->valid;
  }
  return out;
}

Denoiser::Trial Denoiser::try_both(int frame, const Averaged& averaged, std::size_t part) {
  Trial trial;
  if (!parts_[part].divide || averaged.views[parts_[part].view].albedo.empty() || !averaged.light[part].halves())
    return trial;
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  const Planes& divisor = source(frame).views[parts_[part].view].divisor;
  const Light truth{multiply(averaged.light[part].a, divisor), multiply(averaged.light[part].b, divisor), {}};
  const float floor = 1e4f * noise_floor(truth.a);
  const int every = (width + 63) / 64 * ((height + 31) / 32) >= 4 * kTrialTiles ? kTrialTiles : 4;
  for (const bool divided : {true, false}) {
    const Bundle b = bundle(frame, averaged, part, divided, nullptr);
    NlMeansSettings settings = nl_means_settings(averaged, part, divided);
    settings.floor = noise_floor(b.light.a);
    settings.every = every, settings.window = kTrialWindow;
    const NlMeansFrame only{&b.light.a, &b.light.b, &b.light.variance, nullptr, pointer(b.features)};
    const NlMeansResult result = nl_means(std::span(&only, 1), settings);
    const Planes back = divided ? factor(frame, averaged, part, kLeastReflectance) : Planes(width, height, 3, 1);
    std::vector<double> rows(std::size_t(height), 0.0);
    for_rows(height, [&](int y) {
      double sum = 0;
      for (int x = 0; x < width; ++x) {
        if (!is_on_trial(x, y, every)) continue;
        for (int c = 0; c < 3; ++c) {
          const float a = result.a.row(c, y)[x] * back.row(c, y)[x], b_ = result.b.row(c, y)[x] * back.row(c, y)[x];
          const float da = truth.b.row(c, y)[x] - a, db = truth.a.row(c, y)[x] - b_, mean = 0.5f * (a + b_);
          sum += double((da * da + db * db) / (mean * mean + floor));
        }
      }
      rows[std::size_t(y)] = sum;
    });
    for (const double r : rows) (divided ? trial.divided : trial.whole) += r;
  }
  return trial;
}

bool Denoiser::is_divided(int frame, std::size_t part) {
  if (!parts_[part].divide) return false;
  Trial sum;
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) {
    const Trial& trial = averaged(f).trials[part];
    sum.divided += trial.divided, sum.whole += trial.whole;
  }
  return sum.divided <= sum.whole;
}

Planes Denoiser::factor(int frame, const Averaged& averaged, std::size_t part, float least) {
  const Source& own = source(frame);
  Planes out(run_.in()[0].width, run_.in()[0].height, 3, 1);
  const Planes& albedo = averaged.views[parts_[part].view].albedo;
  if (!parts_[part].divide || albedo.empty()) return out;
  for_values(out, [&](int c, int y, int x, float) {
    return own.emitter.row(0, y)[x] > 0 ? 1.0f : std::max(albedo.row(c, y)[x], least);
  });
  return out;
}

void Denoiser::denoise_nl_means(int frame, std::size_t part, Denoised& out) {
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) averaged(f);
  const bool divided = is_divided(frame, part);
  const auto start = cpu_seconds();
  const Averaged& here = averaged(frame);
  std::vector<Bundle> bundles;
  bundles.push_back(bundle(frame, here, part, divided, nullptr));
  for (int f = range.first; f <= range.last; ++f) {
    const auto track = here.tracks.find(f);
    if (track != here.tracks.end()) bundles.push_back(bundle(f, averaged(f), part, divided, &track->second));
  }
  std::vector<NlMeansFrame> frames;
  for (const Bundle& b : bundles)
    frames.push_back({&b.light.a, pointer(b.light.b), &b.light.variance, pointer(b.valid), pointer(b.features)});
  NlMeansSettings settings = nl_means_settings(here, part, divided);
  settings.floor = noise_floor(bundles[0].light.a);
  NlMeansResult result = nl_means(frames, settings);
  Light clean{std::move(result.a), std::move(result.b), {}};
  Planes factor = this->factor(frame, here, part, divided ? kLeastReflectance : kLeastFactor);
  if (!divided) {
    const auto divide_again = [&](int c, int y, int x, float v) { return v / factor.row(c, y)[x]; };
    for_values(clean.a, divide_again);
    if (clean.halves()) for_values(clean.b, divide_again);
  }
  out.light.push_back(std::move(clean));
  out.factor.push_back(std::move(factor));
  spent("NL-means", start);
}

void Denoiser::denoise_oidn(int frame, std::size_t part, Denoised& out) {
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) averaged(f);
  const Averaged& here = averaged(frame);
  const View& view = here.views[parts_[part].view];
  const bool can_divide = parts_[part].divide, divided = parts_.size() > 1 && is_divided(frame, part);
  const auto start = cpu_seconds();
  Planes factor = this->factor(frame, here, part, divided ? kLeastReflectance : kLeastFactor);
  const Planes white = divided ? Planes(factor.width(), factor.height(), 3, 1) : Planes();
  const auto clean = [&](const Planes& light) {
    Planes color = can_divide && !divided ? multiply(light, source(frame).views[parts_[part].view].divisor) : light;
    for (float& v : color.values()) v = std::max(v, 0.0f);
    Planes done = oidn_->denoise(color, divided ? white : view.albedo, view.normal);
    if (!divided) for_values(done, [&](int c, int y, int x, float v) { return v / factor.row(c, y)[x]; });
    return done;
  };
  const Light& light = here.light[part];
  Light done;
  if (recipe_ != Recipe::kSingle && light.halves()) {
    done.a = clean(light.a), done.b = clean(light.b);
  } else {
    done.a = clean(light.mean());
  }
  out.light.push_back(std::move(done));
  out.factor.push_back(std::move(factor));
  spent("Open Image Denoise", start);
}

void Denoiser::make(int frame, Frame& out) {
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) denoised(f);
  const Denoised& here = denoised(frame);
  const Averaged& noisy = averaged(frame);
  const auto start = cpu_seconds();
  const bool halves = here.light[0].halves();
  const bool residuals = settings_.residuals && halves;
  // The denoised picture and, for residuals, its halves and the noisy ones.
  enum { kClean, kCleanA, kCleanB, kA, kB, kPictures };
  std::vector<Planes> sums(residuals ? kPictures : 1, Planes(out.width(), out.height(), 3));
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    const auto pictures = [&](int f) {
      const Light& clean = denoised(f).light[part];
      std::vector<Planes> p{clean.mean()};
      if (residuals) {
        const Light& light = averaged(f).light[part];
        p.insert(p.end(), {clean.a, clean.b, light.a, light.b});
      }
      return p;
    };
    const Light& clean = here.light[part];
    std::vector<Planes> sum = pictures(frame);
    const Planes own = sum[kClean];
    Planes total(own.width(), own.height(), 1, 1);
    const bool by_halves = recipe_ != Recipe::kSingle && halves;
    const Planes variance = by_halves ? half_variance(clean.a, clean.b, kVarianceRadius) : Planes();
    Likeness likeness{.k = 1, .radius = 2, .relative = 1e-6f, .floor = noise_floor(own)};
    for (const auto& [f, track] : noisy.tracks) {
      std::vector<Planes> there = pictures(f);
      for (Planes& p : there) p = gather_smooth(p, track);
      Planes weight;
      if (by_halves) {
        const Light& l = denoised(f).light[part];
        const Planes other = gather_nearest(half_variance(l.a, l.b, kVarianceRadius), track);
        weight = likeness_weights(own, variance, there[kClean], other, track.valid, likeness);
      } else {
        weight = noisy.weights.at(f)[part];
      }
      for (std::size_t i = 0; i < sum.size(); ++i) add_weighted(there[i], weight, sum[i]);
      for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
    }
    for (std::size_t i = 0; i < sum.size(); ++i) {
      divide(sum[i], total);
      const Planes* factor = i < kA                ? &here.factor[part]
                             : parts_[part].divide ? &source(frame).views[parts_[part].view].divisor
                                                   : nullptr;
      for_values(sums[i], [&](int c, int y, int x, float v) {
        return v + sum[i].row(c, y)[x] * (factor ? factor->row(c, y)[x] : 1.0f);
      });
    }
  }
  spent("average after", start);
  if (residuals) {
    const auto begin = cpu_seconds();
    sums[kClean] = return_residuals({sums[kA], sums[kB], sums[kCleanA], sums[kCleanB], sums[kClean]}, 1);
    spent("residuals", begin);
  }
  Image& color = out.layer(layers::color().name);
  for_rows(color.height(), [&](int y) {
    for (int x = 0; x < color.width(); ++x) {
      float* to = color.pixel(x, y);
      for (int c = 0; c < 3; ++c) to[c] = std::max(sums[kClean].row(c, y)[x], 0.0f);
    }
  });
  if (hold_fireflies_ && source(frame).held.all > 0)
    out.metadata["tempera/denoise_held_share"] = source(frame).held.share();
  held_.held += source(frame).held.held, held_.all += source(frame).held.all;
  ++frames_;
}

std::vector<std::string> Denoiser::notes() const {
  const char* const how = recipe_ == Recipe::kComponents ? "halves of the samples, by class of light paths"
                          : recipe_ == Recipe::kHalves   ? "halves of the samples"
                                                         : "all samples together";
  std::vector<std::string> out{fmt::format("denoised by {}: {}", describe_method(oidn_.get()), how)};
  if (damaged_ > 0) out.push_back(fmt::format("{} values that are not finite or beyond 1e14 count as 0", damaged_));
  if (hold_fireflies_ && held_.all > 0)
    out.push_back(
        fmt::format("{:.2g} % of the light was held back, as it outshines the other half of the samples by far",
                    100 * held_.share()));
  return out;
}

std::string Denoiser::costs() const {
  if (frames_ == 0) return "";
  const SequenceDesc& in = run_.in()[0];
  const double scale = 1e6 / (double(in.width) * in.height * frames_);
  std::string text;
  double sum = 0;
  for (const auto& [step, seconds] : seconds_) {
    text += fmt::format("{}{} {:.2f}", text.empty() ? "" : ", ", step, seconds * scale);
    sum += seconds * scale;
  }
  return fmt::format("microseconds of one core a pixel and frame: {}; together {:.2f}", text, sum);
}

}  // namespace tempera::denoise
