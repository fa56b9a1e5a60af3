#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the constants that libs/measure/tests/metrics_test.cpp expects, computed by programs that we did not write.

FLIP comes from NVIDIA's flip-evaluator, SSIM and PSNR from scikit-image, periodograms from SciPy, the rest from NumPy.
    python3 -m pip install -r tools/requirements-dev.txt && python3 tools/metric_constants.py
"""
import flip_evaluator
import numpy as np
import scipy.signal
import skimage.metrics


def random_values(height, width, key):
    """The numbers in [0,1) of random_value in the test."""
    y, x, c = np.meshgrid(*(np.arange(n, dtype=np.uint32) for n in (height, width, 3)), indexing="ij")
    h = x * np.uint32(73856093) ^ y * np.uint32(19349663) ^ c * np.uint32(83492791) ^ np.uint32(key * 2654435761 % 2**32)
    for _ in range(2):
        h = (h ^ h >> 16) * np.uint32(0x45D9F3B)
    return (h ^ h >> 16) / 4294967296.0


def picture(kind, width=48, height=40):
    """Gradients under a checkerboard, with noise, or moved by two pixels."""
    y, x = np.mgrid[0:height, 0:width]
    xs = np.maximum(x - 2, 0) if kind == "shift" else x
    v = 0.1 + 0.8 * np.stack([xs / (width - 1), y / (height - 1), (xs + y) / (width + height - 2)], axis=-1)
    v = np.where(((xs // 8 + y // 8) % 2 == 1)[..., None], v * 0.4, v)
    if kind == "noise":
        v = v + 0.3 * (random_values(height, width, 1) - 0.5)
    return np.clip(v, 0, 1).astype(np.float32)


def srgb(v):
    v = np.clip(v.astype(np.float64), 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def luminance(v):
    return v.astype(np.float64) @ np.array([0.212671, 0.715160, 0.072169])


def show(name, value):
    print(f"{name:44} {value:.10g}")


def main():
    reference, noise, shift = (picture(k) for k in ("reference", "noise", "shift"))
    for name, test in (("noise", noise), ("shift", shift)):
        r, t = reference.astype(np.float64), test.astype(np.float64)
        show(f"mse {name}", ((t - r) ** 2).mean())
        show(f"relative_mse {name}", ((t - r) ** 2 / (r**2 + 1e-2)).mean())
        gray = r.mean(axis=-1)
        show(f"relative_mse_gray {name}", (((t - r) ** 2).mean(axis=-1) / (gray**2 + 1e-3)).mean())
        per_pixel = np.sort(((t - r) ** 2 / (r**2 + 1e-2)).mean(axis=-1).ravel())
        show(f"relative_mse without 5 % {name}", per_pixel[: len(per_pixel) - int(0.05 * len(per_pixel))].mean())
        show(f"luminance_bias {name}", luminance(t).mean() / luminance(r).mean() - 1)
        show(f"psnr {name}", skimage.metrics.peak_signal_noise_ratio(srgb(r), srgb(t), data_range=1))
        show(f"psnr {name}, exposure -1",
             skimage.metrics.peak_signal_noise_ratio(srgb(r / 2), srgb(t / 2), data_range=1))
        show(f"ssim {name}", skimage.metrics.structural_similarity(
            srgb(luminance(np.clip(r, 0, 1))), srgb(luminance(np.clip(t, 0, 1))), data_range=1, gaussian_weights=True,
            sigma=1.5, use_sample_covariance=False))
        _, flip, _ = flip_evaluator.evaluate(reference, test, "LDR", inputsRGB=False, computeMeanError=True,
                                             applyMagma=False, parameters={"ppd": 67.0206433})
        show(f"flip {name}", flip)
        _, flip, _ = flip_evaluator.evaluate(reference**3 * 8, test**3 * 8, "HDR", computeMeanError=True,
                                             applyMagma=False, parameters={"ppd": 67.0206433})
        show(f"hdr_flip {name}", flip)

    # The series of Spectrum.AgreesWithSciPy: its powers, with the Hann window sampled between the frames.
    n = 20
    t = np.arange(n)
    series = 0.5 + 0.2 * t + np.sin(1.1 * t) + 0.3 * np.cos(2.9 * t)
    window = np.sin(np.pi * (t + 0.5) / n) ** 2
    _, power = scipy.signal.periodogram(series, window=window, detrend=False, scaling="spectrum")
    # "spectrum" divides by the square of the window's sum, ours by n times the sum of its squares.
    power = power * window.sum() ** 2 / (n * (window**2).sum())
    for k in (0, 1, 3, 7, 9, 10):
        show(f"power {k}", power[k])


if __name__ == "__main__":
    main()
