// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the generators of scenes share: geometry and materials go to a glTF file, textures and environments to files
// beside it, exact materials and the rest to shot.toml. Motion is a function of the frame number.
#include <functional>

#include "tempera/gallery/gallery.h"
#include "tempera/gallery/glb.h"
#include "tempera/gallery/picture.h"

namespace tempera {

class GalleryBuilder {
 public:
  GalleryBuilder(const GalleryScene& scene, const GalleryOptions& options);

  const GalleryScene& scene() const { return scene_; }
  gallery::Glb& glb() { return *glb_; }
  /// What follows goes to another glTF file, for variants. The first one is scene.glb.
  void start_file(const std::string& name);

  /// A texture in <name>.png; an index for `Look`.
  int texture(const std::string& name, const gallery::Picture& picture, bool srgb = true);
  int material(const gallery::Look& look) { return glb_->material(look); }
  /// Material with what shot.toml says about it in place of glTF's approximation: lines of [materials.<look.name>].
  int material(const gallery::Look& look, const std::string& exact);
  /// Clear smooth glass with the exact Fresnel equations.
  int glass(const std::string& name, double ior);

  /// Environment in environment.exr, or constant.
  void environment(const gallery::Picture& picture);
  void environment(const Rgb& radiance);
  /// Stops by which movies of the scene are brightened; negative: darkened.
  void exposure(double stops);
  /// A scene file in place of scene.glb.
  void scene_file(const std::string& name, const std::string& text);
  /// The published scene that this one needs. Errors: Error{kMissingFile}.
  std::filesystem::path needed_file() const;

  int mesh(const std::string& name, const gallery::Polygons& polygons, int material);
  /// A node with a mesh of its own.
  int place(const std::string& name, const gallery::Polygons& polygons, int material, const Vec3d& position = {},
            const Quatd& rotation = {}, int parent = -1);
  int place(const std::string& name, int mesh, const Vec3d& position = {}, const Quatd& rotation = {}, int parent = -1);
  /// A rectangle of `size` at `position` that shines along `direction`: a panel with a black back, since light of
  /// glTF's materials leaves to both sides.
  int lamp(const std::string& name, const Vec2d& size, const Rgb& radiance, const Vec3d& position,
           const Vec3d& direction);
  /// A node without geometry.
  int group(const std::string& name, const Vec3d& position = {}, const Quatd& rotation = {}, int parent = -1);

  /// Frames that keys are made for: from `begin` (0 or later) to `end`, `per_frame` keys each.
  void keys(double begin, double end, int per_frame);
  void move(int node, const std::function<Vec3d(double frame)>& position);
  void morph(int node, const std::function<std::vector<double>(double frame)>& weights);
  void turn(int node, const std::function<Quatd(double frame)>& rotation);
  /// Camera with a full vertical angle, at rest or moving.
  void camera(double fov_y_degrees, const Vec3d& eye, const Vec3d& target);
  void camera(double fov_y_degrees, const std::function<Vec3d(double frame)>& eye,
              const std::function<Vec3d(double frame)>& target);
  /// Another camera, which looks straight down on so much of the ground, with -z up.
  void camera_above(const std::string& name, const Vec3d& eye, const Vec2d& size);

  GalleryFiles finish();

 private:
  std::string shot_text(const GalleryVariant* variant) const;
  std::string readme() const;

  const GalleryScene& scene_;
  const GalleryOptions& options_;
  std::unique_ptr<gallery::Glb> glb_;
  std::string glb_file_ = "scene.glb";
  GalleryFiles files_;
  std::string scene_file_ = "scene.glb";
  std::vector<std::pair<std::string, std::string>> environment_, video_;  // keys of these tables
  std::map<std::string, std::string> materials_;                          // lines of [materials.<name>]
  std::vector<double> frames_, seconds_;
};

namespace gallery {

/// Rotation of a glTF camera (it looks along its -z, y up) from `eye` to `target`.
Quatd view(const Vec3d& eye, const Vec3d& target);
Quatd about_x(double degrees);
Quatd about_y(double degrees);
Quatd about_z(double degrees);

}  // namespace gallery
}  // namespace tempera
