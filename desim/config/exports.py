"""The names that a package exports, each of which is imported on first access."""

import re
from pathlib import Path

_IMPORT = re.compile(r"^    from (\S+) import (\w+) as \2\b", re.MULTILINE)


def homes_of_exports(file: str) -> dict[str, str]:
    """Return the module of each name that a package exports, in the order of its source.

    They are the names that it imports for type checkers, `from MODULE import NAME as NAME`, so no list repeats them.
    """
    source = Path(file).read_text(encoding="utf-8")
    return {name: home for home, name in _IMPORT.findall(source)}
