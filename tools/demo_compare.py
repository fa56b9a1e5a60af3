#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The demo beside plain path tracing at the same rendering time, called by `./dev demo --compare` with the program, the shot and
the folder OUT.

Runs the demo to OUT, takes the processor time of all that it did, renders the same frames by path tracing alone with as
many samples as that time buys, and puts both movies side by side in OUT/compare.mp4, with the samples and times on them.
"""
import pathlib
import resource
import subprocess
import sys

LABEL = "drawtext=text='{}':x=12:y=h-28:fontsize=18:fontcolor=white:box=1:boxcolor=black@0.5:boxborderw=5:font=DejaVu Sans"
TRIAL_FRAMES, TRIAL_SAMPLES = "1-48x6", 8


def main():
    tempera, shot, out = sys.argv[1:]
    out = pathlib.Path(out)

    def processor_seconds(*arguments):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([tempera, *map(str, arguments)])
        if done.returncode:
            sys.exit(done.returncode)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def render_plain(samples, pattern, *arguments):
        return processor_seconds("-q", "render", shot, "--integrator", "path", "--set", "stages=[]", "--layers", "color",
                                 "--spp", samples, "-o", pattern, *arguments)

    cost = processor_seconds("run", shot, "-o", out / "demo.####.exr", "--no-video")
    processor_seconds("video", out / "final/demo.####.exr", out / "demo.mp4")
    frames = sorted((out / "final").glob("demo.*.exr"))
    trial = render_plain(TRIAL_SAMPLES, out / "plain/trial/demo.####.exr", "--frames", TRIAL_FRAMES)
    tried = len(list((out / "plain/trial").glob("demo.*.exr")))
    samples = max(1, round(TRIAL_SAMPLES * cost / (trial / tried * len(frames))))
    plain_cost = render_plain(samples, out / "plain/demo.####.exr")
    processor_seconds("-q", "video", out / "plain/demo.####.exr", out / "plain.mp4")

    labels = [f"Path tracing alone, {samples} samples, {plain_cost:.0f} s", f"Tempera, {cost:.0f} s"]
    sides = ";".join(f"[{i}]{LABEL.format(label)}[side{i}]" for i, label in enumerate(labels))
    subprocess.run(["ffmpeg", "-y", "-loglevel", "error", "-i", out / "plain.mp4", "-i", out / "demo.mp4",
                    "-filter_complex", f"{sides};[side0][side1]hstack", "-c:v", "libx264", "-crf", "20", "-pix_fmt",
                    "yuv420p", "-movflags", "+faststart", out / "compare.mp4"], check=True)
    print(f"processor time of {len(frames)} frames: Tempera {cost:.1f} s, path tracing with {samples} samples "
          f"{plain_cost:.1f} s ({plain_cost / cost:.2f})")
    print(f"Video:  {out.resolve() / 'compare.mp4'}")


if __name__ == "__main__":
    main()
