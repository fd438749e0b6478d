"""Tables for terminals, papers and pages: aligned text, LaTeX (booktabs), and Markdown."""

import html
import re
from collections.abc import Iterable, Sequence
from typing import ClassVar, Literal, get_args

from desim.analysis.tables import aligned
from desim.config.arguments import naming_arguments, value_text
from desim.config.escaping import escaped
from desim.config.html import html_table
from desim.config.suggestion import close_to

TableFormat = Literal["text", "latex", "markdown"]
"""The format of a table: aligned text, a tabular with the rules of booktabs, or a table of GitHub's Markdown."""
Table = tuple[str, Sequence[Sequence[str]]]
"""The title of a table, and its rows of text; the first row is the header."""
SUFFIXES: dict[str, TableFormat] = {".tex": "latex", ".md": "markdown"}
"""The formats of files, by suffix."""
LATEX = {
    **{"\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_"},
    **{"^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}"},
    **{"|": r"\textbar{}", '"': r"\textquotedbl{}"},
}
"""The LaTeX commands that print the characters which LaTeX reads as commands, or prints as other characters."""
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$])")
"""Matches the characters that Markdown, or mathematics in it, reads as commands."""
INFINITE = {"inf": r"$\infty$", "-inf": r"$-\infty$"}
"""The symbols of cells that are infinite."""
NUMBER = r"[+-]?\d[\d,]*(?:\.\d+)?(?:e[+-]\d+)?"
MEASURED = re.compile(rf"(?P<mean>{NUMBER})(?: \+- (?P<width>{NUMBER}|-))?(?P<remark>| .*)")
"""Matches a number, perhaps with a half width and a remark."""
NEGATIVE = re.compile(r"(?<=[( ])-(?=\d)")
"""Matches the sign of a number within a text."""


class TabularResult:
    """A result that is shown as tables with notes below them: as text, in a notebook, and in the formats of papers."""

    _between_notes: ClassVar[str] = "\n\n"
    """What separates the notes in plain text."""

    def tables(self) -> list[Table]:
        """Return each table as its title and rows of text; the first row is the header."""
        raise NotImplementedError

    def _notes(self) -> Iterable[str]:
        """Return the notes below the tables, in order."""
        raise NotImplementedError

    def _right_from(self) -> int:
        """Return the first column that is aligned to the right."""
        return 1

    @naming_arguments
    def table(self, *, format: TableFormat = "text") -> str:  # noqa: A002 - the clearest name for users
        """Return the tables and the notes: text, latex (booktabs) or markdown.

        Raises:
            ValueError: if there is no such format.
        """
        notes = [*self._notes()]
        if format == "text":
            notes = [self._between_notes.join(notes)] if notes else []
        return formatted(self.tables(), notes, format, self._right_from())

    def __str__(self) -> str:
        return self.table()

    def _repr_html_(self) -> str:
        """Return the tables and the notes as HTML, for notebooks."""
        tables = (html_table(title, rows) for title, rows in self.tables())
        return "".join([*tables, *(f"<p>{html.escape(note)}</p>" for note in self._notes())])


def formatted(
    tables: Iterable[Table],
    notes: Iterable[str],
    format: TableFormat,  # noqa: A002
    right_from: int = 1,
) -> str:
    """Return tables and the notes below them as text.

    Args:
        tables: the tables.
        notes: the notes.
        format: the format.
        right_from: the first column that is aligned to the right.

    Raises:
        ValueError: if there is no such format.
    """
    if format not in get_args(TableFormat):
        near = close_to(str(format), get_args(TableFormat))
        hint = f", did you mean {near[0]}?" if near else ""
        raise ValueError(f"format should be {', '.join(get_args(TableFormat))}, got {value_text(format)}{hint}")
    if format == "text":
        return "\n\n".join([*(f"{title}\n{aligned(rows, right_from)}" for title, rows in tables), *notes])
    parts = [(_latex if format == "latex" else _markdown)(title, rows, right_from) for title, rows in tables]
    if format == "latex":
        return "\n\n".join(["% needs \\usepackage{booktabs}", *parts, *(f"% {_line(note)}" for note in notes)])
    return "\n\n".join([*parts, *(markdown_text(note) for note in notes)])


def _latex(title: str, rows: Sequence[Sequence[str]], right_from: int) -> str:
    """Return a table as a tabular; its title, which belongs into a caption, is a comment."""
    head, *body = rows
    columns = "".join("r" if k >= right_from else "l" for k in range(len(head)))
    lines = [
        " & ".join(latex_text(cell) for cell in head),
        *(" & ".join(_latex_cell(cell) for cell in row) for row in body),
    ]
    header, *rest = (f"{line} \\\\" for line in lines)
    ruled = [r"\toprule", header, r"\midrule", *rest, r"\bottomrule"]
    return "\n".join([f"% {_line(title)}", rf"\begin{{tabular}}{{{columns}}}", *ruled, r"\end{tabular}"])


def latex_text(text: str) -> str:
    """Return a text such that LaTeX prints it as it is."""
    return "".join(LATEX.get(letter, letter) for letter in _line(text))


def _latex_cell(cell: str) -> str:
    """Return a cell for LaTeX; a number at its start, with its half width if it has one, becomes mathematics."""
    match = MEASURED.fullmatch(cell)
    if cell in INFINITE:
        return INFINITE[cell]
    text = latex_text(cell if match is None else match["remark"])
    # First the signs, in mathematics: a hyphen next to the "--" of a range would make a dash of three hyphens.
    text = NEGATIVE.sub("$-$", text).replace(" .. ", "--")
    if match is None:
        return text
    mean, width = (_latex_number(match[name] or "") for name in ("mean", "width"))
    plus_minus = rf" \pm {width}" if width not in {"", "-"} else ""
    return f"${mean}{plus_minus}${text}"


def _latex_number(number: str) -> str:
    """Return a number for the mathematics of LaTeX, which would add a space after a comma without braces."""
    mantissa, e, exponent = number.replace(",", "{,}").partition("e")
    return rf"{mantissa} \times 10^{{{int(exponent)}}}" if e else mantissa


def _markdown(title: str, rows: Sequence[Sequence[str]], right_from: int) -> str:
    """Return a table as a Markdown table below its title."""
    head, *body = ([markdown_text(cell) or " " for cell in row] for row in rows)
    rule = ["---:" if k >= right_from else ":---" for k in range(len(head))]
    lines = [f"| {' | '.join(row)} |" for row in (head, rule, *body)]
    return "\n".join([markdown_text(title), "", *lines])


def markdown_text(text: str) -> str:
    """Return a text such that Markdown shows it as it is."""
    return MARKDOWN.sub(r"\\\1", _line(text)).replace("+-", "±")


def _line(text: str) -> str:
    """Return a text in one line, with the characters that a terminal would not print escaped."""
    return escaped(" ".join(text.split())) if "\n" in text else escaped(text)
