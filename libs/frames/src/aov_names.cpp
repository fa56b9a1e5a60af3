// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/aov_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <set>

namespace tempera {
namespace {

/// A layer under another program's name. `channels` replaces our suffixes one by one; an empty text means the name
/// alone.
struct Alias {
  const char* ours;
  const char* theirs;
  std::vector<std::string> channels;
};

const std::vector<std::string> kRgba{"R", "G", "B", "A"}, kRgb{"R", "G", "B"}, kXyz{"X", "Y", "Z"};
const std::vector<std::string> kLowRgb{"r", "g", "b"};

/// A pass of Blender that shows a layer of ours.
struct BlenderPass {
  const char* ours;
  const char* theirs;
  struct Channel {
    const char* suffix;
    int ours;  ///< channel of our layer
    AovValue value{};
  };
  std::vector<Channel> channels;
  const char* unit = nullptr;  ///< where it is not that of our layer
};

const std::vector<BlenderPass>& blender_passes() {
  constexpr float kNothing = 1e10f;  // the depth of the background
  // y is up for us, z for Blender: its (x, y, z) is our (x, -z, y).
  const std::vector<BlenderPass::Channel> rgb{{"R", 0}, {"G", 1}, {"B", 2}},
      rgba{{"R", 0}, {"G", 1}, {"B", 2}, {"A", 3}}, z_up{{"X", 0}, {"Y", 2, {-1}}, {"Z", 1}};
  // The names of Blender 5 (checked with files that Cycles of 5.2.3 wrote). Earlier rows win over later ones; only the
  // first row of a layer is written.
  static const std::vector<BlenderPass> passes{
      {"color", "Combined", rgba},
      {"albedo", "Denoising Albedo", rgb},
      {"normal", "Normal", z_up},
      {"depth", "Depth", {{"Z", 0, {1, 0, kNothing}}}},
      {"position", "Position", z_up},
      {"object_id", "Object Index", {{"X", 0}}},
      {"uv", "UV", {{"U", 0}, {"V", 1, {-1, 1, 0.0f}}}},  // the origin of ours is at the top of the image
      {"emission", "Emission", rgb},
      // What "Denoising Data" stores: normals in camera space, whose z points away from the viewer there.
      {"normal", "Denoising Normal", {{"X", 0}, {"Y", 1}, {"Z", 2, {-1}}}, "unit vector, camera space"},
      // Blender 2.8 to 4.
      {"object_id", "IndexOB", {{"X", 0}}},
      {"emission", "Emit", rgb},
  };
  return passes;
}

const std::vector<Alias> kArnold{
    // the features that noice looks for, and Arnold's built-in AOVs
    {"color.var", "variance", kRgb}, {"albedo", "denoise_albedo", kRgb}, {"normal", "N", kXyz}, {"depth", "Z", {""}},
    {"position", "P", kXyz},
};
const std::vector<Alias> kRenderman{
    // the channels of PrmanDenoiseChannelDefine
    {"color.var", "mse", kLowRgb},
    {"albedo", "albedo", kLowRgb},
    {"normal", "normal", kLowRgb},
    {"depth", "z", {""}},
    {"motion.forward", "forward", {"x", "y"}},
    {"motion.backward", "backward", {"x", "y"}},
};
const std::vector<Alias> kPbrt{
    // GBufferFilm
    {"color.var", "Variance", kRgb},
    {"albedo", "Albedo", kRgb},
    {"normal", "Ns", kXyz},
    {"position", "P", kXyz},
};
// Further names that only reading knows. Earlier rows win over later ones.
const std::vector<Alias> kReadOnly{
    {"albedo", "diffuse_albedo", kRgb},
    {"normal", "N", kXyz},
    {"depth", "Z", {""}},
    {"color", "Ci", kRgba},
};

const std::vector<Alias>& table(AovNames names) {
  static const std::vector<Alias> none;
  switch (names) {
    case AovNames::kArnold:
      return kArnold;
    case AovNames::kRenderman:
      return kRenderman;
    case AovNames::kPbrt:
      return kPbrt;
    case AovNames::kBlender:
    case AovNames::kTempera:
      return none;
  }
  return none;
}

std::string underscored(std::string name) {
  std::replace(name.begin(), name.end(), '.', '_');
  return name;
}

std::string join(const std::string& layer, const std::string& channel) {
  return channel.empty() ? layer : layer.empty() ? channel : layer + "." + channel;
}

bool is_crypto(std::string_view name) { return name.starts_with("Crypto") && layers::find(name).has_value(); }

/// The vocabulary's layer whose name with '_' for '.' is `pass`: Blender passes cannot hold dots.
std::optional<LayerDesc> find_underscored(std::string_view pass) {
  for (const LayerDesc& d : layers::known()) {
    if (underscored(d.name) == pass) return d;
  }
  if (pass.starts_with("offset_")) {
    if (const auto base = find_underscored(pass.substr(7))) return layers::find("offset." + base->name);
  }
  if (pass.starts_with("class_")) {
    std::vector<std::string> bases{"reflectance"};
    for (const LayerDesc& d : layers::known()) bases.push_back(d.name);
    std::sort(bases.begin(), bases.end(), [](auto& a, auto& b) { return a.size() > b.size(); });
    for (const std::string& base : bases) {
      const std::string tail = "_" + underscored(base);
      if (pass.ends_with(tail) && pass.size() > 6 + tail.size()) {
        return layers::find(fmt::format("class.{}.{}", pass.substr(6, pass.size() - 6 - tail.size()), base));
      }
    }
  }
  return std::nullopt;
}

/// Position of a suffix among the usual ones, so that a layer's channels come out as R,G,B,A, X,Y,Z,W or U,V,A.
int channel_rank(const std::string& suffix) {
  static const std::array<const char*, 14> order{"r", "g", "b", "red", "green", "blue", "x",
                                                 "y", "z", "w", "u",   "v",     "a",    "alpha"};
  std::string low = suffix;
  std::transform(low.begin(), low.end(), low.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  const auto it = std::find(order.begin(), order.end(), low);
  return int(it - order.begin());
}

/// A layer as the file has it.
struct RawLayer {
  std::string name;  ///< "" for plain R, G, B, A, Y
  std::vector<std::pair<std::string, int>> channels;
  std::optional<LayerDesc> known;
};

/// The descriptor of one of our layers for the `count` channels that a foreign layer has of it.
LayerSource foreign_layer(LayerDesc desc, const RawLayer& raw) {
  LayerSource s{std::move(desc), {}};
  const std::size_t n = std::min(s.desc.channels.size(), raw.channels.size());
  s.desc.channels.resize(n);
  for (std::size_t i = 0; i < n; ++i) s.channels.push_back({raw.channels[i].second});
  return s;
}

/// Our layer of what a file holds of a pass of Blender. Channels are found by their names; where a program calls them
/// otherwise (Depth.V), by their order.
LayerSource from_blender(const BlenderPass& pass, const RawLayer& raw) {
  LayerSource s = foreign_layer(*layers::find(pass.ours), raw);
  if (pass.unit) s.desc.unit = pass.unit;
  for (std::size_t i = 0; i < pass.channels.size() && i < raw.channels.size(); ++i) {
    const BlenderPass::Channel& c = pass.channels[i];
    const auto named =
        std::find_if(raw.channels.begin(), raw.channels.end(), [&](auto& r) { return r.first == c.suffix; });
    const int from = named != raw.channels.end() ? named->second : raw.channels[i].second;
    if (c.ours < std::ssize(s.channels)) s.channels[c.ours] = {from, c.value};
  }
  return s;
}

bool is_plain_color(const std::string& channel) {
  static const std::set<std::string> plain{"R", "G", "B", "A", "Y", "r", "g", "b", "a"};
  return plain.contains(channel);
}
}  // namespace

AovNames parse_aov_names(std::string_view text) {
  static const std::map<std::string, AovNames, std::less<>> all{{"tempera", AovNames::kTempera},
                                                                {"blender", AovNames::kBlender},
                                                                {"arnold", AovNames::kArnold},
                                                                {"renderman", AovNames::kRenderman},
                                                                {"pbrt", AovNames::kPbrt}};
  if (const auto it = all.find(text); it != all.end()) return it->second;
  throw Error(ErrorCode::kUnknownName,
              fmt::format("unknown AOV names \"{}\"; known: tempera, blender, arnold, renderman, pbrt", text));
}

namespace {
std::vector<AovChannel> blender_channels(const std::vector<LayerDesc>& layers, const std::string& view_layer) {
  std::vector<AovChannel> out;
  const LayerDesc *color = nullptr, *forward = nullptr, *backward = nullptr;
  const auto add = [&](const std::string& pass, const std::string& channel, const LayerDesc& d, int c,
                       const AovValue& value = {}) {
    out.push_back({fmt::format("{}.{}.{}", view_layer, pass, channel), d.name, c, value});
  };
  for (const LayerDesc& d : layers) {
    if (d.name == "color" && d.channel_count() == 4) color = &d;
    if (d.name == "motion.forward" && d.channel_count() >= 2) forward = &d;
    if (d.name == "motion.backward" && d.channel_count() >= 2) backward = &d;
  }
  for (const LayerDesc& d : layers) {
    const auto& passes = blender_passes();
    const auto pass =
        std::find_if(passes.begin(), passes.end(), [&](const BlenderPass& p) { return d.name == p.ours; });
    if (pass == passes.end()) {
      // Its reader splits at the last two dots: <view layer>.<pass>.<channel>.
      for (int c = 0; c < d.channel_count(); ++c) {
        std::string suffix = d.channels[c];
        if (is_crypto(d.name)) suffix[0] = char(std::tolower(static_cast<unsigned char>(suffix[0])));  // r, g, b, a
        add(underscored(d.name), suffix.empty() ? "X" : suffix, d, c);
      }
      continue;
    }
    for (const BlenderPass::Channel& c : pass->channels) {
      if (c.ours < d.channel_count()) add(pass->theirs, c.suffix, d, c.ours, c.value);
    }
    if (d.name == "uv" && color) add(pass->theirs, "A", *color, 3);  // where there is a surface
  }
  if (forward && backward) {
    // X, Y: previous - current; Z, W: current - next; y points up.
    add("Vector", "X", *backward, 0), add("Vector", "Y", *backward, 1, {-1});
    add("Vector", "Z", *forward, 0, {-1}), add("Vector", "W", *forward, 1);
  }
  return out;
}
/// The layers of a file by the names of its channels, in the order of their first ones, each with its channels in their
/// usual order.
std::vector<RawLayer> raw_layers(const std::vector<std::string>& names) {
  std::vector<RawLayer> raw;
  const auto raw_layer = [&](const std::string& name) -> RawLayer& {
    for (RawLayer& l : raw) {
      if (l.name == name) return l;
    }
    return raw.emplace_back(RawLayer{name, {}, std::nullopt});
  };
  for (int i = 0; i < std::ssize(names); ++i) {
    const std::string& name = names[i];
    const auto dot = name.rfind('.');
    if (dot != std::string::npos && dot > 0) {
      raw_layer(name.substr(0, dot)).channels.push_back({name.substr(dot + 1), i});
    } else if (is_plain_color(name)) {
      raw_layer("").channels.push_back({name, i});
    } else {
      raw_layer(name).channels.push_back({"", i});
    }
  }
  for (RawLayer& l : raw) {
    l.known = layers::find(l.name.empty() ? "color" : l.name);
    const auto rank = [&](const std::string& suffix) {
      if (l.name.empty() && suffix == "Y") return -1;  // gray comes before its alpha
      if (l.known) {                                   // a layer of ours keeps the order of the vocabulary
        const auto& c = l.known->channels;
        const auto it = std::find(c.begin(), c.end(), suffix);
        if (it != c.end()) return int(it - c.begin());
      }
      return 100 + channel_rank(suffix);
    };
    std::stable_sort(l.channels.begin(), l.channels.end(), [&](const auto& a, const auto& b) {
      const int ra = rank(a.first), rb = rank(b.first);
      return ra != rb ? ra < rb : a.first < b.first;
    });
  }
  return raw;
}

/// Our layers of what other programs call otherwise. What claims a layer or one of our names first keeps it.
class Translation {
 public:
  explicit Translation(const std::vector<RawLayer>& raw) : raw_(raw) {
    for (const RawLayer& l : raw) taken_.insert(l.name.empty() ? "color" : l.name);
    claim_small_letters();
    claim_passes();
    claim_vectors();
    claim_aliases();
    claim_uv();
  }
  /// What a layer is translated to, which may be nothing; null if it is not.
  const std::vector<LayerSource>* of(const RawLayer& l) const {
    const auto it = translated_.find(&l);
    return it == translated_.end() ? nullptr : &it->second;
  }

 private:
  const RawLayer* by_name(const std::string& name) const {
    for (const RawLayer& l : raw_) {
      if (l.name == name) return &l;
    }
    return nullptr;
  }
  void claim(const RawLayer& l, LayerSource source) {
    if (of(l) || !taken_.insert(source.desc.name).second) return;
    translated_[&l].push_back(std::move(source));
  }
  void claim(const RawLayer& l, LayerDesc desc) { claim(l, foreign_layer(std::move(desc), l)); }

  /// RenderMan writes our very names of these with small letters, which makes them neither known nor foreign.
  void claim_small_letters() {
    for (const RawLayer& l : raw_) {
      if (l.known && std::none_of(l.channels.begin(), l.channels.end(), [&](const auto& c) {
            return std::find(l.known->channels.begin(), l.known->channels.end(), c.first) != l.known->channels.end();
          })) {
        taken_.erase(l.name.empty() ? "color" : l.name);
        claim(l, *l.known);
      }
    }
  }

  /// "<view layer>.<pass>", the passes that are told best first.
  void claim_passes() {
    const auto pass_of = [](const RawLayer& l) {
      const auto dot = l.name.rfind('.');
      return l.known || dot == std::string::npos ? "" : l.name.substr(dot + 1);
    };
    for (const BlenderPass& p : blender_passes()) {
      // What the compositor made of a view layer is not what its other passes are of.
      for (const bool composite : {false, true}) {
        for (const RawLayer& l : raw_) {
          if (pass_of(l) == p.theirs && l.name.starts_with("Composite.") == composite) claim(l, from_blender(p, l));
        }
      }
    }
    for (const RawLayer& l : raw_) {
      const std::string pass = pass_of(l);
      if (pass.empty()) continue;
      if (is_crypto(pass)) claim(l, *layers::find(pass));
      if (const auto d = find_underscored(pass)) claim(l, *d);
    }
  }

  /// Blender's vectors, unless our own are there.
  void claim_vectors() {
    for (const RawLayer& l : raw_) {
      if (!l.name.ends_with(".Vector") || l.channels.size() != 4) continue;
      if (taken_.contains("motion.forward") || taken_.contains("motion.backward")) {
        if (taken_.contains("motion.forward") && taken_.contains("motion.backward"))
          translated_[&l];  // an alias of them
        continue;
      }
      LayerSource backward{layers::motion_backward(), {{l.channels[0].second}, {l.channels[1].second, {-1}}}};
      LayerSource forward{layers::motion_forward(), {{l.channels[2].second, {-1}}, {l.channels[3].second}}};
      for (LayerSource* s : {&forward, &backward}) {
        s->desc.channels = {"X", "Y"};
        taken_.insert(s->desc.name);
        translated_[&l].push_back(*s);
      }
    }
  }

  void claim_aliases() {
    for (const auto* t : {&kPbrt, &kArnold, &kRenderman, &kReadOnly}) {
      for (const Alias& a : *t) {
        const RawLayer* l = by_name(a.theirs);
        if (l && !l->known && l->channels.size() >= a.channels.size()) claim(*l, *layers::find(a.ours));
      }
    }
    for (const RawLayer& l : raw_) {
      if (l.name.starts_with("crypto_object") && is_crypto("CryptoObject" + l.name.substr(13))) {
        claim(l, *layers::find("CryptoObject" + l.name.substr(13)));
      }
    }
  }

  void claim_uv() {
    const RawLayer* u = by_name("u");
    const RawLayer* v = by_name("v");
    if (u && v && u->channels.size() == 1 && v->channels.size() == 1 && taken_.insert("uv").second) {
      translated_[u].push_back({layers::uv(), {{u->channels[0].second}, {v->channels[0].second}}});
      translated_[v];  // is in the one of u
    }
  }

  const std::vector<RawLayer>& raw_;
  std::set<std::string> taken_;  ///< names that layers of the file have already
  std::map<const RawLayer*, std::vector<LayerSource>> translated_;
};

/// A layer under the name that it has in the file.
LayerSource as_it_is(const RawLayer& l) {
  LayerSource s;
  if (l.known) {
    s.desc = *l.known;
    s.desc.channels.clear();
  } else {
    s.desc.name = l.name;
    s.desc.combine = l.name.find("rypto") == std::string::npos ? Combine::kMean : Combine::kId;
  }
  for (const auto& [suffix, index] : l.channels) {
    s.desc.channels.push_back(suffix);
    s.channels.push_back({index});
  }
  return s;
}

}  // namespace

std::vector<AovChannel> aov_channels(const std::vector<LayerDesc>& layers, AovNames names,
                                     const std::string& view_layer) {
  if (names == AovNames::kBlender) return blender_channels(layers, view_layer);
  std::vector<AovChannel> out;
  for (const LayerDesc& d : layers) {
    const Alias* alias = nullptr;
    for (const Alias& a : table(names)) {
      if (d.name == a.ours) alias = &a;
    }
    if (alias) {
      // A layer may hold fewer channels than ours usually has; it never has more of those with a name there.
      const int n = std::min(d.channel_count(), int(alias->channels.size()));
      for (int c = 0; c < n; ++c) out.push_back({join(alias->theirs, alias->channels[c]), d.name, c});
      continue;
    }
    for (int c = 0; c < d.channel_count(); ++c) {
      std::string name = d.channel_name(c);
      if (names == AovNames::kArnold && d.name.starts_with("CryptoObject")) {
        name = join("crypto_object" + d.name.substr(12), d.channels[c]);
      } else if (names == AovNames::kPbrt && d.name == "uv") {
        name = c == 0 ? "u" : "v";
      }
      out.push_back({std::move(name), d.name, c});
    }
  }
  return out;
}

std::string describe_aov_names(const std::vector<LayerDesc>& layers, AovNames names, const std::string& view_layer) {
  std::vector<std::pair<std::string, std::vector<std::string>>> lines;
  for (const AovChannel& c : aov_channels(layers, names, view_layer)) {
    const auto dot = c.name.rfind('.');
    const std::string layer = dot == std::string::npos ? "" : c.name.substr(0, dot);
    const std::string key = c.source + " -> " + layer;
    if (lines.empty() || lines.back().first != key) lines.push_back({key, {}});
    lines.back().second.push_back(dot == std::string::npos ? c.name : c.name.substr(dot + 1));
  }
  std::string text;
  for (const auto& [key, channels] : lines) {
    const std::string list = fmt::format("{}", fmt::join(channels, ","));
    text += key;
    if (!key.ends_with(' ')) text += '.';
    text += channels.size() > 1 ? "{" + list + "}\n" : list + "\n";
  }
  return text;
}

std::vector<LayerSource> layers_of_channels(const std::vector<std::string>& names, bool translate) {
  const std::vector<RawLayer> raw = raw_layers(names);
  std::optional<Translation> translation;
  if (translate) translation.emplace(raw);
  std::vector<LayerSource> out;
  for (const RawLayer& l : raw) {
    if (const auto* translated = translation ? translation->of(l) : nullptr)
      out.insert(out.end(), translated->begin(), translated->end());
    else
      out.push_back(as_it_is(l));
  }
  return out;
}

}  // namespace tempera
