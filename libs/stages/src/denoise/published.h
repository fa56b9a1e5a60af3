// SPDX-License-Identifier: Apache-2.0
#pragma once
// The denoisers of papers, to compare with, frame after frame: see "Methods of the papers" in docs/denoising.md. Private
// to the denoiser.
#include <map>
#include <string>
#include <vector>

#include "denoise/denoiser.h"
#include "denoise/rmz13.h"

namespace tempera::denoise {

/// All light of each frame alone. [Rousselle 2013]
class FrameByFrame {
 public:
  explicit FrameByFrame(StageRun& run);
  /// Fills `color` of a frame that has what passes through.
  Frame make(int frame);
  std::string costs() const { return ""; }
  std::vector<std::string> notes() const;

 private:
  StageRun& run_;
  Available available_;
  std::int64_t damaged_ = 0;
};

/// Light by classes of paths, as irradiance, over three frames along motion. [Zimmer 2015, Sec. 5.1]
class Decomposed {
 public:
  Decomposed(StageRun& run, const Settings& settings);
  /// Frames before `frame` will not be made.
  Frame make(int frame);
  std::string costs() const { return ""; }
  std::vector<std::string> notes() const;

 private:
  /// What is filtered by itself: the light of a class, what is of no class, or the emission of the first surface.
  struct Part {
    enum class Kind { kClass, kRest, kEmission } kind = Kind::kClass;
    std::string name{};    ///< of the class
    std::size_t view = 0;  ///< of the surfaces that its light is seen on
    bool divide = false;   ///< whether it is divided by their reflectance
    bool emission = false;
  };
  struct Light {
    Planes a, b;      ///< halves; without them all in `a`
    Planes variance;  ///< [h,w,3] of their mean
  };
  struct Source {
    Surfaces surfaces;
    std::vector<Planes> divisors;        ///< of the parts; empty: 1
    std::vector<Light> light;            ///< of the parts, divided
    std::vector<FeatureStack> features;  ///< of the parts
  };
  const Source& source(int frame);
  Source read(int frame);

  StageRun& run_;
  const Settings& settings_;
  Available available_;
  std::vector<std::vector<std::string>> views_;  ///< chains that are seen together; none: the first surface
  std::vector<Part> parts_;
  std::map<int, Source> sources_;
  std::int64_t damaged_ = 0;
};

}  // namespace tempera::denoise
