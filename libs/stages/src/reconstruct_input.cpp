// SPDX-License-Identifier: Apache-2.0
#include "reconstruct_input.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "tempera/core/error.h"
#include "tempera/core/parallel.h"
#include "tempera/core/vec.h"

namespace tempera::reconstruction {
namespace {

const std::string kCameraKey = "tempera/camera", kCropLeftKey = "tempera/crop_left", kCropTopKey = "tempera/crop_top";

[[noreturn]] void bad_layer(const std::string& path, const std::string& layer, const std::string& what) {
  throw Error(ErrorCode::kBadInput, fmt::format("{}: layer \"{}\" {}", path, layer, what));
}

template <class T>
std::optional<T> metadata_value(const Metadata& m, const std::string& key) {
  const auto it = m.find(key);
  const T* v = it == m.end() ? nullptr : std::get_if<T>(&it->second);
  return v ? std::optional<T>(*v) : std::nullopt;
}

float mean_of(const Image& image) {
  double sum = 0;
  for (const float v : image.values()) sum += double(v);
  return float(sum / double(image.values().size()));
}

/// Refuses values that are not finite among those that the reconstruction uses: one would spoil a whole window.
/// `used(x, y)`: whether the value counts.
template <class F>
void check_finite(const std::string& path, const std::string& layer, const Image& image, int width, int height,
                  F&& used) {
  std::vector<int> bad(height, -1);
  parallel_rows(
      0, height,
      [&](int y) {
        for (int x = 0; x < width; ++x) {
          if (!is_finite(image.rgb(x, y)) && used(x, y)) {
            bad[y] = x;
            return;
          }
        }
      },
      16);
  for (int y = 0; y < height; ++y) {
    if (bad[y] < 0) continue;
    bad_layer(path, layer, fmt::format("has a value that is not finite at pixel {},{}", bad[y], y));
  }
}

/// Takes the layers of rare light of the pass whose names begin with `prefix`.
template <class TakePass, class Take>
void take_rare(const std::string& path, int width, int height, const std::string& prefix, Pass& rare, Image& held,
               TakePass&& take_pass, Take&& take) {
  rare = take_pass(prefix + "rare.");
  held = take(prefix + "held.color", 3);
  const auto check = [&](const std::string& name, const Image& image, int dx, int dy) {
    check_finite(path, prefix + name, image, width - dx, height - dy, [](int, int) { return true; });
  };
  check("rare.color", rare.color, 0, 0), check("held.color", held, 0, 0);
  check("rare.grad.x", rare.grad_x, 1, 0), check("rare.grad.y", rare.grad_y, 0, 1);
}

/// Takes light of photons out of a picture.
void subtract(Image& color, const Image& photons) {
  for (int y = 0; y < color.height(); ++y) {
    for (int x = 0; x < color.width(); ++x) color.set_rgb(x, y, color.rgb(x, y) - photons.rgb(x, y));
  }
}

}  // namespace

std::vector<LayerUse> layers_read(const Settings& settings) {
  std::vector<LayerDesc> required{layers::color(), layers::grad_x(), layers::grad_y()};
  for (const std::string& name : settings.classes) {
    for (const LayerDesc& d : {layers::color(), layers::grad_x(), layers::grad_y()})
      required.push_back(layers::class_layer(name, d));
  }
  if (settings.apart) {
    for (const LayerDesc& d :
         {layers::rare_color(), layers::rare_grad_x(), layers::rare_grad_y(), layers::held_color()})
      required.push_back(d);
  }
  if (settings.photons) {
    required.push_back(layers::photon_color());
    for (const std::string& name : settings.classes)
      required.push_back(layers::class_layer(name, layers::photon_color()));
  }
  if (settings.temporal) {
    for (const std::vector<LayerDesc> base = required; const LayerDesc& d : base) required.push_back(layers::offset(d));
    required.push_back(layers::offset(layers::source()));
  } else if (settings.apart) {
    required.push_back(layers::rare_a()), required.push_back(layers::rare_b());
  }
  std::vector<LayerUse> out;
  for (const LayerDesc& d : required) {
    out.push_back({d, true,
                   fmt::format("reconstruction needs the frames of the integrator {}",
                               settings.temporal ? "temporal_gradient_path" : "gradient_path")});
  }
  if (settings.temporal) out.push_back({layers::offset(layers::samples()), false});
  if (settings.apart) {
    for (const LayerDesc& d : {layers::samples(), layers::albedo(), layers::normal(), layers::object_id()})
      out.push_back({d, false});
  }
  return out;
}

Input Reader::read(int frame) const {
  const bool rare = settings_.apart, temporal = settings_.temporal;
  Input in;
  in.frame = frame;
  in.path = run_.path(frame);
  const std::string samples = layers::offset(layers::samples()).name;
  Frame file = run_.read(frame);
  const auto take = [&](const std::string& name, int channels) {
    Image& image = file.layer(name);
    if (image.channels() < channels)
      bad_layer(in.path, name, fmt::format("has {} channels, not {}", image.channels(), channels));
    return std::move(image);
  };
  const auto take_pass = [&](const std::string& prefix) {
    return Pass{take(prefix + "color", 3), take(prefix + "grad.x", 3), take(prefix + "grad.y", 3)};
  };
  const auto all = [](int, int) { return true; };
  const auto take_photons = [&](const std::string& prefix, Image& color) {
    Image photons = take(prefix + layers::photon_color().name, 3);
    check_finite(in.path, prefix + layers::photon_color().name, photons, width_, height_, all);
    subtract(color, photons);
    return photons;
  };
  const auto take_base = [&](const std::string& prefix) {
    Pass pass = take_pass(prefix);
    check_finite(in.path, prefix + "color", pass.color, width_, height_, all);
    check_finite(in.path, prefix + "grad.x", pass.grad_x, width_ - 1, height_, all);
    check_finite(in.path, prefix + "grad.y", pass.grad_y, width_, height_ - 1, all);
    return pass;
  };
  in.light.base = take_base("");
  for (const std::string& name : settings_.classes) in.classes.push_back({take_base("class." + name + "."), {}});
  if (settings_.photons) {
    in.photons.push_back(take_photons("", in.light.base.color));
    for (std::size_t k = 0; k < in.classes.size(); ++k)
      in.photons.push_back(take_photons("class." + settings_.classes[k] + ".", in.classes[k].base.color));
  }
  in.camera = metadata_value<std::string>(file.metadata, kCameraKey).value_or("");
  const auto left = metadata_value<int>(file.metadata, kCropLeftKey),
             top = metadata_value<int>(file.metadata, kCropTopKey);
  in.cropped = left || top;
  in.crop_left = left.value_or(0), in.crop_top = top.value_or(0);
  if (rare) {
    take_rare(in.path, width_, height_, "", in.base_rare, in.base_held, take_pass, take);
    const auto take_if = [&](const LayerDesc& d, int channels) {
      return file.find(d.name) ? take(d.name, channels) : Image();
    };
    in.albedo = take_if(layers::albedo(), 3), in.normal = take_if(layers::normal(), 3);
    in.object = take_if(layers::object_id(), 1);
    for (const char* name : {"samples", "offset.samples"}) {
      if (const Layer* counts = file.find(name)) in.samples += mean_of(counts->image);
    }
    if (!temporal) {
      in.rare_halves = {take(layers::rare_a().name, 3), take(layers::rare_b().name, 3)};
      check_finite(in.path, "rare.a", in.rare_halves[0], width_, height_, all);
      check_finite(in.path, "rare.b", in.rare_halves[1], width_, height_, all);
    }
  }
  if (!temporal) return in;

  in.source = take(layers::offset(layers::source()).name, 3);
  const Image* counts = file.find(samples) ? &file.layer(samples) : nullptr;
  in.sampled.assign(width_, height_);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      in.sampled.at(x, y) = counts ? counts->at(x, y) > 0 : in.source.at(x, y, 2) > 0;
    }
  }
  const auto here = [&](int x, int y) { return in.is_sampled(x, y); };
  const auto take_offset = [&](const std::string& prefix) {
    Pass pass = take_pass(prefix);
    check_finite(in.path, prefix + "color", pass.color, width_, height_, here);
    check_finite(in.path, prefix + "grad.x", pass.grad_x, width_ - 1, height_,
                 [&](int x, int y) { return here(x, y) && here(x + 1, y); });
    check_finite(in.path, prefix + "grad.y", pass.grad_y, width_, height_ - 1,
                 [&](int x, int y) { return here(x, y) && here(x, y + 1); });
    return pass;
  };
  in.light.offset = take_offset("offset.");
  for (std::size_t k = 0; k < in.classes.size(); ++k)
    in.classes[k].offset = take_offset("offset.class." + settings_.classes[k] + ".");
  for (std::size_t k = 0; k < in.photons.size(); ++k) {
    PassPair& light = k == 0 ? in.light : in.classes[k - 1];
    const std::string prefix = k == 0 ? "offset." : "offset.class." + settings_.classes[k - 1] + ".";
    const Image offset = take_photons(prefix, light.offset.color);
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        if (here(x, y)) in.photons[k].set_rgb(x, y, (in.photons[k].rgb(x, y) + offset.rgb(x, y)) * 0.5f);
      }
    }
  }
  if (rare) take_rare(in.path, width_, height_, "offset.", in.offset_rare, in.offset_held, take_pass, take);
  return in;
}

PixelMap replay_map(const Input& in, int width, int height) {
  PixelMap map(width, height);
  const std::string layer = layers::offset(layers::source()).name;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float* s = in.source.pixel(x, y);
      if (!(s[2] > 0)) continue;
      const float sx = s[0] - float(in.crop_left), sy = s[1] - float(in.crop_top);
      const bool inside = sx >= 0 && sy >= 0 && sx < float(width) && sy < float(height);
      if (!inside && in.cropped) continue;  // what it replays is not in the file of the frame before
      if (!inside || sx != std::floor(sx) || sy != std::floor(sy)) {
        bad_layer(in.path, layer,
                  fmt::format("names {},{} at pixel {},{}, which is no pixel of the frame before", s[0], s[1], x, y));
      }
      const int from_x = int(sx), from_y = int(sy);
      if (!map.link(from_x, from_y, x, y)) {
        const Vec2<int> other = map.forward(from_x, from_y);
        bad_layer(in.path, layer,
                  fmt::format("names {},{} at two pixels, {},{} and {},{}: it must be one-to-one", s[0], s[1], other.x,
                              other.y, x, y));
      }
    }
  }
  return map;
}

void combine_passes(const Input& in, const PassPair& light, PoissonFrame& out) {
  const int w = out.width(), h = out.height();
  parallel_rows(
      0, h,
      [&](int y) {
        const auto set_row = [&](RowSet set, int x, const Image& base, const Image& offset, bool both) {
          const Rgb b = base.rgb(x, y), v = both ? (b + offset.rgb(x, y)) * 0.5f : b;
          for (int c = 0; c < 3; ++c) out.data(set, y, c)[x] = v[c];
        };
        for (int x = 0; x < w; ++x) {
          const bool here = in.is_sampled(x, y);
          const auto& [base, offset] = light;
          set_row(RowSet::kPrimal, x, base.color, offset.color, here);
          if (x + 1 < w) set_row(RowSet::kDx, x, base.grad_x, offset.grad_x, here && in.is_sampled(x + 1, y));
          if (y + 1 < h) set_row(RowSet::kDy, x, base.grad_y, offset.grad_y, here && in.is_sampled(x, y + 1));
        }
      },
      8);
}

DataVariance variance_between_passes(const Input& in, const PassPair& light, int w, int h) {
  DataVariance out{Image(w, h, 1), Image(w, h, 1)};
  parallel_rows(
      0, h,
      [&](int y) {
        const auto set_row = [&](Image& image, int x, const Image& base, const Image& offset, bool both) {
          const Rgb d = (base.rgb(x, y) - offset.rgb(x, y)) * 0.5f;
          image.at(x, y) = both ? (d.r * d.r + d.g * d.g + d.b * d.b) / 3 : -1;
        };
        for (int x = 0; x < w; ++x) {
          const bool here = in.is_sampled(x, y);
          const auto& [base, offset] = light;
          set_row(out.dx, x, base.grad_x, offset.grad_x, here && x + 1 < w && in.is_sampled(x + 1, y));
          set_row(out.dy, x, base.grad_y, offset.grad_y, here && y + 1 < h && in.is_sampled(x, y + 1));
        }
      },
      8);
  return out;
}

void subtract_passes(const Pass& base, const Pass& next, PoissonFrame& out) {
  parallel_rows(
      0, out.height(),
      [&](int y) {
        for (const MotionRun& r : out.motion.from_row(y)) {
          const auto set_row = [&](RowSet set, int x, const Image& from, const Image& to) {
            const Rgb d = to.rgb(x + r.dx, y + r.dy) - from.rgb(x, y);
            for (int c = 0; c < 3; ++c) out.data(set, y, c)[x] = d[c];
          };
          for (int i = 0; i < r.length; ++i) {
            set_row(RowSet::kDt, r.x + i, base.color, next.color);
            if (i < r.mixed_x) set_row(RowSet::kDxDt, r.x + i, base.grad_x, next.grad_x);
            if (r.mixed_y) set_row(RowSet::kDyDt, r.x + i, base.grad_y, next.grad_y);
          }
        }
      },
      8);
}

RareFrame take_rare_light(Input& in, LightShares& shares) {
  auto& [in_base, in_offset] = in.light;
  const int w = in_base.color.width(), h = in_base.color.height();
  const bool temporal = !in.sampled.empty();
  RareFrame out;
  out.light = {Image(w, h, 3), Image(w, h, 3)};
  if (in.samples > 0) out.samples = in.samples;
  const auto subtract = [](Image& from, const Image& what, int x, int y) {
    from.set_rgb(x, y, from.rgb(x, y) - what.rgb(x, y));
  };
  std::vector<LightShares> rows(h, LightShares{});
  std::vector<std::uint8_t> lit(h, 0);
  if (temporal) out.previous.assign(w, h, -1);
  parallel_rows(
      0, h,
      [&](int y) {
        for (int x = 0; x < w; ++x) {
          const Rgb base = in.base_rare.color.rgb(x, y) - in.base_held.rgb(x, y);
          Rgb all = in_base.color.rgb(x, y), rare = in.base_rare.color.rgb(x, y), held = in.base_held.rgb(x, y);
          std::array<Rgb, 2> light{base, base};
          if (!temporal) {
            light = {in.rare_halves[0].rgb(x, y), in.rare_halves[1].rgb(x, y)};
          } else if (in.is_sampled(x, y)) {
            light[1] = in.offset_rare.color.rgb(x, y) - in.offset_held.rgb(x, y);
            all = (all + in_offset.color.rgb(x, y)) * 0.5f, held = (held + in.offset_held.rgb(x, y)) * 0.5f;
            rare = (rare + in.offset_rare.color.rgb(x, y)) * 0.5f;
          }
          for (std::size_t k = 0; k < 2; ++k) {
            for (int c = 0; c < 3; ++c) light[k][c] = std::max(0.0f, light[k][c]);
            out.light[k].set_rgb(x, y, light[k]);
            lit[y] |= !is_black(light[k]);
          }
          rows[y] += {double(luminance(all)), double(luminance(rare)), double(luminance(held))};
          subtract(in_base.color, in.base_rare.color, x, y);
          subtract(in_base.grad_x, in.base_rare.grad_x, x, y);
          subtract(in_base.grad_y, in.base_rare.grad_y, x, y);
          if (!temporal) continue;
          subtract(in_offset.color, in.offset_rare.color, x, y);
          subtract(in_offset.grad_x, in.offset_rare.grad_x, x, y);
          subtract(in_offset.grad_y, in.offset_rare.grad_y, x, y);
          const float* s = in.source.pixel(x, y);
          const int sx = int(s[0]) - in.crop_left, sy = int(s[1]) - in.crop_top;
          if (s[2] > 0 && sx >= 0 && sy >= 0 && sx < w && sy < h) out.previous.at(x, y) = sy * w + sx;
        }
      },
      8);
  for (const LightShares& row : rows) shares += row;
  out.dark = std::find(lit.begin(), lit.end(), 1) == lit.end();
  out.albedo = std::move(in.albedo), out.normal = std::move(in.normal), out.object = std::move(in.object);
  return out;
}

}  // namespace tempera::reconstruction
