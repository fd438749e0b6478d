"""Text files of latencies in s, separated by white space or commas; `#` begins a comment."""

from pathlib import Path

from desim.config.number_files import lines_of


def latencies_of(file: Path) -> list[float]:
    """Return the latencies, s, in a text file.

    Raises:
        ValueError: if the file cannot be read, contains no numbers or anything but times >= 0 s, or is a table of
            several columns.
    """
    numbers: list[float] = []
    rows = [text.replace(",", " ").split() for text in lines_of(file)]
    for line, row in enumerate(rows, 1):
        for item in row:
            try:
                numbers.append(float(item))
            except ValueError as error:
                hint = "" if numbers else "; a header should begin with #"
                raise ValueError(f"{file}, line {line}: {item!r} is not a number{hint}") from error
            if not 0.0 <= numbers[-1] < float("inf"):
                raise ValueError(f"{file}, line {line}: a latency should be a time >= 0 s (got {item})")
    if not numbers:
        raise ValueError(f"{file} contains no numbers")
    lengths = [len(row) for row in rows if row]
    if len(lengths) > 1 and lengths[0] > 1 and len(set(lengths)) == 1:
        raise ValueError(f"{file} has {lengths[0]} columns; it should have one, with the latencies")
    return numbers
