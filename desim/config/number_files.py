"""Numbers in text files that people bring: which texts are numbers, and why others are not.

The decimal sign is a point. Python reads more than people write by intention, such as 1_000 or digits of other scripts;
these are refused, and so are decimal commas, thousands separators and units.
"""

import re
import zlib
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable
from gzip import BadGzipFile, GzipFile
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

from desim.config.column_names import OTHER_UNITS, SAME_UNIT
from desim.config.trust import regular_or_missing

Number = TypeVar("Number")

COMMAS = re.compile(r"[+-]?[\d.\s']*,\d[\d.,]*(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""Matches a number with a comma, for decimals or thousands."""
OTHER_DIGITS = re.compile(r"[+-]?[\d_.\s]*\d[\d_.\s]*(e[+-]?[\d_]+)?", re.IGNORECASE)
"""Matches a number with underscores, white space or digits of another script."""
WITH_UNIT = re.compile(r"[+-]?[\d.]+(?:e[+-]?\d+)?\s*([^\W\d_]+(?:/\w+)?|%)", re.IGNORECASE)
"""Matches a number with a unit."""
FILLS = frozenset({999.0, 9999.0, 99999.0, 999999.0, 999.9, 9999.9, 32767.0, 32768.0})
"""Absolute values that stand for a missing value in many data sets."""


def number_of(text: str) -> float:
    """Return the number in a text; it may be nan or infinite.

    Raises:
        ValueError: if the text is not a number; the message ends with the reason, if it is known.
    """
    return _converted(text, float, "a number")


def is_fill(number: float) -> bool:
    """Return whether a number stands for a missing value in many data sets, such as -9999 in grids of ESRI."""
    return abs(number) in FILLS


def is_number_text(text: str) -> bool:
    """Return whether a text is a number; see `number_of`."""
    try:
        number_of(text)
    except ValueError:
        return False
    return True


def converted(convert: Callable[[str], Number], text: str, place: str) -> Number:
    """Return the number that a function, such as `number_of`, reads in a text.

    Raises:
        ValueError: if the function raises one; the message begins with the place of the text.
    """
    try:
        return convert(text)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


def integer_of(text: str) -> int:
    """Return the integer in a text.

    Raises:
        ValueError: if the text is not an integer in decimal digits.
    """
    return _converted(text, int, "an integer")


def _converted(text: str, convert: Callable[[str], Number], expected: str) -> Number:
    try:
        if is_plain(text):
            return convert(text)
    except ValueError:
        pass
    raise not_a_number(text, expected)


def is_plain(text: str) -> bool:
    """Return whether a text has neither underscores nor digits of other scripts, which Python would read in numbers."""
    return text.isascii() and "_" not in text


def not_a_number(text: str, expected: str = "a number") -> ValueError:
    """Return the error that a text is not a number, with the reason if it is known."""
    return ValueError(f"{text!r} is not {expected}{hint_of(text)}")


def hint_of(text: str) -> str:
    """Return the probable reason why a text is not a number, after a semicolon; "" if it is not known."""
    cell = text.strip()
    if COMMAS.fullmatch(cell):
        return "; the decimal sign is a point, and thousands have no separator"
    if OTHER_DIGITS.fullmatch(cell) and not (is_plain(cell) and len(cell.split()) < 2):
        return "; a number has the digits 0 to 9, and nothing between them"
    if WITH_UNIT.fullmatch(cell):
        return "; a number has no unit here"
    return ""


def check_comments(text: str, file: Path, unit: str) -> None:
    """Check that the comments at the head of a file, or beside its first numbers, do not name another unit.

    A table names units in the labels of its columns; a file of numbers alone can name them in comments only. Comments
    that also name the right unit are accepted: they may be about several columns, or about a conversion.

    Args:
        text: the content of the file.
        file: the path, for the error message.
        unit: the unit in which the numbers are read, "s" or "m".

    Raises:
        ValueError: if a comment names another unit; the message has its line.
    """
    lines = text.split("\n")
    comments = list(takewhile(lambda line: not line.strip() or line.lstrip().startswith("#"), lines))
    first_line = next(iter(lines[len(comments) :]), "")
    numbers, sign, comment = first_line.partition("#")
    if sign and re.search(r"\d", numbers) and not re.search(r"\d", comment):  # a number may belong to a conversion
        comments.append(f"#{comment}")
    if any(_unit_named(line, SAME_UNIT[unit]) for line in comments):
        return
    for number, line in enumerate(comments, 1):
        if other := _unit_named(line, OTHER_UNITS[unit]):
            raise ValueError(
                f"{file}, line {number}: the comment says {other!r}, and numbers are read in {unit}: convert them, or"
                " leave the unit out of the comment"
            )


def _unit_named(comment: str, units: str) -> str | None:
    """Return the unit that a comment names as that of numbers, such as `[ms]`, `_ms`, `in ms`, `latency ms` or `, ms`.

    Only units that match the expression `units` count; None if the comment names none of these.
    """
    before = r"[\[(_]\s*|\b(?:in|are) |\bunits?\b\s*[:=]?\s*"
    words = r"(?:[^\W\d][\w-]*[ :-]+)*"  # without numbers, as in `10 ms`
    at_end = rf"(?:[,;=/|:<{{]\s*|^#+\s*{words})({units})[>}}]?$"
    match = re.search(rf"(?:{before})({units})(?=[\])\s,;:./]|$)|{at_end}", comment.strip())
    return match and (match[1] or match[2])


GZIP = b"\x1f\x8b"
"""The first bytes of a file that gzip has compressed."""
MAX_UNPACKED = 2**28
"""Largest size of a decompressed file, bytes; a small file could otherwise fill the memory."""


def content_of(file: Path) -> bytes:
    """Return the content of a file, decompressed if it was compressed by gzip, whatever its name is.

    Raises:
        ValueError: if the file cannot be read, is cut, or is larger than `MAX_UNPACKED` when it is decompressed.
    """
    try:
        content = regular_or_missing(file).read_bytes()
    except OSError as error:
        raise ValueError(f"{file} cannot be read: {error.strerror or error}") from error
    if not content.startswith(GZIP):
        return content
    try:
        with GzipFile(fileobj=BytesIO(content)) as compressed:
            unpacked = compressed.read(MAX_UNPACKED + 1)
    except EOFError as error:
        raise ValueError(f"{file} cannot be read: it is compressed by gzip, and its end is missing") from error
    except (BadGzipFile, zlib.error) as error:
        raise ValueError(f"{file} cannot be read: it is not valid gzip: {error}") from error
    if len(unpacked) > MAX_UNPACKED:
        raise ValueError(f"{file} is larger than {MAX_UNPACKED >> 20} MiB when it is decompressed")
    return unpacked


PICTURE = "a picture of pixels: draw or trace its lines in an editor, and save them as SVG"
NO_TEXT = {
    b"PK\x03\x04": "a zip archive or a spreadsheet: unpack it, or save its table as CSV",
    b"\xd0\xcf\x11\xe0": "a spreadsheet: save its table as CSV",
    b"PAR1": "a Parquet file, which is read as a table only, with a name that ends in .parquet",
    b"SQLite format 3": "a database of SQLite: export a table as CSV",
    b"\x93NUMPY": "an array of numpy: numpy.savetxt writes it as text",
    b"\x89HDF": "a file of HDF5: export a table as CSV",
    b"CDF": "a file of NetCDF: export a table as CSV",
    b"MATLAB 5.0": "a file of Matlab: writetable exports a table as CSV",
    b"ULog": "a log of PX4: ulog2csv exports its tables as CSV",
    b"#ROSBAG": "a bag of ROS: rostopic echo -b FILE -p TOPIC exports a topic as CSV",
    b"P5": PICTURE,
    b"\x89PNG": PICTURE,
    b"\xff\xd8\xff": PICTURE,
    b"GIF8": PICTURE,
    b"\xd4\xc3\xb2\xa1": "a capture of packets: tshark -T fields exports it as CSV",
    b"\n\r\r\n": "a capture of packets: tshark -T fields exports it as CSV",
}
"""Binary formats by their first bytes, and how to export text from them."""


def text_of_file(file: Path) -> str:
    r"""Return the text of a file in UTF-8, or in UTF-16 with a byte order mark; its lines end with \n.

    The file may be compressed by gzip; see `content_of`.

    Raises:
        ValueError: if the file cannot be read, or is not text.
    """
    content, text, reason = content_of(file), "", ""
    try:
        text = _decoded(content)
        reason = ", because it has zero bytes" if "\0" in text else ""
    except UnicodeDecodeError as error:
        reason = f" ({error.reason} at byte {error.start})"
    if reason:
        kind = next((kind for begin, kind in NO_TEXT.items() if content.startswith(begin)), None)
        raise ValueError(f"{file} cannot be read: it is {kind or f'not text in UTF-8{reason}'}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _decoded(content: bytes) -> str:
    is_utf16 = content.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    return content.decode("utf-16") if is_utf16 else content.removeprefix(BOM_UTF8).decode()


def lines_of(file: Path) -> list[str]:
    """Return the lines of a text file of numbers, without comments, which begin with #.

    Raises:
        ValueError: if the file cannot be read.
    """
    return [line.partition("#")[0] for line in text_of_file(file).split("\n")]


def words_of(line: str) -> list[str]:
    """Return the words of a line between ASCII white space; other white space may separate thousands."""
    return re.findall(r"[^ \t\f\v]+", line)
