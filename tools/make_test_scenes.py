#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the glTF scenes of scenes/tests (their Mitsuba XML scenes are written by hand).

Each is one .gltf file with embedded buffers, small enough to read, and has motion whose closed form `asset.extras` states:

  card_translate   a textured card that translates at constant velocity in front of a fixed camera
  card_rotate      the same card turning about its normal at constant angular velocity
  card_zoom        the card at rest, the camera's field of view animated (KHR_animation_pointer)
  skin_morph       a bar of two joints that bends (skin) and bulges (morph target), in a set with floor and light

Needs only Python's standard library, and gives the same bytes on every run.
"""
import base64
import json
import math
import struct
import zlib
from pathlib import Path

OUT = Path(__file__).resolve().parent.parent / "scenes" / "tests"

FLOAT, USHORT, UBYTE = 5126, 5123, 5121
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
CODE = {FLOAT: "f", USHORT: "H", UBYTE: "B"}


def png(width, height, pixel):
    """An RGB PNG whose pixel (x, y) is pixel(x, y), a tuple of three bytes."""
    rows = b"".join(b"\0" + bytes(c for x in range(width) for c in pixel(x, y)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def checker(width, height, cell, a, b):
    return png(width, height, lambda x, y: a if (x // cell + y // cell) % 2 == 0 else b)


class Gltf:
    """A glTF document with one embedded buffer."""

    def __init__(self, extras):
        self.data = bytearray()
        self.doc = {"asset": {"version": "2.0", "generator": "tools/make_test_scenes.py",
                              "copyright": "Tempera authors, Apache-2.0", "extras": extras},
                    "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "materials": [],
                    "accessors": [], "bufferViews": []}

    def add(self, kind, item):
        self.doc.setdefault(kind, []).append(item)
        return len(self.doc[kind]) - 1

    def view(self, raw):
        self.data += b"\0" * (-len(self.data) % 4)
        view = self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw
        return view

    def accessor(self, rows, kind, component=FLOAT, bounds=False):
        flat = [x for row in rows for x in (row if WIDTH[kind] > 1 else [row])]
        item = {"bufferView": self.view(struct.pack(f"<{len(flat)}{CODE[component]}", *flat)),
                "componentType": component, "count": len(rows), "type": kind}
        if bounds:
            columns = list(zip(*[r if WIDTH[kind] > 1 else [r] for r in rows]))
            item["min"], item["max"] = [[f32(limit(c)) for c in columns] for limit in (min, max)]
        return self.add("accessors", item)

    def texture(self, image):
        source = self.add("images", {"bufferView": self.view(image), "mimeType": "image/png"})
        sampler = self.add("samplers", {"magFilter": 9728, "minFilter": 9728})
        return self.add("textures", {"source": source, "sampler": sampler})

    def node(self, root=True, **node):
        index = self.add("nodes", node)
        if root:
            self.doc["scenes"][0]["nodes"].append(index)
        return index

    def channel(self, animation, target, times, values, kind, interpolation="LINEAR"):
        sampler = {"input": self.accessor(times, "SCALAR", bounds=True), "output": self.accessor(values, kind),
                   "interpolation": interpolation}
        animation["samplers"].append(sampler)
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    def write(self, name):
        uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(self.data)).decode()
        self.doc["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        text = json.dumps({k: v for k, v in self.doc.items() if v != []}, indent=1)
        (OUT / f"{name}.gltf").write_text(text + "\n", encoding="utf-8")


def f32(x):
    """The nearest single-precision number, as bounds have to be those of the stored values."""
    return struct.unpack("<f", struct.pack("<f", x))[0]


def quaternion(axis, degrees):
    s = math.sin(math.radians(degrees) / 2)
    return [a * s for a in axis] + [math.cos(math.radians(degrees) / 2)]


def grid(columns, rows, point):
    """Vertices and triangles of a grid; point(u, v) with u, v in [0,1] gives position."""
    vertices = [point(i / columns, j / rows) for j in range(rows + 1) for i in range(columns + 1)]
    at = lambda i, j: j * (columns + 1) + i
    triangles = []
    for j in range(rows):
        for i in range(columns):
            triangles += [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)]
    return vertices, triangles


def card(extras, half=0.8):
    """A card of side 2 * half in the plane z = 0, faced by a camera at z = 5 with a field of view of 40 degrees."""
    g = Gltf({"card": f"square |x|,|y| <= {half} in the plane z = 0, emits its texture",
              "camera": "at (0,0,5), looks along -z, yfov 40 degrees, aspect ratio 1", **extras})
    texture = g.texture(checker(16, 16, 2, (230, 120, 40), (40, 90, 160)))
    # Black but for its emission: a pixel's value is the texture, whatever the lights.
    material = g.add("materials", {"name": "card", "doubleSided": True, "emissiveFactor": [1, 1, 1],
                                   "emissiveTexture": {"index": texture},
                                   "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0,
                                                            "roughnessFactor": 1}})
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    mesh = g.add("meshes", {"name": "card", "primitives": [{
        "material": material, "indices": g.accessor([0, 1, 2, 0, 2, 3], "SCALAR", USHORT),
        "attributes": {"POSITION": g.accessor(corners, "VEC3", bounds=True),
                       "NORMAL": g.accessor([(0, 0, 1)] * 4, "VEC3"),
                       "TEXCOORD_0": g.accessor([(0, 1), (1, 1), (1, 0), (0, 0)], "VEC2")}}]})
    node = g.node(name="card", mesh=mesh)
    camera = g.add("cameras", {"name": "camera", "type": "perspective", "perspective": {
        "yfov": math.radians(40), "aspectRatio": 1, "znear": 0.1, "zfar": 100}})
    g.node(name="camera", camera=camera, translation=[0, 0, 5])
    return g, node


def card_translate():
    velocity = (0.5, 0.25, 0.0)
    g, node = card({"motion": "card position = (0.5, 0.25, 0) * t for 0 <= t <= 2 s"})
    animation = {"name": "translate", "channels": [], "samplers": []}
    g.channel(animation, {"node": node, "path": "translation"}, [0.0, 2.0], [(0, 0, 0), [2 * v for v in velocity]],
              "VEC3")
    g.add("animations", animation)
    g.write("card_translate")


def card_rotate():
    g, node = card({"motion": "card turned by 90 degrees * t about +z (counter-clockwise on screen) for 0 <= t <= 2 s"})
    animation = {"name": "rotate", "channels": [], "samplers": []}
    keys = [0.0, 0.5, 1.0, 1.5, 2.0]
    g.channel(animation, {"node": node, "path": "rotation"}, keys, [quaternion((0, 0, 1), 90 * t) for t in keys],
              "VEC4")
    g.add("animations", animation)
    g.write("card_rotate")


def card_zoom():
    g, _ = card({"motion": "yfov = 40 degrees - 10 degrees * t for 0 <= t <= 2 s, all else at rest"})
    animation = {"name": "zoom", "channels": [], "samplers": []}
    g.channel(animation, {"path": "pointer", "extensions": {"KHR_animation_pointer": {
        "pointer": "/cameras/0/perspective/yfov"}}}, [0.0, 2.0], [math.radians(40), math.radians(20)], "SCALAR")
    g.add("animations", animation)
    g.doc["extensionsUsed"] = ["KHR_animation_pointer"]
    g.write("card_zoom")


def skin_morph():
    g = Gltf({"motion": "joint 1 turns by 60 degrees * sin(pi t) about z, joint 0 moves along x, the bulge's weight is "
                        "0.5 - 0.5 cos(2 pi t); keys at every 1/24 s up to 1 s",
              "camera": "at (0, 1.2, 6), looks along -z, yfov 35 degrees"})
    texture = g.texture(checker(32, 32, 4, (235, 225, 200), (50, 110, 110)))
    bar_material = g.add("materials", {"name": "bar", "pbrMetallicRoughness": {
        "baseColorTexture": {"index": texture}, "metallicFactor": 0, "roughnessFactor": 0.5}})
    floor_material = g.add("materials", {"name": "floor", "pbrMetallicRoughness": {
        "baseColorFactor": [0.6, 0.6, 0.6, 1], "metallicFactor": 0, "roughnessFactor": 1}})
    light_material = g.add("materials", {"name": "light", "emissiveFactor": [1, 1, 1],
                                         "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 12}},
                                         "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0,
                                                                  "roughnessFactor": 1}})
    columns, rows, radius, height = 16, 12, 0.3, 2.0

    def tube(u, v):
        return (radius * math.cos(2 * math.pi * u), height * v, -radius * math.sin(2 * math.pi * u))

    positions, triangles = grid(columns, rows, tube)
    normals = [(x / radius, 0.0, z / radius) for x, _, z in positions]
    uvs = [(i / columns * 2, j / rows * 2) for j in range(rows + 1) for i in range(columns + 1)]
    bulge = [math.sin(math.pi * y / height) * 0.6 for _, y, _ in positions]
    targets = [(x * b, 0.0, z * b) for (x, _, z), b in zip(positions, bulge)]
    smooth = [min(max((y / height - 0.25) / 0.5, 0), 1) for _, y, _ in positions]
    weights = [(1 - (w := s * s * (3 - 2 * s)), w, 0.0, 0.0) for s in smooth]
    bar = g.add("meshes", {"name": "bar", "weights": [0.0], "primitives": [{
        "material": bar_material, "indices": g.accessor(triangles, "SCALAR", USHORT),
        "attributes": {"POSITION": g.accessor(positions, "VEC3", bounds=True), "NORMAL": g.accessor(normals, "VEC3"),
                       "TEXCOORD_0": g.accessor(uvs, "VEC2"),
                       "JOINTS_0": g.accessor([(0, 1, 0, 0)] * len(positions), "VEC4", UBYTE),
                       "WEIGHTS_0": g.accessor(weights, "VEC4")},
        "targets": [{"POSITION": g.accessor(targets, "VEC3", bounds=True)}]}]})

    def quad(name, material, corners, normal):
        return g.add("meshes", {"name": name, "primitives": [{
            "material": material, "indices": g.accessor([0, 1, 2, 0, 2, 3], "SCALAR", USHORT),
            "attributes": {"POSITION": g.accessor(corners, "VEC3", bounds=True),
                           "NORMAL": g.accessor([normal] * 4, "VEC3")}}]})

    floor = quad("floor", floor_material, [(-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4)], (0, 1, 0))
    light = quad("light", light_material, [(-1, 0, 1), (-1, 0, -1), (1, 0, -1), (1, 0, 1)], (0, -1, 0))

    joint1 = g.node(root=False, name="joint1", translation=[0, height / 2, 0])
    joint0 = g.node(name="joint0", children=[joint1])
    identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    lowered = identity[:13] + [-height / 2] + identity[14:]
    skin = g.add("skins", {"joints": [joint0, joint1], "inverseBindMatrices": g.accessor([identity, lowered], "MAT4")})
    bar_node = g.node(name="bar", mesh=bar, skin=skin)
    g.node(name="floor", mesh=floor)
    g.node(name="light", mesh=light, translation=[-1, 4, 2])
    camera = g.add("cameras", {"name": "camera", "type": "perspective", "perspective": {
        "yfov": math.radians(35), "aspectRatio": 1, "znear": 0.1, "zfar": 100}})
    g.node(name="camera", camera=camera, translation=[0, 1.2, 6])

    times = [i / 24 for i in range(25)]
    bend = {"name": "bend", "channels": [], "samplers": []}
    g.channel(bend, {"node": joint1, "path": "rotation"}, times,
              [quaternion((0, 0, 1), 60 * math.sin(math.pi * t)) for t in times], "VEC4")
    g.channel(bend, {"node": joint0, "path": "translation"}, times,
              [(0.5 * math.sin(2 * math.pi * t), 0, 0) for t in times], "VEC3")
    g.channel(bend, {"node": bar_node, "path": "weights"}, times,
              [0.5 - 0.5 * math.cos(2 * math.pi * t) for t in times], "SCALAR")
    g.add("animations", bend)
    g.doc["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    g.write("skin_morph")


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    card_translate()
    card_rotate()
    card_zoom()
    skin_morph()
