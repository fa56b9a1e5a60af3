#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Figures 4 to 11 of Manzi et al. 2016, Temporal Gradient-Domain Path Tracing, and what its Section 6 compares.

PT, GPT and TGPT are `path`, `gradient_path` and `temporal_gradient_path` with adaptive sampling, TGPT- is the method
without what Section 4 adds: no motion vectors, no adaptive sampling. All of a table take the processor time of the same
number of samples of PT (bench/quality.py measures and compares), reconstruction included. Pictures, plots and tables.md
go to out/papers/manzi2016; what is not made again stays in them.

  ./dev paper manzi2016                     all of it
  ./dev paper manzi2016 --figure 7,11       some figures
  ./dev paper manzi2016 --figure parts      each part of the method alone, as in Section 6; `speed`: faster motion
  ./dev paper manzi2016 --quick             a trial of a few minutes, with smaller pictures
"""
import argparse
import copy
import functools
import json
import math
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
from array import array

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "tools")]
import figures  # noqa: E402
import plot_reconstruction  # noqa: E402  (from tools/)
import quality  # noqa: E402  (from bench/)

PT, GPT, TGPT = "path", "gradient_path", "temporal_gradient_path:adaptive=published"
GPT_ADAPTIVE, TGPT_UNIFORM = "gradient_path:adaptive=published", "temporal_gradient_path"
NAMES = {PT: "PT", GPT: "GPT", TGPT: "TGPT", GPT_ADAPTIVE: "GPT, adaptive", TGPT_UNIFORM: "TGPT, uniform"}
FRAMES = "1-8"
METRICS = ["relmse", "temporal_compensated", "flicker_display", "bias"]
# Scene of the gallery: what the paper has, its samples of TGPT and PT, and a close-up in parts of the picture.
SCENES = {
    "bookshelf": ("Bookshelf", "32 / 80", (0.55, 0.30, 0.36, 0.36)),
    "sponza": ("Sponza", "32 / 80", (0.05, 0.25, 0.36, 0.36)),
    "running-figure": ("Running Man", "32 / 80", (0.35, 0.50, 0.36, 0.36)),
    "modern-hall": ("Kitchen 1 and 2", "256 / 640", (0.30, 0.35, 0.36, 0.36)),
}
STANDS_FOR = {
    "bookshelf": "Bookshelf: a shelf of our own with the same name.",
    "sponza": "Sponza: a courtyard in the manner of that model.",
    "running-figure": "Running Man: a figure of our own.",
    "modern-hall": "Kitchen 1 and 2: one hall with gloss, many lamps and a moving camera.",
}
PASS = [prefix + c for prefix in ("", "grad.x.", "grad.y.") for c in "RGB"]  # channels of one pass
OFFSET = ["offset." + ("color." + c if len(c) == 1 else c) for c in PASS]
SOURCE = [f"offset.source.{c}" for c in "XYV"]


def execute(*command):
    """Runs a command; returns what it prints, or ends the program with it."""
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"manzi2016: {' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}")
    return done.stdout


def pixels_of(file, channels, part=None):
    """Rows of tuples of the channels of a file; `part`: (x, y, width, height)."""
    cut = ["--cut", "{2}x{3}+{0}+{1}".format(*part)] if part else []
    chosen = pathlib.Path(file).with_suffix(".part.exr")
    execute("oiiotool", "-i", file, "--ch", ",".join(channels), *cut, "-d", "float", "-o", chosen)
    rows = {}
    for y, values in re.findall(r"Pixel \(-?\d+, (-?\d+)\): ([^\n(]*)", execute("oiiotool", "--dumpdata", chosen)):
        rows.setdefault(int(y), []).append(tuple(float(v) for v in values.split()[:len(channels)]))
    chosen.unlink()
    return [rows[y] for y in sorted(rows)]


def write_pixels(file, rows, names=("R", "G", "B")):
    """Writes rows of triples as an EXR file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    values = array("f", [v for row in reversed(rows) for pixel in row for v in pixel])
    if sys.byteorder == "big":
        values.byteswap()
    plain = file.with_suffix(".pfm")
    plain.write_bytes(f"PF\n{len(rows[0])} {len(rows)}\n-1.0\n".encode() + values.tobytes())
    execute("oiiotool", "-i", plain, "--chnames", ",".join(names), "-d", "float", "-o", file)
    plain.unlink()


def gray(rows):
    return [[(v, v, v) for v in row] for row in rows]


def luminance(pixel):
    return 0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2]


class Study:
    """The scenes with their references, and what the methods make of them at equal time."""

    def __init__(self, args):
        self.args, self.tempera = args, args.build / "bin/tempera"
        self.width, self.height = (int(n) for n in args.size.split("x"))
        self.work = args.build.parent / f"papers/manzi2016/{args.size}-{args.samples}"
        self.settings = argparse.Namespace(
            build=args.build, work=self.work, resolution=args.size, frames=FRAMES, threads=None, exposure="shot",
            reference_spp=args.reference_spp, metrics=METRICS, clock="cpu", denoise=None, oidn=None)

    @functools.cache
    def bench(self, scene):
        return quality.Bench(self.settings, scene)

    def part(self, scene):
        x, y, w, h = SCENES[scene.partition(":")[0]][2]
        return (round(x * self.width), round(y * self.height), round(w * self.width), round(h * self.height))

    def picture(self, scene, caption, file, **options):
        return figures.Picture(caption, file, exposure=self.bench(scene).exposure, **options)

    def reference(self, scene, number, **options):
        """The mean of both references."""
        a, b = (frame(pattern, number) for pattern in self.bench(scene).references)
        file = self.bench(scene).work / f"reference.{number:04}.exr"
        execute("oiiotool", a, "--ch", "R,G,B", b, "--ch", "R,G,B", "--add", "--mulc", "0.5", "-o", file)
        return self.picture(scene, "reference", file, **options)

    @functools.cache
    def equal_time(self, scene, label):
        """{"method", "spp", "seconds", "over", "folder", metric: value} of a method in the time of args.samples samples of
        PT; "over" is the part of it that its least samples take more."""
        bench, method = self.bench(scene), quality.Method(label)
        folder = bench.work / re.sub(r"\W+", "_", label)
        if label == PT:
            spp, seconds = self.args.samples, bench.run(method, self.args.samples, 1, folder)
        else:
            base = self.equal_time(scene, PT)
            # The first guess is the paper's: a sample with differences takes 2.5 times as long.
            bench.seconds_of.setdefault(label, {self.args.samples * 2 // 5: base["seconds"]})
            spp, seconds = bench.calibrate(method, base["seconds"], folder)
        result = self.measured(scene, label, spp, seconds, folder)
        return result | {"over": 0 if label == PT else seconds / base["seconds"] - 1}

    def measured(self, scene, label, spp, seconds, folder):
        result = {"method": NAMES.get(label, label), "spp": spp, "seconds": seconds, "folder": folder}
        result |= self.bench(scene).measure(folder, METRICS)
        print(f"  {scene}, {result['method']}: {spp} samples, {seconds:.1f} s, relMSE {result['relmse']:.4g}", flush=True)
        return result

    def table(self, scene, results):
        """Lines for each result, with ratios to the first one in brackets."""
        def cell(r, metric):
            ratio = r[metric] / results[0][metric] if metric not in quality.SIGNED and results[0][metric] > 0 else None
            return quality.number(r[metric]) + (f" ({ratio:.2g})" if ratio and r is not results[0] else "")

        def time_of(r):
            over = r.get("over", 0)
            return f"{r['seconds']:.1f}" + (f", {100 * over:.0f} % over" if over > quality.TOLERANCE - 1 else "")
        bench = self.bench(scene)
        heading = [scene, "samples", "seconds", *(bench.titles[m] for m in METRICS)]
        return quality.table(heading, ["---"] * len(heading), *(
            [r["method"], str(r["spp"]), time_of(r), *(cell(r, m) for m in METRICS)] for r in results)) + "\n"

    def render(self, scene, name, *options, frames=FRAMES, size=None):
        """Frames rendered with these options, reconstructed by nothing. Returns their pattern."""
        pattern = self.bench(scene).work / name / "f.####.exr"
        execute(self.tempera, "-q", "render", self.bench(scene).shot, "--resolution", size or self.args.size,
                "--frames", frames, *options, "-o", pattern)
        return pattern

    def say(self, key, title, text):
        """Puts a section into tables.md, which has the sections of all figures that were made."""
        parts = self.args.out / "parts"
        parts.mkdir(parents=True, exist_ok=True)
        (parts / f"{key}.md").write_text(f"## {title}\n\n{text}\n", encoding="utf-8")
        sections = [parts / f"{k}.md" for k in FIGURES]
        (self.args.out / "tables.md").write_text("# Manzi et al. 2016\n\n" + "".join(
            f.read_text(encoding="utf-8") for f in sections if f.exists()), encoding="utf-8")


def frame(pattern, number):
    return pathlib.Path(str(pattern).replace("####", f"{number:04}"))


def final(result, number):
    return result["folder"] / f"final/f.{number:04}.exr"


# --- Figures 4 and 5: the error over temporal frequencies -------------------------------------------------------------

@functools.cache
def theory(study):
    """The closed form of Eq. 4 and what the solver makes of white noise, and their plots."""
    columns = json.loads(execute(study.args.build / "bench/poisson_bench", "--theory"))
    study.args.out.mkdir(parents=True, exist_ok=True)
    plot_reconstruction.plot_theory(columns, study.args.out)
    return columns


def theory_table(columns, rows):
    """Errors at equal time: the temporal method has two passes of half the samples, so twice the variance."""
    lines = []
    for title, name, scale in rows:
        for label, values in (("Eq. 4", columns[name]["theory"]), ("solver", columns[name]["solver"])):
            lines.append([f"{title}, {label}", *(f"{scale * values['at'][k]:.3f}" for k in (0, 2, 4, 6, 8, 10)),
                          f"{scale * values['mean']:.3f}"])
    return quality.table(["thousandths at frequency", "0", "0.1", "0.2", "0.3", "0.4", "0.5", "mean"], ["---"] * 8, *lines)


def figure_4(study):
    columns = theory(study)
    shutil.move(study.args.out / "reconstruct-frequency.svg", study.args.out / "figure-4.svg")
    study.say("4", "Figure 4: error over temporal frequencies", theory_table(columns, [
        ("GPT", "independent, spatial rows", 1), ("with dt", "independent, first order", 2),
        ("with dt, dxdt, dydt", "independent, c = 1", 2)]) +
        "\nThe paper prints a plot without figures and Eq. 4, which gives those above; PT has 10 throughout. "
        "figure-4.svg.\n")


def figure_5(study):
    columns = theory(study)
    shutil.move(study.args.out / "reconstruct-ratio.svg", study.args.out / "figure-5.svg")
    study.say("5", "Figure 5: the same for temporal differences of c times the variance", theory_table(
        columns, [(f"c = {c}", f"independent, c = {c}", 2) for c in ("0.5", "1", "1.5", "2")]) + "\nPlot: figure-5.svg.\n")


# --- Figure 6: where samples go, and where they should ----------------------------------------------------------------

def as_density(error):
    """What adaptive sampling makes of errors: median of 5 x 5, smoothed, at most eight times the mean of 1."""
    height, width = len(error), len(error[0])

    def near(rows, x, y, offsets):
        return [rows[min(max(y + dy, 0), height - 1)][min(max(x + dx, 0), width - 1)] for dx, dy in offsets]
    square = [(dx, dy) for dx in range(-2, 3) for dy in range(-2, 3)]
    rows = [[sorted(near(error, x, y, square))[12] for x in range(width)] for y in range(height)]
    for line in ([(d, 0) for d in range(-2, 3)], [(0, d) for d in range(-2, 3)]):
        rows = [[sum(k * v for k, v in zip((0.1, 0.2, 0.4, 0.2, 0.1), near(rows, x, y, line))) for x in range(width)]
                for y in range(height)]
    mean = statistics.fmean(v for row in rows for v in row)
    return [[min(8.0, v / mean) for v in row] for row in rows]


def figure_6(study):
    scene, number, spp = "running-figure", 5, 32
    runs = 4 if study.args.quick else 16
    maps, pictures = [], []
    for seed in range(1, runs + 1):
        common = ("--integrator", GPT, "--spp", spp, "--layers", "color", "--seed", seed)
        if seed <= max(2, runs // 4):
            one = study.render(scene, "map", *common, "--param", "adaptive=published", frames=number)
            maps.append(pixels_of(frame(one, number), ["samples.N"]))
        one = frame(study.render(scene, "uniform", *common, frames=number), number)
        execute(study.tempera, "-q", "reconstruct", one, "-o", one.with_name("final.exr"))
        pictures.append(pixels_of(one.with_name("final.exr"), "RGB"))
    ours = [[statistics.fmean(m[y][x][0] for m in maps) / spp for x in range(study.width)] for y in range(study.height)]

    def relative_variance(x, y):
        colors = [p[y][x] for p in pictures]
        light = statistics.fmean(sum(c) for c in colors)
        return sum(statistics.variance(c[k] for c in colors) for k in range(3)) / (light * light + 1e-3)
    ideal = as_density([[relative_variance(x, y) for x in range(study.width)] for y in range(study.height)])
    ideal = [[0.25 + 0.75 * v for v in row] for row in ideal]  # a quarter of the samples is even: the first batch
    work = study.bench(scene).work
    shown = []
    for name, rows, caption in (("map", ours, "variance of differences"), ("ideal", ideal, "variance of L1 solutions")):
        write_pixels(work / f"{name}.exr", gray([[v / 4 for v in row] for row in rows]))
        shown.append(figures.Picture(caption, work / f"{name}.exr"))
    figures.panel(study.args.out / "figure-6.jpg", shown)
    a, b = ([v for row in rows for v in row] for rows in (ours, ideal))
    pair = statistics.correlation(a, b)
    study.say("6", "Figure 6: samples by variance of differences, and by variance of the solution",
              f"`{scene}`, frame {number}, {spp} samples, {len(maps)} and {runs} runs (paper: 128 samples, 100 runs); "
              f"white is four times the mean. Correlation of both maps: {pair:.2f} (paper: \"look very similar\"). The "
              f"noise of a variance of {runs} runs is in the second one. figure-6.jpg.\n")


# --- Figure 7: adaptive sampling of PT and TGPT -----------------------------------------------------------------------

def adaptive_path(study, scene):
    """PT that stops at a relative error of each pixel, at the time of all."""
    base, error = study.equal_time(scene, PT), 0.25
    bench, folder = study.bench(scene), study.bench(scene).work / "adaptive_path"
    for _ in range(4):
        label = f"path:adaptive_error={error:.4g}:adaptive_min_spp=8"
        seconds = bench.run(quality.Method(label), 8 * study.args.samples, 1, folder)
        if abs(seconds / base["seconds"] - 1) < 0.1:
            break
        error = min(1.0, error * min(3.0, max(0.33, math.sqrt(seconds / base["seconds"]))))
    result = study.measured(scene, label, study.args.samples, seconds, folder)
    return result | {"method": "PT, adaptive", "spp": f"8 to {8 * study.args.samples}"}, label


def figure_7(study):
    scene, number = "modern-hall", 4
    adaptive, label = adaptive_path(study, scene)
    results = [study.equal_time(scene, PT), adaptive, study.equal_time(scene, TGPT_UNIFORM), study.equal_time(scene, TGPT)]
    integrator, settings = quality.settings_of(label, label)
    shown = []
    for name, options in (("PT: samples", (integrator, *(f"{k}={v}" for k, v in settings))),
                          ("TGPT: samples", ("temporal_gradient_path", "adaptive=published"))):
        spp = results[3]["spp"] if "TGPT" in name else 8 * study.args.samples
        parameters = [word for p in options[1:] for word in ("--param", p)]
        raw = frame(study.render(scene, "samples", "--integrator", options[0], *parameters, "--spp", spp, "--layers", "samples",
                                 frames=number), number)
        counts = [[v[0] for v in row] for row in pixels_of(raw, ["samples.N"])]
        mean = statistics.fmean(v for row in counts for v in row)
        file = study.bench(scene).work / f"samples_{options[0]}.exr"
        write_pixels(file, gray([[v / mean / 4 for v in row] for row in counts]))
        shown.append(figures.Picture(name, file))
    figures.panel(study.args.out / "figure-7-samples.jpg", shown)
    part = study.part(scene)
    figures.panel(study.args.out / "figure-7.jpg", [
        study.picture(scene, r["method"], final(r, number), crop=part) for r in results] + [
        study.reference(scene, number, crop=part)], width=240)
    study.say("7", "Figure 7: adaptive sampling of PT and of TGPT",
              study.table(scene, results) +
              f"`{scene}` in place of Kitchen 1. The paper places samples of PT in batches by their variance; our `path` "
              "stops at a relative error of each pixel instead. The paper finds no gain for PT and a visible one for TGPT. "
              "figure-7-samples.jpg (white: four times the mean), figure-7.jpg.\n")


# --- Figures 8 and 9: differences over time ---------------------------------------------------------------------------

@functools.cache
def replayed(study):
    """A frame of bookshelf and the next one with the same random numbers: (samples, pixels of the frame, of the next one at the
    same place, files of both passes along motion, number of the frame). Three times as large as other pictures, so that motion
    is more than a pixel."""
    scene, number, spp, size = "bookshelf", 5, 12, f"{3 * study.width}x{3 * study.height}"
    common = ("--layers", "color", "--spp", spp, "--integrator", PT)
    base = pixels_of(frame(study.render(scene, "now", *common, frames=number, size=size), number), "RGB")
    # Frame t with the shutter of frame t + 1: the same random numbers, a frame later.
    still = pixels_of(frame(study.render(scene, "later", *common, "--shutter", "1,1.5", frames=number, size=size), number),
                      "RGB")
    raw = study.render(scene, "replayed", "--layers", "color", "--spp", 2 * spp, "--integrator", TGPT_UNIFORM,
                       frames=f"{number}-{number + 1}", size=size)
    return spp, base, still, raw, number


def figure_8(study):
    _, _, _, raw, number = replayed(study)
    after = frame(raw, number + 1)
    rows = pixels_of(after, SOURCE)
    write_pixels(after.with_name("source.exr"), gray([[0.6 * v for _, _, v in row] for row in rows]))
    share = statistics.fmean(v for row in rows for _, _, v in row)
    figures.panel(study.args.out / "figure-8.jpg", [
        study.picture("bookshelf", f"base pass of frame {number}", frame(raw, number)),
        study.picture("bookshelf", f"offset pass of frame {number + 1}", after, channels=[f"offset.color.{c}" for c in "RGB"]),
        figures.Picture("pixels with a partner", after.with_name("source.exr"))], width=240)
    study.say("8", "Figure 8: both passes of a frame",
              "The paper draws a diagram; figure-8.jpg shows the data that it speaks of, of `bookshelf`: frame t, frame t + 1 "
              "with the same random numbers along motion, and which pixels do replay one "
              f"({100 * share:.1f} %; black: samples of their own).\n")


def figure_9(study):
    spp, base, still, raw, number = replayed(study)
    before, after = pixels_of(frame(raw, number), "RGB"), pixels_of(frame(raw, number + 1), OFFSET[:3] + SOURCE)
    moved = [[(0.0, 0.0, 0.0)] * len(row) for row in base]
    partner = [[False] * len(row) for row in base]
    for row in after:
        for *color, x, y, valid in row:
            if valid:
                moved[int(y)][int(x)] = tuple(b - a for a, b in zip(before[int(y)][int(x)], color))
                partner[int(y)][int(x)] = True
    unmoved = [[tuple(b - a for a, b in zip(p, q)) for p, q in zip(*rows)] for rows in zip(base, still)]

    def rms(rows):  # of the pixels that have a partner, so that both are of the same pixels
        return math.sqrt(statistics.fmean(v * v for row, there in zip(rows, partner)
                                          for d, replays in zip(row, there) if replays for v in d))
    gain = 0.4 / max(1e-9, 2 * rms(unmoved))
    work = study.bench("bookshelf").work
    shown = []
    for name, rows, caption in (("unmoved", unmoved, "without motion vectors"), ("moved", moved, "with motion vectors")):
        write_pixels(work / f"{name}.exr", [[tuple(0.2 + gain / 2 * v for v in d) for d in row] for row in rows])
        shown.append(figures.Picture(caption, work / f"{name}.exr"))
    figures.panel(study.args.out / "figure-9.jpg", shown, width=384)
    study.say("9", "Figure 9: differences over time without and with motion vectors",
              f"`bookshelf`, frames {number} and {number + 1}, {spp} samples (paper: 512), {len(base[0])}x{len(base)}. Root "
              f"mean square, over pixels that have a partner: {rms(unmoved):.4f} without, {rms(moved):.4f} with motion vectors, "
              f"{rms(unmoved) / rms(moved):.1f} times less (paper: \"significantly smaller\"). Gray is zero. figure-9.jpg.\n")


# --- Figure 10: a pixel over time -------------------------------------------------------------------------------------

def without_extensions(strip, study, spp, frames, crop, folder):
    """TGPT-: both passes by gradient_path, the offset pass of frame t being frame t - 1 with the shutter of t."""
    first, last = frames
    common = [study.tempera, "-q", "render", strip.shot, "--resolution", study.args.size, "--crop", ",".join(map(str, crop)),
              "--integrator", GPT, "--param", "rare=false", "--layers", "color", "--spp", max(1, spp // 2), "--seed", 1]
    execute(*common, "--frames", f"{first}-{last}", "-o", folder / "base.####.exr")
    execute(*common, "--frames", f"{first - 1}-{last - 1}", "--shutter", "1,1.5", "-o", folder / "offset.####.exr")
    x0, y0, w, h = crop
    write_pixels(folder / "source.exr", [[(x0 + x, y0 + y, 1) for x in range(w)] for y in range(h)], SOURCE)
    for t in range(first, last + 1):
        execute("oiiotool", "-i", folder / f"base.{t:04}.exr", "--ch", ",".join(["A", *PASS]),
                "-i", folder / f"offset.{t - 1:04}.exr", "--ch", ",".join(PASS), "--chnames", ",".join(OFFSET), "--chappend",
                "-i", folder / "source.exr", "--chappend", "-d", "float", "-o", folder / f"both.{t:04}.exr")
    execute(study.tempera, "-q", "reconstruct", folder / "both.####.exr", "--weights", "uniform",
            "-o", folder / "final/f.####.exr")


def figure_10(study):
    first, last = 1, 8 if study.args.quick else 16
    crop = (round(0.35 * study.width), 0, round(0.3 * study.width), study.height)
    text = ""
    for scene, start in (("modern-hall", (0.5, 0.5)), ("bookshelf", (0.5, 0.45))):
        strip = copy.copy(study.bench(scene))
        strip.common = ["--resolution", study.args.size, "--frames", f"{first}-{last}", "--crop", ",".join(map(str, crop))]
        strip.seconds_of = {}
        sequences = {}
        for label in (PT, GPT, TGPT):
            folder = strip.work / ("strip_" + re.sub(r"\W+", "_", label))
            strip.run(quality.Method(label), study.equal_time(scene, label)["spp"], 1, folder)
            sequences[NAMES[label]] = folder / "final/f.####.exr"
        folder = strip.work / "strip_minus"
        without_extensions(strip, study, study.equal_time(scene, TGPT_UNIFORM)["spp"], (first, last), crop, folder)
        sequences = {"PT": sequences["PT"], "GPT": sequences["GPT"], "TGPT-": folder / "final/f.####.exr",
                     "TGPT": sequences["TGPT"]}
        sequences["reference"] = study.render(scene, "strip_reference", "--crop", ",".join(map(str, crop)), "--integrator", PT,
                                              "--spp", study.args.reference_spp, "--seed", 3000003, "--layers", "motion",
                                              frames=f"{first}-{last}")
        # The column that the pixel is in, along the motion of the pixel, rounded for each frame.
        x, y, places = start[0] * crop[2], start[1] * crop[3], []
        for t in range(first, last + 1):
            at = (min(max(int(x), 0), crop[2] - 1), min(max(int(y), 0), crop[3] - 1))
            places.append(at)
            dx, dy, _, valid = pixels_of(frame(sequences["reference"], t),
                                         [f"motion.forward.{c}" for c in "XYZV"], (*at, 1, 1))[0][0]
            x, y = (x + dx, y + dy) if valid else (x, y)
        half = min(47, crop[3] // 2 - 1 - max(abs(p[1] - crop[3] // 2) for p in places))
        columns = {name: [[row[0] for row in pixels_of(frame(pattern, first + k), "RGB", (px, py - half, 1, 2 * half + 1))]
                          for k, (px, py) in enumerate(places)] for name, pattern in sequences.items()}
        for name, values in columns.items():
            write_pixels(strip.work / f"strip_{name}.exr",
                         [[values[k // 2][j] for k in range(2 * len(values))] for j in range(2 * half + 1)])
        figures.panel(study.args.out / f"figure-10-{scene}.jpg",
                      [study.picture(scene, name, strip.work / f"strip_{name}.exr") for name in columns], width=144)
        curves = {name: [luminance(values[k][half]) for k in range(len(values))] for name, values in columns.items()}
        top = 1.1 * max(max(c) for c in curves.values())
        plot = plot_reconstruction.Plot((first, last), (0, top), "frame", "luminance", range(first, last + 1, 4),
                                        [round(k * top / 4, 2) for k in range(5)])
        for (name, curve), color in zip(curves.items(), ("orange", "green", "red", "blue", "black")):
            plot.curve([(first + k, v) for k, v in enumerate(curve)], color, name, "4 3" if name == "reference" else "")
        plot.write(study.args.out / f"figure-10-{scene}.svg")

        def jumps(name):  # of the error from frame to frame, over the whole column
            errors = [[luminance(a) - luminance(b) for a, b in zip(*pair)] for pair in zip(columns[name], columns["reference"])]
            return math.sqrt(statistics.fmean((b - a) ** 2 for now, then in zip(errors, errors[1:]) for a, b in zip(now, then)))
        text += f"| {scene} | " + " | ".join(f"{jumps(n):.4f}" for n in list(columns)[:-1]) + " |\n"
    study.say("10", "Figure 10: a pixel and its column over time",
              "Root mean square of how the error of luminance changes from frame to frame, in the column around the pixel:\n\n"
              "| scene | PT | GPT | TGPT- | TGPT |\n| --- | --- | --- | --- | --- |\n" + text +
              "\n`modern-hall` in place of Kitchen 1; the paper prints plots without figures. figure-10-SCENE.svg and .jpg.\n")


# --- Figure 11: the five scenes at equal time -------------------------------------------------------------------------

def figure_11(study):
    text, number = "", 4
    for scene, (title, samples, _) in SCENES.items():
        results = [study.equal_time(scene, label) for label in (PT, GPT, TGPT)]
        part = study.part(scene)
        figures.panel(study.args.out / f"figure-11-{scene}.jpg",
                      [study.picture(scene, f"{title}: TGPT", final(results[2], number))] +
                      [study.picture(scene, r["method"], final(r, number), crop=part) for r in results] +
                      [study.reference(scene, number, crop=part)], width=240)
        text += (f"{STANDS_FOR[scene]} Samples of TGPT / PT: {samples} in the paper, {results[2]['spp']} / {results[0]['spp']} "
                 "here.\n\n" + study.table(scene, results))
    study.say("11", "Figure 11: PT, GPT and TGPT at equal time", text +
              f"{study.args.size}, frames {FRAMES}, references of {study.args.reference_spp} samples. The paper shows pictures, "
              "no errors. figure-11-SCENE.jpg.\n")


# --- Section 6: each of its parts alone -------------------------------------------------------------------------------

def temporal_only(raw, numbers, folder, alpha=0.2, rounds=6):
    """Solves for the frames from the pictures and their differences over time alone, robustly [Manzi 2016, Sec. 6].

    Without rows over space every chain of pixels that replay each other is a tridiagonal system of its own."""
    frames = [pixels_of(frame(raw, t), ["R", "G", "B", *OFFSET[:3], *SOURCE]) for t in numbers]
    height, width = len(frames[0]), len(frames[0][0])
    solved = [[[None] * width for _ in range(height)] for _ in frames]
    following = [{} for _ in frames]  # {pixel: the pixel of the next frame that replays it}
    for k, rows in enumerate(frames[1:]):
        following[k] = {(int(p[6]), int(p[7])): (x, y) for y, row in enumerate(rows) for x, p in enumerate(row) if p[8]}
    mean = statistics.fmean(sum(p[:3]) / 3 for row in frames[0] for p in row)
    for k, rows in enumerate(frames):
        for y in range(height):
            for x in range(width):
                if solved[k][y][x]:
                    continue
                chain, at = [], (x, y)
                while at:
                    chain.append(at)
                    at = following[k + len(chain) - 1].get(at)
                pixels = [frames[k + i][py][px] for i, (px, py) in enumerate(chain)]
                data = [[(a + b) / 2 for a, b in zip(p[:3], p[3:6])] for p in pixels]
                steps = [[b - a for a, b in zip(p[:3], q[3:6])] for p, q in zip(pixels, pixels[1:])]
                for (px, py), color, i in zip(chain, solve_chain(data, steps, alpha, mean, rounds), range(len(chain))):
                    solved[k + i][py][px] = color
    for t, rows in zip(numbers, solved):
        write_pixels(folder / f"final/f.{t:04}.exr", rows)


def solve_chain(data, steps, alpha, mean, rounds):
    """argmin of the sum of alpha |x_k - data_k| and |x_{k+1} - x_k - step_k| by reweighting."""
    n, x = len(data), [list(d) for d in data]
    for r in range(rounds):
        least = mean * max(0.02, 0.05 * 0.5 ** r)

        def weight(residual):
            return 1.0 if r == 0 else 1 / (math.sqrt(sum(v * v for v in residual)) + least)
        # Weights multiply squared rows, in which alpha is squared, too.
        primal = [alpha ** 2 * weight([alpha * (a - b) for a, b in zip(x[k], data[k])]) for k in range(n)]
        temporal = [weight([b - a - s for a, b, s in zip(x[k], x[k + 1], steps[k])]) for k in range(n - 1)]
        diagonal = [primal[k] + (temporal[k] if k < n - 1 else 0) + (temporal[k - 1] if k else 0) for k in range(n)]
        right = [[primal[k] * data[k][c] - (temporal[k] * steps[k][c] if k < n - 1 else 0) +
                  (temporal[k - 1] * steps[k - 1][c] if k else 0) for c in range(3)] for k in range(n)]
        for k in range(1, n):
            f = temporal[k - 1] / diagonal[k - 1]
            diagonal[k] -= f * temporal[k - 1]
            right[k] = [a + f * b for a, b in zip(right[k], right[k - 1])]
        for k in range(n - 1, -1, -1):
            more = [temporal[k] * v for v in x[k + 1]] if k < n - 1 else [0.0] * 3
            x[k] = [(a + b) / diagonal[k] for a, b in zip(right[k], more)]
    return x


def section_6_parts(study):
    scene, number = "running-figure", 4
    results = [study.equal_time(scene, label) for label in (PT, GPT, GPT_ADAPTIVE, TGPT_UNIFORM, TGPT)]
    part = study.part(scene)
    figures.panel(study.args.out / "section-6-parts.jpg",
                  [study.picture(scene, r["method"], final(r, number), crop=part) for r in results] +
                  [study.reference(scene, number, crop=part)], 3, 240)
    text = "Adaptive sampling and differences over time, each alone and both:\n\n" + study.table(scene, results)

    base = results[0]
    raw = study.render(scene, "temporal_only/raw", "--integrator", TGPT_UNIFORM, "--spp", base["spp"], "--layers", "color",
                       "--seed", 1)
    folder = study.bench(scene).work / "temporal_only"
    temporal_only(raw, quality.frames_of(FRAMES), folder)
    alone = study.measured(scene, "differences over time alone", base["spp"], base["seconds"], folder)
    figures.panel(study.args.out / "section-6-temporal-only.jpg",
                  [study.picture(scene, name, file, crop=part) for name, file in (
                      ("PT", final(base, number)), ("over time alone", final(alone, number)),
                      ("TGPT, uniform", final(results[3], number)))], width=240)
    text += ("Differences over time alone, in one window, with the samples of PT in two passes; its seconds are those of PT, "
             "as no more paths are needed, and its solution is made by this script:\n\n" + study.table(scene, [base, alone]))

    study.say("parts", "Section 6: its parts alone", text +
              "The paper shows these in its video, without figures: both together are best, adaptive sampling alone adds "
              "flicker in smooth places; noise of differences over time alone \"appears glued to the surfaces\". section-6-parts.jpg, "
              "section-6-temporal-only.jpg.\n")


def section_6_speed(study):
    text = "".join(study.table(scene, [study.equal_time(scene, label) for label in (PT, GPT, TGPT)])
                   for scene in ("running-figure", "running-figure:2x", "running-figure:4x"))
    study.say("speed", "Section 6: faster motion",
              text + "The paper shows this in its video, without figures: the faster the motion, the less is gained.\n")


FIGURES = {"4": figure_4, "5": figure_5, "6": figure_6, "7": figure_7, "8": figure_8, "9": figure_9, "10": figure_10,
           "11": figure_11, "parts": section_6_parts, "speed": section_6_speed}


def main():
    parser = argparse.ArgumentParser(prog="./dev paper manzi2016", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", default=",".join(FIGURES), help=f"comma list of {', '.join(FIGURES)} [all]")
    parser.add_argument("--size", metavar="WxH", help="of the pictures [128x72, quick: 48x27]")
    parser.add_argument("--samples", type=int, default=48, help="of PT, whose time all methods have [48]")
    parser.add_argument("--reference-spp", type=int, help="of both references together [256, quick: 64]")
    parser.add_argument("--quick", action="store_true", help="small pictures and references, fewer runs and speeds")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/papers/manzi2016", help="[out/papers/manzi2016]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    chosen = args.figure.split(",")
    if unknown := [f for f in chosen if f not in FIGURES]:
        parser.error(f"no figure {', '.join(unknown)}; known: {', '.join(FIGURES)}")
    args.size = args.size or ("48x27" if args.quick else "128x72")
    args.reference_spp = args.reference_spp or (64 if args.quick else 256)
    if not re.fullmatch(r"\d+x\d+", args.size) or args.samples < 1:
        parser.error("--size is WxH, --samples at least 1")
    args.build = args.build.resolve()
    study = Study(args)
    for key in chosen:
        print(f"== {'Figure ' + key if key.isdigit() else 'Section 6, ' + key}", flush=True)
        FIGURES[key](study)
    print(f"written: {args.out / 'tables.md'}")


if __name__ == "__main__":
    main()
