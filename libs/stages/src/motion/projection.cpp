// SPDX-License-Identifier: Apache-2.0
#include "motion/projection.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sound_values.h"
#include "tempera/core/parallel.h"
#include "tempera/stages/stage.h"

namespace tempera::motion {

namespace {

constexpr std::uint32_t kNobody = 0xffffffffu;

const Image* find_layer(const Frame& layers, const std::string& name, int channels, int frame) {
  const Layer* layer = layers.find(name);
  if (!layer) return nullptr;
  if (layer->image.channels() < channels) {
    throw Error(ErrorCode::kBadInput, fmt::format("frame {}: the layer \"{}\" has {} channels, {} are needed", frame,
                                                  name, layer->image.channels(), channels));
  }
  return &layer->image;
}

/// The pixels around those of `ring` for which `is_next(pixel of the ring, pixel)`: each once, in ascending order.
template <std::size_t N, class IsNext>
std::vector<std::size_t> next_ring(const std::vector<std::size_t>& ring, const int (&steps)[N][2], int w, int h,
                                   const IsNext& is_next) {
  std::vector<std::size_t> next;
  for (const std::size_t i : ring) {
    const int x = int(i % std::size_t(w)), y = int(i / std::size_t(w));
    for (const auto& s : steps) {
      const int nx = x + s[0], ny = y + s[1];
      if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
      const std::size_t j = std::size_t(ny) * std::size_t(w) + std::size_t(nx);
      if (is_next(i, j)) next.push_back(j);
    }
  }
  std::sort(next.begin(), next.end());
  next.erase(std::unique(next.begin(), next.end()), next.end());
  return next;
}

/// Continues values smoothly into pixels that have none, from those of the same object: ring by ring, and then so that
/// each is the mean of its neighbors. `known`: 1 where there is one. Returns how many are left without.
std::int64_t inpaint(Grid<Vec3f>& a, Grid<Vec3f>& b, Grid<std::uint8_t>& known, const Grid<float>& id) {
  const int w = a.width(), h = a.height();
  constexpr int kSteps[4][2] = {{0, -1}, {-1, 0}, {1, 0}, {0, 1}};
  std::vector<std::size_t> holes;
  for (std::size_t i = 0; i < known.size(); ++i) {
    if (!known[i]) holes.push_back(i);
  }
  if (holes.empty()) return 0;
  const auto mean_around = [&](std::size_t i, const Grid<Vec3f>& from, const Grid<std::uint8_t>& of, Vec3f& out) {
    const int x = int(i % std::size_t(w)), y = int(i / std::size_t(w));
    Vec3f sum;
    int count = 0;
    for (const auto& s : kSteps) {
      const int nx = x + s[0], ny = y + s[1];
      if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
      const std::size_t j = from.index(nx, ny);
      if (!of[j] || (!id.empty() && id[i] != id[j])) continue;
      sum += from[j], ++count;
    }
    if (count > 0) out = sum / float(count);
    return count > 0;
  };
  std::vector<std::size_t> ring, reached;
  const auto take = [&](std::size_t i, Vec3f& va, Vec3f& vb) {
    return mean_around(i, a, known, va) && mean_around(i, b, known, vb);
  };
  Vec3f va, vb;
  std::copy_if(holes.begin(), holes.end(), std::back_inserter(ring), [&](std::size_t i) { return take(i, va, vb); });
  while (!ring.empty()) {
    std::vector<std::pair<Vec3f, Vec3f>> values;
    for (const std::size_t i : ring) {
      take(i, va, vb);
      values.emplace_back(va, vb);
    }
    for (std::size_t k = 0; k < ring.size(); ++k)
      a[ring[k]] = values[k].first, b[ring[k]] = values[k].second, known[ring[k]] = 1;
    reached.insert(reached.end(), ring.begin(), ring.end());
    ring = next_ring(ring, kSteps, w, h,
                     [&](std::size_t i, std::size_t j) { return !known[j] && (id.empty() || id[i] == id[j]); });
  }
  constexpr int kSweeps = 50;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (const std::size_t i : reached) {  // in one order, so that the result has one value
      mean_around(i, a, known, a[i]);
      mean_around(i, b, known, b[i]);
    }
  }
  return std::int64_t(holes.size() - reached.size());
}

}  // namespace

bool Surfaces::nearer(std::size_t i, std::size_t j) const {
  if (!depth.empty()) return depth[i] < depth[j];
  const Vec3f &a = linear[i], &b = linear[j];
  return a.x * a.x + a.y * a.y > b.x * b.x + b.y * b.y;
}

Surfaces read_surfaces(const Frame& layers, int frame, const std::string& prefix) {
  const int w = layers.width(), h = layers.height();
  const auto find = [&](const LayerDesc& desc, int channels) {
    return find_layer(layers, prefix + desc.name, channels, frame);
  };
  const Image *forward = find(layers::motion_forward(), 2), *backward = find(layers::motion_backward(), 2);
  const Image *depth = find(layers::depth(), 1), *id = find(layers::object_id(), 1);
  Surfaces s;
  s.linear = Grid<Vec3f>(w, h), s.quadratic = Grid<Vec3f>(w, h);
  if (depth) {
    s.depth = Grid<float>(w, h);
    for (std::size_t i = 0; i < s.depth.size(); ++i) {
      const float z = depth->values()[i * std::size_t(depth->channels())];
      s.depth[i] = z > 0 && z < kFar ? z : kFar;
    }
  }
  if (id) {
    s.id = Grid<float>(w, h);
    for (std::size_t i = 0; i < s.id.size(); ++i) {
      const float v = id->values()[i * std::size_t(id->channels())];
      s.id[i] = std::isfinite(v) ? v : 0;  // of any size: some programs' are hashes
    }
  }
  Grid<std::uint8_t> known(w, h);
  const auto read = [](const Image* from, std::size_t i, Vec3f& v) {
    if (!from) return false;
    const int n = from->channels();
    const float* p = from->values().data() + i * std::size_t(n);
    if (!is_sound(p[0]) || !is_sound(p[1]) || (n >= 4 && !(p[3] > 0.5f))) return false;
    v = {p[0], p[1], n >= 3 ? sound(p[2]) : 0};
    return true;
  };
  for (std::size_t i = 0; i < known.size(); ++i) {
    Vec3f f, b;
    const bool has_f = read(forward, i, f), has_b = read(backward, i, b);
    if (!has_f) f = -b;
    if (!has_b) b = -f;
    s.linear[i] = (f - b) * 0.5f, s.quadratic[i] = (f + b) * 0.5f;
    known[i] = std::uint8_t((has_f ? kForward : 0) | (has_b ? kBackward : 0));
  }
  s.vectors = known;
  s.unknown = inpaint(s.linear, s.quadratic, known, s.id);
  return s;
}

Grid<Place> project(const Surfaces& s, float theta) {
  const int w = s.width(), h = s.height();
  struct Candidate {
    std::uint32_t pixel = kNobody;
    float depth = kFar;
  };
  Grid<Candidate> inside(w, h), around(w, h);  // whose square holds the pixel's center; whose center is within a pixel
  const auto offer = [](Candidate& c, std::uint32_t pixel, float depth) {
    if (c.pixel == kNobody || depth < c.depth) c = {pixel, depth};
  };
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = s.linear.index(x, y);
      if (s.vectors[i] == kNothing) continue;
      const Vec3f d = s.moved(i, theta);
      const float cx = float(x) + d.x, cy = float(y) + d.y;  // of the corner
      if (!(cx > -2 && cy > -2 && cx < float(w) + 1 && cy < float(h) + 1)) continue;
      const float depth = s.depth.empty() ? -(d.x * d.x + d.y * d.y) : s.depth[i] >= kFar ? kFar : s.depth[i] + d.z;
      const int x0 = int(std::floor(cx)), y0 = int(std::floor(cy));
      const int x1 = cx > float(x0) ? x0 + 1 : x0, y1 = cy > float(y0) ? y0 + 1 : y0;
      const int sx = int(std::floor(cx + 0.5f)), sy = int(std::floor(cy + 0.5f));
      for (int ty = y0; ty <= y1; ++ty) {
        for (int tx = x0; tx <= x1; ++tx) {
          if (tx >= 0 && ty >= 0 && tx < w && ty < h) offer(around.at(tx, ty), std::uint32_t(i), depth);
        }
      }
      if (sx >= 0 && sy >= 0 && sx < w && sy < h) offer(inside.at(sx, sy), std::uint32_t(i), depth);
    }
  }
  Grid<Place> out(w, h);
  const auto resolve = [&](int x, int y, const Candidate& c, Place& place) {
    if (c.pixel == kNobody) return false;
    const float tx = float(x) + 0.5f, ty = float(y) + 0.5f;
    Vec3f d = s.moved(c.pixel, theta);
    Place p;
    // Where the surface's pixels around say that it came from.
    for (int step = 0; step < 4; ++step) {
      p.x = tx - d.x, p.y = ty - d.y;
      if (!(p.x >= 0 && p.y >= 0 && p.x < float(w) && p.y < float(h))) return false;
      const std::size_t main = s.linear.index(int(p.x), int(p.y));
      if (!s.same(c.pixel, main)) return false;
      const Taps taps = taps_at(s, p);
      Vec3f next;
      for (int k = 0; k < 4; ++k) next += taps.weight[k] * s.moved(taps.pixel[k], theta);
      const float change = std::abs(next.x - d.x) + std::abs(next.y - d.y);
      d = next;
      if (change < 0.01f) break;
    }
    p.depth = c.depth;
    place = p;
    return true;
  };
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const Candidate &in = inside.at(x, y), &near = around.at(x, y);
      Place& place = out.at(x, y);
      // A surface that is stretched leaves cracks between its pixels, where what is behind it must not show.
      const bool in_front = near.pixel != kNobody && near.pixel != in.pixel && near.depth < in.depth;
      if (in_front && !s.same(near.pixel, in.pixel == kNobody ? near.pixel : in.pixel) && resolve(x, y, near, place))
        continue;
      if (resolve(x, y, in, place)) continue;
      resolve(x, y, near, place);
    }
  });
  return out;
}

Grid<Place> walk(std::span<const Surfaces* const> frames, int step) {
  const Surfaces& first = *frames.front();
  const int w = first.width(), h = first.height();
  const std::uint8_t onward = step > 0 ? kForward : kBackward, back = step > 0 ? kBackward : kForward;
  Grid<Place> out(w, h);
  const auto vector_at = [&](const Surfaces& s, const Taps& taps, float theta) {
    Vec3f d;
    for (int k = 0; k < 4; ++k) d += taps.weight[k] * s.moved(taps.pixel[k], theta);
    return d;
  };
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t start = first.linear.index(x, y);
      Place p{float(x) + 0.5f, float(y) + 0.5f};
      bool ok = true;
      for (std::size_t k = 0; ok && k + 1 < frames.size(); ++k) {
        const Surfaces &here = *frames[k], &there = *frames[k + 1];
        const Taps taps = taps_at(here, p);
        ok = here.vectors[taps.main] & onward;
        if (!ok) break;
        const Vec3f d = vector_at(here, taps, float(step));
        p.x += d.x, p.y += d.y;
        ok = p.x >= 0 && p.y >= 0 && p.x < float(w) && p.y < float(h);
        if (!ok) break;
        const Taps then = taps_at(there, p);
        ok = there.vectors[then.main] != kNothing;
        if (ok) ok = first.id.empty() || there.id.empty() || first.id[start] == there.id[then.main];
        if (ok && there.vectors[then.main] & back) {
          const Vec3f b = vector_at(there, then, float(-step));
          const float gap = (d.x + b.x) * (d.x + b.x) + (d.y + b.y) * (d.y + b.y);
          ok = gap <= 0.01f * (d.x * d.x + d.y * d.y) + 0.25f;
        }
      }
      if (ok) out.at(x, y) = p;
    }
  });
  return out;
}

void grow(Grid<Place>& places) {
  const int w = places.width(), h = places.height();
  const auto farthest_around = [&](std::size_t i) {
    const int x = int(i % std::size_t(w)), y = int(i / std::size_t(w));
    const Place* farthest = nullptr;
    for (const auto& o : kAround) {
      const int nx = x + o[0], ny = y + o[1];
      if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
      const Place& p = places.at(nx, ny);
      if (p.valid() && (!farthest || p.depth > farthest->depth)) farthest = &p;
    }
    return farthest;
  };
  std::vector<std::size_t> ring;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (!places[i].valid() && farthest_around(i)) ring.push_back(i);
  }
  while (!ring.empty()) {
    std::vector<Place> values;
    values.reserve(ring.size());
    for (const std::size_t i : ring) values.push_back(*farthest_around(i));
    for (std::size_t k = 0; k < ring.size(); ++k) places[ring[k]] = values[k];
    ring = next_ring(ring, kAround, w, h, [&](std::size_t, std::size_t j) { return !places[j].valid(); });
  }
}

Taps taps_at(const Surfaces& s, const Place& place) {
  const int w = s.width(), h = s.height();
  Taps t;
  t.main = s.linear.index(int(place.x), int(place.y));
  const float fx = place.x - 0.5f, fy = place.y - 0.5f;
  const int x0 = int(std::floor(fx)), y0 = int(std::floor(fy));
  const float u = fx - float(x0), v = fy - float(y0);
  float sum = 0;
  for (int k = 0; k < 4; ++k) {
    const int x = x0 + (k & 1), y = y0 + (k >> 1);
    const std::size_t i = s.linear.index(std::clamp(x, 0, w - 1), std::clamp(y, 0, h - 1));
    const float weight = ((k & 1) ? u : 1 - u) * ((k >> 1) ? v : 1 - v);
    t.pixel[k] = std::uint32_t(i);
    t.weight[k] = weight > 0 && s.same(t.main, i) ? weight : 0;
    sum += t.weight[k];
  }
  for (float& weight : t.weight) weight /= sum;  // the pixel that holds the place has a quarter at least
  return t;
}

std::vector<int> cuts_of(const Params& params) {
  const std::string& text = params.get_string("cuts");
  if (text.empty()) return {};
  try {
    return parse_frame_set(text);
  } catch (const Error& e) {
    throw StageParamError(e.code(), {"cuts"}, "cuts: " + e.message());
  }
}

Grid<std::uint8_t> covered_edges(const Surfaces& s) {
  const int w = s.width(), h = s.height();
  Grid<std::uint8_t> out(w, h);
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const std::size_t i = s.linear.index(x, y);
      for (int k = 0; k < 8; ++k) {
        const int nx = x + kAround[k][0], ny = y + kAround[k][1];
        if (nx < 0 || ny < 0 || nx >= w || ny >= h) continue;
        const std::size_t j = s.linear.index(nx, ny);
        if (!s.moves_with(i, j) && s.nearer(j, i)) out[i] = std::uint8_t(out[i] | 1u << k);
      }
    }
  });
  return out;
}

Image without_edges(const Image& image, const Surfaces& s, const Grid<std::uint8_t>& edges) {
  constexpr int kRadius = 2;
  const int w = s.width(), h = s.height(), n = image.channels();
  Image out = image;
  parallel_rows(0, h, [&](int y) {
    std::vector<float> sum(static_cast<std::size_t>(n));
    for (int x = 0; x < w; ++x) {
      const std::size_t i = edges.index(x, y);
      if (!edges[i]) continue;
      std::fill(sum.begin(), sum.end(), 0.0f);
      int count = 0;
      for (int ny = std::max(0, y - kRadius); ny <= std::min(h - 1, y + kRadius); ++ny) {
        for (int nx = std::max(0, x - kRadius); nx <= std::min(w - 1, x + kRadius); ++nx) {
          const std::size_t j = edges.index(nx, ny);
          if (edges[j] || !s.same(i, j)) continue;
          for (int c = 0; c < n; ++c) sum[c] += sound(image.at(nx, ny, c));
          ++count;
        }
      }
      if (count == 0) continue;
      for (int c = 0; c < n; ++c) out.at(x, y, c) = sum[c] / float(count);
    }
  });
  return out;
}

}  // namespace tempera::motion
