"""What a replay of a large team costs: the time to make the page, its size, and how many frames it plays a second."""

import time

import pytest

from desim import load, run
from desim.view.pages.replay import replay_page, with_recordings
from scenarios.studies.study import SCENARIOS
from tests.view.browser import in_chromium
from tests.view.browser import page as browser_page

WATCHED = 4.0
"""How long a page plays while its frames are counted, s."""


def recorded(count):
    return run(with_recordings(load(SCENARIOS / "relay.toml", [f"team.count={count}"])))


@pytest.mark.parametrize("count", [200, 500])
def test_the_page_of_a_large_team(benchmark, count):
    """A page of 500 pursuers should take 4 s, with its run, and less than 10 MB."""
    begin = time.process_time()
    result = recorded(count)
    ran = time.process_time() - begin
    page = benchmark.pedantic(replay_page, args=(result,), rounds=3)
    benchmark.group = "replay page"
    benchmark.extra_info |= {"pursuers": count, "seconds_of_the_run": ran, "megabytes": len(page) / 1e6}


@in_chromium
@pytest.mark.parametrize("count", [200, 500])
def test_frames_of_a_large_team(benchmark, tmp_path, count):
    """A page should play 30 frames a second with 200 pursuers, and 10 with 500, without a graphics processor."""
    path = tmp_path / "replay.html"
    path.write_text(replay_page(recorded(count)), encoding="utf-8")
    with browser_page() as opened:
        opened.open(path, width=1280, height=800)
        opened.value("replay.seek(0.3 * replay.end); replay.play()")

        def frames():
            before = opened.value("replay.frames")
            time.sleep(WATCHED)
            return opened.value("replay.frames") - before

        shown = benchmark.pedantic(frames, rounds=1)
    benchmark.group = "replay in Chromium"
    benchmark.extra_info |= {"pursuers": count, "frames_per_second": shown / WATCHED}
