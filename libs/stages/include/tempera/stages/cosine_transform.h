// SPDX-License-Identifier: Apache-2.0
#pragma once
// Discrete cosine transforms of any length, sixteen sequences side by side so that every step is a vector operation:
// the eigenvectors of differences with free ends. Not a general FFT library.
#include <vector>

namespace tempera {

/// Orthonormal DCT-II of sequences of one length, and its inverse.
/// Source: [Makhoul 1980] reduces it to a Fourier transform of the same length, here of two sequences at a time as real
/// and imaginary part; that is a Stockham transform of mixed radix, or [Bluestein 1970] for large prime factors.
/// Threads: const members are safe, with a scratch each.
class CosineTransform {
 public:
  static constexpr int kLanes = 16;
  /// Pre: length >= 1.
  explicit CosineTransform(int length);

  int length() const { return n_; }
  /// Working memory of one thread.
  using Scratch = std::vector<float>;
  /// X[k] = s_k sum_n x[n] cos(pi (2 n + 1) k / (2 N)) with s_0 = sqrt(1/N), else sqrt(2/N), in place.
  /// Shapes: data is [length, kLanes], aligned to 64 bytes.
  void forward(float* data, Scratch& scratch) const;
  void inverse(float* data, Scratch& scratch) const;

 private:
  struct Complex {
    float re = 0, im = 0;
  };
  struct Stage {
    int radix, rest, stride;       ///< the length that is left is radix * rest
    std::vector<Complex> twiddle;  ///< [rest, radix]: exp(-2 pi i p j / (radix rest))
    std::vector<Complex> root;     ///< [radix]: exp(-2 pi i k / radix), for radices without code of their own
  };
  /// Plain transform by stages; the result is in `a` or `b`, whichever is returned.
  static float* stages(const std::vector<Stage>& plan, float* a, float* b);
  static std::vector<Stage> make_plan(int n);
  /// Fourier transform of n_ complex lanes, in place in `data` with `work` as long as scratch_size_.
  void fourier(float* data, float* work) const;

  int n_;
  std::vector<Complex> quarter_;  ///< exp(i pi k / (2 N))
  std::vector<Stage> plan_;       ///< of n_, or of the padded length for Bluestein's algorithm
  int padded_ = 0;                ///< 0: plain
  std::vector<Complex> chirp_;    ///< exp(-i pi k^2 / n)
  std::vector<Complex> filter_;   ///< transform of the conjugate chirp / padded length
};

}  // namespace tempera
