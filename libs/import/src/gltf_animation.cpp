// SPDX-License-Identifier: Apache-2.0
#include "gltf_animation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tempera {
namespace {

/// Pointer of what a channel drives, or nothing if it says no node: such channels are for extensions and are ignored.
std::optional<std::string> target_pointer(const GltfDocument& document, const Json& channel, std::string& path) {
  const Json target = channel["target"].required().object();
  path = target["path"].required().string();
  const Json extension = target["extensions"].object()["KHR_animation_pointer"].object();
  if (path == "pointer" && extension) return std::string(extension["pointer"].required().string());
  const Json nodes = document.list("nodes");
  const int node = target["node"].optional_index(nodes.size(), "nodes");
  if (path != "translation" && path != "rotation" && path != "scale" && path != "weights") {
    document.warn(fmt::format("animation path \"{}\" is ignored", path), target["path"]);
    return std::nullopt;
  }
  if (node < 0) {
    document.warn("animation channel without a node is ignored", target);
    return std::nullopt;
  }
  const Json json = nodes.at(std::size_t(node)).object();
  if (path == "weights") {
    const int mesh = json["mesh"].optional_index(document.count("meshes"), "meshes");
    const Json primitives =
        mesh < 0 ? Json() : document.list("meshes").at(std::size_t(mesh)).object()["primitives"].array();
    if (primitives.size() == 0 || primitives.at(0).object()["targets"].size() == 0)
      target.fail(fmt::format("drives the weights of nodes[{}], which has no mesh with morph targets", node));
  } else if (json["matrix"]) {
    target.fail(fmt::format("drives the {} of nodes[{}], which has a matrix instead of translation, rotation and scale",
                            path, node));
  }
  return fmt::format("/nodes/{}/{}", node, path);
}

}  // namespace

void Track::expect_width(std::size_t n) const {
  if (width != n) json.fail(fmt::format("has {} numbers a key, but what it drives has {}", width, n));
}

GltfAnimations::GltfAnimations(const GltfDocument& document, const std::string& name) : document_(document) {
  const Json list = document.list("animations");
  if (list && list.size() == 0) document.warn("an empty list of animations is no valid glTF", list);
  std::vector<Clip> clips;
  for (std::size_t i = 0; i < list.size(); ++i) {
    clips.push_back(read_clip(list.at(i).object()));
    names_.emplace_back(list.at(i)["name"].string());
    if (names_.back().empty()) names_.back() = std::to_string(i);
  }
  select(std::move(clips), name);
}

GltfAnimations::Clip GltfAnimations::read_clip(const Json& json) const {
  Clip clip{json, {}};
  const Json channels = json["channels"].required().array(), samplers = json["samplers"].required().array();
  if (channels.size() == 0) channels.fail("an animation has at least one channel");
  if (samplers.size() == 0) samplers.fail("an animation has at least one sampler");
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const Json channel = channels.at(i).object();
    std::string path;
    const std::optional<std::string> pointer = target_pointer(document_, channel, path);
    Track track = read_track(channel, samplers, path);
    if (!pointer) continue;
    if (!clip.tracks.emplace(*pointer, std::move(track)).second)
      channel["target"].fail(fmt::format("a second channel of this animation drives {}", *pointer));
  }
  return clip;
}

Track GltfAnimations::read_track(const Json& channel, const Json& samplers, const std::string& path) const {
  const Json sampler = samplers.at(std::size_t(channel["sampler"].index(samplers.size(), "samplers"))).object();
  Track track;
  track.json = channel;
  const Json mode = sampler["interpolation"];
  const std::string_view interpolation = mode.string("LINEAR");
  if (interpolation == "STEP")
    track.interpolation = Interpolation::kStep;
  else if (interpolation == "LINEAR")
    track.interpolation = Interpolation::kLinear;
  else if (interpolation == "CUBICSPLINE")
    track.interpolation = Interpolation::kCubic;
  else
    mode.fail(fmt::format("\"{}\" is no interpolation; valid: STEP, LINEAR, CUBICSPLINE", interpolation));
  const bool cubic = track.interpolation == Interpolation::kCubic;

  const Accessor& input = document_.accessor(sampler["input"].required(), "SCALAR");
  if (!input.is_float()) sampler["input"].fail("key times are not floats");
  if (!input.json["min"] || !input.json["max"])
    document_.warn("key times without min and max are no valid glTF", input.json);
  const std::vector<float> times = document_.floats(input);
  // Without data the times are all zero; the glTF validator lets that pass, and so the test files do it. Such a track
  // has no motion: its first key stands for all.
  const bool no_data = input.view < 0 && !input.json["sparse"];
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (!std::isfinite(times[i]) || times[i] < 0 || (i > 0 && !no_data && !(times[i] > times[i - 1])))
      sampler["input"].fail(ErrorCode::kOutOfRange,
                            fmt::format("key {} is at {} s; times increase strictly from 0 or later", i, times[i]));
  }
  if (cubic && times.size() < 2) sampler["input"].fail("a cubic spline has at least two keys");
  track.times.assign(times.begin(), times.end());

  const bool rotation = path == "rotation", weights = path == "weights",
             vec3 = path == "translation" || path == "scale";
  const Accessor& output = document_.accessor(sampler["output"].required(), rotation  ? "VEC4"
                                                                            : vec3    ? "VEC3"
                                                                            : weights ? "SCALAR"
                                                                                      : "SCALAR|VEC2|VEC3|VEC4");
  if (vec3 ? !output.is_float() : (rotation || weights) && !output.is_fraction())
    sampler["output"].fail(fmt::format("an accessor of component type {} cannot drive a {}", int(output.type), path));
  track.values = document_.floats(output);
  const std::size_t groups = times.size() * (cubic ? 3 : 1);
  // Weights have as many values a key as there are morph targets, and so may what a pointer names.
  if (output.count % groups != 0 || ((rotation || vec3) && output.count != groups))
    sampler["output"].fail(fmt::format("has {} values for {} keys{}", output.count, times.size(),
                                       cubic ? "; cubic splines have three a key" : ""));
  track.width = output.count / groups * std::size_t(output.components);
  for (std::size_t i = 0; i < track.values.size(); ++i)
    if (!std::isfinite(track.values[i])) sampler["output"].fail(fmt::format("value {} is not finite", i / track.width));

  if (rotation) {
    for (std::size_t i = cubic ? 1 : 0; i < track.value_count(); i += cubic ? 3 : 1) {
      float* q = &track.values[i * 4];
      const float norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
      if (std::abs(norm - 1) > 0.02f)
        document_.warn("rotation keys that are not unit quaternions are normalized", sampler["output"]);
      if (cubic) continue;  // scaling the value without its tangents would bend the curve; the sum is normalized anyway
      if (!(norm > 0))
        q[3] = 1;
      else
        for (int c = 0; c < 4; ++c) q[c] /= norm;
    }
  }
  if (no_data && track.times.size() > 1) {
    track.times.erase(track.times.begin() + 1, track.times.end());
    track.values.resize(track.width * (cubic ? 3 : 1));
  }
  return track;
}

void GltfAnimations::select(std::vector<Clip> clips, const std::string& name) {
  if (name == "none") return;
  if (!name.empty()) {
    auto found = std::find(names_.begin(), names_.end(), name);
    if (found == names_.end() && name.find_first_not_of("0123456789") == name.npos && name.size() < 9 &&
        std::stoul(name) < names_.size())
      found = names_.begin() + std::ptrdiff_t(std::stoul(name));
    if (found == names_.end()) {
      const Json list = document_.list("animations");
      const std::string known = names_.empty() ? "the file has no animations" : "known: " + nearest_names(name, names_);
      throw Error(ErrorCode::kUnknownName, list ? list.loc() : SourceLoc{document_.file().string()},
                  fmt::format("no animation \"{}\"; {}", name, known));
    }
    tracks_ = std::move(clips[std::size_t(found - names_.begin())].tracks);
    return;
  }
  // A clip plays as a whole or not at all: a walk whose feet run is worse than no run.
  std::string skipped;
  Json first;
  for (std::size_t i = 0; i < clips.size(); ++i) {
    auto& tracks = clips[i].tracks;
    if (std::none_of(tracks.begin(), tracks.end(), [&](const auto& t) { return tracks_.contains(t.first); })) {
      tracks_.merge(tracks);
    } else {
      if (skipped.empty()) first = clips[i].json;
      skipped += (skipped.empty() ? "\"" : ", \"") + names_[i] + "\"";
    }
  }
  if (!skipped.empty())
    document_.warn(
        fmt::format("animations {} move what an earlier one moves and do not play; choose with --animation NAME",
                    skipped),
        first);
}

const Track* GltfAnimations::find(const std::string& pointer, std::size_t width) {
  const auto it = tracks_.find(pointer);
  if (it == tracks_.end()) return nullptr;
  const Track& track = it->second;
  if (width != 0) track.expect_width(width);
  const TimeSpan keys{track.times.front(), track.times.back()};
  span_ = used_.empty() ? keys : TimeSpan{std::min(span_.begin, keys.begin), std::max(span_.end, keys.end)};
  used_.insert(pointer);
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
