// SPDX-License-Identifier: Apache-2.0
#pragma once
// The denoiser over time, one frame after another: reads frames as it needs them, and forgets those that it no longer
// does. Private to the denoiser.
#include <array>
#include <ctime>
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

constexpr float kLeastReflectance = 0.05f;  ///< below it light is not divided by any less
constexpr int kVarianceRadius = 3;          ///< of the pixels over which variances are averaged

/// CPU time of all threads, in seconds: what a step costs on one core, whatever else the machine does.
inline double cpu_seconds() { return double(std::clock()) / CLOCKS_PER_SEC; }

/// What is done with the halves of the samples, see docs/denoising.md.
enum class Recipe {
  kAuto,        ///< by the number of samples and what layers there are
  kSingle,      ///< they are denoised together; what is alike over time is judged by the noisy pictures
  kHalves,      ///< each is denoised, and what is alike is judged by the results
  kComponents,  ///< the same for what the first surface scatters, and for the rest
  kClasses,     ///< the same for each class of paths, along the vectors of what it is seen on
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
  bool any_chain = false;            ///< features of all chains together
  bool photons = false;              ///< light of photons apart, with its halves if there are halves
  std::vector<std::string> classes;  ///< of a decomposition, that have halves of their own
  std::vector<std::string> chains;   ///< that have features of their own
  std::vector<std::string> moving;   ///< of these, that have vectors
  /// What is lost, a sentence each.
  std::vector<std::string> losses(bool alone) const;
};

class Denoiser {
 public:
  Denoiser(StageRun& run, const Settings& settings, std::shared_ptr<Oidn> oidn);
  /// A clean frame with what passes through. Pre: it comes after all that were made before.
  Frame make(int frame);
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
  /// The same while it waits.
  struct PackedLight {
    PackedLight() = default;
    explicit PackedLight(const Light& light) : a(light.a), b(light.b), variance(light.variance) {}
    PackedPlanes a, b, variance;
    bool halves() const { return !b.empty(); }
    bool is_zero() const { return a.is_zero() && b.is_zero(); }
    Light light() const { return {a.planes(), b.planes(), variance.planes()}; }
  };
  /// What is averaged over time by itself: all light, that of the classes which one kind of surface scatters, the rest, or
  /// that of one class.
  struct Part {
    std::vector<std::string> classes;  ///< empty: what is of no other part
    std::size_t view;                  ///< of the surfaces that send it on
    bool emits;                        ///< whether some of it comes from where there is no reflectance to divide it by
    std::size_t moves = 0;             ///< what it moves with: surfaces of a source
  };
  /// Surfaces that are seen, the first ones that scatter after chains of mirrors and glass; features of several chains add
  /// up to what reaches the camera.
  struct View {
    PackedPlanes albedo, normal;
  };
  /// Light that was held back, and all light.
  struct Held {
    double held = 0, all = 0;
    double share() const { return held / all; }
  };
  struct Source {
    std::vector<Surfaces> surfaces;  ///< of each path that light is followed along
    std::vector<View> views;
    PackedPlanes emitter;            ///< 1 near what emits light: it has no reflectance that it could be divided by
    std::vector<PackedLight> light;  ///< of each part, divided where it can be
    Planes photons;                  ///< light of photons, which is none of the parts'; empty if it is
    Held held;
  };
  /// Squared errors of the parts that are filtered apart, and of all light that is filtered together.
  struct Trial {
    double apart = 0, together = 0;
  };
  struct Averaged {
    std::vector<PackedLight> light;                    ///< of the parts
    std::map<int, std::vector<PackedPlanes>> weights;  ///< of the frames around and the parts, by the noisy pictures
    Trial trial;
  };
  /// Parts that are filtered together, and what came of them.
  struct Group {
    std::vector<std::size_t> parts;
    bool divided = false;
    PackedLight light;    ///< divided by `factor`
    PackedPlanes factor;  ///< that makes it radiance again
  };
  using Denoised = std::vector<Group>;
  /// Radiance of a group, averaged over time: denoised, and for residuals its halves and the noisy ones.
  struct Pictures {
    Planes clean, clean_a, clean_b, a, b;
  };
  using Tracks = std::map<int, Track>;  ///< by frame

  const Source& source(int frame);
  const Averaged& averaged(int frame);
  const Denoised& denoised(int frame);
  Source read(int frame);
  Averaged average(int frame);
  Denoised denoise(int frame);
  /// Group `g` of a frame, averaged with those of the frames around.
  Pictures average_after(int frame, std::size_t g);
  /// The clean picture with the residuals that are given back, if there are any.
  Planes with_residuals(const Pictures& pictures);
  /// One part for each class of a decomposition.
  void part_by_class(const Metadata& metadata);
  /// Drops what no frame needs any more that is still to be made.
  void forget();
  /// Where what pixels of a frame show of a part is in those around.
  Tracks tracks(int frame, int distance, const Part& part);
  /// Features of the surfaces that parts are seen on together.
  struct Features {
    Planes albedo, normal;
  };
  Features features(const Source& source, const std::vector<std::size_t>& parts) const;
  /// What light of parts together is divided by; empty: nothing.
  Planes divisor(const Source& source, const std::vector<std::size_t>& parts) const;
  /// Light of parts together, divided by their reflectance or not.
  Light light_of(int frame, const std::vector<std::size_t>& parts, bool divided);
  /// What NL-means reads of a group of a frame, at the pixels of another one if there is a track.
  struct Bundle {
    Light light;
    Planes valid, features;
  };
  Bundle bundle(int frame, const std::vector<std::size_t>& parts, bool divided, const Track* track);
  NlMeansSettings nl_means_settings(const std::vector<std::size_t>& parts, bool divided) const;
  void denoise_nl_means(int frame, Group& group);
  void denoise_oidn(int frame, Group& group);
  /// Filters a few tiles both ways: the error is what each half, denoised by weights of the other, differs from that.
  Trial try_both(int frame);
  /// Whether the parts of a frame are to be filtered apart, by what was tried on it and those around.
  bool is_apart(int frame);
  std::vector<std::size_t> all_parts() const;
  /// That makes radiance of what was divided; `least`: it was divided by no less.
  Planes factor(const Source& source, const std::vector<std::size_t>& parts, const Planes& albedo, float least) const;
  FrameRange around(int frame, int distance) const;
  /// Finds the variance of light that is divided by `divisor`, if there is one.
  void prepare(Light& light, const Planes& divisor, const Planes& color_variance) const;
  /// Factors of both halves that bring what outshines the other half around it by far down to it.
  std::array<Planes, 2> held_fireflies(const Light& light, const Planes& emitter, Held& shares) const;
  /// Adds the time since `start` to a step.
  void spent(const std::string& step, double start);

  StageRun& run_;
  const Settings& settings_;
  Available available_;
  /// Chains (layers::chain_layer) that are seen together; of the first without any the first surface is seen.
  std::vector<std::vector<std::string>> views_;
  std::vector<Part> parts_;
  /// Chains (of layers::chain_layer) whose vectors light is followed along; of the first, none, it is the first surface.
  std::vector<std::vector<std::string>> paths_{{}};
  int radius_;
  std::shared_ptr<Oidn> oidn_;
  Recipe recipe_;
  /// Times the brightest of the other half around that a half may be; none: as bright as it likes.
  std::optional<float> firefly_;
  bool photons_ = false;   ///< whether light of photons passes as it is
  bool few_ = false;       ///< samples, so that cleaning features costs more than it gains
  bool thorough_ = false;  ///< whether Open Image Denoise takes the time for its best
  std::map<int, Source> sources_;
  std::map<int, Averaged> averaged_;
  std::map<int, Denoised> denoised_;
  int making_ = 0;
  std::map<std::string, double> seconds_;
  int frames_ = 0;
  std::int64_t damaged_ = 0;  ///< values that were not finite
  Held held_;                 ///< of all frames that were made
};

}  // namespace tempera::denoise
