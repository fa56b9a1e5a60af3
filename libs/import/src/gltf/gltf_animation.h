// SPDX-License-Identifier: Apache-2.0
#pragma once
// Animation channels of a glTF file by the JSON pointer of what they drive, whether they come from a core target
// (node, path) or from KHR_animation_pointer. Whoever builds a node, camera, light or material asks for its tracks.
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "gltf_document.h"
#include "tempera/core/animated.h"

namespace tempera {

/// The keys of one channel as numbers.
struct Track {
  Json json;                  ///< the channel
  std::vector<double> times;  ///< seconds, in order; two keys at one time: the value before it and from then on
  std::vector<float> values;  ///< `width` numbers a key, finite; cubic: in-tangent, value, out-tangent
  Interpolation interpolation = Interpolation::kLinear;
  std::size_t width = 1;

  std::size_t value_count() const { return values.size() / width; }
  const float* value(std::size_t i) const { return &values[i * width]; }
};

/// Keys through `f`, a linear map from `width` numbers to T (tangents go through it, too).
template <class T, class F>
Animated<T> map_linear(const Track& track, F f) {
  std::vector<T> values;
  values.reserve(track.value_count());
  for (std::size_t i = 0; i < track.value_count(); ++i) values.push_back(f(track.value(i)));
  return Animated<T>(track.times, std::move(values), track.interpolation);
}

/// The track through any function of one number, resampled to linear keys (eight a segment) unless it steps.
template <class F>
Animated<float> map_resampled(const Track& track, F f) {
  const auto source = map_linear<float>(track, [](const float* v) { return v[0]; });
  const bool steps = track.interpolation == Interpolation::kStep;
  constexpr int kSteps = 8;
  std::vector<double> times;
  std::vector<float> values;
  for (std::size_t i = 0; i < track.times.size(); ++i) {
    const bool last = i + 1 == track.times.size();
    for (int k = 0; k < (steps || last ? 1 : kSteps); ++k) {
      const double t = k == 0 ? track.times[i] : std::lerp(track.times[i], track.times[i + 1], double(k) / kSteps);
      if (k > 0 && !(t > times.back())) continue;  // keys closer than doubles can divide
      times.push_back(t);
      values.push_back(f(k == 0 ? source.value(i) : source.at(t)));
    }
  }
  return Animated<float>(std::move(times), std::move(values), steps ? Interpolation::kStep : Interpolation::kLinear);
}

inline Vec3d to_vec3d(const float* v) { return {v[0], v[1], v[2]}; }
inline Quatd to_quatd(const float* v) { return {v[3], v[0], v[1], v[2]}; }  // glTF stores x y z w

class GltfAnimations {
 public:
  /// Selects the clip that `name` names (or numbers), none for "none", or for an empty name all that can play together:
  /// of clips that drive the same thing the first one plays and the rest are a warning. Reads those that play. What is
  /// wrong in them is a warning: keys that say nothing are left out, keys in disorder sorted, channels that cannot be
  /// understood ignored. Errors: Error{kUnknownName} listing the clips.
  GltfAnimations(const GltfDocument& document, const std::string& name);

  /// The selected track that drives `pointer`, e.g. "/nodes/3/translation", with `width` numbers a key; null if there
  /// is none. One with another number of numbers is ignored with a warning, except for weights: missing ones are 0.
  const Track* find(const std::string& pointer, std::size_t width);
  /// Hull of the keys of all tracks that were found, from time 0 on; zero without any.
  TimeSpan span() const { return span_; }
  const std::vector<std::string>& names() const { return names_; }
  /// Warns about selected tracks that nothing asked for.
  void warn_unused() const;

 private:
  struct Channel {
    Json json;
    std::string path;         // "translation", ..., or "" for a pointer to anything but a node's transform or weights
    std::size_t targets = 0;  // weights: morph targets of the mesh; 0: unknown
  };
  struct Clip {
    Json json;
    std::map<std::string, Channel> channels;                    // by pointer
    std::vector<std::pair<std::string, SourceLoc>> complaints;  // for when it plays
  };
  Clip read_clip(const Json& json) const;
  void play(const Clip& clip);
  std::optional<Track> read_track(const Channel& channel, const Json& samplers) const;
  void tidy(Track& track, bool rotation) const;

  const GltfDocument& document_;
  std::vector<std::string> names_;
  std::map<std::string, Track> tracks_;
  std::set<std::string> used_;
  TimeSpan span_;
  bool found_ = false;  // anything
};

}  // namespace tempera
