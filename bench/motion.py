#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What motion vectors of chains cost, and how well they carry what mirrors and glass show from frame to frame.

Cost: processor time of a frame with the layers `chain_motion` over one without, as a part of that of 64 samples of `path`
(the difference of few and many samples, scaled). All on one thread; the least of several rounds counts.
Error: a class of light of two frames with many samples, the first one looked up in the second along the vectors of its
chain and along those of first surfaces: relMSE of both, and their ratio.

  ./dev bench motion
  ./dev bench motion --size 160x90 --spp 256
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

from cost import ROOT, seconds_of

SCENES = {"robot": (24, "refl", "RD"), "vase": (12, "trans4", "TTTTD")}  # frame, class, chain


def main():
    parser = argparse.ArgumentParser(prog="./dev bench motion", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="320x180", help="[320x180]")
    parser.add_argument("--spp", type=int, default=512, help="samples of the frames for the error; 0: none [512]")
    parser.add_argument("--rounds", type=int, default=3, help="of the cost; 0: none [3]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    tempera = args.build / "bin/tempera"
    with tempfile.TemporaryDirectory() as folder:
        for name, (frame, of_light, chain) in SCENES.items():
            made = subprocess.run([tempera, "-q", "gallery", "make", name, "--gallery", f"{folder}/scenes"],
                                  stdout=subprocess.PIPE, text=True)
            if made.returncode:
                sys.exit(made.returncode)
            render = [tempera, "-q", "render", made.stdout.split("\n")[0], "--resolution", args.size,
                      "-o", f"{folder}/f.####.exr"]
            least = {}
            for _ in range(args.rounds):
                for spp, layers in ((1, "color"), (17, "color"), (1, "chain_motion")):
                    took = seconds_of([*render, "--frames", frame, "--spp", spp, "--layers", layers, "--threads", 1])
                    least[spp, layers] = min(took, least.get((spp, layers), took))
            if least:
                samples = 4 * (least[17, "color"] - least[1, "color"])
                motion = least[1, "chain_motion"] - least[1, "color"]
                print(f"{name}: motion {motion:.2f} s, 64 samples {samples:.2f} s: {100 * motion / samples:.1f} %", flush=True)
            if args.spp:
                seconds_of([*render, "--frames", f"{frame}-{frame + 1}", "--spp", args.spp, "--layers",
                            f"color,motion,chain.{chain}.motion"])
                done = subprocess.run([args.build / "bench/motion_warp", f"{folder}/f.{frame:04d}.exr",
                                       f"{folder}/f.{frame + 1:04d}.exr", f"class.{of_light}.color", chain],
                                      stdout=subprocess.PIPE, text=True)
                if done.returncode:
                    sys.exit(done.returncode)
                pixels, along_chain, along_surface = (float(word) for word in done.stdout.split())
                print(f"{name}: class.{of_light}.color over {pixels:.0f} pixels: along chain.{chain}.motion "
                      f"{along_chain:.3g}, along motion {along_surface:.3g}: {along_chain / along_surface:.3f}", flush=True)


if __name__ == "__main__":
    main()
