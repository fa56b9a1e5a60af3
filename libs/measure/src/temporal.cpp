// SPDX-License-Identifier: Apache-2.0
// What changes from one frame to the next, in place and along motion vectors.
#include <limits>

#include "motion.h"
#include "pixel_mean.h"

namespace tempera {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr Vec2f kNowhere{std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::quiet_NaN()};

/// A vector layer's validity channel is the last of X, Y, Z, V; layers without one are valid everywhere.
bool is_valid(const Image& vectors, int x, int y) { return vectors.channels() < 4 || vectors.at(x, y, 3) > 0; }

/// The vector at a position, NaN where one of the four pixels around it has none.
Vec2f vector_at(const Image& vectors, const Vec2f& p) {
  const float x = std::min(std::max(0.0f, p.x - 0.5f), float(vectors.width() - 1));
  const float y = std::min(std::max(0.0f, p.y - 0.5f), float(vectors.height() - 1));
  const int x0 = int(x), y0 = int(y);
  const int x1 = x > float(x0) ? x0 + 1 : x0, y1 = y > float(y0) ? y0 + 1 : y0;
  if (!is_valid(vectors, x0, y0) || !is_valid(vectors, x1, y0) || !is_valid(vectors, x0, y1) ||
      !is_valid(vectors, x1, y1)) {
    return kNowhere;
  }
  return {vectors.bilinear(p, 0), vectors.bilinear(p, 1)};
}

void check_vectors(const Image& vectors) {
  if (vectors.channels() < 2) throw Error(ErrorCode::kBadInput, "motion vectors need two channels at least, X and Y");
}

float square(float v) { return v * v; }
double square(double v) { return v * v; }

}  // namespace

Vec2f follow(const Vec2f& from, const Image& vectors, const Image* back) {
  const Vec2f v = vector_at(vectors, from);
  const Vec2f to{from.x + v.x, from.y + v.y};
  if (!vectors.contains(to)) return kNowhere;  // NaN is not contained either
  if (!back) return to;
  const Vec2f b = vector_at(*back, to);
  const float gap = square(v.x + b.x) + square(v.y + b.y);
  const float lengths = square(v.x) + square(v.y) + square(b.x) + square(b.y);
  return gap <= 0.01f * lengths + 0.5f ? to : kNowhere;  // [Sundaram 2010]
}

Image previous_positions(const Image& backward, const Image* forward_before) {
  check_vectors(backward);
  if (forward_before) check_vectors(*forward_before), check_sizes(*forward_before, backward);
  Image out(backward.width(), backward.height(), 2);
  parallel_rows(
      0, backward.height(),
      [&](int y) {
        for (int x = 0; x < backward.width(); ++x) {
          const Vec2f p = follow({float(x) + 0.5f, float(y) + 0.5f}, backward, forward_before);
          float* const to = out.pixel(x, y);
          to[0] = p.x, to[1] = p.y;
        }
      },
      kRowGrain);
  return out;
}

namespace {

/// Mean over pixels and channels of change(T, T', R, R')^2 / ((R^2 + R'^2) / 2 + epsilon), T' and R' at `previous`, or
/// in place without it.
template <class F>
PixelMean mean_change(const Image& test, const Image& test_before, const Image& reference,
                      const Image& reference_before, const Image* previous, Image* map, double epsilon, double trim,
                      F&& change) {
  check_sizes(test, reference), check_sizes(test_before, reference), check_sizes(reference_before, reference);
  if (previous) check_sizes(*previous, reference);
  return mean_over_pixels(test.width(), test.height(), map, trim, [&](int x, int y) {
    Rgb before_t, before_r;
    if (previous) {
      const Vec2f p = previous->vec2(x, y);
      if (!is_position(p)) return kNone;
      before_t = test_before.rgb_bilinear(p), before_r = reference_before.rgb_bilinear(p);
    } else {
      before_t = test_before.rgb(x, y), before_r = reference_before.rgb(x, y);
    }
    const Rgb t = test.rgb(x, y), r = reference.rgb(x, y);
    double sum = 0;
    for (int c = 0; c < 3; ++c) {
      const double r0 = before_r[c], r1 = r[c];
      sum += square(change(double(t[c]), double(before_t[c]), r1, r0)) / ((r1 * r1 + r0 * r0) / 2 + epsilon);
    }
    return std::isfinite(sum) ? sum / 3 : kNone;
  });
}

}  // namespace

PixelMean temporal_error(const Image& test, const Image& test_before, const Image& reference,
                         const Image& reference_before, const Image* previous, Image* map, double epsilon,
                         double trim) {
  return mean_change(test, test_before, reference, reference_before, previous, map, epsilon, trim,
                     [](double t1, double t0, double r1, double r0) { return (t1 - t0) - (r1 - r0); });
}

PixelMean warp_error(const Image& test, const Image& test_before, const Image& reference, const Image& reference_before,
                     const Image& previous, Image* map, double epsilon, double trim) {
  return mean_change(test, test_before, reference, reference_before, &previous, map, epsilon, trim,
                     [](double t1, double t0, double, double) { return t1 - t0; });
}

PixelMean motion_error(const Image& test, const Image& reference, Image* map) {
  check_vectors(test), check_vectors(reference), check_sizes(test, reference);
  return mean_over_pixels(test.width(), test.height(), map, 0, [&](int x, int y) {
    if (!is_valid(test, x, y) || !is_valid(reference, x, y)) return kNone;
    const double distance = std::hypot(double(test.at(x, y, 0)) - double(reference.at(x, y, 0)),
                                       double(test.at(x, y, 1)) - double(reference.at(x, y, 1)));
    return std::isfinite(distance) ? distance : kNone;
  });
}

PixelMean luminance_change(const Image& now, const Image& before, Image* map) {
  check_sizes(now, before);
  return mean_over_pixels(now.width(), now.height(), map, 0, [&](int x, int y) {
    const double change = std::abs(double(luminance(now.rgb(x, y))) - double(luminance(before.rgb(x, y))));
    return std::isfinite(change) ? change : kNone;
  });
}

}  // namespace tempera
