// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/chain_features.h"

#include <algorithm>

namespace tempera {

namespace {

/// Of light that may still come by any chain: less is not worth following, as where a coat adds to a base what it scatters.
constexpr float kLeastPart = 0.01f;

std::vector<std::string> chains_of(const Frame* out) {
  std::vector<std::string> chains;
  if (!out) return chains;
  for (const Layer& l : out->layers()) {
    const std::string& chain = l.desc.chain;
    if (chain.empty() || std::find(chains.begin(), chains.end(), chain) != chains.end()) continue;
    const auto is_this = [&](const LayerDesc& d) { return l.desc == layers::chain_layer(chain, d); };
    if (std::any_of(layers::chain_features().begin(), layers::chain_features().end(), is_this)) chains.push_back(chain);
  }
  return chains;
}

}  // namespace

ChainFeatures::ChainFeatures(std::vector<std::string> chains) : names_(std::move(chains)), hits_(names_.size()) {
  for (const std::string& name : names_) {
    if (name == layers::kAnyChain) {
      any_ = int(codes_.size());
      codes_.push_back(0);  // that of no chain
      continue;
    }
    TEMPERA_ASSERT(layers::is_chain(name));
    Code code = 1;
    prefixes_.push_back(code);
    for (const char letter : name.substr(0, name.size() - 1)) {
      code = code * 2 + (letter == 'T' ? 1 : 0);
      prefixes_.push_back(code);
    }
    codes_.push_back(code);
  }
  std::sort(prefixes_.begin(), prefixes_.end());
  prefixes_.erase(std::unique(prefixes_.begin(), prefixes_.end()), prefixes_.end());
}

int ChainFeatures::find(Code code) const {
  const auto at = std::find(codes_.begin(), codes_.end(), code);
  return at == codes_.end() ? -1 : int(at - codes_.begin());
}

void ChainFeatures::start() {
  std::fill(hits_.begin(), hits_.end(), ChainHit{});
  shares_.clear();
  if (!prefixes_.empty()) shares_.push({1, Rgb(1.0f)});
  any_part_ = Rgb(any_ < 0 ? 0.0f : 1.0f);
  depth_ = 0, events_ = 0;
}

void ChainFeatures::leave(const Rgb& beta) {
  if (!is_black(any_part_) && events_ > 0) add_any({.albedo = beta * any_part_});
  any_part_ = Rgb(0.0f);
}

void ChainFeatures::add_any(ChainHit hit) {
  ChainHit& sum = hits_[std::size_t(any_)];
  hit.weight = luminance(hit.albedo);
  sum.emission += hit.emission;
  if (!(hit.weight > 0)) return;
  if (hit.weight > sum.weight) sum.instance = hit.instance;
  sum.albedo += hit.albedo;
  sum.weight += hit.weight;
  const float share = hit.weight / sum.weight;
  sum.normal = sum.normal * (1 - share) + hit.normal * share;
  sum.depth += (hit.depth - sum.depth) * share;
}

void ChainFeatures::scatter(const std::array<Rgb, kEventCount>& f) {
  const Rgb sum = f[0] + f[1] + f[2];
  const Rgb& diffuse = f[std::size_t(Event::kDiffuse)];
  for (int c = 0; c < 3; ++c) any_part_[c] *= sum[c] > 0 ? 1 - diffuse[c] / sum[c] : 0;
  if (++events_ > layers::kMaxChain || max_component(any_part_) < kLeastPart) any_part_ = Rgb(0.0f);
  if (shares_.size() == 0) return;
  const auto before = shares_;
  shares_.clear();
  for (const Share& s : before) {
    for (const Event e : {Event::kReflection, Event::kTransmission}) {
      const Rgb& event = f[std::size_t(e)];
      const Code code = s.code * 2 + (e == Event::kTransmission ? 1 : 0);
      if (is_black(event) || !std::binary_search(prefixes_.begin(), prefixes_.end(), code)) continue;
      Rgb part;
      for (int c = 0; c < 3; ++c) part[c] = sum[c] > 0 ? s.part[c] * event[c] / sum[c] : 0;
      shares_.push({code, part});
    }
  }
}

ChainFilm::ChainFilm(const Frame* out, int width, int height)
    : features_(chains_of(out)),
      width_(width),
      sums_(std::size_t(width) * std::size_t(height) * features_.chains().size()) {}

void ChainFilm::add(std::size_t i, float weight) {
  Sums* sums = sums_.data() + i * features_.chains().size();
  for (const ChainHit& hit : features_.hits()) {
    Sums& s = *sums++;
    if (!(hit.weight > 0)) continue;
    s.albedo += hit.albedo * weight;
    s.emission += hit.emission * weight;
    s.normal += hit.normal * hit.weight;
    s.depth += hit.depth * hit.weight;
    s.weight += hit.weight;
    if (hit.weight > s.largest) s.largest = hit.weight, s.instance = hit.instance;
  }
}

void ChainFilm::write(Frame& out, int left, int top, const std::function<int(std::size_t)>& count) const {
  const std::size_t n = features_.chains().size();
  for (std::size_t k = 0; k < n; ++k) {
    const auto layer = [&](const LayerDesc& d) {
      const std::string name = layers::chain_layer(features_.chains()[k], d).name;
      return out.has(name) ? &out.layer(name) : nullptr;
    };
    Image *albedo = layer(layers::albedo()), *emission = layer(layers::emission()), *normal = layer(layers::normal()),
          *depth = layer(layers::depth()), *object = layer(layers::object_id());
    for (std::size_t i = 0; i * n < sums_.size(); ++i) {
      const Sums& s = sums_[i * n + k];
      const int x = left + int(i) % width_, y = top + int(i) / width_;
      const float inv = 1 / float(std::max(count(i), 1)), inv_weight = s.weight > 0 ? 1 / s.weight : 0;
      if (albedo) albedo->set_rgb(x, y, s.albedo * inv);
      if (emission) emission->set_rgb(x, y, s.emission * inv);
      if (normal) normal->set_vec3(x, y, s.normal * inv_weight);
      if (depth) depth->at(x, y) = s.depth * inv_weight;
      if (object) object->at(x, y) = s.weight > 0 ? float(s.instance) + 1 : 0;
    }
  }
}

}  // namespace tempera
