#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What a sample of the gradient-domain integrators costs, as a multiple of one of `path`, by scene.

Each integrator renders the same frames with few and with many samples, on one thread; the difference of the processor
times is that of the samples alone. All take turns, and the least time of each counts, as machines are shared. A sample
of temporal_gradient_path is one of either of its two passes. Reconstruction is not in it.

  ./dev bench cost
  ./dev bench cost --scene glass-egg@320x180 --rounds 5
"""
import argparse
import pathlib
import resource
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
INTEGRATORS = ("path", "gradient_path", "temporal_gradient_path")


def seconds_of(command):
    """Processor seconds of a command; ends the program with its messages if it fails."""
    def now():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime
    begin = now()
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}")
    return now() - begin


def main():
    parser = argparse.ArgumentParser(prog="./dev bench cost", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=lambda s: s.split(","), help="comma list of the gallery, NAME@WxH",
                        default="running-figure@120x68,cornell-motion@80x80,modern-hall@120x68,glass-egg@120x68")
    parser.add_argument("--frames", default="5-6", help="[5-6]")
    parser.add_argument("--spp", default="8,40", help="few and many samples [8,40]")
    parser.add_argument("--rounds", type=int, default=3, help="[3]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    few, many = (int(n) for n in args.spp.split(","))
    if not 0 < few < many or args.rounds < 1:
        parser.error("--spp wants two numbers, the second larger, and --rounds one at least")
    tempera = args.build / "bin/tempera"
    print("| scene | " + " | ".join(f"`{i}`" for i in INTEGRATORS[1:]) + " |\n" + "| --- " * len(INTEGRATORS) + "|")
    with tempfile.TemporaryDirectory() as folder:
        for text in args.scene:
            name, _, size = text.partition("@")
            made = subprocess.run([tempera, "-q", "gallery", "make", name, "--gallery", f"{folder}/scenes"],
                                  stdout=subprocess.PIPE, text=True)
            if made.returncode:
                sys.exit(made.returncode)
            shot = made.stdout.split("\n")[0]
            least = {}
            for _ in range(args.rounds):
                for integrator in INTEGRATORS:
                    for spp in (few, many):
                        took = seconds_of([tempera, "-q", "render", shot, "--frames", args.frames, "--integrator",
                                           integrator, "--spp", spp, "--layers", "color", "--threads", 1,
                                           *(["--resolution", size] if size else []), "-o", f"{folder}/f.####.exr"])
                        key = integrator, spp
                        least[key] = min(took, least.get(key, took))
            cost = {i: least[i, many] - least[i, few] for i in INTEGRATORS}
            if cost["path"] <= 0:
                sys.exit(f"cost: {name} takes too little time to measure; more samples (--spp) would do")
            print(f"| `{name}` | " + " | ".join(f"{cost[i] / cost['path']:.1f}" for i in INTEGRATORS[1:]) + " |", flush=True)


if __name__ == "__main__":
    main()
