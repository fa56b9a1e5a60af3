// SPDX-License-Identifier: Apache-2.0
#pragma once
// glTF 2.0 (.gltf and .glb) to `Scene`. Most callers want `import_scene`, which chooses the importer by file name.
#include <filesystem>

#include "tempera/import/import.h"

namespace tempera {

/// Reads the default scene of `file` (the first one, or all root nodes, if it names none). Time 0 is glTF's time 0.
///
/// Where glTF leaves a choice, or a renderer of films has to differ from one of games:
/// - Animations all play together, unless `options.animation` names one (or gives its number, or "none"). Of those that
///   drive the same thing the first plays; the others are named in a warning.
/// - Surfaces show both sides, whatever doubleSided says. Emissive surfaces shine to the front, and to the back if they
///   are doubleSided: glTF does not show the back of others.
/// - Shading normals are bent for the viewer (Scene::bend_normals).
/// - Lights: one candela is 1 W/sr and one lux 1 W/m^2, the scale of emissive surfaces (1 nit is 1 W/(m^2 sr)).
/// Blender's
///   exporter multiplies the power of lights, but not of surfaces, by 683 lm/W (or, before version 3.4, writes Watts);
///   for its files this is undone, so that both keep the ratio that they have in Cycles.
/// - Transmission without KHR_materials_volume is thin-walled, except in files by Blender's exporter, which cannot say
///   otherwise: Cycles refracts there.
/// - Occlusion textures, the range of lights and the thickness of volumes are for renderers that do not trace paths.
/// Units:   metres, seconds, y up, as in the file. Cameras and lights get a node of their own that turns -z to +z.
/// Errors:  as `import_scene`; and Error{kUnsupported} for a required extension that is not supported.
/// Threads: re-entrant.
Scene import_gltf(const std::filesystem::path& file, const ImportOptions& options, Warnings& warnings);

}  // namespace tempera
