#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""bench/quality.py: its statistics, how it reads methods, and a small comparison whose outcome is known.

  python3 tests/bench/quality_test.py --tempera build/release/bin/tempera
"""
import argparse
import contextlib
import importlib.util
import io
import json
import math
import pathlib
import random
import shutil
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

    def test_mean_with_its_interval(self):
        mean, half = quality.mean_interval([1, None, 2, 3])
        self.assertEqual(mean, 2)
        self.assertAlmostEqual(half, 4.303 / math.sqrt(3), 3)
        self.assertEqual(quality.mean_interval([None, 5]), (5, None))
        self.assertEqual(quality.mean_interval([None]), (None, None))

    def test_figures_have_as_many_digits_as_their_error_allows(self):
        self.assertEqual(quality.number(0.00126789, 0.000034), "0.001268 ± 0.000034")
        self.assertEqual(quality.number(6.71234, 0.21), "6.71 ± 0.21")
        self.assertEqual(quality.number(1234.5, 310), "1.23e+03 ± 3.1e+02")
        self.assertEqual(quality.number(0.0123456), "0.0123")

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
        self.assertEqual((m.name, m.wanted_spp, m.oidn), ("path", 16, False))
        self.assertEqual(m.arguments, ["--sampler", "independent", "--param", "max_depth=4", "--set", "film.filter=tent",
                                       "--integrator", "path", "--set", "stages=[]", "--layers", "color"])
        g = quality.Method("gradient_path:spp=2+reconstruct:norm=l2:temporal-rows=dt")
        self.assertEqual((g.wanted_spp, g.stages), (2, ["reconstruct"]))
        self.assertEqual(g.arguments[:4], ["--set", "reconstruct.norm=l2", "--set", "reconstruct.temporal_rows=dt"])

    def test_chains_of_stages(self):
        m = quality.Method("path:decompose=default+denoise:method=oidn:recipe=single")
        self.assertEqual(m.arguments, ["--decompose", "default", "--set", "denoise.method=oidn", "--set",
                                       "denoise.recipe=single", "--integrator", "path", "--set", 'stages=["denoise"]',
                                       "--layers", "color"])
        self.assertEqual((m.oidn, m.needs_oidn, m.least_spp()), (False, True, 2))
        m = quality.Method("temporal_gradient_path+denoise")
        self.assertEqual((m.stages, m.needs_oidn), (["reconstruct", "denoise"], False))
        self.assertEqual(quality.Method("temporal_gradient_path+reconstruct+denoise").arguments, m.arguments)

    def test_what_the_shot_says(self):
        m = quality.Method("run:quality=final:spp=7")
        self.assertEqual((m.name, m.wanted_spp, m.arguments), ("run", 7, ["--set", "quality=final"]))

    def test_a_denoiser_of_frames_at_the_end(self):
        m = quality.Method("temporal_gradient_path:spp=4+reconstruct:norm=l2+oidn:clean=true")
        self.assertEqual((m.stages, m.oidn, m.clean, m.needs_oidn), (["reconstruct"], True, True, True))
        self.assertEqual(m.arguments[-2:], ["--layers", "color,albedo,normal"])
        m = quality.Method("path+oidn")
        self.assertEqual((m.stages, m.oidn, m.clean), ([], True, False))
        self.assertFalse(quality.Method("path").needs_oidn)

    def test_shots_without_classes_and_layers(self):
        with tempfile.TemporaryDirectory() as folder:
            shot = pathlib.Path(folder) / "shot.toml"
            shot.write_text('scene = "s.glb"\n[output]\nlayers = ["albedo"]\n[sampling]\nspp = 4\n'
                            '[decompose]\ndd = "ED"\n[materials.glass]\ntype = "dielectric"\n')
            plain = quality.plain_shot(shot)
            self.assertEqual(plain.name, "shot_plain.toml")
            self.assertEqual(plain.read_text(),
                             'scene = "s.glb"\n[sampling]\nspp = 4\n[materials.glass]\ntype = "dielectric"\n')
            self.assertEqual(quality.exposure_of(plain), 0)
            shot.write_text('scene = "s.glb"\n[video]\nexposure = -1.5\n')
            self.assertEqual(quality.exposure_of(shot), -1.5)
            self.assertEqual(quality.exposure_of("scene.glb"), 0)

    def test_a_missing_denoiser_is_said_in_a_line(self):
        command = [sys.executable, ROOT / "bench/quality.py", "--oidn", "/nowhere/lib.so", "--methods", "path+oidn"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertEqual(done.stderr, "quality: Open Image Denoise is not there: ./dev oidn fetches it\n")

    def test_methods_of_the_tables_are_known(self):
        for text in ",".join([quality.METHODS, *(p["methods"] for p in quality.PRESETS.values())]).split(","):
            quality.Method(text)

    def test_bounds_are_ratios_to_the_first_method(self):
        results = [{"method": m, "ratios": {"relmse": (r, None, None)}} for m, r in (("a", 1), ("b", 1.05), ("c", 1.2))]
        results.append({"method": "refused", "ratios": {}})
        bounds = quality.bounds_of("relmse=1.1,relmse@object_id=9=0.7")
        self.assertEqual(bounds, {"relmse": 1.1, "relmse@object_id=9": 0.7})
        self.assertEqual(quality.beyond(results, bounds), ["relmse of c is 1.2 of that of a, over 1.1"])
        with self.assertRaises(SystemExit):
            quality.bounds_of("relmse")

    def test_headings(self):
        self.assertEqual(quality.title_of("relmse", "relMSE", ""), "relMSE")
        self.assertEqual(quality.title_of("relmse_trimmed@object_id=9", "relMSE", ""),
                         "relMSE without the worst 0.1 % where object_id = 9")
        self.assertEqual(quality.title_of("flicker_display", "displayed flicker", "1/255"), "displayed flicker [1/255]")

    def test_names_of_scenes(self):
        self.assertEqual([quality.scene_name(s) for s in ("robot@9x9", "a/ship/shot.toml@9x9", "a/ship.glb")],
                         ["robot", "ship", "ship"])

    def test_frame_sets(self):
        self.assertEqual(quality.frames_of("1-4"), [1, 2, 3, 4])
        self.assertEqual(quality.frames_of("3,10-14x2,1..2"), [3, 10, 12, 14, 1, 2])

    def test_wrong_settings_end_the_program(self):
        for text in ("path:spp=0", "path:spp=many", "path:sampler", "path:=3", "path+", "path+oidn:clean=yes",
                     "path+oidn:spp=4", "path+oidn+denoise"):
            with self.assertRaises(SystemExit):
                quality.Method(text)


class Clockwork(quality.Bench):
    """Methods whose time is known: a constant part and one for each sample, which `slower` multiplies after the first
    seed."""

    def __init__(self, constant, each, slower=1.0):
        self.constant, self.each, self.slower = constant, each, slower
        self.work, self.metrics, self.noise, self.seconds_of, self.runs = pathlib.Path("/nowhere"), ["mse"], {}, {}, []

    def run(self, method, spp, seed, folder):
        name = method.label
        seconds = (self.constant[name] + self.each[name] * spp) * (self.slower if seed > 1 and name != "path" else 1)
        self.seconds_of.setdefault(name, {})[spp] = seconds
        self.runs.append((name, spp, seed))
        return seconds

    def measure(self, folder, metrics):
        return {"mse": 1.0}


class EqualTime(unittest.TestCase):
    def compare(self, constant, each, samples, seeds=3, slower=1.0):
        bench = Clockwork({"path": 0.5, "path+denoise": constant}, {"path": 1.0, "path+denoise": each}, slower)
        args = argparse.Namespace(time=30, seeds=seeds, metrics=["mse"])
        methods = [quality.Method("path"), quality.Method("path+denoise")]
        with contextlib.redirect_stdout(io.StringIO()) as out:
            results = quality.equal_time(bench, methods, args, samples)
        return results[1], bench.runs, out.getvalue()

    def test_most_samples_that_fit(self):
        for constant, each, samples in ((2, 1.5, 8), (0.1, 0.02, 8), (3, 1.1, 128), (7, 0.3, 32), (0, 2.4, 8)):
            r, runs, text = self.compare(constant, each, samples)
            target = 0.5 + samples
            self.assertFalse(r["refused"], text)
            self.assertLessEqual(statistics.fmean(r["seconds"]), 1.05 * target, text)
            fits = abs(r["seconds"][0] / target - 1) < 0.05 or constant + each * (r["spp"] + 1) > 1.05 * target
            self.assertTrue(fits, text)
            self.assertLessEqual(len(runs), 3 + 6 + 2, text)

    def test_what_takes_longer_is_refused(self):
        r, _, text = self.compare(7.5, 1, 8)  # 9.5 s at its least, two samples, where 8.5 are given
        self.assertTrue(r["refused"] and not r["figures"] and r["spp"] == 2, text)
        self.assertAlmostEqual(r["over"], 9.5 / 8.5 - 1)
        r, _, text = self.compare(6.9, 1, 8)  # 8.9 s
        self.assertFalse(r["refused"], text)

    def test_seeds_are_run_in_turn(self):
        r, runs, _ = self.compare(2, 1.5, 8)
        last = [("path", 8, 2), ("path+denoise", r["spp"], 2), ("path", 8, 3), ("path+denoise", r["spp"], 3)]
        self.assertEqual(runs[-4:], last)
        self.assertEqual(sum(seed == 1 and name == "path" for name, _, seed in runs), 1)

    def test_seeds_that_take_longer_get_fewer_samples(self):
        r, _, text = self.compare(0, 1, 32, slower=1.2)
        self.assertFalse(r["refused"], text)
        self.assertLessEqual(statistics.fmean(r["seconds"]), 1.05 * 32.5, text)
        self.assertGreater(r["spp"], 24, text)


class Comparison(unittest.TestCase):
    def bench(self, *arguments, status=0):
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            (folder / "bin").mkdir()
            (folder / "bin/tempera").symlink_to(TEMPERA.resolve())
            done = subprocess.run([sys.executable, ROOT / "bench/quality.py", "--build", folder, "--work", folder / "work",
                                   *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            self.assertEqual(done.returncode, status, done.stdout)
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

    def test_references_are_kept_while_their_pixels_stay(self):
        def text_of(folder, *arguments):
            done = subprocess.run([sys.executable, ROOT / "bench/quality.py", "--build", folder, "--work", folder / "work",
                                   "--scene", "cornell-motion@16x16", "--frames", "1-2", "--seeds", "1", "--reference-spp",
                                   "4", "--methods", "path:spp=1", "--metrics", "relmse", *arguments],
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            self.assertEqual(done.returncode, 0, done.stdout)
            return done.stdout
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            (folder / "bin").mkdir()
            (folder / "bin/tempera").symlink_to(TEMPERA.resolve())
            text_of(folder)
            reference = next((folder / "work").glob("cornell-motion/reference_*_a/f.0001.exr"))
            made = reference.stat().st_mtime_ns
            self.assertNotIn("rendering it again", text_of(folder))
            self.assertEqual(reference.stat().st_mtime_ns, made)
            # A renderer whose pixels changed: what is known of the quick rendering is that of other random numbers.
            shutil.copy(next((folder / "work").glob("cornell-motion/reference_*_b/probe/f.0001.exr")),
                        reference.parent / "probe/f.0001.exr")
            self.assertIn("reference a: the scene or the renderer has changed", text_of(folder))
            self.assertNotEqual(reference.stat().st_mtime_ns, made)
            self.assertNotIn("rendering it again", text_of(folder))

    def test_equal_time_is_met(self):
        stored, text = self.bench("--scene", "cornell-motion", "--resolution", "128x128", "--frames", "1", "--seeds", "1",
                                  "--reference-spp", "64", "--time", "4", "--methods", "path", "--metrics", "relmse")
        method = stored["results"][0]
        self.assertGreater(method["spp"], 4, text)
        # The machine may be busy: what is checked is that calibration converged to the order of the target.
        self.assertLess(abs(math.log(method["seconds"][0] / 4)), math.log(2), text)

    def test_stages_and_parts_of_the_picture(self):
        stored, text = self.bench(
            "--scene", "robot", "--resolution", "64x36", "--frames", "1-2", "--seeds", "1", "--reference-spp", "64",
            "--methods", "path:spp=4,path:spp=4+denoise:method=nl_means", "--metrics",
            "relmse,relmse_trimmed,relmse@object_id=9", "--bound", "relmse_trimmed=0.5")
        noisy, clean = (r["figures"][0] for r in stored["results"])
        for metric in noisy:
            self.assertLess(clean[metric], 0.5 * noisy[metric], text)
        self.assertLess(noisy["relmse_trimmed"], noisy["relmse"], text)
        self.assertNotEqual(noisy["relmse@object_id=9"], noisy["relmse"], text)
        self.bench("--scene", "cornell-motion", "--resolution", "16x16", "--frames", "1", "--seeds", "1",
                   "--reference-spp", "64", "--methods", "path:spp=64,path:spp=1", "--metrics", "relmse", "--bound",
                   "relmse=2", status=6)

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
