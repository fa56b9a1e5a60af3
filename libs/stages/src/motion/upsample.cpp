// SPDX-License-Identifier: Apache-2.0
// The stage `upsample`: frames of twice the width and height, whose light follows guides of that size, see
// docs/motion-stages.md. Source: [Zimmer 2015, Sec. 5.2].
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "decomposition.h"
#include "sound_values.h"
#include "tempera/core/grid.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/stage_run.h"

namespace tempera {

namespace {

enum Port { kFrames, kGuides };
constexpr int kFactor = 2;
constexpr int kMost = 8;    ///< guides: reflectance, normal, emission, alpha
constexpr int kLights = 4;  ///< channels of color
/// Of windows, pixels of the small frame; and what keeps their fits from following noise. Source: measured, see
/// docs/motion-stages.md.
constexpr int kRadius = 1;
constexpr double kRidge = 1e-4;

/// A linear model of light by guides, in one window: light = slope * guide + offset.
struct Model {
  float slope[kLights][kMost] = {};
  float offset[kLights] = {};
};

/// Solves (A + kRidge I) x = b for each light by Cholesky's method. A: [n][n], its lower half is used.
void solve(std::array<std::array<double, kMost>, kMost>& a, std::array<std::array<double, kMost>, kLights>& b, int n) {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = a[i][j] + (i == j ? kRidge : 0);
      for (int k = 0; k < j; ++k) sum -= a[i][k] * a[j][k];
      a[i][j] = i == j ? std::sqrt(std::max(sum, 0.5 * kRidge)) : sum / a[j][j];
    }
  }
  for (auto& x : b) {
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < i; ++k) x[i] -= a[i][k] * x[k];
      x[i] /= a[i][i];
    }
    for (int i = n - 1; i >= 0; --i) {
      for (int k = i + 1; k < n; ++k) x[i] -= a[k][i] * x[k];
      x[i] /= a[i][i];
    }
  }
}

class Upsample final : public FrameStage {
 public:
  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    const SequenceDesc &small = in[kFrames], &guides = in[kGuides];
    if (guides.width != kFactor * small.width || guides.height != kFactor * small.height) {
      throw Error(ErrorCode::kBadInput, fmt::format("the frames have {}x{} pixels, so guides have {}x{}, not {}x{}",
                                                    small.width, small.height, kFactor * small.width,
                                                    kFactor * small.height, guides.width, guides.height));
    }
    SequenceDesc out = small;
    out.width = guides.width, out.height = guides.height;
    const bool decomposed = is_decomposed(small.layers);
    std::erase_if(out.layers, [&](const LayerDesc& d) { return !survives(d) && !(decomposed && is_class_color(d)); });
    out.layers.push_back(layers::mask());
    return out;
  }
  std::vector<LayerUse> reads(int port, std::span<const SequenceDesc> in) const override {
    if (port == kFrames) {
      std::vector<LayerUse> uses{{layers::color(), true, "there is nothing to enlarge"}, {layers::emission(), false}};
      for (const LayerDesc& d : in[kFrames].layers) {
        if (is_class_color(d) && is_decomposed(in[kFrames].layers)) uses.push_back({d, true, "other frames have it"});
      }
      return uses;
    }
    std::vector<LayerUse> uses{{layers::albedo(), false}, {layers::normal(), false}, {layers::emission(), false}};
    for (const char* chain : layers::kCommonChains)
      uses.push_back({layers::chain_layer(chain, layers::albedo()), false});
    for (const LayerDesc& d : in[kFrames].layers) {
      if (is_class_color(d) && is_decomposed(in[kFrames].layers)) uses.push_back({d, false});
      if (!survives(d)) continue;
      const auto named = [&](const LayerUse& use) { return use.layer.name == d.name; };
      const auto it = std::find_if(uses.begin(), uses.end(), named);
      if (it != uses.end()) {
        *it = {d, true, "the frames have it"};
      } else {
        uses.push_back({d, true, "the frames have it"});
      }
    }
    return uses;
  }

 protected:
  void make(const FrameWindow& in, int frame, Frame& out) const override {
    const Frame& small = in.at(frame, kFrames);
    const Frame& large = in.at(frame, kGuides);
    const Image& color = small.layer("color");
    const auto expect = [&](const char* name, const Image& image) {
      if (image.channels() >= 3) return;
      throw Error(ErrorCode::kBadInput, fmt::format("frame {}: the layer \"{}\" has {} channels, 3 are needed", frame,
                                                    name, image.channels()));
    };
    expect("color", color);
    for (const char* key : {"tempera/crop_left", "tempera/crop_top"}) {  // in pixels of the whole picture
      if (const auto it = large.metadata.find(key); it != large.metadata.end()) out.metadata[key] = it->second;
    }
    for (const Layer& l : large.layers()) {
      if (survives(l.desc) && small_has(in, l.desc)) out.add(l.desc, l.image);
    }
    Image& result = out.add(small.desc("color"), Image(large.width(), large.height(), color.channels()));
    Image& mask = out.create(layers::mask());
    const Lamps lamps = lamps_of(small, large);
    if (!is_decomposed(in.in()[kFrames].layers)) {
      Image all = enlarge(color, color, guides_of(large, {}), lamps);
      put_background(large, layers::color().name, all);
      put(all, result, mask);
      if (!lamps.large.empty()) mark_edges(lamps.large, result, mask);
      return;
    }
    // Each class follows what it is seen on. [Zimmer 2015, Sec. 5.2]
    const std::vector<ClassInfo> known = classes(small.metadata);
    std::vector<Image> parts;
    std::vector<LayerDesc> descs;
    bool lamps_apart = false;
    for (const Layer& l : small.layers()) {
      if (!is_class_color(l.desc)) continue;
      expect(l.desc.name.c_str(), l.image);
      const auto info =
          std::find_if(known.begin(), known.end(), [&](const ClassInfo& c) { return c.name == l.desc.path_class; });
      std::vector<std::string> chains = info == known.end() ? std::vector<std::string>{} : info->chains;
      std::erase_if(chains, [](const std::string& chain) { return chain.ends_with('L'); });
      const bool shines = info != known.end() && is_emission(*info);
      parts.push_back(enlarge(l.image, color, guides_of(large, chains), shines ? lamps : Lamps()));
      put_background(large, l.desc.name, parts.back());
      lamps_apart |= shines && !lamps.large.empty();
      descs.push_back(l.desc);
    }
    Image sum = parts[0];
    for (std::size_t k = 1; k < parts.size(); ++k) {
      for (std::int64_t i = 0; i < sum.pixels(); ++i) {
        for (int c = 0; c < 3; ++c) sum.values()[i * kLights + c] += parts[k].values()[i * kLights + c];
      }
    }
    put(sum, result, mask);
    if (lamps_apart) mark_edges(lamps.large, result, mask);
    for (std::size_t k = 0; k < parts.size(); ++k) {
      Image& part = out.add(descs[k], Image(large.width(), large.height(), 3));
      parallel_rows(0, part.height(), [&](int y) {
        for (int x = 0; x < part.width(); ++x) {
          for (int c = 0; c < 3; ++c) {
            const float v = parts[k].at(x, y, c);
            // A class may be a little below 0 where others outshine it.
            if (v < -kTolerance - kUnseen * std::max(sum.at(x, y, c), 0.0f)) mask.at(x, y) = 1;
            part.at(x, y, c) = std::max(v, 0.0f);
          }
        }
      });
    }
  }

 private:
  static constexpr float kTolerance = 1e-6f;
  static constexpr float kUnseen = 0.005f;   ///< of all light
  static constexpr float kWhole = 0.99f;     ///< of the brightest lamp around: what a lamp covers as a whole
  static constexpr float kOutshines = 0.5f;  ///< of all light

  static bool survives(const LayerDesc& d) {
    return d.pass.empty() && d.path_class.empty() && d.role != LayerRole::kStatistic &&
           d.role != LayerRole::kReconstruction && d.role != LayerRole::kMask &&
           (d.role != LayerRole::kPicture || d.name == layers::color().name);
  }

  /// Writes what was enlarged, and marks what came out negative. [Zimmer 2015, Sec. 5.2]
  static void put(const Image& from, Image& to, Image& mask) {
    parallel_rows(0, to.height(), [&](int y) {
      for (int x = 0; x < to.width(); ++x) {
        for (int c = 0; c < to.channels(); ++c) {
          const float v = c < kLights ? from.at(x, y, c) : 0;
          if (c < 3 && v < -kTolerance) mask.at(x, y) = 1;
          to.at(x, y, c) = c == 3 ? std::clamp(v, 0.0f, 1.0f) : std::max(v, 0.0f);
        }
      }
    });
  }

  /// Light of lamps that are seen, at both sizes, [h,w,3] each, as their own samples have it; empty where nothing says what
  /// it is.
  struct Lamps {
    Image small, large;
  };
  static Lamps lamps_of(const Frame& small, const Frame& large) {
    Lamps out;
    for (const auto& [from, to] : {std::pair{&small, &out.small}, {&large, &out.large}}) {
      const Layer* layer = from->find(layers::emission().name);
      if (!layer || layer->image.channels() < 3) return {};
      *to = Image(from->width(), from->height(), 3);
      parallel_rows(0, to->height(), [&](int y) {
        for (int x = 0; x < to->width(); ++x) {
          for (int c = 0; c < 3; ++c) to->at(x, y, c) = sound(layer->image.at(x, y, c));
        }
      });
    }
    return out;
  }
  /// Where nothing but the background is seen, the guide's own light has no noise: it takes the place of `out`.
  static void put_background(const Frame& large, const std::string& name, Image& out) {
    const Layer *color = large.find(layers::color().name), *own = large.find(name);
    if (!own || own->image.channels() < 3 || color->image.channels() < 4) return;
    parallel_rows(0, out.height(), [&](int y) {
      for (int x = 0; x < out.width(); ++x) {
        if (color->image.at(x, y, 3) > 0) continue;
        for (int c = 0; c < 3; ++c) out.at(x, y, c) = sound(own->image.at(x, y, c));
        out.at(x, y, 3) = 0;
      }
    });
  }
  /// Marks pixels that lamps cover in part: by how much few samples do not say, for what outshines its surroundings.
  /// `light`: all light.
  static void mark_edges(const Image& lamps, const Image& light, Image& mask) {
    parallel_rows(0, lamps.height(), [&](int y) {
      for (int x = 0; x < lamps.width(); ++x) {
        const float own = luminance(lamps.rgb(x, y));
        if (!(own > 0)) continue;
        float least = own, most = own;
        for (int py = std::max(0, y - 1); py <= std::min(lamps.height() - 1, y + 1); ++py) {
          for (int px = std::max(0, x - 1); px <= std::min(lamps.width() - 1, x + 1); ++px) {
            const float v = luminance(lamps.rgb(px, py));
            least = std::min(least, v), most = std::max(most, v);
          }
        }
        if (own < kWhole * most && most - least > kOutshines * luminance(light.rgb(x, y))) mask.at(x, y) = 1;
      }
    });
  }

  /// Colors of `small` and the fourth channel of `alpha` (1 if it has none) at the size of the guides: [2h,2w,kLights].
  /// DEVIATION [Zimmer 2015, Sec. 5.2]: `lamps` are taken out first and put in afterwards, as no model of what surfaces
  /// scatter follows the edges of what is many times as bright.
  static Image enlarge(const Image& small, const Image& alpha, const Image& guides, const Lamps& lamps) {
    const int w = small.width(), h = small.height(), n = guides.channels();
    // Of the small frame: the mean over the pixels that one covers. Not rendered, so that both say the same.
    Image guide(w, h, n);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        for (int k = 0; k < n; ++k) {
          float sum = 0;
          for (int j = 0; j < kFactor * kFactor; ++j)
            sum += guides.at(kFactor * x + j % kFactor, kFactor * y + j / kFactor, k);
          guide.at(x, y, k) = sum / float(kFactor * kFactor);
        }
      }
    });
    const auto light = [&](int x, int y, int c) {
      const Image& from = c < 3 ? small : alpha;
      const float v = sound(c < from.channels() ? from.at(x, y, c) : 1.0f);
      return c < 3 && !lamps.small.empty() ? v - lamps.small.at(x, y, c) : v;
    };
    Grid<Model> models(w, h);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) models.at(x, y) = fit(guide, light, x, y);
    });
    const Grid<Model> means = mean_models(models, n);
    // DEVIATION [Zimmer 2015, Sec. 5.2]: what the models leave out of the small frame is given back, smoothly. Else light
    // that follows no guide, such as a reflection, is blurred by the windows.
    Image rest(w, h, kLights);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        for (int c = 0; c < kLights; ++c) {
          const Model& m = means.at(x, y);
          float model = m.offset[c];
          for (int j = 0; j < n; ++j) model += m.slope[c][j] * guide.at(x, y, j);
          rest.at(x, y, c) = light(x, y, c) - model;
        }
      }
    });
    Image out(guides.width(), guides.height(), kLights);
    parallel_rows(0, out.height(), [&](int y) {
      for (int x = 0; x < out.width(); ++x) {
        const float fx = (float(x) + 0.5f) / kFactor - 0.5f, fy = (float(y) + 0.5f) / kFactor - 0.5f;
        const int x0 = int(std::floor(fx)), y0 = int(std::floor(fy));
        for (int k = 0; k < 4; ++k) {
          const int px = std::clamp(x0 + (k & 1), 0, w - 1), py = std::clamp(y0 + (k >> 1), 0, h - 1);
          const float u = fx - float(x0), v = fy - float(y0);
          const float weight = ((k & 1) ? u : 1 - u) * ((k >> 1) ? v : 1 - v);
          const Model& m = means.at(px, py);
          for (int c = 0; c < kLights; ++c) {
            float sum = m.offset[c] + rest.at(px, py, c);
            for (int j = 0; j < n; ++j) sum += m.slope[c][j] * guides.at(x, y, j);
            out.at(x, y, c) += weight * sum;
          }
        }
        for (int c = 0; c < 3 && !lamps.large.empty(); ++c) out.at(x, y, c) += lamps.large.at(x, y, c);
      }
    });
    return out;
  }

  static bool small_has(const FrameWindow& in, const LayerDesc& d) { return in.in()[kFrames].has(d); }

  /// The layers that light follows which is seen by `chains`, or by any if there are no such: each scaled to about
  /// [0, 1], [h,w,n].
  static Image guides_of(const Frame& large, const std::vector<std::string>& chains) {
    struct Plane {
      const Image* image;
      int channel;
      float scale;
    };
    std::vector<Plane> planes;
    const auto add = [&](const char* name, int first, int count, float scale) {
      const Layer* layer = large.find(name);
      if (!layer || layer->image.channels() < first + count) return;
      for (int c = 0; c < count; ++c) planes.push_back({&layer->image, first + c, scale});
    };
    Image seen, facing;  // reflectance of what is seen, in mirrors and through glass, too, and its normal
    for (const std::string chain : layers::kCommonChains) {
      if (!chains.empty() && std::find(chains.begin(), chains.end(), chain) == chains.end()) continue;
      const Layer* layer = large.find(layers::chain_layer(chain, layers::albedo()).name);
      if (!layer || layer->image.channels() != 3) continue;
      if (seen.empty()) seen = Image(large.width(), large.height(), 3);
      for (std::size_t i = 0; i < seen.values().size(); ++i) seen.values()[i] += sound(layer->image.values()[i]);
      const Layer* normal = large.find(layers::chain_layer(chain, layers::normal()).name);
      if (chains.empty() || !normal || normal->image.channels() != 3) continue;
      if (facing.empty()) facing = Image(large.width(), large.height(), 3);
      for (std::int64_t i = 0; i < facing.pixels(); ++i) {
        const float* albedo = layer->image.values().data() + 3 * i;
        const float light = sound(luminance(Rgb{albedo[0], albedo[1], albedo[2]}));
        for (int c = 0; c < 3; ++c) facing.values()[3 * i + c] += light * sound(normal->image.values()[3 * i + c]);
      }
    }
    for (int c = 0; c < 3 && !seen.empty(); ++c) planes.push_back({&seen, c, 1});
    if (seen.empty()) add("albedo", 0, 3, 1);
    if (facing.empty()) add("normal", 0, 3, 0.5f);
    for (int c = 0; c < 3 && !facing.empty(); ++c) planes.push_back({&facing, c, 0.5f});
    add("color", 3, 1, 1);
    Image emission;  // luminance over its maximum
    if (const Layer* layer = large.find("emission"); layer && layer->image.channels() >= 3) {
      emission = Image(large.width(), large.height(), 1);
      float most = 0;
      for (int y = 0; y < large.height(); ++y) {
        for (int x = 0; x < large.width(); ++x) {
          emission.at(x, y) = sound(luminance(layer->image.rgb(x, y)));
          most = std::max(most, emission.at(x, y));
        }
      }
      if (most > 0) planes.push_back({&emission, 0, 1 / most});
    }
    // A guide that says nothing would only make the fit singular.
    std::erase_if(planes, [](const Plane& p) {
      const float first = p.image->at(0, 0, p.channel);
      for (std::int64_t i = 0; i < p.image->pixels(); ++i) {
        if (p.image->values()[std::size_t(i) * p.image->channels() + p.channel] != first) return false;
      }
      return true;
    });
    Image out(large.width(), large.height(), int(planes.size()));
    parallel_rows(0, large.height(), [&](int y) {
      for (int x = 0; x < large.width(); ++x) {
        for (std::size_t k = 0; k < planes.size(); ++k) {
          out.at(x, y, int(k)) = sound(planes[k].image->at(x, y, planes[k].channel) * planes[k].scale);
        }
      }
    });
    return out;
  }

  /// The model of the window around a pixel. [He 2013, Eq. 5]
  template <class Light>
  static Model fit(const Image& guide, const Light& light, int x, int y) {
    const int w = guide.width(), h = guide.height(), n = guide.channels();
    double mean_g[kMost] = {}, mean_c[kLights] = {};
    std::array<std::array<double, kMost>, kMost> gg{};
    std::array<std::array<double, kMost>, kLights> gc{};
    int count = 0;
    for (int py = std::max(0, y - kRadius); py <= std::min(h - 1, y + kRadius); ++py) {
      for (int px = std::max(0, x - kRadius); px <= std::min(w - 1, x + kRadius); ++px, ++count) {
        const float* g = guide.pixel(px, py);
        for (int c = 0; c < kLights; ++c) {
          const double v = double(light(px, py, c));
          mean_c[c] += v;
          for (int i = 0; i < n; ++i) gc[c][i] += v * double(g[i]);
        }
        for (int i = 0; i < n; ++i) {
          mean_g[i] += double(g[i]);
          for (int j = 0; j <= i; ++j) gg[i][j] += double(g[i]) * double(g[j]);
        }
      }
    }
    for (double& m : mean_g) m /= count;
    for (double& m : mean_c) m /= count;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j <= i; ++j) gg[i][j] = gg[i][j] / count - mean_g[i] * mean_g[j];
      for (int c = 0; c < kLights; ++c) gc[c][i] = gc[c][i] / count - mean_c[c] * mean_g[i];
    }
    solve(gg, gc, n);
    Model m;
    for (int c = 0; c < kLights; ++c) {
      double offset = mean_c[c];
      for (int i = 0; i < n; ++i) m.slope[c][i] = float(gc[c][i]), offset -= gc[c][i] * mean_g[i];
      m.offset[c] = float(offset);
    }
    return m;
  }

  /// The mean of the models of all windows that a pixel is in.
  static Grid<Model> mean_models(const Grid<Model>& models, int n) {
    const int w = models.width(), h = models.height();
    Grid<Model> out(w, h);
    parallel_rows(0, h, [&](int y) {
      for (int x = 0; x < w; ++x) {
        Model& sum = out.at(x, y);
        int count = 0;
        for (int py = std::max(0, y - kRadius); py <= std::min(h - 1, y + kRadius); ++py) {
          for (int px = std::max(0, x - kRadius); px <= std::min(w - 1, x + kRadius); ++px, ++count) {
            const Model& m = models.at(px, py);
            for (int c = 0; c < kLights; ++c) {
              sum.offset[c] += m.offset[c];
              for (int i = 0; i < n; ++i) sum.slope[c][i] += m.slope[c][i];
            }
          }
        }
        for (int c = 0; c < kLights; ++c) {
          sum.offset[c] /= float(count);
          for (int i = 0; i < n; ++i) sum.slope[c][i] /= float(count);
        }
      }
    });
    return out;
  }
};

}  // namespace

extern const StageEntry upsample_entry;
const StageEntry upsample_entry{
    .name = "upsample",
    .help = "frames of twice the width and height, with detail from guides of few samples",
    .command_help = "Make frames twice as wide and high, with detail from guides.",
    .done = "enlarged",
    .ports = {{"in", "clean frames"},
              {"guides", "frames twice as wide and high, rendered with few samples, with the same layers", true}},
    .output_help = "frames of the size of the guides",
    .reads = {{{"color"}, "needed: the light; of the guides, alpha"},
              {{"emission"},
               "of both: lamps that are seen, which are taken out of the light and put in at the guides' size"},
              {{"albedo", "normal", "emission"},
               "of the guides: what light follows; without any of them it is only smoothed"},
              {{"chain.*"}, "`albedo` of what is seen in mirrors and through glass, in the place of `albedo`"},
              {{"*"}, "of the guides: every layer that the frames have"}},
    .writes = {{{"color"}, "light and alpha of the frames, at the guides' size"},
               {{"*"}, "every layer of the frames: those of the guides"},
               {{"mask"},
                "pixels that are better rendered: their light came out negative, or a lamp covers them in part"}},
    .window = "the frame itself, and its guide",
    .gap_help = "each frame has a guide of its number",
    .examples = {"tempera upsample clean/ guides/ -o large/",
                 "tempera render shot.toml --mask large/f.####.exr -o pixels/f.####.exr",
                 "tempera fill large/ pixels/ -o final/"},
    .make = [](const Params&) -> std::unique_ptr<Stage> { return std::make_unique<Upsample>(); },
    .enlarges = kFactor};

}  // namespace tempera
