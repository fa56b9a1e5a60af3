#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes libs/shading/tests/bsdf_reference.txt: values of Mitsuba 3's BSDFs that the shading tests compare ours with.

  python3 tools/make_bsdf_reference.py [--count 24] > libs/shading/tests/bsdf_reference.txt

Needs the Mitsuba wheel (tools/requirements-dev.txt). After `bsdf NAME` follow rows
  eval  u v  wo(3)  wi(3)  f cos(3)  pdf       for the non-delta part
  delta u v  wo(3)  wi(3)  coefficient(3)  probability
in the local frame; wo is the known direction (Mitsuba's si.wi), wi the sampled one. bsdf_reference_test.cpp makes the
material of each NAME; the textures are 4 x 4 with the bytes of `texture` below.
"""
import argparse
import math

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)

COLOR = {"type": "rgb", "value": [0.7, 0.4, 0.2]}
TINT = {"type": "rgb", "value": [0.9, 0.8, 0.6]}


def texture(channels):
    """4 x 4 bytes, filtered bilinearly and not decoded from sRGB."""
    data = np.fromfunction(lambda y, x, c: (40 * x + 67 * y + 90 * c + 13 * x * y) % 256, (4, 4, channels))
    if channels == 3:
        data[:, :, 2] = 128 + data[:, :, 2] // 2  # normals point up
    return {"type": "bitmap", "bitmap": mi.Bitmap(data.astype(np.uint8)), "raw": True}


def rough(kind, **extra):
    return {"type": kind, **extra}


GOLD = {"material": "Au"}
BSDFS = {
    "diffuse": {"type": "diffuse", "reflectance": COLOR},
    "conductor": {"type": "conductor", **GOLD, "specular_reflectance": TINT},
    "roughconductor_beckmann": rough("roughconductor", **GOLD, alpha=0.2),
    "roughconductor_ggx": rough("roughconductor", **GOLD, alpha=0.3, distribution="ggx", specular_reflectance=TINT),
    "roughconductor_sharp": rough("roughconductor", **GOLD, alpha=0.02, distribution="ggx"),
    "roughconductor_anisotropic_beckmann": rough("roughconductor", **GOLD, alpha_u=0.1, alpha_v=0.4),
    "roughconductor_anisotropic_ggx": rough("roughconductor", **GOLD, alpha_u=0.5, alpha_v=0.15, distribution="ggx"),
    "roughconductor_all_normals_beckmann": rough("roughconductor", **GOLD, alpha=0.3, sample_visible=False),
    "roughconductor_all_normals_ggx":
        rough("roughconductor", **GOLD, alpha_u=0.3, alpha_v=0.2, distribution="ggx", sample_visible=False),
    "dielectric": {"type": "dielectric", "specular_reflectance": TINT, "specular_transmittance": COLOR},
    "dielectric_diamond_in_water": {"type": "dielectric", "int_ior": "diamond", "ext_ior": "water"},
    "thindielectric": {"type": "thindielectric", "specular_transmittance": COLOR},
    "roughdielectric_beckmann": rough("roughdielectric", alpha=0.3, specular_transmittance=COLOR),
    "roughdielectric_ggx": rough("roughdielectric", alpha=0.2, distribution="ggx", int_ior=1.8, ext_ior=1.0),
    "roughdielectric_anisotropic": rough("roughdielectric", alpha_u=0.1, alpha_v=0.5, distribution="ggx"),
    "roughdielectric_all_normals": rough("roughdielectric", alpha=0.3, distribution="ggx", sample_visible=False),
    "roughdielectric_from_dense": rough("roughdielectric", alpha=0.25, int_ior=1.0, ext_ior=1.5),
    "plastic": {"type": "plastic", "diffuse_reflectance": COLOR, "specular_reflectance": TINT},
    "plastic_nonlinear": {"type": "plastic", "diffuse_reflectance": COLOR, "nonlinear": True, "int_ior": 1.9},
    "roughplastic_beckmann": rough("roughplastic", alpha=0.1, diffuse_reflectance=COLOR),
    "roughplastic_ggx_nonlinear":
        rough("roughplastic", alpha=0.3, distribution="ggx", diffuse_reflectance=COLOR, nonlinear=True),
    "roughplastic_all_normals": rough("roughplastic", alpha=0.2, distribution="ggx", sample_visible=False,
                                      specular_reflectance=TINT),
    "principled_plain": {"type": "principled", "base_color": COLOR, "roughness": 0.4},
    "principled_metal": {"type": "principled", "base_color": COLOR, "roughness": 0.3, "metallic": 0.8,
                         "anisotropic": 0.7, "spec_tint": 0.5},
    "principled_cloth": {"type": "principled", "base_color": COLOR, "roughness": 0.8, "flatness": 0.6, "sheen": 0.9,
                         "sheen_tint": 0.4, "specular": 0.3},
    "principled_coat": {"type": "principled", "base_color": COLOR, "roughness": 0.6, "clearcoat": 1.0,
                        "clearcoat_gloss": 0.3, "spec_tint": 0.7},
    "principled_glass": {"type": "principled", "base_color": COLOR, "roughness": 0.35, "spec_trans": 0.8, "eta": 1.45,
                         "clearcoat": 0.5, "clearcoat_gloss": 0.9, "metallic": 0.1, "anisotropic": 0.3,
                         "spec_tint": 0.2},
    "blend": {"type": "blendbsdf", "weight": 0.3, "a": {"type": "diffuse", "reflectance": COLOR},
              "b": rough("roughconductor", **GOLD, alpha=0.3)},
    "blend_textured": {"type": "blendbsdf", "weight": texture(1), "a": {"type": "diffuse", "reflectance": COLOR},
                       "b": {"type": "plastic", "diffuse_reflectance": TINT}},
    "twosided": {"type": "twosided", "a": rough("roughplastic", alpha=0.25, diffuse_reflectance=COLOR)},
    "twosided_pair": {"type": "twosided", "a": {"type": "diffuse", "reflectance": COLOR},
                      "b": rough("roughconductor", **GOLD, alpha_u=0.3, alpha_v=0.2)},
    "bumpmap": {"type": "bumpmap", "map": texture(1), "scale": 0.4, "a": {"type": "diffuse", "reflectance": COLOR}},
    "bumpmap_color": {"type": "bumpmap", "map": texture(3), "scale": -0.2, "a": rough("roughconductor", **GOLD, alpha=0.3)},
    "bumpmap_twosided": {"type": "bumpmap", "map": texture(1), "scale": 0.3,
                         "a": {"type": "twosided", "a": rough("roughplastic", alpha=0.3, diffuse_reflectance=COLOR)}},
    "twosided_bumpmap": {"type": "twosided", "a": {"type": "bumpmap", "map": texture(1), "scale": 0.3,
                                                   "a": {"type": "diffuse", "reflectance": COLOR}}},
    "bumpmap_dielectric": {"type": "bumpmap", "map": texture(1), "scale": 0.1, "a": rough("roughdielectric", alpha=0.3)},
    "normalmap": {"type": "normalmap", "normalmap": texture(3),
                  "a": rough("roughconductor", **GOLD, alpha_u=0.4, alpha_v=0.2)},
    "normalmap_twosided": {"type": "twosided", "a": {"type": "normalmap", "normalmap": texture(3),
                                                     "a": {"type": "diffuse", "reflectance": COLOR}}},
}


def sphere(rng):
    z = rng.uniform(-1, 1)
    phi = rng.uniform(0, 2 * math.pi)
    r = math.sqrt(1 - z * z)
    return [r * math.cos(phi), r * math.sin(phi), z]


def row(kind, *values):
    flat = [float(x) for v in values for x in (v if hasattr(v, "__len__") else [v])]
    print(kind, " ".join(f"{x:.8g}" for x in flat))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=24, help="directions per BSDF")
    count = parser.parse_args().count
    print(f"# Values of Mitsuba {mi.__version__} (scalar_rgb), written by tools/make_bsdf_reference.py; do not edit.")
    context = mi.BSDFContext()
    for name, description in BSDFS.items():
        bsdf = mi.load_dict(description)
        rng = np.random.default_rng(sum(name.encode()))
        print("bsdf", name)
        done = 0
        while done < count:
            si = mi.SurfaceInteraction3f()
            si.p = [0, 0, 0]
            si.n = [0, 0, 1]
            si.sh_frame = mi.Frame3f([0, 0, 1])
            si.sh_frame.s, si.sh_frame.t = [1, 0, 0], [0, 1, 0]
            # Tangents that are neither unit nor orthogonal, but start the frame above.
            si.dp_du, si.dp_dv = [0.8, 0, 0.1], [-0.3, 1.2, 0.2]
            si.uv = np.float32(rng.uniform(-1, 2, 2)).tolist()
            si.wi = sphere(rng)
            if si.wi.z < 0 and rng.uniform() < 0.5:
                si.wi.z = -si.wi.z
            sample, weight = bsdf.sample(context, si, rng.uniform(), rng.uniform(0, 1, 2).tolist())
            if sample.pdf > 0 and mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) or \
               mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null):
                # In a blend, Mitsuba 3.9 adds the probability of a delta lobe to the density of the other material:
                # its weight is wrong there, and no reference.
                if max(weight) > 0 and not name.startswith("blend"):
                    row("delta", si.uv, si.wi, sample.wo, np.array(weight) * sample.pdf, sample.pdf)
                    done += 1
                continue
            wi = sample.wo if rng.uniform() < 0.6 and sample.pdf > 0 else mi.Vector3f(sphere(rng))
            value, pdf = bsdf.eval(context, si, wi), bsdf.pdf(context, si, wi)
            if pdf == 0 and rng.uniform() < 0.9:
                continue  # a few zeros suffice
            # From behind, an opaque `principled` has a density though it samples nothing.
            if name.startswith("principled") and si.wi.z < 0 and pdf > 0 and max(value) == 0:
                continue
            row("eval", si.uv, si.wi, wi, value, pdf)
            done += 1


if __name__ == "__main__":
    main()
