// SPDX-License-Identifier: Apache-2.0
#pragma once
// Small scenes made in code, rendered by any integrator without a pipeline.
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <string>

#include "support/effort.h"
#include "tempera/core/parallel.h"
#include "tempera/transport/frame_scene.h"

namespace tempera {

/// A shot made in code: one shape an instance, one node each.
struct TestShot {
  Scene scene;
  RenderSettings settings;
  std::string integrator = "path";
  std::string parameters;  ///< "name=value,..."
  int tile = 16;

  TestShot() {
    settings.width = settings.height = 32;
    settings.spp = 64;
    settings.sampler = SamplerKind::kIndependent;
    settings.clock.fps = 1;  // seconds are frames
    settings.clock.shutter = {.open = 0, .close = 0};
  }
  int node(AnimatedTransform t) {
    scene.nodes.push_back({-1, std::move(t), "", 1.0f});
    return int(scene.nodes.size()) - 1;
  }
  Shape& add(Geometry g, MaterialPtr material, int node = -1) {
    scene.shapes.push_back({std::move(g), std::move(material), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back(
        {int(scene.groups.size()) - 1, node, "shape" + std::to_string(scene.shapes.size()), true});
    return scene.shapes.back();
  }
  /// Orthographic picture of the square [-half, half]^2 in the plane z = 0, seen from +z; x to the right.
  void orthographic(float half) {
    Camera c;
    c.projection = Projection::kOrthographic;
    c.node = node(Affine3d(look_at(Vec3f{0, 0, 5}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0})));
    c.width = 2 * half;
    scene.cameras = {c};
  }
  Camera& perspective(AnimatedTransform pose, float fov) {
    Camera c;
    c.node = node(std::move(pose));
    c.fov_x = fov;
    scene.cameras = {c};
    return scene.cameras.back();
  }

  /// `only_for_next_frame`: only what the next frame needs of this one.
  Frame render(int frame = 0, bool only_for_next_frame = false) const {
    validate(scene);
    Params params(find_integrator(integrator).params);
    for (std::size_t at = 0; at < parameters.size();) {
      const auto end = std::min(parameters.find(',', at), parameters.size()), equal = parameters.find('=', at);
      params.set_text(parameters.substr(at, equal - at), parameters.substr(equal + 1, end - equal - 1));
      at = end + 1;
    }
    const auto renderer = find_integrator(integrator).make(params);
    GeometryCache cache;
    std::vector<std::string> expressions;
    for (const PathClass& c : settings.classes) expressions.push_back(c.expression);
    const LightPathClassifier classifier(expressions);
    RenderSettings scaled = settings;
    scaled.spp *= test::effort();
    const FrameScene frame_scene(scene, scaled, classifier, frame, 1.0 / 16, cache);
    const PrecedingFrame before(frame_scene);
    FrameContext context = frame_scene.context(nullptr, only_for_next_frame);
    std::optional<Frame> layers_before;
    if (!only_for_next_frame && !renderer->layers_for_next_frame().empty()) layers_before = render(frame - 1, true);
    const auto plan = renderer->prepare(context, renderer->frames_before() ? &before.context() : nullptr,
                                        layers_before ? &*layers_before : nullptr);
    context.plan = plan.get();
    Frame out = make_frame(*renderer, scaled, scene);
    RenderCounters counters;
    const int nx = (settings.width + tile - 1) / tile, ny = (settings.height + tile - 1) / tile;
    for (int round = 0; round < renderer->rounds(scaled); ++round) {
      if (round > 0) renderer->next_round(context, out);
      parallel_for(0, nx * ny, [&](std::int64_t i) {
        const int x = int(i) % nx * tile, y = int(i) / nx * tile;
        renderer->render(context, {x, y, std::min(x + tile, settings.width), std::min(y + tile, settings.height)}, out,
                         counters, {});
      });
    }
    EXPECT_EQ(counters.bad_samples, 0u);
    finish_frame(*renderer, context, out);
    return out;
  }
};

inline std::vector<float> values(const Image& image) { return {image.values().begin(), image.values().end()}; }

}  // namespace tempera
