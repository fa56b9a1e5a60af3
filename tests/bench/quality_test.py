#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""bench/quality.py: its statistics, how it reads methods, and a small comparison whose outcome is known.

  python3 tests/bench/quality_test.py --tempera build/release/bin/tempera
"""
import argparse
import importlib.util
import json
import math
import pathlib
import random
import statistics
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
SPEC = importlib.util.spec_from_file_location("quality", ROOT / "bench/quality.py")
quality = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(quality)
TEMPERA = None


class Statistics(unittest.TestCase):
    def test_interval_of_known_pairs(self):
        # Logarithms -1, 0, 1: mean 0, standard error 1/sqrt(3), t(2) = 4.303.
        ratio, low, high = quality.ratio_interval([math.exp(-1), 1, math.e], [1, 1, 1])
        self.assertAlmostEqual(ratio, 1)
        self.assertAlmostEqual(math.log(high), 4.303 / math.sqrt(3), 3)
        self.assertAlmostEqual(low * high, 1)

    def test_pairing_removes_what_seeds_share(self):
        base = [1.0, 5.0, 0.2, 30.0]
        ratio, low, high = quality.ratio_interval([0.25 * b for b in base], base)
        self.assertAlmostEqual(ratio, 0.25)
        self.assertAlmostEqual(low, high)

    def test_missing_values_leave_out_their_pair(self):
        self.assertAlmostEqual(quality.ratio_interval([None, 2, 8], [1, 1, 4])[0], 2)
        self.assertEqual(quality.ratio_interval([None], [1]), (None, None, None))
        self.assertEqual(quality.ratio_interval([3], [1])[1:], (None, None))

    def test_noise_of_references_is_taken_out(self):
        rng = random.Random(3)
        n, truth, error = 20000, 0.7, 0.05
        x, a, b = ([truth + rng.gauss(0, s) for _ in range(n)] for s in (error, 0.1, 0.2))
        square = lambda p, q: statistics.fmean((u - v) ** 2 for u, v in zip(p, q))
        figure = quality.without_noise("mse", square(x, a), square(x, b), square(a, b))
        self.assertAlmostEqual(figure / error ** 2, 1, delta=0.15)
        self.assertEqual(quality.without_noise("bias", 1, 3, 7), 2)
        self.assertIsNone(quality.without_noise("mse", 1, None, 1))

    def test_interval_covers_as_often_as_it_says(self):
        rng, hits, trials = random.Random(5), 0, 2000
        for _ in range(trials):
            pairs = [math.exp(rng.gauss(math.log(0.25), 0.3)) for _ in range(5)]
            _, low, high = quality.ratio_interval(pairs, [1] * 5)
            hits += low <= 0.25 <= high
        self.assertAlmostEqual(hits / trials, 0.95, delta=0.02)


class Methods(unittest.TestCase):
    def test_settings_go_where_they_belong(self):
        m = quality.Method("path:spp=16:sampler=independent:max_depth=4:film.filter=tent")
        self.assertEqual((m.name, m.wanted_spp), ("path", 16))
        self.assertEqual(m.render, ["--sampler", "independent", "--param", "max_depth=4", "--set", "film.filter=tent"])
        g = quality.Method("gradient_path:norm=l2")
        self.assertEqual((g.wanted_spp, g.render, g.stage), (None, [], ["--norm", "l2"]))

    def test_frame_sets(self):
        self.assertEqual(quality.frames_of("1-4"), [1, 2, 3, 4])
        self.assertEqual(quality.frames_of("3,10-14x2,1..2"), [3, 10, 12, 14, 1, 2])

    def test_wrong_settings_end_the_program(self):
        for text in ("path:spp=0", "path:spp=many", "path:sampler", "path:=3"):
            with self.assertRaises(SystemExit):
                quality.Method(text)


class Comparison(unittest.TestCase):
    def bench(self, *arguments):
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            (folder / "bin").mkdir()
            (folder / "bin/tempera").symlink_to(TEMPERA.resolve())
            done = subprocess.run([sys.executable, ROOT / "bench/quality.py", "--build", folder, "--work", folder / "work",
                                   *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            self.assertEqual(done.returncode, 0, done.stdout)
            return json.loads(next((folder / "bench").glob("quality-*.json")).read_text())[-1], done.stdout

    def test_four_times_the_samples_are_a_quarter_of_the_error(self):
        stored, text = self.bench(
            "--scene", "cornell-motion", "--resolution", "64x64", "--frames", "1-2", "--seeds", "6", "--reference-spp", "4096",
            "--methods", "path:spp=4,path:spp=16", "--metrics", "mse,relmse,temporal")
        second = stored["results"][1]
        for metric in ("mse", "relmse"):
            ratio, low, high = second["ratios"][metric]
            self.assertLessEqual(low, 0.25 * 1.02, text)
            self.assertGreaterEqual(high, 0.25 * 0.98, text)
            self.assertLess(high / low, 1.6, "the interval says nothing: " + text)
        self.assertLess(second["ratios"]["temporal"][2], 0.5, text)
        self.assertLess(stored["noise"]["relmse"], 0.1 * second["figures"][0]["relmse"], text)

    def test_equal_time_is_met(self):
        stored, text = self.bench("--scene", "cornell-motion", "--resolution", "128x128", "--frames", "1", "--seeds", "1",
                                  "--reference-spp", "64", "--time", "4", "--methods", "path", "--metrics", "relmse")
        method = stored["results"][0]
        self.assertGreater(method["spp"], 4, text)
        # The machine may be busy: what is checked is that calibration converged to the order of the target.
        self.assertLess(abs(math.log(method["seconds"][0] / 4)), math.log(2), text)

    def test_equal_error_finds_the_samples(self):
        stored, text = self.bench("--scene", "cornell-motion", "--resolution", "64x64", "--frames", "1", "--reference-spp",
                                  "4096", "--equal-error", "relmse=0.05", "--methods", "path")
        found = stored["results"][0]
        self.assertAlmostEqual(math.log(found["relmse"] / 0.05), 0, delta=math.log(1.25), msg=text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--tempera", type=pathlib.Path, required=True)
    known, rest = parser.parse_known_args()
    TEMPERA = known.tempera
    unittest.main(argv=[sys.argv[0], *rest])
