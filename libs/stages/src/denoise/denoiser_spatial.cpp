// SPDX-License-Identifier: Apache-2.0
// The denoiser of single frames: what is filtered together, by which method, with which features.
#include <algorithm>
#include <numeric>
#include <utility>

#include "denoise/denoiser.h"

namespace tempera::denoise {

namespace {

constexpr float kLeastFactor = 0.2f;  ///< that clean light is divided by, as far as it is averaged over time
constexpr int kTrialTiles = 8;        ///< one tile of so many is tried, in large pictures
constexpr int kTrialWindow = 5;
constexpr double kApartGain = 0.99;  ///< parts that are filtered apart must gain more than chance, for twice the time

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
  if (parts_.size() == 1 || recipe_ == Recipe::kClasses) return {};
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
  if (recipe_ == Recipe::kClasses) return true;
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
  const Tracks tracks = this->tracks(frame, std::min(radius_, 1), parts_[group.parts[0]]);
  std::vector<Bundle> bundles;
  bundles.reserve(tracks.size() + 1);
  bundles.push_back(bundle(frame, group.parts, group.divided, nullptr));
  for (const auto& [f, track] : tracks) bundles.push_back(bundle(f, group.parts, group.divided, &track));
  std::vector<NlMeansFrame> frames;
  frames.reserve(bundles.size());
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
  if (!f.albedo.empty() && !few_) f.albedo = oidn_->prefilter("albedo", f.albedo);
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
    Planes done = oidn_->denoise(color, f.albedo, f.normal, !few_, thorough_);
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

}  // namespace tempera::denoise
