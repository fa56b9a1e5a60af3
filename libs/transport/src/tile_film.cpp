// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/tile_film.h"

#include <fmt/format.h>

#include "tempera/transport/cryptomatte_names.h"

namespace tempera {

const std::vector<std::string>& film_layers() {
  static const std::vector<std::string> names{"color",    "color.a",        "color.b",         "color.var", "albedo",
                                              "normal",   "depth",          "position",        "object_id", "uv",
                                              "emission", "motion.forward", "motion.backward", "samples",   "time"};
  return names;
}

std::vector<LayerDesc> film_outputs(const RenderSettings& settings, std::string_view integrator,
                                    std::span<const std::string> more) {
  std::vector<LayerDesc> result{layers::color()};
  const auto add = [&](const LayerDesc& desc) {
    if (std::find(result.begin(), result.end(), desc) == result.end()) result.push_back(desc);
  };
  std::vector<std::string> known = film_layers();
  known.insert(known.end(), more.begin(), more.end());
  for (const std::string& name : settings.layers) {
    const auto desc = layers::find(name);
    const bool writes = desc && (std::find(known.begin(), known.end(), name) != known.end() || !desc->chain.empty() ||
                                 name.starts_with("CryptoObject"));
    if (!writes) {
      throw SettingError(
          ErrorCode::kUnknownName, "output.layers",
          fmt::format("the integrator \"{}\" cannot write the layer \"{}\"; it can write: {}, CryptoObject00..., "
                      "chain.<letters>.<feature>, and a class.<name>.color for each light-path class",
                      integrator, name, fmt::join(known, ", ")));
    }
    if (name.starts_with("CryptoObject")) {
      for (int rank = 0; rank < (settings.cryptomatte_depth + 1) / 2; ++rank) add(layers::crypto(rank));
    } else {
      add(*desc);
    }
  }
  const std::vector<LayerDesc> asked = result;
  for (const std::string& name : class_names(settings)) {
    for (const LayerDesc& d : {layers::color(), layers::color_a(), layers::color_b(), layers::color_variance()}) {
      if (std::find(asked.begin(), asked.end(), d) != asked.end()) add(layers::class_layer(name, d));
    }
  }
  return result;
}

std::vector<std::string> class_names(const RenderSettings& settings) {
  std::vector<std::string> names;
  for (const PathClass& c : settings.classes) names.push_back(c.name);
  if (settings.classes_are_decomposition) names.push_back("residual");
  return names;
}

void add_missing(std::vector<LayerDesc>& list, const std::vector<LayerDesc>& more) {
  for (const LayerDesc& d : more) {
    if (std::find(list.begin(), list.end(), d) == list.end()) list.push_back(d);
  }
}

Rgb variance_of_mean(const Rgb& sum_a, int count_a, const Rgb& sum_b, int count_b) {
  const float m = float(count_a), n = float(count_b);
  if (count_a == 0 || count_b == 0) {
    const Rgb mean = (sum_a + sum_b) * (1 / std::max(m + n, 1.0f));
    return mean * mean;
  }
  const Rgb difference = sum_a * (1 / m) - sum_b * (1 / n);
  return difference * difference * (m * n / sqr(m + n));
}

namespace {

bool has_classes(const RenderSettings& settings, const std::string& prefix, const Frame& out) {
  const std::vector<std::string> names = class_names(settings);
  return std::any_of(names.begin(), names.end(), [&](const std::string& name) {
    return out.has(prefix + layers::class_layer(name, layers::color()).name);
  });
}

}  // namespace

std::size_t TileFilm::bytes_of_pixel(const RenderSettings& settings) {
  return sizeof(Pixel) + (settings.classes.empty() ? 0 : settings.classes.size() + 1) * sizeof(ClassSums);
}

TileFilm::TileFilm(const FrameContext& context, const Tile& tile, const Frame& out, std::string prefix)
    : settings_(context.settings),
      tile_(tile),
      prefix_(std::move(prefix)),
      class_count_(has_classes(settings_, prefix_, out) ? settings_.classes.size() + 1 : 0),
      pixels_(std::size_t(tile.x1 - tile.x0) * std::size_t(tile.y1 - tile.y0)),
      class_sums_(pixels_.size() * class_count_),
      sample_classes_(class_count_),
      cryptomatte_(out.has(prefix_ + "CryptoObject00")),
      ids_(cryptomatte_ ? tile.x1 - tile.x0 : 0, cryptomatte_ ? tile.y1 - tile.y0 : 0),
      chains_(prefix_.empty() ? &out : nullptr, tile.x1 - tile.x0, tile.y1 - tile.y0) {
  for (const char* name : {"normal", "depth", "position", "uv", "emission"}) {
    if (cryptomatte_ || out.has(prefix_ + name)) features_ = Features::kGeometry;
  }
  if (out.has(prefix_ + "albedo")) features_ = Features::kAll;
  for (const char* name : {"photon.color", "photon.color.a", "photon.color.b"}) {
    if (out.has(prefix_ + name)) gathered_sums_.resize(pixels_.size());
  }
  if (cryptomatte_) {
    for (const std::string& name : cryptomatte_names(context.scene)) instance_ids_.push_back(cryptomatte_id(name));
  }
}

std::span<Rgb> TileFilm::sample_classes() {
  std::fill(sample_classes_.begin(), sample_classes_.end(), Rgb(0.0f));
  return sample_classes_;
}

float TileFilm::Pixel::relative_error() const {
  if (count < 2) return kInfinity;
  const float n = float(count), mean = luminance(sum) / n;
  const float variance = std::max(0.0f, (luminance(squares) / n - mean * mean) / (n - 1));
  return std::sqrt(variance) / (std::abs(mean) + 1e-2f);
}

bool TileFilm::add(int x, int y, int index, const CameraSample& camera, const SampleResult& sample) {
  if (!is_finite(sample.radiance)) return false;
  const std::size_t i = at(x, y);
  Pixel& p = pixels_[i];
  const Rgb c = sample.radiance * camera.weight;
  p.sum += c;
  p.squares += c * c;
  p.alpha += sample.alpha * camera.weight;
  ++p.count;
  (index & 1 ? p.sum_b : p.sum_a) += c;
  ++(index & 1 ? p.count_b : p.count_a);
  p.time += camera.time;
  for (std::size_t k = 0; k < class_count_; ++k) {
    ClassSums& sums = class_sums_[i * class_count_ + k];
    const Rgb part = sample_classes_[k] * camera.weight;
    sums.sum += part;
    if (!(index & 1)) sums.sum_a += part;
  }
  if (!gathered_sums_.empty()) {
    const Rgb part = sample.gathered * camera.weight;
    gathered_sums_[i].sum += part;
    if (!(index & 1)) gathered_sums_[i].sum_a += part;
  }
  if (cryptomatte_)
    ids_.add(x - tile_.x0, y - tile_.y0, sample.first.valid ? instance_ids_[sample.first.instance] : 0, 1);
  add_features(x, y, camera, sample.first);
  return true;
}

void TileFilm::add_features(int x, int y, const CameraSample& camera, const FirstHit& first) {
  const std::size_t i = at(x, y);
  Pixel& p = pixels_[i];
  ++p.feature_count;
  chains_.add(i, camera.weight);
  if (!first.valid) return;
  ++p.hits;
  p.albedo += first.albedo;
  p.emission += first.emission;
  p.normal += first.normal;
  p.position += first.position;
  p.uv += first.uv;
  p.depth += first.depth;
}

void TileFilm::save(ByteWriter& out) const {
  out.values(pixels_);
  out.values(class_sums_);
  out.values(gathered_sums_);
  ids_.save(out);
  chains_.save(out);
}

void TileFilm::load(ByteReader& in) {
  in.values(pixels_);
  in.values(class_sums_);
  in.values(gathered_sums_);
  ids_.load(in);
  chains_.load(in);
}

void TileFilm::write(Frame& out) const {
  chains_.write(out, tile_.x0 - settings_.x0(), tile_.y0 - settings_.y0(),
                [&](std::size_t i) { return pixels_[i].feature_count; });
  Frame crypto_frame(tile_.x1 - tile_.x0, tile_.y1 - tile_.y0);
  if (cryptomatte_) ids_.write(crypto_frame, {}, "CryptoObject", settings_.cryptomatte_depth);
  const auto layer = [&](const std::string& name) {
    return out.has(prefix_ + name) ? &out.layer(prefix_ + name) : nullptr;
  };
  Image* color = layer("color");
  Image *half_a = layer("color.a"), *half_b = layer("color.b"), *variance = layer("color.var");
  Image *albedo = layer("albedo"), *normal = layer("normal"), *depth = layer("depth"), *position = layer("position");
  Image *uv = layer("uv"), *emission = layer("emission"), *count = layer("samples"), *mean_time = layer("time");
  struct ClassLayers {
    Image *color, *half_a, *half_b, *variance;
  };
  const ClassLayers gathered{layer("photon.color"), layer("photon.color.a"), layer("photon.color.b"), nullptr};
  std::vector<ClassLayers> class_layers(class_count_);
  if (class_count_) {
    const std::vector<std::string> names = class_names(settings_);
    for (std::size_t k = 0; k < names.size(); ++k) {
      const std::string name = "class." + names[k] + ".color";
      class_layers[k] = {layer(name), layer(name + ".a"), layer(name + ".b"), layer(name + ".var")};
    }
  }
  for (int y = tile_.y0; y < tile_.y1; ++y) {
    for (int x = tile_.x0; x < tile_.x1; ++x) {
      const std::size_t i = at(x, y);
      const Pixel& p = pixels_[i];
      const int ox = x - settings_.x0(), oy = y - settings_.y0();
      const float inv = p.count ? 1 / float(p.count) : 0, inv_hits = p.hits ? 1 / float(p.hits) : 0;
      const float inv_features = p.feature_count ? 1 / float(p.feature_count) : 0;
      Rgb mean_color = p.sum * inv;
      Rgb class_total;
      const auto write_sums = [&](const ClassSums& sums, const ClassLayers& to) {
        const Rgb c = sums.sum * inv, sum_b = sums.sum - sums.sum_a;
        if (to.color) to.color->set_rgb(ox, oy, c);
        if (to.half_a) to.half_a->set_rgb(ox, oy, p.count_a ? sums.sum_a * (1 / float(p.count_a)) : Rgb(0.0f));
        if (to.half_b) to.half_b->set_rgb(ox, oy, p.count_b ? sum_b * (1 / float(p.count_b)) : Rgb(0.0f));
        if (to.variance) to.variance->set_rgb(ox, oy, variance_of_mean(sums.sum_a, p.count_a, sum_b, p.count_b));
        return c;
      };
      for (std::size_t k = 0; k < class_count_; ++k)
        class_total += write_sums(class_sums_[i * class_count_ + k], class_layers[k]);
      if (!gathered_sums_.empty()) write_sums(gathered_sums_[i], gathered);
      // The picture is defined as the sum of its parts: adding the layers up gives it to the bit.
      if (settings_.classes_are_decomposition && class_count_) mean_color = class_total;
      color->set_rgb(ox, oy, mean_color);
      if (color->channels() > 3) color->at(ox, oy, 3) = p.alpha * inv;
      if (half_a) half_a->set_rgb(ox, oy, p.count_a ? p.sum_a * (1 / float(p.count_a)) : Rgb(0.0f));
      if (half_b) half_b->set_rgb(ox, oy, p.count_b ? p.sum_b * (1 / float(p.count_b)) : Rgb(0.0f));
      if (variance) variance->set_rgb(ox, oy, variance_of_mean(p.sum_a, p.count_a, p.sum_b, p.count_b));
      if (albedo) albedo->set_rgb(ox, oy, p.albedo * inv_features);
      if (emission) emission->set_rgb(ox, oy, p.emission * inv_features);
      if (normal) normal->set_vec3(ox, oy, normalize(p.normal));
      if (position) position->set_vec3(ox, oy, p.position * inv_hits);
      if (depth) depth->at(ox, oy) = p.depth * inv_hits;
      if (uv) {
        uv->at(ox, oy, 0) = p.uv.x * inv_hits;
        uv->at(ox, oy, 1) = p.uv.y * inv_hits;
      }
      if (count) count->at(ox, oy) = float(p.count);
      if (mean_time) mean_time->at(ox, oy) = p.count ? float(p.time / p.count) : 0.0f;
      if (cryptomatte_) {
        for (const Layer& l : crypto_frame.layers()) {
          if (!out.has(l.desc.name)) continue;
          Image& target = out.layer(l.desc.name);
          for (int c = 0; c < target.channels(); ++c) {
            target.at(ox, oy, c) = l.image.at(x - tile_.x0, y - tile_.y0, c);
          }
        }
      }
    }
  }
}

}  // namespace tempera
