// SPDX-License-Identifier: Apache-2.0
#include "tempera/stages/cosine_transform.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "tempera/core/vec.h"

namespace tempera {
namespace {

constexpr int kLanes = CosineTransform::kLanes, kHalf = kLanes / 2;  // element: kHalf real parts, kHalf imaginary ones
constexpr int kLargestRadix = 31;

/// Complex numbers of kHalf lanes in registers (vectors of GCC and Clang).
using Vector = float __attribute__((vector_size(kHalf * sizeof(float))));
struct Lanes {
  Vector re, im;
};
TEMPERA_INLINE Vector load_vector(const float* p) {
  Vector v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
TEMPERA_INLINE void store_vector(float* p, const Vector& v) { std::memcpy(p, &v, sizeof v); }
TEMPERA_INLINE Lanes load(const float* p) { return {load_vector(p), load_vector(p + kHalf)}; }
/// With real and imaginary part exchanged: that turns a transform into its inverse when done before and after it.
TEMPERA_INLINE Lanes load_exchanged(const float* p) { return {load_vector(p + kHalf), load_vector(p)}; }
TEMPERA_INLINE void store(float* p, const Lanes& z) { store_vector(p, z.re), store_vector(p + kHalf, z.im); }
TEMPERA_INLINE void store_exchanged(float* p, const Lanes& z) { store_vector(p, z.im), store_vector(p + kHalf, z.re); }
TEMPERA_INLINE Lanes operator+(const Lanes& a, const Lanes& b) { return {a.re + b.re, a.im + b.im}; }
TEMPERA_INLINE Lanes operator-(const Lanes& a, const Lanes& b) { return {a.re - b.re, a.im - b.im}; }
TEMPERA_INLINE Lanes operator*(float s, const Lanes& a) { return {s * a.re, s * a.im}; }
/// -i a
TEMPERA_INLINE Lanes minus_i(const Lanes& a) { return {a.im, -a.re}; }
template <class C>
TEMPERA_INLINE Lanes times(const C& w, const Lanes& a) {
  return {w.re * a.re - w.im * a.im, w.re * a.im + w.im * a.re};
}

double unit_angle(long long k, long long n) { return 2 * kPiD * double(k % n) / double(n); }

}  // namespace

std::vector<CosineTransform::Stage> CosineTransform::make_plan(int n) {
  std::vector<Stage> plan;
  int left = n, stride = 1;
  const auto add = [&](int radix) {
    Stage s{radix, left / radix, stride, {}, {}};
    for (int p = 0; p < s.rest; ++p) {
      for (int j = 0; j < radix; ++j) {
        const double a = unit_angle(static_cast<long long>(p) * j, left);
        s.twiddle.push_back({float(std::cos(a)), float(-std::sin(a))});
      }
    }
    for (int k = 0; k < radix; ++k) {
      s.root.push_back({float(std::cos(unit_angle(k, radix))), float(-std::sin(unit_angle(k, radix)))});
    }
    plan.push_back(std::move(s));
    left /= radix, stride *= radix;
  };
  while (left % 4 == 0) add(4);
  for (int radix = 2; left > 1; ++radix) {
    while (left % radix == 0) add(radix);
  }
  return plan;
}

float* CosineTransform::stages(const std::vector<Stage>& plan, float* a, float* b) {
  for (const Stage& s : plan) {
    const std::ptrdiff_t in = std::ptrdiff_t(s.stride) * s.rest * kLanes, out = std::ptrdiff_t(s.stride) * kLanes;
    for (int p = 0; p < s.rest; ++p) {
      const Complex* w = s.twiddle.data() + std::ptrdiff_t(p) * s.radix;
      const float* x = a + std::ptrdiff_t(p) * out;
      float* y = b + std::ptrdiff_t(p) * s.radix * out;
      for (int q = 0; q < s.stride; ++q, x += kLanes, y += kLanes) {
        switch (s.radix) {
          case 2: {
            const Lanes u = load(x), v = load(x + in);
            store(y, u + v);
            store(y + out, times(w[1], u - v));
            break;
          }
          case 3: {
            constexpr float kSin = 0.866025403784438647f;
            const Lanes u = load(x), v = load(x + in), t = load(x + 2 * in);
            const Lanes sum = v + t, mid = u - 0.5f * sum, side = kSin * minus_i(v - t);
            store(y, u + sum);
            store(y + out, times(w[1], mid + side));
            store(y + 2 * out, times(w[2], mid - side));
            break;
          }
          case 4: {
            const Lanes u = load(x), v = load(x + in), t = load(x + 2 * in), r = load(x + 3 * in);
            const Lanes even = u + t, odd = u - t, sum = v + r, side = minus_i(v - r);
            store(y, even + sum);
            store(y + out, times(w[1], odd + side));
            store(y + 2 * out, times(w[2], even - sum));
            store(y + 3 * out, times(w[3], odd - side));
            break;
          }
          case 5: {
            constexpr float kCos1 = 0.309016994374947424f, kCos2 = -0.809016994374947424f;
            constexpr float kSin1 = 0.951056516295153572f, kSin2 = 0.587785252292473129f;
            const Lanes u = load(x), v1 = load(x + in), v2 = load(x + 2 * in), v3 = load(x + 3 * in),
                        v4 = load(x + 4 * in);
            const Lanes s1 = v1 + v4, s2 = v2 + v3, d1 = minus_i(v1 - v4), d2 = minus_i(v2 - v3);
            const Lanes m1 = u + kCos1 * s1 + kCos2 * s2, m2 = u + kCos2 * s1 + kCos1 * s2;
            const Lanes n1 = kSin1 * d1 + kSin2 * d2, n2 = kSin2 * d1 - kSin1 * d2;
            store(y, u + s1 + s2);
            store(y + out, times(w[1], m1 + n1));
            store(y + 2 * out, times(w[2], m2 + n2));
            store(y + 3 * out, times(w[3], m2 - n2));
            store(y + 4 * out, times(w[4], m1 - n1));
            break;
          }
          default:
            for (int j = 0; j < s.radix; ++j) {
              Lanes sum = load(x);
              for (int k = 1; k < s.radix; ++k) {
                sum = sum + times(s.root[j * k % s.radix], load(x + k * in));
              }
              store(y + j * out, times(w[j], sum));
            }
        }
      }
    }
    std::swap(a, b);
  }
  return a;
}

CosineTransform::CosineTransform(int length) : n_(length) {
  for (int k = 0; k < n_; ++k) {
    const double a = kPiD * k / (2.0 * n_);
    quarter_.push_back({float(std::cos(a)), float(std::sin(a))});
  }
  int largest = 1, left = n_;
  for (int f = 2; left > 1; ++f) {
    while (left % f == 0) left /= f, largest = f;
  }
  if (largest <= kLargestRadix) {
    plan_ = make_plan(n_);
    return;
  }
  padded_ = 1;
  while (padded_ < 2 * n_ - 1) padded_ *= 2;
  plan_ = make_plan(padded_);
  std::vector<float> a(padded_ * kLanes), b(a.size());
  for (int k = 0; k < n_; ++k) {
    const double angle = unit_angle(static_cast<long long>(k) * k, 2LL * n_);
    chirp_.push_back({float(std::cos(angle)), float(-std::sin(angle))});
    for (const int at : {k, (padded_ - k) % padded_}) {
      a[at * kLanes] = float(std::cos(angle));
      a[at * kLanes + kHalf] = float(std::sin(angle));
    }
  }
  const float* f = stages(plan_, a.data(), b.data());
  for (int k = 0; k < padded_; ++k) {
    const float scale = 1.0f / float(padded_);
    filter_.push_back({scale * f[k * kLanes], scale * f[k * kLanes + kHalf]});
  }
}

void CosineTransform::fourier(float* data, float* work) const {
  const int values = n_ * kLanes;
  if (padded_ == 0) {
    const float* result = stages(plan_, data, work);
    if (result != data) std::copy_n(result, values, data);
    return;
  }
  // A product with a chirp, a cyclic convolution with its conjugate, and a product again.
  float *a = work, *b = work + padded_ * kLanes;
  for (int k = 0; k < n_; ++k) store(a + k * kLanes, times(chirp_[k], load(data + k * kLanes)));
  std::fill(a + values, b, 0.0f);
  float* f = stages(plan_, a, b);
  float* other = f == a ? b : a;
  for (int k = 0; k < padded_; ++k) {
    store_exchanged(f + k * kLanes, times(filter_[k], load(f + k * kLanes)));
  }
  f = stages(plan_, f, other);
  for (int k = 0; k < n_; ++k) {
    store(data + k * kLanes, times(chirp_[k], load_exchanged(f + k * kLanes)));
  }
}

void CosineTransform::forward(float* data, Scratch& scratch) const {
  const int values = n_ * kLanes;
  scratch.resize(values + std::max(values, 2 * padded_ * kLanes));
  float *v = scratch.data(), *work = v + values;
  for (int k = 0; 2 * k < n_; ++k) std::copy_n(data + 2 * k * kLanes, kLanes, v + k * kLanes);
  for (int k = 0; 2 * k + 1 < n_; ++k) std::copy_n(data + (2 * k + 1) * kLanes, kLanes, v + (n_ - 1 - k) * kLanes);
  fourier(v, work);
  const float first = float(std::sqrt(1.0 / n_)), rest = float(std::sqrt(0.5 / n_));
  store(data, first * load(v));
  for (int k = 1; 2 * k <= n_; ++k) {
    // The transforms a and b of the sequences in the real and in the imaginary part.
    const Lanes z = load(v + k * kLanes), y = load(v + (n_ - k) * kLanes);
    const Lanes a{z.re + y.re, z.im - y.im}, b{z.im + y.im, y.re - z.re};
    const float c = rest * quarter_[k].re, s = rest * quarter_[k].im;
    store(data + k * kLanes, {c * a.re + s * a.im, c * b.re + s * b.im});
    if (2 * k < n_) store(data + (n_ - k) * kLanes, {s * a.re - c * a.im, s * b.re - c * b.im});
  }
}

void CosineTransform::inverse(float* data, Scratch& scratch) const {
  const int values = n_ * kLanes;
  scratch.resize(values + std::max(values, 2 * padded_ * kLanes));
  float *v = scratch.data(), *work = v + values;
  const float first = float(std::sqrt(1.0 / n_)), rest = float(std::sqrt(0.5 / n_));
  store_exchanged(v, first * load(data));
  for (int k = 1; 2 * k <= n_; ++k) {
    const float c = rest * quarter_[k].re, s = rest * quarter_[k].im;
    const Lanes low = load(data + k * kLanes), high = load(data + (n_ - k) * kLanes);
    const Lanes a{c * low.re + s * high.re, s * low.re - c * high.re};
    const Lanes b{c * low.im + s * high.im, s * low.im - c * high.im};
    store_exchanged(v + k * kLanes, {a.re - b.im, a.im + b.re});
    store_exchanged(v + (n_ - k) * kLanes, {a.re + b.im, b.re - a.im});
  }
  fourier(v, work);
  for (int k = 0; 2 * k < n_; ++k) store(data + 2 * k * kLanes, load_exchanged(v + k * kLanes));
  for (int k = 0; 2 * k + 1 < n_; ++k) store(data + (2 * k + 1) * kLanes, load_exchanged(v + (n_ - 1 - k) * kLanes));
}

}  // namespace tempera
