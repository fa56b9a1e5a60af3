// SPDX-License-Identifier: Apache-2.0
#pragma once
// Matter as Embree sees it: placed shapes, and the geometry of a scene that no RayScene has to build again.
#include <embree3/rtcore.h>

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "tempera/accel/ray_scene.h"
#include "tempera/scene/analytic.h"
#include "tempera/scene/deform.h"

namespace tempera {

/// Vertices of one mesh as Embree sees them at one knot. Spans point into the mesh itself where nothing changes them.
struct KnotVertices {
  std::vector<Vec3f> own_positions, own_normals;
  const Vec3f* positions = nullptr;
  const Vec3f* normals = nullptr;  // null: flat shading
};

/// How matter is handed to Embree.
enum class Placement : std::uint8_t {
  kStatic,     // never moves in the whole shot and is used once: vertices in world space
  kInstanced,  // rigid motion, or one of several copies: object-space geometry under an Embree instance
  kDeforming,  // vertices change over time: world-space vertices at each knot
};

/// One shape at one place (or, for instanced placement, one shape in object space).
struct PlacedShape {
  std::uint32_t instance = 0, shape = 0;
  Placement placement = Placement::kStatic;
  const Mesh* mesh = nullptr;  // null: analytic
  AnalyticShape analytic;      // object_from_unit already in the frame that Embree sees
  Affine3f unit_from_object;
  bool tangents = true;             // the material needs them
  bool mirrored = false;            // vertices were moved by a mirroring map: winding shows the back
  bool mirroring_changes = false;   // deforming: over the evaluation span
  std::vector<KnotVertices> knots;  // 1 for non-deforming meshes
  Bounds3f box;                     // of the triangles of an instanced mesh
  float radius = 0;                 // of the ball around the center of `box` that holds them
  std::size_t first_knot = 0;       // of `knots` among the poses, deforming only
  std::vector<MeshPose> poses;      // deforming: at every knot of the evaluation span

  /// An analytic shape whose motion Embree cannot follow as that of an instance: intersected in the world.
  struct Moving {
    std::function<Affine3f(double t)> world;  // empty: not such a shape
    double begin = 0, duration = 0;           // seconds: what Embree's times 0 and 1 stand for
    Bounds3f bounds;                          // over the whole of that
  } moving;
};

/// Owner of an RTCScene.
struct EmbreeScene {
  RTCScene scene = nullptr;
  EmbreeScene() = default;
  explicit EmbreeScene(RTCScene s) : scene(s) {}
  EmbreeScene(EmbreeScene&& o) noexcept : scene(std::exchange(o.scene, nullptr)) {}
  EmbreeScene& operator=(EmbreeScene&& o) noexcept {
    std::swap(scene, o.scene);
    return *this;
  }
  ~EmbreeScene() {
    if (scene) rtcReleaseScene(scene);
  }
};

/// Errors: Error{kFailed} if there is none.
RTCDevice new_device();
/// Errors: Error{kOutOfMemory | kFailed} if the device reports an error.
void check_device(RTCDevice device);

struct GeometryCache::Impl {
  RTCDevice device = nullptr;
  std::atomic<std::int64_t> bytes{0};
  // Filled by the first RayScene; a cache serves one scene.
  const Scene* scene = nullptr;
  std::vector<Placement> placements;                 // per (instance, position in group), flattened
  std::vector<std::size_t> first_placed;             // per instance: index of its first shape below
  std::vector<std::unique_ptr<PlacedShape>> placed;  // static ones are complete; deforming ones are templates
  std::map<std::uint32_t, std::unique_ptr<PlacedShape>> object_shapes;  // instanced: by shape
  EmbreeScene static_scene;
  std::vector<const PlacedShape*> static_ids;  // by geomID of static_scene
  std::map<int, EmbreeScene> group_scenes;
  std::uint64_t vertex_bytes = 0;
  bool anything_moves = false;
  bool has_opacity = false;

  void add_geometry(RTCScene target, const PlacedShape& source, RTCBuildQuality quality) const;
  void prepare(const Scene& s, bool robust);
};

}  // namespace tempera
