// SPDX-License-Identifier: Apache-2.0
#include "denoise/published.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "denoise/input.h"
#include "tempera/core/random.h"

namespace tempera::denoise {

namespace {

constexpr float kLeastDivisor = 1e-3f;  ///< light of less is not divided. [Zimmer 2015, Sec. 3]
constexpr JointFilter kBalanced{.patch = 3, .color = true, .tau = 1e-3f};
constexpr int kWindow = 10;
constexpr int kUnknownSamples = 32;  ///< taken where a frame does not say its samples
constexpr float kNoiseFree = 1e-4f;  ///< relative variance of emission that is passed on as it is

/// Variance of each channel of the mean of two halves, smoothed.
Planes channel_variance(const Planes& a, const Planes& b) {
  Planes raw(a.width(), a.height(), a.channels());
  for_values(raw, [&](int c, int y, int x, float) {
    const float d = a.row(c, y)[x] - b.row(c, y)[x];
    return 0.25f * d * d;
  });
  return box_mean(raw, kVarianceRadius);
}

/// The variance where there are no halves: that of the file, or what pixels differ by from those around.
Planes variance_without_halves(InputFrame& in, const Planes& color) {
  const Planes known = in.planes(layers::color_variance(), 3);
  if (!known.empty()) return box_mean(known, kVarianceRadius);
  const Planes one = apparent_variance(color, kVarianceRadius);
  Planes out(color.width(), color.height(), 3);
  for_values(out, [&](int, int y, int x, float) { return one.row(0, y)[x]; });
  return out;
}

/// Directions in [0,1].
Planes scaled_normals(Planes normal) {
  for (float& v : normal.values()) v = 0.5f * (v + 1);
  return normal;
}

/// What is known of first surfaces and noisy.
void add_feature(FeatureStack& stack, Planes values, int samples) {
  if (values.empty()) return;
  Planes variance = bounded_variance(values, samples);
  stack.add(prefilter({std::move(values), std::move(variance)}));
}

void write_color(const Planes& sum, Frame& out) {
  Image& color = out.layer(layers::color().name);
  for_rows(color.height(), [&](int y) {
    for (int x = 0; x < color.width(); ++x) {
      for (int c = 0; c < 3; ++c) color.at(x, y, c) = std::max(sum.row(c, y)[x], 0.0f);
    }
  });
}

std::vector<std::string> notes_of(const char* how, std::int64_t damaged) {
  std::vector<std::string> out{how};
  if (damaged > 0) out.push_back(fmt::format("{} values that are not finite or beyond 1e14 count as 0", damaged));
  return out;
}

}  // namespace

FrameByFrame::FrameByFrame(StageRun& run) : run_(run), available_(run.in()[0].layers) {}

Frame FrameByFrame::make(int frame) {
  run_.check_stop();
  Frame out = run_.start(frame);
  InputFrame in(run_, frame);
  const int samples = samples_of(in.metadata()).value_or(kUnknownSamples);
  Planes color = in.planes(layers::color(), 3), b, variance;
  if (available_.halves && samples != 1) {
    auto halves = centred_halves(color, in.planes(layers::color_a(), 3), in.planes(layers::color_b(), 3));
    color = std::move(halves[0]), b = std::move(halves[1]);
    variance = channel_variance(color, b);
  } else {
    variance = variance_without_halves(in, color);
  }
  FeatureStack features;
  add_feature(features, scaled_normals(in.planes(layers::normal(), 3)), samples);
  add_feature(features, in.planes(layers::albedo(), 3), samples);
  if (Planes depth = in.planes(layers::depth(), 1); !depth.empty()) {
    const float most = *std::max_element(depth.values().begin(), depth.values().end());
    for (float& v : depth.values()) v /= std::max(most, 1e-30f);
    add_feature(features, std::move(depth), samples);
  }
  damaged_ += in.damaged();
  write_color(rmz13({color, b, variance, features}).color, out);
  return out;
}

std::vector<std::string> FrameByFrame::notes() const {
  return notes_of("denoised by rmz13: all light, each frame alone", damaged_);
}

namespace {

/// Whether all pixels that a place lies between show the object that the pixel itself does, whose `id` is here.
void stay_on_object(Track& track, const Planes& id, const Planes& there) {
  const int width = there.width(), height = there.height();
  for_rows(height, [&](int y) {
    const float *px = track.place.row(0, y), *py = track.place.row(1, y), *own = id.row(0, y);
    float* valid = track.valid.row(0, y);
    for (int x = 0; x < width; ++x) {
      if (valid[x] == 0) continue;
      const int left = int(px[x]), top = int(py[x]);
      const int right = px[x] > float(left) ? std::min(left + 1, width - 1) : left;
      const int bottom = py[x] > float(top) ? std::min(top + 1, height - 1) : top;
      for (const int j : {top, bottom}) {
        if (there.row(0, j)[left] != own[x] || there.row(0, j)[right] != own[x]) valid[x] = 0;
      }
    }
  });
}

/// Bilinear interpolation at each place; 0 where it is not valid.
Planes gather_bilinear(const Planes& in, const Track& track) {
  const int width = in.width(), height = in.height();
  Planes out(width, height, in.channels());
  for_rows(height, [&](int y) {
    const float *px = track.place.row(0, y), *py = track.place.row(1, y), *valid = track.valid.row(0, y);
    for (int x = 0; x < width; ++x) {
      if (valid[x] == 0) continue;
      const int left = int(px[x]), top = int(py[x]), right = std::min(left + 1, width - 1),
                bottom = std::min(top + 1, height - 1);
      const float fx = px[x] - float(left), fy = py[x] - float(top);
      for (int c = 0; c < in.channels(); ++c) {
        const float *upper = in.row(c, top), *lower = in.row(c, bottom);
        out.row(c, y)[x] =
            (1 - fy) * ((1 - fx) * upper[left] + fx * upper[right]) + fy * ((1 - fx) * lower[left] + fx * lower[right]);
      }
    }
  });
  return out;
}

/// Objects as colors, so that their differences are features like others.
Planes hashed(const Planes& id) {
  Planes out(id.width(), id.height(), 3);
  for_values(out, [&](int c, int y, int x, float) {
    return float(hash_key(std::uint64_t(id.row(0, y)[x]), std::uint64_t(c)) >> 40) * 0x1p-24f;
  });
  return out;
}

}  // namespace

Decomposed::Decomposed(StageRun& run, const Settings& settings)
    : run_(run), settings_(settings), available_(run.in()[0].layers), views_(1) {
  bool emission = available_.emission;
  for (const ClassView& c : class_views(available_, read_metadata(run.path(run.frames().front())))) {
    Part part{.name = c.name, .divide = c.divide, .emission = c.emission};
    if (!c.chains.empty()) {
      auto view = std::find(views_.begin() + 1, views_.end(), c.chains);
      if (view == views_.end()) view = views_.insert(view, c.chains);
      part.view = std::size_t(view - views_.begin());
    }
    if (c.emission) emission = false;  // it is in a class already
    parts_.push_back(std::move(part));
  }
  const bool whole = parts_.empty();
  if (emission) parts_.push_back({.kind = Part::Kind::kEmission, .emission = true});
  parts_.push_back({.kind = Part::Kind::kRest, .divide = whole});
}

const Decomposed::Source& Decomposed::source(int frame) {
  auto it = sources_.find(frame);
  if (it == sources_.end()) it = sources_.emplace(frame, read(frame)).first;
  return it->second;
}

Decomposed::Source Decomposed::read(int frame) {
  run_.check_stop();
  InputFrame in(run_, frame);
  const int samples = samples_of(in.metadata()).value_or(kUnknownSamples);
  const Planes color = in.planes(layers::color(), 3);
  const int width = color.width(), height = color.height();
  Source out;
  out.surfaces.forward = in.vectors(layers::motion_forward());
  out.surfaces.backward = in.vectors(layers::motion_backward());
  out.surfaces.id = in.planes(layers::object_id(), 1);
  const Planes first_normal = in.planes(layers::normal(), 3);
  out.surfaces.normal = PackedPlanes(first_normal);

  std::vector<Planes> albedo;
  std::vector<FeatureStack> features;  // of the views
  for (std::size_t v = 0; v < views_.size(); ++v) {
    FeatureStack stack;
    Planes id;
    if (v == 0) {
      albedo.push_back(in.planes(layers::albedo(), 3));
      if (!first_normal.empty()) add_feature(stack, scaled_normals(first_normal), samples);
      id = out.surfaces.id;
    } else {
      ChainView seen = in.chains(views_[v]);
      add_feature(stack, scaled_normals(std::move(seen.normal)), samples);
      albedo.push_back(std::move(seen.albedo));
      Planes most(width, height, 1);  // the object that most light comes from
      for (const std::string& chain : views_[v]) {
        const Planes object = in.planes(layers::chain_layer(chain, layers::object_id()), 1),
                     part = in.planes(layers::chain_layer(chain, layers::albedo()), 3);
        if (object.empty()) continue;
        if (id.empty()) id = Planes(width, height, 1);
        for_rows(height, [&](int y) {
          for (int x = 0; x < width; ++x) {
            const float light = luminance(part.row(0, y)[x], part.row(1, y)[x], part.row(2, y)[x]);
            if (light > most.row(0, y)[x]) most.row(0, y)[x] = light, id.row(0, y)[x] = object.row(0, y)[x];
          }
        });
      }
    }
    if (!id.empty()) stack.add({hashed(id), {}});
    features.push_back(std::move(stack));
  }

  const bool halves = available_.halves && samples != 1;
  Light rest{color, {}, {}};
  if (halves) {
    auto [a, b] = centred_halves(color, in.planes(layers::color_a(), 3), in.planes(layers::color_b(), 3));
    rest.a = std::move(a), rest.b = std::move(b);
  } else {
    rest.variance = variance_without_halves(in, color);
  }
  const auto take = [&](const Planes& a, const Planes& b) {
    for (std::size_t i = 0; i < a.values().size(); ++i) {
      rest.a.values()[i] -= a.values()[i];
      if (halves) rest.b.values()[i] -= b.values()[i];
    }
  };
  for (const Part& part : parts_) {
    Light light;
    if (part.kind == Part::Kind::kRest) {
      light = std::exchange(rest, {});
    } else if (part.kind == Part::Kind::kEmission) {
      light.a = in.planes(layers::emission(), 3);
      light.variance = bounded_variance(light.a, samples);
      take(light.a, light.a);
    } else {
      const auto layer = [&](const LayerDesc& d) { return in.planes(layers::class_layer(part.name, d), 3); };
      auto [a, b] = centred_halves(layer(layers::color()), layer(layers::color_a()), layer(layers::color_b()));
      light.a = std::move(a), light.b = std::move(b);
      if (!halves) {  // of one sample
        for (std::size_t i = 0; i < light.a.values().size(); ++i)
          light.a.values()[i] = 0.5f * (light.a.values()[i] + light.b.values()[i]);
        light.b = {};
        light.variance = variance_without_halves(in, color);
      }
      take(light.a, light.b);
    }
    FeatureStack stack = features[part.view];
    Planes divisor;
    if (part.divide && !albedo[part.view].empty()) {
      // Effective irradiance: the ratio of what pixels show of light and of reflectance. [Zimmer 2015, Sec. 3]
      const Planes& reflectance = albedo[part.view];
      divisor = Planes(width, height, 3);
      Planes divided(width, height, 3);  // light that is divided and light that is not have nothing in common
      for_values(divisor, [&](int c, int y, int x, float) {
        const float r = reflectance.row(c, y)[x];
        return r < kLeastDivisor ? 1.0f : r;
      });
      for_values(divided,
                 [&](int c, int y, int x, float) { return reflectance.row(c, y)[x] < kLeastDivisor ? 0.0f : 1.0f; });
      stack.add({std::move(divided), {}});
      const auto divide = [&](Planes& p, bool squared) {
        for (std::size_t i = 0; i < p.values().size(); ++i) {
          const float d = divisor.values()[i];
          p.values()[i] /= squared ? d * d : d;
        }
      };
      divide(light.a, false), divide(light.b, false), divide(light.variance, true);
    }
    if (!light.b.empty()) light.variance = channel_variance(light.a, light.b);
    out.light.push_back(std::move(light));
    out.divisors.push_back(std::move(divisor));
    out.features.push_back(std::move(stack));
  }
  damaged_ += in.damaged();
  return out;
}

Frame Decomposed::make(int frame) {
  sources_.erase(sources_.begin(), sources_.lower_bound(frame - 1));  // frames are made in ascending order
  Frame out = run_.start(frame);
  const int radius = available_.motion && settings_.radius > 0 ? 1 : 0;
  const FrameRange range = shot_around(frame, radius, run_.in()[0].reach, settings_.cuts);
  for (int f = range.first; f <= range.last; ++f) source(f);
  const Source& here = source(frame);
  const int width = out.width(), height = out.height();

  std::vector<std::pair<const Source*, Track>> around;
  for (int f = range.first; f <= range.last; ++f) {
    if (f == frame) continue;
    Track track = follow(frame, f, [&](int g) -> const Surfaces& { return source(g).surfaces; });
    if (track.empty()) continue;
    if (!here.surfaces.id.empty()) stay_on_object(track, here.surfaces.id, source(f).surfaces.id);
    around.emplace_back(&source(f), std::move(track));
  }

  Planes sum(width, height, 3);
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    const Light& own = here.light[part];
    const bool halves = !own.b.empty();
    const auto dark = [](const Planes& p) {
      return std::all_of(p.values().begin(), p.values().end(), [](float v) { return v == 0; });
    };
    if (dark(own.a) && dark(own.b)) continue;  // a class that nothing in the picture belongs to
    const auto add = [&](const Planes& picture, float weight) {
      const Planes& divisor = here.divisors[part];
      for (std::size_t i = 0; i < sum.values().size(); ++i)
        sum.values()[i] += weight * picture.values()[i] * (divisor.empty() ? 1.0f : divisor.values()[i]);
    };
    const auto all = [&](const auto& value) {  // mean over the values of all channels
      double total = 0;
      for (std::size_t i = 0; i < own.a.values().size(); ++i) total += double(value(i));
      return total / double(own.a.values().size());
    };
    const auto mean = [&](std::size_t i) {
      return halves ? 0.5f * (own.a.values()[i] + own.b.values()[i]) : own.a.values()[i];
    };
    const bool noise_free = all([&](std::size_t i) {
                              return own.variance.values()[i] / (mean(i) * mean(i) + kNoiseFree);
                            }) < double(kNoiseFree);
    if (parts_[part].emission && noise_free) {
      add(own.a, halves ? 0.5f : 1.0f);
      if (halves) add(own.b, 0.5f);
      continue;
    }

    // This frame, and those around brought to its pixels.
    struct Warped {
      Light light;
      FeatureStack features;
    };
    std::vector<Warped> warped;
    for (const auto& [there, its_track] : around) {
      const Track& track = its_track;  // which a lambda can capture
      const auto gather = [&](const Planes& p) { return p.empty() ? Planes() : gather_bilinear(p, track); };
      const Light& light = there->light[part];
      const FeatureStack& features = there->features[part];
      warped.push_back({{gather(light.a), gather(light.b), gather(light.variance)},
                        {gather(features.values), gather(features.variance), features.groups}});
    }
    // Each half is filtered with weights from the other, so that they stay independent of their own noise.
    const auto filtered = [&](bool by_b, bool of_b) {
      std::vector<JointFrame> frames;
      std::vector<Planes> variances;
      variances.reserve(1 + warped.size());
      const auto push = [&](const Light& light, const FeatureStack& features, const Planes* valid) {
        variances.push_back(light.variance);
        if (halves) {
          for (float& v : variances.back().values()) v *= 2;
        }
        JointFrame f{.guide = by_b ? &light.b : &light.a,
                     .variance = &variances.back(),
                     .values = of_b ? &light.b : &light.a,
                     .valid = valid};
        if (!features.groups.empty()) f.features = &features.values, f.feature_variance = &features.variance;
        frames.push_back(f);
      };
      push(own, here.features[part], nullptr);
      for (std::size_t i = 0; i < warped.size(); ++i)
        push(warped[i].light, warped[i].features, &around[i].second.valid);
      JointSettings settings{.window = kWindow, .feature_groups = here.features[part].groups};
      const double brightness = all(mean);
      settings.floor = float(1e-10 * brightness * brightness + 1e-30);
      return std::move(joint_filter(frames, std::span(&kBalanced, 1), settings)[0].values);
    };
    if (halves) {
      add(filtered(true, false), 0.5f), add(filtered(false, true), 0.5f);
    } else {
      add(filtered(false, false), 1);
    }
  }
  write_color(sum, out);
  return out;
}

std::vector<std::string> Decomposed::notes() const {
  std::string classes;
  for (const Part& p : parts_) {
    if (p.kind == Part::Kind::kClass) classes += (classes.empty() ? "" : ", ") + p.name;
  }
  const std::string how = classes.empty() ? "all light together" : "the classes " + classes + " and all other light";
  return notes_of(fmt::format("denoised by published: {}", how).c_str(), damaged_);
}

}  // namespace tempera::denoise
