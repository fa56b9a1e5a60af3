// SPDX-License-Identifier: Apache-2.0
#pragma once
// What shot.toml's [materials.<name>] tables replace a scene's materials with: any type of material_catalog().
#include <filesystem>
#include <functional>
#include <map>
#include <span>
#include <string>

#include "tempera/core/params.h"
#include "tempera/scene/scene.h"
#include "tempera/shading/material_catalog.h"

namespace tempera {

/// Where a texture file that is called `name` at `loc` lies.
using FileResolver = std::function<std::filesystem::path(const std::string& name, const SourceLoc& loc)>;

/// Parameters that every type has besides its own: opacity, two_sided, emission.
std::span<const ParamSpec> common_material_params();

/// Replaces the material of all shapes whose material is called `name`. `values` are the parameters, `locs` where each
/// stands. Without a `type` they may only be common ones, and change the scene's own material.
/// Errors: Error{kUnknownName} for a material that the scene lacks, a type or a parameter; those of make.
void override_material(Scene& scene, const std::string& name, const std::map<std::string, ParamValue>& values,
                       const std::map<std::string, SourceLoc>& locs, const FileResolver& files);

}  // namespace tempera
