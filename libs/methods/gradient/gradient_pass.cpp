// SPDX-License-Identifier: Apache-2.0
#include "gradient_pass.h"

#include <fmt/format.h>

#include <algorithm>

#include "shift_observer.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {

namespace {

enum Side { kRight, kDown, kLeft, kUp };
constexpr std::array<const char*, 4> kSides{"grad.right", "grad.down", "grad.left", "grad.up"};

/// Which differences of a pixel there are. They need samples on both sides: none across the border of what is rendered.
std::array<bool, 4> inside(const RenderSettings& s, int x, int y) {
  return {x + 1 < s.x1(), y + 1 < s.y1(), x > s.x0(), y > s.y0()};
}

std::string variance_of(const std::string& name) { return name + ".var"; }

/// Whether a pass needs variances of differences: to place samples, or for the layers that are asked for.
bool needs_variance(const GradientOptions& options, const RenderSettings& settings, const std::string& prefix) {
  const auto wanted = [&](const LayerDesc& d) {
    return std::find(settings.layers.begin(), settings.layers.end(), prefix + d.name) != settings.layers.end();
  };
  return (prefix.empty() && options.adaptive.mode != AdaptiveOptions::Mode::kOff) ||
         wanted(layers::grad_x_variance()) || wanted(layers::grad_y_variance());
}

LayerDesc side_layer(Side side) {
  LayerDesc d = layers::grad_x();
  d.name = kSides[side];
  return d;
}
LayerDesc side_variance_layer(Side side) {
  LayerDesc d = layers::grad_x_variance();
  d.name = variance_of(kSides[side]);
  return d;
}

LayerDesc with_prefix(const std::string& prefix, LayerDesc d) {
  d.name = prefix + d.name;
  return d;
}

}  // namespace

const std::vector<ParamSpec>& GradientOptions::params() {
  static const std::vector<ParamSpec> specs = [] {
    std::vector<ParamSpec> s = PathOptions::params();
    s.push_back({"roughness_threshold", 0.001,
                 "paths of neighbouring pixels are connected at surfaces that are rougher (alpha)", 0, 1});
    s.push_back({"rare", true,
                 "write beside the picture the light of rare bright paths, which robust reconstruction keeps apart"});
    s.push_back(
        {"class_gradients", false,
         "write the differences of each light-path class (--class, --decompose), too: `tempera reconstruct` then "
         "solves for each of them"});
    for (const std::vector<ParamSpec>& more : {AdaptiveOptions::params(), caustics_params(false)})
      s.insert(s.end(), more.begin(), more.end());
    return s;
  }();
  return specs;
}

GradientOptions::GradientOptions(const Params& p)
    : path(p),
      adaptive(p),
      roughness_threshold(float(p.get_double("roughness_threshold"))),
      rare(p.get_bool("rare")),
      class_gradients(p.get_bool("class_gradients")),
      photons(caustics_by_photons(p)) {}

void check_gradient_settings(const RenderSettings& settings, std::string_view integrator) {
  if (settings.clock.shutter.rolling != 0) {
    throw SettingError(
        ErrorCode::kUnsupported, "shutter.rolling",
        fmt::format("the integrator \"{}\" compares pixels at one time: no rolling shutter", integrator));
  }
}

std::vector<LayerDesc> gradient_outputs(const GradientOptions& options, const RenderSettings& settings,
                                        const std::string& prefix, bool with_color) {
  std::vector<LayerDesc> of_light{layers::grad_x(), layers::grad_y()};
  if (options.photons) of_light.push_back(layers::photon_color());
  if (with_color) of_light.insert(of_light.begin(), layers::color());
  std::vector<LayerDesc> result = of_light;
  if (options.class_gradients) {
    for (const std::string& name : class_names(settings)) {
      for (const LayerDesc& d : of_light) result.push_back(layers::class_layer(name, d));
    }
  }
  if (!prefix.empty()) {
    for (LayerDesc& d : result) d = layers::offset(d);
  }
  return result;
}

std::vector<LayerDesc> gradient_work_layers(const GradientOptions& options, const RenderSettings& settings,
                                            const std::string& prefix) {
  std::vector<LayerDesc> result;
  for (const Side side : {kRight, kDown, kLeft, kUp}) {
    if (needs_variance(options, settings, prefix)) result.push_back(with_prefix(prefix, side_variance_layer(side)));
    result.push_back(with_prefix(prefix, side_layer(side)));
  }
  if (options.class_gradients) {
    for (const std::string& name : class_names(settings)) {
      for (const Side side : {kRight, kDown, kLeft, kUp})
        result.push_back(with_prefix(prefix, layers::class_layer(name, side_layer(side))));
    }
  }
  return result;
}

std::vector<std::string> gradient_layer_names(const GradientOptions& options, const std::string& prefix,
                                              int estimates) {
  std::vector<std::string> names;
  for (const char* name : {"grad.x", "grad.y", "grad.x.var", "grad.y.var"}) names.push_back(prefix + name);
  if (options.photons) names.push_back(prefix + "photon.color");
  for (const LayerDesc& d : rare_layers(prefix, estimates)) names.push_back(d.name);
  return names;
}

std::size_t GradientTile::bytes_of_pixel(const GradientOptions& options, const RenderSettings& settings) {
  const std::size_t classes = settings.classes.empty() ? 0 : settings.classes.size() + 1;
  return TileFilm::bytes_of_pixel(settings) + sizeof(Pixel) + sizeof(RarePixel) +
         (options.class_gradients ? classes * 5 * sizeof(Rgb) : 0);
}

GradientTile::GradientTile(const FrameContext& context, const Tile& tile, const Frame& out, const std::string& prefix,
                           const GatheredLight* gathered)
    : settings_(context.settings),
      tile_(tile),
      prefix_(prefix),
      gathered_(gathered),
      film_(context, tile, out, prefix),
      pixels_(std::size_t(tile.x1 - tile.x0) * std::size_t(tile.y1 - tile.y0)),
      two_estimates_(out.has(prefix + "rare.a")) {
  if (out.has(prefix + "rare.color")) rare_.resize(pixels_.size());
  const std::vector<std::string> names = class_names(settings_);
  const bool by_class = std::any_of(names.begin(), names.end(), [&](const std::string& name) {
    return out.has(prefix + layers::class_layer(name, side_layer(kRight)).name);
  });
  if (by_class) class_count_ = settings_.classes.size() + 1;
  class_sums_.resize(pixels_.size() * 4 * class_count_);
  if (gathered) class_apart_.resize(pixels_.size() * class_count_);
}

void GradientTile::sample(const FrameContext& context, const GradientOptions& options, int x, int y,
                          const PixelKey& key, int first, int count, RenderCounters& counters) {
  if (class_count_ > 0 || gathered_) {
    sample_pixel<true>(context, options, x, y, key, first, count, counters);
  } else {
    sample_pixel<false>(context, options, x, y, key, first, count, counters);
  }
}

template <bool kByClass>
void GradientTile::sample_pixel(const FrameContext& context, const GradientOptions& options, int x, int y,
                                const PixelKey& key, int first, int count, RenderCounters& counters) {
  Pixel& p = pixels_[std::size_t(y - tile_.y0) * std::size_t(tile_.x1 - tile_.x0) + std::size_t(x - tile_.x0)];
  const std::array<bool, 4> neighbours = inside(settings_, x, y);
  std::uint64_t rays = 0, shadow_rays = 0;
  std::vector<Rgb> classes(4 * class_count_), apart(class_apart_.empty() ? 0 : class_count_);
  for (int i = first; i < first + count; ++i) {
    const CameraSample camera = camera_sample(context, key, x, y, i);
    const FrameContext& now = context.at(camera.time);
    std::fill(classes.begin(), classes.end(), Rgb(0.0f));
    std::fill(apart.begin(), apart.end(), Rgb(0.0f));
    ShiftObserver<kByClass> shifts(now, options.path, options.roughness_threshold, camera, neighbours, classes,
                                   gathered_, apart);
    const SampleResult r = trace_path(now, options.path, camera, film_.sample_classes(), film_.features(), shifts,
                                film_.chains(), gathered_);
    rays += r.rays + shifts.rays();
    shadow_rays += r.shadow_rays;
    bool finite = true;
    for (std::size_t j = 0; j < 4; ++j) finite &= is_finite(shifts.g(j));
    if (!finite || !film_.add(x, y, i, camera, r)) {
      counters.note_bad({context.frame, x, y, i, key});
      continue;
    }
    ++p.count;
    const bool even = i % 2 == 0;
    p.even_count += even;
    for (std::size_t j = 0; j < 4; ++j) {
      const Rgb g = shifts.g(j) * camera.weight;
      p.sums[j] += g;
      if (even) p.even_sums[j] += g;
      p.squares[j] += g * g;
    }
    for (std::size_t k = 0; k < classes.size(); ++k)
      class_sums_[(&p - pixels_.data()) * classes.size() + k] += classes[k] * camera.weight;
    for (std::size_t k = 0; k < apart.size(); ++k)
      class_apart_[(&p - pixels_.data()) * apart.size() + k] += apart[k] * camera.weight;
    if (!rare_.empty()) add_rare(rare_[&p - pixels_.data()], r, shifts, camera.weight, even);
  }
  counters.samples += std::uint64_t(count);
  counters.rays += rays;
  counters.shadow_rays += shadow_rays;
}

template <bool kByClass>
void GradientTile::add_rare(RarePixel& pixel, const SampleResult& sample, const ShiftObserver<kByClass>& shifts,
                            float weight, bool even) const {
  SampleParts common{(sample.radiance - sample.gathered) * weight};
  for (std::size_t j = 0; j < 4; ++j) common[j + 1] = shifts.g(j) * weight;
  RareLight& light = pixel.estimates[two_estimates_ && !even ? 1 : 0];
  ++light.count;
  if (shifts.rare()) {
    const SampleParts all = common;
    common[0] = shifts.common_radiance() * weight;
    for (std::size_t j = 0; j < 4; ++j) {
      common[j + 1] = shifts.common_g(j) * weight;
      pixel.differences[j] += all[j + 1] - common[j + 1];
    }
    light.add(all[0] - common[0]);
  }
  pixel.common.add(common);
}

void GradientTile::write(Frame& out, bool of_samples) const {
  film_.write(out);
  for (std::size_t j = 0; j < 4; ++j) {
    const std::string name = prefix_ + kSides[j];
    Image& means = out.layer(name);
    Image* variances = out.has(variance_of(name)) ? &out.layer(variance_of(name)) : nullptr;
    const Pixel* p = pixels_.data();
    for (int y = tile_.y0; y < tile_.y1; ++y) {
      for (int x = tile_.x0; x < tile_.x1; ++x, ++p) {
        const int ox = x - settings_.x0(), oy = y - settings_.y0();
        const float n = float(std::max(p->count, 1));
        means.set_rgb(ox, oy, p->sums[j] * (1 / n));
        if (!variances) continue;
        Rgb v;
        if (!of_samples) {
          v = variance_of_mean(p->even_sums[j], p->even_count, p->sums[j] - p->even_sums[j], p->count - p->even_count);
        } else if (p->count > 1) {
          for (int c = 0; c < 3; ++c)
            v[c] = std::max(0.0f, (p->squares[j][c] - p->sums[j][c] * p->sums[j][c] / n) / (n * (n - 1)));
        }
        variances->set_rgb(ox, oy, v);
      }
    }
  }
  if (class_count_ > 0) {
    const std::vector<std::string> names = class_names(settings_);
    for (std::size_t k = 0; k < names.size(); ++k) {
      if (!class_apart_.empty()) {
        Image& apart = out.layer(prefix_ + layers::class_layer(names[k], layers::photon_color()).name);
        for (std::size_t i = 0; i < pixels_.size(); ++i) {
          const int w = tile_.x1 - tile_.x0, x = int(i) % w, y = int(i) / w;
          apart.set_rgb(tile_.x0 + x - settings_.x0(), tile_.y0 + y - settings_.y0(),
                        class_apart_[i * class_count_ + k] * (1 / float(std::max(pixels_[i].count, 1))));
        }
      }
      for (const Side side : {kRight, kDown, kLeft, kUp}) {
        Image& means = out.layer(prefix_ + layers::class_layer(names[k], side_layer(side)).name);
        const Rgb* sum = class_sums_.data() + side * class_count_ + k;
        const Pixel* p = pixels_.data();
        for (int y = tile_.y0; y < tile_.y1; ++y) {
          for (int x = tile_.x0; x < tile_.x1; ++x, ++p, sum += 4 * class_count_)
            means.set_rgb(x - settings_.x0(), y - settings_.y0(), *sum * (1 / float(std::max(p->count, 1))));
        }
      }
    }
  }
  std::size_t i = 0;
  for (int y = tile_.y0; y < tile_.y1 && !rare_.empty(); ++y) {
    for (int x = tile_.x0; x < tile_.x1; ++x, ++i)
      store_rare(rare_[i], pixels_[i].count, prefix_, x - settings_.x0(), y - settings_.y0(), out);
  }
}

void join_gradients(const std::string& pass, Frame& out) {
  std::vector<std::string> prefixes{pass};
  for (const Layer& l : out.layers()) {
    const std::string& name = l.desc.path_class;
    if (!name.empty() && l.desc.name == pass + layers::class_layer(name, side_layer(kRight)).name)
      prefixes.push_back(fmt::format("{}class.{}.", pass, name));
  }
  const auto join = [&](const std::string& prefix, const char* difference, Side forward, Side back, int dx, int dy) {
    const std::string name = prefix + difference;
    const std::string f = prefix + kSides[forward], b = prefix + kSides[back];
    const Image &from = out.layer(f), &to = out.layer(b);
    Image* mean = out.has(name) ? &out.layer(name) : nullptr;
    Image* variance = out.has(variance_of(name)) ? &out.layer(variance_of(name)) : nullptr;
    const Image *from_variance = variance ? &out.layer(variance_of(f)) : nullptr,
                *to_variance = variance ? &out.layer(variance_of(b)) : nullptr;
    parallel_for(
        0, out.height() - dy,
        [&](std::int64_t row) {
          const int y = int(row);
          for (int x = 0; x + dx < out.width(); ++x) {
            if (mean) mean->set_rgb(x, y, from.rgb(x, y) - to.rgb(x + dx, y + dy));
            if (variance) variance->set_rgb(x, y, from_variance->rgb(x, y) + to_variance->rgb(x + dx, y + dy));
          }
        },
        16);
  };
  for (const std::string& prefix : prefixes) {
    join(prefix, "grad.x", kRight, kLeft, 1, 0);
    join(prefix, "grad.y", kDown, kUp, 0, 1);
  }
}

Rgb replay_gradients(const FrameContext& context, const GradientOptions& options, const BadSample& sample) {
  const CameraSample camera = camera_sample(context, sample.numbers, sample.x, sample.y, sample.sample);
  const FrameContext& now = context.at(camera.time);
  ShiftObserver<false> shifts(now, options.path, options.roughness_threshold, camera,
                              inside(context.settings, sample.x, sample.y));
  const Rgb radiance = trace_path(now, options.path, camera, {}, Features::kNone, shifts).radiance * camera.weight;
  for (std::size_t j = 0; j < 4 && is_finite(radiance); ++j) {
    if (!is_finite(shifts.g(j))) return shifts.g(j);
  }
  return radiance;
}

void GradientTile::save(ByteWriter& out) const {
  film_.save(out);
  out.values(pixels_);
  out.values(rare_);
  out.values(class_sums_);
  out.values(class_apart_);
}

void GradientTile::load(ByteReader& in) {
  film_.load(in);
  in.values(pixels_);
  in.values(rare_);
  in.values(class_sums_);
  in.values(class_apart_);
}

GradientBatches::GradientBatches(const RenderSettings& settings, const GradientOptions& options, int spp)
    : plan_(plan_batches(options.adaptive, spp)) {
  const auto pixels = std::size_t(settings.x1() - settings.x0()) * std::size_t(settings.y1() - settings.y0());
  taken_.assign(pixels, 0);
  wanted_.assign(pixels, plan_.first);
}

std::vector<PassDesc> GradientBatches::passes(const GradientOptions& options, const RenderSettings& settings, int spp) {
  const int count = plan_batches(options.adaptive, spp).count;
  std::vector<PassDesc> result;
  for (int i = 0; i < count; ++i) {
    PassDesc pass{.name = count == 1 ? "samples" : fmt::format("batch {} of {}", i + 1, count), .waits = i > 0};
    if (i + 1 < count) pass.memory = GradientTile::bytes_of_pixel(options, settings);
    result.push_back(std::move(pass));
  }
  return result;
}

bool GradientBatches::render(const FrameContext& context, const GradientOptions& options, const GatheredLight* gathered,
                             int batch, const Tile& tile, UnitOutput& out, RenderCounters& counters,
                             const std::stop_token& stop) const {
  const RenderSettings& s = context.settings;
  const bool last = batch + 1 == plan_.count;
  GradientTile film(context, tile, out.picture(), "", gathered);
  if (batch > (plan_.keep_first ? 0 : 1)) {
    ByteReader in(out.kept());
    film.load(in);
  }
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      if (stop.stop_requested()) return false;
      const std::size_t i = std::size_t(y - s.y0()) * std::size_t(s.x1() - s.x0()) + std::size_t(x - s.x0());
      PixelKey key = own_key(context, x, y);
      if (batch == 0 && !plan_.keep_first) key.stream = stream_number(StreamPurpose::kPilot, key.stream);
      film.sample(context, options, x, y, key, taken_[i], wanted_[i], counters);
    }
  }
  film.write(out.picture(), !last);
  if (!last) {
    Bytes bytes;
    ByteWriter writer(bytes);
    film.save(writer);
    out.keep(std::move(bytes));
  }
  return true;
}

void GradientBatches::end(const RenderSettings& settings, const GradientOptions& options, int batch, int frame,
                          const Frame& out) {
  const int w = out.width(), h = out.height();
  for (std::size_t i = 0; i < taken_.size(); ++i) taken_[i] += wanted_[i];
  const auto sum = [](const Rgb& c) { return c.r + c.g + c.b; };
  std::array<const Image*, 4> variances{};
  for (std::size_t j = 0; j < 4; ++j) variances[j] = &out.layer(variance_of(kSides[j]));
  const Image& color = out.layer("color");
  const auto variance = [&](Side side, int x, int y) { return sum(variances[side]->rgb(x, y)); };
  std::vector<PixelNoise> noise(taken_.size());
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = std::size_t(y) * std::size_t(w) + std::size_t(x);
      PixelNoise& p = noise[i];
      // The last column and row have their differences on the other side.
      const int from_x = std::min(x, w - 2), from_y = std::min(y, h - 2);
      if (w > 1) p.variance += variance(kRight, from_x, y) + variance(kLeft, from_x + 1, y);
      if (h > 1) p.variance += variance(kDown, x, from_y) + variance(kUp, x, from_y + 1);
      p.radiance = sum(color.rgb(x, y));
      p.samples = plan_.keep_first ? taken_[i] : 0;
    }
  }
  wanted_ = next_batch(options.adaptive, noise, w, h, plan_.later,
                       hash_key(settings.seed, std::uint64_t(frame), std::uint64_t(batch) + 1));
  if (!plan_.keep_first && batch == 0) std::fill(taken_.begin(), taken_.end(), 0);
}

void GradientState::save(ByteWriter& out) const {
  batches.save(out);
  photons.save(out);
}

void GradientState::load(ByteReader& in) {
  batches.load(in);
  photons.load(in);
}

void GradientBatches::save(ByteWriter& out) const {
  out.values(taken_);
  out.values(wanted_);
}

void GradientBatches::load(ByteReader& in) {
  in.values(taken_);
  in.values(wanted_);
}

}  // namespace tempera
