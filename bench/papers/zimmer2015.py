#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Figures and Table 1 of Zimmer et al. 2015, "Path-space Motion Estimation and Decomposition for Robust Animation
Filtering", at reduced size, with scenes in place of the paper's.

The pictures are small, so motion is, too: the keys of `robot` are as many frames further apart as its pictures are narrower
than 640 pixels, where the paper has three frames between two keys. Errors are the relMSE of `tempera compare`, with the
noise of two references taken out; the paper's are its own measure on its own scenes, so ratios are what can be compared.

  ./dev paper zimmer2015
  ./dev paper zimmer2015 --quick                   few samples: whether it all runs
  ./dev paper zimmer2015 --figure 13,14 --spp 256

Not made: Figures 3 and 5 are schematic; silhouettes (8) are found in the picture, not drawn as edges of meshes.
"""
import argparse
import json
import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "bench/papers")]
from cost import seconds_of  # noqa: E402
from figures import Picture, panel  # noqa: E402

LAYERS = "color,halves,albedo,normal,emission,object_id,depth,motion,chains,chain_motion"
SURFACE = ["R", "G", "B", "A", "object_id.I", "depth.Z",
           *(f"motion.{d}.{c}" for d in ("forward", "backward") for c in "XYZV")]
FEATURES = [f"{layer}.{c}" for layer, channels in (("albedo", "RGB"), ("normal", "XYZ"), ("emission", "RGB")) for c in channels]
HALVES = [f"color.{h}.{c}" for h in "ab" for c in "RGB"]
SHARP = ["--shutter", "0.25,0.25"]
GUIDES = ["--seed", 3, "--param", "feature_samples=16"]  # as quality fast has them
GUIDE_SPP = 8
# First key, distance of keys in frames at 640 pixels, and what paths the figure is about.
ROBOT, VASE, SHADOW = ("robot", 9), ("vase", 5), ("moving-shadow", 9)
HEAD = (176, 0, 96, 54)  # of the robot, at 640x360
CLOSE = {"robot": (10, 90), "vase": (190, 110), "moving-shadow": (300, 120)}  # where crops of 200x112 are, at 640x360


class Study:
    """Where things are made, and with how many samples."""

    def __init__(self, args):
        self.tempera = args.build / "bin/tempera"
        self.out, self.spp = args.out, args.spp
        self.reference_spp = args.reference_spp
        self.width, self.height = args.size
        self.every = max(4, round(4 * 640 / self.width))  # of the keys of `robot`
        self.rows, self.crops = [], []

    @staticmethod
    def run(*command):
        return seconds_of(command)

    def shot(self, scene):
        folder = self.out / "scenes"
        self.run(self.tempera, "-q", "gallery", "make", scene, "--gallery", folder)
        return folder / scene / "shot.toml"

    def render(self, scene, name, frames, spp, *more, size=None, layers=LAYERS, shutter=(0.25, 0.25)):
        """Renders what is not there yet; the frames' pattern."""
        pattern = self.out / scene / name / "f.####.exr"
        self.run(self.tempera, "-q", "render", self.shot(scene), "--frames", frames, "--spp", spp, "--layers", layers,
                 "--resolution", size or f"{self.width}x{self.height}", "--shutter", "{},{}".format(*shutter), *more,
                 "-o", pattern)
        return pattern

    def references(self, scene, frames, shutter=(0.25, 0.25)):
        return [self.render(scene, f"reference_{seed}_{shutter[1] - shutter[0]:g}", frames, self.reference_spp, "--seed", seed,
                            layers="color", shutter=shutter) for seed in (101, 102)]

    def stage(self, scene, name, stage, *inputs):
        pattern = self.out / scene / name / "f.####.exr"
        shutil.rmtree(pattern.parent, ignore_errors=True)
        self.run(self.tempera, "-q", stage, *inputs, "-o", pattern)
        return pattern

    def channels(self, scene, name, frames, channels):
        """Frames with some of the channels; "NEW=OLD" names one anew."""
        pattern = self.out / scene / name / "f.####.exr"
        shutil.rmtree(pattern.parent, ignore_errors=True)
        pattern.parent.mkdir(parents=True)
        for file in sorted(frames.parent.glob("f.*.exr")):
            self.run("oiiotool", "-i", file, "--ch", ",".join(channels), "-o", pattern.parent / file.name)
        return pattern

    def filled(self, scene, name, between, frames):
        """Frames in between, with the pixels that are left to the renderer; and their share."""
        masked = self.out / scene / f"{name}_pixels/f.####.exr"
        shutil.rmtree(masked.parent, ignore_errors=True)
        self.run(self.tempera, "-q", "render", self.shot(scene), "--frames", frames, "--spp", self.spp, "--layers",
                 "albedo,normal,emission,halves", "--resolution", f"{self.width}x{self.height}", *SHARP, "--mask", between,
                 "--seed", 7, "-o", masked)
        return self.stage(scene, f"{name}_filled", "fill", between, masked, "--smooth", "yes")

    def error(self, tested, references, frames=None, metric="relmse", trim=0):
        report = self.out / "compare.json"
        self.run(self.tempera, "compare", f"a={tested}", "-r", references[0], "--reference2", references[1], "--metrics",
                 metric, "--trim", trim, "--json", report, *(["--frames", frames] if frames else []))
        return json.loads(report.read_text(encoding="utf-8"))["sides"][0]["mean"][metric]

    def row(self, what, ours, paper):
        print(f"  {what}: {ours} (paper: {paper})", flush=True)
        self.rows.append(f"| {what} | {ours} | {paper} |")


def frame_of(pattern, number):
    return str(pattern).replace("####", f"{number:04d}")


def share_of(pattern, frames):
    """Mean of the mask of frames."""
    shares = []
    for f in frames:
        text = subprocess.run(["oiiotool", "-i", frame_of(pattern, f), "--ch", "mask.M", "--printstats"],
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True).stdout
        line = next((l for l in text.splitlines() if "Stats Avg" in l), None)
        if line is None:
            sys.exit(f"zimmer2015: {frame_of(pattern, f)}: no mask\n{text}")
        shares.append(float(line.split(":")[1].split()[0]))
    return sum(shares) / len(shares)


def figures_2_4_6(study):
    """Components, what reflects diffusely and is seen by reflection, and how they move."""
    name, frame = ROBOT
    frames = study.render(name, "noisy", frame, study.spp)
    f = frame_of(frames, frame)
    panel(study.out / "figure_02.jpg", [
        Picture("color", f), Picture("ED", f, "class.dd.color"), Picture("ED.+ x2", f, "class.di.color", exposure=1),
        Picture("ERD.* x4", f, "class.refl.color", exposure=2), Picture("ETTD.* x4", f, "class.trans.color", exposure=2),
        Picture("residual x4", f, "class.residual.color", exposure=2)], columns=3)
    for number, chain, layer in (("04", "D", "motion.forward"), ("06", "RD", "chain.RD.motion.forward")):
        vectors = [f"{layer}.{c}" for c in "XY"]
        speed = study.out / name / f"vectors_{chain}.exr"
        # Gray where nothing moves.
        study.run("oiiotool", "-i", f, "--ch", f"R={vectors[0]},G={vectors[1]},B={vectors[1]}", "--mulc", "0.5,0.5,0",
                  "--addc", "0.2,0.2,0.2", "-o", speed)
        panel(study.out / f"figure_{number}.jpg", [
            Picture(f"reflectance of chain {chain}", f, f"chain.{chain}.albedo", exposure=0 if chain == "D" else 2),
            Picture(f"motion of chain {chain}: red right, green down", speed)])


def figures_9_10(study):
    """Filters of the final color and of components."""
    name, frame = ROBOT
    noisy = study.render(name, "noisy", frame, study.spp)
    references = study.references(name, frame)
    plain = study.channels(name, "plain", noisy, ["R", "G", "B", "A", *HALVES])
    variants = {
        "NL-means of color": study.stage(name, "nl_color", "denoise", plain, "--radius", 0),
        "with features": study.stage(name, "nl_features", "denoise", noisy, "--radius", 0, "--recipe", "halves"),
        "components": study.stage(name, "nl_classes", "denoise", noisy, "--radius", 0, "--recipe", "classes"),
        "as published": study.stage(name, "published", "denoise", noisy, "--radius", 0, "--method", "published"),
        "RMZ13": study.stage(name, "rmz13", "denoise", noisy, "--method", "rmz13"),
    }
    # RMZ13 on top of the decomposition: each class as if it were the picture.
    total = study.out / name / "rmz13_classes.exr"
    for i, c in enumerate(("dd", "di", "refl", "trans", "residual")):
        renamed = [f"{to}=class.{c}.color{of}" for to, of in zip("RGB", (".R", ".G", ".B"))]
        renamed += [f"color.{h}.{k}=class.{c}.color.{h}.{k}" for h in "ab" for k in "RGB"]
        one = study.channels(name, f"class_{c}", noisy, [*renamed, "A", *FEATURES, "depth.Z"])
        clean = frame_of(study.stage(name, f"rmz13_{c}", "denoise", one, "--method", "rmz13"), frame)
        study.run("oiiotool", "-i", clean, "--ch", "R,G,B", *(["-i", total, "--add"] if i else []), "-o", total)
    variants["RMZ13 of components"] = total
    errors = {v: study.error(p if p == total else frame_of(p, frame), [frame_of(r, frame) for r in references])
              for v, p in variants.items()}
    pictures = [Picture(f"{study.spp} spp", frame_of(noisy, frame))]
    pictures += [Picture(f"{v}  {errors[v]:.1e}", p if p == total else frame_of(p, frame)) for v, p in variants.items()]
    panel(study.out / "figure_09_10.jpg", [*pictures, Picture("reference", frame_of(references[0], frame))], columns=4)
    for v, e in errors.items():
        study.row(f"Figures 9, 10: `robot`, {v}, relMSE", f"{e:.2e}", {"RMZ13": "1.2e-3", "RMZ13 of components": "0.75e-3"}.get(v, "–"))
    study.row("Figure 10: gain of components with RMZ13", f"{errors['RMZ13'] / errors['RMZ13 of components']:.2f}", "1.6")


def rgb(file, layer):
    """Arguments of oiiotool that leave three channels on the stack."""
    return ["-i", file, "--ch", ",".join(f"{c}={layer}.{c}" for c in "RGB")]


def figure_11(study):
    """Irradiance as the mean of light over reflectance, as standard factorization has it, and as the ratio of their
    means. The renderer does not divide samples, so that each is a frame of its own here, within a thousandth of a second
    from the first to the last."""
    fps, batch = 1000000, 64
    first = ROBOT[1] * fps // 24
    shot = study.shot("robot").with_name("shot_dof.toml")
    folder = study.out / "robot/depth_of_field"

    def render(name, frames, spp, *more):
        pattern = folder / name / "f.####.exr"
        study.run(study.tempera, "-q", "render", shot, "--fps", fps, "--shutter", "0,0", "--resolution", "640x360", "--crop",
                  ",".join(map(str, HEAD)), "--frames", frames, "--spp", spp, *more, "-o", pattern)
        return pattern

    def diffuse(file):  # what reflects diffusely: without coats
        return [*rgb(file, "class.dd.color"), *rgb(file, "class.di.color"), "--add"]

    def albedo(file):
        return rgb(file, "chain.D.albedo")

    def mean(name, files, value):
        out = folder / f"{name}.exr"
        for i in range(0, len(files), batch):
            total = ["-i", out] if i else []
            for k, file in enumerate(files[i:i + batch]):
                total += [*value(file), *(["--add"] if i + k else [])]
            study.run("oiiotool", *total, "-o", out)
        study.run("oiiotool", "-i", out, "--mulc", 1 / len(files), "-o", out)
        return out

    shutil.rmtree(folder, ignore_errors=True)
    render("samples", f"{first}-{first + study.spp - 1}", 1, "--layers", "chain.D.albedo,chain.D.normal")
    files = sorted((folder / "samples").glob("f.*.exr"))
    references = []
    for i, seed in enumerate((101, 102)):
        frame = render(f"reference_{i}", first + study.spp // 2, study.reference_spp, "--seed", seed)
        references.append(mean(f"reference_{i}", [next(frame.parent.glob("f.*.exr"))], diffuse))
    light, reflectance = mean("light", files, diffuse), mean("reflectance", files, albedo)
    normal = mean("normal", files, lambda f: ["-i", f, "--ch", ",".join(f"{to}=chain.D.normal.{c}" for to, c in zip("RGB", "XYZ"))])
    above_zero = ["--maxc", 1e-3]  # of a divisor
    pictures = {f"input, {study.spp} spp": light}
    for name, text in (("standard", "irradiance"), ("effective", "effective irradiance")):
        def irradiance(file):
            return [*diffuse(file), *albedo(file), *above_zero, "--div"]
        parts = []
        for part, some in (("whole", files), ("a", files[0::2]), ("b", files[1::2])):
            if name == "standard":
                parts.append(mean(f"{name}_{part}", some, irradiance))
                continue
            parts.append(folder / f"{name}_{part}.exr")
            study.run("oiiotool", "-i", mean(f"light_{part}", some, diffuse), "-i", reflectance, *above_zero, "--div", "-o",
                      parts[-1])
        noisy = folder / name / "f.0001.exr"
        noisy.parent.mkdir()
        layers = []
        for file, names in zip([*parts, normal], ("R,G,B", "color.a.R,color.a.G,color.a.B", "color.b.R,color.b.G,color.b.B",
                                                  "normal.X,normal.Y,normal.Z")):
            layers += ["-i", file, "--chnames", names, *(["--chappend"] if layers else [])]
        study.run("oiiotool", *layers, "-o", noisy)
        clean = study.stage("robot/depth_of_field", f"{name}_clean", "denoise", noisy, "--radius", 0, "--recipe", "halves")
        pictures[text] = folder / f"{name}_denoised.exr"
        study.run("oiiotool", "-i", frame_of(clean, 1), "--ch", "R,G,B", "-i", reflectance, "--mul", "-o", pictures[text])
    errors = {text: study.error(picture, references) for text, picture in pictures.items()}
    panel(study.out / "figure_11.jpg", [*(Picture(f"{text}  {errors[text]:.1e}", p) for text, p in pictures.items()),
                                        Picture("reference", references[0])], columns=2, width=480)
    for (text, error), paper in zip(errors.items(), ("5.6e-3", "9.9e-3", "0.90e-3")):
        study.row(f"Figure 11: `robot:dof`, {text}, relMSE", f"{error:.2e}", paper)


def figure_12(study):
    """Upsampling of components and of color alone."""
    name, frame = ROBOT
    small = study.render(name, "small", frame, study.spp, size=f"{study.width // 2}x{study.height // 2}")
    guides = study.render(name, "small_guides", frame, GUIDE_SPP, *GUIDES)
    references = study.references(name, frame)
    clean = study.stage(name, "small_clean", "denoise", small, "--radius", 0, "--recipe", "classes")
    kept = SURFACE + FEATURES
    made = {
        "color only": study.stage(name, "upsampled_color", "upsample", study.channels(name, "small_color", clean, kept),
                                  study.channels(name, "small_color_guides", guides, kept)),
        "components": study.stage(name, "upsampled", "upsample", clean, guides),
    }
    shares = {m: share_of(p, [frame]) for m, p in made.items()}
    finished = {m: study.filled(name, p.parent.name, p, frame) for m, p in made.items()}
    errors = {m: study.error(p, references, frame) for m, p in finished.items()}
    panel(study.out / "figure_12.jpg", [Picture("half size", frame_of(clean, frame)),
                                        *(Picture(f"{m}  {errors[m]:.1e}", frame_of(p, frame)) for m, p in finished.items()),
                                        Picture("reference", frame_of(references[0], frame))])
    for m, paper in zip(made, ("8.2e-3, –", "3.4e-3, 0.14 to 0.28 %")):
        study.row(f"Figure 12: `robot` from half the size, {m}, relMSE, rendered again", f"{errors[m]:.2e}, {100 * shares[m]:.1f} %", paper)


def interpolation(study, number, scene, first, every, papers):
    """Frames between keys, of color alone along the first surface and of components."""
    last = first + every
    quarters = sorted({first + round(every * k / 4) for k in (1, 2, 3)})
    wanted = ",".join(map(str, quarters))
    keys = study.render(scene, "keys", f"{first},{last}", study.spp)
    guides = study.render(scene, "guides", f"{first}-{last}", GUIDE_SPP, *GUIDES)
    references = study.references(scene, wanted)
    clean = study.stage(scene, "clean", "denoise", keys, "--radius", 0, "--recipe", "classes")
    color_keys, color_guides = (study.channels(scene, f"color_{n}", p, SURFACE) for n, p in (("keys", clean), ("guides", guides)))
    common = ["--every", every, "--frames", wanted]
    made = {
        "color only": study.stage(scene, "between_color", "interpolate", color_keys, color_guides, "--method", "published", *common),
        "as published": study.stage(scene, "between_published", "interpolate", clean, guides, "--method", "published", *common),
        "gathered": study.stage(scene, "between", "interpolate", clean, guides, *common),
    }
    shares = {m: share_of(p, quarters) for m, p in made.items()}
    finished = {m: study.filled(scene, p.parent.name, p, wanted) for m, p in made.items()}
    errors = {m: study.error(p, references, wanted) for m, p in finished.items()}
    f = quarters[1]
    panel(study.out / f"figure_{number}_{scene}.jpg",
          [Picture(f"{m}  {errors[m]:.1e}", frame_of(p, f)) for m, p in finished.items()] +
          [Picture("reference", frame_of(references[0], f))])
    crop = tuple(round(v * study.width / 640) for v in (*CLOSE[scene], 200, 112))
    study.crops += [Picture(text, frame_of(p, n), crop=crop) for text, p, n in (
        (f"key, frame {first}", clean, first), (f"frame {f}, from keys", finished["gathered"], f),
        (f"frame {f}, rendered", references[0], f), (f"key, frame {last}", clean, last))]
    panel(study.out / "crops.jpg", study.crops, columns=4)
    for m, paper in zip(made, papers):
        study.row(f"Figure {number}: `{scene}`, frames in between, {m}, relMSE", f"{errors[m]:.2e}", paper)
    study.row(f"`{scene}`: gain as published, gathered",
              f"{errors['color only'] / errors['as published']:.1f}, {errors['color only'] / errors['gathered']:.1f}",
              {"robot": "4.3", "vase": "11", "moving-shadow": "4.4"}[scene])
    study.row(f"`{scene}`: rendered again, as published, gathered",
              f"{100 * shares['as published']:.0f} %, {100 * shares['gathered']:.0f} %", "8 to 33 %" if scene == "robot" else "–")


def figure_13(study):
    interpolation(study, 13, *ROBOT, study.every, ("7.3e-3", "1.7e-3", "–"))
    interpolation(study, 13, *VASE, 4, ("1.1e-1", "0.1e-1", "–"))


def figure_14(study):
    interpolation(study, 14, *SHADOW, 4, ("6.2e-2", "1.4e-2", "–"))


def figure_15(study):
    """Motion blur added to a sharp frame."""
    name, frame = VASE
    around = study.render(name, "sharp", f"{frame - 1}-{frame + 1}", study.spp)
    clean = study.stage(name, "sharp_clean", "denoise", around, "--radius", 0, "--recipe", "classes")
    pictures = [Picture("no motion blur", frame_of(clean, frame))]
    for shutter, text in ((0.5, "half exposure"), (1, "full exposure")):
        blurred = study.stage(name, f"blurred_{shutter}", "motionblur", clean, "--shutter", shutter, "--frames", frame)
        references = study.references(name, frame, (0.25 - shutter / 2, 0.25 + shutter / 2))
        error, sharp = study.error(blurred, references, frame), study.error(clean, references, frame)
        pictures += [Picture(f"{text}  {error:.1e}", frame_of(blurred, frame)), Picture("rendered", frame_of(references[0], frame))]
        study.row(f"Figure 15: `vase`, {text}, relMSE of the sharp frame and blurred", f"{sharp:.2e}, {error:.2e}", "–")
    panel(study.out / "figure_15.jpg", pictures)


def table_1(study):
    """Cost of a frame, as a part of that of one rendered with all samples: denoise, interpolate, upsample."""
    name = ROBOT[0]
    shot = study.shot(name)
    common = [study.tempera, "-q", "run", shot, "--resolution", f"{study.width}x{study.height}", "--spp", study.spp,
              "--threads", 1, "--no-video", *SHARP, "--set", "denoise.method=nl_means", "--set", "denoise.radius=0"]

    def seconds(folder, frames, stages, *more):
        work = study.out / "table_1" / folder
        shutil.rmtree(work, ignore_errors=True)
        named = ",".join(f'"{s}"' for s in stages)
        return study.run(*common, "--frames", frames, "--set", f"stages=[{named}]", *more, "-o", work / "f.####.exr")

    base = seconds("base", 9, [], "--layers", "color", "--set", "decompose={}")
    print(f"  base: {base:.1f} s a frame")
    classes = ["--set", "denoise.recipe=classes"]
    for method, stages, paper in (("D", ["denoise"], "1.2"), ("DI", ["denoise", "interpolate"], "0.55"),
                                  ("DU", ["denoise", "upsample"], "0.43"), ("DUI", ["denoise", "upsample", "interpolate"], "0.29")):
        costs = []
        for more in (classes, ["--set", "decompose={}"]):
            took = seconds(method, "9-17", stages, *more) if "I" in method else seconds(method, "9", stages, *more)
            if "I" in method:  # the first key stands for the frames before it
                took = (took - seconds(method + "_key", "9", [s for s in stages if s != "interpolate"], *more)) / 8
            costs.append(took / base)
        study.row(f"Table 1: {method}, relative cost with classes and their vectors, without", f"{costs[0]:.2f}, {costs[1]:.2f}", paper)


def figure_1(study):
    """All of it: from noisy frames of half the size, every fourth one."""
    name, frame = ROBOT
    work = study.out / name / "dui"
    study.run(study.tempera, "-q", "run", study.shot(name), "--quality", "fast", "--set", "denoise.method=nl_means", "--spp",
              study.spp, "--resolution", f"{study.width}x{study.height}", "--frames", f"{frame}-{frame + 4}", "--no-video",
              *SHARP, "-o", work / "f.####.exr")
    between = frame + 2
    references = study.references(name, between)
    final = work / "final/f.####.exr"
    error = study.error(final, references, between)
    panel(study.out / "figure_01.jpg", [
        Picture(f"rendered, {study.spp} spp", frame_of(work / "f.####.exr", frame)),
        Picture(f"two frames later  {error:.1e}", frame_of(final, between)),
        Picture("reference", frame_of(references[0], between))])
    study.row("Figure 1: `robot`, quality fast, the frame between two keys, relMSE", f"{error:.2e}", "–")


FIGURES = {"1": figure_1, "2": figures_2_4_6, "4": figures_2_4_6, "6": figures_2_4_6, "9": figures_9_10, "10": figures_9_10, "11": figure_11,
           "12": figure_12, "13": figure_13, "14": figure_14, "15": figure_15, "table": table_1}


def even_size(text):
    """WIDTHxHEIGHT of pictures that have a half."""
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) * int(height) > 0):
        raise argparse.ArgumentTypeError(f"a size is written as 160x90, not {text}")
    if int(width) % 2 or int(height) % 2:
        raise argparse.ArgumentTypeError(f"width and height have to be even, unlike {text}")
    return int(width), int(height)


def main():
    parser = argparse.ArgumentParser(prog="./dev paper zimmer2015", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", default=",".join(FIGURES), help=f"comma list of {', '.join(FIGURES)} [all]")
    parser.add_argument("--size", type=even_size, default="160x90", metavar="WxH", help="[160x90]")
    parser.add_argument("--spp", type=int, default=512, help="[512, as in the paper]")
    parser.add_argument("--reference-spp", type=int, default=1024, help="of each of two references [1024]")
    parser.add_argument("--quick", action="store_true", help="16 samples and 32 of the references")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/papers/zimmer2015", help="[out/papers/zimmer2015]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    wanted = args.figure.split(",")
    for figure in wanted:
        if figure not in FIGURES:
            parser.error(f"there is no figure {figure}; known: {', '.join(FIGURES)}")
    if args.quick:
        args.spp, args.reference_spp = 16, 32
    args.out = args.out.resolve()
    args.build = args.build.resolve()
    study = Study(args)
    for figure in dict.fromkeys(FIGURES[f] for f in wanted):
        print(figure.__name__.replace("_", " "), flush=True)
        figure(study)
    table = "| what | here | paper |\n| --- | --- | --- |\n" + "\n".join(study.rows) + "\n"
    (args.out / "tables.md").write_text(table, encoding="utf-8")
    print(f"Written: {args.out}")


if __name__ == "__main__":
    main()
