"""Two runs side by side: the page says what differs between them, and a browser plays both on one clock."""

import re
from functools import cache
from html import unescape

import pytest

from desim import Scenario, run
from desim.analysis.trace_index import ended, messages
from desim.kernel.core.events import Trace
from desim.kernel.core.units import SECOND
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.latency import Constant, Lognormal
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.core.events import Decided
from desim.results.run_folder import write
from desim.scenario.players import Evader, Speeds, Team
from desim.scenario.scenario import Recording
from desim.scenario.sweep_table import Sweep
from desim.simulation.run import Result
from desim.view.pages.pair import MAX_DIFFERENCES, MAX_TEXT, differences, side_by_side
from desim.view.pages.replay import replay_page
from desim.view.pages.replay_data import PARTS
from tests.command import accepted, refused
from tests.view.browser import in_chromium
from tests.view.by_hand import chase, history, pair
from tests.view.elements import Elements

HOSTILE = '"></iframe></script><script>window.hurt = 1</script><!-- & {{ names }} <b>Bold</b>'


def found(first, second, seeds=(3, 3)):
    """Return the differences of two scenarios as text."""
    results = [Result(each, seed, Trace()) for each, seed in zip((first, second), seeds, strict=True)]
    return [f"{key}: {one} | {other} {unit or '-'}" for key, one, other, unit in differences(*results)]


# What differs.


def links(**given):
    return Scenario(network=Links(**given))


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (links(latency=Constant(value=0.02)), links(latency=Constant(value=1.0)), "network.latency.value: 0.02 | 1 s"),
        (links(latency=Constant(value=0.1)), links(latency=Lognormal()), "network.latency: constant | lognormal -"),
        (links(loss=Bernoulli(p=0.5)), links(loss=Bernoulli(p=0.25)), "network.loss.p: 0.5 | 0.25 -"),
        (Scenario(), links(range=8.0), "network.range: inf | 8 m"),
        (
            Scenario(),
            Scenario(fault=(Crash(node=1, start=1.0), Partition(start=1.0, groups=((0,), (1,))))),
            "fault: none | crash, partition -",
        ),
        (
            Scenario(fault=(Crash(node=1, start=1.0),)),
            Scenario(fault=(Crash(node=2, start=1.0),)),
            "fault.0.node: 1 | 2 -",
        ),
        (Scenario(team=Team(speeds=1.5)), Scenario(), "team.speeds: 1.5 | default 1, last 2 -"),
        (Scenario(team=Team(speeds=Speeds(last=3.0))), Scenario(), "team.speeds.last: 3 | 2 m/s"),
        (Scenario(), Scenario(team=Team(box=(0.0, 9.0))), "team.box: [0, 20] | [0, 9] -"),
        (Scenario(), Scenario(evader=(Evader(), Evader())), None),
        (links(latency=lambda context, rng: 0.0), Scenario(), None),
    ],
    ids=["number", "kind", "share", "infinity", "faults", "fault", "form", "within", "list", "evaders", "function"],
)
def test_a_changed_key_is_named_with_both_values_and_the_unit_of_numbers(first, second, said):
    (text,) = found(first, second)
    assert said in (None, text)


def test_each_part_of_a_page_is_told_to_a_progress_bar():
    told = []
    replay_page(history(), on_part=lambda: told.append("one"))
    side_by_side(history(), pair(), on_part=lambda: told.append("two"))
    assert told == ["one"] * PARTS + ["two"] * 2 * PARTS


def test_what_does_not_change_a_run_is_no_difference():
    other = Scenario(name="b", seed=5, record=Recording(messages=True), sweep=Sweep(reps=2))
    assert found(Scenario(), other) == []
    assert found(Scenario(), other, seeds=(0, 5)) == ["seed: 0 | 5 -"]


def test_a_text_that_ends_like_a_number_is_shown_whole():
    table = {"kind": "trace", "table": "t,v1.0,v2.0\n0,0.1,0.2\n1,0.1,0.2\n"}
    columns = found(*(links(latency=table | {"value": column}) for column in ("v1.0", "v2.0")))
    assert columns[0] == "network.latency.value: v1.0 | v2.0 -"


def test_a_long_value_is_shortened():
    (text,) = found(Scenario(), Scenario(fault=tuple(Crash(node=k, start=1.0) for k in range(20))))
    _, _, value = text.removesuffix(" -").partition("none | ")
    assert len(value) == MAX_TEXT
    assert value.startswith("crash, crash, ")
    assert value.endswith("…")


def lines(first, second):
    return Elements(side_by_side(first, second)).lines


def other_seed(result, seed):
    return Result(result.scenario, seed, result.trace)


def test_the_header_names_both_runs_and_the_differences(monkeypatch):
    monkeypatch.setattr("desim.view.pages.pair.replay_page", lambda *_, **__: "")
    assert "p: the same scenario, seeds 3 and 4" in lines(history(), other_seed(history(), 4))
    assert "p: the same scenario and the same seed" in lines(history(), history())
    header = side_by_side(chase(1, 500), pair()).partition("<header>")[2].partition("</header>")[0]
    text = re.sub(r"\s+", " ", re.sub("<[^>]*>", "", header)).strip()
    assert text == "chase, seed 3 and pair, seed 3 evader.count: 1 and 2"


def test_more_than_six_differences_are_counted():
    change = {"range": 3.0, "fading": "message", "range_check": "both", "order": "fifo", "loss": Bernoulli(p=0.5)}
    change |= {
        "latency": Lognormal(),
        "processing": Links().processing.model_copy(update={"sender": 0.5, "receiver": 1}),
    }
    other = Result(Scenario(network=Links(**change)), 4, history().trace)
    count = len(differences(history(), other))
    assert count > MAX_DIFFERENCES == 6
    page = side_by_side(history(), other)
    assert f"<li>and {count - MAX_DIFFERENCES} more</li>" in page
    assert page.partition("</header>")[0].count("<li>") == MAX_DIFFERENCES + 1


@pytest.mark.slow
def test_the_page_holds_both_replays_and_the_same_bytes_every_time():
    page = side_by_side(history(), pair())
    assert [unescape(each) for each in re.findall('srcdoc="([^"]*)"', page)] == [
        replay_page(history()),
        replay_page(pair()),
    ]
    assert page == side_by_side(history(), pair())


def test_a_hostile_name_is_text_beside_another_run():
    found = Elements(side_by_side(history(name=HOSTILE), history()))
    assert found.title == f"{HOSTILE}, seed 3 and by hand, seed 3"
    assert found.tags.count("iframe") == 2
    assert len(found.scripts) == 1


# The command.


BRIEF = Scenario(name="brief", horizon=0.2, team=Team(count=3), evader=Evader(position=(60.0, 60.0)))


@cache
def recorded():
    """Return two runs, of 3 and 2 pursuers."""
    record = Recording(messages=True)
    return [run(BRIEF.model_copy(update={"record": record, "team": Team(count=n)})) for n in (3, 2)]


@pytest.fixture
def two(tmp_path, monkeypatch, _undrawn):
    """Go to a folder with the folders of two runs."""
    monkeypatch.chdir(tmp_path)
    write(recorded()[0], tmp_path / "one")
    write(recorded()[1], tmp_path / "other")
    return tmp_path


SMALL = "horizon = 0.2\nteam.count = 3\nevader.position = [60.0, 60.0]\n"


@pytest.mark.slow
def test_two_folders_become_a_page_in_the_working_directory(two):
    said = accepted("replay", "one", two / "other").stdout
    page = (two / "one-other.html").read_text(encoding="utf-8")
    assert page == side_by_side(*recorded())
    one, other = (
        f"brief, seed 0: {n} pursuers, 0.20 s, {messages(each).sent:,} messages"
        for n, each in zip((3, 2), recorded(), strict=True)
    )
    assert said == f"one-other.html: {one}; {other}, {len(page.encode()) / 1000:,.0f} kB\n"
    assert not (two / "one" / "replay.html").exists()


@pytest.mark.slow
def test_a_folder_and_a_file_become_a_page_under_a_given_name(two):
    (two / "a.toml").write_text(SMALL)
    accepted("replay", "a.toml", "one", "-o", "x.html")
    assert "unnamed, seed 0 and brief, seed 0" in Elements((two / "x.html").read_text(encoding="utf-8")).title


@pytest.mark.slow
def test_overrides_and_the_seed_apply_to_both_scenario_files(two):
    (two / "a.toml").write_text(SMALL)
    (two / "b.toml").write_text(f"{SMALL}network.range = 5.0\n")
    accepted("replay", "a.toml", "b.toml", "--set", "horizon=0.1", "-s", 9)
    page = (two / "a-b.html").read_text(encoding="utf-8")
    assert "network.range: <b>inf</b> and <b>5</b> m" in page
    assert page.count("seed 9: not captured within 0.1 s") == 2


def test_what_cannot_be_shown_is_reported_with_its_run(two):
    still = BRIEF.model_copy(update={"record": Recording(trajectory=0.0, messages=True)})
    write(run(still), two / "still")
    said = accepted("replay", "one", "still").stderr
    assert said.startswith("warning: still: Positions were not recorded: ")
    assert said.count("warning") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("one", "other", "one"), "one other one: a page plays one run, or two side by side, got 3"),
        (("one", "other", "-o", "x.gif"), "--out x.gif: should end in .html, or have no suffix, got .gif"),
        (("a.html",), "a.html: is a source, and the page would replace it; give another --out"),
        (("a.html", "one", "-o", "a"), "a.html: is a source, and the page would replace it; give another --out"),
        (("a.html", "other", "-s", "3"), "the results in a DIR are recorded"),
        (("a.html", "missing.toml", "-o", "x"), "missing.toml: cannot be read: No such file or directory"),
        (("a.html", "swept"), "swept: is the folder of a sweep or an explanation, which keeps metrics only; "),
        ((), "needs DIR|FILE [DIR|FILE]: a folder with results"),
    ],
    ids=["three", "name", "itself", "one of them", "seed", "missing", "sweep", "none"],
)
def test_what_is_not_one_run_or_two_is_refused(words, said, two):
    (two / "a.html").write_text(SMALL)
    if "swept" in words:
        accepted("sweep", "a.html", "-n", 1, "-o", "swept", "--set", "sweep.grid={ 'evader.speed' = [1.0] }")
    assert said in refused("replay", *words)
    assert sorted(each.name for each in two.glob("*.html")) == ["a.html"]
    assert (two / "a.html").read_text() == SMALL


@pytest.mark.parametrize("option", [("-s", 3), ("--set", "horizon=0.1")])
def test_a_folder_is_refused_with_a_seed_before_a_file_beside_it_is_run(option, two, monkeypatch):
    (two / "a.toml").write_text(SMALL)
    monkeypatch.setattr("desim.simulation.run.World", lambda *_: pytest.fail("it ran"))
    assert "--seed and --set apply to a scenario FILE only" in refused("replay", "a.toml", "one", *option)


# In a browser.


@pytest.fixture
def shown(browser, tmp_path):
    """Return what opens the page of two runs, and judge in the end that nothing went wrong and nothing left it."""
    path = tmp_path / "pair.html"

    def show(first, second, **window):
        path.write_text(side_by_side(first, second), encoding="utf-8")
        browser.open(path, **window)
        browser.until("Array.from(frames).length === 2 && Array.from(frames).every(each => each.replay)")
        return browser

    yield show
    assert browser.errors == []
    assert browser.requests == [path.resolve().as_uri()]


TIMES = "Array.from(frames).map(each => each.replay.time)"
PLAYING = "Array.from(frames).map(each => each.replay.playing)"


def both(opened, expression, wanted):
    """Wait until an expression has a value in both runs."""
    opened.until(f"Array.from(frames).every(({{ replay, document }}) => ({expression}) === {wanted})")


RUNS = history(), chase(2, 500)
ORDERS = pytest.mark.parametrize(("first", "second"), [RUNS, RUNS[::-1]], ids=["longer first", "shorter first"])


@in_chromium
@pytest.mark.whole
@ORDERS
def test_a_seek_in_either_run_moves_both_and_the_shorter_stays_at_its_end(first, second, shown):
    """One lasts 1 s, the other 0.5 s."""
    opened = shown(first, second)
    ends = [ended(each).t / SECOND for each in (first, second)]
    for k in (0, 1):
        for t in (0.25, 0.75, 0.5, 0.125, 0.0):
            opened.value(f"frames[{k}].replay.seek({t})")
            reached = min(t, ends[k])  # a run cannot be sought beyond its end
            opened.until(f"{TIMES}.join() === '{min(reached, ends[0]):g},{min(reached, ends[1]):g}'")
    slide = "({ slider, replay }) => { slider.value = 0.2 / replay.end * slider.max; slider.oninput(); }"
    opened.value(f"({slide})(frames[1])")
    opened.until(f"{TIMES}.every(t => Math.abs(t - 0.2) < 1e-6)")


@in_chromium
@pytest.mark.whole
@pytest.mark.parametrize(("k", "first", "second"), [(0, *RUNS), (1, *RUNS)], ids=["longer", "shorter"])
def test_play_in_either_run_plays_both_to_the_end_of_the_longer(k, first, second, shown):
    """The button in either pauses both; at the end, it plays both from the start."""
    opened = shown(first, second)
    ends = ",".join(f"{ended(each).t / SECOND:g}" for each in (first, second))
    press = f"frames[{k}].document.getElementById('play').click()"
    opened.value("frames[1].replay.speed = 1")
    both(opened, "replay.speed", 1)
    opened.value(press)
    opened.until(f"{PLAYING}.every(each => each) && {TIMES}.every(t => t > 0.1)")
    assert opened.value(f"(([a, b]) => Math.abs(a - b) < 1e-8 || Math.max(a, b) > 0.5)({TIMES})")
    opened.value(press)
    both(opened, "replay.playing", "false")
    there = opened.value(TIMES)
    assert max(there) < 1.0
    opened.value("new Promise(done => setTimeout(done, 100))")
    assert opened.value(TIMES) == there
    opened.value(press)
    opened.until(f"{TIMES}.join() === '{ends}' && {PLAYING}.join() === 'false,false'")
    opened.value(press)
    opened.until(f"{PLAYING}.join() === 'true,true' && {TIMES}.every(t => t < 0.4)")
    opened.until(f"{TIMES}.join() === '{ends}' && {PLAYING}.join() === 'false,false'")


@in_chromium
@pytest.mark.slow
def test_speed_and_theme_are_the_same_in_both_and_the_last_change_counts(shown):
    opened = shown(*RUNS, theme="light")
    both(opened, "replay.theme", "'light'")
    assert len(set(opened.value("Array.from(frames).map(each => each.replay.speed)"))) == 1
    for k, speed in ((0, 2), (1, 0.5), (1, 5), (0, 0.1)):
        opened.value(f"(menu => {{ menu.value = {speed}; menu.onchange(); }})(frames[{k}].speed)")
        both(opened, "+document.getElementById('speed').value", speed)
        both(opened, "replay.speed", speed)
    for k, theme in ((0, "dark"), (1, "light"), (1, "dark")):
        opened.value(f"frames[{k}].document.getElementById('theme').click()")
        both(opened, "replay.theme", f"'{theme}'")
        opened.until(f"document.documentElement.dataset.theme === '{theme}'")


@in_chromium
@pytest.mark.slow
def test_keys_work_without_a_click_into_a_run(shown):
    opened = shown(*RUNS)
    opened.press("t")
    both(opened, "replay.theme", "'dark'")
    opened.press("End")
    opened.until(f"{TIMES}.join() === '1,0.5'")
    opened.press("Home")
    opened.until(f"{TIMES}.join() === '0,0'")
    opened.press(" ", " ")
    opened.until(f"{PLAYING}.join() === 'true,true'")
    opened.press(" ", " ")
    opened.until(f"{PLAYING}.join() === 'false,false'")


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("k", [0, 1])
def test_steps_from_event_to_event_move_both(k, shown):
    """Each run steps through its own changes of action, although the other one has ticks of another length."""
    long = chase(1, 5000)
    long.trace.events[1:1] = [Decided(t, 0, active) for t, active in ((123_456_789, 0), (400_000_001, 1))]
    runs = history(), long
    opened = shown(*runs)
    wanted = [(0.15, 0.4, 0.8), (0.12345679, 0.4)][k]
    for t in wanted:
        opened.value(f"frames[{k}].document.getElementById('next').click()")
        opened.until(f"{TIMES}.every(t => Math.abs(t - {t}) < 2e-8)")
    for t in wanted[-2::-1]:
        opened.value(f"frames[{k}].document.getElementById('back').click()")
        opened.until(f"{TIMES}.every(t => Math.abs(t - {t}) < 2e-8)")


FITS = """({ document, innerHeight }) => {
  const [stage, footer] = ["#stage", "footer"].map(each => document.querySelector(each).getBoundingClientRect());
  return stage.top >= 0 && stage.bottom <= footer.top && stage.height >= 200 && footer.bottom <= innerHeight + 1;
}"""
"""Whether the plane and the controls of a run are visible at once."""


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "height", "theme"),
    [(1920, 1080, "light"), (1280, 800, "dark"), (1100, 700, "light"), (1000, 700, "dark"), (420, 800, "light")],
)
def test_two_runs_are_beside_each_other_in_a_wide_window_and_below_each_other_in_a_narrow_one(
    width, height, theme, shown
):
    """In each, nothing is wider than its frame, and plane and controls are visible at once."""
    opened = shown(*RUNS, width=width, height=height, theme=theme)
    assert opened.value("document.documentElement.dataset.theme") == theme
    boxes = "[...document.querySelectorAll('iframe')].map(each => each.getBoundingClientRect())"
    left, right = opened.value(f"{boxes}.map(({{ left, top, width }}) => [left, top, width])")
    assert (left[1] == right[1]) is (width >= 1100)
    assert (left[0] == right[0]) is (width < 1100)
    assert opened.value("document.documentElement.scrollWidth <= innerWidth")
    if width >= 1100:
        assert opened.value("document.documentElement.scrollHeight") <= height
    for k in (0, 1):
        opened.until(f"frames[{k}].document.documentElement.scrollWidth <= frames[{k}].innerWidth")
        opened.until(f"({FITS})(frames[{k}])")


@in_chromium
@pytest.mark.slow
def test_hostile_names_are_shown_as_text_beside_each_other(shown):
    opened = shown(history(name=HOSTILE), chase(2, 500))
    assert opened.value("document.querySelector('h1').textContent") == f"{HOSTILE}, seed 3 and chase, seed 3"
    assert opened.value("[window, ...Array.from(frames)].map(each => each.hurt)") == [None, None, None]
