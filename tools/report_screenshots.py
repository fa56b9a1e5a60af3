#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Takes pictures of a page that `tempera compare --html` wrote, for documents.

    tools/report_screenshots.py report.html --out docs/images --pixel 250,200 --frame 12
    tools/report_screenshots.py report.html --out shots --shot "night=exposure=3&mode=split"

Without --shot it takes those that show what the page can do:

  split       the first sequence and the reference, with a line between them
  grid        all sequences side by side
  errors      maps of the first two sequences, with the metrics beside them
  temporal    the temporal error of the same two
  pixel       a pixel over time and slices, along motion vectors if there are some

A shot is NAME=ADDRESS, the address being what stands behind '#' when "Copy link" is pressed in the page. Files are
named after the page and the shot. Needs Debian's packages chromium and chromium-driver.
"""
import argparse
import sys
from pathlib import Path

from browser import Browser, BrowserError


def standard_shots(data: dict, maps: list[str], frame: int | None, pixel: tuple[int, int] | None) -> dict[str, str]:
    """Name -> address, for what the page holds."""
    frames, sides = data["frames"], data["sides"]
    frame = frame if frame is not None else frames[len(frames) // 2]
    x, y = pixel or (data["width"] // 2, data["height"] // 2)
    second = 1 if len(sides) > 1 else 0
    here = f"frame={frame}&panel=false"
    shots = {"split": here}
    if len(sides) > 1:
        shots["grid"] = f"{here}&mode=grid"
    error = next((m for m in ("flip", "relmse") if m in maps), None)
    if error:
        shots["errors"] = f"frame={frame}&a=0&b={second}&showA={error}&showB={error}"
    if "temporal" in maps and frame != frames[0]:
        shots["temporal"] = f"frame={frame}&a=0&b={second}&showA=temporal&showB=temporal"
    if len(frames) > 1:
        follow = "&track=true" if data["motion"]["forward"] or data["motion"]["backward"] else ""
        shots["pixel"] = f"frame={frame}&origin={frame}&a=0&pixel={x},{y}{follow}"
    return shots


def numbers(text: str) -> tuple[int, int]:
    x, y = map(int, text.split(","))
    return x, y


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, help="the page")
    parser.add_argument("--out", type=Path, default=Path("."), help="folder for the pictures [.]")
    parser.add_argument("--shot", action="append", default=[], metavar="NAME=ADDRESS", help="take this one; repeatable")
    parser.add_argument("--frame", type=int, help="frame of the standard shots [the middle one]")
    parser.add_argument("--pixel", type=numbers, metavar="X,Y", help="pixel of the standard shots [the middle one]")
    parser.add_argument("--size", type=numbers, default=(1440, 810), metavar="W,H", help="of the page [1440,810]")
    parser.add_argument("--format", choices=("png", "jpeg", "webp"), default="jpeg", help="of the files [jpeg]")
    parser.add_argument("--quality", type=int, default=85, help="of jpeg and webp, 1 to 100 [85]")
    options = parser.parse_args()
    if not options.report.is_file():
        parser.error(f"there is no file {options.report}")
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        with Browser(*options.size) as browser:
            browser.open(options.report)
            data, maps = browser.run("return [temperaReport.data, temperaReport.maps.map((m) => m.id)]")
            shots = (dict(shot.split("=", 1) for shot in options.shot) if options.shot else
                     standard_shots(data, maps, options.frame, options.pixel))
            for name, address in shots.items():
                browser.open(options.report, address)
                browser.run("await temperaReport.settled()")
                if "pixel=" in address and "panel=false" not in address:
                    # The plot and the slices need the room that the other figures take.
                    browser.run("""for (const id of ["metrics", "frames"]) {
                                     document.getElementById(id)?.removeAttribute("open");
                                   }
                                   await temperaReport.settled();""")
                if errors := browser.run("return temperaReport.errors"):
                    raise BrowserError("; ".join(errors))
                suffix = "jpg" if options.format == "jpeg" else options.format
                file = options.out / f"{options.report.stem}-{name}.{suffix}"
                browser.screenshot(file, options.format, options.quality)
                print(file)
    except BrowserError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
