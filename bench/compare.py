#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Time and memory of `tempera compare`: three methods against a reference, with synthetic frames of noise.

The target is 48 frames of 1280x720 pixels in under 60 s on two cores and under 2 GB, with the default metrics, which
include FLIP and flicker. Results go to <build>/bench/compare.json.

  ./dev bench compare                      the default metrics, and all of them
  ./dev bench compare --metrics relmse     others; repeatable
  ./dev bench compare --frames 8           a short run
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
METHODS = ("method1", "method2", "method3")


def measure(command):
    """Wall seconds, processor seconds and peak MiB of a command; raises on failure."""
    with tempfile.TemporaryFile("w+") as output:
        begin = time.time()
        process = subprocess.Popen([str(c) for c in command], stdout=output, stderr=output)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.time() - begin
        if status:
            output.seek(0)
            raise RuntimeError(f"{' '.join(map(str, command))}: status {status}\n{output.read()}")
    return {"seconds": wall, "cpu_seconds": usage.ru_utime + usage.ru_stime, "memory_mib": usage.ru_maxrss / 1024}


def main(arguments):
    parser = argparse.ArgumentParser(prog="./dev bench compare", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--metrics", action="append", help="as of tempera compare; repeatable [default, all]")
    parser.add_argument("--data", type=pathlib.Path, help="keep the sequences in this folder, and use those that are there")
    args = parser.parse_args(arguments)

    with tempfile.TemporaryDirectory() as temporary:
        data = args.data or pathlib.Path(temporary)
        if not (data / "reference").exists():
            subprocess.run([args.build / "bench/compare_sequences", data, "--frames", str(args.frames), "--size",
                            args.size, "--methods", str(len(METHODS))], check=True)
        results = {"frames": args.frames, "size": args.size, "threads": args.threads, "methods": len(METHODS)}
        for metrics in args.metrics or ["default", "all"]:
            results[metrics] = r = measure(
                [args.build / "bin/tempera", "compare", *(data / m / "f.####.exr" for m in METHODS), "--reference",
                 data / "reference/f.####.exr", "--frames", f"1-{args.frames}", "--threads", args.threads, "--metrics",
                 metrics])
            print(f"{args.frames} frames of {args.size}, {len(METHODS)} methods, {args.threads} threads, "
                  f"{metrics} metrics: {r['seconds']:.1f} s, {r['cpu_seconds']:.1f} s of processor time, "
                  f"peak {r['memory_mib']:.0f} MiB", flush=True)
    target = args.build / "bench/compare.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(results, indent=1))
    print(f"written: {target}")


if __name__ == "__main__":
    main(sys.argv[1:])
