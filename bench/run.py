#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Speed and memory of the path tracer: against a bare ray tracing loop, against one thread, and against Mitsuba 3.

Every scene is rendered with the same size, samples, depth and threads by each renderer in turn; rates are camera paths
per second of rendering (scene loading and, for Mitsuba, compilation of its kernels are printed apart). Results go to
<build>/bench/<commit>.json. Mitsuba 3 is optional: python3 -m pip install -r tools/requirements-dev.txt

  ./dev bench                    all scenes that are present
  ./dev bench --scene cornell    one scene; --no-mitsuba, --threads 1,2, --spp N, --repeat N
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
SHARED = ROOT.parent / "shared" / "scenes"

# name, file, width, height, spp, max_depth, whether Mitsuba can load it
SCENES = [
    ("cornell", ROOT / "scenes/tests/cornell.xml", 320, 180, 64, 13, True),
    ("interior", SHARED / "mitsuba/bathroom/scene.xml", 256, 256, 32, 13, True),
    ("heavy", SHARED / "mitsuba/veach-ajar/scene.xml", 320, 180, 32, 13, True),
    ("hall", SHARED / "mitsuba/modern-hall/scene_v3.xml", 320, 180, 32, 13, True),
    ("animated", SHARED / "blender/cornell_anim.glb", 320, 180, 32, 12, False),
    ("demo", ROOT / "scenes/demo/shot.toml", 320, 180, 16, 8, False),
]

MITSUBA = r"""
import json, sys, time
import mitsuba as mi
variant, path, width, height, spp, depth, threads, repeat = sys.argv[1:9]
mi.set_variant(variant)
import drjit as dr
dr.set_thread_count(int(threads))
begin = time.time()
scene = mi.load_file(path)
load = time.time() - begin
params = mi.traverse(scene.sensors()[0])
params["film.size"] = [int(width), int(height)]
params.update()
integrator = mi.load_dict({"type": "path", "max_depth": int(depth)})
def render(seed):
    begin = time.time()
    image = mi.render(scene, integrator=integrator, spp=int(spp), seed=seed)
    dr.eval(image); dr.sync_thread()
    image.numpy()
    return time.time() - begin
first = render(0)
best = min(render(i + 1) for i in range(int(repeat)))
print(json.dumps({"load": load, "first": first, "seconds": best}))
"""


def measure(command):
    """(stdout, wall seconds, peak MiB of the child) of a command; raises on failure."""
    with tempfile.TemporaryFile("w+") as output:
        begin = time.time()
        process = subprocess.Popen(command, stdout=output, stderr=output)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.time() - begin
        output.seek(0)
        text = output.read()
    if status:
        raise RuntimeError(f"{' '.join(map(str, command))}: status {status}\n{text}")
    return text, wall, usage.ru_maxrss / 1024


def render_tempera(args, scene, threads):
    name, path, width, height, spp, depth, _ = scene
    best = None
    for _ in range(args.repeat):
        with tempfile.TemporaryDirectory() as folder:
            text, wall, memory = measure(
                [args.tempera, "render", path, "-o", f"{folder}/f.####.exr", "--frames", "12", "--resolution",
                 f"{width}x{height}", "--spp", str(args.spp or spp), "--max-depth", str(depth), "--threads", str(threads),
                 "--layers", "color", "--progress", "json"])
        events = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
        done = next(e for e in events if "seconds" in e and "samples" in e)
        if best is None or done["seconds"] < best["seconds"]:
            best = {"seconds": done["seconds"], "load": wall - done["seconds"], "memory_mib": memory,
                    "msamples": done["samples"] / done["seconds"] * 1e-6,
                    "rays_per_sample": (done["rays"] + done.get("shadow_rays", 0)) / done["samples"]}
    return best


def render_mitsuba(args, scene, threads, variant):
    _, path, width, height, spp, depth, _ = scene
    spp = args.spp or spp
    if variant.startswith("scalar"):
        spp = max(1, spp // 4)  # slow, and its rate does not depend on the number of samples
    text, _, _ = measure([sys.executable, "-c", MITSUBA, variant, path, str(width), str(height), str(spp), str(depth),
                          str(threads), str(args.repeat)])
    result = next(json.loads(line) for line in text.splitlines() if line.startswith("{"))
    result["msamples"] = width * height * spp / result["seconds"] * 1e-6
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--scene", action="append", help="name of a scene; repeatable")
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--spp", type=int)
    parser.add_argument("--repeat", type=int, default=3, help="runs of each; the best counts, as machines are shared")
    parser.add_argument("--no-mitsuba", action="store_true")
    args = parser.parse_args()
    args.tempera = args.build / "bin/tempera"
    ray_rate = next((p for p in args.build.rglob("ray_rate") if p.is_file()), None)
    thread_counts = [int(t) for t in args.threads.split(",")]
    have_mitsuba = not args.no_mitsuba and subprocess.run(
        [sys.executable, "-c", "import mitsuba"], capture_output=True).returncode == 0
    if not have_mitsuba and not args.no_mitsuba:
        print("Mitsuba 3 is not installed: no comparison with it", file=sys.stderr)

    results = {}
    for scene in SCENES:
        name, path = scene[0], scene[1]
        if (args.scene and name not in args.scene) or not path.exists():
            continue
        entry = results[name] = {"file": str(path.relative_to(ROOT.parent)), "tempera": {}, "mitsuba": {}}
        for threads in thread_counts:
            entry["tempera"][threads] = ours = render_tempera(args, scene, threads)
            print(f"{name:10} tempera             {threads} thread(s): {ours['msamples']:7.3f} Msamples/s, "
                  f"{ours['rays_per_sample']:.1f} rays a sample, load {ours['load']:.2f} s, peak {ours['memory_mib']:.0f} MiB",
                  flush=True)
            if have_mitsuba and scene[6]:
                for variant in ("llvm_ad_rgb", "scalar_rgb"):
                    theirs = render_mitsuba(args, scene, threads, variant)
                    entry["mitsuba"].setdefault(variant, {})[threads] = theirs
                    print(f"{name:10} mitsuba {variant:11} {threads} thread(s): {theirs['msamples']:7.3f} Msamples/s, "
                          f"load {theirs['load']:.2f} s; tempera / mitsuba = {ours['msamples'] / theirs['msamples']:.2f}",
                          flush=True)
        if len(thread_counts) > 1:
            a, b = thread_counts[0], thread_counts[-1]
            scaling = entry["tempera"][b]["msamples"] / entry["tempera"][a]["msamples"]
            entry["scaling"] = scaling
            print(f"{name:10} {b} threads / {a}: {scaling:.2f}", flush=True)
        if ray_rate and path.suffix in (".xml", ".glb", ".gltf"):
            text, _, _ = measure([ray_rate, path, "--width", str(scene[2]), "--spp", "8"])
            entry["rays"] = json.loads(text.splitlines()[-1])
            print(f"{name:10} rays inside path {entry['rays']['path_mrays']:.2f} M/s, bare loop "
                  f"{entry['rays']['bare_mrays']:.2f} M/s: {100 * entry['rays']['ratio']:.0f} %", flush=True)
    commit = subprocess.run(["git", "-C", ROOT, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    target = args.build / "bench" / f"{commit or 'uncommitted'}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(results, indent=1))
    print(f"written: {target}")


if __name__ == "__main__":
    main()
