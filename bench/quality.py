#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Methods at equal time: error, temporal error and flicker of what they make of the scenes of the gallery.

Each method makes the same frames with several seeds; everything is compared with two references of independent seeds,
whose own noise `tempera compare` takes out of squared metrics. References are kept (build/quality) while a quick
rendering of some of their frames has the same pixels. Tables show each metric's mean over seeds with the half width of
its 95 % confidence interval (Student's t), and its ratio to the first method; on the screen, ratios have the interval of
paired logarithms over the seeds. Results go to <build>/bench/quality-<commit>.json.

A method is a chain of steps joined by +, each with its settings after it, separated by colons:

  INTEGRATOR  renders. Settings: spp=N, sampler=NAME, decompose=TREE, parameters of the integrator, and keys of shot.toml
              with their table (film.filter=tent).
  run         renders, and does what follows in the shot itself. Settings: spp=N and keys of shot.toml (quality=final).
  STAGE       a stage of `tempera run`, with its parameters (denoise:method=oidn:recipe=single). The stages are the
              shot's `stages`: the first is given the layers that it can use. Gradients are always reconstructed:
              +reconstruct need only be named for its settings.
  oidn        last: Open Image Denoise (fetched by ./dev oidn) on each frame, from color, albedo and normal; with
              clean=true, albedo and normal are denoised first.

The time of a method is that of all of its steps: decompositions, features, files and starting programs are in it. The
frames are taken to be all of the shot: stages that look at frames around those see none beyond the first and the last,
and none are rendered for them, so that there is nothing to divide. (That costs the first and last frames of stages
quality; frames further in a shot are better.) Scenes of the gallery are rendered without the light-path classes and
layers that their shots ask for, shot files as they are.

Methods without spp are calibrated to take the same time for all frames, within 5 %: --time seconds, or with --times-of
the time of so many samples of the first method. Samples are whole numbers: where one more would take longer than that,
a method has less time. One that takes over 5 % more than that with its least samples is refused: it has no figures, and
the program ends with status 1.

Metrics are those of tempera compare; NAME_trimmed is without the 0.1 % of the pixels with the largest errors,
NAME@LAYER=VALUE only of the pixels with this value in the reference's layer (relmse@object_id=9).

  ./dev bench quality --scene cornell-motion --methods path:spp=16,path:spp=64
  ./dev bench quality --scene cornell-motion --methods path:spp=16:sampler=sobol,path:spp=64:sampler=sobol
  ./dev bench quality --scene running-figure --methods path,path+oidn,temporal_gradient_path --times-of 8,40
  ./dev bench quality --scene robot@192x108 --times-of 8 --clock cpu --metrics relmse_trimmed,relmse@object_id=9 \
    --methods path+oidn,path:decompose=default+denoise:method=oidn,run:quality=final
  ./dev bench quality --scene vase --methods path,path:sampler=independent --equal-error relmse=0.01
  ./dev bench quality --denoise final.md      the table of docs/denoising.md, of frames that are denoised
  ./dev bench quality --consistency           whether what is denoised becomes the truth with many samples
  ./dev bench quality --tables tables.md      the tables of docs/papers/manzi2016.md; other arguments replace parts

Four times the samples make a quarter of the squared error with sampler=independent, which is what cornell-motion is
rendered with. The error of the default sampler of other scenes (scrambled Sobol points) falls faster, so the second
example shows more than a factor of 4.
"""
import argparse
import dataclasses
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
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECONSTRUCTED = {"gradient_path", "temporal_gradient_path"}
# Tables of the gallery's shots that ask for more than the picture.
EXTRAS = {"classes", "decompose", "output"}
TRIMMED = 0.1  # % of the pixels that NAME_trimmed leaves out
TOLERANCE = 1.05  # what a method may take of the time of all
METHODS = "path,path+oidn,gradient_path,temporal_gradient_path"
METRICS = "flicker_display,relmse,mse,temporal,flicker"
# Frames in a row that tempera compare needs for a metric.
LEAST_FRAMES = {"temporal": 2, "temporal_compensated": 2, "flicker_display": 8, "flicker": 8, "flicker_tracked": 8}
SIGNED = {"bias"}  # their ratios say nothing
# What --tables, --denoise and --consistency stand for.
PRESETS = {
    "tables": {
        "scene": "running-figure@240x135,cornell-motion@160x160,modern-hall@240x135,glass-egg@240x135",
        "methods": "path:sampler=sobol,path:sampler=independent,path:sampler=sobol+oidn,"
                   "path:sampler=sobol+oidn:clean=true,temporal_gradient_path,temporal_gradient_path+oidn:clean=true",
        "metrics": "flicker_display,relmse,temporal_compensated,flicker,flicker_tracked,bias",
        "times_of": "8,40",
        "reference_spp": 2048,
        "clock": "cpu",
    },
    "denoise": {
        "scene": "running-figure@240x135,modern-hall@240x135,robot@192x108,vase@192x108,glass-egg@240x135",
        "methods": "path+oidn,path,path+oidn:clean=true,path+denoise:method=nl_means,path+denoise:method=oidn,"
                   "temporal_gradient_path+oidn:clean=true,run:quality=final",
        "metrics": "relmse,relmse_trimmed,temporal_compensated,flip,flicker_display",
        "times_of": "8,32,128",
        "reference_spp": 1536,
        "clock": "cpu",
        "exposure": "shot",
    },
    "consistency": {
        "scene": ",".join(f"{name}@96x54" for name in ("running-figure", "modern-hall", "robot", "vase", "glass-egg",
                                                       "cornell-motion")),
        "methods": "path:spp=1024,path:spp=1024+denoise:method=nl_means,path:spp=1024+denoise:method=oidn",
        "metrics": "relmse_trimmed",
        "frames": "1-5",
        "seeds": 1,
        "reference_spp": 8192,
        "clock": "cpu",
        "bound": "relmse_trimmed=1.1",
    },
}
# Metrics of --denoise that only a scene has: the pane of the robot's picture.
SCENE_METRICS = {"robot": ["relmse@object_id=9"]}
DEFAULTS = {"scene": "cornell-motion", "methods": METHODS, "metrics": METRICS, "frames": "1-10", "times_of": None,
            "seeds": 3, "reference_spp": 512, "clock": "wall", "bound": None, "exposure": "0"}
OIDN_MISSING = "Open Image Denoise is not there: ./dev oidn fetches it"
# Two-sided 95 % quantiles of Student's t for 1, 2, ... degrees of freedom, and beyond 30.
T95 = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
       2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042]


def settings_of(step, method):
    """(name, [(key, value)]) of one step of a method."""
    name, *settings = step.split(":")
    pairs = []
    for setting in settings:
        key, equal, value = setting.partition("=")
        if not key or not equal or not value:
            sys.exit(f"quality: \"{setting}\" of the method {method} is not NAME=VALUE")
        pairs.append((key, value))
    return name, pairs


class Method:
    """One entry of --methods. `arguments`: of tempera run."""

    def __init__(self, text):
        render, *steps = text.split("+")
        self.label, self.wanted_spp, self.arguments = text, None, []
        self.oidn, self.clean = False, False
        self.name, settings = settings_of(render, text)
        own = self.name == "run"
        for key, value in settings:
            if key == "spp":
                if not value.isdigit() or int(value) < 1:
                    sys.exit(f"quality: spp={value} of the method {text} is not a positive whole number")
                self.wanted_spp = int(value)
            elif not own and key in ("sampler", "decompose"):
                self.arguments += [f"--{key}", value]
            elif own or "." in key:
                self.arguments += ["--set", f"{key}={value}"]
            else:
                self.arguments += ["--param", f"{key}={value}"]
        self.stages = []
        for i, step in enumerate(steps):
            stage, settings = settings_of(step, text)
            if not stage:
                sys.exit(f"quality: a step of the method {text} has no name")
            if stage == "oidn":
                if i + 1 < len(steps):
                    sys.exit(f"quality: oidn is not the last step of the method {text}; "
                             "denoise:method=oidn is the stage that others can follow")
                self.oidn = True
                for key, value in settings:
                    if key != "clean" or value not in ("true", "false"):
                        sys.exit(f"quality: {key}={value} of the method {text} is none of clean=true and clean=false; "
                                 "settings of the render stand after its name")
                    self.clean = value == "true"
                continue
            self.stages.append(stage)
            for key, value in settings:
                self.arguments += ["--set", f"{stage}.{key.replace('-', '_')}={value}"]
        if self.name in RECONSTRUCTED and "reconstruct" not in self.stages:
            self.stages.insert(0, "reconstruct")
        if not own:
            self.arguments += ["--integrator", self.name]
        if self.stages or not own:
            self.arguments += ["--set", "stages=[" + ",".join(f'"{s}"' for s in self.stages) + "]"]
        if self.oidn or not own:
            self.arguments += ["--layers", "color,albedo,normal" if self.oidn else "color"]
        self.needs_oidn = self.oidn or "denoise.method=oidn" in self.arguments

    def least_spp(self):
        least = 2 if self.name == "temporal_gradient_path" or "denoise" in self.stages else 1  # halves of the samples
        if any(a in ("adaptive=published", "adaptive=unbiased") for a in self.arguments):
            least *= 8  # two batches of four in each pass
        return least


def execute(command, clock="wall", oidn=None):
    """Seconds of a command: on the wall, or of all processors. Ends the program with its messages if it fails.

    `oidn`: the library that it may load."""
    def now():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.monotonic() if clock == "wall" else usage.ru_utime + usage.ru_stime
    begin = now()
    environment = dict(os.environ)
    if oidn and oidn.exists():
        environment |= {"TEMPERA_OIDN": str(oidn), "LD_LIBRARY_PATH": str(oidn.parent)}
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          env=environment)
    if done.returncode:
        sys.exit(f"quality: {' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}")
    return now() - begin


def plain_shot(shot):
    """A shot of the gallery without its light-path classes and layers, which would cost every method time; a file beside
    it."""
    lines, kept = [], True
    for line in shot.read_text(encoding="utf-8").splitlines(keepends=True):
        if line.startswith("["):
            kept = line.strip().strip("[]") not in EXTRAS
        if kept:
            lines.append(line)
    plain = shot.with_name(f"{shot.stem}_plain.toml")
    plain.write_text("".join(lines), encoding="utf-8")
    return plain


def exposure_of(shot):
    """The stops that the movie of a shot is exposed by."""
    shot = pathlib.Path(shot)
    if shot.suffix != ".toml":
        return 0
    return tomllib.loads(shot.read_text(encoding="utf-8")).get("video", {}).get("exposure", 0)


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
            self.shot = plain_shot(shot.with_name(f"{shot.stem}_{variant}.toml") if variant else shot)
        self.exposure = exposure_of(self.shot) if args.exposure == "shot" else args.exposure
        self.references = [self.make_reference(name, seed) for name, seed in (("a", 1000003), ("b", 2000003))]
        self.metrics = args.metrics + (SCENE_METRICS.get(scene, []) if args.denoise else [])
        self.noise, self.titles = {}, {}
        self.seconds_of = {}  # {label of a method: {samples: seconds}}, as far as they were tried

    def render_reference(self, frames, spp, seed, pattern):
        size = ["--resolution", self.size] if self.size else []
        execute([self.tempera, "-q", "render", self.shot, "--frames", ",".join(map(str, frames)), *size, *self.threads,
                 "--spp", spp, "--seed", seed, "--sampler", "sobol", "--integrator", "path", "--layers",
                 "motion,object_id", "-o", pattern])

    def make_reference(self, name, seed):
        """Frames with motion vectors and object ids. Finished ones are kept, so that this can be interrupted, and while
        a quick rendering of a few, kept beside them, comes out as it did: it shows whether the scene or the renderer has
        changed. (The fingerprint in the files would also change with settings that change no pixel.)"""
        spp = max(1, self.args.reference_spp // 2)
        folder = self.work / f"reference_{spp}_{self.size or 'own'}_{name}"
        frames = frames_of(self.args.frames)
        known = {int(f.name.split(".")[1]) for f in folder.glob("probe/f.*.exr")} or {frames[0], frames[-1]}
        now = folder / "probe_now"
        self.render_reference(sorted(known), 1, seed, now / "f.####.exr")
        probes = [(folder / "probe" / probe.name, probe) for probe in sorted(now.glob("f.*.exr"))]
        if any(old.exists() and not self.same_pixels(old, new) for old, new in probes):
            print(f"reference {name}: the scene or the renderer has changed; rendering it again", flush=True)
            for old in folder.glob("f.*"):
                old.unlink()
        for old, new in probes:
            old.parent.mkdir(exist_ok=True)
            new.replace(old)
        pattern = folder / "f.####.exr"
        print(f"reference {name}: {spp} samples, {pattern}", flush=True)
        missing = [f for f in frames if not (folder / f"f.{f:04}.exr").exists()]
        if missing:
            self.render_reference(missing, spp, seed, pattern)
        return pattern

    def same_pixels(self, known, probe):
        """Whether two frames have the same color and motion vectors."""
        return all(subprocess.run([self.tempera, "-q", "compare", known, "--reference", probe, "--layer", layer,
                                   "--threshold", "mse=0", "--metrics", "mse"], capture_output=True).returncode == 0
                   for layer in ("color", "motion.backward"))

    def run(self, method, spp, seed, folder):
        """Makes the frames of a method in folder/final. Returns its seconds."""
        shutil.rmtree(folder, ignore_errors=True)
        clock, oidn = self.args.clock, self.args.oidn
        made = folder / "made"
        seconds = execute([self.tempera, "-q", "run", self.shot, *self.common, *self.threads, *method.arguments, "--halo",
                           0, "--no-video", "--spp", spp, "--seed", seed, "-o", made / "f.####.exr"], clock, oidn)
        if (made / "final").exists():
            made = made / "final"
        if method.oidn:
            seconds += execute([self.args.build / "bench/denoise", oidn, made / "f.####.exr",
                                folder / "final/f.####.exr", *(["--clean"] if method.clean else []), *self.threads],
                               clock, oidn)
        else:
            made.rename(folder / "final")
        shutil.rmtree(folder / "made", ignore_errors=True)
        self.seconds_of.setdefault(method.label, {})[spp] = seconds
        return seconds

    def measure(self, folder, metrics):
        """{metric: mean over the frames} of the frames in `folder`, without the noise of the references."""
        groups = {}  # {arguments of tempera compare: {what it measures: name here}}
        for metric in metrics:
            name, _, region = metric.partition("@")
            plain = name.removesuffix("_trimmed")
            arguments = (("--where", region) if region else ()) + (("--trim", TRIMMED) if plain != name else ())
            groups.setdefault(arguments, {})[plain] = metric
        values = {}
        for arguments, names in groups.items():
            out = self.work / "figures.json"
            a, b = self.references
            execute([self.tempera, "-q", "compare", f"m={folder / 'final/f.####.exr'}", "--reference", a, "--reference2", b,
                     "--metrics", ",".join(names), "--exposure", self.exposure, "--json", out, *arguments,
                     *self.threads])
            figures = json.loads(out.read_text())
            for m in figures["metrics"]:
                name = names[m["id"]]
                values[name] = figures["sides"][0]["mean"][m["id"]]
                self.noise[name] = figures["reference_noise"].get(m["id"])
                self.titles[name] = title_of(name, m["title"], m["unit"])
        return values

    def calibrate(self, method, target, folder, start=4):
        """Samples that take `target` seconds within 5 %, or as near below that as whole samples get, and their seconds;
        the least samples where these take longer. What was made with them is in `folder`. `start`: samples to try first,
        where nothing else is known."""
        least = method.least_spp()
        tried, present = self.seconds_of.setdefault(method.label, {}), None
        now = {}  # at this target

        def guess():
            """A constant part and one for each sample, from the two that were tried next to the target."""
            near = sorted(tried, key=lambda n: abs(math.log(tried[n] / target)))[:2]
            if not near:
                return max(start, least)
            if len(near) == 1:
                return max(least, round(near[0] * target / tried[near[0]]))
            slope = (tried[near[0]] - tried[near[1]]) / (near[0] - near[1])
            spp = near[0] + (target - tried[near[0]]) / slope if slope > 0 else max(tried) + 1
            return max(least, min(round(spp), 4 * max(tried)))
        spp = guess()
        for _ in range(8):
            now[spp] = self.run(method, spp, 1, folder)
            present = spp
            print(f"  {method.label}: {spp} samples take {now[spp]:.2f} s", flush=True)
            if abs(now[spp] / target - 1) < TOLERANCE - 1:
                break
            below = [n for n in now if now[n] <= TOLERANCE * target]
            above = [n for n in now if n not in below]
            spp = guess()
            if above and not below:
                spp = min(spp, min(above) - 1)
            elif below and not above:
                spp = max(spp, max(below) + 1)
            elif below:
                if max(below) + 1 >= min(above):
                    break
                spp = min(max(spp, max(below) + 1), min(above) - 1)
            if spp < least:
                if least in now:
                    break
                spp = least
        fitting = [n for n in now if now[n] <= TOLERANCE * target]
        best = max(fitting, default=min(now))
        if best != present:
            now[best] = self.run(method, best, 1, folder)
        return best, now[best]

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


def title_of(metric, title, unit):
    """The heading of a metric's column, from its title and unit in tempera compare."""
    name, _, region = metric.partition("@")
    if name.endswith("_trimmed"):
        title += f" without the worst {TRIMMED:g} %"
    if region:
        title += " where " + region.replace("=", " = ")
    return title + (f" [{unit}]" if unit else "")


@dataclasses.dataclass
class Timed:
    """A method with as many samples as fit into the time of all."""
    method: Method
    folder: pathlib.Path
    spp: int
    calibrated: bool  # whether it has to keep to that time
    seconds: list  # of the runs of each seed, which are in folder/<seed>
    over: float = 0  # part of the time of all that it takes more

    @property
    def refused(self):
        return self.calibrated and self.over > TOLERANCE - 1


def timed_runs(bench, methods, args, samples):
    """Runs the methods with all seeds, at the time of `samples` of the first one, or of args.time. Seeds are run in turn
    for all methods, so that what else the machine does slows them alike."""
    def run(t, seed):
        t.seconds.append(bench.run(t.method, t.spp, seed, t.folder / str(seed)))
        print(f"  {t.method.label}, seed {seed}: {t.spp} samples, {t.seconds[-1]:.2f} s", flush=True)

    def compare(t):
        t.over = statistics.fmean(t.seconds) / target - 1

    target, all_timed = args.time, []
    for i, m in enumerate(methods):
        is_base = samples is not None and i == 0
        calibrated = not is_base and m.wanted_spp is None
        t = Timed(m, bench.work / f"{i}_{m.name}", samples if is_base else m.wanted_spp, calibrated, [])
        all_timed.append(t)
        if calibrated:
            t.spp, seconds = bench.calibrate(m, target, t.folder / "1", start=samples * 2 // 3 if samples else 4)
            t.seconds = [seconds]
            compare(t)
        else:
            run(t, 1)
        if is_base:
            target = t.seconds[0]
    for seed in range(2, args.seeds + 1):
        for t in all_timed:
            if not t.refused:
                run(t, seed)
    if samples:
        target = statistics.fmean(all_timed[0].seconds)
        print(f"  {methods[0].label}: {samples} samples take {target:.2f} s, the time of all", flush=True)
    for t in all_timed:
        compare(t)
        while t.refused and t.spp > t.method.least_spp():  # the seed that was calibrated was a quick one
            t.spp, t.seconds = max(t.method.least_spp(), min(t.spp - 1, int(t.spp / (1 + t.over)))), []
            for seed in range(1, args.seeds + 1):
                run(t, seed)
            compare(t)
    return all_timed


def equal_time(bench, methods, args, samples=None):
    """Figures of all methods at equal time: that of `samples` of the first method, or args.time."""
    results = []
    for t in timed_runs(bench, methods, args, samples):
        figures = [] if t.refused else [bench.measure(t.folder / str(s), bench.metrics) for s in range(1, args.seeds + 1)]
        shutil.rmtree(t.folder, ignore_errors=True)
        results.append({"method": t.method.label, "spp": t.spp, "seconds": t.seconds, "figures": figures, "over": t.over,
                        "refused": t.refused})
    first = results[0]
    print(f"\n{'method':44} {'spp':>6} {'seconds':>9}")
    for r in results:
        print(f"{r['method']:44} {r['spp']:6} {statistics.fmean(r['seconds']):9.2f}"
              + ("  refused: over the time" if r["refused"] else ""))
        r["ratios"] = {}
        for metric in bench.metrics:
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
        if metric != "psnr" and least is not None and noise is not None and noise > least:
            print(f"{metric}: the references' noise, which was taken out, is {noise:.2g}; "
                  "more samples (--reference-spp) would make the figures surer")
    return results


def beyond(results, bounds):
    """What passes the bounds {metric: largest ratio to the first method}, a sentence each."""
    return [f"{metric} of {r['method']} is {r['ratios'][metric][0]:.3g} of that of {results[0]['method']}, over {bound:g}"
            for r in results[1:] for metric, bound in bounds.items()
            if r["ratios"].get(metric, (None,))[0] is not None and not r["ratios"][metric][0] <= bound]


def number(value, half=None):
    """A figure for people, with its error in as many digits as that allows."""
    if half is None:
        return f"{value:.3g}"
    digits = max(0, min(8, 1 - math.floor(math.log10(half)))) if half > 0 else 6
    return f"{value:.{digits}f} ± {half:.{digits}f}" if half < 100 else f"{value:.3g} ± {half:.2g}"


def row(bench, r, results, metrics):
    """The cells of a method: samples, seconds and metrics, with ratios to the first method in brackets."""
    def cell(metric):
        mean, half = mean_interval([f.get(metric) for f in r["figures"]])
        if mean is None:
            return "–"
        ratio = r["ratios"][metric][0]
        return number(mean, half) + (f" ({ratio:.2g})" if r is not results[0] and ratio else "")
    took = f"{statistics.fmean(r['seconds']):.1f}" + (f", {100 * r['over']:.0f} % over: refused" if r["refused"] else "")
    return [f"`{r['method']}`", str(r["spp"]), took, *(cell(m) for m in metrics)]


def table(*lines):
    """Lines of a table in Markdown."""
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def markdown(bench, title, results):
    """A table: a line for each method, a column for each metric."""
    columns = [title, "samples", "seconds", *(bench.titles.get(m, m) for m in bench.metrics)]
    return table(columns, ["---"] * len(columns), *(row(bench, r, results, bench.metrics) for r in results)) + "\n"


def lines_of_all(bench, scene, samples, results, metrics, path):
    """Adds lines to the one table of several scenes, which they begin if the file has none."""
    def heading(metric):
        plain = metric.partition("@")[0].removesuffix("_trimmed")
        return bench.titles.get(metric) or title_of(metric, bench.titles.get(plain, plain), "")
    columns = ["scene", "time of", "method", "samples", "seconds", *map(heading, metrics)]
    lines = [[scene, str(samples or "–"), *row(bench, r, results, metrics)] for r in results]
    if not path.exists() or not path.stat().st_size:
        lines = [columns, ["---"] * len(columns), *lines]
    with open(path, "a", encoding="utf-8") as out:
        out.write(table(*lines))


def scene_name(scene):
    """A short name of a scene: its file's folder where the file is called shot.toml."""
    name = scene.partition("@")[0]
    path = pathlib.Path(name)
    return (path.parent.name if path.stem == "shot" else path.stem) if path.suffix else name


def frames_of(text):
    """The frames of a set like 1-10 or 1-9x2,20."""
    frames = []
    for part in text.split(","):
        ends, _, step = part.replace(":", "x").partition("x")
        first, _, last = ends.replace("..", "-").partition("-")
        frames += range(int(first), int(last or first) + 1, int(step or 1))
    return frames


def bounds_of(text):
    """{metric: ratio} of "relmse=0.6,flip=0.85"."""
    bounds = {}
    for part in text.split(",") if text else ():
        metric, _, value = part.rpartition("=")
        try:
            bounds[metric] = float(value)
        except ValueError:
            sys.exit(f"quality: --bound wants METRIC=RATIO, not {part}")
    return bounds


def main():
    parser = argparse.ArgumentParser(prog="./dev bench quality", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    preset = parser.add_mutually_exclusive_group()
    preset.add_argument("--tables", metavar="FILE", help="all that docs/papers/manzi2016.md shows, as tables in this file")
    preset.add_argument("--denoise", metavar="FILE", nargs="?", const="-",
                        help="denoised frames of five scenes at three times, as one table in this file")
    preset.add_argument("--consistency", metavar="FILE", nargs="?", const="-",
                        help="1024 samples, denoised and not, of six small scenes: ends with status 6 if the error of "
                        "denoised ones is over 1.1 of that of the mean")
    parser.add_argument("--scene", help="comma list: of the gallery, NAME or NAME:VARIANT, or scene files, each with @WxH "
                        "if it is to have that size [cornell-motion]")
    parser.add_argument("--shot", metavar="FILE[@WxH]", action="append", default=[],
                        help="one more scene, e.g. of --denoise")
    parser.add_argument("--methods", help=f"comma list, see above [{METHODS}]")
    parser.add_argument("--seeds", type=int, help="runs of each method [3]")
    parser.add_argument("--frames", help="[1-10]")
    parser.add_argument("--resolution", help="WxH of all scenes [the scene's]")
    parser.add_argument("--time", type=float, default=30, help="seconds for all frames, of methods without spp [30]")
    parser.add_argument("--times-of", metavar="N,...",
                        help="the time of N samples of the first method, instead; a table each")
    parser.add_argument("--equal-error", metavar="METRIC=VALUE", help="find the time that each method needs for this error")
    parser.add_argument("--bound", metavar="METRIC=RATIO,...",
                        help="end with status 6 if a method is above this ratio to the first one")
    parser.add_argument("--reference-spp", type=int, help="of both references together [512]")
    parser.add_argument("--metrics", help=f"see above [{METRICS}]")
    parser.add_argument("--exposure", metavar="STOPS|shot",
                        help="of metrics of displayed pictures; shot: its video.exposure [0, shot for --denoise]")
    parser.add_argument("--threads", help="[all]")
    parser.add_argument("--clock", choices=["wall", "cpu"],
                        help="what equal time is: of the clock, or of all processors, which a busy machine disturbs less")
    parser.add_argument("--markdown", metavar="FILE", help="append the figures as tables")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--work", type=pathlib.Path, default=ROOT / "build/quality", help="references and frames")
    fetched = ROOT / "build/oidn/pyoidn/oidn/lib/libOpenImageDenoise.so"
    parser.add_argument("--oidn", type=pathlib.Path, metavar="LIBRARY", default=os.environ.get("TEMPERA_OIDN") or fetched,
                        help="[TEMPERA_OIDN, else what ./dev oidn fetches]")
    args = parser.parse_args()
    chosen = args.methods
    name = next((name for name in PRESETS if getattr(args, name)), None)
    for key, value in {**DEFAULTS, **PRESETS.get(name, {})}.items():
        if getattr(args, key) is None:
            setattr(args, key, value)
    if args.tables:
        args.markdown = args.tables
    one = next((f for f in (args.denoise, args.consistency) if f), None)
    one_table = pathlib.Path(one) if one and one != "-" else None
    args.scene, args.metrics = args.scene.split(",") + args.shot, args.metrics.split(",")
    bounds = bounds_of(args.bound)
    if args.exposure != "shot":
        try:
            args.exposure = float(args.exposure)
        except ValueError:
            parser.error(f"--exposure is shot or a number of stops, not {args.exposure}")
    methods = [Method(m) for m in args.methods.split(",") if m]
    if any(m.needs_oidn for m in methods) and not args.oidn.exists():
        if chosen or name:
            sys.exit(f"quality: {OIDN_MISSING}")
        print(f"{OIDN_MISSING}; its rows are left out")
        methods = [m for m in methods if not m.needs_oidn]
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
    columns = args.metrics + ([m for ms in SCENE_METRICS.values() for m in ms] if args.denoise else [])
    refused, passed = [], []
    for scene in args.scene:
        bench = Bench(args, scene)
        for samples in times:
            title = f"{scene.partition('@')[0]}, {bench.size or 'its own size'}, frames {args.frames}"
            if samples:
                title += f", time of {samples} samples"
            print(f"== {title}")
            results = equal_error(bench, methods, args) if args.equal_error else equal_time(bench, methods, args, samples)
            if not args.equal_error:
                refused += [f"{r['method']} takes {100 * r['over']:.0f} % longer ({title})"
                            for r in results if r["refused"]]
                passed += [f"{text} ({title})" for text in beyond(results, bounds)]
                if args.markdown:
                    with open(args.markdown, "a", encoding="utf-8") as out:
                        out.write(markdown(bench, title, results))
                if one_table:
                    lines_of_all(bench, scene_name(scene), samples, results, columns, one_table)
            stored = json.loads(path.read_text()) if path.exists() else []
            stored.append({"scene": scene, "frames": args.frames, "resolution": bench.size, "threads": args.threads,
                           "clock": args.clock, "exposure": bench.exposure, "reference_spp": args.reference_spp,
                           "times_of": samples,
                           "noise": bench.noise, "equal_error": args.equal_error, "results": results})
            path.write_text(json.dumps(stored, indent=1))
        print(f"written: {path}")
    for text in passed:
        print(f"quality: {text}", file=sys.stderr)
    for text in refused:
        print(f"quality: refused: {text}", file=sys.stderr)
    sys.exit(1 if refused else 6 if passed else 0)


if __name__ == "__main__":
    main()
