// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a scene consists of, counted: for `tempera info` and for checks after an import.
#include <cstdint>
#include <string>
#include <vector>

#include "tempera/scene/scene.h"

namespace tempera {

struct CameraInfo {
  std::string name;
  bool orthographic = false;
  double fov_degrees = 0;  ///< full horizontal angle at the start; 0: orthographic
  bool animated = false;   ///< its pose or its lens
  bool is_default = false;
};

struct SceneInfo {
  std::vector<CameraInfo> cameras;
  std::vector<std::string> animations;
  TimeSpan animation;  ///< seconds
  std::size_t nodes = 0, moving_nodes = 0;
  std::size_t meshes = 0, spheres = 0, disks = 0, cylinders = 0;
  std::size_t skinned = 0, morphed = 0, cached = 0;  ///< of the meshes
  std::size_t instances = 0;
  std::uint64_t triangles = 0;         ///< stored
  std::uint64_t placed_triangles = 0;  ///< with instances
  std::vector<std::string> materials;  ///< names in use, sorted
  std::size_t area_lights = 0, point_lights = 0, spot_lights = 0, directional_lights = 0, projectors = 0;
  std::size_t environments = 0;
  int environment_width = 0, environment_height = 0;  ///< of the largest image
  std::uint64_t memory = 0;                           ///< bytes of geometry and environment
};

SceneInfo describe(const Scene& scene);

}  // namespace tempera
