// SPDX-License-Identifier: Apache-2.0
#include "gradient_pass.h"

#include <fmt/format.h>

#include "shift_observer.h"
#include "tile_film.h"

namespace tempera {

namespace {

enum Side { kRight, kDown, kLeft, kUp };
constexpr std::array<const char*, 4> kSides{"grad.right", "grad.down", "grad.left", "grad.up"};

std::string variance_of(const std::string& name) { return name + ".var"; }

}  // namespace

const std::vector<ParamSpec>& GradientOptions::params() {
  static const std::vector<ParamSpec> specs = [] {
    std::vector<ParamSpec> s = PathOptions::params();
    s.push_back({"roughness_threshold", 0.001,
                 "paths of neighbouring pixels are connected at surfaces that are rougher (alpha)", 0, 1});
    return s;
  }();
  return specs;
}

GradientOptions::GradientOptions(const Params& p)
    : path(p), roughness_threshold(float(p.get_double("roughness_threshold"))) {}

void check_gradient_settings(const RenderSettings& settings, std::string_view integrator) {
  if (settings.clock.shutter.rolling != 0) {
    throw Error(ErrorCode::kUnsupported,
                fmt::format("the integrator \"{}\" compares pixels at one time: no rolling shutter", integrator));
  }
}

std::vector<LayerDesc> gradient_work_layers(const std::string& prefix) {
  std::vector<LayerDesc> result;
  for (const char* side : kSides) {
    LayerDesc mean = layers::grad_x(), variance = layers::grad_x_variance();
    mean.name = prefix + side;
    variance.name = variance_of(mean.name);
    result.push_back(std::move(mean));
    result.push_back(std::move(variance));
  }
  return result;
}

bool gradient_pass(const FrameContext& context, const GradientOptions& options, const Tile& tile, int spp,
                   const std::function<PixelKey(int, int)>& key, const std::string& prefix, Frame& out,
                   RenderCounters& counters, const std::stop_token& stop) {
  const RenderSettings& settings = context.settings;
  TileFilm film(context, tile, out, prefix);
  std::uint64_t samples = 0, rays = 0, shadow_rays = 0;
  std::array<Image*, 4> means{}, variances{};
  for (std::size_t j = 0; j < 4; ++j) {
    means[j] = &out.layer(prefix + kSides[j]);
    variances[j] = &out.layer(variance_of(prefix + kSides[j]));
  }
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      if (stop.stop_requested()) return false;
      // A difference needs samples on both sides: none across the border of what is rendered.
      const std::array<bool, 4> inside{x + 1 < settings.x1(), y + 1 < settings.y1(), x > settings.x0(),
                                       y > settings.y0()};
      const PixelKey numbers = key(x, y);
      std::array<Rgb, 4> sums, squares;
      int count = 0;
      for (int i = 0; i < spp; ++i) {
        const CameraSample camera = camera_sample(context, numbers, x, y, i);
        const Vec3f axis = film.features() ? context.camera.axis(camera.time) : Vec3f{};
        ShiftObserver shifts(context, options.path, options.roughness_threshold, camera, inside);
        const SampleResult r =
            trace_path(context, options.path, camera, axis, film.sample_classes(), film.features(), shifts);
        ++samples;
        rays += r.rays + shifts.rays();
        shadow_rays += r.shadow_rays;
        bool finite = true;
        for (std::size_t j = 0; j < 4; ++j) finite &= is_finite(shifts.g(j));
        if (!finite || !film.add(x, y, i, camera, r)) {
          counters.note_bad({context.frame, x, y, i});
          continue;
        }
        ++count;
        for (std::size_t j = 0; j < 4; ++j) {
          const Rgb g = shifts.g(j) * camera.weight;
          sums[j] += g;
          squares[j] += g * g;
        }
      }
      const int ox = x - settings.x0(), oy = y - settings.y0();
      const float n = float(std::max(count, 1));
      for (std::size_t j = 0; j < 4; ++j) {
        means[j]->set_rgb(ox, oy, sums[j] * (1 / n));
        Rgb v;
        for (int c = 0; count > 1 && c < 3; ++c) {
          v[c] = std::max(0.0f, (squares[j][c] - sums[j][c] * sums[j][c] / n) / (n * (n - 1)));
        }
        variances[j]->set_rgb(ox, oy, v);
      }
    }
  }
  film.write(out);
  counters.samples += samples;
  counters.rays += rays;
  counters.shadow_rays += shadow_rays;
  return true;
}

void join_gradients(const std::string& prefix, Frame& out) {
  const auto join = [&](const std::string& name, Side forward, Side back, int dx, int dy) {
    const std::string f = prefix + kSides[forward], b = prefix + kSides[back];
    const Image &from = out.layer(f), &to = out.layer(b);
    const Image &from_variance = out.layer(variance_of(f)), &to_variance = out.layer(variance_of(b));
    Image* mean = out.has(name) ? &out.layer(name) : nullptr;
    Image* variance = out.has(variance_of(name)) ? &out.layer(variance_of(name)) : nullptr;
    for (int y = 0; y + dy < out.height(); ++y) {
      for (int x = 0; x + dx < out.width(); ++x) {
        if (mean) mean->set_rgb(x, y, from.rgb(x, y) - to.rgb(x + dx, y + dy));
        if (variance) variance->set_rgb(x, y, from_variance.rgb(x, y) + to_variance.rgb(x + dx, y + dy));
      }
    }
  };
  join(prefix + "grad.x", kRight, kLeft, 1, 0);
  join(prefix + "grad.y", kDown, kUp, 0, 1);
}

}  // namespace tempera
