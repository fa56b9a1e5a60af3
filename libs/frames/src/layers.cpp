// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/layers.h"

#include <fmt/format.h>

#include <algorithm>

namespace tempera {

std::string_view to_string(Combine combine) {
  switch (combine) {
    case Combine::kMean:
      return "mean";
    case Combine::kSum:
      return "sum";
    case Combine::kFirst:
      return "first";
    case Combine::kId:
      return "id";
    case Combine::kVariance:
      return "variance";
  }
  return "mean";
}

std::string_view to_string(LayerRole role) {
  switch (role) {
    case LayerRole::kFeature:
      return "feature";
    case LayerRole::kPicture:
      return "picture";
    case LayerRole::kStatistic:
      return "statistic";
    case LayerRole::kReconstruction:
      return "reconstruction";
    case LayerRole::kMask:
      return "mask";
  }
  return "feature";
}

std::string LayerDesc::channel_name(int c) const {
  const std::string& suffix = channels[c];
  if (name == "color") return suffix;  // plain R, G, B, A: what every viewer opens
  return suffix.empty() ? name : name + "." + suffix;
}

namespace layers {
namespace {
const std::vector<std::string> kRgba{"R", "G", "B", "A"}, kRgb{"R", "G", "B"}, kXyz{"X", "Y", "Z"};
const std::vector<std::string> kXyzv{"X", "Y", "Z", "V"};
}  // namespace

LayerDesc color() { return {"color", kRgba, units::kRadiance, Combine::kMean, LayerRole::kPicture}; }
LayerDesc color_a() { return {"color.a", kRgb, units::kRadiance, Combine::kMean, LayerRole::kStatistic}; }
LayerDesc color_b() { return {"color.b", kRgb, units::kRadiance, Combine::kMean, LayerRole::kStatistic}; }
LayerDesc color_variance() {
  return {"color.var", kRgb, units::kSquaredRadiance, Combine::kVariance, LayerRole::kStatistic};
}
LayerDesc photon_color() { return {"photon.color", kRgb, units::kRadiance, Combine::kMean, LayerRole::kStatistic}; }
LayerDesc photon_a() { return {"photon.color.a", kRgb, units::kRadiance, Combine::kMean, LayerRole::kStatistic}; }
LayerDesc photon_b() { return {"photon.color.b", kRgb, units::kRadiance, Combine::kMean, LayerRole::kStatistic}; }
LayerDesc color_common() { return {"color.common", kRgb, units::kRadiance, Combine::kMean, LayerRole::kPicture}; }
LayerDesc color_rare() { return {"color.rare", kRgb, units::kRadiance, Combine::kMean, LayerRole::kPicture}; }
LayerDesc albedo() { return {"albedo", kRgb, units::kReflectance, Combine::kMean}; }
LayerDesc normal() { return {"normal", kXyz, units::kDirection, Combine::kMean}; }
LayerDesc depth() { return {"depth", {"Z"}, units::kMeters, Combine::kFirst}; }
LayerDesc position() { return {"position", kXyz, units::kWorld, Combine::kFirst}; }
LayerDesc object_id() { return {"object_id", {"I"}, units::kId, Combine::kId}; }
LayerDesc uv() { return {"uv", {"U", "V"}, units::kTexture, Combine::kFirst}; }
LayerDesc emission() { return {"emission", kRgb, units::kRadiance, Combine::kMean}; }
LayerDesc motion_forward() { return {"motion.forward", kXyzv, units::kPixels, Combine::kFirst}; }
LayerDesc motion_backward() { return {"motion.backward", kXyzv, units::kPixels, Combine::kFirst}; }
LayerDesc motion_state() { return {"motion.state", {"F", "B"}, units::kMotionState, Combine::kId}; }
LayerDesc grad_x() { return {"grad.x", kRgb, units::kRadianceDifference, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc grad_y() { return {"grad.y", kRgb, units::kRadianceDifference, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc grad_t() { return {"grad.t", kRgb, units::kRadianceDifference, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc grad_x_variance() {
  return {"grad.x.var", kRgb, units::kSquaredRadiance, Combine::kVariance, LayerRole::kReconstruction};
}
LayerDesc grad_y_variance() {
  return {"grad.y.var", kRgb, units::kSquaredRadiance, Combine::kVariance, LayerRole::kReconstruction};
}
LayerDesc rare_color() { return {"rare.color", kRgb, units::kRadiance, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc rare_grad_x() {
  return {"rare.grad.x", kRgb, units::kRadianceDifference, Combine::kMean, LayerRole::kReconstruction};
}
LayerDesc rare_grad_y() {
  return {"rare.grad.y", kRgb, units::kRadianceDifference, Combine::kMean, LayerRole::kReconstruction};
}
LayerDesc rare_a() { return {"rare.a", kRgb, units::kRadiance, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc rare_b() { return {"rare.b", kRgb, units::kRadiance, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc held_color() { return {"held.color", kRgb, units::kRadiance, Combine::kMean, LayerRole::kReconstruction}; }
LayerDesc source() { return {"source", {"X", "Y", "V"}, units::kPixelIndex, Combine::kFirst}; }
LayerDesc samples() { return {"samples", {"N"}, units::kCount, Combine::kSum}; }
LayerDesc time() { return {"time", {"T"}, units::kSeconds, Combine::kMean}; }
LayerDesc mask() { return {"mask", {"M"}, units::kMask, Combine::kFirst, LayerRole::kMask}; }

LayerDesc crypto(int rank, std::string_view kind) {
  return {fmt::format("Crypto{}{:02d}", kind, rank), kRgba, units::kId, Combine::kId};
}

LayerDesc class_layer(std::string_view class_name, const LayerDesc& base) {
  LayerDesc d = base;
  d.name = fmt::format("class.{}.{}", class_name, base.name);
  d.path_class = class_name;
  if (base.name == "color") d.channels = kRgb;
  return d;
}

bool is_chain(std::string_view letters) {
  return !letters.empty() && letters.size() <= kMaxChain + 1 && letters.back() == 'D' &&
         letters.find_first_not_of("RT") == letters.size() - 1;
}

LayerDesc chain_layer(std::string_view letters, const LayerDesc& base) {
  LayerDesc d = base;
  d.name = fmt::format("chain.{}.{}", letters, base.name);
  d.chain = letters;
  return d;
}

const std::vector<LayerDesc>& chain_features() {
  static const std::vector<LayerDesc> list{albedo(), normal(), emission(), depth(), object_id()};
  return list;
}

const std::vector<LayerDesc>& chain_motion() {
#ifdef TEMPERA_PATH_SPACE_MOTION
  static const std::vector<LayerDesc> list{motion_forward(), motion_backward(), motion_state()};
#else
  static const std::vector<LayerDesc> list;
#endif
  return list;
}

LayerDesc offset(const LayerDesc& base) {
  LayerDesc d = base;
  d.name = "offset." + base.name;
  d.pass = "offset";
  return d;
}

LayerDesc derived(const LayerDesc& base, std::string_view suffix) {
  LayerDesc d = base;
  d.name = fmt::format("{}.{}", base.name, suffix);
  return d;
}

const std::vector<LayerDesc>& known() {
  static const std::vector<LayerDesc> list{color(),
                                           color_a(),
                                           color_b(),
                                           color_variance(),
                                           albedo(),
                                           normal(),
                                           depth(),
                                           position(),
                                           object_id(),
                                           uv(),
                                           emission(),
                                           motion_forward(),
                                           motion_backward(),
                                           grad_x(),
                                           grad_y(),
                                           grad_t(),
                                           grad_x_variance(),
                                           grad_y_variance(),
                                           source(),
                                           samples(),
                                           time(),
                                           photon_color(),
                                           photon_a(),
                                           photon_b(),
                                           color_common(),
                                           color_rare(),
                                           rare_color(),
                                           rare_grad_x(),
                                           rare_grad_y(),
                                           rare_a(),
                                           rare_b(),
                                           held_color(),
                                           mask()};
  return list;
}

std::optional<LayerDesc> find(std::string_view name) {
  for (const LayerDesc& d : known()) {
    if (d.name == name) return d;
  }
  if (name.starts_with("offset.")) {
    if (const auto base = find(name.substr(7)); base && !name.substr(7).starts_with("offset.")) return offset(*base);
    return std::nullopt;
  }
  if (name.starts_with("chain.")) {
    const std::string_view rest = name.substr(6);
    const auto dot = std::min(rest.find('.'), rest.size());
    const std::string_view letters = rest.substr(0, dot);
    if (!is_chain(letters) && letters != kAnyChain) return std::nullopt;
    for (const std::vector<LayerDesc>* list : {&chain_features(), &chain_motion()}) {
      if (list == &chain_motion() && letters == kAnyChain) break;  // nothing moves as all together
      for (const LayerDesc& d : *list) {
        if (d.name == rest.substr(std::min(dot + 1, rest.size()))) return chain_layer(letters, d);
      }
    }
    return std::nullopt;
  }
  if (name.starts_with("class.")) {
    const std::string_view rest = name.substr(6);
    const auto dot = rest.find('.');
    if (dot == std::string_view::npos || dot == 0) return std::nullopt;
    const std::string_view class_name = rest.substr(0, dot), layer = rest.substr(dot + 1);
    const bool valid = std::all_of(class_name.begin(), class_name.end(),
                                   [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-'; });
    if (!valid) return std::nullopt;
    if (layer == "reflectance") {  // demodulation divisor of a class: product of the colors at its specular vertices
      return class_layer(class_name, {"reflectance", kRgb, units::kReflectance, Combine::kMean});
    }
    for (const LayerDesc& d : known()) {
      if (d.name == layer) return class_layer(class_name, d);
    }
    return std::nullopt;
  }
  if (name.starts_with("Crypto") && name.size() > 8) {
    const auto rank = name.substr(name.size() - 2), kind = name.substr(6, name.size() - 8);
    if (std::isdigit(static_cast<unsigned char>(rank[0])) && std::isdigit(static_cast<unsigned char>(rank[1]))) {
      return crypto((rank[0] - '0') * 10 + rank[1] - '0', kind);
    }
  }
  return std::nullopt;
}
}  // namespace layers

namespace {

/// Whether a name is that of motion of chains, of one or of all.
bool is_chain_motion(std::string_view name) {
  if (name == "chain_motion") return true;
  if (!name.starts_with("chain.")) return false;
  const std::string_view rest = name.substr(6);
  const auto dot = std::min(rest.find('.'), rest.size());
  return layers::is_chain(rest.substr(0, dot)) &&
         (rest.substr(dot) == ".motion" || rest.substr(dot).starts_with(".motion."));
}

}  // namespace

std::vector<LayerDesc> parse_layer_names(std::string_view text, const SourceLoc& loc) {
  std::vector<LayerDesc> result;
  const auto add = [&](LayerDesc d) {
    if (std::find(result.begin(), result.end(), d) == result.end()) result.push_back(std::move(d));
  };
  while (!text.empty()) {
    const auto comma = text.find(',');
    std::string_view name = text.substr(0, comma);
    text = comma == std::string_view::npos ? std::string_view{} : text.substr(comma + 1);
    while (!name.empty() && std::isspace(static_cast<unsigned char>(name.front()))) name.remove_prefix(1);
    while (!name.empty() && std::isspace(static_cast<unsigned char>(name.back()))) name.remove_suffix(1);
    if (name.empty()) continue;
    const auto add_chain = [&](std::string_view letters, const std::vector<LayerDesc>& what) {
      for (const LayerDesc& d : what) add(layers::chain_layer(letters, d));
    };
    if (layers::chain_motion().empty() && is_chain_motion(name)) {
      throw Error(ErrorCode::kUnsupported, loc,
                  fmt::format("the layer \"{}\" is of a part that this program was built without; building it with "
                              "-DTEMPERA_PATH_SPACE_MOTION=ON adds it",
                              name));
    }
    const std::string_view letters = name.starts_with("chain.") ? name.substr(6) : "",
                           moving = letters.substr(0, letters.find('.'));
    if (layers::is_chain(letters) || letters == layers::kAnyChain) {
      add_chain(letters, layers::chain_features());
    } else if (layers::is_chain(moving) && letters.substr(moving.size()) == ".motion") {
      add_chain(moving, layers::chain_motion());
    } else if (name == "motion") {
      add(layers::motion_forward()), add(layers::motion_backward());
    } else if (name == "halves") {
      add(layers::color_a()), add(layers::color_b());
    } else if (name == "chains") {
      for (const char* chain : layers::kCommonChains) add_chain(chain, layers::chain_features());
    } else if (name == "chain_motion") {
      for (const char* chain : layers::kCommonChains) {
        if (std::string_view(chain) != "D") add_chain(chain, layers::chain_motion());  // "motion" has that
      }
    } else if (name == "cryptomatte") {
      for (int rank = 0; rank < 3; ++rank) add(layers::crypto(rank));
    } else if (auto d = layers::find(name)) {
      add(std::move(*d));
    } else {
      std::vector<std::string> names{"motion",          "halves",
                                     "cryptomatte",     "chains",
                                     "chain.<letters>", "class.<name>.color",
                                     "offset.<layer>",  "chain.<letters>.<feature>"};
      if (!layers::chain_motion().empty()) {
        for (const char* more : {"chain_motion", "chain.<letters>.motion"}) names.push_back(more);
      }
      for (const LayerDesc& k : layers::known()) names.push_back(k.name);
      const std::size_t all = names.size();
      throw Error(ErrorCode::kUnknownName, loc,
                  fmt::format("unknown layer \"{}\"; known: {}", name, nearest_names(name, std::move(names), all)));
    }
  }
  return result;
}

}  // namespace tempera
