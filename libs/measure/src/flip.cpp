// SPDX-License-Identifier: Apache-2.0
// FLIP [Andersson 2020, Andersson 2021]. The symbols of the papers:
//   q_c, p_c, p_t, w, q_f -> kColorExponent, kColorKnee, kColorTail, kFeatureWidth, kFeatureExponent
//   delta E_c, delta E_f  -> color_difference, feature_difference
//   c_start, c_stop, N    -> FlipExposures::start, stop, count
// The two-dimensional filters are sums of products of one-dimensional ones: images are filtered along rows, then along
// columns, as planes of floats, which the compiler turns into SIMD code.
#include "flip.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "pixel_mean.h"
#include "tempera/core/fast_math.h"
#include "tempera/core/grid.h"

namespace tempera {
namespace {

constexpr float kColorExponent = 0.7f, kColorKnee = 0.4f, kColorTail = 0.95f;
constexpr float kFeatureWidth = 0.082f, kFeatureExponent = 0.5f;

// --- Color spaces, illuminant D65

// Linear RGB to XYZ relative to the white point, so that white is (1, 1, 1): the rows of the matrix divided by it.
struct Matrix {
  float m[3][3];
};
constexpr Matrix kToXyz{{{10135552.0f / 24577794.0f * 1.052156925f, 8788810.0f / 24577794.0f * 1.052156925f,
                          4435075.0f / 24577794.0f * 1.052156925f},
                         {2613072.0f / 12288897.0f, 8788810.0f / 12288897.0f, 887015.0f / 12288897.0f},
                         {1425312.0f / 73733382.0f * 0.918357670f, 8788810.0f / 73733382.0f * 0.918357670f,
                          70074185.0f / 73733382.0f * 0.918357670f}}};
constexpr Matrix kFromXyz{{{3.241003275f * 0.950428545f, -1.537398934f, -0.498615861f * 1.088900371f},
                           {-0.969224334f * 0.950428545f, 1.875930071f, 0.041554224f * 1.088900371f},
                           {0.055639423f * 0.950428545f, -0.204011202f, 1.057148933f * 1.088900371f}}};

inline float row(const Matrix& m, int i, float a, float b, float c) {
  return m.m[i][0] * a + m.m[i][1] * b + m.m[i][2] * c;
}

/// The cube root of CIELAB with its linear part near 0.
inline float lab_root(float t) {
  constexpr float kDelta = 6.0f / 29.0f;
  const float root = exp2_fast(log2_fast(std::max(t, 1e-6f)) * (1.0f / 3.0f));
  const float line = t * (1 / (3 * kDelta * kDelta)) + 4.0f / 29.0f;
  return t > kDelta * kDelta * kDelta ? root : line;
}

/// L*, and a*, b* scaled by L* / 100 (the Hunt effect), of linear RGB in [0,1].
struct Lab {
  float l, a, b;
};
inline Lab hunt_lab(float r, float g, float b) {
  const float x = lab_root(row(kToXyz, 0, r, g, b)), y = lab_root(row(kToXyz, 1, r, g, b)),
              z = lab_root(row(kToXyz, 2, r, g, b));
  const float l = 116 * y - 16;
  return {l, 0.01f * l * 500 * (x - y), 0.01f * l * 200 * (y - z)};
}

/// The HyAB distance.
inline float distance(const Lab& p, const Lab& q) {
  return std::abs(p.l - q.l) + std::sqrt((p.a - q.a) * (p.a - q.a) + (p.b - q.b) * (p.b - q.b));
}

// --- Filters

using Taps = std::vector<float>;  ///< an odd number, the middle one at 0

struct Filters {
  Taps y, cx, cz1, cz2;  ///< contrast sensitivity: Y and Cx one Gaussian each, Cz a sum of two
  Taps g, dg, ddg;       ///< feature detection: a Gaussian and its derivatives
};

Filters make_filters(float ppd) {
  Filters f;
  // Contrast sensitivity: a sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees; for Cz the root of the factor, as it is
  // applied along both axes. [Andersson 2020, Eq. 1 and Table 1]
  const int radius = int(std::ceil(3.0f * std::sqrt(0.04f / (2 * kPi * kPi)) * ppd));
  float sum_y = 0, sum_cx = 0, sum_cz1 = 0, sum_cz2 = 0;
  const auto gaussian = [](float x2, float b) { return std::sqrt(kPi / b) * std::exp(-kPi * kPi * x2 / b); };
  const auto gaussian_root = [](float x2, float a, float b) {
    return std::sqrt(a * std::sqrt(kPi / b)) * std::exp(-kPi * kPi * x2 / b);
  };
  for (int i = -radius; i <= radius; ++i) {
    const float x2 = sqr(float(i) / ppd);
    sum_y += f.y.emplace_back(gaussian(x2, 0.0047f));
    sum_cx += f.cx.emplace_back(gaussian(x2, 0.0053f));
    sum_cz1 += f.cz1.emplace_back(gaussian_root(x2, 34.1f, 0.04f));
    sum_cz2 += f.cz2.emplace_back(gaussian_root(x2, 13.5f, 0.025f));
  }
  const float norm_cz = std::sqrt(sum_cz1 * sum_cz1 + sum_cz2 * sum_cz2);
  for (float& v : f.y) v /= sum_y;
  for (float& v : f.cx) v /= sum_cx;
  for (float& v : f.cz1) v /= norm_cz;
  for (float& v : f.cz2) v /= norm_cz;

  // Positive and negative weights of the derivatives add up to 1 each.
  const float deviation = 0.5f * kFeatureWidth * ppd;
  const int feature_radius = int(std::ceil(3 * deviation));
  float sum_g = 0, dg_plus = 0, dg_minus = 0, ddg_plus = 0, ddg_minus = 0;
  for (int i = -feature_radius; i <= feature_radius; ++i) {
    const float x = float(i), g = std::exp(-x * x / (2 * deviation * deviation));
    const float dg = -x * g, ddg = (x * x / (deviation * deviation) - 1) * g;
    sum_g += f.g.emplace_back(g);
    f.dg.push_back(dg);
    f.ddg.push_back(ddg);
    (dg > 0 ? dg_plus : dg_minus) += std::abs(dg);
    (ddg > 0 ? ddg_plus : ddg_minus) += std::abs(ddg);
  }
  for (float& v : f.g) v /= sum_g;
  for (float& v : f.dg) v /= v > 0 ? dg_plus : dg_minus;
  for (float& v : f.ddg) v /= v > 0 ? ddg_plus : ddg_minus;
  return f;
}

/// An image filtered along rows.
enum Filtered { kY, kCx, kCz1, kCz2, kG, kDg, kDdg, kPlanes };

class Planes {
 public:
  Planes(int width, int height) : height_(height), values_(width, height * kPlanes) {}
  float* row(int plane, int y) { return values_.row(plane * height_ + y).data(); }
  const float* row(int plane, int y) const { return values_.row(plane * height_ + y).data(); }

 private:
  int height_;
  Grid<float> values_;
};

/// out[x] = sum over i of taps[i] * in[x + i - radius]; `in` points at the first of width + 2 * radius values.
void filter_row(const Taps& taps, const float* in, float* out, int width) {
  std::fill(out, out + width, 0.0f);
  for (std::size_t i = 0; i < taps.size(); ++i) {
    const float t = taps[i];
    const float* from = in + i;
    for (int x = 0; x < width; ++x) out[x] += t * from[x];
  }
}

/// A row of linear RGB in [0,1]: what to compare.
using RowSource = std::function<void(int y, float* r, float* g, float* b)>;

void filter_rows(const Filters& f, const RowSource& source, int width, int height, Planes& planes) {
  const int radius = int(f.y.size() / 2), feature_radius = int(f.g.size() / 2), pad = std::max(radius, feature_radius);
  parallel_rows(
      0, height,
      [&](int y) {
        const int stride = width + 2 * pad;
        thread_local std::vector<float> buffer;
        buffer.resize(3 * (stride + width));
        float* py = buffer.data();
        float* pcx = py + stride;
        float* pcz = pcx + stride;
        float* r = pcz + stride;
        float* g = r + width;
        float* b = g + width;
        source(y, r, g, b);
        for (int x = 0; x < width; ++x) {  // RGB to YCxCz, which is linear in XYZ
          const float xx = tempera::row(kToXyz, 0, r[x], g[x], b[x]);
          const float yy = tempera::row(kToXyz, 1, r[x], g[x], b[x]);
          const float zz = tempera::row(kToXyz, 2, r[x], g[x], b[x]);
          py[pad + x] = yy;
          pcx[pad + x] = xx - yy;
          pcz[pad + x] = yy - zz;
        }
        for (float* p : {py, pcx, pcz}) {  // the border repeats
          std::fill(p, p + pad, p[pad]);
          std::fill(p + pad + width, p + stride, p[pad + width - 1]);
        }
        filter_row(f.y, py + pad - radius, planes.row(kY, y), width);
        filter_row(f.cx, pcx + pad - radius, planes.row(kCx, y), width);
        filter_row(f.cz1, pcz + pad - radius, planes.row(kCz1, y), width);
        filter_row(f.cz2, pcz + pad - radius, planes.row(kCz2, y), width);
        filter_row(f.g, py + pad - feature_radius, planes.row(kG, y), width);
        filter_row(f.dg, py + pad - feature_radius, planes.row(kDg, y), width);
        filter_row(f.ddg, py + pad - feature_radius, planes.row(kDdg, y), width);
      },
      kRowGrain);
}

/// out += taps along the column of `plane` around row y.
void filter_column(const Taps& taps, const Planes& planes, int plane, int y, int width, int height, float* out) {
  const int radius = int(taps.size() / 2);
  for (int i = -radius; i <= radius; ++i) {
    const float t = taps[i + radius];
    const float* from = planes.row(plane, std::clamp(y + i, 0, height - 1));
    for (int x = 0; x < width; ++x) out[x] += t * from[x];
  }
}

inline Lab clamped_lab(float y, float cx, float cz) {
  const float x = y + cx, z = y - cz;  // back from YCxCz, then to displayable RGB
  const float r = std::clamp(row(kFromXyz, 0, x, y, z), 0.0f, 1.0f);
  const float g = std::clamp(row(kFromXyz, 1, x, y, z), 0.0f, 1.0f);
  const float b = std::clamp(row(kFromXyz, 2, x, y, z), 0.0f, 1.0f);
  return hunt_lab(r, g, b);
}

/// Colors and features of pixels after both passes: planes of `width` columns. One function computes them for both
/// pictures, and stores them, so that equal pictures differ by exactly 0 whatever the compiler fuses.
class Features {
 public:
  void resize(int width, int height) { values_.resize(width, height * kCount); }
  /// Row `y` of `p` becomes row `to` of the features.
  void compute(const Filters& f, const Planes& p, int y, int height, int to) {
    float *l = row(kL, to), *a = row(kA, to), *b = row(kB, to), *edge = row(kEdge, to), *point = row(kPoint, to);
    thread_local std::vector<float> derivatives;
    const int width = values_.width();
    derivatives.assign(2 * width, 0.0f);
    std::fill(l, l + width * kCount, 0.0f);
    float *dy = derivatives.data(), *ddy = dy + width;
    filter_column(f.y, p, kY, y, width, height, l);
    filter_column(f.cx, p, kCx, y, width, height, a);
    filter_column(f.cz1, p, kCz1, y, width, height, b);
    filter_column(f.cz2, p, kCz2, y, width, height, b);
    filter_column(f.g, p, kDg, y, width, height, edge);
    filter_column(f.dg, p, kG, y, width, height, dy);
    filter_column(f.g, p, kDdg, y, width, height, point);
    filter_column(f.ddg, p, kG, y, width, height, ddy);
    finish(width, l, a, b, edge, point, dy, ddy);
  }
  /// L, a, b, edge and point: `width` values each, one after the other.
  const float* row(int y) const { return values_.row(y * kCount).data(); }

 private:
  enum { kL, kA, kB, kEdge, kPoint, kCount };
  float* row(int plane, int y) { return values_.row(y * kCount + plane).data(); }
  static void finish(int width, float* __restrict l, float* __restrict a, float* __restrict b, float* __restrict edge,
                     float* __restrict point, const float* __restrict dy, const float* __restrict ddy) {
    for (int x = 0; x < width; ++x) {
      const Lab lab = clamped_lab(l[x], a[x], b[x]);
      l[x] = lab.l, a[x] = lab.a, b[x] = lab.b;
      edge[x] = std::sqrt(edge[x] * edge[x] + dy[x] * dy[x]);
      point[x] = std::sqrt(point[x] * point[x] + ddy[x] * ddy[x]);
    }
  }
  Grid<float> values_;
};

/// Compares pictures of one size with a reference; memory is kept between calls.
class Flip {
 public:
  Flip(int width, int height, float ppd)
      : width_(width), height_(height), filters_(make_filters(ppd)), planes_(width, height) {
    // The largest color difference: between green and blue.
    max_color_ = std::pow(distance(hunt_lab(0, 1, 0), hunt_lab(0, 0, 1)), kColorExponent);
    reference_.resize(width, height);
  }

  void set_reference(const RowSource& reference) {
    filter_rows(filters_, reference, width_, height_, planes_);
    parallel_rows(
        0, height_, [&](int y) { reference_.compute(filters_, planes_, y, height_, y); }, kRowGrain);
  }

  /// Sets map = max(map, FLIP).
  void compare(const RowSource& test, Image& map) {
    filter_rows(filters_, test, width_, height_, planes_);
    parallel_rows(
        0, height_,
        [&](int y) {
          thread_local Features row;  // keeps its memory
          row.resize(width_, 1);
          row.compute(filters_, planes_, y, height_, 0);
          difference(width_, max_color_, row.row(0), reference_.row(y), map.row(y));
        },
        kRowGrain);
  }

 private:
  static void difference(int w, float max_color, const float* __restrict t, const float* __restrict r,
                         float* __restrict out) {
    const float knee = kColorKnee * max_color, below = kColorTail / knee, above = (1 - kColorTail) / (max_color - knee);
    for (int x = 0; x < w; ++x) {
      const float d = distance({r[x], r[w + x], r[2 * w + x]}, {t[x], t[w + x], t[2 * w + x]});
      const float powered = pow_fast(d, kColorExponent);
      const float color_difference = powered < knee ? powered * below : kColorTail + (powered - knee) * above;
      static_assert(kFeatureExponent == 0.5f);
      const float feature = std::max(std::abs(r[3 * w + x] - t[3 * w + x]), std::abs(r[4 * w + x] - t[4 * w + x]));
      const float feature_difference = std::sqrt(0.70710678f * feature);
      out[x] = std::max(out[x], pow_fast(color_difference, 1 - feature_difference));
    }
  }

  int width_, height_;
  Filters filters_;
  Planes planes_;  ///< of the picture that is being filtered
  Features reference_;
  float max_color_;
};

/// The maps of the tests, all 0; those that nobody wants are in `local`.
std::vector<Image*> empty_maps(std::span<const FlipTest> tests, const Image& reference, std::vector<Image>& local) {
  local.resize(tests.size());
  std::vector<Image*> maps;
  for (std::size_t i = 0; i < tests.size(); ++i) {
    check_sizes(*tests[i].image, reference);
    maps.push_back(tests[i].map ? tests[i].map : &local[i]);
    *maps.back() = Image(reference.width(), reference.height(), 1);
  }
  return maps;
}

std::vector<double> means_of(const std::vector<Image*>& maps) {
  std::vector<double> means;
  for (const Image* map : maps) {
    means.push_back(mean_over_pixels(map->width(), map->height(), nullptr, 0, [&](int x, int y) {
                      return double(map->at(x, y));
                    }).value);
  }
  return means;
}

inline float unit(float v) { return v > 0 ? std::min(v, 1.0f) : 0.0f; }  // NaN becomes 0

// The ACES curve of FLIP, (a x^2 + b x) / (c x^2 + d x + e): K. Narkowicz's fit with an exposure of 0.6.
constexpr float kA = 0.6f * 0.6f * 2.51f, kB = 0.6f * 0.03f, kC = 0.6f * 0.6f * 2.43f, kD = 0.6f * 0.59f, kE = 0.14f;
}  // namespace

std::vector<double> flip(std::span<const FlipTest> tests, const Image& reference, float scale,
                         float pixels_per_degree) {
  std::vector<Image> local;
  const std::vector<Image*> maps = empty_maps(tests, reference, local);
  const auto source = [scale](const Image& image) -> RowSource {
    return [&image, scale](int y, float* r, float* g, float* b) {
      for (int x = 0; x < image.width(); ++x) {
        const Rgb c = image.rgb(x, y);
        r[x] = unit(c.r * scale), g[x] = unit(c.g * scale), b[x] = unit(c.b * scale);
      }
    };
  };
  Flip flip(reference.width(), reference.height(), pixels_per_degree);
  flip.set_reference(source(reference));
  for (std::size_t i = 0; i < tests.size(); ++i) flip.compare(source(*tests[i].image), *maps[i]);
  return means_of(maps);
}

double flip(const Image& test, const Image& reference, Image* map, float pixels_per_degree) {
  const FlipTest one{&test, map};
  return flip({&one, 1}, reference, 1, pixels_per_degree)[0];
}

FlipExposures flip_exposures(const Image& reference) {
  // Where the tone curve reaches 0.85: the brightest and the median pixel are brought there. [Andersson 2021]
  const float a = kA - 0.85f * kC, b = kB - 0.85f * kD, c = -0.85f * kE;
  const float p = -0.5f * b / a, at = p + std::sqrt(p * p - c / a);
  std::vector<float> luminances;
  luminances.reserve(reference.pixels());
  float highest = 0;
  for (int y = 0; y < reference.height(); ++y) {
    for (int x = 0; x < reference.width(); ++x) {
      const Rgb v = reference.rgb(x, y);
      const auto positive = [](float f) { return f > 0 ? std::min(f, 1e15f) : 0.0f; };
      const float l = 0.2126f * positive(v.r) + 0.7152f * positive(v.g) + 0.0722f * positive(v.b);
      luminances.push_back(l);
      highest = std::max(highest, l);
    }
  }
  if (!(highest > 0)) return {};
  const auto median = [&] {
    const auto middle = luminances.begin() + std::ptrdiff_t(luminances.size() / 2);
    std::nth_element(luminances.begin(), middle, luminances.end());
    return *middle;
  };
  float m = median();
  if (!(m > 0)) {
    std::erase_if(luminances, [](float l) { return !(l > 0); });
    m = median();
  }
  FlipExposures e;
  e.start = std::log2(at / highest);
  e.stop = std::log2(at / m);
  e.count = std::max(2, int(std::ceil(e.stop - e.start)));
  return e;
}

std::vector<double> hdr_flip(std::span<const FlipTest> tests, const Image& reference, float pixels_per_degree) {
  std::vector<Image> local;
  const std::vector<Image*> maps = empty_maps(tests, reference, local);
  const FlipExposures e = flip_exposures(reference);
  Flip flip(reference.width(), reference.height(), pixels_per_degree);
  for (int i = 0; i < e.count; ++i) {
    const float scale = std::exp2(e.start + float(i) * ((e.stop - e.start) / float(e.count - 1)));
    const auto source = [scale](const Image& image) -> RowSource {
      return [&image, scale](int y, float* r, float* g, float* b) {
        const auto shown = [scale](float v) {
          const float x = v > 0 ? std::min(v, 1e15f) * scale : 0.0f;
          return unit((x * (x * kA + kB)) / (x * (x * kC + kD) + kE));
        };
        for (int x = 0; x < image.width(); ++x) {
          const Rgb c = image.rgb(x, y);
          r[x] = shown(c.r), g[x] = shown(c.g), b[x] = shown(c.b);
        }
      };
    };
    flip.set_reference(source(reference));
    for (std::size_t t = 0; t < tests.size(); ++t) flip.compare(source(*tests[t].image), *maps[t]);
    if (e.start == e.stop) break;
  }
  return means_of(maps);
}

double hdr_flip(const Image& test, const Image& reference, Image* map, float pixels_per_degree) {
  const FlipTest one{&test, map};
  return hdr_flip({&one, 1}, reference, pixels_per_degree)[0];
}

}  // namespace tempera
