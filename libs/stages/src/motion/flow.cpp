// SPDX-License-Identifier: Apache-2.0
// Symbols: L_1, L_2 → Picture from, to; w = (u, v) → flow; m → weights; alpha → smoothness; gamma → gradient;
// v_p → surface_motion; psi_S → east, south
// DEVIATION [Zimmer 2015, Sec. 4.2]: vectors are composed as v(x) = r(x) + v_p(x + r(x)), as r is found on pixels that
// were moved; the paper adds v_p(x); shown by Flow.SurfacesThatTurn.
#include "motion/flow.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "sound_values.h"

namespace tempera::motion {

namespace {

using denoise::for_rows;
using denoise::for_values;
using denoise::Planes;

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
constexpr float kLeastWeight = 0.01f;  ///< of what is known around, for a value to be taken from there

/// Cubic interpolation through the values, at distance t in [0, 1) from the second of four.
std::array<float, 4> cubic_weights(float t) {
  const float t2 = t * t, t3 = t2 * t;
  return {0.5f * (2 * t2 - t3 - t), 0.5f * (3 * t3 - 5 * t2) + 1, 0.5f * (4 * t2 - 3 * t3 + t), 0.5f * (t3 - t2)};
}

/// At (x, y), centers of pixels at whole numbers; the border goes on outside.
float bicubic(const Planes& in, float x, float y) {
  const int w = in.width(), h = in.height();
  x = std::clamp(x, -1.0f, float(w)), y = std::clamp(y, -1.0f, float(h));
  const int x0 = int(std::floor(x)), y0 = int(std::floor(y));
  const std::array<float, 4> wx = cubic_weights(x - float(x0)), wy = cubic_weights(y - float(y0));
  int xs[4];
  for (int i = 0; i < 4; ++i) xs[i] = std::clamp(x0 - 1 + i, 0, w - 1);
  float sum = 0;
  for (int j = 0; j < 4; ++j) {
    const float* row = in.row(0, std::clamp(y0 - 1 + j, 0, h - 1));
    float line = 0;
    for (int i = 0; i < 4; ++i) line += wx[std::size_t(i)] * row[xs[i]];
    sum += wy[std::size_t(j)] * line;
  }
  return sum;
}

float bilinear(const Planes& in, int c, float x, float y) {
  const int w = in.width(), h = in.height();
  x = std::clamp(x, 0.0f, float(w - 1)), y = std::clamp(y, 0.0f, float(h - 1));
  const int x0 = int(x), y0 = int(y), x1 = std::min(x0 + 1, w - 1);
  const float u = x - float(x0), v = y - float(y0);
  const float *top = in.row(c, y0), *bottom = in.row(c, std::min(y0 + 1, h - 1));
  return (1 - v) * ((1 - u) * top[x0] + u * top[x1]) + v * ((1 - u) * bottom[x0] + u * bottom[x1]);
}

/// The same picture with other numbers of pixels.
Planes resampled(const Planes& in, int width, int height) {
  Planes out(width, height, in.channels());
  const float sx = float(in.width()) / float(width), sy = float(in.height()) / float(height);
  for_values(out, [&](int c, int y, int x, float) {
    return bilinear(in, c, (float(x) + 0.5f) * sx - 0.5f, (float(y) + 0.5f) * sy - 0.5f);
  });
  return out;
}

/// Gaussian blur; the border goes on outside.
Planes blurred(const Planes& in, float sigma) {
  if (!(sigma > 0)) return in;
  const int radius = std::max(1, int(std::ceil(3 * sigma))), w = in.width(), h = in.height();
  std::vector<float> kernel(std::size_t(2 * radius + 1));
  float total = 0;
  for (int k = -radius; k <= radius; ++k) {
    total += kernel[k + radius] = std::exp(-0.5f * float(k * k) / (sigma * sigma));
  }
  for (float& k : kernel) k /= total;
  Planes rows(w, h, in.channels()), out(w, h, in.channels());
  for (int c = 0; c < in.channels(); ++c) {
    for_rows(h, [&](int y) {
      std::vector<float> padded(std::size_t(w + 2 * radius));
      const float* from = in.row(c, y);
      for (int x = 0; x < w + 2 * radius; ++x) padded[std::size_t(x)] = from[std::clamp(x - radius, 0, w - 1)];
      float* to = rows.row(c, y);
      for (std::size_t k = 0; k < kernel.size(); ++k) {
        for (int x = 0; x < w; ++x) to[x] += kernel[k] * padded[std::size_t(x) + k];
      }
    });
    for_rows(h, [&](int y) {
      float* to = out.row(c, y);
      for (int k = -radius; k <= radius; ++k) {
        const float* from = rows.row(c, std::clamp(y + k, 0, h - 1));
        const float weight = kernel[k + radius];
        for (int x = 0; x < w; ++x) to[x] += weight * from[x];
      }
    });
  }
  return out;
}

/// Derivatives along x (channel 0) and y (channel 1) of a channel, exact for polynomials of fourth degree.
Planes gradient(const Planes& in, int channel) {
  const int w = in.width(), h = in.height();
  Planes out(w, h, 2);
  const auto difference = [](float m2, float m1, float p1, float p2) {
    return (8 * (p1 - m1) - (p2 - m2)) * (1.0f / 12);
  };
  for_rows(h, [&](int y) {
    const float* here = in.row(channel, y);
    float *dx = out.row(0, y), *dy = out.row(1, y);
    for (int x = 0; x < w; ++x) {
      if (x >= 2 && x + 2 < w) {
        dx[x] = difference(here[x - 2], here[x - 1], here[x + 1], here[x + 2]);
      } else {
        const auto at = [&](int i) { return here[std::clamp(i, 0, w - 1)]; };
        dx[x] = difference(at(x - 2), at(x - 1), at(x + 1), at(x + 2));
      }
    }
    const auto row = [&](int j) { return in.row(channel, std::clamp(j, 0, h - 1)); };
    const float *m2 = row(y - 2), *m1 = row(y - 1), *p1 = row(y + 1), *p2 = row(y + 2);
    for (int x = 0; x < w; ++x) dy[x] = difference(m2[x], m1[x], p1[x], p2[x]);
  });
  return out;
}

/// A level of a pyramid: values, and how much of each is known.
struct Picture {
  Planes values, weights;
};

/// Means of what is known around, and how much that is; `width` x `height` pixels.
Picture reduced(const Picture& in, float sigma, int width, int height) {
  Planes both(in.values.width(), in.values.height(), 2);
  for_values(both, [&](int c, int y, int x, float) {
    const float weight = in.weights.row(0, y)[x];
    return c == 1 ? weight : weight > 0 ? weight * in.values.row(0, y)[x] : 0.0f;
  });
  both = blurred(both, sigma);
  if (width != both.width() || height != both.height()) both = resampled(both, width, height);
  Picture out{Planes(width, height, 1), Planes(width, height, 1)};
  for_values(out.weights, [&](int, int y, int x, float) {
    const float weight = both.row(1, y)[x];
    return weight >= kLeastWeight ? weight : 0.0f;
  });
  for_values(out.values, [&](int, int y, int x, float) {
    const float weight = out.weights.row(0, y)[x];
    return weight > 0 ? both.row(0, y)[x] / weight : kUnknown;
  });
  return out;
}

/// Levels from fine to coarse. Unknown values go on smoothly from those that are known.
std::vector<Picture> pyramid(const Picture& picture, const FlowSettings& settings) {
  const int w = picture.values.width(), h = picture.values.height();
  std::vector<Picture> levels;
  levels.push_back(reduced(picture, settings.presmoothing, w, h));
  levels[0].weights = picture.weights;  // what is continued is no data
  const float sigma = 0.6f * std::sqrt(1 / (settings.zoom * settings.zoom) - 1);
  for (float scale = settings.zoom;; scale *= settings.zoom) {
    const int lw = int(std::lround(float(w) * scale)), lh = int(std::lround(float(h) * scale));
    if (std::min(lw, lh) < std::max(settings.coarsest, 1)) break;
    levels.push_back(reduced(levels.back(), sigma, lw, lh));
  }
  double sum = 0, count = 0;
  for (const float v : levels.back().values.values()) {
    if (!std::isnan(v)) sum += double(v), ++count;
  }
  const Planes mean(1, 1, 1, count > 0 ? float(sum / count) : 0.0f);
  for (std::size_t k = levels.size(); k-- > 0;) {
    const Planes& coarser = k + 1 < levels.size() ? levels[k + 1].values : mean;
    Planes& values = levels[k].values;
    const float sx = float(coarser.width()) / float(values.width());
    const float sy = float(coarser.height()) / float(values.height());
    for_values(values, [&](int, int y, int x, float v) {
      if (!std::isnan(v)) return v;
      return bilinear(coarser, 0, (float(x) + 0.5f) * sx - 0.5f, (float(y) + 0.5f) * sy - 0.5f);
    });
  }
  return levels;
}

/// The data term around a flow: values and derivatives of the second picture moved by it, against the first.
struct DataTerm {
  Planes weights, difference;        ///< m, L_z
  Planes first, second_x, second_y;  ///< (L_x, L_y), (L_xx, L_xy), (L_xy, L_yy)
  Planes difference_gradient;        ///< (L_xz, L_yz)

  DataTerm(const Picture& from, const Planes& from_gradient, const Picture& to, const Planes& flow)
      : weights(flow.width(), flow.height(), 1), difference(flow.width(), flow.height(), 1) {
    const int w = flow.width(), h = flow.height();
    Planes moved(w, h, 1);
    for_rows(h, [&](int y) {
      const float *u = flow.row(0, y), *v = flow.row(1, y), *m = from.weights.row(0, y), *here = from.values.row(0, y);
      float *value = moved.row(0, y), *weight = weights.row(0, y), *d = difference.row(0, y);
      for (int x = 0; x < w; ++x) {
        const float px = float(x) + u[x], py = float(y) + v[x];
        value[x] = bicubic(to.values, px, py);
        const bool inside = px >= -0.5f && py >= -0.5f && px <= float(w) - 0.5f && py <= float(h) - 0.5f;
        weight[x] = inside ? m[x] * bilinear(to.weights, 0, px, py) : 0.0f;
        d[x] = value[x] - here[x];
      }
    });
    first = gradient(moved, 0);
    second_x = gradient(first, 0), second_y = gradient(first, 1);
    difference_gradient = first;
    for_values(difference_gradient, [&](int c, int y, int x, float v) { return v - from_gradient.row(c, y)[x]; });
  }
};

/// The linear equations of a flow for given penalizers: at each pixel
///   (a11 + sum psi_S) u + a12 v = c1 + sum psi_S u_N, and likewise for v.
class System {
 public:
  System(int width, int height) : matrix_(width, height, 3), right_(width, height, 2), links_(width, height, 2) {}

  /// Linearized around `start`, with the penalizers that `flow` has. [Zimmer 2015, Sec. 4.2]
  void assemble(const DataTerm& data, const Planes& start, const Planes& flow, const FlowSettings& settings) {
    const int w = flow.width(), h = flow.height();
    const float e2 = settings.epsilon * settings.epsilon;
    for_rows(h, [&](int y) {
      const float *u = flow.row(0, y), *v = flow.row(1, y), *u0 = start.row(0, y), *v0 = start.row(1, y);
      const float *m = data.weights.row(0, y), *lz = data.difference.row(0, y);
      const float *lx = data.first.row(0, y), *ly = data.first.row(1, y);
      const float *lxx = data.second_x.row(0, y), *lxy = data.second_x.row(1, y), *lyy = data.second_y.row(1, y);
      const float *lxz = data.difference_gradient.row(0, y), *lyz = data.difference_gradient.row(1, y);
      float *a11 = matrix_.row(0, y), *a12 = matrix_.row(1, y), *a22 = matrix_.row(2, y);
      float *c1 = right_.row(0, y), *c2 = right_.row(1, y);
      for (int x = 0; x < w; ++x) {
        const float du = u[x] - u0[x], dv = v[x] - v0[x];
        const float s = lz[x] + lx[x] * du + ly[x] * dv;
        const float sx = lxz[x] + lxx[x] * du + lxy[x] * dv, sy = lyz[x] + lxy[x] * du + lyy[x] * dv;
        const float psi_d = m[x] / std::sqrt(s * s + e2);
        const float psi_g = settings.gradient * m[x] / std::sqrt(sx * sx + sy * sy + e2);
        a11[x] = psi_d * lx[x] * lx[x] + psi_g * (lxx[x] * lxx[x] + lxy[x] * lxy[x]);
        a12[x] = psi_d * lx[x] * ly[x] + psi_g * lxy[x] * (lxx[x] + lyy[x]);
        a22[x] = psi_d * ly[x] * ly[x] + psi_g * (lyy[x] * lyy[x] + lxy[x] * lxy[x]);
        const float b1 = -psi_d * lx[x] * lz[x] - psi_g * (lxx[x] * lxz[x] + lxy[x] * lyz[x]);
        const float b2 = -psi_d * ly[x] * lz[x] - psi_g * (lxy[x] * lxz[x] + lyy[x] * lyz[x]);
        c1[x] = b1 + a11[x] * u0[x] + a12[x] * v0[x];
        c2[x] = b2 + a12[x] * u0[x] + a22[x] * v0[x];
      }
    });
    Planes psi(w, h, 1);
    for_rows(h, [&](int y) {
      float* to = psi.row(0, y);
      for (int c = 0; c < 2; ++c) {
        const float *here = flow.row(c, y), *up = flow.row(c, std::max(y - 1, 0)),
                    *down = flow.row(c, std::min(y + 1, h - 1));
        for (int x = 0; x < w; ++x) {
          const float dx = here[std::min(x + 1, w - 1)] - here[std::max(x - 1, 0)], dy = down[x] - up[x];
          to[x] += 0.25f * (dx * dx + dy * dy);
        }
      }
      for (int x = 0; x < w; ++x) to[x] = settings.smoothness / std::sqrt(to[x] + e2);
    });
    for_rows(h, [&](int y) {
      const float *here = psi.row(0, y), *down = psi.row(0, std::min(y + 1, h - 1));
      float *east = links_.row(0, y), *south = links_.row(1, y);
      for (int x = 0; x < w; ++x) {
        east[x] = x + 1 < w ? 0.5f * (here[x] + here[x + 1]) : 0.0f;
        south[x] = y + 1 < h ? 0.5f * (here[x] + down[x]) : 0.0f;
      }
    });
  }

  /// Successive over-relaxation, of red and black pixels in turn: neighbors of a pixel are of the other color, so that
  /// the order of rows does not matter.
  void relax(Planes& flow, const FlowSettings& settings) const {
    const int w = flow.width(), h = flow.height();
    const float keep = 1 - settings.relaxation;
    Planes scale(w, h, 2);
    for_values(scale, [&](int c, int y, int x, float) {
      const float* east = links_.row(0, y);
      const float links =
          east[x] + (x > 0 ? east[x - 1] : 0.0f) + links_.row(1, y)[x] + (y > 0 ? links_.row(1, y - 1)[x] : 0.0f);
      const float diagonal = matrix_.row(c == 0 ? 0 : 2, y)[x] + links;
      return diagonal > 0 ? settings.relaxation / diagonal : 0.0f;
    });
    for (int half = 0; half < 2 * settings.sweeps; ++half) {
      for_rows(h, [&](int y) {
        const int above = std::max(y - 1, 0), below = std::min(y + 1, h - 1);
        float *u = flow.row(0, y), *v = flow.row(1, y);
        const float *u_up = flow.row(0, above), *u_down = flow.row(0, below);
        const float *v_up = flow.row(1, above), *v_down = flow.row(1, below);
        const float *east = links_.row(0, y), *south = links_.row(1, y), *north = links_.row(1, above);
        const float *a12 = matrix_.row(1, y), *c1 = right_.row(0, y), *c2 = right_.row(1, y);
        const float *su = scale.row(0, y), *sv = scale.row(1, y);
        for (int x = (y + half) & 1; x < w; x += 2) {
          const int left = x > 0 ? x - 1 : 0, right = x + 1 < w ? x + 1 : x;
          const float e = east[x], s = south[x], n = y > 0 ? north[x] : 0.0f, o = x > 0 ? east[left] : 0.0f;
          const float sum_u = e * u[right] + o * u[left] + s * u_down[x] + n * u_up[x];
          const float sum_v = e * v[right] + o * v[left] + s * v_down[x] + n * v_up[x];
          u[x] = keep * u[x] + su[x] * (c1[x] - a12[x] * v[x] + sum_u);
          v[x] = keep * v[x] + sv[x] * (c2[x] - a12[x] * u[x] + sum_v);
        }
      });
    }
  }

 private:
  Planes matrix_;  ///< a11, a12, a22
  Planes right_;   ///< c1, c2
  Planes links_;   ///< psi_S between a pixel and the one to its right, the one below it
};

float within(float v, int size) {
  const float limit = float(size);
  return std::isnan(v) ? 0.0f : std::clamp(v, -limit, limit);
}

#ifdef TEMPERA_PATH_SPACE_MOTION

/// Whether two vectors of pixels that are `distance` pixels apart may be of one surface, as far as they tell.
bool alike(Vec2f a, Vec2f b, float distance) {
  const Vec2f d = a - b;
  const float limit = 0.5f + 0.05f * (std::abs(a.x) + std::abs(a.y)) + 0.1f * distance;
  return d.x * d.x + d.y * d.y <= limit * limit;
}

/// The vector at (x, y), centers of pixels at +0.5, from those of the pixels around that `counts(pixel)`. Nothing where
/// they are but a small part, or the place is out of the picture.
template <class Counts>
std::optional<Vec2f> vector_at(const Grid<Vec2f>& vectors, float x, float y, const Counts& counts) {
  constexpr float kLeastPart = 0.2f;
  const int w = vectors.width(), h = vectors.height();
  if (!(x >= 0 && y >= 0 && x < float(w) && y < float(h))) return std::nullopt;
  const float fx = x - 0.5f, fy = y - 0.5f;
  const int x0 = int(std::floor(fx)), y0 = int(std::floor(fy));
  const float u = fx - float(x0), v = fy - float(y0);
  Vec2f sum;
  float total = 0;
  for (int k = 0; k < 4; ++k) {
    const float weight = ((k & 1) ? u : 1 - u) * ((k >> 1) ? v : 1 - v);
    const std::size_t i = vectors.index(std::clamp(x0 + (k & 1), 0, w - 1), std::clamp(y0 + (k >> 1), 0, h - 1));
    if (!(weight > 0) || !counts(i)) continue;
    sum += vectors[i] * weight, total += weight;
  }
  if (total < kLeastPart) return std::nullopt;
  return total == 1 ? sum : sum / total;
}

/// Luminances, negative ones as 0, unknown where a channel is.
Planes luminances(const Planes& light) {
  Planes out(light.width(), light.height(), 1);
  for_values(out, [&](int, int y, int x, float) {
    const float r = light.row(0, y)[x], g = light.row(1, y)[x], b = light.row(2, y)[x];
    if (!is_sound(r) || !is_sound(g) || !is_sound(b)) return kUnknown;
    return std::max(denoise::luminance(r, g, b), 0.0f);
  });
  return out;
}

/// Median of what is positive in two pictures; 1 where nothing is.
float positive_median(const Planes& a, const Planes& b) {
  std::vector<float> positive;
  positive.reserve(a.pixels() + b.pixels());
  for (const Planes* p : {&a, &b}) {
    std::copy_if(p->values().begin(), p->values().end(), std::back_inserter(positive), [](float v) { return v > 0; });
  }
  if (positive.empty()) return 1;
  const auto middle = positive.begin() + std::ptrdiff_t(positive.size() / 2);
  std::nth_element(positive.begin(), middle, positive.end());
  return *middle;
}

#endif  // TEMPERA_PATH_SPACE_MOTION

}  // namespace

Grid<Vec2f> optical_flow(const Planes& from, const Planes& to, const Planes& counts, const FlowSettings& settings) {
  const int w = from.width(), h = from.height();
  Grid<Vec2f> out(w, h);
  if (out.empty()) return out;
  Picture first{from, Planes(w, h, 1)}, second{to, Planes(w, h, 1)};
  for_values(first.weights, [&](int, int y, int x, float) {
    const float weight = counts.row(0, y)[x];
    return is_sound(from.row(0, y)[x]) && weight > 0 ? std::min(weight, 1.0f) : 0.0f;
  });
  for_values(second.weights, [&](int, int y, int x, float) { return is_sound(to.row(0, y)[x]) ? 1.0f : 0.0f; });
  const std::vector<Picture> a = pyramid(first, settings), b = pyramid(second, settings);
  Planes flow;
  for (std::size_t k = a.size(); k-- > 0;) {
    const int lw = a[k].values.width(), lh = a[k].values.height();
    if (flow.empty()) {
      flow = Planes(lw, lh, 2);
    } else {
      const float scale[2] = {float(lw) / float(flow.width()), float(lh) / float(flow.height())};
      flow = resampled(flow, lw, lh);
      for_values(flow, [&](int c, int, int, float v) { return v * scale[c]; });
    }
    const Planes from_gradient = gradient(a[k].values, 0);
    System system(lw, lh);
    for (int warp = 0; warp < settings.warps; ++warp) {
      const DataTerm data(a[k], from_gradient, b[k], flow);
      const Planes start = flow;
      for (int update = 0; update < settings.fixed; ++update) {
        system.assemble(data, start, flow, settings);
        system.relax(flow, settings);
      }
      for_values(flow, [&](int c, int, int, float v) { return within(v, c == 0 ? lw : lh); });
    }
  }
  for_rows(h, [&](int y) {
    for (int x = 0; x < w; ++x) out.at(x, y) = {flow.row(0, y)[x], flow.row(1, y)[x]};
  });
  return out;
}

#ifdef TEMPERA_PATH_SPACE_MOTION

LightFlow irradiance_flow(const Planes& from, const Planes& to, const Grid<Place>& places, const Grid<float>& id,
                          const FlowSettings& settings) {
  const int w = from.width(), h = from.height();
  LightFlow out{Grid<Vec2f>(w, h), Grid<std::uint8_t>(w, h)};
  if (out.vectors.empty()) return out;
  // Shadows in bright and in dim light are alike in the logarithm. [Zimmer 2015, Sec. 4.2]
  Planes first = luminances(from), second = luminances(to);
  const float offset = 0.01f * positive_median(first, second);
  for (Planes* p : {&first, &second}) {
    for_values(*p, [&](int, int, int, float v) { return std::log(v + offset); });  // unknown values stay so
  }

  const auto is_seen = [&](std::size_t i) {
    const Place& p = places[i];
    return p.valid() && p.y >= 0 && p.x < float(w) && p.y < float(h);
  };
  Grid<Vec2f> surface_motion(w, h);
  for_rows(h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = places.index(x, y);
      if (is_seen(i)) surface_motion[i] = {places[i].x - (float(x) + 0.5f), places[i].y - (float(y) + 0.5f)};
    }
  });
  const auto same_surface = [&](std::size_t i, std::size_t j, float distance) {
    return (id.empty() || id[i] == id[j]) && alike(surface_motion[i], surface_motion[j], distance);
  };
  // Light at edges of surfaces is of both, so it has no motion of its own. [Zimmer 2015, Sec. 4.3]
  Planes counts(w, h, 1), moved(w, h, 1);
  for_rows(h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = places.index(x, y);
      const Place& p = places[i];
      bool known = is_seen(i) && !std::isnan(first.row(0, y)[x]);
      for (const auto& step : kAround) {
        const int nx = x + step[0], ny = y + step[1];
        if (!known || nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
        const std::size_t j = places.index(nx, ny);
        known = !is_seen(j) || same_surface(i, j, 1);
      }
      // The second picture as it would be if only the light moved. [Zimmer 2015, Sec. 4.2]
      const float value = known ? bicubic(second, p.x - 0.5f, p.y - 0.5f) : kUnknown;
      moved.row(0, y)[x] = value;
      counts.row(0, y)[x] = std::isnan(value) ? 0.0f : 1.0f;
    }
  });
  const Grid<Vec2f> light_motion = optical_flow(first, moved, counts, settings);

  for_rows(h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = places.index(x, y);
      const Vec2f r = light_motion[i];
      const float px = float(x) + 0.5f + r.x, py = float(y) + 0.5f + r.y, distance = std::sqrt(r.x * r.x + r.y * r.y);
      const auto there = vector_at(surface_motion, px, py, [&](std::size_t j) {
        return is_seen(j) && (!is_seen(i) || same_surface(i, j, distance));
      });
      const Vec2f v = r + there.value_or(surface_motion[i]);
      out.vectors[i] = v;
      const float tx = float(x) + 0.5f + v.x, ty = float(y) + 0.5f + v.y;
      out.valid[i] = is_seen(i) && tx >= 0 && ty >= 0 && tx < float(w) && ty < float(h);
    }
  });
  return out;
}

Grid<std::uint8_t> consistent(const LightFlow& flow, const LightFlow& back, float tolerance) {
  const int w = flow.vectors.width(), h = flow.vectors.height();
  Grid<std::uint8_t> out(w, h);
  for_rows(h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = flow.vectors.index(x, y);
      if (!flow.valid[i]) continue;
      const Vec2f v = flow.vectors[i];
      const auto there = vector_at(back.vectors, float(x) + 0.5f + v.x, float(y) + 0.5f + v.y,
                                   [&](std::size_t j) { return back.valid[j] && alike(back.vectors[j], -v, 0); });
      if (!there) continue;
      const Vec2f gap = v + *there;
      out[i] = gap.x * gap.x + gap.y * gap.y <= tolerance * tolerance;
    }
  });
  return out;
}

#endif  // TEMPERA_PATH_SPACE_MOTION

}  // namespace tempera::motion
