// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>

#include "denoise/residuals.h"
#include "tempera/core/log.h"

namespace tempera::denoise {

namespace {

constexpr float kLeastReflectance = 0.05f;  ///< below it light is not divided by any less
constexpr float kEmitterShare = 0.02f;      ///< of the light of a pixel that it emits, from which on it counts as an emitter
constexpr float kFirefly = 4;               ///< times the brightest of the other half around that a half may be
constexpr int kVarianceRadius = 3;

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

/// The variance of noise that neighbours do not share, where nothing else tells it: of what a pixel differs from the
/// mean of its four neighbours. Edges and textures add to it.
Planes apparent_variance(const Planes& in) {
  const int width = in.width(), height = in.height();
  Planes raw(width, height, 1);
  for_rows(height, [&](int y) {
    float* to = raw.row(0, y);
    for (int c = 0; c < in.channels(); ++c) {
      const float *up = in.row(c, std::max(y - 1, 0)), *down = in.row(c, std::min(y + 1, height - 1)),
                  *here = in.row(c, y);
      for (int x = 0; x < width; ++x) {
        const float around = 0.25f * (up[x] + down[x] + here[std::max(x - 1, 0)] + here[std::min(x + 1, width - 1)]);
        const float d = here[x] - around;
        to[x] += d * d / (1.25f * float(in.channels()));
      }
    }
  });
  return box_mean(raw, kVarianceRadius);
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

Denoiser::Denoiser(StageRun& run, const Settings& settings)
    : run_(run), settings_(settings), available_(run.in()[0].layers), radius_(available_.motion ? settings.radius : 0) {
  if (settings.oidn) oidn_ = std::make_unique<Oidn>(settings.oidn_path);
}

FrameRange Denoiser::around(int frame, int distance) const {
  return shot_around(frame, radius_ > 0 ? distance : 0, run_.in()[0].reach, settings_.cuts);
}

void Denoiser::spent(const std::string& step, double start) {
  seconds_[step] += cpu_seconds() - start;
}

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
  forget(averaged_, frame - radius_ - 1);
  forget(sources_, frame - 2 * radius_ - 1);
}

Recipe Denoiser::recipe(int frame) {
  if (settings_.recipe != Recipe::kAuto) return settings_.recipe;
  const Source& s = source(frame);
  if (!s.light.halves()) return Recipe::kSingle;
  return s.spp > 16 || s.spp == 0 ? Recipe::kHalves : Recipe::kSingle;
}

Denoiser::Source Denoiser::read(int frame) {
  run_.check_stop();
  const auto start = cpu_seconds();
  const Frame in = run_.read(frame);
  spent("read", start);
  const auto prepare = cpu_seconds();
  Source out;
  if (const auto spp = in.metadata.find("tempera/spp"); spp != in.metadata.end()) {
    if (const int* n = std::get_if<int>(&spp->second)) out.spp = *n;
  }
  const auto planes = [&](const LayerDesc& layer, int channels) {
    const Layer* l = in.find(layer.name);
    return l && l->image.channels() >= channels ? Planes(l->image, channels) : Planes();
  };
  const Planes color = planes(layers::color(), 3);
  const int width = color.width(), height = color.height();
  out.albedo = planes(layers::albedo(), 3);
  Surfaces& s = out.surfaces;
  s.normal = planes(layers::normal(), 3);
  if (available_.motion && radius_ > 0) {
    const auto vectors = [&](const LayerDesc& layer) {
      const Layer* l = in.find(layer.name);
      if (!l || l->image.channels() < 2) return Planes();
      Planes v(width, height, 3, 1);  // files of others do not say what is valid
      const int valid = l->image.channels() >= 4 ? 3 : -1;
      for_rows(height, [&](int y) {
        for (int x = 0; x < width; ++x) {
          const float* p = l->image.pixel(x, y);
          const bool finite = std::isfinite(p[0]) && std::isfinite(p[1]);
          v.row(0, y)[x] = finite ? p[0] : 0, v.row(1, y)[x] = finite ? p[1] : 0;
          v.row(2, y)[x] = finite && (valid < 0 || p[valid] > 0) ? 1.0f : 0.0f;
        }
      });
      return v;
    };
    s.forward = vectors(layers::motion_forward()), s.backward = vectors(layers::motion_backward());
  }

  // Halves whose mean is `color`, also for odd numbers of samples.
  Light& light = out.light;
  light.a = color;
  if (available_.halves && out.spp != 1) {
    const Planes a = planes(layers::color_a(), 3), b = planes(layers::color_b(), 3);
    light.b = color;
    for_values(light.a, [&](int c, int y, int x, float v) { return v + 0.5f * (a.row(c, y)[x] - b.row(c, y)[x]); });
    for_values(light.b, [&](int c, int y, int x, float v) { return v - 0.5f * (a.row(c, y)[x] - b.row(c, y)[x]); });
  }
  if (!out.albedo.empty()) {
    out.divisor = out.albedo;
    for_values(out.divisor, [](int, int, int, float v) { return std::max(v, kLeastReflectance); });
    const Planes emission = planes(layers::emission(), 3);
    out.emitter = Planes(width, height, 1);
    if (!emission.empty()) {
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
      for_rows(height, [&](int y) {
        for (int x = 0; x < width; ++x) out.emitter.row(0, y)[x] = grown.row(0, y)[x] > 0 ? 1.0f : 0.0f;
      });
      for_values(out.divisor, [&](int, int y, int x, float v) { return out.emitter.row(0, y)[x] > 0 ? 1.0f : v; });
    }
    for_values(light.a, [&](int c, int y, int x, float v) { return v / out.divisor.row(c, y)[x]; });
    if (light.halves()) for_values(light.b, [&](int c, int y, int x, float v) { return v / out.divisor.row(c, y)[x]; });
  } else {
    out.divisor = Planes(width, height, 3, 1);
    out.emitter = Planes(width, height, 1);
  }
  if (settings_.hold_fireflies && light.halves()) hold_fireflies(light);
  // What emits and what does not never stand for each other.
  s.id = Planes(width, height, 1);
  const Planes id = planes(layers::object_id(), 1);
  for_values(s.id, [&](int, int y, int x, float) {
    return (id.empty() ? 0.0f : 2 * id.row(0, y)[x]) + out.emitter.row(0, y)[x];
  });

  if (light.halves()) {
    light.variance = half_variance(light.a, light.b, kVarianceRadius);
  } else if (const Planes variance = planes(layers::color_variance(), 3); !variance.empty()) {
    Planes raw(width, height, 1);
    for_values(raw, [&](int, int y, int x, float) {
      float sum = 0;
      for (int c = 0; c < 3; ++c) {
        const float d = out.divisor.row(c, y)[x];
        sum += variance.row(c, y)[x] / (d * d);
      }
      return sum / 3;
    });
    light.variance = box_mean(raw, kVarianceRadius);
  } else {
    light.variance = apparent_variance(light.a);
  }
  spent("prepare", prepare);
  return out;
}

void Denoiser::hold_fireflies(Light& light) {
  const auto brightness = [](const Planes& in) {
    Planes out(in.width(), in.height(), 1);
    for_values(out, [&](int, int y, int x, float) { return luminance(in.row(0, y)[x], in.row(1, y)[x], in.row(2, y)[x]); });
    return out;
  };
  const Planes of_a = brightness(light.a), of_b = brightness(light.b);
  const int width = of_a.width(), height = of_a.height();
  const float floor = std::sqrt(noise_floor(light.a));
  std::vector<double> held(std::size_t(height), 0.0), all(std::size_t(height), 0.0);
  const auto limit = [&](Planes& half, const Planes& own, const Planes& other) {
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        float largest = 0;
        for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
          for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i) largest = std::max(largest, other.row(0, j)[i]);
        }
        const float l = own.row(0, y)[x], most = kFirefly * largest + floor;
        all[std::size_t(y)] += double(l);
        if (!(l > most)) continue;
        held[std::size_t(y)] += double(l - most);
        for (int c = 0; c < 3; ++c) half.row(c, y)[x] *= most / l;
      }
    });
  };
  limit(light.a, of_a, of_b), limit(light.b, of_b, of_a);
  for (int y = 0; y < height; ++y) held_ += held[std::size_t(y)], all_ += all[std::size_t(y)];
}

Denoiser::Averaged Denoiser::average(int frame) {
  const Source& here = source(frame);
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) source(f);
  const auto start = cpu_seconds();
  Averaged out;
  out.light = here.light;
  const Planes own = here.light.mean();
  Planes total(own.width(), own.height(), 1, 1);
  Likeness likeness;
  likeness.floor = noise_floor(own);
  for (int f = range.first; f <= range.last; ++f) {
    if (f == frame) continue;
    Track track = follow(frame, f, [&](int g) -> const Surfaces& { return source(g).surfaces; });
    if (track.empty()) continue;
    const Light& there = source(f).light;
    const Planes a = gather_nearest(there.a, track), b = there.halves() ? gather_nearest(there.b, track) : Planes();
    const Planes variance = gather_nearest(there.variance, track);
    Planes mean = a;
    if (!b.empty()) for_values(mean, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
    Planes weight = likeness_weights(own, here.light.variance, mean, variance, track.valid, likeness);
    add_weighted(a, weight, out.light.a);
    if (out.light.halves()) add_weighted(b, weight, out.light.b);
    for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
    out.tracks.emplace(f, std::move(track));
    out.weights.emplace(f, std::move(weight));
  }
  divide(out.light.a, total);
  if (out.light.halves()) {
    divide(out.light.b, total);
    out.light.variance = half_variance(out.light.a, out.light.b, kVarianceRadius);
  } else {
    divide(out.light.variance, total);
  }
  spent("average before", start);

  const auto features = cpu_seconds();
  const auto prefilter = [&](const char* name, const Planes& in) {
    return in.empty() || !oidn_ ? in : oidn_->prefilter(name, in);
  };
  out.albedo = prefilter("albedo", here.albedo);
  for_values(out.albedo, [](int, int, int, float v) { return std::clamp(v, 0.0f, 1.0f); });
  out.normal = prefilter("normal", here.surfaces.normal);
  spent("features", features);
  return out;
}

Denoiser::Denoised Denoiser::denoise(int frame) { return oidn_ ? denoise_oidn(frame) : denoise_nl_means(frame); }

Denoiser::Denoised Denoiser::denoise_nl_means(int frame) {
  const Averaged& here = averaged(frame);
  const FrameRange range = around(frame, std::min(radius_, 1));
  for (int f = range.first; f <= range.last; ++f) averaged(f);
  const auto start = cpu_seconds();
  const int width = here.light.a.width(), height = here.light.a.height();

  NlMeansSettings settings;
  settings.floor = noise_floor(here.light.a);
  if (!here.normal.empty()) settings.feature_groups.push_back(3), settings.feature_floors.push_back(4e-3f);
  if (!here.albedo.empty()) settings.feature_groups.push_back(1), settings.feature_floors.push_back(1e-3f);
  const auto features_of = [&](int f) {
    Planes out;
    const Averaged& a = averaged(f);
    int channels = 0;
    for (const int n : settings.feature_groups) channels += n;
    if (channels == 0) return out;
    out = Planes(width, height, channels);
    int channel = 0;
    if (!a.normal.empty()) {
      for (; channel < 3; ++channel) std::copy_n(a.normal.plane(channel), out.pixels(), out.plane(channel));
    }
    if (!a.albedo.empty()) {
      const Planes& emitter = source(f).emitter;
      std::copy_n(emitter.plane(0), out.pixels(), out.plane(channel));
    }
    return out;
  };

  struct Warped {
    Planes a, b, variance, valid, features;
  };
  std::vector<Warped> warped;
  std::vector<NlMeansFrame> frames;
  warped.reserve(std::size_t(range.last - range.first + 1));
  const Planes features = features_of(frame);
  const auto pointer = [](const Planes& p) { return p.empty() ? nullptr : &p; };
  frames.push_back({&here.light.a, pointer(here.light.b), &here.light.variance, nullptr, pointer(features)});
  for (int f = range.first; f <= range.last; ++f) {
    const auto track = here.tracks.find(f);
    if (track == here.tracks.end()) continue;
    const Light& there = averaged(f).light;
    Warped w;
    w.a = gather_nearest(there.a, track->second);
    if (there.halves()) w.b = gather_nearest(there.b, track->second);
    w.variance = gather_nearest(there.variance, track->second);
    w.valid = track->second.valid;
    if (!features.empty()) w.features = gather_nearest(features_of(f), track->second);
    warped.push_back(std::move(w));
    const Warped& k = warped.back();
    frames.push_back({&k.a, pointer(k.b), &k.variance, &k.valid, pointer(k.features)});
  }
  NlMeansResult result = nl_means(frames, settings);
  Denoised out;
  out.light.a = std::move(result.a), out.light.b = std::move(result.b);
  out.factor = Planes(width, height, 3, 1);
  const Source& own = source(frame);
  if (!here.albedo.empty()) {
    for_values(out.factor, [&](int c, int y, int x, float) {
      return own.emitter.row(0, y)[x] > 0 ? 1.0f : std::max(here.albedo.row(c, y)[x], kLeastReflectance);
    });
  }
  spent("NL-means", start);
  return out;
}

Denoiser::Denoised Denoiser::denoise_oidn(int frame) {
  const Averaged& here = averaged(frame);
  const Source& own = source(frame);
  const auto start = cpu_seconds();
  const int width = own.divisor.width(), height = own.divisor.height();
  Denoised out;
  out.factor = Planes(width, height, 3, 1);
  constexpr float kLeastFactor = 0.2f;
  if (!here.albedo.empty()) {
    for_values(out.factor, [&](int c, int y, int x, float) {
      return own.emitter.row(0, y)[x] > 0 ? 1.0f : std::max(here.albedo.row(c, y)[x], kLeastFactor);
    });
  }
  const auto clean = [&](const Planes& light) {
    Planes color = multiply(light, own.divisor);
    for_values(color, [](int, int, int, float v) { return std::max(v, 0.0f); });
    Planes done = oidn_->denoise(color, here.albedo, here.normal);
    for_values(done, [&](int c, int y, int x, float v) { return v / out.factor.row(c, y)[x]; });
    return done;
  };
  if (recipe(frame) == Recipe::kHalves && here.light.halves()) {
    out.light.a = clean(here.light.a), out.light.b = clean(here.light.b);
  } else {
    out.light.a = clean(here.light.mean());
  }
  spent("Open Image Denoise", start);
  return out;
}

void Denoiser::make(int frame, Frame& out) {
  const Recipe recipe = this->recipe(frame);
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) denoised(f);
  const Denoised& here = denoised(frame);
  const Averaged& noisy = averaged(frame);
  const auto start = cpu_seconds();
  const Planes own = here.light.mean();
  const bool halves = here.light.halves(), by_halves = recipe == Recipe::kHalves && halves;
  const bool residuals = settings_.residuals && halves;
  // The denoised picture and, for residuals, its halves and the noisy ones.
  struct Averages {
    Planes clean, clean_a, clean_b, a, b;
  } sum{own, {}, {}, {}, {}};
  if (residuals) sum.clean_a = here.light.a, sum.clean_b = here.light.b, sum.a = noisy.light.a, sum.b = noisy.light.b;
  Planes total(own.width(), own.height(), 1, 1);
  const Planes variance = by_halves ? half_variance(here.light.a, here.light.b, kVarianceRadius) : Planes();
  Likeness likeness{.k = 1, .radius = 2, .relative = 1e-6f, .floor = noise_floor(own)};
  for (const auto& [f, track] : noisy.tracks) {
    const Denoised& there = denoised(f);
    const Planes value = gather_smooth(there.light.mean(), track);
    Planes weight;
    if (by_halves && there.light.halves()) {
      const Planes other = gather_nearest(half_variance(there.light.a, there.light.b, kVarianceRadius), track);
      weight = likeness_weights(own, variance, value, other, track.valid, likeness);
    } else {
      weight = noisy.weights.at(f);
    }
    add_weighted(value, weight, sum.clean);
    if (residuals) {
      add_weighted(gather_smooth(there.light.a, track), weight, sum.clean_a);
      add_weighted(gather_smooth(there.light.b, track), weight, sum.clean_b);
      add_weighted(gather_smooth(averaged(f).light.a, track), weight, sum.a);
      add_weighted(gather_smooth(averaged(f).light.b, track), weight, sum.b);
    }
    for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
  }
  const auto finish = [&](Planes& planes, const Planes& factor) {
    divide(planes, total);
    for_values(planes, [&](int c, int y, int x, float v) { return v * factor.row(c, y)[x]; });
  };
  finish(sum.clean, here.factor);
  spent("average after", start);
  if (residuals) {
    const auto begin = cpu_seconds();
    const Planes& divisor = source(frame).divisor;
    finish(sum.clean_a, here.factor), finish(sum.clean_b, here.factor);
    finish(sum.a, divisor), finish(sum.b, divisor);
    sum.clean = return_residuals({sum.a, sum.b, sum.clean_a, sum.clean_b, sum.clean}, 1);
    spent("residuals", begin);
  }
  Image& color = out.layer(layers::color().name);
  for_rows(color.height(), [&](int y) {
    for (int x = 0; x < color.width(); ++x) {
      float* to = color.pixel(x, y);
      for (int c = 0; c < 3; ++c) to[c] = std::max(sum.clean.row(c, y)[x], 0.0f);
    }
  });
  out.metadata["tempera/denoise_method"] = oidn_ ? "oidn " + oidn_->version() : std::string("nl_means");
  ++frames_;
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
