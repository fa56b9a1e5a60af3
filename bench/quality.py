#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Methods at equal time: error, temporal error and flicker of integrators on the scenes of the gallery.

Each method renders the same frames with several seeds; everything is compared with two references of independent seeds,
which are kept (build/quality). Their own noise is taken out of squared errors: M = (|x - a|^2 + |x - b|^2 - |a - b|^2) / 2.
The table shows each metric's mean over seeds and its ratio to the first method, with the 95 % confidence
interval of paired logarithms over the seeds (Student's t). Results go to <build>/bench/quality-<commit>.json.

A method is an integrator and settings, separated by colons: spp=N, sampler=NAME, parameters of the integrator, keys of
shot.toml with their table (film.filter=tent), and for the gradient-domain ones those of `tempera reconstruct` (norm,
alpha, window, ...), which is then part of their time. Methods without spp are calibrated to take --time seconds for all
frames, within 5 %.

  ./dev bench quality --scene cornell-motion --methods path:spp=16,path:spp=64
  ./dev bench quality --scene cornell-motion --methods path:spp=16:sampler=sobol,path:spp=64:sampler=sobol
  ./dev bench quality --scene running-figure --methods path,gradient_path,temporal_gradient_path --time 60
  ./dev bench quality --scene vase --methods path,path:sampler=independent --equal-error relmse=0.01

Four times the samples make a quarter of the squared error with sampler=independent, which is what cornell-motion is
rendered with. The error of the default sampler of other scenes (scrambled Sobol points) falls faster, so the second
example shows more than a factor of 4.
"""
import argparse
import json
import math
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
METRICS = ["relmse", "mse", "temporal", "flicker"]
# Means of squares of what differs: the noise of independent references adds to them.
SQUARED = {"relmse", "relmse_gray", "mse", "temporal", "temporal_compensated", "flicker", "flicker_tracked"}
# Two-sided 95 % quantiles of Student's t for 1, 2, ... degrees of freedom, and beyond 30.
T95 = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
       2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042]


class Method:
    """One entry of --methods."""

    def __init__(self, text):
        self.name, *settings = text.split(":")
        self.label = text
        self.wanted_spp, self.render, self.stage = None, [], []
        for setting in settings:
            key, equal, value = setting.partition("=")
            if not key or not equal or not value:
                sys.exit(f"quality: \"{setting}\" of the method {text} is not NAME=VALUE")
            if key == "spp":
                if not value.isdigit() or int(value) < 1:
                    sys.exit(f"quality: spp={value} of the method {text} is not a positive whole number")
                self.wanted_spp = int(value)
            elif key == "sampler":
                self.render += ["--sampler", value]
            elif "." in key:
                self.render += ["--set", setting]
            elif key in STAGE_KEYS and self.name in RECONSTRUCTED:
                self.stage += [f"--{key}"] if value == "true" else [f"--{key}", value]
            else:
                self.render += ["--param", f"{key}={value}"]


def execute(command, clock="wall"):
    """Seconds of a command: on the wall, or of all processors. Ends the program with its messages if it fails."""
    def now():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.monotonic() if clock == "wall" else usage.ru_utime + usage.ru_stime
    begin = now()
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"quality: {' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}")
    return now() - begin


class Bench:
    def __init__(self, args, scene):
        self.args = args
        self.tempera = args.build / "bin/tempera"
        self.scene = scene
        self.work = args.work / scene.replace("/", "_").replace(":", "_")
        self.common = ["--frames", args.frames]
        if args.resolution:
            self.common += ["--resolution", args.resolution]
        if args.threads:
            self.common += ["--threads", args.threads]
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
        metrics = list(args.metrics)
        if args.equal_error:
            metrics.append(args.equal_error.partition("=")[0])
        self.noise = self.figures_of(self.references[0], self.references[1], metrics)

    def make_reference(self, name, seed):
        """Frames with motion vectors. Finished ones are kept, so that this can be interrupted."""
        args = self.args
        spp = max(1, args.reference_spp // 2)
        pattern = self.work / f"reference_{spp}_{args.resolution or 'own'}_{name}" / "f.####.exr"
        print(f"reference {name}: {spp} samples, {pattern}", flush=True)
        execute([self.tempera, "-q", "render", self.shot, *self.common, "--spp", spp, "--seed", seed, "--sampler", "sobol",
                 "--integrator", "path", "--layers", "motion", "-o", pattern, "--resume"])
        return pattern

    def run(self, method, spp, seed, folder):
        """Renders (and reconstructs) to `folder`. Returns its seconds."""
        shutil.rmtree(folder, ignore_errors=True)
        raw = folder / ("raw" if method.name in RECONSTRUCTED else "final")
        seconds = execute([self.tempera, "-q", "render", self.shot, *self.common, "--integrator", method.name, "--spp", spp,
                           "--seed", seed, *method.render, "--layers", "color", "-o", raw / "f.####.exr"],
                          self.args.clock)
        if method.name in RECONSTRUCTED:
            threads = ["--threads", self.args.threads] if self.args.threads else []
            seconds += execute([self.tempera, "-q", "reconstruct", raw / "f.####.exr", "-o", folder / "final/f.####.exr",
                                *method.stage, *threads], self.args.clock)
            shutil.rmtree(raw)
        return seconds

    def figures_of(self, frames, reference, metrics):
        """{metric: mean over the frames} of a pattern."""
        out = self.work / "figures.json"
        execute([self.tempera, "-q", "compare", f"m={frames}", "--reference", reference, "--metrics", ",".join(metrics),
                 "--json", out])
        return json.loads(out.read_text())["sides"][0]["mean"]

    def measure(self, folder, metrics):
        """{metric: mean over the frames} of the frames in `folder`, without the noise of the references."""
        a, b = (self.figures_of(folder / "final/f.####.exr", r, metrics) for r in self.references)
        return {m: without_noise(m, a.get(m), b.get(m), self.noise.get(m)) for m in metrics}

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


def without_noise(metric, a, b, between):
    """A metric of frames against two references and of one against the other: what it would be against the truth, if it
    is the mean of a square; else the mean. None if one is missing."""
    if a is None or b is None or (metric in SQUARED and between is None):
        return None
    return (a + b - (between if metric in SQUARED else 0)) / 2


def ratio_interval(values, base):
    """(ratio, low, high) of paired positive values: Student's t on their logarithms. Low and high None for one pair.

    Pairs with a value that is missing, or 0, are left out."""
    logs = [math.log(v / b) for v, b in zip(values, base) if v and b and v > 0 and b > 0]
    if not logs:
        return None, None, None
    mean = statistics.fmean(logs)
    if len(logs) < 2:
        return math.exp(mean), None, None
    quantile = T95[len(logs) - 2] if len(logs) - 2 < len(T95) else 1.96
    half = quantile * statistics.stdev(logs) / math.sqrt(len(logs))
    return math.exp(mean), math.exp(mean - half), math.exp(mean + half)


def interval_text(ratio, low, high):
    if ratio is None:
        return "-"
    return f"{ratio:.3g}x" + (f" [{low:.3g}, {high:.3g}]" if low is not None else "")


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


def equal_time(bench, methods, args):
    for m in methods:
        m.seconds = None
        if m.spp is None:
            m.spp, m.seconds = bench.calibrate(m, args.time)
            if abs(m.seconds / args.time - 1) > 0.05:
                print(f"  {m.label}: {m.spp} samples take {m.seconds:.2f} s, not {args.time:g} s: samples are whole numbers")
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
            present = [v for v in values if v is not None]
            if not present:
                continue
            ratio = ratio_interval(values, [f.get(metric) for f in first["figures"]])
            r["ratios"][metric] = ratio
            print(f"    {metric:20} {statistics.fmean(present):10.4g}   {interval_text(*ratio)} of the first")
    for metric in SQUARED.intersection(args.metrics):
        least = min((f[metric] for r in results for f in r["figures"] if f.get(metric) is not None), default=None)
        if least is not None and bench.noise.get(metric, 0) > 4 * least:
            print(f"{metric}: the references' noise, which was taken out, is {bench.noise[metric] / 2:.2g}; "
                  "more samples (--reference-spp) would make the figures surer")
    return results


def markdown(scene, results, args):
    """A table: a line for each metric, a column for each method, ratios to the first in brackets."""
    def cell(r, metric):
        present = [f[metric] for f in r["figures"] if f.get(metric) is not None]
        if not present:
            return "–"
        ratio = r["ratios"][metric][0]
        return f"{statistics.fmean(present):.3g}" + (f" ({ratio:.2f})" if r is not results[0] and ratio else "")
    lines = [f"| {scene} | " + " | ".join(f"`{r['method']}`" for r in results) + " |", "| --- " * (len(results) + 1) + "|",
             "| samples, seconds | " + " | ".join(f"{r['spp']}, {statistics.fmean(r['seconds']):.1f}" for r in results) + " |"]
    lines += [f"| {m} | " + " | ".join(cell(r, m) for r in results) + " |" for m in args.metrics]
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
    parser.add_argument("--scene", default=["cornell-motion"], type=lambda s: s.split(","),
                        help="comma list: of the gallery, NAME or NAME:VARIANT, or scene files")
    parser.add_argument("--methods", default="path,gradient_path,temporal_gradient_path", help="comma list, see above")
    parser.add_argument("--seeds", type=int, default=4, help="runs of each method [4]")
    parser.add_argument("--frames", default="1-10", help="[1-10]")
    parser.add_argument("--resolution", help="WxH [the scene's]")
    parser.add_argument("--time", type=float, default=30, help="seconds for all frames, of methods without spp [30]")
    parser.add_argument("--equal-error", metavar="METRIC=VALUE", help="find the time that each method needs for this error")
    parser.add_argument("--reference-spp", type=int, default=512, help="of both references together [512]")
    parser.add_argument("--metrics", default=",".join(METRICS), type=lambda s: s.split(","), help="as of tempera compare")
    parser.add_argument("--threads", help="[all]")
    parser.add_argument("--clock", default="wall", choices=["wall", "cpu"],
                        help="what equal time is: of the clock, or of all processors, which a busy machine disturbs less")
    parser.add_argument("--markdown", metavar="FILE", help="append the figures as tables")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--work", type=pathlib.Path, default=ROOT / "build/quality", help="references and frames")
    args = parser.parse_args()
    methods = [Method(m) for m in args.methods.split(",") if m]
    if not methods or args.seeds < 1 or args.time <= 0:
        parser.error("at least one method and one seed, and a positive time")
    count = len(frames_of(args.frames))
    for metric, least in (("temporal", 2), ("flicker", 8)):  # what tempera compare needs to measure them
        if count < least and metric in args.metrics:
            print(f"{metric} is left out: it needs {least} frames, there are {count}")
            args.metrics.remove(metric)

    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE,
                            text=True).stdout.strip() or "unknown"
    path = args.build / "bench" / f"quality-{commit}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    for scene in args.scene:
        print(f"== {scene}")
        bench = Bench(args, scene)
        for m in methods:
            m.spp = m.wanted_spp
        results = (equal_error if args.equal_error else equal_time)(bench, methods, args)
        if args.markdown and not args.equal_error:
            with open(args.markdown, "a", encoding="utf-8") as out:
                out.write(markdown(scene, results, args))
        stored = json.loads(path.read_text()) if path.exists() else []
        stored.append({"scene": scene, "frames": args.frames, "resolution": args.resolution, "threads": args.threads,
                       "clock": args.clock, "reference_spp": args.reference_spp,
                       "noise": bench.noise, "equal_error": args.equal_error, "results": results})
        path.write_text(json.dumps(stored, indent=1))
        print(f"written: {path}")


if __name__ == "__main__":
    main()
