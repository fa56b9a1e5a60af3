// SPDX-License-Identifier: Apache-2.0
#pragma once
// Where what a pixel shows is in the frames around, and averages over these places with weights from the data. Private
// to the denoiser.
#include <functional>

#include "denoise/planes.h"

namespace tempera::denoise {

constexpr float kNowhere = 1e9f;  ///< the vector of what is not seen in the other frame

/// What is known of the surfaces of a frame.
struct Surfaces {
  Planes forward, backward;  ///< motion vectors x, y, both kNowhere where there is none; empty: none at all
  Planes id;                 ///< empty: none
  PackedPlanes normal;       ///< empty: none
};

/// For each pixel of a frame, its place in another one.
struct Track {
  Planes place;  ///< x, y: index of the pixel, with fractions
  Planes valid;  ///< 1 or 0
  bool empty() const { return place.empty(); }
};

/// Follows the vectors from frame `from` to `to`, step by step. `surfaces(f)` is asked for frames from `from` to `to`.
/// A place is valid where every vector on the way is, stays within the picture and is undone by the vector back, and
/// where the pixel there shows the same object under about the same normal.
/// Empty if vectors are missing. Source: final-frames recipe, see docs/denoising.md.
Track follow(int from, int to, const std::function<const Surfaces&(int)>& surfaces);

/// Values at the nearest pixel of each place; 0 where it is not valid.
Planes gather_nearest(const Planes& in, const Track& track);
Planes gather_nearest(const PackedPlanes& in, const Track& track);
/// Catmull-Rom interpolation at each place; 0 where it is not valid.
Planes gather_smooth(const Planes& in, const Track& track);

/// What weights of an average over time depend on.
struct Likeness {
  float k = 0.45f;   ///< how many standard deviations count as like
  int radius = 3;    ///< of the patches that are compared
  float wide_k = 0;  ///< the same over wide_radius, where far less than the noise of a patch shows; 0: not compared
  int wide_radius = 12;
  float relative = 0;   ///< part of the mean's square that counts as equal
  float floor = 1e-8f;  ///< squared difference that counts as equal
};

/// Weights in [0, 1] of the values `there`, with variance `there_variance`, that belong to the pixels of `here`. Both
/// have three channels, variances one; `valid` is 1 or 0.
Planes likeness_weights(const Planes& here, const Planes& here_variance, const Planes& there,
                        const Planes& there_variance, const Planes& valid, const Likeness& likeness);

/// sum += weight * value, for all channels.
void add_weighted(const Planes& value, const Planes& weight, Planes& sum);
/// Divides all channels by one plane.
void divide(Planes& sum, const Planes& by);

}  // namespace tempera::denoise
