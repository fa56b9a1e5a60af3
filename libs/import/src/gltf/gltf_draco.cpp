// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>

#include "gltf_mesh.h"

#ifdef TEMPERA_HAS_DRACO
#include <draco/compression/decode.h>
#endif

namespace tempera {

#ifdef TEMPERA_HAS_DRACO

DracoPrimitive decode_draco(const GltfDocument& document, const Json& extension) {
  const Json view = extension["bufferView"].required(), names = extension["attributes"].required().object();
  const std::string_view bytes = document.view_bytes(view.index(document.count("bufferViews"), "bufferViews"));
  draco::DecoderBuffer buffer;
  buffer.Init(bytes.data(), bytes.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
  if (!decoded.ok()) view.fail(fmt::format("Draco cannot decode the mesh: {}", decoded.status().error_msg_string()));
  const draco::Mesh& mesh = *decoded.value();

  DracoPrimitive out;
  out.vertices = mesh.num_points();
  document.files().charge(
      out.vertices * sizeof(Vec3f) * std::min<std::size_t>(names.size(), 8) + mesh.num_faces() * 12ull,
      extension.loc());
  out.indices.reserve(std::size_t(mesh.num_faces()) * 3);
  for (draco::FaceIndex f(0); f < mesh.num_faces(); ++f) {
    for (const auto& p : mesh.face(f)) {
      if (p.value() >= out.vertices)
        view.fail(fmt::format("a triangle refers to vertex {} of {}", p.value(), out.vertices));
      out.indices.push_back(p.value());
    }
  }
  for (std::size_t i = 0; i < names.size(); ++i) {
    const Json id = names.at(i);
    const draco::PointAttribute* attribute =
        mesh.GetAttributeByUniqueId(std::uint32_t(std::min<std::uint64_t>(id.integer(0), 0xffffffff)));
    if (!attribute) id.fail(fmt::format("the compressed mesh has no attribute {}", id.integer(0)));
    DracoPrimitive::Attribute a{std::string(id.key()), attribute->num_components(), {}};
    if (a.components < 1 || a.components > 4)
      id.fail(fmt::format("a compressed attribute with {} components", a.components));
    a.values.resize(out.vertices * a.components);
    for (draco::PointIndex p(0); p < mesh.num_points(); ++p) {
      const draco::AttributeValueIndex v = attribute->mapped_index(p);
      if (v.value() >= attribute->size() ||
          !attribute->ConvertValue<float>(v, std::int8_t(a.components),
                                          &a.values[std::size_t(p.value()) * a.components]))
        id.fail(fmt::format("vertex {} of the compressed mesh has no {}", p.value(), id.key()));
    }
    out.attributes.push_back(std::move(a));
  }
  return out;
}

#else

DracoPrimitive decode_draco(const GltfDocument&, const Json& extension) {
  extension.fail(ErrorCode::kUnsupported, "is compressed with Draco, for which this program was built without support");
}

#endif

}  // namespace tempera
