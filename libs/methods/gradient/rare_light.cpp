// SPDX-License-Identifier: Apache-2.0
#include "rare_light.h"

#include <algorithm>
#include <cmath>

#include "tempera/core/parallel.h"

namespace tempera {

namespace {

constexpr int kNear = 2;  ///< radius of what is around a pixel
/// A sample may be kFactor times as bright as the kCommonRank-th brightest of the pixels around (25, in one pass), or
/// the kRareRank-th of both estimates (50); or make the mean of its pixel kShare times the mean light around.
constexpr std::size_t kCommonRank = 3, kRareRank = 8;
constexpr float kFactor = 4, kShare = 2;
constexpr float kEnough = 8;  ///< of a pixel with fewer samples, the share is that of so many

// The work layers of a pass hold the members of RarePixel, in order.
constexpr int kParts = 5, kCommonChannels = 2 * 3 * kParts, kDifferenceChannels = 3 * 4, kLightChannels = 10;
enum LightChannel { kMean = 0, kFirst = 3, kSecond = 6, kCount = 9 };

std::string common_name(const std::string& prefix) { return prefix + "rare.brightest"; }
std::string differences_name(const std::string& prefix) { return prefix + "rare.differences"; }
std::string light_name(const std::string& prefix, int estimate) {
  return prefix + (estimate == 0 ? "rare.light" : "rare.light.odd");
}

float size_of(const Rgb& c) { return luminance(Rgb(std::abs(c.r), std::abs(c.g), std::abs(c.b))); }
float size_of(const SampleParts& parts) {
  float size = 0;
  for (const Rgb& c : parts) size = std::max(size, size_of(c));
  return size;
}

/// Keeps `value` if it is among the two brightest.
template <class T>
void keep(const T& value, float size, T& first, float& first_size, T& second, float& second_size) {
  if (!(size > second_size)) return;
  if (size > first_size) {
    second = first, second_size = first_size;
    first = value, first_size = size;
  } else {
    second = value, second_size = size;
  }
}

Rgb rgb_at(const float* p) { return {p[0], p[1], p[2]}; }
void put(const Rgb& c, float* p) { p[0] = c.r, p[1] = c.g, p[2] = c.b; }

/// The K largest of the numbers that it is shown, 0 for those that are missing.
template <std::size_t K>
class Largest {
 public:
  void add(float v) {
    if (!(v > values_[K - 1])) return;
    std::size_t i = K - 1;
    for (; i > 0 && v > values_[i - 1]; --i) values_[i] = values_[i - 1];
    values_[i] = v;
  }
  float last() const { return values_[K - 1]; }

 private:
  std::array<float, K> values_{};
};

/// The part of a sample that is too much.
float excess(float size, float limit) { return size > limit ? 1 - limit / size : 0.0f; }

/// One value for each pixel.
struct Plane {
  Plane(int w, int h) : width(w), height(h), values(std::size_t(w) * std::size_t(h)) {}
  float& at(int x, int y) { return values[std::size_t(y) * std::size_t(width) + std::size_t(x)]; }
  float at(int x, int y) const { return values[std::size_t(y) * std::size_t(width) + std::size_t(x)]; }
  /// Calls f(x, y) for the pixels around (x, y), itself included.
  template <class F>
  void around(int x, int y, F&& f) const {
    for (int v = std::max(0, y - kNear); v <= std::min(height - 1, y + kNear); ++v) {
      for (int u = std::max(0, x - kNear); u <= std::min(width - 1, x + kNear); ++u) f(u, v);
    }
  }
  int width, height;
  std::vector<float> values;
};

/// Calls f(x, y) for all pixels, rows in parallel.
template <class F>
void for_pixels(int width, int height, F&& f) {
  parallel_for(
      0, height,
      [&](std::int64_t y) {
        for (int x = 0; x < width; ++x) f(x, int(y));
      },
      8);
}

/// A pass, its layers and the sizes of its brightest samples.
struct Pass {
  Pass(const std::string& prefix, Frame& out)
      : color(out.layer(prefix + "color")),
        common(out.layer(common_name(prefix))),
        differences(out.layer(differences_name(prefix))),
        brightest(out.width(), out.height()) {
    for_pixels(out.width(), out.height(), [&](int x, int y) { brightest.at(x, y) = common_size(x, y, 0); });
  }
  SampleParts common_sample(int x, int y, int k) const {
    SampleParts parts;
    const float* p = common.pixel(x, y) + 3 * kParts * k;
    for (std::size_t j = 0; j < kParts; ++j) parts[j] = rgb_at(p + 3 * j);
    return parts;
  }
  float common_size(int x, int y, int k) const { return size_of(common_sample(x, y, k)); }

  const Image &color, &common;
  Image& differences;
  Plane brightest;
};

/// An estimate of the rare light of a frame.
struct Estimate {
  Estimate(const Image& light_, int w, int h) : light(light_), brightest(w, h) {
    for_pixels(w, h, [&](int x, int y) { brightest.at(x, y) = size_of(rgb_at(light.pixel(x, y) + kFirst)); });
  }
  const Image& light;
  Plane brightest;
};

LayerDesc work_layer(std::string name, int channels) {
  LayerDesc d{std::move(name), {}, units::kRadiance, Combine::kMean};
  for (int c = 0; c < channels; ++c) d.channels.push_back(std::to_string(c));
  return d;
}

}  // namespace

void BrightSamples::add(const SampleParts& sample) {
  keep(sample, size_of(sample), first, first_size, second, second_size);
}

void RareLight::add(const Rgb& radiance) {
  sum += radiance;
  keep(radiance, size_of(radiance), first, first_size, second, second_size);
}

std::vector<LayerDesc> rare_work_layers(const std::string& prefix, int estimates) {
  std::vector<LayerDesc> result{work_layer(common_name(prefix), kCommonChannels),
                                work_layer(differences_name(prefix), kDifferenceChannels)};
  for (int k = 0; k < estimates; ++k) result.push_back(work_layer(light_name(prefix, k), kLightChannels));
  return result;
}

std::vector<LayerDesc> rare_layers(const std::string& prefix, int estimates) {
  std::vector<LayerDesc> result{layers::rare_color(), layers::rare_grad_x(), layers::rare_grad_y(),
                                layers::held_color()};
  if (estimates == 2) result.push_back(layers::rare_a()), result.push_back(layers::rare_b());
  for (LayerDesc& d : result) d.name = prefix + d.name;
  return result;
}

void store_rare(const RarePixel& pixel, int count, const std::string& prefix, int x, int y, Frame& out) {
  float* p = out.layer(common_name(prefix)).pixel(x, y);
  for (const SampleParts* sample : {&pixel.common.first, &pixel.common.second}) {
    for (const Rgb& c : *sample) put(c, p), p += 3;
  }
  p = out.layer(differences_name(prefix)).pixel(x, y);
  for (const Rgb& c : pixel.differences) put(c * (1 / float(std::max(count, 1))), p), p += 3;
  for (int k = 0; k < 2; ++k) {
    if (!out.has(light_name(prefix, k))) continue;
    const RareLight& light = pixel.estimates[k];
    p = out.layer(light_name(prefix, k)).pixel(x, y);
    put(light.sum * (1 / float(std::max(light.count, 1))), p + kMean);
    put(light.first, p + kFirst), put(light.second, p + kSecond);
    p[kCount] = float(light.count);
  }
}

void keep_rare_apart(std::span<const std::string> prefixes, Frame& out) {
  const int w = out.width(), h = out.height();
  std::vector<Pass> passes;
  std::vector<Estimate> estimates;
  passes.reserve(prefixes.size());
  for (const std::string& prefix : prefixes) {
    passes.emplace_back(prefix, out);
    for (int k = 0; k < 2 && out.has(light_name(prefix, k)); ++k)
      estimates.emplace_back(out.layer(light_name(prefix, k)), w, h);
  }
  TEMPERA_ASSERT(estimates.size() == 2);
  const std::size_t in_pass = 2 / passes.size();  // estimates of each pass
  const auto samples = [&](std::size_t estimate, int x, int y) { return estimates[estimate].light.at(x, y, kCount); };
  const auto pass_samples = [&](std::size_t p, int x, int y) {
    float n = 0;
    for (std::size_t k = p * in_pass; k < (p + 1) * in_pass; ++k) n += samples(k, x, y);
    return std::max(n, 1.0f);
  };
  /// Rare light of a pass: the mean over its estimates.
  const auto rare_light = [&](std::size_t p, int x, int y) {
    Rgb sum;
    for (std::size_t k = p * in_pass; k < (p + 1) * in_pass; ++k)
      sum += rgb_at(estimates[k].light.pixel(x, y) + kMean) * samples(k, x, y);
    return sum * (1 / pass_samples(p, x, y));
  };

  Plane common(w, h), mean_around(w, h);  // luminance of paths that are not rare
  for_pixels(w, h, [&](int x, int y) {
    float sum = 0;
    for (std::size_t p = 0; p < passes.size(); ++p) sum += luminance(passes[p].color.rgb(x, y) - rare_light(p, x, y));
    common.at(x, y) = std::max(0.0f, sum / float(passes.size()));
  });
  for_pixels(w, h, [&](int x, int y) {
    float sum = 0;
    int count = 0;
    common.around(x, y, [&](int u, int v) { sum += common.at(u, v), ++count; });
    mean_around.at(x, y) = sum / float(count);
  });
  /// The size that makes the mean of n samples kShare times the mean light around.
  const auto share = [&](float n, int x, int y) { return kShare * std::max(n, kEnough) * mean_around.at(x, y); };

  for (std::size_t p = 0; p < passes.size(); ++p) {
    Pass& pass = passes[p];
    const std::string& prefix = prefixes[p];
    Image &rare = out.layer(prefix + "rare.color"), &held = out.layer(prefix + "held.color");
    std::array<Image*, 2> halves{};
    if (in_pass == 2) halves = {&out.layer(prefix + "rare.a"), &out.layer(prefix + "rare.b")};
    for_pixels(w, h, [&](int x, int y) {
      const float n = pass_samples(p, x, y);
      Rgb all = rare_light(p, x, y), too_much;
      // Its own brightest sample has no say in a pixel's limits.
      if (float limit = share(n, x, y); pass.brightest.at(x, y) > limit) {
        Largest<kCommonRank> largest;
        largest.add(pass.common_size(x, y, 1));
        pass.brightest.around(x, y, [&](int u, int v) {
          if (u != x || v != y) largest.add(pass.brightest.at(u, v));
        });
        limit = std::max(limit, kFactor * largest.last());
        float* differences = pass.differences.pixel(x, y);
        for (int k = 0; k < 2; ++k) {
          const SampleParts sample = pass.common_sample(x, y, k);
          const float part = excess(size_of(sample), limit) / n;
          too_much += sample[0] * part;
          for (std::size_t j = 0; j < 4; ++j) {
            float* d = differences + 3 * j;
            put(rgb_at(d) + sample[j + 1] * part, d);
          }
        }
        all += too_much;
      }
      for (std::size_t k = p * in_pass; k < (p + 1) * in_pass; ++k) {
        const Estimate &own = estimates[k], &other = estimates[1 - k];
        const float m = std::max(samples(k, x, y), 1.0f);
        Rgb above;
        if (float limit = share(m, x, y); own.brightest.at(x, y) > limit) {
          const float* light = own.light.pixel(x, y);
          Largest<kRareRank> largest;
          largest.add(size_of(rgb_at(light + kSecond)));
          own.brightest.around(x, y, [&](int u, int v) {
            if (u != x || v != y) largest.add(own.brightest.at(u, v));
            largest.add(other.brightest.at(u, v));
          });
          limit = std::max(limit, kFactor * largest.last());
          for (const LightChannel c : {kFirst, kSecond})
            above += rgb_at(light + c) * (excess(size_of(rgb_at(light + c)), limit) / m);
        }
        too_much += above * (m / n);
        if (halves[k]) halves[k]->set_rgb(x, y, rgb_at(own.light.pixel(x, y) + kMean) - above);
      }
      rare.set_rgb(x, y, all);
      held.set_rgb(x, y, too_much);
    });
    // From what both sides say of a difference, as join_gradients does.
    enum Side { kRight, kDown, kLeft, kUp };
    const auto join = [&](const char* name, Side forward, Side back, int dx, int dy) {
      Image& to = out.layer(prefix + name);
      for_pixels(w - dx, h - dy, [&](int x, int y) {
        to.set_rgb(x, y,
                   rgb_at(pass.differences.pixel(x, y) + 3 * forward) -
                       rgb_at(pass.differences.pixel(x + dx, y + dy) + 3 * back));
      });
    };
    join("rare.grad.x", kRight, kLeft, 1, 0);
    join("rare.grad.y", kDown, kUp, 0, 1);
  }
}

}  // namespace tempera
