// SPDX-License-Identifier: Apache-2.0
#include "gltf_animation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tempera {
namespace {

constexpr double kMaxTime = 1e9;    // seconds; what lies beyond is damage, and no one's thirty years
constexpr float kMaxValue = 1e30f;  // as for values at rest

/// An error's message without the JSON pointer before it: one warning for all channels with the same fault.
std::string without_pointer(const std::string& message) {
  const std::size_t end = message.find(": ");
  return message.starts_with('/') && end != message.npos ? message.substr(end + 2) : message;
}

/// Calls `f`, and passes what is wrong with its part of the file to `complain` (message, place).
template <class F, class Complain>
void forgive(F f, Complain complain) {
  try {
    f();
  } catch (const Error& e) {
    if (e.code() == ErrorCode::kOutOfMemory) throw;
    complain("animation channels that cannot be understood are ignored: " + without_pointer(e.message()), e.loc());
  }
}

/// "translation", "rotation", "scale" or "weights" if that is what a pointer names.
std::string node_path(const std::string& pointer) {
  if (!pointer.starts_with("/nodes/") && !pointer.starts_with("/meshes/")) return {};
  const std::string last = pointer.substr(pointer.rfind('/') + 1);
  return std::count(pointer.begin(), pointer.end(), '/') == 3 &&
                 (last == "translation" || last == "rotation" || last == "scale" || last == "weights")
             ? last
             : "";
}

}  // namespace

GltfAnimations::GltfAnimations(const GltfDocument& document, const std::string& name) : document_(document) {
  const Json list = document.list("animations");
  if (list && list.size() == 0) document.warn("an empty list of animations is no valid glTF", list);
  for (std::size_t i = 0; i < list.size(); ++i) {
    names_.emplace_back(list.at(i)["name"].string());
    if (names_.back().empty()) names_.back() = std::to_string(i);
  }
  if (name == "none") return;
  if (!name.empty()) {
    auto found = std::find(names_.begin(), names_.end(), name);
    if (found == names_.end() && name.find_first_not_of("0123456789") == name.npos && name.size() < 9 &&
        std::stoul(name) < names_.size())
      found = names_.begin() + std::ptrdiff_t(std::stoul(name));
    if (found == names_.end()) {
      const std::string known = names_.empty() ? "the file has no animations" : "known: " + nearest_names(name, names_);
      throw Error(ErrorCode::kUnknownName, list ? list.loc() : SourceLoc{document_.file().string()},
                  fmt::format("no animation \"{}\"; {}", name, known));
    }
    play(read_clip(list.at(found - names_.begin())));
    return;
  }
  // A clip plays as a whole or not at all: a walk whose feet run is worse than no run.
  std::set<std::string> driven;
  std::string skipped;
  Json first;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Clip clip = read_clip(list.at(i));
    if (std::none_of(clip.channels.begin(), clip.channels.end(),
                     [&](const auto& c) { return driven.contains(c.first); })) {
      for (const auto& [pointer, channel] : clip.channels) driven.insert(pointer);
      play(clip);
    } else {
      if (skipped.empty()) first = clip.json;
      skipped += (skipped.empty() ? "\"" : ", \"") + names_[i] + "\"";
    }
  }
  if (!skipped.empty())
    document_.warn(
        fmt::format("animations {} move what an earlier one moves and do not play; choose with --animation NAME",
                    skipped),
        first);
}

/// What each channel of a clip drives. Nothing is said yet: clips that do not play may be as wrong as they like.
GltfAnimations::Clip GltfAnimations::read_clip(const Json& json) const {
  Clip clip{json, {}, {}};
  const auto complain = [&](const std::string& what, const SourceLoc& where) {
    clip.complaints.emplace_back(what, where);
  };
  const auto read = [&](const Json& channel) {
    Channel c{channel, {}, 0};
    const Json target = channel.object()["target"].required().object();
    const std::string path(target["path"].required().string());
    const Json extension = target["extensions"].object()["KHR_animation_pointer"].object();
    std::string pointer;
    if (path == "pointer" && extension) {
      pointer = extension["pointer"].required().string();
      c.path = node_path(pointer);
    } else {
      const Json nodes = document_.list("nodes");
      const int node = target["node"].optional_index(nodes.size(), "nodes");
      if (path != "translation" && path != "rotation" && path != "scale" && path != "weights")
        return complain(fmt::format("animation path \"{}\" is ignored", path), target["path"].loc());
      if (node < 0) return complain("animation channel without a node is ignored", target.loc());
      const Json driven = nodes.at(node).object();
      if (path == "weights") {
        const int mesh = driven["mesh"].optional_index(document_.count("meshes"), "meshes");
        const Json primitives = mesh < 0 ? Json() : document_.list("meshes").at(mesh).object()["primitives"].array();
        c.targets = primitives.size() == 0 ? 0 : primitives.at(0).object()["targets"].size();
        if (c.targets == 0)
          return complain("animations of weights of nodes that have no mesh with morph targets are ignored",
                          target.loc());
      } else if (driven["matrix"]) {
        return complain("animations of nodes with a matrix instead of translation, rotation and scale are ignored",
                        target.loc());
      }
      pointer = fmt::format("/nodes/{}/{}", node, path);
      c.path = path;
    }
    if (!clip.channels.emplace(pointer, c).second)
      complain("animation channels that drive what an earlier one of their animation drives are ignored", target.loc());
  };
  Json channels;
  forgive([&] { channels = json["channels"].required().array(); }, complain);
  if (channels && channels.size() == 0) complain("animations without channels are no valid glTF", channels.loc());
  for (std::size_t i = 0; i < channels.size(); ++i) forgive([&] { read(channels.at(i)); }, complain);
  return clip;
}

void GltfAnimations::play(const Clip& clip) {
  const auto complain = [&](const std::string& what, const SourceLoc& where) { document_.warn(what, where); };
  for (const auto& [what, where] : clip.complaints) complain(what, where);
  for (const auto& entry : clip.channels) {
    forgive(
        [&] {
          const auto& [pointer, channel] = entry;
          std::optional<Track> track = read_track(channel, clip.json["samplers"].required().array());
          if (track) tracks_.emplace(pointer, std::move(*track));
        },
        complain);
  }
}

static constexpr Named<Interpolation> kInterpolations[] = {
    {"STEP", Interpolation::kStep}, {"LINEAR", Interpolation::kLinear}, {"CUBICSPLINE", Interpolation::kCubic}};

std::optional<Track> GltfAnimations::read_track(const Channel& channel, const Json& samplers) const {
  const Json sampler = samplers.at(channel.json["sampler"].index(samplers.size(), "samplers")).object();
  Track track;
  track.json = channel.json;
  const Json mode = sampler["interpolation"];
  std::string interpolation(mode.string("LINEAR"));
  const bool is_upper =
      std::none_of(interpolation.begin(), interpolation.end(), [](char c) { return c >= 'a' && c <= 'z'; });
  std::transform(interpolation.begin(), interpolation.end(), interpolation.begin(),
                 [](char c) { return c >= 'a' && c <= 'z' ? char(c - 'a' + 'A') : c; });
  track.interpolation = choice(mode, interpolation, "interpolation", kInterpolations);
  if (!is_upper) document_.warn("names of interpolations in lower case are no valid glTF", mode);

  const bool rotation = channel.path == "rotation", weights = channel.path == "weights",
             vec3 = channel.path == "translation" || channel.path == "scale";
  const Json in = sampler["input"].required(), out = sampler["output"].required();
  const Accessor& input = document_.accessor(in, "SCALAR");
  const Accessor& output = document_.accessor(out, rotation  ? "VEC4"
                                                   : vec3    ? "VEC3"
                                                   : weights ? "SCALAR"
                                                             : "SCALAR|VEC2|VEC3|VEC4");
  if (!input.is_float()) document_.warn("key times that are not floats are no valid glTF", in);
  if (!input.json["min"] || !input.json["max"])
    document_.warn("key times without min and max are no valid glTF", input.json);
  if (vec3 ? !output.is_float() : (rotation || weights) && !output.is_fraction())
    out.fail(fmt::format("an accessor of component type {} cannot drive a {}", int(output.type), channel.path));

  // Numbers a key: those of one element, or of as many as there are morph targets; and so may what a pointer names
  // have.
  if (track.interpolation == Interpolation::kCubic && (rotation || vec3) && output.count == input.count &&
      input.count > 0) {
    document_.warn("cubic splines without tangents are taken as linear", out);
    track.interpolation = Interpolation::kLinear;
  }
  const std::size_t parts = track.interpolation == Interpolation::kCubic ? 3 : 1;
  std::size_t elements = 1;
  if (!rotation && !vec3 && input.count > 0 && output.count > 0 && output.count % (input.count * parts) == 0)
    elements = output.count / (input.count * parts);
  else if (weights && channel.targets > 0)
    elements = channel.targets;
  const std::size_t keys = std::min(input.count, output.count / (elements * parts));
  if (input.count != keys || output.count != keys * elements * parts)
    document_.warn("animations with other numbers of key times than of values keep the keys that have both", out);
  if (keys == 0) {
    document_.warn("animation channels without keys are ignored", channel.json);
    return std::nullopt;
  }
  track.width = elements * output.components;

  // Without data the times are all zero; the glTF validator lets that pass, and so the test files do it. Such a track
  // has no motion: its first key stands for all.
  const bool no_data = input.view < 0 && !input.json["sparse"] && keys > 1;
  if (no_data) document_.warn("animations whose key times have no data keep their first key", in);
  const std::size_t kept = no_data ? 1 : keys;
  const std::vector<float> times = document_.floats(input);
  track.times.assign(times.begin(), times.begin() + std::ptrdiff_t(kept));
  track.values = document_.floats(output);
  track.values.resize(kept * parts * track.width);
  tidy(track, rotation);
  if (track.times.empty()) {
    document_.warn("animation channels without keys are ignored", channel.json);
    return std::nullopt;
  }
  return track;
}

/// Leaves out keys that say nothing, brings the rest in order, at most two at a time, and makes rotations unit.
void GltfAnimations::tidy(Track& track, bool rotation) const {
  const bool cubic = track.interpolation == Interpolation::kCubic;
  const std::size_t numbers = track.width * (cubic ? 3 : 1);  // of a key
  const std::vector<double> times = std::move(track.times);
  std::vector<float> values = std::move(track.values);
  std::vector<std::size_t> keys;
  for (std::size_t i = 0; i < times.size(); ++i) {
    float* const v = &values[i * numbers];
    if (!(std::abs(times[i]) <= kMaxTime) ||
        !std::all_of(v, v + numbers, [](float x) { return std::abs(x) < kMaxValue; })) {
      document_.warn("animation keys that are not finite or too large are left out", track.json);
      continue;
    }
    if (rotation) {
      float* const q = v + (cubic ? 4 : 0);
      const float norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
      if (!(norm > 1e-6f)) {
        document_.warn("rotation keys without length are left out", track.json);
        continue;
      }
      if (std::abs(norm - 1) > 0.02f)
        document_.warn("rotation keys that are not unit quaternions are normalized", track.json);
      if (!cubic)  // scaling the value without its tangents would bend the curve; the sum is normalized anyway
        for (int c = 0; c < 4; ++c) q[c] /= norm;
    }
    if (times[i] < 0) document_.warn("animation keys before time 0 are no valid glTF", track.json);
    keys.push_back(i);
  }
  const auto earlier = [&](std::size_t a, std::size_t b) { return times[a] < times[b]; };
  if (!std::is_sorted(keys.begin(), keys.end(), earlier)) {
    document_.warn("animations whose keys are not in the order of time are sorted", track.json);
    std::stable_sort(keys.begin(), keys.end(), earlier);
  }
  track.times.clear();
  track.values.clear();
  for (const std::size_t i : keys) {
    const std::size_t n = track.times.size();
    if (n > 0 && track.times[n - 1] == times[i])
      document_.warn("animations with several keys at one time step there from the first to the last", track.json);
    if (n > 1 && track.times[n - 2] == times[i]) {
      track.times.pop_back();
      track.values.resize(track.values.size() - numbers);
    }
    track.times.push_back(times[i]);
    track.values.insert(track.values.end(), &values[i * numbers], &values[i * numbers] + numbers);
  }
}

const Track* GltfAnimations::find(const std::string& pointer, std::size_t width) {
  const auto it = tracks_.find(pointer);
  if (it == tracks_.end()) return nullptr;
  Track& track = it->second;
  used_.insert(pointer);
  if (track.width != width) {
    if (!pointer.ends_with("/weights")) {
      document_.warn("animations with another number of values than what they drive has are ignored", track.json);
      tracks_.erase(it);
      return nullptr;
    }
    document_.warn("animations of weights for another number of morph targets: missing ones are 0, others ignored",
                   track.json);
    std::vector<float> values(track.value_count() * width, 0.0f);
    for (std::size_t i = 0; i < track.value_count(); ++i)
      std::copy_n(track.value(i), std::min(width, track.width), &values[i * width]);
    track.values = std::move(values);
    track.width = width;
  }
  // Frames before time 0 are no part of a clip, whatever its keys.
  const TimeSpan keys{std::max(track.times.front(), 0.0), std::max(track.times.back(), 0.0)};
  span_ = found_ ? TimeSpan{std::min(span_.begin, keys.begin), std::max(span_.end, keys.end)} : keys;
  found_ = true;
  return &track;
}

void GltfAnimations::warn_unused() const {
  for (const auto& [pointer, track] : tracks_) {
    if (used_.contains(pointer)) continue;
    std::string kind;  // one warning for all materials, not one each
    for (std::size_t i = 0; i < pointer.size(); ++i) {
      const bool digit = pointer[i] >= '0' && pointer[i] <= '9';
      const char before = kind.empty() ? ' ' : kind.back();
      if (!digit || (before != '/' && before != '*'))
        kind += pointer[i];
      else if (before == '/')
        kind += '*';
    }
    document_.warn(fmt::format("animation of \"{}\" is ignored", kind), track.json);
  }
}

}  // namespace tempera
