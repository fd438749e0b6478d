"""Films: what stands where in which frame, how long frames are shown, and the same bytes every time."""

import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

from desim.analysis.drawing.plots import styled
from desim.view.pictures.animation import COLOURS, HOLD, MAX_FRAMES, SHADES, _drawn, _Scene, animate, frames
from tests.command import refused
from tests.drawn import described, line_of, text_of, without_layout
from tests.golden import golden
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


def staged(result, *times):
    """Return the stage as text, and then what moves at each (time, that of the frame before), in order of drawing."""
    with styled((4.0, 4.0), font=9.0) as figure:
        stage = _Scene(figure, result)
        told = [described(figure)]
        for t, before in times:
            moving = stage.at(t * MS, before * MS)
            told += [f"at {t} ms after {before} ms", *(each for each in map(moved, moving) if each)]
    return "\n".join(told)


def moved(artist):
    """Return what moves as text, nothing if it is not there."""
    if isinstance(artist, Text):
        return text_of(artist) if artist.get_text() else ""
    return line_of(artist) if np.isfinite(artist.get_xydata()).any() else ""


def test_frames_of_runs_by_hand_are_golden():
    """All positions, sampled every 100 ms, have the style of the action; pursuer 0 runs 4 m in 400 ms.

    A message moves evenly from (1, 0) at 100 ms to (10, 0) at 200 ms; one that waits or never leaves is not seen. A
    loss is in the frame after it, 0.02 of the picture's 11 m before its receiver: on the way from (1, 0) to (0, 10)
    at 0.02 x 11 / sqrt(101) of the way.
    """
    alone = staged(
        history(samples=range(0, 1001, 100)),
        *((0, -1), (99, 0), (100, 50), (150, 100), (200, 150), (400, 300), (500, 400), (800, 700), (1000, 900)),
    )
    two = staged(pair(), (0, -1), (200, 0), (300, 200), (400, 300), (800, 700), (1000, 900))
    mute = staged(history(messages=False, name="mute"))
    golden("animation.txt", {"by hand": alone, "pair": two, "mute": mute})


@pytest.mark.slow_but_one
@pytest.mark.parametrize("pixels", [(100, 112), None])
def test_the_progress_counts_each_frame(pixels, monkeypatch):
    counted = []

    @contextmanager
    def counting(*told):
        yield SimpleNamespace(update=lambda: counted.append(told))

    monkeypatch.setattr("desim.view.pictures.animation.progress", counting)
    frames(history(), [0, 150 * MS, 300 * MS], pixels)
    assert counted == [(3, "frames", "frame")] * 3


def test_the_frames_of_two_evaders_are_in_the_colours_of_their_palette():
    """What is drawn in a hue stays near it: the green of the chasers of evader 2 is in the picture."""
    image = frames(pair(), [800 * MS])[0]
    green = np.array([0, 158, 115])
    assert (np.abs(np.asarray(image.convert("RGB")).astype(int) - green).sum(axis=2) < 12).sum() > 50


@pytest.fixture
def blank(monkeypatch):
    """Let frames be blank, which takes no time, and return the times (ns) and the pixels of those that are drawn."""
    asked = []

    def drawn(_result, times, pixels):
        asked.append((list(times), pixels))
        for k in range(len(times)):
            yield Image.new("RGB", pixels, (k, k, k))

    monkeypatch.setattr("desim.view.pictures.animation._drawn", drawn)
    return asked


@pytest.mark.parametrize(
    ("asked", "count", "pause"),
    [
        ({"speed": 0.5, "end": 0.2, "fps": 20}, 8, 50),
        ({"begin": 0.4, "end": 0.8, "fps": 25}, 10, 40),
        ({"begin": 0.8, "fps": 30}, 7, 30),
    ],
    ids=["half speed", "a part", "hundredths of a second"],
)
def test_a_film_lasts_as_long_as_the_run_at_its_speed(asked, count, pause, blank, tmp_path):
    """The last frame is held. 30 frames a second would pause for 33.3 ms; the format has 30 ms: 7 pauses for 0.2 s."""
    assert animate(history(), tmp_path / "film.gif", **asked) == count + 1
    ((times, _),) = blank
    begin, end = asked.get("begin", 0.0), asked.get("end", 1.0)
    step = pause * asked.get("speed", 1.0)
    assert times == [round((begin * 1000 + k * step) * MS) for k in range(count)] + [round(end * 1000 * MS)]
    _, pauses, loop = played(tmp_path / "film.gif")
    assert sum(pauses) == count * pause + HOLD
    assert pauses[-1] >= HOLD
    assert loop == 0


@pytest.mark.whole
def test_a_frame_depends_on_the_one_before_only_by_what_ended_since():
    """The loss at 100 ms is in the second frame and not in the third, which has the arrival at 200 ms."""
    lost, after = frames(history(), [0, 150 * MS, 300 * MS])[1:]
    plain, same = frames(history(), [120 * MS, 150 * MS])[1], frames(history(), [150 * MS, 300 * MS])[1]
    assert lost.tobytes() != plain.tobytes()
    assert after.tobytes() == same.tobytes() != frames(history(), [200 * MS, 300 * MS])[1].tobytes()


@pytest.mark.whole
def test_the_first_frame_has_no_marks_of_messages_that_ended_earlier():
    """The loss at 100 ms and the arrival at 200 ms precede the window."""
    (first,), (_, later) = frames(history(), [300 * MS]), frames(history(), [290 * MS, 300 * MS])
    assert first.tobytes() == later.tobytes()


@pytest.mark.slow
def test_frames_are_in_the_colours_of_one_palette_and_only_what_moves_changes():
    first, last = frames(history(), [0, 1000 * MS])
    assert first.getpalette() == last.getpalette()
    assert len(first.getcolors()) <= 1 + len(COLOURS) * SHADES
    changed = np.asarray(first) != np.asarray(last)
    assert 0 < changed.mean() < 0.05
    legend = np.asarray(first.convert("RGB"))[-60:]
    assert (legend < 255).any()
    assert not changed[-60:].any()


@pytest.mark.slow
def test_nothing_is_cut_off_at_the_edge():
    for image in frames(history(), [0, 500 * MS, 1000 * MS]):
        pixels = np.asarray(image.convert("RGB"))
        for edge in (pixels[:4], pixels[-4:], pixels[:, :4], pixels[:, -4:]):
            assert (edge == 255).all()


@pytest.mark.whole
def test_a_film_made_twice_has_equal_bytes_and_leaves_global_generators_and_style_alone(tmp_path):
    luck, style = np.random.get_state()[1].tolist(), dict(mpl.rcParams)  # noqa: NPY002 - the global generator is meant
    for name, messages in (("one", True), ("two", True), ("three", False)):
        animate(history(messages=messages), tmp_path / f"{name}.gif", begin=0.1, end=0.2, fps=10)
    one, two, three = ((tmp_path / f"{name}.gif").read_bytes() for name in ("one", "two", "three"))
    assert one == two != three
    assert np.random.get_state()[1].tolist() == luck  # noqa: NPY002
    assert dict(mpl.rcParams) == style


@pytest.mark.whole
def test_six_seconds_of_twenty_pursuers_and_their_messages_are_less_than_a_megabyte(tmp_path, run_of):
    """Measured: 0.44 MB for 5.2 s. A quarter of it is filmed."""
    animate(run_of("relay.toml"), tmp_path / "film.gif", end=1.5)
    assert (tmp_path / "film.gif").stat().st_size < 0.25e6


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"begin": 1.0}, "from 1 s to 1 s is empty: the run lasted 1 s"),
        ({"begin": 0.5, "end": 0.2}, "window from 0.5 s to 0.2 s is empty"),
        ({"speed": 0.0}, "greater than 0"),
        ({"fps": 51}, "from 1 to 50"),
        ({"fps": 12.5}, "fps should be an integer"),
        ({"begin": "1"}, "begin should be a number"),
        ({"speed": 1e-4}, f"more than {MAX_FRAMES} frames: choose a higher speed"),
        ({"speed": 1e-12}, "more than"),
    ],
)
def test_a_run_that_cannot_be_filmed_is_reported(tmp_path, asked, says):
    with pytest.raises(ValueError, match=says):
        animate(history(), tmp_path / "film.gif", **asked)
    assert not list(tmp_path.iterdir())


def test_without_recorded_positions_the_error_explains_how_to_record_them(tmp_path):
    with pytest.raises(ValueError, match=r"record\.trajectory"):
        animate(history(samples=()), tmp_path / "film.gif")


# Sizes, and videos.


@pytest.mark.parametrize(
    ("size", "pixels"),
    [
        (None, (480, 540)),
        ("240px", (240, 270)),
        ("320x180px", (320, 180)),
        ("5.08cm", (200, 224)),
        ("2inx3in", (200, 300)),
        ("101 px x 4096px", (100, 4096)),
    ],
)
def test_a_film_has_the_size_that_is_asked_for(size, pixels, blank, tmp_path):
    animate(history(), tmp_path / "film.gif", begin=0.1, end=0.2, size=size)
    assert [pixels_of_film for _, pixels_of_film in blank] == [pixels]
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == pixels


def test_symbols_and_texts_grow_with_a_picture(monkeypatch):
    """A picture of twice as many pixels each way is the same figure at twice the resolution."""
    seen = []

    @contextmanager
    def noted(size):
        with styled(size) as figure:
            yield figure
        seen.append((size, figure.dpi))
        raise StopAsyncIteration

    monkeypatch.setattr("desim.view.pictures.animation.styled", noted)
    with without_layout():
        for pixels in ((480, 540), (960, 1080), (960, 540)):
            with pytest.raises(StopAsyncIteration):
                next(_drawn(history(), [0], pixels))
    assert seen == [((4.8, 5.4), 100.0), ((4.8, 5.4), 200.0), ((9.6, 5.4), 100.0)]


def test_a_video_is_written_frame_by_frame_and_the_last_one_held(blank, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    asked, frames_sent = [], []

    def write_frames(path, size, **options):
        asked.append((Path(path).suffix, size, options))
        try:
            while True:
                frames_sent.append((yield))
        finally:
            asked.append("closed")
            Path(path).write_bytes(b"film")

    monkeypatch.setattr(ffmpeg, "write_frames", write_frames)
    assert animate(history(), tmp_path / "film.mp4", begin=0.5, end=0.7, fps=10, size="100px") == 3
    exact = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart", "-f", "mp4"]
    look = {"fps": 10.0, "codec": "libx264", "macro_block_size": 2, "quality": 8, "output_params": exact}
    (_, *told), closed = asked
    assert (told, closed) == ([(100, 112), look], "closed")
    assert [frame[:3] for frame in frames_sent] == [bytes([k] * 3) for k in (0, 1, *[2] * 16)]
    assert {len(frame) for frame in frames_sent} == {3 * 100 * 112}
    assert (tmp_path / "film.mp4").read_bytes() == b"film"


@pytest.mark.parametrize(
    ("size", "message"),
    [("10px", "from 100 to 4096 pixels"), ("wide", "a film also in px"), ("9000x9000px", "from 100 to 4096 pixels")],
)
def test_another_size_is_refused(size, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        animate(history(), tmp_path / "film.gif", size=size)
    with pytest.raises(ValueError, match=r"film.avi: a film should end in .gif or .mp4"):
        animate(history(), tmp_path / "film.avi")
    assert not list(tmp_path.iterdir())


def test_a_gif_that_does_not_fit_into_memory_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"too many for a GIF: .* or an MP4"):
        animate(history(), tmp_path / "film.gif", size="4000x4000px", speed=0.04, fps=20)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of the pipes of imageio-ffmpeg
@pytest.mark.whole
def test_a_video_has_the_frames_of_the_gif(tmp_path):
    """Ten frames a second of 0.5 s, and the last one for 1.5 s; H.264 changes colours a little."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    count = animate(history(), tmp_path / "film.mp4", end=0.5, fps=10, size="240x270px")
    assert animate(history(), tmp_path / "film.gif", end=0.5, fps=10, size="240x270px") == count == 6
    reader = ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    about = next(reader)
    video = [np.frombuffer(frame, np.uint8).reshape(270, 240, 3).astype(float) for frame in reader]
    assert (about["size"], about["fps"], len(video)) == ((240, 270), 10.0, 6 + 15)
    shots, _, _ = played(tmp_path / "film.gif")
    for shot, frame in zip(shots, video, strict=False):
        assert np.abs(shot - frame).mean() < 4.0
    assert np.abs(shots[0] - video[5]).mean() > np.abs(shots[5] - video[5]).mean(), "a control"
    again = tmp_path / "again.mp4"
    animate(history(), again, end=0.5, fps=10, size="240x270px")
    assert again.read_bytes() == (tmp_path / "film.mp4").read_bytes()


@pytest.mark.parametrize(("name", "error"), [("film.mp4", ModuleNotFoundError), ("film.gif", ValueError)])
def test_the_package_of_videos_is_asked_for_before_all_else_and_for_videos_only(tmp_path, monkeypatch, name, error):
    """The window is empty."""
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(error):
        animate(history(), tmp_path / name, begin=1e6)


def test_without_its_package_a_video_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ModuleNotFoundError):
        animate(history(), tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.toml").write_text('name = "a"\nhorizon = 0.1\nteam.count = 2\n')
    message = refused("plot", tmp_path / "a.toml", "--kind", "film", "-o", tmp_path / "film.mp4")
    assert message == (
        "no picture: imageio_ffmpeg is missing: pip install 'pursuit-desim[film]',"
        " or in a clone pip install '.[film]'\n"
    )
