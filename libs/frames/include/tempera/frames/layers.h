// SPDX-License-Identifier: Apache-2.0
#pragma once
// The layer vocabulary: which named layers exist, their channels, units and how they combine when frames are merged,
// filtered or resampled. Code that handles layers asks the descriptor, never the name.
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/error.h"

namespace tempera {

/// How the same layer of several sample sets of one frame becomes one.
enum class Combine {
  kMean,      ///< average weighted by samples: radiance, features
  kSum,       ///< added up: counts
  kFirst,     ///< copied from the first: positions, depth, vectors, anything that must not be blended
  kId,        ///< identifiers: copied, and never interpolated
  kVariance,  ///< variance of a mean: sum of w_i^2 v_i with weights w_i that add up to 1
};
/// "mean", "sum", "first", "id" or "variance".
std::string_view to_string(Combine combine);

/// Units of layers: the `unit` of a LayerDesc is one of these, or any text for layers outside the vocabulary.
namespace units {
inline constexpr const char* kRadiance = "radiance, scene-linear Rec. 709";   ///< W/(m^2 sr)
inline constexpr const char* kRadianceDifference = "difference of radiance";  ///< between pixels or frames
inline constexpr const char* kReflectance = "reflectance, linear Rec. 709";   ///< in [0,1]
inline constexpr const char* kDirection = "unit vector, world space";
inline constexpr const char* kMeters = "meters";
inline constexpr const char* kWorld = "meters, world space";
inline constexpr const char* kPixels = "pixels, x right, y down; Z meters; V 1 where valid";
inline constexpr const char* kPixelIndex = "index of a pixel of the full picture; V 1 where valid";
inline constexpr const char* kSquaredRadiance = "squared radiance";
inline constexpr const char* kSeconds = "seconds";
inline constexpr const char* kCount = "count";
inline constexpr const char* kId = "identifier";
inline constexpr const char* kMotionState =  // MotionState in words
    "state: 0 empty, 1 tracked, 2 missed, 3 total, 4 singular, 5 stuck, 6 occluded, 7 branch, 8 cut, 9 perturbed, "
    "10 outside";
inline constexpr const char* kTexture = "texture coordinates";
inline constexpr const char* kMask = "above 0 where set";
}  // namespace units

/// What a layer is to the steps that follow a render.
enum class LayerRole {
  kFeature,         ///< true of the pixel, whatever is made of its light: albedo, motion, identifiers, counts
  kPicture,         ///< an estimate of light
  kStatistic,       ///< of such an estimate, so of no other picture: its halves, its variance
  kReconstruction,  ///< what pictures are reconstructed from: differences, and the light that is kept out of them
  kMask,            ///< says which pixels are still to be rendered
};
/// "feature", "picture", "statistic", "reconstruction" or "mask".
std::string_view to_string(LayerRole role);

/// Whether there is a motion vector of what a chain shows, or why not: values of "chain.<letters>.motion.state".
enum class MotionState : std::uint8_t {
  kEmpty,      ///< the pixel has no such chain
  kTracked,    ///< there is one, and what it leads to is seen there
  kMissed,     ///< the path came to another surface or none, or to another side of it
  kTotal,      ///< total reflection where it refracted
  kSingular,   ///< at a fold (a caustic): the path does not follow from its ends
  kStuck,      ///< no path was found in the steps that are allowed
  kOccluded,   ///< something hides what the chain showed
  kBranch,     ///< another path between the same ends was found: it does not lead back
  kCut,        ///< there is a cut between the frames
  kPerturbed,  ///< a bump or normal map turns a mirror's or glass's normal
  kOutside,    ///< the camera does not see it: behind its plane, or far out of the picture
};
inline constexpr int kMotionStates = 11;

/// A layer: an image of one meaning. EXR channels are `<name>.<channel>`; the layer `color` is plain R, G, B, A.
struct LayerDesc {
  std::string name;                   ///< e.g. "motion.forward"
  std::vector<std::string> channels;  ///< suffixes in storage order, e.g. {"X", "Y", "Z", "V"}; {""}: the name alone
  std::string unit;                   ///< see units
  Combine combine = Combine::kMean;
  LayerRole role = LayerRole::kFeature;
  std::string pass{};        ///< "offset": of the pass that replays the frame before; empty: of the picture's own
  std::string path_class{};  ///< the light-path class whose part of the light this is; empty: all light
  std::string chain{};  ///< "RD": a feature of what is seen by these events (chain_layer); empty: of the first surface

  int channel_count() const { return int(channels.size()); }
  /// Name of channel `c` in an EXR file.
  std::string channel_name(int c) const;
  bool operator==(const LayerDesc&) const = default;
};

namespace layers {
LayerDesc color();           ///< "color" R,G,B,A: radiance, and A the part of the pixel that a surface covers
LayerDesc color_a();         ///< "color.a" R,G,B: mean of the even samples, independent of color.b
LayerDesc color_b();         ///< "color.b" R,G,B: mean of the odd samples
LayerDesc color_variance();  ///< "color.var" R,G,B: variance of color, which is a mean, from these halves
LayerDesc
photon_color();  ///< "photon.color" R,G,B: the part of color that photons light on first surfaces
LayerDesc photon_a();        ///< "photon.color.a" R,G,B: the part of color.a
LayerDesc photon_b();        ///< "photon.color.b" R,G,B: the part of color.b
LayerDesc color_common();    ///< "color.common" R,G,B: of a reconstruction, without the light of rare paths
LayerDesc color_rare();      ///< "color.rare" R,G,B: of a reconstruction, light of rare paths before it was smoothed
LayerDesc albedo();          ///< "albedo" R,G,B: directional-hemispherical reflectance of the first surface
LayerDesc normal();          ///< "normal" X,Y,Z: shading normal in world space, whatever the camera; 0 where nothing is
LayerDesc depth();           ///< "depth" Z: distance along the viewing axis; 0 where nothing is
LayerDesc position();        ///< "position" X,Y,Z: world position; 0 where nothing is
LayerDesc object_id();       ///< "object_id" I: 1 + index of the instance, exact up to 2^24; 0 where nothing is
LayerDesc uv();              ///< "uv" U,V: texture coordinates
LayerDesc emission();        ///< "emission" R,G,B: radiance that the first surface emits
LayerDesc motion_forward();  ///< "motion.forward" X,Y,Z,V: next - current place of what the pixel shows; never NaN
LayerDesc motion_backward();  ///< "motion.backward" X,Y,Z,V: previous - current
LayerDesc motion_state();     ///< "motion.state" F,B: MotionState forward and backward; of chains alone
LayerDesc grad_x();           ///< "grad.x" R,G,B: I[p + x] - I[p]
LayerDesc grad_y();           ///< "grad.y" R,G,B: I[p + y] - I[p]
LayerDesc grad_t();           ///< "grad.t" R,G,B: I[next frame, same surface point] - I[p]
LayerDesc grad_x_variance();  ///< "grad.x.var" R,G,B: variance of grad.x, which is a mean
LayerDesc grad_y_variance();  ///< "grad.y.var" R,G,B: variance of grad.y
LayerDesc rare_color();       ///< "rare.color" R,G,B: light of rare paths, and what is too bright of others
LayerDesc rare_grad_x();      ///< "rare.grad.x" R,G,B: what it adds to grad.x
LayerDesc rare_grad_y();      ///< "rare.grad.y" R,G,B: what it adds to grad.y
LayerDesc rare_a();           ///< "rare.a" R,G,B: rare.color - held.color of the even samples
LayerDesc rare_b();           ///< "rare.b" R,G,B: rare.color - held.color of the odd samples
LayerDesc held_color();       ///< "held.color" R,G,B: the part of rare.color that is held back as too bright
LayerDesc source();           ///< "source" X,Y,V: pixel of the previous frame whose random numbers were replayed here
LayerDesc samples();          ///< "samples" N: paths traced through the pixel
LayerDesc time();             ///< "time" T: mean shutter time, seconds on the shot's axis
LayerDesc mask();             ///< "mask" M: above 0 where a pixel is still to be rendered
/// "Crypto<kind><rank>" R,G,B,A = id, coverage, id, coverage of two ranks, e.g. "CryptoObject00".
LayerDesc crypto(int rank, std::string_view kind = "Object");
/// "class.<class_name>.<layer>": `base` for the paths of one light-path class, e.g. class_layer("dd", color()) is
/// "class.dd.color" (R,G,B, without alpha). Pre: class_name consists of letters, digits, '_' and '-'.
LayerDesc class_layer(std::string_view class_name, const LayerDesc& base);
/// "chain.<letters>.<layer>": the feature `base` of the surface where paths scatter diffusely (D) for the first time, after
/// the specular events before it: "RD" is what mirrors show, "TTD" what is seen through glass with two sides. Reflectance
/// and radiance are those that reach the camera: with what the mirrors and glass on the way leave of them.
/// Pre: letters is a chain (is_chain) or kAnyChain.
LayerDesc chain_layer(std::string_view letters, const LayerDesc& base);
/// Stands for the letters of all chains together: what is seen, whatever mirrors and glass are before it. Its reflectance is
/// that of the D events, and 1 where lamps or the environment are seen in mirrors and through glass.
inline constexpr const char* kAnyChain = "any";
/// Whether this is a chain: up to kMaxChain letters R and T, then D.
inline constexpr int kMaxChain = 6;
bool is_chain(std::string_view letters);
/// "offset.<layer>": `base` for the temporal offset frame.
LayerDesc offset(const LayerDesc& base);
/// "<layer>.<suffix>": what a stage makes of `base`, e.g. "color.denoised".
LayerDesc derived(const LayerDesc& base, std::string_view suffix);

/// All layers of the vocabulary that have fixed names, in the order in which files hold them.
const std::vector<LayerDesc>& known();
/// The features that chains can have: albedo, normal, emission, depth, object_id.
const std::vector<LayerDesc>& chain_features();
/// What chains can have of motion: motion.forward, motion.backward, motion.state; none of it if the program was built
/// without TEMPERA_PATH_SPACE_MOTION.
const std::vector<LayerDesc>& chain_motion();
/// Chains that the short forms "chains" and, without D, which "motion" has, "chain_motion" stand for: what is seen directly,
/// in a mirror, through a sheet, a solid, and a vessel.
inline constexpr const char* kCommonChains[] = {"D", "RD", "TD", "TTD", "TTTTD"};
/// The descriptor of any name of the vocabulary, with class.*, chain.*, offset.* and Crypto* layers; none for other names.
std::optional<LayerDesc> find(std::string_view name);
}  // namespace layers

/// Reads a comma list of layer names as users write it. "motion" stands for both directions, "halves" for color.a and
/// color.b, "cryptomatte" for CryptoObject00 to 02, "chain.<letters>" for all features of a chain, "chain.<letters>.motion"
/// for its vectors and their states, "chains" and "chain_motion" for those of kCommonChains; each appears once.
/// Errors: Error{kUnknownName} at `loc` with the nearest known names; Error{kUnsupported} for motion of chains if the
/// program was built without it.
std::vector<LayerDesc> parse_layer_names(std::string_view text, const SourceLoc& loc = {});

}  // namespace tempera
