// SPDX-License-Identifier: Apache-2.0
#pragma once
// The shot's time axis: double seconds. Frame numbers exist only here and in file names.
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace tempera {

/// Closed interval of seconds on the shot's axis; begin <= end.
struct TimeSpan {
  double begin = 0;
  double end = 0;
  double length() const { return end - begin; }
  bool contains(double t) const { return begin <= t && t <= end; }
  bool operator==(const TimeSpan&) const = default;
};

enum class ShutterShape { kBox, kTrapezoid, kCurve };

/// Consecutive frames, first to last, numbered as the files are; first <= last.
struct FrameRange {
  int first = 0, last = 0;
  bool contains(int frame) const { return first <= frame && frame <= last; }
  bool operator==(const FrameRange&) const = default;
};

/// When light reaches the film within a frame. Fractions of a frame relative to the frame's time.
struct Shutter {
  double open = 0;     ///< start of exposure
  double close = 0.5;  ///< end of exposure, >= open; equal means an instantaneous shutter
  ShutterShape shape = ShutterShape::kBox;
  double ramp_in = 0.25, ramp_out = 0.25;  ///< trapezoid: fractions of the exposure spent opening and closing
  std::vector<float> curve;                ///< kCurve: transmittance at equally spaced times, piecewise linear
  double rolling = 0;  ///< rolling shutter: delay of the last scan line against the first, in frames

  /// Maps u in [0,1) to a position in [0,1] of the exposure with density proportional to the shape's transmittance.
  double warp(double u) const;
  /// Density of warp(u) for uniform u at position x of the exposure: the transmittance, scaled so that it integrates to
  /// 1 over [0,1]; 0 outside.
  double density(double x) const;
  bool operator==(const Shutter&) const = default;
};

/// Maps frame numbers to seconds: time(f) = (f - first) / fps + start.
struct FrameClock {
  double fps = 24;
  int first = 0;     ///< frame number that stands at `start`
  double start = 0;  ///< seconds
  Shutter shutter;

  double time(int frame) const { return start + double(frame - first) / fps; }
  double frame_duration() const { return 1.0 / fps; }
  /// Seconds during which light of `frame` is gathered, over all scan lines.
  TimeSpan exposure(int frame) const;
  /// Time of shutter coordinate u in [0,1) for scan line v in [0,1] (0 top); `v` matters only for a rolling shutter.
  double exposure_time(int frame, double u, double v = 0) const;
  /// Frames whose exposure covers time t in some scan line, which are more than one if shutters overlap; empty if all
  /// are closed. With a rolling shutter each line of them has a part of that exposure only: see exposure_density.
  /// Result: clamped to what a frame number can be.
  std::optional<FrameRange> frames_open_at(double t) const;
  /// Density per second with which exposure_time(frame, u, v) falls on t for uniform u: the weight of light at time t
  /// in scan line v of the frame. Times that exposure_time() gives count as inside, rounding included. Pre: the shutter
  /// is open for some time (close > open); an instantaneous one has no density.
  double exposure_density(int frame, double t, double v = 0) const;
};

/// Expands "1-24", "1..24", "1-100x2", "1-100:2", comma lists of those, and negative numbers ("-5--1"), in the order
/// written, each frame once. Range: at most 10 million frames.
/// Errors: Error{kUsage} naming the part that cannot be read.
std::vector<int> parse_frame_set(std::string_view text);

/// The place for the frame number in the file name of `pattern`: a run of '#' or '@' (Blender, Katana), "%d" or "%04d"
/// (printf), "$F" or "$F4" (Houdini), "<frame>", "<F>" or "<F4>" (Maya, Karma). A single '@' counts only between dots,
/// as in "f.@.exr". The first one is meant if there are several.
struct FramePlace {
  std::size_t begin = 0, length = 0;  ///< length 0: there is none
  int width = 0;                      ///< digits, at least
};
FramePlace find_frame_place(std::string_view pattern);
/// Whether `pattern` names a place for the frame number.
bool has_frame_pattern(std::string_view pattern);
/// `pattern` with the number of the frame at its place; without a place `pattern` itself, which is then one file.
std::string frame_path(std::string_view pattern, int frame);
/// "f.####.exr" for "f.exr"; patterns with a place stay as they are.
std::string numbered_pattern(std::string_view pattern);

}  // namespace tempera
