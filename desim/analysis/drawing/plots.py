"""Drawing with matplotlib: the common style of all figures, and the writing of their files.

Files are reproducible byte by byte.
"""

import re
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text

from desim.analysis.drawing.legends import uncover_data
from desim.config.arguments import value_text
from desim.config.errors import ArgumentError
from desim.config.escaping import escaped
from desim.config.file_names import PICTURE_SUFFIXES, files
from desim.config.whole_files import write_whole

__all__ = [
    "COLUMN",
    "NARROW",
    "Axes",
    "Figure",
    "Style",
    "as_it_is",
    "figure_of",
    "html_image",
    "in_style",
    "save",
    "size_of",
    "styled",
]

COLUMN = 8.5 / 2.54
"""The width of a column of a paper, inches."""
NARROW = 12.0 / 2.54
"""The minimum width, inches, of a figure with the usual size of text and several columns in its legend."""
STYLE: dict[Any, Any] = {
    "text.usetex": False,  # a matplotlibrc in the working folder may set it; names would then run as TeX
    "svg.fonttype": "none",
    "svg.hashsalt": "desim",
    "pdf.fonttype": 42,  # TrueType; publishers refuse Type 3
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}
UNDATED: Mapping[str, Mapping[str, None]] = {".svg": {"Date": None}, ".png": {}, ".pdf": {"CreationDate": None}}
"""The option `metadata` of `savefig` for each format: None leaves out the date."""


Style = str | Mapping[str, Any] | Sequence[str | Mapping[str, Any]] | None
"""A style of matplotlib: rcParams, the name of a style, or several of these; None = that of desim."""


@contextmanager
def in_style(style: Style) -> Iterator[None]:
    """Draw in a style of matplotlib on top of the present one.

    Raises:
        ValueError: if there is no such style or parameter.
    """
    with ExitStack() as drawing:
        try:
            drawing.enter_context(mpl_style.context([] if style is None else style))  # type: ignore[arg-type]
        except UnicodeDecodeError as error:
            raise ArgumentError(
                "style", f"should be a style sheet of matplotlib, got a binary file: {value_text(style)}"
            ) from error
        except TypeError as error:
            raise ArgumentError(
                "style", f"should be rcParams, the name of a style, or a list (got {value_text(style)})"
            ) from error
        except (KeyError, OSError) as error:
            raise ArgumentError("style", f": {error.args[0] if error.args else error}") from error
        yield


def figure_of(ax: object, *, panels: Sequence[str] = ("",), size: str | None = None) -> Figure:
    """Return the figure of axes to draw on.

    Args:
        ax: what a caller gave as `ax`.
        panels: the titles of the panels of the drawing; one pair of axes has room for one panel.
        size: what the caller gave as `size`; it should be None, because the figure has its size already.

    Raises:
        TypeError: if `ax` is not a pair of axes.
        ValueError: if the axes are not plain, there are several panels, or a size is given.
    """
    if not isinstance(ax, Axes):
        hint = ""
        if isinstance(ax, Figure):
            hint = "; ax=figure.add_subplot() gives it one"
        elif isinstance(ax, np.ndarray | Sequence) and not isinstance(ax, str):
            hint = "; give one of them, such as ax=axes[0]"
        elif isinstance(ax, type(mpl)):
            hint = "; ax=plt.gca() is the current one"
        raise TypeError(f"ax should be the axes of a figure of matplotlib, got {type(ax).__name__}{hint}")
    if ax.name != "rectilinear":
        raise ValueError(f"ax should have plain axes, not {ax.name} ones")
    if (figure := ax.get_figure(root=True)) is None:
        raise ValueError("ax was removed from its figure")
    if size is not None:
        raise ArgumentError("size", "is that of a new figure: with ax, set the size of the figure of ax")
    if len(panels) > 1:
        raise ValueError(f"ax is one panel, and there are {len(panels)} ({'; '.join(panels[:3])}): leave ax out")
    return figure


@contextmanager
def styled(
    figsize: tuple[float, float], size: str | None = None, *, font: float | None = None, style: Style = None
) -> Iterator[Figure]:
    """Yield an empty figure in the common style.

    Its layout is computed at the end of the block, and again at each drawing if its size or a text has changed.

    Args:
        figsize: the usual width and height, inches.
        size: another size, see `size_of`; if it is a width alone, the figure has its usual shape. None: the usual one.
        font: size of text, points; None: 9, and 8 in a narrow figure.
        style: a style on top of the common one.

    Raises:
        ValueError: if there is no such style, or the size is invalid.
    """
    if size is not None:
        width, height = size_of(size)
        figsize = width, height or width * figsize[1] / figsize[0]
    if font is None:
        font = 9.0 if figsize[0] >= NARROW else 8.0
    small = {} if font >= STYLE["font.size"] else {"axes.titlesize": font, "axes.linewidth": 0.6}
    with mpl.rc_context(STYLE | small | {"font.size": font}), in_style(style):
        figure = _StyledFigure(figsize=figsize, layout=(layout := _SettledLayout()))
        yield figure
        figure.draw_without_rendering()
        if not layout.is_settled(figure):  # the first layout has changed the ticks of the axes
            figure.draw_without_rendering()
        is_covering = uncover_data(figure)
        if is_covering or not _titles_fit(figure):
            layout.unsettle()
            figure.draw_without_rendering()


def _titles_fit(figure: Figure) -> bool:
    """Return whether the titles of the axes end within a figure; one layout of axes with equal scales may cut them."""
    return all(axes.title.get_window_extent().y1 <= figure.bbox.y1 for axes in figure.axes)


class _StyledFigure(Figure):
    """A figure that `savefig` always writes in the common style, for example with TrueType fonts in a PDF."""

    def savefig(self, *args: Any, **options: Any) -> None:
        """Write the figure; see `matplotlib.figure.Figure.savefig`."""
        with mpl.rc_context(STYLE):
            super().savefig(*args, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return what a notebook shows: a PNG at twice the resolution, and its width and height on the page, pixels.

        IPython knows by itself only how to show figures of pyplot.
        """
        width, height = (round(72 * length) for length in self.get_size_inches())
        return _png(self), {"width": width, "height": height}


class _SettledLayout(ConstrainedLayoutEngine):
    """A constrained layout that is computed anew only if the size or a text of the figure has changed.

    Repeated layouts of one figure differ by rounding errors, so its files would differ, too.
    """

    _last_extent: object = None
    """The `_extent` of the figure after its last layout."""

    def is_settled(self, figure: Figure) -> bool:
        """Return whether size and texts of a figure are those of its last layout."""
        return _extent(figure) == self._last_extent

    def unsettle(self) -> None:
        """Let the next drawing compute the layout anew."""
        self._last_extent = None

    def execute(self, figure: Figure) -> None:
        """Compute the layout if it is not settled; matplotlib calls this at each drawing."""
        if not self.is_settled(figure):
            super().execute(figure)
            self._last_extent = _extent(figure)


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Draw a figure if it has changed, and keep `savefig` from computing a layout for each file.

    Even if the layout is settled, `savefig` draws a figure once more to lay it out, which takes half of the time.
    """
    layout = figure.get_layout_engine()

    def is_settled() -> bool:
        return isinstance(layout, _SettledLayout) and layout.is_settled(figure)

    if figure.stale or not is_settled():
        figure.draw_without_rendering()  # a layout at the resolution of the figure, not at that of a file
    if not is_settled():
        yield
        return
    with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(layout)


def _extent(figure: Figure) -> object:
    """Return the size of a figure, inches, and its texts with their font sizes, points."""
    texts = figure.findobj(Text)
    return tuple(figure.get_size_inches()), [(text.get_text(), text.get_fontsize()) for text in texts]


def as_it_is(text: str) -> str:
    """Return the text of a title whose "$" is shown as it is.

    Without the backslashes, matplotlib reads "$" as mathematics in texts that it wraps, even with `parse_math=False`.
    """
    return escaped(text).replace("$", r"\$")


SIZE = re.compile(r"(?P<width>\d+(\.\d+)?)(?P<unit>cm|mm|in)?(x(?P<height>\d+(\.\d+)?)(?P<last>cm|mm|in)?)?")
UNITS = {"cm": 2.54, "mm": 25.4, "in": 1.0}
"""Units of length per inch."""
LENGTHS = 1.0, 100.0
"""The least and the greatest width and height of a figure, inches."""


def size_of(text: str) -> tuple[float, float | None]:
    """Return the width and the height, inches, of a size such as "8.5cm", "8.5cmx6cm", "85x60mm" or "3.5in".

    The height is None if only a width is given.

    Raises:
        ValueError: if the text is not a size, or the width or the height is not from 1 in to 100 in.
    """
    match = SIZE.fullmatch(str(text).replace(" ", ""))
    units = [match["unit"], match["last"]] if match else []
    if match is None or not any(units):
        why = "should be a width and perhaps a height in cm, mm or in, as 8.5cmx6cm"
        raise ArgumentError("size", f"{why} (got {value_text(text)})")
    unit, last = (name or units[1 - k] for k, name in enumerate(units))  # one unit serves both lengths
    width = float(match["width"]) / UNITS[unit]
    height = None if match["height"] is None else float(match["height"]) / UNITS[last]
    if not all(LENGTHS[0] <= length <= LENGTHS[1] for length in (width, height) if length is not None):
        raise ArgumentError("size", f"should be from {LENGTHS[0]:g} in to {LENGTHS[1]:g} in, each way (got {text!r})")
    return width, height


def save(figure: Figure, path: Path, *, dpi: int = 150) -> list[Path]:
    """Write a figure without a date, as SVG and PNG if the path has no suffix, and return the paths of the files.

    Args:
        figure: a figure made by `styled`.
        path: the path of the file, with a suffix of `PICTURE_SUFFIXES` or without one.
        dpi: dots per inch of a PNG.

    Raises:
        ValueError: if the suffix is not one of `PICTURE_SUFFIXES`.
        OSError: if a file cannot be written.
    """
    paths = files(path, PICTURE_SUFFIXES, PICTURE_SUFFIXES[:2])
    with mpl.rc_context(STYLE), _laid_out(figure):
        for target in paths:
            kind = target.suffix.lower()
            stream = BytesIO()  # on a full disk, the writer of PDF would raise an AttributeError
            figure.savefig(stream, format=kind[1:], dpi=dpi, metadata=UNDATED[kind])
            write_whole(target, stream.getvalue())
    return paths


def _png(figure: Figure) -> bytes:
    """Return a figure as a PNG at twice the resolution of a page, 144 dots per inch."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=2 * 72)
    return stream.getvalue()


def html_image(figure: Figure, name: str) -> str:
    """Return a figure as an HTML image: a PNG at twice the resolution of the page, with `name` as alternative text."""
    width = 72.0 * figure.get_figwidth()
    source = f"data:image/png;base64,{b64encode(_png(figure)).decode()}"
    return f'<img src="{source}" alt="{escape(name)}" width="{width:.0f}">'
