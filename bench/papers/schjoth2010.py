#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Figures 5 to 8 of Schjøth et al. 2010, "Temporal Photon Differentials", with what the paper says of them in numbers.

The scenes are `wave:collimated` and `glass-cylinder:collimated` of the gallery, seen from straight above. Errors are of
the caustic alone: the sum of |picture - reference| over that of the reference (L1), against light that is traced apart at
many instants. B is the share of the error's power, along the way that light takes, that lies within 20 % of the frequency
of bands: the number of instants but one, over the way during the exposure.

Photons of `wave` are counted as in the study that the scene is from, on 2.5 m x 2.5 m of the floor: the whole pool has
nearly eight times as many. Those of `glass-cylinder` are all that the map holds. Time-dependent photon maps have the
radius, of some, with which they err least.

  ./dev paper schjoth2010
  ./dev paper schjoth2010 --quick                  fewer photons and rays: whether it all runs
  ./dev paper schjoth2010 --figure 7,8
"""
import argparse
import array
import cmath
import functools
import math
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "bench/papers")]
from cost import seconds_of  # noqa: E402
from figures import Picture, panel  # noqa: E402

LAYER = "class.caustic.color"
EXPOSURES = {"1/12": 1 / 12, "1/4": 1 / 4, "1/2": 1 / 2, "3/4": 3 / 4, "1": 1, "5/4": 5 / 4, "3/2": 3 / 2, "7/4": 7 / 4}
TRAILING = {"instant": "close", "overlap": 9}
PUBLISHED = TRAILING | {"gauge": "emission", "sweep": "published", "kernel": "uniform"}
WAVE_SPEED, ROD_TURN = 0.1, 5  # metres and degrees a frame


class Scene:
    """A scene of the gallery and how it is looked at.

    `size`: metres that the camera sees, across and down; `corner`: x and z of the picture's top left. `lit`: the part of the
    light that reaches what is seen, with so many `rays` along x and z. `counted`: x0, z0, x1, z1 where photons are counted,
    None: anywhere."""

    def __init__(self, name, frame, size, corner, lit, rays, counted, depth):
        self.name, self.frame, self.size, self.corner = name, frame, size, corner
        self.lit, self.rays, self.counted, self.depth = lit, rays, counted, depth


WAVE = Scene("wave", 8, (2, 2), (-1, -1), (-1.3, -1.1, 1.3, 1.1), "300,40", (-1.25, -1.25, 1.25, 1.25), 3)
ROD = Scene("glass-cylinder", 1, (2.8, 2.4), (-0.2, -1.2), (-0.1, -0.5, 2.5, 0.3), "600,600", None, 8)


class Study:
    """Where things are made, and how fine they are."""

    def __init__(self, args):
        self.tempera, self.caustic_light = args.build / "bin/tempera", args.build / "bench/caustic_light"
        self.out, self.cells, self.quick = args.out, args.size, args.quick
        self.between = (0, 10) if args.quick else (0, 2, 10)  # instants, of time-dependent maps
        self.rows = []
        (self.out / "frames").mkdir(parents=True, exist_ok=True)

    @functools.cache
    def shot(self, name):
        folder = self.out / "scenes"
        seconds_of([self.tempera, "-q", "gallery", "make", name, "--gallery", folder])
        return folder / name / "shot_collimated.toml"

    def resolution(self, scene):
        return tuple(round(s / 2 * self.cells) for s in scene.size)

    def settings(self, scene, exposure):
        width, height = self.resolution(scene)
        return [f"film.resolution=[{width}, {height}]", f"shutter.open={-exposure}", "shutter.close=0", 'camera="above"',
                "environment.radiance=0", f"integrator.max_depth={scene.depth}"]

    def photons(self, scene, exposure, count, integrator="temporal_photon", **parameters):
        """Photons that are stored of `count` that are emitted: x, z and the way in a frame of each."""
        more = [f"integrator.{k}={v}" for k, v in {"name": integrator, **parameters}.items()]
        text = subprocess.run([str(a) for a in (self.caustic_light, "photons", self.shot(scene.name), scene.frame, count,
                                                *self.settings(scene, exposure), *more)], check=True, stdout=subprocess.PIPE,
                              text=True).stdout
        return [tuple(map(float, line.split())) for line in text.splitlines()]

    @functools.cache
    def emitted(self, scene, exposure, count, integrator, **parameters):
        """How many are emitted for `count` that count. It is tried: beams that are bent strongly are divided."""
        x0, z0, x1, z1 = scene.counted or (-math.inf, -math.inf, math.inf, math.inf)
        emitted, fewer = 8 * count, max(1, count / 5000)
        for _ in range(2):
            stored = self.photons(scene, exposure, round(emitted / fewer), integrator.removeprefix("time_"), **parameters)
            emitted *= count / fewer / sum(x0 <= x <= x1 and z0 <= z <= z1 for x, z, *_ in stored)
        return round(emitted)

    def render(self, scene, name, integrator, photons, exposure=1, **parameters):
        """The caustic's picture by `photons` of those that count."""
        matters = {} if integrator == "time_photon" else parameters
        emitted = self.emitted(scene, exposure, photons, integrator, **matters)
        file = self.out / f"frames/{scene.name}_{name}.exr"
        settings = [a for s in self.settings(scene, exposure) for a in ("--set", s)]
        more = [a for k, v in parameters.items() for a in ("--param", f"{k}={v}")]
        seconds_of([self.tempera, "-q", "render", self.shot(scene.name), "--frames", scene.frame, "--spp", 4, "--layers",
                    "color", "--integrator", integrator, "--param", f"photons={emitted}", *settings, *more, "-o", file])
        return Result(self, scene, file)

    @functools.cache
    def reference(self, scene, exposure):
        file = self.out / f"frames/{scene.name}_reference_{round(1000 * exposure)}"
        rays, times = scene.rays, 20 if self.quick else 60 if scene is ROD else 120
        seconds_of([self.caustic_light, "reference", self.shot(scene.name), scene.frame, ",".join(map(str, scene.lit)), rays,
                    times, file.with_suffix(".pfm"), *self.settings(scene, exposure)])
        rows = read_pfm(file.with_suffix(".pfm"))
        # The light's irradiance is pi.
        rows = [[math.pi * v for v in row] for row in rows]
        if scene is WAVE:  # the same in all rows
            mean = [sum(column) / len(rows) for column in zip(*rows)]
            rows = [mean] * len(rows)
        write_pfm(file.with_suffix(".pfm"), rows)
        seconds_of(["oiiotool", file.with_suffix(".pfm"), "--ch", "0,0,0", "--chnames", ",".join(f"{LAYER}.{c}" for c in "RGB"),
                    "-o", file.with_suffix(".exr")])
        return file.with_suffix(".exr"), rows

    def best(self, scene, name, photons, between, radii, exposure=1, **parameters):
        """A time-dependent photon map with the radius of least error; that radius."""
        radii = radii[1:2] if self.quick else radii
        results = {r: self.render(scene, f"{name}_{r}", "time_photon", photons, exposure, between=between, radius=r,
                                  **parameters) for r in radii}
        radius = min(results, key=lambda r: results[r].error(exposure))
        return results[radius], radius

    def row(self, *cells):
        print("  " + "  ".join(map(str, cells)), flush=True)
        self.rows.append("| " + " | ".join(map(str, cells)) + " |")

    def table(self, title, *heads):
        self.rows += ["", f"**{title}**", "", "| " + " | ".join(heads) + " |", "| --- " * len(heads) + "|"]


class Result:
    """A picture and its errors."""

    def __init__(self, study, scene, file):
        self.study, self.scene, self.file = study, scene, file

    @functools.cached_property
    def rows(self):
        green = self.file.with_suffix(".green.exr")
        seconds_of(["oiiotool", self.file, "--ch", f"{LAYER}.G", "-d", "float", "-o", green])
        text = subprocess.run(["oiiotool", "--dumpdata", str(green)], check=True, stdout=subprocess.PIPE, text=True).stdout
        width, height = self.study.resolution(self.scene)
        values = [float(line.rpartition(":")[2]) for line in text.splitlines() if line.lstrip().startswith("Pixel (")]
        return [values[width * y:width * (y + 1)] for y in range(height)]

    @functools.cache
    def difference(self, exposure):
        """Picture minus reference, 0 where the post of the rod stands."""
        reference = self.study.reference(self.scene, exposure)[1]
        width, height = self.study.resolution(self.scene)
        (w, h), (x0, z0) = self.scene.size, self.scene.corner

        def hidden(i, j):
            return self.scene is ROD and math.hypot(x0 + w * (i + 0.5) / width, z0 + h * (j + 0.5) / height) < 0.07
        return [[0 if hidden(i, j) else v - r for i, (v, r) in enumerate(zip(*rows))]
                for j, rows in enumerate(zip(self.rows, reference))]

    def error(self, exposure=1):
        total = sum(map(sum, self.study.reference(self.scene, exposure)[1]))
        return sum(abs(d) for row in self.difference(exposure) for d in row) / total

    def banding(self, between, exposure=1):
        """B for so many instants in between; None where its bands are finer than two pixels."""
        difference = self.difference(exposure)
        width, _ = self.study.resolution(self.scene)
        pixel = self.scene.size[0] / width
        if self.scene is WAVE:
            lines, step, frequency = difference[::4], pixel, (between + 1) / (WAVE_SPEED * exposure)
            if frequency * step * 1.2 > 0.5:
                return None
        else:
            # Along circles about the pivot, outward of half the rod.
            x0, z0 = self.scene.corner
            step, frequency = 0.1, (between + 1) / (ROD_TURN * exposure)  # degrees
            if 2.3 * math.radians(1 / frequency) < 2 * pixel * 1.2:
                return None
            lines = []
            for k in range(24):
                r = 1.2 + 0.05 * k
                turns = [math.radians(-15 + step * i) for i in range(351)]
                lines.append([at(difference, (r * math.cos(a) - x0) / pixel, (-r * math.sin(a) - z0) / pixel) for a in turns])
        inside = total = 0
        for line in lines:
            n = len(line)
            mean = sum(line) / n
            window = [(v - mean) * math.sin(math.pi * (i + 0.5) / n) for i, v in enumerate(line)]
            for k in range(1, n // 2):
                rotation = cmath.exp(-2j * math.pi * k / n)
                power = abs(functools.reduce(lambda s, v: s * rotation + v, window, 0)) ** 2
                total += power
                if abs(k / (n * step) - frequency) <= 0.2 * frequency:
                    inside += power
        return inside / total if total > 0 else 0

    def picture(self, caption):
        return Picture(caption, self.file, LAYER, exposure=-1.5)


def at(rows, x, y):
    """Linear between the middles of pixels."""
    i, j = math.floor(x - 0.5), math.floor(y - 0.5)
    a, b = x - 0.5 - i, y - 0.5 - j

    def value(i, j):
        return rows[j][i] if 0 <= j < len(rows) and 0 <= i < len(rows[0]) else 0
    return (1 - b) * ((1 - a) * value(i, j) + a * value(i + 1, j)) + b * ((1 - a) * value(i, j + 1) + a * value(i + 1, j + 1))


def read_pfm(file):
    """Rows of a picture of one channel, the top one first."""
    data = pathlib.Path(file).read_bytes()
    kind, size, scale, pixels = data.split(b"\n", 3)
    if kind != b"Pf":
        sys.exit(f"schjoth2010: {file} has not one channel")
    width, height = map(int, size.split())
    values = array.array("f", pixels[:4 * width * height])
    if (float(scale) < 0) != (sys.byteorder == "little"):
        values.byteswap()
    return [values[width * y:width * (y + 1)].tolist() for y in reversed(range(height))]


def write_pfm(file, rows):
    values = array.array("f", [v for row in reversed(rows) for v in row])
    if sys.byteorder == "big":
        values.byteswap()
    pathlib.Path(file).write_bytes(f"Pf\n{len(rows[0])} {len(rows)}\n-1.0\n".encode() + values.tobytes())


def number(value):
    return "–" if value is None else f"{value:.3f}".lstrip("0")


def figure_5(study):
    """The wave at all exposures, 1000 photons."""
    count = 1000
    study.table("Figure 5: `wave`, 1000 photons, L1", "exposure", "as published", "with the matter", "still photons",
                "time-dependent, 10 in between (radius)")
    pictures = {"published": [], "ours": [], "maps": [], "reference": []}
    for name, e in [*EXPOSURES.items()][::3 if study.quick else 1]:
        short = name.replace("/", "_")
        published = study.render(WAVE, f"published_{short}", "temporal_photon", count, e, **PUBLISHED)
        ours = study.render(WAVE, f"ours_{short}", "temporal_photon", count, e, **TRAILING)
        still = study.render(WAVE, f"still_{short}", "photon_differentials", count, e, **TRAILING)
        maps, radius = study.best(WAVE, f"maps_{short}", count, 10, (0.12, 0.16, 0.24), e)
        errors = [r.error(e) for r in (published, ours, still, maps)]
        study.row(name, *map(number, errors[:3]), f"{number(errors[3])} ({radius})")
        pictures["published"].append(published.picture(f"e = {name}  {number(errors[0])}"))
        pictures["ours"].append(ours.picture(f"matter  {number(errors[1])}"))
        pictures["maps"].append(maps.picture(f"maps  {number(errors[3])}"))
        pictures["reference"].append(Picture("reference", study.reference(WAVE, e)[0], LAYER, exposure=-1.5))
    panel(study.out / "figure_05.jpg", [p for row in pictures.values() for p in row], columns=len(pictures["ours"]),
          width=150)


def figure_6(study):
    """Temporal photons against time-dependent photon maps."""
    study.table("Figure 6: `wave`, exposure of one frame", "method", "photons", "in between", "L1", "B of its bands",
                "B of two instants", "radius")
    shown = {}

    def row(key, method, photons, result, between=None, radius="–"):
        error = result.error()
        study.row(method, photons, "–" if between is None else between, number(error),
                  number(None if between is None else result.banding(between)), number(result.banding(0)), radius)
        shown[key] = result.picture(f"{key} {photons}{'' if between is None else f', {between} between'}  {number(error)}")

    for photons in (1000, 2000, 4000):
        row(f"ours, {photons}", "temporal, our defaults", photons,
            study.render(WAVE, f"ours_{photons}", "temporal_photon", photons, instant="close"))
    for photons in (500, 1000):
        row("matter", "temporal, with the matter", photons,
            study.render(WAVE, f"matter_{photons}", "temporal_photon", photons, **TRAILING))
    row("(a)", "temporal, as published", 1000, study.render(WAVE, "published_1000", "temporal_photon", 1000, **PUBLISHED))
    letters = {(1000, 0): "(b)", (40000, 0): "(f)", (40000, 2): "(g)", (40000, 10): "(h)"}
    many = 120000 if study.quick else 480000
    for photons, radii in ((1000, (0.12, 0.16, 0.24, 0.32)), (40000, (0.04, 0.06, 0.08, 0.12)), (many, (0.03, 0.04, 0.06))):
        for between in study.between:
            result, radius = study.best(WAVE, f"maps_{photons}_{between}", photons, between, radii)
            letter = {0: "(c)", 2: "(d)", 10: "(e)"}[between] if photons == many else letters.get((photons, between), "")
            row(letter, "time-dependent", photons, result, between, radius)
    reference = Picture("reference", study.reference(WAVE, 1)[0], LAYER, exposure=-1.5)
    order = ("(a)", "(c)", "(d)", "(e)", "matter", "(b)", "(f)", "(g)", "(h)")
    panel(study.out / "figure_06.jpg", [reference, *(shown[k] for k in order if k in shown)],
          columns=2 + len(study.between), width=230)


def figure_7(study):
    """The rod: 5000 photons, maps with the nearest 100 and 250."""
    count = 5000
    study.table("Figure 7: `glass-cylinder`, exposure of one frame", "method", "photons", "in between", "L1", "B of its bands",
                "B of two instants")
    shown = {}

    def row(key, method, photons, result, between=None):
        error = result.error()
        study.row(method, photons, "–" if between is None else between, number(error),
                  number(None if between is None else result.banding(between)), number(result.banding(0)))
        shown[key] = result.picture(f"{key}  {number(error)}")

    row("(a) as published", "temporal, as published", count,
        study.render(ROD, "published", "temporal_photon", count, **PUBLISHED))
    row("emission, middle", "temporal, gauge `emission`, `middle`", count,
        study.render(ROD, "emission", "temporal_photon", count, gauge="emission", overlap=9))
    row("with the matter", "temporal, with the matter, `middle`", count,
        study.render(ROD, "matter", "temporal_photon", count, overlap=9))
    row("defaults", "temporal, our defaults", count, study.render(ROD, "defaults", "temporal_photon", count))
    for key, nearest in (("(b) 100 nearest", 100), ("(c) 250 nearest", 250)):
        for between in study.between:
            row(f"{key}, {between}", f"time-dependent, {nearest} nearest", count,
                study.render(ROD, f"nearest_{nearest}_{between}", "time_photon", count, between=between, nearest=nearest, radius=1),
                between)
    many = 20000 if study.quick else 100000
    for between in study.between:
        result, radius = study.best(ROD, f"maps_{between}", many, between, (0.02, 0.03, 0.045))
        row(f"{many}, {between}", f"time-dependent, radius {radius}", many, result, between)
    reference = Picture("reference", study.reference(ROD, 1)[0], LAYER, exposure=-1.5)
    first = [shown["(a) as published"], shown["with the matter"], reference]
    nearest = [shown[k] for k in shown if "nearest" in k]
    panel(study.out / "figure_07.jpg", (first if len(study.between) == 3 else first[1:]) + nearest,
          columns=len(study.between), width=360)


def figure_8(study):
    """Where photons go: segments from x to x + D_t e, as published and with the matter."""
    exposure, scale = 4, 300  # frames; pixels a metre
    width, height = (round(scale * s) for s in ROD.size)
    files = []
    for gauge in ("emission", "matter"):
        lines = []
        for x, z, dx, dz in study.photons(ROD, 1, 600, **PUBLISHED | {"gauge": gauge}):
            ends = [(x - ROD.corner[0], z - ROD.corner[1]), (x - ROD.corner[0] + exposure * dx, z - ROD.corner[1] + exposure * dz)]
            lines += ["--line:color=0,0,0", ",".join(f"{scale * v:.0f}" for end in ends for v in end)]
        files.append(study.out / f"figure_08_{gauge}.png")
        seconds_of(["oiiotool", "--create", f"{width}x{height}", 3, "--fill:color=1,1,1", f"{width}x{height}", *lines, "-d", "uint8",
                    "-o", files[-1]])
    panel(study.out / "figure_08.jpg", [Picture("", f) for f in files], width=560)


FIGURES = {"5": figure_5, "6": figure_6, "7": figure_7, "8": figure_8}


def main():
    parser = argparse.ArgumentParser(prog="./dev paper schjoth2010", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", default=",".join(FIGURES), help=f"comma list of {', '.join(FIGURES)} [all]")
    parser.add_argument("--size", type=int, default=200, metavar="PIXELS", help="for two metres of the ground [200]")
    parser.add_argument("--quick", action="store_true", help="fewer photons and rays, pictures of half the size")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/papers/schjoth2010", help="[out/papers/schjoth2010]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    wanted = args.figure.split(",")
    for figure in wanted:
        if figure not in FIGURES:
            parser.error(f"there is no figure {figure}; known: {', '.join(FIGURES)}")
    if not 20 <= args.size <= 2000:
        parser.error("--size is from 20 to 2000 pixels")
    if args.quick:
        args.size = min(args.size, 100)
    args.out, args.build = args.out.resolve(), args.build.resolve()
    study = Study(args)
    for figure in dict.fromkeys(FIGURES[f] for f in wanted):
        print(figure.__name__.replace("_", " "), flush=True)
        figure(study)
    if study.rows:
        (args.out / "tables.md").write_text("\n".join(study.rows).lstrip("\n") + "\n", encoding="utf-8")
    print(f"Written: {args.out}")


if __name__ == "__main__":
    main()
