// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/fill.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "decomposition.h"
#include "denoise/denoiser.h"
#include "sound_values.h"
#include "tempera/core/parallel.h"

namespace tempera {

namespace {

using denoise::Planes;

enum Port { kFrames, kPixels };

const std::vector<ParamSpec> kParams = {
    {.name = "smooth",
     .fallback = std::string("auto"),
     .help =
         "whether the light of the pixels is freed of noise, with what is around them: yes, no; auto: where the other "
         "frames were denoised",
     .choices = {"auto", "yes", "no"}},
};

/// Luminance of the first half that is believed at most, in terms of the other half: beyond it, it is a firefly.
constexpr float kOutshines = 4;

Planes planes_of(const Image& image) {
  Planes out(image, 3);
  for (float& v : out.values()) v = sound(v);
  return out;
}

/// `image`, where it is sound, minus `less`, over `by`.
Planes divided(const Image& image, const Planes& less, const Planes& by) {
  Planes out = planes_of(image);
  for (std::size_t i = 0; i < out.values().size(); ++i)
    out.values()[i] = (out.values()[i] - less.values()[i]) / by.values()[i];
  return out;
}

/// Takes noise out of the pixels of `color` where `mask` is above 0: averages with what is around them, whose other
/// pixels have none to speak of. `rendered` has the halves of their samples. [Zimmer 2015, Sec. 5.3]
void smooth_filled(const Image& mask, const Frame& rendered, Frame& frame) {
  if (!frame.has("color")) return;
  Image& color = frame.layer("color");
  const Layer *half_a = rendered.find("color.a"), *half_b = rendered.find("color.b");
  if (!half_a || !half_b || color.channels() < 3 || half_a->image.channels() < 3 || half_b->image.channels() < 3)
    return;
  const int w = color.width(), h = color.height();
  const auto layer = [&](const char* name, float missing) {
    const Layer* l = frame.find(name);
    return l && l->image.channels() >= 3 ? planes_of(l->image) : Planes(w, h, 3, missing);
  };
  const Planes emission = layer("emission", 0), normal = layer("normal", 0);
  Planes albedo = layer("albedo", 1);
  for (float& v : albedo.values()) v = std::max(v, denoise::kLeastReflectance);
  const Planes whole = divided(color, emission, albedo);
  Planes a = divided(half_a->image, emission, albedo), b = divided(half_b->image, emission, albedo);
  Planes noise(w, h, 2);  // of filled pixels, and where they are
  double sum = 0;
  for (std::size_t i = 0; i < whole.pixels(); ++i) {
    for (int c = 0; c < 3; ++c) sum += double(whole.plane(c)[i]);
    if (!(mask.values()[i] > 0)) {
      for (int c = 0; c < 3; ++c) a.plane(c)[i] = b.plane(c)[i] = whole.plane(c)[i];
      continue;
    }
    for (auto [one, other] : {std::pair(&a, &b), std::pair(&b, &a)}) {
      const auto brightness = [&](const Planes& p) {
        return denoise::luminance(p.plane(0)[i], p.plane(1)[i], p.plane(2)[i]);
      };
      const float bound = kOutshines * std::max(brightness(*other), 0.0f), is = brightness(*one);
      if (!(is > bound)) continue;
      for (int c = 0; c < 3; ++c) one->plane(c)[i] *= bound / is;
    }
    for (int c = 0; c < 3; ++c) {
      const float d = a.plane(c)[i] - b.plane(c)[i];
      noise.plane(0)[i] += d * d / 12;  // of the mean of both, and of the channels
    }
    noise.plane(1)[i] = 1;
  }
  denoise::NlMeansSettings settings;
  // Clean pixels are taken to be as noisy as those around: patches hold both, and have to be alike within the noise.
  const Planes near = denoise::box_mean(noise, settings.patch);
  const Planes wide = denoise::box_mean(noise, settings.window + settings.patch);
  Planes variance(w, h, 1);
  for (std::size_t i = 0; i < variance.pixels(); ++i) {
    const Planes& mean = mask.values()[i] > 0 ? near : wide;
    if (mean.plane(1)[i] > 1e-6f) variance.plane(0)[i] = mean.plane(0)[i] / mean.plane(1)[i];
  }
  Planes features(w, h, 6);
  std::copy(normal.values().begin(), normal.values().end(), features.plane(0));
  std::copy(albedo.values().begin(), albedo.values().end(), features.plane(3));
  settings.feature_groups = {3, 3}, settings.feature_floors = {4e-3f, 1e-3f};
  const double level = sum / double(3 * std::max<std::size_t>(whole.pixels(), 1));
  settings.floor = float(1e-8 * level * level + 1e-30);
  const denoise::NlMeansFrame only{&a, &b, &variance, nullptr, &features};
  const denoise::NlMeansResult clean = denoise::nl_means(std::span(&only, 1), settings);
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      if (!(mask.at(x, y) > 0)) continue;
      for (int c = 0; c < 3; ++c) {
        const float u = (clean.a.row(c, y)[x] + clean.b.row(c, y)[x]) / 2;
        color.at(x, y, c) = std::max(u * albedo.row(c, y)[x] + emission.row(c, y)[x], 0.0f);
      }
    }
  });
}

/// Makes the classes of a decomposition add up to `color` again, where pixels were filled.
void fit_classes(const Image& mask, Frame& frame) {
  const std::string rest = layers::class_layer("residual", layers::color()).name;
  if (!frame.has(rest) || !frame.has("color")) return;
  std::vector<Image*> parts;
  for (const Layer& l : frame.layers()) {
    if (!is_class_color(l.desc) || l.image.channels() < 3) continue;
    parts.push_back(&frame.layer(l.desc.name));
  }
  const Image& color = frame.layer("color");
  Image& residual = frame.layer(rest);
  parallel_rows(0, color.height(), [&](int y) {
    for (int x = 0; x < color.width(); ++x) {
      if (!(mask.at(x, y) > 0)) continue;
      for (int c = 0; c < 3; ++c) {
        float sum = 0;
        for (Image* part : parts) sum += std::max(sound(part->at(x, y, c)), 0.0f);
        for (Image* part : parts) {
          float& v = part->at(x, y, c);
          v = sum > 0 ? std::max(sound(v), 0.0f) * (color.at(x, y, c) / sum) : 0;
        }
        if (!(sum > 0)) residual.at(x, y, c) = color.at(x, y, c);
      }
    }
  });
}

class Fill final : public FrameStage {
 public:
  explicit Fill(const Params& params) : smooth_(params.get_string("smooth")) {}

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    if (in[kFrames].width != in[kPixels].width || in[kFrames].height != in[kPixels].height) {
      throw Error(ErrorCode::kBadInput,
                  fmt::format("the frames to be filled have {}x{} pixels, the rendered ones {}x{}", in[kFrames].width,
                              in[kFrames].height, in[kPixels].width, in[kPixels].height));
    }
    SequenceDesc out = in[kFrames];
    std::erase_if(out.layers, [](const LayerDesc& d) { return d.role == LayerRole::kMask; });
    if (std::none_of(out.layers.begin(), out.layers.end(), [&](const LayerDesc& d) { return in[kPixels].has(d); }))
      throw Error(ErrorCode::kBadInput, "the rendered frames have none of the layers that are to be filled");
    return out;
  }
  std::vector<LayerUse> reads(int port, std::span<const SequenceDesc> in) const override {
    std::vector<LayerUse> uses;
    for (const LayerDesc& d : in[kFrames].layers) {
      const bool mask = d.role == LayerRole::kMask;
      if (port == kFrames && mask) uses.push_back({d, true, kWhyMask});
      if (port == kPixels && !mask && in[kPixels].has(d)) uses.push_back({d, true, "others have it"});
    }
    if (port == kPixels && smooth_ != "no") {
      for (const LayerDesc& d : {layers::color_a(), layers::color_b()}) {
        if (!in[kFrames].has(d)) uses.push_back({d, false});
      }
    }
    if (port == kFrames && uses.empty()) uses.push_back({layers::mask(), true, kWhyMask});
    return uses;
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    const Image& mask = in.at(frame, kFrames).layers().front().image;
    for (const Layer& rendered : in.at(frame, kPixels).layers()) {
      const std::string& name = rendered.desc.name;
      const Image& from = rendered.image;
      if (!out.has(name)) continue;
      Image& to = out.layer(name);
      if (from.channels() != to.channels()) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("frame {}: the layer \"{}\" has {} channels in the frames to be filled, {} in the "
                                "rendered ones",
                                frame, name, to.channels(), from.channels()));
      }
      parallel_for(0, to.height(), [&](std::int64_t row) {
        const int y = int(row);
        for (int x = 0; x < to.width(); ++x) {
          if (!(mask.at(x, y) > 0)) continue;
          for (int c = 0; c < to.channels(); ++c) to.at(x, y, c) = from.at(x, y, c);
        }
      });
    }
    const bool clean = out.metadata.contains(stage_engine_key("denoise"));
    if (smooth_ == "yes" || (smooth_ == "auto" && clean)) {
      smooth_filled(mask, in.at(frame, kPixels), out);
      fit_classes(mask, out);
    }
  }

 private:
  std::string smooth_;
  static constexpr const char* kWhyMask = "it says which pixels to fill";
};

}  // namespace

const StageEntry fill_entry{
    .name = "fill",
    .help = "pixels that a stage left to the renderer, put into its frames",
    .command_help = "Put pixels that were rendered alone into the frames of a stage that left them out.",
    .done = "filled",
    .params = kParams,
    .ports = {{"base", "frames of a stage that writes the layer mask"},
              {"pixels", "frames in which the pixels of that mask are rendered"}},
    .output_help = "filled frames",
    .reads = {{{"mask"}, "above 0 where a pixel is to be filled"},
              {{"*"}, "of the rendered frames: every layer that the others have, too"},
              {{"color.a", "color.b"}, "of the rendered frames: tell noise from picture, to smooth with"}},
    .writes = {{{"*"}, "all layers but the mask; where the mask is above 0, the rendered pixel"}},
    .window = "the frame itself",
    .gap_help = "each frame takes pixels of its own",
    .examples = {"tempera render shot.toml --mask between/f.####.exr -o pixels/f.####.exr",
                 "tempera fill between/ pixels/ -o final/   (between/ is what a stage wrote, with the layer mask)"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<Fill>(p); },
    .inserted_help = "follows by itself, after a render of these pixels, where a stage writes a mask"};

}  // namespace tempera
