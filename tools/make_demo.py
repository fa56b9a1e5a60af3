#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Builds the demo's scene: scenes/demo/demo.glb and scenes/demo/sky.hdr.

An automaton at dusk. A fox runs in place on a turntable that carries a small forest past it; brass gears drive the
table, and an orrery (a lantern, a glass ball and a mirror ball) turns above the trees while the camera travels around.
The shot lasts 48 frames at 24 frames a second; every node's motion is in one glTF animation, with a key each frame.

The fox is scenes/demo/source/fox.glb (see scenes/demo/LICENSES.md); everything else is made here. Needs only Python's
standard library, and gives the same bytes on every run. The outputs are committed: rendering the demo needs no Python.
"""
import json
import math
import random
import struct
import zlib
from pathlib import Path

DEMO = Path(__file__).resolve().parent.parent / "scenes" / "demo"

FPS = 24
KEYS = 54  # 48 frames, and some beyond: shutter intervals and forward motion vectors look past the last frame
FLOAT, USHORT, UBYTE = 5126, 5123, 5121
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
CODE = {FLOAT: "f", USHORT: "H", UBYTE: "B"}
TAU = 2 * math.pi

# The mechanism, in metres and degrees per second; the table turns clockwise seen from above.
TABLE_RADIUS, TRACK_RADIUS = 2.0, 1.55
TABLE_SPEED = -60.0
TABLE_TEETH, PINION_TEETH, WHEEL_TEETH = 48, 12, 24
MODULE = 0.0875  # pitch diameter per tooth
FOX_SCALE = 0.0080
FOX_CYCLE = 1.0  # seconds per gallop: with this the paws go as fast as the track


# ---------------------------------------------------------------------------------------------------- vectors

def add(a, b):
    return tuple(x + y for x, y in zip(a, b))


def sub(a, b):
    return tuple(x - y for x, y in zip(a, b))


def scale(a, s):
    return tuple(x * s for x in a)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def normalize(a):
    length = math.sqrt(dot(a, a))
    return scale(a, 1 / length) if length > 0 else (0.0, 1.0, 0.0)


def mix(a, b, t):
    return tuple(x + (y - x) * t for x, y in zip(a, b))


def smoothstep(a, b, x):
    t = min(max((x - a) / (b - a), 0.0), 1.0)
    return t * t * (3 - 2 * t)


def rotation(axis, degrees):
    """Quaternion (x, y, z, w) of a turn about a unit axis."""
    s = math.sin(math.radians(degrees) / 2)
    return (axis[0] * s, axis[1] * s, axis[2] * s, math.cos(math.radians(degrees) / 2))


def about_y(degrees):
    return rotation((0, 1, 0), degrees)


def multiply(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def look_at(eye, target):
    """Quaternion that turns a camera (looking along -z, y up) from `eye` to `target`."""
    z = normalize(sub(eye, target))
    x = normalize(cross((0, 1, 0), z))
    y = cross(z, x)
    m00, m11, m22 = x[0], y[1], z[2]
    w = math.sqrt(max(0.0, 1 + m00 + m11 + m22)) / 2
    if w > 1e-3:
        return ((y[2] - z[1]) / (4 * w), (z[0] - x[2]) / (4 * w), (x[1] - y[0]) / (4 * w), w)
    raise ValueError("the camera looks backwards: choose another base orientation")


# ---------------------------------------------------------------------------------------------------- meshes

class Mesh:
    """Triangles as position and texture coordinate per corner; `finish` gives normals and welds equal corners."""

    def __init__(self):
        self.corners = []  # (position, uv), three a triangle

    def triangle(self, a, b, c, uvs=((0, 0), (0, 0), (0, 0))):
        self.corners += [(a, uvs[0]), (b, uvs[1]), (c, uvs[2])]

    def quad(self, a, b, c, d, uvs=((0, 0), (1, 0), (1, 1), (0, 1))):
        self.triangle(a, b, c, (uvs[0], uvs[1], uvs[2]))
        self.triangle(a, c, d, (uvs[0], uvs[2], uvs[3]))

    def join(self, other, offset=(0, 0, 0), factor=1.0):
        self.corners += [(add(scale(p, factor), offset), uv) for p, uv in other.corners]
        return self

    def finish(self, crease=40.0):
        """Positions, normals, texture coordinates and indices. Faces meeting at less than `crease` degrees are smooth."""
        key = lambda p: tuple(round(x * 1e5) for x in p)
        faces, around = [], {}
        for i in range(0, len(self.corners), 3):
            (a, _), (b, _), (c, _) = self.corners[i:i + 3]
            n = cross(sub(b, a), sub(c, a))
            if dot(n, n) < 1e-18:
                continue  # at the pole of a lathe
            unit = normalize(n)
            for corner in range(3):
                p, q, r = (self.corners[i + (corner + k) % 3][0] for k in range(3))
                angle = math.acos(max(-1.0, min(1.0, dot(normalize(sub(q, p)), normalize(sub(r, p))))))
                around.setdefault(key(p), []).append((unit, angle))
            faces.append((i, unit))
        cosine = math.cos(math.radians(crease))
        index, out = {}, ([], [], [], [])
        for i, unit in faces:
            for corner in range(3):
                p, uv = self.corners[i + corner]
                n = (0.0, 0.0, 0.0)
                for other, angle in around[key(p)]:
                    if dot(other, unit) >= cosine:
                        n = add(n, scale(other, angle))
                n = normalize(n)
                k = (key(p), tuple(round(x * 1e3) for x in n), tuple(round(x * 1e5) for x in uv))
                if k not in index:
                    index[k] = len(out[0])
                    out[0].append(p)
                    out[1].append(n)
                    out[2].append(uv)
                out[3].append(index[k])
        return out


def lathe(profile, segments, uv_scale=(1.0, 1.0)):
    """Turns (radius, height) points about y, listed from the top down along the outside."""
    mesh = Mesh()
    at = lambda k, s: (profile[k][0] * math.sin(TAU * s / segments), profile[k][1],
                       profile[k][0] * math.cos(TAU * s / segments))
    lengths = [0.0]
    for (r0, y0), (r1, y1) in zip(profile, profile[1:]):
        lengths.append(lengths[-1] + math.hypot(r1 - r0, y1 - y0))
    v = [x / lengths[-1] * uv_scale[1] for x in lengths]
    for k in range(len(profile) - 1):
        for s in range(segments):
            u0, u1 = s / segments * uv_scale[0], (s + 1) / segments * uv_scale[0]
            mesh.quad(at(k, s), at(k + 1, s), at(k + 1, s + 1), at(k, s + 1),
                      ((u0, v[k]), (u0, v[k + 1]), (u1, v[k + 1]), (u1, v[k])))
    return mesh


def cylinder(radius, bottom, top, segments=24, bevel=0.012):
    return lathe([(0, top), (radius - bevel, top), (radius, top - bevel), (radius, bottom + bevel),
                  (radius - bevel, bottom), (0, bottom)], segments)


def sphere(radius, segments, rings):
    return lathe([(radius * math.sin(math.pi * k / rings), radius * math.cos(math.pi * k / rings))
                  for k in range(rings + 1)], segments)


def tube(points, radius, segments=10):
    """A round bar along a polyline, closed at its ends."""
    mesh = Mesh()
    rings = []
    for k, p in enumerate(points):
        forward = normalize(sub(points[min(k + 1, len(points) - 1)], points[max(k - 1, 0)]))
        side = normalize(cross(forward, (0, 1, 0) if abs(forward[1]) < 0.9 else (1, 0, 0)))
        up = cross(side, forward)
        rings.append([add(p, add(scale(side, radius * math.cos(TAU * s / segments)),
                                 scale(up, radius * math.sin(TAU * s / segments)))) for s in range(segments)])
    for a, b in zip(rings, rings[1:]):
        for s in range(segments):
            mesh.quad(a[s], a[(s + 1) % segments], b[(s + 1) % segments], b[s])
    for s in range(1, segments - 1):
        mesh.triangle(rings[0][0], rings[0][s + 1], rings[0][s])
        mesh.triangle(rings[-1][0], rings[-1][s], rings[-1][s + 1])
    return mesh


def box(low, high):
    mesh = Mesh()
    (x0, y0, z0), (x1, y1, z1) = low, high
    mesh.quad((x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1))
    mesh.quad((x1, y0, z0), (x0, y0, z0), (x0, y1, z0), (x1, y1, z0))
    mesh.quad((x1, y0, z1), (x1, y0, z0), (x1, y1, z0), (x1, y1, z1))
    mesh.quad((x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x0, y1, z0))
    mesh.quad((x0, y1, z1), (x1, y1, z1), (x1, y1, z0), (x0, y1, z0))
    mesh.quad((x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1))
    return mesh


def gear_outline(teeth, shrink=0.0):
    """Involute outline of a spur gear (pressure angle 20 degrees), counter-clockwise from above; a tooth is at angle 0.

    Backlash of 4 % of the pitch keeps meshing teeth apart; `shrink` moves the outline inwards, for the chamfer.
    """
    pitch = MODULE * teeth / 2
    base = pitch * math.cos(math.radians(20))
    tip, root = pitch + 0.9 * MODULE - shrink, pitch - 1.15 * MODULE - shrink
    involute = lambda r: math.sqrt(max((r / base) ** 2 - 1, 0)) - math.acos(min(base / r, 1))
    half_at_pitch = TAU / teeth * 0.24 - shrink / pitch
    half = lambda r: half_at_pitch + involute(pitch) - involute(max(r, base))
    start = max(root, base)
    radii = [root] + [start + (tip - start) * k / 3 for k in range(0 if start > root else 1, 4)]
    outline = []
    for t in range(teeth):
        middle = TAU * t / teeth
        flank = [(r, half(r)) for r in radii]
        outline += [(r, middle - h) for r, h in flank] + [(r, middle + h) for r, h in reversed(flank)]
    return outline


def gear(teeth, bottom, top, inner, chamfer=0.012):
    """A toothed ring from radius `inner` to the teeth, with chamfered edges; angles run from +z towards +x."""
    mesh = Mesh()
    outer, inset = gear_outline(teeth), gear_outline(teeth, chamfer)
    at = lambda polar, y: (polar[0] * math.sin(polar[1]), y, polar[0] * math.cos(polar[1]))
    for k in range(len(outer)):
        n = (k + 1) % len(outer)
        a, b, ia, ib = outer[k], outer[n], inset[k], inset[n]
        ha, hb = (inner, ia[1]), (inner, ib[1])
        mesh.quad(at(a, bottom + chamfer), at(b, bottom + chamfer), at(b, top - chamfer), at(a, top - chamfer))
        mesh.quad(at(a, top - chamfer), at(b, top - chamfer), at(ib, top), at(ia, top))
        mesh.quad(at(ib, bottom), at(b, bottom + chamfer), at(a, bottom + chamfer), at(ia, bottom))
        mesh.quad(at(ia, top), at(ib, top), at(hb, top), at(ha, top))
        mesh.quad(at(ib, bottom), at(ia, bottom), at(ha, bottom), at(hb, bottom))
        mesh.quad(at(hb, bottom), at(ha, bottom), at(ha, top), at(hb, top))
    return mesh


def spoked_gear(teeth, bottom, top, spokes):
    pitch = MODULE * teeth / 2
    rim = pitch - 2.2 * MODULE
    mesh = gear(teeth, bottom, top, rim)
    hub = max(0.24 * pitch, 0.1)
    mesh.join(cylinder(hub, bottom - 0.02, top + 0.05, 28, 0.015))
    low, high = bottom + 0.03, top - 0.03
    for k in range(spokes):
        a = TAU * (k + 0.5) / spokes
        x, z = (math.cos(a), -math.sin(a)), (math.sin(a), math.cos(a))
        wide, narrow, start, end = 0.30 * hub + 0.03, 0.03 + 0.02 * pitch, hub * 0.9, rim + 0.02
        at = lambda s, r, y: (x[0] * s + z[0] * r, y, x[1] * s + z[1] * r)
        c = [at(-wide, start, high), at(wide, start, high), at(narrow, end, high), at(-narrow, end, high)]
        d = [(p[0], low, p[2]) for p in c]
        mesh.quad(c[3], c[2], c[1], c[0])
        mesh.quad(d[0], d[1], d[2], d[3])
        mesh.quad(c[1], c[2], d[2], d[1])
        mesh.quad(c[3], c[0], d[0], d[3])
    return mesh


def tree(sides, rng):
    """A fir of three flat-shaded cones and its trunk, one unit high; the mesh's uv picks a color of the palette."""
    leaves, trunk = Mesh(), cylinder(0.05, 0.0, 0.25, 7, 0.005)
    for level, (bottom, top, radius) in enumerate([(0.16, 0.58, 0.30), (0.38, 0.78, 0.235), (0.60, 1.0, 0.165)]):
        ring = []
        turn = level * 0.4 + rng.random()
        for s in range(sides):
            r = radius * (1 + 0.14 * (rng.random() - 0.5))
            a = turn + TAU * s / sides
            ring.append((r * math.sin(a), bottom + 0.03 * (rng.random() - 0.5), r * math.cos(a)))
        for s in range(sides):
            p, q = ring[s], ring[(s + 1) % sides]
            leaves.triangle(p, q, (0.0, top, 0.0))
            leaves.triangle(q, p, (0.0, bottom + 0.07, 0.0))
    return leaves, trunk


def rock(rng):
    """A rough octahedron subdivided once and squashed."""
    points = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)]
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    bump = {}

    def at(p):
        p = normalize(p)
        k = tuple(round(x, 4) for x in p)
        if k not in bump:
            bump[k] = 0.82 + 0.36 * rng.random()
        return (p[0] * bump[k], p[1] * bump[k] * 0.62, p[2] * bump[k])

    mesh = Mesh()
    for a, b, c in faces:
        a, b, c = points[a], points[b], points[c]
        ab, bc, ca = add(a, b), add(b, c), add(c, a)
        for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)):
            mesh.triangle(*(at(p) for p in t))
    return mesh


# ---------------------------------------------------------------------------------------------------- pictures

class Noise:
    """Gradient noise over 3D points, about -1 to 1."""

    def __init__(self, seed):
        rng = random.Random(seed)
        self.table = list(range(256))
        rng.shuffle(self.table)
        self.table *= 2

    def __call__(self, x, y, z):
        t = self.table
        xi, yi, zi = math.floor(x), math.floor(y), math.floor(z)
        x, y, z = x - xi, y - yi, z - zi
        xi, yi, zi = xi & 255, yi & 255, zi & 255
        u, v, w = (c * c * c * (c * (c * 6 - 15) + 10) for c in (x, y, z))

        def g(i, j, k, a, b, c):
            h = t[t[t[(xi + i) & 255] + ((yi + j) & 255)] + ((zi + k) & 255)] & 15
            p = a if h < 8 else b
            q = b if h < 4 else (a if h in (12, 14) else c)
            return (p if h & 1 == 0 else -p) + (q if h & 2 == 0 else -q)

        def lerp(a, b, s):
            return a + (b - a) * s

        return lerp(lerp(lerp(g(0, 0, 0, x, y, z), g(1, 0, 0, x - 1, y, z), u),
                         lerp(g(0, 1, 0, x, y - 1, z), g(1, 1, 0, x - 1, y - 1, z), u), v),
                    lerp(lerp(g(0, 0, 1, x, y, z - 1), g(1, 0, 1, x - 1, y, z - 1), u),
                         lerp(g(0, 1, 1, x, y - 1, z - 1), g(1, 1, 1, x - 1, y - 1, z - 1), u), v), w)

    def sum(self, x, y, z, octaves):
        total, size = 0.0, 1.0
        for _ in range(octaves):
            total += size * self(x, y, z)
            x, y, z, size = x * 2.03, y * 2.03, z * 2.03, size * 0.5
        return total


def srgb_byte(x):
    x = min(max(x, 0.0), 1.0)
    x = 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055
    return int(x * 255 + 0.5)


def png(width, height, pixel, gray=False, step=3):
    """A PNG of linear values pixel(x, y) (RGB as sRGB, or gray as they are), quantized to `step` so that it packs well."""
    channels = 1 if gray else 3
    encode = (lambda v: int(min(max(v, 0), 1) * 255 + 0.5)) if gray else srgb_byte
    data = bytearray()
    previous = bytearray(width * channels)
    for y in range(height):
        row = bytearray()
        for x in range(width):
            value = pixel(x, y)
            row += bytes(min(255, encode(v) // step * step + step // 2) for v in ((value,) if gray else value))
        # Every row is written with the filter (none, left, up) whose residuals are smallest.
        left = bytes((row[i] - (row[i - channels] if i >= channels else 0)) & 255 for i in range(len(row)))
        up = bytes((row[i] - previous[i]) & 255 for i in range(len(row)))
        cost = lambda r: sum(min(b, 256 - b) for b in r)
        kind, best = min(((1, left), (2, up)), key=lambda c: cost(c[1]))
        data += bytes([kind]) + best
        previous = row

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    return (b"\x89PNG\r\n\x1a\n" +
            chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0 if gray else 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(bytes(data), 9)) + chunk(b"IEND", b""))


def rgbe(color):
    top = max(color)
    if top < 1e-9:
        return (0, 0, 0, 0)
    mantissa, exponent = math.frexp(top)
    factor = mantissa * 256 / top
    return tuple(min(255, int(c * factor)) for c in color) + (exponent + 128,)


def write_hdr(path, width, height, pixel):
    """A Radiance HDR file (run-length encoded) of pixel(x, y)."""
    out = bytearray(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {height} +X {width}\n".encode())
    for y in range(height):
        row = [rgbe(pixel(x, y)) for x in range(width)]
        out += bytes([2, 2, width >> 8, width & 255])
        for c in range(4):
            plane = [p[c] for p in row]
            i = 0
            while i < width:
                run = 1
                while i + run < width and run < 127 and plane[i + run] == plane[i]:
                    run += 1
                if run >= 4:
                    out += bytes([128 + run, plane[i]])
                    i += run
                    continue
                start = i
                while i < width and i - start < 128 and not (i + 3 < width and
                                                             plane[i] == plane[i + 1] == plane[i + 2] == plane[i + 3]):
                    i += 1
                out += bytes([i - start]) + bytes(plane[start:i])
    path.write_bytes(bytes(out))


def sky(direction, noise):
    """Radiance of a dusk sky: a warm glow low in -z, blue above, lit clouds, hills along the horizon.

    The key light of the set is in it too, a soft round lamp behind the camera: one light of the renderer to sample, not two.
    """
    x, y, z = direction
    azimuth = math.atan2(x, -z) + 0.12  # 0 at the glow
    toward = max(0.0, math.cos(azimuth * 0.5)) ** 2
    zenith, horizon = (0.075, 0.135, 0.30), mix((0.19, 0.21, 0.33), (0.80, 0.37, 0.20), toward ** 3)
    height = max(y, 0.0)
    color = mix(horizon, zenith, smoothstep(0.0, 0.62, height ** 0.75))
    glow = math.exp(-((azimuth / 0.34) ** 2 + ((y - 0.060) / 0.075) ** 2))
    color = add(color, scale((2.1, 1.02, 0.40), glow))
    lamp = smoothstep(0.965, 0.985, dot(direction, normalize((-2.7, 3.8, 4.6))))
    if y > 0:
        # Clouds lie in a plane overhead, lit from the side of the glow.
        s = 1.15 / (y + 0.16)
        density = noise.sum(x * s * 1.1, 7.3, z * s * 2.0, 5) + 0.10
        cover = smoothstep(0.0, 0.55, density) * smoothstep(0.015, 0.14, y)
        lit = mix((0.22, 0.21, 0.30), (1.15, 0.47, 0.30), toward ** 1.5)
        shade = smoothstep(0.95, 0.15, density)
        color = mix(color, mix(scale(lit, 0.45), lit, shade), 0.82 * cover)
    ridge = 0.010 + 0.016 * noise.sum(math.sin(azimuth) * 3, math.cos(azimuth) * 3, 1.7, 4)
    far = 0.034 + 0.016 * noise.sum(math.sin(azimuth) * 2, math.cos(azimuth) * 2, 9.1, 3)
    color = mix(color, mix((0.085, 0.095, 0.16), (0.30, 0.15, 0.15), toward ** 2), smoothstep(far, far - 0.012, y))
    color = mix(color, (0.035, 0.045, 0.062), smoothstep(ridge, ridge - 0.010, y))
    color = mix(color, (0.06, 0.055, 0.06), smoothstep(0.0, -0.15, y))
    return mix(color, (17.0, 14.2, 10.8), lamp)


def table_texture(size):
    """Seen from above: walnut rim, moss with specks, and the fox's sandy track with sleepers."""
    noise = Noise(11)

    def pixel(px, py):
        x, z = (px + 0.5) / size * 2 - 1, (py + 0.5) / size * 2 - 1
        r, a = math.hypot(x, z) * TABLE_RADIUS, math.atan2(x, z)
        grain = noise.sum(x * 5, 0.4, z * 5, 3)
        ring = math.sin(r * 55 + 3.0 * noise(x * 3, 2.1, z * 3) + 0.8 * math.sin(a * 2))
        wood = mix((0.115, 0.042, 0.016), (0.23, 0.098, 0.040), 0.5 + 0.38 * ring + 0.22 * grain)
        moss = mix((0.045, 0.105, 0.030), (0.125, 0.215, 0.055), 0.5 + 0.55 * grain)
        edge = 0.022 * noise.sum(x * 9, 5.5, z * 9, 2)
        track = smoothstep(0.30, 0.275, abs(r - TRACK_RADIUS) + edge)
        sand = mix((0.50, 0.355, 0.20), (0.72, 0.56, 0.36), 0.5 + 0.5 * noise.sum(x * 14, 8.8, z * 14, 2))
        # Planks across the track show how fast it goes.
        sleeper = smoothstep(0.80, 0.90, math.cos(a * 36)) * smoothstep(0.25, 0.235, abs(r - TRACK_RADIUS))
        color = mix(moss, sand, track)
        color = mix(color, scale(wood, 0.9), 0.85 * sleeper)
        return mix(color, wood, smoothstep(1.868, 1.880, r))

    return png(size, size, pixel, step=5)


def tile_value(px, py, size, noise):
    """Which of the 2 x 2 tiles, how deep in the grout, and a mottle; all periodic over the picture."""
    u, v = (px + 0.5) / size * 2, (py + 0.5) / size * 2
    cell = (int(u) + int(v)) % 2
    du, dv = abs(u % 1 - 0.5), abs(v % 1 - 0.5)
    grout = smoothstep(0.483, 0.490, max(du, dv))
    cu, cv = math.cos(math.pi * u), math.sin(math.pi * u)
    mottle = noise.sum(cu * 1.3 + 4 * cell, cv * 1.3, math.cos(math.pi * v) * 1.3 + 2 * math.sin(math.pi * v), 4)
    return cell, grout, mottle


def tile_color(size):
    noise = Noise(23)

    def pixel(px, py):
        cell, grout, mottle = tile_value(px, py, size, noise)
        dark = mix((0.016, 0.034, 0.042), (0.028, 0.056, 0.066), 0.5 + 0.6 * mottle)
        light = mix((0.070, 0.092, 0.096), (0.115, 0.140, 0.140), 0.5 + 0.6 * mottle)
        return mix(light if cell else dark, (0.030, 0.034, 0.036), grout)

    return png(size, size, pixel, step=5)


def tile_roughness(size):
    """glTF's metallic-roughness picture: roughness in green, metalness (none) in blue."""
    noise = Noise(23)

    def pixel(px, py):
        _, grout, mottle = tile_value(px, py, size, noise)
        rough = mix((0.20 + 0.10 * mottle,), (0.8,), grout)[0]
        return (0.0, rough, 0.0)

    def linear(px, py):  # png() takes linear light; these are data, so undo its transfer curve first
        return tuple(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in pixel(px, py))

    return png(size, size, linear, step=9)


def wood_texture(width, height):
    """Boards' end-to-end grain, for the base and the knobs."""
    noise = Noise(5)

    def pixel(px, py):
        u, v = px / width, py / height
        a = TAU * u
        line = math.sin(26 * v + 2.2 * noise.sum(math.cos(a) * 1.2, math.sin(a) * 1.2, v * 2.5, 3))
        fine = noise(math.cos(a) * 22, math.sin(a) * 22, v * 6)
        return mix((0.20, 0.085, 0.034), (0.42, 0.215, 0.092), 0.5 + 0.34 * line + 0.2 * fine)

    return png(width, height, pixel, step=5)


# ---------------------------------------------------------------------------------------------------- glTF

def f32(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


class Glb:
    def __init__(self):
        self.data = bytearray()
        self.doc = {"asset": {"version": "2.0", "generator": "tools/make_demo.py",
                              "copyright": "Set: Tempera authors, Apache-2.0. Fox: model by PixelMannen (CC0 1.0), "
                                           "rig and animation by tomkranis (CC-BY 4.0), glTF conversion by AsoboStudio "
                                           "and scurest (CC-BY 4.0)"},
                    "scene": 0, "scenes": [{"name": "automaton", "nodes": []}], "nodes": []}
        self.animation = {"name": "shot", "channels": [], "samplers": []}
        self.times = self.accessor([k / FPS for k in range(KEYS)], "SCALAR", bounds=True)

    def add(self, kind, item):
        self.doc.setdefault(kind, []).append(item)
        return len(self.doc[kind]) - 1

    def view(self, raw):
        self.data += b"\0" * (-len(self.data) % 4)
        index = self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw
        return index

    def accessor(self, rows, kind, component=FLOAT, bounds=False):
        flat = [x for row in rows for x in (row if WIDTH[kind] > 1 else (row,))]
        item = {"bufferView": self.view(struct.pack(f"<{len(flat)}{CODE[component]}", *flat)),
                "componentType": component, "count": len(rows), "type": kind}
        if bounds:
            columns = list(zip(*((row if WIDTH[kind] > 1 else (row,)) for row in rows)))
            item["min"], item["max"] = [[f32(limit(c)) for c in columns] for limit in (min, max)]
        return self.add("accessors", item)

    def texture(self, image, name):
        source = self.add("images", {"name": name, "bufferView": self.view(image), "mimeType": "image/png"})
        if not self.doc.get("samplers"):
            self.add("samplers", {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497})
        return self.add("textures", {"source": source, "sampler": 0})

    def material(self, name, color=(1, 1, 1), rough=0.5, metal=0.0, texture=None, rough_texture=None, emit=None,
                 extensions=None):
        pbr = {"baseColorFactor": [*color, 1], "roughnessFactor": rough, "metallicFactor": metal}
        if texture is not None:
            pbr["baseColorTexture"] = {"index": texture}
        if rough_texture is not None:
            pbr["metallicRoughnessTexture"] = {"index": rough_texture}
        item = {"name": name, "pbrMetallicRoughness": pbr}
        if emit:
            item["emissiveFactor"] = list(scale(emit, 1 / max(emit)))
            extensions = {**(extensions or {}), "KHR_materials_emissive_strength": {"emissiveStrength": max(emit)}}
        if extensions:
            item["extensions"] = extensions
            used = set(self.doc.get("extensionsUsed", [])) | set(extensions)
            self.doc["extensionsUsed"] = sorted(used)
        return self.add("materials", item)

    def primitive(self, mesh, material, crease=40.0, uvs=False):
        positions, normals, coordinates, indices = mesh.finish(crease)
        attributes = {"POSITION": self.accessor(positions, "VEC3", bounds=True),
                      "NORMAL": self.accessor(normals, "VEC3")}
        if uvs:
            attributes["TEXCOORD_0"] = self.accessor(coordinates, "VEC2")
        return {"attributes": attributes, "indices": self.accessor(indices, "SCALAR", USHORT), "material": material}

    def mesh(self, name, *primitives):
        return self.add("meshes", {"name": name, "primitives": list(primitives)})

    def node(self, name, parent=None, **fields):
        index = self.add("nodes", {"name": name, **{k: (list(v) if isinstance(v, tuple) else v)
                                                    for k, v in fields.items()}})
        siblings = (self.doc["scenes"][0]["nodes"] if parent is None
                    else self.doc["nodes"][parent].setdefault("children", []))
        siblings.append(index)
        return index

    def animate(self, node, path, values):
        """Linear keys values(t) every frame; quaternions are kept on one side so that none turns the long way round."""
        rows = [values(k / FPS) for k in range(KEYS)]
        if path == "rotation":
            for k in range(1, len(rows)):
                if dot(rows[k], rows[k - 1]) < 0:
                    rows[k] = scale(rows[k], -1)
        self.animation["samplers"].append({"input": self.times, "interpolation": "LINEAR",
                                           "output": self.accessor(rows, "VEC3" if path != "rotation" else "VEC4")})
        self.animation["channels"].append({"sampler": len(self.animation["samplers"]) - 1,
                                           "target": {"node": node, "path": path}})

    def write(self, path):
        self.add("animations", self.animation)
        self.data += b"\0" * (-len(self.data) % 4)
        self.doc["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.doc, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.data)) +
                         struct.pack("<I4s", len(text), b"JSON") + text +
                         struct.pack("<I4s", len(self.data), b"BIN\0") + bytes(self.data))


class Fox:
    """Reads the parts of source/fox.glb that the demo takes: geometry, skeleton, picture and the Run clip."""

    def __init__(self, path):
        raw = path.read_bytes()
        length = struct.unpack_from("<I", raw, 12)[0]
        self.doc = json.loads(raw[20:20 + length])
        self.data = raw[28 + length:]

    def rows(self, index):
        accessor = self.doc["accessors"][index]
        view = self.doc["bufferViews"][accessor["bufferView"]]
        width, code = WIDTH[accessor["type"]], CODE[accessor["componentType"]]
        stride = view.get("byteStride") or struct.calcsize(code) * width
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return [struct.unpack_from(f"<{width}{code}", self.data, start + k * stride) for k in range(accessor["count"])]

    def image(self):
        view = self.doc["bufferViews"][self.doc["images"][0]["bufferView"]]
        return self.data[view["byteOffset"]:view["byteOffset"] + view["byteLength"]]

    def clip(self, name):
        """For each animated (node, path) a function of time in cycles, periodic over the clip."""
        animation = next(a for a in self.doc["animations"] if a["name"] == name)
        tracks = {}
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            times = [t for t, in self.rows(sampler["input"])]
            values = self.rows(sampler["output"])
            target = channel["target"]

            def track(cycles, times=times, values=values, rotate=target["path"] == "rotation"):
                t = cycles % 1.0 * times[-1]
                k = next((i for i in range(len(times) - 1) if t <= times[i + 1]), len(times) - 2)
                u = min(max((t - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)
                a, b = values[k], values[k + 1]
                if not rotate:
                    return mix(a, b, u)
                # Keys are a few degrees apart, where normalized linear interpolation equals slerp to 1e-4.
                return normalize(mix(a, b if dot(a, b) >= 0 else scale(b, -1), u))

            tracks[target["node"], target["path"]] = track
        return tracks


# ---------------------------------------------------------------------------------------------------- the shot

def put_fox(glb, position, turn):
    fox = Fox(DEMO / "source" / "fox.glb")
    primitive = fox.doc["meshes"][0]["primitives"][0]["attributes"]
    mesh = Mesh()
    positions, uvs = fox.rows(primitive["POSITION"]), fox.rows(primitive["TEXCOORD_0"])
    joints, weights = fox.rows(primitive["JOINTS_0"]), fox.rows(primitive["WEIGHTS_0"])
    # The model is a triangle soup without normals: weld what agrees in all attributes and smooth over soft edges.
    bound = {}
    for p, uv, j, w in zip(positions, uvs, joints, weights):
        bound[tuple(round(x * 1e5) for x in p)] = (j, w)
    for k in range(0, len(positions), 3):
        mesh.triangle(*positions[k:k + 3], uvs[k:k + 3])
    vertex, normal, uv, indices = mesh.finish(crease=32.0)
    skinned = [bound[tuple(round(x * 1e5) for x in p)] for p in vertex]

    texture = glb.texture(fox.image(), "fox")
    material = glb.material("fox", texture=texture, rough=0.55)
    first = len(glb.doc["nodes"])
    place = glb.node("fox_place", translation=position, rotation=about_y(turn), scale=(FOX_SCALE,) * 3)
    remap = {}

    def bones(index, parent):
        source = fox.doc["nodes"][index]
        fields = {k: source[k] for k in ("translation", "rotation", "scale") if k in source}
        remap[index] = glb.node(source["name"], parent, **fields)
        for child in source.get("children", []):
            bones(child, remap[index])

    bones(0, place)
    skin_source = fox.doc["skins"][0]
    skin = glb.add("skins", {"joints": [remap[j] for j in skin_source["joints"]],
                             "inverseBindMatrices": glb.accessor(fox.rows(skin_source["inverseBindMatrices"]), "MAT4")})
    attributes = {"POSITION": glb.accessor(vertex, "VEC3", bounds=True), "NORMAL": glb.accessor(normal, "VEC3"),
                  "TEXCOORD_0": glb.accessor(uv, "VEC2"),
                  "JOINTS_0": glb.accessor([j for j, _ in skinned], "VEC4", USHORT),
                  "WEIGHTS_0": glb.accessor([w for _, w in skinned], "VEC4")}
    mesh_index = glb.mesh("fox", {"attributes": attributes, "indices": glb.accessor(indices, "SCALAR", USHORT),
                                  "material": material})
    glb.node("fox", mesh=mesh_index, skin=skin)
    for (node, path), track in fox.clip("Run").items():
        glb.animate(remap[node], path, lambda t, track=track: track(t / FOX_CYCLE + 0.1))
    return first


def build(glb):
    rng = random.Random(2026)
    up = (0.0, 1.0, 0.0)

    brass = glb.material("brass", (0.89, 0.62, 0.27), rough=0.36, metal=1.0)
    dark_brass = glb.material("dark_brass", (0.66, 0.42, 0.20), rough=0.40, metal=1.0)
    mirror = glb.material("mirror", (0.95, 0.95, 0.96), rough=0.0, metal=1.0)
    glass = glb.material("glass", rough=0.0, extensions={
        "KHR_materials_transmission": {"transmissionFactor": 1.0}, "KHR_materials_ior": {"ior": 1.5},
        "KHR_materials_volume": {"thicknessFactor": 0.6, "attenuationDistance": 1.6,
                                 "attenuationColor": [0.80, 0.95, 0.92]}})
    leaves = [glb.material("leaves_teal", (0.030, 0.150, 0.115), rough=0.55),
              glb.material("leaves_green", (0.075, 0.190, 0.060), rough=0.55),
              glb.material("leaves_olive", (0.170, 0.210, 0.055), rough=0.6)]
    bark = glb.material("bark", (0.110, 0.055, 0.030), rough=0.8)
    stone = glb.material("stone", (0.27, 0.255, 0.25), rough=0.75)
    cap = glb.material("cap", (0.52, 0.030, 0.020), rough=0.22)
    stem = glb.material("stem", (0.78, 0.70, 0.58), rough=0.6)
    wood = glb.material("wood", texture=glb.texture(wood_texture(256, 128), "wood"), rough=0.38)
    table_top = glb.material("table_top", texture=glb.texture(table_texture(640), "table"), rough=0.62)
    tiles = glb.material("tiles", texture=glb.texture(tile_color(256), "tiles"), rough=1.0, metal=1.0,
                         rough_texture=glb.texture(tile_roughness(128), "tiles_roughness"),
                         extensions={"KHR_materials_specular": {"specularFactor": 0.55}})
    lantern = glb.material("lantern", (0.0, 0.0, 0.0), rough=1.0, emit=(4.6, 2.3, 0.80))

    # The floor: one quad of a metre a tile, well under the mechanism and out to the hills of the sky.
    floor, half, level = Mesh(), 60.0, -0.62
    floor.quad((-half, level, half), (half, level, half), (half, level, -half), (-half, level, -half),
               ((0, half), (half, half), (half, 0), (0, 0)))
    glb.node("floor", mesh=glb.mesh("floor", glb.primitive(floor, tiles, uvs=True)))

    # Base under the table.
    base = lathe([(1.5, -0.40), (1.55, -0.42), (1.62, -0.50), (1.80, -0.52), (1.84, -0.55), (1.84, level)], 72, (12, 1))
    glb.node("base", mesh=glb.mesh("base", glb.primitive(base, wood, uvs=True)))

    # The turntable: everything below this node turns with it.
    table = glb.node("table")
    glb.animate(table, "rotation", lambda t: about_y(TABLE_SPEED * t))
    top = Mesh()
    for s in range(96):
        a, b = TAU * s / 96, TAU * (s + 1) / 96
        p, q = ((1.975 * math.sin(x), 0.0, 1.975 * math.cos(x)) for x in (a, b))
        to_uv = lambda v: (v[0] / TABLE_RADIUS / 2 + 0.5, v[2] / TABLE_RADIUS / 2 + 0.5)
        top.triangle((0, 0, 0), p, q, ((0.5, 0.5), to_uv(p), to_uv(q)))
    rim = lathe([(1.975, 0.0), (1.992, -0.008), (2.0, -0.025), (2.0, -0.105), (1.985, -0.12), (1.9, -0.12)], 96, (10, 1))
    cogs = gear(TABLE_TEETH, -0.36, -0.15, 1.70, chamfer=0.014)
    glb.node("disc", table, mesh=glb.mesh("disc", glb.primitive(top, table_top, uvs=True),
                                          glb.primitive(rim, wood, uvs=True)))
    glb.node("cogs", table, mesh=glb.mesh("cogs", glb.primitive(cogs, brass, crease=25.0)))

    # The forest that it carries.
    tree_meshes = []
    for k, material in enumerate(leaves):
        crown, trunk = tree(9, rng)
        tree_meshes.append(glb.mesh(f"tree{k}", glb.primitive(crown, material, crease=1.0),
                                    glb.primitive(trunk, bark)))
    rocks = [glb.mesh(f"rock{k}", glb.primitive(rock(rng), stone, crease=1.0)) for k in range(2)]
    cap_mesh = lathe([(0, 1.0), (0.25, 0.97), (0.5, 0.87), (0.72, 0.68), (0.80, 0.52), (0.74, 0.47), (0.2, 0.55),
                      (0, 0.55)], 16)
    stem_mesh = lathe([(0, 0.6), (0.17, 0.58), (0.17, 0.3), (0.24, 0.02), (0, 0.0)], 10)
    mushroom = glb.mesh("mushroom", glb.primitive(cap_mesh, cap, 60.0), glb.primitive(stem_mesh, stem, 60.0))

    placed = []

    def plant(mesh, radius, size, gap, name, tall=1.0):
        for _ in range(400):
            a = TAU * rng.random()
            x, z = radius * math.sin(a), radius * math.cos(a)
            if all(math.hypot(x - px, z - pz) >= gap + pg for px, pz, pg in placed):
                placed.append((x, z, gap))
                glb.node(name, table, mesh=mesh, translation=(x, 0.0, z), rotation=about_y(360 * rng.random()),
                         scale=(size, size * tall, size))
                return

    for _ in range(26):
        size = 0.42 + 0.34 * rng.random()
        plant(tree_meshes[rng.randrange(3)], 0.34 + 0.72 * math.sqrt(rng.random()), size, 0.13, "tree",
              0.95 + 0.4 * rng.random())
    for _ in range(9):
        plant(tree_meshes[rng.randrange(3)], 1.905, 0.15 + 0.06 * rng.random(), 0.06, "sapling")
    for _ in range(10):
        plant(rocks[rng.randrange(2)], 1.16 + 0.06 * rng.random() if rng.random() < 0.5 else 1.91,
              0.045 + 0.045 * rng.random(), 0.05, "rock")
    for _ in range(16):
        plant(mushroom, 1.15 + 0.07 * rng.random() if rng.random() < 0.6 else 1.90, 0.07 + 0.05 * rng.random(), 0.05,
              "mushroom")

    # The fox, at the near side of the table, running towards +x against the table's motion.
    put_fox(glb, (0.0, 0.022, TRACK_RADIUS), 90.0)

    # The drive: pinion and wheel mesh with the table's cogs; angles count from +z towards +x, as in gear().
    def drive(name, teeth, center, speed, phase, material, spokes):
        node = glb.node(name, translation=center)
        glb.animate(node, "rotation", lambda t: about_y(phase + speed * t))
        glb.node(name + "_gear", node, mesh=glb.mesh(name, glb.primitive(spoked_gear(teeth, -0.36, -0.15, spokes),
                                                                         material, crease=25.0)))
        axle = cylinder(0.055, level, 0.06 if teeth == PINION_TEETH else -0.02, 20)
        glb.node(name + "_axle", translation=center,
                 mesh=glb.mesh(name + "_axle", glb.primitive(axle, dark_brass)))
        return node

    def meshing(teeth_a, phase_a, teeth_b, direction):
        """Phase of gear b whose teeth fall into the gaps of gear a, b lying at angle `direction` from a."""
        pitch_a, pitch_b = 360 / teeth_a, 360 / teeth_b
        along = ((direction - phase_a) / pitch_a) % 1.0  # position within a's pitch at the point of contact
        return direction + 180 + (along + 0.5) * pitch_b

    pitch = lambda teeth: MODULE * teeth / 2
    to_pinion, to_wheel = 33.0, 84.0
    distance = pitch(TABLE_TEETH) + pitch(PINION_TEETH)
    pinion_at = (distance * math.sin(math.radians(to_pinion)), 0.0, distance * math.cos(math.radians(to_pinion)))
    pinion_speed = -TABLE_SPEED * TABLE_TEETH / PINION_TEETH
    pinion_phase = meshing(TABLE_TEETH, 0.0, PINION_TEETH, to_pinion)
    distance = pitch(PINION_TEETH) + pitch(WHEEL_TEETH)
    wheel_at = add(pinion_at, (distance * math.sin(math.radians(to_wheel)), 0.0,
                               distance * math.cos(math.radians(to_wheel))))
    pinion = drive("pinion", PINION_TEETH, pinion_at, pinion_speed, pinion_phase, dark_brass, 4)
    drive("wheel", WHEEL_TEETH, wheel_at, -pinion_speed * PINION_TEETH / WHEEL_TEETH,
          meshing(PINION_TEETH, pinion_phase, WHEEL_TEETH, to_wheel), brass, 5)
    crank = tube([(0, 0.03, 0), (0, 0.03, 0.36)], 0.032).join(cylinder(0.085, -0.05, 0.075, 24))
    knob = lathe([(0, 0.33), (0.045, 0.32), (0.068, 0.28), (0.062, 0.22), (0.04, 0.13), (0.038, 0.06), (0.0, 0.055)], 20)
    glb.node("crank", pinion, mesh=glb.mesh("crank", glb.primitive(crank, brass), glb.primitive(
        Mesh().join(knob, (0, 0.0, 0.34)), cap, 60.0)))

    # The orrery: a column, the lantern on top, and arms with the two balls, turning against the table.
    column = lathe([(0, 1.02), (0.05, 1.02), (0.05, 0.86), (0.075, 0.84), (0.075, 0.80), (0.05, 0.78), (0.042, 0.4),
                    (0.05, 0.12), (0.09, 0.10), (0.10, 0.05), (0.15, 0.03), (0.16, 0.0)], 28)
    glb.node("column", mesh=glb.mesh("column", glb.primitive(column, brass)))
    glb.node("lantern", translation=(0.0, 1.20, 0.0),
             mesh=glb.mesh("lantern", glb.primitive(sphere(0.19, 24, 12), lantern, 60.0)))
    arms = glb.node("arms", translation=(0.0, 0.90, 0.0))
    glb.animate(arms, "rotation", lambda t: about_y(-62 + 52 * t))
    reach, ball = 1.12, 0.30
    collar = cylinder(0.085, -0.05, 0.05, 28)
    rods = tube([(0, 0, -reach), (0, 0, reach)], 0.021).join(collar)
    glb.node("rods", arms, mesh=glb.mesh("rods", glb.primitive(rods, brass)))
    for name, side, material, radius in (("glass_ball", 1, glass, ball), ("mirror_ball", -1, mirror, ball)):
        holder = glb.node(name + "_holder", arms, translation=(0.0, 0.0, side * reach))
        # The glass ball bobs on its stem; the mirror ball does so half a turn later.
        lift = lambda t, side=side: (0.0, 0.05 * math.sin(TAU * t / 2.0 + (0 if side > 0 else math.pi)) - 0.02,
                                     side * reach)
        glb.animate(holder, "translation", lift)
        stalk = tube([(0, -0.10, 0), (0, 0.09, 0)], 0.018).join(lathe(
            [(0.0, 0.10), (0.10, 0.145), (0.13, 0.165), (0.12, 0.145), (0.03, 0.08), (0.0, 0.07)], 24))
        glb.node(name + "_stalk", holder, mesh=glb.mesh(name + "_stalk", glb.primitive(stalk, dark_brass)))
        glb.node(name, holder, translation=(0.0, 0.115 + radius, 0.0),
                 mesh=glb.mesh(name, glb.primitive(sphere(radius, 64, 32), material, 60.0)))

    camera = glb.add("cameras", {"name": "camera", "type": "perspective", "perspective": {
        "aspectRatio": 16 / 9, "yfov": math.radians(27.0), "znear": 0.05, "zfar": 200.0}})
    node = glb.node("camera", camera=camera)

    def eye(t):
        s = t / 2.0
        a = math.radians(-17 + 36 * s)
        distance, height = 6.7 - 0.6 * s, 1.10 + 0.40 * s
        return (distance * math.sin(a), height, distance * math.cos(a))

    def target(t):
        s = t / 2.0
        return (0.25 + 0.10 * s, 0.42 - 0.03 * s, 0.5)

    glb.animate(node, "translation", eye)
    glb.animate(node, "rotation", lambda t: look_at(eye(t), target(t)))


def main():
    glb = Glb()
    build(glb)
    glb.write(DEMO / "demo.glb")
    noise, width, height = Noise(77), 512, 256

    def pixel(x, y):
        theta, phi = math.pi * (y + 0.5) / height, TAU * (x + 0.5) / width
        # Mitsuba's convention: the picture's left edge is -z, a quarter to the right +x.
        return sky((math.sin(phi) * math.sin(theta), math.cos(theta), -math.cos(phi) * math.sin(theta)), noise)

    write_hdr(DEMO / "sky.hdr", width, height, pixel)


if __name__ == "__main__":
    main()
