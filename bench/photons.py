#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What photons cost on one thread: tracing, the memory of their map, and a query of what arrives at a point.

  ./dev bench photons
  ./dev bench photons --photons 100000 --overlap 16
"""
import argparse
import pathlib
import subprocess
import sys

from cost import ROOT


def main():
    parser = argparse.ArgumentParser(prog="./dev bench photons", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photons", type=int, default=1000000, help="[1000000]")
    parser.add_argument("--overlap", type=float, default=0, help="footprints over a point; 0: the default [0]")
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    args = parser.parse_args()
    sys.exit(subprocess.run([args.build / "bench/photon_rate", str(args.photons), str(args.overlap)]).returncode)


if __name__ == "__main__":
    main()
