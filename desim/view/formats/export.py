"""The trace of a run in the formats of other programs, chosen by the suffix of the file."""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from desim.analysis.knowledge import Pieces
from desim.config.trust import replacing
from desim.kernel.core.events import Event
from desim.view.data.headings import Headings
from desim.view.formats import foxglove, pcapng, trace_table

TABLES = (".csv", ".parquet")
"""The suffixes of tables; see `desim.view.formats.trace_table`."""
COUNTED: Mapping[str, str] = MappingProxyType(
    {".csv": "rows", ".parquet": "rows", ".pcapng": "packets", ".mcap": "messages"}
)
"""The items of a file, by its suffix."""
NEEDED: Mapping[str, tuple[str, str]] = MappingProxyType(
    {".parquet": ("pyarrow", "parquet"), ".mcap": ("mcap", "mcap")}
)
"""The package that a format needs, and the extra of desim with this package."""


def export(
    events: Iterable[Event],
    file: str | Path,
    kinds: Collection[str] = trace_table.KINDS,
    beliefs: Pieces | None = None,
    headings: Headings | None = None,
) -> int:
    """Write the trace of a run to a file, and return the number of its rows, packets or messages.

    The events are not held in memory. The file is written beside its place and replaces an older one at the end.

    Args:
        events: the events of the run, in order: `result.trace`, or `desim.results.run_folder.events(folder)`.
        file: the path of the file: .csv or .parquet (see `desim.view.formats.trace_table`), .pcapng
            (`desim.view.formats.pcapng`) or .mcap (`desim.view.formats.foxglove`).
        kinds: the types of the events in a table.
        beliefs: the beliefs for .mcap, from `desim.analysis.knowledge.knowledge`; None: they are left out.
        headings: the headings for .mcap; None: all players head along the x axis.

    Raises:
        ValueError: if the file has another suffix, there is no such type of events, or the messages that a .pcapng
            needs were not recorded.
        ImportError: if a package that the format needs is not installed.
        OSError: if the file cannot be written.
    """
    file = Path(file)
    check_suffix(file)
    trace_table.columns_of(kinds)  # raises an error for a wrong kind before anything is written
    suffix = file.suffix.lower()
    with replacing(file) as part:
        try:
            match suffix:
                case ".csv":
                    return trace_table.write_csv(events, part, kinds)
                case ".parquet":
                    return trace_table.write_parquet(events, part, kinds)
                case ".pcapng":
                    return pcapng.write(events, part)
            return foxglove.write(events, part, beliefs, headings)
        except ModuleNotFoundError as error:
            package, extra = NEEDED.get(suffix, ("", ""))
            if (error.name or "").partition(".")[0] != package:
                raise
            raise ImportError(
                f"{package} is missing: pip install 'pursuit-desim[{extra}]', or in a clone '.[{extra}]'"
            ) from error


def check_suffix(file: Path) -> None:
    """Raise ValueError unless the suffix of a file is that of a format."""
    if file.suffix.lower() not in COUNTED:
        *others, last = COUNTED
        raise ValueError(f"{file}: should end in {', '.join(others)} or {last}")
