// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/pixel_motion.h"

#include <cmath>

#include "tempera/core/parallel.h"
#include "tempera/transport/path_tracer.h"

namespace tempera {

namespace {

/// Middle of the exposure of scan line y of a frame.
double middle(const RenderSettings& settings, int frame, int y) {
  return settings.clock.exposure_time(frame, 0.5, (double(y) + 0.5) / settings.height);
}

}  // namespace

PixelView view_pixel(const FrameContext& context, int x, int y) {
  PixelView view;
  view.time = middle(context.settings, context.frame, y);
  view.ray = context.camera.ray({float(x) + 0.5f, float(y) + 0.5f}, {0.5f, 0.5f}, view.time);
  Ray ray{view.ray.o, view.ray.d, view.ray.tmin, view.ray.tmax, view.time};
  const FrameContext& now = context.at(view.time);
  const RayScene& rays = now.rays;
  const auto next = [&]() -> std::optional<Hit> {
    Hit hit;
    if (!intersect_seen(now, true, ray, hit)) return std::nullopt;
    return hit;
  };
  auto hit = next();
  for (int i = 0; hit && rays.has_opacity() && i < kMaxVertices; ++i) {  // look through what is mostly transparent
    const Material& material = *rays.shape(hit->point).material;
    if (!material.has_opacity()) break;
    const ShadingPoint s = rays.shading_point(hit->point, view.time, -ray.d);
    if (material.opacity(s) >= 0.5f) break;
    ray.o = rays.offset_origin(s.p, s.ng, ray.d);
    ray.tmin = 0;
    hit = next();
  }
  if (hit) {
    view.point = hit->point;
    view.distance = length(rays.position(hit->point, view.time) - view.ray.o);
  }
  return view;
}

std::optional<PixelMotion> pixel_motion(const FrameContext& context, const PixelView& view, int step) {
  if (context.settings.is_cut(step > 0 ? context.frame + 1 : context.frame)) return std::nullopt;
  const CameraModel& camera = context.camera;
  const RayScene& rays = context.at(view.time).rays;
  const double now = view.time, then = now + step * context.settings.clock.frame_duration();
  PixelMotion m;
  if (view.point) {
    const auto a = camera.project(rays.position(*view.point, now), now);
    const auto b = camera.project(rays.position(*view.point, then), then);
    if (!a || !b) return std::nullopt;
    m = {b->pixel - a->pixel, b->depth - a->depth};
  } else if (const auto a = camera.project_direction(view.ray.d, now)) {
    const auto b = camera.project_direction(context.lights.environment_motion(view.ray.d, now, then), then);
    if (!b) return std::nullopt;
    m = {*b - *a, 0};
  } else {  // parallel projection sees no directions: a far point instead
    const Vec3f p = view.ray.o + view.ray.d * (1e3f * std::max(1.0f, rays.bounds().radius()));
    const auto from = camera.project(p, now), to = camera.project(p, then);
    if (!from || !to) return std::nullopt;
    m = {to->pixel - from->pixel, 0};
  }
  if (!std::isfinite(m.pixels.x) || !std::isfinite(m.pixels.y) || !std::isfinite(m.depth)) return std::nullopt;
  return m;
}

void write_motion(const FrameContext& context, const Tile& tile, Frame& out) {
  const auto layer = [&](const char* name) { return out.has(name) ? &out.layer(name) : nullptr; };
  Image *object_id = layer("object_id"), *forward = layer("motion.forward"), *backward = layer("motion.backward");
  if (!object_id && !forward && !backward) return;
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      const int ox = x - context.settings.x0(), oy = y - context.settings.y0();
      const PixelView view = view_pixel(context, x, y);
      if (object_id) object_id->at(ox, oy) = view.point ? float(view.point->instance + 1) : 0.0f;
      const auto write = [&](Image* image, int step) {
        if (!image) return;
        const auto m = pixel_motion(context, view, step);
        image->at(ox, oy, 0) = m ? m->pixels.x : 0.0f;
        image->at(ox, oy, 1) = m ? m->pixels.y : 0.0f;
        image->at(ox, oy, 2) = m ? m->depth : 0.0f;
        image->at(ox, oy, 3) = m ? 1.0f : 0.0f;
      };
      write(forward, 1);
      write(backward, -1);
    }
  }
}

ReplayMap make_replay_map(const FrameContext& before, const FrameContext& now) {
  const RenderSettings& settings = now.settings;
  ReplayMap map{settings.x0(), settings.y0(), settings.x1() - settings.x0(), settings.y1() - settings.y0(), {}};
  const int w = map.width, h = map.height;
  const std::size_t n = std::size_t(w) * std::size_t(h);
  /// The pixel that another frame's pixel leads to, and how far away what it shows is.
  struct Arrow {
    int x = -1, y = -1;
    float distance = kInfinity;
    Vec2f residue;
  };
  const auto arrows = [&](const FrameContext& context, int step) {
    std::vector<Arrow> result(n);
    parallel_for(0, h, [&](std::int64_t row) {
      for (int i = 0; i < w; ++i) {
        const PixelView view = view_pixel(context, map.x0 + i, map.y0 + int(row));
        const auto m = pixel_motion(context, view, step);
        if (!m || std::abs(m->pixels.x) > float(w) || std::abs(m->pixels.y) > float(h)) continue;
        const int x = i + int(std::lround(m->pixels.x)), y = int(row) + int(std::lround(m->pixels.y));
        if (x < 0 || y < 0 || x >= w || y >= h) continue;
        const Vec2f residue{m->pixels.x - float(x - i), m->pixels.y - float(y - int(row))};
        result[std::size_t(row) * std::size_t(w) + std::size_t(i)] = {x, y, view.distance, residue};
      }
    });
    return result;
  };
  const std::vector<Arrow> forward = arrows(before, 1), backward = arrows(now, -1);
  map.sources.assign(n, {});
  std::vector<float> nearest(n, kInfinity);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const Arrow& f = forward[std::size_t(y) * std::size_t(w) + std::size_t(x)];
      if (f.x < 0) continue;
      // There and back again must lead to where it began, or to a neighbour: else something else stands there.
      const std::size_t j = std::size_t(f.y) * std::size_t(w) + std::size_t(f.x);
      const Arrow& b = backward[j];
      if (b.x < 0 || std::abs(b.x - x) > 1 || std::abs(b.y - y) > 1) continue;
      // Of several pixels that lead to one, the closest to the camera keeps it.
      if (map.sources[j].x >= 0 && !(f.distance < nearest[j])) continue;
      map.sources[j] = {x + map.x0, y + map.y0, f.residue};
      nearest[j] = f.distance;
    }
  }
  return map;
}

}  // namespace tempera
