// SPDX-License-Identifier: Apache-2.0
#include "denoise/input.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "decomposition.h"

namespace tempera::denoise {

namespace {
constexpr float kMost = 1e14f;  ///< of any value: filters square differences of what they divide by reflectances
}  // namespace

std::vector<ClassView> class_views(const Available& available, const Metadata& metadata) {
  const std::vector<ClassInfo> known = classes(metadata);
  std::vector<ClassView> out;
  for (const std::string& name : available.classes) {
    const auto found = std::find_if(known.begin(), known.end(), [&](const ClassInfo& c) { return c.name == name; });
    ClassView view{.name = name};
    if (found != known.end()) {
      for (const std::string& chain : found->chains) {
        if (std::find(available.chains.begin(), available.chains.end(), chain) != available.chains.end())
          view.chains.push_back(chain);
      }
      view.emission = is_emission(*found);
    }
    // Without features of its own, light that the first surface scatters goes by that surface.
    const bool first_scatters = found == known.end() || found->chains == std::vector<std::string>{"D"};
    view.divide = first_scatters || !view.chains.empty();
    out.push_back(std::move(view));
  }
  return out;
}

std::optional<int> samples_of(const Metadata& metadata) {
  const auto spp = metadata.find("tempera/spp");
  const int* n = spp == metadata.end() ? nullptr : std::get_if<int>(&spp->second);
  return n ? std::optional(*n) : std::nullopt;
}

InputFrame::InputFrame(StageRun& run, int frame, const std::function<bool(const LayerDesc&)>& wanted)
    : run_(run), number_(frame), frame_(run.read(frame, 0, wanted)) {}

const Image* InputFrame::image(const LayerDesc& layer, int channels) const {
  if (!run_.in()[0].has(layer)) return nullptr;
  const Layer* l = frame_.find(layer.name);
  const int n = l ? l->image.channels() : 0;
  if (n >= channels) return &l->image;
  throw Error(ErrorCode::kBadInput,
              fmt::format("{}: layer \"{}\" {}; denoising needs it with {} channels in every frame, or in none",
                          run_.path(number_), layer.name,
                          l ? fmt::format("has {} channel{}", n, n == 1 ? "" : "s") : "is missing", channels));
}

Planes InputFrame::planes(const LayerDesc& layer, int channels) {
  const Image* in = image(layer, channels);
  if (!in) return {};
  Planes out(*in, channels);
  for (float& v : out.values()) {
    if (!(std::abs(v) <= kMost)) v = 0, ++damaged_;
  }
  return out;
}

Planes InputFrame::take(const LayerDesc& layer, int channels) {
  Planes out = planes(layer, channels);
  if (frame_.has(layer.name)) frame_.remove(layer.name);
  return out;
}

Planes InputFrame::vectors(const LayerDesc& layer) const {
  const Image* motion = image(layer, 2);
  if (!motion) return {};
  Planes out(motion->width(), motion->height(), 2);
  const int valid = motion->channels() >= 4 ? 3 : -1;  // files of others do not say what is valid
  for_rows(out.height(), [&](int y) {
    for (int x = 0; x < out.width(); ++x) {
      const float* p = motion->pixel(x, y);
      const bool known = std::isfinite(p[0]) && std::isfinite(p[1]) && (valid < 0 || p[valid] > 0);
      for (int c = 0; c < 2; ++c) out.row(c, y)[x] = known ? p[c] : kNowhere;
    }
  });
  return out;
}

ChainView InputFrame::chains(std::span<const std::string> chains) {
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  ChainView sum{Planes(width, height, 3), Planes(width, height, 3)};
  const auto light = [](const Planes& albedo, int y, int x) {
    return luminance(albedo.row(0, y)[x], albedo.row(1, y)[x], albedo.row(2, y)[x]);
  };
  for (const std::string& chain : chains) {
    const Planes albedo = planes(layers::chain_layer(chain, layers::albedo()), 3),
                 normal = planes(layers::chain_layer(chain, layers::normal()), 3);
    for_rows(height, [&](int y) {
      for (int c = 0; c < 3; ++c) {
        for (int x = 0; x < width; ++x) {
          sum.albedo.row(c, y)[x] += albedo.row(c, y)[x];
          sum.normal.row(c, y)[x] += normal.row(c, y)[x] * light(albedo, y, x);
        }
      }
    });
  }
  for_rows(height, [&](int y) {
    for (int c = 0; c < 3; ++c) {
      for (int x = 0; x < width; ++x) sum.normal.row(c, y)[x] /= std::max(light(sum.albedo, y, x), 1e-6f);
    }
  });
  return sum;
}

Surfaces InputFrame::moving(Surfaces first, std::span<const std::string> chains) {
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  Planes most(width, height, 1);
  for (const std::string& chain : chains) {
    const auto layer = [&](const LayerDesc& d) { return layers::chain_layer(chain, d); };
    const Planes albedo = planes(layer(layers::albedo()), 3), forward = vectors(layer(layers::motion_forward())),
                 backward = vectors(layer(layers::motion_backward()));
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        const float light = luminance(albedo.row(0, y)[x], albedo.row(1, y)[x], albedo.row(2, y)[x]);
        if (!(light > most.row(0, y)[x])) continue;
        most.row(0, y)[x] = light;
        for (const auto& [to, from] : {std::pair{&first.forward, &forward}, {&first.backward, &backward}}) {
          if (from->row(0, y)[x] == kNowhere) continue;
          for (int c = 0; c < 2; ++c) to->row(c, y)[x] = from->row(c, y)[x];
        }
      }
    });
  }
  return first;
}

std::array<Planes, 2> centred_halves(const Planes& all, const Planes& a, const Planes& b) {
  std::array<Planes, 2> out{all, all};
  for (std::size_t i = 0; i < all.values().size(); ++i) {
    const float d = 0.5f * (a.values()[i] - b.values()[i]);
    out[0].values()[i] += d, out[1].values()[i] -= d;
  }
  return out;
}

}  // namespace tempera::denoise
