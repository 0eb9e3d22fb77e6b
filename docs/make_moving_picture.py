"""The README's moving picture: the live page of ur10_demo in headless Chromium, once around its circle.

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

from dmframe.catalogue import find_page

FRAMES = 30
PERIOD = math.pi  # [s], of the circle
FIRST = 12.0  # [s], when the controller has adapted
WINDOW = (1400, 860)
PART = (12, 160, 1074, 824)  # [pixels]: robot, errors and V
WIDTH = 760  # [pixels], of the picture
COLOURS = 128
FILE = Path(__file__).parent / "images" / "ur10_demo.gif"


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
        page = find_page("ur10_demo")
        frames = [frame(page, folder, FIRST + PERIOD * k / FRAMES) for k in range(FRAMES)]
    palette = frames[0].quantize(COLOURS, dither=Image.Dither.NONE)
    small = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in frames]
    pause = round(1000 * PERIOD / FRAMES)
    small[0].save(FILE, save_all=True, append_images=small[1:], duration=pause, loop=0, optimize=True)


if __name__ == "__main__":
    main()
