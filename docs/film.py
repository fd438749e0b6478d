"""Record the film at the top of the README, the replay of scenarios/faults.toml: `python docs/film.py`.

It needs chromium and pillow.
"""

import shutil
import subprocess
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from desim import load, run
from desim.view.pages.replay import replay_page

ROOT = Path(__file__).parent.parent
TIMES = np.arange(0.2, 4.4, 0.07)
"""The instants of the frames, s."""
SIZE = (1280, 800)
"""The size of the window, pixels."""
SHRUNK = (960, 600)
"""The size of the film, pixels."""
ATTEMPTS = 5
"""Pictures that are taken of an instant at most: on a busy machine some are taken before the plane is drawn."""
DRAWN = 0.002
"""Share of dark pixels in the plane from which on it counts as drawn; an empty one has none below its buttons."""


def frame(page: Path, t: float) -> Image.Image:
    """Return the replay at an instant, s.

    Raises:
        RuntimeError: if no picture shows the plane.
    """
    for _ in range(ATTEMPTS):
        taken = picture(page, t)
        if is_drawn(taken):
            return taken
    raise RuntimeError(f"{ATTEMPTS} pictures at {t:.2f} s do not show the plane")


def is_drawn(taken: Image.Image) -> bool:
    """Return whether a picture of the replay shows the players: their plane is in its upper left quarter."""
    width, height = taken.size
    plane = np.asarray(taken.convert("L"))[height // 6 : height // 2, : width // 2]
    return float((plane < 200).mean()) > DRAWN


def picture(page: Path, t: float) -> Image.Image:
    """Return what a browser shows of the replay at an instant, s."""
    file = page.with_suffix(".png")
    options = ("--headless", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=2000")
    window = f"--window-size={SIZE[0]},{SIZE[1]}"
    address = f"{page.as_uri()}#t={t:.3f}"
    subprocess.run(
        [shutil.which("chromium") or "chromium", *options, window, f"--screenshot={file}", address],
        check=True,
        capture_output=True,
    )
    return Image.open(BytesIO(file.read_bytes())).convert("RGB").resize(SHRUNK, Image.Resampling.LANCZOS)


def main() -> None:
    """Write docs/_static/replay.gif."""
    with TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        page.write_text(
            replay_page(run(load(ROOT / "scenarios/faults.toml", ["record.messages=true"]))), encoding="utf-8"
        )
        frames = [frame(page, t) for t in TIMES]
    palette = frames[len(frames) // 2].quantize(128)
    first, *others = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    first.save(ROOT / "docs/_static/replay.gif", save_all=True, append_images=others, duration=120, loop=0)


if __name__ == "__main__":
    main()
