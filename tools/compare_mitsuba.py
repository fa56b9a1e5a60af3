#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Renders one scene file with Tempera and with Mitsuba 3 and tests whether the pictures agree.

For every pixel and channel z = (a - b) / sqrt(var a + var b), with variances of the means estimated from independent
batches of each renderer. A pixel passes if its two-sided p-value stays above the Sidak-corrected significance (0.01 over
all pixels); --required of them must, and the means must agree within --mean-tolerance and three standard errors. Needs the
packages of requirements-dev.txt. Exit status: 0 they agree, 1 they do not, 77 with --optional if the scene or Mitsuba is
not there.

  tools/compare_mitsuba.py --tempera build/release/bin/tempera scene.xml --width 256 --spp 512
  tools/compare_mitsuba.py ... scene.xml --reference refs/x_ref_rgb.exr --variance refs/x_ref_rgb_var.exr --spp 128
"""
import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile

RGB_TO_XYZ = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))


def read_exr(path):
    """The layers of an EXR as {channel name: [h,w] array}."""
    bitmap = mi.Bitmap(path)
    data = np.array(bitmap, dtype=np.float64)
    names = [field.name for field in bitmap.struct_()]
    return {name: data[:, :, i] for i, name in enumerate(names)}


def rgb(channels, layer=""):
    prefix = layer + "." if layer else ""
    return np.stack([channels[prefix + c] for c in "RGB"], axis=-1)


def render_tempera(args, batches, spp):
    images = []
    for i in range(batches):
        with tempfile.TemporaryDirectory() as folder:
            command = [args.tempera, "render", args.scene, "-o", os.path.join(folder, "ours.####.exr"), "--frames", "1",
                       "--spp", str(spp), "--seed", str(1 + i), "--sampler", "independent", "--layers", "color",
                       "--progress", "none"]
            if args.width:
                command += ["--resolution", f"{args.width}x{args.height}"]
            if args.max_depth is not None:
                command += ["--max-depth", str(args.max_depth)]
            for define in args.define:
                command += ["-D", define]
            subprocess.run(command, check=True)
            produced = [f for f in os.listdir(folder) if f.endswith(".exr")]
            images.append(rgb(read_exr(os.path.join(folder, sorted(produced)[0]))))
    return mean_and_variance(images)


def mean_and_variance(batches):
    """The mean of independent pictures and its variance."""
    mean = np.mean(batches, axis=0)
    return mean, np.var(batches, axis=0, ddof=1) / len(batches)


def load_scene(args):
    """Mitsuba 3 refuses parameters of older dialects that it no longer knows: they are left out for it."""
    folder, name = os.path.split(os.path.abspath(args.scene))
    with open(args.scene) as file:
        text = re.sub(r'<boolean name="(high_quality_edges|highQualityEdges)"[^>]*/>', "", file.read())
    mi.file_resolver().prepend(folder)
    return mi.load_string(text, **dict(d.split("=", 1) for d in args.define))


def mitsuba_scene(args):
    scene = load_scene(args)
    sensor = scene.sensors()[0]
    if args.width:
        params = mi.traverse(sensor)
        params["film.size"] = [args.width, args.height]
        params.update()
    return scene


def path_integrator(scene, args):
    """The scene's own integrator, unless a depth is given."""
    if args.max_depth is None:
        return scene.integrator()
    return mi.load_dict({"type": "path", "max_depth": args.max_depth})


def render_mitsuba(args, batches, spp):
    scene = mitsuba_scene(args)
    integrator = path_integrator(scene, args)
    return mean_and_variance([
        np.array(mi.render(scene, integrator=integrator, spp=spp, seed=1000 + i), dtype=np.float64)[:, :, :3]
        for i in range(batches)])


def normal_p(z):
    return np.vectorize(math.erfc)(np.abs(z) / math.sqrt(2))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--tempera", required=True)
    parser.add_argument("--width", type=int, default=0)
    parser.add_argument("--height", type=int, default=0)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--batches", type=int, default=16, help="independent renders of each program, spp / batches each")
    parser.add_argument("--max-depth", type=int)
    parser.add_argument("--define", "-D", action="append", default=[])
    parser.add_argument("--reference", help="converged mean (instead of rendering with Mitsuba)")
    parser.add_argument("--variance", help="per-sample variance that belongs to --reference")
    parser.add_argument("--significance", type=float, default=0.01)
    parser.add_argument("--required", type=float, default=0.995, help="share of pixels that must pass")
    parser.add_argument("--mean-tolerance", type=float, default=0.005, help="allowed difference of the mean radiances")
    parser.add_argument("--optional", action="store_true", help="end with status 77 if the scene or Mitsuba is missing")
    parser.add_argument("--border", type=int, default=0, help="pixels at the edges that are not compared")
    parser.add_argument("--images", help="folder for the two pictures and their difference as EXR")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    args = parser.parse_args()
    global mi, np
    if args.optional and not os.path.exists(args.scene):
        print(f"skipped: {args.scene} is not there")
        sys.exit(77)
    try:
        import mitsuba
        import numpy
        mitsuba.set_variant(args.variant)
    except ImportError as e:
        if not args.optional:
            raise
        print(f"skipped: no Mitsuba here ({e}); python3 -m pip install -r tools/requirements-dev.txt")
        sys.exit(77)
    mi, np = mitsuba, numpy
    if args.width and not args.height:
        size = load_scene(args).sensors()[0].film().size()
        args.height = max(1, round(args.width * int(size[1]) / int(size[0])))

    batch_spp = max(1, args.spp // args.batches)
    ours, our_variance = render_tempera(args, args.batches, batch_spp)
    if args.reference:
        theirs = rgb(read_exr(args.reference))
        # Mitsuba's own test compares XYZ: its variances were taken there and only stored as RGB. The reference counts as
        # exact, its per-sample variance is floored.
        to_xyz = np.array(RGB_TO_XYZ).T
        ours, theirs = ours @ to_xyz, theirs @ to_xyz
        variance = np.maximum(rgb(read_exr(args.variance)) @ to_xyz, 1e-4) / (batch_spp * args.batches)
    else:
        theirs, their_variance = render_mitsuba(args, args.batches, batch_spp)
        # Batches estimate a variance with batches - 1 degrees of freedom only: smooth over 5 x 5 pixels, and floor it at
        # what single precision accumulates.
        variance = box5(their_variance) + box5(our_variance)
        variance = np.maximum(variance, (1e-4 * (1e-3 + np.abs(theirs))) ** 2)
    if args.border:
        # Mitsuba cuts a filter off at the edge of the film and scales up what is left; Tempera samples beyond the edge, as
        # the filter's definition asks. Pixels that the difference reaches are left out.
        inner = (slice(args.border, -args.border), slice(args.border, -args.border))
        ours, theirs, variance = ours[inner], theirs[inner], variance[inner]
    z = (ours - theirs) / np.sqrt(variance)
    alpha = 1 - (1 - args.significance) ** (1 / (z.shape[0] * z.shape[1]))
    passed = float(np.mean(normal_p(z) > alpha))
    ratio = [float(ours[:, :, c].mean() / theirs[:, :, c].mean()) for c in range(3)]
    total = float(ours.mean() / theirs.mean())
    # Standard error of the ratio, from the same variances.
    error = float(np.sqrt(variance.sum()) / theirs.sum())
    ok = passed >= args.required and abs(total - 1) <= args.mean_tolerance + 3 * error
    if args.images:
        os.makedirs(args.images, exist_ok=True)
        for name, image in (("ours", ours), ("theirs", theirs), ("z", z)):
            mi.Bitmap(image.astype(np.float32)).write(os.path.join(args.images, name + ".exr"))
            tone = np.abs(image) / 6 if name == "z" else image
            mi.Bitmap(tone.astype(np.float32)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(
                os.path.join(args.images, name + ".png"))
    print(json.dumps({"scene": os.path.basename(os.path.dirname(os.path.abspath(args.scene))) + "/" +
                      os.path.basename(args.scene), "spp": args.spp, "size": [z.shape[1], z.shape[0]],
                      "passed": round(passed, 5), "mean_ratio": round(total, 5), "mean_ratio_error": round(error, 5),
                      "mean_ratio_rgb": [round(r, 5) for r in ratio], "rms_z": round(float(np.sqrt(np.mean(z * z))), 3),
                      "ok": ok}))
    sys.exit(0 if ok else 1)


def box5(image):
    padded = np.pad(image, ((2, 2), (2, 2), (0, 0)), mode="edge")
    h, w = image.shape[:2]
    return sum(padded[j:j + h, i:i + w] for j in range(5) for i in range(5)) / 25


if __name__ == "__main__":
    main()
