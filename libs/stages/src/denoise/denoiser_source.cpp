// SPDX-License-Identifier: Apache-2.0
// What the denoiser makes of the layers of a frame, before it looks at others.
#include <algorithm>
#include <cmath>

#include "denoise/denoiser.h"
#include "denoise/input.h"

namespace tempera::denoise {

namespace {

constexpr float kEmitterShare =
    0.02f;                         ///< of the light of a pixel that it emits, from which on it counts as an emitter
constexpr int kFireflyRadius = 7;  ///< around which they are counted
constexpr float kFireflyShare = 0.015f;  ///< of the pixels there, from which on they begin to count as light

}  // namespace

Denoiser::Source Denoiser::read(int frame) {
  run_.check_stop();
  const auto start = cpu_seconds();
  const bool by_class = parts_.size() > 1;
  InputFrame in(run_, frame, [&](const LayerDesc& d) {
    if (d.path_class.empty()) return true;
    return by_class && std::any_of(parts_.begin(), parts_.end(), [&](const Part& part) {
             return std::find(part.classes.begin(), part.classes.end(), d.path_class) != part.classes.end();
           });
  });
  spent("read", start);
  const auto prepared = cpu_seconds();
  Source out;
  const auto planes = [&](const LayerDesc& layer, int channels) { return in.take(layer, channels); };
  Planes color = planes(layers::color(), 3);
  const auto take_photons = [&](Planes& from, const LayerDesc& layer) {
    if (!photons_ || from.empty()) return Planes();
    Planes photons = planes(layer, 3);
    for_values(from, [&](int c, int y, int x, float v) { return v - photons.row(c, y)[x]; });
    return photons;
  };
  out.photons = take_photons(color, layers::photon_color());
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
  Surfaces s;
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
  out.surfaces.push_back(std::move(s));
  for (std::size_t i = 1; i < paths_.size() && radius_ > 0; ++i)
    out.surfaces.push_back(in.moving(out.surfaces[0], paths_[i]));
  out.emitter = PackedPlanes(emitter);

  const auto halves_of = [](const Planes& all, const Planes& a, const Planes& b) {
    std::array<Planes, 2> halves = centred_halves(all, a, b);
    return Light{std::move(halves[0]), std::move(halves[1]), {}};
  };
  Light rest{color, {}, {}};
  if (available_.halves && samples_of(in.metadata()) != 1) {
    Planes a = planes(layers::color_a(), 3), b = planes(layers::color_b(), 3);
    take_photons(a, layers::photon_a()), take_photons(b, layers::photon_b());
    rest = halves_of(color, a, b);
  }
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
    if (firefly_ && light.halves()) {
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

std::array<Planes, 2> Denoiser::held_fireflies(const Light& light, const Planes& emitter, Held& shares) const {
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
        const float limit = *firefly_ * largest + floor;
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

}  // namespace tempera::denoise
