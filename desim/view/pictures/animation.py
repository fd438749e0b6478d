"""A run as a GIF or an MP4 for slides: a plan view of the players that shows active pursuers and messages in flight.

Colours, symbols and the motion of messages are as in the replay: see `desim.analysis.drawing.palette` and
`desim.view.pages.replay_data`. A collision is a cross, like any other loss.

All frames share one background, and those of a GIF one palette; equal runs give equal bytes.
"""

import re
from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D
from PIL import Image

from desim.analysis.deliveries import deliveries
from desim.analysis.drawing.palette import (
    ACTIVE,
    ACTIVE_WITH_OTHERS,
    CAPTURE_MARK,
    DELIVERED,
    EVADER,
    GREY,
    HUES,
    IN_FLIGHT,
    INACTIVE,
    LOST,
    LOST_MARK,
    PURSUER_MARK,
)
from desim.analysis.drawing.plots import Axes, Figure, size_of, styled
from desim.analysis.drawing.walls import draw_walls
from desim.analysis.trace_index import captures, ended, messages_recorded, started
from desim.config.arguments import value_text
from desim.config.arrays import Floats
from desim.config.errors import ArgumentError
from desim.config.python_numbers import real, whole
from desim.config.whole_files import replacing
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import nanoseconds, seconds, time_text
from desim.simulation.run import Result
from desim.study.workers.progress import progress
from desim.view.pictures.paths import EvaderStyle, Paths, active_periods

WIDTH, HEIGHT = 4.8, 5.4
"""Size of a frame, inches."""
PAD = 0.1
"""Margin around the figure, inches."""
DPI = 100
"""Dots per inch of a frame of the usual size, or of a size that the user gives as a length."""
MAX_FRAMES = 1500
"""Maximum number of frames; each takes 0.4 MB of memory in a GIF of the usual size."""
MAX_PIXELS = 1_000_000_000
"""Maximum number of pixels of all frames of a GIF, which are in memory at once; those of an MP4 are not."""
PIXELS = re.compile(r"(?P<width>\d+)(x(?P<height>\d+))?px")
SIDES = 100, 4096
"""The least and the greatest width and height of a frame, pixels."""
SUFFIXES = (".gif", ".mp4")
HOLD = 1500
"""Display time of the last frame, ms."""
COLOURS = ("black", INACTIVE, ACTIVE, ACTIVE_WITH_OTHERS, EVADER, IN_FLIGHT, DELIVERED, LOST)
"""The colours of a GIF with one evader; with several it also has `HUES`."""
PALE = 0.4
"""If there are several evaders, the weight of an evader's hue in the colour of the pursuers that chase it together; the
rest is white."""
MAX_NAMED = 6
"""Maximum number of evaders in the legend."""
RECEIVER_GAP = 0.02
"""Distance, in widths of the axes, between the mark of an arrival or a loss and the receiver; at most half of the way
from the sender."""
SHADES = 10
"""Number of shades of each colour, towards white."""


def animate(
    result: Result,
    path: str | Path,
    *,
    begin: float = 0.0,
    end: float | None = None,
    speed: float = 1.0,
    fps: int = 20,
    size: str | None = None,
) -> int:
    """Write a run as a GIF or an MP4 and return the number of frames.

    An MP4 needs imageio-ffmpeg (the extra `film`). It is a tenth as large, has all colours, and presentation programs
    can pause it; a GIF plays in any page, again and again.

    Args:
        result: the result of a run with recorded positions; messages are drawn as dots if they were recorded, too.
        path: the output file, .gif or .mp4.
        begin: the start of the time window, s.
        end: the end of the time window, s; None or a time after the end of the run = the end of the run.
        speed: simulated seconds per second of the animation.
        fps: frames per second, at most 50; rounded up such that a frame lasts a whole number of hundredths of a second,
            the time unit of GIF.
        size: the width and perhaps the height of a frame, such as "1920x1080px", "1280px" or "12cm" (at 100 dots per
            inch); symbols and texts grow with it. None = 480x540px.

    Raises:
        ModuleNotFoundError: if imageio-ffmpeg is missing for an MP4.
        ValueError: if no positions were recorded, `speed`, `fps` or `size` is out of bounds, an argument is no number,
            the window is empty or has too many frames, or the file is neither a GIF nor an MP4.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    begin, speed, fps = real(begin, "begin"), real(speed, "speed"), whole(fps, "fps")
    is_video = path.suffix.lower() == ".mp4"
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: a film should end in {' or '.join(SUFFIXES)}")
    pixels = _pixels(size)
    if is_video:
        import imageio_ffmpeg  # noqa: F401 - missing packages are reported before anything is drawn
    run_end = seconds(ended(result).t)
    last = run_end if end is None else min(real(end, "end"), run_end)
    if not 0.0 <= begin < last:
        raise ValueError(
            f"`begin`, `end`: the window from {begin:g} s to {last:g} s is empty: the run lasted {run_end:g} s"
        )
    if not (0.0 < speed < inf and 1 <= fps <= 50):
        raise ValueError(f"the speed should be greater than 0 and fps from 1 to 50, got {speed:g} and {fps}")
    pause = 100 // fps * 10  # ms
    step = nanoseconds(min(speed * pause / 1000.0, run_end))
    times = [*range(nanoseconds(begin), nanoseconds(last), max(step, 1))[: MAX_FRAMES + 1], nanoseconds(last)]
    if len(times) > MAX_FRAMES:
        raise ValueError(
            f"{last - begin:g} s at speed {speed:g} and {fps} fps are more than {MAX_FRAMES} frames: choose a higher"
            " speed, fewer fps, or a shorter window"
        )
    if is_video:
        with replacing(path) as part:
            _write_video(part, _drawn(result, times, pixels), pixels, 1000.0 / pause, HOLD // pause)
        return len(times)
    if len(times) * pixels[0] * pixels[1] > MAX_PIXELS:
        raise ValueError(
            f"{len(times)} frames of {pixels[0]}x{pixels[1]} pixels are too many for a GIF: choose a smaller size,"
            " fewer fps, a shorter window, or an MP4"
        )
    first, *further = frames(result, times, pixels)
    pauses = [pause] * len(further) + [HOLD]
    with replacing(path) as part:
        first.save(part, "GIF", save_all=True, append_images=further, duration=pauses, loop=0, optimize=False)
    return len(times)


def _pixels(size: str | None) -> tuple[int, int]:
    """Return the even width and height of a frame, pixels, as a video needs them.

    Raises:
        ValueError: if the text is not a size, or the size is out of bounds.
    """
    if size is None:
        return round(WIDTH * DPI), round(HEIGHT * DPI)
    if match := PIXELS.fullmatch(str(size).replace(" ", "").replace("pxx", "x")):
        width, height = float(match["width"]), None if match["height"] is None else float(match["height"])
    else:
        try:
            width, height = (None if side is None else side * DPI for side in size_of(size))  # type: ignore[assignment]
        except ArgumentError as error:
            raise ArgumentError(error.name, f"{error.reason}; of a film also in px, as 1280x720px") from error
    sides = width, width * HEIGHT / WIDTH if height is None else height
    if not all(SIDES[0] <= side <= SIDES[1] for side in sides):
        why = f"of a film should be from {SIDES[0]} to {SIDES[1]} pixels, each way"
        raise ArgumentError("size", f"{why} (got {value_text(size)})")
    return 2 * round(sides[0] / 2), 2 * round(sides[1] / 2)


def _write_video(path: Path, images: Iterator[Image.Image], pixels: tuple[int, int], fps: float, hold: int) -> None:
    """Write pictures as an H.264 video; the last one is held for a number of frames."""
    import imageio_ffmpeg

    options = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart", "-f", "mp4"]
    writer = imageio_ffmpeg.write_frames(
        str(path), pixels, fps=fps, codec="libx264", macro_block_size=2, quality=8, output_params=options
    )
    writer.send(None)  # start the generator
    content = b""
    try:
        for image in images:
            content = image.convert("RGB").tobytes()
            writer.send(content)
        for _ in range(hold):
            writer.send(content)
    finally:
        writer.close()


def frames(result: Result, times: Sequence[int], pixels: tuple[int, int] | None = None) -> list[Image.Image]:
    """Draw the run at each of the given times (ns), and return the pictures, which share one palette.

    Args:
        result: the run.
        times: the times, ns.
        pixels: the width and height of the pictures; None = the usual ones.

    Raises:
        ValueError: if no positions were recorded.
    """
    several = len(started(result).evaders) > 1
    palette = _palette(tuple(dict.fromkeys((*COLOURS, *HUES))) if several else COLOURS)
    images = _drawn(result, times, pixels or _pixels(None))
    return [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]


def _drawn(result: Result, times: Sequence[int], pixels: tuple[int, int]) -> Iterator[Image.Image]:
    """Draw the run at each of the given times (ns), in all colours; symbols and texts grow with the picture."""
    dpi = min(pixels[0] / WIDTH, pixels[1] / HEIGHT)
    with styled((pixels[0] / dpi, pixels[1] / dpi)) as figure:
        figure.dpi = dpi
        figure.set_layout_engine("constrained", w_pad=PAD, h_pad=PAD)
        canvas: Any = FigureCanvasAgg(figure)
        scene = _Scene(figure, result)
    for artist in scene.moving:  # only after the layout, which must account for the artists
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    before = times[0] - 1  # the first frame has the messages that end at its time
    with progress(len(times), "frames", "frame") as bar:
        for t in times:
            canvas.restore_region(background)
            for artist in scene.at(t, before):
                figure.draw_artist(artist)
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
            before = t
            bar.update()


def _palette(colours: Sequence[str]) -> Image.Image:
    """Return an image with the common palette of all frames: white, and the shades of the given colours."""
    shades = [_shade(colour, k / SHADES) for colour in colours for k in range(1, SHADES + 1)]
    levels = np.rint(255 * np.array([[1.0, 1.0, 1.0], *shades])).astype(int)
    image = Image.new("P", (1, 1))
    image.putpalette(levels.ravel().tolist())
    return image


def _shade(colour: str, share: float) -> Floats:
    """Return a colour blended with white, as RGB; `share` in [0, 1] is the weight of the colour."""
    shade: Floats = 1.0 + (np.array(to_rgb(colour)) - 1.0) * share
    return shade


class _EvaderArtists:
    """The moving artists of one evader: the evader and the pursuers that chase it.

    Args:
        axes: the axes to draw on.
        evader: the number of the evader, 1 .. M.
        count: the number of evaders M.
    """

    def __init__(self, axes: Axes, evader: int, count: int):
        look, is_only = EvaderStyle.of(evader, count), count == 1
        pale = look.together if is_only else to_hex(tuple(_shade(look.together, PALE).tolist()))
        name = "evader" if is_only else f"evader {evader}"
        mark: dict[str, Any] = {"ms": 6} if is_only else {"ms": 8, "mfc": look.inner, "mew": 1.6}
        (self.trails,) = axes.plot([], [], color=pale, lw=1.0, solid_capstyle="butt")
        (self.relay,) = axes.plot([], [], color=look.alone, lw=2.5, solid_capstyle="butt")
        (self.path,) = axes.plot([], [], color=EVADER, lw=1.3, ls=(0, (3, 1)))
        (self.together,) = axes.plot([], [], PURSUER_MARK, mfc=pale, mec=look.alone, ms=6, label="active with others")
        (self.alone,) = axes.plot([], [], PURSUER_MARK, mfc=look.alone, mec=look.alone, ms=9, label="active alone")
        (self.evader,) = axes.plot([], [], look.mark, color=EVADER, label=name, **mark)
        (self.star,) = axes.plot([], [], CAPTURE_MARK, color="black", ms=14, mew=0)
        offset: dict[str, Any] = {"xytext": (6, 4), "textcoords": "offset points"}
        self.number = axes.annotate("" if is_only else str(evader), (0, 0), color=EVADER, weight="bold", **offset)


class _Scene:
    """The axes of the animation and their moving artists."""

    def __init__(self, figure: Figure, result: Result):
        self._result, self._paths, self._active_periods = result, Paths(result), active_periods(result)
        self._captured = {capture.evader: capture for capture in captures(result)}
        axes = figure.add_subplot()
        self._set_limits(axes)
        draw_walls(axes, result.scenario.wall)
        left, right = axes.get_xlim()
        self._messages = _MessageDots(result, self._paths, RECEIVER_GAP * (right - left))
        count = self._paths.count
        self._evaders = [_EvaderArtists(axes, evader, count) for evader in range(1, count + 1)]
        (self._dots,) = axes.plot([], [], "o", color=IN_FLIGHT, ms=2.5, mew=0, label="message in flight")
        (self._arrived,) = axes.plot([], [], "o", color=DELIVERED, ms=3.5, mew=0, label="delivered")
        (self._crosses,) = axes.plot([], [], LOST_MARK, color=LOST, ms=5, mew=1.2, label="lost")
        (self._inactive,) = axes.plot([], [], PURSUER_MARK, mfc="white", mec=INACTIVE, ms=6, label="inactive")
        self._caption = figure.suptitle("0.00 s", x=0.1, ha="left", fontsize=10)
        handles = [self._inactive, *self._chasers(), *(artists.evader for artists in self._evaders[:MAX_NAMED])]
        handles += [self._dots, self._arrived] if len(self._messages.left) else []
        handles += [self._crosses] if self._messages.lost.any() else []
        figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
        self.moving = self._in_order()

    def _chasers(self) -> list[Line2D]:
        """Return the legend entries of active pursuers; grey if there are several evaders, because hues differ then."""
        first = self._evaders[0]
        if len(self._evaders) == 1:
            return [first.together, first.alone]
        greys = {first.together: to_hex(tuple(_shade(GREY, PALE).tolist())), first.alone: GREY}
        return [
            Line2D([], [], marker="o", ls="", mfc=grey, mec=GREY, ms=line.get_markersize(), label=str(line.get_label()))
            for line, grey in greys.items()
        ]

    def _in_order(self) -> list[Artist]:
        """Return the moving artists in drawing order: each kind of all evaders, then the next kind."""

        def layers(*names: str) -> list[Artist]:
            return [getattr(artists, name) for name in names for artists in self._evaders]

        chased = [*layers("trails", "relay", "path"), self._inactive, *layers("together", "alone")]
        messages = [self._dots, self._arrived, self._crosses]
        return [*chased, *messages, *layers("evader", "star", "number"), self._caption]

    def _set_limits(self, axes: Axes) -> None:
        positions = np.concatenate([self._paths.evaders.reshape(-1, 2), self._paths.pursuers.reshape(-1, 2)])
        low, high = positions.min(axis=0), positions.max(axis=0)
        margin = 0.05 * float((high - low).max()) or 1.0
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")

    def at(self, t: int, before: int) -> list[Artist]:
        """Update the moving artists and return them in drawing order.

        Args:
            t: the time of the frame, ns.
            before: the time of the previous frame, ns; messages that arrived or were lost since then are drawn beside
                their receivers.
        """
        chases = self._chases(t)
        size = self._paths.pursuers.shape[1]
        places = np.array([self._paths.at(pursuer, np.array([t]))[0] for pursuer in range(size)])
        for evader, artists in enumerate(self._evaders, start=1):
            self._set_evader(evader, artists, t, places[[i for i in range(size) if chases.get(i) == evader]])
        self._inactive.set_data(places[[i for i in range(size) if i not in chases]].T)
        self._dots.set_data(self._messages.under_way(t).T)
        self._arrived.set_data(self._messages.ended_between(before, t, lost=False).T)
        self._crosses.set_data(self._messages.ended_between(before, t, lost=True).T)
        self._caption.set_text(f"{time_text(t, ended(self._result).t)} s: {self._status_text(t, chases)}")
        return self.moving

    def _chases(self, t: int) -> dict[int, int]:
        """Return the evader that each active pursuer chases at time t (ns).

        At the end of the run, the pursuers that were active until then are included. With several evaders, a pursuer is
        not included if its evader is captured at that instant.
        """
        is_only, end = self._paths.count == 1, ended(self._result).t
        return {
            period.pursuer: period.evader
            for period in self._active_periods
            if period.begin <= t
            and (t < period.end or (t == period.end == end and (is_only or period.evader not in self._captured)))
        }

    def _set_evader(self, evader: int, artists: _EvaderArtists, t: int, chasers: Floats) -> None:
        periods = [period for period in self._active_periods if period.begin <= t and period.evader == evader]
        for line, alone in ((artists.trails, False), (artists.relay, True)):
            of_kind = [period for period in periods if period.alone == alone]
            paths = [self._paths.of(period.pursuer, period.begin, min(period.end, t)) for period in of_kind]
            line.set_data(_joined(paths))
        path = self._paths.of_evader(evader, 0, t)
        artists.path.set_data(path.T)
        artists.together.set_data(chasers.T if len(chasers) > 1 else ([], []))
        artists.alone.set_data(chasers.T if len(chasers) == 1 else ([], []))
        artists.evader.set_data(path[-1:].T)
        artists.star.set_data(path[-1:].T if self._is_captured(evader, t) else ([], []))
        artists.number.xy = tuple(path[-1].tolist())

    def _is_captured(self, evader: int, t: int) -> bool:
        return evader in self._captured and self._captured[evader].t <= t

    def _status_text(self, t: int, chases: dict[int, int]) -> str:
        """Return the caption of a frame, without the time."""
        count, capturer = self._paths.count, ended(self._result).capturer
        captured = portable_sum(self._is_captured(evader, t) for evader in self._captured)
        if count > 1:
            last = f", the last by {capturer}" if captured == count else f", {len(chases)} active"
            return f"captured {captured} of {count}{last}"
        if captured:
            return f"captured by {capturer}"
        return f"pursuer {min(chases)} alone" if len(chases) == 1 else f"{len(chases)} active"


def _joined(paths: Sequence[Floats]) -> Floats:
    """Return several (k, 2) paths as one (2, K) path, separated by NaN."""
    gap = np.full((1, 2), np.nan)
    joined: Floats = np.concatenate([gap, *(rows for path in paths for rows in (path, gap))]).T
    return joined


class _MessageDots:
    """Messages as dots that move at constant speed from the sender at transmission to the receiver at arrival.

    Without recorded messages there are none.

    Args:
        result: the run.
        paths: the positions of its players.
        gap: the distance between the mark of an arrival or a loss and the receiver, m; see `RECEIVER_GAP`.

    Attributes:
        left: (k,) times of transmission, ns.
        lost: (k,) whether the message was lost.
    """

    def __init__(self, result: Result, paths: Paths, gap: float):
        messages = deliveries(result) if messages_recorded(result) else []
        rows = [(m.left, m.until, m.src, m.dst, m.cause is not None) for m in messages]
        self.left, self._until, src, dst, lost = np.array(rows, np.int64).reshape(-1, 5).T
        self.lost, self._gap = lost.astype(bool), gap
        self._source, self._target = np.zeros((2, len(messages), 2))
        for pursuer in range(paths.pursuers.shape[1]):
            is_sender, is_receiver = src == pursuer, dst == pursuer
            self._source[is_sender] = paths.at(pursuer, self.left[is_sender])
            self._target[is_receiver] = paths.at(pursuer, self._until[is_receiver])

    def under_way(self, t: int) -> Floats:
        """Return the (k, 2) positions, m, of the messages in flight at time t (ns)."""
        in_flight = (self.left <= t) & (t < self._until)
        share = ((t - self.left[in_flight]) / (self._until - self.left)[in_flight])[:, None]
        places: Floats = self._source[in_flight] + share * (self._target - self._source)[in_flight]
        return places

    def ended_between(self, before: int, t: int, *, lost: bool) -> Floats:
        """Return the (k, 2) positions, m, of the marks of messages `lost`, else delivered, in (before, t] (ns)."""
        has_ended = (self.lost == lost) & (before < self._until) & (self._until <= t)
        way = (self._target - self._source)[has_ended]
        length = np.hypot(way[:, 0], way[:, 1])
        share = np.minimum(self._gap / np.maximum(length, self._gap), 0.5)[:, None]
        places: Floats = self._target[has_ended] - share * way
        return places
