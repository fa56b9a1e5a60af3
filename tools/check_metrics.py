#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures a rendered sequence with programs that we did not write and compares the figures with `tempera compare`.

FLIP comes from NVIDIA's flip-evaluator, SSIM and PSNR from scikit-image, spectra from SciPy, all else from NumPy; EXR
files are read by Mitsuba 3. Ends with status 1 if a figure differs by more than its tolerance.
    python3 -m pip install -r tools/requirements-dev.txt
    python3 tools/check_metrics.py 'out/test/f.####.exr' 'out/reference/f.####.exr'
With --reference2 squared metrics are checked without the noise of both references, from their definition.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import flip_evaluator
import mitsuba
import numpy as np
import scipy.ndimage
import scipy.signal
import skimage.metrics

ROOT = pathlib.Path(__file__).resolve().parent.parent
LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
TOLERANCE = {"flip": 1e-3, "hdr_flip": 1e-3, "psnr": 1e-3, "ssim": 1e-4, "flicker": 1e-3,
             "flicker_display": 1e-2}  # that of flicker is relative
CUTOFF = 0.25
NOT_CHECKED = ("warp_error", "motion_error")


def load(pattern, frame):
    """The layers of a frame as float arrays; "color" is RGB."""
    digits = pattern.count("#")
    out = {}
    for name, layer in mitsuba.Bitmap(pattern.replace("#" * digits, f"{frame:0{digits}}")).split():
        values = np.array(layer).astype(np.float32)
        if name == "<root>":
            out["color"] = values[..., :3]
        elif name.startswith("motion."):  # Mitsuba has the channels in an order of its own
            channels = [field.name for field in layer.struct_()]
            out[name] = values[..., [channels.index(c) for c in "XYZV"]]
    return out


def srgb(v):
    v = np.clip(v.astype(np.float64), 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def at(image, x, y):
    """Bilinear lookup at positions in pixels, centers at +0.5."""
    return np.stack([scipy.ndimage.map_coordinates(image[..., c].astype(np.float64), [y - 0.5, x - 0.5], order=1,
                                                   mode="nearest") for c in range(image.shape[-1])], axis=-1)


def previous(backward, forward):
    """Positions in the frame before, and where they exist: as docs/metrics.md has it."""
    h, w = backward.shape[:2]
    y, x = np.mgrid[0:h, 0:w] + 0.5
    b = backward[..., :2].astype(np.float64)
    px, py = x + b[..., 0], y + b[..., 1]
    exists = (backward[..., 3] > 0) & (px >= 0) & (py >= 0) & (px < w) & (py < h)
    f = at(forward, np.clip(px, 0, w), np.clip(py, 0, h))
    exists &= f[..., 3] > 1 - 1e-6  # valid in all four pixels
    gap = ((b + f[..., :2]) ** 2).sum(axis=-1)
    return px, py, exists & (gap <= 0.01 * ((b**2).sum(axis=-1) + (f[..., :2] ** 2).sum(axis=-1)) + 0.5)


def relative_change(t, t0, r, r0):
    return ((t - t0) - (r - r0)) ** 2 / ((r**2 + r0**2) / 2 + 1e-2)


def displayed_luminance(v):
    return srgb(np.clip(np.nan_to_num(v.astype(np.float64), nan=0), 0, 1) @ LUMINANCE)


def measure_frame(test, reference, before):
    """Values of a frame; `before`: test and reference of the frame before."""
    t32, r32 = test["color"], reference["color"]
    t, r = t32.astype(np.float64), r32.astype(np.float64)
    yt, yr = displayed_luminance(t), displayed_luminance(r)
    out = {
        "relmse": ((t - r) ** 2 / (r**2 + 1e-2)).mean(),
        "relmse_gray": (((t - r) ** 2).mean(axis=-1) / (r.mean(axis=-1) ** 2 + 1e-3)).mean(),
        "mse": ((t - r) ** 2).mean(),
        "bias": (t @ LUMINANCE).mean() / (r @ LUMINANCE).mean() - 1,
        "psnr": skimage.metrics.peak_signal_noise_ratio(srgb(r), srgb(t), data_range=1),
        "ssim": skimage.metrics.structural_similarity(yr, yt, data_range=1, gaussian_weights=True, sigma=1.5,
                                                      use_sample_covariance=False),
        "flip": flip_evaluator.evaluate(np.clip(r32, 0, 1), np.clip(t32, 0, 1), "LDR", inputsRGB=False,
                                        applyMagma=False)[1],
        "hdr_flip": flip_evaluator.evaluate(r32, t32, "HDR", applyMagma=False)[1],
    }
    if before:
        t0, r0 = (b["color"].astype(np.float64) for b in before)
        out["temporal"] = relative_change(t, t0, r, r0).mean()
        out["flicker_static"] = np.abs((t - t0) @ LUMINANCE).mean()
        if "motion.backward" in reference and "motion.forward" in before[1]:
            px, py, exists = previous(reference["motion.backward"], before[1]["motion.forward"])
            error = relative_change(t, at(t0, px, py), r, at(r0, px, py))
            out["temporal_compensated"] = error[exists].mean()
    return out


def flicker(residuals):
    """Power above the cutoff of residuals [frame, pixel]; for at most 64 frames."""
    n = len(residuals)
    window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
    frequency, power = scipy.signal.periodogram(residuals, window=window, detrend=False, scaling="spectrum", axis=0)
    power = power.mean(axis=1) * window.sum() ** 2 / (n * (window**2).sum())
    return power[frequency > CUTOFF + 1e-9].sum()


def measure_two(test, references, frames):
    """Means over frames of squared metrics: ((x - a)^2 + (x - b)^2 - (a - b)^2) / 2, relative to the mean of a and b."""
    colors = [np.array([load(p, f)["color"].astype(np.float64) for f in frames]) for p in (test, *references)]
    x, a, b = colors
    square = ((x - a) ** 2 + (x - b) ** 2 - (a - b) ** 2) / 2

    def power(values):
        x, a, b = (v.reshape(len(frames), -1) for v in values)
        return (flicker(x - a) + flicker(x - b) - flicker(a - b)) / 2
    return {"relmse": (square / (((a + b) / 2) ** 2 + 1e-2)).mean(), "mse": square.mean(),
            "flicker": power([v @ LUMINANCE for v in colors]),
            "flicker_display": 255 * np.sqrt(max(0, power([displayed_luminance(v) for v in colors])))}


def report(differences):
    """Prints them and ends the program, with status 1 if one is too large."""
    failed = False
    for name, difference in differences.items():
        bad = not difference <= TOLERANCE.get(name, 1e-6)
        failed |= bad
        print(f"{name:22} differs by {difference:.1e} at most{'  TOO MUCH' if bad else ''}")
    sys.exit(failed)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("test")
    parser.add_argument("reference")
    parser.add_argument("--reference2", help="checks relmse, mse, flicker and flicker_display without the references' noise")
    parser.add_argument("--tempera", default=ROOT / "build/release/bin/tempera")
    args = parser.parse_args()
    mitsuba.set_variant("scalar_rgb")

    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "figures.json"
        second = ["--reference2", args.reference2] if args.reference2 else []
        metrics = "relmse,mse,flicker,flicker_display" if second else "all"
        subprocess.run([args.tempera, "compare", args.test, "--reference", args.reference, *second, "--metrics", metrics,
                        "--json", path], check=True)
        side = json.loads(path.read_text())["sides"][0]
    if second:
        figures = measure_two(args.test, (args.reference, args.reference2), side["frames"])
        report({name: abs(side["mean"][name] - value) / (1 if name == "flicker_display" else abs(value))
                for name, value in figures.items()})

    worst = {name: 0.0 for name in side["values"] if name not in NOT_CHECKED}
    before, residuals, displayed = None, [], []
    for i, frame in enumerate(side["frames"]):
        test, reference = load(args.test, frame), load(args.reference, frame)
        for name, value in measure_frame(test, reference, before).items():
            if name in side["values"]:
                difference = abs(side["values"][name][i] - value)
                if not difference <= worst.get(name, 0):  # NaN stays
                    worst[name] = difference
        residuals.append(((test["color"].astype(np.float64) - reference["color"]) @ LUMINANCE).ravel())
        displayed.append((displayed_luminance(test["color"]) - displayed_luminance(reference["color"])).ravel())
        before = (test, reference)
    if "flicker" in side["mean"] and len(residuals) <= 64:
        worst["flicker"] = abs(side["mean"]["flicker"] / flicker(np.array(residuals)) - 1)
        worst["flicker_display"] = abs(side["mean"]["flicker_display"] - 255 * np.sqrt(flicker(np.array(displayed))))
    report(worst)


if __name__ == "__main__":
    main()
