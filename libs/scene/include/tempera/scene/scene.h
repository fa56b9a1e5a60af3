// SPDX-License-Identifier: Apache-2.0
#pragma once
// The shot: geometry, materials, cameras and lights over time, as authored. Built by an importer, then immutable; there
// is no current time. y is up, units are metres, right-handed.
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tempera/core/animated.h"
#include "tempera/core/time.h"
#include "tempera/scene/geometry.h"
#include "tempera/shading/material.h"

namespace tempera {

/// A frame of the transform hierarchy.
struct Node {
  int parent = -1;  ///< index of an earlier node, or -1
  AnimatedTransform local;
  std::string name;
  Animated<float> visibility{1.0f};  ///< below 0.5: this node and its children are not rendered
};

struct PunctualLight;

/// Radiance leaving a surface. One-sided: only from the front (where the geometric normal points).
struct AreaEmission {
  Slot radiance{0.0f};  ///< W/(m^2 sr); with a spread or a spot what it would be without
  bool two_sided = false;
  /// Radians, above 0: light leaves within this angle of the normal, as through a grid of slats, with the power that it
  /// would have without: times (tan(half_spread) - tan(angle)) / (tan(half_spread) - half_spread). pi/2: evenly.
  float half_spread = kPi / 2;
  /// A spot light with a size: radiance is multiplied by the falloff of this light, by direction from its axis, and it
  /// decides the axis. Null: none.
  std::shared_ptr<const PunctualLight> spot{};
};

/// A piece of geometry with one material.
struct Shape {
  Geometry geometry;
  MaterialPtr material;
  std::optional<AreaEmission> emission;
  std::string name;
  std::string material_name;
};

/// Places a group of shapes. Shapes used once are instances of a group of one.
struct Instance {
  int group = 0;               ///< Scene::groups index
  int node = -1;               ///< Scene::nodes index, -1: identity
  std::string name;            ///< object name for ids and cryptomatte
  bool camera_visible = true;  ///< false: rays that come straight from the camera pass through it
};

/// How a spot's light falls from full at `beam_width` to nothing at `cutoff_angle`.
enum class SpotFalloff {
  kLinear,     ///< linear in the angle: Mitsuba
  kSquared,    ///< square of what is linear in the cosine: glTF
  kSmoothstep  ///< 3 x^2 - 2 x^3 of what is linear in the cosine: Blender
};

enum class LightType { kPoint, kSpot, kDirectional, kProjector };

/// A light without area. Pose by `node`: position at the origin, pointing along local +z (importers convert).
struct PunctualLight {
  LightType type = LightType::kPoint;
  int node = -1;
  Animated<Rgb> intensity{Rgb(1.0f)};  ///< W/sr; directional: irradiance W/m^2; projector: see texture
  Animated<float> intensity_scale{1.0f};
  Animated<float> cutoff_angle{0.34906585f};  ///< spot: half angle in radians where light ends
  Animated<float> beam_width{0.26179939f};    ///< spot: half angle up to which it is full
  SpotFalloff falloff = SpotFalloff::kLinear;
  float angle = 0;              ///< directional: angle that the disk of the sun spans, radians; 0: a point
  bool camera_visible = false;  ///< directional with an angle: whether the camera sees the disk
  std::shared_ptr<const Texture>
      texture;                       ///< spot: intensity over the cone's image; projector: irradiance at distance 1
  float projector_fov = 0.7853982f;  ///< projector: full angle along x, radians
  float projector_aspect = 1;        ///< projector: width over height
  std::string name;
};

/// Light from infinity over all directions. Local frame: latitude-longitude with y up, u = 0 along... see
/// EnvironmentImage.
struct Environment {
  int node = -1;                      ///< rotation only
  Animated<Rgb> radiance{Rgb(1.0f)};  ///< constant radiance, or factor of the image
  /// Equirectangular linear RGB, row 0 at +y; [height][width] row-major. Direction d in local space maps to
  /// u = atan2(d.x, -d.z) / 2pi (mod 1), v = acos(d.y) / pi: Mitsuba's convention. Empty: constant.
  std::vector<Rgb> image;
  int width = 0, height = 0;
  bool camera_visible = true;
  std::string name;
};

enum class Projection { kPerspective, kOrthographic };

/// The side of the picture whose length a sensor has: its larger one (pixel aspect included), or always the same.
enum class SensorFit { kAuto, kHorizontal, kVertical };

/// A camera that looks along its node's local +z with +y up and +x to the *left* of the picture (Mitsuba's frame;
/// importers of formats that look along -z turn by 180 degrees about y).
struct Camera {
  std::string name;
  Projection projection = Projection::kPerspective;
  int node = -1;
  Animated<float> fov_x{0.7853982f};  ///< perspective: full horizontal angle, radians, in (0, pi)
  /// How fov_x is defined when the film's aspect differs from `authored_aspect`: glTF keeps the vertical angle.
  bool keep_vertical_fov = false;
  float authored_aspect = 16.0f / 9.0f;
  Animated<float> width{2.0f};            ///< orthographic: width of the picture in metres
  Animated<float> aperture_radius{0.0f};  ///< metres; 0: pinhole
  /// Above 0 it decides the aperture: its radius is focal length / (2 f_stop), where the focal length is what gives the
  /// field of view on a sensor of `sensor_size`. Orthographic cameras have none: 1 m / (2 f_stop), as in Blender.
  Animated<float> f_stop{0.0f};
  float sensor_size = 0.036f;  ///< metres along the side of the picture that `sensor_fit` names
  SensorFit sensor_fit = SensorFit::kAuto;
  Animated<float> focus_distance{1.0f};  ///< metres along the view axis
  int focus_node = -1;                   ///< in focus is what is as far along the view axis as this node's origin
  Vec2f principal_offset{0, 0};          ///< shift of the picture in fractions of width and height (x right, y down)
  float pixel_aspect = 1;                ///< width of a pixel over its height
  float near_clip = 1e-2f, far_clip = 1e7f;
};

/// What a scene file asks of the film and the integrator; a shot or the command line may override each.
struct RenderDefaults {
  std::optional<int> width, height;
  std::optional<std::string> filter;    ///< box, tent, gaussian, mitchell, blackman_harris
  std::optional<double> filter_radius;  ///< pixels
  std::optional<int> spp;
  std::optional<std::string> sampler;
  std::optional<std::string> integrator;   ///< ours, e.g. "path"
  std::optional<int> max_depth, rr_depth;  ///< as in Mitsuba: number of path edges; -1 unlimited
  std::optional<bool> hide_emitters;
  std::optional<Shutter> shutter;
  std::optional<TimeSpan> exposure;  ///< absolute shutter times (Mitsuba: seconds), for single pictures
  int crop_x = 0, crop_y = 0, crop_width = 0, crop_height = 0;  ///< crop_width 0: no crop
  bool null_counts_as_bounce = false;  ///< Mitsuba counts passing through a mask as a path edge
};

struct Scene {
  std::vector<Node> nodes;
  std::vector<Shape> shapes;
  std::vector<std::vector<int>> groups;  ///< lists of shape indices
  std::vector<Instance> instances;
  std::vector<PunctualLight> lights;
  std::vector<Environment> environments;  ///< their radiance adds up
  std::vector<Camera> cameras;
  int default_camera = 0;
  /// Whether eye paths bend shading normals for the viewer (make_bsdf). Formats say how their surfaces are shaded: glTF
  /// leaves it to us, and it is on; Mitsuba shades with normals as they are.
  bool bend_normals = false;
  RenderDefaults defaults;
  TimeSpan animation;  ///< seconds covered by keys; begin == end: static
  std::vector<std::string> animation_names;
  std::filesystem::path source;
  /// FNV-like hash of all input files' contents, for metadata and resume.
  std::uint64_t content_hash = 0;

  /// World transform of `node` at time `t` (seconds); identity for -1.
  Affine3d world(int node, double t) const { return world(node, t, t); }
  /// The same as if the piece between jumps that holds the time `piece` went on for ever; see Animated::at.
  Affine3d world(int node, double t, double piece) const;
  /// Appends the times within the open `span` at which `node` jumps to another place or appears or disappears.
  void jumps(int node, TimeSpan span, std::vector<double>& out) const;
  /// Whether the world transform of `node` can change within `span`.
  bool moves(int node, TimeSpan span) const;
  bool visible(int node, double t) const;
};

/// Checks everything that other modules rely on: indices in range, finite numbers, no cycles, sizes that agree.
/// Errors: Error{kBadInput} naming the shape, node or light.
void validate(const Scene& scene);

}  // namespace tempera
