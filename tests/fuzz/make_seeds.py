#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the binary and the long seeds of the fuzz targets, and the files that they refer to; hand-written ones stay.

Each seed is small and uses many features of its format at once, so that mutations of it reach much code.
"""
import base64
import json
import struct
import zlib
from pathlib import Path

HERE = Path(__file__).parent
POSITIONS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.25)]
NORMALS = [(0, 0, 1)] * 4
UVS = [(0, 0), (1, 0), (1, 1), (0, 1)]
TRIANGLES = [(0, 1, 2), (0, 2, 3)]
# Two triangles with normals, encoded with Draco 1.5 (10 bits for positions).
DRACO = ("RFJBQ08CAgEBAAAABAIBAgAAAR//ARH/AREC/wAAAAAAAQAJAwAAAgEBCQMAAQMBAQEAAwMBMAEQAwAogpgAAAAAAP8DAAAAAAAAAAAAAAAAAAAA"
         "AIA/CgADAQEBgAEBOP/3AQgDAJiE/wAAAH8AAAAI")


def write(path, data):
    path = HERE / path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.encode() if isinstance(data, str) else data)


def flat(rows):
    return [x for row in rows for x in row]


def png(width=4, height=4):
    """A small RGBA picture."""
    rows = b"".join(b"\0" + bytes((16 * x * y + 40 * c) % 256 for x in range(width) for c in range(4)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def obj():
    lines = ["# a quad and a triangle", "mtllib none.mtl", "o quad"]
    lines += ["v %g %g %g" % p for p in POSITIONS] + ["vt %g %g" % t for t in UVS] + ["vn 0 0 1", "usemtl a", "s off"]
    lines += ["f 1/1/1 2/2/1 3/3/1 4/4/1", "g loose", "v 2 0 0 1.0 0.5 0.25 0.125", "f -1 1 2", "f 1//1 2//1 3//1", "l 1 2", ""]
    return "\n".join(lines)


def ply(kind):
    order = ">" if "big" in kind else "<"
    header = ["ply", f"format {kind} 1.0", "comment made by hand", "element vertex 4"]
    header += [f"property float {n}" for n in ("x", "y", "z", "nx", "ny", "nz", "u", "v")]
    header += [f"property uchar {n}" for n in ("red", "green", "blue", "alpha")]
    header += ["element face 2", "property list uchar int vertex_index", "property double quality", "element edge 1",
               "property short a", "property list ushort uint b", "end_header", ""]
    out = "\n".join(header).encode()
    vertices = [(*p, *n, *t, 10, 200, 30, 255) for p, n, t in zip(POSITIONS, NORMALS, UVS)]
    faces = [(0, 1, 2, 3), (2, 1, 0)]
    if kind == "ascii":
        out += "".join(" ".join("%g" % x for x in v) + "\n" for v in vertices).encode()
        out += "".join(f"{len(f)} {' '.join(map(str, f))} 0.5\n" for f in faces).encode() + b"7 2 8 9\n"
    else:
        out += b"".join(struct.pack(order + "8f4B", *v) for v in vertices)
        out += b"".join(struct.pack(f"{order}B{len(f)}id", len(f), *f, 0.5) for f in faces)
        out += struct.pack(order + "hH2I", 7, 2, 8, 9)
    return out


def serialized(version, double):
    out, offsets = b"", []
    for normals in (True, False):
        offsets.append(len(out))
        real = "d" if double else "f"
        flags = (0x2000 if double else 0x1000) | 0x0002 | 0x0008 | (0x0001 if normals else 0x0010)
        body = struct.pack("<I", flags) + (b"mesh\0" if version == 4 else b"") + struct.pack("<QQ", 4, 2)
        for rows in [POSITIONS] + ([NORMALS] if normals else []) + [UVS] + [[(0.5, 0.25, 1)] * 4]:
            values = flat(rows)
            body += struct.pack(f"<{len(values)}{real}", *values)
        body += struct.pack("<6I", *flat(TRIANGLES))
        out += struct.pack("<HH", 0x041C, version) + zlib.compress(body)
    return out + struct.pack("<2Q" if version == 4 else "<2I", *offsets) + struct.pack("<I", 2)


class Gltf:
    """A document whose buffer grows with each accessor."""

    def __init__(self):
        self.bin = b""
        self.json = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}

    def view(self, data, **more):
        self.bin += b"\0" * (-len(self.bin) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.bin), "byteLength": len(data), **more})
        self.bin += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values, kind, component=5126, **more):
        code = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}[component]
        values = flat(values) if values and isinstance(values[0], tuple) else values
        size = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[kind]
        if kind == "VEC3" and component == 5126:
            more = {"min": [min(values[i::3]) for i in range(3)], "max": [max(values[i::3]) for i in range(3)], **more}
        self.json["accessors"].append({"bufferView": self.view(struct.pack(f"<{len(values)}{code}", *values)),
                                       "componentType": component, "count": len(values) // size, "type": kind, **more})
        return len(self.json["accessors"]) - 1

    def text(self, uri=True):
        document = dict(self.json)
        if self.bin:
            document["buffers"] = [{"byteLength": len(self.bin)}]
            if uri:
                document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.bin).decode()
        return json.dumps(document, separators=(",", ":"))

    def glb(self):
        text = self.text(uri=False).encode()
        text += b" " * (-len(text) % 4)
        data = self.bin + b"\0" * (-len(self.bin) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def animated_gltf():
    """Skin, morph targets, every interpolation, sparse accessor, cameras, lights, instancing, visibility."""
    g = Gltf()
    j = g.json
    attributes = {"POSITION": g.accessor(POSITIONS, "VEC3"), "NORMAL": g.accessor(NORMALS, "VEC3"),
                  "TANGENT": g.accessor([(1, 0, 0, 1)] * 4, "VEC4"), "TEXCOORD_0": g.accessor(UVS, "VEC2"),
                  "TEXCOORD_1": g.accessor([0, 0, 255, 0, 255, 255, 0, 255], "VEC2", 5121, normalized=True),
                  "COLOR_0": g.accessor([(65535, 0, 30000, 65535)] * 4, "VEC4", 5123, normalized=True),
                  "JOINTS_0": g.accessor([(0, 1, 0, 0)] * 4, "VEC4", 5121),
                  "WEIGHTS_0": g.accessor([(0.75, 0.25, 0, 0)] * 4, "VEC4")}
    target = {"POSITION": g.accessor([(0, 0, 0)] * 4, "VEC3", sparse={
        "count": 1, "indices": {"bufferView": g.view(struct.pack("<H", 2)), "componentType": 5123},
        "values": {"bufferView": g.view(struct.pack("<3f", 0, 0, 1))}})}
    indices = g.accessor(flat(TRIANGLES), "SCALAR", 5123)
    j["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices, "targets": [target], "material": 0},
                                   {"attributes": {"POSITION": attributes["POSITION"]}, "mode": 5}], "weights": [0.25]}]
    j["materials"] = [{"name": "m"}]
    unit = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    j["skins"] = [{"joints": [1, 2], "inverseBindMatrices": g.accessor(unit * 2, "MAT4"), "skeleton": 1}]
    j["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1, "zfar": 100, "aspectRatio": 1.5}},
                    {"type": "orthographic", "orthographic": {"xmag": 2, "ymag": 1, "znear": 0, "zfar": 10}}]
    j["extensions"] = {"KHR_lights_punctual": {"lights": [
        {"type": "spot", "intensity": 10, "color": [1, 0.5, 0.25], "range": 5, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
        {"type": "directional", "intensity": 2}, {"type": "point"}]}}
    instancing = {"TRANSLATION": g.accessor([(0, 0, 0), (2, 0, 0)], "VEC3"), "ROTATION": g.accessor([(0, 0, 0, 127)] * 2, "VEC4", 5120, normalized=True),
                  "SCALE": g.accessor([(1, 1, 1), (1, 2, 1)], "VEC3")}
    j["nodes"] = [{"mesh": 0, "skin": 0, "children": [1]}, {"translation": [0, 0.5, 0], "children": [2]}, {"rotation": [0, 0, 0.6, 0.8]},
                  {"camera": 0, "translation": [0, 0, 5], "scale": [1, 2, 1]},
                  {"camera": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 4, 1]},
                  {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 3, 0]},
                  {"mesh": 0, "weights": [1], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": instancing},
                                                             "KHR_node_visibility": {"visible": True}}}]
    j["scenes"] = [{"nodes": [0, 3, 4, 5, 6]}]
    j["scene"] = 0
    times = g.accessor([0, 0.5, 1], "SCALAR", min=[0], max=[1])
    quat = [(0, 0, 0, 1), (0, 0, 0.6, 0.8), (0, 1, 0, 0)]
    samplers = [{"input": times, "output": g.accessor([(0, 0, 0), (1, 0, 0), (0, 1, 0)], "VEC3")},
                {"input": times, "output": g.accessor(quat, "VEC4"), "interpolation": "LINEAR"},
                {"input": times, "output": g.accessor([(1, 1, 1)] * 9, "VEC3"), "interpolation": "CUBICSPLINE"},
                {"input": times, "output": g.accessor([0, 1, 0.5], "SCALAR"), "interpolation": "STEP"},
                {"input": times, "output": g.accessor([0.5, 0.7, 0.9], "SCALAR")},
                {"input": times, "output": g.accessor([(1, 1, 1, 1)] * 3, "VEC4")}]
    channels = [{"sampler": 0, "target": {"node": 1, "path": "translation"}}, {"sampler": 1, "target": {"node": 2, "path": "rotation"}},
                {"sampler": 2, "target": {"node": 6, "path": "scale"}}, {"sampler": 3, "target": {"node": 0, "path": "weights"}}]
    for sampler, pointer in [(4, "/cameras/0/perspective/yfov"), (5, "/materials/0/pbrMetallicRoughness/baseColorFactor"),
                             (4, "/extensions/KHR_lights_punctual/lights/0/intensity"), (3, "/nodes/6/extensions/KHR_node_visibility/visible")]:
        channels.append({"sampler": sampler, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}})
    j["animations"] = [{"name": "all", "samplers": samplers, "channels": channels}]
    j["extensionsUsed"] = ["KHR_lights_punctual", "EXT_mesh_gpu_instancing", "KHR_animation_pointer", "KHR_node_visibility"]
    return g


def material_gltf():
    """Textures and every material extension."""
    g = Gltf()
    j = g.json
    attributes = {"POSITION": g.accessor(POSITIONS, "VEC3"), "TEXCOORD_0": g.accessor(UVS, "VEC2")}
    j["images"] = [{"bufferView": g.view(png()), "mimeType": "image/png"}, {"uri": "texture.png"},
                   {"uri": "data:image/png;base64," + base64.b64encode(png(2, 2)).decode()}]
    j["samplers"] = [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9987}]
    j["textures"] = [{"source": 0, "sampler": 0}, {"source": 1}, {"source": 2}]
    moved = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0], "rotation": 1, "scale": [2, 0.5]}}}
    t = {"index": 1}
    j["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": moved, "baseColorFactor": [1, 0.5, 0.25, 0.75], "metallicRoughnessTexture": t,
                                  "metallicFactor": 0.5, "roughnessFactor": 0.25},
         "normalTexture": {"index": 2, "scale": 0.5}, "occlusionTexture": {"index": 2, "strength": 0.5}, "emissiveTexture": t,
         "emissiveFactor": [1, 1, 0.5], "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True,
         "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": t},
                        "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 2, "attenuationColor": [0.5, 1, 1]},
                        "KHR_materials_ior": {"ior": 1.4}, "KHR_materials_emissive_strength": {"emissiveStrength": 5},
                        "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 0.5], "specularTexture": t},
                        "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.25, "clearcoatNormalTexture": t},
                        "KHR_materials_sheen": {"sheenColorFactor": [1, 0.5, 0], "sheenRoughnessFactor": 0.5},
                        "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": 1}}},
        {"extensions": {"KHR_materials_unlit": {}}, "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5]}}]
    fan = g.accessor([0, 1, 2, 3], "SCALAR", 5121)
    j["meshes"] = [{"primitives": [{"attributes": attributes, "material": 0, "mode": 6, "indices": fan,
                                    "extensions": {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}}},
                                   {"attributes": attributes, "material": 1, "indices": fan, "mode": 5}]}]
    j["nodes"] = [{"mesh": 0}]
    j["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "other"}]}}
    j["extensionsUsed"] = sorted({"KHR_materials_variants", "KHR_materials_unlit", "KHR_texture_transform"} | set(j["materials"][0]["extensions"]))
    return g


def draco_gltf():
    g = Gltf()
    g.json["accessors"] = [{"componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                           {"componentType": 5126, "count": 4, "type": "VEC3"}, {"componentType": 5123, "count": 6, "type": "SCALAR"}]
    view = g.view(base64.b64decode(DRACO))
    g.json["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "extensions": {
        "KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0, "NORMAL": 1}}}}]}]
    g.json["nodes"] = [{"mesh": 0}]
    g.json["scenes"] = [{"nodes": [0]}]
    g.json["extensionsUsed"] = g.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return g


def jumping_gltf():
    """Steps of everything that can step, two keys at one time, disorder, scales of 0 still and moving, camera cuts."""
    g = Gltf()
    j = g.json
    positions = g.accessor(POSITIONS, "VEC3")
    indices = g.accessor(flat(TRIANGLES), "SCALAR", 5123)
    target = {"POSITION": g.accessor([(0, 0, 1)] * 4, "VEC3")}
    skinned = {"POSITION": positions, "JOINTS_0": g.accessor([(0, 1, 0, 0)] * 4, "VEC4", 5121),
               "WEIGHTS_0": g.accessor([(0.75, 0.25, 0, 0)] * 4, "VEC4")}
    j["materials"] = [{"emissiveFactor": [1, 1, 1],
                       "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2}}}]
    j["meshes"] = [{"primitives": [{"attributes": {"POSITION": positions}, "indices": indices, "targets": [target] * 2,
                                    "material": 0}]},
                   {"primitives": [{"attributes": skinned, "indices": indices}]},
                   {"primitives": [{"attributes": {"POSITION": positions}, "indices": indices}]}]
    unit = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    j["skins"] = [{"joints": [2, 3], "inverseBindMatrices": g.accessor(unit * 2, "MAT4")}]
    j["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]
    j["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {}}, {"type": "point"}]}}
    light = {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 0, 3]}
    instancing = {"TRANSLATION": g.accessor([(0, 0, 0), (2, 0, 0)], "VEC3"), "SCALE": g.accessor([(0, 0, 0), (1, 0, 1)], "VEC3")}
    squashed = [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]
    j["nodes"] = [{"mesh": 0, "weights": [0, 0]}, {"mesh": 1, "skin": 0}, {"children": [3]}, {"translation": [0, 1, 0]},
                  {"mesh": 2, "rotation": [0, 0, 0.6, 0.8], "scale": [1, 1, 0]}, {"mesh": 2, "matrix": squashed},
                  {"scale": [1, 0.25, 1], "children": [7]}, {"mesh": 2}, {"camera": 0, "translation": [0, 0, 5]},
                  light, {"scale": [0, 0, 0], "children": [11, 12]}, {"camera": 0}, {"mesh": 2},
                  {"mesh": 2, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": instancing}}}]
    j["scenes"] = [{"nodes": [0, 1, 2, 4, 5, 6, 8, 9, 10, 13]}]
    frames = g.accessor([f / 24 for f in (0, 1, 2)], "SCALAR", min=[0], max=[2 / 24])
    twice = g.accessor([0, 1 / 24, 1 / 24, 2 / 24], "SCALAR", min=[0], max=[2 / 24])
    disorder = g.accessor([-0.5, 2 / 24, 1 / 24, 1 / 24, 1 / 24], "SCALAR", min=[-0.5], max=[2 / 24])
    quat = [(0, 0, 0, 1), (0, 0, 0.6, 0.8), (0, 0, 1, 0), (0, 0, 0, 1)]
    samplers, channels = [], []

    def drive(times, values, kind, target, interpolation="STEP"):
        samplers.append({"input": times, "output": g.accessor(values, kind), "interpolation": interpolation})
        if isinstance(target, str):
            target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": target}}}
        channels.append({"sampler": len(samplers) - 1, "target": target})

    drive(frames, [(0, 0, 0), (3, 0, 0), (0, 2, 0)], "VEC3", {"node": 0, "path": "translation"})
    drive(frames, [(1, 1, 1), (0, 0, 0), (1, 1, -1)], "VEC3", {"node": 0, "path": "scale"}, "LINEAR")
    drive(frames, [0, 1, 1, 0, 0.5, 0.5], "SCALAR", {"node": 0, "path": "weights"})
    drive(twice, quat, "VEC4", {"node": 3, "path": "rotation"}, "LINEAR")
    drive(disorder, [(x, 0, 0) for x in range(5)], "VEC3", {"node": 2, "path": "translation"}, "LINEAR")
    drive(frames, quat[:3], "VEC4", {"node": 7, "path": "rotation"}, "LINEAR")
    drive(frames, [(0, 0, 0)] * 3 + [(0, 1, 0)] * 3 + [(0, 0, 0)] * 3, "VEC3", {"node": 7, "path": "scale"}, "CUBICSPLINE")
    drive(frames, [(0, 0, 5), (4, 0, 5), (0, 0, 5)], "VEC3", {"node": 8, "path": "translation"})
    drive(twice, [(1, 1, 1), (0, 0, 0), (1, 0, 1), (1, 1, 1)], "VEC3", {"node": 8, "path": "scale"}, "LINEAR")
    drive(frames, [(0, 0, 0), (1, 1, 1), (0, 0, 0)], "VEC3", {"node": 9, "path": "scale"})
    drive(frames, [(0, 0, 0), (1, 1, 1), (0, 0, 0)], "VEC3", {"node": 10, "path": "scale"}, "LINEAR")
    drive(frames, [1, 0, 1], "SCALAR", "/nodes/4/extensions/KHR_node_visibility/visible")
    drive(twice, [0.5, 0.5, 1, 1], "SCALAR", "/cameras/0/perspective/yfov", "LINEAR")
    drive(twice, [0, 0, 9, 9], "SCALAR", "/extensions/KHR_lights_punctual/lights/0/intensity", "LINEAR")
    drive(frames, [(1, 1, 1), (0, 0, 0), (1, 0, 0)], "VEC3", "/materials/0/emissiveFactor")
    drive(twice, [1, 2, 0, 1], "SCALAR", "/materials/0/extensions/KHR_materials_emissive_strength/emissiveStrength", "LINEAR")
    j["animations"] = [{"name": "jumps", "samplers": samplers, "channels": channels}]
    j["extensionsUsed"] = ["KHR_lights_punctual", "EXT_mesh_gpu_instancing", "KHR_animation_pointer", "KHR_node_visibility",
                           "KHR_materials_emissive_strength"]
    return g


def singular_mitsuba():
    """Shapes of every kind that are flat, a line or a point, still, moving and as instances; keys in disorder."""
    shapes = []
    for number, kind in enumerate(("sphere", "disk", "cylinder", "rectangle", "cube", "obj")):
        inside = '<string name="filename" value="mesh.obj"/>' if kind == "obj" else ""
        flat_map = '<transform name="to_world"><scale z="0"/><rotate x="1" y="1" angle="33"/></transform>'
        keys = "".join(f'<transform time="{t}">{m}</transform>' for t, m in [
            (0, '<rotate z="1" angle="40"/>'), (0.04, '<scale value="0"/><translate x="3"/>'), (0.04, '<scale z="0"/>'),
            (0.08, '<scale x="0" y="0"/>'), (0.02, "")])
        shapes += [f'<shape type="{kind}">{inside}{flat_map}<emitter type="area"/></shape>',
                   f'<shape type="{kind}">{inside}<animation name="to_world">{keys}</animation></shape>',
                   f'<shape type="shapegroup" id="g{number}"><shape type="{kind}">{inside}</shape></shape>',
                   f'<shape type="instance"><ref id="g{number}"/>{flat_map}</shape>']
    sensor = ('<sensor type="perspective"><animation name="to_world"><transform time="0"><translate z="-5"/></transform>'
              '<transform time="0.04"><scale z="0"/><translate z="-4"/></transform></animation></sensor>')
    return "\n".join(['<scene version="3.0.0">', sensor, *shapes, "</scene>", ""])


def polygon_obj():
    """Concave, crossed and spiked polygons, continuation lines."""
    outlines = [[(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], [(-1, -1), (1, -1), (-1, 1), (1, 1)],
                [(0, 0), (2, 0), (2, 2), (1, 2), (1, 3), (1, 2), (0, 2)],
                [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]]
    lines = []
    for outline in outlines:
        lines += ["v %g %g \\\n%g" % (*p, 0.1 * p[0]) for p in outline]
        lines.append("f " + " \\\n".join(str(i - len(outline)) for i in range(len(outline))))
    return "\ufeff" + "\n".join(lines) + "\n"


def main():
    write("files/texture.png", png())
    write("files/mesh.obj", obj())
    write("files/mesh.ply", ply("binary_little_endian"))
    write("files/mesh.serialized", serialized(4, False))
    write("files/scene.gltf", animated_gltf().text())
    write("seeds/obj/quad.obj", obj())
    write("seeds/obj/polygons.obj", polygon_obj())
    write("seeds/mitsuba/singular.xml", singular_mitsuba())
    for kind in ("ascii", "binary_little_endian", "binary_big_endian"):
        write(f"seeds/ply/{kind}.ply", ply(kind))
    for version in (3, 4):
        for double in (False, True):
            write(f"seeds/serialized/v{version}_{'double' if double else 'single'}.serialized", serialized(version, double))
    for name, document in [("animated", animated_gltf()), ("material", material_gltf()), ("draco", draco_gltf()),
                           ("jumps", jumping_gltf())]:
        write(f"seeds/gltf/{name}.gltf", document.text())
        write(f"seeds/glb/{name}.glb", document.glb())


if __name__ == "__main__":
    main()
