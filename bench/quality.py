#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Methods at equal time: error, temporal error and flicker of integrators on the scenes of the gallery.

Each method renders the same frames with several seeds; everything is compared with two references of independent seeds,
whose own noise `tempera compare` takes out of squared metrics. References are kept (build/quality) while the frames'
fingerprints (scene, settings, version) and the pixels of a quick rendering of the first frame stay what they were.
Tables show each metric's mean over seeds with the half width of its 95 % confidence interval (Student's t), and its
ratio to the first method; on the screen, ratios have the interval of paired logarithms over the seeds. Results go to
<build>/bench/quality-<commit>.json.

A method is an integrator and settings, separated by colons: spp=N, sampler=NAME, parameters of the integrator, keys of
shot.toml with their table (film.filter=tent), and for the gradient-domain ones those of `tempera reconstruct` (norm,
alpha, window, ...), which is then part of their time. INTEGRATOR+oidn denoises each frame with Open Image Denoise (fetched
by ./dev oidn) from color, albedo and normal, with clean=true from denoised albedo and normal; its time counts, too.
Methods without spp are calibrated to take the same time for all frames, within 5 %: --time seconds, or with --times-of
the time of so many samples of the first method.

  ./dev bench quality --scene cornell-motion --methods path:spp=16,path:spp=64
  ./dev bench quality --scene cornell-motion --methods path:spp=16:sampler=sobol,path:spp=64:sampler=sobol
  ./dev bench quality --scene running-figure --methods path,path+oidn,temporal_gradient_path --times-of 8,40
  ./dev bench quality --scene vase --methods path,path:sampler=independent --equal-error relmse=0.01
  ./dev bench quality --tables tables.md      the tables of docs/papers/manzi2016.md; other arguments replace parts

Four times the samples make a quarter of the squared error with sampler=independent, which is what cornell-motion is
rendered with. The error of the default sampler of other scenes (scrambled Sobol points) falls faster, so the second
example shows more than a factor of 4.
"""
import argparse
import json
import math
import os
import pathlib
import resource
import shutil
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECONSTRUCTED = {"gradient_path", "temporal_gradient_path"}
STAGE_KEYS = {"norm", "alpha", "window", "overlap", "temporal-rows", "strict-mixed", "weights", "schedule", "rounds",
              "iterations", "rare", "parts"}
METHODS = "path,path+oidn,gradient_path,temporal_gradient_path"
METRICS = "flicker_display,relmse,mse,temporal,flicker"
# Frames in a row that tempera compare needs for a metric.
LEAST_FRAMES = {"temporal": 2, "temporal_compensated": 2, "flicker_display": 8, "flicker": 8, "flicker_tracked": 8}
SIGNED = {"bias"}  # their ratios say nothing
# What --tables stands for.
TABLES = {
    "scene": "running-figure@240x135,cornell-motion@160x160,modern-hall@240x135,glass-egg@240x135",
    "methods": "path:sampler=sobol,path:sampler=independent,path+oidn:sampler=sobol,path+oidn:sampler=sobol:clean=true,"
               "temporal_gradient_path,temporal_gradient_path+oidn:clean=true",
    "metrics": "flicker_display,relmse,temporal_compensated,flicker,flicker_tracked,bias",
    "frames": "1-10",
    "times_of": "8,40",
    "reference_spp": 2048,
    "clock": "cpu",
}
DEFAULTS = {"scene": "cornell-motion", "methods": METHODS, "metrics": METRICS, "frames": "1-10", "times_of": None,
            "reference_spp": 512, "clock": "wall"}
OIDN_MISSING = "Open Image Denoise is not there: ./dev oidn fetches it"
# Two-sided 95 % quantiles of Student's t for 1, 2, ... degrees of freedom, and beyond 30.
T95 = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
       2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042]


class Method:
    """One entry of --methods."""

    def __init__(self, text):
        name, *settings = text.split(":")
        self.name, plus, denoiser = name.partition("+")
        if plus and denoiser != "oidn":
            sys.exit(f"quality: \"{denoiser}\" of the method {text} is no denoiser; known: oidn")
        self.label, self.denoises, self.clean = text, bool(plus), False
        self.wanted_spp, self.render, self.stage = None, [], []
        for setting in settings:
            key, equal, value = setting.partition("=")
            if not key or not equal or not value:
                sys.exit(f"quality: \"{setting}\" of the method {text} is not NAME=VALUE")
            if key == "spp":
                if not value.isdigit() or int(value) < 1:
                    sys.exit(f"quality: spp={value} of the method {text} is not a positive whole number")
                self.wanted_spp = int(value)
            elif key == "clean" and self.denoises:
                if value not in ("true", "false"):
                    sys.exit(f"quality: clean={value} of the method {text} is neither true nor false")
                self.clean = value == "true"
            elif key == "sampler":
                self.render += ["--sampler", value]
            elif "." in key:
                self.render += ["--set", setting]
            elif key in STAGE_KEYS and self.name in RECONSTRUCTED:
                self.stage += [f"--{key}"] if value == "true" else [f"--{key}", value]
            else:
                self.render += ["--param", f"{key}={value}"]


def execute(command, clock="wall", libraries=None):
    """Seconds of a command: on the wall, or of all processors. Ends the program with its messages if it fails.

    `libraries`: a folder whose shared libraries come before those of the system."""
    def now():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.monotonic() if clock == "wall" else usage.ru_utime + usage.ru_stime
    begin = now()
    environment = os.environ | ({"LD_LIBRARY_PATH": str(libraries)} if libraries else {})
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          env=environment)
    if done.returncode:
        sys.exit(f"quality: {' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}")
    return now() - begin


class Bench:
    """One scene, NAME[:VARIANT][@WxH] or FILE[@WxH], with its references."""

    def __init__(self, args, text):
        self.args = args
        self.tempera = args.build / "bin/tempera"
        scene, _, size = text.partition("@")
        self.size = args.resolution or size or None
        self.work = args.work / scene.replace("/", "_").replace(":", "_")
        self.common = ["--frames", args.frames]
        if self.size:
            self.common += ["--resolution", self.size]
        self.threads = ["--threads", args.threads] if args.threads else []
        if pathlib.Path(scene).suffix:
            self.shot = scene
        else:
            made = subprocess.run([self.tempera, "-q", "gallery", "make", scene.split(":")[0], "--gallery",
                                   args.work / "scenes"], stdout=subprocess.PIPE, text=True)
            if made.returncode:
                sys.exit(made.returncode)
            shot = pathlib.Path(made.stdout.split("\n")[0])
            variant = scene.partition(":")[2]
            self.shot = shot.with_name(f"{shot.stem}_{variant}.toml") if variant else shot
        self.references = [self.make_reference(name, seed) for name, seed in (("a", 1000003), ("b", 2000003))]
        self.noise, self.titles = {}, {}

    def render_reference(self, frames, spp, seed, pattern, resume):
        size = ["--resolution", self.size] if self.size else []
        execute([self.tempera, "-q", "render", self.shot, "--frames", frames, *size, *self.threads, "--spp", spp, "--seed",
                 seed, "--sampler", "sobol", "--integrator", "path", "--layers", "motion", "-o", pattern,
                 *(["--resume"] if resume else [])])

    def make_reference(self, name, seed):
        """Frames with motion vectors. Finished ones are kept, so that this can be interrupted.

        `tempera render --resume` knows by its fingerprint whether a frame is of this scene and these settings, and of this
        version of the program, but not whether its code has changed since: that shows in a quick rendering of one frame,
        which is kept beside them."""
        spp = max(1, self.args.reference_spp // 2)
        folder = self.work / f"reference_{spp}_{self.size or 'own'}_{name}"
        known = next(folder.glob("probe/f.*.exr"), folder / f"probe/f.{frames_of(self.args.frames)[0]:04}.exr")
        probe = folder / "probe_now" / known.name
        self.render_reference(known.name.split(".")[1], 1, seed, probe.parent / "f.####.exr", False)
        if known.exists() and not self.same_pixels(known, probe):
            print(f"reference {name}: the scene or the renderer has changed; rendering it again", flush=True)
            for old in folder.glob("f.*"):
                old.unlink()
        known.parent.mkdir(exist_ok=True)
        probe.replace(known)
        pattern = folder / "f.####.exr"
        print(f"reference {name}: {spp} samples, {pattern}", flush=True)
        self.render_reference(self.args.frames, spp, seed, pattern, True)
        return pattern

    def same_pixels(self, known, probe):
        """Whether two frames have the same color and motion vectors."""
        return all(subprocess.run([self.tempera, "-q", "compare", known, "--reference", probe, "--layer", layer,
                                   "--threshold", "mse=0", "--metrics", "mse"], capture_output=True).returncode == 0
                   for layer in ("color", "motion.backward"))

    def run(self, method, spp, seed, folder):
        """Renders (and reconstructs, and denoises) to `folder`. Returns its seconds."""
        shutil.rmtree(folder, ignore_errors=True)
        clock = self.args.clock
        steps = ["raw"] * (method.name in RECONSTRUCTED) + ["noisy"] * method.denoises + ["final"]
        layers = "color,albedo,normal" if method.denoises else "color"
        pattern = folder / steps.pop(0) / "f.####.exr"
        seconds = execute([self.tempera, "-q", "render", self.shot, *self.common, *self.threads, "--integrator", method.name,
                           "--spp", spp, "--seed", seed, *method.render, "--layers", layers, "-o", pattern], clock)

        def step(make_command, libraries=None):
            nonlocal pattern, seconds
            before, pattern = pattern, folder / steps.pop(0) / "f.####.exr"
            seconds += execute([*make_command(before, pattern), *self.threads], clock, libraries)
            shutil.rmtree(before.parent)
        if method.name in RECONSTRUCTED:
            step(lambda source, target: [self.tempera, "-q", "reconstruct", source, "-o", target, *method.stage])
        if method.denoises:
            library, clean = self.args.oidn, ["--clean"] if method.clean else []
            step(lambda source, target: [self.args.build / "bench/denoise", library, source, target, *clean], library.parent)
        return seconds

    def measure(self, folder, metrics):
        """{metric: mean over the frames} of the frames in `folder`, without the noise of the references."""
        out = self.work / "figures.json"
        a, b = self.references
        execute([self.tempera, "-q", "compare", f"m={folder / 'final/f.####.exr'}", "--reference", a, "--reference2", b,
                 "--metrics", ",".join(metrics), "--json", out])
        figures = json.loads(out.read_text())
        self.noise |= figures["reference_noise"]
        self.titles |= {m["id"]: m["title"] + (f" [{m['unit']}]" if m["unit"] else "") for m in figures["metrics"]}
        return figures["sides"][0]["mean"]

    def calibrate(self, method, target):
        """Samples that take `target` seconds within 5 %, or as near as whole samples get."""
        least = 2 if method.name == "temporal_gradient_path" else 1
        if any(s in ("adaptive=published", "adaptive=unbiased") for s in method.render):
            least *= 8  # two batches of four in each pass
        spp, best = max(4, least), None
        tried = {}
        for _ in range(8):
            if spp not in tried:
                tried[spp] = self.run(method, spp, 7, self.work / "calibration")
                print(f"  {method.label}: {spp} samples take {tried[spp]:.2f} s", flush=True)
            best = min(tried, key=lambda n: abs(tried[n] - target))
            if abs(tried[best] / target - 1) < 0.05:
                break
            if len(tried) == 1:
                spp = max(least, round(spp * target / tried[spp]))
                if spp in tried:
                    spp += 1
            else:  # a constant part and one for each sample, from the two that bracket the target best
                a, b = sorted(tried, key=lambda n: abs(math.log(tried[n] / target)))[:2]
                slope = (tried[a] - tried[b]) / (a - b)
                spp = max(least, round(a + (target - tried[a]) / slope)) if slope > 0 else max(tried) + 1
            if spp in tried:
                break
        return best, tried[best]

    def samples_for_error(self, method, metric, target):
        """Samples after which `metric` falls to `target` (within 5 %), and the time that they take."""
        spp, tried = 8, {}
        for _ in range(10):
            seconds = self.run(method, spp, 7, self.work / "calibration")
            error = self.measure(self.work / "calibration", [metric])[metric]
            tried[spp] = (error, seconds)
            print(f"  {method.label}: {spp} samples, {seconds:.2f} s: {metric} {error:.4g}", flush=True)
            if abs(error / target - 1) < 0.05:
                break
            slope = -1.0
            if len(tried) > 1:
                a, b = sorted(tried, key=lambda n: abs(math.log(tried[n][0] / target)))[:2]
                slope = math.log(tried[a][0] / tried[b][0]) / math.log(a / b)
                slope = min(-0.3, max(-3.0, slope))
            spp = max(2, round(spp * min(16.0, max(1 / 16, (target / error) ** (1 / slope)))))
            if spp in tried:
                break
        best = min(tried, key=lambda n: abs(math.log(tried[n][0] / target)))
        return best, *tried[best]


def t95(count):
    """Student's t of a mean of `count` values, two-sided, 95 %."""
    return T95[count - 2] if count - 2 < len(T95) else 1.96


def mean_interval(values):
    """(mean, half width of its 95 % confidence interval) of values, of which some may be None: left out. The half width
    is None for less than two, both for none."""
    present = [v for v in values if v is not None]
    if len(present) < 2:
        return (present[0] if present else None), None
    return statistics.fmean(present), t95(len(present)) * statistics.stdev(present) / math.sqrt(len(present))


def ratio_interval(values, base):
    """(ratio, low, high) of paired positive values: Student's t on their logarithms. Low and high None for one pair.

    Pairs with a value that is missing, or 0, are left out."""
    logs = [math.log(v / b) for v, b in zip(values, base) if v and b and v > 0 and b > 0]
    if not logs:
        return None, None, None
    mean = statistics.fmean(logs)
    if len(logs) < 2:
        return math.exp(mean), None, None
    half = t95(len(logs)) * statistics.stdev(logs) / math.sqrt(len(logs))
    return math.exp(mean), math.exp(mean - half), math.exp(mean + half)


def interval_text(ratio, low, high):
    if ratio is None:
        return "-"
    return f"{ratio:.3g}x of the first" + (f" [{low:.3g}, {high:.3g}]" if low is not None else "")


def equal_error(bench, methods, args):
    metric, _, value = args.equal_error.partition("=")
    try:
        target = float(value)
    except ValueError:
        sys.exit(f"quality: --equal-error wants METRIC=VALUE, not {args.equal_error}")
    results = []
    for m in methods:
        spp, error, seconds = bench.samples_for_error(m, metric, target)
        results.append({"method": m.label, "spp": spp, "seconds": seconds, metric: error})
    base = results[0]["seconds"]
    print(f"\n{'method':44} {'spp':>6} {'seconds':>9} {metric:>10}  time / first")
    for r in results:
        print(f"{r['method']:44} {r['spp']:6} {r['seconds']:9.2f} {r[metric]:10.4g}  {r['seconds'] / base:.3g}x")
    return results


def equal_time(bench, methods, args, samples=None):
    """Figures of all methods at equal time: that of `samples` of the first method, or args.time."""
    target = args.time
    for m in methods:
        m.spp, seconds = m.wanted_spp, None
        if samples and m is methods[0]:
            m.spp, target = samples, bench.run(m, samples, 7, bench.work / "calibration")
            print(f"  {m.label}: {samples} samples take {target:.2f} s, the time of all", flush=True)
        elif m.spp is None:
            m.spp, seconds = bench.calibrate(m, target)
            if abs(seconds / target - 1) > 0.05:
                print(f"  {m.label}: {m.spp} samples take {seconds:.2f} s, not {target:.2f} s: samples are whole numbers")
    results = []
    for m in methods:
        seconds, figures = [], []
        for seed in range(1, args.seeds + 1):
            folder = bench.work / f"{methods.index(m)}_{m.name}_{seed}"
            seconds.append(bench.run(m, m.spp, seed, folder))
            figures.append(bench.measure(folder, args.metrics))
            print(f"  {m.label}, seed {seed}: {seconds[-1]:.2f} s", flush=True)
        results.append({"method": m.label, "spp": m.spp, "seconds": seconds, "figures": figures})
    first = results[0]
    print(f"\n{'method':44} {'spp':>6} {'seconds':>9}")
    for r in results:
        print(f"{r['method']:44} {r['spp']:6} {statistics.fmean(r['seconds']):9.2f}")
        r["ratios"] = {}
        for metric in args.metrics:
            values = [f.get(metric) for f in r["figures"]]
            mean, half = mean_interval(values)
            if mean is None:
                continue
            ratio = (None, None, None)
            if metric not in SIGNED:
                ratio = ratio_interval(values, [f.get(metric) for f in first["figures"]])
            r["ratios"][metric] = ratio
            spread = f"± {half:.2g}" if half is not None else ""
            print(f"    {metric:20} {mean:10.4g} {spread:10} {interval_text(*ratio)}")
    for metric, noise in bench.noise.items():
        least = min((f[metric] for r in results for f in r["figures"] if f.get(metric) is not None), default=None)
        if metric in args.metrics and metric != "psnr" and least is not None and noise is not None and noise > least:
            print(f"{metric}: the references' noise, which was taken out, is {noise:.2g}; "
                  "more samples (--reference-spp) would make the figures surer")
    return results


def number(value, half=None):
    """A figure for people, with its error in as many digits as that allows."""
    if half is None:
        return f"{value:.3g}"
    digits = max(0, min(8, 1 - math.floor(math.log10(half)))) if half > 0 else 6
    return f"{value:.{digits}f} ± {half:.{digits}f}" if half < 100 else f"{value:.3g} ± {half:.2g}"


def markdown(bench, title, results, args):
    """A table: a line for each method, a column for each metric, ratios to the first in brackets."""
    def cell(r, metric):
        mean, half = mean_interval([f.get(metric) for f in r["figures"]])
        if mean is None:
            return "–"
        ratio = r["ratios"][metric][0]
        return number(mean, half) + (f" ({ratio:.2g})" if r is not results[0] and ratio else "")
    columns = ["samples", "seconds", *(bench.titles.get(m, m) for m in args.metrics)]
    lines = [f"| {title} | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    for r in results:
        cells = [str(r["spp"]), f"{statistics.fmean(r['seconds']):.1f}", *(cell(r, m) for m in args.metrics)]
        lines.append(f"| `{r['method']}` | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n\n"


def frames_of(text):
    """The frames of a set like 1-10 or 1-9x2,20."""
    frames = []
    for part in text.split(","):
        ends, _, step = part.replace(":", "x").partition("x")
        first, _, last = ends.replace("..", "-").partition("-")
        frames += range(int(first), int(last or first) + 1, int(step or 1))
    return frames


def main():
    parser = argparse.ArgumentParser(prog="./dev bench quality", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", metavar="FILE", help="all that docs/papers/manzi2016.md shows, as tables in this file")
    parser.add_argument("--scene", help="comma list: of the gallery, NAME or NAME:VARIANT, or scene files, each with @WxH "
                        "if it is to have that size [cornell-motion]")
    parser.add_argument("--methods", help=f"comma list, see above [{METHODS}]")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each method [3]")
    parser.add_argument("--frames", help="[1-10]")
    parser.add_argument("--resolution", help="WxH of all scenes [the scene's]")
    parser.add_argument("--time", type=float, default=30, help="seconds for all frames, of methods without spp [30]")
    parser.add_argument("--times-of", metavar="N,...",
                        help="the time of N samples of the first method, instead; a table each")
    parser.add_argument("--equal-error", metavar="METRIC=VALUE", help="find the time that each method needs for this error")
    parser.add_argument("--reference-spp", type=int, help="of both references together [512]")
    parser.add_argument("--metrics", help=f"as of tempera compare [{METRICS}]")
    parser.add_argument("--threads", help="[all]")
    parser.add_argument("--clock", choices=["wall", "cpu"],
                        help="what equal time is: of the clock, or of all processors, which a busy machine disturbs less")
    parser.add_argument("--markdown", metavar="FILE", help="append the figures as tables")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--work", type=pathlib.Path, default=ROOT / "build/quality", help="references and frames")
    parser.add_argument("--oidn", type=pathlib.Path, metavar="LIBRARY",
                        default=ROOT / "build/oidn/pyoidn/oidn/lib/libOpenImageDenoise.so", help="[what ./dev oidn fetches]")
    args = parser.parse_args()
    chosen = args.methods
    for name, value in (TABLES if args.tables else DEFAULTS).items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    if args.tables:
        args.markdown = args.tables
    args.scene, args.metrics = args.scene.split(","), args.metrics.split(",")
    methods = [Method(m) for m in args.methods.split(",") if m]
    if any(m.denoises for m in methods) and not args.oidn.exists():
        if chosen or args.tables:
            sys.exit(f"quality: {OIDN_MISSING}")
        print(f"{OIDN_MISSING}; its rows are left out")
        methods = [m for m in methods if not m.denoises]
    times = [int(n) if n.isdigit() else 0 for n in args.times_of.split(",")] if args.times_of else [None]
    if not methods or args.seeds < 1 or args.time <= 0 or 0 in times:
        parser.error("at least one method and one seed, and a positive time or positive numbers of samples")
    count = len(frames_of(args.frames))
    for metric, least in LEAST_FRAMES.items():
        if count < least and metric in args.metrics:
            print(f"{metric} is left out: it needs {least} frames, there are {count}")
            args.metrics.remove(metric)

    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE,
                            text=True).stdout.strip() or "unknown"
    path = args.build / "bench" / f"quality-{commit}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    for scene in args.scene:
        bench = Bench(args, scene)
        for samples in times:
            title = f"{scene.partition('@')[0]}, {bench.size or 'its own size'}, frames {args.frames}"
            if samples:
                title += f", time of {samples} samples"
            print(f"== {title}")
            results = equal_error(bench, methods, args) if args.equal_error else equal_time(bench, methods, args, samples)
            if args.markdown and not args.equal_error:
                with open(args.markdown, "a", encoding="utf-8") as out:
                    out.write(markdown(bench, title, results, args))
            stored = json.loads(path.read_text()) if path.exists() else []
            stored.append({"scene": scene, "frames": args.frames, "resolution": bench.size, "threads": args.threads,
                           "clock": args.clock, "reference_spp": args.reference_spp, "times_of": samples,
                           "noise": bench.noise, "equal_error": args.equal_error, "results": results})
            path.write_text(json.dumps(stored, indent=1))
        print(f"written: {path}")


if __name__ == "__main__":
    main()
