"""The check of exporters: `check_exporter`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from desim.config.arguments import naming_arguments, value_text
from desim.kernel.core.trace_file import line_of
from desim.results.run_folder import streamed, write
from desim.scenario.scenario import Scenario
from desim.simulation.run import run
from desim.testing.judging import SEED, Subject, subject
from desim.testing.metrics import SITUATIONS
from desim.view.formats.export import EXPORTERS, ExporterTraits, is_count


@naming_arguments
def check_exporter(exporter: Any, *, limit: float = 10.0) -> None:
    """Check an exporter; if you are unsure whether yours is right, run this.

    It exports runs that may surprise it: without a capture, at time 0, without recorded positions or messages, with
    crashes, with two evaders. It checks that the file is written, with equal bytes for an equal run; that the number of
    items is an integer or None; that the trace is not changed; and, with `streams = True`, that a recorded run gives
    the same file. An exporter may refuse a run with a ValueError that says what the run lacks, but not every run.

    Args:
        exporter: a function or object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each run and export may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the exporter is wrong, with the run and what is expected.
    """
    tested = subject(exporter, EXPORTERS, "exporter")
    refusals = []
    for where, parts in SITUATIONS.items():
        with tested.judged(where, limit), TemporaryDirectory() as folder:
            refusals += _refusals(tested, where, parts, Path(folder))
    tested.require(
        len(refusals) < len(SITUATIONS), f"the exporter refuses every run: {refusals[0] if refusals else ''}"
    )


def _refusals(tested: Subject, where: str, parts: dict[str, Any], folder: Path) -> list[str]:
    """Check two exports of one run; return the reason, in a list, if the exporter refuses the run."""
    result = run(Scenario(**parts), SEED)
    lines = list(map(line_of, result.trace))
    files = [folder / f"{name}{ExporterTraits.of(tested.model).suffix or '.file'}" for name in "ab"]
    results: list[Any] = [result, result]
    if streams := ExporterTraits.of(tested.model).streams:
        write(result, folder / "run", drawn=False)
        results[1] = streamed(folder / "run", allow_import=True)
    call = f"exporter(result, file) of {where}"
    for exported, file in zip(results, files, strict=True):
        try:
            with tested.fresh() as model:
                count = model(exported, file)
        except ValueError as error:
            return [str(error)]
        tested.require(file.exists(), f"{call} does not write the file that it is given")
        tested.require(
            is_count(count),
            f"{call} returns {value_text(count)}, expected the number of items in the file, an integer, or None",
        )
    first, second = (file.read_bytes() for file in files)
    how = "read from its folder, event by event," if streams else "exported again"
    tested.require(first == second, f"{call} writes another file for the run {how}: expected equal bytes")
    tested.require(list(map(line_of, result.trace)) == lines, f"{call} changes the trace")
    return []
