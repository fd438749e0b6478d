"""Record the film at the top of the README, the replay of scenarios/faults.toml: `python docs/film.py`.

It needs chromium and pillow.
"""

import base64
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from desim import load, run
from desim.view.pages.replay import replay_page
from scenarios.benchmarks.browser import Page, page

ROOT = Path(__file__).parent.parent
FILM = ROOT / "docs/_static/replay.gif"
TIMES = np.arange(0.2, 4.4, 0.07)
"""The instants of the frames, s."""
SIZE = (1280, 800)
"""The size of the window, pixels."""
SHRUNK = (960, 600)
"""The size of the film, pixels."""
DRAWN = 0.002
"""Share of dark pixels in the plane from which on it counts as drawn; an empty one has none below its buttons."""
PAINTED = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
"""Waits until the browser has shown what was drawn: a frame of the screen begins after the one before was painted."""


def frame(browser: Page, t: float) -> Image.Image:
    """Return the replay at an instant, s.

    Raises:
        RuntimeError: if the picture does not show the plane.
    """
    browser.value(f"replay.seek({t:.3f})")
    browser.value(PAINTED)
    content = base64.b64decode(browser.send("Page.captureScreenshot", format="png")["data"])
    taken = Image.open(BytesIO(content)).convert("RGB").resize(SHRUNK, Image.Resampling.LANCZOS)
    if not is_drawn(taken):
        raise RuntimeError(f"the picture at {t:.2f} s does not show the plane")
    return taken


def is_drawn(taken: Image.Image) -> bool:
    """Return whether a picture of the replay shows the players: their plane is in its upper left quarter."""
    width, height = taken.size
    plane = np.asarray(taken.convert("L"))[height // 6 : height // 2, : width // 2]
    return float((plane < 200).mean()) > DRAWN


def main() -> None:
    """Write docs/_static/replay.gif."""
    with TemporaryDirectory() as folder, page() as browser:
        file = Path(folder) / "replay.html"
        result = run(load(ROOT / "scenarios/faults.toml", ["record.messages=true"]))
        file.write_text(replay_page(result), encoding="utf-8")
        browser.open(file, *SIZE)
        frames = [frame(browser, t) for t in TIMES]
    palette = frames[len(frames) // 2].quantize(128)
    first, *others = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    first.save(FILM, save_all=True, append_images=others, duration=120, loop=0)


if __name__ == "__main__":
    main()
