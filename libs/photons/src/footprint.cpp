// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/footprint.h"

#include <algorithm>
#include <cmath>

namespace tempera {

namespace {

constexpr float kGaussianReach = 1.5f;          // of y
constexpr float kGaussianWithin = 0.98889101f;  // 1 - exp(-3 * 1.5)
/// Sweeps shorter than this in filter space stand still.
constexpr float kLeastSweep = 1e-3f;

/// Integral of the kernel along a line through the center of filter space.
float line_integral(SpatialKernel kernel) {
  switch (kernel) {
    case SpatialKernel::kUniform:
      return 2;
    case SpatialKernel::kEpanechnikov:
      return 8.0f / 3;
    case SpatialKernel::kBiweight:
      return 16.0f / 5;
    case SpatialKernel::kGaussian:
      return 3.0960861f;  // 3 sqrt(pi / 3) erf(sqrt(4.5)) / kGaussianWithin
  }
  return 0;
}

/// Integral of K(rho^2 + x^2) (1 + slope x) over the part of [a, b] within the support, whose half length is c.
float chord(SpatialKernel kernel, float rho2, float c2, float c, float a, float b, float constant, float slope) {
  a = std::max(a, -c), b = std::min(b, c);
  if (!(a < b)) return 0;
  const auto primitive = [&](float x) {
    const float x2 = x * x;
    switch (kernel) {
      case SpatialKernel::kUniform:
        return x * (constant + 0.5f * slope * x);
      case SpatialKernel::kEpanechnikov:
        return x * (2 * constant * (c2 - x2 * (1.0f / 3)) + slope * x * (c2 - 0.5f * x2));
      case SpatialKernel::kBiweight: {
        const float left = c2 - x2;
        return 3 * constant * x * (c2 * c2 - x2 * (c2 * (2.0f / 3) - x2 * 0.2f)) - 0.5f * slope * left * left * left;
      }
      case SpatialKernel::kGaussian: {
        constexpr float kRoot3 = 1.7320508f;
        return std::exp(-3 * rho2) / kGaussianWithin *
               (constant * (3 * 0.8862269f / kRoot3) * std::erf(kRoot3 * x) - 0.5f * slope * std::exp(-3 * x2));
      }
    }
    return 0.0f;
  };
  return std::max(primitive(b) - primitive(a), 0.0f);
}

/// Integral of f from a to b: Gauss and Legendre's five points.
template <class F>
float gauss_legendre(float a, float b, F&& f) {
  constexpr std::array<float, 3> kAt{0, 0.5384693101f, 0.9061798459f};
  constexpr std::array<float, 3> kWeight{0.5688888889f, 0.4786286705f, 0.2369268851f};
  const float middle = 0.5f * (a + b), half = 0.5f * (b - a);
  float sum = kWeight[0] * f(middle);
  for (int i = 1; i < 3; ++i) sum += kWeight[i] * (f(middle - half * kAt[i]) + f(middle + half * kAt[i]));
  return sum * half;
}

float flux_factor(float rate, float sigma) { return std::max(0.0f, 1 + rate * sigma); }

}  // namespace

float spatial_kernel(SpatialKernel kernel, float y) {
  if (kernel == SpatialKernel::kGaussian) return y < kGaussianReach ? 3 / kGaussianWithin * std::exp(-3 * y) : 0.0f;
  if (!(y < 1)) return 0;
  switch (kernel) {
    case SpatialKernel::kUniform:
      return 1;
    case SpatialKernel::kEpanechnikov:
      return 2 * (1 - y);
    default:
      return 3 * sqr(1 - y);
  }
}

float support(SpatialKernel kernel) { return kernel == SpatialKernel::kGaussian ? std::sqrt(kGaussianReach) : 1.0f; }

float time_weight(TimeFilter filter, SpatialKernel kernel, float s) {
  if (filter == TimeFilter::kBox) return 1;
  const float y = s * s;
  switch (kernel) {
    case SpatialKernel::kUniform:
      return 1;
    case SpatialKernel::kEpanechnikov:
      return 1.5f * (1 - y);
    case SpatialKernel::kBiweight:
      return 15.0f / 8 * sqr(1 - y);
    case SpatialKernel::kGaussian:
      return 1.16877f * std::exp(-0.5f * y);
  }
  return 0;
}

FootprintAxes footprint_axes(std::span<const Vec3d> columns, const Vec3d& n, double least, double most, bool* clamped) {
  const auto [s, t] = tangents_of(n);
  double a = 0, b = 0, c = 0;  // of the matrix [a b; b c]
  for (const Vec3d& column : columns) {
    const double x = dot(column, s), y = dot(column, t);
    a += x * x, b += x * y, c += y * y;
  }
  const double mean = 0.5 * (a + c), half = 0.5 * (a - c), r = std::sqrt(half * half + b * b);
  // The eigenvector of mean + r.
  Vec2d e = half >= 0 ? Vec2d{half + r, b} : Vec2d{b, r - half};
  const double l = length(e);
  e = l > 0 ? e * (1 / l) : Vec2d{1, 0};
  const double first = std::sqrt(std::max(mean + r, 0.0));
  // The product of the eigenvalues is the determinant, without the loss of digits of mean - r.
  const double second = first > 0 ? std::sqrt(std::max(a * c - b * b, 0.0)) / first : 0;
  const double la = std::clamp(first, 2 * least, 2 * most), lb = std::clamp(second, 2 * least, 2 * most);
  if (clamped) *clamped = la != first || lb != second;
  return {Vec3f((s * e.x + t * e.y) * la), Vec3f((t * e.x - s * e.y) * lb)};
}

Footprint::Footprint(const Vec3f& p, const FootprintAxes& axes, const Vec3f& velocity) : center(p) {
  const float aa = dot(axes.a, axes.a), bb = dot(axes.b, axes.b);
  m1 = axes.a * (2 / aa);
  m2 = axes.b * (2 / bb);
  w = to_filter(velocity);
  const float speed = length(w);
  slowness = speed > 0 ? 1 / speed : 0.0f;
  inverse_area = 4 / (kPi * std::sqrt(aa * bb));
}

FootprintAxes Footprint::half_axes() const { return {m1 * (1 / dot(m1, m1)), m2 * (1 / dot(m2, m2))}; }

Vec3f Footprint::velocity() const {
  const FootprintAxes h = half_axes();
  return h.a * w.x + h.b * w.y;
}

float instant_density(const Footprint& f, SpatialKernel kernel, const Vec3f& offset, float sigma, float rate) {
  const Vec2f z = f.to_filter(offset) - f.w * sigma;
  return spatial_kernel(kernel, dot(z, z)) * f.inverse_area * flux_factor(rate, sigma);
}

float swept_density(const Footprint& f, const KernelSettings& k, const Vec3f& offset, float rate) {
  const float begin = float(k.begin), end = float(k.end), span = end - begin;
  const Vec2f z0 = f.to_filter(offset);
  const float reach2 = sqr(support(k.kernel)), y0 = dot(z0, z0);
  if (f.slowness == 0 || !(span > kLeastSweep * f.slowness)) {
    const float middle = 0.5f * (begin + end);
    const Vec2f z = z0 - f.w * middle;
    return spatial_kernel(k.kernel, dot(z, z)) * f.inverse_area * flux_factor(rate, middle);
  }
  const Vec2f e = f.w * f.slowness;
  const float along = dot(z0, e), rho2 = std::max(y0 - along * along, 0.0f), c2 = reach2 - rho2;
  if (k.sweep != Sweep::kPublished && !(c2 > 0)) return 0;  // beside its way
  const float speed = dot(f.w, e), far = std::max(std::abs(begin), std::abs(end));
  const auto weight = [&](float sigma) {
    return flux_factor(rate, sigma) * time_weight(k.filter, k.kernel, std::min(std::abs(sigma) / far, 1.0f));
  };
  if (k.sweep == Sweep::kLine) {
    // [Schjoth 2010, Eq. 8] with its kernel at every instant instead of the nearest one.
    const float a = begin * speed - along, b = end * speed - along, c = std::sqrt(c2);
    const float scale = f.inverse_area * f.slowness / span;
    if (k.filter == TimeFilter::kBox && 1 + rate * begin >= 0 && 1 + rate * end >= 0) {
      const float slope = rate * f.slowness;
      return chord(k.kernel, rho2, c2, c, a, b, 1 + slope * along, slope) * scale;
    }
    const float lo = std::max(a, -c), hi = std::min(b, c);
    if (!(lo < hi)) return 0;
    return scale * gauss_legendre(lo, hi, [&](float xi) {
             return spatial_kernel(k.kernel, rho2 + xi * xi) * weight((xi + along) * f.slowness);
           });
  }
  const float sweep = speed * span;
  const float area = 1 / f.inverse_area;
  if (k.sweep == Sweep::kClamped) {
    const float sigma = std::clamp(dot(z0, f.w) / (speed * speed), begin, end);
    const Vec2f z = z0 - f.w * sigma;
    const float kappa = line_integral(k.kernel);
    float ends = kPi, way = kappa * sweep;
    if (k.filter != TimeFilter::kBox) {
      const auto at = [&](float s) { return time_weight(k.filter, k.kernel, std::min(std::abs(s) / far, 1.0f)); };
      ends = 0.5f * kPi * (at(begin) + at(end));
      way *= gauss_legendre(begin, end, at) / span;
    }
    return spatial_kernel(k.kernel, dot(z, z)) * weight(sigma) / (area * kInvPi * (ends + way));
  }
  // [Schjoth 2010, Eq. 7]; the kernel's length across the way is that of the chord through the center.
  const Vec3f velocity = f.velocity();
  const float v2 = dot(velocity, velocity);
  const float sigma = std::clamp(dot(offset, velocity) / v2, begin, end);
  const Vec2f z = z0 - f.w * sigma;
  const Vec3f n = cross(f.m1, f.m2), across = normalize(cross(n, velocity));
  const float l = 2 / length(f.to_filter(across));
  return spatial_kernel(k.kernel, dot(z, z)) * weight(sigma) / (area + l * std::sqrt(v2) * span);
}

Bounds3f footprint_bounds(const Footprint& f, const KernelSettings& k, const Vec3f& n, float thickness) {
  const FootprintAxes h = f.half_axes();
  const float reach = support(k.kernel) * (1 + 1e-4f);
  Vec3f half;
  for (int j = 0; j < 3; ++j)
    half[j] = reach * std::sqrt(sqr(h.a[j]) + sqr(h.b[j])) + std::abs(n[j]) * thickness + 1e-6f * std::abs(f.center[j]);
  const Vec3f velocity = f.velocity();
  Bounds3f r;
  for (const double sigma : {k.begin, k.end}) {
    const Vec3f c = f.center + velocity * float(sigma);
    r.extend(c - half);
    r.extend(c + half);
  }
  return r;
}

}  // namespace tempera
