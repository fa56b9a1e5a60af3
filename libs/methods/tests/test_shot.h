// SPDX-License-Identifier: Apache-2.0
#pragma once
// Small scenes made in code, rendered by any integrator without a pipeline.
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <string>

#include "support/effort.h"
#include "tempera/core/parallel.h"
#include "tempera/methods/render_section.h"

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

  Frame render(int frame = 0) const {
    const auto method = make_method();
    GeometryCache cache;
    RenderSettings scaled = settings;
    scaled.spp *= test::effort();
    return render(*method, scaled, cache, frame, method->passes(scaled, {frame, frame}));
  }
  std::unique_ptr<Method> make_method() const {
    validate(scene);
    Params params(find_method(integrator).params);
    for (std::size_t at = 0; at < parameters.size();) {
      const auto end = std::min(parameters.find(',', at), parameters.size()), equal = parameters.find('=', at);
      params.set_text(parameters.substr(at, equal - at), parameters.substr(equal + 1, end - equal - 1));
      at = end + 1;
    }
    return find_method(integrator).make(params);
  }

 private:
  /// The first passes of a frame, or all of them.
  Frame render(const Method& method, const RenderSettings& scaled, GeometryCache& cache, int frame,
               std::vector<PassDesc> passes) const {
    const bool whole = passes.size() == method.passes(scaled, {frame, frame}).size();
    const LightPathClassifier classifier(path_expressions(method, settings));
    SceneWindow window(scene, scaled, classifier, 1.0 / 16, cache, {frame, frame});
    Section section(method, scaled, scene, {frame, frame}, {frame}, std::move(passes), tile);
    SectionHooks hooks;
    hooks.read = [&](int before, const LayerRead& read) {
      std::vector<PassDesc> first = method.passes(scaled, {before, before});
      while (first.back().name != read.pass) first.pop_back();
      return render(method, scaled, cache, before, std::move(first)).layer(read.layer);
    };
    EXPECT_TRUE(render_section(method, window, section, {}, hooks, {}));
    EXPECT_EQ(section.totals().bad_samples, 0u);
    if (whole) section.finish(method);
    return std::move(section.picture(frame));
  }
};

inline std::vector<float> values(const Image& image) { return {image.values().begin(), image.values().end()}; }

}  // namespace tempera
