// SPDX-License-Identifier: Apache-2.0
#pragma once
// The denoiser over time, one frame after another: reads frames as it needs them, and forgets those that it no longer
// does. Private to the denoiser.
#include <array>
#include <map>
#include <memory>
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
  kAuto,
  kSingle,     ///< they are denoised together; what is alike over time is judged by the noisy pictures
  kHalves,     ///< each is denoised, and what is alike is judged by the results
  kComponents,  ///< the same for each class of paths
};

struct Settings {
  explicit Settings(const Params& params);
  bool oidn = false;
  std::string oidn_path;
  Recipe recipe = Recipe::kAuto;
  bool residuals = true, hold_fireflies = true, as_color = false;
  int radius = 2;         ///< frames before and after that are averaged; 0: none
  std::vector<int> cuts;  ///< first frames of shots
};

/// The frames from which `frame` is made: those within `distance` of it that no cut keeps from it.
FrameRange shot_around(int frame, int distance, const FrameRange& reach, const std::vector<int>& cuts);

/// Which layers there are to work with.
struct Available {
  explicit Available(std::span<const LayerDesc> layers);
  bool halves = false, variance = false, albedo = false, normal = false, emission = false, id = false, motion = false;
  std::vector<std::string> classes;  ///< of light paths, that have halves of their own
  /// What is lost, a sentence each.
  std::vector<std::string> losses(bool alone) const;
};

class Denoiser {
 public:
  Denoiser(StageRun& run, const Settings& settings);
  /// Fills `color` of a frame that has what passes through.
  void make(int frame, Frame& out);
  /// Frames before `frame` will not be made.
  void forget_before(int frame);
  /// Seconds by step, and their sum per pixel and frame.
  std::string costs() const;

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
    std::string name;  ///< of the class; "": of no class, or all light
    bool reflected = true;  ///< by the first surface, so that it can be divided by its reflectance
  };
  struct Source {
    Surfaces surfaces;
    Planes albedo;
    Planes emitter;  ///< 1 near what emits light: it has no reflectance that it could be divided by
    Planes divisor;  ///< reflectance
    std::vector<Light> light;  ///< of each part, divided by it where that is reflected
    int spp = 0;               ///< 0: not known
  };
  struct Averaged {
    std::vector<Light> light;
    std::map<int, Track> tracks;                 ///< by frame
    std::map<int, std::vector<Planes>> weights;  ///< of the frames around and the parts, by the noisy pictures
    Planes albedo, normal;                       ///< without noise
    std::vector<double> divided_error, color_error;  ///< of the parts that are reflected, see `try_both`
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
  void denoise_nl_means(int frame, std::size_t part, Denoised& out);
  void denoise_oidn(int frame, std::size_t part, Denoised& out);
  /// Tries on a few tiles whether it is better to filter a part divided by the reflectance or as it is: the error is
  /// what each half, denoised by weights of the other, differs from the other.
  void try_both(int frame, std::size_t part, Averaged& a);
  /// Divides the light by `divisor`, if there is one, and finds the variance.
  void prepare(Light& light, const Planes* divisor, const Planes& color_variance);
  /// Factors of both halves that bring what outshines the other half around it by far down to it.
  std::array<Planes, 2> held_fireflies(const Light& light);
  Recipe recipe(int frame);
  FrameRange around(int frame, int distance) const;
  /// Adds the time since `start` to a step.
  void spent(const std::string& step, double start);

  StageRun& run_;
  const Settings& settings_;
  Available available_;
  std::vector<Part> parts_;
  int radius_;
  std::unique_ptr<Oidn> oidn_;
  std::map<int, Source> sources_;
  std::map<int, Averaged> averaged_;
  std::map<int, Denoised> denoised_;
  std::map<std::string, double> seconds_;
  int frames_ = 0;
  double held_ = 0, all_ = 0;
};

}  // namespace tempera::denoise
