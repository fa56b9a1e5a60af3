// SPDX-License-Identifier: Apache-2.0
#pragma once
// Writes scenes as binary glTF 2.0: meshes with skins and morph targets, materials with the extensions that change
// light transport, cameras, punctual lights and animations. What it cannot say is not needed by generated scenes.
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "tempera/core/vec.h"
#include "tempera/gallery/polygons.h"

namespace tempera::gallery {

/// glTF's metallic-roughness material. Texture members are indices of Glb::image, -1: none.
struct Look {
  std::string name;
  Rgb color{0.5f};       ///< linear; times the texture
  int texture = -1;      ///< color, sRGB
  double roughness = 1;  ///< perceptual: alpha = roughness^2
  double metallic = 0;
  int surface_texture = -1;  ///< roughness in green, metallic in blue; times the factors
  int normal_texture = -1;
  double normal_scale = 1;
  double specular = 1;  ///< strength of a dielectric's reflection; 0: diffuse alone
  Rgb emission{0.0f};   ///< radiance, W/(m^2 sr); any size
  int emission_texture = -1;
  double transmission = 0;  ///< 1: clear
  bool solid = true;        ///< of a transmissive material: a body that refracts, not a thin wall
  double ior = 1.5;
  Rgb attenuation_color{1.0f};
  double attenuation_distance = 0;  ///< metres; 0: none
  double clearcoat = 0, clearcoat_roughness = 0;
};

class Glb {
 public:
  Glb();
  ~Glb();
  Glb(const Glb&) = delete;
  Glb& operator=(const Glb&) = delete;

  /// A picture in a file beside the scene. Returns an index for `Look`.
  int image(const std::string& file);
  int material(const Look& look);

  struct Part {
    Polygons polygons;
    int material = -1;
  };
  /// Pre: the parts of one mesh have the same number of morph targets.
  int mesh(const std::string& name, std::span<const Part> parts);

  struct Node {
    std::string name;
    int parent = -1;
    Vec3d translation{};
    Quatd rotation{};
    Vec3d scale{1, 1, 1};
    int mesh = -1, skin = -1, camera = -1, light = -1;
  };
  int node(const Node& node);
  /// Joints are nodes; `inverse_bind` takes points of the mesh to the frame of the joint at bind time.
  int skin(std::span<const int> joints, std::span<const Affine3d> inverse_bind);
  /// Perspective camera that looks along its node's -z; the angle is the full vertical one.
  int camera(const std::string& name, double fov_y_degrees, double aspect);
  /// Orthographic camera whose picture is so wide and high, in metres.
  int camera(const std::string& name, const Vec2d& size);
  /// Directional light along its node's -z; irradiance in W/m^2 on a surface that faces it.
  int directional_light(const std::string& name, const Rgb& irradiance);

  enum class Interpolation { kStep, kLinear };
  /// Animations that follow go to the clip of this name, which is made when it is new.
  void clip(const std::string& name);
  void translate(int node, std::span<const double> times, std::span<const Vec3d> values,
                 Interpolation interpolation = Interpolation::kLinear);
  void rotate(int node, std::span<const double> times, std::span<const Quatd> values,
              Interpolation interpolation = Interpolation::kLinear);
  /// `values`: one per morph target and key, the targets of a key together.
  void morph(int node, std::span<const double> times, std::span<const double> values);

  /// Triangles of all meshes, and those that nodes place.
  std::size_t triangles() const;
  std::size_t placed_triangles() const;
  /// The whole file. Result: a function of the calls alone.
  std::string bytes() const;

 private:
  struct Data;
  std::unique_ptr<Data> data_;
};

}  // namespace tempera::gallery
