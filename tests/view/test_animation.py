"""Films: what stands where in which frame, how long frames are shown, and the same bytes every time."""

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from desim import load, run
from desim.analysis.plots import styled
from desim.view.animation import COLOURS, HOLD, MOST, SHADES, SHORT, _Stage, animate, frames
from scenarios.study import SCENARIOS
from tests.view.by_hand import MS, history, pair


def played(path):
    """Return the frames of a GIF as arrays, and how long each is shown, ms."""
    with Image.open(path) as film:
        found, pauses = [], []
        for k in range(film.n_frames):
            film.seek(k)
            found.append(np.asarray(film.convert("RGB")))
            pauses.append(film.info["duration"])
        return found, pauses, film.info.get("loop")


def at(result, t, before=-1, evader=1):
    """Return the points of what moves, of one evader and of all, by its name on the stage, and the caption."""
    with styled((4.0, 4.0)) as figure:
        stage = _Stage(figure, result)
        stage.at(t * MS, before * MS)
    moving = vars(stage) | vars(stage._quarries[evader - 1])
    points = {name: line.get_xydata() for name, line in moving.items() if hasattr(line, "get_xydata")}
    return {name.lstrip("_"): each[~np.isnan(each).any(axis=1)].tolist() for name, each in points.items()} | {
        "caption": stage._caption.get_text()
    }


@pytest.mark.parametrize(
    ("t", "inactive", "beside", "alone", "caption"),
    [
        (0, [[0, 10]], [[0, 0], [10, 0]], [], "0.00 s: 2 active"),
        (200, [[10, 0], [0, 10]], [], [[2, 0]], "0.20 s: pursuer 0 alone"),
        (500, [[4, 0], [10, 0], [0, 10]], [], [], "0.50 s: 0 active"),
        (800, [[4, 0], [10, 0]], [], [[0, 10]], "0.80 s: pursuer 2 alone"),
        (1000, [[4, 0], [10, 0]], [], [[0, 10]], "1.00 s: captured by 2"),
    ],
)
def test_everyone_stands_where_it_was_in_the_look_of_what_it_did(t, inactive, beside, alone, caption):
    """Sampled every 100 ms; pursuer 0 runs 4 m in its first 400 ms."""
    found = at(history(samples=range(0, 1001, 100)), t)
    assert (found["inactive"], found["beside"], found["alone"]) == (inactive, beside, alone)
    assert found["caption"] == caption
    assert found["evader"] == [[5.0, pytest.approx(5.0 + t / 1000)]]
    assert found["star"] == (found["evader"] if t == 1000 else [])


@pytest.mark.parametrize(
    ("t", "inactive", "on_1", "on_2", "captured", "caption"),
    [
        (0, [], [[0, 0], [10, 0]], [[0, 10]], (), "0.00 s: captured 0 of 2, 3 active"),
        (200, [], [[0.8, 0]], [[10, 0], [0, 10]], (), "0.20 s: captured 0 of 2, 3 active"),
        (300, [[0, 10]], [[1.2, 0]], [[10, 0]], (), "0.30 s: captured 0 of 2, 2 active"),
        (400, [[0, 10]], [], [[1.6, 0], [10, 0]], (1,), "0.40 s: captured 1 of 2, 2 active"),
        (800, [[10, 0], [0, 10]], [], [[3.2, 0]], (1,), "0.80 s: captured 1 of 2, 1 active"),
        (1000, [[4, 0], [10, 0], [0, 10]], [], [], (1, 2), "1.00 s: captured 2 of 2, the last by 0"),
    ],
)
def test_of_two_evaders_each_is_chased_by_its_own_and_captured_in_its_time(t, inactive, on_1, on_2, captured, caption):
    for evader, chasers in ((1, on_1), (2, on_2)):
        found = at(pair(), t, evader=evader)
        assert np.round(found["inactive"], 9).tolist() == inactive
        alone, beside = (np.round(found[name], 9).reshape(-1, 2).tolist() for name in ("alone", "beside"))
        assert (alone, beside) == ((chasers, []) if len(chasers) == 1 else ([], chasers))
        place = [5, 5 + min(t, 400) / 1000] if evader == 1 else [8 + t / 1000, 2]
        assert found["evader"] == [pytest.approx(place)]
        assert found["star"] == (found["evader"] if evader in captured else [])
        assert found["caption"] == caption


def test_the_frames_of_two_evaders_are_in_the_colours_of_their_palette():
    """What is drawn in a hue stays near it: the green of who chases evader 2 is in the picture."""
    image = frames(pair(), [800 * MS])[0]
    green = np.array([0, 158, 115])
    assert (np.abs(np.asarray(image.convert("RGB")).astype(int) - green).sum(axis=2) < 12).sum() > 50


def test_trails_are_as_long_as_the_past():
    found = at(history(samples=range(0, 1001, 100)), 300)
    assert sorted(found["trails"]) == [[0, 0], [1, 0], [pytest.approx(1.5), 0], [10, 0], [10, 0], [10, 0]]
    assert found["relay"] == [[pytest.approx(1.5), 0], [2, 0], [3, 0]]
    assert found["evaded"][-1] == [5.0, pytest.approx(5.3)]


def test_a_message_moves_evenly_from_its_sender_to_where_its_receiver_will_be():
    """From (1, 0) at 100 ms to (10, 0) at 200 ms; a message that waits or never leaves is not seen."""
    result = history(samples=range(0, 1001, 100))
    assert at(result, 99)["dots"] == []
    assert at(result, 100)["dots"] == [[1, 0]]
    assert at(result, 150)["dots"] == [[pytest.approx(5.5), 0]]
    assert at(result, 200)["dots"] == []
    assert at(result, 260)["dots"] == []
    assert at(result, 400)["dots"] == [[pytest.approx(2.0), pytest.approx(5.0)]]


def test_a_loss_is_seen_in_the_frame_after_it_near_its_receiver():
    """On the way from (1, 0) to (0, 10), 0.02 of the picture's 11 m before its end."""
    result = history(samples=range(0, 1001, 100))
    before = SHORT * 11.0 / np.hypot(1, 10)
    assert at(result, 100, before=50)["crosses"] == [[pytest.approx(before), pytest.approx(10.0 - 10.0 * before)]]
    assert at(result, 150, before=100)["crosses"] == []
    assert len(at(result, 800, before=700)["crosses"]) == 2


def test_a_film_lasts_as_long_as_the_run_at_its_speed(tmp_path):
    """1 s at half speed: 2 s at 20 frames a second, and the last frame held."""
    assert animate(history(), tmp_path / "film.gif", speed=0.5) == 41
    _, pauses, loop = played(tmp_path / "film.gif")
    assert sum(pauses) == 2000 + HOLD
    assert pauses[-1] >= HOLD
    assert loop == 0


def test_pauses_are_hundredths_of_a_second_and_the_speed_is_kept(tmp_path):
    """30 frames a second would pause for 33.3 ms; the format has 30 ms, so there are 34 pauses for 1 s."""
    assert animate(history(), tmp_path / "film.gif", fps=30) == 35
    assert sum(played(tmp_path / "film.gif")[1]) == 34 * 30 + HOLD


def test_a_frame_depends_on_the_one_before_only_by_what_was_lost_since():
    """The loss at 100 ms is in the second frame and not in the third."""
    lost, after = frames(history(), [0, 150 * MS, 300 * MS])[1:]
    plain, same = frames(history(), [120 * MS, 150 * MS])[1], frames(history(), [200 * MS, 300 * MS])[1]
    assert lost.tobytes() != plain.tobytes()
    assert after.tobytes() == same.tobytes()


def test_a_part_of_a_run_is_filmed_alone(tmp_path):
    animate(history(), tmp_path / "part.gif", begin=0.4, end=0.8, fps=25)
    assert sum(played(tmp_path / "part.gif")[1]) == 400 + HOLD


def test_frames_are_in_the_colours_of_one_palette_and_only_what_moves_changes():
    first, last = frames(history(), [0, 1000 * MS])
    assert first.getpalette() == last.getpalette()
    assert len(first.getcolors()) <= 1 + len(COLOURS) * SHADES
    changed = np.asarray(first) != np.asarray(last)
    assert 0 < changed.mean() < 0.05
    assert not changed[-60:].any()  # the legend


def test_nothing_is_cut_off_at_the_edge():
    for image in frames(history(), [0, 500 * MS, 1000 * MS]):
        pixels = np.asarray(image.convert("RGB"))
        for edge in (pixels[:4], pixels[-4:], pixels[:, :4], pixels[:, -4:]):
            assert (edge == 255).all()


def test_a_film_made_twice_is_the_same_bytes_and_leaves_luck_and_style_alone(tmp_path):
    luck, style = np.random.get_state()[1].tolist(), dict(mpl.rcParams)  # noqa: NPY002 - the global generator is meant
    animate(history(), tmp_path / "one.gif")
    animate(history(), tmp_path / "two.gif")
    animate(history(name="another", messages=False), tmp_path / "three.gif")
    one, two, three = ((tmp_path / f"{name}.gif").read_bytes() for name in ("one", "two", "three"))
    assert one == two != three
    assert np.random.get_state()[1].tolist() == luck  # noqa: NPY002
    assert dict(mpl.rcParams) == style


def test_messages_are_in_the_legend_only_if_there_are_any():
    def names(result):
        with styled((4.0, 4.0)) as figure:
            _Stage(figure, result)
        return [text.get_text() for text in figure.legends[0].get_texts()]

    players = ["inactive", "active with others", "active alone", "evader"]
    assert names(history()) == [*players, "message", "lost"]
    assert names(history(messages=False)) == players


@pytest.mark.slow
def test_six_seconds_of_twenty_pursuers_and_their_messages_are_less_than_a_megabyte(tmp_path):
    """Measured: 0.44 MB for 5.2 s."""
    animate(run(load(SCENARIOS / "relay.toml")), tmp_path / "film.gif", end=6.0)
    assert (tmp_path / "film.gif").stat().st_size < 1e6


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"begin": 1.0}, "from 1 s to 1 s: the run lasted 1 s"),
        ({"begin": 0.5, "end": 0.2}, "nothing from 0.5 s to 0.2 s"),
        ({"speed": 0.0}, "greater than 0"),
        ({"fps": 51}, "from 1 to 50"),
        ({"speed": 1e-4}, f"more than {MOST} frames: choose a higher speed"),
        ({"speed": 1e-12}, "more than"),
    ],
)
def test_what_cannot_be_filmed_is_said(tmp_path, asked, says):
    with pytest.raises(ValueError, match=says):
        animate(history(), tmp_path / "film.gif", **asked)
    assert not list(tmp_path.iterdir())


def test_without_recorded_positions_it_is_said_how_to_record_them(tmp_path):
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        animate(history(samples=()), tmp_path / "film.gif")
