// SPDX-License-Identifier: Apache-2.0
#pragma once
// Optical flow of irradiance: how shadows and other light move over surfaces between two key frames, which no vector of a
// surface tells. What surfaces do is taken out first, so that little is left to find. Private to the stages that move
// pictures.
#include <cstdint>

#include "denoise/planes.h"
#include "motion/projection.h"
#include "tempera/core/grid.h"
#include "tempera/core/vec.h"

namespace tempera::motion {

/// The energy of the flow and its solver. Defaults are for logarithms of irradiance: with less smoothness vectors
/// are worse along edges, with twice as much small faint shadows are lost.
struct FlowSettings {
  float smoothness = 0.6f;    ///< weight of the smoothness term
  float gradient = 10;        ///< weight of the constancy of gradients against that of values
  float epsilon = 1e-3f;      ///< of the penalizer sqrt(s^2 + epsilon^2), > 0
  float presmoothing = 0.8f;  ///< standard deviation, pixels
  float zoom = 0.75f;         ///< of a level of the pyramid against the finer one, in (0, 1)
  int coarsest = 16;          ///< least side of the coarsest level, pixels; smaller pictures have one level
  int warps = 3;              ///< linearizations per level
  int fixed = 1;              ///< updates of the penalizers per linearization
  int sweeps = 20;            ///< of successive over-relaxation per update
  float relaxation = 1.95f;   ///< in (0, 2)
};

/// Vectors from pixels of `from` to where the same is in `to`.
/// Shapes:  `from`, `to`, `counts` [h,w,1]; values of any scale that the settings are made for. Those that are not finite
///          are unknown.
/// Range:   `counts` in [0, 1]: weight of the data term; 0 where what `from` shows is not in `to`, the smoothness term
///          fills in there. It is off too where a vector leads to unknown values or out of the picture.
/// Units:   pixels; at most the size of the picture, and never NaN. Exactly 0 if the pictures are the same.
/// Result:  the same bits for any number of threads.
/// Source:  [Zimmer 2015, Sec. 4.2], the method of Brox et al. 2004 with a penalizer for each term.
Grid<Vec2f> optical_flow(const denoise::Planes& from, const denoise::Planes& to, const denoise::Planes& counts,
                         const FlowSettings& settings = {});

#ifdef TEMPERA_PATH_SPACE_MOTION

/// Where light goes from one key frame to another.
struct LightFlow {
  Grid<Vec2f> vectors;       ///< pixels
  Grid<std::uint8_t> valid;  ///< 1: the surface is in both pictures, and the vector leads into the picture
};

/// Total motion of irradiance, that of the surfaces included.
/// Shapes:  `from`, `to` [h,w,3] irradiance, noisy at most by a few percent; negative values count as 0, those that are not
///          finite are unknown. `places` [w,h]: where in `to` is what pixels of `from` show, by the vectors of surfaces.
///          `id` [w,h]: objects of `from`; empty: unknown.
/// Source:  [Zimmer 2015, Sec. 4.2].
LightFlow irradiance_flow(const denoise::Planes& from, const denoise::Planes& to, const Grid<Place>& places,
                          const Grid<float>& id, const FlowSettings& settings = {});

/// Which vectors of `flow` are valid and undone by those of `back`, the flow between the same pictures the other way, up
/// to `tolerance` pixels. 1: yes.
Grid<std::uint8_t> consistent(const LightFlow& flow, const LightFlow& back, float tolerance = 0.5f);

#endif  // TEMPERA_PATH_SPACE_MOTION

}  // namespace tempera::motion
