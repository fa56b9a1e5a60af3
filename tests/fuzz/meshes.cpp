// SPDX-License-Identifier: Apache-2.0
#include <string>

#include "entries.h"
#include "tempera/import/mesh_files.h"
#include "tempera/shading/material.h"

namespace tempera::fuzz {
namespace {

/// What the importer of a scene does with a mesh, and then the rest of the program.
void use(Mesh mesh, std::string_view input) {
  Mesh creased = mesh;
  fill_normals(mesh);
  align_winding(mesh);
  crease_normals(creased, 0.5f);
  Scene scene;
  for (Mesh* m : {&mesh, &creased}) {
    scene.groups.push_back({int(scene.shapes.size())});
    scene.instances.push_back({.group = int(scene.shapes.size())});
    scene.shapes.push_back({std::move(*m), make_diffuse(), AreaEmission{}, "mesh", ""});
  }
  scene.cameras.emplace_back();
  validate(scene);
  exercise(scene, input);
}

}  // namespace

void obj(std::string_view input) {
  expect_bad_input_only([&] {
    Warnings warnings;
    use(read_obj(input, "input.obj", warnings), input);
  });
}

void ply(std::string_view input) {
  expect_bad_input_only([&] {
    Warnings warnings;
    use(read_ply(input, "input.ply", warnings), input);
  });
}

void serialized(std::string_view input) {
  for (const int index : {0, 1, 1000}) {
    expect_bad_input_only([&] { use(read_serialized(input, "input.serialized", index, kMemoryLimit), input); });
  }
}

}  // namespace tempera::fuzz
