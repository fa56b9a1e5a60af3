// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/frame.h"

#include <fmt/format.h>

#include <algorithm>

namespace tempera {

Image& Frame::create(const LayerDesc& desc) {
  TEMPERA_ASSERT(width_ > 0 && height_ > 0);
  return add(desc, Image(width_, height_, desc.channel_count()));
}

Image& Frame::add(LayerDesc desc, Image image) {
  if (layers_.empty() && width_ == 0 && height_ == 0) width_ = image.width(), height_ = image.height();
  if (image.width() != width_ || image.height() != height_ || image.channels() != desc.channel_count()) {
    throw Error(ErrorCode::kBadInput,
                fmt::format("layer \"{}\" has {}x{} pixels and {} channels; the frame needs {}x{} and {}", desc.name,
                            image.width(), image.height(), image.channels(), width_, height_, desc.channel_count()));
  }
  for (Layer& l : layers_) {
    if (l.desc.name == desc.name) {
      l = {std::move(desc), std::move(image)};
      return l.image;
    }
  }
  return layers_.emplace_back(Layer{std::move(desc), std::move(image)}).image;
}

void Frame::remove(std::string_view name) {
  layers_.remove_if([&](const Layer& l) { return l.desc.name == name; });
}

const Layer* Frame::find(std::string_view name) const {
  for (const Layer& l : layers_) {
    if (l.desc.name == name) return &l;
  }
  return nullptr;
}

const Layer& Frame::get(std::string_view name) const {
  if (const Layer* l = find(name)) return *l;
  throw Error(ErrorCode::kUnknownName,
              fmt::format("the frame has no layer \"{}\"; it has {}", name, nearest_names(name, layer_names(), 64)));
}

const Image& Frame::layer(std::string_view name) const { return get(name).image; }
Image& Frame::layer(std::string_view name) { return const_cast<Image&>(get(name).image); }
const LayerDesc& Frame::desc(std::string_view name) const { return get(name).desc; }

std::vector<std::string> Frame::layer_names() const {
  std::vector<std::string> names;
  for (const Layer& l : layers_) names.push_back(l.desc.name);
  return names;
}

}  // namespace tempera
