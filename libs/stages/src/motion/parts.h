// SPDX-License-Identifier: Apache-2.0
#pragma once
// The parts of a picture's light that move each in its own way: what is reflected and what is seen through glass does not
// move as the mirror and the glass do. Private to the stages that move pictures.
#include <span>
#include <string>
#include <vector>

#include "motion/projection.h"

namespace tempera::motion {

/// Light that is moved together.
struct Part {
  std::string color;                ///< layer: "color", or that of a class of light paths
  std::vector<std::string> chains;  ///< whose surfaces it is seen on; none: the first surface
  bool shines = false;              ///< whether it comes from these surfaces themselves, which are lamps
  bool divide = true;               ///< whether these scatter it, so that it can be divided by their reflectance
  bool add = true;                  ///< whether it is a summand of `color`
};

/// The parts of frames of these layers: the classes of a decomposition, else all light as one. Other classes of light
/// paths follow, which are not added. `metadata`: of one of the frames. Classes are moved along the vectors of their
/// chains where there are such, if the program is built with TEMPERA_PATH_SPACE_MOTION, else along those of the first
/// surface. [Zimmer 2015, Sec. 3]
std::vector<Part> parts_of(std::span<const LayerDesc> layers, const Metadata& metadata);

/// Layers of chains that parts can make use of: those there are, and what else chains with vectors can have.
std::vector<LayerDesc> chain_layers(std::span<const LayerDesc> layers);

/// As read_surfaces, of the surfaces that a part is seen on: of several chains, the one that most light comes from. Where
/// there is none, `vectors` is kNothing. Of light of lamps, the surfaces that are dark are seen, too: they hide lamps.
Surfaces surfaces_of(const Frame& frame, int number, const Part& part);

/// Reflectance that reaches the camera, [h,w,3]; of one where nothing says what it is, or the part is not divided.
/// `least`: at least.
Image reflectance_of(const Frame& frame, const Part& part, float least);

}  // namespace tempera::motion
