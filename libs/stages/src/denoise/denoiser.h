// SPDX-License-Identifier: Apache-2.0
#pragma once
// The denoiser over time, one frame after another: reads frames as it needs them, and forgets those that it no longer
// does. Private to the denoiser.
#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "denoise/nl_means.h"
#include "denoise/oidn.h"
#include "denoise/tracks.h"
#include "tempera/core/params.h"
#include "tempera/stages/stage.h"
#include "tempera/stages/stage_run.h"

namespace tempera::denoise {

/// What is done with the halves of the samples, see docs/denoising.md.
enum class Recipe {
  kAuto,        ///< by the number of samples and what layers there are
  kSingle,      ///< they are denoised together; what is alike over time is judged by the noisy pictures
  kHalves,      ///< each is denoised, and what is alike is judged by the results
  kComponents,  ///< the same for each class of paths
};

enum class Method { kAuto, kNlMeans, kOidn, kPublished, kRmz13 };

struct Settings {
  /// Errors: StageParamError.
  explicit Settings(const Params& params);
  Method method = Method::kAuto;
  std::string oidn_path, oidn_version;  ///< empty: any
  Recipe recipe = Recipe::kAuto;
  bool residuals = true;
  std::optional<bool> hold_fireflies;  ///< none: as the method needs it
  int radius = 2;                      ///< frames before and after that are averaged; 0: none
  std::vector<int> cuts;               ///< first frames of shots
};

/// The denoiser of single frames that `settings` ask for: Open Image Denoise, or null for NL-means.
/// Errors: Error{kUnsupported} if it is asked for, or a version of it, and is not there.
std::shared_ptr<Oidn> choose_method(const Settings& settings);
/// "nl_means", or "oidn 2.5.1".
std::string describe_method(const Oidn* oidn);

/// The frames from which `frame` is made: those within `distance` of it that no cut keeps from it.
FrameRange shot_around(int frame, int distance, const FrameRange& reach, const std::vector<int>& cuts);

/// Which layers there are to work with.
struct Available {
  explicit Available(std::span<const LayerDesc> layers);
  bool halves = false, variance = false, albedo = false, normal = false, emission = false, id = false, motion = false;
  std::vector<std::string> classes;  ///< of a decomposition, that have halves of their own
  std::vector<std::string> chains;   ///< that have features of their own
  /// What is lost, a sentence each.
  std::vector<std::string> losses(bool alone) const;
};

class Denoiser {
 public:
  Denoiser(StageRun& run, const Settings& settings, std::shared_ptr<Oidn> oidn);
  /// Fills `color` of a frame that has what passes through.
  void make(int frame, Frame& out);
  /// Frames before `frame` will not be made.
  void forget_before(int frame);
  /// CPU time by step, per pixel and frame.
  std::string costs() const;
  /// What was done, and with what of the light.
  std::vector<std::string> notes() const;

 private:
  /// Halves of light, or all of it in `a`.
  struct Light {
    Planes a, b;
    Planes variance;  ///< [h,w,1] of their mean
    bool halves() const { return !b.empty(); }
    Planes mean() const;
  };
  /// What is filtered by itself: all light, or the paths of one class.
  struct Part {
    std::string name;  ///< of the class; "": what is of no class, or all light
    std::size_t view;  ///< of the surface that sends it on
    bool divide;       ///< whether that is one which scatters, so that light can be divided by its reflectance
  };
  /// Surfaces that are seen, the first ones that scatter after chains of mirrors and glass; features of several chains add
  /// up to what reaches the camera.
  struct View {
    Planes albedo, normal;
    Planes divisor;  ///< reflectance, not too small
  };
  /// Light that was held back, and all light.
  struct Held {
    double held = 0, all = 0;
    double share() const { return held / all; }
  };
  struct Source {
    Surfaces surfaces;
    std::vector<View> views;
    Planes emitter;            ///< 1 near what emits light: it has no reflectance that it could be divided by
    std::vector<Light> light;  ///< of each part, divided where it can be
    Held held;
  };
  /// Squared errors of a part that is filtered divided by the reflectance, and of one that is filtered as it is.
  struct Trial {
    double divided = 0, whole = 0;
  };
  struct Averaged {
    std::vector<Light> light;
    std::map<int, Track> tracks;                 ///< by frame
    std::map<int, std::vector<Planes>> weights;  ///< of the frames around and the parts, by the noisy pictures
    std::vector<View> views;                     ///< without noise
    std::vector<Trial> trials;                   ///< of the parts
  };
  struct Denoised {
    std::vector<Light> light;    ///< divided by `factor`
    std::vector<Planes> factor;  ///< that makes it radiance again
  };

  const Source& source(int frame);
  const Averaged& averaged(int frame);
  const Denoised& denoised(int frame);
  Source read(int frame);
  Averaged average(int frame);
  Denoised denoise(int frame);
  /// What NL-means reads of a part of a frame, at the pixels of another one if there is a track.
  struct Bundle {
    Light light;
    Planes valid, features;
  };
  Bundle bundle(int frame, const Averaged& averaged, std::size_t part, bool divided, const Track* track);
  NlMeansSettings nl_means_settings(const Averaged& averaged, std::size_t part, bool divided) const;
  void denoise_nl_means(int frame, std::size_t part, Denoised& out);
  void denoise_oidn(int frame, std::size_t part, Denoised& out);
  /// Filters a few tiles both ways: the error is what each half, denoised by weights of the other, differs from that.
  Trial try_both(int frame, const Averaged& averaged, std::size_t part);
  /// Whether a part of a frame is to be filtered divided by the reflectance, by what was tried on it and those around.
  bool is_divided(int frame, std::size_t part);
  /// That makes radiance of what was divided; `least`: it was divided by no less.
  Planes factor(int frame, const Averaged& averaged, std::size_t part, float least);
  FrameRange around(int frame, int distance) const;
  /// Divides the light by `divisor`, if there is one, and finds the variance.
  void prepare(Light& light, const Planes* divisor, const Planes& color_variance);
  /// Factors of both halves that bring what outshines the other half around it by far down to it.
  static std::array<Planes, 2> held_fireflies(const Light& light, Held& shares);
  /// Adds the time since `start` to a step.
  void spent(const std::string& step, double start);

  StageRun& run_;
  const Settings& settings_;
  Available available_;
  /// Chains (layers::chain_layer) that are seen together: all of them first; without any that is the first surface.
  std::vector<std::vector<std::string>> views_;
  std::vector<Part> parts_;
  int radius_;
  std::shared_ptr<Oidn> oidn_;
  Recipe recipe_;
  bool hold_fireflies_;
  std::map<int, Source> sources_;
  std::map<int, Averaged> averaged_;
  std::map<int, Denoised> denoised_;
  std::map<std::string, double> seconds_;
  int frames_ = 0;
  std::int64_t damaged_ = 0;  ///< values that were not finite
  Held held_;                 ///< of all frames that were made
};

}  // namespace tempera::denoise
