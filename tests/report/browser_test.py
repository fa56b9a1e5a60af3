#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Opens pages of `tempera compare --html` in a headless Chromium and uses them as a person does.

    browser_test.py --tempera PROGRAM [--keep FOLDER] [unittest's arguments]

What the page shows is checked against what it does not know: the EXR files as oiiotool reads them, frames as
`tempera video` encodes them, the closed form of a scene's motion, and an unpacker written from docs/report.md.
Exit status 77 (skipped) if Chromium or its driver is not installed.
"""
import argparse
import base64
import json
import math
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from browser import Browser, missing_programs  # noqa: E402

TEMPERA = ""
FOLDER = Path()
NOT_INSTALLED = 77


def tempera(*arguments, status=0):
    """Standard output of the program."""
    done = subprocess.run([TEMPERA, *map(str, arguments)], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == status, f"{arguments}: status {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def render(name, scene, frames, spp, *more, size="96x72"):
    pattern = FOLDER / name / "f.####.exr"
    tempera("render", ROOT / scene, "-o", pattern, "--frames", frames, "--spp", spp, "--resolution", size, *more)
    return pattern


def frame_file(pattern, frame):
    return Path(str(pattern).replace("####", f"{frame:04d}"))


def exr(pattern, frame):
    """[height][width] of RGB of a file, as oiiotool reads it: these channels come first."""
    text = subprocess.run(["oiiotool", "--dumpdata", frame_file(pattern, frame)], capture_output=True, text=True,
                          check=True).stdout
    rows = {}
    for x, y, values in re.findall(r"Pixel \((\d+), (\d+)\): (.*)", text):
        rows.setdefault(int(y), {})[int(x)] = [float(v) for v in values.split()[:3]]
    return [[row[x] for x in sorted(row)] for _, row in sorted(rows.items())]


def shown_by_video(pattern, frame, *display):
    """[height][width] of RGB bytes: a frame as `tempera video` encodes it, without loss."""
    movie = FOLDER / "shown.mkv"
    tempera("video", frame_file(pattern, frame), movie, "--codec", "ffv1", *display)
    probe = subprocess.run(["ffprobe", "-v", "error", "-show_entries", "stream=width,height", "-of", "csv=p=0", movie],
                           capture_output=True, text=True, check=True).stdout
    width, height = map(int, probe.strip().split(","))
    raw = subprocess.run(["ffmpeg", "-v", "error", "-i", movie, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
                         capture_output=True, check=True).stdout
    return [[tuple(raw[3 * (y * width + x):][:3]) for x in range(width)] for y in range(height)]


def png_pixels(data):
    """[height][width] of RGB of an 8-bit PNG without interlacing."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, idat = 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack(">IIBB", body[:10])
        elif kind == b"IDAT":
            idat += body
        at += 12 + size
    assert depth == 8 and color in (2, 6)
    n = 3 if color == 2 else 4
    raw, rows, above = zlib.decompress(idat), [], bytes(width * n)
    for y in range(height):
        kind, line = raw[y * (width * n + 1)], bytearray(raw[y * (width * n + 1) + 1:(y + 1) * (width * n + 1)])
        for i in range(width * n):
            a, b, c = (line[i - n] if i >= n else 0), above[i], (above[i - n] if i >= n else 0)
            if kind == 1:
                line[i] = (line[i] + a) & 255
            elif kind == 2:
                line[i] = (line[i] + b) & 255
            elif kind == 3:
                line[i] = (line[i] + (a + b) // 2) & 255
            elif kind == 4:
                p = a + b - c
                near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
                line[i] = (line[i] + near) & 255
        rows.append([tuple(line[n * x:n * x + 3]) for x in range(width)])
        above = line
    return rows


def unpack(page, block):
    """[channels][pixels] of a block, from the text of docs/report.md alone; not finite is None."""
    head, body = re.search(rf'<script type="application/octet-stream" id="{block}"([^>]*)>([^<]*)<', page).groups()
    attributes = dict(re.findall(r'data-([a-z]+)="([^"]*)"', head))
    data = json.loads(re.search(r'id="report-data">(.*?)</script>', page, re.S)[1])
    width, height, channels = data["width"], data["height"], int(attributes["channels"])
    raw, n = zlib.decompress(base64.b64decode(body)), width * height
    planes = []
    for c in range(channels):
        low, high = raw[2 * c * n:(2 * c + 1) * n], raw[(2 * c + 1) * n:(2 * c + 2) * n]
        codes = []
        for i in range(n):
            x, y = i % width, i // width
            if i == 0:
                expected = 0
            elif y == 0:
                expected = codes[i - 1]
            elif x == 0:
                expected = codes[i - width]
            else:
                w, north, nw = codes[i - 1], codes[i - width], codes[i - width - 1]
                ne = codes[i - width + 1] if x + 1 < width else north
                expected = (sorted([w, north, w + north - nw])[1] if attributes["gradient"] == "1"
                            else (w + north + nw + ne + 2) // 4)
            code = (low[i] + 256 * high[i] - 0x8080 + expected) & 0xffff
            codes.append(code - 65536 if code >= 32768 else code)
        planes.append(codes)
    signed = lambda v: (v + 32768) % 65536 - 32768  # noqa: E731
    if "step" in attributes:
        return [[None if c == -32768 else c * float(attributes["step"]) for c in plane] for plane in planes]
    if channels == 3:
        planes[0] = [signed(r + g) for r, g in zip(planes[0], planes[1])]
        planes[2] = [signed(b + g) for b, g in zip(planes[2], planes[1])]
    steps, toe = int(attributes["steps"]), float(attributes["toe"])
    return [[None if c == -32768 else math.copysign(toe * (2 ** (abs(c) / steps) - 1), c) for c in plane]
            for plane in planes]


class ReportPage(unittest.TestCase):
    """One browser and one comparison for all tests: a box in motion, two noisy renders and a reference."""

    WIDTH, HEIGHT = 1500, 900
    FRAMES = range(1, 7)

    @classmethod
    def setUpClass(cls):
        scene = "scenes/tests/cornell_motion.xml"
        cls.coarse = render("coarse", scene, "1-6", 4, "--seed", 1)
        cls.fine = render("fine", scene, "1-6", 32, "--seed", 2)
        cls.reference = render("reference", scene, "1-6", 128, "--seed", 3, "--layers", "motion")
        cls.page = FOLDER / "report.html"
        cls.table = FOLDER / "figures.json"
        tempera("compare", cls.coarse, cls.fine, "--reference", cls.reference, "--html", cls.page, "--json", cls.table)
        cls.browser = Browser(cls.WIDTH, cls.HEIGHT)

    @classmethod
    def tearDownClass(cls):
        cls.browser.close()

    def open(self, fragment="", page=None):
        self.browser.messages()
        self.browser.open(page or self.page, fragment)
        self.browser.run("await temperaReport.settled()")
        self.assertEqual(self.browser.run("return temperaReport.errors"), [])

    def tearDown(self):
        complaints = [m["message"] for m in self.browser.messages() if m["level"] in ("SEVERE", "WARNING")]
        self.assertEqual(complaints, [], "what the browser complained about")

    def state(self):
        return self.browser.run("await temperaReport.settled(); return temperaReport.state")

    def show(self, **state):
        """Sets what is shown, as the page's own controls do, and waits for it."""
        self.browser.run("temperaReport.set(args[0]); await temperaReport.settled()", state)

    def box(self, selector):
        """Left, top, width and height of an element on the screen."""
        return self.browser.run("""const box = document.querySelector(args[0]).getBoundingClientRect();
            return [box.left, box.top, box.width, box.height];""", selector)

    def text(self, selector):
        return self.browser.run("return document.querySelector(args[0]).innerText", selector)

    def place_of_picture(self, scale):
        """Left and top of a centered picture of 96x72 on the screen, for a zoom of `scale`."""
        left, top, width, height = self.box("#view")
        return left + width / 2 - 48 * scale, top + height / 2 - 36 * scale

    def map_of(self, name, side, frame, base=None):
        """Values of a map, row by row; what has no value is None."""
        return self.browser.run("return temperaReport.map(args[0], args[1], args[2], args[3])", name, side, frame,
                                {} if base is None else {"base": base})

    def mean_of_map(self, *arguments):
        values = [v for v in self.map_of(*arguments) if v is not None]
        return sum(values) / len(values)

    def assert_close(self, value, expected, relative=0.02, floor=2e-3):
        for v, e in zip(value, expected, strict=True):
            self.assertAlmostEqual(v, e, delta=relative * abs(e) + floor)

    # --- What is shown ---

    def test_shows_a_and_b_as_movies_do(self):
        for tone in ("srgb", "filmic"):
            self.open(f"frame=2&mode=split&a=0&b=2&zoom=4&center=48,36&tone={tone}&exposure=0.5")
            left, top = self.place_of_picture(4)
            screen = png_pixels(self.browser.screenshot())
            sides = [shown_by_video(p, 2, "--tone-map", tone, "--exposure", 0.5) for p in (self.coarse, self.reference)]
            divider = self.box("#divider")[0] + 7
            checked, worst = [0, 0], 0
            for y in range(3, 69):
                for x in range(3, 93):
                    px, py = round(left + 4 * x + 2), round(top + 4 * y + 2)
                    if abs(px - divider) < 20:
                        continue
                    side = int(px > divider)
                    checked[side] += 1
                    worst = max(worst, *(abs(a - b) for a, b in zip(screen[py][px], sides[side][y][x])))
            self.assertGreater(min(checked), 1000)
            # A step of the stored values is a level or two of the display.
            self.assertLessEqual(worst, 4, tone)

    def test_the_divider_can_be_dragged(self):
        self.open("mode=split")
        box = self.box("#view")
        y = box[1] + box[3] / 3
        self.browser.drag((box[0] + box[2] / 2, y), (box[0] + box[2] / 4, y))
        self.assertAlmostEqual(self.state()["split"], 0.25, delta=0.01)

    def test_zoom_and_pan_are_shared_by_all_pictures(self):
        self.open("mode=grid&zoom=4&center=48,36")
        cells = png_pixels(self.browser.screenshot())
        self.assertGreater(len(set(cells[300])), 20)
        box = self.box("#view")
        self.browser.wheel(box[0] + 100, box[1] + 100, -300)
        zoomed = self.state()
        self.assertGreater(zoomed["zoom"], 5)
        self.browser.drag((box[0] + 100, box[1] + 100), (box[0] + 140, box[1] + 70))
        moved = self.state()
        self.assertAlmostEqual(zoomed["center"][0] - moved["center"][0], 40 / zoomed["zoom"], delta=0.01)
        self.assertAlmostEqual(zoomed["center"][1] - moved["center"][1], -30 / zoomed["zoom"], delta=0.01)
        self.browser.press("z")
        self.assertEqual(self.state()["zoom"], 0)

    def test_keys_scrub_flip_and_choose(self):
        self.open("mode=split")
        self.browser.press("ArrowRight", "ArrowRight")
        self.assertEqual(self.state()["frame"], 3)
        self.browser.press("End")
        self.assertEqual(self.state()["frame"], 6)
        self.browser.press("Home")
        self.assertEqual(self.state()["frame"], 1)
        self.browser.press("f")
        self.assertEqual((self.state()["mode"], self.state()["flipped"]), ("flip", False))
        one = self.browser.screenshot()
        self.browser.press("f")
        self.assertTrue(self.state()["flipped"])
        self.assertNotEqual(one, self.browser.screenshot())
        self.browser.press("2", "x")
        state = self.state()
        self.assertEqual((state["a"], state["b"]), (2, 1))
        self.browser.press("]", "]", "t")
        state = self.state()
        self.assertEqual((state["exposure"], state["tone"]), (1, "filmic"))
        self.browser.press("e")
        self.assertEqual(self.state()["showA"], self.browser.run("return temperaReport.maps[0].id"))
        self.browser.press("?")
        self.assertTrue(self.browser.run("return document.getElementById('help').open"))
        self.browser.press("Escape")

    def test_the_scrubber_moves_all_pictures(self):
        self.open("mode=grid")
        first = self.browser.screenshot()
        left, top, width, height = self.box("#scrubber")
        self.browser.click(left + width * 0.6, top + height / 2)
        self.assertEqual(self.state()["frame"], 4)
        self.assertNotEqual(first, self.browser.screenshot())
        self.assertIn("frame 4", self.text("#frame-value"))

    def test_plays(self):
        self.open("frame=1")
        self.browser.run("document.getElementById('fps').value = 60")
        seen = self.browser.run("""
            const seen = new Set(), end = performance.now() + 5000;
            document.getElementById("play").click();
            while (performance.now() < end && seen.size < 6) {
              seen.add(temperaReport.state.frame);
              await new Promise((resolve) => setTimeout(resolve, 3));
            }
            document.getElementById("play").click();
            return [...seen].sort();""")
        self.assertEqual(seen, list(self.FRAMES))

    # --- Values ---

    def test_a_click_on_a_pixel_reads_its_values_over_time(self):
        self.open("frame=3&mode=flip&a=1&zoom=6&center=48,36")
        left, top = self.place_of_picture(6)
        x, y = 30, 50
        self.browser.click(left + 6 * x + 3, top + 6 * y + 3)
        self.assertEqual(self.state()["pixel"], [x, y])
        self.browser.move(left + 6 * x + 3, top + 6 * y + 4)
        number = r"(?:−?[\d.]+(?:e−?\d+)?)"
        tooltip = self.text("#tooltip")
        rows = {name.strip(): [float(v.replace("−", "-")) for v in values.split()]
                for name, values in re.findall(rf"^(\S+)\s+({number}\s+{number}\s+{number})\s*$", tooltip, re.M)}
        self.assertEqual(set(rows), {"fine", "reference"}, tooltip)
        self.assert_close(rows["fine"], exr(self.fine, 3)[y][x])
        self.assert_close(rows["reference"], exr(self.reference, 3)[y][x])

        for frame in self.FRAMES:
            self.show(frame=frame, channel="green")
            text = self.text("#pixel .plot-readout").replace("−", "-")
            for name, pattern in (("coarse", self.coarse), ("fine", self.fine), ("reference", self.reference)):
                value = float(re.search(rf"{name}\s+(\S+)", text)[1])
                self.assert_close([value], [exr(pattern, frame)[y][x][1]])

    def test_slices_are_columns_over_time(self):
        self.open()
        for axis, length in (("column", 31), ("row", 0)):
            how = {"axis": axis, "length": length}
            slice_ = self.browser.run("return temperaReport.slice(1, 40, 20, args[0])", how)
            size = slice_["size"]
            self.assertEqual(size, length or 96)
            for f, frame in enumerate(self.FRAMES):
                image = exr(self.fine, frame)
                self.assert_close(slice_["series"][f], image[20][40])
                for k in range(size):
                    x, y = (40, 20 - size // 2 + k) if axis == "column" else (k, 20)
                    values = slice_["values"][(k * 6 + f) * 3:][:3]
                    if y < 0:
                        self.assertEqual(values, [None] * 3, "above the picture is nothing")
                    else:
                        self.assert_close(values, image[y][x])

    def test_slices_are_drawn(self):
        self.open("pixel=40,20&frame=2")
        canvas = ".slice[data-side='2'] canvas"
        self.browser.run("document.querySelector(args[0]).scrollIntoView({ block: 'center' })", canvas)
        box = self.box(canvas)
        screen = png_pixels(self.browser.screenshot())
        for f, frame in enumerate(self.FRAMES):
            expected = shown_by_video(self.reference, frame)
            for row in (30, 40, 60):  # rows 95 tall around y = 20: row k shows y = k - 27
                x, y = round(box[0] + box[2] * (f + 0.5) / 6), round(box[1] + box[3] * (row + 0.5) / 95)
                worst = max(abs(a - b) for a, b in zip(screen[y][x], expected[row - 27][40]))
                self.assertLessEqual(worst, 4)
        self.browser.click(box[0] + box[2] * 4.5 / 6, box[1] + 20)
        self.assertEqual(self.state()["frame"], 5)

    def test_tracks_follow_the_motion(self):
        # The card of the scene moves by (0.5, 0.25) metres a second; its camera sees 2 * 5 * tan(20 degrees) metres.
        for layers in ("motion", "motion.backward"):
            card = render("card", "scenes/tests/card_translate.gltf", "1-12", 16, "--fps", 12, "--layers", layers,
                          "--shutter", "0,0.01", size="96x96")
            page = FOLDER / "card.html"
            tempera("compare", card, "--html", page)
            self.open(page=page)
            slice_ = self.browser.run("return temperaReport.slice(0, 44, 52, { origin: 4, track: true })")
            step = 96 / (2 * 5 * math.tan(math.radians(20))) / 12
            for i, position in enumerate(slice_["positions"]):
                self.assertIsNotNone(position, f"frame {i + 1}, {layers}")
                self.assertAlmostEqual(position[0], 44.5 + 0.5 * step * (i - 3), delta=0.5)
                self.assertAlmostEqual(position[1], 52.5 - 0.25 * step * (i - 3), delta=0.5)
            still = self.browser.run("return temperaReport.slice(0, 44, 52, { origin: 4, track: false })")
            change = lambda s: sum(abs(a[1] - b[1]) for a, b in zip(s["series"], s["series"][1:]))  # noqa: E731
            self.assertLess(change(slice_), 0.5 * change(still) + 1e-3, "the tracked point keeps its texture")
            self.show(pixel=[44, 52], origin=4, track=True)

    def test_maps_agree_with_the_metrics(self):
        """The mean of a map is the figure of its frame: those that the page computes, and those that it holds."""
        self.open()
        figures = json.loads(self.table.read_text())
        maps = self.browser.run("return temperaReport.maps.map((m) => m.id)")
        for name in ("relmse", "mse", "flip", "signed", "temporal", "temporal_compensated", "change"):
            self.assertIn(name, maps)
        for metric in [m["id"] for m in figures["metrics"] if m["id"] in maps]:
            for side in (0, 1):
                values = figures["sides"][side]["values"][metric]
                for frame in (2, 5):
                    mean, expected = self.mean_of_map(metric, side, frame), values[frame - 1]
                    # Vectors are stored to 1/16 of a pixel, which moves the samples of compensated maps.
                    tolerance = 0.05 if metric == "temporal_compensated" else 0.02
                    self.assertAlmostEqual(mean, expected, delta=tolerance * expected, msg=f"{metric} {side} {frame}")
        self.assertEqual(max(self.map_of("relmse", 2, 1)), 0)

    def test_differences_in_time(self):
        self.open()
        test, reference = ([exr(p, f) for f in (2, 3)] for p in (self.coarse, self.reference))
        values = self.map_of("temporal", 0, 3)
        for x, y in ((10, 10), (50, 40), (80, 60)):
            expected = 0
            for c in range(3):
                change, base = ([image[y][x][c] for image in images] for images in (test, reference))
                difference = (change[1] - change[0]) - (base[1] - base[0])
                expected += difference ** 2 / ((base[0] ** 2 + base[1] ** 2) / 2 + 0.01) / 3
            self.assertAlmostEqual(values[y * 96 + x], expected, delta=0.1 * expected + 2e-3)
        self.assertIsNone(self.map_of("temporal", 0, 1), "no frame is before the first")

    def test_the_packing_is_the_documented_one(self):
        text = self.page.read_text()
        for block, pattern, frame in (("picture-0-2", self.coarse, 2), ("picture-reference-5", self.reference, 5)):
            planes, image = unpack(text, block), exr(pattern, frame)
            for c in range(3):
                self.assert_close(planes[c], [image[i // 96][i % 96][c] for i in range(96 * 72)])

    # --- Figures ---

    def test_the_table_holds_the_figures(self):
        self.open()
        figures = json.loads(self.table.read_text())
        rows = self.browser.run("""
            const numbers = (row) => [...row.querySelectorAll("td")].map((cell) => cell.firstChild.textContent);
            return [...document.querySelectorAll("#metrics tbody tr")].map((row) =>
                [row.querySelector("th button")?.textContent, ...numbers(row)]);""")
        titles = {m["title"]: m["id"] for m in figures["metrics"]}
        self.assertEqual({r[0] for r in rows if r[0]}, set(titles))
        for title, *cells in rows:
            for side, cell in enumerate(cells):
                mean = figures["sides"][side]["mean"][titles[title]]
                shown = float(cell.replace("−", "-")) if cell not in ("–", "∞") else None
                if mean is not None:
                    self.assertAlmostEqual(shown, mean, delta=1e-3 * abs(mean))
        self.browser.run("""[...document.querySelectorAll("#metrics tbody button")]
            .find((button) => button.textContent === "FLIP").click()""")
        self.assertEqual(self.state()["metric"], "flip")
        self.show(frame=4)
        shown = float(re.search(r"coarse\s+(\S+)", self.text("#frames .plot-readout"))[1])
        self.assertAlmostEqual(shown, figures["sides"][0]["values"]["flip"][3], delta=1e-3)
        paths = self.browser.run("""return [...document.querySelectorAll("#frames path.line")]
            .map((path) => path.getAttribute("d"))""")
        self.assertEqual([len(re.findall("[ML]", path)) for path in paths], [6, 6])

    # --- Addresses ---

    def test_the_address_keeps_what_is_shown(self):
        fragment = ("frame=5&a=1&b=0&showA=flip&showB=relmse&exposure=-1.5&split=0.3&zoom=7&center=20,30&pixel=12,13&"
                    "origin=2&track=true&axis=row&channel=blue")
        self.open(fragment)
        state = self.state()
        expected = {"frame": 5, "a": 1, "b": 0, "showA": "flip", "pixel": [12, 13], "origin": 2, "track": True}
        self.assertEqual({key: state[key] for key in expected}, expected)
        self.browser.run("await new Promise((resolve) => setTimeout(resolve, 400))")
        address = self.browser.run("return location.hash.slice(1)")
        self.assertEqual(sorted(address.split("&")), sorted(fragment.split("&")))
        picture = self.browser.screenshot()
        self.open(address)
        self.assertEqual(picture, self.browser.screenshot())

    def test_addresses_that_make_no_sense_do_no_harm(self):
        self.open("frame=99&a=7&mode=%3Cscript%3E&showA=nothing&zoom=-3&center=NaN,1&pixel=1e9,2&range.relmse=5,1&"
                  "exposure=abc&metric=x")
        self.assertEqual(self.state(), self.browser.run("temperaReport.set({}); return temperaReport.state"))
        self.assertEqual(self.state()["frame"], 1)

    # --- Other comparisons ---

    def test_without_a_reference(self):
        page = FOLDER / "plain.html"
        tempera("compare", self.coarse, self.fine, "--html", page)
        self.open("showA=change&frame=2", page)
        self.assertIsNone(self.browser.run("return temperaReport.data.reference"))
        self.assertFalse(self.browser.run("return Boolean(document.getElementById('metrics'))"))
        self.assertEqual(self.state()["b"], 1)
        self.assertFalse(self.browser.run("return document.getElementById('legend').hidden"))
        self.assertGreater(self.mean_of_map("relmse", 0, 2, 1), 0)
        tempera("compare", self.coarse, self.fine, status=2)

    def test_a_single_frame(self):
        page = FOLDER / "single.html"
        tempera("compare", frame_file(self.coarse, 2), "--reference", frame_file(self.reference, 2), "--html", page)
        self.open("pixel=5,6", page)
        self.assertTrue(self.browser.run("return document.getElementById('transport').hidden"))
        self.assert_close(self.browser.run("return temperaReport.pixel(0, 2, 5, 6)"), exr(self.coarse, 2)[6][5])
        maps = self.browser.run("return temperaReport.maps.map((m) => m.id)")
        self.assertNotIn("temporal", maps)

    def test_sequences_with_other_frames(self):
        part = FOLDER / "part"
        part.mkdir(exist_ok=True)
        for frame in (2, 3, 5):
            shutil.copy(frame_file(self.fine, frame), part)
        page = FOLDER / "part.html"
        tempera("compare", self.coarse, part / "f.####.exr", "--reference", self.reference, "--html", page)
        self.open("frame=4&a=0&b=1&pixel=3,4", page)
        labels = self.browser.run("return document.getElementById('labels').innerText")
        self.assertIn("part has no frame 4", labels)
        self.assertIsNone(self.browser.run("return temperaReport.pixel(1, 4, 3, 4)"))
        self.assert_close(self.browser.run("return temperaReport.pixel(1, 5, 3, 4)"), exr(self.fine, 5)[4][3])

    def test_hostile_names(self):
        folder = FOLDER / "<img src=x onerror=\"document.title='owned'\">&'"
        folder.mkdir(exist_ok=True)
        shutil.copy(frame_file(self.coarse, 1), folder)
        page = FOLDER / "hostile.html"
        title = "</title><script>document.title='owned'</script>{{data}}"
        tempera("compare", folder / "f.0001.exr", "--reference", frame_file(self.reference, 1), "--html", page,
                "--title", title)
        self.open("pixel=3,4&showA=relmse", page)
        self.assertEqual(self.browser.run("return document.title"), title)
        self.assertEqual(self.browser.run("return document.images.length"), 0)
        self.assertIn("<img src=x", self.browser.run("return document.body.innerText"))

    def test_smaller_pictures(self):
        page = FOLDER / "half.html"
        tempera("compare", self.fine, "--reference", self.reference, "--html", page, "--html-scale", 50)
        self.open("pixel=10,11", page)
        image = exr(self.fine, 1)
        mean = [sum(image[y][x][c] for y in (22, 23) for x in (20, 21)) / 4 for c in range(3)]
        self.assert_close(self.browser.run("return temperaReport.pixel(0, 1, 10, 11)"), mean)
        self.assertIn("48x36", self.browser.run("return document.querySelector('#pixel .note').textContent"))


class LargePage(unittest.TestCase):
    """24 frames of 640x360 of three methods with a reference: the size and the time that issue 3 sets as limits."""

    def test_stays_small_and_opens_quickly(self):
        sides = []
        for name, spp in (("one", 1), ("two", 2), ("three", 3), ("many", 8)):
            sides.append(render(f"large_{name}", "scenes/demo/shot.toml", "1-24", spp, "--seed", spp, "--filter", "box",
                                "--layers", "motion", size="640x360"))
        page = FOLDER / "large.html"
        tempera("compare", *sides[:3], "--reference", sides[3], "--html", page)
        size = page.stat().st_size
        with Browser(1500, 900) as browser:
            browser.open(page)
            browser.run("await temperaReport.ready")
            first, parsed = browser.run("""return [performance.getEntriesByName("first-picture")[0].startTime,
                performance.getEntriesByType("navigation")[0].domContentLoadedEventEnd]""")
            browser.run("""temperaReport.set({ pixel: [300, 200], mode: "grid", showA: "flip", frame: 24 });
                           await temperaReport.settled();""")
            self.assertEqual(browser.run("return temperaReport.errors"), [])
            complaints = [m["message"] for m in browser.messages() if m["level"] in ("SEVERE", "WARNING")]
        print(f"{size / 1e6:.1f} MB: first picture after {first / 1e3:.2f} s, all read after {parsed / 1e3:.2f} s")
        self.assertEqual(complaints, [])
        self.assertLess(size, 60e6)
        self.assertLess(first, 3000)
        self.assertLess(parsed, 3000)


def main() -> int:
    global TEMPERA, FOLDER
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tempera", required=True, help="the program to test")
    parser.add_argument("--keep", type=Path, help="work in this folder and leave everything there")
    options, rest = parser.parse_known_args()
    if missing := missing_programs():
        print(f"skipped: {' and '.join(missing)} not installed; `./dev test --slow` installs Debian's packages")
        return NOT_INSTALLED
    TEMPERA = str(Path(options.tempera).resolve())
    with tempfile.TemporaryDirectory(prefix="tempera_report_") as temporary:
        FOLDER = (options.keep or Path(temporary)).resolve()
        FOLDER.mkdir(parents=True, exist_ok=True)
        program = unittest.main(argv=[sys.argv[0], *rest], exit=False, verbosity=2)
    return 0 if program.result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
