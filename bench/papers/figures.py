# SPDX-License-Identifier: Apache-2.0
"""Panels of pictures with captions, for the pages of papers. Made by oiiotool; fonts are those that ffmpeg brings along."""
import dataclasses
import pathlib
import subprocess
import sys

FONT = "DejaVuSans"


@dataclasses.dataclass
class Picture:
    """A layer of an EXR file, or a PNG file as it is.

    `crop`: (x, y, width, height) in pixels. `exposure`: stops. `channels`: names in the file, if they are not those of the
    layer as a color."""
    caption: str
    file: pathlib.Path
    layer: str = "color"
    crop: tuple = None
    exposure: float = 0
    channels: tuple = None


def shown(picture, width):
    """Arguments of oiiotool that leave the picture on the stack, `width` pixels wide."""
    own = pathlib.Path(picture.file).suffix != ".exr"
    arguments = ["-i", str(picture.file)]
    if not own:
        prefix = "" if picture.layer == "color" else picture.layer + "."
        channels = picture.channels or [prefix + c for c in "RGB"]
        arguments += ["--ch", ",".join(channels)]
    if picture.crop:
        x, y, w, h = picture.crop
        arguments += ["--cut", f"{w}x{h}+{x}+{y}"]
    if not own:
        arguments += ["--mulc", str(2 ** picture.exposure), "--colorconvert", "linear", "sRGB", "--clamp:min=0:max=1"]
    # Pixels stay squares: what is looked at are pixels.
    arguments += ["--resize:filter=box", f"{width}x0"]
    if picture.caption:
        shadow = f"--text:x=7:y=19:size=13:font={FONT}:color=0,0,0"
        arguments += [shadow, picture.caption, f"--text:x=6:y=18:size=13:font={FONT}:color=1,1,1", picture.caption]
    return arguments


def panel(out, pictures, columns=None, width=320):
    """Writes `pictures` side by side, `columns` in a row, each `width` pixels wide, all of one shape."""
    columns = columns or len(pictures)
    rows = -(-len(pictures) // columns)
    command = ["oiiotool"]
    for picture in pictures:
        command += shown(picture, width)
    command += ["--mosaic:pad=3", f"{columns}x{rows}", "--quality", "88", "-o", str(out)]
    pathlib.Path(out).parent.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"figures: {out}: {done.stdout}")
