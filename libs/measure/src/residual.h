// SPDX-License-Identifier: Apache-2.0
#pragma once
// Power spectra of residuals over time, from frames that are seen once, in order; private to the module.
//
// Welch's method [Welch 1967]: the frames are divided into segments that overlap by half, each is multiplied by a Hann
// window and transformed; the periodograms of all pixels and segments are averaged. Only the segments that are being
// filled are in memory, two at most, of as many pixels as the caller allows.
#include <cstdint>
#include <memory>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/frames/image.h"
#include "tempera/measure/compare.h"

namespace tempera {

/// Fewer frames in a row have no spectrum.
inline constexpr int kMinSpectrumFrames = 8;
inline constexpr int kMaxSegmentFrames = 64;

/// Segments of `length` frames that begin at `starts` and cover all of a number of frames.
struct Segments {
  int length = 0;
  std::vector<int> starts;
};
/// One segment of all frames if there are not more than kMaxSegmentFrames, otherwise ones of equal length that overlap
/// by half. Empty for less than kMinSpectrumFrames.
Segments plan_segments(int frames);

/// The pixels that are looked at: all, or one of each cell of stride x stride, at a place that differs from cell to
/// cell.
struct PixelChoice {
  struct Pixel {
    int x, y;
  };
  PixelChoice(int width, int height, int cell);
  int stride = 1;
  std::vector<Pixel> pixels;
  double coverage = 1;  ///< part of all pixels
};

/// Where the pixels of the first frame of a segment are in its later frames, along motion vectors.
class Tracks {
 public:
  explicit Tracks(const PixelChoice& choice);
  /// Moves on by a frame. `forward`: motion.forward of the frame that is left; `backward`: motion.backward of the one
  /// that is entered, null to trust every vector. Points that get lost stay so; without vectors (an empty image) all
  /// are.
  void advance(const Image& forward, const Image* backward);
  /// NaN for those that are lost.
  const std::vector<Vec2f>& positions() const { return positions_; }

 private:
  std::vector<Vec2f> positions_;
};

/// The sums of what spectrum_of turns into a ResidualSpectrum.
struct PowerSums {
  std::vector<double> power;  ///< of each frequency, over pixels and segments
  double pixels = 0;          ///< how many of them were counted
};

/// The residuals of one run over the frames of one segment. `Stored`: how they are kept in memory, as float or, where
/// they are in [-1,1] as those of displayed pictures, as std::int16_t in half the room: to 1/32767, an error of
/// 0.002/255.
template <class Stored>
class SegmentRecord {
 public:
  SegmentRecord(const Segments& segments, std::shared_ptr<const PixelChoice> choice);
  /// The next frame: luminance of test minus reference, at the chosen pixels or, if given, at the nearest pixels to
  /// `positions`, so that noise keeps its variance. Pixels that are lost or not finite drop out.
  void add(const Image& test, const Image& reference, const std::vector<Vec2f>* positions);
  bool full() const { return added_ == values_.height(); }
  /// Adds the power of the whole segment. Pre: full().
  void add_to(PowerSums& sums) const;

 private:
  int added_ = 0;
  std::shared_ptr<const PixelChoice> choice_;
  Grid<Stored> values_;  ///< a row for each frame, with the values of its pixels
};

/// The mean power of each frequency. Pre: sums of segments of `segments.length` frames.
ResidualSpectrum spectrum_of(std::string_view id, const Segments& segments, const PowerSums& sums, double coverage);

/// Power above `cutoff` cycles per frame.
double power_above(const ResidualSpectrum& spectrum, double cutoff);

}  // namespace tempera
