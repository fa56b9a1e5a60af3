// SPDX-License-Identifier: Apache-2.0
#pragma once
// An open box with a ball under lights of every kind.
#include "tempera/scene/light_shape.h"
#include "test_shot.h"

namespace tempera {

inline Mesh quad(const Vec3f& center, const Vec3f& s, const Vec3f& t) {
  Mesh m;
  m.positions = {center - s - t, center + s - t, center + s + t, center - s + t};
  m.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  m.indices = {0, 1, 2, 0, 2, 3};
  return m;
}

/// An octahedron of radius 1 that is shaded like a sphere: no mesh is coarser.
inline Mesh coarse_ball() {
  Mesh m;
  m.positions = m.normals = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  m.indices = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
  return m;
}

/// An open box of 2 units, seen from +z, with one material for the floor and one for a ball.
struct BoxShot : TestShot {
  BoxShot(MaterialPtr floor, MaterialPtr ball) {
    const MaterialPtr white = make_two_sided(make_diffuse(0.7f)),
                      red = make_two_sided(make_diffuse(Rgb{0.6f, 0.1f, 0.1f}));
    add(quad({0, -1, 0}, {1, 0, 0}, {0, 0, -1}), std::move(floor));
    add(quad({0, 1, 0}, {1, 0, 0}, {0, 0, 1}), white);
    add(quad({0, 0, -1}, {1, 0, 0}, {0, 1, 0}), white);
    add(quad({-1, 0, 0}, {0, 0, 1}, {0, -1, 0}), red);
    add(quad({1, 0, 0}, {0, 0, 1}, {0, 1, 0}), white);
    if (ball) {
      add(Sphere{}, std::move(ball),
          node(Affine3d(translate(Vec3d{0.25, -0.5, 0.1}) * scale(Vec3d{0.45, 0.45, 0.45}))));
    }
    perspective(Affine3d(look_at(Vec3f{0.1f, 0.1f, 3.2f}, Vec3f{0, -0.1f, 0}, Vec3f{0, 1, 0})), 0.7f);
    settings.width = 24, settings.height = 20;
    settings.filter = PixelFilter(FilterKind::kBox);
    parameters = "max_depth=6";
  }
  BoxShot& area_light(float size = 0.3f) {
    add(quad({-0.1f, 0.98f, 0.1f}, {size, 0, 0}, {0, 0, size}), make_diffuse(0.2f)).emission =
        AreaEmission{Slot(4.0f), false};
    return *this;
  }
  BoxShot& lamp(LightType type) {
    PunctualLight light;
    light.type = type;
    light.intensity = Rgb(1.5f);
    light.cutoff_angle = 0.6f;
    light.beam_width = 0.5f;
    light.node = node(Affine3d(look_at(Vec3f{-0.3f, 0.8f, 0.5f}, Vec3f{0.2f, -0.8f, 0}, Vec3f{0, 0, 1})));
    scene.lights.push_back(light);
    return *this;
  }
  /// Gives the last lamp a radius.
  BoxShot& sized(float radius) {
    make_sphere_light(scene, int(scene.lights.size()) - 1, radius, false);
    return *this;
  }
  /// A coarse ball, turned, whose shading normals are bent for the viewer.
  BoxShot& coarse(MaterialPtr material) {
    add(coarse_ball(), std::move(material),
        node(Affine3d(translate(Vec3d{-0.35, -0.45, 0.2}) * rotation(axis_angle(Vec3d{1, 2, 3}, 0.7)) *
                      scale(Vec3d{0.5, 0.5, 0.5}))));
    scene.bend_normals = true;
    return *this;
  }
  /// A dim sky with one bright texel, whose light is concentrated enough for photons.
  BoxShot& sky_with_a_sun() {
    Environment e;
    e.width = 32, e.height = 16;
    e.image.assign(512, Rgb(0.1f));
    e.image[4 * 32 + 9] = Rgb(200.0f);
    scene.environments.push_back(e);
    return *this;
  }
  BoxShot& sky() {
    Environment e;
    e.radiance = Rgb{1, 1.2f, 1.5f};
    e.width = 16, e.height = 8;
    for (int i = 0; i < 128; ++i) e.image.push_back(i % 37 == 5 ? Rgb(6.0f) : Rgb(0.3f));
    scene.environments.push_back(e);
    return *this;
  }
};

}  // namespace tempera
