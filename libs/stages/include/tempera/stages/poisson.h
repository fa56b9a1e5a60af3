// SPDX-License-Identifier: Apache-2.0
#pragma once
// Spatio-temporal screened Poisson reconstruction of a window of frames in memory: the frames that fit sampled radiance
// and its sampled differences in x, y, t, xt and yt best. Files and sequences are in reconstruct.h.
//
// Symbols of [Manzi 2016]: I^g -> RowSet::kPrimal, I^dx I^dy I^dt I^dxdt I^dydt -> the other row sets, alpha ->
// PoissonWeights::alpha, A -> the rows of a PoissonSystem, phi -> PoissonFrame::motion.
#include <array>
#include <bit>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <stop_token>
#include <vector>

#include "tempera/stages/motion_runs.h"
#include "tempera/stages/row_block.h"

namespace tempera {

/// The kinds of rows of A. Row (set, i, t) and its datum b:
///   kPrimal  alpha x_t[i]                                       = alpha I^g
///   kDx, kDy x_t[i + e] - x_t[i]                                = I^d       where i + e is in the picture
///   kDt      x_t'[phi i] - x_t[i]                               = I^dt      where phi i exists; t' = t + 1
///   kDxDt, kDyDt  x_t'[phi i + e] - x_t'[phi i] - x_t[i + e] + x_t[i] = I^ddt  where a MotionRun says so
/// Rows that do not exist have neither coefficients nor weight, and their data are not read.
enum class RowSet { kPrimal, kDx, kDy, kDt, kDxDt, kDyDt };
inline constexpr int kRowSets = 6;

/// RGB of several frames of one size, in planes.
class PlanarFrames {
 public:
  PlanarFrames() = default;
  PlanarFrames(int width, int height, int frames)
      : height_(height), frames_(frames), block_(width, std::int64_t(3) * height * frames) {}
  int width() const { return block_.width(); }
  int height() const { return height_; }
  int frames() const { return frames_; }
  /// The values of channel `c` in row `y` of frame `t`.
  float* row(int t, int y, int c) { return block_.row((std::int64_t(t) * height_ + y) * 3 + c); }
  const float* row(int t, int y, int c) const { return block_.row((std::int64_t(t) * height_ + y) * 3 + c); }
  int stride() const { return block_.stride(); }
  std::size_t bytes() const { return block_.bytes(); }

 private:
  int height_ = 0, frames_ = 0;
  RowBlock<float> block_;
};

/// The upper half of a float, rounded to nearest: weights need range, and no more than eight bits of mantissa.
using BFloat16 = std::uint16_t;
inline float to_float(BFloat16 v) { return std::bit_cast<float>(std::uint32_t(v) << 16); }

/// A factor of a weight, with five bits of mantissa: 0, or from 0.00104 to 62. Every row of a window has one, and none
/// is known better than that.
struct Precision {
  static constexpr std::uint32_t kBase = (127 - 10) << 4;  ///< the exponent of the least values, as a float has it
  std::uint8_t bits = 0;                                   ///< four of the exponent, four of the mantissa
};
inline float to_float(Precision v) {
  return v.bits ? std::bit_cast<float>((std::uint32_t(v.bits) + Precision::kBase) << 19) : 0.0f;
}
/// The nearest one; positive values out of the range become its end. Pre: v >= 0, not NaN.
Precision to_precision(float v);

/// One frame of a window: the data of its rows, and where its pixels are in the next frame.
class PoissonFrame {
 public:
  PoissonFrame(int width, int height) : height_(height), data_(width, std::int64_t(kRowSets) * 3 * height) {}
  int width() const { return data_.width(); }
  int height() const { return height_; }
  /// b of channel `c` in row `y`, indexed by the pixel i of this frame. Units: radiance.
  float* data(RowSet set, int y, int c) { return data_.row(index(set, y, c)); }
  const float* data(RowSet set, int y, int c) const { return data_.row(index(set, y, c)); }
  std::size_t bytes() const { return data_.bytes() + precision_.bytes(); }

  /// Sets the precision of the rows of a set at the pixels of row `y`, from the first one on: their squared weights are
  /// multiplied by it. Statistically it is a reference variance over that of the datum. 1 for all rows until this is
  /// called; then 0 for those that it was not called for. Pre: values >= 0; all frames of a window have precisions, or
  /// none.
  void set_precision(RowSet set, int y, std::span<const float> values);
  bool has_precision() const { return precision_.rows() > 0; }
  const Precision* precision(RowSet set, int y) const { return precision_.row(row_of(set, y)); }

  /// To the next frame. Without runs (as constructed) there are no rows between the frames.
  MotionRuns motion;

 private:
  static std::int64_t row_of(RowSet set, int y) { return std::int64_t(y) * kRowSets + int(set); }
  static std::int64_t index(RowSet set, int y, int c) { return row_of(set, y) * 3 + c; }
  int height_;
  RowBlock<float> data_;
  RowBlock<Precision> precision_;
};

/// Weights of the kinds of rows, inside of the norm: alpha 0.2 makes the primal rows count 0.04 in the normal
/// equations.
struct PoissonWeights {
  float alpha = 0.2f;  ///< of kPrimal, > 0
  float spatial = 1;   ///< of kDx and kDy, >= 0
  float temporal = 1;  ///< of kDt
  float mixed = 1;     ///< of kDxDt and kDyDt
  float of(RowSet set) const {
    return set == RowSet::kPrimal ? alpha : set <= RowSet::kDy ? spatial : set == RowSet::kDt ? temporal : mixed;
  }
};

/// Dot products of the three channels of frames.
using ChannelSums = std::array<double, 3>;

/// The rows of a window with their weights W; A is never stored.
/// Result:  the same bits for any number of threads. Threads: members use parallel_for; one call at a time.
class PoissonSystem {
 public:
  /// Uniform weights. Keeps the frames' addresses. Pre: at least one frame, all of one size.
  PoissonSystem(std::span<const PoissonFrame* const> window, const PoissonWeights& weights);

  int width() const { return window_[0]->width(); }
  int height() const { return window_[0]->height(); }
  int frames() const { return int(window_.size()); }

  /// out = A^T W^2 A p. Returns through the references sum(p out) and sum(out out / D), where D is the preconditioner.
  /// Pre: p != out.
  void apply(const PlanarFrames& p, PlanarFrames& out, ChannelSums& p_out, ChannelSums& out_out) const;
  /// out = A^T W^2 (b - A x), the steepest descent of the squared error. Returns sum(out out / D).
  ChannelSums descent(const PlanarFrames& x, PlanarFrames& out) const;
  /// 1 / D for row `y` of frame t: the diagonal of A^T W^2 A. Null for uniform weights, where the diagonal is all but
  /// constant and D is 1.
  const float* inverse_diagonal(int t, int y) const {
    return stored_ ? inverse_diagonal_.row(std::int64_t(t) * height() + y) : nullptr;
  }

  /// Weights of iteratively reweighted least squares for the sum of norms |W0 (A x - b)| of RGB vectors, where W0 are
  /// the weights without reweighting: W^2 = scale W0^2 / (|W0 (A x - b)| + epsilon). The minimum of the reweighted
  /// squares moves to that of Fair's loss, which is quadratic below epsilon and linear above.
  /// Source: [Manzi 2016, Eq. 3], p = 1. Returns the sum of norms at x, over all rows. Pre: epsilon > 0.
  double reweight(const PlanarFrames& x, double epsilon, double scale);
  /// Weights that depend on the set alone.
  void set_uniform() { stored_ = false; }
  /// Those times the precisions of the rows. Pre: the frames have them.
  void set_precise();

  /// W^2 of the row of `set` at pixel (x, y) of frame t, which exists.
  float squared_weight(RowSet set, int t, int x, int y) const;

  /// Leaves out the rows between frames, or takes them in again.
  void set_linked(bool linked) { linked_ = linked; }
  bool linked() const { return linked_; }
  /// Whether all frames are linked pixel by pixel without motion, or none: then uniform weights make A^T A diagonal
  /// under a cosine transform.
  bool is_separable() const;

  const PoissonWeights& weights() const { return weights_; }

 private:
  /// From frame t to the next one; null where there are no rows between them.
  const MotionRuns* motion_from(int t) const;
  void store_weights();
  void invert_diagonal();
  /// W^2 of the rows of `set` at the pixels of row y of frame t, once weights are stored.
  BFloat16* squared_row(RowSet set, int t, int y) { return squared_.row(squared_index(set, t, y)); }
  const BFloat16* squared_row(RowSet set, int t, int y) const { return squared_.row(squared_index(set, t, y)); }
  std::int64_t squared_index(RowSet set, int t, int y) const {
    return (std::int64_t(t) * height() + y) * kRowSets + int(set);
  }
  template <bool kStored, bool kData>
  void descend(const PlanarFrames& x, PlanarFrames& out, ChannelSums& x_out, ChannelSums& out_out) const;

  std::vector<const PoissonFrame*> window_;
  PoissonWeights weights_;
  bool stored_ = false, linked_ = true;
  RowBlock<BFloat16> squared_;        // W^2, rows (t, y, set)
  RowBlock<float> inverse_diagonal_;  // rows (t, y)
};

enum class PoissonNorm {
  kL1,  ///< sum of norms of RGB residuals: robust, slightly biased
  kL2,  ///< sum of squares: unbiased
};

enum class PoissonDevice {
  kCpu,
  kCuda,  ///< the same but for rounding, on the first CUDA device
};
/// Whether this is a build with CUDA (-DTEMPERA_CUDA=ON), and the machine has a device.
bool has_cuda();

struct PoissonSettings {
  PoissonDevice device = PoissonDevice::kCpu;
  PoissonNorm norm = PoissonNorm::kL1;
  PoissonWeights weights;
  int l2_steps = 20;  ///< conjugate gradient steps of kL2
  /// Starts from each frame's own solution, which a cosine transform gives exactly at the cost of about four steps,
  /// instead of the given start: worth ten steps or more.
  bool direct_start = true;
  /// kL1: rounds of reweighting (the first one has uniform weights), and steps in each.
  int rounds = 6, round_steps = 15;
  /// kL1: epsilon of round k = 1, 2, ... is max(epsilon_floor, epsilon / 2^(k - 1)), in units of the window's mean
  /// luminance if `relative`, else of radiance.
  double epsilon = 0.05, epsilon_floor = 0.02;
  bool relative = true;

  /// The schedule of the authors' program: 20 rounds of 50 steps, epsilon halved from an absolute 0.05 without floor;
  /// 50 steps for kL2.
  static PoissonSettings published();
};

struct PoissonReport {
  int steps = 0;         ///< of conjugate gradients
  bool direct = false;   ///< whether a cosine transform solved uniform weights exactly
  double residual = 0;   ///< of the last round's normal equations, relative to that round's start
  double objective = 0;  ///< kL1: sum of norms before the last round
};

/// Called with the share of a window's work that is done, after each step. May throw, which ends the solution.
using PoissonProgress = std::function<void(double share)>;

/// Solves a window.
/// Shapes:  x: the window's size and frames; in: the start (the primal data serve), out: the solution.
/// Units:   radiance.
/// Result:  the same bits for any number of threads. Exact data keep an exact start unchanged.
/// Errors:  Error{kCancelled} after `stop`; with kCuda Error{kUnsupported} without has_cuda(), Error{kOutOfMemory}.
/// Source:  [Manzi 2016, Sec. 3.3]; [Chen 2020] for conjugate gradients with one pass over memory for all vectors.
PoissonReport solve_poisson(std::span<const PoissonFrame* const> window, const PoissonSettings& settings,
                            PlanarFrames& x, std::stop_token stop = {}, const PoissonProgress& progress = {});

}  // namespace tempera
