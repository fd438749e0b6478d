"""Costs of the page of a replay: its size, the time that it takes to make, and that of a frame in Chromium.

A page is played in Chromium without a window and without a graphics processor, if Chromium is installed. The cost of a
frame is the CPU time of all processes of the browser, which does not depend on the load of the machine. At 33 ms, an
otherwise idle processor shows 30 frames a second.
"""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from desim import Result, load, run
from desim.view.pages.replay import replay_page, with_recordings
from scenarios.benchmarks.browser import CHROMIUM, Page, cpu_time, page
from scenarios.benchmarks.measuring import Cost
from scenarios.studies.study import SCENARIOS, Options

FRAMES_PER_SECOND = {200: 30.0, 500: 10.0}
"""By number of pursuers, the frames that a page should show per second."""
SIZE, TIME = 10.0, 4.0
"""The largest size, MB, of the page of the largest team, and the longest time, s, to make it after its run."""
WATCHED = 4.0
"""The time for which a page is watched, s."""
PLAYED_AGAIN = "setInterval(() => replay.playing || (replay.seek(0.3 * replay.end), replay.play()), 5)"
"""Lets a page begin again at once when it has ended, as a run of many pursuers soon does."""


def replays(options: Options) -> list[Cost]:
    """Return the costs of the pages of large teams."""
    costs: list[Cost] = []
    for count, rate in FRAMES_PER_SECOND.items():
        is_largest = count == max(FRAMES_PER_SECOND)
        result = run(with_recordings(load(SCENARIOS / "relay.toml", [f"team.count={count}"])))
        content, duration = timed_page(result, options.runs)
        size = len(content.encode()) / 1e6
        costs += [
            Cost(f"page of {count} pursuers", size, "MB", SIZE if is_largest else None),
            Cost(f"making a page of {count} pursuers", duration, "s", TIME if is_largest else None),
        ]
        if CHROMIUM is None:
            continue
        with TemporaryDirectory() as folder, page() as browser:
            file = Path(folder, "replay.html")
            file.write_text(content, encoding="utf-8")
            rate_shown, per_frame = frames(browser, file, options.runs)
        costs += [
            Cost(f"frames of {count} pursuers, load {os.getloadavg()[0]:.1f}", rate_shown, "frames/s"),
            Cost(f"a frame of {count} pursuers", 1e3 * per_frame, "ms of CPU", 1e3 / rate),
        ]
    return costs


def timed_page(result: Result, rounds: int) -> tuple[str, float]:
    """Return the page of a run, and the CPU time, s, of the fastest of some rounds that make it."""
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        content = replay_page(result)
        times.append(time.process_time() - begin)
    return content, min(times)


def frames(browser: Page, file: Path, rounds: int) -> tuple[float, float]:
    """Return the most frames per second, and the least CPU time per frame, s, of some rounds."""
    browser.open(file, width=1280, height=800)
    browser.value(PLAYED_AGAIN)
    rates, times = [], []
    for _ in range(rounds):
        begin, before, cpu = time.monotonic(), browser.value("replay.frames"), cpu_time(browser)
        time.sleep(WATCHED)
        drawn = browser.value("replay.frames") - before
        rates.append(drawn / (time.monotonic() - begin))
        times.append((cpu_time(browser) - cpu) / max(drawn, 1))
    return max(rates), min(times)
