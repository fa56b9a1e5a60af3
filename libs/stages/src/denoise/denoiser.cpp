// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <numeric>
#include <utility>

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
constexpr int kFireflyRadius = 7;     ///< around which they are counted
constexpr float kFireflyShare = 0.015f;  ///< of the pixels there, from which on they begin to count as light
constexpr int kVarianceRadius = 3;
constexpr int kFew = 16;        ///< samples per pixel, up to which halves are too noisy to be denoised apart
constexpr int kSome = 24;       ///< from which on classes may be filtered apart
constexpr int kMany = 64;       ///< from which on the larger network costs less than the samples that it saves
constexpr int kTrialTiles = 8;  ///< one tile of so many is tried, in large pictures
constexpr int kTrialWindow = 5;
constexpr double kApartGain = 0.99;  ///< parts that are filtered apart must gain more than chance, for twice the time

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
  // Classes whose light the first surface scatters belong together: they are divided by the same reflectance.
  std::vector<std::string> scattered;
  for (const ClassInfo& c : classes(metadata)) {
    const bool there =
        std::find(available_.classes.begin(), available_.classes.end(), c.name) != available_.classes.end();
    if (there && c.chains == std::vector<std::string>{"D"}) scattered.push_back(c.name);
  }
  const int samples = samples_of(metadata).value_or(kMany);
  if (recipe_ == Recipe::kAuto) {
    recipe_ = !available_.halves || samples <= kFew             ? Recipe::kSingle
              : oidn_ && !scattered.empty() && samples >= kSome ? Recipe::kComponents
                                                                : Recipe::kHalves;
  }
  thorough_ = samples >= kMany;
  if (recipe_ == Recipe::kComponents && scattered.empty()) {
    log_info(
        "no classes of a decomposition with halves that the first surface scatters: all light is filtered together");
    recipe_ = Recipe::kHalves;
  }
  if (recipe_ == Recipe::kComponents) {
    std::vector<std::string> rest = available_.chains;
    const bool diffuse = std::erase(rest, "D") > 0;
    views_.push_back(diffuse ? std::vector<std::string>{"D"} : std::vector<std::string>{});
    if (views_[0] != rest) views_.push_back(rest);
    parts_ = {{scattered, 0, false}, {{}, views_.size() - 1, true}};
  } else {
    views_ = {available_.chains};
    parts_ = {{{}, 0, true}};
  }
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
  if (it == averaged_.end()) {
    it = averaged_.emplace(frame, average(frame)).first;
    it->second.trial = try_both(frame);
    forget();
  }
  return it->second;
}
const Denoiser::Denoised& Denoiser::denoised(int frame) {
  auto it = denoised_.find(frame);
  if (it == denoised_.end()) {
    it = denoised_.emplace(frame, denoise(frame)).first;
    forget();
  }
  return it->second;
}

void Denoiser::forget() {
  // Frames are made, denoised and averaged in ascending order; these are the next ones.
  const int denoise = std::max(denoised_.empty() ? 0 : denoised_.rbegin()->first + 1, making_ - radius_);
  const int average = std::max(averaged_.empty() ? 0 : averaged_.rbegin()->first + 1, denoise - 1);
  const auto forget_before = [](auto& frames, int before) { frames.erase(frames.begin(), frames.lower_bound(before)); };
  forget_before(denoised_, making_ - radius_);
  forget_before(averaged_, std::min(making_ - radius_, denoise - 1));
  forget_before(sources_, std::min({making_ - radius_, denoise - 1, average - radius_}));
  for (auto& [f, source] : sources_) {
    if (f < average - radius_) source.light.clear();
    if (f < std::min(making_, denoise - 1)) source.views.clear(), source.emitter = {};
  }
}

Denoiser::Tracks Denoiser::tracks(int frame, int distance) {
  const FrameRange range = around(frame, distance);
  Tracks out;
  for (int f = range.first; f <= range.last; ++f) {
    if (f == frame) continue;
    Track track = follow(frame, f, [&](int g) -> const Surfaces& { return source(g).surfaces; });
    if (!track.empty()) out.emplace(f, std::move(track));
  }
  return out;
}

Denoiser::Source Denoiser::read(int frame) {
  run_.check_stop();
  const auto start = cpu_seconds();
  const bool by_class = parts_.size() > 1;
  InputFrame in(run_, frame, [&](const LayerDesc& d) {
    if (d.path_class.empty()) return true;
    const std::vector<std::string>& wanted = parts_[0].classes;
    return by_class && std::find(wanted.begin(), wanted.end(), d.path_class) != wanted.end();
  });
  spent("read", start);
  const auto prepared = cpu_seconds();
  Source out;
  const auto planes = [&](const LayerDesc& layer, int channels) { return in.take(layer, channels); };
  const Planes color = planes(layers::color(), 3);
  const int width = color.width(), height = color.height();
  const Planes first_albedo = planes(layers::albedo(), 3), first_normal = planes(layers::normal(), 3);
  for (const std::vector<std::string>& chains : views_) {
    if (chains.empty()) {
      out.views.push_back({PackedPlanes(first_albedo), PackedPlanes(first_normal)});
      continue;
    }
    ChainView seen = in.chains(chains);
    // Where no chain ends the edges of the first surface are known, but its reflectance says nothing of the light.
    if (!first_normal.empty()) {
      const Planes& sum = seen.albedo;
      for_values(seen.normal, [&](int c, int y, int x, float v) {
        const float light = luminance(sum.row(0, y)[x], sum.row(1, y)[x], sum.row(2, y)[x]);
        return light < kLeastReflectance ? first_normal.row(c, y)[x] : v;
      });
    }
    out.views.push_back({PackedPlanes(seen.albedo), PackedPlanes(seen.normal)});
  }
  Surfaces& s = out.surfaces;
  s.normal = PackedPlanes(first_normal);
  if (available_.motion && radius_ > 0) {
    s.forward = in.vectors(layers::motion_forward()), s.backward = in.vectors(layers::motion_backward());
  }

  Planes emitter(width, height, 1);
  if (const Planes emission = planes(layers::emission(), 3); !emission.empty()) {
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
    for_values(emitter, [&](int, int y, int x, float) { return grown.row(0, y)[x] > 0 ? 1.0f : 0.0f; });
  }
  // What emits and what does not never stand for each other.
  s.id = Planes(width, height, 1);
  const Planes id = planes(layers::object_id(), 1);
  for_values(
      s.id, [&](int, int y, int x, float) { return (id.empty() ? 0.0f : 2 * id.row(0, y)[x]) + emitter.row(0, y)[x]; });
  out.emitter = PackedPlanes(emitter);

  const auto halves_of = [](const Planes& all, const Planes& a, const Planes& b) {
    std::array<Planes, 2> halves = centred_halves(all, a, b);
    return Light{std::move(halves[0]), std::move(halves[1]), {}};
  };
  Light rest{color, {}, {}};
  if (available_.halves && samples_of(in.metadata()) != 1)
    rest = halves_of(color, planes(layers::color_a(), 3), planes(layers::color_b(), 3));
  const Planes variance = rest.halves() ? Planes() : planes(layers::color_variance(), 3);
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    const Part& part = parts_[p];
    Light light;
    if (part.classes.empty()) {
      light = std::exchange(rest, {});
    } else {
      for (const std::string& name : part.classes) {
        const auto layer = [&](const LayerDesc& d) { return planes(layers::class_layer(name, d), 3); };
        Light one = halves_of(layer(layers::color()), layer(layers::color_a()), layer(layers::color_b()));
        if (light.a.empty()) {
          light = std::move(one);
        } else {
          for_values(light.a, [&](int c, int y, int x, float v) { return v + one.a.row(c, y)[x]; });
          for_values(light.b, [&](int c, int y, int x, float v) { return v + one.b.row(c, y)[x]; });
        }
      }
      for_values(rest.a, [&](int c, int y, int x, float v) { return v - light.a.row(c, y)[x]; });
      for_values(rest.b, [&](int c, int y, int x, float v) { return v - light.b.row(c, y)[x]; });
    }
    if (hold_fireflies_ && light.halves()) {
      const std::array<Planes, 2> kept = held_fireflies(light, emitter, out.held);
      for_values(light.a, [&](int, int y, int x, float v) { return v * kept[0].row(0, y)[x]; });
      for_values(light.b, [&](int, int y, int x, float v) { return v * kept[1].row(0, y)[x]; });
    }
    prepare(light, divisor(out, {p}), variance);
    out.light.emplace_back(light);
  }
  damaged_ += in.damaged();
  spent("prepare", prepared);
  return out;
}

Planes Denoiser::divisor(const Source& source, const std::vector<std::size_t>& parts) const {
  const std::size_t first = parts_[parts.front()].view, last = parts_[parts.back()].view;
  Planes out = source.views[first].albedo.planes();
  if (out.empty()) return out;
  const PackedPlanes& more = source.views[last].albedo;
  const bool emits = parts_[parts.back()].emits;
  for_values(out, [&](int c, int y, int x, float v) {
    if (emits && source.emitter.at(0, y, x) > 0) return 1.0f;
    return std::max(first == last ? v : v + more.at(c, y, x), kLeastReflectance);
  });
  return out;
}

void Denoiser::prepare(Light& light, const Planes& divisor, const Planes& color_variance) const {
  if (!divisor.empty()) {
    const auto divided = [&](int c, int y, int x, float v) { return v / divisor.row(c, y)[x]; };
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
        const float d = divisor.empty() ? 1 : divisor.row(c, y)[x];
        sum += color_variance.row(c, y)[x] / (d * d);
      }
      return sum / 3;
    });
    light.variance = box_mean(raw, kVarianceRadius);
  } else {
    light.variance = apparent_variance(light.a, kVarianceRadius);
  }
}

std::array<Planes, 2> Denoiser::held_fireflies(const Light& light, const Planes& emitter, Held& shares) {
  const auto brightness = [](const Planes& in) {
    Planes out(in.width(), in.height(), 1);
    for_values(out,
               [&](int, int y, int x, float) { return luminance(in.row(0, y)[x], in.row(1, y)[x], in.row(2, y)[x]); });
    return out;
  };
  const std::array<Planes, 2> half{brightness(light.a), brightness(light.b)};
  const int width = half[0].width(), height = half[0].height();
  const float floor = std::sqrt(noise_floor(light.a));
  std::array<Planes, 2> most{Planes(width, height, 1), Planes(width, height, 1)};
  Planes outliers(width, height, 1);
  for (int h = 0; h < 2; ++h) {
    const Planes &own = half[std::size_t(h)], &other = half[std::size_t(1 - h)];
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        // Beside a lamp its light is no measure of what is none.
        float largest = 0;
        for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
          for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i) {
            if (emitter.row(0, j)[i] <= emitter.row(0, y)[x]) largest = std::max(largest, other.row(0, j)[i]);
          }
        }
        const float limit = kFirefly * largest + floor;
        most[std::size_t(h)].row(0, y)[x] = limit;
        if (own.row(0, y)[x] > limit) outliers.row(0, y)[x] += 1;
      }
    });
  }
  const Planes density = box_mean(outliers, kFireflyRadius);
  std::vector<double> held(std::size_t(height), 0.0), all(std::size_t(height), 0.0);
  for (int h = 0; h < 2; ++h) {
    const Planes& own = half[std::size_t(h)];
    for_rows(height, [&](int y) {
      float* to = most[std::size_t(h)].row(0, y);
      for (int x = 0; x < width; ++x) {
        const float l = own.row(0, y)[x], limit = to[x];
        all[std::size_t(y)] += double(l);
        to[x] = 1;
        if (!(l > limit)) continue;
        // Where they are many, they are the light that is there.
        const float keep = std::clamp(density.row(0, y)[x] / kFireflyShare - 1, 0.0f, 1.0f);
        const float kept = limit + keep * (l - limit);
        held[std::size_t(y)] += double(l - kept);
        to[x] = kept / l;
      }
    });
  }
  for (int y = 0; y < height; ++y) shares.held += held[std::size_t(y)], shares.all += all[std::size_t(y)];
  return most;
}

Denoiser::Averaged Denoiser::average(int frame) {
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) source(f);
  const Source& here = source(frame);
  const auto start = cpu_seconds();
  Averaged out;
  const Tracks tracks = this->tracks(frame, radius_);
  const bool by_halves = recipe_ != Recipe::kSingle && here.light[0].halves();
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    Light light = here.light[part].light();
    const Planes own = light.mean(), own_variance = light.variance;
    Planes total(own.width(), own.height(), 1, 1);
    Likeness likeness;
    likeness.floor = noise_floor(own);
    for (const auto& [f, track] : tracks) {
      const PackedLight& there = source(f).light[part];
      const Planes a = gather_nearest(there.a, track), b = there.halves() ? gather_nearest(there.b, track) : Planes();
      const Planes variance = gather_nearest(there.variance, track);
      Planes mean = a;
      if (!b.empty()) for_values(mean, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
      const Planes weight = likeness_weights(own, own_variance, mean, variance, track.valid, likeness);
      add_weighted(a, weight, light.a);
      if (light.halves()) {
        add_weighted(b, weight, light.b);
      } else {
        for_values(light.variance, [&](int, int y, int x, float v) {
          const float w = weight.row(0, y)[x];
          return v + w * w * variance.row(0, y)[x];
        });
      }
      for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
      if (!by_halves) out.weights[f].emplace_back(weight);
    }
    divide(light.a, total);
    if (light.halves()) {
      divide(light.b, total);
      light.variance = half_variance(light.a, light.b, kVarianceRadius);
    } else {
      divide(light.variance, total), divide(light.variance, total);
    }
    out.light.emplace_back(light);
  }
  spent("average before", start);
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

Denoiser::Features Denoiser::features(const Source& source, const std::vector<std::size_t>& parts) const {
  const std::size_t first = parts_[parts.front()].view, last = parts_[parts.back()].view;
  Features out{source.views[first].albedo.planes(), source.views[first].normal.planes()};
  if (first == last) return out;
  const Planes albedo = source.views[last].albedo.planes(), normal = source.views[last].normal.planes();
  if (albedo.empty() || out.albedo.empty()) return out;
  const auto brightness = [](const Planes& p, int y, int x) {
    return luminance(p.row(0, y)[x], p.row(1, y)[x], p.row(2, y)[x]);
  };
  for_values(out.normal, [&](int c, int y, int x, float v) {
    const float a = brightness(out.albedo, y, x), b = brightness(albedo, y, x);
    return normal.empty() ? v : (v * a + normal.row(c, y)[x] * b) / std::max(a + b, 1e-6f);
  });
  for_values(out.albedo, [&](int c, int y, int x, float v) { return v + albedo.row(c, y)[x]; });
  return out;
}

std::vector<std::size_t> Denoiser::all_parts() const {
  std::vector<std::size_t> out(parts_.size());
  std::iota(out.begin(), out.end(), std::size_t(0));
  return out;
}

Denoiser::Light Denoiser::light_of(int frame, const std::vector<std::size_t>& parts, bool divided) {
  if (divided && parts.size() == 1) return averaged(frame).light[parts[0]].light();
  Light out;
  const auto scale = [](Light& light, const Planes& by, bool divide) {
    const auto factor = [&](int c, int y, int x) { return divide ? 1 / by.row(c, y)[x] : by.row(c, y)[x]; };
    for (Planes* half : {&light.a, &light.b})
      for_values(*half, [&](int c, int y, int x, float v) { return v * factor(c, y, x); });
    if (light.halves()) return;
    for_values(light.variance, [&](int, int y, int x, float v) {
      float sum = 0;
      for (int c = 0; c < 3; ++c) sum += factor(c, y, x) * factor(c, y, x);
      return v * sum / 3;
    });
  };
  for (const std::size_t part : parts) {
    Light light = averaged(frame).light[part].light();
    if (const Planes d = divisor(source(frame), {part}); !d.empty()) scale(light, d, false);
    if (out.a.empty()) {
      out = std::move(light);
      continue;
    }
    for_values(out.a, [&](int c, int y, int x, float v) { return v + light.a.row(c, y)[x]; });
    for_values(out.b, [&](int c, int y, int x, float v) { return v + light.b.row(c, y)[x]; });
  }
  if (divided) {
    if (const Planes d = divisor(source(frame), parts); !d.empty()) scale(out, d, true);
  }
  if (out.halves()) out.variance = half_variance(out.a, out.b, kVarianceRadius);
  return out;
}

Denoiser::Denoised Denoiser::denoise(int frame) {
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) averaged(f);
  Denoised out;
  const auto add = [&](std::vector<std::size_t> parts, bool divided) {
    out.push_back({.parts = std::move(parts), .divided = divided, .light = {}, .factor = {}});
  };
  if (is_apart(frame)) {  // mirrors and glass show edges that a reflectance does not have: the rest as it is
    for (std::size_t part = 0; part < parts_.size(); ++part) add({part}, !parts_[part].emits);
  } else {
    // What Open Image Denoise leaves of few samples shows the noise of the reflectance that it is multiplied by again.
    add(all_parts(), !oidn_ || recipe_ != Recipe::kSingle);
  }
  for (Group& group : out) {
    const bool dark = std::all_of(group.parts.begin(), group.parts.end(),
                                  [&](std::size_t part) { return averaged(frame).light[part].is_zero(); });
    if (dark) {  // classes that nothing in the picture belongs to
      group.light = averaged(frame).light[group.parts[0]];
      group.factor = PackedPlanes(Planes(group.light.a.width(), group.light.a.height(), 3, 1));
    } else if (oidn_) {
      denoise_oidn(frame, group);
    } else {
      denoise_nl_means(frame, group);
    }
  }
  return out;
}

NlMeansSettings Denoiser::nl_means_settings(const std::vector<std::size_t>& parts, bool divided) const {
  NlMeansSettings settings;
  const auto feature = [&](int channels, float floor) {
    settings.feature_groups.push_back(channels), settings.feature_floors.push_back(floor);
  };
  const bool chains = !views_[parts_[parts[0]].view].empty();
  if (chains || available_.normal) feature(3, 4e-3f);
  if (!divided && (chains || available_.albedo)) feature(3, 1e-3f);
  feature(1, 1e-3f);  // what emits, and what does not
  return settings;
}

Denoiser::Bundle Denoiser::bundle(int frame, const std::vector<std::size_t>& parts, bool divided, const Track* track) {
  const Source& s = source(frame);
  Features features = this->features(source(frame), parts);
  if (divided) features.albedo = {};
  const Planes emitter = s.emitter.planes();
  Bundle out{light_of(frame, parts, divided), {}, joined({&features.normal, &features.albedo, &emitter})};
  if (track) {
    for (Planes* p : {&out.light.a, &out.light.b, &out.light.variance, &out.features}) {
      if (!p->empty()) *p = gather_nearest(*p, *track);
    }
    out.valid = track->valid;
  }
  return out;
}

Denoiser::Trial Denoiser::try_both(int frame) {
  if (parts_.size() == 1) return {};
  const auto start = cpu_seconds();
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  const Light truth = light_of(frame, all_parts(), false);
  const float floor = 1e4f * noise_floor(truth.a);
  const int every = (width + 63) / 64 * ((height + 31) / 32) >= 4 * kTrialTiles ? kTrialTiles : 4;
  Trial trial;
  for (const bool apart : {true, false}) {
    std::vector<std::vector<std::size_t>> groups{all_parts()};
    if (apart) groups = {{0}, {1}};
    Planes a(width, height, 3), b(width, height, 3);
    for (const std::vector<std::size_t>& parts : groups) {
      const bool divided = !apart || !parts_[parts[0]].emits;
      const Bundle bundle = this->bundle(frame, parts, divided, nullptr);
      NlMeansSettings settings = nl_means_settings(parts, divided);
      settings.floor = noise_floor(bundle.light.a);
      settings.every = every, settings.window = kTrialWindow;
      const NlMeansFrame only{&bundle.light.a, &bundle.light.b, &bundle.light.variance, nullptr,
                              pointer(bundle.features)};
      const NlMeansResult result = nl_means(std::span(&only, 1), settings);
      const Planes back = divided
                              ? factor(source(frame), parts, features(source(frame), parts).albedo, kLeastReflectance)
                              : Planes(width, height, 3, 1);
      for_values(a, [&](int c, int y, int x, float v) { return v + result.a.row(c, y)[x] * back.row(c, y)[x]; });
      for_values(b, [&](int c, int y, int x, float v) { return v + result.b.row(c, y)[x] * back.row(c, y)[x]; });
    }
    std::vector<double> rows(std::size_t(height), 0.0);
    for_rows(height, [&](int y) {
      double sum = 0;
      for (int x = 0; x < width; ++x) {
        if (!is_on_trial(x, y, every)) continue;
        for (int c = 0; c < 3; ++c) {
          const float da = truth.b.row(c, y)[x] - a.row(c, y)[x], db = truth.a.row(c, y)[x] - b.row(c, y)[x],
                      mean = 0.5f * (a.row(c, y)[x] + b.row(c, y)[x]);
          sum += double((da * da + db * db) / (mean * mean + floor));
        }
      }
      rows[std::size_t(y)] = sum;
    });
    for (const double r : rows) (apart ? trial.apart : trial.together) += r;
  }
  spent("trials", start);
  return trial;
}

bool Denoiser::is_apart(int frame) {
  if (parts_.size() == 1) return false;
  Trial sum;
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) {
    const Trial& trial = averaged(f).trial;
    sum.apart += trial.apart, sum.together += trial.together;
  }
  return sum.apart < kApartGain * sum.together;
}

Planes Denoiser::factor(const Source& source, const std::vector<std::size_t>& parts, const Planes& albedo,
                        float least) const {
  Planes out(run_.in()[0].width, run_.in()[0].height, 3, 1);
  if (albedo.empty()) return out;
  const bool emits = parts_[parts.back()].emits;
  for_values(out, [&](int c, int y, int x, float) {
    return emits && source.emitter.at(0, y, x) > 0 ? 1.0f : std::max(albedo.row(c, y)[x], least);
  });
  return out;
}

void Denoiser::denoise_nl_means(int frame, Group& group) {
  const auto start = cpu_seconds();
  const Tracks tracks = this->tracks(frame, std::min(radius_, 1));
  std::vector<Bundle> bundles;
  bundles.reserve(tracks.size() + 1);
  bundles.push_back(bundle(frame, group.parts, group.divided, nullptr));
  for (const auto& [f, track] : tracks) bundles.push_back(bundle(f, group.parts, group.divided, &track));
  std::vector<NlMeansFrame> frames;
  for (const Bundle& b : bundles)
    frames.push_back({&b.light.a, pointer(b.light.b), &b.light.variance, pointer(b.valid), pointer(b.features)});
  NlMeansSettings settings = nl_means_settings(group.parts, group.divided);
  settings.floor = noise_floor(bundles[0].light.a);
  NlMeansResult result = nl_means(frames, settings);
  bundles.clear();
  const Source& own = source(frame);
  const Planes factor = this->factor(own, group.parts, features(source(frame), group.parts).albedo,
                                     group.divided ? kLeastReflectance : kLeastFactor);
  Light clean{std::move(result.a), std::move(result.b), {}};
  if (!group.divided) {
    const auto divide_again = [&](int c, int y, int x, float v) { return v / factor.row(c, y)[x]; };
    for_values(clean.a, divide_again);
    if (clean.halves()) for_values(clean.b, divide_again);
  }
  group.light = PackedLight(clean), group.factor = PackedPlanes(factor);
  spent("NL-means", start);
}

void Denoiser::denoise_oidn(int frame, Group& group) {
  const Source& own = source(frame);
  const auto prefiltering = cpu_seconds();
  Features f = features(own, group.parts);
  if (!f.albedo.empty()) f.albedo = oidn_->prefilter("albedo", f.albedo);
  // The noise of normals is small, and costs as much to take out.
  if (!f.normal.empty() && thorough_) f.normal = oidn_->prefilter("normal", f.normal);
  for (float& v : f.albedo.values()) v = std::clamp(v, 0.0f, 1.0f);
  spent("features", prefiltering);
  const auto start = cpu_seconds();
  const Planes factor = this->factor(own, group.parts, f.albedo, group.divided ? kLeastReflectance : kLeastFactor);
  if (group.divided && !f.normal.empty()) f.albedo = Planes(factor.width(), factor.height(), 3, 1);
  const Light light = light_of(frame, group.parts, group.divided);
  const auto clean = [&](Planes color) {
    for (float& v : color.values()) v = std::max(v, 0.0f);
    Planes done = oidn_->denoise(color, f.albedo, f.normal, thorough_);
    if (!group.divided) for_values(done, [&](int c, int y, int x, float v) { return v / factor.row(c, y)[x]; });
    return done;
  };
  Light done;
  if (recipe_ != Recipe::kSingle && light.halves()) {
    done.a = clean(light.a), done.b = clean(light.b);
  } else {
    done.a = clean(light.mean());
  }
  group.light = PackedLight(done), group.factor = PackedPlanes(factor);
  spent("Open Image Denoise", start);
}

Frame Denoiser::make(int frame) {
  making_ = frame;
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) denoised(f);
  const Denoised& here = denoised(frame);
  const Averaged& noisy = averaged(frame);
  const auto start = cpu_seconds();
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  const bool halves = here[0].light.halves();
  const bool residuals = settings_.residuals && halves;
  // The denoised picture and, for residuals, its halves and the noisy ones.
  enum { kClean, kCleanA, kCleanB, kA, kB, kPictures };
  std::vector<Planes> sums(residuals ? kPictures : 1, Planes(width, height, 3));
  const Tracks tracks = this->tracks(frame, radius_);
  for (std::size_t g = 0; g < here.size(); ++g) {
    const Group& group = here[g];
    const Light clean = group.light.light();
    const Planes own = clean.mean();
    const bool by_halves = recipe_ != Recipe::kSingle && halves;
    const Planes variance = by_halves ? half_variance(clean.a, clean.b, kVarianceRadius) : Planes();
    Likeness likeness{.k = 1, .radius = 2, .relative = 1e-6f, .floor = noise_floor(own)};
    Planes total(width, height, 1, 1);
    std::map<int, Planes> weights;
    std::vector<Planes> sum = residuals ? std::vector{own, clean.a, clean.b} : std::vector{own};
    for (const auto& [f, track] : tracks) {
      const Denoised& those = denoised(f);
      if (those.size() != here.size()) continue;  // what is filtered together there is not so here
      const Light there = those[g].light.light();
      std::vector<Planes> values{gather_smooth(there.mean(), track)};
      if (residuals) values.push_back(gather_smooth(there.a, track)), values.push_back(gather_smooth(there.b, track));
      Planes weight;
      if (by_halves) {
        const Planes other = gather_nearest(half_variance(there.a, there.b, kVarianceRadius), track);
        weight = likeness_weights(own, variance, values[kClean], other, track.valid, likeness);
      } else {
        weight = noisy.weights.at(f)[group.parts[0]].planes();
        for (const std::size_t part : group.parts) {
          const PackedPlanes& w = noisy.weights.at(f)[part];
          for_values(weight, [&](int, int y, int x, float v) { return std::min(v, w.at(0, y, x)); });
        }
      }
      for (std::size_t i = 0; i < sum.size(); ++i) add_weighted(values[i], weight, sum[i]);
      for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
      if (residuals) weights.emplace(f, std::move(weight));
    }
    const Planes factor = group.factor.planes();
    for (std::size_t i = 0; i < sum.size(); ++i) {
      divide(sum[i], total);
      for_values(sums[i], [&](int c, int y, int x, float v) { return v + sum[i].row(c, y)[x] * factor.row(c, y)[x]; });
    }
    if (!residuals) continue;
    for (const std::size_t part : group.parts) {
      const Planes d = divisor(source(frame), {part});
      for (const int i : {kA, kB}) {
        const auto half = [&](const PackedLight& l) { return (i == kA ? l.a : l.b).planes(); };
        Planes light = half(noisy.light[part]);
        for (const auto& [f, weight] : weights)
          add_weighted(gather_smooth(half(averaged(f).light[part]), tracks.at(f)), weight, light);
        divide(light, total);
        for_values(sums[std::size_t(i)], [&](int c, int y, int x, float v) {
          return v + light.row(c, y)[x] * (d.empty() ? 1.0f : d.row(c, y)[x]);
        });
      }
    }
  }
  spent("average after", start);
  if (residuals) {
    const auto begin = cpu_seconds();
    sums[kClean] = return_residuals({sums[kA], sums[kB], sums[kCleanA], sums[kCleanB], sums[kClean]}, 1);
    spent("residuals", begin);
  }
  const Held held = source(frame).held;
  forget();
  Frame out = run_.start(frame);
  Image& color = out.layer(layers::color().name);
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      float* to = color.pixel(x, y);
      for (int c = 0; c < 3; ++c) to[c] = std::max(sums[kClean].row(c, y)[x], 0.0f);
    }
  });
  if (hold_fireflies_ && held.all > 0) out.metadata["tempera/denoise_held_share"] = held.share();
  held_.held += held.held, held_.all += held.all;
  ++frames_;
  return out;
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
