"""The README's moving picture: the live page of ur10_fast in headless Chromium, once around its circle.

``python docs/make_moving_picture.py``: some minutes; Chromium must be installed.
"""

from __future__ import annotations

import io
import math
import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

import dmframe as dm

FRAMES = 36
PERIOD = 2 * math.pi  # [s], of the circle
FIRST = 6.0  # [s], when the tool has left a trace
WINDOW = (1400, 700)
PART = (12, 146, 1056, 668)  # [pixels]: robot, error and V
WIDTH = 760  # [pixels], of the picture
COLOURS = 200
FILE = Path(__file__).parent / "images" / "ur10_fast.gif"


def frame(page: Path, folder: Path, time: float) -> Image.Image:
    """Picture of the page at an instant [s]."""
    shot = folder / "frame.png"
    gpu = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    words = ("--headless", "--no-sandbox", "--hide-scrollbars", *gpu, f"--window-size={WINDOW[0]},{WINDOW[1]}")
    end = ("--virtual-time-budget=3000", f"--screenshot={shot}", f"{page.as_uri()}#at={time:.4f}")
    subprocess.run([shutil.which("chromium") or "chromium", *words, *end], check=True, capture_output=True)
    picture = Image.open(io.BytesIO(shot.read_bytes())).convert("RGB").crop(PART)
    return picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS)


def main() -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        page = dm.load("ur10_fast").page().save(folder / "page.html")
        frames = [frame(page, folder, FIRST + PERIOD * k / FRAMES) for k in range(FRAMES)]
    palette = frames[0].quantize(COLOURS, dither=Image.Dither.NONE)
    small = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in frames]
    pause = round(1000 * PERIOD / FRAMES)
    small[0].save(FILE, save_all=True, append_images=small[1:], duration=pause, loop=0, optimize=True)


if __name__ == "__main__":
    main()
